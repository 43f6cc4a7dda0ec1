"""The table of parameter groups: names, units, words, usual spread, and how a rest and a turn see each of them.

A reading is linear in functions β of the specific force f and the rate ω,

    y_p = Σ_b K_pb β_pb(f, ω),    β = 1, ω (3), f (3), products f_k f_l (6), |own|, own³                   (3)

own being the component of what sensor p measures along its nominal axis. K (n, 15) holds the sensitivity matrix and the
bias, and every further group adds to it: a group is the constant array ∂K/∂θ, its `regressors` (n, 15, m). Some groups
change no reading at rest: lever arms and delays act in a turn alone, and are named by `Motion`.

Everything that deals with parameters loops over the table, parameters.toml: estimation, bounds, planning, simulation,
frames, the calibration file, terminal, report, registry and limits. A further group is one entry, or one of another
package (`tumble.plugins`).

The groups are those of docs/explanation/mathematics.md (1) and (2); their usual sizes those of data sheets of each
class.
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

FUNCTIONS = 15
"""How many functions β there are."""
CONSTANT, RATE, FORCE, PRODUCTS, OWN_SIZE, OWN_CUBE = 0, slice(1, 4), slice(4, 7), slice(7, 13), 13, 14
"""Where each function stands."""
PAIRS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
"""k and l of the products f_k f_l."""

Terms = Literal["full", "linear"]
"""The parameters of an instrument: bias, scale factor and axis angles alone, or all groups of the table."""
Motion = Literal["lever", "delay", "single delay"]
Variable = Literal["time", "temperature", "temperature²", "temperature³", "hysteresis", "launch", "lag"]
"""What the change of a parameter goes with: time from the mean of a session's rests, s, temperature from the reference,
K, its square and cube, the direction it came from, −1 … 1, or that a session is another one; a lag moves the
temperatures."""
THERMAL: tuple[Variable, ...] = ("temperature", "temperature²", "temperature³")
"""Those of polynomials of temperature, in the order of their powers."""
Regressors = Callable[[Block], Array]
"""∂K/∂θ (n, 15, m) of a block for a group's parameters."""

