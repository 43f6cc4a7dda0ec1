"""Several launches (power-ons) of one device: their mean, and how much it changes from launch to launch.

The uncertainty of the mean covers what the launches know of themselves and the instability between them: the mean of
their covariances over L, or on the diagonal the variance from launch to launch over L where that is larger. The
uncertainty of gravity is common to all launches of a site, and what is wrong with a prior or the time base to all
launches: they are taken out of either and do not average out (`tumble.result.coverage`).
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import zip_longest
from pathlib import Path
from typing import TypeVar, get_args

import numpy as np

from tumble.errors import InputError
from tumble.files import FilePath
from tumble.inference.estimate import GroupFinding, Outcome
from tumble.inference.prediction import Prediction, prediction
from tumble.inference.sources import UncertaintyBudget, by_time_base, clocked, source
from tumble.methods.ellipsoid_fit import TRIAD
from tumble.methods.magnetometer import NAMES
from tumble.recording.log import Log
from tumble.recording.session import AirConditions, Circumstances, Session
from tumble.recording.session_file import session_from
from tumble.result.calibration import Calibration
from tumble.result.coverage import by_gravity, degrees_of_mean, shared_gravity
from tumble.result.parts import Launch, Parameter
from tumble.result.shared_errors import by_priors
from tumble.result.uncertainty_budget import contributions_of
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

    @property
    def name(self) -> str:
        """What the session is called among the launches."""
        return Path(self.session.name).name or self.session.name


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
    runs = []
    for session in map(session_from, sessions):
        made = calibrate(session, method=method, iterations=iterations, frame=frame, terms=terms, progress=progress)
        runs.append(Run(session=session, calibration=made))
    return mean_of_launches(runs, alike=alike) if len(runs) > 1 else runs[0].calibration


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
    launches = [run.calibration for run in runs]
    first, session, count = launches[0], runs[0].session, len(runs)
    _check_alike(runs)
    names = [name for name in first if all(name in launch for launch in launches)]
    members = [[launch[name] for launch in launches] for name in names]
    reference = _mean_where_known([launch.reference_temperature for launch in launches])
    references = _mean_references([launch.references for launch in launches])
    moves = [_to_temperature(launch, names, reference, references) for launch in launches]
    values = np.array([move @ [launch[n].value for n in names] for launch, move in zip(launches, moves, strict=True)])
    mean, spread = values.mean(axis=0), values.std(axis=0, ddof=1)
    digests = [launch.provenance["log_sha256"] for launch in launches]

    # how much the device changes from launch to launch, by these launches and, where it is like them, those of its type
    others = None if alike is None else alike.without(set(digests))
    instability, unlike = [], []
    for name, each, s in zip(names, members, spread.tolist(), strict=True):
        noise = float(np.mean([(p.u or 0.0) ** 2 for p in each]))
        both = pooled(s**2, count - 1.0, (0.0, 0.0) if others is None else others.of(name, noise))
        unlike += [name] if both is None else []
        instability.append((s**2, count - 1.0) if both is None else both)

    # covariance of the mean and degrees of freedom of its diagonal (module docstring)
    whole = [move @ _covariance_of(launch, names) @ move.T for launch, move in zip(launches, moves, strict=True)]
    gravity = _gravity_in_common(launches, names, whole)
    clock_u = min(run.session.log.time_base_u for run in runs)
    clock = by_time_base(names, clocked(clock_u, session.log.increments))
    of_site = np.outer(gravity, gravity) + np.outer(clock, clock)
    of_priors = [
        sum((np.outer(each, each) for each in by_priors([launch[n] for n in names], C).values()), np.zeros_like(C))
        for launch, C in zip(launches, whole, strict=True)
    ]
    apart = [np.diag(C - of_site - of_prior).clip(0.0) for C, of_prior in zip(whole, of_priors, strict=True)]
    common = of_site + np.mean(of_priors, axis=0)
    covariance = np.sum([C - of_site - P for C, P in zip(whole, of_priors, strict=True)], axis=0) / count**2 + common
    of_launches = covariance - common
    np.fill_diagonal(of_launches, np.sum(apart, axis=0) / count**2)
    parameters = []
    for i, (name, each) in enumerate(zip(names, members, strict=True)):
        parts = []
        for p, C, variance in zip(each, whole, apart, strict=True):
            dof = None if p.dof is None or C[i, i] == 0.0 else p.dof * float(variance[i] / C[i, i]) ** 2
            parts.append((float(variance[i]), dof))
        s2, degrees = instability[i]
        u, dof = degrees_of_mean(parts, float(np.sqrt(s2)), float(np.sqrt(common[i, i])), degrees=degrees)
        covariance[i, i] = u**2
        deviations = [p.deviation for p in each if p.deviation is not None]
        prior = max((p.prior for p in each if p.prior is not None), default=None)
        parameters.append(
            Parameter(
                name=name,
                value=float(mean[i]),
                u=float(np.sqrt(covariance[i, i])),
                unit=each[0].unit,
                deviation=sum(deviations) / count if len(deviations) == count else None,
                run_to_run=float(spread[i]),
                dof=dof,
                prior=prior,
                learned=None if prior is None else float(np.clip(1.0 - (u / prior) ** 2, 0.0, 1.0)),
            )
        )
    by_name = dict(zip(names, mean.tolist(), strict=True))
    of_gravity, of_clock = np.outer(gravity, gravity), np.outer(clock, clock)
    budget = UncertaintyBudget(sources=(source("within launches"),), covariances=of_launches[None])
    for own, of_own in (
        (source("launches", dof=count - 1.0 if others is None else None), covariance - of_launches - common),
        (source("gravity", first.site.gravity_u if first.site else None, "m/s^2"), of_gravity),
        (source("clock", clock_u, "1"), of_clock),
        (source("priors"), common - of_gravity - of_clock),
    ):
        budget = budget.beside(own, of_own)
    return Calibration(
        serial=first.serial,
        model=first.model,
        method=first.method,
        frame=first.frame,
        parameters=tuple(parameters),
        covariance=covariance,
        accel=_mean_model(first.frame, session.accel_block, by_name),
        gyro=_mean_model(first.frame, session.gyro_block, by_name),
        mag=TRIAD.model(np.array([by_name[n] for n in NAMES])) if set(NAMES) <= set(names) else None,
        outcome=_outcome(runs),
        iterations=tuple(
            {name: sum(step.get(name, 0.0) for step in steps) / count for name in names}
            for steps in zip_longest(
                *(launch.iterations for launch in launches), fillvalue={}
            )  # fewer: none at the end
        ),
        site=_common([launch.site for launch in launches]),
        programme=_common([launch.programme for launch in launches]),
        readings=_common_items([launch.readings for launch in launches]),
        notes=(*_notes(runs), *_left_out(launches, names), *_pooled_with(alike, unlike)),
        launches=tuple(map(_launch, runs)),
        provenance=provenance_of(digest_of_all(digests)),
        groups=_groups(launches, parameters),
        budget=contributions_of(budget, names),
        prediction=_prediction(runs, names, mean, covariance),
        axes=_common_items([launch.axes for launch in launches]),
        reference_temperature=reference,
        references=references,
        thermometers=_common_items([launch.thermometers for launch in launches]),
        circumstances=circumstances_of_all([launch.circumstances for launch in launches]),
        imu=_common_items([launch.imu for launch in launches]),
        sample_rate=_mean_where_known([launch.sample_rate for launch in launches]),
        clock_u=clock_u,
    )


def digest_of_all(digests: Iterable[str]) -> str:
    """The SHA-256 of those of several logs."""
    return hashlib.sha256("\n".join(digests).encode()).hexdigest()


def circumstances_of_all(each: Sequence[Circumstances]) -> Circumstances:
    """What is the same in all launches, all their equipment, and the date of the last."""
    return Circumstances(
        date=max((one.date for one in each if one.date is not None), default=None),
        operator=_common([one.operator for one in each]),
        air=_common([one.air for one in each]) or AirConditions(),
        equipment=tuple(dict.fromkeys(item for one in each for item in one.equipment)),
    )


def _outcome(runs: Sequence[Run]) -> Outcome:
    """What is said of the sessions, each sentence with the name of its own."""

    def sentences(what: Callable[[Outcome], tuple[str, ...]]) -> tuple[str, ...]:
        return tuple(f"{run.name}: {each}" for run in runs for each in what(run.calibration.outcome))

    return Outcome(
        reasons=sentences(lambda outcome: outcome.reasons),
        remarks=sentences(lambda outcome: outcome.remarks),
        unobservable=tuple(dict.fromkeys(name for run in runs for name in run.calibration.outcome.unobservable)),
        of_accel=sentences(lambda outcome: outcome.of_accel),
        of_gyro=sentences(lambda outcome: outcome.of_gyro),
    )


def _launch(run: Run) -> Launch:
    """A launch by itself, as it stands beside the mean."""
    launch = run.calibration
    return Launch(
        session=run.name,
        parameters=launch.parameters,
        covariance=launch.covariance,
        log_sha256=launch.provenance["log_sha256"],
        site=launch.site,
        circumstances=launch.circumstances,
        rests=launch.rests,
        turns=launch.turns,
        fits=launch.fits,
    )


def _common(values: Sequence[_Any]) -> _Any | None:
    """What all launches share; None where they differ."""
    return values[0] if all(value == values[0] for value in values) else None


def _common_items(values: Sequence[Mapping[str, _Any]]) -> dict[str, _Any]:
    """The entries that all launches share."""
    return {key: value for key, value in values[0].items() if all(each.get(key) == value for each in values)}


def _mean_where_known(values: Sequence[float | None]) -> float | None:
    """The mean over the launches; None where one has none."""
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if len(known) == len(values) else None


def _check_alike(runs: Sequence[Run]) -> None:
    serial = runs[0].calibration.serial
    for run in runs[1:]:
        if run.calibration.serial != serial:
            raise InputError(
                f"{run.session.name}: expected a launch of device {serial!r} like the first "
                f"session, found {run.calibration.serial!r}; calibrate each device by itself"
            )
    check_recordings([(r.session.name, r.calibration.provenance["log_sha256"], _means(r.calibration)) for r in runs])


def _means(calibration: Calibration) -> Means:
    """What the sensors read in the rests of a calibration."""
    means, u = [], []
    for rest in calibration.rests:
        sensors = [each for each in (rest.accel, rest.gyro) if each is not None]
        if sensors:
            means.append(np.concatenate([each.mean for each in sensors]))
            u.append(np.concatenate([each.noise for each in sensors]) / np.sqrt(rest.stop - rest.start))
    return (np.array(means), np.array(u)) if means else (np.empty((0, 0)), np.empty((0, 0)))


def _covariance_of(launch: Calibration, names: list[str]) -> Array:
    """The covariance of these parameters of a launch; zero where it has none."""
    if launch.covariance is None:
        return np.zeros((len(names), len(names)))
    order = list(launch)
    chosen = [order.index(name) for name in names]
    return np.asarray(launch.covariance[np.ix_(chosen, chosen)])


def _gravity_in_common(launches: Sequence[Calibration], names: list[str], covariances: Sequence[Array]) -> Array:
    """What one standard uncertainty of g changes in the parameters (m,) of all launches; zero where they are of several
    values of g, or do not count its uncertainty."""
    if not all(shared_gravity(launches[0].site, launch.site) for launch in launches):
        return np.zeros(len(names))
    changes = [by_gravity([x[n] for n in names], C, x.site) for x, C in zip(launches, covariances, strict=True)]
    return np.asarray(np.mean(changes, axis=0))


def _groups(launches: Sequence[Calibration], parameters: Sequence[Parameter]) -> tuple[GroupFinding, ...]:
    """What all launches together say of each group beyond the linear model; of one that not all have kept, nothing."""
    learned: dict[str, list[float]] = {}
    for parameter in parameters:
        if parameter.learned is not None:
            learned.setdefault(group_name(parameter.name), []).append(parameter.learned)
    findings = {group.name: group for launch in launches for group in launch.groups}
    return tuple(
        replace(group, kept=name in learned, learned=tuple(learned.get(name, [0.0] * len(group.learned))))
        for name, group in findings.items()
    )


def _notes(runs: Sequence[Run]) -> Iterator[str]:
    """What there is to say of the launches, once, with the launches of which it holds."""
    names_by_note: dict[str, list[str]] = {}
    for run in runs:
        for note in run.calibration.notes:
            names_by_note.setdefault(note, []).append(run.name)
    for note, names in names_by_note.items():
        yield f"{'every launch' if len(names) == len(runs) else ', '.join(names)}: {note}"


def _left_out(launches: Sequence[Calibration], names: list[str]) -> tuple[str, ...]:
    """The groups of parameters that some launches have and not all, as a note."""
    known = positions_by_group(name for launch in launches for name in launch if name not in names)
    return (f"left out of the mean, not known of every launch: {', '.join(known)}",) if known else ()


def _pooled_with(alike: TypeSpread | None, unlike: list[str]) -> Iterator[str]:
    """With what the instability was pooled, as notes."""
    if alike is not None:
        yield (
            f"instability from launch to launch: by all launches of the type {alike.model} in the registry, "
            f"{alike.degrees} degrees of freedom"
        )
        if unlike:
            yield f"more unstable than the type, and by these launches alone: {', '.join(unlike)}"


def _prediction(runs: Sequence[Run], names: list[str], values: Array, covariance: Array) -> Prediction | None:
    """What readings corrected with the mean are known to; None where the launches do not say, or in another frame."""
    session, known = runs[0].session, [run.calibration.prediction for run in runs]
    further = set(positions_by_group(names))
    instrument = Instrument.of(session.accel_block, session.gyro_block, further, variables=get_args(Variable))
    framed = runs[0].calibration.frame == "accelerometer"
    if None in known or not framed or not set(instrument.names) <= set(names):
        return None
    at = [names.index(name) for name in instrument.names]
    return prediction(
        instrument,
        values[at],
        covariance[np.ix_(at, at)],
        gravity=float(np.mean([run.session.site.gravity for run in runs])),
        rate=_mean_where_known([None if each is None else each.at_rate for each in known]),
    )


def _mean_references(every: Sequence[Mapping[str, tuple[float, ...]]]) -> dict[str, tuple[float, ...]]:
    """The reference temperatures of each sensor by its own thermometer; none where launches have other sensors."""
    sizes = [{kind: len(celsius) for kind, celsius in references.items()} for references in every]
    if any(each != sizes[0] for each in sizes):
        return {}
    return {kind: tuple(np.mean([each[kind] for each in every], axis=0).tolist()) for kind in every[0]}


def _to_temperature(
    launch: Calibration, names: list[str], reference: float | None, references: Mapping[str, tuple[float, ...]]
) -> Array:
    """The matrix (m, m) that takes parameters of a launch to other reference temperatures."""
    if reference is None or launch.reference_temperature is None:
        return np.eye(len(names))
    there = replace(launch, reference_temperature=reference, references=references)
    return to_temperature(names, np.array([there.reference_of(n) - launch.reference_of(n) for n in names]))


def _mean_model(frame: str, block: Block | None, values: Mapping[str, float]) -> SensorModel | None:
    """The sensor model of the mean parameters; None where a launch lacks one of them."""
    if block is None:
        return None
    convention = Convention(frame=frame_of(frame), block=block)
    if not set(convention.names) <= set(values):
        return None
    return convention.model(np.array([values[name] for name in convention.names]))


def difference_percent(value: Array | float, reference: Array | float) -> Array:
    """How far values are from those of another method, % of the latter: the last column of the paper's Table 1."""
    return np.asarray(100.0 * (np.asarray(value) - reference) / reference)
