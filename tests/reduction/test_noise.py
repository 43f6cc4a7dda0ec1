"""Allan deviation against allantools and theory; noise terms of simulated records against their truth."""

from __future__ import annotations

import json
import subprocess
import sys
import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import allantools
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter
from scipy.stats import binom, norm

from tests.support import ROOT, naive, study
from tumble.errors import InputError, MissingExtraError
from tumble.reduction import kernels as _kernels
from tumble.reduction.noise.allan_deviation import AllanDeviation, allan_deviation, pooled
from tumble.reduction.noise.wavelet_moments import (
    FLICKER,
    Coefficient,
    GaussMarkov,
    NoiseParameters,
    Panel,
    _Moments,
    filter_densities,
    identify,
)
from tumble.units import DEGREE_PER_HOUR, G_STANDARD, Array
from tumble.views.noise import coefficient_rows, plot

RATE = 100.0
NO_FALSE_ALARM = 5.5  # standard uncertainties: 4e-8


def record(
    rng: np.random.Generator, samples: int, *, Q: float = 0.0, N: float = 0.0, B: float = 0.0, K: float = 0.0
) -> Array:
    """Samples at RATE of a sensor with these noise terms, (1) of `tumble.reduction.noise.allan_deviation`."""
    out: Array = N * np.sqrt(RATE) * rng.standard_normal(samples)
    out += Q * RATE * np.diff(rng.standard_normal(samples + 1))
    out += K / np.sqrt(RATE) * np.cumsum(rng.standard_normal(samples))
    if B > 0.0:
        out += B * flicker(rng, samples)
    return out


def flicker(rng: np.random.Generator, samples: int) -> Array:
    """Noise of two-sided density 1/(2πf): a quarter of a period of shaped white noise, at four times the rate and
    averaged, as samples are means."""
    length, rate = 16 * samples, 4.0 * RATE
    f = np.fft.rfftfreq(length, 1.0 / rate)[1:]
    both = rng.standard_normal((2, len(f)))
    amplitude = np.sqrt(rate * length / (2.0 * np.pi * f) / 2.0)
    spectrum = np.concatenate([[0.0], amplitude * (both[0] + 1j * both[1])])
    return np.asarray(np.fft.irfft(spectrum, length)[: 4 * samples].reshape(samples, 4).mean(axis=1))


def found(samples: Array) -> NoiseParameters:
    (parameters,) = identify(allan_deviation(samples, RATE))
    return parameters


@settings(max_examples=40, deadline=None)
@given(samples=st.integers(3, 9000), seed=st.integers(0, 2**32 - 1), data=st.data())
def test_compiled_sums_equal_the_plain_ones(samples: int, seed: int, data: st.DataObject) -> None:
    phase = np.cumsum(np.random.default_rng(seed).standard_normal(samples))
    largest = (samples - 1) // 2
    sizes = np.array(data.draw(st.lists(st.integers(1, largest), min_size=1, max_size=8)))
    np.testing.assert_allclose(
        _kernels.allan_sums(phase, sizes), naive.allan_sums(phase, sizes), rtol=1e-11, atol=1e-18
    )


@pytest.mark.parametrize("samples", [33, 1000, 50_001])
def test_deviation_equals_allantools(samples: int) -> None:
    rng = np.random.default_rng(1)
    readings = 9.8 + np.column_stack([record(rng, samples, N=1e-3), record(rng, samples, N=1e-4, K=1e-4)])
    ours = allan_deviation(readings, RATE)
    for c in range(2):
        tau, theirs, _, _ = allantools.oadev(readings[:, c], rate=RATE, data_type="freq", taus=ours.tau)
        np.testing.assert_allclose(tau, ours.tau, rtol=1e-12)
        np.testing.assert_allclose(ours.deviation[:, c], theirs, rtol=1e-12)


def test_averaging_times_are_a_quarter_octave_apart_up_to_a_quarter_of_the_record() -> None:
    tau = allan_deviation(np.random.default_rng(2).standard_normal(4096), RATE).tau
    assert tau[0] == 1.0 / RATE
    assert tau[-1] == 1024 / RATE
    far = tau >= 16 / RATE
    np.testing.assert_allclose(np.diff(np.log2(tau[far])), 0.25, atol=0.05)


