"""Lever arms of an array from its motion: against a simulation with kinematics of its own, and on a real array."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import polars as pl
import pytest

from tumble.inference.array_levers import COMMON, ArrayLevers, array_levers
from tumble.reduction.blocks.motion_samples import MotionSamples
from tumble.reduction.turns.array_motion import ArrayMoments, array_moments
from tumble.sensors.instrument import Instrument
from tumble.sensors.model import Block, left_null_space
from tumble.units import DEGREE, G_STANDARD, Array

UPRIGHT, TURNED = np.eye(3), np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
AXES = np.vstack([UPRIGHT if chip % 2 == 0 else TURNED for chip in range(8)])
ACCEL, GYRO = Block(kind="accel", axes=AXES), Block(kind="gyro", axes=AXES)
INSTRUMENT = Instrument.of(ACCEL, GYRO, names=("accel.lever", "accel.delay"))
NOMINAL = np.zeros(len(INSTRUMENT.names))
CHIPS = np.array([[x, y, z] for x in (-9.45, 9.45) for y in (9.45, -9.45) for z in (1.0, -1.0)]) * 1e-3
ALONG = np.abs(AXES).argmax(axis=1)


def moments_of(accel: Array, gyro: Array, dt: float) -> ArrayMoments | None:
    """The moments of readings (m, n) of accelerometers and gyros."""
    samples = MotionSamples(spare=2 * (len(AXES) - 3))
    to_body, beyond = np.linalg.pinv(AXES).T, left_null_space(AXES).T
    spare = np.hstack([accel @ beyond, gyro @ beyond])
    samples.append(gyro @ to_body, accel @ to_body, np.full(len(accel), dt), spare)
    extremes = np.array([accel.min(axis=0), accel.max(axis=0)]), np.array([gyro.min(axis=0), gyro.max(axis=0)])
    return array_moments(samples, [(0, len(accel))], (ACCEL, GYRO), extremes, np.zeros(3))


def in_gauge(levers: Array) -> Array:
    """Lever arms (n, 3) less the mean of the sensors of each direction, which parity does not see."""
    out = levers.copy()
    for axis in range(3):
        out[axis == ALONG] -= out[axis == ALONG].mean(axis=0)
    return out


PROJECT = np.array([in_gauge(column.reshape(24, 3)).ravel() for column in np.eye(72)]).T[:, :69]
"""Lever arms of all sensors but the last to those in the gauge."""


def solved(found: ArrayLevers, rates: float, lever: float = 0.03) -> tuple[Array, Array]:
    """Lever arms, delay and E (q,), and their covariance, where the rates are known to a part `rates`."""
    known = np.concatenate([np.full(len(found.about) - COMMON, lever), [0.02], np.full(9, rates)]) ** -2.0
    normal = found.root.T @ found.root + np.diag(known)
    step = np.linalg.solve(normal, found.root.T @ found.excess - known * found.about)
    return np.asarray(found.about + step), np.asarray(np.linalg.inv(normal))


def placed(solution: Array) -> Array:
    """Lever arms (n, 3) of all sensors, the last one at zero."""
    return np.vstack([solution[:-COMMON].reshape(-1, 3), np.zeros(3)])


class Shaken:
    """An array shaken by hand for `seconds`: rates and forces of sines, readings at instants, uneven noise."""

    def __init__(
        self, seed: int, *, seconds: float = 30.0, rate: float = 200.0, delay: float = 1.5e-3, rows: float = 2e-4
    ) -> None:
        rng = np.random.default_rng(seed)
        self.dt, self.delay = 1.0 / rate, delay
        t = np.arange(round(seconds * rate), dtype=float) * self.dt
        self.levers = np.repeat(CHIPS, 3, axis=0) + rng.normal(0.0, 0.3e-3, (24, 3))
        self.own = rng.normal(0.0, [0.3, rows, rows, rows], (24, 4))  # biases, and what is not known of the rows
        self.values = np.zeros(len(INSTRUMENT.names))
        accel = INSTRUMENT.own(ACCEL)
        self.values[accel][24:] = rng.normal(0.0, 0.01, accel.stop - accel.start - 24)
        K = INSTRUMENT.model(ACCEL, self.values).matrix
        size, place = rng.normal(0.0, 6.0, (2, 3, 4)), rng.uniform(2.0, 5.0, (3, 4))
        omega, turning = self._sines(t - delay, size, place)
        self.rates = self._sines(t, size, place)[0]
        push = self._sines(t - delay, rng.normal(0.0, 10.0, (2, 3, 4)), rng.uniform(2.0, 6.0, (3, 4)))[0]
        force = push + np.array([0.0, G_STANDARD, 0.0])
        at = force[:, None] + np.cross(turning[:, None], self.levers)
        at += np.cross(omega[:, None], np.cross(omega[:, None], self.levers))
        clean = np.einsum("kpi,pi->kp", at, K + self.own[:, 1:]) + self.own[:, 0]
        loud = 0.02 * np.exp(rng.normal(0.0, 1.0, len(t)))
        self.accel = clean + loud[:, None] * rng.standard_normal(clean.shape)
        self.gyro = self.rates @ AXES.T + 1e-3 * rng.standard_normal((len(t), 24))

    @staticmethod
    def _sines(t: Array, size: Array, place: Array) -> tuple[Array, Array]:
        """Values (m, 3) and derivatives of sums of sines and cosines."""
        phase = 2.0 * np.pi * t[:, None, None] * place
        s, c = np.sin(phase), np.cos(phase)
        by = 2.0 * np.pi * place
        return (size[0] * s + size[1] * c).sum(axis=2), (by * (size[0] * c - size[1] * s)).sum(axis=2)


def test_lever_arms_and_delay_are_found_within_what_is_stated() -> None:
    errors = []
    for seed in range(6):
        shaken = Shaken(seed)
        moments = moments_of(shaken.accel, shaken.gyro, shaken.dt)
        assert moments is not None
        found, covariance = solved(array_levers(moments, INSTRUMENT, shaken.values), rates=1e-5)
        spread = np.sqrt(np.diag(PROJECT @ covariance[:69, :69] @ PROJECT.T))
        off = (in_gauge(placed(found)) - in_gauge(shaken.levers)).ravel()
        errors.append(off)
        assert np.abs(off / spread).max() < 2.0
        assert spread.max() < 0.06e-3
        assert found[69] == pytest.approx(shaken.delay, abs=0.006e-3)
    assert np.sqrt(np.mean(np.square(errors))) < 0.01e-3


def in_combinations(off: Array, covariance: Array) -> Array:
    """What is off (72,) in each combination of lever arms that is seen, over what it is known to."""
    size, direction = np.linalg.eigh(covariance)
    seen = size > 1e-6 * size[-1]
    return np.asarray((direction[:, seen].T @ off) / np.sqrt(size[seen]))


def test_rows_of_sensors_that_differ_in_motion_are_in_what_is_stated() -> None:
    """Axes off by 2 mrad in motion, counted with the force alone, would make lever arms err by 0.05 mm."""
    for seed in range(3):
        shaken = Shaken(seed, rows=2e-3)
        moments = moments_of(shaken.accel, shaken.gyro, shaken.dt)
        assert moments is not None
        found, covariance = solved(array_levers(moments, INSTRUMENT, shaken.values), rates=1e-5)
        off = (in_gauge(placed(found)) - in_gauge(shaken.levers)).ravel()
        assert np.sqrt(np.mean(off**2)) < 0.02e-3
        z = in_combinations(off, PROJECT @ covariance[:69, :69] @ PROJECT.T)
        assert np.mean(z**2) < 1.3


def test_an_error_of_the_rates_is_told_from_the_lever_arms_but_for_their_scale() -> None:
    shaken = Shaken(3)
    E = np.array([[0.004, 0.003, -0.002], [0.001, -0.005, 0.002], [-0.001, 0.002, 0.001]])
    moments = moments_of(shaken.accel, shaken.rates @ np.linalg.inv(np.eye(3) + E).T @ AXES.T, shaken.dt)
    assert moments is not None
    found, _ = solved(array_levers(moments, INSTRUMENT, shaken.values), rates=0.03)
    seen = found[70:].reshape(3, 3)
    assert seen - np.eye(3) * np.trace(seen) / 3.0 == pytest.approx(E - np.eye(3) * np.trace(E) / 3.0, abs=1.5e-3)


def test_what_does_not_move_says_nothing() -> None:
    rng = np.random.default_rng(1)
    still = np.array([0.0, G_STANDARD, 0.0]) @ AXES.T + 0.02 * rng.standard_normal((4000, 24))
    assert moments_of(still, 1e-3 * rng.standard_normal((4000, 24)), 0.01) is None


def test_six_accelerometers_are_too_few() -> None:
    samples = MotionSamples()
    samples.append(np.ones((9, 3)), np.ones((9, 3)), np.full(9, 0.01))
    six = Block(kind="accel", axes=AXES[:6])
    extremes = np.ones((2, 6)), np.ones((2, 24))
    assert array_moments(samples, [(0, 9)], (six, GYRO), extremes, np.zeros(3)) is None


def test_clipped_gyros_and_uneven_intervals_are_left_out() -> None:
    shaken = Shaken(2)
    whole = moments_of(shaken.accel, shaken.gyro, shaken.dt)
    clipped = shaken.gyro.copy()
    clipped[:, 4] = np.clip(clipped[:, 4], -10.0, 10.0)
    fewer = moments_of(shaken.accel, clipped, shaken.dt)
    assert whole is not None
    assert fewer is not None
    assert 0.2 < fewer.counts.sum() / whole.counts.sum() < 0.95
    found = [
        in_gauge(placed(solved(array_levers(m, INSTRUMENT, shaken.values), rates=1e-4)[0])) for m in (whole, fewer)
    ]
    assert np.abs(found[1] - found[0]).max() < 0.1e-3


def test_gyros_that_are_all_clipped_together_are_left_out() -> None:
    shaken = Shaken(2)
    clipped = np.clip(shaken.gyro, -12.0, 12.0)
    moments = moments_of(shaken.accel, clipped, shaken.dt)
    assert moments is not None
    found, _ = solved(array_levers(moments, INSTRUMENT, shaken.values), rates=1e-4)
    assert np.abs(in_gauge(placed(found)) - in_gauge(shaken.levers)).max() < 0.1e-3


def test_rows_are_the_derivative_of_what_they_linearise() -> None:
    shaken = Shaken(4, seconds=10.0)
    moments = moments_of(shaken.accel, shaken.gyro, shaken.dt)
    assert moments is not None
    levers = array_levers(moments, INSTRUMENT, NOMINAL)
    rng, step = np.random.default_rng(0), 1e-6
    values = np.where(np.arange(len(NOMINAL)) < INSTRUMENT.linear_count, rng.normal(0.0, 1e-3, len(NOMINAL)), 0.0)
    rows = levers.rows(INSTRUMENT, values)
    for column in range(48, len(values)):
        up, down = values.copy(), values.copy()
        up[column] += step
        down[column] -= step
        numeric = (levers.rows(INSTRUMENT, down)[:, -1] - levers.rows(INSTRUMENT, up)[:, -1]) / (2.0 * step)
        scale = np.abs(rows[:, column]).max() + 1.0
        assert rows[:, column] == pytest.approx(numeric, abs=1e-5 * scale)


def test_the_chips_of_a_real_array_lie_where_they_lie_in_every_session(data: Path) -> None:
    found, known = [], []
    for number in (1, 3, 5):
        log = pl.read_parquet(data / "mimu4444" / f"exp_{number}.parquet")
        names = [f"{chip}{axis}" for chip in range(1, 9) for axis in "xyz"]
        accel = log.select([f"a{n}" for n in names]).to_numpy() / 2048.0 * 9.818
        gyro = log.select([f"g{n}" for n in names]).to_numpy() / 16.4 * DEGREE
        moments = moments_of(accel, gyro - np.median(gyro[:300], axis=0), 1.0 / 62.5)
        assert moments is not None
        levers, covariance = solved(array_levers(moments, INSTRUMENT, NOMINAL), rates=1e-3)
        found.append(in_gauge(placed(levers)))
        known.append(PROJECT @ covariance[:69, :69] @ PROJECT.T)
        assert 1e-3 < levers[69] < 2.5e-3
    assert np.sqrt(np.mean(np.var(found, axis=0, ddof=1))) < 0.08e-3
    pairs = [in_combinations((found[a] - found[b]).ravel(), known[a] + known[b]) for a, b in ((0, 1), (0, 2), (1, 2))]
    assert 0.7 < np.mean(np.square(pairs)) < 1.5
    chips = np.mean(found, axis=0).reshape(8, 3, 3).mean(axis=1)
    assert np.abs(chips - CHIPS).max() < 0.6e-3
