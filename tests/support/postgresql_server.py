"""A PostgreSQL server of the tests' own: a free loopback port, its own data folder, an unprivileged user; stopped
by its pid."""

from __future__ import annotations

import os
import pwd
import secrets
import shutil
import signal
import socket
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import psycopg
import pytest

USER = "tumble"
PATIENCE = 60.0  # s


@dataclass(frozen=True, kw_only=True, slots=True)
class Server:
    """A running server."""

    port: int
    password: str

    def url(self, database: str) -> str:
        """The URL of a database on it."""
        return f"postgresql://{USER}:{self.password}@127.0.0.1:{self.port}/{database}"

    def new_database(self) -> str:
        """The URL of an empty database."""
        name = f"registry_{secrets.token_hex(6)}"
        with psycopg.connect(self.url("postgres"), autocommit=True) as connection:
            connection.execute(f"CREATE DATABASE {name}")
        return self.url(name)


@contextmanager
def postgresql_server() -> Iterator[Server]:
    """A server that runs until the block ends. Without PostgreSQL the test is skipped, and fails in CI."""
    programs = _programs()
    folder = Path(tempfile.mkdtemp(prefix="tumble-postgresql-"))
    account = _account(folder)
    password = secrets.token_urlsafe(12)
    (folder / "password").write_text(password, encoding="utf-8")
    data = folder / "data"
    options = ["--auth=scram-sha-256", f"--pwfile={folder / 'password'}", "--no-sync", "--no-locale", "--encoding=UTF8"]
    initdb: list[str | Path] = [programs / "initdb", "-D", data, "-U", USER, *options]
    subprocess.run(initdb, check=True, stdout=subprocess.DEVNULL, cwd=folder, timeout=PATIENCE, **account)
    port = _free_port()
    settings = {"listen_addresses": "127.0.0.1", "port": port, "unix_socket_directories": folder, "fsync": "off"}
    command: list[str | Path] = [
        programs / "postgres",
        "-D",
        data,
        *(f"--{key}={value}" for key, value in settings.items()),
    ]
    with (folder / "log").open("wb") as log:
        process: subprocess.Popen[bytes] = subprocess.Popen(command, stdout=log, stderr=log, cwd=folder, **account)
    try:
        server = Server(port=port, password=password)
        _wait(server, process, folder / "log")
        yield server
    finally:
        process.send_signal(signal.SIGQUIT)  # an immediate shutdown: nothing is to be kept
        process.wait(timeout=PATIENCE)
        shutil.rmtree(folder)


def _programs() -> Path:
    """The folder of initdb and postgres; distributions do not put it into PATH."""
    found = [*Path("/usr/lib/postgresql").glob("*/bin"), *map(Path, os.environ.get("PATH", "").split(os.pathsep))]
    if shutil.which("pg_config"):
        said = subprocess.run(["pg_config", "--bindir"], capture_output=True, text=True, check=True)
        found.append(Path(said.stdout.strip()))
    for folder in sorted(found, reverse=True):
        if (folder / "initdb").exists() and (folder / "postgres").exists():
            return folder
    missing = "PostgreSQL is not installed: no initdb in /usr/lib/postgresql, PATH or pg_config --bindir"
    if os.environ.get("CI") == "true":
        pytest.fail(missing)
    pytest.skip(missing)


def _account(folder: Path) -> dict[str, Any]:
    """For root: arguments that run a process as a user without rights, to whom the folder is given."""
    if os.getuid() != 0:
        return {}
    nobody = pwd.getpwnam("nobody")
    os.chown(folder, nobody.pw_uid, nobody.pw_gid)
    return {"user": nobody.pw_uid, "group": nobody.pw_gid, "extra_groups": []}


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def _wait(server: Server, process: subprocess.Popen[bytes], log: Path) -> None:
    """Wait until the server takes connections."""
    deadline = time.monotonic() + PATIENCE
    while True:
        try:
            psycopg.connect(server.url("postgres"), connect_timeout=5).close()
            return
        except psycopg.OperationalError:
            if process.poll() is not None or time.monotonic() > deadline:
                raise AssertionError(f"the server did not start:\n{log.read_text()}") from None
            time.sleep(0.05)
