"""Where a device is and how it is turned, as functions of time, and the rate and specific force that it feels.

A course is rests with turns between them. On turn k, from the attitude q_k and the place p_k to the next,

    q(t) = q_k exp(v_k s(u) + tremor(t) + ringing(t)),      p(t) = p_k + (p_{k+1} − p_k) s(u) + …

with u the share of the turn's time that has passed and s a quintic that is at rest at both ends. Tremor are sinusoids
of 4 to 10 Hz within the turn (and, where the device is held, at rest too); ringing is a decaying oscillation after
every stop, of a device on something soft, or a creeping to its place; a knock moves it to and fro within 20 ms.
Everything else follows by central differences over STEP, whose error is
1e-6 of an acceleration at 10 Hz:

    ω(t) = log(q(t − h)* q(t + h)) / 2h + Lᵀ ω_earth,      α(t) = (ω(t + h) − ω(t − h)) / 2h
    f(t) = Lᵀ (p̈ + g up) + α × r + ω × (ω × r)             at a place r in the body

Frames: n is north, up, east. A quaternion (w, x, y, z) takes vectors of the body to n.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]

DEG = np.pi / 180.0
EARTH_RATE = 7.292115e-5
STEP = 1e-4
KNOCK, KNOCK_TIME = 20.0, 4e-3
"""m/s² of a knock at its peak, and the standard deviation of the Gaussian in time, s, by which it moves the device."""
NORTH, UP, EAST = np.eye(3)


@dataclass(frozen=True, kw_only=True, slots=True)
class Handling:
    """How a device is carried: the programme, and how steadily."""

    programme: str = "hand"
    """hand, table, cube, faces, or turns: faces with a full turn about each axis after them"""
    rests: int = 30
    """Of the programme hand; the others have their own."""
    rest: float = 5.0  # s, a fifth more or less
    first_rest: float = 20.0
    turn: float = 3.0  # s, a fifth more or less
    off: float = 1.5 * DEG
    """Standard deviation by which a table or a cube misses its attitudes."""
    carried: float = 0.3  # m, from rest to rest at most, each way
    tremor: float = 0.0
    """Amplitude of rotations while the device is turned, rad; of places, m, a twentieth of it."""
    tremor_at_rest: float = 0.0
    """The same at rest, in the hand."""
    ringing: tuple[float, float, float] = (0.0, 8.0, 0.3)
    """Amplitude after a stop, rad (and a twentieth of it, m), frequency, Hz, 0 for creeping, and time constant, s."""
    knocks: int = 0
    """At any time, in any direction, of KNOCK."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Course:
    """Attitudes (R, 4) and places (R, 3) of the rests; rotation vectors (R − 1, 3) and begins (R − 1,) of the turns,
    how long they last, and begins and ends (R, 2) of the rests. Tremors are (R − 1, 3 frequencies, 3 axes) of amplitude
    and phase; `ringing` (R − 1, 3) says about which axis it rings; knocks have times (K,) and directions (K, 3).
    `faces` are the axes that point up at the rests, and the axes of full turns, where these are the programme."""

    handling: Handling
    attitudes: Array
    places: Array
    vectors: Array
    begin: Array
    lasts: Array
    rests: Array
    tremor: tuple[Array, Array, Array]
    ringing: Array
    knocks: tuple[Array, Array]
    faces: tuple[str, ...]
    latitude: float
    gravity: float

    @property
    def duration(self) -> float:
        """From the beginning of the first rest to the end of the last, s."""
        return float(self.rests[-1, 1])

    @property
    def sections(self) -> dict[str, tuple[float, float]]:
        """What an operator notes: when each face was up, half a second within, and when each full turn was made, half a
        second of rest about it."""
        out = {}
        for k, name in enumerate(self.faces):
            if name.endswith("turn"):
                out[name] = float(self.rests[k - 1, 1] - 0.5), float(self.rests[k, 0] + 0.5)
            else:
                out[name] = float(self.rests[k, 0] + 0.5), float(self.rests[k, 1] - 0.5)
        return out

    def still(self, t: Array) -> NDArray[np.bool_]:
        """Whether nothing moves at times (N,)."""
        if self.handling.tremor_at_rest:
            return np.zeros(len(t), dtype=bool)
        k = np.clip(np.searchsorted(self.begin - 2.0 * STEP, t, side="right") - 1, 0, None)
        since = t - self.begin[k] - self.lasts[k]
        rung = 0.9 * (self.rests[k + 1, 1] - self.rests[k + 1, 0]) if self.handling.ringing[0] else 0.0
        still = (t < self.begin[0] - 2.0 * STEP) | (since > rung + 2.0 * STEP)
        for knock in self.knocks[0]:
            still &= np.abs(t - knock) > 10.0 * KNOCK_TIME
        return np.asarray(still)

    def pose(self, t: Array) -> tuple[Array, Array]:
        """Quaternions (N, 4) and places (N, 3) at times (N,)."""
        k = np.clip(np.searchsorted(self.begin, t, side="right") - 1, 0, None)
        u = (t - self.begin[k]) / self.lasts[k]
        done = smooth(u)[:, None]
        handling, moved = self.handling, np.zeros((len(t), 3))
        if handling.tremor or handling.tremor_at_rest:
            amplitude, frequency, phase = (each[k] for each in self.tremor)
            within = np.clip(u, 0.0, 1.0)
            window = handling.tremor * 64.0 * (within * (1.0 - within)) ** 3 + handling.tremor_at_rest
            sinusoids = amplitude * np.sin(2.0 * np.pi * frequency * t[:, None, None] + phase)
            moved += sinusoids.sum(axis=1) * window[:, None]
        size, ringing, decay = handling.ringing
        if size:
            since = t - self.begin[k] - self.lasts[k]
            rest = self.rests[k + 1, 1] - self.rests[k + 1, 0]
            envelope = smooth(1.0 + since / 0.2) * np.exp(-np.clip(since, 0.0, None) / decay)
            envelope *= 1.0 - smooth(since / (0.9 * rest))
            to_and_fro = np.sin(2.0 * np.pi * ringing * since) if ringing else 1.0
            moved += (size * envelope * to_and_fro)[:, None] * self.ringing[k]
        q = product(self.attitudes[k], exponential(self.vectors[k] * done + moved))
        place = self.places[k] + (self.places[k + 1] - self.places[k]) * done
        for knock, way in zip(*self.knocks, strict=True):
            pulse = np.exp(-0.5 * np.clip((t - knock) / KNOCK_TIME, -12.0, 12.0) ** 2)
            place = place + KNOCK * KNOCK_TIME**2 * pulse[:, None] * way
        return q, place + 0.05 * np.roll(moved, 1, axis=1)

    def felt(self, t: Array, places: Array) -> tuple[Array, Array]:
        """Rates (N, 3) and specific forces (N, P, 3) in the body at P places in it (P, 3), at times (N,)."""
        rate, force = np.empty((len(t), 3)), np.empty((len(t), len(places), 3))
        still = self.still(t)
        earth = EARTH_RATE * (np.cos(self.latitude) * NORTH + np.sin(self.latitude) * UP)
        if still.any():
            k = np.searchsorted(self.begin, t[still], side="right")
            rate[still] = into_body(self.attitudes, earth)[k]
            force[still] = self.gravity * into_body(self.attitudes, UP)[k][:, None, :]
        moving = ~still
        if moving.any():
            at = t[moving]
            poses = [self.pose(at + j * STEP) for j in range(-2, 3)]
            spun = [logarithm(product(conjugate(poses[j - 1][0]), poses[j + 1][0])) / (2.0 * STEP) for j in (1, 2, 3)]
            w = [each + into_body(poses[j][0], earth) for j, each in zip((1, 2, 3), spun, strict=True)]
            change = (w[2] - w[0]) / (2.0 * STEP)
            acceleration = (poses[1][1] - 2.0 * poses[2][1] + poses[3][1]) / STEP**2
            at_origin = into_body(poses[2][0], acceleration + self.gravity * UP)
            rate[moving] = w[1]
            for p, place in enumerate(places):
                turned = np.cross(change, place) + np.cross(w[1], np.cross(w[1], place))
                force[moving, p] = at_origin + turned
        return rate, force


