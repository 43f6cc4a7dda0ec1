"""The main job: from a session to a calibration."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from typing import Any, Literal, overload

import numpy as np
import numpy.typing as npt

from tumble import __version__
from tumble.calibration.calibration_file import Calibration, SensingAxes, read_calibration
from tumble.calibration.case import CaseAlignment, estimate_in
from tumble.calibration.coverage import MANY_DEGREES, with_degrees
from tumble.calibration.field_dip import exchanged_columns
from tumble.calibration.observed import Progress, inspect_session, observations_for_calibration
from tumble.calibration.over_temperature import over_temperature
from tumble.calibration.results import Parameter, Readings, RestResult, SensorsAtRest, TurnResult
from tumble.errors import CalibrationError, InputError
from tumble.estimation.common_errors import by_time_base
from tumble.estimation.diagnosis import verdict
from tumble.estimation.estimate import Estimate, Outcome
from tumble.estimation.methods.ellipsoid import ellipsoid
from tumble.estimation.methods.joint.method import joint
from tumble.estimation.methods.magnetometer import NAMES as MAGNETOMETER_NAMES
from tumble.estimation.methods.magnetometer import magnetometer
from tumble.estimation.methods.paper.scalar import scalar
from tumble.estimation.methods.paper.sequential import sequential
from tumble.estimation.methods.staged.method import staged
from tumble.estimation.misfit import lost_by_velocities
from tumble.files import FilePath
from tumble.recording.arrays import Temperatures, session_of_arrays
from tumble.recording.gaps import Gap
from tumble.recording.log import Log
from tumble.recording.session import Channels, Session, session_from
from tumble.reduction import exclusion
from tumble.reduction.observations import Observations, Rests
from tumble.rotation import rotation_vector
from tumble.sensors.frames import Convention, Frame, convert
from tumble.sensors.grades import guessed_grade
from tumble.sensors.model import Block
from tumble.sensors.parameters import group_name, sensor_kind, usual_sizes
from tumble.units import DEGREE, ZERO_CELSIUS, Array

DEFAULT_METHOD = "joint"
Terms = Literal["full", "linear"]
"""Which parameters: all groups of the table, or bias, scale factor and axis angles alone."""
"""Degrees of freedom from which Student's t is the normal distribution."""
METHODS: Mapping[str, Callable[[Observations], Estimate]] = {"joint": joint, "staged": staged, "ellipsoid": ellipsoid}
ITERATED_METHODS: Mapping[str, Callable[[Observations, int], Estimate]] = {"sequential": sequential, "scalar": scalar}
"""The pipelines of the paper, which take a number of iterations."""


@overload
def calibrate(
    session: Session | FilePath,
    *,
    method: str = ...,
    iterations: int | None = ...,
    frame: Frame = ...,
    terms: Terms = ...,
    without: Iterable[int] = ...,
    progress: Progress = ...,
) -> Calibration: ...


@overload
def calibrate(
    *,
    accel: npt.ArrayLike,
    gyro: npt.ArrayLike | None = ...,
    time: npt.ArrayLike | None = ...,
    rate: float | None = ...,
    temperature: Temperatures | None = ...,
    latitude: float | None = ...,
    height: float = ...,
    gravity: float | None = ...,
    gravity_u: float | None = ...,
    accel_axes: npt.ArrayLike | None = ...,
    gyro_axes: npt.ArrayLike | None = ...,
    programme: str | Sequence[str] | None = ...,
    serial: str = ...,
    method: str = ...,
    iterations: int | None = ...,
    frame: Frame = ...,
    terms: Terms = ...,
    without: Iterable[int] = ...,
) -> Calibration: ...


