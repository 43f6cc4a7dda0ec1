"""Findings from the residuals of an estimate, and from noise and parameters that are far from their usual sizes.

An estimate is accepted with scatter if a group of residuals exceeds the noise within rests and the usual in-run biases,
if a cause is significant (`tumble.diagnosis.causes`), or if biases or scale factors vary far more than usual. All tests
together find something in less than one of a hundred clean sessions. An estimate is refused if its uncertainty cannot
be trusted: if leaving out a significant cause moves a parameter of the linear model by more than LARGEST_DAMAGE of its
u, since this error is not random. Groups that it moves by less than ACCEPTED_DAMAGE are accepted all the same.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from operator import attrgetter

import numpy as np

from tumble.advice import Advised, advised, found_in, prefixed, remedy_of
from tumble.diagnosis.causes import (
    LinearisedSession,
    candidates_of,
    earth_rate_errors,
    fit_candidates,
    quantisation,
)
from tumble.diagnosis.findings import BIAS_UNITS, SENSORS, Finding, refusal, remark, with_unit
from tumble.diagnosis.lost_samples import (
    TURN_GROUPS,
    jitter_hint,
    lost_in_all_turns,
    lost_in_one_turn,
    samples_held,
    scatter_of_turns_only,
    stamps_remedy,
)
from tumble.diagnosis.projection import FALSE_ALARMS, SumOfSquares, diagnostic_solution, holm_limit, projections
from tumble.inference.estimate import Estimate, HyperparameterEstimate
from tumble.inference.linearisation import Linearisation
from tumble.inference.noise import REST_SCATTER, SCATTER, VarianceComponents, typical_noise
from tumble.inference.normal_equations import Solution
from tumble.inference.problem import SessionSpan
from tumble.reduction.observations import Observations
from tumble.sensors.model import SensorKind
from tumble.sensors.parameters import group_of, shown_in
from tumble.units import DEGREE, DEGREE_PER_HOUR, G_STANDARD, two_digits

CAUSE_P_VALUE = 0.02  # causes of a significant scatter are named if their p-value is smaller
LOST_SAMPLES_P_VALUE = 0.05  # lost samples are named first for turns that scatter if their p-value is smaller
MOST_CAUSES = 3  # causes that are named
MOST_SESSIONS = 5  # sessions, of several, that are described one by one
MODEL_FAILURE_RATIO = 30.0
"""Scatter over noise above which the model fails: then the errors of turns are not random, and gyro parameters from
turns are refused."""
NEGLIGIBLE_SCATTER = {"accel": 5e-6 * G_STANDARD, "gyro": 0.02 * DEGREE_PER_HOUR, "turn": 2e-5, "velocity": 1e-3}
"""m/s², rad/s, rad, m/s: scatter without effect on any use of an inertial unit, however small the noise of the log."""
UNUSUAL_RATIO = 3.0
"""Ratio to the usual size above which, by the lower limit of the 68 % interval, an in-run bias or a drift is reported,
and the in-run bias of one sensor against those of its kind."""
UNUSUAL_GROUP_RATIO, WIDENED_RATIO = 5.0, 10.0
"""The same for the size of a group of parameters, and for the widening of its prior at the maximum."""
CHANGES = ("jump", "shift")  # causes by which parameters are others before than after
MOVEMENT_RATIO = 10.0
"""Scatter over noise of turns, relative to that of gyros at rest, above which turns have a cause of their own."""
LARGEST_DAMAGE, ACCEPTED_DAMAGE = 3.0, 0.5
"""Errors of parameters by a cause, in u: a larger one refuses the estimate; groups with smaller ones are accepted,
whose errors are then √(1 + 0.5²) u = 1.12 u."""
LARGEST_CLOCK_ERROR = 0.1
"""Relative: a larger one means that the unit of time is wrong, or that the gyros do not measure the Earth's rate."""
IN_U = "; u contains it"
RANDOM_IN_U = f"{IN_U} as far as it is random"


