"""The joint likelihood of everything a session contains: residuals, analytic Jacobians and noise.

Unknowns: the parameters θ of the instrument, local gravity g, and the attitude L (body → geographic) of every rest.
Minimised is the sum of squares, each over its covariance (turntable method §8; dynamics method §3), of

    ŷ − Σ_b K_b(θ) β_b(f, ω)                   at rest, of both blocks: f = g u, u = Lᵀ e_U; ω = Lᵀ Ω
    log( C(θ) L_jᵀ e^{−[Ω×]T} L_i )            the turn from rest i to rest j, resolved in the body at its start
    V(θ) − L_iᵀ ∫ e^{[Ω×]s} g e_U ds           its velocity, likewise, where levers and delay are unknowns        (9)
    g − g₀                                     the measured gravity

C(θ) = exp([φ×]) C and V(θ) are about the parameters the turn was integrated with: φ and V change with the coefficients
K by what `tumble.reduction.moments` has of the turn, to first order; levers and delays enter V linearly. The turn's
rows are (9) in other axes, those in which its covariance is given. The Coriolis term of (9) is left out: it is below
0.1 σ for a table whose axes are within a metre. Gravity is the same for all rests, so it is an unknown that has been
measured; no table angle has a prior unless a `Prior` is given. Parameters have priors: those of the linear model
their limits, which decide what the data leave open and are nothing beside what they show; the others what
instruments usually have. What n > 3 gyros say of a turn beyond its rotation is n − 3 rows more.

Several sessions of one instrument have the parameters in common, and of their own, besides attitudes, what differs from
launch to launch or drifts within one (`OWN`): changes of biases and scale factors with priors. These are eliminated
with the attitudes, session by session, so that the cost is linear in the number of sessions.

Attitudes change in the body, L → L exp([δ×]), with δ in the basis t₁, t₂, u of the rest, so that

    du = u × δ = t₂ δ₁ − t₁ δ₂,   dω = ω × δ,   dr = J_r⁻¹(r) δ_i − J_l⁻¹(r) C δ_j + J_l⁻¹(r) J_l(φ) dφ

J_l(r) is the left Jacobian of the rotation group, J_r(r) = J_l(r)ᵀ. A turn of everything about the vertical leaves the
accelerometers and turns as they are; in this basis its coefficients vanish exactly, so that a heading that the gyros do
not see stays free and takes no information from the others. Without a latitude the Earth's rate is noise, Ω/√3 an axis.

Noise. Beside the noise within rests a session has components of variance (`Scatter`): a bias of the accelerometers and
of the gyros that differs from rest to rest and lasts through the turn that follows, which makes the rows of a rest and
of its turn dependent; a scatter of the rotations and of the velocities of the turns, and of what n > 3 gyros say beyond
the rotation; the error of velocities over forces that jump between samples (A3), and of rotations over rates that do.
Rows of a rest and of the turn after it are therefore whitened together.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from tumble.earth import EARTH_RATE, earth_rate
from tumble.estimation.elimination import fold, whitening
from tumble.estimation.turns_about import TurnsAbout
from tumble.estimation.variables import GROWING, Variables, by_lag, variables_of
from tumble.reduction.observations import Observations
from tumble.reduction.turns import Turns
from tumble.rotation import rotation_matrix, rotation_vector, skew
from tumble.sensors.instrument import Instrument, by_sensor, functions, slopes
from tumble.sensors.model import Block, SensorModel, beyond_body
from tumble.sensors.parameters import CONSTANT, FUNCTIONS, Variable, limits_of
from tumble.units import Array, BoolArray, IntArray

_UP = np.array([0.0, 1.0, 0.0])

COMPONENTS = ("accel", "gyro", "turn", "velocity", "apart", "jumps", "aliased")
"""The components of variance, in the order of `Scatter`."""

OWN: tuple[Variable, ...] = ("time", "launch")
"""What the changes go with that each of several sessions has of its own."""
WARMING: tuple[Variable, ...] = ("warm-up", "warm-up²")
"""And those that a session without a thermometer has that warms."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Prior:
    """What is known beforehand: standard deviations, SI, of parameters about their start values, by name (others have
    their limit or their usual size), and of the attitudes about those of the programme, rad an axis. Where a
    `covariance` (1 + m, 1 + m) of gravity and the parameters is known, it takes the place of all of these but the
    attitudes'."""

    parameters: Mapping[str, float] = field(default_factory=dict)
    attitude: float | None = None
    covariance: Array | None = None


