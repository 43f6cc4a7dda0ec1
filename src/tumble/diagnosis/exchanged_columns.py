"""Columns of a log that are exchanged or have the wrong sign: all ways to do so, and each in words."""

from __future__ import annotations

from itertools import permutations, product

import numpy as np

from tumble.units import Array


def signed_permutations() -> list[Array]:
    """All ways to exchange columns and signs, those with the fewest changes first."""
    out = [
        np.array(signs)[:, None] * np.eye(3)[list(order)]
        for order in permutations(range(3))
        for signs in product((1.0, -1.0), repeat=3)
    ]
    return sorted(out, key=lambda m: _changes(m))


def _readings_of(transform: Array) -> list[tuple[str, Array]]:
    """What a signed permutation of the gyros may mean: that of the gyros, or, unless it is a mirror image, one of the
    accelerometers, of which only the directions up to a common sign show in turns."""
    out = [("gyro", transform)]
    if np.linalg.det(transform) > 0.0:
        out += [("accelerometer", transform.T), ("accelerometer", -transform.T)]
    return out


def _changed(matrix: Array) -> tuple[list[str], list[str]]:
    """Axes whose columns are exchanged, and axes whose signs are wrong."""
    moved = ["xyz"[p] for p in range(3) if matrix[p, p] == 0.0]
    return moved, ["xyz"[p] for p in range(3) if matrix[p].sum() < 0.0]


def _changes(transform: Array) -> int:
    """Columns moved and signs changed, in the simplest reading of a signed permutation."""
    return min(sum(map(len, _changed(matrix))) for _, matrix in _readings_of(transform))


def columns_said(transform: Array) -> str:
    """The simplest readings of a signed permutation of the gyros, in words."""
    said = []
    for sensors, matrix in _readings_of(transform):
        moved, negative = _changed(matrix)
        if len(moved) + len(negative) > _changes(transform):
            continue
        parts = [f"the {sensors} columns {' and '.join(moved)} are exchanged"] if len(moved) == 2 else []
        if len(moved) == 3:
            order = ", ".join("xyz"[int(np.argmax(np.abs(row)))] for row in matrix)
            parts = [f"the {sensors} columns are in the order {order}"]
        if negative:
            parts.append(f"the sign of {sensors} {', '.join(negative)} is wrong")
        said.append(" and ".join(parts))
    return " or ".join(said) + " (relative to the other sensors)"
