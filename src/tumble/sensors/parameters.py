"""The table of parameter groups: names, units, words, usual spread, and how a rest and a turn see each of them.

A reading is linear in functions β of the specific force f and the rate ω,

    y_p = Σ_b K_pb β_pb(f, ω),    β = 1, ω (3), f (3), products f_k f_l (6), |own|, own³                   (3)

own being the component of what sensor p measures along its nominal axis. K (n, 15) holds the sensitivity matrix and the
bias, and every further group adds to it: a group is the constant array ∂K/∂θ, its `regressors` (n, 15, m). Some groups
change no reading at rest: lever arms and delays act in a turn alone, and are named by `Motion`.

Everything that deals with parameters loops over this table: estimation, bounds, planning, simulation, frames, the
calibration file, terminal, report, registry and limits. A further group is one entry.

The groups are those of docs/mathematics.md (1) and (2); their usual sizes those of data sheets of each class.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Literal

import numpy as np

from tumble.sensors.model import Block, SensorKind
from tumble.units import DEGREE, DEGREE_PER_HOUR, G_STANDARD, Array, coarsest, engineering

FUNCTIONS = 15
"""How many functions β there are."""
CONSTANT, RATE, FORCE, PRODUCTS, OWN_SIZE, OWN_CUBE = 0, slice(1, 4), slice(4, 7), slice(7, 13), 13, 14
"""Where each function stands."""
PAIRS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
"""k and l of the products f_k f_l."""

Motion = Literal["lever", "delay", "single delay"]
Variable = Literal["time", "temperature", "temperature²", "hysteresis", "launch", "lag"]
"""What the change of a parameter goes with: time from the middle of a session, s, temperature from the reference, K,
its square, the direction it came from, −1 … 1, or that a session is another one; the lag moves the temperatures."""
THERMAL: tuple[Variable, ...] = ("temperature", "temperature²")
"""Those of slopes and curvatures."""
Regressors = Callable[[Block], Array]
"""∂K/∂θ (n, 15, m) of a block for a group's parameters."""

MICRO_G = 1e-6 * G_STANDARD


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ParameterGroup:
    """A group of parameters such as "accel.quadratic", which `kind` of sensors has.

    `unit` is the SI unit, `shown` the units it is shown in, (size in SI, name), the smallest first; `words` what
    reports call it. `suffixes` makes the names of its parameters for a block, behind the group's own name or another
    `stem`. `limit`, SI, is how far from nominal a value may reasonably be; `usual` the standard deviation over
    instruments of a grade, the prior where a parameter has one; a grade that is not there has the group only where a
    data sheet says so. `regressors` is None for bias, scale and axis angles, whose derivative `Block.jacobian` has, and
    where `motion` says how a turn sees the group, or where the group is the change of another, its `base`, with a
    `variable`, or the lag, which has no base."""

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


_ENDINGS: dict[Variable | None, str] = {
    "time": "drift",
    "temperature": "t1",
    "temperature²": "t2",
    "hysteresis": "hysteresis",
    "launch": "launch",
}
"""How the name of a parameter ends that is the change of another."""
_CHANGES: dict[Variable, tuple[str, str]] = {
    "time": ("s", "drift of the "),
    "temperature": ("K", "slope over temperature of the "),
    "temperature²": ("K^2", "curvature over temperature of the "),
    "hysteresis": ("", "hysteresis over temperature of the "),
    "launch": ("", "change from session to session of the "),
}
"""What a change is divided by in its unit, and its words."""


def _every_sensor(block: Block) -> tuple[str, ...]:
    return block.sensors


def _angles(block: Block) -> tuple[str, ...]:
    return block.angles


def _by_force(block: Block) -> tuple[str, ...]:
    apart = "" if block.triad else "."
    return tuple(f"{sensor}{apart}{axis}" for sensor in block.sensors for axis in "xyz")


def _levers(block: Block) -> tuple[str, ...]:
    return tuple(f"{sensor}.{axis}" for sensor in block.sensors[:-1] for axis in "xyz")


def _others(block: Block) -> tuple[str, ...]:
    return block.sensors[:-1]


def _once(_: Block) -> tuple[str, ...]:
    return ("",)


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


_MASS = ((MICRO_G, "µg"), (1e3 * MICRO_G, "mg"))
_PARTS = ((1e-6, "ppm"),)
_TURN_RATE = ((DEGREE_PER_HOUR, "°/h"), (DEGREE, "°/s"))
_AT_TEN = 1e-6 / (10.0 * DEGREE) ** 2
"""s²/rad²: what changes the scale factor by 1 ppm at 10 °/s."""
_PER_G = tuple((size / G_STANDARD, f"{name}/g") for size, name in _TURN_RATE)


