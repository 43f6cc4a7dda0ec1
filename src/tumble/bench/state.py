"""Types of the state that the server sends to the page and `page/bench.js` shows.

Numbers are in the unit that is shown, times in s.
"""

from __future__ import annotations

from typing import Any, Literal, TypedDict


class Received(TypedDict):
    """Lines that were `refused` and `why` the last one was; whether the source has `ended`, and whether it is `silent`
    although it has not; its troubles, in words."""

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
    """A group of parameters: the largest uncertainty and the wanted one, and whether the data determine all of it."""

    group: str
    unit: str
    u: float
    wanted: float
    determined: bool
    enough: bool


class EstimateShown(TypedDict):
    """The estimate from the rests so far: groups of parameters, residuals of the rests (σ, µg), the part of the
    uncertainty that a rest in each of 26 directions would leave (`gains`) and the best direction in words (`next`), the
    likely `cause` of a misfit, the number of unknowns, and the processor time, s."""

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
    """A button: its command, its label, what it leads to, and whether it is the usual answer."""

    do: str
    label: str
    says: str
    primary: bool


class PositionShown(TypedDict):
    """A position of the programme: where the body axes point, the move into it, its picture, and the unit as it is now
    (`ghost`), in lines over that picture."""

    number: int
    label: str
    points: dict[str, str]
    move: str
    angle: str | None
    picture: str
    ghost: dict[str, Any] | None


class RestShown(TypedDict, total=False):
    """The number of a rest, and of how many. Of a rest that lasts: its duration, the time left, uncertainty of its mean
    and the wanted one (µg, °/h), its drift (µg)."""

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
    """One of the screens. `fault` has the fields of a `follow.faults.Fault`. The keys from `seconds` to `to_go` are on
    every screen as soon as there are blocks."""

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
    """All that the page shows of a bench; the `result` as `results.shown` makes it."""

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
    """Means of the blocks before number `next`: times, s, specific force, m/s², and rate, °/s. `anew`: the page forgets
    the earlier ones."""

    next: int
    anew: bool
    t: list[float]
    a: list[list[float]]
    g: list[list[float]]
