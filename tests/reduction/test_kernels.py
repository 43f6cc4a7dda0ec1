"""The compiled loops over samples against NumPy; those of noise are in test_noise.py and test_coloured_noise.py, those
of turns in test_moments.py, the elimination in tests/inference/test_likelihood.py, the correction in tests/use."""

from __future__ import annotations

import numpy as np
import pytest

from tumble.reduction import kernels
from tumble.units import Array

SIZE = 7


def blocks_of(values: Array, cuts: list[int]) -> tuple[Array, Array]:
    """Block sums and the state of the channels, of samples that come in pieces."""
    time, state = 0.01 * np.arange(float(len(values))), kernels.new_channel_state(values.shape[1])
    sums, filled, done = np.zeros(values.shape[1]), np.zeros(1, dtype=np.int64), []
    for part in np.split(np.arange(len(values)), cuts):
        out = np.zeros((len(part) // SIZE + 1, values.shape[1]))
        count = kernels.block_sums(
            np.asfortranarray(values[part]), time[part], np.full(len(part), 1.0 / SIZE), SIZE, sums, filled, state, out
        )
        done.append(out[:count])
    return np.concatenate(done), state


@pytest.mark.parametrize("cuts", [[], [1, 2, 60, 61, 150]])
def test_blocks_and_channels_are_those_of_numpy_however_samples_are_cut(cuts: list[int]) -> None:
    values = np.round(np.random.default_rng(4).standard_normal((203, 2)), 1)
    values[80:90, 1] = values[:, 1].max()
    means, state = blocks_of(values, cuts)
    np.testing.assert_allclose(means, values[:203].reshape(-1, SIZE, 2).mean(axis=1), atol=1e-14)
    np.testing.assert_array_equal(state[:, 0], 203)
    np.testing.assert_array_equal(state[:, 1:3], np.array([values.min(axis=0), values.max(axis=0)]).T)
    np.testing.assert_array_equal(state[:, 3], (np.diff(values, axis=0) == 0.0).sum(axis=0))
    steps = np.abs(np.diff(values, axis=0))
    np.testing.assert_array_equal(state[:, 13], [column[column > 0.0].min() for column in steps.T])
    assert state[1, 6] == 10
    assert state[1, 8] == values[80, 1]
    assert state[1, 7] == pytest.approx(0.89)


def test_a_lag_adds_what_is_kept_of_the_value_before() -> None:
    values = np.random.default_rng(5).standard_normal(50)
    found, expected = values.copy(), values.copy()
    kernels.follow(found, 0.3)
    for k in range(1, len(expected)):
        expected[k] = values[k] + 0.3 * expected[k - 1]
    np.testing.assert_array_equal(found, expected)
