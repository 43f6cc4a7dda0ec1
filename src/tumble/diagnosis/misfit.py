"""Residuals that the noise does not explain: how likely by chance, how large, what is behind them, and what follows.

An estimate is accepted with scatter where a group of residuals is larger than the noise within rests explains, where
a cause stands out (`tumble.diagnosis.causes`), or where biases or scale factors wander or drift beyond what is usual:
by all tests together in less than one of a hundred clean sessions. It is not accepted where its uncertainty cannot be
trusted: where a cause that stands out, being left out, moves a parameter of the linear model by more than DAMAGE of its
u, for then the error is not random. Groups of parameters that it moves by less than SPARED are accepted all the same.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from operator import attrgetter

import numpy as np

from tumble.diagnosis.causes import Cause, candidates_of, earth_rate_errors, quantisation, tested
from tumble.diagnosis.findings import Finding, refusal, remark
from tumble.diagnosis.linearised_session import UNITS, WORDS, Kind, LinearisedSession, sized
from tumble.diagnosis.lost_samples import (
    OF_TURNS,
    jittering,
    lost_in_all_turns,
    of_turns,
    samples_held,
    stamps_remedy,
    turns_to_blame,
)
from tumble.diagnosis.projection import FALSE_ALARMS, SumOfSquares, judged_solution, projections, standing_out
from tumble.inference.estimate import Estimate, HyperparameterEstimate
from tumble.inference.linearisation import Linearisation
from tumble.inference.noise import REST_SCATTER, SCATTER, VarianceComponents, typical_noise
from tumble.inference.normal_equations import Solution
from tumble.inference.problem import SessionSpan
from tumble.reduction.observations import Observations
from tumble.sensors.parameters import group_of, shown_in
from tumble.units import DEGREE, DEGREE_PER_HOUR, G_STANDARD, two_digits

NAMED_PROBABILITY, LOST_PROBABILITY = 0.02, 0.05
"""A cause is named for scatter that is there where chance alone would show as much less often, and samples are taken
for lost in turns that scatter."""
MOST_NAMED = 3
MOST_SESSIONS = 5
"""Of several sessions, so many at most are described one by one."""
MANY = 30.0
"""Times the noise: a larger scatter is no disturbance of a model that otherwise holds. What turns err by is then not
random either, and what they tell of the gyros is refused."""
NEGLIGIBLE_SCATTER = {"accel": 5e-6 * G_STANDARD, "gyro": 0.02 * DEGREE_PER_HOUR, "turn": 2e-5, "velocity": 1e-3}
"""m/s², rad/s, rad, m/s: scatter that no use of an inertial unit would notice, however small the noise of the log."""
BEYOND_USUAL = 3.0
"""Times what is usual of the grade: an in-run bias or a drift that is larger for certain, by the lower limit of its
middle 68 %, is said; and so is the in-run bias of a sensor, beside those of its kind."""
LARGER, WIDENED = 5.0, 10.0
"""Times its usual size: a group of parameters that is larger for certain, by the lower limit of its middle 68 %, is
said, and one whose prior is widened by more at the maximum."""
TURNS_MORE = 10.0
"""Times: turns that scatter by more than gyros at rest, in parts of their noise, do so for a cause of their own."""
DAMAGE, SPARED = 3.0, 0.5
"""Times u: a parameter that errs by more because a cause was left out; and by what those of a group err at most that is
accepted beside it, whose errors are of √(1 + SPARED²) u then, 1.12 u."""
LARGEST_CLOCK_ERROR = 0.1
"""Relative: a clock that is off by more is read in a wrong unit, or the gyros do not show the Earth's rate."""
CONTAINED = "; u contains it"
AT_RANDOM = f"{CONTAINED} as far as it is random"


