"""Is anything gained if the errors of the table are estimated together with the accelerometers?

Every rest then has two unknowns of its own, the tilts t of the programmed vertical u₀ (the azimuth is in no reading),
and all three readings are used:

    ŵ = S g u + δw + noise,   u = (u₀ + B t)/|u₀ + B t|,   B across u₀

9 + 2 N unknowns in 3 N equations leave N − 9, which is what the norm |S⁻¹(ŵ − δw)| = g of the scalar method leaves
with 9 unknowns in N equations: to eliminate the tilts is to take the one direction they do not reach. Both are
iterated to convergence, beside the sequential method, on the rests of rough-table with noise, table and mounting off
by up to 1°. Rms errors are in % of the spread before calibration. Last, how exact the table would have to be for its
positions to tell anything: standard uncertainties with the tilts known beforehand to some uncertainty.

    python studies/table_errors_as_unknowns.py [--short]

The answer is printed last.
"""

from __future__ import annotations

import argparse
import math
import sys
import timeit
from collections.abc import Callable
from dataclasses import replace

import formulas_against_simulation as simulation
import numpy as np
from accuracy_formulas import accelerometer_errors
from paper_device import SETUP

from tumble.methods.paper.accelerometers import by_vector as sequential
from tumble.methods.paper.accelerometers import scalar_fit
from tumble.rotation import tangent_basis, unit_vector
from tumble.sensors.grades import NoiseModel
from tumble.sensors.model import ACCEL_ANGLES, PERFECT_TRIAD, SensorModel, triad_model, triad_parameters
from tumble.units import ARCSEC, DEGREE, Array

GROUPS = {
    "bias": (slice(0, 3), SETUP.accel.bias),
    "scale": (slice(3, 6), SETUP.accel.scale),
    "axes": (slice(6, 9), SETUP.accel.axis),
}
CONVERGED = 4
"""Passes after which nothing changes any more."""
KNOWN = {"1°": DEGREE, "1′": 60.0 * ARCSEC, "1″": ARCSEC, "0.1″": 0.1 * ARCSEC}
"""Standard uncertainties of the tilts beforehand."""

Pass = Callable[[Array, Array], SensorModel]
"""Stages 1 and 2: the model of readings (T, N, 3) at rests with nominal verticals (N, 3)."""


def scalar_pass(readings: Array, nominal: Array) -> SensorModel:
    """The scalar method with the estimated orientation."""
    del nominal
    return scalar_fit(readings, unit_vector(readings), np.array(SETUP.gravity))


def vector(readings: Array, nominal: Array) -> SensorModel:
    """The sequential vector method."""
    return sequential(readings, nominal, np.array(SETUP.gravity))


def iterated(method: Pass, readings: Array, nominal: Array, passes: int) -> SensorModel:
    """The model after so many passes, each on readings compensated by those before."""
    model = PERFECT_TRIAD
    for _ in range(passes):
        model = model.composed(method(model.apply(readings), nominal))
    return model


def with_tilts(readings: Array, nominal: Array, passes: int) -> tuple[SensorModel, Array]:
    """The model and the tilts (T, N, 2), rad, after so many Gauss-Newton steps from perfect sensors and the programmed
    verticals: every step solves for the errors left in compensated readings, in units of g, and for all tilts."""
    across = np.swapaxes(tangent_basis(nominal), -1, -2)
    model, tilts = PERFECT_TRIAD, np.zeros((*readings.shape[:-1], 2))
    for _ in range(passes):
        leaning = nominal + (across @ tilts[..., None])[..., 0]
        u = unit_vector(leaning)
        residual = model.apply(readings) / SETUP.gravity - u
        by_tilt = across - u[..., None] * (u[..., None, :] @ across)
        by_tilt = by_tilt / np.linalg.norm(leaning, axis=-1)[..., None, None]
        x = (np.linalg.pinv(rows(u, by_tilt)) @ residual.reshape(len(residual), -1, 1))[..., 0]
        found = triad_model(SETUP.gravity * x[:, :3], x[:, 3:6], x[:, 6:9])
        model, tilts = model.composed(found), tilts + x[:, 9:].reshape(tilts.shape)
    return model, tilts


def rows(u: Array, by_tilt: Array) -> Array:
    """Derivatives (T, 3 N, 9 + 2 N) of the readings, in g, with respect to b, k, γ and the tilts of every rest, from
    verticals (T, N, 3) and their derivatives (T, N, 3, 2)."""
    T, N, _ = u.shape
    tilts = np.zeros((T, N, 3, N, 2))
    at = np.arange(N)
    tilts[:, at, :, at] = np.moveaxis(by_tilt, 1, 0)
    sensors = np.moveaxis(accelerometer_errors(np.eye(9)[:, None, None], u), 0, -1)
    return np.concatenate([sensors.reshape(T, 3 * N, 9), tilts.reshape(T, 3 * N, 2 * N)], axis=-1)


