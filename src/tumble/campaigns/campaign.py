"""Campaigns: many simulated calibrations over a grid of methods and conditions, given by a TOML file.

    seed = 1
    trials = 200                 for every point of the grid
    intervals = false            true: u of the joint method integrated over its hyperparameters, many times slower
    [grid]                       a value or a list of values; every combination is a point of the grid
    method = ["joint", "scalar"]
    table_error_deg = [0.5, 1, 2]

Trial i belongs to point i mod P of the P points, so that all points progress at the same rate. The columns of the rows
are described in `tumble.campaigns.trial`.

The summary has a line for each method and group of parameters at every point of the grid. For a group such as
accel.bias, with e the value minus the truth, over its parameters p and the accepted trials i:

    bias² = mean_p (mean_i e)²     scatter² = mean_p var_i e     rms² = mean e² = bias² + scatter²
    to bound = rms / √(mean of the Cramér–Rao variances of the same observations)
    coverage = fraction of |e| within 1.96 u

The device is drawn anew for every trial: a methodical error in proportion to the device's parameters appears in the
scatter, and the bias is what all devices have in common. With n trials the bias has a noise of scatter/√n.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any, Self, Unpack, cast

import numpy as np
import polars as pl
from pydantic import BaseModel, ConfigDict, Field, model_validator

from tumble.arguments import checked
from tumble.brief import Brief
from tumble.campaigns.cluster import Place, executor_for
from tumble.campaigns.engine import Job, Progress, run
from tumble.campaigns.trial import Cell, session_rows, setup_of
from tumble.documents import shown, text_of_document, toml_of, validated
from tumble.errors import did_you_mean
from tumble.files import FilePath, whole_file
from tumble.planning.bounds import instrument_of
from tumble.programme.positions import BUILT_IN
from tumble.run.calibrate import DEFAULT_METHOD, ITERATED_METHODS, METHODS, Method
from tumble.sensors.grades import GRADES
from tumble.sensors.parameters import group_of, positions_by_group
from tumble.usual_setup import GRADE, INSTABILITY_TIME, LATITUDE_DEG, MOUNTING_ERROR_DEG, PROGRAMME, TABLE_ERROR_DEG

MAX_TASKS = 10_000_000


@dataclass(frozen=True, kw_only=True, slots=True)
class Axis:
    """An axis of the grid: its `default` (None: the usual value on a table or by hand), and its possible `names`, or
    the `limits` of its numbers."""

    default: str | float | None = None
    names: tuple[str, ...] = ()
    limits: tuple[float, float] = (0.0, 0.0)
    whole: bool = False

    def check(self, value: Any, where: str) -> None:
        """Raise ValueError if the axis cannot have this value."""
        if self.names:
            if value not in self.names:
                raise ValueError(f"{where}: expected one of {', '.join(self.names)}, found {shown(value)}")
            return
        (least, most), is_number = self.limits, isinstance(value, int if self.whole else int | float)
        if not is_number or isinstance(value, bool) or not least <= value <= most:
            kind = "a whole number" if self.whole else "a number"
            raise ValueError(f"{where}: expected {kind} from {least:g} to {most:g}, found {shown(value)}")


AXES: Mapping[str, Axis] = {
    "grade": Axis(default=GRADE, names=tuple(GRADES)),
    "programme": Axis(default=PROGRAMME, names=tuple(BUILT_IN)),
    "positions": Axis(limits=(1, 1000), whole=True),
    "table_error_deg": Axis(default=TABLE_ERROR_DEG, limits=(0.0, 10.0)),
    "mounting_error_deg": Axis(default=MOUNTING_ERROR_DEG, limits=(0.0, 10.0)),
    "rest": Axis(limits=(0.1, 86_400.0)),
    "rate_deg_s": Axis(limits=(1e-3, 10_000.0)),
    "sample_rate": Axis(limits=(0.1, 10_000.0)),
    "latitude_deg": Axis(default=LATITUDE_DEG, limits=(-90.0, 90.0)),
    "noise_factor": Axis(default=1.0, limits=(0.0, 1000.0)),
    "instability_time": Axis(default=INSTABILITY_TIME, limits=(0.0, 86_400.0)),
    "terms": Axis(default="linear", names=("linear", "full")),
}
"""Axes of the grid apart from the method, outermost first."""
_METHOD = Axis(default=DEFAULT_METHOD, names=(*METHODS, *ITERATED_METHODS))
_LARGEST_SEED = 2**63


class Campaign(BaseModel):
    """A campaign; `grid` has the values of all axes and of the method."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)

    trials: int = Field(ge=1, le=MAX_TASKS, description=f"a whole number from 1 to {MAX_TASKS:g}")
    seed: int = Field(default=0, ge=0, le=_LARGEST_SEED, description=f"a whole number from 0 to {_LARGEST_SEED:g}")
    intervals: bool = False
    grid: dict[str, Any] = {}

    @model_validator(mode="after")
    def _complete(self) -> Self:
        """Check the grid, and give every axis a list of values."""
        axes, stated = {"method": _METHOD, **AXES}, dict(self.grid)
        for name, written in stated.items():
            if name not in axes:
                raise ValueError(f"unknown key {name!r} in [grid]{did_you_mean(name, axes)}")
            axis, values = axes[name], written if isinstance(written, list) else [written]
            if not values:
                raise ValueError(f"grid.{name}: expected a value or more, found none")
            for value in values:
                axis.check(value, f"grid.{name}")
            self.grid[name] = values if axis.names or axis.whole else [float(value) for value in values]
        if {"programme", "positions"} <= stated.keys():
            raise ValueError("grid.positions: expected no grid.programme with it, found both; leave one out")
        unstated = {name: [axis.default] for name, axis in axes.items() if name not in stated}
        self.grid.update(unstated | ({"programme": [None]} if "positions" in stated else {}))
        if self.trials * len(self.cells) > MAX_TASKS:
            raise ValueError(f"trials: expected at most {MAX_TASKS} over all points of the grid, found more")
        return self

    @property
    def cells(self) -> tuple[Cell, ...]:
        """Points of the grid, the last axis varying first."""
        points = product(*(self.grid[axis] for axis in AXES))
        return tuple(dict(zip(AXES, values, strict=True)) for values in points)

    def job(self) -> Job:
        """Return the campaign as a job of trials × cells tasks."""
        instruments = [instrument_of(setup_of(cell), gyros=True) for cell in self.cells]
        names = tuple(dict.fromkeys(name for instrument in instruments for name in instrument.names))
        schema: dict[str, Any] = {
            name: pl.String if axis.names else pl.Int64 if axis.whole else pl.Float64 for name, axis in AXES.items()
        }
        schema |= {"method": pl.String, "accepted": pl.Boolean, "reasons": pl.String}
        schema |= {f"{quantity}.{name}": pl.Float64 for quantity in ("error", "u", "bound") for name in names}
        return Job(
            definition={"campaign": self.model_dump()},
            items=self.cells * self.trials,
            task=partial(session_rows, self.seed, cast("list[Method]", self.grid["method"]), self.intervals),
            schema=schema,
        )


