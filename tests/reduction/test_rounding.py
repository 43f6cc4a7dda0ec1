"""The resolution of channels: found from the grid of their values, and what it does to their means."""

from __future__ import annotations

import numpy as np
import pytest

from tumble.reduction.blocks.reducer import ChannelState
from tumble.reduction.noise.rounding import Rounding, rounding, rounding_notes
from tumble.units import DEGREE, Array

STEP = 1.19709e-3
RESTS, BLOCKS, SIZE = 26, 50, 10


def state(values: Array) -> ChannelState:
    """The state of a channel as far as it matters here."""
    steps = np.abs(np.diff(values))
    return ChannelState(
        samples=len(values),
        minimum=float(values.min()),
        maximum=float(values.max()),
        repeats=int(np.sum(steps == 0.0)),
        run=0,
        run_stop=0.0,
        run_value=0.0,
        step=float(steps[steps > 0.0].min(initial=np.inf)),
        extreme_run=0,
        extreme_stop=0.0,
    )


def rounded(noise: float, rng: np.random.Generator, decimals: int | None = None) -> tuple[Rounding, Array]:
    """26 rests at random levels and turns between them, of noise in steps, and the errors of the means of the rests."""
    levels = rng.uniform(-900.0, 900.0, RESTS) * STEP
    still = np.repeat(levels, BLOCKS * SIZE)
    true = np.concatenate([still, rng.uniform(-1000.0, 1000.0, 3000) * STEP])
    seen = np.round((true + noise * STEP * rng.standard_normal(len(true))) / STEP) * STEP
    seen = seen if decimals is None else np.round(seen, decimals)
    ends = seen[SIZE - 1 :: SIZE, None]
    found = rounding(ends, [ends[i * BLOCKS : (i + 1) * BLOCKS] for i in range(RESTS)], [state(seen)])
    return found, seen[: len(still)].reshape(RESTS, -1).mean(axis=1) - levels


@pytest.mark.parametrize("decimals", [None, 6])
@pytest.mark.parametrize("noise", [0.0, 0.1, 0.3, 0.5, 1.0, 3.0])
def test_the_step_is_that_of_the_grid(noise: float, decimals: int | None) -> None:
    """Also where the file has its numbers to six decimals, a thousandth of a step."""
    found, _ = rounded(noise, np.random.default_rng(1), decimals)
    assert found.step[0] == pytest.approx(STEP, rel=1e-5)


def test_values_on_no_grid_have_no_step() -> None:
    values = np.random.default_rng(2).standard_normal(5000)
    found = rounding(values[::10, None], [values[:1000:10, None]], [state(values)])
    np.testing.assert_array_equal([found.step, found.rest_u, found.common_u], np.zeros((3, 1)))


@pytest.mark.parametrize(("noise", "expected"), [(0.0, 0.2887), (0.1, 0.1866), (0.2, 0.1023), (0.3, 0.0381)])
def test_the_error_of_a_mean_is_what_is_said(noise: float, expected: float) -> None:
    """40 sets of 26 rests; a root mean square has a standard error of 2 %. The noise that is found is uncertain, and
    the error follows it steeply."""
    rng = np.random.default_rng(3)
    sets = [rounded(noise, rng) for _ in range(40)]
    seen = np.sqrt(np.mean([errors**2 for _, errors in sets])) / STEP
    white = noise / np.sqrt(BLOCKS * SIZE)
    assert np.sqrt(seen**2 - white**2) == pytest.approx(expected, rel=0.12)
    said = np.median([found.rest_u[0] for found, _ in sets]) / STEP
    assert said == pytest.approx(expected, rel=0.3)
    assert np.median([found.noise[0] for found, _ in sets]) / STEP == pytest.approx(noise, abs=0.03)


