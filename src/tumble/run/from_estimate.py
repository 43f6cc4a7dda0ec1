"""Assembly of a `Calibration`, from the parameters of any kind of session or from an estimate and its observations.

Every kind of session ends in `assemble`; those with an estimate of rests, turns or motion get there by
`build_calibration`, which adds the verdict, the evidence and notes on the recording.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from types import MappingProxyType
from typing import Any, TypeVar

import numpy as np

from tumble import __version__
from tumble.advice import Advised
from tumble.diagnosis.findings import Finding, outcome_of
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
from tumble.sensors.model import Block
from tumble.sensors.parameters import THERMAL, group_name, sensor_kind, units_of, variable_of
from tumble.units import DEGREE, ZERO_CELSIUS, Array, IntArray

_Record = TypeVar("_Record")
LAGS = {"accel.lag": "accelerometers", "gyro.lag": "gyros"}
SIGNIFICANT_SLOPE = 3.0  # u, of a slope over temperature
GAPS_SHOWN = 5
ONE_RATE = 1.3
"""Ratio of the largest to the smallest rms rate of turns, below which they count as one rate: extrapolated to other
rates, scale factors that change with the square of the rate would be seven times less certain."""


def origin_of(*digests: str) -> dict[str, Any]:
    """Return the fields of `Provenance` of a calibration made now from logs with these SHA-256."""
    joint = digests[0] if len(digests) == 1 else hashlib.sha256("\n".join(digests).encode()).hexdigest()
    created = datetime.now(UTC).isoformat(timespec="seconds")
    return {"log_sha256": joint, "software": f"tumble {__version__}", "created": created}


def assemble(
    session: Session, method: str, outcome: Outcome, provenance: Mapping[str, Any], **results: Any
) -> Calibration:
    """Return a calibration of the device of a session.

    `provenance` and `results` are fields of `Provenance` and `Calibration`. Without results it has no parameters, and
    the outcome has the reasons."""
    programme, device = session.programme, session.device
    of_session = {
        "site": session.site,
        "programme": None if programme is None else programme.listed.name,
        "readings": readings_of_session(session),
    }
    nothing = {"frame": "accelerometer", "parameters": (), "covariance": None, "accel": None, "gyro": None}
    return Calibration(
        device=CalibratedDevice(serial=device.serial, model=device.model, imu=device.imu),
        method=method,
        outcome=outcome,
        provenance=Provenance(**{**of_session, **provenance}),
        **{**nothing, **results},
    )


def extended(
    calibration: Calibration,
    findings: Iterable[Finding] = (),
    unobservable: tuple[str, ...] = (),
    *,
    notes: Iterable[str] = (),
    **provenance: Any,
) -> Calibration:
    """Return the calibration with further findings, unobservable parameters and notes, and fields of `Provenance`."""
    outcome, further, before = calibration.outcome, outcome_of(findings, unobservable), calibration.provenance
    added = ("reasons", "remarks", "unobservable")
    changed = {name: (*getattr(outcome, name), *getattr(further, name)) for name in added}
    return replace(
        calibration,
        outcome=replace(outcome, **changed, concerns={**outcome.concerns, **further.concerns}),
        provenance=replace(before, notes=(*before.notes, *notes), **provenance),
    )


def build_calibration(
    session: Session, estimate: Estimate, observations: Observations, frame: Frame, provenance: Mapping[str, Any]
) -> Calibration:
    """Return the calibration of an estimate; `provenance` as for `assemble`."""
    outcome = verdict(estimate, observations, gravity_confirmed=observations.site.gravity_confirmed)
    rests, turns = rest_results(estimate, observations), turn_results(estimate, observations)
    complete = bool(estimate.observable[: len(observations.accel_block.names)].all())
    notes = [*observations.notes, *_fit_notes(estimate, observations), *temperature_notes(estimate, observations)]
    # the passport, with the start values, is in the frame of the accelerometers
    systematic = observations.start if frame == "accelerometer" else {}
    if frame != "accelerometer" and complete:
        from tumble.run.case import estimate_in

        estimate, case = estimate_in(frame, estimate, observations)
        notes += [] if case is None else [case.note]
    determined = np.flatnonzero(estimate.observable)
    faces = faces_alone(estimate, outcome.unobservable)
    missing = set() if faces else {sensor_kind(name) for name in outcome.unobservable}
    absent = (f"{', '.join(outcome.unobservable)}: not determined by six faces, taken as 0",) if faces else ()
    before = (*provenance.get("notes", ()), *exclusion_notes(session.excluded))
    return assemble(
        session,
        estimate.method,
        outcome,
        {**provenance, "clock_u": session.log.time_base_u, "notes": (*before, *notes), "absent": absent},
        frame=frame if complete else "accelerometer",
        parameters=with_degrees(build_parameters(estimate, determined, systematic), estimate.fits),
        covariance=estimate.covariance[np.ix_(determined, determined)],
        accel=None if "accel" in missing else estimate.accel,
        gyro=None if missing else estimate.gyro,
        groups=estimate.groups,
        prediction=estimate.prediction,
        axes={block.kind: tuple(map(tuple, block.axes.tolist())) for block in blocks_of(observations)},
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
    )


def blocks_of(observations: Observations) -> list[Block]:
    """Return the accelerometers and, if there are any, the gyros."""
    return [block for block in (observations.accel_block, observations.gyro_block) if block is not None]


def parameters_of(names: Sequence[str], values: Array, u: Array, **others: Sequence[Any]) -> tuple[Parameter, ...]:
    """Return parameters with these values and standard uncertainties, SI, and others of their fields.

    Unless it is given, `learned` follows from u and the standard deviations `prior`."""
    fields = {"name": names, "value": values.tolist(), "u": u.tolist(), **others}
    if "unit" not in others:
        fields["unit"] = units_of(names)
    if "prior" in others and "learned" not in others:
        priors = zip(fields["u"], others["prior"], strict=True)
        fields["learned"] = [None if prior is None else learned_fraction(each, prior) for each, prior in priors]
    return _records(Parameter, **fields)


def _records(kind: type[_Record], **columns: Iterable[Any]) -> tuple[_Record, ...]:
    """Return a record of this type for each row of the columns, which are its fields."""
    return tuple(kind(**dict(zip(columns, row, strict=True))) for row in zip(*columns.values(), strict=True))


def build_parameters(
    estimate: Estimate, determined: IntArray, systematic: Mapping[str, float] = MappingProxyType({})
) -> tuple[Parameter, ...]:
    """Return the parameters with these indices, with deviations from the `systematic` values of the passport.

    Those of groups beyond the linear model have their widened prior and what was learned beyond it, and all have these
    if there is a prior of the device type."""
    names, values, u = [estimate.names[i] for i in determined], estimate.values[determined], estimate.u[determined]
    priors = dict[str, tuple[float, float]]()
    for group in estimate.groups:
        members = [name for name in estimate.names if group_name(name) == group.name]
        for name, learned in zip(members, group.learned, strict=True):
            priors[name] = group.prior * group.prior_widened, learned
    of_type = {name: size for name, size in estimate.of_type.items() if name in names}
    priors |= {name: (size, learned_fraction(float(u[names.index(name)]), size)) for name, size in of_type.items()}
    degrees = np.full(len(names), np.inf) if estimate.degrees is None else estimate.degrees[determined]
    return parameters_of(
        names,
        values,
        u,
        unit=[estimate.units[i] for i in determined],
        deviation=[
            value - systematic[name] if name in systematic else None
            for name, value in zip(names, values.tolist(), strict=True)
        ],
        dof=[None if count > MANY_DEGREES else count for count in degrees.tolist()],
        prior=[priors.get(name, (None, None))[0] for name in names],
        learned=[priors.get(name, (None, None))[1] for name in names],
    )


def mean_temperature(observations: Observations) -> float | None:
    """Return the reference temperature of the parameters, °C: the mean of the thermometers over the rests."""
    temperature = observations.rests.temperature
    return None if temperature is None else float(temperature.mean()) - ZERO_CELSIUS


def sensor_temperatures(observations: Observations) -> dict[str, tuple[float, ...]]:
    """Return the mean temperatures of the sensors over the rests, °C, by kind."""
    if observations.rests.temperatures is None:
        return {}
    celsius = observations.rests.temperatures.mean(axis=0) - ZERO_CELSIUS
    return {block.kind: tuple(celsius[block.thermometer].tolist()) for block in blocks_of(observations)}


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
    nothing: list[None] = [None] * len(rests)
    columns: dict[str, Any] = {"accel": nothing, "gyro": nothing, "attitude": nothing, "temperature": nothing}
    for block in blocks_of(observations):
        warm = np.empty((len(rests), 0))
        if rests.temperatures is not None:
            warm = rests.temperatures[:, block.thermometer] - ZERO_CELSIUS
        at_rest = {"mean": getattr(rests, block.kind), "temperature": warm}
        at_rest |= {what: getattr(rests, f"{block.kind}_{what}") for what in ("noise", "drift")}
        vectors = {name: map(tuple, values.tolist()) for name, values in at_rest.items()}
        columns[block.kind] = _records(SensorsAtRest, **vectors)
    if observations.programme is not None and observations.position is not None:
        columns["attitude"] = [observations.programme.positions[k].attitude for k in observations.position.tolist()]
    if rests.temperature is not None:
        columns["temperature"] = (rests.temperature - ZERO_CELSIUS).tolist()
    columns |= {name: getattr(rests, name).tolist() for name in ("file", "start", "stop")}
    columns |= {name: getattr(estimate, f"rest_{name}").tolist() for name in ("residual", "sigmas")}
    return _records(RestResult, **columns)


def turn_results(estimate: Estimate, observations: Observations) -> tuple[TurnResult, ...]:
    """Return the turns of a calibration, with their angles by its gyros and by the programme."""
    turns, programme, position = observations.turns, observations.programme, observations.position
    if turns is None or not len(estimate.turn_sigmas):
        return ()
    rotations, linearised = turns.C, estimate.linearised  # nominal ones without gyros, else of the likelihood
    if estimate.gyro is not None and linearised is not None and linearised.integrated is not None:
        rotations = linearised.rotations
    elif estimate.gyro is not None:
        rotations = observations.turns_about(estimate.gyro).C
    angles = np.arccos(np.clip(0.5 * (np.trace(rotations, axis1=1, axis2=2) - 1.0), -1.0, 1.0))
    programmed: list[float | None] = [None] * len(turns)
    if programme is not None and position is not None and programme.ordered:
        for k, (before, after) in enumerate(zip(position[turns.first], position[turns.last], strict=True)):
            angle = programme.moves[int(before)].angle if after == before + 1 else None
            programmed[k] = None if angle is None else abs(angle)
    results = _records(
        TurnResult,
        first=turns.first.tolist(),
        last=turns.last.tolist(),
        duration=turns.duration.tolist(),
        angle=len(turns) * [None] if estimate.gyro is None else angles.tolist(),
        programmed=programmed,
        sigmas=estimate.turn_sigmas.tolist(),
    )
    return tuple(turn for turn in results if turn.duration > 0.0)  # not between the parts of a rest


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
    turns, integrated = observations.turns, None if estimate.linearised is None else estimate.linearised.integrated
    cubic = any(group_name(name) == "gyro.cubic" for name in estimate.names)
    if estimate.method != "joint" or turns is None or integrated is None or cubic:
        return
    is_turn = turns.duration > 0.0  # and not the step between two parts of a rest
    rates = np.sqrt(integrated.moments.body_rates[is_turn][:, [0, 3, 5]].sum(axis=1) / turns.duration[is_turn])
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
    by_lag = estimate.budget.variances_from("lag")
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
