"""Rests as a calibration has them."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from tumble.errors import InputError
from tumble.run.from_estimate import rest_results


def test_a_fit_that_ran_away_is_refused() -> None:
    estimate = cast("Any", SimpleNamespace(rest_residual=np.array([0.0, np.inf])))
    observations = cast("Any", SimpleNamespace(rests=[0, 1]))
    with pytest.raises(InputError, match="expected rests in attitudes far apart, found 2 for which the fit"):
        rest_results(estimate, observations)
