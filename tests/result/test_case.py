"""The case and two blocks: rotations from verticals, with an uncertainty that is that of the errors."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.spatial.transform import Rotation

from tests.support.staged import staged
from tumble.cli import main
from tumble.errors import InputError
from tumble.planning.setup import Setup
from tumble.programme.positions import BUILT_IN, attitude, from_attitudes, programme
from tumble.reduction.observations import Observations
from tumble.result.calibration import read_calibration
from tumble.rotation import rotation_matrix, unit_vector
from tumble.run.calibrate import calibrate
from tumble.run.case import (
    CaseAlignment,
    align_case,
    estimate_in,
    vertical_by_parameters,
)
from tumble.sensors.model import Block
from tumble.simulation.observations import simulate_observations
from tumble.simulation.scenario import Scenario, itinerary, scenario_of
from tumble.simulation.session import simulate_session
from tumble.units import DEGREE, Array

FACES = ("UEN", "DWN", "NUE", "NDW", "ENU", "WND")
DOUBLED = tuple(code + turn for code in FACES for turn in ("", " U+180"))
UP = np.array([0.0, 1.0, 0.0])


def exact(direction: Array) -> tuple[Array, Array]:
    """Verticals that depend on no parameters."""
    return direction, np.zeros((len(direction), 3, 0))


def placed(codes: tuple[str, ...], mat_cb: Array, lean: Array, seating: Array) -> tuple[Array, Array]:
    """Verticals in b and in the case of a block that stands on a plate whose normal leans by `lean` (2,), rad, to north
    and east, with errors (N, 3) of the seating."""
    nominal = np.array([attitude(code) for code in codes])
    plate = rotation_matrix(np.array([lean[1], 0.0, -lean[0]]))  # the normal U goes by +N for a turn about −E
    np.testing.assert_allclose((plate @ UP)[[0, 2]], lean, atol=1e-3 * float(np.linalg.norm(lean)) + 1e-15)
    true = rotation_matrix(seating) @ plate @ nominal
    return np.swapaxes(true @ mat_cb, 1, 2) @ UP, nominal[:, 1, :]


def found(codes: tuple[str, ...], mat_cb: Array, lean: Array, seating: Array) -> CaseAlignment:
    direction, normals = placed(codes, mat_cb, lean, seating)
    return align_case(*exact(direction), normals)


def error(alignment: CaseAlignment, mat_cb: Array) -> Array:
    """Rotation vector, rad, from the true case to the one found."""
    return Rotation.from_matrix(alignment.alignment.mat_cb @ mat_cb.T).as_rotvec()


# -------------------- the rotation --------------------


def test_on_a_level_plate_the_case_is_found_exactly() -> None:
    mat_cb = rotation_matrix(np.array([0.02, -0.03, 0.01]))
    alignment = found(FACES, mat_cb, np.zeros(2), np.zeros((6, 3)))
    np.testing.assert_allclose(alignment.alignment.mat_cb, mat_cb, atol=1e-14)
    assert alignment.scatter < 1e-12


@pytest.mark.parametrize("lean", [(0.01, 0.0), (0.0, 0.01), (-0.006, 0.008)])
def test_faces_doubled_by_180_degrees_cancel_the_tilt(lean: tuple[float, float]) -> None:
    """A plate that leans by 0.57°: the rotation is free of it to the second order, and the scatter contains it."""
    mat_cb = rotation_matrix(np.array([0.02, -0.03, 0.01]))
    alignment = found(DOUBLED, mat_cb, np.array(lean), np.zeros((12, 3)))
    assert np.linalg.norm(error(alignment, mat_cb)) < 2e-4 * 0.01
    assert 0.005 < alignment.scatter < 0.01


@pytest.mark.parametrize("codes", [FACES, DOUBLED], ids=["six", "doubled"])
def test_the_covariance_is_that_of_the_errors(codes: tuple[str, ...]) -> None:
    """Seating errors of 3 mrad, 500 draws: with the scatter from the same residuals, ψᵀ Σ⁻¹ ψ / 3 is Fisher's F of 3
    and so many degrees, whose quantiles it must have."""
    from scipy.stats import f

    rng = np.random.default_rng(1 + len(codes))
    mat_cb = rotation_matrix(np.array([0.02, -0.01, 0.03]))
    draws, ratios = 500, []
    for _ in range(draws):
        alignment = found(codes, mat_cb, np.zeros(2), 3e-3 * rng.standard_normal((len(codes), 3)))
        psi = error(alignment, mat_cb)
        ratios.append(psi @ np.linalg.solve(alignment.alignment.covariance, psi) / 3.0)
    degrees = 2 * len(codes) - 3
    for quantile in (0.5, 0.9):
        below = np.mean(np.array(ratios) < f.ppf(quantile, 3, degrees))
        assert abs(below - quantile) < 5.5 * np.sqrt(quantile * (1.0 - quantile) / draws)


def test_the_rotation_changes_with_the_accelerometer_parameters_as_said() -> None:
    block = Block(kind="accel", axes=np.eye(3))
    values = np.array([0.05, -0.02, 0.03, 4e-3, -2e-3, 3e-3, 5e-3, -4e-3, 3e-3])
    mat_cb = rotation_matrix(np.array([0.02, -0.03, 0.01]))
    direction, normals = placed(FACES, mat_cb, np.array([0.004, 0.002]), np.zeros((6, 3)))
    readings = block.model(values).predict(9.8 * direction)

    def aligned(at: Array) -> CaseAlignment:
        force, jacobian = block.model(at).apply(readings), block.jacobian(at)
        change = np.einsum("pkm,ik->ipm", jacobian[:, :3], force) + jacobian[:, 3]
        by_parameters = vertical_by_parameters(block.model(at), force, change)
        return align_case(unit_vector(force), by_parameters, normals)

    base = aligned(values)
    numerical = np.array([(error(aligned(values + h), base.alignment.mat_cb)) / 1e-5 for h in 1e-5 * np.eye(9)]).T
    np.testing.assert_allclose(base.alignment.by_parameters, numerical, atol=2e-4)


# -------------------- sessions --------------------


def scenario(codes_or_name: tuple[str, ...] | str, *, table: float, seed: int) -> Scenario:
    """A navigation unit on a table or in a cube with errors of `table` degrees, mounted askew by up to 2°."""
    listed = programme(codes_or_name) if isinstance(codes_or_name, str) else from_attitudes(codes_or_name)
    typical = scenario_of(Setup.of(), np.random.default_rng(seed), serial="S")
    return typical.changed(programme=listed, table_error=table * DEGREE, mounting_error=2.0 * DEGREE)


def observed(described: Scenario, seed: int) -> tuple[Observations, Array]:
    """Observations of a scenario, and the true mounting body → case."""
    seen = simulate_observations(described, np.random.default_rng(seed))
    way = itinerary(described, np.random.default_rng(seed).spawn(3)[0])
    geometry = np.random.default_rng(seed).spawn(3)[0]
    count = len(described.setup.programme.positions)
    if not described.setup.programme.ordered:
        geometry.permutation(count)
        geometry.uniform(-np.pi, np.pi, (count, 1))
    mounting = rotation_matrix(described.setup.mounting_error * geometry.uniform(-1.0, 1.0, 3))
    if described.setup.table_error < 1e-9:
        np.testing.assert_allclose((way.attitudes @ mounting.T)[:, 1, :], _nominal(described, way.positions), atol=1e-7)
    return seen, mounting


def _nominal(described: Scenario, positions: tuple[int, ...]) -> Array:
    return np.array([described.setup.programme.positions[k].vertical_b for k in positions])


@pytest.mark.parametrize("name", [name for name in BUILT_IN if name != "cube-12"])
def test_the_case_of_a_session_is_found_within_its_uncertainty(name: str) -> None:
    """Table errors of 0.2°, ten sessions: both blocks in the case, mounting included; edges alone show no case."""
    ratios = []
    for seed in range(10):
        described = scenario(name, table=0.2, seed=seed)
        seen, mounting = observed(described, seed)
        estimate, case = estimate_in("case", staged(seen), seen)
        assert case is not None
        psi = error(case, mounting)
        ratios.append(psi @ np.linalg.solve(case.alignment.covariance, psi) / 3.0)
        truth = np.array([described.truth[n] for n in described.accel.names])
        true_matrix = described.accel.model(truth).matrix @ mounting.T
        assert np.abs(estimate.accel.matrix - true_matrix).max() < 0.3 * DEGREE
    assert np.median(ratios) < 4.0
    assert max(ratios) < 40.0


def test_the_command_gives_the_case_and_says_how_it_was_found(tmp_path: Path) -> None:
    request = Setup.of(programme="cube-14", rest=8.0, rate_deg_s=40.0, sample_rate=50.0, table_error_deg=0.1)
    folder = simulate_session(tmp_path / "cube", request, seed=31)
    result = CliRunner().invoke(main, ["calibrate", str(folder), "--terms", "linear", "--frame", "case", "--all"])
    assert result.exit_code == 0, result.output
    assert "case: from 6 rests on its six faces" in result.output.replace("\n", " ")
    found_case = read_calibration(folder / "calibration.json")
    assert found_case.frame == "case"
    assert [p.name for p in found_case.parameters][6:12] == [
        f"accel.axis.{pair}" for pair in ("xy", "xz", "yx", "yz", "zx", "zy")
    ]
    plain = calibrate(folder, terms="linear")
    for axis in "xyz":
        assert found_case[f"accel.bias.{axis}"].value == plain[f"accel.bias.{axis}"].value
    u = found_case["accel.axis.xy"].u
    assert u is not None
    assert 0.01 * DEGREE < u < 0.2 * DEGREE


# -------------------- refusals --------------------


def test_sessions_that_do_not_give_the_case_are_refused_in_one_line(tmp_path: Path) -> None:
    words: dict[str, Any] = {"rest": 5.0, "rate_deg_s": 60.0, "sample_rate": 50.0}
    folders = {
        "none was given": simulate_session(tmp_path / "hand", Setup.of(**words, positions=20), seed=32),
        "X up, X down, Y up, Y down, Z up, Z down": simulate_session(
            tmp_path / "edges", Setup.of(**words, programme="cube-12"), seed=33
        ),
    }
    for said, folder in folders.items():
        result = CliRunner().invoke(main, ["calibrate", str(folder), "--terms", "linear", "--frame", "case", "--all"])
        assert result.exit_code == 2, result.output
        assert result.output.count("\n") == 1
        assert "frame 'case': expected a " in result.output
        assert (said if said != "none was given" else "[programme]") in result.output
        assert not (folder / "calibration.json").exists()


def test_placements_that_give_no_rotation_are_refused() -> None:
    with pytest.raises(InputError, match="three directions"):
        align_case(*exact(np.eye(3)[:2]), np.eye(3)[:2])