@dataclass(frozen=True, kw_only=True, slots=True)
class Group:
    """A group of residuals: the component of scatter that gives its size, those `beside` it, which sensors it concerns,
    words, and (SI, name) of a unit."""

    name: str
    beside: tuple[str, ...] = ()
    concerns: Kind
    words: str
    unit: tuple[float, str]

    def scatter(self, components: VarianceComponents) -> float:
        """Its scatter, with that of the in-run bias."""
        in_run = {"accel": components.accel_in_run, "gyro": components.gyro_in_run}.get(self.name, 0.0)
        return float(np.hypot(getattr(components, self.name), in_run))

    def beyond_model(self, ratio: float, components: VarianceComponents) -> bool:
        """Whether its scatter, so many times the noise, is no disturbance of a model that otherwise holds."""
        return ratio > MANY and self.scatter(components) > NEGLIGIBLE_SCATTER[self.name]

    def noise(self, observations: Observations) -> float:
        """The usual noise of a row."""
        rests, turns = observations.rests, observations.turns
        covariances = {"accel": rests.accel_covariance, "gyro": rests.gyro_covariance}
        if turns is not None:
            covariances |= {"turn": turns.covariance, "velocity": turns.velocity_covariance}
        return typical_noise(covariances[self.name])

    def chance(self, linearised: Linearisation, alone: Solution, part: SessionSpan) -> float:
        """Probability that chance alone makes the residuals of a session as large as they are beside the noise within
        rests, in the directions of the scatter."""
        noise, equations = linearised.noise, alone.equations
        rests = self.name in REST_SCATTER
        Z, of = noise.rest_directions if rests else noise.turn_directions
        W = equations.rest_whitening if rests else equations.turn_whitening
        residual, covariance = alone.rest_residuals if rests else alone.turn_residuals
        some = part.rests if rests else part.turns
        along = Z[:, :, np.isin(of, [SCATTER.index(name) for name in (self.name, *self.beside)])]
        return SumOfSquares.along(W[some] @ along[some], residual[some], covariance[some]).chance


GROUPS = (
    Group(name="accel", concerns="accel", words="readings of the accelerometers at rest", unit=UNITS["accel"]),
    Group(name="gyro", concerns="gyro", words="readings of the gyros at rest", unit=UNITS["gyro"]),
    Group(name="turn", beside=("apart",), concerns="gyro", words="rotations of the turns", unit=(DEGREE, "°")),
    Group(name="velocity", concerns="accel", words="velocities of the turns", unit=(1e-3, "mm/s")),
)


def misfit(estimate: Estimate, search: bool = True) -> tuple[Finding, ...]:
    """What the residuals of an estimate show, of several sessions each for itself, and where there is a `search` the
    causes behind them; nothing where no likelihood of the estimate is kept. Of a method whose u has a scatter of its
    own the residuals are those about the joint estimate."""
    linearised = estimate.linearised
    if linearised is None:
        return ()
    alone = judged_solution(linearised, VarianceComponents())
    session, together = LinearisedSession(linearised), linearised.problem.observations.together
    chances = [{group: group.chance(linearised, alone, part) for group in GROUPS} for part in linearised.problem.parts]
    causes = _causes(session, alone) if search else [[] for _ in chances]
    limit = standing_out([p for by in chances for p in by.values()] + [c.probability for by in causes for c in by])
    wandering = list(_wandering(estimate, linearised))
    usual = {h.name.removesuffix("_in_run"): h.usual for h in estimate.hyperparameters}
    known = {kind for found in wandering for kind in found.kinds if found.causes != ("scale-factor drift",)}
    every = [
        list(_of_session(linearised, *of_session, limit, usual, known))
        for of_session in zip(session.observed, chances, causes, strict=True)
    ]
    if together is not None:
        named = zip(together.names, every, strict=True)
        every = [[replace(each, sentence=f"{name}: {each.sentence}") for each in found] for name, found in named]
        every = [found for found in every if found]
    findings = [each for found in every[:MOST_SESSIONS] for each in found]
    for found in every[MOST_SESSIONS:]:  # remarks on so many sessions would be more than anyone reads
        findings += (each for each in found if each.refuses)
    if len(every) > MOST_SESSIONS:
        findings.append(
            remark(f"{len(every) - MOST_SESSIONS} more sessions scatter: calibrate them one by one to see by what")
        )
    findings += [*_groups_beyond_usual(estimate), *wandering]
    if estimate.method == "joint":
        return tuple(findings)
    return tuple(
        replace(each, sentence=f"by the method joint, {each.sentence}".replace(AT_RANDOM, "").replace(CONTAINED, ""))
        for each in findings
    )


@dataclass(frozen=True, kw_only=True, slots=True)
class ClockByEarth:
    """The clock of a log by the Earth's rate: seconds in one of its seconds, the relative standard uncertainty of that,
    and what the parameters of the gyros, by name, change with one of it."""

    rate: float
    u: float
    changes: Mapping[str, float]

    def sentence(self, corrected: str) -> str:
        """What it says, and which parameters are corrected for it."""
        return (
            f"by the Earth's rate a second of the log's clock is {100.0 * (self.rate - 1.0):+.3g} % longer than one, "
            f"to {100.0 * self.u:.2g} %: {corrected} corrected for it; look at rate_hz, or the time column, in [log]"
        )


