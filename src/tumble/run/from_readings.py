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

import numpy as np
import scipy

from tumble.advice import Advised, advised, found_in, remedy_of
from tumble.arguments import checked
from tumble.brief import Brief
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
from tumble.recording.session import Site
from tumble.reduction.observations import Observations
from tumble.result.calibration import Calibration
from tumble.result.parts import SERIAL_NOT_STATED, CalibratedDevice, Evidence, Readings
from tumble.result.uncertainty_budget import contributions_of
from tumble.run.calibrate import new_provenance
from tumble.run.case import estimate_in
from tumble.run.from_estimate import build_parameters, prior_fields
from tumble.run.readings_table import (
    UNITS,
    Nominal,
    ReadingsTable,
    fitted_outputs,
    nominal_of,
    positions_of,
    read_table,
    table_of,
    table_rests,
)
from tumble.sensors.frames import Convention, Frame, convert, frame_of
from tumble.sensors.grades import GRADES
from tumble.sensors.grades import grade as grade_named
from tumble.sensors.parameters import FURTHER, Terms, group_name, prior_sizes
from tumble.units import Array, engineering, fitting_units, is_near_one

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
    """A calibration from a table; `fit` is None for six faces and if the fit was refused."""

    calibration: Calibration
    table: ReadingsTable
    nominal: Nominal
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
    table = positions_of(rows, rows_per_position)
    nominal = nominal_of(
        table,
        unit=unit,
        scale=scale,
        scale_per=scale_per,
        gravity=gravity,
        gravity_u=gravity_u,
        directions=directions or {},
    )
    _check_lengths(table, nominal)
    if grade is not None:
        grade_named(grade)
    fitted, noise = _fitted(table, nominal, _sigmas(OUTLIER_PROBABILITY, table))
    fit, estimate, notes = None, None, tuple[str, ...]()
    if isinstance(fitted, EllipsoidFit):
        fit, estimate, notes = _estimated(fitted, noise, table, nominal, grade, terms)
        outcome = Outcome(reasons=tuple(_reasons(table, nominal, fit)), remarks=tuple(_remarks(table, nominal, fit)))
    else:
        refusal = undetermined_by_positions(nominal.to_si(rows.values), block=TRIAD) or fitted  # of the rows as written
        by_faces = _by_faces(table, nominal, noise, grade, terms) if len(refusal.null) else None
        misstated = None if len(refusal.null) else _misstated(nominal, fitted_outputs(table.values, nominal.gravity))
        outcome = Outcome(reasons=(misstated or refusal.reason,), unobservable=TRIAD.names)
        if by_faces is not None:
            estimate, outcome, notes = by_faces
    frame = "accelerometer" if fit is None else frame
    has_u, learned = fit is None or fit.covariance is not None, {} if estimate is None else prior_fields(estimate)
    if estimate is not None and frame != "accelerometer":
        estimate, _ = estimate_in(frame, estimate, _rests(table, nominal, np.zeros((3, 3))))
    budget, by = None if estimate is None or not has_u else estimate.budget, "grades that the residuals allow"
    if grade is not None or fit is None:
        by = f"{'stated' if grade is not None else 'guessed'} grade {grade or [*GRADES][-1]}"
    basis = {} if estimate is None else dict.fromkeys(map(group_name, estimate.names), by)
    unstated = (f"{SERIAL_NOT_STATED}: the name of the table stands for it",) if serial is None else ()
    determined = np.flatnonzero([] if estimate is None else estimate.observable)
    parameters = () if estimate is None else build_parameters(estimate, determined, {}, learned)
    # scatter estimated from single rows contains the uncertainty of a row
    row_known = fit is not None and (table.covariance is not None or fit.scatter == 0.0)
    meaning = Readings(
        columns=table.columns,
        unit=nominal.unit,
        increments=False,
        scale=tuple(nominal.scale.tolist()),
        offset=(0.0, 0.0, 0.0),
        row_u=tuple((table.row_u / np.abs(nominal.scale)).tolist()) if row_known else (),
    )
    calibration = Calibration(
        device=CalibratedDevice(serial=table.path.stem if serial is None else serial.strip()),
        method="ellipsoid" if estimate is None else estimate.method,
        frame=frame,
        parameters=parameters if has_u else tuple(replace(p, u=None, dof=None) for p in parameters),
        covariance=estimate.covariance[np.ix_(determined, determined)] if estimate is not None and has_u else None,
        accel=None if estimate is None else estimate.accel,
        gyro=None,
        outcome=outcome,
        groups=() if estimate is None else estimate.groups,
        prediction=None if estimate is None else estimate.prediction,
        evidence=Evidence(
            fits={} if fit is None else {"accelerometers": fit.fit("m/s^2")},
            budget=contributions_of(budget, () if estimate is None else estimate.names, basis),
        ),
        provenance=replace(
            new_provenance(table.sha256),
            site=replace(_site(nominal), gravity_is_unit=nominal.gravity_u is None),
            readings={"accel": meaning},
            notes=(*unstated, *table.left_out, *_notes(table, nominal, fit), *notes),
        ),
    )
    return ReadingsCalibration(calibration=calibration, table=table, nominal=nominal, fit=fit)


