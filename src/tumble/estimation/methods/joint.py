"""Joint method: maximum likelihood over everything a session contains.

All sensor parameters, the attitudes of all rests and local gravity are found at once from the rest means of both
blocks, the turns, the Earth's rate and the measured gravity (`tumble.estimation.likelihood`), by Gauss–Newton. The
table's angles are not used. The estimate reaches the Cramér–Rao bound.

Start, in closed form: verticals from nominal accelerometers; gyro parameters by one linear least-squares pass over the
rests and over the verticals that the turns carry (the indirect method); headings carried along each chain of turns, and
turned together by what the gyros see of the horizontal Earth's rate. A chain whose heading they hardly see (no better
than UNSEEN) keeps it where it is: it is still an unknown of every step, so that it takes nothing from the parameters.

Turns are integrated again about the current gyros wherever the second-order effect of the change since exceeds 1e-7 rad
or a hundredth of the turn's noise.

Scatter on top of the noise within rests: of the accelerometers and the gyros from rest to rest, and of the turns, each
where the residuals of its group are larger than expected (SCATTER_PROBABILITY); then it is what makes the
two equal. What is expected of a squared residual is its variance less what the fit takes, the leverage. A scatter of
the gyros lasts through the turn that follows.

What is seen: a parameter counts as determined when it is known DETERMINED times better than its spread, which is its
prior; so does a combination of parameters.

What fits: a rest or turn is judged by how much chi-square falls without it, rᵀ M⁻¹ r with M the covariance of its
residuals r after the fit, as Gaussian sigmas of the same probability (F where the scale is estimated too). One bad rest
of few hides behind the scatter it makes. So where a group scatters and one of it stands out before the scatter is
allowed for, everything is estimated again without it, and so on; then these are judged by what the others predict.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from scipy import special

from tumble.earth import EARTH_RATE
from tumble.estimation.elimination import carry
from tumble.estimation.estimate import DETERMINED, FIT_SIGMAS, Estimate, Fit, chance_of
from tumble.estimation.likelihood import (
    NO_PRIOR,
    Left,
    Point,
    Prior,
    Problem,
    Rows,
    Scatter,
    Step,
    TurnsAbout,
    Weights,
    left,
    linearise,
    solve,
    weights,
)
from tumble.reduction.observations import Observations
from tumble.rotation import skew
from tumble.sensors.model import SensorModel
from tumble.units import Array, BoolArray, IntArray

MAX_ITERATIONS = 30
CONVERGED = 1e-3  # of the standard uncertainty
SQUARED = 10.0  # error after a step, in units of the spreads, over the square of the step
SECOND_ORDER = 1e-7  # rad
SECOND_ORDER_SHARE = 0.01  # of the noise of a turn
UNSEEN = 0.2  # rad: a heading that the gyros know to no better
SCATTER_PROBABILITY = 0.25
"""Scatter is estimated where chance alone would exceed the chi-square of a group less often than this. There are three
groups: a limit at the median, as of the staged method, would find scatter in four of five sessions that have none, and
give intervals that cover too much; a strict one would miss scatter that is there."""
SCATTER_ROUNDS = 3
SCATTER_STEPS = 30
SCATTER_CONVERGED = 1e-2  # of the expected sum of squares
LEFT_OUT = 1e4  # times its noise: what a rest or turn that is left out has
FREE = 0.01  # of the variance of the noise: directions in which residuals have less say nothing
STANDS_OUT = 8.0  # times the median fall of chi-square of its group: of 15 without a bad one, 1 % have such a one
MOST_LEFT_OUT = 6
LEAST_CHANCE = 1e-300
ROUGH_TURN = 1e-2  # rad: what the start takes the turns to err by
ROUGH_EFFECT = 1e-3  # rad: second-order effect that the start puts up with

GROUPS = ("accelerometers", "gyro rests", "gyro turns")
TOTAL = "noise within rests"
"""The name of the fit of everything before any scatter."""


def joint(observations: Observations, *, prior: Prior = NO_PRIOR, robust: bool = False) -> Estimate:
    """All parameters of a session by maximum likelihood, with covariance and outcome. With `robust`, the estimate is
    that without the rests and turns that do not fit; their sigmas say which they are."""
    problem = Problem.of(observations, prior)
    at, first = _started(problem)
    everything = _fitted(problem, at, _Out.nothing(problem))
    fitting = _fitting(problem, everything)
    shown = fitting if robust else everything
    return _estimate(problem, shown, first + shown.increments, *_sigmas(fitting, everything.scatter))


# Which rests and turns count


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Out:
    """Rests (N,) and turns (K,) that are left out."""

    rest: BoolArray
    turn: BoolArray

    @staticmethod
    def nothing(problem: Problem) -> _Out:
        turns = problem.observations.turns
        return _Out(
            rest=np.zeros(len(problem.link), dtype=bool), turn=np.zeros(0 if turns is None else len(turns), dtype=bool)
        )

    def weights(self, problem: Problem, scatter: Scatter) -> Weights:
        """The weights of what is not left out."""
        all_of_them = weights(problem, scatter)
        if not (self.rest.any() or self.turn.any()):
            return all_of_them
        rest, turn = (np.where(out, 1.0 / LEFT_OUT, 1.0)[:, None, None] for out in (self.rest, self.turn))
        return Weights(rest=rest * all_of_them.rest, turn=turn * all_of_them.turn)


# The start


def _started(problem: Problem) -> tuple[_At, tuple[Array, ...]]:
    """A point near the solution, in closed form, and the step there from zero."""
    observations = problem.observations
    block, gyro_block = observations.accel_block, observations.gyro_block
    accel = observations.start_values(block)
    force = block.model(accel).apply(observations.rests.accel)
    vertical = force / np.linalg.norm(force, axis=1, keepdims=True)
    if gyro_block is None:
        about, gyro = None, np.empty(0)
    else:
        about, gyro = _started_gyros(problem, vertical)
    values = np.append(accel, gyro)
    attitudes = _headings(problem, vertical, values, about)
    point = Point(values=values, gravity=observations.site.gravity, attitudes=attitudes)
    return _At.of(problem, point, about), (values,)


def _started_gyros(problem: Problem, vertical: Array) -> tuple[TurnsAbout | None, Array]:
    """Gyro parameters from the means of the rests and the verticals that the turns carry, linearised once, and the
    turns integrated about them."""
    observations, up = problem.observations, problem.earth[1]
    block = observations.gyro_block
    assert block is not None
    values = observations.start_values(block)
    model = block.model(values)
    median = np.median(observations.rests.gyro, axis=0)
    values = block.parameters(SensorModel(matrix=model.matrix, bias=median))
    if observations.turns is None:
        return None, values
    about = TurnsAbout.of(observations, block.model(values))
    turns = about.turns
    derivative = np.einsum("ap,pqm->aqm", about.to_rate, block.jacobian(values))
    by_rate = np.einsum("kipq,pqm->kim", turns.M, derivative[:, :3]) + turns.B @ derivative[:, 3]
    back = np.einsum("kij,kj->ki", turns.C, vertical[turns.last])
    rate = (observations.rests.gyro - about.model.bias) @ about.to_rate.T
    by_rest = np.einsum("aqm,iq->iam", derivative[:, :3], up * vertical) + derivative[:, 3]
    spread = problem.spread[problem.accel_count :]
    jacobian = np.concatenate([
        (skew(back) @ by_rate).reshape(-1, len(values)) / ROUGH_TURN,
        by_rest.reshape(-1, len(values)) / EARTH_RATE,
        np.diag(1.0 / spread),
    ])  # fmt: skip
    residual = np.concatenate([
        (vertical[turns.first] - back).ravel() / ROUGH_TURN,
        (rate - up * vertical).ravel() / EARTH_RATE,
        np.zeros(len(values)),
    ])  # fmt: skip
    values = values + np.linalg.solve(jacobian.T @ jacobian, jacobian.T @ residual)
    now = block.model(values)
    return (about if np.all(_second_order(about, now) < ROUGH_EFFECT) else TurnsAbout.of(observations, now)), values


def _headings(problem: Problem, vertical: Array, values: Array, about: TurnsAbout | None) -> Array:
    """Attitudes (N, 3, 3) with these verticals. With N', E' the axes of a chain whose heading is any, the rates at
    rest are ω − Ω_U u = δ + a N' + s E', where the gyros still err by δ: linear in δ and in a and s of each chain."""
    observations, link = problem.observations, problem.link
    attitudes = np.empty((len(vertical), 3, 3))
    block = observations.gyro_block
    if about is None:
        C, turned = np.empty((0, 3, 3)), np.empty(0)
    else:
        C, turned = about.turns.C, about.turns.duration * problem.earth[1]
    carry(np.ascontiguousarray(vertical), np.ascontiguousarray(C), link, turned, attitudes)
    if block is None or problem.earth[0] == 0.0:
        return attitudes
    rate = problem.gyro_model(values).apply(observations.rests.gyro) - problem.earth[1] * vertical
    chain = problem.chain
    count = np.bincount(chain)
    level = attitudes[:, ::2]  # N' and E'
    seen = _sums(np.einsum("iab,ib->ia", level, rate), chain)
    axes = _sums(level.reshape(-1, 6), chain).reshape(-1, 2, 3)
    normal = len(rate) * np.eye(3) - np.einsum("cab,cad,c->bd", axes, axes, 1.0 / count)
    error = np.linalg.lstsq(normal, rate.sum(axis=0) - np.einsum("cab,ca,c->b", axes, seen, 1.0 / count), 1e-6)[0]
    heading = seen - axes @ error
    heading = (heading / np.linalg.norm(heading, axis=1, keepdims=True))[chain]
    north = np.einsum("ia,iab->ib", heading, level)
    return np.stack([north, vertical, np.cross(north, vertical)], axis=1)


def _sums(values: Array, chain: IntArray) -> Array:
    """Sums of rows (N, c) over the chains."""
    return np.asarray(np.add.reduceat(values, np.flatnonzero(np.diff(chain, prepend=-1)), axis=0))


# Gauss–Newton


@dataclass(frozen=True, kw_only=True, slots=True)
class _At:
    """A point, the turns about gyros near it, and the rows linearised there."""

    point: Point
    about: TurnsAbout | None
    rows: Rows

    @staticmethod
    def of(problem: Problem, point: Point, about: TurnsAbout | None) -> _At:
        return _At(point=point, about=about, rows=linearise(problem, point, about))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Solved:
    """The point where the iteration ended, the last step, where that began, and the changes of the parameters."""

    point: Point
    last: _At
    step: Step
    increments: tuple[Array, ...]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Fitted:
    """The solution with its scatter, what it leaves of the residuals with it and what without, the fits of the groups,
    and what was left out."""

    solved: _Solved
    left: Left
    without: Left
    scatter: Scatter
    out: _Out
    fits: Mapping[str, Fit]
    increments: tuple[Array, ...]


def _fitted(problem: Problem, start: _At, out: _Out) -> _Fitted:
    """The solution with the scatter that it shows."""
    scatter = Scatter()
    solved = _iterated(problem, start, out.weights(problem, scatter))
    without = after = left(problem, solved.step)
    increments = solved.increments
    for _ in range(SCATTER_ROUNDS):
        found = _scattered(problem, solved.last.rows, after, scatter, out)
        if found == scatter:
            break
        scatter = found
        solved = _iterated(problem, solved.last, out.weights(problem, scatter))  # the last step again, with scatter
        after = left(problem, solved.step)
        increments = increments[:-1] + solved.increments
    return _Fitted(
        solved=solved,
        left=after,
        without=without,
        scatter=scatter,
        out=out,
        fits=_fits(problem, after, scatter, without),
        increments=increments,
    )


def _iterated(problem: Problem, at: _At, weight: Weights) -> _Solved:
    """Gauss–Newton with these weights."""
    increments: list[Array] = []
    while True:
        step = solve(problem, at.rows, weight)
        point, moved = _moved(problem, at.point, step)
        increments.append(moved)
        about = _integrated(problem, point, at.about)
        if (_negligible(problem, step) and about is at.about) or len(increments) == MAX_ITERATIONS:
            return _Solved(point=point, last=at, step=step, increments=tuple(increments))
        at = _At.of(problem, point, about)


def _negligible(problem: Problem, step: Step) -> bool:
    """Whether what is left to do after a step is: Gauss–Newton squares the error, in units of the spreads."""
    change, u = np.abs(step.parameters[1:]), np.sqrt(np.diag(step.covariance)[1:])
    after = change * min(1.0, SQUARED * float(np.max(change / problem.spread)))
    return bool(np.all(after <= CONVERGED * u + 1e-15))


def _moved(problem: Problem, point: Point, step: Step) -> tuple[Point, Array]:
    """The point after a step, shortened so that no parameter moves by more than its spread, and the change of the
    parameters. Chains whose heading is hardly seen keep it."""
    share = 1.0 / max(1.0, float(np.max(np.abs(step.parameters[1:]) / problem.spread)))
    angles = share * step.angles
    n = problem.observations.accel_block.size
    seen = np.bincount(problem.chain, (step.whitened[0][:, n:, 2] ** 2).sum(axis=1))
    mean = np.bincount(problem.chain, angles[:, 2]) / np.bincount(problem.chain)
    angles[:, 2] -= np.where(seen < UNSEEN**-2, mean, 0.0)[problem.chain]
    return point.moved(share * step.parameters, angles), share * step.parameters[1:]


def _integrated(problem: Problem, point: Point, about: TurnsAbout | None) -> TurnsAbout | None:
    """The turns, integrated again if the gyros have moved too far since."""
    if about is None:
        return None
    now = problem.gyro_model(point.values)
    noise = np.sqrt(np.trace(about.turns.covariance, axis1=1, axis2=2) / 3.0)
    if np.all(_second_order(about, now) <= np.minimum(SECOND_ORDER, SECOND_ORDER_SHARE * noise)):
        return about
    return TurnsAbout.of(problem.observations, now)


def _second_order(about: TurnsAbout, now: SensorModel) -> Array:
    """About how much (K,), rad, the rotations about another model err, being of first order in the change."""
    E, offset = about.change(now)
    path = np.sqrt((about.turns.M**2).sum(axis=(1, 2, 3)))  # about the angle of the turn
    return np.asarray(0.5 * (np.linalg.norm(E) * path + np.linalg.norm(offset) * about.turns.duration) ** 2)


# Scatter


def _parts(after: Left) -> tuple[tuple[Array, Array], ...]:
    """Residuals and their covariances of the groups, in the order of GROUPS."""
    return after.accel, after.gyro, after.turn


def _scattered(problem: Problem, rows: Rows, after: Left, start: Scatter, out: _Out) -> Scatter:
    """The scatter that makes the squares of each group that has one what they are expected to be: steps of Fisher
    scoring, at one linearisation. `after` is what the solution with the scatter `start` leaves."""
    variance = np.array([start.accel, start.gyro, start.turn]) ** 2
    scatter, active = start, variance > 0.0
    if not active.any():
        active = np.array([_chance(part) < SCATTER_PROBABILITY for part in _parts(after)])
    weight = out.weights(problem, start)
    for _ in range(SCATTER_STEPS):
        squares, expected = np.array([_squares(part) for part in _parts(after)]).T
        off = active & (np.abs(squares - expected) > SCATTER_CONVERGED * expected)
        if not np.any(off & ((variance > 0.0) | (squares > expected))):
            break
        gains = _inverse_variances(problem, weight)
        gain = np.array([(_variances(part) * g).sum() for part, g in zip(_parts(after), gains, strict=True)])
        change = (squares - expected) / np.where(gain > 0.0, gain, np.inf)
        variance = np.where(active, np.maximum(variance + change, 0.0), 0.0)
        accel, gyro, turn = np.sqrt(variance).tolist()
        scatter = Scatter(accel=accel, gyro=gyro, turn=turn)
        weight = out.weights(problem, scatter)
        after = left(problem, solve(problem, rows, weight))
    return scatter


def _squares(part: tuple[Array, Array]) -> tuple[float, float]:
    """Sum of the squares of a group, and what is expected of it."""
    return float((part[0] ** 2).sum()), float(_variances(part).sum())


def _variances(part: tuple[Array, Array]) -> Array:
    """Variances of the residuals of a group."""
    return np.diagonal(part[1], axis1=1, axis2=2)


def _chance(part: tuple[Array, Array]) -> float:
    """Probability that chance alone exceeds the chi-square of a group; 1 where nothing is left to judge by."""
    squares, expected = _squares(part)
    return chance_of(squares, expected) if expected > 0.5 else 1.0


def _inverse_variances(problem: Problem, weight: Weights) -> Iterator[Array]:
    """Inverse variances of the rows of each group."""
    n = problem.observations.accel_block.size
    stop = n + problem.observations.rests.gyro.shape[1]
    rest, turn = (weight.rest**2).sum(axis=2), (weight.turn**2).sum(axis=2)
    yield from (rest[:, :n], rest[:, n:stop], turn)


def _fits(problem: Problem, after: Left, scatter: Scatter, without: Left) -> dict[str, Fit]:
    """Chi-square of every group there is, and of everything with the noise within rests alone."""
    found = zip(
        GROUPS, _parts(after), (scatter.accel, scatter.gyro, scatter.turn), ("m/s^2", "rad/s", "rad"), strict=True
    )
    out = {name: _fit([part], value, unit) for name, part, value, unit in found}
    if problem.observations.gyro_block is None:
        out = {GROUPS[0]: out[GROUPS[0]]}
    return out | {TOTAL: _fit(list(_parts(without)), 0.0, "")}


def _fit(parts: list[tuple[Array, Array]], scatter: float, unit: str) -> Fit:
    squares, expected = np.sum([_squares(part) for part in parts], axis=0).tolist()
    return Fit(chi_square=squares, degrees=expected, scatter=scatter, scatter_unit=unit)


# What fits


def _drops(part: tuple[Array, Array], left_out: BoolArray) -> tuple[Array, Array]:
    """By how much chi-square falls without each rest or turn of a group, and the number of directions in which it has
    residuals; of those that are left out, the chi-square of their readings about what all others predict."""
    residual, covariance = part
    variance, directions = np.linalg.eigh(covariance)
    seen = (variance > FREE) | left_out[:, None]
    share = np.where(seen, variance, 1.0)
    square = np.einsum("ia,iab->ib", residual, directions) ** 2
    predicted = LEFT_OUT**2 / share**2 / (1.0 + LEFT_OUT**2 * np.maximum(1.0 / share - 1.0, 0.0))
    drop = square * np.where(left_out[:, None], predicted, 1.0 / share)
    return np.where(seen, drop, 0.0).sum(axis=1), seen.sum(axis=1)


def _groups(fitted: _Fitted) -> Iterator[tuple[tuple[Array, Array], tuple[Array, Array], BoolArray, float, float]]:
    """Of every group: its residuals with and without scatter, what of it is left out, its scatter and its degrees of
    freedom."""
    out, scatter = fitted.out, fitted.scatter
    for name, part, before, left_out, value in zip(
        GROUPS,
        _parts(fitted.left),
        _parts(fitted.without),
        (out.rest, out.rest, out.turn),
        (scatter.accel, scatter.gyro, scatter.turn),
        strict=True,
    ):
        yield part, before, left_out, value, fitted.fits[name].degrees if name in fitted.fits else 0.0


def _sigmas(fitted: _Fitted, scatter: Scatter) -> tuple[Array, Array]:
    """How far each rest (N,) and turn (K,) is from the fit, in sigmas: a rest by the worse of its blocks. Groups that
    have a `scatter` when nothing is left out are judged by their own scale: that they have none without some of them
    may be by choice of these."""
    found = []
    scales = (scatter.accel, scatter.gyro, scatter.turn)
    for (part, _, left_out, _, degrees), scale in zip(_groups(fitted), scales, strict=True):
        drop, count = _drops(part, left_out)
        k = np.maximum(count, 1)
        others = np.maximum(degrees - k * max(1, left_out.sum()), 1.0)  # what was chosen has taken the largest with it
        chance = special.fdtrc(k, others, drop / k) if scale > 0.0 else special.chdtrc(k, drop)
        found.append(-special.ndtri(0.5 * np.maximum(chance, LEAST_CHANCE)))
    accel, gyro, turn = found
    return np.maximum(accel, gyro), turn


def _suspect(fitted: _Fitted) -> _Out | None:
    """With the rest or turn left out too that stands out most among those of a group that scatters, before the scatter
    is allowed for; None where none does."""
    most, found = STANDS_OUT, None
    for group, (_, before, left_out, scatter, _) in enumerate(_groups(fitted)):
        if scatter == 0.0:
            continue
        drop, count = _drops(before, left_out)
        judged = (count > 0) & ~left_out
        if judged.sum() < 3:
            continue
        size = np.where(judged, drop / np.maximum(count, 1), 0.0)
        ratio = size / np.median(size[judged])
        worst = int(np.argmax(ratio))
        if ratio[worst] > most:
            most, found = float(ratio[worst]), (group, worst)
    if found is None:
        return None
    rest, turn = fitted.out.rest.copy(), fitted.out.turn.copy()
    (turn if found[0] == 2 else rest)[found[1]] = True
    return _Out(rest=rest, turn=turn)


def _fitting(problem: Problem, everything: _Fitted) -> _Fitted:
    """The fit without what does not fit. Suspects are left out one after the other, for they hide each other; those
    that the others confirm stay out."""
    fitted = everything
    for _ in range(MOST_LEFT_OUT):
        suspect = _suspect(fitted)
        if suspect is None:
            break
        fitted = _again(problem, fitted, suspect)
    if fitted is everything:
        return everything
    rest, turn = _sigmas(fitted, everything.scatter)
    confirmed = _Out(rest=fitted.out.rest & (rest > FIT_SIGMAS), turn=fitted.out.turn & (turn > FIT_SIGMAS))
    count = confirmed.rest.sum() + confirmed.turn.sum()
    if count == 0:
        return everything
    if count == fitted.out.rest.sum() + fitted.out.turn.sum():
        return fitted
    return _again(problem, fitted, confirmed)


def _again(problem: Problem, fitted: _Fitted, out: _Out) -> _Fitted:
    """The fit with something else left out."""
    return _fitted(problem, _At.of(problem, fitted.solved.point, fitted.solved.last.about), out)


def _estimate(
    problem: Problem,
    fitted: _Fitted,
    increments: tuple[Array, ...],
    rest_sigmas: Array,
    turn_sigmas: Array,
) -> Estimate:
    observations = problem.observations
    blocks = [b for b in (observations.accel_block, observations.gyro_block) if b is not None]
    values, covariance = fitted.solved.point.values, fitted.solved.step.covariance[1:, 1:]
    variance, combinations = np.linalg.eigh(covariance / np.outer(problem.spread, problem.spread))
    accel = problem.accel_model(values)
    force = accel.apply(observations.rests.accel)
    return Estimate(
        method="joint",
        names=tuple(name for block in blocks for name in block.names),
        units=tuple(unit for block in blocks for unit in block.units),
        values=values,
        covariance=covariance,
        observable=np.sqrt(np.diag(covariance)) < problem.spread / DETERMINED,
        null=combinations[:, variance > DETERMINED**-2].T,
        accel=accel,
        gyro=None if observations.gyro_block is None else problem.gyro_model(values),
        rest_residual=np.linalg.norm(force, axis=1) - observations.site.gravity,
        rest_sigmas=rest_sigmas,
        turn_sigmas=turn_sigmas,
        increments=increments,
        fits=fitted.fits,
        converged=_negligible(problem, fitted.solved.step),
    )
