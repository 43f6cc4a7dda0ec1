"""What may be behind residuals that the noise does not explain.

All is tested at the linearisation of the estimate, without solving again (dynamics method, Eq. (11)). With the whitened
rows A of all unknowns, their residuals e and the whitened columns A_c of a candidate cause,

    B = A_c − Q Qᵀ A_c,    ĉ = (BᵀB)⁻¹ Bᵀe,    Δχ² = eᵀ B ĉ,    Δθ = −A⁺ A_c ĉ                                    (11)

Q being an orthonormal basis of what A spans. Δχ² is judged as chi-square of q degrees of freedom, or, where scatter was
estimated from the same residuals, by F = (Δχ²/q) / ((χ² − Δχ²)/(ν − q)).

A cause that is random, another variance with directions Z, is judged by eᵀ Z Zᵀ e: a sum of squares, each with a
weight, an eigenvalue of Zᵀ (1 − Q Qᵀ) Z. Its probability is that of Pearson's distribution of the same first three
moments.

A heading that the gyros hardly see may be far from where the rows were linearised. The horizontal Earth's rate is
linear in its cosine and sine, so the rows get another unknown, the part along north, for each chain of rests that has
such a heading.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from scipy import special
from scipy.linalg import solve_triangular

from tumble.earth import earth_rate
from tumble.estimation.likelihood import Linearised, Scatter
from tumble.estimation.linearisation import linearise
from tumble.estimation.turns_about import TurnsAbout
from tumble.rotation import rotation_matrix, rotation_vector, tangent_basis
from tumble.sensors.instrument import functions
from tumble.sensors.model import Block
from tumble.sensors.parameters import PAIRS, PRODUCTS, RATE
from tumble.units import DEGREE, G_STANDARD, Array

NO_HEADING = 100.0
"""rad: how well every angle of an attitude is known beforehand, so that a heading that nothing shows has a row."""

SEEN_HEADING = 0.05
"""rad: a heading that the gyros at rest know better is where the rows were linearised."""

UNSEEN = 1e-4
"""A combination of a cause's columns of which the projection leaves less than this part of the length is not seen."""

WARM_UP_SHARES = (0.1, 0.3)
"""Time constants of a warm-up that are tried, in parts of the session."""

LATITUDE_KNOWN = 0.01
"""rad: gyros that know the latitude to no better hardly see the Earth's rate, nor the headings, and these are not
linear then."""

MEMORIES = (10.0, 60.0, 300.0)
"""Time constants of a memory that are tried, s."""

PLAY = 0.05 * G_STANDARD
"""Half the width of the play of a hysteresis: a change of the own force by twice as much takes it across."""

PATH_STEPS = 24
"""Steps a turn is followed in."""

SHORTEST_TURN = 1e-6
"""s: what is shorter is no turn."""

Concerns = Literal["accel", "gyro", "both"]


@dataclass(frozen=True, kw_only=True, slots=True)
class Cause:
    """A candidate cause: its `name`, which sensors it `concerns`, the `probability` that chance alone shows as much,
    by how much the 21 parameters err without it at most, in their u, and a `sentence` with size and remedy."""

    name: str
    concerns: Concerns
    probability: float
    damage: float
    sentence: str


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Columns:
    """Columns of rest rows (N, r, q) and rows of turns (K, t, q) of a candidate, per SI unit of its size; `sentence`
    with a place for the size, which is said in a `unit` (size in SI, name)."""

    name: str
    concerns: Concerns
    rest: Array
    turn: Array
    unit: tuple[float, str]
    sentence: str
    known: float = np.inf
    """A session that knows the size to no better, SI, says nothing of it."""


# The projection


