"""Recordings of others, real and simulated, against what is known of them (README of the data folder)."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from click.testing import CliRunner
from scipy.linalg import rq

from tests.support.linear_instrument import stated_linear
from tests.support.staged import staged_estimate
from tumble.cli import main
from tumble.result.calibration import Calibration
from tumble.run.calibrate import calibrate
from tumble.sensors.parameters import Terms
from tumble.units import ARCSEC, DEGREE, DEGREE_PER_HOUR, Array

pytestmark = pytest.mark.data


def run(*arguments: str) -> tuple[int, str, str]:
    """Exit status, standard output and standard error of a command."""
    result = CliRunner().invoke(main, arguments)
    return result.exit_code, result.stdout, result.stderr


def session(folder: Path, files: list[Path], timing: str, site: str, accel: str, gyro: str) -> Path:
    """A session folder with links to these logs."""
    folder.mkdir()
    for file in files:
        (folder / file.name).symlink_to(file)
    names = ", ".join(f'"{file.name}"' for file in files)
    (folder / "session.toml").write_text(
        f'format = 1\n[device]\nserial = "S"\n[site]\n{site}\n[log]\nfile = [{names}]\n{timing}\n'
        f"[log.accel]\n{accel}\n[log.gyro]\n{gyro}\n"
    )
    return folder


IN_SI_AND_DEGREES = (
    'columns = ["acc_x", "acc_y", "acc_z"]\nunit = "m/s^2"',
    'columns = ["gyr_x", "gyr_y", "gyr_z"]\nunit = "deg/s"',
)


# -------------------- simulated independently of the project --------------------


@pytest.mark.parametrize("name", ["truth-turntable", "truth-handheld"])
def test_an_independent_simulation_is_recovered_within_its_uncertainties(name: str, data: Path) -> None:
    result = calibrate(stated_linear(data / name), terms="linear")
    truth = json.loads((data / name / "truth.json").read_text())
    assert result.outcome.accepted
    assert [p.name for p in result.parameters] == list(truth)
    assert len(truth) == 21
    normalised = [(p.value - truth[p.name]) / (p.u or 0.0) for p in result.parameters]
    assert np.abs(normalised).max() < 4.0
    assert 0.5 < np.sqrt(np.mean(np.square(normalised))) < 1.6


@pytest.mark.parametrize("name", ["truth-turntable", "truth-handheld"])
def test_without_its_gyros_it_still_gives_the_accelerometers(name: str, data: Path, tmp_path: Path) -> None:
    """On the table the turns about the vertical are then all but invisible."""
    (log,) = (data / name).glob("log.*")
    (tmp_path / log.name).symlink_to(log)
    described = (data / name / "session.toml").read_text()
    without = re.sub(r"\[log\.gyro\]\n(?:\w.*\n?)*", "", described)
    assert "[log.accel]" in without
    (tmp_path / "session.toml").write_text(without)
    result = calibrate(stated_linear(tmp_path), terms="linear")
    truth = json.loads((data / name / "truth.json").read_text())
    assert result.outcome.accepted
    assert [p.name for p in result.parameters] == list(truth)[:9]
    normalised = [(p.value - truth[p.name]) / (p.u or 0.0) for p in result.parameters]
    assert np.abs(normalised).max() < 4.0
    assert 0.4 < np.sqrt(np.mean(np.square(normalised))) < 1.7


# -------------------- Xsens MTi --------------------


@pytest.fixture(scope="module")
def xsens(data: Path, tmp_path_factory: pytest.TempPathFactory) -> Calibration:
    """With the gravity that imu_tk assumes."""
    folder = tmp_path_factory.mktemp("xsens")
    (folder / "log.csv").symlink_to(data / "xsens-mti" / "log.csv")
    described = (data / "xsens-mti" / "session.toml").read_text()
    (folder / "session.toml").write_text(
        described.replace("height_m = 12.0", "height_m = 12.0\ngravity = 9.81744\ngravity_u = 1e-6")
    )
    return calibrate(folder)


def test_xsens_without_a_place_gives_everything_but_the_size_of_g(
    xsens: Calibration, data: Path, tmp_path: Path
) -> None:
    """With gravity as it is anywhere: scale factors of the accelerometers are as uncertain, all else is the same."""
    (tmp_path / "log.csv").symlink_to(data / "xsens-mti" / "log.csv")
    described = (data / "xsens-mti" / "session.toml").read_text()
    nowhere = described.replace("latitude_deg = 45.41\nheight_m = 12.0", "gravity = 9.81744\ngravity_u = 0.03")
    assert nowhere != described
    (tmp_path / "session.toml").write_text(nowhere)
    found = calibrate(tmp_path)
    assert found.outcome.verdict == "accepted with scatter"
    for name in list(xsens)[:21]:
        there, here = xsens[name], found[name]
        assert here.u is not None
        assert there.u is not None
        if name.startswith("accel.scale"):
            assert 2e-3 < here.u < 5e-3
            assert abs(here.value - there.value) < here.u
        elif not name.startswith("gyro"):  # which without a latitude do not know the Earth's rate
            assert abs(here.value - there.value) < 0.3 * there.u


def sensitivities(result: Calibration) -> tuple[Array, Array]:
    """Sensitivity matrices of accelerometers and gyros in counts per m/s² and per rad/s."""
    assert result.accel is not None
    assert result.gyro is not None
    return 415.0 * result.accel.matrix, 4770.0 * result.gyro.matrix


def test_xsens_accelerometers_agree_with_the_independent_fit(xsens: Calibration) -> None:
    """The independent fit gives 414.421(27), 412.031(14), 414.621(16) counts per m/s²: these are the diagonal of an
    upper-triangular sensitivity matrix, imu_tk's convention, not the row norms of the matrix, which are 414.44,
    412.13 and 414.61 and which our scale factors multiply. Any sensitivity matrix becomes upper triangular by a
    rotation of the body (RQ factorisation)."""
    accel, _ = sensitivities(xsens)
    triangular, _ = rq(accel)
    diagonal = np.abs(np.diag(triangular))
    ours = np.array([415.0 * (xsens[f"accel.scale.{axis}"].u or 0.0) for axis in "xyz"])
    combined = np.hypot(ours, [0.027, 0.014, 0.016])
    assert np.all(np.abs(diagonal - [414.421, 412.031, 414.621]) < 3.0 * combined)
    assert np.all(np.abs(np.linalg.norm(accel, axis=1) - [414.44, 412.13, 414.61]) < combined)


def test_xsens_biases_and_residuals_agree_with_the_independent_fit(xsens: Calibration) -> None:
    assert xsens.accel is not None
    counts = 32768.0 + 415.0 * xsens.accel.bias
    u = np.array([415.0 * (xsens[f"accel.bias.{axis}"].u or 0.0) for axis in "xyz"])
    np.testing.assert_array_less(np.abs(counts - [33123.84, 33275.16, 32364.49]), 3.0 * np.sqrt(2.0) * u)
    assert len(xsens.evidence.rests) == 38
    residuals = np.array([rest.residual for rest in xsens.evidence.rests])
    assert np.sqrt(np.mean(residuals**2)) <= 1.05e-3


def test_xsens_gyros_agree_with_imu_tk(xsens: Calibration) -> None:
    """4778.0, 4764.2, 4773.7 counts per rad/s: imu_tk gives the reciprocals of the diagonal of the inverse matrix, in
    the frame in which the accelerometers' matrix is upper triangular. It has no g-sensitivity, and its scatter makes
    these known to 4.0, 3.7 and 5.6 (studies/xsens.md)."""
    accel, gyro = sensitivities(xsens)
    _, rotation = rq(accel)
    rotation *= np.sign(np.diag(rotation))[:, None]
    found = np.abs(1.0 / np.diag(np.linalg.inv(gyro @ rotation.T)))
    ours = np.array([4770.0 * (xsens[f"gyro.scale.{axis}"].u or 0.0) for axis in "xyz"])
    combined = np.hypot(ours, [4.0, 3.7, 5.6])
    assert np.all(np.abs(found - [4778.0, 4764.2, 4773.7]) < 1.5 * combined)


def test_xsens_is_accepted(xsens: Calibration) -> None:
    assert xsens.outcome.accepted
    assert len(xsens.parameters) == 51  # without drifts, which are in the in-run process of MEMS


# -------------------- LN-100 up and down --------------------


@pytest.fixture(scope="module")
def ln100(data: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    files = [data / "ln100-updown" / f"ln100_x_{side}.csv" for side in ("up", "down")]
    folder = tmp_path_factory.mktemp("ln100") / "session"
    site = "latitude_deg = 51.08\nheight_m = 1100.0"
    return session(folder, files, 'time = "t"', site, *IN_SI_AND_DEGREES)


def test_ln100_half_sums_are_those_of_its_paper(ln100: Path) -> None:
    """Two files, an unrecorded move between them."""
    status, said, _ = run("inspect", str(ln100))
    assert status == 0
    (line,) = [line for line in " ".join(said.split()).split("X up")[1:] if "half sum" in line]
    numbers = re.findall(r"half (?:sum|difference) ([+-]?[0-9.]+) (µg|m/s²|°/h)", line)
    assert [unit for _, unit in numbers] == ["µg", "m/s²", "°/h", "°/h"]
    accel_sum, accel_difference, gyro_sum, gyro_difference = (float(value) for value, _ in numbers)
    assert accel_sum == pytest.approx(-43.7, abs=0.15)
    assert accel_difference == pytest.approx(9.80672, abs=1e-5)
    assert gyro_sum == pytest.approx(-0.254, abs=0.001)
    assert gyro_difference / 15.041 == pytest.approx(0.7800, abs=3e-4)  # °/h, the Earth's rate


def test_ln100_is_refused_by_the_names_of_what_two_rests_cannot_say(ln100: Path, tmp_path: Path) -> None:
    out = tmp_path / "calibration.json"
    status, _, said = run("calibrate", str(ln100), "--out", str(out))
    assert status == 1
    content = json.loads(out.read_text())
    missing = content["outcome"]["unobservable"]
    for name in ("accel.bias.y", "accel.scale.z", "accel.axis.yx", "gyro.scale.y", "gyro.axis.zx"):
        assert name in missing
        assert name in said
    given = {p["name"]: p for p in content["parameters"]}
    assert not set(given) & set(missing)
    bias = given["gyro.bias.x"]
    assert abs(bias["value"] / DEGREE_PER_HOUR + 0.254) < 4.0 * bias["u"] / DEGREE_PER_HOUR


# -------------------- imucal, Ferraris --------------------


@pytest.fixture(scope="module")
def ferraris_session(data: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = data / "imucal-ferraris" / "example_ferraris_session.csv"
    folder = tmp_path_factory.mktemp("ferraris") / "session"
    return session(
        folder,
        [file],
        "rate_hz = 102.4\nclock_ppm_u = 30",
        "latitude_deg = 49.57\nheight_m = 280.0",
        *IN_SI_AND_DEGREES,
    )


@pytest.fixture(scope="module")
def ferraris(ferraris_session: Path) -> Calibration:
    return calibrate(ferraris_session, terms="linear")


def test_ferraris_rests_are_the_sections_its_authors_marked(ferraris: Calibration, data: Path) -> None:
    """Each of the six marked faces is (but for two seconds of hands at its ends) inside a rest, each marked turn
    between two."""
    marked = json.loads((data / "imucal-ferraris" / "example_ferraris_session_list.json").read_text())
    rests = np.array([(rest.start, rest.stop) for rest in ferraris.evidence.rests])
    for name, section in marked.items():
        start, stop = section["start"] / 102.4, section["end"] / 102.4
        overlap = np.minimum(rests[:, 1], stop) - np.maximum(rests[:, 0], start)
        if name.endswith("rot"):
            assert overlap.max() < 0.5
        else:
            assert overlap.max() > stop - start - 2.0


def test_ferraris_is_refused_the_nine_accelerometer_parameters(ferraris_session: Path) -> None:
    """Six faces, however often, leave the angles between the axes open."""
    found = calibrate(ferraris_session, method="ellipsoid", terms="linear")
    assert not found.outcome.accepted
    assert found.accel is None
    assert "undetermined: axis.yx, axis.zx, axis.zy" in found.outcome.reasons[0]


def test_ferraris_gyros_are_those_of_its_full_turns(ferraris: Calibration, data: Path) -> None:
    """The turns by 360° in the hand, integrated: scale factors to 1 %, biases to 30 °/h."""
    log = pl.read_csv(data / "imucal-ferraris" / "example_ferraris_session.csv")
    marked = json.loads((data / "imucal-ferraris" / "example_ferraris_session_list.json").read_text())
    gyro = log.select("gyr_x", "gyr_y", "gyr_z").to_numpy()
    faces = [gyro[s["start"] : s["end"]].mean(axis=0) for name, s in marked.items() if not name.endswith("rot")]
    bias = np.mean(faces, axis=0)
    for axis, name in enumerate("xyz"):
        section = marked[f"{name}_rot"]
        turned = (gyro[section["start"] - 50 : section["end"] + 50] - bias).sum(axis=0) / 102.4
        assert ferraris[f"gyro.scale.{name}"].value == pytest.approx(np.linalg.norm(turned) / 360.0 - 1.0, abs=0.01)
        assert ferraris[f"gyro.bias.{name}"].value == pytest.approx(bias[axis] * DEGREE, abs=30 * DEGREE_PER_HOUR)


def test_ferraris_is_poorly_observable_by_the_joint_method(ferraris: Calibration) -> None:
    """The turns show what six faces do not, but poorly; the advice is the same. The terms left out are larger in this
    unit than is usual and move the scale factor of one gyro by more than 0.5 %, which is said of it."""
    assert not ferraris.outcome.accepted
    assert ferraris.outcome.reasons[0].startswith("poorly observable in this session: ")
    assert "rests that would help" in ferraris.outcome.reasons[0]
    concerned = ferraris.outcome.concerns[ferraris.outcome.reasons[0]]
    assert not any(part.startswith("accel") for part in concerned) or concerned[0].startswith("accel")
    scales = {name: ferraris[name].u or 1.0 for name in ("gyro.scale.x", "gyro.scale.y", "gyro.scale.z")}
    assert max(scales.values()) < 0.01
    assert all(u < 0.005 or name in ferraris.outcome.reasons[0] for name, u in scales.items())


# -------------------- PSINS, systematic --------------------

PSINS_G = 9.7803267715
"""PSINS's g, to which its µg refer."""

