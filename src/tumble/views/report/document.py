"""The content of a report, in the order in which it is read: the result first, then how it is applied, then what it
rests on. One document for every kind of output."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

from tumble.acceptance.certificate import Certificate, check_certificate, recorded_on
from tumble.acceptance.conformity import RESULTS, LimitJudgement, Result, Verdict, verdicts
from tumble.acceptance.limits import Limits
from tumble.errors import InputError
from tumble.result import further
from tumble.result.calibration import Calibration
from tumble.result.further import left_by_matrix, left_said, remarks
from tumble.views.blocks import Block, Document, Facts, Items, Part, Section, Text, Tone, section
from tumble.views.numbers import NONE, device_name
from tumble.views.registry import TONES
from tumble.views.report import certified, compare, limits, over_temperature, recording, result
from tumble.views.uncertainty_budget import budget_section

_MOST_MOMENTS = 3
"""Of more recordings only the days are listed."""


@dataclass(frozen=True, kw_only=True, slots=True)
class ReportedFile:
    """A calibration with the name of its file and the SHA-256 of what was read from it."""

    file: str
    sha256: str
    calibration: Calibration


@dataclass(frozen=True, kw_only=True, slots=True)
class _Reported:
    """A calibration with all that it is reported with: its verdicts by the limits, where there are any, certificate,
    and the calibration before an adjustment."""

    source: ReportedFile
    acceptance: Limits | None
    checks: tuple[Verdict, ...]
    certificate: Certificate | None
    as_found: Calibration | None

    @property
    def calibration(self) -> Calibration:
        return self.source.calibration

    @property
    def limits_elsewhere(self) -> bool:
        """Whether the table of results cannot hold the limits with all that is to be said of them."""
        limits = self.acceptance
        return limits is not None and (limits.frame != self.calibration.frame or limits.temperatures is not None)


def document(
    sources: Sequence[ReportedFile],
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
    first, *others = [source.calibration for source in sources]
    if as_found is not None and (as_found.serial, as_found.frame) != (first.serial, first.frame):
        raise InputError(
            f"certificate: as_found: expected a calibration of device {first.serial!r} in the frame "
            f"{first.frame!r}, found {as_found.serial!r} in {as_found.frame!r}"
        )
    if certificate is not None:
        check_certificate(certificate, first, as_found)
    reported = [
        _Reported(
            source=source,
            acceptance=acceptance,
            checks=_checks(source, acceptance),
            certificate=certificate,
            as_found=as_found,
        )
        for source in sources
    ]
    titles, of_all = _titles(sources), _for_the_laboratory if certificate is None else _for_customers
    parts = [
        Part(
            title=title if others else "",
            sections=tuple(section for section in of_all(one, f"c{i}") if section is not None),
            customer=0 if others else 1,
        )
        for i, (one, title) in enumerate(zip(reported, titles, strict=True), 1)
    ]
    if others:
        together = compare.compared(titles, [first, *others], "compared")
        parts.insert(0, Part(title="Comparison", sections=(together,)))
    badge, tone, verdict = _verdict(reported)
    return Document(
        title="Calibration report" if certificate is None else "Calibration certificate",
        device=device_name(first.serial, first.model),
        tone=tone,
        verdict=badge,
        facts=(
            *(() if certificate is None else certified.facts(certificate, first)),
            *_front(first, titles),
            *((("verdict", verdict),) if acceptance is not None else ()),
        ),
        created=max(calibration.provenance.get("created", "") for calibration in [first, *others]),
        parts=tuple(parts),
        statements=certified.statements(certificate, judged=acceptance is not None),
        signatures=certified.signatures(certificate),
        closing="End of the report" if certificate is None else f"End of the certificate {certificate.number}",
        number="" if certificate is None else certificate.number,
        letterhead=None if certificate is None else certified.letterhead(certificate.laboratory),
    )


def _checks(source: ReportedFile, acceptance: Limits | None) -> tuple[Verdict, ...]:
    """A calibration against the limits of every check."""
    return () if acceptance is None else tuple(verdicts(source.calibration, acceptance))


def _verdict(reported: Sequence[_Reported]) -> tuple[str, Tone, str]:
    """The worst verdict, with its colour: of the checks where there are limits, else whether the calibrations are
    accepted; and both in a few words."""
    outcomes = [one.calibration.outcome for one in reported]
    if not all(outcome.accepted for outcome in outcomes):
        *of_kinds, _ = further.verdicts(reported[0].calibration)
        if not of_kinds or len(reported) > 1:
            return "not accepted", "bad", "not accepted"
        return "; ".join(of_kinds), "doubt", "not accepted"
    remarked = any(outcome.remarks for outcome in outcomes)
    accepted = "accepted with scatter" if remarked else "accepted"
    worst: dict[str, Result] = {}
    for check in (check for one in reported for check in one.checks):
        worst[check.occasion] = min(check.result, worst.get(check.occasion, "pass"), key=RESULTS.index)
    said = ", ".join([accepted, *(f"{occasion}: {result}" for occasion, result in worst.items())])
    if not worst:
        return accepted, "doubt" if remarked else "good", said
    badge = min(worst.values(), key=RESULTS.index)
    return badge, TONES[badge], said


def not_accepted(sources: Sequence[ReportedFile], acceptance: Limits | None) -> list[str]:
    """Why a calibration is not accepted or not within limits, each with its file."""
    reasons = [f"{source.file}: {reason}" for source in sources for reason in source.calibration.outcome.reasons]
    for source in sources:
        for verdict in _checks(source, acceptance):
            if verdict.result != "pass":
                reasons.append(f"{source.file}: {verdict.occasion} check: {'; '.join(verdict.reasons())}")
    return reasons


def _check_one_device(sources: Sequence[ReportedFile]) -> None:
    first = sources[0]
    for source in sources[1:]:
        if source.calibration.serial != first.calibration.serial:
            raise InputError(
                f"{source.file}: expected a calibration of device {first.calibration.serial!r} like {first.file}, "
                f"found {source.calibration.serial!r}; make a report for each device"
            )


def _titles(sources: Sequence[ReportedFile]) -> list[str]:
    """What each calibration is called: its method where these differ, else a number and the date of its recording."""
    methods = [source.calibration.method for source in sources]
    if len(set(methods)) == len(sources):
        return methods
    dates = [(source.calibration.circumstances.date or "")[:10] for source in sources]
    return [f"{i}: {method} {date}".rstrip() for i, (method, date) in enumerate(zip(methods, dates, strict=True), 1)]


def _front(first: Calibration, titles: Sequence[str]) -> tuple[tuple[str, str], ...]:
    device = (("serial number", first.serial), ("model", first.model or NONE))
    if len(titles) > 1:
        return (*device, ("calibrations", ", ".join(titles)))
    recordings = recording.recordings(first)
    return (
        *device,
        ("recorded", _recorded(first)),
        ("method", f"{first.method}, frame “{first.frame}”"),
        ("programme", first.programme or "none"),
        ("launches", str(len(recordings))),
        *(recording.site_facts(recordings[0].site) if first.site is not None else ()),
        ("temperature", recording.temperature(recordings)),
        *certified.circumstances(first.circumstances),
    )


def _recorded(calibration: Calibration) -> str:
    """When each recording was made, by its session or log; never when it was computed."""
    moments = recorded_on(calibration)
    if len(moments) > _MOST_MOMENTS:
        moments = list(dict.fromkeys(moment[:10] for moment in moments))
    said = (moment.replace("T", " ").replace("+00:00", " UTC") for moment in moments)
    return ", ".join(said) or "date not stated"


def _computed(calibration: Calibration) -> str:
    return calibration.provenance.get("created", NONE).replace("T", " ").replace("+00:00", " UTC")


def _for_the_laboratory(one: _Reported, key: str) -> Iterator[Section | None]:
    """Everything that is known of a calibration; `key` begins the names of its figures."""
    calibration = one.calibration
    recordings = recording.recordings(calibration)
    yield _result(one)
    yield result.beyond(calibration)
    yield result.unknown(calibration)
    yield over_temperature.section(calibration, f"{key}-temperature")
    yield limits.section(calibration, one.acceptance, one.checks)
    yield _notes((*remarks(calibration), *calibration.notes))
    yield result.launches(calibration) if calibration.launches else None
    yield result.application(calibration)
    yield result.frame(calibration, f"{key}-frame")
    yield recording.site(recordings)
    yield from (recording.found(r, f"{key}-sphere{i}") for i, r in enumerate(recordings))
    yield from (recording.residuals(r, f"{key}-residuals{i}") for i, r in enumerate(recordings))
    yield budget_section(calibration, f"{key}-budget")
    yield result.correlations(calibration)
    yield result.convergence(calibration, f"{key}-convergence")
    yield from (recording.noise(r, f"{key}-noise{i}") for i, r in enumerate(recordings))
    yield _provenance(one.source)


def _for_customers(one: _Reported, key: str) -> Iterator[Section | None]:
    """What a certificate states: results and how they are applied, conformity, what was measured, and where all of it
    is as data; no causes and no advice."""
    calibration = one.calibration
    recordings = recording.recordings(calibration)
    yield _result(one)
    yield limits.section(calibration, one.acceptance, one.checks) if one.limits_elsewhere else None
    yield _notes((*remarks(calibration), *map(_without_advice, calibration.notes)))
    yield result.launches(calibration) if calibration.launches else None
    yield result.beyond(calibration, for_customers=True)
    yield over_temperature.section(calibration, f"{key}-temperature")
    yield result.application(calibration)
    yield result.frame(calibration, f"{key}-frame")
    if any(each.site != recordings[0].site for each in recordings):
        yield recording.site(recordings)
    yield from (recording.measured(each) for each in recordings)
    yield budget_section(calibration)
    yield result.correlations(calibration)
    yield _provenance(one.source)


_FOR_THE_OPERATOR = ("[", "`", "--", "tumble ", "let ")
"""What only speaks to those who run the program has one of these: keys, commands, options, advice."""


def _without_advice(note: str) -> str:
    """A note without the clauses that say what to do."""
    clauses = [clause for clause in note.split("; ") if not any(mark in clause for mark in _FOR_THE_OPERATOR)]
    return "; ".join(clauses)


def _result(one: _Reported) -> Section:
    calibration, certified_result = one.calibration, one.certificate is not None
    blocks: list[Block] = result.verdict(calibration, opinions=not certified_result)
    if calibration.parameters:
        judged: dict[str, list[LimitJudgement]] = {}
        if one.acceptance is not None and one.acceptance.frame == calibration.frame:
            for judgement in (judgement for check in one.checks for judgement in check.judgements):
                judged.setdefault(judgement.name, []).append(judgement)
        said = (
            "U = k u is the expanded uncertainty, which covers 95.45 %: k = 2 where u is known, more, by Student's t "
            "with ν degrees of freedom, where it was estimated from few residuals. "
            f"{_of_which_power_on(calibration)} "
            '1 µg is 9.80665·10⁻⁶ m/s², " a second of arc.'
        )
        table = result.parameter_table(calibration, one.as_found, judged, with_degrees=certified_result)
        blocks += [table, Text(text=said, tone="small")]
    if calibration.prediction is not None:
        left = left_by_matrix(calibration)
        alone = "" if left is None else f", with the whole correction; {left_said(left)}"
        known_to = f"{further.predicted(calibration.prediction)}{alone}"
        blocks.append(Text(text=f"Known to (standard uncertainty): {known_to}."))
    if calibration.outcome.unobservable:
        blocks.append(Text(text=f"Not determined: {', '.join(calibration.outcome.unobservable)}."))
    if one.limits_elsewhere:
        blocks.append(Text(text="Limits, and the verdict on every parameter: section “Limits and verdict”."))
    return section("Result", *blocks)


def _of_which_power_on(calibration: Calibration) -> str:
    """What U is of, and what it has not of the next power-on."""
    if len(calibration.launches) > 1:
        return (
            f"It is of the mean of {len(calibration.launches)} power-ons; a single later one lies about the mean with "
            "the standard deviation “run to run”, which comes on top."
        )
    if calibration.together:
        return "It is of all recorded power-ons together; what changes at the next one comes on top."
    return "It is of the one power-on that was recorded; what changes at the next one is not in it."


def _notes(notes: Iterable[str]) -> Section | None:
    """What is to be known of the recording and of U."""
    said = tuple(note for note in notes if note)
    return section("Notes", Items(items=said)) if said else None


def _provenance(source: ReportedFile) -> Section:
    provenance = source.calibration.provenance
    rows = [
        ("data annex", f"the calibration file {source.file}: all values, u, k, ν and covariances in SI"),
        ("its SHA-256", source.sha256),
        ("SHA-256 of the log" + ("s" if source.calibration.launches else ""), provenance.get("log_sha256", NONE)),
        ("software", provenance.get("software", NONE)),
        ("computed", _computed(source.calibration)),
        ("method", source.calibration.method),
    ]
    return section("Provenance", Facts(rows=tuple(rows)))
