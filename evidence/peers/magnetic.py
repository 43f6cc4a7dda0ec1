"""Magnetometers: by an ellipsoid, by Kok and Schön, by Huang, Hendeby and Skog.

The readings are m = D Rᵀ h + o, R the attitude (body → n, Z upwards), h = (cos δ, 0, −sin δ) the direction of the field
with the dip δ; D contains its modulus, scale factors, axes and the rotation to the inertial sensors.

Ellipsoid: Li and Griffiths as in `magneto`, of all samples; A⁻¹ symmetric, so that a rotation stays.

Kok and Schön, Magnetometer calibration using inertial sensors, IEEE Sensors Journal 16 (2016) 5679, arXiv:1601.05257.
An extended Kalman filter of the attitude, driven by the gyros, predicts accelerometers, Rᵀ g, and magnetometer; unknown
are D, o, δ, the gyros' bias and the noise of the three kinds of sensors, which make the likelihood

    ½ Σ eᵀ S⁻¹ e + ½ Σ log det S

of the predictions' errors e and their covariances S the greatest. It begins with an ellipsoid, attitudes by inertial
sensors, and the rotation with which the vertical part of the field is the same throughout. No uncertainties.

Huang, Hendeby and Skog, Joint magnetometer–IMU calibration via maximum a posteriori estimation, arXiv:2505.16662: the
attitudes at equal intervals are unknowns of their own, beside D, o, δ and the biases of accelerometers and gyros; the
least sum of squares of

    (a − Rₖᵀ g − o_a)/σ_a,    (m − D Rₖᵀ h − o)/σ_m,    W log((ΔRₖ exp(J b))ᵀ Rₖᵀ Rₖ₊₁)

with ΔR of the gyros integrated between, J its derivative by the bias and W its noise. The covariance is that of the
normal equations. The noise is that of the program's example, of the magnetometer the data sheet's.

Both have 100 ms between attitudes; here all samples are averaged over these. Both neglect accelerations, the Earth's
rate, and errors of inertial sensors but for biases.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu

from evidence.case import Array, Case, Estimate, GaveUpError, Program, parameters_of
from evidence.peers import magneto

INTERVAL = 0.1
"""s between attitudes."""
DENSITIES = {"accel": 0.02, "gyro": 8.7e-4}
"""Of Huang's example, m/s²/√Hz and rad/s/√Hz."""
MAG_NOISE = 0.05
"""µT/√Hz, of the data sheet."""
STEP = 1e-5
"""By which parameters are moved for derivatives, in their sizes."""
MOST_STEPS = 30
SETTLED = 1e-3
"""Standard deviations by which no unknown moves any more, and of a likelihood that grows no more."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Averaged:
    """Means over intervals (K, 3), and the rotation vectors (K − 1, 3) of the gyros from the middle of one to that of
    the next, with the seconds between (K − 1,)."""

    accel: Array
    mag: Array
    turned: Array
    seconds: Array
    gravity: float


def averaged(case: Case, interval: float = INTERVAL) -> Averaged:
    """A recording, averaged."""
    assert case.gyro is not None
    assert case.mag is not None
    n = max(2, 2 * round(0.5 * interval * case.rate))
    count = len(case.time) // n
    dt = 1.0 / case.rate

    def means(x: Array) -> Array:
        return np.asarray(x[: n * count].reshape(count, n, 3).mean(axis=1))

    halves = case.gyro[n // 2 : n * (count - 1) + n // 2].reshape(count - 1, n, 3) * dt
    return Averaged(
        accel=means(case.accel), mag=means(case.mag), turned=rotated(halves),
        seconds=np.full(count - 1, n * dt), gravity=case.gravity,
    )  # fmt: skip


def rotated(steps: Array) -> Array:
    """The rotation vectors (K, 3) of small ones (K, n, 3) one after the other."""
    R = exponential(steps[:, 0])
    for k in range(1, steps.shape[1]):
        R = R @ exponential(steps[:, k])
    return logarithm(R)


def skew(v: Array) -> Array:
    """[v×] (…, 3, 3)."""
    out = np.zeros((*v.shape, 3))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        out[..., j, k], out[..., k, j] = -v[..., i], v[..., i]
    return out


def exponential(v: Array) -> Array:
    """The rotations (…, 3, 3) of rotation vectors (…, 3)."""
    angle = np.linalg.norm(v, axis=-1)[..., None, None]
    K = skew(v)
    half = 0.5 * np.sinc(0.5 * angle / np.pi) ** 2
    return np.asarray(np.eye(3) + np.sinc(angle / np.pi) * K + half * (K @ K))


def logarithm(R: Array) -> Array:
    """The rotation vectors (…, 3), shorter than π, of rotations."""
    twice = np.stack([R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]], axis=-1)
    cos = 0.5 * (np.trace(R, axis1=-2, axis2=-1) - 1.0)
    sin = 0.5 * np.linalg.norm(twice, axis=-1)
    angle = np.arctan2(sin, cos)
    return np.asarray(0.5 * twice * np.where(sin > 1e-9, angle / np.maximum(sin, 1e-12), 1.0)[..., None])


def upright(up: Array) -> Array:
    """An attitude (3, 3), of any heading, in which the body's `up` points upwards."""
    z = up / np.linalg.norm(up)
    x = np.cross(np.eye(3)[int(np.argmin(np.abs(z)))], z)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z])


