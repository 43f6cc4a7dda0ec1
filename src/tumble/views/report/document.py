"""A report or a certificate as a document: the result first, then how it is applied, then what it rests on; of a
certificate also laboratory, customer, dates, statements and signatures."""

from __future__ import annotations

import base64
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

from tumble.documents import check_regular
from tumble.errors import InputError
from tumble.lab.certificate import RELATES, STATES, Certificate, Party, check_certificate, recorded_on
from tumble.lab.conformity import RESULTS, RULE, Result, Verdict, verdicts
from tumble.lab.limits import Limits
from tumble.lab.scope import statement_of_scope, within_scope
from tumble.result import further
from tumble.result.calibration import Calibration
from tumble.views.blocks import Document, Facts, Items, Letterhead, Part, Section, Signature, Tone, section
from tumble.views.numbers import NONE, device_name, fixed, significant
from tumble.views.registry import TONES
from tumble.views.report import application, over_temperature, recording, result
from tumble.views.uncertainty_budget import budget_section

_MOST_MOMENTS = 3
"""Of more recordings only the days are listed."""
_FOR_THE_OPERATOR = ("[", "`", "--", "tumble ", "let ")
"""What only speaks to those who run the program has one of these: keys, commands, options, advice."""
_PLACES = {
    "laboratory": "laboratory",
    "customer": "at the customer's",
    "laboratoryBranch": "branch of the laboratory",
    "customerBranch": "branch of the customer",
    "other": "elsewhere",
}


@dataclass(frozen=True, kw_only=True, slots=True)
class ReportedFile:
    """A calibration with the name of its file and the SHA-256 of what was read from it; of a certificate what the scope
    of the accreditation says of its parameters, by name."""

    file: str
    sha256: str
    calibration: Calibration
    scope: Mapping[str, str] = field(default_factory=dict)


def as_certified(source: ReportedFile, certificate: Certificate) -> ReportedFile:
    """A calibration as the certificate states it: no U is below the capability of the laboratory."""
    stated, scope = within_scope(source.calibration, certificate.laboratory.scope)
    return replace(source, calibration=stated, scope=scope)


def document(
    sources: Sequence[ReportedFile],
    acceptance: Limits | None = None,
    certificate: Certificate | None = None,
    as_found: Calibration | None = None,
) -> Document:
    """The report of calibrations of one device, or the `certificate` of one of them, where it was adjusted with the
    calibration `as_found`. Raises InputError where they are of several devices, and for a certificate of several
    calibrations or without a date."""
    calibrations = [source.calibration for source in sources]
    first, several = calibrations[0], len(sources) > 1
    for source in sources[1:]:
        if source.calibration.serial != first.serial:
            raise InputError(
                f"{source.file}: expected a calibration of device {first.serial!r} like {sources[0].file}, "
                f"found {source.calibration.serial!r}; make a report for each device"
            )
    if certificate is not None and several:
        raise InputError(f"--certificate: expected one calibration, found {len(sources)}")
    if as_found is not None and (as_found.serial, as_found.frame) != (first.serial, first.frame):
        raise InputError(
            f"certificate: as_found: expected a calibration of device {first.serial!r} in the frame "
            f"{first.frame!r}, found {as_found.serial!r} in {as_found.frame!r}"
        )
    if certificate is not None:
        check_certificate(certificate, first, as_found)
    titles = [calibration.method for calibration in calibrations]  # else by a number and the date of the recording
    if len(set(titles)) < len(titles):
        dates = [(calibration.circumstances.date or "")[:10] for calibration in calibrations]
        titles = [f"{i}: {name} {day}".rstrip() for i, (name, day) in enumerate(zip(titles, dates, strict=True), 1)]
    checks = [() if acceptance is None else tuple(verdicts(each, acceptance)) for each in calibrations]
    parts, customer = [], 0 if several else 1
    if several:
        parts.append(Part(title="Comparison", sections=(result.compared(titles, calibrations, "compared"),)))
    for i, (source, judged, title) in enumerate(zip(sources, checks, titles, strict=True), 1):
        if certificate is None:
            made = _for_the_laboratory(source, acceptance, judged, f"c{i}")
        else:
            made = _for_customers(source, acceptance, judged, as_found, f"c{i}")
        sections = tuple(each for each in made if each is not None)
        parts.append(Part(title=title if several else "", sections=sections, customer=customer))
    badge, tone, verdict = _verdict(calibrations, checks)
    facts = (*_front(first, titles), *((("verdict", verdict),) if acceptance is not None else ()))
    signed_by, closing = [Signature(name=name) for name in ("Calibrated by", "Approved by", "Date")], "the report"
    if certificate is not None:
        facts, closing = (*_certified(certificate, first), *facts), f"the certificate {certificate.number}"
        signed_by = [Signature(name=person.name, role=person.role or "") for person in certificate.person]
    return Document(
        title="Calibration report" if certificate is None else "Calibration certificate",
        device=device_name(first.serial, first.model),
        tone=tone,
        verdict=badge,
        facts=facts,
        created=max(calibration.provenance.get("created", "") for calibration in calibrations),
        parts=tuple(parts),
        statements=_statements(certificate, sources[0].scope, judged=acceptance is not None),
        signatures=tuple(signed_by),
        closing=f"End of {closing}",
        number="" if certificate is None else certificate.number,
        letterhead=None if certificate is None else letterhead(certificate.laboratory),
    )


