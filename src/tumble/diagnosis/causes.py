"""Possible causes of residuals that the noise does not explain: one type, a table of words, and one loop of tests.

A cause is a set of columns, the effect of its size on the rows of rests and turns. Most causes change the coefficients
of readings, y_p = Σ_b K_pb β_pb(f, ω), in a course of time, so that their columns are those of parameters of the
instrument times this course (`LinearisedSession.columns`): a jump of biases, gyros that shift, products of forces. What
they are called and what to do about them is in `causes.toml`.

All causes are fitted at the linearisation of the estimate, without solving again, and judged by F tests with its
variance components (`tumble.diagnosis.projection`).

Drifts are no causes: they are part of the bias processes and of the groups that vary in time, whose sizes are estimated
(`tumble.diagnosis.misfit`). In-run biases that are large enough follow a jump of a bias, too. So a jump is judged with
in-run biases of usual size, and its Δχ² counts less the difference of both in −2 ln L.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from tumble.advice import Advised, advised, found_in, remedy_of
from tumble.diagnosis.findings import BIAS_UNITS, SENSORS, UNITS, Finding, with_unit
from tumble.diagnosis.projection import FALSE_ALARMS, Projection, projections
from tumble.earth import EARTH_RATE, earth_rate
from tumble.inference.integrated_turns import along_paths
from tumble.inference.linearisation import Linearisation, linearise
from tumble.inference.noise import NO_COMPONENTS
from tumble.inference.normal_equations import Solution, solve
from tumble.reduction.observations import Observations, extract_session
from tumble.rotation import rotation_matrix, rotation_vector, skew
from tumble.sensors.instrument import functions
from tumble.sensors.model import Block, SensorKind
from tumble.sensors.parameters import CONSTANT, FUNCTIONS, PAIRS, PRODUCTS, RATE, group_name, positions_by_group
from tumble.units import DEGREE, G_STANDARD, Array, IntArray, two_digits

WORDS = tomllib.loads((Path(__file__).parent / "causes.toml").read_text(encoding="utf-8"))
PATH_STEPS = 24  # steps into which the path of a turn is divided
SHORTEST_TURN = 1e-6  # s: shorter turns only join the parts of one rest
MEMORY_TIMES = (10.0, 60.0, 300.0)  # s: time constants of a memory that are tried
PLAY = 0.05 * G_STANDARD
"""Half the width of the play of a hysteresis: a change of the force by twice as much crosses it."""
EARTH_RATE_U = 0.03
"""Largest relative uncertainty of the Earth's rate, and of the latitude in rad, at which these are tested: with less
information the headings are hardly determined and not linear."""
RESTS_BESIDE = 2
"""Fewest rests before and after a change: a single rest with another bias is a rest that does not fit."""
JUMP_PLACES, SHIFT_PLACES = 24, 7
"""Most places in a session at which a jump or a shift is tried; one between two of them is found at either."""
COARSE_ROUNDING = 0.5  # error of the mean of a rest by rounding, in units of its noise, from which rounding is a cause

STEADY = np.ones((1, 1))  # course of an error that does not change

Columns = tuple[Array, Array]
"""Effect of q unknowns, per SI unit, on the rows of the rests (N, r, q) and of the turns (K, t, q)."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Cause:
    """A possible cause of residuals, with its effect on the rows."""

    name: str  # in causes.toml
    kind: SensorKind | None  # of the sensors at fault; None for the log or the site
    columns: Columns
    words: Sequence[Mapping[str, object]] = ({},)  # of its sentence, for each session or for all
    beside: int = 0  # number of last columns, of an error that resembles the cause and beside which it is judged
    places: int = 1  # number of places of which this is one
    direct: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """By group, the change beside the effect on the rows, per unit of the size, and its standard uncertainty."""

    def sentence(self, session: int, size: float) -> str:
        """Return what is found in a session, with the size in SI, and what to do about it."""
        kind, entry = self.kind or "gyro", WORDS[self.name]
        unit = entry["unit"].format(bias=BIAS_UNITS[kind])
        words = {
            "sensors": SENSORS[kind],
            "size": with_unit(size, unit),
            **self.words[min(session, len(self.words) - 1)],
        }
        return Advised(entry["found"].format(**words), entry["remedy"].format(**words))


