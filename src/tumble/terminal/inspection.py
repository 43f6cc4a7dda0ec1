"""Rests and turns found in a recording, as text."""

from __future__ import annotations

import math

import numpy as np
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from tumble.calibration.observed import Observed
from tumble.reduction.observations import Observations
from tumble.terminal.table import add_numbers, plain_table
from tumble.units import DEGREE, DEGREE_PER_HOUR, G_STANDARD, ZERO_CELSIUS, BoolArray

UPRIGHT = 0.98  # an axis within 11° of the vertical is up or down


def inspection_report(observed: Observed) -> RenderableType:
    """Rests, turns and rejected stretches of a log."""
    segmentation, observations = observed.segmentation, observed.observations
    limits = f"thresholds found: accelerometer scatter {segmentation.scatter_limit:.3g} m/s²"
    if segmentation.rate_limit is not None:
        limits += f", distance from the rest level of the gyros {segmentation.rate_limit / DEGREE:.3g} °/s"
    parts: list[RenderableType] = [Text(limits), Text("")]
    if observations is not None:
        parts += [_rests_found(observations), Text(""), _turns_found(observations)]
        parts += _half_sums(observations)
        parts += [Text(""), *map(Text, observations.notes)] if observations.notes else []
    if segmentation.rejected:
        table = plain_table()
        add_numbers(table, "rejected from s", "to s")
        table.add_column("because")
        for r in segmentation.rejected:
            table.add_row(f"{r.start:z.1f}", f"{r.stop:z.1f}", r.reason)
        parts += [Text(""), table, *map(Text, segmentation.unused())]
    return Group(*parts)


def _rests_found(observations: Observations) -> Table:
    rests = observations.rests
    force = observations.accel_block.nominal().apply(rests.accel)
    vertical = force / np.linalg.norm(force, axis=1, keepdims=True)
    table = plain_table()
    files = len(set(rests.file.tolist())) > 1
    headings = [
        "rest",
        *(["file"] if files else []),
        "start s",
        "stop s",
        "vertical in the body",
        "u of accel µg",
        "drift µg",
    ]
    gyros = rests.gyro.shape[1] > 0
    headings += ["u of gyro °/h", "drift °/h"] if gyros else []
    headings += ["T °C"] if rests.temperature is not None else []
    add_numbers(table, *headings)
    for i in range(len(rests)):
        row = [
            str(i + 1),
            *([str(rests.file[i] + 1)] if files else []),
            f"{rests.start[i]:z.1f}",
            f"{rests.stop[i]:z.1f}",
        ]
        row.append(" ".join(f"{v:+z.3f}" for v in vertical[i]))
        row += _noise_columns(rests.accel_covariance[i], rests.accel_drift[i], G_STANDARD * 1e-6)
        if gyros:
            row += _noise_columns(rests.gyro_covariance[i], rests.gyro_drift[i], DEGREE / 3600.0)
        if rests.temperature is not None:
            row.append(f"{rests.temperature[i] - ZERO_CELSIUS:.1f}")
        table.add_row(*row)
    return table


def _noise_columns(covariance: np.ndarray, drift: np.ndarray, size: float) -> list[str]:
    u = math.sqrt(float(np.trace(covariance)) / len(covariance)) / size
    worst = float(drift[np.argmax(np.abs(drift))]) / size
    return [f"{u:.3g}", f"{worst:+z.3g}"]


def _turns_found(observations: Observations) -> RenderableType:
    turns = observations.turns
    if turns is None or len(turns) == 0:
        return Text("no turns between rests")
    table = plain_table()
    add_numbers(table, "turn", "from rest", "to rest", "duration s", "angle °", "axis in the body")
    for k in range(len(turns)):
        C = turns.C[k]
        axis = np.array([C[2, 1] - C[1, 2], C[0, 2] - C[2, 0], C[1, 0] - C[0, 1]])
        sine = 0.5 * float(np.linalg.norm(axis))
        angle = math.atan2(sine, 0.5 * (float(np.trace(C)) - 1.0)) / DEGREE
        shown = " ".join(f"{v:+z.2f}" for v in axis / (2.0 * sine)) if sine > 1e-3 else ""
        table.add_row(
            str(k + 1),
            str(turns.first[k] + 1),
            str(turns.last[k] + 1),
            f"{turns.duration[k]:.1f}",
            f"{angle:.1f}",
            shown,
        )
    return table


def _half_sums(observations: Observations) -> list[RenderableType]:
    """For each body axis that rested both up and down: half sum and half difference of the mean readings of its
    sensors, which are bias and sensitivity before any correction."""
    rests = observations.rests
    if observations.accel_block.size != 3:
        return []
    force = observations.accel_block.nominal().apply(rests.accel)
    vertical = force / np.linalg.norm(force, axis=1, keepdims=True)
    lines = []
    for axis, name in enumerate("XYZ"):
        up, down = vertical[:, axis] > UPRIGHT, vertical[:, axis] < -UPRIGHT
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
    return [Text(""), *map(Text, lines)] if lines else []


def _numbers(chosen: BoolArray) -> str:
    """Numbers of rests, counted from 1."""
    return ", ".join(str(i + 1) for i in np.flatnonzero(chosen))