def calibrate(
    session: Session | FilePath | None = None,
    *,
    method: str = DEFAULT_METHOD,
    iterations: int | None = None,
    frame: Frame = "accelerometer",
    terms: Terms = "full",
    without: Iterable[int] = (),
    progress: Progress = Log.chunks,
    **readings: Any,
) -> Calibration:
    """Calibrate the device of a session: a `Session`, the path of its folder, or readings in SI as
    `session_of_arrays` takes them. `iterations` is for the methods that iterate as the paper does (default 2), `terms`
    for the method joint: `linear` leaves out what is not bias, scale factor or axis angle. The rests
    `without`, by their numbers from 1 in the result with all, are left out beside those of [[exclude]]. The result is
    given in `frame` (see `frames`). A recording that cannot be calibrated comes back with the reasons in its outcome;
    unusable input raises an `InputError`.

    >>> import tumble
    >>> folder = tumble.simulate_session("session", tumble.Setup.of(grade="mems", positions=12), seed=1)
    >>> tumble.calibrate(folder)
    <Calibration of mems-1: joint, 60 parameters, accepted>
    """
    session = _given(session, readings).without(without)
    estimator = _estimator(method, iterations)
    Convention(frame=frame, block=session.accel_block)
    systematic = systematic_of(session)
    observed = inspect_session(session, progress=progress)
    observations = observations_for_calibration(observed)
    found: tuple[Estimate, Observations] | Outcome
    if isinstance(observations, Outcome):
        found = observations
    else:
        found = estimated(session, observations, estimator, systematic, terms if method == "joint" else "linear")
    provenance, bridged = provenance_of(observed.sha256), bridged_in(observed.gaps)
    if isinstance(found, Outcome):
        made = without_result(session, method, found, provenance, bridged)
    else:
        made = result_of(session, *found, systematic, frame, provenance, bridged)
        made = replace(_with_magnetometer(made, session, found[1]), sample_rate=observed.rate)
    return replace(made, circumstances=observed.circumstances)


def _given(session: Session | FilePath | None, readings: Mapping[str, Any]) -> Session:
    """The session that is given, by itself or as readings."""
    if session is None and "accel" in readings:
        return session_of_arrays(**readings)
    if session is None or readings:
        found = ", ".join(readings) or "nothing"
        beside = "" if session is None else " beside a session"
        raise InputError(f"calibrate: expected a session or readings accel=…, found {found}{beside}")
    return session_from(session)


def _estimator(method: str, iterations: int | None) -> Callable[[Observations], Estimate]:
    """The function of a method's name."""
    if method in ITERATED_METHODS:
        iterated = ITERATED_METHODS[method]
        return lambda observations: iterated(observations, 2 if iterations is None else iterations)
    if method not in METHODS:
        known = ", ".join([*METHODS, *ITERATED_METHODS])
        raise InputError(f"method: expected one of {known}, found {method!r}")
    if iterations is not None:
        raise InputError(
            f"iterations: expected none with the method {method!r}, which iterates until nothing changes, found "
            f"{iterations}; only {' and '.join(ITERATED_METHODS)} take a number"
        )
    return METHODS[method]


def systematic_of(session: Session) -> Mapping[str, float]:
    """Values of the systematic (passport) calibration a session names, by parameter name."""
    if session.device.systematic is None:
        return {}
    passport = read_calibration(session.device.systematic)
    if passport.frame != "accelerometer":
        raise CalibrationError(
            f"{session.device.systematic}: expected a calibration in the frame 'accelerometer', found "
            f"{passport.frame!r}; "
            "calibrate without --frame to get one"
        )
    return {p.name: p.value for p in passport.parameters}


def _usual(session: Session, observations: Observations, terms: Terms) -> tuple[dict[str, float], tuple[str, ...]]:
    """The usual sizes of the groups beyond the linear model in instruments of this grade, and where the grade is from,
    as a note; none for the linear model."""
    if terms == "linear":
        return {}, ()
    grade, guessed = grade_of(session, observations)
    said = f"usual sizes of what is not bias, scale or axis angle: those of the grade {grade}"
    origin = ", guessed from the noise; [device] grade says another" if guessed else ""
    return usual_sizes(grade, session.device.prior), (said + origin,)


def grade_of(session: Session, observations: Observations) -> tuple[str, bool]:
    """The grade of a session's device, and whether it had to be guessed from the noise."""
    if session.device.grade is not None:
        return session.device.grade, False
    rests = observations.rests
    gyro = float(np.median(rests.gyro_noise)) if rests.gyro_noise.size else None
    return guessed_grade(float(np.median(rests.accel_noise)), gyro), True


