"""Rests and turns of a recording: tables, and a picture of the readings over time, files side by side."""

from __future__ import annotations

import math
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tumble.reduction.observations import Observations
from tumble.rotation import rotation_vector
from tumble.run.gyros_alone import WHAT_TO_RECORD, GyroRests
from tumble.run.observed import Observed
from tumble.units import DEGREE, DEGREE_PER_HOUR, G_STANDARD, ZERO_CELSIUS
from tumble.views.blocks import Block, Items, Table, table
from tumble.views.render.characters import drawable
from tumble.views.render.pictures import COLOURS, write_picture

if TYPE_CHECKING:
    from matplotlib.figure import Figure

UPRIGHT = 0.98  # cosine of 11°: an axis nearer to the vertical is up or down

_REST_COLOUR, _TURN_COLOUR = "#e3e8ee", "#f6e3d6"
_MAX_NUMBERED = 40  # rests in a picture


def inspection_blocks(observed: Observed) -> list[Block]:
    """Return the rests, turns and rejected stretches of a log."""
    segmentation, observations = observed.segmentation, observed.observations
    limits = f"thresholds found: accelerometer scatter {segmentation.scatter_limit:.3g} m/s²"
    if segmentation.rate_limit is not None:
        limits += f", distance from the rest level of the gyros {segmentation.rate_limit / DEGREE:.3g} °/s"
    blocks: list[Block] = [limits]
    if observations is not None:
        turns = _turn_table(observations)
        blocks += [_rest_table(observations), turns or "no turns between rests"]
        blocks += [Items(items=tuple(lines)) for lines in (_half_sums(observations), observations.notes) if lines]
    if segmentation.rejected:
        rejected = [
            {"rejected from s": f"{r.start:z.1f}", "to s": f"{r.stop:z.1f}", "because": r.reason}
            for r in segmentation.rejected
        ]
        blocks.append(table(rejected, words=("because",), caption="\n".join(segmentation.unused())))
    return blocks


def gyro_blocks(gyro_rests: GyroRests) -> list[Block]:
    """Return the rests of a log of gyros alone, with their means."""
    rows = []
    for i, rest in enumerate(gyro_rests.segmentation.rests):
        means = {f"{axis} °/s": f"{value / DEGREE:z.4f}" for axis, value in zip("xyz", gyro_rests.mean[i], strict=True)}
        times = {"rest": str(i + 1), "from s": f"{rest.start:z.1f}", "to s": f"{rest.stop:z.1f}"}
        rows.append(times | means)
    unit = "; their unit is not known, so that the numbers are not °/s: state --gyro-unit"
    return [
        "gyros alone: rests by the level of the gyros" + ("" if gyro_rests.session.log.accel.scale_stated else unit),
        table(rows),
        f"for biases: tumble calibrate; for noise: tumble noise; for scale factors and axes {WHAT_TO_RECORD}",
    ]


def _verticals(observations: Observations) -> np.ndarray:
    """Return the vertical in the body frame (N, 3) at every rest, by the nominal axes."""
    force = observations.accel_block.nominal().apply(observations.rests.accel)
    return np.asarray(force / np.linalg.norm(force, axis=1, keepdims=True))


def _rest_table(observations: Observations) -> Table:
    """Return a table of the rests: vertical, u of a mean (root mean square over the sensors) and largest drift."""
    rests, verticals, shown = observations.rests, _verticals(observations), []
    several = len(set(rests.file.tolist())) > 1
    kinds = [("accel", "µg", 1e-6 * G_STANDARD), ("gyro", "°/h", DEGREE_PER_HOUR)][: 1 + bool(rests.gyro.shape[1])]
    for i in range(len(rests)):
        row = {"rest": str(i + 1)} | ({"file": str(rests.file[i] + 1)} if several else {})
        row |= {"start s": f"{rests.start[i]:z.1f}", "stop s": f"{rests.stop[i]:z.1f}"}
        row["vertical in the body"] = " ".join(f"{v:+z.3f}" for v in verticals[i])
        for kind, unit, size in kinds:
            covariance, drift = getattr(rests, f"{kind}_covariance")[i], getattr(rests, f"{kind}_drift")[i]
            row[f"u of {kind} {unit}"] = f"{math.sqrt(float(np.trace(covariance)) / len(covariance)) / size:.3g}"
            row[f"drift {unit}"] = f"{float(drift[np.argmax(np.abs(drift))]) / size:+z.3g}"
        if rests.temperature is not None:
            row["T °C"] = f"{rests.temperature[i] - ZERO_CELSIUS:.1f}"
        shown.append(row)
    return table(shown, words=())


