"""Do the accuracy formulas of the paper predict what a nonlinear simulation shows?

The simulation knows nothing of the formulas: exact sensors, Eq. (1), on a rough table; rests levelled by TRIAD;
turns integrated through the Earth's rotation at constant rate; the estimators as the paper describes them. Each of
its launches has an instrument, a mounting, a table and noise of its own. Printed are rms errors over launches and
over the parameters of a group, and the prediction of `tumble plan` beside them.

    python studies/formulas_against_simulation.py [--short]

The answer is printed last; the exit status is 1 if it is no.
"""

from __future__ import annotations

import argparse
import math
import sys
from dataclasses import dataclass, replace

import numpy as np
from accuracy_formulas import (
    axis_angle_error,
    reference_rate_error,
    scalar_scale_error,
    up_down_errors,
)

from tumble.earth import earth_rate, normal_gravity
from tumble.inference.noise import CORRELATION_TIME
from tumble.planning.itinerary import itinerary_of
from tumble.planning.pass_errors import METHODS_OF_PAPER, MethodOfPaper
from tumble.planning.plan import plan
from tumble.planning.setup import GROUPS, NAMES, Setup
from tumble.programme.positions import programme
from tumble.rotation import axes_angles, axes_matrix, rotation_matrix
from tumble.sensors.grades import Grade, NoiseModel, Spread
from tumble.sensors.parameters import usual_sizes
from tumble.units import ARCSEC, DEGREE, DEGREE_PER_HOUR, Array, IntArray

DEVICE = Grade(
    accel=Spread(bias=2e-3, scale=1e-4, axis=25.0 * ARCSEC),
    gyro=Spread(bias=0.3 * DEGREE_PER_HOUR, scale=1e-4, axis=10.0 * ARCSEC),
    noise=NoiseModel(accel_white=1e-4, gyro_white=0.003 * (DEGREE / 60.0)),
)
"""An instrument like the published one, with white noise alone."""

STEPS = 12
"""Steps of the integration of a turn, of fourth order: 15° each."""

ALLOWANCE = 0.05
"""How far a prediction of first order in table errors of some degrees may be off for the answer to be yes."""

CURVATURE = 0.1
"""The same for the errors of single estimates, where bias times bias has not averaged out."""

SIGMAS = 5.0

NOTHING = 1e-4
"""Errors below this part of the spread before calibration are not compared."""


# -------------------- the simulated launches --------------------


@dataclass(frozen=True, kw_only=True, slots=True)
class Launches:
    """T launches: true parameters (T, 21), readings at rest over N positions (T, N, 3), and the readings of the gyros
    at the Gauss nodes of the steps of K turns, `rates` (T, K, STEPS, 2, 3), rad/s. `first`, `last`, `duration` (K,) of
    the turns; `nominal` (N, 3, 3)."""

    setup: Setup
    truth: Array
    attitudes: Array
    accel: Array
    gyro: Array
    rates: Array
    first: IntArray
    last: IntArray
    duration: Array
    nominal: Array


def simulate(setup: Setup, launches: int, rng: np.random.Generator) -> Launches:
    """Launches of instruments with Gaussian parameters on tables and mountings with uniform errors."""
    a, g = setup.accel, setup.gyro
    spread = np.repeat([a.bias, a.scale, a.axis, g.bias, g.scale, g.axis], [3, 3, 3, 3, 3, 6])
    nominal = np.array([position.matrix for position in setup.programme.positions])
    table = setup.table_error * rng.uniform(-1.0, 1.0, (launches, len(nominal), 3))
    mounting = setup.mounting_error * rng.uniform(-1.0, 1.0, (launches, 1, 3))
    attitudes = rotation_matrix(table) @ nominal @ rotation_matrix(mounting)
    return readings(setup, spread * rng.standard_normal((launches, len(NAMES))), attitudes, rng)


