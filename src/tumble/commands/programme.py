"""`tumble programme`: the operator's sheet."""

from __future__ import annotations

from pathlib import Path

import click

from tumble.commands.arguments import FILE, number, programmes_like, say
from tumble.errors import InputError
from tumble.usual_setup import ON_TABLE


@click.command()
@click.argument("name", metavar="[NAME]", required=False, shell_complete=programmes_like)
@click.option("--attitude", "attitudes", multiple=True, help="Instead of NAME: a position's attitude code; repeat.")
@number("--rest", ON_TABLE.rest, "Duration of a rest, s.")
@number("--turn-rate", ON_TABLE.rate_deg_s, "Rate of the turns, °/s.")
@click.option("-o", "--out", type=FILE, help="Write the sheet with a picture of each position: .html, .pdf or .svg.")
@click.option("--serial", default="", help="Of the device, on the sheet; default: a line for it.")
@click.option("--number", "sheet_number", default="", help="Of the sheet, likewise.")
@click.option("--revision", default="", help="Of the sheet, likewise.")
def programme(
    name: str | None,
    attitudes: tuple[str, ...],
    rest: float,
    turn_rate: float,
    out: Path | None,
    serial: str,
    sheet_number: str,
    revision: str,
) -> None:
    """The operator's sheet of a built-in programme NAME or of a list of attitudes."""
    from tumble.programme.positions import programme_of
    from tumble.units import DEGREE
    from tumble.views.render.terminal import print_blocks
    from tumble.views.sheet import sheet_blocks, write_sheet

    if (name is None) == (not attitudes):
        raise InputError("expected either the NAME of a programme or --attitude for each position")
    listed = programme_of(attitudes if name is None else name)
    sheet = sheet_blocks(listed, rest=rest, rate=turn_rate * DEGREE)
    if out is not None:
        pace = {"rest": rest, "rate": turn_rate * DEGREE}
        write_sheet(out, listed, **pace, serial=serial, number=sheet_number, revision=revision)
        say(f"written to {out}")
    print_blocks(*sheet)