NO_PRIOR = Prior()


@dataclass(frozen=True, kw_only=True, slots=True)
class Scatter:
    """Standard deviations on top of the noise within rests: of a bias of the accelerometers (m/s²) and gyros (rad/s)
    from rest to rest, of the rotations (rad) and velocities (m/s) of turns, of the integrals (rad) of gyros beyond the
    rotation of the body, c of (A3), the error of the integral over a jump between samples in parts of its size times
    the interval, and the error of a rotation in parts of what `aliased` samples would make it."""

    accel: float = 0.0
    gyro: float = 0.0
    turn: float = 0.0
    velocity: float = 0.0
    apart: float = 0.0
    jumps: float = 0.0
    aliased: float = 0.0

    @property
    def variances(self) -> Array:
        """The squares, in the order of COMPONENTS."""
        return np.array([getattr(self, name) for name in COMPONENTS]) ** 2

    @property
    def of_turns(self) -> float:
        """The largest number of those that concern turns alone: whether there is any."""
        return float(max(getattr(self, name) for name in COMPONENTS[2:]))

    @staticmethod
    def of_variances(variances: Array) -> Scatter:
        """The scatter of these squares."""
        return Scatter(**dict(zip(COMPONENTS, np.sqrt(variances).tolist(), strict=True)))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Point:
    """Where the likelihood is taken: parameters (m,), gravity, attitudes (N, 3, 3), and what each session has of its
    own (S, q)."""

    values: Array
    gravity: float
    attitudes: Array
    own: Array = field(default_factory=lambda: np.zeros((1, 0)))

    def moved(self, parameters: Array, angles: Array, own: Array | None = None) -> Point:
        """The point after steps of gravity and the parameters (1 + m,), of the angles (N, 3) of the attitudes, and of
        what each session has of its own (S, q). The heading turns everything about the vertical, exactly: it may be off
        by much."""
        basis = bases(self.attitudes)
        tilt = np.einsum("iab,ib->ia", basis[:, :, :2], angles[:, :2])
        turned = rotation_matrix(angles[:, 2:] * _UP) @ self.attitudes @ rotation_matrix(tilt)
        return Point(
            values=self.values + parameters[1:],
            gravity=self.gravity + parameters[0],
            attitudes=turned,
            own=self.own if own is None else self.own + own,
        )


def bases(attitudes: Array) -> Array:
    """Columns t₁, t₂, u (N, 3, 3) of every rest: north, west and up in the body."""
    return np.stack([attitudes[:, 0], -attitudes[:, 2], attitudes[:, 1]], axis=2)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Rows:
    """The linearised residuals, in SI: [coefficients | residual], residual = observed less predicted, columns as
    `tumble.estimation.elimination` has them with three unknowns a rest, the parameters being gravity and those of the
    instrument, and then what a session has of its own. `prior` (1 + p, 1 + p) is whitened, and a triangle; `own` (S, q)
    the whitened residuals of the priors of what each session has of its own. `bias` are the coefficients (K, t, n) of
    the turns for a bias of the accelerometers, then of the gyros, in the turn."""

    rest: Array
    turn: Array
    prior: Array
    bias: Array
    own: Array = field(default_factory=lambda: np.zeros((1, 0)))

    def with_priors(self, problem: Problem, point: Point, about: TurnsAbout | None = None) -> Rows:
        """The same rows with the priors of a problem."""
        return replace(self, prior=priors(problem, point, about), own=-point.own / problem.own_known)

    def merged(self, first: IntArray) -> Array:
        """Rows (K, r + t, ·) of every turn together with those of the rest before it."""
        K, t = self.turn.shape[:2]
        r = self.rest.shape[1]
        out = np.zeros((K, r + t, self.turn.shape[2]))
        out[:, :r, :3], out[:, :r, 6:] = self.rest[first, :, :3], self.rest[first, :, 3:]
        out[:, r:] = self.turn
        return out


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Noise:
    """Covariance of the rows without scatter, of the rests (N, r, r) and of the merged rows (K, r + t, r + t), and the
    directions Z (N, r, q), (K, r + t, q) of the components of variance, each with the place in COMPONENTS of the one it
    belongs to: Σ = N + Σ v Z Zᵀ."""

    rest: Array
    merged: Array
    rest_directions: tuple[Array, IntArray]
    merged_directions: tuple[Array, IntArray]

    def weights(self, scatter: Scatter) -> Weights:
        """The weights of the rows with a scatter."""
        return Weights(
            rest=whitening(self.rest, *self.rest_directions, scatter.variances),
            merged=whitening(self.merged, *self.merged_directions, scatter.variances),
        )


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Weights:
    """Inverses of the Cholesky factors of the covariances of the rows: of the rests (N, r, r), which count where no
    turn follows, and of the merged rows of rests and turns (K, r + t, r + t)."""

    rest: Array
    merged: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class SessionSpan:
    """One of several sessions: its rests and turns, and the turn among these after each of its rests, or −1."""

    rests: slice
    turns: slice
    link: IntArray

    @cached_property
    def last(self) -> BoolArray:
        """The rests that no turn follows, whose own rows count."""
        return self.link < 0

    @cached_property
    def first(self) -> IntArray:
        """The rest before each turn."""
        linked = np.flatnonzero(self.link >= 0)
        return linked[np.argsort(self.link[linked])]


