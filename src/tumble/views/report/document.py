"""Reports: from calibration files to a document, and from that to a page.

The result comes first, then how it is applied, then the evidence.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from tumble.arguments import checked
from tumble.earth import EARTH_RATE
from tumble.errors import InputError
from tumble.files import FilePath, ending_in, whole_file
from tumble.result import further
from tumble.result.calibration import Calibration, calibration_of, text_and_name
from tumble.result.further import recording_dates
from tumble.views.blocks import Document, Facts, Items, Part, Section, Tone, section
from tumble.views.numbers import NONE, device_name, fixed, significant
from tumble.views.report import application, over_temperature, recording, result
from tumble.views.uncertainty_budget import budget_blocks

_MAX_TIMES = 3  # times listed in full; with more recordings only the days are listed


@dataclass(frozen=True, kw_only=True, slots=True)
class ReportedFile:
    """A calibration with the name of its file and the SHA-256 of the content."""

    file: str
    sha256: str
    calibration: Calibration


@checked
def write_report(calibrations: Calibration | FilePath | Sequence[Calibration | FilePath], out: FilePath) -> list[str]:
    """Write the report of a calibration, or of several of one device, as a page of HTML that prints well.

    Parameters
    ----------
    calibrations
        A calibration or its file, or several of one device.
    out
        The file to write: .html. For a PDF, print the page.

    Returns
    -------
    list of str
        Sentences on calibrations that are not accepted, with the reasons.

    Raises
    ------
    InputError
        For files that cannot be used.
    MissingExtraError
        Without the extra `tumble[lab]`.

    Examples
    --------
    >>> import tumble
    >>> folder = tumble.simulate_session("session", tumble.Setup.of(grade="mems", positions=12), seed=1)
    >>> tumble.calibrate(folder).write("calibration.json")
    >>> tumble.write_report("calibration.json", "report.html")
    []
    """
    if Path(out).suffix.lower() == ".pdf":
        raise InputError(
            f"{out}: expected a file that ends in .html, found '.pdf'; print the page for a PDF (of a certificate, "
            "--certificate, there is one)"
        )
    ending_in(Path(out), ".html")
    sources = sources_of(calibrations)
    write_document(report_of(sources), out)
    return reasons_of(sources)


def sources_of(calibrations: Calibration | FilePath | Sequence[Calibration | FilePath]) -> list[ReportedFile]:
    """Return calibrations with the names of their files and the SHA-256 of their content."""
    listed = [calibrations] if isinstance(calibrations, Calibration | str | os.PathLike) else calibrations
    sources = []
    for each in listed:
        text, name = text_and_name(each)
        content, file = text.encode(), name
        if not isinstance(each, Calibration):
            content, file = Path(each).read_bytes(), Path(each).name
        calibration = calibration_of(text, name)
        sources.append(ReportedFile(file=file, sha256=hashlib.sha256(content).hexdigest(), calibration=calibration))
    return sources


def write_document(document: Document, out: FilePath) -> None:
    """Write a document as HTML or PDF, by the suffix of `out`.

    Raises InputError if it cannot be written, MissingExtraError without the extra `tumble[lab]`."""
    out = Path(out)
    from tumble.views.render.pages import page, pdf

    content = page(document).encode() if out.suffix.lower() == ".html" else pdf(document)
    try:
        with whole_file(out) as temporary:
            temporary.write_bytes(content)
    except OSError as error:
        raise InputError(f"{out}: cannot be written: {error.strerror}") from error


def report_of(sources: Sequence[ReportedFile], further_sections: Sequence[Sequence[Section]] = ()) -> Document:
    """Return the report of calibrations of one device, with further sections after the result of each.

    Calibrations by one method are named by a number and the date of the recording too. Raises InputError for
    calibrations of several devices."""
    calibrations = [source.calibration for source in sources]
    first = calibrations[0]
    for source in sources[1:]:
        if source.calibration.serial != first.serial:
            raise InputError(
                f"{source.file}: expected a calibration of device {first.serial!r} like {sources[0].file}, "
                f"found {source.calibration.serial!r}; make a report for each device"
            )
    titles, parts = [calibration.method for calibration in calibrations], []
    if len(set(titles)) < len(titles):
        dates = [(calibration.provenance.circumstances.date or "")[:10] for calibration in calibrations]
        titles = [f"{i}: {name} {day}".rstrip() for i, (name, day) in enumerate(zip(titles, dates, strict=True), 1)]
    for i, (source, title) in enumerate(zip(sources, titles, strict=True)):
        calibration, key = source.calibration, f"c{i + 1}"  # prefix of its figures
        origin = calibration.provenance
        sections = [
            result.result(calibration, f"{key}-improvement"),
            *(further_sections[i] if further_sections else ()),
            notes(*further.remarks(calibration), *origin.assumptions, *origin.notes),
            *annexes(calibration, key),
            result.unknown(calibration),
            provenance(source),
        ]
        parts.append(Part(title=title if len(sources) > 1 else "", sections=tuple(filter(None, sections))))
    verdict, tone = verdict_on(calibrations)
    return Document(
        title="Calibration report",
        device=device_name(first.serial, first.model),
        tone=tone,
        verdict=verdict,
        facts=front(first, titles),
        created=max(calibration.provenance.created or "" for calibration in calibrations),
        parts=tuple(parts),
        closing="End of the report",
    )


def verdict_on(calibrations: Sequence[Calibration]) -> tuple[str, Tone]:
    """Return the worst verdict on calibrations, and its tone."""
    outcomes = [calibration.outcome for calibration in calibrations]
    if all(outcome.accepted for outcome in outcomes):
        remarks = any(outcome.remarks for outcome in outcomes)
        return ("accepted with scatter", "doubt") if remarks else ("accepted", "good")
    *by_kind, _ = further.verdicts(calibrations[0])
    if by_kind and len(calibrations) == 1:
        return "; ".join(by_kind), "doubt"
    return "not accepted", "bad"


def reasons_of(sources: Sequence[ReportedFile]) -> list[str]:
    """Return the reasons why calibrations are not accepted, each with its file."""
    return [
        f"not accepted: {source.file}: {reason}" for source in sources for reason in source.calibration.outcome.reasons
    ]


# -------------------- sections --------------------


def annexes(calibration: Calibration, key: str, *, short: bool = False) -> Iterator[Section | None]:
    """Yield the sections on the correction and the evidence; for a certificate `short`, without figures of recordings,
    budgets of parameters and tables of groups."""
    recordings = recording.recordings(calibration)
    yield application.application(calibration)
    yield result.launches(calibration)
    yield result.iterations(calibration)
    yield result.beyond(calibration, groups=not short)
    yield over_temperature.section(calibration, f"{key}-temperature")
    yield recording.sites(recordings)
    yield from map(recording.rests_and_turns, recordings)
    names = ("" if short else f"{key}-residuals{i}" for i in range(len(recordings)))
    yield from map(recording.residuals, recordings, names)
    if budget := budget_blocks(calibration, every=not short):
        yield section("Uncertainty budget", *budget)
    yield result.correlations(calibration)


def notes(*sentences: str) -> Section | None:
    """Return a section of notes, None without any."""
    return section("Notes", Items(items=sentences)) if sentences else None


def provenance(source: ReportedFile) -> Section:
    """Return the section on the calibration file, the log and the software."""
    origin = source.calibration.provenance
    rows = (
        ("data annex", f"the calibration file {source.file}: all values, u, k, ν and covariances in SI"),
        ("its SHA-256", source.sha256),
        ("SHA-256 of the log" + ("s" if source.calibration.evidence.launches else ""), origin.log_sha256 or NONE),
        ("software", origin.software or NONE),
        ("computed", _time_text(origin.created or NONE)),
        ("method", source.calibration.method),
    )
    return section("Provenance", Facts(rows=rows))


# -------------------- first page --------------------


def front(first: Calibration, titles: Sequence[str]) -> tuple[tuple[str, str], ...]:
    """Return facts on the device, and for a single calibration on its recording, the air, the operator and
    equipment."""
    rows = [("serial number", first.serial), ("model", first.model or "not stated")]
    if len(titles) > 1:
        return (*rows, ("calibrations", ", ".join(titles)))
    recordings, moments = recording.recordings(first), recording_dates(first)
    if len(moments) > _MAX_TIMES:
        moments = list(dict.fromkeys(moment[:10] for moment in moments))
    rows += [
        ("recorded", ", ".join(map(_time_text, moments)) or "date not stated"),
        ("method", f"{first.method}, frame “{first.frame}”"),
        ("programme", first.provenance.programme or "none"),
        ("launches", str(len(recordings))),
        *(recording.site_facts(recordings[0].recorded.site) if first.provenance.site is not None else ()),
        ("device temperature", recording.temperature(recordings)),
    ]
    if first.gyro is not None:
        clock = first.provenance.clock_u
        rows.append(("time base", f"U = {significant(2e6 * clock, 2)} ppm (k = 2)" if clock else "taken as exact"))
        rows.append(("rate of the Earth", f"{significant(EARTH_RATE, 7)} rad/s, taken as exact"))
    circumstances = first.provenance.circumstances
    air = circumstances.conditions
    if air.temperature_degC is not None:
        u = "" if air.temperature_u is None else f", U = {significant(2.0 * air.temperature_u, 2)} °C (k = 2)"
        rows.append(("air temperature", f"{fixed(air.temperature_degC, 1)} °C{u}"))
    if air.humidity_percent is not None:
        rows.append(("relative humidity", f"{significant(air.humidity_percent, 3)} %"))
    if air.pressure_hPa is not None:
        rows.append(("air pressure", f"{significant(air.pressure_hPa, 5)} hPa"))
    if circumstances.operator is not None:
        rows.append(("operator", circumstances.operator))
    return (*rows, *((("equipment", "; ".join(circumstances.equipment)),) if circumstances.equipment else ()))


def _time_text(moment: str) -> str:
    """Return an ISO 8601 time without "T"."""
    return moment.replace("T", " ").replace("+00:00", " UTC")
