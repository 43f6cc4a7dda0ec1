"""The database of a registry: its tables, what is asked of them, and the transactions of readers and writers.

A device is its serial number; it has no table of its own, since there is nothing to say about a device that could not
change. A calibration has the columns by which records are searched and listed, and the text of its file. Times are in
UTC, without a zone. Triggers refuse that a row is changed or deleted. A change of the tables takes another name of one
of them, by which a database of another version is recognised.

Writers come one after the other: SQLite's BEGIN IMMEDIATE, an advisory lock on PostgreSQL. A plain BEGIN on SQLite
takes the lock only at the first write, and what was read before it may be stale by then. A reader sees one state of the
database from its first query to its last and waits for nobody.
"""

from __future__ import annotations

import errno
import os
import shutil
import sqlite3
from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from sqlalchemy import (
    URL,
    Column,
    ColumnElement,
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


TABLES = MetaData()

LIMITS = Table(
    "limits",
    TABLES,
    Column("number", Integer, primary_key=True),
    Column("model", Text, nullable=False, index=True),
    Column("file", Text, nullable=False),  # the TOML file
    Column("systematic", Text),  # the calibration file it names
    Column("added", DateTime, nullable=False),
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
    Column("performed", DateTime, nullable=False),
    Column("occasion", String(16), nullable=False),  # incoming, periodic
    Column("state", String(16), nullable=False),  # as-found, as-left, unchanged
    Column("limits", ForeignKey("limits.number")),  # that were in force
    Column("verdict", String(24)),  # by them
    Column("added", DateTime, nullable=False),
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
    """An open database. `name` is what messages call it: its file, or its URL without the password. `file`: that of
    SQLite. A `new` one is there with the first that is written, and not before."""

    name: str
    engine: Engine
    file: Path | None
    new: bool

    @contextmanager
    def reading(self) -> Iterator[Rows]:
        """A transaction that sees one state of the database. Raises InputError, one line, where the database fails."""
        if self.new:
            with self.writing():
                pass
        with self._transaction(**{} if _is_file(self.engine.url) else {"isolation_level": "REPEATABLE READ"}) as begun:
            yield Rows(connection=begun)

    @contextmanager
    def writing(self) -> Iterator[Rows]:
        """The transaction of the only writer, committed when the block ends without an error."""
        created = False
        try:
            with self._transaction(tumble_writes=True) as begun:
                created = self.new and not _has_tables(begun, self.name, create=True)
                if created:
                    _make_tables(begun)
                yield Rows(connection=begun)
        except BaseException:
            self.engine.dispose()
            if self.new and self.file is not None and self.file.is_file() and self.file.stat().st_size == 0:
                self.file.unlink()
            raise
        if self.file is not None and not self.file.is_file():
            raise InputError(f"{self.name}: expected the registry, found that it was removed meanwhile; try again")
        if created and self.file is not None:  # readers do not wait for writers then; the file remembers it
            with suppress(sqlite3.OperationalError), closing(self.engine.raw_connection()) as raw:
                raw.cursor().execute("PRAGMA journal_mode = WAL")  # or the last of those that opened it at once does

    @contextmanager
    def _transaction(self, **options: Any) -> Iterator[Connection]:
        try:
            with in_one_line(self.name), self.engine.connect() as begun, begun.execution_options(**options).begin():
                yield begun
        except (ValueError, TypeError) as error:  # a column that is not what it was written as
            raise InputError(
                f"{self.name}: the registry cannot be used: expected what was written into it, found a damaged value: "
                f"{' '.join(str(error).split())}"
            ) from error


@dataclass(frozen=True, kw_only=True, slots=True)
class Rows:
    """What is asked of the tables within a transaction."""

    connection: Connection

    def records(self, **values: object) -> list[Record]:
        """The records that have these values in their columns, by number."""
        return self._records(*(CALIBRATION.c[name] == value for name, value in values.items()))

    def records_with_logs(self, logs: set[str]) -> list[Record]:
        """The records that stand on one of these logs (SHA-256)."""
        return self._records(CALIBRATION.c.number.in_(select(LOGS.c.calibration).where(LOGS.c.sha256.in_(logs))))

    def _records(self, *conditions: ColumnElement[bool]) -> list[Record]:
        columns = [column for column in CALIBRATION.c if column.name != "file"]
        query = select(*columns).where(*conditions).order_by(CALIBRATION.c.number)
        return [Record(**_whole(row._asdict(), CALIBRATION)) for row in self.connection.execute(query)]

    def file(self, number: int) -> str:
        """The text of the calibration file of a record."""
        query = select(CALIBRATION.c.file).where(CALIBRATION.c.number == number)
        return str(self.connection.execute(query).scalar_one())

    def add(self, values: Mapping[str, Any], logs: set[str]) -> Record:
        """A new record with the values of its columns, and the logs (SHA-256) it stands on."""
        added = insert(CALIBRATION).returning(CALIBRATION.c.number)
        number = int(self.connection.execute(added, _without_zone(values)).scalar_one())
        if logs:
            self.connection.execute(insert(LOGS), [{"sha256": log, "calibration": number} for log in sorted(logs)])
        return self.records(number=number)[0]

    def limits(self) -> list[LimitsRecord]:
        """All limits of all types by number; the last ones of a type are in force."""
        every = self.connection.execute(select(LIMITS).order_by(LIMITS.c.number))
        rows = [_whole(row._asdict(), LIMITS) for row in every]
        last = {row["model"]: row["number"] for row in rows}
        return [LimitsRecord(**row, in_force=last[row["model"]] == row["number"]) for row in rows]

    def limits_in_force(self, model: str | None) -> LimitsRecord | None:
        """The limits that are in force for a type."""
        return next((each for each in self.limits() if each.in_force and each.model == model), None)

    def add_limits(self, model: str, file: str, systematic: str | None) -> LimitsRecord:
        """New limits of a type, in force from now on."""
        values = {"model": model, "file": file, "systematic": systematic, "added": datetime.now(UTC)}
        self.connection.execute(insert(LIMITS), _without_zone(values))
        return self.limits()[-1]


def _whole(row: dict[str, Any], table: Table) -> dict[str, Any]:
    """A row of a table with its times in UTC. Raises ValueError for one that lacks what every row has."""
    if missing := [name for name, value in row.items() if value is None and not table.c[name].nullable]:
        raise ValueError(f"no {missing[0]}")
    return row | {name: v.replace(tzinfo=UTC) for name, v in row.items() if isinstance(v, datetime)}


def _without_zone(values: Mapping[str, Any]) -> dict[str, Any]:
    return {
        name: v.astimezone(UTC).replace(tzinfo=None) if isinstance(v, datetime) else v for name, v in values.items()
    }


# -------------------- where it is --------------------


def connected(place: str, create: bool) -> Database:
    """The database of a registry at a file or URL. Raises as `open_registry`."""
    url = _url(place)
    file = Path(url.database or "") if _is_file(url) else None
    name, new = str(file) if file else url.render_as_string(hide_password=True), False
    if file is not None:
        new = not file.exists()
        if file.is_dir():
            raise InputError(f"{file}: expected a registry, found a folder")
        if new and not create:
            raise InputError(f"{file}: expected a registry, found no such file; `tumble registry add` makes one")
        if new and not file.parent.is_dir():
            raise InputError(f"{file}: expected a folder for the registry, found no {file.parent}; make it first")
    engine = _engine(url, name)
    try:
        if not new:
            with Database(name=name, engine=engine, file=file, new=False).reading() as rows:
                new = not _has_tables(rows.connection, name, create)
        return Database(name=name, engine=engine, file=file, new=new)
    except BaseException:
        engine.dispose()
        raise


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


def _is_file(url: URL) -> bool:
    return url.get_backend_name() == "sqlite"


def _engine(url: URL, name: str) -> Engine:
    """An engine whose transactions begin as the module docstring says."""
    on_file = _is_file(url)
    try:
        arguments: dict[str, Any] = {"timeout": PATIENCE} if on_file else {"connect_timeout": int(PATIENCE)}
        engine = create_engine(url, connect_args=arguments)
    except (ValueError, TypeError) as error:
        raise InputError(f"{name}: expected a URL of a registry, found {error}") from error

    def set_up(connection: Any, _: object) -> None:
        connection.isolation_level = None  # transactions are begun below, not by the driver
        for pragma in ("foreign_keys = ON", "synchronous = FULL"):
            connection.execute(f"PRAGMA {pragma}")

    def begin(connection: Connection) -> None:
        writes = connection.get_execution_options().get("tumble_writes", False)
        if on_file:
            connection.exec_driver_sql("BEGIN IMMEDIATE" if writes else "BEGIN")
        elif writes:
            connection.exec_driver_sql(f"SET LOCAL lock_timeout = '{PATIENCE:.0f}s'")
            connection.exec_driver_sql(f"SELECT pg_advisory_xact_lock({WRITERS_LOCK})")

    if on_file:
        event.listen(engine, "connect", set_up)
    event.listen(engine, "begin", begin)
    return engine


def _has_tables(connection: Connection, name: str, create: bool) -> bool:
    """Whether a database is a registry; False if it is empty and one may be made of it. Raises InputError."""
    tables = set(inspect(connection).get_table_names()) - {"sqlite_sequence"}
    if tables == set(TABLES.tables):
        return True
    if tables:
        raise InputError(
            f"{name}: expected a registry or an empty database, found tables of another program, or of another version "
            "of tumble; add the calibration files to a new registry"
        )
    if not create:
        raise InputError(f"{name}: expected a registry, found an empty database; `tumble registry add` makes one")
    return False


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


@contextmanager
def in_one_line(name: str) -> Iterator[None]:
    """Errors of the database as InputError, those of SQLite's own module too."""
    try:
        yield
    except (DBAPIError, sqlite3.Error) as error:
        text = " ".join(str(getattr(error, "orig", error)).split())
        reason = text
        if "database is locked" in text or "lock timeout" in text:
            reason = f"another writer has held it for {PATIENCE:.0f} s; try again"
        elif text in _NO_ROOM and shutil.disk_usage(Path(name).parent).free < _ROOM:
            reason = os.strerror(errno.ENOSPC)
        raise InputError(f"{name}: the registry cannot be used: {reason}") from error
