"""Parameters over temperature: θ(T) = θ + θ₁ (T − T₀) + θ₂ (T − T₀)² + θ₃ (T − T₀)³ with its uncertainty, and the
temperatures at which it was measured.

θ₁ is the parameter `<name>.t1`, θ₂ `<name>.t2` and θ₃ `<name>.t3` where a calibration has them; T₀ its reference
temperature. Where it does not know θ, as of a device that lay in one attitude, it is the change from T₀. Temperatures
are in °C. Beyond the measured range the polynomial is an extrapolation.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import chain

import numpy as np

from tumble.result.parts import RestResult, stated_factor
from tumble.result.record import CalibrationData, reference_of_parameter
from tumble.sensors.parameters import OVER_TEMPERATURE, units_of
from tumble.units import Array

_LEAST_SPAN = 0.05
"""K: rests whose temperatures are closer show nothing over temperature."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Range:
    """The lowest and the highest temperature of a rest, °C."""

    low: float
    high: float

    def temperatures(self, count: int = 201) -> Array:
        """Temperatures (count,), °C, equally spaced from end to end."""
        return np.linspace(self.low, self.high, count)

    def __str__(self) -> str:
        """Both ends to a tenth of a degree."""
        return f"{self.low:.1f} to {self.high:.1f} °C"


def rests_with_temperature(calibration: CalibrationData) -> list[RestResult]:
    """The rests of all launches that have a temperature."""
    rests = chain(calibration.evidence.rests, *(launch.rests for launch in calibration.evidence.launches))
    return [rest for rest in rests if rest.temperature is not None]


def temperature_of(rest: RestResult, kind: str) -> float:
    """The mean temperature, °C, of the sensors of a kind at a rest; that of the rest where they are not known."""
    sensors = rest.accel if kind == "accel" else rest.gyro
    celsius = () if sensors is None else sensors.temperature
    return math.nan if rest.temperature is None else float(np.mean(celsius or rest.temperature))


def thermometer_notes(calibration: CalibrationData) -> list[str]:
    """Which thermometer the temperature of each sensor is that of, where there are several."""
    if len(set(chain(*calibration.temperature.thermometers.values()))) < 2:
        return []
    sentence = "the temperature of each sensor, and its reference, is that of its own thermometer"
    for i, (kind, columns) in enumerate(calibration.temperature.thermometers.items()):
        celsius = calibration.temperature.references.get(kind, ())
        labels = [f"{name} ({T:.1f} degC)" for name, T in zip(columns, celsius, strict=False)] or list(columns)
        which = f"that of {labels[0]}" if len(set(columns)) == 1 else f"those of {', '.join(labels)}, one a sensor"
        sentence += f"{'; of' if i else ': of'} {kind} {which}"
    return [sentence]


def measured_range(calibration: CalibrationData) -> Range | None:
    """The range of temperatures of the rests of all launches; None where they have none, or all the same."""
    span = calibration.temperature_range
    if span is None or span[1] - span[0] < _LEAST_SPAN:
        return None
    return Range(low=span[0], high=span[1])


def thermal_parameters(calibration: CalibrationData) -> tuple[str, ...]:
    """Names of the parameters that change with temperature, in the order of the file."""
    bases = (name.rpartition(".") for name in calibration)
    changed = dict.fromkeys(base for base, _, ending in bases if ending in OVER_TEMPERATURE)
    return (*(name for name in calibration if name in changed), *(name for name in changed if name not in calibration))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Curve:
    """A parameter (N,) over temperatures (N,), °C, and its expanded uncertainty U (N,), both SI; U is None where the
    calibration has no covariance, or somewhere too few degrees of freedom for a U; `degrees` (N,) are these."""

    name: str
    unit: str
    temperature: Array
    value: Array
    expanded: Array | None
    degrees: Array | None = None


def temperature_curve(calibration: CalibrationData, name: str, temperature: Array) -> Curve:
    """A parameter over temperatures (N,), °C: value and U = k u with u² = pᵀ Σ p, p = (1, T − T₀, …), and k by the
    effective degrees of freedom of the sum."""
    places = {p.name: i for i, p in enumerate(calibration.parameters)}
    powers = [(0, name), *((d, f"{name}.{ending}") for d, ending in enumerate(OVER_TEMPERATURE, 1))]
    terms = [(d, places[each]) for d, each in powers if each in places]
    warmer = temperature - reference_of_parameter(calibration, name)
    P = np.stack([warmer**d for d, _ in terms], axis=1)
    members = [i for _, i in terms]
    parameters, expanded, degrees = [calibration.parameters[i] for i in members], None, None
    if calibration.covariance is not None:
        # Welch–Satterthwaite (JCGM 100:2008, G.4.1). Parameters that go against each other have a sum known better than
        # they are, to which it does not apply: a sum has at least the degrees of freedom of the parameter that has
        # least, as it has where they are independent
        S = calibration.covariance[np.ix_(members, members)]
        u2 = np.einsum("ni,ij,nj->n", P, S, P)
        per_degree = np.array([0.0 if p.dof is None else 1.0 / p.dof for p in parameters])
        spread = (P**2 * np.diag(S)) ** 2 @ per_degree
        degrees = np.divide(u2**2, spread, out=np.full(len(u2), math.inf), where=spread > 0.0)
        least = min((p.dof for p in parameters if p.dof is not None), default=math.inf)
        degrees = np.maximum(degrees, least)
        factors = [k for k in map(stated_factor, degrees.tolist()) if k is not None]
        expanded = np.array(factors) * np.sqrt(u2) if len(factors) == len(u2) else None
    return Curve(
        name=name,
        unit=units_of([name])[0],
        temperature=temperature,
        value=P @ np.array([p.value for p in parameters]),
        expanded=expanded,
        degrees=degrees,
    )