def _grades(navigation: float, tactical: float, mems: float, consumer: float) -> dict[str, float]:
    return {"navigation": navigation, "tactical": tactical, "mems": mems, "consumer": consumer}


_BLOCKS: tuple[tuple[SensorKind, str, str, float, tuple[tuple[float, str], ...]], ...] = (
    ("accel", "accelerometers", "m/s^2", 1.0, _MASS),
    ("gyro", "gyros", "rad/s", 0.1, _TURN_RATE),
)

LINEAR: tuple[ParameterGroup, ...] = tuple(
    ParameterGroup(
        name=f"{kind}.{what}", kind=kind, unit=unit, words=words, suffixes=suffixes, limit=limit, shown=shown
    )
    for kind, sensors, bias_unit, bias_limit, bias_shown in _BLOCKS
    for what, unit, words, suffixes, limit, shown in (
        ("bias", bias_unit, f"biases of the {sensors}", _every_sensor, bias_limit, bias_shown),
        ("scale", "1", f"scale-factor errors of the {sensors}", _every_sensor, 0.1, _PARTS),
        ("axis", "rad", f"axis angles of the {sensors}", _angles, 0.1, ()),
    )
)
"""Bias, scale-factor error and axis angles: the 21 of two triads."""

FURTHER: list[ParameterGroup] = [
    ParameterGroup(
        name="accel.quadratic",
        kind="accel",
        unit="s^2/m",
        words="quadratic nonlinearity of the accelerometers, K₂",
        suffixes=_every_sensor,
        limit=1e-2 / G_STANDARD,
        shown=((MICRO_G / G_STANDARD**2, "µg/g²"), (1e3 * MICRO_G / G_STANDARD**2, "mg/g²")),
        usual={grade: ppm * 1e-6 / G_STANDARD for grade, ppm in _grades(30.0, 100.0, 500.0, 1000.0).items()},
        regressors=quadratic,
    ),
    ParameterGroup(
        name="accel.cubic",
        kind="accel",
        unit="s^4/m^2",
        words="cubic nonlinearity of the accelerometers, K₃",
        suffixes=_every_sensor,
        limit=1e-2 / G_STANDARD**2,
        shown=((MICRO_G / G_STANDARD**3, "µg/g³"), (1e3 * MICRO_G / G_STANDARD**3, "mg/g³")),
        usual={grade: ppm * 1e-6 / G_STANDARD**2 for grade, ppm in _grades(10.0, 30.0, 100.0, 200.0).items()},
        regressors=_own(OWN_CUBE),
    ),
    ParameterGroup(
        name="accel.asymmetry",
        kind="accel",
        unit="1",
        words="difference of the + and − scale factors of the accelerometers, half",
        suffixes=_every_sensor,
        limit=1e-2,
        shown=_PARTS,
        usual=_grades(20e-6, 100e-6, 500e-6, 1000e-6),
        regressors=_own(OWN_SIZE),
    ),
    ParameterGroup(
        name="gyro.asymmetry",
        kind="gyro",
        unit="1",
        words="difference of the + and − scale factors of the gyros, half",
        suffixes=_every_sensor,
        limit=1e-2,
        shown=_PARTS,
        usual=_grades(10e-6, 100e-6, 500e-6, 1000e-6),
        regressors=_own(OWN_SIZE),
    ),
    ParameterGroup(
        name="gyro.cubic",
        kind="gyro",
        unit="s^2/rad^2",
        words="cubic nonlinearity of the gyros: their scale factors with the square of the rate",
        suffixes=_every_sensor,
        limit=1e-2 / (10.0 * DEGREE) ** 2,
        shown=((0.01 * _AT_TEN, "ppm at 100 °/s"), (_AT_TEN, "ppm at 10 °/s")),
        regressors=_own(OWN_CUBE),
    ),
    ParameterGroup(
        name="gyro.g_sensitivity",
        kind="gyro",
        unit="rad*s/m",
        words="g-sensitivity of the gyros",
        suffixes=_by_force,
        limit=DEGREE,
        shown=_PER_G,
        usual={
            grade: rate / G_STANDARD
            for grade, rate in _grades(
                0.05 * DEGREE_PER_HOUR, 5.0 * DEGREE_PER_HOUR, 0.1 * DEGREE, 0.2 * DEGREE
            ).items()
        },
        regressors=g_sensitivity,
    ),
    ParameterGroup(
        name="accel.lever",
        kind="accel",
        unit="m",
        words="lever arms of the accelerometers from the last one",
        suffixes=_levers,
        limit=1.0,
        shown=((1e-3, "mm"),),
        usual=_grades(0.03, 0.03, 0.005, 0.005),
        motion="lever",
    ),
    ParameterGroup(
        name="accel.delay",
        kind="accel",
        unit="s",
        words="delay of the accelerometers after the gyros",
        suffixes=_once,
        limit=0.1,
        shown=((1e-6, "µs"), (1e-3, "ms")),
        usual=_grades(1e-3, 3e-3, 5e-3, 10e-3),
        motion="delay",
    ),
    ParameterGroup(
        name="accel.single_delay",
        kind="accel",
        unit="s",
        words="delays of single accelerometers after the last one",
        suffixes=_others,
        limit=0.1,
        shown=((1e-6, "µs"), (1e-3, "ms")),
        usual=_grades(20e-6, 100e-6, 300e-6, 500e-6),
        motion="single delay",
        stem="accel.delay",
    ),
]
"""The groups beyond the linear model, in the order of the calibration file."""


