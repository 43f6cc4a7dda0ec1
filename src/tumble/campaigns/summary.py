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
from typing import Any

import numpy as np
import polars as pl

from tumble.brief import Brief
from tumble.campaigns.campaign import AXES, Campaign, read_campaign
from tumble.campaigns.cluster import executor_for
from tumble.campaigns.engine import Progress, run
from tumble.files import FilePath, whole_file
from tumble.planning.setup import NAMES
from tumble.sensors.parameters import group_of, positions_by_group
from tumble.units import Array

COVERED_WITHIN = 1.96
"""Uncertainties in a 95 % interval."""


@dataclass(frozen=True, kw_only=True, slots=True)
class SummaryLine:
    """One method at one point of the grid, in one group of parameters: how many trials (or triads), of them accepted
    and failed, and over the accepted ones bias, scatter and rms error in `unit` (SI), rms over bound and coverage; None
    where there is nothing to tell it from. `why` is the first reason why a trial was not accepted or failed, empty
    where all were accepted."""

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
    why: str = ""


def summary(rows: Path) -> tuple[SummaryLine, ...]:
    """The lines of a campaign's rows (the path of `engine.run`)."""
    frame = pl.read_parquet(rows)
    axes = list(AXES)
    out = []
    for values, part in frame.group_by([*axes, "method"], maintain_order=True):
        point = dict(zip(axes, values, strict=False))
        out += list(_lines(point, str(values[-1] or "every method"), part))
    return tuple(out)


def _lines(point: Mapping[str, Any], method: str, part: pl.DataFrame) -> Iterator[SummaryLine]:
    statics = "triads" in part.columns
    refused = part.filter(pl.col("accepted").not_())["reasons"].to_list() if "reasons" in part.columns else []
    why = next(iter(refused + part["error"].drop_nulls().to_list()), "")
    if statics:
        trials, failed = int(part["triads"].sum()), int(part["failed"].sum() or 0)
        accepted = trials - failed
    else:
        trials, failed = len(part), int(part["error"].is_not_null().sum())
        part = part.filter(pl.col("accepted"))
        accepted = len(part)
    names = NAMES if statics else _names(part)
    moments = _statics_moments(part) if statics else _session_moments(part)
    for group, places in positions_by_group(names).items():
        members = [moments[names[i]] for i in places if names[i] in moments]
        if members or not accepted:
            yield SummaryLine(
                point=point,
                method=method,
                group=group,
                unit=group_of(names[places[0]]).unit,
                trials=trials,
                accepted=accepted,
                failed=failed,
                why=why,
                **_of_group(members),
            )


def _names(part: pl.DataFrame) -> tuple[str, ...]:
    """The parameters that rows of sessions have columns of."""
    return tuple(column.removeprefix("error.") for column in part.columns if column.startswith("error."))


_Moments = dict[str, float | None]
"""Of one parameter: `mean` of the error, of its `square` and of the variance of the `bound` (None without), and the
part `covered` (None where there is no u)."""


def _session_moments(part: pl.DataFrame) -> dict[str, _Moments]:
    """Moments by parameter over trials that have a value."""
    out: dict[str, _Moments] = {}
    for name in _names(part):
        error, u, bound = (_column(part, f"{what}.{name}") for what in ("error", "u", "bound"))
        seen = np.isfinite(error)
        if not seen.any():
            continue
        error, u, bound = error[seen], u[seen], bound[seen]
        out[name] = {
            "mean": float(error.mean()),
            "square": float((error**2).mean()),
            "bound": float((bound**2).mean()) if np.isfinite(bound).all() else None,
            "covered": float((np.abs(error) <= COVERED_WITHIN * u).mean()) if np.isfinite(u).all() else None,
        }
    return out


def _statics_moments(part: pl.DataFrame) -> dict[str, _Moments]:
    """Moments by parameter from those of the trials, each weighted with its triads."""
    part = part.filter(pl.col("error").is_null() & (pl.col("failed") < pl.col("triads")))
    if part.is_empty():
        return {}
    weight = (part["triads"] - part["failed"]).to_numpy()
    whats = ("mean", "square", "bound", "covered")
    return {
        name: {what: float(np.average(_column(part, f"{what}.{name}"), weights=weight)) for what in whats}
        for name in NAMES[:9]
    }


def _column(part: pl.DataFrame, name: str) -> Array:
    return part[name].cast(pl.Float64).fill_null(math.nan).to_numpy()


def _of_group(members: Sequence[_Moments]) -> dict[str, float | None]:
    """The figures of a group from the moments of its parameters."""
    if not members:
        return dict.fromkeys(("bias", "scatter", "rms", "to_bound", "coverage"))
    mean, square, bound, covered = (
        np.array([member[what] for member in members], dtype=float) for what in ("mean", "square", "bound", "covered")
    )
    bias2, rms2, least = float((mean**2).mean()), float(square.mean()), float(bound.mean())
    return {
        "bias": math.sqrt(bias2),
        "scatter": math.sqrt(max(rms2 - bias2, 0.0)),
        "rms": math.sqrt(rms2),
        "to_bound": math.sqrt(rms2 / least) if least > 0.0 else None,
        "coverage": float(covered.mean()) if np.isfinite(covered).all() else None,
    }


def varying(lines: Sequence[SummaryLine]) -> tuple[str, ...]:
    """The axes of the grid that have more than one value."""
    return tuple(axis for axis in AXES if len({line.point[axis] for line in lines}) > 1)


def write_summary(lines: Sequence[SummaryLine], path: Path) -> None:
    """Write the lines as CSV, SI, one row each."""
    figures = ("trials", "accepted", "failed", "unit", "bias", "scatter", "rms", "to_bound", "coverage")
    rows = [
        {**line.point, "method": line.method, "group": line.group} | {name: getattr(line, name) for name in figures}
        for line in lines
    ]
    with whole_file(path) as temporary:
        pl.DataFrame(rows, infer_schema_length=None).write_csv(temporary)


def said(value: Any) -> str:
    """The value of an axis in words, nothing for none."""
    return "" if value is None else f"{value:g}" if isinstance(value, float) else str(value)


# A campaign in one call

SUMMARY_FILE = "summary.csv"


@dataclass(frozen=True, kw_only=True, slots=True, repr=False)
class CampaignResult(Brief):
    """The rows of a campaign, a Parquet file, their summary in lines, and the CSV file it is in."""

    rows: Path
    lines: tuple[SummaryLine, ...]
    summary: Path


def campaign(
    planned: Campaign | FilePath,
    out: FilePath,
    *,
    serial: bool = False,
    cluster: str | None = None,
    workers: int | None = None,
    progress: Progress = lambda _done, _all: None,
) -> CampaignResult:
    """Simulate and calibrate many times over the grid of a campaign, or of its TOML file, into a folder; what is there
    already is not computed again. `serial`, `cluster` and `workers` say where, as `executor_for`.

    >>> import tumble
    >>> from pathlib import Path
    >>> _ = Path("campaign.toml").write_text('seed = 1\\ntrials = 2\\n[grid]\\nmethod = "joint"\\ngrade = "mems"\\n')
    >>> tumble.campaign("campaign.toml", "results", serial=True).rows.name
    'rows.parquet'
    """
    known, folder = planned if isinstance(planned, Campaign) else read_campaign(Path(planned)), Path(out)
    with executor_for(serial=serial, cluster=cluster, workers=workers) as executor:
        rows = run(known.job(), folder, executor=executor, progress=progress)
    lines = summary(rows)
    write_summary(lines, folder / SUMMARY_FILE)
    return CampaignResult(rows=rows, lines=lines, summary=folder / SUMMARY_FILE)
