"""Text for pages: control and invisible characters are replaced, numbers have a real minus."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Callable
from dataclasses import asdict
from functools import cache
from typing import Any

from tumble.views.blocks import Document

_HIDDEN = frozenset({"Cc", "Cf", "Cn", "Co", "Cs"})


def visible(text: str) -> str:
    """Replace control characters, invisible ones and those that reverse the text direction by their code: [U+202E]."""
    return "".join(_code(c) if unicodedata.category(c) in _HIDDEN else c for c in text)


def drawable(text: str) -> str:
    """Also replace characters that are missing in the fonts of figures and PDF by their code."""
    return "".join(c if ord(c) in _glyphs() else _code(c) for c in visible(text))


def everywhere(content: Any, change: Callable[[str], str], *, except_key: str) -> Any:
    """Apply `change` to every string of nested dictionaries and sequences, except those under `except_key`."""
    if isinstance(content, str):
        return change(content)
    if isinstance(content, dict):
        return {k: v if k == except_key else everywhere(v, change, except_key=except_key) for k, v in content.items()}
    if isinstance(content, list | tuple):
        return [everywhere(each, change, except_key=except_key) for each in content]
    return content


def printed(document: Document, change: Callable[[str], str]) -> dict[str, Any]:
    """Return the content of a document for a template: all texts changed by `change`; in columns of numbers real
    minuses, and a dash in empty cells."""
    content: dict[str, Any] = everywhere(asdict(document), change, except_key="svg")
    blocks = (block for part in content["parts"] for section in part["sections"] for block in section["blocks"])
    for table in (block for block in blocks if block["kind"] == "table"):
        table["rows"] = [
            [cell if i in table["text"] else _MINUS.sub("−", cell) or "—" for i, cell in enumerate(row)]
            for row in table["rows"]
        ]
    return content


_MINUS = re.compile(r"(?<![\w.])-(?=[\d.∞])")


def _code(character: str) -> str:
    return f"[U+{ord(character):04X}]"


@cache
def _glyphs() -> frozenset[int]:
    """Return the characters of DejaVu Sans, which comes with matplotlib, in both weights."""
    from matplotlib import get_data_path
    from matplotlib.ft2font import FT2Font

    fonts = f"{get_data_path()}/fonts/ttf"
    regular, bold = (FT2Font(f"{fonts}/DejaVuSans{weight}.ttf").get_charmap() for weight in ("", "-Bold"))
    return frozenset(regular) & frozenset(bold)
