"""Joint method: maximum likelihood over everything a session contains.

All parameters of the instrument, the attitudes of all rests and local gravity are found at once from the rest means of
both blocks, the rotations and velocities of the turns, the Earth's rate and the measured gravity
(`tumble.estimation.likelihood`), by Gauss–Newton. The table's angles are not used. The estimate reaches the Cramér–Rao
bound.

Start, in closed form: verticals from nominal accelerometers; gyro parameters by one linear least-squares pass over the
rests and over the verticals that the turns carry (the indirect method); headings carried along each chain of turns, and
turned together by what the gyros see of the horizontal Earth's rate. A chain whose heading they hardly see (no better
than UNSEEN) keeps it where it is: it is still an unknown of every step, so that it takes nothing from the parameters.

Turns are integrated again about the current parameters wherever the second-order effect of the change since counts
(`TurnsAbout.good_for`).

Groups beyond the linear model are all kept, each with a prior of its usual size (dynamics method, A4). A prior that the
data exceed is widened, never narrowed:

    λ² ← max(1, mean of (ĉ² + Var ĉ)/s²),   s ← λ s   until it settles                                            (A4)

Scatter on top of the noise within rests is estimated by restricted maximum likelihood (A3): with D = ∂Σ/∂σ², P the
projector onto residuals, score ½(rᵀPDPr − tr PD), information ½ tr PDPD of which the part within a rest and its turn is
taken. A component counts where chance alone would exceed its score less often than SCATTER_PROBABILITY.

How many degrees of freedom stand behind a u is by Welch–Satterthwaite: ν = 2 u⁴ / Var(u²), with the variance from that
of the components of scatter.

What is seen: a parameter of the linear model counts as determined when it is known DETERMINED times better than its
limit; so does a combination of them.

What fits: a rest or turn is judged by how much chi-square falls without it, as Gaussian sigmas of the same
probability (F where the scale is estimated too). One bad rest of few hides behind the scatter it makes. So where a
group scatters and one of it stands out before the scatter is allowed for, everything is estimated again without it,
and so on; then these are judged by what the others predict.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy import special

from tumble.earth import EARTH_RATE
from tumble.estimation.common_errors import common_covariance
from tumble.estimation.elimination import carry, fold, score
from tumble.estimation.estimate import DETERMINED, FIT_SIGMAS, Estimate, Fit, GroupFinding, OwnEstimate
from tumble.estimation.likelihood import (
    COMPONENTS,
    NO_PRIOR,
    Linearised,
    Noise,
    Point,
    Prior,
    Problem,
    Rows,
    Scatter,
    Weights,
    at_reference,
    instruments_of,
    linearise,
    noise_of,
    priors,
)
from tumble.estimation.prediction import prediction
from tumble.estimation.step import Left, Step, joined, left, solve, tell, variance_slopes
from tumble.estimation.turns_about import TurnsAbout
from tumble.reduction.observations import Observations
from tumble.rotation import skew
from tumble.sensors.compensation import specific_force
from tumble.sensors.instrument import Instrument
from tumble.sensors.model import SensorModel
from tumble.units import Array, BoolArray, IntArray

MAX_ITERATIONS = 30
CONVERGED = 1e-3  # of the standard uncertainty
SQUARED = 10.0  # error after a step, in units of the spreads, over the square of the step
UNSEEN = 0.2  # rad: a heading that the gyros know to no better
SCATTER_PROBABILITY = 0.25
"""A component of scatter is estimated where chance alone would exceed its score less often than this. A limit at the
median would find scatter in most sessions that have none, and give intervals that cover too much; a strict one would
miss scatter that is there."""
ROUNDS = 6
ALL_STEPS = MAX_ITERATIONS * (ROUNDS + 2)  # more than there can be
QUICK_STEPS = 20
"""Steps that the fit of a quick estimate may take: that of a sound session takes ten."""
SCATTER_STEPS = 40
SCATTER_CONVERGED = 0.02  # of the standard deviation of a component of variance
FURTHEST = 1e3  # of it, that a step may go: two components that nearly are one would send each other anywhere
LEAST_DEGREES = 0.5
"""Of freedom: a component of scatter of which the fit leaves less is not estimated. It is by what is left of it, in the
end by rounding, that its variance would be divided."""
SHARES = (0.25, 3.0)  # what a step of scoring may be of that by the information
WIDENING_STEPS = 50
LAGS = (0.0, 10.0, 25.0, 50.0, 100.0, 200.0, 400.0, 800.0, -25.0, -100.0)
"""s: time constants of the sensors behind the thermometer from which the best is sought."""
LAG_HELD = 1e-3  # s
LAG_GRID = np.linspace(-5.0, 8.0, 20)
"""Lags at which the likelihood is taken, in units of u from the maximum: of a Gaussian, sums in steps of one u have its
mean and spread to 1e-8."""
_APART = np.concatenate([[0.5], 2.0 ** np.arange(0.0, 9.5, 0.5)])
LAGS_ABOUT = np.concatenate([-_APART[::-1], [0.0], _APART])
"""s: the same from a lag of which Gauss–Newton does not say how well it is known."""
LESS_LIKELY = 6.0
"""−2 log of the likelihoods of two lags: the first is taken for a wrong one."""
UNEXPLAINED = 1e-4
"""Where chance alone exceeds all residuals, by the noise within rests, less often, a warm-up is looked for."""
WARM_UPS = np.geomspace(0.03, 1.0, 11)
"""Its time constants that are tried, in parts of the session; the first and the last belong to none."""
NEAR = 0.2
"""A change of the logarithm of a time constant over which its likelihood is a parabola."""
FARTHEST = 0.5
"""And the largest change by one parabola."""
SETTLED_TO = 0.2
"""Of its u: by how much it may still move."""
WARM_UP_ROUNDS = 5
TIME_CONSTANT_KNOWN = 0.5
"""u of the logarithm of a time constant: what is known less well is no warm-up that is seen."""
EVIDENT = 40.0
"""−2 log of the likelihood without a warm-up over that with it: beyond doubt."""
WIDENED = 1.01  # λ of a step that counts as settled
KEPT = 1e-3  # learned fraction of a group that the session says anything of
LEFT_OUT = 1e6  # times its variance: what a rest or turn that is left out has on top
FREE = 0.01  # of the variance of the noise: directions in which residuals have less say nothing
ROUNDED = 1e-9  # of the largest: directions of a projector below it are rounding
STANDS_OUT = 8.0  # times the median fall of chi-square of its group: of 15 without a bad one, 1 % have such a one
MOST_LEFT_OUT = 6
QUICK_LEFT_OUT = 1
"""Rests and turns that a quick estimate leaves out at most: each costs as much as the estimate with them."""
LEAST_CHANCE = 1e-300
ROUGH_TURN = 1e-2  # rad: what the start takes the turns to err by
ROUGH_EFFECT = 1e-3  # rad: second-order effect that the start puts up with
MOST_DEGREES = 1e6

GROUPS = ("accelerometers", "gyro rests", "gyro turns", "velocities of turns")
SCATTER_OF = ("accel", "gyro", "turn", "velocity")
SCATTER_UNITS = ("m/s^2", "rad/s", "rad", "m/s")
TOTAL = "noise within rests"
"""The name of the fit of everything before any scatter."""


def joint(
    observations: Observations,
    *,
    prior: Prior = NO_PRIOR,
    robust: bool = False,
    instrument: Instrument | None = None,
    quick: bool = False,
) -> Estimate:
    """All parameters of a session by maximum likelihood, with covariance and outcome. The `instrument` says which;
    where None, the groups whose usual size the observations know. With `robust`, the estimate is that without the
    rests and turns that do not fit; their sigmas say which they are. A `quick` one ends after
    QUICK_STEPS, settled or not; of what does not fit it looks for QUICK_LEFT_OUT, where it has not settled for nothing:
    it is for a page that follows a session and cannot wait for one that contradicts itself."""
    usual, own = instruments_of(observations)
    instrument = instrument or usual
    problem = Problem.of(observations, prior, instrument=instrument, own=own, usual=observations.usual)
    at, first = _started(problem)
    at = _with_lag(problem, at)
    everything = _fitted_with_lag(problem, at, QUICK_STEPS if quick else ALL_STEPS)
    if not quick and own is None:
        everything = _with_warm_up(everything, problem)
    most = (QUICK_LEFT_OUT if everything.settled else 0) if quick else MOST_LEFT_OUT
    fitting = _fitting(everything, most)
    shown = _with_posterior(fitting if robust else everything, problem)
    return _estimate(shown, first + shown.increments, _sigmas(fitting, everything.scatter))


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

    def noise(self, problem: Problem, rows: Rows) -> Noise:
        """The noise of the rows, large where they are left out."""
        noise = noise_of(problem, rows)
        if not (self.rest.any() or self.turn.any()):
            return noise
        rest, merged, r = noise.rest.copy(), noise.merged.copy(), noise.rest.shape[1]
        rest[self.rest] += LEFT_OUT * _diagonals(rest[self.rest])
        if len(merged):
            turns = problem.observations.turns
            assert turns is not None
            more = LEFT_OUT * _diagonals(merged)
            more[:, :r] *= self.rest[turns.first][:, None, None]
            more[:, r:] *= self.turn[:, None, None]
            merged += more
        return replace(noise, rest=rest, merged=merged)


def _diagonals(matrices: Array) -> Array:
    """The diagonals of matrices (N, n, n), as matrices."""
    return np.asarray(matrices * np.eye(matrices.shape[1]))


# The start


def _started(problem: Problem) -> tuple[_At, tuple[Array, ...]]:
    """A point near the solution, in closed form, and the step there from zero."""
    observations, instrument = problem.observations, problem.instrument
    values = problem.measured[0][1:].copy()
    force = problem.accel_model(values).apply(observations.rests.accel)
    vertical = force / np.linalg.norm(force, axis=1, keepdims=True)
    about = None
    if instrument.gyro is not None:
        about, values[instrument.own(instrument.gyro)] = _started_gyros(problem, values, vertical)
    attitudes = headings(problem, vertical, values, about)
    own = np.zeros((len(problem.parts), len(problem.own_known)))
    point = Point(values=values, gravity=observations.site.gravity, attitudes=attitudes, own=own)
    return _At.of(problem, point, about, _Out.nothing(problem)), (values,)


def _started_gyros(problem: Problem, values: Array, vertical: Array) -> tuple[TurnsAbout | None, Array]:
    """Gyro parameters from the means of the rests and the verticals that the turns carry, linearised once, and the
    turns integrated about them."""
    observations, up, instrument = problem.observations, problem.earth[1], problem.instrument
    block = instrument.gyro
    assert block is not None
    own = instrument.own(block)
    model = block.model(values[own])
    median = np.median(observations.rests.gyro, axis=0)
    started = values.copy()
    started[own] = block.parameters(SensorModel(matrix=model.matrix, bias=median))
    turns = observations.turns
    if turns is None:
        return None, started[own]
    about = TurnsAbout.of(observations, instrument, started)
    derivative = np.einsum("ap,pqm->aqm", about.to_rate, block.jacobian(started[own]))
    by_turn = about.columns(instrument, started)[0][:, :, own]
    back = np.einsum("kij,kj->ki", about.C, vertical[turns.last])
    rate = (observations.rests.gyro - median) @ about.to_rate.T
    by_rest = np.einsum("aqm,iq->iam", derivative[:, :3], up * vertical) + derivative[:, 3]
    count = by_turn.shape[2]
    jacobian = np.concatenate([
        (skew(back) @ by_turn).reshape(-1, count) / ROUGH_TURN,
        by_rest.reshape(-1, count) / EARTH_RATE,
        np.diag(1.0 / problem.spread[own]),
    ])  # fmt: skip
    residual = np.concatenate([
        (vertical[turns.first] - back).ravel() / ROUGH_TURN,
        (rate - up * vertical).ravel() / EARTH_RATE,
        np.zeros(count),
    ])  # fmt: skip
    started[own] += np.linalg.solve(jacobian.T @ jacobian, jacobian.T @ residual)
    near = bool(np.all(about.second_order(instrument, started)[0] < ROUGH_EFFECT))
    return (about if near else TurnsAbout.of(observations, instrument, started)), started[own]


def headings(problem: Problem, vertical: Array, values: Array, about: TurnsAbout | None) -> Array:
    """Attitudes (N, 3, 3) with these verticals. With N', E' the axes of a chain whose heading is any, the rates at
    rest are ω − Ω_U u = δ + a N' + s E', where the gyros still err by δ: linear in δ and in a and s of each chain."""
    observations, link = problem.observations, problem.link
    attitudes = np.empty((len(vertical), 3, 3))
    turns = observations.turns
    if about is None or turns is None:
        C, turned = np.empty((0, 3, 3)), np.empty(0)
    else:
        C, turned = about.C, turns.duration * problem.earth[1]
    carry(np.ascontiguousarray(vertical), np.ascontiguousarray(C), link, turned, attitudes)
    if observations.gyro_block is None or problem.earth[0] == 0.0:
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


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _At:
    """A point, the turns about parameters near it, the rows linearised there, and their noise, large where they are
    `out`."""

    point: Point
    about: TurnsAbout | None
    rows: Rows
    noise: Noise
    out: _Out

    @staticmethod
    def of(problem: Problem, point: Point, about: TurnsAbout | None, out: _Out) -> _At:
        rows = linearise(problem, point, about)
        return _At(point=point, about=about, rows=rows, noise=out.noise(problem, rows), out=out)

    def solved(self, problem: Problem, scatter: Scatter) -> Step:
        """The least-squares step from here with a scatter."""
        return solve(problem, self.rows, self.noise.weights(scatter))

    def with_priors(self, problem: Problem) -> _At:
        """The same with the priors of a problem."""
        return replace(self, rows=self.rows.with_priors(problem, self.point, self.about))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Solved:
    """The point where the iteration ended, the last step, where that began, and the changes of the parameters."""

    point: Point
    last: _At
    step: Step
    increments: tuple[Array, ...]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Fitted:
    """The solution of a problem, whose priors are as wide as the data ask for: with its scatter, what it leaves of the
    residuals with scatter and what without, each with the weights, the covariance of the variances of the scatter, and
    whether it `settled` within its steps."""

    problem: Problem
    solved: _Solved
    left: tuple[Left, Weights]
    without: tuple[Left, Weights]
    scatter: Scatter
    components: Array
    fits: Mapping[str, Fit]
    increments: tuple[Array, ...]
    settled: bool

    @property
    def out(self) -> _Out:
        """What was left out."""
        return self.solved.last.out


def _fitted(problem: Problem, start: _At, most: int = ALL_STEPS) -> _Fitted:
    """The solution with the scatter that it shows, after so many steps at most."""
    scatter, components, wide = Scatter(), np.zeros((len(COMPONENTS), len(COMPONENTS))), problem
    solved = _iterated(problem, start, scatter, most)
    increments, steps = solved.increments, len(solved.increments)
    after = without = left(problem, solved.step), solved.step.weights
    seen = _seen(problem, solved.last.noise, *without)
    for _ in range(ROUNDS):
        at = solved.last
        found, components = _scattered(wide, at, scatter, seen)
        wider = _widened(wide, at, found)
        if (found == scatter and wider is wide) or steps >= most:
            break
        settled, wide, scatter = wider is wide, wider, found
        solved = _iterated(wide, at.with_priors(wide), scatter, most - steps)  # the last step again, with scatter
        increments, steps = increments[:-1] + solved.increments, steps + len(solved.increments)
        after = left(wide, solved.step), solved.step.weights
        if settled and len(solved.increments) == 1:
            break
    return _Fitted(
        problem=wide,
        solved=solved,
        left=after,
        without=without,
        scatter=scatter,
        components=components,
        fits=_fits(wide, after[0], scatter, without[0]),
        increments=increments,
        settled=steps < most,
    )


def _iterated(problem: Problem, at: _At, scatter: Scatter, most: int = MAX_ITERATIONS) -> _Solved:
    """Gauss–Newton with this scatter, by so many steps at most."""
    increments: list[Array] = []
    while True:
        step = at.solved(problem, scatter)
        point, change = moved(problem, at.point, step)
        increments.append(change)
        about = integrated(problem, point, at.about)
        if (_negligible(problem, step) and about is at.about) or len(increments) == min(most, MAX_ITERATIONS):
            return _Solved(point=point, last=at, step=step, increments=tuple(increments))
        at = _At.of(problem, point, about, at.out)


def _negligible(problem: Problem, step: Step) -> bool:
    """Whether what is left to do after a step is: Gauss–Newton squares the error, in units of the spreads."""
    change, u = np.abs(step.parameters[1:]), np.sqrt(np.diag(step.covariance)[1:])
    after = change * min(1.0, SQUARED * float(np.max(change / problem.spread)))
    return bool(np.all(after <= CONVERGED * u + 1e-15))


def moved(problem: Problem, point: Point, step: Step) -> tuple[Point, Array]:
    """The point after a step, shortened so that no parameter moves by more than its spread, and the change of the
    parameters. Chains whose heading is hardly seen keep it."""
    share = 1.0 / max(1.0, float(np.max(np.abs(step.parameters[1:]) / problem.spread)))
    angles = share * step.angles
    seen = np.bincount(problem.chain, _heading_information(problem, step))
    mean = np.bincount(problem.chain, angles[:, 2]) / np.bincount(problem.chain)
    angles[:, 2] -= np.where(seen < UNSEEN**-2, mean, 0.0)[problem.chain]
    return point.moved(share * step.parameters, angles, share * step.own), share * step.parameters[1:]


def _heading_information(problem: Problem, step: Step) -> Array:
    """What the gyros of each rest (N,) say of its heading, rad⁻²."""
    rest, merged = step.whitened
    n, r = problem.observations.accel_block.size, rest.shape[1]
    own = (rest[:, n:, 2] ** 2).sum(axis=1)
    linked = problem.link >= 0
    own[linked] = (merged[problem.link[linked], n:r, 2] ** 2).sum(axis=1)
    return np.asarray(own)


def integrated(problem: Problem, point: Point, about: TurnsAbout | None) -> TurnsAbout | None:
    """The turns, integrated again if the parameters have moved too far since."""
    turns = problem.observations.turns
    if about is None or turns is None:
        return None
    noise = np.sqrt(np.trace(turns.covariance, axis1=1, axis2=2) / 3.0)
    velocity = np.sqrt(np.trace(turns.velocity_covariance, axis1=1, axis2=2) / 3.0)
    if not problem.instrument.in_velocities:
        velocity = np.full_like(velocity, np.inf)
    changes = problem.changed_in_turns(point)
    if changes is not None and about.small(changes[0], (noise, velocity)):
        changes = None
    gyro_changes = 0.0 if changes is None else changes[0]
    if about.good_for(problem.instrument, point.values, (noise, velocity), gyro_changes):
        return about
    return TurnsAbout.of(problem.observations, problem.instrument, point.values, changes)


# Scatter


def _seen(problem: Problem, noise: Noise, after: Left, weight: Weights) -> BoolArray:
    """Whether a fit leaves something of each component (5,) of scatter."""
    degrees, last = np.zeros(len(COMPONENTS)), problem.link < 0
    at_rest, of_rest = noise.rest_directions
    rows = (weight.rest[last], after.rest[1][last]), (weight.merged, after.merged[1])
    for (W, covariance), (Z, of) in zip(rows, ((at_rest[last], of_rest), noise.merged_directions), strict=True):
        WZ = W @ Z
        whole, left_of = (WZ**2).sum(axis=1), (WZ * (covariance @ WZ)).sum(axis=1)
        np.add.at(degrees, of, (left_of / np.where(whole > 0.0, whole, 1.0)).sum(axis=0))
    return np.asarray(degrees > LEAST_DEGREES)


def _scattered(problem: Problem, at: _At, start: Scatter, seen: BoolArray) -> tuple[Scatter, Array]:
    """The components of scatter that are `seen` (5,) by restricted maximum likelihood at one linearisation, from a
    start, and the covariance (5, 5) of their variances: steps of Fisher scoring, halved while the likelihood falls. The
    information lacks what rests and turns tell of each other: `share` is the part that it was of how the score fell in
    the step before."""
    variance, share = start.variances, 1.0
    active = variance > 0.0
    deviance, slope, information = _scored(problem, at, variance)
    if not active.any():
        size = np.sqrt(np.where(np.diag(information) > 0.0, np.diag(information), np.inf))
        active = seen & (slope / size > -special.ndtri(SCATTER_PROBABILITY))
    for _ in range(SCATTER_STEPS):
        active &= (variance > 0.0) | (slope > 0.0)
        if not active.any():
            break
        index = np.ix_(active, active)
        change = np.zeros_like(variance)
        change[active] = share * np.linalg.solve(information[index], slope[active])
        deviation = np.where(active, 1.0 / np.sqrt(np.where(active, np.diag(information), 1.0)), np.inf)
        wanted = np.clip(variance + change, 0.0, variance + FURTHEST * deviation)
        before, above = variance, slope
        for _ in range(5):
            variance = wanted
            found = _scored(problem, at, variance)
            if found[0] <= deviance + 1e-6:
                break
            wanted = 0.5 * (wanted + before)
        deviance, slope, information = found
        change = np.where(active, variance - before, 0.0)
        if np.all(np.abs(change) <= SCATTER_CONVERGED * deviation):
            break
        expected, fallen = change @ information @ change, change @ (above - slope)
        share = float(np.clip(expected / fallen, *SHARES)) if fallen > 0.0 else SHARES[1]
    active = variance > 0.0
    components = np.zeros((len(COMPONENTS), len(COMPONENTS)))
    if active.any():
        components[np.ix_(active, active)] = np.linalg.inv(information[np.ix_(active, active)])
    return Scatter.of_variances(variance), components


def _scored(problem: Problem, at: _At, variance: Array) -> tuple[float, Array, Array]:
    """−2 log of the restricted likelihood, its score (5,) and information (5, 5) with respect to the variances."""
    step = at.solved(problem, Scatter.of_variances(variance))
    after, weight, last = left(problem, step), step.weights, problem.link < 0
    slope, information = np.zeros(len(variance)), np.zeros((len(variance),) * 2)
    (at_rest, of_rest), (Z, of_merged) = at.noise.rest_directions, at.noise.merged_directions
    score(weight.rest[last] @ at_rest[last], of_rest, (after.rest[0][last], after.rest[1][last]), slope, information)
    score(weight.merged @ Z, of_merged, after.merged, slope, information)
    return step.deviance, slope, information


# The lag


def _with_lag(problem: Problem, at: _At) -> _At:
    """The start with the best of LAGS. The sum of squares over the lag, which multiplies the coefficients over
    temperature, has several minima: everything else is found at none, and from there that of each in one step."""
    if problem.lag is None:
        return at
    solved = _iterated(_held(problem, 0.0), at, Scatter())
    at = _At.of(problem, solved.point, solved.last.about, at.out)
    tried = [_at_lag(problem, at, lag, Scatter()) for lag in LAGS]
    best = min(range(len(LAGS)), key=lambda i: tried[i].square + _prior_of_lag(problem, LAGS[i]))
    step = tried[best]
    point = _point_of(solved.point.moved(step.parameters, step.angles, step.own), problem.lag, LAGS[best])
    return _At.of(problem, point, solved.last.about, at.out)


def _prior_of_lag(problem: Problem, lag: float) -> float:
    """What the prior adds to the sum of squares."""
    assert problem.lag is not None
    expected, u = (values[1 + problem.lag] for values in problem.measured)
    return float(((lag - expected) / u) ** 2)


def _held(problem: Problem, lag: float) -> Problem:
    """The problem with a lag that is known."""
    assert problem.lag is not None
    expected, u = (values.copy() for values in problem.measured)
    expected[1 + problem.lag], u[1 + problem.lag] = lag, LAG_HELD
    return replace(problem, measured=(expected, u), lag_known=True)


def _point_of(point: Point, where: int, lag: float) -> Point:
    """A point with another lag."""
    values = point.values.copy()
    values[where] = lag
    return replace(point, values=values)


def _at_lag(problem: Problem, at: _At, lag: float, scatter: Scatter) -> Step:
    """The step from a point to the solution with a lag."""
    assert problem.lag is not None
    held = _held(problem, lag)
    return _At.of(held, _point_of(at.point, problem.lag, lag), at.about, at.out).solved(held, scatter)


def _fitted_with_lag(problem: Problem, start: _At, most: int) -> _Fitted:
    """The solution with the scatter that it shows; with the lag of the start where Gauss–Newton has left it for one
    that is much less likely. In an exponential warm-up the lag shows by its square alone: the steps do not know it."""
    fitted = _fitted(problem, start, most)
    if problem.lag is None:
        return fitted
    at = _At.of(fitted.problem, fitted.solved.point, fitted.solved.last.about, fitted.out)
    lags = float(start.point.values[problem.lag]), float(fitted.solved.point.values[problem.lag])
    started, found = (
        _at_lag(fitted.problem, at, lag, fitted.scatter).deviance + _prior_of_lag(problem, lag) for lag in lags
    )
    return fitted if found < started + LESS_LIKELY else _fitted(_held(problem, lags[0]), start, most)


def _with_posterior(fitted: _Fitted, free: Problem) -> _Fitted:
    """The fit with the lag at the mean of what is known of it, and its spread in all uncertainties: with the
    solutions θ(λ), of spread C(λ),

        C = C(λ) + E[(θ(λ) − E θ)(θ(λ) − E θ)ᵀ]                                                                   (A5)

    Where a session hardly shows the lag, its likelihood is no parabola, and mean and spread are not those of the
    maximum. A lag that the session says nothing of stays what it is. In the problem `free` the lag is an unknown."""
    solved = fitted.solved
    if free.lag is None:
        return fitted
    where, expected = 1 + free.lag, free.measured[1]
    u = float(np.sqrt(solved.step.covariance[where, where]))
    if not fitted.problem.lag_known and 1.0 - (u / expected[where]) ** 2 < KEPT:
        return fitted
    grid = LAGS_ABOUT if fitted.problem.lag_known else u * LAG_GRID
    lags = solved.point.values[free.lag] + grid
    at = _At.of(fitted.problem, solved.point, solved.last.about, fitted.out)
    deviance, moved_by = np.empty(len(lags)), np.empty((len(lags), len(expected)))
    for i, lag in enumerate(lags.tolist()):
        step = _at_lag(fitted.problem, at, lag, fitted.scatter)
        deviance[i], moved_by[i] = step.deviance + _prior_of_lag(free, lag), step.parameters
    moved_by[:, where] = lags
    weight = np.exp(-0.5 * (deviance - deviance.min())) * np.gradient(lags)
    weight /= weight.sum()
    mean = float(weight @ lags)
    moved_by -= weight @ moved_by
    held = _held(fitted.problem, mean)
    start = _At.of(held, _point_of(solved.point, free.lag, mean), solved.last.about, fitted.out)
    there = _iterated(held, start, fitted.scatter)
    step = replace(there.step, covariance=there.step.covariance + (moved_by.T * weight) @ moved_by)
    after = left(held, there.step), there.step.weights
    problem = replace(fitted.problem, measured=_lag_freed(fitted.problem, free), lag_known=False)
    return replace(fitted, problem=problem, solved=replace(there, step=step), left=after)


def _lag_freed(problem: Problem, free: Problem) -> tuple[Array, Array]:
    """What was known before of gravity and the parameters, of the lag as in the problem in which it is free."""
    assert free.lag is not None
    out = problem.measured[0].copy(), problem.measured[1].copy()
    for values, others in zip(out, free.measured, strict=True):
        values[1 + free.lag] = others[1 + free.lag]
    return out


# Warm-up


def _with_warm_up(fitted: _Fitted, problem: Problem) -> _Fitted:
    """The solution with biases that settle exponentially after the start, where they make a session that the noise
    within rests does not explain far more likely; else that without. What is not known of the time constant τ is in
    the covariance:

        C = C(τ) + (∂θ/∂ log τ)(∂θ/∂ log τ)ᵀ u²(log τ)"""
    settling, found, by = _time_constant(fitted, problem), fitted, np.zeros(0)
    for _ in range(WARM_UP_ROUNDS):
        if settling is None:
            return fitted
        before, warm = settling, _settling(problem, settling)
        found = _fitted(warm, _without_own(warm, found.solved))
        settling, u, by = _closest(found, settling)
        if settling is not None and abs(np.log(settling / before)) < SETTLED_TO * u:
            break
    longest = WARM_UPS[-1] * np.ptp(problem.observations.rests.start)
    if settling is None or settling > longest or _evidence(fitted) - _evidence(found) < EVIDENT:
        return fitted
    step = found.solved.step
    spread = replace(step, covariance=step.covariance + np.outer(by, by))
    return replace(found, solved=replace(found.solved, step=spread))


def _time_constant(fitted: _Fitted, problem: Problem) -> float | None:
    """The time constant, s, of the warm-up that goes best with a solution without one; None where none is needed, where
    a thermometer says more, and where what goes best is none that begins and ends within the session."""
    rests, total = problem.observations.rests, fitted.fits[TOTAL]
    explained = special.chdtrc(max(total.degrees, 1.0), total.chi_square) > UNEXPLAINED
    unknown = "accel.bias.warmup" not in problem.observations.usual
    if explained or unknown or rests.temperatures is not None or rests.file[0] != rests.file[-1]:
        return None
    tried = (WARM_UPS * np.ptp(rests.start)).tolist()
    best = int(np.argmin([_at_time_constant(fitted, each).deviance for each in tried]))
    return tried[best] if 0 < best < len(tried) - 1 else None


def _settling(problem: Problem, settling: float) -> Problem:
    """The problem with biases that settle with a time constant, s."""
    observations = replace(problem.observations, warm_up=settling)
    own = instruments_of(observations)[1]
    return Problem.of(observations, problem.prior, instrument=problem.instrument, own=own, usual=observations.usual)


def _without_own(problem: Problem, solved: _Solved) -> _At:
    """The start of a solution from one with another warm-up, or without."""
    point = replace(solved.point, own=np.zeros((len(problem.parts), len(problem.own_known))))
    return _At.of(problem, point, solved.last.about, solved.last.out)


def _at_time_constant(fitted: _Fitted, settling: float) -> Step:
    """The step from a solution to that with another time constant, s, or with one, of a warm-up."""
    other = replace(_settling(fitted.problem, settling), measured=fitted.problem.measured)
    if fitted.problem.own is not None:
        other = replace(other, own_known=fitted.problem.own_known)
    return _without_own(other, fitted.solved).solved(other, fitted.scatter)


def _closest(fitted: _Fitted, settling: float) -> tuple[float | None, float, Array]:
    """The most likely time constant, s, with the scatter and the priors of a solution with one, by parabolas of the
    likelihood over its logarithm, None where there is none; u of the logarithm, and what that makes of gravity and the
    parameters (1 + m,)."""
    u, by = np.inf, np.zeros(0)
    for _ in range(WARM_UP_ROUNDS):
        shorter, here, longer = (_at_time_constant(fitted, settling * float(np.exp(h))) for h in (-NEAR, 0.0, NEAR))
        bend = (shorter.deviance - 2.0 * here.deviance + longer.deviance) / NEAR**2
        if bend <= 2.0 * TIME_CONSTANT_KNOWN**-2:
            return None, u, by
        u = float(np.sqrt(2.0 / bend))
        by = u * (longer.parameters - shorter.parameters) / (2.0 * NEAR)
        moved = float(np.clip(0.5 * (shorter.deviance - longer.deviance) / (NEAR * bend), -FARTHEST, FARTHEST))
        settling *= float(np.exp(moved))
        if abs(moved) < SETTLED_TO * u:
            break
    return settling, u, by


def _evidence(fitted: _Fitted) -> float:
    """−2 log of the likelihood with what is not known of the parameters by their priors, less a constant."""
    problem = fitted.problem
    priors = np.concatenate([problem.measured[1][1:], problem.own_known])
    return fitted.solved.step.deviance + 2.0 * float(np.log(priors[priors > 0.0]).sum())


# Priors


def _widened(problem: Problem, at: _At, scatter: Scatter) -> Problem:
    """The problem with the priors of groups widened that the data exceed (A4), at one linearisation; the same where
    none is."""
    members, own_members = problem.instrument.members, _own_members(problem)
    if not members and not own_members:
        return problem
    expected, u = problem.measured
    now, own = u.copy(), problem.own_known.copy()
    further = np.arange(len(u)) > problem.instrument.linear_count
    told, q = tell(problem, at.rows, at.noise.weights(scatter)), len(own)
    fixed = replace(problem, measured=(expected, np.where(further, np.inf, u)))
    fold(priors(fixed, at.point, at.about), told.sessions[0, q:, q:])
    for _ in range(WIDENING_STEPS):
        trial = replace(problem, measured=(expected, np.where(further, now, np.inf)), own_known=own)
        found = joined(trial, at.rows.with_priors(trial, at.point), told)
        values, variance = at.point.values + found.parameters[1:], np.diag(found.covariance)[1:]
        most = 1.0
        for name, group in members.items():
            if name == "temperature.lag":
                continue  # it multiplies others: a wide prior would let both grow
            most = max(most, _widen(now[1:], group, (values - expected[1:]) ** 2 + variance))
        own_variance = np.diagonal(found.own_covariance, axis1=1, axis2=2)[:, : len(own)]
        own_square = ((at.point.own + found.own) ** 2 + own_variance).mean(axis=0)
        for group in own_members:
            most = max(most, _widen(own, group, own_square))
        if most < WIDENED:
            break
    if np.all(now <= u * WIDENED) and np.all(own <= problem.own_known * WIDENED):
        return problem
    return replace(problem, measured=(expected, now), own_known=own)


def _widen(known: Array, group: slice, square: Array) -> float:
    """Widen the priors of a group, in place, that the squares of its parameters and variances exceed; by how much."""
    widened = float(np.sqrt(np.mean(square[group] / known[group] ** 2)))
    if widened > 1.0:
        known[group] *= widened
    return max(widened, 1.0)


def _own_members(problem: Problem) -> list[slice]:
    """Where the groups stand of what each session has of its own."""
    if problem.own is None:
        return []
    first = problem.own.linear_count
    return [slice(of.start - first, of.stop - first) for of in problem.own.members.values()]


# Chi-square


def _parts(problem: Problem, after: Left) -> Iterator[list[tuple[Array, Array]]]:
    """Residuals and their covariances of the groups, in the order of GROUPS: of the rests that no turn follows, and of
    the others."""
    n = problem.observations.accel_block.size
    stop = n + problem.observations.rests.gyro.shape[1]
    r = after.rest[0].shape[1]
    last = problem.link < 0
    for part in (slice(0, n), slice(n, stop)):
        yield [
            (residual[:, part], covariance[:, part, part])
            for residual, covariance in ((after.rest[0][last], after.rest[1][last]), after.merged)
        ]
    v = r + 6 if problem.instrument.in_velocities else r + 3
    for rows in (np.r_[r : r + 3, v : after.merged[0].shape[1]], np.arange(r + 3, v)):
        yield [(after.merged[0][:, rows], after.merged[1][:, rows[:, None], rows])]


def _fits(problem: Problem, after: Left, scatter: Scatter, without: Left) -> dict[str, Fit]:
    """Chi-square of every group there is, and of everything with the noise within rests alone."""
    found = [
        (name, _fit(part, getattr(scatter, component), unit))
        for name, component, unit, part in zip(GROUPS, SCATTER_OF, SCATTER_UNITS, _parts(problem, after), strict=True)
    ]
    there = 1 if problem.observations.gyro_block is None else 4 if problem.instrument.in_velocities else 3
    out = dict(found[:there])
    return out | {TOTAL: _fit([one for part in _parts(problem, without) for one in part], 0.0, "")}


def _fit(parts: list[tuple[Array, Array]], scatter: float, unit: str) -> Fit:
    squares = float(sum((residual**2).sum() for residual, _ in parts))
    expected = float(sum(np.trace(covariance, axis1=1, axis2=2).sum() for _, covariance in parts))
    return Fit(chi_square=squares, degrees=expected, scatter=scatter, scatter_unit=unit)


# Which rests and turns fit


def _judged(fitted: _Fitted, left_of: tuple[Left, Weights]) -> Iterator[tuple[Array, Array]]:
    """Of accelerometers and gyros at rest, by rest, and of the turns, by turn: by how much chi-square falls without
    them, and in how many directions they have residuals."""
    problem, out, (after, weight) = fitted.problem, fitted.out, left_of
    n = problem.observations.accel_block.size
    stop = n + problem.observations.rests.gyro.shape[1]
    r, linked = after.rest[0].shape[1], problem.link >= 0
    noise = noise_of(problem, fitted.solved.last.rows)
    at_rest, merged = (
        _pulls(*found) for found in ((weight.rest, after.rest, noise.rest), (weight.merged, after.merged, noise.merged))
    )
    for part in (slice(0, n), slice(n, stop)):
        rows = at_rest.part(part)
        for own, of_turn in zip(rows, merged.part(part), strict=True):
            own[linked] = of_turn[problem.link[linked]]
        yield _falls(rows, out.rest)
    yield _falls(merged.part(slice(r, None)), out.turn)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Pulls:
    """Of rows (N, r): the pull P r on them, the block of P, their covariance, and what is added to its diagonal where
    they are left out."""

    pull: Array
    projector: Array
    noise: Array
    left_out: Array

    def part(self, rows: slice) -> tuple[Array, Array, Array, Array]:
        """The same of some of the rows."""
        of = self.projector[:, rows, rows].copy(), self.noise[:, rows, rows].copy()
        return self.pull[:, rows].copy(), *of, self.left_out[:, rows].copy()


def _pulls(W: Array, left_of: tuple[Array, Array], noise: Array) -> _Pulls:
    back = np.swapaxes(W, 1, 2)
    return _Pulls(
        pull=np.einsum("kab,kb->ka", back, left_of[0]),
        projector=back @ left_of[1] @ W,
        noise=np.asarray(np.linalg.inv(back @ W)),
        left_out=LEFT_OUT * np.diagonal(noise, axis1=1, axis2=2),
    )


def _falls(rows: tuple[Array, Array, Array, Array], left_out: BoolArray) -> tuple[Array, Array]:
    """Falls of chi-square (N,) without rows, see `_Pulls`, and directions (N,) in which they have residuals; of those
    that are left out, the chi-square of their readings about what all others predict."""
    pull, Q, noise, inflation = rows
    if not pull.size:
        return np.zeros(len(left_out)), np.zeros(len(left_out), dtype=np.int64)
    size = np.sqrt(np.diagonal(noise, axis1=1, axis2=2))
    variance, directions = np.linalg.eigh(Q * size[:, :, None] * size[:, None, :])
    seen = variance > FREE
    square = np.einsum("ia,iab->ib", pull * size, directions) ** 2
    fall = np.where(seen, square / np.where(seen, variance, 1.0), 0.0).sum(axis=1)
    count = seen.sum(axis=1)
    for i in np.flatnonzero(left_out):
        kept = variance[i] > ROUNDED * variance[i].max()
        along = directions[i][:, kept]
        spread = np.diag(1.0 / variance[i][kept])
        own = spread - along.T @ np.diag(inflation[i] / size[i] ** 2) @ along
        difference = spread @ along.T @ (pull[i] * size[i])
        fall[i], count[i] = difference @ np.linalg.solve(own, difference), len(difference)
    return fall, count


def _sigmas(fitted: _Fitted, scatter: Scatter) -> tuple[Array, Array, Array]:
    """How far each rest is from the fit by its accelerometers and by its gyros (N,), and each turn (K,), in sigmas.
    Groups that have a `scatter` when nothing is left out are judged by their own scale: that they have none without
    some of them may be by choice of these."""
    out, found = fitted.out, []
    judged = _judged(fitted, fitted.left)
    scales = (scatter.accel, scatter.gyro, max(scatter.turn, scatter.velocity, scatter.jumps))
    for (fall, count), left_out, name, scale in zip(
        judged, (out.rest, out.rest, out.turn), GROUPS[:3], scales, strict=True
    ):
        degrees = fitted.fits[name].degrees if name in fitted.fits else 0.0
        k = np.maximum(count, 1)
        others = np.maximum(degrees - k * max(1, left_out.sum()), 1.0)  # what was chosen has taken the largest with it
        chance = special.fdtrc(k, others, fall / k) if scale > 0.0 else special.chdtrc(k, fall)
        found.append(0.0 - special.ndtri(0.5 * np.maximum(chance, LEAST_CHANCE)))
    accel, gyro, turn = found
    return accel, gyro, turn


def _suspect(fitted: _Fitted) -> _Out | None:
    """With the rest or turn left out too that stands out most among those of a group that scatters, before the scatter
    is allowed for; None where none does."""
    most, found, out, scatter = STANDS_OUT, None, fitted.out, fitted.scatter
    scales = (scatter.accel, scatter.gyro, max(scatter.turn, scatter.velocity, scatter.jumps))
    if not any(scales):
        return None
    judged = _judged(fitted, fitted.without)
    for group, ((fall, count), left_out, scale) in enumerate(
        zip(judged, (out.rest, out.rest, out.turn), scales, strict=True)
    ):
        candidates = (count > 0) & ~left_out
        if scale == 0.0 or candidates.sum() < 3:
            continue
        size = np.where(candidates, fall / np.maximum(count, 1), 0.0)
        ratio = size / np.median(size[candidates])
        worst = int(np.argmax(ratio))
        if ratio[worst] > most:
            most, found = float(ratio[worst]), (group, worst)
    if found is None:
        return None
    rest, turn = out.rest.copy(), out.turn.copy()
    (turn if found[0] == 2 else rest)[found[1]] = True
    return _Out(rest=rest, turn=turn)


def _fitting(everything: _Fitted, most: int) -> _Fitted:
    """The fit without what does not fit. Suspects, `most` of them, are left out one after the other, for they hide each
    other; those that the others confirm stay out."""
    fitted = everything
    for _ in range(most):
        suspect = _suspect(fitted)
        if suspect is None:
            break
        fitted = _again(everything.problem, fitted, suspect)
    if fitted is everything:
        return everything
    by_accel, by_gyro, turn = _sigmas(fitted, everything.scatter)
    rest = np.maximum(by_accel, by_gyro)
    confirmed = _Out(rest=fitted.out.rest & (rest > FIT_SIGMAS), turn=fitted.out.turn & (turn > FIT_SIGMAS))
    count = confirmed.rest.sum() + confirmed.turn.sum()
    if count == 0:
        return everything
    if count == fitted.out.rest.sum() + fitted.out.turn.sum():
        return fitted
    return _again(everything.problem, fitted, confirmed)


def _again(problem: Problem, fitted: _Fitted, out: _Out) -> _Fitted:
    """The fit with something else left out."""
    return _fitted(problem, _At.of(problem, fitted.solved.point, fitted.solved.last.about, out))


# The estimate


def _estimate(fitted: _Fitted, increments: tuple[Array, ...], sigmas: tuple[Array, Array, Array]) -> Estimate:
    accel_sigmas, gyro_sigmas, turn_sigmas = sigmas
    problem, instrument = fitted.problem, fitted.problem.instrument
    observations, linear = problem.observations, instrument.linear_count
    values, last = fitted.solved.point.values, fitted.solved.last
    covariance = fitted.solved.step.covariance[1:, 1:] + common_covariance(observations, instrument)
    spread = problem.spread[:linear]
    variance, combinations = np.linalg.eigh(covariance[:linear, :linear] / np.outer(spread, spread))
    observable = np.ones(len(values), dtype=bool)
    observable[:linear] = np.sqrt(np.diag(covariance)[:linear]) < spread / DETERMINED
    findings = tuple(_findings(fitted, covariance))
    for finding in findings:
        observable[instrument.members[finding.name]] = finding.kept
    accel = problem.accel_model(values)
    return Estimate(
        method="joint",
        names=instrument.names,
        units=instrument.units,
        values=values,
        covariance=covariance,
        observable=observable,
        null=combinations[:, variance > DETERMINED**-2].T,
        accel=accel,
        gyro=None if observations.gyro_block is None else problem.gyro_model(values),
        rest_residual=np.linalg.norm(_force(fitted), axis=1) - observations.site.gravity,
        rest_sigmas=np.maximum(accel_sigmas, gyro_sigmas),
        gyro_rest_sigmas=gyro_sigmas,
        turn_sigmas=turn_sigmas,
        increments=increments,
        fits=fitted.fits,
        converged=fitted.settled and _negligible(problem, fitted.solved.step),
        instrument=instrument,
        groups=findings,
        degrees=_degrees(fitted, covariance),
        prediction=prediction(
            instrument,
            values,
            covariance,
            gravity=observations.site.gravity,
            rate=_usual_rate(last.about),
        ),
        linearised=_linearised(fitted),
        own=_own(fitted),
    )


def _linearised(fitted: _Fitted) -> Linearised:
    """The likelihood about the solution."""
    last = fitted.solved.last
    return Linearised(
        problem=fitted.problem,
        point=last.point,
        about=last.about,
        rows=last.rows,
        noise=last.noise,
        scatter=fitted.scatter,
    )


def _usual_rate(about: TurnsAbout | None) -> float | None:
    """The rate of the session's turns, rad/s, root mean square; None without turns."""
    if about is None or not len(about.moments):
        return None
    moments = about.moments
    return float(np.sqrt(moments.body_rates[:, [0, 3, 5]].sum() / moments.T.sum()))


