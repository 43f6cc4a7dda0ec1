"""From a table of readings to a calibration, by the ellipsoid method, and what is said of it.

Everything that the readings do not say of themselves is in `readings.Nominal`. The calibration is in the form of all
others; what a table adds is the residual of every position, plain and left out in turn, and the coefficients in the
form of the source: k in output per g, the angles θ of its upper triangular matrix, the bias b referred to the input,

    u = diag(k) [[1, θz, θy], [0, 1, θx], [0, 0, 1]] (a + b)                                             (1), (5)

The estimate is that of the method `ellipsoid` from rests, whose means the rows are: with quadratic and cubic terms,
asymmetry and drift of the accelerometers in u, of the size usual for the grade. Rows are taken to be in the order and
at the pace of an operator's sheet; those of a recording show in themselves what drifts.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from scipy.special import ndtri

from tumble import __version__
from tumble.brief import Brief
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
from tumble.result.parts import Parameter, Readings
from tumble.run.case import estimate_in
from tumble.run.from_estimate import learned_in, parameters_of
from tumble.run.readings_grade import AT_REST, guessed_grade, residual_of
from tumble.run.readings_table import (
    THE_FIELD,
    Nominal,
    ReadingsTable,
    Sensor,
    TablePositions,
    plain_units,
    positions_of,
    read_table,
    sizes_seen,
)
from tumble.run.readings_table import nominal as nominal_of
from tumble.sensors.frames import Convention, Frame, convert, frame_of
from tumble.sensors.grades import grade as grade_named
from tumble.sensors.parameters import usual_sizes, variable_of
from tumble.units import Array, engineering
from tumble.usual_setup import MOVE, ON_TABLE

if TYPE_CHECKING:
    from tumble.run.calibrate import Terms

SCATTER_LIMIT = {"accel": 1e-3, "gyro": 1e-3, "mag": 2e-2}
"""Scatter of the positions, in parts of the modulus, above which a triad does not follow the model. Near steel the
field of the Earth is not the same in every position."""

RECORDED_LIMIT = 2e-2
"""The same of samples of a triad that is waved about: of an accelerometer it is its own motion, which makes the vector
longer by its square, 4e-4."""

SIZE_TOLERANCE = 0.25
"""Scale factors may be off the stated ones by this part before scale and unit are doubted. Iron around a magnetometer
may do more."""

NAMED = 4
"""Of more positions than these, the one to look at is not told."""

BAD_CHANCE = 1e-3
"""A position is bad where chance alone makes one of the positions so bad in less than this part of all tables."""

_FIT_NAMES = {"accel": "accelerometers", "gyro": "gyros", "mag": "magnetometer"}


@dataclass(frozen=True, kw_only=True, slots=True, repr=False)
class ReadingsCalibration(Brief):
    """A calibration from a table; `fit` is None where it was refused; whether its rows were recorded one after another
    while the device was waved about."""

    calibration: Calibration
    table: ReadingsTable
    nominal: Nominal
    fit: EllipsoidFit | None
    recorded: bool


def calibrate_table(
    readings: ReadingsTable | FilePath,
    *,
    sensor: Sensor = "accel",
    unit: str = "V",
    scale: Sequence[float] | None = None,
    scale_per: str | None = None,
    gravity: float | None = None,
    gravity_u: float | None = None,
    modulus: float | None = None,
    modulus_u: float | None = None,
    known: Mapping[int, Array] | None = None,
    rows_per_position: int = 1,
    grade: str | None = None,
    terms: Terms = "full",
    frame: Frame = "accelerometer",
    serial: str | None = None,
) -> ReadingsCalibration:
    """Calibrate a triad by the ellipsoid method from its readings in N ≥ 9 positions, a table or its CSV file. Each
    position is `rows_per_position` rows; equal ones count once. What the readings are worth is said as
    `readings_table.nominal` takes it. The `terms` that accelerometers have beyond bias, scale factor and axis angles
    are in u, of the size usual for the `grade`, guessed where None; `linear` leaves them out. What cannot be calibrated
    comes back with the reasons in its outcome. Without a `serial` number of the device it is the name of the table.
    Raises InputError for a table that cannot be read and for options that do not go together.

    >>> import tumble
    >>> faces = ["0,0,1", "0,0,-1", "0,1,0", "0,-1,0", "1,0,0", "-1,0,0"]
    >>> edges = ["0.6,0.8,0", "0.6,-0.8,0", "0,0.6,0.8", "0,0.6,-0.8", "0.8,0,0.6", "0.8,0,-0.6"]
    >>> _ = Path("readings.csv").write_text("x,y,z\\n" + "\\n".join(faces + edges))
    >>> result = tumble.calibrate_table("readings.csv", unit="g")
    >>> result.calibration
    <Calibration of readings: ellipsoid, 24 parameters, accepted>
    """
    if sensor != "accel" and frame != "accelerometer":
        raise InputError(f"--frame: expected accelerometer for --sensor {sensor}, found {frame!r}")
    if serial is not None and not serial.strip():
        raise InputError(f"--serial: expected a serial number, found {serial!r}")
    whole = readings if isinstance(readings, ReadingsTable) else read_table(Path(readings))
    positions = positions_of(whole, rows_per_position)
    table = positions.table
    nominal = nominal_of(
        table,
        sensor=sensor,
        unit=unit,
        scale=scale,
        scale_per=scale_per,
        gravity=gravity,
        gravity_u=gravity_u,
        modulus=modulus,
        modulus_u=modulus_u,
        known=known,
    )
    serial = table.path.stem if serial is None else serial
    if grade is not None:
        grade_named(grade)
    found, noise = _fitted(positions, nominal, _bad_sigmas(positions))
    if isinstance(found, Refusal):
        found = undetermined(nominal.to_si(whole.values), block=TRIAD) or found  # counts the rows as they are written
        misstated = None if len(found.null) else _misstated(nominal, sizes_seen(table.values, nominal.modulus))
        outcome = Outcome(reasons=(misstated or found.reason,), unobservable=_names(nominal, TRIAD.names))
        empty = _calibration(serial, positions, nominal, None, None, frame, outcome, ())
        return ReadingsCalibration(calibration=empty, table=table, nominal=nominal, fit=None, recorded=False)
    found, estimate, said = _estimated(found, noise, positions, nominal, grade, terms)
    outcome = Outcome(reasons=tuple(_reasons(positions, nominal, found)), remarks=_remarks(positions, nominal))
    calibration = _calibration(serial, positions, nominal, found, estimate, frame, outcome, said)
    recorded = positions.stretch is not None
    return ReadingsCalibration(calibration=calibration, table=table, nominal=nominal, fit=found, recorded=recorded)


def _bad_sigmas(positions: TablePositions) -> float:
    """Beyond so many standard deviations a position is bad."""
    return float(-ndtri(0.5 * BAD_CHANCE / len(positions.table.values)))


def _fitted(positions: TablePositions, nominal: Nominal, bad: float) -> tuple[EllipsoidFit | Refusal, Array]:
    """The fit without positions beyond `bad` standard deviations, and the covariance (3, 3) of a reading that it was
    made with. It has the scatter that the residuals show; where they show less than the last digit of the readings
    explains, that. Of blocks of rows it has their own scatter."""
    readings = nominal.to_si(positions.table.values)
    modulus_u = nominal.modulus_u or 0.0
    floor, none = np.diag((positions.resolution_u / nominal.scale) ** 2), np.zeros((3, 3))
    if positions.stretch is not None:
        found = fit_ellipsoid(readings, modulus=nominal.modulus, modulus_u=modulus_u, blocks=positions.stretch)
        return found, none
    if positions.covariance is not None:
        floor += positions.covariance / np.outer(nominal.scale, nominal.scale)
    known = fit_ellipsoid(
        readings,
        modulus=nominal.modulus,
        modulus_u=modulus_u,
        covariance=np.broadcast_to(floor, (len(readings), 3, 3)),
        bad_sigmas=bad,
    )
    if isinstance(known, Refusal):
        return known, floor
    within = positions.covariance is not None
    if within and known.scatter == 0.0 and positions.degrees:
        known = replace(known, noise_degrees=float(positions.degrees))
    if within or (known.degrees > 0 and known.chi_square <= known.degrees):
        return known, floor
    return fit_ellipsoid(readings, modulus=nominal.modulus, modulus_u=modulus_u, bad_sigmas=bad), none


def _estimated(
    found: EllipsoidFit, noise: Array, positions: TablePositions, nominal: Nominal, grade: str | None, terms: Terms
) -> tuple[EllipsoidFit, Estimate, tuple[str, ...]]:
    """The fit, with the positions that what it leaves out makes look bad, the estimate of the method `ellipsoid`, and
    what its u has of what it leaves out, in words."""
    rests = _rests(positions, nominal, noise)
    if nominal.sensor == "gyro":
        said = "u has no part of asymmetry and g-sensitivity of the gyros, which the readings do not tell from biases"
        return found, estimate_of(found, rests), (said,)
    if nominal.sensor == "mag" or terms == "linear" or found.covariance is None:
        return found, estimate_of(found, rests), ()
    chosen, origin = (grade, "") if grade is not None else guessed_grade(found, rests)
    known = {name: size for name, size in usual_sizes(chosen).items() if name in AT_REST}
    what = "quadratic and cubic terms, asymmetry and drift"
    if positions.stretch is not None:
        known = {name: size for name, size in known.items() if variable_of(name) is None}
        what = "quadratic and cubic terms and asymmetry"
    said = (
        f"{what} of the size usual for the grade {chosen} are in u{origin}; the values take them as nothing, and "
        "--terms linear leaves them out"
    )
    rests = replace(rests, usual=known)
    bad = ~found.used
    bad[list(found.doubtful)] = True
    if bad.any():
        whole, noise = _fitted(positions, nominal, np.inf)
        allowed = _bad_sigmas(positions) * residual_of(rests, chosen)
        if isinstance(whole, EllipsoidFit) and np.all(np.abs(whole.residual) <= np.where(bad, allowed, np.inf)):
            found, rests = whole, replace(_rests(positions, nominal, noise), usual=known)
    return found, estimate_of(found, rests), (said,)


def _rests(positions: TablePositions, nominal: Nominal, noise: Array) -> Observations:
    """The readings as the mean readings of rests, with the modulus in the place of gravity."""
    readings = nominal.to_si(positions.table.values)
    N = len(readings)
    none, start = np.zeros((N, 0)), np.asarray(np.arange(N) * (ON_TABLE.rest + MOVE))
    at_rest = Rests(
        file=np.zeros(N, dtype=np.int64),
        start=start,
        stop=start + ON_TABLE.rest,
        accel=readings,
        accel_covariance=np.broadcast_to(noise, (N, 3, 3)),
        accel_drift=none,
        accel_noise=none,
        gyro=none,
        gyro_covariance=np.zeros((N, 0, 0)),
        gyro_drift=none,
        gyro_noise=none,
        temperatures=None,
    )
    return Observations(
        accel_block=TRIAD,
        gyro_block=None,
        site=Site(latitude=None, height=0.0, gravity=nominal.modulus, gravity_u=nominal.modulus_u or 0.0),
        rests=at_rest,
        turns=None,
        turn_samples=None,
        programme=None,
        position=None,
    )


def _names(nominal: Nominal, names: tuple[str, ...]) -> tuple[str, ...]:
    """Names of parameters for the sensors that they are of."""
    return tuple(f"{nominal.sensor}.{name.partition('.')[2]}" for name in names)


def _remarks(positions: TablePositions, nominal: Nominal) -> tuple[str, ...]:
    """What the readings cannot show of themselves."""
    if positions.stretch is None or nominal.sensor != "accel":
        return ()
    return (
        "an accelerometer that is waved reads its own motion: what of it is always along the same side of the device, "
        "as in turns about a wrist (0.1 m at 60 °/s: 11 mg), passes for a bias and is not in u; a table of readings at "
        "rest has none of it",
    )


def _reasons(positions: TablePositions, nominal: Nominal, found: EllipsoidFit) -> list[str]:
    """What speaks against a fit."""
    table = positions.table
    misstated = _misstated(nominal, np.abs(nominal.scale) * (1.0 + found.values[3:6]))
    if misstated is not None:
        return [misstated]
    size, unit = engineering(nominal.result_unit, float(np.abs(found.residual).max()))
    reasons = [
        f"position {i + 1} (line {table.lines[i]}) does not fit: {found.sigmas[i]:.1f} sigma, residual "
        f"{found.residual[i] / size:+.3g} {unit}; it was left out"
        for i in np.flatnonzero(~found.used)
    ]
    if found.doubtful and found.worst is not None:
        which = " or ".join(f"{i + 1} (line {table.lines[i]})" for i in sorted(found.doubtful))
        reasons.append(
            f"position {which} does not fit: {found.worst.sigmas:.1f} sigma"
            + ("; these positions do not tell which, so that none was left out" if len(found.doubtful) > 1 else "")
        )
    limit = (SCATTER_LIMIT[nominal.sensor] if positions.stretch is None else RECORDED_LIMIT) * nominal.modulus
    if found.scatter > limit:
        size, unit = engineering(nominal.result_unit, found.scatter)
        rows = "positions" if positions.stretch is None else "samples"
        said = f"the {rows} scatter by {found.scatter / size:.3g} {unit}, more than {limit / size:.3g} {unit}"
        first = () if found.worst is None else (found.worst.position, *found.worst.rivals)
        if found.worst is not None and len(first) <= NAMED and found.worst.scatter < 0.5 * found.scatter:
            which = " or ".join(f"{i + 1} (line {table.lines[i]})" for i in sorted(first))
            said += (
                f"; look first at position {which}, without which it would be {found.worst.scatter / size:.3g} {unit}"
            )
        reasons.append(said)
    if not found.converged:
        reasons.append("the fit did not converge: the readings contradict the model")
    return reasons


def _misstated(nominal: Nominal, seen: Array | None) -> str | None:
    """That the channels' output `seen` (3,), per SI unit, is not what scale and unit state, and which would fit."""
    if nominal.estimated or nominal.sensor == "mag" or seen is None:
        return None
    if _near_one(seen / np.abs(nominal.scale)):
        return None
    stated, outputs = (
        ", ".join(f"{v * nominal.per_factor:.3g}" for v in scale)
        for scale in (nominal.scale, np.sign(nominal.scale) * seen)
    )
    fitting = [f"--unit {unit}" for unit, factor in plain_units(nominal.sensor).items() if _near_one(seen * factor)]
    if nominal.unit == nominal.per:
        length = "gravity" if nominal.sensor == "accel" else "--modulus"
        said = f"the readings are {outputs} times what --unit {nominal.unit} and {length} give"
    else:
        said = f"the outputs seen are {outputs} {nominal.unit}/{nominal.per}, the scale states {stated}"
        fitting += [f"--scale={outputs}".replace(" ", "")]
    return f"{said}; {' or '.join(fitting) or 'another unit or scale'} would fit"