def estimated(
    session: Session,
    observations: Observations,
    method: Callable[[Observations], Estimate],
    start: Mapping[str, float],
    terms: Terms,
) -> tuple[Estimate, Observations] | Outcome:
    """The estimate and what it was made from, or why there is none."""
    usual, said = _usual(session, observations, terms)
    notes, clock_u = observations.notes + said, session.log.gyro_clock_u
    unstamped = session.log.unstamped
    observations = replace(observations, start=start, usual=usual, notes=notes, clock_u=clock_u, unstamped=unstamped)
    try:
        estimate = _with_time_base(method(observations), observations)
        if terms == "linear" and estimate.linearised is not None and unstamped:
            known = replace(observations, usual=_usual(session, observations, "full")[0])
            reasons, remarks = lost_by_velocities(estimate.linearised, known)
            estimate = replace(estimate, reasons=(*estimate.reasons, *reasons), remarks=remarks)
        return estimate, observations
    except np.linalg.LinAlgError as error:
        broken = f"the estimate broke down ({error}): the data contradict the model; look at them with `tumble inspect`"
        return Outcome(reasons=(broken,))


def _with_time_base(estimate: Estimate, observations: Observations) -> Estimate:
    """An estimate with the uncertainty of the time base, which the method joint counts itself."""
    change = by_time_base(estimate.names, observations.clock_u)
    if estimate.method == "joint" or not change.any():
        return estimate
    return replace(estimate, covariance=estimate.covariance + np.outer(change, change))


def provenance_of(log_sha256: str) -> dict[str, str]:
    """Where a calibration is from: its log, the program and the time."""
    return {
        "log_sha256": log_sha256,
        "software": f"tumble {__version__}",
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
    }


_GAPS_SHOWN = 5
ONE_RATE = 1.2
"""The largest mean rate of the turns, in parts of the smallest, where they count as one rate."""


def bridged_in(found: Sequence[Gap]) -> tuple[str, ...]:
    """What was bridged or left out in the log, as notes: the first of each kind, and how many more."""
    kinds = {
        "bridged": [g for g in found if g.samples and g.integrable],
        "left out": [g for g in found if not g.samples],
        "gap": [g for g in found if not g.integrable],
    }
    notes = []
    for kind, gaps in kinds.items():
        for g in gaps[:_GAPS_SHOWN]:
            lost = f" ({g.samples} samples)" if g.samples > 1 else ""
            notes.append(
                f"{kind}: file {g.file + 1}, row {g.row}, {g.time:.3f} s: {g.what.removesuffix(': left out')}{lost}"
            )
        if len(gaps) > _GAPS_SHOWN:
            lost = f", {sum(g.samples for g in gaps)} samples in all" if gaps[0].samples else ""
            notes.append(f"{kind}: {len(gaps) - _GAPS_SHOWN} more such places{lost}")
    return tuple(notes)


def _torn(observations: Observations) -> tuple[str, ...]:
    """The turns that were not recorded as a whole, as notes."""
    if observations.turns is None:
        return ()
    file, known = observations.rests.file, set(observations.turns.first.tolist())
    if observations.together is not None:
        return ()
    missing = [i for i in range(len(file) - 1) if file[i] == file[i + 1] and i not in known]
    left_out = [f"turn from rest {i + 1} to rest {i + 2} is left out" for i in missing]
    return tuple(
        f"{said}: samples are lost in it"
        for said in left_out
        if not any(note.startswith(said) for note in observations.notes)
    )


def _unchecked(estimate: Estimate) -> tuple[str, ...]:
    """What no redundancy checks, as notes."""
    fit = estimate.fits["accelerometers"]
    if fit.degrees >= 0.5 or estimate.unobservable:
        return ()
    return ("as many rests as accelerometer parameters: nothing checks the fit, a bad rest would go unnoticed",)


def _one_rate(estimate: Estimate, observations: Observations) -> tuple[str, ...]:
    """Where all turns have about one rate, what the scale factors of the gyros are, as a note."""
    turns = observations.turns
    if estimate.method != "joint" or turns is None or any(group_name(name) == "gyro.cubic" for name in estimate.names):
        return ()
    made = turns.duration > 0.0  # between the parts of a rest nothing is turned
    rates = np.linalg.norm(rotation_vector(turns.C[made]), axis=1) / turns.duration[made]
    if not len(rates) or not rates.max() < ONE_RATE * rates.min():
        return ()
    return (
        f"all turns have about {rates.mean() / DEGREE:.2g} °/s: scale factors of the gyros are those at this rate; "
        "what they are at others, turns at two rates show, or gyro_cubic in [device.prior] puts into u",
    )


