"""Covariance of an estimate by independent sources, C = Σ K S Kᵀ (docs/explanation/mathematics.md, section 14).

At given hyperparameters the estimate is linear in all random quantities: noise of rests and turns, components of
variance, steps of in-run biases, and priors. With the whitened rows W J of all of these, of unit covariance, and y the
gravity and the parameters, biases being the means over the session, a least-squares estimate has

    ŷ − y = Σ_rows Kᵀ e,   K = W J Z,   Z = Cov(unknowns, y),   C_y = Σ_rows Kᵀ K                                 (37)

The covariance of a block of rows is a sum over sources, 1 = W (Σ_s S_s) Wᵀ, and so is C_y:

    C_y = Σ_s Σ_blocks Hᵀ S_s H,   H = Wᵀ K                                                                        (38)

A row with a weight below 1 counts as one with more noise, in the same proportion from every source. Priors are rows
1/u(g) of gravity and 1/s of a parameter.

Z (39) needs no large matrix. The unknowns of the rests are a chain, δ_i = A_i δ_{i+1} + B_i x + a_i + R_i⁻¹ e_i, with x
the parameters of the session, gravity and the common parameters, so that δ_i = M_i x + …, M_i = A_i M_{i+1} + B_i, and
y = Y x + Σ_i c_i R_i⁻¹ e_i, with c_i R_i⁻¹ from `tumble.inference.normal_equations.session_mean_bias`. Then

    Z_x = Cov(x) Yᵀ,   Z_i = M_i Z_x + N_i,   N_i = A_i N_{i+1} + R_i⁻¹ (c_i R_i⁻¹)ᵀ

If the hyperparameters are integrated over, the sources are scaled to the mean covariance over their points
(`scaled_to`), and the covariance of the estimates at the points is a source itself.

Source: JCGM 100:2008 (GUM), 5.1; EA-4/02 M:2022, section 4.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from tumble.inference.elimination import recur_backwards
from tumble.inference.linearisation import root_of_inverse
from tumble.inference.noise import SCATTER, STATIONS
from tumble.inference.normal_equations import Solution, times
from tumble.units import Array


def contributions(solution: Solution) -> dict[str, Array]:
    """Return the covariances (1 + m, 1 + m) of gravity and the parameters by source.

    For a single session with in-run biases, biases are the means over the session."""
    problem, equations, linearisation = solution.problem, solution.equations, solution.linearisation
    noise, (inverse, by_next), sensitivity = equations.noise, equations.inverses, equations.sensitivity
    d, q, size, biases = equations.unknowns, solution.local.shape[-1], len(solution.parameters), 1 + problem.biases
    accelerometers = problem.instrument.accel.size
    mean = solution.mean_bias
    out = dict[str, Array]()

    def add(name: str, K: Array, SK: Array | None = None) -> None:
        """Add Kᵀ K of rows (…, y), or Kᵀ S K."""
        SK = K if SK is None else SK
        out[name] = out.get(name, 0.0) + K.reshape(-1, K.shape[-1]).T @ SK.reshape(-1, K.shape[-1])

    for s, part in enumerate(problem.session_spans):
        # Z (39); N is zero but for the biases
        Y, stations = np.eye(q + size)[q:], part.stations
        if mean is not None:
            Y[biases] += mean[0][:, :-1]
        Z_x = solution.roots[s] @ (solution.roots[s].T @ Y.T)
        Z = times(sensitivity[stations, :, :-1], Z_x)
        if mean is not None:
            N = inverse @ np.swapaxes(mean[1], -1, -2)
            recur_backwards(by_next, N)
            Z[..., biases] += N

        # covariances by source (38)
        for kind, rows in equations.rows.items():
            block, of_kind = part.rows[kind], noise.rows[kind]
            K = times(rows[block, :, STATIONS[kind] * d : -1], Z_x)
            station = problem.first_station[kind][block] - stations.start
            for e in range(STATIONS[kind]):
                K += rows[block, :, e * d : (e + 1) * d] @ Z[station + e]
            H = np.swapaxes(equations.whitening[kind][block] / of_kind.root_weights[block, None], -1, -2) @ K
            for name, S in of_kind.sources.items():
                add(name, H, S[block] @ H)
            for number in np.unique(of_kind.component):
                along = np.swapaxes(noise.directions[kind][block][:, :, of_kind.component == number], 1, 2) @ H
                add(f"{SCATTER[number]}.scatter", np.sqrt(noise.variances[number]) * along)
        if noise.states:
            states = Z[:, d - noise.states :]
            rho, step = noise.state_rho[stations][:-1, :, None], noise.state_step[stations][:-1, :, None]
            for K in (states[:1], (states[1:] - rho * states[:-1]) / step):
                add("accel.in_run", K[:, : min(accelerometers, noise.biases)])
                add("gyro.in_run", K[:, accelerometers : noise.biases])
                add("displacement", K[:, noise.biases :])
        if problem.local is None:
            mag = 0 if problem.magnetometer is None else len(problem.magnetometer.u)
            add("prior.magnetometer", Z_x[:mag] / problem.local_u[:mag, None])
            add("support", Z_x[mag:q] / problem.local_u[mag:, None])
        for name, members in problem.local_members.items():
            add(f"prior.{name}", Z_x[members] / problem.local_u[members, None])

    common, u, instrument = Z_x[q:], problem.prior_u, problem.instrument
    if problem.prior.covariance is not None:
        add("prior", root_of_inverse(problem.prior.covariance) @ common)
    else:
        K = common / np.where(u > 0.0, u, np.inf)[:, None]
        add("gravity", K[:1])
        add("prior.linear", K[1 : 1 + instrument.linear_count])
        for name, members in instrument.members.items():
            add(f"prior.{name}", K[1:][members])
    add("arrays", linearisation.array[:, :-1] @ common)
    return {name: covariance for name, covariance in out.items() if covariance.any()}


def scaled_to(sources: Mapping[str, Array], covariance: Array) -> dict[str, Array]:
    """Return the sources (1 + m, 1 + m) as T S Tᵀ, whose sum is a given covariance.

    T is symmetric in units of u and nearest to 1: the optimal transport between the two normal distributions."""
    before = np.sum(list(sources.values()), axis=0)
    uncertain = np.flatnonzero((np.diag(before) > 0.0) & (np.diag(covariance) > 0.0))
    index, u = np.ix_(uncertain, uncertain), np.sqrt(np.diag(before)[uncertain])
    value, vectors = np.linalg.eigh(before[index] / np.outer(u, u))
    root = np.sqrt(np.maximum(value, value[-1] * 1e-12))
    half, inverse = (vectors * root) @ vectors.T, (vectors / root) @ vectors.T
    value, vectors = np.linalg.eigh(half @ (covariance[index] / np.outer(u, u)) @ half)
    T = inverse @ ((vectors * np.sqrt(np.maximum(value, 0.0))) @ vectors.T) @ inverse * u[:, None] / u
    out = dict[str, Array]()
    for name, source in sources.items():
        out[name] = np.zeros_like(covariance)
        out[name][index] = T @ source[index] @ T.T
    return out
