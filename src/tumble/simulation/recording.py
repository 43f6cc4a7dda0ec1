"""The log of a scenario, sample by sample, exact to rounding.

All the time the Earth turns. With n and θ of a move and L₀ the attitude at its start (body → geographic),

    L(t) = exp([nθ×]) L₀,   ω = n θ̇ + Ω,   f = (g + v) e_U        geographic frame; v: vibration, vertical

A sample is the mean over the interval that ends at its time stamp, in the body frame. Since Lᵀn is constant,

    mean Lᵀω = L₀ᵀ( n Δθ/h + mean(R)ᵀ Ω ),   mean Lᵀf = L₀ᵀ mean((g + v) Rᵀ) e_U
    Rᵀ = nnᵀ + cos θ (I − nnᵀ) − sin θ [n×]

so that a move is three scalar series: Δθ, and the means of cos θ and sin θ. The means are Gauss–Legendre
sums over panels that end wherever a sample ends or θ(t) is not smooth, exact to rounding; moves need not
begin or end with a sample. `reading = matrix @ mean + bias + noise`. There are no lever arms.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from tumble.earth import earth_rate
from tumble.errors import InputError
from tumble.rotation import UP
from tumble.sensors.model import SensorModel
from tumble.simulation.scenario import Scenario, itinerary
from tumble.units import Array

_LEGENDRE = np.polynomial.legendre.leggauss(6)
_NODES, _WEIGHTS = 0.5 * (_LEGENDRE[0] + 1.0), 0.5 * _LEGENDRE[1]
"""Six Gauss–Legendre nodes and weights on 0…1."""
_PANELS_PER_CYCLE = 4.0
_MAX_SAMPLES = 30_000_000
"""Eight hours at 1 kHz, 1.5 GB."""
_CHUNK = 1 << 13
"""Samples made at a time."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Recording:
    """A simulated log and what really happened. `time` (N,), s; `accel` (N, n), m/s²; `gyro` (N, n), rad/s;
    `attitudes` (R, 3, 3), true body → geographic at the rests; `rests` (R, 2), their start and stop, s;
    `moves` (R − 1, 3), rotation vectors in the geographic frame, rad; `positions` (R,), which position of the
    programme each rest is (of the random ones, if hand-held)."""

    time: Array
    accel: Array
    gyro: Array
    attitudes: Array
    rests: Array
    moves: Array
    positions: tuple[int, ...]


def record(scenario: Scenario, rng: np.random.Generator) -> Recording:
    """Run a scenario in memory. Attitudes and times do not depend on the noise.

    Raises InputError, one line, if the scenario is impossible or too long."""
    geometry, noise = rng.spawn(2)
    way = itinerary(scenario, geometry)
    samples = way.rests[-1, 1] * scenario.profile.sample_rate
    if not samples <= _MAX_SAMPLES:
        raise InputError(f"session: expected at most {_MAX_SAMPLES:g} samples, found {samples:.3g}")
    time, accel, gyro = _readings(scenario, way.attitudes, way.moves, way.rests, noise)
    return Recording(
        time=time,
        accel=accel,
        gyro=gyro,
        attitudes=way.attitudes,
        rests=way.rests,
        moves=way.moves,
        positions=way.positions,
    )


def _readings(
    scenario: Scenario, attitudes: Array, moves: Array, rests: Array, rng: np.random.Generator
) -> tuple[Array, Array, Array]:
    """Time and readings of both blocks, piece by piece: rest, move, rest, …

    A sample belongs to a rest if all of its interval does."""
    fs = scenario.profile.sample_rate
    edges = np.column_stack([np.ceil(rests[:, 0] * fs - 1e-6), np.floor(rests[:, 1] * fs + 1e-6)]).astype(int)
    N = int(edges[-1, 1])
    accel, gyro = _sensors(scenario, N, rng)
    for i, L in enumerate(attitudes):
        accel.draw_bias()
        gyro.draw_bias()
        for first, last in _chunks(edges[i, 0], edges[i, 1]):
            force, rate = _at_rest(scenario, L, first, last)
            accel.put(first, last, force)
            gyro.put(first, last, rate)
        for first, last in _chunks(edges[i, 1], edges[i + 1, 0]) if i < len(moves) else ():
            force, rate = _in_move(scenario, L, moves[i], float(rests[i, 1]), first, last)
            accel.put(first, last, force)
            gyro.put(first, last, rate)
    return np.arange(1, N + 1) / fs, accel.readings.T, gyro.readings.T


def _chunks(first: int, last: int) -> Iterator[tuple[int, int]]:
    """A range of samples in pieces of bounded length."""
    for start in range(int(first), int(last), _CHUNK):
        yield start, min(start + _CHUNK, int(last))


@dataclass(kw_only=True, slots=True, eq=False)
class _SampledBlock:
    """One block at work: its readings (n, N) as they fill up, the noise `sigma` of a sample, and the bias it
    has in the current rest and move."""

    model: SensorModel
    sigma: float
    instability: float
    rng: np.random.Generator
    bias: Array
    readings: Array

    def draw_bias(self) -> None:
        self.bias = self.model.bias + self.instability * self.rng.standard_normal(len(self.model.bias))

    def put(self, first: int, last: int, true: Array) -> None:
        """Readings of true body vectors, shape (last − first, 3), or (1, 3) for all of them."""
        out = self.readings[:, first:last]
        out[:] = self.model.matrix @ true.T + self.bias[:, None]
        if self.sigma > 0.0:
            out += self.sigma * self.rng.standard_normal(out.shape)


