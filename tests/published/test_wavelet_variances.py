"""Noise of three sensors whose wavelet variances or estimates others have published.

Haar wavelet variances at octaves, half the Allan variances, as the data of the R package wv 0.1.3 have them (Guerrier,
Balamuta and others; recordings of EPFL, Geodetic Engineering Laboratory): of the gyros of a LN-200, 8,640,000 samples
at 400 Hz, and the gyro Y of a NavChip, 3,105,250 samples at 250 Hz. Estimates by the generalised method of wavelet
moments of the NavChip and of the gyro X of an MTi-G at 100 Hz are those of the tutorial "GMWM Tutorial with R" of the
same group, chapter 5; the wavelet variances of the MTi-G are published in no table.
"""

from __future__ import annotations

import numpy as np
import pytest

from tumble.reduction.noise.allan_deviation import AllanDeviation
from tumble.reduction.noise.wavelet_moments import (
    NoiseParameters,
    _Fit,
    _fitted,
    _Moments,
    _slopes,
    _Weighting,
    identify,
)
from tumble.units import Array

LN200 = {
    "X": (
        "1.9179e-8 1.1998e-8 6.9218e-9 3.8066e-9 1.8466e-9 9.4752e-10 4.7259e-10 2.3278e-10 1.141e-10 5.6385e-11 "
        "2.7631e-11 1.3941e-11 7.1845e-12 3.5347e-12 1.8033e-12 8.0749e-13 4.325e-13 2.7598e-13 1.2945e-13 "
        "3.4904e-14 2.6629e-14 1.9822e-14"
    ),
    "Y": (
        "1.7898e-8 1.1153e-8 6.3404e-9 3.5771e-9 1.9704e-9 1.0075e-9 4.7403e-10 2.1548e-10 1.0157e-10 4.8918e-11 "
        "2.4195e-11 1.2107e-11 5.9328e-12 3.0694e-12 1.525e-12 7.5852e-13 3.7423e-13 1.7593e-13 9.6922e-14 "
        "6.2029e-14 5.0214e-14 2.9751e-14"
    ),
    "Z": (
        "1.7181e-8 1.0434e-8 5.6897e-9 3.0012e-9 1.5697e-9 7.9409e-10 4.0137e-10 1.9806e-10 9.6507e-11 4.7912e-11 "
        "2.3584e-11 1.1698e-11 5.9974e-12 2.9999e-12 1.507e-12 7.7177e-13 3.7362e-13 1.783e-13 1.1405e-13 "
        "6.5452e-14 1.4008e-14 6.9892e-15"
    ),
}
"""(rad/s)², of 2, 4, 8 … samples."""
NAVCHIP_Y = (
    "3.7589e-6 1.0408e-6 3.071e-7 9.6424e-8 3.5675e-8 1.519e-8 7.4529e-9 4.1661e-9 2.7073e-9 2.0782e-9 1.819e-9 "
    "1.6419e-9 1.6284e-9 1.7074e-9 1.9444e-9 2.428e-9 2.7175e-9 3.0417e-9 3.7379e-9 5.0116e-9"
)
NAVCHIP_ESTIMATES = {
    "Q²": 2.283112e-6,
    "σ²": 7.061277e-7,
    "AR(1)": ((0.9804320, 2.211797e-10), (0.9991688, 1.126672e-11), (0.9999766, 5.982079e-13)),
    "γ²": 3.935597e-14,
}
"""Of the tutorial's best sum: squares in (rad/s)² a sample, of AR(1) processes φ and the variance of the steps."""
MTIG_ESTIMATES = ((0.1255909, 5.028488e-5), (0.9984905, 3.676371e-10), (0.9999226, 1.766927e-11))
MTIG_SAMPLES = 873_684


def octaves(count: int, first: int = 0) -> Array:
    """Cluster sizes (k,) in samples, 2^first and on."""
    return np.asarray(np.exp2(np.arange(first, count, dtype=float)))


def recorded(table: str) -> Array:
    """Allan variances (k,) of 1, 2, 4 … samples."""
    return 2.0 * np.array([float(word) for word in table.split()])


def named(variances: Array, rate: float, samples: int) -> NoiseParameters:
    """The processes that a channel of these Allan variances is said to have."""
    deviation = np.sqrt(variances)[:, None]
    blank = np.ones_like(deviation)
    tau = octaves(len(variances)) / rate
    of = AllanDeviation(tau=tau, deviation=deviation, degrees=blank, low=deviation, high=deviation, counts=(samples,))
    return identify(of)[0]


def fitted(variances: Array, samples: int, start: _Fit) -> tuple[_Fit, Array]:
    """The sum of the processes of another with its own covariance, in units of a sample; and Q of that other."""
    sizes = 2 ** np.arange(len(variances))
    tau, moments, q = sizes.astype(float), _Moments(sizes=sizes, counts=(samples,)), []
    found = start
    for _ in range(8):
        model = _slopes(tau, found.times) @ found.squares
        C = moments.covariance(found.squares, found.times)
        weights = _Weighting(root=np.asarray(np.linalg.cholesky(C)), freedom=2.0 * model**2 / np.diag(C), model=model)
        g, _ = weights.residuals(variances, _slopes(tau, start.times) @ start.squares)
        q.append(float(np.sum(np.linalg.solve(weights.root, g) ** 2)))
        found = _fitted(variances, tau, found, weights)
    return found, np.array(q)


