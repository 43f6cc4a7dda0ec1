"""Acceptance limits of a device type, and the verdict on every parameter.

In the file of limits (TOML), [incoming] and [periodic] give them by parameter ("accel.bias.x") or by kind
("accel.bias"); the longer name goes before. A limit is "5 mg", which is ±5 mg about zero, or a table: min, max, or
deviation, which is about the type's systematic value in the calibration file that `systematic` names.

With temperature_degC = [-20, 60] they hold at every temperature between these: a parameter is judged at the one where
it is worst (`tumble.registry.conformity`).

The decision rule is RULE. With the limits low, high and the expanded uncertainty U = t₉₅.₄₅(ν) u:

    pass                inside the limits by at least U: low + U ≤ value ≤ high − U
    conditional pass    inside by less
    conditional fail    outside by no more than U
    fail                outside by more

Source: ILAC-G8:09/2019, 4.2.3 (guard band w = U on either side of a limit, JCGM 106:2012, 8.3).
"""

from __future__ import annotations

import calendar
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from datetime import date
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal, get_args

from tumble.calibration.coverage import expanded_of
from tumble.documents import text_of_document, toml_of
from tumble.errors import InputError, did_you_mean
from tumble.registry.records import OCCASIONS, Occasion, ParameterRow
from tumble.sensors.frames import FRAMES
from tumble.sensors.parameters import ParameterGroup, group_of, groups, meant_by
from tumble.sensors.typed_quantities import quantity_of

FORMAT = 1

RULE = (
    "decision rule: pass where the value is inside its limits by at least U (95.45 %), conditional pass where it is "
    "inside by less, conditional fail where it is outside by no more than U, fail where it is outside by more (guard "
    "band w = U: ILAC-G8:09/2019, 4.2.3)"
)

Result = Literal["fail", "undecided", "conditional fail", "conditional pass", "pass"]
RESULTS: tuple[Result, ...] = get_args(Result)
"""The worst first; undecided is what has no value or no U, or was not measured at all temperatures."""

_OF_A_VALUE: tuple[Result, ...] = ("fail", "conditional fail", "conditional pass")

_KEYS = ("format", "frame", "systematic", "interval_months", "device_interval_months", "temperature_degC", *OCCASIONS)
_FORMS = 'a text such as "5 mg", or a table with min and max, or one with deviation'


@dataclass(frozen=True, kw_only=True, slots=True)
class Limit:
    """Between which values (SI) a parameter has to be; with `relative`, its deviation from the systematic value."""

    low: float
    high: float
    relative: bool


@dataclass(frozen=True, kw_only=True, slots=True)
class Limits:
    """Acceptance limits of a device type by check and by parameter or kind; its systematic values (SI); months between
    calibrations, of the type and of devices that have their own; the `temperatures`, °C, between which the limits hold,
    where they are not those at the reference."""

    frame: str
    checks: Mapping[Occasion, Mapping[str, Limit]]
    systematic: Mapping[str, float]
    interval_months: int | None
    device_interval_months: Mapping[str, int]
    temperatures: tuple[float, float] | None = None

    def interval(self, serial: str) -> int | None:
        """Months between calibrations of a device."""
        return self.device_interval_months.get(serial, self.interval_months)

    def due(self, serial: str, performed: date) -> date | None:
        """The day the next calibration of a device is due by the calendar; None without an interval."""
        months = self.interval(serial)
        return None if months is None else months_later(performed, months)

    def of(self, name: str, occasion: Occasion) -> tuple[float, float] | None:
        """The lowest and the highest value (SI) of a parameter; None where it has no limit."""
        own = self.checks.get(occasion, {})
        keys = [key for key in own if meant_by(key, name)]
        if not keys:
            return None
        limit = own[max(keys, key=len)]
        about = self.systematic.get(name, math.nan) if limit.relative else 0.0
        return about + limit.low, about + limit.high


@dataclass(frozen=True, kw_only=True, slots=True)
class LimitJudgement:
    """A parameter (SI) against its limits; `expanded` is U. A parameter that was not determined has no value. Over
    temperature it is that `at` the temperature, °C, where it is worst; `beyond` says that not all temperatures were
    measured."""

    name: str
    unit: str
    value: float | None
    expanded: float | None
    low: float
    high: float
    result: Result
    at: float | None = None
    beyond: bool = False

    @property
    def named(self) -> str:
        """The parameter, with the temperature at which it is worst."""
        return self.name if self.at is None else f"{self.name} at {self.at:.1f} °C".replace("at -", "at −")