def fit_causes(session: LinearisedSession, causes: Sequence[Cause]) -> list[list[Finding]]:
    """Return for each session the causes that it determines, the most likely place of each name and kind of sensor.

    The p-value is multiplied by the number of places tried (Bonferroni)."""
    rest, turn = (np.concatenate([cause.columns[rows] for cause in causes], axis=2) for rows in (0, 1))
    ends = np.cumsum([cause.columns[0].shape[2] for cause in causes])
    columns = np.split(np.arange(ends[-1]), ends[:-1])  # of each cause
    linearised, instrument = session.linearised, session.problem.instrument
    groups = positions_by_group(instrument.names[: instrument.linear_count])

    # the noise: as estimated or, for a jump, with in-run biases of usual size, which are less likely by `excess`
    components, in_run = linearised.components, linearised.problem.observations.in_run
    as_estimated = list(projections(linearised, components, rest, turn))
    with_usual_biases, excess = as_estimated, 0.0
    if components.wanders and any(cause.beside for cause in causes):
        sizes = {f"{kind}_in_run": min(getattr(components, f"{kind}_in_run"), in_run[kind]) for kind in in_run}
        usual = replace(components, **sizes, unlike=np.zeros(0))
        with_usual_biases = list(projections(linearised, usual, rest, turn))
        excess = float(solve(linearised, usual).deviance - session.solution.deviance)

    causes_by_session = []
    for s, (estimated, usual_biases) in enumerate(zip(as_estimated, with_usual_biases, strict=True)):
        best = dict[tuple[str, SensorKind | None], tuple[Finding, IntArray, Projection]]()
        for cause, own in zip(causes, columns, strict=True):
            judge, size = usual_biases if cause.beside else estimated, len(own) - cause.beside
            fit, judged = estimated.fit(own), judge.fit(own)
            if fit is None or judged is None:
                continue
            p_value = cause.places * judge.p_value(own, beside=own[size:])
            if cause.beside:
                p_value = max(p_value, cause.places * judge.p_value(own, handicap=max(0.0, excess)))
            name = cause.name, cause.kind
            if name in best and best[name][0].p_value <= p_value:
                continue
            shift, variance = fit.shift.copy(), estimated.u**2
            for group, (change, u) in cause.direct.items():
                shift[groups[group]] -= change * fit.values[0]
                variance[groups[group]] += u**2
            damage = np.abs(shift) / np.sqrt(variance)
            found = Finding(
                causes=(cause.name,),
                concerns=() if cause.kind is None else (cause.kind,),
                p_value=min(1.0, p_value),
                by_group={group: float(damage[members].max()) for group, members in groups.items()},
                sentence=cause.sentence(s, float(np.abs(judged.values[:size]).max())),
            )
            best[name] = found, own, judge
        causes_by_session.append(_beside_the_likeliest(list(best.values())))
    return causes_by_session


def _beside_the_likeliest(found: list[tuple[Finding, IntArray, Projection]]) -> list[Finding]:
    """Return the causes, the likeliest first if it is significant, with the p-values of the others beside it.

    A significant cause is named with it if neither explains anything beside the other."""
    if not found or min(cause.p_value for cause, *_ in found) > FALSE_ALARMS:
        return [cause for cause, *_ in found]
    best, best_columns, projection = min(found, key=lambda each: each[0].p_value)
    others = list[Finding]()
    for cause, columns, _ in found:
        if columns is best_columns:
            continue
        both = np.concatenate([best_columns, columns])
        beside, reversed_ = (projection.p_value(both, one) for one in (best_columns, columns))
        if min(beside, reversed_) > FALSE_ALARMS >= cause.p_value:
            by_group = {name: max(size, cause.by_group[name]) for name, size in best.by_group.items()}
            found_both = f"{found_in(best.sentence)}; or, indistinguishable in this session: {found_in(cause.sentence)}"
            sentence = advised(found_both, " or ".join(filter(None, map(remedy_of, (best.sentence, cause.sentence)))))
            best = replace(best, sentence=sentence, by_group=by_group, causes=(*best.causes, cause.cause))
        others.append(replace(cause, p_value=max(cause.p_value, beside)))
    return [best, *others]


# -------------------- the effects on the rows --------------------


