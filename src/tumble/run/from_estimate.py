"""Build a `Calibration` from an estimate and its observations, with notes on the recording."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from tumble.advice import Advised
from tumble.diagnosis.undetermined import faces_alone
from tumble.diagnosis.verdict import verdict
from tumble.errors import InputError
from tumble.inference.estimate import Estimate, Outcome
from tumble.inference.variables import RAMP_RANGE, at_two_temperatures, over_a_range, ramps_up_and_down
from tumble.recording.rows.gaps import Gap
from tumble.recording.session import Session
from tumble.reduction.observations import Observations
from tumble.reduction.rests.matching import exclusion_notes
from tumble.reduction.rests.warming import OVER_TEMPERATURE
from tumble.result.calibration import Calibration
from tumble.result.coverage import MANY_DEGREES, with_degrees
from tumble.result.parts import (
    CalibratedDevice,
    CalibratedTemperature,
    Evidence,
    Parameter,
    Provenance,
    Readings,
    RestResult,
    SensorsAtRest,
    TurnResult,
    learned_fraction,
)
from tumble.result.uncertainty_budget import contributions_of
from tumble.sensors.frames import Frame
from tumble.sensors.parameters import THERMAL, group_name, sensor_kind, variable_of
from tumble.units import DEGREE, ZERO_CELSIUS, Array, IntArray

LAGS = {"accel.lag": "accelerometers", "gyro.lag": "gyros"}
SIGNIFICANT_SLOPE = 3.0  # u, of a slope over temperature
GAPS_SHOWN = 5
ONE_RATE = 1.3
"""Ratio of the largest to the smallest rms rate of turns, below which they count as one rate: extrapolated to other
rates, scale factors that change with the square of the rate would be seven times less certain."""


def build_calibration(
    session: Session,
    estimate: Estimate,
    observations: Observations,
    systematic: Mapping[str, float],
    frame: Frame,
    provenance: Provenance,
    bridged: tuple[str, ...] = (),
) -> Calibration:
    """Return the calibration of an estimate; `bridged` are notes on the gaps of its log."""
    outcome = verdict(estimate, observations, gravity_confirmed=observations.site.gravity_confirmed)
    rests, turns = rest_results(estimate, observations), turn_results(estimate, observations)
    blocks = {b.kind: b for b in (observations.accel_block, observations.gyro_block) if b is not None}
    complete = bool(estimate.observable[: len(observations.accel_block.names)].all())
    priors, thermal_notes = prior_fields(estimate), tuple(temperature_notes(estimate, observations))
    case_notes = tuple[str, ...]()
    if frame != "accelerometer":
        systematic = {}  # it is in the frame of the accelerometers
        if complete:
            from tumble.run.case import estimate_in

            estimate, case = estimate_in(frame, estimate, observations)
            if case is not None:
                u = ", ".join(f"{each:.2g}°" for each in np.sqrt(np.diag(case.alignment.covariance)) / DEGREE)
                case_notes = (
                    f"case: from {case.placements} rests on its six faces, which scatter by "
                    f"{case.scatter / DEGREE:.2g}° an axis; standard uncertainty of its alignment {u} about X, Y, Z; "
                    "the tilt of the plate is part of the scatter",
                )
    determined = np.flatnonzero(estimate.observable)
    faces = faces_alone(estimate, outcome.unobservable)
    missing = set() if faces else {sensor_kind(name) for name in outcome.unobservable}
    return Calibration(
        device=device_of(session),
        method=estimate.method,
        frame=frame if complete else "accelerometer",
        parameters=with_degrees(build_parameters(estimate, determined, systematic, priors), estimate.fits),
        covariance=estimate.covariance[np.ix_(determined, determined)],
        accel=None if "accel" in missing else estimate.accel,
        gyro=None if missing else estimate.gyro,
        outcome=outcome,
        groups=estimate.groups,
        prediction=estimate.prediction,
        axes={kind: tuple(map(tuple, block.axes.tolist())) for kind, block in blocks.items()},
        temperature=calibrated_temperature(session, observations),
        evidence=Evidence(
            rests=rests,
            turns=turns,
            fits=estimate.fits,
            hyperparameters=estimate.hyperparameters,
            integral=estimate.integral,
            process_bias=estimate.process_bias if frame == "accelerometer" else (),
            budget=contributions_of(estimate.budget, estimate.names, observations.size_basis),
            iterations=tuple({estimate.names[i]: float(step[i]) for i in determined} for step in estimate.increments),
        ),
        provenance=replace(
            provenance,
            site=observations.site,
            clock_u=session.log.time_base_u,
            programme=None if observations.programme is None else observations.programme.name,
            readings=readings_of_session(session),
            notes=(
                *(*bridged, *exclusion_notes(session.excluded)),
                *observations.notes,
                *_fit_notes(estimate, observations),
                *thermal_notes,
                *case_notes,
            ),
            absent=(f"{', '.join(outcome.unobservable)}: not determined by six faces, taken as 0",) if faces else (),
        ),
    )


def refused_calibration(
    session: Session, method: str, outcome: Outcome, provenance: Provenance, bridged: tuple[str, ...] = ()
) -> Calibration:
    """Return a calibration without parameters, whose outcome has the reasons; `bridged` are notes on gaps of its
    log."""
    return Calibration(
        device=device_of(session),
        method=method,
        frame="accelerometer",
        parameters=(),
        covariance=None,
        accel=None,
        gyro=None,
        outcome=outcome,
        provenance=replace(
            provenance,
            site=session.site,
            programme=None if session.programme is None else session.programme.name,
            readings=readings_of_session(session),
            notes=bridged,
        ),
    )


def device_of(session: Session) -> CalibratedDevice:
    """Return the device of a session."""
    return CalibratedDevice(serial=session.device.serial, model=session.device.model, imu=session.device.imu)


def build_parameters(
    estimate: Estimate, determined: IntArray, systematic: Mapping[str, float], priors: Mapping[str, Mapping[str, float]]
) -> tuple[Parameter, ...]:
    """Return the parameters with these indices; `priors` are from `prior_fields`."""
    u, degrees = estimate.u, np.full(len(estimate.names), np.inf) if estimate.degrees is None else estimate.degrees
    return tuple(
        Parameter(
            name=name,
            value=value,
            u=float(u[i]),
            unit=estimate.units[i],
            deviation=value - systematic[name] if name in systematic else None,
            dof=None if degrees[i] > MANY_DEGREES else float(degrees[i]),
            **priors.get(name, {}),
        )
        for i, name, value in ((i, estimate.names[i], float(estimate.values[i])) for i in determined.tolist())
    )


def prior_fields(estimate: Estimate) -> dict[str, dict[str, float]]:
    """Return the widened prior and the learned fraction of parameters, by name.

    Parameters of groups beyond the linear model have these, and all parameters with a prior of the device type."""
    u = dict(zip(estimate.names, estimate.u.tolist(), strict=True))
    type_priors = {name: {"prior": s, "learned": learned_fraction(u[name], s)} for name, s in estimate.of_type.items()}
    if estimate.instrument is None:
        return type_priors
    return {
        name: {"prior": group.prior * group.prior_widened, "learned": learned}
        for group in estimate.groups
        for name, learned in zip(estimate.names[estimate.instrument.members[group.name]], group.learned, strict=True)
    } | type_priors


def mean_temperature(observations: Observations) -> float | None:
    """Return the reference temperature of the parameters, °C: the mean of the thermometers over the rests."""
    temperature = observations.rests.temperature
    return None if temperature is None else float(temperature.mean()) - ZERO_CELSIUS


def sensor_temperatures(observations: Observations) -> dict[str, tuple[float, ...]]:
    """Return the mean temperatures of the sensors over the rests, °C, by kind."""
    kelvin, blocks = observations.rests.temperatures, (observations.accel_block, observations.gyro_block)
    if kelvin is None:
        return {}
    celsius = kelvin.mean(axis=0) - ZERO_CELSIUS
    return {block.kind: tuple(celsius[block.thermometer].tolist()) for block in blocks if block is not None}


def calibrated_temperature(session: Session, observations: Observations) -> CalibratedTemperature:
    """Return the temperatures of a calibration, with the columns of its thermometers."""
    columns, by_kind = session.log.temperature, sensor_temperatures(observations)
    return CalibratedTemperature(
        reference=mean_temperature(observations),
        thermometers={} if columns is None else {kind: columns.names(kind) for kind in by_kind},
        references=by_kind,
    )


def readings_of_session(session: Session) -> dict[str, Readings]:
    """Return columns, unit, scale and offset of the readings of a session, by kind of sensor."""
    by_kind = {"accel": session.log.accel, "gyro": session.log.gyro, "mag": session.log.magnetometer}
    return {
        kind: Readings(
            columns=channels.columns,
            unit=channels.unit_name,
            increments=channels.unit.kind == "increment",
            scale=tuple((channels.scale / channels.unit.factor).tolist()),
            offset=tuple(channels.offset.tolist()),
        )
        for kind, channels in by_kind.items()
        if channels is not None
    }


def check_sensors(calibration: Calibration, session: Session) -> None:
    """Raise InputError if the sensors of a session, or the scales of its counts or volts, are not those of a
    calibration."""
    for kind, readings in readings_of_session(session).items():
        model, expected = getattr(calibration, kind), calibration.provenance.readings.get(kind)
        if model is not None and len(model.bias) != len(readings.columns):
            raise InputError(
                f"{session.name}: log.{kind}: expected the {len(model.bias)} sensors of the calibration of "
                f"{calibration.serial!r}, found {len(readings.columns)}"
            )
        if expected is None or not {readings.unit, expected.unit} & {"count", "V"}:
            continue
        here, then = ((each.unit, each.scale, each.offset) for each in (readings, expected))
        if here != then:
            raise InputError(
                f"{session.name}: log.{kind}: expected the unit, scale and offset of the calibration of "
                f"{calibration.serial!r}, {', '.join(map(str, then))}, found {', '.join(map(str, here))}; state them "
                "as they were"
            )


# -------------------- rests and turns --------------------


def rest_results(estimate: Estimate, observations: Observations) -> tuple[RestResult, ...]:
    """Return the rests of a calibration.

    Raises InputError if the fit diverged, which can happen if all rests are nearly in one attitude."""
    rests = observations.rests
    if not np.isfinite(estimate.rest_residual).all():
        raise InputError(
            f"expected rests in attitudes far apart, found {len(rests)} for which the fit comes to no finite values; "
            "put the device down in others too (`tumble programme` lists them)"
        )
    celsius = None if rests.temperatures is None else rests.temperatures - ZERO_CELSIUS
    sensors: dict[str, list[SensorsAtRest | None]] = {kind: [None] * len(rests) for kind in ("accel", "gyro")}
    for block, mean, noise, drift in (
        (observations.accel_block, rests.accel, rests.accel_noise, rests.accel_drift),
        (observations.gyro_block, rests.gyro, rests.gyro_noise, rests.gyro_drift),
    ):
        if block is not None and mean.shape[1]:
            warm = np.empty((len(rests), 0)) if celsius is None else celsius[:, block.thermometer]
            at_rest = zip(*(map(tuple, values.tolist()) for values in (mean, noise, drift, warm)), strict=True)
            sensors[block.kind] = [SensorsAtRest(mean=m, noise=n, drift=d, temperature=t) for m, n, d, t in at_rest]
    positions = None if observations.programme is None else observations.programme.positions
    position = observations.position
    return tuple(
        RestResult(
            file=int(rests.file[i]),
            start=float(rests.start[i]),
            stop=float(rests.stop[i]),
            residual=float(estimate.rest_residual[i]),
            sigmas=float(estimate.rest_sigmas[i]),
            attitude=None if positions is None or position is None else positions[int(position[i])].attitude,
            accel=sensors["accel"][i],
            gyro=sensors["gyro"][i],
            temperature=None if rests.temperature is None else float(rests.temperature[i]) - ZERO_CELSIUS,
        )
        for i in range(len(rests))
    )


def turn_results(estimate: Estimate, observations: Observations) -> tuple[TurnResult, ...]:
    """Return the turns of a calibration, with their angles by its gyros and by the programme."""
    turns, programme, position = observations.turns, observations.programme, observations.position
    if turns is None or not len(estimate.turn_sigmas):
        return ()
    rotations, linearised = turns.C, estimate.linearised  # nominal ones without gyros, else of the likelihood
    if estimate.gyro is not None and linearised is not None and linearised.about is not None:
        rotations = linearised.rotations
    elif estimate.gyro is not None:
        rotations = observations.turns_about(estimate.gyro).C
    angles = np.arccos(np.clip(0.5 * (np.trace(rotations, axis1=1, axis2=2) - 1.0), -1.0, 1.0))
    programmed: list[float | None] = [None] * len(turns)
    if programme is not None and position is not None and programme.ordered:
        for k, (before, after) in enumerate(zip(position[turns.first], position[turns.last], strict=True)):
            angle = programme.moves[int(before)].angle if after == before + 1 else None
            programmed[k] = None if angle is None else abs(angle)
    return tuple(
        TurnResult(
            first=int(turns.first[k]),
            last=int(turns.last[k]),
            duration=float(turns.duration[k]),
            angle=None if estimate.gyro is None else float(angles[k]),
            programmed=programmed[k],
            sigmas=float(estimate.turn_sigmas[k]),
        )
        for k in range(len(turns))
        if turns.duration[k] > 0.0  # not between the parts of a rest
    )


# -------------------- notes --------------------


def gap_notes(gaps: Sequence[Gap]) -> tuple[str, ...]:
    """Return notes on gaps that were bridged or left out: the first of each kind, and the number of others."""
    kinds = {
        "bridged": [gap for gap in gaps if gap.samples and gap.integrable],
        "left out": [gap for gap in gaps if not gap.samples],
        "gap": [gap for gap in gaps if not gap.integrable],
    }
    notes = []
    for kind, places in kinds.items():
        for gap in places[:GAPS_SHOWN]:
            lost = f" ({gap.samples} samples)" if gap.samples > 1 else ""
            what = gap.what.removesuffix(": left out")
            notes.append(f"{kind}: file {gap.file + 1}, row {gap.row}, {gap.time:.3f} s: {what}{lost}")
        if len(places) > GAPS_SHOWN:
            lost = f", {sum(gap.samples for gap in places)} samples in all" if places[0].samples else ""
            notes.append(f"{kind}: {len(places) - GAPS_SHOWN} more such places{lost}")
    return tuple(notes)


def _fit_notes(estimate: Estimate, observations: Observations) -> Iterator[str]:
    """Return notes on a fit without redundancy, and on turns of one rate."""
    at_rest = observations.links is None
    if at_rest and estimate.fits["accelerometers"].degrees < 0.5 and not estimate.unobservable:
        yield "as many rests as accelerometer parameters: nothing checks the fit, a bad rest would go unnoticed"
    turns, about = observations.turns, None if estimate.linearised is None else estimate.linearised.about
    cubic = any(group_name(name) == "gyro.cubic" for name in estimate.names)
    if estimate.method != "joint" or turns is None or about is None or cubic:
        return
    is_turn = turns.duration > 0.0  # and not the step between two parts of a rest
    rates = np.sqrt(about.moments.body_rates[is_turn][:, [0, 3, 5]].sum(axis=1) / turns.duration[is_turn])
    if len(rates) and rates.max() < ONE_RATE * rates.min():
        yield Advised(
            f"all turns have about {rates.mean() / DEGREE:.2g} °/s: the scale factors of the gyros hold at this rate",
            "for others turn at a second rate too, or state gyro_cubic in [device.prior]",
        )


def temperature_notes(estimate: Estimate, observations: Observations) -> Iterator[str]:
    """Return notes on what the temperatures of one or several sessions determine."""
    kelvin, turns = observations.rests.temperature, observations.turns
    if observations.links is not None:
        records = [] if observations.thermometers is None else observations.thermometers.files.values()
        change = max((float(np.ptp(record, axis=0).max()) for _, record in records), default=0.0)
        if change > RAMP_RANGE:
            yield Advised(
                f"temperature changed by {change:.1f} K in motion: biases are followed in time, but how scale factors "
                "and axes change with it is not in u",
                "let the device warm up before, or put it down in nine or more positions",
            )
        return
    yield from _lag_notes(estimate, observations)
    if kelvin is None or (observations.together is None and not over_a_range(observations)):
        return

    def span(temperatures: Array) -> str:
        return f"{temperatures.min() - ZERO_CELSIUS:z.1f} to {temperatures.max() - ZERO_CELSIUS:z.1f} °C"

    yield f"temperatures of the rests: {span(kelvin)}; beyond them nothing was measured"
    if not over_a_range(observations):
        yield Advised(
            f"temperatures span {np.ptp(kelvin):.1f} K, less than {OVER_TEMPERATURE:.0f}: coefficients over "
            "temperature have mostly their usual sizes",
            "take sessions at temperatures further apart",
        )
        return
    thermal = [group for group in estimate.groups if variable_of(group.name) in THERMAL]
    unseen = [group.name for group in thermal if not group.kept]
    if at_two_temperatures(observations):
        yield Advised(
            "coefficients t2 have their usual sizes, which are in u of biases and scale factors at the reference "
            "temperature: two temperatures show slopes and no curvature",
            "take a third between them",
        )
    elif unseen:
        yield Advised(f"not determined: {', '.join(unseen)}", "turn at more temperatures, each axis up and down")
    if turns is not None and (turns.duration > 0.0).any():  # only turns show scale factors of gyros
        is_turn = turns.duration > 0.0
        turned = kelvin[np.concatenate([turns.first[is_turn], turns.last[is_turn]])]
        if np.ptp(turned) < 0.5 * np.ptp(kelvin):
            yield Advised(
                f"turns span {span(turned)} only: beyond that the change of scale factors has its usual size",
                "turn at the other temperatures too",
            )
    lags = [float(estimate.u[estimate.names.index(name)]) for name in LAGS if name in estimate.names]
    if lags and not ramps_up_and_down(observations):
        yield Advised(
            f"the temperature only rose or only fell: lags behind the thermometer are known to {max(lags):.0f} s "
            "only, and hysteresis, not determined, is in u with its usual size",
            "ramp up and down in one recording",
        )


def _lag_notes(estimate: Estimate, observations: Observations) -> Iterator[str]:
    """Return notes on sensors that do not change with temperature, and on lags that are most of u."""
    kelvin = observations.rests.temperatures
    if kelvin is None or estimate.budget is None:
        return
    lag_sources = [i for i, source in enumerate(estimate.budget.sources) if source.name == "lag"]
    by_lag = np.diagonal(estimate.budget.covariances[lag_sources], axis1=1, axis2=2).sum(axis=0)
    for name, sensors in LAGS.items():
        if name not in estimate.names:
            continue
        kind = sensor_kind(name)
        slopes = [i for i, n in enumerate(estimate.names) if group_name(n) in (f"{kind}.bias.t1", f"{kind}.scale.t1")]
        bias = [i for i, n in enumerate(estimate.names) if group_name(n) == f"{kind}.bias"]
        if np.any(by_lag[bias] > 0.5 * estimate.u[bias] ** 2):
            u = float(estimate.u[estimate.names.index(name)])
            yield Advised(
                f"the lag of the {sensors} behind their thermometer is known to {u:.0f} s only, which is most of u of "
                f"{kind}.bias",
                f"let the device warm up before, ramp up and down in one recording, or state {kind}_lag in "
                "[device.prior]",
            )
        elif np.all(np.abs(estimate.values[slopes]) < SIGNIFICANT_SLOPE * estimate.u[slopes]):
            yield f"no change of the {sensors} with temperature is significant over {np.ptp(kelvin):.1f} K"
