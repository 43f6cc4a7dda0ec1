"""Observability of the nine parameters of a triad from positions, and the positions that would improve it.

The sensitivities are the rows of Eq. (13) of the turntable paper, of the length of a reading to biases, scale factors
and axis angles, for the direction of the true vector in each position.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from tumble.inference.estimate import UNOBSERVABLE_SHARE
from tumble.reduction.rests.rests import sphere_through
from tumble.sensors.model import Block, tilt_null_space
from tumble.sensors.parameters import within_kind
from tumble.units import Array

LARGEST_CONDITION = 100.0
"""Largest condition number of positions that determine the nine parameters. Six faces in which the device stands askew
by up to 5° have 350 at best, good programmes 2 to 10."""
RANK_CONDITION = 20.0  # condition number up to which a combination counts in the rank of refused positions
LEAST_SPREAD = 0.05
"""Spread of readings in a direction, relative to their widest, below which their centre is not determined along it."""
DISTINCT = np.radians(10.0)  # angle between the verticals of distinct positions


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Refusal:
    """Reason why there is no fit.

    Attributes
    ----------
    reason : str
        Sentence with cause and remedy.
    null : (q, 9) array
        Combinations of parameters that the positions do not determine, relative to the modulus and in radians; none if
        the readings do not lie on an ellipsoid.
    """

    reason: str
    null: Array


def undetermined_by_positions(readings: Array, *, block: Block) -> Refusal | None:
    """Return why readings (N, 3) cannot determine the parameters, whatever their noise; None if they can.

    There may be too few positions, too few distinct ones, or all in one plane. The directions are approximated by a
    sphere through the readings."""
    directions = rough_directions(readings @ np.linalg.inv(block.axes).T)
    rows = rest_rows(block, directions)[:, 0]
    _, s, Vt = np.linalg.svd(rows, full_matrices=len(rows) < 9)
    if len(s) == 9 and s[8] * LARGEST_CONDITION > s[0]:
        return None
    rank = int(np.sum(s * RANK_CONDITION > s[0]))
    null, distinct = Vt[rank:], list[Array]()
    for direction in directions:
        if all(direction @ other < np.cos(DISTINCT) for other in distinct):
            distinct.append(direction)
    counted = f"{len(readings)} positions"
    if len(distinct) < len(readings):
        counted += f", only {len(distinct)} of them distinct,"
    candidates = {standing(u): rest_rows(block, u[None])[0] for u in faces_and_edges()}
    plane, (_, extent, axes) = "", np.linalg.svd(directions - directions.mean(axis=0), full_matrices=False)
    if len(directions) >= 3 and extent[-1] <= 0.1 * extent[0]:
        normal = axes[2] * np.sign(axes[2][np.argmax(np.abs(axes[2]))])
        plane = f", all of them in one plane across ({', '.join(f'{v:.2f}' for v in normal)})"
    missing = ", ".join(in_words(null, [within_kind(name) for name in block.names]))
    return Refusal(
        reason=f"{counted} determine {rank} of the 9 parameters (rank {rank}){plane}; undetermined: {missing}; "
        f"positions that would help, the most helpful first: {', '.join(most_informative(null, candidates)[0])}",
        null=null,
    )


def rough_directions(readings: Array) -> Array:
    """Return unit vectors (N, 3) to the readings (N, 3), in body axes, from the centre of the sphere through them."""
    centre, _ = sphere_through(readings, least=LEAST_SPREAD)
    out = readings - centre
    length = np.linalg.norm(out, axis=1, keepdims=True)
    return np.asarray(out / np.where(length > 0.0, length, 1.0))


def rest_rows(block: Block, directions: Array, modulus: float = 1.0) -> Array:
    """Return the sensitivity (N, n − 2, m) of rests in unknown attitudes to the m parameters of a block.

    The vectors have the length `modulus` and the directions (N, 3) in the body. For a triad these are the rows of
    Eq. (13) of the turntable paper."""
    homogeneous = np.concatenate([modulus * directions, np.ones((len(directions), 1))], axis=1)
    jacobian = block.jacobian(np.zeros(len(block.names)))
    return np.asarray(np.einsum("ipr,pqm,iq->irm", tilt_null_space(block.axes, directions), jacobian, homogeneous))


def in_words(null: Array, names: Sequence[str]) -> list[str]:
    """Return the combinations `null` (q, m) in reduced echelon form, which has the fewest parameters, such as
    "scale.y − scale.x": the largest coefficient first, those below 0.15 left out."""
    rows = null.copy()
    for i in range(len(rows)):
        column = int(np.argmax(np.abs(rows[i:]).max(axis=0)))
        pivot = i + int(np.argmax(np.abs(rows[i:, column])))
        rows[[i, pivot]] = rows[[pivot, i]]
        rows[i] /= rows[i, column]
        others = np.arange(len(rows)) != i
        rows[others] -= np.outer(rows[others, column], rows[i])
    texts = list[str]()
    for row in rows:
        order = sorted(range(len(row)), key=lambda i: (-round(float(abs(row[i])), 1), row[i] < 0.0))
        text = ""
        for i in (i for i in order if abs(row[i]) > 0.15):
            size = "" if abs(abs(row[i]) - 1.0) < 0.15 else f"{abs(row[i]):.2g} "
            text += f" {'−' if row[i] < 0 else '+'} {size}{names[i]}"
        texts.append(text.removeprefix(" + "))
    return texts


def most_informative(null: Array, candidates: Mapping[str, Array]) -> tuple[list[str], int]:
    """Return the names of candidates with rows (r, m) that together determine the combinations `null` (q, m), and the
    number of combinations that none determines; each time the one that determines most of the remaining is chosen."""
    chosen: list[str] = []
    remaining = null[np.linalg.norm(null, axis=1) > UNOBSERVABLE_SHARE]
    while len(remaining):
        name = max(candidates, key=lambda name: float(np.linalg.norm(remaining @ candidates[name].T)))
        U, s, _ = np.linalg.svd(remaining @ candidates[name].T)
        rank = int(np.sum(s > UNOBSERVABLE_SHARE * np.linalg.norm(candidates[name])))
        if rank == 0:
            break
        chosen.append(name)
        remaining = U[:, rank:].T @ remaining
    return chosen, len(remaining)


def faces_and_edges() -> list[Array]:
    """Return the verticals (3,) of the faces and edges of a cube."""
    return [np.array(s) / np.linalg.norm(s) for s in product((1.0, 0.0, -1.0), repeat=3) if any(s) and not all(s)]


def standing(vertical: Array) -> str:
    """Return which body axes point up and down, for the vertical (3,) of a face or an edge."""
    parts = [f"{'XYZ'[p]} {'up' if vertical[p] > 0 else 'down'}" for p in range(3) if abs(vertical[p]) > 1e-9]
    return parts[0] if len(parts) == 1 else f"{' and '.join(parts)} (45° each)"
