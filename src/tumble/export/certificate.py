"""What a certificate says that no recording knows: who calibrated what for whom, when and where; from a TOML file.

number = "2026-0042"
country = "DE"                  # where the certificate is issued, ISO 3166-1
begin = 2026-05-04              # of the measurements
end = 2026-05-05
place = "laboratory"            # laboratory, customer, laboratoryBranch, customerBranch or other

[laboratory]
name = "Inertial laboratory"
city = "Braunschweig"
country = "DE"                  # also: code, email, street, postcode

[customer]
name = "A customer"
city = "Perm"
country = "RU"

[[person]]                      # who answers for it, the first one signs
name = "N. N."
role = "head of the laboratory"
"""

from __future__ import annotations

from collections.abc import Mapping
from datetime import date
from pathlib import Path
from typing import Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from tumble.documents import text_of_document, toml_of
from tumble.errors import InputError

_Text = Field(pattern=r"^\S+(\s+\S+)*$")
_Country = Field(pattern="^[A-Z]{2}$")


class _CertificateTable(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)


class Party(_CertificateTable):
    """A laboratory or a customer: `code` is the laboratory's accreditation mark."""

    name: str = _Text
    city: str = _Text
    country: str = _Country
    code: str | None = Field(default=None, pattern=r"^\S+(\s+\S+)*$")
    email: str | None = Field(default=None, pattern=r"^\S+$")
    street: str | None = Field(default=None, pattern=r"^\S+(\s+\S+)*$")
    postcode: str | None = Field(default=None, pattern=r"^\S+(\s+\S+)*$")


class Person(_CertificateTable):
    """Who answers for a certificate."""

    name: str = _Text
    role: str | None = Field(default=None, pattern=r"^\S+(\s+\S+)*$")


class Certificate(_CertificateTable):
    """The administrative part of a calibration certificate."""

    number: str = _Text
    country: str = _Country
    begin: date
    end: date
    place: Literal["laboratory", "customer", "laboratoryBranch", "customerBranch", "other"] = "laboratory"
    laboratory: Party
    customer: Party
    person: tuple[Person, ...] = Field(min_length=1, strict=False)

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.end < self.begin:
            raise ValueError(f"end: expected a day not before the begin, {self.begin}, found {self.end}")
        return self


def read_certificate(path: Path) -> Certificate:
    """The administrative part of a certificate from its TOML file. Raises InputError, one line with the first fault."""
    try:
        content: Mapping[str, Any] = toml_of(text_of_document(path), str(path))
        return Certificate.model_validate(content)
    except OSError as error:
        raise InputError(f"{path}: expected a TOML file with the data of the certificate: {error.strerror}") from None
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: expected UTF-8 text, found {error.reason}; save it as UTF-8") from None
    except ValidationError as error:
        fault = error.errors(include_url=False)[0]
        key = ".".join(map(str, fault["loc"])) or "certificate"
        raise InputError(f"{path}: {key}: {fault['msg']}; see docs/export/dcc.md") from None
