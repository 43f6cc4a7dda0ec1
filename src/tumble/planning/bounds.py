"""The best a programme allows: the Cramér–Rao bound of the joint likelihood, before anything is measured.

The rows are those of `tumble.inference.likelihood`, taken at perfect sensors and at the attitudes of the programme,
which are eliminated: so the bound is the covariance that `joint` would state for an exact programme if it knew the
noise. What a log has of it: the rests, with white noise, the moves between them, all of which the log has, and in-run
instability, the standard deviation of a Gauss–Markov process (`tumble.inference.in_run`) that is the bias of a sensor;
what is said of a bias is said of its mean over the session. A move goes about one axis at a constant rate; the body
turns about a fixed axis in inertial space (`tumble.planning.steady_turns`). Errors of table and mounting are not in the
bound: the attitudes are unknowns, and where they are a degree or two off it changes by parts of a thousand.

What `calibrate` will state (`stated`) is more: it does not know the noise nor how large further groups are in this
instrument (`tumble.planning.expected_sizes`), it has the time base of the log, and of this the ends of the rests belong
to the turns.

Other units of the device's type may say what is usual of a parameter instead (`Prior`): then `calibrate` has them
beside the recording, and how large the groups are need not be found out.

Groups of parameters beyond the linear model (`Setup.further`) have priors, the spreads of the set-up. What is said of
combinations is said of the linear parameters, whatever the others are within their priors; of a group, what the
programme finds out about it: the learned fraction 1 − u²/s² of each parameter, s being its prior.

How well the parameters are seen together is judged in natural units, biases as parts of gravity and of the rate of the
turns, scale-factor errors as they are, angles in rad: `condition` is that of the whitened Jacobian, `worst` the
combination of unit length that is determined worst. For accelerometers alone that is the matrix H of Eq. (13).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tumble.brief import Brief
from tumble.earth import earth_rate
from tumble.errors import InputError
from tumble.inference.elimination import fold
from tumble.inference.estimate import GroupFinding
from tumble.inference.hyperparameters import Components
from tumble.inference.in_run import InRun, mean_along
from tumble.inference.likelihood import Linearised, Point, Problem
from tumble.inference.linearisation import linearised
from tumble.inference.prior import Prior
from tumble.inference.sources import by_time_base, clocked
from tumble.inference.step import joining, tell, whitened_rows, with_own
from tumble.inference.turns_about import TurnsAbout, own_axes, warms
from tumble.methods.least_squares import least_squares
from tumble.planning.expected_sizes import expected
from tumble.planning.itinerary import Itinerary, itinerary_of
from tumble.planning.setup import ACCEL, GYRO, Setup, check_setup
from tumble.planning.steady_turns import inertial_turns, steady_moments, white_turns
from tumble.recording.session import Site
from tumble.reduction.blocks.tuning import USUAL
from tumble.reduction.observations import Observations
from tumble.reduction.rests.rests import Rests
from tumble.reduction.turns.turns import TURN_FLOOR, VELOCITY_FLOOR
from tumble.sensors.grades import NoiseModel
from tumble.sensors.instrument import Instrument
from tumble.sensors.parameters import positions_by_group
from tumble.units import Array, BoolArray


@dataclass(frozen=True, kw_only=True, slots=True, eq=False, repr=False)
class Bound(Brief):
    """Least possible covariance (m, m) of the parameters, SI, in the order of `names`, of which the first `linear`
    are those of the linear model. `observable` marks the parameters that are determined, and only these mean
    anything; those of further groups are by their priors at least, and `further` says what the programme adds.
    `null` (q, linear) are the combinations that are not determined, `worst` (linear,) the unit combination
    determined worst and `worst_u` how well, both in natural units, whose sizes in SI are `natural` (linear,).
    `condition` is infinite where a combination is not determined."""

    names: tuple[str, ...]
    units: tuple[str, ...]
    linear: int
    covariance: Array
    observable: BoolArray
    natural: Array
    null: Array
    condition: float
    worst: Array
    worst_u: float
    further: tuple[GroupFinding, ...]

    @property
    def u(self) -> Array:
        """Least standard uncertainties (m,), SI; infinite where a parameter is not determined."""
        return np.where(self.observable, np.sqrt(np.diag(self.covariance)), np.inf)

    @property
    def rank(self) -> int:
        """How many combinations of the linear parameters are determined."""
        return self.linear - len(self.null)

    def rms(self, group: str) -> float:
        """Root mean square of the u of a group such as "accel.bias", SI; infinite where one of it is not determined.
        Raises KeyError for a group that is not there."""
        return float(np.sqrt(np.mean(self.u[positions_by_group(self.names)[group]] ** 2)))

    @property
    def groups(self) -> tuple[str, ...]:
        """The kinds of linear parameters there are, in order."""
        return tuple(positions_by_group(self.names[: self.linear]))


def bound(setup: Setup, *, gyros: bool = True) -> Bound:
    """The bound of a set-up's programme, with gyros and all moves, or of accelerometers alone.

    Raises InputError for values that make no sense, and where there is no noise.

    >>> import tumble
    >>> setup = tumble.Setup.of(rest=120.0)
    >>> found = tumble.bound(setup)
    >>> found.rank == len(found.names)
    True
    """
    return bound_of(itinerary_of(setup), setup, gyros=gyros)


def bound_of(course: Itinerary, setup: Setup, *, gyros: bool = True) -> Bound:
    """The bound of an itinerary; of the set-up, all but programme, table and mounting counts. Raises InputError."""
    return bound_by(view(course, setup, gyros=gyros), setup.turn_rate)


def stated(setup: Setup, *, gyros: bool = True, prior: Prior | None = None) -> Bound:
    """The same with what `calibrate` does not know of a recording by a set-up's programme: what it will state on the
    average over instruments, or with a prior. Raises InputError."""
    course = itinerary_of(setup).as_logged(setup.ramp, USUAL.margin_of(setup.rest))
    seen = view(course, setup, gyros=gyros)
    seen, by_type = expected(seen), None
    if prior is not None:
        problem = seen.problem
        known = prior.places(problem.instrument.names)
        if not known:
            raise InputError(f"prior: expected one of the instrument's parameters, found none by {prior.words}")
        places, of = list(known), list(known.values())
        covariance = prior.covariance[np.ix_(of, of)]
        by_type = np.zeros((len(places), len(problem.instrument.names)))
        by_type[:, places] = np.linalg.inv(np.linalg.cholesky(covariance))
        size, usual = problem.measured[1].copy(), problem.usual[1].copy()
        size[1 + np.array(places)] = usual[1 + np.array(places)] = np.sqrt(np.diag(covariance))
        problem = replace(problem, measured=(problem.measured[0], size), usual=(problem.usual[0], usual))
        seen = replace(seen, problem=problem)
    return bound_by(seen, setup.turn_rate, setup.clock_u, by_type)


def instrument_of(setup: Setup, gyros: bool) -> Instrument:
    """The instrument of a set-up: triads along the body axes with the groups of parameters it has."""
    return Instrument.of(ACCEL, GYRO if gyros else None, tuple(setup.further))


# What the likelihood sees of it


def bound_by(seen: Linearised, rate: float, clock_u: float = 0.0, by_type: Array | None = None) -> Bound:
    """What rows at the true parameters say, of turns at a rate, rad/s, that gives biases of gyros their natural unit,
    with a time base of this relative standard uncertainty, and with whitened rows (k, m) of what the device's type says
    in the place of the usual sizes of those parameters.

    The covariance of the linear parameters, whatever gravity and the others are: with the columns of these first, the
    triangle of all is R = (F X; 0 L), and L that of the linear ones. Gravity that is exact has no column."""
    problem, instrument, q = seen.problem, seen.problem.instrument, len(seen.problem.own_known)
    linear, m = instrument.linear_count, len(instrument.names)
    spread, own = problem.spread[:linear], slice(1, 1 + linear)
    told = tell(problem, seen.rows, seen.noise.weights(seen.components))
    size = problem.measured[1].copy()
    size[own] = 0.0
    if by_type is not None:
        size[1:][by_type.any(axis=0)] = 0.0
    triangle = np.diag(np.append(np.divide(1.0, size, out=np.zeros(1 + m), where=size > 0.0), 0.0))
    for session, residual in zip(told.sessions, seen.rows.own, strict=True):
        fold(with_own(problem.own_known, session, residual)[q:, q:], triangle, triangular=True)
    if by_type is not None:
        fold(np.pad(by_type, ((0, 0), (1, 1))), triangle)
    triangle = triangle[:-1, :-1]
    others = np.setdiff1d(np.flatnonzero(triangle.any(axis=0)), np.arange(1, 1 + linear))
    R, k = np.asarray(np.linalg.qr(np.hstack([triangle[:, others], triangle[:, own]]), mode="r")), len(others)
    L = R[k : k + linear, k:]
    solution = least_squares(L, np.zeros(len(L)), spread)
    known = np.hstack([solution.gain, spread[:, None] * solution.null.T])
    root = np.zeros((1 + m, known.shape[1] + k))
    root[own, : known.shape[1]] = known
    root[others] = np.hstack([-np.linalg.solve(R[:k, :k], R[:k, k:]) @ known, np.linalg.inv(R[:k, :k])])

    # with the time base, of sensors that read rates and forces, no increments; and the biases of one session the
    # means over it
    clock = by_time_base(instrument.names, clocked(clock_u, {"accel": False, "gyro": False}))
    more = np.zeros((len(root), 0))
    if told.process is not None and len(problem.parts) == 1:
        by, noise = mean_along(told)
        biases, more = 1 + problem.biases, np.zeros((len(root), len(by)))
        root[biases] += by[:, :-1] @ root
        value, vectors = np.linalg.eigh(np.einsum("ibd,icd->bc", noise, noise))
        more[biases] = vectors * np.sqrt(np.maximum(value, 0.0))
    root = np.column_stack([root[1:], more[1:], clock])
    covariance = root @ root.T

    natural_sizes = {"m/s^2": problem.observations.site.gravity, "rad/s": rate, "1": 1.0, "rad": 1.0}
    natural = np.array([natural_sizes[unit] for unit in instrument.units[:linear]])
    direction, length, _ = np.linalg.svd(root[:linear] / natural[:, None])
    null = solution.null * spread / natural
    null /= np.linalg.norm(null, axis=1, keepdims=True)
    worst = null[0] if len(null) else direction[:, 0]
    sizes, usual, variance = problem.measured[1][1:], problem.usual[1][1:], np.diag(covariance)
    return Bound(
        names=instrument.names,
        units=instrument.units,
        linear=linear,
        covariance=covariance,
        observable=np.append(solution.observable, np.ones(m - linear, dtype=bool)),
        natural=natural,
        null=null,
        condition=np.inf if len(null) else float(length[0]) / max(float(length[-1]), np.finfo(float).tiny),
        worst=worst * np.sign(worst[np.argmax(np.abs(worst))]),
        worst_u=np.inf if len(null) else float(length[0]),
        further=tuple(
            GroupFinding.of(name, usual[members], sizes[members], variance[members])
            for name, members in instrument.members.items()
        ),
    )


def whitened(seen: Linearised) -> tuple[Array, Array, int]:
    """The whitened rows of the rests (N, r + n, d + p + 1), n = d − 3 being the states of in-run biases, and those
    that join each to the next (N − 1, t + n, 2d + p + 1), its turn and the steps of the states, see
    `tumble.inference.elimination`. The last n of a rest are zero: they are for where a chain begins (`begun`)."""
    process = InRun.of(seen.problem, seen.components) if seen.components.wanders else None
    rest, turn = whitened_rows(seen.problem, seen.rows, seen.noise.weights(seen.components), process)
    n = 0 if process is None else seen.problem.sensors
    return np.pad(rest, ((0, 0), (0, n), (0, 0))), joining(seen.problem, turn, process)[:-1], n


def begun(rest: Array, states: int) -> Array:
    """The rows of rests (..., r + n, d + p + 1) of `whitened` where a chain begins with each: its n states are
    those of a stationary process."""
    out = rest.copy()
    out[..., rest.shape[-2] - states :, 3 : 3 + states] = np.eye(states)
    return out


def view(course: Itinerary, setup: Setup, *, gyros: bool) -> Linearised:
    """The rows at perfect sensors and the attitudes of the course. Raises InputError."""
    instrument = instrument_of(setup, gyros)
    observations, about = observed(course, setup, instrument)
    problem = Problem.of(observations, instrument=instrument, usual=setup.further)
    point = Point(values=np.zeros(len(instrument.names)), gravity=setup.gravity, attitudes=course.attitudes)
    return linearised(problem, point, about, components_of(setup.noise))


SHORTEST_TIME = 1e-3
"""s: of the correlation of biases that are drawn anew at every rest."""


def components_of(noise: NoiseModel) -> Components:
    """The in-run instability of an instrument."""
    time = max(noise.instability_time, SHORTEST_TIME)
    return Components(
        accel_in_run=noise.accel_instability, gyro_in_run=noise.gyro_instability, accel_time=time, gyro_time=time
    )


def observed(course: Itinerary, setup: Setup, instrument: Instrument) -> tuple[Observations, TurnsAbout | None]:
    """What perfect sensors observe on a course, with the covariances of white noise, and its turns about the parameters
    of an instrument, where it has gyros. Raises InputError for values that make no sense, and where there is no
    noise."""
    check_setup(setup, 1)
    noise, gyros = setup.noise, instrument.gyro is not None
    for sensors, level in (
        ("accelerometers", noise.accel_white + noise.accel_instability),
        ("gyros", noise.gyro_white),
    ):
        if level == 0.0 and (gyros or sensors == "accelerometers"):
            raise InputError(f"noise: expected {sensors} with noise, found none; without it there is no bound")
    earth, g = np.array(earth_rate(setup.latitude)), setup.gravity
    turns = about = None
    first, seconds = course.first, course.seconds
    if gyros and len(first) > 0:
        start, end, still = course.attitudes[first], course.attitudes[first + 1], course.still[first]
        vector = inertial_turns(start, end, course.moves[first], seconds, setup.latitude)
        moments, grown = steady_moments(vector, seconds, start, setup, own_axes(instrument), still)
        ends = (g * start[:, 1], g * end[:, 1]), (earth @ start, earth @ end)
        exact = (instrument.all_coefficients(np.zeros(len(instrument.names))), 0.0)
        growing = grown if warms(instrument) else None
        about = TurnsAbout.from_moments(moments, instrument.accel, exact, (np.eye(3), np.eye(3)), ends, growing)
        T = seconds + 2.0 * still
        rotation = (noise.gyro_white**2 * T + TURN_FLOOR**2)[:, None, None] * np.eye(3)
        turns = white_turns(first, T, rotation, noise.accel_white**2 * T + VELOCITY_FLOOR**2, moments)
    observations = Observations(
        accel_block=ACCEL,
        gyro_block=instrument.gyro,
        site=Site(latitude=setup.latitude, height=0.0, gravity=g, gravity_u=setup.gravity_u),
        rests=Rests.of_white_noise(
            *course.rests.T,
            accel=g * course.attitudes[:, 1],
            gyro=(earth @ course.attitudes)[:, : 3 if gyros else 0],
            densities=(noise.accel_white, noise.gyro_white),
        ),
        turns=turns,
        usual=setup.further,
    )
    return observations, about
