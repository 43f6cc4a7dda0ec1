"""Methods of the turntable paper on a session: four stages, each with the results of the previous one, and iterations.

    1  biases and scale factors of the accelerometers     from rests
    2  angles between the axes of the accelerometers      from rests (the scalar method does 1 and 2 together)
    3  biases of the gyros                                from rests in which each is vertical, Eq. (18)
    4  scale factors and axis angles of the gyros         from turns, by the indirect method

The four stages are a pass. It starts from the models of the previous pass (first from nominal sensors), takes readings
compensated by them, and composes the new models with them exactly. Stage 3 is the only variant of the paper that holds
for any bias. Stage 4 uses the programme matrix of §6.3 and plain least squares. An iteration is one pass over the same
data, with the turns integrated about the gyro model of the pass.

The covariance is that of the data, propagated with the derivative of the passes with respect to every mean reading,
turn, gravity and start value, by central differences and the chain rule. The error of the last pass is the difference
to the limit of further passes. Omitted groups of parameters are in the result as zero, and in the covariance by the
same derivative (`tumble.diagnosis.linear_model`). Scatter, and rests and turns that do not fit, are those of the method
`joint` with all groups.

Source: Vodicheva & Parysheva 2019, the turntable paper, §2 to §6.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import pairwise

import numpy as np

from tumble.diagnosis.linear_model import converged_joint, group_columns, omitted_sizes, with_omitted_groups
from tumble.earth import earth_rate
from tumble.errors import InputError, ProgrammeError, SessionError
from tumble.inference.estimate import Estimate
from tumble.inference.joint import joint
from tumble.inference.noise import VarianceComponents, typical_noise
from tumble.inference.problem import Problem
from tumble.inference.sources import Source, UncertaintyBudget, source
from tumble.methods.least_squares import solve_least_squares
from tumble.methods.paper.accelerometers import (
    by_modulus,
    by_modulus_nominal,
    by_vector,
    check_for_modulus,
    check_for_vector,
)
from tumble.methods.paper.blocks import TRIAD, compensate, compose, model_of, parameters_of, sensing_axes, to_sensors
from tumble.methods.paper.gyros import (
    RecordedTurn,
    Series,
    along_vertical,
    axes_and_angles,
    check_directions,
    horizontal_differences,
    known_turns,
    programme_matrix,
    recorded_matrix,
    spare_sensitivities,
    triad,
    vertical_bias,
)
from tumble.programme.positions import Programme
from tumble.reduction.observations import Observations
from tumble.reduction.turns.turns import Turns
from tumble.rotation import rotation_matrix
from tumble.sensors.model import PERFECT_TRIAD, Block, SensorModel, triad_model
from tumble.sensors.parameters import group_name, units_of
from tumble.units import DEGREE_PER_HOUR, Array, IntArray

GYRO_TRIAD = replace(TRIAD, kind="gyro")
MAX_PASSES = 30
NEGLIGIBLE = 1e-2  # increments, in uncertainties or steps of the differences
LARGEST_AZIMUTH = 0.1
"""Largest azimuth error of TRIAD, rad, for formulas of first order in it; the paper requires biases an order of
magnitude below the Earth's rate as well."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class PaperMethod:
    """A method of the paper."""

    name: str
    accelerometers: Callable[[Array, Array, Array, Block], SensorModel]
    """Stages 1 and 2, of readings, nominal verticals, gravity and block."""
    check: Callable[[Array, Block], None]
    """Raises ProgrammeError if rests with the nominal verticals (N, 3) are not enough."""
    gyro_bias: Callable[[Array, Array, Array, Array, Array], Array] = vertical_bias
    """Stage 3, of rates, specific force, Earth's rate, nominal verticals and axes."""
    any_axes: bool = False  # whether it takes blocks other than triads


SEQUENTIAL = PaperMethod(name="sequential", accelerometers=by_vector, check=check_for_vector, any_axes=True)
SCALAR = PaperMethod(name="scalar", accelerometers=by_modulus, check=check_for_modulus)
SCALAR_NOMINAL = PaperMethod(name="scalar-nominal", accelerometers=by_modulus_nominal, check=check_for_modulus)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ProgrammeCourse:
    """Rests and turns of a session by its programme."""

    nominal: Array  # (N, 3): verticals of the programme in the body
    series: tuple[Series, ...] = ()  # of recorded turns
    duration: Array = field(default_factory=lambda: np.empty(0))  # (K,), of all turns, s
    earth_rate: Array = field(default_factory=lambda: np.zeros(3))  # in N, U, E
    matrix: Array | None = None  # of the programme; None to use that of the recorded turns
    accel: Block = TRIAD
    gyro: Block = GYRO_TRIAD


