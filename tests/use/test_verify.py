"""Check positions: Eq. (21) with an uncertainty that is that of the differences, and a verdict that holds."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from tests.support.staged import staged
from tumble.cli import main
from tumble.errors import CalibrationError, InputError
from tumble.inference.estimate import Estimate, Outcome
from tumble.planning.setup import Setup
from tumble.programme.positions import programme
from tumble.recording.session import Site
from tumble.reduction.observations import Observations
from tumble.reduction.rests.rests import Rests
from tumble.result.calibration import Calibration, read_calibration
from tumble.result.parts import CalibratedDevice, Parameter, Readings
from tumble.rotation import rotation_matrix
from tumble.run.calibrate import calibrate
from tumble.run.case import relate
from tumble.run.from_readings import calibrate_table
from tumble.sensors.frames import FRAMES
from tumble.sensors.model import Block
from tumble.simulation.session import simulate_session
from tumble.units import DEGREE, Array
from tumble.use.verify import TURNED_ON, Positions, positions_of, verify_calibration, verticals

G = 9.8159
SITE = Site(latitude=None, height=0.0, gravity=G, gravity_u=0.0)
BLOCK = Block(kind="accel", axes=np.eye(3))
TRUTH = np.array([0.05, -0.02, 0.03, 4e-3, -2e-3, 3e-3, 5e-3, -4e-3, 3e-3])
NOISE = 3e-5 * G
MICRO_G = 1e-6 * G


@cache
def nominal_of(name: str) -> Array:
    return np.array([p.vertical_b for p in programme(name).positions])


def directions(name: str, rng: np.random.Generator) -> Array:
    """Verticals of a programme, each off by 2° about every axis."""
    nominal = nominal_of(name)
    return np.asarray(
        np.einsum("ijk,ik->ij", rotation_matrix(2.0 * DEGREE * rng.uniform(-1, 1, nominal.shape)), nominal)
    )


def read(
    vertical: Array, rng: np.random.Generator, *, noise: float = NOISE, gravity: float = G, sha256: str = "check"
) -> Positions:
    """Readings at rest under true gravity, stated as G."""
    count = len(vertical)
    return Positions(
        block=BLOCK,
        readings=BLOCK.model(TRUTH).predict(gravity * vertical) + noise * rng.standard_normal((count, 3)),
        covariance=np.broadcast_to(NOISE**2 * np.eye(3), (count, 3, 3)),
        labels=tuple(f"rest {i + 1}" for i in range(count)),
        gravity=G,
        gravity_u=0.0,
        sha256=sha256,
    )


def observed(positions: Positions) -> Observations:
    count = len(positions.readings)
    start = np.arange(0.0, 100.0 * count, 100.0)
    empty, none = np.zeros((count, 3)), np.empty((count, 0))
    return Observations(
        accel_block=BLOCK,
        gyro_block=None,
        site=replace(SITE, gravity_u=positions.gravity_u),
        rests=Rests(
            file=np.zeros(count, dtype=np.int64),
            start=start,
            stop=start + 60.0,
            accel=positions.readings,
            accel_covariance=positions.covariance,
            accel_drift=empty,
            accel_noise=empty,
            gyro=none,
            gyro_covariance=np.empty((count, 0, 0)),
            gyro_drift=none,
            gyro_noise=none,
            temperatures=None,
        ),
        turns=None,
        turn_samples=None,
        programme=None,
        position=None,
    )


def calibrated(positions: Positions, *, site: Site = SITE) -> tuple[Calibration, Estimate]:
    """The calibration from positions by the staged method."""
    estimate = staged(observed(positions))
    parameters = tuple(
        Parameter(name=name, value=float(value), u=float(u), unit=unit)
        for name, value, u, unit in zip(estimate.names, estimate.values, estimate.u, estimate.units, strict=True)
    )
    made = Calibration(
        device=CalibratedDevice(serial="S"),
        method="staged",
        frame="accelerometer",
        parameters=parameters,
        covariance=estimate.covariance,
        accel=estimate.accel,
        gyro=None,
        outcome=Outcome(),
        fits=estimate.fits,
        site=site,
        provenance={"log_sha256": positions.sha256},
    )
    return made, estimate


# -------------------- what is computed --------------------


def test_the_difference_is_that_of_equation_21() -> None:
    rng = np.random.default_rng(1)
    made, _ = calibrated(read(directions("cube-14", rng), rng, sha256="own"))
    check = read(directions("cube-12", rng), rng)
    assert made.accel is not None
    expected = [G - np.linalg.norm(np.linalg.solve(made.accel.matrix, y - made.accel.bias)) for y in check.readings]
    np.testing.assert_allclose(verify_calibration(made, check).difference, expected, atol=1e-14)


def test_a_perfect_calibration_leaves_nothing_in_perfect_positions() -> None:
    rng = np.random.default_rng(2)
    made, _ = calibrated(read(directions("cube-14", rng), rng, noise=0.0, sha256="own"))
    found = verify_calibration(made, read(directions("cube-12", rng), rng, noise=0.0))
    assert np.abs(found.difference).max() < 1e-9
    assert found.reasons == ()


@cache
def drawn() -> list[tuple[Calibration, Positions, Positions]]:
    """200 calibrations from 14 positions, these, and five others."""
    rng, out = np.random.default_rng(3), []
    for _ in range(200):
        own = read(directions("cube-14", rng), rng, sha256="own")
        out.append((calibrated(own)[0], own, read(directions("cube-12", rng)[:5], rng)))
    return out


def test_the_uncertainty_is_the_scatter_of_the_differences() -> None:
    """Known noise, so Δg/u is normal: no scatter to estimate."""
    ratios = []
    for made, _, check in drawn():
        found = verify_calibration(replace(made, fits={}), check)
        ratios.append(found.difference / found.u)
    assert np.mean(np.square(ratios)) == pytest.approx(1.0, abs=0.35)
    assert abs(np.mean(ratios)) < 5.0 / np.sqrt(200.0)


def test_a_good_calibration_is_refused_once_in_a_hundred_times() -> None:
    """At most 5 standard deviations more than 1 %, for check positions and for those left out."""
    refused = np.zeros(2)
    for made, own, check in drawn():
        refused += [bool(verify_calibration(made, positions).reasons) for positions in (check, own)]
    assert (refused < 2.0 + 5.0 * np.sqrt(2.0)).all()


def test_left_out_positions_are_those_of_a_fit_without_them() -> None:
    """Each position left out for good, and the calibration of the others asked about it."""
    rng = np.random.default_rng(5)
    own = read(directions("cube-14", rng), rng, sha256="own")
    made, _ = calibrated(own)
    made = replace(made, fits={name: replace(fit, scatter=0.0) for name, fit in made.fits.items()})
    found = verify_calibration(made, own)
    assert found.left_out
    for i in range(14):
        others = [k for k in range(14) if k != i]
        kept = replace(own, readings=own.readings[others], covariance=own.covariance[others], labels=own.labels[1:])
        alone = replace(
            own,
            readings=own.readings[[i]],
            covariance=own.covariance[[i]],
            labels=own.labels[:1],
            sha256="another",
        )
        without, estimate = calibrated(kept)
        if estimate.fits["accelerometers"].scatter > 0.0:
            continue  # this one has other weights
        expected = verify_calibration(without, alone)
        assert found.difference[i] == pytest.approx(expected.difference[0], abs=0.02 * expected.u[0])
        assert found.u[i] == pytest.approx(expected.u[0], rel=0.02)


def test_nine_positions_leave_nothing_that_checks_them() -> None:
    rng = np.random.default_rng(6)
    own = read(directions("nine", rng), rng, sha256="own")
    made, _ = calibrated(own)
    found = verify_calibration(made, own)
    assert len(found.reasons) == 1
    assert "record check positions" in found.reasons[0]


def test_a_bad_position_is_named() -> None:
    rng = np.random.default_rng(7)
    made, _ = calibrated(read(directions("cube-26", rng), rng, sha256="own"))
    check = read(directions("cube-12", rng), rng)
    check.readings[4] *= 1.001
    reasons = verify_calibration(made, check).reasons
    assert len(reasons) == 1
    assert reasons[0].startswith("rest 5: Δg is -")
    assert "mg" in reasons[0]


def test_a_device_that_has_changed_is_refused() -> None:
    rng = np.random.default_rng(8)
    made, _ = calibrated(read(directions("cube-26", rng), rng, sha256="own"))
    check = read(directions("cube-14", rng), rng)
    moved = replace(check, readings=check.readings + np.array([500.0 * MICRO_G, 0.0, 0.0]))
    assert len(verify_calibration(made, moved).reasons) >= 2


def test_a_refusal_says_whether_turning_on_again_explains_it() -> None:
    """Biases that change by 0.3 mg do in MEMS units, and not in navigation; a bad position is explained by neither."""
    rng = np.random.default_rng(8)
    made, _ = calibrated(read(directions("cube-26", rng), rng, sha256="own"))
    check = read(directions("cube-14", rng), rng)
    moved = replace(check, readings=check.readings + 300.0 * MICRO_G * np.array([1.0, -0.7, 0.4]))
    bad = check.readings.copy()
    bad[4] *= 1.001
    for positions, grade, explained in (
        (moved, "mems", True),
        (moved, "navigation", False),
        (moved, None, False),
        (replace(check, readings=bad), "mems", False),
    ):
        found = verify_calibration(made, replace(positions, grade=grade))
        assert len(found.reasons) >= 1
        assert (found.reasons[-1] == TURNED_ON) == explained, (grade, found.reasons)


# -------------------- gravity --------------------


def test_an_error_of_gravity_that_is_common_cancels_and_one_that_is_not_counts() -> None:
    """The truth is 300 µg from what is stated, and the statement as uncertain. Calibrated and verified with the same
    statement nothing of it is seen; calibrated with the right value, Δg is the error and its uncertainty covers it."""
    rng = np.random.default_rng(9)
    doubt = 300.0 * MICRO_G
    own = replace(read(directions("cube-26", rng), rng, gravity=G + doubt, sha256="own"), gravity_u=doubt)
    check = replace(read(directions("cube-12", rng), rng, gravity=G + doubt), gravity_u=doubt)
    made, _ = calibrated(own, site=replace(SITE, gravity_u=doubt))
    same = verify_calibration(made, check)
    assert np.abs(same.difference).max() < 150.0 * MICRO_G
    assert same.u.max() < 50.0 * MICRO_G
    elsewhere = verify_calibration(replace(made, site=replace(SITE, gravity=G + 1e-4, gravity_u=doubt)), check)
    assert elsewhere.u.min() > 1.4 * doubt
    left_out = verify_calibration(made, own)
    assert left_out.u.max() < 60.0 * MICRO_G


# -------------------- sessions, tables, refusals --------------------

REQUEST = Setup.of(programme="cube-14", rest=8.0, rate_deg_s=40.0, sample_rate=50.0)


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    base = tmp_path_factory.mktemp("verify")
    edges = replace(REQUEST, programme=programme("cube-12"))
    return {
        "own": simulate_session(base / "own", REQUEST, seed=51),
        "check": simulate_session(base / "check", edges, seed=51, launch=2),
        "other": simulate_session(base / "other", edges, seed=52),
    }


def run(*arguments: str) -> tuple[int, str, str]:
    result = CliRunner().invoke(main, arguments)
    return result.exit_code, result.stdout, result.stderr


def test_every_frame_verifies_alike(folders: dict[str, Path]) -> None:
    found = []
    for frame in FRAMES:
        made = calibrate(folders["own"], frame=frame, terms="linear")
        found.append(
            (
                verify_calibration(made, positions_of(folders["check"], made)),
                verify_calibration(made, positions_of(folders["own"], made)),
            )
        )
    for check, own in found[1:]:
        np.testing.assert_allclose(check.difference, found[0][0].difference, atol=1e-12)
        np.testing.assert_allclose(check.u, found[0][0].u, rtol=1e-6)
        np.testing.assert_allclose(own.sigmas, found[0][1].sigmas, rtol=1e-5)


def test_the_command_ends_with_its_verdict(folders: dict[str, Path], tmp_path: Path) -> None:
    made = tmp_path / "c.json"
    assert run("calibrate", str(folders["own"]), "--out", str(made))[0] == 0
    status, out, _ = run("verify", str(made), str(folders["check"]))
    assert status == 0, out
    assert out.startswith("check positions\n")
    assert out.rstrip().endswith("\naccepted")
    assert out.count("rest ") == 12
    status, out, _ = run("verify", str(made), str(folders["own"]))
    assert status == 0, out
    assert "left out in turn" in out
    calibration = read_calibration(made)
    assert calibration.accel is not None
    drifted = replace(
        calibration, accel=replace(calibration.accel, bias=calibration.accel.bias + 5e-3), provenance={"log_sha256": ""}
    )
    drifted.write(tmp_path / "drifted.json")
    status, out, err = run("verify", str(tmp_path / "drifted.json"), str(folders["check"]))
    assert status == 1
    assert out.rstrip().endswith("\nnot accepted")
    assert "not accepted: rest " in err
    status, _, err = run("verify", str(made), str(folders["other"]))
    assert status == 2
    assert "expected a session of device 'navigation-51'" in err
    assert err.count("\n") == 1


def test_a_table_of_readings_is_verified_with_the_scale_of_its_calibration(tmp_path: Path) -> None:
    """Volts of the other polarity, 0.1 V/g."""
    rng = np.random.default_rng(10)
    made, _ = calibrated(read(directions("cube-14", rng), rng, sha256="own"))
    scale = (-0.1 / 9.80665,) * 3
    worth = Readings(columns=("x", "y", "z"), unit="V", increments=False, scale=scale, offset=(0.0, 0.0, 0.0))
    scattered = {name: replace(fit, scatter=NOISE) for name, fit in made.fits.items()}
    made = replace(made, readings={"accel": worth}, fits=scattered)
    check = read(directions("cube-12", rng)[:5], rng)
    table = tmp_path / "check.csv"
    rows = "\n".join(",".join(f"{v:.12g}" for v in row) for row in check.readings * scale)
    table.write_text(f"ux,uy,uz\n{rows}\n")
    found = verify_calibration(made, positions_of(table, made))
    np.testing.assert_allclose(
        found.difference, verify_calibration(replace(made, fits={}), check).difference, atol=1e-9
    )
    assert found.labels[1] == "position 2 (line 3)"
    made.write(tmp_path / "c.json")
    assert run("verify", str(tmp_path / "c.json"), str(table))[0] == 0
    with pytest.raises(CalibrationError, match="how uncertain a reading is"):
        positions_of(table, replace(made, fits={}))
    with pytest.raises(CalibrationError, match="what their readings are worth"):
        positions_of(table, replace(made, readings={}))


def test_rows_of_a_table_are_as_uncertain_as_those_within_its_positions(tmp_path: Path) -> None:
    """Blocks of four rows show no scatter beyond the rows' own, which is that of the single rows to check with."""
    rng = np.random.default_rng(11)
    readings = np.repeat(directions("cube-14", rng), 4, axis=0), directions("cube-12", rng)
    tables = [tmp_path / "readings.csv", tmp_path / "check.csv"]
    for table, vertical in zip(tables, readings, strict=True):
        rows = vertical + 1e-4 * rng.standard_normal(vertical.shape)
        table.write_text("ux,uy,uz\n" + "\n".join(",".join(f"{v:.9f}" for v in row) for row in rows) + "\n")
    calibrate_table(tables[0], unit="g", rows_per_position=4).calibration.write(tmp_path / "c.json")
    found = verify_calibration(tmp_path / "c.json", tables[1])
    assert found.reasons == ()
    assert found.u.min() > 0.9e-4 * 9.80665
    assert 0.5 < np.sqrt(np.mean((found.difference / found.u) ** 2)) < 1.6


