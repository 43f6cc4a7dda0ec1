"""What is wrong with a recording, said in sentences with cause and remedy.

`recording_faults` looks at the channels before anything is estimated, `sense_faults` asks whether the gyros carry
the vertical from rest to rest, and `verdict` turns an estimate into an outcome.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import permutations, product

import numpy as np

from tumble.earth import EARTH_RATE, normal_gravity
from tumble.estimation.causes import Concerns
from tumble.estimation.common_errors import common_covariance
from tumble.estimation.estimate import FIT_SIGMAS, SEEN, Estimate, Outcome
from tumble.estimation.misfit import misfit
from tumble.estimation.observability import faces_and_edges, most_telling, standing
from tumble.programme.positions import from_attitudes, programme
from tumble.recording.session import Channels, Session, Site
from tumble.reduction.blocks import ChannelState, Reduction
from tumble.reduction.observations import Observations
from tumble.reduction.segmentation import STILL_SECONDS, Segmentation
from tumble.rotation import onto_body, skew, tangent_basis, unit_vector
from tumble.sensors.model import SensorModel
from tumble.sensors.parameters import LINEAR, group_name, group_of, limits_of
from tumble.units import ACCEL_UNITS, DEGREE, G_STANDARD, GYRO_UNITS, TIME_UNITS, Array, Unit

UNIT_TOLERANCE = 0.25
"""|a| at rest may differ from g by this part before the unit is doubted: bias and scale errors are less."""

CARRIED = 0.25
"""rad: the turns of nominal gyros miss the vertical by less at the mean, unless a unit, a sign or a column is wrong."""

EVIDENT = 0.5
"""rad: no half turn of nominal gyros misses the vertical by as much: bias, scale and axis errors of 5 % leave less."""

SMALL_SCALE_ERROR = 0.1
"""Scale-factor errors that a calibration is for."""

UPRIGHT = 20.0 * DEGREE
"""How far a rest may be from its position of the programme to count as that position, or as it upside down."""

FASTEST_TURN = 10.0
"""rad/s: by hand or on a table."""

BIAS_LIMIT = 100.0
"""rad/s: what no gyro measures, let alone as its bias."""

REST_SHARE = 0.2
"""At least this part of a recording is rest: there a sample of coarse resolution equals the one before."""

POORLY_KNOWN = 0.05
"""Of the spreads: a combination of parameters that is known no better is poorly observable."""

SCATTER_LIMIT = 1e-3 * G_STANDARD
TURN_SCATTER_LIMIT = 1.0 * DEGREE
IMPOSSIBLE = 1e10
"""SI: no sensor reads as much, in whatever unit its log is taken to be."""

MILLIGAL = 1e-5  # m/s²
GRAVITY_DOUBTED = 300.0 * MILLIGAL
GRAVITY_REFUSED = 1100.0 * MILLIGAL
"""Anomalies of gravity on Earth reach 300 mGal on land in a few places; nowhere 1,000. The limit lets the value through
that imu_tk takes for its recording, 1,091 mGal more than normal gravity, which published results rest on."""

CHANCE = 1e-9
"""Probability below which a row of equal samples is no accident."""


def recording_faults(reduction: Reduction, session: Session) -> list[str]:
    """Faults of single channels, exchanged sensors, and an accelerometer unit that cannot be right."""
    log = session.log
    accel = np.concatenate([f.accel for f in reduction.files])
    gyros = np.concatenate([f.gyro for f in reduction.files if f.gyro is not None] or [np.empty((0, 0))])
    faults = [*_channel_faults(reduction.accel_channels, accel, log.accel, reduction.rate, "use a larger range")]
    if log.gyro is not None:
        advice = "use a larger range or turn more slowly"
        faults += _channel_faults(reduction.gyro_channels, gyros, log.gyro, reduction.rate, advice)
    if faults:
        return faults
    force = accel @ onto_body(log.accel.axes).T
    magnitude = float(np.median(np.linalg.norm(force, axis=1)))
    g = session.site.gravity
    if abs(magnitude / g - 1.0) < UNIT_TOLERANCE:
        return []
    if log.gyro is not None:
        meant = _as_logged_by(gyros, log.gyro, log.accel)
        exchanged = float(np.median(np.linalg.norm(meant, axis=1)))
        fits = abs(exchanged / g - 1.0) < UNIT_TOLERANCE and _like_gravity(meant)
        if fits or (magnitude < 0.5 * g and _fitting_units(exchanged, log.accel, g, reduction.rate, ("rate",))):
            return [
                f"accelerometer and gyro columns are exchanged: the accelerometers read {magnitude:.3g} m/s^2 and the "
                f"gyro columns have the magnitude of gravity; exchange [log.accel] columns and [log.gyro] columns"
            ]
    return [_unit_fault(force, magnitude, log.accel, g, reduction.rate)]


def _unit_fault(force: Array, magnitude: float, channels: Channels, g: float, rate: float) -> str:
    found = f"the accelerometers read {magnitude:.4g} m/s^2 at the median, expected {g:.4g} m/s^2"
    if _raw(channels):
        return f"{found}: {_scale_or_offset(force, magnitude, channels, g)}"
    units = _fitting_units(magnitude, channels, g, rate, ("rate", "increment") if _like_gravity(force) else ("rate",))
    if units:
        return f'{found}: the unit of [log.accel] is not "{channels.unit_name}"; {" or ".join(units)} would fit'
    if magnitude < UNIT_TOLERANCE * g:
        return f"{found}: gravity has been removed from the log; record the raw specific force"
    return f'{found}: the unit "{channels.unit_name}" of [log.accel] is not right, and no other known unit fits'


def _scale_or_offset(force: Array, magnitude: float, channels: Channels, g: float) -> str:
    """What is wrong with raw accelerometers: the offset where gravity shows about the middle of the readings, else
    the scale."""
    middle = 0.5 * (force.min(axis=0) + force.max(axis=0))
    about = float(np.median(np.linalg.norm(force - middle, axis=1)))
    if np.linalg.norm(middle) > 2.0 * g and abs(about / g - 1.0) < 2.0 * UNIT_TOLERANCE:
        raw = channels.offset + channels.scale * (channels.axes @ middle) / channels.unit.factor
        return f"the offset of [log.accel] is wrong; about {', '.join(f'{v:.4g}' for v in raw)} would fit"
    for name in ("m/s^2", "g"):
        if abs(magnitude / channels.unit.factor * ACCEL_UNITS[name].factor / g - 1.0) < UNIT_TOLERANCE:
            return f'the scale of [log.accel] would fit with scale_per = "{name}"'
    return f"the nominal scale of [log.accel] is about {_times(magnitude / g)}, or its offset is wrong"


def _times(ratio: float) -> str:
    """How wrong a nominal scale is whose readings are `ratio` times what they should be."""
    return f"{ratio:.3g} times too small" if ratio > 1.0 else f"{1.0 / ratio:.3g} times too large"


def _fitting_units(magnitude: float, channels: Channels, g: float, rate: float, kinds: tuple[str, ...]) -> list[str]:
    """Units of accelerometers of these kinds in which a magnitude logged in the stated unit would be g."""
    if _raw(channels):
        return []
    return [
        f'"{name}"'
        for name, unit in ACCEL_UNITS.items()
        if unit.kind in kinds
        and abs(magnitude * _per_second(unit, rate) / _per_second(channels.unit, rate) / g - 1.0) < UNIT_TOLERANCE
    ]


def _per_second(unit: Unit, rate: float) -> float:
    """What a number in this unit is worth as a mean rate (m/s² or rad/s) over a sample."""
    return unit.factor * (rate if unit.kind == "increment" else 1.0)


def _like_gravity(force: Array) -> bool:
    """Whether vectors (K, 3) have one length and many directions: not what is left where gravity was removed."""
    length = np.linalg.norm(force, axis=1)
    low, median, high = np.quantile(length, [0.25, 0.5, 0.75])
    about = float(np.median(np.linalg.norm(force - np.median(force, axis=0), axis=1)))
    return bool(high - low < UNIT_TOLERANCE * median and about > UNIT_TOLERANCE * median)


def _raw(channels: Channels) -> bool:
    return channels.unit_name in ("count", "V")


def _as_logged_by(readings: Array, written: Channels, meant: Channels) -> Array:
    """Readings (SI) of one kind of channels, taken as if the columns had been those of another kind, as vectors."""
    n = min(readings.shape[1], len(meant.columns))
    logged = readings[:, :n] / written.unit.factor * written.scale[:n] + written.offset[:n]
    meant_si = (logged - meant.offset[:n]) / meant.scale[:n] * meant.unit.factor
    return np.asarray(meant_si @ onto_body(meant.axes[:n]).T)


def _channel_faults(
    states: tuple[ChannelState, ...], means: Array, channels: Channels, rate: float, advice: str
) -> Iterator[str]:
    """Dead, clipped and stuck channels; `means` (K, n) are those of blocks, in SI."""
    for i, (column, state) in enumerate(zip(channels.columns, states, strict=True)):
        extreme = max(state.minimum, state.maximum, key=abs)
        if abs(extreme) > IMPOSSIBLE:
            yield (
                f"column {column!r} is damaged: it reads {_logged(extreme, channels, i, rate)}, which no sensor does; "
                "remove such rows or write nan in them"
            )
            continue
        if state.minimum == state.maximum:
            value = _logged(state.minimum, channels, i, rate)
            yield f"column {column!r} is dead: all {state.samples} samples are {value}"
            continue
        at_end = np.isclose(means[:, [i]], [state.minimum, state.maximum], rtol=1e-12, atol=0.0).any(axis=1)
        saturated = max(state.extreme_run, round(float(at_end.mean()) * state.samples))
        full_scale = channels.range
        if full_scale is not None and abs(extreme) >= 0.9999 * full_scale:
            yield (
                f"column {column!r} is clipped: it reaches its range, {state.extreme_run or 1} samples in a row up to "
                f"{state.extreme_stop:.2f} s; {advice}"
            )
        elif state.extreme_run >= 5 and _no_accident(state, state.extreme_run, saturated):
            yield (
                f"column {column!r} is clipped: {state.extreme_run} samples in a row at its extreme value, up to "
                f"{state.extreme_stop:.2f} s; {advice}"
            )
        elif state.run >= rate and _no_accident(state, state.run, state.run):
            yield (
                f"column {column!r} is stuck: {state.run} samples in a row are "
                f"{_logged(state.run_value, channels, i, rate)}, up to {state.run_stop:.2f} s"
            )


def _logged(value: float, channels: Channels, sensor: int, rate: float) -> str:
    """A reading (SI) as the log has it."""
    number = value / _per_second(channels.unit, rate) * channels.scale[sensor] + channels.offset[sensor]
    return f"{number:.6g} {channels.unit_name}"


def _no_accident(state: ChannelState, run: int, explained: int) -> bool:
    """Whether a row of `run` equal samples is beyond chance, given how often neighbours are equal elsewhere than in
    the `explained` samples; those may all be at rest, as they are where the resolution is coarse."""
    elsewhere = max(state.repeats - explained, 0) / (REST_SHARE * state.samples)
    return float(state.samples * min(max(elsewhere, 1e-6), 1.0) ** (run - 1)) < CHANCE


def sense_faults(observations: Observations, session: Session, rate: float) -> list[str]:
    """Whether nominal gyros carry the vertical from rest to rest, and if not, which unit, scale, sign or exchange of
    columns would make them; and whether up is up. `rate`: samples per second."""
    turns, block, channels = observations.turns, observations.gyro_block, session.log.gyro
    if turns is None or block is None or channels is None or len(turns) == 0:
        return _upside_down(observations, session)
    bias = np.median(observations.rests.gyro, axis=0)
    nominal = block.nominal()
    assumed = SensorModel(matrix=nominal.matrix, bias=bias)
    miss = _misses(observations, assumed)
    if miss.max() < EVIDENT:
        largest = float(np.abs(bias).max())
        if largest > BIAS_LIMIT:
            return [f"the gyros read {largest:.3g} rad/s at rest, as no gyro does: the offset of [log.gyro] is wrong"]
        return _upside_down(observations, session)
    said = (
        "the gyros do not carry the vertical from rest to rest: they miss it by "
        f"{miss.max() / DEGREE:.0f}° at worst and by {np.median(miss) / DEGREE:.0f}° at the median of {len(miss)} turns"
    )

    def explains(matrix: Array) -> float:
        return _explains(observations, SensorModel(matrix=matrix, bias=bias), miss)

    unit = _fitting_unit(observations, channels, rate, assumed, miss)
    if unit is not None:
        return [f"{said}; {_unit_named(channels, unit)} would fit"]
    for name, factor in TIME_UNITS.items():
        if session.log.time is not None and explains(nominal.matrix * session.log.time_factor / factor) < np.inf:
            return [f'{said}; log.time_unit = "{name}" would fit']
    trials = [(t, explains(nominal.matrix @ t)) for t in _signed_permutations()]
    best = min(trial for _, trial in trials)
    if best < np.inf:
        simplest = next(t for t, trial in trials if trial <= 1.5 * best + 0.1 * CARRIED)
        return [f"{said}; {_described(simplest)}"]
    scales = [(explains(nominal.matrix * ratio), float(ratio)) for ratio in np.geomspace(0.2, 5.0, 131)]
    best, ratio = min(scales)
    if best < np.inf:
        if abs(np.log(ratio)) < SMALL_SCALE_ERROR:  # many revolutions
            return _upside_down(observations, session)
        suspects = ["the nominal scale of [log.gyro]"] if _raw(channels) else []
        suspects += ["log.rate_hz"] if session.log.rate is not None else []
        seen = f"the gyros read about {ratio:.3g} times what they should"
        return [f"{said}; {seen}" + (f": {' or '.join(suspects)} is {_times(ratio)}" if suspects else "")]
    if _raw(channels) and np.all(channels.scale == 1.0):
        return [
            f"{said}: log.gyro.scale is 1, as if the numbers were no raw ones; write the counts per deg/s of the data "
            "sheet (16.4, 32.8, 65.5, 131 …), or let `tumble new` find them from the turns"
        ]
    per_half_turn = miss / np.maximum(1.0, _turned(observations, assumed) / np.pi)
    if np.median(per_half_turn) < CARRIED:
        lost = [_lost(observations, int(k), float(miss[k])) for k in np.flatnonzero(per_half_turn >= EVIDENT)]
        return lost or _upside_down(observations, session)
    return [
        f"{said}, and no other unit, scale, sign or order of columns explains it: check the columns, the unit and "
        "[log.gyro] axes"
    ]


def fitting_gyro_unit(observations: Observations, session: Session, rate: float) -> str | None:
    """The unit in which nominal gyros carry the vertical from rest to rest, where they do not in the one stated; None
    where they do, or where no unit helps."""
    turns, block, channels = observations.turns, observations.gyro_block, session.log.gyro
    if turns is None or block is None or channels is None or len(turns) == 0:
        return None
    assumed = SensorModel(matrix=block.nominal().matrix, bias=np.median(observations.rests.gyro, axis=0))
    miss = _misses(observations, assumed)
    return None if miss.max() < EVIDENT else _fitting_unit(observations, channels, rate, assumed, miss)


def _fitting_unit(
    observations: Observations, channels: Channels, rate: float, assumed: SensorModel, miss: Array
) -> str | None:
    """The first other unit in which the gyros, `assumed` nominal with some bias, explain what they miss."""
    for name, factor in _other_units(channels, rate):
        if _explains(observations, SensorModel(matrix=assumed.matrix / factor, bias=assumed.bias), miss) < np.inf:
            return name
    return None


def _explains(observations: Observations, gyro: SensorModel, miss: Array) -> float:
    """Mean miss of gyros of this model, infinite where it does not explain what is missed by those assumed."""
    trial = _misses(observations, gyro)
    fits = trial.mean() < 0.5 * min(float(miss.mean()), CARRIED) and trial.max() < 0.5 * miss.max()
    return float(trial.mean()) if fits else np.inf


def _lost(observations: Observations, k: int, miss: float) -> str:
    """Turn k, in which nominal gyros lose the vertical, in words."""
    return (
        f"the gyros lose the vertical in {observations.turn_named(k)}: they miss it by {miss / DEGREE:.0f}°; look "
        "there for damaged or lost samples"
    )


def _turned(observations: Observations, gyro: SensorModel) -> Array:
    """About how far (K,) each turn went at the usual rate, rad, whole revolutions included; nothing where that rate is
    none that a device is turned with."""
    with np.errstate(invalid="ignore", over="ignore"):
        turns = observations.turns_about(gyro)
        rate = float(np.median(np.nan_to_num(np.sqrt((turns.M**2).sum(axis=(1, 2, 3)))) / turns.duration))
    return turns.duration * (rate if rate < FASTEST_TURN else 0.0)


def _misses(observations: Observations, gyro: SensorModel) -> Array:
    """Angles (K,), rad, between the vertical after each turn carried back by the gyros and the one before it."""
    with np.errstate(invalid="ignore", over="ignore"):  # a wrong unit may make it thousands of radians a sample
        turns = observations.turns_about(gyro)
    vertical = _verticals(observations)
    back = np.einsum("kij,kj->ki", turns.C, vertical[turns.last])
    cosine = np.einsum("ki,ki->k", back, vertical[turns.first])
    return np.asarray(np.arccos(np.clip(np.nan_to_num(cosine, nan=-1.0), -1.0, 1.0)))


def _verticals(observations: Observations) -> Array:
    """Verticals (N, 3) in the body, from nominal accelerometers."""
    force = observations.accel_block.nominal().apply(observations.rests.accel)
    return unit_vector(force)


def _other_units(channels: Channels, rate: float) -> Iterator[tuple[str, float]]:
    """Other units than the stated one (of raw channels: of the scale), and how much larger they are."""
    for name, unit in GYRO_UNITS.items():
        factor = _per_second(unit, rate) / _per_second(channels.unit, rate)
        if unit.kind != "raw" and unit != channels.unit and not (_raw(channels) and unit.kind != channels.unit.kind):
            yield name, factor


def _unit_named(channels: Channels, name: str) -> str:
    if _raw(channels):
        return f'the scale of [log.gyro] is not per that unit; scale_per = "{name}"'
    return f'the unit of [log.gyro] is not "{channels.unit_name}", "{name}"'


def _upside_down(observations: Observations, session: Session) -> list[str]:
    """Whether all accelerometers have the wrong sign, by the programme or the vertical part of the Earth's rate."""
    vertical = _verticals(observations)
    expected = _programmed(session, len(vertical))
    if expected is not None and np.all(np.einsum("ij,ij->i", vertical, expected) < -np.cos(UPRIGHT)):
        return [f"all accelerometers have the wrong sign: every rest is the programme's upside down; {_SIGN}"]
    if _earth_reversed(observations, vertical):
        return [
            "the gyros see the vertical part of the Earth's rate with the wrong sign: all accelerometers have the "
            f"wrong sign, or site.latitude_deg has; {_SIGN}, and latitudes are positive in the north"
        ]
    return []