@dataclass(frozen=True, kw_only=True, eq=False)
class Problem:
    """A session as the likelihood sees it: `link` (N,), the turn after each rest or −1, `chain` (N,), the number of
    each rest's chain, the Earth's rate (3,), zero where the latitude is not known, and `measured`, gravity and the
    parameters (1 + m,) as they were known before, with standard deviations; zero where gravity is taken as exact."""

    observations: Observations
    instrument: Instrument
    prior: Prior
    link: IntArray
    chain: IntArray
    earth: Array
    measured: tuple[Array, Array]
    variables: Variables
    """What parameters may change with."""
    parts: tuple[SessionSpan, ...]
    """The sessions."""
    of_session: tuple[IntArray, IntArray]
    """The session of every rest (N,) and turn (K,)."""
    own: Instrument | None = None
    """What each of several sessions has of its own, beside the linear model, and"""
    own_known: Array = field(default_factory=lambda: np.zeros(0))
    """the standard deviations (q,) of its priors."""
    by_lag: Variables = field(default_factory=dict)
    """Derivatives of the variables by the lag of the thermometer, where this is an unknown."""
    at_lag: float | None = None
    """The lag at which the variables are."""
    lag_known: bool = False
    """Whether the lag is known, so that nothing else is said of it."""

    @staticmethod
    def of(
        observations: Observations,
        prior: Prior = NO_PRIOR,
        *,
        instrument: Instrument | None = None,
        own: Instrument | None = None,
        usual: Mapping[str, float] | None = None,
    ) -> Problem:
        """A session, or several, with the parameters of an instrument (those of the linear model where None), and with
        the groups of `own` in each session; `usual` are the priors of further groups by name. Raises ValueError unless
        turns join neighbouring rests, at most one each."""
        accel, gyro, site = observations.accel_block, observations.gyro_block, observations.site
        instrument = instrument or Instrument(accel=accel, gyro=gyro)
        link = np.full(len(observations.rests), -1, dtype=np.int64)
        turns = observations.turns
        if turns is not None and len(turns):
            if np.any(turns.last != turns.first + 1) or len(np.unique(turns.first)) < len(turns):
                raise ValueError("turns: expected at most one between neighbouring rests, found others")
            link[turns.first] = np.arange(len(turns))
        known = limits_of(instrument.names)
        for name, members in instrument.members.items():
            known[members] = (usual or {}).get(name, known[members])
        known = np.array([prior.parameters.get(n, k) for n, k in zip(instrument.names, known.tolist(), strict=True)])
        start = np.array([observations.start.get(name, 0.0) for name in instrument.names])
        own_known = [np.zeros(0)]
        if own is not None:
            own_known += [
                np.full(len(group.names(own.block(group))), (usual or {}).get(group.name, group.limit))
                for group in own.further
            ]
        parts, of_session = _parts(observations, link)
        return Problem(
            observations=observations,
            instrument=instrument,
            prior=prior,
            link=link,
            chain=np.append(0, np.cumsum(link[:-1] < 0)),
            earth=np.zeros(3) if site.latitude is None else np.array(earth_rate(site.latitude)),
            measured=(np.append(site.gravity, start), np.append(site.gravity_u, known)),
            variables=variables_of(observations),
            parts=parts,
            of_session=of_session,
            own=own,
            own_known=np.concatenate(own_known),
        )

    @cached_property
    def changes(self) -> list[tuple[slice, slice, Variable]]:
        """Where the parameters stand that are changes of others, those of each session after the common ones, where
        the others stand, and what they go with."""
        if self.own is None:
            return self.instrument.changes
        further = len(self.instrument.names) - self.own.linear_count
        shifted = [
            (slice(own.start + further, own.stop + further), base, variable) for own, base, variable in self.own.changes
        ]
        return self.instrument.changes + shifted

    @cached_property
    def lag(self) -> int | None:
        """Where the lag of the thermometer stands among the parameters."""
        found = self.instrument.members.get("temperature.lag")
        return None if found is None else found.start

    def warmed(self, point: Point) -> Problem:
        """The problem with the temperatures that the sensors have by the lag at a point."""
        if self.lag is None:
            return self
        lag = float(point.values[self.lag])
        if lag == self.at_lag:
            return self
        change = {} if self.lag_known else by_lag(self.observations, lag)
        return replace(self, variables=variables_of(self.observations, lag), by_lag=change, at_lag=lag)

    def goes_with(self, of: Variables, variable: Variable, own: slice, place: int) -> Array:
        """What the parameters at `own` go with (·, m), or (·, 1) where all go with the same, at rest (`place` 0) or in
        the turns (1): each with the temperature of its sensor's thermometer."""
        every = of[variable][place]
        return every if every.shape[1] == 1 else every[:, self.instrument.thermometers[own]]

    def values_in(self, point: Point, place: int) -> Array:
        """Parameters (·, m + q) of every rest (`place` 0) or turn (1), those of its session after the common ones."""
        of = self.of_session[place]
        common = np.broadcast_to(point.values, (len(of), len(point.values)))
        return np.concatenate([common, point.own[of]], axis=1)

    def changed_in_turns(self, point: Point) -> tuple[Array, Array] | None:
        """By how much the coefficients (K, n, 15) of gyros and accelerometers differ in the turns from those of the
        parameters, being changed by time, temperature or launch; None where nothing changes."""
        if not self.changes:
            return None
        values, variables, out = self.values_in(point, 1), self.warmed(point).variables, []
        for block in (self.instrument.gyro, self.instrument.accel):
            assert block is not None
            D = self.instrument.derivative(block, point.values)
            change = np.zeros((len(values), block.size, FUNCTIONS))
            for own, base, variable in self.changes:
                change += np.einsum(
                    "pbm,km->kpb", D[:, :, base], self.goes_with(variables, variable, own, 1) * values[:, own]
                )
            out.append(change)
        return out[0], out[1]

    @property
    def spread(self) -> Array:
        """How far the parameters (m,) may reasonably be from nominal."""
        return limits_of(self.instrument.names)

    def accel_model(self, values: Array) -> SensorModel:
        """The accelerometers of parameters (m,)."""
        return self.instrument.model(self.observations.accel_block, values)

    def gyro_model(self, values: Array) -> SensorModel:
        """The gyros of parameters (m,)."""
        assert self.observations.gyro_block is not None
        return self.instrument.model(self.observations.gyro_block, values)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Linearised:
    """The likelihood about the estimate: the point, the turns about it, the rows there, their noise, and the scatter
    on top of it."""

    problem: Problem
    point: Point
    about: TurnsAbout | None
    rows: Rows
    noise: Noise
    scatter: Scatter