def _verdict(calibrations: Sequence[Calibration], checks: Sequence[Sequence[Verdict]]) -> tuple[str, Tone, str]:
    """The worst verdict, with its colour: of the checks where there are limits, else whether the calibrations are
    accepted; and both in a few words."""
    outcomes = [calibration.outcome for calibration in calibrations]
    if not all(outcome.accepted for outcome in outcomes):
        *of_kinds, _ = further.verdicts(calibrations[0])
        if not of_kinds or len(calibrations) > 1:
            return "not accepted", "bad", "not accepted"
        return "; ".join(of_kinds), "doubt", "not accepted"
    remarked = any(outcome.remarks for outcome in outcomes)
    accepted = "accepted with scatter" if remarked else "accepted"
    worst: dict[str, Result] = {}
    for check in (check for judged in checks for check in judged):
        worst[check.occasion] = min(check.result, worst.get(check.occasion, "pass"), key=RESULTS.index)
    each = (f"{occasion} check: {of_check}" for occasion, of_check in worst.items())
    both = ", ".join([f"calibration {accepted}", *each])
    if not worst:
        return accepted, "doubt" if remarked else "good", both
    badge = min(worst.values(), key=RESULTS.index)
    return badge, TONES[badge], both


def not_accepted(sources: Sequence[ReportedFile], acceptance: Limits | None) -> list[str]:
    """Why a calibration is not accepted or not within limits, each with its file."""
    reasons = [f"{source.file}: {reason}" for source in sources for reason in source.calibration.outcome.reasons]
    for source in sources:
        for verdict in () if acceptance is None else verdicts(source.calibration, acceptance):
            if verdict.result != "pass":
                reasons.append(f"{source.file}: {verdict.occasion} check: {'; '.join(verdict.reasons())}")
    return reasons


# -------------------- the sections --------------------


def _for_the_laboratory(
    source: ReportedFile, acceptance: Limits | None, checks: Sequence[Verdict], key: str
) -> Iterator[Section | None]:
    """Everything that is known of a calibration; `key` begins the names of its figures."""
    calibration, recordings = source.calibration, recording.recordings(source.calibration)
    yield result.result(calibration, acceptance, checks)
    yield result.beyond(calibration)
    yield result.unknown(calibration)
    yield over_temperature.section(calibration, f"{key}-temperature")
    yield result.limits(calibration, acceptance, checks)
    yield _notes(*further.remarks(calibration), *calibration.notes)
    yield result.launches(calibration)
    yield application.application(calibration)
    yield application.frame(calibration, f"{key}-frame")
    yield recording.site(recordings)
    yield from (recording.found(each, f"{key}-sphere{i}") for i, each in enumerate(recordings))
    yield from (recording.residuals(each, f"{key}-residuals{i}") for i, each in enumerate(recordings))
    yield budget_section(calibration, f"{key}-budget")
    yield result.correlations(calibration)
    yield result.convergence(calibration, f"{key}-convergence")
    yield from (recording.noise(each, f"{key}-noise{i}") for i, each in enumerate(recordings))
    yield _provenance(source)


