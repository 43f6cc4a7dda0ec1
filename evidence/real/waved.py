"""Recordings by hand without rests, with a magnetometer, held against attitudes by cameras.

    python -m evidence.real.waved       all programs on all recordings, to evidence/results/waved.json, and the pages

BROAD (Laidig and others, Data 6 (2021) 72) has attitudes of an IMU by an optical system, which no program is given. A
rotation between the frame of a program's sensors and that of the markers is found anew, by the turns of a second, and
two scores are left, of the samples in motion:

    turn    rms over five seconds of the angle between the turn by the corrected gyros and that of the cameras, rad
    field   rms of the angle between the corrected magnetometer, turned into the room, and its mean direction, rad

The readings as they come are a program of their own: gyros less their mean over the rest at the beginning. Cameras,
markers and a field that is not the same throughout the room are in both scores.
"""

from __future__ import annotations

import json
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from evidence import programs as benchmark
from evidence.case import Array, Case, Estimate, Refusal
from evidence.pages import ROOT, digits, table, write
from evidence.peers.magnetic import exponential, logarithm
from evidence.peers.rests import rotation_of
from evidence.real.cases import case as case_of
from evidence.real.get import named, place_of
from evidence.state import made_now

RESULTS = ROOT / "evidence" / "results" / "waved.json"
PROGRAMS = ("tumble joint", "ellipsoid", "Kok and Schön", "Huang and others", "imu_tk")
RAW = "as it comes"
LONG, SHORT = 5.0, 1.0
"""s of a turn that is judged, and of those that find the rotation between the frames."""
FIRST = 20.0
"""s of the rest at the beginning that are used."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Seen:
    """A recording, and attitudes (N, 3, 3), body → room, by cameras, where they are known and the device moves (N,)."""

    case: Case
    attitudes: Array
    known: npt.NDArray[np.bool_]


def recordings() -> Iterator[Seen]:
    """Those that are in the cache. The field is of unknown modulus: the programs that want one get the median."""
    import h5py

    source = named("broad")
    for file in source.files:
        path = place_of(source, file)
        if not path.exists():
            continue
        with h5py.File(path) as log:
            accel, gyro, mag, quaternions, moving = (
                log[name][:] for name in ("imu_acc", "imu_gyr", "imu_mag", "opt_quat", "movement")
            )
            rate = float(log.attrs["sampling_rate"])
        times = np.arange(1.0, len(accel) + 1.0) / rate
        one = case_of(source, path.stem[:2], "", times, accel, gyro, "by hand, without rests")
        modulus = float(np.median(np.linalg.norm(mag, axis=1)))
        known = moving.astype(bool) & np.isfinite(quaternions).all(axis=1)
        yield Seen(
            case=replace(one, time=times, mag=mag, mag_field=modulus),
            attitudes=rotation_of(np.where(known[:, None], quaternions, [1.0, 0.0, 0.0, 0.0])),
            known=known,
        )


def corrected(found: Estimate | None, case: Case) -> tuple[Array, Array]:
    """Rates and field (N, 3) by what a program knows of them; without a program as they come."""
    assert case.gyro is not None
    assert case.mag is not None
    first = case.gyro[case.time <= case.time[0] + FIRST].mean(axis=0)
    if found is None:
        return case.gyro - first, case.mag
    rates = case.gyro - (first if found.gyro_bias is None else found.gyro_bias)
    if found.gyro is not None:
        rates = np.linalg.solve(found.gyro, rates.T).T
    if found.mag is None or found.mag_bias is None:
        return rates, np.full_like(case.mag, np.nan)
    return rates, np.linalg.solve(found.mag, (case.mag - found.mag_bias).T).T


def turns(rates: Array, seen: Seen, seconds: float) -> tuple[Array, Array]:
    """Rotation vectors (K, 3) of stretches of a recording by gyros, and by cameras."""
    n, step = round(seconds * seen.case.rate), 1.0 / seen.case.rate
    whole = np.array([seen.known[a : a + n + 1].all() for a in range(0, len(rates) - n, n)])
    starts = n * np.flatnonzero(whole)
    steps = exponential(rates[starts[:, None] + 1 + np.arange(n)] * step)
    turned = steps[:, 0]
    for k in range(1, n):
        turned = turned @ steps[:, k]
    before, after = seen.attitudes[starts], seen.attitudes[starts + n]
    return logarithm(turned), logarithm(np.swapaxes(before, 1, 2) @ after)


def scores_of(rates: Array, field: Array, seen: Seen) -> dict[str, float | None]:
    """Turn and field; None of what a program does not know."""
    short = turns(rates, seen, SHORT)
    u, _, v = np.linalg.svd(short[0].T @ short[1])
    between = u @ np.diag([1.0, 1.0, np.linalg.det(u @ v)]) @ v  # markers → sensors
    by_gyros, by_cameras = turns(rates, seen, LONG)
    off = logarithm(np.swapaxes(exponential(by_gyros), 1, 2) @ exponential(by_cameras @ between.T))
    turn, angle = float(np.sqrt(np.mean(np.sum(off**2, axis=1)))), None
    if np.isfinite(field).all():
        room = np.einsum("nij,nj->ni", seen.attitudes[seen.known] @ between.T, field[seen.known])
        room /= np.linalg.norm(room, axis=1)[:, None]
        mean = room.mean(axis=0)
        sine = np.linalg.norm(np.cross(room, mean), axis=1)
        angle = float(np.sqrt(np.mean(np.arctan2(sine, room @ mean) ** 2)))
    return {"turn": turn, "field": angle}


def results() -> dict[str, Any]:
    """All programs on all recordings."""
    rows = list[dict[str, Any]]()
    for seen in recordings():
        for name in (RAW, *PROGRAMS):
            start = time.process_time()
            found = None if name == RAW else benchmark.named(name).calibrate(seen.case)
            seconds = round(time.process_time() - start, 1)
            if isinstance(found, Refusal):
                rows.append({"case": seen.case.name, "program": name, "said": found.reason[:300]})
                continue
            scores = scores_of(*corrected(found, seen.case), seen)
            gives = found is not None and (found.gyro is not None or found.gyro_bias is not None)
            rows.append({
                "case": seen.case.name, "program": name, "said": "" if found is None else found.verdict[:300],
                "seconds": seconds, "accepted": found is None or found.accepted,
                "turn": scores["turn"] if found is None or gives else None, "field": scores["field"],
            })  # fmt: skip
    source = named("broad")
    made = made_now("src", "evidence/*.py", "evidence/peers", "evidence/real")
    return {"made": made, "source": {"title": source.title, "licence": source.licence}, "rows": rows}


def waved_table(content: Mapping[str, Any]) -> str:
    """Return the table of both scores in mrad, in brackets if not accepted, with a row for each program."""
    names = list(dict.fromkeys(row["case"] for row in content["rows"]))
    of = {(row["case"], row["program"]): row for row in content["rows"]}
    lines = []
    for program in dict.fromkeys(row["program"] for row in content["rows"]):
        cells = [cell(of[name, program], score) for score in ("turn", "field") for name in names]
        lines.append([program, *cells])
    heads = [f"{what}, {name.split()[-1]}" for what in ("turn", "field") for name in names]
    return table(["program", *heads], lines)


def cell(row: Mapping[str, Any], score: str) -> str:
    """A score in mrad."""
    value = row.get(score)
    if value is None:
        return "–"
    text = digits(1e3 * value)
    return text if row["accepted"] else f"({text})"


def read_results() -> dict[str, Any]:
    """What is stored."""
    return dict(json.loads(RESULTS.read_text(encoding="utf-8")))


def main() -> None:
    content = results()
    RESULTS.write_text(json.dumps(content, ensure_ascii=False, indent=1) + "\n", encoding="utf-8")
    print(waved_table(content))
    write()


if __name__ == "__main__":
    main()
