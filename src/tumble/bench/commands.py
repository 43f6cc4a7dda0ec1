"""The command `bench`."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import click

from tumble.commands import ask, tell


@click.command(
    epilog=ask.examples(
        "tumble bench imu-7 --listen udp:5005",
        "tumble bench new --listen serial:/dev/ttyUSB0:115200 --serial A-7 --latitude 56.84",
    )
)
@click.argument("sessions", metavar="SESSION...", type=ask.PATH, nargs=-1, required=True)
@ask.option(
    "--listen",
    "What to record: udp:5005, serial:/dev/ttyUSB0:115200, replay:FOLDER@20x …; again: for the next SESSION.",
    metavar="SOURCE",
    multiple=True,
)
@ask.option("--serial/serials", "Of a new SESSION; again: for the next SESSION.", metavar="NUMBER", multiple=True)
@ask.LATITUDE
@ask.GRAVITY
@ask.programme("Of a new session; default: free positions.")
@ask.WANT
@ask.grade("mems", ": where the other wishes come from")
@ask.REGISTRY
@ask.option("--host", "Address to listen on; beyond the loopback a token is asked for.", "127.0.0.1")
@ask.option("--port", "0: any that is free.", 8422, type=click.IntRange(0, 65535))
@click.option("--browser", is_flag=True, help="Open the page.")
def bench(
    sessions: tuple[Path, ...],
    listen: tuple[str, ...],
    latitude: float | None,
    gravity: float | None,
    place: str | None,
    host: str,
    port: int,
    browser: bool,
    **options: Any,
) -> None:
    """The live page: follow a recording, say what to do next, and calibrate at the end.

    SESSION is a folder with session.toml, or a new one for a source that is recorded. Without --listen the log that
    another program writes there is followed. Several are several benches, each with a page of its own, and a list of
    them.
    """
    from tumble.bench.station import stations_of
    from tumble.bench.web.serve import serve

    told = {"latitude_deg": latitude, "gravity": gravity}
    site = {key: value for key, value in told.items() if value is not None}
    stations = partial(stations_of, sessions, listen, site=site, registry=place, **options)
    serve(stations, folders=sessions, host=host, port=port, browser=browser, say=tell.warn)
