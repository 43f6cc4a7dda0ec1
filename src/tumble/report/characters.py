"""Text from files as it is shown: no character of it acts, hides or is missing."""

from __future__ import annotations

import unicodedata
from collections.abc import Callable
from functools import cache
from typing import Any

_HIDDEN = frozenset({"Cc", "Cf", "Cn", "Co", "Cs"})


def visible(text: str) -> str:
    """The text with control characters, invisible ones and those that reverse what follows as their code: [U+202E]."""
    return "".join(_code(c) if unicodedata.category(c) in _HIDDEN else c for c in text)


def drawable(text: str) -> str:
    """The visible text with characters that the fonts of the figures and of the PDF lack as their code."""
    return "".join(c if ord(c) in _glyphs() else _code(c) for c in visible(text))


def everywhere(content: Any, change: Callable[[str], str], *, except_key: str) -> Any:
    """Nested dictionaries and sequences with `change` made to every string but those under `except_key`."""
    if isinstance(content, str):
        return change(content)
    if isinstance(content, dict):
        return {k: v if k == except_key else everywhere(v, change, except_key=except_key) for k, v in content.items()}
    if isinstance(content, list | tuple):
        return [everywhere(each, change, except_key=except_key) for each in content]
    return content


def _code(character: str) -> str:
    return f"[U+{ord(character):04X}]"


@cache
def _glyphs() -> frozenset[int]:
    """The characters of DejaVu Sans, which comes with matplotlib, in both weights."""
    from matplotlib import get_data_path
    from matplotlib.ft2font import FT2Font

    fonts = f"{get_data_path()}/fonts/ttf"
    regular, bold = (FT2Font(f"{fonts}/DejaVuSans{weight}.ttf").get_charmap() for weight in ("", "-Bold"))
    return frozenset(regular) & frozenset(bold)
