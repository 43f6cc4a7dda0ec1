"""The joint likelihood of everything a session contains: what is unknown, its residuals and their noise.

Unknowns: the parameters θ of the instrument, local gravity g, and the attitude L (body → geographic) of every rest.
Minimised is the sum of squares, each over its covariance (docs/explanation/mathematics.md, sections 1 to 5), of

    ŷ − Σ_b K_b(θ) β_b(f, ω)                   at rest, of both blocks: f = g u, u = Lᵀ e_U; ω = Lᵀ Ω
    log( C(θ) L_jᵀ e^{−[Ω×]T} L_i )            the turn from rest i to rest j, resolved in the body at its start
    V(θ) − L_iᵀ ∫ e^{[Ω×]s} g e_U ds           its velocity, likewise, where levers and delay are unknowns       (13)
    g − g₀                                     the measured gravity

C(θ) = exp([φ×]) C and V(θ) are about the parameters the turn was integrated with: φ and V change with the coefficients
K by what `tumble.reduction.turns.moments` has of the turn, to first order; levers and delays enter V linearly. The
turn's rows are (13) in other axes, those in which its covariance is given. The Coriolis term of (13) is left out: it is
below 0.1 σ for a table whose axes are within a metre. Gravity is the same for all rests, so it is an unknown that has
been measured; no table angle has a prior unless a `Prior` is given. Parameters have priors: those of the linear model
their limits, which decide what the data leave open and are nothing beside what they show; the others what
instruments usually have. What n > 3 gyros say of a turn beyond its rotation is n − 3 rows more.

Several sessions of one instrument have the parameters in common, and of their own, besides attitudes, what differs from
launch to launch or drifts within one (`OWN`): changes of biases and scale factors with priors, which are eliminated
with the attitudes, session by session.

Attitudes change in the body, L → L exp([δ×]), with δ in the basis t₁, t₂, u of the rest, so that

    du = u × δ = t₂ δ₁ − t₁ δ₂,   dω = ω × δ,   dr = J_r⁻¹(r) δ_i − J_l⁻¹(r) C δ_j + J_l⁻¹(r) J_l(φ) dφ             (14)

J_l(r) is the left Jacobian of the rotation group, J_r(r) = J_l(r)ᵀ. In this basis the coefficients of a heading that
the gyros do not see vanish exactly: it stays free and takes no information from the others.

Noise (16), (17). Beside that within rests a session has components of variance
(`tumble.inference.hyperparameters.Components`), and the bias of every sensor is a process in time
(`tumble.inference.in_run`), with its states among the unknowns of the rests. Without a latitude the Earth's rate is
noise, Ω/√3 an axis.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from tumble.earth import EARTH_RATE, earth_rate
from tumble.inference.noise_components import NO_COMPONENTS, Components, Noise, Weights
from tumble.inference.turns_about import TurnsAbout
from tumble.inference.variables import GROWING, KINDS, Variables, variables_of
from tumble.reduction.observations import Observations
from tumble.rotation import UP, rotation_matrix, skew
from tumble.sensors.instrument import Instrument
from tumble.sensors.model import SensorModel, beyond_body
from tumble.sensors.parameters import Variable, limits_of, sensor_kind, variable_of
from tumble.units import Array, IntArray

LAG_HELD = 1e-3
"""s: standard deviation of a lag that is held."""
OWN: tuple[Variable, ...] = ("time", "launch")
"""What the changes go with that each of several sessions has of its own."""


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
        tilt = (bases(self.attitudes)[:, :, :2] @ angles[:, :2, None])[:, :, 0]
        return Point(
            values=self.values + parameters[1:],
            gravity=self.gravity + parameters[0],
            attitudes=rotation_matrix(angles[:, 2:] * UP) @ self.attitudes @ rotation_matrix(tilt),
            own=self.own if own is None else self.own + own,
        )


def bases(attitudes: Array) -> Array:
    """Columns t₁, t₂, u (N, 3, 3) of every rest: north, west and up in the body."""
    return np.stack([attitudes[:, 0], -attitudes[:, 2], attitudes[:, 1]], axis=2)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Rows:
    """The linearised residuals, in SI: [coefficients | residual], residual = observed less predicted, columns as
    `tumble.inference.elimination` has them with three unknowns a rest, the parameters being gravity and those of the
    instrument, and then what a session has of its own. `prior` (1 + p, 1 + p) is whitened, and a triangle; `own` (S, q)
    the whitened residuals of the priors of what each session has of its own. `bias` are the coefficients (K, t, n) of
    the turns for a bias of the accelerometers, then of the gyros, in the turn; `gained` (K, 3), m/s, is what gravity
    gives the turns of velocity, in the body at their start."""

    rest: Array
    turn: Array
    prior: Array
    bias: Array
    gained: Array
    own: Array = field(default_factory=lambda: np.zeros((1, 0)))

    @property
    def residuals(self) -> tuple[Array, Array]:
        """Observed less predicted, of the rests (N, r) and of the turns (K, t)."""
        return self.rest[..., -1], self.turn[..., -1]

    @property
    def headings(self) -> Array:
        """The coefficients (N, r) of the rests for their heading."""
        return np.asarray(self.rest[..., 2])

    def beside(self, rest: Array, turn: Array) -> Rows:
        """The same with further common parameters after those of the instrument, of which nothing is known beforehand,
        by their columns (N, r, c) and (K, t, c)."""
        before, c = -1 - self.own.shape[1], rest.shape[2]
        pairs = zip((self.rest, self.turn), (rest, turn), strict=True)
        every = (np.concatenate([a[..., :before], b, a[..., before:]], axis=2) for a, b in pairs)
        p = len(self.prior) - 1
        prior = np.zeros((p + c + 1, p + c + 1))
        keep = np.append(np.arange(p), p + c)
        prior[np.ix_(keep, keep)] = self.prior
        wide_rest, wide_turn = every
        return replace(self, rest=wide_rest, turn=wide_turn, prior=prior)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class SessionSpan:
    """Where one of several sessions stands among the rests and turns of all, the turn among its own after each of its
    rests, or −1, and the rest (K,) among its own before each of its turns."""

    rests: slice
    turns: slice
    link: IntArray
    first: IntArray


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
    before_turn: IntArray
    """The rest (K,) before each turn."""
    own: Instrument | None = None
    """What each of several sessions has of its own, beside the linear model, and"""
    own_known: Array = field(default_factory=lambda: np.zeros(0))
    """the standard deviations (q,) of its priors."""
    at_lags: tuple[float, ...] = ()
    """The lags at which the variables are."""
    usual: tuple[Array, Array] = (np.zeros(0), np.zeros(0))
    """`measured` with every group of its usual size, and"""
    own_usual: Array = field(default_factory=lambda: np.zeros(0))
    """`own_known` likewise."""
    bias_after: float = 0.5
    """The share of the in-run bias of a turn that is that of the rest after it; the other is of the rest before."""

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
            if np.any(turns.last != turns.first + 1) or np.bincount(turns.first).max() > 1:
                raise ValueError("turns: expected at most one between neighbouring rests, found others")
            link[turns.first] = np.arange(len(turns))
        known = limits_of(instrument.names)
        for name, members in instrument.members.items():
            known[members] = (usual or {}).get(name, known[members])
            if variable_of(name) == "lag":  # the estimate holds it: `tumble.inference.lag`
                known[members] = LAG_HELD
        known = np.array([prior.parameters.get(n, k) for n, k in zip(instrument.names, known.tolist(), strict=True)])
        start = np.array([observations.start.get(name, 0.0) for name in instrument.names])
        own_known = [np.zeros(0)]
        if own is not None:
            own_known += [
                np.full(len(group.names(own.block(group))), (usual or {}).get(group.name, group.limit))
                for group in own.further
            ]
        before = np.zeros(0, dtype=np.int64) if turns is None else turns.first
        session = np.zeros(len(link), dtype=np.int64) if observations.session is None else observations.session
        edges, turn_edges = (np.searchsorted(of, np.arange(session[-1] + 2)) for of in (session, session[before]))
        parts = tuple(
            SessionSpan(
                rests=slice(rest, rest_end),
                turns=slice(turn, turn_end),
                link=np.where(link[rest:rest_end] < 0, -1, link[rest:rest_end] - turn),
                first=before[turn:turn_end] - rest,
            )
            for rest, rest_end, turn, turn_end in zip(edges, edges[1:], turn_edges, turn_edges[1:], strict=False)
        )
        measured = np.append(site.gravity, start), np.append(site.gravity_u, known)
        return Problem(
            observations=observations,
            instrument=instrument,
            prior=prior,
            link=link,
            chain=np.append(0, np.cumsum(link[:-1] < 0)),
            earth=np.zeros(3) if site.latitude is None else np.array(earth_rate(site.latitude)),
            measured=measured,
            usual=measured,
            variables=variables_of(observations),
            parts=parts,
            of_session=(session, session[before]),
            before_turn=before,
            own=own,
            own_known=np.concatenate(own_known),
            own_usual=np.concatenate(own_known),
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
    def own_members(self) -> dict[str, slice]:
        """Where the groups stand among what each session has of its own."""
        if self.own is None:
            return {}
        first, members = self.own.linear_count, self.own.members
        return {g.name: slice(members[g.name].start - first, members[g.name].stop - first) for g in self.own.further}

    @property
    def biases(self) -> IntArray:
        """Where the biases of all sensors stand among the parameters."""
        columns = [self.instrument.group_columns[f"{block.kind}.bias"] for block in self.instrument.blocks]
        return np.concatenate([np.arange(len(self.instrument.names))[each] for each in columns])

    @property
    def sensors(self) -> int:
        """How many accelerometers and gyros there are."""
        return sum(block.size for block in self.instrument.blocks)

    @cached_property
    def lags(self) -> dict[str, int]:
        """Where the lags behind the thermometers stand among the parameters, by kind of sensor."""
        members = self.instrument.members
        return {kind: members[f"{kind}.lag"].start for kind in KINDS if f"{kind}.lag" in members}

    def with_lags(self, values: Array) -> Problem:
        """The problem in which the lags are known to have the values they have among those of the parameters (m,)."""
        expected, at = self.measured[0].copy(), list(self.lags.values())
        expected[1:][at] = values[at]
        return replace(self, measured=(expected, self.measured[1]))

    def warmed(self, point: Point) -> Problem:
        """The problem with the temperatures that the sensors have by the lags at a point."""
        lags = {kind: float(point.values[at]) for kind, at in self.lags.items()}
        if tuple(lags.values()) == self.at_lags:
            return self
        return replace(self, variables=variables_of(self.observations, lags), at_lags=tuple(lags.values()))

    def goes_with(self, variable: Variable, own: slice, place: int) -> Array:
        """What the parameters at `own` go with (·, m), or (·, 1) where all go with the same, at rest (`place` 0) or in
        the turns (1): each with the temperature of its sensor."""
        every = self.variables[variable][place]
        if every.shape[1] == 1:
            return every
        of_gyros = sensor_kind(self.instrument.names[own.start]) == "gyro"
        return every[:, self.instrument.thermometers[own] + of_gyros * every.shape[1] // 2]

    @cached_property
    def changed(self) -> tuple[IntArray, IntArray]:
        """Where the parameters (c,) stand that are changes of others, and where these stand."""
        every, none = np.arange(self.width), np.arange(0)
        own = np.concatenate([none, *(every[own] for own, _, _ in self.changes)])
        return own, np.concatenate([none, *(every[base] for _, base, _ in self.changes)])

    def going(self, place: int) -> Array:
        """What the changes (·, c) go with at rest (`place` 0), in the turns (1), or by how much a second that grows in
        them (2)."""
        out, first = np.zeros((len(self.of_session[min(place, 1)]), len(self.changed[0]))), 0
        for own, _, variable in self.changes:
            last = first + own.stop - own.start
            out[:, first:last] = self.goes_with(variable, own, place)
            first = last
        return out

    @cached_property
    def goes(self) -> tuple[Array, Array, Array]:
        """What the changes go with, (N, c), (K, c) and (K, c)."""
        return self.going(0), self.going(1), self.going(GROWING)

    def changes_in(self, point: Point, place: int) -> Array:
        """The values (·, c) of the changes at every rest (`place` 0) or turn (1), those of its session."""
        of, own = self.of_session[place], self.changed[0]
        if not len(self.own_known):
            return np.broadcast_to(point.values[own], (len(of), len(own)))
        every = np.concatenate([np.broadcast_to(point.values, (len(point.own), len(point.values))), point.own], axis=1)
        return np.asarray(every[:, own][of])

    @cached_property
    def noise(self) -> Noise:
        """What the noise of the rows has that does not change with the parameters."""
        return _noise_of_session(self)

    @property
    def rows_of_turn(self) -> int:
        """How many rows a turn has: rotation, velocity where it is predicted, and what gyros say of each other."""
        gyro, velocity = self.instrument.gyro, 3 if self.instrument.in_velocities else 0
        return 3 + velocity + (0 if gyro is None or self.observations.turn_readings is None else gyro.size - 3)

    @cached_property
    def noise_of_turns(self) -> tuple[Array, Array]:
        """Standard deviations (K,) of the rotations of the turns, rad, and of their velocities, m/s, infinite where
        they are not predicted: root mean square over the axes."""
        turns = self.observations.turns
        assert turns is not None
        rotation = np.sqrt(np.trace(turns.covariance, axis1=1, axis2=2) / 3.0)
        if not self.instrument.in_velocities:
            return rotation, np.full_like(rotation, np.inf)
        return rotation, np.sqrt(np.trace(turns.velocity_covariance, axis1=1, axis2=2) / 3.0)

    @property
    def width(self) -> int:
        """How many parameters there are, with what a session has of its own."""
        return len(self.instrument.names) + len(self.own_known)

    @cached_property
    def earth_turned(self) -> Array:
        """How the Earth turns back (K, 3, 3) over the turns."""
        turns = self.observations.turns
        return np.zeros((0, 3, 3)) if turns is None else rotation_matrix(-turns.duration[:, None] * self.earth)

    def changed_in_turns(self, point: Point) -> Array | None:
        """By how much the coefficients (K, n, 15) of accelerometers and gyros differ in the turns from those of the
        parameters, being changed by time, temperature or launch; None where nothing changes."""
        if not self.changes:
            return None
        D = self.instrument.linearised(point.values)[1][:, :, self.changed[1]]
        change = self.warmed(point).goes[1] * self.changes_in(point, 1)
        return np.asarray(change @ D.reshape(-1, D.shape[2]).T).reshape(len(change), *D.shape[:2])

    @cached_property
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
    """The likelihood about the estimate: the point, the turns about it, the rows there, their noise, and the components
    of variance beside it."""

    problem: Problem
    point: Point
    about: TurnsAbout | None
    rows: Rows
    noise: Noise
    components: Components

    @property
    def rotations(self) -> Array:
        """The rotations (K, 3, 3) of the turns, body at the end → body at the start, by the gyros of the point."""
        about, changes = self.about, self.problem.changed_in_turns(self.point)
        assert about is not None
        return about.rotations(self.problem.instrument, self.point.values, 0.0 if changes is None else changes)


def instruments_of(observations: Observations) -> tuple[Instrument, Instrument | None]:
    """The instrument with all groups whose usual size observations know and which they may show; and, of several
    sessions, that with what each has of its own."""
    blocks, usual = (observations.accel_block, observations.gyro_block), observations.usual
    variables = set(variables_of(observations))
    if observations.together is None:
        return Instrument.of(*blocks, usual, variables), None
    own = Instrument.of(*blocks, usual, OWN)
    own = replace(own, further=tuple(group for group in own.further if group.variable in OWN))
    return Instrument.of(*blocks, usual, variables - set(OWN)), own


# Noise


def noise_of(problem: Problem, rows: Rows) -> Noise:
    """Covariance of the rows without scatter, and the directions of the components of scatter."""
    noise, turns = problem.noise, problem.observations.turns
    Z, component = noise.turn_directions
    if turns is None or not len(Z) or not problem.instrument.in_velocities:
        return noise
    across, Z, turn = skew(-0.5 * rows.gained), Z.copy(), noise.turn.copy()
    rotation, constant = turn[:, :3, :3], turns.duration[:, None, None] ** 2 * unseen_rate(problem)
    by_rotation = across @ (rotation - constant * np.eye(3)) @ np.swapaxes(across, 1, 2)
    turn[:, 3:6, :3] = across @ rotation
    turn[:, :3, 3:6] = np.swapaxes(turn[:, 3:6, :3], 1, 2)
    turn[:, 3:6, 3:6] += turns.arising[:, None, None] * by_rotation
    turn[:, 3:6, 3:6] += constant * across @ np.swapaxes(across, 1, 2)
    Z[:, 3:6, -3:] = across @ Z[:, :3, -3:]
    return replace(noise, turn=turn, turn_directions=(Z, component))


def unseen_rate(problem: Problem) -> float:
    """The variance, rad²/s², of the Earth's rate along an axis where the latitude is not known."""
    return EARTH_RATE**2 / 3.0 if problem.observations.site.latitude is None else 0.0


