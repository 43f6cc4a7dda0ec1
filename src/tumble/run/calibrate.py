"""Calibration of the device of a session."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from datetime import UTC, datetime
from functools import partial
from importlib import import_module
from types import MappingProxyType
from typing import Any, Literal, Unpack, get_args

import numpy as np

from tumble import __version__
from tumble.advice import Advised, advised, found_in, remedy_of
from tumble.arguments import checked
from tumble.diagnosis import linear_model
from tumble.diagnosis.level_faces import with_common_tilt
from tumble.diagnosis.misfit import ClockByEarth, clock_by_earth
from tumble.diagnosis.undetermined import one_attitude
from tumble.diagnosis.verdict import doubtful_time_base, improves, motion_note, unused_quiet_time
from tumble.errors import CalibrationError, InputError
from tumble.files import FilePath
from tumble.inference.estimate import Estimate, Outcome
from tumble.inference.hyperparameters import size_factors
from tumble.inference.joint import joint
from tumble.inference.prior import DevicePrior, with_prior
from tumble.inference.sources import clock_effects, clock_errors, source
from tumble.recording.arrays import SensorArrays, readings_of, session_of_arrays
from tumble.recording.log import Log
from tumble.recording.session import Session
from tumble.recording.session_file import gyros_in_place, session_from
from tumble.reduction.observations import Observations
from tumble.result.accepted import accepted_kinds
from tumble.result.calibration import Calibration, calibration_from, read_calibration
from tumble.result.parts import Provenance
from tumble.rotation import UP
from tumble.run.from_estimate import build_calibration, gap_notes, mean_temperature, refused_calibration
from tumble.run.observed import Observed, Progress, grade_of, inspected, observations_for_calibration
from tumble.run.warming import calibrate_warming, is_still
from tumble.sensors.frames import Convention, Frame
from tumble.sensors.grades import grade as grade_named
from tumble.sensors.parameters import Terms, prior_sizes, usual_sizes
from tumble.units import G_STANDARD

_LOG = logging.getLogger(__name__)
Method = Literal["joint", "sequential", "scalar", "scalar-nominal", "ellipsoid"]
DEFAULT_METHOD: Method = "joint"
Estimator = Callable[[Observations], Estimate]
_HEIGHT, _DIGITS = "the height is not stated", "gravity is taken to its last digit"
_TIME_BASE = "the uncertainty of the time base is not stated"
UNSTATED: Mapping[str, str] = {_HEIGHT: "gravity", _DIGITS: "gravity", _TIME_BASE: "clock"}
"""Beginning of the sentence on what is not stated and in u, with its source in the uncertainty budget."""
CLOCK_CONTRADICTED = 3.0  # u of the time base; a larger error of the clock is a remark instead of a note


def _imported(module: str, name: str) -> Callable[..., Estimate]:
    """Return a method that is imported on its first call."""
    return lambda *args, **words: getattr(import_module(f"tumble.methods.{module}"), name)(*args, **words)


METHODS: Mapping[str, Callable[..., Estimate]] = {"joint": joint, "ellipsoid": _imported("ellipsoid", "ellipsoid")}
UNSCALED = Advised(
    "the scale of the counts of the gyros is not stated: the accelerometers are calibrated alone",
    "state scale in [log.gyro] as the data sheet has it, and the gyros are too",
)
ITERATED_METHODS: Mapping[str, Callable[..., Estimate]] = {
    name: _imported("paper.four_stages", name.replace("-", "_")) for name in ("sequential", "scalar", "scalar-nominal")
}
"""Methods of the paper, which take a number of iterations."""


@checked
def calibrate(
    session: Session | FilePath | None = None,
    *,
    method: Method = DEFAULT_METHOD,
    iterations: int | None = None,
    frame: Frame = "accelerometer",
    terms: Terms = "full",
    without: Iterable[int] = (),
    prior: DevicePrior | None = None,
    base: Calibration | FilePath | None = None,
    progress: Progress = Log.chunks,
    **arrays: Unpack[SensorArrays],
) -> Calibration:
    """Calibrate the device of a session.

    Parameters
    ----------
    session
        A session or the path of its folder; None for readings given as `accel=…, gyro=…, rate=…`.
    method
        `joint`, one estimate from all readings with priors; `sequential`, `scalar` and `scalar-nominal`, the methods of
        the paper, the last in the attitudes of the programme; `ellipsoid`, accelerometers alone, without attitudes.
    iterations
        Number of passes of the methods of the paper; default 2.
    frame
        Frame of the result: `accelerometer`, `paper`, `symmetric` or `case`.
    terms
        `full`, or `linear` for bias, scale factor and axis angles alone; their u then includes the other groups with
        the usual size.
    without
        Numbers from 1 of rests to leave out, in addition to those that the session excludes.
    prior
        Prior from calibrations of other devices of the type, such as that of `Registry.prior`, instead of sizes usual
        for the grade; for the method `joint` with all terms.
    base
        Calibration of the device, or its file, to whose biases a recording at rest while it warms or cools adds
        temperature coefficients; for the method `joint` with all terms.
    progress
        Function that yields the chunks of a log while it is read, for example with a progress bar.
    **arrays
        Readings in memory, in SI, instead of a session: `accel` and `gyro` (N, n), `time` (N,) or `rate`,
        `temperature`, `latitude`, `height`, `gravity`, `gravity_u`, `accel_axes`, `gyro_axes`, `programme`, `serial`
        and `clock_ppm_u`, see `tumble.types.SensorArrays`. For gyros alone the biases are calibrated.

    Returns
    -------
    Calibration
        If the recording cannot be calibrated, the reasons are in its `outcome`.

    Raises
    ------
    InputError
        If the input cannot be used.

    Examples
    --------
    >>> import tumble
    >>> folder = tumble.simulate_session("session", tumble.Setup.of(grade="mems", positions=12), seed=1)
    >>> tumble.calibrate(folder)
    <Calibration of mems-1: joint, 51 parameters, accepted>
    >>> import polars as pl
    >>> log = pl.read_parquet(folder / "log.parquet")
    >>> accel, gyro = log.select("ax", "ay", "az").to_numpy(), log.select("gx", "gy", "gz").to_numpy()
    >>> tumble.calibrate(accel=accel, gyro=gyro, time=log["t"], latitude=0.992, serial="A-0007")
    <Calibration of A-0007: joint, 51 parameters, accepted>
    """
    if terms not in get_args(Terms):
        raise InputError(f"--terms: expected {' or '.join(get_args(Terms))}, found {terms!r}")
    rates = arrays.get("gyro")
    if session is None and arrays.get("accel") is None and rates is not None:
        from tumble.run.gyros_alone import calibrate_gyros, gyro_rests

        upright = np.tile(G_STANDARD * UP, (len(readings_of("gyro", rates)), 1))
        return calibrate_gyros(gyro_rests(gyros_in_place(session_of_arrays(**arrays | {"accel": upright})), progress))
    if session is None and "accel" in arrays:
        recording = session_of_arrays(**arrays)
    elif session is None or arrays:
        found = ", ".join(arrays) or "nothing"
        beside = "" if session is None else " beside a session"
        raise InputError(f"calibrate: expected a session or readings accel=…, gyro=…, found {found}{beside}")
    else:
        recording = session_from(session)
    recording, stated = recording.without(without).of_known_scales(), recording
    methods: dict[str, Callable[..., Estimate]] = {**METHODS, **ITERATED_METHODS}
    if method not in methods:
        raise InputError(f"--method: expected one of {', '.join(methods)}, found {method!r}")
    if iterations is not None and method not in ITERATED_METHODS:
        raise InputError(
            f"--iterations: expected none with the method {method!r}, which iterates until nothing changes, found "
            f"{iterations}; only {', '.join(ITERATED_METHODS)} take a number"
        )
    estimator: Estimator = methods[method] if iterations is None else partial(methods[method], iterations=iterations)
    if prior is not None and (method != "joint" or terms != "full"):
        raise InputError("prior: expected the method joint with all terms, which takes one, found another")
    if base is not None and (method != "joint" or terms != "full" or prior is not None or frame != "accelerometer"):
        raise InputError("--base: expected the method joint with all terms, no prior and no frame, found others")
    if frame != "accelerometer":
        Convention(frame=frame, block=recording.accel_block)
    base_calibration = None if base is None else calibration_from(base)
    calibration = _calibrated(recording, method, estimator, frame, terms, progress, prior, base_calibration)
    if recording.log.gyro is not stated.log.gyro:
        calibration = _with(calibration, notes=(UNSCALED,))
    if not recording.excluded:
        return calibration
    # no u contains the choice of rests left out: the outcome of the whole recording is also stated
    try:
        whole = replace(recording, excluded=())
        outcome = _calibrated(whole, method, estimator, frame, terms, progress, prior, base_calibration).outcome
    except InputError as error:  # more rests than positions in the programme, for example after a knock
        outcome = Outcome(reasons=(str(error),))
    reasons = "; ".join(map(found_in, outcome.reasons))
    note = f"with what was left out: {': '.join(filter(None, [outcome.verdict, reasons]))}"
    by_choice = tuple(kind for kind in accepted_kinds(calibration) if not outcome.of(kind))
    remark = f"accepted only without what was left out, and u does not include the effect of this choice; {note}"
    return _with(calibration, remarks={remark: by_choice}) if by_choice else _with(calibration, notes=(note,))


def _calibrated(
    session: Session,
    method: str,
    estimator: Estimator,
    frame: Frame,
    terms: Terms,
    progress: Progress,
    prior: DevicePrior | None,
    base: Calibration | None,
    clock: ClockByEarth | None = None,
) -> Calibration:
    """Calibrate with the rests that a session does not exclude.

    If the Earth's rate contradicts the clock of the log, the estimate is repeated with a corrected `clock`."""
    systematic = passport_values(session)
    options = (estimator, systematic, terms, prior, clock)
    with ThreadPoolExecutor(max_workers=1) as executor:
        observed = inspected(session, progress, executor)
        observations = observations_for_calibration(observed, joint=method == "joint")
        if base is not None or (method == "joint" and is_still(observed)):
            return calibrate_warming(observed, base, new_provenance(observed.sha256))
        if isinstance(observations, Outcome):
            result: tuple[Estimate, Observations] | Outcome = observations
        else:
            result, observations = _estimate_of_rests_or_motion(observed, observations, options)
    if clock is None and not isinstance(result, Outcome) and (clock := clock_by_earth(result[0])) is not None:
        log = replace(session.log, clock_rate=session.log.clock_rate * clock.rate, clock_u=clock.u)
        repeated = _calibrated(replace(session, log=log), method, estimator, frame, terms, progress, prior, base, clock)
        sentence = clock.sentence(" and ".join(clock_effects(clock.u, log.increments)) or "no parameter")
        contradicted = abs(clock.rate - 1.0) > CLOCK_CONTRADICTED * session.log.time_base_u
        return _with(repeated, remarks={sentence: ()}) if contradicted else _with(repeated, notes=(sentence,))
    bridged = (*gap_notes(observed.gaps), *observed.segmentation.unused())
    provenance = replace(
        new_provenance(observed.sha256),
        sample_rate=observed.rate,
        circumstances=observed.circumstances,
        assumptions=assumptions(session),
    )
    if isinstance(result, Outcome):
        calibration = refused_calibration(session, method, result, provenance, bridged)
    else:
        calibration = build_calibration(session, *result, systematic, frame, provenance, bridged)
        faults = (*observed.gyro_faults, *observed.gyro_bias_faults)
        concerned = [calibration.outcome.concerns.get(reason, ("",))[0] for reason in calibration.outcome.accel.reasons]
        by_gyros = bool(concerned) and all(part.startswith("gyro") for part in concerned)
        if by_gyros and method == "joint" and not isinstance(observations, Outcome):
            accel_result = estimate_observations(session, observations.of_accelerometers(), *options)
            if not isinstance(accel_result, Outcome):
                accel_only = build_calibration(session, *accel_result, systematic, frame, provenance, bridged)
                if accel_only.outcome.accel.accepted and accel_only.accel is not None:
                    reasons = calibration.outcome.gyro.reasons
                    alone = "the accelerometers are estimated alone"
                    because = (advised(f"{found_in(each)}; {alone}", remedy_of(each)) for each in reasons)
                    result, calibration, faults = accel_result, accel_only, (*because, *faults)
        estimate, used = result
        little = unused_quiet_time(observed.segmentation, in_motion=used.links is not None)
        remarks: dict[str, tuple[str, ...]] = dict.fromkeys(little, ())
        if estimate.gyro is not None and not session.log.increments["gyro"]:
            grade, _ = grade_of(session, used)
            remarks |= dict.fromkeys(doubtful_time_base(estimate, grade_named(grade).gyro.scale), ("gyro.scale",))
        notes = motion_note(estimate, used) if accepted_kinds(calibration) else ()
        calibration = _with(calibration, notes=notes, remarks=remarks)
        sensors = {"accel": session.log.accel, "gyro": session.log.gyro}
        settled = {f"doubt: {channels.doubt}" for kind in accepted_kinds(calibration) if (channels := sensors[kind])}
        open_ones = tuple(s for s in calibration.provenance.assumptions if s not in settled)
        calibration = replace(calibration, provenance=replace(calibration.provenance, assumptions=open_ones))
        if session.log.magnetometer is not None:
            from tumble.run.magnetometer import with_magnetometer

            calibration = with_magnetometer(calibration, estimate, session.log.magnetometer, used)
        if prior is not None and estimate.of_type:
            calibration = replace(calibration, provenance=replace(calibration.provenance, prior=prior.words))
        if faults:
            lost = () if session.gyro_block is None or estimate.gyro is not None else session.gyro_block.names
            part, outcome = "gyro" if lost else "gyro.bias", calibration.outcome
            outcome = replace(
                outcome,
                reasons=(*outcome.reasons, *faults),
                concerns={**outcome.concerns, **dict.fromkeys(faults, (part,))},
                unobservable=(*outcome.unobservable, *lost),
            )
            calibration = replace(calibration, outcome=outcome)
    for sentence in (*calibration.provenance.notes, *calibration.outcome.remarks, *calibration.outcome.reasons):
        _LOG.info("%s: %s", session.name, sentence)
    return calibration


