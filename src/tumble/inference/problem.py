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

Noise (16), (17). Beside that within rests a session has components of variance, and the bias of every sensor is a
process in time (`tumble.inference.noise`), with its states among the unknowns of the rests. Without a latitude the
Earth's rate is noise, Ω/√3 an axis. In one attitude what is not known of it errs alike at all rests
(`tumble.inference.sources`): a heading that is free in (14) would take a level direction from the biases.
"""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from tumble.earth import EARTH_RATE, earth_rate
from tumble.inference.magnetometer import Magnetometer
from tumble.inference.noise import SCATTER, NoiseModel
from tumble.inference.variables import GROWING, KINDS, Variables, variables_of
from tumble.reduction.observations import Observations
from tumble.reduction.turns.links import PARTS
from tumble.rotation import UP, rotation_matrix, skew
from tumble.sensors.instrument import Instrument
from tumble.sensors.model import SensorModel, beyond_body
from tumble.sensors.parameters import Variable, limits_of, sensor_kind, variable_of
from tumble.units import Array, IntArray

LEVER_COLUMNS, SUPPORT_COLUMNS = 3, 24
"""Numbers of a lever, and of how what holds a device gives way: columns of `support_columns`."""
LEVER_U, SUPPORT_U = 0.5, 0.01
"""m: standard deviations of the lever from what holds a device to the instrument, and of each of the others."""
LEAST_FIELD = 1e-6
"""Of the field: no reading of a magnetometer is taken to be better known."""
LAG_HELD = 1e-3
"""s: standard deviation of a lag that is held."""
MAGNETIC_ROWS = slice(9, 12)
"""The rows of a link that are those of a magnetometer at the node before it."""
OWN: tuple[Variable, ...] = ("time", "launch")
"""What the changes go with that each of several sessions has of its own."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Prior:
    """What is known beforehand.

    Parameters
    ----------
    parameters
        Standard deviations, SI, of parameters about their start values, by name; others have their limit or their usual
        size.
    attitude
        Standard deviation of the attitudes about those of the programme, rad an axis.
    covariance : (1 + m, 1 + m)
        Of gravity and the parameters; it takes the place of `parameters`.
    undisturbed
        Whether the rests are parts of one: nothing but the noise and the in-run biases changes readings from one to the
        next, and those of all sensors of a kind are alike.
    """

    parameters: Mapping[str, float] = field(default_factory=dict)
    attitude: float | None = None
    covariance: Array | None = None
    undisturbed: bool = False


NO_PRIOR = Prior()


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Point:
    """Where the likelihood is taken: parameters (m,), gravity, attitudes (M, 3, 3) of the stations, and what each
    session has of its own (S, q); of a device that moves its velocities, m/s, in the body, and its displacements, m, in
    the navigation frame (M, 3)."""

    values: Array
    gravity: float
    attitudes: Array
    local: Array = field(default_factory=lambda: np.zeros((1, 0)))
    velocities: Array = field(default_factory=lambda: np.zeros((0, 3)))
    displacements: Array = field(default_factory=lambda: np.zeros((0, 3)))

    def moved(
        self,
        parameters: Array,
        angles: Array,
        local: Array | None = None,
        velocities: Array | None = None,
        displacements: Array | None = None,
    ) -> Point:
        """The point after steps of gravity and the parameters (1 + m,), of the angles (M, 3) of the attitudes, of what
        each session has of its own (S, q), and of the velocities, with these displacements. The heading turns
        everything about the vertical, exactly: it may be off by much."""
        tilt = (bases(self.attitudes)[:, :, :2] @ angles[:, :2, None])[:, :, 0]
        return Point(
            values=self.values + parameters[1:],
            gravity=self.gravity + parameters[0],
            attitudes=rotation_matrix(angles[:, 2:] * UP) @ self.attitudes @ rotation_matrix(tilt),
            local=self.local if local is None else self.local + local,
            velocities=self.velocities if velocities is None else self.velocities + velocities,
            displacements=self.displacements if displacements is None else displacements,
        )


def bases(attitudes: Array) -> Array:
    """Columns t₁, t₂, u (M, 3, 3) of every station: north, west and up in the body."""
    return np.stack([attitudes[:, 0], -attitudes[:, 2], attitudes[:, 1]], axis=2)


