"""The tables and keys of session.toml, with checks, and their conversion to SI and radians (`si`).

Messages quote the `description` of a key, which states the expected value: "session.toml: site.latitude_deg:
expected a number from -90 to 90, found 145.5". The validators of the tables check several keys together.
"""

from __future__ import annotations

from datetime import date as date_type
from datetime import datetime
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from tumble.earth import NORMAL_GRAVITY_U, normal_gravity
from tumble.recording.session import (
    AirConditions,
    AssumedGravity,
    Circumstances,
    Device,
    Exclusion,
    ProgrammeSpec,
    Session,
    SessionTable,
    Site,
    check_name,
    check_plain,
    key,
    sensors_from,
)
from tumble.recording.session.log_tables import LogTable
from tumble.sensors.parameters import prior_of
from tumble.units import DEGREE, G_STANDARD, TESLA

_MOST_TYPED_DECIMALS = 9
LEAST_GRAVITY_U = 1e-15  # m/s²; no gravimeter reaches it
UNKNOWN_SITE_GRAVITY_U = 0.03
"""Standard uncertainty of standard gravity as local gravity at an unknown place on Earth, m/s²."""
UNKNOWN_HEIGHT_GRAVITY_U = 4e-3
"""Standard uncertainty of normal gravity at an unknown height, m/s²: that of 1300 m."""

_FIELD_ON_EARTH = (1.5e-5, 8e-5)  # T, at the ground: 22 to 67 µT, and magnetic rock


class SiteTable(SessionTable):
    """[site]"""

    latitude_deg: float | None = key("a number from -90 to 90", ge=-90, le=90)
    height_m: float | None = key("a number from -1000 to 10000 (m)", ge=-1000, le=10000)
    gravity: float | None = key("a number from 9.7 to 9.9 (m/s^2, on Earth)", ge=9.7, le=9.9)
    gravity_u: float | None = key("a number from 0 to 0.1 (m/s^2)", ge=0, le=0.1)
    gravity_confirmed: bool = key("true or false", False)
    field: float | None = key("a positive number, in the unit of [log.magnetometer]", gt=0)

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.gravity_u is not None and 0.0 < self.gravity_u < LEAST_GRAVITY_U:
            raise ValueError(f"gravity_u: expected 0 or at least {LEAST_GRAVITY_U:g} m/s^2, found {self.gravity_u:g}")
        if self.gravity_u is not None and self.gravity is None and self.latitude_deg is None:
            raise ValueError("gravity_u: expected site.gravity or site.latitude_deg with it, found neither")
        return self

    def si(self) -> Site:
        """Return the site in SI, with assumptions, and their standard uncertainty, for missing values.

        Gravity without `gravity_u` is uniform over its last digit, and exact with more than nine. Without gravity it is
        normal gravity, at sea level if the height is not stated; at an unknown place it is standard gravity."""
        latitude = None if self.latitude_deg is None else self.latitude_deg * DEGREE
        assumed: AssumedGravity = "nothing"
        if self.gravity is not None:
            decimals = len(repr(self.gravity).partition(".")[2])
            u = 0.0 if decimals > _MOST_TYPED_DECIMALS else 10.0**-decimals / 12.0**0.5
            gravity, assumed = self.gravity, "digits"
        elif latitude is None:
            gravity, u, assumed = G_STANDARD, UNKNOWN_SITE_GRAVITY_U, "place"
        elif self.height_m is None:
            gravity, u, assumed = normal_gravity(latitude, 0.0), UNKNOWN_HEIGHT_GRAVITY_U, "height"
        else:
            gravity, u = normal_gravity(latitude, self.height_m), NORMAL_GRAVITY_U
        return Site(
            latitude=latitude,
            height=self.height_m,
            gravity=gravity,
            gravity_u=u if self.gravity_u is None else self.gravity_u,
            assumed=assumed if self.gravity_u is None else "nothing",
            field=self.field,
            gravity_confirmed=self.gravity_confirmed,
        )


