"""Links: motion from node to node of a device that does not lie still.

A node is an instant at which the device moves. The samples between two nodes give the increments of rotation C,
velocity V and position P, resolved in the body frame at the first node,

    C = Π C_p,   V = Σ R V_p,   P = Σ (V_before T_p + R P_p),   R the rotation before part p.

Each link is integrated in PARTS, whose sensitivities are those of short turns (`tumble.reduction.turns.moments`). With
[φ | δV | δP] the first-order change of a link, and that of a part with index p, the parts are joined by
(docs/explanation/mathematics.md (42))

    φ ← φ + R φ_p,   δV ← δV + φ × R V_p + R δV_p,   δP ← δP + T_p δV + φ × R P_p + R δP_p,

where φ and δV on the right are those before the part. Within a part, the velocity from an accelerometer error grows
with time, and that from a rotation, ½ φ_p × V_p in all, with its square, so that δP_p = T_p (½ δV_p − φ_p × V_p/12) to
a relative error of ω T_p/6. White noise of the samples follows the same recursion, with a random rotation and velocity
in each part.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from tumble.reduction.blocks.motion_samples import MotionSamples
from tumble.reduction.blocks.reducer import FileBlocks, Reduction
from tumble.reduction.rests.blemishes import bad_samples_of_turns
from tumble.reduction.rests.segmentation import Stretch
from tumble.reduction.rests.sway import FOURTH_DIFFERENCES
from tumble.reduction.turns.turns import TurnSamples, independent_sample_variances, smallest_distances
from tumble.rotation import rotation_matrix, skew
from tumble.units import Array, BoolArray, IntArray

PARTS = 4  # parts of a link in which its sensitivities are integrated
NODE_SECONDS = 0.5  # s from node to node
SHORTEST_LINKED = 3.0  # s: longer motion between two rests is cut into links; shorter motion is a turn
CHI_SQUARE_MEDIAN = 0.4549  # of one degree of freedom
QUIET_SHARE = 0.25  # quantile of the noise over links that is taken for that of the samples: fast motion adds noise
EDGE_WEIGHTS = np.array([-1.0, 7.0, 7.0, -1.0]) / 12.0
"""Weights of the means of two blocks before and two after an edge for the value at the edge, to fourth order."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Links:
    """K links between M stations, which are the rests and nodes of a recording in order of time.

    `file`, `time`: file of each station (M,), and its time, s (M,), for a rest its middle. `rest`: station of each rest
    (N,). `before`: station before each link (K,), followed by the one after it. `free`: whether both ends of a link are
    nodes (K,), so that positions are compared. `duration` (K,), s. `samples`: those of the PARTS of each link, one
    after the other. `rates`, `forces`: rates, rad/s, and specific forces, m/s², of nominal sensors at both ends of each
    part (K PARTS, 2, 3). `gyro_density`, `accel_density`: of white noise, rad²/s and m²/s³. `magnetometer`: readings at
    the node before each link (K, 3), in their unit, NaN at a rest and near the ends of a file; None without a
    magnetometer. `magnetometer_variance`: noise variance of these. `bad_samples`: number of bad samples, whose links
    were left out."""

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
        """Whether the node before each link has a reading of the magnetometer (K,)."""
        return np.zeros(len(self), dtype=bool) if self.magnetometer is None else np.isfinite(self.magnetometer[:, 0])


@dataclass(frozen=True, kw_only=True, slots=True)
class _Interval:
    """Motion from one station to the next, blocks first … last − 1 of a file.

    `before`: index of the station before it. `from_node`, `to_node`: whether the stations at its ends are nodes."""

    file: FileBlocks
    first: int
    last: int
    before: int
    from_node: bool
    to_node: bool


