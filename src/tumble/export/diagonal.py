"""What is left of a calibration where the target holds an offset and a factor for each accelerometer, an offset for
each gyro, and how much that loses.

Autopilots over temperature: their offsets follow a cubic of the temperature between two ends, nothing else does.

    reading − cubic(T) − offset, T kept within TMIN … TMAX

The biases of a calibration are polynomials of the second degree at most, so a cubic holds them whole; TMIN and TMAX are
the ends of what was measured. Scale factors have one value each, that at the reference temperature.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Container, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np

from tumble.errors import InputError
from tumble.export.exported import NO_UNCERTAINTY, SINGLE_PRECISION, example, shown, triads
from tumble.export.larger_model import not_held, session_rate
from tumble.result.calibration import Calibration
from tumble.result.parts import RestResult
from tumble.result.temperature_curves import (
    Range,
    changing,
    coefficients,
    measured_range,
    model_at,
    references,
    warm_rests,
)
from tumble.sensors.model import SensorKind, SensorModel
from tumble.sensors.parameters import group_name
from tumble.units import DEGREE, G_STANDARD, Array


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Diagonal:
    """What an autopilot can hold, in single precision, of the kinds of sensors that are `known`: their offsets (3,),
    and factors (3,), which gyros have none of: 1."""

    offset: Mapping[SensorKind, Array]
    factor: Mapping[SensorKind, Array]
    known: Mapping[SensorKind, SensorModel]
    losses: tuple[str, ...]

    def example(self, kind: SensorKind, model: SensorModel, offset: Array, where: str = "") -> str:
        """A reading, what the autopilot makes of it with this offset (3,) and what it is."""
        worked = example(kind, model)
        target = (worked.reading - offset) * self.factor[kind]
        return (
            f"example {kind}{where}: reading {shown(worked.reading)} becomes {shown(target.round(6))}; it is "
            f"{shown(worked.true.round(6))}"
        )

    def examples(self) -> list[str]:
        """An example of each kind of sensors."""
        return [self.example(kind, model, self.offset[kind]) for kind, model in self.known.items()]


def diagonal(calibration: Calibration, target: str, apart: Container[str] = ()) -> Diagonal:
    """Offsets and factors of a calibration, and what is lost, but for the groups of parameters that are told of
    `apart`. Raises InputError unless every channel senses its own axis of the frame, X, Y, Z, positive."""
    known = triads(calibration, target, needed=())
    for kind, model in known.items():
        if (np.argmax(model.matrix, axis=1) != np.arange(3)).any() or (np.diag(model.matrix) <= 0.5).any():
            raise InputError(
                f"export to {target}: expected {kind} channels along X, Y, Z in this order, found others; {target} has "
                "no place for another order or sign: name the columns of the session in that order"
            )
    factors = {kind: 1.0 / np.diag(model.matrix) if kind == "accel" else np.ones(3) for kind, model in known.items()}
    losses = [misalignment_lost(model) if kind == "accel" else gyro_matrix_lost(model) for kind, model in known.items()]
    return Diagonal(
        offset={kind: single(model.bias) for kind, model in known.items()},
        factor={kind: single(factor) for kind, factor in factors.items()},
        known=known,
        losses=(*losses, *not_held(calibration, apart), SINGLE_PRECISION, NO_UNCERTAINTY),
    )


def single(values: Array) -> Array:
    """Numbers as single precision keeps them."""
    return np.asarray(values.astype(np.float32), dtype=float)


def worst(error: Array) -> float:
    """The largest relative error |E v| / |v| of any vector."""
    return float(np.linalg.norm(error, ord=2))


def misalignment_lost(model: SensorModel) -> str:
    """What accelerometers without cross terms lose: with a factor 1/Mᵢᵢ for each axis the result is (1 + E) true."""
    error = model.matrix / np.diag(model.matrix)[:, None] - np.eye(3)
    return (
        f"misalignment of the accelerometers: up to {1e3 * np.abs(error).max():.3g} mrad, in 1 g an error of up to "
        f"{G_STANDARD * worst(error):.3g} m/s^2"
    )


def gyro_matrix_lost(model: SensorModel) -> str:
    """What gyros with nothing but offsets lose."""
    error = model.matrix - np.eye(3)
    return (
        f"scale factors and misalignment of the gyros: an error of up to {100.0 * worst(error):.3g} % of the rate, "
        f"{np.rad2deg(worst(error) * np.deg2rad(100.0)):.3g} deg/s in 100 deg/s"
    )


HELD = ("accel.bias.t1", "accel.bias.t2", "gyro.bias.t1", "gyro.bias.t2")
SCALES = ("accel.scale.t1", "accel.scale.t2", "gyro.scale.t1", "gyro.scale.t2")
"""Not held, with a sentence of their own."""

_NOTHING = 1e-12
"""mg or deg/s: rounding of double precision."""

Offsets = Callable[[SensorKind, Array], Array]
"""The offsets (N, 3), SI, that a target takes off the readings of a kind of sensors at temperatures (N,), °C."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Thermal:
    """What an autopilot holds of a calibration over temperature, its references being temperatures of the target: what
    it holds at these, and by kind how the biases change, (3, 2), per K and per K², within the range that was measured;
    and what is lost where sensors `shared` a thermometer there only."""

    held: Diagonal
    calibration: Calibration
    measured: Range
    slopes: dict[SensorKind, Array]
    shared: tuple[str, ...]

    def reference(self, kind: SensorKind) -> float:
        """The temperature of the target, °C, at which sensors of a kind have their values."""
        return float(references(self.calibration, kind)[0])

    def losses(self, offsets: Offsets) -> tuple[str, ...]:
        """What is lost over temperature, and how much of it within the measured range; `offsets` are the target's."""
        return (
            self._curves(offsets),
            self._scales(),
            *self._hysteresis(),
            *self.shared,
            f"outside {_plain(self.measured)} nothing was measured: the target keeps the offsets of the nearer end",
        )

    def ends(self, kind: SensorKind) -> Array:
        """The reference of a kind of sensors and the ends of the measured range, °C, in single precision."""
        return single(np.array([self.reference(kind), self.measured.low, self.measured.high]))

    def examples(self, offsets: Offsets) -> list[str]:
        """Readings at the warmer end, what the autopilot makes of them and what they are, line by line."""
        at, out = warm_end(self.measured), []
        for kind in self.held.known:
            model, offset = model_at(self.calibration, kind, at), offsets(kind, np.array([at]))[0]
            out.append(self.held.example(kind, model, offset, f" at {at:g} degC"))
        return out

    def steepest(self) -> Mapping[SensorKind, float]:
        """The largest change of a bias per K within the range, m/s²/K or rad/s/K, of the kinds of sensors there are."""
        return {kind: _steepest(self.calibration, kind, self.measured) for kind in self.slopes}

    def _curves(self, offsets: Offsets) -> str:
        temperature, error = self.measured.temperatures(), {}
        for kind, (linear, square) in ((kind, slopes.T) for kind, slopes in self.slopes.items()):
            warmer = (temperature - self.reference(kind))[:, None]
            biases = self.held.known[kind].bias + linear * warmer + square * warmer**2
            error[kind] = float(np.abs(offsets(kind, temperature) - biases).max())
        return (
            f"offsets over temperature: from {_plain(self.measured)} the cubic is within "
            f"{said(error)} of the calibration's curve"
        )

    def _scales(self) -> str:
        """The largest error that scale factors without a temperature make."""
        rate, error = session_rate(self.calibration), {}
        for kind, model in self.held.known.items():
            warmer = (self.measured.temperatures() - self.reference(kind))[:, None]
            linear, square = coefficients(self.calibration, kind, "scale").T
            longer = linear * warmer + square * warmer**2
            unit = model.matrix / np.linalg.norm(model.matrix, axis=1)[:, None]
            applied = np.diag(model.matrix)[:, None] if kind == "accel" else 1.0
            felt = G_STANDARD if kind == "accel" else rate
            error[kind] = felt * max(worst(each[:, None] * unit / applied) for each in longer)
        turning = f"at {rate / DEGREE:.3g} deg/s"
        where = " ".join(["in 1 g"] * ("accel" in error) + [turning] * ("gyro" in error))
        return (
            f"scale factors over temperature: no place in this file, from {_plain(self.measured)} an error of up to "
            f"{said(error)} {where}"
        )

    def _hysteresis(self) -> list[str]:
        largest = {
            kind: max((abs(p.value) for p in self.calibration.parameters if _is_hysteresis(p.name, kind)), default=0.0)
            for kind in self.held.known
        }
        lost = any(largest.values())
        return [f"hysteresis of the biases: no place in this file, up to {said(largest)}"] if lost else []