def _sensors(scenario: Scenario, samples: int, rng: np.random.Generator) -> tuple[_SampledBlock, _SampledBlock]:
    """Accelerometers and gyros, ready to fill."""
    noise, root = scenario.noise, math.sqrt(scenario.profile.sample_rate)
    levels = ((noise.accel_white, noise.accel_instability), (noise.gyro_white, noise.gyro_instability))
    made = []
    for block, (white, instability), own in zip((scenario.accel, scenario.gyro), levels, rng.spawn(2), strict=True):
        model = block.model(np.array([scenario.truth[name] for name in block.names]))
        made.append(
            _SampledBlock(
                model=model,
                sigma=white * root,
                instability=instability,
                rng=own,
                bias=model.bias,
                readings=np.empty((block.size, samples)),
            )
        )
    return made[0], made[1]


def _at_rest(scenario: Scenario, L: Array, first: int, last: int) -> tuple[Array, Array]:
    """Mean specific force and rate, body frame, of samples [first, last) at rest: (1, 3), or with vibration
    the force of every sample."""
    site, vibration, fs = scenario.site, scenario.vibration, scenario.profile.sample_rate
    up, rate = L.T @ UP, L.T @ np.array(earth_rate(scenario.latitude))
    force = np.full(1, site.gravity)
    if vibration.amplitude > 0.0:
        middle = (np.arange(first, last) + 0.5) / fs
        mean = vibration.amplitude * np.sinc(vibration.frequency / fs)
        force = site.gravity + mean * np.sin(2.0 * np.pi * vibration.frequency * middle)
    return force[:, None] * up, rate[None, :]


def _in_move(scenario: Scenario, L: Array, move: Array, start: float, first: int, last: int) -> tuple[Array, Array]:
    """Mean specific force and rate, body frame, (last − first, 3), of samples of a move from attitude L that
    starts at time `start`. The formulas are those at the head of the module."""
    profile, fs = scenario.profile, scenario.profile.sample_rate
    total = float(np.linalg.norm(move))
    n = move / total if total > 0.0 else UP
    whole = math.floor(start * fs)  # time within the move, in samples, so that nothing is lost late in a log
    passed = (first - whole) - (start * fs - whole)
    samples = np.arange(last - first + 1.0)
    turned = np.diff(profile.angle((samples + passed) / fs, total)) * fs
    panels = _panels(scenario, total, passed, last - first)
    nodes = panels[:-1, None] + np.diff(panels)[:, None] * _NODES
    theta = profile.angle((nodes + passed) / fs, total)
    ones, cosine, sine = np.ones_like(theta), np.cos(theta), np.sin(theta)
    force = scenario.site.gravity + _vibration(scenario, nodes, first)
    w = _means(np.stack([ones, cosine, sine]), panels, samples)
    f = _means(force * np.stack([ones, cosine, sine]), panels, samples)
    earth = np.array(earth_rate(scenario.latitude))
    return f @ _turning(n, UP) @ L, (w @ _turning(n, earth) + np.outer(turned, n)) @ L


def _turning(n: Array, vector: Array) -> Array:
    """Rows a, b, c with Rᵀ vector = a + b cos θ + c sin θ, R the rotation by θ about n."""
    along = n * (n @ vector)
    return np.stack([along, vector - along, -np.cross(n, vector)])


def _means(values: Array, panels: Array, samples: Array) -> Array:
    """Means over every sample, (samples, k), of k series given at the nodes of every panel, (k, P, 6)."""
    integrals = (values @ _WEIGHTS) * np.diff(panels)
    return np.asarray(np.add.reduceat(integrals, np.searchsorted(panels, samples[:-1]), axis=1).T)


def _panels(scenario: Scenario, total: float, passed: float, samples: int) -> Array:
    """Borders of the quadrature panels of a piece of a move, in samples from its beginning: every sample's
    ends, quarters of the vibration's cycle, and where the ramps begin and end."""
    profile, vibration = scenario.profile, scenario.vibration
    each = 1
    if vibration.amplitude > 0.0:
        each += math.ceil(_PANELS_PER_CYCLE * vibration.frequency / profile.sample_rate)
    T = profile.duration(total)
    kinks = np.array([0.0, profile.ramp, T - profile.ramp, T]) * profile.sample_rate - passed
    inside = kinks[(kinks > 0.0) & (kinks < samples)]
    return np.unique(np.concatenate([np.arange(samples * each + 1) / each, inside]))


def _vibration(scenario: Scenario, nodes: Array, first: int) -> Array:
    """Specific force of the vibration, m/s², at `nodes`, samples after sample `first` begins."""
    vibration = scenario.vibration
    if vibration.amplitude == 0.0:
        return np.zeros(1)
    t = (first + nodes) / scenario.profile.sample_rate
    return np.asarray(vibration.amplitude * np.sin(2.0 * np.pi * vibration.frequency * t))
