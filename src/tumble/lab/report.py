"""Reports with acceptance limits, and certificates: what the laboratory adds to `tumble.views.report`.

A report by limits has a section on them after the result. A certificate has laboratory, customer, dates, statements and
signatures beside the result, and no causes and no advice.
"""

from __future__ import annotations

import base64
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal

from tumble.documents import check_regular
from tumble.errors import InputError
from tumble.files import FilePath, ending_in
from tumble.lab.certificate import RELATES, Certificate, Party, check_certificate, judged_by, read_certificate
from tumble.lab.conformity import RESULTS, RISK, RULE, LimitJudgement, Result, Verdict, in_percent, verdicts
from tumble.lab.limits import Limits, limits_of
from tumble.lab.registry.views import TONES
from tumble.lab.scope import statement_of_scope, within_scope
from tumble.result.calibration import Calibration, read_calibration
from tumble.result.coverage import expanded
from tumble.result.further import remarks
from tumble.result.parts import Parameter
from tumble.result.uncertainty_budget import shares_of_priors
from tumble.views.blocks import Block, Document, Letterhead, Part, Section, Signature, Table, Text, section
from tumble.views.numbers import (
    NONE,
    cells,
    degrees,
    device_name,
    factor,
    limit_cell,
    percent,
    quantity_table,
    to_digits_of,
    units_of_values,
)
from tumble.views.report.document import (
    ReportedFile,
    annexes,
    front,
    notes,
    provenance,
    reasons_of,
    report_of,
    sources_of,
    verdict_on,
    write_document,
)
from tumble.views.report.result import Cells, value_blocks, verdict_blocks
from tumble.views.uncertainty_budget import SHOWN

OVER_TEMPERATURE = (
    "Biases and scale factors are judged at the temperature where they are worst, with U there; other parameters are "
    "the same at all temperatures. Beyond what was measured nothing passes."
)
_RULE = f"{RULE[0].upper()}{RULE[1:]}. {RISK[0].upper()}{RISK[1:]}."
_CHECKS = {"incoming": "Incoming inspection", "periodic": "Periodic check"}
_FOR_THE_OPERATOR = ("[", "`", "--", "tumble ", "let ")
"""What only speaks to those who run the program has one of these: keys, commands, options, advice."""


# -------------------- reports by acceptance limits --------------------


def write_judged_report(
    calibrations: Calibration | FilePath | Sequence[Calibration | FilePath], out: FilePath, limits: FilePath
) -> list[str]:
    """Write the report of calibrations of one device with the verdict by acceptance limits.

    Parameters
    ----------
    calibrations
        A calibration or its file, or several of one device.
    out
        The file to write: .html.
    limits
        File with acceptance limits.

    Returns
    -------
    list of str
        Why a calibration is not accepted, and what is not within the limits.

    Raises
    ------
    InputError
        For files that cannot be used.
    MissingExtraError
        Without the extra `tumble[lab]`.
    """
    ending_in(Path(out), ".html")
    acceptance, sources = limits_of(Path(limits)), sources_of(calibrations)
    checks = [verdicts(source.calibration, acceptance) for source in sources]
    document = report_of(sources, [[limits_section(acceptance, each)] for each in checks])
    badge = [(verdict.result, TONES[verdict.result]) for judged in checks for verdict in judged]
    if document.tone != "bad" and all(source.calibration.outcome.accepted for source in sources):
        verdict, tone = min(badge, key=lambda each: RESULTS.index(each[0]))
        document = replace(document, verdict=verdict, tone=tone)
    sentence = f"calibration {verdict_on([source.calibration for source in sources])[0]}"
    facts = (*document.facts, ("verdict", ", ".join([sentence, *_in_words(checks)])))
    write_document(replace(document, facts=facts), out)
    return [*reasons_of(sources), *_not_passed(sources, checks)]


def _in_words(checks: Sequence[Sequence[Verdict]]) -> list[str]:
    """The worst result of each check."""
    worst: dict[str, Result] = {}
    for verdict in (verdict for judged in checks for verdict in judged):
        worst[verdict.occasion] = min(verdict.result, worst.get(verdict.occasion, "pass"), key=RESULTS.index)
    return [f"{occasion} check: {result}" for occasion, result in worst.items()]


def _not_passed(sources: Sequence[ReportedFile], checks: Sequence[Sequence[Verdict]]) -> list[str]:
    """What is not within the limits, each with its file."""
    return [
        f"{source.file}: {verdict.occasion} check: {'; '.join(verdict.reasons)}"
        for source, judged in zip(sources, checks, strict=True)
        for verdict in judged
        if verdict.result != "pass"
    ]


