"""What may be behind residuals that the noise does not explain, of each session the most likely first.

A candidate is columns of the rows of rests and turns per unit of its size, with a place among WORDING for what is said
of it: `candidates_of` is the list of them. All are tested at the linearisation of the estimate, without solving again
(`tumble.diagnosis.projection`). A fall of chi-square Δχ² is judged as chi-square of q degrees of freedom by the noise
alone, and by F = (Δχ²/q) / ((χ² − Δχ²)/(ν − q)) with the components of variance of the estimate too: of few degrees of
freedom a scatter may be had by chance, and what is left beside a cause be nothing. What drifts or settles is no
candidate: it is in the processes of the biases and in the groups that go with time, whose sizes are estimated
(`tumble.diagnosis.misfit`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from tumble.diagnosis.linearised_session import (
    PATH_STEPS,
    SHORTEST_TURN,
    UNITS,
    WORDS,
    Concerns,
    LinearisedSession,
    sized,
)
from tumble.diagnosis.projection import FALSE_ALARMS, Projection, falls_by_place, projections
from tumble.earth import earth_rate
from tumble.inference.integrated_turns import IntegratedTurns
from tumble.inference.linearisation import Linearisation, linearise
from tumble.inference.noise import VarianceComponents
from tumble.inference.normal_equations import Solution
from tumble.rotation import skew
from tumble.sensors.instrument import functions
from tumble.sensors.model import Block
from tumble.sensors.parameters import PAIRS, PRODUCTS, RATE, group_name, positions_by_group
from tumble.units import DEGREE, G_STANDARD, Array, IntArray, two_digits

MEMORIES = (10.0, 60.0, 300.0)
"""Time constants of a memory that are tried, s."""
PLAY = 0.05 * G_STANDARD
"""Half the width of the play of a hysteresis: a change of the own force by twice as much takes it across."""
EARTH_SEEN = 0.03
"""Relative standard uncertainty of the Earth's rate, and rad of the latitude: gyros that know them no better hardly see
the headings, and these are not linear then."""
FEWEST_BESIDE = 2
"""Rests on either side of a jump: one alone with another bias is a rest that does not fit."""
SHIFTS = 7
"""Places of a session at which gyros are tried that turn against the accelerometers: one that shifts between two of
them is seen by either."""
COARSE = 0.5
"""What rounding does to the mean of a rest, in parts of its noise, from which on it is a cause."""

_APART = "calibrate what is before and what is after as launches"
_PRODUCTS = (
    2,
    "{sensors} that read products of forces, by {size}: more oblique rests, or use it near the attitudes of the "
    "session",
)
WORDING: Mapping[str, tuple[tuple[float, str] | int, str]] = {
    "jump": (
        0,
        "biases of the {sensors} jump by {size} after {0}, as of a driver that measures them anew or of another "
        f"device: {_APART}, each with the times of the other in [[exclude]]",
    ),
    "shift": (
        (DEGREE, "°"),
        "the gyros turn against the accelerometers by {size} about {0} s, as on a board that is loose: fasten it, and "
        f"{_APART}",
    ),
    "hysteresis": (
        0,
        "hysteresis of the accelerometers of {size}, by the sign of the last change of the own force: come to each "
        "position from both sides",
    ),
    "memory": (
        1,
        "{sensors} that remember the previous attitude by {size} for about {0} s: longer rests, of which the beginning "
        "is left out",
    ),
    "cross products": _PRODUCTS,
    "g² sensitivity": _PRODUCTS,
    "gyro nonlinearity": (
        (1e-6 / (10.0 * DEGREE) ** 2, "ppm at 10 °/s"),
        "scale factors of the gyros that depend on the rate, by {size}: turn at the rates of use, at one rate, or make "
        "them parameters by gyro_cubic in [device.prior]",
    ),
    "latitude": (
        (DEGREE, "°"),
        "a latitude that the gyros contradict by {size}: look at latitude_deg in [site], and its sign",
    ),
    "clock": (
        (1e-2, "%"),
        "a clock of the log that the Earth's rate contradicts by {size}: look at rate_hz, or the time column and its "
        "unit, in [log]",
    ),
    "lost samples": (
        (DEGREE, "°"),
        "{0} errs about its own axis by {size}: samples are missing or held there; leave it out by turn = {1} in "
        "[[exclude]], and record with time stamps",
    ),
}
"""Of each candidate the unit (SI, name) of its size, or a power of g by which that of biases is divided, and what is
said of `sensors` by its `size` and place."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Cause:
    """A candidate cause as a session sees it: its `name`, which sensors it `concerns`, the `probability` that chance
    alone shows as much, by how much the parameters of each group of the linear model err without it at most, in their
    u, and a `sentence` with size and remedy."""

    name: str
    concerns: Concerns
    probability: float = 0.0
    by_group: Mapping[str, float] = field(default_factory=dict)
    sentence: str
    rivals: tuple[str, ...] = ()
    """Names of causes that the session does not tell from it."""

    @property
    def damage(self) -> float:
        """By how much any parameter errs, in its u."""
        return max(self.by_group.values(), default=0.0)

    @property
    def concerned(self) -> tuple[str, ...]:
        """The kind of sensor it concerns, none where both."""
        return () if self.concerns == "both" else (self.concerns,)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Candidate:
    """Columns of the rows of rests (N, r, q) and of turns (K, t, q) of a candidate, per SI unit of its size."""

    name: str
    concerns: Concerns
    columns: tuple[Array, Array]
    places: Sequence[Sequence[str]] = ((),)
    """Where, in words for what is said, one or that of each session."""
    known: float = np.inf
    """A session that knows the size to no better, SI, says nothing of it."""
    tried: int = 1
    """Of how many places it is the most likely."""
    direct: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """By how much one of its size changes parameters of groups beside what the rows show, and their standard
    uncertainty for it."""

    def sentence(self, s: int, size: float) -> str:
        """What is said of it in session s."""
        unit, words = WORDING[self.name]
        if isinstance(unit, int):
            one, name = UNITS[self.concerns]
            unit = one / G_STANDARD**unit, f"{name}/g{'' if unit == 1 else '²'}" if unit else name
        place = self.places[min(s, len(self.places) - 1)]
        return words.format(*place, size=sized(size, unit), sensors=WORDS.get(self.concerns, ""))


