"""The tables of the registry, and bringing a database up to date.

`schema_version` is alembic's table with the last migration that was made (migrations/versions); VERSION is the one that
this program knows. Where they are the same, alembic is not even imported. A migration and the check before it are one
writer's transaction, so that many programs may open a new registry at once.

A device is its serial number, as in the calibrations that have it; it has no row of its own, since there is nothing to
say about a device that could not change. Times are in UTC.
"""

from __future__ import annotations

import re
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

from sqlalchemy import (
    Column,
    DateTime,
    Dialect,
    ForeignKey,
    Index,
    Integer,
    MetaData,
    String,
    Table,
    Text,
    TypeDecorator,
    inspect,
    text,
)

from tumble import __version__
from tumble.errors import InputError
from tumble.registry.connect import Registry

if TYPE_CHECKING:
    from sqlalchemy import Connection

VERSION = "v0001"
VERSION_TABLE = "schema_version"
_A_VERSION = re.compile("v(?!0000)[0-9]{4}")
MIGRATIONS = Path(__file__).parent / "migrations"


class UtcTime(TypeDecorator[datetime]):
    """A time in UTC, which the database keeps without a zone."""

    impl = DateTime
    cache_ok = True

    def process_bind_param(self, value: datetime | None, dialect: Dialect) -> datetime | None:  # noqa: ARG002
        """To the database."""
        return None if value is None else value.astimezone(UTC).replace(tzinfo=None)

    def process_result_value(self, value: datetime | None, dialect: Dialect) -> datetime | None:  # noqa: ARG002
        """From the database."""
        return None if value is None else value.replace(tzinfo=UTC)


METADATA = MetaData()

LIMITS = Table(
    "limits",
    METADATA,
    Column("number", Integer, primary_key=True),
    Column("sha256", String(64), nullable=False, unique=True),  # of model, time and both files
    Column("model", Text, nullable=False, index=True),
    Column("file", Text, nullable=False),  # the TOML file
    Column("systematic", Text),  # the calibration file it names
    Column("added", UtcTime, nullable=False),
    sqlite_autoincrement=True,
)

CALIBRATION = Table(
    "calibration",
    METADATA,
    Column("number", Integer, primary_key=True),
    Column("sha256", String(64), nullable=False, unique=True),  # of the file's content
    Column("serial", Text, nullable=False),
    Column("model", Text),
    Column("method", Text, nullable=False),
    Column("frame", Text, nullable=False),
    Column("performed", UtcTime, nullable=False),
    Column("occasion", String(16), nullable=False),  # incoming, periodic
    Column("state", String(16), nullable=False),  # as-found, as-left, unadjusted
    Column("limits", ForeignKey("limits.number")),  # that were in force
    Column("verdict", String(24)),  # by them
    Column("supersedes", ForeignKey("calibration.number"), unique=True),
    Column("reason", Text),
    Column("added", UtcTime, nullable=False),
    Index("calibration_of_device", "serial", "performed", "number"),
    sqlite_autoincrement=True,
)

CONTENT = Table(  # apart, so that a look through the records does not go through their files
    "content",
    METADATA,
    Column("calibration", ForeignKey("calibration.number"), primary_key=True),
    Column("file", Text, nullable=False),  # the whole calibration file
)

LAUNCH = Table(
    "launch",
    METADATA,
    Column("calibration", ForeignKey("calibration.number"), primary_key=True),
    Column("number", Integer, primary_key=True, autoincrement=False),  # from 1
    Column("session", Text),
    Column("log_sha256", Text, nullable=False, index=True),
)


def bring_up_to_date(registry: Registry, create: bool) -> None:
    """Make the tables of a new registry (with `create`), or migrate those of an older one.

    Raises InputError for a newer schema, another program's database, or none where `create` is not asked for."""
    with registry.reading() as connection:
        found = _version(connection)
        if found == VERSION:
            return
        _check(connection, registry.name, found, create)
    if registry.engine.dialect.name == "sqlite":
        _keep_a_write_ahead_log(registry)
    with registry.writing() as connection:
        found = _version(connection)
        if found != VERSION:
            _check(connection, registry.name, found, create)
            _migrate(connection)


def _version(connection: Connection) -> str | None:
    """The version of the schema of a registry; None where the database is none, or says it otherwise than we do."""
    if not inspect(connection).has_table(VERSION_TABLE):
        return None
    row = connection.execute(text(f"SELECT * FROM {VERSION_TABLE}")).mappings().first()
    version = None if row is None else row.get("version_num")
    return version if isinstance(version, str) and _A_VERSION.fullmatch(version) else None


def _check(connection: Connection, name: str, found: str | None, create: bool) -> None:
    """That the database is one to migrate."""
    if found is not None and found > VERSION:
        raise InputError(
            f"{name}: expected a registry of schema {VERSION} or older, found {found}, written by a newer tumble than "
            f"this one ({__version__}); install a newer one"
        )
    if found is None and inspect(connection).get_table_names():
        raise InputError(f"{name}: expected a registry or an empty database, found the tables of another program")
    if found is None and not create:
        raise InputError(f"{name}: expected a registry, found an empty database; `tumble registry add` makes one")


def _keep_a_write_ahead_log(registry: Registry) -> None:
    """Readers do not wait for writers then. The file remembers it."""
    raw = registry.engine.raw_connection()
    try:
        raw.cursor().execute("PRAGMA journal_mode = WAL")
    finally:
        raw.close()


def _migrate(connection: Connection) -> None:
    from alembic import command
    from alembic.config import Config

    config = Config()
    config.set_main_option("script_location", str(MIGRATIONS).replace("%", "%%"))
    config.attributes["connection"] = connection
    command.upgrade(config, "head")