def thermal(calibration: Calibration, target: str, together: Sequence[tuple[SensorKind, ...]]) -> Thermal:
    """What an autopilot can hold of a calibration over temperature, in which the sensors of these kinds have a
    thermometer `together`, that of the first. Raises InputError where nothing changes with temperature, or where the
    rests were all at one."""
    held = diagonal(calibration, target, apart=(*HELD, *SCALES))
    measured = range_of(calibration, target)
    seen: dict[str, tuple[float, ...]] = {kind: tuple(references(calibration, kind).tolist()) for kind in held.known}
    together = [tuple(kind for kind in of if kind in seen) for of in together]
    seen = {kind: len(seen[kind]) * (float(np.mean(seen[of[0]])),) for of in together for kind in of}
    return Thermal(
        held=held,
        calibration=replace(calibration, references=seen),
        measured=measured,
        slopes={kind: coefficients(calibration, kind, "bias") for kind in held.known},
        shared=tuple(said for kinds in together for said in _shared(calibration, kinds, measured)),
    )


def _steepest(calibration: Calibration, kind: SensorKind, measured: Range) -> float:
    """The largest change of a bias per K within the range, SI."""
    linear, square = coefficients(calibration, kind, "bias").T
    ends = np.array([[measured.low], [measured.high]]) - references(calibration, kind)
    return float(np.abs(linear + 2.0 * square * ends).max())