def readings(setup: Setup, truth: Array, attitudes: Array, rng: np.random.Generator) -> Launches:
    """What instruments (T, 21) read at these true attitudes (T, N, 3, 3) and in the turns between them."""
    known = [(i, m.angle) for i, m in enumerate(setup.programme.moves) if m.angle is not None]
    first = np.array([i for i, _ in known], dtype=int)
    axis = np.array([setup.programme.moves[i].axis for i in first], dtype=float).reshape(-1, 3)
    angle = np.array([a for _, a in known], dtype=float)
    duration = np.abs(angle) / setup.turn_rate
    S_a, b_a, S_g, b_g = matrices(truth)
    up = np.swapaxes(attitudes, -1, -2) @ [0.0, 1.0, 0.0]
    earth = np.swapaxes(attitudes, -1, -2) @ np.array(earth_rate(setup.latitude))
    dwell = math.sqrt(setup.rest)
    changes = setup.noise.gyro_instability * in_run(setup, earth.shape, rng)
    accel = setup.gravity * up @ S_a.swapaxes(1, 2) + b_a[:, None]
    accel += setup.noise.accel_instability * in_run(setup, up.shape, rng)
    accel += setup.noise.accel_white / dwell * rng.standard_normal(up.shape)
    gyro = earth @ S_g.swapaxes(1, 2) + b_g[:, None] + changes
    gyro += setup.noise.gyro_white / dwell * rng.standard_normal(up.shape)
    start = attitudes[:, first]
    vector = turn_vectors(start, attitudes[:, first + 1], axis * angle[:, None])
    true = true_rates(start, vector, duration, setup.latitude)
    step = duration / STEPS
    noise = setup.noise.gyro_white / np.sqrt(step)[:, None, None] * rng.standard_normal((*true.shape[:3], 3))
    between = b_g[:, None] + 0.5 * (changes[:, first] + changes[:, first + 1])
    rates = true @ S_g[:, None, None].swapaxes(-1, -2) + between[:, :, None, None]
    return Launches(
        setup=setup,
        truth=truth,
        attitudes=attitudes,
        accel=accel,
        gyro=gyro,
        rates=rates + noise[:, :, :, None],
        first=first,
        last=first + 1,
        duration=duration,
        nominal=np.array([position.matrix for position in setup.programme.positions]),
    )


def in_run(setup: Setup, shape: tuple[int, ...], rng: np.random.Generator) -> Array:
    """In-run biases (T, N, 3) at the rests: Gauss–Markov processes of unit variance, about their means."""
    start = itinerary_of(setup).rests[:, 0]
    root = np.linalg.cholesky(np.exp(-np.abs(start[:, None] - start) / CORRELATION_TIME))
    drawn = root @ rng.standard_normal(shape)
    return np.asarray(drawn - drawn.mean(axis=1, keepdims=True))


def matrices(X: Array) -> tuple[Array, Array, Array, Array]:
    """Matrices (T, 3, 3) and biases (T, 3) of accelerometers and gyros with parameters (T, 21): the exact Eq. (1)."""
    six = np.zeros((6, len(X)))
    six[[2, 4, 5]] = X[:, 6:9].T
    accel, gyro = axes_matrix(*six), axes_matrix(*X[:, 15:21].T)
    S_a = (1.0 + X[:, 3:6])[:, :, None] * np.moveaxis(accel, 2, 0)
    S_g = (1.0 + X[:, 12:15])[:, :, None] * np.moveaxis(gyro, 2, 0)
    return S_a, X[:, :3], S_g, X[:, 9:12]


def parameters(S_a: Array, b_a: Array, S_g: Array, b_g: Array) -> Array:
    """Parameters (T, 21) of matrices and biases: `matrices` inverted."""
    out = []
    for S, b, angles in ((S_a, b_a, [2, 4, 5]), (S_g, b_g, [0, 1, 2, 3, 4, 5])):
        norms = np.linalg.norm(S, axis=2)
        six = axes_angles(np.moveaxis(S / norms[:, :, None], 0, 2))
        out += [b, norms - 1.0, six[angles].T]
    return np.concatenate(out, axis=1)


