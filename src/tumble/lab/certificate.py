"""Administrative data of a calibration certificate, read from a TOML file (docs/howto/reports.md has every key).

number = "2026-0042"            # unique, stands on every page
country = "DE"                  # where the certificate is issued, ISO 3166-1
laboratory = "laboratory.toml"  # a file with [laboratory] and [[person]]; or the table [laboratory] itself

[customer]
name = "A customer"
city = "Perm"
country = "RU"
"""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, date, datetime, timedelta
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator

from tumble.advice import found_in
from tumble.documents import is_plain, shown, text_of_document, toml_of, validated
from tumble.errors import InputError
from tumble.lab.limits import Limits, Occasion, read_limits
from tumble.result.calibration import Calibration, read_calibration
from tumble.result.further import recording_dates, remarks
from tumble.result.parts import SERIAL_NOT_STATED

SCOPE_STATEMENT = (
    "This certificate relates only to the item described in it, in the state in which it was calibrated; it may be "
    "reproduced only as a whole, unless the laboratory agrees in writing."
)
STATES: Mapping[str, str] = {
    "as-found": "as found: calibrated before any adjustment",
    "as-left": "as left: calibrated after adjustment",
    "unchanged": "not adjusted: as found and as left",
}
"""States of the item when it was calibrated."""
Place = Literal["laboratory", "customer", "laboratoryBranch", "customerBranch", "other"]
PLACES: Mapping[Place, str] = {
    "laboratory": "laboratory",
    "customer": "at the customer's",
    "laboratoryBranch": "branch of the laboratory",
    "customerBranch": "branch of the customer",
    "other": "elsewhere",
}
"""Places of calibration."""


def _without_control_characters(text: str) -> str:
    if not is_plain(text.replace("\n", " ").replace("\t", " ")):
        raise ValueError(f"expected no control characters, found {shown(text)}")
    return text


_Str = Annotated[str, AfterValidator(_without_control_characters)]
_Text = Annotated[_Str, Field(pattern=r"^\S+(\s+\S+)*$")]
_Country = Annotated[_Str, Field(pattern="^[A-Z]{2}$", description="two capital letters of ISO 3166-1, such as 'DE'")]
_Path = Annotated[_Str, Field(min_length=1)]

_ACCREDITED = ("procedure", "traceability", "issued")
"""Keys required in a certificate under accreditation (ISO/IEC 17025, 7.8)."""


class _CertificateTable(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)


class Party(_CertificateTable):
    """A laboratory or a customer. `code` is the accreditation number of a laboratory, `logo` the path of its
    picture."""

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
    """A person who signs a certificate."""

    name: _Text
    role: _Text | None = None


class Certificate(_CertificateTable):
    """Administrative data of a calibration certificate.

    Without `begin` and `end` the date is that of the recording. `state` is that of the item when it was calibrated,
    `as_found` the calibration file from before an adjustment. `limits` is a file of acceptance limits, `check` selects
    one of its checks, `agreed` is the agreement on limits and decision rule, `traceability` that of gravity, time and
    table; `changed` is what the laboratory states on a device that changed while it was recorded; `replaces` is the
    number of an earlier certificate. Keys with a title are shown on the first page."""

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
    changed: _Text | None = None
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
        """Return the first and the last day of the calibration, by default those of the recordings.

        Raises InputError if neither is known."""
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
        """Return titles and texts for the first page. Raises InputError if the day of calibration is not known."""
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


def for_reader(sentence: str) -> str:
    """Return a sentence of a calibration for the reader of a certificate: what was found, without what to do."""
    return found_in(sentence).replace("probable cause: ", "what would explain the residuals: ")


def statements_of_result(calibration: Calibration, *first: str) -> list[str]:
    """Return the `first` sentences and what else bears on the use of a result, for the reader of a certificate."""
    origin = calibration.provenance
    return [*filter(None, map(for_reader, (*first, *remarks(calibration), *origin.assumptions, *origin.notes)))]


