"""Check positions: gravity less the modulus of the corrected reading, in positions at rest.

In every position, with true = matrix⁻¹ (reading − bias), Eq. (21) of the ellipsoid paper gives

    Δg = g − |true|                                                                                              (1)

If the position took no part in the calibration, Δg has the variance

    u² = variance of the rest + scatter between rests + J Σ Jᵀ + u(g)²,   J = ∂|true|/∂θ                         (2)

with Σ the covariance of the parameters θ. With v the vertical and S the axes matrix, J = −vᵀ S⁻¹ ∂(S g v + b)/∂θ. If
the calibration was made with the same stated gravity, the error of this gravity is in its scale factors too: it
cancels in Δg, and J Σ Jᵀ contains u(g)² that is to be taken off.

If the position belongs to the calibration, it is left out. Let h be its leverage, the ratio of the variance of |true|
from the parameters to the variance of the position itself. Without the position

    Δg → Δg / (1 − h),   u² → variance of the position / (1 − h)                                                 (3)

which is exact for a linear fit. The plain residual would be too small by √(1 − h).

The largest |Δg|/u of N positions is compared with the quantile that it exceeds by chance with the probability CHANCE,
by Bonferroni's inequality over the positions. It is one of Student's t distribution if the scatter was estimated.

What turning the device on again changes is not a part of u; `tumble.use.check` tests the parameters with it.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy

from tumble.errors import CalibrationError, InputError
from tumble.inference.estimate import Fit
from tumble.inference.variables import sensors_at
from tumble.methods.least_squares import gaussian_sigmas
from tumble.reduction.observations import Observations
from tumble.result.calibration import Calibration
from tumble.rotation import unit_vector
from tumble.run.readings_table import ReadingsTable, read_table, rests_of
from tumble.sensors.frames import Convention, frame_of, triad_axes
from tumble.sensors.instrument import Instrument, functions
from tumble.sensors.model import Block
from tumble.sensors.parameters import THERMAL, Variable, beyond_linear, group_name, sensor_kind
from tumble.units import ZERO_CELSIUS, Array

CHANCE = 0.01
"""Probability that the largest difference refutes a good calibration."""

NOTHING_LEFT = 0.05
"""1 − h below which hardly anything but the position itself determines what it is compared with: h is the ratio of two
variances that integrate over the scatter, and known to some hundredths."""

_OVER_TEMPERATURE: dict[Variable, int] = {variable: power for power, variable in enumerate(THERMAL, 1)}
"""Variables that a reading at some temperature depends on, and their powers."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class PositionResiduals:
    """Differences Δg (N,) from gravity with their u, m/s², and Δg/u, `sigmas`, the largest of which is compared with
    the quantile `limit`. If the positions are those of the calibration, each is `left_out`, Eq. (3): Δg is not a number
    where nothing but the position determines it, and Δg/u is studentised."""

    difference: Array
    u: Array
    sigmas: Array
    limit: float
    left_out: bool


def table_observations(calibration: Calibration, path: Path) -> tuple[Observations, ReadingsTable]:
    """The rows of a table of readings as rests, and the table, which has the unit, scale and gravity of the calibration
    and the noise of its rests, or of a row of its table.

    Raises InputError for a table that cannot be read, and CalibrationError for a calibration that does not state the
    unit of a reading or its uncertainty."""
    table, meaning = read_table(path), calibration.provenance.readings.get("accel")
    if calibration.accel is None or meaning is None or meaning.increments or calibration.provenance.site is None:
        raise CalibrationError(
            f"{path}: expected a calibration of three accelerometers that says what their readings are worth, found "
            "none; calibrate again, or check with a session"
        )

    # the variance of a row beside the scatter: of a row of its table, or of a mean as long as the rests
    before = [(np.array(r.accel.noise), r.stop - r.start) for r in calibration.evidence.rests if r.accel is not None]
    variance = np.array(meaning.row_u) ** 2 if meaning.row_u else np.zeros(3)
    if before and not meaning.row_u:
        variance = np.median([noise**2 / duration for noise, duration in before], axis=0)
    elif not meaning.row_u and _accelerometer_fit(calibration).scatter == 0.0:
        raise CalibrationError(
            f"calibration of {calibration.serial!r}: expected one that says how uncertain a reading is, found no "
            "scatter in it: it has as many positions as parameters; calibrate with more"
        )
    readings = (table.values - np.array(meaning.offset)) / np.array(meaning.scale)
    block = Block(kind="accel", axes=triad_axes(calibration.accel.matrix))
    return rests_of(readings, np.diag(variance), block, calibration.provenance.site), table


def _accelerometer_fit(calibration: Calibration) -> Fit:
    nothing = Fit(chi_square=0.0, degrees=0.0, scatter=0.0, unit="m/s^2")
    return calibration.evidence.fits.get("accelerometers", nothing)


