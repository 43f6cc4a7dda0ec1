"""What accuracy a set-up gives: what the errors of a set-up do to each pass of a method on a programme.

How the budget is put together. Let X be the 21 parameters (the order of the calibration file). To first order in X
one pass of a method is a matrix, so that it leaves

    X − X̂ = T X − G n + q(X)         T = T₀ + Σ τ_k D_k

of the parameters: τ_k are the deviations of the attitudes from the programme (table: three per position, about N, U,
E; mounting: three, about X, Y, Z), T₀ what an exact programme leaves (Earth's rate × gyro errors), n the noise of
rests and turns, q the error of second order in the parameters. The next pass sees what is left, so that it leaves
T² X. With parameters and deviations independent of each other and of zero mean,

    pass 1    E (T X)²_p = Σ_j σ_j² [ T₀² + Σ_k v_k D_k² ]_pj
    pass 2    E (T² X)²_p = Σ_j σ_j² [ (c + tr A)² + Σ_k v_k l_k² + 2 Σ_kl v_k v_l S_kl² + Σ_k (μ_k − 3 v_k²) A_kk² ]_pj

where T² = c + Σ τ_k l_k + Σ τ_k τ_l A_kl, S is the symmetric part of A, tr A = Σ v_k A_kk, and v_k, μ_k are the second
and fourth moments of τ_k. Further passes gain as much as the second did: (κσ)^i, §7.

The method `joint` needs none of that: what it leaves is the bound (`tumble.planning.bounds`), of instruments with all
groups of parameters, too, which the others take for parameters of the linear model.

T₀, D and q are those of `tumble.planning.error_propagation`. `tumble.planning.requirements` is the inverse.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from tumble.brief import Brief
from tumble.earth import EARTH_RATE, earth_rate
from tumble.errors import InputError
from tumble.inference.hyperparameters import CORRELATION_TIME
from tumble.planning.bounds import bound
from tumble.planning.error_propagation import (
    BUDGETED_METHODS,
    STEP,
    BudgetedMethod,
    Plan,
    estimated,
    first_order,
    logged_rows,
    observed,
    plan_of,
    second_order,
)
from tumble.planning.itinerary import itinerary_of
from tumble.planning.setup import NAMES, Setup, check_setup
from tumble.sensors.grades import spread_of
from tumble.sensors.parameters import group_name, positions_by_group, units_of
from tumble.units import DEGREE, DEGREE_PER_HOUR, Array

PlannedMethod = Literal["joint", "sequential", "scalar", "staged"]

UNITS = {group_name(name): unit for name, unit in zip(NAMES, units_of(NAMES), strict=True)}
"""The SI unit of each group of parameters."""
MEMBERS = {group: np.array(members) for group, members in positions_by_group(NAMES).items()}
"""Indices of the parameters of each group."""
GROUPS = tuple(MEMBERS)
"""The groups of parameters, in the order of the calibration file."""

MAXIMUM_LIKELIHOOD = "maximum likelihood, the bound"
"""How the method joint finds every group of parameters."""

_INDIRECT = ("indirect, programme matrix",) * 2
_BY_METHOD: Mapping[BudgetedMethod, tuple[str, ...]] = {
    "sequential": (*("up and down, levelled, Eq. (4)",) * 2, "axes 45° up and down, Eq. (10)",
                   "vertical axes, Eq. (18)", *_INDIRECT),
    "scalar": (*("scalar, estimated orientation, Eq. (13)",) * 3, "scalar, estimated orientation", *_INDIRECT),
    "staged": (*("scalar, estimated orientation, Eq. (13)",) * 3, "dot product",
               *("indirect, logged Jacobian",) * 2),
}  # fmt: skip
ESTIMATORS = {method: dict(zip(GROUPS, words, strict=True)) for method, words in _BY_METHOD.items()}
"""How each method finds each group of parameters."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Term:
    """One cause of a group's error, and the rms error it makes alone, SI."""

    name: str
    error: float


@dataclass(frozen=True, kw_only=True, slots=True)
class BudgetRow:
    """Expected error of a group of parameters after `iteration` passes of a method.

    `error`: rms over the group's parameters and over instruments and set-ups, in `unit` (SI); `relative`: the same
    over the spread before calibration; `errors`: rms by parameter name; `terms`: what it is made of, largest first."""

    group: str
    method: PlannedMethod
    estimator: str
    iteration: int
    unit: str
    error: float
    relative: float
    errors: Mapping[str, float]
    terms: tuple[Term, ...]

    @property
    def dominating(self) -> str:
        """The largest term's name; nothing where nothing is left, to the order of the formulas."""
        return self.terms[0].name if self.terms else "nothing"


