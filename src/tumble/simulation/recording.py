"""Samples of the log of a scenario, exact to rounding.

The Earth rotates throughout. For a move by θ about n, from the attitude L₀ (body → geographic),

    L(t) = exp([nθ×]) L₀,   ω = n θ̇ + Ω,   f = (g + v) e_U        geographic frame; v: vibration, vertical

A sample is the mean of the readings over the interval that ends at its time stamp, or earlier by the delay of an
accelerometer, for forces Lᵀf and rates Lᵀω in the body, with R = exp([nθ×]),

    Lᵀ = L₀ᵀ Rᵀ,   Rᵀ = nnᵀ + cos θ (I − nnᵀ) − sin θ [n×]

and f + [ω̇×]r + [ω×]²r at an accelerometer with lever arm r. The means are Gauss–Legendre sums over panels that end
where a sample ends or θ(t) is not smooth; moves need not begin or end with a sample. At rest, parameters that change
with temperature have the value in the middle of the sample.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, fields

import numpy as np

from tumble.earth import earth_rate
from tumble.errors import InputError
from tumble.planning.itinerary import Itinerary
from tumble.rotation import UP, skew
from tumble.sensors.model import Block
from tumble.simulation.scenario import Scenario, itinerary
from tumble.simulation.sensors import NODES, WEIGHTS, SimulatedBlock, harmonic_coefficients, harmonics
from tumble.units import Array

_PANELS_PER_CYCLE = 4.0
_MAX_SAMPLES = 30_000_000  # eight hours at 1 kHz, 1.5 GB
_CHUNK = 1 << 13  # samples made at a time
_ROUNDING = 1e-6  # of a sample: a rest that ends with a sample to rounding includes it


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Recording(Itinerary):
    """A simulated log with its true itinerary."""

    time: Array  # (N,), s
    accel: Array  # (N, n), m/s²
    gyro: Array  # (N, n), rad/s


def record(scenario: Scenario, rng: np.random.Generator) -> Recording:
    """Record a scenario in memory; attitudes and times do not depend on the noise. Each accelerometer may have a delay.

    Raises InputError if the scenario is impossible or too long."""
    geometry, noise = rng.spawn(2)
    course, fs = itinerary(scenario, geometry), scenario.setup.sample_rate
    samples = float(course.rests[-1, 1]) * float(fs)
    if not samples <= _MAX_SAMPLES:
        raise InputError(f"session: expected at most {_MAX_SAMPLES:g} samples, found {samples:.3g}")
    N = math.floor(course.rests[-1, 1] * fs + _ROUNDING)
    accel_noise, gyro_noise = noise.spawn(2)
    delays, which = np.unique(scenario.instrument.delays(scenario.values), return_inverse=True)
    streams = [accel_noise] if len(delays) == 1 else accel_noise.spawn(len(delays))
    accel = np.empty((scenario.accel.size, N))
    for k, (delay, stream) in enumerate(zip(delays.tolist(), streams, strict=True)):
        accel[which == k] = _block_readings(scenario.accel, scenario, course, stream, delay)[which == k]
    gyro = _block_readings(scenario.gyro, scenario, course, gyro_noise, 0.0)
    truth = {field.name: getattr(course, field.name) for field in fields(course)}
    return Recording(time=np.arange(1, N + 1) / fs, accel=accel.T, gyro=gyro.T, **truth)


def _block_readings(
    block: Block, scenario: Scenario, course: Itinerary, rng: np.random.Generator, delay: float
) -> Array:
    """Return the readings (n, N) of a block whose readings have a `delay`, s.

    They are made piece by piece: rest, move, rest, … A sample belongs to a rest if its whole interval does."""
    fs, rests = scenario.setup.sample_rate, course.rests
    sensors = SimulatedBlock.of(block, scenario, course.middle)
    out = np.empty((block.size, math.floor(rests[-1, 1] * fs + _ROUNDING)))
    shifted = rests + delay
    shifted[0, 0], shifted[-1, 1] = rests[0, 0], rests[-1, 1]
    starts, stops = shifted.T * fs
    edges = np.column_stack([np.ceil(starts - _ROUNDING), np.floor(stops + _ROUNDING)]).astype(int)
    normal = np.empty((len(rests), block.size))
    for i, L in enumerate(course.attitudes):
        normal[i] = rng.standard_normal(block.size)
        moves = () if i == len(course.moves) else _chunks(edges[i, 1], edges[i + 1, 0])
        pieces = [(*piece, True) for piece in _chunks(*edges[i])] + [(*piece, False) for piece in moves]
        for first, last, still in pieces:
            if still:
                means = _at_rest(sensors, scenario, delay, L, first, last)
            else:
                means = _in_move(sensors, scenario, delay, L, course.moves[i], float(shifted[i, 1]), first, last)
            out[:, first:last] = means.T
            if sensors.white > 0.0:
                out[:, first:last] += math.sqrt(fs) * sensors.white * rng.standard_normal((block.size, last - first))
    bias = sensors.bias(normal, rests)
    for first, last in _chunks(0, out.shape[1]) if np.any(bias.values) else ():
        begins = (np.arange(first, last) + _ROUNDING) / fs - delay  # of the rest that begins there
        out[:, first:last] += bias.at(np.asarray(begins, dtype=float)).T
    return out


def _chunks(first: int, last: int) -> Iterator[tuple[int, int]]:
    """Yield a range of samples in pieces of bounded length."""
    for start in range(int(first), int(last), _CHUNK):
        yield start, min(start + _CHUNK, int(last))


def _at_rest(sensors: SimulatedBlock, scenario: Scenario, delay: float, L: Array, first: int, last: int) -> Array:
    """Return the mean readings of samples [first, last) at rest: (1, n), or of every sample with vibration or drift."""
    setup, vibration = scenario.setup, scenario.vibration
    fs = setup.sample_rate
    still = vibration.amplitude == 0.0 and not sensors.changes
    middle = np.asarray((np.arange(first, first + 1 if still else last) + 0.5) / fs - delay, dtype=float)
    force = np.full(len(middle), setup.gravity)
    if vibration.amplitude > 0.0:
        mean = vibration.amplitude * np.sinc(vibration.frequency / fs)
        force += mean * np.sin(2.0 * np.pi * vibration.frequency * middle)
    rates = np.broadcast_to(np.array(earth_rate(setup.latitude)) @ L, (len(force), 3))
    return sensors.read(_with_levers(sensors, force[:, None] * L[1], rates, np.zeros_like(rates)), rates, middle)


def _in_move(
    sensors: SimulatedBlock,
    scenario: Scenario,
    delay: float,
    L: Array,
    move: Array,
    start: float,
    first: int,
    last: int,
) -> Array:
    """Return the mean readings (last − first, n) of samples of a move from attitude L that starts at time `start`."""
    profile, vibration, fs = scenario.profile, scenario.vibration, scenario.setup.sample_rate
    earth = np.array(earth_rate(scenario.setup.latitude))
    total = float(np.linalg.norm(move))
    n = move / total if total > 0.0 else UP
    whole = math.floor(start * fs)  # time within the move is counted in samples, for precision late in a log
    passed = (first - whole) - (start * fs - whole)
    # panels end with every sample, every quarter of a cycle of the vibration, and the ramps
    T = profile.duration(total)
    per_sample = 1
    if vibration.amplitude > 0.0:
        per_sample += math.ceil(_PANELS_PER_CYCLE * vibration.frequency / fs)
    kinks = np.array([0.0, profile.ramp, T - profile.ramp, T]) * fs - passed
    inside = kinks[(kinks > 0.0) & (kinks < last - first)]
    panels = np.unique(np.concatenate([np.arange((last - first) * per_sample + 1) / per_sample, inside]))
    nodes = panels[:-1, None] + np.diff(panels)[:, None] * NODES
    theta = profile.angle((nodes + passed) / fs, total)
    rate, change = (each[..., None] for each in profile.rates((nodes + passed) / fs, total))
    vertical = np.full_like(theta, scenario.setup.gravity)
    if vibration.amplitude > 0.0:
        seconds = (first + nodes - delay * fs) / fs
        vertical += vibration.amplitude * np.sin(2.0 * np.pi * vibration.frequency * seconds)
    earth_b, axis_b = harmonics(theta) @ harmonic_coefficients(n, earth) @ L, n @ L
    force = vertical[..., None] * harmonics(theta) @ harmonic_coefficients(n, UP) @ L
    changes = change * axis_b - rate * np.cross(axis_b, earth_b)
    force, rates, changes = (each.reshape(-1, 3) for each in (force, earth_b + rate * axis_b, changes))
    readings = sensors.read(_with_levers(sensors, force, rates, changes), rates, (first + nodes).ravel() / fs)
    integrals = np.einsum("pnk,n,p->pk", readings.reshape(*theta.shape, -1), WEIGHTS, np.diff(panels))
    return np.asarray(np.add.reduceat(integrals, np.searchsorted(panels, np.arange(last - first)), axis=0))


def _with_levers(sensors: SimulatedBlock, force: Array, rate: Array, change: Array) -> Array:
    """Return forces (N, n, 3) at lever arms r, f + [ω̇×]r + [ω×]²r, or those (N, 3) of the body without arms."""
    if not np.any(sensors.arms):
        return force
    around = skew(change) + skew(rate) @ skew(rate)
    return np.asarray(force[:, None] + np.einsum("nij,pj->npi", around, sensors.arms))