@dataclass(frozen=True, kw_only=True, slots=True)
class Verdict:
    """Every parameter that has a limit, judged in the frame of the limits; over the `temperatures`, °C, between which
    these hold, and what of them was not measured, in words."""

    occasion: Occasion
    frame: str
    judgements: tuple[LimitJudgement, ...]
    temperatures: tuple[float, float] | None = None
    unmeasured: str = ""

    @property
    def over(self) -> str:
        """Between which temperatures a verdict stands, in words; nothing where it is that at the reference."""
        if self.temperatures is None:
            return ""
        low, high = (f"{each:g}".replace("-", "−") for each in self.temperatures)
        return (
            f"{'within limits' if self.result == 'pass' else 'not shown to be within limits'} from {low} to {high} °C"
        )

    @property
    def result(self) -> Result:
        """The worst of the results."""
        return min((j.result for j in self.judgements), key=RESULTS.index)

    def reasons(self) -> list[str]:
        """Which parameters do not pass, and why, in words."""
        unmeasured = f"not measured {self.unmeasured}" if self.unmeasured else "not known over temperature"
        undecided = [j for j in self.judgements if j.result == "undecided"]
        groups: dict[str, list[LimitJudgement]] = {
            **{each: [j for j in self.judgements if j.result == each] for each in _OF_A_VALUE},
            unmeasured: [j for j in undecided if j.beyond],
            "without U": [j for j in undecided if j.expanded is None and j.value is not None and not j.beyond],
            "not determined": [j for j in undecided if j.value is None],
        }
        return [f"{what}: {', '.join(j.named for j in judged)}" for what, judged in groups.items() if judged]


def months_later(day: date, months: int) -> date:
    """The same day so many months later, or the last one of a month that is too short."""
    year, month = divmod(day.year * 12 + day.month - 1 + months, 12)
    return date(year, month + 1, min(day.day, calendar.monthrange(year, month + 1)[1]))


def judge(
    limits: Limits, occasion: Occasion, parameters: Iterable[ParameterRow], unobservable: Iterable[str] = ()
) -> Verdict | None:
    """The verdict on the parameters of a calibration in the frame of the limits; None where the limits have none for
    such a check. Parameters that have a limit and were not determined do not pass: those that the calibration calls
    `unobservable`, and a kind without any parameter."""
    own = limits.checks.get(occasion)
    if not own:
        return None
    rows = [row for row in parameters if row.launch == 0]
    judged = [_judged(row, found) for row in rows if (found := limits.of(row.name, occasion)) is not None]
    named = [*(row.name for row in rows), *unobservable]
    missing = [name for name in unobservable if limits.of(name, occasion) is not None]
    missing += [key for key in own if not any(meant_by(key, name) for name in named)]
    judged += [_not_determined(name, limits.of(name, occasion) or (-math.inf, math.inf)) for name in missing]
    return Verdict(occasion=occasion, frame=limits.frame, judgements=tuple(judged))


def _not_determined(name: str, limits: tuple[float, float]) -> LimitJudgement:
    low, high = limits
    unit = group_of(name).unit
    return LimitJudgement(name=name, unit=unit, value=None, expanded=None, low=low, high=high, result="undecided")


def _judged(row: ParameterRow, limits: tuple[float, float]) -> LimitJudgement:
    low, high = limits
    expanded = None if row.u is None else expanded_of(row.u, row.dof)
    return LimitJudgement(
        name=row.name,
        unit=row.unit,
        value=row.value,
        expanded=expanded,
        low=low,
        high=high,
        result=judge_value(row.value, row.u, low, high, row.dof),
    )


def judge_value(value: float, u: float | None, low: float, high: float, dof: float | None = None) -> Result:
    """The verdict on a value with its standard uncertainty and degrees of freedom (module docstring); undecided without
    one, with too few for a U, or where a limit is not a number."""
    expanded = None if u is None else expanded_of(u, dof)
    if expanded is None or math.isnan(low) or math.isnan(high):
        return "undecided"
    return result_inside(min(value - low, high - value), expanded)


def result_inside(inside: float, expanded: float) -> Result:
    """The verdict on a value that is so far `inside` its limits, with U."""
    if inside >= 0.0:
        return "pass" if inside >= expanded else "conditional pass"
    return "conditional fail" if inside >= -expanded else "fail"


# -------------------- the file --------------------


def limits_of(path: Path) -> Limits:
    """The limits of a file. Raises InputError, one line."""
    return parse_limits(*read_limits(path), str(path))


def read_limits(path: Path) -> tuple[str, str | None]:
    """The text of a file of limits, and that of the calibration file it names, both checked.

    Raises InputError, one line."""
    text = _text(path)
    named = _content(text, str(path)).get("systematic")
    systematic = None
    if named is not None:
        if not isinstance(named, str) or not named:
            raise InputError(f"{path}: systematic: expected the name of a calibration file, found {named!r}")
        systematic = _text(path.parent / named)
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
    content = _content(text, name)
    frame = content.get("frame", "accelerometer")
    if frame not in FRAMES:
        raise InputError(f"{name}: frame: expected one of {', '.join(FRAMES)}, found {frame!r}")
    checks = {occasion: _check(content[occasion], occasion, name) for occasion in OCCASIONS if occasion in content}
    if not any(checks.values()):
        raise InputError(f"{name}: expected limits in [incoming] or [periodic], found none")
    limits = Limits(
        frame=frame,
        checks=checks,
        systematic={} if systematic is None else _systematic(systematic, frame, name),
        interval_months=None if "interval_months" not in content else _months(content, "interval_months", name),
        device_interval_months=_device_months(content, name),
        temperatures=_temperatures(content, name),
    )
    _check_relative(limits, name)
    return limits


