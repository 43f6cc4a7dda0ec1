"""Calibration of the device of a session."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from typing import Any, Literal, Unpack, get_args

import numpy as np

from tumble.advice import Advised, advised, found_in, remedy_of
from tumble.arguments import checked
from tumble.diagnosis import linear_model
from tumble.diagnosis.findings import refusal, remark
from tumble.diagnosis.level_faces import with_common_tilt
from tumble.diagnosis.misfit import ClockByEarth, clock_by_earth
from tumble.diagnosis.undetermined import one_attitude
from tumble.diagnosis.verdict import doubtful_time_base, improves, motion_note, unused_quiet_time
from tumble.errors import CalibrationError, InputError
from tumble.files import FilePath
from tumble.inference.estimate import Estimate, Outcome
from tumble.inference.joint import joint
from tumble.inference.prior import DevicePrior, with_prior
from tumble.inference.sources import clock_effects, clock_errors, source
from tumble.recording.arrays import SensorArrays, readings_of, session_of_arrays
from tumble.recording.log import Log
from tumble.recording.session import Session
from tumble.recording.session_file import gyros_in_place, session_from
from tumble.reduction.observations import Observations
from tumble.reduction.rests.segmentation import Segmentation
from tumble.result.accepted import accepted_kinds
from tumble.result.calibration import Calibration, calibration_from, read_calibration
from tumble.rotation import UP
from tumble.run.from_estimate import assemble, build_calibration, extended, gap_notes, mean_temperature
from tumble.run.observed import Observed, Progress, grade_of, inspect_session, observations_for_calibration, with_grade
from tumble.run.warming import calibrate_warming, is_still
from tumble.sensors.frames import Convention, Frame
from tumble.sensors.grades import grade as grade_named
from tumble.sensors.parameters import Terms
from tumble.units import DEGREE, G_STANDARD

_LOG = logging.getLogger(__name__)
Method = Literal["joint", "sequential", "scalar", "scalar-nominal", "ellipsoid"]
DEFAULT_METHOD: Method = "joint"
CLOCK_CONTRADICTED = 3.0  # u of the time base; a larger error of the clock is a remark instead of a note
UNSCALED = Advised(
    "the scale of the counts of the gyros is not stated: the accelerometers are calibrated alone",
    "state scale in [log.gyro] as the data sheet has it, and the gyros are too",
)


def _imported(module: str, name: str) -> Callable[..., Estimate]:
    """Return a method that is imported on its first call."""
    return lambda *args, **words: getattr(import_module(f"tumble.methods.{module}"), name)(*args, **words)


METHODS: Mapping[str, Callable[..., Estimate]] = {"joint": joint, "ellipsoid": _imported("ellipsoid", "ellipsoid")}
ITERATED_METHODS: Mapping[str, Callable[..., Estimate]] = {
    name: _imported("paper.four_stages", name.replace("-", "_")) for name in ("sequential", "scalar", "scalar-nominal")
}
"""Methods of the paper, which take a number of iterations."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Options:
    """Options of `calibrate`; `clock` is the clock of the log as the Earth's rate shows it."""

    method: str = DEFAULT_METHOD
    iterations: int | None = None
    frame: Frame = "accelerometer"
    terms: Terms = "full"
    prior: DevicePrior | None = None
    base: Calibration | None = None
    clock: ClockByEarth | None = None

    def __post_init__(self) -> None:
        """Raise InputError for options that are unknown or do not go together."""
        methods, joint_in_full = [*METHODS, *ITERATED_METHODS], self.method == "joint" and self.terms == "full"
        if self.method not in methods:
            raise InputError(f"--method: expected one of {', '.join(methods)}, found {self.method!r}")
        if self.terms not in get_args(Terms):
            raise InputError(f"--terms: expected {' or '.join(get_args(Terms))}, found {self.terms!r}")
        if self.iterations is not None and self.method not in ITERATED_METHODS:
            raise InputError(
                f"--iterations: expected none with the method {self.method!r}, which iterates until nothing changes, "
                f"found {self.iterations}; only {', '.join(ITERATED_METHODS)} take a number"
            )
        if self.prior is not None and not joint_in_full:
            raise InputError("prior: expected the method joint with all terms, which takes one, found another")
        alone = self.prior is None and self.frame == "accelerometer"
        if self.base is not None and not (joint_in_full and alone):
            raise InputError("--base: expected the method joint with all terms, no prior and no frame, found others")

    def estimate(self, observations: Observations) -> Estimate:
        """Return the estimate by the method, with terms = "linear" for the method joint that of the linear terms."""
        if self.method == "joint" and self.terms == "linear":
            return linear_model.linear_joint(observations)
        words = {} if self.iterations is None else {"iterations": self.iterations}
        return {**METHODS, **ITERATED_METHODS}[self.method](observations, **words)


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
    options = Options(
        method=method,
        iterations=iterations,
        frame=frame,
        terms=terms,
        prior=prior,
        base=None if base is None else calibration_from(base),
    )
    if frame != "accelerometer":
        Convention(frame=frame, block=recording.accel_block)  # raises InputError for sensors that have no such frame
    calibration = _calibrated(recording, options, progress)
    if recording.log.gyro is not stated.log.gyro:
        calibration = extended(calibration, notes=[UNSCALED])
    if not recording.excluded:
        return calibration
    # no u contains the choice of rests left out: the outcome of the whole recording is also stated
    try:
        outcome = _calibrated(replace(recording, excluded=()), options, progress).outcome
    except InputError as error:  # more rests than positions in the programme, for example after a knock
        outcome = Outcome(reasons=(str(error),))
    reasons = "; ".join(map(found_in, outcome.reasons))
    note = f"with what was left out: {': '.join(filter(None, [outcome.verdict, reasons]))}"
    by_choice = [kind for kind in accepted_kinds(calibration) if not outcome.of(kind)]
    if not by_choice:
        return extended(calibration, notes=[note])
    sentence = f"accepted only without what was left out, and u does not include the effect of this choice; {note}"
    return extended(calibration, [remark(sentence, concerns=tuple(by_choice))])


