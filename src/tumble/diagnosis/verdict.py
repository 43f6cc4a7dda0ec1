"""The outcome of an estimate: whether it may be used, its accelerometers and gyros each for itself, and why not."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from tumble.diagnosis.linearised_session import Concerns
from tumble.diagnosis.misfit import Misfit, misfit
from tumble.diagnosis.site_gravity import gravity_refused
from tumble.diagnosis.undetermined import (
    as_six_faces_give,
    faces_alone,
    gravity_wanted,
    linear_names,
    undetermined,
)
from tumble.inference.estimate import FIT_SIGMAS, Estimate, Outcome
from tumble.inference.integral import POOR
from tumble.reduction.observations import Observations
from tumble.reduction.rests.segmentation import Segmentation
from tumble.sensors.parameters import sensor_kind
from tumble.units import DEGREE, G_STANDARD, BoolArray

SCATTER_LIMIT, TURN_SCATTER_LIMIT = 1e-3 * G_STANDARD, 1.0 * DEGREE
"""Of readings at rest by the methods that have one scatter and leave nothing out, and of turns by all."""
MOST_LEFT_OUT = 1.0 / 3.0
"""Of the rests or turns: where more do not fit, it is not they that are wrong."""
FEWEST_POINTS = 10.0
"""Effective points of the integral over the hyperparameters, below which u is as good as a few points say, where their
weights are poor, too."""

_Said = tuple[Concerns, str]
_ORDER: tuple[Concerns, ...] = ("both", "accel", "gyro")


def verdict(estimate: Estimate, observations: Observations, *, gravity_confirmed: bool = False) -> Outcome:
    """Whether an estimate may be used, and its accelerometers and gyros each for itself."""
    missing = linear_names(estimate.unobservable)
    faces = faces_alone(estimate, missing)
    first = [] if estimate.reasons or faces else undetermined(estimate, observations, missing)
    judged = _judged(estimate, missing)
    reasons: list[tuple[Concerns, str]] = [("both", reason) for reason in estimate.reasons]
    if (faces or not missing) and not estimate.converged:
        said = "the estimate did not converge: the data contradict the model; look at the rests with `tumble inspect`"
        reasons.append(("both", said))
    if not gravity_confirmed:
        reasons += (("accel", said) for said in gravity_refused(observations.site))
    reasons += _scattering(estimate, observations)
    spoilt, apart = _not_fitting(estimate, observations)
    reasons += spoilt
    reasons += judged.reasons
    reasons = first + sorted(reasons, key=lambda reason: _ORDER.index(reason[0]))
    remarks: list[tuple[Concerns, str]] = [("accel", said) for said in gravity_wanted(observations.site)]
    if faces:
        remarks.append(("accel", as_six_faces_give(estimate, observations, missing)))
    remarks += [*apart, *(("both", remark) for remark in estimate.remarks), *judged.remarks]
    integral = estimate.integral
    if integral is not None and integral.pareto > POOR and integral.effective < FEWEST_POINTS:
        said = "u rests on a few points of the integral over what the model does not know of itself: it is a rough one"
        remarks.append(("both", said))
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


def _scattering(estimate: Estimate, observations: Observations) -> Iterator[_Said]:
    """Accelerometers at rest and turns that scatter beyond anything a sensor does."""
    rests, turns = estimate.fits.get("accelerometers"), estimate.fits.get("gyro turns")
    if rests is not None and rests.scatter > SCATTER_LIMIT and estimate.left_out is None:
        yield (
            "accel",
            f"the rests scatter by {rests.scatter / G_STANDARD * 1e3:.2g} mg, more than 1 mg: the device moved at "
            "rest, or the accelerometers do not follow the model",
        )
    if turns is not None and turns.scatter > TURN_SCATTER_LIMIT:
        worst = observations.turn_named(int(np.argmax(estimate.turn_sigmas)))
        yield (
            "gyro",
            f"the turns scatter by {turns.scatter / DEGREE:.2g}°, more than {TURN_SCATTER_LIMIT / DEGREE:.0f}°: look "
            f"for damaged or lost samples of the gyros, first in {worst}",
        )


def _judged(estimate: Estimate, missing: tuple[str, ...]) -> Misfit:
    """What the residuals say; where parameters of one kind of sensor are missing, of the other kind."""
    without = {sensor_kind(name) for name in missing}
    if not estimate.converged or (without and (estimate.gyro is None or len(without) > 1)):
        return Misfit()
    found = misfit(estimate) or Misfit()
    reasons, remarks = (
        tuple(each for each in said if not without or each[0] not in ("both", *without))
        for said in (found.reasons, found.remarks)
    )
    return Misfit(reasons=reasons, remarks=remarks, causes=found.causes)


def _not_fitting(estimate: Estimate, observations: Observations) -> tuple[list[_Said], list[_Said]]:
    """What is said of rests and turns that do not fit, or that were left out because they do not: reasons, and
    remarks. A method that leaves out has them in no parameter, or fits them within its scatter; for one that does not
    they are reasons, and so they are where they are many."""
    rests, turns, out = observations.rests, observations.turns, estimate.left_out
    N, K = len(rests), 0 if turns is None else len(turns)
    none, by_gyros = np.zeros(N, dtype=bool), np.zeros(N, dtype=bool)
    if len(estimate.gyro_rest_sigmas):
        by_gyros = estimate.gyro_rest_sigmas == estimate.rest_sigmas
    accel, gyro, turn = (none, none, np.zeros(K, dtype=bool)) if out is None else (out.accel, out.gyro, out.turn)
    reasons, remarks = list[_Said](), list[_Said]()
    several: tuple[tuple[Concerns, str, BoolArray], ...]
    several = ("accel", "rests", accel), ("gyro", "rests by their gyros", gyro), ("gyro", "turns", turn)
    for kind, what, omitted in several:
        if omitted.sum() > MOST_LEFT_OUT * len(omitted):
            said = f"{omitted.sum()} of {len(omitted)} {what} do not fit, more than a third"
            reasons.append((kind, f"{said}: the data contradict the model; look at the rests with `tumble inspect`"))
    for i in np.flatnonzero((estimate.rest_sigmas > FIT_SIGMAS) | accel | gyro):
        left = accel[i] or gyro[i]
        gyros = bool(gyro[i] and not accel[i]) if left else bool(by_gyros[i])
        said = f"{observations.rest_named(int(i))} ({rests.start[i]:z.1f}–{rests.stop[i]:z.1f} s)"
        said += " was left out" if left else " does not fit"
        said += (" by its gyros" if gyros else "") + f": {_far(estimate.rest_sigmas[i], bool(left))}"
        said += "" if gyros else f", residual {estimate.rest_residual[i]:.2g} m/s^2"
        (reasons if out is None else remarks).append(("gyro" if gyros else "both", said))
    judged = np.flatnonzero((estimate.turn_sigmas > FIT_SIGMAS) | turn) if len(estimate.turn_sigmas) else ()
    for k in judged:
        said = f"{observations.turn_named(int(k))} {'was left out' if turn[k] else 'does not fit'}: "
        said += _far(estimate.turn_sigmas[k], bool(turn[k]))
        (reasons if out is None else remarks).append(("gyro" if out is not None else "both", said))
    return reasons, remarks


def _far(sigmas: float, left_out: bool) -> str:
    """How far a rest or turn is from the fit."""
    return f"{sigmas:.1f} sigma from what the others say" if left_out else f"{sigmas:.1f} sigma"


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
