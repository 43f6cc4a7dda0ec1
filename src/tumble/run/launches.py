"""Several launches (power-ons) of one device: their mean, and how much it changes from launch to launch.

The uncertainty of the mean covers what the launches know of themselves and the instability between them: the mean of
their covariances over L, or on the diagonal the variance from launch to launch over L where that is larger. The
uncertainty of gravity is common to all launches of a site, and what is wrong with a prior or the time base to all
launches: they are taken out of either and do not average out (`tumble.result.coverage`).
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import zip_longest
from pathlib import Path
from typing import TypeVar, get_args

import numpy as np

from tumble.errors import InputError
from tumble.files import FilePath
from tumble.inference.common_errors import by_time_base, clocked
from tumble.inference.estimate import GroupFinding, Outcome
from tumble.inference.prediction import Prediction, prediction
from tumble.methods.ellipsoid_fit import TRIAD
from tumble.methods.magnetometer import NAMES
from tumble.recording.circumstances import AirConditions, Circumstances
from tumble.recording.log import Log
from tumble.recording.session import Session
from tumble.recording.session_file import session_from
from tumble.result.calibration import Calibration
from tumble.result.coverage import by_gravity, degrees_of_mean, shared_gravity
from tumble.result.parts import Launch, Parameter
from tumble.result.shared_errors import by_priors
from tumble.run.calibrate import DEFAULT_METHOD, Method, Terms, calibrate, provenance_of
from tumble.run.observed import Progress
from tumble.run.same_recording import Means, check_recordings
from tumble.run.type_spread import TypeSpread, pooled
from tumble.sensors.frames import Convention, Frame, frame_of
from tumble.sensors.instrument import Instrument
from tumble.sensors.model import Block, SensorModel
from tumble.sensors.parameters import Variable, group_name, positions_by_group, to_temperature
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
    method: Method = DEFAULT_METHOD,
    iterations: int | None = None,
    frame: Frame = "accelerometer",
    terms: Terms = "full",
    alike: TypeSpread | None = None,
    progress: Progress = Log.chunks,
) -> Calibration:
    """Calibrate a device from one session or several, its launches: see `calibrate` and `mean_of_launches`.

    >>> import tumble
    >>> request = tumble.Setup.of(grade="mems", positions=12)
    >>> folders = [tumble.simulate_session(f"launch-{i}", request, seed=1, launch=i) for i in (1, 2)]
    >>> tumble.calibrate_launches(folders)
    <Calibration of mems-1: joint of 2 launches, 57 parameters, accepted>
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
    return mean_of_launches(runs, alike=alike) if len(runs) > 1 else runs[0].calibration


def _outcome(runs: Sequence[Run]) -> Outcome:
    """What is said of the sessions, each sentence with the name of its own."""

    def said(what: Callable[[Outcome], tuple[str, ...]]) -> tuple[str, ...]:
        return tuple(f"{_name(run)}: {each}" for run in runs for each in what(run.calibration.outcome))

    return Outcome(
        reasons=said(lambda outcome: outcome.reasons),
        remarks=said(lambda outcome: outcome.remarks),
        unobservable=tuple(dict.fromkeys(name for run in runs for name in run.calibration.outcome.unobservable)),
        of_accel=said(lambda outcome: outcome.of_accel),
        of_gyro=said(lambda outcome: outcome.of_gyro),
    )


