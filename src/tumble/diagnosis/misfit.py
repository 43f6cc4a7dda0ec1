"""Findings from the residuals of an estimate.

An estimate is accepted with scatter if a group of residuals exceeds the noise within rests and the usual in-run biases,
if a cause is significant (`tumble.diagnosis.causes`), or if biases or scale factors vary far more than usual
(`tumble.diagnosis.unusual_sizes`). All tests together find something in less than one of a hundred clean sessions. An
estimate is refused if its uncertainty cannot be trusted: if leaving out a significant cause moves a parameter of the
linear model by more than LARGEST_DAMAGE of its u, since this error is not random. Groups that it moves by less than
ACCEPTED_DAMAGE are accepted all the same.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from operator import attrgetter

import numpy as np

from tumble.advice import Advised, advised, found_in, prefixed, remedy_of
from tumble.diagnosis.causes import (
    LinearisedSession,
    causes_of_session,
    earth_rate_errors,
    fit_causes,
    quantisation,
)
from tumble.diagnosis.findings import BIAS_UNITS, IN_U, SENSORS, TURN_GROUPS, Finding, refusal, remark, with_unit
from tumble.diagnosis.lost_samples import (
    are_measured_intervals,
    jitter_hint,
    lost_in_all_turns,
    lost_in_one_turn,
    samples_held,
    stamps_remedy,
)
from tumble.diagnosis.projection import FALSE_ALARMS, SumOfSquares, holm_limit, projections, with_unknown_headings
from tumble.diagnosis.unusual_sizes import UNUSUAL_RATIO, unusual_groups, usual_sizes, varying_parameters
from tumble.inference.estimate import Estimate
from tumble.inference.linearisation import Linearisation
from tumble.inference.noise import (
    NO_COMPONENTS,
    REST_SCATTER,
    SCATTER,
    SCATTER_WORDS,
    VarianceComponents,
    typical_noise,
)
from tumble.inference.normal_equations import Solution, solve
from tumble.inference.problem import SessionSpan
from tumble.reduction.observations import Observations
from tumble.sensors.model import SensorKind
from tumble.units import DEGREE, DEGREE_PER_HOUR, G_STANDARD, two_digits

CAUSE_P_VALUE = 0.02  # causes of a significant scatter are named if their p-value is smaller
LOST_SAMPLES_P_VALUE = 0.05  # lost samples are named first for turns that scatter if their p-value is smaller
MOST_CAUSES = 3  # causes that are named
MODEL_FAILURE_RATIO = 30.0
"""Scatter over noise above which the model fails: then the errors of turns are not random, and gyro parameters from
turns are refused."""
NEGLIGIBLE_SCATTER = {"accel": 5e-6 * G_STANDARD, "gyro": 0.02 * DEGREE_PER_HOUR, "turn": 2e-5, "velocity": 1e-3}
"""m/s², rad/s, rad, m/s: scatter without effect on any use of an inertial unit, however small the noise of the log."""
CHANGES = ("jump", "shift")  # causes by which parameters are others before than after
MOVEMENT_RATIO = 10.0
"""Scatter over noise of turns, relative to that of gyros at rest, above which turns have a cause of their own."""
LARGEST_DAMAGE, ACCEPTED_DAMAGE = 3.0, 0.5
"""Errors of parameters by a cause, in u: a larger one refuses the estimate; groups with smaller ones are accepted,
whose errors are then √(1 + 0.5²) u = 1.12 u."""
LARGEST_CLOCK_ERROR = 0.1
"""Relative: a larger one means that the unit of time is wrong, or that the gyros do not measure the Earth's rate."""
RANDOM_IN_U = f"{IN_U} as far as it is random"
RESIDUALS: Mapping[str, tuple[SensorKind, str]] = {
    "accel": ("accel", BIAS_UNITS["accel"]),
    "gyro": ("gyro", BIAS_UNITS["gyro"]),
    "turn": ("gyro", "°"),
    "velocity": ("accel", "mm/s"),
}
"""Kind of sensors at fault and unit of each group of residuals, by its component of variance."""


@dataclass(frozen=True, kw_only=True, slots=True)
class GroupOfResiduals:
    """A group of residuals of one session with its scatter."""

    name: str  # of the component of variance
    p_value: float  # probability that chance exceeds the residuals, by the noise and the usual in-run biases
    scatter: float  # SI, that of the in-run bias included
    ratio: float  # of the scatter to the typical noise of a row

    @property
    def at_rest(self) -> bool:
        """Whether they are readings at rest, or else of turns."""
        return self.name in REST_SCATTER

    @property
    def kind(self) -> SensorKind:
        """Kind of sensors at fault."""
        return RESIDUALS[self.name][0]

    @property
    def exceeds_model(self) -> bool:
        """Whether the scatter is too large to be a disturbance of a valid model."""
        return self.ratio > MODEL_FAILURE_RATIO and self.scatter > NEGLIGIBLE_SCATTER[self.name]