def _estimate_of_rests_or_motion(
    observed: Observed, observations: Observations, options: tuple[Any, ...]
) -> tuple[tuple[Estimate, Observations] | Outcome, Observations]:
    """Return the estimate from observations, with these; from rests and turns if motion is no better than they are."""
    result = estimate_observations(observed.session, observations, *options)
    if observations.links is not None and len(observations.rests):
        at_rest = observations_for_calibration(observed, joint=True, motion=False)
        if isinstance(at_rest, Observations):
            by_rests = estimate_observations(observed.session, at_rest, *options)
            if isinstance(result, Outcome) or not (isinstance(by_rests, Outcome) or improves(result[0], by_rests[0])):
                return by_rests, at_rest
    return result, observations


def _with(
    calibration: Calibration,
    *,
    notes: Iterable[str] = (),
    remarks: Mapping[str, tuple[str, ...]] = MappingProxyType({}),
) -> Calibration:
    """Return the calibration with further notes and remarks.

    `remarks` maps each to the kinds of sensors or groups of parameters that it concerns; empty means all."""
    outcome, provenance = calibration.outcome, calibration.provenance
    concerns = {**outcome.concerns, **{remark: concerned for remark, concerned in remarks.items() if concerned}}
    return replace(
        calibration,
        outcome=replace(outcome, remarks=(*outcome.remarks, *remarks), concerns=concerns),
        provenance=replace(provenance, notes=(*provenance.notes, *notes)),
    )


