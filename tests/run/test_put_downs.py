"""A device that is put down on its faces: a blow along one axis is no corrupt sample, and a corrupt one is found."""

from __future__ import annotations

import numpy as np
import pytest

import tumble
from tumble.rotation import rotation_matrix, rotation_vector
from tumble.units import DEGREE, Array

G, LATITUDE = 9.81, 0.85
FACES = np.vstack([np.eye(3), -np.eye(3)])
EDGES = np.array([[1, 1, 0], [1, -1, 0], [-1, 0, 1], [0, 1, 1], [0, -1, 1], [-1, 0, -1]]) / np.sqrt(2.0)
NAMES = tuple(f"{kind}.{group}.{axis}" for kind in ("accel", "gyro") for group in ("bias", "scale") for axis in "xyz")


def put_down(seed: int, rate: float, speed: float, end: float = np.inf) -> tuple[Array, Array, dict[str, float]]:
    """Readings (N, 3) of both sensors, means over their intervals, and the truth: 18 positions at rest, turns between
    them by a smooth rotation, and at the end of each a way down at `speed`, m/s, that a table stops within 6 ms. The
    accelerometers are at the `end` of their range, m/s², within the samples."""
    rng, sub = np.random.default_rng(seed), round(4000.0 / rate)
    step = 1.0 / (sub * rate)
    ups = np.vstack([FACES, EDGES, FACES]) + 0.003 * rng.standard_normal((18, 3))
    ups = rng.permutation(ups / np.linalg.norm(ups, axis=1)[:, None])
    verticals = [np.append(up, 0.0)[:3] for up in ups]
    attitudes = []  # body → north, up, east, with any heading
    for up in verticals:
        axis = np.cross(up, [0.0, 1.0, 0.0])
        sine, cosine = float(np.linalg.norm(axis)), float(up[1])
        tilt = rotation_matrix(axis / max(sine, 1e-9) * np.arctan2(sine, cosine))
        attitudes.append(rotation_matrix(np.array([0.0, rng.uniform(-np.pi, np.pi), 0.0])) @ tilt)
    force, turning = list[Array](), list[Array]()

    def add(attitude: Array, acceleration: Array, rates: Array) -> None:
        up = np.array([0.0, G, 0.0])
        force.append(np.einsum("...ji,...j->...i", attitude, acceleration + up) * np.ones((len(rates), 1)))
        turning.append(rates)

    for k, attitude in enumerate(attitudes):
        still = round((15.0 if k == 0 else 3.0) / step)
        add(attitude, np.zeros((still, 3)), np.zeros((still, 3)))
        if k + 1 == len(attitudes):
            break
        turn = rotation_vector((attitude.T @ attitudes[k + 1])[None])[0]
        count = round(2.0 / step)
        s = (np.arange(count) + 0.5) / count
        share, change = s**3 * (10.0 - 15.0 * s + 6.0 * s**2), 30.0 * s**2 * (1.0 - s) ** 2 / 2.0
        lift = np.zeros((count, 3))
        lift[:, 1] = 0.1 * (60.0 * s - 180.0 * s**2 + 120.0 * s**3) / 4.0
        add(attitude @ rotation_matrix(share[:, None] * turn), lift, change[:, None] * turn)
        down = round(0.3 / step)
        s = (np.arange(down) + 0.5) / down
        approach = np.append(-20.0 * speed * s * (1.0 - s), np.zeros(round(0.1 / step)))
        stop = np.sin(np.pi * (np.arange(round(0.006 / step)) + 0.5) / round(0.006 / step))
        way = np.zeros((len(approach) + len(stop), 3))
        way[:, 1] = np.append(approach, -stop * approach.sum() / stop.sum())
        add(attitudes[k + 1], way, np.zeros((len(way), 3)))
    samples = [np.concatenate(each) for each in (force, turning)]
    samples[0] = np.clip(samples[0], -end, end)
    f, w = (each[: len(each) // sub * sub].reshape(-1, sub, 3).mean(axis=1) for each in samples)
    sizes = (0.05, 6e-3, 5e-3, 6e-3)
    drawn = [size * rng.standard_normal(3) for size in sizes]
    accel = (1.0 + drawn[1]) * f + drawn[0] + 1.5e-3 * np.sqrt(rate) * rng.standard_normal(f.shape)
    gyro = (1.0 + drawn[3]) * w + drawn[2] + 0.01 * DEGREE * np.sqrt(rate) * rng.standard_normal(w.shape)
    return accel, gyro, dict(zip(NAMES, np.concatenate(drawn).tolist(), strict=True))


def calibrated(accel: Array, gyro: Array, rate: float) -> tumble.Calibration:
    time = (np.arange(len(accel)) + 1.0) / rate
    return tumble.calibrate(
        accel=accel, gyro=gyro, time=time, latitude=LATITUDE, gravity=G, gravity_u=1e-5, clock_ppm_u=0.0
    )


@pytest.mark.parametrize(("rate", "speed"), [(100.0, 0.15), (62.5, 0.3), (200.0, 0.6)])
def test_a_device_that_is_put_down_is_calibrated(rate: float, speed: float) -> None:
    accel, gyro, truth = put_down(1, rate, speed)
    made = calibrated(accel, gyro, rate)
    assert made.outcome.accepted
    assert not any("bad sample" in note for note in made.provenance.notes)
    z = np.array([(made[name].value - value) / (made[name].u or 1.0) for name, value in truth.items()])
    assert np.abs(z).max() < 5.0
    assert np.sqrt(np.mean(z**2)) < 2.0


@pytest.mark.parametrize(
    ("rate", "speed", "end"), [(400.0, 0.6, 15.0 * G), (200.0, 0.6, 8.0 * G), (100.0, 0.5, 4.0 * G)]
)
def test_blows_beyond_the_range_within_a_sample_say_nothing(rate: float, speed: float, end: float) -> None:
    accel, gyro, truth = put_down(4, rate, speed, end)
    made = calibrated(accel, gyro, rate)
    assert made.outcome.accepted
    further = [made[name] for name in made if name.startswith(("accel.quadratic", "accel.cubic"))]
    z = [(made[name].value - value) / (made[name].u or 1.0) for name, value in truth.items()]
    z += [parameter.value / (parameter.u or 1.0) for parameter in further]
    assert np.abs(z).max() < 4.0


def test_a_corrupt_sample_between_put_downs_is_replaced() -> None:
    accel, gyro, truth = put_down(2, 100.0, 0.15)
    still = np.linalg.norm(gyro - np.median(gyro, axis=0), axis=1) < 0.2
    at = int(np.flatnonzero(~still)[200])
    accel[at, 1] += 20.0 * G
    made = calibrated(accel, gyro, 100.0)
    assert made.outcome.accepted
    assert any(note.startswith("1 bad sample, far off those beside it, replaced") for note in made.provenance.notes)
    z = np.array([(made[name].value - value) / (made[name].u or 1.0) for name, value in truth.items()])
    assert np.abs(z).max() < 5.0
