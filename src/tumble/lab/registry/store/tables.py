"""The tables of the registry, and the row that says which version of them a database has.

A device is its serial number, as in the calibrations that have it; it has no row of its own, since there is nothing to
say about a device that could not change. Of what a calibration file says, a table has what records are searched and
listed by. Times are in UTC, and kept without a zone. The database itself refuses that a row is changed.
"""

from __future__ import annotations

from datetime import UTC, datetime
from typing import TYPE_CHECKING

from sqlalchemy import (
    Column,
    DateTime,
    Float,
    ForeignKey,
    Index,
    Integer,
    MetaData,
    String,
    Table,
    Text,
    TypeDecorator,
    insert,
    inspect,
)

from tumble.errors import InputError

if TYPE_CHECKING:
    from sqlalchemy import Connection, Dialect

VERSION = "v0002"
"""Of the tables below; another number for every change of them."""

METADATA = MetaData()


class Utc(TypeDecorator[datetime]):
    """A time with its zone, kept in UTC without one."""

    impl, cache_ok = DateTime, True

    def process_bind_param(self, value: datetime | None, dialect: Dialect) -> datetime | None:  # noqa: ARG002
        """As the database keeps it."""
        return None if value is None else value.astimezone(UTC).replace(tzinfo=None)

    def process_result_value(self, value: datetime | None, dialect: Dialect) -> datetime | None:  # noqa: ARG002
        """As it is read."""
        return None if value is None else value.replace(tzinfo=UTC)


SCHEMA_VERSION = Table("schema_version", METADATA, Column("version_num", String(32), primary_key=True))

LIMITS = Table(
    "limits",
    METADATA,
    Column("number", Integer, primary_key=True),
    Column("sha256", String(64), nullable=False, unique=True),  # of model, time and both files
    Column("model", Text, nullable=False, index=True),
    Column("file", Text, nullable=False),  # the TOML file
    Column("systematic", Text),  # the calibration file it names
    Column("added", Utc, nullable=False),
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
    Column("performed", Utc, nullable=False),
    Column("occasion", String(16), nullable=False),  # incoming, periodic
    Column("state", String(16), nullable=False),  # as-found, as-left, unchanged
    Column("limits", ForeignKey("limits.number")),  # that were in force
    Column("verdict", String(24)),  # by them
    Column("supersedes", ForeignKey("calibration.number"), unique=True),
    Column("reason", Text),
    Column("added", Utc, nullable=False),
    Index("calibration_of_device", "serial", "performed", "number"),
    sqlite_autoincrement=True,
)

CONTENT = Table(  # apart, so that a look through the records does not go through their files
    "content",
    METADATA,
    Column("calibration", ForeignKey("calibration.number"), primary_key=True),
    Column("file", Text, nullable=False),  # the whole calibration file
)

LOG = Table(
    "log",
    METADATA,
    Column("sha256", String(64), primary_key=True),
    Column("calibration", ForeignKey("calibration.number"), primary_key=True),  # that stands on it
)

FORECAST = Table(  # what takes too long to be found whenever it is asked which device is due
    "forecast",
    METADATA,
    Column("limits", ForeignKey("limits.number"), primary_key=True),
    Column("serial", Text, primary_key=True),
    Column("last", ForeignKey("calibration.number"), primary_key=True),  # the highest number in force of the device
    Column("count", Integer, primary_key=True),  # how many are in force: with `last` it says which these are
    Column("name", Text),  # the parameter; without one no limit is met
    Column("unit", Text),
    Column("limit", Float),
    Column("expected", Utc),
    Column("earliest", Utc),
    Column("latest", Utc),
)

_KEPT = ("limits", "calibration", "content", "log", "forecast")
_REFUSED = "a registry is added to, never changed"


def has_tables(connection: Connection, name: str, create: bool) -> bool:
    """Whether a database is a registry; False where it is empty and one may be made of it.

    Raises InputError for a registry of another version, another program's database, or an empty one without `create`,
    in which it is called `name`."""
    tables = inspect(connection).get_table_names()
    if SCHEMA_VERSION.name in tables:
        row = connection.exec_driver_sql(f"SELECT * FROM {SCHEMA_VERSION.name}").mappings().first()
        version = None if row is None else row.get("version_num")
        if version == VERSION:
            return True
        if isinstance(version, str) and version[:1] == "v" and version[1:].isdecimal():
            raise InputError(
                f"{name}: expected a registry of version {VERSION}, found {version}, written by another tumble; with "
                "that one `tumble registry export -o FILE`, with this one `tumble registry import FILE --registry NEW`"
            )
    if tables:
        raise InputError(f"{name}: expected a registry or an empty database, found the tables of another program")
    if not create:
        raise InputError(f"{name}: expected a registry, found an empty database; `tumble registry add` makes one")
    return False


def make_tables(connection: Connection) -> None:
    """Make the tables in an empty database."""
    METADATA.create_all(connection, checkfirst=False)
    connection.execute(insert(SCHEMA_VERSION), {"version_num": VERSION})
    if connection.dialect.name == "sqlite":
        refusals = [
            f"CREATE TRIGGER {table}_no_{change.lower()} BEFORE {change} ON {table} "
            f"BEGIN SELECT RAISE(ABORT, '{_REFUSED}'); END"
            for table in _KEPT
            for change in ("UPDATE", "DELETE")
        ]
    else:
        refusals = [
            "CREATE FUNCTION refuse_change() RETURNS trigger LANGUAGE plpgsql AS "
            f"$$ BEGIN RAISE EXCEPTION '{_REFUSED}'; END $$",
            *(
                f"CREATE TRIGGER {table}_is_kept BEFORE UPDATE OR DELETE OR TRUNCATE ON {table} "
                "FOR EACH STATEMENT EXECUTE FUNCTION refuse_change()"
                for table in _KEPT
            ),
        ]
    for statement in refusals:
        connection.exec_driver_sql(statement)
