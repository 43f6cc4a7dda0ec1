"""The command `bench`, registered in the entry point group `tumble.commands`."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import click

from tumble.commands import console, params


@click.command(
    epilog=params.examples(
        "tumble bench imu-7 --listen udp:5005",
        "tumble bench new --listen serial:/dev/ttyUSB0:115200 --serial A-7 --latitude 56.84",
    )
)
@click.argument("session", type=params.PATH)
@params.option(
    "--listen", "What to record: udp:5005, serial:/dev/ttyUSB0:115200, replay:FOLDER@20x …", metavar="SOURCE"
)
@params.option("--serial", "Serial number of the device, for a new SESSION.", metavar="NUMBER")
@params.LATITUDE
@params.HEIGHT
@params.GRAVITY
@params.programme("Programme of a new SESSION; default: free positions.")
@params.WANT
@params.grade("mems", ": for uncertainties that are not stated")
@params.REGISTRY
@params.option("--host", "Address to listen on; other than loopback, access needs a token.", "127.0.0.1")
@params.option("--port", "Port to listen on; 0: any free port.", 8422, type=click.IntRange(0, 65535))
def bench(
    session: Path,
    listen: str | None,
    latitude: float | None,
    height: float | None,
    gravity: float | None,
    place: str | None,
    host: str,
    port: int,
    **options: Any,
) -> None:
    """The live page: follow a recording, say what to do next, and calibrate at the end.

    SESSION is a folder with session.toml, or a new one for a source that is recorded. Without --listen the log that
    another program writes there is followed.
    """
    from tumble.bench.station import station_of
    from tumble.bench.web.serve import serve

    given = {"latitude_deg": latitude, "height_m": height, "gravity": gravity}
    site = {key: value for key, value in given.items() if value is not None}
    station = partial(station_of, session, listen, site=site, registry=place, **options)
    serve(station, folder=session, host=host, port=port, say=console.warn)
