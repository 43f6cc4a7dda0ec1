"""TOML and JSON documents of users, results as JSON, and values of documents in messages.

Errors of a parser become one line, including those for numbers of thousands of digits and for deep nesting. Characters
that move the cursor of a terminal or change the direction of writing are not shown.
"""

from __future__ import annotations

import codecs
import math
import re
import unicodedata
from collections.abc import Callable, Iterable, Mapping
from dataclasses import is_dataclass
from datetime import date
from functools import cache
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Any, NoReturn, TypeVar, get_args, get_origin, get_type_hints

from tumble.errors import InputError, did_you_mean

if TYPE_CHECKING:
    from pydantic import BaseModel, ValidationError

# Parsers and pydantic are imported where they are used: the help of the command line does not need them.

AS_PRINTED: Mapping[type, Callable[[Any], Any]] = {float: lambda number: number if math.isfinite(number) else None}
"""Conversions for `--json`: a number that is not finite becomes null."""
LARGEST_DOCUMENT = 1 << 26  # bytes, 64 MB
LONGEST_LINE = 1000  # characters of a message
_LONGEST_WORD = 160  # characters
_LONGEST_KEY = 16  # parts of a TOML key a.b.c: time and memory of the parser grow with their square
_LONG_KEY = re.compile(rf"""(?<![\w"'-])(?:(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')[ \t]*+\.[ \t]*+){{{_LONGEST_KEY}}}""")
_BEYOND_MEASURE = "a number or a nesting without measure"
_WORDS = re.compile(rf"\S{{{_LONGEST_WORD + 1},}}")
_HIDDEN = ("Cc", "Cf", "Cs", "Zl", "Zp")
_WIDTH = 60  # characters of a value in a message
_FAULTS_SHOWN = 3
_LONGEST_PLACE = 80


def whole_number(text: str) -> int | None:
    """Return the number of up to nine digits 0 to 9; None for any other text."""
    return int(text) if re.fullmatch("[0-9]{1,9}", text) else None


def check_regular(path: Path) -> None:
    """Raise InputError for a device, a pipe or a socket."""
    if path.exists() and not path.is_file() and not path.is_dir():
        raise InputError(f"{path}: expected a file, found a device or a pipe; copy what it gives into a file")


def text_of_document(path: Path, error: type[InputError] = InputError) -> str:
    """Return the text of a document. Raises `error` if it cannot be read or is too large."""
    if "\0" in str(path):
        raise error(f"{path}: expected the name of a file, found a null byte in it")
    check_regular(path)
    try:
        with path.open("rb") as file:
            content = file.read(min(path.stat().st_size, LARGEST_DOCUMENT) + 1)
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as fault:
        is_binary = b"\0" in content and not content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
        found = "a binary file" if is_binary else f"{fault.reason}; save it as UTF-8"
        raise error(f"{path}: expected UTF-8 text, found {found}") from None
    except OSError as fault:
        raise error(f"{path}: cannot be read: {fault.strerror}") from None
    if len(content) > LARGEST_DOCUMENT:
        raise error(f"{path}: expected at most {LARGEST_DOCUMENT >> 20} MB, found more")
    return text.replace("\r\n", "\n").replace("\r", "\n")


def toml_of(text: str, where: str, error: type[InputError] = InputError) -> dict[str, Any]:
    """Return the tables of a TOML text, named `where` in messages. Raises `error`."""
    import tomllib

    if _LONG_KEY.search(text):
        raise error(f"{where}: expected keys of at most {_LONGEST_KEY} parts, found a longer one")
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as fault:
        raise error(f"{where}: expected TOML, found an error in its syntax: {fault}") from None
    except (ValueError, OverflowError, RecursionError):
        raise error(f"{where}: expected TOML, found {_BEYOND_MEASURE}") from None