@dataclass(frozen=True, kw_only=True, slots=True, repr=False)
class Budget(Brief):
    """The rows of a set-up: by method, then by iteration, then by group; `remarks` say, in sentences, where the set-up
    is outside what the formulas hold for."""

    setup: Setup
    rows: tuple[BudgetRow, ...]
    remarks: tuple[str, ...]

    def row(self, method: PlannedMethod, group: str, iteration: int) -> BudgetRow:
        """The row of this method, group and iteration. Raises KeyError if there is none."""
        for row in self.rows:
            if (row.method, row.group, row.iteration) == (method, group, iteration):
                return row
        raise KeyError((method, group, iteration))


def budget(setup: Setup, methods: Sequence[PlannedMethod] = BUDGETED_METHODS, iterations: int = 2) -> Budget:
    """Expected errors of every group of parameters after each of so many passes of these methods; joint has one.

    Groups that the programme cannot give (gyro scale factors without known turns) have no row. Raises InputError for
    values that make no sense, and for groups beyond the linear model with another method than joint; ProgrammeError for
    a programme without the positions a method needs.

    >>> import tumble
    >>> setup = tumble.Setup.of(rest=120.0)
    >>> found = tumble.budget(setup, methods=["staged"])
    >>> sorted({row.method for row in found.rows})
    ['staged']
    """
    check_setup(setup, iterations)
    rows: list[BudgetRow] = []

    def add(
        method: PlannedMethod, iteration: int, group: str, errors: Mapping[str, float], terms: Mapping[str, float]
    ) -> None:
        error = _rms(np.array(list(errors.values())) ** 2)
        rows.append(
            BudgetRow(
                group=group,
                method=method,
                estimator=MAXIMUM_LIKELIHOOD if method == "joint" else ESTIMATORS[method][group],
                iteration=iteration,
                unit=UNITS[group],
                error=error,
                relative=error / spread_of(setup, group),
                errors=errors,
                terms=tuple(Term(name=n, error=e) for n, e in sorted(terms.items(), key=lambda term: -term[1])),
            )
        )

    for method in methods:
        if method == "joint":
            least, alone = bound(setup), bound(replace(setup, further={}))
            for group in least.groups:
                error, noise = least.rms(group), alone.rms(group)
                further = {"groups beyond the linear model": math.sqrt(max(error**2 - noise**2, 0.0))}
                if math.isfinite(error):
                    errors = {least.names[p]: float(least.u[p]) for p in positions_by_group(least.names)[group]}
                    add(method, 1, group, errors, {"noise": noise} | (further if setup.further else {}))
            continue
        expect_linear(setup, method)
        pipeline = pipeline_of(setup, method)
        for iteration in range(1, iterations + 1):
            variances = {**pipeline.methodical(iteration, 1.0), **pipeline.noise}
            total = total_of(variances)
            for group in pipeline.groups:
                members, size = MEMBERS[group], size_of(setup, group)
                errors = {NAMES[p]: size * math.sqrt(total[p]) for p in members}
                terms = {name: size * _rms(v[members]) for name, v in variances.items() if v[members].any()}
                add(method, iteration, group, errors, terms)
    return Budget(setup=setup, rows=tuple(rows), remarks=tuple(_remarks(setup, methods)))


def expect_linear(setup: Setup, method: BudgetedMethod) -> None:
    """Raise InputError where an instrument has more than the formulas of a method hold for."""
    if setup.further:
        raise InputError(
            f"terms: expected linear for the method {method}, whose formulas have no other groups of parameters, found "
            "full; take the method joint, or the linear model"
        )


