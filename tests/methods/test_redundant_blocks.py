"""Redundant blocks: four sensors of a kind on a pyramid, and six with axes normal to the faces of a dodecahedron.

By the methods joint and sequential, from observations made directly and through the whole pipeline. Statistical limits
are at least five standard errors wide.
"""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.support.direct import DODECAHEDRON, PYRAMID, QUIET, SETUP, error_of, in_the_hand, observed, scenario
from tests.support.linear_instrument import stated_linear
from tumble.errors import ProgrammeError
from tumble.inference.joint import joint
from tumble.methods.paper.accelerometers import check_for_vector, every_pair, oblique, verticals
from tumble.methods.paper.four_stages import sequential
from tumble.planning.setup import Setup, with_all_groups
from tumble.programme.positions import code_of_vertical, from_attitudes, programme
from tumble.rotation import rotation_matrix, unit_vector
from tumble.run.calibrate import calibrate
from tumble.sensors.grades import GRADES
from tumble.sensors.instrument import Instrument
from tumble.sensors.model import Block
from tumble.sensors.parameters import group_name
from tumble.simulation.scenario import Scenario, draw_parameters, scenario_of
from tumble.simulation.session import write_simulation
from tumble.units import Array

BLOCKS = pytest.mark.parametrize("axes", [PYRAMID, DODECAHEDRON], ids=["four", "six"])
g = 9.8159


def test_the_axes_are_those_of_a_dodecahedron() -> None:
    """Any two of its faces that are not parallel have normals with the cosine ±1/√5; together they see all directions
    alike."""
    cosines = DODECAHEDRON @ DODECAHEDRON.T
    np.testing.assert_allclose(np.abs(cosines[~np.eye(6, dtype=bool)]), 5.0**-0.5, atol=1e-15)
    np.testing.assert_allclose(DODECAHEDRON.T @ DODECAHEDRON, 2.0 * np.eye(3), atol=1e-15)


@pytest.mark.parametrize("gyro_axes", [DODECAHEDRON, PYRAMID], ids=["six gyros", "four gyros"])
def test_six_noiseless_accelerometers_and_gyros_are_recovered(gyro_axes: Array) -> None:
    """6 + 6 + 9 and 6 + 6 + 12 parameters, or those of four gyros."""
    table = scenario(QUIET, 101, DODECAHEDRON, gyro_axes)
    for chosen in (table, in_the_hand(table, 15)):
        found = joint(observed(chosen, 101))
        assert len(found.values) == len(chosen.truth)
        assert found.unobservable == ()
        np.testing.assert_allclose(error_of(found, chosen), 0.0, atol=1e-9)


@pytest.mark.weekly
def test_normalised_errors_of_six_have_unit_rms() -> None:
    """20 sessions of §8: rms of (value − truth)/u of biases, scale factors and angles of either kind, each group taken
    for as informative as three independent errors a session."""
    normalised = []
    for seed in range(20):
        chosen = scenario(SETUP, seed, DODECAHEDRON)
        found = joint(observed(chosen, seed))
        normalised.append(error_of(found, chosen) / found.u)
    for group in np.split(np.array(normalised), np.cumsum([6, 6, 9, 6, 6]), axis=1):
        assert np.sqrt((group**2).mean()) == pytest.approx(1.0, abs=5.5 / np.sqrt(2.0 * 20 * 3))