def test_what_is_common_is_at_most_that_of_no_noise_and_forgotten_from_half_a_step_on() -> None:
    """Without noise LSB/√12; at a fifth of a step LSB e^(−2π²σ²/LSB²)/π = 0.145 LSB."""
    rng = np.random.default_rng(4)
    silent, some, loud = (rounded(noise, rng)[0] for noise in (0.0, 0.2, 0.7))
    assert silent.common_u[0] == pytest.approx(STEP / np.sqrt(12.0))
    relative = some.noise[0] / some.step[0]
    assert some.common_u[0] == pytest.approx(STEP * np.exp(-2.0 * np.pi**2 * relative**2) / np.pi, rel=1e-4)
    assert loud.common_u[0] == 0.0
    assert loud.rest_u[0] < 1e-3 * STEP


def test_notes_name_the_channels_that_rounding_limits() -> None:
    found, _ = rounded(0.0, np.random.default_rng(5))
    (note,) = rounding_notes({"gyro": found})
    assert note.startswith("gyro 1: its noise is 0 of its resolution of 247 °/h")
    assert rounding_notes({"accel": rounded(2.0, np.random.default_rng(6))[0]}) == ()


@pytest.mark.parametrize("noise", [0.05, 0.1, 0.15, 0.2, 0.3, 0.4])
def test_the_error_that_all_rests_have_is_what_is_said(noise: float) -> None:
    """100 gyros whose rests all read the same, somewhere between two steps. Without noise the largest error is √3 u;
    of 100 the root mean square has a standard error of 7 %."""
    rng = np.random.default_rng(7)
    moving = STEP * rng.integers(-1000, 1000, (3000, 1))
    relative = []
    for true in rng.uniform(0.0, STEP, 100):
        values = STEP * np.round((true + noise * STEP * rng.standard_normal((1800, 1))) / STEP)
        samples = np.concatenate([values, moving])
        found = rounding(samples, list(values.reshape(18, 100, 1)), [state(samples[:, 0])])
        u = np.hypot(found.common_u[0], values.std() / np.sqrt(1800))
        relative.append((values.mean() - true) / u)
    assert np.sqrt(np.mean(np.square(relative))) < 1.3
    assert np.max(np.abs(relative)) < 4.5


@pytest.mark.parametrize("noise", [0.1, 0.2, 0.3, 0.35, 0.4])
def test_decimals_round_what_a_chip_has_rounded_before(noise: float) -> None:
    """100 gyros of 1/33 °/s a step in a log of 0.1 °/s: the edges between decimals differ by half a step of the chip,
    which no noise averages out."""
    rng = np.random.default_rng(9)
    decimal, chip = DEGREE * 0.1, DEGREE / 33.0
    moving = decimal * rng.integers(-1000, 1000, (3000, 1))
    relative = []
    for true in rng.uniform(-20.0, 20.0, 100) * decimal:
        by_chip = chip * np.round((true + noise * decimal * rng.standard_normal((1800, 1))) / chip)
        values = decimal * np.round(by_chip / decimal)
        samples = np.concatenate([values, moving])
        found = rounding(samples, list(values.reshape(18, 100, 1)), [state(samples[:, 0])])
        relative.append((values.mean() - true) / np.hypot(found.common_u[0], values.std() / np.sqrt(1800)))
    assert np.sqrt(np.mean(np.square(relative))) < 1.3
    assert np.max(np.abs(relative)) < 4.5


def test_rounding_lasts_as_long_as_a_rate_is_steady() -> None:
    """400 turns at steady rates between steps, 300 samples long, with ramps that pass many steps: the error of the
    integral is that of one sample for as long as the plateau lasts."""
    rng = np.random.default_rng(8)
    found = Rounding(step=np.ones(1), noise=np.zeros(1), rest_u=np.full(1, 12.0**-0.5), common_u=np.ones(1))
    ramp = np.linspace(0.0, 1.0, 100)
    errors, said = [], []
    for rate in rng.uniform(50.0, 60.0, 400):
        rates = np.concatenate([rate * ramp, np.full(300, rate), rate * ramp[::-1]])[:, None]
        rounded_rates = np.round(rates)
        errors.append(0.01 * (rounded_rates - rates).sum())
        said.append(found.variance_of_integrals(rounded_rates, np.full(len(rates), 0.01))[0])
    assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(np.sqrt(np.mean(said)), rel=0.15)
    assert np.sqrt(np.mean(said)) == pytest.approx(3.0 / np.sqrt(12.0), rel=0.1)
