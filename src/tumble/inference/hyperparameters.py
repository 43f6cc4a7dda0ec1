"""What the model does not know about itself: the hyperparameters φ, their priors, and how each enters the likelihood.

| φ | what | prior |
|---|---|---|
| ln σ of a component of scatter | rests | σ exponential, its mean m the noise it stands beside |
| | turns, velocities … | σ of density m/(m + σ)² |
| ln σ_b, ln τ_b of a kind | in-run bias, a Gauss–Markov process | log-normal about the grade's size and 300 s, ÷× 30 |
| p of a sensor | its scatter and in-run bias are exp(max(p, 0)) times those of its kind | N(0, ln 3) |
| p of a group | its size is exp(max(p, 0)) times the usual one | N(0, ln k) |

A component of scatter may be small, and is never excluded: no test decides whether it is there. That of
turns falls by a power: with an exponential one turns that are spoilt a hundred times their noise are so unlikely that
sound accelerometers take the blame. With λ = exp(max(p, 0))
half of the prior says that the sheet holds, the other half that it is too small by a factor of the order k: 2 for a
data sheet, 3 for a grade that is stated, 10 for one that is guessed where the next poorer grade has a larger
size. A prior is never narrowed.

`Hyperparameters` has all that the maximum (`tumble.inference.maximum`) and the integral (`tumble.inference.integral`)
need of φ; `table` makes those of a problem, in their order. Adding one is adding an entry there.
"""

from __future__ import annotations

from collections.abc import Container, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal, get_args

import numpy as np

from tumble.inference.likelihood import Problem
from tumble.inference.noise_components import (
    CORRELATION_TIME,
    OF_TURNS,
    SCATTER,
    SCATTER_WORDS,
    Components,
    Noise,
    typical_noise,
)
from tumble.inference.variables import at_two_temperatures, both_ways
from tumble.sensors.parameters import group_of, poorer, prior_sizes, variable_of
from tumble.units import Array, BoolArray, IntArray

IN_RUN_WITHIN = float(np.log(30.0) / 1.645)
"""Standard deviation of the logarithms of its size and of its correlation time about the usual ones: nine of ten are
within ÷× 30. It is wide enough for the process to take a drift, of which there is no group beside it: with ÷× 5 the
biases of a BMI160 that move by 4 mg in 237 s went into its scale factors."""
SHEET, STATED, GUESSED = 2.0, 3.0, 10.0
"""The factor by which a usual size may be too small where it is from a data sheet, from a grade that is stated, or from
one that is guessed."""
UNLIKE = 3.0
"""The same of the scatter and the in-run bias of a sensor, over those of the others of its kind."""
Place = Literal["scatter", "in-run", "time", "unlike", "group", "own group"]
PLACES: tuple[Place, ...] = get_args(Place)


@dataclass(frozen=True, kw_only=True, slots=True)
class Hyperparameter:
    """An element of φ: its name, unit and words; where it enters; its prior: about `usual`, SI, exponential or of
    density m/(m + σ)² (`scatter`), or normal in the logarithm with the standard deviation `within`."""

    name: str
    unit: str
    words: str
    place: Place
    usual: float
    within: float = 0.0
    members: slice | IntArray | None = None

    @staticmethod
    def of_size(name: str, words: str, place: Place, too_small: float, members: slice | IntArray) -> Hyperparameter:
        """p of a size λ = exp(max(p, 0)) that may be too small by a factor."""
        within = float(np.log(too_small))
        return Hyperparameter(name=name, unit="1", words=words, place=place, usual=1.0, within=within, members=members)

    @property
    def bounded(self) -> bool:
        """Whether values below zero are those at zero: p of λ = exp(max(p, 0))."""
        return self.place in ("unlike", "group", "own group")

    @property
    def centre(self) -> float:
        """The most likely φ by the prior alone."""
        return 0.0 if self.bounded else float(np.log(self.usual))

    def value(self, phi: float) -> float:
        """The quantity, SI."""
        return float(np.exp(max(phi, 0.0) if self.bounded else phi))


