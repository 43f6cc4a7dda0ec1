"""The probability of a lag: sums over a grid that follows the likelihood to where it is."""

from __future__ import annotations

import numpy as np
import pytest

from tumble.inference.lag import LAGS_ABOUT, resolved
from tumble.units import Array


@pytest.mark.parametrize(("centre", "spread"), [(-20.0, 190.0), (3.0, 15.0), (17.0, 2.0), (-41.0, 0.6)])
def test_mean_and_spread_of_a_lag_are_those_of_its_likelihood(centre: float, spread: float) -> None:
    """The likelihood of a ramp, from a lag that is held at −20 s, be it much narrower than the grid and away from it;
    the parameters move with the lag."""

    def at_lags(lags: Array) -> tuple[Array, Array]:
        return ((lags - centre) / spread) ** 2, np.column_stack([np.zeros_like(lags), 2.0 * lags])

    lags, weight, moved = resolved(at_lags, -20.0 + LAGS_ABOUT)
    mean = float(weight @ lags)
    assert mean == pytest.approx(centre, abs=0.03 * spread)
    assert np.sqrt(weight @ (lags - mean) ** 2) == pytest.approx(spread, rel=0.03)
    assert np.sqrt(weight @ (moved[:, 1] - 2.0 * mean) ** 2) == pytest.approx(2.0 * spread, rel=0.03)
    assert len(lags) < 60
