"""What the page of a bench shows: the state that the server sends and `page/bench.js` reads, key by key.

Numbers are in the unit that is shown; times in s. A screen has the keys of `Screen` that it needs.
"""

from __future__ import annotations

from typing import Any, Literal, TypedDict


class Received(TypedDict):
    """What was wrong with what has come: rows `refused`, the last one for this reason `why`; whether the source has
    `ended`; what is wrong with it, in words."""

    refused: int
    why: str
    ended: bool
    trouble: list[str]


class Recorded(Received):
    """The log: its source, samples that were read and are missing, and a second of how many."""

    source: str
    samples: int
    rate: float | None
    lost: int


class GroupShown(TypedDict):
    """A group of parameters: the largest u and the wanted one in a unit; whether the data tell all of them."""

    group: str
    unit: str
    u: float
    wanted: float
    determined: bool
    enough: bool


class EstimateShown(TypedDict):
    """The estimate from so many rests: groups, residuals (σ, µg), what a rest in each of 26 directions would leave of u
    (`gains`), the best of them in words (`next`), what may be the `cause` of a misfit; unknowns, s of computing."""

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
    """A button: its command, its label, what comes of it, and whether it is the usual one."""

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
    """Which rest of how many; of one that lasts: for how long, how much longer, u of its mean (µg, °/h) and what is
    wanted, its drift (µg)."""

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
    """What to do now; the `fault` has the fields of a `follow.faults.Fault`. On every screen but the first `waiting`:
    `seconds` … `to_go`."""

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
    """Means of blocks before number `next`: times, s, specific force, m/s², rate, °/s; `anew`: nothing goes before."""

    next: int
    anew: bool
    t: list[float]
    a: list[list[float]]
    g: list[list[float]]
