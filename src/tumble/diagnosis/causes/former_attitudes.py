"""Accelerometers and gyros that read where they come from: hysteresis, and a memory that fades."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from tumble.diagnosis.causes.cause import UNITS, WORDS, Candidate
from tumble.diagnosis.causes.linearised_session import PATH_STEPS, LinearisedSession, kinds
from tumble.sensors.model import Block
from tumble.units import G_STANDARD, Array

MEMORIES = (10.0, 60.0, 300.0)
"""Time constants of a memory that are tried, s."""

PLAY = 0.05 * G_STANDARD
"""Half the width of the play of a hysteresis: a change of the own force by twice as much takes it across."""


def hysteresis(session: LinearisedSession) -> Candidate:
    """Readings of the accelerometers that depend on the sign of the last change of the own force."""
    at_rest, in_turn = _played(session)
    rest, turn = session.biased("accel", at_rest, in_turn)
    return Candidate(
        name="hysteresis",
        concerns="accel",
        rest=rest,
        turn=turn,
        unit=UNITS["accel"],
        sentences=(
            "hysteresis of the accelerometers of {size}, by the sign of the last change of the own force: come to each "
            "position from both sides",
        ),
    )


def _played(session: LinearisedSession) -> tuple[Array, Array]:
    """Where in its play, −1 … 1, the own force of each accelerometer is at rest (N, n) and on the way of the turns
    (K, steps, n)."""
    axes, link = session.accel.axes, session.problem.link
    own, paths = session.force @ axes.T, session.paths @ axes.T
    at_rest, in_turn = np.zeros_like(own), np.zeros_like(paths)
    middle = own[0].copy()
    for i, here in enumerate(own):
        middle = here if i in session.begins else middle
        middle = np.clip(middle, here - PLAY, here + PLAY)
        at_rest[i] = (here - middle) / PLAY
        if (k := link[i]) >= 0:
            for j, step in enumerate(paths[k]):
                middle = np.clip(middle, step - PLAY, step + PLAY)
                in_turn[k, j] = (step - middle) / PLAY
    return at_rest, in_turn


def memory(session: LinearisedSession) -> Iterator[Candidate]:
    """Readings that follow the own force with time constants of tens of seconds to minutes."""
    for kind, block in kinds(session):
        for seconds in MEMORIES:
            at_rest, in_turn = _remembered(session, block, seconds)
            rest, turn = session.biased(kind, at_rest, in_turn)
            size, name = UNITS[kind]
            yield Candidate(
                name="memory",
                concerns=kind,
                rest=rest,
                turn=turn,
                unit=(size / G_STANDARD, f"{name}/g"),
                sentences=(
                    f"{WORDS[kind]} that remember the previous attitude by {{size}} for about {seconds:.0f} s: longer "
                    "rests, of which the beginning is left out",
                ),
            )


def _remembered(session: LinearisedSession, block: Block, seconds: float) -> tuple[Array, Array]:
    """How far the own force, low-pass, is behind: the mean over each rest (N, n) and step of a turn (K, steps, n)."""
    rests, turns, link = session.observations.rests, session.observations.turns, session.problem.link
    own, paths = session.force @ block.axes.T, session.paths @ block.axes.T
    at_rest, in_turn = np.zeros_like(own), np.zeros_like(paths)
    slow = own[0].copy()
    for i, here in enumerate(own):
        slow = here if i in session.begins else slow
        at_rest[i], slow = _relaxed(slow, here, float(rests.stop[i] - rests.start[i]) / seconds)
        if (k := link[i]) >= 0 and turns is not None:
            in_turn[k], slow = _followed(slow, paths[k], float(turns.duration[k]) / PATH_STEPS / seconds)
    return at_rest, in_turn


def _followed(slow: Array, targets: Array, passed: float) -> tuple[Array, Array]:
    """The means of slow − target over steps of a time, in time constants, with a target (n,) each, and slow after them:
    slow_j+1 = target_j + (slow_j − target_j) e^(−t)."""
    steps = len(targets)
    lag = np.arange(steps + 1)[:, None] - np.arange(steps)  # from the end of each step
    left = np.where(lag > 0, np.exp(-passed * np.maximum(lag - 1, 0)), 0.0)
    before = np.exp(-passed * np.arange(steps + 1))[:, None] * slow - np.expm1(-passed) * (left @ targets)
    return (before[:-1] - targets) * _mean_left(passed), before[-1]


def _relaxed(slow: Array, target: Array, passed: float) -> tuple[Array, Array]:
    """The mean of slow − target over a time, in time constants, and slow after it."""
    return (slow - target) * _mean_left(passed), target + (slow - target) * np.exp(-passed)


def _mean_left(passed: float) -> float:
    """The mean of e^(−t) over a time."""
    return float(-np.expm1(-passed) / passed) if passed > 0.0 else 1.0