def test_one_column_is_one_channel() -> None:
    samples = np.random.default_rng(3).standard_normal(500)
    flat, column = allan_deviation(samples, RATE), allan_deviation(samples[:, None], RATE)
    assert flat.deviation.shape == (len(flat.tau), 1)
    np.testing.assert_array_equal(flat.deviation, column.deviation)


@pytest.mark.parametrize(
    ("terms", "variance"),
    [
        ({"N": 2.0}, lambda tau: 4.0 / tau),
        ({"B": 2.0}, lambda tau: np.full_like(tau, 4.0 * FLICKER)),
        ({"K": 2.0}, lambda tau: 4.0 * tau / 3.0),
    ],
    ids=["white", "flicker", "walk"],
)
def test_variance_degrees_and_intervals_are_those_of_theory(
    terms: dict[str, float], variance: Callable[[Array], Array]
) -> None:
    """400 records of 4096 samples, at τ from 4 samples on (below, samples of one instant are not means). σ² is (1)
    within 5.5 of its standard errors and 3 %; its scatter is that of χ² with the stated degrees of freedom to
    30 % (400 records give it to 7 %, the published formulas are good to 10 %); the interval holds the truth in
    0.683 ± 0.15 of the records at each τ (a binomial sigma is 0.023) and ± 0.04 over all."""
    runs, rng = 400, np.random.default_rng(4)
    records = np.column_stack([record(rng, 4096, **terms) for _ in range(runs)])
    adev = allan_deviation(records, RATE)
    near = adev.tau > 3.5 / RATE
    truth = np.sqrt(variance(adev.tau[near]))
    squares = adev.deviation[near] ** 2
    u = squares.std(axis=1) / np.sqrt(runs)
    assert np.all(np.abs(squares.mean(axis=1) - truth**2) < NO_FALSE_ALARM * u + 0.03 * truth**2)
    degrees = 2.0 * squares.mean(axis=1) ** 2 / squares.var(axis=1)
    np.testing.assert_allclose(adev.degrees[near].mean(axis=1), degrees, rtol=0.3)
    inside = (adev.low[near] <= truth[:, None]) & (truth[:, None] <= adev.high[near])
    assert abs(inside.mean() - 0.6827) < 0.04
    assert np.all(np.abs(inside.mean(axis=1) - 0.6827) < 0.15)


@pytest.mark.parametrize(
    ("term", "name", "others"),
    [
        ("N", "white_noise", {}),
        pytest.param("B", "bias_instability", {"N": 0.3}, marks=pytest.mark.weekly),
        pytest.param("K", "rate_random_walk", {"N": 0.1}, marks=pytest.mark.weekly),
        pytest.param("Q", "quantisation", {"N": 1.0}, marks=pytest.mark.weekly),
    ],
)
def test_a_term_is_recovered_within_its_uncertainty(term: str, name: str, others: dict[str, float]) -> None:
    """24 records of 328 s with the term at 1: every estimate within 5.5 of its u (missed by chance once in 10⁶),
    the u neither too small (rms of error/u, with what 24 records scatter) nor three times too large."""
    runs, rng = 24, np.random.default_rng(5)
    records = np.column_stack([record(rng, 2**15, **{term: 1.0}, **others) for _ in range(runs)])
    coefficients = [getattr(p, name) for p in identify(allan_deviation(records, RATE))]
    assert all(isinstance(c, Coefficient) for c in coefficients)
    value, u = np.array([(c.value, c.u) for c in coefficients]).T
    error = (value - 1.0) / u
    assert np.abs(error).max() < NO_FALSE_ALARM
    assert np.sqrt(np.mean(error**2)) < 1.0 + 4.0 / np.sqrt(2.0 * runs)
    assert np.median(u) < 0.06
    assert np.median(u) < 3.0 * value.std()


def test_all_terms_of_a_long_record_are_recovered_together() -> None:
    """With K half as large the walk is told from a ramp, or seen at all, in nine records of twelve only."""
    truth = {"quantisation": 0.1, "white_noise": 1.0, "bias_instability": 0.8, "rate_random_walk": 0.1}
    p = found(record(np.random.default_rng(6), 2**20, Q=0.1, N=1.0, B=0.8, K=0.1))
    for name, value in truth.items():
        coefficient = getattr(p, name)
        assert coefficient is not None, name
        assert abs(coefficient.value - value) < NO_FALSE_ALARM * coefficient.u, name
        assert coefficient.u < 0.35 * value, name


