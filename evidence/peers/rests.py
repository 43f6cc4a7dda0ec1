"""Rests of a recording, for programs that take rests as given, and quaternions of turns.

The detector is that of Tedaldi, Pretto and Menegatti (2014), Sec. III-C: a sample is at rest where the norm of the
three variances of the accelerometers in a window about it is below a threshold. imu_tk has its own way to the
threshold; the other programs have theirs by `found`, from the quieter part of the recording.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from evidence.case import Array, Case, GaveUpError

QUIET = 0.2
"""Share of the samples that is taken to be at rest when the threshold is set."""
ABOVE_QUIET = 6.0
"""A rest has less than so many times the variance of the quiet part."""
LEAST_VARIANCE = 1e-6
"""(m/s²)², below which all is at rest: no hand is that quiet."""
SHORTEST = 1.0
"""s, the shortest rest."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Rests:
    """Rests of a recording: samples start (included) to stop (excluded), (M, 2), and the mean readings, (M, 3)."""

    spans: npt.NDArray[np.int64]
    accel: Array
    gyro: Array | None


def variance_norm(readings: Array, window: int) -> Array:
    """The norm of the variances (N − window + 1,) in windows of so many samples, by their first sample."""
    centred = readings - readings.mean(axis=0)
    sums = np.cumsum(np.vstack([np.zeros((1, 3)), centred]), axis=0)
    squares = np.cumsum(np.vstack([np.zeros((1, 3)), centred**2]), axis=0)
    total, square = sums[window:] - sums[:-window], squares[window:] - squares[:-window]
    variance = np.clip(square - total**2 / window, 0.0, None) / (window - 1)
    return np.asarray(np.linalg.norm(variance, axis=1), dtype=float)


def runs(still: npt.NDArray[np.bool_]) -> npt.NDArray[np.int64]:
    """First (included) and last (excluded) of every run of True, (M, 2)."""
    change = np.flatnonzero(np.diff(np.concatenate([[False], still, [False]]).astype(np.int8)))
    return change.reshape(-1, 2).astype(np.int64)


def static_spans(readings: Array, threshold: float, window: int = 101) -> npt.NDArray[np.int64]:
    """The detector: samples (M, 2) about which the norm is below the threshold."""
    return runs(variance_norm(readings, window) < threshold) + window // 2


def window_of(case: Case) -> int:
    """An odd number of samples that last about a second."""
    return max(11, 2 * round(0.5 * case.rate) + 1)


def rests_between(case: Case, spans: npt.NDArray[np.int64]) -> Rests:
    """The means over these spans."""
    return Rests(
        spans=spans,
        accel=np.array([case.accel[a:b].mean(axis=0) for a, b in spans]).reshape(-1, 3),
        gyro=None if case.gyro is None else np.array([case.gyro[a:b].mean(axis=0) for a, b in spans]).reshape(-1, 3),
    )


def found(case: Case) -> Rests:
    """The rests of a recording, of a table its rows. Raises GaveUpError where there are none."""
    if case.table:
        rows = np.arange(len(case.accel))
        return Rests(spans=np.column_stack([rows, rows + 1]), accel=case.accel, gyro=case.gyro)
    window = window_of(case)
    if len(case.time) <= 2 * window:
        raise GaveUpError(f"{len(case.time)} samples are too few to find rests in")
    norm = variance_norm(case.accel, window)
    threshold = max(ABOVE_QUIET * float(np.quantile(norm, QUIET)), LEAST_VARIANCE)
    spans = static_spans(case.accel, threshold, window)
    stamps = case.time
    steady = np.array([stamps[b - 1] - stamps[a] < 1.5 * (b - a) / case.rate for a, b in spans], dtype=bool)
    spans = spans[steady & ((spans[:, 1] - spans[:, 0]) >= SHORTEST * case.rate)] if len(spans) else spans
    if not len(spans):
        raise GaveUpError("no rests are found")
    return rests_between(case, spans)


def faces(case: Case, within: float) -> dict[str, Array]:
    """The mean reading on each of the six faces, `x+` to `z-`: in the noted sections, else in the rest whose reading is
    nearest to that axis, no farther than `within`, rad. Raises GaveUpError where a face has none."""
    names = [f"{axis}{sign}" for axis in "xyz" for sign in "+-"]
    if all(name in case.sections for name in names):
        return {name: case.between(*case.sections[name]).accel.mean(axis=0) for name in names}
    means = found(case).accel
    directions = means / np.linalg.norm(means, axis=1)[:, None]
    chosen: dict[str, Array] = {}
    for name in names:
        cosine = directions[:, "xyz".index(name[0])] * (1.0 if name[1] == "+" else -1.0)
        if cosine.max() < np.cos(within):
            raise GaveUpError(f"no rest within {np.degrees(within):.0f}° of the face {name}")
        chosen[name] = means[int(np.argmax(cosine))]
    return chosen


# -------------------- quaternions (w, x, y, z) --------------------


def product(p: Array, q: Array) -> Array:
    """p ⊗ q (…, 4)."""
    pw, px, py, pz = np.moveaxis(p, -1, 0)
    qw, qx, qy, qz = np.moveaxis(q, -1, 0)
    out = np.empty(np.broadcast_shapes(p.shape, q.shape))
    out[..., 0] = pw * qw - px * qx - py * qy - pz * qz
    out[..., 1] = pw * qx + px * qw + py * qz - pz * qy
    out[..., 2] = pw * qy - px * qz + py * qw + pz * qx
    out[..., 3] = pw * qz + px * qy - py * qx + pz * qw
    return out


def chained(steps: Array) -> Array:
    """p₀ ⊗ p₁ ⊗ … of steps (turns, N, 4), pairwise; (turns, 4)."""
    while steps.shape[1] > 1:
        if steps.shape[1] % 2:
            one = np.zeros((len(steps), 1, 4))
            one[:, :, 0] = 1.0
            steps = np.concatenate([steps, one], axis=1)
        steps = product(steps[:, 0::2], steps[:, 1::2])
    return steps[:, 0]


def rotation_of(q: Array) -> Array:
    """The matrix (…, 3, 3) that takes v to q ⊗ v ⊗ q*."""
    w, x, y, z = np.moveaxis(q, -1, 0)
    rows = [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
        [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
        [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


def padded(pieces: list[Array]) -> Array:
    """Pieces (n, …) of different lengths as one array (turns, longest, …), zeros behind."""
    out = np.zeros((len(pieces), max(len(piece) for piece in pieces), *pieces[0].shape[1:]))
    for row, piece in zip(out, pieces, strict=True):
        row[: len(piece)] = piece
    return out