_SIGN = "an accelerometer at rest with its axis up must read +g"


def _programmed(session: Session, rests: int) -> Array | None:
    """Verticals (N, 3) of the session's programme, where it has an order and as many positions as there are rests."""
    spec = session.programme
    if spec is None:
        return None
    listed = programme(spec.name) if spec.name is not None else from_attitudes([p.attitude for p in spec.positions])
    if not listed.ordered or len(listed.positions) != rests:
        return None
    return np.array([p.vertical_b for p in listed.positions])


def _earth_reversed(observations: Observations, vertical: Array) -> bool:
    """Whether ω = bias + s Ω sin B û at rest says s = −1 and nothing near +1. The horizontal part of the Earth's rate
    and gyros of lesser grades are noise to it."""
    block, latitude = observations.gyro_block, observations.site.latitude
    if block is None or latitude is None or len(vertical) < 4:
        return False
    rate = block.nominal().apply(observations.rests.gyro)
    rate, known = rate - rate.mean(axis=0), EARTH_RATE * np.sin(latitude) * (vertical - vertical.mean(axis=0))
    square = float((known**2).sum())
    if square == 0.0:
        return False
    slope = float((rate * known).sum()) / square
    u = float(np.sqrt(((rate - slope * known) ** 2).sum() / (3 * len(rate) - 4) / square))
    return slope + 6.0 * u < 0.0 and abs(slope + 1.0) < 3.0 * u + 0.1


