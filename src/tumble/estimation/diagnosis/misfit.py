"""Residuals that the noise does not explain: how likely by chance, how large, what is behind them, and what follows.

An estimate is accepted with scatter where a group of residuals is larger than the noise within rests explains, or where
a cause stands out (`tumble.estimation.causes`); all tests together give a false alarm in less than one of a hundred
clean sessions. It is not accepted where its uncertainty cannot be trusted: where the scatter is many times the noise,
for then it is no small disturbance of a known model; and where a cause that stands out, being left out, moves one of
the 21 parameters by more than DAMAGE of its u, for then the error is not random.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from tumble.inference.by_session import each_session
from tumble.estimation.causes.cause import UNITS, WORDS, Cause, Concerns
from tumble.estimation.causes.chances import variance_chance
from tumble.estimation.causes.lost_samples import jittering, lost_in_a_turn, stamps_remedy, with_all_groups
from tumble.estimation.causes.neighbouring_rests import Neighbours, neighbours
from tumble.estimation.causes.projection import Projection
from tumble.estimation.causes.ranking import causes
from tumble.inference.hyperparameters import COMPONENTS, Scatter
from tumble.estimation.estimate import Estimate
from tumble.inference.likelihood import Linearised
from tumble.inference.joint import joint
from tumble.reduction.observations import Observations
from tumble.units import DEGREE, DEGREE_PER_HOUR, G_STANDARD, Array

GROUP_PROBABILITY = 1e-3
"""A group of residuals is larger than its noise where chance alone would make it so less often: one of four."""

CAUSE_PROBABILITY = 1e-4
"""A cause stands out where chance alone would show as much less often: one of about sixteen."""

NAMED_PROBABILITY = 0.02
"""A cause is named for scatter that is there where chance alone would show as much less often."""

MOST_NAMED = 3
MOST_SESSIONS = 5
"""Of several sessions, so many at most are described one by one."""

MANY = 30.0
"""Times the noise: a larger scatter is no disturbance of a model that otherwise holds."""

NOTHING = {"accel": 5e-6 * G_STANDARD, "gyro": 0.02 * DEGREE_PER_HOUR, "turn": 2e-5}
"""m/s², rad/s, rad: scatter that no use of an inertial unit would notice, however small the noise of the log."""

LOST_PROBABILITY = 0.05
"""With less, turns that scatter by themselves lack samples sooner than that the device moved."""

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


def misfit(estimate: Estimate, observations: Observations) -> Misfit | None:
    """What the residuals of an estimate say, of several sessions each for itself; None where nothing keeps a likelihood
    of it."""
    linearised = estimate.linearised
    if linearised is None:
        return None
    if observations.together is None:
        alone = _of_session(next(each_session(linearised)))
        return alone if estimate.method == "joint" else _about_joint(alone)
    names = observations.together.names
    found = [_of_session(each, share=1.0 / len(names)) for each in each_session(linearised)]
    return _of_all([(name, each) for name, each in zip(names, found, strict=True) if each.remarks or each.reasons])


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


def _of_session(linearised: Linearised, share: float = 1.0) -> Misfit:
    """What the residuals of a session say, which has this share of the false alarms."""
    observations, limit = linearised.problem.observations, share * CAUSE_PROBABILITY
    scatter = linearised.scatter  # that of sensors which are named is part of the noise
    alone = Projection(
        linearised, Scatter(accel_wandering=scatter.accel_wandering, gyro_wandering=scatter.gyro_wandering)
    )
    chances = group_chances(linearised, alone)
    larger = [group for group, chance in zip(GROUPS, chances, strict=True) if chance < share * GROUP_PROBABILITY]
    scatters = bool(np.any(scatter.variances > 0.0))
    projection = Projection(linearised, scatter) if scatters else alone
    alike = tuple(neighbours(linearised, projection))
    found = causes(linearised, (alone, projection), alike)
    named = [cause for cause in found if cause.probability < limit]
    ratios = {group.component: _ratio(group, linearised, observations) for group in larger}
    if larger:
        others = [cause for cause in found if cause.probability >= limit]
        named += _likely(others, ratios, {group.concerns for group in larger}, observations)
    named = named[:MOST_NAMED]
    reasons = [
        _too_large(group, ratios[group.component], linearised) for group in larger if _many(group, ratios, linearised)
    ]
    wandering = list(_wandering(linearised, observations))
    reasons += [
        (concerns, f"{said}, more than {MANY:.0f} times the noise") for concerns, said, many in wandering if many
    ]
    reasons += [(c.concerns, _damaging(c)) for c in named if c.damage > DAMAGE and c.probability < limit]
    remarks = list(_settled(linearised))
    remarks += [(group.concerns, _larger(group, ratios[group.component], linearised)) for group in larger]
    remarks += [(concerns, f"{said}{CONTAINED}") for concerns, said, many in wandering if not many]
    remarks += list(_alike(alike))
    remarks += [(cause.concerns, f"probable cause: {cause.sentence}") for cause in named]
    warm = ("warm-up",) if observations.warm_up is not None else ()
    return Misfit(reasons=tuple(reasons), remarks=tuple(remarks), causes=(*warm, *(cause.name for cause in named)))


def _settled(linearised: Linearised) -> Iterator[tuple[Concerns, str]]:
    """What settles after the start, where the estimate has it."""
    own, settling = linearised.problem.own, linearised.problem.observations.warm_up
    if own is None or settling is None:
        return
    first, values = own.linear_count, linearised.point.own[0]
    said = list[str]()
    for kind, words in WORDS.items():
        size, unit = UNITS[kind]
        found = [own.members[name] for name in (f"{kind}.bias.warmup", f"{kind}.bias.warmup2") if name in own.members]
        if found:
            settled = sum(values[members.start - first : members.stop - first] for members in found)
            largest = np.abs(settled).max() / size
            said.append(f"of the {words} {'' if said else 'settle '}by up to {largest:.2g} {unit}".replace(" °", "°"))
    yield (
        "both",
        f"warm-up after power-on: biases {' and '.join(said)}, with a time constant of {settling:.0f} s; "
        "parameters are those of the settled device and u contains what is not known of it; switch on earlier",
    )


def _wandering(linearised: Linearised, observations: Observations) -> Iterator[tuple[Concerns, str, bool]]:
    """The sensors that wander more than the others of their kind, where the estimate has such, and whether
    they do so beyond use."""
    problem, first = linearised.problem, 0
    for block, group in zip(problem.instrument.blocks, GROUPS, strict=False):
        own = [block.sensors[c - first] for c in problem.wandering if first <= c < first + block.size]
        first += block.size
        if own:
            (size, unit), names = group.unit, ", ".join(f"{block.kind}.bias.{sensor}" for sensor in own)
            by, others = getattr(linearised.scatter, f"{block.kind}_wandering"), _scatter(group, linearised)
            said = f"{names} wander{'s' if len(own) == 1 else ''} from rest to rest by {by / size:.2g} {unit}"
            said += f", those of the other {WORDS[block.kind]} by {others / size:.2g} {unit}"
            many = by > max(MANY * _noise(group, observations), NOTHING[block.kind])
            yield group.concerns, said.replace(" °", "°"), many


def _alike(alike: Iterable[Neighbours]) -> Iterator[tuple[Concerns, str]]:
    """The kinds of sensors whose biases are alike in neighbouring rests."""
    for each in alike:
        if (correlation := each.alone) > 0.0:
            yield (
                each.kind,
                f"biases of the {WORDS[each.kind]} are alike in neighbouring rests, by a correlation of "
                f"{correlation:.2f}: an instability that lasts longer than a rest{CONTAINED}",
            )


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
    lost = [c for c in likely if c.name == "lost samples"]
    untold = lost and lost[0].probability > LOST_PROBABILITY
    random = [_movement(), *(_untold(c, observations) for c in lost)] if untold else [*lost, _movement()]
    return random + [c for c in standing if c not in lost]


def group_chances(linearised: Linearised, alone: Projection) -> list[float]:
    """Probability, by group, that chance alone makes residuals as large, by the projection with the noise within rests
    alone, and the scatter of sensors that wander."""
    noise = linearised.noise
    (rest, of_rest), (merged, of_merged), r = noise.rest_directions, noise.merged_directions, noise.rest.shape[1]
    found = []
    for group in GROUPS:
        places = [COMPONENTS.index(name) for name in (group.component, *BESIDE.get(group.component, ()))]
        of = np.isin(of_rest, places), np.isin(of_merged, places)
        found.append(variance_chance(alone, rest[:, :, of[0]], merged[:, r:, of[1]]))
    return found


def _scatter(group: Group, linearised: Linearised) -> float:
    return float(getattr(linearised.scatter, group.component))


def _ratio(group: Group, linearised: Linearised, observations: Observations) -> float:
    """The scatter of a group in parts of its noise."""
    return _scatter(group, linearised) / _noise(group, observations)


def _noise(group: Group, observations: Observations) -> float:
    rests, turns = observations.rests, observations.turns
    covariances = {"accel": rests.accel_covariance, "gyro": rests.gyro_covariance}
    if turns is not None:
        covariances |= {"turn": turns.covariance, "velocity": turns.velocity_covariance}
    return _typical(covariances[group.component])


def _typical(covariance: Array) -> float:
    return float(np.sqrt(np.median(np.trace(covariance, axis1=1, axis2=2) / covariance.shape[1])))


def _many(group: Group, ratios: dict[str, float], linearised: Linearised) -> bool:
    """Whether a group scatters beyond use. Velocities may: they carry little of what is estimated."""
    floor = NOTHING.get(group.component, np.inf)
    return ratios[group.component] > MANY and _scatter(group, linearised) > floor


def _said(group: Group, ratio: float, linearised: Linearised) -> str:
    size, unit = group.unit
    said = f"{_scatter(group, linearised) / size:.2g} {unit}".replace(" °", "°")
    return f"{said}, {ratio:.2g} times their noise"


def _larger(group: Group, ratio: float, linearised: Linearised) -> str:
    if group.component == "turn" and linearised.scatter.aliased > 0.0:
        return _aliased(linearised)
    if _scatter(group, linearised) == 0.0:
        return f"the {group.words} are further from the fit than their noise explains"
    return f"the {group.words} scatter by {_said(group, ratio, linearised)}{AT_RANDOM}"


def _aliased(linearised: Linearised) -> str:
    turns = linearised.problem.observations.turns
    assert turns is not None
    largest = linearised.scatter.aliased * float(np.sqrt(turns.aliased.max())) / DEGREE
    return (
        f"the rotations of the turns err by up to about {largest:.2g}° where rates jump from sample to sample, as "
        f"instantaneous samples of jerky turns do{CONTAINED}; turn smoothly, or sample faster"
        + jittering(linearised.problem.observations)
    )


def _too_large(group: Group, ratio: float, linearised: Linearised) -> tuple[Concerns, str]:
    observations = linearised.problem.observations
    return (
        group.concerns,
        f"the {group.words} scatter by {_said(group, ratio, linearised)}, more than {MANY:.0f}: something is there "
        "that the model does not have"
        + (f"; look for lost or held samples{jittering(observations)}" if group.component == "turn" else ""),
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
    found = _standing_loss(next(each_session(whole)))
    if found is None:
        return (), ()
    return ((_damaging(found),), ()) if found.damage > DAMAGE else ((), (f"probable cause: {found.sentence}",))


def _standing_loss(linearised: Linearised) -> Cause | None:
    """The turn that lacks samples most likely, where it stands out."""
    found = lost_in_a_turn(linearised, Projection(linearised, linearised.scatter))
    return found if found is not None and found.probability < CAUSE_PROBABILITY else None


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
