"""Redundant blocks: four sensors of a kind on a pyramid, and six with axes normal to the faces of a dodecahedron.

By the staged method, from observations made directly and through the whole pipeline; and by the functions of the
sequential vector method, axis by axis and pair by pair. Statistical limits are at least five standard errors wide.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from accuracy_formulas import angle_variance, best_elevations

from tests.methods.test_staged import (
    COARSE,
    FINE,
    NAVIGATION,
    PYRAMID,
    error_of,
    in_the_hand,
    observations,
    rough_table,
    unit,
)
from tests.support.paper_variants import angle_astride
from tests.support.staged import staged
from tumble.earth import earth_rate
from tumble.methods.paper.accelerometers import angle_between, bias_and_scale
from tumble.methods.paper.gyros import triad
from tumble.planning.setup import Setup
from tumble.rotation import rotation_matrix, unit_vector
from tumble.run.calibrate import calibrate
from tumble.sensors.grades import GRADES
from tumble.sensors.model import Block
from tumble.simulation.scenario import draw_parameters, scenario_of
from tumble.simulation.session import write_simulation
from tumble.units import ARCSEC, DEGREE, DEGREE_PER_HOUR, Array

GOLDEN = 0.5 * (1.0 + 5.0**0.5)
DODECAHEDRON = np.array(
    [
        [1.0, GOLDEN, 0.0],
        [-1.0, GOLDEN, 0.0],
        [0.0, 1.0, GOLDEN],
        [0.0, -1.0, GOLDEN],
        [GOLDEN, 0.0, 1.0],
        [GOLDEN, 0.0, -1.0],
    ]
) / np.hypot(1.0, GOLDEN)
BLOCKS = pytest.mark.parametrize("axes", [PYRAMID, DODECAHEDRON], ids=["four", "six"])
g = 9.8159


def test_the_axes_are_those_of_a_dodecahedron() -> None:
    """Any two of its faces that are not parallel have normals with the cosine ±1/√5; together they see all directions
    alike."""
    cosines = DODECAHEDRON @ DODECAHEDRON.T
    np.testing.assert_allclose(np.abs(cosines[~np.eye(6, dtype=bool)]), 5.0**-0.5, atol=1e-15)
    np.testing.assert_allclose(DODECAHEDRON.T @ DODECAHEDRON, 2.0 * np.eye(3), atol=1e-15)


# -------------------- staged --------------------


@pytest.mark.parametrize("sizes", [FINE, COARSE], ids=["fine", "coarse"])
def test_six_noiseless_accelerometers_and_gyros_are_recovered(sizes: tuple[float, ...]) -> None:
    """6 + 6 + 9 and 6 + 6 + 12 parameters."""
    rng = np.random.default_rng(101)
    for way in (rough_table(rng), in_the_hand(rng, 15)):
        device = unit(rng, sizes, DODECAHEDRON, DODECAHEDRON)
        estimate = staged(observations(device, way, rng))
        assert len(estimate.values) == 21 + 24
        assert estimate.converged
        assert estimate.unobservable == ()
        np.testing.assert_allclose(estimate.values, device.truth, rtol=0.0, atol=1e-9)


def test_six_accelerometers_go_with_four_gyros() -> None:
    rng = np.random.default_rng(102)
    device = unit(rng, COARSE, DODECAHEDRON, PYRAMID)
    estimate = staged(observations(device, in_the_hand(rng, 15), rng))
    np.testing.assert_allclose(estimate.values, device.truth, rtol=0.0, atol=1e-9)


def test_normalised_errors_of_six_have_unit_rms(monkeypatch: pytest.MonkeyPatch) -> None:
    """20 sessions with noise of navigation grade, no scatter looked for: rms of (value − truth)/u of biases, scale
    factors and angles of either kind, each group taken for as informative as three independent errors a session, and
    the distance of all 45 errors in units of their covariance."""
    monkeypatch.setattr("tumble.methods.least_squares.SCATTER_PROBABILITY", 0.0)
    rng = np.random.default_rng(103)
    normalised, distance = [], []
    for _ in range(20):
        device = unit(rng, FINE, DODECAHEDRON, DODECAHEDRON)
        estimate = staged(observations(device, rough_table(rng), rng, NAVIGATION))
        error = error_of(estimate, device)
        normalised.append(error / estimate.u)
        distance.append(error @ np.linalg.solve(estimate.covariance, error))
    for group in np.split(np.array(normalised), np.cumsum([6, 6, 9, 6, 6]), axis=1):
        assert np.sqrt((group**2).mean()) == pytest.approx(1.0, abs=5.5 / np.sqrt(2.0 * 20 * 3))
    assert np.mean(distance) == pytest.approx(45.0, abs=5.5 * np.sqrt(2.0 * 45 / 20))


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
    found = calibrate(write_simulation(tmp_path / "session", scenario, rng), terms="linear")
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


# -------------------- axis by axis and pair by pair --------------------


@dataclass(frozen=True, kw_only=True, slots=True)
class Directions:
    """Verticals (2 n + P, 3) in the body for a block: every axis up and down, then every pair of axes where the
    variance of the angle between them is least."""

    axes: Array
    nominal: Array

    @staticmethod
    def of(axes: Array) -> Directions:
        standing = [sign * axis for axis in axes for sign in (1.0, -1.0)]
        oblique = []
        for p, q in combinations(range(len(axes)), 2):
            φ = float(np.arccos(axes[p] @ axes[q]))
            along = unit_vector(axes[q] - np.cos(φ) * axes[p])
            α, _ = best_elevations(φ)
            oblique.append(np.cos(α) * axes[p] - np.sin(α) * along)
        return Directions(axes=axes, nominal=np.array(standing + oblique))

    def tilted(self, rng: np.random.Generator) -> Array:
        """As a rough table has them: off by up to 1° about each axis."""
        off = rotation_matrix(DEGREE * rng.uniform(-1.0, 1.0, (len(self.nominal), 3)))
        return np.asarray(np.einsum("nij,nj->ni", off, self.nominal))


@dataclass(frozen=True, kw_only=True, slots=True)
class Sequential:
    """What the functions of the vector method find: biases and scale factors (n,), angles between axes (P,), and the
    values of all parameters that follow from them."""

    bias: Array
    scale: Array
    between: Array
    values: Array


def one_pass(block: Block, readings: Array, values: Array) -> Sequential:
    """Stage 1 for every axis, stage 2 for every pair, levelled with the model of the pass before."""
    n, model = block.size, block.model(values)
    u = unit_vector(model.apply(readings))
    sensing = unit_vector(model.matrix)
    found = []
    for p in range(n):
        standing = [2 * p, 2 * p + 1]
        found.append(bias_and_scale(readings[standing, p], u[standing] @ sensing[p], g))
    bias, scale = (np.array(each) for each in zip(*found, strict=True))
    w, between = (readings - bias) / (1.0 + scale), []
    for rest, (p, q) in enumerate(combinations(range(n), 2), start=2 * n):
        across = g * u[rest] @ unit_vector(np.cross(sensing[p], sensing[q]))
        angle = angle_between if block.axes[p] @ block.axes[q] >= 0.0 else angle_astride
        between.append(angle(w[rest, p], w[rest, q], across, g))
    angles = angles_of(block, np.array(between), values[2 * n :])
    return Sequential(bias=bias, scale=scale, between=np.array(between), values=np.concatenate([bias, scale, angles]))


def angles_of(block: Block, between: Array, start: Array) -> Array:
    """The 2 n − 3 axis angles that agree best with the angles between the axes, Eq. (2) for a redundant block: by Gauss
    and Newton, in the cosines."""
    pairs = np.array(list(combinations(range(block.size), 2)))
    first, second = pairs.T
    values = np.concatenate([np.zeros(2 * block.size), start])
    for _ in range(4):
        axes, derivative = block.model(values).matrix, block.jacobian(values)[:, :3, 2 * block.size :]
        rows = np.einsum("rqm,rq->rm", derivative[first], axes[second])
        rows += np.einsum("rqm,rq->rm", derivative[second], axes[first])
        residual = np.cos(between) - (axes[first] * axes[second]).sum(axis=1)
        values[2 * block.size :] += np.linalg.lstsq(rows, residual)[0]
    return np.asarray(values[2 * block.size :])


def between_axes(axes: Array) -> Array:
    """Angles (P,) between all pairs of axes."""
    return np.array([np.arccos(axes[p] @ axes[q]) for p, q in combinations(range(len(axes)), 2)])


def drawn(block: Block, rng: np.random.Generator) -> Array:
    n = block.size
    return np.asarray(np.repeat([2e-3, 1e-4, 25 * ARCSEC], [n, n, 2 * n - 3]) * rng.standard_normal(4 * n - 3))


@BLOCKS
def test_noiseless_accelerometers_are_recovered_axis_by_axis_and_pair_by_pair(axes: Array) -> None:
    """One pass errs by parts of the parameters, as the paper has it; every further one by less, down to nothing."""
    block, rng = Block(kind="accel", axes=axes), np.random.default_rng(105)
    truth = drawn(block, rng)
    readings = block.model(truth).predict(g * Directions.of(axes).tilted(rng))
    values, errors = np.zeros_like(truth), []
    for _ in range(8):
        values = one_pass(block, readings, values).values
        errors.append(float(np.abs((values - truth)[: 2 * len(axes)]).max()))
    assert 1e-7 < errors[0] < 0.1 * 2e-3
    assert errors[1] < 0.1 * errors[0]
    np.testing.assert_allclose(values, truth, rtol=0.0, atol=1e-11)


@BLOCKS
def test_errors_axis_by_axis_and_pair_by_pair_are_those_of_their_formulas(axes: Array) -> None:
    """20 launches with noise: rms of error/u of biases and scale factors, u = σ/√2 for axes up and down, and of the
    angles between axes, by Eq. (9) with the noise of their own rest."""
    block, rng, σ = Block(kind="accel", axes=axes), np.random.default_rng(106), 1.3e-5
    n, directions = len(axes), Directions.of(axes)
    nominal = np.array([best_elevations(φ) for φ in between_axes(axes)])
    own = (σ / g) ** 2 * (np.sin(nominal) ** -2.0).sum(axis=1)
    u_between = np.sqrt(angle_variance(nominal[:, 0], nominal[:, 1], 0.5 * (σ / g) ** 2, 0.5 * (σ / g) ** 2) + own)
    z: dict[str, list[Array]] = {"bias": [], "scale": [], "between": []}
    for _ in range(20):
        truth = drawn(block, rng)
        model = block.model(truth)
        readings = model.predict(g * directions.tilted(rng))
        readings += σ * rng.standard_normal(readings.shape)
        found = one_pass(block, readings, np.zeros_like(truth))
        for _ in range(2):
            found = one_pass(block, readings, found.values)
        z["bias"].append((found.bias - truth[:n]) / (σ / np.sqrt(2.0)))
        z["scale"].append((found.scale - truth[n : 2 * n]) / (σ / g / np.sqrt(2.0)))
        z["between"].append((found.between - between_axes(unit_vector(model.matrix))) / u_between)
    for values in z.values():
        assert np.sqrt(np.mean(np.square(values))) == pytest.approx(1.0, abs=5.5 / np.sqrt(2.0 * 20 * n / 2))


@BLOCKS
def test_gyro_biases_of_a_redundant_block_are_found_axis_by_axis(axes: Array) -> None:
    """Where an axis is vertical its gyro reads its bias and the Earth's rate along it as TRIAD sees it, Eq. (18): to
    3 % of the biases at tilts of up to 1°."""
    block, rng = Block(kind="gyro", axes=axes), np.random.default_rng(107)
    Ω, n = np.array(earth_rate(56.84 * DEGREE)), len(axes)
    bias = 0.3 * DEGREE_PER_HOUR * rng.standard_normal(n)
    model = block.model(np.concatenate([bias, np.zeros(3 * n)]))
    u = Directions.of(axes).tilted(rng)[: 2 * n]
    north = unit_vector(np.cross(u, rng.standard_normal(u.shape)))
    attitude = np.stack([north, u, np.cross(north, u)], axis=1)
    readings = model.predict(np.einsum("nij,i->nj", attitude, Ω))
    levelled = triad(g * u, block.nominal().apply(readings))
    shown = readings - np.einsum("nij,i->nj", levelled, Ω) @ axes.T
    found = np.array([shown[[2 * p, 2 * p + 1], p].mean() for p in range(n)])
    assert np.abs(found - bias).max() < 0.03 * 0.3 * DEGREE_PER_HOUR