def _parts(observations: Observations, link: IntArray) -> tuple[tuple[SessionSpan, ...], tuple[IntArray, IntArray]]:
    """The sessions, and that of every rest and turn."""
    session, turns = observations.session, observations.turns
    of_rest = np.zeros(len(link), dtype=np.int64) if session is None else session
    of_turn = np.zeros(0, dtype=np.int64) if turns is None else of_rest[turns.first]
    edges, turn_edges = (np.searchsorted(of, np.arange(of_rest[-1] + 2)) for of in (of_rest, of_turn))
    parts = []
    for s in range(len(edges) - 1):
        rests, own = slice(edges[s], edges[s + 1]), slice(turn_edges[s], turn_edges[s + 1])
        parts.append(SessionSpan(rests=rests, turns=own, link=np.where(link[rests] < 0, -1, link[rests] - own.start)))
    return tuple(parts), (of_rest, of_turn)


def instruments_of(observations: Observations) -> tuple[Instrument, Instrument | None]:
    """The instrument with all groups whose usual size observations know and which they may show; and, of several
    sessions, that with what each has of its own."""
    accel, gyro, usual = observations.accel_block, observations.gyro_block, observations.usual
    variables = set(variables_of(observations))
    if observations.together is None:
        variables -= set(WARMING)
        warming = None if observations.warm_up is None else changing_with(observations, WARMING)
        return Instrument.of(accel, gyro, usual, variables), warming
    own = changing_with(observations, OWN)
    return Instrument.of(accel, gyro, usual, variables - set(OWN)), own


