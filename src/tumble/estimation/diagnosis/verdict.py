"""The outcome of an estimate: whether it may be used, its accelerometers and gyros each for itself, and why not."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from tumble.estimation.causes.cause import Concerns
from tumble.estimation.diagnosis.misfit import Misfit, misfit
from tumble.estimation.diagnosis.site_gravity import gravity_refused
from tumble.estimation.diagnosis.undetermined import (
    as_six_faces_give,
    faces_alone,
    gravity_wanted,
    linear_names,
    undetermined,
)
from tumble.estimation.estimate import FIT_SIGMAS, Estimate, Outcome
from tumble.reduction.observations import Observations
from tumble.reduction.segmentation import Segmentation
from tumble.units import DEGREE, G_STANDARD

SCATTER_LIMIT = 1e-3 * G_STANDARD
TURN_SCATTER_LIMIT = 1.0 * DEGREE

_ORDER: tuple[Concerns, ...] = ("both", "accel", "gyro")


def verdict(estimate: Estimate, observations: Observations, *, gravity_confirmed: bool = False) -> Outcome:
    """Whether an estimate may be used, and its accelerometers and gyros each for itself."""
    missing = linear_names(estimate.unobservable)
    faces = faces_alone(estimate, missing)
    first = [] if estimate.reasons or faces else undetermined(estimate, observations, missing)
    judged = misfit(estimate, observations) if estimate.converged and not missing else None
    judged = judged or Misfit()
    reasons: list[tuple[Concerns, str]] = [("both", reason) for reason in estimate.reasons]
    if (faces or not missing) and not estimate.converged:
        said = "the estimate did not converge: the data contradict the model; look at the rests with `tumble inspect`"
        reasons.append(("both", said))
    if not gravity_confirmed:
        reasons += (("accel", said) for said in gravity_refused(observations.site))
    reasons += (("accel", said) for said in _scattering_rests(estimate))
    reasons += (("gyro", said) for said in _scattering_turns(estimate, observations))
    reasons += (("both", said) for said in _misfits(estimate, observations))
    reasons += judged.reasons
    reasons = first + sorted(reasons, key=lambda reason: _ORDER.index(reason[0]))
    remarks: list[tuple[Concerns, str]] = [("accel", said) for said in gravity_wanted(observations.site)]
    if faces:
        remarks.append(("accel", as_six_faces_give(estimate, observations, missing)))
    remarks += [*(("both", remark) for remark in estimate.remarks), *judged.remarks]
    of_accel, of_gyro = (
        tuple(said for concerns, said in (*reasons, *remarks) if concerns == kind) for kind in ("accel", "gyro")
    )
    return Outcome(
        reasons=tuple(said for _, said in reasons),
        remarks=tuple(said for _, said in remarks),
        unobservable=missing,
        of_accel=of_accel,
        of_gyro=of_gyro,
    )


def _scattering_rests(estimate: Estimate) -> Iterator[str]:
    """Accelerometers at rest that scatter beyond anything a sensor does."""
    fit = estimate.fits.get("accelerometers")
    wandering = 0.0 if estimate.linearised is None else estimate.linearised.scatter.accel_wandering
    scatter = wandering if fit is None else max(fit.scatter, wandering)
    if scatter > SCATTER_LIMIT:
        yield (
            f"the rests scatter by {scatter / G_STANDARD * 1e3:.2g} mg, more than 1 mg: the device moved at "
            "rest, or the accelerometers do not follow the model"
        )


def _scattering_turns(estimate: Estimate, observations: Observations) -> Iterator[str]:
    """Turns that scatter beyond anything a gyro does."""
    turns = estimate.fits.get("gyro turns")
    if turns is not None and turns.scatter > TURN_SCATTER_LIMIT:
        worst = observations.turn_named(int(np.argmax(estimate.turn_sigmas)))
        yield (
            f"the turns scatter by {turns.scatter / DEGREE:.2g}°, more than {TURN_SCATTER_LIMIT / DEGREE:.0f}°: look "
            f"for damaged or lost samples of the gyros, first in {worst}"
        )


def _misfits(estimate: Estimate, observations: Observations) -> Iterator[str]:
    """Rests and turns beyond FIT_SIGMAS."""
    rests = observations.rests
    for i in np.flatnonzero(estimate.rest_sigmas > FIT_SIGMAS):
        by_gyros = len(estimate.gyro_rest_sigmas) > 0 and estimate.gyro_rest_sigmas[i] == estimate.rest_sigmas[i]
        yield (
            f"{observations.rest_named(int(i))} ({rests.start[i]:z.1f}–{rests.stop[i]:z.1f} s) does not fit"
            + (" by its gyros" if by_gyros else "")
            + f": {estimate.rest_sigmas[i]:.1f} sigma"
            + ("" if by_gyros else f", residual {estimate.rest_residual[i]:.2g} m/s^2")
        )
    if observations.turns is None:
        return
    for k in np.flatnonzero(estimate.turn_sigmas > FIT_SIGMAS):
        yield f"{observations.turn_named(int(k))} does not fit: {estimate.turn_sigmas[k]:.1f} sigma"


def no_rests(segmentation: Segmentation) -> Outcome:
    """The outcome of a log in which nothing rests."""
    reason = (
        f"no rest found: expected the device to lie still for at least {segmentation.tuning.still} s in each position"
    )
    reason += "".join(f"; {said}" for said in segmentation.passed_over())
    if segmentation.rejected:
        longest = max(segmentation.rejected, key=lambda r: r.stop - r.start)
        reason += f"; the longest quiet stretch, {longest.start:.1f}–{longest.stop:.1f} s, is none: {longest.reason}"
    return Outcome(reasons=(f"{reason}; `tumble inspect` shows what was rejected",))
