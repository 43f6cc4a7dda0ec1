"""The content of a report, in the order in which it is read: the result first, then how it is applied, then what it
rests on. One document for every kind of output."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from tumble.calibration.calibration_file import Calibration
from tumble.calibration.coverage import remarks
from tumble.calibration.further import predicted
from tumble.errors import InputError
from tumble.export.certificate import Certificate
from tumble.registry.conformity import verdicts
from tumble.registry.limits import RESULTS, Limits, Result, Verdict
from tumble.report import certified, compare, limits, over_temperature, recording, result
from tumble.report.blocks import Block, Document, Facts, Items, Part, Section, Text, Tone
from tumble.report.numbers import NONE


@dataclass(frozen=True, kw_only=True, slots=True)
class Source:
    """A calibration with the name of its file and the SHA-256 of what was read from it."""

    file: str
    sha256: str
    calibration: Calibration


def document(
    sources: Sequence[Source],
    acceptance: Limits | None = None,
    certificate: Certificate | None = None,
    as_found: Calibration | None = None,
) -> Document:
    """The report of calibrations of one device, or the `certificate` of one of them, where it was adjusted with the
    calibration `as_found`. Raises InputError where they are of several devices, and for a certificate of several
    calibrations or without a date."""
    _check_one_device(sources)
    if certificate is not None and len(sources) > 1:
        raise InputError(f"--certificate: expected one calibration, found {len(sources)}")
    calibrations = [source.calibration for source in sources]
    if as_found is not None and (as_found.serial, as_found.frame) != (calibrations[0].serial, calibrations[0].frame):
        raise InputError(
            f"certificate: as_found: expected a calibration of device {calibrations[0].serial!r} in the frame "
            f"{calibrations[0].frame!r}, found {as_found.serial!r} in {as_found.frame!r}"
        )
    titles = _titles(sources)
    given = ReportBasis(acceptance=acceptance, certificate=certificate, as_found=as_found)
    parts = [
        Part(
            title=title if len(sources) > 1 else "",
            sections=_sections(source, f"c{i}", given),
            customer=0 if len(sources) > 1 else 1,
        )
        for i, (source, title) in enumerate(zip(sources, titles, strict=True), 1)
    ]
    if len(sources) > 1:
        together = compare.compared(titles, calibrations, "compared")
        parts.insert(0, Part(title="Comparison", sections=(together,)))
    first = calibrations[0]
    return Document(
        title="Calibration report" if certificate is None else "Calibration certificate",
        device=first.serial if first.model is None else f"{first.serial} ({first.model})",
        tone=_tone(sources, given),
        verdict=_badge(sources, given),
        facts=(
            *(() if certificate is None else certified.facts(certificate, first)),
            *_front(sources, titles),
            *((("verdict", _verdict(sources, given)),) if acceptance is not None else ()),
        ),
        created=max(calibration.provenance.get("created", "") for calibration in calibrations),
        parts=tuple(parts),
        statements=certified.statements(certificate, judged=acceptance is not None),
        signatures=certified.signatures(certificate),
        closing="End of the report" if certificate is None else f"End of the certificate {certificate.number}",
        number="" if certificate is None else certificate.number,
        letterhead=None if certificate is None else certified.letterhead(certificate.laboratory),
    )


@dataclass(frozen=True, kw_only=True, slots=True)
class ReportBasis:
    """What a report is made with beside the calibrations."""

    acceptance: Limits | None
    certificate: Certificate | None
    as_found: Calibration | None

    @property
    def agreed(self) -> str | None:
        """How the decision rule was agreed: None without a certificate."""
        return None if self.certificate is None else self.certificate.agreed or ""


def _tone(sources: Sequence[Source], given: ReportBasis) -> Tone:
    """The colour of the worst verdict."""
    badge = _badge(sources, given)
    if badge in limits.TONES:
        return limits.TONES[badge]
    if badge == "not accepted":
        return "bad"
    return "doubt" if any(source.calibration.outcome.remarks for source in sources) else "good"


def _badge(sources: Sequence[Source], given: ReportBasis) -> str:
    """One verdict: the worst outcome of the checks where there are limits, else whether the calibrations are
    accepted."""
    outcomes = [source.calibration.outcome for source in sources]
    if not all(outcome.accepted for outcome in outcomes):
        return "not accepted"
    found = _outcomes(sources, given)
    if found:
        return min((each for _, each in found), key=RESULTS.index)
    return "accepted with scatter" if any(outcome.remarks for outcome in outcomes) else "accepted"


def _outcomes(sources: Sequence[Source], given: ReportBasis) -> list[tuple[str, Result]]:
    """The outcome of every check, with its name."""
    found = [verdict for _, verdict in _checks(sources, given.acceptance)]
    return [(verdict.occasion, verdict.result) for verdict in found]


def _verdict(sources: Sequence[Source], given: ReportBasis) -> str:
    """The verdict in a few words: of the calibrations, and where there are limits, of every check."""
    outcomes = [source.calibration.outcome for source in sources]
    if not all(outcome.accepted for outcome in outcomes):
        return "not accepted"
    accepted = "accepted with scatter" if any(outcome.remarks for outcome in outcomes) else "accepted"
    results: dict[str, list[Result]] = {}
    for occasion, outcome in _outcomes(sources, given):
        results.setdefault(occasion, []).append(outcome)
    worst = [f"{check}: {min(found, key=RESULTS.index)}" for check, found in results.items()]
    return ", ".join([accepted, *worst])


def _checks(sources: Sequence[Source], acceptance: Limits | None) -> Iterator[tuple[Source, Verdict]]:
    """Every calibration against the limits of every check."""
    if acceptance is not None:
        for source in sources:
            for verdict in verdicts(source.calibration, acceptance):
                yield source, verdict


def not_accepted(sources: Sequence[Source], acceptance: Limits | None) -> list[str]:
    """Why a calibration is not accepted or not within limits, each with its file."""
    reasons = [f"{source.file}: {reason}" for source in sources for reason in source.calibration.outcome.reasons]
    for source, verdict in _checks(sources, acceptance):
        if verdict.result != "pass":
            reasons.append(f"{source.file}: {verdict.occasion} check: {'; '.join(verdict.reasons())}")
    return reasons


def _check_one_device(sources: Sequence[Source]) -> None:
    first = sources[0]
    for source in sources[1:]:
        if source.calibration.serial != first.calibration.serial:
            raise InputError(
                f"{source.file}: expected a calibration of device {first.calibration.serial!r} like {first.file}, "
                f"found {source.calibration.serial!r}; make a report for each device"
            )


def _titles(sources: Sequence[Source]) -> list[str]:
    """What each calibration is called: its method where these differ, else a number and the date of its recording."""
    methods = [source.calibration.method for source in sources]
    if len(set(methods)) == len(sources):
        return methods
    dates = [(source.calibration.circumstances.date or "")[:10] for source in sources]
    return [f"{i}: {method} {date}".rstrip() for i, (method, date) in enumerate(zip(methods, dates, strict=True), 1)]


def _front(sources: Sequence[Source], titles: Sequence[str]) -> tuple[tuple[str, str], ...]:
    first = sources[0].calibration
    rows = [("serial number", first.serial), ("model", first.model or NONE)]
    if len(sources) > 1:
        rows.append(("calibrations", ", ".join(titles)))
        return tuple(rows)
    recordings = recording.recordings(first)
    rows += [
        ("recorded", _recorded(first)),
        ("method", f"{first.method}, frame “{first.frame}”"),
        ("programme", first.programme or "none"),
        ("launches", str(len(recordings))),
        *(recording.site_facts(recordings[0].site) if first.site is not None else ()),
        ("temperature", recording.temperature(recordings)),
        *certified.circumstances(first.circumstances),
    ]
    return tuple(rows)


def _recorded(calibration: Calibration) -> str:
    """When, by the session or the log; never when it was computed."""
    date = calibration.circumstances.date
    return "date not stated" if date is None else date.replace("T", " ").replace("+00:00", " UTC")


def _computed(calibration: Calibration) -> str:
    return calibration.provenance.get("created", NONE).replace("T", " ").replace("+00:00", " UTC")


def _sections(source: Source, key: str, given: ReportBasis) -> tuple[Section, ...]:
    """All sections of one calibration; `key` begins the names of its figures."""
    calibration = source.calibration
    recordings = recording.recordings(calibration)
    sections: list[Section | None] = [
        _result(calibration, given),
        result.beyond(calibration),
        over_temperature.section(calibration, f"{key}-temperature"),
        limits.section(calibration, given.acceptance, given.agreed),
        _notes(calibration),
        result.launches(calibration) if calibration.launches else None,
        result.application(calibration),
        result.frame(calibration, f"{key}-frame"),
        recording.site(recordings),
        *(recording.found(r, f"{key}-sphere{i}") for i, r in enumerate(recordings)),
        *(recording.residuals(r, f"{key}-residuals{i}") for i, r in enumerate(recordings)),
        result.correlations(calibration, f"{key}-correlations"),
        result.convergence(calibration, f"{key}-convergence"),
        *(recording.noise(r, f"{key}-noise{i}") for i, r in enumerate(recordings)),
        _provenance(source),
        result.covariance(calibration),
    ]
    return tuple(section for section in sections if section is not None)


def _result(calibration: Calibration, given: ReportBasis) -> Section:
    blocks: list[Block] = result.verdict(calibration)
    if calibration.parameters:
        blocks.append(result.parameter_table(calibration, given.as_found, _by_parameter(calibration, given)))
        blocks.append(
            Text(
                text="U = k u is the expanded uncertainty, which covers 95.45 %: k = 2 where u is known, more, by "
                "Student's t, where it was estimated from few residuals. "
                '1 µg is 9.80665·10⁻⁶ m/s², " a second of arc.',
                tone="small",
            )
        )
    if calibration.prediction is not None:
        blocks.append(Text(text=f"Known to (standard uncertainty): {predicted(calibration.prediction)}."))
    if calibration.outcome.unobservable:
        blocks.append(Text(text=f"Not determined: {', '.join(calibration.outcome.unobservable)}."))
    return Section(title="Result", blocks=tuple(blocks))


def _by_parameter(calibration: Calibration, given: ReportBasis) -> dict[str, str]:
    """The worst outcome of the checks of every parameter that has a limit."""
    if given.acceptance is None or given.acceptance.frame != calibration.frame:
        return {}
    found: dict[str, Result] = {}
    for judgement in (j for verdict in verdicts(calibration, given.acceptance) for j in verdict.judgements):
        outcome = judgement.result
        found[judgement.name] = min(found.get(judgement.name, outcome), outcome, key=RESULTS.index)
    return dict(found)


def _notes(calibration: Calibration) -> Section | None:
    """What is to be known of the recording and of U."""
    said = (*remarks(calibration), *calibration.notes)
    return Section(title="Notes", blocks=(Items(items=said),)) if said else None


def _provenance(source: Source) -> Section:
    provenance = source.calibration.provenance
    rows = [
        ("calibration file", source.file),
        ("its SHA-256", source.sha256),
        ("SHA-256 of the log" + ("s" if source.calibration.launches else ""), provenance.get("log_sha256", NONE)),
        ("software", provenance.get("software", NONE)),
        ("computed", _computed(source.calibration)),
        ("method", source.calibration.method),
    ]
    return Section(title="Provenance", blocks=(Facts(rows=tuple(rows)),))
