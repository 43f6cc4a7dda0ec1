"""TOML and JSON as users give them, and words of data as a message can show them.

What a parser says of a document becomes one line; so do numbers of thousands of digits and hundreds of brackets, which
are no error of the syntax. No character that moves the cursor of a terminal or turns the direction of writing round is
shown.
"""

from __future__ import annotations

import json
import re
import tomllib
import unicodedata
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NoReturn

from tumble.errors import InputError

LARGEST_DOCUMENT = 1 << 26
"""Bytes of a document that is read as a whole: 64 MB."""
LONGEST_LINE = 1000
"""Characters of a message."""

_LONGEST_WORD = 160
_LONGEST_KEY = 16
"""Parts of a key of TOML, a.b.c: the memory and the time that a parser takes grow with their square."""
_LONG_KEY = re.compile(rf"""(?<![\w"'-])(?:(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')[ \t]*+\.[ \t]*+){{{_LONGEST_KEY}}}""")
_BEYOND_MEASURE = "a number or a nesting without measure"
_WORDS = re.compile(rf"\S{{{_LONGEST_WORD + 1},}}")
_HIDDEN = ("Cc", "Cf", "Cs", "Zl", "Zp")


def whole_number(text: str) -> int | None:
    """The number, from 0, that up to nine digits 0 to 9 say; None of anything else, "²" and 5,000 digits too."""
    return int(text) if re.fullmatch("[0-9]{1,9}", text) else None


def check_regular(path: Path) -> None:
    """Raises InputError for what exists and is no file that ends: a device, a pipe or a socket; folders pass."""
    if path.exists() and not path.is_file() and not path.is_dir():
        raise InputError(f"{path}: expected a file, found a device or a pipe; copy what it gives into a file")


def text_of_document(path: Path) -> str:
    """The text of a document. Raises OSError, UnicodeDecodeError, and InputError for one that is too large."""
    if "\0" in str(path):
        raise InputError(f"{path}: expected the name of a file, found a null byte in it")
    check_regular(path)
    with path.open("rb") as file:
        content = file.read(min(path.stat().st_size, LARGEST_DOCUMENT) + 1)
    if len(content) > LARGEST_DOCUMENT:
        raise InputError(f"{path}: expected at most {LARGEST_DOCUMENT >> 20} MB, found more")
    return content.decode("utf-8-sig").replace("\r\n", "\n").replace("\r", "\n")


def toml_of(text: str, where: str, error: type[InputError] = InputError) -> dict[str, Any]:
    """The tables of a TOML text, `where` in messages. Raises an error of the class, one line."""
    if _LONG_KEY.search(text):
        raise error(f"{where}: expected keys of at most {_LONGEST_KEY} parts, found a longer one")
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as fault:
        raise error(f"{where}: expected TOML, found an error in its syntax: {fault}") from None
    except (ValueError, OverflowError, RecursionError):
        raise error(f"{where}: expected TOML, found {_BEYOND_MEASURE}") from None


def json_of(text: str) -> Any:
    """The content of a JSON text. Raises ValueError, one line, also for NaN and infinity."""
    try:
        return json.loads(text, parse_constant=_no_number)
    except RecursionError:
        raise ValueError(_BEYOND_MEASURE) from None
    except ValueError as fault:
        raise ValueError(_BEYOND_MEASURE if "digits" in str(fault) else str(fault)) from None


def _no_number(name: str) -> NoReturn:
    raise ValueError(f"{name} in place of a number")


def shown(value: object, width: int = 60) -> str:
    """A value of a document as a message shows it: on one line, shortened."""
    if isinstance(value, dict | list):
        return "a table" if isinstance(value, dict) else f"a list of {len(value)}"
    if isinstance(value, int) and abs(value) > 10**width:
        return "a number without measure"
    text = "null" if value is None else repr(value)
    return text if len(text) <= width else f"{text[: width - 1]}…"


def dotted(key: Iterable[int | str]) -> str:
    """A key of a document as log.accel.unit; entries of lists are counted from 1: programme.position[2]."""
    return "".join(f"[{part + 1}]" if isinstance(part, int) else f".{part}" for part in key).lstrip(".")


def is_plain(text: str) -> bool:
    """Whether all characters of a text are seen where they stand, and do nothing else."""
    return text.isprintable() or not any(unicodedata.category(character) in _HIDDEN for character in text)


def plain(text: str) -> str:
    """A text as a terminal may show it: characters that do something are replaced by question marks; new lines stay."""
    if text.isprintable():
        return text
    hidden = (character != "\n" and unicodedata.category(character) in _HIDDEN for character in text)
    return "".join("\N{REPLACEMENT CHARACTER}" if h else c for h, c in zip(hidden, text, strict=True))


def one_line(text: str) -> str:
    """A message on one line that can be read: plain, words without end and what follows a thousand characters left
    out."""
    line = plain(" ".join(text.split()))
    line = _WORDS.sub(lambda word: f"{word[0][:100]}…{word[0][-40:]}", line)
    return line if len(line) <= LONGEST_LINE else f"{line[: LONGEST_LINE - 1]}…"
