"""`tumble programme`: the operator's sheet."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from tumble.commands import ask, tell
from tumble.errors import InputError


@click.command(epilog=ask.examples("tumble programme cube-26 -o sheet.html"))
@click.argument("name", metavar="[NAME]", required=False, shell_complete=ask.programmes_like)
@ask.option("--attitude/attitudes", "Instead of NAME: a position's attitude code; repeat.", multiple=True)
@ask.PACE
@ask.out("Write the sheet with a picture of each position: .html, .pdf or .svg.")
@ask.option("--serial", "Of the device, on the sheet; default: a line for it.")
@ask.option("--number", "Of the sheet, likewise.")
@ask.option("--revision", "Of the sheet, likewise.")
def programme(
    name: str | None, attitudes: tuple[str, ...], rest: float, turn_rate: float, out: Path | None, **sheet: str | None
) -> None:
    """The operator's sheet of a built-in programme NAME or of a list of attitudes."""
    from tumble.programme.positions import programme_of
    from tumble.units import DEGREE
    from tumble.views.render.terminal import print_blocks
    from tumble.views.sheet import sheet_blocks, write_sheet

    if (name is None) == (not attitudes):
        raise InputError("expected either the NAME of a programme or --attitude for each position")
    listed = programme_of(attitudes if name is None else name)
    blocks = sheet_blocks(listed, rest=rest, rate=turn_rate * DEGREE)
    if out is not None:
        words: dict[str, Any] = {key: value or "" for key, value in sheet.items()}
        write_sheet(out, listed, rest=rest, rate=turn_rate * DEGREE, **words)
        tell.say(f"written to {out}")
    print_blocks(*blocks)
