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
the session has of its own, gravity and the common parameters. y = Y x + Σ_i c_i R_i⁻¹ e_i, where the mean of the biases
over a session is followed along the chain from its first rest (`tumble.inference.in_run.mean_along`); then

    Z_x = Cov(x) Yᵀ,   Z_i = A_i Z_{i+1} + B_i Z_x + R_i⁻¹ (c_i R_i⁻¹)ᵀ                                            (39)

from the last rest to the first. Integrated over the hyperparameters, C is the mean of (38) over the points, and what
the estimate moves by from point to point is the source that the hyperparameters are.

Source: JCGM 100:2008 (GUM), 5.1; EA-4/02 M:2022, section 4.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from tumble.inference.elimination import given_others
from tumble.inference.hyperparameters import SCATTER, Components, Noise
from tumble.inference.likelihood import Problem, unseen_rate
from tumble.inference.linearisation import root_of_inverse
from tumble.inference.maximum import At
from tumble.inference.step import Known, Told
from tumble.rotation import skew
from tumble.units import Array, IntArray


def contributions(
    problem: Problem, at: At, told: Told, known: Known, mean: tuple[Array, Array, Array] | None
) -> dict[str, Array]:
    """The covariance of gravity and the parameters (1 + m, 1 + m) by source, at the hyperparameters that the rows are
    weighed with; the biases are those of the session where their `mean` is given (`mean_along`)."""
    noise, d, q, size = at.noise, told.factor.shape[1], len(problem.own_known), len(known.parameters)
    components, (rest, turn) = told.weights.components, told.whitened
    apart = told.weights.rest / noise.kept[0][:, None], told.weights.turn / noise.kept[1][:, None]
    _, by_next, by, _ = given = given_others(told.factor)
    out = dict[str, Array]()

    def add(name: str, covariance: Array) -> None:
        if covariance.any():
            out[name] = out[name] + covariance if name in out else covariance

    for s, part in enumerate(problem.parts):
        # Z (39), along the chain from its last rest to the first
        Y, Z = np.eye(q + size)[q:], np.zeros((part.rests.stop - part.rests.start + 1, d, size))
        if mean is not None:
            biases = 1 + problem.biases
            Y[biases] += mean[1]
            Z[:-1, :, biases] = given[0] @ np.swapaxes(mean[2], 1, 2)
        Z_x = known.roots[s] @ (known.roots[s].T @ Y.T)
        Z[:-1] += by[part.rests] @ Z_x
        for i in range(len(Z) - 2, -1, -1):
            Z[i] += by_next[part.rests.start + i] @ Z[i + 1]

        # covariances by source (38)
        K = rest[part.rests, :, :d] @ Z[:-1] + rest[part.rests, :, d:-1] @ Z_x
        H = np.swapaxes(apart[0][part.rests], 1, 2) @ K
        for name, S in _of_rests(problem, noise):
            add(name, _through(S[part.rests], H))
        directions, of = noise.at_rest(components)
        for name, covariance in _of_scatter(components, directions[part.rests], of, H):
            add(name, covariance)
        rows, first = turn[part.turns], part.first
        K = rows[:, :, :d] @ Z[first] + rows[:, :, d : 2 * d] @ Z[first + 1] + rows[:, :, 2 * d : -1] @ Z_x
        H = np.swapaxes(apart[1][part.turns], 1, 2) @ K
        for name, S in _of_turns(problem, at):
            add(name, _through(S[part.turns], H))
        directions, of = noise.turn_directions
        for name, covariance in _of_scatter(components, directions[part.turns], of, H):
            add(name, covariance)
        if (process := told.process) is not None:
            states, follows = Z[:, d - len(process.sigma) :], process.follows[part.rests]
            steps = states[1:] - process.rho[part.rests][:, :, None] * states[:-1]
            K = np.concatenate([states[:1], (steps / process.deviation[part.rests][:, :, None])[follows]])
            accelerometers = problem.instrument.accel.size
            add("accel.in_run", _squares(K[:, :accelerometers]))
            add("gyro.in_run", _squares(K[:, accelerometers:]))
        for name, own in problem.own_members.items():
            add(f"prior.{name}", _squares(Z_x[own] / problem.own_known[own, None]))

    common, u, instrument = Z_x[q:], problem.measured[1], problem.instrument
    if problem.prior.covariance is not None:
        add("prior", _squares(root_of_inverse(problem.prior.covariance) @ common))
    else:
        K = common / np.where(u > 0.0, u, np.inf)[:, None]
        add("gravity", _squares(K[:1]))
        add("prior.linear", _squares(K[1 : 1 + instrument.linear_count]))
        for group in instrument.further:
            add(f"prior.{group.name}", _squares(K[1:][instrument.members[group.name]]))
    for array in () if at.about is None else at.about.arrays:
        add("arrays", _squares(array.rows(instrument, at.point.values)[:, :-1] @ common[1:]))
    return out


