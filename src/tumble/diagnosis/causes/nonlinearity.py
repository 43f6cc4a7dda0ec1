"""Readings that are not linear in force and rate, beyond what the instrument of the estimate has."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from tumble.diagnosis.causes.cause import UNITS, WORDS, Candidate
from tumble.diagnosis.causes.linearised_session import SHORTEST_TURN, LinearisedSession, kinds
from tumble.inference.turns_about import TurnsAbout
from tumble.sensors.instrument import functions
from tumble.sensors.model import Block
from tumble.sensors.parameters import PAIRS, PRODUCTS, RATE
from tumble.units import DEGREE, G_STANDARD


def products(session: LinearisedSession) -> Iterator[Candidate]:
    """Products of forces that no group of the instrument has: cross products in accelerometers, all in gyros."""
    about = session.linearised.about
    for kind, block in kinds(session):
        first = 0 if kind == "accel" else session.accel.size
        chosen = [b for b, pair in enumerate(PAIRS, start=PRODUCTS.start) if pair[0] != pair[1] or kind == "gyro"]
        beta = functions(block, session.force, session.rate)[:, 0, chosen]
        q = block.size * len(chosen)
        rest, turn = session.nothing(q)
        rest[:, first : first + block.size] = np.einsum("nb,ps->npsb", beta, np.eye(block.size)).reshape(
            len(rest), block.size, q
        )
        if about is not None:
            if kind == "accel":
                session.put_velocity(turn, about.by_force[..., chosen].reshape(len(turn), 3, q))
            else:
                turn[:, :3] = about.by_phi[..., chosen].reshape(len(turn), 3, q)
        size, name = UNITS[kind]
        yield Candidate(
            name="cross products" if kind == "accel" else "g² sensitivity",
            concerns=kind,
            rest=rest,
            turn=turn,
            unit=(size / G_STANDARD**2, f"{name}/g²"),
            sentences=(
                f"{WORDS[kind]} that read products of forces, by {{size}}: more oblique rests, or use it near the "
                "attitudes of the session",
            ),
        )


def gyro_nonlinearity(session: LinearisedSession, about: TurnsAbout, gyro: Block) -> Candidate:
    """Scale factors with the square of the rate, of an estimate that has no such parameters."""
    n = gyro.size
    duration = np.maximum(about.moments.T, SHORTEST_TURN)[:, None]
    square = about.moments.body_rates[:, [0, 3, 5]] / duration @ (gyro.axes**2).T
    rest, turn = session.nothing(n)
    phi, V = (
        np.einsum("kipb,pb,kp->kip", by[..., RATE], gyro.axes, square) for by in (about.by_phi, about.by_velocity)
    )
    turn[:, :3] = phi
    session.put_velocity(turn, V)
    return Candidate(
        name="gyro nonlinearity",
        concerns="gyro",
        rest=rest,
        turn=turn,
        unit=(1e-6 / (10.0 * DEGREE) ** 2, "ppm at 10 °/s"),
        sentences=(
            "scale factors of the gyros that depend on the rate, by {size}: turn at the rates of use, at one rate, or "
            "make them parameters by gyro_cubic in [device.prior]",
        ),
    )
