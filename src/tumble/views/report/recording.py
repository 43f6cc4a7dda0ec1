"""Sections of a report on the recording: site, rests and turns against the programme, residuals."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from tumble.diagnosis.verdict import anomaly_text
from tumble.errors import ProgrammeError
from tumble.inference.estimate import FIT_SIGMAS
from tumble.programme.positions import from_attitudes
from tumble.programme.sheet_words import short_code
from tumble.recording.session import Site
from tumble.result.calibration import Calibration
from tumble.result.further import rest_summary
from tumble.result.parts import Launch, RestResult, TurnResult
from tumble.rotation import unit_vector
from tumble.run.calibrate import ITERATED_METHODS
from tumble.units import DEGREE, G_STANDARD, engineering
from tumble.views.blocks import Block, Facts, Figure, Section, Table, Text, section, table
from tumble.views.numbers import NONE, fixed, in_engineering, minus, significant
from tumble.views.render.pictures import COLOURS, GREY, PAGE_WIDTH, grid, svg_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas

MICRO_G = 1e-6 * G_STANDARD
_MAX_TICKS = 25  # numbers of rests below a figure
_MAX_UNHALVED_TURNS = 8  # rows; a longer table of turns is set in halves


@dataclass(frozen=True, kw_only=True, slots=True)
class RecordedSession:
    """A session of a calibration with the evidence `recorded` in it; with several launches each has a `title`."""

    title: str
    calibration: Calibration
    recorded: Launch

    def titled(self, title: str) -> str:
        """Return the title of a section about this session."""
        return f"{title}: {self.title}" if self.title else title


def recordings(calibration: Calibration) -> list[RecordedSession]:
    """Return the sessions of a calibration: itself, or its launches."""
    return [
        RecordedSession(title=launch.session, calibration=calibration, recorded=launch)
        for launch in calibration.evidence.launches or [calibration.as_launch("")]
    ]


def site_facts(site: Site | None) -> tuple[tuple[str, str], ...]:
    """Return the place, and gravity with its uncertainty."""
    if site is None:
        return (("site", "not in the calibration file"),)
    gravity = f"{fixed(site.gravity, 7)} m/s², U = {significant(2.0 * site.gravity_u, 2)} m/s² (k = 2)"
    if site.gravity_is_unit:
        gravity = f"not stated: g at the place is the unit, {fixed(site.gravity, 5)} m/s² stands for it"
    elif site.gravity_u == 0.0:
        gravity = f"{fixed(site.gravity, 7)} m/s², taken as exact: no uncertainty of it was stated"
    against = None if site.gravity_is_unit else anomaly_text(site)
    gravity += f"; {against}" if against is not None else ""
    if site.latitude is None:
        return (("latitude", NONE), ("gravity", gravity))
    height = "not stated" if site.height is None else f"{fixed(site.height, 1)} m"
    return (("latitude", f"{minus(f'{site.latitude / DEGREE:.8g}')}°"), ("height", height), ("gravity", gravity))


def sites(recordings: Sequence[RecordedSession]) -> Section | None:
    """Return the sites of recordings; None if they are at one site."""
    if all(recording.recorded.site == recordings[0].recorded.site for recording in recordings):
        return None
    blocks: list[Block] = []
    for recording in recordings:
        blocks += [Text(text=recording.title, tone="label"), Facts(rows=site_facts(recording.recorded.site))]
    return section("Sites", *blocks)


# -------------------- rests and turns --------------------


def rests_and_turns(recording: RecordedSession) -> Section | None:
    """Return the section on the rests and turns against the programme."""
    if not recording.recorded.rests:
        return None
    rests, turns, _ = tables_of(recording)
    count, programme = f"{len(recording.recorded.rests)} rests", recording.calibration.provenance.programme
    text = f"No programme: {count} were found, in attitudes that were not prescribed."
    if programme is not None:
        named = "Positions listed in the session" if programme == "listed" else f"Programme “{programme}”"
        text = (
            f"{named}: {count} were found. Off is the angle between the vertical in the body as it was found and as "
            "the programme has it. N, U, E are north, up, east; a code says where body X, Y, Z point and how they are "
            "turned."
        )
    return section(recording.titled("Programme and what was found"), text, rests, turns)


def tables_of(recording: RecordedSession) -> tuple[Table | None, Table | None, Table | None]:
    """Return tables of the rests, turns and fits."""
    rests = _rest_table(recording) if recording.recorded.rests else None
    return rests, _turn_table(recording.recorded.turns), _fit_table(recording)


def _rest_table(recording: RecordedSession) -> Table:
    rests, model, rows, verticals = recording.recorded.rests, recording.calibration.accel, [], None
    several = len({rest.file for rest in rests}) > 1
    warm = any(rest.temperature is not None for rest in rests)
    programmed = any(rest.attitude is not None for rest in rests)
    readings = [rest.accel.mean for rest in rests if rest.accel is not None]
    if model is not None and len(readings) == len(rests):
        verticals = unit_vector(model.apply(np.array(readings)))  # in the body frame
    for i, rest in enumerate(rests):
        position = None
        with suppress(ProgrammeError):  # an attitude that is not in the programme
            position = None if rest.attitude is None else from_attitudes([rest.attitude]).positions[0]
        row = {"rest": str(i + 1)} | ({"file": str(rest.file + 1)} if several else {})
        if programmed:
            row["position"] = NONE if position is None else position.label
            row["code"] = NONE if rest.attitude is None else short_code(rest.attitude)
        row |= {"start s": f"{rest.start:z.1f}", "stop s": f"{rest.stop:z.1f}"}
        if verticals is not None:
            row |= {axis: f"{v:z.3f}" for axis, v in zip("XYZ", verticals[i], strict=True)}
            if programmed:
                row["off °"] = ""
            if position is not None:
                nominal, vertical = position.vertical_b, verticals[i]
                off = math.atan2(np.linalg.norm(np.cross(nominal, vertical)), nominal @ vertical)
                row["off °"] = fixed(off / DEGREE, 2)
        row |= {"residual µg": f"{rest.residual / MICRO_G:z.1f}", "sigmas": f"{rest.sigmas:.1f}"}
        row |= {"T °C": "" if rest.temperature is None else f"{rest.temperature:z.1f}"} if warm else {}
        rows.append(row)
    caption = (
        "Rests. Sigmas: distance from the fit, as standard deviations of a normal distribution of the same probability."
    )
    caption += "" if verticals is None else " X, Y, Z: the vertical in the body as it was found."
    return table(rows, words=("position", "code"), caption=caption, dense=True)


def _turn_table(turns: Sequence[TurnResult]) -> Table | None:
    def degrees(angle: float | None, digits: int) -> str:
        return "" if angle is None else f"{angle / DEGREE:z.{digits}f}"

    programmed, rows = any(turn.programmed is not None for turn in turns), []
    for turn in turns:
        row = {"turn from rest": f"{turn.first + 1} to {turn.last + 1}", "duration s": f"{turn.duration:.1f}"}
        row |= {"programme °": degrees(turn.programmed, 0)} if programmed else {}
        rows.append(row | {"found °": degrees(turn.angle, 2), "sigmas": f"{turn.sigmas:.1f}"})
    caption = "Turns. Found is the whole angle between two rests as the calibrated gyros saw it (0 to 180°)."
    halves = len(rows) > _MAX_UNHALVED_TURNS
    return table(rows, words=("turn from rest",), caption=caption, dense=True, halves=halves) if rows else None


# -------------------- residuals --------------------


def residuals(recording: RecordedSession, name: str) -> Section | None:
    """Return the section on residuals, with a figure if it has a `name`, and chi-square tests."""
    title, fits = recording.titled("Residuals"), _fit_table(recording)
    if not recording.recorded.rests:
        return section(title, fits) if fits else None
    picture = None
    if name:
        svg = _residual_figure(name, recording.recorded.rests, recording.recorded.turns)
        picture = Figure(svg=svg, caption="Residual of every rest, and how far rests and turns are from the fit.")
    return section(title, f"{rest_summary(recording.recorded)}.", picture, fits)


def _residual_figure(name: str, rests: Sequence[RestResult], turns: Sequence[TurnResult]) -> str:
    """Draw the residuals of the rests, and the distance of rests and turns from the fit in sigmas."""
    numbers = np.arange(1, len(rests) + 1)

    def draw(figure: Canvas) -> None:
        top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=(1.25, 1.0))
        values = np.array([rest.residual for rest in rests])
        size, unit = engineering("m/s^2", float(np.sqrt(np.mean(values**2))))
        top.axhline(0.0, color=GREY, linewidth=0.6)
        top.bar(numbers, values / size, width=0.55, color=COLOURS[0])
        top.set(ylabel=unit, title="|corrected reading| − g")
        bottom.plot(numbers, [rest.sigmas for rest in rests], "o", markersize=4, color=COLOURS[0], label="rests")
        if turns:
            between = [0.5 * (turn.first + turn.last) + 1.0 for turn in turns]
            sigmas = [turn.sigmas for turn in turns]
            bottom.plot(between, sigmas, "D", markersize=3.5, color=COLOURS[1], label="turns")
        bottom.axhline(FIT_SIGMAS, color="#b02a2a", linewidth=0.8, linestyle="--", label="limit")
        bottom.set(ylabel="sigmas", xlabel="rest", title="distance from the fit", ylim=(0.0, None))
        figure.legend(*bottom.get_legend_handles_labels(), loc="outside lower right", ncols=3)
        for axes in (top, bottom):
            grid(axes)
        bottom.set_xticks(range(1, len(rests) + 1, math.ceil(len(rests) / _MAX_TICKS)))
        bottom.set_xlim(0.4, len(rests) + 0.6)

    return svg_of(name, PAGE_WIDTH, 3.5, draw)


def _fit_table(recording: RecordedSession) -> Table | None:
    """Return a table of the chi-square of each kind of residuals, and the scatter that was added."""
    method = recording.calibration.method
    rows = [
        {
            "residuals of": name,
            "chi-square": f"{fit.chi_square:.1f}",
            "degrees of freedom": f"{fit.degrees:.1f}",
            "probability": f"{fit.probability:.2f}" if fit.degrees >= 0.5 else "",
            "scatter added": in_engineering(fit.unit, fit.scatter) if fit.scatter > 0.0 else "none",
        }
        for name, fit in recording.recorded.fits.items()
    ]
    caption = (
        "Probability: of a larger chi-square by chance alone. Scatter added: what the residuals show beyond the noise "
        "within rests; it is in every uncertainty. Noise within rests: the residuals if nothing were added."
    )
    if method in ITERATED_METHODS:
        caption += (
            f" These, all sigmas and the angles of turns are of the method joint, whose noise and scatter are in U of "
            f"{method}; the residuals of rests in µg are of {method}."
        )
    return table(rows, words=("residuals of",), caption=caption) if rows else None


def temperature(recordings: Sequence[RecordedSession]) -> str:
    """Return the range of the temperatures of the rests."""
    celsius = [rest.temperature for r in recordings for rest in r.recorded.rests if rest.temperature is not None]
    if not celsius:
        return "not recorded" if any(r.recorded.rests for r in recordings) else NONE
    return " to ".join(dict.fromkeys([fixed(min(celsius), 1), fixed(max(celsius), 1)])) + " °C (sensors)"