class Projection:
    """The residuals of an estimate and what its unknowns span, whitened with the noise and a scatter."""

    def __init__(self, linearised: Linearised, scatter: Scatter) -> None:
        problem, rows = linearised.problem, linearised.rows
        turns = problem.observations.turns
        self._weights = linearised.noise.weights(scatter)
        self._link = problem.link
        self.first = np.zeros(0, dtype=np.int64) if turns is None else turns.first
        N, known = len(problem.link), np.abs(rows.prior[:-1, :-1]).sum(axis=0) > 0.0
        stacked = self.whitened(rows.rest[..., 3:], rows.turn[..., 6:])
        angles = np.column_stack([self._angles(rows.rest[..., :3], rows.turn[..., :6]), self._norths(linearised)])
        own = angles.shape[1]
        A = np.zeros((len(stacked) + own + len(rows.prior) - 1, own + int(known.sum())))
        A[: len(stacked), :own], A[: len(stacked), own:] = angles, stacked[:, :-1][:, known]
        A[len(stacked) : len(stacked) + own, :own] = np.diag(np.where(np.arange(own) < 3 * N, 1.0 / NO_HEADING, 1.0))
        A[len(stacked) + own :, own:] = rows.prior[:-1, :-1][:, known]
        right = np.concatenate([stacked[:, -1], np.zeros(own), rows.prior[:-1, -1]])
        self.basis, self._triangle = np.linalg.qr(A)
        self.residual = right - self.basis @ (self.basis.T @ right)
        self._rows, self._parameters = len(stacked), own + int(known[0])
        self.degrees = self._rows - float((self.basis[: self._rows] ** 2).sum())

    def _norths(self, linearised: Linearised) -> Array:
        """The whitened columns of the part of the Earth's rate along north in every chain whose heading is hardly seen,
        (rows, chains)."""
        problem, rows = linearised.problem, linearised.rows
        gyro, n = problem.observations.gyro_block, problem.observations.accel_block.size
        if gyro is None or problem.earth[0] == 0.0:
            return np.zeros((self.whitened(rows.rest[..., :0], rows.turn[..., :0]).shape[0], 0))
        chains = np.arange(problem.chain[-1] + 1)
        own = (problem.chain[:, None] == chains)[:, None]
        turn = np.zeros((*rows.turn.shape[:2], len(chains)))
        stop = n + gyro.size

        def whitened(seen: Array) -> Array:
            rest = np.zeros((*rows.rest.shape[:2], len(chains)))
            rest[:, n:stop] = seen * own
            return self.whitened(rest, turn)

        headings = whitened(rows.rest[:, n:stop, 2:3])
        north = whitened((linearised.point.attitudes[:, 0] * problem.earth[0] @ gyro.axes.T)[:, :, None])
        return np.asarray(north[:, (headings**2).sum(axis=0) < SEEN_HEADING**-2])

    @property
    def chi_square(self) -> float:
        """Sum of the squares of the residuals of the rows."""
        return float((self.residual[: self._rows] ** 2).sum())

    def whitened(self, rest: Array, turn: Array) -> Array:
        """Columns of the rests (N, r, q) and turns (K, t, q), whitened, one below the other."""
        merged = np.concatenate([rest[self.first], turn], axis=1)
        alone = self._link < 0
        parts = (self._weights.rest[alone] @ rest[alone], self._weights.merged @ merged)
        return np.concatenate([part.reshape(part.shape[0] * part.shape[1], rest.shape[2]) for part in parts])

    def _angles(self, rest: Array, turn: Array) -> Array:
        """The whitened columns of the attitudes of all rests, (rows, 3 N)."""
        N, K = len(rest), len(turn)
        wide_rest, wide_turn = np.zeros((N, rest.shape[1], N, 3)), np.zeros((K, turn.shape[1], N, 3))
        wide_rest[np.arange(N), :, np.arange(N)] = rest
        wide_turn[np.arange(K), :, self.first] = turn[..., :3]
        wide_turn[np.arange(K), :, self.first + 1] = turn[..., 3:]
        return self.whitened(_joined(wide_rest), _joined(wide_turn))

    def left_of(self, columns: Array) -> Array:
        """What the unknowns leave of whitened columns: B of (11), over all rows, priors included."""
        padded = np.zeros((len(self.residual), columns.shape[1]))
        padded[: self._rows] = columns
        return np.asarray(padded - self.basis @ (self.basis.T @ padded))

    def change(self, columns: Array, values: Array) -> Array:
        """Δθ (m,) of the parameters by a cause of these values that is left out."""
        right = self.basis[: self._rows].T @ (columns @ values)
        return np.asarray(solve_triangular(self._triangle, right)[self._parameters :])

    @cached_property
    def u(self) -> Array:
        """Standard uncertainties (m,) of the parameters."""
        inverse = solve_triangular(self._triangle, np.eye(len(self._triangle)))
        return np.asarray(np.sqrt((inverse**2).sum(axis=1))[self._parameters :])


