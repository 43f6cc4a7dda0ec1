"""Results as text on a terminal: rests and turns found, noise, budgets. `calibration_text` has the calibrations."""

from __future__ import annotations

import io
import math
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from rich.console import Console, Group, RenderableType
from rich.table import Table
from rich.text import Text

from tumble.observe import Observations
from tumble.plain_table import add_numbers, plain_table
from tumble.results import Parameter
from tumble.segment import Segmentation
from tumble.units import DEGREE, DEGREE_PER_HOUR, G_STANDARD, BoolArray, engineering

if TYPE_CHECKING:
    from tumble.bounds import Bound
    from tumble.budget import Budget
    from tumble.noise import Panel
    from tumble.require import Requirements

UPRIGHT = 0.98  # an axis within 11° of the vertical is up or down


def _group(parameter: Parameter) -> str:
    return ".".join(parameter.name.split(".")[:2])


def shown_units(parameters: Sequence[Parameter]) -> dict[str, tuple[float, str]]:
    """The unit in which each parameter is shown, by its name, as (size in SI, unit): one for all of a kind, by their
    root mean square."""
    kinds: dict[str, list[Parameter]] = {}
    for p in parameters:
        kinds.setdefault(_group(p), []).append(p)
    of_kind = {
        kind: engineering(alike[0].unit, math.sqrt(sum(p.value**2 for p in alike) / len(alike)))
        for kind, alike in kinds.items()
    }
    return {p.name: of_kind[_group(p)] for p in parameters}


def noise_report(source: str, panels: Sequence[Panel]) -> RenderableType:
    """Noise coefficients of every channel."""
    from tumble.noise import shown  # it loads more of SciPy than the other commands need

    table = plain_table("sensor", "noise", "symbol")
    add_numbers(table, "value", "u (k=1)")
    table.add_column("unit")
    for panel in panels:
        for channel, parameters in zip(panel.channels, panel.parameters, strict=True):
            coefficients = shown(parameters, panel.unit)
            for c in coefficients:
                table.add_row(channel, c.name, c.symbol, c.value, c.u, c.unit)
            if not coefficients:
                table.add_row(channel, "none that the record shows")
    return Group(Text(source), Text(""), table)


def inspection_report(segmentation: Segmentation, observations: Observations | None) -> RenderableType:
    """Rests, turns and rejected stretches of a log."""
    limits = f"thresholds found: accelerometer scatter {segmentation.scatter_limit:.3g} m/s²"
    if segmentation.rate_limit is not None:
        limits += f", distance from the rest level of the gyros {segmentation.rate_limit / DEGREE:.3g} °/s"
    parts: list[RenderableType] = [Text(limits), Text("")]
    if observations is not None:
        parts += [_rests_found(observations), Text(""), _turns_found(observations)]
        parts += _half_sums(observations)
    if segmentation.rejected:
        table = plain_table()
        add_numbers(table, "rejected from s", "to s")
        table.add_column("because")
        for r in segmentation.rejected:
            table.add_row(f"{r.start:z.1f}", f"{r.stop:z.1f}", r.reason)
        parts += [Text(""), table]
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
        row.append(" ".join(f"{v:+.3f}" for v in vertical[i]))
        row += _noise_columns(rests.accel_covariance[i], rests.accel_drift[i], G_STANDARD * 1e-6)
        if gyros:
            row += _noise_columns(rests.gyro_covariance[i], rests.gyro_drift[i], DEGREE / 3600.0)
        if rests.temperature is not None:
            row.append(f"{rests.temperature[i]:.1f}")
        table.add_row(*row)
    return table


def _noise_columns(covariance: np.ndarray, drift: np.ndarray, size: float) -> list[str]:
    u = math.sqrt(float(np.trace(covariance)) / len(covariance)) / size
    worst = float(drift[np.argmax(np.abs(drift))]) / size
    return [f"{u:.3g}", f"{worst:+.3g}"]


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
        shown = " ".join(f"{v:+.2f}" for v in axis / (2.0 * sine)) if sine > 1e-3 else ""
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
            f"{0.5 * (high + low) / G_STANDARD * 1e6:+.1f} µg, half difference {0.5 * abs(high - low):.6f} m/s²"
        )
        if rests.gyro.shape[1] == 3:
            high, low = rests.gyro[up, axis].mean() / DEGREE_PER_HOUR, rests.gyro[down, axis].mean() / DEGREE_PER_HOUR
            line += f"; gyro half sum {0.5 * (high + low):+.3f} °/h, half difference {0.5 * abs(high - low):.3f} °/h"
        lines.append(line)
    return [Text(""), *map(Text, lines)] if lines else []


def _numbers(chosen: BoolArray) -> str:
    """Numbers of rests, counted from 1."""
    return ", ".join(str(i + 1) for i in np.flatnonzero(chosen))


def budget_report(budget: Budget, bound: Bound | None) -> RenderableType:
    """Expected errors of every method, pass and group of parameters, beside the least that any method can have."""
    table = plain_table("method", "pass", "parameters", "estimator")
    add_numbers(table, "error (rms)", "of the spread", *(["bound"] if bound is not None else []))
    table.add_column("mostly from")
    for row in budget.rows:
        numbers = [_quantity(row.error, row.unit), f"{row.relative:.2%}"]
        numbers += [_quantity(bound.rms(row.group), row.unit)] if bound is not None else []
        table.add_row(row.method, str(row.iteration), row.group, row.estimator, *numbers, row.dominating)
    return table


def _quantity(value: float, unit: str) -> str:
    """A value, SI, in its engineering unit; nothing where it is infinite."""
    size, shown = engineering(unit, value)
    return f"{value / size:.3g} {shown}" if math.isfinite(value) else ""


def requirements_report(requirements: Requirements) -> RenderableType:
    """What each wanted accuracy asks of table, mounting and rests, and what meets all of them."""
    table = plain_table("parameters")
    add_numbers(table, "wanted", "table within", "mounting within", "rest at least")
    table.add_column("because")
    for row in requirements.rows:
        size, unit = engineering(row.unit, row.wanted)
        needs = (
            (_within(row.table_error, row.limited), _within(row.mounting_error, row.limited), f"{row.rest:.3g} s")
            if row.feasible
            else ("no table", "", "")
        )
        table.add_row(row.group, f"{row.wanted / size:.3g} {unit}", *needs, row.reason)
    together = (
        f"together: table within ±{requirements.table_error / DEGREE:.2f}°, mounting within "
        f"±{requirements.mounting_error / DEGREE:.2f}°, rests of at least {requirements.rest:.3g} s"
    )
    return Group(table, Text(""), Text(together)) if any(row.feasible for row in requirements.rows) else table


def _within(angle: float, limited: bool) -> str:
    return f"±{angle / DEGREE:.2f}°" if limited else "any (±5°)"


def print_report(report: RenderableType) -> None:
    """Print to standard output, as wide as the terminal, or as needed where there is none; characters that it cannot
    show become question marks."""
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")
    console = Console(highlight=False, soft_wrap=False)
    if not console.is_terminal:
        console = Console(highlight=False, width=160)
    console.print(report)