class Hyperparameters(tuple[Hyperparameter, ...]):
    """The elements of φ (D,) of a problem, in their order, and where all of them enter: matrices of 0 and 1, by
    component of scatter (D, c), by sensor for the sizes of in-run biases, their correlation times and sensors unlike
    the others (D, n), and by parameter for the sizes of groups in common (D, m) and of each session (D, q)."""

    by_scatter: Array
    by_in_run: Array
    by_time: Array
    by_unlike: Array
    by_group: Array
    by_own_group: Array

    @staticmethod
    def of(problem: Problem, entries: Iterable[Hyperparameter]) -> Hyperparameters:
        """Entries of a problem."""
        out = Hyperparameters(entries)
        widths = len(SCATTER), *(problem.sensors,) * 3, len(problem.instrument.names), len(problem.own_known)
        for place, width in zip(PLACES, widths, strict=True):
            by = np.zeros((len(out), width))
            for i, h in enumerate(out):
                if h.place == place:
                    by[i, SCATTER.index(h.name) if h.members is None else h.members] = 1.0
            setattr(out, f"by_{place.replace('-', '_').replace(' ', '_')}", by)
        return out

    @cached_property
    def bounded(self) -> BoolArray:
        """Which have values below zero that are those at zero (D,)."""
        return np.array([h.bounded for h in self], dtype=bool)

    @cached_property
    def centre(self) -> Array:
        """The most likely φ (D,) by the prior alone."""
        return np.array([h.centre for h in self])

    @cached_property
    def _priors(self) -> tuple[BoolArray, BoolArray, Array]:
        of_turns = np.array([h.name in OF_TURNS for h in self], dtype=bool)
        return np.asarray(self.by_scatter.any(axis=1)), of_turns, np.array([h.within or 1.0 for h in self])

    def prior(self, phi: Array) -> Array:
        """Of every element the logarithm of the density of φ, less a constant, its derivative, and the curvature of its
        negative (3, D)."""
        scatter, of_turns, within = self._priors
        z = (phi - self.centre) / within
        x = np.exp(np.where(scatter, z, 0.0))
        exponential, power = (
            (z - x, 1.0 - x, x),
            (z - 2.0 * np.log1p(x), (1.0 - x) / (1.0 + x), 2.0 * x / (1.0 + x) ** 2),
        )
        normal = -0.5 * z * z, -z / within, np.broadcast_to(within**-2, z.shape)
        return np.where(of_turns, power, np.where(scatter, exponential, normal))

    def sizes(self, phi: Array, by: Array) -> Array:
        """λ = exp(max(p, 0)) at φ of what a matrix of bounded elements says where they enter."""
        return np.asarray(np.exp(np.maximum(phi, 0.0) @ by))


def size_factors(
    grade: str, sizes: Mapping[str, float], sheet: Container[str] = (), *, guessed: bool
) -> dict[str, float]:
    """Factors by which the sizes of groups in instruments of a grade may be too small, by where each is from: a data
    `sheet`, or a grade that is stated or guessed. A guess between grades of equal sizes cannot be wrong by it."""
    worse = poorer(grade) if guessed else None
    in_worse = {} if worse is None else prior_sizes(worse)
    return {
        name: SHEET if name in sheet else GUESSED if in_worse.get(name, 0.0) > size else STATED
        for name, size in sizes.items()
    }


