"""The recording in a report: site, programme and what was found, residuals, noise and drift of the rests."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from tumble.diagnosis.site_gravity import against_normal
from tumble.errors import ProgrammeError
from tumble.inference.estimate import Fit
from tumble.programme.positions import Position, from_attitudes
from tumble.programme.sheet_words import short_code
from tumble.recording.session import Site
from tumble.result.calibration import Calibration
from tumble.result.parts import Launch, Readings, RestResult, SensorsAtRest, TurnResult
from tumble.rotation import unit_vector
from tumble.sensors.model import SensorModel
from tumble.units import DEGREE, G_STANDARD, Array, engineering
from tumble.views.blocks import Block, Facts, Figure, Section, Table, Text, section, table
from tumble.views.numbers import NONE, fixed, in_engineering, significant
from tumble.views.recording_picture import overview
from tumble.views.report import drawings, figures

MICRO_G = 1e-6 * G_STANDARD
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
        return section("Site", Facts(rows=site_facts(all_of_them[0].site)))
    blocks: list[Block] = []
    for recording in all_of_them:
        blocks += [Text(text=recording.title, tone="small"), Facts(rows=site_facts(recording.site))]
    return section("Sites", *blocks)


# Programme and what was found


def found(recording: RecordedSession, name: str) -> Section | None:
    """Every rest and every turn against the programme, and where the vertical was in the body."""
    if not recording.rests:
        return None
    time, sphere, verticals = None, None, _verticals(recording)
    if all(rest.accel is not None for rest in recording.rests):
        columns = recording.readings["accel"].columns if "accel" in recording.readings else ()
        time = Figure(
            svg=overview(f"{name}-time", recording.rests, recording.turns, columns),
            caption="The recording: mean readings of the accelerometers at its numbered rests, and between them "
            "the turns, with their angles as the gyros saw them.",
        )
    if verticals is not None:
        positions = (_position(rest.attitude) for rest in recording.rests)
        nominal = np.array([p.vertical_b for p in positions if p is not None]).reshape(-1, 3)
        gap = drawings.farthest_from(verticals) / DEGREE
        sphere = Figure(
            svg=drawings.sphere(name, drawings.Directions(found=verticals, nominal=nominal)),
            caption="Orientation coverage: where the vertical was in the body at each rest, on both sides of the "
            f"sphere. The direction farthest from any rest is {gap:.0f}° away from the nearest.",
            width=drawings.SPHERE,
        )
    title, said = _titled("Programme and what was found", recording), Text(text=_programme_said(recording))
    return section(title, said, time, _rest_table(recording), sphere, _turn_table(recording.turns))


def measured(recording: RecordedSession) -> Section | None:
    """Every rest and every turn as numbers, and how they agree with the result."""
    if not recording.rests:
        return residuals(recording, "")
    rests, turns, *fits = tables_of(recording)
    said, residual = Text(text=_programme_said(recording)), Text(text=f"{rests_said(recording)}.")
    return section(_titled("What was measured", recording), said, rests, turns, residual, *fits)


def tables_of(recording: RecordedSession) -> list[Table | None]:
    """Rests, turns and fits."""
    rests = _rest_table(recording) if recording.rests else None
    return [rests, _turn_table(recording.turns), _fit_table(recording.fits)]


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


def _rest_table(recording: RecordedSession) -> Table:
    several, verticals = len({rest.file for rest in recording.rests}) > 1, _verticals(recording)
    warm = any(rest.temperature is not None for rest in recording.rests)
    programmed = any(rest.attitude is not None for rest in recording.rests)
    rows = []
    for i, rest in enumerate(recording.rests):
        position = _position(rest.attitude)
        row = {"rest": str(i + 1)} | ({"file": str(rest.file + 1)} if several else {})
        if programmed:
            row["position"] = NONE if position is None else position.label
            row["code"] = NONE if rest.attitude is None else short_code(rest.attitude)
        row |= {"start s": f"{rest.start:z.1f}", "stop s": f"{rest.stop:z.1f}"}
        if verticals is not None:
            row |= {axis: f"{v:z.3f}" for axis, v in zip("XYZ", verticals[i], strict=True)}
            row |= {"off °": _off(position, verticals[i])} if programmed else {}
        row |= {"residual µg": f"{rest.residual / MICRO_G:z.1f}", "sigmas": f"{rest.sigmas:.1f}"}
        row |= {"T °C": "" if rest.temperature is None else f"{rest.temperature:z.1f}"} if warm else {}
        rows.append(row)
    caption = "Rests." if verticals is None else "Rests. X, Y, Z: the vertical in the body as it was found."
    return table(rows, words=("position", "code"), caption=caption, dense=True)


def _off(position: Position | None, vertical: Array) -> str:
    if position is None:
        return ""
    nominal = position.vertical_b
    return fixed(math.atan2(np.linalg.norm(np.cross(nominal, vertical)), nominal @ vertical) / DEGREE, 2)


def _turn_table(turns: Sequence[TurnResult]) -> Table | None:
    programmed = any(turn.programmed is not None for turn in turns)
    rows = []
    for turn in turns:
        row = {"turn from rest": f"{turn.first + 1} to {turn.last + 1}", "duration s": f"{turn.duration:.1f}"}
        row |= {"programme °": _degrees(turn.programmed, 0)} if programmed else {}
        rows.append(row | {"found °": _degrees(turn.angle, 2), "sigmas": f"{turn.sigmas:.1f}"})
    caption = "Turns. Found is the whole angle between two rests as the calibrated gyros saw it (0 to 180°)."
    halves = len(rows) > _MOST_TURNS
    return table(rows, words=("turn from rest",), caption=caption, dense=True, halves=halves) if rows else None


def _degrees(angle: float | None, digits: int) -> str:
    return "" if angle is None else f"{angle / DEGREE:z.{digits}f}"


# Residuals


def residuals(recording: RecordedSession, name: str) -> Section | None:
    """The plot of residuals, and what chi-square says of them."""
    title, fits = _titled("Residuals", recording), _fit_table(recording.fits)
    if not recording.rests:
        return section(title, fits) if fits else None
    picture = Figure(
        svg=figures.residuals(name, recording.rests, recording.turns),
        caption="Residual of every rest, and how far rests and turns are from the fit.",
    )
    return section(title, Text(text=f"{rests_said(recording)}."), picture, fits)


def rests_said(recording: RecordedSession) -> str:
    """How far the corrected readings at rest are from g, and turns from the fit."""
    rests, turns = recording.rests, recording.turns
    rms = math.sqrt(sum(rest.residual**2 for rest in rests) / len(rests))
    worst = max(range(len(rests)), key=lambda i: abs(rests[i].residual))
    size, unit = engineering("m/s^2", rms)
    said = (
        f"{len(rests)} rests: corrected readings miss g by {rms / size:.3g} {unit} (rms), at most by "
        f"{abs(rests[worst].residual) / size:.3g} {unit} (rest {worst + 1})"
    )
    if not turns:
        return said
    return f"{said}; {len(turns)} turns, the worst {max(turn.sigmas for turn in turns):z.1f} sigma from the fit"


def _fit_table(fits: Mapping[str, Fit]) -> Table | None:
    """What chi-square says of each kind of residuals, and the scatter that was added."""
    if not fits:
        return None
    return table(
        [
            {
                "residuals of": name,
                "chi-square": f"{fit.chi_square:.1f}",
                "degrees of freedom": f"{fit.degrees:.1f}",
                "probability": f"{fit.probability:.2f}" if checked(fit) else "",
                "scatter added": in_engineering(fit.scatter_unit, fit.scatter) if fit.scatter > 0.0 else "none",
            }
            for name, fit in fits.items()
        ],
        words=("residuals of",),
        caption="Probability: of a larger chi-square by chance alone. Scatter added: what the residuals show beyond "
        "the noise within rests; it is in every uncertainty.",
    )


def checked(fit: Fit) -> bool:
    """Whether there are more data than unknowns."""
    return fit.degrees >= 0.5


# Noise and drift


def noise(recording: RecordedSession, name: str) -> Section | None:
    """Noise density and drift of every sensor over the rests."""
    kinds = [kind for kind in ("accel", "gyro") if _seen(recording, kind)]
    if not kinds:
        return None
    sensors = {kind: _sensor_names(recording, kind) for kind in kinds}
    rows = [row for kind in kinds for row in _noise_rows(_seen(recording, kind), sensors[kind], kind)]
    blocks: list[Block] = [
        table(
            rows,
            words=("sensor",),
            caption="Noise density: of the mean of a rest, whatever the colour of the noise. Drift: the change of a "
            "reading over a rest.",
        ),
        Figure(
            svg=figures.noise_and_drift(name, recording.rests, sensors),
            caption="Noise and drift at every rest" + _warmth(recording.rests) + ".",
        ),
    ]
    return section(_titled("Noise and drift of the rests", recording), *blocks)


def _seen(recording: RecordedSession, kind: str) -> list[SensorsAtRest]:
    seen = [getattr(rest, kind) for rest in recording.rests]
    return [] if any(each is None for each in seen) else seen


def _sensor_names(recording: RecordedSession, kind: str) -> tuple[str, ...]:
    """Names of the sensors: their columns in the log, else numbers."""
    if kind in recording.readings:
        return recording.readings[kind].columns
    return tuple(f"{kind} {i}" for i in range(len(_seen(recording, kind)[0].mean)))


def _noise_rows(seen: Sequence[SensorsAtRest], sensors: Sequence[str], kind: str) -> list[dict[str, str]]:
    si, rows = {"accel": "m/s^2", "gyro": "rad/s"}[kind], []
    density, drift = np.array([s.noise for s in seen]), np.array([s.drift for s in seen])
    for i, sensor in enumerate(sensors):
        row = {"sensor": sensor}
        for heading, value, per in (
            ("noise density, median", float(np.median(density[:, i])), "/√Hz"),
            ("drift over a rest, rms", float(np.sqrt(np.mean(drift[:, i] ** 2))), ""),
            ("drift, largest", float(drift[np.argmax(np.abs(drift[:, i])), i]), ""),
        ):
            size, unit = engineering(si, value)
            row[heading] = f"{significant(value / size, 3)} {unit}{per}"
        rows.append(row)
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
