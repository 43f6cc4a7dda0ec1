"""Priors that are as wide as the data ask for.

Groups beyond the linear model are all kept, each with a prior of its usual size (dynamics method, A4). A prior that the
data exceed is widened, never narrowed:

    λ² ← max(1, mean of (ĉ² + Var ĉ)/s²),   s ← λ s   until it settles                                            (A4)

Curvatures are not widened where there are but two temperatures: rests have b + t₂ x² alone there, x² the same at both,
and what a bias, or anything that goes with it, has beyond its usual size would be taken for one.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tumble.estimation.elimination import fold
from tumble.estimation.likelihood import Problem
from tumble.estimation.linearisation import priors, with_priors
from tumble.estimation.methods.joint.iteration import At
from tumble.estimation.step import Told, joined
from tumble.estimation.variables import at_two_temperatures, both_ways
from tumble.sensors.parameters import Variable, variable_of
from tumble.units import Array

WIDENING_STEPS = 50
WIDENED = 1.01  # λ of a step that counts as settled


def has_groups(problem: Problem) -> bool:
    """Whether there are parameters beyond the linear model, whose priors may be too narrow."""
    return bool(problem.instrument.further) or problem.own is not None


def with_wider_priors(problem: Problem, at: At, told: Told) -> Problem:
    """The problem with the priors of groups widened that the data exceed (A4), at one linearisation, of what its
    rows have told; the same where none is."""
    if not has_groups(problem):
        return problem
    members, own_members = _widened(problem), _own_members(problem)
    expected, u = problem.measured
    now, own = u.copy(), problem.own_known.copy()
    further = np.arange(len(u)) > problem.instrument.linear_count
    told, q = replace(told, sessions=told.sessions.copy()), len(own)
    fixed = replace(problem, measured=(expected, np.where(further, np.inf, u)))
    fold(priors(fixed, at.point, at.about), told.sessions[0, q:, q:])
    for _ in range(WIDENING_STEPS):
        trial = replace(problem, measured=(expected, np.where(further, now, np.inf)), own_known=own)
        found = joined(trial, with_priors(at.rows, trial, at.point), told)
        values, variances = at.point.values + found.parameters[1:], found.variances
        most = 1.0
        for group in members:
            most = max(most, _widen(now[1:], group, (values - expected[1:]) ** 2 + variances[0, q + 1 :]))
        own_square = ((at.point.own + found.own) ** 2 + variances[:, :q]).mean(axis=0)
        for group in own_members:
            most = max(most, _widen(own, group, own_square))
        if most < WIDENED:
            break
    if np.all(now <= u * WIDENED) and np.all(own <= problem.own_known * WIDENED):
        return problem
    return replace(problem, measured=(expected, now), own_known=own)


def _widened(problem: Problem) -> list[slice]:
    """Where the common groups stand whose priors may be widened."""
    held: set[Variable | None] = {"lag"}  # it multiplies others: a wide prior would let both grow
    if at_two_temperatures(problem.observations):
        held.add("temperature²")
    if not both_ways(problem.observations):
        held.add("hysteresis")
    return [of for name, of in problem.instrument.members.items() if variable_of(name) not in held]


def _widen(known: Array, group: slice, square: Array) -> float:
    """Widen the priors of a group, in place, that the squares of its parameters and variances exceed; by how much."""
    widened = float(np.sqrt(np.mean(square[group] / known[group] ** 2)))
    if widened > 1.0:
        known[group] *= widened
    return max(widened, 1.0)


def _own_members(problem: Problem) -> list[slice]:
    """Where the groups stand of what each session has of its own."""
    if problem.own is None:
        return []
    first = problem.own.linear_count
    return [slice(of.start - first, of.stop - first) for of in problem.own.members.values()]