def turn_vectors(start: Array, stop: Array, nominal: Array) -> Array:
    """Rotation vectors (T, K, 3), geographic, that lead from one attitude to the other, on the side of the nominal
    ones (K, 3): Newton's method from there."""
    vector = np.broadcast_to(nominal, start.shape[:-1]).copy()
    for _ in range(5):
        left = stop @ np.swapaxes(rotation_matrix(vector) @ start, -1, -2)
        small = 0.5 * (left - np.swapaxes(left, -1, -2))
        error = np.stack([small[..., 2, 1], small[..., 0, 2], small[..., 1, 0]], axis=-1)
        vector = vector + np.linalg.solve(left_jacobian(vector), error[..., None])[..., 0]
    return vector


def left_jacobian(vector: Array) -> Array:
    """∫₀¹ exp(s [v×]) ds (..., 3, 3) of rotation vectors (..., 3)."""
    angle = np.linalg.norm(vector, axis=-1)[..., None, None]
    K = cross_matrix(vector) / angle
    return np.asarray(np.eye(3) + (1 - np.cos(angle)) / angle * K + (1 - np.sin(angle) / angle) * (K @ K))


def cross_matrix(vector: Array) -> Array:
    """[v×] (..., 3, 3)."""
    return np.cross(vector[..., None, :], np.eye(3)).swapaxes(-1, -2)


NODES = 0.5 + np.array([-1.0, 1.0]) * math.sqrt(3.0) / 6.0


def true_rates(start: Array, vector: Array, duration: Array, latitude: float) -> Array:
    """Rates in the body (T, K, STEPS, 2, 3) at the Gauss nodes of the steps of turns at constant rate: Lᵀ(n Θ̇ + Ω)."""
    s = ((np.arange(STEPS)[:, None] + NODES) / STEPS)[:, :, None]
    back = rotation_matrix(-s * vector[:, :, None, None])
    total = vector[:, :, None, None] / duration[:, None, None, None] + np.array(earth_rate(latitude))
    return np.asarray(np.einsum("tkba,tksnbc,tksnc->tksna", start, back, total))


# -------------------- the methods --------------------


@dataclass(kw_only=True)
class Found:
    """What is known of the sensors so far: matrices (T, 3, 3) and biases (T, 3)."""

    S_a: Array
    b_a: Array
    S_g: Array
    b_g: Array


def calibrate(launches: Launches, method: MethodOfPaper, iterations: int) -> list[Array]:
    """Errors (T, 21), estimated − true, after each pass of a method."""
    T = len(launches.truth)
    eye, zero = np.broadcast_to(np.eye(3), (T, 3, 3)), np.zeros((T, 3))
    found = Found(S_a=eye, b_a=zero, S_g=eye, b_g=zero)
    errors = []
    for _ in range(iterations):
        one_pass(launches, method, found)
        errors.append(parameters(found.S_a, found.b_a, found.S_g, found.b_g) - launches.truth)
    return errors


def one_pass(launches: Launches, method: MethodOfPaper, found: Found) -> None:
    """All stages on readings corrected by what is known; what they find is put on top of it, exactly."""
    accel = accelerometers_sequential if method == "sequential" else accelerometers_scalar
    w = corrected(launches.accel, found.S_a, found.b_a)
    S, b = accel(launches, w)
    found.b_a = found.b_a + (found.S_a @ b[..., None])[..., 0]
    found.S_a = found.S_a @ S
    w = corrected(launches.accel, found.S_a, found.b_a)
    ω = corrected(launches.gyro, found.S_g, found.b_g)
    bias = bias_vertical(launches, w, ω)
    found.b_g = found.b_g + (found.S_g @ bias[..., None])[..., 0]
    if len(launches.first):
        found.S_g = np.asarray(found.S_g @ gyro_matrices(launches, found, w, ω - bias[:, None]))


def corrected(values: Array, S: Array, b: Array) -> Array:
    """Readings (T, N, 3) corrected by matrices (T, 3, 3) and biases (T, 3)."""
    return np.asarray(np.linalg.solve(S[:, None], (values - b[:, None])[..., None])[..., 0])


