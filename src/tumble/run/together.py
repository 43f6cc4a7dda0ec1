"""Several sessions of one device over temperature as one estimate.

Parameters and their temperature coefficients are common to all sessions. Each session has its own attitudes, and its
own changes of the biases from launch to launch and drifts, both with priors. A session without turns determines only
the changes of the biases with its temperature.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from tumble.advice import Advised, prefixed
from tumble.arguments import checked
from tumble.errors import InputError
from tumble.files import FilePath
from tumble.inference.estimate import Outcome
from tumble.recording.log import Log
from tumble.recording.session import Session, Site
from tumble.recording.session_file import session_from
from tumble.reduction.observations import Observations, join_sessions
from tumble.result.calibration import Calibration
from tumble.result.parts import Member
from tumble.run.calibrate import Options, assumptions, estimate_observations, prepared
from tumble.run.from_estimate import assemble, build_calibration, origin_of, parameters_of
from tumble.run.launches import check_recordings, joint_circumstances
from tumble.run.observed import Progress, inspect_session, observations_for_calibration, observations_in_parts
from tumble.sensors.frames import Frame
from tumble.units import DEGREE, ZERO_CELSIUS, IntArray

SAME_GRAVITY = 1e-6  # m/s²
SAME_LATITUDE = 1e-9  # rad


@checked
def calibrate_together(
    sessions: Sequence[Session | FilePath], *, frame: Frame = "accelerometer", progress: Progress = Log.chunks
) -> Calibration:
    """Calibrate a device over temperature from several sessions in one estimate, by the method joint.

    Parameters and their coefficients over temperature are common to all sessions; attitudes, and the part of the biases
    that changes from launch to launch, are estimated for each session. Sessions at constant temperatures, temperature
    ramps and long recordings in one position can be combined.

    Parameters
    ----------
    sessions
        Two or more sessions of the device, or the paths of their folders.
    frame
        Frame of the result: `accelerometer`, `paper` or `symmetric`.
    progress
        See `calibrate`.

    Raises
    ------
    InputError
        If there are fewer than two sessions, if they differ in device, place or sensors, if one log is given twice, or
        if a session has no temperatures, or no rests but motion.

    Examples
    --------
    >>> import tumble
    >>> folders = [tumble.simulate_session(f"level-{i}", tumble.Setup.of(positions=12), seed=i) for i in (1, 2)]
    >>> tumble.calibrate_together(folders)
    Traceback (most recent call last):
    ...
    tumble.errors.InputError: level-1: expected temperatures in every session, found no [log.temperature]; names in
    [ ] are tables of session.toml; for arrays use the argument of that name without unit, or tumble.session_of
    """
    if len(sessions) < 2:
        raise InputError(f"sessions: expected two or more for one estimate, found {len(sessions)}")
    if frame == "case":
        raise InputError("frame: expected accelerometer, paper or symmetric of several sessions, found 'case'")
    described = [session_from(session).of_known_scales() for session in sessions]
    _check_alike(described)
    recorded = [inspect_session(session, progress=progress) for session in described]
    names = [Path(session.name).name or session.name for session in described]
    first = replace(described[0], programme=None)
    digests = [observed.sha256 for observed in recorded]
    circumstances = joint_circumstances([observed.circumstances for observed in recorded])
    provenance = origin_of(*digests) | {"circumstances": circumstances}
    parts, faults = list[tuple[Observations, IntArray]](), list[str]()
    for name, observed in zip(names, recorded, strict=True):
        part = observations_in_parts(observed)
        if not isinstance(part, Outcome):
            parts.append(part)
        elif isinstance(observations_for_calibration(observed, joint=True), Outcome):
            faults += [prefixed(f"{name}: ", reason) for reason in part.reasons]
        else:
            raise InputError(
                f"{name}: expected rests, found a device in motion; calibrate such sessions as launches, without "
                "--together: the result is their mean"
            )
    if faults:
        return assemble(first, "joint", Outcome(reasons=tuple(faults)), provenance)
    check_recordings(described, digests)
    members = list[Member]()
    for session, name, digest, observed, (observations, _) in zip(
        described, names, digests, recorded, parts, strict=True
    ):
        kelvin, turns = observations.rests.temperature, observations.turns
        if kelvin is None:
            raise InputError(f"{session.name}: expected temperatures in the log, found none that are numbers")
        members.append(
            Member(
                session=name,
                log_sha256=digest,
                rests=len(observations.rests),
                turns=0 if turns is None else int((turns.duration > 0.0).sum()),
                temperatures=(float(kelvin.min()) - ZERO_CELSIUS, float(kelvin.max()) - ZERO_CELSIUS),
                date=observed.circumstances.date,
            )
        )
    # all clocks have one common error, with the largest u of the sessions with turns
    turned = [session.log for session, member in zip(described, members, strict=True) if member.turns]
    clock = max(turned or [session.log for session in described], key=lambda log: log.time_base_u)
    first = replace(first, log=replace(first.log, clock_u=clock.clock_u))
    options = Options(frame=frame)
    result = estimate_observations(first, prepared(first, _joined(described, members, parts), options), options)
    if isinstance(result, Outcome):
        return assemble(first, "joint", result, provenance)
    calibration = build_calibration(first, *result, frame, provenance | assumptions(first))
    if (own := result[0].own) is not None:
        for i, (values, u) in enumerate(zip(own.values, own.u, strict=True)):
            parameters = parameters_of(own.names, values, u, unit=own.units, prior=own.priors.tolist())
            members[i] = replace(members[i], parameters=parameters)
    return replace(calibration, evidence=replace(calibration.evidence, together=tuple(members)))


def _joined(
    sessions: Sequence[Session], members: Sequence[Member], parts: Sequence[tuple[Observations, IntArray]]
) -> Observations:
    """Return the observations of all sessions, with notes on those that are not turned and on magnetometers."""
    observations, numbers = zip(*parts, strict=True)
    joined = join_sessions(observations, [member.session for member in members], numbers)
    notes = list(joined.notes)
    if any(session.log.magnetometer is not None for session in sessions):
        note = "magnetometer: several sessions in one estimate leave it out"
        notes.append(Advised(note, "calibrate one alone for hard and soft iron"))
    for member in members:
        if not member.turns:
            taken = f", taken in {member.rests} parts" if member.rests > 1 else ""
            notes.append(
                f"{member.session}: nothing is turned{taken}: it shows how biases in this position change with "
                "temperature, but not scale factors"
            )
    return replace(joined, notes=tuple(notes))


def _check_alike(sessions: Sequence[Session]) -> None:
    """Raise InputError if sessions differ from the first in device, place or sensors, or have no temperatures."""

    def sensors(session: Session) -> list[Any]:
        blocks = (block for block in (session.accel_block, session.gyro_block) if block is not None)
        return [(block.kind, block.axes.round(9).tolist(), block.thermometer.tolist()) for block in blocks]

    def place(site: Site) -> str:
        latitude = "no latitude" if site.latitude is None else f"latitude {site.latitude / DEGREE:.6g}°"
        return f"{latitude} and gravity {site.gravity:.6f} m/s^2"

    first = sessions[0]
    for session in sessions:
        if session.log.temperature is None:
            raise InputError(f"{session.name}: expected temperatures in every session, found no [log.temperature]")
        serials, (site, other) = [each.device.serial for each in (first, session)], (first.site, session.site)
        nowhere = (site.latitude is None) == (other.latitude is None)
        same_place = nowhere and abs((site.latitude or 0.0) - (other.latitude or 0.0)) < SAME_LATITUDE
        expected = {
            f"the device {serials[0]!r} of the first session, found {serials[1]!r}; calibrate each device by itself": (
                serials[0] == serials[1]
            ),
            "the sensors and thermometers of the first session, found others; list them alike": (
                sensors(session) == sensors(first)
            ),
            f"the place of the first session, {place(site)}, found {place(other)}; give the same [site]": (
                same_place and abs(site.gravity - other.gravity) < SAME_GRAVITY
            ),
        }
        for sentence, holds in expected.items():
            if not holds:
                raise InputError(f"{session.name}: expected {sentence}")
