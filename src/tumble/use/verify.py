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
import scipy

from tumble.brief import Brief
from tumble.errors import CalibrationError, InputError
from tumble.files import FilePath
from tumble.inference.estimate import Fit
from tumble.inference.variables import sensors_at
from tumble.methods.least_squares import sigmas
from tumble.recording.session import Session
from tumble.recording.session_file import session_from
from tumble.reduction.observations import Observations
from tumble.result.accepted import accepted_accelerometers
from tumble.result.calibration import Calibration, calibration_from
from tumble.run.calibrate import grade_of
from tumble.run.case import Verticals, verticals_of
from tumble.run.observed import Observed, inspect_session
from tumble.run.readings_table import read_table
from tumble.sensors.frames import Convention, frame_of, triad_axes
from tumble.sensors.grades import TURN_ON, spread_of
from tumble.sensors.instrument import Instrument, functions
from tumble.sensors.model import Block
from tumble.sensors.parameters import Variable, beyond_linear, group_name, sensor_kind
from tumble.units import ZERO_CELSIUS, Array, engineering

CHANCE = 0.01
"""How often a good calibration is refused."""

_OVER_TEMPERATURE: dict[Variable, int] = {"temperature": 1, "temperature²": 2}
"""What readings at a temperature change with, and its power."""

TURNED_ON = (
    "a usual change from one power-on to the next explains it: if the device was switched off since the calibration, "
    "`tumble check` allows for that"
)

VERIFIED = "positions at rest verify a calibration"

NOTHING_LEFT = 0.05
"""1 − h below which hardly anything but the position itself determines what it is compared with: h is the ratio of two
variances that integrate over the scatter, and known to some hundredths."""


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
    """The positions of a session, its folder, or a table of readings. The sensors of a session follow their
    thermometers with the calibration's lag. Rows of a table are in the unit and with the scale that the calibration was
    made with, taken where gravity is as it was there, and have the noise of its rests, or of a row of its table beside
    its scatter.

    Raises InputError where nothing rests and for a table that cannot be read, and CalibrationError where the
    calibration does not say what the readings of a table are worth, or nothing says how uncertain they are.

    >>> import tumble
    >>> request = tumble.Setup.of(grade="mems", positions=12)
    >>> folders = [tumble.simulate_session(f"launch-{i}", request, seed=1, launch=i) for i in (1, 2)]
    >>> tumble.positions_of(folders[1], tumble.calibrate(folders[0])).readings.shape
    (12, 3)
    """
    if not isinstance(given, Session) and not Path(given).is_dir():
        return _positions_of_table(Path(given), calibration)
    session = session_from(given)
    check_device(calibration, session)
    observed, observations, celsius = rests_of(calibration, session)
    rests = observations.rests
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
        sha256=observed.sha256,
        celsius=celsius,
        grade=grade_of(session, observations)[0],
    )


def _positions_of_table(path: Path, calibration: Calibration) -> Positions:
    """The rows of a table of readings."""
    table, worth = read_table(path), calibration.readings.get("accel")
    if calibration.accel is None or worth is None or worth.increments or calibration.site is None:
        raise CalibrationError(
            f"{path}: expected a calibration of three accelerometers that says what their readings are worth, found "
            "none; calibrate again, or verify with a session"
        )

    # the variance of a row beside the scatter: of a row of its table, or of a mean as long as the rests
    rests = [(np.array(r.accel.noise), r.stop - r.start) for r in calibration.rests if r.accel is not None]
    variance = np.array(worth.row_u) ** 2 if worth.row_u else np.zeros(3)
    if rests and not worth.row_u:
        variance = np.median([noise**2 / duration for noise, duration in rests], axis=0)
    elif not worth.row_u and _accelerometer_fit(calibration).scatter == 0.0:
        raise CalibrationError(
            f"calibration of {calibration.serial!r}: expected one that says how uncertain a reading is, found no "
            "scatter in it: it has as many positions as parameters; calibrate with more"
        )
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