def values_of(model: SensorModel) -> Array:
    """Parameters (T, 9) of models."""
    bias, scale, angles = triad_parameters(model)
    return np.concatenate([bias, scale, angles[..., ACCEL_ANGLES]], axis=-1)


def uncertainties(nominal: Array, noise: float, tilt: float) -> Array:
    """Standard uncertainties (9,) of b (in g), k, γ from noise of mean readings (in g) and tilts known to `tilt`."""
    by_tilt = np.swapaxes(tangent_basis(nominal), -1, -2)
    A = rows(nominal[None], by_tilt[None])[0] / noise
    known = np.diag([0.0] * 9 + [tilt**-2] * 2 * len(nominal))
    return np.sqrt(np.diag(np.linalg.inv(A.T @ A + known))[:9])


def main(arguments: list[str]) -> int:
    """Print the tables and the answer."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--short", action="store_true", help="fewer launches")
    launches = 100 if parser.parse_args(arguments).short else 2000
    white = SETUP.noise.accel_white
    setup = replace(SETUP, noise=NoiseModel(accel_white=white), rest=60.0)
    found = simulation.simulate(setup, launches, np.random.default_rng(31))
    readings, nominal = found.accel, found.nominal[:, 1]
    solvers: dict[str, Callable[[], SensorModel]] = {
        "sequential, 1 pass": lambda: iterated(vector, readings, nominal, 1),
        "sequential, 2 passes": lambda: iterated(vector, readings, nominal, 2),
        "scalar, 1 pass": lambda: iterated(scalar_pass, readings, nominal, 1),
        "scalar, converged": lambda: iterated(scalar_pass, readings, nominal, CONVERGED),
        "tilts as unknowns, 1 step": lambda: with_tilts(readings, nominal, 1)[0],
        "tilts as unknowns, 2 steps": lambda: with_tilts(readings, nominal, 2)[0],
        "tilts as unknowns, converged": lambda: with_tilts(readings, nominal, CONVERGED)[0],
    }
    values = {name: values_of(solver()) for name, solver in solvers.items()}
    seconds = {name: min(timeit.repeat(solver, number=1, repeat=3)) for name, solver in solvers.items()}
    unit = seconds["scalar, converged"]
    print(f"rms errors, % of the spread before calibration, and times; {launches} launches, 15 rests of 60 s")
    print(f"{'':<30}" + "".join(f"{group:>10}" for group in GROUPS) + f"{'time':>9}")
    for name, X in values.items():
        error = X - found.truth[:, :9]
        shown = [100.0 * np.sqrt((error[:, c] ** 2).mean()) / spread for c, spread in GROUPS.values()]
        print(f"{name:<30}" + "".join(f"{v:10.3f}" for v in shown) + f"{seconds[name] / unit:9.2f}")
    error = values["scalar, converged"] - found.truth[:, :9]
    apart = values["tilts as unknowns, converged"] - values["scalar, converged"]
    parts = np.sqrt((apart**2).mean(axis=0) / (error**2).mean(axis=0))
    tilts = with_tilts(readings, nominal, CONVERGED)[1]
    noise = white / math.sqrt(setup.rest) / setup.gravity
    free = uncertainties(nominal, noise, 1e3)
    gained = {name: float((uncertainties(nominal, noise, tilt) / free).mean()) for name, tilt in KNOWN.items()}
    print(f"\nconverged solutions differ by at most {parts.max():.1e} of the rms error (rms, worst parameter)")
    print(f"tilts found: rms {np.sqrt((tilts**2).mean()) / DEGREE:.2f}°")
    print("uncertainties with the tilts known beforehand, mean ratio to those with unknown tilts")
    print("  " + ", ".join(f"to {name}: {ratio:.3f}" for name, ratio in gained.items()))
    same = parts.max() < 1e-3
    verdict = "No: converged, it is the scalar method" if same else "Yes: it is not the scalar method"
    cost = seconds["tilts as unknowns, converged"] / unit
    print(
        f"\nIs anything gained by the tilts as unknowns? {verdict}, whose norm is the one "
        f"reading in three that the tilts do not reach; the two differ by {parts.max():.0e} of the error, it takes "
        f"{cost:.0f} times as long. A table adds something only if its positions are known about as well as the "
        f"readings tell them, here to {noise / ARCSEC:.1f}″: known to 1″ they bring the uncertainties to "
        f"{gained['1″']:.2f} of what they are."
    )
    return 0 if same and gained["1°"] > 0.99 and gained["1″"] < 0.9 else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
