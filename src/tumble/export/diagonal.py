"""What is left of a calibration where the target holds an offset and a factor for each accelerometer, an offset for
each gyro, and how much that loses."""

from __future__ import annotations

from collections.abc import Container, Mapping
from dataclasses import dataclass

import numpy as np

from tumble.calibration.calibration_file import Calibration
from tumble.errors import InputError
from tumble.export.exported import NO_UNCERTAINTY, SINGLE_PRECISION, example, shown, triads
from tumble.export.larger_model import not_held
from tumble.sensors.model import SensorKind, SensorModel
from tumble.units import G_STANDARD, Array


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