# -------------------- the Kalman filter, of several sets of unknowns at once --------------------


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Unknowns:
    """Of B sets: D (B, 3, 3), o (B, 3), dip (B,), bias of the gyros (B, 3), and the logarithms (B, 3) of the standard
    deviations of gyros (rad/s over an interval), accelerometers and magnetometer."""

    D: Array
    o: Array
    dip: Array
    bias: Array
    noise: Array

    @property
    def flat(self) -> Array:
        """(B, 19)."""
        return np.concatenate(
            [self.D.reshape(-1, 9), self.o, self.dip[:, None], self.bias, self.noise], axis=1
        )  # fmt: skip

    @staticmethod
    def of(flat: Array) -> Unknowns:
        """The inverse."""
        return Unknowns(
            D=flat[:, :9].reshape(-1, 3, 3), o=flat[:, 9:12], dip=flat[:, 12], bias=flat[:, 13:16], noise=flat[:, 16:]
        )


def field_of(dip: Array) -> Array:
    """Its direction (…, 3)."""
    return np.stack([np.cos(dip), 0.0 * dip, -np.sin(dip)], axis=-1)


def filtered(made: Averaged, p: Unknowns, first: Array, with_mag: bool = True) -> tuple[Array, Array, Array]:
    """Errors of the predictions (K, B, 6 or 3), their covariances, and the attitudes (K, B, 3, 3)."""
    count, rows = len(p.o), 6 if with_mag else 3
    R, P = np.broadcast_to(first, (count, 3, 3)), np.broadcast_to(np.diag([1e-2, 1e-2, 1.0 if with_mag else 1e-2]),
                                                                 (count, 3, 3))  # fmt: skip
    variances = np.exp(2.0 * p.noise)
    noise = np.zeros((count, rows, rows))
    for i in range(rows):
        noise[:, i, i] = variances[:, 1 if i < 3 else 2]
    h, up = field_of(p.dip)[:, :, None], np.array([0.0, 0.0, made.gravity])[:, None]
    turns = exponential(made.turned[:, None] - p.bias * made.seconds[:, None, None])
    errors, covariances = np.empty((len(made.accel), count, rows)), np.empty((len(made.accel), count, rows, rows))
    attitudes, identity = np.empty((len(made.accel), count, 3, 3)), np.eye(3)
    for k in range(len(made.accel)):
        if k:
            R = R @ turns[k - 1]
            P = P + (variances[:, 0] * made.seconds[k - 1] ** 2)[:, None, None] * identity
        body = np.swapaxes(R, 1, 2)
        force = body @ up
        parts, H = [made.accel[k] - force[:, :, 0]], [body @ skew(up[:, 0])]
        if with_mag:
            parts.append(made.mag[k] - (p.D @ (body @ h))[:, :, 0] - p.o)
            H.append(p.D @ body @ skew(h[:, :, 0]))
        e, J = np.concatenate(parts, axis=1), np.concatenate(H, axis=1)
        PJ = P @ np.swapaxes(J, 1, 2)
        S = J @ PJ + noise
        gain = PJ @ np.linalg.inv(S)
        errors[k], covariances[k] = e, S
        R = exponential((gain @ e[:, :, None])[:, :, 0]) @ R
        P = P - gain @ np.swapaxes(PJ, 1, 2)
        P = 0.5 * (P + np.swapaxes(P, 1, 2))
        attitudes[k] = R
    return errors, covariances, attitudes