def changing_with(observations: Observations, variables: tuple[Variable, ...]) -> Instrument:
    """The instrument of the linear model and of its changes with some variables."""
    every = Instrument.of(observations.accel_block, observations.gyro_block, observations.usual, variables)
    return replace(every, further=tuple(group for group in every.further if group.variable in variables))


# Residuals and Jacobians


def linearise(problem: Problem, point: Point, about: TurnsAbout | None) -> Rows:
    """Residuals and Jacobians at a point; `about` is None where there are no turns."""
    problem = problem.warmed(point)
    observations = problem.observations
    rest = [_rest_rows(problem, point, observations.accel_block, observations.rests.accel)]
    p = 2 + len(point.values) + len(problem.own_known)
    turn, bias = np.zeros((0, 6, 6 + p)), np.zeros((0, 6, 0))
    if observations.gyro_block is not None:
        rest.append(_rest_rows(problem, point, observations.gyro_block, observations.rests.gyro))
        if about is not None:
            turn, bias = _turn_rows(problem, point, about)
    if problem.prior.attitude is not None:
        rest.append(_attitude_rows(problem, point))
    return Rows(
        rest=np.concatenate(rest, axis=1),
        turn=turn,
        prior=priors(problem, point, about),
        bias=bias,
        own=-point.own / problem.own_known,
    )


def _with_changes(problem: Problem, point: Point, by: Array, place: int, growing: Array | None = None) -> None:
    """Fill in the columns (·, r, m + q) of what changes with time, temperature or launch: those of its base times what
    it goes with, at rest (`place` 0) or in the turns (1); and that of the lag, which moves the temperatures. `growing`
    are the columns (K, r, m) of what grows by 1 a second about the middle of the turns."""
    if not problem.changes:
        return
    values = problem.values_in(point, place)
    every = [(place, by)] if growing is None else [(place, by), (GROWING, growing)]
    for own, base, variable in problem.changes:
        by[:, :, own] = 0.0
        for what, columns in every:
            by[:, :, own] += problem.goes_with(problem.variables, variable, own, what)[:, None] * columns[:, :, base]
            if variable in problem.by_lag:
                moved = problem.goes_with(problem.by_lag, variable, own, what) * values[:, own]
                by[:, :, problem.lag] += np.einsum("krm,km->kr", columns[:, :, base], moved)


def _changed(problem: Problem, point: Point, by: Array, place: int) -> Array:
    """What these changes add (·, r)."""
    out = np.zeros(by.shape[:2])
    if not problem.changes:
        return out
    values = problem.values_in(point, place)
    for own, _, _ in problem.changes:
        out += np.einsum("krm,km->kr", by[:, :, own], values[:, own])
    return out


def at_reference(problem: Problem, point: Point, rows: Rows) -> Array:
    """Readings (N, n) of the accelerometers at rest as they would be at the reference temperature, in the middle of a
    session and without what differs from launch to launch."""
    accel = problem.observations.rests.accel
    by = rows.rest[:, : accel.shape[1], 4:-1]
    return np.asarray(accel - _changed(problem, point, by, 0))


def _rest_rows(problem: Problem, point: Point, block: Block, observed: Array) -> Array:
    """ŷ − Σ K β of one block."""
    g, L, instrument = point.gravity, point.attitudes, problem.instrument
    force, rate, basis = g * L[:, 1], problem.earth @ L, bases(L)
    K, beta = instrument.coefficients(block, point.values), functions(block, force, rate)
    by_force, by_rate = slopes(block, K, force, rate)
    used = instrument.used[block.kind]
    rows = np.zeros((len(L), block.size, 5 + len(point.values) + len(problem.own_known)))
    rows[:, :, :2] = by_force @ (skew(force) @ basis)[:, :, :2]
    rows[:, :, :3] += by_rate @ skew(rate) @ basis
    if problem.observations.site.gravity_u > 0.0:
        rows[:, :, 3] = np.einsum("npk,nk->np", by_force, L[:, 1])
    D = instrument.derivative(block, point.values)
    by = rows[:, :, 4:-1]
    by[:, :, : len(point.values)] = by_sensor(beta[:, :, used], D[:, used])
    _with_changes(problem, point, by, 0)
    rows[:, :, -1] = observed - np.einsum("npb,pb->np", beta, K) - _changed(problem, point, by, 0)
    return rows