def _calibrated(session: Session, options: Options, progress: Progress) -> Calibration:
    """Calibrate with the rests that a session does not exclude.

    If the Earth's rate contradicts the clock of the log, the estimate is repeated with a corrected `clock`."""
    log, is_joint = session.log, options.method == "joint"
    observed = inspect_session(session, progress=progress)
    if options.base is not None or (is_joint and is_still(observed)):
        return calibrate_warming(observed, options.base)
    result = _estimated(observed, options)
    if options.clock is None and not isinstance(result, Outcome) and (clock := clock_by_earth(result[0])) is not None:
        corrected = replace(log, clock_rate=log.clock_rate * clock.rate, clock_u=clock.u)
        repeated = _calibrated(replace(session, log=corrected), replace(options, clock=clock), progress)
        sentence = clock.sentence(" and ".join(clock_effects(clock.u, log.increments)) or "no parameter")
        contradicted = abs(clock.rate - 1.0) > CLOCK_CONTRADICTED * log.time_base_u
        return extended(repeated, [remark(sentence)]) if contradicted else extended(repeated, notes=[sentence])
    notes = (*_latitude_notes(session), *gap_notes(observed.log.gaps), *observed.segmentation.unused())
    origin = observed.origin | {"notes": notes}
    if isinstance(result, Outcome):
        calibration = assemble(session, options.method, result, origin | assumptions(session))
    else:
        estimate, used, observations = result
        calibration = build_calibration(session, estimate, used, options.frame, origin)
        faults = (*observed.gyro_faults, *observed.gyro_bias_faults)
        accel_result = _accelerometers_alone(session, calibration, observations, options, origin) if is_joint else None
        if accel_result is not None:
            alone, reasons = "the accelerometers are estimated alone", calibration.outcome.gyro.reasons
            faults = (*(advised(f"{found_in(each)}; {alone}", remedy_of(each)) for each in reasons), *faults)
            calibration, estimate, used = accel_result
        calibration = _with_remarks(calibration, estimate, used, session, observed.segmentation, faults)
        if options.prior is not None and estimate.of_type:
            calibration = extended(calibration, prior=options.prior.words)
    for sentence in (*calibration.provenance.notes, *calibration.outcome.remarks, *calibration.outcome.reasons):
        _LOG.info("%s: %s", session.name, sentence)
    return calibration