def accelerometers_sequential(launches: Launches, w: Array) -> tuple[Array, Array]:
    """Eqs. (3), (4) on all rests with an axis up or down, levelled by TRIAD, then (10) and (2)."""
    g = launches.setup.gravity
    nominal = launches.nominal[:, 1]
    unit = w / np.linalg.norm(w, axis=-1, keepdims=True)
    X = np.zeros((len(w), len(NAMES)))
    for p in range(3):
        rests = np.abs(nominal[:, p]) > 0.9
        c, r = unit[:, rests, p], w[:, rests, p]
        dc, dr = c - c.mean(1, keepdims=True), r - r.mean(1, keepdims=True)
        slope = (dc * dr).sum(1) / (dc**2).sum(1)
        X[:, 3 + p], X[:, p] = slope / g - 1.0, r.mean(1) - slope * c.mean(1)
    w = (w - X[:, None, :3]) / (1.0 + X[:, None, 3:6])
    φ = []
    for p, q in PAIRS:
        (rest,) = np.flatnonzero(np.abs(nominal[:, p] * nominal[:, q]) > 0.4)
        φ.append(angle_by_eq_10(w[:, rest], p, q, g))
    X[:, 6], X[:, 7] = 0.5 * np.pi - φ[0], 0.5 * np.pi - φ[1]
    sine = np.cos(φ[2]) - np.sin(X[:, 6]) * np.sin(X[:, 7])
    X[:, 8] = np.arcsin(sine / (np.cos(X[:, 6]) * np.cos(X[:, 7])))
    return matrices(X)[:2]


def angle_by_eq_10(w: Array, p: int, q: int, g: float) -> Array:
    """Angle (T,) between the axes p, above, and q, below the horizon, from readings (T, 3)."""
    across = np.sqrt(g**2 - w[:, 3 - p - q] ** 2)
    return np.asarray(np.arccos(w[:, q] / across) - np.arccos(w[:, p] / across))


def accelerometers_scalar(launches: Launches, w: Array) -> tuple[Array, Array]:
    """Eqs. (12), (13) on all rests with the estimated orientation."""
    g = launches.setup.gravity
    u = w / np.linalg.norm(w, axis=-1, keepdims=True)
    x, y, z = np.moveaxis(u, -1, 0)
    H = np.stack([x, y, z, x * x, y * y, z * z, x * y, x * z, y * z], axis=-1)
    Z = ((w**2).sum(-1) - g**2) / (2.0 * g**2)
    X = np.zeros((len(w), len(NAMES)))
    X[:, :9] = (np.linalg.pinv(H) @ Z[..., None])[..., 0]
    X[:, :3] *= g
    return matrices(X)[:2]


def triad(w: Array, ω: Array) -> Array:
    """Attitudes body → geographic (..., 3, 3), rows N, U, E: the vertical is the base vector."""
    up = w / np.linalg.norm(w, axis=-1, keepdims=True)
    east = np.cross(ω, up)
    east = east / np.linalg.norm(east, axis=-1, keepdims=True)
    return np.stack([np.cross(up, east), up, east], axis=-2)


def bias_vertical(launches: Launches, w: Array, ω: Array) -> Array:
    """Vector method: each gyro where it is vertical."""
    shown = ω - np.swapaxes(triad(w, ω), -1, -2) @ np.array(earth_rate(launches.setup.latitude))
    vertical = np.abs(launches.nominal[:, 1]) > 0.9
    return np.stack([shown[:, vertical[:, p], p].mean(1) for p in range(3)], axis=1)


def gyro_matrices(launches: Launches, found: Found, w: Array, ω: Array) -> Array:
    """Indirect method: matrices (T, 3, 3) of what is left in the gyros, with the table of §6.3."""
    y = differences(launches, w, ω, integrated(launches, found))
    X = np.zeros((len(w), len(NAMES)))
    X[:, 12:] = (np.linalg.pinv(PROGRAMME_MATRIX) @ y[..., None])[..., 0]
    return matrices(X)[2]


