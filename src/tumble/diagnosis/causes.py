"""What may be behind residuals that the noise does not explain, of each session the most likely first.

A candidate is columns of the rows of rests and turns per unit of its size: `_candidates` is the table of them. All are
tested at the linearisation of the estimate, without solving again (`tumble.diagnosis.projection`). A fall of chi-square
Δχ² is judged as chi-square of q degrees of freedom by the noise alone, and by F = (Δχ²/q) / ((χ² − Δχ²)/(ν − q)) with
the components of variance of the estimate too: of few degrees of freedom a scatter may be had by chance, and what is
left beside a cause be nothing. What drifts or settles is no candidate: it is in the processes of the biases and in the
groups that go with time, whose sizes are estimated (`tumble.diagnosis.misfit`).
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
from tumble.diagnosis.projection import FALSE_ALARMS, Projection, judged_solution, projections
from tumble.earth import earth_rate
from tumble.inference.linearisation import Linearisation, linearise
from tumble.inference.noise import VarianceComponents
from tumble.inference.normal_equations import Solution
from tumble.inference.turns_about import TurnsAbout
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
FREE = 0.01
"""Of the variance of a step of a process: the data say nothing of one of which they leave more than 1 − FREE."""
SHIFTS = 7
"""Places of a session at which gyros are tried that turn against the accelerometers: one that shifts between two of
them is seen by either."""
COARSE = 0.5
"""What rounding does to the mean of a rest, in parts of its noise, from which on it is a cause."""


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
    """Columns of the rows of rests (N, r, q) and of turns (K, t, q) of a candidate, per SI unit of its size; sentences
    with a place for the size, one or that of each session, which is said in a `unit` (size in SI, name)."""

    name: str
    concerns: Concerns
    columns: tuple[Array, Array]
    unit: tuple[float, str]
    sentences: tuple[str, ...]
    known: float = np.inf
    """A session that knows the size to no better, SI, says nothing of it."""
    tried: int = 1
    """Of how many places it is the most likely."""
    direct: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """By how much one of its size changes parameters of groups beside what the rows show, and their standard
    uncertainty for it."""

    def tested(
        self, s: int, some: slice, alone: Projection, whole: Projection, groups: Mapping[str, list[int]]
    ) -> Cause | None:
        """The candidate in session s, its columns being `some` of those in the projections with the noise alone and
        with the components of variance of the estimate: it is no more likely than by either. None where the session
        does not see it."""
        by_noise, explained = alone.explained(some, self.known), whole.explained(some)
        if by_noise is None or explained is None:
            return None
        probability = alone.chance(by_noise.fall, by_noise.q)
        moved, variance = explained.moved.copy(), whole.u**2
        for group, (by_one, u) in self.direct.items():
            moved[groups[group]] -= by_one * explained.values[0]
            variance[groups[group]] += u**2
        damage = np.abs(moved) / np.sqrt(variance)
        return Cause(
            name=self.name,
            concerns=self.concerns,
            probability=max(probability, whole.chance(explained.fall, explained.q)),
            by_group={group: float(damage[members].max()) for group, members in groups.items()},
            sentence=self.sentences[min(s, len(self.sentences) - 1)].format(
                size=sized(float(np.abs(explained.values).max()), self.unit)
            ),
        )


def tested(linearised: Linearisation, candidates: Sequence[Candidate]) -> list[list[Cause]]:
    """Of each session the candidates that it sees, of each name and kind of sensor the most likely with its probability
    as that of one of many."""
    rest, turn = (np.concatenate([c.columns[rows] for c in candidates], axis=2) for rows in (0, 1))
    ends = np.cumsum([c.columns[0].shape[2] for c in candidates]).tolist()
    instrument = linearised.problem.instrument
    groups = positions_by_group(instrument.names[: instrument.linear_count])
    whole = list(projections(linearised, linearised.components, rest, turn))
    alone = projections(linearised, VarianceComponents(), rest, turn) if whole[0].scatters else whole
    tried = dict[tuple[str, Concerns], int]()
    for candidate in candidates:
        key = candidate.name, candidate.concerns
        tried[key] = tried.get(key, 0) + candidate.tried
    by_session = []
    for s, seen_by in enumerate(zip(alone, whole, strict=True)):
        best, columns = dict[tuple[str, Concerns], Cause](), dict[tuple[str, Concerns], IntArray]()
        for candidate, end in zip(candidates, ends, strict=True):
            key, some = (candidate.name, candidate.concerns), slice(end - candidate.columns[0].shape[2], end)
            cause = candidate.tested(s, some, *seen_by, groups)
            if cause is not None and (key not in best or cause.probability < best[key].probability):
                best[key], columns[key] = cause, np.arange(some.start, some.stop)
        likely = [replace(c, probability=min(1.0, tried[key] * c.probability)) for key, c in best.items()]
        by_session.append(_told_apart(likely, list(columns.values()), seen_by[1]))
    return by_session


def _told_apart(causes: list[Cause], columns: list[IntArray], whole: Projection) -> list[Cause]:
    """The causes beside the likeliest one, if that stands out, which comes first then. The others are as likely as they
    are beside it; those beside which it explains nothing more are its rivals, and are said with it."""
    if not causes or min(cause.probability for cause in causes) > FALSE_ALARMS:
        return causes
    first = min(range(len(causes)), key=lambda i: causes[i].probability)
    best, alone, out = causes[first], whole.explained(columns[first]), list[Cause]()
    assert alone is not None
    for cause, own in zip(causes, columns, strict=True):
        both = whole.explained(np.concatenate([columns[first], own]))
        if cause is causes[first] or both is None:
            continue
        other = whole.explained(own)
        assert other is not None
        chance, instead = (
            whole.chance(both.fall - first_in.fall, both.q - first_in.q, (first_in.fall, first_in.q))
            if both.q > first_in.q
            else 1.0
            for first_in in (alone, other)
        )
        if min(chance, instead) > FALSE_ALARMS:
            damages = {name: max(size, cause.by_group[name]) for name, size in best.by_group.items()}
            sentence = f"{best.sentence}; or, which the session does not tell apart: {cause.sentence}"
            best = replace(best, sentence=sentence, by_group=damages, rivals=(*best.rivals, cause.name))
        out.append(replace(cause, probability=max(cause.probability, chance)))
    return [best, *out]


def candidates_of(session: LinearisedSession) -> Iterator[Candidate]:
    """Everything that is tried by columns, but for lost samples (`tumble.diagnosis.lost_samples`)."""
    about, gyro = session.linearised.about, session.observations.gyro_block
    yield from jumps(session)
    yield Candidate(
        name="hysteresis",
        concerns="accel",
        columns=session.biased("accel", *_followed_along(session, session.accel, _played, np.ones(()))),
        unit=UNITS["accel"],
        sentences=(
            "hysteresis of the accelerometers of {size}, by the sign of the last change of the own force: come to each "
            "position from both sides",
        ),
    )
    for kind, block in session.kinds:
        for memory, *columns in zip(
            MEMORIES, *_followed_along(session, block, followed, np.array(MEMORIES)), strict=True
        ):
            size, unit = UNITS[kind]
            yield Candidate(
                name="memory",
                concerns=kind,
                columns=session.biased(kind, *columns),
                unit=(size / G_STANDARD, f"{unit}/g"),
                sentences=(
                    f"{WORDS[kind]} that remember the previous attitude by {{size}} for about {memory:.0f} s: longer "
                    "rests, of which the beginning is left out",
                ),
            )
    yield from products(session)
    if any(session.turned) and about is not None and gyro is not None:
        yield from shifts(session, about, gyro)
    modelled = "gyro.cubic" in session.problem.instrument.members
    if any(session.turned) and about is not None and gyro is not None and not modelled:
        yield gyro_nonlinearity(session, about, gyro)
    if gyro is not None and session.observations.site.latitude is not None:
        yield from earth_rate_errors(session)


def jumps(session: LinearisedSession) -> Iterator[Candidate]:
    """Biases of a kind of sensors that change between two rests, as where a driver measures them anew or another device
    goes on, about their means over the rests, which are the parameters; the turn between is taken as lying half before
    and half after it. They do so where their process, had it all scatter of the rests and lasted as long as the
    session, would step by the most beside its usual steps."""
    rests, before_turn, first = session.observations.rests, session.problem.before_turn, 0
    components, longest = session.linearised.components, max(float(np.ptp(rests.start)), 1.0)
    wandering = VarianceComponents(
        accel_in_run=float(np.hypot(components.accel, components.accel_in_run)),
        gyro_in_run=float(np.hypot(components.gyro, components.gyro_in_run)),
        accel_time=longest,
        gyro_time=longest,
    )
    if not wandering.wanders:
        return
    step = judged_solution(session.linearised, wandering)
    N, most = len(rests), max(part.rests.stop - part.rests.start for part in session.problem.parts)
    for kind, block in session.kinds:
        falls = _falls(step, slice(first, first + block.size))
        first += block.size
        after, in_turn, sentences = np.zeros(N), np.zeros(len(before_turn)), list[str]()
        for part in session.problem.parts:
            places = np.arange(part.rests.start + FEWEST_BESIDE - 1, part.rests.stop - FEWEST_BESIDE)
            if not len(places) or falls[places].max() <= 0.0:
                sentences.append("")
                continue
            last = int(places[np.argmax(falls[places])])
            after[part.rests], in_turn[part.turns] = session.since(last, part)
            share = float(after[part.rests].mean())
            after[part.rests] -= share
            in_turn[part.turns] -= share
            sentences.append(
                f"biases of the {WORDS[kind]} jump by {{size}} after "
                f"{session.observations.rest_named(last).rpartition(': ')[2]} "
                f"({rests.start[last]:z.1f}–{rests.stop[last]:z.1f} s), as of a driver that measures them anew or of "
                "another device: calibrate what is before and what is after as launches, each with the times of the "
                "other in [[exclude]]"
            )
        steps = np.ones((1, PATH_STEPS, block.size))
        yield Candidate(
            name="jump",
            concerns=kind,
            columns=session.biased(kind, np.outer(after, np.ones(block.size)), in_turn[:, None, None] * steps),
            unit=UNITS[kind],
            sentences=tuple(sentences),
            tried=max(1, most - 2 * FEWEST_BESIDE + 1),
        )


def shifts(session: LinearisedSession, about: TurnsAbout, gyro: Block) -> Iterator[Candidate]:
    """Gyros that turn against the accelerometers by a small angle δ between two rests, as on a board that is loose, at
    SHIFTS places of each session: ∂K/∂δ of a gyro of the axis a is a × δ, in the rates of what comes after."""
    rests, before_turn, n = session.observations.rests, session.problem.before_turn, session.accel.size
    change = skew(gyro.axes)  # (n, 3, 3): a × e_j, by the components of the rate
    whole_rest, whole_turn = session.nothing(3)
    whole_rest[:, n : n + gyro.size] = np.einsum("nb,pbj->npj", session.rate, change)
    by_phi, by_velocity = (
        np.einsum("kipb,pbj->kij", by[..., RATE], change) for by in (about.by_phi, about.by_velocity)
    )
    whole_turn[:, :3] = by_phi
    session.put_velocity(whole_turn, by_velocity)
    for place in range(1, SHIFTS + 1):
        at_rest, in_turn, sentences = np.zeros(len(rests)), np.zeros(len(before_turn)), list[str]()
        for part in session.problem.parts:
            last = part.rests.start + (part.rests.stop - part.rests.start) * place // (SHIFTS + 1)
            at_rest[part.rests], in_turn[part.turns] = session.since(last, part)
            sentences.append(
                f"the gyros turn against the accelerometers by {{size}} about {rests.stop[last]:z.0f} s, as on a board "
                "that is loose: fasten it, and calibrate what is before and what is after as launches"
            )
        yield Candidate(
            name="shift",
            concerns="gyro",
            columns=(whole_rest * at_rest[:, None, None], whole_turn * in_turn[:, None, None]),
            unit=(DEGREE, "°"),
            sentences=tuple(sentences),
        )


def _falls(step: Solution, sensors: slice) -> Array:
    """By how much chi-square falls (N,) without the step of the processes of some sensors after each rest; 0 where none
    follows, or where the data say nothing of it."""
    noise = step.equations.noise
    n = sum(noise.sensors)
    states = step.covariances(slice(-n, None))[:, :, sensors, sensors]
    values, rho = step.unknowns[:, -n:][:, sensors], noise.state_rho[:, sensors]
    here, following, across = states[0, :-1], states[0, 1:], states[1, :-1] * rho[:-1, :, None]
    deviation = noise.state_step[:-1, sensors]
    steps = (values[1:] - rho[:-1] * values[:-1]) / deviation
    covariance = following - across - np.swapaxes(across, 1, 2) + rho[:-1, :, None] * here * rho[:-1, None]
    covariance /= deviation[:, :, None] * deviation[:, None]
    told, directions = np.linalg.eigh(np.eye(covariance.shape[1]) - covariance)
    along = (steps[:, None] @ directions)[:, 0]
    fall = np.where(told > FREE, along**2 / np.maximum(told, FREE), 0.0).sum(axis=1)
    return np.append(np.where(noise.follows[:-1], fall, 0.0), 0.0)


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
        first = 0 if kind == "accel" else session.accel.size
        chosen = [b for b, pair in enumerate(PAIRS, start=PRODUCTS.start) if pair[0] != pair[1] or kind == "gyro"]
        beta = functions(block, session.force, session.rate)[:, 0, chosen]
        n, q = block.size, block.size * len(chosen)
        rest, turn = session.nothing(q)
        rest[:, first : first + n] = np.einsum("nb,ps->npsb", beta, np.eye(n)).reshape(len(rest), n, q)
        if about is not None and kind == "accel":
            session.put_velocity(turn, about.by_force[..., chosen].reshape(len(turn), 3, q))
        elif about is not None:
            turn[:, :3] = about.by_phi[..., chosen].reshape(len(turn), 3, q)
        size, unit = UNITS[kind]
        yield Candidate(
            name="cross products" if kind == "accel" else "g² sensitivity",
            concerns=kind,
            columns=(rest, turn),
            unit=(size / G_STANDARD**2, f"{unit}/g²"),
            sentences=(
                f"{WORDS[kind]} that read products of forces, by {{size}}: more oblique rests, or use it near the "
                "attitudes of the session",
            ),
        )


def gyro_nonlinearity(session: LinearisedSession, about: TurnsAbout, gyro: Block) -> Candidate:
    """Scale factors with the square of the rate, of an estimate that has no such parameters."""
    duration = np.maximum(about.moments.T, SHORTEST_TURN)[:, None]
    square = about.moments.body_rates[:, [0, 3, 5]] / duration @ (gyro.axes**2).T
    rest, turn = session.nothing(gyro.size)
    phi, V = (
        np.einsum("kipb,pb,kp->kip", by[..., RATE], gyro.axes, square) for by in (about.by_phi, about.by_velocity)
    )
    turn[:, :3] = phi
    session.put_velocity(turn, V)
    return Candidate(
        name="gyro nonlinearity",
        concerns="gyro",
        columns=(rest, turn),
        unit=(1e-6 / (10.0 * DEGREE) ** 2, "ppm at 10 °/s"),
        sentences=(
            "scale factors of the gyros that depend on the rate, by {size}: turn at the rates of use, at one rate, or "
            "make them parameters by gyro_cubic in [device.prior]",
        ),
    )


def earth_rate_errors(session: LinearisedSession) -> Iterator[Candidate]:
    """An error of the latitude of the site, rad, and a relative one of the clock of the log, each by a difference.

    Of a log of which a second lasts 1 + ε seconds, turns are larger by ε than the gyros say, as by their scale factors;
    levers and delays in its seconds explain the velocities as well. What is left is the Earth's rate, which is
    (1 + ε) Ω in its seconds."""
    step, latitude, rows = 1e-4, session.observations.site.latitude, session.linearised
    assert latitude is not None

    def columns(earth: Array) -> tuple[Array, Array]:
        moved = replace(session.problem, earth=earth)
        there = linearise(moved, session.linearised.point, session.linearised.about)
        rest, turn = ((a - b)[..., None] / step for a, b in zip(rows.residuals, there.residuals, strict=True))
        return rest, turn

    yield Candidate(
        name="latitude",
        concerns="both",
        columns=columns(np.array(earth_rate(latitude + step))),
        unit=(DEGREE, "°"),
        sentences=("a latitude that the gyros contradict by {size}: look at latitude_deg in [site], and its sign",),
        known=EARTH_SEEN,
    )
    by_clock = {name: size for name, size in session.observations.by_clock.items() if name == group_name(name)}
    u = max(map(abs, by_clock.values()), default=1.0)
    yield Candidate(
        name="clock",
        concerns="both",
        columns=columns((1.0 + step) * session.problem.earth),
        unit=(1e-2, "%"),
        sentences=(
            "a clock of the log that the Earth's rate contradicts by {size}: look at rate_hz, or the time column and "
            "its unit, in [log]",
        ),
        known=EARTH_SEEN,
        direct={group: (size / u, size) for group, size in by_clock.items()},
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
