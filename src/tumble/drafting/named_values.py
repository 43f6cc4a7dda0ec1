"""Lines that name their values: `ax=0.01 ay=-0.02`, `acc: 0.1, 0.2, 9.8; gyro: …`, `Acc (mg) [ 12.2, …`, `Rotation X:
0.01, Y: -0.02, Z: 0.00 rad/s`, `GYRO: X=0.01, Y=-0.02, Z=0.00, ACCEL: X=…`; and samples of several such lines, as
`rostopic echo` prints messages: a name stands for what is above it too, `angular_velocity:` and then `x: 0.1` further
in, and a sample ends where a name comes again. And lines that are objects of JSON, `{"ts": 0.01, "acc": [0.1, 0.2,
9.8], "gyro": {"x": 0, …}}`: a list of three numbers is three columns, an object within an object has its name before
its own."""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from typing import Any

from tumble.drafting.spelling import LONGEST_LINE, Row, Spelling, spelt_alike
from tumble.recording.text.dialect import Dialect, is_clock

# A word is looked at from its first letter, and once: a line of nothing but letters takes no longer than another one.
_KEY = re.compile(
    r"(?<![^\W\d])([^\W\d][\w.]*+)\s*(?:\(\s*([^()\d]+?)\s*\)\s*)?(?:[=:]\s*(?=[-+\d.\[(])|(?=\[\s*[-+]?\d+\.))"
)
_GROUP = re.compile(r"(?<![^\W\d])([^\W\d]\w*+)\s*(?:\([^()]*\))?\s*:\s*(?=[^\W\d]\w*\s*=)")
_NUMBER = re.compile(r"(?<![\w^/.])[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
_WHEN = re.compile(r"[\s\[\]()>,;|:-]*$")
_WORD = re.compile(r"([^\W\d]\w*)\s+$")
_WORDS = re.compile(r"(?<!\w)([^\W\d]\w*(?:[ \t]+[^\W\d]\w*)*)\s+$")
_UNITS = r"(?:m/s\^?2|rad/s|deg/s|m?dps|m?g)"
_UNIT = re.compile(rf"(?<![^\W\d])\s*({_UNITS})\s*$")
_BEHIND = re.compile(rf"^[-+.,\deE\s]*(?:{_UNITS}(?!\w))?")
"""A number and its unit."""
_ABOVE = re.compile(r"([ \t]*)([^\W\d][\w.]*)\s*:\s*")
_LEAST_NAMES = 6
_SHARE = 0.8
_TIME = "time"
_QUANTITIES = ("velocity", "acceleration", "rate", "field")


def named_values(lines: Sequence[str]) -> Spelling | None:
    """Spelling of lines most of which have the same names and numbers."""

    def row(line: str) -> Row | None:
        named = cells(line)
        return (tuple(named), list(named.values())) if named else None

    return spelt_alike(lines, row, "names before the numbers")


def cells(line: str) -> dict[str, str]:
    """Names and numbers of a line. A time before the first name is one, and a name before three numbers is three.

    An axis has the name of the sensor before several, `GYRO: X=0.1, Y=…`, else the words before it, `Linear Accel X =
    0.1, Y = …`, which also hold for the axes behind it."""
    keys, groups = (list(pattern.finditer(line[:LONGEST_LINE])) for pattern in (_KEY, _GROUP))
    if not keys:
        return {}
    first = min(name.start() for name in (keys[0], *groups[:1]))
    when = _WHEN.sub("", _WORDS.sub("", line[:first])).strip(" []")
    values = {_TIME: when} if is_clock(when) or _NUMBER.fullmatch(when) else {}
    words, end = "", 0
    for key, after in zip(keys, [*keys[1:], None], strict=True):
        of = [group[1] for group in groups if group.end() <= key.start() and key[0].rstrip().endswith("=")]
        before = _WORDS.search(_BEHIND.sub("", line[end : key.start()]))
        words, end = before[1] if before else words, key.end()
        name = "_".join([*of[-1:], key[1]]) if of or len(key[1]) > 1 else f"{words} {key[1]}".strip()
        numbers = _NUMBER.findall(line[end : after.start() if after else None])
        unit = f" [{key[2]}]" if key[2] else ""
        if len(numbers) == 1:
            values[name + unit] = numbers[0]
        elif len(numbers) == 3:
            word = _WORD.search(line[: key.start()]) if name.lower() in _QUANTITIES else None  # `Angular Velocity: (…)`
            name = f"{word[1]} {name}" if word else name
            values |= {f"{name}_{axis}{unit}": number for axis, number in zip("xyz", numbers, strict=True)}
    return values


def several_lines(lines: Sequence[str]) -> Spelling | None:
    """Spelling of samples that are several lines each; None otherwise."""
    sample_before = _samples()
    samples = [done for line in lines if (done := sample_before(line)) is not None]
    kinds = Counter(tuple(values) for values, count in samples[1:] if count > 1)
    names, count = kinds.most_common(1)[0] if kinds else ((), 0)
    if len(names) < _LEAST_NAMES or count <= max(_SHARE * (len(samples) - 1), 1):
        return None
    reading = _samples()

    def values(line: str) -> Sequence[str] | None:
        done = reading(line)
        return [done[0].get(name, "") for name in names] if done is not None else None

    return Spelling(names=names, values=values, title=f"several lines a sample ({', '.join(names)})")


def _samples() -> Callable[[str], tuple[dict[str, str], int] | None]:
    """A function that is fed line by line, and returns the sample before with its number of lines where a line begins
    the next."""
    sample: dict[str, str] = {}
    above: list[tuple[int, str]] = []
    count = 0

    def fed(line: str) -> tuple[dict[str, str], int] | None:
        nonlocal sample, count
        inside = len(line) - len(line.lstrip())
        above[:] = [(at, name) for at, name in above if at < inside]
        title = _ABOVE.fullmatch(line.rstrip())
        if title is not None:
            above.append((inside, title[2]))
            return None
        unit = _UNIT.search(line[:LONGEST_LINE])  # behind the last number, and so of all of them
        before, behind = "".join(f"{name}_" for _, name in above), f" [{unit[1]}]" if unit else ""
        values = {f"{before}{name}{behind}": number for name, number in cells(line).items()}
        done = (sample, count) if values.keys() & sample.keys() else None
        if done is not None:
            sample, count = {}, 0
        sample = sample | values
        count += bool(values)
        return done

    return fed


def json_lines(lines: Sequence[str]) -> Spelling | None:
    """Spelling of lines most of which are objects of JSON, or as Python prints them."""

    def row(line: str) -> Row | None:
        text = line.strip().removeprefix("[").removesuffix("]").strip().removesuffix(",")
        for spelt in (text, text.replace("'", '"')) if text.startswith("{") and len(text) < LONGEST_LINE else ():
            with suppress(ValueError, RecursionError):
                read = dict(_values(json.loads(spelt)))
                return tuple(read), list(read.values())
        return None

    return spelt_alike(lines, row, "objects of JSON")


def _values(read: Mapping[str, Any], before: str = "") -> Iterator[tuple[str, str]]:
    """Names and values of an object and its parts: numbers, also as text, and times of day."""
    for key, value in read.items():
        name = before + re.sub('[,"\\s]+', " ", key)
        if isinstance(value, dict):
            yield from _values(value, f"{name}_")
        elif isinstance(value, list) and len(value) == 3:
            yield from _values(dict(zip("xyz", value, strict=True)), f"{name}_")
        elif isinstance(value, int | float) and not isinstance(value, bool):
            yield name, repr(value)
        elif isinstance(value, str) and (is_clock(value) or Dialect().is_number(value)):
            yield name, value