def limits_section(acceptance: Limits, checks: Sequence[Verdict]) -> Section:
    """The decision rule, and every parameter against the limits of all checks with the verdicts."""
    blocks: list[Block] = [f"{_RULE} Limits hold in the frame “{acceptance.frame}”."]
    for verdict in checks:
        reasons = f" ({'; '.join(verdict.reasons)})" if verdict.reasons else ""
        over = f", {verdict.over}" if verdict.over else ""
        sentence = f"{_CHECKS[verdict.occasion]}: {verdict.result}{over}{reasons}.{verdict.whole_risk}"
        blocks.append(Text(text=sentence, tone=TONES[verdict.result]))
        blocks += [OVER_TEMPERATURE] if verdict.temperatures is not None else []
        blocks.append(_judgement_table(verdict))
    return section("Limits and verdict", *blocks)


def _judgement_table(verdict: Verdict) -> Table:
    """Every parameter that has a limit, with the verdict on it."""

    def row(j: LimitJudgement, size: float, unit: str) -> dict[str, str]:
        value, U = cells(j.value, j.expanded, size)
        row = {"low": limit_cell(j.low, size), "value": value, "U": U, "high": limit_cell(j.high, size)}
        row |= {"unit": unit, "verdict": j.result, "risk": in_percent(j.risk)}
        if verdict.temperatures is not None:
            row["at °C"] = "" if j.at is None else f"{j.at:.1f}"
        return row

    sizes = (
        (j.name, size, j.unit)
        for j in verdict.judgements
        for size in (j.value, j.low, j.high)
        if size is not None and math.isfinite(size)
    )
    return quantity_table(verdict.judgements, units_of_values(sizes), row, words=("verdict",))


# -------------------- certificates --------------------


def write_certificate(
    calibrations: Calibration | FilePath | Sequence[Calibration | FilePath], out: FilePath, certificate: FilePath
) -> list[str]:
    """Write the certificate of a calibration.

    Parameters
    ----------
    calibrations
        One calibration or its file.
    out
        The file to write: .html or .pdf.
    certificate
        File with laboratory, customer, dates and statements.

    Returns
    -------
    list of str
        Why the calibration is not accepted, and what is not within the limits that the certificate names.

    Raises
    ------
    InputError
        For files that cannot be used, several calibrations, and a calibration without a date.
    MissingExtraError
        Without the extra `tumble[lab]`.
    """
    ending_in(Path(out), ".html", ".pdf")
    stated, sources = read_certificate(Path(certificate)), sources_of(calibrations)
    acceptance = judged_by(stated)
    if len(sources) > 1:
        raise InputError(f"--certificate: expected one calibration, found {len(sources)}")
    as_found = None if stated.as_found is None else read_calibration(stated.as_found)
    document, checks = certificate_of(sources[0], stated, acceptance, as_found)
    write_document(document, out)
    return [*reasons_of(sources), *_not_passed(sources, [checks])]


def certificate_of(
    source: ReportedFile, certificate: Certificate, acceptance: Limits | None, as_found: Calibration | None
) -> tuple[Document, list[Verdict]]:
    """A certificate as a document, and the verdicts by the limits. No U in it is below the capability of the
    laboratory. Raises InputError where the certificate does not fit the calibration."""
    calibration, scope = within_scope(source.calibration, certificate.laboratory.scope)
    if as_found is not None and (as_found.serial, as_found.frame) != (calibration.serial, calibration.frame):
        raise InputError(
            f"certificate: as_found: expected a calibration of device {calibration.serial!r} in the frame "
            f"{calibration.frame!r}, found {as_found.serial!r} in {as_found.frame!r}"
        )
    check_certificate(certificate, calibration, as_found)
    checks = [] if acceptance is None else verdicts(calibration, acceptance)
    verdict, tone = verdict_on([calibration])
    facts = [*certificate.facts(calibration), *front(calibration, [calibration.method])]
    if acceptance is not None:
        facts.append(("verdict", ", ".join([f"calibration {verdict}", *_in_words([checks])])))
        if calibration.outcome.accepted:
            verdict = min((check.result for check in checks), key=RESULTS.index)
            tone = TONES[verdict]
    sections = _certificate_sections(replace(source, calibration=calibration), acceptance, checks, as_found, scope)
    document = Document(
        title="Calibration certificate",
        device=device_name(calibration.serial, calibration.model),
        tone=tone,
        verdict=verdict,
        facts=tuple(facts),
        created=calibration.provenance.created or "",
        parts=(Part(title="", sections=tuple(each for each in sections if each is not None), customer=1),),
        statements=_statements(certificate, calibration, scope, checks if acceptance is not None else None),
        signatures=tuple(Signature(name=person.name, role=person.role or "") for person in certificate.person),
        closing=f"End of the certificate {certificate.number}",
        number=certificate.number,
        letterhead=letterhead(certificate.laboratory),
    )
    return document, checks


