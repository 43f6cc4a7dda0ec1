"""What a certificate says that no recording knows: who calibrated what for whom, when, where and by which rule it is
judged; from a TOML file, whose laboratory and signatories may stand in a file of their own.
docs/howto/reports.md has every key.

number = "2026-0042"            # unique, stands on every page
country = "DE"                  # where the certificate is issued, ISO 3166-1
laboratory = "laboratory.toml"  # [laboratory] and [[person]]; or the table [laboratory] itself

[customer]
name = "A customer"
city = "Perm"
country = "RU"
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from datetime import date
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator

from tumble.documents import is_plain, shown, text_of_document, toml_of, validated
from tumble.errors import InputError
from tumble.lab.limits import Limits, Occasion, limits_of
from tumble.result.calibration import Calibration, read_calibration
from tumble.result.further import recording_dates

RELATES = (
    "This certificate relates only to the item described in it, in the state in which it was calibrated; it may be "
    "reproduced only as a whole, unless the laboratory agrees in writing."
)
STATES: Mapping[str, str] = {
    "as-found": "as found: calibrated before any adjustment",
    "as-left": "as left: calibrated after adjustment",
    "unchanged": "not adjusted: as found and as left",
}
"""The state of the item when it was calibrated."""
Place = Literal["laboratory", "customer", "laboratoryBranch", "customerBranch", "other"]
PLACES: Mapping[Place, str] = {
    "laboratory": "laboratory",
    "customer": "at the customer's",
    "laboratoryBranch": "branch of the laboratory",
    "customerBranch": "branch of the customer",
    "other": "elsewhere",
}
"""Where an item was calibrated."""


def _without_control_characters(text: str) -> str:
    if not is_plain(text.replace("\n", " ").replace("\t", " ")):
        raise ValueError(f"expected no control characters, found {shown(text)}")
    return text


_Str = Annotated[str, AfterValidator(_without_control_characters)]
_Text = Annotated[_Str, Field(pattern=r"^\S+(\s+\S+)*$")]
_Country = Annotated[_Str, Field(pattern="^[A-Z]{2}$", description="two capital letters of ISO 3166-1, such as 'DE'")]
_Path = Annotated[_Str, Field(min_length=1)]

_ACCREDITED = ("procedure", "traceability", "issued")
"""Without these a certificate is not one of ISO/IEC 17025, 7.8."""


class _CertificateTable(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)


class Party(_CertificateTable):
    """A laboratory or a customer: `code` is the laboratory's accreditation number, `logo` the path of its picture."""

    name: _Text
    city: _Text
    country: _Country
    code: _Text | None = None
    email: _Str | None = Field(default=None, pattern=r"^\S+$", description="an address without spaces")
    street: _Text | None = None
    postcode: _Text | None = None
    logo: _Str | None = Field(
        default=None, pattern=r"^\S.*\.(svg|png)$", description="the name of a picture, .svg or .png"
    )

    @property
    def address(self) -> str:
        """Street, postcode, city and country on one line."""
        town = f"{self.postcode} {self.city}" if self.postcode else self.city
        return ", ".join(part for part in (self.street, town, self.country) if part)


class Person(_CertificateTable):
    """Who answers for a certificate."""

    name: _Text
    role: _Text | None = None


class Certificate(_CertificateTable):
    """The administrative part of a calibration certificate. Without `begin` and `end` the date is that of the
    recording. `state` is that of the item when it was calibrated: before an adjustment, after it, or without one;
    `as_found` the calibration file from before. `limits` is the file of acceptance limits, `check` which of its checks
    the statement of conformity is about, `agreed` how they and the decision rule were agreed with the customer,
    `traceability` how gravity, time and table are traced, `replaces` the number of a certificate that this one takes
    the place of. A key with a title stands on the first page under this title."""

    number: _Text
    country: _Country
    begin: date | None = None
    end: date | None = None
    received: date | None = Field(default=None, title="received")
    issued: date | None = Field(default=None, title="issued")
    place: Place = "laboratory"
    state: Literal["as-found", "as-left", "unchanged"] = "unchanged"
    as_found: _Path | None = None
    procedure: _Text | None = Field(default=None, title="procedure")
    limits: _Path | None = None
    check: Occasion | None = None
    agreed: _Text | None = None
    traceability: tuple[_Str, ...] = Field(default=(), strict=False)
    remarks: tuple[_Str, ...] = Field(default=(), strict=False)
    replaces: _Text | None = Field(default=None, title="replaces certificate")
    laboratory: Party
    customer: Party
    person: tuple[Person, ...] = Field(min_length=1, strict=False)

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.begin is not None and self.end is not None and self.end < self.begin:
            raise ValueError(f"end: expected a day not before the begin, {self.begin}, found {self.end}")
        if self.as_found is not None and self.state != "as-left":
            raise ValueError(f'as_found: expected only with state = "as-left", found {self.state!r}')
        if self.replaces == self.number:
            raise ValueError(f"replaces: expected the number of another certificate, found its own, {self.number!r}")
        missing = [name for name in _ACCREDITED if not getattr(self, name)] if self.laboratory.code else []
        missing += ["agreed"] if self.laboratory.code and self.limits is not None and self.agreed is None else []
        if missing:
            raise ValueError(
                f"{missing[0]}: expected this key under an accreditation number (laboratory.code), found none of "
                f"{', '.join(missing)}"
            )
        return self

    def days(self, calibration: Calibration) -> tuple[date, date]:
        """First and last day of the calibration: as stated, or those of the recordings. Raises InputError without."""
        recorded = [date.fromisoformat(moment[:10]) for moment in recording_dates(calibration)]
        begin = self.begin or (min(recorded) if recorded else self.end)
        end = self.end or (max(recorded) if recorded else self.begin)
        if begin is None or end is None:
            raise InputError(
                "certificate: begin: expected the day of the calibration, found none, and none in the recording; state "
                "begin and end, or date in [session]"
            )
        return begin, end

    def facts(self, calibration: Calibration) -> tuple[tuple[str, str], ...]:
        """What the first page says of the certificate. Raises InputError without a day of the calibration."""
        first, last = self.days(calibration)
        titled = [(key.title, getattr(self, name)) for name, key in type(self).model_fields.items() if key.title]
        return (
            ("customer", f"{self.customer.name}, {self.customer.address}"),
            ("certificate number", self.number),
            ("calibrated", str(first) if first == last else f"{first} to {last}"),
            ("place", PLACES[self.place]),
            ("state", STATES[self.state]),
            *((title, str(value)) for title, value in titled if title is not None and value is not None),
        )


