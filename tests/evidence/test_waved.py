"""Recordings by hand against attitudes by cameras: the scores, by motion that is known."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from evidence.case import Array, Case, Estimate
from evidence.pages import with_figures
from evidence.real import waved

pytestmark = pytest.mark.weekly

RATE = 100.0
BETWEEN = Rotation.from_rotvec([0.02, -0.03, 0.01]).as_matrix()
"""Sensors → markers."""


@pytest.fixture(scope="module")
def seen() -> waved.Seen:
    """Thirty seconds of a device that turns about an axis which wanders, with perfect gyros, a perfect magnetometer and
    cameras whose markers are askew."""
    t = np.arange(int(30.0 * RATE)) / RATE
    rates = np.stack([np.sin(0.9 * t), np.cos(0.7 * t), 0.6 * np.sin(0.4 * t + 1.0)], axis=1)
    R, attitudes = Rotation.identity(), np.empty((len(t), 3, 3))
    for k, step in enumerate(Rotation.from_rotvec(rates / RATE)):
        R = R * step
        attitudes[k] = R.as_matrix()
    field = 45.0 * np.array([0.4, 0.0, -0.9165]) @ attitudes
    case = Case(
        name="waved", kind="waved", time=t + 1.0 / RATE, accel=np.tile([0.0, 0.0, 9.81], (len(t), 1)), gyro=rates,
        mag=field, mag_field=45.0, gravity=9.81, gravity_u=0.0,
    )  # fmt: skip
    return waved.Seen(case=case, attitudes=attitudes @ BETWEEN.T, known=np.ones(len(t), dtype=bool))


def perfect(seen: waved.Seen) -> tuple[Array, Array]:
    assert seen.case.gyro is not None
    assert seen.case.mag is not None
    return seen.case.gyro, seen.case.mag


def test_perfect_sensors_miss_nothing_though_the_markers_are_askew(seen: waved.Seen) -> None:
    scores = waved.scores_of(*perfect(seen), seen)
    assert scores["turn"] == pytest.approx(0.0, abs=1e-7)
    assert scores["field"] == pytest.approx(0.0, abs=1e-7)


def test_a_bias_that_is_left_is_five_seconds_of_it(seen: waved.Seen) -> None:
    """In turns about an axis that wanders less than it does: between a third of it and all."""
    rates, field = perfect(seen)
    turn = waved.scores_of(rates + 2e-3 * np.array([0.0, 0.6, 0.8]), field, seen)["turn"]
    assert turn is not None
    assert 3e-3 < turn < 1.0e-2


def test_hard_iron_turns_the_field_with_the_device(seen: waved.Seen) -> None:
    """0.9 µT across a field of 45 µT: up to 20 mrad, 14 mrad and less in the mean."""
    rates, field = perfect(seen)
    angle = waved.scores_of(rates, field + np.array([0.9, 0.0, 0.0]), seen)["field"]
    assert angle is not None
    assert 7e-3 < angle < 2e-2
    assert waved.scores_of(rates, np.full_like(field, np.nan), seen)["field"] is None


def test_readings_are_corrected_by_what_a_program_knows(seen: waved.Seen) -> None:
    found = Estimate(gyro_bias=np.array([0.1, 0.0, 0.0]), mag=2.0 * np.eye(3), mag_bias=np.array([1.0, 2.0, 3.0]))
    rates, field = waved.corrected(found, seen.case)
    gyro, mag = perfect(seen)
    np.testing.assert_allclose(rates, gyro - [0.1, 0.0, 0.0])
    np.testing.assert_allclose(field, 0.5 * (mag - [1.0, 2.0, 3.0]))
    assert np.isnan(waved.corrected(Estimate(gyro_bias=np.zeros(3)), seen.case)[1]).all()


def test_the_table_has_what_is_stored_and_brackets_what_is_not_accepted() -> None:
    rows = [
        {"case": "broad 02", "program": "one", "said": "", "accepted": True, "turn": 0.0081, "field": 0.033},
        {"case": "broad 02", "program": "other", "said": "not", "accepted": False, "turn": 0.0123, "field": None},
        {"case": "broad 02", "program": "third", "said": "fewer than 12 rests"},
    ]
    lines = waved.waved_table({"rows": rows}).splitlines()
    assert lines[0] == "| program | turn, 02 | field, 02 |"
    assert lines[2:] == ["| one | 8.1 | 33 |", "| other | (12) | – |", "| third | – | – |"]


def test_figures_name_the_state_of_these_results() -> None:
    if waved.RESULTS.exists():
        commit = waved.read_results()["made"]["commit"]
        assert not commit.endswith("changed")
        assert f"-->{commit[:12]}<!--" in with_figures("x <!-- figure: waved | made | commit -->?<!-- end -->", {})