def course(handling: Handling, rng: np.random.Generator) -> Course:
    """A course of a programme, drawn anew, at a place on Earth drawn anew."""
    nominal, turns, faces = _programme(handling, rng)
    missed = nominal if handling.programme == "hand" else [
        product(product(exponential(about), q), exponential(within / 3.0))
        for q in nominal for about, within in [handling.off * rng.normal(size=(2, 3))]
    ]  # fmt: skip
    attitudes = np.array(missed)
    vectors = logarithm(product(conjugate(attitudes[:-1]), attitudes[1:]))
    for k, meant in enumerate(turns):  # half a turn either way looks alike: the one that is meant
        other = vectors[k] * (1.0 - 2.0 * np.pi / np.linalg.norm(vectors[k]))
        if meant is not None and np.linalg.norm(meant) > 1.5 * np.pi:  # a full turn ends where it began
            attitudes[k + 1], vectors[k] = attitudes[k], meant
            if k + 1 < len(vectors):
                vectors[k + 1] = logarithm(product(conjugate(attitudes[k + 1]), attitudes[k + 2]))
        elif meant is not None and np.linalg.norm(other - meant) < np.linalg.norm(vectors[k] - meant):
            vectors[k] = other
    count = len(attitudes)
    resting = handling.rest * rng.uniform(0.8, 1.2, count)
    resting[0] = handling.first_rest
    lasts = handling.turn * rng.uniform(0.8, 1.2, count - 1)
    begin = np.cumsum(resting[:-1]) + np.r_[0.0, np.cumsum(lasts)[:-1]]
    starts = np.r_[0.0, begin + lasts]
    latitude = rng.choice([-1.0, 1.0]) * rng.uniform(20.0, 60.0) * DEG
    return Course(
        handling=handling,
        attitudes=attitudes,
        places=rng.uniform(-0.5, 0.5, (count, 3)) * (handling.carried if handling.programme == "hand" else 0.0),
        vectors=vectors,
        begin=begin,
        lasts=lasts,
        rests=np.column_stack([starts, starts + resting]),
        tremor=(
            rng.normal(size=(count - 1, 3, 3)) / np.sqrt(3.0),
            rng.uniform(4.0, 10.0, (count - 1, 3, 3)),
            rng.uniform(0.0, 2.0 * np.pi, (count - 1, 3, 3)),
        ),
        ringing=unit(rng.normal(size=(count - 1, 3))),
        knocks=(rng.uniform(0.0, starts[-1], handling.knocks), unit(rng.normal(size=(handling.knocks, 3)))),
        faces=faces,
        latitude=latitude,
        gravity=normal_gravity(latitude) + 3e-4 * rng.normal(),
    )


