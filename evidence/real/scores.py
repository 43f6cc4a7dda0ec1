"""Two scores of a calibration that need no reference, and of several what they agree by.

Prediction of rests and turns that a program has not seen: the length of the corrected specific force at rest is g, and
the corrected rates of a turn carry the vertical of the rest before it into that of the rest after it.

    force   rms over rests of ‖f‖ − g, m/s², f the corrected mean reading
    shape   the same of ‖f − c‖ − g, c the three biases that fit the unseen rests best: what scale factors and axes
            miss, where biases have changed since
    tilt    rms over turns of the angle between Rᵀ u₀ and u₁, rad; u from the program's own accelerometers, R the
            integral of the corrected rates, the bias of the gyros read anew in the rests on both sides of the turn

Repeatability between sessions of one device: the standard deviation of a parameter over its sessions, and the mean
square of the differences over the u of them. Biases change from one power-on to another; scale factors and axes should
not.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from evidence.case import NAMES, Array, Case, Estimate, parameters_of
from evidence.peers.rests import Rests, chained, found, padded, rotation_of
from evidence.score import GROUPS

LONGEST_TURN = 20.0
"""s; what lasts longer, such as shaking, predicts the drift of the bias."""
STILL = 0.1
"""rad: a turn by less is none."""
FEWEST = 11
"""Rests to fit nine parameters and more to."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Prediction:
    """Of the rests and turns of a recording; None where the calibration says nothing of them."""

    rests: int
    force: float | None
    shape: float | None
    turns: int
    tilt: float | None


def prediction(estimate: Estimate, unseen: Case) -> Prediction:
    """How well what a program stands by predicts a recording that it was not made from."""
    rests = found(unseen)
    if not estimate.gives("accel"):
        return Prediction(rests=len(rests.accel), force=None, shape=None, turns=0, tilt=None)
    force, rates = estimate.corrected(rests.accel, rests.gyro)
    length = np.linalg.norm(force, axis=1)
    tilts: Array = np.zeros(0)
    if estimate.gives("gyro") and unseen.gyro is not None and rates is not None:
        tilts = tilts_of(estimate, unseen, rests, force / length[:, None], rates)
    return Prediction(
        rests=len(length),
        force=float(np.sqrt(np.mean((length - unseen.gravity) ** 2))),
        shape=shape_of(force, unseen.gravity),
        turns=len(tilts),
        tilt=float(np.sqrt(np.mean(tilts**2))) if len(tilts) else None,
    )


def shape_of(force: Array, gravity: float) -> float | None:
    """The rms of ‖f − c‖ − g over rests (n, 3) with the best c, of n − 3 degrees of freedom; None of three rests."""
    if len(force) < 4:
        return None
    c = np.zeros(3)
    for _ in range(10):
        left = force - c
        length = np.linalg.norm(left, axis=1)
        step, *_ = np.linalg.lstsq(left / length[:, None], length - gravity, rcond=None)
        c = c + step
    missed = np.linalg.norm(force - c, axis=1) - gravity
    return float(np.sqrt((missed**2).sum() / (len(force) - 3)))


def tilts_of(estimate: Estimate, unseen: Case, rests: Rests, up: Array, still: Array) -> Array:
    """The angle (turns,) by which each turn misses the vertical after it, rad; `still` are the corrected rates of the
    rests, what is left of the biases."""
    assert unseen.gyro is not None
    angles, ends = [], []
    for number, ((_, start), (stop, _)) in enumerate(pairwise(rests.spans)):
        turn = slice(int(start), int(stop) + 1)
        dt = np.diff(unseen.time[turn], prepend=unseen.time[start - 1])
        moved = np.arccos(np.clip(up[number] @ up[number + 1], -1.0, 1.0)) > STILL
        if dt.max() > 1.5 / unseen.rate or dt.sum() > LONGEST_TURN or not moved:
            continue
        share = np.linspace(0.0, 1.0, len(dt))[:, None]
        _, rate = estimate.corrected(unseen.accel[turn], unseen.gyro[turn])
        assert rate is not None
        angles.append((rate - (1.0 - share) * still[number] - share * still[number + 1]) * dt[:, None])
        ends.append(number)
    if not ends:
        return np.zeros(0)
    angle = padded(angles)
    half = 0.5 * np.linalg.norm(angle, axis=-1, keepdims=True)
    turned = rotation_of(chained(np.concatenate([np.cos(half), 0.5 * np.sinc(half / np.pi) * angle], axis=-1)))
    before, after = up[ends], up[np.array(ends) + 1]
    carried = np.einsum("nji,nj->ni", turned, before)
    return np.asarray(np.arctan2(np.linalg.norm(np.cross(carried, after), axis=1), (carried * after).sum(axis=1)))


def folds(case: Case) -> list[tuple[Case, Case]]:
    """What to fit and what to predict, twice: without the last quarter of the rests and that, without the first and
    that, cut at the ends of rests; of a table every second row. None where fewer than FEWEST rests are left to fit."""
    if case.table:
        even = np.arange(len(case.time)) % 2 == 0
        parts = case.where(even), case.where(~even)
        return [parts, parts[::-1]] if len(case.time) >= 2 * FEWEST else []
    spans = found(case).spans
    held = len(spans) // 4
    if len(spans) - held < FEWEST:
        return []
    starts, stops = case.time[spans[:, 0]], case.time[spans[:, 1] - 1]
    margin = 0.5 / case.rate
    before = case.between(-np.inf, stops[-held - 1] + margin), case.between(starts[-held] - margin, np.inf)
    after = case.between(starts[held] - margin, np.inf), case.between(-np.inf, stops[held - 1] + margin)
    return [before, after]


@dataclass(frozen=True, kw_only=True, slots=True)
class Repeated:
    """Sessions of devices: by group of parameters the standard deviation over sessions, SI, how many degrees of freedom
    it has, and the mean square of deviations over u, None without u."""

    deviation: dict[str, float]
    degrees: dict[str, int]
    over_u: dict[str, float | None]


def repeatability(devices: Iterable[Sequence[Estimate]]) -> Repeated:
    """Of several devices, a sequence of estimates each."""
    squares: dict[str, list[float]] = {group: [] for group in GROUPS}
    degrees = dict.fromkeys(GROUPS, 0)
    ratios: dict[str, list[float]] = {group: [] for group in GROUPS}
    for sessions in devices:
        values = [parameters_of(one) for one in sessions]
        for name in NAMES:
            there = [number for number, each in enumerate(values) if name in each]
            if len(there) < 2:
                continue
            group = name.rpartition(".")[0]
            x = np.array([values[number][name] for number in there])
            squares[group].append(float(((x - x.mean()) ** 2).sum()))
            degrees[group] += len(x) - 1
            u = np.array([(sessions[number].u or {}).get(name, np.nan) for number in there])
            if np.isfinite(u).all():
                weighted = float((x / u**2).sum() / (1.0 / u**2).sum())
                ratios[group].append(float((((x - weighted) / u) ** 2).sum()) / (len(x) - 1))
    deviation = {group: float(np.sqrt(sum(s) / degrees[group])) for group, s in squares.items() if degrees[group]}
    over_u = {group: float(np.mean(ratios[group])) if ratios[group] else None for group in deviation}
    return Repeated(deviation=deviation, degrees={g: degrees[g] for g in deviation}, over_u=over_u)