def _turn_rows(problem: Problem, point: Point, about: TurnsAbout) -> tuple[Array, Array]:
    """Rotation and velocity of the turns, what more than three gyros say of themselves, and the coefficients of all for
    a bias of the accelerometers and gyros."""
    observations, instrument = problem.observations, problem.instrument
    turns, gyro = observations.turns, observations.gyro_block
    assert turns is not None
    assert gyro is not None
    basis, start, end = bases(point.attitudes), point.attitudes[turns.first], point.attitudes[turns.last]
    phi, V = about.moved(instrument, point.values)
    by_phi, by_V = about.columns(instrument, point.values)
    if len(problem.own_known):
        none = np.zeros((*by_phi.shape[:2], len(problem.own_known)))
        by_phi, by_V = np.concatenate([by_phi, none], axis=2), np.concatenate([by_V, none], axis=2)
    growing = about.growing_columns(instrument, point.values)
    for by, grows, changed in ((by_phi, growing[0], phi), (by_V, growing[1], V)):
        _with_changes(problem, point, by, 1, grows)
        changed -= _changed(problem, point, by, 1)
    C = rotation_matrix(phi) @ about.C
    earth = rotation_matrix(-turns.duration[:, None] * problem.earth)
    r = rotation_vector(C @ np.swapaxes(end, 1, 2) @ earth @ start)
    left = inverse_left_jacobian(r)
    phi_bias, V_bias = about.bias_columns()
    by_turned = left @ left_jacobian(phi)
    rows = np.zeros((len(turns), 6, 8 + by_phi.shape[2]))
    rows[:, :3, :3] = -np.swapaxes(left, 1, 2) @ basis[turns.first]
    rows[:, :3, 3:6] = left @ C @ basis[turns.last]
    rows[:, :3, 7:-1] = by_turned @ by_phi
    rows[:, :3, -1] = r
    bias = np.zeros((len(turns), 6, phi_bias.shape[2]))
    bias[:, :3], bias[:, 3:] = by_turned @ phi_bias, V_bias
    if instrument.in_velocities:
        predicted, by_turning = _velocity(problem, point, turns.duration)
        rows[:, 3:, :3] = by_turning
        if observations.site.gravity_u > 0.0:
            rows[:, 3:, 6] = predicted / point.gravity
        rows[:, 3:, 7:-1], rows[:, 3:, -1] = by_V, V - predicted
    else:
        rows, bias = rows[:, :3], bias[:, :3]
    if observations.turn_readings is None:
        return rows, bias
    spare, spare_bias = _spare_rows(problem, point)
    return np.concatenate([rows, spare], axis=1), np.concatenate([bias, spare_bias], axis=1)


def _velocity(problem: Problem, point: Point, T: Array) -> tuple[Array, Array]:
    """L_iᵀ ∫ e^{[Ω×]s} g e_U ds (K, 3) over the turns, and its derivative (K, 3, 3) with the attitude of the rest
    before: ∫ = T (I + [x×]/2 + [x×]²/6) with x = Ω T. The heading has a part in it through the Earth's rate alone."""
    turns = problem.observations.turns
    assert turns is not None
    L, basis = point.attitudes[turns.first], bases(point.attitudes)[turns.first]
    X = skew(T[:, None] * problem.earth)
    by_earth = (point.gravity * T)[:, None] * np.einsum("kia,ki->ka", L, (X / 2.0 + X @ X / 6.0) @ _UP)
    straight = (point.gravity * T)[:, None] * L[:, 1]
    by_turning = skew(by_earth) @ basis
    by_turning[:, :, :2] += (skew(straight) @ basis)[:, :, :2]
    return straight + by_earth, by_turning


