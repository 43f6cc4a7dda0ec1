"""Check positions: gravity less the modulus of the corrected reading, in positions at rest.

In every position, with true = matrix⁻¹ (reading − bias), Eq. (21) of the ellipsoid paper gives

    Δg = g − |true|                                                                                              (1)

In positions that took no part in the calibration Δg has the variance

    u² = variance of the rest + scatter between rests + J Σ Jᵀ + u(g)²,   J = ∂|true|/∂θ                         (2)

with Σ the covariance of the parameters θ. With v the vertical and S the axes matrix, J = −vᵀ S⁻¹ ∂(S g v + b)/∂θ. If
the calibration was made with the same stated gravity, the error of this gravity is in its scale factors too: it
cancels in Δg, and J Σ Jᵀ contains u(g)² that is to be taken off.

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
from tumble.reduction.observations import Observations
from tumble.result.calibration import Calibration
from tumble.rotation import unit_vector
from tumble.run.readings_table import ReadingsTable, read_table, table_rests
from tumble.sensors.frames import Convention, frame_of, triad_axes
from tumble.sensors.instrument import Instrument, functions
from tumble.sensors.model import Block
from tumble.sensors.parameters import THERMAL, Variable, beyond_linear, group_name, sensor_kind
from tumble.units import ZERO_CELSIUS, Array

CHANCE = 0.01
"""Probability that the largest difference refutes a good calibration."""

_OVER_TEMPERATURE: dict[Variable, int] = {variable: power for power, variable in enumerate(THERMAL, 1)}
"""Variables that a reading at some temperature depends on, and their powers."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class PositionResiduals:
    """Differences Δg (N,) from gravity with their u, m/s², and Δg/u, `sigmas`, the largest of which is compared with
    the quantile `limit`."""

    difference: Array
    u: Array
    sigmas: Array
    limit: float


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
    return table_rests(readings, np.diag(variance), block, calibration.provenance.site), table


def _accelerometer_fit(calibration: Calibration) -> Fit:
    nothing = Fit(chi_square=0.0, degrees=0.0, scatter=0.0, unit="m/s^2")
    return calibration.evidence.fits.get("accelerometers", nothing)


def position_residuals(calibration: Calibration, observations: Observations, sha256: str) -> PositionResiduals:
    """Return the differences from gravity, Eq. (1) and (2), in check positions whose log or table has this SHA-256.

    Raises CalibrationError for a calibration without all parameters of its accelerometers, and InputError for positions
    of other sensors or from which the calibration was made."""
    force, J, names, covariance = _length_and_derivative(calibration, observations)
    length = np.linalg.norm(force, axis=1)
    rests, site_of_check, block = observations.rests, observations.site, observations.accel_block
    assert calibration.accel is not None
    if sha256 in (calibration.provenance.log_sha256, *(each.log_sha256 for each in calibration.evidence.launches)):
        raise InputError(
            f"calibration of {calibration.serial!r}: expected positions that took no part in it, found those it was "
            "made from; record a few rests in other attitudes, such as on edges of a cube"
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

    shared = site is not None and (site.gravity, site.gravity_u) == (site_of_check.gravity, site_of_check.gravity_u)
    by_gravity = -(site_of_check.gravity_u**2) if shared else site_of_check.gravity_u**2
    u = np.sqrt(variance + np.maximum(by_parameters + by_gravity, 0.0))
    by_scatter = float(np.max(fit.scatter**2 * (across[:, 0] ** 2).sum(axis=1) / u**2))
    return PositionResiduals(
        difference=difference,
        u=u,
        sigmas=difference / u,
        limit=limit(fit.degrees / by_scatter**2 if by_scatter > 0.0 else np.inf),  # Welch–Satterthwaite
    )


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
