"""Real recordings of the benchmark: how they are read, the scores without a reference, the page."""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from scipy.spatial.transform import Rotation

from evidence.case import NAMES, Case, Estimate, matrix_of
from evidence.peers.rests import found
from evidence.real import get
from evidence.real.cases import cases, normal_gravity, psins_truth
from evidence.real.page import predicted, read_results, real_losses, repeated, sources
from evidence.real.run import content_of, found_from
from evidence.real.scores import FEWEST, folds, prediction, repeatability

pytestmark = pytest.mark.weekly

GRAVITY = 9.81


def device(seed: int) -> dict[str, float]:
    rng = np.random.default_rng(seed)
    size = {"bias": 0.02, "scale": 0.005, "axis": 0.004}
    return {name: float(size[name.split(".")[1]] * rng.normal()) for name in NAMES}


def perfect(truth: dict[str, float]) -> Estimate:
    """The truth as an estimate."""
    biases = (np.array([truth[f"{kind}.bias.{axis}"] for axis in "xyz"]) for kind in ("accel", "gyro"))
    accel_bias, gyro_bias = biases
    return Estimate(
        accel=matrix_of(truth, "accel"), accel_bias=accel_bias, gyro=matrix_of(truth, "gyro"), gyro_bias=gyro_bias
    )  # fmt: skip


def turned_about(truth: dict[str, float], count: int) -> Case:
    """So many rests of 3 s with turns of 2 s at a constant rate between them, 100 Hz, no Earth's rate."""
    rng = np.random.default_rng(9)
    attitude, ups, rates = np.eye(3), [], []
    for _ in range(count):
        ups.append(np.tile(attitude.T @ [0.0, 0.0, 1.0], (300, 1)))
        rates.append(np.zeros((300, 3)))
        turn = Rotation.from_rotvec(1.2 * rng.normal(size=3))
        steps = [attitude @ Rotation.from_rotvec(turn.as_rotvec() * k / 200.0).as_matrix() for k in range(1, 201)]
        ups.append(np.array([one.T @ [0.0, 0.0, 1.0] for one in steps]))
        rates.append(np.tile(turn.as_rotvec() / 2.0, (200, 1)))
        attitude = steps[-1]
    force, rate = GRAVITY * np.concatenate(ups), np.concatenate(rates)
    ideal = perfect(truth)
    accel, gyro = (
        values @ np.asarray(matrix).T + bias
        for values, matrix, bias in ((force, ideal.accel, ideal.accel_bias), (rate, ideal.gyro, ideal.gyro_bias))
    )
    accel = accel + 1e-4 * rng.normal(size=accel.shape)
    return Case(
        name="turned", kind="turned", time=np.arange(1, len(accel) + 1) / 100.0, accel=accel, gyro=gyro,
        gravity=GRAVITY, gravity_u=0.0,
    )  # fmt: skip


# -------------------- scores --------------------


def test_a_perfect_calibration_predicts_rests_and_turns() -> None:
    truth = device(1)
    case = turned_about(truth, 12)
    made = prediction(perfect(truth), case)
    assert (made.rests, made.turns) == (12, 11)
    assert made.force == pytest.approx(0.0, abs=3e-5)
    assert made.tilt == pytest.approx(0.0, abs=3e-5)


def test_what_is_wrong_with_a_calibration_is_in_its_prediction() -> None:
    """A bias of 10 mm/s² misses the length of g by that times the cosine to its axis, a scale factor of gyros off by
    1 % misses a turn by up to 1 % of its angle, a bias of gyros by nothing, since it is read anew."""
    truth = device(1)
    case, exact = turned_about(truth, 12), perfect(truth)
    assert exact.accel is not None
    assert exact.accel_bias is not None
    assert exact.gyro is not None
    assert exact.gyro_bias is not None
    biased = prediction(replace(exact, accel_bias=exact.accel_bias + np.array([0.01, 0.0, 0.0])), case)
    up = np.linalg.solve(exact.accel, (found(case).accel - exact.accel_bias).T).T / GRAVITY
    assert biased.force == pytest.approx(0.01 * np.sqrt(np.mean(up[:, 0] ** 2)), rel=0.02)
    scaled = prediction(replace(exact, gyro=1.01 * exact.gyro), case)
    assert scaled.tilt is not None
    assert 0.003 < scaled.tilt < 0.03
    shifted = prediction(replace(exact, gyro_bias=exact.gyro_bias + 0.05), case)
    assert shifted.tilt == pytest.approx(0.0, abs=3e-5)


def test_the_shape_of_an_ellipsoid_knows_no_bias() -> None:
    truth = device(1)
    case, exact = turned_about(truth, 12), perfect(truth)
    assert exact.accel is not None
    assert exact.accel_bias is not None
    shifted = prediction(replace(exact, accel_bias=exact.accel_bias + 0.02), case)
    assert shifted.force is not None
    assert shifted.force > 5e-3
    assert shifted.shape == pytest.approx(0.0, abs=5e-5)
    stretched = prediction(replace(exact, accel=exact.accel * np.array([1.001, 1.0, 1.0])), case)
    assert stretched.shape is not None
    assert 5e-4 < stretched.shape < 9.81e-3


