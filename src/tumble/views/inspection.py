"""Rests and turns found in a recording, and the recording as a picture."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tumble.calibration.observed import Observed
from tumble.reduction.observations import Observations
from tumble.units import DEGREE, DEGREE_PER_HOUR, G_STANDARD, ZERO_CELSIUS, BoolArray
from tumble.views.blocks import Block, Items, Table, Text, table
from tumble.views.recording_picture import draw_recording
from tumble.views.render.pictures import STYLE, write_picture

if TYPE_CHECKING:
    from matplotlib.figure import Figure

UPRIGHT = 0.98  # an axis within 11° of the vertical is up or down


def inspection_blocks(observed: Observed) -> list[Block]:
    """Rests, turns and rejected stretches of a log."""
    segmentation, observations = observed.segmentation, observed.observations
    limits = f"thresholds found: accelerometer scatter {segmentation.scatter_limit:.3g} m/s²"
    if segmentation.rate_limit is not None:
        limits += f", distance from the rest level of the gyros {segmentation.rate_limit / DEGREE:.3g} °/s"
    blocks: list[Block] = [Text(text=limits)]
    if observations is not None:
        turns = _turn_table(observations)
        blocks += [_rest_table(observations), turns or Text(text="no turns between rests")]
        blocks += [Items(items=tuple(lines)) for lines in (_half_sums(observations), observations.notes) if lines]
    if segmentation.rejected:
        rows = [
            {"rejected from s": f"{r.start:z.1f}", "to s": f"{r.stop:z.1f}", "because": r.reason}
            for r in segmentation.rejected
        ]
        blocks.append(table(rows, words=("because",), caption="\n".join(segmentation.unused())))
    return blocks


def _verticals(observations: Observations) -> np.ndarray:
    """Vertical in the body (N, 3) at every rest, by the nominal axes."""
    force = observations.accel_block.nominal().apply(observations.rests.accel)
    return np.asarray(force / np.linalg.norm(force, axis=1, keepdims=True))


def _rest_table(observations: Observations) -> Table:
    rests, verticals, rows = observations.rests, _verticals(observations), []
    files = len(set(rests.file.tolist())) > 1
    for i in range(len(rests)):
        row = {"rest": str(i + 1)} | ({"file": str(rests.file[i] + 1)} if files else {})
        row |= {"start s": f"{rests.start[i]:z.1f}", "stop s": f"{rests.stop[i]:z.1f}"}
        row["vertical in the body"] = " ".join(f"{v:+z.3f}" for v in verticals[i])
        u, drift = _noise(rests.accel_covariance[i], rests.accel_drift[i], G_STANDARD * 1e-6)
        row |= {"u of accel µg": u, "drift µg": drift}
        if rests.gyro.shape[1]:
            u, drift = _noise(rests.gyro_covariance[i], rests.gyro_drift[i], DEGREE_PER_HOUR)
            row |= {"u of gyro °/h": u, "drift °/h": drift}
        if rests.temperature is not None:
            row["T °C"] = f"{rests.temperature[i] - ZERO_CELSIUS:.1f}"
        rows.append(row)
    return table(rows, words=())


def _noise(covariance: np.ndarray, drift: np.ndarray, size: float) -> tuple[str, str]:
    """u of a mean, root mean square over the sensors, and the largest drift."""
    u = math.sqrt(float(np.trace(covariance)) / len(covariance)) / size
    return f"{u:.3g}", f"{float(drift[np.argmax(np.abs(drift))]) / size:+z.3g}"


def _turn_table(observations: Observations) -> Table | None:
    turns, rows = observations.turns, []
    if turns is None or len(turns) == 0:
        return None
    for k in range(len(turns)):
        C = turns.C[k]
        axis = np.array([C[2, 1] - C[1, 2], C[0, 2] - C[2, 0], C[1, 0] - C[0, 1]])
        sine = 0.5 * float(np.linalg.norm(axis))
        angle = math.atan2(sine, 0.5 * (float(np.trace(C)) - 1.0)) / DEGREE
        rows.append(
            {
                "turn": str(k + 1),
                "from rest": str(turns.first[k] + 1),
                "to rest": str(turns.last[k] + 1),
                "duration s": f"{turns.duration[k]:.1f}",
                "angle °": f"{angle:.1f}",
                "axis in the body": " ".join(f"{v:+z.2f}" for v in axis / (2.0 * sine)) if sine > 1e-3 else "",
            }
        )
    return table(rows, words=())


def _half_sums(observations: Observations) -> list[str]:
    """For each body axis that rested both up and down: half sum and half difference of the mean readings of its
    sensors, which are bias and sensitivity before any correction."""
    rests, lines = observations.rests, []
    if observations.accel_block.size != 3:
        return []
    verticals = _verticals(observations)
    for axis, name in enumerate("XYZ"):
        up, down = verticals[:, axis] > UPRIGHT, verticals[:, axis] < -UPRIGHT
        if not (up.any() and down.any()):
            continue
        high, low = rests.accel[up, axis].mean(), rests.accel[down, axis].mean()
        line = (
            f"{name} up (rests {_numbers(up)}) and down ({_numbers(down)}): accelerometer half sum "
            f"{0.5 * (high + low) / G_STANDARD * 1e6:+z.1f} µg, half difference {0.5 * abs(high - low):.6f} m/s²"
        )
        if rests.gyro.shape[1] == 3:
            high, low = rests.gyro[up, axis].mean() / DEGREE_PER_HOUR, rests.gyro[down, axis].mean() / DEGREE_PER_HOUR
            line += f"; gyro half sum {0.5 * (high + low):+z.3f} °/h, half difference {0.5 * abs(high - low):.3f} °/h"
        lines.append(line)
    return lines


def _numbers(chosen: BoolArray) -> str:
    """Numbers of rests, counted from 1."""
    return ", ".join(str(i + 1) for i in np.flatnonzero(chosen))


def plot(observed: Observed, path: Path) -> None:
    """Write the recording of a session with its rests and turns as svg, png or pdf by the ending of the file.

    Raises MissingExtraError without matplotlib, InputError for another ending."""

    def draw(figure: Figure) -> None:
        draw_recording(figure, observed)

    write_picture(path, "a picture of the recording", (10.0, 5.0), draw, STYLE)
