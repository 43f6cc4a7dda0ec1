"""Several launches (power-ons) of one device: their mean, and how much it changes from launch to launch.

The uncertainty of the mean covers what the launches know of themselves and the instability between them: the mean of
their covariances over L, or on the diagonal the variance from launch to launch over L where that is larger. The
uncertainty of gravity is common to all launches of a site, and what is wrong with a prior or the time base to all
launches: they are taken out of either and do not average out (`tumble.result.coverage`).
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain, combinations, zip_longest
from pathlib import Path
from typing import Any, TypeVar, get_args

import numpy as np

from tumble.arguments import checked
from tumble.errors import InputError
from tumble.files import FilePath
from tumble.inference.estimate import GroupFinding, Outcome
from tumble.inference.magnetic_estimate import block_near
from tumble.inference.prediction import Prediction, prediction
from tumble.inference.prior import DevicePrior
from tumble.inference.sources import UncertaintyBudget, clock_effects, clock_errors, source
from tumble.recording.log import Log
from tumble.recording.session import AirConditions, Circumstances, Session
from tumble.recording.session_file import session_from
from tumble.result.calibration import Calibration
from tumble.result.coverage import by_gravity, degrees_of_mean, shared_gravity, welch_satterthwaite
from tumble.result.launch_variances import LaunchVariances, at_temperature, own_variance, pooled, variance_of_type
from tumble.result.parts import CalibratedTemperature, Evidence, Parameter, SourceContributions, learned_fraction
from tumble.result.shared_errors import by_priors, is_of_device
from tumble.result.uncertainty_budget import contributions_of
from tumble.run.calibrate import DEFAULT_METHOD, Method, calibrate, provenance_of
from tumble.run.magnetometer import NAMES
from tumble.run.observed import Progress
from tumble.sensors.frames import Convention, Frame, frame_of
from tumble.sensors.instrument import Instrument
from tumble.sensors.model import Block, SensorModel
from tumble.sensors.parameters import Terms, Variable, beyond_linear, group_name, positions_by_group
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


@checked
def calibrate_launches(
    sessions: Sequence[Session | FilePath],
    *,
    method: Method = DEFAULT_METHOD,
    iterations: int | None = None,
    frame: Frame = "accelerometer",
    terms: Terms = "full",
    alike: Sequence[LaunchVariances] = (),
    prior: DevicePrior | None = None,
    progress: Progress = Log.chunks,
) -> Calibration:
    """Calibrate a device from one session or from several, its launches.

    Parameters
    ----------
    sessions
        Sessions or the paths of their folders.
    method, iterations, frame, terms, progress
        See `calibrate`.
    alike
        Launches of other devices of the type, by which the instability from launch to launch is better known.
    prior
        See `calibrate`; for one session alone, since in the mean of several it would count as often.

    Returns
    -------
    Calibration
        Of several sessions the mean, with the standard deviation from launch to launch and every launch in its
        `evidence`.

    Raises
    ------
    InputError
        For sessions of different devices, and for one recording given twice.

    Examples
    --------
    >>> import tumble
    >>> request = tumble.Setup.of(grade="mems", positions=12)
    >>> folders = [tumble.simulate_session(f"launch-{i}", request, seed=1, launch=i) for i in (1, 2)]
    >>> tumble.calibrate_launches(folders)
    <Calibration of mems-1: joint of 2 launches, 51 parameters, accepted>
    """
    if not sessions:
        raise InputError("sessions: expected at least one, found none")
    if prior is not None and len(sessions) > 1:
        raise InputError(f"prior: expected one session with it, found {len(sessions)}")
    words: dict[str, Any] = {"iterations": iterations, "frame": frame, "terms": terms, "prior": prior}
    runs = [
        Run(session=session, calibration=calibrate(session, method=method, progress=progress, **words))
        for session in map(session_from, sessions)
    ]
    return mean_of_launches(runs, alike=alike) if len(runs) > 1 else runs[0].calibration


def mean_of_launches(runs: Sequence[Run], *, alike: Sequence[LaunchVariances] = ()) -> Calibration:
    """Mean of the calibrations of several sessions of one device by the same method, see `calibrate_launches`."""
    launches = [run.calibration for run in runs]
    first, session, count = launches[0], runs[0].session, len(runs)
    sources = [launch.provenance for launch in launches]
    digests = [each.log_sha256 or "" for each in sources]
    for run in runs[1:]:
        if run.calibration.serial != first.serial:
            raise InputError(
                f"{run.session.name}: expected a launch of device {first.serial!r} like the first session, found "
                f"{run.calibration.serial!r}; calibrate each device by itself"
            )
    check_recordings([run.session for run in runs], digests)
    names = [name for name in first if all(name in launch for launch in launches)]
    references = [launch.temperature.references for launch in launches]
    alike_sensors = _common([{kind: len(celsius) for kind, celsius in each.items()} for each in references]) or ()
    temperature = CalibratedTemperature(
        reference=_mean_where_known([launch.reference_temperature for launch in launches]),
        thermometers=_common_items([launch.temperature.thermometers for launch in launches]),
        references={k: tuple(np.mean([each[k] for each in references], axis=0).tolist()) for k in alike_sensors},
    )
    values, covariances = at_temperature(launches, names, temperature)
    clock_u = min(run.session.log.time_base_u for run in runs)
    by_clock = clock_errors(names, clock_effects(clock_u, session.log.increments))
    shared = _shared_covariances(launches, names, covariances, by_clock)
    instability, pooled_with = _instability(launches, names, values, digests, alike)
    parameters, covariance, of_launches = _mean_parameters(launches, names, values, covariances, shared, instability)
    mean, of_common = values.mean(axis=0), sum(each.mean(axis=0) for each in shared.values())
    budget = _by_source(launches, names, shared, of_launches)
    site = first.provenance.site
    for each, part in (
        (source("launches", dof=None if alike else count - 1.0), covariance - of_launches - of_common),
        (source("gravity", None if site is None else site.gravity_u, "m/s^2"), shared["gravity"][0]),
        (source("clock", clock_u, "1"), shared["clock"][0]),
    ):
        budget = budget.with_source(each, part)
    by_name = dict(zip(names, mean.tolist(), strict=True))
    convention = frame_of(first.frame)
    return Calibration(
        device=replace(first.device, imu=_common_items([launch.imu for launch in launches])),
        method=first.method,
        frame=first.frame,
        parameters=parameters,
        covariance=covariance,
        accel=_mean_model(convention, session.accel_block, by_name),
        gyro=_mean_model(convention, session.gyro_block, by_name),
        mag=None if first.mag is None else _mean_model("accelerometer", block_near(first.mag.matrix), by_name),
        outcome=Outcome(  # every sentence with the name of its session
            reasons=tuple(f"{run.name}: {reason}" for run in runs for reason in run.calibration.outcome.reasons),
            remarks=tuple(f"{run.name}: {remark}" for run in runs for remark in run.calibration.outcome.remarks),
            unobservable=tuple(dict.fromkeys(name for launch in launches for name in launch.outcome.unobservable)),
            concerns={f"{run.name}: {s}": on for run in runs for s, on in run.calibration.outcome.concerns.items()},
        ),
        groups=_groups(launches, parameters),
        prediction=_prediction(runs, names, mean, covariance),
        axes=_common_items([launch.axes for launch in launches]),
        temperature=temperature,
        evidence=Evidence(
            budget=contributions_of(budget, names),
            iterations=tuple(  # of a launch with fewer iterations the last ones added nothing
                {name: sum(step.get(name, 0.0) for step in steps) / count for name in names}
                for steps in zip_longest(*(launch.evidence.iterations for launch in launches), fillvalue={})
            ),
            launches=tuple(run.calibration.as_launch(run.name) for run in runs),
        ),
        provenance=replace(
            provenance_of(digest_of_all(digests)),
            site=_common([each.site for each in sources]),
            sample_rate=_mean_where_known([each.sample_rate for each in sources]),
            clock_u=clock_u,
            circumstances=circumstances_of_all([each.circumstances for each in sources]),
            programme=_common([each.programme for each in sources]),
            readings=_common_items([each.readings for each in sources]),
            notes=(*_notes(runs, names), *pooled_with),
            assumptions=tuple(dict.fromkeys(chain(*(each.assumptions for each in sources)))),
        ),
    )


# -------------------- the statistics of the mean (see `tumble.result.coverage`) --------------------


def _shared_covariances(
    launches: Sequence[Calibration], names: Sequence[str], covariances: Array, by_clock: Array
) -> dict[str, Array]:
    """Covariances (L, m, m) of errors that the launches have in common, by source: of gravity where they used one value
    of it, of the time base, one standard uncertainty of which changes `by_clock` (m,), and of the priors of groups."""
    site, members = launches[0].provenance.site, [[launch[n] for n in names] for launch in launches]
    gravity = np.zeros(len(names))
    if all(shared_gravity(site, launch.provenance.site) for launch in launches):
        gravity = np.mean([by_gravity(p, C, site) for p, C in zip(members, covariances, strict=True)], axis=0)
    shared = {
        "gravity": np.broadcast_to(np.outer(gravity, gravity), covariances.shape),
        "clock": np.broadcast_to(np.outer(by_clock, by_clock), covariances.shape),
    }
    for i, (parameters, C, launch) in enumerate(zip(members, covariances, launches, strict=True)):
        changes = [
            (f"prior.{group_name(name)}", np.outer(each, each))
            for name, each in by_priors(parameters, C, launch.evidence.budget).items()
        ]
        known = {prior for prior, _ in changes}
        for each in launch.evidence.budget:  # of groups that are in u alone, as with linear terms
            prior, _, group = each.name.partition(".")
            if prior == "prior" and beyond_linear(group) and each.name not in known and is_of_device(group):
                changes.append((each.name, np.diag([each.contributions.get(name, 0.0) ** 2 for name in names])))
        for prior, square in changes:
            shared.setdefault(prior, np.zeros_like(covariances))[i] += square
    return shared


def _instability(
    launches: Sequence[Calibration],
    names: Sequence[str],
    values: Array,
    digests: Sequence[str],
    alike: Sequence[LaunchVariances],
) -> tuple[list[tuple[float, float]], tuple[str, ...]]:
    """Variance from launch to launch of every parameter with its degrees of freedom, by these launches and, if the
    device is like them, by those of its type; and notes on that."""
    others, degrees = [each for each in alike if not each.logs & set(digests)], len(launches) - 1.0
    instability, unlike, model = [], [], launches[0].model
    for name, s2 in zip(names, np.var(values, axis=0, ddof=1).tolist(), strict=True):
        noise = float(np.mean([own_variance(launch, name) for launch in launches]))
        both = pooled(s2, degrees, variance_of_type(others, name, noise))
        unlike += [name] if both is None else []
        instability.append(both or (s2, degrees))
    if not alike:
        return instability, ()
    note = (
        f"instability from launch to launch: by all launches of {'its type' if model is None else f'the type {model}'} "
        f"in the registry, {sum(each.degrees for each in alike)} degrees of freedom"
    )
    apart = (f"more unstable than the type, and by these launches alone: {', '.join(unlike)}",) if unlike else ()
    return instability, (note, *apart)


def _mean_parameters(
    launches: Sequence[Calibration],
    names: Sequence[str],
    values: Array,
    covariances: Array,
    shared: Mapping[str, Array],
    instability: Sequence[tuple[float, float]],
) -> tuple[tuple[Parameter, ...], Array, Array]:
    """Parameters of the mean with their covariance (m, m), and the part (m, m) of it from the launches themselves."""
    count, of_common = len(launches), np.sum([each.mean(axis=0) for each in shared.values()], axis=0)
    apart = covariances - np.sum([*shared.values()], axis=0)
    variances = np.diagonal(apart, axis1=1, axis2=2).clip(0.0)
    of_launches = apart.sum(axis=0) / count**2
    covariance = of_launches + of_common
    np.fill_diagonal(of_launches, variances.sum(axis=0) / count**2)
    parameters = []
    for i, name in enumerate(names):
        each = [launch[name] for launch in launches]
        parts = []
        for p, C, variance in zip(each, covariances, variances, strict=True):
            dof = None if p.dof is None or C[i, i] == 0.0 else p.dof * float(variance[i] / C[i, i]) ** 2
            parts.append((float(variance[i]), dof))
        s2, degrees = instability[i]
        u, dof = degrees_of_mean(parts, float(np.sqrt(s2)), float(np.sqrt(of_common[i, i])), degrees=degrees)
        covariance[i, i] = u**2
        prior = max((p.prior for p in each if p.prior is not None), default=None)
        parameters.append(
            Parameter(
                name=name,
                value=float(values[:, i].mean()),
                u=float(np.sqrt(covariance[i, i])),
                unit=each[0].unit,
                deviation=_mean_where_known([p.deviation for p in each]),
                run_to_run=float(np.std(values[:, i], ddof=1)),
                dof=dof,
                prior=prior,
                learned=None if prior is None else learned_fraction(u, prior),
            )
        )
    return tuple(parameters), covariance, of_launches


def _by_source(
    launches: Sequence[Calibration], names: Sequence[str], shared: Mapping[str, Array], of_launches: Array
) -> UncertaintyBudget:
    """The budget of the mean by the sources of its launches: each has of the variances in `of_launches` (m, m) the
    share that it has of the sum of those of the launches, and of a prior beside it what is common to all. Its standard
    uncertainty is the root mean square over the launches, with the degrees of freedom of that."""
    every: dict[str, list[SourceContributions]] = {}
    for each in chain(*(launch.evidence.budget for launch in launches)):
        if each.name != "clock" and (each.name != "gravity" or not shared["gravity"].any()):
            every.setdefault(each.name, []).append(each)
    nothing = np.zeros((1, *of_launches.shape))
    priors = [shared.get(name, nothing) if name.startswith("prior.") else nothing for name in every]
    own = [
        np.sum([[each.contributions.get(n, 0.0) ** 2 for n in names] for each in members], axis=0)
        - np.diagonal(prior, axis1=1, axis2=2).sum(axis=0)
        for members, prior in zip(every.values(), priors, strict=True)
    ]
    variances = np.reshape(own, (len(own), len(names))).clip(0.0)
    total = variances.sum(axis=0)
    shares = np.divide(variances, total, out=np.zeros_like(variances), where=total > 0.0)
    budget = UncertaintyBudget(sources=(), covariances=np.empty((0, *of_launches.shape)))
    for (name, members), prior, share in zip(every.items(), priors, shares, strict=True):
        u, dof = [each.u or 0.0 for each in members], None
        if all(each.dof is not None for each in members):
            dof = welch_satterthwaite((size**2, each.dof) for size, each in zip(u, members, strict=True))
        rms = None if members[0].u is None else float(np.sqrt(np.mean(np.square(u))))
        each_source = replace(source(name, rms, members[0].unit, dof), basis=members[0].basis)
        budget = budget.with_source(each_source, np.diag(share * np.diag(of_launches)) + prior.mean(axis=0))
    return budget


# -------------------- what the launches have in common --------------------


def check_recordings(sessions: Sequence[Session], digests: Sequence[str]) -> None:
    """Raises InputError where two sessions are one: of logs with the same SHA-256, without the same parts."""
    for (one, digest), (other, other_digest) in combinations(zip(sessions, digests, strict=True), 2):
        if digest == other_digest and one.excluded == other.excluded:
            raise InputError(f"{other.name}: holds the same recording as {one.name}; name every recording once")


def digest_of_all(digests: Iterable[str]) -> str:
    """The SHA-256 of those of several logs."""
    return hashlib.sha256("\n".join(digests).encode()).hexdigest()


def circumstances_of_all(each: Sequence[Circumstances]) -> Circumstances:
    """What is the same in all launches, all their equipment, and the date of the last."""
    return Circumstances(
        date=max((one.date for one in each if one.date is not None), default=None),
        operator=_common([one.operator for one in each]),
        conditions=_common([one.conditions for one in each]) or AirConditions(),
        equipment=tuple(dict.fromkeys(item for one in each for item in one.equipment)),
    )


def _common(values: Sequence[_Any]) -> _Any | None:
    """What all launches share; None where they differ."""
    return values[0] if all(value == values[0] for value in values) else None


def _common_items(values: Sequence[Mapping[str, _Any]]) -> dict[str, _Any]:
    """The entries that all launches share."""
    return {key: value for key, value in values[0].items() if all(each.get(key) == value for each in values)}


def _mean_where_known(values: Sequence[float | None]) -> float | None:
    """The mean over the launches; None where one has none."""
    stated = [value for value in values if value is not None]
    return float(np.mean(stated)) if len(stated) == len(values) else None


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


def _notes(runs: Sequence[Run], names: list[str]) -> Iterator[str]:
    """What there is to say of the launches, once, with the launches of which it holds; and which groups of parameters
    some of them have and not all."""
    launches_by_note: dict[str, list[str]] = {}
    for run in runs:
        for note in run.calibration.provenance.notes:
            launches_by_note.setdefault(note, []).append(run.name)
    for note, launches in launches_by_note.items():
        yield f"{'every launch' if len(launches) == len(runs) else ', '.join(launches)}: {note}"
    missing = positions_by_group(name for run in runs for name in run.calibration if name not in names)
    if missing:
        yield f"left out of the mean, not known of every launch: {', '.join(missing)}"


def _prediction(runs: Sequence[Run], names: list[str], values: Array, covariance: Array) -> Prediction | None:
    """What readings corrected with the mean are known to; None where the launches do not say, or in another frame."""
    session, predictions = runs[0].session, [run.calibration.prediction for run in runs]
    further = set(positions_by_group(names))
    instrument = Instrument.of(session.accel_block, session.gyro_block, further, variables=get_args(Variable))
    if None in predictions or runs[0].calibration.frame != "accelerometer" or not set(instrument.names) <= set(names):
        return None
    order = [names.index(name) for name in instrument.names]
    return prediction(
        instrument,
        values[order],
        covariance[np.ix_(order, order)],
        gravity=float(np.mean([run.session.site.gravity for run in runs])),
        rate=_mean_where_known([None if each is None else each.at_rate for each in predictions]),
    )


def _mean_model(frame: Frame, block: Block | None, values: Mapping[str, float]) -> SensorModel | None:
    """The sensor model of the mean parameters; None where a launch lacks one of them."""
    if block is None:
        return None
    if block.kind == "mag":
        return block.model(np.array([values[name] for name in NAMES])) if set(NAMES) <= set(values) else None
    convention = Convention(frame=frame, block=block)
    if not set(convention.names) <= set(values):
        return None
    return convention.model(np.array([values[name] for name in convention.names]))
