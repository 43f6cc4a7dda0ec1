"""Parameters, and combinations of them, that a session does not determine, and the rests or turns that would."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence

import numpy as np

from tumble.advice import Advised, advised, found_in, remedy_of
from tumble.diagnosis.findings import Finding, refusal, remark
from tumble.diagnosis.observability import faces_and_edges, most_informative, rest_rows, standing
from tumble.inference.estimate import DETERMINED, Estimate
from tumble.inference.noise import typical_noise
from tumble.inference.sources import common_covariances
from tumble.recording.session import Site
from tumble.reduction.observations import Observations
from tumble.rotation import onto_body, rotation_vector, skew, tangent_basis, unit_vector
from tumble.sensors.parameters import LINEAR, group_name, group_of, limits_of, sensor_kind, within_kind
from tumble.units import Array

POORLY_KNOWN = 0.05
"""Uncertainty of a combination of parameters, in units of their spreads, above which it is reported; above
1/DETERMINED it is refused."""
SHARE_OF_ACCELEROMETERS = 0.1
"""Norm of the accelerometer part of a combination of unit length; a smaller part comes from unknown gyros."""
SHORTEST_TURN = 1e-9  # rad: a shorter turn has no axis
MOST_NAMES = 21  # parameters that are listed one by one


def linear_names(names: Sequence[str]) -> tuple[str, ...]:
    """Return the names of the parameters that belong to the linear model."""
    linear = {group.name for group in LINEAR}
    return tuple(name for name in names if group_name(name) in linear)


def undetermined(estimate: Estimate, observations: Observations, missing: tuple[str, ...]) -> list[Finding]:
    """Return findings about parameters that the data do not determine, and what would determine them.

    `missing` are the undetermined parameters. For kinds of sensors without such parameters, poorly determined
    combinations are reported, and refused if u does not hold for them."""
    findings = list[Finding]()
    if missing:
        sentence = f"not observable in this session: {parameter_list(missing)}"
        if one_vertical := one_attitude(observations):
            found, remedy = f"{found_in(one_vertical)}; {sentence}", remedy_of(one_vertical)
        else:
            block, rests = observations.accel_block, len(observations.rests)
            needed = len(linear_names(block.names)) if block.size == len("xyz") else 0
            kinds = {sensor_kind(name) for name in missing}
            too_few = f"{rests} rests of the {needed} needed; " if "accel" in kinds and rests < needed else ""
            turns = observations.turns_left_out if "gyro" in kinds else ()
            left_out = "".join(f"{turn}; " for turn in turns[:1])
            if len(turns) > 1:
                left_out = f"{turns[0]} (and {len(turns) - 1} more); "
            found, remedy = f"{too_few}{left_out}{sentence}", _most_helpful(estimate, observations, estimate.null)
        findings.append(refusal(found, remedy, concerns=tuple(dict.fromkeys(map(group_name, missing)))))
    combinations, u, refused = _poorly_determined(estimate, observations, {sensor_kind(name) for name in missing})
    described, concerned = list[str](), set[str]()
    for combination, each_u in zip(combinations, u, strict=True):
        order = np.argsort(-np.abs(combination)).tolist()
        parts = [i for i in order[:4] if abs(combination[i]) > 0.5 * abs(combination[order[0]])]
        sign = np.sign(combination[parts[0]])
        terms = " ".join(f"{'+' if sign * combination[i] > 0 else '−'} {estimate.names[i]}" for i in parts)
        described.append(f"{terms.removeprefix('+ ')} (known to {100.0 * each_u:.2g} % of its usual size)")
        concerned |= {group_name(estimate.names[i]) for i in parts}
    if described:
        found = f"poorly observable in this session: {'; '.join(described)}"
        sentence = advised(found, _most_helpful(estimate, observations, combinations))
        # accelerometers first: if they are among them, rests are missing, and they are no better alone
        findings.append(Finding(sentence=sentence, concerns=tuple(sorted(concerned)), refuses=refused))
    return findings


def faces_alone(estimate: Estimate, missing: Sequence[str]) -> bool:
    """Return True if only axis angles of a triad of accelerometers are undetermined, as by six faces."""
    angles = all(group_name(name) == "accel.axis" for name in missing)
    return bool(missing) and angles and estimate.gyro is None and len(estimate.accel.bias) == len("xyz")


def six_faces(estimate: Estimate, observations: Observations, missing: Sequence[str]) -> Finding:
    """Return the remark on a session of accelerometers without oblique rests."""
    return remark(
        "six faces give bias and scale factor of each axis alone: not observable in this session and taken as 0 is "
        f"{parameter_list(missing)}, whose usual size u includes",
        _most_helpful(estimate, observations, estimate.null),
        concerns=("accel",),
    )


def one_attitude(observations: Observations) -> str:
    """Return a sentence if the vertical in the body is the same in all rests, else an empty text."""
    if not observations.one_vertical:
        return ""
    N = len(observations.rests)
    counted = "1 rest" if N == 1 else f"all {N} rests"
    return Advised(
        f"the device lay in one attitude ({counted}), which calibrates nothing",
        "put it down in others too, 5 s in each (`tumble programme` lists them); `tumble noise` gives the noise of a "
        "recording at rest",
    )


def parameter_list(names: Sequence[str]) -> str:
    """Return parameters by name or, if there are many, by group with their number: "accel.axis (12)"."""
    if len(names) <= MOST_NAMES:
        return ", ".join(names)
    return ", ".join(f"{group} ({count})" for group, count in Counter(map(group_name, names)).items())


def _poorly_determined(estimate: Estimate, observations: Observations, without: set[str]) -> tuple[Array, Array, bool]:
    """Return poorly determined combinations (q, m) of linear parameters in units of spreads, the worst first, their u
    (q,) in these units, and whether one is too uncertain for use; kinds of sensors `without` are left out.

    Spreads are the limits of parameters, times √(n/3) for n sensors of a kind, so that a combination of unit length in
    which all n err alike counts as one of a triad in which all three do. A combination is refused also where the square
    of the uncertainty of scale factors and angles is not small against what the data resolve, as effects of second
    order are then not in u."""
    linear = linear_names(estimate.names)
    kept = [i for i, name in enumerate(linear) if sensor_kind(name) not in without]
    blocks = (observations.accel_block, observations.gyro_block)
    factor: dict[str, float] = {block.kind: np.sqrt(block.size / 3.0) for block in blocks if block is not None}
    spread = (limits_of(linear) * [factor[sensor_kind(name)] for name in linear])[kept]
    # no further rest would reduce errors that are common to all rests
    gravity_u = observations.site.gravity_u / observations.site.gravity
    by_gravity = [gravity_u if group_name(name) == "accel.scale" else 0.0 for name in estimate.names]
    covariance = estimate.covariance - np.outer(by_gravity, by_gravity)
    if estimate.instrument is not None:
        covariance = covariance - sum(common_covariances(observations, estimate.instrument).values())
    variance, vectors = np.linalg.eigh(covariance[np.ix_(kept, kept)] / np.outer(spread, spread))
    nonlinear = np.array([within_kind(group_name(linear[i])) != "bias" for i in kept], dtype=bool)
    squared = variance * (vectors[nonlinear] ** 2).sum(axis=0) * group_of("accel.axis").limit ** 2
    refused = (variance > DETERMINED**-2) | (squared > _resolution(estimate, observations))
    poor = np.flatnonzero((variance > POORLY_KNOWN**2) | refused)[::-1]
    combinations = np.zeros((len(poor), len(linear)))
    combinations[:, kept] = vectors[:, poor].T
    return combinations, np.sqrt(variance[poor]), bool(refused.any())


def _resolution(estimate: Estimate, observations: Observations) -> float:
    """Return the angle, rad, that both rests and turns resolve, scatter included."""

    def typical(covariance: Array, group: str) -> float:
        return math.hypot(typical_noise(covariance), estimate.fits[group].scatter if group in estimate.fits else 0.0)

    tilt = typical(observations.rests.accel_covariance, "accelerometers") / observations.site.gravity
    if observations.turns is None or not len(observations.turns) or estimate.gyro is None:
        return tilt
    return max(tilt, typical(observations.turns.covariance, "gyro turns"))


def uncertain_gravity(site: Site) -> Iterator[Finding]:
    """Yield a remark if the uncertainty of gravity makes all scale factors of accelerometers uncertain."""
    relative = site.gravity_u / site.gravity
    if np.sqrt(3.0) * relative < POORLY_KNOWN * group_of("accel.scale").limit:
        return
    yield remark(
        f"gravity is {site.gravity:.5f} m/s^2 with a standard uncertainty of {site.gravity_u:.2g} m/s^2: the common "
        f"scale of the accelerometers is known to {100.0 * relative:.2g} % only, which u includes",
        "state latitude_deg and height_m in [site] (--latitude, --height), or gravity",
        concerns=("accel.scale",),
    )


def _most_helpful(estimate: Estimate, observations: Observations, unseen: Array) -> str:
    """Return the rests or turns that would determine combinations `unseen` (q, m) of parameters, the most useful first.

    If the rests or turns of the session show a combination at least as well as any further one would, it is lost in
    noise, and no attitude is missing."""
    m = len(observations.accel_block.names)
    of_accel = np.linalg.norm(unseen[:, :m], axis=1) > SHARE_OF_ACCELEROMETERS
    if of_accel.any():
        block, g = observations.accel_block, observations.site.gravity
        spread = limits_of(block.names)
        further = {standing(u): rest_rows(block, u[None], g)[0] * spread for u in faces_and_edges()}
        recorded = rest_rows(block, unit_vector(block.nominal().apply(observations.rests.accel)), g) * spread
        what, unseen = "rests", unseen[of_accel, :m]
    else:
        eye = np.eye(3)
        further = {
            f"180° about {'XYZ'[axis]} from {'XYZ'[up]} up": _turn_rows(observations, np.pi * eye[axis], eye[up])
            for up in range(3)
            for axis in range(3)
        }
        vertical = unit_vector(observations.accel_block.nominal().apply(observations.rests.accel))
        turns, of_turns = observations.turns, list[Array]()
        if turns is not None and len(turns):
            paths = zip(rotation_vector(turns.C), vertical[turns.first], strict=True)
            of_turns = [_turn_rows(observations, path, up) for path, up in paths]
        recorded, what, unseen = np.array(of_turns), "turns", unseen[:, m:]
    most = np.max([np.linalg.norm(rows @ unseen.T, axis=0) for rows in further.values()], axis=0)
    in_noise = np.linalg.norm(recorded.reshape(-1, unseen.shape[1]) @ unseen.T, axis=0) >= most
    helpful, others = most_informative(unseen[~in_noise], further)
    parts = list[str]()
    if helpful:
        parts.append(f"{what} that would help, the most helpful first: {', '.join(helpful)}")
    if others and of_accel.any() and observations.gyro_block is not None and estimate.method == "joint":
        parts.append("turns about other axes would show the others")  # gyro parameters, which no rest determines
    elif others:
        parts.append(f"the others no further {what} would show to the method {estimate.method}")
    if in_noise.any():
        parts.append(
            f"the {what} there are would show {'the others' if parts else 'it'} if they were quieter: let the "
            "device lie still, on something firm, for longer"
        )
    return "; ".join(parts)


def _turn_rows(observations: Observations, path: Array, up: Array) -> Array:
    """Return the sensitivity (2, m), rad, of a turn to the gyro parameters in units of their spreads.

    The turn is by the rotation vector `path` (3,) from the vertical `up` (3,), both in the body."""
    block, angle = observations.gyro_block, float(np.linalg.norm(path))
    assert block is not None
    n = path / max(angle, SHORTEST_TURN)
    derivative = np.einsum("ap,pqm->aqm", onto_body(block.axes), block.jacobian(np.zeros(len(block.names))))
    # ∫ C dψ over the angle, Eq. (6.2) of the turntable paper
    integral = np.sin(angle) * np.eye(3) + (1.0 - np.cos(angle)) * skew(n) + (angle - np.sin(angle)) * np.outer(n, n)
    rows = tangent_basis(up) @ skew(up) @ integral @ np.einsum("aqm,q->am", derivative[:, :3], n)
    return np.asarray(rows * limits_of(block.names))
