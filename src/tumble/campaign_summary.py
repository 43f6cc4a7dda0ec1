"""What a campaign found: errors by method and group of parameters at every point of the grid, as a table and a picture.

For a group (accel.bias and so on), over its parameters p and the accepted trials i, e the value less the truth:

    bias² = mean_p (mean_i e)²     scatter² = mean_p var_i e     rms² = mean e² = bias² + scatter²
    to bound = rms / √(mean of the Cramér–Rao variances of the same observations)
    coverage = part of the |e| within 1.96 u

The device is drawn anew at every trial: a methodical error that is in proportion to the device's own parameters shows
in the scatter, and the bias is what all devices have in common. With n trials, bias has a noise of scatter/√n.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import polars as pl
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from tumble.budget import GROUPS, UNITS
from tumble.campaign import AXES
from tumble.errors import InputError, needs_extra
from tumble.trial import NAMES
from tumble.units import Array, engineering
from tumble.whole_file import whole_file

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COVERED_WITHIN = 1.96
"""Uncertainties in a 95 % interval."""

WIDE = 5.0
"""Ratio of the errors in a panel from which its scale is logarithmic."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Line:
    """One method at one point of the grid, in one group of parameters: how many trials (or triads), of them accepted
    and failed, and over the accepted ones bias, scatter and rms error in `unit` (SI), rms over bound and coverage; None
    where there is nothing to tell it from."""

    point: Mapping[str, Any]
    method: str
    group: str
    unit: str
    trials: int
    accepted: int
    failed: int
    bias: float | None
    scatter: float | None
    rms: float | None
    to_bound: float | None
    coverage: float | None


def summary(rows: Path) -> tuple[Line, ...]:
    """The lines of a campaign's rows (the path of `run_campaign`)."""
    frame = pl.read_parquet(rows)
    axes = list(AXES)
    out = []
    for values, part in frame.group_by([*axes, "method"], maintain_order=True):
        point = dict(zip(axes, values, strict=False))
        out += list(_lines(point, str(values[-1] or "every method"), part))
    return tuple(out)


def _lines(point: Mapping[str, Any], method: str, part: pl.DataFrame) -> Iterator[Line]:
    statics = "triads" in part.columns
    if statics:
        trials, failed = int(part["triads"].sum()), int(part["failed"].sum() or 0)
        accepted = trials - failed
    else:
        trials, failed = len(part), int(part["error"].is_not_null().sum())
        part = part.filter(pl.col("accepted"))
        accepted = len(part)
    moments = _statics_moments(part) if statics else _session_moments(part)
    for group in GROUPS:
        members = [moments[name] for name in NAMES if name.startswith(group) and name in moments]
        if members or not accepted:
            yield Line(
                point=point,
                method=method,
                group=group,
                unit=UNITS[group],
                trials=trials,
                accepted=accepted,
                failed=failed,
                **_of_group(members),
            )


@dataclass(frozen=True, kw_only=True, slots=True)
class _Moments:
    """Of one parameter: means of the error, its square, the variance of the bound (None without), and the coverage
    (None where there is no u)."""

    mean: float
    square: float
    bound: float | None
    covered: float | None


def _session_moments(part: pl.DataFrame) -> dict[str, _Moments]:
    """Moments by parameter over trials that have a value."""
    out = {}
    for name in NAMES:
        error, u, bound = (_column(part, f"{what}.{name}") for what in ("error", "u", "bound"))
        seen = np.isfinite(error)
        if not seen.any():
            continue
        error, u, bound = error[seen], u[seen], bound[seen]
        out[name] = _Moments(
            mean=float(error.mean()),
            square=float((error**2).mean()),
            bound=float((bound**2).mean()) if np.isfinite(bound).all() else None,
            covered=float((np.abs(error) <= COVERED_WITHIN * u).mean()) if np.isfinite(u).all() else None,
        )
    return out


def _statics_moments(part: pl.DataFrame) -> dict[str, _Moments]:
    """Moments by parameter from those of the trials, each weighted with its triads."""
    part = part.filter(pl.col("error").is_null() & (pl.col("failed") < pl.col("triads")))
    if part.is_empty():
        return {}
    weight = (part["triads"] - part["failed"]).to_numpy()

    def mean(what: str, name: str) -> float:
        return float(np.average(_column(part, f"{what}.{name}"), weights=weight))

    return {
        name: _Moments(
            mean=mean("mean", name),
            square=mean("square", name),
            bound=mean("bound", name),
            covered=mean("covered", name),
        )
        for name in NAMES[:9]
    }


def _column(part: pl.DataFrame, name: str) -> Array:
    return part[name].cast(pl.Float64).fill_null(math.nan).to_numpy()


def _of_group(members: Sequence[_Moments]) -> dict[str, float | None]:
    """The figures of a group from the moments of its parameters."""
    if not members:
        return dict.fromkeys(("bias", "scatter", "rms", "to_bound", "coverage"))
    bias2 = float(np.mean([m.mean**2 for m in members]))
    square = float(np.mean([m.square for m in members]))
    bounds = [m.bound for m in members if m.bound is not None]
    covered = [m.covered for m in members if m.covered is not None]
    bounded = len(bounds) == len(members) and sum(bounds) > 0.0
    return {
        "bias": math.sqrt(bias2),
        "scatter": math.sqrt(max(square - bias2, 0.0)),
        "rms": math.sqrt(square),
        "to_bound": math.sqrt(square / float(np.mean(bounds))) if bounded else None,
        "coverage": float(np.mean(covered)) if len(covered) == len(members) else None,
    }


