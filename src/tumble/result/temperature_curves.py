"""Parameters over temperature: θ(T) = θ + θ₁ (T − T₀) + θ₂ (T − T₀)² + θ₃ (T − T₀)³, with uncertainty.

θ₁, θ₂ and θ₃ are the parameters `<name>.t1`, `<name>.t2` and `<name>.t3`, as far as a calibration has them, and T₀ is
its reference temperature. If θ itself is unknown, as for a device in one attitude, θ(T) is the change from T₀.
Temperatures are in °C. Beyond the measured range the polynomial is an extrapolation.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np

from tumble.result.coverage import degrees_of_factor
from tumble.result.parts import RestResult, coverage_factor, stated_factor
from tumble.result.record import CalibrationData, reference_of_parameter
from tumble.sensors.parameters import OVER_TEMPERATURE, units_of
from tumble.units import Array

_LEAST_SPAN = 0.05  # K, least span of temperatures of rests that determines coefficients


def rests_with_temperature(calibration: CalibrationData) -> list[RestResult]:
    """Return the rests of all launches that have a temperature."""
    return [rest for rest in calibration.evidence.all_rests if rest.temperature is not None]


def temperature_of(rest: RestResult, kind: str) -> float:
    """Return the mean temperature, °C, of the sensors of a kind at a rest, or that of the rest."""
    sensors = rest.accel if kind == "accel" else rest.gyro
    celsius = () if sensors is None else sensors.temperature
    return math.nan if rest.temperature is None else float(np.mean(celsius or rest.temperature))


def thermometer_notes(calibration: CalibrationData) -> list[str]:
    """Return a sentence that assigns thermometers to sensors, if there are several."""
    if len(set(chain(*calibration.temperature.thermometers.values()))) < 2:
        return []
    sentence = "the temperature of each sensor, and its reference, is that of its own thermometer"
    for i, (kind, columns) in enumerate(calibration.temperature.thermometers.items()):
        celsius = calibration.temperature.references.get(kind, ())
        labels = [f"{name} ({T:.1f} degC)" for name, T in zip(columns, celsius, strict=False)] or list(columns)
        which = f"that of {labels[0]}" if len(set(columns)) == 1 else f"those of {', '.join(labels)}, one a sensor"
        sentence += f"{'; of' if i else ': of'} {kind} {which}"
    return [sentence]


def measured_range(calibration: CalibrationData) -> tuple[float, float] | None:
    """Return the lowest and highest temperature, °C, of the rests of all launches; None without them or a range."""
    span = calibration.temperature_range
    return None if span is None or span[1] - span[0] < _LEAST_SPAN else span


def thermal_parameters(calibration: CalibrationData) -> tuple[str, ...]:
    """Return the names of the parameters that change with temperature, in the order of the file."""
    bases = (name.rpartition(".") for name in calibration)
    changed = dict.fromkeys(base for base, _, ending in bases if ending in OVER_TEMPERATURE)
    return (*(name for name in calibration if name in changed), *(name for name in changed if name not in calibration))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Curve:
    """Values (N,) of a parameter over temperatures, with expanded uncertainty U (N,), None without a covariance or
    where the degrees of freedom are too few anywhere."""

    name: str
    unit: str
    value: Array
    expanded: Array | None


def temperature_curve(calibration: CalibrationData, name: str, temperature: Array) -> Curve:
    """Evaluate a parameter over temperatures (N,), °C, with U = k u, u² = pᵀ Σ p, p = (1, T − T₀, …)."""
    places = {p.name: i for i, p in enumerate(calibration.parameters)}
    powers = [(0, name), *((d, f"{name}.{ending}") for d, ending in enumerate(OVER_TEMPERATURE, 1))]
    terms = [(d, places[each]) for d, each in powers if each in places]
    warmer = temperature - reference_of_parameter(calibration, name)
    P = np.stack([warmer**d for d, _ in terms], axis=1)
    members = [i for _, i in terms]
    parameters = [calibration.parameters[i] for i in members]
    S = None if calibration.covariance is None else calibration.covariance[np.ix_(members, members)]
    return Curve(
        name=name,
        unit=units_of([name])[0],
        value=P @ np.array([p.value for p in parameters]),
        expanded=None if S is None else _expanded(P, S, [p.dof for p in parameters]),
    )


def _expanded(P: Array, S: Array, dofs: Sequence[float | None]) -> Array | None:
    """Return U (N,) of P (N, m) times parameters with the covariance S (m, m) and these degrees of freedom (m,).

    The degrees of freedom of a sum are those of Welch and Satterthwaite (JCGM 100:2008, G.4.1) for independent
    parameters, except that they are at least the fewest of any parameter, because the formula gives too few where
    errors cancel, and that U is at least that of each term alone, because it gives too many where other terms have
    many."""
    u2 = np.einsum("ni,ij,nj->n", P, S, P)
    spread = (P**2 * np.diag(S)) ** 2 @ np.array([0.0 if dof is None else 1.0 / dof for dof in dofs])
    degrees = np.divide(u2**2, spread, out=np.full(len(u2), math.inf), where=spread > 0.0)
    degrees = np.maximum(degrees, min((dof for dof in dofs if dof is not None), default=math.inf))
    shares = np.minimum(np.abs(P) * np.sqrt(np.diag(S)) / np.sqrt(np.maximum(u2, 1e-300))[:, None], 1.0)
    for share, dof in zip(shares.T, dofs, strict=True):
        if dof is not None:
            of_term = (coverage_factor(dof) * share).tolist()
            degrees = np.minimum(degrees, [degrees_of_factor(k) or math.inf for k in of_term])
    factors = [k for k in map(stated_factor, degrees.tolist()) if k is not None]
    return np.array(factors) * np.sqrt(u2) if len(factors) == len(u2) else None