def links_of(reduction: Reduction, spans: Sequence[Stretch]) -> Links | None:
    """Return the links of all motion that is no turn between rests, None if there is none.

    Links with a bad sample are left out: they do not begin and end at rest, which would distinguish it from a blow."""
    stored = reduction.samples
    if stored is None:
        return None
    stations, rest, intervals = _cut_at_nodes(reduction, spans)
    if not intervals:
        return None
    edges = [np.linspace(m.file.sample_at(m.first), m.file.sample_at(m.last), PARTS + 1) for m in intervals]
    parts = np.array(edges).astype(np.int64)
    seconds = reduction.clock_rate * np.array([m.file.edges[m.last] - m.file.edges[m.first] for m in intervals])
    samples, density = _samples_of(stored, parts), dict[str, float]()
    for kind in ("gyro", "accel"):
        variance = independent_sample_variances(samples, kind).reshape(-1, PARTS).sum(axis=1)
        density[kind] = float(np.quantile(variance / seconds, QUIET_SHARE))
    file_start, file_stop = np.array([(m.file.first_sample, m.file.sample_at(len(m.file))) for m in intervals]).T
    start, stop = np.maximum(parts[:, 0] - 1, file_start), np.minimum(parts[:, -1] + 1, file_stop)
    least = smallest_distances(reduction, (density["gyro"], density["accel"]))
    bad = bad_samples_of_turns(stored, start, stop, (file_start, file_stop), reduction.rate, least, reduction.tuning)
    sound = np.setdiff1d(np.arange(len(intervals)), bad.turn)
    if not len(sound):
        return None
    intervals, parts = [intervals[k] for k in sound], parts[sound]
    rates, forces = _ends(stored, parts)
    field, field_variance = _field_at_nodes(reduction, intervals)
    file, time = zip(*stations, strict=True)
    return Links(
        file=np.array(file),
        time=np.array(time),
        rest=np.array(rest, dtype=np.int64),
        before=np.array([m.before for m in intervals]),
        free=np.array([m.from_node and m.to_node for m in intervals]),
        duration=seconds[sound],
        samples=_samples_of(stored, parts),
        rates=rates,
        forces=forces,
        gyro_density=density["gyro"],
        accel_density=density["accel"],
        magnetometer=field,
        magnetometer_variance=field_variance,
        bad_samples=len(np.unique(bad.at)),
    )


def _cut_at_nodes(
    reduction: Reduction, spans: Sequence[Stretch]
) -> tuple[list[tuple[int, float]], list[int], list[_Interval]]:
    """Cut all motion that is no turn between rests into intervals of about NODE_SECONDS.

    Return file and time, s, of every station, the stations that are rests, and the intervals without a gap."""
    blocks = max(1, round(NODE_SECONDS / reduction.block_seconds))
    stations, at_rest, intervals = list[tuple[int, float]](), list[int](), list[_Interval]()
    for f in reduction.files:
        rests = [span for span in spans if span.file == f.file]
        gaps = [gap for gap in reduction.gaps if gap.file == f.file and not gap.integrable]
        for before, after in pairwise([None, *rests, None]):
            if before is not None:
                at_rest.append(len(stations))
                stations.append((f.file, 0.5 * (before.start + before.stop)))
            start = 0 if before is None else before.last
            stop = len(f) if after is None else after.first
            is_turn = before is not None and after is not None and not is_linked(before, after)
            if is_turn or stop - start < blocks:
                continue
            count = max(1, round((stop - start) / blocks))
            cuts = np.linspace(start, stop, count + 1).astype(np.int64).tolist()
            nodes = cuts[0 if before is None else 1 : None if after is None else -1]
            station = len(stations) - (before is not None)
            stations += [(f.file, float(f.edges[node])) for node in nodes]
            for j, (first, last) in enumerate(pairwise(cuts)):
                if any(gap.time < f.edges[last] and gap.stop > f.edges[first] for gap in gaps):
                    continue
                from_node, to_node = before is None or j > 0, after is None or j < count - 1
                interval = _Interval(
                    file=f, first=first, last=last, before=station + j, from_node=from_node, to_node=to_node
                )
                intervals.append(interval)
    return stations, at_rest, intervals


def _field_at_nodes(reduction: Reduction, intervals: Sequence[_Interval]) -> tuple[Array | None, float]:
    """Return the readings of the magnetometer (K, 3) before every interval, NaN at a rest and near the ends of a file,
    and their noise variance; None without a magnetometer.

    The variance is that of fourth differences of the quieter half: what moves fast, or jumps, adds to the others."""
    by_file = [f.magnetometer.means for f in reduction.files if len(f) > 4]
    if not by_file or not reduction.magnetometer_channels:
        return None, 0.0
    squares = np.concatenate([np.diff(means, n=4, axis=0) for means in by_file]) ** 2
    block_variance = np.median(squares) / (FOURTH_DIFFERENCES * CHI_SQUARE_MEDIAN)
    field = np.full((len(intervals), 3), np.nan)
    for k, m in enumerate(intervals):
        means = m.file.magnetometer.means
        if m.from_node and 2 <= m.first <= len(means) - 2:
            field[k] = EDGE_WEIGHTS @ means[m.first - 2 : m.first + 2]
    return field, float(block_variance * (EDGE_WEIGHTS**2).sum())


