"""The linear model where the instrument has more: whether the session shows it, and by how much it moves the result.

The methods beside `joint` have bias, scale factor and axis angles alone, and take what else there is for one of these:
a quadratic term of the accelerometers for a bias and scale factors. Two things are asked of such an estimate.

Its residuals are judged about the estimate that `joint` makes of the same model (`judged`), for the turns show most of
what rests alone can be fitted to. And what they do not show is counted: in u by the method ellipsoid, which has no
turns, in a note by the others. Groups of usual size σ, beyond bias, scale factor and axis angles, add B φ to the
readings at rest, B along what no turn of the vertical reaches. A fit of the linear columns A, with the weights it has,
takes A⁺ B φ for parameters:

    ΔX = A⁺ B φ,   cov(ΔX) = A⁺ B Σ (A⁺ B)ᵀ,   cov(ΔX, −φ) = −A⁺ B Σ,   Σ = diag(σ²)

The groups stay at nothing, so that −φ is their error. With it the corrected force in the attitudes of the rests is as
well known as the fit has it, and in others as badly as the groups allow. Where the rests show that σ is too small, it
is what `joint` widens the prior of a group to (`GroupFinding.prior_widened`).

This is docs/explanation/mathematics.md (36) with usual sizes; the columns are those of Eq. (12) of the turntable paper,
for any number of sensors.
"""

from __future__ import annotations

from collections.abc import Container
from dataclasses import dataclass, replace

import numpy as np

from tumble.diagnosis.lost_samples import lost_by_velocities
from tumble.diagnosis.misfit import DAMAGE, damaging
from tumble.diagnosis.undetermined import linear_names
from tumble.inference.estimate import Estimate, GroupFinding
from tumble.inference.joint import joint
from tumble.inference.likelihood import Problem, instruments_of
from tumble.inference.prediction import prediction
from tumble.inference.sources import source
from tumble.reduction.observations import Observations
from tumble.rotation import unit_vector
from tumble.sensors.instrument import Instrument, functions
from tumble.sensors.model import beyond_turning
from tumble.sensors.parameters import FORCE, positions_by_group, shown_in, units_of
from tumble.units import Array, two_digits

_NOTHING = 1e-9
"""Of the largest singular value: what rests do not determine is moved by nothing that they show."""
_AT_REST = {
    "accel.quadratic": "quadratic terms",
    "accel.cubic": "cubic terms",
    "accel.asymmetry": "asymmetry",
}
"""Groups that change readings of the accelerometers at rest."""
_WORDS = {"accel.bias": "biases", "accel.scale": "scale factors", "accel.axis": "axis angles"}


def judged(estimate: Estimate, observations: Observations, whole: Observations) -> Estimate:
    """An estimate of the linear model with a likelihood by which its residuals are judged, and with what the velocities
    of turns say of lost samples; `whole` are the observations that know the usual sizes of all groups."""
    if estimate.linearised is None and not estimate.unobservable and estimate.converged:
        beside = by_joint(observations if estimate.gyro is not None else observations.of_accelerometers())
        if beside is not None:
            estimate = replace(estimate, linearised=beside.linearised)
    if estimate.linearised is None or not whole.unstamped or estimate.gyro is None:
        return estimate
    lost = lost_by_velocities(estimate.linearised, whole)
    if lost is None:
        return estimate
    if lost.damage > DAMAGE:
        return replace(estimate, reasons=(*estimate.reasons, damaging(lost)[1]))
    return replace(estimate, remarks=(*estimate.remarks, f"probable cause: {lost.sentence}"))


def by_joint(observations: Observations) -> Estimate | None:
    """What `joint` makes of observations; None where it does not converge or leaves a linear parameter open."""
    try:
        found = joint(observations)
    except np.linalg.LinAlgError:
        return None
    return found if found.converged and not linear_names(found.unobservable) else None


def left_out(estimate: Estimate, observations: Observations, whole: Observations) -> tuple[str, ...]:
    """What an estimate of the linear model leaves out, and by how much more than u that moves it, as a note."""
    block = observations.accel_block
    names = {name for name in whole.usual if name in _AT_REST}
    if not names or not set(block.names) <= set(estimate.names) or estimate.unobservable:
        return ()
    moved, u = moved_by(names, whole), estimate.u[: len(block.names)]
    sizes = []
    for name, at in positions_by_group(block.names).items():
        by, known = float(np.sqrt((moved[at] ** 2).mean())), float(np.sqrt((u[at] ** 2).mean()))
        if by > known:
            size, unit = shown_in(name, units_of(block.names)[at[0]], by)
            sizes.append(f"{_WORDS[name]} by {two_digits(by / size)} {unit}")
    if not sizes:
        return ()
    return (
        f"not in the model: {', '.join(_AT_REST[name] for name in _AT_REST if name in names)} of the accelerometers; "
        f"where they are of the size usual in instruments of the grade, they move {', '.join(sizes)} (rms), which u "
        "does not contain; the method joint with all its terms does",
    )


def taken_as_nothing(estimate: Estimate) -> tuple[str, ...]:
    """That groups are nothing by the method and in its u by their size, where an estimate has such, as a note."""
    if not estimate.groups:
        return ()
    return (
        f"the method {estimate.method} takes all of it as nothing and has its size in u; the method joint finds what "
        "the session shows of it, and --terms linear leaves it out",
    )


