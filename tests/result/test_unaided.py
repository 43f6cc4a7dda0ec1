"""Errors without aid: the formulas against a strapdown integration of drawn sensors."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from tests.support.calibrated import HEXAD, calibration, with_fields
from tumble.inference.estimate import Outcome
from tumble.inference.prediction import Prediction
from tumble.result.further import improvement, unaided
from tumble.rotation import rotation_matrix, unit_vector
from tumble.units import DEGREE, G_STANDARD, Array

DRAWS, STEPS, SECONDS = 4000, 600, 60.0
SIZES = {"accel.bias": 0.02, "accel.axis": 2e-3, "gyro.bias": 3e-4}
"""Standard deviations, SI."""


def test_the_formulas_are_those_of_a_strapdown_integration() -> None:
    """4000 sensors with drawn errors are levelled, turned to a drawn heading and integrated at 10 Hz on an Earth that
    does not turn. Root mean squares of 4000 are known to 1.1 %, five of which are 5.6 %."""
    rng = np.random.default_rng(4)
    made = calibration()
    linear = [p for p in made.parameters if p.name.rpartition(".")[0] in SIZES]
    given = tuple(
        replace(p, value=SIZES[p.name.rpartition(".")[0]], u=0.1 * SIZES[p.name.rpartition(".")[0]]) for p in linear
    )
    made = with_fields(made, parameters=given, covariance=None, site=None)
    found = unaided(made, SECONDS)
    assert found is not None
    errors = _integrated(rng)
    for name, drawn in zip(("tilt", "heading", "position"), errors, strict=True):
        assert np.sqrt(np.mean(drawn**2)) == pytest.approx(getattr(found[0], name), rel=0.056), name
        assert getattr(found[1], name) == pytest.approx(0.1 * getattr(found[0], name)), name


def _integrated(rng: np.random.Generator) -> tuple[Array, Array, Array]:
    """Tilt, heading and position errors of DRAWS sensors; the third axis is vertical."""
    up = np.array([0.0, 0.0, 1.0])
    axis = rng.integers(0, 3, DRAWS)
    onto_up = np.array([np.roll(np.eye(3), k, axis=0) for k in (0, 1, 2)])  # turned so that each axis is up once
    bias = SIZES["accel.bias"] * rng.standard_normal((DRAWS, 3))
    skewed = np.tril(SIZES["accel.axis"] * rng.standard_normal((DRAWS, 3, 3)), -1)
    drift = SIZES["gyro.bias"] * rng.standard_normal((DRAWS, 3))
    C = onto_up[axis]  # body to navigation frame, true
    force_b = np.swapaxes(C, 1, 2) @ (G_STANDARD * up)
    read = force_b + bias + np.einsum("ijk,ik->ij", skewed, force_b)
    # levelled: the estimated attitude puts the reading upright
    seen = unit_vector(np.einsum("ijk,ik->ij", C, read))
    axis_angle = np.cross(seen, up)
    estimated = rotation_matrix(axis_angle) @ C
    heading = rotation_matrix(rng.uniform(0.0, 2.0 * np.pi, DRAWS)[:, None] * np.tile(up, (DRAWS, 1)))
    body_turn = np.swapaxes(C, 1, 2) @ heading @ C  # the same turn seen by exact gyros in the body
    C, estimated = heading @ C, estimated @ body_turn
    h = SECONDS / STEPS
    velocity, position = np.zeros((2, DRAWS, 3))
    step = rotation_matrix(h * drift)
    for _ in range(STEPS):
        middle = estimated @ rotation_matrix(0.5 * h * drift)
        acceleration = np.einsum("ijk,ik->ij", middle, read) - G_STANDARD * up
        position, velocity = position + h * velocity + 0.5 * h**2 * acceleration, velocity + h * acceleration
        estimated = estimated @ step
    off = estimated @ np.swapaxes(C, 1, 2)
    angle = 0.5 * np.stack(
        [off[:, 2, 1] - off[:, 1, 2], off[:, 0, 2] - off[:, 2, 0], off[:, 1, 0] - off[:, 0, 1]], axis=1
    )
    return np.hypot(angle[:, 0], angle[:, 1]), angle[:, 2], np.hypot(position[:, 0], position[:, 1])


def test_biases_of_the_next_launch_count_after_calibration() -> None:
    made = calibration()
    moved = tuple(replace(p, run_to_run=0.01) if p.name.startswith("gyro.bias") else p for p in made.parameters)
    now, then = unaided(made), unaided(replace(made, parameters=moved))
    assert now is not None
    assert then is not None
    assert then[1].heading == pytest.approx(np.hypot(now[1].heading, 0.01 * 60.0))
    assert then[0] == now[0]


def test_without_gyros_or_with_other_blocks_nothing_is_stated() -> None:
    assert unaided(calibration(with_gyro=False)) is None
    assert improvement(calibration(accel=HEXAD)) == ()
    (said,) = improvement(calibration())
    assert said.startswith("after 60 s without aid: tilt ")
    assert said.count(" → ") == 3


@pytest.mark.parametrize("axes", [None, HEXAD / np.linalg.norm(HEXAD, axis=1)[:, None]], ids=["triad", "six sensors"])
def test_before_is_what_readings_are_off_by_and_after_what_corrected_ones_are(axes: Array | None) -> None:
    """Readings taken as they are in many attitudes and about many axes; and as many draws of the errors of u."""
    known = Prediction(force_u=4e-3, rate_u=3e-4, at_rate=50.0 * DEGREE)
    nominal, rng = np.eye(3) if axes is None else axes, np.random.default_rng(5)
    made = replace(
        calibration(accel=axes, gyro=axes),
        prediction=known,
        axes=dict.fromkeys(("accel", "gyro"), tuple(map(tuple, nominal.tolist()))),
    )
    inverse, up, expected = np.linalg.pinv(nominal), unit_vector(rng.standard_normal((200_000, 3))), []
    for model, size, u in ((made.accel, G_STANDARD, known.force_u), (made.gyro, 50.0 * DEGREE, known.rate_u)):
        assert model is not None
        assert u is not None
        off = model.predict(size * up) @ inverse.T - size * up
        noise = u * rng.standard_normal((200_000, len(model.bias))) @ inverse.T
        expected += [np.sqrt(np.mean(np.sum(each**2, axis=1))) for each in (off, noise)]
    said = improvement(made)[0]
    found = re.fullmatch(r"at rest off by (\S+) mg → (\S+) mg; rates off by (\S+) % → (\S+) % of 50 °/s", said)
    assert found is not None, said
    sizes = np.array([1e-3 * G_STANDARD, 1e-3 * G_STANDARD, 0.5 * DEGREE, 0.5 * DEGREE])
    np.testing.assert_allclose(np.array(found.groups(), dtype=float) * sizes, expected, rtol=0.06)


def test_what_nothing_is_known_of_was_there_before() -> None:
    """Six faces leave the axes to their usual size: more than what is corrected, and no improvement, but no harm."""
    made = replace(calibration(), prediction=Prediction(force_u=1.0, rate_u=None, at_rate=None))
    found = re.match(r"at rest off by (\S+) mg → (\S+) mg", improvement(made)[0])
    assert found is not None
    assert float(found[1]) >= float(found[2])
    by_faces = replace(made, outcome=Outcome(unobservable=("accel.axis.yx", "accel.axis.zx", "accel.axis.zy")))
    assert improvement(by_faces)[0].endswith(" mg (these rests do not determine the axis angles)")


def test_of_refused_sensors_no_improvement_is_stated() -> None:
    made = replace(calibration(), prediction=Prediction(force_u=4e-3, rate_u=3e-4, at_rate=1.0))
    refused = replace(made, outcome=Outcome(reasons=("gyros jump",), concerns={"gyros jump": ("gyro",)}))
    (said,) = improvement(refused)
    assert said.startswith("at rest off by ")
    assert "rates" not in said
    assert improvement(replace(made, outcome=Outcome(reasons=("no",)))) == ()