def varying(lines: Sequence[Line]) -> tuple[str, ...]:
    """The axes of the grid that have more than one value."""
    return tuple(axis for axis in AXES if len({line.point[axis] for line in lines}) > 1)


def write_summary(lines: Sequence[Line], path: Path) -> None:
    """Write the lines as CSV, SI, one row each."""
    figures = ("trials", "accepted", "failed", "unit", "bias", "scatter", "rms", "to_bound", "coverage")
    rows = [
        {**line.point, "method": line.method, "group": line.group} | {name: getattr(line, name) for name in figures}
        for line in lines
    ]
    with whole_file(path) as temporary:
        pl.DataFrame(rows, infer_schema_length=None).write_csv(temporary)


def summary_report(lines: Sequence[Line]) -> RenderableType:
    """The lines as tables: first how the trials ended, then the errors."""
    axes = varying(lines)
    ended, errors = Table(box=None, pad_edge=False), Table(box=None, pad_edge=False)
    for table, headings in (
        (ended, ("trials", "accepted", "not accepted", "failed")),
        (errors, ("bias", "scatter", "rms", "unit", "rms/bound", "coverage")),
    ):
        for axis in axes:
            table.add_column(axis, justify="right")
        table.add_column("method")
        if table is errors:
            table.add_column("parameters")
        for heading in headings:
            table.add_column(heading, justify="left" if heading == "unit" else "right")
    before: list[str] = []
    for line in lines:
        where = [_plain(line.point[axis]) for axis in axes] + [line.method]
        if where != before:
            refused = line.trials - line.accepted - line.failed
            ended.add_row(*where, str(line.trials), str(line.accepted), str(refused), str(line.failed))
        if line.rms is not None:
            errors.add_row(*(where if where != before else [""] * len(where)), line.group, *_figures(line))
        before = where
    return Group(ended, Text(""), errors)


def _figures(line: Line) -> list[str]:
    assert line.bias is not None
    assert line.scatter is not None
    assert line.rms is not None
    size, unit = engineering(line.unit, line.rms)
    return [
        *(f"{value / size:.3g}" for value in (line.bias, line.scatter, line.rms)),
        unit,
        "" if line.to_bound is None else f"{line.to_bound:.3f}",
        "" if line.coverage is None else f"{line.coverage:.1%}",
    ]


def _plain(value: Any) -> str:
    return "" if value is None else f"{value:g}" if isinstance(value, float) else str(value)


# The picture


def plot(lines: Sequence[Line], path: Path) -> None:
    """Draw the rms errors, a panel for each group, over the first axis of numbers that varies (over the methods if none
    does), with one line for each method and value of the other axes; where it is known, the bound dotted. As svg, png
    or pdf by the ending of the file.

    Raises MissingExtraError without matplotlib, InputError where no trial was accepted."""
    with needs_extra("a plot of a campaign", "report", "matplotlib"):
        from matplotlib import rc_context
        from matplotlib.figure import Figure
    lines = [line for line in lines if line.rms is not None]
    if not lines:
        raise InputError(f"{path}: expected an accepted trial to draw, found none")
    axes = varying(lines)
    along = next((a for a in axes if isinstance(lines[0].point[a], int | float)), None)
    groups = [group for group in GROUPS if any(line.group == group for line in lines)]
    with rc_context({"svg.fonttype": "none", "svg.hashsalt": "tumble", "font.size": 9.0}):
        figure = Figure(figsize=(10.5, 3.2 * math.ceil(len(groups) / 3) + 0.4), layout="constrained")
        panels = figure.subplots(math.ceil(len(groups) / 3), min(3, len(groups)), squeeze=False).ravel()
        for panel, group in zip(panels, groups, strict=True):
            _draw(panel, [line for line in lines if line.group == group], axes, along)
        handles, names = panels[0].get_legend_handles_labels()
        figure.legend(handles, names, loc="outside lower center", ncols=4, fontsize=8.0)
        undated = {".svg": {"Date": None}, ".pdf": {"CreationDate": None}}
        with whole_file(path) as temporary:
            figure.savefig(temporary, dpi=150, metadata=undated.get(path.suffix.lower()))


def _draw(panel: Axes, lines: Sequence[Line], axes: Sequence[str], along: str | None) -> None:
    """One group: rms errors against the axis `along`."""
    size, unit = engineering(lines[0].unit, max(line.rms or 0.0 for line in lines))
    series: dict[str, list[Line]] = {}
    for line in lines:
        others = [f"{axis} {_plain(line.point[axis])}" for axis in axes if axis != along]
        series.setdefault(", ".join([line.method, *others]), []).append(line)
    for i, (name, members) in enumerate(series.items()):
        x = [i if along is None else line.point[along] for line in members]
        rms = np.array([line.rms for line in members]) / size
        panel.plot(x, rms, "o-", color=f"C{i}", markersize=3.5, linewidth=1.3, label=name)
        if all(line.to_bound for line in members):
            bound = rms / np.array([line.to_bound for line in members])
            panel.plot(x, bound, "_:" if along is None else ":", color=f"C{i}", linewidth=1.0)
    panel.set(title=lines[0].group, ylabel=f"rms error, {unit}", xlabel="method" if along is None else along)
    largest, least = (of(line.rms or 0.0 for line in lines) for of in (max, min))
    if largest > WIDE * least:
        panel.set(yscale="log")
    else:
        panel.set_ylim(0.0, 1.1 * largest / size)
    if along is None:
        panel.set_xticks([])
    panel.grid(which="major", alpha=0.5, linewidth=0.6)
    for formatter in (panel.yaxis.set_major_formatter, panel.yaxis.set_minor_formatter):
        formatter("{x:g}")