def without_result(
    session: Session, method: str, outcome: Outcome, provenance: Mapping[str, str], bridged: tuple[str, ...] = ()
) -> Calibration:
    """A calibration that says why there is none; `bridged` are notes of the gaps of its log."""
    return Calibration(
        serial=session.device.serial,
        model=session.device.model,
        method=method,
        frame="accelerometer",
        parameters=(),
        covariance=None,
        accel=None,
        gyro=None,
        outcome=outcome,
        site=session.site,
        readings=readings_of_session(session),
        notes=bridged,
        provenance=provenance,
    )


def readings_of_session(session: Session) -> dict[str, Readings]:
    """What the readings of a session are."""
    given = {"accel": session.log.accel, "gyro": session.log.gyro}
    readings = {kind: _readings_in(channels) for kind, channels in given.items() if channels is not None}
    mag, ones, zeros = session.log.magnetometer, (1.0, 1.0, 1.0), (0.0, 0.0, 0.0)
    if mag is not None:
        readings["mag"] = Readings(columns=mag.columns, unit=mag.unit, increments=False, scale=ones, offset=zeros)
    return readings


def _readings_in(channels: Channels) -> Readings:
    return Readings(
        columns=channels.columns,
        unit=channels.unit_name,
        increments=channels.unit.kind == "increment",
        scale=tuple((channels.scale / channels.unit.factor).tolist()),
        offset=tuple(channels.offset.tolist()),
    )


def _rest_results(estimate: Estimate, observations: Observations) -> tuple[RestResult, ...]:
    rests = observations.rests
    return tuple(
        RestResult(
            file=int(rests.file[i]),
            start=float(rests.start[i]),
            stop=float(rests.stop[i]),
            residual=float(estimate.rest_residual[i]),
            sigmas=float(estimate.rest_sigmas[i]),
            attitude=_attitude(observations, i),
            accel=_sensors_at_rest(
                rests.accel[i], rests.accel_noise[i], rests.accel_drift[i], _celsius(rests, i, observations.accel_block)
            ),
            gyro=_sensors_at_rest(
                rests.gyro[i], rests.gyro_noise[i], rests.gyro_drift[i], _celsius(rests, i, observations.gyro_block)
            ),
            temperature=None if rests.temperature is None else float(rests.temperature[i]) - ZERO_CELSIUS,
        )
        for i in range(len(rests))
    )


def _attitude(observations: Observations, rest: int) -> str | None:
    if observations.programme is None or observations.position is None:
        return None
    return observations.programme.positions[int(observations.position[rest])].attitude


def _sensors_at_rest(mean: Array, noise: Array, drift: Array, celsius: Array) -> SensorsAtRest | None:
    if len(mean) == 0:
        return None
    each = (tuple(values.tolist()) for values in (mean, noise, drift, celsius))
    return SensorsAtRest(**dict(zip(("mean", "noise", "drift", "temperature"), each, strict=True)))


def _celsius(rests: Rests, i: int, block: Block | None) -> Array:
    """Temperatures (n,), °C, of the sensors of a block at a rest; none where there is no thermometer."""
    if rests.temperatures is None or block is None:
        return np.empty(0)
    return np.asarray(rests.temperatures[i, block.thermometer] - ZERO_CELSIUS)


def _turn_results(estimate: Estimate, observations: Observations) -> tuple[TurnResult, ...]:
    if observations.turns is None or not len(estimate.turn_sigmas):
        return ()
    turns = observations.turns if estimate.gyro is None else observations.turns_about(estimate.gyro)
    angles = np.arccos(np.clip(0.5 * (np.trace(turns.C, axis1=1, axis2=2) - 1.0), -1.0, 1.0))
    return tuple(
        TurnResult(
            first=int(turns.first[k]),
            last=int(turns.last[k]),
            duration=float(turns.duration[k]),
            angle=None if estimate.gyro is None else float(angles[k]),
            programmed=_programmed_angle(observations, int(turns.first[k]), int(turns.last[k])),
            sigmas=float(estimate.turn_sigmas[k]),
        )
        for k in range(len(turns))
        if turns.duration[k] > 0.0  # not between the parts of a rest
    )


