"""Several launches (power-ons) of one device: their mean, and how much it changes from launch to launch.

The uncertainty of the mean covers what the launches know of themselves and the instability between them: the mean of
their covariances over L, or on the diagonal the variance from launch to launch over L where that is larger. The
uncertainty of gravity is common to all launches of a site and does not average out.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import zip_longest
from pathlib import Path
from typing import TypeVar

import numpy as np

from tumble.calibration.calibrate import DEFAULT_METHOD, Terms, calibrate
from tumble.calibration.calibration_file import Calibration
from tumble.calibration.observed import Progress
from tumble.calibration.results import Launch, Parameter
from tumble.errors import InputError
from tumble.estimation.ellipsoid import TRIAD
from tumble.estimation.estimate import Outcome
from tumble.estimation.methods.magnetometer import NAMES
from tumble.files import FilePath
from tumble.recording.log import Log
from tumble.recording.session import Session, session_from
from tumble.sensors.frames import Convention, Frame, frame_of
from tumble.sensors.model import Block, SensorModel
from tumble.units import Array

_Any = TypeVar("_Any")


@dataclass(frozen=True, kw_only=True, slots=True)
class Run:
    """A session and its calibration."""

    session: Session
    calibration: Calibration


def calibrate_launches(
    sessions: Sequence[Session | FilePath],
    *,
    method: str = DEFAULT_METHOD,
    iterations: int | None = None,
    frame: Frame = "accelerometer",
    terms: Terms = "full",
    progress: Progress = Log.chunks,
) -> Calibration:
    """Calibrate a device from one session or several, its launches: see `calibrate` and `mean_of_launches`.

    >>> import tumble
    >>> request = tumble.Setup.of(grade="mems", positions=12)
    >>> folders = [tumble.simulate_session(f"launch-{i}", request, seed=1, launch=i) for i in (1, 2)]
    >>> tumble.calibrate_launches(folders)
    <Calibration of mems-1: joint of 2 launches, 21 parameters, accepted>
    """
    if not sessions:
        raise InputError("sessions: expected at least one, found none")
    runs = [
        Run(
            session=session,
            calibration=calibrate(
                session, method=method, iterations=iterations, frame=frame, terms=terms, progress=progress
            ),
        )
        for session in map(session_from, sessions)
    ]
    return mean_of_launches(runs) if len(runs) > 1 else runs[0].calibration


def mean_of_launches(runs: Sequence[Run]) -> Calibration:
    """One calibration from several sessions of one device by the same method: means with uncertainties, standard
    deviations from launch to launch, mean increments of each iteration, and every launch.

    >>> import tumble
    >>> request = tumble.Setup.of(grade="mems", positions=12)
    >>> folders = [tumble.simulate_session(f"launch-{i}", request, seed=1, launch=i) for i in (1, 2)]
    >>> sessions = [tumble.read_session(folder) for folder in folders]
    >>> runs = [tumble.Run(session=each, calibration=tumble.calibrate(each)) for each in sessions]
    >>> tumble.mean_of_launches(runs)["accel.bias.x"].run_to_run > 0.0
    True
    """
    first = runs[0].calibration
    _check_alike(runs)
    reasons = tuple(f"{_name(run)}: {reason}" for run in runs for reason in run.calibration.outcome.reasons)
    missing = tuple(dict.fromkeys(name for run in runs for name in run.calibration.outcome.unobservable))
    common = [p.name for p in first.parameters if all(p.name in _named(run) for run in runs)]
    values = np.array([[_named(run)[name].value for name in common] for run in runs])
    covariance = _covariance(runs, common, values)
    parameters = tuple(
        Parameter(
            name=name,
            value=float(value),
            u=float(u),
            unit=_named(runs[0])[name].unit,
            deviation=_mean_deviation(runs, name),
            run_to_run=float(spread),
        )
        for name, value, u, spread in zip(
            common, values.mean(axis=0), np.sqrt(np.diag(covariance)), values.std(axis=0, ddof=1), strict=True
        )
    )
    digests = [run.calibration.provenance["log_sha256"] for run in runs]
    means = dict(zip(common, values.mean(axis=0).tolist(), strict=True))
    return replace(
        first,
        parameters=parameters,
        covariance=covariance,
        accel=_mean_model(first.frame, runs[0].session.accel_block, means),
        gyro=_mean_model(first.frame, runs[0].session.gyro_block, means),
        mag=_mean_magnetometer(means),
        outcome=Outcome(reasons=reasons, unobservable=missing),
        iterations=_mean_increments(runs, common),
        rests=(),
        turns=(),
        fits={},
        site=_common([run.calibration.site for run in runs]),
        programme=_common([run.calibration.programme for run in runs]),
        notes=tuple(f"{_name(run)}: {note}" for run in runs for note in run.calibration.notes),
        launches=tuple(
            Launch(
                session=_name(run),
                parameters=run.calibration.parameters,
                covariance=run.calibration.covariance,
                log_sha256=digest,
                site=run.calibration.site,
                rests=run.calibration.rests,
                turns=run.calibration.turns,
                fits=run.calibration.fits,
            )
            for run, digest in zip(runs, digests, strict=True)
        ),
        provenance=dict(first.provenance) | {"log_sha256": hashlib.sha256("\n".join(digests).encode()).hexdigest()},
    )


def _common(values: Sequence[_Any]) -> _Any | None:
    """What all launches share; None where they differ."""
    return values[0] if all(value == values[0] for value in values) else None


def _name(run: Run) -> str:
    return Path(run.session.name).name or run.session.name


def _named(run: Run) -> Mapping[str, Parameter]:
    return {p.name: p for p in run.calibration.parameters}


def _check_alike(runs: Sequence[Run]) -> None:
    first = runs[0]
    for run in runs[1:]:
        if run.calibration.serial != first.calibration.serial:
            raise InputError(
                f"{run.session.name}: expected a launch of device {first.calibration.serial!r} like the first "
                f"session, found {run.calibration.serial!r}; calibrate each device by itself"
            )
    seen: dict[str, Run] = {}
    for run in runs:
        digest = run.calibration.provenance["log_sha256"]
        if digest in seen:
            raise InputError(
                f"{run.session.name}: holds the same log as {seen[digest].session.name}; name every launch once"
            )
        seen[digest] = run


def _mean_deviation(runs: Sequence[Run], name: str) -> float | None:
    """Mean deviation from the systematic calibration, where every session names one."""
    deviations = [d for run in runs if (d := _named(run)[name].deviation) is not None]
    return sum(deviations) / len(runs) if len(deviations) == len(runs) else None


def _covariance(runs: Sequence[Run], names: list[str], values: Array) -> Array:
    """Covariance of the mean (module docstring)."""
    count = len(runs)
    own = np.zeros((len(names), len(names)))
    for run in runs:
        if run.calibration.covariance is not None:
            order = [p.name for p in run.calibration.parameters]
            chosen = [order.index(name) for name in names]
            own += run.calibration.covariance[np.ix_(chosen, chosen)] / count**2
    between = values.var(axis=0, ddof=1) / count
    by_gravity = np.mean([_by_gravity(run, names) for run in runs], axis=0)
    excess = np.maximum(between - np.diag(own), 0.0)
    return np.asarray(own + np.diag(excess) + (1.0 - 1.0 / count) * np.outer(by_gravity, by_gravity))


def _by_gravity(run: Run, names: list[str]) -> Array:
    """Change of the parameters with one standard uncertainty of g: only accelerometer scale factors, −(1 + k) δg/g."""
    site, found = run.session.site, _named(run)
    return np.array(
        [-(1.0 + found[n].value) * site.gravity_u / site.gravity if n.startswith("accel.scale") else 0.0 for n in names]
    )


def _mean_model(frame: str, block: Block | None, values: Mapping[str, float]) -> SensorModel | None:
    """The sensor model of the mean parameters; None where a launch lacks one of them."""
    if block is None:
        return None
    convention = Convention(frame=frame_of(frame), block=block)
    if not set(convention.names) <= set(values):
        return None
    return convention.model(np.array([values[name] for name in convention.names]))


def _mean_magnetometer(values: Mapping[str, float]) -> SensorModel | None:
    """The model of the mean parameters of the magnetometer, where all launches have them."""
    names = [name for name in NAMES if name in values]
    return TRIAD.model(np.array([values[name] for name in names])) if len(names) == len(NAMES) else None


def _mean_increments(runs: Sequence[Run], names: list[str]) -> tuple[Mapping[str, float], ...]:
    """Mean increment of each parameter in each iteration; a launch that needed fewer has none in the last ones."""
    steps = zip_longest(*(run.calibration.iterations for run in runs), fillvalue={})
    return tuple({name: sum(step.get(name, 0.0) for step in at) / len(runs) for name in names} for at in steps)


def difference_percent(value: Array | float, reference: Array | float) -> Array:
    """How far values are from those of another method, % of the latter: the last column of the paper's Table 1."""
    return np.asarray(100.0 * (np.asarray(value) - reference) / reference)
