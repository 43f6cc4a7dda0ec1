"""Check positions: Eq. (21), its uncertainty and the verdict."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from tests.support.calibrated import with_fields
from tests.support.staged import staged
from tumble.errors import CalibrationError, InputError
from tumble.inference.estimate import Outcome
from tumble.programme.positions import programme
from tumble.recording.session import Site
from tumble.reduction.observations import Observations
from tumble.reduction.rests.rests import Rests
from tumble.result.calibration import Calibration
from tumble.result.parts import CalibratedDevice, Evidence, Launch, Parameter, Provenance, Readings
from tumble.rotation import rotation_matrix
from tumble.run.from_readings import calibrate_readings
from tumble.sensors.model import Block
from tumble.units import DEGREE, Array
from tumble.use.check import check_calibration
from tumble.use.positions import PositionResiduals, position_residuals, table_observations

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


def read(vertical: Array, rng: np.random.Generator, *, noise: float = NOISE, gravity: float = G) -> Observations:
    """Rests under true gravity, stated as G."""
    count = len(vertical)
    start = np.arange(0.0, 100.0 * count, 100.0)
    rests = Rests.of_white_noise(
        start,
        start + 60.0,
        accel=BLOCK.model(TRUTH).predict(gravity * vertical) + noise * rng.standard_normal((count, 3)),
        gyro=np.zeros((count, 0)),
        densities=(NOISE * np.sqrt(60.0), 0.0),
    )
    return Observations(accel_block=BLOCK, gyro_block=None, site=SITE, rests=rests)


def changed(check: Observations, readings: Array) -> Observations:
    return replace(check, rests=replace(check.rests, accel=readings))


def calibrated(own: Observations) -> Calibration:
    """The calibration from positions by the staged method."""
    estimate = staged(own)
    parameters = tuple(
        Parameter(name=name, value=float(value), u=float(u), unit=unit)
        for name, value, u, unit in zip(estimate.names, estimate.values, estimate.u, estimate.units, strict=True)
    )
    return Calibration(
        device=CalibratedDevice(serial="S"),
        method="scalar",
        frame="accelerometer",
        parameters=parameters,
        covariance=estimate.covariance,
        accel=estimate.accel,
        gyro=None,
        outcome=Outcome(),
        evidence=Evidence(fits=estimate.fits),
        provenance=Provenance(log_sha256="own", site=own.site),
    )


def calibrated_from(name: str, rng: np.random.Generator) -> Calibration:
    return calibrated(read(directions(name, rng), rng))


def beyond(found: PositionResiduals) -> list[int]:
    """The positions beyond the limit."""
    return np.flatnonzero(np.abs(found.sigmas) > found.limit).tolist()


# -------------------- what is computed --------------------


def test_the_difference_is_that_of_equation_21() -> None:
    rng = np.random.default_rng(1)
    made, check = calibrated_from("cube-14", rng), read(directions("cube-12", rng), rng)
    assert made.accel is not None
    expected = [G - np.linalg.norm(np.linalg.solve(made.accel.matrix, y - made.accel.bias)) for y in check.rests.accel]
    np.testing.assert_allclose(position_residuals(made, check, "check").difference, expected, atol=1e-14)


@cache
def drawn() -> list[tuple[Calibration, Observations]]:
    """200 calibrations from 14 positions, with five other positions."""
    rng, out = np.random.default_rng(3), []
    for _ in range(200):
        out.append((calibrated_from("cube-14", rng), read(directions("cube-12", rng)[:5], rng)))
    return out


def test_the_uncertainty_is_the_scatter_of_the_differences() -> None:
    """Known noise, so Δg/u is normal: no scatter to estimate."""
    ratios = [position_residuals(with_fields(made, fits={}), check, "check").sigmas for made, check in drawn()]
    assert np.mean(np.square(ratios)) == pytest.approx(1.0, abs=0.35)
    assert abs(np.mean(ratios)) < 5.0 / np.sqrt(200.0)


def test_a_good_calibration_is_refuted_once_in_a_hundred_times() -> None:
    """At most 5 standard deviations more than 1 %."""
    refuted = sum(bool(beyond(position_residuals(made, check, "check"))) for made, check in drawn())
    assert refuted < 2.0 + 5.0 * np.sqrt(2.0)


def test_a_bad_position_and_a_device_that_has_changed_are_beyond_the_limit() -> None:
    rng = np.random.default_rng(8)
    made, check = calibrated_from("cube-26", rng), read(directions("cube-14", rng), rng)
    bad = check.rests.accel.copy()
    bad[4] *= 1.001
    assert beyond(position_residuals(made, changed(check, bad), "check")) == [4]
    moved = changed(check, check.rests.accel + 300.0 * MICRO_G * np.array([1.0, -0.7, 0.4]))
    assert beyond(position_residuals(made, moved, "check"))


def test_an_error_of_gravity_that_is_common_cancels_and_one_that_is_not_counts() -> None:
    """The truth is 300 µg from what is stated, and the statement as uncertain. Calibrated and checked with the same
    statement nothing of it is seen; calibrated with the right value, Δg is the error and its uncertainty covers it."""
    rng, doubt = np.random.default_rng(9), 300.0 * MICRO_G
    doubtful = replace(SITE, gravity_u=doubt)
    own, check = (
        replace(read(directions(name, rng), rng, gravity=G + doubt), site=doubtful) for name in ("cube-26", "cube-12")
    )
    made = calibrated(own)
    same = position_residuals(made, check, "check")
    assert np.abs(same.difference).max() < 150.0 * MICRO_G
    assert same.u.max() < 50.0 * MICRO_G
    elsewhere = position_residuals(with_fields(made, site=replace(doubtful, gravity=G + 1e-4)), check, "check")
    assert elsewhere.u.min() > 1.4 * doubt


# -------------------- tables --------------------


def test_a_table_of_readings_has_the_scale_of_its_calibration(tmp_path: Path) -> None:
    """Volts of the other polarity, 0.1 V/g."""
    rng = np.random.default_rng(10)
    made = calibrated_from("cube-14", rng)
    scale = (-0.1 / 9.80665,) * 3
    worth = Readings(columns=("x", "y", "z"), unit="V", increments=False, scale=scale, offset=(0.0, 0.0, 0.0))
    scattered = {name: replace(fit, scatter=NOISE) for name, fit in made.evidence.fits.items()}
    made = with_fields(made, readings={"accel": worth}, fits=scattered)
    check, table = read(directions("cube-12", rng)[:5], rng), tmp_path / "check.csv"
    rows = "\n".join(",".join(f"{v:.12g}" for v in row) for row in check.rests.accel * scale)
    table.write_text(f"ux,uy,uz\n{rows}\n")
    found = check_calibration(made, table)
    expected = position_residuals(with_fields(made, fits={}), check, "check").difference
    np.testing.assert_allclose([rest.difference for rest in found.rests], expected, atol=1e-9)
    assert found.rests[1].label == "position 2 (line 3)"
    assert found.valid
    assert found.parameters == ()
    drifted = replace(made, accel=replace(made.accel, bias=made.accel.bias + 5e-3))  # type: ignore[type-var,union-attr]
    assert "g − |f| is" in check_calibration(drifted, table).reasons[0]
    with pytest.raises(CalibrationError, match="how uncertain a reading is"):
        table_observations(with_fields(made, fits={}), table)
    with pytest.raises(CalibrationError, match="what their readings are worth"):
        table_observations(with_fields(made, readings={}), table)


def test_rows_of_a_table_are_as_uncertain_as_those_within_its_positions(tmp_path: Path) -> None:
    """Blocks of four rows show no scatter beyond the rows' own, which is that of the single rows to check with."""
    rng = np.random.default_rng(11)
    readings = np.repeat(directions("cube-14", rng), 4, axis=0), directions("cube-12", rng)
    tables = [tmp_path / "readings.csv", tmp_path / "check.csv"]
    for table, vertical in zip(tables, readings, strict=True):
        rows = vertical + 1e-4 * rng.standard_normal(vertical.shape)
        table.write_text("ux,uy,uz\n" + "\n".join(",".join(f"{v:.9f}" for v in row) for row in rows) + "\n")
    calibrate_readings(tables[0], unit="g", rows_per_position=4).calibration.write(tmp_path / "c.json")
    found = check_calibration(tmp_path / "c.json", tables[1])
    assert found.valid
    assert min(rest.u or 0.0 for rest in found.rests) > 0.9e-4 * 9.80665
    assert 0.5 < np.sqrt(np.mean([(rest.sigmas or 0.0) ** 2 for rest in found.rests])) < 1.6
    with pytest.raises(InputError, match="found those it was made from"):
        check_calibration(tmp_path / "c.json", tables[0])


def test_positions_that_check_nothing_are_refused() -> None:
    rng = np.random.default_rng(11)
    own = read(directions("cube-14", rng), rng)
    made = calibrated(own)
    tetrad = Block(kind="accel", axes=np.vstack([np.eye(3), [3**-0.5] * 3]))
    rests = replace(own.rests, accel=np.zeros((14, 4)), accel_covariance=np.broadcast_to(np.eye(4), (14, 4, 4)))
    with pytest.raises(InputError, match="found 4 with other axes"):
        position_residuals(made, replace(own, accel_block=tetrad, rests=rests), "check")
    one_quadratic = Parameter(name="accel.quadratic.x", value=0.0, u=None, unit="1/(m/s^2)")
    with pytest.raises(InputError, match="all parameters of a group or none, found no"):
        position_residuals(replace(made, parameters=(*made.parameters, one_quadratic)), own, "check")
    launch = Launch(session="own", parameters=(), covariance=None, log_sha256="own")
    for from_them in (made, with_fields(made, launches=(launch, launch), log_sha256=None)):
        with pytest.raises(InputError, match="found those it was made from; record a few rests in other attitudes"):
            position_residuals(from_them, own, "own")