@dataclass(frozen=True, kw_only=True, slots=True)
class ResidualGroup:
    """A group of residuals with its component of scatter."""

    name: str  # of the component
    others: tuple[str, ...] = ()  # further components with the same residuals
    concerns: SensorKind
    words: str
    unit: tuple[float, str]  # SI, name

    def scatter(self, components: VarianceComponents) -> float:
        """Return the scatter, that of the in-run bias included, SI."""
        in_run = {"accel": components.accel_in_run, "gyro": components.gyro_in_run}.get(self.name, 0.0)
        return float(np.hypot(getattr(components, self.name), in_run))

    def exceeds_model(self, ratio: float, components: VarianceComponents) -> bool:
        """Return True if the scatter, `ratio` times the noise, is too large to be a disturbance of a valid model."""
        return ratio > MODEL_FAILURE_RATIO and self.scatter(components) > NEGLIGIBLE_SCATTER[self.name]

    def noise(self, observations: Observations) -> float:
        """Return the typical noise of a row, SI."""
        rests, turns = observations.rests, observations.turns
        covariances = {"accel": rests.accel_covariance, "gyro": rests.gyro_covariance}
        if turns is not None:
            covariances |= {"turn": turns.covariance, "velocity": turns.velocity_covariance}
        return typical_noise(covariances[self.name])

    def p_value(self, linearised: Linearisation, expected: Solution, part: SessionSpan) -> float:
        """Return the probability that chance exceeds the residuals of a session, in the directions of the scatter.

        `expected` is the solution with the noise within rests and the usual in-run biases."""
        kind = self.name if self.name in REST_SCATTER else "turn"
        if kind not in expected.residuals:
            return 1.0
        noise, (residual, covariance) = linearised.noise.rows[kind], expected.residuals[kind]
        W, rows, names = expected.equations.whitening[kind], part.rows[kind], (self.name, *self.others)
        Z = noise.directions[rows][:, :, np.isin(noise.component, [SCATTER.index(name) for name in names])]
        return SumOfSquares.along(W[rows] @ Z, residual[rows], covariance[rows]).p_value


GROUPS = (
    ResidualGroup(
        name="accel", concerns="accel", words="readings of the accelerometers at rest", unit=BIAS_UNITS["accel"]
    ),
    ResidualGroup(name="gyro", concerns="gyro", words="readings of the gyros at rest", unit=BIAS_UNITS["gyro"]),
    ResidualGroup(name="turn", others=("apart",), concerns="gyro", words="rotations of the turns", unit=(DEGREE, "°")),
    ResidualGroup(name="velocity", concerns="accel", words="velocities of the turns", unit=(1e-3, "mm/s")),
)


def misfit(estimate: Estimate, search: bool = True) -> tuple[Finding, ...]:
    """Return the findings from the residuals of an estimate, and with `search` their causes.

    Each of several sessions is judged by itself. There are none if the estimate has no likelihood. For methods other
    than `joint` the residuals are those of the joint estimate that comes with theirs."""
    linearised = estimate.linearised
    if linearised is None:
        return ()
    linearised = _with_estimated_sizes(linearised, estimate)
    session, together = LinearisedSession(linearised), linearised.problem.observations.together
    usual = {
        h.name.removesuffix("_in_run"): _usual_size(h, linearised, UNUSUAL_RATIO) for h in estimate.hyperparameters
    }
    in_run = VarianceComponents(accel_in_run=usual.get("accel", 0.0), gyro_in_run=usual.get("gyro", 0.0))
    expected = diagnostic_solution(linearised, in_run)
    p_values = [
        {group: group.p_value(linearised, expected, part) for group in GROUPS} for part in linearised.problem.parts
    ]
    causes = [list[Finding]() for _ in p_values]
    if search:
        causes = _causes(session)
    limit = holm_limit(
        [p for of_session in p_values for p in of_session.values()]
        + [cause.p_value for of_session in causes for cause in of_session]
    )
    varying = list(_varying_parameters(estimate, linearised))
    reported = {kind for finding in varying for kind in finding.kinds if finding.causes != ("scale-factor drift",)}
    by_session = [
        list(_session_findings(linearised, *of_session, limit, usual, reported))
        for of_session in zip(session.observed, p_values, causes, strict=True)
    ]
    if together is not None:
        named = zip(together.names, by_session, strict=True)
        by_session = [
            [replace(one, sentence=prefixed(f"{name}: ", one.sentence)) for one in found] for name, found in named
        ]
        by_session = [found for found in by_session if found]
    findings = [finding for found in by_session[:MOST_SESSIONS] for finding in found]
    findings += [finding for found in by_session[MOST_SESSIONS:] for finding in found if finding.refuses]
    if len(by_session) > MOST_SESSIONS:
        findings.append(
            remark(Advised(f"{len(by_session) - MOST_SESSIONS} more sessions scatter", "calibrate them one by one"))
        )
    jumping = {kind for finding in findings if "jump" in finding.causes for kind in finding.kinds}
    findings += unusual_groups(estimate)
    findings += (one for one in varying if one.causes == ("scale-factor drift",) or jumping.isdisjoint(one.kinds))
    if estimate.method == "joint":
        return tuple(findings)
    by_joint = []
    for one in findings:
        found = f"by the method joint, {found_in(one.sentence)}".replace(RANDOM_IN_U, "").replace(IN_U, "")
        by_joint.append(replace(one, sentence=advised(found, remedy_of(one.sentence))))
    return tuple(by_joint)