def _accelerometers_alone(
    session: Session, calibration: Calibration, observations: Observations, options: Options, origin: Mapping[str, Any]
) -> tuple[Calibration, Estimate, Observations] | None:
    """Return the calibration of the accelerometers alone, its estimate and its observations.

    None unless the `calibration` refuses the accelerometers because of the gyros, and alone they are accepted."""
    outcome = calibration.outcome
    concerned = [outcome.concerns.get(reason, ("",))[0] for reason in outcome.accel.reasons]
    if not concerned or not all(part.startswith("gyro") for part in concerned):
        return None
    result = estimate_observations(session, prepared(session, observations.of_accelerometers(), options), options)
    if isinstance(result, Outcome):
        return None
    alone = build_calibration(session, *result, options.frame, origin)
    return (alone, *result) if alone.outcome.accel.accepted and alone.accel is not None else None


def _estimated(observed: Observed, options: Options) -> tuple[Estimate, Observations, Observations] | Outcome:
    """Return the estimate of a recording, its observations as the estimate used them, and as they were before.

    A recording of motion with rests is estimated from rests and turns too, and from motion only if that is better."""
    observations = observations_for_calibration(observed, joint=options.method == "joint")
    if isinstance(observations, Outcome):
        return observations
    ready = prepared(observed.session, observations, options)
    if observations.links is not None:
        at_rest = observations_for_calibration(observed, joint=True, motion=False)
        if isinstance(at_rest, Observations):
            ready_at_rest = prepared(observed.session, at_rest, options)
            moving, still = _at_maximum(ready), _at_maximum(ready_at_rest)
            if moving is None or not (still is None or improves(moving, still)):
                observations, ready = at_rest, ready_at_rest
    result = estimate_observations(observed.session, ready, options)
    return result if isinstance(result, Outcome) else (*result, observations)


def _at_maximum(observations: Observations) -> Estimate | None:
    """Return the joint estimate at the maximum of its hyperparameters; None if it breaks down."""
    try:
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # damaged samples
            return joint(observations, intervals=False)
    except np.linalg.LinAlgError:
        return None


def _with_remarks(
    calibration: Calibration,
    estimate: Estimate,
    used: Observations,
    session: Session,
    segmentation: Segmentation,
    faults: Iterable[str],
) -> Calibration:
    """Return the calibration of a recording with remarks on it, the `faults` of its gyros, and its magnetometer."""
    log, accepted = session.log, accepted_kinds(calibration)
    findings = list(map(remark, unused_quiet_time(segmentation, in_motion=used.links is not None)))
    if estimate.gyro is not None and not log.increments["gyro"]:
        usual = grade_named(grade_of(session, used)[0]).gyro.scale
        findings += [remark(sentence, concerns=("gyro.scale",)) for sentence in doubtful_time_base(estimate, usual)]
    lost = () if session.gyro_block is None or estimate.gyro is not None else session.gyro_block.names
    refusals = [refusal(fault, concerns=("gyro" if lost else "gyro.bias",)) for fault in faults]
    calibration = extended(
        calibration,
        [*findings, *refusals],
        lost if refusals else (),
        notes=motion_note(estimate, used) if accepted else (),
        **assumptions(session, accepted),
    )
    if log.magnetometer is None:
        return calibration
    from tumble.run.magnetometer import with_magnetometer

    return with_magnetometer(calibration, estimate, log.magnetometer, used)


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


def prepared(session: Session, observations: Observations, options: Options) -> Observations:
    """Return observations with what the session and the options state: grade, clock, and values to start from."""
    prior, clock, log = options.prior, options.clock, session.log
    observations = with_grade(session, observations)
    return replace(
        observations,
        start=passport_values(session),
        by_clock=clock_effects(log.time_base_u, log.increments) | dict(clock.changes if clock else {}),
        unstamped=log.unstamped,
        in_run={**observations.in_run, **(prior.in_run if prior is not None else {})},
    )


