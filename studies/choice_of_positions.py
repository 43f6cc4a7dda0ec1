"""Does the choice of positions by maximal sensitivity of the measured moduli lead to the paper's nine?

At rest |ŵ| tells the nine accelerometer parameters by a row h(u), Eq. (13), of the vertical u in the body. For every
parameter the positions where its coefficient |h_j(u)| is largest are searched over the whole sphere, from many
starts. One position is then taken for each of the nine parameters, and every set that can be taken so is judged by
its matrix H (9, 9): rank, condition, and the sum of the variances tr (HᵀH)⁻¹ of unit noise. Beside the best of them
the paper's nine, nine positions that are best for all parameters jointly (a descent on tr (HᵀH)⁻¹), the 18 faces and
edges of a cube, and the 15 of rough-table; every set on a table and in a mounting that are off by up to 1°, by the
scalar method with the estimated orientation, two passes, 60 s a rest. Rms errors in % of the spread before
calibration; bench time is that of the rests, as a ratio to the nine.

    python studies/choice_of_positions.py [--short]

The answer is printed last.
"""

from __future__ import annotations

import argparse
import math
import sys
from itertools import product

import numpy as np
from paper_device import SETUP
from scipy.optimize import minimize

from tumble.methods.paper.accelerometers import scalar_fit, scalar_rows
from tumble.programme.positions import programme
from tumble.rotation import rotation_matrix, unit_vector
from tumble.sensors.model import ACCEL_ANGLES, PERFECT_TRIAD, triad_model, triad_parameters
from tumble.units import DEGREE, Array

PARAMETERS = ("b_x", "b_y", "b_z", "k_x", "k_y", "k_z", "γ_yx", "γ_zx", "γ_zy")
SPREAD = np.repeat([SETUP.accel.bias, SETUP.accel.scale, SETUP.accel.axis], 3)
SAME = 1e-4
"""Directions that differ by less are one."""
REST = 60.0


# -------------------- the choice --------------------


def most_sensitive(j: int, rng: np.random.Generator) -> Array:
    """Directions (M, 3) in which |h_j| has its largest value."""

    def insensitivity(x: Array) -> float:
        return -abs(float(scalar_rows(unit_vector(x))[j]))

    found = [minimize(insensitivity, rng.standard_normal(3), tol=1e-12) for _ in range(60)]
    best = min(f.fun for f in found)
    kept: list[Array] = []
    for f in found:
        u = unit_vector(f.x)
        if f.fun < best + SAME**2 and all(np.linalg.norm(u - other) > 1e2 * SAME for other in kept):
            kept.append(u.round(3))
    return unit_vector(np.array(kept))


def sets_of_nine(choices: list[Array]) -> Array:
    """Sets (S, 9, 3) of one position a parameter: biases and scale factors are most sensitive in the same positions,
    so that one of them takes the axis up and the other the axis down."""
    standing = [u for pair in choices[:3] for u in pair]
    return np.array([[*standing, *oblique] for oblique in product(*choices[6:])])


def variance(u: Array) -> float:
    """tr (HᵀH)⁻¹ of positions (N, 3)."""
    singular = np.linalg.svd(scalar_rows(u), compute_uv=False)
    return float((1.0 / np.maximum(singular, 1e-9) ** 2).sum())


def described(u: Array) -> str:
    """Which axes an oblique position has above and below the horizon: X/Y is X above, Y below."""
    above, below = ("".join(axis for axis, v in zip("XYZ", sign * u, strict=True) if v > SAME) for sign in (1.0, -1.0))
    return f"{above or '–'}/{below or '–'}"


def jointly_best(starts: int, rng: np.random.Generator) -> Array:
    """Nine positions (9, 3) with the smallest sum of variances."""

    def size(x: Array) -> float:
        return math.log(variance(unit_vector(x.reshape(9, 3))))

    found = [minimize(size, rng.standard_normal(27)) for _ in range(starts)]
    return unit_vector(min(found, key=lambda f: f.fun).x.reshape(9, 3))


def cube() -> Array:
    """Six faces and twelve edges (18, 3)."""
    every = np.array(list(product((-1.0, 0.0, 1.0), repeat=3)))
    return unit_vector(every[np.isin(np.abs(every).sum(axis=1), (1, 2))])


# -------------------- what it is worth --------------------


