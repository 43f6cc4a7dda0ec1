"""The table of parameter groups: names, units, usual spread, and their effect on a rest and a turn.

A reading is linear in functions β of the specific force f and the rate ω,

    y_p = Σ_b K_pb β_pb(f, ω),    β = 1, ω (3), f (3), products f_k f_l (6), |x_p|, x_p³                   (3)

x_p being the component of the measured vector along the nominal axis of sensor p. K (n, 15) holds the sensitivity
matrix and the bias, and every further group adds to it: a group is the constant array ∂K/∂θ, its `regressors`
(n, 15, m). Some groups change no reading at rest: lever arms and delays act only in a turn, and are named by `Motion`.

Everything that deals with parameters loops over the table, parameters.toml: estimation, bounds, planning, simulation,
frames, the calibration file, terminal, report, registry and limits. A further group is one entry, or one of another
package (`tumble.plugins`).

The groups are those of docs/explanation/mathematics.md (1) and (2). Their usual sizes are from data sheets, and for
MEMS from recordings (`source`).
"""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, lru_cache
from operator import attrgetter
from pathlib import Path
from typing import Any, Literal

import numpy as np

from tumble.errors import InputError
from tumble.plugins import load_all
from tumble.sensors.model import Block, SensorKind
from tumble.units import (
    ARCSEC,
    DEGREE,
    DEGREE_PER_HOUR,
    G_STANDARD,
    READ,
    Array,
    as_typed,
    coarsest,
    engineering,
    quantity,
)

FUNCTIONS = 15  # number of functions β, and the index of each
CONSTANT, RATE, FORCE, PRODUCTS, OWN_SIZE, OWN_CUBE = 0, slice(1, 4), slice(4, 7), slice(7, 13), 13, 14
PAIRS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))  # k and l of the products f_k f_l

Terms = Literal["full", "linear"]
"""Parameters of an instrument: all groups of the table, or only bias, scale factor and axis angles."""
Motion = Literal["lever", "delay", "single delay"]
"""Effect on turns of a group of parameters that has none on rests."""
Variable = Literal["time", "temperature", "temperature²", "temperature³", "hysteresis", "launch", "lag"]
"""Variable that a change of a parameter is proportional to: time from the mean of a session's rests, s; temperature
from the reference, K, its square and cube; the direction of temperature change, −1 … 1; the session. A lag shifts the
temperatures."""
THERMAL: tuple[Variable, ...] = ("temperature", "temperature²", "temperature³")  # in the order of their powers
Regressors = Callable[[Block], Array]  # ∂K/∂θ (n, 15, m) of a block for a group's parameters

