"""Where the covariance of an estimate comes from: C = Σ K S Kᵀ over independent sources, exactly
(docs/explanation/mathematics.md, section 14).

At given hyperparameters the estimate is linear in everything that is random: noise of rests and of turns, components of
scatter, steps of the in-run biases, what gravity and the parameters are beforehand. With the whitened rows W J of all
of these, of covariance 1, and y the gravity and the parameters, biases being the means over the session,

    y − ŷ = Σ_rows Kᵀ e,   K = W J Z,   Z = Cov(unknowns, y),   C_y = Σ_rows Kᵀ K                                 (37)

which is what a least-squares estimate is. The covariance of a block of rows is a sum of sources, 1 = W (Σ_s S_s) Wᵀ,
and so is C_y:

    C_y = Σ_s Σ_blocks Hᵀ S_s H,   H = Wᵀ K                                                                        (38)

with the noise within rests and each component of scatter along its directions; steps of the in-run biases are rows of
their own, and so are priors, of which a row of gravity is 1/u(g), one of a parameter 1/s. A row that is kept at a
weight below 1 counts as one of so much more noise, from every source alike.

Z needs no large matrix. The unknowns of the rests are a chain, δ_i = A_i δ_{i+1} + B_i x + a_i + R_i⁻¹ e_i, with x what
the session has of its own, gravity and the common parameters, and so δ_i = M_i x + …, M_i = A_i M_{i+1} + B_i.
y = Y x + Σ_i c_i R_i⁻¹ e_i, where the mean of the biases over a session is followed along the chain from its first rest
(`tumble.inference.normal_equations.session_mean_bias`); then

    Z_x = Cov(x) Yᵀ,   Z_i = M_i Z_x + N_i,   N_i = A_i N_{i+1} + R_i⁻¹ (c_i R_i⁻¹)ᵀ                               (39)

Integrated over the hyperparameters, the covariance C is another one. The sources S at the maximum, which sum up to
C_max, are then T S Tᵀ, with the symmetric T for which T C_max Tᵀ is C less what the estimate moves by from point to
point (`scaled_to`); that is the source that the hyperparameters are.

Source: JCGM 100:2008 (GUM), 5.1; EA-4/02 M:2022, section 4.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from tumble.inference.elimination import recur_backwards
from tumble.inference.linearisation import Linearisation, root_of_inverse
from tumble.inference.noise import SCATTER
from tumble.inference.normal_equations import Solution, times
from tumble.inference.problem import unknown_earth_variance
from tumble.rotation import skew
from tumble.units import Array, IntArray

Covariances = dict[str, Array]
"""By source its covariances S (N, r, r) of rows."""


def noise_covariances(linearisation: Linearisation) -> tuple[Covariances, Covariances, Covariances]:
    """The sources of the noise of the rows of rests, of turns and of links; where the Earth's rate is not known, it
    turns what the velocities go with, too."""
    problem, noise = linearisation.problem, linearisation.noise
    turns, instrument = problem.observations.turns, problem.instrument
    n, sensors, earth = instrument.accel.size, problem.sensors, unknown_earth_variance(problem)
    last = sensors + 3 * (problem.prior.attitude is not None)
    kinds = {"accel.noise": slice(n), "gyro.noise": slice(n, sensors)}
    kinds |= {"attitude": slice(sensors, last), "mag.noise": slice(last, None)}
    rests = {name: np.zeros_like(noise.rest) for name in kinds}
    for name, rows in kinds.items():
        rests[name][:, rows, rows] = noise.rest[:, rows, rows]
    if earth > 0.0 and sensors > n:
        axes, rows = instrument.blocks[1].axes, kinds["gyro.noise"]
        rests["earth"] = np.zeros_like(noise.rest)
        rests["earth"][:, rows, rows] = earth * axes @ axes.T
        rests["gyro.noise"] = rests["gyro.noise"] - rests["earth"]
    in_turns = dict[str, Array]()
    if turns is not None and instrument.in_velocities:
        in_turns["turn.accel.noise"] = np.zeros_like(noise.turn)
        in_turns["turn.accel.noise"][:, 3:6, 3:6] = turns.velocity_covariance
    if turns is not None and earth > 0.0:
        along = np.zeros((*noise.turn.shape[:2], 3))
        along[:, :3] = turns.duration[:, None, None] * np.eye(3)
        if instrument.in_velocities:
            along[:, 3:6] = skew(-0.5 * linearisation.gained) @ along[:, :3]
        in_turns["earth"] = earth * along @ np.swapaxes(along, 1, 2)
    in_turns["turn.gyro.noise"] = noise.turn - sum(in_turns.values())

    def with_scatter(sources: Covariances, directions: tuple[Array, IntArray]) -> Covariances:
        out, (Z, place) = {name: S for name, S in sources.items() if S.any()}, directions
        for number in np.unique(place).tolist():
            along = float(getattr(noise.components, SCATTER[number])) * Z[:, :, place == number]
            if along.any():
                out[f"{SCATTER[number]}.scatter"] = along @ np.swapaxes(along, 1, 2)
        return out

    of_links = {"link.noise": noise.link} if linearisation.problem.moves else {}
    rest, turn, link = map(with_scatter, (rests, in_turns, of_links), noise.directions)
    return rest, turn, link


def contributions(solution: Solution) -> dict[str, Array]:
    """By source the covariance (1 + m, 1 + m) of gravity and the parameters, biases being those of the session where
    there is one and they wander."""
    problem, equations, linearisation = solution.problem, solution.equations, solution.linearisation
    noise, (inverse, by_next), sensitivity = equations.noise, equations.inverses, equations.sensitivity
    d, q, size, biases = equations.unknowns, solution.local.shape[-1], len(solution.parameters), 1 + problem.biases
    accelerometers, rest_weights, turn_weights = problem.instrument.accel.size, noise.rest_weights, noise.turn_weights
    whitening = (
        equations.rest_whitening / rest_weights[:, None],
        equations.turn_whitening / turn_weights[:, None],
        equations.link_whitening / noise.link_weights[:, None],
    )
    covariances = noise_covariances(linearisation.with_components(noise.components))
    every = equations.rest_rows, equations.turn_rows, equations.link_rows
    mean = solution.mean_bias
    out = dict[str, Array]()

    def add(name: str, K: Array, SK: Array | None = None) -> None:
        """Kᵀ K of rows (…, y), or Kᵀ S K."""
        SK = K if SK is None else SK
        out[name] = out.get(name, 0.0) + K.reshape(-1, K.shape[-1]).T @ SK.reshape(-1, K.shape[-1])

    for s, part in enumerate(problem.parts):
        # Z (39): of the unknowns of the rests what is beside that by the others, N, concerns the biases alone
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
        links, station, before = slice(None if problem.moves else 0), problem.station[part.rests], problem.before_link
        ends_of_rests = (station - stations.start,)
        places = (part.rests, ends_of_rests), (part.turns, (part.first, part.first + 1)), (links, (before, before + 1))
        for sources, W, rows, (some, ends) in zip(covariances, whitening, every, places, strict=True):
            K = times(rows[some, :, len(ends) * d : -1], Z_x)
            for e, after in enumerate(ends):
                K += rows[some, :, e * d : (e + 1) * d] @ Z[after]
            H = np.swapaxes(W[some], -1, -2) @ K
            for name, S in sources.items():
                add(name, H, S[some] @ H)
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
    for array in () if linearisation.about is None else linearisation.about.arrays:
        add("arrays", array.rows(instrument, linearisation.point.values)[:, :-1] @ common[1:])
    return {name: covariance for name, covariance in out.items() if covariance.any()}


def scaled_to(sources: Mapping[str, Array], covariance: Array) -> dict[str, Array]:
    """Sources (1 + m, 1 + m) each as T S Tᵀ, so that they sum up to a covariance, T being symmetric in units of u and
    the nearest to 1 (the optimal transport from one normal distribution to the other)."""
    before = np.sum(list(sources.values()), axis=0)
    seen = np.flatnonzero((np.diag(before) > 0.0) & (np.diag(covariance) > 0.0))
    index, u = np.ix_(seen, seen), np.sqrt(np.diag(before)[seen])
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
