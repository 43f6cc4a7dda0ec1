"""Summaries of a calibration in words and numbers, for terminal, notebook and report."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from math import inf, sqrt

import numpy as np
import scipy

from tumble.inference.estimate import Fit
from tumble.inference.prediction import Prediction
from tumble.result.calibration import Calibration
from tumble.result.correction import correction_errors
from tumble.result.coverage import notes_without_expanded
from tumble.result.parts import Evidence, Launch, Parameter
from tumble.sensors.model import WORDS
from tumble.sensors.parameters import beyond_linear, group_name, named_group, sensor_kind
from tumble.units import Array, engineering, two_digits

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
    size, unit = engineering("m/s^2", prediction.force_u)
    sentence = f"corrected specific force at 1 g: u {two_digits(prediction.force_u / size)} {unit}"
    if prediction.rate_u is None or prediction.at_rate is None:
        return sentence
    size, unit = engineering("rad/s", prediction.rate_u)
    turned, per = engineering("rad/s", prediction.at_rate)
    rate, u = two_digits(prediction.at_rate / turned), two_digits(prediction.rate_u / size)
    return f"{sentence}; corrected rate at {rate} {per}: u {u} {unit}"


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
        rms = float(np.sqrt(np.mean(errors**2)))
        return f"up to {two_digits(float(errors.max()) / size)} {per} (rms {two_digits(rms / size)} {per})"

    sentence = f"with matrix and bias alone: off by {shown('m/s^2', force)} at 1 g"
    if at_rate is None:
        return sentence
    size, per = engineering("rad/s", at_rate)
    return f"{sentence}, and by {shown('rad/s', rate)} at {two_digits(at_rate / size)} {per} in 1 g"


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