MICRO_G = 1e-6 * G_STANDARD
DATA_SHEETS = "data sheets of the class"
TYPICAL_OF_BOUND = 0.1
"""Standard deviation at 1 g relative to the bound of a data sheet for the whole range: chips with bounds of 600 µg/g²
and more have some 50."""
CURVED = 1.0 / 60.0  # 1/K: usual curvature over usual slope, which have the same effect at 60 K from the reference


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ParameterGroup:
    """A group of parameters of one `kind` of sensors, such as "accel.quadratic".

    `unit`: SI unit. `words`: name in reports. `suffixes`: names of its parameters for a block, behind the name of the
    group or another `stem`. `limit`: largest plausible deviation from nominal, SI. `shown`: units in which it is shown,
    (size in SI, name), the smallest first. `usual`: standard deviation over instruments by grade, in the order of the
    grades in the file. It is the prior of further groups, which an estimate may widen but not narrow; for bias, scale
    factor and axes, whose prior is `limit`, it serves plans and simulations. A grade that is missing has the group only
    if a data sheet states it. `regressors`: None for bias, scale and axis angles, whose derivative is `Block.jacobian`,
    for groups with a `motion`, and for changes. `motion`: effect on a turn, if there is none on a rest. `base`,
    `variable`: for a change of another group, that group and what it is proportional to; a lag has no base.
    `sized_with`: a group that rests hardly separate from it; one factor enlarges both. `source`: of the usual size in
    MEMS instruments (those of tactical and navigation instruments are from data sheets, and never larger than that of a
    poorer grade)."""

    name: str
    kind: SensorKind
    unit: str
    words: str
    suffixes: Callable[[Block], tuple[str, ...]]
    limit: float
    shown: tuple[tuple[float, str], ...] = ()
    usual: Mapping[str, float] = field(default_factory=dict)
    regressors: Regressors | None = None
    motion: Motion | None = None
    stem: str | None = None
    base: str | None = None
    variable: Variable | None = None
    sized_with: str | None = None
    source: str = DATA_SHEETS

    @property
    def linear(self) -> bool:
        """Whether the group belongs to the linear model: bias, scale factor and axis angles."""
        return self.regressors is None and self.motion is None and self.variable is None

    def names(self, block: Block) -> tuple[str, ...]:
        """Return the parameter names for a block of sensors."""
        stem, ending = self.stem or self.base or self.name, "" if self.base is None else f".{_ENDINGS[self.variable]}"
        return tuple(f"{stem}.{suffix}{ending}" if suffix else f"{stem}{ending}" for suffix in self.suffixes(block))

    def thermometers(self, block: Block) -> tuple[int, ...]:
        """Return the thermometer of the sensor of each parameter."""
        by_sensor = dict(zip(block.sensors, block.thermometer[block.channels].tolist(), strict=True))
        return tuple(by_sensor.get(s[:1] if block.triad else s.partition(".")[0], 0) for s in self.suffixes(block))


_CHANGES: dict[Variable | None, tuple[str, str, str]] = {
    "time": ("drift", "s", "drift of the "),
    "temperature": ("t1", "K", "slope over temperature of the "),
    "temperature²": ("t2", "K^2", "curvature over temperature of the "),
    "temperature³": ("t3", "K^3", "cubic term over temperature of the "),
    "hysteresis": ("hysteresis", "", "hysteresis over temperature of the "),
    "launch": ("launch", "", "change from session to session of the "),
}
"""Ending of the name of a parameter that is a change of another, divisor of its unit, and its words."""
_ENDINGS = {variable: ending for variable, (ending, _, _) in _CHANGES.items()}
OVER_TEMPERATURE = tuple(_ENDINGS[variable] for variable in THERMAL)  # endings of coefficients of polynomials


_SUFFIXES: Mapping[str, Callable[[Block], tuple[str, ...]]] = {
    "sensors": attrgetter("sensors"),
    "angles": attrgetter("angles"),
    "others": lambda block: block.sensors[:-1],
    "by force": lambda block: tuple(s + ("" if block.triad else ".") + axis for s in block.sensors for axis in "xyz"),
    "levers": lambda block: tuple(f"{sensor}.{axis}" for sensor in block.sensors[:-1] for axis in "xyz"),
    "once": lambda _: ("",),
}


def _own(function: int) -> Regressors:
    """Return the regressors of a function of each sensor's own component."""

    def regressors(block: Block) -> Array:
        out = np.zeros((block.size, FUNCTIONS, block.size))
        out[block.channels, function, np.arange(block.size)] = 1.0
        return out

    return regressors


def quadratic(block: Block) -> Array:
    """Return ∂K/∂K₂ (n, 15, n): the square of the force along the nominal axis a, Σ a_k a_l f_k f_l."""
    out = np.zeros((block.size, FUNCTIONS, block.size))
    axes = block.axes[block.channels]
    for b, (k, other) in enumerate(PAIRS, start=PRODUCTS.start):
        out[block.channels, b, np.arange(block.size)] = (1.0 if k == other else 2.0) * axes[:, k] * axes[:, other]
    return out