def _programmed_angle(observations: Observations, first: int, last: int) -> float | None:
    """Angle (rad, not negative) of the programme's turn from one rest to the next."""
    if observations.programme is None or observations.position is None or not observations.programme.ordered:
        return None
    before, after = int(observations.position[first]), int(observations.position[last])
    angle = observations.programme.moves[before].angle if after == before + 1 else None
    return None if angle is None else abs(angle)


def result_of(
    session: Session,
    estimate: Estimate,
    observations: Observations,
    systematic: Mapping[str, float],
    frame: Frame,
    provenance: Mapping[str, str],
    bridged: tuple[str, ...] = (),
) -> Calibration:
    """The calibration of an estimate; `bridged` are notes of the gaps of its log."""
    outcome = verdict(estimate, observations, gravity_confirmed=observations.site.gravity_confirmed)
    rests, turns = _rest_results(estimate, observations), _turn_results(estimate, observations)
    complete = bool(estimate.observable[: len(observations.accel_block.names)].all())
    learned, notes_over_temperature = _learned(estimate), tuple(over_temperature(estimate, observations))
    estimate, case = estimate_in(frame, estimate, observations)
    systematic = _systematic_in(frame, systematic, observations, estimate.gyro is not None, case)
    seen = np.flatnonzero(estimate.observable)
    parameters = tuple(
        Parameter(
            name=estimate.names[i],
            value=float(estimate.values[i]),
            u=float(estimate.u[i]),
            unit=estimate.units[i],
            deviation=float(estimate.values[i]) - systematic[estimate.names[i]]
            if estimate.names[i] in systematic
            else None,
            dof=_dof(estimate, int(i)),
            **learned.get(estimate.names[i], {}),
        )
        for i in seen
    )
    missing = {sensor_kind(name) for name in outcome.unobservable}
    return Calibration(
        serial=session.device.serial,
        model=session.device.model,
        method=estimate.method,
        frame=frame if complete else "accelerometer",
        parameters=with_degrees(parameters, estimate.fits),
        covariance=estimate.covariance[np.ix_(seen, seen)],
        accel=None if "accel" in missing else estimate.accel,
        gyro=None if missing else estimate.gyro,
        outcome=outcome,
        iterations=tuple({estimate.names[i]: float(step[i]) for i in seen} for step in estimate.increments),
        rests=rests,
        turns=turns,
        fits=estimate.fits,
        site=observations.site,
        programme=None if observations.programme is None else observations.programme.name,
        readings=readings_of_session(session),
        notes=bridged
        + _torn(observations)
        + exclusion.said(session.excluded)
        + observations.notes
        + _unchecked(estimate)
        + _one_rate(estimate, observations)
        + notes_over_temperature
        + _aligned(case),
        provenance=provenance,
        groups=estimate.groups,
        prediction=estimate.prediction,
        axes=_axes(observations),
        reference_temperature=reference_of(observations),
        thermometers=_thermometers(session, observations),
        references=references_of(observations),
        imu=session.device.imu,
        clock_u=observations.clock_u,
    )


def _axes(observations: Observations) -> dict[str, SensingAxes]:
    """Nominal sensing directions by kind of sensor."""
    blocks = (observations.accel_block, observations.gyro_block)
    return {block.kind: tuple(map(tuple, block.axes.tolist())) for block in blocks if block is not None}


def _thermometers(session: Session, observations: Observations) -> dict[str, tuple[str, ...]]:
    """The column of the thermometer of each sensor by kind."""
    known, blocks = session.log.temperature, (observations.accel_block, observations.gyro_block)
    if known is None or observations.rests.temperatures is None:
        return {}
    return {block.kind: known.names(block.kind) for block in blocks if block is not None}


def reference_of(observations: Observations) -> float | None:
    """The temperature, °C, at which parameters have their values: the mean of the thermometers over the rests."""
    temperature = observations.rests.temperature
    return None if temperature is None else float(temperature.mean()) - ZERO_CELSIUS