def json_of(text: str) -> Any:
    """Return the content of a JSON text. Raises ValueError, one line, also for NaN and infinity."""
    import json

    try:
        return json.loads(text, parse_constant=_no_number)
    except RecursionError:
        raise ValueError(_BEYOND_MEASURE) from None
    except ValueError as fault:
        if not text.lstrip().startswith(("{", "[")):
            raise ValueError("text that is no JSON; is it the log?") from None
        found = f"an error in its syntax: {fault}" if isinstance(fault, json.JSONDecodeError) else str(fault)
        raise ValueError(_BEYOND_MEASURE if "digits" in str(fault) else found) from None


def as_json(part: Any, by_type: Mapping[type, Callable[[Any], Any]] = AS_PRINTED) -> Any:
    """Convert a result to the types of JSON.

    A dataclass becomes an object of its fields, or of the attributes and properties that its class attribute
    `json_fields` names. A dataclass with a length holds columns of this length and becomes a list of rows. Arrays and
    tuples become lists, dates and times ISO 8601 strings, and paths strings. `by_type` has functions for objects of
    exactly these types, which replace these rules."""
    if type(part) in by_type:
        return by_type[type(part)](part)
    if hasattr(part, "tolist"):  # NumPy
        return as_json(part.tolist(), by_type)
    if isinstance(part, date | PurePath):
        return part.isoformat() if isinstance(part, date) else str(part)
    if isinstance(part, list | tuple):
        return [as_json(each, by_type) for each in part]
    if isinstance(part, Mapping):
        return {key: as_json(each, by_type) for key, each in part.items()}
    names = getattr(part, "json_fields", None) or getattr(part, "__dataclass_fields__", None)
    if names is None:
        return part
    content = {name: as_json(getattr(part, name), by_type) for name in names}
    if not hasattr(part, "__len__"):
        return content
    count = len(part)
    columns = ([None] * count if column is None else column for column in content.values())
    return [dict(zip(names, row, strict=True)) for row in zip(*columns, strict=True)]


def _no_number(name: str) -> NoReturn:
    raise ValueError(f"{name} in place of a number")


def shown(value: object, width: int = _WIDTH) -> str:
    """Return a value of a document for a message, on one line and shortened."""
    if isinstance(value, dict | list):
        return "a table" if isinstance(value, dict) else f"a list of {len(value)}"
    if isinstance(value, int) and abs(value) > 10**width:
        return "a number without measure"
    text = "null" if value is None else repr(value)
    return text if len(text) <= width else f"{text[: width - 1]}…"


def dotted(key: Iterable[int | str]) -> str:
    """Return a key of a document as log.accel.unit; entries of lists are counted from 1: programme.position[2]."""
    return "".join(f"[{part + 1}]" if isinstance(part, int) else f".{part}" for part in key).lstrip(".")


def is_plain(text: str) -> bool:
    """Return True if a text has no control or formatting characters."""
    return text.isprintable() or not any(unicodedata.category(character) in _HIDDEN for character in text)


def plain(text: str) -> str:
    """Return a text with control and formatting characters, except new lines, replaced by � (U+FFFD)."""
    if text.isprintable():
        return text
    hidden = (character != "\n" and unicodedata.category(character) in _HIDDEN for character in text)
    return "".join("\N{REPLACEMENT CHARACTER}" if h else c for h, c in zip(hidden, text, strict=True))


def one_line(text: str) -> str:
    """Return a message on one line, plain and shortened to LONGEST_LINE characters."""
    line = plain(" ".join(text.split()))
    line = _WORDS.sub(lambda word: f"{word[0][:100]}…{word[0][-40:]}", line)
    return line if len(line) <= LONGEST_LINE else f"{line[: LONGEST_LINE - 1]}…"


# -------------------- documents that a model of pydantic describes --------------------

_Model = TypeVar("_Model", bound="BaseModel")


@cache
def _expected() -> Mapping[str, str]:
    """Return descriptions of the expected value, by type of fault, for keys without a description."""
    return toml_of(Path(__file__).with_name("expected.toml").read_text(encoding="utf-8"), "expected.toml")


