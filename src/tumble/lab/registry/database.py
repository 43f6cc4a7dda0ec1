"""Tables of a registry, and transactions of its readers and writers.

A device is identified by its serial number and has no table. The row of a calibration has the columns by which records
are searched and listed, and the text of its file. Triggers prevent rows from being changed or deleted. If the tables
change in a later version, one of them must be renamed, so that a database of another version is recognised.

Writers are serialised by BEGIN IMMEDIATE on SQLite and an advisory lock on PostgreSQL. A plain BEGIN on SQLite would
take the lock only at the first write, when data read before may be stale. A reader sees one state of the database
throughout its transaction and never waits.
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

LOCK_TIMEOUT = 30.0  # s, for which a writer waits for another one
WRITERS_LOCK = 7_848_652_101  # key of the advisory lock on PostgreSQL, arbitrary

# SQLite reports these errors for a full disk, among other causes; fewer free bytes than _MIN_FREE identify a full one
_DISK_ERRORS, _MIN_FREE = ("disk I/O error", "database or disk is full"), 1 << 20
_PLACE = "expected a file or postgresql://USER@HOST/NAME"
_REFUSED = "a registry is added to, never changed"


class _Moment(TypeDecorator[datetime]):
    """A time that is stored in UTC without a zone."""

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
    Column("limits", ForeignKey("limits.number")),  # in force at that time
    Column("verdict", String(24)),  # by these limits
    Column("added", _Moment, nullable=False),
    Column("file", Text, nullable=False),  # the whole calibration file
    Index("calibration_of_device", "serial", "performed", "number"),
    sqlite_autoincrement=True,
)

LOGS = Table(  # a log belongs to one calibration
    "calibration_log",
    TABLES,
    Column("sha256", String(64), primary_key=True),
    Column("calibration", ForeignKey("calibration.number"), nullable=False),
)


@dataclass(frozen=True, kw_only=True, slots=True)
class Database:
    """A database, with its `name` in messages: its SQLite `file`, or its URL without the password. A missing file is
    created by the first writer."""

    name: str
    engine: Engine
    file: Path | None

    @contextmanager
    def reading(self) -> Iterator[Rows]:
        """Open a transaction that sees one state of the database. Raises InputError if the database fails."""
        if self.file is not None and not self.file.exists():
            with self.writing():
                pass
        options = {"isolation_level": "REPEATABLE READ"} if self.file is None else {}
        with self._transaction(**options) as connection:
            yield Rows(connection=connection)

    @contextmanager
    def writing(self) -> Iterator[Rows]:
        """Open an exclusive writing transaction, committed when the block ends without an error."""
        is_new, created = self.file is not None and not self.file.exists(), False
        try:
            with self._transaction(tumble_writes=True) as connection:
                if created := not _has_tables(connection, self.name, create=True):
                    _make_tables(connection)
                yield Rows(connection=connection)
        except BaseException:
            self.engine.dispose()
            if is_new and self.file is not None and self.file.is_file() and self.file.stat().st_size == 0:
                self.file.unlink()
            raise
        if self.file is not None and not self.file.is_file():
            raise InputError(f"{self.name}: expected the registry, found that it was removed meanwhile; try again")
        if created and self.file is not None:  # so that readers do not wait for writers; stored in the file
            with suppress(sqlite3.OperationalError), closing(self.engine.raw_connection()) as raw:
                raw.cursor().execute("PRAGMA journal_mode = WAL")  # fails if another process has the file open

    @contextmanager
    def _transaction(self, **options: Any) -> Iterator[Connection]:
        """Open a transaction whose database errors are raised as InputError."""
        try:
            with self.engine.connect() as connection, connection.execution_options(**options).begin():
                yield connection
        except (DBAPIError, sqlite3.Error) as error:
            reason = " ".join(str(getattr(error, "orig", error)).split())
            if "database is locked" in reason or "lock timeout" in reason:
                reason = f"another writer has held it for {LOCK_TIMEOUT:.0f} s; try again"
            elif reason in _DISK_ERRORS and shutil.disk_usage(Path(self.name).parent).free < _MIN_FREE:
                reason = os.strerror(errno.ENOSPC)
            raise InputError(f"{self.name}: the registry cannot be used: {reason}") from error
        except (ValueError, TypeError) as error:  # a damaged column
            raise InputError(
                f"{self.name}: the registry cannot be used: expected what was written into it, found a damaged value: "
                f"{' '.join(str(error).split())}"
            ) from error


@dataclass(frozen=True, kw_only=True, slots=True)
class Rows:
    """Rows of the tables within a transaction."""

    connection: Connection

    def records(self, *, logs: Collection[str] | None = None, **values: object) -> list[Record]:
        """Return the records with these values in their columns and one of these logs (SHA-256), by number."""
        conditions = [CALIBRATION.c[name] == value for name, value in values.items()]
        if logs is not None:
            conditions.append(CALIBRATION.c.number.in_(select(LOGS.c.calibration).where(LOGS.c.sha256.in_(logs))))
        columns = [column for column in CALIBRATION.c if column.name != "file"]
        query = select(*columns).where(*conditions).order_by(CALIBRATION.c.number)
        return [Record(**row._asdict()) for row in self.connection.execute(query)]

    def file(self, number: int) -> str:
        """Return the text of the calibration file of a record."""
        query = select(CALIBRATION.c.file).where(CALIBRATION.c.number == number)
        return str(self.connection.execute(query).scalar_one())

    def limits(self) -> list[LimitsRecord]:
        """Return the limits of all types by number; the last ones of a type are in force."""
        rows = [row._asdict() for row in self.connection.execute(select(LIMITS).order_by(LIMITS.c.number))]
        last = {row["model"]: row["number"] for row in rows}
        return [LimitsRecord(**row, in_force=last[row["model"]] == row["number"]) for row in rows]

    def limits_in_force(self, model: str | None) -> LimitsRecord | None:
        """Return the limits in force for a type, None without."""
        return next((limits for limits in self.limits() if limits.in_force and limits.model == model), None)

    def add(self, table: Table, **values: Any) -> int:
        """Add a row to a table with the current time, and return its number."""
        added = insert(table).values(added=datetime.now(UTC), **values).returning(table.c.number)
        return int(self.connection.execute(added).scalar_one())

    def add_logs(self, calibration: int, logs: Collection[str]) -> None:
        """Add the logs (SHA-256) of a calibration."""
        if logs:
            self.connection.execute(insert(LOGS), [{"sha256": log, "calibration": calibration} for log in sorted(logs)])


def connected(place: str, create: bool) -> Database:
    """Return the database of a registry at a file or URL. Raises as `open_registry`."""
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
    """Return the URL of a file name or URL. Raises InputError for another kind of database."""
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
    """Return an engine that begins transactions itself, as the module docstring says, instead of the driver."""
    on_file = url.get_backend_name() == "sqlite"
    try:
        arguments = (
            {"timeout": LOCK_TIMEOUT, "isolation_level": None} if on_file else {"connect_timeout": int(LOCK_TIMEOUT)}
        )
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
            connection.exec_driver_sql(f"SET LOCAL lock_timeout = '{LOCK_TIMEOUT:.0f}s'")
            connection.exec_driver_sql(f"SELECT pg_advisory_xact_lock({WRITERS_LOCK})")

    return engine


def _has_tables(connection: Connection, name: str, *, create: bool) -> bool:
    """Return True for a registry, False for an empty database if `create`. Raises InputError for others."""
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
    """Create the tables, and the triggers that refuse changes of their rows."""
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