def _turn_table(observations: Observations) -> Table | None:
    """Return a table of the turns: duration, angle and axis, which is empty near 0 and 180°."""
    turns, shown = observations.turns, []
    if turns is None or len(turns) == 0:
        return None
    for k, vector in enumerate(rotation_vector(turns.C)):
        angle = float(np.linalg.norm(vector))
        row = {"turn": str(k + 1), "from rest": str(turns.first[k] + 1), "to rest": str(turns.last[k] + 1)}
        row |= {"duration s": f"{turns.duration[k]:.1f}", "angle °": f"{angle / DEGREE:.1f}"}
        about = " ".join(f"{v:+z.2f}" for v in vector / angle) if math.sin(angle) > 1e-3 else ""
        shown.append(row | {"axis in the body": about})
    return table(shown, words=())


def _half_sums(observations: Observations) -> list[str]:
    """Return half sum and half difference of the mean readings of each axis that rested both up and down: its bias and
    sensitivity before any correction."""
    rests, lines = observations.rests, []
    if observations.accel_block.size != 3:
        return []
    verticals = _verticals(observations)
    for axis, name in enumerate("XYZ"):
        up, down = verticals[:, axis] > UPRIGHT, verticals[:, axis] < -UPRIGHT
        if not (up.any() and down.any()):
            continue
        high, low = rests.accel[up, axis].mean(), rests.accel[down, axis].mean()
        above, below = (", ".join(str(i + 1) for i in np.flatnonzero(which)) for which in (up, down))
        line = (
            f"{name} up (rests {above}) and down ({below}): accelerometer half sum "
            f"{0.5 * (high + low) / G_STANDARD * 1e6:+z.1f} µg, half difference {0.5 * abs(high - low):.6f} m/s²"
        )
        if rests.gyro.shape[1] == 3:
            high, low = rests.gyro[up, axis].mean() / DEGREE_PER_HOUR, rests.gyro[down, axis].mean() / DEGREE_PER_HOUR
            line += f"; gyro half sum {0.5 * (high + low):+z.3f} °/h, half difference {0.5 * abs(high - low):.3f} °/h"
        lines.append(line)
    return lines


# -------------------- pictures --------------------


def plot(observed: Observed, path: Path) -> None:
    """Plot the readings of a session with its rests and turns, as svg, png or pdf by the suffix of the file.

    Raises MissingExtraError without matplotlib, InputError for another suffix."""
    files, log = observed.reduction.files, observed.session.log
    durations = [float(file.edges[-1] - file.edges[0]) for file in files]
    starts = [0.0, *np.cumsum(durations).tolist()][:-1]
    shifts = [start - float(file.edges[0]) for start, file in zip(starts, files, strict=True)]
    rests = [(r.start + shifts[r.file], r.stop + shifts[r.file], r.file) for r in observed.segmentation.rests]
    spans = [(start, stop, _REST_COLOUR) for start, stop, _ in rests]
    spans += [(before[1], after[0], _TURN_COLOUR) for before, after in pairwise(rests) if before[2] == after[2]]
    panels = [("accel", log.accel, 1.0, "m/s²")] + ([("gyro", log.gyro, DEGREE, "°/s")] if log.gyro else [])

    def draw(figure: Figure) -> None:
        all_axes = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
        for axes, (kind, channels, size, unit) in zip(all_axes, panels, strict=True):
            assert channels is not None
            for i, column in enumerate(channels.columns):
                for file, start in zip(files, starts, strict=True):
                    middle = 0.5 * (file.edges[1:] + file.edges[:-1]) - file.edges[0] + start
                    label = drawable(column) if file is files[0] else None
                    values = getattr(file, kind).means[:, i] / size
                    axes.plot(middle, values, color=COLOURS[i % len(COLOURS)], linewidth=0.8, label=label)
            for start, stop, colour in spans:
                axes.axvspan(start, stop, color=colour, linewidth=0.0, zorder=0)
            axes.margins(x=0.005)
            axes.set_ylabel(unit)
            axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
        for number in range(0, len(rests), math.ceil(len(rests) / _MAX_NUMBERED) or 1):
            above: dict[str, Any] = {"xycoords": ("data", "axes fraction"), "ha": "center", "va": "bottom"}
            middle = 0.5 * (rests[number][0] + rests[number][1])
            all_axes[0].annotate(str(number + 1), (middle, 1.0), fontsize=7.0, **above)
        all_axes[-1].set_xlabel("time, s")

    write_picture(path, "a picture of the recording", (10.0, 5.0), draw)
