"""`tumble ellipsoid`: a calibration from a table of readings."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from tumble.commands.arguments import FILE, JSON, grades_like, say, warn
from tumble.documents import whole_number
from tumble.errors import InputError

if TYPE_CHECKING:
    from tumble.calibration.calibrate import Terms
    from tumble.calibration.readings_table import Sensor
    from tumble.sensors.frames import Frame
    from tumble.units import Array


@click.command()
@click.argument("readings", metavar="READINGS.csv", type=FILE)
@click.option(
    "--unit", default="V", show_default=True, help="Of the readings: V, count, g, m/s^2; others: see --sensor."
)
@click.option(
    "--scale", metavar="K|K,K,K", help="Nominal output per unit, signed by polarity; default: from the readings."
)
@click.option("--scale-per", help="Unit that the scale is per: g (default) or m/s^2.")
@click.option("--gravity", type=float, help="At the place of the readings, m/s^2; default: it is the unit, as 9.80665.")
@click.option("--gravity-u", type=float, help="Its standard uncertainty; default: 3e-4, of gravity from a latitude.")
@click.option(
    "--position", "positions", multiple=True, metavar="N=X,Y,Z", help="Where up roughly was in position N; repeat."
)
@click.option(
    "--sensor", type=click.Choice(["accel", "gyro", "mag"]), default="accel", show_default=True, help="What they are."
)
@click.option("--modulus", type=float, help="gyro: rate of the table; mag: the field; in --unit or --scale-per.")
@click.option("--modulus-u", type=float, help="Its standard uncertainty; default: scale factors are relative to it.")
@click.option("--rows-per-position", type=int, default=1, show_default=True, help="Rows of one position after another.")
@click.option(
    "--grade",
    shell_complete=grades_like,
    help="navigation, tactical, mems or consumer; default: guessed from biases and residuals.",
)
@click.option(
    "--terms",
    type=click.Choice(["full", "linear"]),
    default="full",
    show_default=True,
    help="What u contains: all groups of the accelerometers, or bias, scale and axes alone.",
)
@click.option(
    "--frame",
    type=click.Choice(["accelerometer", "paper", "symmetric"]),
    default="accelerometer",
    show_default=True,
    help="Of the result.",
)
@click.option("--serial", help="Serial number of the device; default: the name of the table without its ending.")
@click.option("-o", "--out", type=FILE, help="Calibration file; default: READINGS.calibration.json beside the table.")
@click.option("--force", is_flag=True, help="Replace a calibration file that came from another table or method.")
@JSON
def ellipsoid(
    readings: Path,
    unit: str,
    scale: str | None,
    scale_per: str | None,
    gravity: float | None,
    gravity_u: float | None,
    positions: tuple[str, ...],
    sensor: Sensor,
    modulus: float | None,
    modulus_u: float | None,
    rows_per_position: int,
    grade: str | None,
    terms: Terms,
    frame: Frame,
    serial: str | None,
    out: Path | None,
    force: bool,
    as_json: bool,
) -> None:
    """Calibrate a triad from READINGS.csv, a table of mean readings in nine or more positions of any orientation.

    The table has a header with the names of three columns, one per channel, and a row per position.
    """
    from tumble.calibration.from_readings import calibrate_table
    from tumble.views.readings import readings_blocks
    from tumble.views.render.data import print_data
    from tumble.views.render.terminal import print_blocks

    result = calibrate_table(
        readings,
        sensor=sensor,
        unit=unit,
        scale=None if scale is None else _numbers("--scale", scale),
        scale_per=scale_per,
        gravity=gravity,
        gravity_u=gravity_u,
        modulus=modulus,
        modulus_u=modulus_u,
        known=dict(map(_position, positions)),
        rows_per_position=rows_per_position,
        grade=grade,
        terms=terms,
        frame=frame,
        serial=serial,
    )
    target = out or readings.with_suffix(".calibration.json")
    result.calibration.write(target, force=force)
    if as_json:
        print_data(result.calibration.content())
    else:
        print_blocks(*readings_blocks(result))
    say(f"written to {target}")
    for reason in result.calibration.outcome.reasons:
        warn(f"not accepted: {reason}")
    sys.exit(0 if result.calibration.outcome.accepted else 1)


def _numbers(option: str, text: str) -> list[float]:
    try:
        return [float(number) for number in text.split(",")]
    except ValueError:
        raise InputError(f"{option}: expected numbers with commas between them, found {text!r}") from None


def _position(text: str) -> tuple[int, Array]:
    """N=X,Y,Z: a position and the direction (3,) of up in it."""
    import numpy as np

    number, _, direction = text.partition("=")
    position = whole_number(number.strip())
    vector = np.array(_numbers("--position", direction)) if direction else np.zeros(0)
    if position is None or vector.shape != (3,) or not np.isfinite(vector).all() or not vector.any():
        raise InputError(f"--position: expected N=X,Y,Z, the number of a position and a direction, found {text!r}")
    return position, vector