def _with_estimated_sizes(linearised: Linearisation, estimate: Estimate) -> Linearisation:
    """Widen the priors of groups to their sizes by the integral, where these are larger than at the maximum.

    Scatter and large groups may explain the same residuals, with a maximum of the posterior each."""
    problem, sizes = linearised.problem, {h.name: h.value for h in estimate.hyperparameters}
    prior_u, usual_u = problem.prior_u.copy(), problem.usual_u
    for finding in estimate.groups:
        if finding.name in problem.instrument.members:
            members = problem.instrument.members[finding.name]
            places = slice(members.start + 1, members.stop + 1)
            size = max(finding.prior_widened, sizes.get(finding.name, 1.0))
            prior_u[places] = np.maximum(prior_u[places], size * usual_u[places])
    return linearised.with_priors(replace(problem, prior_u=prior_u))


@dataclass(frozen=True, kw_only=True, slots=True)
class ClockByEarth:
    """The clock of a log as measured with the Earth's rate."""

    rate: float  # duration of one of its seconds, s
    u: float  # relative standard uncertainty
    changes: Mapping[str, float]  # by name, the change of gyro parameters by one u

    def sentence(self, corrected: str) -> str:
        """Return the result as a sentence; `corrected` names the parameters that are corrected for it."""
        return Advised(
            f"by the Earth's rate a second of the log's clock is {100.0 * (self.rate - 1.0):+.3g} % longer than one, "
            f"to {100.0 * self.u:.2g} %: {corrected} corrected for it",
            "look at rate_hz, or the time column, in [log]",
        )


def clock_by_earth(estimate: Estimate) -> ClockByEarth | None:
    """Return the clock error if the Earth's rate contradicts the stated clock and no other cause is as likely.

    It is fitted with the noise within rests and the scatter that remains beside it, as the variance components of the
    estimate have taken the clock error for in-run biases."""
    linearised = estimate.linearised
    if linearised is None or linearised.problem.observations.together is not None:
        return None
    session, problem = LinearisedSession(linearised), linearised.problem
    if problem.observations.gyro_block is None or problem.observations.site.latitude is None or problem.moves:
        return None
    errors = list(earth_rate_errors(session))
    likely = fit_candidates(linearised, errors)[0]
    if not likely or likely[0].cause != "clock" or likely[0].p_value > FALSE_ALARMS:
        return None
    first = _causes(session)[0][0]
    if first.causes != ("clock",):
        return None
    clock = next(error for error in errors if error.name == "clock")
    (projection,) = projections(linearised, VarianceComponents(), *clock.columns)
    fit = projection.fit(slice(0, 1))
    assert fit is not None
    scatter = max(1.0, (projection.chi_square - fit.drop) / projection.degrees)
    value, u = float(fit.values[0]), float(np.sqrt(scatter / fit.drop) * abs(fit.values[0]))
    if abs(value) > LARGEST_CLOCK_ERROR:
        return None
    changes = zip(problem.instrument.names, (-u / value * fit.shift).tolist(), strict=True)
    return ClockByEarth(
        rate=1.0 + value, u=u, changes={name: change for name, change in changes if name.startswith("gyro")}
    )


