"""Check positions: whether a calibration holds where it is looked at again.

In every position at rest, Eq. (21) of the ellipsoid method, with true = matrix⁻¹ (reading − bias):

    Δg = g − |true|

Where the positions did not take part in the calibration, Δg has the variance

    u² = noise of the rest + scatter between rests + vᵀ S⁻¹ ∂(S g v + b)/∂θ Σ (…)ᵀ + u(g)²

v being the vertical and Σ the covariance of the parameters. If the calibration was made with the same stated gravity,
its error is in the scale factors too and cancels. Where the positions are the calibration's own, each is left out in
turn: with the leverage h, the variance of |true| from the parameters over that of the position itself,

    Δg without the position = Δg / (1 − h),   u² = own variance / (1 − h)

which is exact for a linear fit. The plain residual would be too small by √(1 − h).

What turning on again changes is in no u: positions of the same power-on check a calibration to the noise, those of
another one could check it to the turn-on spread of the grade only. So a refusal says whether that spread explains it:

    Δgᵀ V⁻¹ Δg,   V = diag(own variance) + J (Σ + 2 diag(s_g²)) Jᵀ + u(g)²,   J = ∂|true|/∂θ

is then no larger than by chance; `tumble check` allows for it.

A calibration is refused where |Δg|/u of one position is beyond what happens by chance in CHANCE of all verifications,
Bonferroni over the positions, Student's t where the scatter was estimated from few rests.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tumble.brief import Brief
from tumble.errors import CalibrationError, InputError
from tumble.files import FilePath
from tumble.inference.estimate import Fit
from tumble.inference.variables import sensors_at
from tumble.methods.least_squares import sigmas
from tumble.recording.session import Session
from tumble.recording.session_file import session_from
from tumble.result.accepted import accepted_accelerometers
from tumble.result.calibration import Calibration, calibration_from
from tumble.result.parts import Readings
from tumble.run.calibrate import grade_of
from tumble.run.case import Verticals, verticals_of
from tumble.run.observed import inspect_session
from tumble.run.readings_table import read_table
from tumble.sensors.frames import Convention, frame_of, triad_axes
from tumble.sensors.grades import TURN_ON, spread_of
from tumble.sensors.instrument import Instrument, functions
from tumble.sensors.model import Block
from tumble.sensors.parameters import LINEAR, Variable, group_name, sensor_kind
from tumble.units import ZERO_CELSIUS, Array, engineering
from tumble.use.thermometers import check_thermometers

CHANCE = 0.01
"""How often a good calibration is refused."""

_OVER_TEMPERATURE: dict[Variable, int] = {"temperature": 1, "temperature²": 2}
"""What readings at a temperature change with, and its power."""

TURNED_ON = (
    "a usual change from one power-on to the next explains it: if the device was switched off since the calibration, "
    "`tumble check` allows for that"
)

VERIFIED = "positions at rest verify a calibration"

NOTHING_LEFT = 1e-6
"""1 − h below which nothing but the position itself determines what it is compared with."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Positions:
    """Readings at rest to verify a calibration with: mean readings (N, n) of a block with covariance (N, n, n), SI,
    what the positions are called, gravity with its standard uncertainty, m/s², the SHA-256 of their source, and where
    they are known the temperatures (N, n), °C, of the sensors and the grade."""

    block: Block
    readings: Array
    covariance: Array
    labels: tuple[str, ...]
    gravity: float
    gravity_u: float
    sha256: str
    celsius: Array | None = None
    grade: str | None = None