def _accelerometer_fit(calibration: Calibration) -> Fit:
    nothing = Fit(chi_square=0.0, degrees=0.0, scatter=0.0, unit="m/s^2")
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
    seen, J, names, length = _seen(calibration, positions)
    assert calibration.accel is not None
    if any(launch.log_sha256 == positions.sha256 for launch in calibration.launches):
        raise InputError(
            f"calibration of {calibration.serial!r}: expected positions that did not take part in it, or those of its "
            f"only session, found one of its {len(calibration.launches)} launches; verify with another session"
        )
    fit, site = _accelerometer_fit(calibration), calibration.site
    across = seen.direction[:, None, :] @ calibration.accel.inverse()
    noise = positions.covariance + fit.scatter**2 * np.eye(positions.block.size)
    variance = (across @ noise @ np.swapaxes(across, 1, 2))[:, 0, 0]
    known = np.einsum("im,mk,ik->i", J, seen.parameter_covariance, J)
    difference = positions.gravity - length

    def limit(degrees: float) -> float:
        """What the largest of so many ratios exceeds in CHANCE of all cases."""
        tail = 1.0 - 0.5 * CHANCE / len(difference)
        return float(scipy.special.ndtri(tail) if np.isinf(degrees) else scipy.special.stdtrit(degrees, tail))

    if calibration.provenance.get("log_sha256") == positions.sha256:  # the calibration's own: each is left out in turn
        untold = _untold(calibration, names, J)
        left = 1.0 - np.maximum(known - untold - positions.gravity_u**2, 0.0) / variance
        left = np.where(left > NOTHING_LEFT, left, np.nan)  # nothing else determines it
        u = np.sqrt(variance * left + untold)
        return Verification(
            labels=positions.labels,
            difference=difference / left,
            u=u / left,
            sigmas=sigmas(difference / u, fit.degrees, fit.scatter > 0.0),
            limit=limit(np.inf),
            left_out=True,
        )
    shared = site is not None and (site.gravity, site.gravity_u) == (positions.gravity, positions.gravity_u)
    by_gravity = -(positions.gravity_u**2) if shared else positions.gravity_u**2
    u = np.sqrt(variance + np.maximum(known + by_gravity, 0.0))
    by_scatter = float(np.max(fit.scatter**2 * (across[:, 0] ** 2).sum(axis=1) / u**2))

    # with what turning on again changes in the linear parameters, all together; never where the grade is not known
    by_turn_on = False
    if positions.grade is not None:
        spread, linear = TURN_ON[positions.grade], positions.block.names
        turned_on = np.zeros(len(names))
        turned_on[: len(linear)] = [2.0 * spread_of(spread, name) ** 2 for name in linear]
        V = np.diag(variance) + by_gravity + J @ (seen.parameter_covariance + np.diag(turned_on)) @ J.T
        N, square = len(difference), float(difference @ np.linalg.solve(V, difference))
        if fit.scatter == 0.0 or np.isinf(fit.degrees):
            by_turn_on = square < float(scipy.special.chdtri(N, CHANCE))
        else:
            by_turn_on = square / N < float(scipy.special.fdtri(N, fit.degrees, 1.0 - CHANCE))
    return Verification(
        labels=positions.labels,
        difference=difference,
        u=u,
        sigmas=np.abs(difference) / u,
        limit=limit(fit.degrees / by_scatter**2 if by_scatter > 0.0 else np.inf),  # Welch–Satterthwaite
        left_out=False,
        by_turn_on=by_turn_on,
    )


def _untold(calibration: Calibration, names: tuple[str, ...], J: Array) -> Array:
    """The part (N,) of the variance of the force in the calibration's own positions that comes from parameters of which
    they have told nothing: given these, the force is as well known as the fit has it."""
    untold = [p.name for p in calibration.parameters if p.learned == 0.0]
    every = calibration.covariance_of([*names, *untold])
    if every is None or not untold:
        return np.zeros(len(J))
    moved = J @ every[: len(names), len(names) :]
    return np.asarray(np.einsum("ik,ki->i", moved, np.linalg.solve(every[len(names) :, len(names) :], moved.T)))


def verticals(calibration: Calibration, positions: Positions) -> Verticals:
    """Where the vertical was in the calibration's frame in every position, with its covariance, for the relation of two
    blocks (`case.relate`). Raises as `verify_calibration`."""
    return _seen(accepted_accelerometers(calibration, VERIFIED), positions)[0]


