"""What navigation filters ask for of the noise that a record at rest shows.

Filters know two processes, white noise n of a density and a bias that walks, k. Of the processes of a channel
(`NoiseParameters`) these are as large as they over the times that count,

    n² = N² + 3 Q²/Δ       quantisation Q as white noise over one sample Δ
    k² = K² + Σ 2 σ²/T + 3 (2 ln 2/π)² B⁴/N²        what Gauss–Markov noise grows by before it is as old as T; and a
                                                    walk through the flat part where it meets the white noise

and of several channels the largest. A ramp, as of a warm-up, is no noise: a filter follows it as a bias. Where no slow
process shows, k is the largest that the Allan deviation allows, k² ≤ 3 σ²(τ)/τ everywhere.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tumble.reduction.noise.wavelet_moments import FLICKER, NoiseParameters, Panel


@dataclass(frozen=True, kw_only=True, slots=True)
class Densities:
    """White noise, SI/√Hz, and random walk of the bias, SI/s/√Hz, of one kind, the largest of its channels; what the
    record did not show and was bounded by, in sentences."""

    white: float
    walk: float
    bounds: tuple[str, ...] = ()


def densities(panel: Panel, rate: float) -> Densities:
    """The white noise and the walking bias that stand for the processes of a kind of sensors."""
    high, tau = panel.deviation.high, panel.deviation.tau[:, None]
    whites = [_white(p, rate) for p in panel.parameters]
    walks = [_walk(p) for p in panel.parameters]
    bounds = []
    for term, found, most in (
        ("white noise", whites, (high * np.sqrt(tau)).min(axis=0)),
        ("random walk", walks, (high * np.sqrt(3.0 / tau)).min(axis=0)),
    ):
        if 0.0 in found:
            found[:] = [value or float(bound) for value, bound in zip(found, most, strict=True)]
            bounds.append(
                f"{term} of the {panel.title}: not seen in every channel, so the largest that the record allows is "
                "written; record longer"
            )
    return Densities(white=max(whites), walk=max(walks), bounds=tuple(bounds))


def _white(p: NoiseParameters, rate: float) -> float:
    """n of a channel; 0 where it shows neither white noise nor quantisation."""
    N, Q = (0.0 if c is None else c.value for c in (p.white_noise, p.quantisation))
    return float(np.sqrt(N**2 + 3.0 * Q**2 * rate))


def _walk(p: NoiseParameters) -> float:
    """k of a channel; 0 where it shows nothing slow."""
    square = 0.0 if p.rate_random_walk is None else p.rate_random_walk.value**2
    square += sum(2.0 * each.sigma.value**2 / each.time.value for each in p.gauss_markov)
    if p.bias_instability is not None and p.white_noise is not None:
        square += 3.0 * (FLICKER * p.bias_instability.value**2 / p.white_noise.value) ** 2
    return float(np.sqrt(square))
