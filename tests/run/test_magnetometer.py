"""Magnetometers in sessions: keys, chunks, rests, parameters, and what is said where they cannot be calibrated."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
from click.testing import CliRunner
from scipy.spatial.transform import Rotation

from tests.methods.test_ellipsoid import cube, placed
from tests.support.moving import Motion, record
from tumble.cli import main
from tumble.errors import InputError, SessionError
from tumble.inference.magnetic_estimate import by_attitudes
from tumble.inference.magnetometer import OWN, Magnetometer
from tumble.inference.problem import Point, bases
from tumble.methods.ellipsoid_fit import TRIAD
from tumble.recording.log import open_log
from tumble.recording.session_file import read_session, write_session
from tumble.reduction.blocks.reducer import reduce_log
from tumble.result.calibration import Calibration, read_calibration
from tumble.run.calibrate import calibrate
from tumble.run.launches import LaunchRun, mean_of_launches
from tumble.run.magnetometer import PARAMETER_NAMES
from tumble.run.together import calibrate_together
from tumble.sensors.model import Block, SensorModel
from tumble.units import Array, BoolArray
from tumble.use.apply import apply_to_session

RATE, REST, MOVE = 50.0, 6.0, 1.5  # Hz, s, s
FIELD = 49.7  # uT
TRIAD_TRUTH = np.array([12.0, -7.5, 3.2, 0.05, -0.03, 0.01, 0.02, -0.04, 0.03])
TRUTH = Block(kind="mag", axes=np.eye(3)).parameters(TRIAD.model(TRIAD_TRUTH))
ACCEL = np.array([0.1, -0.2, 0.15, 2e-3, -3e-3, 1e-3, 1e-3, 2e-3, -3e-3])


def attitudes(rng: np.random.Generator) -> tuple[Array, Array]:
    """Directions (N, 3) of the vertical and of the field in the body in eighteen rests; the field dips by 65°."""
    vertical = placed(cube(1, 2), rng)
    across = np.cross(vertical, rng.standard_normal(vertical.shape))
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    dip = np.radians(65.0)
    return vertical, np.cos(dip) * across - np.sin(dip) * vertical


def over_time(rests: Array) -> Array:
    """Samples of a vector that rests and moves on, linearly."""
    still, moving = int(REST * RATE), int(MOVE * RATE)
    parts = [np.repeat(rests[:1], still, axis=0)]
    for before, after in pairwise(rests):
        parts += [np.linspace(before, after, moving), np.repeat(after[None], still, axis=0)]
    return np.concatenate(parts)


def write(
    folder: Path, seed: int = 1, *, noise: float = 0.05, unit: float = 1.0, changes: Mapping[str, Any] | None = None
) -> Path:
    """A session without gyros; `noise` of the magnetometer in uT a sample, `changes` to its tables, by dotted key."""
    rng = np.random.default_rng(seed)
    vertical, field = attitudes(rng)
    accel = over_time(TRIAD.model(ACCEL).predict(9.81 * vertical))
    magnetic = over_time(TRIAD.model(TRIAD_TRUTH).predict(FIELD * field))
    folder.mkdir(parents=True, exist_ok=True)
    accel = accel + (3e-3 if noise else 3e-6) * rng.standard_normal(accel.shape)
    magnetic = unit * (magnetic + noise * rng.standard_normal(magnetic.shape))
    columns = dict(zip(["ax", "ay", "az", "mx", "my", "mz"], np.hstack([accel, magnetic]).T, strict=True))
    pl.DataFrame({"t": np.arange(1, len(accel) + 1) / RATE, **columns}).write_parquet(folder / "log.parquet")
    write_session(folder, described(changes or {}))
    return folder


def described(changes: Mapping[str, Any]) -> dict[str, Any]:
    content: dict[str, Any] = {
        "format": 1,
        "device": {"serial": "M-1"},
        "site": {"gravity": 9.81, "field": FIELD},
        "log": {
            "file": "log.parquet",
            "time": "t",
            "accel": {"columns": ["ax", "ay", "az"], "unit": "m/s^2"},
            "magnetometer": {"columns": ["mx", "my", "mz"], "unit": "uT"},
        },
    }
    for key, value in changes.items():
        *path, last = key.split(".")
        table = content
        for part in path:
            table = table[part]
        if value is None:
            del table[last]
        else:
            table[last] = value
    return content


def values(calibration: Calibration) -> Array:
    return np.array([calibration[name].value for name in PARAMETER_NAMES])


def us(calibration: Calibration) -> Array:
    return np.array([calibration[name].u for name in PARAMETER_NAMES], dtype=float)


def test_a_session_with_a_magnetometer_gives_its_parameters(tmp_path: Path) -> None:
    found = calibrate(write(tmp_path))
    assert found.outcome.accepted, found.outcome.reasons
    names = [p.name for p in found.parameters]
    assert names[:9] == list(TRIAD.names)
    assert [name for name in names if name.startswith("mag.")] == list(PARAMETER_NAMES)
    assert [found[name].unit for name in PARAMETER_NAMES] == ["uT"] * 3 + ["1"] * 3 + ["rad"] * 6
    z = (values(found) - TRUTH) / us(found)
    assert np.abs(z).max() < 5.0
    assert us(found)[:3].max() < 0.02
    assert found.mag is not None
    assert found.mag.matrix == pytest.approx(TRIAD.model(TRIAD_TRUTH).matrix, abs=1e-3)
    assert found.covariance is not None
    assert found.covariance.shape == (len(names), len(names))
    u = np.sqrt(found.covariance.diagonal())
    assert np.linalg.eigvalsh(found.covariance / np.outer(u, u))[0] > 0.0
    # an axis of the accelerometers that is not known moves those of the magnetometer, in the frame of these
    of_mag = np.array([name.startswith("mag.axis") for name in names])
    assert np.abs((found.covariance / np.outer(u, u))[np.ix_(~of_mag, of_mag)]).max() > 0.02


def test_the_accelerometers_are_calibrated_as_without_it(tmp_path: Path) -> None:
    with_it = calibrate(write(tmp_path / "a"), method="ellipsoid")
    changes = {"log.magnetometer": None, "site.field": None}
    without = calibrate(write(tmp_path / "b", changes=changes), method="ellipsoid")
    assert without.parameters == tuple(p for p in with_it.parameters if not p.name.startswith("mag."))
    assert without.mag is None


def test_noiseless_parameters_are_recovered(tmp_path: Path) -> None:
    found = calibrate(write(tmp_path, noise=0.0))
    assert values(found) == pytest.approx(TRUTH, abs=5e-5)  # what accelerometers in noise of 3e-6 m/s² a sample leave


def test_the_uncertainties_hold_over_many_sessions(tmp_path: Path) -> None:
    z = []
    for seed in range(12):
        found = calibrate(write(tmp_path / str(seed), seed))
        z.append((values(found) - TRUTH) / us(found))
    # 12 × 12 values of about unit variance: five standard errors of the rms
    assert np.sqrt(np.mean(np.square(z))) == pytest.approx(1.0, abs=0.45)


@pytest.mark.parametrize(("unit", "factor"), [("nT", 1e3), ("gauss", 1e-2), ("mgauss", 10.0), ("T", 1e-6)])
def test_the_unit_is_that_of_the_field_and_of_the_result(tmp_path: Path, unit: str, factor: float) -> None:
    plain = calibrate(write(tmp_path / "a"))
    changes = {"log.magnetometer": {"columns": ["mx", "my", "mz"], "unit": unit}, "site.field": FIELD * factor}
    scaled = calibrate(write(tmp_path / "b", unit=factor, changes=changes))
    assert scaled["mag.bias.x"].unit == unit
    expected = np.concatenate([values(plain)[:3] * factor, values(plain)[3:]])
    assert values(scaled) == pytest.approx(expected, rel=1e-6)


def test_without_the_field_scale_factors_are_relative_and_that_is_said(tmp_path: Path) -> None:
    known = calibrate(write(tmp_path / "a"))
    found = calibrate(write(tmp_path / "b", changes={"site.field": None}))
    assert found.outcome.accepted
    assert any("the field is not known (site.field)" in note for note in found.provenance.notes)
    assert not any("not known" in note for note in known.provenance.notes)
    # only a common factor of the scale factors differs
    ratio = (1.0 + values(found)[3:6]) / (1.0 + values(known)[3:6])
    assert ratio == pytest.approx(np.full(3, ratio[0]), rel=1e-6)
    assert np.delete(values(found), [3, 4, 5]) == pytest.approx(np.delete(values(known), [3, 4, 5]), abs=1e-5)
    assert found.mag is not None
    assert np.linalg.det(found.mag.matrix) == pytest.approx(1.0, abs=1e-3)


def test_hard_and_soft_iron_are_said_in_words(tmp_path: Path) -> None:
    result = CliRunner().invoke(main, ["calibrate", str(write(tmp_path)), "--all"], catch_exceptions=False)
    assert result.exit_code == 0
    said = " ".join(result.stdout.split())
    assert "hard iron (12" in said
    assert "soft iron: the field is read 0.9" in said
    assert "mag.bias.x" in said


def test_a_disturbed_rest_is_left_out_and_named(tmp_path: Path) -> None:
    folder = write(tmp_path, noise=0.02)
    log = pl.read_parquet(folder / "log.parquet")
    near_steel = (pl.col("t") > 4 * (REST + MOVE) - 0.5) & (pl.col("t") < 5 * (REST + MOVE) - 0.5)
    log.with_columns(mx=pl.col("mx") + pl.when(near_steel).then(8.0).otherwise(0.0)).write_parquet(
        folder / "log.parquet"
    )
    found = calibrate(folder)
    assert found.outcome.accepted, found.outcome.reasons
    assert [note for note in found.provenance.notes if "rest 5 (" in note and "was left out" in note]
    assert np.abs((values(found) - TRUTH) / us(found)).max() < 5.0


def test_a_field_that_changes_everywhere_leaves_the_rest_of_the_session_alone(tmp_path: Path) -> None:
    folder = write(tmp_path)
    log = pl.read_parquet(folder / "log.parquet")
    rng = np.random.default_rng(3)
    disturbed = {name: log[name] + over_time(4.0 * rng.standard_normal((18, 1)))[:, 0] for name in ("mx", "my", "mz")}
    log.with_columns(**disturbed).write_parquet(folder / "log.parquet")
    found = calibrate(folder)
    said = next(note for note in found.provenance.notes if note.startswith("magnetometer: the readings scatter by"))
    assert "[log.magnetometer] out" in said
    assert said.endswith("the rest of the session is calibrated without it")
    assert found.mag is None
    alone = calibrate(write(tmp_path / "alone", changes={"log.magnetometer": None, "site.field": None}))
    assert found.outcome.accepted
    assert [p.value for p in found.parameters] == pytest.approx([p.value for p in alone.parameters], rel=1e-9)
    assert found.in_frame("symmetric").accel is not None


def test_a_dead_channel_leaves_the_rest_of_the_session_alone_and_its_parameters_are_named(tmp_path: Path) -> None:
    folder = write(tmp_path)
    pl.read_parquet(folder / "log.parquet").with_columns(mz=pl.lit(1.0)).write_parquet(folder / "log.parquet")
    found = calibrate(folder)
    assert found.outcome.accepted
    assert found.outcome.unobservable == PARAMETER_NAMES
    assert any(note.startswith("magnetometer: ") for note in found.provenance.notes)
    assert found.mag is None
    assert found.accel is not None


@pytest.mark.parametrize(
    ("columns", "latitude", "said"),
    [
        (["my", "mx", "mz"], 48.0, "with (mx, my, mz) in place of (my, mx, mz)"),
        (["my", "mx", "mz"], None, "with (mx, my, mz) or (−mx, −my, −mz) in place of (my, mx, mz)"),
        (["mx", "my", "mw"], 48.0, "with (mx, my, −mw) in place of (mx, my, mw)"),
        (["mz", "mx", "my"], -48.0, "with (−mx, −my, −mz) in place of (mz, mx, my)"),
    ],
)
def test_exchanged_and_mirrored_columns_are_named_by_the_dip_angle(
    tmp_path: Path, columns: list[str], latitude: float | None, said: str
) -> None:
    changes = {"log.magnetometer.columns": columns} | ({} if latitude is None else {"site.latitude_deg": latitude})
    folder = write(tmp_path, changes=changes)
    log = pl.read_parquet(folder / "log.parquet").with_columns(mw=-pl.col("mz"))
    log.write_parquet(folder / "log.parquet")
    found = calibrate(folder)
    assert found.outcome.accepted
    assert any(said in note for note in found.provenance.notes), found.provenance.notes


def test_columns_in_order_are_not_doubted(tmp_path: Path) -> None:
    for seed in range(3):
        found = calibrate(write(tmp_path / str(seed), seed, noise=0.5))
        assert found.mag is not None
        assert not any("in place of" in note for note in found.provenance.notes)


def test_the_calibration_file_keeps_the_magnetometer(tmp_path: Path) -> None:
    found = calibrate(write(tmp_path))
    found.write(tmp_path / "calibration.json")
    again = read_calibration(tmp_path / "calibration.json")
    assert found.mag is not None
    assert again.mag is not None
    assert again.mag.matrix.tolist() == found.mag.matrix.tolist()
    assert again.parameters == found.parameters
    assert again.provenance.readings["mag"].unit == "uT"


def test_apply_removes_hard_and_soft_iron(tmp_path: Path) -> None:
    folder = write(tmp_path / "session", noise=0.0)
    found = calibrate(folder)
    apply_to_session(found, read_session(folder), tmp_path / "out.parquet")
    before, after = (pl.read_parquet(path) for path in (folder / "log.parquet", tmp_path / "out.parquet"))
    assert after.columns == before.columns
    rest = slice(0, int(REST * RATE))
    length = np.linalg.norm(after["mx", "my", "mz"].to_numpy()[rest], axis=1)
    assert length == pytest.approx(np.full(len(length), FIELD), rel=1e-6)
    assert np.linalg.norm(before["mx", "my", "mz"].to_numpy()[rest], axis=1) != pytest.approx(length, rel=1e-2)


def test_apply_leaves_a_magnetometer_alone_that_was_not_calibrated(tmp_path: Path) -> None:
    without = calibrate(write(tmp_path / "a", changes={"log.magnetometer": None, "site.field": None}))
    folder = write(tmp_path / "b")
    apply_to_session(without, read_session(folder), tmp_path / "out.parquet")
    before, after = (pl.read_parquet(path) for path in (folder / "log.parquet", tmp_path / "out.parquet"))
    assert after["mx", "my", "mz"].equals(before["mx", "my", "mz"])


def test_apply_refuses_a_magnetometer_in_another_unit(tmp_path: Path) -> None:
    found = calibrate(write(tmp_path / "a"))
    folder = write(tmp_path / "b", unit=1e3, changes={"log.magnetometer.unit": "nT", "site.field": 1e3 * FIELD})
    with pytest.raises(InputError, match=r"log.magnetometer.unit: expected that of the calibration, 'uT', found 'nT'"):
        apply_to_session(found, read_session(folder), tmp_path / "out.parquet")
    assert not (tmp_path / "out.parquet").exists()


def test_several_launches_have_the_mean_magnetometer(tmp_path: Path) -> None:
    folders = [write(tmp_path / str(seed), seed) for seed in (1, 2)]
    runs = [LaunchRun(session=read_session(folder), calibration=calibrate(folder)) for folder in folders]
    mean = mean_of_launches(runs)
    assert values(mean) == pytest.approx(np.mean([values(run.calibration) for run in runs], axis=0), rel=1e-12)
    assert mean.mag is not None
    assert mean.mag.bias == pytest.approx(values(mean)[:3])


@pytest.mark.parametrize("rows", [1000, 17])
def test_blocks_do_not_depend_on_the_chunks(tmp_path: Path, rows: int) -> None:
    session = read_session(write(tmp_path))
    log = open_log(session)
    whole = reduce_log(log, session.accel_block, None)
    parts = reduce_log(log, session.accel_block, None, log.chunks(rows))
    first, second = whole.files[0].magnetometer.means, parts.files[0].magnetometer.means
    assert first == pytest.approx(second, rel=1e-13)
    samples = np.concatenate([c.magnetometer for c in log.chunks() if c.magnetometer is not None])
    size = whole.files[0].size
    assert first[7] == pytest.approx(samples[7 * size : 8 * size].mean(axis=0), rel=1e-13)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"log.magnetometer.columns": ["mx", "my"]}, "log.magnetometer.columns: expected a list of three column names"),
        ({"log.magnetometer.unit": "Oe"}, "log.magnetometer.unit: expected one of nT, uT, gauss, mgauss, T, found"),
        (
            {"log.magnetometer.columns": ["mx", "my", "ax"]},
            'expected every column once, found "ax" in log.accel.columns',
        ),
        ({"log.magnetometer": None}, "site.field: expected only with [log.magnetometer], found no magnetometer"),
        ({"site.field": 49700.0}, "site.field: expected the field on Earth, from 15 to 80 uT"),
        ({"site.field": -1.0}, "site.field: expected a positive number, in the unit of [log.magnetometer], found -1"),
        ({"log.magnetometer.scale": 1.0}, "unknown key 'scale' in [log.magnetometer]"),
    ],
)
def test_what_a_session_cannot_mean_is_refused(tmp_path: Path, changes: dict[str, Any], said: str) -> None:
    with pytest.raises(SessionError) as refused:
        write_session(tmp_path, described(changes))
    assert said in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_missing_column_is_named(tmp_path: Path) -> None:
    folder = write(tmp_path, changes={"log.magnetometer.columns": ["mx", "my", "mq"]})
    result = CliRunner().invoke(main, ["calibrate", str(folder)], catch_exceptions=False)
    assert result.exit_code == 2
    assert "expected a column 'mq'" in result.stderr


def moved(
    folder: Path, motion: Motion, seed: int, *, steel: tuple[float, float] = (0.0, 0.0), noise: float = 0.5,
    late: int = 0,
) -> tuple[Path, Array]:  # fmt: skip
    """A session with gyros, and the truth of its magnetometer, which is near steel between two times, s, and whose
    readings are so many samples `late`."""
    recording, rng = record(motion, seed), np.random.default_rng(1000 + seed)
    truth = SensorModel(matrix=np.eye(3) + 0.03 * rng.standard_normal((3, 3)), bias=20.0 * rng.standard_normal(3))
    dip, t = np.radians(65.0), np.arange(1, len(recording.accel) + 1) / recording.rate
    field = FIELD * np.array([np.cos(dip), -np.sin(dip), 0.0]) @ recording.attitudes
    field = np.concatenate([np.repeat(field[:1], late, axis=0), field[: len(field) - late]])
    magnetic = truth.predict(field) + np.outer((t > steel[0]) & (t < steel[1]), [4.0, -2.0, 3.0])
    magnetic += noise * rng.standard_normal(magnetic.shape)
    names = [f"{kind}{axis}" for kind in "agm" for axis in "xyz"]
    every = np.hstack([recording.accel, recording.gyro, magnetic])
    folder.mkdir(parents=True, exist_ok=True)
    pl.DataFrame({"t": t, **dict(zip(names, every.T, strict=True))}).write_parquet(folder / "log.parquet")
    write_session(folder, described({"log.gyro": {"columns": ["gx", "gy", "gz"], "unit": "rad/s"}}))
    return folder, Block(kind="mag", axes=np.eye(3)).parameters(truth)


RESTS = Motion(seconds=160.0, rests=20)


@pytest.mark.parametrize("motion", [RESTS, Motion(), Motion(sway=0.1, rests=4)], ids=["turns", "pivot", "hand"])
def test_attitudes_are_those_of_the_other_sensors(tmp_path: Path, motion: Motion) -> None:
    """N = 3: 36 values within 5 u, and together within 1.6 u, root mean square."""
    z = []
    for seed in range(3):
        folder, truth = moved(tmp_path / str(seed), motion, seed)
        found = calibrate(folder)
        assert found.outcome.accepted, found.outcome.reasons
        z.append((values(found) - truth) / us(found))
    assert np.abs(z).max() < 5.0
    assert np.sqrt(np.mean(np.square(z))) < 1.6


def test_a_magnetometer_that_is_late_errs_no_more(tmp_path: Path) -> None:
    """By 50 ms on a pivot at 60 °/s, which turns the field by 3°: within 4 u, and together within 1.6 u, root mean
    square (5 u and 2.4 u with a delay of first order in the angle)."""
    folder, truth = moved(tmp_path, Motion(), 0, late=10)
    found = calibrate(folder)
    assert found.outcome.accepted, found.outcome.reasons
    z = (values(found) - truth) / us(found)
    assert np.abs(z).max() < 4.0
    assert np.sqrt(np.mean(z**2)) < 1.6


def test_an_estimate_over_temperature_says_that_it_leaves_the_magnetometer_out(tmp_path: Path) -> None:
    folders = [write(tmp_path / str(seed), seed) for seed in (1, 2)]
    for folder, celsius in zip(folders, (10.0, 30.0), strict=True):
        pl.read_parquet(folder / "log.parquet").with_columns(T=pl.lit(celsius)).write_parquet(folder / "log.parquet")
        write_session(folder, described({"log.temperature": {"columns": ["T"], "unit": "degC"}}))
    found = calibrate_together(folders)
    assert found.mag is None
    assert [note for note in found.provenance.notes if note.startswith("magnetometer: ")] == [
        "magnetometer: several sessions in one estimate leave it out; calibrate one alone for hard and soft iron"
    ]


def test_gyros_tell_hard_and_soft_iron_better(tmp_path: Path) -> None:
    """Of twenty rests u of hard iron, scale factors and axes fall below 0.85 by the attitudes that gyros add."""
    folder, _ = moved(tmp_path, RESTS, 1, noise=2.0)
    u = us(calibrate(folder))
    write_session(folder, described({}))
    of_rests = us(calibrate(folder))
    ratio = [np.sqrt(np.mean(u[k] ** 2) / np.mean(of_rests[k] ** 2)) for k in (slice(3), slice(3, 6), slice(6, 12))]
    assert max(ratio) < 0.85, ratio


@pytest.mark.parametrize(
    ("motion", "said"),
    [(RESTS, "rest 6 (42.7–45.3 s) was left out"), (Motion(), "its readings from 40.0 to 46.0 s were left out")],
    ids=["rest", "nodes"],
)
def test_readings_near_steel_are_left_out_and_named(tmp_path: Path, motion: Motion, said: str) -> None:
    folder, truth = moved(tmp_path, motion, 1, steel=(39.8, 46.2))
    found = calibrate(folder)
    assert found.outcome.accepted
    assert [note for note in found.provenance.notes if "left out" in note] == [
        next(note for note in found.provenance.notes if note.startswith(f"magnetometer: {said}"))
    ]
    assert np.abs((values(found) - truth) / us(found)).max() < 5.0


def left_out_rests(found: Calibration) -> list[int]:
    notes = [note for note in found.provenance.notes if note.startswith("magnetometer: rest ")]
    return [int(note.split()[2]) for note in notes]


@pytest.mark.parametrize("seed", range(4))
def test_a_third_of_the_rests_with_a_motor_running_are_all_named(tmp_path: Path, seed: int) -> None:
    """A robust fit of unknown scale breaks down where it is Student-t and more than a fifth are disturbed. N = 4."""
    folder, truth = moved(tmp_path, Motion(seconds=96.0, rests=12), seed, steel=(24.2, 55.8))
    found = calibrate(folder)
    assert found.outcome.accepted, found.outcome.reasons
    assert left_out_rests(found) == [4, 5, 6, 7]
    assert np.abs((values(found) - truth) / us(found)).max() < 5.0


def test_more_disturbed_rests_than_can_be_told_are_refused_in_one_sentence(tmp_path: Path) -> None:
    folder, _ = moved(tmp_path, Motion(seconds=192.0, rests=24), 1, steel=(24.2, 103.8))
    found = calibrate(folder)
    assert found.outcome.accepted
    assert found.mag is None
    (said,) = (note for note in found.provenance.notes if note.startswith("magnetometer: "))
    assert said.startswith("magnetometer: the field is not the same in 10 or more of its 24 readings, too many to tell")
    assert "record away from steel, with motors off, or leave [log.magnetometer] out" in said


def disturbed(rng: np.random.Generator, rests: int, count: int, sigma: float) -> tuple[Array, Array, Array, BoolArray]:
    """Readings of a unit field in random attitudes with Gaussian errors, the attitudes, the hard iron, and True for
    sound readings; the others have a constant field beside, in the body or in the world, of 20 to 1000 sigma."""
    L = Rotation.random(rests, random_state=int(rng.integers(1 << 31))).as_matrix()
    dip, sound = np.radians(rng.uniform(-70.0, 80.0)), np.ones(rests, dtype=bool)
    sound[rng.permutation(rests)[:count]] = False
    beside = rng.standard_normal(3)
    beside *= sigma * 20.0 * 50.0 ** rng.random() / np.linalg.norm(beside)
    extra = np.broadcast_to(beside, (rests, 3)) if rng.random() < 0.5 else beside @ L
    field = np.array([np.cos(dip), -np.sin(dip), 0.0]) @ L
    soft, hard = np.eye(3) + 0.1 * rng.standard_normal((3, 3)), 0.5 * rng.standard_normal(3)
    errors = sigma * rng.standard_normal((rests, 3)) + extra * ~sound[:, None]
    return field @ soft.T + hard + errors, L, hard, sound


@pytest.mark.parametrize(("rests", "count"), [(12, 0), (12, 2), (12, 4), (16, 4), (24, 4), (24, 8), (240, 80)])
def test_readings_that_agree_are_found_in_known_attitudes(rests: int, count: int) -> None:
    """N = 20 for each: in at least 17, no disturbed reading is among them, and at most one sound one is not; then the
    hard iron is within 10 sigma."""
    rng, right = np.random.default_rng((rests, count)), 0
    for _ in range(20):
        readings, L, hard, sound = disturbed(rng, rests, count, 2e-3)
        found = by_attitudes(readings, L, np.zeros(rests, dtype=np.int64))
        assert found is not None
        if not np.any(found[2] & ~sound) and np.sum(found[2]) >= np.sum(sound) - 1:
            right += 1
            assert np.abs(found[0].bias - hard).max() < 10.0 * 2e-3
    assert right >= 17


def test_a_spoilt_turn_is_no_disturbed_field(tmp_path: Path) -> None:
    """Gyros that read 12 % more in one turn make the attitudes of half of the rests wrong; none is left out."""
    folder, truth = moved(tmp_path, RESTS, 1)
    log = pl.read_parquet(folder / "log.parquet")
    factor = pl.when((pl.col("t") > 77.5) & (pl.col("t") < 82.5)).then(1.12).otherwise(1.0)
    log.with_columns(pl.col("gx", "gy", "gz") * factor).write_parquet(folder / "log.parquet")
    found = calibrate(folder)
    assert left_out_rests(found) == []
    assert found.mag is not None
    assert np.abs((values(found) - truth) / us(found)).max() < 5.0


def test_rows_are_derivatives_of_the_readings() -> None:
    """Every column against central differences, with a delay, which is not linear beside the others."""
    rng = np.random.default_rng(5)
    magnetometer = Magnetometer(block=Block(kind="mag", axes=np.eye(3)[[1, 0, 2]]), field=50.0, dip=1.0)
    own, rates, step = 0.05 * rng.standard_normal(OWN), rng.random((4, 3)), 1e-6
    attitudes = Rotation.random(4, random_state=2).as_matrix()

    def readings(own: Array, angles: Array) -> Array:
        moved = Point(values=np.zeros(0), gravity=9.81, attitudes=attitudes).moved(np.zeros(1), angles)
        return magnetometer.rows(own, moved.attitudes, bases(moved.attitudes), rates)[0]

    _, by_angles, by_own = magnetometer.rows(own, attitudes, bases(attitudes), rates)
    for k in range(OWN):
        e = step * np.eye(OWN)[k]
        difference = (readings(own + e, np.zeros((4, 3))) - readings(own - e, np.zeros((4, 3)))) / (2.0 * step)
        assert by_own[:, :, k] == pytest.approx(difference, abs=1e-6)
    for k in range(3):
        e = np.tile(step * np.eye(3)[k], (4, 1))
        difference = (readings(own, e) - readings(own, -e)) / (2.0 * step)
        assert by_angles[:, :, k] == pytest.approx(difference, abs=1e-6)
