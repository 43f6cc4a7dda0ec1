"""Links: motion from node to node, where a device does not lie still.

A node is an instant at which the device moves. The samples between two nodes give the increments of rotation C,
velocity V and position P, resolved in the body at the first node,

    C = Π C_p,   V = Σ R V_p,   P = Σ (V_before T_p + R P_p),   R the rotation of what is before part p.

Each link is integrated in PARTS, whose sensitivities are those of short turns (`tumble.reduction.turns.moments`), and
put together: with [φ | V | P] the first-order change of a link, and those of a part with index p,

    φ ← φ + R φ_p,   δV ← δV + φ × R V_p + R δV_p,   δP ← δP + T_p δV + φ × R P_p + R δP_p,

δV on the right being that before the part. Within a part what an accelerometer's error adds to the velocity grows with
time, what a rotation adds, ½ φ_p × V_p in all, with its square, so that δP_p = T_p (½ δV_p − φ_p × V_p/12), to ω T_p/6
of itself. White noise of the samples follows the same recursion, as rotations and velocities that arise in each part.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from tumble.reduction.blocks.motion_samples import MotionSamples
from tumble.reduction.blocks.reducer import Reduction
from tumble.reduction.rests.blemishes import bad_samples_of_turns
from tumble.reduction.rests.segmentation import Stretch
from tumble.reduction.rests.sway import FOURTH_DIFFERENCES
from tumble.reduction.turns.turns import TurnSamples, independent_sample_variances, smallest_distances
from tumble.rotation import rotation_matrix, skew
from tumble.sensors.model import SensorKind
from tumble.units import Array, BoolArray, IntArray

PARTS = 4
"""Parts of a link in which its sensitivities are integrated."""
NODE_SECONDS = 0.5
"""s: from node to node."""
STRETCH = 3.0
"""s: motion between two rests that lasts longer is cut into links; a shorter one is a turn."""
NORMAL_MEDIAN = 0.4549
"""Median of the square of a normal number of variance 1."""
QUIET = 0.25
"""The share of the links whose noise counts as that of the samples: what moves fast adds to the others."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Links:
    """K links between M stations, which are the rests and the nodes of a recording in order of time.

    Parameters
    ----------
    file, time : (M,)
        The file of each station, and its time, s: the middle of a rest.
    rest : (N,)
        The station of each rest.
    before : (K,)
        The station before each link; the one after it is the next.
    free : (K,)
        Whether both ends of a link are nodes: then places are compared.
    duration : (K,)
        s.
    samples : TurnSamples
        The samples of the PARTS of each link, one after the other.
    rates, forces : (K PARTS, 2, 3)
        Rates, rad/s, and specific forces, m/s², of nominal sensors at both ends of each part.
    gyro_density, accel_density
        Of white noise, rad²/s and m²/s³.
    magnetometer : (K, 3)
        Readings of the magnetometer, in its unit, at the node before each link; not a number where there is a rest, or
        nothing to either side. None without one.
    magnetometer_variance
        Variance of the noise of these readings.
    bad_samples
        Number of bad samples, with which the links they fall in were left out.
    """

    file: IntArray
    time: Array
    rest: IntArray
    before: IntArray
    free: BoolArray
    duration: Array
    samples: TurnSamples
    rates: Array
    forces: Array
    gyro_density: float
    accel_density: float
    magnetometer: Array | None = None
    magnetometer_variance: float = 0.0
    bad_samples: int = 0

    def __len__(self) -> int:
        return len(self.before)

    @property
    def magnetic(self) -> BoolArray:
        """Whether there is a reading of the magnetometer at the node before each link (K,)."""
        return np.zeros(len(self), dtype=bool) if self.magnetometer is None else np.isfinite(self.magnetometer[:, 0])