def support_columns(attitudes: Array) -> Array:
    """By how much what holds a device gives way with its attitude: columns (M, 3, SUPPORT_COLUMNS) of displacements, in
    the navigation frame, that are linear in the vertical u in the body, and its products u_k u_l less those of a
    sphere. Arms bend and tripods sag; a motion that follows the attitude would be taken for scale factors and axes."""
    u = attitudes[:, 1]
    x, y, z = u.T
    of_vertical = np.stack([x, y, z, x * y, x * z, y * z, x * x - y * y, z * z - 1.0 / 3.0], axis=1)
    return np.asarray(np.einsum("kr,mc->mkrc", np.eye(3), of_vertical).reshape(len(u), 3, SUPPORT_COLUMNS))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class SessionSpan:
    """Where one of several sessions stands among the rests, stations and turns of all, the turn among its own after
    each of its rests, or −1, and the rest (K,) among its own before each of its turns."""

    rests: slice
    stations: slice
    turns: slice
    link: IntArray
    first: IntArray


@dataclass(frozen=True, kw_only=True, eq=False)
class Problem:
    """A session, or several of one instrument, as the likelihood sees it.

    Parameters
    ----------
    observations, instrument, prior
        What was observed, the parameters that sessions have in common, and what is known beforehand.
    link : (M,)
        The turn after each station, or −1. Stations are the rests and, of a device that moves, the nodes between them.
    chain : (M,)
        The number of the chain of turns and links that each station belongs to.
    station : (N,)
        The station of each rest.
    earth : (3,)
        The Earth's rate, rad/s; zero where the latitude is not known, its part along the vertical where
        `earth_in_biases`.
    earth_in_biases
        Whether the Earth's rate is taken as a part of the biases of the gyros: in one attitude nothing tells them
        apart, unless the biases were known beforehand.
    prior_mean, prior_u : (1 + m,)
        Gravity and the parameters as they were known before, and their standard deviations; of gravity zero where it is
        taken as exact.
    usual_u : (1 + m,)
        `prior_u` with every group of its usual size.
    variables
        What parameters may change with.
    parts
        Where the sessions stand.
    of_session : ((N,), (K,))
        The session of every rest and turn.
    before_turn : (K,)
        The station before each turn.
    local
        What each of several sessions has beside the linear model that others do not share, None of a single session.
    local_u, usual_local_u : (q,)
        Standard deviations of the priors of these, and those of usual size.
    at_lags
        The lags at which the variables are.
    magnetometer
        The magnetometer, of which a session has its unknowns beside; None without one.
    bias_after
        The share of the in-run bias of a turn that is that of the rest after it; the other is of the rest before.
    """

    observations: Observations
    instrument: Instrument
    prior: Prior
    link: IntArray
    chain: IntArray
    station: IntArray
    earth: Array
    earth_in_biases: bool
    prior_mean: Array
    prior_u: Array
    usual_u: Array
    variables: Variables
    parts: tuple[SessionSpan, ...]
    of_session: tuple[IntArray, IntArray]
    before_turn: IntArray
    local: Instrument | None
    local_u: Array
    usual_local_u: Array
    at_lags: tuple[float, ...] = ()
    bias_after: float = 0.5
    magnetometer: Magnetometer | None = None

    @staticmethod
    def of(
        observations: Observations,
        prior: Prior = NO_PRIOR,
        *,
        instrument: Instrument | None = None,
        local: Instrument | None = None,
        usual: Mapping[str, float] | None = None,
    ) -> Problem:
        """The problem of one session or of several.

        Parameters
        ----------
        observations, prior
            What was observed, and what is known beforehand.
        instrument
            The parameters; those of the linear model where None.
        local
            Groups that every session has by itself.
        usual
            Standard deviations of the priors of further groups, SI, by name.

        Raises
        ------
        ValueError
            Unless turns join neighbouring rests, at most one each.
        """
        accel, gyro, site = observations.accel_block, observations.gyro_block, observations.site
        instrument = instrument or Instrument(accel=accel, gyro=gyro)
        turns, links, N = observations.turns, observations.links, len(observations.rests)
        station = np.arange(N) if links is None else links.rest
        link = np.full(N if links is None else len(links.time), -1, dtype=np.int64)
        before = np.zeros(0, dtype=np.int64) if turns is None else station[turns.first]
        if turns is not None and len(turns):
            if np.any(turns.last != turns.first + 1) or np.bincount(turns.first).max() > 1:
                raise ValueError("turns: expected at most one between neighbouring rests, found others")
            link[before] = np.arange(len(turns))
        joined = link >= 0
        if links is not None:
            joined[links.before] = True
        u = limits_of(instrument.names)
        for name, members in instrument.members.items():
            u[members] = (usual or {}).get(name, u[members])
            if variable_of(name) == "lag":  # the estimate holds it: `tumble.inference.lag`
                u[members] = LAG_HELD
        u = np.array([prior.parameters.get(n, size) for n, size in zip(instrument.names, u.tolist(), strict=True)])
        start = np.array([observations.start.get(name, 0.0) for name in instrument.names])
        local_u = np.zeros(0)
        for group in () if local is None else local.further:
            size = (usual or {}).get(group.name, group.limit)
            local_u = np.append(local_u, np.full(len(group.names(local.block(group))), size))  # type: ignore[union-attr]
        if links is not None:
            local_u = np.concatenate([local_u, np.full(LEVER_COLUMNS, LEVER_U), np.full(SUPPORT_COLUMNS, SUPPORT_U)])
        session = np.zeros(len(link), dtype=np.int64) if observations.session is None else observations.session
        edges, turn_edges = (np.searchsorted(of, np.arange(session[-1] + 2)) for of in (session, session[before]))
        parts = tuple(
            SessionSpan(
                rests=slice(*np.searchsorted(station, [rest, rest_end]).tolist()),
                stations=slice(rest, rest_end),
                turns=slice(turn, turn_end),
                link=np.where(link[rest:rest_end] < 0, -1, link[rest:rest_end] - turn),
                first=before[turn:turn_end] - rest,
            )
            for rest, rest_end, turn, turn_end in zip(edges, edges[1:], turn_edges, turn_edges[1:], strict=False)
        )
        prior_u = np.append(site.gravity_u, u)
        earth = np.zeros(3) if site.latitude is None else np.array(earth_rate(site.latitude))
        earth_in_biases = prior.covariance is None and observations.one_attitude
        if earth_in_biases:
            earth *= UP
        return Problem(
            observations=observations,
            instrument=instrument,
            prior=prior,
            link=link,
            chain=np.append(0, np.cumsum(~joined[:-1])),
            station=station,
            earth=earth,
            earth_in_biases=earth_in_biases,
            prior_mean=np.append(site.gravity, start),
            prior_u=prior_u,
            usual_u=prior_u,
            variables=variables_of(observations),
            parts=parts,
            of_session=(session[station], session[before]),
            before_turn=before,
            local=local,
            local_u=local_u,
            usual_local_u=local_u,
        )

    @cached_property
    def changes(self) -> list[tuple[slice, slice, Variable]]:
        """Where the parameters stand that are changes of others, those of each session after the common ones, where
        the others stand, and what they go with."""
        if self.local is None:
            return self.instrument.changes
        further = len(self.instrument.names) - self.local.linear_count
        shifted = [
            (slice(own.start + further, own.stop + further), base, variable)
            for own, base, variable in self.local.changes
        ]
        return self.instrument.changes + shifted

    @cached_property
    def local_members(self) -> dict[str, slice]:
        """Where the groups stand among what each session has of its own."""
        if self.local is None:
            return {}
        first, members = self.local.linear_count, self.local.members
        return {g.name: slice(members[g.name].start - first, members[g.name].stop - first) for g in self.local.further}

    @property
    def biases(self) -> IntArray:
        """Where the biases of all sensors stand among the parameters."""
        columns = [self.instrument.group_columns[f"{block.kind}.bias"] for block in self.instrument.blocks]
        return np.concatenate([np.arange(len(self.instrument.names))[each] for each in columns])

    @property
    def moves(self) -> bool:
        """Whether there are links: then stations have velocities and displacements."""
        return self.observations.links is not None

    @property
    def before_link(self) -> IntArray:
        """The station before each link (J,)."""
        links = self.observations.links
        return np.zeros(0, dtype=np.int64) if links is None else links.before

    @property
    def sensors(self) -> int:
        """How many accelerometers and gyros there are."""
        return sum(block.size for block in self.instrument.blocks)

    @cached_property
    def lags(self) -> dict[str, int]:
        """Where the lags behind the thermometers stand among the parameters, by kind of sensor."""
        members = self.instrument.members
        return {kind: members[f"{kind}.lag"].start for kind in KINDS if f"{kind}.lag" in members}

    def with_magnetometer(self, magnetometer: Magnetometer) -> Problem:
        """The problem with the readings of a magnetometer, whose unknowns come first of those that a session has."""
        u = np.concatenate([magnetometer.u, self.local_u])
        return replace(self, magnetometer=magnetometer, local_u=u, usual_local_u=u)

    def _changed(self, **fields: Any) -> Problem:
        """The problem with other fields, and with all that was made of those that stay."""
        out = copy(self)
        if "variables" in fields:
            vars(out).pop("regressors", None)
        vars(out).update(fields)
        return out

    def with_sizes(self, prior_u: Array, local_u: Array) -> Problem:
        """The problem with priors of other standard deviations (1 + m,) and (q,)."""
        return self._changed(prior_u=prior_u, local_u=local_u)

    def with_lags(self, values: Array) -> Problem:
        """The problem in which the lags are known to have the values they have among those of the parameters (m,)."""
        mean, at = self.prior_mean.copy(), list(self.lags.values())
        mean[1:][at] = values[at]
        return self._changed(prior_mean=mean)

    def with_lags_at(self, point: Point) -> Problem:
        """The problem with the temperatures that the sensors have by the lags at a point."""
        lags = {kind: float(point.values[at]) for kind, at in self.lags.items()}
        if tuple(lags.values()) == self.at_lags:
            return self
        return self._changed(variables=variables_of(self.observations, lags), at_lags=tuple(lags.values()))

    def regressor(self, variable: Variable, own: slice, place: int) -> Array:
        """What the parameters at `own` go with (·, m), or (·, 1) where all go with the same, at rest (`place` 0) or in
        the turns (1): each with the temperature of its sensor."""
        every = self.variables[variable][place]
        if every.shape[1] == 1:
            return every
        of_gyros = sensor_kind(self.instrument.names[own.start]) == "gyro"
        return every[:, self.instrument.thermometers[own] + of_gyros * every.shape[1] // 2]

    @cached_property
    def change_columns(self) -> tuple[IntArray, IntArray]:
        """Where the parameters (c,) stand that are changes of others, and where these stand."""
        every, none = np.arange(self.width), np.arange(0)
        own = np.concatenate([none, *(every[own] for own, _, _ in self.changes)])
        return own, np.concatenate([none, *(every[base] for _, base, _ in self.changes)])

    def _regressors_at(self, place: int) -> Array:
        """What the changes (·, c) go with at rest (`place` 0), in the turns (1), or by how much a second that grows in
        them (2)."""
        out, first = np.zeros((len(self.of_session[min(place, 1)]), len(self.change_columns[0]))), 0
        for own, _, variable in self.changes:
            last = first + own.stop - own.start
            out[:, first:last] = self.regressor(variable, own, place)
            first = last
        return out

    @cached_property
    def regressors(self) -> tuple[Array, Array, Array]:
        """What the changes go with, (N, c), (K, c) and (K, c)."""
        return self._regressors_at(0), self._regressors_at(1), self._regressors_at(GROWING)

    def change_values(self, point: Point, place: int) -> Array:
        """The values (·, c) of the changes at every rest (`place` 0) or turn (1), those of its session."""
        of, own = self.of_session[place], self.change_columns[0]
        if not len(self.local_u):
            return np.broadcast_to(point.values[own], (len(of), len(own)))
        every = np.concatenate(
            [np.broadcast_to(point.values, (len(point.local), len(point.values))), point.local], axis=1
        )
        return np.asarray(every[:, own][of])

    @cached_property
    def noise(self) -> NoiseModel:
        """The part of the noise of the rows that does not change with the parameters."""
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
    def noise_of_parts(self) -> tuple[Array, Array]:
        """Standard deviations of the rotations, rad, and velocities, m/s, of the parts of the links."""
        links = self.observations.links
        assert links is not None
        seconds = np.repeat(links.duration / PARTS, PARTS)
        return np.sqrt(links.gyro_density * seconds), np.sqrt(links.accel_density * seconds)

    @property
    def width(self) -> int:
        """How many parameters there are, with what a session has of its own."""
        return len(self.instrument.names) + len(self.local_u)

    @cached_property
    def earth_turned(self) -> Array:
        """How the Earth turns back (K, 3, 3) over the turns."""
        turns = self.observations.turns
        return np.zeros((0, 3, 3)) if turns is None else rotation_matrix(-turns.duration[:, None] * self.earth)

    def coefficient_changes(self, point: Point) -> Array | None:
        """By how much the coefficients (K, n, 15) of accelerometers and gyros differ in the turns from those of the
        parameters, being changed by time, temperature or launch; None where nothing changes."""
        if not self.changes:
            return None
        D = self.instrument.linearised(point.values)[1][:, :, self.change_columns[1]]
        change = self.with_lags_at(point).regressors[1] * self.change_values(point, 1)
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


# -------------------- noise --------------------


def noise_model(problem: Problem, noise: NoiseModel, gained: Array) -> NoiseModel:
    """The noise of the rows of a problem, docs/explanation/mathematics.md (16), (17), without scatter.

    Parameters
    ----------
    problem, noise
        The session or sessions, and the part of the noise that does not change with the attitudes.
    gained : (K, 3)
        Velocity, m/s, that gravity gives each turn, in the body at its start. What errs in a rotation on the way turns
        it, and so errs in the velocity of the turn too.
    """
    turns, (Z, component) = problem.observations.turns, noise.turn_directions
    if turns is None or not len(Z) or not problem.instrument.in_velocities:
        return noise
    across, Z, turn = skew(-0.5 * gained), Z.copy(), noise.turn.copy()
    rotation, constant = turn[:, :3, :3], turns.duration[:, None, None] ** 2 * unseen_rate(problem)
    by_rotation = across @ (rotation - constant * np.eye(3)) @ np.swapaxes(across, 1, 2)
    turn[:, 3:6, :3] = across @ rotation
    turn[:, :3, 3:6] = np.swapaxes(turn[:, 3:6, :3], 1, 2)
    turn[:, 3:6, 3:6] += turns.arising[:, None, None] * by_rotation
    turn[:, 3:6, 3:6] += constant * across @ np.swapaxes(across, 1, 2)
    Z[:, 3:6, -3:] = across @ Z[:, :3, -3:]
    return replace(noise, turn=turn, turn_directions=(Z, component))


def unseen_rate(problem: Problem) -> float:
    """The variance, rad²/s², of the Earth's rate along an axis where the latitude is not known, beside the biases."""
    unknown = problem.observations.site.latitude is None and not problem.earth_in_biases
    return EARTH_RATE**2 / 3.0 if unknown else 0.0


def _noise_of_session(problem: Problem) -> NoiseModel:
    """The part of the noise that does not change with the parameters: without what an error of the rotation on the way
    does to the velocity."""
    observations, rests, turns = problem.observations, problem.observations.rests, problem.observations.turns
    gyro, n, earth = observations.gyro_block, rests.accel.shape[1], unseen_rate(problem)
    blocks = [rests.accel_covariance]
    if gyro is not None:
        blocks.append(rests.gyro_covariance + earth * gyro.axes @ gyro.axes.T)
    if problem.prior.attitude is not None:
        blocks.append(np.broadcast_to(problem.prior.attitude**2 * np.eye(3), (len(rests), 3, 3)))
    mag = 0 if problem.magnetometer is None else 3
    if problem.magnetometer is not None:
        assert rests.magnetometer_covariance is not None
        blocks.append(rests.magnetometer_covariance + (LEAST_FIELD * problem.magnetometer.field) ** 2 * np.eye(3))
    rest, t, v = _diagonal(blocks), problem.rows_of_turn, 3 if problem.instrument.in_velocities else 0
    sensors, spare = n + rests.gyro.shape[1], t - v - 3
    along = np.zeros((rest.shape[1], sensors + mag))
    along[:sensors, :sensors], along[rest.shape[1] - mag :, sensors:] = np.eye(sensors), np.eye(mag)
    at_rest = np.broadcast_to(along, (len(rests), *along.shape))
    rest_places = np.repeat([0, 1, SCATTER.index("mag")], [n, sensors - n, mag])
    turn_places = np.repeat([2, 3, 4, 5, 7, 6], [3, v, spare, v, spare, 3])  # in SCATTER
    turn, Z = np.zeros((0, t, t)), np.zeros((len(problem.before_turn), t, len(turn_places)))
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
    links = observations.links
    file, time = (rests.file, 0.5 * (rests.start + rests.stop)) if links is None else (links.file, links.time)
    follows = np.ones(len(time), dtype=bool)
    follows[[part.stations.stop - 1 for part in problem.parts]] = False
    interval = np.append(np.where(file[1:] == file[:-1], np.abs(np.diff(time)), np.inf), np.inf)
    displaced = np.full(len(interval), np.inf)
    if links is not None:
        displaced[links.before[links.free]] = links.duration[links.free]
    return NoiseModel(
        rest=rest,
        turn=turn,
        link=np.zeros((0, 9, 9)),
        link_weights=np.ones((len(problem.before_link), 9 + mag * problem.moves)),
        rest_directions=(at_rest, rest_places),
        turn_directions=(Z, turn_places),
        link_directions=(np.zeros((0, 9, 0)), np.zeros(0, dtype=np.int64)),
        rest_weights=np.ones(rest.shape[:2]),
        turn_weights=np.ones(turn.shape[:2]),
        interval=interval,
        displaced=None if links is None else displaced,
        follows=follows,
        sensors=(problem.instrument.accel.size, problem.sensors - problem.instrument.accel.size),
    )


def _diagonal(blocks: list[Array]) -> Array:
    """Covariances (N, n, n) joined as blocks on the diagonal."""
    size = sum(b.shape[-1] for b in blocks)
    out, first = np.zeros((len(blocks[0]), size, size)), 0
    for block in blocks:
        last = first + block.shape[-1]
        out[:, first:last, first:last] = block
        first = last
    return out