def g_sensitivity(block: Block) -> Array:
    """Return ∂K/∂G (n, 15, 3n): each gyro by each component of the specific force."""
    out = np.zeros((block.size, FUNCTIONS, 3 * block.size))
    for j, channel in enumerate(block.channels):
        out[channel, FORCE, 3 * j : 3 * j + 3] = np.eye(3)
    return out


_REGRESSORS: Mapping[str, Regressors] = {
    "own square": quadratic,
    "own cube": _own(OWN_CUBE),
    "own size": _own(OWN_SIZE),
    "force": g_sensitivity,
}

_HOUR = 3600.0
_AT_TEN = 1e-6 / (10.0 * DEGREE) ** 2
_SIZES: Mapping[str, float] = {
    "ng": 1e-3 * MICRO_G, "µg": MICRO_G, "mg": 1e3 * MICRO_G, "ppb": 1e-9, "ppm": 1e-6, "arcsec": ARCSEC,
    "°/h": DEGREE_PER_HOUR, "°/s": DEGREE, "°/√h": DEGREE / 60.0, "µs": 1e-6, "ms": 1e-3, "s": 1.0, "mm": 1e-3,
    "µg/g²": 1e-6 / G_STANDARD, "mg/g²": 1e-3 / G_STANDARD, "µg/g³": 1e-6 / G_STANDARD**2,
    "mg/g³": 1e-3 / G_STANDARD**2, "°/h/g": DEGREE_PER_HOUR / G_STANDARD, "°/s/g": DEGREE / G_STANDARD,
    "ppm at 100 °/s": 0.01 * _AT_TEN, "ppm at 10 °/s": _AT_TEN,
}  # fmt: skip
"""SI values of the units in the tables."""


def size_of(written: float | str) -> float:
    """Return a size written in SI, or with a unit of the tables, in SI."""
    number, _, unit = str(written).partition(" ")
    return float(number) * _SIZES[unit] if unit else float(number)


def _usual(row: Mapping[str, Any], key: str = "usual") -> dict[str, float]:
    """Return the sizes of a row by grade."""
    return dict(zip(("navigation", "tactical", "mems", "consumer"), map(size_of, row.get(key, ())), strict=False))


def _shown(units: Iterable[str], per: str = "", size: float = 1.0) -> tuple[tuple[float, str], ...]:
    """Return units, divided by another, as (size in SI, name)."""
    return tuple((_SIZES[unit.removesuffix("/°C³")] / size, unit + per) for unit in units)


def _entry(row: Mapping[str, Any]) -> ParameterGroup:
    """Return the group of a row that is no change of another."""
    more = {key: row[key] for key in ("motion", "stem", "variable", "sized_with", "source") if key in row}
    return ParameterGroup(
        name=row["name"],
        kind=row["name"].partition(".")[0],
        unit=row["unit"],
        words=row["words"],
        suffixes=_SUFFIXES[row.get("named", "sensors")],
        limit=size_of(row["limit"]),
        shown=_shown(row.get("shown", ())),
        usual=_usual(row),
        regressors=_REGRESSORS.get(row.get("regressors", "")),
        **more,
    )


_TABLE: Mapping[str, Any] = tomllib.loads((Path(__file__).parent / "parameters.toml").read_text(encoding="utf-8"))
LINEAR, MAGNETIC = (tuple(map(_entry, _TABLE[part])) for part in ("linear", "magnetic"))
"""Bias, scale-factor error and axis angles, of accelerometers and gyros, and of a magnetometer."""