PSINS_GYRO_ANGLES = {"xy": 10, "xz": 20, "yx": 30, "yz": 40, "zx": 50, "zy": 60}
PSINS_QUADRATIC = np.array([10e-6, 20e-6, 30e-6])


def psins(data: Path, folder: Path, *, compensated: bool, terms: Terms = "full") -> Calibration:
    """Increments, 100 Hz; the quadratic terms of the accelerometers, which 21 parameters do not contain, taken out or
    not. A float32 cannot count hundredths of a second: the rate stands for the time."""
    source = data / "psins-systematic" / "log.parquet"
    log = pl.read_parquet(source)
    dv = log.select("dv_x", "dv_y", "dv_z").to_numpy().astype(float)
    if compensated:
        dv += PSINS_QUADRATIC * (100.0 * dv) ** 2 / PSINS_G / 100.0
    turned = log.select("dtheta_x", "dtheta_y", "dtheta_z").to_numpy().astype(float)
    made = folder / "made.parquet"
    columns = dict(zip(("vx", "vy", "vz", "tx", "ty", "tz"), [*dv.T, *turned.T], strict=True))
    pl.DataFrame(columns).write_parquet(made)
    s2 = np.sin(34.0 * DEGREE) ** 2
    gravity = PSINS_G * (1.0 + 5.27094e-3 * s2 + 2.32718e-5 * s2**2)
    return calibrate(
        session(
            folder / "session",
            [made],
            "rate_hz = 100.0",
            f"latitude_deg = 34.0\ngravity = {gravity}\ngravity_u = 1e-6",
            'columns = ["vx", "vy", "vz"]\nunit = "m/s"',
            'columns = ["tx", "ty", "tz"]\nunit = "rad"',
        ),
        terms=terms,
    )


