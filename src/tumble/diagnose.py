"""What is wrong with a recording, said in sentences with cause and remedy.

`recording_faults` looks at the channels before anything is estimated, `sense_faults` asks whether the gyros carry
the vertical from rest to rest, and `verdict` turns an estimate into an outcome.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import permutations, product

import numpy as np

from tumble.estimate import SEEN, Estimate, Outcome, spreads
from tumble.model import SensorModel
from tumble.observe import Observations
from tumble.rotation import skew, tangent_basis
from tumble.segment import ChannelState, Reduction, Segmentation
from tumble.session import Channels, Session
from tumble.units import ACCEL_UNITS, DEGREE, G_STANDARD, GYRO_UNITS, Array

UNIT_TOLERANCE = 0.25
"""|a| at rest may differ from g by this part before the unit is doubted: bias and scale errors are less."""

CARRIED = 0.25
"""rad: a turn of nominal gyros misses the vertical by less, unless a unit, a sign or a column is wrong."""

FIT_SIGMAS = 5.0
SCATTER_LIMIT = 1e-3 * G_STANDARD
CHANCE = 1e-9
"""Probability below which a row of equal samples is no accident."""


def recording_faults(reduction: Reduction, session: Session) -> list[str]:
    """Faults of single channels, exchanged sensors, and an accelerometer unit that cannot be right."""
    log = session.log
    faults = [*_channel_faults(reduction.accel_channels, log.accel, reduction.rate)]
    if log.gyro is not None:
        faults += _channel_faults(reduction.gyro_channels, log.gyro, reduction.rate)
    if faults:
        return faults
    magnitude = float(np.median(np.concatenate([_magnitude(f.accel, log.accel.axes) for f in reduction.files])))
    g = session.site.gravity
    if abs(magnitude / g - 1.0) < UNIT_TOLERANCE:
        return []
    if log.gyro is not None and magnitude < 0.5 * g:
        gyros = np.concatenate([f.gyro for f in reduction.files if f.gyro is not None])
        as_accel = _as_logged_by(gyros, log.gyro, log.accel)
        exchanged = float(np.median(_magnitude(as_accel, log.accel.axes)))
        units = _fitting_units(exchanged, log.accel, g)
        if abs(exchanged / g - 1.0) < UNIT_TOLERANCE or units:
            return [
                f"accelerometer and gyro columns are exchanged: the accelerometers read {magnitude:.3g} m/s^2 and the "
                f"gyro columns have the magnitude of gravity; exchange [log.accel] columns and [log.gyro] columns"
            ]
    return [_unit_fault(magnitude, log.accel, g)]


def _unit_fault(magnitude: float, channels: Channels, g: float) -> str:
    found = f"the accelerometers read {magnitude:.4g} m/s^2 at the median, expected {g:.4g} m/s^2"
    if _raw(channels):
        return f"{found}: the nominal scale of [log.accel] is about {magnitude / g:.3g} times too small, or its offset is wrong"
    units = _fitting_units(magnitude, channels, g)
    if units:
        return f'{found}: the unit of [log.accel] is not "{channels.unit_name}"; {" or ".join(units)} would fit'
    if magnitude < UNIT_TOLERANCE * g:
        return f"{found}: gravity has been removed from the log; record the raw specific force"
    return f'{found}: the unit "{channels.unit_name}" of [log.accel] is not right, and no other known unit fits'


def _fitting_units(magnitude: float, channels: Channels, g: float) -> list[str]:
    """Rate units of accelerometers in which a magnitude logged in the stated unit would be g."""
    if _raw(channels) or channels.unit.kind != "rate":
        return []
    logged = magnitude / channels.unit.factor
    return [
        f'"{name}"'
        for name, unit in ACCEL_UNITS.items()
        if unit.kind == "rate" and abs(logged * unit.factor / g - 1.0) < UNIT_TOLERANCE
    ]


def _raw(channels: Channels) -> bool:
    return channels.unit_name in ("count", "V")


def _magnitude(readings: Array, axes: Array) -> Array:
    """|specific force| of block means from nominal sensors."""
    return np.asarray(np.linalg.norm(readings @ np.linalg.pinv(axes).T, axis=1))


def _as_logged_by(readings: Array, written: Channels, meant: Channels) -> Array:
    """Readings (SI) of one kind of channels, taken as if the columns had been those of another kind."""
    n = min(readings.shape[1], len(meant.columns))
    logged = readings[:, :n] / written.unit.factor * written.scale[:n] + written.offset[:n]
    return np.asarray((logged - meant.offset[:n]) / meant.scale[:n] * meant.unit.factor)


def _channel_faults(states: tuple[ChannelState, ...], channels: Channels, rate: float) -> Iterator[str]:
    for column, state in zip(channels.columns, states, strict=True):
        if state.minimum == state.maximum:
            yield f"column {column!r} is dead: all {state.samples} samples are {state.minimum:.6g}"
            continue
        full_scale = channels.range
        if full_scale is not None and max(abs(state.minimum), abs(state.maximum)) >= 0.9999 * full_scale:
            yield (
                f"column {column!r} is clipped: it reaches its range of {full_scale:.6g} "
                f"(about {state.extreme_stop:.2f} s); use a larger range or turn more slowly"
            )
        repeats = state.repeats / state.samples
        if repeats > 0.5:
            continue  # a recording without noise, or of coarse resolution: equal samples mean nothing
        if state.extreme_run >= 5 and _accident(repeats, state.extreme_run, state.samples):
            yield (
                f"column {column!r} is clipped: {state.extreme_run} samples in a row at its extreme value, up to "
                f"{state.extreme_stop:.2f} s; use a larger range or turn more slowly"
            )
        elif state.run >= rate and _accident(repeats, state.run, state.samples):
            yield (
                f"column {column!r} is stuck: {state.run} samples in a row are {state.run_value:.6g}, up to "
                f"{state.run_stop:.2f} s"
            )


def _accident(repeats: float, run: int, samples: int) -> bool:
    """Whether a row of `run` equal samples is beyond chance, given how often neighbours are equal."""
    return float(samples * max(repeats, 1e-6) ** (run - 1)) < CHANCE


def sense_faults(observations: Observations, session: Session) -> list[str]:
    """Whether nominal gyros carry the vertical from rest to rest, and if not, which unit, sign or exchange of
    columns would make them."""
    turns, block, channels = observations.turns, observations.gyro_block, session.log.gyro
    if turns is None or block is None or channels is None or len(turns) == 0:
        return []
    bias = np.median(observations.rests.gyro, axis=0)
    nominal = block.nominal()
    miss = _miss(observations, SensorModel(matrix=nominal.matrix, bias=bias))
    if miss < CARRIED:
        return []
    said = f"the gyros do not carry the vertical from rest to rest: they miss it by {miss / DEGREE:.0f}° at the median"
    for name, factor in _other_units(channels):
        if _miss(observations, SensorModel(matrix=nominal.matrix / factor, bias=bias)) < 0.5 * min(miss, CARRIED):
            return [f'{said}; the unit of [log.gyro] is not "{channels.unit_name}", "{name}" would fit']
    best, found = 0.5 * min(miss, CARRIED), ""
    for transform in _signed_permutations():
        trial = _miss(observations, SensorModel(matrix=nominal.matrix @ transform, bias=bias))
        if trial < best:
            best, found = trial, _described(transform)
    if found:
        return [f"{said}; {found}"]
    return [
        f"{said}, and no other unit, sign or order of columns explains it: check the columns, the unit and [log.gyro] axes"
    ]


def _miss(observations: Observations, gyro: SensorModel) -> float:
    """Median angle, rad, between the vertical after a turn carried back by the gyros and the one before it."""
    turns = observations.turns_about(gyro)
    force = observations.accel_block.nominal().apply(observations.rests.accel)
    vertical = force / np.linalg.norm(force, axis=1, keepdims=True)
    back = np.einsum("kij,kj->ki", turns.C, vertical[turns.last])
    cosine = np.einsum("ki,ki->k", back, vertical[turns.first])
    return float(np.median(np.arccos(np.clip(cosine, -1.0, 1.0))))


def _other_units(channels: Channels) -> Iterator[tuple[str, float]]:
    """Other units of the same kind as the stated one, and how much larger they are."""
    for name, unit in GYRO_UNITS.items():
        if not _raw(channels) and unit.kind == channels.unit.kind and name != channels.unit_name:
            yield name, unit.factor / channels.unit.factor


def _signed_permutations() -> list[Array]:
    """All ways to exchange columns and signs, those with the fewest changes first."""
    out = [
        np.array(signs)[:, None] * np.eye(3)[list(order)]
        for order in permutations(range(3))
        for signs in product((1.0, -1.0), repeat=3)
    ]
    return sorted(out, key=lambda m: _changes(m))


def _changes(transform: Array) -> int:
    """Columns moved and signs changed, by the simpler of the two readings (gyros or accelerometers)."""
    moved = int(np.sum(np.abs(np.diag(transform)) == 0.0))
    return moved + min(int(np.sum(transform < 0.0)), int(np.sum(transform > 0.0)) + 1)


def _described(transform: Array) -> str:
    """A signed permutation of the gyros in words: a mirror image of the accelerometers is the same thing with all
    signs changed, so the shorter of the two is said first."""
    said = []
    for sign, sensors in ((1.0, "gyro"), (-1.0, "accelerometer")):
        matrix = sign * transform
        moved = ["xyz"[p] for p in range(3) if matrix[p, p] == 0.0]
        negative = ["xyz"[p] for p in range(3) if matrix[p].sum() < 0.0]
        parts = [f"the {sensors} columns {' and '.join(moved)} are exchanged"] if moved else []
        if negative:
            parts.append(f"the sign of {sensors} {' and '.join(negative)} is wrong")
        said.append((len(moved) + len(negative), " and ".join(parts)))
    fewest = min(count for count, _ in said)
    return " or ".join(text for count, text in said if count == fewest) + " (relative to the other sensors)"


def verdict(estimate: Estimate, observations: Observations) -> Outcome:
    """Whether an estimate may be used."""
    reasons = []
    missing = estimate.unobservable
    if missing:
        reasons.append(f"not observable in this session: {', '.join(missing)}; {_most_helpful(estimate, observations)}")
    elif not estimate.converged:
        reasons.append(
            "the estimate did not converge: the data contradict the model; look at the rests with `tumble inspect`"
        )
    for name, fit in estimate.fits.items():
        if name == "accelerometers" and fit.scatter > SCATTER_LIMIT:
            reasons.append(
                f"the rests scatter by {fit.scatter / G_STANDARD * 1e3:.2g} mg, more than 1 mg: the device moved at rest, or "
                "the accelerometers do not follow the model"
            )
    reasons += _misfits(estimate, observations)
    return Outcome(reasons=tuple(reasons), unobservable=missing)


def _misfits(estimate: Estimate, observations: Observations) -> Iterator[str]:
    """Rests and turns beyond FIT_SIGMAS."""
    rests = observations.rests
    for i in np.flatnonzero(estimate.rest_sigmas > FIT_SIGMAS):
        yield (
            f"rest {i + 1} ({rests.start[i]:.1f}–{rests.stop[i]:.1f} s) does not fit: {estimate.rest_sigmas[i]:.1f} sigma, "
            f"residual {estimate.rest_residual[i]:.2g} m/s^2"
        )
    if observations.turns is None:
        return
    for k in np.flatnonzero(estimate.turn_sigmas > FIT_SIGMAS):
        a, b = observations.turns.first[k], observations.turns.last[k]
        yield (
            f"the turn from rest {a + 1} to rest {b + 1} ({rests.stop[a]:.1f}–{rests.start[b]:.1f} s) does not fit: "
            f"{estimate.turn_sigmas[k]:.1f} sigma"
        )


# What is missing


def _most_helpful(estimate: Estimate, observations: Observations) -> str:
    """The rest, or the turn, that would say most about what the data do not determine."""
    m = len(observations.accel_block.names)
    by_accel = np.abs(estimate.null[:, :m]).max(initial=0.0) > SEEN
    if by_accel:
        scores = {
            _standing(u): float(np.linalg.norm(estimate.null[:, :m] @ _rest_row(observations, u)))
            for u in _directions()
        }
        return f"the rest that would help most: {max(scores, key=lambda name: scores[name])}"
    null = estimate.null[:, m:]
    scores = {
        f"a turn of 180° about body {'XYZ'[axis]} with body {'XYZ'[up]} up before it": float(
            np.linalg.norm(null @ _turn_rows(observations, axis, up).T)
        )
        for axis in range(3)
        for up in range(3)
    }
    return f"what would help most: {max(scores, key=lambda name: scores[name])}"


def _directions() -> list[Array]:
    """Verticals of faces, edges and vertices of a cube."""
    return [np.array(s) / np.linalg.norm(s) for s in product((1.0, 0.0, -1.0), repeat=3) if any(s)]


def _standing(vertical: Array) -> str:
    """Which body axes point up and down, in words."""
    parts = [f"{'XYZ'[p]} {'up' if vertical[p] > 0 else 'down'}" for p in range(3) if abs(vertical[p]) > 1e-9]
    tilt = {1: "", 2: " (45° each)", 3: " (35° each)"}[len(parts)]
    return f"body {', '.join(parts)}{tilt}"


def _rest_row(observations: Observations, vertical: Array) -> Array:
    """What |a| at one more rest would say about the accelerometer parameters, in units of their spreads."""
    block, g = observations.accel_block, observations.site.gravity
    derivative = block.jacobian(np.zeros(len(block.names)))
    along = vertical @ np.linalg.pinv(block.axes)
    return np.asarray(np.einsum("p,pqm,q->m", along, derivative, np.append(g * vertical, 1.0)) * spreads(block))


def _turn_rows(observations: Observations, axis: int, up: int) -> Array:
    """What one more turn by 180° about a body axis would say about the gyro parameters, in units of their spreads."""
    block = observations.gyro_block
    assert block is not None
    n = np.eye(3)[axis]
    derivative = np.einsum("ap,pqm->aqm", np.linalg.pinv(block.axes), block.jacobian(np.zeros(len(block.names))))
    path = np.pi * np.outer(n, n) + 2.0 * skew(n)  # ∫ C dθ of a turn by π, Eq. (6.2)
    rows = tangent_basis(np.eye(3)[up]) @ skew(np.eye(3)[up]) @ path @ np.einsum("aqm,q->am", derivative[:, :3], n)
    return np.asarray(rows * spreads(block))


def no_rests(segmentation: Segmentation) -> Outcome:
    """The outcome of a log in which nothing rests."""
    longest = max((r.stop - r.start for r in segmentation.rejected), default=0.0)
    return Outcome(
        reasons=(
            f"no rest found: expected the device to lie still for at least 3 s in each position, the longest quiet stretch "
            f"is {longest:.1f} s; `tumble inspect` shows what was rejected",
        )
    )
