"""Biases that jump once during a session. What drifts or settles is in the processes of the biases."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from tumble.diagnosis.causes.cause import UNITS, WORDS, Candidate
from tumble.diagnosis.causes.linearised_session import PATH_STEPS, LinearisedSession, kinds
from tumble.diagnosis.causes.projection import Remaining
from tumble.inference.hyperparameters import Components
from tumble.inference.step import Step
from tumble.units import Array

FEWEST_BESIDE = 2
"""Rests on either side of a jump: one alone with another bias is a rest that does not fit."""
FREE = 0.01
"""Of the variance of a step of a process: the data say nothing of one of which they leave more than 1 − FREE."""


def jumps(session: LinearisedSession) -> Iterator[Candidate]:
    """Biases of a kind of sensors that change between two rests, as where a driver measures them anew or another device
    goes on; the turn between is taken as lying half before and half after it. They do so where their process, had it
    all scatter of the rests and lasted as long as the session, would step by the most beside its usual steps."""
    rests, before_turn, first = session.observations.rests, session.problem.before_turn, 0
    components, longest = session.linearised.components, max(float(np.ptp(rests.start)), 1.0)
    wandering = Components(
        accel_in_run=float(np.hypot(components.accel, components.accel_in_run)),
        gyro_in_run=float(np.hypot(components.gyro, components.gyro_in_run)),
        accel_time=longest,
        gyro_time=longest,
    )
    if not wandering.wanders:
        return
    step = Remaining.of(session.linearised, wandering).step
    N, most = len(rests), max(part.rests.stop - part.rests.start for part in session.problem.parts)
    for kind, block in kinds(session):
        falls = _falls(step, slice(first, first + block.size))
        first += block.size
        after, sentences = np.zeros(N), list[str]()
        in_turn = np.zeros(len(before_turn))
        for part in session.problem.parts:
            places = np.arange(part.rests.start + FEWEST_BESIDE - 1, part.rests.stop - FEWEST_BESIDE)
            if not len(places) or falls[places].max() <= 0.0:
                sentences.append("")
                continue
            last = int(places[np.argmax(falls[places])])
            after[last + 1 : part.rests.stop] = 1.0
            turns = np.arange(part.turns.start, part.turns.stop)
            in_turn[turns] = 0.5 * (1.0 + np.sign(before_turn[turns] - last))
            sentences.append(
                f"biases of the {WORDS[kind]} jump by {{size}} after "
                f"{session.observations.rest_named(last).rpartition(': ')[2]} "
                f"({rests.start[last]:z.1f}–{rests.stop[last]:z.1f} s), as of a driver that measures them anew or of "
                "another device: calibrate what is before and what is after as launches, each with the times of the "
                "other in [[exclude]]"
            )
        wide, steps = np.ones(block.size), np.ones((1, PATH_STEPS, block.size))
        rest, turn = session.biased(kind, np.outer(after, wide), in_turn[:, None, None] * steps)
        yield Candidate(
            name="jump",
            concerns=kind,
            rest=rest,
            turn=turn,
            unit=UNITS[kind],
            sentences=tuple(sentences),
            tried=max(1, most - 2 * FEWEST_BESIDE + 1),
        )


def _falls(step: Step, sensors: slice) -> Array:
    """By how much chi-square falls (N,) without the step of the processes of some sensors after each rest; 0 where none
    follows, or where the data say nothing of it."""
    process = step.told.process
    assert process is not None
    n = len(process.sigma)
    own = step.shared[0][:, :, -n:, -n:][:, :, sensors, sensors]
    values, rho = step.unknowns[:, -n:][:, sensors], process.rho[:, sensors]
    here, following, across = own[0, :-1], own[0, 1:], own[1, :-1] * rho[:-1, :, None]
    deviation = process.deviation[:-1, sensors]
    steps = (values[1:] - rho[:-1] * values[:-1]) / deviation
    covariance = following - across - np.swapaxes(across, 1, 2) + rho[:-1, :, None] * here * rho[:-1, None]
    covariance /= deviation[:, :, None] * deviation[:, None]
    told, directions = np.linalg.eigh(np.eye(covariance.shape[1]) - covariance)
    along = (steps[:, None] @ directions)[:, 0]
    fall = np.where(told > FREE, along**2 / np.maximum(told, FREE), 0.0).sum(axis=1)
    return np.append(np.where(process.follows[:-1], fall, 0.0), 0.0)
