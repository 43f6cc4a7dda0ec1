"""How much hangs on the thresholds by which rests and bad samples are told from movement?

Every threshold of `tumble.reduction.blocks.tuning.Tuning` is halved, divided by 1.4, multiplied by 1.4 and doubled, the
others as they are, over simulated sessions of four grades: 12 positions by hand; on a vibrating bench; with gyros that
feel specific force and a slow turn about the vertical, at 0.3 °/s, in place of one rest; with rests of 1.2 s; with
single samples that are off by 0.5 g to 16 g and by 20 to 2000 °/s, in rests and in turns. Counted are

    false    rests that were found where the device moved
    missed   true rests that were not found
    bad      bad samples that were not left out
    sound    sound samples that were left out, of turns, and of rests beyond those of bad ones
    rms z    of the errors of the 21 parameters over u

over all sessions. A threshold that decides nothing here is named as such: the sessions do not show that it is right.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from functools import cache

import numpy as np
from stored import shown, store

from tumble.inference.joint import joint
from tumble.planning.setup import Setup
from tumble.recording.log import Chunk
from tumble.reduction.blocks.reducer import Reducer, Reduction
from tumble.reduction.blocks.tuning import USUAL, Tuning
from tumble.reduction.observations import Observations, observe
from tumble.reduction.rests.blemishes import without_blemishes
from tumble.reduction.rests.segmentation import Stretch, find_rests
from tumble.simulation.recording import Recording, record
from tumble.simulation.scenario import NO_VIBRATION, Scenario, Vibration, scenario_of
from tumble.units import DEGREE, G_STANDARD, Array, IntArray

GRADES = ("consumer", "mems", "tactical", "navigation")
SITUATIONS = ("by hand", "vibrating", "slow turn", "short rests", "bad samples")
FACTORS = (0.5, 1.0 / 1.4, 1.4, 2.0)
RATE, POSITIONS = 100.0, 12
SHORT_FORM = ("window", "fewest_short", "sample_beyond", "noise_beyond")
MOST_Z = 1.3


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Session:
    """A recording with its true rests (N, 2), s, the numbers of its bad samples, and all that was measured of it."""

    scenario: Scenario
    recording: Recording
    reduction: Reduction
    rests: Array
    bad: IntArray


@dataclass(frozen=True, kw_only=True, slots=True)
class Count:
    """What went wrong in sessions, and the sum of z² of so many parameters."""

    false: int = 0
    missed: int = 0
    bad: int = 0
    sound: int = 0
    squares: float = 0.0
    parameters: int = 0

    def __add__(self, other: Count) -> Count:
        return Count(**{f.name: getattr(self, f.name) + getattr(other, f.name) for f in fields(Count)})

    @property
    def rms(self) -> float:
        """rms z."""
        return float(np.sqrt(self.squares / max(self.parameters, 1)))

    @property
    def wrong(self) -> tuple[int, int, int, int]:
        """The counts alone."""
        return self.false, self.missed, self.bad, self.sound

    @property
    def cells(self) -> list[str]:
        """As a row of a table has it."""
        return [*map(str, self.wrong), f"{self.rms:.2f}"]


def session(grade: str, situation: str, seed: int) -> Session:
    """A session of a grade in a situation."""
    rng = np.random.default_rng([seed, GRADES.index(grade), SITUATIONS.index(situation)])
    rest = 1.2 if situation == "short rests" else 5.0
    setup = replace(Setup.of(grade=grade, positions=POSITIONS, rest=rest, sample_rate=RATE), first_rest=rest)
    vibration = Vibration(amplitude=0.05, frequency=33.7) if situation == "vibrating" else NO_VIBRATION
    scenario = scenario_of(setup, rng, vibration=vibration)
    recording = record(scenario, rng)
    rests, accel, gyro = recording.rests, recording.accel.copy(), recording.gyro.copy()
    bad = np.zeros(0, dtype=np.int64)
    if situation == "slow turn":
        gyro += accel @ (0.1 * DEGREE / G_STANDARD * rng.standard_normal((3, 3))).T
        slow = (recording.time > rests[5, 0]) & (recording.time <= rests[5, 1])
        gyro[slow] += 0.3 * DEGREE * accel[slow] / G_STANDARD
        rests = np.delete(rests, 5, axis=0)
    if situation == "bad samples":
        middle = np.concatenate([rests[1:].mean(axis=1), 0.5 * (rests[1:, 0] + rests[:-1, 1])])
        bad = np.sort((RATE * (middle + rng.uniform(-0.3, 0.3, len(middle)))).astype(np.int64))
        sizes = np.exp(rng.uniform(*np.log([[0.5 * G_STANDARD, 20.0 * DEGREE], [16.0 * G_STANDARD, 2000.0 * DEGREE]])))
        for i in bad.tolist():
            kind = int(rng.integers(2))
            (accel, gyro)[kind][i, rng.integers(3)] += sizes[kind] * rng.choice([-1.0, 1.0])
    reducer, dt = Reducer(rate=RATE, accel=scenario.accel, gyro=scenario.gyro), np.full(len(accel), 1.0 / RATE)
    reducer.feed(Chunk(file=0, time=recording.time, dt=dt, accel=accel, gyro=gyro, temperature=None))
    return Session(scenario=scenario, recording=recording, reduction=reducer.now(), rests=rests, bad=bad)


class Judge:
    """Counts what goes wrong in a session; the same rests and samples are estimated from once."""

    def __init__(self, one: Session) -> None:
        self.session = one
        self._z = cache(self._errors)

    def count(self, tuning: Tuning) -> Count:
        """What goes wrong with a tuning."""
        one = self.session
        reduction = without_blemishes(replace(one.reduction, tuning=tuning))
        spans = find_rests(reduction, one.scenario.accel, one.scenario.gyro).rests
        times = np.array([(s.start, s.stop) for s in spans]).reshape(-1, 2)
        inside = (times[:, None, 0] >= one.rests[:, 0] - 0.05) & (times[:, None, 1] <= one.rests[:, 1] + 0.05)
        whole = Count(false=int((~inside.any(axis=1)).sum()), missed=int((~inside.any(axis=0)).sum()))
        if len(spans) < 2:
            return whole
        found = observe(
            reduction,
            spans,
            one.scenario.accel,
            one.scenario.gyro,
            one.scenario.site,
        )
        assert found.turn_samples is not None
        blocks = [(b.first * self.block, b.last * self.block) for b in reduction.blemishes]
        of_rests = [i for first, last in blocks for i in one.bad.tolist() if first <= i < last]
        out = set(found.turn_samples.bad.at.tolist())
        more = sum(b.samples for b in reduction.blemishes) - len(of_rests) + len(out - set(one.bad.tolist()))
        left = len(set(one.bad.tolist()) - out - set(of_rests))
        key = spans, tuple(sorted(out)), tuple(blocks)
        self.observations = found
        squares, parameters = self._z(key)
        return whole + Count(bad=left, sound=max(more, 0), squares=squares, parameters=parameters)

    @property
    def block(self) -> int:
        """Samples in a block."""
        return self.session.reduction.files[0].size

    def _errors(self, _: tuple[tuple[Stretch, ...], tuple[int, ...], tuple[tuple[int, int], ...]]) -> tuple[float, int]:
        """Σ z² and how many parameters of the linear model are known."""
        observations: Observations = replace(self.observations, usual=self.session.scenario.setup.further)
        try:
            found = joint(observations)
        except np.linalg.LinAlgError:  # too few rests
            return 0.0, 0
        truth = self.session.scenario.truth
        z = [
            (value - truth[name]) / u
            for name, value, u in zip(found.names, found.values, found.u, strict=True)
            if name in truth and np.isfinite(u) and u > 0.0
        ][:21]
        return float(np.square(z).sum()), len(z)


def swept(names: tuple[str, ...]) -> Iterator[tuple[str, float, Tuning]]:
    """Every threshold times every factor: whole numbers stay such."""
    for name in names:
        usual = getattr(USUAL, name)
        values = [max(1, round(usual * f)) if isinstance(usual, int) else usual * f for f in FACTORS]
        for factor, value in zip(FACTORS, values, strict=True):
            yield name, factor, replace(USUAL, **{name: value})


def main() -> int:
    short = "--short" in sys.argv[1:]
    grades, situations = (("mems",), SITUATIONS[3:]) if short else (GRADES, SITUATIONS)
    names = SHORT_FORM if short else tuple(f.name for f in fields(Tuning))
    judges = [Judge(session(grade, situation, seed=1)) for grade in grades for situation in situations]
    counted = len(judges) * POSITIONS
    usual = sum((judge.count(USUAL) for judge in judges), Count())
    print(f"{len(judges)} sessions, {counted} positions, {sum(len(j.session.bad) for j in judges)} bad samples, seed 1")
    head = ["threshold", "times", "false rests", "missed rests", "bad samples kept", "sound ones left out", "rms z"]
    rows = [head, ["as they are", "", *usual.cells]]
    near, decides = list[str](), set[str]()
    for name, factor, tuning in swept(names):
        found = sum((judge.count(tuning) for judge in judges), Count())
        if found.wrong == usual.wrong and abs(found.rms - usual.rms) < 0.05:
            continue
        decides.add(name)
        if 0.7 < factor < 1.5 and (sum(found.wrong) > sum(usual.wrong) or found.rms > MOST_Z):
            near.append(name)
        rows.append([f"`{name}`", f"{factor:.2g}", *found.cells])
    print(shown(rows))
    if "--store" in sys.argv[1:] and not short:
        store("tuning", {"thresholds": rows}, seed=1, N=len(judges))
    print(
        f"\nThese decide nothing here, from half to twice: {', '.join(n for n in names if n not in decides) or 'none'}."
    )
    right = usual.missed == usual.bad == usual.sound == 0 and usual.rms < MOST_Z
    close = ", ".join(dict.fromkeys(near)) or "none"
    turns = len(grades) if "slow turn" in situations else 0
    print(
        f"{usual.false} of {turns} slow turns passes for a rest: the level of the gyros is followed from rest to rest."
    )
    print(
        "Are all rests found, no sound sample left out, and u honest, with the thresholds as they are? "
        f"{'Yes' if right else 'No'}; not if these are moved by 1.4: {close}."
    )
    return 0 if right else 1


if __name__ == "__main__":
    sys.exit(main())