def validated(
    model: type[_Model], content: Mapping[str, Any], where: str = "", error: type[InputError] = InputError
) -> _Model:
    """Validate a document by a model.

    Raises `error`, one line with up to three faults "key: expected …, found …" after `where`."""
    from pydantic import ValidationError

    try:
        return model.model_validate(content)
    except ValidationError as fault:
        faults = faults_of(fault, content, model)
    more = [f"and {len(faults) - _FAULTS_SHOWN} more"] if len(faults) > _FAULTS_SHOWN else []
    message = "; ".join(faults[:_FAULTS_SHOWN] + more)
    raise error(f"{where}: {message}" if where else message)


def faults_of(error: ValidationError, content: Any, model: type[Any]) -> list[str]:
    """Return the faults of a document, each once.

    The expected value of a key is the description of its field; a list with a description is named instead of its
    elements."""
    faults: dict[tuple[int | str, ...], str] = {}
    for fault in error.errors(include_url=False):
        kind, value, expected = fault["type"], content, ""
        key: tuple[int | str, ...] = ()
        table: type[Any] = model  # innermost table on the way to the key
        inner: type[Any] | None = model  # table in the value of the last key, if any
        for part in fault["loc"]:
            if isinstance(part, int):
                if (inner is None and expected) or not isinstance(value, list | tuple) or part >= len(value):
                    kind = "too_short" if kind == "missing" else kind
                    break
                key, value = (*key, part), value[part]
                continue
            is_there = isinstance(value, Mapping) and part in value
            if inner is not None and part in (described := keys_of(inner)):
                table, (annotation, expected) = inner, described[part]
                inner = table_behind(annotation)
            elif inner is not None or not (is_there or kind == "missing"):  # an unknown key, or the choice of a union
                value = key[-1] if part == "[key]" else value
                break
            key, value = (*key, part), value[part] if is_there else None
        place = dotted(key)[:_LONGEST_PLACE]
        if kind == "extra_forbidden":
            unknown = str(fault["loc"][-1])
            where = f"in [{place}]" if key else "at the top level"
            hint = did_you_mean(unknown, keys_of(inner or table))
            faults[(*key, unknown)] = f"unknown key '{unknown}' {where}{hint}"
        elif kind == "value_error":
            message = str(fault["ctx"]["error"])  # for a table it may begin with one of its keys
            separator = "" if not key else ": " if inner is None or message.startswith("expected") else "."
            faults[key] = f"{place}{separator}{message}"
        else:
            expected = expected or _expected().get(kind) or fault.get("ctx", {}).get("expected") or fault["msg"]
            found = "none" if kind == "missing" else as_written(value)
            faults.setdefault(key, f"{place}: expected {expected}, found {found}")
    return list(faults.values())


def keys_of(table: type[Any]) -> dict[str, tuple[Any, str]]:
    """Return the keys of a model or dataclass, with their types and descriptions."""
    if is_dataclass(table):
        keys = {}
        for name, hint in get_type_hints(table, include_extras=True).items():
            aliases = (part.alias for part in get_args(hint) if getattr(part, "alias", None))
            keys[next(aliases, name)] = (hint, "")
        return keys
    return {name: (field.annotation, field.description or "") for name, field in table.model_fields.items()}


def table_behind(annotation: Any) -> type[Any] | None:
    """Return the model or dataclass of the values of a key, or of their elements; None if there is none."""
    from pydantic import BaseModel

    annotation = getattr(annotation, "table", annotation)
    if isinstance(annotation, type) and (issubclass(annotation, BaseModel) or is_dataclass(annotation)):
        return annotation
    annotated = [part for part in get_args(annotation) if hasattr(part, "table")]
    parts = annotated or (() if get_origin(annotation) is Mapping else get_args(annotation))
    return next((table for part in parts if (table := table_behind(part)) is not None), None)


def as_written(value: Any) -> str:
    """Return a value as written in TOML, on one line and shortened."""
    import json

    if isinstance(value, Mapping):
        return "a table"
    if isinstance(value, int) and abs(value) > 10**_WIDTH:
        return shown(value)
    text = json.dumps(value, default=str, ensure_ascii=False)
    return text if len(text) <= _WIDTH else f"{text[: _WIDTH - 1]}…"