def clock_by_earth(estimate: Estimate) -> ClockByEarth | None:
    """The clock of a log where the Earth's rate contradicts the stated one and no other cause explains as much.

    By least squares with the noise within rests, for what an estimate takes for wandering biases is the error of the
    clock, and with the scatter that is left beside it."""
    linearised = estimate.linearised
    if linearised is None or linearised.problem.observations.together is not None:
        return None
    session, problem = LinearisedSession(linearised), linearised.problem
    if problem.observations.gyro_block is None or problem.observations.site.latitude is None or problem.moves:
        return None
    errors = list(earth_rate_errors(session))
    likely = tested(linearised, errors)[0]
    if not likely or likely[0].name != "clock" or likely[0].probability > FALSE_ALARMS:
        return None
    first = _causes(session, judged_solution(linearised, VarianceComponents()))[0][0]
    if first.name != "clock" or first.rivals:
        return None
    clock = next(error for error in errors if error.name == "clock")
    (alone,) = projections(linearised, VarianceComponents(), *clock.columns)
    explained = alone.explained(slice(0, 1))
    assert explained is not None
    scatter = max(1.0, (alone.chi_square - explained.fall) / alone.degrees)
    value, u = float(explained.values[0]), float(np.sqrt(scatter / explained.fall) * abs(explained.values[0]))
    if abs(value) > LARGEST_CLOCK_ERROR:
        return None
    changes = zip(problem.instrument.names, (-u / value * explained.moved).tolist(), strict=True)
    return ClockByEarth(
        rate=1.0 + value, u=u, changes={name: change for name, change in changes if name.startswith("gyro")}
    )


def _causes(session: LinearisedSession, alone: Solution) -> list[list[Cause]]:
    """Of each session all causes, the most significant first, one of a name and kind of sensor, by what is left of the
    residuals with the noise `alone` and with the components of variance of the estimate."""
    by_probability, linearised = attrgetter("probability"), session.linearised
    whole = judged_solution(linearised, linearised.components)
    by_session = tested(linearised, [*candidates_of(session, alone), *of_turns(session, whole)])
    blamed = turns_to_blame(linearised) if any(session.turned) else whole
    for s, causes in enumerate(by_session):
        causes += quantisation(session, s)
        lost = [cause for cause in causes if cause.name == "lost samples"]
        held = samples_held(session.observed[s])
        if held is None and session.turned[s] and blamed.components.turn > NEGLIGIBLE_SCATTER["turn"]:
            lost.append(lost_in_all_turns(session, s, blamed))
        likely = held or min(lost, key=by_probability, default=None)
        causes[:] = [cause for cause in causes if cause not in lost] + ([likely] if likely is not None else [])
        causes.sort(key=by_probability)
    return by_session


def _of_session(
    linearised: Linearisation,
    observations: Observations,
    chances: Mapping[Group, float],
    causes: list[Cause],
    limit: float,
    usual: Mapping[str, float],
    known: set[str],
) -> Iterator[Finding]:
    """What the residuals of a session show, by the probabilities of its groups and of its causes, of which those up to
    a limit stand out. A scatter within the `usual` size of in-run biases is not mentioned, and that of the readings of
    a kind of sensors whose in-run biases are mentioned is `known` already."""
    components = linearised.components
    larger = {
        group: group.scatter(components) / group.noise(observations)
        for group, p in chances.items()
        if p <= limit and group.scatter(components) > usual.get(group.name, 0.0)
    }
    ratios = {group.name: ratio for group, ratio in larger.items()}
    lost = [cause for cause in causes if cause.name == "lost samples"]
    first = [cause for cause in lost if cause.probability < LOST_PROBABILITY and "turn" in ratios]  # looks like others
    named = first + [cause for cause in causes if cause.probability <= limit and cause not in first]
    if larger:  # others that may be behind a scatter that is there
        concerned = {"both", *(group.concerns for group in larger)}
        likely = [cause for cause in causes if cause not in named and cause.concerns in concerned]
        explained = any(cause.concerns != "accel" for cause in named)
        if ratios.get("turn", 0.0) > TURNS_MORE * ratios.get("gyro", 0.0) and not explained:
            # what makes turns scatter, and gyros at rest much less, is random itself: nothing systematic need fit it
            sentence = "a device that moved after it was put down, or before it was taken up: wait until it lies still"
            named.append(Cause(name="movement", concerns="gyro", probability=1.0, sentence=sentence))
            untold = "or samples that are missing or held in the log, which these turns do not tell from movement: "
            untold += stamps_remedy(jittering(observations))
            named += (replace(cause, sentence=untold) for cause in likely if cause.name == "lost samples")
        named += (cause for cause in likely if cause.probability < NAMED_PROBABILITY)
    named = named[:MOST_NAMED]
    harmful = [c for c in named if c.damage > DAMAGE and (c.probability <= limit or c in first)]
    yield from map(damaging, harmful)
    for group, ratio in larger.items():
        sentence = _larger(group, ratio, linearised)
        if group.name not in REST_SCATTER and group.beyond_model(ratio, components) and not jittering(observations):
            yield refusal(sentence.removesuffix(AT_RANDOM), *OF_TURNS)
        elif group.name not in known:
            yield remark(sentence, group.concerns)
    for cause in named:
        if cause not in harmful:
            sentence = f"probable cause: {cause.sentence}"
            yield Finding(sentence=sentence, concerns=cause.concerned, causes=(cause.name, *cause.rivals))
    yield from _restless(linearised)


