"""Estimates from the rests so far, computed in a thread, for the page."""

from __future__ import annotations

import contextlib
import logging
import math
import time
from collections.abc import Mapping
from concurrent.futures import Executor, Future
from dataclasses import replace

import numpy as np

from tumble.bench.follow.progress import Progress
from tumble.bench.follow.task import Task
from tumble.bench.state import EstimateShown, GroupShown
from tumble.inference.estimate import FIT_SIGMAS, Estimate
from tumble.inference.joint import joint
from tumble.recording.session import Exclusion, Session, Site
from tumble.reduction.blocks.reducer import Reduction
from tumble.reduction.observations import observe
from tumble.reduction.rests.blemishes import without_blemishes
from tumble.reduction.rests.matching import without_numbered, without_times
from tumble.reduction.rests.segmentation import Segmentation, find_rests
from tumble.sensors.instrument import functions
from tumble.sensors.model import Block
from tumble.sensors.parameters import group_name, positions_by_group, prior_sizes, sensor_kind, shown_in
from tumble.units import G_STANDARD, Array, two_digits

log = logging.getLogger(__name__)

DIRECTIONS = np.array([d for d in np.ndindex(3, 3, 3) if d != (1, 1, 1)], dtype=float) - 1.0
DIRECTIONS /= np.linalg.norm(DIRECTIONS, axis=1, keepdims=True)
"""Directions of the 26 faces, edges and corners of a cube."""
LEAST_GAIN = 0.01  # in the uncertainty of the accelerometers, by the best further rest; a smaller one is not worth it

_NO_ESTIMATE: EstimateShown = {
    "rests": 0, "groups": [], "enough": False, "residuals": [], "gains": None, "cause": "", "next": "", "unknowns": 0,
    "seconds": 0.0,
}  # fmt: skip


class Estimates:
    """Estimates of a task, computed one at a time by a `worker`. `shown` is the latest, None before the first."""

    def __init__(self, task: Task, worker: Executor) -> None:
        self.shown: EstimateShown | None = None
        self._task, self._worker = task, worker
        self._basis = 0, 0  # rests and exclusions of the latest estimate
        self._future: Future[EstimateShown] | None = None

    @property
    def under_way(self) -> bool:
        return self._future is not None

    def take(self) -> None:
        """Take over the computed estimate if it is finished; after a failure show the error."""
        if self._future is None or not self._future.done():
            return
        done, self._future = self._future, None
        error = done.exception()
        if error is None:
            self.shown = done.result()
            return
        log.error("an estimate has failed", exc_info=error)
        cause = f"the estimate has failed ({type(error).__name__}: {error}); the recording goes on"
        self.shown = {**_NO_ESTIMATE, "rests": self._basis[0], "cause": " ".join(cause.split())}

    def ask(self, progress: Progress, excluded: tuple[Exclusion, ...]) -> None:
        """Start another estimate if there is a new rest or exclusion."""
        if self._future is not None:
            return
        rests = [rest for group in progress.groups for rest in group]
        unfinished = progress.current if progress.current is not None and not progress.judged[-1].enough else None
        settled = rests[:-1] if unfinished is not None else rests
        basis = len(settled), len(excluded)
        if basis == self._basis or len(settled) < 2:
            return
        self._basis = basis
        until = math.inf, math.inf
        if unfinished is not None:
            file = progress.blocks.file_of(unfinished.first)
            until = file.number, unfinished.start - file.shift
        self._future = self._worker.submit(_compute, self._task, progress.reduction, until, excluded)


def estimate_so_far(
    session: Session, grade: str, reduction: Reduction, segmentation: Segmentation, excluded: tuple[Exclusion, ...]
) -> Estimate | None:
    """Return the joint estimate from these rests and the turns between them; None for fewer than two rests."""
    numbered = tuple(one for one in excluded if one.rest is not None and one.rest <= len(segmentation.rests))
    _, segmentation = without_numbered(reduction, segmentation, numbered)
    if len(segmentation.rests) < 2:
        return None
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        observations = observe(reduction, segmentation.rests, session.accel_block, session.gyro_block, session.site)
        for usual in (prior_sizes(grade, session.device.prior), {}):  # few rests determine only the linear model
            with contextlib.suppress(np.linalg.LinAlgError):
                return joint(replace(observations, usual=usual), quick=True)
    return None


# -------------------- content for the page --------------------