def check_certificate(certificate: Certificate, calibration: Calibration) -> Calibration | None:
    """Check that a certificate is consistent with its calibration.

    The item must be received before it is calibrated and calibrated before the certificate is issued, all recordings
    must be within the days of the calibration, scale factors in SI, and a change of the device needs a statement. The
    calibration as found must be of the same device, in the same frame and recorded earlier; it is returned, None
    without. Raises InputError."""
    if any(note.startswith(SERIAL_NOT_STATED) for note in calibration.provenance.notes):
        raise InputError(
            f"certificate: expected the serial number of the device, found {calibration.serial!r}, the name of the "
            "table of its readings; calibrate again with --serial"
        )
    site = calibration.provenance.site
    if calibration.accel is not None and site is not None and site.gravity_is_unit:
        raise InputError(
            "certificate: expected scale factors in SI, found gravity at the place of the readings as their unit, "
            "which differs by up to 0.3 %; calibrate again with --gravity and --gravity-u"
        )
    if calibration.outcome.unsteady and certificate.changed is None:
        raise InputError(
            "certificate: changed: expected a statement under this key on a device that changed while it was recorded, "
            f"found none, and: {calibration.outcome.unsteady[0]}"
        )
    begin, end = certificate.days(calibration)
    today = datetime.now(UTC).date() + timedelta(days=1)  # a day for time zones
    if certificate.issued is not None and certificate.issued > today:
        raise InputError(f"certificate: issued: expected a day that is not in the future, found {certificate.issued}")
    order = (("received", certificate.received), ("begin", begin), ("end", end), ("issued", certificate.issued))
    stated = [(name, day) for name, day in order if day is not None]
    for (earlier, first), (later, second) in pairwise(stated):
        if second < first:
            raise InputError(f"certificate: {later}: expected a day not before {earlier}, {first}, found {second}")
    recordings = recording_dates(calibration)
    for day in (date.fromisoformat(moment[:10]) for moment in recordings):
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
    log = calibration.provenance.log_sha256
    if log is not None and as_found.provenance.log_sha256 == log:
        raise InputError(f"{expected} a calibration from before the adjustment, found one of the same recording")
    before = recording_dates(as_found)
    if before and recordings and max(before) > min(recordings):
        raise InputError(f"{expected} a recording from before that of the result, {recordings[0]}, found {before[-1]}")
    return as_found


def certificate_limits(certificate: Certificate) -> Limits | None:
    """Return the acceptance limits, of one check, for the statement of conformity of a certificate; None without
    limits.

    Raises InputError if the file has limits of both checks and the certificate selects none, or selects another one."""
    if certificate.limits is None:
        return None
    limits = read_limits(Path(certificate.limits))
    checks = limits.checks
    selected = certificate.check or (checks[0] if len(checks) == 1 else None)
    if selected not in checks:
        both = f"'incoming' or 'periodic', for {certificate.limits} has limits of both"
        expected = both if len(checks) > 1 else f"{checks[0]!r}, whose limits {certificate.limits} has"
        raise InputError(f"certificate: check: expected {expected}, found {repr(selected) if selected else 'none'}")
    return limits.model_copy(update={other: {} for other in checks if other != selected})


def read_certificate(path: Path) -> Certificate:
    """Read the data of a certificate from its TOML file and the file of the laboratory that it names.

    Paths are relative to the file in which they are written. Raises InputError."""
    content = toml_of(text_of_document(path), str(path))
    named, laboratory_folder = content.get("laboratory"), path.parent
    if isinstance(named, str):
        file = path.parent / named
        laboratory = toml_of(text_of_document(file), str(file))
        content = {"person": [], **laboratory, **{key: content[key] for key in content if key != "laboratory"}}
        laboratory_folder = file.parent
    content["laboratory"] = _resolve_path(content.get("laboratory"), "logo", laboratory_folder)
    content = _resolve_path(_resolve_path(content, "as_found", path.parent), "limits", path.parent)
    stated = {key: value for key, value in content.items() if value is not None}
    try:
        return validated(Certificate, stated, str(path))
    except InputError as error:
        raise InputError(f"{error}; see docs/howto/reports.md") from None


def _resolve_path(table: Any, key: str, folder: Path) -> Any:
    """Return a table with the path under a key taken relative to a folder."""
    if isinstance(table, dict) and isinstance(table.get(key), str):
        return table | {key: str(folder / table[key])}
    return table
