"""The content of a report, in the order in which it is read: the result first, then how it is applied, then what it
rests on. One document for every kind of output."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from tumble.calibration.calibration_file import Calibration
from tumble.calibration.coverage import remarks
from tumble.calibration.further import predicted
from tumble.errors import InputError
from tumble.registry.limits import Limits, Verdict
from tumble.report import compare, limits, over_temperature, recording, result
from tumble.report.blocks import Block, Document, Facts, Items, Part, Section, Text, Tone
from tumble.report.numbers import NONE


@dataclass(frozen=True, kw_only=True, slots=True)
class Source:
    """A calibration with the name of its file and the SHA-256 of what was read from it."""

    file: str
    sha256: str
    calibration: Calibration


def document(sources: Sequence[Source], acceptance: Limits | None = None) -> Document:
    """The report of calibrations of one device. Raises InputError where they are of several."""
    _check_one_device(sources)
    calibrations = [source.calibration for source in sources]
    titles = _titles(sources)
    parts = [
        Part(title=title if len(sources) > 1 else "", sections=_sections(source, f"c{i}", acceptance))
        for i, (source, title) in enumerate(zip(sources, titles, strict=True), 1)
    ]
    if len(sources) > 1:
        together = compare.compared(titles, calibrations, "compared")
        parts.insert(0, Part(title="Comparison", sections=(together,)))
    first = calibrations[0]
    return Document(
        title="Calibration report",
        device=first.serial if first.model is None else f"{first.serial} ({first.model})",
        tone=_tone(sources, acceptance),
        verdict=_verdict(sources, acceptance),
        facts=_front(sources, titles),
        created=max(calibration.provenance.get("created", "") for calibration in calibrations),
        parts=tuple(parts),
    )


def _tone(sources: Sequence[Source], acceptance: Limits | None) -> Tone:
    """The colour of the worst verdict."""
    if not_accepted(sources, acceptance):
        return "bad"
    return "doubt" if any(source.calibration.outcome.remarks for source in sources) else "good"


def _verdict(sources: Sequence[Source], acceptance: Limits | None) -> str:
    """The verdict in a few words: of the calibrations, and where there are limits, of every check."""
    outcomes = [source.calibration.outcome for source in sources]
    if not all(outcome.accepted for outcome in outcomes):
        return "not accepted"
    accepted = "accepted with scatter" if any(outcome.remarks for outcome in outcomes) else "accepted"
    results: dict[str, list[str]] = {}
    for _, verdict in _checks(sources, acceptance):
        results.setdefault(verdict.occasion, []).append(verdict.result)
    worst = ("fail", "undecided", "pass")
    return ", ".join([accepted, *(f"{check}: {min(found, key=worst.index)}" for check, found in results.items())])


def _checks(sources: Sequence[Source], acceptance: Limits | None) -> Iterator[tuple[Source, Verdict]]:
    """Every calibration against the limits of every check."""
    if acceptance is not None:
        for source in sources:
            for verdict in limits.verdicts(source.calibration, acceptance):
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
    """What each calibration is called: its method where these differ, else a number and its date."""
    methods = [source.calibration.method for source in sources]
    if len(set(methods)) == len(sources):
        return methods
    dates = [source.calibration.provenance.get("created", "")[:10] for source in sources]
    return [f"{i}: {method} {date}".rstrip() for i, (method, date) in enumerate(zip(methods, dates, strict=True), 1)]


def _front(sources: Sequence[Source], titles: Sequence[str]) -> tuple[tuple[str, str], ...]:
    first = sources[0].calibration
    rows = [("serial number", first.serial), ("model", first.model or NONE)]
    if len(sources) > 1:
        rows.append(("calibrations", ", ".join(titles)))
        return tuple(rows)
    recordings = recording.recordings(first)
    rows += [
        ("calibrated", _when(first)),
        ("method", f"{first.method}, frame “{first.frame}”"),
        ("programme", first.programme or "none"),
        ("launches", str(len(recordings))),
        *(recording.site_facts(recordings[0].site) if first.site is not None else ()),
        ("temperature", recording.temperature(recordings)),
    ]
    return tuple(rows)


def _when(calibration: Calibration) -> str:
    return calibration.provenance.get("created", NONE).replace("T", " ").replace("+00:00", " UTC")


def _sections(source: Source, key: str, acceptance: Limits | None) -> tuple[Section, ...]:
    """All sections of one calibration; `key` begins the names of its figures."""
    calibration = source.calibration
    recordings = recording.recordings(calibration)
    sections: list[Section | None] = [
        _result(calibration),
        result.beyond(calibration),
        over_temperature.section(calibration, f"{key}-temperature"),
        limits.section(calibration, acceptance),
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


def _result(calibration: Calibration) -> Section:
    blocks: list[Block] = result.verdict(calibration)
    if calibration.parameters:
        blocks.append(result.parameter_table(calibration))
        blocks.append(
            Text(
                text="U = k u is the expanded uncertainty, which covers 95.45 %: k = 2 where u is known, more, by "
                "Student's t, where it was estimated from few residuals. "
                '1 µg is 9.80665·10⁻⁶ m/s², " a second of arc.',
                tone="small",
            )
        )
        if found := remarks(calibration):
            blocks.append(Items(items=found))
    if calibration.prediction is not None:
        blocks.append(Text(text=f"Known to (standard uncertainty): {predicted(calibration.prediction)}."))
    if calibration.outcome.unobservable:
        blocks.append(Text(text=f"Not determined: {', '.join(calibration.outcome.unobservable)}."))
    if calibration.notes:
        blocks += [Text(text="Notes", tone="small"), Items(items=calibration.notes)]
    return Section(title="Result", blocks=tuple(blocks))


def _provenance(source: Source) -> Section:
    provenance = source.calibration.provenance
    rows = [
        ("calibration file", source.file),
        ("its SHA-256", source.sha256),
        ("SHA-256 of the log" + ("s" if source.calibration.launches else ""), provenance.get("log_sha256", NONE)),
        ("software", provenance.get("software", NONE)),
        ("calibrated", _when(source.calibration)),
        ("method", source.calibration.method),
    ]
    return Section(title="Provenance", blocks=(Facts(rows=tuple(rows)),))
