"""Text logs that are no table, as one: `ax=0.01 ay=-0.02 …`, `acc: 0.1, 0.2, 9.8; gyro: …`, sentences `$VNYMR,…`, and
lines that end in a carriage return alone.

What is written is a CSV file in the session's folder, a row for each line, with the names before the signs. A name with
three numbers behind it is three columns. A line with other names is left as it is, for the reader to report.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from tumble.calibration.sentences import FIELDS, sentence_of, values_of
from tumble.files import whole_file
from tumble.recording.dialect import encoding_of, is_clock
from tumble.recording.readers import opened, readable

_SEEN_LINES = 200
_SHARE = 0.8
_LEAST_NUMBERS = 3
_LONGEST_LINE = 4096
_KEY = re.compile(r"([^\W\d][\w.]*)\s*[=:]\s*(?=[-+\d.\[(])")
_NUMBER = re.compile(r"(?<![\w^/.])[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
_TIME = "time"
_WHEN = re.compile(r"[\s\[\]()>,;|-]*$")


def respelled(file: Path, seen: bytes, folder: Path) -> tuple[Path, str] | None:
    """The copy of a text log in a folder, made if need be, and what there is to say of it; None for one that can be
    read as it is. `seen`: the first bytes of the file."""
    encoding = encoding_of(seen)
    text = seen.decode(encoding, errors="replace")
    old = text.count("\r") > 2 and "\n" not in text
    lines = re.split("[\r\n]+", text)[:-1][:_SEEN_LINES]
    kind = sentence_of(lines)
    names = _names_of(lines) if kind is None else FIELDS[kind]
    if names is None and not old:
        return None
    target = folder / f"{file.name.partition('.')[0]}.csv"
    if target.exists():
        target = target.with_stem(f"{target.stem}-copy")
    folder.mkdir(parents=True, exist_ok=True)
    with readable(file), opened(file, encoding) as stream, whole_file(target) as temporary, temporary.open("wb") as out:
        if names is not None:
            out.write(f"{','.join(names)}\n".encode())
        for line in _lines(iter(lambda: stream.read(1 << 16), b"")):
            row = _row(line, names) if kind is None else ",".join(values_of(line, kind)) or line.replace(",", " ")
            out.write(row.encode() + b"\n")
    return target, f"text: {_what(kind, names)}: copied to {target.name} as a table"


def _what(kind: str | None, names: tuple[str, ...] | None) -> str:
    if kind is not None:
        return f"sentences ${kind}"
    return "lines that end in a carriage return" if names is None else f"names before the numbers ({', '.join(names)})"


def _lines(pieces: Iterator[bytes]) -> Iterator[str]:
    rest = b""
    for piece in pieces:
        *whole, rest = (rest + piece).replace(b"\r\n", b"\n").replace(b"\r", b"\n").split(b"\n")
        yield from (line.decode(errors="replace") for line in whole)
        rest = rest[:_LONGEST_LINE]
    if rest.strip():
        yield rest.decode(errors="replace")


def _names_of(lines: list[str]) -> tuple[str, ...] | None:
    """The names that most lines have before their numbers."""
    found = Counter(tuple(cells) for line in lines if len(cells := _cells(line)) >= _LEAST_NUMBERS)
    if not found:
        return None
    names, count = found.most_common(1)[0]
    return names if count > _SHARE * sum(bool(line.strip()) for line in lines) and count > 1 else None


def _cells(line: str) -> dict[str, str]:
    """Names and numbers of a line; a time before the first name is one too."""
    keys = list(_KEY.finditer(line[:_LONGEST_LINE]))
    if not keys:
        return {}
    when = _WHEN.sub("", line[: keys[0].start()]).strip(" []")
    cells = {_TIME: when} if is_clock(when) or _NUMBER.fullmatch(when) else {}
    for key, after in zip(keys, [*keys[1:], None], strict=True):
        numbers = _NUMBER.findall(line[key.end() : after.start() if after else None])
        if len(numbers) == 1:
            cells[key[1]] = numbers[0]
        elif len(numbers) == 3:
            cells |= {f"{key[1]}_{axis}": number for axis, number in zip("xyz", numbers, strict=True)}
    return cells


def _row(line: str, names: tuple[str, ...] | None) -> str:
    if names is None:
        return line
    cells = _cells(line)
    return ",".join(cells[name] for name in names) if tuple(cells) == names else line.replace(",", " ")