def weighted_chance(square: float, weights: Array) -> float:
    """Probability that Σ λ χ²₁ exceeds a value: Pearson's distribution of the same mean, variance and skewness."""
    first, second, third = (float((weights**k).sum()) for k in (1, 2, 3))
    if first <= 0.0 or third <= 0.0:
        return 1.0
    degrees = second**3 / third**2
    shifted = degrees + (square - first) * np.sqrt(degrees / second)
    return float(special.chdtrc(degrees, max(shifted, 0.0)))


def variance_chance(projection: Projection, rest: Array, turn: Array) -> float:
    """Probability that chance alone makes a score as large of a variance whose directions are columns of the rests
    (N, r, q) and turns (K, t, q), each of a number of its own."""
    if max(rest.shape[2], turn.shape[2]) == 0:
        return 1.0
    return weighted_chance(*_sum_of_squares(projection, apart(projection, rest, turn)))


def apart(projection: Projection, rest: Array, turn: Array) -> Array:
    """Whitened directions, a column for each rest or turn and each of the q."""
    N, K, q = len(rest), len(turn), max(rest.shape[2], turn.shape[2])
    wide_rest, wide_turn = np.zeros((N, rest.shape[1], N, q)), np.zeros((K, turn.shape[1], N, q))
    if rest.shape[2]:
        wide_rest[np.arange(N), :, np.arange(N)] = rest
    if turn.shape[2]:
        wide_turn[np.arange(K), :, projection.first] = turn
    return projection.whitened(_joined(wide_rest), _joined(wide_turn))


def _sum_of_squares(projection: Projection, directions: Array) -> tuple[float, Array]:
    """The square of the residuals along whitened directions, and its weights: Σ λ χ²₁ where chance alone is at work."""
    left = projection.left_of(directions[:, np.any(directions != 0.0, axis=0)])
    along = left.T @ projection.residual
    return float(along @ along), np.maximum(np.linalg.eigvalsh(left.T @ left), 0.0)


# The candidates


class _Session:
    """What the candidates are made of: own forces of the accelerometers at rest (N, n) and on the way to the next
    (K, steps, n), and where the rows of a kind of sensor stand."""

    def __init__(self, linearised: Linearised) -> None:
        self.linearised = linearised
        self.problem, self.observations = linearised.problem, linearised.problem.observations
        L = linearised.point.attitudes
        self.force = linearised.point.gravity * L[:, 1]
        self.rate = self.problem.earth @ L
        self.rest_shape = linearised.rows.rest.shape[:2]
        self.turn_shape = linearised.rows.turn.shape[:2]

    @cached_property
    def accel(self) -> Block:
        return self.observations.accel_block

    @cached_property
    def turned(self) -> bool:
        """Whether anything is turned: the parts of a rest are joined by turns of no duration."""
        about = self.linearised.about
        return about is not None and bool(np.any(about.moments.T >= SHORTEST_TURN))

    @cached_property
    def steps(self) -> Array:
        """Rotations (K, steps, 3, 3), body at the start → body on the way of each turn, taken as one about one axis of
        the body."""
        about = self.linearised.about
        if about is None:
            return np.zeros((0, PATH_STEPS, 3, 3))
        path = rotation_vector(about.C)
        angle = np.linalg.norm(path, axis=1, keepdims=True)
        beyond = np.einsum("ka,ka->k", path, about.moments.body[:, 1:4]) < 0.0
        path = np.where(beyond[:, None], path * (1.0 - 2.0 * np.pi / np.maximum(angle, 1e-9)), path)
        share = (np.arange(PATH_STEPS) + 0.5) / PATH_STEPS
        back = rotation_matrix(-(share[None, :, None] * path[:, None]).reshape(-1, 3))
        return np.asarray(back.reshape(-1, PATH_STEPS, 3, 3))

    @cached_property
    def paths(self) -> Array:
        """Specific forces (K, steps, 3) on the way of each turn."""
        turns = self.observations.turns
        if turns is None:
            return np.zeros((0, PATH_STEPS, 3))
        return np.asarray(np.einsum("ksab,kb->ksa", self.steps, self.force[turns.first]))

    def biased(self, kind: str, at_rest: Array, in_turn: Array) -> tuple[Array, Array]:
        """Columns of a bias of every sensor of a kind that is so many times as large at rest (N, n) and on the way of
        the turns (K, steps, n)."""
        n = at_rest.shape[1]
        first = 0 if kind == "accel" else self.accel.size
        rest = np.zeros((*self.rest_shape, n))
        rest[:, first : first + n] = at_rest[:, :, None] * np.eye(n)
        about = self.linearised.about
        turn = np.zeros((*self.linearised.rows.turn.shape[:2], n))
        if len(turn):
            turn = self.linearised.rows.bias[:, :, first : first + n] * in_turn.mean(axis=1)[:, None, :]
        if kind == "accel" and about is not None:
            nominal = np.linalg.pinv(self.accel.axes)
            each = np.swapaxes(self.steps, 2, 3) @ nominal  # C s_p
            self.put_velocity(turn, np.einsum("ksip,ksp,k->kip", each, in_turn, about.moments.T / PATH_STEPS))
        return rest, turn

    def put_velocity(self, turn: Array, columns: Array) -> None:
        """Put columns (K, 3, q) into the rows of the velocities, where there are any."""
        if self.problem.instrument.in_velocities:
            turn[:, 3:6] = columns

    def nothing(self, q: int) -> tuple[Array, Array]:
        """Columns of nothing."""
        return np.zeros((*self.rest_shape, q)), np.zeros((*self.turn_shape, q))