# One pass


def one_pass(
    method: PaperMethod,
    course: ProgrammeCourse,
    rests: tuple[Array, Array],
    turn: Callable[[SensorModel], Array] | None,
    gravity: Array,
    before: tuple[SensorModel, SensorModel],
    matrix: Array | None = None,
    integral: Array | None = None,
) -> tuple[SensorModel, SensorModel]:
    """Return the models of accelerometers and gyros after all stages, from those of the previous pass.

    Parameters
    ----------
    method, course
        The method, and the rests and turns by the programme.
    rests : (..., N, n) each
        Readings of accelerometers and gyros at rest; N = 0 without gyros.
    turn
        Returns the turns (..., K, 3, 3) integrated with a gyro model; with None, the pass ends after stage 3.
    gravity : (...)
        Gravity, m/s².
    before
        Models of accelerometers and gyros of the previous pass.
    matrix : (2T, 9)
        Matrix of stage 4, by default that of the programme.
    integral : (..., K, n)
        Integrals of the readings of more than three gyros over the turns, rad.
    """
    readings, rates = rests
    accel, gyro = before
    axes = sensing_axes(course.accel)
    inner = method.accelerometers(compensate(accel, readings, axes), course.nominal, gravity, course.accel)
    accel = compose(accel, inner, axes)
    if not rates.shape[-2]:
        return accel, gyro
    force, axes = accel.apply(readings), sensing_axes(course.gyro)
    bias = method.gyro_bias(compensate(gyro, rates, axes), force, course.earth_rate, course.nominal, axes)
    gyro = compose(gyro, SensorModel(matrix=axes, bias=bias), axes)
    if turn is None:
        return accel, gyro
    matrix = course.matrix if matrix is None else matrix
    assert matrix is not None
    attitude = triad(force, gyro.apply(rates))
    y = horizontal_differences(course.series, attitude, force, turn(gyro), course.duration, course.earth_rate)
    x = solve_least_squares(matrix, y)
    sensitivity = axes @ triad_model(np.zeros_like(x[..., :3]), x[..., :3], x[..., 3:]).matrix
    if integral is not None and integral.shape[-2]:
        unbiased = integral - course.duration[:, None] * gyro.bias[..., None, :]
        scaled = compensate(replace(gyro, bias=np.zeros_like(gyro.bias)), unbiased, axes)
        sensitivity = sensitivity + spare_sensitivities(scaled, axes)
    return accel, compose(gyro, SensorModel(matrix=sensitivity, bias=np.zeros_like(bias)), axes)


# The course of a session


def course_of(observations: Observations, method: PaperMethod) -> ProgrammeCourse:
    """Return the course of a session; raise InputError unless it has everything that the method needs."""
    programme, position = observations.programme, observations.position
    if programme is None or position is None:
        raise ProgrammeError(
            f"method {method.name}: expected a programme with known positions and turns, such as rough-table, "
            "found none; give [programme] in session.toml or take the method joint"
        )
    accel, gyro, latitude = observations.accel_block, observations.gyro_block, observations.site.latitude
    blocks = [block for block in (accel, gyro) if block is not None]
    for block in blocks:
        if not block.triad and not method.any_axes:
            raise InputError(
                f"method {method.name}: expected three sensors of a kind along the body axes, found {block.size} "
                f"({block.kind}) with other directions; take the method sequential or joint"
            )
    nominal = np.array([programme.positions[k].vertical_b for k in position])
    method.check(nominal, accel)
    if gyro is None:
        return ProgrammeCourse(nominal=nominal, accel=accel)
    vertical: list[bool] = np.any(along_vertical(nominal, sensing_axes(gyro)), axis=0).tolist()
    if not all(vertical):
        lying = ", ".join(f"gyro {name}" for name, found in zip(gyro.sensors, vertical, strict=True) if not found)
        raise ProgrammeError(
            f"method {method.name}: expected rests in which every gyro is vertical, found none for {lying} in the "
            "programme; take the programme rough-table for sensors along X, Y and Z, or the method joint"
        )
    turns, matrix = observations.turns, None
    first, last = ([], []) if turns is None else (turns.first.tolist(), turns.last.tolist())
    series: tuple[Series, ...] = tuple(
        (RecordedTurn(turn=k, first=a, last=b, counts=True),) for k, (a, b) in enumerate(zip(first, last, strict=True))
    )
    if all(block.triad for block in blocks):
        check_directions(programme)
        series, matrix = _series(programme, position, first), programme_matrix(programme)[0]
    if latitude is None:
        raise SessionError(
            f"[site]: expected latitude_deg, from which the method {method.name} has the Earth's rate, found none; "
            "give it or take the method joint"
        )
    return ProgrammeCourse(
        nominal=nominal,
        series=series,
        duration=np.empty(0) if turns is None else turns.duration,
        earth_rate=np.array(earth_rate(latitude)),
        matrix=matrix,
        accel=accel,
        gyro=gyro,
    )