@dataclass(frozen=True, kw_only=True, slots=True, eq=False, repr=False)
class Verification(Brief):
    """Δg (N,) of every position with standard uncertainty `u` (N,), m/s², both without the position where
    `left_out`; `sigmas` (N,) is |Δg|/u (of positions left out studentised), `limit` what it may be; whether what
    turning on again usually changes explains them all, `by_turn_on`."""

    labels: tuple[str, ...]
    difference: Array
    u: Array
    sigmas: Array
    limit: float
    left_out: bool
    by_turn_on: bool = False

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why the calibration is not accepted; none if it is."""
        if not np.isfinite(self.sigmas).any():
            return ("nothing checks the calibration: as many positions as parameters; record check positions",)
        size, unit = engineering("m/s^2", float(np.nanmax(np.abs(self.difference))))
        said = tuple(
            f"{self.labels[i]}: Δg is {self.difference[i] / size:+.3g} {unit}, {self.sigmas[i]:.1f} of its standard "
            f"uncertainty, expected at most {self.limit:.1f}"
            for i in np.flatnonzero(self.sigmas > self.limit)
        )
        return (*said, TURNED_ON) if said and self.by_turn_on else said


def positions_of(given: Session | FilePath, calibration: Calibration) -> Positions:
    """The positions of a session, its folder, or a table of readings. Raises as `rests_of` and `positions_of_table`.

    >>> import tumble
    >>> request = tumble.Setup.of(grade="mems", positions=12)
    >>> folders = [tumble.simulate_session(f"launch-{i}", request, seed=1, launch=i) for i in (1, 2)]
    >>> tumble.positions_of(folders[1], tumble.calibrate(folders[0])).readings.shape
    (12, 3)
    """
    if not isinstance(given, Session) and not Path(given).is_dir():
        return positions_of_table(Path(given), calibration)
    session = session_from(given)
    if session.device.serial != calibration.serial:
        raise InputError(
            f"{session.name}: expected a session of device {calibration.serial!r}, which was calibrated, found "
            f"{session.device.serial!r}"
        )
    if calibration.accel is None:
        return rests_of(session)
    check_thermometers(calibration, session)
    return rests_of(session, calibration.compensator.lag)


def rests_of(session: Session, lag: float = 0.0) -> Positions:
    """Every rest of a session, the sensors following their thermometers with a lag, s. Raises InputError where there is
    none."""
    found = inspect_session(session)
    observations = found.observations
    if observations is None or found.faults:
        said = found.faults[0] if found.faults else "no rests; look at it with `tumble inspect`"
        raise InputError(f"{session.name}: expected rests to verify with, found {said}")
    rests, celsius = observations.rests, None
    if rests.temperatures is not None:
        at_rest = sensors_at(observations, rests.temperatures, lag)
        celsius = at_rest[:, observations.accel_block.thermometer] - ZERO_CELSIUS
    return Positions(
        block=observations.accel_block,
        readings=rests.accel,
        covariance=rests.accel_covariance,
        labels=tuple(
            f"rest {i} ({start:z.1f}–{stop:z.1f} s)"
            for i, (start, stop) in enumerate(zip(rests.start, rests.stop, strict=True), 1)
        ),
        gravity=session.site.gravity,
        gravity_u=session.site.gravity_u,
        sha256=found.sha256,
        celsius=celsius,
        grade=grade_of(session, observations)[0],
    )


def positions_of_table(path: Path, calibration: Calibration) -> Positions:
    """The rows of a table of readings, in the unit and with the scale that the calibration was made with, taken where
    gravity is as it was there. Their noise is that of its rests, or of a row of its table beside its scatter.

    Raises InputError for a table that cannot be read, and CalibrationError where the calibration does not say what
    the readings are worth, or nothing says how uncertain they are."""
    table, worth = read_table(path), calibration.readings.get("accel")
    if calibration.accel is None or worth is None or worth.increments or calibration.site is None:
        raise CalibrationError(
            f"{path}: expected a calibration of three accelerometers that says what their readings are worth, found "
            "none; calibrate again, or verify with a session"
        )
    variance = _variance_of_a_row(calibration, worth)
    readings = (table.values - np.array(worth.offset)) / np.array(worth.scale)
    return Positions(
        block=Block(kind="accel", axes=triad_axes(calibration.accel.matrix)),
        readings=readings,
        covariance=np.broadcast_to(np.diag(variance), (len(readings), 3, 3)),
        labels=tuple(f"position {i} (line {line})" for i, line in enumerate(table.lines, 1)),
        gravity=calibration.site.gravity,
        gravity_u=calibration.site.gravity_u,
        sha256=table.sha256,
    )


def _variance_of_a_row(calibration: Calibration, worth: Readings) -> Array:
    """Variance (3,) of a row beside the scatter between positions: of a mean as long as the rests of the calibration,
    or of a row of its table. Raises CalibrationError where nothing says how uncertain a reading is."""
    if worth.row_u:
        return np.array(worth.row_u) ** 2
    variances = [
        np.array(rest.accel.noise) ** 2 / (rest.stop - rest.start)
        for rest in calibration.rests
        if rest.accel is not None
    ]
    if not variances and _accelerometer_fit(calibration).scatter == 0.0:
        raise CalibrationError(
            f"calibration of {calibration.serial!r}: expected one that says how uncertain a reading is, found no "
            "scatter in it: it has as many positions as parameters; calibrate with more"
        )
    return np.median(variances, axis=0) if variances else np.zeros(3)


def _accelerometer_fit(calibration: Calibration) -> Fit:
    nothing = Fit(chi_square=0.0, degrees=0.0, scatter=0.0, scatter_unit="m/s^2")
    return calibration.fits.get("accelerometers", nothing)


def verify_calibration(calibration: Calibration | FilePath, check: Positions | Session | FilePath) -> Verification:
    """Eq. (21) in every position: those of a session, its folder, or a table of readings. The calibration is one or its
    file.

    Raises CalibrationError for a calibration that was not accepted or has no accelerometers, and InputError for
    positions of other sensors or of one of several launches behind the calibration.

    >>> import tumble
    >>> request = tumble.Setup.of(grade="mems", positions=12)
    >>> one, other = (tumble.simulate_session(f"launch-{i}", request, seed=1, launch=i) for i in (1, 2))
    >>> found = tumble.verify_calibration(tumble.calibrate(one), other)
    >>> len(found.labels), found.reasons
    (12, ())
    """
    calibration = accepted_accelerometers(calibration_from(calibration), VERIFIED)
    positions = check if isinstance(check, Positions) else positions_of(check, calibration)
    seen = verticals(calibration, positions)
    assert calibration.accel is not None
    own = calibration.provenance.get("log_sha256") == positions.sha256
    if any(launch.log_sha256 == positions.sha256 for launch in calibration.launches):
        raise InputError(
            f"calibration of {calibration.serial!r}: expected positions that did not take part in it, or those of its "
            f"only session, found one of its {len(calibration.launches)} launches; verify with another session"
        )
    fit = _accelerometer_fit(calibration)
    across = seen.direction[:, None, :] @ calibration.accel.inverse()
    noise = positions.covariance + fit.scatter**2 * np.eye(positions.block.size)
    variance = (across @ noise @ np.swapaxes(across, 1, 2))[:, 0, 0]
    by_parameters = _length_by_parameters(calibration, positions, seen)
    known = np.einsum("im,mk,ik->i", by_parameters, seen.parameter_covariance, by_parameters)
    difference = positions.gravity - np.linalg.norm(_force(calibration, positions), axis=1)
    if own:
        untold = _untold(calibration, positions, by_parameters)
        known = np.maximum(known - untold - positions.gravity_u**2, 0.0)
        return _left_out(positions, difference, variance, (known, untold), fit)
    same_gravity = calibration.site is not None and (
        (calibration.site.gravity, calibration.site.gravity_u) == (positions.gravity, positions.gravity_u)
    )
    by_gravity = -(positions.gravity_u**2) if same_gravity else positions.gravity_u**2
    u = np.sqrt(variance + np.maximum(known + by_gravity, 0.0))
    by_scatter = float(np.max(fit.scatter**2 * (across[:, 0] ** 2).sum(axis=1) / u**2))
    return Verification(
        labels=positions.labels,
        difference=difference,
        u=u,
        sigmas=np.abs(difference) / u,
        limit=_limit(len(u), fit.degrees / by_scatter**2 if by_scatter > 0.0 else np.inf),  # Welch–Satterthwaite
        left_out=False,
        by_turn_on=_by_turn_on(calibration, positions, seen, difference, variance, by_gravity),
    )


def _by_turn_on(
    calibration: Calibration,
    positions: Positions,
    seen: Verticals,
    difference: Array,
    variance: Array,
    by_gravity: float,
) -> bool:
    """Whether Δg (N,) are no larger than by chance, all together, with what turning on again usually changes in the
    linear parameters between two power-ons; never where the grade is not known."""
    if positions.grade is None:
        return False
    from scipy.special import chdtri, fdtri

    J, fit = _length_by_parameters(calibration, positions, seen), _accelerometer_fit(calibration)
    turned_on, known = np.zeros(len(seen.parameter_covariance)), seen.parameter_covariance
    names = positions.block.names
    turned_on[: len(names)] = [2.0 * spread_of(TURN_ON[positions.grade], name) ** 2 for name in names]
    V = np.diag(variance) + J @ (known + np.diag(turned_on)) @ J.T + by_gravity
    N = len(difference)
    square = float(difference @ np.linalg.solve(V, difference))
    if fit.scatter == 0.0 or np.isinf(fit.degrees):
        return square < float(chdtri(N, CHANCE))
    return square / N < float(fdtri(N, fit.degrees, 1.0 - CHANCE))


def _untold(calibration: Calibration, positions: Positions, by_parameters: Array) -> Array:
    """The part (N,) of the variance of the force in the calibration's own positions that comes from parameters of which
    they have told nothing: given these, the force is as well known as the fit has it."""
    names, covariance = _accelerometer_names(calibration, positions), calibration.covariance
    untold = [i for i, p in enumerate(calibration.parameters) if p.learned == 0.0]
    if covariance is None or not untold:
        return np.zeros(len(by_parameters))
    at = [i for i, p in enumerate(calibration.parameters) if p.name in names]
    moved = by_parameters @ covariance[np.ix_(at, untold)]
    return np.asarray(np.einsum("ik,ki->i", moved, np.linalg.solve(covariance[np.ix_(untold, untold)], moved.T)))


def _left_out(
    positions: Positions, difference: Array, variance: Array, known: tuple[Array, Array], fit: Fit
) -> Verification:
    """Each of the calibration's own positions without itself; nan where nothing else determines it. `known`: the
    variances of the force there by the fit, and by what it leaves out."""
    of_fit, untold = known
    left = 1.0 - of_fit / variance
    left = np.where(left > NOTHING_LEFT, left, np.nan)
    normalised = difference / np.sqrt(variance * left + untold)
    return Verification(
        labels=positions.labels,
        difference=difference / left,
        u=np.sqrt(variance * left + untold) / left,
        sigmas=sigmas(normalised, fit.degrees, fit.scatter > 0.0),
        limit=_limit(len(left), np.inf),
        left_out=True,
    )


def _limit(count: int, degrees: float) -> float:
    """What the largest of `count` ratios exceeds in CHANCE of all cases."""
    from scipy.special import ndtri, stdtrit

    tail = 1.0 - 0.5 * CHANCE / count
    return float(ndtri(tail) if np.isinf(degrees) else stdtrit(degrees, tail))


def verticals(calibration: Calibration, positions: Positions) -> Verticals:
    """Where the vertical was in the calibration's frame in every position, with its covariance, for the relation of two
    blocks (`case.relate`). Raises as `verify_calibration`."""
    calibration = accepted_accelerometers(calibration, VERIFIED)
    assert calibration.accel is not None
    names = _accelerometer_names(calibration, positions)
    force = _force(calibration, positions)
    change = _change(calibration, positions, force)
    index = [i for i, p in enumerate(calibration.parameters) if p.name in names]
    known = np.zeros((len(index), len(index)))
    if calibration.covariance is not None:
        known = calibration.covariance[np.ix_(index, index)]
    return verticals_of(calibration.accel, force, change, positions.covariance, known)


def _force(calibration: Calibration, positions: Positions) -> Array:
    """Specific force (N, 3) in the positions, by the parameters at their temperatures."""
    return calibration.compensator.force(positions.readings, positions.celsius)


def _beyond(calibration: Calibration, positions: Positions) -> Instrument:
    """The accelerometers with what a reading at rest depends on beyond the linear model, with the changes over
    temperature where the positions have temperatures."""
    found = {group_name(p.name) for p in calibration.parameters}
    warm = positions.celsius is not None and calibration.reference_temperature is not None
    return Instrument.of(positions.block, None, found, variables=_OVER_TEMPERATURE if warm else ())


def _accelerometer_names(calibration: Calibration, positions: Positions) -> tuple[str, ...]:
    """The parameters that a reading of the accelerometers at rest depends on, in their order. Raises InputError where
    the linear ones are not those of the block, and where a group lacks some."""
    assert calibration.accel is not None
    block = positions.block
    convention = Convention(frame=frame_of(calibration.frame), block=block)
    linear = {group.name for group in LINEAR}
    if calibration.outcome.unobservable:
        raise CalibrationError(
            f"calibration of {calibration.serial!r}: expected one of all parameters, found no "
            f"{', '.join(calibration.outcome.unobservable)}; verify one from oblique rests too"
        )
    found = [p.name for p in calibration.parameters if sensor_kind(p.name) == block.kind]
    if tuple(name for name in found if group_name(name) in linear) != convention.names:
        raise InputError(
            f"calibration of {calibration.serial!r}: expected readings of its {len(calibration.accel.bias)} "
            f"accelerometers, found {block.size} with other axes; verify with recordings of the same device"
        )
    further = _beyond(calibration, positions)
    names = convention.names + further.names[further.linear_count :]
    if missing := sorted(set(names).difference(found)):
        raise InputError(
            f"calibration of {calibration.serial!r}: expected all parameters of a group or none, found no "
            f"{missing[0]!r}: the file was changed; calibrate again"
        )
    return names


def _change(calibration: Calibration, positions: Positions, force: Array) -> Array:
    """Derivative (N, n, m) of the readings with the parameters of `_accelerometer_names`, in specific forces (N, 3)."""
    block = positions.block
    convention = Convention(frame=frame_of(calibration.frame), block=block)
    linear = convention.jacobian(np.array([calibration[name].value for name in convention.names]))
    own = np.einsum("pkm,ik->ipm", linear[:, :3], force) + linear[:, 3]
    instrument = _beyond(calibration, positions)
    derivative = instrument.derivative(block, np.zeros(len(instrument.names)))
    every = np.einsum("npb,pbm->npm", functions(block, force, np.zeros_like(force)), derivative)
    for changed, base, variable in instrument.changes:
        assert positions.celsius is not None
        assert calibration.reference_temperature is not None
        warmer = positions.celsius - calibration.reference_temperature
        every[:, :, changed] = (warmer ** _OVER_TEMPERATURE[variable])[:, :, None] * every[:, :, base]
    return np.concatenate([own, every[:, :, instrument.linear_count :]], axis=2)


def _length_by_parameters(calibration: Calibration, positions: Positions, seen: Verticals) -> Array:
    """Derivative (N, m) of |true| with the parameters of the accelerometers."""
    assert calibration.accel is not None
    change = _change(calibration, positions, _force(calibration, positions))
    return np.asarray(-np.einsum("ik,kp,ipm->im", seen.direction, calibration.accel.inverse(), change))
