"""From a table of readings to a calibration, by the ellipsoid method, and what is said of it.

Everything that the readings do not say of themselves is in `readings.Nominal`. The calibration is in the form of all
others; what a table adds is the residual of every position, plain and left out in turn, and the coefficients in the
form of the source: k in output per g, the angles θ of its upper triangular matrix, the bias b referred to the input,

    u = diag(k) [[1, θz, θy], [0, 1, θx], [0, 0, 1]] (a + b)                                             (1), (5)

The estimate is that of the method `ellipsoid` from rests, whose means the rows are: with quadratic and cubic terms,
asymmetry and drift of the accelerometers in u, of the size usual for the grade. Rows are taken to be in the order and
at the pace of an operator's sheet; those of a recording show in themselves what drifts.

A table has no noise in time to tell the grade of its accelerometers by. Guessed is the poorest of two. By the biases:
the poorest grade whose three usual biases are so small by chance in no less than CHANCE of its instruments. By the
residuals e of the fit, the best grade in which they are so large in no less,

    e = (I − A A⁺)(n + B φ),   Σe² ~ a χ²_ν,  a ν = tr C,  2 a² ν = 2 tr C²,   C = σ²(I − A A⁺) + L Σ_φ Lᵀ

σ being the grade's in-run instability, Σ_φ the usual sizes of what it has beyond the linear model and L what this
leaves in the residuals (Satterthwaite). Noise of the reading itself makes the guess poorer, and u larger, never
smaller.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Unpack

import numpy as np
import scipy

from tumble.arguments import checked
from tumble.brief import Brief
from tumble.diagnosis.linear_model import left_out_by_rests
from tumble.diagnosis.observability import Refusal, undetermined
from tumble.errors import InputError
from tumble.files import FilePath
from tumble.inference.estimate import Estimate, Outcome
from tumble.methods.ellipsoid import estimate_of
from tumble.methods.ellipsoid_fit import TRIAD, EllipsoidFit, fit_ellipsoid
from tumble.recording.session import Site
from tumble.reduction.observations import Observations
from tumble.reduction.rests.rests import Rests
from tumble.result.calibration import Calibration
from tumble.result.evidence import Evidence
from tumble.result.further import KINDS
from tumble.result.parts import CalibratedDevice, Parameter, Readings
from tumble.run.calibrate import provenance_of
from tumble.run.case import estimate_in
from tumble.run.from_estimate import learned_in, parameters_of
from tumble.run.readings_table import (
    THE_FIELD,
    UNITS,
    Nominal,
    ReadingsDescription,
    ReadingsTable,
    nominal_of,
    positions_of,
    read_table,
    sizes_seen,
    table_of,
)
from tumble.sensors.frames import Convention, Frame, convert, frame_of
from tumble.sensors.grades import GRADES
from tumble.sensors.grades import grade as grade_named
from tumble.sensors.parameters import FURTHER, Terms, usual_sizes, variable_of
from tumble.units import Array, engineering, fitting_units, is_near_one
from tumble.usual_setup import MOVE, ON_TABLE

SCATTER_LIMIT = {"accel": 1e-3, "gyro": 1e-3, "mag": 2e-2}
"""Scatter of the positions, in parts of the modulus, above which a triad does not follow the model. Near steel the
field of the Earth is not the same in every position."""

RECORDED_LIMIT = 2e-2
"""The same of samples of a triad that is waved about: of an accelerometer it is its own motion, which makes the vector
longer by its square, 4e-4."""

NAMED = 4
"""Of more positions than these, the one to look at is not told."""

BAD_CHANCE = 1e-3
"""A position is bad where chance alone makes one of the positions so bad in less than this part of all tables."""

WAVED = (
    "an accelerometer that is waved reads its own motion: what of it is always along the same side of the device, as "
    "in turns about a wrist (0.1 m at 60 °/s: 11 mg), passes for a bias and is not in u; a table of readings at rest "
    "has none of it"
)
"""What a recording cannot show of itself."""

CHANCE = 0.01

AT_REST = tuple(
    group.name
    for group in FURTHER
    if group.kind == "accel" and (group.regressors is not None or group.variable == "time")
)
"""The groups of the accelerometers that a table of readings may have in it: what it says nothing of, a temperature or a
motion, is not known to have been there."""


@dataclass(frozen=True, kw_only=True, slots=True, repr=False)
class ReadingsCalibration(Brief):
    """A calibration from a table; `fit` is None where it was refused; whether its rows were recorded one after another
    while the device was waved about."""

    calibration: Calibration
    table: ReadingsTable
    nominal: Nominal
    fit: EllipsoidFit | None
    recorded: bool


@checked
def calibrate_readings(
    readings: ReadingsTable | Array | FilePath,
    *,
    rows_per_position: int = 1,
    grade: str | None = None,
    terms: Terms = "full",
    frame: Frame = "accelerometer",
    serial: str | None = None,
    **described: Unpack[ReadingsDescription],
) -> ReadingsCalibration:
    """Calibrate a triad from a table of its readings in nine or more positions, by the ellipsoid method.

    Parameters
    ----------
    readings
        Array of shape (N, 3), a row per position; or the path of a CSV file with the names of three columns above the
        rows.
    rows_per_position
        Number of rows of each position; equal positions count once.
    grade
        Grade of the accelerometers, by which terms beyond bias, scale factor and axis angles are in u with their usual
        size; guessed if None.
    terms
        `full`, or `linear` to leave these terms out of u.
    frame
        Frame of the result: `accelerometer`, `paper` or `symmetric`.
    serial
        Serial number of the device; the name of the file if None.
    **described
        What the readings are, see `tumble.types.ReadingsDescription`.

    Returns
    -------
    ReadingsCalibration
        The calibration with the fit. If the readings cannot be calibrated, the reasons are in the outcome.

    Raises
    ------
    InputError
        For a table that cannot be read, and for arguments that contradict each other.

    Examples
    --------
    >>> import tumble
    >>> faces = ["0,0,1", "0,0,-1", "0,1,0", "0,-1,0", "1,0,0", "-1,0,0"]
    >>> edges = ["0.6,0.8,0", "0.6,-0.8,0", "0,0.6,0.8", "0,0.6,-0.8", "0.8,0,0.6", "0.8,0,-0.6"]
    >>> _ = Path("readings.csv").write_text("x,y,z\\n" + "\\n".join(faces + edges))
    >>> result = tumble.calibrate_readings("readings.csv", unit="g")
    >>> result.calibration
    <Calibration of readings: ellipsoid, 24 parameters, accepted>
    """
    sensor = described.get("sensor", "accel")
    if sensor != "accel" and frame != "accelerometer":
        raise InputError(f"--frame: expected accelerometer for --sensor {sensor}, found {frame!r}")
    if serial is not None and not serial.strip():
        raise InputError(f"--serial: expected a serial number, found {serial!r}")
    if isinstance(readings, str | os.PathLike):
        whole = read_table(Path(readings), sensor)
    else:
        whole = readings if isinstance(readings, ReadingsTable) else table_of(np.asarray(readings))
    table = positions_of(whole, rows_per_position)
    nominal = nominal_of(table, **described)
    if grade is not None:
        grade_named(grade)
    fitted, noise = _fitted(table, nominal, float(-scipy.special.ndtri(0.5 * BAD_CHANCE / len(table.values))))
    fit: EllipsoidFit | None = None
    estimate: Estimate | None = None
    notes: tuple[str, ...] = ()
    recorded = table.stretch is not None
    if isinstance(fitted, Refusal):
        refusal = (
            undetermined(nominal.to_si(whole.values), block=TRIAD) or fitted
        )  # counts the rows as they are written
        misstated = None if len(refusal.null) else _misstated(nominal, sizes_seen(table.values, nominal.modulus))
        names = tuple(f"{sensor}.{name.partition('.')[2]}" for name in TRIAD.names)
        outcome = Outcome(reasons=(misstated or refusal.reason,), unobservable=names)
    else:
        fit, estimate, notes = _estimated(fitted, noise, table, nominal, grade, terms)
        remarks = (WAVED,) if recorded and sensor == "accel" else ()
        outcome = Outcome(reasons=tuple(_reasons(table, nominal, fit)), remarks=remarks)
    parameters: tuple[Parameter, ...] = ()
    has_u = fit is not None and fit.covariance is not None
    if estimate is not None:
        learned = learned_in(estimate)
        if frame != "accelerometer":
            estimate, _ = estimate_in(frame, estimate, _rests(table, nominal, np.zeros((3, 3))))
        named = replace(
            estimate,
            names=tuple(f"{sensor}.{name.partition('.')[2]}" for name in estimate.names),
            units=(nominal.result_unit,) * 3 + estimate.units[3:],
        )
        parameters = parameters_of(named, np.arange(len(named.names)), {}, learned)
        parameters = parameters if has_u else tuple(replace(p, u=None, dof=None) for p in parameters)
    models: dict[str, Any] = dict.fromkeys(("accel", "gyro", "mag")) | {sensor: estimate and estimate.accel}
    site = replace(_site(nominal), gravity_is_unit=nominal.modulus_u is None)
    # where the scatter is that of all there is, a row has no uncertainty beside it
    row_known = fit is not None and (table.covariance is not None or fit.scatter == 0.0)
    worth = Readings(
        columns=table.columns,
        unit=nominal.unit,
        increments=False,
        scale=tuple(nominal.scale.tolist()),
        offset=(0.0, 0.0, 0.0),
        row_u=tuple((table.row_u / np.abs(nominal.scale)).tolist()) if row_known else (),
    )
    calibration = Calibration(
        device=CalibratedDevice(serial=table.path.stem if serial is None else serial),
        method="ellipsoid",
        frame="accelerometer" if estimate is None else frame,
        parameters=parameters,
        covariance=estimate.covariance if estimate is not None and has_u else None,
        **models,
        outcome=outcome,
        groups=() if estimate is None else estimate.groups,
        prediction=None if estimate is None else estimate.prediction,
        evidence=Evidence(fits={} if fit is None else {KINDS[sensor]: fit.fit(nominal.result_unit)}),
        provenance=replace(
            provenance_of(table.sha256),
            site=site if sensor == "accel" else None,
            readings={sensor: worth},
            notes=(*table.left_out, *_notes(table, nominal, fit), *notes),
        ),
    )
    return ReadingsCalibration(
        calibration=calibration, table=table, nominal=nominal, fit=fit, recorded=recorded and fit is not None
    )


def _site(nominal: Nominal) -> Site:
    """A place where the modulus is gravity."""
    return Site(latitude=None, height=0.0, gravity=nominal.modulus, gravity_u=nominal.modulus_u or 0.0)


def _fitted(table: ReadingsTable, nominal: Nominal, bad: float) -> tuple[EllipsoidFit | Refusal, Array]:
    """The fit without positions beyond `bad` standard deviations, and the covariance (3, 3) of a reading that it was
    made with. It has the scatter that the residuals show; where they show less than the last digit of the readings
    explains, that. Of blocks of rows it has their own scatter."""
    readings = nominal.to_si(table.values)
    fit = partial(fit_ellipsoid, readings, modulus=nominal.modulus, modulus_u=nominal.modulus_u or 0.0)
    floor, none = np.diag((table.resolution_u / nominal.scale) ** 2), np.zeros((3, 3))
    if table.stretch is not None:
        return fit(blocks=table.stretch), none
    if table.covariance is not None:
        floor += table.covariance / np.outer(nominal.scale, nominal.scale)
    known = fit(covariance=np.broadcast_to(floor, (len(readings), 3, 3)), bad_sigmas=bad)
    if isinstance(known, Refusal):
        return known, floor
    within = table.covariance is not None
    if within and known.scatter == 0.0 and table.degrees:
        known = replace(known, noise_degrees=float(table.degrees))
    if within or (known.degrees > 0 and known.chi_square <= known.degrees):
        return known, floor
    return fit(bad_sigmas=bad), none


def _estimated(
    fit: EllipsoidFit, noise: Array, table: ReadingsTable, nominal: Nominal, grade: str | None, terms: Terms
) -> tuple[EllipsoidFit, Estimate, tuple[str, ...]]:
    """The fit, with the positions that what it leaves out makes look bad, the estimate of the method `ellipsoid`, and
    what its u has of what it leaves out, in words."""
    rests = _rests(table, nominal, noise)
    if nominal.sensor == "gyro":
        note = "u has no part of asymmetry and g-sensitivity of the gyros, which the readings do not tell from biases"
        return fit, estimate_of(fit, rests), (note,)
    if nominal.sensor == "mag" or terms == "linear" or fit.covariance is None:
        return fit, estimate_of(fit, rests), ()
    chosen, origin = (grade, "") if grade is not None else guessed_grade(fit, rests)
    usual, what = _usual(chosen), "quadratic and cubic terms, asymmetry and drift"
    if table.stretch is not None:
        usual = {name: size for name, size in usual.items() if variable_of(name) is None}
        what = "quadratic and cubic terms and asymmetry"
    note = (
        f"{what} of the size usual for the grade {chosen} are in u{origin}; the values take them as nothing, and "
        "--terms linear leaves them out"
    )
    rests = replace(rests, usual=usual)
    bad = ~fit.used
    bad[list(fit.doubtful)] = True
    if bad.any():  # by how much a residual may be off by the in-run instability and by what is left out
        (beyond, leaves), instability = left_out_by_rests(rests), GRADES[chosen].noise.accel_instability
        sigma = np.sqrt(instability**2 + ((leaves * beyond.usual) ** 2).sum(axis=1))
        allowed = float(-scipy.special.ndtri(0.5 * BAD_CHANCE / len(table.values))) * sigma
        whole, noise = _fitted(table, nominal, np.inf)
        if isinstance(whole, EllipsoidFit) and np.all(np.abs(whole.residual) <= np.where(bad, allowed, np.inf)):
            fit, rests = whole, replace(_rests(table, nominal, noise), usual=usual)
    return fit, estimate_of(fit, rests), (note,)


def _usual(grade: str) -> dict[str, float]:
    """What a table may have beyond the linear model, and its usual size."""
    return {name: size for name, size in usual_sizes(grade).items() if name in AT_REST}


def guessed_grade(fit: EllipsoidFit, rests: Observations) -> tuple[str, str]:
    """The grade, and what it is guessed from, in words (module docstring)."""
    best, *_, poorest = order = [*GRADES]

    def chance_of_biases(grade: str) -> float:
        return float(scipy.special.chdtr(3, (fit.values[:3] ** 2).sum() / GRADES[grade].accel.bias ** 2))

    def chance_of_residuals(grade: str) -> float:
        if fit.degrees == 0:
            return 1.0
        beyond, leaves = left_out_by_rests(replace(rests, usual=_usual(grade)))
        noise, left = GRADES[grade].noise.accel_instability ** 2, leaves * beyond.usual
        of_groups = left.T @ left
        trace = noise * fit.degrees + np.trace(of_groups)
        square = noise**2 * fit.degrees + 2.0 * noise * np.trace(of_groups) + float((of_groups**2).sum())
        degrees = trace**2 / square
        return float(scipy.special.chdtrc(degrees, degrees * float((fit.residual[fit.used] ** 2).sum()) / trace))

    by_biases = next((grade for grade in order[::-1] if chance_of_biases(grade) > CHANCE), best)
    by_residuals = next((grade for grade in order if chance_of_residuals(grade) > CHANCE), poorest)
    poorer, what = max((by_biases, "biases"), (by_residuals, "residuals"), key=lambda each: order.index(each[0]))
    return poorer, f", guessed from the {what}; state another with --grade"


def _rests(table: ReadingsTable, nominal: Nominal, noise: Array) -> Observations:
    """The readings as the mean readings of rests, with the modulus in the place of gravity."""
    readings = nominal.to_si(table.values)
    N = len(readings)
    none, start = np.zeros((N, 0)), np.asarray(np.arange(N) * (ON_TABLE.rest + MOVE))
    white = Rests.of_white_noise(start, start + ON_TABLE.rest, accel=readings, gyro=none, densities=(0.0, 0.0))
    covariance = np.broadcast_to(noise, (N, 3, 3))
    return Observations(
        accel_block=TRIAD,
        gyro_block=None,
        site=_site(nominal),
        rests=replace(white, accel_covariance=covariance, accel_drift=none, accel_noise=none),
    )


def _reasons(table: ReadingsTable, nominal: Nominal, fit: EllipsoidFit) -> Iterator[str]:
    """What speaks against a fit."""
    misstated = _misstated(nominal, np.abs(nominal.scale) * (1.0 + fit.values[3:6]))
    if misstated is not None:
        yield misstated
        return

    def named(which: Iterable[int]) -> str:
        return " or ".join(f"{i + 1} (line {table.lines[i]})" for i in which)

    size, unit = engineering(nominal.result_unit, float(np.abs(fit.residual).max()))
    for i in np.flatnonzero(~fit.used).tolist():
        yield (
            f"position {named([i])} does not fit: {fit.sigmas[i]:.1f} sigma, residual {fit.residual[i] / size:+.3g} "
            f"{unit}; it was left out"
        )
    if fit.doubtful and fit.worst is not None:
        several = "; these positions do not tell which, so that none was left out" if len(fit.doubtful) > 1 else ""
        yield f"position {named(sorted(fit.doubtful))} does not fit: {fit.worst.sigmas:.1f} sigma{several}"
    rows = "positions" if table.stretch is None else "samples"
    limit = (SCATTER_LIMIT[nominal.sensor] if table.stretch is None else RECORDED_LIMIT) * nominal.modulus
    if fit.scatter > limit:
        size, unit = engineering(nominal.result_unit, fit.scatter)
        first, look = () if fit.worst is None else (fit.worst.position, *fit.worst.rivals), ""
        if fit.worst is not None and len(first) <= NAMED and fit.worst.scatter < 0.5 * fit.scatter:
            without = f"{fit.worst.scatter / size:.3g} {unit}"
            look = f"; look first at position {named(sorted(first))}, without which it would be {without}"
        yield f"the {rows} scatter by {fit.scatter / size:.3g} {unit}, more than {limit / size:.3g} {unit}{look}"
    if not fit.converged:
        yield "the fit did not converge: the readings contradict the model"


def _misstated(nominal: Nominal, seen: Array | None) -> str | None:
    """That the channels' output `seen` (3,), per SI unit, is not what scale and unit state, and which would fit; iron
    around a magnetometer may do more."""
    if nominal.estimated or nominal.sensor == "mag" or seen is None or is_near_one(seen / np.abs(nominal.scale)):
        return None
    stated, outputs = (
        ", ".join(f"{v * nominal.per_factor:.3g}" for v in scale)
        for scale in (nominal.scale, np.sign(nominal.scale) * seen)
    )
    fitting = [f"--unit {unit}" for unit in fitting_units(seen, UNITS[nominal.sensor])]
    if nominal.unit == nominal.per:
        length = "gravity" if nominal.sensor == "accel" else "--modulus"
        fault = f"the readings are {outputs} times what --unit {nominal.unit} and {length} give"
    else:
        fault = f"the outputs seen are {outputs} {nominal.unit}/{nominal.per}, the scale states {stated}"
        fitting += [f"--scale={outputs}".replace(" ", "")]
    return f"{fault}; {' or '.join(fitting) or 'another unit or scale'} would fit"


def _notes(table: ReadingsTable, nominal: Nominal, fit: EllipsoidFit | None) -> Iterator[str]:
    """What u has of the modulus, where that is not what is usual, and what was taken for scale and polarity."""
    u, per = nominal.modulus_u, ", ".join(f"{s * nominal.per_factor:.6g}" for s in nominal.scale)
    if nominal.sensor == "accel" and u is None:
        yield (
            "gravity is not stated: g at the place of the readings is the unit, for which 9.80665 m/s^2 stands; u has "
            "no part of it, which may be 0.3 %. For values in m/s^2 give --gravity and --gravity-u"
        )
    elif nominal.sensor == "accel" and u == 0.0:
        yield "gravity is taken as exact, as --gravity-u states"
    elif nominal.sensor == "accel":
        yield f"gravity {nominal.modulus:.9g} m/s^2 with u = {u:.2g} m/s^2, in all scale factors"
    elif u is None and nominal.per != THE_FIELD:
        what = {"gyro": "the rate of the table", "mag": "the field"}[nominal.sensor]
        yield (
            f"the uncertainty of {what} is not stated (--modulus-u): scale factors are relative to it, and u has no "
            "part of it"
        )
    if nominal.estimated:
        yield f"no nominal scale was stated: {per} {nominal.unit}/{nominal.per} was taken from the readings"
    if nominal.assumed:
        yield (
            f"polarity of {', '.join(nominal.assumed)}: taken as positive, since the readings do not tell it; state it "
            "with --scale or --position"
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
    """k (3,) in the table's unit per `per`; θ (x, y, z), rad; b (3,), in units of `per`; with the covariance (9, 9) of
    all, k, θ, b, None where there is none."""

    k: Array
    theta: Array
    b: Array
    covariance: Array | None


def paper_form(result: ReadingsCalibration) -> PaperForm:
    """The coefficients of a fit in the form of Table 1 of the source."""
    calibration, nominal = result.calibration, result.nominal
    framed = convert(
        TRIAD,
        None,
        source=frame_of(calibration.frame),
        values=np.array([p.value for p in calibration.parameters[:9]]),
        covariance=None if calibration.covariance is None else calibration.covariance[:9, :9],
        target="paper",
    )
    values, model = framed.values, framed.accel
    inverse = model.inverse()
    b = inverse @ model.bias
    derivative = Convention(frame="paper", block=TRIAD).jacobian(values)
    by_values = np.zeros((9, 9))
    scale = nominal.scale * nominal.per_factor
    by_values[:3, 3:6] = np.diag(scale)
    by_values[3:6, [8, 7, 6]] = np.eye(3)  # θx, θy, θz are yz, xz, xy
    change = derivative[:, 3] - np.einsum("pqm,q->pm", derivative[:, :3], b)
    by_values[6:] = inverse @ change / nominal.per_factor
    covariance = None if framed.covariance is None else by_values @ framed.covariance @ by_values.T
    return PaperForm(
        k=scale * (1.0 + values[3:6]),
        theta=values[[8, 7, 6]],
        b=b / nominal.per_factor,
        covariance=covariance,
    )
