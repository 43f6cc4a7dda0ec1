"""Lines that name their values: `ax=0.01 ay=-0.02`, `acc: 0.1, 0.2, 9.8; gyro: …`, `Acc (mg) [ 12.2, …`, `Rotation X:
0.01, Y: -0.02, Z: 0.00 rad/s`, `GYRO: X=0.01, Y=-0.02, Z=0.00, ACCEL: X=…`."""

from __future__ import annotations

import re
from collections.abc import Sequence

from tumble.recording.dialect import is_clock

LONGEST_LINE = 4096
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
_TIME = "time"
_QUANTITIES = ("velocity", "acceleration", "rate", "field")


def cells(line: str) -> dict[str, str]:
    """Names and numbers of a line; a time before the first name is one too, and a name before three numbers three."""
    keys, groups = (list(pattern.finditer(line[:LONGEST_LINE])) for pattern in (_KEY, _GROUP))
    if not keys:
        return {}
    first = min(found.start() for found in (keys[0], *groups[:1]))
    when = _WHEN.sub("", _WORDS.sub("", line[:first])).strip(" []")
    found = {_TIME: when} if is_clock(when) or _NUMBER.fullmatch(when) else {}
    for key, name, after in zip(keys, _names(line, keys, groups), [*keys[1:], None], strict=True):
        numbers = _NUMBER.findall(line[key.end() : after.start() if after else None])
        unit = f" [{key[2]}]" if key[2] else ""
        if len(numbers) == 1:
            found[name + unit] = numbers[0]
        elif len(numbers) == 3:
            name = _qualified(line[: key.start()], name)
            found |= {f"{name}_{axis}{unit}": number for axis, number in zip("xyz", numbers, strict=True)}
    return found


def _qualified(before: str, name: str) -> str:
    """A name of a quantity with the word before it, as in `Angular Velocity: (…)`."""
    word = _WORD.search(before) if name.lower() in _QUANTITIES else None
    return f"{word[1]} {name}" if word else name


def _names(line: str, keys: Sequence[re.Match[str]], groups: Sequence[re.Match[str]]) -> list[str]:
    """The names in a line: an axis with the sensor that stands before several, `GYRO: X=0.1, Y=…`, else with the words
    before it, `Linear Accel X = 0.1, Y = …`, which are those of the axes behind it too."""
    names, words, end = [], "", 0
    for key in keys:
        of = [group[1] for group in groups if group.end() <= key.start() and key[0].rstrip().endswith("=")]
        before = _WORDS.search(_BEHIND.sub("", line[end : key.start()]))
        words = before[1] if before else words
        end = key.end()
        names.append("_".join([*of[-1:], key[1]]) if of or len(key[1]) > 1 else f"{words} {key[1]}".strip())
    return names


def named_numbers(line: str) -> dict[str, str]:
    """The same, each name with the unit behind the last number, as in `Rotation X: 0.01, Y: -0.02, Z: 0.00 rad/s`."""
    unit = _UNIT.search(line[:LONGEST_LINE])
    behind = f" [{unit[1]}]" if unit else ""
    return {f"{name}{behind}": number for name, number in cells(line).items()}