def _signed_permutations() -> list[Array]:
    """All ways to exchange columns and signs, those with the fewest changes first."""
    out = [
        np.array(signs)[:, None] * np.eye(3)[list(order)]
        for order in permutations(range(3))
        for signs in product((1.0, -1.0), repeat=3)
    ]
    return sorted(out, key=lambda m: _changes(m))


def _readings_of(transform: Array) -> list[tuple[str, Array]]:
    """What a signed permutation of the gyros may mean: that of the gyros, or, unless it is a mirror image, one of the
    accelerometers, of which only the directions up to a common sign show in turns."""
    out = [("gyro", transform)]
    if np.linalg.det(transform) > 0.0:
        out += [("accelerometer", transform.T), ("accelerometer", -transform.T)]
    return out


def _changed(matrix: Array) -> tuple[list[str], list[str]]:
    """Axes whose columns are exchanged, and axes whose signs are wrong."""
    moved = ["xyz"[p] for p in range(3) if matrix[p, p] == 0.0]
    return moved, ["xyz"[p] for p in range(3) if matrix[p].sum() < 0.0]


def _changes(transform: Array) -> int:
    """Columns moved and signs changed, in the simplest reading of a signed permutation."""
    return min(sum(map(len, _changed(matrix))) for _, matrix in _readings_of(transform))