def _changing(base: str, variable: Variable, usual: dict[str, float], shown: tuple[tuple[float, str], ...]) -> None:
    """Add the change of a group of the linear model with a variable to the table."""
    group = next(group for group in LINEAR if group.name == base)
    per, said = _CHANGES[variable]
    FURTHER.append(
        ParameterGroup(
            name=f"{base}.{_ENDINGS[variable]}",
            kind=group.kind,
            unit=f"{group.unit}/{per}" if per else group.unit,
            words=said + group.words,
            suffixes=group.suffixes,
            limit=group.limit,
            shown=shown,
            usual=usual,
            base=base,
            variable=variable,
        )
    )


def _scaled(values: dict[str, float], factor: float) -> dict[str, float]:
    return {grade: factor * value for grade, value in values.items()}


_HOUR = 3600.0
_FINER = {"accel.bias": ((1e-3 * MICRO_G, "ng"),), "accel.scale": ((1e-9, "ppb"),), "gyro.scale": ((1e-9, "ppb"),)}
_CURVED = 1.0 / 60.0
"""Usual curvature over temperature, K⁻¹, in parts of the usual slope: at 60 K from the reference they do as much."""
for _base, _units, _per_hour, _per_kelvin in (
    (
        "accel.bias",
        _MASS,
        _scaled(_grades(20.0, 200.0, 2e3, 5e3), MICRO_G),
        _scaled(_grades(20.0, 50.0, 300.0, 1e3), MICRO_G),
    ),
    ("accel.scale", _PARTS, _grades(10e-6, 50e-6, 200e-6, 500e-6), _grades(20e-6, 30e-6, 150e-6, 300e-6)),
    (
        "gyro.bias",
        _TURN_RATE,
        _scaled(_grades(0.005, 0.5, 50.0, 200.0), DEGREE_PER_HOUR),
        _scaled(_grades(0.01, 1.0, 80.0, 200.0), DEGREE_PER_HOUR),
    ),
    ("gyro.scale", _PARTS, _grades(5e-6, 50e-6, 200e-6, 500e-6), _grades(10e-6, 30e-6, 200e-6, 400e-6)),
):
    _hourly = tuple((size / _HOUR, f"{name}/h") for size, name in _units)
    _changing(_base, "time", _scaled(_per_hour, 1.0 / _HOUR), _hourly)
    _changing(_base, "temperature", _per_kelvin, tuple((size, f"{name}/°C") for size, name in _units))
    _squared = tuple((size, f"{name}/°C²") for size, name in (*_FINER.get(_base, ()), *_units))
    _changing(_base, "temperature²", _scaled(_per_kelvin, _CURVED), _squared)
_FURTHER_CHANGES: tuple[tuple[str, tuple[tuple[float, str], ...], Variable, dict[str, float]], ...] = (
    ("accel.bias", _MASS, "hysteresis", _scaled(_grades(20.0, 50.0, 500.0, 1e3), MICRO_G)),
    ("gyro.bias", _TURN_RATE, "hysteresis", _scaled(_grades(0.01, 0.5, 20.0, 50.0), DEGREE_PER_HOUR)),
    ("accel.bias", _MASS, "launch", _scaled(_grades(20.0, 100.0, 500.0, 2e3), MICRO_G)),
    ("gyro.bias", _TURN_RATE, "launch", _scaled(_grades(0.005, 0.5, 20.0, 100.0), DEGREE_PER_HOUR)),
)
for _name, _shown, _variable, _sizes in _FURTHER_CHANGES:
    _changing(_name, _variable, _sizes, _shown)
FURTHER.append(
    ParameterGroup(
        name="temperature.lag",
        kind="accel",
        unit="s",
        words="lag of all sensors behind the thermometer",
        suffixes=_once,
        limit=_HOUR,
        shown=((1.0, "s"),),
        usual=_grades(200.0, 200.0, 200.0, 200.0),
        variable="lag",
    )
)