def course_of_programme(programme: Programme, *, turn_rate: float, latitude: float) -> ProgrammeCourse:
    """Return the course of the known turns of a programme alone, at a rate in rad/s."""
    known = [k for series in known_turns(programme) for k in series]
    return ProgrammeCourse(
        nominal=np.array([position.vertical_b for position in programme.positions]),
        series=_series(programme, np.arange(len(programme.positions)), known),
        duration=np.abs(axes_and_angles(programme)[1]) / turn_rate,
        earth_rate=np.array(earth_rate(latitude)),
        matrix=programme_matrix(programme)[0],
    )


def _series(programme: Programme, position: IntArray, first: Sequence[int]) -> tuple[Series, ...]:
    """Return the recorded turns of every series of known turns of a programme, for rests at `position` (N,) and turns
    after the rests `first` (K,)."""
    turn_after, course = {rest: turn for turn, rest in enumerate(first)}, []
    for moves in known_turns(programme):
        rests = np.flatnonzero((position >= moves[0]) & (position <= moves[-1] + 1)).tolist()
        for rest in rests[:-1]:
            if rest not in turn_after:
                raise ProgrammeError(
                    f"programme {programme.name}: expected the turn from rest {rest + 1} to rest {rest + 2} in the "
                    "log, found the end of a file; record every series in one file or take the method joint"
                )
        course.append(
            tuple(
                RecordedTurn(turn=turn_after[a], first=a, last=b, counts=bool(position[a] != position[b]))
                for a, b in pairwise(rests)
            )
        )
    return tuple(course)


# Iterations


def shift_by_groups(observations: Observations, method: PaperMethod, iterations: int = 2) -> tuple[Problem, Array]:
    """Return the likelihood with the groups that a method omits, and the shift (m, k) of its result by one of each of
    their parameters. Raises as `iterated`."""
    _, derivative, _ = _SessionData.of(observations, method).passes(iterations)
    problem, columns = group_columns(observations)
    return problem, derivative @ columns