def normal_gravity(latitude: float) -> float:
    """Of the ellipsoid GRS 80, at sea level (Somigliana)."""
    s = np.sin(latitude) ** 2
    return float(9.7803267715 * (1.0 + 0.001931851353 * s) / np.sqrt(1.0 - 0.0066943800229 * s))


def _programme(handling: Handling, rng: np.random.Generator) -> tuple[list[Array], list[Array | None], tuple[str, ...]]:
    """Nominal attitudes, the rotation vectors, in the body, of the turns of which they matter, and the axes that point
    up, x+ to z−, or are turned about, where these are faces."""
    if handling.programme == "hand":
        return list(unit(rng.normal(size=(handling.rests, 4)))), [], ()
    out: list[Array] = []
    turns: list[Array | None] = []
    if handling.programme == "table":
        for axes in (np.eye(3), np.roll(np.eye(3), 2, axis=0), np.roll(np.eye(3), 1, axis=0)):
            # columns are where X, Y, Z point: NUE, ENU, UEN
            q = _of_axes(axes)
            if out:
                turns.append(None)
            out.append(q)
            for axis, sense in ((NORTH, 1.0), (UP, 1.0), (NORTH, -1.0)):
                turns.append(sense * np.pi * into_body(q, axis))
                q = product(exponential(sense * np.pi * axis), q)
                out.append(q)
        for above, below in ((0, 1), (0, 2), (1, 2)):
            axes = np.empty((3, 3))
            axes[:, above], axes[:, below] = (NORTH + UP) / np.sqrt(2.0), (NORTH - UP) / np.sqrt(2.0)
            third = 3 - above - below
            sense = 1.0 if (above, below, third) in ((0, 1, 2), (1, 2, 0), (2, 0, 1)) else -1.0
            axes[:, third] = sense * np.cross(axes[:, above], axes[:, below])
            turns.append(None)
            out.append(_of_axes(axes))
        return out, turns, ()
    grid = [np.array([x, y, z], float) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1)]
    count = {"cube": 4, "faces": 2, "turns": 2}[handling.programme]  # how many of x, y, z may be 0 or not
    ups = [d for d in grid if 0 < np.abs(d).sum() < count]
    order = rng.permutation(len(ups))
    for i in order:
        up = unit(ups[i])
        north = np.linalg.qr(np.column_stack([up, rng.normal(size=3)]))[0][:, 1]
        out.append(_of_axes(np.stack([north, up, np.cross(north, up)])))
    faces = tuple(f"{'xyz'[np.abs(ups[i]).argmax()]}{'-+'[int(ups[i].sum() > 0.0)]}" for i in order)
    if handling.programme == "turns":
        turns, faces = [None] * (len(out) - 1), (*faces, "x turn", "y turn", "z turn")
        for axis in np.eye(3):
            turns.append(2.0 * np.pi * axis)
            out.append(out[-1])
    return out, turns, faces if handling.programme != "cube" else ()