def _certificate_sections(
    source: ReportedFile,
    acceptance: Limits | None,
    checks: Sequence[Verdict],
    as_found: Calibration | None,
    scope: Mapping[str, str],
) -> Iterator[Section | None]:
    """What a certificate states. The limits are in the table of results where they hold at the reference temperature
    in the frame of the calibration, else in a section of their own."""
    calibration = source.calibration
    elsewhere = acceptance is not None and (
        acceptance.frame != calibration.frame or acceptance.temperatures is not None
    )
    shown = _cells(as_found, () if elsewhere else checks, scope)
    pointer = ["Limits, and the verdict on every parameter: section “Limits and verdict”."] if elsewhere else []
    yield section(
        "Result", *verdict_blocks(calibration), *value_blocks(calibration, shown, words=("verdict", "scope")), *pointer
    )
    if elsewhere and acceptance is not None:
        yield limits_section(acceptance, checks)
    kept = [
        "; ".join(clause for clause in note.split("; ") if not any(mark in clause for mark in _FOR_THE_OPERATOR))
        for note in (*calibration.provenance.assumptions, *calibration.provenance.notes)
    ]
    yield notes(*remarks(calibration), *filter(None, kept))
    yield from annexes(calibration, "c", short=True)
    yield provenance(source)


def _cells(as_found: Calibration | None, checks: Sequence[Verdict], scope: Mapping[str, str]) -> Cells:
    """What a certificate says of a parameter beside its value and U: the value as found before an adjustment, coverage
    factor and degrees of freedom, limits and verdict, and what the scope of the accreditation says."""
    judged = {j.name: j for check in checks for j in check.judgements}

    def shown(p: Parameter, size: float) -> dict[str, str]:
        row = {"k": factor(p), "ν": degrees(p)}
        if as_found is not None:
            before = as_found[p.name].value if p.name in as_found else None
            row["as found"] = to_digits_of(before, expanded(p), size)
        if judged:
            j = judged.get(p.name)
            low, high = (math.nan, math.nan) if j is None else (j.low, j.high)
            row |= {"lowest": limit_cell(low, size), "highest": limit_cell(high, size)}
            row |= {"verdict": NONE if j is None else j.result, "risk": in_percent(None if j is None else j.risk)}
        return row | ({"scope": scope.get(p.name, "")} if scope else {})

    return shown


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


def _statements(
    certificate: Certificate, calibration: Calibration, scope: Mapping[str, str], checks: Sequence[Verdict] | None
) -> tuple[str, ...]:
    """What stands above the signatures: by which rule the `checks` were judged, what priors rest on, traceability, the
    `scope` of the accreditation, remarks, and what it all relates to."""
    agreed = f" Agreed beforehand: {certificate.agreed}." if certificate.agreed else ""
    rule = "" if checks is None else f"{_RULE}{agreed}{''.join(check.whole_risk for check in checks)}"
    traced = f"Traceability: {'; '.join(certificate.traceability)}." if certificate.traceability else ""
    within = f"{statement_of_scope(scope)}." if certificate.laboratory.scope else ""
    priors = statement_of_priors(calibration)
    return tuple(each for each in (rule, priors, traced, within, *certificate.remarks, RELATES) if each)


def statement_of_priors(calibration: Calibration) -> str:
    """What the sizes of priors rest on, and their share of u² by group of parameters; nothing without any."""
    clauses = []
    for basis, shares in shares_of_priors(calibration).items():
        largest = sorted(((share, group) for group, share in shares.items() if share >= SHOWN), reverse=True)
        if largest:
            clauses.append(f"by the {basis}: {', '.join(f'{percent(share)} of {group}' for share, group in largest)}")
    return (
        "Part of u² (mean over the parameters of a group) is not measured, but what instruments of the kind usually "
        f"have, {'; '.join(clauses)}."
        if clauses
        else ""
    )
