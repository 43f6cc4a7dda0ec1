"""What a plan says of a recording without rests, beside what `calibrate` states of simulated ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

import tumble
from tests.support.moving import G, record
from tests.support.moving import Motion as Moved
from tumble.cli import main
from tumble.errors import InputError
from tumble.planning.bounds import expected_bound
from tumble.planning.itinerary import Held, Motion, motion_of
from tumble.planning.setup import GROUPS, Setup, with_all_groups
from tumble.sensors.parameters import positions_by_group
from tumble.units import Array

MOVED: dict[Held, Moved] = {"pivot": Moved(), "hand": Moved(sway=0.1, frequency=0.6, lever=(0.0, 0.0, 0.0))}


def setup() -> Setup:
    return with_all_groups(Setup.of(grade="mems", gravity=G, gravity_u=1e-4))


def u_of_calibration(motion: Moved, seed: int) -> Array:
    """u, root mean square by group, of a simulated recording of a device of the same noise."""
    recording = record(motion, seed)
    time = np.arange(len(recording.gyro)) / recording.rate
    found = tumble.calibrate(
        accel=recording.accel, gyro=recording.gyro, time=time, gravity=G, gravity_u=1e-4, serial="A"
    )
    u, members = np.array([p.u for p in found.parameters]), positions_by_group([p.name for p in found.parameters])
    return np.array([np.sqrt(np.mean(u[members[group]] ** 2)) for group in GROUPS])


@pytest.mark.parametrize("held", list(MOVED))
def test_the_plan_is_what_calibrate_states(held: Held) -> None:
    """Motion by harmonics, which the plan knows nothing of: u of every group, mean of N = 2, within a factor 1.3."""
    found = np.mean([u_of_calibration(MOVED[held], seed) for seed in (1, 2)], axis=0)
    plan = tumble.plan(setup(), motion=Motion(held=held, seconds=120.0))
    ratio = np.array([plan.group(group).u for group in GROUPS]) / found
    assert ratio.max() < 1.3, ratio
    assert ratio.min() > 1.0 / 1.3, ratio


def test_longer_motion_and_a_pivot_are_better() -> None:
    def u(held: Held, seconds: float) -> Array:
        bound = expected_bound(setup(), motion=Motion(held=held, seconds=seconds))
        return np.array([bound.rms(group) for group in GROUPS])

    assert np.all(u("pivot", 240.0) < u("pivot", 60.0))
    assert np.all(u("pivot", 60.0) < u("hand", 60.0))


def test_the_linear_model_has_the_groups_in_its_u() -> None:
    motion = Motion(held="pivot", seconds=60.0)
    linear, whole = (expected_bound(setup(), terms=terms, motion=motion) for terms in ("linear", "full"))
    bare = expected_bound(replace(setup(), further={}), motion=motion)
    assert linear.names == whole.names[: len(linear.names)]
    assert np.all(linear.u >= bare.u * (1.0 - 1e-9))


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--pivot", "two minutes"], "--pivot: expected a number and one of s, min"),
        (["--pivot", "60s", "--hand", "60s"], "--pivot, --hand: expected one of them, found both"),
        (["--hand", "1s"], "hand: expected from 8 s to 3600 s of motion, found 1"),
        (["--hand", "60s", "--want", "accel.bias=1mg"], "expected the method joint, gyros and no wanted accuracies"),
        (["--pivot", "60s", "--method", "scalar"], "expected the method joint, gyros and no wanted accuracies"),
    ],
)
def test_what_cannot_be_planned_is_said_in_a_line(options: list[str], said: str) -> None:
    result = CliRunner().invoke(main, ["plan", *options], catch_exceptions=False)
    assert result.exit_code == 2
    assert said in result.stderr


def test_the_command_says_how_the_device_is_taken_to_be_turned() -> None:
    result = CliRunner().invoke(main, ["plan", "--pivot", "2min", "--grade", "mems"], catch_exceptions=False)
    assert result.exit_code == 0
    assert result.stdout.startswith("2:00 of motion on a pivot\n")
    assert "turned through all attitudes at 60 °/s" in result.stdout
    assert motion_of("2min", None) == Motion(held="pivot", seconds=120.0)
    assert motion_of(None, None) is None
    with pytest.raises(InputError, match="found both"):
        motion_of("1", "1")