def _candidates(session: _Session) -> Iterator[_Columns]:
    """Everything that is tried."""
    yield from _of_time(session)
    yield _hysteresis(session)
    yield from _memory(session)
    yield from _products(session)
    about, gyro = session.linearised.about, session.observations.gyro_block
    modelled = "gyro.cubic" in session.problem.instrument.members
    if session.turned and about is not None and gyro is not None and not modelled:
        yield _gyro_nonlinearity(session, about, gyro)
    if gyro is not None and session.observations.site.latitude is not None:
        yield _latitude(session)


_UNITS = {"accel": (1e-6 * G_STANDARD, "µg"), "gyro": (DEGREE / 3600.0, "°/h")}
_WORDS = {"accel": "accelerometers", "gyro": "gyros"}


def _kinds(session: _Session) -> list[tuple[Literal["accel", "gyro"], Block]]:
    gyro = session.observations.gyro_block
    return [("accel", session.accel), *([("gyro", gyro)] if gyro is not None else [])]  # type: ignore[list-item]


def _of_time(session: _Session) -> Iterator[_Columns]:
    """Drift, beyond what its prior allows for, and warm-up."""
    at_rest, in_turn, _ = (values[:, 0] for values in session.problem.variables["time"])
    span = max(float(np.ptp(at_rest)), 1.0)
    rows = session.linearised.rows
    for kind, block in _kinds(session):
        words, wide, steps = _WORDS[kind], np.ones(block.size), np.ones((1, PATH_STEPS, block.size))
        for what, unit in (("bias", _UNITS[kind]), ("scale", (1e-6, "ppm"))):
            own = session.problem.instrument.group_columns(f"{kind}.{what}")
            yield _Columns(
                name="drift",
                concerns=kind,
                rest=rows.rest[:, :, 4:-1][:, :, own] * (at_rest / span)[:, None, None],
                turn=rows.turn[:, :, 7:-1][:, :, own] * (in_turn / span)[:, None, None],
                unit=unit,
                sentence=f"{what} of the {words} drifts by {{size}} over the session: let the device warm up, or make "
                "the session shorter",
            )
        for share in WARM_UP_SHARES:
            x, z = (np.exp(-(t - at_rest.min()) / (share * span)) for t in (at_rest, in_turn))
            rest, turn = session.biased(kind, np.outer(x, wide), z[:, None, None] * steps)
            yield _Columns(
                name="warm-up",
                concerns=kind,
                rest=rest,
                turn=turn,
                unit=_UNITS[kind],
                sentence=f"biases of the {words} settle by {{size}} after the start, in about {share * span:.0f} s: "
                "switch on earlier, or leave the first rests out",
            )


def _hysteresis(session: _Session) -> _Columns:
    at_rest, in_turn = _played(session)
    rest, turn = session.biased("accel", at_rest, in_turn)
    return _Columns(
        name="hysteresis",
        concerns="accel",
        rest=rest,
        turn=turn,
        unit=_UNITS["accel"],
        sentence="hysteresis of the accelerometers of {size}, by the sign of the last change of the own force: come to "
        "each position from both sides",
    )


