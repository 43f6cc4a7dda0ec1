"""Campaigns: many simulated calibrations over a grid of methods and conditions, from a TOML file to a table of errors.

    seed = 1
    trials = 200                 of every point of the grid
    source = "observations"      "log": sampled logs through the whole chain (see `tumble.campaigns.trial`)
    intervals = false            true: u of the joint method integrated over its hyperparameters, many times slower
    [grid]                       a value or a list of values; every combination is a point of the grid
    method = ["joint", "scalar"]
    table_error_deg = [0.5, 1, 2]

Trial i belongs to point i mod P of the P points, so that all are about equally far at any time. The columns of the rows
are described in `tumble.campaigns.trial`, their summary in `tumble.campaigns.summary`.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable
from functools import cached_property, partial
from itertools import product
from pathlib import Path
from typing import Annotated, Any, Self, cast

import polars as pl
from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from tumble.campaigns.engine import Job, Row
from tumble.campaigns.trial import Cell, Source, session_rows
from tumble.documents import text_of_document, toml_of, validated
from tumble.planning.bounds import instrument_of
from tumble.planning.setup import Setup
from tumble.programme.positions import BUILT_IN
from tumble.run.calibrate import DEFAULT_METHOD, ITERATED_METHODS, METHODS, Method
from tumble.sensors.grades import GRADES
from tumble.usual_setup import GRADE, INSTABILITY_TIME, LATITUDE_DEG, MOUNTING_ERROR_DEG, PROGRAMME, TABLE_ERROR_DEG

MOST_TASKS = 10_000_000


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)


def _axis(usual: Any, expected: str | Iterable[str]) -> Any:
    """An axis of the grid: its default, and its values, described in words or listed by name."""
    words = expected if isinstance(expected, str) else f"one of {', '.join(expected)}"
    names: list[Any] | None = None if isinstance(expected, str) else list(expected)
    return Field(default=[usual], min_length=1, description=words, json_schema_extra={"names": names})


_Degrees = Annotated[float, Field(ge=0.0, le=10.0)]
_Seconds = Annotated[float, Field(ge=0.1, le=86_400.0)]
_Positive = Annotated[float, Field(gt=0.0, le=10_000.0)]


class _Grid(_Table):
    """The axes, the outermost first. A single value stands for a list of one; None, as for `tumble simulate`, is the
    usual value on a table or by hand."""

    method: list[str] = _axis(DEFAULT_METHOD, (*METHODS, *ITERATED_METHODS))
    grade: list[str] = _axis(GRADE, GRADES)
    programme: list[str] = _axis(PROGRAMME, BUILT_IN)
    positions: list[Annotated[int, Field(ge=1, le=1000)] | None] = _axis(None, "whole numbers from 1 to 1000")
    table_error_deg: list[_Degrees] = _axis(TABLE_ERROR_DEG, "numbers from 0 to 10 (degrees)")
    mounting_error_deg: list[_Degrees] = _axis(MOUNTING_ERROR_DEG, "numbers from 0 to 10 (degrees)")
    rest: list[_Seconds | None] = _axis(None, "numbers from 0.1 to 86400 (s)")
    rate_deg_s: list[_Positive | None] = _axis(None, "numbers above 0 (degrees a second)")
    sample_rate: list[_Positive | None] = _axis(None, "numbers above 0 (Hz)")
    latitude_deg: list[Annotated[float, Field(ge=-90.0, le=90.0)]] = _axis(LATITUDE_DEG, "numbers from -90 to 90")
    noise_factor: list[Annotated[float, Field(ge=0.0, le=1000.0)]] = _axis(1.0, "numbers from 0 to 1000")
    instability_time: list[Annotated[float, Field(ge=0.0, le=86_400.0)]] = _axis(
        INSTABILITY_TIME, "numbers from 0 to 86400 (s)"
    )
    terms: list[str] = _axis("linear", ("linear", "full"))

    @field_validator("*", mode="before")
    @classmethod
    def _listed(cls, value: Any) -> Any:
        return value if isinstance(value, list) else [value]

    @model_validator(mode="after")
    def _check(self) -> Self:
        for key, axis in type(self).model_fields.items():
            names = cast("dict[str, Any]", axis.json_schema_extra)["names"]
            for name in getattr(self, key):
                if names is not None and name not in names:
                    raise ValueError(f"{key}: expected {axis.description}, found {json.dumps(name)}")
        if {"programme", "positions"} <= self.model_fields_set:
            raise ValueError("positions: expected no grid.programme with it, found both; leave one out")
        return self


AXES = tuple(axis for axis in _Grid.model_fields if axis != "method")
"""The axes of the grid apart from the method, outermost first."""


class Campaign(_Table):
    """What a campaign file says. `cells` are the points of the grid, apart from the methods."""

    source: Source = Field(default="observations", description='"observations" or "log"')
    seed: int = Field(default=0, ge=0, le=2**63, description="a whole number, not negative")
    trials: int = Field(ge=1, le=MOST_TASKS, description=f"a whole number from 1 to {MOST_TASKS}")
    intervals: bool = Field(default=False, description="true or false")
    grid: _Grid = Field(default=_Grid(), description="a table")

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.trials * math.prod(len(getattr(self.grid, axis)) for axis in AXES) > MOST_TASKS:
            raise ValueError(f"trials: expected at most {MOST_TASKS} over all points of the grid, found more")
        return self

    @property
    def methods(self) -> tuple[Method, ...]:
        """Those by which every trial is calibrated."""
        return tuple(cast("list[Method]", self.grid.method))

    @cached_property
    def cells(self) -> tuple[Cell, ...]:
        """The points of the grid, the last axis varying first."""
        points = product(*(getattr(self.grid, axis) for axis in AXES))
        return tuple(dict(zip(AXES, values, strict=True)) for values in points)

    def job(self) -> Job:
        """The campaign as a job of trials × cells tasks."""
        instruments = [instrument_of(Setup.of(**cell), gyros=True) for cell in self.cells]
        names = tuple(dict.fromkeys(name for instrument in instruments for name in instrument.names))
        types = {"grade": pl.String, "programme": pl.String, "positions": pl.Int64, "terms": pl.String}
        schema: dict[str, Any] = {axis: types.get(axis, pl.Float64) for axis in AXES}
        schema |= {"method": pl.String, "accepted": pl.Boolean, "reasons": pl.String}
        schema |= {f"{quantity}.{name}": pl.Float64 for quantity in ("error", "u", "bound") for name in names}
        return Job(
            definition={"campaign": self.model_dump()},
            items=self.cells * self.trials,
            task=partial(session_rows, self.seed, self.source, self.methods, self.intervals),
            label=label,
            schema=schema,
        )


def label(cell: Cell) -> Row:
    """The columns by which a cell differs from others."""
    return {**cell} | ({} if cell["positions"] is None else {"programme": None})


def read_campaign(path: Path) -> Campaign:
    """The campaign of a file. Raises InputError, one line, with up to three faults."""
    return validated(Campaign, toml_of(text_of_document(path), str(path)), str(path))
