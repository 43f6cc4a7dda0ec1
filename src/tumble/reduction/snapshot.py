"""What a recording shows so far: rests, the rest or turn under way, and the samples it lost.

    reducer = Reducer(rate=…, accel=…, gyro=…)
    reducer.feed(chunk)            as they come
    shown = snapshot(reducer)      at any moment; the reducer goes on as if nobody had asked

A snapshot is what the log would give if it ended here, to the bit: nothing is carried from one to the next, so that it
cannot disagree with the result at the end. What depends on the whole log is therefore provisional. The noise floors
and the level of the gyros are those of what there is: in the first seconds a body that is moved gently may pass for
one at rest, and a rest may lose or gain a second at its ends, or vanish, once there is something quieter or a turn to
compare with. The end of a rest under way is the last block. Nothing is found in the first second of a file.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import reduce

import numpy as np

from tumble.reduction.blemishes import without_blemishes
from tumble.reduction.blocks import FileBlocks, Reducer, Reduction
from tumble.reduction.rests import Rests, reduced_rests
from tumble.reduction.segmentation import RestSpan, Segmentation, find_rests, rest_between
from tumble.rotation import rotation_matrix, rotation_vector
from tumble.units import Array

FIRST_SECONDS = 1.0
"""A file shows nothing before: the windows of the segmentation are as long."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class OpenRest:
    """The stretch of quiet blocks at the end of a log: its `span`, whether it is long enough to be a rest already, mean
    readings (n,) in SI with their standard uncertainty, scatter of the blocks and drift from start to stop, and the
    mean temperature, K. The gyro arrays are empty without gyros."""

    span: RestSpan
    is_rest: bool
    accel: Array
    accel_u: Array
    accel_scatter: Array
    accel_drift: Array
    gyro: Array
    gyro_u: Array
    gyro_scatter: Array
    gyro_drift: Array
    temperature: float | None

    @property
    def seconds(self) -> float:
        """How long it has lasted."""
        return self.span.stop - self.span.start


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class OpenTurn:
    """The movement since the end of the last rest of a file: `start`, s, and, with gyros, the rotation vector (3,),
    rad, from the body then to the body now, from the blocks, right to about a degree."""

    start: float
    rotation: Array | None


@dataclass(frozen=True, kw_only=True, slots=True)
class Snapshot:
    """The state of a recording of so many `seconds` and `samples`: samples lost and held; the `reduction`, less a file
    of less than FIRST_SECONDS, and what the batch finds in it, None where there is nothing yet: the `segmentation`,
    the `rests` and the `turns` between two of them; the rest under way, or the turn, None before the first rest of a
    file."""

    seconds: float
    samples: int
    lost: int
    held: int
    reduction: Reduction
    segmentation: Segmentation | None
    rests: Rests | None
    turns: tuple[tuple[int, int], ...]
    open_rest: OpenRest | None
    open_turn: OpenTurn | None


def snapshot(reducer: Reducer) -> Snapshot:
    """What the log shows that was fed so far (module docstring)."""
    reduction = without_blemishes(reducer.now())
    files = tuple(f for f in reduction.files if f.edges[-1] - f.edges[0] >= FIRST_SECONDS * (1.0 - 1e-9))
    known = replace(reduction, files=files)
    found = find_rests(known, reducer.accel, reducer.gyro) if files else None
    spans = found.rests if found else ()
    rests = reduced_rests(known, spans, reducer.accel, reducer.gyro)[0] if spans else None
    open_rest, open_turn = None, None
    if found and files[-1].file == reduction.files[-1].file:
        open_rest = _open_rest(known, found, rests, reducer)
        before = [span for span in spans if span.file == files[-1].file]
        open_turn = _open_turn(files[-1], before[-1], reducer) if before and open_rest is None else None
    return Snapshot(
        seconds=sum(float(f.edges[-1] - f.edges[0]) for f in reduction.files),
        samples=reduction.accel_channels[0].samples,
        lost=reduction.lost,
        held=reduction.held,
        reduction=known,
        segmentation=found,
        rests=rests,
        turns=tuple((i, i + 1) for i in range(len(spans) - 1) if spans[i].file == spans[i + 1].file),
        open_rest=open_rest,
        open_turn=open_turn,
    )


def _open_rest(known: Reduction, found: Segmentation, rests: Rests | None, reducer: Reducer) -> OpenRest | None:
    """The rest at the end of the last file; one that is too short yet has the noise of those before it, too."""
    file, spans = known.files[-1], found.rests
    if rests is not None and spans[-1].file == file.file and spans[-1].last == len(file.accel):
        return _described(file, spans[-1], True, rests)
    ends = [r for r in found.rejected if r.fails == "duration" and r.file == file.file and r.stop == file.edges[-1]]
    if not ends:
        return None
    span = rest_between(file, ends[0].start, ends[0].stop)
    return _described(file, span, False, reduced_rests(known, (*spans, span), reducer.accel, reducer.gyro)[0])


def _described(file: FileBlocks, span: RestSpan, is_rest: bool, rests: Rests) -> OpenRest:
    """The last of some rests."""
    blocks = slice(span.first, span.last)
    gyro = np.empty((span.last - span.first, 0)) if file.gyro is None else file.gyro[blocks]
    return OpenRest(
        span=span,
        is_rest=is_rest,
        accel=rests.accel[-1],
        accel_u=np.sqrt(np.diag(rests.accel_covariance[-1])),
        accel_scatter=file.accel[blocks].std(axis=0),
        accel_drift=rests.accel_drift[-1],
        gyro=rests.gyro[-1],
        gyro_u=np.sqrt(np.diag(rests.gyro_covariance[-1])),
        gyro_scatter=gyro.std(axis=0),
        gyro_drift=rests.gyro_drift[-1],
        temperature=None if rests.temperature is None else float(rests.temperature[-1]),
    )


def _open_turn(file: FileBlocks, before: RestSpan, reducer: Reducer) -> OpenTurn:
    """The movement since a rest, from the blocks less the level of the gyros in that rest."""
    if file.gyro is None or reducer.gyro is None:
        return OpenTurn(start=before.stop, rotation=None)
    rates = (file.gyro[before.last :] - file.gyro_mean(before.first, before.last)) @ np.linalg.pinv(reducer.gyro.axes).T
    steps = rotation_matrix(rates * np.diff(file.edges)[before.last :, None])
    return OpenTurn(start=before.stop, rotation=rotation_vector(reduce(np.matmul, steps, np.eye(3))))
