"""The likelihood of several sessions about their estimate, each session for itself.

A session alone is its rows with what all others say of the parameters that they have in common: the triangle that is
left of the others once their attitudes and what each has of its own are eliminated. So whatever is asked of one session
(`tumble.estimation.causes`) is answered with the knowledge of all, at a cost that is linear in their number.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields, replace

import numpy as np

from tumble.estimation.turns_about import TurnsAbout
from tumble.inference.hyperparameters import Noise
from tumble.inference.likelihood import Linearised, Problem, Rows
from tumble.inference.session_spans import SessionSpan
from tumble.inference.step import tell, with_own
from tumble.reduction.moments import Moments
from tumble.reduction.together import apart
from tumble.units import Array


def each_session(linearised: Linearised) -> Iterator[Linearised]:
    """Each of one or several sessions, in their order; what it has of its own stands after the common parameters."""
    problem = linearised.problem.warmed(linearised.point)
    if problem.observations.together is None:
        rows = linearised.rows
        yield replace(linearised, rows=_rows(rows, problem.parts[0], rows.prior, 0, problem.own_known))
        return
    triangles, prior = list(_triangles(linearised)), linearised.rows.prior
    for s, part in enumerate(problem.parts):
        others = np.asarray(np.linalg.qr(np.concatenate([prior, *triangles[:s], *triangles[s + 1 :]]), mode="r"))
        alone, point = _problem(problem, part), linearised.point
        yield Linearised(
            problem=alone,
            point=replace(point, attitudes=point.attitudes[part.rests], own=point.own[s : s + 1]),
            about=None if alone.observations.turns is None else _turns(linearised.about, part.turns),
            rows=_rows(linearised.rows, part, others, s, problem.own_known),
            noise=_noise(linearised.noise, part),
            scatter=linearised.scatter,
        )


def _triangles(linearised: Linearised) -> Iterator[Array]:
    """What each session says of gravity and the common parameters, (1 + m + 1, 1 + m + 1)."""
    problem, rows = linearised.problem, linearised.rows
    told, q = tell(problem, rows, linearised.noise.weights(linearised.scatter)), len(problem.own_known)
    for session, residual in zip(told.sessions, rows.own, strict=True):
        yield with_own(problem, session, residual)[q:, q:]


def _problem(problem: Problem, part: SessionSpan) -> Problem:
    """The problem of a session alone, with the parameters of all."""
    N, K = len(part.link), part.turns.stop - part.turns.start
    none = np.zeros(N, dtype=np.int64)
    single = SessionSpan(rests=slice(0, N), turns=slice(0, K), link=part.link)
    variables, by_lag = (
        {name: (rest[part.rests], turn[part.turns], grows[part.turns]) for name, (rest, turn, grows) in of.items()}
        for of in (problem.variables, problem.by_lag)
    )
    return replace(
        problem,
        observations=apart(problem.observations, part.rests, part.turns),
        link=part.link,
        chain=np.append(0, np.cumsum(part.link[:-1] < 0)),
        variables=variables,
        by_lag=by_lag,
        parts=(single,),
        of_session=(none, none[:1].repeat(K)),
    )


def _rows(rows: Rows, part: SessionSpan, others: Array, s: int, own_known: Array) -> Rows:
    """The rows of a session, those of the others as its prior, and of what it has of its own that as well."""
    p, q = len(others) - 1, len(own_known)
    prior = np.zeros((p + q + 1, p + q + 1))
    prior[:p, :p], prior[:p, -1] = others[:p, :p], others[:p, -1]
    prior[np.arange(p, p + q), np.arange(p, p + q)], prior[p : p + q, -1] = 1.0 / own_known, rows.own[s]
    return Rows(
        rest=rows.rest[part.rests],
        turn=rows.turn[part.turns],
        prior=prior,
        bias=rows.bias[part.turns],
        gained=rows.gained[part.turns],
    )


def _turns(about: TurnsAbout | None, some: slice) -> TurnsAbout | None:
    """Some of the turns."""
    if about is None:
        return None
    in_motion = {motion: by[some] for motion, by in about.in_motion.items()}
    moments = Moments(**{field.name: getattr(about.moments, field.name)[some] for field in fields(Moments)})
    return replace(
        about,
        coefficients=about.coefficients if about.coefficients.ndim == 2 else about.coefficients[some],
        moments=moments,
        paths=about.paths[some],
        in_motion=in_motion,
        growing=None if about.growing is None else about.growing[some],
    )


def _noise(noise: Noise, part: SessionSpan) -> Noise:
    """The noise of the rows of a session."""
    return Noise(
        rest=noise.rest[part.rests],
        merged=noise.merged[part.turns],
        rest_directions=(noise.rest_directions[0][part.rests], noise.rest_directions[1]),
        merged_directions=(noise.merged_directions[0][part.turns], noise.merged_directions[1]),
    )
