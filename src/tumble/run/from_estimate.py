"""From an estimate to a calibration: its parameters, rests, turns, and all that belongs to them."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from tumble.diagnosis.site_gravity import gravity_doubted
from tumble.diagnosis.undetermined import faces_alone
from tumble.diagnosis.verdict import verdict
from tumble.errors import InputError
from tumble.inference.estimate import Estimate, Outcome
from tumble.recording.session import Channels, Session
from tumble.reduction.observations import Observations
from tumble.reduction.rests.matching import left_out
from tumble.reduction.rests.rests import Rests
from tumble.result.calibration import Calibration, SensingAxes
from tumble.result.coverage import MANY_DEGREES, with_degrees
from tumble.result.parts import Parameter, Readings, RestResult, SensorsAtRest, TurnResult
from tumble.result.uncertainty_budget import contributions_of
from tumble.run.case import CaseAlignment, estimate_in
from tumble.run.notes import case_found, one_rate, over_temperature, unchecked
from tumble.sensors.frames import Frame, convert
from tumble.sensors.model import Block
from tumble.sensors.parameters import sensor_kind
from tumble.units import ZERO_CELSIUS, Array, IntArray


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
    rests, turns = rest_results(estimate, observations), turn_results(estimate, observations)
    complete = bool(estimate.observable[: len(observations.accel_block.names)].all())
    learned, limited = learned_in(estimate), tuple(over_temperature(estimate, observations))
    estimate, case = estimate_in(frame, estimate, observations)
    systematic = _systematic_in(frame, systematic, observations, estimate.gyro is not None, case)
    seen = np.flatnonzero(estimate.observable)
    faces = faces_alone(estimate, outcome.unobservable)
    missing = set() if faces else {sensor_kind(name) for name in outcome.unobservable}
    return Calibration(
        serial=session.device.serial,
        model=session.device.model,
        method=estimate.method,
        frame=frame if complete else "accelerometer",
        parameters=with_degrees(parameters_of(estimate, seen, systematic, learned), estimate.fits),
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
        + left_out(session.excluded)
        + observations.notes
        + gravity_doubted(observations.site)
        + unchecked(estimate)
        + one_rate(estimate, observations)
        + limited
        + case_found(case),
        provenance=provenance,
        groups=estimate.groups,
        hyperparameters=estimate.hyperparameters,
        integral=estimate.integral,
        process_bias=estimate.process_bias if frame == "accelerometer" else (),
        budget=contributions_of(estimate.budget, estimate.names),
        prediction=estimate.prediction,
        axes=_axes(observations),
        reference_temperature=reference_of(observations),
        thermometers=_thermometers(session, observations),
        references=references_of(observations),
        imu=session.device.imu,
        clock_u=session.log.time_base_u,
        absent=(f"{', '.join(outcome.unobservable)}: not determined by six faces, taken as 0",) if faces else (),
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


def parameters_of(
    estimate: Estimate, seen: IntArray, systematic: Mapping[str, float], learned: Mapping[str, Mapping[str, float]]
) -> tuple[Parameter, ...]:
    """The parameters that the data determine, those `seen`, in the order of the estimate."""
    return tuple(
        Parameter(
            name=name,
            value=value,
            u=float(estimate.u[i]),
            unit=estimate.units[i],
            deviation=value - systematic[name] if name in systematic else None,
            dof=_dof(estimate, i),
            **learned.get(name, {}),
        )
        for i, name, value in ((i, estimate.names[i], float(estimate.values[i])) for i in seen.tolist())
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


def learned_in(estimate: Estimate) -> dict[str, dict[str, float]]:
    """Prior, as widened, and learned fraction of the parameters of groups beyond the linear model, by name."""
    instrument = estimate.instrument
    if instrument is None:
        return {}
    return {
        name: {"prior": group.prior * group.widened, "learned": learned}
        for group in estimate.groups
        for name, learned in zip(estimate.names[instrument.members[group.name]], group.learned, strict=True)
    }


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


def readings_of_session(session: Session) -> dict[str, Readings]:
    """What the readings of a session are."""
    given = {"accel": session.log.accel, "gyro": session.log.gyro, "mag": session.log.magnetometer}
    return {kind: _readings_in(channels) for kind, channels in given.items() if channels is not None}


def _readings_in(channels: Channels) -> Readings:
    return Readings(
        columns=channels.columns,
        unit=channels.unit_name,
        increments=channels.unit.kind == "increment",
        scale=tuple((channels.scale / channels.unit.factor).tolist()),
        offset=tuple(channels.offset.tolist()),
    )


def rest_results(estimate: Estimate, observations: Observations) -> tuple[RestResult, ...]:
    """The rests of a calibration, in their order. Raises InputError where the fit ran away, as it may where the rests
    are in nearly one attitude."""
    rests = observations.rests
    if not np.isfinite(estimate.rest_residual).all():
        raise InputError(
            f"expected rests in attitudes far apart, found {len(rests)} for which the fit comes to no finite values; "
            "put the device down in others too (`tumble programme` lists them)"
        )
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


def turn_results(estimate: Estimate, observations: Observations) -> tuple[TurnResult, ...]:
    """The turns of a calibration, in their order; none of an estimate that has none."""
    if observations.turns is None or not len(estimate.turn_sigmas):
        return ()
    turns, rotations = observations.turns, _rotations(estimate, observations)
    angles = np.arccos(np.clip(0.5 * (np.trace(rotations, axis1=1, axis2=2) - 1.0), -1.0, 1.0))
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


def _rotations(estimate: Estimate, observations: Observations) -> Array:
    """Rotations (K, 3, 3) of the turns by the gyros of an estimate, nominal ones where it has none: as its likelihood
    has them, where it has one."""
    assert observations.turns is not None
    if estimate.gyro is None:
        return observations.turns.C
    linearised = estimate.linearised
    if linearised is None or linearised.about is None:
        return observations.turns_about(estimate.gyro).C
    return linearised.rotations


def _programmed_angle(observations: Observations, first: int, last: int) -> float | None:
    """Angle (rad, not negative) of the programme's turn from one rest to the next."""
    if observations.programme is None or observations.position is None or not observations.programme.ordered:
        return None
    before, after = int(observations.position[first]), int(observations.position[last])
    angle = observations.programme.moves[before].angle if after == before + 1 else None
    return None if angle is None else abs(angle)
