"""Simulated observations whose biases are processes in time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from tumble.reduction.observations import Observations
from tumble.units import Array

Process = Callable[[np.random.Generator, Array], Array]
"""Values (N,) of unit size at times (N,), s."""


def gauss_markov(tau: float) -> Process:
    """A stationary chain of a correlation time, s; AR(1) where rests are equally far apart."""

    def of(rng: np.random.Generator, time: Array) -> Array:
        rho = np.exp(-np.diff(time, prepend=-np.inf) / tau)
        steps, out = np.sqrt(1.0 - rho**2) * rng.standard_normal(len(time)), np.zeros(len(time))
        for i in range(len(time)):
            out[i] = rho[i] * out[i - 1] + steps[i]
        return out

    return of


def random_walk(rng: np.random.Generator, time: Array) -> Array:
    """From nothing, of unit size at the end."""
    steps = np.sqrt(np.diff(time, prepend=time[0]) / np.ptp(time))
    return np.asarray(np.cumsum(steps * rng.standard_normal(len(time))))


def warm_up(seconds: float) -> Process:
    """An exponential of either sign that settles with a time constant."""

    def of(rng: np.random.Generator, time: Array) -> Array:
        return np.asarray(rng.choice([-1.0, 1.0]) * np.exp(-(time - time[0]) / seconds))

    return of


def drift(rng: np.random.Generator, time: Array) -> Array:
    """A straight line from −1 to 1, or back."""
    return np.asarray(rng.choice([-1.0, 1.0]) * np.linspace(-1.0, 1.0, len(time)))


def middles(observations: Observations) -> Array:
    """The times (N,), s, of the middles of the rests."""
    return 0.5 * (observations.rests.start + observations.rests.stop)


def biased(observations: Observations, accel: Array, gyro: Array) -> Observations:
    """The session of a triad with changes of its biases at the rests (N, 3), SI, and straight between them in the
    turns."""
    rests, turns, samples = observations.rests, observations.turns, observations.turn_samples
    changed = replace(rests, accel=rests.accel + accel, gyro=rests.gyro + gyro)
    if turns is None or samples is None:
        return replace(observations, rests=changed)
    rates, forces, dt = (each.copy() for each in samples.samples.read(0, samples.samples.count))
    for first, start, stop in zip(turns.first, samples.start, samples.stop, strict=True):
        share = ((np.cumsum(dt[start:stop]) - 0.5 * dt[start:stop]) / dt[start:stop].sum())[:, None]
        for readings, change in ((rates, gyro), (forces, accel)):
            readings[start:stop] += (1.0 - share) * change[first] + share * change[first + 1]
    other = type(samples.samples)()
    other.append(rates, forces, dt)
    return replace(observations, rests=changed, turn_samples=replace(samples, samples=other))
