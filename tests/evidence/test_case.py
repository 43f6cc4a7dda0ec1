"""Cases and estimates of the benchmark: frames of programs, names of the truth."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from evidence.case import NAMES, Case, Estimate, GaveUpError, Program, Refusal, matrix_of, parameters_of


def truth(rng: np.random.Generator) -> dict[str, float]:
    return {name: float(0.01 * rng.normal()) for name in NAMES}


def test_parameters_are_the_same_from_any_frame_of_a_program() -> None:
    rng = np.random.default_rng(1)
    true = truth(rng)
    turned = Rotation.from_rotvec(0.3 * rng.normal(size=3)).as_matrix()
    biases = [np.array([true[f"{kind}.bias.{axis}"] for axis in "xyz"]) for kind in ("accel", "gyro")]
    accel, gyro = (matrix_of(true, kind) @ turned for kind in ("accel", "gyro"))
    found = parameters_of(Estimate(accel=accel, accel_bias=biases[0], gyro=gyro, gyro_bias=biases[1]))
    assert tuple(found) == NAMES
    for name in NAMES:
        assert found[name] == pytest.approx(true[name], abs=1e-14)


def still() -> Case:
    time = np.arange(1, 101) / 100.0
    return Case(
        name="still",
        kind="still",
        time=time,
        accel=np.tile([0.0, 0.0, 9.8], (100, 1)),
        gyro=None,
        gravity=9.8,
        gravity_u=1e-4,
    )


def test_a_program_that_lacks_something_says_what() -> None:
    def estimate(case: Case) -> Estimate:
        raise GaveUpError(f"{len(case.time)} samples are too few")

    asking = Program(name="p", needs=frozenset({"gyro", "faces"}), estimate=estimate, source="")
    assert asking.calibrate(still()) == Refusal(reason="needs faces, gyro")
    refused = Program(name="p", needs=frozenset(), estimate=estimate, source="").calibrate(still())
    assert isinstance(refused, Refusal)
    assert refused.reason == "100 samples are too few"


def test_a_part_of_a_case_keeps_rows_together() -> None:
    part = still().between(0.2, 0.5)
    assert part.time[0] == pytest.approx(0.21)
    assert part.time[-1] == pytest.approx(0.5)
    assert part.accel.shape == (30, 3)
    assert part.rate == pytest.approx(100.0)