@dataclass(frozen=True, kw_only=True, slots=True)
class _Turned:
    """Turns integrated about a gyro model, to first order in changes of it."""

    turns: Turns
    about: SensorModel
    matrix: Array | None  # of the recorded turns; None to use that of the programme

    def rotations(self, error: Array, model: SensorModel) -> Array:
        """Return C (..., K, 3, 3) about `model`, with errors (..., K, 3) of the turns: exp([−(M : E + B δ)×]) C, where
        rates compensated by `about` are (I + E) ω + δ."""
        inverse = self.about.inverse()
        E, δ = inverse @ model.matrix - np.eye(3), (model.bias - self.about.bias) @ inverse.T
        turned = np.einsum("kipq,...pq->...ki", self.turns.M, E) + np.einsum("kip,...p->...ki", self.turns.B, δ)
        return np.asarray(rotation_matrix(error) @ rotation_matrix(-turned) @ self.turns.C)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _SessionData:
    """A session as a vector of data and a vector of values, both with leading axes for many at once.

    The data are the mean readings of accelerometers and of gyros (`to_sensors`), the errors of the turns, the integrals
    over them of the readings of more than three gyros, and gravity, which have these `shapes`. The values are the
    parameters of the blocks."""

    observations: Observations
    method: PaperMethod
    course: ProgrammeCourse
    blocks: tuple[Block, ...]
    shapes: tuple[tuple[int, ...], ...]
    data: Array  # (d,)
    steps: Array  # (d + m,): of the central differences, of data and values

    @staticmethod
    def of(observations: Observations, method: PaperMethod) -> _SessionData:
        course, rests, integrals = course_of(observations, method), observations.rests, observations.turn_readings
        blocks = tuple(b for b in (observations.accel_block, observations.gyro_block) if b is not None)
        parts = [getattr(rests, block.kind) @ to_sensors(block) for block in blocks]
        parts += [np.empty((0, 3))] * (2 - len(blocks)) + [np.zeros((len(course.duration), 3))]
        parts += [np.empty((0, 3)) if integrals is None else integrals.integral, np.array([observations.site.gravity])]
        of_data = np.repeat([1e-5, 1e-9, 1e-6, 1e-6, 1e-5], [part.size for part in parts])
        groups = [group_name(name) for block in blocks for name in block.names]
        of_values = [{"accel.bias": 1e-5, "gyro.bias": 1e-9}.get(group, 1e-6) for group in groups]
        return _SessionData(
            observations=observations,
            method=method,
            course=course,
            blocks=blocks,
            shapes=tuple(part.shape for part in parts),
            data=np.concatenate([part.ravel() for part in parts]),
            steps=np.append(of_data, of_values),
        )

    @property
    def places(self) -> list[slice]:
        """Slices of the parts in the data."""
        return [slice(*ends) for ends in pairwise(np.cumsum([0, *map(math.prod, self.shapes)]).tolist())]

    def parts(self, data: Array) -> list[Array]:
        """Return readings at rest (..., N, n), errors of turns (..., K, 3), integrals (..., K, n), and g (..., 1)."""
        parts = zip(self.places, self.shapes, strict=True)
        return [data[..., place].reshape(*data.shape[:-1], *shape) for place, shape in parts]

    def models(self, values: Array) -> tuple[SensorModel, SensorModel]:
        """Return the models of accelerometers and gyros, the latter perfect if there are none."""
        accel, *gyro = self.blocks
        count = len(accel.names)
        return model_of(accel, values[..., :count]), model_of(gyro[0], values[..., count:]) if gyro else PERFECT_TRIAD

    def turned(self, values: Array) -> _Turned | None:
        """Integrate the turns about the gyro model of values (m,); raise ProgrammeError unless they determine the
        gyros."""
        block, (accel, about), matrix = self.observations.gyro_block, self.models(values), self.course.matrix
        if block is None:
            return None
        if self.observations.turns is None:
            raise ProgrammeError("method sequential: expected turns between the rests in the log, found none")
        turns = self.observations.turns_about(block.model(values[len(self.observations.accel_block.names) :]))
        if matrix is None:
            force, rate, *_ = self.parts(self.data)
            matrix = recorded_matrix(self.course.series, triad(accel.apply(force), about.apply(rate)), turns.M)
            rank = int(np.linalg.matrix_rank(matrix, 1e-3))
            if rank < 9:
                raise ProgrammeError(
                    f"method sequential: expected turns that determine nine combinations of gyro parameters, found "
                    f"{rank}; turn about more axes between the rests, or take the method joint"
                )
        return _Turned(turns=turns, about=about, matrix=matrix)

    def after_pass(self, data: Array, values: Array, turned: _Turned | None) -> Array:
        """Return the values (..., m) after a pass over data (..., d) from values (..., m); without `turned`, after the
        stages of the rests."""
        force, rate, turning, integral, gravity = self.parts(data)
        turn, matrix = (None, None) if turned is None else (partial(turned.rotations, turning), turned.matrix)
        before = self.models(values)
        models = one_pass(self.method, self.course, (force, rate), turn, gravity[..., 0], before, matrix, integral)
        parts = zip(self.blocks, models, strict=False)
        return np.concatenate([parameters_of(block, model) for block, model in parts], axis=-1)

    def passes(self, iterations: int) -> tuple[Array, Array, tuple[Array, ...]]:
        """Return the values (m,) after some passes, their derivative (m, d) by the data, and the increments."""
        values, d = np.concatenate([self.observations.start_values(block) for block in self.blocks]), len(self.data)
        derivative, increments = np.zeros((len(values), d)), list[Array]()
        for _ in range(iterations):
            turned = self.turned(self.after_pass(self.data, values, None))
            shifted = np.append(self.data, values) + np.concatenate([np.diag(self.steps), -np.diag(self.steps)])
            high, low = np.split(self.after_pass(shifted[:, :d], shifted[:, d:], turned), 2)
            by_data, by_start = np.split((high - low).T / (2.0 * self.steps), [d], axis=1)
            increments.append(self.after_pass(self.data, values, turned) - values)
            derivative, values = by_data + by_start @ derivative, values + increments[-1]
        return values, derivative, tuple(increments)

    def limit(self, values: Array, turned: _Turned | None, u: Array) -> tuple[Array, bool]:
        """Return the limit of further passes from values (m,) of uncertainty u, with the turns to first order, and
        whether they converge."""
        negligible = NEGLIGIBLE * np.maximum(u, self.steps[len(self.data) :])
        for _ in range(MAX_PASSES):
            after = self.after_pass(self.data, values, turned)
            if np.all(np.abs(after - values) <= negligible):
                return after, True
            values = after
        return values, False

    def unsettled(self, gyro: SensorModel | None) -> str:
        """Return a sentence on passes that do not converge, with their cause; `gyro` is the model by `joint`."""
        cause, earth = "table, mounting or sensors are too far off their nominal values", self.course.earth_rate
        if gyro is not None:
            errors = np.linalg.norm(gyro.apply(self.observations.rests.gyro), axis=1) - np.linalg.norm(earth)
            off, north = float(np.sqrt(np.mean(errors**2))), float(earth[0])
            cause = weak_north(off, north) if off > LARGEST_AZIMUTH * north else cause
        return f"the passes of the method {self.method.name} do not converge: {cause}; take the method joint"

    def budget(self, derivative: Array, components: VarianceComponents) -> UncertaintyBudget:
        """Return the covariance of values by source, from their derivative (m, d) with respect to the data.

        Rests and turns have independent errors; an in-run bias has one in a turn that is proportional to its
        duration."""
        rests, turns, integrals = self.observations.rests, self.observations.turns, self.observations.turn_readings
        sources, covariances, m = dict[str, Source](), dict[str, Array](), len(derivative)

        def add(name: str, place: slice, variances: Array, u: float | None = None, unit: str = "") -> None:
            """Add errors of a source with the covariances (N, n, n) in N rests or turns."""
            J = derivative[:, place].reshape(m, len(variances), -1)
            sources.setdefault(name, source(name, u, unit))
            covariances[name] = covariances.get(name, 0.0) + np.einsum("min,inp,kip->mk", J, variances, J)

        sensors = components.unlike if components.unlike.size else np.ones(sum(block.size for block in self.blocks))
        *at_rest, rotations, spare, gravity = self.places
        for block, place, unit in zip(self.blocks, at_rest, ("m/s^2", "rad/s"), strict=False):
            kind, axes = block.kind, to_sensors(block)
            noise: Array = getattr(rests, f"{kind}_covariance")
            add(f"{kind}.noise", place, axes.T @ noise @ axes, typical_noise(noise), unit)
            factors, sensors = sensors[: block.size], sensors[block.size :]
            by_one = np.broadcast_to(axes.T @ np.diag(factors**2) @ axes, noise.shape)
            for name, what in (("scatter", kind), ("in_run", f"{kind}_in_run")):
                size = float(getattr(components, what))
                add(f"{kind}.{name}", place, size**2 * by_one, size, unit)
        if len(self.blocks) == 2 and turns is not None:
            add("turn.gyro.noise", rotations, turns.covariance, typical_noise(turns.covariance), "rad")
            for name, size, unit, variance in (
                ("gyro.in_run", components.gyro_in_run, "rad/s", turns.duration**2),
                ("turn.scatter", components.turn, "rad", np.ones(len(turns))),
                ("aliased.scatter", components.aliased, "1", turns.aliased),
            ):
                add(name, rotations, size**2 * variance[:, None, None] * np.eye(3), size, unit)
            if integrals is not None:
                add("turn.gyro.noise", spare, integrals.covariance)
        g_u = self.observations.site.gravity_u
        add("gravity", gravity, np.array([[[g_u**2]]]), g_u, "m/s^2")
        budget = UncertaintyBudget(sources=(), covariances=np.empty((0, m, m)))
        for name, covariance in covariances.items():
            budget = budget.with_source(sources[name], covariance)
        return budget