def _content(text: str, name: str) -> dict[str, Any]:
    content = toml_of(text, name)
    if content.get("format") != FORMAT:
        raise InputError(f"{name}: format: expected {FORMAT}, found {content.get('format', 'none')!r}")
    for key in content:
        if key not in _KEYS:
            raise InputError(f"{name}: expected the keys {', '.join(_KEYS)}, found {key!r}")
    return content


def _check(content: Any, occasion: str, name: str) -> Mapping[str, Limit]:
    if not isinstance(content, dict):
        raise InputError(f"{name}: {occasion}: expected a table of limits, found {content!r}")
    return {key: _limit(key, value, f"{name}: {occasion}: {key}") for key, value in content.items()}


def _limit(key: str, value: Any, where: str) -> Limit:
    try:
        kind = group_of(key)
    except KeyError:
        said = 'expected a quoted name such as "accel.bias" or "gyro.axis.xy", found'
        raise InputError(f"{where}: {said} {key!r}{did_you_mean(key, (group.name for group in groups()))}") from None
    if isinstance(value, str):
        size = _size(value, kind, where)
        return Limit(low=-size, high=size, relative=False)
    if isinstance(value, dict) and set(value) == {"deviation"}:
        size = _size(value["deviation"], kind, where)
        return Limit(low=-size, high=size, relative=True)
    if isinstance(value, dict) and value and set(value) <= {"min", "max"}:
        low = _number(value["min"], kind, where) if "min" in value else -math.inf
        high = _number(value["max"], kind, where) if "max" in value else math.inf
        if low < high:
            return Limit(low=low, high=high, relative=False)
        raise InputError(f"{where}: expected a min below max, found {value['min']!r} and {value['max']!r}")
    raise InputError(f"{where}: expected {_FORMS}, found {value!r}")


def _number(value: Any, kind: ParameterGroup, where: str) -> float:
    if not isinstance(value, str):
        raise InputError(f"{where}: expected {_FORMS}, found {value!r}")
    try:
        return quantity_of(kind, value)
    except ValueError as error:
        raise InputError(f"{where}: {error}") from None


def _size(value: Any, kind: ParameterGroup, where: str) -> float:
    size = _number(value, kind, where)
    if size <= 0.0:
        raise InputError(f"{where}: expected more than 0, found {value!r}")
    return size


def _months(content: Mapping[str, Any], key: str, name: str) -> int:
    months = content[key]
    if isinstance(months, bool) or not isinstance(months, int) or not 1 <= months <= 1200:
        raise InputError(f"{name}: {key}: expected a whole number of months from 1 to 1200, found {months!r}")
    return months


def _device_months(content: Mapping[str, Any], name: str) -> Mapping[str, int]:
    own = content.get("device_interval_months", {})
    if not isinstance(own, dict):
        raise InputError(f"{name}: device_interval_months: expected a table of serial numbers, found {own!r}")
    return {serial: _months(own, serial, f"{name}: device_interval_months") for serial in own}


def _temperatures(content: Mapping[str, Any], name: str) -> tuple[float, float] | None:
    """Between which temperatures, °C, limits hold, where they are not those at the reference."""
    given = content.get("temperature_degC")
    if given is None:
        return None
    numbers = isinstance(given, list) and all(isinstance(n, int | float) and not isinstance(n, bool) for n in given)
    if not numbers or len(given) != 2 or not -273.15 <= given[0] < given[1] <= 1000.0:
        raise InputError(
            f"{name}: temperature_degC: expected the lowest and the highest, as [-20, 60], found {given!r}"
        )
    return float(given[0]), float(given[1])


def _systematic(text: str, frame: str, name: str) -> Mapping[str, float]:
    from tumble.calibration.calibration_file import calibration_of

    calibration = calibration_of(text, f"{name}: systematic")
    if calibration.frame != frame:
        raise InputError(
            f"{name}: systematic: expected a calibration in the frame {frame!r} of the limits, found "
            f"{calibration.frame!r}"
        )
    return {p.name: p.value for p in calibration.parameters}


def _check_relative(limits: Limits, name: str) -> None:
    """That there is a systematic value for every limit that is about one."""
    for occasion, own in limits.checks.items():
        for key, limit in own.items():
            known = any(meant_by(key, p) for p in limits.systematic)
            if limit.relative and not known:
                raise InputError(
                    f"{name}: {occasion}: {key}: expected a systematic value to deviate from, found none; name a "
                    "calibration file that has it: systematic = FILE"
                )
