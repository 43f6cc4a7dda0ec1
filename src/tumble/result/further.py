"""Summaries of a calibration in words and numbers, for terminal, notebook and report.

Among these are the errors of tilt, heading and position of a vehicle without aid, before and after calibration
(`unaided`). The vehicle stands with one axis of the body up, levels itself by its accelerometers, turns to any heading,
and is then navigated by its inertial sensors alone for a time t, without turning. To first order the horizontal errors
are

    tilt      φ = f/g + ω t                                                                                      (1)
    heading   ψ = ω_u t                                                                                          (2)
    position  r = ½ (f + g f/g) t² + g ω t³/6                                                                    (3)

f is the horizontal error of the specific force at rest, and ω and ω_u are the errors of the rate about the horizontal
axes and the vertical. Levelling tilts the attitude by f/g; at that heading the component of gravity added by the tilt
cancels f. In the turn f turns with the body but the tilt does not: over all headings the two are uncorrelated and add
in quadrature. The drift ω t adds the acceleration g ω t, integrated twice in (3).

With the biases b and the axis angles α of the accelerometers, and the gyro biases β, over all three axes up or down,

    f² = (2/3) Σ b² + (g²/3) Σ α²,   ω² = (2/3) Σ β²,   ω_u² = (1/3) Σ β²                                        (4)

summed over both horizontal axes. Before calibration the squares are those of the parameters themselves, after it their
variances in the next recording, with in-run bias and, where known, changes from launch to launch. Noise, errors of
scale factors (which need motion) and products of the Earth's rate and gyro errors are neglected.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import hypot, inf, sqrt

import numpy as np
import scipy

from tumble.inference.estimate import Fit
from tumble.inference.prediction import Prediction
from tumble.result.accepted import accepted_kinds
from tumble.result.calibration import Calibration
from tumble.result.correction import correction_errors
from tumble.result.coverage import notes_without_expanded
from tumble.result.parts import Evidence, Launch, Parameter
from tumble.rotation import left_inverse
from tumble.sensors.model import WORDS, SensorKind
from tumble.sensors.parameters import beyond_linear, group_name, named_group, sensor_kind
from tumble.units import DEGREE, G_STANDARD, Array, coarsest, engineering, two_digits

BY_PRIOR = 0.5  # learned fraction below which the prior determines a parameter rather than the data
OPEN_BIAS_RATIO = 2.0  # u of a single bias to that of the corrected force, above which a prior decides the bias
OTHER_THAN_TWO = 0.05  # difference of a coverage factor from 2 above which the factor is shown
NEGLIGIBLE = 1e-9  # m/s², rad/s: rounding of double precision
HIDDEN_PROBABILITY = 0.05  # of a chi-square as small as the observed one with the largest undetected scatter
SENSORS = {"accel": "accelerometer", "gyro": "gyro", "mag": "magnetometer"}
_NAME = re.compile(
    r"(?P<kind>accel|gyro|mag)\.(?:axis\.(?P<pair>[xyz]{2})|(?P<what>bias|scale|axis)\."
    r"(?:(?P<letter>[xyz])|(?P<number>\d+))(?:\.(?P<angle>[12]))?)"
)
SECONDS = 60.0  # without aid
_FORCES = ((1e-6 * G_STANDARD, " µg"), (1e-3 * G_STANDARD, " mg"))
_PARTS = ((1e-6, " ppm"), (1e-2, " %"))
_ANGLES = ((DEGREE / 3600.0, "″"), (DEGREE / 60.0, "′"), (DEGREE, "°"))
_LENGTHS = ((1e-2, " cm"), (1.0, " m"), (1e3, " km"))


def parameter_words(name: str) -> str:
    """Return a parameter in words: "X accelerometer, bias", "Y accelerometer, axis towards X"."""
    match = _NAME.fullmatch(name)
    if match is None:
        return ""
    block = SENSORS[match["kind"]]
    if match["pair"]:
        return f"{match['pair'][0].upper()} {block}, axis towards {match['pair'][1].upper()}"
    sensor = f"{block} {match['number']}" if match["number"] else f"{match['letter'].upper()} {block}"
    words = {"bias": "bias", "scale": "scale-factor error", "axis": f"axis angle {match['angle']}"}
    return f"{sensor}, {words[match['what']]}"


def linear_parameters(parameters: Sequence[Parameter]) -> tuple[Parameter, ...]:
    """Return the parameters of the linear model: bias, scale factor, axis angles."""
    return tuple(p for p in parameters if not beyond_linear(p.name))


def further_parameters(parameters: Sequence[Parameter]) -> tuple[Parameter, ...]:
    """Return the parameters of the groups beyond the linear model."""
    return tuple(p for p in parameters if beyond_linear(p.name))


def by_group(parameters: Iterable[Parameter]) -> dict[str, list[Parameter]]:
    """Return parameters by the names of their groups, in their order."""
    out: dict[str, list[Parameter]] = {}
    for p in parameters:
        out.setdefault(group_name(p.name), []).append(p)
    return out


def prediction_text(prediction: Prediction) -> str:
    """Return a sentence with the uncertainty of corrected readings."""
    sentence = f"corrected specific force at 1 g: u {_quantity('m/s^2', prediction.force_u)}"
    if prediction.rate_u is None or prediction.at_rate is None:
        return sentence
    rate, u = (_quantity("rad/s", each) for each in (prediction.at_rate, prediction.rate_u))
    return f"{sentence}; corrected rate at {rate}: u {u}"


def _quantity(unit: str, value: float) -> str:
    size, name = engineering(unit, value)
    return f"{two_digits(value / size)} {name}"


def decided_by_priors(calibration: Calibration) -> str | None:
    """Return a sentence on groups whose priors decide the biases of the accelerometers; None if the data decide."""
    biases = [p.u for p in calibration.parameters if group_name(p.name) == "accel.bias" and p.u]
    groups, findings = [], {group.name: group.learned for group in calibration.groups}
    for name, members in by_group(further_parameters(calibration.parameters)).items():
        entry = named_group(name)
        learned = findings.get(name) or [p.learned for p in members if p.learned is not None]
        seen_at_rest = entry is not None and entry.kind == "accel" and entry.regressors is not None
        if entry is not None and seen_at_rest and min(learned, default=1.0) < BY_PRIOR:
            groups.append(entry.words)
    if calibration.prediction is None or not biases or not groups:
        return None
    ratio = max(biases) / calibration.prediction.force_u
    if ratio <= OPEN_BIAS_RATIO:
        return None
    return (
        f"the usual size, not the data, decides u of {'; '.join(groups)}: u of a single bias is up to {ratio:.1f} "
        "times that of the corrected specific force; rests in oblique attitudes (corners, edges) would settle it: "
        "tumble plan"
    )


def verdicts(calibration: Calibration) -> tuple[str, ...]:
    """Return the verdict, after those of accelerometers and gyros if these differ."""
    outcome = calibration.outcome
    names = (*(p.name for p in calibration.parameters), *outcome.unobservable)
    has_both = {"accel", "gyro"} <= {sensor_kind(name) for name in names}
    if not has_both or outcome.accel.verdict == outcome.gyro.verdict:
        return (outcome.verdict,)
    return f"accelerometers: {outcome.accel.verdict}", f"gyros: {outcome.gyro.verdict}", outcome.verdict


def accepted_groups(calibration: Calibration) -> tuple[str, ...]:
    """Return the accepted groups of parameters of sensors that are not accepted as a whole."""
    outcome, groups = calibration.outcome, {group_name(p.name) for p in calibration.parameters}
    accepted = (name for name, judgement in outcome.groups.items() if judgement and name in groups)
    return tuple(name for name in accepted if not outcome.of(sensor_kind(name)))


def recording_dates(calibration: Calibration) -> list[str]:
    """Return the known dates of the recordings behind a calibration, ISO 8601, in order and each once."""
    evidence = calibration.evidence
    dates = {launch.circumstances.date for launch in evidence.launches} | {each.date for each in evidence.together}
    return sorted(date for date in dates | {calibration.provenance.circumstances.date} if date is not None)


def rest_summary(recorded: Evidence | Launch) -> str:
    """Return a sentence on the residuals of rests and turns."""
    rests, turns = recorded.rests, recorded.turns
    rms = sqrt(sum(rest.residual**2 for rest in rests) / len(rests))
    worst = max(range(len(rests)), key=[abs(rest.residual) for rest in rests].__getitem__)
    size, unit = engineering("m/s^2", rms)
    sentence = (
        f"{len(rests)} rests: corrected readings miss g by {rms / size:.3g} {unit} (rms), at most by "
        f"{abs(rests[worst].residual) / size:.3g} {unit} (rest {worst + 1})"
    )
    if not turns:
        return sentence
    return f"{sentence}; {len(turns)} turns, the worst {max(turn.sigmas for turn in turns):z.1f} sigma from the fit"


def has_other_factors(parameters: Sequence[Parameter]) -> bool:
    """Return True if the coverage factor of any parameter is not 2."""
    return any(p.k is None or abs(p.k - 2.0) > OTHER_THAN_TWO for p in parameters if p.u)


def linear_errors_text(calibration: Calibration) -> str:
    """Return a sentence on the errors of a correction by matrix and bias alone; empty if these are the whole model.

    These errors are of the specific force at 1 g in all attitudes, and of the rate of the prediction about all axes."""
    if calibration.accel is None or calibration.compensator.linear:
        return ""
    prediction = calibration.prediction
    at_rate = None if calibration.gyro is None or prediction is None else prediction.at_rate
    force = correction_errors(calibration, "accel", calibration.accel.apply)
    rate = np.zeros(1)
    if calibration.gyro is not None and at_rate is not None:
        rate = correction_errors(calibration, "gyro", calibration.gyro.apply)
    if max(force.max(), rate.max()) < NEGLIGIBLE:
        return "with matrix and bias alone: exact at the reference temperature"

    def shown(unit: str, errors: Array) -> str:
        size, per = engineering(unit, float(errors.max()))
        rms = two_digits(float(np.sqrt(np.mean(errors**2))) / size)
        return f"up to {_quantity(unit, float(errors.max()))} (rms {rms} {per})"

    sentence = f"with matrix and bias alone: off by {shown('m/s^2', force)} at 1 g"
    if at_rate is None:
        return sentence
    return f"{sentence}, and by {shown('rad/s', rate)} at {_quantity('rad/s', at_rate)} in 1 g"


def remarks(calibration: Calibration) -> tuple[str, ...]:
    """Return remarks on parameters without U, and on scatter that few residuals may not reveal."""

    def hidden_scatter(fit: Fit) -> float:
        """Return the largest scatter, in units of the noise, for which chi-square is as small with
        HIDDEN_PROBABILITY."""
        least = 2.0 * float(scipy.special.gammaincinv(0.5 * fit.degrees, HIDDEN_PROBABILITY))
        return sqrt(max(fit.chi_square / least - 1.0, 0.0)) if least > 0.0 else inf

    sentences = list(notes_without_expanded(calibration.parameters))
    if calibration.evidence.launches:
        return tuple(sentences)
    for kind, sensors in WORDS.items():
        groups = [fit for name, fit in calibration.evidence.fits.items() if name.startswith(kind) and fit.degrees > 0.0]
        scatters = [(hidden_scatter(fit), fit.degrees) for fit in groups if fit.scatter == 0.0]
        largest, degrees = max(scatters, default=(0.0, 0.0))
        if 1.0 < largest < inf:
            sentences.append(
                f"no scatter of the {sensors} was detected, with {degrees:.2g} degrees of freedom to show one: U "
                f"covers the noise within rests and turns; a scatter of up to {largest:.2g} times that noise may be "
                "undetected"
            )
    return tuple(sentences)


@dataclass(frozen=True, kw_only=True, slots=True)
class Unaided:
    """Root mean square errors: `tilt` about both horizontal axes and `heading`, rad, and horizontal `position`, m."""

    tilt: float
    heading: float
    position: float


def unaided(calibration: Calibration, seconds: float = SECONDS) -> tuple[Unaided, Unaided] | None:
    """Return the errors of a vehicle without aid for some seconds, before and after calibration.

    None if the calibration lacks accelerometers, gyros, uncertainties, biases or axis angles, or has more than three
    sensors of a kind."""
    accel, gyro, site = calibration.accel, calibration.gyro, calibration.provenance.site
    if accel is None or gyro is None or len(accel.bias) != 3 or len(gyro.bias) != 3:
        return None
    gravity = G_STANDARD if site is None else site.gravity
    next_u = {bias.name: bias.next_u for bias in calibration.evidence.process_bias}
    before, after = dict[str, float](), dict[str, float]()
    for p in calibration.parameters:
        if beyond_linear(p.name):
            continue
        if p.u is None:
            return None
        group = group_name(p.name)
        variance = max(p.u, next_u.get(p.name, 0.0)) ** 2 + (p.run_to_run or 0.0) ** 2
        before[group] = before.get(group, 0.0) + p.value**2
        after[group] = after.get(group, 0.0) + variance
    if not {"accel.bias", "accel.axis", "gyro.bias"} <= before.keys():
        return None
    results = []
    for squares in (before, after):  # Eq. (4), and (1) to (3)
        force = sqrt(2.0 / 3.0 * squares["accel.bias"] + gravity**2 / 3.0 * squares["accel.axis"])
        rate_up = sqrt(squares["gyro.bias"] / 3.0)
        rate = sqrt(2.0) * rate_up
        results.append(
            Unaided(
                tilt=hypot(force / gravity, rate * seconds),
                heading=rate_up * seconds,
                position=hypot(sqrt(0.5) * force * seconds**2, gravity * rate * seconds**3 / 6.0),
            )
        )
    return results[0], results[1]


def improvement(calibration: Calibration) -> tuple[str, ...]:
    """Return up to two sentences on what the calibration improves: errors of readings, and of a vehicle without aid.

    After calibration the error of a reading is its standard uncertainty, before it also the correction, root mean
    square over all attitudes at rest or over all axes at the rate of the session's turns. Sensors that are not accepted
    are left out."""
    prediction, accepted, clauses = calibration.prediction, accepted_kinds(calibration), list[str]()
    if prediction is not None and "accel" in accepted:
        before, after = _off_by(calibration, "accel", prediction.force_u)
        open_angles = any(group_name(name) == "accel.axis" for name in calibration.outcome.unobservable)
        why = " (these rests do not determine the axis angles)" if open_angles else ""
        clauses.append(f"at rest off by {_change(before, after, _FORCES, 0.01)}{why}")
    if prediction is not None and prediction.rate_u is not None and prediction.at_rate and "gyro" in accepted:
        before, after = _off_by(calibration, "gyro", prediction.rate_u)
        rate = prediction.at_rate
        clauses.append(
            f"rates off by {_change(before / rate, after / rate, _PARTS, 0.01)} of {two_digits(rate / DEGREE)} °/s"
        )
    lines = ["; ".join(clauses)] if clauses else []
    if (before_and_after := unaided(calibration)) is not None and len(accepted) == len(before_and_after):
        errors = (("tilt", _ANGLES), ("heading", _ANGLES), ("position", _LENGTHS))
        first, last = before_and_after
        changes = (f"{name} {_change(getattr(first, name), getattr(last, name), units)}" for name, units in errors)
        lines.append(f"after {SECONDS:.0f} s without aid: {', '.join(changes)}")
    return tuple(lines)


def _change(corrected: float, remaining: float, units: Sequence[tuple[float, str]], limit: float = 1.0) -> str:
    """Return both errors with an arrow between, each in the largest unit in which it is at least `limit`.

    The error before calibration contains the correction and the remaining error."""
    shown = ((value, *coarsest(units, value, limit=limit)) for value in (hypot(corrected, remaining), remaining))
    return " → ".join(f"{two_digits(value / size)}{name}" for value, size, name in shown)


def _off_by(calibration: Calibration, kind: SensorKind, u: float) -> tuple[float, float]:
    """Return the root mean square error of uncorrected vectors, and the standard uncertainty of corrected vectors if
    that of each sensor is u, SI."""
    block, _ = calibration.compensator.sensors(kind)
    assert block is not None
    nominal = left_inverse(block.axes)
    off = correction_errors(calibration, kind, lambda readings: readings @ nominal.T)
    return float(np.sqrt(np.mean(off**2))), u * float(np.linalg.norm(nominal))