def weak_north(off: float, north: float) -> str:
    """Return words on gyros that are off by a rate at rest, beside the northward Earth's rate, both rad/s."""
    size, found = off / DEGREE_PER_HOUR, north / DEGREE_PER_HOUR
    return f"gyros off by {size:.3g} °/h at rest, with {found:.3g} °/h of Earth's rate to find north by"


def iterated(
    observations: Observations, iterations: int = 2, *, method: PaperMethod, intervals: bool = True
) -> Estimate:
    """Estimate the parameters of a session from its start values by one or more passes of a method of the paper.

    With `intervals`, scatter and sizes of groups are integrated by `joint`; otherwise they are at the maximum. Raises
    InputError for a session without what the method needs."""
    if iterations < 1:
        raise InputError(f"iterations: expected at least 1, found {iterations}")
    session = _SessionData.of(observations, method)
    values, derivative, increments = session.passes(iterations)
    turned = session.turned(values)
    by_likelihood = converged_joint(observations, intervals and bool(observations.usual))
    if by_likelihood is None:  # groups leave a linear parameter undetermined
        by_likelihood = joint(replace(observations, usual={}), intervals=False)
    assert by_likelihood.budget is not None
    assert by_likelihood.linearised is not None
    budget = session.budget(derivative, by_likelihood.linearised.components)
    limit, settled = session.limit(values, turned, np.sqrt(np.diag(budget.covariances.sum(axis=0))))
    budget = budget.with_source(source("passes"), np.outer(limit - values, limit - values))
    dof = {each.name: each.dof for each in by_likelihood.budget.sources}
    budget = replace(budget, sources=tuple(replace(each, dof=dof.get(each.name)) for each in budget.sources))
    variances = np.diagonal(budget.covariances, axis1=1, axis2=2)
    degrees = np.array([each.dof or np.inf for each in budget.sources])
    by_scatter = (variances**2 / degrees[:, None]).sum(axis=0)
    accel, *gyro = session.blocks
    accel_model, names = accel.model(values[: len(accel.names)]), tuple(n for b in session.blocks for n in b.names)
    estimate = Estimate(
        method=session.method.name,
        names=names,
        units=units_of(names),
        values=values,
        covariance=budget.covariances.sum(axis=0),
        observable=np.ones(len(values), dtype=bool),
        null=np.empty((0, len(values))),
        accel=accel_model,
        gyro=gyro[0].model(values[len(accel.names) :]) if gyro else None,
        rest_residual=np.linalg.norm(accel_model.apply(observations.rests.accel), axis=1) - observations.site.gravity,
        rest_sigmas=by_likelihood.rest_sigmas,
        gyro_rest_sigmas=by_likelihood.gyro_rest_sigmas,
        turn_sigmas=by_likelihood.turn_sigmas,
        increments=increments,
        fits=by_likelihood.fits,
        converged=by_likelihood.converged,
        reasons=() if settled else (session.unsettled(by_likelihood.gyro),),
        linearised=by_likelihood.linearised,
        hyperparameters=by_likelihood.hyperparameters,
        degrees=np.divide(  # Welch, Satterthwaite
            variances.sum(axis=0) ** 2, by_scatter, out=np.full(len(values), np.inf), where=by_scatter > 0.0
        ),
        budget=budget,
    )
    if not observations.usual:
        return estimate
    problem, columns = group_columns(observations)
    return with_omitted_groups(estimate, problem, derivative @ columns, omitted_sizes(problem, by_likelihood))


sequential = partial(iterated, method=SEQUENTIAL)
"""Estimate with the sequential vector method for accelerometers."""
scalar = partial(iterated, method=SCALAR)
"""Estimate with the scalar method on all rests, in the estimated orientation."""
scalar_nominal = partial(iterated, method=SCALAR_NOMINAL)
"""The same in the orientation of the programme, with which the paper compares it."""