MICRO_G = 1e-6 * G_STANDARD
DATA_SHEETS = "data sheets of the class"
TYPICAL_OF_BOUND = 0.1
"""Standard deviation at 1 g over the bound that a data sheet states for the whole range: those of chips with
bounds of 600 µg/g² and more have some 50."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ParameterGroup:
    """A group of parameters such as "accel.quadratic", which `kind` of sensors has.

    `unit` is the SI unit, `shown` the units it is shown in, (size in SI, name), the smallest first; `words` what
    reports call it. `suffixes` makes the names of its parameters for a block, behind the group's own name or another
    `stem`. `limit`, SI, is how far from nominal a value may reasonably be; `usual` the standard deviation over
    instruments of a grade: the prior of further groups; that of bias, scale factor and axes serves plans and
    simulations alone, and their prior is `limit`. A grade that is not there has the group only where a data sheet says
    so. `regressors` is None for bias, scale and axis angles, whose derivative `Block.jacobian` has, and where `motion`
    says how a turn sees the group, or where the group is the change of another, its `base`, with a `variable`, or a
    lag, which has no base. `sized_with` names a group from which rests hardly tell it apart: by one factor both are
    larger than usual. `source` says where the usual size in MEMS instruments is from (those of tactical and navigation
    instruments are from data sheets, and never wider than that of a poorer grade)."""

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
        """Whether the group belongs to the 21 of the linear model: bias, scale factor and axis angles."""
        return self.regressors is None and self.motion is None and self.variable is None

    def names(self, block: Block) -> tuple[str, ...]:
        """Parameter names for a block of sensors."""
        stem, ending = self.stem or self.base or self.name, "" if self.base is None else f".{_ENDINGS[self.variable]}"
        return tuple(f"{stem}.{suffix}{ending}" if suffix else f"{stem}{ending}" for suffix in self.suffixes(block))

    def thermometers(self, block: Block) -> tuple[int, ...]:
        """The numbers of the thermometers of the sensors that its parameters are of."""
        of = dict(zip(block.sensors, block.thermometer[block.channels].tolist(), strict=True))
        return tuple(of.get(s[:1] if block.triad else s.partition(".")[0], 0) for s in self.suffixes(block))


_CHANGES: dict[Variable | None, tuple[str, str, str]] = {
    "time": ("drift", "s", "drift of the "),
    "temperature": ("t1", "K", "slope over temperature of the "),
    "temperature²": ("t2", "K^2", "curvature over temperature of the "),
    "temperature³": ("t3", "K^3", "cubic term over temperature of the "),
    "hysteresis": ("hysteresis", "", "hysteresis over temperature of the "),
    "launch": ("launch", "", "change from session to session of the "),
}
"""How the name of a parameter ends that is the change of another, what its unit is divided by, and its words."""
_ENDINGS = {variable: ending for variable, (ending, _, _) in _CHANGES.items()}
OVER_TEMPERATURE = tuple(_ENDINGS[variable] for variable in THERMAL)
"""How the names of the coefficients of such polynomials end."""


# What parameters are called within their group


def _by_force(block: Block) -> tuple[str, ...]:
    apart = "" if block.triad else "."
    return tuple(f"{sensor}{apart}{axis}" for sensor in block.sensors for axis in "xyz")


def _levers(block: Block) -> tuple[str, ...]:
    return tuple(f"{sensor}.{axis}" for sensor in block.sensors[:-1] for axis in "xyz")


def _once(_: Block) -> tuple[str, ...]:
    return ("",)


_SUFFIXES: Mapping[str, Callable[[Block], tuple[str, ...]]] = {
    "sensors": attrgetter("sensors"),
    "angles": attrgetter("angles"),
    "others": lambda block: block.sensors[:-1],
    "by force": _by_force,
    "levers": _levers,
    "once": _once,
}


# Regressors


def _own(function: int) -> Regressors:
    """Regressors of a function of each sensor's own component."""

    def regressors(block: Block) -> Array:
        out = np.zeros((block.size, FUNCTIONS, block.size))
        out[block.channels, function, np.arange(block.size)] = 1.0
        return out

    return regressors


def quadratic(block: Block) -> Array:
    """∂K/∂K₂ (n, 15, n): the square of the force along the nominal axis a, Σ a_k a_l f_k f_l."""
    out = np.zeros((block.size, FUNCTIONS, block.size))
    axes = block.axes[block.channels]
    for b, (k, other) in enumerate(PAIRS, start=PRODUCTS.start):
        out[block.channels, b, np.arange(block.size)] = (1.0 if k == other else 2.0) * axes[:, k] * axes[:, other]
    return out


def g_sensitivity(block: Block) -> Array:
    """∂K/∂G (n, 15, 3n): each gyro by each component of the specific force."""
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


# The table, parameters.toml

CURVED = 1.0 / 60.0
"""Usual curvature over temperature, K⁻¹, in parts of the usual slope: at 60 K from the reference they do as much."""
_HOUR = 3600.0
_AT_TEN = 1e-6 / (10.0 * DEGREE) ** 2
_SIZES: Mapping[str, float] = {
    "ng": 1e-3 * MICRO_G, "µg": MICRO_G, "mg": 1e3 * MICRO_G, "ppb": 1e-9, "ppm": 1e-6, "arcsec": ARCSEC,
    "°/h": DEGREE_PER_HOUR, "°/s": DEGREE, "°/√h": DEGREE / 60.0, "µs": 1e-6, "ms": 1e-3, "s": 1.0, "mm": 1e-3,
    "µg/g²": 1e-6 / G_STANDARD, "mg/g²": 1e-3 / G_STANDARD, "µg/g³": 1e-6 / G_STANDARD**2,
    "mg/g³": 1e-3 / G_STANDARD**2, "°/h/g": DEGREE_PER_HOUR / G_STANDARD, "°/s/g": DEGREE / G_STANDARD,
    "ppm at 100 °/s": 0.01 * _AT_TEN, "ppm at 10 °/s": _AT_TEN,
}  # fmt: skip
"""SI, of the units in the tables."""