def _samples_of(stored: MotionSamples, parts: IntArray) -> TurnSamples:
    """Return the samples of links whose parts have these edges (K, PARTS + 1)."""
    return TurnSamples(samples=stored, start=parts[:, :-1].ravel(), stop=parts[:, 1:].ravel())


def is_linked(before: Stretch, after: Stretch) -> bool:
    """Return whether the motion between two rests is cut into links."""
    return before.file == after.file and after.start - before.stop >= SHORTEST_LINKED


def _ends(stored: MotionSamples, parts: IntArray) -> tuple[Array, Array]:
    """Return rates and forces (K PARTS, 2, 3) at both ends of each part, means of the samples on either side."""
    rates, forces, _ = stored.read(int(parts.min()), int(parts.max()))
    edges = parts - parts.min()
    before, after = np.maximum(edges - 1, 0), np.minimum(edges, len(rates) - 1)
    at = [0.5 * (values[before] + values[after]) for values in (rates, forces)]
    rates, forces = (np.stack([x[:, :-1], x[:, 1:]], axis=2).reshape(-1, 2, 3) for x in at)
    return rates, forces


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Increments:
    """Increments of K links: rotation `C` (K, 3, 3) from the body at the end to the body at the start, velocity `V`
    (K, 3), m/s, position `P` (K, 3), m, and their derivatives by m quantities, `columns` (K, 9, m)."""

    C: Array
    V: Array
    P: Array
    columns: Array


def joined_parts(rows: Array, C: Array, V: Array, P: Array, T: Array) -> Increments:
    """Join the increments of parts to those of links.

    `rows` (K, PARTS, 6, m + 1): derivatives of the rotation and the velocity of every part by m quantities; the last
    column has the rotation vector by which the rotation differs from `C`, and the velocity, m/s. `C`, `V`, `P`, `T`:
    rotation (K, PARTS, 3, 3), velocity (K, PARTS, 3), m/s, position (K, PARTS, 3), m, and duration (K, PARTS), s, as
    integrated."""
    K, parts, m = len(rows), rows.shape[1], rows.shape[3] - 1
    R, velocity, position = np.broadcast_to(np.eye(3), (K, 3, 3)), np.zeros((K, 3)), np.zeros((K, 3))
    columns = np.zeros((K, 9, m))
    rotation_columns, velocity_columns, position_columns = columns[:, :3], columns[:, 3:6], columns[:, 6:]
    for p in range(parts):
        t = T[:, p, None]
        moved = rows[:, p, 3:, -1]
        gained = (R @ moved[..., None])[..., 0]
        turned = rows[:, p, :3, -1]
        displacement = P[:, p] + t * (0.5 * (moved - V[:, p]) - np.cross(turned, V[:, p]) / 12.0)
        passed = (R @ displacement[..., None])[..., 0]
        d_rotation, d_velocity = R @ rows[:, p, :3, :-1], R @ rows[:, p, 3:, :-1]
        d_position = 0.5 * d_velocity + skew(gained) @ d_rotation / 12.0
        position_columns += t[..., None] * (velocity_columns + d_position) - skew(passed) @ rotation_columns
        velocity_columns += d_velocity - skew(gained) @ rotation_columns
        rotation_columns += d_rotation
        position = position + t * velocity + passed
        velocity = velocity + gained
        R = R @ rotation_matrix(turned) @ C[:, p]
    return Increments(C=R, V=velocity, P=position, columns=columns)


def noise_of_links(C: Array, V: Array, P: Array, T: Array, densities: tuple[float, float]) -> tuple[Array, Array]:
    """Return square roots Z (K, 9, 3 PARTS) of the covariances Z Zᵀ of the increments of links from the white noise of
    gyros, and from that of accelerometers, whose densities are in rad²/s and m²/s³. Other arguments are as in
    `joined_parts`."""
    K, parts = T.shape
    rows = np.zeros((K, parts, 6, 6 * parts + 1))
    rows[:, :, 3:, -1] = V
    for p in range(parts):  # a rotation that arises evenly over the part has half of its effect on the velocity
        gyro, accel = np.split(rows[:, p, :, 6 * p : 6 * p + 6], 2, axis=2)
        gyro[:, :3], gyro[:, 3:], accel[:, 3:] = np.eye(3), -0.5 * skew(V[:, p]), np.eye(3)
    roots = joined_parts(rows, C, V, P, T).columns.reshape(K, 9, parts, 2, 3)
    roots *= np.sqrt(T[:, :, None] * densities)[:, None, :, :, None]
    return roots[:, :, :, 0].reshape(K, 9, -1), roots[:, :, :, 1].reshape(K, 9, -1)