def mean_of_launches(runs: Sequence[Run], *, alike: TypeSpread | None = None) -> Calibration:
    """One calibration from several sessions of one device by the same method: means with uncertainties, standard
    deviations from launch to launch, mean increments of each iteration, and every launch. With `alike`, the launches of
    other devices of the type, uncertainties are of the instability that all these show together.

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
    common = [p.name for p in first.parameters if all(p.name in _named(run) for run in runs)]
    reference = _mean_where_known([run.calibration.reference_temperature for run in runs])
    references = _mean_references(runs)
    moves = [_to_temperature(run, common, reference, references) for run in runs]
    values = np.array(
        [move @ [_named(run)[name].value for name in common] for run, move in zip(runs, moves, strict=True)]
    )
    spread = values.std(axis=0, ddof=1)
    instability = _instability(runs, common, spread, alike)
    covariance, degrees = _covariance(runs, moves, common, instability)
    mean, u = values.mean(axis=0), np.sqrt(np.diag(covariance))
    parameters = tuple(_mean_parameter(runs, *each) for each in zip(common, mean, u, spread, degrees, strict=True))
    means = dict(zip(common, mean.tolist(), strict=True))
    return Calibration(
        serial=first.serial,
        model=first.model,
        method=first.method,
        frame=first.frame,
        parameters=parameters,
        covariance=covariance,
        accel=_mean_model(first.frame, runs[0].session.accel_block, means),
        gyro=_mean_model(first.frame, runs[0].session.gyro_block, means),
        mag=_mean_magnetometer(means),
        outcome=_outcome(runs),
        iterations=_mean_increments(runs, common),
        site=_common([run.calibration.site for run in runs]),
        programme=_common([run.calibration.programme for run in runs]),
        readings=_common_items([run.calibration.readings for run in runs]),
        notes=(
            *_notes(runs),
            *_left_out(runs, common),
            *_pooled_with(common, instability, alike),
        ),
        launches=tuple(map(_launch, runs)),
        provenance=provenance_of(_digest_of_all(runs)),
        groups=_groups(runs, parameters),
        prediction=_prediction(runs, common, mean, covariance),
        axes=_common_items([run.calibration.axes for run in runs]),
        reference_temperature=reference,
        references=references,
        thermometers=_common_items([run.calibration.thermometers for run in runs]),
        circumstances=circumstances_of_all([run.calibration.circumstances for run in runs]),
        imu=_common_items([run.calibration.imu for run in runs]),
        sample_rate=_mean_where_known([run.calibration.sample_rate for run in runs]),
        clock_u=_clock_u(runs),
    )


def _mean_parameter(
    runs: Sequence[Run], name: str, value: float, u: float, run_to_run: float, degrees: float | None
) -> Parameter:
    """The mean of a parameter over the launches."""
    return Parameter(
        name=name,
        value=float(value),
        u=float(u),
        unit=_named(runs[0])[name].unit,
        deviation=_mean_deviation(runs, name),
        run_to_run=float(run_to_run),
        dof=degrees,
        **_learned(runs, name, float(u)),
    )


def _launch(run: Run) -> Launch:
    """A launch by itself, as it stands beside the mean."""
    own = run.calibration
    return Launch(
        session=_name(run),
        parameters=own.parameters,
        covariance=own.covariance,
        log_sha256=own.provenance["log_sha256"],
        site=own.site,
        circumstances=own.circumstances,
        rests=own.rests,
        turns=own.turns,
        fits=own.fits,
    )


def _digest_of_all(runs: Sequence[Run]) -> str:
    """The SHA-256 of the launches' logs together."""
    digests = [run.calibration.provenance["log_sha256"] for run in runs]
    return hashlib.sha256("\n".join(digests).encode()).hexdigest()


def circumstances_of_all(each: Sequence[Circumstances]) -> Circumstances:
    """What is the same in all launches, all their equipment, and the date of the last."""
    dates = [one.date for one in each if one.date is not None]
    return Circumstances(
        date=max(dates, default=None),
        operator=_common([one.operator for one in each]),
        air=_common([one.air for one in each]) or AirConditions(),
        equipment=tuple(dict.fromkeys(item for one in each for item in one.equipment)),
    )


def _common(values: Sequence[_Any]) -> _Any | None:
    """What all launches share; None where they differ."""
    return values[0] if all(value == values[0] for value in values) else None


def _common_items(values: Sequence[Mapping[str, _Any]]) -> dict[str, _Any]:
    """The entries that all launches share."""
    return {key: own for key, own in values[0].items() if all(each.get(key) == own for each in values)}


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
    check_recordings([(r.session.name, r.calibration.provenance["log_sha256"], _means(r.calibration)) for r in runs])


def _means(calibration: Calibration) -> Means:
    """What the sensors read in the rests of a calibration."""
    of_rests = [
        (rest, [sensors for sensors in (rest.accel, rest.gyro) if sensors is not None]) for rest in calibration.rests
    ]
    means = [np.concatenate([each.mean for each in sensors]) for _, sensors in of_rests if sensors]
    u = [
        np.concatenate([each.noise for each in sensors]) / np.sqrt(rest.stop - rest.start)
        for rest, sensors in of_rests
        if sensors
    ]
    return (np.array(means), np.array(u)) if means else (np.empty((0, 0)), np.empty((0, 0)))


def _mean_deviation(runs: Sequence[Run], name: str) -> float | None:
    """Mean deviation from the systematic calibration, where every session names one."""
    deviations = [d for run in runs if (d := _named(run)[name].deviation) is not None]
    return sum(deviations) / len(runs) if len(deviations) == len(runs) else None