def size_of(written: float | str) -> float:
    """A size that is written in SI, or with a unit of the tables."""
    number, _, unit = str(written).partition(" ")
    return float(number) * _SIZES[unit] if unit else float(number)


def _usual(row: Mapping[str, Any], key: str = "usual") -> dict[str, float]:
    """The sizes of a row by grade."""
    return dict(zip(("navigation", "tactical", "mems", "consumer"), map(size_of, row.get(key, ())), strict=False))


def _shown(units: Iterable[str], per: str = "", size: float = 1.0) -> tuple[tuple[float, str], ...]:
    """Units, divided by another, as (their size in SI, their names)."""
    return tuple((_SIZES[unit.removesuffix("/°C³")] / size, unit + per) for unit in units)


def _entry(row: Mapping[str, Any]) -> ParameterGroup:
    """The group of a row that is no change of another."""
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
"""Bias, scale-factor error and axis angles: the 21 of two triads, and those of a magnetometer."""


def _changes(row: Mapping[str, Any]) -> Iterator[ParameterGroup]:
    """The change of a group of the linear model with a variable, or its drift, slope and curvature."""
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


DRIFT_IN_PROCESS = ("mems", "consumer")
"""Grades whose in-run process of the biases contains their drift, so that no line stands beside it."""


@cache
def _brought() -> tuple[ParameterGroup, ...]:
    """The groups of other packages. Raises InputError for one whose name is taken or not of accelerometers or gyros."""
    found = load_all("parameters", ParameterGroup).values()
    taken = {group.name for group in (*LINEAR, *FURTHER)}
    for group in found:
        if group.name in taken or not re.fullmatch(rf"{group.kind}\.[a-z0-9_]+", group.name):
            raise InputError(
                f"entry point tumble.parameters: expected the name of a group that is new, such as {group.kind}.fifth, "
                f"found {group.name!r}; rename it in its package"
            )
    return tuple(found)


def further_groups() -> tuple[ParameterGroup, ...]:
    """The groups beyond the linear model: those of the table, and those of other packages."""
    return (*FURTHER, *_brought())


def groups() -> tuple[ParameterGroup, ...]:
    """All groups, in the order of the calibration file."""
    return (*LINEAR, *further_groups())


@lru_cache(maxsize=4096)
def group_name(parameter: str) -> str:
    """The group of a parameter: "accel.bias" of "accel.bias.x", "accel.bias.t1" of "accel.bias.x.t1",
    "accel.single_delay" of "accel.delay.x"."""
    parts = parameter.split(".")
    stem = ".".join(parts[:2])
    if (
        len(parts) > 2
        and (name := next((group.name for group in further_groups() if group.stem == stem), None)) is not None
    ):
        return name
    return ".".join([stem, *(parts[-1:] if parts[-1] in _ENDINGS.values() else [])])


def units_of(parameters: Iterable[str]) -> tuple[str, ...]:
    """SI units of parameters."""
    by_group = {group.name: group.unit for group in groups()}
    return tuple(by_group[group_name(parameter)] for parameter in parameters)


def sensor_kind(parameter: str) -> str:
    """The kind of sensor of a parameter: "accel" of "accel.bias.x"."""
    return parameter.partition(".")[0]


def within_kind(parameter: str) -> str:
    """The name of a parameter or group within its kind of sensor: "bias.x" of "accel.bias.x"."""
    return parameter.partition(".")[2]


def within_group(parameter: str) -> str:
    """The name of a parameter within its group: "x" of "accel.bias.x", "x.t1" of "accel.bias.x.t1"; "" where it is the
    only one."""
    return within_kind(within_kind(parameter))


def variable_of(parameter: str) -> Variable | None:
    """What the change goes with that a parameter or group is; None where it is none."""
    return getattr(named_group(group_name(parameter)), "variable", None)