def _described(transform: Array) -> str:
    """The simplest readings of a signed permutation of the gyros, in words."""
    said = []
    for sensors, matrix in _readings_of(transform):
        moved, negative = _changed(matrix)
        if len(moved) + len(negative) > _changes(transform):
            continue
        parts = [f"the {sensors} columns {' and '.join(moved)} are exchanged"] if len(moved) == 2 else []
        if len(moved) == 3:
            order = ", ".join("xyz"[int(np.argmax(np.abs(row)))] for row in matrix)
            parts = [f"the {sensors} columns are in the order {order}"]
        if negative:
            parts.append(f"the sign of {sensors} {', '.join(negative)} is wrong")
        said.append(" and ".join(parts))
    return " or ".join(said) + " (relative to the other sensors)"


def verdict(estimate: Estimate, observations: Observations, *, gravity_confirmed: bool = False) -> Outcome:
    """Whether an estimate may be used, and its accelerometers and gyros each for itself."""
    both, of_accel, of_gyro = list(estimate.reasons), list[str](), list[str]()
    first: tuple[str, ...] = ()
    missing = tuple(name for name in estimate.unobservable if name in _linear(estimate))
    unknown = {name.split(".")[0] for name in missing}
    if missing and not both:
        lists = {frozenset({"accel"}): of_accel, frozenset({"gyro"}): of_gyro}
        said = _and(f"not observable in this session: {listed(missing)}", _most_helpful(estimate, observations))
        lists.get(frozenset(unknown), both).append(said)
        first = (said,)
    elif not missing and not both and (weak := _weak_combinations(estimate, observations)):
        both.append(_and(f"poorly observable in this session: {'; '.join(weak)}", _remedy(estimate, observations)))
    if not missing and not estimate.converged:
        both.append(
            "the estimate did not converge: the data contradict the model; look at the rests with `tumble inspect`"
        )
    if not gravity_confirmed:
        of_accel += _gravity_refused(observations.site)
    of_accel += _scattering_rests(estimate)
    of_gyro += _scattering_turns(estimate, observations)
    both += _misfits(estimate, observations)
    judged = None if missing or not estimate.converged else misfit(estimate, observations)
    said_of = {"accel": of_accel, "gyro": of_gyro, "both": both}
    remarks: list[tuple[Concerns, str]] = [("both", remark) for remark in estimate.remarks]
    if judged is not None:
        for concerns, reason in judged.reasons:
            said_of[concerns].append(reason)
        remarks += judged.remarks
    return Outcome(
        reasons=first + tuple(reason for reason in (*both, *of_accel, *of_gyro) if reason not in first),
        remarks=tuple(remark for _, remark in remarks),
        unobservable=missing,
        of_accel=(*of_accel, *(remark for concerns, remark in remarks if concerns == "accel")),
        of_gyro=(*of_gyro, *(remark for concerns, remark in remarks if concerns == "gyro")),
    )


