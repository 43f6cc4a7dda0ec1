"""`tumble mission`: errors of navigation by a calibration, against flights integrated by pyins, closed forms and finite
differences."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from click.testing import CliRunner
from scipy.signal import lfilter

from tests.support.calibrated import calibration
from tumble.cli import main
from tumble.earth import EARTH_RATE, normal_gravity, radii_of_curvature
from tumble.errors import InputError
from tumble.planning.setup import Setup
from tumble.result.calibration import Calibration
from tumble.rotation import rotation_matrix, rotation_vector, skew
from tumble.run.calibrate import calibrate
from tumble.sensors.instrument import Instrument, readings
from tumble.sensors.parameters import group_of
from tumble.simulation.session import simulate_session
from tumble.units import DEGREE, Array
from tumble.use.error_sources import calibrated, noise_of
from tumble.use.mission import QUANTITIES, error_dynamics, mission
from tumble.use.trajectory import STEP, trajectory_of

NED = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
"""North, east, down of north, up, east."""
FLIGHTS = {"car": 1000, "quadrotor": 500}


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Calibration:
    """A calibration of a mems unit."""
    folder = tmp_path_factory.mktemp("mission") / "session"
    return calibrate(simulate_session(folder, Setup.of(grade="mems"), seed=1))


def flights(made: Calibration, name: str, at: list[int], rng: np.random.Generator) -> Array:
    """Errors (N, T, 9) of attitude, velocity and position, N, U, E, after so many steps: readings of a device
    with drawn parameters, noise and in-run biases, corrected by its calibration and integrated by pyins."""
    import pandas as pd
    from pyins._numba_integrate import integrate  # of its Integrator, whose tables take most of the time
    from pyins.sim import generate_imu
    from pyins.strapdown import compute_increments_from_imu
    from pyins.transform import compute_lla_difference, mat_from_rph, mat_to_rph
    from pyins.util import ACCEL_COLS, GYRO_COLS, LLA_COLS, RPH_COLS, VEL_COLS

    assert made.site is not None
    assert made.site.latitude is not None
    flown = trajectory_of(name, made.site.latitude, made.site.height)
    time = np.arange(len(flown.position)) * STEP
    start = np.array([flown.latitude / DEGREE, 37.0, flown.height])
    true, imu = generate_imu(time, start, mat_to_rph(NED @ flown.mat_nb), flown.velocity @ NED.T, "increment")
    force, rate = imu[ACCEL_COLS].to_numpy() / STEP, imu[GYRO_COLS].to_numpy() / STEP

    known = made.compensator
    instrument = Instrument.of(known.accel, known.gyro, variables=())
    usual = np.diag([group_of(each).usual.get("mems", 0.0) ** 2 for each in instrument.names])
    covariance, _ = calibrated(made, instrument.names, usual)
    values = np.array([made[each].value if each in made else 0.0 for each in instrument.names])
    _, noise, _ = noise_of(made, "mems")
    root = np.linalg.cholesky(covariance + 1e-30 * np.eye(len(usual)))
    lla, velocity, attitude = (true[columns].to_numpy() for columns in (LLA_COLS, VEL_COLS, RPH_COLS))
    of_truth, (places, speeds, mat_nb) = (
        mat_from_rph(attitude[at]),
        (lla.copy(), velocity.copy(), mat_from_rph(attitude)),
    )
    out = np.empty((FLIGHTS[name], len(at), 9))
    for each in out:
        K = instrument.all_coefficients(values + root @ rng.standard_normal(len(values)))
        read = []
        for block, of in zip(instrument.blocks, noise, strict=True):
            kept, drawn = np.exp(-STEP / of.time), rng.standard_normal((2, len(time), 3))
            drawn[0, 1:] *= np.sqrt(1.0 - kept**2)
            bias = lfilter([1.0], [1.0, -kept], drawn[0], axis=0)
            random = of.in_run * bias + of.white / np.sqrt(STEP) * drawn[1]
            read.append(readings(block, K[instrument.rows(block)], force, rate) + random)
        corrected = known.force(read[0])
        both = np.hstack([known.rate(read[1], corrected), corrected]) * STEP
        frame = pd.DataFrame(both, index=imu.index, columns=GYRO_COLS + ACCEL_COLS)
        dt, theta, dv = np.split(compute_increments_from_imu(frame, "increment").to_numpy(), [1, 4], axis=1)
        turned_by, moved_by = np.ascontiguousarray(theta), np.ascontiguousarray(dv)
        integrate(dt[:, 0].copy(), places, speeds, mat_nb, turned_by, moved_by, 0, with_altitude=True)
        each[:, :3] = rotation_vector(mat_nb[at] @ np.swapaxes(of_truth, 1, 2)) @ NED
        each[:, 3:6] = (speeds - velocity)[at] @ NED
        each[:, 6:] = compute_lla_difference(places[at], lla[at]) @ NED
    return out


@pytest.mark.filterwarnings("ignore:The copy keyword is deprecated")  # of pandas, in pyins 1.0
@pytest.mark.parametrize("name", ["car", "quadrotor"])
def test_heading_and_position_are_as_scattered_as_flights_by_pyins(made: Calibration, name: str) -> None:
    """500 flights of ten minutes, and 1000 of one, within 5 %: by chance a standard deviation has 3.2 and 2.2 %."""
    found = mission(made, name)
    at = [round(float(found.times[k]) / STEP) for k in found.marks]
    squares = np.mean(flights(made, name, at, np.random.default_rng(7)) ** 2, axis=0)
    heading, position = np.sqrt(squares[:, 1]), np.sqrt(squares[:, 6] + squares[:, 8])
    marks = list(found.marks)
    np.testing.assert_allclose(found.after[marks, 0], heading, rtol=0.05)
    np.testing.assert_allclose(found.after[marks, 2], position, rtol=0.05)


def test_error_dynamics_are_the_derivative_of_the_mechanisation() -> None:
    """F by central differences of C' = C [ω_ib×] − [ω_in×] C, v' = C f_b + g − (2 ω_ie + ω_en) × v and latitude,
    longitude, height, at 60° and 200 m/s."""
    L, h, v, C = 1.05, 900.0, np.array([150.0, 5.0, -130.0]), rotation_matrix(np.array([0.4, 1.1, -0.3]))
    f_b, w_b = np.array([1.0, 9.0, 2.0]), np.array([0.1, -0.2, 0.3])

    def radii(latitude: float, height: float) -> tuple[float, float]:
        along, across = radii_of_curvature(np.array(latitude))
        return float(along) + height, float(across) + height

    def derivative(attitude: Array, velocity: Array, latitude: float, height: float) -> tuple[Array, Array, Array]:
        along, across = radii(latitude, height)
        ie = EARTH_RATE * np.array([np.cos(latitude), np.sin(latitude), 0.0])
        en = np.array([velocity[2] / across, velocity[2] * np.tan(latitude) / across, -velocity[0] / along])
        gravity = np.array([0.0, -normal_gravity(L, height), 0.0])  # by latitude 7e-9 1/s², left out
        turn = attitude @ skew(w_b) - skew(ie + en) @ attitude
        rate = np.array([velocity[0] / along, velocity[2] / (across * np.cos(latitude)), velocity[1]])
        return turn, attitude @ f_b + gravity - np.cross(2.0 * ie + en, velocity), rate

    def off_by(x: Array) -> Array:
        (along, across), (turn, force, rate) = radii(L, h), derivative(C, v, L, h)
        lat, lon = x[6] / along, x[8] / (across * np.cos(L))
        wrong = rotation_matrix(x[:3]) @ C
        turn_x, force_x, rate_x = derivative(wrong, v + x[3:6], L + lat, h + x[7])
        phi = turn_x @ C.T + wrong @ turn.T
        scales = np.array([along, across * np.cos(L)])
        later = radii(L + 1e-6 * rate[0], h + 1e-6 * rate[2])
        moved = (np.array([later[0], later[1] * np.cos(L + 1e-6 * rate[0])]) - scales) / 1e-6
        north, east = scales * (rate_x - rate)[:2] + moved * np.array([lat, lon])
        return np.array([phi[2, 1], phi[0, 2], phi[1, 0], *(force_x - force), north, rate_x[2] - rate[2], east])

    sizes = np.repeat([1e-4, 1e-1, 1e2], 3)
    F = np.column_stack(
        [(off_by(step) - off_by(-step)) / (2.0 * s) for step, s in zip(np.diag(sizes), sizes, strict=True)]
    )
    force = (C @ f_b)[None]
    ours = error_dynamics(np.array([L]), np.array([h]), v[None], force)[0]
    np.testing.assert_allclose(ours, F, rtol=0.02, atol=1e-12)


def single(made: Calibration, name: str, u: float) -> Calibration:
    """A calibration that knows all but one parameter, without noise."""
    covariance = np.diag([u**2 if p.name == name else 0.0 for p in made.parameters])
    return replace(made, covariance=covariance)


def test_at_rest_errors_grow_as_in_closed_form() -> None:
    """Of a known start an accelerometer's bias b gives b t²/2 and a gyro's about a level axis g b t³/6, less what 600 s
    of Schuler's 84 min take off; the gyro's about the vertical turns the heading by b t. Levelled, a bias tilts by b/g
    and moves nothing at first."""
    made, b, w = calibration(), 1e-3, 1e-6
    assert made.accel is not None
    assert made.gyro is not None
    of_accel, of_gyro = np.linalg.inv(made.accel.matrix), np.linalg.inv(made.gyro.matrix)
    level, g = np.linalg.norm(of_accel[:2, 0]), normal_gravity(0.992, 270.0)
    found = mission(single(made, "accel.bias.x", b), "standing", latitude_deg=56.84)
    part, (_, minute, last) = found.sources.index("biases of the accelerometers"), found.marks
    assert found.after_parts[part, minute, 2] == pytest.approx((0.5 * b * level * 60.0**2) ** 2, rel=2e-3)
    schuler = np.sqrt(g / 6.37e6)
    whole = b * level / schuler**2 * (1.0 - np.cos(schuler * 600.0))
    assert found.after_parts[part, last, 2] == pytest.approx(whole**2, rel=5e-3)
    levelled = mission(single(made, "accel.bias.x", b), "standing", latitude_deg=56.84, levelled=True)
    assert levelled.after_parts[part, 0, 1] == pytest.approx((b * level / g) ** 2, rel=1e-3)
    assert levelled.after_parts[part, last, 2] < (0.02 * whole) ** 2

    part = found.sources.index("biases of the gyros")
    turning = mission(single(made, "gyro.bias.z", w), "standing", latitude_deg=56.84)
    assert turning.after_parts[part, minute, 0] == pytest.approx((w * of_gyro[2, 2] * 60.0) ** 2, rel=1e-4)
    tilting = mission(single(made, "gyro.bias.y", w), "standing", latitude_deg=56.84)
    way = g * w * np.linalg.norm(of_gyro[:2, 1]) * 60.0**3 / 6.0
    assert tilting.after_parts[part, minute, 2] == pytest.approx(way**2, rel=2e-3)


def test_parts_add_up_and_calibration_helps(made: Calibration) -> None:
    """Of every quantity at every time; the variance before is that of what is usual."""
    found = mission(made, "car")
    np.testing.assert_allclose(found.after_parts.sum(axis=0), found.after**2, rtol=1e-9)
    np.testing.assert_allclose(found.before_parts.sum(axis=0), found.before**2, rtol=1e-9)
    position = np.diagonal(found.covariance, axis1=1, axis2=2)
    np.testing.assert_allclose(position[:, 6] + position[:, 8], found.after[:, 2] ** 2, rtol=1e-9)
    assert np.all(found.after < 0.5 * found.before)
    assert (
        not mission(made, "car", temperature_change=0.0)
        .after_parts[found.sources.index("temperature of the gyros")]
        .any()
    )
    warm = mission(made, "car", temperature_change=20.0)
    assert warm.after[-1, 0] > 2.0 * found.after[-1, 0]  # slopes that this calibration does not have
    assert any("gyro.bias.t1" in remark for remark in warm.remarks)


def test_a_trajectory_from_a_file_is_that_built_in(made: Calibration, tmp_path: Path) -> None:
    """Written at 20 Hz with latitude, longitude, height and the angles of the vehicle, and read again."""
    flown = trajectory_of("quadrotor", 0.99, 200.0)
    mat_nv = flown.mat_nb @ np.linalg.inv(np.array([[1.0, 0, 0], [0, 0, 1.0], [0, -1.0, 0]]))
    forward, up, right = np.moveaxis(mat_nv, 2, 0)
    along, across = radii_of_curvature(np.array(0.99))
    latitude = 0.99 + flown.position[:, 0] / (along + 200.0)
    columns = {
        "time": 5.0 + np.arange(len(forward)) * STEP,
        "latitude": latitude / DEGREE,
        "longitude": 30.0 + flown.position[:, 2] / ((across + 200.0) * np.cos(latitude)) / DEGREE,
        "height": 200.0 + flown.position[:, 1],
        "roll": np.arctan2(-right[:, 1], up[:, 1]) / DEGREE,
        "pitch": np.arcsin(forward[:, 1]) / DEGREE,
        "heading": np.arctan2(forward[:, 2], forward[:, 0]) / DEGREE,
    }
    path = tmp_path / "flight.csv"
    pl.DataFrame(columns).write_csv(path)
    read = trajectory_of(path, 0.0, 0.0)
    np.testing.assert_allclose(read.mat_nb, flown.mat_nb, atol=1e-9)
    np.testing.assert_allclose(read.position, flown.position, atol=0.02)
    by_file, built_in = mission(made, path), mission(made, "quadrotor", latitude_deg=0.99 / DEGREE)
    np.testing.assert_allclose(by_file.after[-1], built_in.after[-1], rtol=1e-2)


@pytest.mark.parametrize(
    ("rows", "says"),
    [
        ("time,north,up,roll,pitch,heading\n0,0,0,0,0,0\n", "no east"),
        ("time,north,up,east,roll,pitch,heading\n" + "0,0,0,0,0,0,0\n" * 5, "time growing"),
        ("time,north,up,east,roll,pitch,heading\n" + "a,0,0,0,0,0,0\n" * 5, "expected numbers"),
    ],
)
def test_a_file_that_is_no_trajectory_is_refused(tmp_path: Path, rows: str, says: str) -> None:
    path = tmp_path / "flight.csv"
    path.write_text(rows)
    with pytest.raises(InputError, match=says):
        trajectory_of(path, 0.9, 0.0)


def test_what_is_no_trajectory_and_no_mounting_is_refused() -> None:
    with pytest.raises(InputError, match="did you mean 'quadrotor'"):
        trajectory_of("quadrotr", 0.9, 0.0)
    with pytest.raises(InputError, match="another axis than forward"):
        trajectory_of("car", 0.9, 0.0, "x", "-x")


def test_the_command_says_what_contributes_and_its_json_is_the_mission(made: Calibration, tmp_path: Path) -> None:
    file = tmp_path / "calibration.json"
    made.write(file)
    picture = tmp_path / "mission.svg"
    ran = CliRunner().invoke(main, ["mission", str(file), "--trajectory", "standing", "--plot", str(picture)])
    assert ran.exit_code == 0, ran.output
    assert "after 600 s" in ran.output
    assert "biases of the gyros" in ran.output
    assert picture.read_text().lstrip().startswith("<?xml")
    ran = CliRunner().invoke(main, ["mission", str(file), "--trajectory", "standing", "--json"])
    data, found = json.loads(ran.stdout), mission(made, "standing")
    assert data["quantities"] == list(QUANTITIES)
    np.testing.assert_allclose([row["after"] for row in data["times"]], found.after, rtol=1e-9)
