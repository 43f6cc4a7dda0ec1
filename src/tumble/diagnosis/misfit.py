"""Residuals that the noise does not explain: how likely by chance, how large, what is behind them, and what follows.

An estimate is accepted with scatter where a group of residuals is larger than the noise within rests explains, where
a cause stands out (`tumble.diagnosis.causes`), or where biases wander beyond what is usual: by all tests together in
less than one of a hundred clean sessions. It is not accepted where its uncertainty cannot be trusted: where a cause
that stands out, being left out, moves a parameter of the linear model by more than DAMAGE of its u, for then the error
is not random.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from tumble.diagnosis.causes.cause import UNITS, WORDS, Cause, Concerns
from tumble.diagnosis.causes.chances import SumOfSquares, standing_out
from tumble.diagnosis.causes.linearised_session import LinearisedSession
from tumble.diagnosis.causes.lost_samples import jittering, lost_in_a_turn, stamps_remedy, with_all_groups
from tumble.diagnosis.causes.projection import Remaining
from tumble.diagnosis.causes.ranking import causes, tested
from tumble.inference.estimate import Estimate, HyperparameterEstimate
from tumble.inference.hyperparameters import REST_MODES, SCATTER, Components
from tumble.inference.joint import joint
from tumble.inference.likelihood import Linearised
from tumble.inference.session_spans import SessionSpan
from tumble.reduction.observations import Observations
from tumble.units import DEGREE, DEGREE_PER_HOUR, G_STANDARD, Array

NAMED_PROBABILITY = 0.02
"""A cause is named for scatter that is there where chance alone would show as much less often."""

MOST_NAMED = 3
MOST_SESSIONS = 5
"""Of several sessions, so many at most are described one by one."""

MANY = 30.0
"""Times the noise: a larger scatter is no disturbance of a model that otherwise holds."""

NOTHING = {"accel": 5e-6 * G_STANDARD, "gyro": 0.02 * DEGREE_PER_HOUR, "turn": 2e-5}
"""m/s², rad/s, rad: scatter that no use of an inertial unit would notice, however small the noise of the log."""

BEYOND_USUAL = 3.0
"""Times what is usual of the grade: an in-run bias that is larger for certain, by the lower limit of its middle 68 %,
is said; and so is that of a sensor, beside those of its kind."""

TURNS_MORE = 10.0
"""Times: turns that scatter by more than gyros at rest, in parts of their noise, do so for a cause of their own."""

CONTAINED = "; u contains it"
AT_RANDOM = f"{CONTAINED} as far as it is random"

DAMAGE = 3.0
"""Times u: a parameter that errs by more because a cause was left out."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Group:
    """A group of residuals: its component of scatter, which sensors it concerns, words, and (SI, name) of a unit."""

    component: str
    concerns: Concerns
    words: str
    unit: tuple[float, str]


GROUPS = (
    Group(
        component="accel",
        concerns="accel",
        words="readings of the accelerometers at rest",
        unit=UNITS["accel"],
    ),
    Group(component="gyro", concerns="gyro", words="readings of the gyros at rest", unit=UNITS["gyro"]),
    Group(component="turn", concerns="gyro", words="rotations of the turns", unit=(DEGREE, "°")),
    Group(component="velocity", concerns="accel", words="velocities of the turns", unit=(1e-3, "mm/s")),
)


