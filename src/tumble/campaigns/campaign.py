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
_NAMED: Mapping[str, tuple[str, Sequence[str]]] = {
    "method": (DEFAULT_METHOD, (*METHODS, *ITERATED_METHODS)),
    "grade": (GRADE, tuple(GRADES)),
    "programme": (PROGRAMME, tuple(BUILT_IN)),
    "terms": ("linear", ("linear", "full")),
}
"""Axes whose values are names: the default, and all."""
_NUMBERED: Mapping[str, tuple[float | None, float, float]] = {
    "positions": (None, 1, 1000),
    "table_error_deg": (TABLE_ERROR_DEG, 0.0, 10.0),
    "mounting_error_deg": (MOUNTING_ERROR_DEG, 0.0, 10.0),
    "rest": (None, 0.1, 86_400.0),
    "rate_deg_s": (None, 1e-3, 10_000.0),
    "sample_rate": (None, 0.1, 10_000.0),
    "latitude_deg": (LATITUDE_DEG, -90.0, 90.0),
    "noise_factor": (1.0, 0.0, 1000.0),
    "instability_time": (INSTABILITY_TIME, 0.0, 86_400.0),
}
"""Axes whose values are numbers: the default, None for the usual one on a table or by hand, the least and the most."""
AXES = ("grade", "programme", *_NUMBERED, "terms")
"""The axes of the grid apart from the method, outermost first."""


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
        schema: dict[str, Any] = {axis: pl.Float64 if axis in _NUMBERED else pl.String for axis in AXES}
        schema |= {"positions": pl.Int64, "method": pl.String, "accepted": pl.Boolean, "reasons": pl.String}
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
    campaign = Campaign(
        trials=int(_number(content.get("trials", "none"), 1, MOST_TASKS, f"{where}: trials", whole=True)),
        seed=int(_number(content.get("seed", 0), 0, 2**63, f"{where}: seed", whole=True)),
        intervals=intervals,
        grid={axis: _values(axis, grid, f"{where}: grid.{axis}") for axis in ("method", *AXES)},
    )
    if campaign.trials * len(campaign.cells) > MOST_TASKS:
        raise InputError(f"{where}: trials: expected at most {MOST_TASKS} over all points of the grid, found more")
    return campaign


def _values(axis: str, grid: Mapping[str, Any], where: str) -> list[Any]:
    """The values of an axis of the grid."""
    default = _NAMED[axis][0] if axis in _NAMED else _NUMBERED[axis][0]
    stated = grid.get(axis, default)
    values = stated if isinstance(stated, list) else [stated]
    if not values:
        raise InputError(f"{where}: expected a value or more, found none")
    if axis in _NUMBERED:
        _, least, most = _NUMBERED[axis]
        whole = axis == "positions"
        return values if axis not in grid else [_number(value, least, most, where, whole=whole) for value in values]
    names = _NAMED[axis][1]
    for value in values:
        if value not in names:
            raise InputError(f"{where}: expected one of {', '.join(names)}, found {shown(value)}")
    return values


def _number(value: Any, least: float, most: float, where: str, *, whole: bool) -> float:
    """A number of a document, if it is one from `least` to `most`. Raises InputError."""
    is_number = isinstance(value, int if whole else int | float) and not isinstance(value, bool)
    if not is_number or not least <= value <= most:
        kind = "a whole number" if whole else "a number"
        raise InputError(f"{where}: expected {kind} from {least:g} to {most:g}, found {shown(value)}")
    return value if whole else float(value)