def residuals_in(calibration: Calibration, observations: Observations, sha256: str) -> PositionResiduals:
    """Differences by an accepted calibration, Eq. (1) to (3), in check positions whose log or table has this SHA-256.

    Raises CalibrationError for a calibration without all parameters of its accelerometers, and InputError for positions
    of other sensors or of one of several launches behind the calibration, and if each of its own positions is
    determined by nothing but itself."""
    force, J, names, covariance = _length_and_derivative(calibration, observations)
    length = np.linalg.norm(force, axis=1)
    rests, site_of_check, block = observations.rests, observations.site, observations.accel_block
    assert calibration.accel is not None
    if any(launch.log_sha256 == sha256 for launch in calibration.evidence.launches):
        raise InputError(
            f"calibration of {calibration.serial!r}: expected positions that did not take part in it, or those of its "
            f"only session, found one of its {len(calibration.evidence.launches)} launches; check with another session"
        )
    fit, site = _accelerometer_fit(calibration), calibration.provenance.site
    across = unit_vector(force)[:, None, :] @ calibration.accel.inverse()
    noise = rests.accel_covariance + fit.scatter**2 * np.eye(block.size)
    variance = (across @ noise @ np.swapaxes(across, 1, 2))[:, 0, 0]
    by_parameters = np.einsum("im,mk,ik->i", J, covariance, J)
    difference = site_of_check.gravity - length

    def limit(degrees: float) -> float:
        """Quantile of the largest of the ratios."""
        tail = 1.0 - 0.5 * CHANCE / len(difference)
        return float(scipy.special.ndtri(tail) if np.isinf(degrees) else scipy.special.stdtrit(degrees, tail))

    if calibration.provenance.log_sha256 == sha256:  # its own positions: each is left out
        if any(source.name.startswith("prior.") for source in calibration.evidence.budget) and not calibration.groups:
            raise InputError(
                f"calibration of {calibration.serial!r}: expected one with all terms, found linear ones, whose u "
                "does not tell its own positions from others; calibrate with --terms full, or record check positions"
            )
        unlearned = _unlearned(calibration, names, J)
        remaining = 1.0 - np.maximum(by_parameters - unlearned - site_of_check.gravity_u**2, 0.0) / variance
        remaining = np.where(remaining > NOTHING_LEFT, remaining, np.nan)
        if np.isnan(remaining).all():
            raise InputError(
                f"calibration of {calibration.serial!r}: expected more positions than parameters, found "
                f"{len(difference)}, of which each is determined by itself alone; record check positions"
            )
        u = np.sqrt(variance * remaining + unlearned)
        return PositionResiduals(
            difference=difference / remaining,
            u=u / remaining,
            sigmas=np.sign(difference) * gaussian_sigmas(difference / u, fit.degrees, fit.scatter > 0.0),
            limit=limit(np.inf),
            left_out=True,
        )
    shared = site is not None and (site.gravity, site.gravity_u) == (site_of_check.gravity, site_of_check.gravity_u)
    by_gravity = -(site_of_check.gravity_u**2) if shared else site_of_check.gravity_u**2
    u = np.sqrt(variance + np.maximum(by_parameters + by_gravity, 0.0))
    by_scatter = float(np.max(fit.scatter**2 * (across[:, 0] ** 2).sum(axis=1) / u**2))
    return PositionResiduals(
        difference=difference,
        u=u,
        sigmas=difference / u,
        limit=limit(fit.degrees / by_scatter**2 if by_scatter > 0.0 else np.inf),  # Welch–Satterthwaite
        left_out=False,
    )


def _unlearned(calibration: Calibration, names: tuple[str, ...], J: Array) -> Array:
    """Part (N,) of the variance of |true| in the positions of the calibration from parameters that have only a
    prior."""
    unlearned = [p.name for p in calibration.parameters if p.learned == 0.0]
    every = calibration.covariance_of([*names, *unlearned])
    if every is None or not unlearned:
        return np.zeros(len(J))
    moved = J @ every[: len(names), len(names) :]
    return np.asarray(np.einsum("ik,ki->i", moved, np.linalg.solve(every[len(names) :, len(names) :], moved.T)))


def _length_and_derivative(
    calibration: Calibration, observations: Observations
) -> tuple[Array, Array, tuple[str, ...], Array]:
    """The true specific force (N, 3) at rest, the derivative J (N, m) of its length, and the names and the covariance
    (m, m) of the m parameters that it depends on."""
    assert calibration.accel is not None
    block, reference = observations.accel_block, calibration.reference_temperature
    rests, celsius = observations.rests, None
    if rests.temperatures is not None:  # the sensors follow their thermometers with the lag of the calibration
        kelvin = sensors_at(observations, rests.temperatures, calibration.compensator.lags.get(block.kind, 0.0))
        celsius = kelvin[:, block.thermometer] - ZERO_CELSIUS
    convention = Convention(frame=frame_of(calibration.frame), block=block)
    if calibration.outcome.unobservable:
        raise CalibrationError(
            f"calibration of {calibration.serial!r}: expected one of all parameters, found no "
            f"{', '.join(calibration.outcome.unobservable)}; check one from oblique rests too"
        )
    names_here = [name for name in calibration if sensor_kind(name) == block.kind]
    if tuple(name for name in names_here if not beyond_linear(name)) != convention.names:
        raise InputError(
            f"calibration of {calibration.serial!r}: expected readings of its {len(calibration.accel.bias)} "
            f"accelerometers, found {block.size} with other axes; check with recordings of the same device"
        )
    over_temperature = _OVER_TEMPERATURE if celsius is not None and reference is not None else ()
    instrument = Instrument.of(block, None, set(map(group_name, calibration)), variables=over_temperature)
    names = convention.names + instrument.names[instrument.linear_count :]
    if missing := sorted(set(names).difference(names_here)):
        raise InputError(
            f"calibration of {calibration.serial!r}: expected all parameters of a group or none, found no "
            f"{missing[0]!r}: the file was changed; calibrate again"
        )

    # derivative (N, n, m) of the readings
    force = calibration.compensator.force(rests.accel, celsius)
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
    J = -np.einsum("ik,kp,ipm->im", unit_vector(force), calibration.accel.inverse(), change)
    return force, J, names, covariance