def _check_lengths(table: ReadingsTable, nominal: Nominal) -> None:
    """Raise InputError if a reading is far longer than the others."""
    lengths = np.linalg.norm(nominal.to_si(table.values), axis=1)
    longest, median = int(np.argmax(lengths)), float(np.median(lengths))
    if lengths[longest] > WILD_RATIO * median > 0.0:
        found = ", ".join(f"{value:.6g}" for value in table.values[longest])
        raise InputError(
            f"{table.path}: line {table.lines[longest]}: expected readings of one vector, all about as long, found "
            f"{found}, {lengths[longest] / median:.3g} times as long as the median; correct the row or leave it out"
        )


def _site(nominal: Nominal) -> Site:
    return Site(latitude=None, height=None, gravity=nominal.gravity, gravity_u=nominal.gravity_u or 0.0)


def _rests(table: ReadingsTable, nominal: Nominal, covariance: Array) -> Observations:
    """Return the readings as mean readings of rests, with the covariance (3, 3) of each."""
    return table_rests(nominal.to_si(table.values), covariance, TRIAD, _site(nominal))


def _fitted(table: ReadingsTable, nominal: Nominal, outlier_sigmas: float) -> tuple[EllipsoidFit | Refusal, Array]:
    """Fit the ellipsoid without positions beyond some standard deviations.

    The covariance (3, 3) of a reading is returned too: that of the last digit and of the scatter within positions, or
    zero if positions are single rows and the residuals exceed it, so that the scatter is estimated from them."""
    readings = nominal.to_si(table.values)
    gravity_u = nominal.gravity_u or 0.0
    fit = partial(fit_ellipsoid, readings, modulus=nominal.gravity, modulus_u=gravity_u, bad_sigmas=outlier_sigmas)
    covariance = np.diag((table.resolution_u / nominal.scale) ** 2)
    if table.covariance is not None:
        covariance += table.covariance / np.outer(nominal.scale, nominal.scale)
    fitted = fit(covariance=np.broadcast_to(covariance, (len(readings), 3, 3)))
    if isinstance(fitted, Refusal):
        return fitted, covariance
    if table.covariance is not None and fitted.scatter == 0.0 and table.degrees:
        fitted = replace(fitted, noise_degrees=float(table.degrees))
    if table.covariance is not None or (fitted.degrees > 0 and fitted.chi_square <= fitted.degrees):
        return fitted, covariance
    return fit(), np.zeros((3, 3))


def _estimated(
    fit: EllipsoidFit, noise: Array, table: ReadingsTable, nominal: Nominal, grade: str | None, terms: Terms
) -> tuple[EllipsoidFit, Estimate, tuple[str, ...]]:
    """Return the fit, the estimate of the method `ellipsoid`, and a note on the groups of parameters in its u.

    Outliers are fitted too if the groups left out of the fit explain all their residuals."""
    rests = _rests(table, nominal, noise)
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
        limit = np.where(is_outlier, _sigmas(OUTLIER_PROBABILITY, table) * explained, np.inf)
        fit_to_all, noise = _fitted(table, nominal, np.inf)
        if isinstance(fit_to_all, EllipsoidFit) and np.all(np.abs(fit_to_all.residual) <= limit):
            fit, rests = fit_to_all, _rests(table, nominal, noise)
    return fit, with_groups(estimate_of(fit, rests), fit, rests, grades), (note,)


