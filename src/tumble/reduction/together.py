"""Several sessions as one, and rests that warm up divided into parts.

A rest is its mean reading at its mean temperature, so that a rest during which the temperature changes shows the
temperature dependence of the sensors only if it is divided into parts. The parts are joined by turns of duration 0,
which leave the attitude unchanged to PART_ROTATION.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace
from itertools import pairwise
from typing import Any, TypeVar

import numpy as np

from tumble.reduction.blocks.reducer import Reduction
from tumble.reduction.noise.rounding import Rounding
from tumble.reduction.observations import Observations, Together
from tumble.reduction.rests.rests import Rests, rows_of
from tumble.reduction.rests.segmentation import Segmentation, Stretch
from tumble.reduction.rests.thermometer import Thermometers
from tumble.reduction.rests.warming import warming_of
from tumble.reduction.turns.turns import TurnReadings, Turns, TurnSamples
from tumble.units import Array, IntArray

WARMED = 1.0  # K: temperature change of a rest from which it is divided
SHORTEST_PART = 20.0  # s: a shorter part has too few blocks for the noise of its mean
MAX_PARTS = 60
PART_ROTATION = 1e-6  # rad per axis: motion of a support from one part of a rest to the next
_Arrays = TypeVar("_Arrays", Rests, Turns, TurnReadings)


def split_warming_rests(reduction: Reduction, whole: Segmentation, least: int = 1) -> tuple[Segmentation, IntArray]:
    """Divide each rest into one part per WARMED of temperature change, at least `least` if it is long enough. Return
    the parts in place of the rests, and the number (N,) of the rest that each part belongs to."""
    by_file, spans, number = reduction.by_file, list[Stretch](), list[int]()
    for i, span in enumerate(whole.rests):
        file = by_file[span.file]
        kelvin = None if file.temperature is None else file.temperature[span.first : span.last]
        parts = 1
        if kelvin is not None:
            tenths = [part.mean(axis=0) for part in np.array_split(kelvin, min(10, len(kelvin)))]
            change = max(warming_of(kelvin), float(np.ptp(tenths, axis=0).max()))
            most = min(MAX_PARTS, int((span.stop - span.start) / SHORTEST_PART))
            parts = max(1, min(max(int(np.ceil(change / WARMED)), least), most))
        for first, last in pairwise(np.linspace(span.first, span.last, parts + 1).round().astype(int).tolist()):
            edges = span.start if first == span.first else file.edges[first], file.edges[last]
            stop = span.stop if last == span.last else float(edges[1])
            spans.append(replace(span, first=first, last=last, start=float(edges[0]), stop=stop))
            number.append(i)
    position = None if whole.position is None else whole.position[number]
    return replace(whole, rests=tuple(spans), position=position), np.array(number, dtype=np.int64)


def join_sessions(sessions: Sequence[Observations], names: Sequence[str], numbers: Sequence[IntArray]) -> Observations:
    """Join the observations of sessions of one device at one place; `numbers` are for each session the numbers (N,) of
    its rests, which parts of a rest share."""
    counts = [len(each.rests) for each in sessions]
    rests, turns, readings = list[Rests](), list[Turns](), list[TurnReadings]()
    samples, records = list[tuple[int, TurnSamples]](), dict[int, tuple[float, Array]]()
    rounding = dict[str, Rounding]()  # by kind of sensor, from the first session which has it
    files_before = rests_before = turns_before = 0
    for each, count in zip(sessions, counts, strict=True):
        files = each.thermometers.files if each.thermometers is not None else {}
        rests.append(replace(each.rests, file=each.rests.file + files_before))
        records |= {file + files_before: record for file, record in files.items()}
        rounding = dict(each.rounding) | rounding
        if each.turns is not None:
            first, last = each.turns.first + rests_before, each.turns.last + rests_before
            turns.append(replace(each.turns, first=first, last=last))
            if each.turn_samples is not None:
                samples.append((turns_before, each.turn_samples))
                turns_before += len(each.turns)
        if each.turn_readings is not None:
            readings.append(each.turn_readings)
        files_before += 1 + max([int(each.rests.file.max()), *files])
        rests_before += count
    thermometers = all(each.thermometers is not None for each in sessions)
    return replace(
        sessions[0],
        rests=replace(_stacked(rests), magnetometer=None, magnetometer_covariance=None),
        turns=_stacked(turns) if turns else None,
        turn_samples=replace(samples[0][1], others=tuple(samples[1:])) if samples else None,
        turn_readings=_stacked(readings) if readings else None,
        arrays=tuple(moments for each in sessions for moments in each.arrays),
        programme=None,
        position=None,
        rounding=rounding,
        thermometers=Thermometers(files=records) if thermometers else None,
        notes=tuple(f"{name}: {note}" for name, each in zip(names, sessions, strict=True) for note in each.notes),
        turns_left_out=tuple(
            f"{name}: {turn}" for name, each in zip(names, sessions, strict=True) for turn in each.turns_left_out
        ),
        together=Together(
            names=tuple(names), session=np.repeat(np.arange(len(sessions)), counts), number=np.concatenate(numbers)
        ),
    )


def _stacked(parts: Sequence[_Arrays]) -> _Arrays:
    """Concatenate the rows of all parts; None for a field that is None in one of them."""
    columns = {field.name: [getattr(part, field.name) for part in parts] for field in fields(parts[0])}
    whole: dict[str, Any] = {k: None if any(v is None for v in c) else np.concatenate(c) for k, c in columns.items()}
    return replace(parts[0], **whole)


def extract_session(observations: Observations, rests: slice, turns: slice) -> Observations:
    """Return the observations of one session, with these rests and turns, out of several that were joined."""
    together, samples, readings = observations.together, observations.turn_samples, observations.turn_readings
    assert together is not None
    its_turns = None
    if observations.turns is not None and turns.stop > turns.start:
        its_turns = rows_of(observations.turns, turns)
        its_turns = replace(its_turns, first=its_turns.first - rests.start, last=its_turns.last - rests.start)
    if samples is not None:  # sessions are identified by their first turn
        samples = ({0: replace(samples, others=())} | dict(samples.others)).get(turns.start)
    return replace(
        observations,
        rests=rows_of(observations.rests, rests),
        turns=its_turns,
        turn_samples=None if its_turns is None else samples,
        turn_readings=None if its_turns is None or readings is None else rows_of(readings, turns),
        together=replace(together, session=together.session[rests], number=together.number[rests]),
    )


def hold_attitude(observations: Observations) -> Observations:
    """Return observations whose turns of duration 0 leave the attitude unchanged to PART_ROTATION."""
    turns = observations.turns
    if turns is None:
        return observations
    covariance = turns.covariance.copy()
    covariance[turns.duration == 0.0] = PART_ROTATION**2 * np.eye(3)
    return replace(observations, turns=replace(turns, covariance=covariance))