def check_certificate(certificate: Certificate, calibration: Calibration) -> Calibration | None:
    """Check that a certificate fits the calibration it is of: received before calibrated before issued, every recording
    within the days of the calibration, and as found the same device in the same frame by an earlier recording. Returns
    the calibration from before an adjustment. Raises InputError, one line."""
    begin, end = certificate.days(calibration)
    order = (("received", certificate.received), ("begin", begin), ("end", end), ("issued", certificate.issued))
    stated = [(name, day) for name, day in order if day is not None]
    for (earlier, first), (later, second) in pairwise(stated):
        if second < first:
            raise InputError(f"certificate: {later}: expected a day not before {earlier}, {first}, found {second}")
    recordings = recording_dates(calibration)
    for day in (date.fromisoformat(recorded[:10]) for recorded in recordings):
        if not begin <= day <= end:
            raise InputError(
                f"certificate: begin, end: expected days that hold every recording, found {begin} to {end} and a "
                f"recording of {day}"
            )
    if certificate.as_found is None:
        return None
    as_found = read_calibration(certificate.as_found)
    expected = "certificate: as_found: expected"
    if (as_found.serial, as_found.frame) != (calibration.serial, calibration.frame):
        raise InputError(
            f"{expected} a calibration of device {calibration.serial!r} in the frame {calibration.frame!r}, found "
            f"{as_found.serial!r} in {as_found.frame!r}"
        )
    if as_found.provenance.log_sha256 == calibration.provenance.log_sha256 is not None:
        raise InputError(f"{expected} a calibration from before the adjustment, found one of the same recording")
    before = recording_dates(as_found)
    if before and recordings and max(before) > min(recordings):
        raise InputError(f"{expected} a recording from before that of the result, {recordings[0]}, found {before[-1]}")
    return as_found


def judged_by(certificate: Certificate) -> Limits | None:
    """The acceptance limits of the check that a certificate states conformity with; None without limits. Raises
    InputError where its file has limits of both checks and the certificate does not say which, or none of that."""
    if certificate.limits is None:
        return None
    limits = limits_of(Path(certificate.limits))
    checks = [occasion for occasion in limits.checks if limits.checks[occasion]]
    kept = certificate.check or (checks[0] if len(checks) == 1 else None)
    if kept not in checks:
        both = f"'incoming' or 'periodic', for {certificate.limits} has limits of both"
        expected = both if len(checks) > 1 else f"{checks[0]!r}, whose limits {certificate.limits} has"
        raise InputError(f"certificate: check: expected {expected}, found {'none' if kept is None else repr(kept)}")
    return replace(limits, checks={kept: limits.checks[kept]})


def read_certificate(path: Path) -> Certificate:
    """The administrative part of a certificate from its TOML file, and of the file of the laboratory that it names.
    Paths are relative to the file they stand in. Raises InputError, one line."""
    content = _parsed(path)
    named = content.get("laboratory")
    if isinstance(named, str):
        file = path.parent / named
        content = {"person": [], **_parsed(file), **{key: content[key] for key in content if key != "laboratory"}}
        content["laboratory"] = _with_paths(content.get("laboratory"), "logo", file.parent)
    else:
        content["laboratory"] = _with_paths(named, "logo", path.parent)
    content = _with_paths(_with_paths(content, "as_found", path.parent), "limits", path.parent)
    stated = {key: value for key, value in content.items() if value is not None}
    try:
        return validated(Certificate, stated, str(path))
    except InputError as error:
        raise InputError(f"{error}; see docs/howto/reports.md") from None


def _parsed(path: Path) -> dict[str, Any]:
    return toml_of(text_of_document(path), str(path))


def _with_paths(table: Any, key: str, folder: Path) -> Any:
    """A table with the path under a key taken from a folder."""
    if isinstance(table, dict) and isinstance(table.get(key), str):
        return table | {key: str(folder / table[key])}
    return table
