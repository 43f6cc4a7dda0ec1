"""Three sessions of one board of eight chips: verdicts of the whole array and of every chip alone, and what repeats.

The recordings are mimu4444 (MIT licence; not part of this repository). Every session is calibrated as a log whose
columns are named and nothing else: the array with 24 accelerometers and 24 gyros, and each chip by itself. Between
every two sessions the mean of chi-square over degrees of freedom is given by group: differences of values over the
variances of both, and with their covariances.

    python studies/array_sessions.py            the three arrays and each chip of each
    python studies/array_sessions.py --short    chips 3 and 5 of two sessions, for a look

exp_1.parquet, exp_3.parquet and exp_5.parquet are in the folder mimu4444 of TUMBLE_DATA.
"""

from __future__ import annotations

import itertools
import os
import sys
import tempfile
from pathlib import Path

import numpy as np

import tumble
from tumble.result.calibration import Calibration

CHIPS = range(1, 9)
UPRIGHT, UPSIDE_DOWN = [[1, 0, 0], [0, 1, 0], [0, 0, 1]], [[0, -1, 0], [-1, 0, 0], [0, 0, -1]]


def session(folder: Path, log: Path, chips: tuple[int, ...]) -> Path:
    """A session folder of some chips of the board."""
    axes = [axis for chip in chips for axis in (UPRIGHT if chip % 2 else UPSIDE_DOWN)]
    tables = "".join(
        f"[log.{kind}]\ncolumns = {[f'{kind[0]}{chip}{axis}' for chip in chips for axis in 'xyz']}\n"
        f"unit = 'count'\nscale = {scale}\nscale_per = '{per}'\naxes = {axes}\n"
        for kind, scale, per in (("accel", 2048.0, "g"), ("gyro", 16.4, "deg/s"))
    )
    (folder / "session.toml").write_text(
        f"format = 1\n[device]\nserial = 'mimu4444'\n[site]\nlatitude_deg = 59.35\n"
        f"[log]\nfile = '{log.resolve().as_posix()}'\ntime = 't'\n{tables}"
    )
    return folder


def calibrated(log: Path, chips: tuple[int, ...]) -> Calibration:
    """The calibration of some chips by one recording."""
    with tempfile.TemporaryDirectory() as folder:
        return tumble.calibrate(session(Path(folder), log, chips))


def repeats(first: Calibration, second: Calibration) -> dict[str, tuple[int, float, float]]:
    """By group: N, chi-square over N by variances, chi-square over its degrees of freedom by covariances."""
    names = [name for name in first if name in second and first[name].u and second[name].u]
    groups: dict[str, list[str]] = {}
    for name in names:
        groups.setdefault(".".join(name.split(".")[:2]), []).append(name)
    made: dict[str, tuple[int, float, float]] = {}
    for group, members in groups.items():
        difference = np.array([first[name].value - second[name].value for name in members])
        one, other = first.covariance_of(members), second.covariance_of(members)
        assert one is not None
        assert other is not None
        covariance = one + other
        variances = np.diag(covariance)
        if not np.all(variances > 0.0):
            continue
        scale = np.sqrt(variances)
        sizes, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
        along = vectors.T @ (difference / scale)
        made[group] = (
            len(members),
            float(np.mean(difference**2 / variances)),
            float(np.mean(along**2 / np.maximum(sizes, 1e-9))),
        )
    return made


def main() -> None:
    short = "--short" in sys.argv
    folder = Path(os.environ.get("TUMBLE_DATA") or Path(__file__).parents[2] / "shared" / "data") / "mimu4444"
    logs = {number: folder / f"exp_{number}.parquet" for number in ((3, 5) if short else (1, 3, 5))}
    wholes, refused = {}, list[str]()
    for number, log in logs.items():
        parts = [] if short else [("whole array", tuple(CHIPS))]
        for what, chips in (*parts, *((f"chip {chip}", (chip,)) for chip in ((3, 5) if short else CHIPS))):
            made = calibrated(log, chips)
            wholes.setdefault(number, made)
            said = "; ".join((*made.outcome.reasons, *made.outcome.remarks))
            print(f"session {number}, {what}: {made.outcome.verdict}" + (f"; {said}" if said else ""), flush=True)
            refused += [] if made.outcome.accepted else [f"session {number}, {what}"]
    between = list(itertools.combinations(logs, 2))
    print("\n| group | N | " + " | ".join(f"{a} and {b}" for a, b in between) + " |")
    print("|---|---|" + "---|" * len(between))
    pairs = [repeats(wholes[a], wholes[b]) for a, b in between]
    for group in pairs[0]:
        cells = [f"{pair[group][1]:.2f} ({pair[group][2]:.2f})" for pair in pairs if group in pair]
        print(f"| {group} | {pairs[0][group][0]} | " + " | ".join(cells) + " |")
    print(f"\nIs any session of the board refused, or a chip of it? {', '.join(refused) or 'No.'}")
    if refused:
        sys.exit(1)


if __name__ == "__main__":
    main()
