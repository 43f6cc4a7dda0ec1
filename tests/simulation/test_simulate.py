"""Simulated sessions: are they the truth they claim to be?"""

from __future__ import annotations

import json
import math
import tomllib
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from tumble.earth import earth_rate, normal_gravity
from tumble.errors import InputError
from tumble.planning.setup import Setup
from tumble.programme.positions import from_attitudes, programme
from tumble.recording.session_file import read_session
from tumble.rotation import rotation_matrix, rotation_vector
from tumble.sensors.grades import GRADES, NoiseModel
from tumble.sensors.model import Block
from tumble.simulation.recording import Recording, record
from tumble.simulation.scenario import Scenario, Vibration, draw_parameters, itinerary
from tumble.simulation.session import simulate_session, vibration_of, write_simulation
from tumble.units import DEGREE, Array

UP = np.array([0.0, 1.0, 0.0])
LATITUDE = 56.84 * DEGREE
TRIAD = np.eye(3)
TETRAD = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1 / 3**0.5] * 3])
QUIET, STILL = NoiseModel(), Vibration()
SHORT = Setup(
    programme=programme("rough-table"),
    table_error=2 * DEGREE,
    mounting_error=2 * DEGREE,
    first_rest=1.303,
    rest=1.007,
    turn_rate=80 * DEGREE,
    ramp=0.5,
    sample_rate=100.0,
    noise=QUIET,
    latitude=LATITUDE,
    height=270.0,
    gravity=normal_gravity(LATITUDE, 270.0) + 1e-3,
    gravity_u=1e-7,
)
SLOW = replace(SHORT, turn_rate=10 * DEGREE, ramp=1.0)


def scenario(
    setup: Setup = SHORT, *, axes: Array = TRIAD, perfect: bool = False, vibration: Vibration = STILL
) -> Scenario:
    """A noiseless MEMS unit, or a perfect one, unless something else is asked for."""
    accel, gyro = Block(kind="accel", axes=axes), Block(kind="gyro", axes=axes)
    truth = draw_parameters(GRADES["mems"], (accel, gyro), np.random.default_rng(5))
    return Scenario(
        setup=setup,
        accel=accel,
        gyro=gyro,
        truth=dict.fromkeys(truth, 0.0) if perfect else truth,
        vibration=vibration,
        serial="S-1",
    )


def run(made: Scenario, seed: int = 1) -> Recording:
    return record(made, np.random.default_rng(seed))


def models(made: Scenario) -> tuple[Array, Array, Array, Array]:
    """Matrix and bias of accelerometers and gyros."""
    accel, gyro = (
        block.model(np.array([made.truth[name] for name in block.names])) for block in (made.accel, made.gyro)
    )
    return accel.matrix, accel.bias, gyro.matrix, gyro.bias


def inside(recording: Recording, rest: int, fs: float) -> slice:
    """The samples that lie wholly in a rest."""
    start, stop = recording.rests[rest]
    return slice(math.ceil(start * fs - 1e-6), math.floor(stop * fs + 1e-6))


# -------------------- kinematics --------------------


@pytest.mark.parametrize("by_hand", [None, 6], ids=["table", "hand"])
@pytest.mark.parametrize("axes", [TRIAD, TETRAD], ids=["triad", "tetrad"])
def test_noiseless_rests_read_gravity_and_the_earths_rate(by_hand: int | None, axes: Array) -> None:
    made = scenario(replace(SHORT, by_hand=by_hand), axes=axes)
    found = run(made)
    S_a, b_a, S_g, b_g = models(made)
    assert found.accel.shape == found.gyro.shape == (len(found.time), len(axes))
    for i, L in enumerate(found.attitudes):
        samples = inside(found, i, made.setup.sample_rate)
        accel = S_a @ (made.site.gravity * L.T @ UP) + b_a
        gyro = S_g @ (L.T @ earth_rate(LATITUDE)) + b_g
        assert samples.stop - samples.start >= 99
        np.testing.assert_allclose(found.accel[samples] - accel, 0.0, atol=1e-14)
        np.testing.assert_allclose(found.gyro[samples] - gyro, 0.0, atol=1e-17)