def _spare_rows(problem: Problem, point: Point) -> tuple[Array, Array]:
    """What n gyros say of themselves: ∫ ŷ dt − b T has nothing in the directions that no rate explains."""
    observations, instrument = problem.observations, problem.instrument
    readings, gyro, turns = observations.turn_readings, observations.gyro_block, observations.turns
    assert readings is not None
    assert gyro is not None
    assert turns is not None
    model = problem.gyro_model(point.values)
    free = beyond_body(model.matrix)
    y = readings.integral - np.outer(turns.duration, model.bias)
    by_rate = np.zeros((len(y), 1, 15))
    by_rate[:, 0, 1:4] = y @ model.inverse().T
    by_rate[:, 0, CONSTANT] = turns.duration
    by = np.zeros((len(y), gyro.size, len(point.values) + len(problem.own_known)))
    D = instrument.derivative(gyro, point.values)
    by[:, :, : len(point.values)] = np.einsum("kb,pbm->kpm", by_rate[:, 0, :4], D[:, :4])
    _with_changes(problem, point, by, 1)
    rows = np.zeros((len(y), len(free), 8 + by.shape[2]))
    rows[:, :, 7:-1] = free @ by
    rows[:, :, -1] = (y - _changed(problem, point, by, 1)) @ free.T
    none = np.zeros((len(y), len(free), observations.accel_block.size))
    bias = turns.duration[:, None, None] * np.broadcast_to(free, (len(y), *free.shape))
    return rows, np.concatenate([none, bias], axis=2)


def _attitude_rows(problem: Problem, point: Point) -> Array:
    """log(Lᵀ L_nominal); of a programme in any order, where only the vertical is known, its tilt."""
    programme, position = problem.observations.programme, problem.observations.position
    assert programme is not None
    assert position is not None
    nominal = np.array([programme.positions[i].matrix for i in position])
    basis = bases(point.attitudes)
    rows = np.zeros((len(nominal), 3, 3 + 1 + len(point.values) + len(problem.own_known) + 1))
    if programme.ordered:
        e = rotation_vector(np.swapaxes(point.attitudes, 1, 2) @ nominal)
        rows[:, :, :3] = inverse_left_jacobian(e) @ basis
        rows[:, :, -1] = e
    else:
        across = -point.attitudes[:, [2, 0]]
        rows[:, :2, :3] = -np.cross(nominal[:, None, 1], across) @ basis
        rows[:, :2, -1] = np.einsum("iab,ib->ia", across, nominal[:, 1])
    return rows


def priors(problem: Problem, point: Point, about: TurnsAbout | None = None) -> Array:
    """Measured gravity and the prior of the parameters, whitened: a triangle, of a diagonal and a right-hand side; with
    what arrays say of themselves in motion."""
    expected, u = problem.measured
    known = u > 0.0
    rows = np.zeros((len(u) + 1, len(u) + 1))
    if problem.prior.covariance is None:
        rows[np.arange(len(u)), np.arange(len(u))] = np.where(known, 1.0 / np.where(known, u, 1.0), 0.0)
    else:
        rows[:-1, :-1] = _root_of_inverse(problem.prior.covariance)
    rows[:-1, -1] = rows[:-1, :-1] @ (expected - np.append(point.gravity, point.values))
    for array in () if about is None else about.arrays:
        fold(np.insert(array.rows(problem.instrument, point.values), 0, 0.0, axis=1), rows)
    return rows


def _root_of_inverse(covariance: Array) -> Array:
    """The triangle W with WᵀW = C⁻¹; zero where a quantity is exact."""
    known = np.flatnonzero(np.diag(covariance) > 0.0)
    index = np.ix_(known, known)
    size = np.sqrt(np.diag(covariance)[known])
    lower = np.linalg.cholesky(covariance[index] / np.outer(size, size))
    out = np.zeros_like(covariance)
    out[index] = np.linalg.qr(np.linalg.inv(lower), mode="r") / size
    return out


def left_jacobian(r: Array) -> Array:
    """J_l(r) (..., 3, 3): exp([(r + dr)×]) = exp([J_l dr×]) exp([r×]) to first order in dr."""
    angle = np.linalg.norm(r, axis=-1)[..., None, None]
    K = skew(r)
    small = angle < 1e-2
    safe = np.where(small, 1.0, angle)
    second = np.where(small, 1.0 / 6.0 - angle**2 / 120.0, (safe - np.sin(safe)) / safe**3)
    return np.asarray(np.eye(3) + 0.5 * np.sinc(0.5 * angle / np.pi) ** 2 * K + second * (K @ K))


def inverse_left_jacobian(r: Array) -> Array:
    """J_l⁻¹(r) (..., 3, 3); its transpose is J_r⁻¹(r)."""
    angle = np.linalg.norm(r, axis=-1)[..., None, None]
    K = skew(r)
    small = angle < 1e-2
    safe = np.where(small, 1.0, angle)
    series = 1.0 / 12.0 + angle**2 / 720.0
    second = np.where(small, series, 1.0 / safe**2 - 0.5 / (safe * np.tan(0.5 * safe)))
    return np.asarray(np.eye(3) - 0.5 * K + second * (K @ K))