def likelihood(errors: Array, covariances: Array) -> Array:
    """½ Σ eᵀ S⁻¹ e + ½ Σ log det S, (B,)."""
    solved = np.linalg.solve(covariances, errors[..., None])[..., 0]
    return np.asarray(0.5 * (errors * solved).sum(axis=(0, 2)) + 0.5 * np.linalg.slogdet(covariances)[1].sum(axis=0))


def scoring_step(errors: Array, covariances: Array, sizes: Array) -> tuple[Array, Array]:
    """The gradient and Fisher's information of the likelihood, of predictions of the first set of unknowns and of one
    set each that is moved by a size."""
    e, S = errors[:, 0], covariances[:, 0]
    de = (errors[:, 1:] - e[:, None]) / sizes[:, None]
    dS = (covariances[:, 1:] - S[:, None]) / sizes[:, None, None]
    inverse = np.linalg.inv(S)
    y, W = np.einsum("kij,kj->ki", inverse, e), np.einsum("kij,kbjl->kbil", inverse, dS)
    gradient = np.einsum("kbi,ki->b", de, y) - 0.5 * np.einsum("ki,kbij,kj->b", y, dS, y)
    gradient += 0.5 * np.einsum("kbii->b", W)
    information = np.einsum("kbi,kij,kcj->bc", de, inverse, de) + 0.5 * np.einsum("kbij,kcji->bc", W, W)
    return gradient, information


# -------------------- where both begin --------------------


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Start:
    """D, o and the dip to begin with, and the attitudes (K, 3, 3)."""

    D: Array
    o: Array
    dip: float
    attitudes: Array


def ellipsoid(mag: Array, modulus: float) -> tuple[Array, Array]:
    """D (3, 3), symmetric, which contains the modulus, and o."""
    inverse, centre = magneto.fitted(mag, modulus)
    return modulus * np.linalg.inv(inverse), centre


def start(made: Averaged, modulus: float, bias: Array) -> Start:
    """The ellipsoid, turned so that the vertical part of the field is the same throughout, in attitudes by inertial
    sensors."""
    D, o = ellipsoid(made.mag, modulus)
    inertial = Unknowns(
        D=D[None], o=o[None], dip=np.zeros(1), bias=bias[None], noise=np.log([[0.01, 0.3, 1.0]])
    )  # fmt: skip
    attitudes = filtered(made, inertial, upright(made.accel[0]), with_mag=False)[2][:, 0]
    up, seen = attitudes[:, 2], np.linalg.solve(D, (made.mag - o).T).T
    # upᵀ Q seen = c for a rotation Q: the least singular vector of the ten unknowns
    design = np.column_stack([np.einsum("ki,kj->kij", up, seen).reshape(-1, 9), -np.ones(len(up))])
    found = np.linalg.svd(design, full_matrices=False)[2][-1]
    Q = found[:9].reshape(3, 3)
    Q, c = (Q, found[9]) if np.linalg.det(Q) > 0.0 else (-Q, -found[9])
    u, size, v = np.linalg.svd(Q)
    Q, dip = u @ v, float(np.arcsin(np.clip(-c / size.mean(), -1.0, 1.0)))
    # the heading: what turns the horizontal parts to the x axis
    level = np.einsum("kij,jl,kl->ki", attitudes, Q, seen)[:, :2]
    heading = np.arctan2(level[:, 1], level[:, 0])
    turn = exponential(np.stack([0.0 * heading, 0.0 * heading, -heading], axis=1))
    return Start(D=D @ Q.T, o=o, dip=dip, attitudes=turn @ attitudes)


def quiet_bias(case: Case) -> Array:
    """What gyros read in the first second if nothing turns, else nothing."""
    assert case.gyro is not None
    first = case.gyro[case.time <= case.time[0] + 1.0]
    return first.mean(axis=0) if np.linalg.norm(first.std(axis=0)) < 0.02 else np.zeros(3)


# -------------------- Kok and Schön --------------------


