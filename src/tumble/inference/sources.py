"""Sources of uncertainty by name: their words, whether of type A or B, and the covariance of an estimate by source."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from tumble.units import Array

Evaluation = Literal["A", "B"]
"""Of the standard uncertainty of a source: by statistics of this recording, or otherwise."""
WORDS: Mapping[str, tuple[str, Evaluation]] = {
    "accel.noise": ("noise of the accelerometers within rests", "A"),
    "gyro.noise": ("noise of the gyros within rests", "A"),
    "turn.gyro.noise": ("noise of the gyros in turns", "A"),
    "turn.accel.noise": ("noise of the accelerometers in turns", "A"),
    "earth": ("rate of the Earth where the latitude is not known", "B"),
    "attitude": ("attitudes of the programme", "B"),
    "accel.scatter": ("scatter of the accelerometers from rest to rest", "A"),
    "gyro.scatter": ("scatter of the gyros from rest to rest", "A"),
    "turn.scatter": ("scatter of the rotations of turns", "A"),
    "velocity.scatter": ("scatter of the velocities of turns", "A"),
    "apart.scatter": ("scatter of what spare gyros say of turns", "A"),
    "jumps.scatter": ("jumps of force between samples", "A"),
    "aliased.scatter": ("jumps of rate between samples", "A"),
    "aliased_apart.scatter": ("jumps of rate between samples of spare gyros", "A"),
    "accel.in_run": ("in-run bias of the accelerometers", "A"),
    "gyro.in_run": ("in-run bias of the gyros", "A"),
    "fit": ("noise and scatter, by the residuals of the fit", "A"),
    "mag.fit": ("noise and scatter of the magnetometer, by the residuals of its fit", "A"),
    "within launches": ("what each launch knows of itself", "A"),
    "launches": ("changes from launch to launch", "A"),
    "gravity": ("gravity of the site", "B"),
    "priors": ("usual sizes of groups, in common", "B"),
    "prior": ("what was known beforehand of all parameters together", "B"),
    "prior.linear": ("limits of bias, scale factor and axis angles", "B"),
    "arrays": ("readings of the array in motion", "A"),
    "hyperparameters": ("what the model does not know of itself: scatter, in-run biases, sizes of groups", "A"),
    "rounding": ("rounding of readings to steps", "B"),
    "clock": ("time base of the log", "B"),
    "lag": ("lag of the thermometer", "A"),
    "case": ("placements on the faces of the case", "A"),
}
"""Of every source: in words, and how its uncertainty is evaluated. Those of groups of parameters are `prior.GROUP`."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Source:
    """A source of uncertainty: its name and words, type A or B, its standard uncertainty with SI unit, None where it is
    of several quantities, and degrees of freedom behind that, None where they are many."""

    name: str
    words: str
    type: Evaluation
    u: float | None = None
    unit: str = ""
    dof: float | None = None


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class UncertaintyBudget:
    """The covariance of an estimate by `sources` (S): `covariances` (S, m, m) of the parameters, SI, whose sum it
    is."""

    sources: tuple[Source, ...]
    covariances: Array

    def carried(self, jacobian: Array) -> UncertaintyBudget:
        """The same of functions of the parameters, by their `jacobian` (q, m)."""
        return replace(self, covariances=jacobian @ self.covariances @ jacobian.T)

    def beside(self, source: Source, covariance: Array) -> UncertaintyBudget:
        """With another source, of this covariance (m, m); the same where it is nothing."""
        if not covariance.any():
            return self
        covariances = np.concatenate([self.covariances, covariance[None]])
        return UncertaintyBudget(sources=(*self.sources, source), covariances=covariances)


def source(name: str, u: float | None = None, unit: str = "", dof: float | None = None) -> Source:
    """The source of a name."""
    group = name.removeprefix("prior.")
    words, evaluation = WORDS.get(name, (f"usual size of {group}", "B"))
    return Source(name=name, words=words, type=evaluation, u=u, unit=unit, dof=dof)


def of_fit(covariance: Array, by_gravity: Array, gravity_u: float, degrees: float) -> UncertaintyBudget:
    """The budget of a fit whose residuals say how uncertain it is: what one standard uncertainty of gravity changes in
    the parameters (m,), and the rest of their covariance (m, m)."""
    of_gravity = np.outer(by_gravity, by_gravity)
    every = UncertaintyBudget(
        sources=(source("fit", dof=degrees if np.isfinite(degrees) else None),),
        covariances=(covariance - of_gravity)[None],
    )
    return every.beside(source("gravity", gravity_u, "m/s^2"), of_gravity)