def _restless(linearised: Linearisation) -> Iterator[Finding]:
    """Kinds of sensors whose biases change from one rest to the next by more than MANY times the noise of a rest.

    The in-run bias changes by σ_b √(2 − 2 e^{−Δt/τ}) from rest to rest. A device that wanders or warms up changes by a
    few times its noise; where it is more, the process has taken an error that is no bias. The turns are compared with
    the verticals that the accelerometers see, so that theirs spoils the scale factors and axes of the gyros too."""
    rests, components = linearised.problem.observations.rests, linearised.components
    interval = float(np.median(np.diff(0.5 * (rests.start + rests.stop)))) if len(rests) > 1 else 0.0
    for block in linearised.problem.instrument.blocks:
        kind, noise = block.kind, typical_noise(getattr(rests, f"{block.kind}_covariance"))
        size, time = getattr(components, f"{kind}_in_run"), getattr(components, f"{kind}_time")
        change = float(size * np.sqrt(-2.0 * np.expm1(-interval / time))) if time > 0.0 else 0.0
        if change > max(MANY * noise, NEGLIGIBLE_SCATTER[kind]):
            yield refusal(
                f"biases of the {WORDS[kind]} change by {sized(change, UNITS[kind])} from one rest to the next, "
                f"{change / noise:.2g} times the noise of a rest: something is there that the model does not have; "
                "look at the rests with `tumble inspect`",
                *(kind, *(OF_TURNS if kind == "accel" else ())),
            )


def damaging(cause: Cause) -> Finding:
    """A cause that does harm, as a reason, with the groups of parameters that it does not spare, those of the sensors
    at fault first."""
    err = [group for group, damage in cause.by_group.items() if damage > SPARED]
    err.sort(key=lambda group: not group.startswith(cause.concerned))
    by = f"up to {cause.damage:.2g} times their u" if np.isfinite(cause.damage) else "more than their u, all alike"
    sentence = f"{cause.sentence}; without it parameters of {', '.join(err)} err by {by}"
    return Finding(sentence=sentence, concerns=tuple(err), refuses=True, causes=(cause.name, *cause.rivals))


def _larger(group: Group, ratio: float, linearised: Linearisation) -> str:
    """That a group of residuals is larger than its noise, with its size."""
    observations, components = linearised.problem.observations, linearised.components
    scatter, beyond, jumps = group.scatter(components), group.beyond_model(ratio, components), ""
    if group.name == "turn" and observations.turns is not None:
        aliased = components.aliased * float(np.sqrt(observations.turns.aliased.max()))
        if aliased > components.turn:
            jumps = (
                f"the rotations of the turns err by up to about {aliased / DEGREE:.2g}° where rates jump from sample "
                "to sample, as instantaneous samples of jerky turns do"
            )
    if jumps and not beyond:
        return f"{jumps}{CONTAINED}; turn smoothly, or sample faster{jittering(observations)}"
    if scatter == 0.0:
        return f"the {group.words} are further from the fit than their noise explains"
    said = f"the {group.words} scatter by {sized(scatter, group.unit)}, {ratio:.2g} times their noise"
    if beyond:
        said += f", more than {MANY:.0f}: something is there that the model does not have"
        if group.name not in REST_SCATTER:
            said += f"; look for lost or held samples{jittering(observations)}"
    said += f"; and {jumps}: turn smoothly, or sample faster" if jumps else ""
    return f"{said}{AT_RANDOM}"


