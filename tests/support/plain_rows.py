"""Rows of a linearisation as of rests, turns and links, with the columns of their stations side by side."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import scipy

from tumble.inference.linearisation import Linearisation
from tumble.inference.noise import STATIONS, NoiseModel
from tumble.units import Array, IntArray

AT_REST = "accel", "gyro", "attitude"


@dataclass(frozen=True, kw_only=True)
class PlainRows:
    """Rows (…, ·): the angles of one or both stations, gravity and the parameters, those of a session, the residual.

    Links have angles and velocities of both stations, and then the displacements of both, before gravity."""

    rest: Array
    turn: Array
    link: Array


def plain_rows(rows: Linearisation) -> PlainRows:
    """The rows of a linearisation, those of a rest in the order of AT_REST."""
    m, q, d = len(rows.point.values), len(rows.problem.local_u), rows.problem.station_columns

    def plain(kind: str) -> Array:
        each, wide = rows.rows[kind], 6 if kind == "link" else 3
        stations = [each[..., e * d : e * d + wide] for e in range(STATIONS[kind])]
        stations += [each[..., (e + 1) * d - 3 : (e + 1) * d] for e in range(2 * (kind == "link"))]
        return np.concatenate(
            [*stations, each[..., -2 - m : -1], each[..., -2 - m - q : -2 - m], each[..., -1:]], axis=2
        )

    link = plain("link") if "link" in rows.rows else np.zeros((0, 9, 20 + m + q))
    rest = np.concatenate([plain(kind) for kind in AT_REST if kind in rows.rows], axis=1)
    return PlainRows(rest=rest, turn=plain("turn"), link=link)


def of_rests(by_kind: Mapping[str, Array]) -> Array:
    """Blocks (N, r, c) of every kind of rows at rest as one block-diagonal one."""
    kinds = [by_kind[kind] for kind in AT_REST if kind in by_kind]
    return np.array([scipy.linalg.block_diag(*each) for each in zip(*kinds, strict=True)])


def covariances(noise: NoiseModel) -> tuple[Array, Array]:
    """Covariances of the noise of rests (N, r, r) and of turns (K, t, t), without components of variance."""
    return of_rests({kind: rows.covariance for kind, rows in noise.rows.items()}), noise.rows["turn"].covariance


def directions(noise: NoiseModel) -> tuple[tuple[Array, IntArray], tuple[Array, IntArray]]:
    """Directions of the components of variance of rests and of turns, with the indices of these components."""
    at_rest = np.concatenate([rows.component for kind, rows in noise.rows.items() if kind in AT_REST])
    return (of_rests(noise.directions), at_rest), (noise.directions["turn"], noise.rows["turn"].component)


def with_residuals(rows: Linearisation, rest: Array, turn: Array) -> Linearisation:
    """The rows with other residuals of rests (N, r) and of turns (K, t)."""
    changed, first = dict(rows.rows), 0
    for kind in (*(kind for kind in AT_REST if kind in changed), "turn"):
        changed[kind] = changed[kind].copy()
        count = changed[kind].shape[1]
        changed[kind][..., -1] = turn if kind == "turn" else rest[:, first : first + count]
        first += count
    return replace(rows, rows=changed)