def _by_faces(
    table: ReadingsTable, nominal: Nominal, noise: Array, grade: str | None, terms: Terms
) -> tuple[Estimate, Outcome, tuple[str, ...]] | None:
    """Return the joint estimate of bias and scale factor from positions that determine no angles, such as six faces;
    None if the positions are others."""
    rests, readings = _rests(table, nominal, noise), nominal.to_si(table.values)
    is_upright = np.abs(rough_directions(readings)).max(axis=1) >= UPRIGHT
    if not FEWEST_POSITIONS <= len(readings) < RECORDING_ROWS or not is_upright.all():
        return None
    chosen, middle = grade or [*GRADES][-1], 0.5 * (readings.min(axis=0) + readings.max(axis=0))
    covariance = rests.rests.accel_covariance + (LEAST_NOISE * nominal.gravity) ** 2 * np.eye(3)
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
    rows = "" if table.covariance is None else " and the scatter within positions"
    note = f"nothing checks the readings: u includes their last digit{rows}, and the usual sizes for the grade {chosen}"
    return estimate, verdict(estimate, observations), (note,)


# -------------------- reasons, remarks and notes --------------------


def _reasons(table: ReadingsTable, nominal: Nominal, fit: EllipsoidFit) -> Iterator[str]:
    misstated = _misstated(nominal, np.abs(nominal.scale) * (1.0 + fit.values[3:6]))
    if misstated is not None:
        yield misstated
        return
    size, unit = engineering("m/s^2", float(np.abs(fit.residual).max()))
    for i in np.flatnonzero(~fit.used).tolist():
        yield (
            f"position {_named(table, [i])} does not fit: {fit.sigmas[i]:.1f} sigma, "
            f"residual {fit.residual[i] / size:+.3g} {unit}; it was left out"
        )
    if fit.doubtful and fit.worst is not None:
        several = "; which of them is wrong cannot be told, so none was left out" if len(fit.doubtful) > 1 else ""
        yield f"position {_named(table, sorted(fit.doubtful))} does not fit: {fit.worst.sigmas:.1f} sigma{several}"
    if fit.scatter > _limit(table, fit) * nominal.gravity:
        yield _scatter(table, nominal, fit)
    if not fit.converged:
        yield "the fit did not converge: the readings contradict the model"


def _remarks(table: ReadingsTable, nominal: Nominal, fit: EllipsoidFit) -> Iterator[str]:
    """Return remarks on a fit that may be accepted."""
    if SCATTER_REMARK < fit.scatter / nominal.gravity <= _limit(table, fit):
        scatter = _scatter(table, nominal, fit)
        yield advised(f"{found_in(scatter)}; u has it", remedy_of(scatter))
    if len(table.values) >= RECORDING_ROWS and table.rows == 1:
        yield Advised(
            f"{len(table.values)} rows count as positions at rest: neighbouring rows of a recording have common "
            "errors, and a moving device reads its own motion, which u does not include",
            "take a log with `tumble calibrate`",
        )


def _limit(table: ReadingsTable, fit: EllipsoidFit) -> float:
    """Return the largest scatter that is accepted, relative to gravity."""
    is_single = fit.worst is not None and fit.worst.sigmas > _sigmas(SINGLE_OUTLIER_PROBABILITY, table)
    return SCATTER_REMARK if is_single else SCATTER_LIMIT


def _scatter(table: ReadingsTable, nominal: Nominal, fit: EllipsoidFit) -> str:
    """Return a sentence on readings with too large a scatter and the positions to look at first."""
    size, unit = engineering("m/s^2", fit.scatter)
    suspects, look = () if fit.worst is None else (fit.worst.position, *fit.worst.rivals), ""
    if fit.worst is not None and len(suspects) <= MOST_SUSPECTS and fit.worst.scatter < 0.5 * fit.scatter:
        without = f"{fit.worst.scatter / size:.3g} {unit}"
        look = f"look first at position {_named(table, sorted(suspects))}, without which it would be {without}"
    limit = nominal.gravity * (SCATTER_LIMIT if SCATTER_LIMIT * nominal.gravity < fit.scatter else SCATTER_REMARK)
    found = f"the positions scatter by {fit.scatter / size:.3g} {unit}, more than {limit / size:.3g} {unit}"
    return advised(found, look)


def _sigmas(probability: float, table: ReadingsTable) -> float:
    """Return the normal quantile that chance exceeds in any of the positions with a probability (Bonferroni)."""
    return float(-scipy.special.ndtri(0.5 * probability / len(table.values)))


def _named(table: ReadingsTable, positions: Iterable[int]) -> str:
    return " or ".join(f"{i + 1} (line {table.lines[i]})" for i in positions)