def _changes(row: Mapping[str, Any]) -> Iterator[ParameterGroup]:
    """Yield the change of a group of the linear model with a variable, or its drift, slope and curvature."""
    group = next(group for group in LINEAR if group.name == row["base"])

    def change(
        variable: Variable, shown: tuple[tuple[float, str], ...], usual: dict[str, float], scaled: float = 1.0
    ) -> ParameterGroup:
        ending, per, words = _CHANGES[variable]
        return replace(
            group,
            name=f"{group.name}.{ending}",
            unit=f"{group.unit}/{per}" if per else group.unit,
            words=words + group.words,
            shown=shown,
            usual={grade: scaled * size for grade, size in usual.items()},
            base=group.name,
            variable=variable,
        )

    if "variable" in row:
        yield change(row["variable"], _shown(row["shown"]), _usual(row))
        return
    per_kelvin = _usual(row, "per_kelvin")
    yield change("time", _shown(row["shown"], "/h", _HOUR), _usual(row, "per_hour"), 1.0 / _HOUR)
    yield change("temperature", _shown(row["shown"], "/°C"), per_kelvin)
    yield change("temperature²", _shown((*row.get("finer", ()), *row["shown"]), "/°C²"), per_kelvin, CURVED)


FURTHER: list[ParameterGroup] = [
    group for row in _TABLE["further"] for group in (_changes(row) if "base" in row else [_entry(row)])
]
"""The groups beyond the linear model, in the order of the calibration file."""


DRIFT_IN_PROCESS = ("mems", "consumer")  # grades whose in-run process of the biases includes their drift


@cache
def _plugin_groups() -> tuple[ParameterGroup, ...]:
    """Return the groups of other packages. Raises InputError if a name is taken, or not of accelerometers or gyros, or
    if a group has no regressors, without which it would not be estimated."""
    loaded = load_all("parameters", ParameterGroup).values()
    taken = {group.name for group in (*LINEAR, *FURTHER)}
    for group in loaded:
        if group.name in taken or not re.fullmatch(rf"{group.kind}\.[a-z0-9_]+", group.name):
            raise InputError(
                f"entry point tumble.parameters: expected the name of a group that is new, such as {group.kind}.fifth, "
                f"found {group.name!r}; rename it in its package"
            )
        if group.linear:
            raise InputError(
                f"entry point tumble.parameters: expected regressors of the group {group.name!r}, found none; give "
                "regressors= in its package"
            )
    return tuple(loaded)


def further_groups() -> tuple[ParameterGroup, ...]:
    """Return the groups beyond the linear model: those of the table and of other packages."""
    return (*FURTHER, *_plugin_groups())


def groups() -> tuple[ParameterGroup, ...]:
    """Return all groups, in the order of the calibration file."""
    return (*LINEAR, *further_groups())


@lru_cache(maxsize=4096)
def group_name(parameter: str) -> str:
    """Return the group of a parameter: "accel.bias" for "accel.bias.x", "accel.bias.t1" for "accel.bias.x.t1",
    "accel.single_delay" for "accel.delay.x"."""
    parts = parameter.split(".")
    stem = ".".join(parts[:2])
    by_stem = {group.stem: group.name for group in reversed(further_groups()) if group.stem is not None}
    if len(parts) > 2 and stem in by_stem:
        return by_stem[stem]
    return ".".join([stem, *(parts[-1:] if parts[-1] in _ENDINGS.values() else [])])


def units_of(parameters: Iterable[str]) -> tuple[str, ...]:
    """Return the SI units of parameters."""
    by_name = _by_name()
    return tuple(by_name[group_name(parameter)].unit for parameter in parameters)


def sensor_kind(parameter: str) -> str:
    """Return the kind of sensor of a parameter: "accel" for "accel.bias.x"."""
    return parameter.partition(".")[0]


def within_kind(parameter: str) -> str:
    """Return the name of a parameter or group within its kind of sensor: "bias.x" for "accel.bias.x"."""
    return parameter.partition(".")[2]


def within_group(parameter: str) -> str:
    """Return the name of a parameter within its group: "x" for "accel.bias.x", "x.t1" for "accel.bias.x.t1"; "" if it
    is the only one."""
    return within_kind(within_kind(parameter))


def variable_of(parameter: str) -> Variable | None:
    """Return the variable of a parameter or group that is a change, else None."""
    group = named_group(group_name(parameter))
    return None if group is None else group.variable