def moved_by(names: set[str], observations: Observations) -> Array:
    """Standard deviations (m,) by which groups of their usual sizes move bias, scale factors and axis angles of the
    accelerometers in a fit to the rests that does not have them."""
    return np.asarray(np.linalg.norm(left_out_of(observations, names=names).moved, axis=1))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class LeftOut:
    """The `instrument` with the groups that are left out, the `usual` standard deviations (k,) of these, how many times
    too small they are (k,), by how much one of each `moves` the parameters (m, k) of the linear model, and what it
    `leaves` (r, k) in the rows that these are fitted to, in units of their standard deviations."""

    instrument: Instrument
    usual: Array
    too_small: Array
    moves: Array
    leaves: Array

    @property
    def sizes(self) -> Array:
        """The standard deviations (k,) that are counted with."""
        return self.usual * self.too_small

    @property
    def moved(self) -> Array:
        """What these move (m, k)."""
        return self.moves * self.sizes


def left_out_of(
    observations: Observations, sigma: Array | None = None, names: Container[str] | None = None,
    beside: Estimate | None = None,
) -> LeftOut:  # fmt: skip
    """The groups of the accelerometers of which the observations know a usual size, those of `names` alone where there
    are any, and what they do in a fit to rests with standard deviations `sigma` (N,), equal ones where None. Their
    sizes are widened as those of the estimate `beside`."""
    seen = observations.of_accelerometers()
    usual = {name: size for name, size in seen.usual.items() if names is None or name in names}
    whole = instruments_of(replace(seen, usual=usual))[0]
    instrument = replace(whole, further=tuple(group for group in whole.further if group.variable != "lag"))
    problem = Problem.of(seen, instrument=instrument, usual=usual)
    block, g, values = seen.accel_block, seen.site.gravity, np.zeros(len(instrument.names))
    force = g * unit_vector(block.nominal().apply(seen.rests.accel))
    beta, D = functions(block, force, np.zeros_like(force)), instrument.derivative(block, values)
    changes = np.einsum("ipb,pbm->ipm", beta, D)
    changing, base = problem.changed
    changes[:, :, changing] = changes[:, :, base] * problem.goes[0][:, None]
    across = beyond_turning(instrument.coefficients(block, values)[:, FORCE], force / g)
    rows = np.einsum("ipr,ipm->irm", across, changes).reshape(-1, len(values))
    if sigma is not None:
        rows = rows / np.repeat(sigma, block.size - 2)[:, None]
    A, B = np.split(rows, [instrument.linear_count], axis=1)
    moves = np.linalg.pinv(A, rcond=_NOTHING) @ B
    too_small = np.ones(B.shape[1])
    for group in () if beside is None else beside.groups:
        if group.name in instrument.members:
            members = instrument.members[group.name]
            too_small[members.start - A.shape[1] : members.stop - A.shape[1]] = group.prior_widened
    return LeftOut(
        instrument=instrument,
        usual=problem.measured[1][1 + A.shape[1] :],
        too_small=too_small,
        moves=moves,
        leaves=B - A @ moves,
    )


def with_left_out(estimate: Estimate, found: LeftOut, gravity: float) -> Estimate:
    """An estimate of the accelerometers, with degrees of freedom, with the groups it leaves out, which are nothing
    within their sizes, and their part in its covariance."""
    instrument, moved, sizes, first = found.instrument, found.moved, found.sizes, found.instrument.linear_count
    k, crossed = len(sizes), -moved * sizes
    linear = estimate.covariance + moved @ moved.T
    covariance = np.block([[linear, crossed], [crossed.T, np.diag(sizes**2)]])
    values = np.append(estimate.values, np.zeros(k))
    assert estimate.degrees is not None
    degrees = estimate.degrees * (np.diag(linear) / np.diag(estimate.covariance)) ** 2
    groups = (
        GroupFinding(
            name=name,
            kept=True,
            prior=float(found.usual[members.start - first]),
            prior_widened=float(found.too_small[members.start - first]),
            learned=(0.0,) * (members.stop - members.start),
        )
        for name, members in ((group.name, instrument.members[group.name]) for group in instrument.further)
    )
    budget = estimate.budget
    if budget is not None:
        wide = np.vstack([np.eye(first), np.zeros((k, first))])
        budget = budget.carried(wide)
        for name, members in instrument.members.items():
            own = slice(members.start - first, members.stop - first)
            by = np.vstack([-moved, np.diag(sizes)])[:, own]
            size, unit = float(sizes[own.start]), instrument.units[members.start]
            budget = budget.beside(source(f"prior.{name}", size, unit), by @ by.T)
    return replace(
        estimate,
        budget=budget,
        names=instrument.names,
        units=instrument.units,
        values=values,
        covariance=covariance,
        observable=np.append(estimate.observable, np.ones(k, dtype=bool)),
        null=np.pad(estimate.null, ((0, 0), (0, k))),
        increments=tuple(np.append(step, np.zeros(k)) for step in estimate.increments),
        instrument=instrument,
        groups=tuple(groups),
        degrees=np.append(degrees, np.full(k, np.inf)),
        prediction=prediction(instrument, values, covariance, gravity=gravity, rate=None),
    )