def _misstated(nominal: Nominal, outputs_si: Array | None) -> str | None:
    """Return a sentence if outputs (3,) per m/s² contradict the stated scale and unit, with those that would fit."""
    if nominal.estimated or outputs_si is None or is_near_one(outputs_si / np.abs(nominal.scale)):
        return None
    per_unit = np.sign(nominal.scale) * outputs_si * UNITS[nominal.per]
    stated, outputs = (", ".join(f"{v:.3g}" for v in scale) for scale in (nominal.per_unit, per_unit))
    fitting = [f"--unit {unit}" for unit in fitting_units(outputs_si, UNITS)]
    if nominal.unit == nominal.per:
        fault = f"the readings are {outputs} times what --unit {nominal.unit} and gravity give"
    else:
        fault = f"the outputs seen are {outputs} {nominal.unit}/{nominal.per}, the scale states {stated}"
        fitting += [f"--scale={outputs}".replace(" ", "")]
    return f"{fault}; {' or '.join(fitting) or 'another unit or scale'} would fit"


def _notes(table: ReadingsTable, nominal: Nominal, fit: EllipsoidFit | None) -> Iterator[str]:
    """Return notes on gravity, scale and polarity, and on a fit without redundancy."""
    u = nominal.gravity_u
    if u is None:
        yield Advised(
            "gravity is not stated: the unit is g at the place of the readings, printed as 9.80665 m/s^2; u does not "
            "include the difference, up to 0.3 %",
            "for values in m/s^2 give --gravity and --gravity-u",
        )
    elif u == 0.0:
        yield "gravity is taken as exact, as stated"
    else:
        yield f"gravity {nominal.gravity:.9g} m/s^2 with u = {u:.2g} m/s^2, in all scale factors"
    if nominal.estimated:
        per, fitting = ", ".join(f"{s:.6g}" for s in nominal.per_unit), fitting_units(np.abs(nominal.scale), UNITS)
        also = f"{' or '.join(f'--unit {unit}' for unit in fitting)} would fit" if fitting else ""
        yield advised(
            f"no nominal scale was stated: {per} {nominal.unit}/{nominal.per} was taken from the readings", also
        )
    if nominal.assumed:
        yield Advised(
            f"polarity of {', '.join(nominal.assumed)}: taken as positive, since the readings do not show it",
            "state it with --scale or --position",
        )
    negative = [name for name, s in zip(table.columns, nominal.scale, strict=True) if s < 0.0]
    if negative:
        mirrored = (
            "; as they are written, the readings are the mirror image of a right-handed triad, so the fit needs a "
            "reflection"
        )
        odd = mirrored if len(negative) % 2 else ""
        yield f"polarity of {', '.join(negative)}: negative, as the scale or the positions state{odd}"
    if fit is not None and fit.covariance is not None and fit.scatter == 0.0 and table.covariance is None:
        yield "the residuals are no larger than the last digit of the readings explains: u is of that digit"
    if fit is not None and fit.degrees == 0:
        unknown = ", and no uncertainty can be given" if fit.covariance is None else ""
        yield f"as many positions as parameters: nothing checks the fit{unknown}"


# -------------------- the form of the source --------------------


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class PaperForm:
    """Coefficients of Eq. (1): k (3,) in the table's unit per `per`, θ (x, y, z), rad, and b (3,) in units of `per`.

    `covariance` (9, 9) is that of k, θ and b; None where there is none."""

    k: Array
    theta: Array
    b: Array
    covariance: Array | None


def paper_form(result: ReadingsCalibration) -> PaperForm:
    """Return the coefficients of a fit in the form of Table 1 of the source."""
    calibration, nominal = result.calibration, result.nominal
    framed = convert(
        TRIAD,
        None,
        source=frame_of(calibration.frame),
        values=np.array([p.value for p in calibration.parameters[:9]]),
        covariance=None if calibration.covariance is None else calibration.covariance[:9, :9],
        target="paper",
    )
    values, inverse, size = framed.values, framed.accel.inverse(), UNITS[nominal.per]
    b = inverse @ framed.accel.bias
    derivative = Convention(frame="paper", block=TRIAD).jacobian(values)
    by_values = np.zeros((9, 9))
    by_values[:3, 3:6] = np.diag(nominal.per_unit)
    by_values[3:6, [8, 7, 6]] = np.eye(3)  # θx, θy, θz are yz, xz, xy
    by_values[6:] = inverse @ (derivative[:, 3] - np.einsum("pqm,q->pm", derivative[:, :3], b)) / size
    return PaperForm(
        k=nominal.per_unit * (1.0 + values[3:6]),
        theta=values[[8, 7, 6]],
        b=b / size,
        covariance=None if framed.covariance is None else by_values @ framed.covariance @ by_values.T,
    )