def _groups_beyond_usual(estimate: Estimate) -> Iterator[Finding]:
    """Groups beyond the linear model, but for drifts, that are far larger than usual, by kind of sensor."""
    sizes = {h.name: h for h in estimate.hyperparameters}
    by_kind = dict[str, dict[str, str]]()
    for finding in estimate.groups:
        group, size, widened = group_of(finding.name), sizes.get(finding.name), finding.prior_widened
        if group.variable == "time":
            continue
        if (widened if size is None else size.low) > LARGER or widened > WIDENED:
            unit, name = shown_in(group.name, group.unit, finding.prior)
            times, usual = max(0.0 if size is None else size.value, widened), two_digits(finding.prior / unit)
            said = f"{group.words} (about {times:.2g} times the usual {usual} {name})".replace(" °", "°")
            by_kind.setdefault(group.kind, {})[group.name] = said
    for kind, groups in by_kind.items():
        sentence = (
            f"larger than usual: {', '.join(groups.values())}{CONTAINED}; state sizes in [device.prior], or "
            "another grade, where the device is so, and look for disturbances of the log where it is not"
        )
        yield Finding(sentence=sentence, concerns=(kind,), causes=tuple(groups))


def _wandering(estimate: Estimate, linearised: Linearisation) -> Iterator[Finding]:
    """What changes within the session far beyond what is usual, by the sizes that were estimated: drifts of biases and
    of scale factors, in-run biases of kinds of sensors, and of single ones."""
    by_name, rests = {h.name: h for h in estimate.hyperparameters}, linearised.problem.observations.rests
    longest = max(float(rests.stop[p.rests].max() - rests.start[p.rests].min()) for p in linearised.problem.parts)
    for block in linearised.problem.instrument.blocks:
        kind, words, drifts = block.kind, WORDS[block.kind], dict[str, bool]()
        for what, cause, drifting, unit in (
            ("bias", "drift", f"biases of the {words}", UNITS[kind]),
            ("scale", "scale-factor drift", f"scale factors of the {words}", (1e-6, "ppm")),
        ):
            name = f"{kind}.{what}.drift"
            drifts[what] = name in by_name and _beyond(by_name[name])
            if drifts[what]:
                changed = sized(longest * _slope(name, estimate, linearised), unit)
                sentence = (
                    f"{drifting} drift by {changed} over the session, those given are the means of its "
                    f"rests{CONTAINED}; let the device warm up, or make the session shorter"
                )
                yield Finding(sentence=sentence, concerns=(f"{kind}.{what}",), causes=(cause,))
        size, lasting, bias = by_name.get(f"{kind}_in_run"), by_name.get(f"{kind}_time"), (f"{kind}.bias",)
        if size is None or lasting is None:
            continue
        of_kind = sized(size.value, UNITS[kind])
        if _beyond(size) and not drifts["bias"]:
            lasts = lasting.value > longest
            remark = (
                f"biases of the {words} wander by {of_kind} in the session, where {sized(size.usual, UNITS[kind])} is "
                "usual"
            )
            if lasts:
                remark += ", and last longer than it: a drift, or warm-up after power-on; switch on earlier"
            cause = "drift" if lasts else "in-run bias"
            yield Finding(sentence=f"{remark}{CONTAINED}", concerns=bias, causes=(cause,))
        for sensor in block.sensors:
            unlike = by_name.get(f"{kind}.in_run.{sensor}")
            if unlike is not None and _beyond(unlike):
                alone = sized(unlike.value * size.value, UNITS[kind])
                remark = f"{kind}.bias.{sensor} wanders by {alone}, those of the other {words} by {of_kind}{CONTAINED}"
                yield Finding(sentence=remark, concerns=bias, causes=("wandering sensor",))


def _beyond(size: HyperparameterEstimate) -> bool:
    """Whether a size is far beyond the usual one."""
    return size.low > BEYOND_USUAL * size.usual


def _slope(name: str, estimate: Estimate, linearised: Linearisation) -> float:
    """The largest change a second of a group of drifts, of the instrument or of the sessions."""
    problem = linearised.problem
    if name in problem.instrument.members:
        return float(np.abs(estimate.values[problem.instrument.members[name]]).max())
    assert estimate.own is not None
    return float(np.abs(estimate.own.values[:, problem.local_members[name]]).max())
