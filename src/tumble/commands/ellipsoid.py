"""`tumble ellipsoid`: a calibration from a table of readings."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from tumble.commands import ask, tell
from tumble.errors import InputError

if TYPE_CHECKING:
    from tumble.units import Array


@click.command(
    epilog=ask.examples(
        "tumble ellipsoid positions.csv --unit g", "tumble ellipsoid compass.csv --sensor mag --unit uT"
    )
)
@click.argument("readings", metavar="READINGS.csv", type=ask.FILE)
@ask.option("--unit", "Of the readings: V, count, g, m/s^2; others: see --sensor.", "V")
@ask.option("--scale", "Nominal output per unit, signed by polarity; default: from the readings.", metavar="K|K,K,K")
@ask.option("--scale-per", "Unit that the scale is per: g (default) or m/s^2.")
@ask.GRAVITY
@ask.option("--gravity-u", "Its standard uncertainty; default: 3e-4, of gravity from a latitude.", type=float)
@ask.option("--position/positions", "Where up roughly was in position N; repeat.", multiple=True, metavar="N=X,Y,Z")
@ask.option("--sensor", "What they are.", "accel", type=click.Choice(["accel", "gyro", "mag"]))
@ask.option("--modulus", "gyro: rate of the table; mag: the field; in --unit or --scale-per.", type=float)
@ask.option("--modulus-u", "Its standard uncertainty; default: scale factors are relative to it.", type=float)
@ask.option("--rows-per-position", "Rows of one position after another.", 1, type=int)
@ask.grade(None, "; default: guessed from biases and residuals")
@ask.terms("full")
@ask.frame([frame for frame in ask.FRAMES if frame != "case"])
@ask.SERIAL
@ask.out("Calibration file; default: READINGS.calibration.json beside the table.")
@ask.force("Replace a calibration file that came from another table or method.")
@ask.JSON
def ellipsoid(
    readings: Path,
    scale: str | None,
    positions: tuple[str, ...],
    out: Path | None,
    force: bool,
    as_json: bool,
    **options: Any,
) -> None:
    """Calibrate a triad from READINGS.csv, a table of mean readings in nine or more positions of any orientation.

    The table has a header with the names of three columns, one per channel, and a row per position.
    """
    from tumble.run.from_readings import calibrate_table
    from tumble.views.readings import readings_blocks

    nominal = None if scale is None else _numbers("--scale", scale)
    result = calibrate_table(readings, scale=nominal, known=dict(map(_position, positions)), **options)
    target = out or readings.with_suffix(".calibration.json")
    result.calibration.write(target, force=force)
    tell.show(as_json, result.calibration.content, lambda: readings_blocks(result))
    tell.say(f"written to {target}")
    tell.end(result.calibration.outcome.reasons, "not accepted: ")


def _numbers(option: str, text: str) -> list[float]:
    try:
        return [float(number) for number in text.split(",")]
    except ValueError:
        raise InputError(f"{option}: expected numbers with commas between them, found {text!r}") from None


def _position(text: str) -> tuple[int, Array]:
    """N=X,Y,Z: a position and the direction (3,) of up in it."""
    import numpy as np

    from tumble.documents import whole_number

    number, _, direction = text.partition("=")
    position = whole_number(number.strip())
    vector = np.array(_numbers("--position", direction)) if direction else np.zeros(0)
    if position is None or vector.shape != (3,) or not np.isfinite(vector).all() or not vector.any():
        raise InputError(f"--position: expected N=X,Y,Z, the number of a position and a direction, found {text!r}")
    return position, vector