class LinearisedSession:
    """One or several sessions with the forces and rates of their estimate, from which causes are built."""

    def __init__(self, linearised: Linearisation) -> None:
        self.linearised = linearised
        self.problem = linearised.problem.with_lagged_temperatures(linearised.point)
        self.observations = self.problem.observations
        self.blocks: dict[SensorKind, Block] = {block.kind: block for block in self.problem.instrument.blocks}
        L = linearised.point.attitudes
        self.force = linearised.point.gravity * L[:, 1]  # (N, 3), in the body at rest
        self.rate = self.problem.earth @ L  # (N, 3), of the Earth
        turns, integrated = self.observations.turns, linearised.integrated
        moved = np.zeros(0, dtype=bool) if integrated is None else integrated.moments.T >= SHORTEST_TURN
        # the parts of one rest are joined by turns of no duration
        self.has_turns = [bool(moved[part.turns].any()) for part in self.problem.session_spans]
        self.path_rotations, self.path_forces = np.zeros((0, PATH_STEPS, 3, 3)), np.zeros((0, PATH_STEPS, 3))
        if integrated is not None and turns is not None:
            # since the start of each turn, taken as about one axis in the body
            path = rotation_vector(integrated.C)
            angle = np.linalg.norm(path, axis=1, keepdims=True)
            beyond_half = np.einsum("ka,ka->k", path, integrated.moments.body[:, 1:4]) < 0.0
            path = np.where(beyond_half[:, None], path * (1.0 - 2.0 * np.pi / np.maximum(angle, 1e-9)), path)
            share = (np.arange(PATH_STEPS) + 0.5) / PATH_STEPS
            back = rotation_matrix(-(share[None, :, None] * path[:, None]).reshape(-1, 3))
            self.path_rotations = back.reshape(-1, PATH_STEPS, 3, 3)
            self.path_forces = np.einsum("ksab,kb->ksa", self.path_rotations, self.force[turns.first])

    @cached_property
    def solution(self) -> Solution:
        """The solution with the variance components of the estimate."""
        return solve(self.linearised, self.linearised.components)

    @cached_property
    def observed(self) -> list[Observations]:
        """The observations of each session."""
        if self.observations.together is None:
            return [self.observations]
        return [extract_session(self.observations, part.rests, part.turns) for part in self.problem.session_spans]

    def columns(self, kind: SensorKind, change: Array, at_rest: Array = STEADY, in_turn: Array = STEADY) -> Columns:
        """Return the effect of changes ∂K/∂c = `change` (n, 15, q) of the coefficients of a kind of sensors, times
        their courses `at_rest` (N, q) and `in_turn` (K, q), in which 1 is for all."""
        rows, block, sensors = self.linearised, self.blocks[kind], self.linearised.noise.places[kind]
        by_function = functions(block, self.force, self.rate)
        rest, turn = (np.zeros((*residuals.shape, change.shape[2])) for residuals in rows.residuals)
        rest[:, sensors] = np.einsum("npb,pbq->npq", by_function, change) * at_rest[:, None]
        if rows.integrated is not None:
            t = 6 if self.problem.instrument.in_velocities else 3
            turn[:, :t] = along_paths(rows.integrated.paths[:, :, sensors], change)[:, :t]
            turn[:, t:] = rows.bias[:, t:, sensors] @ change[:, CONSTANT]
        return rest, turn * in_turn[:, None]

    def bias_columns(self, kind: SensorKind, at_rest: Array, in_turn: Array) -> Columns:
        """Return the effect of biases that vary by factors `at_rest` (N, n) and `in_turn` (K, steps, n)."""
        block, integrated = self.blocks[kind], self.linearised.integrated
        rest, turn = self.columns(kind, unit_biases(block), at_rest, in_turn.mean(axis=1))
        if kind == "accel" and integrated is not None and self.problem.instrument.in_velocities:
            turned = np.swapaxes(self.path_rotations, 2, 3) @ np.linalg.pinv(block.axes)  # C s_p
            turn[:, 3:6] = np.einsum("ksip,ksp,k->kip", turned, in_turn, integrated.moments.T / PATH_STEPS)
        return rest, turn

    def after(self, place: float, *, centred: bool) -> tuple[Array, Array, list[int]]:
        """Return which rests (N,) and turns (K,) follow a place of their session, 0 … 1, and the last rests before.

        They follow by 1, or ½ for the turn there, less the mean over the rests if `centred`."""
        at_rest, in_turn, lasts = np.zeros(len(self.force)), np.zeros(len(self.path_forces)), list[int]()
        for part in self.problem.session_spans:
            rests, before = np.arange(part.rests.start, part.rests.stop), self.problem.before_turn[part.turns]
            if len(possible := rests[RESTS_BESIDE - 1 : -RESTS_BESIDE]):
                last = round(possible[0] + place * (len(possible) - 1))
                mean = float((rests > last).mean()) if centred else 0.0
                at_rest[part.rests], in_turn[part.turns] = rests > last, 0.5 * (1.0 + np.sign(before - last))
                at_rest[part.rests] -= mean
                in_turn[part.turns] -= mean
            lasts.append(int(last) if len(possible) else part.rests.start)
        return at_rest, in_turn, lasts


