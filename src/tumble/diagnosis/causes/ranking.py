"""What may be behind residuals that the noise does not explain, of each session the most likely first.

All is tested at the linearisation of the estimate, without solving again (`tumble.diagnosis.causes.projection`). A
fall of chi-square Δχ² is judged as chi-square of q degrees of freedom by the noise alone, and by
F = (Δχ²/q) / ((χ² − Δχ²)/(ν − q)) with the components of variance of the estimate too: of few degrees of freedom a
scatter may be had by chance, and what is left beside a cause be nothing.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from tumble.diagnosis.causes.cause import Candidate, Cause
from tumble.diagnosis.causes.former_attitudes import hysteresis, memory
from tumble.diagnosis.causes.latitude import latitude_error
from tumble.diagnosis.causes.linearised_session import LinearisedSession
from tumble.diagnosis.causes.lost_samples import lost_in_a_turn, lost_in_all_turns, samples_held, turns_to_blame
from tumble.diagnosis.causes.nonlinearity import gyro_nonlinearity, products
from tumble.diagnosis.causes.over_time import jumps
from tumble.diagnosis.causes.projection import Projection, Remaining, projections
from tumble.diagnosis.causes.quantisation import quantisation
from tumble.inference.hyperparameters import Components
from tumble.inference.likelihood import Linearised
from tumble.units import Array


def causes(linearised: Linearised, alone: Remaining, whole: Remaining) -> list[list[Cause]]:
    """Of each session all causes, the most significant first, one of a name and kind of sensor, by what is left of the
    residuals with the noise alone and with the components of variance of the estimate."""
    session = LinearisedSession(linearised)
    found, us = tested(linearised, list(_candidates(session, whole)))
    blamed = turns_to_blame(linearised, alone) if session.turned else whole
    for s, (own, u) in enumerate(zip(found, us, strict=True)):
        own += quantisation(session, s)
        held = samples_held(session.observed[s])
        if held is not None:
            own[:] = [cause for cause in own if cause.name != held.name] + [held]
        elif session.turned_in(s):
            lost = [cause for cause in own if cause.name == "lost samples"]
            lost.append(lost_in_all_turns(session, s, blamed, u))
            most = min(lost, key=lambda cause: cause.probability)
            own[:] = [cause for cause in own if cause not in lost] + [most]
        own.sort(key=lambda cause: cause.probability)
    return found


def tested(linearised: Linearised, candidates: Sequence[Candidate]) -> tuple[list[list[Cause]], list[Array]]:
    """Of each session all candidates that it sees, one of a name and kind of sensor, and u of the parameters (m,)."""
    rest, turn = (np.concatenate([getattr(c, rows) for c in candidates], axis=2) for rows in ("rest", "turn"))
    ends = np.cumsum([c.rest.shape[2] for c in candidates])
    places = [slice(end - c.rest.shape[2], end) for c, end in zip(candidates, ends.tolist(), strict=True)]
    linear = linearised.problem.instrument.linear_count
    whole = list(projections(linearised, linearised.components, rest, turn))
    alone = projections(linearised, Components(), rest, turn) if whole[0].scatters else whole
    found = [_most_likely(candidates, places, s, both, linear) for s, both in enumerate(zip(alone, whole, strict=True))]
    return found, [each.u for each in whole]


def _most_likely(
    candidates: Sequence[Candidate], places: list[slice], s: int, seen_by: tuple[Projection, Projection], linear: int
) -> list[Cause]:
    """Of the candidates of each name and kind the most likely, with its probability as that of one of many."""
    best, tried = dict[tuple[str, str], Cause](), dict[tuple[str, str], int]()
    for candidate, some in zip(candidates, places, strict=True):
        key = candidate.name, candidate.concerns
        tried[key] = tried.get(key, 0) + candidate.tried
        cause = candidate.tested(s, some, *seen_by, linear)
        if cause is not None and (key not in best or cause.probability < best[key].probability):
            best[key] = cause
    return [replace(cause, probability=min(1.0, tried[key] * cause.probability)) for key, cause in best.items()]


def _candidates(session: LinearisedSession, whole: Remaining) -> Iterator[Candidate]:
    """Everything that is tried by columns."""
    yield from jumps(session)
    yield hysteresis(session)
    yield from memory(session)
    yield from products(session)
    about, gyro = session.linearised.about, session.observations.gyro_block
    modelled = "gyro.cubic" in session.problem.instrument.members
    if session.turned and about is not None and gyro is not None and not modelled:
        yield gyro_nonlinearity(session, about, gyro)
    if gyro is not None and session.observations.site.latitude is not None:
        yield latitude_error(session)
    if session.turned and session.observations.unstamped:
        yield from lost_in_a_turn(session, whole)