def _causes(session: LinearisedSession) -> list[list[Finding]]:
    """Return for each session its causes, one of each name and kind of sensor, the most significant first."""
    by_p_value, linearised = attrgetter("p_value"), session.linearised
    with_scatter = diagnostic_solution(linearised, linearised.components)
    candidates = [*candidates_of(session), *lost_in_one_turn(session, with_scatter)]
    by_session = fit_candidates(linearised, candidates)
    turns_only = scatter_of_turns_only(linearised) if any(session.has_turns) else with_scatter
    for s, causes in enumerate(by_session):
        causes += quantisation(session, s)
        lost = [cause for cause in causes if cause.cause == "lost samples"]
        held = samples_held(session.observed[s])
        if held is None and session.has_turns[s] and turns_only.components.turn > NEGLIGIBLE_SCATTER["turn"]:
            lost.append(lost_in_all_turns(session, s, turns_only))
        likely = held or min(lost, key=by_p_value, default=None)
        causes[:] = [cause for cause in causes if cause not in lost] + ([likely] if likely is not None else [])
        causes.sort(key=by_p_value)
    return by_session


def _session_findings(
    linearised: Linearisation,
    observations: Observations,
    p_values: Mapping[ResidualGroup, float],
    causes: list[Finding],
    limit: float,
    usual: Mapping[str, float],
    reported: set[str],
) -> Iterator[Finding]:
    """Yield the findings from the residuals of one session; p-values up to `limit` are significant.

    Scatter within the `usual` size of in-run biases is not mentioned, nor that of the readings of kinds of sensors
    whose in-run biases are `reported`."""
    components = linearised.components
    scattering = {
        group: group.scatter(components) / group.noise(observations)
        for group, p_value in p_values.items()
        if p_value <= limit and group.scatter(components) > usual.get(group.name, 0.0)
    }
    ratios = {group.name: ratio for group, ratio in scattering.items()}
    # lost samples resemble other causes, and come first
    first = [c for c in causes if c.cause == "lost samples" and c.p_value < LOST_SAMPLES_P_VALUE and "turn" in ratios]
    named = first + [cause for cause in causes if cause.p_value <= limit and cause not in first]
    if scattering:  # further causes are named if they may explain it
        kinds = {group.concerns for group in scattering}
        likely = [c for c in causes if c not in named and (not c.concerns or c.concerns[0] in kinds)]
        likely = [c for c in likely if c.cause != "lost samples" or "turn" in ratios]  # rests are as they were
        explained = any(cause.concerns != ("accel",) for cause in named)
        if ratios.get("turn", 0.0) > MOVEMENT_RATIO * ratios.get("gyro", 0.0) and not explained:
            # a cause by which turns scatter far more than gyros at rest is random; no systematic effect need fit it
            sentence = "a device that moved after it was put down, or before it was taken up"
            sentence = Advised(sentence, "wait until it lies still")
            named.append(Finding(causes=("movement",), concerns=("gyro",), p_value=1.0, sentence=sentence))
            sentence = "or samples that are missing or held in the log, which in these turns look like movement"
            sentence = Advised(sentence, stamps_remedy(observations))
            named += (replace(cause, sentence=sentence) for cause in likely if cause.cause == "lost samples")
        named += (cause for cause in likely if cause.p_value < CAUSE_P_VALUE)
    named = named[:MOST_CAUSES]
    harmful = [c for c in named if c.damage > LARGEST_DAMAGE and (c.p_value <= limit or c in first)]
    for cause in harmful:
        moved = [group for group, damage in cause.by_group.items() if damage > ACCEPTED_DAMAGE]
        groups = [group for group in moved if group.startswith(cause.concerns)]  # of the sensors at fault
        groups += [group for group in moved if group not in groups]
        finite = np.isfinite(cause.damage)
        damage = f"up to {two_digits(cause.damage)} times their u" if finite else "more than their u, all alike"
        damage += ", if the most harmful of these is the cause" if len(cause.causes) > 1 else ""
        found = f"{found_in(cause.sentence)}; without it parameters of {', '.join(groups)} err by {damage}"
        sentence = advised(found, remedy_of(cause.sentence))
        yield replace(cause, sentence=sentence, concerns=tuple(groups), refuses=True)
    for group, ratio in scattering.items():
        sentence = _scatter_sentence(group, ratio, linearised)
        if group.name not in REST_SCATTER and group.exceeds_model(ratio, components) and not jitter_hint(observations):
            found = found_in(sentence).removesuffix(RANDOM_IN_U)
            yield refusal(advised(found, remedy_of(sentence)), *TURN_GROUPS)
        elif group.name not in reported:
            yield remark(sentence, group.concerns)
    for cause in named:
        if cause not in harmful:
            sentence = prefixed("probable cause: ", cause.sentence)
            yield replace(cause, sentence=sentence, unsteady=cause.cause in CHANGES)
    yield from _erratic_biases(linearised)


