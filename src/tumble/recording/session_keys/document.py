"""The whole of session.toml, and the table behind every key that is one."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Self

from pydantic import Field, model_validator

from tumble.recording.session_keys.circumstances import CircumstancesTable, ConditionsTable, ExcludeTable
from tumble.recording.session_keys.device import DeviceTable, ImuTable
from tumble.recording.session_keys.log import LogTable
from tumble.recording.session_keys.programme import PositionTable, ProgrammeTable
from tumble.recording.session_keys.sensors import AccelTable, GyroTable, MagnetometerTable
from tumble.recording.session_keys.site import SiteTable
from tumble.recording.session_keys.table import SessionTable
from tumble.recording.session_keys.temperature import TemperatureTable


class SessionDocument(SessionTable):
    """The whole file."""

    format: int = Field(ge=1, le=1, description="1, the format of this file")
    device: DeviceTable = Field(description="the table [device]")
    site: SiteTable = Field(default_factory=SiteTable, description="the table [site]")
    log: LogTable = Field(description="the table [log]")
    programme: ProgrammeTable | None = Field(default=None, description="the table [programme]")
    session: CircumstancesTable = Field(default_factory=CircumstancesTable, description="the table [session]")
    exclude: list[ExcludeTable] = Field(default_factory=list, description="tables [[exclude]]")

    @model_validator(mode="after")
    def _check(self) -> Self:
        self.site.check_field(None if self.log.magnetometer is None else self.log.magnetometer.unit)
        return self


TABLES: Mapping[str, type[SessionTable]] = {
    "device": DeviceTable,
    "imu": ImuTable,
    "site": SiteTable,
    "log": LogTable,
    "accel": AccelTable,
    "gyro": GyroTable,
    "magnetometer": MagnetometerTable,
    "temperature": TemperatureTable,
    "programme": ProgrammeTable,
    "position": PositionTable,
    "session": CircumstancesTable,
    "conditions": ConditionsTable,
}
"""The table behind every key that is one."""