def estimate_observations(
    session: Session, observations: Observations, options: Options
) -> tuple[Estimate, Observations] | Outcome:
    """Return the estimate of `prepared` observations, and these, or an Outcome with the reason if there is none."""
    prior, notes = options.prior, observations.notes
    try:
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # damaged samples
            estimate = options.estimate(observations)
        if estimate.method != "joint":  # the method joint includes the time base
            estimate = _with_clock(estimate, observations.by_clock)
        if options.terms == "linear" or estimate.method != "joint":
            if estimate.groups:
                notes += (
                    f"the method {estimate.method}{' with linear terms' * (estimate.method == 'joint')} takes errors "
                    "other than bias, scale factor and axis angles as zero and includes their usual size in u; the "
                    "method joint with all terms estimates them",
                )
            estimate = linear_model.linear_part(estimate) if options.terms == "linear" else estimate
        elif prior is not None:
            estimate, prior_notes = with_prior(estimate, observations, prior, mean_temperature(observations))
            notes += prior_notes
        grade, guessed_from = grade_of(session, observations)
        if session.device.grade is not None and guessed_from:
            sentence = Advised(
                f"the stated grade is {session.device.grade!r}, but by {guessed_from} the device is of the grade "
                f"{grade}, whose usual sizes are taken",
                "state its grade in [device], or look for what disturbed the recording",
            )
            estimate = replace(estimate, remarks=(*estimate.remarks, sentence))
        estimate = with_common_tilt(estimate, observations)
    except np.linalg.LinAlgError as error:
        broken = f"the estimate broke down ({error}): the data contradict the model"
        broken = Advised(broken, "look at them with `tumble inspect`")
        return Outcome(reasons=(one_attitude(observations) or broken,))
    return estimate, replace(observations, notes=notes)


def _with_clock(estimate: Estimate, by_clock: Mapping[str, float]) -> Estimate:
    """Return an estimate with the error of the time base in its covariance and its budget.

    `by_clock` is the change of groups of parameters by one standard uncertainty of the time base."""
    change = clock_errors(estimate.names, by_clock)
    covariance, budget = np.outer(change, change), estimate.budget
    if budget is not None:
        relative = max(map(abs, by_clock.values()), default=0.0)
        budget = budget.with_source(source("clock", relative, "1"), covariance)
    return replace(estimate, covariance=estimate.covariance + covariance, budget=budget)


def assumptions(session: Session, accepted: Sequence[str] = ()) -> dict[str, Any]:
    """Return the assumptions about a session and what it leaves unstated, as fields of `Provenance`.

    A doubt about the unit of a kind of sensors ends where these are `accepted`."""
    site, log, unstated = session.site, session.log, dict[str, str]()
    by_clock = clock_effects(log.time_base_u, log.increments)
    mm = f"{1e3 * site.gravity_u:.2g} mm/s²"
    if site.assumed == "height":
        found = f"the height is not stated: gravity is that of sea level, with {mm} for heights of 1300 m in u of "
        unstated[Advised(f"{found}accel.scale", "state height_m in [site] (--height), or gravity")] = "gravity"
    elif site.assumed == "digits" and site.gravity_u:
        found = f"gravity is taken to its last digit, with {mm} in u of accel.scale"
        unstated[Advised(found, "state gravity_u in [site]")] = "gravity"
    if log.clock_u is None and by_clock:
        clock = "time stamps of a crystal" if log.rate is None else "a sample rate without time stamps"
        size = f"{1e6 * log.time_base_u:.0f} ppm" if log.rate is None else f"{1e2 * log.time_base_u:.0f} %"
        found = f"the uncertainty of the time base is not stated: {size}, usual for {clock}, is in u of "
        unstated[Advised(f"{found}{' and '.join(by_clock)}", "state clock_ppm_u in [log], 0 where it is exact")] = (
            "clock"
        )
    by_kind = {"accel": log.accel, "gyro": log.gyro}
    settled = {channels.doubt for kind in accepted if (channels := by_kind[kind]) is not None}
    doubts = (f"doubt: {doubt}" for doubt in log.doubts if doubt not in settled)
    return {"unstated": unstated, "assumptions": (*unstated, *doubts)}


def _latitude_notes(session: Session) -> tuple[str, ...]:
    """Return a note on a latitude with three decimals or more that may have been meant in radians."""
    degrees = (session.site.latitude or 0.0) / DEGREE
    if abs(degrees) >= 0.5 * math.pi or abs(degrees - round(degrees, 2)) < 1e-9:
        return ()
    return (f"latitude {degrees:.6g}° as stated; {degrees / DEGREE:.3g}° if radians were meant",)