def _shared(calibration: Calibration, kinds: Sequence[SensorKind], measured: Range) -> list[str]:
    """What is lost because sensors of these kinds have one temperature in the target: by what they differ at rests
    other than in the mean, which their references contain."""
    names = dict.fromkeys(chain(*(calibration.thermometers.get(kind, ()) for kind in kinds)))
    if len(names) < 2:
        return []
    mean = {kind: references(calibration, kind) for kind in kinds}
    apart = max((_apart(rest, mean) for rest in warm_rests(calibration)), default=0.0)
    sizes = [_in_field_units(kind, apart * _steepest(calibration, kind, measured)) for kind in kinds]
    return [
        f"thermometers of their own ({', '.join(names)}): the target has one for these sensors; at the rests they "
        f"differ by up to {apart:.1f} K more or less than in the mean, an error of up to {' and '.join(sizes)}"
    ]


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


def _apart(rest: RestResult, mean: Mapping[SensorKind, Array]) -> float:
    """By how much temperatures of sensors, less those in the mean, differ at a rest, K."""
    own = {kind: getattr(rest, kind) for kind in mean}
    off = [np.array(at.temperature) - mean[kind] for kind, at in own.items() if at is not None and at.temperature]
    return float(np.ptp(np.concatenate(off))) if off else 0.0


def said(errors: Mapping[SensorKind, float]) -> str:
    """Errors of accelerometers, m/s², and gyros, rad/s, in mg and deg/s, rounded up."""
    return " and ".join(_in_field_units(kind, error) for kind, error in errors.items())


def _in_field_units(kind: SensorKind, error: float) -> str:
    return f"{_at_most(error / (1e-3 * G_STANDARD))} mg" if kind == "accel" else f"{_at_most(error / DEGREE)} deg/s"


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