def _near_one(ratios: Array) -> bool:
    return bool(np.all(np.abs(ratios - 1.0) <= SIZE_TOLERANCE))


def _calibration(
    serial: str,
    positions: TablePositions,
    nominal: Nominal,
    found: EllipsoidFit | None,
    estimate: Estimate | None,
    frame: Frame,
    outcome: Outcome,
    said: tuple[str, ...],
) -> Calibration:
    parameters: tuple[Parameter, ...] = ()
    known = found is not None and found.covariance is not None
    if estimate is not None:
        learned = learned_in(estimate)
        estimate, _ = estimate_in(frame, estimate, _rests(positions, nominal, np.zeros((3, 3))))
        units = (nominal.result_unit,) * 3 + estimate.units[3:]
        named = replace(estimate, names=_names(nominal, estimate.names), units=units)
        parameters = parameters_of(named, np.arange(len(units)), {}, learned)
        parameters = parameters if known else tuple(replace(p, u=None, dof=None) for p in parameters)
    model = None if estimate is None else estimate.accel
    fits = {} if found is None else {_FIT_NAMES[nominal.sensor]: found.fit(nominal.result_unit)}
    return Calibration(
        serial=serial,
        model=None,
        method="ellipsoid",
        frame="accelerometer" if estimate is None else frame,
        parameters=parameters,
        covariance=estimate.covariance if estimate is not None and known else None,
        accel=model if nominal.sensor == "accel" else None,
        gyro=model if nominal.sensor == "gyro" else None,
        mag=model if nominal.sensor == "mag" else None,
        outcome=outcome,
        fits=fits,
        site=_site(nominal),
        readings={nominal.sensor: _readings(positions, nominal, found)},
        notes=(*positions.left_out, *_notes(positions, nominal, found), *said),
        groups=() if estimate is None else estimate.groups,
        prediction=None if estimate is None else estimate.prediction,
        provenance={
            "log_sha256": positions.table.sha256,
            "software": f"tumble {__version__}",
            "created": datetime.now(UTC).isoformat(timespec="seconds"),
        },
    )


