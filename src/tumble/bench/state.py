"""Types of the state that the server sends to the page, shown by `page/bench.js`.

Numbers are in display units, times in s.
"""

from __future__ import annotations

from typing import Any, Literal, TypedDict


class Received(TypedDict):
    """Input: the number of `refused` lines, the reason for the last one (`why`), whether the source has `ended` or is
    `silent`, and its troubles."""

    refused: int
    why: str
    ended: bool
    silent: bool
    trouble: list[str]


class Recorded(Received):
    """The log: its source, the number of samples, their rate (Hz), and how many are missing."""

    source: str
    samples: int
    rate: float | None
    lost: int


class GroupShown(TypedDict):
    """A group of parameters: its largest u, the wanted u, and whether the data determine all its parameters."""

    group: str
    unit: str
    u: float
    wanted: float
    determined: bool
    enough: bool


class EstimateShown(TypedDict):
    """The estimate from the rests so far.

    It has groups of parameters, residuals of the rests (σ, µg), the fraction of u that a further rest in each of 26
    directions would leave (`gains`), the best direction (`next`), the likely `cause` of a misfit or of a wanted u that
    no rest will reach, the number of unknowns, and the processor time, s."""

    rests: int
    groups: list[GroupShown]
    enough: bool
    residuals: list[dict[str, float]]
    gains: list[float] | None
    next: str
    cause: str
    unknowns: int
    seconds: float


class Answer(TypedDict):
    """A button: command, label, effect, and whether it is the usual answer."""

    do: str
    label: str
    says: str
    primary: bool


class PositionShown(TypedDict):
    """A position of the programme: directions of the body axes, the move into it, its picture, and the present attitude
    as lines over the picture (`ghost`)."""

    number: int
    label: str
    points: dict[str, str]
    move: str
    angle: str | None
    picture: str
    ghost: dict[str, Any] | None


class RestShown(TypedDict, total=False):
    """A rest with its number out of `of`; while it lasts also its duration, the remaining time, u of its mean and the
    wanted u (µg, °/h), and its drift (µg)."""

    number: int
    of: int | None
    seconds: float
    left: float | None
    u: float | None
    wanted: float
    gyro_u: float | None
    gyro_wanted: float
    drift: float
    settling: bool
    nothing_more: bool


class TurnShown(TypedDict):
    """A turn under way, °, and its rate, °/s."""

    done: float | None
    angle: float | None
    rate: float | None
    full_scale: float | None


class Screen(TypedDict, total=False):
    """A screen. `fault` has the fields of `follow.faults.Fault`; the keys from `seconds` to `to_go` are present as soon
    as there are blocks."""

    screen: Literal["waiting", "rest", "turn", "done", "fault"]
    headline: str
    fault: dict[str, Any] | None
    rest: RestShown
    position: PositionShown | None
    turn: TurnShown
    early: str
    complete: bool
    missed: list[str] | None
    seconds: float
    scatter: dict[str, float]
    sphere: dict[str, Any]
    temperature: float | None
    to_go: float | None


class State(Screen, total=False):
    """The whole state of the page; `result` is from `results.page_content`."""

    unit: dict[str, str | None]
    session: str
    listening: bool
    can_record: bool
    received: Recorded
    programme: str | None
    positions: int | None
    wanted: dict[str, float]
    estimate: EstimateShown | None
    estimating: bool
    result: dict[str, Any] | None
    calibrating: bool
    message: str
    excluded: int
    answers: list[Answer]


class Trace(TypedDict):
    """Means of the blocks before number `next`: times, s, specific force, m/s², rate, °/s. With `anew` the page drops
    earlier blocks."""

    next: int
    anew: bool
    t: list[float]
    a: list[list[float]]
    g: list[list[float]]