BESIDE = {"turn": ("apart",)}
"""Components of scatter whose residuals belong to the group of another."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Misfit:
    """Reasons and remarks with what they concern, and the names of the causes that stand out, the most likely first."""

    reasons: tuple[tuple[Concerns, str], ...] = ()
    remarks: tuple[tuple[Concerns, str], ...] = ()
    causes: tuple[str, ...] = ()


def misfit(estimate: Estimate) -> Misfit | None:
    """What the residuals of an estimate say, of several sessions each for itself; None where nothing keeps a likelihood
    of it."""
    linearised = estimate.linearised
    if linearised is None:
        return None
    alone, whole = Remaining.of(linearised, Components()), Remaining.of(linearised, linearised.components)
    parts, observed = linearised.problem.parts, LinearisedSession(linearised).observed
    chances = [group_chances(linearised, alone, part) for part in parts]
    found = causes(linearised, alone, whole)
    wandering = list(_wandering(estimate, linearised))
    usual = {h.name.removesuffix("_in_run"): h.usual for h in estimate.hyperparameters}
    limit = standing_out([p for own in chances for p in own] + [c.probability for own in found for c in own])
    every = [
        _of_session(linearised, seen, own, likely, limit, usual, {concerns for concerns, *_ in wandering})
        for seen, own, likely in zip(observed, chances, found, strict=True)
    ]
    together = linearised.problem.observations.together
    if together is not None:
        said = [(name, each) for name, each in zip(together.names, every, strict=True) if each.remarks or each.reasons]
        every = [_of_all(said)]
    of_process = Misfit(
        remarks=tuple((concerns, remark) for concerns, _, remark in wandering),
        causes=tuple(cause for _, cause, _ in wandering),
    )
    joined = Misfit(
        reasons=every[0].reasons,
        remarks=of_process.remarks + every[0].remarks,
        causes=tuple(dict.fromkeys(every[0].causes + of_process.causes)),
    )
    return joined if estimate.method == "joint" else _about_joint(joined)


def _about_joint(found: Misfit) -> Misfit:
    """What residuals about the joint estimate say of one by another method, whose u has a scatter of its own."""
    said = ((concerns, remark.replace(AT_RANDOM, "").replace(CONTAINED, "")) for concerns, remark in found.remarks)
    return replace(
        found,
        reasons=tuple((concerns, f"by the method joint, {reason}") for concerns, reason in found.reasons),
        remarks=tuple((concerns, f"by the method joint, {remark}") for concerns, remark in said),
    )


def _of_all(found: list[tuple[str, Misfit]]) -> Misfit:
    """What residuals of sessions say, each with its name: the first few, and how many more."""
    shown, more = found[:MOST_SESSIONS], len(found) - MOST_SESSIONS
    remarks = [(concerns, f"{name}: {said}") for name, each in shown for concerns, said in each.remarks]
    if more > 0:
        remarks.append(("both", f"{more} more sessions scatter: calibrate them one by one to see by what"))
    return Misfit(
        reasons=tuple((concerns, f"{name}: {said}") for name, each in found for concerns, said in each.reasons),
        remarks=tuple(remarks),
        causes=tuple(dict.fromkeys(cause for _, each in found for cause in each.causes)),
    )


def _of_session(
    linearised: Linearised,
    observations: Observations,
    chances: list[float],
    found: list[Cause],
    limit: float,
    usual: Mapping[str, float],
    said: set[str],
) -> Misfit:
    """What the residuals of a session say, by the probabilities of its groups and of its causes, of which those up to a
    limit stand out. A scatter within what is `usual` of in-run biases is nothing to speak of, and that of some groups
    is `said` already."""
    larger = [
        group
        for group, chance in zip(GROUPS, chances, strict=True)
        if chance <= limit and _scatter(group, linearised) > usual.get(group.component, 0.0)
    ]
    lost = [cause for cause in found if cause.name == "lost samples" and cause.probability < NAMED_PROBABILITY]
    first = lost if any(group.component == "turn" for group in larger) else []  # what they do looks like others
    named = first + [cause for cause in found if cause.probability <= limit and cause not in first]
    ratios = {group.component: _scatter(group, linearised) / _noise(group, observations) for group in larger}
    if larger:
        others = [cause for cause in found if cause not in named]
        named += _likely(others, ratios, {group.concerns for group in larger}, observations)
    named = named[:MOST_NAMED]
    harmful = [c for c in named if c.damage > DAMAGE and (c.probability <= limit or c in first)]
    remarks = [
        (group.concerns, _larger(group, ratios[group.component], linearised))
        for group in larger
        if group.component not in said
    ]
    remarks += [(cause.concerns, f"probable cause: {cause.sentence}") for cause in named if cause not in harmful]
    return Misfit(
        reasons=tuple((cause.concerns, _damaging(cause)) for cause in harmful),
        remarks=tuple(remarks),
        causes=tuple(cause.name for cause in named),
    )


def _wandering(estimate: Estimate, linearised: Linearised) -> Iterator[tuple[Concerns, str, str]]:
    """In-run biases of kinds of sensors, and of single sensors, that are far beyond usual: what they concern, the name
    of the cause, and a remark."""
    by_name, rests = {h.name: h for h in estimate.hyperparameters}, linearised.problem.observations.rests
    longest = max(float(rests.stop[p.rests].max() - rests.start[p.rests].min()) for p in linearised.problem.parts)
    for block in linearised.problem.instrument.blocks:
        kind: Concerns = "accel" if block.kind == "accel" else "gyro"
        size, lasting = by_name.get(f"{kind}_in_run"), by_name.get(f"{kind}_time")
        drift = by_name.get(f"{kind}.bias.drift")
        if drift is not None and _beyond(drift):
            yield kind, "drift", _drift_said(kind, longest, linearised)
        if size is None or lasting is None:
            continue
        words, of_kind = WORDS[kind], _sized(kind, size.value)
        if _beyond(size) and not (drift is not None and _beyond(drift)):
            drifts = lasting.value > longest
            yield (
                kind,
                "drift" if drifts else "in-run bias",
                f"biases of the {words} wander by {of_kind} in the session, where {_sized(kind, size.usual)} is usual"
                + (", and last longer than it: a drift, or warm-up after power-on; switch on earlier" if drifts else "")
                + CONTAINED,
            )
        for sensor in block.sensors:
            unlike = by_name.get(f"{kind}.in_run.{sensor}")
            if unlike is not None and _beyond(unlike):
                own = _sized(kind, unlike.value * size.value)
                remark = f"{kind}.bias.{sensor} wanders by {own}, those of the other {words} by {of_kind}{CONTAINED}"
                yield kind, "wandering sensor", remark


def _drift_said(kind: str, seconds: float, linearised: Linearised) -> str:
    """By how much biases drift over a session where that is a group of parameters."""
    problem, point, name = linearised.problem, linearised.point, f"{kind}.bias.drift"
    if name in problem.instrument.members:
        slopes = point.values[problem.instrument.members[name]]
    else:
        assert problem.own is not None
        own, first = problem.own.members[name], problem.own.linear_count
        slopes = point.own[:, own.start - first : own.stop - first]
    return (
        f"biases of the {WORDS[kind]} drift by {_sized(kind, seconds * float(np.abs(slopes).max()))} over the session"
        f"{CONTAINED}; let the device warm up, or make the session shorter"
    )


def _beyond(found: HyperparameterEstimate) -> bool:
    """Whether a size is far beyond the usual one."""
    return found.low > BEYOND_USUAL * found.usual


def _sized(kind: str, value: float) -> str:
    """A bias with its unit."""
    size, unit = UNITS[kind]
    return f"{value / size:.2g} {unit}".replace(" °", "°")


def _likely(
    found: list[Cause], ratios: dict[str, float], concerned: set[Concerns], observations: Observations
) -> list[Cause]:
    """Causes, of those that do not stand out, for a scatter that is there, which is `ratios` times the noise. What
    makes turns scatter and not, or much less, the gyros at rest is random itself, so that nothing systematic need fit
    well: it comes first."""
    likely = [c for c in found if c.concerns in {*concerned, "both"}]
    standing = [c for c in likely if c.probability < NAMED_PROBABILITY]
    if ratios.get("turn", 0.0) <= TURNS_MORE * ratios.get("gyro", 0.0):
        return standing
    untold = [_untold(c, observations) for c in likely if c.name == "lost samples"]
    return [_movement(), *untold, *standing]


def group_chances(linearised: Linearised, alone: Remaining, part: SessionSpan) -> list[float]:
    """Probability, by group of a session, that chance alone makes residuals as large as they are beside the noise
    within rests, in the directions of its scatter."""
    noise, weights = linearised.noise, alone.step.told.weights
    (at_rest, of_rest), (in_turn, of_turn), after = noise.rest_directions, noise.turn_directions, alone.left
    found = []
    for group in GROUPS:
        places = [SCATTER.index(name) for name in (group.component, *BESIDE.get(group.component, ()))]
        if group.component in REST_MODES:
            own, W, Z, left = part.rests, weights.rest, at_rest[:, :, np.isin(of_rest, places)], after.rest
        else:
            own, W, Z, left = part.turns, weights.turn, in_turn[:, :, np.isin(of_turn, places)], after.turn
        found.append(SumOfSquares.along(W[own] @ Z[own], left[0][own], left[1][own]).chance)
    return found


def _scatter(group: Group, linearised: Linearised) -> float:
    """The scatter of a group, with that of the in-run bias."""
    components = linearised.components
    in_run = {"accel": components.accel_in_run, "gyro": components.gyro_in_run}.get(group.component, 0.0)
    return float(np.hypot(getattr(components, group.component), in_run))


def _noise(group: Group, observations: Observations) -> float:
    rests, turns = observations.rests, observations.turns
    covariances = {"accel": rests.accel_covariance, "gyro": rests.gyro_covariance}
    if turns is not None:
        covariances |= {"turn": turns.covariance, "velocity": turns.velocity_covariance}
    return _typical(covariances[group.component])


def _typical(covariance: Array) -> float:
    return float(np.sqrt(np.median(np.trace(covariance, axis1=1, axis2=2) / covariance.shape[1])))


def _said(group: Group, ratio: float, linearised: Linearised) -> str:
    size, unit = group.unit
    said = f"{_scatter(group, linearised) / size:.2g} {unit}".replace(" °", "°")
    return f"{said}, {ratio:.2g} times their noise"


def _larger(group: Group, ratio: float, linearised: Linearised) -> str:
    turns = linearised.problem.observations.turns
    if group.component == "turn" and turns is not None:
        largest = linearised.components.aliased * float(np.sqrt(turns.aliased.max()))
        if largest > linearised.components.turn:
            return _aliased(largest, linearised)
    if _scatter(group, linearised) == 0.0:
        return f"the {group.words} are further from the fit than their noise explains"
    said = f"the {group.words} scatter by {_said(group, ratio, linearised)}"
    if ratio > MANY and _scatter(group, linearised) > NOTHING.get(group.component, np.inf):
        said += f", more than {MANY:.0f}: something is there that the model does not have"
        if group.component == "turn":
            said += f"; look for lost or held samples{jittering(linearised.problem.observations)}"
    return f"{said}{AT_RANDOM}"


def _aliased(largest: float, linearised: Linearised) -> str:
    return (
        f"the rotations of the turns err by up to about {largest / DEGREE:.2g}° where rates jump from sample to "
        f"sample, as instantaneous samples of jerky turns do{CONTAINED}; turn smoothly, or sample faster"
        + jittering(linearised.problem.observations)
    )


def lost_by_velocities(linear: Linearised, observations: Observations) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """The turn that lacks samples, as a reason, or where it does little harm as a remark, where an estimate of all
    groups of parameters shows it: the velocities of turns, which the linear model does without, tell more of it than
    their rotations. That estimate is made where the noise alone does not explain the velocities about the linear
    one."""
    if _standing_loss(with_all_groups(linear, observations)) is None:
        return (), ()
    whole = joint(observations).linearised
    assert whole is not None
    found = _standing_loss(whole)
    if found is None:
        return (), ()
    return ((_damaging(found),), ()) if found.damage > DAMAGE else ((), (f"probable cause: {found.sentence}",))


def _standing_loss(linearised: Linearised) -> Cause | None:
    """The turn that lacks samples most likely, where it stands out."""
    session = LinearisedSession(linearised)
    if not session.turned:
        return None
    whole = Remaining.of(linearised, linearised.components)
    found = [cause for own in tested(linearised, list(lost_in_a_turn(session, whole)))[0] for cause in own]
    return next((cause for cause in found if cause.probability <= standing_out([cause.probability])), None)


def _damaging(cause: Cause) -> str:
    return f"{cause.sentence}; without it parameters err by up to {cause.damage:.2g} times their u"


def _untold(lost: Cause, observations: Observations) -> Cause:
    """Lost samples of which the turns say nothing by how they err."""
    return replace(
        lost,
        sentence="or samples that are missing or held in the log, which these turns do not tell from movement: "
        + stamps_remedy(observations),
    )


def _movement() -> Cause:
    """The turns scatter more than the gyros at rest."""
    return Cause(
        name="movement",
        concerns="gyro",
        probability=1.0,
        damage=0.0,
        sentence="a device that moved after it was put down, or before it was taken up: wait until it lies still",
    )