def unit(vectors: Array) -> Array:
    """Of length 1 along the last axis."""
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))


def smooth(u: Array) -> Array:
    """From 0 to 1 without a jump of rate or acceleration."""
    u = np.clip(u, 0.0, 1.0)
    return u**3 * (10.0 - 15.0 * u + 6.0 * u**2)


def exponential(vector: Array) -> Array:
    """The quaternions (…, 4) of rotation vectors (…, 3)."""
    angle = np.linalg.norm(vector, axis=-1, keepdims=True)
    return np.concatenate([np.cos(0.5 * angle), 0.5 * np.sinc(angle / (2.0 * np.pi)) * vector], axis=-1)


def logarithm(q: Array) -> Array:
    """The rotation vectors, of at most π, of quaternions."""
    q = q * np.where(q[..., :1] < 0.0, -1.0, 1.0)
    size = np.linalg.norm(q[..., 1:], axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(size, q[..., :1])
    return np.asarray(q[..., 1:] * np.where(size > 1e-12, angle / np.where(size > 1e-12, size, 1.0), 2.0))


def conjugate(q: Array) -> Array:
    return np.asarray(q * np.array([1.0, -1.0, -1.0, -1.0]))


def product(p: Array, q: Array) -> Array:
    """The product of quaternions: q first, in the body."""
    a, b = p[..., 1:], q[..., 1:]
    scalar = p[..., :1] * q[..., :1] - (a * b).sum(axis=-1, keepdims=True)
    return np.concatenate([scalar, p[..., :1] * b + q[..., :1] * a + np.cross(a, b)], axis=-1)


def into_body(q: Array, vector: Array) -> Array:
    """Vectors of n, in the body."""
    v = -q[..., 1:]
    across = 2.0 * np.cross(v, np.broadcast_to(vector, v.shape))
    return np.asarray(vector + q[..., :1] * across + np.cross(v, across))


def _of_axes(axes: Array) -> Array:
    """The quaternion of a rotation matrix: Bar-Itzhack's eigenvector, which has no special cases."""
    m = axes
    K = np.array([
        [m[0, 0] + m[1, 1] + m[2, 2], m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]],
        [m[2, 1] - m[1, 2], m[0, 0] - m[1, 1] - m[2, 2], m[0, 1] + m[1, 0], m[0, 2] + m[2, 0]],
        [m[0, 2] - m[2, 0], m[0, 1] + m[1, 0], m[1, 1] - m[0, 0] - m[2, 2], m[1, 2] + m[2, 1]],
        [m[1, 0] - m[0, 1], m[0, 2] + m[2, 0], m[1, 2] + m[2, 1], m[2, 2] - m[0, 0] - m[1, 1]],
    ])  # fmt: skip
    return np.linalg.eigh(K)[1][:, -1]
