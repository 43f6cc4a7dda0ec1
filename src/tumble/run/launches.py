"""Mean of the calibrations of several launches (power-ons) of one device, with the scatter from launch to launch.

The covariance of the mean of L launches is the mean of their covariances over L; on the diagonal it is the variance
from launch to launch over L where that is larger. Errors of gravity, priors and the time base are common to all
launches and do not average out: they are separated first, and added in the end (`tumble.result.coverage`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain, combinations, product, zip_longest
from pathlib import Path
from typing import Any, TypeVar, get_args

import numpy as np
import scipy

from tumble.advice import Advised, prefixed
from tumble.arguments import checked
from tumble.diagnosis.findings import Finding, outcome_of
from tumble.errors import InputError
from tumble.files import FilePath
from tumble.inference.estimate import GroupFinding
from tumble.inference.magnetic_estimate import block_near
from tumble.inference.prediction import Prediction, prediction
from tumble.inference.prior import DevicePrior
from tumble.inference.sources import UncertaintyBudget, clock_effects, clock_errors, source
from tumble.recording.log import Log
from tumble.recording.session import AirConditions, Circumstances, Session
from tumble.recording.session_file import session_from
from tumble.result.calibration import Calibration
from tumble.result.coverage import (
    MANY_DEGREES,
    gravity_sensitivity,
    shared_gravity,
    u_and_degrees_of_mean,
    welch_satterthwaite,
)
from tumble.result.launch_variances import at_temperature
from tumble.result.parts import CalibratedTemperature, Evidence, Parameter, Provenance, SourceContributions
from tumble.result.shared_errors import is_device_property, prior_sensitivities
from tumble.result.uncertainty_budget import contributions_of
from tumble.run.calibrate import DEFAULT_METHOD, Method, calibrate
from tumble.run.from_estimate import origin_of, parameters_of
from tumble.run.observed import Progress
from tumble.sensors.frames import Convention, Frame, frame_of
from tumble.sensors.grades import TURN_ON, guessed_grade, spread_of
from tumble.sensors.instrument import Instrument
from tumble.sensors.model import Block, SensorModel
from tumble.sensors.parameters import (
    Terms,
    Variable,
    beyond_linear,
    group_name,
    positions_by_group,
    sensor_kind,
    shown_in,
)
from tumble.units import Array, two_digits

_Any = TypeVar("_Any")
DIFFERING_CHANCE = 1e-4  # probability of differences between launches of one device, below which they are remarked
UNSTEADY_CHANCE = 1e-6  # of such differences by chance, below which the mean is not that of one state of a device


@dataclass(frozen=True, kw_only=True, slots=True)
class LaunchRun:
    """A session and its calibration."""

    session: Session
    calibration: Calibration

    @property
    def name(self) -> str:
        """Name of the session among the launches."""
        return Path(self.session.name).name or self.session.name


@checked
def calibrate_launches(
    sessions: Sequence[Session | FilePath],
    *,
    method: Method = DEFAULT_METHOD,
    iterations: int | None = None,
    frame: Frame = "accelerometer",
    terms: Terms = "full",
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
    prior
        See `calibrate`; for one session alone, since the mean of several would contain it several times.

    Returns
    -------
    Calibration
        For several sessions the mean, with the standard deviation from launch to launch and every launch in its
        `evidence`.

    Raises
    ------
    InputError
        If the sessions are of different devices, or one recording is given twice.

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
    options: dict[str, Any] = {"iterations": iterations, "frame": frame, "terms": terms, "prior": prior}
    runs = [
        LaunchRun(session=session, calibration=calibrate(session, method=method, progress=progress, **options))
        for session in map(session_from, sessions)
    ]
    return mean_of_launches(runs) if len(runs) > 1 else runs[0].calibration


def mean_of_launches(runs: Sequence[LaunchRun]) -> Calibration:
    """Return the mean of calibrations of one device by the same method, see `calibrate_launches`."""
    launches, sessions = [run.calibration for run in runs], [run.session for run in runs]
    first, session, count = launches[0], sessions[0], len(runs)
    sources = [launch.provenance for launch in launches]
    for other, key in product(sessions[1:], ("serial", "model", "grade")):
        expected, found = (getattr(each.device, key) for each in (session, other))
        if None not in (expected, found) and expected != found:
            what = "a launch of device " if key == "serial" else ""
            raise InputError(
                f"{other.name}: device.{key}: expected {what}{expected!r} like the first session, found {found!r}; "
                "calibrate each device by itself"
            )
    digests = [each.log_sha256 or "" for each in sources]
    check_recordings(sessions, digests)
    names = [name for name in first if all(name in launch for launch in launches)]
    references = [launch.temperature.references for launch in launches]
    kinds = _common([{kind: len(celsius) for kind, celsius in each.items()} for each in references]) or ()
    temperature = CalibratedTemperature(
        reference=_mean_where_known([launch.reference_temperature for launch in launches]),
        thermometers=_common_items([launch.temperature.thermometers for launch in launches]),
        references={k: tuple(np.mean([each[k] for each in references], axis=0).tolist()) for k in kinds},
    )
    values, covariances = at_temperature(launches, names, temperature)
    clock_u, site = min(each.log.time_base_u for each in sessions), first.provenance.site
    by_clock = clock_errors(names, clock_effects(clock_u, session.log.increments))
    shared = _shared_covariances(launches, names, covariances, by_clock)
    shared_mean = np.sum([each.mean(axis=0) for each in shared.values()], axis=0)
    unshared, mean = covariances - np.sum([*shared.values()], axis=0), values.mean(axis=0)
    parameters, covariance, within = _mean_parameters(launches, names, values, covariances, unshared, shared_mean)
    budget = _mean_budget(launches, names, shared, within)
    for each, part in (
        (source("launches", dof=count - 1.0), covariance - within - shared_mean),
        (source("gravity", None if site is None else site.gravity_u, "m/s^2"), shared["gravity"][0]),
        (source("clock", clock_u, "1"), shared["clock"][0]),
    ):
        budget = budget.with_source(each, part)
    by_name, convention = dict(zip(names, mean.tolist(), strict=True)), frame_of(first.frame)
    missing = tuple(dict.fromkeys(name for launch in launches for name in launch.outcome.unobservable))
    return Calibration(
        device=replace(first.device, imu=_common_items([launch.imu for launch in launches])),
        method=first.method,
        frame=first.frame,
        parameters=parameters,
        covariance=covariance,
        accel=_mean_model(convention, session.accel_block, by_name),
        gyro=_mean_model(convention, session.gyro_block, by_name),
        mag=None if first.mag is None else _mean_model("accelerometer", block_near(first.mag.matrix), by_name),
        outcome=outcome_of([*_differing_launches(runs, parameters, covariances), *_findings(runs)], missing),
        groups=_groups(launches, parameters),
        prediction=_prediction(runs, names, mean, covariance),
        axes=_common_items([launch.axes for launch in launches]),
        temperature=temperature,
        evidence=Evidence(
            budget=contributions_of(budget, names),
            iterations=tuple(  # a launch with fewer iterations has zero increments in the last ones
                {name: sum(step.get(name, 0.0) for step in steps) / count for name in names}
                for steps in zip_longest(*(launch.evidence.iterations for launch in launches), fillvalue={})
            ),
            launches=tuple(run.calibration.as_launch(run.name) for run in runs),
        ),
        provenance=Provenance(
            **origin_of(*digests),
            site=_common([each.site for each in sources]),
            sample_rate=_mean_where_known([each.sample_rate for each in sources]),
            clock_u=clock_u,
            circumstances=joint_circumstances([each.circumstances for each in sources]),
            programme=_common([each.programme for each in sources]),
            readings=_common_items([each.readings for each in sources]),
            notes=tuple(_notes(runs, names)),
            assumptions=tuple(dict.fromkeys(chain(*(each.assumptions for each in sources)))),
            unstated=dict(chain(*(each.unstated.items() for each in sources))),
        ),
    )


def _findings(runs: Sequence[LaunchRun]) -> Iterator[Finding]:
    """Yield the reasons and remarks of the launches, with their names."""
    for run in runs:
        outcome = run.calibration.outcome
        for sentence in (*outcome.reasons, *outcome.remarks):
            yield Finding(
                sentence=prefixed(f"{run.name}: ", sentence),
                concerns=outcome.concerns.get(sentence, ()),
                refuses=sentence in outcome.reasons,
                unsteady=sentence in outcome.unsteady,
            )


# -------------------- statistics of the mean (see `tumble.result.coverage`) --------------------


def _shared_covariances(
    launches: Sequence[Calibration], names: Sequence[str], covariances: Array, by_clock: Array
) -> dict[str, Array]:
    """Return covariances (L, m, m) of errors that the launches share, by source.

    The sources are gravity, if all used the same value, the time base, whose standard uncertainty changes the
    parameters by `by_clock` (m,), and the priors of groups."""
    site, members = launches[0].provenance.site, [[launch[n] for n in names] for launch in launches]
    gravity = np.zeros(len(names))
    if all(shared_gravity(site, launch.provenance.site) for launch in launches):
        gravity = np.mean([gravity_sensitivity(p, C, site) for p, C in zip(members, covariances, strict=True)], axis=0)
    shared = {
        "gravity": np.broadcast_to(np.outer(gravity, gravity), covariances.shape),
        "clock": np.broadcast_to(np.outer(by_clock, by_clock), covariances.shape),
    }
    for i, (parameters, C, launch) in enumerate(zip(members, covariances, launches, strict=True)):
        changes = [
            (f"prior.{group_name(name)}", np.outer(each, each))
            for name, each in prior_sensitivities(parameters, C, launch.evidence.budget).items()
        ]
        listed = {prior for prior, _ in changes}
        for each in launch.evidence.budget:  # groups that are only in u, such as those with linear terms
            prior, _, group = each.name.partition(".")
            if prior == "prior" and beyond_linear(group) and each.name not in listed and is_device_property(group):
                changes.append((each.name, np.diag([each.contributions.get(name, 0.0) ** 2 for name in names])))
        for prior, square in changes:
            shared.setdefault(prior, np.zeros_like(covariances))[i] += square
    return shared


def _mean_parameters(
    launches: Sequence[Calibration],
    names: Sequence[str],
    values: Array,
    covariances: Array,
    unshared: Array,
    shared_mean: Array,
) -> tuple[tuple[Parameter, ...], Array, Array]:
    """Return the parameters of the mean, their covariance (m, m), and its part (m, m) from within the launches.

    `covariances`, `unshared` (L, m, m): of the launches, and without the errors that they share, whose covariance in
    the mean is `shared_mean` (m, m)."""
    count = len(launches)
    variances = np.diagonal(unshared, axis1=1, axis2=2).clip(0.0)
    within = unshared.sum(axis=0) / count**2
    covariance = within + shared_mean
    np.fill_diagonal(within, variances.sum(axis=0) / count**2)
    estimates = [[launch[name] for launch in launches] for name in names]
    run_to_run = values.std(axis=0, ddof=1)
    degrees = list[float | None]()
    for i, members in enumerate(estimates):
        parts = []
        for p, C, variance in zip(members, covariances, variances[:, i].tolist(), strict=True):
            dof = None if p.dof is None or C[i, i] == 0.0 else p.dof * float(variance / C[i, i]) ** 2
            parts.append((variance, dof))
        u, dof = u_and_degrees_of_mean(parts, float(run_to_run[i]), float(np.sqrt(shared_mean[i, i])))
        covariance[i, i] = u**2
        degrees.append(dof)
    parameters = parameters_of(
        names,
        values.mean(axis=0),
        np.sqrt(np.diag(covariance)),
        unit=[members[0].unit for members in estimates],
        deviation=[_mean_where_known([p.deviation for p in members]) for members in estimates],
        run_to_run=run_to_run.tolist(),
        dof=degrees,
        prior=[max((p.prior for p in each if p.prior is not None), default=None) for each in estimates],
    )
    return parameters, covariance, within


def _differing_launches(
    runs: Sequence[LaunchRun], parameters: Sequence[Parameter], covariances: Array
) -> Iterator[Finding]:
    """Yield a remark if launches differ by more than power-ons of one device of its grade, and their u, explain.

    For a parameter of the linear model s²/(s_g² + n²) has an F distribution, with the usual s_g from power-on to
    power-on of the grade and the u of a launch, n. The least probability is multiplied by the number of parameters."""
    launches = [run.calibration for run in runs]
    white, grade = dict[str, float](), runs[0].session.device.grade
    for kind in ("accel", "gyro"):  # median noise density at rest, SI/√Hz
        at_rest = [getattr(rest, kind) for each in launches for rest in each.evidence.rests]
        if noise := [each.noise for each in at_rest if each is not None]:
            white[kind] = float(np.median(noise))
    if grade is None and "accel" in white:
        grade, _ = guessed_grade(white["accel"], white.get("gyro"))
    if grade is None:
        return
    tested = list[tuple[float, float, Parameter]]()
    for p, u_squared in zip(parameters, np.diagonal(covariances, axis1=1, axis2=2).mean(axis=0).tolist(), strict=True):
        kind = sensor_kind(p.name)
        usable = kind in ("accel", "gyro") and all(each.outcome.of(kind) for each in launches)
        if beyond_linear(p.name) or not usable:
            continue
        usual = spread_of(TURN_ON[grade], p.name) ** 2
        fewest = min((dof for each in launches if (dof := each[p.name].dof) is not None), default=None)
        degrees = welch_satterthwaite([(usual, None), (u_squared, fewest)]) or MANY_DEGREES
        ratio = (p.run_to_run or 0.0) ** 2 / (usual + u_squared)
        tested.append((float(scipy.special.fdtrc(len(runs) - 1, degrees, ratio)), ratio, p))
    if not tested:
        return
    chance, ratio, p = min(tested, key=lambda each: (each[0], -each[1]))
    chance *= len(tested)
    if chance < DIFFERING_CHANCE:
        size, unit = shown_in(p.name, p.unit, spread_of(TURN_ON[grade], p.name))
        sentence = Advised(
            f"the launches differ by more than power-ons and noise of one device: {p.name} has a standard deviation of "
            f"{two_digits((p.run_to_run or 0.0) / size)} {unit} from launch to launch, {ratio**0.5:.1f} times what is "
            f"usual for the grade {grade} (by chance with probability {chance:.1g}): they are of different devices, or "
            "the device was changed or much warmer in between",
            "calibrate each launch alone",
        )
        yield Finding(sentence=sentence, unsteady=chance < UNSTEADY_CHANCE)


def _mean_budget(
    launches: Sequence[Calibration], names: Sequence[str], shared: Mapping[str, Array], within: Array
) -> UncertaintyBudget:
    """Return the budget of the mean by the sources of its launches.

    The share of a source in the variances `within` (m, m) is its share in the sum over the launches; a prior also has
    its shared part. Its standard uncertainty is the root mean square over the launches."""
    members = dict[str, list[SourceContributions]]()
    for each in chain(*(launch.evidence.budget for launch in launches)):
        if each.name != "clock" and (each.name != "gravity" or not shared["gravity"].any()):
            members.setdefault(each.name, []).append(each)
    priors = {name: covariances for name, covariances in shared.items() if name.startswith("prior.")}
    variances = dict[str, Array]()
    for name, lines in members.items():
        squares = np.sum([[line.contributions.get(n, 0.0) ** 2 for n in names] for line in lines], axis=0)
        prior = np.einsum("lmm->m", priors[name]) if name in priors else 0.0
        variances[name] = np.maximum(squares - prior, 0.0)
    total = np.sum([np.zeros(len(names)), *variances.values()], axis=0)
    budget = UncertaintyBudget(sources=(), covariances=np.empty((0, *within.shape)))
    for name, lines in members.items():
        u, dof = [line.u or 0.0 for line in lines], None
        if all(line.dof is not None for line in lines):
            dof = welch_satterthwaite((size**2, line.dof) for size, line in zip(u, lines, strict=True))
        rms = None if lines[0].u is None else float(np.sqrt(np.mean(np.square(u))))
        share = np.divide(variances[name], total, out=np.zeros_like(total), where=total > 0.0)
        part = np.diag(share * np.diag(within)) + (priors[name].mean(axis=0) if name in priors else 0.0)
        budget = budget.with_source(replace(source(name, rms, lines[0].unit, dof), basis=lines[0].basis), part)
    return budget


# -------------------- values common to the launches --------------------


def check_recordings(sessions: Sequence[Session], digests: Sequence[str]) -> None:
    """Raise InputError if two sessions have the same log and leave out the same parts."""
    for (one, digest), (other, other_digest) in combinations(zip(sessions, digests, strict=True), 2):
        if digest == other_digest and one.excluded == other.excluded:
            raise InputError(f"{other.name}: holds the same recording as {one.name}; name every recording once")


def joint_circumstances(circumstances: Sequence[Circumstances]) -> Circumstances:
    """Return the circumstances common to all launches, all their equipment, and the date of the last."""
    return Circumstances(
        date=max((one.date for one in circumstances if one.date is not None), default=None),
        operator=_common([one.operator for one in circumstances]),
        conditions=_common([one.conditions for one in circumstances]) or AirConditions(),
        equipment=tuple(dict.fromkeys(item for one in circumstances for item in one.equipment)),
    )


def _common(values: Sequence[_Any]) -> _Any | None:
    """Return the value if all are equal, else None."""
    return values[0] if all(value == values[0] for value in values) else None


def _common_items(values: Sequence[Mapping[str, _Any]]) -> dict[str, _Any]:
    return {key: value for key, value in values[0].items() if all(each.get(key) == value for each in values)}


def _mean_where_known(values: Sequence[float | None]) -> float | None:
    """Return the mean, or None if a value is None."""
    return None if None in values else float(np.mean([value for value in values if value is not None]))


def _groups(launches: Sequence[Calibration], parameters: Sequence[Parameter]) -> tuple[GroupFinding, ...]:
    """Return the findings on groups beyond the linear model; the learned fraction is zero unless all launches kept the
    group."""
    learned: dict[str, list[float]] = {}
    for parameter in parameters:
        if parameter.learned is not None:
            learned.setdefault(group_name(parameter.name), []).append(parameter.learned)
    findings = {group.name: group for launch in launches for group in launch.groups}
    return tuple(
        replace(group, kept=name in learned, learned=tuple(learned.get(name, [0.0] * len(group.learned))))
        for name, group in findings.items()
    )


def _notes(runs: Sequence[LaunchRun], names: list[str]) -> Iterator[str]:
    """Return the notes of the launches, each once with their names, and on groups missing in some launches."""
    launches_by_note: dict[str, list[str]] = {}
    for run in runs:
        for note in run.calibration.provenance.notes:
            launches_by_note.setdefault(note, []).append(run.name)
    for note, launches in launches_by_note.items():
        yield prefixed(f"{'every launch' if len(launches) == len(runs) else ', '.join(launches)}: ", note)
    missing = positions_by_group(name for run in runs for name in run.calibration if name not in names)
    if missing:
        yield f"left out of the mean, not known of every launch: {', '.join(missing)}"


def _prediction(runs: Sequence[LaunchRun], names: list[str], values: Array, covariance: Array) -> Prediction | None:
    """Return the uncertainty of readings corrected with the mean; None in other frames or if a launch has none."""
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
    """Return the sensor model of the mean parameters; None if one of them is missing."""
    if block is None:
        return None
    convention = Convention(frame=frame, block=block) if block.kind != "mag" else block
    names = convention.names
    return convention.model(np.array([values[name] for name in names])) if set(names) <= set(values) else None