def table(problem: Problem, noise: Noise, seen: BoolArray) -> Hyperparameters:
    """The hyperparameters of a problem: the components of scatter that are `seen`, the in-run biases, and the groups
    whose size is by a prior."""
    observations, blocks, entries = problem.observations, problem.instrument.blocks, list[Hyperparameter]()

    # components of scatter: each stands beside the noise along its directions
    both = (noise.rest, *noise.rest_directions), (noise.turn, *noise.turn_directions)
    for number, (name, (unit, words)) in enumerate(SCATTER_WORDS.items()):
        beside = [np.zeros(0)]
        for covariance, Z, of in both if seen[number] else ():
            along, own = Z[:, :, of == number], (Z[:, :, of == number] ** 2).sum(axis=1)
            size = np.einsum("kaq,kab,kbq->kq", along, covariance, along)
            beside.append(size[own > 0.0] / own[own > 0.0] ** 2)
        if len(every := np.concatenate(beside)):
            usual = float(np.sqrt(np.median(every)))
            entries.append(Hyperparameter(name=name, unit=unit, words=words, place="scatter", usual=usual))

    # in-run biases of both kinds, and sensors whose bias wanders more than that of the others
    rests, first = observations.rests, 0
    covariances = (rests.accel_covariance, rests.gyro_covariance) if len(rests) > 1 else ()
    for block, covariance in zip(blocks, covariances, strict=False):
        kind, words = block.kind, "accelerometers" if block.kind == "accel" else "gyros"
        entries.append(
            Hyperparameter(
                name=f"{kind}_in_run",
                unit=SCATTER_WORDS[kind][0],
                words=f"in-run bias of the {words}",
                place="in-run",
                usual=observations.in_run.get(kind, typical_noise(covariance)),
                within=IN_RUN_WITHIN,
                members=slice(first, first + block.size),
            )
        )
        entries.append(
            Hyperparameter(
                name=f"{kind}_time",
                unit="s",
                words=f"correlation time of the in-run bias of the {words}",
                place="time",
                usual=CORRELATION_TIME,
                within=IN_RUN_WITHIN,
                members=slice(first, first + block.size),
            )
        )
        for c, sensor in enumerate(block.sensors if block.size > 1 else ()):
            said = f"scatter and in-run bias of {kind} {sensor} over those of the others"
            member = slice(first + c, first + c + 1)
            entries.append(Hyperparameter.of_size(f"{kind}.in_run.{sensor}", said, "unlike", UNLIKE, member))
        first += block.size

    # groups of parameters beyond the linear model. A lag multiplies others: a wide prior would let both grow.
    # Curvatures are not wider than usual where there are but two temperatures, nor is a hysteresis where they came one
    # way: what a bias has beyond its usual size would be taken for one.
    two, both_sides = at_two_temperatures(observations), both_ways(observations)
    held = {"lag", "temperature²" if two else "lag", "lag" if both_sides else "hysteresis"}
    common = {name: own for name, own in problem.instrument.members.items() if variable_of(name) not in held}
    sizes: tuple[tuple[Place, dict[str, slice]], ...] = ("group", common), ("own group", problem.own_members)
    for place, groups in sizes:
        for name, own in groups.items():
            with_it = [other for other in groups if group_of(other).sized_with == name]
            if group_of(name).sized_with in groups:
                continue
            members = np.concatenate([np.arange(g.start, g.stop) for g in (own, *(groups[other] for other in with_it))])
            factor, said = observations.too_small.get(name, STATED), f"size of {name} over the usual one"
            entries.append(Hyperparameter.of_size(name, said, place, factor, members))
    return Hyperparameters.of(problem, entries)


def components_of(entries: Hyperparameters, phi: Array) -> Components:
    """The components of variance at φ, or at a stack of them."""
    values = np.exp(phi)
    known: dict[str, Any] = dict.fromkeys(SCATTER, np.zeros(phi.shape[:-1])[()])
    known |= {h.name: values[..., i] for i, h in enumerate(entries) if h.place in ("scatter", "in-run", "time")}
    return Components(**known, unlike=entries.sizes(phi, entries.by_unlike))


def sized(problem: Problem, entries: Hyperparameters, phi: Array) -> Problem:
    """The problem with the priors of its groups as large as φ says, or a stack of them."""
    expected, usual = problem.measured[0], problem.usual[1]
    known = np.broadcast_to(usual, (*phi.shape[:-1], len(usual))).copy()
    known[..., 1:] *= entries.sizes(phi, entries.by_group)
    own = problem.own_usual * entries.sizes(phi, entries.by_own_group)
    return replace(problem, measured=(expected, known), own_known=own)