def _erratic_biases(linearised: Linearisation) -> Iterator[Finding]:
    """Refuse sensors whose biases change from rest to rest by more than MODEL_FAILURE_RATIO times the noise of a rest.

    The in-run bias changes by σ_b √(2 − 2 e^{−Δt/τ}). In-run instability and warm-up change it by a few times the
    noise; a larger change is an error that is no bias. Turns are compared with the verticals of the accelerometers,
    whose errors therefore spoil the scale factors and axes of the gyros as well."""
    rests, components = linearised.problem.observations.rests, linearised.components
    interval = float(np.median(np.diff(0.5 * (rests.start + rests.stop)))) if len(rests) > 1 else 0.0
    for block in linearised.problem.instrument.blocks:
        kind, noise = block.kind, typical_noise(getattr(rests, f"{block.kind}_covariance"))
        size, time = getattr(components, f"{kind}_in_run"), getattr(components, f"{kind}_time")
        change = float(size * np.sqrt(-2.0 * np.expm1(-interval / time))) if time > 0.0 else 0.0
        if change > max(MODEL_FAILURE_RATIO * noise, NEGLIGIBLE_SCATTER[kind]):
            yield refusal(
                Advised(
                    f"biases of the {SENSORS[kind]} change by {with_unit(change, BIAS_UNITS[kind])} from one rest to "
                    f"the next, {change / noise:.2g} times the noise of a rest: the model does not describe this",
                    "look at the rests with `tumble inspect`",
                ),
                *(kind, *(TURN_GROUPS if kind == "accel" else ())),
            )


def _scatter_sentence(group: ResidualGroup, ratio: float, linearised: Linearisation) -> str:
    """Return a sentence that a group of residuals scatters, with the size."""
    observations, components = linearised.problem.observations, linearised.components
    scatter, exceeds, jumps = group.scatter(components), group.exceeds_model(ratio, components), ""
    if group.name == "turn" and observations.turns is not None:
        aliased = components.aliased * float(np.sqrt(observations.turns.aliased.max()))
        if aliased > components.turn:
            jumps = (
                f"the rotations of the turns err by up to about {aliased / DEGREE:.2g}° where rates jump from sample "
                "to sample, as instantaneous samples of jerky turns do"
            )
    if jumps and not exceeds:
        return Advised(f"{jumps}{IN_U}", f"turn smoothly, or sample faster{jitter_hint(observations)}")
    if scatter == 0.0:
        return f"the {group.words} are further from the fit than their noise explains"
    sentence, remedies = f"the {group.words} scatter by {with_unit(scatter, group.unit)}", list[str]()
    sentence += f", {ratio:.2g} times their noise"
    if exceeds:
        sentence += f", more than {MODEL_FAILURE_RATIO:.0f}: the model does not describe this"
        if group.name not in REST_SCATTER:
            remedies.append(f"look for lost or held samples{jitter_hint(observations)}")
    elif group.name in REST_SCATTER:
        remedies.append("longer rests on a hard support reduce it")
    if jumps:
        sentence += f"; and {jumps}"
        remedies.append("turn smoothly, or sample faster")
    return advised(f"{sentence}{RANDOM_IN_U}", *remedies)


def unusual_groups(estimate: Estimate) -> Iterator[Finding]:
    """Yield the groups beyond the linear model, without drifts, that are far larger than usual, by kind of sensor."""
    sizes = {h.name: h for h in estimate.hyperparameters}
    by_kind = dict[str, dict[str, str]]()
    for finding in estimate.groups:
        group, size, widened = group_of(finding.name), sizes.get(finding.name), finding.prior_widened
        if group.variable == "time":
            continue
        if (widened if size is None else size.low) > UNUSUAL_GROUP_RATIO or widened > WIDENED_RATIO:
            unit, name = shown_in(group.name, group.unit, finding.prior)
            times, usual = max(0.0 if size is None else size.value, widened), two_digits(finding.prior / unit)
            words = f"{group.words} (about {times:.2g} times the usual {usual} {name})".replace(" °", "°")
            by_kind.setdefault(group.kind, {})[group.name] = words
    for kind, groups in by_kind.items():
        sentence = Advised(
            f"larger than usual: {', '.join(groups.values())}{IN_U}",
            "if the device is like that, state sizes in [device.prior] or another grade; otherwise look for "
            "disturbances in the log",
        )
        yield Finding(sentence=sentence, concerns=(kind,), causes=tuple(groups))


