"""Is u of the ellipsoid method honest for instruments that are not what their data sheet says?

The method takes groups of parameters beyond bias, scale factor and axes as nothing, and has their size in u: the usual
one, or that which the method `joint` finds in the same rests where they show that the usual one is too small.
Instruments are drawn with groups of so many times their usual size; errors over u of bias, scale factor and axes of the
accelerometers, with the usual sizes alone and with those that are found. Positions by hand and on a cube show sizes;
the 15 of a rough table do not (nine parameters, and hardly a residual that a group leaves).

    python studies/ellipsoid_sizes.py [--short] [--store]        40 instruments a line, seeds from 5000
"""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
from populations import ALONE, SETUPS
from scipy import special
from stored import shown, store

from tumble.inference.estimate import Estimate
from tumble.methods.ellipsoid import ellipsoid, estimate_of
from tumble.methods.ellipsoid_fit import EllipsoidFit, fit_ellipsoid
from tumble.reduction.observations import Observations
from tumble.simulation.observations import simulate_observations
from tumble.simulation.scenario import scenario_of
from tumble.units import Array

BY_ROUGH_TABLE = "rough table, accelerometers alone"
LINES = ALONE | {BY_ROUGH_TABLE: SETUPS["rough table"]}
TIMES = (1.0, 3.0, 10.0)
FIRST = 5000


def usual_alone(observations: Observations) -> Estimate:
    """The same with the usual sizes, whatever the rests show."""
    rests, site = observations.rests, observations.site
    found = fit_ellipsoid(
        rests.accel, modulus=site.gravity, modulus_u=site.gravity_u, covariance=rests.accel_covariance,
        block=observations.accel_block,
    )  # fmt: skip
    assert isinstance(found, EllipsoidFit)
    return estimate_of(found, observations)


def errors(name: str, times: float, seed: int) -> list[tuple[Array, Array]]:
    """Of an instrument, with the usual sizes and with those that are found: errors over u (9,), and whether the
    intervals of 95 % contain them."""
    setup, rng = LINES[name], np.random.default_rng(seed)
    scenario = scenario_of(replace(setup, further={n: times * size for n, size in setup.further.items()}), rng)
    observations = replace(simulate_observations(scenario, rng), usual=setup.further).of_accelerometers()
    out = []
    for estimate in (usual_alone(observations), ellipsoid(observations)):
        truth = np.array([scenario.truth[parameter] for parameter in estimate.names[:9]])
        assert estimate.degrees is not None
        z = (estimate.values[:9] - truth) / estimate.u[:9]
        out.append((z, np.abs(z) <= special.stdtrit(estimate.degrees[:9], 0.975)))
    return out


def main() -> int:
    """Print the table, and whether u holds where sizes show."""
    short = "--short" in sys.argv
    count, times = (4, TIMES[:2]) if short else (40, TIMES)
    rows = [["positions", "times", "sizes", "rms", "covered", "beyond 3 u", "largest"]]
    holds = True
    for name in list(LINES)[:1] if short else LINES:
        for size in times:
            runs = [errors(name, size, seed) for seed in range(FIRST, FIRST + count)]
            for which, said in enumerate(("usual", "as found")):
                z, inside = (np.concatenate([run[which][part] for run in runs]) for part in (0, 1))
                rms, covered = float(np.sqrt(np.mean(z**2))), float(np.mean(inside))
                beyond = f"{100.0 * np.mean(np.abs(z) > 3.0):.1f} %"
                positions = name.removesuffix(", accelerometers alone")
                cells = [f"{rms:.2f}", f"{100.0 * covered:.1f} %", beyond, f"{np.abs(z).max():.1f}"]
                rows.append([positions, f"{size:g}", said, *cells])
                if said == "as found" and name != BY_ROUGH_TABLE:
                    holds &= rms < (1.6 if short else 1.15 if size <= 3.0 else 1.4)
    print(shown(rows))
    if "--store" in sys.argv and not short:
        store("ellipsoid_sizes", {"sizes": rows}, seed=f"from {FIRST}", N=count)
    print(f"Is u of the ellipsoid method honest where rests show how large groups are? {'Yes' if holds else 'No'}")
    return 0 if holds else 1


if __name__ == "__main__":
    sys.exit(main())