def test_what_cannot_be_verified_is_refused(folders: dict[str, Path]) -> None:
    rng = np.random.default_rng(11)
    own = read(directions("cube-14", rng), rng, sha256="own")
    made, _ = calibrated(own)
    with pytest.raises(CalibrationError, match="expected an accepted one"):
        verify_calibration(replace(made, outcome=Outcome(reasons=("rest 3 does not fit",))), own)
    tetrad = Block(kind="accel", axes=np.vstack([np.eye(3), [3**-0.5] * 3]))
    four = replace(
        own,
        block=tetrad,
        readings=np.zeros((14, 4)),
        covariance=np.broadcast_to(np.eye(4), (14, 4, 4)),
    )
    with pytest.raises(InputError, match="found 4 with other axes"):
        verify_calibration(made, four)
    one_quadratic = Parameter(name="accel.quadratic.x", value=0.0, u=None, unit="1/(m/s^2)")
    with pytest.raises(InputError, match="all parameters of a group or none, found no"):
        verify_calibration(replace(made, parameters=(*made.parameters, one_quadratic)), own)
    session = calibrate(folders["own"], terms="linear")
    from tumble.result.parts import Launch

    launch = Launch(session="own", parameters=(), covariance=None, log_sha256=session.provenance["log_sha256"])
    with pytest.raises(InputError, match="one of its 2 launches"):
        verify_calibration(
            replace(session, launches=(launch, launch), provenance={}), positions_of(folders["own"], session)
        )


# -------------------- two blocks on one base --------------------


def test_two_calibrated_blocks_on_one_base_are_related() -> None:
    """A second block, turned by 30° on the base of the first, in the same twelve positions."""
    rng = np.random.default_rng(12)
    mat_12 = rotation_matrix(np.array([0.1, 0.5, -0.05]))
    base = directions("cube-12", rng)
    seen = []
    for turn in (np.eye(3), mat_12):
        own = read(directions("cube-14", rng), rng, sha256="own")
        seen.append(verticals(calibrated(own)[0], read(base @ turn, rng)))
    relation = relate(*seen)
    found = relation.mat_12 @ mat_12.T
    psi = 0.5 * np.array([found[2, 1] - found[1, 2], found[0, 2] - found[2, 0], found[1, 0] - found[0, 1]])
    assert psi @ np.linalg.solve(relation.covariance, psi) < 25.0
    assert 1e-5 < np.sqrt(np.diag(relation.covariance)).min() < 1e-4