def _and(*parts: str) -> str:
    """What there is to say, separated by semicolons."""
    return "; ".join(part for part in parts if part)


MOST_LISTED = 21
"""Parameters that are named one by one."""


def listed(names: Sequence[str]) -> str:
    """Parameters by name, or where they are many by group: "accel.axis (12), accel.scale (6)"."""
    if len(names) <= MOST_LISTED:
        return ", ".join(names)
    counted = Counter(group_name(name) for name in names)
    return ", ".join(f"{group} ({count})" for group, count in counted.items())


def _scattering_rests(estimate: Estimate) -> Iterator[str]:
    """Accelerometers at rest that scatter beyond anything a sensor does."""
    fit = estimate.fits.get("accelerometers")
    if fit is not None and fit.scatter > SCATTER_LIMIT:
        yield (
            f"the rests scatter by {fit.scatter / G_STANDARD * 1e3:.2g} mg, more than 1 mg: the device moved at "
            "rest, or the accelerometers do not follow the model"
        )


def _scattering_turns(estimate: Estimate, observations: Observations) -> Iterator[str]:
    """Turns that scatter beyond anything a gyro does."""
    turns = estimate.fits.get("gyro turns")
    if turns is not None and turns.scatter > TURN_SCATTER_LIMIT:
        worst = observations.turn_named(int(np.argmax(estimate.turn_sigmas)))
        yield (
            f"the turns scatter by {turns.scatter / DEGREE:.2g}°, more than {TURN_SCATTER_LIMIT / DEGREE:.0f}°: look "
            f"for damaged or lost samples of the gyros, first in {worst}"
        )


