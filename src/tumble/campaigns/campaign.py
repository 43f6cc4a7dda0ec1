"""Campaigns: many simulated calibrations over a grid of methods and conditions, from a TOML file to a table of errors.

    kind = "sessions"            "statics": accelerometers from rests alone, thousands of triads a trial
    source = "observations"      "log": sampled logs, through the whole chain (see `tumble.campaigns.trial`)
    seed = 1
    trials = 200                 of every point of the grid
    [grid]                       a value, or a list of them; every combination is a point of the grid
    method = ["joint", "scalar"]
    table_error_deg = [0.5, 1, 2]

Trial i belongs to point i mod P of the P points, so that all are about equally far at any time. All methods of a trial
see the same observations. What the rows hold is said in `tumble.campaigns.trial`; `tumble.campaigns.summary` sums
them up.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Sequence
from functools import cached_property, partial
from itertools import product
from pathlib import Path
from typing import Annotated, Any, Literal, Self, cast

import polars as pl
from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from tumble.campaigns.engine import Job, Row
from tumble.campaigns.trial import Cell, Source, session_rows, statics_rows
from tumble.documents import text_of_document, toml_of, validated
from tumble.planning.bounds import instrument_of
from tumble.planning.setup import NAMES, Setup
from tumble.programme.positions import BUILT_IN
from tumble.run.calibrate import DEFAULT_METHOD, ITERATED_METHODS, METHODS, Method
from tumble.sensors.grades import GRADES
from tumble.usual_setup import GRADE, INSTABILITY_TIME, LATITUDE_DEG, MOUNTING_ERROR_DEG, PROGRAMME, TABLE_ERROR_DEG

MOST_TASKS = 10_000_000


class _CampaignTable(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)


def _axis(usual: Any, expected: str | Iterable[str]) -> Any:
    """An axis of the grid: its usual value, and what its values are, in words or by their names."""
    words = expected if isinstance(expected, str) else f"one of {', '.join(expected)}"
    names: list[Any] | None = None if isinstance(expected, str) else list(expected)
    return Field(default=[usual], min_length=1, description=words, json_schema_extra={"names": names})


_Degrees = Annotated[float, Field(ge=0.0, le=10.0)]
_Seconds = Annotated[float, Field(ge=0.1, le=86_400.0)]
_Positive = Annotated[float, Field(gt=0.0, le=10_000.0)]


class _GridKeys(_CampaignTable):
    """Every axis is a list; a single value stands for a list of one. None, as with `tumble simulate`, for what is usual
    on a table or by hand. The axes are in the order in which they vary, the outermost first."""

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


AXES = tuple(axis for axis in _GridKeys.model_fields if axis != "method")
"""The axes of the grid apart from the method, outermost first."""


class Campaign(_CampaignTable):
    """What a campaign file says. `cells` are the points of the grid, apart from the methods."""

    kind: Literal["sessions", "statics"] = Field(default="sessions", description='"sessions" or "statics"')
    source: Source = Field(default="observations", description='"observations" or "log"')
    seed: int = Field(default=0, ge=0, le=2**63, description="a whole number, not negative")
    trials: int = Field(ge=1, le=MOST_TASKS, description=f"a whole number from 1 to {MOST_TASKS}")
    grid: _GridKeys = Field(default=_GridKeys(), description="a table")

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.kind == "statics" and (
            "source" in self.model_fields_set or {"method", "terms"} & self.grid.model_fields_set
        ):
            raise ValueError(
                'kind: expected neither source nor grid.method nor grid.terms with "statics", found one; leave it out'
            )
        if self.trials * math.prod(len(getattr(self.grid, axis)) for axis in AXES) > MOST_TASKS:
            raise ValueError(f"trials: expected at most {MOST_TASKS} over all points of the grid, found more")
        return self

    @property
    def methods(self) -> tuple[Method, ...]:
        """Those that every trial is calibrated by."""
        return tuple(cast("list[Method]", self.grid.method))

    @cached_property
    def cells(self) -> tuple[Cell, ...]:
        """The points of the grid, the last axis varying first."""
        points = product(*(getattr(self.grid, axis) for axis in AXES))
        return tuple(dict(zip(AXES, values, strict=True)) for values in points)

    def job(self) -> Job:
        """The campaign as a job of trials × cells tasks."""
        types = {"grade": pl.String, "programme": pl.String, "positions": pl.Int64, "terms": pl.String}
        schema: dict[str, Any] = {name: types.get(name, pl.Float64) for name in AXES} | {"method": pl.String}
        names: Sequence[str] = NAMES[:9]
        moments: Sequence[str] = ("mean", "square", "bound", "covered")
        rows: Any = partial(statics_rows, self.seed)
        if self.kind == "statics":
            schema |= {"triads": pl.Int64, "failed": pl.Int64}
        else:
            rows = partial(session_rows, self.seed, self.source, self.methods)
            instruments = [instrument_of(Setup.of(**cell), gyros=True) for cell in self.cells]
            names, moments = tuple(dict.fromkeys(n for i in instruments for n in i.names)), ("error", "u", "bound")
            schema |= {"accepted": pl.Boolean, "reasons": pl.String}
        schema |= {f"{what}.{name}": pl.Float64 for what in moments for name in names}
        items = self.cells * self.trials
        return Job(definition={"campaign": self.model_dump()}, items=items, task=rows, label=label, schema=schema)


def label(cell: Cell) -> Row:
    """The columns that tell a cell from others."""
    return {**cell} | ({} if cell["positions"] is None else {"programme": None})


def read_campaign(path: Path) -> Campaign:
    """The campaign of a file. Raises InputError, one line, with up to three faults."""
    return validated(Campaign, toml_of(text_of_document(path), str(path)), str(path))
