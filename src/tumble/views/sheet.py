"""Operator's sheet of a programme: on a terminal, and as a page, a drawing, or a PDF."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

from tumble.arguments import checked
from tumble.errors import InputError, needs_extra
from tumble.files import FilePath, ending_in, whole_file
from tumble.programme.positions import Programme
from tumble.programme.sheet import SIGNATURES, form_of, legend, picture, sheet_drawing, sheet_page
from tumble.programme.sheet_words import POINTS, RATE, REST, notes_of, pace_of, sheet_rows
from tumble.usual_setup import MOVE
from tumble.views.blocks import Block, table

ENDINGS = (".html", ".pdf", ".svg")


def sheet_blocks(programme: Programme, *, rest: float = REST, rate: float = RATE, move: float = MOVE) -> list[Block]:
    """Return the sheet for a terminal of 100 columns: how to get to each position, its attitude, and when."""
    rows = sheet_rows(programme, rest=rest, rate=rate, move=move)
    listed = [
        {
            "": str(row.number),
            "how to get there": row.how,
            "attitude": row.attitude,
            "up and down": row.position.label,
            "rest": row.when,
        }
        for row in rows
    ]
    title = f"{programme.name}: {pace_of(programme, rows, rate, move)}"
    words = ("how to get there", "attitude", "up and down")
    return [title, table(listed, words=words), *notes_of(programme)]


@checked
def write_sheet(
    path: FilePath,
    programme: Programme,
    *,
    rest: float = REST,
    rate: float = RATE,
    move: float = MOVE,
    serial: str = "",
    number: str = "",
    revision: str = "",
) -> None:
    """Write the operator's sheet of a programme.

    Parameters
    ----------
    path
        The file: a page, .html or .pdf, or the drawing alone, .svg.
    programme
        The positions in their order.
    rest, move
        Duration of a rest, and of a move that no programme prescribes, s.
    rate
        Rate of the turns, rad/s.
    serial, number, revision
        Serial number of the device, number and revision of the sheet; lines for them if empty.

    Raises
    ------
    InputError
        For another ending, and for a file that cannot be written.
    ProgrammeError
        For a programme that no sheet can show.
    MissingExtraError
        For .pdf without the extra `lab`.

    Examples
    --------
    >>> import tumble
    >>> tumble.write_sheet("sheet.svg", tumble.programme_of("nine"), rest=30.0)
    """
    path = Path(path)
    ending = ending_in(path, *ENDINGS)
    pace = {"rest": rest, "rate": rate, "move": move}
    if ending == ".svg":
        content = sheet_drawing(programme, **pace).encode()
    elif ending == ".html":
        content = sheet_page(programme, **pace, serial=serial, number=number, revision=revision).encode()
    else:
        content = _pdf(programme, pace, serial, number, revision)
    try:
        with whole_file(path) as temporary:
            temporary.write_bytes(content)
    except OSError as error:
        raise InputError(f"{path}: expected a file that can be written: {error.strerror or error}") from error


def _pdf(programme: Programme, pace: Mapping[str, float], serial: str, number: str, revision: str) -> bytes:
    """Return the page as PDF/A-2b on A4, without a date, so that the same sheet gives the same bytes."""
    with needs_extra("a sheet as PDF", "lab", "matplotlib", "typst"):
        from tumble.views.render.characters import drawable, everywhere
        from tumble.views.render.pages import set_in_type
    rows = sheet_rows(programme, **pace)
    content = {
        "name": programme.name,
        "pace": pace_of(programme, rows, pace["rate"], pace["move"]),
        "number": number,
        "revision": revision,
        "forms": form_of(serial, number, revision),
        "signatures": SIGNATURES,
        "legend": {"svg": legend()},
        "notes": [*notes_of(programme), POINTS],
        "positions": [
            {
                "number": str(row.number),
                "svg": picture(row.position, row.move),
                "how": row.how,
                "words": [
                    row.position.label,
                    ", ".join(f"{axis} → {where}" for axis, where in zip("XYZ", row.points, strict=True)),
                    f"rest {row.when}",
                ],
                "code": row.attitude,
            }
            for row in rows
        ],
    }
    return set_in_type("sheet.typ", json.dumps(everywhere(content, drawable, except_key="svg")), timestamp=0)