def group_of(parameter: str) -> ParameterGroup:
    """The entry of a parameter's group. Raises KeyError where the table has none."""
    group = named_group(group_name(parameter))
    if group is None:
        raise KeyError(parameter)
    return group


def named_group(name: str) -> ParameterGroup | None:
    """The entry of a group's name; None where the table has none."""
    return next((group for group in (*groups(), *MAGNETIC) if group.name == name), None)


def is_parameter(name: str) -> bool:
    """Whether a name is that of a parameter of some sensor, of a group of the table."""
    entry = named_group(group_name(name))
    sensor = within_group(name).removesuffix(f".{_ENDINGS.get(entry.variable, '')}") if entry else ""
    return entry is not None and bool(sensor or entry.suffixes is _once)


def name_covers(name: str, parameter: str) -> bool:
    """Whether a name, of a parameter, of a group or of one sensor in it ("gyro.g_sensitivity.x"), means a parameter:
    "accel.bias" means "accel.bias.x", and not its change "accel.bias.x.t1", which is of a group of its own."""
    group = group_name(parameter)
    return name in (parameter, group) or (parameter.startswith(f"{name}.") and group == group_name(name))


def to_temperature(names: Sequence[str], warmer: float | Array) -> Array:
    """The matrix (m, m) that takes parameters of these names to a reference temperature higher by so many K, each (m,)
    or all, by the polynomials of temperature among them: (d + w)^k = Σ_j C(k, j) w^(k−j) d^j."""
    out, place = np.eye(len(names)), {name: i for i, name in enumerate(names)}
    by = np.broadcast_to(warmer, len(names)).tolist()
    for i, name in enumerate(names):
        base, _, ending = name.rpartition(".")
        if base not in place or ending not in OVER_TEMPERATURE:
            continue
        power = 1 + OVER_TEMPERATURE.index(ending)
        for j, lower in enumerate([base, *(f"{base}.{each}" for each in OVER_TEMPERATURE[: power - 1])]):
            if lower in place:
                out[place[lower], i] = math.comb(power, j) * by[i] ** (power - j)
    return out


def beyond_linear(parameter: str) -> bool:
    """Whether a parameter belongs to a group beyond bias, scale factor and axis angles."""
    group = named_group(group_name(parameter))
    return group is not None and not group.linear


def shown_in(name: str, unit: str, magnitude: float) -> tuple[float, str]:
    """The unit in which a parameter or group of this name, SI unit and magnitude is shown, as (its size in SI, its
    name): that of the table where there is one, such as µg/g² or mm, else the engineering unit."""
    group = named_group(group_name(name))
    known = group is not None and group.shown and group.unit == unit
    return coarsest(group.shown, magnitude) if known and group is not None else engineering(unit, magnitude)


def limits_of(parameters: Iterable[str]) -> Array:
    """How far from nominal parameters of these names may reasonably be, SI."""
    return _limits_of(tuple(parameters)).copy()


@lru_cache(maxsize=64)
def _limits_of(parameters: tuple[str, ...]) -> Array:
    """The same: every estimate of instruments of one kind asks for it."""
    by_name = {group.name: group.limit for group in (*groups(), *MAGNETIC)}
    return np.array([by_name[group_name(parameter)] for parameter in parameters])


def usual_sizes(grade: str, prior: Mapping[str, float] | None = None) -> dict[str, float]:
    """Standard deviations, SI, by group of the groups beyond the linear model in instruments of a grade, or those of
    a data sheet (`prior`)."""
    return {group.name: group.usual[grade] for group in further_groups() if grade in group.usual} | dict(prior or {})


