"""What changes during a session: drift, warm-up after power-on, and biases that jump once."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from tumble.estimation.causes.cause import UNITS, WORDS, Candidate
from tumble.estimation.causes.linearised_session import PATH_STEPS, LinearisedSession, kinds

FEWEST_BESIDE = 2
"""Rests on either side of a jump: one alone with another bias is a rest that does not fit."""
WARM_UP_SHARES = (0.1, 0.3)
"""Time constants of a warm-up that are tried, in parts of the session."""


def over_time(session: LinearisedSession) -> Iterator[Candidate]:
    """Drift, beyond what its prior allows for, and warm-up."""
    at_rest, in_turn, _ = (values[:, 0] for values in session.problem.variables["time"])
    span = max(float(np.ptp(at_rest)), 1.0)
    rows = session.linearised.rows
    for kind, block in kinds(session):
        words, wide, steps = WORDS[kind], np.ones(block.size), np.ones((1, PATH_STEPS, block.size))
        for what, unit in (("bias", UNITS[kind]), ("scale", (1e-6, "ppm"))):
            own = session.problem.instrument.group_columns(f"{kind}.{what}")
            yield Candidate(
                name="drift",
                concerns=kind,
                rest=rows.rest[:, :, 4:-1][:, :, own] * (at_rest / span)[:, None, None],
                turn=rows.turn[:, :, 7:-1][:, :, own] * (in_turn / span)[:, None, None],
                unit=unit,
                sentence=f"{what} of the {words} drifts by {{size}} over the session: let the device warm up, or make "
                "the session shorter",
            )
        for share in WARM_UP_SHARES:
            x, z = (np.exp(-(t - at_rest.min()) / (share * span)) for t in (at_rest, in_turn))
            rest, turn = session.biased(kind, np.outer(x, wide), z[:, None, None] * steps)
            yield Candidate(
                name="warm-up",
                concerns=kind,
                rest=rest,
                turn=turn,
                unit=UNITS[kind],
                sentence=f"biases of the {words} settle by {{size}} after the start, in about {share * span:.0f} s: "
                "switch on earlier, or leave the first rests out",
            )


def jumps(session: LinearisedSession) -> Iterator[Candidate]:
    """Biases of a kind of sensors that change between two rests, as where a driver measures them anew or another device
    goes on; the turn between is taken as lying half before and half after it."""
    rests = session.observations.rests
    at_rest, in_turn, _ = (values[:, 0] for values in session.problem.variables["time"])
    for last in range(FEWEST_BESIDE - 1, len(rests) - FEWEST_BESIDE):
        jump = 0.5 * (at_rest[last] + at_rest[last + 1])
        x, z = (0.5 * (1.0 + np.sign(t - jump)) for t in (at_rest, in_turn))
        between = np.abs(in_turn - jump) < 0.5 * (at_rest[last + 1] - at_rest[last])
        z = np.where(between, 0.5, z)
        for kind, block in kinds(session):
            wide, steps = np.ones(block.size), np.ones((1, PATH_STEPS, block.size))
            rest, turn = session.biased(kind, np.outer(x, wide), z[:, None, None] * steps)
            yield Candidate(
                name="jump",
                concerns=kind,
                rest=rest,
                turn=turn,
                unit=UNITS[kind],
                sentence=f"biases of the {WORDS[kind]} jump by {{size}} after rest {last + 1} "
                f"({rests.start[last]:z.1f}–{rests.stop[last]:z.1f} s), as of a driver that measures them anew or of "
                "another device: calibrate what is before and what is after as launches, each with the times of the "
                "other in [[exclude]]",
            )
