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

import numpy as np

from tumble.advice import Advised, prefixed
from tumble.arguments import checked
from tumble.errors import InputError
from tumble.files import FilePath
from tumble.inference.estimate import Outcome
from tumble.inference.joint import joint
from tumble.recording.log import Log
from tumble.recording.session import Session, Site
from tumble.recording.session_file import session_from
from tumble.reduction.observations import Observations, join_sessions
from tumble.result.calibration import Calibration
from tumble.result.parts import Member, Parameter, learned_fraction
from tumble.run.calibrate import assumptions, estimate_observations, new_provenance, passport_values
from tumble.run.from_estimate import build_calibration, refused_calibration
from tumble.run.launches import check_recordings, joint_circumstances, joint_digest
from tumble.run.observed import Progress, inspect_session, observations_for_calibration, observations_in_parts
from tumble.sensors.frames import Frame
from tumble.units import DEGREE, ZERO_CELSIUS

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
    tumble.errors.InputError: level-1: expected temperatures in every session, found no [log.temperature]; […] is a
    table of session.toml; for arrays use the argument of that name without unit, or tumble.session_of
    """
    if len(sessions) < 2:
        raise InputError(f"sessions: expected two or more for one estimate, found {len(sessions)}")
    if frame == "case":
        raise InputError("frame: expected accelerometer, paper or symmetric of several sessions, found 'case'")
    described = [session_from(session).of_known_scales() for session in sessions]
    _check_alike(described)
    first, systematic = described[0], passport_values(described[0])
    members, observations, numbers = list[Member](), list[Observations](), []
    circumstances, faults = [], []
    for session in described:
        observed = inspect_session(session, progress=progress)
        parts, name = observations_in_parts(observed), Path(session.name).name or session.name
        circumstances.append(observed.circumstances)
        if isinstance(parts, Outcome):
            if not isinstance(observations_for_calibration(observed, joint=True), Outcome):
                raise InputError(
                    f"{name}: expected rests, found a device in motion; calibrate such sessions as launches, without "
                    "--together: the result is their mean"
                )
            faults += [prefixed(f"{name}: ", reason) for reason in parts.reasons]
            continue
        rests, turns = parts[0].rests, parts[0].turns
        celsius = np.full(1, np.nan) if rests.temperature is None else rests.temperature - ZERO_CELSIUS
        observations.append(parts[0])
        numbers.append(parts[1])
        members.append(
            Member(
                session=name,
                log_sha256=observed.sha256,
                rests=len(rests),
                turns=0 if turns is None else int((turns.duration > 0.0).sum()),
                temperatures=(float(celsius.min()), float(celsius.max())),
                date=observed.circumstances.date,
            )
        )
    provenance = new_provenance(joint_digest(member.log_sha256 for member in members))
    if faults:
        return refused_calibration(first, "joint", Outcome(reasons=tuple(faults)), provenance)
    check_recordings(described, [member.log_sha256 for member in members])
    for session, each in zip(described, observations, strict=True):
        if each.rests.temperature is None:
            raise InputError(f"{session.name}: expected temperatures in the log, found none that are numbers")
    joint_observations = join_sessions(observations, [member.session for member in members], numbers)
    # all clocks have one common error, with the largest u of the sessions with turns
    turned = [session.log for session, member in zip(described, members, strict=True) if member.turns]
    clock = max(turned or [session.log for session in described], key=lambda log: log.time_base_u)
    first = replace(first, log=replace(first.log, clock_u=clock.clock_u))
    if any(session.log.magnetometer is not None for session in described):
        note = "magnetometer: several sessions in one estimate leave it out"
        note = Advised(note, "calibrate one alone for hard and soft iron")
        joint_observations = replace(joint_observations, notes=(*joint_observations.notes, note))
    estimate = estimate_observations(first, joint_observations, joint, systematic, "full")
    if isinstance(estimate, Outcome):
        return refused_calibration(first, "joint", estimate, provenance)
    calibration, session_only = build_calibration(first, *estimate, systematic, frame, provenance), estimate[0].own
    if session_only is not None:
        by_session = zip(session_only.values.tolist(), session_only.u.tolist(), strict=True)
        named = list(zip(session_only.names, session_only.units, session_only.priors.tolist(), strict=True))
        members = [
            replace(
                member,
                parameters=tuple(
                    Parameter(name=name, value=x, u=u, unit=unit, prior=prior, learned=learned_fraction(u, prior))
                    for (name, unit, prior), x, u in zip(named, *values_and_u, strict=True)
                ),
            )
            for member, values_and_u in zip(members, by_session, strict=True)
        ]
    return replace(
        calibration,
        evidence=replace(calibration.evidence, together=tuple(members)),
        provenance=replace(
            calibration.provenance,
            circumstances=joint_circumstances(circumstances),
            assumptions=assumptions(first),
            notes=(
                *calibration.provenance.notes,
                *(
                    f"{member.session}: nothing is "
                    f"turned{f', taken in {member.rests} parts' if member.rests > 1 else ''}: it shows how biases in "
                    "this position change with temperature, but not scale factors"
                    for member in members
                    if not member.turns
                ),
            ),
        ),
    )


def _check_alike(sessions: Sequence[Session]) -> None:
    """Raise InputError if sessions differ from the first in device, place or sensors, or have no temperatures."""

    def same(a: float | None, b: float | None, limit: float) -> bool:
        return a is b if a is None or b is None else abs(a - b) < limit

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
        if session.device.serial != first.device.serial:
            raise InputError(
                f"{session.name}: expected the device {first.device.serial!r} of the first session, found "
                f"{session.device.serial!r}; calibrate each device by itself"
            )
        if sensors(session) != sensors(first):
            raise InputError(
                f"{session.name}: expected the sensors and thermometers of the first session, found others; list them "
                "alike"
            )
        site, other = first.site, session.site
        same_latitude = same(other.latitude, site.latitude, SAME_LATITUDE)
        if not (same_latitude and same(other.gravity, site.gravity, SAME_GRAVITY)):
            raise InputError(
                f"{session.name}: expected the place of the first session, {place(site)}, found {place(other)}; give "
                "the same [site]"
            )