class ImuTable(SessionTable):
    """[device.imu]"""

    accel_number: int | None = key("a number from 1 to 9", ge=1, le=9)
    accel_id: int | None = key("a device id, a whole number", ge=1, lt=2**32)
    gyro_number: int | None = key("a number from 1 to 9", ge=1, le=9)
    gyro_id: int | None = key("a device id, a whole number", ge=1, lt=2**32)


class DeviceTable(SessionTable):
    """[device]"""

    serial: Annotated[str, AfterValidator(check_name)] = Field(
        min_length=1, description="the serial number, a string that is not empty"
    )
    model: Annotated[str, AfterValidator(check_name)] | None = key("a string")
    systematic: str | None = key("the path of a calibration file", min_length=1)
    grade: Literal["navigation", "tactical", "mems", "consumer"] | None = key(
        "one of navigation, tactical, mems, consumer"
    )
    imu: ImuTable = Field(default_factory=ImuTable, description="a table of sensors of an autopilot")
    prior: dict[str, str | dict[str, str]] = Field(
        default_factory=dict, description='standard deviations such as accel_quadratic = "20 ug/g^2"'
    )

    def priors(self) -> dict[str, float]:
        """Return standard deviations, SI, by group. Raises ValueError for an unknown group or unit."""
        flat = {
            f"{key}.{part}" if part else key: text
            for key, value in self.prior.items()
            for part, text in ({"": value} if isinstance(value, str) else value).items()
        }
        return dict(prior_of(key, text) for key, text in flat.items())

    @model_validator(mode="after")
    def _check(self) -> Self:
        self.priors()
        return self

    def si(self, folder: Path) -> Device:
        return Device(
            serial=self.serial,
            model=self.model,
            systematic=None if self.systematic is None else folder / self.systematic,
            grade=self.grade,
            prior=self.priors(),
            imu=sensors_from(self.imu.model_dump()),
        )


class CircumstancesTable(SessionTable):
    """[session]"""

    date: datetime | date_type | None = key("a date, or a date with a time, without quotes")
    operator: Annotated[str, AfterValidator(check_plain)] | None = key("a name, a string", min_length=1)
    conditions: AirConditions = Field(default_factory=AirConditions, description="a table of conditions")
    equipment: list[Annotated[str, AfterValidator(check_plain)]] = Field(
        default_factory=list, description="a list of strings"
    )

    def si(self) -> Circumstances:
        return Circumstances(
            date=None if self.date is None else self.date.isoformat(),
            operator=self.operator,
            conditions=self.conditions,
            equipment=tuple(self.equipment),
        )


class SessionDocument(SessionTable):
    """The whole file."""

    format: int = Field(ge=1, le=1, description="1, the format of this file")
    device: DeviceTable = Field(description="the table [device]")
    site: SiteTable = Field(default_factory=SiteTable, description="the table [site]")
    log: LogTable = Field(description="the table [log]")
    programme: ProgrammeSpec | None = key("the table [programme]")
    session: CircumstancesTable = Field(default_factory=CircumstancesTable, description="the table [session]")
    exclude: list[Exclusion] = Field(default_factory=list, description="tables [[exclude]]")

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.site.field is None:
            return self
        if self.log.magnetometer is None:
            raise ValueError("site.field: expected only with [log.magnetometer], found no magnetometer")
        unit = self.log.magnetometer.unit
        low, high = (limit / TESLA[unit] for limit in _FIELD_ON_EARTH)
        if not low <= self.site.field <= high:
            raise ValueError(
                f"site.field: expected the field on Earth, from {low:g} to {high:g} {unit}, the unit of "
                f"[log.magnetometer], found {self.site.field:g}"
            )
        return self

    def si(self, folder: Path | None) -> Session:
        """Return the session, with its files in a folder; None if samples are in memory."""
        base = folder or Path()
        return Session(
            folder=folder,
            device=self.device.si(base),
            site=self.site.si(),
            log=self.log.si(base),
            programme=self.programme,
            excluded=tuple(self.exclude),
            circumstances=self.session.si(),
            description=self.model_dump(exclude_unset=True, exclude_none=True),
        )