def _longest_session(linearised: Linearisation) -> float:
    """Return the time from the first rest of a session to its last, s, of the longest session."""
    rests = linearised.problem.observations.rests
    parts = [part.rests for part in linearised.problem.parts]
    return max(float(rests.stop[part].max() - rests.start[part].min()) for part in parts)


def _usual_size(size: HyperparameterEstimate, linearised: Linearisation, drift_factor: float = 1.0) -> float:
    """Return the usual size of a hyperparameter.

    That of an in-run bias includes the standard deviation d T/√12 of a drift over the session, where d is
    `drift_factor` times the usual drift, if the process includes the drift."""
    drift = drift_factor * linearised.problem.observations.drift.get(size.name.removesuffix("_in_run"), 0.0)
    return float(np.hypot(size.usual, drift * _longest_session(linearised) / np.sqrt(12.0))) if drift else size.usual


def _varying_parameters(estimate: Estimate, linearised: Linearisation) -> Iterator[Finding]:
    """Yield drifts of biases and scale factors, and in-run biases, that are far larger than usual."""
    by_name, problem = {h.name: h for h in estimate.hyperparameters}, linearised.problem
    longest = _longest_session(linearised)

    def is_unusual(size: HyperparameterEstimate | None) -> bool:
        return size is not None and size.low > UNUSUAL_RATIO * _usual_size(size, linearised)

    for block in problem.instrument.blocks:
        kind, words, unit = block.kind, SENSORS[block.kind], BIAS_UNITS[block.kind]
        for what, cause, parameters, drift_unit in (
            ("bias", "drift", f"biases of the {words}", unit),
            ("scale", "scale-factor drift", f"scale factors of the {words}", (1e-6, "ppm")),
        ):
            name = f"{kind}.{what}.drift"
            if is_unusual(by_name.get(name)):
                if name in problem.instrument.members:
                    drifts = estimate.values[problem.instrument.members[name]]
                else:  # of the sessions
                    assert estimate.own is not None
                    drifts = estimate.own.values[:, problem.local_members[name]]
                changed = with_unit(longest * float(np.abs(drifts).max()), drift_unit)
                sentence = advised(
                    f"{parameters} drift by {changed} over the session, the values given are means over its "
                    f"rests{IN_U}",
                    "let the device warm up, or make the session shorter",
                )
                yield Finding(sentence=sentence, concerns=(f"{kind}.{what}",), causes=(cause,), unsteady=True)
        size, time, bias = by_name.get(f"{kind}_in_run"), by_name.get(f"{kind}_time"), (f"{kind}.bias",)
        if size is None or time is None:
            continue
        in_run = with_unit(size.value, unit)
        if is_unusual(size) and not is_unusual(by_name.get(f"{kind}.bias.drift")):
            usual = with_unit(_usual_size(size, linearised), unit)
            sentence = f"biases of the {words} wander by {in_run} in the session, where {usual} is usual"
            lasting = time.value > longest
            if lasting:
                sentence += ", and last longer than the session: a drift, a jump, or warm-up after power-on"
            cause = "drift" if lasting else "in-run bias"
            sentence = advised(f"{sentence}{IN_U}", "switch on earlier" if lasting else "")
            yield Finding(sentence=sentence, concerns=bias, causes=(cause,), unsteady=True)
        for sensor in block.sensors:
            ratio = by_name.get(f"{kind}.in_run.{sensor}")
            if ratio is not None and is_unusual(ratio):
                wander = with_unit(ratio.value * size.value, unit)
                sentence = f"{kind}.bias.{sensor} wanders by {wander}, those of the other {words} by {in_run}{IN_U}"
                yield Finding(sentence=sentence, concerns=bias, causes=("wandering sensor",), unsteady=True)