def _seen(calibration: Calibration, positions: Positions) -> tuple[Verticals, Array, tuple[str, ...], Array]:
    """The verticals, and |true| (N,), by the parameters at their temperatures, with its derivative (N, m) and the names
    of the parameters that a reading of the accelerometers at rest depends on. Raises InputError where the linear ones
    are not those of the block, and where a group lacks some."""
    assert calibration.accel is not None
    block, celsius, reference = positions.block, positions.celsius, calibration.reference_temperature
    convention = Convention(frame=frame_of(calibration.frame), block=block)
    if calibration.outcome.unobservable:
        raise CalibrationError(
            f"calibration of {calibration.serial!r}: expected one of all parameters, found no "
            f"{', '.join(calibration.outcome.unobservable)}; verify one from oblique rests too"
        )
    known = [name for name in calibration if sensor_kind(name) == block.kind]
    if tuple(name for name in known if not beyond_linear(name)) != convention.names:
        raise InputError(
            f"calibration of {calibration.serial!r}: expected readings of its {len(calibration.accel.bias)} "
            f"accelerometers, found {block.size} with other axes; verify with recordings of the same device"
        )
    over_temperature = _OVER_TEMPERATURE if celsius is not None and reference is not None else ()
    instrument = Instrument.of(block, None, set(map(group_name, calibration)), variables=over_temperature)
    names = convention.names + instrument.names[instrument.linear_count :]
    if missing := sorted(set(names).difference(known)):
        raise InputError(
            f"calibration of {calibration.serial!r}: expected all parameters of a group or none, found no "
            f"{missing[0]!r}: the file was changed; calibrate again"
        )

    # the derivative (N, n, m) of the readings
    force = calibration.compensator.force(positions.readings, celsius)
    linear = convention.jacobian(np.array([calibration[name].value for name in convention.names]))
    of_linear = np.einsum("pkm,ik->ipm", linear[:, :3], force) + linear[:, 3]
    derivative = instrument.derivative(block, np.zeros(len(instrument.names)))
    every = np.einsum("npb,pbm->npm", functions(block, force, np.zeros_like(force)), derivative)
    for changed, base, variable in instrument.changes:
        assert celsius is not None
        assert reference is not None
        warmer = (celsius - reference) ** _OVER_TEMPERATURE[variable]
        every[:, :, changed] = warmer[:, :, None] * every[:, :, base]
    change = np.concatenate([of_linear, every[:, :, instrument.linear_count :]], axis=2)
    covariance = calibration.covariance_of(names)
    covariance = np.zeros((len(names), len(names))) if covariance is None else covariance
    seen = verticals_of(calibration.accel, force, change, positions.covariance, covariance)
    J = -np.einsum("ik,kp,ipm->im", seen.direction, calibration.accel.inverse(), change)
    return seen, J, names, np.linalg.norm(force, axis=1)


# -------------------- sessions of the device --------------------


def check_device(calibration: Calibration, session: Session) -> None:
    """Raises InputError for a session of another device than a calibration, and where sensors that change with
    temperature share thermometers otherwise than they did when the calibration was made; of a session without a
    thermometer nothing is said."""
    if session.device.serial != calibration.serial:
        raise InputError(
            f"{session.name}: expected a session of device {calibration.serial!r}, which was calibrated, found "
            f"{session.device.serial!r}"
        )
    known = session.log.temperature
    if known is None or (calibration.accel is None and calibration.gyro is None) or not calibration.compensator.warm:
        return
    compensator = calibration.compensator
    for made, now in ((compensator.accel, session.accel_block), (compensator.gyro, session.gyro_block)):
        if made is not None and now is not None and not np.array_equal(made.thermometer, now.thermometer):
            then = ", ".join(calibration.temperature.thermometers.get(made.kind, ())) or "one for all sensors"
            raise InputError(
                f"{session.name}: log.temperature.columns: expected a thermometer for each sensor {made.kind} as in "
                f"the calibration, {then}, found {', '.join(known.names(made.kind))}"
            )


def rests_of(
    calibration: Calibration, session: Session, *, otherwise: str = ""
) -> tuple[Observed, Observations, Array | None]:
    """What is seen in a session, its rests, and the temperatures (N, n), °C, of its accelerometers in them, which
    follow the thermometers with the calibration's lag; None where there are none. Raises InputError where nothing
    rests, with what to do `otherwise`."""
    observed = inspect_session(session)
    observations = observed.observations
    if observations is None or observed.faults:
        fault = observed.faults[0] if observed.faults else "no rests; look at it with `tumble inspect`"
        raise InputError(f"{session.name}: expected rests to verify with, found {fault}{otherwise}")
    kelvin, celsius = observations.rests.temperatures, None
    if kelvin is not None:
        lag = 0.0 if calibration.accel is None else calibration.compensator.lag
        celsius = sensors_at(observations, kelvin, lag)[:, observations.accel_block.thermometer] - ZERO_CELSIUS
    return observed, observations, celsius
