"""Several sessions of one device over temperature as one estimate.

The parameters and how they change with temperature are common; attitudes are those of each rest, and biases are each
session's own by what differs from launch to launch and drifts in a session, both with priors. A session in which
nothing is turned says how biases change with its temperature and nothing else.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from tumble.errors import InputError
from tumble.files import FilePath
from tumble.inference.estimate import Estimate, Outcome, OwnEstimate
from tumble.inference.joint import joint
from tumble.recording.log import Log
from tumble.recording.session import Session
from tumble.recording.session_file import session_from
from tumble.reduction.observations import Observations
from tumble.reduction.together import joined
from tumble.result.calibration import Calibration
from tumble.result.parts import Member, Parameter
from tumble.run.calibrate import estimated, provenance_of, systematic_of
from tumble.run.from_estimate import result_of, without_result
from tumble.run.launches import circumstances_of_all, digest_of_all
from tumble.run.observed import Observed, Progress, inspect_session, observations_in_parts
from tumble.run.same_recording import Means, check_recordings
from tumble.sensors.frames import Frame
from tumble.sensors.model import Block
from tumble.units import DEGREE, DEGREE_PER_HOUR, G_STANDARD, ZERO_CELSIUS

SAME_GRAVITY = 1e-6  # m/s²
SAME_LATITUDE = 1e-9  # rad
SELDOM = 1e-3
"""Residuals are more than noise where chance alone would make them so large less often."""


_Reduced = tuple[Session, Member, Observations]
"""A session, what is said of it, and what is taken of its log."""


def calibrate_together(
    sessions: Sequence[Session | FilePath],
    *,
    frame: Frame = "accelerometer",
    progress: Progress = Log.chunks,
) -> Calibration:
    """Calibrate a device over temperature from several sessions, each a `Session` or the path of its folder, in one
    estimate by the method joint: parameters and their coefficients over temperature are common, attitudes and what
    differs from launch to launch each session's own. Levels, ramps, and long recordings in one position may be mixed.

    Raises InputError for fewer than two sessions, another device, place or sensors than the first session has, one log
    twice, and a session without temperatures.

    >>> import tumble
    >>> folders = [tumble.simulate_session(f"level-{i}", tumble.Setup.of(positions=12), seed=i) for i in (1, 2)]
    >>> tumble.calibrate_together(folders)
    Traceback (most recent call last):
    ...
    tumble.errors.InputError: level-1: expected temperatures in every session, found no [log.temperature]
    """
    if len(sessions) < 2:
        raise InputError(f"sessions: expected two or more for one estimate, found {len(sessions)}")
    if frame == "case":
        raise InputError("frame: expected accelerometer, paper or symmetric of several sessions, found 'case'")
    described = [session_from(session) for session in sessions]
    _check_alike(described)
    first, systematic = described[0], systematic_of(described[0])
    reduced: list[_Reduced] = []
    numbers, circumstances, faults = [], [], []
    for session in described:
        observed = inspect_session(session, progress=progress)
        circumstances.append(observed.circumstances)
        taken = observations_in_parts(observed)
        if isinstance(taken, Outcome):
            faults += [f"{_name(session)}: {reason}" for reason in taken.reasons]
        else:
            reduced.append((session, _member(observed, taken[0]), taken[0]))
            numbers.append(taken[1])
    provenance = provenance_of(digest_of_all(member.log_sha256 for _, member, _ in reduced))
    if faults:
        return without_result(first, "joint", Outcome(reasons=tuple(faults)), provenance)
    _check_logs(reduced)
    names = [member.session for _, member, _ in reduced]
    whole = joined([observations for _, _, observations in reduced], names, numbers)
    estimate = estimated(first, whole, joint, systematic, "full")
    if isinstance(estimate, Outcome):
        return without_result(first, "joint", estimate, provenance)
    made = result_of(first, *estimate, systematic, frame, provenance)
    return replace(
        made,
        outcome=_with_scatter(made.outcome, estimate[0]),
        circumstances=circumstances_of_all(circumstances),
        notes=(*made.notes, *(note for _, member, observations in reduced for note in _notes(member, observations))),
        together=tuple(_with_own(member, estimate[0].own, s) for s, (_, member, _) in enumerate(reduced)),
    )


def _name(session: Session) -> str:
    return Path(session.name).name or session.name


# What sessions must have in common


def _check_alike(sessions: Sequence[Session]) -> None:
    first = sessions[0]
    for session in sessions:
        if session.log.temperature is None:
            raise InputError(f"{session.name}: expected temperatures in every session, found no [log.temperature]")
        if session.device.serial != first.device.serial:
            raise InputError(
                f"{session.name}: expected the device {first.device.serial!r} of the first session, found "
                f"{session.device.serial!r}; calibrate each device by itself"
            )
        if not (_same(session.accel_block, first.accel_block) and _same(session.gyro_block, first.gyro_block)):
            raise InputError(
                f"{session.name}: expected the sensors and thermometers of the first session, found others; list them "
                "alike"
            )
        if not _same_place(session, first):
            raise InputError(
                f"{session.name}: expected the place of the first session, {_place(first)}, found {_place(session)}; "
                "give the same [site]"
            )


def _same(block: Block | None, other: Block | None) -> bool:
    if block is None or other is None:
        return block is other
    if block.axes.shape != other.axes.shape or not np.array_equal(block.thermometer, other.thermometer):
        return False
    return bool(np.allclose(block.axes, other.axes, rtol=0.0, atol=1e-9))


def _same_place(session: Session, other: Session) -> bool:
    a, b = session.site, other.site
    if a.latitude is None or b.latitude is None:
        return a.latitude is b.latitude and abs(a.gravity - b.gravity) < SAME_GRAVITY
    return abs(a.latitude - b.latitude) < SAME_LATITUDE and abs(a.gravity - b.gravity) < SAME_GRAVITY


def _place(session: Session) -> str:
    latitude = session.site.latitude
    said = "no latitude" if latitude is None else f"latitude {latitude / DEGREE:.6g}°"
    return f"{said} and gravity {session.site.gravity:.6f} m/s^2"


def _check_logs(reduced: Sequence[_Reduced]) -> None:
    check_recordings([(session.name, member.log_sha256, _means(each)) for session, member, each in reduced])
    for session, _, observations in reduced:
        if observations.rests.temperature is None:
            raise InputError(f"{session.name}: expected temperatures in the log, found none that are numbers")


def _means(observations: Observations) -> Means:
    """What the sensors read in the rests of a session."""
    rests = observations.rests
    variances = [np.diagonal(C, axis1=1, axis2=2) for C in (rests.accel_covariance, rests.gyro_covariance)]
    return np.hstack([rests.accel, rests.gyro]), np.sqrt(np.hstack(variances))


# What is said


def _member(observed: Observed, observations: Observations) -> Member:
    """A session without what it has of its own."""
    rests, turns = observations.rests, observations.turns
    celsius = np.full(1, np.nan) if rests.temperature is None else rests.temperature - ZERO_CELSIUS
    return Member(
        session=_name(observed.session),
        log_sha256=observed.sha256,
        rests=len(rests),
        turns=0 if turns is None else int((turns.duration > 0.0).sum()),
        temperatures=(float(celsius.min()), float(celsius.max())),
        date=observed.circumstances.date,
    )


def _with_own(member: Member, own: OwnEstimate | None, s: int) -> Member:
    """A session with what it, the number s, has of its own."""
    if own is None:
        return member
    learned = np.clip(1.0 - (own.u[s] / own.priors) ** 2, 0.0, 1.0)
    numbers = np.column_stack([own.values[s], own.u[s], own.priors, learned]).tolist()
    parameters = tuple(
        Parameter(name=name, value=value, u=u, unit=unit, prior=prior, learned=part)
        for name, unit, (value, u, prior, part) in zip(own.names, own.units, numbers, strict=True)
    )
    return replace(member, parameters=parameters)


def _notes(member: Member, observations: Observations) -> Iterator[str]:
    """What there is to say of a session."""
    turns, rests = observations.turns, observations.rests
    if turns is None or not (turns.duration > 0.0).any():
        parts = f", taken in {len(rests)} parts" if len(rests) > 1 else ""
        yield (
            f"{member.session}: nothing is turned{parts}: it says how the biases that gravity and the Earth's rate "
            "show in this position change with temperature, and of scale factors nothing"
        )


def _with_scatter(outcome: Outcome, estimate: Estimate) -> Outcome:
    """The outcome with a remark where the noise within rests explains the residuals of each session, but not those of
    all."""
    total = estimate.fits["noise within rests"]
    if total.probability >= SELDOM or outcome.reasons or outcome.remarks:
        return outcome
    units = {
        "accelerometers": (1e-6 * G_STANDARD, "µg"),
        "gyro rests": (DEGREE_PER_HOUR, "°/h"),
        "gyro turns": (DEGREE, "°"),
        "velocities of turns": (1e-3, "mm/s"),
    }
    found = [
        f"{name} by {fit.scatter / units[name][0]:.2g} {units[name][1]}"
        for name, fit in estimate.fits.items()
        if name in units and fit.scatter > 0.0
    ]
    said = (
        f"residuals are larger than the noise within rests: {', '.join(found)} beyond it; u contains it as far as it is"
    )
    return replace(outcome, remarks=(*outcome.remarks, f"{said} random"))