def passport_values(session: Session) -> Mapping[str, float]:
    """Return the values of the systematic (passport) calibration that a session names, by parameter name."""
    if session.device.systematic is None:
        return {}
    passport = read_calibration(session.device.systematic)
    if passport.frame != "accelerometer":
        raise CalibrationError(
            f"{session.device.systematic}: expected a calibration in the frame 'accelerometer', found "
            f"{passport.frame!r}; calibrate without --frame to get one"
        )
    return {p.name: p.value for p in passport.parameters}


def with_grade(session: Session, observations: Observations) -> Observations:
    """Return the observations with the sizes of parameter groups and in-run biases usual for the grade of the
    device."""
    grade, guessed_from = grade_of(session, observations)
    sheet, noise = session.device.prior, grade_named(grade).noise
    sizes, usual = prior_sizes(grade, sheet), usual_sizes(grade)
    note = f"errors other than bias, scale factor and axis angles have the size usual for the grade {grade}"
    if guessed_from:
        note = Advised(f"{note}, guessed from {guessed_from}", "state another as [device] grade")
    basis = f"{'guessed' if guessed_from else 'stated'} grade {grade}"
    return replace(
        observations,
        usual=sizes,
        size_basis={name: "data sheet" if name in sheet else basis for name in sizes},
        too_small=size_factors(grade, sizes, sheet, guessed=bool(guessed_from)),
        in_run={"accel": noise.accel_instability, "gyro": noise.gyro_instability},
        drift={kind: usual[f"{kind}.bias.drift"] for kind in ("accel", "gyro") if f"{kind}.bias.drift" not in sizes},
        notes=(*observations.notes, note),
    )