def group_of(parameter: str) -> ParameterGroup:
    """Return the group of a parameter. Raises KeyError if the table has none."""
    group = named_group(group_name(parameter))
    if group is None:
        raise KeyError(parameter)
    return group


def named_group(name: str) -> ParameterGroup | None:
    """Return the group of this name, None if the table has none."""
    return _by_name().get(name)


def _by_name() -> dict[str, ParameterGroup]:
    return {group.name: group for group in (*groups(), *MAGNETIC)}


def is_parameter(name: str) -> bool:
    """Return True if a name is that of a parameter of some sensor."""
    entry = named_group(group_name(name))
    sensor = within_group(name).removesuffix(f".{_ENDINGS.get(entry.variable, '')}") if entry else ""
    return entry is not None and bool(sensor or entry.suffixes is _SUFFIXES["once"])


def name_covers(name: str, parameter: str) -> bool:
    """Return True if a name, of a parameter, of a group or of one sensor in it ("gyro.g_sensitivity.x"), includes a
    parameter: "accel.bias" includes "accel.bias.x", but not its change "accel.bias.x.t1", which has its own group."""
    group = group_name(parameter)
    return name in (parameter, group) or (parameter.startswith(f"{name}.") and group == group_name(name))


def to_temperature(names: Sequence[str], warmer: float | Array) -> Array:
    """Return the matrix (m, m) that takes parameters of these names to a reference temperature higher by `warmer` K,
    for each (m,) or all, by their polynomials of temperature: (d + w)^k = Σ_j C(k, j) w^(k−j) d^j."""
    out, index = np.eye(len(names)), {name: i for i, name in enumerate(names)}
    warming = np.broadcast_to(warmer, len(names)).tolist()
    for i, name in enumerate(names):
        base, _, ending = name.rpartition(".")
        if base not in index or ending not in OVER_TEMPERATURE:
            continue
        power = 1 + OVER_TEMPERATURE.index(ending)
        for j, lower in enumerate([base, *(f"{base}.{ending}" for ending in OVER_TEMPERATURE[: power - 1])]):
            if lower in index:
                out[index[lower], i] = math.comb(power, j) * warming[i] ** (power - j)
    return out


def beyond_linear(parameter: str) -> bool:
    """Return True if a parameter belongs to a group beyond bias, scale factor and axis angles."""
    group = named_group(group_name(parameter))
    return group is not None and not group.linear


def shown_in(name: str, unit: str, magnitude: float) -> tuple[float, str]:
    """Return the unit, (size in SI, name), in which a parameter or group of this name, SI unit and magnitude is shown:
    that of the table, such as µg/g² or mm, else the engineering unit."""
    group = named_group(group_name(name))
    if group is not None and group.shown and group.unit == unit:
        return coarsest(group.shown, magnitude)
    return engineering(unit, magnitude)


def limits_of(parameters: Iterable[str]) -> Array:
    """Return the largest plausible deviations from nominal of parameters of these names, SI."""
    by_name = _by_name()
    return np.array([by_name[group_name(parameter)].limit for parameter in parameters])


def usual_sizes(grade: str, prior: Mapping[str, float] | None = None) -> dict[str, float]:
    """Return the standard deviations, SI, by group, of the groups beyond the linear model in instruments of a grade,
    replaced by those of a data sheet (`prior`)."""
    return {group.name: group.usual[grade] for group in further_groups() if grade in group.usual} | dict(prior or {})


def prior_sizes(
    grade: str, sheet: Mapping[str, float] | None = None, usual: Mapping[str, float] | None = None
) -> dict[str, float]:
    """Return the prior standard deviations of the groups beyond the linear model, SI, by group.

    `sheet` has the standard deviations that a data sheet states, `usual` sizes in place of those of the grade.

    Notes
    -----
    MEMS have no prior of straight drifts. Their biases vary as much as they drift, and their in-run process includes
    the drift. A straight line in addition would be fitted first, and leave the curved part to scale factors and axes:
    |f| of the next session of 8 chips in 72 sessions is then 1.1 times that of the linear model, and 1.0 without.
    Tactical and navigation instruments drift by more than they vary, and keep the line."""
    sizes = usual_sizes(grade) if usual is None else dict(usual)
    if grade in DRIFT_IN_PROCESS:
        sizes = {name: size for name, size in sizes.items() if variable_of(name) != "time"}
    return sizes | dict(sheet or {})


