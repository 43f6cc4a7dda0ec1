"""The joint likelihood of everything recorded in a session: unknowns, residuals and their noise.

The unknowns are the parameters θ of the instrument, local gravity g, and the attitude L (body → geographic) of every
rest. The estimate minimises the sum of the squared residuals, each weighted by the inverse of its covariance
(docs/explanation/mathematics.md, sections 1 to 5):

    ŷ − Σ_b K_b(θ) β_b(f, ω)                   readings at rest, f = g u, u = Lᵀ e_U, ω = Lᵀ Ω
    log( C(θ) L_jᵀ e^{−[Ω×]T} L_i )            rotation of the turn from rest i to rest j, in the body axes at its start
    V(θ) − L_iᵀ ∫ e^{[Ω×]s} g e_U ds           velocity of the turn, where levers and delays are unknowns       (13)
    g − g₀                                     measured gravity

C(θ) = exp([φ×]) C and V(θ) are linearised about the parameters with which the turn was integrated: φ and V are of
first order in the coefficients K, with the moments of `tumble.reduction.turns.moments` as derivatives, and linear in
levers and delays. The residuals of a turn are (13) rotated into the axes of its covariance. The Coriolis term is left
out of (13): it is below 0.1 σ for a table whose axes are within a metre of each other. Gravity is the same at all
rests, so it is one unknown with one measurement. Table angles are used only with a `Prior` on attitudes. Parameters of
the linear model have their limits as priors, which matter only for parameters that the data leave undetermined; other
parameters have their usual sizes. With n > 3 gyros each turn has n − 3 further residuals, in the directions that no
rotation explains.

Several sessions of one instrument share its parameters. Each session has attitudes and changes of biases and scale
factors of its own, from launch to launch or with time (`SESSION_VARIABLES`), with priors; they are eliminated session
by session.

An attitude is updated in the body, L → L exp([δ×]), with δ in the basis t₁, t₂, u of the rest, so that

    du = u × δ = t₂ δ₁ − t₁ δ₂,   dω = ω × δ,   dr = J_r⁻¹(r) δ_i − J_l⁻¹(r) C δ_j + J_l⁻¹(r) J_l(φ) dφ             (14)

J_l(r) is the left Jacobian of the rotation group, J_r(r) = J_l(r)ᵀ. In this basis the coefficients of a heading that
the gyros do not observe vanish exactly: the heading stays free and takes no information from other unknowns.

Noise and in-run biases are those of `tumble.inference.noise`. Without a latitude the Earth's rate is noise of Ω/√3 per
axis. If all rests have one attitude, the unknown part of the Earth's rate is an error common to them all
(`tumble.inference.sources`), because a free heading in (14) would absorb a level direction of the biases.
"""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from tumble.earth import EARTH_RATE, earth_rate
from tumble.inference.magnetometer import Magnetometer
from tumble.inference.noise import SCATTER, STATIONS, NoiseModel, RowNoise
from tumble.inference.variables import GROWING, KINDS, Variables, variables_of
from tumble.reduction.observations import Observations
from tumble.reduction.turns.links import PARTS
from tumble.rotation import UP, rotation_matrix, skew
from tumble.sensors.instrument import Instrument
from tumble.sensors.model import SensorModel, left_null_space
from tumble.sensors.parameters import Variable, limits_of, sensor_kind, variable_of
from tumble.units import Array, IntArray

LEVER_COLUMNS, SUPPORT_COLUMNS = 3, 32  # unknowns of the lever from the pivot, and of `support_columns`
LEVER_U, SUPPORT_U = 0.5, 0.01  # m: standard deviations of their priors
LEAST_FIELD = 1e-6  # smallest standard deviation of a magnetometer reading, relative to the field
LAG_HELD = 1e-3  # s: prior standard deviation of a lag that is held fixed
# Components of variance of turns: of rotations, velocities and redundant gyros, then by jumps between samples.
OF_TURNS = "turn", "velocity", "apart", "jumps", "aliased_apart", "aliased"
SESSION_VARIABLES: tuple[Variable, ...] = ("time", "launch")  # variables of the changes that each session has


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Prior:
    """Prior knowledge beside the limits and usual sizes of the parameters.

    Parameters
    ----------
    parameters
        Standard deviations, SI, of parameters about their start values, by name, in place of limit or usual size.
    attitude
        Standard deviation of the attitudes about those of the programme, rad per axis.
    covariance : (1 + m, 1 + m)
        Covariance of gravity and the parameters, in place of `parameters`.
    undisturbed
        True if the rests are parts of one rest: then readings differ between them by noise and in-run biases only, and
        all sensors of a kind have the same in-run bias process.
    """

    parameters: Mapping[str, float] = field(default_factory=dict)
    attitude: float | None = None
    covariance: Array | None = None
    undisturbed: bool = False


