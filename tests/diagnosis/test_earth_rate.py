"""What gyros that see the Earth's rate say of the latitude of the site and of the clock of the log."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from functools import cache

import numpy as np
import polars as pl
import pytest

from tests.support.shared import session
from tumble.diagnosis.carried_vertical import upside_down
from tumble.earth import EARTH_RATE
from tumble.planning.setup import Setup
from tumble.recording.arrays import session_of_arrays
from tumble.result.calibration import Calibration
from tumble.rotation import unit_vector
from tumble.run.calibrate import calibrate
from tumble.sensors.parameters import group_name, usual_sizes
from tumble.simulation.observations import simulate_observations
from tumble.simulation.scenario import scenario_of
from tumble.units import DEGREE

RATE = 50.0
SETUP = Setup.of(grade="navigation", positions=14, rest=30.0, sample_rate=RATE)


@cache
def calibrated(
    *, rate: float | None = None, stamps: float = 1.0, latitude: float = 0.0, measured: bool = True
) -> Calibration:
    """A session of a navigation unit of which the rate is stated, or the stamps are so many times too long, and the
    latitude is stated with an error, rad; gravity is measured, or that of the latitude."""
    log = pl.read_parquet(session(SETUP, seed=3) / "log.parquet")
    time = stamps * np.arange(1, len(log) + 1) / RATE
    return calibrate(
        accel=log.select("ax", "ay", "az").to_numpy(),
        gyro=log.select("gx", "gy", "gz").to_numpy(),
        latitude=SETUP.latitude + latitude,
        height=None if measured else 270.0,
        gravity=SETUP.gravity if measured else None,
        gravity_u=1e-5 if measured else None,
        serial="A",
        **({"time": time} if rate is None else {"rate": rate}),
    )


def errors(found: Calibration, group: str) -> list[float]:
    """Errors of the parameters of a group, in their u."""
    truth = json.loads((session(SETUP, seed=3) / "truth.json").read_text())
    members = [p for p in found.parameters if group_name(p.name) == group]
    return [(p.value - truth[p.name]) / p.u for p in members]


@pytest.mark.parametrize("clock", [1.01, 1.03, 0.95])
def test_the_earths_rate_corrects_a_stated_sample_rate_that_is_wrong(clock: float) -> None:
    found = calibrated(rate=RATE * clock)
    assert found.outcome.accepted
    said = "\n".join((*found.outcome.remarks, *found.provenance.notes))
    (longer,) = re.findall(r"a second of the log's clock is ([+-][\d.]+) % longer", said)
    assert float(longer) == pytest.approx(100.0 * (clock - 1.0), abs=0.3)
    assert not any("latitude" in each for each in found.outcome.remarks)
    assert found.provenance.clock_u < 2e-3  # one per cent without the Earth's rate
    for group in ("gyro.bias", "gyro.scale", "gyro.axis"):
        assert max(map(abs, errors(found, group))) < 4.0


def test_time_stamps_that_the_earths_rate_contradicts_are_corrected_and_remarked() -> None:
    found = calibrated(stamps=1.0 / 1.03)
    assert found.outcome.verdict == "accepted with scatter"
    assert any("a second of the log's clock is +3" in remark for remark in found.outcome.remarks)
    assert max(map(abs, errors(found, "gyro.scale"))) < 4.0


def test_a_clock_that_nothing_contradicts_is_believed() -> None:
    found = calibrated(rate=RATE)
    assert found.outcome.accepted
    assert not any("clock" in said for said in (*found.outcome.remarks, *found.provenance.notes))
    assert found.provenance.clock_u == 1e-2
    assert found.parameters == calibrated(rate=RATE).parameters


@pytest.mark.parametrize("error", [2.0, -10.0, 5.684 - 56.84])
def test_a_wrong_latitude_is_no_wrong_clock(error: float) -> None:
    """Up to a decimal point in the wrong place, far beyond where the Earth's rate is linear in the latitude."""
    found = calibrated(rate=RATE, latitude=error * DEGREE)
    assert found.outcome.gyro.verdict == "not accepted"
    (said,) = [each for each in found.outcome.reasons if "a latitude that the gyros contradict" in each]
    fitting = re.search(r"about (\d+)° would fit", said)
    assert fitting is not None
    assert float(fitting[1]) == pytest.approx(SETUP.latitude / DEGREE, abs=3.0)
    assert not any("clock" in each for each in (*found.outcome.reasons, *found.outcome.remarks))


def test_what_a_wrong_latitude_does_to_the_mean_bias_of_the_session_is_predicted() -> None:
    """The bias that is given is the mean over the session, which is better known than that of its process."""
    found = calibrated(latitude=4.0 * DEGREE)
    (times,) = re.findall(r"gyro.bias.* err by up to ([\d.]+) times", found.outcome.reasons[0])
    assert float(times) == pytest.approx(max(map(abs, errors(found, "gyro.bias"))), rel=0.25)
    assert found.outcome.of("gyro.bias").verdict == "not accepted"


def test_scale_factors_by_the_gravity_of_a_wrong_latitude_are_refused_with_it() -> None:
    """They were accepted all the same, off by 28 u; from gravity that was measured they are right."""
    found, measured = (calibrated(latitude=-10.0 * DEGREE, measured=each) for each in (False, True))
    assert max(map(abs, errors(found, "accel.scale"))) > 10.0
    assert found.outcome.of("accel.scale").verdict == "not accepted"
    assert max(map(abs, errors(measured, "accel.scale"))) < 4.0
    assert measured.outcome.of("accel.scale").verdict != "not accepted"


@pytest.mark.parametrize(("grade", "times", "named"), [("navigation", -1.0, True), ("tactical", -1.0, True),
                                                       ("mems", -1.7, False)])  # fmt: skip
def test_up_is_down_only_where_noise_and_g_sensitivity_let_the_earths_rate_tell(
    grade: str, times: float, named: bool
) -> None:
    """Readings may scatter by less than their noise, by chance: MEMS gyros do not see the Earth's rate all the same."""
    setup, rng = Setup.of(grade=grade, positions=10), np.random.default_rng(1)
    observations = simulate_observations(scenario_of(setup, rng), rng)
    up = unit_vector(observations.rests.accel)
    rests = replace(observations.rests, gyro=times * EARTH_RATE * np.sin(setup.latitude) * up)
    any_session = session_of_arrays(accel=np.full((9, 3), 5.66), rate=1.0, serial="A")
    sensitivity = usual_sizes(grade)["gyro.g_sensitivity"]
    assert bool(upside_down(replace(observations, rests=rests), any_session, sensitivity)) == named
