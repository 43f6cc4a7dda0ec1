"""When is the scalar method better than the sequential vector method?

Both on the same launches of navigation-grade instruments, with noise, on tables and in mountings that are off by up to
0.1° to 5° about each axis: rms errors of the accelerometer parameters and of the gyro parameters that follow from
them, after one pass and after two, in % of the spread before calibration. The methods are the package's, on mean
readings and turns of the simulation in `formulas_against_simulation.py`.

    python studies/sequential_against_scalar.py [--short]

The answer is printed last.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace

import formulas_against_simulation as simulation
import numpy as np
from paper_device import SCALAR, SEQUENTIAL, SETUP, passes, values_of

from tumble.sensors.grades import NoiseModel
from tumble.units import DEGREE

TABLES = (0.1, 0.2, 0.5, 1.0, 2.0, 3.0, 5.0)
"""Largest errors of table and mounting about each axis, degrees."""

GROUPS = {
    "accel.bias": (slice(0, 3), SETUP.accel.bias),
    "accel.scale": (slice(3, 6), SETUP.accel.scale),
    "accel.axis": (slice(6, 9), SETUP.accel.axis),
    "gyro.scale": (slice(12, 15), SETUP.gyro.scale),
    "gyro.axis": (slice(15, 21), SETUP.gyro.axis),
}

WORSE = 1.1
"""Ratio of rms errors from which one method counts as worse."""

NOWHERE = f"nowhere up to ±{max(TABLES):g}°"


def errors(degrees: float, launches: int) -> dict[tuple[str, int], dict[str, float]]:
    """Rms errors by method and pass, then by group, % of the spread before calibration."""
    noise = NoiseModel(accel_white=SETUP.noise.accel_white, gyro_white=SETUP.noise.gyro_white)
    size = degrees * DEGREE
    setup = replace(SETUP, noise=noise, rest=60.0, table_error=size, mounting_error=size)
    found = simulation.simulate(setup, launches, np.random.default_rng(11))
    out = {}
    for method in (SEQUENTIAL, SCALAR):
        for count, models in enumerate(passes(found, method, 2), start=1):
            error = values_of(*models) - found.truth
            out[method.name, count] = {
                group: 100.0 * float(np.sqrt((error[:, columns] ** 2).mean())) / spread
                for group, (columns, spread) in GROUPS.items()
            }
    return out


def worse_from(found: dict[float, dict[tuple[str, int], dict[str, float]]], count: int, groups: list[str]) -> str:
    """The smallest table error from which the sequential method is worse after so many passes."""
    for degrees, at in found.items():
        if any(at["sequential", count][g] > WORSE * at["scalar", count][g] for g in groups):
            return f"from ±{degrees:g}° on"
    return NOWHERE


def main(arguments: list[str]) -> int:
    """Print the table and the answer."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--short", action="store_true", help="fewer launches")
    launches = 200 if parser.parse_args(arguments).short else 2000
    print(f"rms errors, % of the spread before calibration; {launches} launches a row, 15 rests of 60 s with noise")
    print("table, mounting   method      pass " + "".join(f"{group:>13}" for group in GROUPS))
    found = {degrees: errors(degrees, launches) for degrees in TABLES}
    for degrees, at in found.items():
        for (method, count), row in at.items():
            print(f"±{degrees:<4g}°            {method:<11} {count}   " + "".join(f"{v:13.3f}" for v in row.values()))
    one, two = (worse_from(found, count, list(GROUPS)) for count in (1, 2))
    scalar, sequential = found[TABLES[-1]]["scalar", 1], found[TABLES[-1]]["sequential", 2]
    print(
        f"\nWhen is the scalar method better? After one pass {one}, after two {two}: where two passes are made, the "
        f"sequential method is as good on any finer table. At ±{TABLES[-1]:g}° one pass of the scalar method gives "
        f"accelerometer angles to {scalar['accel.axis']:.1f} %, two of the sequential one to "
        f"{sequential['accel.axis']:.1f} %."
    )
    holds = one == f"from ±{min(TABLES):g}° on" and two not in (one, NOWHERE)
    return 0 if holds and scalar["accel.axis"] < sequential["accel.axis"] else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
