"""Several sessions of one device over temperature as one estimate.

The parameters and how they change with temperature are common; attitudes are those of each rest, and biases are each
session's own by what differs from launch to launch and drifts in a session, both with priors. A session in which
nothing is turned says how biases change with its temperature and nothing else.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from tumble.errors import InputError
from tumble.files import FilePath
from tumble.inference.estimate import Estimate, Outcome, OwnEstimate
from tumble.inference.joint import joint
from tumble.recording.log import Log
from tumble.recording.rows.gaps import Gap
from tumble.recording.session import Session
from tumble.recording.session_file import session_from
from tumble.reduction.observations import Observations
from tumble.reduction.together import joined
from tumble.result.calibration import Calibration
from tumble.result.parts import Member, Parameter
from tumble.run.calibrate import estimated, provenance_of, systematic_of
from tumble.run.from_estimate import result_of, without_result
from tumble.run.launches import circumstances_of_all
from tumble.run.observed import Progress, inspect_session, observations_in_parts
from tumble.run.same_recording import Means, check_recordings
from tumble.sensors.frames import Frame
from tumble.sensors.model import Block
from tumble.units import DEGREE, DEGREE_PER_HOUR, G_STANDARD, ZERO_CELSIUS, IntArray

SAME_GRAVITY = 1e-6  # m/s²
SAME_LATITUDE = 1e-9  # rad
SELDOM = 1e-3
"""Residuals are more than noise where chance alone would make them so large less often."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _ReducedSession:
    """A session, the SHA-256 of its log, its gaps, what is left of it, and when it was recorded."""

    session: Session
    sha256: str
    gaps: tuple[Gap, ...]
    observations: Observations
    numbers: IntArray
    date: str | None

    @property
    def name(self) -> str:
        return Path(self.session.name).name or self.session.name


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
    systematic, reduced, faults = systematic_of(described[0]), list[_ReducedSession](), list[str]()
    circumstances = []
    for session in described:
        seen = inspect_session(session, progress=progress)
        circumstances.append(seen.circumstances)
        found = observations_in_parts(seen)
        if isinstance(found, Outcome):
            faults += [f"{Path(session.name).name}: {reason}" for reason in found.reasons]
            continue
        observations, numbers = found
        reduced.append(
            _ReducedSession(
                session=session,
                sha256=seen.sha256,
                gaps=seen.gaps,
                observations=observations,
                numbers=numbers,
                date=seen.circumstances.date,
            )
        )
    provenance = provenance_of(_digest(reduced))
    if faults:
        return without_result(described[0], "joint", Outcome(reasons=tuple(faults)), provenance)
    _check_logs(reduced)
    whole = joined([each.observations for each in reduced], _names(reduced), [each.numbers for each in reduced])
    estimate = estimated(described[0], whole, joint, systematic, "full")
    if isinstance(estimate, Outcome):
        return without_result(described[0], "joint", estimate, provenance)
    made = result_of(described[0], *estimate, systematic, frame, provenance)
    notes = (*made.notes, *(note for each in reduced for note in _notes(each)))
    return replace(
        made,
        outcome=_with_scatter(made.outcome, estimate[0]),
        circumstances=circumstances_of_all(circumstances),
        notes=notes,
        together=tuple(_members(reduced, estimate[0].own)),
    )


def _names(reduced: Sequence[_ReducedSession]) -> list[str]:
    return [each.name for each in reduced]


def _digest(reduced: Sequence[_ReducedSession]) -> str:
    """The SHA-256 of those of all logs."""
    return hashlib.sha256("\n".join(each.sha256 for each in reduced).encode()).hexdigest()


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
    latitudes = a.latitude is b.latitude if None in (a.latitude, b.latitude) else _near(a.latitude, b.latitude)
    return latitudes and abs(a.gravity - b.gravity) < SAME_GRAVITY


def _near(a: float | None, b: float | None) -> bool:
    return a is not None and b is not None and abs(a - b) < SAME_LATITUDE


def _place(session: Session) -> str:
    latitude = session.site.latitude
    said = "no latitude" if latitude is None else f"latitude {latitude / DEGREE:.6g}°"
    return f"{said} and gravity {session.site.gravity:.6f} m/s^2"


def _check_logs(reduced: Sequence[_ReducedSession]) -> None:
    check_recordings([(each.session.name, each.sha256, _means(each.observations)) for each in reduced])
    for each in reduced:
        if each.observations.rests.temperature is None:
            raise InputError(f"{each.session.name}: expected temperatures in the log, found none that are numbers")


def _means(observations: Observations) -> Means:
    """What the sensors read in the rests of a session."""
    rests = observations.rests
    variances = [np.diagonal(C, axis1=1, axis2=2) for C in (rests.accel_covariance, rests.gyro_covariance)]
    return np.hstack([rests.accel, rests.gyro]), np.sqrt(np.hstack(variances))


# What is said


def _members(reduced: Sequence[_ReducedSession], own: OwnEstimate | None) -> Iterator[Member]:
    """The sessions with what each has of its own."""
    for s, each in enumerate(reduced):
        rests, turns = each.observations.rests, each.observations.turns
        assert rests.temperature is not None
        low, high = rests.temperature.min() - ZERO_CELSIUS, rests.temperature.max() - ZERO_CELSIUS
        parameters = () if own is None else zip(own.names, own.units, own.values[s], own.u[s], own.priors, strict=True)
        yield Member(
            session=each.name,
            log_sha256=each.sha256,
            rests=len(rests),
            turns=0 if turns is None else int((turns.duration > 0.0).sum()),
            temperatures=(float(low), float(high)),
            parameters=tuple(
                Parameter(
                    name=name,
                    value=float(value),
                    u=float(u),
                    unit=unit,
                    prior=float(prior),
                    learned=float(np.clip(1.0 - (u / prior) ** 2, 0.0, 1.0)),
                )
                for name, unit, value, u, prior in parameters
            ),
            date=each.date,
        )


def _notes(each: _ReducedSession) -> Iterator[str]:
    """What there is to say of a session."""
    turns, rests = each.observations.turns, each.observations.rests
    if turns is None or not (turns.duration > 0.0).any():
        parts = f", taken in {len(rests)} parts" if len(rests) > 1 else ""
        yield (
            f"{each.name}: nothing is turned{parts}: it says how the biases that gravity and the Earth's rate show in "
            "this position change with temperature, and of scale factors nothing"
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
