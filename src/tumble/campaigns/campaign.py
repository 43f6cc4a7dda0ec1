"""Campaigns: many simulated calibrations over a grid of methods and conditions, from a TOML file to a table of errors.

    seed = 1
    trials = 200                 of every point of the grid
    intervals = false            true: u of the joint method integrated over its hyperparameters, many times slower
    [grid]                       a value or a list of values; every combination is a point of the grid
    method = ["joint", "scalar"]
    table_error_deg = [0.5, 1, 2]

Trial i belongs to point i mod P of the P points, so that all are about equally far at any time. The columns of the rows
are described in `tumble.campaigns.trial`, their summary in `tumble.campaigns.summary`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any, cast

import polars as pl

from tumble.campaigns.engine import Job, Row
from tumble.campaigns.trial import Cell, session_rows
from tumble.documents import shown, text_of_document, toml_of
from tumble.errors import InputError, did_you_mean
from tumble.planning.bounds import instrument_of
from tumble.planning.setup import Setup
from tumble.programme.positions import BUILT_IN
from tumble.run.calibrate import DEFAULT_METHOD, ITERATED_METHODS, METHODS, Method
from tumble.sensors.grades import GRADES
from tumble.usual_setup import GRADE, INSTABILITY_TIME, LATITUDE_DEG, MOUNTING_ERROR_DEG, PROGRAMME, TABLE_ERROR_DEG

MOST_TASKS = 10_000_000


@dataclass(frozen=True, kw_only=True, slots=True)
class Axis:
    """An axis of the grid: its `default`, None for the usual one on a table or by hand, and all `names` that it may
    have, or the `limits` of its numbers, whole ones or any."""

    default: str | float | None = None
    names: tuple[str, ...] = ()
    limits: tuple[float, float] = (0.0, 0.0)
    whole: bool = False

    def check(self, value: Any, where: str) -> None:
        """Raise InputError for a value that it cannot have."""
        if self.names:
            if value not in self.names:
                raise InputError(f"{where}: expected one of {', '.join(self.names)}, found {shown(value)}")
            return
        (least, most), is_number = self.limits, isinstance(value, int if self.whole else int | float)
        if not is_number or isinstance(value, bool) or not least <= value <= most:
            kind = "a whole number" if self.whole else "a number"
            raise InputError(f"{where}: expected {kind} from {least:g} to {most:g}, found {shown(value)}")


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
"""The axes of the grid apart from the method, outermost first."""
_METHOD = Axis(default=DEFAULT_METHOD, names=(*METHODS, *ITERATED_METHODS))
_TRIALS, _SEED = Axis(limits=(1, MOST_TASKS), whole=True), Axis(limits=(0, 2**63), whole=True)


@dataclass(frozen=True, kw_only=True, slots=True)
class Campaign:
    """What a campaign file says; `grid` has the values of all axes, and of the method."""

    trials: int
    seed: int
    intervals: bool
    grid: Mapping[str, Sequence[Any]]

    @property
    def cells(self) -> tuple[Cell, ...]:
        """The points of the grid, the last axis varying first."""
        points = product(*(self.grid[axis] for axis in AXES))
        return tuple(dict(zip(AXES, values, strict=True)) for values in points)

    def job(self) -> Job:
        """The campaign as a job of trials × cells tasks."""
        instruments = [instrument_of(Setup.of(**cell), gyros=True) for cell in self.cells]
        names = tuple(dict.fromkeys(name for instrument in instruments for name in instrument.names))
        schema: dict[str, Any] = {
            name: pl.String if axis.names else pl.Int64 if axis.whole else pl.Float64 for name, axis in AXES.items()
        }
        schema |= {"method": pl.String, "accepted": pl.Boolean, "reasons": pl.String}
        schema |= {f"{quantity}.{name}": pl.Float64 for quantity in ("error", "u", "bound") for name in names}
        return Job(
            definition={"campaign": asdict(self)},
            items=self.cells * self.trials,
            task=partial(session_rows, self.seed, cast("list[Method]", self.grid["method"]), self.intervals),
            label=label,
            schema=schema,
        )


def label(cell: Cell) -> Row:
    """The columns by which a cell differs from others."""
    return {**cell} | ({} if cell["positions"] is None else {"programme": None})


def read_campaign(path: Path) -> Campaign:
    """The campaign of a file. Raises InputError, one line."""
    return campaign_of(toml_of(text_of_document(path), str(path)), str(path))


def campaign_of(content: Mapping[str, Any], where: str = "campaign") -> Campaign:
    """The campaign of the content of a file, named `where` in messages. Raises InputError, one line."""
    grid = content.get("grid", {})
    if not isinstance(grid, Mapping):
        raise InputError(f"{where}: grid: expected a table, found {shown(grid)}")
    for place, keys, names in (
        ("at the top level", content, ("seed", "trials", "intervals", "grid")),
        ("in [grid]", grid, ("method", *AXES)),
    ):
        for key in keys:
            if key not in names:
                raise InputError(f"{where}: unknown key {key!r} {place}{did_you_mean(key, names)}")
    if {"programme", "positions"} <= grid.keys():
        raise InputError(f"{where}: grid.positions: expected no grid.programme with it, found both; leave one out")
    intervals = content.get("intervals", False)
    if not isinstance(intervals, bool):
        raise InputError(f"{where}: intervals: expected true or false, found {shown(intervals)}")
    trials, seed = content.get("trials", "none"), content.get("seed", 0)
    _TRIALS.check(trials, f"{where}: trials")
    _SEED.check(seed, f"{where}: seed")
    campaign = Campaign(trials=trials, seed=seed, intervals=intervals, grid=_grid_of(grid, f"{where}: grid"))
    if trials * len(campaign.cells) > MOST_TASKS:
        raise InputError(f"{where}: trials: expected at most {MOST_TASKS} over all points of the grid, found more")
    return campaign


def _grid_of(stated: Mapping[str, Any], where: str) -> dict[str, list[Any]]:
    """The values of every axis of the grid, the defaults where none is stated."""
    grid = dict[str, list[Any]]()
    for name, axis in {"method": _METHOD, **AXES}.items():
        values = stated.get(name, axis.default)
        grid[name] = values if isinstance(values, list) else [values]
        if not grid[name]:
            raise InputError(f"{where}.{name}: expected a value or more, found none")
        for value in grid[name] if name in stated else ():
            axis.check(value, f"{where}.{name}")
        if name in stated and not axis.names and not axis.whole:
            grid[name] = [float(value) for value in grid[name]]
    return grid