def _remarks(setup: Setup, methods: Sequence[PlannedMethod]) -> Iterator[str]:
    """What a set-up has that the formulas do not hold for."""
    largest = max(setup.table_error, setup.mounting_error)
    if set(methods) != {"joint"} and largest > LARGEST_DEVIATION:
        yield (
            f"errors of table and mounting up to {largest / DEGREE:.3g}°: the formulas are of first order in them and "
            f"hold up to {LARGEST_DEVIATION / DEGREE:g}°"
        )
    rate = math.hypot(setup.gyro.bias, setup.noise.gyro_white / math.sqrt(setup.rest), setup.noise.gyro_instability)
    north = earth_rate(setup.latitude)[0]
    if rate > LARGEST_AZIMUTH * north and set(methods) & {"sequential", "scalar"}:
        yield (
            f"gyros off by {rate / DEGREE_PER_HOUR:.3g} °/h at rest, with {north / DEGREE_PER_HOUR:.3g} °/h of Earth's "
            "rate to find north by: the methods sequential and scalar do worse in gyro parameters than predicted, "
            "take staged"
        )


LARGEST_DEVIATION = 5.0 * DEGREE
"""Largest table and mounting error, rad, for which formulas of first order in them are taken to hold."""

LARGEST_AZIMUTH = 0.1
"""Largest azimuth error of TRIAD, rad, likewise; the paper, too, wants biases an order below the Earth's rate."""


def size_of(setup: Setup, group: str) -> float:
    """One internal unit of a group in SI: biases of accelerometers are angles inside."""
    return setup.gravity if group == "accel.bias" else 1.0


def _rms(variance: Array) -> float:
    return math.sqrt(float(variance.mean()))


# -------------------- what a method leaves of the parameters --------------------


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Pipeline:
    """What passes of a method leave of the parameters. Matrices (21, 21) are to be applied to the variances of the
    parameters: `exact`, `by_table` and `by_mounting` for the first pass, and for the second the parts that grow with
    the 0th, 2nd and 4th power of the deviations, `twice`. `second_order` (21,) and `noise` (21,) by cause are variances
    themselves; `spread` (21,) the rms of the parameters."""

    method: BudgetedMethod
    groups: tuple[str, ...]
    exact: Array
    by_table: Array
    by_mounting: Array
    twice: tuple[Array, Array, Array]
    second_order: Array
    noise: Mapping[str, Array]
    spread: Array

    def methodical(self, iteration: int, scale: float) -> dict[str, Array]:
        """Variances (21,) of the errors after so many passes, by the name of their cause, but for noise, with table and
        mounting errors multiplied by `scale`."""
        if iteration == 1:
            return {
                **self._by_group("{} × table error", scale**2 * self.by_table),
                **self._by_group("{} × mounting error", scale**2 * self.by_mounting),
                **self._by_group("{} × Earth's rate", self.exact),
                "second order in the parameters": self.second_order,
            }
        fixed, linear, square = self.twice
        second = self._by_group("{} left by the pass before", fixed + scale**2 * linear + scale**4 * square)
        if iteration == 2:
            return second
        gain, first = np.zeros(len(NAMES)), total_of(self.methodical(1, scale))
        for members in MEMBERS.values():
            before = float(first[members].mean())
            gain[members] = total_of(second)[members].mean() / before if before > 0.0 else 0.0
        return {name: gain ** (iteration - 2) * variance for name, variance in second.items()}

    def _by_group(self, name: str, matrix: Array) -> dict[str, Array]:
        """Variances (21,) that each group of parameters contributes through a matrix."""
        return {name.format(g): matrix[:, own] @ self.spread[own] ** 2 for g, own in MEMBERS.items()}


def total_of(variances: Mapping[str, Array]) -> Array:
    """The sum (21,) of variances by cause."""
    return sum(variances.values(), np.zeros(len(NAMES)))


