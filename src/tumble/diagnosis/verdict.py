"""The outcome of an estimate: whether it may be used, its accelerometers and gyros each for itself, and why not."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import scipy

from tumble.diagnosis.findings import Finding, outcome_of, refusal, remark
from tumble.diagnosis.in_motion import in_motion
from tumble.diagnosis.misfit import misfit
from tumble.diagnosis.projection import FALSE_ALARMS
from tumble.diagnosis.undetermined import (
    as_six_faces_give,
    faces_alone,
    gravity_wanted,
    linear_names,
    undetermined,
)
from tumble.earth import normal_gravity
from tumble.inference.estimate import FIT_SIGMAS, Estimate, Outcome
from tumble.inference.integral import is_poorly_sampled
from tumble.recording.session import Site
from tumble.reduction.observations import Observations
from tumble.reduction.rests.segmentation import Segmentation
from tumble.sensors.parameters import group_name, limits_of, sensor_kind
from tumble.units import DEGREE, G_STANDARD, two_digits

SCATTER_LIMIT, TURN_SCATTER_LIMIT = 1e-3 * G_STANDARD, 1.0 * DEGREE
"""Of readings at rest by the methods that have one scatter and leave nothing out, and of turns by all."""
MOST_LEFT_OUT = 1.0 / 3.0
"""Of the rests or turns: where more do not fit, it is not they that are wrong."""
NO_BIAS = 5.0
"""Times the limit: no gyro has such a bias."""
OF_USUAL = 2.0
"""Degrees of freedom for which the usual spread of scale factors counts: it is right within a factor of about two."""
MILLIGAL = 1e-5  # m/s²
GRAVITY_DOUBTED = 300.0 * MILLIGAL
GRAVITY_REFUSED = 1100.0 * MILLIGAL
"""Anomalies of gravity on Earth reach 300 mGal on land in a few places; nowhere 1,000. The limit lets the value through
that imu_tk takes for its recording, 1,091 mGal more than normal gravity, which published results rest on."""


def verdict(
    estimate: Estimate, observations: Observations, *, gravity_confirmed: bool = False, search: bool = True
) -> Outcome:
    """Judge an estimate.

    Parameters
    ----------
    estimate
        Of any method.
    observations
        What it was made from.
    gravity_confirmed
        Whether gravity is what is stated, however far from normal gravity.
    search
        Whether to search for causes; without, residuals are judged by their size alone.

    Returns
    -------
    Outcome
        Whether it may be used, its accelerometers and gyros each for itself, and which groups of parameters where these
        are not judged alike. Reasons are in the order: what is not determined, what concerns both kinds of sensors,
        what concerns the accelerometers, the gyros.
    """
    missing, site = linear_names(estimate.unobservable), observations.site
    of_gravity = (*(() if gravity_confirmed else _impossible_gravity(site)), *gravity_wanted(site))
    if observations.links is not None:
        return outcome_of((*in_motion(estimate, observations, missing), *of_gravity), missing)
    faces = faces_alone(estimate, missing)
    weak = [] if estimate.reasons or faces else undetermined(estimate, observations, missing)
    findings = [
        *(refusal(reason) for reason in estimate.reasons),
        *([] if missing and not faces else _not_converged(estimate)),
        *of_gravity,
        *_beyond_scatter(estimate, observations),
        *([as_six_faces_give(estimate, observations, missing)] if faces else []),
        *(each for each in weak if not each.refuses),
        *_not_fitting(estimate, observations),
        *_beyond_any_bias(estimate),
        *map(remark, estimate.remarks),
        *_judged(estimate, missing, search),
        *_few_points(estimate),
    ]
    of_kinds = ((), ("accel",), ("gyro",))
    refusals = sorted((each for each in findings if each.refuses), key=lambda each: of_kinds.index(each.kinds))
    remarks = (each for each in findings if not each.refuses)
    return outcome_of([*(each for each in weak if each.refuses), *refusals, *remarks], missing)


def _not_converged(estimate: Estimate) -> Iterator[Finding]:
    """That the iteration ran out."""
    if not estimate.converged:
        yield refusal(
            "the estimate did not converge: the data contradict the model; look at the rests with `tumble inspect`"
        )


def _few_points(estimate: Estimate) -> Iterator[Finding]:
    """That the integral over the hyperparameters has an error that counts."""
    if estimate.integral is not None and is_poorly_sampled(estimate.integral):
        yield remark(
            "u rests on a few points of the integral over what the model does not know of itself: it is a rough one"
        )


def _impossible_gravity(site: Site) -> Iterator[Finding]:
    """Gravity that no place on Earth has."""
    difference = gravity_difference(site)
    if difference is not None and abs(difference) > GRAVITY_REFUSED:
        yield refusal(
            f"{gravity_said(site)}, more than {GRAVITY_REFUSED / MILLIGAL:.0f}: every scale factor of the "
            "accelerometers would be wrong with it; correct gravity, latitude_deg or height_m in [site], or write "
            "gravity_confirmed = true",
            "accel.scale",
        )


def _beyond_any_bias(estimate: Estimate) -> Iterator[Finding]:
    """A bias of the gyros far beyond its limit, which a device that turned steadily would show too."""
    at = np.array([group_name(name) == "gyro.bias" for name in estimate.names]) & estimate.observable
    if at.any():
        name, value = max(zip(np.array(estimate.names)[at], estimate.values[at], strict=True), key=lambda x: abs(x[1]))
        limit = float(limits_of([name])[0])
        if abs(value) > NO_BIAS * limit:
            yield remark(
                f"{name} of {value / DEGREE:.4g} °/s is far beyond any usual one, up to {limit / DEGREE:.2g} °/s: is "
                "the unit right, or did the device turn?",
                "gyro.bias",
            )


def _beyond_scatter(estimate: Estimate, observations: Observations) -> Iterator[Finding]:
    """Rests and turns that scatter by more than any model bears."""
    rests, turns = estimate.fits.get("accelerometers"), estimate.fits.get("gyro turns")
    if rests is not None and rests.scatter > SCATTER_LIMIT and estimate.left_out is None:
        yield refusal(
            f"the rests scatter by {rests.scatter / G_STANDARD * 1e3:.2g} mg, more than 1 mg: the device moved at "
            "rest, or the accelerometers do not follow the model",
            "accel",
        )
    if turns is not None and turns.scatter > TURN_SCATTER_LIMIT:
        worst = observations.turn_named(int(np.argmax(estimate.turn_sigmas)))
        yield refusal(
            f"the turns scatter by {turns.scatter / DEGREE:.2g}°, more than {TURN_SCATTER_LIMIT / DEGREE:.0f}°: look "
            f"for damaged or lost samples of the gyros, first in {worst}",
            "gyro",
        )


def _judged(estimate: Estimate, missing: tuple[str, ...], search: bool) -> Iterator[Finding]:
    """What the residuals show; where parameters of one kind of sensor are missing, of the other kind."""
    without = {sensor_kind(name) for name in missing}
    if not estimate.converged or (without and (estimate.gyro is None or len(without) > 1)):
        return
    for found in misfit(estimate, search):
        if not without or (found.kinds and not without & {*found.kinds}):
            yield found


def _not_fitting(estimate: Estimate, observations: Observations) -> Iterator[Finding]:
    """Rests and turns that do not fit, or that were left out because they do not. A method that leaves out has them in
    no parameter, or fits them within its scatter; for one that does not they are reasons, and so they are where they
    are many."""
    rests, turns, out = observations.rests, observations.turns, estimate.left_out
    N, K = len(rests), 0 if turns is None else len(turns)
    none, by_gyros = np.zeros(N, dtype=bool), np.zeros(N, dtype=bool)
    if len(estimate.gyro_rest_sigmas):
        by_gyros = estimate.gyro_rest_sigmas == estimate.rest_sigmas
    accel, gyro, turn = (none, none, np.zeros(K, dtype=bool)) if out is None else (out.accel, out.gyro, out.turn)
    for kind, what, omitted in (
        ("accel", "rests", accel),
        ("gyro", "rests by their gyros", gyro),
        ("gyro", "turns", turn),
    ):
        if omitted.sum() > MOST_LEFT_OUT * len(omitted):
            yield refusal(
                f"{omitted.sum()} of {len(omitted)} {what} do not fit, more than a third: the data contradict the "
                "model; look at the rests with `tumble inspect`",
                kind,
            )
    for i in np.flatnonzero((estimate.rest_sigmas > FIT_SIGMAS) | accel | gyro):
        left = accel[i] or gyro[i]
        gyros = bool(gyro[i] and not accel[i]) if left else bool(by_gyros[i])
        rest = f"{observations.rest_named(int(i))} ({rests.start[i]:z.1f}–{rests.stop[i]:z.1f} s)"
        how = _how_far(estimate.rest_sigmas[i], bool(left), " by its gyros" if gyros else "")
        how += "" if gyros else f", residual {estimate.rest_residual[i]:.2g} m/s^2"
        yield Finding(sentence=rest + how, concerns=("gyro",) if gyros else (), refuses=out is None)
    for k in np.flatnonzero((estimate.turn_sigmas > FIT_SIGMAS) | turn) if len(estimate.turn_sigmas) else ():
        sentence = observations.turn_named(int(k)) + _how_far(estimate.turn_sigmas[k], bool(turn[k]))
        yield Finding(sentence=sentence, concerns=() if out is None else ("gyro",), refuses=out is None)


def _how_far(sigmas: float, left_out: bool, by: str = "") -> str:
    """That a rest or turn does not fit, or was left out, and how far it is from the fit."""
    if left_out:
        return f" was left out{by}: {sigmas:.1f} sigma from what the others say"
    return f" does not fit{by}: {sigmas:.1f} sigma"


def no_rests(segmentation: Segmentation) -> Outcome:
    """The outcome of a log in which nothing rests."""
    reason = (
        f"no rest found: expected the device to lie still for at least {segmentation.tuning.still} s in each position"
    )
    reason += "".join(f"; {said}" for said in segmentation.passed_over())
    if segmentation.rejected:
        longest = max(segmentation.rejected, key=lambda r: r.stop - r.start)
        reason += f"; the longest quiet stretch, {longest.start:z.1f}–{longest.stop:z.1f} s, is none: {longest.reason}"
    advice = (
        "put it down in nine or more positions (`tumble programme` shows them); of accelerometers that were slowly "
        "waved through all attitudes `tumble ellipsoid LOG` makes what can be made; `tumble inspect` shows what was "
        "rejected"
    )
    return Outcome(reasons=(f"{reason}; {advice}",))


def little_used(segmentation: Segmentation, *, in_motion: bool = False) -> tuple[str, ...]:
    """That much of the quiet time of a log is no rest that the estimate has, as a remark. One `in_motion` has what
    moves, but not what is shaken."""
    used = sum(rest.stop - rest.start for rest in segmentation.rests)
    left_out = segmentation.shaken if in_motion else segmentation.rejected
    unused = sum(stretch.stop - stretch.start for stretch in left_out)
    if unused <= MOST_LEFT_OUT * (used + unused):
        return ()
    return (
        f"{unused:.0f} s of {used + unused:.0f} s in which the device was quiet are not used as rests, more than a "
        "third (the notes say why); let it lie still for longer, without vibration or sway",
    )


# -------------------- gravity of the site against normal gravity of its latitude and height --------------------


def gravity_difference(site: Site) -> float | None:
    """Gravity of a site less normal gravity, m/s²; None where the latitude is not known."""
    return None if site.latitude is None else site.gravity - normal_gravity(site.latitude, site.height)


def against_normal(site: Site) -> str | None:
    """How far gravity is from normal gravity; where it is that to the last digit and no better known than a milligal,
    which any measurement is, none was measured: then the uncertainty it has. None where the latitude is not known."""
    difference = gravity_difference(site)
    if difference is None:
        return None
    if difference == 0.0 and site.gravity_u > MILLIGAL:
        return f"normal gravity assumed, u {two_digits(1e6 * site.gravity_u / site.gravity)} ppm"
    return f"{difference / MILLIGAL:+z.0f} mGal from normal gravity"


def gravity_said(site: Site) -> str:
    """Gravity, and where the latitude is known what it is against normal gravity."""
    against = against_normal(site)
    return f"gravity {site.gravity:.6f} m/s^2" + ("" if against is None else f", {against}")


def gravity_doubted(site: Site) -> tuple[str, ...]:
    """Gravity that few places have, as a note."""
    difference = gravity_difference(site)
    if difference is None or abs(difference) <= GRAVITY_DOUBTED:
        return ()
    return (
        f"{gravity_said(site)}, more than {GRAVITY_DOUBTED / MILLIGAL:.0f}: look at gravity, latitude_deg and height_m "
        f"in [site]; if that is wrong, the scale factors of the accelerometers are off by "
        f"{difference / site.gravity * 1e6:+.0f} ppm",
    )


# -------------------- time base of the log against the scale factors of the gyros --------------------


def time_base_doubted(estimate: Estimate, usual: float) -> tuple[str, ...]:
    """Scale factors of the gyros that err alike by more than they differ, as all do by a wrong time base.

    The mean of n scale-factor errors of an instrument is N(0, σ²/n) beside its own uncertainty, that of the time base
    included. σ is by the spread s of the n and by the `usual` one of the grade, which counts as OF_USUAL degrees of
    freedom: σ² = (OF_USUAL usual² + (n − 1) s²)/(OF_USUAL + n − 1). What stands out by Student's t, with the degrees of
    freedom of Welch and Satterthwaite, is said.

    Parameters
    ----------
    estimate : Estimate
        With gyros.
    usual : float
        Standard deviation of scale-factor errors over instruments of the grade.

    Returns
    -------
    tuple of str
        A remark, or nothing.
    """
    at = [i for i, name in enumerate(estimate.names) if group_name(name) == "gyro.scale"]
    n = len(at)
    if n < len("xyz") or not estimate.observable[at].all():
        return ()
    scale, degrees = estimate.values[at], OF_USUAL + n - 1
    mean, spread = float(scale.mean()), float(scale.std(ddof=1))
    by_spread = (OF_USUAL * usual**2 + (n - 1) * spread**2) / degrees / n
    variance = by_spread + float(estimate.covariance[np.ix_(at, at)].mean())
    t = mean / np.sqrt(variance)
    if 2.0 * scipy.special.stdtr(degrees * (variance / by_spread) ** 2, -abs(t)) > FALSE_ALARMS:
        return ()
    return (
        f"the scale factors of the gyros err alike, by {100.0 * mean:+.2g} %, and differ by {100.0 * spread:.2g} %: "
        "the sample rate or the time stamps are wrong by as much, or the nominal scale of the gyros is, which the "
        "session does not tell apart; measure the rate by a clock",
    )