def estimate_observations(
    session: Session,
    observations: Observations,
    method: Estimator,
    start: Mapping[str, float],
    terms: Terms,
    prior: DevicePrior | None = None,
    clock: ClockByEarth | None = None,
) -> tuple[Estimate, Observations] | Outcome:
    """Return the estimate by a method and its observations, or an Outcome with the reason if there is none."""
    by_clock = clock_effects(session.log.time_base_u, session.log.increments) | dict(clock.changes if clock else {})
    linear_joint = method is joint and terms == "linear"
    observations = with_grade(session, observations)
    if prior is not None:
        observations = replace(observations, in_run={**observations.in_run, **prior.in_run})
    notes, unstamped = observations.notes, session.log.unstamped
    observations = replace(observations, start=start, by_clock=by_clock, unstamped=unstamped)
    try:
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # damaged samples
            estimate = linear_model.linear_joint(observations) if linear_joint else method(observations)
        if estimate.method != "joint":  # the method joint includes the time base
            change, relative = clock_errors(estimate.names, by_clock), max(map(abs, by_clock.values()), default=0.0)
            clock_covariance, budget = np.outer(change, change), estimate.budget
            budget = None if budget is None else budget.with_source(source("clock", relative, "1"), clock_covariance)
            estimate = replace(estimate, covariance=estimate.covariance + clock_covariance, budget=budget)
        if linear_joint or estimate.method != "joint":
            if estimate.groups:
                notes += (
                    f"the method {estimate.method}{' with linear terms' * linear_joint} takes errors other than bias, "
                    "scale factor and axis angles as zero and includes their usual size in u; the method joint with "
                    "all terms estimates them",
                )
            estimate = linear_model.linear_part(estimate) if terms == "linear" else estimate
        elif prior is not None:
            estimate, prior_notes = with_prior(estimate, observations, prior, mean_temperature(observations))
            notes += prior_notes
        grade, guessed_from = grade_of(session, observations)
        if session.device.grade is not None and guessed_from:
            remark = Advised(
                f"the stated grade is {session.device.grade!r}, but by {guessed_from} the device is of the grade "
                f"{grade}, whose usual sizes are taken",
                "state its grade in [device], or look for what disturbed the recording",
            )
            estimate = replace(estimate, remarks=(*estimate.remarks, remark))
        estimate = with_common_tilt(estimate, observations)
    except np.linalg.LinAlgError as error:
        broken = f"the estimate broke down ({error}): the data contradict the model"
        broken = Advised(broken, "look at them with `tumble inspect`")
        return Outcome(reasons=(one_attitude(observations) or broken,))
    return estimate, replace(observations, notes=notes)