def tested(linearised: Linearisation, candidates: Sequence[Candidate]) -> list[list[Cause]]:
    """Of each session the candidates that it sees, of each name and kind of sensor the most likely with its probability
    as that of one of many: no more likely than by the noise alone, or by the components of variance of the estimate."""
    rest, turn = (np.concatenate([c.columns[rows] for c in candidates], axis=2) for rows in (0, 1))
    ends = np.cumsum([c.columns[0].shape[2] for c in candidates])
    columns = [np.arange(end - c.columns[0].shape[2], end) for c, end in zip(candidates, ends.tolist(), strict=True)]
    instrument = linearised.problem.instrument
    groups = positions_by_group(instrument.names[: instrument.linear_count])
    whole = list(projections(linearised, linearised.components, rest, turn))
    alone = projections(linearised, VarianceComponents(), rest, turn) if whole[0].scatters else whole
    tried = dict[tuple[str, Concerns], int]()
    for c in candidates:
        tried[c.name, c.concerns] = tried.get((c.name, c.concerns), 0) + c.tried
    by_session = []
    for s, (by_noise, by_all) in enumerate(zip(alone, whole, strict=True)):
        best = dict[tuple[str, Concerns], tuple[Cause, IntArray]]()
        for c, some in zip(candidates, columns, strict=True):
            by_one, explained = by_noise.explained(some, c.known), by_all.explained(some)
            if by_one is None or explained is None:
                continue
            chance = max(by_noise.chance(by_one.fall, by_one.q), by_all.chance(explained.fall, explained.q))
            chance = min(1.0, tried[c.name, c.concerns] * chance)
            if (c.name, c.concerns) in best and best[c.name, c.concerns][0].probability <= chance:
                continue
            moved, variance = explained.moved.copy(), by_all.u**2
            for group, (change, u) in c.direct.items():
                moved[groups[group]] -= change * explained.values[0]
                variance[groups[group]] += u**2
            damage = np.abs(moved) / np.sqrt(variance)
            cause = Cause(
                name=c.name,
                concerns=c.concerns,
                probability=chance,
                by_group={group: float(damage[members].max()) for group, members in groups.items()},
                sentence=c.sentence(s, float(np.abs(explained.values).max())),
            )
            best[c.name, c.concerns] = cause, some
        by_session.append(_told_apart(list(best.values()), by_all))
    return by_session