@dataclass(frozen=True, kw_only=True, slots=True)
class _Instability:
    """A standard deviation from launch to launch with its degrees of freedom, by these launches and, where the device
    is `like` its type, those of the type."""

    s: float
    degrees: float
    like: bool


def _instability(
    runs: Sequence[Run], names: list[str], spread: Array, alike: TypeSpread | None
) -> tuple[_Instability, ...]:
    """How much the device changes from launch to launch in each of the parameters."""
    others = None if alike is None else alike.without({run.calibration.provenance["log_sha256"] for run in runs})
    found = []
    for name, own in zip(names, spread.tolist(), strict=True):
        noise = float(np.mean([(_named(run)[name].u or 0.0) ** 2 for run in runs]))
        of_type = (0.0, 0.0) if others is None else others.of(name, noise)
        both = pooled(own**2, len(runs) - 1.0, of_type)
        s2, degrees = (own**2, len(runs) - 1.0) if both is None else both
        found.append(_Instability(s=float(np.sqrt(s2)), degrees=degrees, like=both is not None))
    return tuple(found)


def _pooled_with(names: list[str], found: Sequence[_Instability], alike: TypeSpread | None) -> tuple[str, ...]:
    """With what the instability was pooled, as notes."""
    if alike is None:
        return ()
    unlike = [name for name, each in zip(names, found, strict=True) if not each.like]
    said = (
        f"instability from launch to launch: by all launches of the type {alike.model} in the registry, "
        f"{alike.degrees} degrees of freedom"
    )
    own = f"more unstable than the type, and by these launches alone: {', '.join(unlike)}"
    return (said, own) if unlike else (said,)


def _covariance(
    runs: Sequence[Run], moves: Sequence[Array], names: list[str], instability: Sequence[_Instability]
) -> tuple[Array, list[float | None]]:
    """Covariance of the mean and degrees of freedom of its diagonal (module docstring)."""
    count = len(runs)
    whole = [move @ _own(run, names) @ move.T for run, move in zip(runs, moves, strict=True)]
    gravity = _gravity_in_common(runs, names, whole)
    by_prior = [_by_prior(run, names, covariance) for run, covariance in zip(runs, whole, strict=True)]
    clock = by_time_base(names, clocked(_clock_u(runs), runs[0].session.log.increments))
    of_site = np.outer(gravity, gravity) + np.outer(clock, clock)
    own = [c - of_site - of_prior for c, of_prior in zip(whole, by_prior, strict=True)]
    common = of_site + np.mean(by_prior, axis=0)
    covariance = np.sum(own, axis=0) / count**2 + common
    degrees: list[float | None] = []
    for i, name in enumerate(names):
        parts = [
            _own_variance(_named(run)[name], float(c[i, i]), float(each[i, i]))
            for run, c, each in zip(runs, whole, own, strict=True)
        ]
        shown = instability[i]
        u, dof = degrees_of_mean(parts, shown.s, float(np.sqrt(common[i, i])), degrees=shown.degrees)
        covariance[i, i] = u**2
        degrees.append(dof)
    return np.asarray(covariance), degrees


def _own(run: Run, names: list[str]) -> Array:
    """The covariance of these parameters of a launch; zero where it has none."""
    if run.calibration.covariance is None:
        return np.zeros((len(names), len(names)))
    order = [p.name for p in run.calibration.parameters]
    chosen = [order.index(name) for name in names]
    return np.asarray(run.calibration.covariance[np.ix_(chosen, chosen)])


def _own_variance(parameter: Parameter, whole: float, own: float) -> tuple[float, float | None]:
    """The part of a variance that is not common, and its degrees of freedom."""
    own = max(own, 0.0)
    return own, None if parameter.dof is None or whole == 0.0 else parameter.dof * (own / whole) ** 2


def _clock_u(runs: Sequence[Run]) -> float:
    """The uncertainty of the time base that all launches have at least."""
    return min(run.session.log.time_base_u for run in runs)


def _gravity_in_common(runs: Sequence[Run], names: list[str], covariances: Sequence[Array]) -> Array:
    """What one standard uncertainty of g changes in the parameters (m,) of all launches; zero where they are of several
    values of g, or do not count its uncertainty."""
    sites = [run.calibration.site for run in runs]
    if not all(shared_gravity(sites[0], site) for site in sites):
        return np.zeros(len(names))
    changes = [
        by_gravity([_named(run)[name] for name in names], covariance, run.calibration.site)
        for run, covariance in zip(runs, covariances, strict=True)
    ]
    return np.asarray(np.mean(changes, axis=0))