def test_psins_truth_is_recovered_once_the_quadratic_terms_are_taken_out(data: Path, tmp_path: Path) -> None:
    """Its signs: a calibration applied to a perfect log, so that biases and scale factors come out negative and its
    angles as they are. Lever arms and the delay do not enter rotations and rests. The height of the site, and with it
    gravity, is not known to better than 10 m: 3 ppm common to the accelerometers."""
    result = psins(data, tmp_path, compensated=True)
    assert len(result.evidence.rests) == 19
    assert len(result.evidence.turns) == 18
    assert result.outcome.accepted
    for axis, size in zip("xyz", (1.0, 2.0, 3.0), strict=True):
        assert result[f"gyro.bias.{axis}"].value / DEGREE_PER_HOUR == pytest.approx(-0.1 * size, abs=2e-4)
        assert result[f"gyro.scale.{axis}"].value == pytest.approx(-10e-6 * size, abs=0.2e-6)
        assert result[f"accel.bias.{axis}"].value / (1e-6 * PSINS_G) == pytest.approx(-10.0 * size, abs=0.1)
    scales = np.array([result[f"accel.scale.{axis}"].value for axis in "xyz"]) - [-10e-6, -20e-6, -30e-6]
    assert np.abs(scales).max() < 4e-6
    assert np.ptp(scales) < 0.2e-6
    for pair, size in PSINS_GYRO_ANGLES.items():
        assert result[f"gyro.axis.{pair}"].value / ARCSEC == pytest.approx(size, abs=0.4)
    for pair, size in {"yx": 10, "zx": 20, "zy": 30}.items():
        assert result[f"accel.axis.{pair}"].value / ARCSEC == pytest.approx(size, abs=0.4)


def test_psins_as_it_is_does_not_fit_21_parameters_and_says_so(data: Path, tmp_path: Path) -> None:
    """With the faces up and down, b and b + K₂g cannot be told apart: the biases come out with the quadratic terms.
    Without noise in the log, rests that do not fit stand out by many sigmas."""
    assert not psins(data, tmp_path, compensated=False, terms="linear").outcome.accepted
    estimate = staged_estimate(tmp_path / "session")
    assert estimate.rest_sigmas.max() > 5.0
    found = dict(zip(estimate.names, estimate.values.tolist(), strict=True))
    for axis, size in zip("xyz", (1.0, 2.0, 3.0), strict=True):
        assert found[f"accel.bias.{axis}"] / (1e-6 * PSINS_G) == pytest.approx(-20.0 * size, abs=1.0)
        assert found[f"gyro.bias.{axis}"] / DEGREE_PER_HOUR == pytest.approx(-0.1 * size, abs=1e-3)
    for pair, size in PSINS_GYRO_ANGLES.items():
        assert found[f"gyro.axis.{pair}"] / ARCSEC == pytest.approx(size, abs=5.0)