def fine_means(made: Scenario, found: Recording, i: int, sample: int) -> tuple[Array, Array]:
    """Mean specific force and rate of a sample of the move from rest i, by Simpson's rule on a fine grid over
    each part of the sample in which the law of the rate is one formula."""
    p, fs = made.profile, made.setup.sample_rate
    total = float(np.linalg.norm(found.moves[i]))
    n = found.moves[i] / total
    # rate: a raised cosine, constant, a raised cosine; the area is the angle
    T = max(total / p.rate, p.ramp) + p.ramp
    peak = total / (T - p.ramp)

    def rate(t: Array) -> Array:
        into = np.clip(np.minimum(t, T - t), 0.0, p.ramp)
        return np.asarray(0.5 * peak * (1.0 - np.cos(math.pi * into / p.ramp)))

    def angle(t: float) -> float:
        knots = [0.0, p.ramp, T - p.ramp, T]
        ends = [min(max(k, 0.0), t) for k in knots]
        return sum(simpson(np.linspace(a, b, 2001), rate) for a, b in pairwise(ends))

    start = found.rests[i, 1]
    begin, end = sample / fs - start, (sample + 1) / fs - start
    borders = [begin, *(k for k in (0.0, p.ramp, T - p.ramp, T) if begin < k < end), end]
    force, turning = np.zeros(3), np.zeros(3)
    for a, b in pairwise(borders):
        t = np.linspace(a, b, 201)
        theta = np.array([angle(min(max(x, 0.0), T)) for x in t])
        L_T = np.swapaxes(rotation_matrix(theta[:, None] * n) @ found.attitudes[i], -1, -2)
        v = made.vibration.amplitude * np.sin(2 * np.pi * made.vibration.frequency * (t + start))
        f = (made.site.gravity + v)[:, None] * (L_T @ UP)
        w = (L_T @ (np.array(earth_rate(LATITUDE)) + rate(t)[:, None] * n)[..., None])[..., 0]
        weights = np.ones(201)
        weights[1:-1:2], weights[2:-1:2] = 4.0, 2.0
        force += weights @ f * (b - a) / 600.0
        turning += weights @ w * (b - a) / 600.0
    return force * fs, turning * fs


def simpson(t: Array, function: object) -> float:
    assert callable(function)
    y = function(t)
    return float((y[0] + y[-1] + 4 * y[1:-1:2].sum() + 2 * y[2:-1:2].sum()) * (t[1] - t[0]) / 3.0)