def links_of(reduction: Reduction, spans: Sequence[Stretch]) -> Links | None:
    """The links of all motion of a recording that is no turn between rests; None where there is none. Those with a bad
    sample are left out: they do not begin and end at rest, which would tell it from a blow."""
    if reduction.samples is None:
        return None
    blocks = max(1, round(NODE_SECONDS / reduction.block_seconds))
    file, time, before, free = list[int](), list[float](), list[int](), list[bool]()
    rest, edges, duration, fields = list[int](), list[tuple[int, int]](), list[float](), list[Array]()
    for f in reduction.files:
        own = [span for span in spans if span.file == f.file]
        starts, stops = [0, *(span.last for span in own)], [*(span.first for span in own), len(f)]
        torn = [gap for gap in reduction.gaps if gap.file == f.file and not gap.integrable]
        for k, (start, stop) in enumerate(zip(starts, stops, strict=True)):
            if k > 0:
                rest.append(len(time))
                file.append(f.file)
                time.append(0.5 * (own[k - 1].start + own[k - 1].stop))
            inner = 0 < k < len(own)
            if stop - start < blocks or (inner and not stretched(own[k - 1], own[k])):
                continue
            cuts = np.linspace(start, stop, max(1, round((stop - start) / blocks)) + 1).astype(np.int64).tolist()
            nodes = cuts[(1 if k > 0 else 0) : (-1 if k < len(own) else None)]
            first = len(time) - (k > 0)
            file += [f.file] * len(nodes)
            time += [float(f.edges[cut]) for cut in nodes]
            for j, (a, b) in enumerate(pairwise(cuts)):
                if any(gap.time < f.edges[b] and gap.stop > f.edges[a] for gap in torn):
                    continue
                before.append(first + j)
                free.append((k == 0 or j > 0) and (k == len(own) or j < len(cuts) - 2))
                edges.append((f.sample_at(a), f.sample_at(b)))
                fields.append(_between(f.magnetometer.means, a) if k == 0 or j > 0 else np.full(3, np.nan))
                duration.append(reduction.clock_rate * float(f.edges[b] - f.edges[a]))
    if not before:
        return None
    parts = np.array([np.linspace(a, b, PARTS + 1).astype(np.int64) for a, b in edges])
    samples, seconds = _parts_of(reduction.samples, parts), np.array(duration)
    gyro_density, accel_density = (_density(samples, kind, seconds) for kind in ("gyro", "accel"))
    within = np.array([(f.first_sample, f.sample_at(len(f))) for f in (reduction.by_file[file[i]] for i in before)])
    start, stop = np.maximum(parts[:, 0] - 1, within[:, 0]), np.minimum(parts[:, -1] + 1, within[:, 1])
    least = smallest_distances(reduction, (gyro_density, accel_density))
    bad = bad_samples_of_turns(
        reduction.samples, start, stop, (within[:, 0], within[:, 1]), reduction.rate, least, reduction.tuning
    )
    sound = ~np.isin(np.arange(len(parts)), bad.turn)
    if not sound.any():
        return None
    parts = parts[sound]
    rates, forces = _ends(reduction.samples, parts)
    every = [f.magnetometer.means for f in reduction.files if len(f) > 4 and reduction.magnetometer_channels]
    return Links(
        file=np.array(file),
        time=np.array(time),
        rest=np.array(rest, dtype=np.int64),
        before=np.array(before, dtype=np.int64)[sound],
        free=np.array(free, dtype=bool)[sound],
        duration=seconds[sound],
        samples=_parts_of(reduction.samples, parts),
        rates=rates,
        forces=forces,
        gyro_density=gyro_density,
        accel_density=accel_density,
        magnetometer=np.array(fields)[sound] if every else None,
        magnetometer_variance=_variance_between(np.concatenate([np.diff(means, n=4, axis=0) for means in every]))
        if every
        else 0.0,
        bad_samples=len(np.unique(bad.at)),
    )


def _parts_of(stored: MotionSamples, parts: IntArray) -> TurnSamples:
    """The samples of links whose parts have their edges (K, PARTS + 1) there."""
    return TurnSamples(samples=stored, start=parts[:, :-1].ravel(), stop=parts[:, 1:].ravel())


def stretched(before: Stretch, after: Stretch) -> bool:
    """Whether the motion between two rests is cut into links."""
    return before.file == after.file and after.start - before.stop >= STRETCH


def _ends(stored: MotionSamples, parts: IntArray) -> tuple[Array, Array]:
    """Rates and forces (K PARTS, 2, 3) at both ends of each part, means of the samples on both sides."""
    first, last = int(parts.min()), int(parts.max())
    rates, forces, _ = stored.read(first, last)
    out = []
    for values in (rates, forces):
        edges = parts - first
        at = 0.5 * (values[np.maximum(edges - 1, 0)] + values[np.minimum(edges, len(values) - 1)])
        out.append(np.stack([at[:, :-1], at[:, 1:]], axis=2).reshape(-1, 2, 3))
    return out[0], out[1]


EDGE = np.array([-1.0, 7.0, 7.0, -1.0]) / 12.0
"""Weights of the means of two blocks before and two after an edge, which give the value at it to fourth order."""


def _between(means: Array, edge: int) -> Array:
    """The value (3,) at an edge of blocks with these means (K, 3); not a number near the ends."""
    if means.shape[1] != 3 or not 2 <= edge <= len(means) - 2:
        return np.full(3, np.nan)
    return np.asarray(EDGE @ means[edge - 2 : edge + 2])