def test_terms_of_the_fit_are_its_variance() -> None:
    p = NoiseParameters(
        quantisation=None,
        white_noise=Coefficient(value=2.0, u=0.1),
        bias_instability=None,
        rate_random_walk=Coefficient(value=3.0, u=0.1),
    )
    terms = p.variances(np.array([1.0, 4.0]))
    np.testing.assert_allclose(terms["white_noise"], [4.0, 1.0])
    np.testing.assert_allclose(terms["rate_random_walk"], [3.0, 12.0])
    assert set(terms) == {"white_noise", "rate_random_walk"}


@pytest.mark.parametrize("kind", ["white", "walk", "quantised", "drifting", "wandering"])
def test_the_covariance_of_the_moments_is_that_of_simulated_records(kind: str) -> None:
    """Of 3000 records of 1024 samples: standard deviations within 7 % (5 sigmas), correlations within 0.1. Random walk
    and Gauss–Markov noise are sums of what happens between samples, so that their shortest clusters have 3 % more."""
    runs, n, rng, time = 3000, 1024, np.random.default_rng(14), 40.0
    white = rng.standard_normal((n, runs))
    squares, times = np.zeros(5), tuple[float, ...]()
    if kind == "white":
        samples, squares[1] = white, 1.0
    elif kind == "walk":
        samples, squares[3] = np.cumsum(white, axis=0), 1.0
    elif kind == "quantised":
        samples, squares[0] = np.diff(rng.standard_normal((n + 1, runs)), axis=0), 1.0
    elif kind == "drifting":
        samples, squares[1], squares[4] = white + 0.01 * np.arange(n)[:, None], 1.0, 1e-4
    else:
        kept = np.exp(-1.0 / time)
        steps = np.vstack([white[:1], np.sqrt(1.0 - kept**2) * white[1:]])
        samples, squares, times = lfilter([1.0], [1.0, -kept], steps, axis=0), np.array([0, 0, 0, 0, 0, 1.0]), (time,)
    sizes = 2 ** np.arange(2, 8)
    phase = np.vstack([np.zeros(runs), np.cumsum(samples, axis=0)])
    moments = [
        0.5 * np.mean((phase[2 * m :] - 2.0 * phase[m:-m] + phase[: -2 * m]) ** 2, axis=0) / m**2
        for m in sizes.tolist()
    ]
    found = np.cov(moments)
    C = _Moments(sizes=sizes, counts=(n,)).covariance(squares, times)
    scale = np.sqrt(np.diag(C))
    np.testing.assert_allclose(np.sqrt(np.diag(found)), scale, rtol=0.07)
    np.testing.assert_allclose(found / np.outer(scale, scale), C / np.outer(scale, scale), atol=0.14)
    twice = _Moments(sizes=sizes, counts=(n, n)).covariance(squares, times)
    np.testing.assert_allclose(twice, 0.5 * C, rtol=1e-9)  # two records of one device


def test_two_gauss_markov_processes_are_told_apart() -> None:
    """T 0.5 and 10 s beside white noise, in records of 22 minutes: both, of every one of five, within 5.5 u."""
    module = study("noise_processes")
    (case,) = (each for each in module.CASES if each.name.startswith("N + σ, T 0.5 s"))
    for p in identify(allan_deviation(module.records(case, 5, np.random.default_rng(15)), module.RATE)):
        assert p.words == "white noise + two Gauss–Markov processes"
        for _, found, true in module.coefficients(case, p):
            assert abs(np.log(found.value / true)) < NO_FALSE_ALARM * found.u / found.value
        low, high = p.gauss_markov[0].time.interval
        assert low < p.gauss_markov[0].time.value < high
        assert p.runner_up
        assert p.margin > 0.0


def test_several_records_are_taken_together() -> None:
    """Four records of one device, one of them shorter: u of N is half that of one; other sensors are refused."""
    rng = np.random.default_rng(16)
    records = [allan_deviation(record(rng, samples, N=1.0), RATE) for samples in (2**14, 2**14, 2**14, 2**13)]
    one, (p,) = identify(records[0])[0], identify(pooled(records))
    assert one.white_noise is not None
    assert p.white_noise is not None
    assert abs(p.white_noise.value - 1.0) < NO_FALSE_ALARM * p.white_noise.u
    assert p.white_noise.u == pytest.approx(one.white_noise.u / np.sqrt(3.5), rel=0.05)
    np.testing.assert_array_equal(pooled(records[:1]).deviation, records[0].deviation)
    with pytest.raises(InputError, match="same sensors at one rate"):
        pooled([records[0], allan_deviation(record(rng, 1000, N=1.0), 2.0 * RATE)])


