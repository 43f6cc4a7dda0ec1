"""Several sessions as one: their rests and turns one after the other, and a long rest in parts while it warms.

A rest is its mean reading at its mean temperature. One during which the temperature changes says how the sensors change
with it once it is taken in parts. Nothing is turned between these, so that they are joined by turns of no duration,
which leave the attitude as it is to HELD.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace
from itertools import pairwise
from typing import Any

import numpy as np

from tumble.reduction.blocks import Reduction
from tumble.reduction.matching import Match
from tumble.reduction.observations import Observations, Together
from tumble.reduction.rests import Rests
from tumble.reduction.rounding import Rounding
from tumble.reduction.segmentation import RestSpan
from tumble.reduction.thermometer import Thermometers
from tumble.reduction.turn_samples import TurnSamples
from tumble.reduction.turns import TurnReadings, Turns
from tumble.units import Array, IntArray

WARMED = 1.0
"""K: a rest whose temperature changes by more is taken in parts."""
SHORTEST_PART = 20.0
"""s: a shorter part has too few blocks for the noise of its mean."""
MOST_PARTS = 60
HELD = 1e-6
"""rad an axis: what a support moves by from one part of a rest to the next."""


def in_parts(reduction: Reduction, match: Match) -> tuple[Match, IntArray]:
    """The rests of a match, those that warm in parts, and the number of the rest that each of these is of."""
    by_file = reduction.by_file
    spans: list[RestSpan] = []
    number: list[int] = []
    for i, span in enumerate(match.rests):
        file = by_file[span.file]
        warmth = None if file.temperature is None else file.temperature[span.first : span.last]
        for first, last in _cuts(span, warmth):
            edges = span.start if first == span.first else file.edges[first], file.edges[last]
            stop = span.stop if last == span.last else float(edges[1])
            spans.append(replace(span, first=first, last=last, start=float(edges[0]), stop=stop))
            number.append(i)
    position = None if match.position is None else match.position[number]
    return replace(match, rests=tuple(spans), position=position), np.array(number, dtype=np.int64)


def _cuts(span: RestSpan, warmth: Array | None) -> list[tuple[int, int]]:
    """The blocks of the parts of a rest with temperatures (K, T) of its blocks."""
    if warmth is None:
        return [(span.first, span.last)]
    tenth = max(len(warmth) // 10, 1)
    change = float(np.abs(warmth[-tenth:].mean(axis=0) - warmth[:tenth].mean(axis=0)).max())
    parts = [part.mean(axis=0) for part in np.array_split(warmth, min(10, len(warmth)))]
    change = max(change, float(np.ptp(parts, axis=0).max()))
    most = min(MOST_PARTS, int((span.stop - span.start) / SHORTEST_PART))
    count = min(int(np.ceil(change / WARMED)), most)
    if count < 2:
        return [(span.first, span.last)]
    edges = np.linspace(span.first, span.last, count + 1).round().astype(int).tolist()
    return list(pairwise(edges))


def joined(sessions: Sequence[Observations], names: Sequence[str], numbers: Sequence[IntArray]) -> Observations:
    """The observations of several sessions of one device at one place as one; `numbers` are those of their rests."""
    first = sessions[0]
    counts = [len(each.rests) for each in sessions]
    rests_before = np.concatenate([[0], np.cumsum(counts)])[:-1]
    turns = _turns(sessions, rests_before)
    return replace(
        first,
        rests=_rests(sessions),
        turns=turns,
        turn_samples=_samples(sessions),
        turn_readings=_readings(sessions),
        arrays=tuple(moments for each in sessions for moments in each.arrays),
        programme=None,
        position=None,
        rounding=_rounding(sessions),
        thermometers=_thermometers(sessions),
        notes=tuple(f"{name}: {note}" for name, each in zip(names, sessions, strict=True) for note in each.notes),
        together=Together(
            names=tuple(names),
            session=np.repeat(np.arange(len(sessions)), counts),
            number=np.concatenate(numbers),
        ),
    )


def apart(observations: Observations, rests: slice, turns: slice) -> Observations:
    """Those of one of several sessions that were joined, its rests and turns being these."""
    whole = {field.name: getattr(observations.rests, field.name) for field in fields(Rests)}
    own: dict[str, Any] = {name: None if value is None else value[rests] for name, value in whole.items()}
    together, every, readings = observations.together, observations.turns, observations.turn_readings
    assert together is not None
    some = None
    if every is not None and turns.stop > turns.start:
        some = Turns(**{field.name: getattr(every, field.name)[turns] for field in fields(Turns)})
        some = replace(some, first=some.first - rests.start, last=some.last - rests.start)
        if readings is not None:
            readings = TurnReadings(integral=readings.integral[turns], covariance=readings.covariance[turns])
    return replace(
        observations,
        rests=Rests(**own),
        turns=some,
        turn_samples=None if some is None else _samples_from(observations.turn_samples, turns.start),
        turn_readings=None if some is None else readings,
        together=replace(together, session=together.session[rests], number=together.number[rests]),
    )


def _samples_from(samples: TurnSamples | None, first: int) -> TurnSamples | None:
    """The samples of the session whose turns begin with this one."""
    if samples is None:
        return None
    every = {0: replace(samples, others=(), _only_batch=[])} | dict(samples.others)
    return every.get(first)


def held(observations: Observations) -> Observations:
    """The same with turns of no duration that leave the attitude as it is to HELD."""
    turns = observations.turns
    if turns is None:
        return observations
    covariance = turns.covariance.copy()
    covariance[turns.duration == 0.0] = HELD**2 * np.eye(3)
    return replace(observations, turns=replace(turns, covariance=covariance))


def _rests(sessions: Sequence[Observations]) -> Rests:
    before = _files_before(sessions)
    renumbered = [
        replace(each.rests, file=each.rests.file + earlier) for each, earlier in zip(sessions, before, strict=True)
    ]
    whole: dict[str, Any] = {}
    for field in fields(Rests):
        values = [getattr(each, field.name) for each in renumbered]
        known = all(value is not None for value in values) and "magnetometer" not in field.name
        whole[field.name] = np.concatenate(values) if known else None
    return Rests(**whole)


def _files_before(sessions: Sequence[Observations]) -> list[int]:
    """How many files the sessions before each have."""
    counts = [
        1 + max([int(each.rests.file.max()), *(each.thermometers.files if each.thermometers is not None else ())])
        for each in sessions
    ]
    return [0, *np.cumsum(counts).tolist()][:-1]


def _thermometers(sessions: Sequence[Observations]) -> Thermometers | None:
    """The records of all sessions; None where one has none."""
    before = _files_before(sessions)
    known = [each.thermometers for each in sessions if each.thermometers is not None]
    if len(known) < len(sessions):
        return None
    return Thermometers(
        files={
            file + first: record
            for each, first in zip(known, before, strict=True)
            for file, record in each.files.items()
        }
    )


def _turns(sessions: Sequence[Observations], rests_before: IntArray) -> Turns | None:
    known = [
        replace(each.turns, first=each.turns.first + before, last=each.turns.last + before)
        for each, before in zip(sessions, rests_before, strict=True)
        if each.turns is not None
    ]
    if not known:
        return None
    return Turns(
        **{field.name: np.concatenate([getattr(each, field.name) for each in known]) for field in fields(Turns)}
    )


def _samples(sessions: Sequence[Observations]) -> TurnSamples | None:
    known = [(each.turn_samples, len(each.turns)) for each in sessions if each.turn_samples and each.turns is not None]
    if not known:
        return None
    before = np.cumsum([0] + [count for _, count in known]).tolist()
    others = tuple((first, samples) for first, (samples, _) in zip(before[1:-1], known[1:], strict=True))
    return replace(known[0][0], others=others, _only_batch=[])


def _readings(sessions: Sequence[Observations]) -> TurnReadings | None:
    known = [each.turn_readings for each in sessions if each.turn_readings is not None]
    if not known:
        return None
    return TurnReadings(
        integral=np.concatenate([each.integral for each in known]),
        covariance=np.concatenate([each.covariance for each in known]),
    )


def _rounding(sessions: Sequence[Observations]) -> dict[str, Rounding]:
    """That of the first session which has it, by kind of sensor."""
    out: dict[str, Rounding] = {}
    for each in sessions:
        out = dict(each.rounding) | out
    return out