def kok_schon(made: Averaged, begin: Start) -> Unknowns:
    """The unknowns of the greatest likelihood, by Fisher scoring with steps that are halved until it grows."""
    p = Unknowns(
        D=begin.D[None], o=begin.o[None], dip=np.array([begin.dip]), bias=np.zeros((1, 3)),
        noise=np.log([[0.01, 0.3, 0.3]]),
    ).flat[0]  # fmt: skip
    modulus = float(np.cbrt(np.linalg.det(begin.D)))
    sizes = STEP * np.concatenate([np.full(9, modulus), np.full(3, modulus), [1.0], np.full(3, 0.1), np.ones(3)])
    first = begin.attitudes[0]

    def predicted(p: Array) -> tuple[Array, Array]:
        every = np.vstack([p, p + np.diag(sizes)])
        return filtered(made, Unknowns.of(every), first)[:2]

    errors, covariances = predicted(p)
    least = float(likelihood(errors[:, :1], covariances[:, :1])[0])
    for _ in range(MOST_STEPS):
        gradient, information = scoring_step(errors, covariances, sizes)
        step = -np.linalg.solve(information, gradient)
        share = min(1.0, 1.0 / float(np.abs(step[16:]).max()))  # no noise grows or falls by more than e
        while share > 1e-3:
            tried = filtered(made, Unknowns.of((p + share * step)[None]), first)[:2]
            now = float(likelihood(*tried)[0])
            if np.isfinite(now) and now < least:
                break
            share *= 0.5
        else:
            return Unknowns.of(p[None])
        p, gain, least = p + share * step, least - now, now
        if gain < SETTLED:
            return Unknowns.of(p[None])
        errors, covariances = predicted(p)
    raise GaveUpError(f"the likelihood still grows after {MOST_STEPS} steps")


def estimate_kok_schon(case: Case) -> Estimate:
    """The magnetometer in the frame of the inertial sensors, and the gyros' bias."""
    assert case.mag_field is not None
    made = averaged(case)
    found = kok_schon(made, start(made, case.mag_field, quiet_bias(case)))
    return Estimate(mag=found.D[0] / case.mag_field, mag_bias=found.o[0], gyro_bias=found.bias[0])


# -------------------- Huang, Hendeby and Skog --------------------


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Joint:
    """D, o, biases of accelerometers and gyros, dip, attitudes (K, 3, 3), and the covariance (19, 19) of D, row by row,
    o, the biases and the dip."""

    D: Array
    o: Array
    accel_bias: Array
    gyro_bias: Array
    dip: float
    attitudes: Array
    covariance: Array


def huang(made: Averaged, begin: Start, bias: Array, noise: tuple[float, float, float]) -> Joint:
    """The least squares by Gauss and Newton; `noise` are the standard deviations of the means of accelerometers and
    magnetometer, and of a turn between them, SI and µT."""
    count, g = len(made.accel), np.array([0.0, 0.0, made.gravity])
    sigma_a, sigma_m, sigma_g = noise
    R, D, o = begin.attitudes, begin.D, begin.o
    x = np.concatenate([np.zeros(3), bias, [begin.dip]])
    nodes, links = np.arange(count), np.arange(count - 1)
    shared = 3 * count
    for _ in range(MOST_STEPS):
        body, h = np.swapaxes(R, 1, 2), field_of(np.array(x[6]))
        seen, turns = body @ h, exponential(made.turned - x[3:6] * made.seconds[:, None])
        off = logarithm(np.swapaxes(turns, 1, 2) @ body[:-1] @ R[1:])
        residual = np.concatenate(
            [((made.accel - body @ g - x[:3]) / sigma_a).ravel(), ((made.mag - seen @ D.T - o) / sigma_m).ravel(),
             (off / sigma_g).ravel()]
        )  # fmt: skip
        by_dip = body @ np.array([-np.sin(x[6]), 0.0, -np.cos(x[6])])
        seconds = made.seconds[:, None, None] * np.eye(3)
        blocks = [
            # rows of a kind begin at 3 K × (0, 1, 2); columns; what residuals change by
            (0, nodes, 3 * nodes, -body @ skew(g) / sigma_a),
            (0, nodes, shared + 12 + 0 * nodes, np.tile(-np.eye(3) / sigma_a, (count, 1, 1))),
            (1, nodes, 3 * nodes, -D @ body @ skew(h) / sigma_m),
            (1, nodes, shared + 0 * nodes, -np.einsum("ip,kj->kpij", np.eye(3), seen).reshape(count, 3, 9) / sigma_m),
            (1, nodes, shared + 9 + 0 * nodes, np.tile(-np.eye(3) / sigma_m, (count, 1, 1))),
            (1, nodes, shared + 18 + 0 * nodes, -(by_dip @ D.T)[:, :, None] / sigma_m),
            (2, links, 3 * links, -body[1:] / sigma_g),
            (2, links, 3 * links + 3, body[1:] / sigma_g),
            (2, links, shared + 15 + 0 * links, seconds / sigma_g),
        ]
        J = assembled(blocks, count, shared + 19)
        normal = splu((J.T @ J).tocsc())
        step = -normal.solve(J.T @ residual)
        R = exponential(step[:shared].reshape(count, 3)) @ R
        D, o, x = D + step[shared : shared + 9].reshape(3, 3), o + step[shared + 9 : shared + 12], x + step[-7:]
        covariance = normal.solve(np.eye(shared + 19)[:, shared:])[shared:]
        if np.all(np.abs(step[shared:]) < SETTLED * np.sqrt(np.diag(covariance))):
            return Joint(D=D, o=o, accel_bias=x[:3], gyro_bias=x[3:6], dip=float(x[6]), attitudes=R,
                         covariance=covariance)  # fmt: skip
    raise GaveUpError(f"the iteration has not settled after {MOST_STEPS} steps")