NO_PRIOR = Prior()


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Point:
    """Values of the unknowns at which the likelihood is linearised.

    Parameters
    ----------
    values : (m,)
        Parameters, SI.
    gravity
        m/s².
    attitudes : (M, 3, 3)
        Attitudes of the stations, body → north, up, east.
    local : (S, q)
        Parameters of each session.
    velocities, displacements : (M, 3)
        For a moving device, m/s in the body and m in the navigation frame; (0, 3) otherwise.
    """

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
        """Return the point after steps of gravity and the parameters (1 + m,), of the angles (M, 3), of the parameters
        of each session (S, q) and of the velocities (M, 3), with new displacements (M, 3). The heading, which may be
        far off, is rotated exactly."""
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
    """Return the bases t₁, t₂, u (M, 3, 3): north, west and up in the body, as columns."""
    return np.stack([attitudes[:, 0], -attitudes[:, 2], attitudes[:, 1]], axis=2)


def support_columns(attitudes: Array) -> Array:
    """Return displacements of a device whose support bends with its attitude.

    Tripods sag and arms bend. A motion that follows the attitude would otherwise be taken for scale factors and axes.

    Returns
    -------
    (M, 3, SUPPORT_COLUMNS)
        Displacements in the navigation frame per unit coefficient: in each axis, the components of the vertical u in
        the body and the products u_k u_l, without the constant u·u; and displacements in the body, as of an arm that
        bends under its weight, of each axis by each component of u, without that of z by z, which follows from those
        of x by x and y by y.
    """
    u = attitudes[:, 1]
    x, y, z = u.T
    by_vertical = np.stack([x, y, z, x * y, x * z, y * z, x * x - y * y, z * z - 1.0 / 3.0], axis=1)
    sagging = np.einsum("kr,mc->mkrc", np.eye(3), by_vertical).reshape(len(u), 3, -1)
    bending = (attitudes[:, :, :, None] * u[:, None, None]).reshape(len(u), 3, 9)[:, :, :-1]
    return np.concatenate([sagging, bending], axis=2)


class MagneticReadings(NamedTuple):
    """Readings (K, 3) of a magnetometer, in its unit, at rests and then at nodes, with covariances (K, 3, 3), the rates
    of the body (K, 3), rad/s, and the stations (K,)."""

    values: Array
    covariance: Array
    rates: Array
    station: IntArray


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class SessionSpan:
    """Slices of one session in the stations and in the blocks of rows of each kind of all sessions."""

    stations: slice
    rows: Mapping[str, slice]

    @property
    def rests(self) -> slice:
        """Slice of the rests."""
        return self.rows["accel"]

    @property
    def turns(self) -> slice:
        """Slice of the turns."""
        return self.rows["turn"]