def _told_apart(found: list[tuple[Cause, IntArray]], whole: Projection) -> list[Cause]:
    """The causes, with their columns, beside the likeliest one, if that stands out, which comes first then. The others
    are as likely as they are beside it; those beside which it explains nothing more are its rivals, and are said with
    it."""
    causes = [cause for cause, _ in found]
    if not causes or min(cause.probability for cause in causes) > FALSE_ALARMS:
        return causes
    best, first = min(found, key=lambda each: each[0].probability)
    alone, out = whole.explained(first), list[Cause]()
    assert alone is not None
    for cause, own in found:
        both, other = whole.explained(np.concatenate([first, own])), whole.explained(own)
        if own is first or both is None or other is None:
            continue
        chance, instead = (
            whole.chance(both.fall - before.fall, both.q - before.q, (before.fall, before.q))
            if both.q > before.q
            else 1.0
            for before in (alone, other)
        )
        if min(chance, instead) > FALSE_ALARMS:
            damages = {name: max(size, cause.by_group[name]) for name, size in best.by_group.items()}
            sentence = f"{best.sentence}; or, which the session does not tell apart: {cause.sentence}"
            best = replace(best, sentence=sentence, by_group=damages, rivals=(*best.rivals, cause.name))
        out.append(replace(cause, probability=max(cause.probability, chance)))
    return [best, *out]


def candidates_of(session: LinearisedSession, alone: Solution) -> Iterator[Candidate]:
    """Everything that is tried by columns, but for lost samples (`tumble.diagnosis.lost_samples`); `alone` is what the
    noise within rests leaves of residuals."""
    about, gyro = session.linearised.about, session.observations.gyro_block
    yield from jumps(session, alone)
    played = session.biased("accel", *_followed_along(session, session.accel, _played, np.ones(())))
    yield Candidate(name="hysteresis", concerns="accel", columns=played)
    for kind, block in session.kinds:
        memories = zip(MEMORIES, *_followed_along(session, block, followed, np.array(MEMORIES)), strict=True)
        for memory, *columns in memories:
            slow = session.biased(kind, *columns)
            yield Candidate(name="memory", concerns=kind, columns=slow, places=[[f"{memory:.0f}"]])
    yield from products(session)
    if any(session.turned) and about is not None and gyro is not None:
        yield from shifts(session, about, gyro)
        if "gyro.cubic" not in session.problem.instrument.members:
            yield gyro_nonlinearity(session, about, gyro)
    if gyro is not None and session.observations.site.latitude is not None:
        yield from earth_rate_errors(session)


def jumps(session: LinearisedSession, alone: Solution) -> Iterator[Candidate]:
    """Biases of a kind of sensors that change between two rests, as where a driver measures them anew or another device
    goes on, about their means over the rests, which are the parameters; the turn between is taken as lying half before
    and half after it. They do so where that explains most of what the noise within rests leaves."""
    rests, parts = session.observations.rests, session.problem.parts
    turns = len(session.problem.before_turn)
    for kind, block in session.kinds:
        alike = np.ones((len(rests), block.size)), np.ones((turns, PATH_STEPS, block.size))
        bias = alone.equations.rest_whitening @ session.biased(kind, *alike)[0]
        after, in_turn, places = np.zeros(len(rests)), np.zeros(turns), list[list[str]]()
        for part in parts:
            lasts = np.arange(part.rests.start + FEWEST_BESIDE - 1, part.rests.stop - FEWEST_BESIDE)
            later = (np.arange(part.rests.start, part.rests.stop) > lasts[:, None]).astype(float)
            about_mean = later - later.mean(axis=1, keepdims=True)
            residual, covariance = (each[part.rests] for each in alone.rest_residuals)
            falls = falls_by_place(about_mean, bias[part.rests], residual, covariance)
            places.append([""])
            if not falls.any():
                continue
            last = int(lasts[np.argmax(falls)])
            since, in_turn[part.turns] = session.since(last, part)
            after[part.rests] = since - since.mean()
            in_turn[part.turns] -= since.mean()
            named = session.observations.rest_named(last).rpartition(": ")[2]
            places[-1] = [f"{named} ({rests.start[last]:z.1f}–{rests.stop[last]:z.1f} s)"]
        columns = session.biased(kind, after[:, None] * alike[0], in_turn[:, None, None] * alike[1])
        tried = max(1, max(part.rests.stop - part.rests.start for part in parts) - 2 * FEWEST_BESIDE + 1)
        yield Candidate(name="jump", concerns=kind, columns=columns, places=places, tried=tried)