@pytest.mark.parametrize(
    ("setup", "vibration"),
    [
        (SHORT, STILL),
        (replace(SHORT, sample_rate=10.0), STILL),
        (replace(SLOW, turn_rate=500 * DEGREE), STILL),  # the ramps are the whole move
        (SHORT, Vibration(amplitude=0.5, frequency=23.0)),
        (SHORT, Vibration(amplitude=0.5, frequency=470.0)),  # above the sample rate
    ],
    ids=["100 Hz", "10 Hz", "short moves", "vibration", "fast vibration"],
)
def test_samples_are_means_over_their_intervals(setup: Setup, vibration: Vibration) -> None:
    made = scenario(setup, vibration=vibration, perfect=True)
    found = run(made)
    fs = setup.sample_rate
    for i in (3,):
        first, last = math.floor(found.rests[i, 1] * fs), math.floor(found.rests[i + 1, 0] * fs)
        for sample in (first, (first + last) // 2, last):
            force, rate = fine_means(made, found, i, sample)
            np.testing.assert_allclose(found.accel[sample], force, atol=1e-11)
            np.testing.assert_allclose(found.gyro[sample], rate, atol=1e-11)


def test_vibration_at_rest_is_averaged_over_the_sample() -> None:
    made = scenario(vibration=Vibration(amplitude=0.5, frequency=30.0), perfect=True)
    found, quiet = run(made), run(replace(made, vibration=STILL))
    samples = inside(found, 0, 100.0)
    t = (found.time[samples] - np.array([[0.01], [0.0]])) * 2.0 * math.pi * 30.0
    mean = 0.5 * (np.cos(t[0]) - np.cos(t[1])) / (2.0 * math.pi * 30.0) * 100.0  # ∫ sin over the sample
    expected = np.outer(mean, found.attitudes[0].T @ UP)
    np.testing.assert_allclose((found.accel - quiet.accel)[samples], expected, atol=1e-12)
    np.testing.assert_allclose(found.gyro, quiet.gyro, atol=1e-16)


# -------------------- the course --------------------


@pytest.mark.parametrize("seed", range(2))
def test_gyros_see_programmed_turns_in_the_programmed_direction(seed: int) -> None:
    """Lᵀn is constant in a turn about n, so the integral of the body rate gives the signed angle."""
    made = scenario(replace(SHORT, sample_rate=20.0), perfect=True)
    found = run(made, seed)
    for i, move in enumerate(made.setup.programme.moves):
        start, stop = (round(x * 20.0) for x in (found.rests[i, 1], found.rests[i + 1, 0]))
        turned = found.attitudes[i] @ found.gyro[start - 2 : stop + 2].sum(axis=0) / 20.0
        if move.axis is None or move.angle is None:
            assert np.linalg.norm(turned) < math.pi
        else:
            off = np.linalg.norm(turned - move.angle * move.axis)
            assert off < 12 * DEGREE  # errors of both ends, 2° in each of three axes


def test_turns_beyond_180_degrees_go_on_in_their_direction() -> None:
    moves = np.array([itinerary(scenario(), np.random.default_rng(seed)).moves[0] for seed in range(40)])
    angles = np.linalg.norm(moves, axis=1)
    assert (moves[:, 0] > 0.0).all()
    assert 10 <= (angles > math.pi).sum() <= 30


def test_attitudes_are_the_programme_with_one_mounting_error_and_an_error_at_every_position() -> None:
    only_table = replace(SHORT, mounting_error=0.0)
    only_mounting = replace(SHORT, table_error=0.0)
    nominal = np.array([p.matrix for p in SHORT.programme.positions])
    table = run(scenario(only_table)).attitudes @ np.swapaxes(nominal, -1, -2)
    mounting = np.swapaxes(nominal, -1, -2) @ run(scenario(only_mounting)).attitudes
    np.testing.assert_allclose(mounting, mounting[:1].repeat(15, axis=0), atol=1e-15)
    errors = np.array([rotation_vector(R) for R in (*table, mounting[0])])
    assert np.abs(errors).max() < 2 * DEGREE
    assert np.abs(errors).max(axis=0).min() > 1 * DEGREE
    assert np.linalg.matrix_rank(errors[:15] - errors[0]) == 3


def test_a_cube_stands_in_any_order_and_azimuth() -> None:
    cube = replace(SHORT, programme=programme("cube-26"), table_error=0.0, mounting_error=0.0, sample_rate=10.0)
    found = run(scenario(cube))
    assert sorted(found.positions) == list(range(26))
    assert list(found.positions) != list(range(26))
    nominal = np.array([cube.programme.positions[i].vertical_b for i in found.positions])
    np.testing.assert_allclose(found.attitudes[:, 1, :], nominal, atol=1e-15)
    north = found.attitudes[:, 0, :] - np.array([cube.programme.positions[i].matrix[0] for i in found.positions])
    assert np.linalg.norm(north, axis=1).min() > 1e-3


def test_hand_held_positions_have_any_orientation() -> None:
    found = itinerary(scenario(replace(SHORT, by_hand=400)), np.random.default_rng(1))
    for axis in range(3):  # each component of a random direction is uniform on −1…1: mean 0, variance 1/3
        u = found.attitudes[:, 1, axis]
        assert abs(u.mean()) < 5 * math.sqrt(1 / 3 / 400)
        assert abs((u**2).mean() - 1 / 3) < 5 * math.sqrt(4 / 45 / 400)
    assert np.linalg.norm(found.moves, axis=1).max() <= math.pi


def test_rests_last_as_long_as_asked_and_moves_as_their_angles_need() -> None:
    found = run(scenario(SLOW))
    durations = found.rests[:, 1] - found.rests[:, 0]
    np.testing.assert_allclose(durations, [1.303] + [1.007] * 14, atol=1e-12)
    angles = np.linalg.norm(found.moves, axis=1)
    np.testing.assert_allclose(found.rests[1:, 0] - found.rests[:-1, 1], angles / SLOW.turn_rate + 1.0, atol=1e-12)
    np.testing.assert_allclose(np.diff(found.time), 0.01, atol=1e-12)
    assert found.time[0] == 0.01
    assert found.rests[-1, 1] - 0.01 < found.time[-1] <= found.rests[-1, 1] + 1e-9
    speed = np.linalg.norm(run(scenario(SLOW, perfect=True)).gyro, axis=1)
    assert speed.max() == pytest.approx(10 * DEGREE, rel=1e-3)


# -------------------- noise --------------------


def test_white_noise_has_its_density() -> None:
    noise = NoiseModel(accel_white=2e-3, gyro_white=3e-4)
    made = scenario(replace(SHORT, programme=from_attitudes(["NUE"]), first_rest=500.0, sample_rate=64.0, noise=noise))
    accel = run(made).accel - run(made.changed(noise=QUIET)).accel
    gyro = run(made).gyro - run(made.changed(noise=QUIET)).gyro
    n = len(accel)
    assert n == 32000
    for found, density in ((accel, 2e-3), (gyro, 3e-4)):
        z = found / (density * 8.0)  # √64 Hz
        # five standard deviations: 6e-7 a figure
        assert np.abs((z**2).mean(axis=0) - 1.0).max() < 5 * math.sqrt(2 / n)
        assert np.abs(z.mean(axis=0)).max() < 5 / math.sqrt(n)
        assert np.abs((z[1:] * z[:-1]).mean(axis=0)).max() < 5 / math.sqrt(n)
        assert abs((z[:, 0] * z[:, 1]).mean()) < 5 / math.sqrt(n)


def test_instability_without_a_correlation_time_is_a_bias_for_a_rest_and_the_move_after_it() -> None:
    noise = NoiseModel(accel_instability=2e-3, gyro_instability=3e-4, instability_time=0.0)
    made = scenario(replace(SHORT, by_hand=60, sample_rate=5.0, noise=noise))
    found, quiet = run(made), run(made.changed(noise=QUIET))
    first = np.array([inside(found, i, 5.0).start for i in range(60)])
    for noisy, clean, sigma in ((found.accel, quiet.accel, 2e-3), (found.gyro, quiet.gyro, 3e-4)):
        drawn = (noisy - clean)[first]
        held = np.repeat(drawn, np.diff(np.append(first, len(noisy))), axis=0)
        np.testing.assert_allclose(noisy - clean, held, atol=1e-14)
        z = drawn / sigma
        assert np.abs((z**2).mean(axis=0) - 1.0).max() < 5 * math.sqrt(2 / 60)
        assert np.abs(z.mean(axis=0)).max() < 5 / math.sqrt(60)


def test_in_run_biases_stay_for_a_rest_and_go_straight_to_the_next() -> None:
    noise = NoiseModel(accel_instability=2e-3, gyro_instability=3e-4, instability_time=5.0)
    made = scenario(replace(SHORT, by_hand=6, sample_rate=20.0, noise=noise))
    found, quiet = run(made), run(made.changed(noise=QUIET))
    for noisy, clean in ((found.accel, quiet.accel), (found.gyro, quiet.gyro)):
        bias = noisy - clean
        for i in range(6):
            assert np.ptp(bias[inside(found, i, 20.0)], axis=0).max() < 1e-13
        for i in range(5):
            move = bias[inside(found, i, 20.0).stop - 1 : inside(found, i + 1, 20.0).start + 1]
            assert np.abs(np.diff(move[2:-2], 2, axis=0)).max() < 1e-13
            assert (
                np.abs(move.mean(axis=0) - 0.5 * (move[0] + move[-1])).max() < 0.05 * np.abs(move[-1] - move[0]).max()
            )


def test_sessions_without_in_run_bias_do_not_depend_on_its_correlation_time() -> None:
    white = replace(GRADES["mems"].noise, accel_instability=0.0, gyro_instability=0.0)
    first, second = (
        run(scenario(replace(SHORT, noise=replace(white, instability_time=time)))) for time in (0.0, 300.0)
    )
    np.testing.assert_array_equal(first.accel, second.accel)
    np.testing.assert_array_equal(first.gyro, second.gyro)


# -------------------- grades --------------------


@pytest.mark.parametrize("grade", GRADES)
def test_drawn_parameters_have_the_spreads_of_their_grade(grade: str) -> None:
    blocks = [Block(kind=kind, axes=TRIAD) for kind in ("accel", "gyro")]
    rng = np.random.default_rng(0)
    draws = [draw_parameters(GRADES[grade], blocks, rng) for _ in range(400)]
    for kind in ("accel", "gyro"):
        for what in ("bias", "scale", "axis"):
            values = [v for d in draws for k, v in d.items() if k.startswith(f"{kind}.{what}")]
            spread = getattr(getattr(GRADES[grade], kind), what)
            assert abs(np.mean(np.square(values)) / spread**2 - 1.0) < 5 * math.sqrt(2 / len(values))


# -------------------- folders --------------------

QUICK = Setup.of(rest=0.5, rate_deg_s=90.0, sample_rate=20.0)


def content(folder: Path) -> dict[str, Any]:
    return tomllib.loads((folder / "session.toml").read_text(encoding="utf-8"))


def test_truth_has_the_values_of_every_parameter_and_the_log_was_made_with_them(tmp_path: Path) -> None:
    folder = simulate_session(tmp_path / "launch", replace(QUICK, noise=NoiseModel()), seed=3)
    truth = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    blocks = [Block(kind=kind, axes=TRIAD) for kind in ("accel", "gyro")]
    assert tuple(truth) == blocks[0].names + blocks[1].names
    assert len(set(truth.values())) == 21
    frame = pl.read_parquet(folder / "log.parquet")
    model = blocks[0].model(np.array([truth[name] for name in blocks[0].names]))
    rest = frame.select("ax", "ay", "az").head(9).to_numpy()
    np.testing.assert_allclose(np.linalg.norm(model.apply(rest), axis=1), content(folder)["site"]["gravity"])


def test_the_same_seed_gives_the_same_session_and_another_one_does_not(tmp_path: Path) -> None:
    logs = {}
    for name, seed in (("a", 3), ("b", 3), ("c", 4)):
        folder = simulate_session(tmp_path / name, QUICK, seed=seed)
        logs[name] = pl.read_parquet(folder / "log.parquet")
    assert logs["a"].equals(logs["b"])
    assert (tmp_path / "a" / "truth.json").read_bytes() == (tmp_path / "b" / "truth.json").read_bytes()
    assert abs(logs["a"]["gx"].head(5) - logs["c"]["gx"].head(5)).min() != 0.0


def test_csv_and_parquet_hold_the_same_numbers_to_the_last_bit(tmp_path: Path) -> None:
    a = simulate_session(tmp_path / "a", QUICK, seed=3, log_format="csv")
    b = simulate_session(tmp_path / "b", QUICK, seed=3)
    assert content(a)["log"]["file"] == "log.csv"
    assert pl.read_csv(a / "log.csv").equals(pl.read_parquet(b / "log.parquet"))


def test_hand_held_sessions_name_no_programme(tmp_path: Path) -> None:
    folder = simulate_session(tmp_path / "launch", Setup.of(grade="mems", positions=5), seed=3)
    assert "programme" not in content(folder)
    t = pl.read_parquet(folder / "log.parquet")["t"]
    assert 60.0 < t[-1] < 60.0 + 4 * (180 / 80 + 0.5)  # 40 s and four times 5 s, and four moves
    assert t[1] - t[0] == pytest.approx(0.01)


def test_redundant_blocks_and_listed_positions_are_written_as_the_session_needs_them(tmp_path: Path) -> None:
    listed = from_attitudes(["NUE", "NUE N+45"])
    made = scenario(replace(SHORT, programme=listed, table_error=0.0, mounting_error=0.0), axes=TETRAD)
    folder = write_simulation(tmp_path / "launch", made, np.random.default_rng(0), log_format="csv")
    said = content(folder)
    assert said["programme"] == {"position": [{"attitude": "NUE"}, {"attitude": "NUE N+45"}]}
    assert said["log"]["accel"] == {
        "columns": ["a0", "a1", "a2", "a3"], "unit": "m/s^2", "axes": TETRAD.tolist(),
    }  # fmt: skip
    assert pl.read_csv(folder / "log.csv").columns == ["t", *(f"{k}{p}" for k in "ag" for p in range(4))]
    truth = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    assert "accel.axis.3.2" in truth
    assert len(truth) == 13 + 16


def test_a_session_reads_back_as_the_scenario_it_was_made_of(tmp_path: Path) -> None:
    made = scenario(axes=TETRAD)
    session = read_session(write_simulation(tmp_path / "launch", made, np.random.default_rng(0)))
    assert session.device.serial == made.serial
    assert session.site.latitude == pytest.approx(made.site.latitude, rel=1e-14)
    assert (session.site.gravity, session.site.gravity_u) == (made.site.gravity, made.site.gravity_u)
    assert session.gyro_block is not None
    assert session.accel_block.names + session.gyro_block.names == tuple(made.truth)
    np.testing.assert_allclose(session.accel_block.axes, TETRAD, rtol=1e-15)


# -------------------- bad input --------------------


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ({"grade": "navigaton"}, "found 'navigaton'; did you mean 'navigation'?"),
        ({"programme": "rough"}, "programme: expected one of rough-table"),
        ({"positions": 0}, "positions: expected at least 1, found 0"),
        ({"rest": 0.01}, "rest: expected at least two samples, 0.02 s, found 0.01 s"),
        ({"rest": math.nan}, "found nan s"),
        ({"rest": 1e9}, "session: expected at most 3e+07 samples, found 1.5e+12"),
        ({"rate_deg_s": 0.0}, "rate: expected more than 0, in deg/s, found 0"),
        ({"rate_deg_s": 1e-9}, "session: expected at most 3e+07 samples"),
        ({"sample_rate": 0.0}, "sample rate: expected more than 0, in Hz, found 0"),
        ({"table_error_deg": -1.0}, "table error: expected 0 or more, in deg, found -1"),
        ({"mounting_error_deg": math.nan}, "mounting error: expected 0 or more, in deg, found nan"),
        ({"latitude_deg": 91.0}, "latitude: expected -90 to 90 degrees, found 91"),
    ],
    ids=str,
)
def test_an_impossible_request_is_one_line_and_leaves_no_folder(
    tmp_path: Path, words: dict[str, Any], said: str
) -> None:
    with pytest.raises(InputError) as caught:
        simulate_session(tmp_path / "launch", Setup.of(**words), seed=1)
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "launch").exists()


def test_a_session_is_never_overwritten(tmp_path: Path) -> None:
    simulate_session(tmp_path / "launch", QUICK, seed=1)
    before = (tmp_path / "launch" / "truth.json").read_bytes()
    with pytest.raises(InputError, match="expected a new folder, found a session in it"):
        simulate_session(tmp_path / "launch", QUICK, seed=2)
    assert (tmp_path / "launch" / "truth.json").read_bytes() == before


def test_a_folder_that_cannot_be_made_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="expected a folder to write to"):
        simulate_session(tmp_path / "file" / "launch", QUICK, seed=1)


@pytest.mark.parametrize("text", ["", "0.05", "@30", "0.05@0", "-1@30", "nan@30", "1@inf", "1@2@3", "a@b"])
def test_a_vibration_is_read_from_text_or_refused_in_one_line(text: str) -> None:
    assert vibration_of("0.05@30") == Vibration(amplitude=0.05, frequency=30.0)
    with pytest.raises(InputError, match=r"vibration: expected AMPLITUDE@HZ .*, found "):
        vibration_of(text)
