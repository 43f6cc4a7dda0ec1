"""The grade of the accelerometers behind a table of readings, which has no noise in time to tell it by.

Guessed is the poorest of two. By the biases: the poorest grade whose three usual biases are so small by chance in no
less than CHANCE of its instruments. By the residuals e of the fit, the best grade in which they are so large in no
less,

    e = (I − A A⁺)(n + B φ),   Σe² ~ a χ²_ν,  a ν = tr C,  2 a² ν = 2 tr C²,   C = σ²(I − A A⁺) + L Σ_φ Lᵀ

σ being the grade's in-run instability, Σ_φ the usual sizes of what it has beyond the linear model and L what this
leaves in the residuals (Satterthwaite). Noise of the reading itself makes the guess poorer, and u larger, never
smaller.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import special

from tumble.diagnosis.linear_model import left_out_of
from tumble.methods.ellipsoid_fit import EllipsoidFit
from tumble.reduction.observations import Observations
from tumble.sensors.grades import GRADES
from tumble.sensors.parameters import FURTHER, usual_sizes
from tumble.units import Array

CHANCE = 0.01

AT_REST = tuple(
    group.name
    for group in FURTHER
    if group.kind == "accel" and (group.regressors is not None or group.variable == "time")
)
"""The groups of the accelerometers that a table of readings may have in it: what it says nothing of, a temperature or a
motion, is not known to have been there."""


def guessed_grade(found: EllipsoidFit, rests: Observations) -> tuple[str, str]:
    """The grade, and what it is guessed from, in words."""
    order = [*GRADES]
    best, *_, poorest = order
    small = (name for name in order[::-1] if _chance(found.values[:3] ** 2, GRADES[name].accel.bias) > CHANCE)
    large = (name for name in order if _explained(found, rests, name) > CHANCE)
    by_biases, by_residuals = next(small, best), next(large, poorest)
    if order.index(by_biases) >= order.index(by_residuals):
        return by_biases, ", guessed from the biases; state another with --grade"
    return by_residuals, ", guessed from the residuals; state another with --grade"


def residual_of(rests: Observations, grade: str) -> Array:
    """How large the residual of each reading (N,), m/s², is by the in-run instability of a grade and by the groups of
    which the observations know the size."""
    beyond = left_out_of(rests)
    square = ((beyond.leaves * beyond.usual) ** 2).sum(axis=1)
    return np.asarray(np.sqrt(GRADES[grade].noise.accel_instability ** 2 + square))


def _chance(squares: Array, sigma: float) -> float:
    """How often values of this standard deviation are as small."""
    return float(special.chdtr(len(squares), squares.sum() / sigma**2))


def _explained(found: EllipsoidFit, rests: Observations, grade: str) -> float:
    """How often the residuals of an instrument of a grade are as large."""
    if found.degrees == 0:
        return 1.0
    known = {name: size for name, size in usual_sizes(grade).items() if name in AT_REST}
    beyond = left_out_of(replace(rests, usual=known))
    noise, left = GRADES[grade].noise.accel_instability ** 2, beyond.leaves * beyond.usual
    own = left.T @ left
    trace = noise * found.degrees + np.trace(own)
    square = noise**2 * found.degrees + 2.0 * noise * np.trace(own) + float((own**2).sum())
    degrees = trace**2 / square
    seen = float((found.residual[found.used] ** 2).sum())
    return float(special.chdtrc(degrees, degrees * seen / trace))