def next_poorer_grade(grade: str) -> str | None:
    """Return the next poorer grade in the order of the tables, None for the poorest."""
    order = list(LINEAR[0].usual)
    following = order.index(grade) + 1
    return order[following] if following < len(order) else None


def positions_by_group(parameters: Iterable[str]) -> dict[str, list[int]]:
    """Return the positions of the parameters of each group, the groups in their order."""
    out: dict[str, list[int]] = {}
    for i, parameter in enumerate(parameters):
        out.setdefault(group_name(parameter), []).append(i)
    return out


SMALLEST, LARGEST = 1e-60, 1e60  # SI: standard deviations whose squares, and their inverses, do not overflow


def prior_of(key: str, text: str) -> tuple[str, float]:
    """Return the group of a key of [device.prior] and the standard deviation, SI, of its text.

    The key is, for example, "accel_quadratic" or "accel_temperature.bias"; the text "20 ug/g^2", or for quadratic and
    cubic terms "0.5 % of 16 g", the nonlinearity of a data sheet. Raises ValueError, one line, for an unknown group or
    unit."""
    stem, _, changed = key.partition(".")
    kind, _, what = stem.partition("_")
    ending = {"temperature": "t1", "curvature": "t2"}.get(what, what)
    name = f"{kind}.{changed}.{ending}" if changed else f"{kind}.{what}"
    group = named_group(name)
    if group is None or group.linear:
        names = ", ".join(g.name.replace(".", "_") for g in further_groups() if g.variable is None)
        raise ValueError(
            f"{key}: expected one of {names}, or accel_temperature, gyro_temperature, accel_curvature, gyro_curvature, "
            "accel_hysteresis, gyro_hysteresis, accel_drift, gyro_drift, "
            "accel_launch, gyro_launch, accel_lag, gyro_lag"
        )
    try:
        bound = _nonlinearity(group, text)
        value = quantity_of(group, text) if bound is None else TYPICAL_OF_BOUND * bound
    except ValueError:
        value = 0.0
    if not SMALLEST <= value <= LARGEST:
        units = ", ".join(_typed_units(group))
        raise ValueError(f"{key}: expected a positive number and one of {units}, found {text!r}")
    return group.name, value


def _nonlinearity(group: ParameterGroup, text: str) -> float | None:
    """Return the bound of K, SI, from a data sheet's nonlinearity such as "0.5 % of 16 g", None for another text or
    group.

    Over −R … R the best line misses K xⁿ by K Rⁿ/2ⁿ⁻¹ (Chebyshev), which the sheet states to be at most p R: K ≤ 2ⁿ⁻¹
    p/Rⁿ⁻¹."""
    power = {"quadratic": 2, "cubic": 3}.get(group.name.rpartition(".")[2])
    share, separator, full_scale = text.partition(" of ")
    if power is None or not separator:
        return None
    p = quantity(share, READ["1"])
    R = quantity(full_scale, READ["m/s^2" if group.kind == "accel" else "rad/s"])
    return float(p * (2.0 / R) ** (power - 1)) if R > 0.0 else 0.0


def quantity_of(group: ParameterGroup, text: str) -> float:
    """Return the SI value of a text such as "-3 ug/g^2" for a parameter of a group. Raises ValueError, one line."""
    return quantity(text, _typed_units(group))


def _typed_units(group: ParameterGroup) -> dict[str, float]:
    """Return the units in which values of a group may be typed, SI."""
    if group.linear:
        return READ[group.unit]
    return {as_typed(shown): size for size, shown in group.shown} | {group.unit: 1.0}
