"""What may be behind residuals that the noise does not explain, the most likely first.

All is tested at the linearisation of the estimate, without solving again (dynamics method, Eq. (11)). With the whitened
rows A of all unknowns, their residuals e and the whitened columns A_c of a candidate cause,

    B = A_c − Q Qᵀ A_c,    ĉ = (BᵀB)⁻¹ Bᵀe,    Δχ² = eᵀ B ĉ,    Δθ = −A⁺ A_c ĉ                                    (11)

Q being an orthonormal basis of what A spans. Δχ² is judged as chi-square of q degrees of freedom by the noise alone,
and, where scatter was estimated from the same residuals, by F = (Δχ²/q) / ((χ² − Δχ²)/(ν − q)) too: of few degrees of
freedom a scatter may be had by chance, and what is left beside a cause be nothing.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from tumble.estimation.causes.cause import Candidate, Cause, tested
from tumble.estimation.causes.former_attitudes import hysteresis, memory
from tumble.estimation.causes.latitude import latitude_error
from tumble.estimation.causes.linearised_session import LinearisedSession
from tumble.estimation.causes.lost_samples import lost_samples
from tumble.estimation.causes.neighbouring_rests import Neighbours
from tumble.estimation.causes.nonlinearity import gyro_nonlinearity, products
from tumble.estimation.causes.over_time import jumps, over_time
from tumble.estimation.causes.projection import Projection
from tumble.estimation.causes.quantisation import quantisation
from tumble.inference.likelihood import Linearised


def causes(
    linearised: Linearised, seen_by: tuple[Projection, Projection], alike: tuple[Neighbours, ...] = ()
) -> list[Cause]:
    """All candidates, the most significant first, one of a name and kind of sensor. The first projection is that with
    the noise alone, the second that with the scatter of the estimate too: the same where there is none."""
    session = LinearisedSession(linearised)
    found: dict[tuple[str, str], Cause] = {}
    tried: dict[tuple[str, str], int] = {}
    for candidate in _candidates(session):
        key = candidate.name, candidate.concerns
        tried[key] = tried.get(key, 0) + 1
        cause = tested(candidate, session, seen_by, alike)
        if cause is not None and (key not in found or cause.probability < found[key].probability):
            found[key] = cause
    several = [replace(c, probability=min(1.0, tried[key] * c.probability)) for key, c in found.items()]
    several += quantisation(session)
    several += lost_samples(session, seen_by[1])
    return sorted(several, key=lambda cause: cause.probability)


def _candidates(session: LinearisedSession) -> Iterator[Candidate]:
    """Everything that is tried."""
    yield from over_time(session)
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
