"""Moments of turns against their plain twin; columns against finite differences of the kernel and of a simulator."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tests.support import naive_moments
from tests.support.preintegrated import moments_of
from tumble.reduction.turns.moment_kernels import GROUP
from tumble.reduction.turns.moments import (
    NO_OWN_AXES,
    BlockCompensation,
    Compensation,
    Moments,
    OwnAxes,
    Pieces,
    delay_column,
    growing_moments,
    integrate,
    integrate_in_parts,
    lever_columns,
    single_delay_columns,
)
from tumble.rotation import rotation_vector, skew
from tumble.sensors.model import Block, SensorModel
from tumble.units import Array, IntArray

TRIAD = np.eye(3)
TETRAD = np.array([[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]]) / np.sqrt(3.0)
SIX = np.array([[1.0, 0, 0], [0, 1, 0], [0, 0, 1], [0.8, 0.6, 0], [0, 0.8, 0.6], [0.6, 0, 0.8]])
ARRAYS = {"triad": TRIAD, "tetrad": TETRAD, "six": SIX}
DEGREE = np.pi / 180.0

# Random samples --------------------------------------------------------------------------------------------------


def wandering(rng: np.random.Generator, samples: int, largest: float = 1.0) -> tuple[Array, Array, Array]:
    """Rates up to `largest` rad/s and forces about 10 m/s² that wander, over uneven intervals."""
    steps = np.cumsum(rng.standard_normal((samples, 6)), axis=0) / np.sqrt(samples + 1.0)
    values = np.tanh(steps + 0.3 * rng.standard_normal((samples, 6)))
    return largest * values[:, :3], 10.0 * values[:, 3:], 0.01 * (1.0 + 0.1 * rng.random(samples))


def some_compensation(rng: np.random.Generator, axes: Array = TRIAD, *, plain: bool = False) -> Compensation:
    """Errors of the size of MEMS; without nonlinear terms, g-sensitivity and delay where `plain`."""

    def block(bias: float, size: Array) -> BlockCompensation:
        model = SensorModel(
            matrix=axes + 5e-3 * rng.standard_normal(axes.shape), bias=bias * rng.standard_normal(len(axes))
        )
        return BlockCompensation.of(axes, model, size * rng.standard_normal((len(axes), 3)))

    size = 0.0 if plain else 1.0
    return Compensation(
        gyro=block(0.01, size * np.array([0.0, 0.0, 1e-3])),
        accel=block(0.1, size * np.array([5e-5, 1e-6, 1e-3])),
        g_sensitivity=size * 2e-4 * rng.standard_normal((3, 3)),
        delay=size * 4e-3,
    )


def pieces_of(samples: tuple[Array, Array, Array], starts: IntArray, stops: IntArray) -> Pieces:
    return Pieces(
        rates=samples[0],
        forces=samples[1],
        intervals=samples[2],
        turn=np.arange(len(starts)),
        start=starts,
        stop=stops,
    )


def ranges(*lengths: int) -> tuple[IntArray, IntArray]:
    """Starts and stops of turns of these lengths, one after the other."""
    stops = np.cumsum(np.array(lengths, dtype=np.int64))
    return stops - np.array(lengths, dtype=np.int64), stops


def assert_equal(found: Moments, expected: Moments, tolerance: float) -> None:
    """Every array to `tolerance` of its largest number of the turn."""
    for f in fields(Moments):
        ours, theirs = getattr(found, f.name), getattr(expected, f.name)
        assert ours.shape == theirs.shape, f.name
        axes = tuple(range(1, theirs.ndim))
        scale = np.abs(theirs).max(axis=axes, initial=1e-3, keepdims=True)
        assert np.abs((ours - theirs) / scale).max(initial=0.0) <= tolerance, f.name


# The kernel and its twin -------------------------------------------------------------------------------------------

lengths = st.lists(
    st.one_of(
        st.integers(0, 40),
        st.sampled_from([GROUP - 1, GROUP, GROUP + 1, 2 * GROUP, 500, 1007]),
    ),
    min_size=1,
    max_size=35,
).filter(lambda values: sum(values) <= 1500)


@settings(max_examples=8, deadline=None)
@given(
    lengths=lengths,
    seed=st.integers(0, 2**32 - 1),
    largest=st.sampled_from([1e-4, 1.0, 20.0]),
    plain=st.booleans(),
    array=st.sampled_from(sorted(ARRAYS)),
)
def test_kernel_equals_the_plain_recursion(
    lengths: list[int], seed: int, largest: float, plain: bool, array: str
) -> None:
    rng = np.random.default_rng(seed)
    compensation = some_compensation(rng, ARRAYS[array], plain=plain)
    own = OwnAxes(gyro=ARRAYS[array], accel=SIX[:2]) if seed % 2 else NO_OWN_AXES
    pieces = pieces_of(wandering(rng, sum(lengths), largest), *ranges(*lengths))
    assert_equal(moments_of(pieces, compensation, own), naive_moments.moments_of(pieces, compensation, own), 1e-12)


def test_pieces_may_be_any_ranges_of_the_samples() -> None:
    rng = np.random.default_rng(1)
    pieces = pieces_of(wandering(rng, 900), np.array([400, 0, 10, 850, 7]), np.array([700, 20, 20, 900, 7]))
    compensation = some_compensation(rng)
    assert_equal(moments_of(pieces, compensation), naive_moments.moments_of(pieces, compensation), 1e-12)


def test_no_pieces_are_no_moments_and_an_empty_piece_is_no_rotation() -> None:
    rng = np.random.default_rng(2)
    samples, compensation = wandering(rng, 9), some_compensation(rng)
    none = np.empty(0, dtype=np.int64)
    assert len(moments_of(pieces_of(samples, none, none), compensation)) == 0
    found = moments_of(pieces_of(samples, np.array([4]), np.array([4])), compensation)
    np.testing.assert_array_equal(found.C, np.eye(3)[None])
    assert not found.V.any()
    assert not found.T.any()


@settings(max_examples=20, deadline=None)
@given(cuts=st.sets(st.integers(1, 2999), max_size=20), seed=st.integers(0, 2**32 - 1))
def test_pieces_of_a_turn_combine_to_the_turn(cuts: set[int], seed: int) -> None:
    rng = np.random.default_rng(seed)
    samples, compensation = wandering(rng, 3000), some_compensation(rng)
    own = OwnAxes(gyro=TRIAD, accel=TRIAD)
    edges = np.array([0, *sorted(cuts), 3000])
    whole = moments_of(pieces_of(samples, edges[:1], edges[-1:]), compensation, own)
    batches = []
    for start, stop in pairwise(edges):
        lead = min(start, 2)
        part = tuple(x[start - lead : stop] for x in samples)
        zero = np.zeros(1, dtype=np.int64)
        batches.append(replace(pieces_of((*part,), zero + lead, zero + lead + stop - start), turn=zero))  # type: ignore[arg-type]
    found = integrate(batches, 1, compensation, own)
    assert_equal(found, whole, 1e-12)


def test_batches_go_to_their_turns() -> None:
    rng = np.random.default_rng(4)
    samples, compensation = wandering(rng, 1200), some_compensation(rng)
    starts, stops = np.array([5, 300, 700]), np.array([250, 650, 1100])
    expected = moments_of(pieces_of(samples, starts, stops), compensation)
    first = replace(pieces_of(samples, starts[[2, 0]], np.array([800, 250])), turn=np.array([2, 0]))
    second = replace(pieces_of(samples, np.array([800, 300]), stops[[2, 1]]), turn=np.array([2, 1]))
    assert_equal(integrate([first, second], 3, compensation), expected, 1e-13)


def test_a_number_that_is_not_one_spoils_its_own_turn_only() -> None:
    rng = np.random.default_rng(5)
    rates, forces, intervals = wandering(rng, 20 * 50)
    compensation, starts = some_compensation(rng), 50 * np.arange(20)
    clean = moments_of(pieces_of((rates, forces, intervals), starts, starts + 45), compensation)
    forces[7 * 50 + 10] = np.nan
    found = moments_of(pieces_of((rates, forces, intervals), starts, starts + 45), compensation)
    assert np.isnan(found.V[7]).all()
    for f in fields(Moments):
        ours, theirs = (np.delete(getattr(x, f.name), 7, axis=0) for x in (found, clean))
        np.testing.assert_array_equal(ours, theirs)


def test_a_session_without_turns_has_no_moments() -> None:
    moments, C, V = integrate_in_parts([], np.zeros(0, dtype=np.int64), 32, nominal())
    Phi, Psi = growing_moments([], np.zeros(0, dtype=np.int64), nominal())
    assert (len(moments), C.shape, V.shape) == (0, (0, 33, 3, 3), (0, 33, 3))
    assert (Phi.shape, Psi.shape) == ((0, 3, 3, 13), (0, 3, 3, 7))


def test_parts_of_a_turn_make_the_turn() -> None:
    """Rotation, velocity, Φ and Ψ, whatever the number of parts, of a turn that comes in two batches."""
    rng = np.random.default_rng(8)
    whole = pieces_of(wandering(rng, 700, largest=0.4), np.array([2]), np.array([699]))
    halves = [replace(whole, stop=np.array([333])), replace(whole, start=np.array([333]))]
    expected = moments_of(whole, nominal())
    for parts in (1, 7, 32):
        moments, C, V = integrate_in_parts(halves, np.array([697]), parts, nominal())
        after = V[:, -1:] - V[:, 1:]
        Phi = np.einsum("kpij,pjmb->pimb", C[:, :-1], moments.Phi)
        Psi = np.einsum("kpij,pjmb->pimb", C[:, :-1], moments.Psi)
        Psi = Psi + np.cross(Phi[..., :7], after[0, :, :, None, None], axis=1)
        np.testing.assert_allclose(C[:, -1], expected.C, atol=1e-12)
        np.testing.assert_allclose(V[:, -1], expected.V, rtol=1e-11)
        np.testing.assert_allclose(Phi.sum(axis=0), expected.Phi[0], rtol=1e-10, atol=1e-11)
        np.testing.assert_allclose(Psi.sum(axis=0), expected.Psi[0], rtol=1e-9, atol=1e-9)


def test_growing_moments_are_what_a_bias_does_that_grows_within_a_turn() -> None:
    """To the 2 % that steps are not a line; of a turn that comes in two batches, and of one without samples."""
    rng = np.random.default_rng(6)
    rates, forces, intervals = wandering(rng, 1300, largest=0.4)
    plain = nominal()
    whole = pieces_of((rates, forces, intervals), np.array([2, 700, 1300]), np.array([650, 1300, 1300]))
    halves = [
        replace(whole, turn=np.array([0, 1]), start=np.array([2, 700]), stop=np.array([300, 1000])),
        replace(whole, turn=np.array([0, 1]), start=np.array([300, 1000]), stop=np.array([650, 1300])),
    ]
    Phi, Psi = growing_moments(halves, whole.stop - whole.start, plain)
    assert not Phi[2].any()
    assert not Psi[2].any()
    growth, step = np.zeros((1300, 1)), 1e-5
    for start, stop in ((2, 650), (700, 1300)):
        time = np.cumsum(intervals[start:stop]) - 0.5 * intervals[start:stop]
        growth[start:stop, 0] = time - 0.5 * intervals[start:stop].sum()
    for j, axis in enumerate(np.eye(3)):
        by_gyro = [replace(whole, rates=rates + sign * step * growth * axis) for sign in (1.0, -1.0)]
        by_accel = [replace(whole, forces=forces + sign * step * growth * axis) for sign in (1.0, -1.0)]
        more, less = (moments_of(each, plain) for each in by_gyro)
        phi = rotation_vector(more.C @ np.swapaxes(less.C, 1, 2))
        felt = np.subtract(*(moments_of(each, plain).V for each in by_accel))
        for found, expected in ((Phi[:, :, j, 0], phi), (Psi[:, :, j, 0], more.V - less.V), (Phi[:, :, j, 0], felt)):
            np.testing.assert_allclose(2.0 * step * found, expected, atol=0.02 * np.abs(expected).max())


# A simulated turn --------------------------------------------------------------------------------------------------

GAUSS = np.array([-np.sqrt(0.6), 0.0, np.sqrt(0.6)]) / 2.0, np.array([5.0, 8.0, 5.0]) / 18.0
GRAVITY = np.array([0.0, -9.81, 0.0])
REST = 0.5


def smooth(t: Array, duration: float) -> tuple[Array, Array, Array]:
    """From 0 to 1 with four derivatives zero at both ends, and its first two derivatives."""
    x = np.clip(t / duration, 0.0, 1.0)
    y = x * (1.0 - x)
    value = x**5 * (126.0 - 420.0 * x + 540.0 * x**2 - 315.0 * x**3 + 70.0 * x**4)
    return value, 630.0 * y**4 / duration, 2520.0 * y**3 * (1.0 - 2.0 * x) / duration**2


@dataclass(frozen=True, kw_only=True)
class Motion:
    """A turn by two angles about two axes one after the other, about a point 10 cm from the origin, and a hand that
    moves the point from one place of rest to another."""

    angles: tuple[float, float] = (1.9, -1.2)
    axes: tuple[tuple[float, float, float], tuple[float, float, float]] = ((0.6, 0.0, 0.8), (0.0, 0.8, -0.6))
    durations: tuple[float, float] = (5.0, 4.0)
    centre: tuple[float, float, float] = (0.06, -0.08, 0.0)
    path: tuple[float, float, float] = (0.2, -0.3, 0.1)

    @property
    def seconds(self) -> float:
        return max(self.durations) + 2.0 * REST

    def attitude(self, t: Array) -> tuple[Rotation, Array, Array]:
        """Body → space, rate and its derivative in the body."""
        (n, k), (s, u) = np.array(self.axes), (smooth(t - REST, T) for T in self.durations)
        first = Rotation.from_rotvec(np.multiply.outer(self.angles[0] * s[0], n))
        second = Rotation.from_rotvec(np.multiply.outer(self.angles[1] * u[0], k))
        carried = second.inv().apply(n)
        outer, inner = self.angles[0] * s[1][:, None] * carried, self.angles[1] * np.multiply.outer(u[1], k)
        change = self.angles[0] * s[2][:, None] * carried - np.cross(inner, outer)
        return first * second, outer + inner, change + self.angles[1] * np.multiply.outer(u[2], k)

    def force(self, t: Array) -> tuple[Array, Array, Array]:
        """Rate and specific force at the origin (S, 3), and the change of the force with a lever arm (S, 3, 3)."""
        attitude, rate, change = self.attitude(t)
        hand = np.multiply.outer(smooth(t - REST, max(self.durations))[2], np.array(self.path))
        turning = np.einsum("sj,jab->sab", rate, GENERATORS)
        gradient = np.einsum("sj,jab->sab", change, GENERATORS) + turning @ turning
        return rate, attitude.inv().apply(hand - GRAVITY) - gradient @ np.array(self.centre), gradient


GENERATORS = np.array([skew(axis) for axis in np.eye(3)])


@lru_cache(maxsize=64)
def moved(motion: Motion, hertz: float, offset: float) -> tuple[Array, Array, Array]:
    """Rate, force and its gradient `offset` seconds from the middle of every interval, from two before the start."""
    count = round(motion.seconds * hertz)
    return motion.force(np.asarray((np.arange(-2, count) + 0.5) / hertz + offset, dtype=float))


@dataclass(frozen=True, kw_only=True)
class Device:
    """What it reads: per sensor regressors (n, 13) and own-axis terms (n, 2), levers (n, 3) and delays (n,)."""

    gyro_axes: Array
    accel_axes: Array
    gyro_terms: Array
    accel_terms: Array
    gyro_own: Array
    accel_own: Array
    levers: Array
    delays: Array


def perfect(gyro_axes: Array, accel_axes: Array) -> Device:
    n, m = len(gyro_axes), len(accel_axes)
    return Device(
        gyro_axes=gyro_axes,
        accel_axes=accel_axes,
        gyro_terms=np.zeros((n, 13)),
        accel_terms=np.zeros((m, 13)),
        gyro_own=np.zeros((n, 2)),
        accel_own=np.zeros((m, 2)),
        levers=np.zeros((m, 3)),
        delays=np.zeros(m),
    )


def regressors(rate: Array, force: Array) -> Array:
    products = [force[:, a] * force[:, b] for a, b in naive_moments.PAIRS]
    return np.column_stack([np.ones(len(rate)), rate, force, *products])


def readings(device: Device, motion: Motion, hertz: float, offset: float) -> tuple[Array, Array]:
    """Readings of the gyros (S, n) and accelerometers (S, m) `offset` seconds from the middle of every interval."""
    rate, force, _ = moved(motion, hertz, offset)
    along = rate @ device.gyro_axes.T
    own = device.gyro_own[:, 0] * np.abs(along) + device.gyro_own[:, 1] * along**3
    gyro = along + regressors(rate, force) @ device.gyro_terms.T + own
    accel = np.empty((len(rate), len(device.accel_axes)))
    for p, axis in enumerate(device.accel_axes):
        rate, force, gradient = moved(motion, hertz, offset - float(device.delays[p]))
        force = force + gradient @ device.levers[p]
        along = force @ axis
        accel[:, p] = along + device.accel_own[p] @ np.array([np.abs(along), along**3])
        if device.accel_terms[p].any():
            accel[:, p] += regressors(rate, force) @ device.accel_terms[p]
    return gyro, accel


def recorded(device: Device, motion: Motion, hertz: float) -> Pieces:
    """Three-point Gauss means over the intervals, as body vectors of nominal sensors, two samples ahead."""
    parts = [readings(device, motion, hertz, x / hertz) for x in GAUSS[0]]
    gyro, accel = (sum(w * part[kind] for w, part in zip(GAUSS[1], parts, strict=True)) for kind in (0, 1))
    count = len(gyro)
    samples = (
        gyro @ np.linalg.pinv(device.gyro_axes).T,
        accel @ np.linalg.pinv(device.accel_axes).T,
        np.full(count, 1.0 / hertz),
    )
    return pieces_of(samples, np.array([2]), np.array([count]))


def nominal(gyro_axes: Array = TRIAD, accel_axes: Array = TRIAD) -> Compensation:
    gyro, accel = (
        BlockCompensation.of(axes, SensorModel(matrix=axes, bias=np.zeros(len(axes))))
        for axes in (gyro_axes, accel_axes)
    )
    return Compensation(gyro=gyro, accel=accel, g_sensitivity=np.zeros((3, 3)), delay=0.0)


def slope(plus: Moments, minus: Moments, step: float) -> tuple[Array, Array]:
    """∂φ and ∂V (3,) by central differences."""
    turned = rotation_vector(plus.C[0] @ minus.C[0].T)
    return turned / (2.0 * step), (plus.V[0] - minus.V[0]) / (2.0 * step)


# Closure -----------------------------------------------------------------------------------------------------------


def closure(motion: Motion, hertz: float) -> tuple[float, float]:
    """Errors of rotation, rad, and velocity, m/s, of a perfect device."""
    found = moments_of(recorded(perfect(TRIAD, TRIAD), motion, hertz), nominal())
    attitude, _, _ = motion.attitude(np.array([0.0, motion.seconds]))
    turned = attitude[0].inv() * attitude[1]
    velocity = attitude[0].inv().apply(-GRAVITY * found.T[0])
    rotation = (Rotation.from_matrix(found.C[0]) * turned.inv()).magnitude()
    return float(rotation), float(np.linalg.norm(found.V[0] - velocity))


def test_velocity_of_a_turn_closes_to_third_order() -> None:
    """Part II, A1: 4.1, 0.51, 0.064 µm/s at 50, 100 and 200 Hz for a turn with a peak of 50°/s."""
    T = 630.0 / 256.0 * 90.0 / 50.0
    motion = Motion(angles=(90.0 * DEGREE, 0.0), axes=((0.0, 0.0, 1.0), (1.0, 0.0, 0.0)), durations=(T, T))
    assert np.abs(motion.attitude(np.linspace(0.0, motion.seconds, 1001))[1]).max() == pytest.approx(
        50.0 * DEGREE, rel=1e-4
    )
    for hertz, published in ((50.0, 4.1e-6), (100.0, 0.51e-6), (200.0, 0.064e-6)):
        rotation, velocity = closure(motion, hertz)
        assert rotation < 1e-11
        assert 0.5 * published < velocity < 2.0 * published


def test_rotation_and_velocity_of_a_turn_about_moving_axes_close() -> None:
    errors = [closure(Motion(), hertz) for hertz in (50.0, 100.0, 200.0)]
    for coarse, fine in pairwise(errors):
        assert coarse[0] > 7.0 * fine[0]
        assert coarse[1] > 7.0 * fine[1]
    assert errors[-1][0] < 1e-8
    assert errors[-1][1] < 1e-6


# Columns -----------------------------------------------------------------------------------------------------------
#
# A reading with a parameter turned on, integrated without it, moves the other way from a turn integrated with it: the
# columns are the derivatives of the kernel with respect to its compensation, and those of the simulator with the
# opposite sign.

HERTZ = 200.0
CALM = Motion(durations=(20.0, 18.0))


def by_simulation(change: Callable[[float], Device], step: float, motion: Motion, hertz: float) -> tuple[Array, Array]:
    """−∂φ and −∂V with respect to a number of the device."""
    compensation = nominal(change(0.0).gyro_axes, change(0.0).accel_axes)
    plus, minus = (moments_of(recorded(change(x), motion, hertz), compensation) for x in (step, -step))
    phi, V = slope(plus, minus, step)
    return -phi, -V


def by_kernel(pieces: Pieces, change: Callable[[float], Compensation], step: float) -> tuple[Array, Array]:
    """∂φ and ∂V with respect to a number of the compensation."""
    return slope(moments_of(pieces, change(step)), moments_of(pieces, change(-step)), step)


def unit(n: int, p: int, b: int) -> Array:
    """Regressor array w (n, 13, 1) of one number."""
    w = np.zeros((n, 13, 1))
    w[p, b] = 1.0
    return w


def gyro_columns(moments: Moments, left_inverse: Array, w: Array) -> tuple[Array, Array]:
    """∂φ and ∂V (K, 3, m) of gyro parameters with regressors w (n, 13, m), Eq. (A6); of ∂V the linear regressors."""
    weights = np.tensordot(left_inverse, w, axes=1)
    return -contracted(moments.Phi, weights), -contracted(moments.Psi, weights[:, : moments.Psi.shape[-1]])


def accel_columns(moments: Moments, left_inverse: Array, w: Array) -> Array:
    """∂V (K, 3, m) of accelerometer parameters with regressors w (n, 13, m), Eq. (A6); ∂φ is 0."""
    return -contracted(moments.Phi, np.tensordot(left_inverse, w, axes=1))


def own_columns(moments: Array, left_inverse: Array, w: Array) -> Array:
    """Columns (K, 3, m) of parameters that add w_p0m |a_p·u| + w_p1m (a_p·u)³, w (n, 2, m), by moments of own axes."""
    return -contracted(moments, np.einsum("jp,pqm->jqpm", left_inverse, w))


def contracted(moments: Array, weights: Array) -> Array:
    """Σ M_ij… w_j…m (K, 3, m)."""
    return np.asarray(np.tensordot(moments, weights, axes=weights.ndim - 1))


@pytest.mark.parametrize("array", ["triad", "tetrad"])
def test_regressor_columns_are_the_derivatives_of_a_simulated_turn(array: str) -> None:
    """[FD] of §2: relative to the largest number of the column, to 1e-6."""
    axes = ARRAYS[array]
    start, s = perfect(axes, axes), np.linalg.pinv(axes)
    moments = moments_of(recorded(start, CALM, HERTZ), nominal(axes, axes))
    for p in (0, len(axes) - 1):
        for b in range(13):
            w = unit(len(axes), p, b)
            if b < 7:
                phi, V = gyro_columns(moments, s, w)
                change = lambda x, w=w: replace(start, gyro_terms=x * w[..., 0])  # noqa: E731
                found = by_simulation(change, 1e-6, CALM, HERTZ)
                np.testing.assert_allclose(found[0], phi[0, :, 0], atol=1e-6 * np.abs(phi).max())
                np.testing.assert_allclose(found[1], V[0, :, 0], atol=2e-6 * np.abs(V).max())
            V = accel_columns(moments, s, w)
            change = lambda x, w=w: replace(start, accel_terms=x * w[..., 0])  # noqa: E731
            found = by_simulation(change, 1e-5, CALM, HERTZ)
            np.testing.assert_allclose(found[0], 0.0, atol=1e-12)
            np.testing.assert_allclose(found[1], V[0, :, 0], atol=1e-6 * np.abs(V).max())


@pytest.mark.parametrize("array", ["triad", "tetrad"])
def test_own_axis_columns_are_the_derivatives_of_a_simulated_turn(array: str) -> None:
    """|u| is taken of the mean over a sample: the sample in which u changes its sign errs by its own length."""
    axes = ARRAYS[array]
    start, s, n = perfect(axes, axes), np.linalg.pinv(axes), len(axes)
    own = OwnAxes(gyro=axes, accel=axes)
    moments = moments_of(recorded(start, CALM, HERTZ), nominal(axes, axes), own)
    for p in range(n):
        for power, tolerance in ((0, 2e-6), (1, 2e-6)):
            w = np.zeros((n, 2))
            w[p, power] = 1.0
            found = by_simulation(lambda x, w=w: replace(start, accel_own=x * w), 1e-5, CALM, HERTZ)  # type: ignore[misc]
            V = own_columns(moments.Phi_accel, s, w[..., None])
            np.testing.assert_allclose(found[1], V[0, :, 0], atol=tolerance * np.abs(V).max())
            found = by_simulation(lambda x, w=w: replace(start, gyro_own=x * w), 1e-5, CALM, HERTZ)  # type: ignore[misc]
            phi, V = (own_columns(each, s, w[..., None]) for each in (moments.Phi_gyro, moments.Psi_gyro))
            np.testing.assert_allclose(found[0], phi[0, :, 0], atol=tolerance * np.abs(phi).max())
            np.testing.assert_allclose(found[1], V[0, :, 0], atol=tolerance * np.abs(V).max())


STILL = np.zeros((1, 3)), np.zeros((1, 3))
ARM = np.array([[0.03, -0.02, 0.01], [0.01, 0.04, -0.02], [0.0, 0.0, 0.0]])


@pytest.mark.parametrize("array", sorted(ARRAYS))
def test_lever_columns_are_the_derivatives_of_a_simulated_turn(array: str) -> None:
    axes = ARRAYS[array]
    start = perfect(TRIAD, axes)
    moments = moments_of(recorded(start, CALM, HERTZ), nominal(TRIAD, axes))
    columns = lever_columns(moments, np.linalg.pinv(axes), axes, STILL)[0].reshape(3, len(axes), 3)
    for p in range(len(axes)):
        for k in range(3):
            lever = np.zeros((len(axes), 3))
            lever[p, k] = 1.0
            _, V = by_simulation(lambda x, r=lever: replace(start, levers=x * r), 1e-2, CALM, HERTZ)  # type: ignore[misc]
            np.testing.assert_allclose(V, columns[:, p, k], atol=1.4e-4 * np.abs(columns).max())


def test_lever_columns_are_the_derivatives_of_a_turn_that_begins_and_ends_while_all_else_turns() -> None:
    """As every turn on the Earth does: what an arm turns with at its ends is in the integral of ω̇ × r."""
    first, stop = round(7.0 * HERTZ), round(13.0 * HERTZ)
    rates = CALM.attitude(np.array([first, stop]) / HERTZ)[1]
    cut = np.array([first + 2]), np.array([stop + 2])
    out, back = (
        moments_of(
            replace(recorded(replace(perfect(TRIAD, TRIAD), levers=x), CALM, HERTZ), start=cut[0], stop=cut[1]),
            nominal(),
        )
        for x in (ARM, -ARM)
    )
    columns = lever_columns(out, np.eye(3), TRIAD, (rates[:1], rates[1:]))[0]
    expected = 0.5 * (back.V - out.V)[0]
    np.testing.assert_allclose(columns @ ARM.ravel(), expected, atol=1.4e-4 * np.abs(expected).max())


@pytest.mark.parametrize("array", sorted(ARRAYS))
def test_delay_columns_are_the_derivatives_of_a_simulated_turn(array: str) -> None:
    axes = ARRAYS[array]
    start, s = perfect(TRIAD, axes), np.linalg.pinv(axes)
    pieces = recorded(start, CALM, HERTZ)
    moments = moments_of(pieces, nominal(TRIAD, axes))
    single = single_delay_columns(moments, s, axes, (pieces.forces[2:3], pieces.forces[-1:]))[0]
    for p in range(len(axes)):
        _, V = by_simulation(lambda x, p=p: replace(start, delays=x * np.eye(len(axes))[p]), 1e-4, CALM, HERTZ)  # type: ignore[misc]
        np.testing.assert_allclose(V, single[:, p], atol=1e-6 * np.abs(single).max())
    common = delay_column(moments)[0]
    _, V = by_simulation(lambda x: replace(start, delays=np.full(len(axes), x)), 1e-4, CALM, HERTZ)
    np.testing.assert_allclose(V, common, atol=1e-6 * np.abs(common).max())
    np.testing.assert_allclose(single.sum(axis=1), common, atol=1e-6 * np.abs(common).max())


@pytest.mark.parametrize("array", sorted(ARRAYS))
def test_columns_of_a_sensor_model_are_the_derivatives_of_the_kernel(array: str) -> None:
    """Bias, scale and axes as parametrised by `Block`, about values of the size of MEMS."""
    rng = np.random.default_rng(7)
    axes = ARRAYS[array]
    pieces = recorded(perfect(axes, axes), CALM, HERTZ)
    gyro, accel = Block(kind="gyro", axes=axes), Block(kind="accel", axes=axes)
    values = {kind: 5e-3 * rng.standard_normal(len(block.names)) for kind, block in (("g", gyro), ("a", accel))}

    def about(x: float, g: Array, a: Array) -> Compensation:
        return Compensation(
            gyro=BlockCompensation.of(axes, gyro.model(values["g"] + x * g)),
            accel=BlockCompensation.of(axes, accel.model(values["a"] + x * a)),
            g_sensitivity=np.zeros((3, 3)),
            delay=0.0,
        )

    still = about(0.0, 0.0 * values["g"], 0.0 * values["a"])
    moments = moments_of(pieces, still)
    for kind, block, first in (("g", gyro, 1), ("a", accel, 4)):
        jacobian, many = block.jacobian(values[kind]), len(block.names)
        w = np.zeros((len(axes), 13, many))
        w[:, 0], w[:, first : first + 3] = jacobian[:, 3], jacobian[:, :3]
        if kind == "g":
            phi, V = gyro_columns(moments, still.gyro.left_inverse, w)
        else:
            V = accel_columns(moments, still.accel.left_inverse, w)
            phi = np.zeros_like(V)
        for m in range(many):
            direction = np.eye(many)[m]
            zero = {"g": 0.0 * values["g"], "a": 0.0 * values["a"]} | {kind: direction}
            found = by_kernel(pieces, lambda x, z=zero: about(x, z["g"], z["a"]), 1e-5)  # type: ignore[misc]
            np.testing.assert_allclose(found[0], phi[0, :, m], atol=1e-6 * np.abs(phi).max())
            np.testing.assert_allclose(found[1], V[0, :, m], atol=2e-6 * np.abs(V).max())


def test_columns_of_nonlinear_terms_are_the_derivatives_of_the_kernel() -> None:
    """g-sensitivity, K₂, K₃, both asymmetries and the delay, of a tetrad."""
    start = nominal(TETRAD, TETRAD)
    pieces = recorded(perfect(TETRAD, TETRAD), CALM, HERTZ)
    moments = moments_of(pieces, start, OwnAxes(gyro=TETRAD, accel=TETRAD))
    s = np.linalg.pinv(TETRAD)

    def check(found: tuple[Array, Array], phi: Array, V: Array) -> None:
        np.testing.assert_allclose(found[0], phi, atol=1e-6 * max(np.abs(phi).max(), 1e-9))
        np.testing.assert_allclose(found[1], V, atol=2e-6 * np.abs(V).max())

    for p in range(4):
        for q in range(3):
            w = unit(4, p, 4 + q)
            G = s @ w[:, 4:7, 0]
            found = by_kernel(pieces, lambda x, G=G: replace(start, g_sensitivity=x * G), 1e-5)  # type: ignore[misc]
            check(found, *(column[0, :, 0] for column in gyro_columns(moments, s, w)))
        w = np.zeros((4, 13, 1))
        w[p, 7:, 0] = [(2.0 - (a == b)) * TETRAD[p, a] * TETRAD[p, b] for a, b in naive_moments.PAIRS]
        own = np.zeros((4, 2, 3))
        own[p, 0, 2] = own[p, 1, 1] = 1.0
        columns = own_columns(moments.Phi_accel, s, own)
        columns[..., :1] = accel_columns(moments, s, w)
        for power in range(3):
            terms = np.zeros((4, 3))
            terms[p, power] = 1.0

            def about(x: float, terms: Array = terms) -> Compensation:
                return replace(start, accel=replace(start.accel, terms=x * terms))

            check(by_kernel(pieces, about, 1e-6), np.zeros(3), columns[0, :, power])

        phi, V = (own_columns(each, s, own) for each in (moments.Phi_gyro, moments.Psi_gyro))
        for power in (1, 2):

            def about_gyro(x: float, p: int = p, power: int = power) -> Compensation:
                return replace(start, gyro=replace(start.gyro, terms=x * np.outer(np.eye(4)[p], np.eye(3)[power])))

            check(by_kernel(pieces, about_gyro, 1e-5), phi[0, :, power], V[0, :, power])
    check(by_kernel(pieces, lambda x: replace(start, delay=x), 1e-5), np.zeros(3), delay_column(moments)[0])


@pytest.mark.parametrize("array", sorted(ARRAYS))
def test_a_lever_common_to_all_is_not_seen(array: str) -> None:
    rng = np.random.default_rng(8)
    axes = ARRAYS[array]
    compensation = some_compensation(rng, axes)
    moments = moments_of(pieces_of(wandering(rng, 900), *ranges(400, 500)), compensation)
    s = np.linalg.solve(compensation.accel.left_inverse @ axes, compensation.accel.left_inverse)
    columns = lever_columns(moments, s, axes, STILL).reshape(2, 3, len(axes), 3)
    assert np.abs(columns.sum(axis=2)).max() < 1e-13 * np.abs(columns).max()


@pytest.mark.parametrize(
    ("array", "turns", "rank"), [("triad", 3, 6), ("tetrad", 3, 9), ("six", 5, 15), ("six", 4, 12)]
)
def test_levers_have_a_gauge_of_three_given_enough_turns(array: str, turns: int, rank: int) -> None:
    """Part II, A7: ranks 6, 9 and 15 of three, four and six accelerometers; four turns give 12 of 15."""
    rng = np.random.default_rng(9)
    rates, forces, intervals = wandering(rng, 200 * turns)
    moments = moments_of(pieces_of((rates, forces, intervals), *ranges(*[200] * turns)), nominal(TRIAD, ARRAYS[array]))
    columns = lever_columns(moments, np.linalg.pinv(ARRAYS[array]), ARRAYS[array], STILL).reshape(3 * turns, -1)
    values = np.linalg.svd(columns, compute_uv=False)
    assert int(np.sum(values > 1e-9 * values[0])) == rank


def test_parity_rows_see_levers_through_the_integrals_in_the_body() -> None:
    """Part II, A7: ∫ a·([ω̇×] + [ω×]²) r dt = a·∫ [ω×]² dt r between two rests."""
    motion, r = Motion(), np.array([0.01, -0.02, 0.03])
    out = replace(perfect(TRIAD, SIX), levers=np.outer(np.eye(6)[4], r))
    still = perfect(TRIAD, SIX)
    pieces = recorded(still, motion, 200.0)
    moments = moments_of(pieces, nominal(TRIAD, SIX))
    both = [readings(device, motion, 2000.0, 0.0)[1] for device in (out, still)]
    seen = np.sum((both[0] - both[1])[:, 4]) / 2000.0
    xx, xy, xz, yy, yz, zz = moments.body_rates[0]
    product = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    expected = SIX[4] @ (product - np.trace(product) * np.eye(3)) @ r
    assert seen == pytest.approx(expected, rel=1e-5)


def test_a_turn_integrated_about_the_truth_is_the_perfect_turn() -> None:
    """All errors of the size of MEMS at once, levers apart. What is left comes of g-sensitivity to the part of the
    force that changes otherwise than by the turning; A1's rate without g-sensitivity left 2·10⁻⁴ m/s."""
    rng = np.random.default_rng(10)
    motion, tau = Motion(), 4e-3
    gyro = SensorModel(matrix=np.eye(3) + 5e-3 * rng.standard_normal((3, 3)), bias=0.01 * rng.standard_normal(3))
    accel = SensorModel(matrix=np.eye(3) + 5e-3 * rng.standard_normal((3, 3)), bias=0.1 * rng.standard_normal(3))
    G, K = 2e-4 * rng.standard_normal((3, 3)), 5e-5 * rng.standard_normal(3)
    terms = np.zeros((2, 3, 13))
    terms[0, :, 0], terms[0, :, 1:4], terms[0, :, 4:7] = gyro.bias, gyro.matrix - np.eye(3), G
    terms[1, :, 0], terms[1, :, 4:7] = accel.bias, accel.matrix - np.eye(3)
    for p, b in enumerate((7, 10, 12)):
        terms[1, p, b] = K[p]
    device = replace(perfect(TRIAD, TRIAD), gyro_terms=terms[0], accel_terms=terms[1], delays=np.full(3, tau))
    compensation = Compensation(
        gyro=BlockCompensation.of(TRIAD, gyro),
        accel=BlockCompensation.of(TRIAD, accel, np.outer(K, [1.0, 0.0, 0.0])),
        g_sensitivity=G,
        delay=tau,
    )
    found = moments_of(recorded(device, motion, 200.0), compensation)
    truth = moments_of(recorded(perfect(TRIAD, TRIAD), motion, 200.0), nominal())
    assert rotation_vector(found.C[0] @ truth.C[0].T) == pytest.approx(np.zeros(3), abs=1e-6)
    assert found.V[0] == pytest.approx(truth.V[0], abs=2e-5)