def test_filters_get_a_walk_as_large_as_the_processes() -> None:
    """Gauss–Markov noise grows like a walk of σ √(2/T) before it is as old as T; what is not seen is bounded."""

    def c(value: float) -> Coefficient:
        return Coefficient(value=value, u=0.01 * value)

    wandering = NoiseParameters(white_noise=c(1e-4), gauss_markov=(GaussMarkov(sigma=c(1e-4), time=c(50.0)),))
    deviation = allan_deviation(1e-3 * np.random.default_rng(17).standard_normal((4096, 1)), RATE)
    panel = Panel(title="gyros", unit="rad/s", channels=("gx",), deviation=deviation, parameters=(wandering,))
    found = filter_densities(panel, RATE)
    assert found.white == pytest.approx(1e-4)
    assert found.walk == pytest.approx(1e-4 * np.sqrt(2.0 / 50.0))
    white = replace(panel, parameters=(NoiseParameters(white_noise=c(1e-4)),))
    bounded = filter_densities(white, RATE)
    assert bounded.walk > 0.0
    assert "random walk of the gyros: not seen" in bounded.bounds[0]


@pytest.mark.parametrize("time", [5.0, 30.0])
def test_gauss_markov_noise_is_called_by_its_name(time: float) -> None:
    """Of σ 20 °/h beside white noise in an hour at 20 Hz, which was called a bias instability of 14.4 ± 1.4 °/h, with a
    white noise 3 u too low: every record has it, with its size and time, and no flat part and no random walk."""
    rate, samples = 20.0, 72_000
    memory, noise, sigma = np.exp(-1.0 / (rate * time)), np.radians(0.15) / 60.0, 20.0 * DEGREE_PER_HOUR
    rng = np.random.default_rng(31)
    steps = sigma * np.sqrt(1.0 - memory**2) * rng.standard_normal((samples, 6))
    steps[0] = sigma * rng.standard_normal(6)
    wandering = lfilter([1.0], [1.0, -memory], steps, axis=0)
    for p in identify(allan_deviation(wandering + noise * np.sqrt(rate) * rng.standard_normal((samples, 6)), rate)):
        assert p.bias_instability is None
        assert p.rate_random_walk is None
        assert p.white_noise is not None
        (process,) = p.gauss_markov
        for found, true in ((process.sigma, sigma), (process.time, time), (p.white_noise, noise)):
            assert abs(found.value - true) < NO_FALSE_ALARM * found.u
            assert found.u < 0.25 * true
        assert [s.symbol for s in coefficient_rows(p, "rad/s")] == ["N", "σ", "T"]
        assert p.variances(np.array([1e-3 * time]))["gauss_markov 1"][0] < 1e-3 * sigma**2


@pytest.mark.weekly
def test_flicker_noise_and_random_walk_are_not_called_gauss_markov() -> None:
    """Of 12 records each chance alone takes none; a random walk of the one, a flat part of the other are as before."""
    rng = np.random.default_rng(32)
    for terms, name in (({"N": 0.3, "B": 1.0}, "bias_instability"), ({"N": 0.1, "K": 1.0}, "rate_random_walk")):
        records = np.column_stack([record(rng, 2**14, **terms) for _ in range(12)])
        results = identify(allan_deviation(records, RATE))
        assert all(p.gauss_markov == () for p in results)
        assert sum(getattr(p, name) is not None for p in results) >= 9


@pytest.mark.weekly
def test_white_noise_alone_shows_nothing_else() -> None:
    """80 records of 82 s: a second term in 0.5 % of them at most, less what chance adds but once in 10⁶."""
    runs, limit = 80, 6
    assert binom.sf(limit, runs, 0.005) < 1e-6
    rng = np.random.default_rng(7)
    records = np.column_stack([record(rng, 2**13, N=1.0) for _ in range(runs)])
    results = identify(allan_deviation(records, RATE))
    assert all(p.white_noise is not None for p in results)
    assert sum(p.bias_instability is not None or p.rate_random_walk is not None for p in results) <= limit
    assert sum(p.quantisation is not None for p in results) <= limit


