"""What a certificate adds to a report: the laboratory, the customer, dates, statements and signatures."""

from __future__ import annotations

import base64
from pathlib import Path
from typing import Literal

from tumble.acceptance.certificate import RELATES, STATES, Certificate, Party
from tumble.acceptance.conformity import RULE
from tumble.documents import check_regular
from tumble.errors import InputError
from tumble.recording.circumstances import Circumstances
from tumble.result.calibration import Calibration
from tumble.views.blocks import Letterhead, Signature
from tumble.views.numbers import fixed, significant

_PLACES = {
    "laboratory": "laboratory",
    "customer": "at the customer's",
    "laboratoryBranch": "branch of the laboratory",
    "customerBranch": "branch of the customer",
    "other": "elsewhere",
}


def letterhead(laboratory: Party) -> Letterhead:
    """Name, address, accreditation number and logo. Raises InputError for a logo that is none."""
    lines = [laboratory.address]
    lines += [laboratory.email] if laboratory.email else []
    lines += [f"accreditation {laboratory.code}"] if laboratory.code else []
    if laboratory.logo is None:
        return Letterhead(name=laboratory.name, lines=tuple(lines))
    try:
        check_regular(Path(laboratory.logo))
        logo = Path(laboratory.logo).read_bytes()
    except OSError as error:
        raise InputError(f"{laboratory.logo}: expected a logo: {error.strerror}") from None
    kind: Literal["svg", "png"] = "svg" if laboratory.logo.endswith(".svg") else "png"
    if {"svg": b"<svg", "png": b"\x89PNG"}[kind] not in logo:
        raise InputError(f"{laboratory.logo}: expected a picture in {kind.upper()}, found another file")
    return Letterhead(
        name=laboratory.name, lines=tuple(lines), logo=base64.b64encode(logo).decode("ascii"), logo_type=kind
    )


def facts(certificate: Certificate, calibration: Calibration) -> tuple[tuple[str, str], ...]:
    """Customer, number, dates, place, state and procedure. Raises InputError without a day of the calibration."""
    first, last = certificate.days(calibration)
    optional = (
        ("replaces certificate", certificate.replaces),
        ("received", None if certificate.received is None else certificate.received.isoformat()),
        ("issued", None if certificate.issued is None else certificate.issued.isoformat()),
        ("procedure", certificate.procedure),
    )
    return (
        ("customer", f"{certificate.customer.name}, {certificate.customer.address}"),
        ("certificate number", certificate.number),
        ("calibrated", first.isoformat() if first == last else f"{first.isoformat()} to {last.isoformat()}"),
        ("place", _PLACES[certificate.place]),
        ("state", STATES[certificate.state]),
        *((name, value) for name, value in optional if value is not None),
    )


def circumstances(given: Circumstances) -> tuple[tuple[str, str], ...]:
    """The air, the operator and the equipment, as far as they are known."""
    air = given.air
    found = []
    if air.temperature is not None:
        u = "" if air.temperature_u is None else f", U = {significant(2.0 * air.temperature_u, 2)} °C (k = 2)"
        found.append(("air temperature", f"{fixed(air.temperature, 1)} °C{u}"))
    if air.humidity is not None:
        found.append(("relative humidity", f"{significant(air.humidity, 3)} %"))
    if air.pressure is not None:
        found.append(("air pressure", f"{significant(air.pressure, 5)} hPa"))
    if given.operator is not None:
        found.append(("operator", given.operator))
    if given.equipment:
        found.append(("equipment", "; ".join(given.equipment)))
    return tuple(found)


def statements(certificate: Certificate | None, *, judged: bool) -> tuple[str, ...]:
    """What stands above the signatures: by which rule limits were `judged`, traceability, what it all relates to."""
    said = f"{RULE[0].upper()}{RULE[1:]}." if judged else ""
    if certificate is None:
        return tuple(each for each in (said, "The results relate only to the item named above.") if each)
    said += f" Agreed beforehand: {certificate.agreed}." if judged and certificate.agreed else ""
    traced = f"Traceability: {'; '.join(certificate.traceability)}." if certificate.traceability else ""
    return tuple(each for each in (said, traced, *certificate.remarks, RELATES) if each)


def signatures(certificate: Certificate | None) -> tuple[Signature, ...]:
    """The lines to sign on: those who answer for a certificate."""
    if certificate is None:
        return tuple(Signature(name=name) for name in ("Calibrated by", "Approved by", "Date"))
    return tuple(Signature(name=person.name, role=person.role or "") for person in certificate.person)
