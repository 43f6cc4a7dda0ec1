"""What `tumble new` guesses of logs whose units, scales, rates, times, columns and axes are hostile to guessing.

Simulated recordings, with 2 to 16 rests, are written as boards, phones and laboratories write them: in random units or
counts of data sheets, with or without a word for them, at random rates, with times in any unit, in ticks, as intervals,
as numbers of samples or none, with columns that are named or not, and some with exchanged or reversed axes. Every guess
is right, said to be near another that is the right one, refused, or wrong without a word, which is what must not be.

    python studies/log_guesses.py [N] [--seed S] [--sweep [WIDTH …]] [--short]

`--sweep` does so with each of the `Widths` of `tumble.diagnosis.turn_likelihood`, or with those named, halved and
doubled; `--short` is 20 logs. Ends with 1 where more than 3 of 100 are wrong without a word.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections import Counter
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import polars as pl

from tumble.diagnosis.turn_likelihood import WIDTHS, Widths
from tumble.drafting.new_session import NOTHING_GIVEN, written_session
from tumble.errors import TumbleError
from tumble.files import nothing_left
from tumble.planning.setup import Setup
from tumble.recording.log import Log
from tumble.run.observed import inspect_session
from tumble.simulation.session import simulate_session
from tumble.units import DEGREE, G_STANDARD

SILENT_SHARE = 0.03
RECORDINGS = 14
RATES = (25.0, 50.0, 100.0, 104.0, 119.0, 200.0)
ACCEL_WORDS = {"m/s^2": 1.0, "g": 1 / G_STANDARD, "mg": 1e3 / G_STANDARD, "cm/s^2": 100.0, "mm/s^2": 1e3}
"""Numbers per m/s²."""
GYRO_WORDS = {
    "rad/s": 1.0,
    "deg/s": 1 / DEGREE,
    "mdeg/s": 1e3 / DEGREE,
    "0.1 deg/s": 10 / DEGREE,
    "deg/h": 3600 / DEGREE,
}
ACCEL_SHEETS = (16384.0, 8192.0, 4096.0, 2048.0, 1024.0, 256.0, 1e3 / 0.732)
GYRO_SHEETS = (131.0, 65.5, 32.8, 16.4, 16.0, 14.375, 1e3 / 8.75, 1e3 / 17.5, 1e3 / 70.0)
TIMES = {"s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9, "ticks": 32768.0, "25 us": 4e4}
NAMES = (
    ("ax", "ay", "az", "gx", "gy", "gz"),
    ("AccX", "AccY", "AccZ", "GyroX", "GyroY", "GyroZ"),
    ("accel_x", "accel_y", "accel_z", "gyro_x", "gyro_y", "gyro_z"),
    ("imu.acc.0", "imu.acc.1", "imu.acc.2", "imu.gyr.0", "imu.gyr.1", "imu.gyr.2"),
    (),
    (),
)
DOUBTS = ("would fit", "is unknown", "no turn", "is a guess, put", "identified by their numbers")


@dataclass(kw_only=True)
class Truth:
    """How a recording was written: numbers per m/s² and per rad/s, samples per second, the columns of accelerometers
    and gyros, the words that name the truth of each, and whether gyros have other axes than accelerometers."""

    accel: float
    gyro: float
    rate: float
    columns: tuple[list[str], list[str]]
    words: dict[str, str] = field(default_factory=dict)
    turned: bool = False
    how: str = ""


Recordings = list[tuple[pl.DataFrame, float, int]]
"""Clean logs in SI, their rates, Hz, and how many positions they have."""


def recordings(folder: Path, seed: int) -> Recordings:
    """Clean logs in SI, their rates, Hz, and how many positions they have."""
    rng = np.random.default_rng(seed)
    made = []
    for k in range(RECORDINGS):
        positions, rate = int(rng.choice([2, 3, 4, 8, 12, 16])), float(rng.choice(RATES))
        setup = Setup.of(
            grade=str(rng.choice(["mems", "consumer"])),
            positions=positions,
            rest=float(rng.uniform(2.6, 6.0)),
            rate_deg_s=float(rng.uniform(40.0, 160.0)),
            sample_rate=rate,
        )
        simulate_session(folder / str(k), setup, seed=seed + k)
        made.append((pl.read_parquet(folder / str(k) / "log.parquet"), rate, positions))
    return made


def written(log: pl.DataFrame, rate: float, path: Path, rng: np.random.Generator) -> Truth:
    """A log in one of the ways of the world, as a text file, and the truth of it."""
    t, a, g = (log.select(c).to_numpy() for c in (["t"], ["ax", "ay", "az"], ["gx", "gy", "gz"]))
    t = t[:, 0] - t[0, 0]
    words, turned = {}, rng.random() < 0.12
    if turned:
        g = g[:, rng.permutation(3)] * rng.choice([-1.0, 1.0], 3)
        turned = not np.array_equal(g, log.select(["gx", "gy", "gz"]).to_numpy())
    way = rng.choice(["units", "counts", "mixed", "increments"], p=[0.45, 0.33, 0.17, 0.05])
    accel_word, gyro_word, whole = str(rng.choice(list(ACCEL_WORDS))), str(rng.choice(list(GYRO_WORDS))), (False, False)
    per_accel, per_gyro, zero = ACCEL_WORDS[accel_word], GYRO_WORDS[gyro_word], 0.0
    if way == "units":
        accel_word, gyro_word = (
            (accel_word, gyro_word)
            if rng.random() < 0.5
            else [("m/s^2", "rad/s"), ("g", "deg/s"), ("m/s^2", "deg/s"), ("mg", "mdeg/s")][rng.integers(4)]
        )
        per_accel, per_gyro = ACCEL_WORDS[accel_word], GYRO_WORDS[gyro_word]
        whole = per_accel > 90.0 and rng.random() < 0.7, per_gyro > 500.0 and rng.random() < 0.7
    if way in ("counts", "mixed"):
        sheet = float(rng.choice(GYRO_SHEETS))
        gyro_word, per_gyro, whole = f"{sheet:.6g}", sheet / DEGREE, (per_accel > 90.0, True)
        if way == "counts":
            sheet = float(rng.choice(ACCEL_SHEETS))
            accel_word, per_accel, whole = f"{sheet:.6g}", sheet / G_STANDARD, (True, True)
            zero = 32768.0 if rng.random() < 0.08 else 0.0
    if way == "increments":
        accel_word, gyro_word = "m/s", str(rng.choice(["rad", "deg", "arcsec"]))
        per_accel, per_gyro = 1 / rate, {"rad": 1.0, "deg": 1 / DEGREE, "arcsec": 3600 / DEGREE}[gyro_word] / rate
    columns = [per_accel * a[:, j] + zero for j in range(3)] + [per_gyro * g[:, j] for j in range(3)]
    columns = [np.round(c) if whole[j // 3] else c for j, c in enumerate(columns)]
    names = list(NAMES[rng.integers(len(NAMES))])
    stated = bool(names) and rng.random() < 0.15 and way in ("units",)
    if stated:
        names = [f"{n} [{accel_word if j < 3 else gyro_word}]" for j, n in enumerate(names)]
    order = [*range(3, 6), *range(3)] if rng.random() < 0.25 else list(range(6))
    time = str(rng.choice(["s", "ms", "us", "ns", "ticks", "25 us", "none", "interval", "count"],
                          p=[0.26, 0.2, 0.18, 0.05, 0.05, 0.03, 0.13, 0.05, 0.05]))  # fmt: skip
    time = "ms" if time == "interval" and not names else time
    stamps: list[npt.NDArray[Any]] = []
    if time in TIMES:
        size = TIMES[time]
        stamps = [t if time == "s" else np.round(size * (t + rng.uniform(0, 50)))]
    elif time == "interval":
        stamps = [np.full(len(t), round(1e6 / rate))]
    elif time == "count":
        stamps = [np.arange(len(t)) + float(rng.integers(5000))]
    label = {"interval": "dt", "count": "n"}.get(time, str(rng.choice(["t", "time", "timestamp"])))
    table = [*stamps, *(columns[j] for j in order)]
    if not names:
        digits = [f"{k + 1}" for k in range(len(table))]
        head, kinds = "", [digits[len(stamps) + order.index(j)] for j in range(6)]
    else:
        head = ",".join([*([label] if stamps else []), *(names[j] for j in order)]) + "\n"
        kinds = names
    texts = [[f"{v:.10g}" if k < len(stamps) else f"{v:.6g}" for v in column] for k, column in enumerate(table)]
    if time in TIMES and time != "s":
        texts[0] = [f"{v:.0f}" for v in table[0]]
    path.write_text(head + "".join(",".join(row) + "\n" for row in zip(*texts, strict=True)))
    words = {"accelerometers": accel_word, "gyros": gyro_word, "rate": f"{rate:g}"}
    how = f"{way} {accel_word} {gyro_word} {time} {rate:g} Hz {'named' if names else 'nameless'}"
    if stated:
        words["stated"] = "yes"
    return Truth(accel=per_accel, gyro=per_gyro, rate=rate, columns=(kinds[:3], kinds[3:]), words=words,
                 turned=turned, how=how + (" exchanged" if turned else ""))  # fmt: skip


def outcome(log: Path, folder: Path, truth: Truth, widths: Widths = WIDTHS) -> tuple[str, str]:
    """Right, said, refused or silent, and in which part, of one log."""
    try:
        with nothing_left(folder) as output:
            draft, faults = written_session(output, log, NOTHING_GIVEN, Log.chunks, widths)
        observed = inspect_session(draft.session())
    except TumbleError as error:
        return "refused", str(error).rpartition(": ")[2][:60]
    session, blocks = draft.session(), observed.reduction.files[0]
    rate = blocks.size * len(blocks) / float(blocks.edges[-1] - blocks.edges[0])  # as the stamps have it at the mean
    doubts = [s for s in (*draft.remarks, *draft.doubts) if any(d in s for d in DOUBTS)]
    if list(session.log.accel.columns) != truth.columns[0]:
        return ("refused" if faults else "silent"), "columns"
    if session.log.gyro is None or list(session.log.gyro.columns) != truth.columns[1]:
        said = any("identified by their numbers" in s for s in doubts)
        return ("refused" if faults else "said" if said else "silent"), "gyro columns"
    parts = []
    for kind, channels, worth in (
        ("accelerometers", session.log.accel, truth.accel),
        ("gyros", session.log.gyro, truth.gyro),
    ):
        per = float(channels.scale[0]) / channels.unit.per_second(rate)
        if abs(np.log(per / worth)) > 0.004:
            parts.append(kind)
    if abs(np.log(rate / truth.rate)) > 0.004:
        parts.append("rate")
    for part in parts:
        general = ("is unknown", "no turn", "is a guess, put")
        known = any(f"{truth.words[part]}{end}" in f"{s} " for s in doubts for end in " :,") or any(
            word in s for s in doubts for word in general
        )
        if not known and not faults:
            return "silent", part
    if truth.turned and not faults:
        turns = observed.observations is not None and observed.observations.turns
        return ("silent" if turns else "said"), "axes"
    if faults:
        return ("right" if truth.turned else "refused"), f"{', '.join(parts) or 'axes'}: {faults[0][-70:]}"
    return ("said" if parts else "right"), ", ".join(parts)


def asked(number: int, seed: int, made: Recordings, folder: Path, widths: Widths, *, show: bool) -> Counter[str]:
    """How many of so many logs are right, said, refused and silent."""
    counts: Counter[str] = Counter()
    for i in range(number):
        rng = np.random.default_rng([seed, i])
        log, rate, positions = made[int(rng.integers(len(made)))]
        truth = written(log, rate, folder / f"log{i}.csv", rng)
        with tempfile.TemporaryDirectory() as session:
            what, where = outcome(folder / f"log{i}.csv", Path(session) / "s", truth, widths)
        counts[what] += 1
        if show or what == "silent":
            print(f"{i} {what} ({where}): {truth.how}, {positions} positions", flush=True)
    print(", ".join(f"{counts[word]} {word}" for word in ("right", "said", "refused", "silent")), flush=True)
    return counts


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("number", nargs="?", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--show", action="store_true")
    names = [width.name for width in fields(Widths)]
    parser.add_argument("--sweep", nargs="*", choices=names)
    parser.add_argument("--short", action="store_true")
    words = parser.parse_args()
    number = 20 if words.short else words.number
    with tempfile.TemporaryDirectory() as temporary:
        made = recordings(Path(temporary), words.seed)
        print(f"N = {number}, seed {words.seed}")
        counts = asked(number, words.seed, made, Path(temporary), WIDTHS, show=words.show)
        for name in () if words.sweep is None else words.sweep or names:
            for factor in (0.5, 2.0):
                widths = replace(WIDTHS, **{name: factor * getattr(WIDTHS, name)})
                print(f"{name} {factor:g} times: ", end="")
                asked(number, words.seed, made, Path(temporary), widths, show=False)
    holds = counts["silent"] <= SILENT_SHARE * number
    answer = "Yes" if holds else "No"
    print(f"Is a wrong guess said? {answer}: {counts['silent']} of {number} are wrong without a word.")
    if not holds:
        sys.exit(1)


if __name__ == "__main__":
    main()