def _for_customers(
    source: ReportedFile,
    acceptance: Limits | None,
    checks: Sequence[Verdict],
    as_found: Calibration | None,
    key: str,
) -> Iterator[Section | None]:
    """What a certificate states: results and how they are applied, conformity, what was measured, and where all of it
    is as data; no causes and no advice."""
    calibration, recordings = source.calibration, recording.recordings(source.calibration)
    advised = [
        "; ".join(clause for clause in note.split("; ") if not any(mark in clause for mark in _FOR_THE_OPERATOR))
        for note in calibration.notes
    ]
    yield result.result(calibration, acceptance, checks, as_found, certified=True, scope=source.scope)
    yield result.limits(calibration, acceptance, checks) if result.limits_elsewhere(calibration, acceptance) else None
    yield _notes(*further.remarks(calibration), *filter(None, advised))
    yield result.launches(calibration)
    yield result.beyond(calibration, for_customers=True)
    yield over_temperature.section(calibration, f"{key}-temperature")
    yield application.application(calibration)
    yield application.frame(calibration, f"{key}-frame")
    if any(each.recorded.site != recordings[0].recorded.site for each in recordings):
        yield recording.site(recordings)
    yield from (recording.measured(each) for each in recordings)
    yield budget_section(calibration)
    yield result.correlations(calibration)
    yield _provenance(source)


def _notes(*notes: str) -> Section | None:
    """What is to be known of the recording and of U."""
    return section("Notes", Items(items=notes)) if notes else None


def _provenance(source: ReportedFile) -> Section:
    provenance = source.calibration.provenance
    rows = (
        ("data annex", f"the calibration file {source.file}: all values, u, k, ν and covariances in SI"),
        ("its SHA-256", source.sha256),
        ("SHA-256 of the log" + ("s" if source.calibration.launches else ""), provenance.get("log_sha256", NONE)),
        ("software", provenance.get("software", NONE)),
        ("computed", _in_words(provenance.get("created", NONE))),
        ("method", source.calibration.method),
    )
    return section("Provenance", Facts(rows=rows))


# -------------------- the first page --------------------


def _in_words(moment: str) -> str:
    """A moment by ISO 8601 as it is read."""
    return moment.replace("T", " ").replace("+00:00", " UTC")


def _front(first: Calibration, titles: Sequence[str]) -> tuple[tuple[str, str], ...]:
    """The device; of a single calibration also when, where and how it was recorded, the air, the operator and the
    equipment, as far as they are known."""
    rows = [("serial number", first.serial), ("model", first.model or NONE)]
    if len(titles) > 1:
        return (*rows, ("calibrations", ", ".join(titles)))
    recordings, moments = recording.recordings(first), recorded_on(first)  # never when it was computed
    if len(moments) > _MOST_MOMENTS:
        moments = list(dict.fromkeys(moment[:10] for moment in moments))
    rows += [
        ("recorded", ", ".join(map(_in_words, moments)) or "date not stated"),
        ("method", f"{first.method}, frame “{first.frame}”"),
        ("programme", first.programme or "none"),
        ("launches", str(len(recordings))),
        *(recording.site_facts(recordings[0].recorded.site) if first.site is not None else ()),
        ("temperature", recording.temperature(recordings)),
    ]
    given, air = first.circumstances, first.circumstances.conditions
    if air.temperature_degC is not None:
        u = "" if air.temperature_u is None else f", U = {significant(2.0 * air.temperature_u, 2)} °C (k = 2)"
        rows.append(("air temperature", f"{fixed(air.temperature_degC, 1)} °C{u}"))
    if air.humidity_percent is not None:
        rows.append(("relative humidity", f"{significant(air.humidity_percent, 3)} %"))
    if air.pressure_hPa is not None:
        rows.append(("air pressure", f"{significant(air.pressure_hPa, 5)} hPa"))
    if given.operator is not None:
        rows.append(("operator", given.operator))
    return (*rows, *((("equipment", "; ".join(given.equipment)),) if given.equipment else ()))


def _certified(certificate: Certificate, calibration: Calibration) -> tuple[tuple[str, str], ...]:
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
    picture = base64.b64encode(logo).decode("ascii")
    return Letterhead(name=laboratory.name, lines=tuple(lines), logo=picture, logo_type=kind)


def _statements(certificate: Certificate | None, said: Mapping[str, str], *, judged: bool) -> tuple[str, ...]:
    """What stands above the signatures: by which rule limits were `judged`, traceability, what is `said` of the scope,
    and what it all relates to."""
    rule = f"{RULE[0].upper()}{RULE[1:]}." if judged else ""
    if certificate is None:
        return (*([rule] if rule else []), "The results relate only to the item named above.")
    rule += f" Agreed beforehand: {certificate.agreed}." if judged and certificate.agreed else ""
    traced = f"Traceability: {'; '.join(certificate.traceability)}." if certificate.traceability else ""
    scope = f"{statement_of_scope(said)}." if certificate.laboratory.scope else ""
    return tuple(each for each in (rule, traced, scope, *certificate.remarks, RELATES) if each)