def prior_sizes(
    grade: str, sheet: Mapping[str, float] | None = None, usual: Mapping[str, float] | None = None
) -> dict[str, float]:
    """Standard deviations of the groups beyond the linear model that are the priors of an estimate.

    Parameters
    ----------
    grade : str
        Of the instrument.
    sheet : mapping of str to float, optional
        Standard deviations that a data sheet states, SI, by group.
    usual : mapping of str to float, optional
        Sizes in place of those that are usual of the grade.

    Returns
    -------
    dict of str to float
        By group, SI: the usual sizes without the straight drifts of MEMS, and those of the data sheet.

    Notes
    -----
    The biases of MEMS wander by as much as they drift, and their in-run process contains the drift. A straight line
    beside it would be fitted first, and leave to scale factors and axes what of the wandering is not straight: |f| of
    the next session of 8 chips in 72 sessions is then 1.1 times that of the linear model, and 1.0 without. Tactical and
    navigation instruments drift by more than they wander, and keep the line."""
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
    """Where the parameters of each group stand, the groups in their order."""
    out: dict[str, list[int]] = {}
    for i, parameter in enumerate(parameters):
        out.setdefault(group_name(parameter), []).append(i)
    return out


# Values as they are typed, in the units that the table shows: "20 ug/g^2" or "-3 deg/h"

LEAST, LARGEST = 1e-60, 1e60
"""SI: standard deviations between which squares and their inverses are numbers."""


def prior_of(key: str, text: str) -> tuple[str, float]:
    """The group of a key of [device.prior], such as "accel_quadratic" or "accel_temperature.bias", and the standard
    deviation, SI, of a text such as "20 ug/g^2", or of quadratic and cubic terms "0.5 % of 16 g", the nonlinearity of a
    data sheet. Raises ValueError, one line, for a group or a unit that is none."""
    stem, _, of = key.partition(".")
    kind, _, what = stem.partition("_")
    ending = {"temperature": "t1", "curvature": "t2"}.get(what, what)
    name = f"{kind}.{of}.{ending}" if of else f"{kind}.{what}"
    group = named_group(name)
    if group is None or group.linear:
        known = ", ".join(g.name.replace(".", "_") for g in further_groups() if g.variable is None)
        raise ValueError(
            f"{key}: expected one of {known}, or accel_temperature, gyro_temperature, accel_curvature, gyro_curvature, "
            "accel_hysteresis, gyro_hysteresis, accel_drift, gyro_drift, "
            "accel_launch, gyro_launch, accel_lag, gyro_lag"
        )
    try:
        bound = _nonlinearity(group, text)
        value = quantity_of(group, text) if bound is None else TYPICAL_OF_BOUND * bound
    except ValueError:
        value = 0.0
    if not LEAST <= value <= LARGEST:
        units = ", ".join(_typed_units(group))
        raise ValueError(f"{key}: expected a positive number and one of {units}, found {text!r}")
    return group.name, value


def _nonlinearity(group: ParameterGroup, text: str) -> float | None:
    """Bound of K, SI, that a data sheet's nonlinearity such as "0.5 % of 16 g" sets; None for another text or group.

    Over −R … R the best line misses K xⁿ by K Rⁿ/2ⁿ⁻¹ (Chebyshev), of which the sheet says that it is at most p R:
    K ≤ 2ⁿ⁻¹ p/Rⁿ⁻¹."""
    power = {"quadratic": 2, "cubic": 3}.get(group.name.rpartition(".")[2])
    share, of, full_scale = text.partition(" of ")
    if power is None or not of:
        return None
    p = quantity(share, READ["1"])
    R = quantity(full_scale, READ["m/s^2" if group.kind == "accel" else "rad/s"])
    return float(p * (2.0 / R) ** (power - 1)) if R > 0.0 else 0.0


def quantity_of(group: ParameterGroup, text: str) -> float:
    """SI value of a text such as "-3 ug/g^2" for a parameter of a group. Raises ValueError, one line."""
    return quantity(text, _typed_units(group))


def _typed_units(group: ParameterGroup) -> dict[str, float]:
    """The units that values of a group may be typed in, SI."""
    if group.linear:
        return READ[group.unit]
    return {as_typed(shown): size for size, shown in group.shown} | {group.unit: 1.0}