def unit_biases(block: Block) -> Array:
    """Return ∂K/∂b (n, 15, n) of the biases of a block."""
    out = np.zeros((block.size, FUNCTIONS, block.size))
    out[:, CONSTANT] = np.eye(block.size)
    return out


# -------------------- the causes --------------------


def causes_of_session(session: LinearisedSession) -> Iterator[Cause]:
    """Yield all causes with columns except lost samples (`tumble.diagnosis.lost_samples`)."""
    yield from jumps(session)
    play = _lags(session, session.blocks["accel"], _play_lag, np.ones(()))
    yield Cause(name="hysteresis", kind="accel", columns=session.bias_columns("accel", *play))
    for kind, block in session.blocks.items():
        lags = _lags(session, block, memory_lag, np.array(MEMORY_TIMES))
        for time, *lag in zip(MEMORY_TIMES, *lags, strict=True):
            columns = session.bias_columns(kind, *lag)
            yield Cause(name="memory", kind=kind, columns=columns, places=len(MEMORY_TIMES), words=[{"time": time}])
        yield _products(session, kind, block)
    if "gyro" in session.blocks:
        if any(session.has_turns):
            yield from shifts(session, session.blocks["gyro"])
            if "gyro.cubic" not in session.problem.instrument.members:
                yield _gyro_nonlinearity(session, session.blocks["gyro"])
        if session.observations.site.latitude is not None:
            yield from earth_rate_errors(session)


def jumps(session: LinearisedSession) -> Iterator[Cause]:
    """Yield a jump of the biases of each kind of sensor after some rest, as of a driver that measures them anew.

    The turn there has a bias of its own, as the jump may be anywhere in it. Any error of this turn is such a bias, so
    that the jump must also be significant beside it, by the rests and the other turns. The parameters are the means
    over the rests, and the jump is about these."""
    rests = session.observations.rests
    longest = max(part.rests.stop - part.rests.start for part in session.problem.session_spans)
    places = np.linspace(0.0, 1.0, min(max(1, longest - 2 * RESTS_BESIDE + 1), JUMP_PLACES))
    for place in places.tolist():
        at_rest, in_turn, lasts = session.after(place, centred=True)
        there = np.isin(session.problem.before_turn, lasts)
        names = [session.observations.rest_named(last).rpartition(": ")[2] for last in lasts]
        where = [
            {"rest": f"{name} ({rests.start[last]:z.1f}–{rests.stop[last]:z.1f} s)"}
            for name, last in zip(names, lasts, strict=True)
        ]
        for kind, block in session.blocks.items():
            rest = np.repeat(np.column_stack([at_rest, 0.0 * at_rest]), block.size, axis=1)
            turn = np.repeat(np.column_stack([in_turn, there]), block.size, axis=1)
            columns = session.columns(kind, np.tile(unit_biases(block), 2), rest, turn)
            yield Cause(name="jump", kind=kind, columns=columns, beside=block.size, places=len(places), words=where)