# The site


def gravity_difference(site: Site) -> float | None:
    """Gravity of a site less normal gravity, m/s²; None where the latitude is not known."""
    return None if site.latitude is None else site.gravity - normal_gravity(site.latitude, site.height)


def gravity_said(site: Site) -> str | None:
    """Gravity against normal gravity, in words; None where the latitude is not known."""
    difference = gravity_difference(site)
    if difference is None:
        return None
    said = f"gravity {site.gravity:.6f} m/s^2 is {difference / MILLIGAL:+.0f} mGal from normal gravity"
    if abs(difference) <= GRAVITY_DOUBTED:
        return said
    return f"{said}, more than {GRAVITY_DOUBTED / MILLIGAL:.0f}: look at gravity, latitude_deg and height_m in [site]"


def _gravity_refused(site: Site) -> Iterator[str]:
    """Gravity that no place of this latitude has."""
    difference = gravity_difference(site)
    if difference is not None and abs(difference) > GRAVITY_REFUSED:
        yield (
            f"gravity {site.gravity:.6f} m/s^2 is {difference / MILLIGAL:+.0f} mGal from normal gravity, more than "
            f"{GRAVITY_REFUSED / MILLIGAL:.0f}: every scale factor of the accelerometers would be wrong with it; "
            "correct gravity, latitude_deg or height_m in [site], or write gravity_confirmed = true"
        )