def errors(nominal: Array, launches: int) -> Array:
    """Rms errors (3,) of biases, scale factors and angles by the scalar method in these positions, % of the spread."""
    rng = np.random.default_rng(41)
    truth = SPREAD * rng.standard_normal((launches, 9))
    table = rotation_matrix(DEGREE * rng.uniform(-1.0, 1.0, (launches, len(nominal), 3)))
    mounting = rotation_matrix(DEGREE * rng.uniform(-1.0, 1.0, (launches, 1, 3)))
    u = (table @ mounting @ nominal[..., None])[..., 0]
    model = triad_model(truth[:, :3], truth[:, 3:6], truth[:, 6:])
    readings = SETUP.gravity * u @ np.swapaxes(model.matrix, -1, -2) + model.bias[:, None]
    readings += SETUP.noise.accel_white / math.sqrt(REST) * rng.standard_normal(readings.shape)
    found = PERFECT_TRIAD
    for _ in range(2):
        w = found.apply(readings)
        found = found.composed(scalar_fit(w, unit_vector(w), np.array(SETUP.gravity)))
    bias, scale, angles = triad_parameters(found)
    error = np.concatenate([bias, scale, angles[..., ACCEL_ANGLES]], axis=-1) - truth
    return 100.0 * np.sqrt(((error / SPREAD) ** 2).mean(axis=0).reshape(3, 3).mean(axis=1))


def condition(u: Array) -> float:
    """Condition number of H."""
    return float(np.linalg.cond(scalar_rows(u)))


def among(u: Array, sets: Array) -> bool:
    """Whether positions (9, 3) are one of the sets (S, 9, 3), in any order."""
    found = np.linalg.norm(sets[:, :, None] - u, axis=-1) < SAME
    return bool(found.any(axis=1).all(axis=1).any())


def main(arguments: list[str]) -> int:
    """Choose, compare, answer."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--short", action="store_true", help="fewer launches and starts")
    short = parser.parse_args(arguments).short
    launches, starts = (100, 3) if short else (2000, 30)
    rng = np.random.default_rng(4)
    choices = [most_sensitive(j, rng) for j in range(9)]
    print("largest sensitivity of |ŵ|/g, and where")
    for j, (name, u) in enumerate(zip(PARAMETERS, choices, strict=True)):
        shown = "  ".join("(" + " ".join(f"{v:+z.2f}" for v in direction) + ")" for direction in u)
        print(f"  {name:<5}{np.abs(scalar_rows(u)[:, j]).max():5.2f}   {shown}")
    sets = sets_of_nine(choices)
    ranks = np.linalg.matrix_rank(scalar_rows(sets))
    conditions = np.array([condition(u) for u in sets])
    traces = np.array([variance(u) for u in sets])
    paper = np.array([position.vertical_b for position in programme("nine").positions])
    contained = among(paper, sets)
    print(
        f"\n{len(sets)} sets of one position a parameter: rank {ranks.min()}, tr (HᵀH)⁻¹ {traces.min():.2f} to", end=" "
    )
    print(f"{traces.max():.2f}; the paper's nine {'are one of them' if contained else 'are none of them'}")
    for value, count in zip(*np.unique(conditions.round(3), return_counts=True), strict=True):
        example = sets[np.flatnonzero(np.abs(conditions - value) < 1e-3)[0]][6:]
        print(f"  condition {value:.2f}: {count} sets, such as {', '.join(map(described, example))}")
    joint = jointly_best(starts, rng)
    listed = {
        "one each, best condition": sets[np.argmin(conditions)],
        "the paper's nine": paper,
        "nine jointly best": joint,
        "18, faces and edges": cube(),
        "15 of rough-table": np.array([position.vertical_b for position in programme("rough-table").positions]),
    }
    print("\n                          rests  bench   tr·N/9  condition   errors, %: bias   scale    axes")
    for name, u in listed.items():
        shown = "".join(f"{e:8.3f}" for e in errors(u, launches))
        each = f"{len(u):>5} {len(u) / 9:6.2f} {variance(u) * len(u) / 9:8.2f} {condition(u):9.2f}"
        print(f"  {name:<24}{each}          {shown}")
    nine, jointly = errors(paper, launches), errors(joint, launches)
    print(
        f"\nDoes maximal sensitivity lead to the paper's nine? {'Yes' if contained else 'No'}, up to signs: biases and "
        "scale factors want the six faces, every angle any of four positions at 45°. The variances of all "
        f"{len(sets)} choices are the same; the condition is {conditions.min():.2f} to {conditions.max():.2f}, the "
        f"paper's {condition(paper):.2f}. For all parameters together there is a better nine, of no special "
        f"directions: tr (HᵀH)⁻¹ {variance(joint):.1f} for {variance(paper):.1f}, and it errs by {jointly[2]:.1f} for "
        f"{nine[2]:.1f} % in the angles, by {jointly[0]:.2f} for {nine[0]:.2f} % in the biases, but by "
        f"{jointly[1]:.2f} for {nine[1]:.2f} % in the scale factors."
    )
    return 0 if contained and variance(joint) < 0.5 * variance(paper) and np.ptp(traces) < 1e-3 else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
