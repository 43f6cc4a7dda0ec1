"""The estimate after each rest, made beside everything else, and what the page shows of it."""

from __future__ import annotations

import logging
import math
import time
from concurrent.futures import Executor, Future
from typing import Any

import numpy as np

from tumble.bench.chain import estimate_so_far
from tumble.bench.course import Progress
from tumble.bench.live import Followed
from tumble.bench.task import Task
from tumble.bench.wishes import DIRECTIONS, gains, reached
from tumble.estimation.estimate import FIT_SIGMAS, Estimate
from tumble.recording.session import Exclusion
from tumble.reduction.blocks.reducer import Reduction
from tumble.reduction.rests.segmentation import RestSpan
from tumble.units import G_STANDARD, Array

log = logging.getLogger(__name__)

_NO_ESTIMATE: dict[str, Any] = {
    "groups": [], "enough": False, "residuals": [], "gains": None, "cause": "", "next": "", "unknowns": 0,
    "seconds": 0.0,
}  # fmt: skip


class Estimates:
    """Has estimates of a task made by a `worker`, one at a time. `shown` is the last one for the page, None before the
    first."""

    def __init__(self, task: Task, worker: Executor) -> None:
        self.shown: dict[str, Any] | None = None
        self._task, self._worker = task, worker
        self._made_of: tuple[tuple[int, ...], int] = (), 0
        self._future: Future[dict[str, Any]] | None = None

    @property
    def under_way(self) -> bool:
        """Whether one is being made."""
        return self._future is not None

    def take(self) -> None:
        """Take the one that was being made, if it is done. One that has failed is said; the next is made as ever."""
        if self._future is None or not self._future.done():
            return
        done, self._future = self._future, None
        error = done.exception()
        if error is None:
            self.shown = done.result()
            return
        log.error("an estimate has failed", exc_info=error)
        cause = f"the estimate has failed ({type(error).__name__}: {error}); the recording goes on"
        self.shown = _NO_ESTIMATE | {"rests": len(self._made_of[0]), "cause": " ".join(cause.split())}

    def ask(self, now: Followed, progress: Progress, excluded: tuple[Exclusion, ...]) -> None:
        """Have one made when there is another rest to make it from."""
        if self._future is not None:
            return
        spans, current = now.spans, progress.current
        if current is not None and spans and spans[-1].last > current.first and not progress.judged[-1].enough:
            spans = spans[:-1]
        made_of = tuple(span.first for span in spans), len(excluded)
        if made_of == self._made_of or len(spans) < 2:
            return
        self._made_of = made_of
        self._future = self._worker.submit(_shown, self._task, now.reduction, spans, excluded)


def _shown(
    task: Task, reduction: Reduction, spans: tuple[RestSpan, ...], excluded: tuple[Exclusion, ...]
) -> dict[str, Any]:
    """What the page shows of the estimate from these rests."""
    began = time.thread_time()
    session, wanted = task.session, task.wanted
    estimate = estimate_so_far(session, task.grade, reduction, spans, excluded)
    if estimate is None:
        return _NO_ESTIMATE | {"rests": len(spans)}
    found = reached(estimate, wanted.group)
    left = gains(estimate, wanted.group, session.accel_block, wanted.accel, session.site.gravity)
    best = int(np.argmin(left))
    return {
        "rests": len(spans),
        "groups": [group.shown() for group in found],
        "enough": all(group.enough for group in found),
        "residuals": _residuals(estimate),
        "gains": left.tolist(),
        "next": f"{_upwards(DIRECTIONS[best])}: accelerometers to {100.0 * left[best]:.0f} % of u",
        "cause": _cause(estimate, spans),
        "unknowns": len(estimate.names),
        "seconds": time.thread_time() - began,
    }


def _residuals(estimate: Estimate) -> list[dict[str, float]]:
    return [
        {"sigmas": float(s), "residual": float(r) / G_STANDARD * 1e6}
        for s, r in zip(estimate.rest_sigmas, estimate.rest_residual, strict=True)
        if math.isfinite(s)
    ]


def _cause(estimate: Estimate, spans: tuple[RestSpan, ...]) -> str:
    """What does not fit, and what may be the cause."""
    if not estimate.converged:
        return "the readings contradict each other: are the axes, their senses and the units right?"
    rest, turn = np.nan_to_num(estimate.rest_sigmas), np.nan_to_num(estimate.turn_sigmas)
    if len(rest) and rest.max() > FIT_SIGMAS:
        k = int(np.argmax(rest))
        return f"rest {k + 1} ({spans[k].start:.0f} s) does not fit by {rest[k]:.0f}σ: moved, knocked or still settling"
    if len(turn) and turn.max() > FIT_SIGMAS:
        k = int(np.argmax(turn))
        return f"turn {k + 1} does not fit by {turn[k]:.0f}σ: clipped, samples lost, or a knock in it"
    return ""


def _upwards(d: Array) -> str:
    """A direction of the vertical in the body, in words: "X up, Z down"."""
    return ", ".join(f"{name} {'up' if v > 0 else 'down'}" for name, v in zip("XYZ", d, strict=True) if abs(v) > 0.1)