def integrated(launches: Launches, found: Found) -> Array:
    """Rotations C (T, K, 3, 3), body at the end → at the start, non-rotating, by Magnus steps of fourth order."""
    inverse = np.linalg.inv(found.S_g)[:, None]
    T, K = launches.rates.shape[:2]
    C = np.broadcast_to(np.eye(3), (T, K, 3, 3))
    h = (launches.duration / STEPS)[:, None]
    for s in range(STEPS):
        first = (inverse @ (launches.rates[:, :, s, 0] - found.b_g[:, None])[..., None])[..., 0]
        second = (inverse @ (launches.rates[:, :, s, 1] - found.b_g[:, None])[..., None])[..., 0]
        φ = 0.5 * h * (first + second) + math.sqrt(3.0) / 12.0 * h**2 * np.cross(first, second)
        C = C @ rotation_matrix(φ)
    return np.asarray(C)


def differences(launches: Launches, w: Array, ω: Array, C: Array) -> Array:
    """y (T, 2K): attitude by TRIAD at the start of a series, held in rests, carried through turns."""
    earth = np.array(earth_rate(launches.setup.latitude))
    y, L = [], np.empty(0)
    for t, (i, j) in enumerate(zip(launches.first, launches.last, strict=True)):
        if t == 0 or i != launches.last[t - 1]:
            L = triad(w[:, i], ω[:, i])
        after = rotation_matrix(-earth * launches.duration[t]) @ L @ C[:, t]
        y.append((after @ w[:, j, :, None] - L @ w[:, i, :, None])[:, [0, 2], 0] / launches.setup.gravity)
        L = after
    return np.concatenate(y, axis=1)


PROGRAMME_TABLE = """
 0   0   0     0  0 -2  0  0  0
 pi  0   0     0  0  0  0  0  0
 0   0   0    -2  0  0  0  0  0
 0   0   0     0  0  0  0  0  2
 0   0   0     0  0 -2  0  0  0
-pi  0   0     0  0  0  0  0  0
 0   0   0     0  0  0  0  0 -2
 0   pi  0     0  0  0  0  0  0
 0   0   0     0  0  0 -2  0  0
 0   0   0     0  2  0  0  0  0
 0   0   0     0  0  0  0  0 -2
 0  -pi  0     0  0  0  0  0  0
 0   0   0     0 -2  0  0  0  0
 0   0   pi    0  0  0  0  0  0
 0   0   0     0  0  0  0 -2  0
 0   0   0     0  0  2  0  0  0
 0   0   0     0 -2  0  0  0  0
 0   0  -pi    0  0  0  0  0  0
"""
"""The table of §6.3: y_N and y_E of the nine turns against k and γ_xy, γ_xz, γ_yx, γ_yz, γ_zx, γ_zy."""

_WORTH = {"pi": math.pi, "-pi": -math.pi}
PROGRAMME_MATRIX = np.array(
    [[_WORTH.get(word) or float(word) for word in line.split()] for line in PROGRAMME_TABLE.split("\n") if line]
)


# -------------------- the question --------------------


def rms_by_group(errors: Array) -> dict[str, tuple[float, float]]:
    """Rms of each group over launches and its parameters, and the relative standard error of it."""
    out = {}
    for group in GROUPS:
        square = (errors[:, [name.startswith(group) for name in NAMES]] ** 2).mean(axis=1)
        out[group] = (math.sqrt(square.mean()), 0.5 * float(square.std() / square.mean()) / math.sqrt(len(square)))
    return out


@dataclass(frozen=True, kw_only=True, slots=True)
class Single:
    """One formula against the simulation: errors of estimates and what the formula says of them, of one shape."""

    name: str
    unit: str
    simulated: Array
    formula: Array