def _force(fitted: _Fitted) -> Array:
    """Specific forces (N, 3) at rest by the whole model."""
    problem, last = fitted.problem, fitted.solved.last
    accel = problem.observations.rests.accel
    if "temperature" in problem.variables:
        accel = at_reference(problem, last.point, last.rows)
    return specific_force(problem.instrument, fitted.solved.point.values, accel)


def _own(fitted: _Fitted) -> OwnEstimate | None:
    """What each of several sessions has of its own."""
    own = fitted.problem.own
    if own is None:
        return None
    first, q = own.linear_count, len(fitted.problem.own_known)
    variance = np.diagonal(fitted.solved.step.own_covariance, axis1=1, axis2=2)[:, :q]
    return OwnEstimate(
        names=own.names[first:],
        units=own.units[first:],
        values=fitted.solved.point.own,
        u=np.sqrt(variance),
        priors=fitted.problem.own_known,
    )


def _findings(fitted: _Fitted, covariance: Array) -> Iterator[GroupFinding]:
    """What the session says of each further group."""
    instrument, widened = fitted.problem.instrument, fitted.problem.measured[1][1:]
    usual = fitted.problem.observations.usual
    for group in instrument.further:
        own = instrument.members[group.name]
        prior = usual.get(group.name, group.limit)
        learned = np.clip(1.0 - np.diag(covariance)[own] / widened[own] ** 2, 0.0, 1.0)
        yield GroupFinding(
            name=group.name,
            kept=bool(learned.max() > KEPT),
            prior=prior,
            widened=float(widened[own][0] / prior),
            learned=tuple(learned.tolist()),
        )


def _degrees(fitted: _Fitted, covariance: Array) -> Array:
    """Degrees of freedom (m,) behind the u of the parameters: ν = 2 u⁴ / Var(u²)."""
    problem, variance = fitted.problem, fitted.scatter.variances
    degrees = np.full(len(covariance), MOST_DEGREES)
    if not variance.any():
        return degrees
    slopes = variance_slopes(problem, fitted.solved.step, fitted.solved.last.noise)[:, 1:] * (variance > 0.0)[:, None]
    of_u = np.einsum("am,ab,bm->m", slopes, fitted.components, slopes)
    least = 2.0 * np.diag(covariance) ** 2 / MOST_DEGREES
    return np.asarray(MOST_DEGREES * least / np.maximum(of_u, least))