def shifts(session: LinearisedSession, gyro: Block) -> Iterator[Cause]:
    """Yield rotations of the gyros against the accelerometers by a small angle δ, as on a loose board.

    For a gyro of axis a, ∂K/∂δ = a × δ for the rates after the place of the shift."""
    change = np.zeros((gyro.size, FUNCTIONS, 3))
    change[:, RATE] = np.swapaxes(skew(gyro.axes), 1, 2)
    for place in np.linspace(0.0, 1.0, SHIFT_PLACES + 2)[1:-1].tolist():
        at_rest, in_turn, lasts = session.after(place, centred=False)
        columns = session.columns("gyro", change, at_rest[:, None], in_turn[:, None])
        times = [{"time": session.observations.rests.stop[last]} for last in lasts]
        yield Cause(name="shift", kind="gyro", columns=columns, places=SHIFT_PLACES, words=times)


def _products(session: LinearisedSession, kind: SensorKind, block: Block) -> Cause:
    """Return products of forces that are not parameters: cross products in accelerometers, all products in gyros."""
    chosen = [b for b, pair in enumerate(PAIRS, PRODUCTS.start) if pair[0] != pair[1] or kind == "gyro"]
    change = np.zeros((block.size, FUNCTIONS, block.size, len(chosen)))
    for p in range(block.size):
        change[p, chosen, p] = np.eye(len(chosen))
    columns = session.columns(kind, change.reshape(block.size, FUNCTIONS, -1))
    return Cause(name="cross products" if kind == "accel" else "g² sensitivity", kind=kind, columns=columns)


def _gyro_nonlinearity(session: LinearisedSession, gyro: Block) -> Cause:
    """Return scale factors of gyros that vary with the square of the rate."""
    integrated, change = session.linearised.integrated, np.zeros((gyro.size, FUNCTIONS, gyro.size))
    assert integrated is not None
    duration = np.maximum(integrated.moments.T, SHORTEST_TURN)[:, None]
    square = integrated.moments.body_rates[:, [0, 3, 5]] / duration @ (gyro.axes**2).T
    change[:, RATE] = np.eye(gyro.size)[:, None] * gyro.axes[:, :, None]
    return Cause(name="gyro nonlinearity", kind="gyro", columns=session.columns("gyro", change, 0.0 * STEADY, square))


# ---- errors that depend on the previous attitudes


def _lags(
    session: LinearisedSession, block: Block, lag: Callable[[Array, Array, Array], tuple[Array, Array]], times: Array
) -> tuple[Array, Array]:
    """Return the lag of every sensor at rest (..., N, n) and in the steps of the turns (..., K, steps, n).

    Each sensor has a state, which starts at its force in the first rest of a session. `lag` returns the lags in steps
    and the states (..., n) after them, from the states before, the forces (steps, n) and the duration of a step in
    `times` (...), s."""
    rests, turns = session.observations.rests, session.observations.turns
    turn_after = {rest: k for k, rest in enumerate(session.problem.before_turn.tolist())}
    force, path = session.force @ block.axes.T, session.path_forces @ block.axes.T
    first = {part.rests.start for part in session.problem.session_spans}
    at_rest, in_turn = np.zeros((*times.shape, *force.shape)), np.zeros((*times.shape, *path.shape))
    state = np.zeros((*times.shape, block.size))
    for i, here in enumerate(force):
        if i in first:
            state = np.broadcast_to(here, state.shape)
        at_rest[..., i : i + 1, :], state = lag(state, here[None], (rests.stop[i] - rests.start[i]) / times)
        if (k := turn_after.get(i)) is not None and turns is not None:
            in_turn[..., k, :, :], state = lag(state, path[k], turns.duration[k] / PATH_STEPS / times)
    return at_rest, in_turn


def _play_lag(middle: Array, force: Array, _: Array) -> tuple[Array, Array]:
    """Return where the forces (steps, n) are in their play, −1 … 1, and the middle of the play after them."""
    middles = np.empty_like(force)
    for j, (low, high) in enumerate(zip(force - PLAY, force + PLAY, strict=True)):
        middles[j] = middle = np.clip(middle, low, high)
    return (force - middles) / PLAY, middle