def pipeline_of(setup: Setup, method: BudgetedMethod) -> Pipeline:
    """A method on the programme of a set-up: the mean squares of T X, T² X and q(X), see the module's docstring."""
    plan = plan_of(setup.programme, method, turn_rate=setup.turn_rate, latitude=setup.latitude)
    T0, D = first_order(plan)
    table = 3 * len(plan.nominal)
    width = np.repeat([setup.table_error, setup.mounting_error], [table, 3])
    v, fourth = width**2 / 3.0, width**4 / 5.0  # uniform
    angles = [setup.accel.bias / setup.gravity, setup.accel.scale, setup.accel.axis]
    spread = np.repeat([*angles, setup.gyro.bias, setup.gyro.scale, setup.gyro.axis], [3, 3, 3, 3, 3, 6])
    # T² = c + Σ τ_k l_k + Σ τ_k τ_l A_kl
    c, linear = T0 @ T0, T0 @ D + D @ T0
    A = np.einsum("kpj,ljq->klpq", D, D)
    S, own = 0.5 * (A + A.swapaxes(0, 1)), np.einsum("kkpq->kpq", A)
    trace = np.tensordot(v, own, axes=1)
    square = trace**2 + 2.0 * np.einsum("k,l,klpq->pq", v, v, S**2, optimize=True)
    square += np.tensordot(fourth - 3.0 * v**2, own**2, axes=1)
    # q(X) = Xᵀ Q X, with the mean square (tr Q)² + 2 Σ Q_ij² for independent Gaussian X of unit spread
    Q = np.outer(spread, spread)[:, :, None] * second_order(plan)
    return Pipeline(
        method=method,
        groups=GROUPS if len(plan.first) else GROUPS[:4],
        exact=T0**2,
        by_table=np.tensordot(v[:table], D[:table] ** 2, axes=1),
        by_mounting=np.tensordot(v[table:], D[table:] ** 2, axes=1),
        twice=(c**2, 2.0 * c * trace + np.tensordot(v, linear**2, axes=1), square),
        second_order=np.trace(Q) ** 2 + 2.0 * (Q**2).sum(axis=(0, 1)),
        noise=_noise(setup, plan),
        spread=spread,
    )


REST_NOISE = ("accelerometer noise at rest", "gyro noise at rest")
"""The causes that longer rests reduce."""


def _noise(setup: Setup, plan: Plan) -> dict[str, Array]:
    """Variances (21,) of the parameters from noise, by cause, on an exact programme: each noise as if alone."""
    N, K, noise, g = len(plan.nominal), len(plan.first), setup.noise, setup.gravity
    rest, turn = np.eye(3 * N).reshape(3 * N, N, 3), np.eye(3 * K).reshape(3 * K, K, 3)
    rows = logged_rows(plan, np.zeros(len(NAMES)), plan.nominal)

    def gains(step: float, **errors: Array) -> Array:
        """What unit errors of what is seen make of the parameters (m, 21)."""
        X, out = np.zeros((len(rest) if "turned" not in errors else len(turn), len(NAMES))), []
        for sign in (1.0, -1.0):
            seen = observed(plan, X, plan.nominal, **{name: sign * step * error for name, error in errors.items()})
            out.append(estimated(plan, seen, rows))
        return np.asarray((out[0] - out[1]) / (2.0 * step))

    alike = np.exp(-np.abs(np.subtract.outer(*[itinerary_of(setup).rests[:, 0]] * 2)) / CORRELATION_TIME)

    def wandered(gains: Array, bias: str) -> Array:
        """Variances (21,) by biases that are a process of unit variance, with what comes of each rest and axis
        (3N, 21); those of a `bias` are about its mean over the session."""
        of_rests = gains.reshape(N, 3, -1).copy()
        of_rests[:, np.arange(3), MEMBERS[bias]] -= 1.0 / N
        return np.asarray(np.einsum("icp,ij,jcp->p", of_rests, alike, of_rests))

    by_accel, by_gyro = gains(STEP, force=rest), gains(STEP * EARTH_RATE, rate=rest)
    by_turn = gains(STEP, turned=turn) if K else np.zeros((0, len(NAMES)))
    between = 0.5 * (rest[:, plan.first] + rest[:, plan.first + 1])  # biases in a turn are those between its ends
    by_change = gains(STEP * EARTH_RATE, rate=rest, drift=between)
    scale = np.isin(np.arange(len(NAMES)), MEMBERS["accel.scale"])
    return {
        REST_NOISE[0]: (by_accel**2).sum(axis=0) * (noise.accel_white / g) ** 2 / setup.rest,
        REST_NOISE[1]: (by_gyro**2).sum(axis=0) * noise.gyro_white**2 / setup.rest,
        "gyro noise in turns": np.repeat(plan.course.duration, 3) @ by_turn**2 * noise.gyro_white**2,
        "accelerometer instability": wandered(by_accel, "accel.bias") * (noise.accel_instability / g) ** 2,
        "gyro instability": wandered(by_change, "gyro.bias") * noise.gyro_instability**2,
        "uncertainty of gravity": scale * (setup.gravity_u / g) ** 2,
    }
