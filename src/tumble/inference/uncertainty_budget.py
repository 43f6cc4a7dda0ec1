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

from dataclasses import dataclass, field

import numpy as np

from tumble.inference.elimination import along_chain, given_others
from tumble.inference.hyperparameters import SCATTER
from tumble.inference.likelihood import Problem, unseen_rate
from tumble.inference.linearisation import root_of_inverse
from tumble.inference.maximum import At, Evaluated
from tumble.rotation import skew
from tumble.scipy_compiled import blas
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


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Sources:
    """The covariance of gravity and the parameters (1 + m, 1 + m) by source, as triangles to which rows are added."""

    triangles: dict[str, Array] = field(default_factory=dict)

    def add(self, name: str, K: Array) -> None:
        """Σ Kᵀ K over rows (..., y)."""
        flat = K.reshape(-1, K.shape[-1])
        if len(flat):
            before = self.triangles.get(name)
            before = np.zeros((K.shape[-1],) * 2, order="F") if before is None else before
            self.triangles[name] = blas.dsyrk(1.0, flat.T, 1.0, before, overwrite_c=1)

    def covariances(self) -> dict[str, Array]:
        """Of those that there are."""
        return {name: np.triu(each) + np.triu(each, 1).T for name, each in self.triangles.items() if each.any()}


def add_contributions(
    out: Sources,
    weight: float,
    at: At,
    here: Evaluated,
    mean: tuple[Array, Array, Array] | None,
    roots: tuple[Roots, Roots],
) -> None:
    """Add the covariance by source at the hyperparameters of `here`, with a weight; the biases are those of the session
    where their `mean` is given (`mean_along`)."""
    problem, told, known = here.problem, here.told, here.known
    d, q, size = told.factor.shape[1], len(problem.own_known), len(known.parameters)
    components, whitened, kept, process = told.weights.components, told.whitened, at.noise.kept, told.process
    sigma = {f"{name}.scatter": getattr(components, name) for name in SCATTER}
    rooted = list[Array]()
    for (where, F), W, weights in zip(roots, (told.weights.rest, told.weights.turn), kept, strict=True):
        longer = np.ones(F.shape[2])
        for name in where.keys() & sigma.keys():
            longer[where[name]] = sigma[name]
        if F is roots[0][1] and len(components.unlike):
            longer[-problem.sensors :] *= components.unlike
        rooted.append((W / weights[:, None]) @ (F * longer))
    inverse, by_next, by, _ = given_others(told.factor)

    for s, part in enumerate(problem.parts):
        # Z (39), along the chain from its last rest to the first
        Y, Z = np.sqrt(weight) * np.eye(q + size)[q:], np.zeros((part.rests.stop - part.rests.start + 1, d, size))
        if mean is not None:
            biases = 1 + problem.biases
            Y[biases] += np.sqrt(weight) * mean[1]
            Z[:-1, :, biases] = inverse @ np.swapaxes(np.sqrt(weight) * mean[2], 1, 2)
        Z_x = known.roots[s] @ (known.roots[s].T @ Y.T)
        Z[:-1] += by[part.rests] @ Z_x
        along_chain(by_next[part.rests], Z[:-1])

        # covariances by source (38)
        rest, turn, first = whitened[0][part.rests], whitened[1][part.turns], part.first
        ends = np.concatenate([Z[first], Z[first + 1]], axis=1)
        for (where, _), F, own, rows, Z_i in (
            (roots[0], rooted[0], part.rests, rest, Z[:-1]),
            (roots[1], rooted[1], part.turns, turn, ends),
        ):
            e, flat = Z_i.shape[1], rows.reshape(-1, rows.shape[2])
            K = rows[:, :, :e] @ Z_i + (flat[:, e:-1] @ Z_x).reshape(*rows.shape[:2], size)
            H = np.swapaxes(F[own], 1, 2) @ K
            for name, columns in where.items():
                if sigma.get(name, 1.0) > 0.0:
                    out.add(name, H[:, columns])
        if process is not None:
            states, follows = Z[:, d - len(process.sigma) :], process.follows[part.rests]
            steps = states[1:] - process.rho[part.rests][:, :, None] * states[:-1]
            K = np.concatenate([states[:1], (steps / process.deviation[part.rests][:, :, None])[follows]])
            accelerometers = problem.instrument.accel.size
            out.add("accel.in_run", K[:, :accelerometers])
            out.add("gyro.in_run", K[:, accelerometers:])
        for name, members in problem.own_members.items():
            out.add(f"prior.{name}", Z_x[members] / problem.own_known[members, None])

    common, u, instrument = Z_x[q:], problem.measured[1], problem.instrument
    if problem.prior.covariance is not None:
        out.add("prior", root_of_inverse(problem.prior.covariance) @ common)
    else:
        K = common / np.where(u > 0.0, u, np.inf)[:, None]
        out.add("gravity", K[:1])
        out.add("prior.linear", K[1 : 1 + instrument.linear_count])
        for group in instrument.further:
            out.add(f"prior.{group.name}", K[1:][instrument.members[group.name]])
    for array in () if at.about is None else at.about.arrays:
        out.add("arrays", array.rows(instrument, at.point.values)[:, :-1] @ common[1:])
