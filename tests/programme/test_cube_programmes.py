"""Cubes: faces, edges and corners are recognised in any order and azimuth, and what is wrong is named."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from tumble.cli import main
from tumble.errors import ProgrammeError
from tumble.planning.setup import Setup
from tumble.programme.positions import ANY_MOVE, BUILT_IN, Position, Programme, programme
from tumble.recording.log import open_log
from tumble.recording.session import ProgrammeSpec, Session
from tumble.recording.session_file import read_session
from tumble.reduction.blocks.reducer import reduce_log
from tumble.reduction.rests.matching import match_rests
from tumble.reduction.rests.segmentation import Segmentation, find_rests
from tumble.result.calibration import read_calibration
from tumble.rotation import rotation_matrix
from tumble.simulation.scenario import scenario_of
from tumble.simulation.session import simulate_session, write_simulation
from tumble.units import DEGREE

CUBES = tuple(name for name in BUILT_IN if name.startswith(("cube", "faces")))


U = np.array([0.0, 1.0, 0.0])


def standing(name: str, order: Sequence[int], rng: np.random.Generator, extra: Sequence[Position] = ()) -> Programme:
    """Positions of a cube in this order, each in any azimuth, then others."""
    listed = [programme(name).positions[k] for k in order]
    turned = [replace(p, matrix=rotation_matrix(rng.uniform(-np.pi, np.pi) * U) @ p.matrix) for p in (*listed, *extra)]
    return Programme(name="shuffled", positions=tuple(turned), moves=(ANY_MOVE,) * (len(turned) - 1), ordered=True)


def recorded(
    folder: Path, course: Programme, rng: np.random.Generator, *, grade: str = "mems", error: float = 2.0
) -> Path:
    """A short session of a course with errors of up to `error` degrees about every axis, of mounting and positions."""
    scenario = scenario_of(Setup.of(grade=grade), rng, serial="cube")
    scenario = scenario.changed(
        programme=course,
        table_error=error * DEGREE,
        mounting_error=error * DEGREE,
        first_rest=5.0,
        rest=5.0,
        turn_rate=60.0 * DEGREE,
        ramp=0.5,
        sample_rate=20.0,
    )
    return write_simulation(folder, scenario, rng)


def matched(folder: Path, name: str, *, gyros: bool = True) -> Segmentation:
    """The rests of a session matched to a built-in programme, whatever its session.toml says."""
    found = read_session(folder)
    session: Session = replace(found, programme=ProgrammeSpec(name=name))
    if not gyros:
        session = replace(session, log=replace(session.log, gyro=None))
    log = open_log(session)
    reduction = reduce_log(log, session.accel_block, session.gyro_block, log.chunks())
    return match_rests(session, reduction, find_rests(reduction, session.accel_block, session.gyro_block))


def refused(folder: Path, name: str) -> str:
    with pytest.raises(ProgrammeError) as caught:
        matched(folder, name)
    message = str(caught.value)
    assert "\n" not in message
    assert message.startswith(f"programme {name}: ")
    return message


def said(name: str, k: int) -> str:
    listed = programme(name).positions
    return f"position {k + 1} of {len(listed)} ({listed[k].attitude!r}, {listed[k].label})"


# -------------------- what fits --------------------


@pytest.mark.parametrize("gyros", [True, False], ids=["gyros", "accelerometers"])
@pytest.mark.parametrize("grade", ["navigation", "consumer"])
@pytest.mark.parametrize("name", CUBES)
def test_every_position_is_recognised_in_any_order_and_azimuth(
    name: str, grade: str, gyros: bool, tmp_path: Path
) -> None:
    """Positions and mounting askew by up to 2° about every axis each, accelerometers off by up to 0.3 m/s²."""
    rng = np.random.default_rng([len(name), len(grade), gyros])
    order = rng.permutation(len(programme(name).positions)).tolist()
    match = matched(recorded(tmp_path, standing(name, order, rng), rng, grade=grade), name, gyros=gyros)
    assert match.position is not None
    np.testing.assert_array_equal(match.position, order)


def test_a_block_turned_on_its_face_stays_in_one_position(tmp_path: Path) -> None:
    """Two rests in a row on each face, turned by 180° between: what cancels the tilt of the plate."""
    rng = np.random.default_rng(3)
    order = [k for face in range(6) for k in (face, face)] + list(range(6, 14))
    course = standing("cube-14", order, rng)
    positions = list(course.positions)
    for first in range(0, 12, 2):
        turned = rotation_matrix(np.pi * U) @ positions[first].matrix
        positions[first + 1] = replace(positions[first + 1], matrix=turned)
    folder = recorded(tmp_path, replace(course, positions=tuple(positions)), rng)
    match = matched(folder, "cube-14")
    assert match.position is not None
    np.testing.assert_array_equal(match.position, order)


@pytest.mark.parametrize("name", CUBES)
def test_a_simulated_cube_is_calibrated(name: str, tmp_path: Path) -> None:
    """The command draws order and azimuths at random, and another launch draws them anew."""
    orders = []
    for launch in (1, 2):
        request = Setup.of(programme=name, rest=5.0, rate_deg_s=60.0, sample_rate=20.0)
        folder = simulate_session(tmp_path / str(launch), request, seed=4, launch=launch)
        match = matched(folder, name)
        assert match.position is not None
        assert sorted(match.position.tolist()) == list(range(len(programme(name).positions)))
        orders.append(match.position.tolist())
    assert orders[0] != orders[1]
    assert orders[0] != sorted(orders[0])
    result = CliRunner().invoke(main, ["calibrate", str(folder)])
    assert result.exit_code == 0, result.output
    assert read_calibration(folder / "calibration.json").outcome.accepted


# -------------------- what does not --------------------


@pytest.mark.parametrize("missing", [0, 5, 6, 13])
def test_a_missing_position_is_named(missing: int, tmp_path: Path) -> None:
    rng = np.random.default_rng([5, missing])
    order = [k for k in rng.permutation(14).tolist() if k != missing]
    message = refused(recorded(tmp_path, standing("cube-14", order, rng), rng), "cube-14")
    assert "expected 14 positions, each once, found 13" in message
    assert f"no rest for {said('cube-14', missing)}" in message


@pytest.mark.parametrize("doubled", [2, 9])
def test_a_doubled_position_is_named_with_its_times(doubled: int, tmp_path: Path) -> None:
    rng = np.random.default_rng([6, doubled])
    order = [k for k in range(14) if k != doubled]
    order = [*order[:3], doubled, *order[3:10], doubled, *order[10:]]
    message = refused(recorded(tmp_path, standing("cube-14", order, rng), rng), "cube-14")
    assert f"{said('cube-14', doubled)} was taken 2 times, at " in message
    assert "surplus" in message


def test_a_position_taken_for_another_is_named_with_the_missing_one(tmp_path: Path) -> None:
    rng = np.random.default_rng(7)
    order = [*range(13), 6]
    message = refused(recorded(tmp_path, standing("cube-14", order, rng), rng), "cube-14")
    assert f"no rest for {said('cube-14', 13)}" in message
    assert f"{said('cube-14', 6)} was taken 2 times" in message


def test_an_impossible_position_is_named_with_the_nearest(tmp_path: Path) -> None:
    """A corner that stands on a wedge, 15° off."""
    rng = np.random.default_rng(8)
    course = standing("cube-14", range(14), rng)
    off = rotation_matrix(15.0 * DEGREE * np.array([1.0, 0.0, 0.0])) @ course.positions[9].matrix
    positions = (*course.positions[:9], replace(course.positions[9], matrix=off), *course.positions[10:])
    message = refused(recorded(tmp_path, replace(course, positions=positions), rng, error=0.3), "cube-14")
    assert said("cube-14", 9) in message
    assert float(message.split("° off")[0].split(" ")[-1]) == pytest.approx(15.0, abs=1.5)
    assert "at most 7°" in message