def memory_lag(state: Array, target: Array, time: Array) -> tuple[Array, Array]:
    """Return the mean of s − target in each step (..., steps, n) and the last s, s_{j+1} = target_j + (s_j − target_j)
    e^(−t), from `state` (..., n), targets (steps, n) and the duration t of a step in time constants (...)."""
    steps, t = len(target), time[..., None, None]
    decay = np.exp(-time[..., None] * np.arange(steps + 1))  # after so many steps
    steps_since = np.arange(steps + 1)[:, None] - np.arange(steps)
    weight = np.where(steps_since > 0, decay[..., np.maximum(steps_since - 1, 0)], 0.0)
    states = decay[..., None] * state[..., None, :] - np.expm1(-t) * (weight @ target)
    mean = np.where(t > 0.0, -np.expm1(-t) / np.where(t > 0.0, t, 1.0), 1.0)  # of e^(−t) over a step
    return (states[..., :-1, :] - target) * mean, states[..., -1, :]


# ---- errors of the site and of the clock


def earth_rate_errors(session: LinearisedSession) -> Iterator[Cause]:
    """Yield an error of the latitude, rad, and a relative error of the clock of the log.

    If a second of the log lasts 1 + ε s, the angles of turns are larger by ε, which is the effect of scale factors of
    the gyros; velocities change as by lever arms and delays. Only the Earth's rate, (1 + ε) Ω in the log's seconds,
    shows it. The rows are linear in its components along north and up. An error of the latitude moves them along a
    circle, and its column is the chord to the latitude that fits best, however far the stated one is off."""
    latitude, rows = session.observations.site.latitude, session.linearised
    assert latitude is not None
    stated, step = session.problem.earth, 1e-4 * EARTH_RATE
    changed = [
        linearise(replace(session.problem, earth=stated + step * axis), rows.point, rows.integrated).residuals
        for axis in np.eye(3)[:2]
    ]
    by_north_up = tuple(
        (rows.residuals[k][:, :, None] - np.dstack([each[k] for each in changed])) / step for k in (0, 1)
    )
    latitudes = np.append(np.linspace(-0.5 * np.pi, 0.5 * np.pi, 1801), latitude + 1e-4)
    changes = np.array([earth_rate(each) for each in latitudes.tolist()])[:, :2] - stated[:2]
    chi_square, known = np.zeros(len(changes)), list(projections(rows, NO_COMPONENTS, *by_north_up))
    for each in known:
        chi_square += ((each.residual - changes * each.length @ each.triangle.T) ** 2).sum(axis=1)
    best = int(np.argmin(chi_square))
    by_clock = {name: size for name, size in session.observations.by_clock.items() if name == group_name(name)}
    u = max(map(abs, by_clock.values()), default=1.0)
    for name, along, direct in (
        ("latitude", changes[best] / (latitudes[best] - latitude), {}),
        ("clock", stated[:2], {group: (size / u, size) for group, size in by_clock.items()}),
    ):
        rest, turn = (each @ along[:, None] for each in by_north_up)
        if max(float(np.linalg.norm(each.triangle @ (along * each.length))) for each in known) * EARTH_RATE_U > 1.0:
            words = [{"degrees": latitudes[best] / DEGREE}]
            yield Cause(name=name, kind=None, columns=(rest, turn), words=words, direct=direct)


# ---- rounding, which needs no columns


def quantisation(session: LinearisedSession, s: int) -> Iterator[Finding]:
    """Yield kinds of sensors of session s whose rounding errors are large beside the noise of the mean of a rest."""
    rests = session.problem.session_spans[s].rests
    for kind in session.blocks:
        unit, rounding = BIAS_UNITS[kind], session.observations.rounding.get(kind)
        if rounding is None or not rounding.common_u.any():
            continue
        covariance = getattr(session.observations.rests, f"{kind}_covariance")[rests]
        variance = np.median(np.diagonal(covariance, axis1=1, axis2=2), axis=0) - rounding.rest_u**2
        coarse = rounding.common_u > COARSE_ROUNDING * np.sqrt(np.maximum(variance, 0.0))
        if coarse.any():
            worst = int(np.argmax(np.where(coarse, rounding.common_u, 0.0)))
            step, noise, error = (
                f"{two_digits(each[worst] / UNITS[unit])} {unit}"
                for each in (rounding.step, rounding.noise, rounding.common_u)
            )
            yield Finding(
                causes=("quantisation",),
                concerns=(kind,),
                sentence=Advised(
                    f"steps of the {SENSORS[kind]} of {step}, too coarse for the noise of a reading, {noise}, to "
                    f"average their rounding out: the mean of a rest errs by up to {error}",
                    "log with more digits, or use a smaller range",
                ),
            )
