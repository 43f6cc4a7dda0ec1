"""The content of a report, in the order in which it is read: the result first, then how it is applied, then what it
rests on. One document for every kind of output."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

from tumble.calibration import further
from tumble.calibration.calibration_file import Calibration
from tumble.calibration.coverage import remarks
from tumble.calibration.further import left_by_matrix, left_said
from tumble.errors import InputError
from tumble.export.certificate import Certificate, check_certificate, recorded_on
from tumble.registry.conformity import verdicts
from tumble.registry.limits import RESULTS, LimitJudgement, Limits, Result, Verdict
from tumble.views.blocks import Block, Document, Facts, Items, Part, Section, Text, Tone
from tumble.views.numbers import NONE, device_name
from tumble.views.registry import TONES
from tumble.views.report import certified, compare, limits, over_temperature, recording, result

_MOST_MOMENTS = 3
"""Of more recordings only the days are listed."""


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
    if certificate is not None:
        check_certificate(certificate, calibrations[0], as_found)
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
        device=device_name(first.serial, first.model),
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


def _tone(sources: Sequence[Source], given: ReportBasis) -> Tone:
    """The colour of the worst verdict."""
    badge = _badge(sources, given)
    if badge in TONES:
        return TONES[badge]
    if badge == "not accepted":
        return "bad"
    return "doubt" if any(source.calibration.outcome.remarks for source in sources) else "good"


def _badge(sources: Sequence[Source], given: ReportBasis) -> str:
    """One verdict: the worst outcome of the checks where there are limits, else whether the calibrations are
    accepted."""
    outcomes = [source.calibration.outcome for source in sources]
    if not all(outcome.accepted for outcome in outcomes):
        *of_kinds, _ = further.verdicts(sources[0].calibration)
        return "; ".join(of_kinds) if of_kinds and len(sources) == 1 else "not accepted"
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
    """When each recording was made, by its session or log; never when it was computed."""
    moments = recorded_on(calibration)
    if len(moments) > _MOST_MOMENTS:
        moments = list(dict.fromkeys(moment[:10] for moment in moments))
    said = (moment.replace("T", " ").replace("+00:00", " UTC") for moment in moments)
    return ", ".join(said) or "date not stated"


def _computed(calibration: Calibration) -> str:
    return calibration.provenance.get("created", NONE).replace("T", " ").replace("+00:00", " UTC")


def _sections(source: Source, key: str, given: ReportBasis) -> tuple[Section, ...]:
    """All sections of one calibration; `key` begins the names of its figures."""
    of_all = _for_customers if given.certificate is not None else _for_the_laboratory
    return tuple(section for section in of_all(source, key, given) if section is not None)


def _for_the_laboratory(source: Source, key: str, given: ReportBasis) -> Iterator[Section | None]:
    """Everything that is known of a calibration."""
    calibration = source.calibration
    recordings = recording.recordings(calibration)
    yield _result(calibration, given)
    yield result.beyond(calibration)
    yield over_temperature.section(calibration, f"{key}-temperature")
    yield limits.section(calibration, given.acceptance)
    yield _notes((*remarks(calibration), *calibration.notes))
    yield result.launches(calibration) if calibration.launches else None
    yield result.application(calibration)
    yield result.frame(calibration, f"{key}-frame")
    yield recording.site(recordings)
    yield from (recording.found(r, f"{key}-sphere{i}") for i, r in enumerate(recordings))
    yield from (recording.residuals(r, f"{key}-residuals{i}") for i, r in enumerate(recordings))
    yield result.correlations(calibration)
    yield result.convergence(calibration, f"{key}-convergence")
    yield from (recording.noise(r, f"{key}-noise{i}") for i, r in enumerate(recordings))
    yield _provenance(source)


def _for_customers(source: Source, key: str, given: ReportBasis) -> Iterator[Section | None]:
    """What a certificate states: results and how they are applied, conformity, what was measured, and where all of it
    is as data; no causes and no advice."""
    calibration = source.calibration
    recordings = recording.recordings(calibration)
    yield _result(calibration, given)
    if given.acceptance is not None and not _on_the_first_page(calibration, given.acceptance):
        yield limits.section(calibration, given.acceptance)
    yield _notes((*remarks(calibration), *map(_without_advice, calibration.notes)))
    yield result.launches(calibration) if calibration.launches else None
    yield result.beyond_for_customers(calibration)
    yield over_temperature.section(calibration, f"{key}-temperature")
    yield result.application(calibration)
    yield result.frame(calibration, f"{key}-frame")
    if any(each.site != recordings[0].site for each in recordings):
        yield recording.site(recordings)
    yield from (recording.measured(each) for each in recordings)
    yield result.correlations(calibration)
    yield _provenance(source)


def _on_the_first_page(calibration: Calibration, acceptance: Limits) -> bool:
    """Whether the table of results has the limits with all that is to be said of them."""
    return acceptance.frame == calibration.frame and acceptance.temperatures is None


_FOR_THE_OPERATOR = ("[", "`", "--", "tumble ", "let ")
"""What only speaks to those who run the program has one of these: keys, commands, options, advice."""


def _without_advice(note: str) -> str:
    """A note without the clauses that say what to do."""
    clauses = [clause for clause in note.split("; ") if not any(mark in clause for mark in _FOR_THE_OPERATOR)]
    return "; ".join(clauses)


def _result(calibration: Calibration, given: ReportBasis) -> Section:
    certified_result = given.certificate is not None
    blocks: list[Block] = result.verdict(calibration, opinions=not certified_result)
    if calibration.parameters:
        table = result.parameter_table(
            calibration, given.as_found, _by_parameter(calibration, given), with_degrees=certified_result
        )
        said = (
            "U = k u is the expanded uncertainty, which covers 95.45 %: k = 2 where u is known, more, by Student's t "
            "with ν degrees of freedom, where it was estimated from few residuals. "
            f"{_of_which_power_on(calibration)} "
            '1 µg is 9.80665·10⁻⁶ m/s², " a second of arc.'
        )
        blocks += [table, Text(text=said, tone="small")]
    if calibration.prediction is not None:
        left = left_by_matrix(calibration)
        alone = "" if left is None else f", with the whole correction; {left_said(left)}"
        known_to = f"{further.predicted(calibration.prediction)}{alone}"
        blocks.append(Text(text=f"Known to (standard uncertainty): {known_to}."))
    if calibration.outcome.unobservable:
        blocks.append(Text(text=f"Not determined: {', '.join(calibration.outcome.unobservable)}."))
    if given.acceptance is not None and not _on_the_first_page(calibration, given.acceptance):
        blocks.append(Text(text="Limits, and the verdict on every parameter: section “Limits and verdict”."))
    return Section(title="Result", blocks=tuple(blocks))


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


def _by_parameter(calibration: Calibration, given: ReportBasis) -> dict[str, list[LimitJudgement]]:
    """What the checks say of every parameter that has a limit, where the table has room for all there is to say."""
    if given.acceptance is None or given.acceptance.frame != calibration.frame:
        return {}
    judged: dict[str, list[LimitJudgement]] = {}
    for judgement in (j for verdict in verdicts(calibration, given.acceptance) for j in verdict.judgements):
        judged.setdefault(judgement.name, []).append(judgement)
    return judged


def _notes(notes: Iterable[str]) -> Section | None:
    """What is to be known of the recording and of U."""
    said = tuple(note for note in notes if note)
    return Section(title="Notes", blocks=(Items(items=said),)) if said else None


def _provenance(source: Source) -> Section:
    provenance = source.calibration.provenance
    rows = [
        ("data annex", f"the calibration file {source.file}: all values, u, k, ν and covariances in SI"),
        ("its SHA-256", source.sha256),
        ("SHA-256 of the log" + ("s" if source.calibration.launches else ""), provenance.get("log_sha256", NONE)),
        ("software", provenance.get("software", NONE)),
        ("computed", _computed(source.calibration)),
        ("method", source.calibration.method),
    ]
    return Section(title="Provenance", blocks=(Facts(rows=tuple(rows)),))
