"""Autopilots over temperature: their offsets follow a cubic of the temperature between two ends, nothing else does.

    reading − cubic(T) − offset, T kept within TMIN … TMAX

The biases of a calibration are polynomials of the second degree at most, so a cubic holds them whole; TMIN and TMAX are
the ends of what was measured. Scale factors have one value each, that at the reference temperature.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tumble.calibration.calibration_file import Calibration
from tumble.calibration.temperature_curves import Range, changing, coefficients, measured_range, model_at
from tumble.errors import InputError
from tumble.export.autopilot import Diagonal, diagonal
from tumble.export.exported import example, shown, worst
from tumble.export.larger_model import session_rate
from tumble.sensors.parameters import group_name
from tumble.units import DEGREE, G_STANDARD, Array

HELD = ("accel.bias.t1", "accel.bias.t2", "gyro.bias.t1", "gyro.bias.t2")
SCALES = ("accel.scale.t1", "accel.scale.t2", "gyro.scale.t1", "gyro.scale.t2")
"""Not held, with a sentence of their own."""

_NOTHING = 1e-12
"""mg or deg/s: rounding of double precision."""

Offsets = Callable[[str, Array], Array]
"""The offsets (N, 3), SI, that a target takes off the readings of a kind of sensors at temperatures (N,), °C."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Thermal:
    """What an autopilot holds of a calibration over temperature: what it holds at the `reference`, °C, and by kind how
    the biases change, (3, 2), per K and per K², within the range that was measured."""

    held: Diagonal
    calibration: Calibration
    reference: float
    measured: Range
    slopes: dict[str, Array]

    def losses(self, offsets: Offsets) -> tuple[str, ...]:
        """What is lost over temperature, and how much of it within the measured range; `offsets` are the target's."""
        return (
            self._curves(offsets),
            self._scales(),
            *self._hysteresis(),
            f"outside {_plain(self.measured)} nothing was measured: the target keeps the offsets of the nearer end",
        )

    def examples(self, offsets: Offsets) -> list[str]:
        """Readings at the warmer end, what the autopilot makes of them and what they are, line by line."""
        out, at = [], warm_end(self.measured)
        for kind in self.held.known:
            model = model_at(self.calibration, kind, at)
            worked = example(kind, model)
            factor = self.held.accel_factor if kind == "accel" else 1.0
            target = (worked.reading - offsets(kind, np.array([at]))[0]) * factor
            out.append(
                f"example {kind} at {at:g} degC: reading {shown(worked.reading)} becomes {shown(target.round(6))}; "
                f"it is {shown(worked.true.round(6))}"
            )
        return out

    def steepest(self) -> tuple[float, float]:
        """The largest change of a bias per K within the range: accelerometers, m/s²/K, and gyros, rad/s/K."""
        ends = np.array([self.measured.low, self.measured.high]) - self.reference
        found = {kind: float(np.abs(own[:, :1] + 2.0 * own[:, 1:] * ends).max()) for kind, own in self.slopes.items()}
        return found["accel"], found.get("gyro", 0.0)

    def _curves(self, offsets: Offsets) -> str:
        temperature = self.measured.temperatures()
        error = {
            kind: float(np.abs(offsets(kind, temperature) - self._biases(kind, temperature)).max())
            for kind in self.slopes
        }
        return (
            f"offsets over temperature: from {_plain(self.measured)} the cubic is within "
            f"{said(error['accel'], error.get('gyro'))} of the calibration's curve"
        )

    def _biases(self, kind: str, temperature: Array) -> Array:
        """The biases (N, 3) of the calibration."""
        warmer = (temperature - self.reference)[:, None]
        linear, square = self.slopes[kind].T
        return np.asarray(self.held.known[kind].bias + linear * warmer + square * warmer**2)

    def _scales(self) -> str:
        """The largest error that scale factors without a temperature make."""
        rate, error = session_rate(self.calibration), {}
        warmer = (self.measured.temperatures() - self.reference)[:, None]
        for kind, model in self.held.known.items():
            linear, square = coefficients(self.calibration, kind, "scale").T
            longer = linear * warmer + square * warmer**2
            unit = model.matrix / np.linalg.norm(model.matrix, axis=1)[:, None]
            applied = np.diag(model.matrix)[:, None] if kind == "accel" else 1.0
            error[kind] = max(worst(each[:, None] * unit / applied) for each in longer)
        gyro = error.get("gyro")
        where = "in 1 g" if gyro is None else f"in 1 g at {rate / DEGREE:.3g} deg/s"
        return (
            f"scale factors over temperature: no place in this file, from {_plain(self.measured)} an error of up to "
            f"{said(G_STANDARD * error['accel'], None if gyro is None else rate * gyro)} {where}"
        )

    def _hysteresis(self) -> list[str]:
        largest = [
            max((abs(p.value) for p in self.calibration.parameters if _is_hysteresis(p.name, kind)), default=0.0)
            for kind in ("accel", "gyro")
        ]
        accel, gyro = largest
        return [f"hysteresis of the biases: no place in this file, up to {said(accel, gyro)}"] if any(largest) else []


def thermal(calibration: Calibration, target: str) -> Thermal:
    """What an autopilot can hold of a calibration over temperature. Raises InputError where nothing changes with it,
    or where the rests were all at one."""
    held = diagonal(calibration, target, apart=(*HELD, *SCALES))
    measured = range_of(calibration, target)
    return Thermal(
        held=held,
        calibration=calibration,
        reference=float(calibration.reference_temperature or 0.0),
        measured=measured,
        slopes={kind: coefficients(calibration, kind, "bias") for kind in held.known},
    )


def range_of(calibration: Calibration, target: str) -> Range:
    """The temperatures at which a calibration was measured. Raises InputError where there is nothing over them."""
    measured = measured_range(calibration)
    if calibration.reference_temperature is None or not changing(calibration):
        raise InputError(
            f"export to {target}: expected parameters that change with temperature, such as accel.bias.x.t1, found "
            "none; calibrate a session with a thermometer"
        )
    if measured is None:
        raise InputError(
            f"export to {target}: expected rests at several temperatures, found one; record while it gets warmer"
        )
    return measured


def warm_end(measured: Range) -> float:
    """A tenth of a degree at the warmer end of the range, °C, where examples are."""
    return math.floor(10.0 * measured.high) / 10.0


def said(accel: float, gyro: float | None) -> str:
    """Errors of accelerometers, m/s², and gyros, rad/s, in mg and deg/s, rounded up."""
    in_mg = f"{_at_most(accel / (1e-3 * G_STANDARD))} mg"
    return in_mg if gyro is None else f"{in_mg} and {_at_most(gyro / DEGREE)} deg/s"


def _at_most(value: float) -> str:
    """A number of two digits that is not smaller."""
    if value <= _NOTHING:
        return "0"
    digit = 10.0 ** (math.floor(math.log10(value)) - 1)
    return f"{math.ceil(value / digit * (1.0 - 1e-12)) * digit:.2g}"


def _plain(measured: Range) -> str:
    return f"{measured.low:.1f} to {measured.high:.1f} degC"


def _is_hysteresis(name: str, kind: str) -> bool:
    return group_name(name) == f"{kind}.bias.hysteresis"