def single_formulas(setup: Setup, draws: int, rng: np.random.Generator) -> list[Single]:
    """Formulas that predict the error of every single estimate, at positions up to ±1.5° off (the oblique ones ±2°)."""
    nine = replace(
        setup,
        programme=programme("nine"),
        table_error=1.5 * DEGREE,
        mounting_error=0.0,
        noise=NoiseModel(),
    )
    launches = simulate(nine, draws, rng)
    X, g, L = launches.truth, setup.gravity, launches.attitudes
    b, γ, u = X[:, :3] / g, X[:, 6:9], L[:, :, 1]
    found = matrices_to_parameters(accelerometers_sequential(launches, launches.accel)) - X[:, :9]
    pairs = [up_down_errors(p, u[:, 2 * p], u[:, 2 * p + 1], b, γ) for p in range(3)]
    out = [
        Single(name="(7a) k", unit="1", simulated=found[:, 3:6], formula=np.stack([k for k, _ in pairs], 1)),
        Single(name="(7a) δw", unit="m/s^2", simulated=found[:, :3], formula=g * np.stack([w for _, w in pairs], 1)),
    ]
    S_a, b_a = matrices(X)[:2]
    oblique = rotation_matrix(2.0 * DEGREE * rng.uniform(-1.0, 1.0, (draws, 3, 3))) @ launches.nominal[6:]
    w = g * oblique[:, :, 1] @ S_a.swapaxes(1, 2) + b_a[:, None]
    lean = [angle_sums(γ, p, q, 3 - p - q) for p, q in PAIRS]
    simulated, formula = [], []
    for i, (p, q) in enumerate(PAIRS):
        r = 3 - p - q
        up = oblique[:, i, 1]
        turn = np.arctan2(-up[:, q], up[:, p]) - 0.25 * np.pi
        axes = S_a / np.linalg.norm(S_a, axis=2, keepdims=True)
        angle = np.arccos((axes[:, p] * axes[:, q]).sum(1))
        simulated.append(angle_by_eq_10(w[:, i], p, q, g) - angle)
        formula.append(axis_angle_error(np.arcsin(up[:, r]), turn, b[:, [p, q, r]], X[:, [3 + p, 3 + q]], lean[i]))
    out.append(Single(name="(11) φ", unit="rad", simulated=np.stack(simulated, 1), formula=np.stack(formula, 1)))
    exact = readings(nine, X, np.broadcast_to(launches.nominal, L.shape), rng)
    found = matrices_to_parameters(accelerometers_scalar(exact, exact.accel)) - X[:, :9]
    whole = scalar_scale_error(b, X[:, 3:6], γ)
    out.append(Single(name="(15) k, whole", unit="1", simulated=found[:, 3:6], formula=whole))
    accel_error = launches.accel / g - u
    earth = np.array(earth_rate(setup.latitude))
    true = np.swapaxes(L, -1, -2) @ earth
    shown = np.swapaxes(triad(launches.accel, launches.gyro), -1, -2) @ earth - true
    by_16 = reference_rate_error(L, accel_error, launches.gyro - true, setup.latitude)
    up_and_down = [(2 * p + i, p) for p in range(3) for i in (0, 1)]
    simulated, formula = ([v[:, i, p] for i, p in up_and_down] for v in (shown, by_16))
    out.append(
        Single(name="(16) vertical", unit="rad/s", simulated=np.stack(simulated, 1), formula=np.stack(formula, 1))
    )
    return out


PAIRS = ((0, 1), (0, 2), (1, 2))


def matrices_to_parameters(model: tuple[Array, Array]) -> Array:
    """Parameters (T, 9) of accelerometers."""
    return parameters(*model, *model)[:, :9]


def angle_sums(γ: Array, p: int, q: int, r: int) -> Array:
    """Γ_rp, Γ_rq (T, 2) of γ_yx, γ_zx, γ_zy."""
    Γ = np.zeros((len(γ), 3, 3))
    Γ[:, [1, 2, 2], [0, 0, 1]] = γ
    Γ = Γ + Γ.swapaxes(1, 2)
    return np.stack([Γ[:, r, p], Γ[:, r, q]], axis=1)


SHOWN = {"m/s^2": (1e-6, "µm/s²"), "1": (1e-6, "ppm"), "rad": (ARCSEC, "″"), "rad/s": (DEGREE / 3600.0, "°/h")}