def _played(session: _Session) -> tuple[Array, Array]:
    """Where in its play, −1 … 1, the own force of each accelerometer is at rest (N, n) and on the way of the turns
    (K, steps, n)."""
    axes, link = session.accel.axes, session.problem.link
    own, paths = session.force @ axes.T, session.paths @ axes.T
    at_rest, in_turn = np.zeros_like(own), np.zeros_like(paths)
    middle = own[0].copy()
    for i, here in enumerate(own):
        middle = np.clip(middle, here - PLAY, here + PLAY)
        at_rest[i] = (here - middle) / PLAY
        if (k := link[i]) >= 0:
            for j, step in enumerate(paths[k]):
                middle = np.clip(middle, step - PLAY, step + PLAY)
                in_turn[k, j] = (step - middle) / PLAY
    return at_rest, in_turn


def _memory(session: _Session) -> Iterator[_Columns]:
    for kind, block in _kinds(session):
        for seconds in MEMORIES:
            at_rest, in_turn = _remembered(session, block, seconds)
            rest, turn = session.biased(kind, at_rest, in_turn)
            size, name = _UNITS[kind]
            yield _Columns(
                name="memory",
                concerns=kind,
                rest=rest,
                turn=turn,
                unit=(size / G_STANDARD, f"{name}/g"),
                sentence=f"{_WORDS[kind]} that remember the previous attitude by {{size}} for about {seconds:.0f} s: "
                "longer rests, of which the beginning is left out",
            )


def _remembered(session: _Session, block: Block, seconds: float) -> tuple[Array, Array]:
    """How far the own force, low-pass, is behind: the mean over each rest (N, n) and step of a turn (K, steps, n)."""
    rests, turns, link = session.observations.rests, session.observations.turns, session.problem.link
    own, paths = session.force @ block.axes.T, session.paths @ block.axes.T
    at_rest, in_turn = np.zeros_like(own), np.zeros_like(paths)
    slow = own[0].copy()
    for i, here in enumerate(own):
        at_rest[i], slow = _relaxed(slow, here, float(rests.stop[i] - rests.start[i]) / seconds)
        if (k := link[i]) >= 0 and turns is not None:
            for j, step in enumerate(paths[k]):
                in_turn[k, j], slow = _relaxed(slow, step, float(turns.duration[k]) / PATH_STEPS / seconds)
    return at_rest, in_turn


def _relaxed(slow: Array, target: Array, passed: float) -> tuple[Array, Array]:
    """The mean of slow − target over a time, in time constants, and slow after it."""
    share = -np.expm1(-passed) / passed if passed > 0.0 else 1.0
    return (slow - target) * share, target + (slow - target) * np.exp(-passed)


def _products(session: _Session) -> Iterator[_Columns]:
    """Products of forces that no group of the instrument has: cross products in accelerometers, all in gyros."""
    about = session.linearised.about
    for kind, block in _kinds(session):
        first = 0 if kind == "accel" else session.accel.size
        chosen = [b for b, pair in enumerate(PAIRS, start=PRODUCTS.start) if pair[0] != pair[1] or kind == "gyro"]
        beta = functions(block, session.force, session.rate)[:, 0, chosen]
        q = block.size * len(chosen)
        rest, turn = session.nothing(q)
        rest[:, first : first + block.size] = np.einsum("nb,ps->npsb", beta, np.eye(block.size)).reshape(
            len(rest), block.size, q
        )
        if about is not None:
            if kind == "accel":
                session.put_velocity(turn, about.by_force[..., chosen].reshape(len(turn), 3, q))
            else:
                turn[:, :3] = about.by_phi[..., chosen].reshape(len(turn), 3, q)
        size, name = _UNITS[kind]
        yield _Columns(
            name="cross products" if kind == "accel" else "g² sensitivity",
            concerns=kind,
            rest=rest,
            turn=turn,
            unit=(size / G_STANDARD**2, f"{name}/g²"),
            sentence=f"{_WORDS[kind]} that read products of forces, by {{size}}: more oblique rests, or use it near "
            "the attitudes of the session",
        )