def test_a_record_too_short_for_the_bias_instability_does_not_give_it() -> None:
    """Flicker noise reaches the white noise at τ = N²/(0.44 B²) = 57 s; 20 s of record do not show it, 3 h do."""
    rng = np.random.default_rng(8)
    assert found(record(rng, 2000, N=1.0, B=0.2)).bias_instability is None
    assert found(record(rng, 2**20, N=1.0, B=0.2)).bias_instability is not None


def test_a_disturbance_that_is_no_noise_enlarges_the_uncertainty() -> None:
    rng = np.random.default_rng(9)
    quiet = record(rng, 2**15, N=1.0)
    t = np.arange(2**15) / RATE
    shaken = quiet + 6.0 * np.sin(2.0 * np.pi * 1.7 * t)
    before, after = found(quiet).white_noise, found(shaken)
    assert before is not None
    assert after.white_noise is None or after.white_noise.u > 5.0 * before.u


def test_a_constant_channel_has_no_noise() -> None:
    samples = np.column_stack([np.full(300, 9.80665), np.random.default_rng(10).standard_normal(300)])
    still, live = identify(allan_deviation(samples, RATE))
    assert still == NoiseParameters()
    assert live.white_noise is not None


@pytest.mark.parametrize("samples", [1000, 1500, 2605])
def test_a_ramp_alone_is_no_noise(samples: int) -> None:
    """As of a column of times that is taken for a sensor."""
    (ramp,) = identify(allan_deviation(np.round(0.05 * np.arange(1, samples + 1), 5), 1.0))
    assert replace(ramp, probability=1.0) == NoiseParameters()


def test_a_panel_of_constant_channels_is_drawn(tmp_path: Path) -> None:
    adev = allan_deviation(np.full((100, 3), 0.1), RATE)
    assert not adev.deviation.any()
    plot([_panel("gyros", "rad/s", ("gx", "gy", "gz"), adev)], tmp_path / "still.svg")


def test_channels_are_worked_on_one_at_a_time() -> None:
    samples = np.random.default_rng(11).standard_normal((200_000, 6))
    allan_deviation(samples[:100], RATE)
    tracemalloc.start()
    allan_deviation(samples, RATE)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 2.5 * samples[:, 0].nbytes


def test_too_few_samples_and_gaps_are_refused_in_one_line() -> None:
    with pytest.raises(InputError, match=r"at least 32 samples at rest, found 31; record longer") as few:
        allan_deviation(np.zeros(31), RATE)
    samples = np.zeros(100)
    samples[50] = np.nan
    with pytest.raises(InputError, match="expected finite samples, found NaN") as gap:
        allan_deviation(samples, RATE)
    assert all("\n" not in str(error.value) for error in (few, gap))


def test_coefficients_are_shown_in_the_units_of_data_sheets() -> None:
    p = NoiseParameters(
        quantisation=None,
        white_noise=Coefficient(value=np.radians(0.003) / 60.0, u=np.radians(0.0001) / 60.0),
        bias_instability=Coefficient(value=0.01 * DEGREE_PER_HOUR, u=0.002 * DEGREE_PER_HOUR),
        rate_random_walk=None,
    )
    white, flat = coefficient_rows(p, "rad/s")
    assert (white.symbol, white.value, white.u, white.unit) == ("N", "0.00300", "0.00010", "°/√h")
    assert (flat.name, flat.value, flat.u, flat.unit) == ("bias instability", "0.0100", "0.0020", "°/h")
    accel = NoiseParameters(
        quantisation=Coefficient(value=2e-3, u=1e-4),
        white_noise=Coefficient(value=50e-6 * G_STANDARD, u=1e-6 * G_STANDARD),
        bias_instability=None,
        rate_random_walk=Coefficient(value=30e-6 * G_STANDARD / 60.0, u=3e-6 * G_STANDARD / 60.0),
    )
    lines = [f"{s.symbol} {s.value} {s.u} {s.unit}" for s in coefficient_rows(accel, "m/s^2")]
    assert lines == ["Q 2.00 0.10 mm/s", "N 50.0 1.0 µg/√Hz", "K 30.0 3.0 µg/√h"]