def _compute(
    task: Task, reduction: Reduction, until: tuple[float, float], excluded: tuple[Exclusion, ...]
) -> EstimateShown:
    """Compute the estimate from the rests that begin before `until` (file, time in it, s), as content for the page."""
    began = time.thread_time()
    session, wanted = task.session, task.wanted
    reduction = without_blemishes(reduction)
    segmentation = without_times(reduction, find_rests(reduction, session.accel_block, session.gyro_block), excluded)
    segmentation = replace(
        segmentation, rests=tuple(rest for rest in segmentation.rests if (rest.file, rest.start) < until)
    )
    estimate = estimate_so_far(session, task.grade, reduction, segmentation, excluded)
    if estimate is None:
        return {**_NO_ESTIMATE, "rests": len(segmentation.rests)}

    # groups with a wanted uncertainty, in the units of `tumble calibrate`
    groups: list[GroupShown] = []
    for group, rows in positions_by_group(estimate.names).items():
        if (aim := wanted.group.get(group)) is None:
            continue
        u, determined = float(estimate.u[rows].max()), bool(estimate.observable[rows].all())
        size, unit = shown_in(group, estimate.units[rows[0]], float(np.sqrt(np.mean(estimate.values[rows] ** 2))))
        reached: GroupShown = {
            "group": group,
            "unit": unit,
            "u": u / size,
            "wanted": aim / size,
            "determined": determined,
            "enough": determined and u <= aim,
        }
        groups.append(reached)

    # the largest misfit and its likely cause
    rest, turn = np.nan_to_num(estimate.rest_sigmas), np.nan_to_num(estimate.turn_sigmas)
    i, j = int(np.argmax(rest)) if len(rest) else 0, int(np.argmax(turn)) if len(turn) else 0
    cause = ""
    if not estimate.converged:
        cause = "the readings contradict each other: are the axes, their senses and the units right?"
    elif rest.max(initial=0.0) > FIT_SIGMAS:
        start = f"{segmentation.rests[i].start:.0f} s"
        cause = f"rest {i + 1} ({start}) does not fit by {rest[i]:.0f}σ: moved, knocked or still settling"
    elif turn.max(initial=0.0) > FIT_SIGMAS:
        cause = f"turn {j + 1} does not fit by {turn[j]:.0f}σ: clipped, samples lost, or a knock in it"

    floor, scale = session.site.gravity_u / session.site.gravity, wanted.group.get("accel.scale", math.inf)
    if not cause and scale < floor:
        cause = (
            f"accel.scale is limited by gravity to {two_digits(1e6 * floor)} ppm, and {two_digits(1e6 * scale)} are "
            "wanted: state latitude, height (--height) or gravity in [site]"
        )

    remaining = gains(estimate, wanted.group, session.accel_block, wanted.accel, session.site)
    following = best_next(remaining)
    return {
        "rests": len(segmentation.rests),
        "groups": groups,
        "enough": all(group["enough"] for group in groups),
        "residuals": [
            {"sigmas": float(s), "residual": float(r) / G_STANDARD * 1e6}
            for s, r in zip(estimate.rest_sigmas, estimate.rest_residual, strict=True)
            if math.isfinite(s)
        ],
        "gains": remaining.tolist() if following else None,
        "next": following,
        "cause": cause,
        "unknowns": len(estimate.names),
        "seconds": time.thread_time() - began,
    }


def best_next(remaining: Array) -> str:
    """Return in words the direction of the rest that would leave least of the uncertainty, with its gain; empty if no
    further rest is worth it."""
    best = int(np.argmin(remaining))
    gain = 1.0 - float(remaining[best])
    upwards = [f"{name} {'up' if v > 0 else 'down'}" for name, v in zip("XYZ", DIRECTIONS[best], strict=True) if v]
    said = f"{', '.join(upwards)}: uncertainty of the accelerometers {100.0 * gain:.0f} % smaller"
    return said if gain > LEAST_GAIN else ""


def gains(
    estimate: Estimate,
    wanted: Mapping[str, float],
    block: Block,
    rest_u: float,
    site: Site,
    directions: Array = DIRECTIONS,
) -> Array:
    """Return the fraction of the accelerometers' uncertainty that a further rest along each of the directions would
    leave.

    Uncertainties are relative to the wanted ones (root mean square). The length of the mean force of a rest is gravity:
    one scalar observation, by which the covariance of the estimate is updated. It scatters as the rests so far do. An
    error of gravity is common to the rest and the scale factors, so that no rest reduces it. Information on the gyros
    from the turn into it is neglected."""
    instrument, names = estimate.instrument, estimate.names
    assert instrument is not None  # as in every estimate by `joint`
    groups = map(group_name, names)
    weight = np.array([wanted.get(name, np.inf) if sensor_kind(name) == block.kind else np.inf for name in groups])
    relative = np.array([group_name(name) == "accel.scale" for name in names]) * (1.0 + estimate.values) / site.gravity
    C = estimate.covariance - site.gravity_u**2 * np.outer(relative, relative)
    force = site.gravity * directions
    beta, D = functions(block, force, np.zeros_like(force)), instrument.derivative(block, estimate.values)
    h = np.einsum("qk,kn,qnb,nbm->qm", directions, np.linalg.pinv(block.axes), beta, D, optimize=True)
    Ch = h @ C
    scatter = estimate.fits["accelerometers"].scatter
    reduced = Ch**2 / (rest_u**2 + scatter**2 + np.maximum(np.einsum("qm,qm->q", h, Ch), 0.0))[:, None]
    before = estimate.u**2
    left = np.maximum(before - reduced, 0.0)
    return np.asarray(np.sqrt((left / weight**2).sum(axis=1) / (before / weight**2).sum()))