def _by_prior(run: Run, names: list[str], covariance: Array) -> Array:
    """Covariance that comes from the priors: what is wrong with them is the same in every launch."""
    changes = by_priors([_named(run)[name] for name in names], covariance)
    return sum((np.outer(each, each) for each in changes.values()), start=np.zeros_like(covariance))


def _learned(runs: Sequence[Run], name: str, u: float) -> dict[str, float]:
    """The widest prior of the launches and the part of its variance that they have taken off together."""
    priors = [prior for run in runs if (prior := _named(run)[name].prior) is not None]
    if not priors:
        return {}
    return {"prior": max(priors), "learned": float(np.clip(1.0 - (u / max(priors)) ** 2, 0.0, 1.0))}


def _groups(runs: Sequence[Run], parameters: tuple[Parameter, ...]) -> tuple[GroupFinding, ...]:
    """What all launches together say of each group beyond the linear model; of one that not all have kept, nothing."""
    learned: dict[str, list[float]] = {}
    for parameter in parameters:
        if parameter.learned is not None:
            learned.setdefault(group_name(parameter.name), []).append(parameter.learned)
    findings = {group.name: group for run in runs for group in run.calibration.groups}
    return tuple(
        replace(group, kept=name in learned, learned=tuple(learned.get(name, [0.0] * len(group.learned))))
        for name, group in findings.items()
    )


def _notes(runs: Sequence[Run]) -> Iterator[str]:
    """What there is to say of the launches, once, with the launches of which it holds."""
    said: dict[str, list[str]] = {}
    for run in runs:
        for note in run.calibration.notes:
            said.setdefault(note, []).append(_name(run))
    for note, names in said.items():
        yield f"{'every launch' if len(names) == len(runs) else ', '.join(names)}: {note}"


def _left_out(runs: Sequence[Run], names: list[str]) -> tuple[str, ...]:
    """The groups of parameters that some launches have and not all, as a note."""
    known = positions_by_group(p.name for run in runs for p in run.calibration.parameters if p.name not in names)
    return (f"left out of the mean, not known of every launch: {', '.join(known)}",) if known else ()


def _prediction(runs: Sequence[Run], names: list[str], values: Array, covariance: Array) -> Prediction | None:
    """What readings corrected with the mean are known to; None where the launches do not say, or in another frame."""
    own, session = [run.calibration.prediction for run in runs], runs[0].session
    known, further = [each for each in own if each is not None], set(positions_by_group(names))
    instrument = Instrument.of(session.accel_block, session.gyro_block, further, variables=get_args(Variable))
    framed = runs[0].calibration.frame == "accelerometer"
    if len(known) < len(own) or not framed or not set(instrument.names) <= set(names):
        return None
    at = [names.index(name) for name in instrument.names]
    rates = [each.at_rate for each in known if each.at_rate is not None]
    return prediction(
        instrument,
        values[at],
        covariance[np.ix_(at, at)],
        gravity=float(np.mean([run.session.site.gravity for run in runs])),
        rate=float(np.mean(rates)) if len(rates) == len(known) else None,
    )


def _mean_where_known(values: Sequence[float | None]) -> float | None:
    """The mean over the launches; None where one has none."""
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if len(known) == len(values) else None


def _mean_references(runs: Sequence[Run]) -> dict[str, tuple[float, ...]]:
    """Those of each sensor by its own thermometer."""
    first, every = runs[0].calibration.references, [run.calibration.references for run in runs]
    if any(
        {kind: len(own) for kind, own in each.items()} != {k: len(own) for k, own in first.items()} for each in every
    ):
        return {}
    return {kind: tuple(np.mean([each[kind] for each in every], axis=0).tolist()) for kind in first}


def _to_temperature(
    run: Run, names: list[str], reference: float | None, references: Mapping[str, tuple[float, ...]]
) -> Array:
    """The matrix (m, m) that takes parameters of a launch to other reference temperatures."""
    own = run.calibration
    if reference is None or own.reference_temperature is None:
        return np.eye(len(names))
    there = replace(own, reference_temperature=reference, references=references)
    return to_temperature(names, np.array([there.reference_of(name) - own.reference_of(name) for name in names]))


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