def assumptions(session: Session) -> tuple[str, ...]:
    """Return a sentence for each assumption about a session, with the statement that would replace it."""
    site, log, sentences = session.site, session.log, list[str]()
    by_clock = clock_effects(log.time_base_u, log.increments)
    mm = f"{1e3 * site.gravity_u:.2g} mm/s²"
    if site.assumed == "height":
        found = f"{_HEIGHT}: gravity is that of sea level, with {mm} for heights of 1300 m in u of accel.scale"
        sentences.append(Advised(found, "state height_m in [site] (--height), or gravity"))
    elif site.assumed == "digits" and site.gravity_u:
        sentences.append(Advised(f"{_DIGITS}, with {mm} in u of accel.scale", "state gravity_u in [site]"))
    if log.clock_u is None and by_clock:
        clock = "time stamps of a crystal" if log.rate is None else "a sample rate without time stamps"
        size = f"{1e6 * log.time_base_u:.0f} ppm" if log.rate is None else f"{1e2 * log.time_base_u:.0f} %"
        found = f"{_TIME_BASE}: {size}, usual for {clock}, is in u of {' and '.join(by_clock)}"
        sentences.append(Advised(found, "state clock_ppm_u in [log], 0 where it is exact"))
    return (*sentences, *(f"doubt: {doubt}" for doubt in log.doubts))


def new_provenance(log_sha256: str) -> Provenance:
    """Return the provenance of a calibration made now."""
    created = datetime.now(UTC).isoformat(timespec="seconds")
    return Provenance(log_sha256=log_sha256, software=f"tumble {__version__}", created=created)
