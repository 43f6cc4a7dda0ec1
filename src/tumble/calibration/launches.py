"""Several launches (power-ons) of one device: their mean, and how much it changes from launch to launch.

The uncertainty of the mean covers what the launches know of themselves and the instability between them: the mean of
their covariances over L, or on the diagonal the variance from launch to launch over L where that is larger. The
uncertainty of gravity is common to all launches of a site: it is taken out of both and does not average out
(`tumble.calibration.coverage`).
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import zip_longest
from pathlib import Path
from typing import TypeVar

import numpy as np

from tumble.calibration.calibrate import DEFAULT_METHOD, Terms, calibrate
from tumble.calibration.calibration_file import Calibration
from tumble.calibration.coverage import by_gravity, degrees_of_mean, shared_gravity
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


def _outcome(runs: Sequence[Run]) -> Outcome:
    """What is said of the sessions, each sentence with the name of its own.

    >>> import tumble
    >>> request = tumble.Setup.of(grade="mems", positions=12)
    >>> folders = [tumble.simulate_session(f"launch-{i}", request, seed=1, launch=i) for i in (1, 2)]
    >>> sessions = [tumble.read_session(folder) for folder in folders]
    >>> runs = [tumble.Run(session=each, calibration=tumble.calibrate(each)) for each in sessions]
    >>> tumble.mean_of_launches(runs)["accel.bias.x"].run_to_run > 0.0
    True
    """

    def said(what: Callable[[Outcome], tuple[str, ...]]) -> tuple[str, ...]:
        return tuple(f"{_name(run)}: {each}" for run in runs for each in what(run.calibration.outcome))

    return Outcome(
        reasons=said(lambda outcome: outcome.reasons),
        remarks=said(lambda outcome: outcome.remarks),
        unobservable=tuple(dict.fromkeys(name for run in runs for name in run.calibration.outcome.unobservable)),
        of_accel=said(lambda outcome: outcome.of_accel),
        of_gyro=said(lambda outcome: outcome.of_gyro),
    )


def mean_of_launches(runs: Sequence[Run]) -> Calibration:
    """One calibration from several sessions of one device by the same method: means with uncertainties, standard
    deviations from launch to launch, mean increments of each iteration, and every launch."""
    first = runs[0].calibration
    _check_alike(runs)
    common = [p.name for p in first.parameters if all(p.name in _named(run) for run in runs)]
    values = np.array([[_named(run)[name].value for name in common] for run in runs])
    spread = values.std(axis=0, ddof=1)
    covariance, degrees = _covariance(runs, common, spread)
    parameters = tuple(
        Parameter(
            name=name,
            value=float(value),
            u=float(u),
            unit=_named(runs[0])[name].unit,
            deviation=_mean_deviation(runs, name),
            run_to_run=float(each),
            dof=dof,
        )
        for name, value, u, each, dof in zip(
            common, values.mean(axis=0), np.sqrt(np.diag(covariance)), spread, degrees, strict=True
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
        outcome=_outcome(runs),
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


def _covariance(runs: Sequence[Run], names: list[str], run_to_run: Array) -> tuple[Array, list[float | None]]:
    """Covariance of the mean and degrees of freedom of its diagonal (module docstring)."""
    common = _common_part(runs, names)
    own = [_own(run, names) - np.outer(common, common) for run in runs]
    covariance = sum(own, np.zeros((len(names), len(names)))) / len(runs) ** 2 + np.outer(common, common)
    degrees: list[float | None] = []
    for i, name in enumerate(names):
        parts = [
            (float(each[i, i]), _without(_named(run)[name], common[i])) for each, run in zip(own, runs, strict=True)
        ]
        u, dof = degrees_of_mean(parts, float(run_to_run[i]), float(common[i]))
        covariance[i, i] = u**2
        degrees.append(dof)
    return covariance, degrees


def _own(run: Run, names: list[str]) -> Array:
    """The covariance of these parameters of a launch; zero where it has none."""
    if run.calibration.covariance is None:
        return np.zeros((len(names), len(names)))
    order = [p.name for p in run.calibration.parameters]
    chosen = [order.index(name) for name in names]
    return np.asarray(run.calibration.covariance[np.ix_(chosen, chosen)])


def _without(parameter: Parameter, common: float) -> float | None:
    """Degrees of freedom of the part of u² that is not common."""
    if parameter.dof is None or not parameter.u:
        return None
    return parameter.dof * (1.0 - (common / parameter.u) ** 2) ** 2


def _common_part(runs: Sequence[Run], names: list[str]) -> Array:
    """What one standard uncertainty of g changes in the parameters (m,) of all launches; zero where they are of several
    values of g, or do not count its uncertainty."""
    sites = [run.calibration.site for run in runs]
    if not all(shared_gravity(sites[0], site) for site in sites):
        return np.zeros(len(names))
    changes = [
        by_gravity([_named(run)[name] for name in names], _own(run, names), run.calibration.site) for run in runs
    ]
    return np.asarray(np.mean(changes, axis=0))


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
