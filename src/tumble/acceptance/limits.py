"""Acceptance limits of a device type, from their file (TOML).

[incoming] and [periodic] give them by parameter ("accel.bias.x") or by kind ("accel.bias"); the longer name goes
before. A limit is "5 mg", which is ±5 mg about zero, or a table: min, max, or deviation, which is about the type's
systematic value in the calibration file that `systematic` names. With temperature_degC = [-20, 60] limits hold at every
temperature between these.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from tumble.acceptance.schedule import OCCASIONS, Occasion, Schedule, content_of, schedule_of
from tumble.documents import text_of_document
from tumble.errors import InputError, did_you_mean
from tumble.sensors.frames import FRAMES
from tumble.sensors.parameters import group_of, groups, meant_by, quantity_of

_FORMS = 'a text such as "5 mg", or a table with min and max, or one with deviation'


@dataclass(frozen=True, kw_only=True, slots=True)
class Limit:
    """Between which values (SI) a parameter has to be; with `relative`, its deviation from the systematic value."""

    low: float
    high: float
    relative: bool = False


@dataclass(frozen=True, kw_only=True, slots=True)
class Limits:
    """Acceptance limits of a device type by check and by parameter or kind; its systematic values (SI); when its
    devices are due; the `temperatures`, °C, between which the limits hold, where they are not those at the
    reference."""

    frame: str
    checks: Mapping[Occasion, Mapping[str, Limit]]
    systematic: Mapping[str, float]
    schedule: Schedule
    temperatures: tuple[float, float] | None = None

    def of(self, name: str, occasion: Occasion) -> tuple[float, float] | None:
        """The lowest and the highest value (SI) of a parameter; None where it has no limit."""
        by_key = self.checks.get(occasion, {})
        keys = [key for key in by_key if meant_by(key, name)]
        if not keys:
            return None
        limit = by_key[max(keys, key=len)]
        about = self.systematic.get(name, math.nan) if limit.relative else 0.0
        return about + limit.low, about + limit.high


def limits_of(path: Path) -> Limits:
    """The limits of a file. Raises InputError, one line."""
    return parse_limits(*read_limits(path), str(path))


def read_limits(path: Path) -> tuple[str, str | None]:
    """The text of a file of limits, and that of the calibration file it names, both checked.

    Raises InputError, one line."""
    text = _text(path)
    named = content_of(text, str(path)).get("systematic")
    if named is not None and (not isinstance(named, str) or not named):
        raise InputError(f"{path}: systematic: expected the name of a calibration file, found {named!r}")
    systematic = None if named is None else _text(path.parent / named)
    parse_limits(text, systematic, str(path))
    return text, systematic


def _text(path: Path) -> str:
    try:
        return text_of_document(path)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error
    except ValueError as error:
        raise InputError(f"{path}: expected UTF-8 text, found {error}") from error


@lru_cache(maxsize=64)
def parse_limits(text: str, systematic: str | None, name: str) -> Limits:
    """The limits of the text of a file and of the calibration it names. Raises InputError, one line."""
    content = content_of(text, name)
    frame = content.get("frame", "accelerometer")
    if frame not in FRAMES:
        raise InputError(f"{name}: frame: expected one of {', '.join(FRAMES)}, found {frame!r}")
    tables = {occasion: content[occasion] for occasion in OCCASIONS if occasion in content}
    for occasion, table in tables.items():
        if not isinstance(table, dict):
            raise InputError(f"{name}: {occasion}: expected a table of limits, found {table!r}")
    checks = {
        occasion: {key: _limit(key, value, f"{name}: {occasion}: {key}") for key, value in table.items()}
        for occasion, table in tables.items()
    }
    if not any(checks.values()):
        raise InputError(f"{name}: expected limits in [incoming] or [periodic], found none")
    values: Mapping[str, float] = {}
    if systematic is not None:
        from tumble.result.calibration import calibration_of

        calibration = calibration_of(systematic, f"{name}: systematic")
        if calibration.frame != frame:
            raise InputError(
                f"{name}: systematic: expected a calibration in the frame {frame!r} of the limits, found "
                f"{calibration.frame!r}"
            )
        values = {p.name: p.value for p in calibration.parameters}
    for occasion, by_key in checks.items():
        for key, limit in by_key.items():
            if limit.relative and not any(meant_by(key, parameter) for parameter in values):
                raise InputError(
                    f"{name}: {occasion}: {key}: expected a systematic value to deviate from, found none; name a "
                    "calibration file that has it: systematic = FILE"
                )
    given, temperatures = content.get("temperature_degC"), None
    if given is not None:
        numbers = isinstance(given, list) and all(isinstance(n, int | float) and not isinstance(n, bool) for n in given)
        if not numbers or len(given) != 2 or not -273.15 <= given[0] < given[1] <= 1000.0:
            raise InputError(
                f"{name}: temperature_degC: expected the lowest and the highest, as [-20, 60], found {given!r}"
            )
        temperatures = float(given[0]), float(given[1])
    schedule = schedule_of(content, name)
    return Limits(frame=frame, checks=checks, systematic=values, schedule=schedule, temperatures=temperatures)


def _limit(key: str, value: Any, where: str) -> Limit:
    """A limit as it is typed, under the name of a parameter or a kind."""
    try:
        kind = group_of(key)
    except KeyError:
        said = 'expected a quoted name such as "accel.bias" or "gyro.axis.xy", found'
        raise InputError(f"{where}: {said} {key!r}{did_you_mean(key, (group.name for group in groups()))}") from None

    def number(typed: Any) -> float:
        if not isinstance(typed, str):
            raise InputError(f"{where}: expected {_FORMS}, found {typed!r}")
        try:
            return quantity_of(kind, typed)
        except ValueError as error:
            raise InputError(f"{where}: {error}") from None

    relative = isinstance(value, dict) and set(value) == {"deviation"}
    if relative or isinstance(value, str):
        typed = value["deviation"] if relative else value
        size = number(typed)
        if size <= 0.0:
            raise InputError(f"{where}: expected more than 0, found {typed!r}")
        return Limit(low=-size, high=size, relative=relative)
    if not isinstance(value, dict) or not value or not set(value) <= {"min", "max"}:
        raise InputError(f"{where}: expected {_FORMS}, found {value!r}")
    low = number(value["min"]) if "min" in value else -math.inf
    high = number(value["max"]) if "max" in value else math.inf
    if low >= high:
        raise InputError(f"{where}: expected a min below max, found {value['min']!r} and {value['max']!r}")
    return Limit(low=low, high=high)