def _groups_of_residuals(
    components: VarianceComponents, expected: Solution, observations: Observations, part: SessionSpan
) -> Iterator[GroupOfResiduals]:
    """Yield the groups of residuals of a session, a part of all.

    `expected` is the solution with the noise within rests and the usual in-run biases; `components` are estimated."""
    rests, turns = observations.rests, observations.turns
    covariances = {"accel": rests.accel_covariance, "gyro": rests.gyro_covariance}
    if turns is not None:
        covariances |= {"turn": turns.covariance, "velocity": turns.velocity_covariance}
    by_kind = {kind: (r, C, directions, at) for kind, r, C, directions, at in expected.scatter}
    for name, noise in covariances.items():
        kind = name if name in REST_SCATTER else "turn"
        if kind not in by_kind:
            continue
        rows, (residual, covariance, directions, component) = part.rows[kind], by_kind[kind]
        names = ("turn", "apart") if name == "turn" else (name,)  # rotations, and integrals of redundant gyros
        directions = directions[rows][:, :, np.isin(component, [SCATTER.index(each) for each in names])]
        scatter = float(np.hypot(getattr(components, name), getattr(components, f"{name}_in_run", 0.0)))
        yield GroupOfResiduals(
            name=name,
            p_value=SumOfSquares.along(directions, residual[rows], covariance[rows]).p_value,
            scatter=scatter,
            ratio=scatter / typical_noise(noise) if scatter else 0.0,
        )


def misfit(estimate: Estimate, search: bool = True) -> tuple[Finding, ...]:
    """Return the findings from the residuals of an estimate, and with `search` their causes.

    Each of several sessions is judged by itself. There are none if the estimate has no likelihood. For methods other
    than `joint` the residuals are those of the joint estimate that comes with theirs."""
    if estimate.linearised is None:
        return ()
    linearised = _rows_to_judge(estimate.linearised, estimate)
    session, together = LinearisedSession(linearised), linearised.problem.observations.together
    usual = usual_sizes(estimate, linearised, UNUSUAL_RATIO)
    accel_in_run, gyro_in_run = (usual.get(f"{kind}_in_run", 0.0) for kind in ("accel", "gyro"))
    expected = solve(linearised, VarianceComponents(accel_in_run=accel_in_run, gyro_in_run=gyro_in_run))
    groups = [
        list(_groups_of_residuals(linearised.components, expected, *each))
        for each in zip(session.observed, linearised.problem.session_spans, strict=True)
    ]
    causes = _causes(session) if search else [list[Finding]() for _ in groups]
    limit = holm_limit([*(g.p_value for each in groups for g in each), *(c.p_value for each in causes for c in each)])
    varying = list(varying_parameters(estimate, linearised))
    reported = {kind for finding in varying for kind in finding.kinds if finding.causes != ("scale-factor drift",)}
    findings = list[Finding]()
    for s, (observed, of_residuals, of_session) in enumerate(zip(session.observed, groups, causes, strict=True)):
        expected_size = {g.name: usual.get(f"{g.name}_in_run", usual.get(g.name, 0.0)) for g in of_residuals}
        scattering = [g for g in of_residuals if g.p_value <= limit and g.scatter > expected_size[g.name]]
        for one in _session_findings(linearised, observed, scattering, of_session, limit, reported):
            named = one.sentence if together is None else prefixed(f"{together.names[s]}: ", one.sentence)
            findings.append(replace(one, sentence=named))
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


def _rows_to_judge(linearised: Linearisation, estimate: Estimate) -> Linearisation:
    """Return rows with unknown headings and with priors of groups as wide as their sizes by the integral.

    These may be larger than at the maximum, as scatter and large groups may explain the same residuals, with a maximum
    of the posterior each."""
    problem, sizes = linearised.problem, {h.name: h.value for h in estimate.hyperparameters}
    prior_u = problem.prior_u.copy()
    for finding in estimate.groups:
        if (members := problem.instrument.members.get(finding.name)) is not None:
            places, size = slice(members.start + 1, members.stop + 1), sizes.get(finding.name, 1.0)
            wide = max(size, finding.prior_widened) * problem.usual_u[places]
            prior_u[places] = np.maximum(prior_u[places], wide)
    return with_unknown_headings(linearised.with_priors(replace(problem, prior_u=prior_u)))


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
    if estimate.linearised is None or estimate.linearised.problem.moves:
        return None
    problem, observations = estimate.linearised.problem, estimate.linearised.problem.observations
    if observations.together is not None or observations.gyro_block is None or observations.site.latitude is None:
        return None
    linearised = _rows_to_judge(estimate.linearised, estimate)
    session = LinearisedSession(linearised)
    errors = list(earth_rate_errors(session))
    likely = fit_causes(session, errors)[0] if errors else []
    if not likely or likely[0].cause != "clock" or likely[0].p_value > FALSE_ALARMS:
        return None
    first = _causes(session)[0][0]
    if first.causes != ("clock",):
        return None
    clock = next(error for error in errors if error.name == "clock")
    (projection,) = projections(linearised, NO_COMPONENTS, *clock.columns)
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
    by_p_value, linearised, turns = attrgetter("p_value"), session.linearised, session.observations.turns
    noise = 0.0 if turns is None else typical_noise(turns.covariance)
    by_session = fit_causes(session, [*causes_of_session(session), *lost_in_one_turn(session)])
    for s, causes in enumerate(by_session):
        causes += quantisation(session, s)
        lost = [cause for cause in causes if cause.cause == "lost samples"]
        held = samples_held(session.observed[s])
        scatters = linearised.components.turn > max(noise, NEGLIGIBLE_SCATTER["turn"])
        if held is None and session.has_turns[s] and scatters and not are_measured_intervals(session.observed[s]):
            lost.append(lost_in_all_turns(session, s))
        likely = held or min(lost, key=by_p_value, default=None)
        causes[:] = [cause for cause in causes if cause not in lost] + ([likely] if likely is not None else [])
        causes.sort(key=by_p_value)
    return by_session