def _noise_of_session(problem: Problem) -> Noise:
    """All of it that does not change with the parameters: without what an error of the rotation on the way does to the
    velocity, of the turns docs/explanation/mathematics.md (16)."""
    observations, rests, turns = problem.observations, problem.observations.rests, problem.observations.turns
    gyro, n, earth = observations.gyro_block, rests.accel.shape[1], unseen_rate(problem)
    blocks = [rests.accel_covariance]
    if gyro is not None:
        blocks.append(rests.gyro_covariance + earth * gyro.axes @ gyro.axes.T)
    if problem.prior.attitude is not None:
        blocks.append(np.broadcast_to(problem.prior.attitude**2 * np.eye(3), (len(rests), 3, 3)))
    rest, t, v = _diagonal(blocks), problem.rows_of_turn, 3 if problem.instrument.in_velocities else 0
    sensors, spare = n + rests.gyro.shape[1], t - v - 3
    at_rest = np.broadcast_to(np.eye(rest.shape[1], sensors), (len(rests), rest.shape[1], sensors))
    of_rest = np.repeat([0, 1], [n, sensors - n])
    of_turn = np.repeat([2, 3, 4, 5, 7, 6], [3, v, spare, v, spare, 3])  # places in SCATTER
    turn, Z = np.zeros((0, t, t)), np.zeros((len(problem.before_turn), t, len(of_turn)))
    if turns is not None and len(turns):
        blocks = [turns.covariance + turns.duration[:, None, None] ** 2 * earth * np.eye(3)]
        if v:
            blocks.append(turns.velocity_covariance)
        if (readings := observations.turn_readings) is not None:
            assert gyro is not None
            free = beyond_body(gyro.axes)
            blocks.append(free @ readings.covariance @ free.T)
        turn, jumps, aliased = _diagonal(blocks), np.sqrt(turns.jumps), np.sqrt(turns.aliased)
        Z[:, :, :t] = np.eye(t)
        Z[turns.duration <= 0.0, : 3 + v] = 0.0  # between the parts of a rest nothing is turned
        Z[:, 3 : 3 + v, t : t + v] = jumps[:, None, None] * np.eye(v)
        Z[:, 3 + v :, t + v : -3] = aliased[:, None, None] * np.eye(spare)
        Z[:, :3, -3:] = aliased[:, None, None] * np.eye(3)
    kept = np.ones(rest.shape[:2]), np.ones(turn.shape[:2])
    return Noise(rest=rest, turn=turn, rest_directions=(at_rest, of_rest), turn_directions=(Z, of_turn), kept=kept)


def _diagonal(blocks: list[Array]) -> Array:
    """Covariances (N, n, n) joined as blocks on the diagonal."""
    size = sum(b.shape[-1] for b in blocks)
    out, first = np.zeros((len(blocks[0]), size, size)), 0
    for block in blocks:
        last = first + block.shape[-1]
        out[:, first:last, first:last] = block
        first = last
    return out


def weights(problem: Problem, rows: Rows, components: Components = NO_COMPONENTS) -> Weights:
    """The weights of the rows from the noise within rests and components of variance."""
    return noise_of(problem, rows).weights(components)
