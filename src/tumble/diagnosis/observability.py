"""What positions tell of the nine parameters of a triad, and which further ones would say what they do not.

Judged by the rows of Eq. (13) of the turntable paper in the directions in which the true vector stood: what a position
says of biases, scale factors and axis angles through the length of the reading.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from tumble.inference.estimate import UNOBSERVABLE_SHARE
from tumble.reduction.rests.rests import sphere_through
from tumble.sensors.model import Block, beyond_turning
from tumble.sensors.parameters import within_kind
from tumble.units import Array

LARGEST_CONDITION = 100.0
"""Positions that determine the nine parameters worse than this, worst against best, do not determine them: six faces in
which the device stands askew by up to 5° reach 350 at best, good programmes 2 to 10."""

COUNTED = 20.0
"""A combination determined so much worse than the best does not count in the rank of refused positions."""

SURROUNDED = 0.05
"""Part of their widest spread by which readings must be spread in a direction for their centre to be told along it."""

DISTINCT = np.radians(10.0)
"""Positions whose verticals differ by less count as one."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Refusal:
    """Why there is no fit: a sentence with cause and remedy. `null` (q, 9) are the combinations of parameters that
    the positions do not determine, in parts of the modulus and radians; none where the readings are not an
    ellipsoid's."""

    reason: str
    null: Array


def undetermined(readings: Array, *, block: Block) -> Refusal | None:
    """Why readings (N, 3) cannot determine the parameters, whatever their noise: too few positions, too few different
    ones, or all of them in one plane. None where they can. For the directions a sphere about the readings is good
    enough."""
    directions = rough_directions(readings @ np.linalg.inv(block.axes).T)
    rows = rows_of_rests(block, directions)[:, 0]
    _, s, Vt = np.linalg.svd(rows, full_matrices=len(rows) < 9)
    if len(s) == 9 and s[8] * LARGEST_CONDITION > s[0]:
        return None
    rank = int(np.sum(s * COUNTED > s[0]))
    null = Vt[rank:]
    distinct = _distinct(directions)
    counted = f"{len(readings)} positions" + (
        f", only {distinct} of them distinct," if distinct < len(readings) else ""
    )
    missing = in_words(null, [within_kind(name) for name in block.names])
    cube = {standing(u): rows_of_rests(block, u[None])[0] for u in faces_and_edges()}
    helpful, _ = most_telling(null, cube)
    reason = (
        f"{counted} determine {rank} of the 9 parameters (rank {rank}){_plane_in_words(directions)}; undetermined: "
        f"{', '.join(missing)}; positions that would help, the most helpful first: {', '.join(helpful)}"
    )
    return Refusal(reason=reason, null=null)


def rough_directions(readings: Array) -> Array:
    """Unit vectors (N, 3) from the centre of the sphere nearest the readings, taken along the body axes."""
    centre, _ = sphere_through(readings, least=SURROUNDED)
    out = readings - centre
    length = np.linalg.norm(out, axis=1, keepdims=True)
    return np.asarray(out / np.where(length > 0.0, length, 1.0))


def rows_of_rests(block: Block, directions: Array, modulus: float = 1.0) -> Array:
    """What rests with a vector of this length along `directions` (N, 3) in the body say of the parameters of a block,
    whatever the exact directions: (N, n − 2, m), of a triad the rows of Eq. (13) of the turntable paper."""
    homogeneous = np.concatenate([modulus * directions, np.ones((len(directions), 1))], axis=1)
    jacobian = block.jacobian(np.zeros(len(block.names)))
    return np.asarray(np.einsum("ipr,pqm,iq->irm", beyond_turning(block.axes, directions), jacobian, homogeneous))


def _distinct(directions: Array) -> int:
    """How many of the directions are more than DISTINCT from all counted before."""
    counted: list[Array] = []
    for u in directions:
        if all(u @ v < np.cos(DISTINCT) for v in counted):
            counted.append(u)
    return len(counted)


def _plane_in_words(directions: Array) -> str:
    """That all directions lie in one plane, where they do."""
    _, s, Vt = np.linalg.svd(directions - directions.mean(axis=0), full_matrices=len(directions) < 3)
    if len(directions) < 3 or s[-1] > 0.1 * s[0]:
        return ""
    normal = Vt[2] * np.sign(Vt[2][np.argmax(np.abs(Vt[2]))])
    return f", all of them in one plane across ({', '.join(f'{v:.2f}' for v in normal)})"


def in_words(null: Array, names: Sequence[str]) -> list[str]:
    """The undetermined combinations in the fewest parameters: the rows of `null` in reduced echelon form."""
    rows = null.copy()
    for i in range(len(rows)):
        column = int(np.argmax(np.abs(rows[i:]).max(axis=0)))
        pivot = i + int(np.argmax(np.abs(rows[i:, column])))
        rows[[i, pivot]] = rows[[pivot, i]]
        rows[i] /= rows[i, column]
        others = np.arange(len(rows)) != i
        rows[others] -= np.outer(rows[others, column], rows[i])
    return [sum_in_words(row, names) for row in rows]


def sum_in_words(row: Array, names: Sequence[str]) -> str:
    """A combination such as "scale.y − scale.x", the largest coefficient first, those below 0.15 left out."""
    said = ""
    for i in sorted(range(len(row)), key=lambda i: (-round(float(abs(row[i])), 1), row[i] < 0.0)):
        if abs(row[i]) > 0.15:
            size = "" if abs(abs(row[i]) - 1.0) < 0.15 else f"{abs(row[i]):.2g} "
            said += f" {'−' if row[i] < 0 else '+'} {size}{names[i]}"
    return said.removeprefix(" + ")


def most_telling(null: Array, candidates: Mapping[str, Array]) -> tuple[list[str], int]:
    """Names of candidates whose rows (r, m) together see the combinations `null` (q, m): each time the one that sees
    most of what is left. Also how many combinations none of them sees."""
    chosen: list[str] = []
    left = null[np.linalg.norm(null, axis=1) > UNOBSERVABLE_SHARE]
    while len(left):
        name = max(candidates, key=lambda name: float(np.linalg.norm(left @ candidates[name].T)))
        U, s, _ = np.linalg.svd(left @ candidates[name].T)
        seen = int(np.sum(s > UNOBSERVABLE_SHARE * np.linalg.norm(candidates[name])))
        if seen == 0:
            break
        chosen.append(name)
        left = U[:, seen:].T @ left
    return chosen, len(left)


def faces_and_edges() -> list[Array]:
    """Verticals (3,) of the faces and edges of a cube."""
    return [np.array(s) / np.linalg.norm(s) for s in product((1.0, 0.0, -1.0), repeat=3) if any(s) and not all(s)]


def standing(vertical: Array) -> str:
    """Which body axes point up and down, in words, for a face or an edge."""
    parts = [f"{'XYZ'[p]} {'up' if vertical[p] > 0 else 'down'}" for p in range(3) if abs(vertical[p]) > 1e-9]
    return parts[0] if len(parts) == 1 else f"{' and '.join(parts)} (45° each)"