def _misfits(estimate: Estimate, observations: Observations) -> Iterator[str]:
    """Rests and turns beyond FIT_SIGMAS."""
    rests = observations.rests
    for i in np.flatnonzero(estimate.rest_sigmas > FIT_SIGMAS):
        by_gyros = len(estimate.gyro_rest_sigmas) > 0 and estimate.gyro_rest_sigmas[i] == estimate.rest_sigmas[i]
        yield (
            f"{observations.rest_named(int(i))} ({rests.start[i]:z.1f}–{rests.stop[i]:z.1f} s) does not fit"
            + (" by its gyros" if by_gyros else "")
            + f": {estimate.rest_sigmas[i]:.1f} sigma"
            + ("" if by_gyros else f", residual {estimate.rest_residual[i]:.2g} m/s^2")
        )
    if observations.turns is None:
        return
    for k in np.flatnonzero(estimate.turn_sigmas > FIT_SIGMAS):
        yield f"{observations.turn_named(int(k))} does not fit: {estimate.turn_sigmas[k]:.1f} sigma"


# What is missing


def _weak(estimate: Estimate, observations: Observations) -> tuple[Array, Array]:
    """Combinations (q, m) of the parameters, in units of their spreads, that the data determine poorly or not at all,
    the worst first, and how well they are known, in the same units. Poorly is also where the square of the uncertainty
    of scale factors and angles is not small against what the data resolve: u does not hold then, for effects of second
    order count."""
    linear = _linear(estimate)
    spread = limits_of(linear)
    m, covariance = len(linear), estimate.covariance
    if estimate.instrument is not None:  # what is common to all rests no further rest would show
        covariance = covariance - common_covariance(observations, estimate.instrument)
    variance, vectors = np.linalg.eigh(covariance[:m, :m] / np.outer(spread, spread))
    angles = np.array([".bias." not in name for name in linear])  # biases are linear
    squared = variance * (vectors[angles] ** 2).sum(axis=0) * group_of("accel.axis").limit ** 2
    poor = np.flatnonzero((variance > POORLY_KNOWN**2) | (squared > _resolution(estimate, observations)))[::-1]
    return vectors[:, poor].T, np.sqrt(variance[poor])


def _linear(estimate: Estimate) -> tuple[str, ...]:
    """Names of the parameters of the linear model, which come first; the others have priors."""
    linear = {group.name for group in LINEAR}
    return tuple(name for name in estimate.names if group_name(name) in linear)


def _resolution(estimate: Estimate, observations: Observations) -> float:
    """The angle, rad, that the rests and turns both resolve, scatter included."""

    def typical(covariance: Array, group: str) -> float:
        variance = np.median(np.diagonal(covariance, axis1=1, axis2=2))
        return float(np.hypot(np.sqrt(variance), estimate.fits[group].scatter if group in estimate.fits else 0.0))

    tilt = typical(observations.rests.accel_covariance, "accelerometers") / observations.site.gravity
    if observations.turns is None or estimate.gyro is None:
        return tilt
    return max(tilt, typical(observations.turns.covariance, "gyro turns"))


