"""Devices held in the hand: what they sway by in their rests, and what is made of it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import polars as pl
import pytest

import tumble
from tests.support.moving import lay
from tumble.rotation import rotation_matrix, rotation_vector
from tumble.simulation.session import read_truth
from tumble.units import DEGREE, Array

SITE = {"latitude": 56.84 * DEGREE, "height": 270.0, "gravity": 9.815788295915675, "gravity_u": 1e-7}


@dataclass(frozen=True, kw_only=True, eq=False)
class Held:
    """Samples of a MEMS device by hand, and its truth."""

    truth: dict[str, float]
    time: Array
    accel: Array
    gyro: Array

    def swaying(self, angle: float, frequencies: tuple[float, float], seed: int = 3) -> dict[str, Array]:
        """The samples of a device that sways by so much an axis, °, root mean square, between two frequencies, Hz: of
        the attitude L exp(α) it reads exp(−α) f and exp(−α) ω + α̇."""
        rng, dt = np.random.default_rng(seed), float(np.diff(self.time).mean())
        f = np.fft.rfftfreq(len(self.time) + 1, dt)
        amplitude = np.where((f >= frequencies[0]) & (f <= frequencies[1]), 1.0 / np.maximum(f, dt), 0.0)[:, None]
        normal = rng.standard_normal((2, len(f), 3))
        sway = np.fft.irfft(amplitude * (normal[0] + 1j * normal[1]), len(self.time) + 1, axis=0)
        C = rotation_matrix(angle * DEGREE * sway / sway.std(axis=0))
        back = np.swapaxes(rotation_matrix(angle * DEGREE * 0.5 * (sway[1:] + sway[:-1]) / sway.std(axis=0)), 1, 2)
        turned = rotation_vector(np.swapaxes(C[:-1], 1, 2) @ C[1:]) / dt
        accel, gyro = ((back @ each[:, :, None])[:, :, 0] for each in (self.accel, self.gyro))
        return {"time": self.time, "accel": accel, "gyro": gyro + turned}

    def errors(self, made: tumble.Calibration, group: str) -> tuple[Array, Array]:
        """Errors and standard uncertainties of the parameters of a group."""
        names = [p.name for p in made.parameters if p.name.startswith(f"{group}.") and p.name.count(".") == 2]
        return np.array([made[n].value - self.truth[n] for n in names]), np.array([made[n].u for n in names])


@pytest.fixture(scope="module")
def held(tmp_path_factory: pytest.TempPathFactory) -> Held:
    folder = tmp_path_factory.mktemp("held") / "s"
    tumble.simulate_session(folder, tumble.Setup.of(grade="mems", positions=20), seed=2)
    log = pl.read_parquet(folder / "log.parquet")
    return Held(
        truth=read_truth(Path(folder) / "truth.json"),
        time=log["t"].to_numpy(),
        accel=log.select("ax", "ay", "az").to_numpy(),
        gyro=log.select("gx", "gy", "gz").to_numpy(),
    )


@pytest.mark.parametrize(("angle", "frequencies"), [(0.1, (0.3, 8.0)), (0.5, (0.3, 8.0)), (0.8, (0.3, 2.0))])
def test_a_device_in_the_hand_gives_gyros_too(held: Held, angle: float, frequencies: tuple[float, float]) -> None:
    """Lying still, gyro.scale is known to 135 ppm. Turns between the attitudes at the ends of rests have it to 1,400
    and 6,800 ppm, and not at all; were what accelerometers read of the sway noise, it would be 270, 630, 950 ppm."""
    samples = held.swaying(angle, frequencies)
    made = tumble.calibrate(**samples, **SITE)  # type: ignore[arg-type]
    assert made.outcome.gyro.accepted
    for group in ("accel.bias", "accel.scale", "accel.axis", "gyro.bias", "gyro.scale", "gyro.axis"):
        error, u = held.errors(made, group)
        assert np.all(np.abs(error) < 4.0 * u), group
    assert held.errors(made, "gyro.scale")[1].max() < (2.4e-4 if angle < 0.2 else 3.5e-4)
    (note,) = [note for note in made.provenance.notes if "sways" in note]
    assert float(note.split()[4].rstrip("°")) == pytest.approx(angle, rel=0.25)
    assert "put it down on something firm" in note


def test_pauses_in_the_hand_are_rests_where_the_device_does_not_stay_in_place() -> None:
    """Eight pauses of seven seconds, lifted by 15 cm in between: by motion, as if it stayed in place, parameters were
    off by up to 8 u and a quadratic term was 500 times as large as usual, accepted with scatter."""
    faces = np.vstack([np.eye(3), -np.eye(3), [[0.7, 0.7, 0.0], [0.0, 0.7, -0.7]]])
    recording = lay(faces[np.random.default_rng(0).permutation(8)], 0, rest=(6.0, 8.0))
    time = np.arange(1, len(recording.accel) + 1) / recording.rate
    truth = {f"accel.bias.{a}": recording.accel_bias[k] for k, a in enumerate("xyz")}
    truth |= {f"{kind}.scale.{a}": matrix[k, k] - 1.0 for kind, matrix in (
        ("accel", recording.accel_matrix), ("gyro", recording.gyro_matrix)) for k, a in enumerate("xyz")}  # fmt: skip
    held = Held(truth=truth, time=time, accel=recording.accel, gyro=recording.gyro)
    made = tumble.calibrate(**held.swaying(0.2, (0.5, 3.0)), gravity=recording.gravity, gravity_u=1e-4)  # type: ignore[arg-type]
    assert made.outcome.accepted
    assert not any(note.startswith("calibrated in motion") for note in made.provenance.notes)
    for group in ("accel.bias", "accel.scale", "gyro.scale"):
        error, u = held.errors(made, group)
        assert np.all(np.abs(error) < 4.0 * u), group


def test_the_mean_force_is_as_long_as_gravity_where_the_device_sways(held: Held) -> None:
    """By 1.4° the mean of a unit vector is shorter by 600 ppm; what is left of it is the noise."""
    still = tumble.calibrate(time=held.time, accel=held.accel, gyro=held.gyro, **SITE)  # type: ignore[arg-type]
    made = tumble.calibrate(**held.swaying(1.4, (0.5, 6.0)), **SITE)  # type: ignore[arg-type]
    change = [made[f"accel.scale.{axis}"].value - still[f"accel.scale.{axis}"].value for axis in "xyz"]
    assert abs(np.mean(change)) < 2e-4


def test_a_device_that_lies_still_does_not_sway(held: Held) -> None:
    made = tumble.calibrate(time=held.time, accel=held.accel, gyro=held.gyro, **SITE)  # type: ignore[arg-type]
    assert not any("sways" in note for note in made.provenance.notes)
    shaken = held.accel + 0.5 * np.sin(2.0 * np.pi * 23.0 * held.time)[:, None] * np.array([0.6, 0.0, 0.8])
    made = tumble.calibrate(time=held.time, accel=shaken, gyro=held.gyro, **SITE)  # type: ignore[arg-type]
    assert not any("sways" in note for note in made.provenance.notes)
