"""Parameters and combinations of them that a session does not determine, in words, and what would determine them."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence

import numpy as np

from tumble.diagnosis.findings import Finding, refusal, remark
from tumble.diagnosis.observability import faces_and_edges, most_telling, rows_of_rests, standing
from tumble.inference.estimate import DETERMINED, Estimate
from tumble.inference.noise import typical_noise
from tumble.inference.sources import common_covariances
from tumble.recording.session import Site
from tumble.reduction.observations import Observations
from tumble.rotation import onto_body, rotation_vector, skew, tangent_basis, unit_vector
from tumble.sensors.parameters import LINEAR, group_name, group_of, limits_of, sensor_kind, within_kind
from tumble.units import Array

POORLY_KNOWN = 0.05
"""Of the spreads: that a combination of parameters of a triad is known no better is said, and of one of more sensors
where all err alike by as much; where it is known less than DETERMINED times better than its spread it is refused."""

MIXED = 0.1
"""Part of accelerometers in a combination of parameters of unit length: less comes with gyros that are not known."""
SHORTEST = 1e-9
"""rad: a shorter turn is about no axis."""

MOST_LISTED = 21
"""Parameters that are named one by one."""


def linear_names(names: Sequence[str]) -> tuple[str, ...]:
    """Those of these parameters that belong to the linear model. They come first in an estimate; the others have
    priors."""
    linear = {group.name for group in LINEAR}
    return tuple(name for name in names if group_name(name) in linear)


def undetermined(estimate: Estimate, observations: Observations, missing: tuple[str, ...]) -> list[Finding]:
    """What the data do not determine, the parameters that are `missing`; and of kinds of sensors of which none is, the
    combinations that they determine poorly: a remark where these are as well known as u says. With what would help."""
    findings = list[Finding]()
    if missing:
        alone = one_attitude(observations)
        helpful = "" if alone else _most_helpful(estimate, observations, estimate.null)
        unseen = f"not observable in this session: {listed(missing)}"
        few = "" if alone else _too_few(observations, missing)
        findings.append(refusal(_and(alone, few, unseen, helpful), *groups_of(missing)))
    combinations, known, refused = _weak(estimate, observations, {sensor_kind(name) for name in missing})
    if len(known):
        largest, weak = [_largest_of(combination) for combination in combinations], list[str]()
        for combination, parts, u in zip(combinations, largest, known, strict=True):
            sign = np.sign(combination[parts[0]])
            terms = " ".join(f"{'+' if sign * combination[i] > 0 else '−'} {estimate.names[i]}" for i in parts)
            weak.append(f"{terms.removeprefix('+ ')} (known to {100.0 * u:.2g} % of its usual size)")
        remedy = _most_helpful(estimate, observations, combinations)
        concerned = groups_of([estimate.names[i] for parts in largest for i in parts])
        sentence = _and(f"poorly observable in this session: {'; '.join(weak)}", remedy)
        findings.append(Finding(sentence=sentence, concerns=concerned, refuses=refused))
    return findings


def faces_alone(estimate: Estimate, missing: Sequence[str]) -> bool:
    """Whether a session shows bias and scale factor of every accelerometer of a triad and, as six faces do, no angles
    between their axes."""
    angles = all(group_name(name) == "accel.axis" for name in missing)
    return bool(missing) and angles and estimate.gyro is None and len(estimate.accel.bias) == len("xyz")


def as_six_faces_give(estimate: Estimate, observations: Observations, missing: Sequence[str]) -> Finding:
    """What a session without oblique rests gives, and which rests would show the rest."""
    said = (
        "bias and scale factor of each axis alone, as six faces give them: not observable in this session and taken "
        f"as 0 is {listed(missing)}, of which u contains any usual size"
    )
    return remark(_and(said, _most_helpful(estimate, observations, estimate.null)), "accel")


def one_attitude(observations: Observations) -> str:
    """That the device lay in one attitude only, or nothing."""
    if not observations.one_vertical:
        return ""
    N = len(observations.rests)
    counted = "1 rest" if N == 1 else f"all {N} rests"
    return (
        f"the device lay in one attitude ({counted}), which calibrates nothing: put it down in others too, 5 s in "
        "each (`tumble programme` lists them); the noise of a recording at rest is told by `tumble noise`"
    )


def _too_few(observations: Observations, missing: Sequence[str]) -> str:
    """That there are fewer rests than the accelerometers of a triad have parameters, and which turns were left out."""
    block, rests = observations.accel_block, len(observations.rests)
    needed = len(linear_names(block.names)) if block.size == len("xyz") else 0
    kinds = {sensor_kind(name) for name in missing}
    few = f"{rests} rests of the {needed} needed" if "accel" in kinds and rests < needed else ""
    left_out = observations.turns_left_out if "gyro" in kinds else ()
    more = f" (and {len(left_out) - 1} more)" if len(left_out) > 1 else ""
    return _and(few, f"{left_out[0]}{more}" if left_out else "")


def _and(*parts: str) -> str:
    """What there is to say, separated by semicolons."""
    return "; ".join(part for part in parts if part)


def groups_of(parameters: Sequence[str]) -> tuple[str, ...]:
    """The groups of parameters, each once."""
    return tuple(dict.fromkeys(map(group_name, parameters)))


def listed(names: Sequence[str]) -> str:
    """Parameters by name, or where they are many by group: "accel.axis (12), accel.scale (6)"."""
    if len(names) <= MOST_LISTED:
        return ", ".join(names)
    counted = Counter(group_name(name) for name in names)
    return ", ".join(f"{group} ({count})" for group, count in counted.items())


def _weak(estimate: Estimate, observations: Observations, without: set[str]) -> tuple[Array, Array, bool]:
    """Combinations (q, m) of the parameters of the linear model, in units of their spreads, that the data determine
    poorly or not at all, the worst first, how well they are known, in the same units, and whether one too
    poorly for use; `without` those of some kinds of sensors. Spreads are the limits of parameters, wider by √(n/3) for
    n sensors of a kind: a combination of unit length of n sensors that err alike is then known as well as one of a
    triad whose three err by as much. Too poorly is also where the square of the uncertainty of scale factors and angles
    is not small against what the data resolve: u does not hold then, for effects of second order count."""
    linear = linear_names(estimate.names)
    some = [i for i, name in enumerate(linear) if sensor_kind(name) not in without]
    blocks = (observations.accel_block, observations.gyro_block)
    wider: dict[str, float] = {block.kind: np.sqrt(block.size / 3.0) for block in blocks if block is not None}
    spread = (limits_of(linear) * [wider[sensor_kind(name)] for name in linear])[some]
    # what is common to all rests no further rest would show
    relative = observations.site.gravity_u / observations.site.gravity  # by which scale factors are uncertain together
    common = [relative if group_name(name) == "accel.scale" else 0.0 for name in estimate.names]
    covariance = estimate.covariance - np.outer(common, common)
    if estimate.instrument is not None:
        covariance = covariance - sum(common_covariances(observations, estimate.instrument).values())
    variance, vectors = np.linalg.eigh(covariance[np.ix_(some, some)] / np.outer(spread, spread))
    angles = np.array([within_kind(group_name(linear[i])) != "bias" for i in some], dtype=bool)  # biases are linear
    squared = variance * (vectors[angles] ** 2).sum(axis=0) * group_of("accel.axis").limit ** 2
    refused = (variance > DETERMINED**-2) | (squared > _resolution(estimate, observations))
    poor = np.flatnonzero((variance > POORLY_KNOWN**2) | refused)[::-1]
    combinations = np.zeros((len(poor), len(linear)))
    combinations[:, some] = vectors[:, poor].T
    return combinations, np.sqrt(variance[poor]), bool(refused.any())


def _resolution(estimate: Estimate, observations: Observations) -> float:
    """The angle, rad, that the rests and turns both resolve, scatter included."""

    def typical(covariance: Array, group: str) -> float:
        return math.hypot(typical_noise(covariance), estimate.fits[group].scatter if group in estimate.fits else 0.0)

    tilt = typical(observations.rests.accel_covariance, "accelerometers") / observations.site.gravity
    if observations.turns is None or not len(observations.turns) or estimate.gyro is None:
        return tilt
    return max(tilt, typical(observations.turns.covariance, "gyro turns"))


def gravity_wanted(site: Site) -> Iterator[Finding]:
    """That gravity is not known well enough for the scale factors of accelerometers, which are all as uncertain."""
    relative = site.gravity_u / site.gravity
    if np.sqrt(3.0) * relative < POORLY_KNOWN * group_of("accel.scale").limit:
        return
    yield remark(
        f"gravity is {site.gravity:.5f} m/s^2 with a standard uncertainty of {site.gravity_u:.2g} m/s^2: all scale "
        f"factors of the accelerometers together are known to {100.0 * relative:.2g} % only, which u contains; state "
        "latitude_deg and height_m in [site] (--latitude, --height), or gravity",
        "accel.scale",
    )


def _largest_of(combination: Array) -> list[int]:
    """Which parameters a combination (m,) consists of for the most part, the largest first."""
    order = np.argsort(-np.abs(combination))
    return [int(i) for i in order[:4] if abs(combination[i]) > 0.5 * abs(combination[order[0]])]


def _most_helpful(estimate: Estimate, observations: Observations, unseen: Array) -> str:
    """The rests, or the turns, that together would say what the data do not determine, the most telling first; `unseen`
    (q, m) are combinations of parameters. One that the session's own rests or turns show at least as well as any
    further one would is lost in their noise: no attitude is missing."""
    m = len(observations.accel_block.names)
    of_accel = np.linalg.norm(unseen[:, :m], axis=1) > MIXED
    if of_accel.any():
        block, g = observations.accel_block, observations.site.gravity
        spread = limits_of(block.names)
        further = {standing(u): rows_of_rests(block, u[None], g)[0] * spread for u in faces_and_edges()}
        own = rows_of_rests(block, unit_vector(block.nominal().apply(observations.rests.accel)), g) * spread
        what, unseen = "rests", unseen[of_accel, :m]
    else:
        further = {
            f"180° about {'XYZ'[axis]} from {'XYZ'[up]} up": _turn_rows(
                observations, np.pi * np.eye(3)[axis], np.eye(3)[up]
            )
            for up in range(3)
            for axis in range(3)
        }
        own, what, unseen = _rows_of_turns(observations), "turns", unseen[:, m:]
    most = np.max([np.linalg.norm(rows @ unseen.T, axis=0) for rows in further.values()], axis=0)
    shown = np.linalg.norm(own.reshape(-1, unseen.shape[1]) @ unseen.T, axis=0) >= most
    helpful, others = most_telling(unseen[~shown], further)
    other = (
        "turns about other axes would show the others"  # of the gyros, which no rest shows
        if of_accel.any() and observations.gyro_block is not None and estimate.method == "joint"
        else f"the others no further {what} would show to the method {estimate.method}"
    )
    return _and(
        f"{what} that would help, the most helpful first: {', '.join(helpful)}" if helpful else "",
        other if others else "",
        f"the {what} there are would show {'the others' if helpful or others else 'it'} if they were quieter: let the "
        "device lie still, on something firm, for longer"
        if shown.any()
        else "",
    )


def _rows_of_turns(observations: Observations) -> Array:
    """What the turns of a session say about the gyro parameters, as of nominal sensors: (K, 2, m)."""
    turns, block = observations.turns, observations.gyro_block
    if turns is None or block is None or not len(turns):
        return np.zeros((0, 2, 0 if block is None else len(block.names)))
    vertical = unit_vector(observations.accel_block.nominal().apply(observations.rests.accel))
    paths = rotation_vector(turns.C)
    return np.array([_turn_rows(observations, path, vertical[k]) for path, k in zip(paths, turns.first, strict=True)])


def _turn_rows(observations: Observations, path: Array, up: Array) -> Array:
    """What a turn by the rotation vector `path` (3,) from the vertical `up` (3,), both in the body, says about the gyro
    parameters, in units of their spreads: (2, m), rad."""
    block, angle = observations.gyro_block, float(np.linalg.norm(path))
    assert block is not None
    n = path / max(angle, SHORTEST)
    derivative = np.einsum("ap,pqm->aqm", onto_body(block.axes), block.jacobian(np.zeros(len(block.names))))
    # ∫ C dψ over the angle, Eq. (6.2)
    integral = np.sin(angle) * np.eye(3) + (1.0 - np.cos(angle)) * skew(n) + (angle - np.sin(angle)) * np.outer(n, n)
    rows = tangent_basis(up) @ skew(up) @ integral @ np.einsum("aqm,q->am", derivative[:, :3], n)
    return np.asarray(rows * limits_of(block.names))
