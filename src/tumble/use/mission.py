"""What a calibration means for a vehicle: errors of heading, tilt and position along a trajectory without aid, with
what contributes, before and after calibration.

The navigator integrates what corrected readings say in the navigation frame n (N, U, E) from a start that is known, or
levelled by its accelerometers. Its attitude Ĉ = (1 + [φ×]) C is turned from the true one by φ, its velocity and
position are v + δv and r + δr. With ω_ie the Earth's rate, ω_en = M v the transport rate, ω_in their sum, f the
specific force in n, and δf and δω what corrected readings are off by in the body, the mechanisation

    C' = C [ω_ib×] − [ω_in×] C,    v' = C f_b + g − (2 ω_ie + ω_en) × v,    r' = v

gives to first order (Groves, Principles of GNSS, Inertial, and Multisensor Integrated Navigation Systems, 2013, 14.2)

    φ'  = −ω_in × φ − M δv − ∂ω_in/∂r δr + C δω                                                                 (1)
    δv' = φ × f − (2 ω_ie + ω_en) × δv + v × (M δv + ∂(2 ω_ie + ω_en)/∂r δr) + (2 g/R) δr_U e_U + C δf           (2)
    δr' = δv + ∂v/∂r δr                                                                                         (3)

M δv in (1) and φ × f in (2) swing the horizontal errors with the period of Schuler, 84 min; δr_U e_U in (2) lets the
height run away, e-fold in ten minutes. ∂v/∂r is that of north and east in metres on a curved Earth.

Errors of readings are linear in what makes them: δf = S⁻¹ Σ ∂K/∂θ β(f, ω) δθ of the parameters θ (`Instrument`), a
Gauss–Markov process ξ' = −ξ/τ + white noise for every in-run bias, and white noise. So are (1) to (3), and x =
(φ, δv, δr) is a sum over sources, each of which is propagated by itself, in steps over which F is constant:

    parameters         X ← Φ X + Γ J,  covariance X Σ Xᵀ            noise, in-run bias   P ← A P Aᵀ + Q of (x, ξ)

Φ = 1 + F h + F² h²/2 with F, C, f and ω at the middle of the step, Γ = (1 + F h/2) G h. Σ is the covariance of the
calibration and, of groups it does not have, what is usual for the grade; before calibration all is as usual. Parameters
are correlated: of the variance x_i² a group g has the part (X_g (Σ Xᵀ)_g)_ii, so that all parts add up; that of a group
whose errors others undo is small, or negative.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tumble.brief import Brief
from tumble.earth import EARTH_RATE, normal_gravity, radii_of_curvature
from tumble.errors import CalibrationError, InputError
from tumble.files import FilePath
from tumble.result.calibration import Calibration, calibration_from
from tumble.rotation import UP, left_inverse, rotation_matrix, rotation_vector, skew
from tumble.sensors.instrument import Instrument, functions, measured_by
from tumble.sensors.parameters import THERMAL, group_name, group_of, within_kind
from tumble.units import DEGREE, Array, IntArray
from tumble.use.error_sources import SensorNoise, calibrated, derivative, in_motion, noise_of
from tumble.use.trajectory import STEP, Trajectory, trajectory_of
from tumble.usual_setup import HEIGHT, LATITUDE_DEG

QUANTITIES = {"heading": "rad", "tilt": "rad", "position": "m", "height": "m"}
"""What is known of x, with SI units: the rotation about the vertical; that about both horizontal axes, and the way off
in both horizontal directions, each as the root of the sum of both variances; the error of the height."""
_OF_STATE = np.zeros((4, 9))
_OF_STATE[0, 1] = _OF_STATE[1, [0, 2]] = _OF_STATE[2, [6, 8]] = _OF_STATE[3, 7] = 1.0
ATTITUDE, VELOCITY, POSITION = slice(0, 3), slice(3, 6), slice(6, 9)
"""Where φ, δv and δr stand in x, each N, U, E."""

MARKS = (10.0, 60.0, 600.0)
"""s, after which errors are stated, beside the end."""
POINTS = 60
"""Times of the curve, evenly in the logarithm."""
LINEAR = 0.2
"""rad, of a heading error beyond which the first order is an order of magnitude."""
_SINGLE = (
    "white noise of the accelerometers",
    "white noise of the gyros",
    "in-run bias of the accelerometers",
    "in-run bias of the gyros",
    "from power-on to power-on",
)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False, repr=False)
class Mission(Brief):
    """Standard uncertainties of the QUANTITIES over a trajectory, SI: `before` and `after` calibration (T, 4) at
    `times` (T,), s, of which the `marks` are for tables. Of `sources`, in words, `before_parts` and `after_parts`
    (S, T, 4) add up to the variances. `covariance` (T, 9, 9) is that of the errors of attitude, velocity and position
    (N, U, E) after calibration; `remarks` say what was assumed."""

    serial: str
    trajectory: str
    grade: str
    times: Array
    marks: tuple[int, ...]
    before: Array
    after: Array
    sources: tuple[str, ...]
    before_parts: Array
    after_parts: Array
    covariance: Array
    remarks: tuple[str, ...]


def mission(
    calibration: Calibration | FilePath,
    trajectory: FilePath = "car",
    *,
    grade: str | None = None,
    temperature_change: float = 0.0,
    levelled: bool = False,
    latitude_deg: float | None = None,
    forward: str = "x",
    up: str = "z",
) -> Mission:
    """Errors of heading, tilt and position over a trajectory, by a calibration of accelerometers and gyros.

    The trajectory is built in ("standing", "car", "quadrotor") or the user's own file (`trajectory.from_file`). The
    sensors are warmer by `temperature_change`, K, than the calibration's reference; `levelled` takes the tilt at the
    start from the accelerometers, else the start is known. `forward` and `up` are the axes of the body that point so in
    the vehicle; the `grade` says what is usual, by default that which the noise is nearest to.

    Raises CalibrationError for a calibration without covariance, and InputError for what is no trajectory.

    >>> import tumble
    >>> folder = tumble.simulate_session("session", tumble.Setup.of(grade="mems", positions=12), seed=1)
    >>> found = tumble.mission(tumble.calibrate(folder), "car")
    >>> found.trajectory, found.times[list(found.marks)].tolist()
    ('car', [10.0, 60.0])
    """
    given = calibration_from(calibration).in_frame("accelerometer")
    if given.accel is None or given.gyro is None or given.covariance is None:
        raise CalibrationError(f"{given.serial}: expected accelerometers and gyros with a covariance, found others")
    latitude = LATITUDE_DEG * DEGREE if given.site is None or given.site.latitude is None else given.site.latitude
    latitude = latitude if latitude_deg is None else latitude_deg * DEGREE
    if not abs(latitude) < 89.0 * DEGREE:
        raise InputError(f"latitude: expected one that leaves a north, within ±89°, found {latitude / DEGREE:g}°")
    height = HEIGHT if given.site is None else given.site.height
    flown = trajectory_of(trajectory, latitude, height, forward, up)

    name, noise, remarks = noise_of(given, grade)
    blocks = given.compensator.accel, given.compensator.gyro
    instrument = Instrument.of(*blocks, variables=("temperature", "temperature²", "hysteresis"))
    sources: dict[str, list[int]] = {}
    for i, each in enumerate(instrument.names):
        sources.setdefault(_source(each), []).append(i)
    usual = np.diag([group_of(each).usual.get(name, 0.0) ** 2 for each in instrument.names])
    covariance, turned_on = calibrated(given, instrument.names, usual)

    last = len(flown.position) - 1
    marks = sorted({round(mark / STEP) for mark in (*MARKS, flown.duration) if mark <= flown.duration})
    at = np.unique([*marks, *np.geomspace(min(1.0 / STEP, last), last, POINTS).round().astype(int)])
    values = np.array([given[each].value if each in given else 0.0 for each in instrument.names])
    D = derivative(instrument, values, temperature_change)
    X, P = _propagated(flown, instrument, values, D, noise, levelled, at)

    random = np.diagonal(P, axis1=-2, axis2=-1)[..., :9]
    parts = {}
    for which, C, on in (("before", usual, 0.0 * turned_on), ("after", covariance, turned_on)):
        by_parameter = X * (X @ C)
        by_source = [by_parameter[..., each].sum(axis=-1) for each in sources.values()]
        parts[which] = np.stack([*by_source, *random, np.sum(X * (X @ on), axis=-1)]) @ _OF_STATE.T
    after = P.sum(axis=0)[:, :9, :9] + X @ (covariance + turned_on) @ np.swapaxes(X, 1, 2)

    moving = X.any(axis=(0, 1)) & (np.diag(usual) > 0.0)
    if missing := {
        group_name(n) for n, moves in zip(instrument.names, moving, strict=True) if moves and n not in given
    }:
        remarks.append(f"not in the calibration, and as usual after it, too: {', '.join(sorted(missing))}")
    if not turned_on.any():
        remarks.append("what another power-on changes is not in it: a calibration of several launches knows that")
    if np.sqrt(parts["before"].sum(axis=0)[-1, 0]) > LINEAR:
        remarks.append("before calibration the errors are beyond what is linear: their order of magnitude alone holds")
    return Mission(
        serial=given.serial,
        trajectory=flown.name,
        grade=name,
        times=at * STEP,
        marks=tuple(np.searchsorted(at, marks).tolist()),
        before=np.sqrt(parts["before"].sum(axis=0)),
        after=np.sqrt(parts["after"].sum(axis=0)),
        sources=(*sources, *_SINGLE),
        before_parts=parts["before"],
        after_parts=parts["after"],
        covariance=after,
        remarks=tuple(remarks),
    )


def _source(parameter: str) -> str:
    """What the table of parts calls a parameter: those whose errors undo each other wherever it points stand together,
    and so do all changes with temperature."""
    group = group_of(parameter)
    kind = "accelerometers" if group.kind == "accel" else "gyros"
    if group.variable in (*THERMAL, "hysteresis"):
        return f"temperature of the {kind}"
    if within_kind(group.name) in ("scale", "quadratic", "cubic", "asymmetry"):
        return f"scale factors and nonlinearity of the {kind}"
    return group.words


def earth_and_transport(latitude: Array, height: Array) -> tuple[Array, Array, Array]:
    """The Earth's rate (K, 3), rad/s, the matrices M (K, 3, 3), 1/m, of the transport rate M v, and the radius of the
    meridian (K,), m, at heights over the ellipsoid."""
    along, across = (radius + height for radius in radii_of_curvature(latitude))
    zero, M = np.zeros_like(latitude), np.zeros((len(latitude), 3, 3))
    M[:, 0, 2], M[:, 1, 2], M[:, 2, 0] = 1.0 / across, np.tan(latitude) / across, -1.0 / along
    return EARTH_RATE * np.column_stack([np.cos(latitude), np.sin(latitude), zero]), M, along


def error_dynamics(latitude: Array, height: Array, v: Array, force: Array) -> Array:
    """F (K, 9, 9) of x' = F x, Eq. (1) to (3), at latitudes, rad, and heights, m, (K,), for velocities and specific
    forces (K, 3) in N, U, E."""
    ie, M, R = earth_and_transport(latitude, height)
    en = np.einsum("kij,kj->ki", M, v)
    d_ie, d_en = np.zeros((2, len(v), 3, 3))  # by δr
    d_ie[:, 0, 0], d_ie[:, 1, 0] = -ie[:, 1] / R, ie[:, 0] / R
    d_en[:, 1, 0] = M[:, 0, 2] * v[:, 2] / np.cos(latitude) ** 2 / R
    d_en[:, :, 1] = -np.abs(M[:, [0, 0, 2], [2, 2, 0]]) * en
    F = np.zeros((len(v), 9, 9))
    F[:, ATTITUDE, ATTITUDE] = -skew(ie + en)
    F[:, ATTITUDE, VELOCITY] = -M
    F[:, ATTITUDE, POSITION] = -(d_ie + d_en)
    F[:, VELOCITY, ATTITUDE] = -skew(force)
    F[:, VELOCITY, VELOCITY] = skew(v) @ M - skew(2.0 * ie + en)
    F[:, VELOCITY, POSITION] = skew(v) @ (2.0 * d_ie + d_en)
    F[:, 4, 7] += 2.0 * normal_gravity(float(latitude[0]), float(height[0])) / R
    F[:, POSITION, VELOCITY] = np.eye(3)
    F[:, 6, 6], F[:, 6, 7] = v[:, 1] / R, -v[:, 0] / R
    F[:, 8, 6] = en[:, 1]
    F[:, 8, 7], F[:, 8, 8] = -en[:, 0], v[:, 1] * M[:, 0, 2] - v[:, 0] * M[:, 1, 2]
    return F


def _propagated(
    flown: Trajectory,
    instrument: Instrument,
    values: Array,
    D: Array,
    noise: list[SensorNoise],
    levelled: bool,
    at: IntArray,
) -> tuple[Array, Array]:
    """X (T, 9, m), and P (4, T, 15, 15) of white noise and in-run bias of accelerometers and gyros, after so many
    steps (T,)."""
    h, accel, gyro = STEP, instrument.accel, instrument.gyro
    assert gyro is not None
    turn = rotation_vector(np.swapaxes(flown.mat_nb[:-1], 1, 2) @ flown.mat_nb[1:])
    C = flown.mat_nb[:-1] @ rotation_matrix(0.5 * turn)
    r, v = (0.5 * (each[1:] + each[:-1]) for each in (flown.position, flown.velocity))
    height = flown.height + r[:, 1]
    latitude = flown.latitude + r[:, 0] / (radii_of_curvature(np.array(flown.latitude))[0] + flown.height)
    ie, M, _ = earth_and_transport(latitude, height)
    en, g = np.einsum("kij,kj->ki", M, v), normal_gravity(flown.latitude, flown.height)
    force_n = np.diff(flown.velocity, axis=0) / h + np.cross(2.0 * ie + en, v) + g * UP
    force = np.einsum("kji,kj->ki", C, force_n)
    rate = turn / h + np.einsum("kji,kj->ki", C, ie + en)
    F = h * error_dynamics(latitude, height, v, force_n)
    G = np.zeros((len(v), 9, 6))
    G[:, VELOCITY, :3] = G[:, ATTITUDE, 3:] = C
    transition, gain = np.eye(9) + F + 0.5 * F @ F, h * (G + 0.5 * F @ G)

    K = instrument.all_coefficients(values)
    onto = np.zeros((6, len(K)))
    onto[:3, : accel.size] = left_inverse(K[: accel.size, measured_by(accel)])
    onto[3:, accel.size :] = left_inverse(K[accel.size :, measured_by(gyro)])
    beta = np.concatenate([functions(accel, force, rate), functions(gyro, force, rate)], axis=1)
    motion = in_motion(instrument, force, rate)

    density = np.concatenate([each.white for each in noise]) ** 2
    spread = np.concatenate([each.in_run for each in noise]) ** 2
    of_kind = np.arange(len(K)) >= accel.size
    steps = np.zeros((4, len(v), 15, 15))
    P, A = np.zeros((4, 15, 15)), np.zeros((len(v), 15, 15))
    A[:, :9, :9], A[:, :9, 9:] = transition, gain
    tilt = np.zeros((9, 6))  # of a start where Ĉ f̂ is upright: φ_N = -δf_E / g, φ_E = δf_N / g
    if levelled:
        tilt[0, :3], tilt[2, :3] = -C[0, 2] / g, C[0, 0] / g
    for kind in (0, 1):
        white, in_run = (onto @ np.diag(np.where(of_kind == kind, each, 0.0)) @ onto.T for each in (density, spread))
        steps[kind, :, :9, :9] = gain @ white @ np.swapaxes(gain, 1, 2) / h
        decay, own = np.exp(-h / noise[kind].time), slice(9 + 3 * kind, 12 + 3 * kind)
        A[:, own, own] = decay * np.eye(3)
        steps[2 + kind, :, 9:, 9:] = (1.0 - decay**2) * in_run
        start = np.vstack([tilt, np.eye(6)])
        P[2 + kind] = start @ in_run @ start.T
    X, out = np.zeros((9, D.shape[2])), list[tuple[Array, Array]]()
    for k in range(len(v) + 1):
        if k == at[len(out)]:
            out.append((X, P))
        if k < len(v):
            errors = onto @ ((beta[k, :, None] @ D)[:, 0] + motion[k])
            X = transition[k] @ (X if k else tilt @ errors) + gain[k] @ errors
            P = A[k] @ P @ A[k].T + steps[:, k]
    return np.array([x for x, _ in out]), np.stack([p for _, p in out], axis=1)
