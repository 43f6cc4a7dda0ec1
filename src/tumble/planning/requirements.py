"""What set-up an accuracy needs, the inverse of `tumble.planning.budget`: from wanted errors back to the tolerances
of table and mounting and the duration of the rests.

Of the method `joint` the errors are the bound, which knows no errors of the table and falls with the rests until what
longer ones show is nothing beside in-run instability, gravity and groups beyond the linear model, or drifts grow.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

from tumble.brief import Brief
from tumble.earth import EARTH_RATE, earth_rate
from tumble.errors import InputError
from tumble.planning.bounds import bound
from tumble.planning.budget import (
    ESTIMATORS,
    GROUPS,
    LARGEST_DEVIATION,
    MAXIMUM_LIKELIHOOD,
    MEMBERS,
    REST_NOISE,
    UNITS,
    Pipeline,
    PlannedMethod,
    expect_linear,
    pipeline_of,
    size_of,
    total_of,
)
from tumble.planning.setup import Setup, check_setup, expect, wanted_accuracies
from tumble.sensors.grades import spread_of
from tumble.units import Array, engineering

REST_SHARE = 0.25
"""Part of the permitted variance that `require` gives to the noise of rests; table and mounting get the others."""

LONGEST_REST = 3600.0
"""s: of a rest that an operator waits for."""

BiasEstimator = Literal["programme", "vertical", "polar"]


@dataclass(frozen=True, kw_only=True, slots=True)
class Requirement:
    """What one wanted accuracy asks of the set-up: largest `table_error` and `mounting_error`, rad (uniform within ±,
    in the ratio of the set-up), their rms together per axis, `tilt`, rad, and the shortest `rest`, s. `limited` says
    whether the table matters at all within 5°. If not `feasible` the tolerances are zero, `rest` is infinite, and
    `reason` says what stands in the way of any table."""

    group: str
    estimator: str
    wanted: float
    unit: str
    limited: bool = True
    table_error: float = 0.0
    mounting_error: float = 0.0
    rest: float = math.inf
    reason: str = ""

    @property
    def feasible(self) -> bool:
        """Whether some table meets it."""
        return not self.reason

    @property
    def tilt(self) -> float:
        """Errors of table and mounting together, rms per axis, rad."""
        return math.sqrt((self.table_error**2 + self.mounting_error**2) / 3.0)


@dataclass(frozen=True, kw_only=True, slots=True, repr=False)
class Requirements(Brief):
    """All requirements, and what meets those that can be met: the smallest tolerances and the longest rest."""

    setup: Setup
    method: PlannedMethod
    iteration: int
    rows: tuple[Requirement, ...]

    @property
    def feasible(self) -> bool:
        """Whether some set-up meets all of them."""
        return all(row.feasible for row in self.rows)

    @property
    def table_error(self) -> float:
        """Largest error of the table, rad, that meets every requirement that can be met."""
        return min((row.table_error for row in self.met), default=0.0)

    @property
    def mounting_error(self) -> float:
        """The same of the mounting."""
        return min((row.mounting_error for row in self.met), default=0.0)

    @property
    def rest(self) -> float:
        """Shortest rest, s, that meets every requirement that can be met."""
        return max((row.rest for row in self.met), default=0.0)

    @property
    def met(self) -> tuple[Requirement, ...]:
        """Those that some set-up meets."""
        return tuple(row for row in self.rows if row.feasible)


def require(
    wanted: Mapping[str, float],
    setup: Setup,
    *,
    method: PlannedMethod = "joint",
    iteration: int = 1,
    gyro_bias: BiasEstimator = "programme",
) -> Requirements:
    """Tolerances of table and mounting, and duration of the rests, for wanted rms errors by group of parameters, SI.

    Of `setup` the programme, noises, spreads, turn rate and site are used, and the ratio of table to mounting error;
    if both are zero they get equal tolerances. `iteration` and `gyro_bias` are for the other methods. `gyro_bias`:
    instead of what the method does with the whole programme, "vertical" is one rest per gyro with its axis vertical,
    Eq. (18), and "polar" one along the Earth's axis, Eq. (17).
    Raises InputError for a group that does not exist or values that make no sense.

    >>> import tumble
    >>> setup = tumble.Setup.of(terms="full")
    >>> tumble.require({"accel.scale": 10e-6}, setup).feasible
    True
    >>> tumble.require({"accel.scale": 3.5e-6}, setup).feasible
    False
    """
    check_setup(setup, iteration)
    if method == "joint":
        if gyro_bias != "programme":
            raise InputError(
                f"gyro_bias: expected programme with the method joint, found {gyro_bias!r}; take another method"
            )
        return Requirements(setup=setup, method=method, iteration=1, rows=_rows_of_joint(wanted, setup))
    expect_linear(setup, method)
    larger = max(setup.table_error, setup.mounting_error)
    table, mounting = (setup.table_error / larger, setup.mounting_error / larger) if larger > 0.0 else (1.0, 1.0)
    unit = replace(setup, table_error=table, mounting_error=mounting)
    pipeline = pipeline_of(unit, method)
    _check_wanted(wanted, pipeline.groups)
    rows = [_requirement(unit, pipeline, iteration, group, value, gyro_bias) for group, value in wanted.items()]
    return Requirements(setup=setup, method=method, iteration=iteration, rows=tuple(rows))


def wanted_of(texts: Sequence[str], relative_percent: float | None, setup: Setup) -> dict[str, float]:
    """Wanted rms errors by group, SI, from texts such as "accel.scale=3.5ppm" and, for the groups these do not name,
    from a percentage of the spreads. Raises InputError for a text it cannot read, and where nothing is wanted."""
    if relative_percent is not None and not relative_percent > 0.0:
        raise InputError(f"--relative: expected more than 0 %, found {relative_percent:g}")
    spreads = {group: spread_of(setup, group) for group in GROUPS}
    wanted = {} if relative_percent is None else {g: 1e-2 * relative_percent * s for g, s in spreads.items()}
    wanted |= wanted_accuracies(texts, GROUPS)
    if not wanted:
        raise InputError("expected --want GROUP=VALUE or --relative PERCENT, found neither")
    return wanted


def _rows_of_joint(wanted: Mapping[str, float], setup: Setup) -> tuple[Requirement, ...]:
    """Of the method joint: the shortest rests of at most LONGEST_REST with which the bound is what is wanted."""
    _check_wanted(wanted, GROUPS)
    rests = [1.0]
    while rests[-1] < LONGEST_REST:
        rests.append(min(2.0 * rests[-1], LONGEST_REST))
    bounds = [bound(replace(setup, rest=rest)) for rest in rests]
    rows = []
    for group, value in wanted.items():
        least = [each.rms(group) for each in bounds]
        best = min(range(len(rests)), key=lambda i: least[i])
        enough = next((i for i, error in enumerate(least) if error <= value), None)
        row = Requirement(group=group, estimator=MAXIMUM_LIKELIHOOD, wanted=value, unit=UNITS[group])
        if enough is not None:
            short, long = rests[max(enough - 1, 0)], rests[enough]
            while long > 1.01 * short:  # to 1 %
                middle = math.sqrt(short * long)
                met = bound(replace(setup, rest=middle)).rms(group) <= value
                short, long = (short, middle) if met else (middle, long)
            any_table = LARGEST_DEVIATION
            rows.append(replace(row, limited=False, table_error=any_table, mounting_error=any_table, rest=long))
            continue
        size, unit = engineering(UNITS[group], least[best])
        reached = (
            "which this programme does not determine"
            if math.isinf(least[best])
            else f"expected an accuracy of at least {least[best] / size:.3g} {unit}, which the method joint has "
            f"with rests of {rests[best]:.0f} s, found {value / size:.3g} {unit}"
        )
        remedy = "take another programme (tumble plan), average launches, or a better grade"
        rows.append(replace(row, reason=f"{group}: {reached}; {remedy}"))
    return tuple(rows)


_SINGLE_REST = {
    "vertical": ("one rest, axis vertical, Eq. (18)", "accelerometer error × horizontal Earth's rate"),
    "polar": ("one rest, axis along the Earth's, Eq. (17)", "azimuth error of TRIAD, δω²/2Ω"),
}
"""What one rest is called, and what its error is where there is neither table error nor noise."""

_REMEDY: Mapping[str, str] = {
    "gyro noise in turns": "turn faster, or average launches",
    "accelerometer instability": "average launches",
    "gyro instability": "average launches",
    "uncertainty of gravity": "measure gravity",
    "second order in the parameters": "take another pass",
    "azimuth error of TRIAD, δω²/2Ω": "take vertical axes, Eq. (18), or another pass",
}


def _requirement(
    unit: Setup, pipeline: Pipeline, iteration: int, group: str, wanted: float, gyro_bias: BiasEstimator
) -> Requirement:
    """The inverse: what of wanted² is left over what no table can help goes to deviations and to the noise of rests.
    The variance is made of what is `fixed` by cause, of `rest_noise` over the duration of a rest, and of what
    deviations of so many times the unit ratio add."""
    from scipy.optimize import brentq

    by_deviations: Callable[[float], float]
    if group != "gyro.bias" or gyro_bias == "programme":
        estimator, members, square = ESTIMATORS[pipeline.method][group], MEMBERS[group], size_of(unit, group) ** 2

        def in_group(causes: Mapping[str, Array]) -> dict[str, float]:
            return {name: square * float(v[members].mean()) for name, v in causes.items()}

        def by_deviations(scale: float) -> float:
            return sum(in_group(pipeline.methodical(iteration, scale)).values())

        noise = in_group(pipeline.noise)
        rest_noise = unit.rest * sum(noise.pop(name) for name in REST_NOISE)
        fixed = in_group(pipeline.methodical(iteration, 0.0)) | noise
    else:
        # one rest per gyro, vertical (18) or polar (17), with the accelerometers as each pass leaves them: the bias
        # that a pass has left is what the next one sees
        tilt = math.sqrt((unit.table_error**2 + unit.mounting_error**2) / 3.0)
        north, up, _ = earth_rate(unit.latitude)
        level, steep = (north, up) if gyro_bias == "vertical" else (0.0, EARTH_RATE)

        def by_deviations(scale: float) -> float:
            bias2 = unit.gyro.bias**2
            for i in range(1, iteration + 1):
                b2 = float(total_of(pipeline.methodical(i, scale))[MEMBERS["accel.bias"]].mean())
                curved = 3.0 * (bias2 / (2.0 * EARTH_RATE)) ** 2 if gyro_bias == "polar" else 0.0
                bias2 = level**2 * b2 + (scale * tilt) ** 2 * (steep**2 * b2 + bias2) + curved
            return bias2

        estimator, cause = _SINGLE_REST[gyro_bias]
        fixed = {cause: by_deviations(0.0), "gyro instability": unit.noise.gyro_instability**2}
        rest_noise = unit.noise.gyro_white**2
    least, floor = sum(fixed.values()), by_deviations(0.0)
    free = wanted**2 - least
    row = Requirement(group=group, estimator=estimator, wanted=wanted, unit=UNITS[group])
    if free <= 0.0:
        cause = max(fixed, key=lambda name: fixed[name])
        size, name = engineering(UNITS[group], math.sqrt(least))
        reason = (
            f"{group}: expected an accuracy of at least {math.sqrt(least) / size:.3g} {name}, which an exact table and "
            f"endless rests leave (mostly {cause}), found {wanted / size:.3g} {name}; "
            f"{_REMEDY.get(cause, 'take another pass or method')}"
        )
        return replace(row, reason=reason)
    permitted = (1.0 - REST_SHARE) * free if rest_noise > 0.0 else free
    scale = largest = LARGEST_DEVIATION / max(unit.table_error, unit.mounting_error)
    if by_deviations(largest) - floor > permitted:
        scale = float(brentq(lambda x: by_deviations(x) - floor - permitted, 0.0, largest, rtol=1e-9))
    return replace(
        row,
        limited=scale < largest,
        table_error=scale * unit.table_error,
        mounting_error=scale * unit.mounting_error,
        rest=rest_noise / (REST_SHARE * free) if rest_noise > 0.0 else 0.0,
    )


def _check_wanted(wanted: Mapping[str, float], groups: Sequence[str]) -> None:
    """Raise InputError for a group the programme does not give or an accuracy that is none."""
    for group, value in wanted.items():
        if group not in groups:
            raise InputError(f"wanted: expected some of {', '.join(groups)}, found {group!r}")
        expect(group, value, least="more than 0")