def shifts(session: LinearisedSession, about: IntegratedTurns, gyro: Block) -> Iterator[Candidate]:
    """Gyros that turn against the accelerometers by a small angle δ between two rests, as on a board that is loose, at
    SHIFTS places of each session: ∂K/∂δ of a gyro of the axis a is a × δ, in the rates of what comes after."""
    rests, n = session.observations.rests, session.accel.size
    change = skew(gyro.axes)  # (n, 3, 3): a × e_j, by the components of the rate
    rest, turn = session.nothing(3)
    rest[:, n : n + gyro.size] = np.einsum("nb,pbj->npj", session.rate, change)
    turn[:, :3], velocity = (
        np.einsum("kipb,pbj->kij", by[..., RATE], change) for by in (about.by_phi, about.by_velocity)
    )
    session.put_velocity(turn, velocity)
    for place in range(1, SHIFTS + 1):
        at_rest, in_turn, places = np.zeros(len(rest)), np.zeros(len(turn)), list[list[str]]()
        for part in session.problem.parts:
            last = part.rests.start + (part.rests.stop - part.rests.start) * place // (SHIFTS + 1)
            at_rest[part.rests], in_turn[part.turns] = session.since(last, part)
            places.append([f"{rests.stop[last]:z.0f}"])
        columns = rest * at_rest[:, None, None], turn * in_turn[:, None, None]
        yield Candidate(name="shift", concerns="gyro", columns=columns, places=places)


# ---- readings that depend on where the sensors come from


def _followed_along(
    session: LinearisedSession, block: Block, follow: Callable[[Array, Array, Array], tuple[Array, Array]], units: Array
) -> tuple[Array, Array]:
    """What states of every sensor of a block, carried from rest to rest, do to its readings: at rest (..., N, n) and in
    the steps of the turns (..., K, steps, n). `follow(states (..., n), own forces (steps, n), times of a step (...))`,
    times being in `units` (...), s, has that and the states after the steps; the first rest of a session begins at its
    own force."""
    rests, turns, link = session.observations.rests, session.observations.turns, session.problem.link
    own, paths = session.force @ block.axes.T, session.paths @ block.axes.T
    at_rest, in_turn = np.zeros((*units.shape, *own.shape)), np.zeros((*units.shape, *paths.shape))
    state = np.zeros((*units.shape, block.size))
    for i, here in enumerate(own):
        if i == 0 or i in session.begins:
            state = np.broadcast_to(here, state.shape)
        at_rest[..., i : i + 1, :], state = follow(state, here[None], (rests.stop[i] - rests.start[i]) / units)
        if (k := link[i]) >= 0 and turns is not None:
            in_turn[..., k, :, :], state = follow(state, paths[k], turns.duration[k] / PATH_STEPS / units)
    return at_rest, in_turn


def _played(middle: Array, targets: Array, _: Array) -> tuple[Array, Array]:
    """Where in their play, −1 … 1, the own forces (steps, n) are, and the middle of the play after them."""
    middles = np.empty_like(targets)
    for j, (low, high) in enumerate(zip(targets - PLAY, targets + PLAY, strict=True)):
        middles[j] = middle = np.minimum(np.maximum(middle, low), high)
    return (targets - middles) / PLAY, middle


def followed(slow: Array, targets: Array, passed: Array) -> tuple[Array, Array]:
    """The means (..., steps, n) of slow − target over steps of a time, in time constants (...), with a target (n,)
    each, and slow (..., n) after them: slow_j+1 = target_j + (slow_j − target_j) e^(−t)."""
    steps, t = len(targets), passed[..., None, None]
    left = np.exp(-passed[..., None] * np.arange(steps + 1))  # after so many steps
    lag = np.arange(steps + 1)[:, None] - np.arange(steps)  # from the end of each step
    weight = np.where(lag > 0, left[..., np.maximum(lag - 1, 0)], 0.0)
    before = left[..., None] * slow[..., None, :] - np.expm1(-t) * (weight @ targets)
    mean = np.where(t > 0.0, -np.expm1(-t) / np.where(t > 0.0, t, 1.0), 1.0)  # of e^(−t) over a step
    return (before[..., :-1, :] - targets) * mean, before[..., -1, :]


# ---- readings that are not linear in force and rate, and the place


