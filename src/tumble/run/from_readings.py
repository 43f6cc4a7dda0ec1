"""Calibration of three accelerometers from a table of readings by the ellipsoid method.

The rows are the mean readings of rests, in the order and at the pace of an operator's sheet; the estimate is that of
the method `ellipsoid`. Its u contains quadratic and cubic terms, asymmetry and drift of the sizes usual for the grade,
or for any grade if none is stated, as far as the residuals allow (`tumble.methods.ellipsoid`). `paper_form` converts
the result to the form of the source: k in output per g, the angles θ of an upper triangular matrix, and the bias b
referred to the input,

    u = diag(k) [[1, θz, θy], [0, 1, θx], [0, 0, 1]] (a + b)                                             (1), (5)
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import scipy

from tumble.advice import Advised, advised, found_in, remedy_of
from tumble.arguments import checked
from tumble.brief import Brief
from tumble.diagnosis.findings import Finding, outcome_of, refusal, remark
from tumble.diagnosis.level_faces import UPRIGHT, with_common_tilt
from tumble.diagnosis.linear_model import omitted_by_rests, omitted_sizes
from tumble.diagnosis.observability import Refusal, rough_directions, undetermined_by_positions
from tumble.diagnosis.verdict import verdict
from tumble.errors import InputError
from tumble.files import FilePath
from tumble.inference.estimate import Estimate, Outcome
from tumble.inference.joint import joint
from tumble.methods.ellipsoid import estimate_of, with_groups
from tumble.methods.ellipsoid_fit import TRIAD, EllipsoidFit, fit_ellipsoid
from tumble.recording.session import Channels, Device, LogSpec, Session, Site
from tumble.reduction.observations import Observations
from tumble.result.calibration import Calibration
from tumble.result.parts import SERIAL_NOT_STATED, Evidence
from tumble.result.uncertainty_budget import contributions_of
from tumble.run.case import estimate_in
from tumble.run.from_estimate import assemble, build_parameters, origin_of, readings_of_session
from tumble.run.readings_table import (
    UNITS,
    ReadingsTable,
    channels_of,
    fitted_outputs,
    positions_of,
    read_table,
    site_of,
    table_of,
    table_rests,
    unit_of_scale,
)
from tumble.sensors.frames import Convention, Frame, convert, frame_of
from tumble.sensors.grades import GRADES
from tumble.sensors.grades import grade as grade_named
from tumble.sensors.parameters import FURTHER, Terms, group_name, prior_sizes
from tumble.units import Array, engineering, fitting_units, is_near_one

NO_TIMES = np.empty(0)  # a table has no sample intervals, which only increments would need
SCATTER_REMARK = 1e-3  # relative to gravity; good instruments scatter less unless their readings have few digits
SCATTER_LIMIT = 2e-2  # relative to gravity; a triad that scatters more does not follow the model
FEWEST_POSITIONS = 6  # for bias and scale factor of each sensor
RECORDING_ROWS = 100  # a longer table may be a recording of a device in motion
WILD_RATIO = 30.0  # relative to the median length of the readings; no real reading of gravity differs so much
LEAST_NOISE = 1e-6  # relative to gravity, of a reading without redundancy
MOST_SUSPECTS = 4  # positions named as the first to look at
OUTLIER_PROBABILITY = 1e-3  # of one such residual by chance in a table, below which the position does not fit
SINGLE_OUTLIER_PROBABILITY = 1e-2  # the same if the scatter is large, when it is not common to all positions
REST_GROUPS = tuple(
    group.name
    for group in FURTHER
    if group.kind == "accel" and (group.regressors is not None or group.variable == "time")
)
"""Groups of parameters that affect readings at rest without a known temperature or motion."""


@dataclass(frozen=True, kw_only=True, slots=True, repr=False)
class ReadingsCalibration(Brief):
    """A calibration from a table, whose `channels` have unit and nominal scale; `fit` is None for six faces and if the
    fit was refused."""

    calibration: Calibration
    table: ReadingsTable
    channels: Channels
    fit: EllipsoidFit | None


@checked
def calibrate_readings(
    readings: ReadingsTable | Array | FilePath,
    *,
    unit: str = "V",
    scale: Sequence[float] | None = None,
    scale_per: str | None = None,
    gravity: float | None = None,
    gravity_u: float | None = None,
    directions: Mapping[int, Array] | None = None,
    rows_per_position: int = 1,
    grade: str | None = None,
    terms: Terms = "full",
    frame: Frame = "accelerometer",
    serial: str | None = None,
) -> ReadingsCalibration:
    """Calibrate three accelerometers from a table of their readings in nine or more positions, by the ellipsoid method.

    Six faces give bias and scale factor of each accelerometer, as the method `joint` has them.

    Parameters
    ----------
    readings
        Array of shape (N, 3), one row per position; or the path of a CSV file with the names of three columns above the
        rows.
    unit
        Unit of the readings: V, count, g or m/s^2.
    scale
        Nominal output per unit, one number or three, signed by polarity; only for V and count. By default it is taken
        from the readings.
    scale_per
        Unit of the input in `scale`, g (default) or m/s^2.
    gravity, gravity_u
        Gravity and its standard uncertainty, m/s²; by default gravity at the place is the unit, taken as 9.80665 m/s².
    directions
        Rough direction (3,) of up in positions by their numbers from 1; they give the polarity of the columns.
    rows_per_position
        Number of rows of each position; equal positions count once.
    grade
        Grade of the accelerometers, which gives the size of the terms beyond bias, scale factor and axis angles in u;
        if None, the size of any grade that the residuals allow.
    terms
        `full`, or `linear` to leave these terms out of u.
    frame
        Frame of the result: `accelerometer`, `paper` or `symmetric`.
    serial
        Serial number of the device; the name of the file if None.

    Returns
    -------
    ReadingsCalibration
        The calibration with the fit. If the readings cannot be calibrated, the reasons are in the outcome.

    Raises
    ------
    InputError
        If the table cannot be read, or arguments contradict each other.

    Examples
    --------
    >>> import tumble
    >>> from pathlib import Path
    >>> faces = ["0,0,1", "0,0,-1", "0,1,0", "0,-1,0", "1,0,0", "-1,0,0"]
    >>> edges = ["0.6,0.8,0", "0.6,-0.8,0", "0,0.6,0.8", "0,0.6,-0.8", "0.8,0,0.6", "0.8,0,-0.6"]
    >>> _ = Path("readings.csv").write_text("x,y,z\\n" + "\\n".join(faces + edges))
    >>> result = tumble.calibrate_readings("readings.csv", unit="g")
    >>> result.calibration
    <Calibration of readings: ellipsoid, 24 parameters, accepted>
    """
    if serial is not None and not serial.strip():
        raise InputError(f"--serial: expected a serial number, found {serial!r}")
    if isinstance(readings, str | os.PathLike):
        rows = read_table(Path(readings))
    else:
        rows = readings if isinstance(readings, ReadingsTable) else table_of(np.asarray(readings))
    table, (site, gravity_note) = positions_of(rows, rows_per_position), site_of(gravity, gravity_u)
    channels, notes = channels_of(
        table, site.gravity, unit=unit, scale=scale, scale_per=scale_per, directions=directions or {}
    )
    rests = _rests_of(table, channels, site)
    if grade is not None:
        grade_named(grade)
    fitted, used = _fitted(rests, table.degrees, _sigmas(OUTLIER_PROBABILITY, len(table.values)))
    fit, estimate, fit_notes = None, None, tuple[str, ...]()
    if isinstance(fitted, EllipsoidFit):
        fit, estimate, fit_notes = _estimated(fitted, used, table.degrees, grade, terms)
        outcome = outcome_of(_findings(table, channels, site, fit))
    else:
        refused = undetermined_by_positions(channels.to_si(rows.values, NO_TIMES), block=TRIAD) or fitted  # as written
        reason, by_faces = refused.reason, None
        if len(refused.null):  # the positions do not determine all parameters
            by_faces = _by_faces(rests, table.degrees, grade, terms)
        else:
            reason = _misstated(channels, fitted_outputs(table.values, site.gravity)) or reason
        outcome = Outcome(reasons=(reason,), unobservable=TRIAD.names)
        if by_faces is not None:
            estimate, outcome, fit_notes = by_faces
    device = Device(serial=table.path.stem if serial is None else serial.strip())
    session = Session(folder=None, device=device, site=site, log=LogSpec(files=(table.path,), accel=channels))
    readings_u, unstated = (), [f"{SERIAL_NOT_STATED}: the name of the table stands for it"] if serial is None else []
    if fit is not None and (table.degrees or fit.scatter == 0.0):  # else the scatter of the fit contains it
        readings_u = tuple((table.row_u * np.abs(channels.unit.factor / channels.scale)).tolist())
    provenance = origin_of(table.sha256) | {
        "readings": {"accel": replace(readings_of_session(session)["accel"], row_u=readings_u)},
        "notes": (*unstated, *table.left_out, gravity_note, *notes, *_fit_notes(table, fit), *fit_notes),
    }
    results = dict[str, Any]() if estimate is None else _results(estimate, fit, rests, grade, frame)
    method = "ellipsoid" if estimate is None else estimate.method
    calibration = assemble(session, method, outcome, provenance, **results)
    return ReadingsCalibration(calibration=calibration, table=table, channels=channels, fit=fit)


def _results(
    estimate: Estimate, fit: EllipsoidFit | None, rests: Observations, grade: str | None, frame: Frame
) -> dict[str, Any]:
    """Return the fields of the calibration that an estimate, in the frame of the accelerometers, determines."""
    if fit is None:
        frame = "accelerometer"
    elif frame != "accelerometer":
        estimate, _ = estimate_in(frame, estimate, rests)
    by = f"{'guessed' if grade is None else 'stated'} grade {grade or [*GRADES][-1]}"
    basis = "grades that the residuals allow" if grade is None and fit is not None else by
    determined = np.flatnonzero(estimate.observable)
    parameters = build_parameters(estimate, determined)
    covariance: Array | None = estimate.covariance[np.ix_(determined, determined)]
    budget = contributions_of(estimate.budget, estimate.names, dict.fromkeys(map(group_name, estimate.names), basis))
    if fit is not None and fit.covariance is None:  # as many positions as parameters
        parameters, covariance, budget = tuple(replace(p, u=None, dof=None) for p in parameters), None, ()
    return {
        "frame": frame,
        "parameters": parameters,
        "covariance": covariance,
        "accel": estimate.accel,
        "groups": estimate.groups,
        "prediction": estimate.prediction,
        "evidence": Evidence(fits={} if fit is None else {"accelerometers": fit.fit("m/s^2")}, budget=budget),
    }


def _rests_of(table: ReadingsTable, channels: Channels, site: Site) -> Observations:
    """Return the readings as mean readings of rests, with the covariance of the last digit and of the scatter within
    positions. Raises InputError if a reading is far longer than the others."""
    readings, size = channels.to_si(table.values, NO_TIMES), channels.unit.factor / channels.scale
    lengths = np.linalg.norm(readings, axis=1)
    longest, median = int(np.argmax(lengths)), float(np.median(lengths))
    if lengths[longest] > WILD_RATIO * median > 0.0:
        found = ", ".join(f"{value:.6g}" for value in table.values[longest])
        raise InputError(
            f"{table.path}: line {table.lines[longest]}: expected readings of one vector, all about as long, found "
            f"{found}, {lengths[longest] / median:.3g} times as long as the median; correct the row or leave it out"
        )
    covariance = np.diag((table.resolution_u * size) ** 2)
    if table.covariance is not None:
        covariance += table.covariance * np.outer(size, size)
    return table_rests(readings, covariance, TRIAD, site)


def _fitted(rests: Observations, degrees: int, outlier_sigmas: float) -> tuple[EllipsoidFit | Refusal, Observations]:
    """Fit the ellipsoid without positions beyond some standard deviations, and return it with the rests.

    `degrees` are those of the scatter within positions. For single rows it is 0, and if the residuals exceed their last
    digit they count as exact, so that the scatter is estimated from the residuals."""
    readings, site = rests.rests.accel, rests.site
    fit = partial(fit_ellipsoid, readings, modulus=site.gravity, modulus_u=site.gravity_u, bad_sigmas=outlier_sigmas)
    fitted = fit(covariance=rests.rests.accel_covariance)
    if isinstance(fitted, Refusal):
        return fitted, rests
    if degrees and fitted.scatter == 0.0:
        fitted = replace(fitted, noise_degrees=float(degrees))
    if degrees or (fitted.degrees > 0 and fitted.chi_square <= fitted.degrees):
        return fitted, rests
    exact = replace(rests.rests, accel_covariance=np.zeros((len(readings), 3, 3)))
    return fit(), replace(rests, rests=exact)


def _estimated(
    fit: EllipsoidFit, rests: Observations, degrees: int, grade: str | None, terms: Terms
) -> tuple[EllipsoidFit, Estimate, tuple[str, ...]]:
    """Return the fit, the estimate of the method `ellipsoid`, and a note on the groups of parameters in its u.

    Outliers are fitted too if the groups left out of the fit explain all their residuals."""
    if terms == "linear" or fit.covariance is None:
        return fit, estimate_of(fit, rests), ()
    grades = [
        {name: size for name, size in prior_sizes(each).items() if name in REST_GROUPS}
        for each in (GRADES if grade is None else [grade])
    ]
    sizes = "any grade" if grade is None else f"the grade {grade}"
    note = advised(
        f"quadratic and cubic terms and asymmetry and drift of the sizes usual for {sizes} are in u as far as the "
        "residuals allow; the values take them as zero",
        "" if grade is not None else "--grade states one grade",
        "--terms linear leaves them out of u",
    )
    is_outlier = ~fit.used
    is_outlier[list(fit.doubtful)] = True
    if is_outlier.any():
        largest = {name: max(sizes.get(name, 0.0) for sizes in grades) for sizes in grades for name in sizes}
        problem, _, leaves = omitted_by_rests(replace(rests, usual=largest), fit.values)
        explained = np.linalg.norm(leaves * omitted_sizes(problem, None), axis=1)
        limit = np.where(is_outlier, _sigmas(OUTLIER_PROBABILITY, len(is_outlier)) * explained, np.inf)
        fit_to_all, all_rests = _fitted(rests, degrees, np.inf)
        if isinstance(fit_to_all, EllipsoidFit) and np.all(np.abs(fit_to_all.residual) <= limit):
            fit, rests = fit_to_all, all_rests
    return fit, with_groups(estimate_of(fit, rests), fit, rests, grades), (note,)


def _by_faces(
    rests: Observations, degrees: int, grade: str | None, terms: Terms
) -> tuple[Estimate, Outcome, tuple[str, ...]] | None:
    """Return the joint estimate of bias and scale factor from positions that determine no angles, such as six faces;
    None if the positions are others."""
    readings = rests.rests.accel
    is_upright = np.abs(rough_directions(readings)).max(axis=1) >= UPRIGHT
    if not FEWEST_POSITIONS <= len(readings) < RECORDING_ROWS or not is_upright.all():
        return None
    chosen, middle = grade or [*GRADES][-1], 0.5 * (readings.min(axis=0) + readings.max(axis=0))
    covariance = rests.rests.accel_covariance + (LEAST_NOISE * rests.site.gravity) ** 2 * np.eye(3)
    observations = replace(
        rests,
        rests=replace(rests.rests, accel_covariance=covariance),
        usual={} if terms == "linear" else prior_sizes(chosen),
        in_run={"accel": GRADES[chosen].noise.accel_instability},
        start=dict(zip(TRIAD.names, middle.tolist(), strict=False)),
    )
    try:
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # of readings that contradict the model
            estimate = with_common_tilt(joint(observations), observations)
    except np.linalg.LinAlgError:
        return None
    rows = " and the scatter within positions" if degrees else ""
    note = f"nothing checks the readings: u includes their last digit{rows}, and the usual sizes for the grade {chosen}"
    return estimate, verdict(estimate, observations), (note,)


# -------------------- reasons, remarks and notes --------------------


def _findings(table: ReadingsTable, channels: Channels, site: Site, fit: EllipsoidFit) -> Iterator[Finding]:
    """Yield reasons against a fit and remarks on it; a wrong scale or unit is a reason that explains all others."""
    misstated = _misstated(channels, np.abs(channels.scale / channels.unit.factor) * (1.0 + fit.values[3:6]))
    if misstated is not None:
        yield refusal(misstated)
    else:
        size, unit = engineering("m/s^2", float(np.abs(fit.residual).max()))
        for i in np.flatnonzero(~fit.used).tolist():
            yield refusal(
                f"position {_named(table, [i])} does not fit: {fit.sigmas[i]:.1f} sigma, "
                f"residual {fit.residual[i] / size:+.3g} {unit}; it was left out"
            )
        if fit.doubtful and fit.worst is not None:
            several = "; which of them is wrong cannot be told, so none was left out" if len(fit.doubtful) > 1 else ""
            named = _named(table, sorted(fit.doubtful))
            yield refusal(f"position {named} does not fit: {fit.worst.sigmas:.1f} sigma{several}")
        if not fit.converged:
            yield refusal("the fit did not converge: the readings contradict the model")
    relative, N = fit.scatter / site.gravity, len(table.values)
    is_single = fit.worst is not None and fit.worst.sigmas > _sigmas(SINGLE_OUTLIER_PROBABILITY, N)
    if relative > SCATTER_REMARK:
        scatter = _scatter(table, site.gravity, fit)
        if relative <= (SCATTER_REMARK if is_single else SCATTER_LIMIT):
            yield remark(advised(f"{found_in(scatter)}; u has it", remedy_of(scatter)))
        elif misstated is None:
            yield refusal(scatter)
    if N >= RECORDING_ROWS and table.rows == 1:
        yield remark(
            Advised(
                f"{N} rows count as positions at rest: neighbouring rows of a recording have common errors, and a "
                "moving device reads its own motion, which u does not include",
                "take a log with `tumble calibrate`",
            )
        )


def _scatter(table: ReadingsTable, gravity: float, fit: EllipsoidFit) -> str:
    """Return a sentence on readings with too large a scatter and the positions to look at first."""
    size, unit = engineering("m/s^2", fit.scatter)
    suspects, look = () if fit.worst is None else (fit.worst.position, *fit.worst.rivals), ""
    if fit.worst is not None and len(suspects) <= MOST_SUSPECTS and fit.worst.scatter < 0.5 * fit.scatter:
        without = f"{fit.worst.scatter / size:.3g} {unit}"
        look = f"look first at position {_named(table, sorted(suspects))}, without which it would be {without}"
    limit = gravity * (SCATTER_LIMIT if SCATTER_LIMIT * gravity < fit.scatter else SCATTER_REMARK)
    found = f"the positions scatter by {fit.scatter / size:.3g} {unit}, more than {limit / size:.3g} {unit}"
    return advised(found, look)


def _sigmas(probability: float, positions: int) -> float:
    """Return the normal quantile that chance exceeds in any of the positions with a probability (Bonferroni)."""
    return float(-scipy.special.ndtri(0.5 * probability / positions))


def _named(table: ReadingsTable, positions: Iterable[int]) -> str:
    return " or ".join(f"{i + 1} (line {table.lines[i]})" for i in positions)


def _misstated(channels: Channels, outputs_si: Array | None) -> str | None:
    """Return a sentence if outputs (3,) per m/s² contradict the stated scale and unit, with those that would fit."""
    factor, name, per = channels.unit.factor, channels.unit_name, unit_of_scale(channels)
    if outputs_si is None or not channels.scale_stated or is_near_one(outputs_si * factor / np.abs(channels.scale)):
        return None
    seen = np.sign(channels.scale) * outputs_si * factor
    stated, outputs = (", ".join(f"{v:.3g}" for v in scale) for scale in (channels.scale, seen))
    fitting = [f"--unit {unit}" for unit in fitting_units(outputs_si, UNITS)]
    if name == per:
        fault = f"the readings are {outputs} times what --unit {name} and gravity give"
    else:
        fault = f"the outputs seen are {outputs} {name}/{per}, the scale states {stated}"
        fitting += [f"--scale={outputs}".replace(" ", "")]
    return f"{fault}; {' or '.join(fitting) or 'another unit or scale'} would fit"


def _fit_notes(table: ReadingsTable, fit: EllipsoidFit | None) -> Iterator[str]:
    """Yield notes on a fit whose residuals do not check it."""
    if fit is not None and fit.covariance is not None and fit.scatter == 0.0 and not table.degrees:
        yield "the residuals are no larger than the last digit of the readings explains: u is of that digit"
    if fit is not None and fit.degrees == 0:
        unknown = ", and no uncertainty can be given" if fit.covariance is None else ""
        yield f"as many positions as parameters: nothing checks the fit{unknown}"


# -------------------- the form of the source --------------------


def paper_form(result: ReadingsCalibration) -> tuple[Array, Array | None]:
    """Return the coefficients (9,) of a fit in the form of Table 1 of the source, and their covariance (9, 9), if any.

    They are k in the unit of the table per unit of the input, θ (x, y, z), rad, and b in units of the input."""
    calibration, channels = result.calibration, result.channels
    framed = convert(
        TRIAD,
        None,
        source=frame_of(calibration.frame),
        values=np.array([p.value for p in calibration.parameters[:9]]),
        covariance=None if calibration.covariance is None else calibration.covariance[:9, :9],
        target="paper",
    )
    values, inverse, size = framed.values, framed.accel.inverse(), channels.unit.factor
    b = inverse @ framed.accel.bias
    derivative = Convention(frame="paper", block=TRIAD).jacobian(values)
    by_values = np.zeros((9, 9))
    by_values[:3, 3:6] = np.diag(channels.scale)
    by_values[3:6, [8, 7, 6]] = np.eye(3)  # θx, θy, θz are yz, xz, xy
    by_values[6:] = inverse @ (derivative[:, 3] - np.einsum("pqm,q->pm", derivative[:, :3], b)) / size
    coefficients = np.concatenate([channels.scale * (1.0 + values[3:6]), values[[8, 7, 6]], b / size])
    return coefficients, None if framed.covariance is None else by_values @ framed.covariance @ by_values.T