def _weak_combinations(estimate: Estimate, observations: Observations) -> list[str]:
    """The poorly determined combinations in words, each by its largest parts."""
    said = []
    for combination, known in zip(*_weak(estimate, observations), strict=True):
        order = np.argsort(-np.abs(combination))
        largest = [i for i in order[:4] if abs(combination[i]) > 0.5 * abs(combination[order[0]])]
        sign = np.sign(combination[largest[0]])
        parts = [f"{'+' if sign * combination[i] > 0 else '−'} {estimate.names[i]}" for i in largest]
        said.append(f"{' '.join(parts).removeprefix('+ ')} (known to {100.0 * known:.2g} % of its usual size)")
    return said


def _remedy(estimate: Estimate, observations: Observations) -> str:
    """What would determine the poorly determined combinations: gravity, where its uncertainty is most of theirs, else
    rests or turns."""
    combinations, known = _weak(estimate, observations)
    site = observations.site
    linear = _linear(estimate)
    scales = np.array([name.startswith("accel.scale.") for name in linear])
    by_gravity = combinations @ (scales / limits_of(linear)) * site.gravity_u / site.gravity
    if np.all(by_gravity**2 > 0.5 * known**2):
        return f"gravity is known to {site.gravity_u:g} m/s^2 only: give latitude_deg or gravity in [site]"
    return _most_helpful(estimate, observations)


def _most_helpful(estimate: Estimate, observations: Observations) -> str:
    """The rests, or the turns, that together would say what the data do not determine, the most telling first."""
    m = len(observations.accel_block.names)
    unseen = estimate.null if estimate.unobservable else _weak(estimate, observations)[0]
    null = unseen[:, :m]
    if np.abs(null).max(initial=0.0) > SEEN:
        rests = {standing(u): _rest_rows(observations, u) for u in faces_and_edges()}
        return _advice(estimate, "rests", *most_telling(null, rests))
    turns = {
        f"180° about {'XYZ'[axis]} from {'XYZ'[up]} up": _turn_rows(observations, axis, up)
        for up in range(3)
        for axis in range(3)
    }
    return _advice(estimate, "turns", *most_telling(estimate.null[:, m:], turns))


def _advice(estimate: Estimate, what: str, names: list[str], left: int) -> str:
    said = [f"{what} that would help, the most helpful first: {', '.join(names)}"] if names else []
    if left:
        said.append(f"the others no further {what} would show to the method {estimate.method}")
    return "; ".join(said)


def _rest_rows(observations: Observations, vertical: Array) -> Array:
    """What one more rest would say about the accelerometer parameters, whatever the exact vertical, in units of their
    spreads: (n − 2, m), m/s²."""
    block, g = observations.accel_block, observations.site.gravity
    derivative = block.jacobian(np.zeros(len(block.names)))
    basis, _ = np.linalg.qr(block.axes @ tangent_basis(vertical).T, mode="complete")
    rows = np.einsum("pr,pqm,q->rm", basis[:, 2:], derivative, np.append(g * vertical, 1.0))
    return np.asarray(rows * limits_of(block.names))


def _turn_rows(observations: Observations, axis: int, up: int) -> Array:
    """What one more turn by 180° about a body axis would say about the gyro parameters, in units of their spreads:
    (2, m), rad."""
    block = observations.gyro_block
    assert block is not None
    n = np.eye(3)[axis]
    derivative = np.einsum("ap,pqm->aqm", onto_body(block.axes), block.jacobian(np.zeros(len(block.names))))
    path = np.pi * np.outer(n, n) + 2.0 * skew(n)  # ∫ C dθ of a turn by π, Eq. (6.2)
    rows = tangent_basis(np.eye(3)[up]) @ skew(np.eye(3)[up]) @ path @ np.einsum("aqm,q->am", derivative[:, :3], n)
    return np.asarray(rows * limits_of(block.names))


def no_rests(segmentation: Segmentation) -> Outcome:
    """The outcome of a log in which nothing rests."""
    reason = f"no rest found: expected the device to lie still for at least {STILL_SECONDS} s in each position"
    reason += "".join(f"; {said}" for said in segmentation.passed_over())
    if segmentation.rejected:
        longest = max(segmentation.rejected, key=lambda r: r.stop - r.start)
        reason += f"; the longest quiet stretch, {longest.start:.1f}–{longest.stop:.1f} s, is none: {longest.reason}"
    return Outcome(reasons=(f"{reason}; `tumble inspect` shows what was rejected",))
