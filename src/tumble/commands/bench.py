"""`tumble bench`: the live page at the turntable."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import click

from tumble.commands.arguments import EXISTING_FOLDER, programme_option, warn

GRADES = ["navigation", "tactical", "mems", "consumer"]


@click.command()
@click.argument("sessions", metavar="SESSION...", type=EXISTING_FOLDER, nargs=-1, required=True)
@click.option(
    "--listen",
    metavar="SOURCE",
    multiple=True,
    help="What to record: udp:5005, serial:/dev/ttyUSB0:115200, replay:FOLDER@20x …; again: for the next SESSION.",
)
@click.option(
    "--serial",
    "serial_numbers",
    metavar="NUMBER",
    multiple=True,
    help="Serial number, where SESSION is new; again: for the next SESSION.",
)
@click.option("--latitude", type=float, metavar="DEGREES", help="Of the place, ° north, of a new session.")
@click.option("--gravity", type=float, help="Measured gravity, m/s², of a new session.")
@programme_option("Of a new session; default: free positions.")
@click.option(
    "--want", "wanted", multiple=True, metavar="GROUP=VALUE", help="E.g. gyro.scale=2ppm; repeat. Default: the grade's."
)
@click.option(
    "--grade", type=click.Choice(GRADES), default="mems", show_default=True, help="Where the other wishes come from."
)
@click.option(
    "--registry",
    metavar="FILE|URL",
    envvar="TUMBLE_REGISTRY",
    help="Where the page registers; default: TUMBLE_REGISTRY, else a file of the user's.",
)
@click.option(
    "--host",
    default="127.0.0.1",
    show_default=True,
    help="Address to listen on; beyond the loopback a token is asked for.",
)
@click.option("--port", type=click.IntRange(0, 65535), default=8422, show_default=True, help="0: any that is free.")
@click.option("--browser", is_flag=True, help="Open the page.")
def bench(
    sessions: tuple[Path, ...],
    listen: tuple[str, ...],
    serial_numbers: tuple[str, ...],
    latitude: float | None,
    gravity: float | None,
    programme: str | None,
    wanted: tuple[str, ...],
    grade: str,
    registry: str | None,
    host: str,
    port: int,
    browser: bool,
) -> None:
    """The live page: follow a recording, say what to do next, and calibrate at the end.

    SESSION is a folder with session.toml, or a new one for a source that is recorded. Without --listen the log that
    another program writes there is followed. Several are several benches, each with a page of its own, and a list of
    them.
    """
    from tumble.bench.opening import stations_of
    from tumble.bench.web.serve import serve

    given = {"latitude_deg": latitude, "gravity": gravity}
    stations = partial(
        stations_of,
        sessions,
        listen,
        serials=serial_numbers,
        site={key: value for key, value in given.items() if value is not None},
        programme=programme,
        wanted=wanted,
        grade=grade,
        registry=registry,
    )
    serve(stations, folders=sessions, host=host, port=port, browser=browser, say=warn)