@BLOCKS
def test_a_session_with_redundant_blocks_is_calibrated(axes: Array, tmp_path: Path) -> None:
    """From the log to the file, noise and instability of tactical grade: sensors by number, every value near its truth,
    and readings that become the specific force again."""
    request = Setup.of(grade="tactical", rest=10.0, rate_deg_s=30.0, sample_rate=50.0)
    rng = np.random.default_rng(104)
    accel, gyro = Block(kind="accel", axes=axes), Block(kind="gyro", axes=axes)
    scenario = replace(
        scenario_of(request, rng, serial="redundant"),
        accel=accel,
        gyro=gyro,
        truth=draw_parameters(GRADES["tactical"], (accel, gyro), rng),
    )
    found = calibrate(stated_linear(write_simulation(tmp_path / "session", scenario, rng)), terms="linear")
    assert found.outcome.accepted, found.outcome.reasons
    assert [p.name for p in found.parameters] == [*accel.names, *gyro.names]
    truth = json.loads((tmp_path / "session" / "truth.json").read_text())
    z = np.array([(p.value - truth[p.name]) / p.u for p in found.parameters if p.u])
    assert len(z) == len(truth)
    assert np.abs(z).max() < 5.5
    assert 0.5 < np.sqrt((z**2).mean()) < 1.5
    assert found.accel is not None
    up = unit_vector(rng.standard_normal((100, 3)))
    read = accel.model(np.array([truth[name] for name in accel.names])).predict(g * up)
    np.testing.assert_allclose(found.accel.apply(read), g * up, atol=5e-4)


# The sequential method


def table_setup(axes: Array, setup: Setup) -> Setup:
    """A set-up with the paper's programme for accelerometers along axes."""
    listed = verticals(Block(kind="accel", axes=axes)).values()
    return replace(setup, programme=from_attitudes([code_of_vertical(vertical) for vertical in listed]))


def test_the_programme_of_redundant_accelerometers_has_the_fewest_positions() -> None:
    """Every axis up and down, and as many pairs as there are axis angles, 2n − 3, two of which may be in one position:
    of a triad nine positions, those of the paper."""
    assert [len(table_setup(axes, QUIET).programme.positions) for axes in (PYRAMID, DODECAHEDRON)] == [11, 21]
    ours = np.array(list(verticals(Block(kind="accel", axes=np.eye(3))).values()))
    papers = np.array([position.vertical_b for position in programme("nine").positions])
    assert np.abs(ours @ papers.T).max(axis=0) == pytest.approx(np.ones(9))


@BLOCKS
def test_pairs_are_inclined_as_equation_9_wants(axes: Array) -> None:
    """Of all inclinations in the vertical plane, the variance (9) of the angle is least where the axes are symmetric
    about the horizon, for an angle of at most 90°, or about the vertical."""
    block = Block(kind="accel", axes=axes)
    for vertical in list(verticals(block).values())[2 * len(axes) :]:
        pairs = [pair for pair in every_pair(axes) if oblique(vertical[None], axes, pair)[0].any()]
        for p, q in pairs:
            normal = np.cross(axes[p], axes[q]) / np.linalg.norm(np.cross(axes[p], axes[q]))
            near = rotation_matrix(np.radians([-20.0, -5.0, 0.0, 5.0, 20.0])[:, None] * normal) @ vertical
            for scale, bias in ((1.0, 0.0), (0.0, 1.0), (1.0, 1.0)):
                cosine = near @ axes[[p, q]].T
                assert np.argmin(((scale * cosine**2 + bias) / (1.0 - cosine**2)).sum(axis=1)) == 2


@BLOCKS
def test_noiseless_redundant_sensors_are_recovered_pass_by_pass(axes: Array) -> None:
    """On a table of ±1°: the paper has 1.7–3.5 % for biases and scale factors after the first pass and less than 1 %
    after the second, whatever the directions of the axes, and 10 % for angles."""
    relative, n = list[Array](), len(axes)
    for seed in range(4):
        chosen = scenario(table_setup(axes, QUIET), seed, axes)
        found = sequential(observed(chosen, seed), 8)
        left = error_of(found, chosen) - found.values + np.cumsum(found.increments, axis=0)
        relative.append(left / sizes_of(chosen))
    bias_and_scale, angles = np.split(np.sqrt(np.square(relative).mean(axis=0))[:, : 4 * n - 3], [2 * n], axis=1)
    assert 0.005 < np.sqrt(np.mean(bias_and_scale[0] ** 2)) < 0.035
    assert np.sqrt(np.mean(angles[0] ** 2)) < 0.1
    assert max(bias_and_scale[1].max(), angles[1].max()) < 0.01
    assert np.abs(relative)[:, -1].max() < 1e-8


