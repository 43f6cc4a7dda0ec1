"""The keys of [log.accel], [log.gyro] and [log.magnetometer]."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import ClassVar, Self

import numpy as np
from pydantic import Field, model_validator

from tumble.recording.session_keys.table import SessionTable, as_written, check_known, check_one_per_column
from tumble.units import ACCEL_UNITS, GYRO_UNITS, MAGNETIC_UNITS, Array, Unit

_UNIT_NORM_TOLERANCE = 1e-6
_LEAST_SINGULAR_VALUE = 1e-3
_LEAST_SINE = 1e-3


class SensorsTable(SessionTable):
    """The common keys of [log.accel] and [log.gyro]."""

    UNITS: ClassVar[Mapping[str, Unit]]
    SCALE_PER: ClassVar[tuple[str, ...]]  # the first is the default

    columns: list[str] = Field(min_length=3, description="a list of at least three column names")
    unit: str = Field(description="the name of a unit, a string")
    scale: float | list[float] | None = Field(default=None, description="a number or a list of numbers")
    scale_per: str | None = Field(default=None, description="the name of a unit, a string")
    offset: float | list[float] | None = Field(default=None, description="a number or a list of numbers")
    axes: list[list[float]] | None = Field(default=None, description="a list of unit vectors [x, y, z]")
    range: float | None = Field(default=None, gt=0, description="a positive number")

    @property
    def raw(self) -> bool:
        """Whether the columns need a scale."""
        return self.UNITS[self.unit].kind == "raw"

    def worth(self) -> Unit:
        """The unit of (raw − offset) / scale."""
        return self.UNITS[(self.scale_per or self.SCALE_PER[0]) if self.raw else self.unit]

    def per_sensor(self, value: float | Sequence[float] | None, default: float) -> Array:
        """A number or a list as an array (n,)."""
        return np.broadcast_to(np.asarray(default if value is None else value, float), len(self.columns)).copy()

    def directions(self) -> Array:
        """The axes (n, 3), exactly of unit length."""
        axes = np.eye(3) if self.axes is None else np.array(self.axes, dtype=float)
        return np.asarray(axes / np.linalg.norm(axes, axis=1, keepdims=True))

    @model_validator(mode="after")
    def _check(self) -> Self:
        check_known("unit", self.unit, self.UNITS)
        self._check_scale()
        self._check_axes()
        return self

    def _check_scale(self) -> None:
        if not self.raw:
            for key in ("scale", "scale_per", "offset"):
                if getattr(self, key) is not None:
                    raise ValueError(f'{key}: expected only with unit "count" or "V", found unit "{self.unit}"')
            return
        if self.scale is None:
            raise ValueError(f'scale: expected the nominal output per unit for unit "{self.unit}", found none')
        check_known("scale_per", self.scale_per or self.SCALE_PER[0], self.SCALE_PER)
        for key in ("scale", "offset"):
            check_one_per_column(key, getattr(self, key), self.columns)
        if not self.per_sensor(self.scale, 1.0).all():
            raise ValueError(f"scale: expected numbers other than zero, found {as_written(self.scale)}")

    def _check_axes(self) -> None:
        if self.axes is None:
            if len(self.columns) > 3:
                raise ValueError(f"axes: expected {len(self.columns)} unit vectors for a redundant block, found none")
            return
        if len(self.axes) != len(self.columns):
            raise ValueError(f"axes: expected {len(self.columns)} vectors, one per column, found {len(self.axes)}")
        for number, axis in enumerate(self.axes, 1):
            if len(axis) != 3:
                raise ValueError(f"axes: expected vectors [x, y, z], found {len(axis)} numbers in vector {number}")
            if abs(math.hypot(*axis) - 1.0) > _UNIT_NORM_TOLERANCE:
                raise ValueError(
                    f"axes: expected unit vectors within {_UNIT_NORM_TOLERANCE:g}, "
                    f"found norm {math.hypot(*axis):.7g} of vector {number}, {as_written(axis)}"
                )
        if np.linalg.svd(self.directions(), compute_uv=False)[2] < _LEAST_SINGULAR_VALUE:
            raise ValueError("axes: expected directions that span three dimensions, found them in one plane")


class AccelTable(SensorsTable):
    """[log.accel]"""

    UNITS = ACCEL_UNITS
    SCALE_PER = ("m/s^2", "g", "m/s")

    def _check_axes(self) -> None:
        super()._check_axes()
        first, second = self.directions()[:2]
        if np.linalg.norm(np.cross(first, second)) < _LEAST_SINE:
            raise ValueError(
                "axes: expected the first two accelerometers, which fix the body frame, in different "
                "directions, found them parallel; list the sensors in another order"
            )


class GyroTable(SensorsTable):
    """[log.gyro]"""

    UNITS = GYRO_UNITS
    SCALE_PER = ("rad/s", "deg/s", "rad", "deg", "arcsec")


class MagnetometerTable(SessionTable):
    """[log.magnetometer]"""

    columns: list[str] = Field(min_length=3, max_length=3, description="a list of three column names")
    unit: str = Field(description="the name of a unit, a string")

    @model_validator(mode="after")
    def _check(self) -> Self:
        check_known("unit", self.unit, MAGNETIC_UNITS)
        return self