def gauss_markov(processes: tuple[tuple[float, float], ...]) -> tuple[list[float], tuple[float, ...]]:
    """Variances and correlation times, in samples, of AR(1) processes."""
    return [s2 / (1.0 - phi**2) for phi, s2 in processes], tuple(float(-1.0 / np.log(phi)) for phi, _ in processes)


def test_gyros_of_an_ln_200_show_white_noise_of_their_data_sheet() -> None:
    """0.05 °/√h, as the publication quotes it for comparison. X and Z are white noise and nothing else over six hours,
    at every τ within its statistics; Y, which wanders in 0.3 s, follows no sum, and its N is 6 % more than what is left
    of it at long τ."""
    tau = octaves(22) / 400.0
    of_record = np.sqrt(3.0 * tau * 400.0 / 8_640_000)  # of σ² of white noise, standard deviation in parts of it
    for axis, table in LN200.items():
        p = named(recorded(table), 400.0, 8_640_000)
        assert p.words == "white noise"
        assert p.white_noise is not None
        assert 0.035 < np.degrees(p.white_noise.value) * 60.0 < 0.05
        off = recorded(table) * tau / p.white_noise.value**2 - 1.0
        white = slice(8, 19)  # from 0.6 s on, as long as there are thirty pieces
        if axis == "Y":
            assert p.probability < 1e-3
            np.testing.assert_allclose(off[white][:7], -0.12, atol=0.08)
        else:
            assert p.probability > 0.1
            assert np.all(np.abs(off[white]) < 3.0 * of_record[white])


def test_a_gyro_of_a_navchip_has_the_published_quantisation_and_white_noise() -> None:
    """The sum of the publication, fitted to its variances at all scales: Q² and σ² within 1.5 %, sizes of the three
    slower processes within a quarter. Their times differ, up to four times: the publication weights moments by their
    own variances, as if they were independent. Neither sum is that of this sensor: with the full covariance Q is 702
    of 11 degrees of freedom, and 770 of the published values."""
    published = NAVCHIP_ESTIMATES
    squares, times = gauss_markov(published["AR(1)"])  # type: ignore[arg-type]
    other = _Fit(
        squares=np.array([published["Q²"], published["σ²"], 0.0, published["γ²"], 0.0, *squares], dtype=float),
        times=times,
        u=np.empty(0),
    )
    variances = recorded(NAVCHIP_Y)
    model = _slopes(octaves(len(variances)), times) @ other.squares
    np.testing.assert_allclose(model, variances, rtol=0.13)  # the letters of both mean the same
    found, q = fitted(variances, 3_105_250, other)
    assert found.squares[0] == pytest.approx(published["Q²"], rel=0.015)
    assert found.squares[1] == pytest.approx(published["σ²"], rel=0.015)
    np.testing.assert_allclose(np.sqrt(found.squares[5:]), np.sqrt(squares), rtol=0.25)
    assert found.misfit == pytest.approx(702.0, rel=0.01)
    assert q[-1] == pytest.approx(770.0, rel=0.01)


def test_what_vanishes_from_a_sum_is_no_part_of_it() -> None:
    """A white noise of 1e-8 rad/√s had an uncertainty of 0.1, and with it the quantisation one forty times too large:
    the processes of the NavChip that are named are all seen."""
    p = named(recorded(NAVCHIP_Y), 250.0, 3_105_250)
    for name in ("quantisation", "white_noise", "bias_instability", "rate_random_walk", "ramp"):
        coefficient = getattr(p, name)
        assert coefficient is None or coefficient.u < 0.3 * coefficient.value
    assert p.quantisation is not None
    assert p.quantisation.u < 0.02 * p.quantisation.value
    assert p.probability > 0.01


def test_the_published_processes_of_an_mti_g_are_those_of_the_formula() -> None:
    """Allan variances of the two slow AR(1) processes of the publication, from their autocovariance, are those of
    Gauss–Markov noise with the times −Δt/ln φ and the variances s²/(1 − φ²); the difference is that samples of these
    are means. Beside the third, which is white from four samples on, no record of this length tells two processes from
    a flat part, and N comes out 3 % too small."""

    def allan(m: Array, *processes: tuple[float, float]) -> Array:
        """Allan variances of AR(1) processes: of neighbouring means of m samples, 2 var(m) − 2 var(2m)."""

        def of_means(m: Array, phi: float, s2: float) -> Array:
            whole = m * (1.0 + phi) / (1.0 - phi) - 2.0 * phi * (1.0 - phi**m) / (1.0 - phi) ** 2
            return np.asarray(s2 / (1.0 - phi**2) * whole / m**2)

        return np.asarray(np.sum([2.0 * (of_means(m, *p) - of_means(2.0 * m, *p)) for p in processes], axis=0))

    sizes = octaves(17, first=5)
    squares, times = gauss_markov(MTIG_ESTIMATES[1:])
    model = _slopes(sizes, times) @ np.array([0.0, 0.0, 0.0, 0.0, 0.0, *squares])
    np.testing.assert_allclose(model, allan(sizes, *MTIG_ESTIMATES[1:]), rtol=1e-3)
    (phi, s2), interval = MTIG_ESTIMATES[0], 0.01
    p = named(allan(octaves(18), *MTIG_ESTIMATES), 1.0 / interval, MTIG_SAMPLES)
    assert p.words == "white noise + bias instability"
    assert p.white_noise is not None
    assert p.white_noise.value == pytest.approx(np.sqrt(s2 * interval) / (1.0 - phi), rel=0.04)
