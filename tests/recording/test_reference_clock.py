"""A log's clock by a second one in it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

import tumble
from tests.support.shared import session
from tumble.errors import InputError
from tumble.run.together import calibrate_together
from tumble.simulation.temperature_profile import TemperatureProfile
from tumble.units import Array

RATE, SECONDS, PPM = 100.0, 300.0, 40.0


def stamps(
    rng: np.random.Generator, *, jitter: float, fixes: float | None = None, slow: float = 0.0
) -> tuple[Array, Array]:
    """Times of a log whose seconds are too short by PPM, and those of a second clock: with jitter, s, white or
    (`slow`, s) wandering over 30 s, and new only with each fix."""
    t = np.arange(0.0, SECONDS, 1.0 / RATE)
    true = t * (1.0 + 1e-6 * PPM)
    late = np.abs(jitter * rng.standard_normal(len(t)))
    if slow:
        a = np.exp(-1.0 / RATE / 30.0)
        walk = np.zeros(len(t))
        steps = slow * np.sqrt(1.0 - a**2) * rng.standard_normal(len(t))
        for k in range(1, len(t)):
            walk[k] = a * walk[k - 1] + steps[k]
        late += walk
    shown = true + late if fixes is None else np.floor(true / fixes + 1e-9) * fixes
    return t, 1.7e9 + shown


def session_with(t: Array, c: Array, **keys: Any) -> tumble.Session:
    accel = {"columns": ["x", "y", "z"], "unit": "g"}
    clock = {"column": "c", "ppm_u": 0.0} | keys
    description = {
        "format": 1,
        "device": {"serial": "A"},
        "log": {"time": "t", "accel": accel, "reference_clock": clock},
    }
    zero = np.zeros(len(t))
    return tumble.session_of(description, {"t": t, "c": c, "x": zero, "y": zero, "z": zero + 1.0})


@pytest.mark.parametrize(
    "kind",
    [{"jitter": 1e-3}, {"jitter": 0.0, "fixes": 0.1}, {"jitter": 1e-4, "slow": 1e-3}],
    ids=["host", "fixes at 10 Hz", "latency that wanders"],
)
def test_its_rate_is_found_to_what_is_said(kind: dict[str, float]) -> None:
    """Over N = 60 logs; the jackknife of ten parts knows u to a quarter."""
    z, u = [], []
    for seed in range(60 if "fixes" not in kind else 1):
        log = session_with(*stamps(np.random.default_rng(seed), **kind)).log
        assert log.clock_u is not None
        z.append((log.clock_rate - 1.0 - 1e-6 * PPM) / log.clock_u)
        u.append(log.clock_u)
    assert np.sqrt(np.mean(np.square(z))) < 1.7
    assert np.mean(u) < 20e-6


def test_stamps_that_leap_are_left_out() -> None:
    t, c = stamps(np.random.default_rng(1), jitter=1e-4)
    c[5000:5400] += 1.0
    log = session_with(t, c).log
    assert log.clock_rate == pytest.approx(1.0 + 1e-6 * PPM, abs=1e-7)


def test_the_rate_of_the_second_clock_is_in_u() -> None:
    t, c = stamps(np.random.default_rng(1), jitter=1e-5)
    assert session_with(t, c, ppm_u=3.0).log.clock_u == pytest.approx(3e-6, rel=0.01)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda t, c: (t, 1e-3 * c), "expected a clock that goes as the log's does"),
        (lambda t, c: (t, 0.0 * c), "expected at least 50 stamps at which it moves, found 1"),
        (lambda t, c: (t[:2000], c[:2000]), "expected to be compared over 30 s at least"),
    ],
)
def test_what_is_no_clock_is_refused(change: Any, words: str) -> None:
    with pytest.raises(InputError, match=words):
        session_with(*change(*stamps(np.random.default_rng(1), jitter=1e-4)))


def test_a_time_base_that_was_compared_corrects_the_scale_factors_of_the_gyros(tmp_path: Path) -> None:
    """A log of 200 ppm too short seconds: without the second clock the scale factors are 200 ppm off."""
    folder = session(tumble.Setup.of(grade="tactical", positions=15), seed=3)
    log = pl.read_parquet(folder / "log.parquet")
    t = log["t"].to_numpy()
    short = log.with_columns(pl.Series("t", t / (1.0 + 200e-6)), pl.Series("gps", 1.7e9 + t))
    text = (folder / "session.toml").read_text()
    found = {}
    for name, clock in (("alone", "clock_ppm_u = 0"), ("with", '[log.reference_clock]\ncolumn = "gps"\nppm_u = 0.0')):
        other = tmp_path / name
        other.mkdir()
        short.write_parquet(other / "log.parquet")
        head, _, tail = text.partition("[log.accel]")
        head = head.replace("clock_ppm_u = 0\n", "")
        (other / "session.toml").write_text(f"{head}{clock}\n\n[log.accel]{tail}")
        found[name] = tumble.calibrate(other)
    exact = tumble.calibrate(folder)
    for axis in "xyz":
        name = f"gyro.scale.{axis}"
        assert found["with"][name].value == pytest.approx(exact[name].value, abs=0.15 * (exact[name].u or 0.0))
        assert found["alone"][name].value - exact[name].value == pytest.approx(-200e-6, rel=0.03)
    assert any("+200.0 ppm" in note and "'gps'" in note for note in found["with"].provenance.notes)
    assert found["with"].provenance.clock_u < 1e-6
    made = found["with"]
    assert made.gyro is not None
    block = tumble.read_session(folder).gyro_block
    assert block is not None
    np.testing.assert_allclose(made.gyro.matrix, block.model(np.array([made[n].value for n in block.names])).matrix)


def test_every_session_of_one_estimate_is_read_by_its_own_clock(tmp_path: Path) -> None:
    """Of two sessions over temperature one has seconds that are 300 ppm too short, and the time of satellites beside
    them: the scale factors of both together are those of two good clocks, whichever session is the first, and u has the
    clock that is known worst."""
    setup = tumble.Setup.of(grade="tactical", positions=12)
    sound = []
    for k, celsius in enumerate(((10.0, 22.0), (30.0, 18.0))):
        profile = TemperatureProfile(celsius=celsius)
        folder = tmp_path / f"level-{k}"
        sound.append(tumble.simulate_session(folder, setup, seed=3, launch=k + 1, temperature=profile))
    short = tmp_path / "short"
    short.mkdir()
    log = pl.read_parquet(sound[0] / "log.parquet")
    t = log["t"].to_numpy()
    log = log.with_columns(pl.Series("t", t / (1.0 + 300e-6)), pl.Series("gps", 1.7e9 + t))
    log.write_parquet(short / "log.parquet")
    head, _, tail = (sound[0] / "session.toml").read_text().replace("clock_ppm_u = 0\n", "").partition("[log.accel]")
    clock = '[log.reference_clock]\ncolumn = "gps"\nppm_u = 0.1'
    (short / "session.toml").write_text(f"{head}{clock}\n\n[log.accel]{tail}")
    stated = sound[1] / "session.toml"
    stated.write_text(stated.read_text().replace("clock_ppm_u = 0\n", "clock_ppm_u = 5\n"))
    exact = calibrate_together(sound)
    for order in ((short, sound[1]), (sound[1], short)):
        made = calibrate_together(order)
        for axis in "xyz":
            name = f"gyro.scale.{axis}"
            assert made[name].value == pytest.approx(exact[name].value, abs=0.1 * (exact[name].u or 0.0))
            assert made[name].u == pytest.approx(exact[name].u, rel=0.01)
        assert made.provenance.clock_u == pytest.approx(5e-6)
        assert any(note.startswith("short: by 'gps'") and "+300.0 ppm" in note for note in made.provenance.notes)
        assert (
            "the clocks of the sessions are known to 0.1 to 5 ppm: u has that of level-1, the largest"
            in made.provenance.notes
        )


def test_increments_are_of_true_seconds() -> None:
    """A gravity of 9.8 m/s² in increments, by a clock whose seconds are 300 ppm too short: 9.8 m/s² by the second one,
    300 ppm more without it."""
    rng, count = np.random.default_rng(4), 12_000
    t = np.arange(1, count + 1) / RATE
    read = {"x": np.zeros(count), "y": np.zeros(count), "z": np.full(count, 9.8 / RATE)}
    noise = {name: values + 1e-6 * rng.standard_normal(count) for name, values in read.items()}
    found = []
    for reference in (None, {"column": "c", "ppm_u": 0.0}):
        log: dict[str, Any] = {"time": "t", "accel": {"columns": ["x", "y", "z"], "unit": "m/s"}}
        log |= {} if reference is None else {"reference_clock": reference}
        description = {"format": 1, "device": {"serial": "A"}, "log": log}
        session = tumble.session_of(description, {"t": t / (1.0 + 300e-6), "c": 1.7e9 + t, **noise})
        observed = tumble.inspect_session(session)
        assert observed.observations is not None
        found.append(float(observed.observations.rests.accel[:, 2].mean()))
    assert found[0] == pytest.approx(9.8 * (1.0 + 300e-6), rel=1e-6)
    assert found[1] == pytest.approx(9.8, rel=1e-6)
