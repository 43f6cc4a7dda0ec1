"""Check positions: gravity less the modulus of the corrected reading, in positions at rest.

In every position, with true = matrix⁻¹ (reading − bias), Eq. (21) of the ellipsoid paper gives

    Δg = g − |true|                                                                                              (1)

In positions that were not used for the calibration Δg has the variance

    u² = variance of the rest + scatter between rests + J Σ Jᵀ + u(g)²,   J = ∂|true|/∂θ                         (2)

with Σ the covariance of the parameters θ. With v the vertical and S the axes matrix, J = −vᵀ S⁻¹ ∂(S g v + b)/∂θ. If
the calibration was made with the same stated gravity, the error of this gravity is in its scale factors too and cancels
in Δg: u(g)² is then subtracted instead of added.

The largest |Δg|/u of N positions is compared with the quantile that chance exceeds with the probability CHANCE, by
Bonferroni's inequality over the positions; the distribution is Student's t if the scatter was estimated. u does not
contain changes from one power-on to the next, which `tumble.use.check` includes.
"""

from __future__ import annotations

from collections.abc import Mapping
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
"""Powers of temperature by name of the variable."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class PositionResiduals:
    """Differences Δg (N,) from gravity with their u (N,), m/s², and the `limit` of the largest |Δg|/u."""

    difference: Array
    u: Array
    limit: float

    @property
    def sigmas(self) -> Array:
        """Δg/u (N,)."""
        return np.asarray(self.difference / self.u)


def table_observations(calibration: Calibration, path: Path) -> tuple[Observations, ReadingsTable]:
    """Read a table of readings and return its rows as rests.

    Unit, scale and gravity are those of the calibration; the noise is that of its rests or of a row of its table.
    Raises InputError for a table that cannot be read, and CalibrationError for a calibration that does not state the
    unit of a reading or its uncertainty."""
    table = read_table(path)
    meaning = calibration.provenance.readings.get("accel")  # unit, scale and offset of a reading
    if calibration.accel is None or meaning is None or meaning.increments or calibration.provenance.site is None:
        raise CalibrationError(
            f"{path}: expected a calibration of three accelerometers that says what their readings are worth, found "
            "none; calibrate again, or check with a session"
        )

    # variance of a row without the scatter: that of a row of the calibration's table, or of the mean over a rest
    recorded = calibration.evidence.all_rests
    rests = [(np.array(r.accel.noise), r.stop - r.start) for r in recorded if r.accel is not None]
    variance = np.zeros(3)
    if meaning.row_u:
        variance = np.array(meaning.row_u) ** 2
    elif rests:
        variance = np.median([noise**2 / duration for noise, duration in rests], axis=0)
    elif _accelerometer_fit(calibration).scatter == 0.0:
        raise CalibrationError(
            f"calibration of {calibration.serial!r}: expected one that says how uncertain a reading is, found no "
            "scatter in it: it has as many positions as parameters; calibrate with more"
        )
    readings = (table.values - np.array(meaning.offset)) / np.array(meaning.scale)
    block = Block(kind="accel", axes=triad_axes(calibration.accel.matrix))
    return table_rests(readings, np.diag(variance), block, calibration.provenance.site), table


def fits_of(calibration: Calibration) -> Mapping[str, Fit]:
    """Return the fits of a calibration by group of residuals; of a mean of launches those of all launches together."""
    launches = [launch.fits for launch in calibration.evidence.launches]
    if not launches:
        return calibration.evidence.fits
    pooled = {}
    for name in (name for name in launches[0] if all(name in fits for fits in launches)):
        fits = [each[name] for each in launches]
        chi_square, degrees = (sum(getattr(fit, field) for fit in fits) for field in ("chi_square", "degrees"))
        scatter = float(np.sqrt(np.mean([fit.scatter**2 for fit in fits])))
        pooled[name] = Fit(chi_square=chi_square, degrees=degrees, scatter=scatter, unit=fits[0].unit)
    return pooled


def _accelerometer_fit(calibration: Calibration) -> Fit:
    no_fit = Fit(chi_square=0.0, degrees=0.0, scatter=0.0, unit="m/s^2")
    return fits_of(calibration).get("accelerometers", no_fit)


def position_residuals(calibration: Calibration, observations: Observations, sha256: str) -> PositionResiduals:
    """Return the differences from gravity, Eq. (1) and (2), in check positions; `sha256` is that of their log or table.

    Raises CalibrationError for a calibration without all parameters of its accelerometers, and InputError for positions
    of other sensors or from which the calibration was made."""
    force, J, covariance = _force_and_derivative(calibration, observations)
    rests, site_of_check, block = observations.rests, observations.site, observations.accel_block
    assert calibration.accel is not None
    if sha256 in (calibration.provenance.log_sha256, *(each.log_sha256 for each in calibration.evidence.launches)):
        raise InputError(
            f"calibration of {calibration.serial!r}: expected positions that took no part in it, found those it was "
            "made from; record a few rests in other attitudes, such as on edges of a cube"
        )
    fit, site = _accelerometer_fit(calibration), calibration.provenance.site
    across = unit_vector(force)[:, None, :] @ calibration.accel.inverse()  # vᵀ S⁻¹ (N, 1, n), from a reading to |true|
    noise = rests.accel_covariance + fit.scatter**2 * np.eye(block.size)
    variance = (across @ noise @ np.swapaxes(across, 1, 2))[:, 0, 0]
    by_parameters = np.einsum("im,mk,ik->i", J, covariance, J)
    shared = site is not None and (site.gravity, site.gravity_u) == (site_of_check.gravity, site_of_check.gravity_u)
    by_gravity = -(site_of_check.gravity_u**2) if shared else site_of_check.gravity_u**2
    u = np.sqrt(variance + np.maximum(by_parameters + by_gravity, 0.0))
    scatter_share = float(np.max(fit.scatter**2 * (across[:, 0] ** 2).sum(axis=1) / u**2))
    tail = 1.0 - 0.5 * CHANCE / len(force)
    limit = float(scipy.special.ndtri(tail))
    if scatter_share > 0.0:
        limit = float(scipy.special.stdtrit(fit.degrees / scatter_share**2, tail))  # Welch–Satterthwaite
    difference = site_of_check.gravity - np.linalg.norm(force, axis=1)
    return PositionResiduals(difference=difference, u=u, limit=limit)


def _force_and_derivative(calibration: Calibration, observations: Observations) -> tuple[Array, Array, Array]:
    """Return the true specific force (N, 3) at rest, the derivative J (N, m) of its length, and the covariance (m, m)
    of the m parameters that it depends on."""
    assert calibration.accel is not None
    block, reference = observations.accel_block, calibration.reference_temperature
    rests, celsius = observations.rests, None
    if rests.temperatures is not None:  # sensors follow their thermometers with the lag of the calibration
        kelvin = sensors_at(observations, rests.temperatures, calibration.compensator.lags.get(block.kind, 0.0))
        celsius = kelvin[:, block.thermometer] - ZERO_CELSIUS
    convention = Convention(frame=frame_of(calibration.frame), block=block)
    if calibration.outcome.unobservable:
        raise CalibrationError(
            f"calibration of {calibration.serial!r}: expected one of all parameters, found no "
            f"{', '.join(calibration.outcome.unobservable)}; check one from oblique rests too"
        )
    calibrated = [name for name in calibration if sensor_kind(name) == block.kind]
    if tuple(name for name in calibrated if not beyond_linear(name)) != convention.names:
        raise InputError(
            f"calibration of {calibration.serial!r}: expected readings of its {len(calibration.accel.bias)} "
            f"accelerometers, found {block.size} with other axes; check with recordings of the same device"
        )
    variables = _OVER_TEMPERATURE if celsius is not None and reference is not None else ()
    instrument = Instrument.of(block, None, set(map(group_name, calibration)), variables=variables)
    names = convention.names + instrument.names[instrument.linear_count :]
    if missing := sorted(set(names).difference(calibrated)):
        raise InputError(
            f"calibration of {calibration.serial!r}: expected all parameters of a group or none, found no "
            f"{missing[0]!r}: the file was changed; calibrate again"
        )

    # derivative (N, n, m) of the readings
    force = calibration.compensator.force(rests.accel, celsius)
    linear = convention.jacobian(np.array([calibration[name].value for name in convention.names]))
    by_linear = np.einsum("pkm,ik->ipm", linear[:, :3], force) + linear[:, 3]
    derivative = instrument.derivative(block, np.zeros(len(instrument.names)))
    by_group = np.einsum("npb,pbm->npm", functions(block, force, np.zeros_like(force)), derivative)
    for changed, base, variable in instrument.changes:
        assert celsius is not None
        assert reference is not None
        factor = (celsius - reference) ** _OVER_TEMPERATURE[variable]
        by_group[:, :, changed] = factor[:, :, None] * by_group[:, :, base]
    change = np.concatenate([by_linear, by_group[:, :, instrument.linear_count :]], axis=2)
    covariance = calibration.covariance_of(names)
    covariance = np.zeros((len(names), len(names))) if covariance is None else covariance
    J = -np.einsum("ik,kp,ipm->im", unit_vector(force), calibration.accel.inverse(), change)
    return force, J, covariance