def _gyro_nonlinearity(session: _Session, about: TurnsAbout, gyro: Block) -> _Columns:
    """Scale factors with the square of the rate, of an estimate that has no such parameters."""
    n = gyro.size
    duration = np.maximum(about.moments.T, SHORTEST_TURN)[:, None]
    square = about.moments.body_rates[:, [0, 3, 5]] / duration @ (gyro.axes**2).T
    rest, turn = session.nothing(n)
    phi, V = (
        np.einsum("kipb,pb,kp->kip", by[..., RATE], gyro.axes, square) for by in (about.by_phi, about.by_velocity)
    )
    turn[:, :3] = phi
    session.put_velocity(turn, V)
    return _Columns(
        name="gyro nonlinearity",
        concerns="gyro",
        rest=rest,
        turn=turn,
        unit=(1e-6 / (10.0 * DEGREE) ** 2, "ppm at 10 °/s"),
        sentence="scale factors of the gyros that depend on the rate, by {size}: turn at the rates of use, at one "
        "rate, or make them parameters by gyro_cubic in [device.prior]",
    )


def _latitude(session: _Session) -> _Columns:
    step, latitude = 1e-4, session.observations.site.latitude
    assert latitude is not None
    moved = replace(session.problem, earth=np.array(earth_rate(latitude + step)))
    rows, there = session.linearised.rows, linearise(moved, session.linearised.point, session.linearised.about)
    rest = (rows.rest[..., -1:] - there.rest[..., -1:]) / step
    turn = (rows.turn[..., -1:] - there.turn[..., -1:]) / step
    return _Columns(
        name="latitude",
        concerns="both",
        rest=rest,
        turn=turn,
        unit=(DEGREE, "°"),
        sentence="a latitude that the gyros contradict by {size}: look at latitude_deg in [site], and its sign",
        known=LATITUDE_KNOWN,
    )


# The test


def causes(linearised: Linearised, projection: Projection) -> list[Cause]:
    """All candidates, the most significant first, one of a name and kind of sensor. The `projection` is that with the
    scatter of the estimate."""
    session = _Session(linearised)
    found: dict[tuple[str, str], Cause] = {}
    tried: dict[tuple[str, str], int] = {}
    for candidate in _candidates(session):
        key = candidate.name, candidate.concerns
        tried[key] = tried.get(key, 0) + 1
        cause = _tested(candidate, session, projection)
        if cause is not None and (key not in found or cause.probability < found[key].probability):
            found[key] = cause
    several = [replace(c, probability=min(1.0, tried[key] * c.probability)) for key, c in found.items()]
    several += _quantisation(session)
    held = list(_held(session))
    several += held
    if session.turned and not held:
        several.append(_lost(session, projection))
    return sorted(several, key=lambda cause: cause.probability)


def _tested(candidate: _Columns, session: _Session, projection: Projection) -> Cause | None:
    """A candidate by Eq. (11); None where the session does not see it."""
    columns = projection.whitened(candidate.rest, candidate.turn)
    length = np.sqrt((columns**2).sum(axis=0))
    columns, q = columns / np.where(length > 0.0, length, 1.0), len(length)
    left = projection.left_of(columns)
    size, directions = np.linalg.eigh(left.T @ left)
    seen = size > UNSEEN**2
    if not seen.any() or 1.0 / np.sqrt(size[seen].min()) > candidate.known * length.max():
        return None
    along = directions[:, seen].T @ (left.T @ projection.residual)
    fall, q = float((along**2 / size[seen]).sum()), int(seen.sum())
    values = directions[:, seen] @ (along / size[seen])
    m = session.problem.instrument.linear_count
    damage = float(np.max(np.abs(projection.change(columns, values)[:m]) / projection.u[:m]))
    largest = float(np.max(np.abs(values / np.where(length > 0.0, length, np.inf))))
    scale, unit = candidate.unit
    return Cause(
        name=candidate.name,
        concerns=candidate.concerns,
        probability=chance(projection, session.linearised.scatter, fall, q),
        damage=damage,
        sentence=candidate.sentence.format(size=f"{largest / scale:.2g} {unit}".replace(" °", "°")),
    )


def chance(projection: Projection, scatter: Scatter, fall: float, q: int) -> float:
    """Probability of a fall of chi-square with q parameters."""
    if not np.any(scatter.variances > 0.0):
        return float(special.chdtrc(q, fall))
    others = max(projection.degrees - q, 1.0)
    rest = max(projection.chi_square - fall, 1e-9)
    overstated = min(1.0, projection.chi_square / projection.degrees)  # noise that is less than said proves nothing
    return float(special.fdtrc(q, others, overstated * fall / q / (rest / others)))


COARSE = 0.5
"""What rounding does to the mean of a rest, in parts of its noise, from which on it is a cause."""


