"""Errors of a campaign by method and group of parameters at every point of the grid.

For a group such as accel.bias, over its parameters p and the accepted trials i, with e the value less the truth:

    bias² = mean_p (mean_i e)²     scatter² = mean_p var_i e     rms² = mean e² = bias² + scatter²
    to bound = rms / √(mean of the Cramér–Rao variances of the same observations)
    coverage = part of the |e| within 1.96 u

The device is drawn anew at every trial: a methodical error that is in proportion to the device's own parameters shows
in the scatter, and the bias is what all devices have in common. With n trials, bias has a noise of scatter/√n.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Unpack

import numpy as np
import polars as pl

from tumble.arguments import checked
from tumble.brief import Brief
from tumble.campaigns.campaign import AXES, Campaign, read_campaign
from tumble.campaigns.cluster import Place, executor_for
from tumble.campaigns.engine import Progress, run
from tumble.files import FilePath, whole_file
from tumble.sensors.parameters import group_of, positions_by_group

COVERED_WITHIN = 1.96
"""Uncertainties in a 95 % interval."""
SUMMARY_FILE = "summary.csv"


@dataclass(frozen=True, kw_only=True, slots=True)
class SummaryLine:
    """One method at one point of the grid, in one group of parameters.

    `trials`, and of them `accepted` and `failed`, are counts. Bias, scatter and rms error of the accepted ones are in
    `unit` (SI), `to_bound` is rms over bound; None where there is nothing to compute it from. `why` is the first reason
    why a trial was not accepted or failed, empty where all were accepted."""

    point: Mapping[str, Any]
    method: str
    group: str
    unit: str
    trials: int
    accepted: int
    failed: int
    bias: float | None = None
    scatter: float | None = None
    rms: float | None = None
    to_bound: float | None = None
    coverage: float | None = None
    why: str = ""


@dataclass(frozen=True, kw_only=True, slots=True, repr=False)
class CampaignResult(Brief):
    """The rows of a campaign, a Parquet file, the lines of their summary, and the CSV file of these."""

    rows: Path
    lines: tuple[SummaryLine, ...]
    summary: Path


@checked
def campaign(
    planned: Campaign | FilePath,
    out: FilePath,
    *,
    progress: Progress = lambda _done, _all: None,
    **place: Unpack[Place],
) -> CampaignResult:
    """Simulate and calibrate many times over the grid of a campaign.

    Parameters
    ----------
    planned
        The campaign, or its TOML file.
    out
        Folder of the results; what it has already is not computed again.
    progress
        Function that is called with the number of tasks done and of all.
    **place
        Where to compute, see `tumble.types.Place`.

    Returns
    -------
    CampaignResult
        The rows, their summary, and its file.

    Raises
    ------
    InputError
        For a file that describes no campaign, and for a folder of something else.

    Examples
    --------
    >>> import tumble
    >>> from pathlib import Path
    >>> _ = Path("campaign.toml").write_text('seed = 1\\ntrials = 2\\n[grid]\\nmethod = "joint"\\ngrade = "mems"\\n')
    >>> tumble.campaign("campaign.toml", "results", serial=True).rows.name
    'rows.parquet'
    """
    definition = planned if isinstance(planned, Campaign) else read_campaign(Path(planned))
    folder = Path(out)
    with executor_for(**place) as executor:
        rows = run(definition.job(), folder, executor=executor, progress=progress)
    lines = summary(rows)
    write_summary(lines, folder / SUMMARY_FILE)
    return CampaignResult(rows=rows, lines=lines, summary=folder / SUMMARY_FILE)


def summary(rows: Path) -> tuple[SummaryLine, ...]:
    """The lines of a campaign's rows (the path that `engine.run` returns)."""
    lines: list[SummaryLine] = []
    for values, part in pl.read_parquet(rows).group_by([*AXES, "method"], maintain_order=True):
        refused = part.filter(pl.col("accepted").not_())["reasons"].to_list() + part["error"].drop_nulls().to_list()
        accepted = part.filter(pl.col("accepted"))
        names = [column.removeprefix("error.") for column in part.columns if column.startswith("error.")]
        for group, places in positions_by_group(names).items():
            figures = _figures(accepted, [names[i] for i in places])
            if figures or accepted.is_empty():
                lines.append(
                    SummaryLine(
                        point=dict(zip(AXES, values, strict=False)),
                        method=str(values[-1] or "every method"),
                        group=group,
                        unit=group_of(names[places[0]]).unit,
                        trials=len(part),
                        accepted=len(accepted),
                        failed=int(part["error"].is_not_null().sum()),
                        why=next(iter(refused), ""),
                        **figures,
                    )
                )
    return tuple(lines)


def _figures(accepted: pl.DataFrame, names: Sequence[str]) -> dict[str, float | None]:
    """The figures of the parameters of a group over the trials that have a value; none where no trial has one."""
    moments = []  # of each parameter: mean error, mean squares of the error and of the bound, part that u covers
    for name in names:
        columns = (accepted[f"{what}.{name}"].cast(pl.Float64).fill_null(math.nan) for what in ("error", "u", "bound"))
        error, u, bound = np.array([column.to_numpy() for column in columns])[
            :, accepted[f"error.{name}"].is_not_null()
        ]
        if len(error):
            covered = (np.abs(error) <= COVERED_WITHIN * u).mean() if np.isfinite(u).all() else math.nan
            moments.append((error.mean(), (error**2).mean(), (bound**2).mean(), covered))
    if not moments:
        return {}
    mean, square, least, coverage = np.array(moments).T
    bias2, rms2, least2 = float((mean**2).mean()), float(square.mean()), float(least.mean())
    return {
        "bias": math.sqrt(bias2),
        "scatter": math.sqrt(max(rms2 - bias2, 0.0)),
        "rms": math.sqrt(rms2),
        "to_bound": math.sqrt(rms2 / least2) if least2 > 0.0 else None,
        "coverage": float(coverage.mean()) if np.isfinite(coverage).all() else None,
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