@dataclass(frozen=True, kw_only=True, eq=False)
class Problem:
    """Estimation problem of one session, or of several sessions of one instrument.

    Parameters
    ----------
    observations, instrument, prior
        Observations, the parameters common to all sessions, and prior knowledge.
    earth : (3,)
        The Earth's rate, rad/s: zero without a latitude, and its vertical part only if `earth_in_biases`.
    earth_in_biases
        True if the Earth's rate counts as part of the gyro biases, from which it cannot be separated in one attitude
        unless the biases have a prior covariance.
    prior_mean, prior_u : (1 + m,)
        Prior means and standard deviations of gravity and the parameters; `prior_u[0]` is 0 if gravity is exact.
    usual_u : (1 + m,)
        `prior_u` with every group of its usual size.
    local
        Instrument whose further groups each session has for itself; None for a single session.
    local_u, usual_local_u : (q,)
        Prior standard deviations of the parameters of a session, and those of usual size.
    temperature_lags
        Lags of the sensor temperatures behind the thermometers, s, by kind of sensor.
    magnetometer
        The magnetometer, whose unknowns come first among the parameters of a session; None without one.
    bias_after
        Weight of the in-run bias after a turn in the bias during the turn; that before it has the remaining weight.
    """

    observations: Observations
    instrument: Instrument
    prior: Prior
    earth: Array
    earth_in_biases: bool
    prior_mean: Array
    prior_u: Array
    usual_u: Array
    local: Instrument | None
    local_u: Array
    usual_local_u: Array
    temperature_lags: Mapping[str, float] = field(default_factory=dict)
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
        """Return the problem of one session or of several.

        Parameters
        ----------
        observations, prior
            Observations and prior knowledge.
        instrument
            The parameters; those of the linear model if None.
        local
            Instrument whose further groups each session has for itself.
        usual
            Prior standard deviations of further groups, SI, by name.

        Raises
        ------
        ValueError
            Unless turns join neighbouring rests, at most one each.
        """
        accel, gyro, site = observations.accel_block, observations.gyro_block, observations.site
        instrument = instrument or Instrument(accel=accel, gyro=gyro)
        turns, links = observations.turns, observations.links
        if turns is not None and (np.any(turns.last != turns.first + 1) or np.any(np.bincount(turns.first) > 1)):
            raise ValueError("turns: expected at most one between neighbouring rests, found others")
        u = limits_of(instrument.names)
        for name, members in instrument.members.items():
            u[members] = (usual or {}).get(name, u[members])
            if variable_of(name) == "lag":  # held fixed here, and estimated by `tumble.inference.lag`
                u[members] = LAG_HELD
        u = np.array([prior.parameters.get(n, size) for n, size in zip(instrument.names, u.tolist(), strict=True)])
        start = np.array([observations.start.get(name, 0.0) for name in instrument.names])
        local_u = np.zeros(0)
        for group in () if local is None else local.further:
            size = (usual or {}).get(group.name, group.limit)
            local_u = np.append(local_u, np.full(len(group.names(local.block(group))), size))  # type: ignore[union-attr]
        if links is not None:
            local_u = np.concatenate([local_u, np.full(LEVER_COLUMNS, LEVER_U), np.full(SUPPORT_COLUMNS, SUPPORT_U)])
        prior_u = np.append(site.gravity_u, u)
        earth = np.zeros(3) if site.latitude is None else np.array(earth_rate(site.latitude))
        earth_in_biases = prior.covariance is None and observations.one_attitude
        if earth_in_biases:
            earth *= UP
        return Problem(
            observations=observations,
            instrument=instrument,
            prior=prior,
            earth=earth,
            earth_in_biases=earth_in_biases,
            prior_mean=np.append(site.gravity, start),
            prior_u=prior_u,
            usual_u=prior_u,
            local=local,
            local_u=local_u,
            usual_local_u=local_u,
        )

    @cached_property
    def changes(self) -> list[tuple[slice, slice, Variable]]:
        """Places of parameters that are changes of others, places of these others, and the variables of the changes.

        The parameters of a session are counted after the common ones."""
        if self.local is None:
            return self.instrument.changes
        further = len(self.instrument.names) - self.local.linear_count
        return self.instrument.changes + [
            (slice(columns.start + further, columns.stop + further), base, variable)
            for columns, base, variable in self.local.changes
        ]

    @cached_property
    def local_members(self) -> dict[str, slice]:
        """Places of groups among the parameters of a session."""
        if self.local is None:
            return {}
        first, members = self.local.linear_count, self.local.members
        return {g.name: slice(members[g.name].start - first, members[g.name].stop - first) for g in self.local.further}

    @property
    def biases(self) -> IntArray:
        """Places of the biases of all sensors among the parameters."""
        columns = [self.instrument.group_columns[f"{block.kind}.bias"] for block in self.instrument.blocks]
        return np.concatenate([np.arange(len(self.instrument.names))[group] for group in columns])

    @property
    def moves(self) -> bool:
        """True if there are links; then stations have velocities and displacements."""
        return self.observations.links is not None

    @cached_property
    def station(self) -> IntArray:
        """Station of each rest (N,). Stations are the rests and, of a moving device, the nodes between them."""
        links = self.observations.links
        return np.arange(len(self.observations.rests)) if links is None else links.rest

    @property
    def before_turn(self) -> IntArray:
        """Station before each turn (K,)."""
        turns = self.observations.turns
        return self.station[np.zeros(0, dtype=np.int64) if turns is None else turns.first]

    @cached_property
    def first_station(self) -> dict[str, IntArray]:
        """Kinds of rows, with the first station of each of their blocks."""
        out = dict[str, IntArray]()
        out |= {block.kind: self.station for block in self.instrument.blocks}
        if self.prior.attitude is not None:
            out["attitude"] = self.station
        if self.magnetometer is not None and self.magnetic is not None:
            out["mag"] = self.magnetic.station
        out["turn"] = self.before_turn
        return out if self.observations.links is None else out | {"link": self.observations.links.before}

    @cached_property
    def chain(self) -> IntArray:
        """Number of the chain of turns and links that each station (M,) belongs to."""
        links = self.observations.links
        joined = np.zeros(len(self.station if links is None else links.time), dtype=bool)
        for kind in self.first_station.keys() & {"turn", "link"}:
            joined[self.first_station[kind]] = True
        return np.append(0, np.cumsum(~joined[:-1]))

    @cached_property
    def session_of_station(self) -> IntArray:
        """Number of the session of each station (M,)."""
        session = self.observations.session
        return np.zeros(len(self.chain), dtype=np.int64) if session is None else session

    @cached_property
    def session_spans(self) -> tuple[SessionSpan, ...]:
        """Slices of the sessions."""
        stations = np.searchsorted(self.session_of_station, np.arange(self.session_of_station[-1] + 2)).tolist()
        edges = {kind: np.searchsorted(first, stations).tolist() for kind, first in self.first_station.items()}
        return tuple(
            SessionSpan(
                stations=slice(*stations[s : s + 2]), rows={kind: slice(*at[s : s + 2]) for kind, at in edges.items()}
            )
            for s in range(len(stations) - 1)
        )

    @cached_property
    def magnetic(self) -> MagneticReadings | None:
        """Readings of the magnetometer at the stations; None without them."""
        rests, links = self.observations.rests, self.observations.links
        readings = list[tuple[Array, Array, Array, IntArray]]()
        if rests.magnetometer is not None and rests.magnetometer_covariance is not None:
            no_rates = np.zeros_like(rests.magnetometer)
            readings.append((rests.magnetometer, rests.magnetometer_covariance, no_rates, self.station))
        if links is not None and links.magnetometer is not None:
            valid = links.magnetic
            covariance = np.broadcast_to(links.magnetometer_variance * np.eye(3), (valid.sum(), 3, 3))
            rates = links.rates[::PARTS, 0][valid]
            readings.append((links.magnetometer[valid], covariance, rates, links.before[valid]))
        return MagneticReadings(*map(np.concatenate, zip(*readings, strict=True))) if readings else None

    @property
    def sensors(self) -> int:
        """Number of accelerometers and gyros."""
        return sum(block.size for block in self.instrument.blocks)

    @cached_property
    def lag_places(self) -> dict[str, int]:
        """Places of the thermometer lags among the parameters, by kind of sensor."""
        members = self.instrument.members
        return {kind: members[f"{kind}.lag"].start for kind in KINDS if f"{kind}.lag" in members}

    def _changed(self, **fields: Any) -> Problem:
        """Return the problem with other fields, keeping the cached properties that do not depend on them."""
        out = copy(self)
        vars(out).update(fields)
        return out

    def with_sizes(self, prior_u: Array, local_u: Array) -> Problem:
        """Return the problem with other prior standard deviations (1 + m,) and (q,)."""
        return self._changed(prior_u=prior_u, local_u=local_u)

    def with_held_lags(self, values: Array) -> Problem:
        """Return the problem whose priors hold the lags at those among the parameters `values` (m,)."""
        mean, places = self.prior_mean.copy(), list(self.lag_places.values())
        mean[1:][places] = values[places]
        return self._changed(prior_mean=mean)

    def with_lagged_temperatures(self, point: Point) -> Problem:
        """Return the problem with the sensor temperatures at the lags of a point."""
        lags = {kind: float(point.values[place]) for kind, place in self.lag_places.items()}
        if lags == self.temperature_lags:
            return self
        out = self._changed(temperature_lags=lags)
        for depending in ("variables", "regressors"):
            vars(out).pop(depending, None)
        return out

    @cached_property
    def variables(self) -> Variables:
        """The variables with which parameters change."""
        return variables_of(self.observations, self.temperature_lags)

    @cached_property
    def change_columns(self) -> tuple[IntArray, IntArray]:
        """Places (c,) of the parameters that are changes of others, and places (c,) of these others."""
        places, empty = np.arange(len(self.instrument.names) + len(self.local_u)), np.arange(0)
        columns = np.concatenate([empty, *(places[columns] for columns, _, _ in self.changes)])
        return columns, np.concatenate([empty, *(places[base] for _, base, _ in self.changes)])

    def columns_of(self, places: IntArray) -> IntArray:
        """Return the columns of rows (`zero_rows`), from the last, for parameters at these places."""
        m, q = len(self.instrument.names), len(self.local_u)
        return np.where(places < m, places - 1 - m, places - 2 - 2 * m - q)

    @cached_property
    def regressors(self) -> tuple[Array, Array, Array]:
        """Regressors of the changes at rest (N, c) and in the turns (K, c), and their growth there, 1/s (K, c)."""

        def at(place: int, rows: int) -> Array:
            columns = list[Array]()
            for members, _, variable in self.changes:
                values = self.variables[variable][place]
                if values.shape[1] > 1:  # each parameter has the temperature of its sensor
                    is_gyro = sensor_kind(self.instrument.names[members.start]) == "gyro"
                    values = values[:, self.instrument.thermometers[members] + is_gyro * values.shape[1] // 2]
                columns.append(np.broadcast_to(values, (rows, members.stop - members.start)))
            return np.concatenate([np.zeros((rows, 0)), *columns], axis=1)

        turns = len(self.before_turn)
        return at(0, len(self.station)), at(1, turns), at(GROWING, turns)

    def change_values(self, point: Point, stations: IntArray) -> Array:
        """Return the values (K, c) of the changes in the sessions of stations (K,)."""
        common = np.broadcast_to(point.values, (len(point.local), len(point.values)))
        every = np.concatenate([common, point.local], axis=1)
        return np.asarray(every[:, self.change_columns[0]][self.session_of_station[stations]])

    @cached_property
    def noise(self) -> NoiseModel:
        """The part of the noise that does not depend on the parameters."""
        return _constant_noise(self)

    @property
    def rows_of_turn(self) -> int:
        """Number of rows of a turn: rotation, velocity where it is predicted, and n − 3 spare directions of n gyros."""
        gyro, velocity = self.instrument.gyro, 3 if self.instrument.in_velocities else 0
        return 3 + velocity + (0 if gyro is None or self.observations.turn_readings is None else gyro.size - 3)

    @cached_property
    def noise_of_turns(self) -> tuple[Array, Array]:
        """Standard deviations (K,) of rotations, rad, and velocities, m/s, of the turns, root mean square over axes.

        Velocities that are not predicted have an infinite one."""
        turns = self.observations.turns
        assert turns is not None
        rotation = np.sqrt(np.trace(turns.covariance, axis1=1, axis2=2) / 3.0)
        if not self.instrument.in_velocities:
            return rotation, np.full_like(rotation, np.inf)
        return rotation, np.sqrt(np.trace(turns.velocity_covariance, axis1=1, axis2=2) / 3.0)

    @property
    def noise_of_parts(self) -> tuple[Array, Array]:
        """Standard deviations of rotations, rad, and velocities, m/s, of the parts of the links."""
        links = self.observations.links
        assert links is not None
        seconds = np.repeat(links.duration / PARTS, PARTS)
        return np.sqrt(links.gyro_density * seconds), np.sqrt(links.accel_density * seconds)

    @property
    def bias_columns(self) -> slice:
        """Columns of rows for the biases of all sensors at the first station."""
        first = 6 if self.moves else 3
        return slice(first, first + self.sensors)

    @property
    def station_columns(self) -> int:
        """Number of columns of rows for the unknowns of a station."""
        return int(self.bias_columns.stop) + 3 * self.moves

    def zero_rows(self, kind: str, rows: int) -> Array:
        """Return zero rows (K, rows, ·) of a kind.

        Columns: for each station the three angles, three velocities of a moving device, the biases of all sensors and
        three displacements of a moving device; then, at the end, the parameters of the session, gravity, the common
        parameters, and the residual, observed less predicted."""
        shared = len(self.local_u) + len(self.instrument.names) + 2
        return np.zeros((len(self.first_station[kind]), rows, STATIONS[kind] * self.station_columns + shared))

    def coefficient_changes(self, point: Point) -> Array | None:
        """Return the changes (K, n, 15) of the coefficients in the turns by time, temperature or launch.

        None if no parameter changes."""
        if not self.changes:
            return None
        D = self.instrument.linearised(point.values)[1][:, :, self.change_columns[1]]
        change = self.with_lagged_temperatures(point).regressors[1] * self.change_values(point, self.before_turn)
        return np.asarray(change @ D.reshape(-1, D.shape[2]).T).reshape(len(change), *D.shape[:2])

    @cached_property
    def spread(self) -> Array:
        """Limits (m,) of the parameters, by which they are scaled."""
        return limits_of(self.instrument.names)

    def accel_model(self, values: Array) -> SensorModel:
        """Return the model of the accelerometers with parameters (m,)."""
        return self.instrument.model(self.observations.accel_block, values)

    def gyro_model(self, values: Array) -> SensorModel:
        """Return the model of the gyros with parameters (m,)."""
        assert self.observations.gyro_block is not None
        return self.instrument.model(self.observations.gyro_block, values)


def instruments_of(observations: Observations) -> tuple[Instrument, Instrument | None]:
    """Return the instrument of the observations, and the one with the groups that each of several sessions has.

    The groups are those whose usual size the observations state and whose variable they record."""
    blocks, usual = (observations.accel_block, observations.gyro_block), observations.usual
    variables = set(variables_of(observations))
    if observations.together is None:
        return Instrument.of(*blocks, usual, variables), None
    local = Instrument.of(*blocks, usual, SESSION_VARIABLES)
    local = replace(local, further=tuple(group for group in local.further if group.variable in SESSION_VARIABLES))
    return Instrument.of(*blocks, usual, variables - set(SESSION_VARIABLES)), local


# -------------------- noise --------------------


def unknown_earth_variance(problem: Problem) -> float:
    """Return the variance, rad²/s² per axis, of the Earth's rate if the latitude is unknown and the biases are not."""
    unknown = problem.observations.site.latitude is None and not problem.earth_in_biases
    return EARTH_RATE**2 / 3.0 if unknown else 0.0


def _constant_noise(problem: Problem) -> NoiseModel:
    """Return the noise of all rows but links, without the errors of velocity by errors of rotation."""
    observations, rests, links = problem.observations, problem.observations.rests, problem.observations.links
    gyro, earth = observations.gyro_block, unknown_earth_variance(problem)
    rows = {"accel": _noise_at_stations("accel", {"accel.noise": rests.accel_covariance})}
    if problem.instrument.gyro is not None and gyro is not None:
        sources = {"gyro.noise": rests.gyro_covariance}
        if earth > 0.0:
            sources["earth"] = np.broadcast_to(earth * gyro.axes @ gyro.axes.T, rests.gyro_covariance.shape)
        rows["gyro"] = _noise_at_stations("gyro", sources)
    if problem.prior.attitude is not None:
        attitude = np.broadcast_to(problem.prior.attitude**2 * np.eye(3), (len(rests), 3, 3))
        rows["attitude"] = _noise_at_stations("attitude", {"attitude": attitude})
    if problem.magnetometer is not None and problem.magnetic is not None:
        least = (LEAST_FIELD * problem.magnetometer.field) ** 2 * np.eye(3)
        rows["mag"] = _noise_at_stations("mag", {"mag.noise": problem.magnetic.covariance + least})
    rows["turn"] = _noise_of_turns(problem)

    # processes of the biases, within a file, and of the displacements, over free links
    if links is None:
        file, time = rests.file, 0.5 * (rests.start + rests.stop)
    else:
        file, time = links.file, links.time
    follows = np.ones(len(time), dtype=bool)
    follows[[part.stations.stop - 1 for part in problem.session_spans]] = False
    interval = np.full((len(time), problem.sensors + 3 * problem.moves), np.inf)
    interval[:-1, : problem.sensors] = np.where(file[1:] == file[:-1], np.abs(np.diff(time)), np.inf)[:, None]
    if links is not None:
        interval[links.before[links.free], problem.sensors :] = links.duration[links.free][:, None]
    return NoiseModel(
        rows=rows,
        interval=interval,
        follows=follows,
        sensors=(problem.instrument.accel.size, problem.sensors - problem.instrument.accel.size),
    )


def _noise_at_stations(kind: str, sources: Mapping[str, Array]) -> RowNoise:
    """Return the noise of rows of a kind, with the component of variance of its name, if any, in each of the r rows."""
    K, r, _ = next(iter(sources.values())).shape
    component = np.full(r, SCATTER.index(kind)) if kind in SCATTER else np.zeros(0, dtype=int)
    directions = np.broadcast_to(np.eye(r, len(component)), (K, r, len(component)))
    return RowNoise(sources=sources, directions=directions, component=component, weight=np.ones(K))


def _noise_of_turns(problem: Problem) -> RowNoise:
    """Return the noise of turns without the errors of velocity by errors of rotation."""
    turns, readings, gyro = problem.observations.turns, problem.observations.turn_readings, problem.instrument.gyro
    K, t, v = len(problem.before_turn), problem.rows_of_turn, 3 if problem.instrument.in_velocities else 0
    spare, earth = t - v - 3, unknown_earth_variance(problem)
    sources = {"turn.gyro.noise": np.zeros((K, t, t))}
    component = np.repeat([SCATTER.index(name) for name in OF_TURNS], [3, v, spare, v, spare, 3])
    Z = np.zeros((K, t, len(component)))
    if turns is not None and K:
        sources["turn.gyro.noise"][:, :3, :3] = turns.covariance
        if readings is not None and gyro is not None:
            free = left_null_space(gyro.axes)
            sources["turn.gyro.noise"][:, 3 + v :, 3 + v :] = free @ readings.covariance @ free.T
        if v:
            sources["turn.accel.noise"] = np.zeros((K, t, t))
            sources["turn.accel.noise"][:, 3:6, 3:6] = turns.velocity_covariance
        if earth > 0.0:
            sources["earth"] = np.zeros((K, t, t))
            sources["earth"][:, :3, :3] = turns.duration[:, None, None] ** 2 * earth * np.eye(3)
        jumps, aliased = np.sqrt(turns.jumps)[:, None, None], np.sqrt(turns.aliased)[:, None, None]
        Z[:, :, :t] = np.eye(t)
        Z[turns.duration <= 0.0, : 3 + v] = 0.0  # there is no turn between the parts of one rest
        Z[:, 3 : 3 + v, t : t + v] = jumps * np.eye(v)
        Z[:, 3 + v :, t + v : -3] = aliased * np.eye(spare)
        Z[:, :3, -3:] = aliased * np.eye(3)
    return RowNoise(sources=sources, directions=Z, component=component, weight=np.ones(K))


def with_errors_of_velocity(problem: Problem, rows: RowNoise, gained: Array) -> RowNoise:
    """Add to the noise of turns the errors of velocity that errors of rotation cause, (16) and (17).

    With X = −½ [ΔV×], an error φ of rotation that arises evenly over the turn adds X φ to the velocity `gained` (K, 3),
    m/s, that gravity gives the turn, in the body at its start."""
    turns = problem.observations.turns
    if turns is None or not len(turns) or not problem.instrument.in_velocities:
        return rows
    X, Z, sources = skew(-0.5 * gained), rows.directions.copy(), dict(rows.sources)
    Xt = np.swapaxes(X, 1, 2)
    for name, ratio in (("turn.gyro.noise", turns.moment_ratio), ("earth", np.ones(len(turns)))):
        if name in sources:
            covariance = sources[name] = sources[name].copy()
            rotation = covariance[:, :3, :3]
            covariance[:, 3:6, :3], covariance[:, :3, 3:6] = X @ rotation, rotation @ Xt
            covariance[:, 3:6, 3:6] = ratio[:, None, None] * (X @ rotation @ Xt)
    Z[:, 3:6, -3:] = X @ Z[:, :3, -3:]
    return replace(rows, sources=sources, directions=Z)