def test_sensors_that_the_program_does_not_stand_by_predict_nothing() -> None:
    truth = device(1)
    refused = replace(perfect(truth), accepted=False, refused=frozenset({"gyro"}))
    made = prediction(refused, turned_about(truth, 12))
    assert made.force is not None
    assert made.tilt is None


def test_folds_share_no_sample_and_hold_out_a_quarter_of_the_rests() -> None:
    case = turned_about(device(2), 20)
    both = folds(case)
    assert len(both) == 2
    for fitted, held in both:
        assert not set(fitted.time) & set(held.time)
        assert (len(found(fitted).accel), len(found(held).accel)) == (15, 5)
    assert folds(turned_about(device(2), FEWEST)) == []


def test_repeatability_is_the_scatter_over_sessions_and_over_u() -> None:
    """12 devices of 9 sessions, scatter 1e-4, u as it is: a group of three has 288 degrees of freedom: its
    standard deviation is known to 4.2 %, its mean square over u to 8.3 %; three sigma."""
    rng = np.random.default_rng(11)
    devices = []
    for number in range(12):
        truth = device(number)
        devices.append(
            [
                replace(
                    perfect({name: value + 1e-4 * rng.normal() for name, value in truth.items()}),
                    u=dict.fromkeys(NAMES, 1e-4),
                )
                for _ in range(9)
            ]
        )
    made = repeatability(devices)
    assert made.degrees["accel.scale"] == 12 * 3 * 8
    for group, deviation in made.deviation.items():
        assert deviation == pytest.approx(1e-4, rel=0.13)
        assert made.over_u[group] == pytest.approx(1.0, abs=0.26)


def test_an_estimate_comes_back_from_its_file() -> None:
    truth = device(4)
    estimate = replace(perfect(truth), u={"accel.bias.x": 1e-3}, accepted=False, refused=frozenset({"gyro"}))
    back = found_from(json.loads(json.dumps(content_of(estimate))))
    assert isinstance(back, Estimate)
    assert back.refused == {"gyro"}
    assert back.u == estimate.u
    np.testing.assert_array_equal(np.asarray(back.accel), np.asarray(estimate.accel))


# -------------------- recordings --------------------


def test_normal_gravity_is_that_of_the_tables() -> None:
    """GRS80 at 45°: 9.806199203 m/s² (Moritz 2000); 0.3086 mGal a metre."""
    assert normal_gravity(np.pi / 4.0, 0.0) == pytest.approx(9.806199203, abs=2e-9)
    assert normal_gravity(np.pi / 4.0, 1000.0) == pytest.approx(9.806199203 - 3.086e-3, abs=2e-9)


def test_the_scale_factors_of_psins_are_lengths_of_rows() -> None:
    """30 ppm on the diagonal, with angles of 50″ and 60″: 29.929 ppm."""
    assert psins_truth()["gyro.scale.z"] == pytest.approx(-29.928e-6, abs=2e-9)


@pytest.mark.data
def test_the_packets_of_the_array_are_decoded_as_its_table_has_them(data: Path) -> None:
    files = get.named("mimu4444").files
    if not all(get.place_of(get.named("mimu4444"), file).exists() for file in files):
        pytest.skip("python -m evidence.real.get brings the packets")
    table = pl.read_parquet(data / "mimu4444" / "exp_3.parquet")
    for case in cases("mimu4444"):
        if not case.name.startswith("mimu4444 session 3 "):
            continue
        chip = case.name[-1]
        assert case.gyro is not None
        counts = table.select(f"a{chip}x", f"a{chip}y", f"a{chip}z").to_numpy()
        np.testing.assert_allclose(case.accel * 2048.0 / 9.80665, counts, atol=1e-9)
        counts = table.select(f"g{chip}x", f"g{chip}y", f"g{chip}z").to_numpy()
        np.testing.assert_allclose(np.degrees(case.gyro) * 16.4, counts, atol=1e-9)
        np.testing.assert_allclose(case.time, table["t"].to_numpy(), atol=1e-6)


def test_a_file_that_has_changed_is_not_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TUMBLE_EVIDENCE_DATA", str(tmp_path))
    right = hashlib.sha256(b"right").hexdigest()
    source = get.Source(name="s", title="", licence="MIT", repository="o/n", commit="c", files={"a/b.csv": right})
    for content, said in ((b"wrong", "not kept"), (b"right", "fetched"), (b"wrong", "there")):
        monkeypatch.setattr(get, "content", lambda *_, content=content: content)
        assert get.get(source, "a/b.csv").startswith(said)
    assert get.place_of(source, "a/b.csv").read_bytes() == b"right"


def test_every_table_of_the_page_is_made_and_losses_come_by_name() -> None:
    results = read_results()
    for made in (predicted(results, "force", 1.0), repeated(results), sources(results)):
        assert made.startswith("| ")
    ahead = [
        {**row, "shape": 0.5 * row["shape"]} if row["program"] == "ArduPilot ellipsoid" and "shape" in row else row
        for row in results["predictions"]
    ]
    assert "ArduPilot ellipsoid" in real_losses({**results, "predictions": ahead})
    assert "ArduPilot ellipsoid" not in real_losses(results)
