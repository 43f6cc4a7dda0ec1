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
(`tumble.inference.step.mean_along`); then

    Z_x = Cov(x) Yᵀ,   Z_i = M_i Z_x + N_i,   N_i = A_i N_{i+1} + R_i⁻¹ (c_i R_i⁻¹)ᵀ                               (39)

Integrated over the hyperparameters, C is the mean of (38) over the points, and what
the estimate moves by from point to point is the source that the hyperparameters are.

Source: JCGM 100:2008 (GUM), 5.1; EA-4/02 M:2022, section 4.
"""

from __future__ import annotations

import numpy as np

from tumble.inference.elimination import along_chains
from tumble.inference.likelihood import Problem, unseen_rate
from tumble.inference.linearisation import root_of_inverse
from tumble.inference.maximum import At, Evaluated
from tumble.inference.noise_components import SCATTER
from tumble.inference.step import by_others, times
from tumble.rotation import skew
from tumble.units import Array, IntArray

Roots = tuple[dict[str, slice], Array]
"""Names of sources, and where each stands among the roots F (N, r, Q) of their covariances of rows, S = F Fᵀ over the
columns of a name."""


def noise_roots(problem: Problem, at: At) -> tuple[Roots, Roots]:
    """The sources of the noise of the rows of rests and of turns; where the Earth's rate is not known, it turns what
    the velocities go with, too. Of scatter the directions, which σ is yet to multiply."""
    turns, noise, instrument = problem.observations.turns, at.noise, problem.instrument
    n, sensors, earth = instrument.accel.size, problem.sensors, unseen_rate(problem)
    kinds = {"accel.noise": slice(n), "gyro.noise": slice(n, sensors), "attitude": slice(sensors, noise.rest.shape[1])}
    rests = {name: np.zeros_like(noise.rest) for name in kinds}
    for name, own in kinds.items():
        rests[name][:, own, own] = noise.rest[:, own, own]
    if earth > 0.0 and sensors > n:
        axes, own = instrument.blocks[1].axes, kinds["gyro.noise"]
        rests["earth"] = np.zeros_like(noise.rest)
        rests["earth"][:, own, own] = earth * axes @ axes.T
        rests["gyro.noise"] = rests["gyro.noise"] - rests["earth"]
    in_turns = dict[str, Array]()
    if turns is not None and instrument.in_velocities:
        in_turns["turn.accel.noise"] = np.zeros_like(noise.turn)
        in_turns["turn.accel.noise"][:, 3:6, 3:6] = turns.velocity_covariance
    if turns is not None and earth > 0.0:
        along = np.zeros((*noise.turn.shape[:2], 3))
        along[:, :3] = turns.duration[:, None, None] * np.eye(3)
        if instrument.in_velocities:
            along[:, 3:6] = skew(-0.5 * at.rows.gained) @ along[:, :3]
        in_turns["earth"] = earth * along @ np.swapaxes(along, 1, 2)
    in_turns["turn.gyro.noise"] = noise.turn - sum(in_turns.values())

    def roots(sources: dict[str, Array], directions: tuple[Array, IntArray]) -> Roots:
        columns = dict[str, Array]()
        for name, S in sources.items():
            size = np.sqrt(np.maximum(np.diagonal(S, axis1=1, axis2=2), 0.0))
            unit = np.where(size > 0.0, size, 1.0)
            value, vectors = np.linalg.eigh(S / unit[:, :, None] / unit[:, None, :])
            F = size[:, :, None] * vectors * np.sqrt(np.maximum(value, 0.0))[:, None]
            columns[name] = F[:, :, F.any(axis=(0, 1))]
        Z, of = directions
        columns |= {f"{SCATTER[place]}.scatter": Z[:, :, of == place] for place in np.unique(of).tolist()}
        last = np.cumsum([each.shape[2] for each in columns.values()]).tolist()
        where = {name: slice(end - F.shape[2], end) for (name, F), end in zip(columns.items(), last, strict=True)}
        return where, np.concatenate(list(columns.values()), axis=2)

    return roots(rests, noise.rest_directions), roots(in_turns, noise.turn_directions)


def contributions(
    here: Evaluated, mean: tuple[Array, Array] | None, roots: tuple[Roots, Roots]
) -> tuple[dict[str, Array], dict[str, Array]]:
    """By source the covariance (1 + m, 1 + m) of gravity and the parameters, at hyperparameters or at a stack of them,
    and of what is known beforehand the rows K (k, 1 + m) of which Kᵀ K is one; the biases are those of the session
    where their `mean` is given (`mean_along`)."""
    at, out, beforehand = here.at, dict[str, Array](), dict[str, Array]()

    def add(name: str, K: Array) -> None:
        """Kᵀ K of rows (…, k, y)."""
        square = np.swapaxes(K, -1, -2) @ K
        out[name] = out[name] + square if name in out else square

    problem, told, known = here.problem, here.told, here.known
    d, q, size, biases = told.factor.shape[-2], len(problem.own_usual), known.parameters.shape[-1], 1 + problem.biases
    components, process, (inverse, by_next, by) = told.weights.components, told.process, told.solved
    stack, reduced, own_known = known.parameters.shape[:-1], by_others(problem, told), problem.own_known[..., None]
    sigma = {f"{name}.scatter": np.asarray(getattr(components, name)) for name in SCATTER}
    rooted = list[Array]()
    for (where, F), W, weights in zip(roots, (told.weights.rest, told.weights.turn), at.noise.kept, strict=True):
        longer = np.ones((*stack, F.shape[2]))
        for name in where.keys() & sigma.keys():
            longer[..., where[name]] = sigma[name][..., None]
        if F is roots[0][1] and components.unlike.size:
            longer[..., -problem.sensors :] *= components.unlike
        rooted.append((W / weights[:, None]) @ (F * longer[..., None, None, :]))

    for s, part in enumerate(problem.parts):
        # Z (39): of the unknowns of the rests what is beside that by the others, N, concerns the biases alone
        Y, own = np.tile(np.eye(q + size)[q:], (*stack, 1, 1)), part.rests
        first, accelerometers = own.start + part.first, problem.instrument.accel.size
        places = ((own, (own,)), (part.turns, (first, first + 1)))
        if mean is not None:
            Y[..., biases, :] += mean[0][..., :-1]
            N = inverse @ np.swapaxes(mean[1], -1, -2)
            along_chains(by_next, N)
        Z_x = known.roots[..., s, :, :] @ (np.swapaxes(known.roots[..., s, :, :], -1, -2) @ np.swapaxes(Y, -1, -2))

        # covariances by source (38)
        kinds = zip(roots, rooted, reduced, told.whitened, places, strict=True)
        for (where, _), F, E, rows, (some, ends) in kinds:
            K = times(E[..., some, :, :-1], Z_x)
            if mean is not None:
                for e, after in enumerate(ends):
                    K[..., biases] += rows[..., some, :, e * d : (e + 1) * d] @ N[..., after, :, :]
            F = F[..., some, :, :]
            H = np.empty((*stack, F.shape[-1], K.shape[-3], size))
            np.matmul(np.swapaxes(F, -1, -2), K, out=np.swapaxes(H, -3, -2))
            for name, columns in where.items():
                if np.any(sigma.get(name, 1.0)):
                    add(name, H[..., columns, :, :].reshape(*stack, -1, size))
        if process is not None:
            states = times(by[..., own, 3:, :-1], Z_x)
            if mean is not None:
                states[..., biases] += N[..., own, 3:, :]
            rho, deviation = (each[..., own, :][..., :-1, :, None] for each in (process.rho, process.deviation))
            steps = states[..., 1:, :, :] * (1.0 / deviation)
            steps -= states[..., :-1, :, :] * (rho / deviation)
            for K in (states[..., :1, :, :], steps):
                add("accel.in_run", K[..., :accelerometers, :].reshape(*stack, -1, size))
                add("gyro.in_run", K[..., accelerometers:, :].reshape(*stack, -1, size))
        for name, members in problem.own_members.items():
            K, before = Z_x[..., members, :] / own_known[..., members, :], beforehand.get(f"prior.{name}")
            beforehand[f"prior.{name}"] = K if before is None else np.concatenate([before, K], axis=-2)

    common, u, instrument = Z_x[..., q:, :], problem.measured[1], problem.instrument
    if problem.prior.covariance is not None:
        beforehand["prior"] = root_of_inverse(problem.prior.covariance) @ common
    else:
        K = common / np.where(u > 0.0, u, np.inf)[..., None]
        beforehand |= {"gravity": K[..., :1, :], "prior.linear": K[..., 1 : 1 + instrument.linear_count, :]}
        for name, members in instrument.members.items():
            beforehand[f"prior.{name}"] = K[..., 1:, :][..., members, :]
    arrays = () if at.about is None else at.about.arrays
    if arrays:
        rows = np.concatenate([array.rows(instrument, at.point.values)[:, :-1] for array in arrays])
        beforehand["arrays"] = rows @ common[..., 1:, :]
    return out, beforehand


def averaged(weight: Array, points: list[tuple[dict[str, Array], dict[str, Array]]]) -> dict[str, Array]:
    """The means by source of the contributions of stacks of points with weights (P,), where there are any."""
    out = dict[str, Array]()
    for name in points[0][0]:
        out[name] = np.tensordot(weight, np.concatenate([covariances[name] for covariances, _ in points]), axes=1)
    for name in points[0][1]:
        K = np.concatenate([beforehand[name] for _, beforehand in points]) * np.sqrt(weight)[:, None, None]
        K = K.reshape(-1, K.shape[-1])
        out[name] = K.T @ K
    return {name: covariance for name, covariance in out.items() if covariance.any()}