def _quantisation(session: _Session) -> Iterator[Cause]:
    """Channels whose steps the noise does not cover, where what rounding does to a mean is not small beside its
    noise."""
    rests = session.observations.rests
    for kind, _ in _kinds(session):
        found = session.observations.rounding.get(kind)
        if found is None or not found.common_u.any():
            continue
        covariance = getattr(rests, f"{kind}_covariance")
        variance = np.median(np.diagonal(covariance, axis1=1, axis2=2), axis=0) - found.of_rest**2
        coarse = found.common_u > COARSE * np.sqrt(np.maximum(variance, 0.0))
        if coarse.any():
            worst = int(np.argmax(np.where(coarse, found.common_u, 0.0)))
            step, error = float(found.step[worst]), float(found.common_u[worst])
            scale, unit = _UNITS[kind]
            yield Cause(
                name="quantisation",
                concerns=kind,
                probability=0.0,
                damage=0.0,
                sentence=f"steps of the {_WORDS[kind]} of {step / scale:.2g} {unit} that the noise does not cover, "
                f"{found.noise[worst] / step:.2g} of one: the mean of a rest errs by up to {error / scale:.2g} {unit}; "
                "log with more digits, or use a smaller range",
            )


def _held(session: _Session) -> Iterator[Cause]:
    """Samples of turns whose accelerometers and gyros all read what they read in the sample before, where that is not
    for want of resolution."""
    samples = session.observations.turn_samples
    if samples is None:
        return
    rows = same = 0
    fewest = np.zeros(6, dtype=np.int64)
    for start, stop in zip(samples.start.tolist(), samples.stop.tolist(), strict=True):
        rates, forces, _ = samples.samples.read(start, stop)
        equal = np.concatenate([np.diff(rates, axis=0) == 0.0, np.diff(forces, axis=0) == 0.0], axis=1)
        rows, same, fewest = rows + len(equal), same + int(equal.all(axis=1).sum()), fewest + equal.sum(axis=0)
    if same < FEWEST_HELD or same < 0.8 * fewest.min() or fewest.min() > 0.5 * rows:
        return
    yield Cause(
        name="lost samples",
        concerns="both",
        probability=0.0,
        damage=0.0,
        sentence=f"{same} of {rows} samples of the turns are copies of the one before, {100.0 * same / rows:.2g} %: "
        "the log holds the last sample where one is missing; record all of them",
    )


FEWEST_HELD = 3


def _lost(session: _Session, projection: Projection) -> Cause:
    """Rotations of turns that err about their own axis, with the angle, more than across it: samples that are missing
    or held. Both are scatter, so that what is compared is one with the other."""
    about = session.linearised.about
    assert about is not None
    path = np.einsum("kipp->ki", about.moments.Phi[..., RATE])
    axis = path / np.maximum(np.linalg.norm(path, axis=1, keepdims=True), 1e-9)
    size = np.sqrt(about.moments.body_rates[:, [0, 3, 5]].sum(axis=1))[:, None]
    about_axis, across_it = axis[..., None], np.swapaxes(tangent_basis(axis), 1, 2)
    along, across = (_along(session, projection, size[..., None] * d) for d in (about_axis, across_it))
    return Cause(
        name="lost samples",
        concerns="both",
        probability=_ratio_chance(along, across),
        damage=0.0,
        sentence="turns that err about their own axis, with their angle: samples are missing or held in the log; "
        "record with time stamps",
    )


def _along(session: _Session, projection: Projection, directions: Array) -> tuple[float, Array]:
    """The sum of squares along directions (K, 3, q) of the rotations, each turn's of sizes of their own."""
    rest, turn = session.nothing(directions.shape[2])
    turn[:, :3] = directions
    return _sum_of_squares(projection, apart(projection, rest, turn))


def _ratio_chance(one: tuple[float, Array], other: tuple[float, Array]) -> float:
    """Probability that chance alone makes the first of two sums Σ λ χ²₁ as large as it is beside the second, by F with
    the degrees of freedom (Σ λ)²/Σ λ² of each."""
    (above, first), (below, second) = one, other
    if min(first.sum(), second.sum(), below) <= 0.0:
        return 1.0
    m, n = (float(w.sum() ** 2 / (w**2).sum()) for w in (first, second))
    return float(special.fdtrc(m, n, above / first.sum() * second.sum() / below))


def _joined(wide: Array) -> Array:
    """Columns (N, r, …) with all indices after the second as one."""
    return wide.reshape(*wide.shape[:2], math.prod(wide.shape[2:]))
