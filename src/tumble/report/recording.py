"""The recording in a report: site, programme and what was found, residuals, noise and drift of the rests."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from tumble.calibration.calibration_file import Calibration
from tumble.calibration.results import Launch, Readings, RestResult, SensorsAtRest, TurnResult
from tumble.errors import ProgrammeError
from tumble.estimation.diagnosis.site_gravity import against_normal
from tumble.estimation.estimate import Fit
from tumble.programme.positions import Position, from_attitudes
from tumble.programme.sheet_words import short_code
from tumble.recording.session import Site
from tumble.report import drawings, figures
from tumble.report.blocks import Block, Facts, Figure, ReportTable, Section, Text
from tumble.report.numbers import NONE, fixed, significant
from tumble.report.recording_picture import overview
from tumble.rotation import unit_vector
from tumble.sensors.model import SensorModel
from tumble.units import DEGREE, Array, engineering

_MOST_TURNS = 8
"""Rows of the table of turns from which on it stands in halves."""


@dataclass(frozen=True, kw_only=True, slots=True)
class RecordedSession:
    """One session behind a calibration: its rests, turns and fits, the sensor model that corrects them, and what its
    readings are. `title` is empty where there is one only."""

    title: str
    site: Site | None
    rests: tuple[RestResult, ...]
    turns: tuple[TurnResult, ...]
    fits: Mapping[str, Fit]
    accel: SensorModel | None
    programme: str | None
    readings: Mapping[str, Readings]


def recordings(calibration: Calibration) -> list[RecordedSession]:
    """The sessions of a calibration: itself, or its launches."""
    each: list[tuple[str, Calibration | Launch]] = [(launch.session, launch) for launch in calibration.launches]
    return [
        RecordedSession(
            title=title,
            accel=calibration.accel,
            site=found.site,
            rests=found.rests,
            turns=found.turns,
            fits=found.fits,
            programme=calibration.programme,
            readings=calibration.readings,
        )
        for title, found in each or [("", calibration)]
    ]


def site_facts(site: Site | None) -> tuple[tuple[str, str], ...]:
    """Where it was recorded, and gravity with its uncertainty."""
    if site is None:
        return (("site", "not in the calibration file"),)
    latitude = NONE if site.latitude is None else f"{fixed(site.latitude / DEGREE, 5)}°"
    gravity = f"{fixed(site.gravity, 7)} m/s², U = {significant(2.0 * site.gravity_u, 2)} m/s² (k = 2)"
    if site.gravity_is_unit:
        gravity = f"not stated: g at the place is the unit, {fixed(site.gravity, 5)} m/s² stands for it"
    elif site.gravity_u == 0.0:
        gravity = f"{fixed(site.gravity, 7)} m/s², taken as exact: no uncertainty of it was stated"
    height = () if site.latitude is None else (("height", f"{fixed(site.height, 1)} m"),)
    against = None if site.gravity_is_unit else against_normal(site)
    if against is not None:
        gravity = f"{gravity}; {against}"
    return (("latitude", latitude), *height, ("gravity", gravity))


def site(all_of_them: Sequence[RecordedSession]) -> Section:
    """The site of the recordings, once where they share it."""
    if all(recording.site == all_of_them[0].site for recording in all_of_them):
        return Section(title="Site", blocks=(Facts(rows=site_facts(all_of_them[0].site)),))
    blocks: list[Block] = []
    for recording in all_of_them:
        blocks += [Text(text=recording.title, tone="small"), Facts(rows=site_facts(recording.site))]
    return Section(title="Sites", blocks=tuple(blocks))


# Programme and what was found


def found(recording: RecordedSession, name: str) -> Section | None:
    """Every rest and every turn against the programme, and where the vertical was in the body."""
    if not recording.rests:
        return None
    positions = [_position(rest.attitude) for rest in recording.rests]
    verticals = _verticals(recording)
    blocks: list[Block] = [Text(text=_programme_said(recording))]
    if all(rest.accel is not None for rest in recording.rests):
        columns = recording.readings["accel"].columns if "accel" in recording.readings else ()
        blocks.append(
            Figure(
                svg=overview(f"{name}-time", recording.rests, recording.turns, columns),
                caption="The recording: mean readings of the accelerometers at its numbered rests, and between them "
                "the turns, with their angles as the gyros saw them.",
            )
        )
    blocks.append(_rest_table(recording, positions, verticals))
    if verticals is not None:
        nominal = np.array([p.vertical_b for p in positions if p is not None]).reshape(-1, 3)
        gap = drawings.farthest_from(verticals) / DEGREE
        blocks.append(
            Figure(
                svg=drawings.sphere(name, drawings.Directions(found=verticals, nominal=nominal)),
                caption="Orientation coverage: where the vertical was in the body at each rest, on both sides of the "
                f"sphere. The direction farthest from any rest is {gap:.0f}° away from the nearest.",
                width=drawings.SPHERE,
            )
        )
    if recording.turns:
        blocks.append(_turn_table(recording.turns))
    return Section(title=_titled("Programme and what was found", recording), blocks=tuple(blocks))


def measured(recording: RecordedSession) -> Section | None:
    """Every rest and every turn as numbers, and how they agree with the result."""
    if not recording.rests:
        return residuals(recording, "")
    positions = [_position(rest.attitude) for rest in recording.rests]
    blocks: list[Block] = [
        Text(text=_programme_said(recording)),
        _rest_table(recording, positions, _verticals(recording)),
        *([_turn_table(recording.turns)] if recording.turns else []),
        Text(text=_residuals_said(recording)),
        *([_fit_table(recording.fits)] if recording.fits else []),
    ]
    return Section(title=_titled("What was measured", recording), blocks=tuple(blocks))


def _titled(title: str, recording: RecordedSession) -> str:
    return f"{title}: {recording.title}" if recording.title else title


def _programme_said(recording: RecordedSession) -> str:
    count = f"{len(recording.rests)} rests"
    if recording.programme is None:
        return f"No programme: {count} were found, in attitudes that were not prescribed."
    named = (
        "Positions listed in the session" if recording.programme == "listed" else f"Programme “{recording.programme}”"
    )
    return (
        f"{named}: {count} were found. Off is the angle between the vertical in the body as it was found and as the "
        "programme has it. N, U, E are north, up, east; a code says where body X, Y, Z point and how they are turned."
    )


def _position(code: str | None) -> Position | None:
    """The position of an attitude code; None for what is none."""
    if code is None:
        return None
    try:
        return from_attitudes([code]).positions[0]
    except ProgrammeError:
        return None


def _verticals(recording: RecordedSession) -> Array | None:
    """Vertical in the body (N, 3) at every rest from its corrected reading; None where it cannot be known."""
    readings = [rest.accel.mean for rest in recording.rests if rest.accel is not None]
    if recording.accel is None or len(readings) < len(recording.rests):
        return None
    force = recording.accel.apply(np.array(readings))
    return unit_vector(force)


def _rest_table(
    recording: RecordedSession, positions: Sequence[Position | None], verticals: Array | None
) -> ReportTable:
    several = len({rest.file for rest in recording.rests}) > 1
    warm = any(rest.temperature is not None for rest in recording.rests)
    programmed = any(rest.attitude is not None for rest in recording.rests)
    headings = ["rest", *(["file"] if several else []), *(["position", "code"] if programmed else [])]
    words = tuple(headings.index(heading) for heading in ("position", "code") if heading in headings)
    headings += ["start s", "stop s"]
    headings += ["X", "Y", "Z"] if verticals is not None else []
    headings += ["off °"] if programmed and verticals is not None else []
    headings += ["residual µg", "sigmas", *(["T °C"] if warm else [])]
    rows = []
    for i, rest in enumerate(recording.rests):
        row = [str(i + 1), *([str(rest.file + 1)] if several else [])]
        position = positions[i]
        code = NONE if rest.attitude is None else short_code(rest.attitude)
        row += [NONE if position is None else position.label, code] if programmed else []
        row += [fixed(rest.start, 1), fixed(rest.stop, 1)]
        if verticals is not None:
            row += [fixed(float(v), 3) for v in verticals[i]]
            row += [_off(position, verticals[i])] if programmed else []
        row += [fixed(figures.micro_g(rest.residual), 1), fixed(rest.sigmas, 1)]
        row += [NONE if rest.temperature is None else fixed(rest.temperature, 1)] if warm else []
        rows.append(tuple(row))
    caption = "Rests." if verticals is None else "Rests. X, Y, Z: the vertical in the body as it was found."
    return ReportTable(columns=tuple(headings), rows=tuple(rows), text=words, caption=caption, dense=True)


def _off(position: Position | None, vertical: Array) -> str:
    if position is None:
        return NONE
    nominal = position.vertical_b
    return fixed(math.atan2(np.linalg.norm(np.cross(nominal, vertical)), nominal @ vertical) / DEGREE, 2)


def _turn_table(turns: Sequence[TurnResult]) -> ReportTable:
    programmed = any(turn.programmed is not None for turn in turns)
    columns = ("turn from rest", "duration s", *(("programme °",) if programmed else ()), "found °", "sigmas")
    rows = tuple(
        (
            f"{turn.first + 1} to {turn.last + 1}",
            fixed(turn.duration, 1),
            *((_degrees(turn.programmed, 0),) if programmed else ()),
            _degrees(turn.angle, 2),
            fixed(turn.sigmas, 1),
        )
        for turn in turns
    )
    caption = "Turns. Found is the whole angle between two rests as the calibrated gyros saw it (0 to 180°)."
    return ReportTable(columns=columns, rows=rows, caption=caption, dense=True, halves=len(rows) > _MOST_TURNS)


def _degrees(angle: float | None, digits: int) -> str:
    return NONE if angle is None else fixed(angle / DEGREE, digits)


# Residuals


def residuals(recording: RecordedSession, name: str) -> Section | None:
    """The plot of residuals, and what chi-square says of them."""
    if not recording.rests:
        table = (_fit_table(recording.fits),) if recording.fits else ()
        return Section(title=_titled("Residuals", recording), blocks=table) if table else None
    blocks: list[Block] = [
        Text(text=_residuals_said(recording)),
        Figure(
            svg=figures.residuals(name, recording.rests, recording.turns),
            caption="Residual of every rest, and how far rests and turns are from the fit.",
        ),
    ]
    if recording.fits:
        blocks.append(_fit_table(recording.fits))
    return Section(title=_titled("Residuals", recording), blocks=tuple(blocks))


def _residuals_said(recording: RecordedSession) -> str:
    rms = math.sqrt(sum(rest.residual**2 for rest in recording.rests) / len(recording.rests))
    worst = max(recording.rests, key=lambda rest: abs(rest.residual))
    return (
        "The corrected readings of the accelerometers at rest miss g by "
        f"{significant(figures.micro_g(rms), 3)} µg (rms), at most by "
        f"{significant(figures.micro_g(abs(worst.residual)), 3)} µg (rest {recording.rests.index(worst) + 1})."
    )


def _fit_table(fits: Mapping[str, Fit]) -> ReportTable:
    rows = []
    for name, fit in fits.items():
        size, unit = engineering(fit.scatter_unit, fit.scatter)
        scatter = f"{significant(fit.scatter / size, 3)} {unit}" if fit.scatter > 0.0 else "none"
        chance = fixed(fit.probability, 2) if fit.degrees >= 0.5 else NONE
        rows.append((name, fixed(fit.chi_square, 1), fixed(fit.degrees, 1), chance, scatter))
    return ReportTable(
        columns=("residuals of", "chi-square", "degrees of freedom", "probability", "scatter added"),
        rows=tuple(rows),
        caption="Probability: of a larger chi-square by chance alone. Scatter added: what the residuals show beyond "
        "the noise within rests; it is in every uncertainty.",
    )


# Noise and drift


def noise(recording: RecordedSession, name: str) -> Section | None:
    """Noise density and drift of every sensor over the rests."""
    kinds = [kind for kind in ("accel", "gyro") if _seen(recording, kind)]
    if not kinds:
        return None
    sensors = {kind: _sensor_names(recording, kind) for kind in kinds}
    rows = [row for kind in kinds for row in _noise_rows(_seen(recording, kind), sensors[kind], kind)]
    blocks: list[Block] = [
        ReportTable(
            columns=("sensor", "noise density, median", "drift over a rest, rms", "drift, largest"),
            rows=tuple(rows),
            caption="Noise density: of the mean of a rest, whatever the colour of the noise. Drift: the change of a "
            "reading over a rest.",
        ),
        Figure(
            svg=figures.noise_and_drift(name, recording.rests, sensors),
            caption="Noise and drift at every rest" + _warmth(recording.rests) + ".",
        ),
    ]
    return Section(title=_titled("Noise and drift of the rests", recording), blocks=tuple(blocks))


def _seen(recording: RecordedSession, kind: str) -> list[SensorsAtRest]:
    seen = [getattr(rest, kind) for rest in recording.rests]
    return [] if any(each is None for each in seen) else seen


def _sensor_names(recording: RecordedSession, kind: str) -> tuple[str, ...]:
    """Names of the sensors: their columns in the log, else numbers."""
    if kind in recording.readings:
        return recording.readings[kind].columns
    return tuple(f"{kind} {i}" for i in range(len(_seen(recording, kind)[0].mean)))


def _noise_rows(seen: Sequence[SensorsAtRest], sensors: Sequence[str], kind: str) -> list[tuple[str, ...]]:
    si = {"accel": "m/s^2", "gyro": "rad/s"}[kind]
    density, drift = np.array([s.noise for s in seen]), np.array([s.drift for s in seen])
    rows = []
    for i, sensor in enumerate(sensors):
        middle, rms = float(np.median(density[:, i])), float(np.sqrt(np.mean(drift[:, i] ** 2)))
        largest = float(drift[np.argmax(np.abs(drift[:, i])), i])
        cells = []
        for value, per in ((middle, "/√Hz"), (rms, ""), (largest, "")):
            size, unit = engineering(si, value)
            cells.append(f"{significant(value / size, 3)} {unit}{per}")
        rows.append((sensor, *cells))
    return rows


def _warmth(rests: Sequence[RestResult]) -> str:
    seen = [rest.temperature for rest in rests if rest.temperature is not None]
    if not seen:
        return "; the recording has no temperature"
    return f", and the temperature: {_span(seen)}"


def temperature(all_of_them: Sequence[RecordedSession]) -> str:
    """The range of temperatures of the rests."""
    seen = [rest.temperature for r in all_of_them for rest in r.rests if rest.temperature is not None]
    return f"{_span(seen)} (sensors)" if seen else "not recorded"


def _span(celsius: Sequence[float]) -> str:
    """The lowest to the highest temperature, one where they are shown alike."""
    return " to ".join(dict.fromkeys((fixed(min(celsius), 1), fixed(max(celsius), 1)))) + " °C"
