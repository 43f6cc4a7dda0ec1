"""The words for columns in the languages of laboratories, and how instruments abbreviate them, in the words of
`columns`."""

from __future__ import annotations

import re

_WORDS: tuple[tuple[str, str], ...] = (
    # units first: they stand in brackets or behind a comma
    (r"м\s*/\s*с\s*(\^?2|²|\*\*2)|м\s*/\s*с\s*/\s*с|米/秒\^?[2²]", "m/s^2"),
    (r"(град|°|гр)\.?\s*/\s*(с(ек)?\b|s)|度/秒", "deg/s"),
    (r"рад\s*/\s*с(ек)?", "rad/s"),
    (r"grad\s*/\s*s", "deg/s"),
    (r"\bмкс\b|微秒", "us"),
    (r"\bмс\b|毫秒", "ms"),
    (r"(?<=[\[(,])\s*с(ек)?\.?\s*(?=[\])]|$)|(?<=[\[(])秒(?=[\])])", "s"),
    # what is measured
    (r"угл\w*\.?[\s_]*скор\w*|кутов\w*[\s_]*швидк\w*|гироскоп\w*|гіроскоп\w*|\bдус\b", " gyro "),
    (r"角速度|陀螺仪?|角速率", " gyro "),
    (r"winkelgeschw\w*|winkelrate|drehrate\w*|drehgeschw\w*|gyroskop\w*|kreisel\w*", " gyro "),
    (r"vitesse[\s_]*angulaire|velocidad[\s_]*angular|rate[\s_]*of[\s_]*turn|rotation[\s_]*rate", " gyro "),
    (r"(?<![^\W_])giro(sc[oó]pio?s?|scop[ei])?(?![^\W_\d]{2})", " gyro "),
    (r"ускор\w*|акселер\w*|прискор\w*|кажущ\w*", " acc "),
    (r"加速度计?|比力", " acc "),
    (r"beschl(eunigung\w*)?", " acc "),
    (r"acc?el[eé]rom[eè]t(ro|re)s?|accelerazion[ei]|acc[eé]l[eé]ration", " acc "),
    (r"(?<![^\W_])acel(eraci[oó]n|era[cç][aã]o|er[oô]metros?)?(?![^\W_\d]{2})", " acc "),
    (r"магнит\w*|магніт\w*|磁场|磁力|地磁|magnetfeld\w*", " mag "),
    (r"температур\w*|温度|temperatur(?!e)", " temperature "),
    (r"\bврем\w*|\bчас\b|时间戳?|\bzeit(stempel)?\b|\btemps\b|\btiempo\b|系统时间", " time "),
    (r"\bпо\b|\bоси\b|\bосі\b|\bвісь\b|\bось\b|\bachse\b|轴", " "),
    (r"(?<![а-яіїєё])[хХ](?![а-яіїєё])", "x"),
    (r"(?<![а-яіїєё])[уУ](?![а-яіїєё])", "y"),
)  # fmt: skip
_PATTERNS = tuple((re.compile(pattern, re.IGNORECASE), word) for pattern, word in _WORDS)


def in_english(name: str) -> str:
    """A column's name with the words of other languages replaced."""
    for pattern, word in _PATTERNS:
        name = pattern.sub(word, name)
    return name
