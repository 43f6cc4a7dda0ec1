"""Does the page follow a session at the pace of reality, however long its rests are?

Sessions are appended to a log a fifth of a second at a time, and the bench looks after each, as it does in reality;
only the time between is not waited for. First come sessions of a programme that begin with a warm-up in the first
position, of 10 to 60 minutes, then sessions by hand with rests, turns and warm-ups drawn at random. From LATE_SECONDS
after the beginning of a rest to its end the page must say which position this is, and nothing may be called wrong. In
the end it must show as many rests as the calibration has, and what it calibrates must be what `tumble calibrate` makes
of the recording.

    python studies/bench_in_real_time.py [--short]
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from tumble.bench.session_folder import begin
from tumble.bench.station import STEP_SECONDS, Station
from tumble.programme.positions import programme
from tumble.recording.live.samples import SI_LOG
from tumble.rotation import rotation_matrix, rotation_vector
from tumble.run.observed import inspect_session
from tumble.sensors.grades import grade
from tumble.units import DEGREE, G_STANDARD, Array

SAMPLE_RATE = 25.0
PANELS = 8
"""Of a sample, over which its reading is averaged."""
LATE_SECONDS = 1.0
"""From the end of a turn until the page says where the unit rests."""
SITE = {"latitude_deg": 50.0, "gravity": 9.81}
EARTH = 7.292115e-5 * np.array([np.cos(50.0 * DEGREE), np.sin(50.0 * DEGREE), 0.0])
"""rad/s, towards north, up and east."""
PROGRAMME = "nine"


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Course:
    """Rests of so many seconds, turns (n − 1, 3) between them, rad, in the geographic frame, each at a rate, rad/s; the
    first attitude; and biases that settle by so much, `warm_up` (6,), SI, with a time constant, s."""

    programme: str | None
    attitude: Array
    rests: list[float]
    turns: Array
    rates: list[float]
    warm_up: Array
    settles: float


@dataclass(frozen=True, kw_only=True, slots=True)
class Followed:
    """How the page followed a recording: looks at rest, and those of them that named another position or called
    something wrong; whether the number of rests and the result are those of the batch; processor time of a look, s."""

    looks: int
    wrong: int
    same_rests: bool
    same_result: bool
    seconds: float

    @property
    def fine(self) -> bool:
        """Whether nothing is otherwise than it should be."""
        return not self.wrong and self.same_rests and self.same_result


def after_warming_up(minutes: float, rest: float) -> Course:
    """A programme whose first rest lasts so long, and the others so many seconds."""
    attitudes = [position.matrix for position in programme(PROGRAMME).positions]
    return Course(
        programme=PROGRAMME,
        attitude=attitudes[0],
        rests=[60.0 * minutes, *[rest] * (len(attitudes) - 1)],
        turns=np.array([rotation_vector(b @ a.T) for a, b in pairwise(attitudes)]),
        rates=[45.0 * DEGREE] * (len(attitudes) - 1),
        warm_up=np.zeros(6),
        settles=600.0,
    )


def by_hand(rng: np.random.Generator) -> Course:
    """Rests of 6 to 30 s, the first up to two minutes, turns of 60° to 180° at 20 to 140 °/s; biases that settle
    by 2 mg and 0.1 °/s at most within minutes."""
    turns = int(rng.integers(8, 12))
    axes = rng.standard_normal((turns, 3))
    angles = rng.uniform(60.0, 180.0, turns) * DEGREE
    return Course(
        programme=None,
        attitude=rotation_matrix(rng.uniform(-2.0, 2.0, 3)),
        rests=[rng.uniform(10.0, 120.0), *rng.uniform(6.0, 30.0, turns)],
        turns=axes / np.linalg.norm(axes, axis=1, keepdims=True) * angles[:, None],
        rates=list(rng.uniform(20.0, 140.0, turns) * DEGREE),
        warm_up=rng.uniform(-1.0, 1.0, 6) * np.repeat([2e-3 * G_STANDARD, 0.1 * DEGREE], 3),
        settles=float(rng.uniform(60.0, 600.0)),
    )


def recorded(folder: Path, course: Course, rng: np.random.Generator) -> Array:
    """Write a session folder of a course, of a unit of the grade "mems"; begin and end of its rests (n, 2), s."""
    attitude, clock, rests, pieces = course.attitude, 0, [], []
    for k, seconds in enumerate(course.rests):
        samples = round(seconds * SAMPLE_RATE)
        rests.append((clock / SAMPLE_RATE, (clock + samples) / SAMPLE_RATE))
        still = np.concatenate([attitude.T @ [0.0, SITE["gravity"], 0.0], attitude.T @ EARTH])
        pieces.append(np.broadcast_to(still, (samples, 6)))
        clock += samples
        if k < len(course.turns):
            turn = course.turns[k]
            pieces.append(moved := _turned(attitude, turn, course.rates[k]))
            attitude, clock = rotation_matrix(turn) @ attitude, clock + len(moved)
    true, time_s = np.concatenate(pieces), np.arange(1, clock + 1) / SAMPLE_RATE
    noise = grade("mems").noise
    white = np.repeat([noise.accel_white, noise.gyro_white], 3) * SAMPLE_RATE**0.5
    bias = rng.standard_normal(6) * np.repeat([0.02 * G_STANDARD, 1.0 * DEGREE], 3)
    settling = course.warm_up * np.exp(-time_s[:, None] / course.settles)
    rows = np.column_stack([time_s, true + bias + settling + white * rng.standard_normal((clock, 6))])
    begin(folder, log=SI_LOG, serial="in-real-time", site=SITE, programme=course.programme)
    header = ",".join([SI_LOG["time"], *SI_LOG["accel"]["columns"], *SI_LOG["gyro"]["columns"]])
    np.savetxt(folder / "log.csv", rows, fmt="%.9g", delimiter=",", header=header, comments="")
    return np.array(rests)


def _turned(attitude: Array, turn: Array, rate: float) -> Array:
    """Specific force and angular rate (m, 6) in the body in the samples of a turn that begins and ends smoothly."""
    angle = float(np.linalg.norm(turn))
    samples = max(4, round(2.0 * angle / rate * SAMPLE_RATE))
    part = (np.arange(samples * PANELS) + 0.5) / (samples * PANELS)
    gone, speed = part - np.sin(2.0 * np.pi * part) / (2.0 * np.pi), 1.0 - np.cos(2.0 * np.pi * part)
    from_body = rotation_matrix(gone[:, None] * turn) @ attitude
    rates = turn * speed[:, None] * SAMPLE_RATE / samples + EARTH
    true = [np.full((len(part), 3), [0.0, SITE["gravity"], 0.0]), rates]
    seen = np.hstack([np.einsum("kij,ki->kj", from_body, each) for each in true])
    return np.asarray(seen.reshape(samples, PANELS, 6).mean(axis=1))


def followed(sent: Path, rests: Array, folder: Path, between: float) -> Followed:
    """Have a bench follow a recording as it grows, and calibrate it. It looks every so many seconds from a minute after
    the beginning of a rest to ten seconds before its end."""
    folder.mkdir()
    (folder / "session.toml").write_bytes((sent / "session.toml").read_bytes())
    header, *rows = (sent / "log.csv").read_bytes().splitlines(keepends=True)
    station, looks, wrong, seconds = Station(folder, None), 0, 0, 0.0
    written = 0
    with (folder / "log.csv").open("ab", buffering=0) as log:
        log.write(header)
        while written < len(rows):
            at = written / SAMPLE_RATE
            middle = np.any((rests[:, 0] + 60.0 < at) & (at < rests[:, 1] - 10.0 - between))
            start, written = written, written + round((between if middle else STEP_SECONDS) * SAMPLE_RATE)
            log.write(b"".join(rows[start:written]))
            began = time.thread_time()
            station.step()
            seconds += time.thread_time() - began
            at = min(written, len(rows)) / SAMPLE_RATE
            resting = np.flatnonzero((rests[:, 0] + LATE_SECONDS <= at) & (at <= rests[:, 1]))
            if len(resting):
                looks += 1
                wrong += not _right(station.state, int(resting[0]), at - rests[resting[0], 0])
    station.step()
    taken = len(station.state["sphere"]["taken"])
    station.command("calibrate")
    station.stop()
    words = ["calibrate", "--out", str(sent / "batch.json"), "--", str(sent)]
    subprocess.run([sys.executable, "-m", "tumble", *words], capture_output=True, check=False)
    return Followed(
        looks=looks,
        wrong=wrong,
        same_rests=taken == len(inspect_session(sent).segmentation.rests),
        same_result=_without_date(folder / "calibration.json") == _without_date(sent / "batch.json"),
        seconds=seconds / looks,
    )


def _right(state: dict[str, Any], rest: int, since: float) -> bool:
    """Whether a page says that the unit is in rest `rest`, from 0, for so many seconds; in the first one it may still
    wait."""
    if state["screen"] == "waiting":
        return rest == 0 and since < 5.0
    return state["fault"] is None and len(state["sphere"]["taken"]) == rest + 1


def _without_date(path: Path) -> dict[str, Any]:
    """A calibration but for when it was made."""
    content = dict(json.loads(path.read_text(encoding="utf-8")))
    del content["provenance"]["created"]
    return content


def main() -> int:
    parser = argparse.ArgumentParser()
    parser.add_argument("--short", action="store_true", help="one warm-up, of ten minutes, and one session by hand")
    given = parser.parse_args()
    minutes, rest, sessions = ([10.0], 15.0, 1) if given.short else ([10.0, 20.0, 60.0], 56.0, 20)
    courses = [(f"first rest {m:g} min", after_warming_up(m, rest)) for m in minutes]
    courses += [(f"by hand {k}", by_hand(np.random.default_rng([1, k]))) for k in range(sessions)]
    fine = 0
    for k, (name, course) in enumerate(courses):
        with tempfile.TemporaryDirectory() as made:
            sent = Path(made) / "sent"
            rests = recorded(sent, course, np.random.default_rng([2, k]))
            page = followed(sent, rests, Path(made) / "received", 2.0 if given.short else STEP_SECONDS)
        fine += page.fine
        print(
            f"{name}: {len(rests)} rests in {rests[-1, 1]:.0f} s, {page.wrong} of {page.looks} looks wrong; rests "
            f"{'as' if page.same_rests else 'not as'} in the batch, result {'as' if page.same_result else 'not as'} in "
            f"the batch; {1e3 * page.seconds:.1f} ms a look",
            flush=True,
        )
    answer = "Yes." if fine == len(courses) else f"In {fine} of {len(courses)}."
    print(f"Does the page follow a session at the pace of reality, however long its rests are? {answer}")
    return 0 if fine == len(courses) else 1


if __name__ == "__main__":
    sys.exit(main())
