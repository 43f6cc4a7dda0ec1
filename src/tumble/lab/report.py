"""Reports with acceptance limits, and certificates.

Both have a section on the limits after the result. A certificate also has laboratory, customer, dates, statements and
signatures, but no causes and no advice.
"""

from __future__ import annotations

import base64
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Literal

from tumble.documents import check_regular
from tumble.errors import InputError
from tumble.files import FilePath, ending_in
from tumble.lab.certificate import (
    SCOPE_STATEMENT,
    Party,
    certificate_limits,
    check_certificate,
    for_reader,
    read_certificate,
    statements_of_result,
)
from tumble.lab.conformity import (
    DECISION_RULE,
    RESULTS_WORST_FIRST,
    RISK_DEFINITION,
    LimitJudgement,
    Result,
    Verdict,
    judge_calibration,
    risk_text,
)
from tumble.lab.limits import Limits, read_limits
from tumble.result.accepted import accepted_kinds
from tumble.result.calibration import Calibration
from tumble.result.further import recording_dates
from tumble.result.parts import Parameter
from tumble.result.uncertainty_budget import shares_of_priors
from tumble.views.blocks import Block, Document, Letterhead, Part, Section, Signature, Text, Tone, section
from tumble.views.numbers import (
    cells,
    degrees,
    device_name,
    factor,
    limit_cell,
    percent,
    quantity_table,
    units_of_values,
    with_expanded,
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
from tumble.views.report.result import value_blocks, verdict_blocks
from tumble.views.uncertainty_budget import MIN_SHARE

TONES: Mapping[Result, Tone] = {
    "pass": "good",
    "conditional pass": "doubt",
    "conditional fail": "bad",
    "undecided": "bad",
    "fail": "bad",
}
"""Tone of each result of a check."""
_RULE = f"{DECISION_RULE[0].upper()}{DECISION_RULE[1:]}. {RISK_DEFINITION[0].upper()}{RISK_DEFINITION[1:]}."
_CHECKS = {"incoming": "Incoming inspection", "periodic": "Periodic check"}


def write_judged_report(
    calibrations: Calibration | FilePath | Sequence[Calibration | FilePath], out: FilePath, limits: FilePath
) -> list[str]:
    """Write the report of calibrations of one device into an .html file, with verdicts by a file of acceptance limits.

    Returns the reasons why calibrations are not accepted or not within the limits. Raises InputError for files that
    cannot be used, MissingExtraError without the extra `tumble[lab]`."""
    ending_in(Path(out), ".html")
    acceptance, sources = read_limits(Path(limits)), sources_of(calibrations)
    checks = [judge_calibration(source.calibration, acceptance) for source in sources]
    document = report_of(sources, [[limits_section(acceptance, verdicts)] for verdicts in checks])
    return _write(document, out, sources, checks)


def write_certificate(
    calibrations: Calibration | FilePath | Sequence[Calibration | FilePath], out: FilePath, certificate: FilePath
) -> list[str]:
    """Write the certificate of one calibration into an .html or .pdf file; `certificate` is the file of its laboratory,
    customer, dates and statements.

    Returns the reasons why the calibration is not accepted or not within the limits that the certificate names. Raises
    InputError for files that cannot be used, several calibrations, and a calibration without a date, MissingExtraError
    without the extra `tumble[lab]`."""
    ending_in(Path(out), ".html", ".pdf")
    stated, sources = read_certificate(Path(certificate)), sources_of(calibrations)
    acceptance = certificate_limits(stated)
    if len(sources) > 1:
        raise InputError(f"--certificate: expected one calibration, found {len(sources)}")
    calibration = sources[0].calibration
    as_found = check_certificate(stated, calibration)
    checks = [] if acceptance is None else judge_calibration(calibration, acceptance)
    verdict, tone = verdict_on([calibration])
    laboratory = stated.laboratory
    if not accepted_kinds(calibration):  # values that must not be used are not certified under accreditation
        laboratory = laboratory.model_copy(update={"code": None})
    # above the signatures: decision rule, basis of the priors, traceability, remarks, scope
    agreed = f" Agreed beforehand: {stated.agreed}." if stated.agreed else ""
    rule = f"{_RULE}{agreed}{''.join(check.risk_sentence for check in checks)}" if stated.limits else ""
    traced = f"Traceability: {'; '.join(stated.traceability)}." if stated.traceability else ""
    statements = (rule, statement_of_priors(calibration), traced, stated.changed, *stated.remarks, SCOPE_STATEMENT)
    document = Document(
        title="Calibration certificate",
        device=device_name(calibration.serial, calibration.model),
        tone=tone,
        verdict=verdict,
        facts=(*stated.facts(calibration), *front(calibration, [calibration.method])),
        created=calibration.provenance.created or "",
        parts=(Part(title="", sections=(*_sections(sources[0], acceptance, checks, as_found),), customer=1),),
        statements=tuple(filter(None, statements)),
        signatures=tuple(Signature(name=person.name, role=person.role or "") for person in stated.person),
        closing=f"End of the certificate {stated.number}",
        number=stated.number,
        letterhead=letterhead(laboratory),
    )
    return _write(document, out, sources, [checks])


def _write(
    document: Document, out: FilePath, sources: Sequence[ReportedFile], checks: Sequence[Sequence[Verdict]]
) -> list[str]:
    """Write a document with the worst verdict as the badge on its first page, and return, by file, why calibrations are
    not accepted or not within the limits."""
    worst: dict[str, Result] = {}
    for verdict in chain(*checks):
        worst[verdict.occasion] = min(
            verdict.result, worst.get(verdict.occasion, "pass"), key=RESULTS_WORST_FIRST.index
        )
    if worst:
        results = (f"{occasion} check: {result}" for occasion, result in worst.items())
        fact = ("verdict", ", ".join([f"calibration {document.verdict}", *results]))
        document = replace(document, facts=(*document.facts, fact))
        if all(source.calibration.outcome.accepted for source in sources):
            result = min(worst.values(), key=RESULTS_WORST_FIRST.index)
            document = replace(document, verdict=result, tone=TONES[result])
    write_document(document, out)
    return reasons_of(sources) + [
        f"{source.file}: {verdict.occasion} check: {'; '.join(verdict.reasons)}"
        for source, verdicts in zip(sources, checks, strict=True)
        for verdict in verdicts
        if verdict.result != "pass"
    ]


def limits_section(acceptance: Limits, checks: Sequence[Verdict]) -> Section:
    """Return the section with the decision rule and the verdicts on all parameters that have limits."""
    blocks: list[Block] = [f"{_RULE} Limits hold in the frame “{acceptance.frame}”."]

    def row(j: LimitJudgement, size: float, unit: str) -> dict[str, str]:
        value, U = cells(j.value, j.expanded, size)
        row = {"low": limit_cell(j.low, size), "value": value, "U": U, "high": limit_cell(j.high, size)}
        return row | {"unit": unit, "verdict": j.result, "risk": risk_text(j.risk)}

    for verdict in checks:
        reasons = f" ({'; '.join(verdict.reasons)})" if verdict.reasons else ""
        sentence = f"{_CHECKS[verdict.occasion]}: {verdict.result}{reasons}.{verdict.risk_sentence}"
        sizes = ((j.name, size, j.unit) for j in verdict.judgements for size in (j.value, j.low, j.high))
        units = units_of_values(
            (name, size, unit) for name, size, unit in sizes if size is not None and math.isfinite(size)
        )
        table = quantity_table(verdict.judgements, units, row, words=("verdict",))
        blocks += [Text(text=sentence, tone=TONES[verdict.result]), table]
    return section("Limits and verdict", *blocks)


# -------------------- certificates --------------------


def _sections(
    source: ReportedFile, acceptance: Limits | None, checks: Sequence[Verdict], as_found: Calibration | None
) -> Iterator[Section]:
    """Yield the sections of a certificate. Its table of parameters adds coverage factor, degrees of freedom and the
    value as found with its U."""
    calibration = source.calibration

    def extra_columns(p: Parameter, size: float) -> dict[str, str]:
        row = {"k": factor(p), "ν": degrees(p)}
        if as_found is not None:
            before = with_expanded(as_found[p.name], size) if p.name in as_found else ("", "")
            row |= dict(zip(("as found", "U as found"), before, strict=True))
        return row

    found = list[str]()
    if as_found is not None:
        days = list(dict.fromkeys(moment[:10] for moment in recording_dates(as_found)))
        judged = [] if acceptance is None else judge_calibration(as_found, acceptance)
        verdicts = [verdict_on([as_found])[0]]
        verdicts += [f"{each.occasion} check: {'; '.join(each.reasons) or each.result}" for each in judged]
        recorded = f"recorded {' and '.join(days)}" if days else "recorded on a day that is not stated"
        found.append(f"As found: {recorded}, method {as_found.method}; {', '.join(verdicts)}.")
    yield section("Result", *verdict_blocks(calibration, for_reader), *value_blocks(calibration, extra_columns), *found)
    if acceptance is not None:
        yield limits_section(acceptance, checks)
    yield from filter(None, (notes(*statements_of_result(calibration)), *annexes(calibration, "c", short=True)))
    yield provenance(source)


def letterhead(laboratory: Party) -> Letterhead:
    """Return the letterhead of a laboratory. Raises InputError if its logo is not a picture."""
    accreditation = f"accreditation {laboratory.code}" if laboratory.code else None
    lines = tuple(filter(None, (laboratory.address, laboratory.email, accreditation)))
    if laboratory.logo is None:
        return Letterhead(name=laboratory.name, lines=lines)
    try:
        check_regular(Path(laboratory.logo))
        logo = Path(laboratory.logo).read_bytes()
    except OSError as error:
        raise InputError(f"{laboratory.logo}: expected a logo: {error.strerror}") from None
    kind: Literal["svg", "png"] = "svg" if laboratory.logo.endswith(".svg") else "png"
    if {"svg": b"<svg", "png": b"\x89PNG"}[kind] not in logo:
        raise InputError(f"{laboratory.logo}: expected a picture in {kind.upper()}, found another file")
    picture = base64.b64encode(logo).decode("ascii")
    return Letterhead(name=laboratory.name, lines=lines, logo=picture, logo_type=kind)


def statement_of_priors(calibration: Calibration) -> str:
    """Return a sentence on the basis of the priors and their shares of u² by parameter group; empty without any."""
    clauses = []
    for basis, shares in shares_of_priors(calibration).items():
        largest = sorted(((share, group) for group, share in shares.items() if share >= MIN_SHARE), reverse=True)
        if largest:
            clauses.append(f"by the {basis}: {', '.join(f'{percent(share)} of {group}' for share, group in largest)}")
    if not clauses:
        return ""
    return (
        "Part of u² is not from this recording but from the usual sizes of instruments of the kind (means over the "
        f"parameters of a group), {'; '.join(clauses)}."
    )
