"""Where the registry is, and the transactions of its readers and writers.

Writers come one after the other: SQLite's BEGIN IMMEDIATE, an advisory lock on PostgreSQL. A plain BEGIN on SQLite
takes the lock only at the first write, and what was read before it may be stale by then. A reader sees one state of the
database from its first query to its last and waits for nobody.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import AbstractContextManager, closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

from tumble.errors import InputError, needs_extra
from tumble.files import FilePath

if TYPE_CHECKING:
    from sqlalchemy import URL, Connection, Engine

PATIENCE = 30.0
"""How long a writer waits for another one, s."""

WRITERS_LOCK = 7_848_652_101
"""The advisory lock of writers on PostgreSQL, a number of our own."""

FILE_NAME = "registry.sqlite"

_LIBRARIES = ("platformdirs", "psycopg", "sqlalchemy")
_PLACE = "expected a file or postgresql://USER@HOST/NAME"


@dataclass(frozen=True, kw_only=True, slots=True)
class Registry:
    """An open registry. `name` is how messages call it: its file, or its URL without the password."""

    name: str
    engine: Engine

    @contextmanager
    def reading(self) -> Iterator[Connection]:
        """A transaction that sees one state of the database. Raises InputError, one line, where the database fails."""
        with self._transaction(**{} if _is_file(self.engine.url) else {"isolation_level": "REPEATABLE READ"}) as begun:
            try:
                yield begun
            except (ValueError, TypeError) as error:  # of a column that is not what it was written as
                raise InputError(
                    f"{self.name}: the registry cannot be used: expected what was written into it, found a damaged "
                    f"value: {' '.join(str(error).split())}"
                ) from error

    @contextmanager
    def writing(self) -> Iterator[Connection]:
        """A transaction that is the only writer's, committed when the block ends without an error."""
        with self._transaction(tumble_writes=True) as begun:
            yield begun

    @contextmanager
    def _transaction(self, **options: Any) -> Iterator[Connection]:
        with in_one_line(self.name), self.engine.connect() as begun, begun.execution_options(**options).begin():
            yield begun


@contextmanager
def open_registry(place: FilePath | None = None, *, create: bool = False) -> Iterator[Registry]:
    """The registry at a file or URL (default: registry.sqlite in the user's data folder). With `create` one that does
    not exist is made.

    Raises InputError, one line: no such registry, another program's database, a registry of another version, a server
    that does not answer; MissingExtraError without the extra.

    >>> import tumble
    >>> with tumble.open_registry("registry.sqlite", create=True) as registry:
    ...     tumble.records(registry)
    []
    """
    with extra_named():
        registry = _connected(None if place is None else os.fspath(place), create)
    try:
        yield registry
    finally:
        registry.engine.dispose()


def _connected(place: str | None, create: bool) -> Registry:
    from tumble.lab.registry.store.tables import has_tables, make_tables

    url = _url(place)
    file = Path(url.database or "") if _is_file(url) else None
    name, new = str(file) if file else url.render_as_string(hide_password=True), False
    if file is not None:
        new = not file.exists()
        if file.is_dir():
            raise InputError(f"{file}: expected a registry, found a folder")
        if new and not create:
            raise InputError(f"{file}: expected a registry, found no such file; `tumble registry add` makes one")
        if new and place is None:  # the user's own data folder is made too, no other
            file.parent.mkdir(parents=True, exist_ok=True)
        if new and not file.parent.is_dir():
            raise InputError(f"{file}: expected a folder for the registry, found no {file.parent}; make it first")
        beside = (file.with_name(file.name + ending) for ending in ("-wal", "-journal"))
        if not create and not os.access(file.parent, os.W_OK) and not any(each.exists() for each in beside):
            # where nothing can be written nobody does while it is read; SQLite would make files beside it
            url = url.set(database=f"file:{quote(str(file.resolve()))}", query={"immutable": "1", "uri": "true"})
    registry = Registry(name=name, engine=_engine(url, name))
    try:
        with registry.reading() as connection:
            if has_tables(connection, name, create):
                return registry
        if file is not None:  # readers do not wait for writers then; the file remembers it
            with in_one_line(name), closing(registry.engine.raw_connection()) as raw:
                raw.cursor().execute("PRAGMA journal_mode = WAL")
        with registry.writing() as connection:  # of programs that open a new registry at once, the first makes them
            if not has_tables(connection, name, create):
                make_tables(connection)
    except BaseException:
        registry.engine.dispose()
        if new and file is not None and file.is_file() and file.stat().st_size == 0:
            file.unlink()
        raise
    return registry


def extra_named() -> AbstractContextManager[None]:
    """Where a library of the extra is missing, what to install."""
    return needs_extra("the registry", "lab", *_LIBRARIES)


def _url(place: str | None) -> URL:
    """The database of a file name or URL."""
    from sqlalchemy import URL, make_url
    from sqlalchemy.exc import ArgumentError

    if place == "":
        raise InputError(f"registry: {_PLACE}, found an empty name")
    if place is None or "://" not in place:
        path = default_file() if place is None else Path(place)
        return URL.create("sqlite", database=str(path))
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


def default_file() -> Path:
    """registry.sqlite in the folder for data of the user's programs."""
    from platformdirs import user_data_path

    return user_data_path("tumble", appauthor=False) / FILE_NAME


def _is_file(url: URL) -> bool:
    return url.get_backend_name() == "sqlite"


def _engine(url: URL, name: str) -> Engine:
    """An engine whose transactions begin as the module docstring says."""
    from sqlalchemy import create_engine, event

    try:
        arguments: dict[str, Any] = {"timeout": PATIENCE} if _is_file(url) else {"connect_timeout": int(PATIENCE)}
        engine = create_engine(url, connect_args=arguments)
    except (ValueError, TypeError) as error:
        raise InputError(f"{name}: expected a URL of a registry, found {error}") from error
    on_file = _is_file(url)

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


@contextmanager
def in_one_line(name: str) -> Iterator[None]:
    """Errors of the database as InputError, those of SQLite's own module too."""
    import sqlite3

    from sqlalchemy.exc import DBAPIError

    try:
        yield
    except (DBAPIError, sqlite3.Error) as error:
        said = " ".join(str(getattr(error, "orig", error)).split())
        busy = "database is locked" in said or "lock timeout" in said
        advice = f"another writer has held it for {PATIENCE:.0f} s; try again" if busy else said
        raise InputError(f"{name}: the registry cannot be used: {advice}") from error
