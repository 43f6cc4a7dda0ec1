"""What the page takes from the chain of a calibration, fed as the log grows: the blocks, the rests so far, how well a
rest is known, and the estimate. Everything of the chain that the bench uses is named here."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, replace

import numpy as np

from tumble.bench.follow import BRIDGED, SoundSamples
from tumble.estimation.estimate import Estimate
from tumble.inference.joint import joint
from tumble.recording.gaps import Gap
from tumble.recording.log import Chunk
from tumble.recording.session import Exclusion, Session
from tumble.reduction.blocks.reducer import Reducer, Reduction
from tumble.reduction.noise.coloured_noise import fit_coloured_noise
from tumble.reduction.observations import observe
from tumble.reduction.rests.blemishes import without_blemishes
from tumble.reduction.rests.exclusion import without_rests, without_times
from tumble.reduction.rests.matching import Match
from tumble.reduction.rests.segmentation import RestSpan, Segmentation, find_rests
from tumble.sensors.parameters import usual_sizes
from tumble.units import ZERO_CELSIUS, Array

_LEAST_BLOCKS = 30


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Blocks:
    """The blocks so far, in the body: their `edges` (K + 1,), s; specific force (K, 3), m/s²; angular rate (K, 3),
    rad/s, and temperature (K,), K, where there are any."""

    edges: Array
    force: Array
    rate: Array | None
    temperature: Array | None

    def __len__(self) -> int:
        return len(self.force)


@dataclass(frozen=True, kw_only=True, slots=True)
class MeanUncertainty:
    """How well the mean of a rest is known: u of accelerometers, m/s², and gyros, rad/s (None without), the largest of
    the channels', and what part of it twice the time would leave."""

    accel: float
    gyro: float | None
    twice: float


class Chain:
    """The chain of a session whose log grows, of one file, with a sample every `interval` s."""

    def __init__(self, session: Session, interval: float) -> None:
        log = session.log
        self.session = session
        increments = tuple(c is not None and c.unit.kind == "increment" for c in (log.accel, log.gyro))
        self._reducer = Reducer(
            rate=1.0 / interval,
            accel=session.accel_block,
            gyro=session.gyro_block,
            increments=(increments[0], increments[1]),
        )
        self._gaps: list[Gap] = []
        block = [session.accel_block, session.gyro_block]
        self._to_body = [None if b is None else np.asarray(np.linalg.pinv(b.axes).T) for b in block]

    def feed(self, samples: SoundSamples) -> tuple[Array, Array | None]:
        """Add samples; what the accelerometers (m, n) and gyros (m, n) read, in SI."""
        log, dt = self.session.log, samples.dt
        n = len(log.accel.columns)
        accel = log.accel.to_si(samples.values[:, :n], dt)
        gyro = None if log.gyro is None else log.gyro.to_si(samples.values[:, n : n + len(log.gyro.columns)], dt)
        temperature = None
        if log.temperature is not None:
            warmth = samples.values[:, -len(log.temperature.columns) :]
            temperature = log.temperature.to_celsius(warmth) + ZERO_CELSIUS
        if len(dt):
            chunk = Chunk(file=0, time=samples.time, dt=dt, accel=accel, gyro=gyro, temperature=temperature)
            self._reducer.feed(chunk)
        for i in np.flatnonzero(samples.lost > BRIDGED):
            lost, stop = int(samples.lost[i]), float(samples.time[i])
            start = stop - (lost + 1) * float(dt[i])
            self._gaps.append(
                Gap(file=0, row=0, time=start, samples=lost, what="missing samples", stop=stop, integrable=False)
            )
        return accel, gyro

    def now(self) -> Reduction:
        """What was fed so far."""
        return replace(self._reducer.now(), gaps=tuple(self._gaps))

    def blocks(self, reduction: Reduction) -> Blocks:
        """The blocks of a reduction."""
        file = reduction.files[-1]
        return Blocks(
            edges=file.edges,
            force=_in_body(file.accel.means, self._to_body[0]),
            rate=None if self.session.gyro_block is None else _in_body(file.gyro.means, self._to_body[1]),
            temperature=None if file.temperature is None else file.temperature.mean(axis=1),
        )

    def rests(self, reduction: Reduction, excluded: tuple[Exclusion, ...]) -> Segmentation | None:
        """The rests so far, without the times that are left out; None while there is too little."""
        if not reduction.files or len(reduction.files[-1]) < _LEAST_BLOCKS:
            return None
        reduction = without_blemishes(reduction)
        found = find_rests(reduction, self.session.accel_block, self.session.gyro_block)
        return without_times(reduction, found, excluded)


def known(reduction: Reduction, first: int, last: int) -> MeanUncertainty | None:
    """How well the mean over blocks first … last − 1 is known; None while they are too few."""
    if last - first < 10:
        return None
    file = reduction.files[-1]
    accel, twice_accel = _uncertain(file.accel.means[first:last])
    if not reduction.gyro_channels:
        return MeanUncertainty(accel=accel, gyro=None, twice=twice_accel / accel)
    gyro, twice_gyro = _uncertain(file.gyro.means[first:last])
    return MeanUncertainty(accel=accel, gyro=gyro, twice=max(twice_accel / accel, twice_gyro / gyro))


def estimate_so_far(
    session: Session, grade: str, reduction: Reduction, spans: tuple[RestSpan, ...], excluded: tuple[Exclusion, ...]
) -> Estimate | None:
    """The joint estimate from these rests and the turns between them; None where they are too few."""
    numbered = tuple(one for one in excluded if one.rest is not None and one.rest <= len(spans))
    match = without_rests(Match(rests=spans, programme=None, position=None), numbered)
    if len(match.rests) < 2:
        return None
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        found = observe(without_blemishes(reduction), match, session.accel_block, session.gyro_block, session.site)
        for usual in (usual_sizes(grade, session.device.prior), {}):  # few rests bear the linear model alone
            with contextlib.suppress(np.linalg.LinAlgError):
                return joint(replace(found, usual=usual), quick=True)
    return None


def _in_body(series: Array, to_body: Array | None) -> Array:
    """Readings in the body."""
    return series if to_body is None or np.array_equal(to_body, np.eye(3)) else series @ to_body


def _uncertain(series: Array) -> tuple[float, float]:
    """Standard uncertainty of the mean of block means (K, n), the largest of the channels', and that after twice the
    time."""
    noise, count = fit_coloured_noise([series]), len(series)
    now, twice = (np.sqrt(np.diag(noise.covariance_of_mean(k * count)).max()) for k in (1.0, 2.0))
    return max(float(now), 1e-12), float(twice)
