"""The sensor model: parameters to matrix and back, analytic derivatives, the frame of the accelerometers."""

from __future__ import annotations

import numpy as np
import pytest

from tumble.rotation import axes_angles, axes_matrix, rotation_matrix
from tumble.sensors.model import Block, SensorModel, to_accelerometer_frame

TRIAD = np.eye(3)
PERMUTED = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
TETRAD = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1 / 3**0.5] * 3])
SKEWED = np.array([[0.8, 0.6, 0.0], [0.0, 0.8, 0.6], [0.6, 0.0, 0.8]])
BLOCKS = [Block(kind=kind, axes=axes) for kind in ("accel", "gyro") for axes in (TRIAD, PERMUTED, TETRAD, SKEWED)]


def values(block: Block, seed: int = 0) -> np.ndarray:
    return 1e-2 * np.random.default_rng(seed).normal(size=len(block.names))


@pytest.mark.parametrize("block", BLOCKS, ids=lambda b: f"{b.kind}{b.size}")
def test_parameters_of_the_model_of_parameters_are_the_same(block: Block) -> None:
    theta = values(block)
    np.testing.assert_allclose(block.parameters(block.model(theta)), theta, atol=1e-14)


@pytest.mark.parametrize("block", BLOCKS, ids=lambda b: f"{b.kind}{b.size}")
def test_jacobian_agrees_with_finite_differences(block: Block) -> None:
    theta, step = values(block), 1e-6
    analytic = block.jacobian(theta)
    for i in range(len(theta)):
        e = step * np.eye(len(theta))[i]
        high, low = block.model(theta + e), block.model(theta - e)
        np.testing.assert_allclose(analytic[:, :3, i], (high.matrix - low.matrix) / (2 * step), atol=1e-9)
        np.testing.assert_allclose(analytic[:, 3, i], (high.bias - low.bias) / (2 * step), atol=1e-9)


def test_contract_names_of_a_triad() -> None:
    accel = Block(kind="accel", axes=TRIAD).names
    gyro = Block(kind="gyro", axes=TRIAD).names
    assert accel[6:] == ("accel.axis.yx", "accel.axis.zx", "accel.axis.zy")
    assert gyro[:4] == ("gyro.bias.x", "gyro.bias.y", "gyro.bias.z", "gyro.scale.x")
    assert len(accel) + len(gyro) == 21


def test_a_block_of_n_has_2n_minus_3_accelerometer_angles_and_2n_gyro_angles() -> None:
    assert len(Block(kind="accel", axes=TETRAD).names) == 4 * 4 - 3
    assert len(Block(kind="gyro", axes=TETRAD).names) == 4 * 4


def test_axes_matrix_has_unit_rows_and_inverts() -> None:
    six = 0.05 * np.random.default_rng(1).normal(size=6)
    axes = axes_matrix(*six)
    np.testing.assert_allclose(np.linalg.norm(axes, axis=1), 1.0, rtol=1e-15)
    np.testing.assert_allclose(axes_angles(axes), six, atol=1e-15)


@pytest.mark.parametrize("axes", [TRIAD, PERMUTED, TETRAD, SKEWED], ids=["triad", "permuted", "tetrad", "skewed"])
def test_the_accelerometer_frame_has_no_free_rotation_left(axes: np.ndarray) -> None:
    block, gyro = Block(kind="accel", axes=axes), Block(kind="gyro", axes=axes)
    truth, gyro_truth = block.model(values(block, 3)), gyro.model(values(gyro, 4))
    turn = rotation_matrix(np.array([0.3, -0.2, 0.5]))
    turned = SensorModel(matrix=truth.matrix @ turn, bias=truth.bias)
    gyro_turned = SensorModel(matrix=gyro_truth.matrix @ turn, bias=gyro_truth.bias)
    back, gyro_back = to_accelerometer_frame(block, turned, gyro_turned)
    np.testing.assert_allclose(back.matrix, truth.matrix, atol=1e-14)
    assert gyro_back is not None
    np.testing.assert_allclose(gyro_back.matrix, gyro_truth.matrix, atol=1e-14)


def test_apply_inverts_predict() -> None:
    for block in BLOCKS:
        model = block.model(values(block))
        true = np.random.default_rng(2).normal(size=(5, 3))
        np.testing.assert_allclose(model.apply(model.predict(true)), true, atol=1e-13)