def read_campaign(path: Path) -> Campaign:
    """Read a campaign from a file. Raises InputError."""
    return validated(Campaign, toml_of(text_of_document(path), str(path)), str(path))


# -------------------- summary --------------------

COVERAGE_FACTOR = 1.96  # of a 95 % interval
SUMMARY_FILE = "summary.csv"


@dataclass(frozen=True, kw_only=True, slots=True)
class SummaryLine:
    """Errors of one method at one point of the grid, in one group of parameters.

    `bias`, `scatter` and `rms` of the accepted trials are in `unit` (SI), `to_bound` is rms over bound; None if they
    cannot be computed. `why` is the first reason why a trial was not accepted or failed, empty if all were accepted."""

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
    """Result of a campaign: the Parquet file of its rows, the lines of their summary, and the CSV file of these."""

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
        Folder of the results; finished trials are not computed again.
    progress
        Function of the number of finished tasks and the number of all tasks.
    **place
        Where to compute, see `tumble.types.Place`.

    Returns
    -------
    CampaignResult
        Files of the rows and of the summary, and its lines.

    Raises
    ------
    InputError
        For a file that describes no campaign, and for a folder with other content.

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
    figures = ("trials", "accepted", "failed", "unit", "bias", "scatter", "rms", "to_bound", "coverage")
    table = [
        {**line.point, "method": line.method, "group": line.group} | {name: getattr(line, name) for name in figures}
        for line in lines
    ]
    with whole_file(folder / SUMMARY_FILE) as temporary:
        pl.DataFrame(table, infer_schema_length=None).write_csv(temporary)
    return CampaignResult(rows=rows, lines=lines, summary=folder / SUMMARY_FILE)


def summary(rows: Path) -> tuple[SummaryLine, ...]:
    """Return the lines of the summary of a campaign's rows (the file that `engine.run` returns)."""
    lines: list[SummaryLine] = []
    for values, part in pl.read_parquet(rows).group_by([*AXES, "method"], maintain_order=True):
        refused = part.filter(pl.col("accepted").not_())["reasons"].to_list() + part["error"].drop_nulls().to_list()
        accepted = part.filter(pl.col("accepted"))
        names = [column.removeprefix("error.") for column in part.columns if column.startswith("error.")]
        for group, places in positions_by_group(names).items():
            figures = _figures(accepted, [names[i] for i in places])
            if not figures and not accepted.is_empty():
                continue
            line = SummaryLine(
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
            lines.append(line)
    return tuple(lines)


def _figures(accepted: pl.DataFrame, names: Sequence[str]) -> dict[str, float | None]:
    """Return the figures of a group of parameters over the trials with a value; empty if there is none."""
    moments = []  # by parameter: mean error, mean squares of error and bound, fraction covered by u
    for name in names:
        columns = [f"{column}.{name}" for column in ("error", "u", "bound")]
        estimated = accepted.filter(pl.col(columns[0]).is_not_null()).select(columns).cast(pl.Float64)
        error, u, bound = estimated.fill_null(math.nan).to_numpy().T
        if len(error):
            covered = (np.abs(error) <= COVERAGE_FACTOR * u).mean() if np.isfinite(u).all() else math.nan
            moments.append((error.mean(), (error**2).mean(), (bound**2).mean(), covered))
    if not moments:
        return {}
    mean, square, bound_square, coverage = np.array(moments).T
    bias2, rms2, bound2 = float((mean**2).mean()), float(square.mean()), float(bound_square.mean())
    return {
        "bias": math.sqrt(bias2),
        "scatter": math.sqrt(max(rms2 - bias2, 0.0)),
        "rms": math.sqrt(rms2),
        "to_bound": math.sqrt(rms2 / bound2) if bound2 > 0.0 else None,
        "coverage": float(coverage.mean()) if np.isfinite(coverage).all() else None,
    }


def varying(lines: Sequence[SummaryLine]) -> tuple[str, ...]:
    """Return the axes of the grid that have more than one value."""
    return tuple(axis for axis in AXES if len({line.point[axis] for line in lines}) > 1)
