"""The database of a registry: its tables, and the transactions of readers and writers.

A device is its serial number; it has no table of its own, since there is nothing to say about a device that could not
change. A calibration has the columns by which records are searched and listed, and the text of its file. Triggers
refuse that a row is changed or deleted. A change of the tables takes another name of one of them, by which a database
of another version is recognised.

Writers come one after the other: SQLite's BEGIN IMMEDIATE, an advisory lock on PostgreSQL. A plain BEGIN on SQLite
takes the lock only at the first write, and what was read before it may be stale by then. A reader sees one state of the
database from its first query to its last and waits for nobody.
"""

from __future__ import annotations

import errno
import os
import shutil
import sqlite3
from collections.abc import Collection, Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from sqlalchemy import (
    URL,
    Column,
    Connection,
    DateTime,
    Engine,
    ForeignKey,
    Index,
    Integer,
    MetaData,
    String,
    Table,
    Text,
    TypeDecorator,
    create_engine,
    event,
    insert,
    inspect,
    make_url,
    select,
)
from sqlalchemy.exc import ArgumentError, DBAPIError

from tumble.errors import InputError
from tumble.lab.registry.records import LimitsRecord, Record

PATIENCE = 30.0
"""How long a writer waits for another one, s."""
WRITERS_LOCK = 7_848_652_101
"""The advisory lock of writers on PostgreSQL, a number of our own."""

_NO_ROOM, _ROOM = ("disk I/O error", "database or disk is full"), 1 << 20
"""What SQLite says where a disk has fewer bytes than so many, and elsewhere too."""
_PLACE = "expected a file or postgresql://USER@HOST/NAME"
_REFUSED = "a registry is added to, never changed"


class _Moment(TypeDecorator[datetime]):
    """A time, which the database has in UTC and without a zone."""

    impl, cache_ok = DateTime, True

    def process_bind_param(self, value: datetime | None, dialect: object) -> datetime | None:
        del dialect
        return None if value is None else value.astimezone(UTC).replace(tzinfo=None)

    def process_result_value(self, value: datetime | None, dialect: object) -> datetime:
        del dialect
        if value is None:
            raise ValueError("no time")
        return value.replace(tzinfo=UTC)


TABLES = MetaData()

LIMITS = Table(
    "limits",
    TABLES,
    Column("number", Integer, primary_key=True),
    Column("model", Text, nullable=False, index=True),
    Column("file", Text, nullable=False),  # the TOML file
    Column("added", _Moment, nullable=False),
    sqlite_autoincrement=True,
)

CALIBRATION = Table(
    "calibration",
    TABLES,
    Column("number", Integer, primary_key=True),
    Column("sha256", String(64), nullable=False, unique=True),  # of the file's content
    Column("serial", Text, nullable=False),
    Column("model", Text),
    Column("method", Text, nullable=False),
    Column("frame", Text, nullable=False),
    Column("performed", _Moment, nullable=False),
    Column("occasion", String(16), nullable=False),  # incoming, periodic
    Column("state", String(16), nullable=False),  # as-found, as-left, unchanged
    Column("limits", ForeignKey("limits.number")),  # that were in force
    Column("verdict", String(24)),  # by them
    Column("added", _Moment, nullable=False),
    Column("file", Text, nullable=False),  # the whole calibration file
    Index("calibration_of_device", "serial", "performed", "number"),
    sqlite_autoincrement=True,
)

LOGS = Table(  # a log stands behind one calibration alone
    "calibration_log",
    TABLES,
    Column("sha256", String(64), primary_key=True),
    Column("calibration", ForeignKey("calibration.number"), nullable=False),
)