@pytest.fixture(scope="module")
def panels() -> list[Panel]:
    rng = np.random.default_rng(12)
    accel = allan_deviation(np.column_stack([record(rng, 5000, N=1e-3), np.full(5000, 9.8)]), RATE)
    gyro = allan_deviation(record(rng, 5000, N=1e-5, B=1e-5), RATE)
    return [
        _panel("accelerometers", "m/s^2", ("ax", "ay"), accel),
        _panel("gyros", "rad/s", ("gx",), gyro),
    ]


def _panel(title: str, unit: str, channels: tuple[str, ...], adev: AllanDeviation) -> Panel:
    return Panel(title=title, unit=unit, channels=channels, deviation=adev, parameters=identify(adev))


@pytest.mark.parametrize(("ending", "magic"), [("svg", b"<?xml"), ("png", b"\x89PNG"), ("pdf", b"%PDF")])
def test_plot_writes_the_format_of_the_ending(panels: list[Panel], tmp_path: Path, ending: str, magic: bytes) -> None:
    path = tmp_path / f"allan.{ending}"
    plot(panels, path)
    assert path.read_bytes().startswith(magic)
    again = tmp_path / f"again.{ending}"
    plot(panels, again)
    assert path.read_bytes() == again.read_bytes()


def test_plot_names_sensors_units_and_coefficients(panels: list[Panel], tmp_path: Path) -> None:
    plot(panels, tmp_path / "allan.svg")
    text = (tmp_path / "allan.svg").read_text(encoding="utf-8")
    (white,) = (s for s in coefficient_rows(panels[0].parameters[0], "m/s^2") if s.symbol == "N")
    for word in ("accelerometers", "gyros", "averaging time", f"ax: N = {white.value} ± {white.u} µg/√Hz", "°/h"):
        assert word in text


def test_plot_of_one_kind_of_sensor_has_one_panel(panels: list[Panel], tmp_path: Path) -> None:
    plot(panels[1:], tmp_path / "gyro.svg")
    text = (tmp_path / "gyro.svg").read_text(encoding="utf-8")
    assert "gyros" in text
    assert "accelerometers" not in text


def test_plot_refuses_other_endings(panels: list[Panel], tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"allan.gif: expected a file that ends in .svg, .png or .pdf"):
        plot(panels, tmp_path / "allan.gif")


def test_without_matplotlib_the_extra_is_named(
    panels: list[Panel], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(MissingExtraError, match=r"needs matplotlib; install it with: pip install 'tumble\[lab\]'"):
        plot(panels, tmp_path / "allan.svg")


def test_a_calibration_imports_no_interpolation_unless_a_thermometer_has_steps() -> None:
    code = "import sys, tumble.run.calibrate; assert 'scipy.interpolate' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)


def test_matplotlib_is_imported_by_plot_alone() -> None:
    code = "import sys, tumble.reduction.noise.wavelet_moments; assert 'matplotlib' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)


def test_the_example_of_the_guide_prints_what_it_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    guide = (ROOT / "docs/howto/noise.md").read_text(encoding="utf-8")
    _, code, _, expected = (block.strip("\n") for block in guide.split("```")[2:6])
    monkeypatch.chdir(tmp_path)
    exec(code.removeprefix("python\n"), {})
    assert capsys.readouterr().out.strip() == expected
    assert (tmp_path / "allan-deviation.svg").exists()


def test_intervals_are_the_normal_68_percent() -> None:
    """With many degrees of freedom χ² is normal: σ(1 ± 1/√(2ν))."""
    adev = allan_deviation(np.random.default_rng(13).standard_normal(200_000), RATE)
    relative = 1.0 / np.sqrt(2.0 * adev.degrees[0, 0])
    assert norm.cdf(1.0) - norm.cdf(-1.0) == pytest.approx(0.6827, abs=1e-4)
    assert adev.high[0, 0] / adev.deviation[0, 0] - 1.0 == pytest.approx(relative, rel=0.01)
    assert 1.0 - adev.low[0, 0] / adev.deviation[0, 0] == pytest.approx(relative, rel=0.01)


def test_the_page_shows_what_the_study_wrote() -> None:
    module = study("noise_processes")
    content = json.loads((ROOT / "studies/noise_processes.json").read_text(encoding="utf-8"))
    page = (ROOT / "studies/noise.md").read_text(encoding="utf-8")
    results = [module.Result(**each) for each in content["sums"]]
    assert [each.name for each in results] == [each.name for each in module.CASES]
    assert module.answer(results)[0]
    assert f"--seed {content['seed']}" in page
    for each in results:
        assert each.row in page.splitlines()