# Noise


def noise_of(problem: Problem, rows: Rows) -> Noise:
    """Covariance of the rows without scatter, and the directions of the components of variance."""
    observations, rests = problem.observations, problem.observations.rests
    gyro, n = observations.gyro_block, rests.accel.shape[1]
    unseen = EARTH_RATE**2 / 3.0 if observations.site.latitude is None else 0.0
    blocks = [rests.accel_covariance]
    if gyro is not None:
        blocks.append(rests.gyro_covariance + unseen * gyro.axes @ gyro.axes.T)
    if problem.prior.attitude is not None:
        blocks.append(np.broadcast_to(problem.prior.attitude**2 * np.eye(3), (len(rests), 3, 3)))
    rest = _diagonal(blocks)
    r, stop = rest.shape[1], n + rests.gyro.shape[1]
    t = rows.turn.shape[1]
    v = 3 if problem.instrument.in_velocities else 0
    component = np.repeat(np.arange(len(COMPONENTS)), [n, stop - n, 3, v, t - v - 3, v, 3])
    at_rest = np.broadcast_to(np.eye(r, stop), (len(rests), r, stop)), component[:stop]
    turns = observations.turns
    if turns is None or not len(turns):
        empty = np.zeros((0, r + t, len(component)))
        return Noise(
            rest=rest,
            merged=np.zeros((0, r + t, r + t)),
            rest_directions=at_rest,
            merged_directions=(empty, component),
        )
    Z = np.zeros((len(turns), r + t, len(component)))
    Z[:, :stop, :stop], Z[:, r:, :stop] = np.eye(stop), rows.bias
    Z[:, r:, stop : stop + t] = np.eye(t)
    turned = turns.duration > 0.0  # between the parts of a rest nothing is
    Z[~turned, r : r + 3 + v, stop:] = 0.0
    Z[:, r + 3 : r + 3 + v, stop + t : -3] = np.sqrt(turns.jumps)[:, None, None] * np.eye(v)
    Z[:, r : r + 3 + v, -3:] = np.sqrt(turns.aliased)[:, None, None] * _turned_on_the_way(turns)[:, : 3 + v]
    return Noise(
        rest=rest,
        merged=_diagonal([rest[turns.first], _turn_noise(problem, unseen)]),
        rest_directions=at_rest,
        merged_directions=(Z, component),
    )


def _turn_noise(problem: Problem, unseen: float) -> Array:
    """Covariance (K, t, t) of the rows of the turns: Eq. (8) with the variance of a mean over the turn in place of that
    of white noise (A3)."""
    turns, readings = problem.observations.turns, problem.observations.turn_readings
    assert turns is not None
    T = turns.duration[:, None, None]
    rotation = turns.covariance + T**2 * unseen * np.eye(3)
    across = _turned_on_the_way(turns)[:, 3:]
    by_rotation = across @ rotation @ np.swapaxes(across, 1, 2)
    out = np.zeros((len(turns), 6, 6))
    out[:, :3, :3] = rotation
    out[:, 3:, :3] = across @ rotation
    out[:, :3, 3:] = np.swapaxes(out[:, 3:, :3], 1, 2)
    out[:, 3:, 3:] = turns.velocity_covariance + 4.0 / 3.0 * by_rotation
    if not problem.instrument.in_velocities:
        out = out[:, :3, :3]
    if readings is None:
        return out
    assert problem.observations.gyro_block is not None
    free = beyond_body(problem.observations.gyro_block.axes)
    return _diagonal([out, free @ readings.covariance @ free.T])


def _turned_on_the_way(turns: Turns) -> Array:
    """What an error of the rotation that arose evenly within a turn is in its rotation and its velocity (K, 6, 3)."""
    rotation = np.broadcast_to(np.eye(3), (len(turns), 3, 3))
    return np.concatenate([rotation, skew(-0.5 * turns.velocity)], axis=1)


def _diagonal(blocks: list[Array]) -> Array:
    """Covariances (N, n, n) joined as blocks on the diagonal."""
    size = sum(b.shape[-1] for b in blocks)
    out, first = np.zeros((len(blocks[0]), size, size)), 0
    for block in blocks:
        last = first + block.shape[-1]
        out[:, first:last, first:last] = block
        first = last
    return out


def weights(problem: Problem, rows: Rows, scatter: Scatter) -> Weights:
    """The weights of the rows from the noise within rests and a scatter."""
    return noise_of(problem, rows).weights(scatter)