def products(session: LinearisedSession) -> Iterator[Candidate]:
    """Products of forces that no group of the instrument has: cross products in accelerometers, all in gyros."""
    about = session.linearised.about
    for kind, block in session.kinds:
        accel, first = kind == "accel", 0 if kind == "accel" else session.accel.size
        chosen = [b for b, pair in enumerate(PAIRS, start=PRODUCTS.start) if pair[0] != pair[1] or not accel]
        beta = functions(block, session.force, session.rate)[:, 0, chosen]
        n, q = block.size, block.size * len(chosen)
        rest, turn = session.nothing(q)
        rest[:, first : first + n] = np.einsum("nb,ps->npsb", beta, np.eye(n)).reshape(len(rest), n, q)
        if about is not None and accel:
            session.put_velocity(turn, about.by_force[..., chosen].reshape(len(turn), 3, q))
        elif about is not None:
            turn[:, :3] = about.by_phi[..., chosen].reshape(len(turn), 3, q)
        yield Candidate(name="cross products" if accel else "g² sensitivity", concerns=kind, columns=(rest, turn))


def gyro_nonlinearity(session: LinearisedSession, about: IntegratedTurns, gyro: Block) -> Candidate:
    """Scale factors with the square of the rate, of an estimate that has no such parameters."""
    duration = np.maximum(about.moments.T, SHORTEST_TURN)[:, None]
    square = about.moments.body_rates[:, [0, 3, 5]] / duration @ (gyro.axes**2).T
    rest, turn = session.nothing(gyro.size)
    turn[:, :3], velocity = (
        np.einsum("kipb,pb,kp->kip", by[..., RATE], gyro.axes, square) for by in (about.by_phi, about.by_velocity)
    )
    session.put_velocity(turn, velocity)
    return Candidate(name="gyro nonlinearity", concerns="gyro", columns=(rest, turn))


def earth_rate_errors(session: LinearisedSession) -> Iterator[Candidate]:
    """An error of the latitude of the site, rad, and a relative one of the clock of the log, each by a difference.

    Of a log of which a second lasts 1 + ε seconds, turns are larger by ε than the gyros say, as by their scale factors;
    levers and delays in its seconds explain the velocities as well. What is left is the Earth's rate, which is
    (1 + ε) Ω in its seconds."""
    step, latitude, rows = 1e-4, session.observations.site.latitude, session.linearised
    assert latitude is not None
    by_clock = {name: size for name, size in session.observations.by_clock.items() if name == group_name(name)}
    u = max(map(abs, by_clock.values()), default=1.0)
    direct = {group: (size / u, size) for group, size in by_clock.items()}
    for name, earth in (("latitude", earth_rate(latitude + step)), ("clock", (1.0 + step) * session.problem.earth)):
        there = linearise(replace(session.problem, earth=np.array(earth)), rows.point, rows.about)
        rest, turn = ((a - b)[..., None] / step for a, b in zip(rows.residuals, there.residuals, strict=True))
        yield Candidate(
            name=name,
            concerns="both",
            columns=(rest, turn),
            known=EARTH_SEEN,
            direct=direct if name == "clock" else {},
        )


def quantisation(session: LinearisedSession, s: int) -> Iterator[Cause]:
    """Channels of session s whose steps the noise does not cover, where what rounding does to a mean is not small
    beside its noise."""
    rests = session.problem.parts[s].rests
    for kind, _ in session.kinds:
        rounding = session.observations.rounding.get(kind)
        if rounding is None or not rounding.common_u.any():
            continue
        covariance = getattr(session.observations.rests, f"{kind}_covariance")[rests]
        variance = np.median(np.diagonal(covariance, axis1=1, axis2=2), axis=0) - rounding.of_rest**2
        coarse = rounding.common_u > COARSE * np.sqrt(np.maximum(variance, 0.0))
        if coarse.any():
            worst = int(np.argmax(np.where(coarse, rounding.common_u, 0.0)))
            step, error = float(rounding.step[worst]), float(rounding.common_u[worst])
            scale, unit = UNITS[kind]
            yield Cause(
                name="quantisation",
                concerns=kind,
                sentence=f"steps of the {WORDS[kind]} of {two_digits(step / scale)} {unit}, which the noise, "
                f"{two_digits(rounding.noise[worst] / step)} of a step, does not cover: the mean of a rest errs by up "
                f"to {two_digits(error / scale)} {unit}; log with more digits, or use a smaller range",
            )
