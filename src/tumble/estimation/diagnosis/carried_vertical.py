"""Whether gyros carry the vertical from rest to rest, and if not, which unit, scale, sign or order would make them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from tumble.estimation.diagnosis.accelerometer_unit import times_wrong
from tumble.estimation.diagnosis.exchanged_columns import columns_said, signed_permutations
from tumble.estimation.diagnosis.upside_down import specific_forces, upside_down, verticals
from tumble.estimation.observability import rough_directions
from tumble.recording.session import Channels, LogSpec, Session
from tumble.recording.session.log_tables import GyroTable
from tumble.reduction.observations import Observations
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


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Carrying:
    """Gyros as the session states them, with the bias that they show at rest, the `vertical` (N, 3) of each rest in the
    body, and the angles (K,), rad, by which they `miss` that after each turn."""

    observations: Observations
    channels: Channels
    stated: SensorModel
    vertical: Array
    miss: Array

    @staticmethod
    def of(observations: Observations, session: Session) -> _Carrying | None:
        """None where there are no gyros, or no turns."""
        turns, block, channels = observations.turns, observations.gyro_block, session.log.gyro
        if turns is None or block is None or channels is None or len(turns) == 0:
            return None
        stated = SensorModel(matrix=block.nominal().matrix, bias=np.median(observations.rests.gyro, axis=0))
        vertical = verticals(observations)
        miss = _misses(observations, stated, vertical)
        carrying = _Carrying(observations=observations, channels=channels, stated=stated, vertical=vertical, miss=miss)
        return carrying._less_accelerometer_biases() if carrying.evident else carrying

    def _less_accelerometer_biases(self) -> _Carrying:
        """The same with verticals about the centre of all of them, where biases of the accelerometers explain what the
        gyros miss: half a g moves a vertical by 30°."""
        vertical = rough_directions(specific_forces(self.observations))
        miss = _misses(self.observations, self.stated, vertical)
        return replace(self, vertical=vertical, miss=miss) if self._explains(miss) else self

    @property
    def evident(self) -> bool:
        """Whether the vertical is lost in some turn."""
        return bool(self.miss.max() >= EVIDENT)

    @property
    def said(self) -> str:
        """By how much the vertical is missed, in words."""
        return (
            "the gyros do not carry the vertical from rest to rest: they miss it by "
            f"{self.miss.max() / DEGREE:.0f}° at worst and by {np.median(self.miss) / DEGREE:.0f}° at the median of "
            f"{len(self.miss)} turns"
        )

    def explained(self, matrix: Array) -> float:
        """Mean miss, rad, of gyros with another matrix; infinite where it does not explain what is missed, or where it
        is no less than that of gyros which read nothing: a device that was shaken and put back."""
        trial = _misses(self.observations, SensorModel(matrix=matrix, bias=self.stated.bias), self.vertical)
        informed = trial.mean() < 0.5 * self.moved.mean()
        return float(trial.mean()) if informed and self._explains(trial) else np.inf

    @property
    def moved(self) -> Array:
        """Angles (K,), rad, by which the vertical moves in the body from the rest before each turn to the one after."""
        turns = self.observations.turns
        assert turns is not None
        cosine = np.einsum("ki,ki->k", self.vertical[turns.first], self.vertical[turns.last])
        return np.asarray(np.arccos(np.clip(cosine, -1.0, 1.0)))

    def _explains(self, trial: Array) -> bool:
        """Whether what a trial misses (K,) is so little that it explains what is missed."""
        return bool(trial.mean() < 0.5 * min(float(self.miss.mean()), CARRIED) and trial.max() < 0.5 * self.miss.max())


def sense_faults(observations: Observations, session: Session, rate: float) -> list[str]:
    """Whether nominal gyros carry the vertical from rest to rest, and if not, which unit, scale, sign or exchange of
    columns would make them; and whether up is up. `rate`: samples per second."""
    carrying = _Carrying.of(observations, session)
    if carrying is None:
        return upside_down(observations, session)
    if not carrying.evident:
        largest = float(np.abs(carrying.stated.bias).max())
        if largest > BIAS_LIMIT:
            return [f"the gyros read {largest:.3g} rad/s at rest, as no gyro does: the offset of [log.gyro] is wrong"]
        return upside_down(observations, session)
    found = _unit_said(carrying, rate) or _time_unit_said(carrying, session.log, rate) or _columns_said(carrying)
    if found is not None:
        return [f"{carrying.said}; {found}"]
    ratio = _scale_ratio(carrying)
    if ratio is not None and abs(np.log(ratio)) >= SMALL_SCALE_ERROR:
        return [f"{carrying.said}; {_scale_said(ratio, carrying.channels, session.log)}"]
    if ratio is not None:  # many revolutions
        return upside_down(observations, session)
    lost = _unexplained(carrying)
    return upside_down(observations, session) if lost is None else lost


def fitting_gyro_unit(observations: Observations, session: Session, rate: float) -> str | None:
    """The unit in which nominal gyros carry the vertical from rest to rest, where they do not in the one stated; None
    where they do, or where no unit helps."""
    carrying = _Carrying.of(observations, session)
    return _fitting_unit(carrying, rate) if carrying is not None and carrying.evident else None


def fitting_time_unit(observations: Observations, session: Session, rate: float) -> str | None:
    """The unit of the times in which nominal gyros carry the vertical, where they do not in the one stated; None where
    they do, or where no unit helps."""
    carrying = _Carrying.of(observations, session)
    return _fitting_time_unit(carrying, session.log, rate) if carrying is not None and carrying.evident else None


def misses_by_unit(observations: Observations, session: Session, rate: float) -> dict[str, float]:
    """Median angle, rad, by which nominal gyros miss the vertical after a turn, in the stated unit and in all others,
    the least first; nothing where nothing turned."""
    carrying = _Carrying.of(observations, session)
    if carrying is None:
        return {}
    misses = {carrying.channels.unit_name: float(np.median(carrying.miss))}
    for name, factor in _other_units(carrying.channels, rate):
        trial = SensorModel(matrix=carrying.stated.matrix / factor, bias=carrying.stated.bias)
        misses[name] = float(np.median(_misses(observations, trial, carrying.vertical)))
    return dict(sorted(misses.items(), key=lambda miss: miss[1]))


def _fitting_unit(carrying: _Carrying, rate: float) -> str | None:
    """The first other unit that explains what the gyros miss."""
    for name, factor in _other_units(carrying.channels, rate):
        if carrying.explained(carrying.stated.matrix / factor) < np.inf:
            return name
    return None


def _unit_said(carrying: _Carrying, rate: float) -> str | None:
    unit = _fitting_unit(carrying, rate)
    if unit is None:
        return None
    if carrying.channels.raw:
        return f'the scale of [log.gyro] is not per that unit; scale_per = "{unit}" would fit'
    return f'the unit of [log.gyro] is not "{carrying.channels.unit_name}", "{unit}" would fit'


def _time_unit_said(carrying: _Carrying, log: LogSpec, rate: float) -> str | None:
    unit = _fitting_time_unit(carrying, log, rate)
    return None if unit is None else f'log.time_unit = "{unit}" would fit'


def _fitting_time_unit(carrying: _Carrying, log: LogSpec, rate: float) -> str | None:
    """The first other unit of the times that explains what the gyros miss, and in which they are those of a log."""
    rests = carrying.observations.rests
    for name, factor in TIME_UNITS.items():
        longer = factor / log.time_factor
        possible = _RATES[0] < rate / longer < _RATES[1] and float(rests.stop.max()) * longer > _SHORTEST_LOG
        if log.time is None or log.clock or not possible:
            continue
        if carrying.explained(carrying.stated.matrix / longer) < np.inf:
            return name
    return None


def _columns_said(carrying: _Carrying) -> str | None:
    """The simplest exchange of columns and signs among those that explain what is missed nearly as well as the best."""
    trials = [(exchange, carrying.explained(carrying.stated.matrix @ exchange)) for exchange in signed_permutations()]
    best = min(trial for _, trial in trials)
    if best == np.inf:
        return None
    return columns_said(next(exchange for exchange, trial in trials if trial <= 1.5 * best + 0.1 * CARRIED))


def _scale_ratio(carrying: _Carrying) -> float | None:
    """How many times what they should the gyros read, where one ratio for all explains what is missed best; of ratios
    beyond five, up to those of a unit and its thousandths, only where none within does."""
    for low, high in ((0.2, 5.0), (5.0, 2e3), (5e-4, 0.2)):
        ratios = np.geomspace(low, high, 1 + round(40.0 * np.log(high / low)))
        best, ratio = min((carrying.explained(carrying.stated.matrix * ratio), float(ratio)) for ratio in ratios)
        if best < np.inf:
            return ratio
    return None


def _scale_said(ratio: float, channels: Channels, log: LogSpec) -> str:
    suspects = ["the nominal scale of [log.gyro]"] if channels.raw else []
    suspects += ["log.rate_hz"] if log.rate is not None else []
    seen = f"the gyros read about {ratio:.3g} times what they should"
    return seen + (f": {' or '.join(suspects)} is {times_wrong(ratio)}" if suspects else "")


def _unexplained(carrying: _Carrying) -> list[str] | None:
    """What is said where nothing that holds for all turns explains what is missed; None where the turns are so long
    that nominal gyros may miss as much."""
    if carrying.channels.raw and np.all(carrying.channels.scale == 1.0):
        return [
            f"{carrying.said}: log.gyro.scale is 1, as if the numbers were no raw ones; write the counts per deg/s of "
            "the data sheet (16.4, 32.8, 65.5, 131 …), or let `tumble new` find them from the turns"
        ]
    observations, miss = carrying.observations, carrying.miss
    per_half_turn = miss / np.maximum(1.0, _turned(observations, carrying.stated) / np.pi)
    if np.median(per_half_turn) < CARRIED:
        return [_lost(observations, int(k), float(miss[k])) for k in np.flatnonzero(per_half_turn >= EVIDENT)] or None
    return [
        f"{carrying.said}, and no other unit, scale, sign or order of columns explains it: check the columns, the unit "
        "and [log.gyro] axes"
    ]


def _lost(observations: Observations, k: int, miss: float) -> str:
    """Turn k, in which nominal gyros lose the vertical, in words."""
    assert observations.turns is not None
    number = int(observations.turns.first[k]) + 1
    return (
        f"the gyros lose the vertical in {observations.turn_named(k)}: they miss it by {miss / DEGREE:.0f}°; look "
        f"there for damaged or lost samples, or leave it out: [[exclude]] turn = {number}"
    )


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
    back = np.einsum("kij,kj->ki", turns.C, vertical[turns.last])
    cosine = np.einsum("ki,ki->k", back, vertical[turns.first])
    return np.asarray(np.arccos(np.clip(np.nan_to_num(cosine, nan=-1.0), -1.0, 1.0)))


def _other_units(channels: Channels, rate: float) -> Iterator[tuple[str, float]]:
    """Other units than the stated one (of raw channels: of the scale), and how much larger they are."""
    for name, unit in GYRO_UNITS.items():
        factor = unit.per_second(rate) / channels.unit.per_second(rate)
        allowed = name in GyroTable.SCALE_PER if channels.raw else unit.kind != "raw"
        if allowed and unit != channels.unit and not (channels.raw and unit.kind != channels.unit.kind):
            yield name, factor
