"""Groups of the accelerometers that an estimate of the linear model leaves out, and what they make it err by.

Groups of usual size σ, beyond bias, scale factor and axis angles, add B φ to the readings at rest, B along what no turn
of the vertical reaches. A fit of the linear columns A, with the weights it has, takes A⁺ B φ for parameters:

    ΔX = A⁺ B φ,   cov(ΔX) = A⁺ B Σ (A⁺ B)ᵀ,   cov(ΔX, −φ) = −A⁺ B Σ,   Σ = diag(σ²)

The groups stay at nothing, so that −φ is their error. With it the corrected force in the attitudes of the rests is as
well known as the fit has it, and in others as badly as the groups allow.

This is docs/mathematics.md (36) with usual sizes; the columns are those of Eq. (12) of the turntable paper, for any
number of sensors.
"""

from __future__ import annotations

from collections.abc import Container
from dataclasses import dataclass, replace

import numpy as np

from tumble.inference.estimate import Estimate, GroupFinding
from tumble.inference.likelihood import Problem, instruments_of
from tumble.inference.prediction import prediction
from tumble.reduction.observations import Observations
from tumble.rotation import tangent_basis, unit_vector
from tumble.sensors.instrument import Instrument, functions
from tumble.sensors.parameters import FORCE
from tumble.units import Array

_NOTHING = 1e-9
"""Of the largest singular value: what rests do not determine is moved by nothing that they show."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class LeftOut:
    """The `instrument` with the groups that are left out, the standard deviations (k,) of these, by how much one of
    each `moves` the parameters (m, k) of the linear model, and what it `leaves` (r, k) in the rows that these are
    fitted to, in units of their standard deviations."""

    instrument: Instrument
    usual: Array
    moves: Array
    leaves: Array

    @property
    def by_usual(self) -> Array:
        """What their usual sizes move (m, k)."""
        return self.moves * self.usual


def left_out_of(observations: Observations, sigma: Array | None = None, names: Container[str] | None = None) -> LeftOut:
    """The groups of the accelerometers of which the observations know a usual size, those of `names` alone where there
    are any, and what they do in a fit to rests with standard deviations `sigma` (N,), equal ones where None."""
    seen = observations.of_accelerometers()
    usual = {name: size for name, size in seen.usual.items() if names is None or name in names}
    problem = Problem.of(seen, instrument=_at_rest(replace(seen, usual=usual)), usual=usual)
    rows = _rows(problem) if sigma is None else _rows(problem) / np.repeat(sigma, _rows_of_rest(problem))[:, None]
    A, B = np.split(rows, [problem.instrument.linear_count], axis=1)
    moves = np.linalg.pinv(A, rcond=_NOTHING) @ B
    return LeftOut(
        instrument=problem.instrument, usual=problem.measured[1][1 + A.shape[1] :], moves=moves, leaves=B - A @ moves
    )


def _at_rest(observations: Observations) -> Instrument:
    """The instrument with the groups that change readings at rest: a lag has nothing of its own."""
    whole = instruments_of(observations)[0]
    return replace(whole, further=tuple(group for group in whole.further if group.variable != "lag"))


def _rows_of_rest(problem: Problem) -> int:
    return problem.instrument.accel.size - 2


def _rows(problem: Problem) -> Array:
    """How the readings (N (n − 2), m) of the rests, along what no turn of the vertical reaches, change with the
    parameters, nominal ones being the first."""
    observations, instrument = problem.observations, problem.instrument
    block, g = observations.accel_block, observations.site.gravity
    values = np.zeros(len(instrument.names))
    force = g * unit_vector(block.nominal().apply(observations.rests.accel))
    seen, D = functions(block, force, np.zeros_like(force)), instrument.derivative(block, values)
    changes = np.einsum("ipb,pbm->ipm", seen, D)
    changing, base = problem.changed
    changes[:, :, changing] = changes[:, :, base] * problem.goes[0][:, None]
    turning = np.einsum("pk,ijk->ipj", instrument.coefficients(block, values)[:, FORCE], tangent_basis(force / g))
    across, _ = np.linalg.qr(turning, mode="complete")
    return np.asarray(np.einsum("ipr,ipm->irm", across[:, :, 2:], changes).reshape(-1, len(values)))


def with_left_out(estimate: Estimate, found: LeftOut, gravity: float) -> Estimate:
    """An estimate of the accelerometers, with degrees of freedom, with the groups it leaves out, which are nothing
    within their usual sizes, and their part in its covariance."""
    instrument, moved, k = found.instrument, found.by_usual, len(found.usual)
    own, crossed = estimate.covariance + moved @ moved.T, -moved * found.usual
    covariance = np.block([[own, crossed], [crossed.T, np.diag(found.usual**2)]])
    values = np.append(estimate.values, np.zeros(k))
    assert estimate.degrees is not None
    degrees = estimate.degrees * (np.diag(own) / np.diag(estimate.covariance)) ** 2
    return replace(
        estimate,
        names=instrument.names,
        units=instrument.units,
        values=values,
        covariance=covariance,
        observable=np.append(estimate.observable, np.ones(k, dtype=bool)),
        null=np.pad(estimate.null, ((0, 0), (0, k))),
        increments=tuple(np.append(step, np.zeros(k)) for step in estimate.increments),
        instrument=instrument,
        groups=_nothing_learned(found),
        degrees=np.append(degrees, np.full(k, np.inf)),
        prediction=prediction(instrument, values, covariance, gravity=gravity, rate=None),
    )


def _nothing_learned(found: LeftOut) -> tuple[GroupFinding, ...]:
    first = found.instrument.linear_count
    return tuple(
        GroupFinding(
            name=group.name,
            kept=True,
            prior=float(found.usual[own.start - first]),
            widened=1.0,
            learned=(0.0,) * (own.stop - own.start),
        )
        for group in found.instrument.further
        for own in (found.instrument.members[group.name],)
    )
