"""What navigation filters ask for of the noise that a record at rest shows, and why they are given more.

Filters know two processes, white noise n of a density and a bias that walks, k. Of the processes of a channel
(`NoiseParameters`) these are as large as they over the times that count,

    n² = N² + 3 Q²/Δ       quantisation Q as white noise over one sample Δ
    k² = K² + Σ 2 σ²/T + 3 (2 ln 2/π)² B⁴/N²        what Gauss–Markov noise grows by before it is as old as T; and a
                                                    walk through the flat part where it meets the white noise

and of several channels the largest. A ramp, as of a warm-up, is no noise: a filter follows it as a bias. Where no slow
process shows, k is the largest that the Allan deviation allows, k² ≤ 3 σ²(τ)/τ everywhere.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from tumble.reduction.noise.wavelet_moments import FLICKER, NoiseParameters, Panel

RUN = 600.0
"""s, over which a filter without bias states has to live with what the bias becomes."""
AUTOPILOT_STEP = 0.01
"""s, of the estimators of PX4 and ArduPilot (10 and 12 ms)."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Densities:
    """White noise, SI/√Hz, and random walk of the bias, SI/s/√Hz, of one kind, the largest of its channels; what the
    record did not show and was bounded by, in sentences."""

    white: float
    walk: float
    bounds: tuple[str, ...] = ()


def densities(panel: Panel, rate: float) -> Densities:
    """The white noise and the walking bias that stand for the processes of a kind of sensors."""
    high, tau = panel.deviation.high, panel.deviation.tau[:, None]
    whites = [_white(p, rate) for p in panel.parameters]
    walks = [_walk(p) for p in panel.parameters]
    bounds = []
    for term, found, most in (
        ("white noise", whites, (high * np.sqrt(tau)).min(axis=0)),
        ("random walk", walks, (high * np.sqrt(3.0 / tau)).min(axis=0)),
    ):
        if 0.0 in found:
            found[:] = [value or float(bound) for value, bound in zip(found, most, strict=True)]
            bounds.append(
                f"{term} of the {panel.title}: not seen in every channel, so the largest that the record allows is "
                "written; record longer"
            )
    return Densities(white=max(whites), walk=max(walks), bounds=tuple(bounds))


def _white(p: NoiseParameters, rate: float) -> float:
    """n of a channel; 0 where it shows neither white noise nor quantisation."""
    N, Q = (0.0 if c is None else c.value for c in (p.white_noise, p.quantisation))
    return float(np.sqrt(N**2 + 3.0 * Q**2 * rate))


def _walk(p: NoiseParameters) -> float:
    """k of a channel; 0 where it shows nothing slow."""
    square = 0.0 if p.rate_random_walk is None else p.rate_random_walk.value**2
    square += sum(2.0 * each.sigma.value**2 / each.time.value for each in p.gauss_markov)
    if p.bias_instability is not None and p.white_noise is not None:
        square += 3.0 * (FLICKER * p.bias_instability.value**2 / p.white_noise.value) ** 2
    return float(np.sqrt(square))


@dataclass(frozen=True, kw_only=True, slots=True)
class FilterValue:
    """A parameter of a filter: what the record says, the value to begin with, and why that is more."""

    filter: str
    parameter: str
    unit: str
    measured: float
    value: float
    why: str


_MOTION = (
    "10 times: vibration, scale factors, temperature and stamps are in no record at rest; a maintainer of Kalibr names "
    "10 to 20 times"
)
_VIBRATION = "10 times; not below the default of the autopilot: a frame with propellers shakes"
_BOUNDED = "not seen: the largest that the record allows, as it is"
_BIASLESS = (
    "variance of a sample, and of what the bias becomes in ten minutes: this filter estimates no bias, and takes what "
    "stays for noise"
)
_KINDS: Mapping[str, tuple[str, str]] = {"accelerometers": ("accel", "m/s^2"), "gyros": ("gyro", "rad/s")}


def filter_values(panels: tuple[Panel, ...], rate: float) -> list[FilterValue]:
    """Values for Kalibr and OpenVINS, VINS-Mono and VINS-Fusion, robot_localization, ArduPilot and PX4."""
    out = []
    for panel in panels:
        found, (kind, unit) = densities(panel, rate), _KINDS[panel.title]
        bounded = [any(bound.startswith(term) for bound in found.bounds) for term in ("white noise", "random walk")]
        per_sample, per_step = np.sqrt(rate), np.sqrt(1.0 / AUTOPILOT_STEP)
        for name, parameters, units, factor, least, why in _FILTERS[kind]:
            scale = {"density": 1.0, "sample": per_sample, "step": per_step}[factor]
            for density, few, parameter, in_unit, default in zip(
                (found.white, found.walk), bounded, parameters, units, least, strict=True
            ):
                value = float(density * scale)
                more = max(value if few else 10.0 * value, default)
                said = f"{_BOUNDED}; {why.partition('; ')[2]}".rstrip("; ") if few else why
                out.append(
                    FilterValue(filter=name, parameter=parameter, unit=in_unit, measured=value, value=more, why=said)
                )
        variance, becomes = found.white**2 * rate, max(_becomes(p) for p in panel.parameters)
        field = "linear_acceleration_covariance" if kind == "accel" else "angular_velocity_covariance"
        out.append(
            FilterValue(
                filter="robot_localization",
                parameter=field,
                unit=f"({unit})²",
                measured=variance,
                value=variance + becomes**2,
                why=_BIASLESS,
            )
        )
    return out


def _becomes(p: NoiseParameters) -> float:
    """Standard deviation of what the bias of a channel becomes in RUN, beside its white noise."""
    square = sum(each.sigma.value**2 for each in p.gauss_markov)
    square += 0.0 if p.bias_instability is None else p.bias_instability.value**2
    square += 0.0 if p.rate_random_walk is None else p.rate_random_walk.value**2 * RUN
    return float(np.sqrt(square))


def _filters(kind: str) -> list[tuple[str, tuple[str, str], tuple[str, str], str, tuple[float, float], str]]:
    """Filters with a white noise and a walking bias: names, parameters, units, by what they count, defaults below which
    no value goes, and why more is given."""
    long, short, ekf = ("accelerometer", "acc", "ACC") if kind == "accel" else ("gyroscope", "gyr", "GYR")
    unit = "m/s^2" if kind == "accel" else "rad/s"
    density, sampled = (f"{unit}/√Hz", f"{unit}/s/√Hz"), (unit, f"{unit}/s")
    ardupilot = ("EK3_ACC_P_NSE", "EK3_ABIAS_P_NSE") if kind == "accel" else ("EK3_GYRO_P_NSE", "EK3_GBIAS_P_NSE")
    noise, of_ardupilot, of_px4 = (0.35, 0.02, 0.003) if kind == "accel" else (0.015, 0.001, 0.001)
    return [
        ("Kalibr, OpenVINS", (f"{long}_noise_density", f"{long}_random_walk"), density, "density", (0.0, 0.0), _MOTION),
        ("VINS", (f"{short}_n", f"{short}_w"), sampled, "sample", (0.0, 0.0), _MOTION),
        ("ArduPilot", ardupilot, sampled, "step", (noise, of_ardupilot), _VIBRATION),
        ("PX4", (f"EKF2_{ekf}_NOISE", f"EKF2_{ekf}_B_NOISE"), sampled, "step", (noise, of_px4), _VIBRATION),
    ]


_FILTERS = {kind: _filters(kind) for kind in ("accel", "gyro")}
"""Defaults are those of ArduPilot 4 and PX4 1.14."""