def _site(nominal: Nominal) -> Site | None:
    """Gravity as stated, where it was the modulus, or as the unit."""
    if nominal.sensor != "accel":
        return None
    unit = nominal.modulus_u is None
    return Site(
        latitude=None,
        height=0.0,
        gravity=nominal.modulus,
        gravity_u=nominal.modulus_u or 0.0,
        gravity_is_unit=unit,
    )


def _readings(positions: TablePositions, nominal: Nominal, found: EllipsoidFit | None) -> Readings:
    """What the readings are; where the scatter is that of all there is, a row has no uncertainty beside it."""
    known = found is not None and (positions.covariance is not None or found.scatter == 0.0)
    return Readings(
        columns=positions.table.columns,
        unit=nominal.unit,
        increments=False,
        scale=tuple(nominal.scale.tolist()),
        offset=(0.0, 0.0, 0.0),
        row_u=tuple((positions.row_u / np.abs(nominal.scale)).tolist()) if known else (),
    )


def _notes(positions: TablePositions, nominal: Nominal, found: EllipsoidFit | None) -> tuple[str, ...]:
    table, notes = positions.table, list(_modulus_said(nominal))
    per = ", ".join(f"{s * nominal.per_factor:.6g}" for s in nominal.scale)
    if nominal.estimated:
        notes.append(f"no nominal scale was stated: {per} {nominal.unit}/{nominal.per} was taken from the readings")
    if nominal.assumed:
        notes.append(
            f"polarity of {', '.join(nominal.assumed)}: taken as positive, since the readings do not tell it; state it "
            "with --scale or --position"
        )
    negative = [name for name, s in zip(table.columns, nominal.scale, strict=True) if s < 0.0]
    if negative:
        said = f"polarity of {', '.join(negative)}: negative, as the scale or the positions state"
        if len(negative) % 2:
            said += (
                "; as they are written, the readings are the mirror image of a right-handed triad, so the fit needs a "
                "reflection"
            )
        notes.append(said)
    if found is not None and found.covariance is not None and found.scatter == 0.0 and positions.covariance is None:
        notes.append("the residuals are no larger than the last digit of the readings explains: u is of that digit")
    if found is not None and found.degrees == 0:
        said = "as many positions as parameters: nothing checks the fit"
        notes.append(said + (", and no uncertainty can be given" if found.covariance is None else ""))
    return tuple(notes)


def _modulus_said(nominal: Nominal) -> tuple[str, ...]:
    """What u has of the modulus, where that is not what is usual."""
    if nominal.sensor == "accel":
        if nominal.modulus_u is None:
            return (
                "gravity is not stated: g at the place of the readings is the unit, for which 9.80665 m/s^2 stands; u "
                "has no part of it, which may be 0.3 %. For values in m/s^2 give --gravity and --gravity-u",
            )
        if nominal.modulus_u == 0.0:
            return ("gravity is taken as exact, as --gravity-u states",)
        return (f"gravity {nominal.modulus:.9g} m/s^2 with u = {nominal.modulus_u:.2g} m/s^2, in all scale factors",)
    what = {"gyro": "the rate of the table", "mag": "the field"}[nominal.sensor]
    if nominal.modulus_u is None and nominal.per != THE_FIELD:
        return (
            f"the uncertainty of {what} is not stated (--modulus-u): scale factors are relative to it, and u has no "
            "part of it",
        )
    return ()


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


# -------------------- what is said --------------------