def _session_findings(
    linearised: Linearisation,
    observations: Observations,
    scattering: list[GroupOfResiduals],
    causes: list[Finding],
    limit: float,
    reported: set[str],
) -> Iterator[Finding]:
    """Yield the findings from the groups of residuals of one session that are `scattering`, and their causes.

    P-values up to `limit` are significant. Scatter of the readings of kinds of sensors whose in-run biases are
    `reported` is not mentioned."""
    ratios, kinds = {group.name: group.ratio for group in scattering}, {group.kind for group in scattering}
    # lost samples resemble other causes, and come first
    first = [c for c in causes if c.cause == "lost samples" and c.p_value < LOST_SAMPLES_P_VALUE and "turn" in ratios]
    named = first + [cause for cause in causes if cause.p_value <= limit and cause not in first]
    if scattering:  # further causes are named if they may explain it
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
        moved.sort(key=lambda group: not group.startswith(cause.concerns))  # first those of the sensors at fault
        finite = np.isfinite(cause.damage)
        damage = f"up to {two_digits(cause.damage)} times their u" if finite else "more than their u, all alike"
        damage += ", if the most harmful of these is the cause" if len(cause.causes) > 1 else ""
        found = f"{found_in(cause.sentence)}; without it parameters of {', '.join(moved)} err by {damage}"
        sentence = advised(found, remedy_of(cause.sentence))
        yield replace(cause, sentence=sentence, concerns=tuple(moved), refuses=True)
    for group in scattering:
        sentence = _scatter_sentence(group, linearised)
        if not group.at_rest and group.exceeds_model and not jitter_hint(observations):
            yield refusal(found_in(sentence).removesuffix(RANDOM_IN_U), remedy_of(sentence), concerns=TURN_GROUPS)
        elif group.name not in reported:
            yield remark(sentence, concerns=(group.kind,))
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
                f"biases of the {SENSORS[kind]} change by {with_unit(change, BIAS_UNITS[kind])} from one rest to the "
                f"next, {change / noise:.2g} times the noise of a rest: the model does not describe this",
                "look at the rests with `tumble inspect`",
                concerns=(kind, *(TURN_GROUPS if kind == "accel" else ())),
            )


def _scatter_sentence(group: GroupOfResiduals, linearised: Linearisation) -> str:
    """Return a sentence that a group of residuals scatters, with the size."""
    observations, components, jumps = linearised.problem.observations, linearised.components, ""
    words, exceeds, remedies = SCATTER_WORDS[group.name][1], group.exceeds_model, list[str]()
    if group.name == "turn" and observations.turns is not None:
        aliased = components.aliased * float(np.sqrt(observations.turns.aliased.max()))
        if aliased > components.turn:
            jumps = (
                f"the rotations of the turns err by up to about {aliased / DEGREE:.2g}° where rates jump from sample "
                "to sample, as instantaneous samples of jerky turns do"
            )
    if jumps and not exceeds:
        return Advised(f"{jumps}{IN_U}", f"turn smoothly, or sample faster{jitter_hint(observations)}")
    if group.scatter == 0.0:
        return f"the {words} are further from the fit than their noise explains"
    sentence = f"the {words} scatter by {with_unit(group.scatter, RESIDUALS[group.name][1])}"
    sentence += f", {group.ratio:.2g} times their noise"
    if exceeds:
        sentence += f", more than {MODEL_FAILURE_RATIO:.0f}: the model does not describe this"
        if not group.at_rest:
            remedies.append(f"look for lost or held samples{jitter_hint(observations)}")
    elif group.at_rest:
        remedies.append("longer rests on a hard support reduce it")
    if jumps:
        sentence += f"; and {jumps}"
        remedies.append("turn smoothly, or sample faster")
    return advised(f"{sentence}{RANDOM_IN_U}", *remedies)