def _squares(K: Array) -> Array:
    """Σ Kᵀ K over rows (..., y)."""
    flat = K.reshape(-1, K.shape[-1])
    return np.asarray(flat.T @ flat)


def _through(S: Array, H: Array) -> Array:
    """Σ Hᵀ S H over the blocks of S (N, r, r) and H (N, r, y)."""
    flat = H.reshape(-1, H.shape[2])
    return np.asarray(flat.T @ (S @ H).reshape(flat.shape))


def _of_scatter(components: Components, Z: Array, of: IntArray, H: Array) -> Iterator[tuple[str, Array]]:
    """What each component of scatter has along its directions Z."""
    for place, (name, variance) in enumerate(zip(SCATTER, components.variances.tolist(), strict=True)):
        if variance > 0.0:
            yield f"{name}.scatter", variance * _squares(np.swapaxes(Z[:, :, of == place], 1, 2) @ H)


def _of_rests(problem: Problem, noise: Noise) -> Iterator[tuple[str, Array]]:
    """The covariances (N, r, r) whose sum is that of the rows of rests without scatter."""
    accelerometers, sensors, earth = problem.instrument.accel.size, problem.sensors, unseen_rate(problem)
    kinds = {"accel.noise": slice(accelerometers), "gyro.noise": slice(accelerometers, sensors)}
    for name, own in (kinds | {"attitude": slice(sensors, noise.rest.shape[1])}).items():
        S = np.zeros_like(noise.rest)
        S[:, own, own] = noise.rest[:, own, own]
        if name == "gyro.noise" and earth > 0.0 and sensors > accelerometers:
            of_earth, axes = np.zeros_like(S), problem.instrument.blocks[1].axes
            of_earth[:, own, own] = earth * axes @ axes.T
            S -= of_earth
            yield "earth", of_earth
        yield name, S


def _of_turns(problem: Problem, at: At) -> Iterator[tuple[str, Array]]:
    """The covariances (K, t, t) whose sum is that of the rows of turns without scatter: the rate of the Earth, where it
    is not known, turns what the velocities go with, too."""
    turns, of_gyros, earth = problem.observations.turns, at.noise.turn.copy(), unseen_rate(problem)
    if turns is None:
        return
    if problem.instrument.in_velocities:
        S = np.zeros_like(of_gyros)
        S[:, 3:6, 3:6] = turns.velocity_covariance
        of_gyros -= S
        yield "turn.accel.noise", S
    if earth > 0.0:
        along = np.zeros((*of_gyros.shape[:2], 3))
        along[:, :3] = turns.duration[:, None, None] * np.eye(3)
        if problem.instrument.in_velocities:
            along[:, 3:6] = skew(-0.5 * at.rows.gained) @ along[:, :3]
        S = earth * along @ np.swapaxes(along, 1, 2)
        of_gyros -= S
        yield "earth", S
    yield "turn.gyro.noise", of_gyros