@dataclass(frozen=True, kw_only=True, slots=True)
class Database:
    """A database that can be opened. `name` is what messages call it: its SQLite `file`, or its URL without the
    password. A file that is not there is made with the first that is written."""

    name: str
    engine: Engine
    file: Path | None

    @contextmanager
    def reading(self) -> Iterator[Rows]:
        """A transaction that sees one state of the database. Raises InputError, one line, where the database fails."""
        if self.file is not None and not self.file.exists():
            with self.writing():
                pass
        options = {"isolation_level": "REPEATABLE READ"} if self.file is None else {}
        with self._transaction(**options) as connection:
            yield Rows(connection=connection)

    @contextmanager
    def writing(self) -> Iterator[Rows]:
        """The transaction of the only writer, committed when the block ends without an error."""
        new, made = self.file is not None and not self.file.exists(), False
        try:
            with self._transaction(tumble_writes=True) as connection:
                if made := not _has_tables(connection, self.name, create=True):
                    _make_tables(connection)
                yield Rows(connection=connection)
        except BaseException:
            self.engine.dispose()
            if new and self.file is not None and self.file.is_file() and self.file.stat().st_size == 0:
                self.file.unlink()
            raise
        if self.file is not None and not self.file.is_file():
            raise InputError(f"{self.name}: expected the registry, found that it was removed meanwhile; try again")
        if made and self.file is not None:  # readers do not wait for writers then; the file remembers it
            with suppress(sqlite3.OperationalError), closing(self.engine.raw_connection()) as raw:
                raw.cursor().execute("PRAGMA journal_mode = WAL")  # or the last of those that opened it at once does

    @contextmanager
    def _transaction(self, **options: Any) -> Iterator[Connection]:
        """A transaction whose errors are InputError, those of SQLite's own module too."""
        try:
            with self.engine.connect() as connection, connection.execution_options(**options).begin():
                yield connection
        except (DBAPIError, sqlite3.Error) as error:
            reason = " ".join(str(getattr(error, "orig", error)).split())
            if "database is locked" in reason or "lock timeout" in reason:
                reason = f"another writer has held it for {PATIENCE:.0f} s; try again"
            elif reason in _NO_ROOM and shutil.disk_usage(Path(self.name).parent).free < _ROOM:
                reason = os.strerror(errno.ENOSPC)
            raise InputError(f"{self.name}: the registry cannot be used: {reason}") from error
        except (ValueError, TypeError) as error:  # a column that is not what it was written as
            raise InputError(
                f"{self.name}: the registry cannot be used: expected what was written into it, found a damaged value: "
                f"{' '.join(str(error).split())}"
            ) from error


@dataclass(frozen=True, kw_only=True, slots=True)
class Rows:
    """The rows of the tables within a transaction."""

    connection: Connection

    def records(self, *, of_logs: Collection[str] | None = None, **values: object) -> list[Record]:
        """The records that have these values in their columns, or stand on one of these logs (SHA-256), by number."""
        conditions = [CALIBRATION.c[name] == value for name, value in values.items()]
        if of_logs is not None:
            conditions.append(CALIBRATION.c.number.in_(select(LOGS.c.calibration).where(LOGS.c.sha256.in_(of_logs))))
        columns = [column for column in CALIBRATION.c if column.name != "file"]
        query = select(*columns).where(*conditions).order_by(CALIBRATION.c.number)
        return [Record(**row._asdict()) for row in self.connection.execute(query)]

    def file(self, number: int) -> str:
        """The text of the calibration file of a record."""
        query = select(CALIBRATION.c.file).where(CALIBRATION.c.number == number)
        return str(self.connection.execute(query).scalar_one())

    def limits(self) -> list[LimitsRecord]:
        """All limits of all types by number; the last ones of a type are in force."""
        rows = [row._asdict() for row in self.connection.execute(select(LIMITS).order_by(LIMITS.c.number))]
        last = {row["model"]: row["number"] for row in rows}
        return [LimitsRecord(**row, in_force=last[row["model"]] == row["number"]) for row in rows]

    def limits_in_force(self, model: str | None) -> LimitsRecord | None:
        """The limits that are in force for a type."""
        return next((each for each in self.limits() if each.in_force and each.model == model), None)

    def add(self, table: Table, **values: Any) -> int:
        """Add a row to a table, now; its number."""
        added = insert(table).values(added=datetime.now(UTC), **values).returning(table.c.number)
        return int(self.connection.execute(added).scalar_one())

    def add_logs(self, calibration: int, logs: Collection[str]) -> None:
        """Say on which logs (SHA-256) a calibration stands."""
        if logs:
            self.connection.execute(insert(LOGS), [{"sha256": log, "calibration": calibration} for log in sorted(logs)])


