"""The keys of [site]."""

from __future__ import annotations

from typing import Self

from pydantic import Field, model_validator

from tumble.recording.session_keys.table import SessionTable

LEAST_GRAVITY_U = 1e-15
"""m/s²: a smaller uncertainty than no gravimeter reaches is zero, or a mistake."""

_TESLA = {"nT": 1e-9, "uT": 1e-6, "gauss": 1e-4, "mgauss": 1e-7, "T": 1.0}
_FIELD_ON_EARTH = (1.5e-5, 8e-5)  # T, at the ground: 22 to 67 µT, and magnetic rock


class SiteTable(SessionTable):
    """[site]"""

    latitude_deg: float | None = Field(default=None, ge=-90, le=90, description="a number from -90 to 90")
    height_m: float = Field(default=0.0, ge=-1000, le=10000, description="a number from -1000 to 10000 (m)")
    gravity: float | None = Field(
        default=None, ge=9.7, le=9.9, description="a number from 9.7 to 9.9 (m/s^2, on Earth)"
    )
    gravity_u: float | None = Field(default=None, ge=0, le=0.1, description="a number from 0 to 0.1 (m/s^2)")
    gravity_confirmed: bool = Field(default=False, description="true or false")
    field: float | None = Field(default=None, gt=0, description="a positive number, in the unit of [log.magnetometer]")

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.gravity_u is not None and 0.0 < self.gravity_u < LEAST_GRAVITY_U:
            raise ValueError(f"gravity_u: expected 0 or at least {LEAST_GRAVITY_U:g} m/s^2, found {self.gravity_u:g}")
        if self.gravity_u is not None and self.gravity is None and self.latitude_deg is None:
            raise ValueError("gravity_u: expected site.gravity or site.latitude_deg with it, found neither")
        return self

    def check_field(self, unit: str | None) -> None:
        """Raises ValueError where the field is not one on Earth in the unit of the magnetometer; None is none."""
        if self.field is None:
            return
        if unit is None:
            raise ValueError("site.field: expected only with [log.magnetometer], found no magnetometer")
        low, high = (limit / _TESLA[unit] for limit in _FIELD_ON_EARTH)
        if not low <= self.field <= high:
            raise ValueError(
                f"site.field: expected the field on Earth, from {low:g} to {high:g} {unit}, the unit of "
                f"[log.magnetometer], found {self.field:g}"
            )
