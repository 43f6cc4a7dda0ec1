"""The keys of [device] and [device.imu]."""

from __future__ import annotations

from typing import Literal, Self

from pydantic import Field, model_validator

from tumble.documents import shown
from tumble.recording.session_keys.table import SessionTable
from tumble.sensors.parameters import prior_of

LONGEST_NAME = 200
"""Characters of a serial number and of a type."""


class ImuTable(SessionTable):
    """[device.imu]"""

    accel_number: int | None = Field(default=None, ge=1, le=9, description="a number from 1 to 9")
    accel_id: int | None = Field(default=None, ge=1, lt=2**32, description="a device id, a whole number")
    gyro_number: int | None = Field(default=None, ge=1, le=9, description="a number from 1 to 9")
    gyro_id: int | None = Field(default=None, ge=1, lt=2**32, description="a device id, a whole number")


class DeviceTable(SessionTable):
    """[device]"""

    serial: str = Field(min_length=1, description="the serial number, a string that is not empty")
    model: str | None = Field(default=None, description="a string")
    systematic: str | None = Field(default=None, min_length=1, description="the path of a calibration file")
    grade: Literal["navigation", "tactical", "mems", "consumer"] | None = Field(
        default=None, description="one of navigation, tactical, mems, consumer"
    )
    imu: ImuTable = Field(default_factory=ImuTable, description="a table of sensors of an autopilot")
    prior: dict[str, str | dict[str, str]] = Field(
        default_factory=dict, description='standard deviations such as accel_quadratic = "20 ug/g^2"'
    )

    def priors(self) -> dict[str, float]:
        """Standard deviations, SI, by group. Raises ValueError for a group or a unit that is not known."""
        found: dict[str, float] = {}
        for key, value in self.prior.items():
            if isinstance(value, str):
                found |= [prior_of(key, value)]
            else:
                found |= [prior_of(f"{key}.{of}", each) for of, each in value.items()]
        return found

    @model_validator(mode="after")
    def _check(self) -> Self:
        for key, text in (("serial", self.serial), ("model", self.model)):
            if text is not None and not (text.strip() and text.isprintable() and len(text) <= LONGEST_NAME):
                raise ValueError(f"{key}: expected 1 to {LONGEST_NAME} printable characters, found {shown(text)}")
        self.priors()
        return self