def sizes_of(chosen: Scenario) -> Array:
    """Standard deviations of the parameters of a scenario."""
    return np.array([getattr(getattr(SETUP, kind), what) for kind, what, *_ in (n.split(".") for n in chosen.truth)])


@BLOCKS
def test_redundant_sensors_are_within_their_uncertainty(axes: Array) -> None:
    """Eight sessions of §8, three passes: the squares of error/u have the mean 1, to five standard errors, a session
    taken for ten independent parameters; none is beyond 4.5."""
    normalised = list[Array]()
    for seed in range(8):
        chosen = scenario(table_setup(axes, SETUP), seed, axes)
        found = sequential(observed(chosen, seed), 3)
        normalised.append(error_of(found, chosen) / found.u)
    assert np.mean(np.square(normalised)) == pytest.approx(1.0, abs=5.0 * np.sqrt(2.0 / 80.0))
    assert np.abs(normalised).max() < 4.5


def test_groups_that_redundant_blocks_may_have_are_in_the_uncertainty() -> None:
    """Five sessions of a navigation instrument with quadratic terms, g-sensitivities and the like of usual size."""
    setup, normalised = table_setup(PYRAMID, with_all_groups(Setup.of(grade="navigation", rest=120.0))), list[Array]()
    accel, gyro = Block(kind="accel", axes=PYRAMID), Block(kind="gyro", axes=PYRAMID)
    for seed in range(5):
        rng = np.random.default_rng([seed, 3])
        instrument = Instrument.of(accel, gyro, tuple(setup.further))
        size = dict(setup.further) | {f"{kind}.{what}": getattr(getattr(setup, kind), what)
                                      for kind in ("accel", "gyro") for what in ("bias", "scale", "axis")}  # fmt: skip
        truth = {name: size[group_name(name)] * rng.standard_normal() for name in instrument.names}
        chosen = replace(scenario_of(setup, rng), accel=accel, gyro=gyro, truth=truth)
        found, linear = sequential(observed(chosen, seed), 3), instrument.linear_count
        normalised.append(error_of(found, chosen)[:linear] / found.u[:linear])
    assert 0.4 < np.sqrt(np.mean(np.square(normalised))) < 1.2
    assert np.abs(normalised).max() < 4.0


def test_a_log_of_a_redundant_block_is_calibrated_by_the_sequential_method(tmp_path: Path) -> None:
    rng = np.random.default_rng(105)
    setup = table_setup(PYRAMID, Setup.of(grade="navigation", rest=30.0, rate_deg_s=30.0, sample_rate=50.0))
    block, gyro = Block(kind="accel", axes=PYRAMID), Block(kind="gyro", axes=PYRAMID)
    chosen = replace(
        scenario_of(setup, rng, serial="four"),
        accel=block,
        gyro=gyro,
        truth=draw_parameters(GRADES["navigation"], (block, gyro), rng),
    )
    found = calibrate(write_simulation(tmp_path / "session", chosen, rng), method="sequential")
    assert found.outcome.accepted, found.outcome.reasons
    truth = json.loads((tmp_path / "session" / "truth.json").read_text())
    z = np.array([(p.value - truth[p.name]) / p.u for p in found.parameters if p.name in truth and p.u])
    assert len(z) == 29
    assert np.abs(z).max() < 5.0
    assert len(found.evidence.iterations) == 2


def test_positions_that_are_missing_are_listed_as_the_programme_wants_them() -> None:
    chosen = scenario(table_setup(PYRAMID, QUIET), 1, PYRAMID)
    seen = replace(observed(chosen, 1), gyro_block=None, turns=None, turn_readings=None)
    assert seen.position is not None
    with pytest.raises(ProgrammeError, match=r"3 down; accelerometer 0 .* above and accelerometer") as refusal:
        sequential(replace(seen, position=np.where(seen.position == 7, 0, seen.position) % 8))
    codes = re.findall('"(NUE[^"]*)"', str(refusal.value))
    check_for_vector(np.array([p.vertical_b for p in from_attitudes(codes).positions]), chosen.accel)
