"""Whether gyros carry the vertical from rest to rest, and if not, which unit, scale, sign or order of the columns would
make them; and whether up is up."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import permutations, product

import numpy as np

from tumble.diagnosis.channels import times_wrong
from tumble.diagnosis.observability import rough_directions
from tumble.earth import EARTH_RATE
from tumble.programme.positions import from_attitudes, programme
from tumble.recording.session import Channels, LogSpec, Session
from tumble.recording.session.log_tables import GyroTable
from tumble.reduction.observations import Observations
from tumble.rotation import unit_vector
from tumble.sensors.model import SensorModel
from tumble.units import DEGREE, GYRO_UNITS, TIME_UNITS, Array

CARRIED = 0.25
"""rad: the turns of nominal gyros miss the vertical by less at the mean, unless a unit, a sign or a column is wrong."""
EVIDENT = 0.5
"""rad: no half turn of nominal gyros misses the vertical by as much: bias, scale and axis errors of 5 % leave less."""
SMALL_SCALE_ERROR = 0.1
"""Scale-factor errors that a calibration is for."""
FASTEST_TURN = 10.0
"""rad/s: by hand or on a table."""
_RATES, _SHORTEST_LOG = (0.5, 20_000.0), 2.0
"""Hz, and s, of a log that is one."""
BIAS_LIMIT = 100.0
"""rad/s: what no gyro measures, let alone as its bias."""
UPRIGHT = 20.0 * DEGREE
"""How far a rest may be from its position of the programme to count as that position, or as it upside down."""
_SIGN = "an accelerometer at rest with its axis up must read +g"


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Carrying:
    """Gyros as the session states them, with the bias that they show at rest, the `vertical` (N, 3) of each rest in the
    body, and the angles (K,), rad, by which they `miss` that after each turn; samples come at a `rate`, Hz."""

    observations: Observations
    channels: Channels
    log: LogSpec
    rate: float
    stated: SensorModel
    vertical: Array
    miss: Array

    @staticmethod
    def of(observations: Observations, session: Session, rate: float) -> _Carrying | None:
        """None where there are no gyros, or no turns. Where biases of the accelerometers explain what the gyros miss,
        verticals are those about the centre of all of them: half a g moves a vertical by 30°."""
        turns, block, channels = observations.turns, observations.gyro_block, session.log.gyro
        if turns is None or block is None or channels is None or len(turns) == 0:
            return None
        stated = SensorModel(matrix=block.nominal().matrix, bias=np.median(observations.rests.gyro, axis=0))
        force = observations.accel_block.nominal().apply(observations.rests.accel)
        vertical = unit_vector(force)
        carrying = _Carrying(
            observations=observations,
            channels=channels,
            log=session.log,
            rate=rate,
            stated=stated,
            vertical=vertical,
            miss=_misses(observations, stated, vertical),
        )
        if not carrying.evident:
            return carrying
        about_centre = rough_directions(force)
        miss = _misses(observations, stated, about_centre)
        return replace(carrying, vertical=about_centre, miss=miss) if carrying.explains(miss) else carrying

    @property
    def evident(self) -> bool:
        """Whether the vertical is lost in some turn."""
        return bool(self.miss.max() >= EVIDENT)

    def explains(self, trial: Array) -> bool:
        """Whether what a trial misses (K,) is so little that it explains what is missed."""
        return bool(trial.mean() < 0.5 * min(float(self.miss.mean()), CARRIED) and trial.max() < 0.5 * self.miss.max())

    def explained(self, matrix: Array) -> float:
        """Mean miss, rad, of gyros with another matrix; infinite where it does not explain what is missed, or where it
        is no less than that of gyros which read nothing: a device that was shaken and put back."""
        turns = self.observations.turns
        assert turns is not None
        trial = self.missed(matrix)
        moved = _angles(self.vertical[turns.first], self.vertical[turns.last])
        return float(trial.mean()) if trial.mean() < 0.5 * moved.mean() and self.explains(trial) else np.inf

    def missed(self, matrix: Array) -> Array:
        """Angles (K,), rad, by which gyros with another matrix miss the vertical."""
        return _misses(self.observations, SensorModel(matrix=matrix, bias=self.stated.bias), self.vertical)

    def in_gyro_units(self) -> Iterator[tuple[str, Array]]:
        """Other units of the gyros than the stated one (of raw channels: of the scale), and the matrices (3, n) in
        these."""
        channels = self.channels
        for name, unit in GYRO_UNITS.items():
            larger = unit.per_second(self.rate) / channels.unit.per_second(self.rate)
            allowed = name in GyroTable.SCALE_PER if channels.raw else unit.kind != "raw"
            if allowed and unit != channels.unit and not (channels.raw and unit.kind != channels.unit.kind):
                yield name, self.stated.matrix / larger

    def in_time_units(self) -> Iterator[tuple[str, Array]]:
        """Other units of the times, in which they are those of a log, and the matrices (3, n) in these."""
        log, seconds = self.log, float(self.observations.rests.stop.max())
        for name, factor in {} if log.time is None or log.clock else TIME_UNITS.items():
            longer = factor / log.time_factor
            if _RATES[0] < self.rate / longer < _RATES[1] and seconds * longer > _SHORTEST_LOG:
                yield name, self.stated.matrix / longer

    def fitting(self, units: Iterable[tuple[str, Array]]) -> str | None:
        """The first of these units that explains what the gyros miss."""
        return next((name for name, matrix in units if self.explained(matrix) < np.inf), None)

    def fitting_columns(self) -> str | None:
        """The simplest exchange of columns and signs among those that explain what is missed nearly as well as the
        best, in words."""
        trials = [(exchange, self.explained(self.stated.matrix @ exchange)) for exchange in signed_permutations()]
        best = min(trial for _, trial in trials)
        if best == np.inf:
            return None
        return columns_said(next(exchange for exchange, trial in trials if trial <= 1.5 * best + 0.1 * CARRIED))

    def fitting_scale(self) -> float | None:
        """How many times what they should the gyros read, where one ratio for all explains what is missed best; of
        ratios beyond five, up to those of a unit and its thousandths, only where none within does."""
        for low, high in ((0.2, 5.0), (5.0, 2e3), (5e-4, 0.2)):
            ratios = np.geomspace(low, high, 1 + round(40.0 * np.log(high / low)))
            best, ratio = min((self.explained(self.stated.matrix * ratio), float(ratio)) for ratio in ratios)
            if best < np.inf:
                return ratio
        return None


def sense_faults(observations: Observations, session: Session, rate: float) -> list[str]:
    """Whether nominal gyros carry the vertical from rest to rest, and if not, which unit, scale, sign or exchange of
    columns would make them; and whether up is up. `rate`: samples per second."""
    carrying = _Carrying.of(observations, session, rate)
    if carrying is not None and not carrying.evident:
        largest = float(np.abs(carrying.stated.bias).max())
        if largest > BIAS_LIMIT:
            return [f"the gyros read {largest:.3g} rad/s at rest, as no gyro does: the offset of [log.gyro] is wrong"]
    faults = _not_carried(carrying) if carrying is not None and carrying.evident else []
    return faults or upside_down(observations, session)


def _not_carried(carrying: _Carrying) -> list[str]:
    """Why gyros lose the vertical: by one unit, order or scale of all turns, else by single turns; nothing where the
    turns are so long that nominal gyros may miss as much."""
    channels, log, miss, observations = carrying.channels, carrying.log, carrying.miss, carrying.observations
    lost = (
        "the gyros do not carry the vertical from rest to rest: they miss it by "
        f"{miss.max() / DEGREE:.0f}° at worst and by {np.median(miss) / DEGREE:.0f}° at the median of {len(miss)} turns"
    )
    if (unit := carrying.fitting(carrying.in_gyro_units())) is not None:
        if channels.raw:
            return [f'{lost}; the scale of [log.gyro] is not per that unit; scale_per = "{unit}" would fit']
        return [f'{lost}; the unit of [log.gyro] is not "{channels.unit_name}", "{unit}" would fit']
    if (unit := carrying.fitting(carrying.in_time_units())) is not None:
        return [f'{lost}; log.time_unit = "{unit}" would fit']
    if (columns := carrying.fitting_columns()) is not None:
        return [f"{lost}; {columns}"]
    if (ratio := carrying.fitting_scale()) is not None:
        if abs(np.log(ratio)) < SMALL_SCALE_ERROR:  # many revolutions
            return []
        suspects = ["the nominal scale of [log.gyro]"] if channels.raw else []
        suspects += ["log.rate_hz"] if log.rate is not None else []
        wrong = f": {' or '.join(suspects)} is {times_wrong(ratio)}" if suspects else ""
        return [f"{lost}; the gyros read about {ratio:.3g} times what they should{wrong}"]
    if channels.raw and np.all(channels.scale == 1.0):
        return [
            f"{lost}: log.gyro.scale is 1, as if the numbers were no raw ones; write the counts per deg/s of "
            "the data sheet (16.4, 32.8, 65.5, 131 …), or let `tumble new` find them from the turns"
        ]
    turns = observations.turns
    assert turns is not None
    per_half_turn = miss / np.maximum(1.0, _turned(observations, carrying.stated) / np.pi)
    if np.median(per_half_turn) < CARRIED:
        return [
            f"the gyros lose the vertical in {observations.turn_named(int(k))}: they miss it by "
            f"{miss[k] / DEGREE:.0f}°; look there for damaged or lost samples, or leave it out: [[exclude]] turn = "
            f"{int(turns.first[k]) + 1}"
            for k in np.flatnonzero(per_half_turn >= EVIDENT)
        ]
    return [
        f"{lost}, and no other unit, scale, sign or order of columns explains it: check the columns, the unit "
        "and [log.gyro] axes"
    ]


def _turned(observations: Observations, gyro: SensorModel) -> Array:
    """About how far (K,) each turn went at the usual rate, rad, whole revolutions included; nothing where that rate is
    none that a device is turned with."""
    with np.errstate(invalid="ignore", over="ignore"):
        turns = observations.turns_about(gyro)
        rate = float(np.median(np.nan_to_num(np.sqrt((turns.M**2).sum(axis=(1, 2, 3)))) / turns.duration))
    return turns.duration * (rate if rate < FASTEST_TURN else 0.0)


def _misses(observations: Observations, gyro: SensorModel, vertical: Array) -> Array:
    """Angles (K,), rad, between the vertical (N, 3) after each turn carried back by the gyros and the one before it."""
    with np.errstate(invalid="ignore", over="ignore"):  # a wrong unit may make it thousands of radians a sample
        turns = observations.turns_about(gyro)
    return _angles(np.einsum("kij,kj->ki", turns.C, vertical[turns.last]), vertical[turns.first])


def _angles(a: Array, b: Array) -> Array:
    """Angles (K,), rad, between unit vectors (K, 3); π where one is no number."""
    cosine = np.einsum("ki,ki->k", a, b)
    return np.asarray(np.arccos(np.clip(np.nan_to_num(cosine, nan=-1.0), -1.0, 1.0)))


# ---- columns that are exchanged or have the wrong sign


def signed_permutations() -> list[Array]:
    """All ways to exchange columns and signs, those with the fewest changes first."""
    out = [
        np.array(signs)[:, None] * np.eye(3)[list(order)]
        for order in permutations(range(3))
        for signs in product((1.0, -1.0), repeat=3)
    ]
    return sorted(out, key=_changes)


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


def columns_said(transform: Array) -> str:
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


# ---- whether up is up


def upside_down(observations: Observations, session: Session) -> list[str]:
    """Whether all accelerometers have the wrong sign, by the programme or the vertical part of the Earth's rate."""
    vertical = unit_vector(observations.accel_block.nominal().apply(observations.rests.accel))
    spec = session.programme
    if spec is not None:
        listed = programme(spec.name) if spec.name is not None else from_attitudes([p.attitude for p in spec.positions])
        expected = np.array([p.vertical_b for p in listed.positions])
        comparable = listed.ordered and len(expected) == len(vertical)
        if comparable and np.all(np.einsum("ij,ij->i", vertical, expected) < -np.cos(UPRIGHT)):
            return [f"all accelerometers have the wrong sign: every rest is the programme's upside down; {_SIGN}"]
    if _earth_reversed(observations, vertical):
        return [
            "the gyros see the vertical part of the Earth's rate with the wrong sign: all accelerometers have the "
            f"wrong sign, or site.latitude_deg has; {_SIGN}, and latitudes are positive in the north"
        ]
    return []


def _earth_reversed(observations: Observations, vertical: Array) -> bool:
    """Whether û·ω = û·bias + s Ω sin B at rest says s = −1 and nothing near +1. The horizontal part of the Earth's
    rate is in none of it; gyros of lesser grades, and what they feel of specific force, are noise to it."""
    block, latitude = observations.gyro_block, observations.site.latitude
    if block is None or latitude is None or len(vertical) < 6:
        return False
    rate = np.einsum("ij,ij->i", block.nominal().apply(observations.rests.gyro), vertical)
    rows = np.column_stack([vertical, np.full(len(vertical), EARTH_RATE * np.sin(latitude))])
    found, _, rank, _ = np.linalg.lstsq(rows, rate)
    if rank < 4:
        return False
    scatter = ((rate - rows @ found) ** 2).sum() / (len(rate) - 4)
    slope, u = float(found[3]), float(np.sqrt(scatter * np.linalg.inv(rows.T @ rows)[3, 3]))
    return slope + 6.0 * u < 0.0 and abs(slope + 1.0) < 3.0 * u + 0.1