def groups() -> tuple[ParameterGroup, ...]:
    """All groups, in the order of the calibration file."""
    return (*LINEAR, *FURTHER)


@lru_cache(maxsize=4096)
def group_name(parameter: str) -> str:
    """The group of a parameter: "accel.bias" of "accel.bias.x", "accel.bias.t1" of "accel.bias.x.t1",
    "accel.single_delay" of "accel.delay.x"."""
    parts = parameter.split(".")
    stem = ".".join(parts[:2])
    if len(parts) > 2 and (name := next((group.name for group in FURTHER if group.stem == stem), None)) is not None:
        return name
    return ".".join([stem, *(parts[-1:] if parts[-1] in _ENDINGS.values() else [])])


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
    group = named_group(group_name(parameter))
    return None if group is None else group.variable


def group_of(parameter: str) -> ParameterGroup:
    """The entry of a parameter's group. Raises KeyError where the table has none."""
    group = named_group(group_name(parameter))
    if group is None:
        raise KeyError(parameter)
    return group


def named_group(name: str) -> ParameterGroup | None:
    """The entry of a group's name; None where the table has none."""
    return next((group for group in groups() if group.name == name), None)


def is_parameter(name: str) -> bool:
    """Whether a name is that of a parameter of some sensor: of a group of the table, or of a magnetometer."""
    group = group_name(name)
    if sensor_kind(name) == "mag":
        return group in ("mag.bias", "mag.scale", "mag.axis")
    entry = named_group(group)
    sensor = within_group(name).removesuffix(f".{_ENDINGS.get(entry.variable, '')}") if entry else ""
    return entry is not None and bool(sensor or entry.suffixes is _once)


def meant_by(name: str, parameter: str) -> bool:
    """Whether a name, of a parameter, of a group or of one sensor in it ("gyro.g_sensitivity.x"), means a parameter:
    "accel.bias" means "accel.bias.x", and not its change "accel.bias.x.t1", which is of a group of its own."""
    group = group_name(parameter)
    return name in (parameter, group) or (parameter.startswith(f"{name}.") and group == group_name(name))


def to_temperature(names: Sequence[str], warmer: float | Array) -> Array:
    """The matrix (m, m) that takes parameters of these names to a reference temperature higher by so many K, each (m,)
    or all, by the slopes and curvatures among them."""
    out, place = np.eye(len(names)), {name: i for i, name in enumerate(names)}
    by = np.broadcast_to(warmer, len(names)).tolist()
    slope, curvature = _ENDINGS["temperature"], _ENDINGS["temperature²"]
    for i, name in enumerate(names):
        base, _, ending = name.rpartition(".")
        if base not in place:
            continue
        if ending == slope:
            out[place[base], i] = by[i]
        elif ending == curvature:
            out[place[base], i] = by[i] ** 2
            if f"{base}.{slope}" in place:
                out[place[f"{base}.{slope}"], i] = 2.0 * by[i]
    return out


def beyond_linear(parameter: str) -> bool:
    """Whether a parameter belongs to a group beyond bias, scale factor and axis angles."""
    group = named_group(group_name(parameter))
    return group is not None and not group.linear


def shown_in(name: str, unit: str, magnitude: float) -> tuple[float, str]:
    """The unit in which a parameter or group of this name, SI unit and magnitude is shown, as (its size in SI, its
    name): that of the table where there is one, such as µg/g² or mm, else the engineering unit."""
    group = named_group(group_name(name))
    if group is None or not group.shown or group.unit != unit:
        return engineering(unit, magnitude)
    return coarsest(group.shown, magnitude)


def limits_of(parameters: Iterable[str]) -> Array:
    """How far from nominal parameters of these names may reasonably be, SI."""
    return _limits_of(tuple(parameters)).copy()


@lru_cache(maxsize=64)
def _limits_of(parameters: tuple[str, ...]) -> Array:
    """The same: every estimate of instruments of one kind asks for it."""
    by_name = {group.name: group.limit for group in groups()}
    return np.array([by_name[group_name(parameter)] for parameter in parameters])


def usual_sizes(grade: str, prior: Mapping[str, float] | None = None) -> dict[str, float]:
    """Standard deviations, SI, by group of the groups beyond the linear model in instruments of a grade, or those of
    a data sheet (`prior`)."""
    return {group.name: group.usual[grade] for group in FURTHER if grade in group.usual} | dict(prior or {})


def positions_by_group(parameters: Iterable[str]) -> dict[str, list[int]]:
    """Where the parameters of each group stand, the groups in their order."""
    out: dict[str, list[int]] = {}
    for i, parameter in enumerate(parameters):
        out.setdefault(group_name(parameter), []).append(i)
    return out