def _variance_between(differences: Array) -> float:
    """Variance of the noise of values at edges, by fourth differences (K, 3) of the means of blocks: of the quieter
    half, since what moves fast, or jumps, adds to the others."""
    of_block = np.median(differences**2) / (FOURTH_DIFFERENCES * NORMAL_MEDIAN)
    return float(of_block * (EDGE**2).sum())


def _density(samples: TurnSamples, kind: SensorKind, duration: Array) -> float:
    """Density of white noise, rad²/s of rates or m²/s³ of forces, in the quietest links."""
    variances = independent_sample_variances(samples, kind).reshape(-1, PARTS).sum(axis=1)
    return float(np.quantile(variances / duration, QUIET))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Increments:
    """Increments of K links: rotation `C` (K, 3, 3), body at the end → body at the start, velocity `V` (K, 3), m/s,
    and position `P` (K, 3), m, with `columns` (K, 9, m), their derivatives by m quantities."""

    C: Array
    V: Array
    P: Array
    columns: Array


def joined_parts(rows: Array, C: Array, V: Array, P: Array, T: Array) -> Increments:
    """Increments of links from those of their parts.

    Parameters
    ----------
    rows : (K, PARTS, 6, m + 1)
        Derivatives of the rotation and the velocity of every part by m quantities; in the last column a small rotation
        vector by which the rotation differs from `C`, and the velocity, m/s.
    C, V, P, T : (K, PARTS, 3, 3), (K, PARTS, 3), (K, PARTS, 3), (K, PARTS)
        Rotation, velocity (m/s), position (m) and duration (s) of the parts, as integrated.

    Returns
    -------
    Increments
    """
    K, parts, m = len(rows), rows.shape[1], rows.shape[3] - 1
    R, velocity, place = np.broadcast_to(np.eye(3), (K, 3, 3)), np.zeros((K, 3)), np.zeros((K, 3))
    columns = np.zeros((K, 9, m))
    by_rotation, by_velocity, by_place = columns[:, :3], columns[:, 3:6], columns[:, 6:]
    for p in range(parts):
        t = T[:, p, None]
        moved = rows[:, p, 3:, -1]
        gained = (R @ moved[..., None])[..., 0]
        turned = rows[:, p, :3, -1]
        own = P[:, p] + t * (0.5 * (moved - V[:, p]) - np.cross(turned, V[:, p]) / 12.0)
        passed = (R @ own[..., None])[..., 0]
        of_rotation, of_velocity = R @ rows[:, p, :3, :-1], R @ rows[:, p, 3:, :-1]
        of_place = 0.5 * of_velocity + skew(gained) @ of_rotation / 12.0
        by_place += t[..., None] * (by_velocity + of_place) - skew(passed) @ by_rotation
        by_velocity += of_velocity - skew(gained) @ by_rotation
        by_rotation += of_rotation
        place = place + t * velocity + passed
        velocity = velocity + gained
        R = R @ rotation_matrix(turned) @ C[:, p]
    return Increments(C=R, V=velocity, P=place, columns=columns)


def noise_of_links(C: Array, V: Array, P: Array, T: Array, densities: tuple[float, float]) -> tuple[Array, Array]:
    """Roots Z (K, 9, 3 PARTS) of the covariances Z Zᵀ of the increments of links by white noise of gyros, and of those
    by white noise of accelerometers.

    Parameters
    ----------
    C, V, P, T : (K, PARTS, …)
        As in `joined_parts`.
    densities
        Of the noise of gyros, rad²/s, and of accelerometers, m²/s³.
    """
    K, parts = T.shape
    rows = np.zeros((K, parts, 6, 6 * parts + 1))
    rows[:, :, 3:, -1] = V
    for p in range(parts):  # a rotation that arises evenly over the part has half of its effect on the velocity
        of_gyros, of_accels = np.split(rows[:, p, :, 6 * p : 6 * p + 6], 2, axis=2)
        of_gyros[:, :3], of_gyros[:, 3:], of_accels[:, 3:] = np.eye(3), -0.5 * skew(V[:, p]), np.eye(3)
    every = joined_parts(rows, C, V, P, T).columns.reshape(K, 9, parts, 2, 3)
    every *= np.sqrt(T[:, :, None] * densities)[:, None, :, :, None]
    return every[:, :, :, 0].reshape(K, 9, -1), every[:, :, :, 1].reshape(K, 9, -1)