def compare(title: str, setup: Setup, launches: int, seed: int) -> list[float]:
    """Print predicted and simulated rms errors; return how far apart their logarithms are beyond chance."""
    simulated = simulate(setup, launches, np.random.default_rng(seed))
    print(f"\n{title}: {launches} launches")
    print("  method      pass  group         predicted   simulated  unit    ratio    the largest source")
    off = []
    for method in METHODS_OF_PAPER:
        predicted = plan(setup, method=method, iterations=2)
        given = {row.group for row in predicted.groups}
        for iteration, errors in enumerate(calibrate(simulated, method, 2), start=1):
            for group, (rms, u) in rms_by_group(errors).items():
                row = predicted.group(group, iteration) if group in given else None
                if row is None or row.u / row.spread < NOTHING:
                    continue  # nothing to speak of is left
                size, unit = SHOWN[row.unit]
                ratio = rms / row.u
                off.append(max(abs(math.log(ratio)) - SIGMAS * u, 0.0))
                numbers = f"{row.u / size:10.4g}  {rms / size:10.4g}  {unit:<6} {ratio:6.3f}"
                print(f"  {method:<11} {iteration}     {group:<12} {numbers}    {row.largest}")
    return off


def required(setup: Setup, launches: int) -> list[float]:
    """Print whether the set-up that a plan asks for gives what was wanted; return by how much it does not, beyond
    chance, in logarithms."""
    wanted = {"accel.scale": 3.5e-6, "accel.bias": 5e-5, "gyro.axis": 1.0 * ARCSEC}
    needs = plan(setup, method="sequential", iterations=1, wanted=wanted).requirements
    table = min(row.table_error or math.inf for row in needs)
    mounting = min(row.mounting_error or math.inf for row in needs)
    rest = max(row.rest for row in needs)
    met = replace(setup, table_error=table, mounting_error=mounting, rest=rest)
    simulated = rms_by_group(calibrate(simulate(met, launches, np.random.default_rng(5)), "sequential", 1)[0])
    print(f"\nrequired: table and mounting ±{table / DEGREE:.3f}°, rests of {rest:.0f} s")
    off = []
    for group, value in wanted.items():
        rms, u = simulated[group]
        print(f"  {group:<12} wanted {value:.3g}, simulated {rms:.3g}")
        off.append(max(math.log(rms / value) - SIGMAS * u, 0.0))
    return off


def print_single(setup: Setup, draws: int) -> float:
    """Print single formulas and return the largest part of an error that one does not explain."""
    print(f"\nsingle estimates: {draws} draws\n  formula         rms error   rms (simulation − formula)")
    unexplained = []
    for single in single_formulas(setup, draws, np.random.default_rng(6)):
        size, unit = SHOWN[single.unit]
        error = math.sqrt((single.simulated**2).mean())
        left = math.sqrt(((single.simulated - single.formula) ** 2).mean())
        unexplained.append(left / error)
        print(f"  {single.name:<14} {error / size:10.4g}   {left / size:10.4g} {unit:<5} {100 * left / error:6.2f} %")
    return max(unexplained)


def main(arguments: list[str]) -> int:
    """Ask the question and answer it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--short", action="store_true", help="fewer launches")
    launches = 400 if parser.parse_args(arguments).short else 4000
    latitude = 56.84 * DEGREE
    setup = Setup(
        latitude=latitude,
        gravity=normal_gravity(latitude, 270.0),
        gravity_u=0.0,
        clock_u=0.0,
        noise=DEVICE.noise,
        accel=DEVICE.accel,
        gyro=DEVICE.gyro,
        further=dict.fromkeys(usual_sizes("navigation"), 0.0),
    )
    silent = replace(setup, noise=NoiseModel())
    nine = replace(silent, programme=programme("nine"), table_error=1.5 * DEGREE, mounting_error=0.0)
    unexplained = print_single(setup, 5 * launches)
    off = compare("rough-table ±1°, mounting ±1°, 60 s, noise", setup, launches, 1)
    off += compare("the same without noise", silent, launches, 2)
    off += compare("nine positions ±1.5°, without noise", nine, launches, 3)
    off += required(setup, launches)
    furthest = math.exp(max(off)) - 1.0
    answer = "yes" if furthest < ALLOWANCE and unexplained < CURVATURE else "no"
    print(
        f"\nDo the formulas predict the simulation? {answer}: single errors to {100 * unexplained:.1f} %, rms errors "
        f"beyond {SIGMAS:g} standard errors of the simulation to {100 * furthest:.1f} %."
    )
    return 0 if answer == "yes" else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