def connected(place: str, create: bool) -> Database:
    """The database of a registry at a file or URL. Raises as `open_registry`."""
    url = _url(place)
    file = Path(url.database or "") if url.get_backend_name() == "sqlite" else None
    if file is not None and file.is_dir():
        raise InputError(f"{file}: expected a registry, found a folder")
    new = file is not None and not file.exists()
    if new and not create:
        raise InputError(f"{file}: expected a registry, found no such file; `tumble registry add` makes one")
    if file is not None and not file.parent.is_dir():
        raise InputError(f"{file}: expected a folder for the registry, found no {file.parent}; make it first")
    name = url.render_as_string(hide_password=True) if file is None else str(file)
    database = Database(name=name, engine=_engine(url, name), file=file)
    try:
        if not new:
            with database.reading() as rows:
                has_tables = _has_tables(rows.connection, name, create=create)
            if not has_tables:
                with database.writing():
                    pass
    except BaseException:
        database.engine.dispose()
        raise
    return database


def _url(place: str) -> URL:
    """The database of a file name or URL."""
    if place == "":
        raise InputError(f"registry: {_PLACE}, found an empty name")
    if "://" not in place:
        return URL.create("sqlite", database=place)
    try:
        url = make_url(place)
        backend = url.get_backend_name()
    except (ArgumentError, ValueError) as error:
        raise InputError(f"registry: {_PLACE}, found a URL of another form") from error
    if backend in ("postgresql", "postgres"):
        return url.set(drivername="postgresql+psycopg")
    if backend == "sqlite" and url.database not in (None, "", ":memory:"):
        return url.set(drivername="sqlite")
    raise InputError(f"registry: {_PLACE}, found a URL of {backend!r}")


def _engine(url: URL, name: str) -> Engine:
    """An engine whose transactions begin as the module docstring says, and not by the driver."""
    on_file = url.get_backend_name() == "sqlite"
    try:
        arguments = {"timeout": PATIENCE, "isolation_level": None} if on_file else {"connect_timeout": int(PATIENCE)}
        engine = create_engine(url, connect_args=arguments)
    except (ValueError, TypeError) as error:
        raise InputError(f"{name}: expected a URL of a registry, found {error}") from error

    if on_file:
        event.listen(engine, "connect", lambda connection, _: connection.execute("PRAGMA synchronous = FULL"))

    @event.listens_for(engine, "begin")
    def begin(connection: Connection) -> None:
        writes = connection.get_execution_options().get("tumble_writes", False)
        if on_file:
            connection.exec_driver_sql("BEGIN IMMEDIATE" if writes else "BEGIN")
        elif writes:
            connection.exec_driver_sql(f"SET LOCAL lock_timeout = '{PATIENCE:.0f}s'")
            connection.exec_driver_sql(f"SELECT pg_advisory_xact_lock({WRITERS_LOCK})")

    return engine


def _has_tables(connection: Connection, name: str, *, create: bool) -> bool:
    """Whether a database is a registry; False if it is empty and one may be made of it. Raises InputError."""
    tables = set(inspect(connection).get_table_names()) - {"sqlite_sequence"}
    if tables and tables != set(TABLES.tables):
        raise InputError(
            f"{name}: expected a registry or an empty database, found tables of another program, or of another version "
            "of tumble; add the calibration files to a new registry"
        )
    if not tables and not create:
        raise InputError(f"{name}: expected a registry, found an empty database; `tumble registry add` makes one")
    return bool(tables)


def _make_tables(connection: Connection) -> None:
    """Make the tables in an empty database, and triggers that keep their rows."""
    TABLES.create_all(connection, checkfirst=False)
    if connection.dialect.name == "sqlite":
        refusals = [
            f"CREATE TRIGGER {table}_no_{change.lower()} BEFORE {change} ON {table} "
            f"BEGIN SELECT RAISE(ABORT, '{_REFUSED}'); END"
            for table in TABLES.tables
            for change in ("UPDATE", "DELETE")
        ]
    else:
        refusals = [
            "CREATE FUNCTION refuse_change() RETURNS trigger LANGUAGE plpgsql AS "
            f"$$ BEGIN RAISE EXCEPTION '{_REFUSED}'; END $$",
            *(
                f"CREATE TRIGGER {table}_is_kept BEFORE UPDATE OR DELETE OR TRUNCATE ON {table} "
                "FOR EACH STATEMENT EXECUTE FUNCTION refuse_change()"
                for table in TABLES.tables
            ),
        ]
    for statement in refusals:
        connection.exec_driver_sql(statement)
