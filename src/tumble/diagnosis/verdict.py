"""Outcome of an estimate: which parameters may be used, and why others may not."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import scipy

from tumble.advice import Advised
from tumble.diagnosis.findings import Finding, outcome_of, refusal, remark
from tumble.diagnosis.misfit import misfit
from tumble.diagnosis.projection import FALSE_ALARMS
from tumble.diagnosis.undetermined import faces_alone, linear_names, six_faces, uncertain_gravity, undetermined
from tumble.diagnosis.unusual_sizes import unusual_groups
from tumble.earth import NORMAL_GRAVITY_U, normal_gravity
from tumble.inference.estimate import FIT_SIGMAS, Estimate, Omitted, Outcome
from tumble.inference.integral import is_poorly_sampled
from tumble.inference.problem import LEVER_COLUMNS, SUPPORT_COLUMNS, SUPPORT_U
from tumble.recording.session import Site
from tumble.recording.session.document import UNKNOWN_HEIGHT_GRAVITY_U
from tumble.reduction.observations import Observations
from tumble.reduction.rests.segmentation import Segmentation
from tumble.sensors.parameters import group_name, limits_of, sensor_kind, within_kind
from tumble.units import DEGREE, G_STANDARD, two_digits

REST_SCATTER_LIMIT = 1e-3 * G_STANDARD  # of readings at rest, for methods with one scatter that leave nothing out
TURN_SCATTER_LIMIT = 1.0 * DEGREE
LARGEST_SHARE = 1.0 / 3.0  # of rests or turns that do not fit: if there are more, the model is wrong
IMPOSSIBLE_BIAS = 5.0  # in limits of a gyro bias
SPREAD_DEGREES = 2.0  # degrees of freedom of the usual spread of scale factors, which is right within a factor of two
MILLIGAL = 1e-5  # m/s²
DOUBTFUL_SIGMAS = 4.0  # of the difference between stated and normal gravity; high mountains reach it
IMPOSSIBLE_ANOMALY = 1100.0 * MILLIGAL
"""No anomaly on Earth reaches 1,000 mGal. imu_tk takes a value 1,091 mGal above normal gravity for its recording, on
which published results rest."""

IN_MOTION = "calibrated in motion"  # start of the note on a result from motion
MOST_NAMED = 4
LEAST_GAIN = 0.8  # ratio of u with motion to that without, geometric mean; two minutes in one place reach 0.05 to 0.5
LARGEST_DISPLACEMENT = 0.3  # m: a larger one contradicts the model of a device that stays in one place


def verdict(
    estimate: Estimate, observations: Observations, *, gravity_confirmed: bool = False, search: bool = True
) -> Outcome:
    """Judge an estimate.

    Parameters
    ----------
    estimate
        Estimate of any method.
    observations
        Observations it was made from.
    gravity_confirmed
        Whether gravity is as stated, however far from normal gravity.
    search
        Whether to search for causes of residuals; otherwise these are judged by their size alone.

    Returns
    -------
    Outcome
        Whether the accelerometers, the gyros and their groups of parameters may be used. Reasons come in the order:
        undetermined parameters, both kinds of sensors, accelerometers, gyros.
    """
    missing, site = linear_names(estimate.unobservable), observations.site
    of_gravity = (*(() if gravity_confirmed else _doubtful_gravity(site)), *uncertain_gravity(site))
    if observations.links is not None:
        return outcome_of((*_of_motion(estimate, observations, missing), *of_gravity), missing)
    faces = faces_alone(estimate, missing)
    weak = [] if estimate.reasons or faces else undetermined(estimate, observations, missing)
    findings = [*map(refusal, estimate.reasons)]
    if not estimate.converged and (faces or not missing):
        contradicted = "the estimate did not converge: the data contradict the model"
        findings.append(refusal(contradicted, "look at the rests with `tumble inspect`"))
    findings += [*of_gravity, *_excessive_scatter(estimate, observations)]
    if faces:
        findings.append(six_faces(estimate, observations, missing))
    findings += [finding for finding in weak if not finding.refuses]
    findings += [*_not_fitting(estimate, observations), *_impossible_bias(estimate), *map(remark, estimate.remarks)]
    without = {sensor_kind(name) for name in missing}
    if estimate.converged and (not without or (estimate.gyro is not None and len(without) == 1)):
        # of the other kind of sensors, if parameters of one kind are missing
        of_residuals = misfit(estimate, search)
        findings += (each for each in of_residuals if not without or (each.kinds and without.isdisjoint(each.kinds)))
    if estimate.integral is not None and is_poorly_sampled(estimate.integral):
        findings.append(
            remark(
                "the integral over scatter, in-run biases and sizes of groups has not converged: values and u may be "
                f"off by {100.0 * estimate.integral.u_error:.0f} % of u"
            )
        )
    order = ((), ("accel",), ("gyro",))
    refusals = sorted((finding for finding in findings if finding.refuses), key=lambda each: order.index(each.kinds))
    remarks = (finding for finding in findings if not finding.refuses)
    return outcome_of([*(finding for finding in weak if finding.refuses), *refusals, *remarks], missing)


def _doubtful_gravity(site: Site) -> Iterator[Finding]:
    """Refuse gravity that no place on Earth has, and report gravity that few places have."""
    anomaly = gravity_anomaly(site) or 0.0
    remedy = "correct gravity, latitude_deg or height_m in [site], or write gravity_confirmed = true"
    normal_u = UNKNOWN_HEIGHT_GRAVITY_U if site.height is None else NORMAL_GRAVITY_U
    sigmas = abs(anomaly) / float(np.hypot(site.gravity_u, normal_u))
    if abs(anomaly) > IMPOSSIBLE_ANOMALY:
        found = (
            f"{gravity_text(site)}, more than {IMPOSSIBLE_ANOMALY / MILLIGAL:.0f}: every scale factor of the "
            "accelerometers would be wrong with it"
        )
        yield refusal(found, remedy, concerns=("accel.scale",))
    elif sigmas > DOUBTFUL_SIGMAS:
        place = " at sea level" if site.height is None else f" at {site.height:.0f} m"
        found = (
            f"{gravity_text(site)}{place}, {sigmas:.1f} times the standard uncertainty of both: if it is wrong, so "
            f"are the scale factors of the accelerometers, by {1e6 * anomaly / site.gravity:+.0f} ppm"
        )
        yield remark(found, remedy, concerns=("accel.scale",))


def _impossible_bias(estimate: Estimate) -> Iterator[Finding]:
    """Report a gyro bias far beyond its limit, which a steady rotation of the device would also produce."""
    known = zip(estimate.names, estimate.values.tolist(), estimate.observable, strict=True)
    biases = {name: value for name, value, observable in known if observable and group_name(name) == "gyro.bias"}
    name = max(biases, key=lambda name: abs(biases[name]), default="")
    if biases and abs(biases[name]) > IMPOSSIBLE_BIAS * (limit := float(limits_of([name])[0])):
        yield remark(
            f"{name} of {biases[name] / DEGREE:.4g} °/s is far beyond any usual one, up to {limit / DEGREE:.2g} °/s: "
            "is the unit right, or did the device turn?",
            concerns=("gyro.bias",),
        )


def _excessive_scatter(estimate: Estimate, observations: Observations) -> Iterator[Finding]:
    """Refuse scatter of rests and turns that is too large for any model."""
    rests, turns = estimate.fits.get("accelerometers"), estimate.fits.get("gyro turns")
    if rests is not None and rests.scatter > REST_SCATTER_LIMIT and estimate.left_out is None:
        yield refusal(
            f"the rests scatter by {rests.scatter / G_STANDARD * 1e3:.2g} mg, more than 1 mg: the device moved at "
            "rest, or the accelerometers do not follow the model",
            concerns=("accel",),
        )
    if turns is not None and turns.scatter > TURN_SCATTER_LIMIT:
        worst = observations.turn_named(int(np.argmax(estimate.turn_sigmas)))
        yield refusal(
            f"the turns scatter by {turns.scatter / DEGREE:.2g}°, more than {TURN_SCATTER_LIMIT / DEGREE:.0f}°",
            f"look for damaged or lost samples of the gyros, first in {worst}",
            concerns=("gyro",),
        )


def _not_fitting(estimate: Estimate, observations: Observations) -> Iterator[Finding]:
    """Yield rests and turns that do not fit, or were left out for it.

    They are remarks for methods that leave out what does not fit, unless too much was left out, and refuse estimates
    of other methods."""
    rests, none = observations.rests, np.zeros(len(observations.rests), dtype=bool)
    no_turn = np.zeros(0 if observations.turns is None else len(observations.turns), dtype=bool)
    out, refuses = estimate.left_out or Omitted(accel=none, gyro=none, turn=no_turn), estimate.left_out is None
    for kind, what, omitted in (
        ("accel", "rests", out.accel),
        ("gyro", "rests by their gyros", out.gyro),
        ("gyro", "turns", out.turn),
    ):
        if omitted.sum() > LARGEST_SHARE * len(omitted):
            yield refusal(
                f"{omitted.sum()} of {len(omitted)} {what} do not fit, more than a third: the data contradict the "
                "model",
                "look at the rests with `tumble inspect`",
                concerns=(kind,),
            )

    def misses(sigmas: float, left_out: bool, by: str = "") -> str:
        if left_out:
            return f" was left out{by}: {sigmas:.1f} sigma from what the others predict"
        return f" does not fit{by}: {sigmas:.1f} sigma"

    for i in np.flatnonzero((estimate.rest_sigmas > FIT_SIGMAS) | out.accel | out.gyro):
        left_out, sigmas = bool(out.accel[i] or out.gyro[i]), estimate.rest_sigmas[i]
        gyros = bool(out.gyro[i] and not out.accel[i])
        if not left_out and len(estimate.gyro_rest_sigmas):
            gyros = bool(estimate.gyro_rest_sigmas[i] == sigmas)
        sentence = f"{observations.rest_named(int(i))} ({rests.start[i]:z.1f}–{rests.stop[i]:z.1f} s)"
        sentence += misses(sigmas, left_out, " by its gyros" if gyros else "")
        sentence += "" if gyros else f", residual {estimate.rest_residual[i]:.2g} m/s^2"
        yield Finding(sentence=sentence, concerns=("gyro",) if gyros else (), refuses=refuses)
    for k in np.flatnonzero((estimate.turn_sigmas > FIT_SIGMAS) | out.turn) if len(estimate.turn_sigmas) else ():
        sentence = observations.turn_named(int(k)) + misses(estimate.turn_sigmas[k], bool(out.turn[k]))
        yield Finding(sentence=sentence, concerns=() if refuses else ("gyro",), refuses=refuses)


# -------------------- motion --------------------


def _of_motion(estimate: Estimate, observations: Observations, missing: tuple[str, ...]) -> Iterator[Finding]:
    """Yield findings about an estimate from motion; `missing` are linear parameters that it does not determine.

    Displacements that follow the attitude, as of a stand that gives way, are SUPPORT_COLUMNS unknowns b ~ N(0, s²) of
    the estimate (docs/explanation/mathematics.md (40)). The variance of their posterior mean over instruments is at
    most s², so Σ b²/s² is at most χ² with SUPPORT_COLUMNS degrees of freedom. If it is larger, the displacements exceed
    the prior, and scale factors and axes contain them."""
    links, linearised = observations.links, estimate.linearised
    assert links is not None
    n = len(observations.rests)
    recorded = f"{n} rest{'s' * (n != 1)} and {float(links.duration.sum()):.0f} s of motion"
    advice = (
        "turn it for two minutes about a point that stays in place, a tripod head or a ball joint, through all "
        "attitudes, or put it down in nine or more positions (`tumble programme` shows them)"
    )
    if not estimate.converged or linearised is None:
        yield refusal(f"{recorded} do not fit the model", advice)
        return
    if missing:
        named = ", ".join(missing[:MOST_NAMED]) + (" and others" if len(missing) > MOST_NAMED else "")
        yield refusal(f"{recorded} do not determine {named} well enough", advice, concerns=missing)
    support, displacement = linearised.point.local[0, -SUPPORT_COLUMNS:], float(linearised.components.displacement)
    if scipy.special.chdtrc(SUPPORT_COLUMNS, float((support**2).sum()) / SUPPORT_U**2) < FALSE_ALARMS:
        yield refusal(
            f"the device moved by {100.0 * float(np.abs(support).max()):.1f} cm and more with its attitude: what held "
            "it gave way",
            "hold it by something stiffer, or turn it in the hand without a rhythm",
        )
    elif displacement > LARGEST_DISPLACEMENT and not missing:
        yield refusal(f"the device moved by {displacement:.1f} m in motion", "keep it in one place")
    yield from unusual_groups(estimate)


def improves(moving: Estimate, at_rest: Estimate) -> bool:
    """Return True if an estimate from motion is to be preferred to that from the rests and turns of its recording.

    Motion adds that the device stays in one place. If it was laid by hand from face to face, the unknowns of its
    support and the sizes of groups follow its way instead. Rests and turns do not depend on the place: if the device
    stays there, the scale factors and angles that they determine differ by Δ ~ N(0, C_r − C_m), and Δᵀ C_r⁻¹ Δ is at
    most χ² with as many degrees of freedom as there are values (Hausman 1978, Econometrica 46, 1251-1271). Biases are
    means over other times. Where rests and turns determine all linear parameters, motion must also reduce u."""
    linear = linear_names(at_rest.names)
    n, is_bias = len(linear), np.array([within_kind(group_name(name)) == "bias" for name in linear], dtype=bool)
    known = np.flatnonzero(at_rest.observable[:n] & ~is_bias)
    change = moving.values[known] - at_rest.values[known]
    square = float(change @ np.linalg.solve(at_rest.covariance[np.ix_(known, known)], change))
    if len(known) and scipy.special.chdtrc(len(known), square) < FALSE_ALARMS:
        return False
    gain = float(np.exp(np.log(moving.u[:n] / at_rest.u[:n]).mean()))
    complete = moving.converged and not linear_names(moving.unobservable)
    return bool(linear_names(at_rest.unobservable)) or (complete and gain < LEAST_GAIN)


def motion_note(estimate: Estimate, observations: Observations) -> tuple[str, ...]:
    """Return a note on a result from motion, with the point about which the device turned; none for rests and turns."""
    links, linearised = observations.links, estimate.linearised
    if links is None or linearised is None:
        return ()
    n, lever = len(observations.rests), linearised.point.local[0, -LEVER_COLUMNS - SUPPORT_COLUMNS : -SUPPORT_COLUMNS]
    place, size = ", ".join(f"{1e3 * x:.0f}" for x in lever), 1e3 * float(linearised.components.displacement)
    return (
        f"{IN_MOTION}, from {n} rest{'s' * (n != 1)} and {float(links.duration.sum()):.0f} s of it: "
        f"the device turned, to within {size:.2g} mm, about a point from which its accelerometers are at ({place}) mm",
    )


# -------------------- recordings --------------------


def no_rests(segmentation: Segmentation) -> Outcome:
    """Return the outcome of a log without rests."""
    seconds = segmentation.tuning.rest_seconds
    reason = f"no rest found: expected the device to lie still for at least {seconds} s in each position"
    reason += "".join(f"; {sentence}" for sentence in segmentation.passed_over())
    if segmentation.rejected:
        longest = max(segmentation.rejected, key=lambda r: r.stop - r.start)
        reason += f"; the longest quiet stretch, {longest.start:z.1f}–{longest.stop:z.1f} s, is none: {longest.reason}"
    advice = (
        "put it down in nine or more positions (`tumble programme` shows them); of accelerometers that were slowly "
        "waved through all attitudes `tumble ellipsoid LOG` makes what can be made; `tumble inspect` shows what was "
        "rejected"
    )
    return Outcome(reasons=(Advised(reason, advice),))


def unused_quiet_time(segmentation: Segmentation, *, in_motion: bool = False) -> tuple[str, ...]:
    """Return a remark if more than a third of the quiet time of a log is not used as rests.

    With `in_motion`, only shaken rests are unused, as moving ones are part of the motion."""
    used = sum(rest.stop - rest.start for rest in segmentation.rests)
    left_out = segmentation.shaken if in_motion else segmentation.rejected
    unused = sum(stretch.stop - stretch.start for stretch in left_out)
    if unused <= LARGEST_SHARE * (used + unused):
        return ()
    sentence = (
        f"{unused:.0f} s of {used + unused:.0f} s in which the device was quiet are not used as rests, more than a "
        "third (the notes say why)"
    )
    return (Advised(sentence, "let it lie still for longer, without vibration or sway"),)


# -------------------- gravity of the site --------------------


def gravity_anomaly(site: Site) -> float | None:
    """Return gravity of a site less normal gravity, m/s²; None if the latitude is unknown.

    Without a height normal gravity is that at sea level."""
    return None if site.latitude is None else site.gravity - normal_gravity(site.latitude, site.height or 0.0)


def anomaly_text(site: Site) -> str | None:
    """Return the difference to normal gravity in words; None if the latitude is unknown.

    Gravity equal to normal gravity whose uncertainty exceeds a milligal was not measured; its uncertainty is given."""
    anomaly = gravity_anomaly(site)
    if anomaly is None:
        return None
    if anomaly == 0.0 and site.gravity_u > MILLIGAL:
        return f"normal gravity assumed, u {two_digits(1e6 * site.gravity_u / site.gravity)} ppm"
    return f"{anomaly / MILLIGAL:+z.0f} mGal from normal gravity"


def gravity_text(site: Site) -> str:
    """Return gravity, with its difference to normal gravity if the latitude is known."""
    anomaly = anomaly_text(site)
    return f"gravity {site.gravity:.6f} m/s^2" + ("" if anomaly is None else f", {anomaly}")


# -------------------- time base of the log --------------------


def doubtful_time_base(estimate: Estimate, usual: float) -> tuple[str, ...]:
    """Return a remark if the scale factors of the gyros have a common error, as by a wrong time base.

    The mean of n scale-factor errors is N(0, σ²/n), beside its own uncertainty, that of the time base included. σ is
    estimated from the spread s of the n errors and the `usual` standard deviation over instruments of the grade, which
    counts as SPREAD_DEGREES degrees of freedom ν₀: σ² = (ν₀ usual² + (n − 1) s²)/(ν₀ + n − 1). The mean is tested by
    Student's t with the degrees of freedom of Welch and Satterthwaite."""
    gyro_scale = [i for i, name in enumerate(estimate.names) if group_name(name) == "gyro.scale"]
    n = len(gyro_scale)
    if n < len("xyz") or not estimate.observable[gyro_scale].all():
        return ()
    scale, degrees = estimate.values[gyro_scale], SPREAD_DEGREES + n - 1
    mean, spread = float(scale.mean()), float(scale.std(ddof=1))
    by_spread = (SPREAD_DEGREES * usual**2 + (n - 1) * spread**2) / degrees / n
    variance = by_spread + float(estimate.covariance[np.ix_(gyro_scale, gyro_scale)].mean())
    t = mean / np.sqrt(variance)
    if 2.0 * scipy.special.stdtr(degrees * (variance / by_spread) ** 2, -abs(t)) > FALSE_ALARMS:
        return ()
    sentence = (
        f"the scale factors of the gyros err alike, by {100.0 * mean:+.2g} %, and differ by {100.0 * spread:.2g} %: "
        "the sample rate or the time stamps are wrong by as much, or the nominal scale of the gyros is, "
        "indistinguishable in this session"
    )
    return (Advised(sentence, "measure the rate by a clock"),)