def references_of(observations: Observations) -> dict[str, tuple[float, ...]]:
    """The same of each sensor by kind, °C, by its own thermometer."""
    kelvin, blocks = observations.rests.temperatures, (observations.accel_block, observations.gyro_block)
    if kelvin is None:
        return {}
    celsius = kelvin.mean(axis=0) - ZERO_CELSIUS
    return {block.kind: tuple(celsius[block.thermometer].tolist()) for block in blocks if block is not None}


def _dof(estimate: Estimate, i: int) -> float | None:
    """Degrees of freedom behind the u of a parameter; None where there are more than matter."""
    if estimate.degrees is None or estimate.degrees[i] > MANY_DEGREES:
        return None
    return float(estimate.degrees[i])


def _learned(estimate: Estimate) -> dict[str, dict[str, float]]:
    """Prior, as widened, and learned fraction of the parameters of groups beyond the linear model, by name."""
    instrument = estimate.instrument
    if instrument is None:
        return {}
    return {
        name: {"prior": group.prior * group.widened, "learned": learned}
        for group in estimate.groups
        for name, learned in zip(estimate.names[instrument.members[group.name]], group.learned, strict=True)
    }


def _with_magnetometer(calibration: Calibration, session: Session, observations: Observations) -> Calibration:
    """A calibration with the parameters of the session's magnetometer, where it has one; where that cannot be
    calibrated, without them, and a note says why."""
    spec, covariance = session.log.magnetometer, calibration.covariance
    if spec is None:
        return calibration
    found = magnetometer(observations, spec.unit)
    if found.reasons or found.values is None or found.covariance is None or covariance is None:
        why = "; ".join(found.reasons) or "magnetometer: nothing says how well it is known"
        said = (f"{why}; the rest of the session is calibrated without it",)
        missing = replace(calibration.outcome, unobservable=calibration.outcome.unobservable + MAGNETOMETER_NAMES)
        return replace(calibration, outcome=missing, notes=calibration.notes + said)
    u, units = np.sqrt(np.diag(found.covariance)), (spec.unit,) * 3 + ("1",) * 3 + ("rad",) * 3
    parameters = tuple(
        Parameter(name=name, value=float(value), u=float(each), unit=unit)
        for name, value, each, unit in zip(MAGNETOMETER_NAMES, found.values, u, units, strict=True)
    )
    apart = np.zeros((len(covariance), 9))
    return replace(
        calibration,
        parameters=calibration.parameters + parameters,
        covariance=np.block([[covariance, apart], [apart.T, found.covariance]]),
        mag=found.model,
        fits=dict(calibration.fits) | found.fits,
        notes=calibration.notes + found.notes + exchanged_columns(calibration.accel, found.model, observations, spec),
    )


def _systematic_in(
    frame: Frame, systematic: Mapping[str, float], observations: Observations, gyros: bool, case: CaseAlignment | None
) -> Mapping[str, float]:
    """Values of the systematic calibration in another frame; none where it lacks one of them."""
    if frame == "accelerometer":
        return systematic
    accel, gyro = observations.accel_block, observations.gyro_block if gyros else None
    names = accel.names + (() if gyro is None else gyro.names)
    if not set(names) <= set(systematic) or (frame == "case" and case is None):
        return {}
    framed = convert(
        accel,
        gyro,
        source="accelerometer",
        values=np.array([systematic[name] for name in names]),
        covariance=None,
        target=frame,
        alignment=None if case is None else case.alignment,
    )
    return dict(zip(framed.names, framed.values.tolist(), strict=True))


def _aligned(case: CaseAlignment | None) -> tuple[str, ...]:
    """How the case was found, as a note."""
    if case is None:
        return ()
    u = np.sqrt(np.diag(case.alignment.covariance)) / DEGREE
    text = (
        f"case: from {len(case.rests)} rests on its six faces, which scatter by {case.scatter / DEGREE:.2g}° an axis; "
        f"standard uncertainty of its alignment {u[0]:.2g}°, {u[1]:.2g}°, {u[2]:.2g}° about X, Y, Z"
    )
    if not len(case.tilt):
        return (f"{text}; azimuths are not known, so that the tilt of the plate is part of the scatter",)
    lean = np.linalg.norm(case.tilt) / DEGREE
    return (f"{text}; the plate leans by {lean:.2g}° (u {np.linalg.norm(case.tilt_u) / DEGREE:.1g}°)",)