def assembled(
    blocks: Sequence[tuple[int, NDArray[Any], NDArray[Any], Array]], count: int, columns: int
) -> sparse.csc_array:
    """The matrix of blocks (n, 3, w): the kind of rows, their numbers, first columns, values."""
    rows, places, values = [], [], []
    for kind, number, first, block in blocks:
        shape = block.shape
        rows.append(np.broadcast_to((3 * count * kind + 3 * number)[:, None, None] + np.arange(3)[:, None], shape))
        places.append(np.broadcast_to(first[:, None, None] + np.arange(shape[2]), shape))
        values.append(block)
    flat = [np.concatenate([part.ravel() for part in parts]) for parts in (values, rows, places)]
    return sparse.csc_array((flat[0], (flat[1], flat[2])), shape=(9 * count - 3, columns))


def estimate_huang(case: Case) -> Estimate:
    """The magnetometer in the frame of the inertial sensors, biases of these, and u."""
    assert case.mag_field is not None
    made, bias = averaged(case), quiet_bias(case)
    each = float(made.seconds[0])
    noise = DENSITIES["accel"] / np.sqrt(each), MAG_NOISE / np.sqrt(each), DENSITIES["gyro"] * np.sqrt(each)
    found = huang(made, start(made, case.mag_field, bias), bias, noise)
    estimate = Estimate(
        accel_bias=found.accel_bias, gyro_bias=found.gyro_bias, mag=found.D / case.mag_field,
        mag_bias=found.o,
    )  # fmt: skip
    u = np.sqrt(np.diag(found.covariance))
    stated = {f"{kind}.bias.{axis}": float(u[at + i]) for kind, at in (("mag", 9), ("accel", 12), ("gyro", 15))
              for i, axis in enumerate("xyz")}  # fmt: skip
    stated |= of_matrix(estimate, found.covariance[:9, :9] / case.mag_field**2)
    return replace(estimate, u=stated, expanded={name: 1.96 * value for name, value in stated.items()})


def of_matrix(estimate: Estimate, covariance: Array) -> dict[str, float]:
    """u of scale factors and angles, of the covariance (9, 9) of the matrix."""
    assert estimate.mag is not None
    step, here = 1e-6, parameters_of(estimate)
    names = [name for name in here if name.startswith(("mag.scale", "mag.axis"))]
    rows = []
    for k in range(9):
        moved = parameters_of(replace(estimate, mag=estimate.mag + step * np.eye(9)[k].reshape(3, 3)))
        rows.append([(moved[name] - here[name]) / step for name in names])
    J = np.array(rows).T
    return {name: float(u) for name, u in zip(names, np.sqrt(np.diag(J @ covariance @ J.T)), strict=True)}


def estimate_ellipsoid(case: Case) -> Estimate:
    """The magnetometer in a frame of its own."""
    assert case.mag is not None
    assert case.mag_field is not None
    D, o = ellipsoid(case.mag, case.mag_field)
    return Estimate(mag=D / case.mag_field, mag_bias=o)


ELLIPSOID = Program(
    name="ellipsoid", needs=frozenset({"magnetometer"}), estimate=estimate_ellipsoid, source="Li and Griffiths 2004"
)
KOK_SCHON = Program(
    name="Kok and Schön",
    needs=frozenset({"magnetometer", "gyro", "accel"}),
    estimate=estimate_kok_schon,
    source="Kok and Schön, IEEE Sensors Journal 16 (2016) 5679; arXiv:1601.05257",
)
HUANG = Program(
    name="Huang and others",
    needs=frozenset({"magnetometer", "gyro", "accel"}),
    estimate=estimate_huang,
    source="Huang, Hendeby and Skog, arXiv:2505.16662",
)
