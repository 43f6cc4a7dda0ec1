"""Candidate causes of residuals that the noise does not explain, each with its columns, its sentence and its test.

A candidate is a set of columns, the rows of rests and turns per SI unit of its size. All candidates are fitted at the
linearisation of the estimate, without solving again (`tumble.diagnosis.projection`). A decrease of chi-square Δχ² is
judged by the noise alone, as chi-square of q degrees of freedom, and with the variance components of the estimate, by
F = (Δχ²/q) / ((χ² − Δχ²)/(ν − q)). The larger probability counts: with few degrees of freedom, scatter may be due to
chance, or a cause may leave nothing of the residuals. Drifts are no candidates: they are part of the bias processes and
of the groups that vary in time, whose sizes are estimated (`tumble.diagnosis.misfit`). In-run biases that are large
enough follow a jump of a bias, too. So a jump is judged with in-run biases of usual size if these and the jump are far
more likely than the larger in-run biases: if Δχ² exceeds the difference of both in −2 ln L by more than chance does.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import scipy

from tumble.advice import Advised, advised, found_in, remedy_of
from tumble.diagnosis.findings import BIAS_UNITS, SENSORS, Finding, with_unit
from tumble.diagnosis.projection import FALSE_ALARMS, Projection, diagnostic_solution, projections
from tumble.earth import EARTH_RATE, earth_rate
from tumble.inference.integrated_turns import IntegratedTurns
from tumble.inference.linearisation import Linearisation, linearise
from tumble.inference.noise import VarianceComponents
from tumble.inference.problem import SessionSpan
from tumble.reduction.observations import Observations, extract_session
from tumble.rotation import rotation_matrix, rotation_vector, skew
from tumble.sensors.instrument import functions
from tumble.sensors.model import Block, SensorKind
from tumble.sensors.parameters import PAIRS, PRODUCTS, RATE, group_name, positions_by_group
from tumble.units import DEGREE, G_STANDARD, Array, IntArray, two_digits

PATH_STEPS = 24  # steps into which the path of a turn is divided
SHORTEST_TURN = 1e-6  # s: shorter turns only join the parts of one rest
MEMORY_TIMES = (10.0, 60.0, 300.0)  # s: time constants of a memory that are tried
PLAY = 0.05 * G_STANDARD
"""Half the width of the play of a hysteresis: a change of the force by twice as much crosses it."""
EARTH_RATE_U = 0.03
"""Largest relative uncertainty of the Earth's rate, and of the latitude in rad, at which these are tested: with less
information the headings are hardly determined and not linear."""
RESTS_BESIDE_JUMP = 2
"""Fewest rests before and after a jump: a single rest with another bias is a rest that does not fit."""
JUMP_PLACES = 24
"""Most places in a session at which a jump of biases is tried."""
SHIFT_PLACES = 7
"""Places in a session at which a shift of the gyros is tried; one between two of them is found at either."""
COARSE_ROUNDING = 0.5  # error of the mean of a rest by rounding, in units of its noise, from which rounding is a cause


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Candidate:
    """A possible cause with its effect on the rows of rests and turns."""

    name: str
    concerns: tuple[SensorKind, ...]
    columns: tuple[Array, Array]  # (N, r, q) of the rests and (K, t, q) of the turns, per SI unit of the size
    unit: tuple[float, str]  # of the size in sentences: SI, name
    sentences: Sequence[str]  # one, or one for each session, with {size}
    largest_u: float = np.inf  # SI: it is not tested where its size is more uncertain
    places: int = 1  # number of places of which this is the most likely one
    sized: int | None = None  # columns, the first ones, that give the size; None for all
    abrupt: bool = False  # larger in-run biases than usual could have followed it, or an error of one turn resembles it
    direct: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """By group, the change beside the effect on the rows, per unit of the size, and its standard uncertainty."""


def fit_candidates(linearised: Linearisation, candidates: Sequence[Candidate]) -> list[list[Finding]]:
    """Return for each session the causes that it determines, the most likely candidate of each name and kind of sensor.

    The p-value is multiplied by the number of places tried (Bonferroni)."""
    rest, turn = (np.concatenate([c.columns[rows] for c in candidates], axis=2) for rows in (0, 1))
    ends = np.cumsum([c.columns[0].shape[2] for c in candidates]).tolist()
    columns = [np.arange(end - c.columns[0].shape[2], end) for c, end in zip(candidates, ends, strict=True)]
    instrument = linearised.problem.instrument
    groups = positions_by_group(instrument.names[: instrument.linear_count])
    with_scatter = list(projections(linearised, linearised.components, rest, turn))
    noise_only, usual_biases, excess = with_scatter, with_scatter, np.inf
    if with_scatter[0].has_scatter:
        noise_only = list(projections(linearised, VarianceComponents(), rest, turn))
    components, in_run = linearised.components, linearised.problem.observations.in_run
    if components.wanders and any(c.abrupt for c in candidates):
        sizes = {f"{kind}_in_run": min(getattr(components, f"{kind}_in_run"), in_run[kind]) for kind in in_run}
        usual = replace(components, **sizes, unlike=np.zeros(0))
        usual_biases = list(projections(linearised, usual, rest, turn))
        deviances = [diagnostic_solution(linearised, each).deviance for each in (usual, components)]
        excess = float(deviances[0] - deviances[1])  # of −2 ln L, without a jump
    places = Counter[tuple[str, tuple[str, ...]]]()
    for c in candidates:
        places[c.name, c.concerns] += c.places
    causes_by_session = []
    for s, (by_noise, estimated, by_usual) in enumerate(zip(noise_only, with_scatter, usual_biases, strict=True)):
        best = dict[tuple[str, tuple[str, ...]], tuple[Finding, IntArray, Projection]]()
        for c, own_columns in zip(candidates, columns, strict=True):
            name, first, fit = (c.name, c.concerns), by_noise.fit(own_columns, c.largest_u), estimated.fit(own_columns)
            if first is None or fit is None:
                continue
            projection, judged = estimated, fit
            # a jump with in-run biases of usual size, against larger in-run biases without one
            steady = (by_usual.fit(own_columns) if c.abrupt else None) or fit
            if c.abrupt and steady.drop > excess + scipy.special.chdtri(steady.rank, FALSE_ALARMS / places[name]):
                projection, judged = by_usual, steady
            p_value = max(each.p_value(f.drop, f.rank) for each, f in ((by_noise, first), (projection, judged)))
            if c.abrupt:  # and the jump beside an error of the turn there alone
                p_value = max(p_value, by_usual.p_value_beside(steady, by_usual.fit(own_columns[c.sized :])))
            p_value = min(1.0, places[name] * p_value)
            if name in best and best[name][0].p_value <= p_value:
                continue
            shift, variance = fit.shift.copy(), estimated.u**2
            for group, (change, u) in c.direct.items():
                shift[groups[group]] -= change * fit.values[0]
                variance[groups[group]] += u**2
            damage = np.abs(shift) / np.sqrt(variance)
            size = with_unit(float(np.abs(steady.values[: c.sized]).max()), c.unit)
            sentence = c.sentences[min(s, len(c.sentences) - 1)]
            cause = Finding(
                causes=(c.name,),
                concerns=c.concerns,
                p_value=p_value,
                by_group={group: float(damage[members].max()) for group, members in groups.items()},
                sentence=advised(found_in(sentence).format(size=size), remedy_of(sentence)),
            )
            best[name] = cause, own_columns, projection
        causes_by_session.append(_beside_the_likeliest(list(best.values())))
    return causes_by_session


def _beside_the_likeliest(found: list[tuple[Finding, IntArray, Projection]]) -> list[Finding]:
    """Return the causes, the likeliest first if it is significant, with the p-values of the others beside it.

    A significant cause is named with it if neither explains anything beside the other."""
    causes = [cause for cause, *_ in found]
    if not causes or min(cause.p_value for cause in causes) > FALSE_ALARMS:
        return causes
    best, best_columns, projection = min(found, key=lambda each: each[0].p_value)
    best_fit, others = projection.fit(best_columns), list[Finding]()
    assert best_fit is not None
    for cause, columns, _ in found:
        both, own_fit = projection.fit(np.concatenate([best_columns, columns])), projection.fit(columns)
        if columns is best_columns or both is None or own_fit is None:
            continue
        beside, reversed_ = (projection.p_value_beside(both, before) for before in (best_fit, own_fit))
        if min(beside, reversed_) > FALSE_ALARMS >= cause.p_value:
            by_group = {name: max(size, cause.by_group[name]) for name, size in best.by_group.items()}
            found_both = f"{found_in(best.sentence)}; or, indistinguishable in this session: {found_in(cause.sentence)}"
            sentence = advised(found_both, " or ".join(filter(None, map(remedy_of, (best.sentence, cause.sentence)))))
            best = replace(best, sentence=sentence, by_group=by_group, causes=(*best.causes, cause.cause))
        others.append(replace(cause, p_value=max(cause.p_value, beside)))
    return [best, *others]


# -------------------- the candidates --------------------


class LinearisedSession:
    """One or several sessions with the forces and rates of their estimate, from which candidates are built."""

    def __init__(self, linearised: Linearisation) -> None:
        self.linearised = linearised
        self.problem = linearised.problem.with_lags_at(linearised.point)
        self.observations = self.problem.observations
        L = linearised.point.attitudes
        self.force = linearised.point.gravity * L[:, 1]  # (N, 3), in the body at rest
        self.rate = self.problem.earth @ L  # (N, 3), of the Earth
        self.accel: Block = self.observations.accel_block
        self.first_rests = {part.rests.start for part in self.problem.parts}
        gyro, about = self.observations.gyro_block, linearised.about
        self.kinds: list[tuple[SensorKind, Block]] = [("accel", self.accel)]
        if gyro is not None:
            self.kinds.append(("gyro", gyro))
        moved = np.zeros(0, dtype=bool) if about is None else about.moments.T >= SHORTEST_TURN
        # the parts of one rest are joined by turns of no duration
        self.has_turns = [bool(moved[part.turns].any()) for part in self.problem.parts]

    @cached_property
    def observed(self) -> list[Observations]:
        """The observations of each session."""
        if self.observations.together is None:
            return [self.observations]
        return [extract_session(self.observations, part.rests, part.turns) for part in self.problem.parts]

    @cached_property
    def _path_rotations(self) -> Array:
        """Rotations (K, steps, 3, 3) of the body since the start of each turn, taken as about one axis in the body."""
        about = self.linearised.about
        if about is None:
            return np.zeros((0, PATH_STEPS, 3, 3))
        path = rotation_vector(about.C)
        angle = np.linalg.norm(path, axis=1, keepdims=True)
        beyond_half = np.einsum("ka,ka->k", path, about.moments.body[:, 1:4]) < 0.0
        path = np.where(beyond_half[:, None], path * (1.0 - 2.0 * np.pi / np.maximum(angle, 1e-9)), path)
        share = (np.arange(PATH_STEPS) + 0.5) / PATH_STEPS
        back = rotation_matrix(-(share[None, :, None] * path[:, None]).reshape(-1, 3))
        return np.asarray(back.reshape(-1, PATH_STEPS, 3, 3))

    @cached_property
    def path_forces(self) -> Array:
        """Specific forces (K, steps, 3) in the body during each turn."""
        turns = self.observations.turns
        if turns is None:
            return np.zeros((0, PATH_STEPS, 3))
        return np.asarray(np.einsum("ksab,kb->ksa", self._path_rotations, self.force[turns.first]))

    def zero_columns(self, q: int) -> tuple[Array, Array]:
        """Return zero columns (N, r, q) of the rests and (K, t, q) of the turns."""
        rest, turn = (np.zeros((*residuals.shape, q)) for residuals in self.linearised.residuals)
        return rest, turn

    def after_rest(self, last: int, part: SessionSpan) -> tuple[Array, Array]:
        """Return which rests (N,) and turns (K,) of a session follow one of its rests, 0 or 1; ½ for the next turn."""
        before = self.problem.before_turn[part.turns]
        after = np.arange(part.rests.start, part.rests.stop) > last
        return after.astype(float), 0.5 * (1.0 + np.sign(before - last))

    def bias_columns(self, kind: str, at_rest: Array, in_turn: Array) -> tuple[Array, Array]:
        """Return the columns of biases of a kind of sensor that vary by factors `at_rest` (N, n) and `in_turn`
        (K, steps, n)."""
        n, about = at_rest.shape[1], self.linearised.about
        first = 0 if kind == "accel" else self.accel.size
        rest, turn = self.zero_columns(n)
        rest[:, first : first + n] = at_rest[:, :, None] * np.eye(n)
        if len(turn):
            turn = self.linearised.bias[:, :, first : first + n] * in_turn.mean(axis=1)[:, None, :]
        if kind == "accel" and about is not None:
            turned = np.swapaxes(self._path_rotations, 2, 3) @ np.linalg.pinv(self.accel.axes)  # C s_p
            self.set_velocity(turn, np.einsum("ksip,ksp,k->kip", turned, in_turn, about.moments.T / PATH_STEPS))
        return rest, turn

    def set_velocity(self, turn: Array, columns: Array) -> None:
        """Set the rows of the velocities to columns (K, 3, q), if the estimate uses velocities."""
        if self.problem.instrument.in_velocities:
            turn[:, 3:6] = columns


def candidates_of(session: LinearisedSession) -> Iterator[Candidate]:
    """Yield all candidates except lost samples (`tumble.diagnosis.lost_samples`)."""
    about, gyro = session.linearised.about, session.observations.gyro_block
    yield from jumps(session)
    hysteresis = session.bias_columns("accel", *_lags_along_session(session, session.accel, _play_lag, np.ones(())))
    yield Candidate(
        name="hysteresis",
        concerns=("accel",),
        columns=hysteresis,
        unit=BIAS_UNITS["accel"],
        sentences=[
            Advised(
                "hysteresis of the accelerometers of {size}, by the sign of the last change of the own force",
                "come to each position from both sides",
            )
        ],
    )
    for kind, block in session.kinds:
        lags = _lags_along_session(session, block, memory_lag, np.array(MEMORY_TIMES))
        for time, *lag in zip(MEMORY_TIMES, *lags, strict=True):
            yield Candidate(
                name="memory",
                concerns=(kind,),
                columns=session.bias_columns(kind, *lag),
                unit=_per_g(kind, 1),
                sentences=[
                    Advised(
                        f"{SENSORS[kind]} that remember the previous attitude by {{size}} for about {time:.0f} s",
                        "take longer rests, of which the beginning is left out",
                    )
                ],
            )
    yield from products(session)
    if any(session.has_turns) and about is not None and gyro is not None:
        yield from shifts(session, about, gyro)
        if "gyro.cubic" not in session.problem.instrument.members:
            yield gyro_nonlinearity(session, about, gyro)
    if gyro is not None and session.observations.site.latitude is not None:
        yield from earth_rate_errors(session)


def _per_g(kind: str, power: int) -> tuple[float, str]:
    """Return the unit (SI, name) of a bias per power of g."""
    size, name = BIAS_UNITS[kind]
    return size / G_STANDARD**power, f"{name}/g{'' if power == 1 else '²'}"


def jumps(session: LinearisedSession) -> Iterator[Candidate]:
    """Yield a jump of the biases of each kind of sensor after some rest, as of a driver that measures them anew.

    The turn there has a bias of its own, as the jump may be anywhere in it. Any error of this turn is such a bias, so
    that the jump must also be significant beside it, by the rests and the other turns. The parameters are the means
    over the rests, and the jump is about these."""
    rests, parts = session.observations.rests, session.problem.parts
    at_rest, (in_turn, there) = np.zeros((len(rests), 1)), np.zeros((2, len(session.problem.before_turn), 1, 1))
    lasts = [np.arange(part.rests.start, part.rests.stop)[RESTS_BESIDE_JUMP - 1 : -RESTS_BESIDE_JUMP] for part in parts]
    for place in np.linspace(0.0, 1.0, min(max(1, *map(len, lasts)), JUMP_PLACES)):
        where = list[str]()
        for part, possible in zip(parts, lasts, strict=True):
            last = part.rests.start
            if len(possible):
                last = round(possible[0] + place * (len(possible) - 1))
                after, later = session.after_rest(last, part)
                there[part.turns, 0, 0] = later == 0.5
                at_rest[part.rests, 0], in_turn[part.turns, 0, 0] = after - after.mean(), later - after.mean()
            name = session.observations.rest_named(last).rpartition(": ")[2]
            where.append(f"{name} ({rests.start[last]:z.1f}–{rests.stop[last]:z.1f} s)")
        for kind, block in session.kinds:
            steps = np.ones((PATH_STEPS, block.size))
            jump = session.bias_columns(kind, at_rest * steps[0], in_turn * steps)
            meanwhile = session.bias_columns(kind, 0.0 * at_rest * steps[0], there * steps)
            yield Candidate(
                name="jump",
                concerns=(kind,),
                columns=(np.dstack([jump[0], meanwhile[0]]), np.dstack([jump[1], meanwhile[1]])),
                unit=BIAS_UNITS[kind],
                sized=block.size,
                sentences=[
                    Advised(
                        f"biases of the {SENSORS[kind]} jump by {{size}} after {rest}, as of a driver that measures "
                        "them anew or of another device, and the values given are means over the rests",
                        "calibrate what is before and what is after as launches, each with the times of the other in "
                        "[[exclude]]",
                    )
                    for rest in where
                ],
                abrupt=True,
            )


def shifts(session: LinearisedSession, about: IntegratedTurns, gyro: Block) -> Iterator[Candidate]:
    """Yield rotations of the gyros against the accelerometers by a small angle δ, as on a loose board.

    For a gyro of axis a, ∂K/∂δ = a × δ for the rates after the place of the shift."""
    rests, n = session.observations.rests, session.accel.size
    change = skew(gyro.axes)  # (n, 3, 3): a × e_j, by the components of the rate
    rest, turn = session.zero_columns(3)
    rest[:, n : n + gyro.size] = np.einsum("nb,pbj->npj", session.rate, change)
    turn[:, :3], velocity = (
        np.einsum("kipb,pbj->kij", by[..., RATE], change) for by in (about.by_phi, about.by_velocity)
    )
    session.set_velocity(turn, velocity)
    for place in range(1, SHIFT_PLACES + 1):
        at_rest, in_turn, sentences = np.zeros(len(rest)), np.zeros(len(turn)), list[str]()
        for part in session.problem.parts:
            last = part.rests.start + (part.rests.stop - part.rests.start) * place // (SHIFT_PLACES + 1)
            at_rest[part.rests], in_turn[part.turns] = session.after_rest(last, part)
            sentences.append(
                Advised(
                    f"the gyros turn against the accelerometers by {{size}} about {rests.stop[last]:z.0f} s, as on a "
                    "board that is loose",
                    "fasten it, and calibrate what is before and what is after as launches",
                )
            )
        columns = rest * at_rest[:, None, None], turn * in_turn[:, None, None]
        yield Candidate(name="shift", concerns=("gyro",), columns=columns, unit=(DEGREE, "°"), sentences=sentences)


# ---- errors that depend on the previous attitudes


def _lags_along_session(
    session: LinearisedSession, block: Block, lag: Callable[[Array, Array, Array], tuple[Array, Array]], times: Array
) -> tuple[Array, Array]:
    """Return the lag of every sensor at rest (..., N, n) and in the steps of the turns (..., K, steps, n).

    Each sensor has a state, which starts at its force in the first rest of a session. `lag` returns the lags in steps
    and the states (..., n) after them, from the states before, the forces (steps, n) and the duration of a step in
    `times` (...), s."""
    rests, turns = session.observations.rests, session.observations.turns
    turn_after = {rest: k for k, rest in enumerate(session.problem.before_turn.tolist())}
    force, path = session.force @ block.axes.T, session.path_forces @ block.axes.T
    at_rest, in_turn = np.zeros((*times.shape, *force.shape)), np.zeros((*times.shape, *path.shape))
    state = np.zeros((*times.shape, block.size))
    for i, here in enumerate(force):
        if i in session.first_rests:
            state = np.broadcast_to(here, state.shape)
        at_rest[..., i : i + 1, :], state = lag(state, here[None], (rests.stop[i] - rests.start[i]) / times)
        if (k := turn_after.get(i)) is not None and turns is not None:
            in_turn[..., k, :, :], state = lag(state, path[k], turns.duration[k] / PATH_STEPS / times)
    return at_rest, in_turn


def _play_lag(middle: Array, force: Array, _: Array) -> tuple[Array, Array]:
    """Return where the forces (steps, n) are in their play, −1 … 1, and the middle of the play after them."""
    middles = np.empty_like(force)
    for j, (low, high) in enumerate(zip(force - PLAY, force + PLAY, strict=True)):
        middles[j] = middle = np.minimum(np.maximum(middle, low), high)
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


# ---- errors that are not linear in force and rate


def products(session: LinearisedSession) -> Iterator[Candidate]:
    """Yield products of forces that are not parameters: cross products in accelerometers, all products in gyros."""
    about = session.linearised.about
    for kind, block in session.kinds:
        accel, first = kind == "accel", 0 if kind == "accel" else session.accel.size
        chosen = [b for b, pair in enumerate(PAIRS, start=PRODUCTS.start) if pair[0] != pair[1] or not accel]
        beta = functions(block, session.force, session.rate)[:, 0, chosen]
        n, q = block.size, block.size * len(chosen)
        rest, turn = session.zero_columns(q)
        rest[:, first : first + n] = np.einsum("nb,ps->npsb", beta, np.eye(n)).reshape(len(rest), n, q)
        if about is not None and accel:
            session.set_velocity(turn, about.by_force[..., chosen].reshape(len(turn), 3, q))
        elif about is not None:
            turn[:, :3] = about.by_phi[..., chosen].reshape(len(turn), 3, q)
        yield Candidate(
            name="cross products" if accel else "g² sensitivity",
            concerns=(kind,),
            columns=(rest, turn),
            unit=_per_g(kind, 2),
            sentences=[
                Advised(
                    f"{SENSORS[kind]} that read products of forces, by {{size}}",
                    "take more oblique rests, or use it near the attitudes of the session",
                )
            ],
        )


def gyro_nonlinearity(session: LinearisedSession, about: IntegratedTurns, gyro: Block) -> Candidate:
    """Return scale factors of gyros that vary with the square of the rate."""
    duration = np.maximum(about.moments.T, SHORTEST_TURN)[:, None]
    square = about.moments.body_rates[:, [0, 3, 5]] / duration @ (gyro.axes**2).T
    rest, turn = session.zero_columns(gyro.size)
    turn[:, :3], velocity = (
        np.einsum("kipb,pb,kp->kip", by[..., RATE], gyro.axes, square) for by in (about.by_phi, about.by_velocity)
    )
    session.set_velocity(turn, velocity)
    return Candidate(
        name="gyro nonlinearity",
        concerns=("gyro",),
        columns=(rest, turn),
        unit=(1e-6 / (10.0 * DEGREE) ** 2, "ppm at 10 °/s"),
        sentences=[
            Advised(
                "scale factors of the gyros that depend on the rate, by {size}",
                "turn at the rates of use, at one rate, or make them parameters by gyro_cubic in [device.prior]",
            )
        ],
    )


# ---- errors of the site and of the clock


def earth_rate_errors(session: LinearisedSession) -> Iterator[Candidate]:
    """Yield an error of the latitude, rad, and a relative error of the clock of the log.

    If a second of the log lasts 1 + ε s, the angles of turns are larger by ε, which is the effect of scale factors of
    the gyros; velocities change as by lever arms and delays. Only the Earth's rate, (1 + ε) Ω in the log's seconds,
    shows it. The rows are linear in its components along north and up. An error of the latitude moves them along a
    circle, and its column is the chord to the latitude that fits best, however far the stated one is off."""
    latitude, rows = session.observations.site.latitude, session.linearised
    assert latitude is not None
    stated, step = session.problem.earth, 1e-4 * EARTH_RATE
    components = list[tuple[Array, Array]]()  # of a rate northward and upward
    for axis in np.eye(3)[:2]:
        changed = linearise(replace(session.problem, earth=stated + step * axis), rows.point, rows.about)
        rest, turn = (np.subtract(*each) / step for each in zip(rows.residuals, changed.residuals, strict=True))
        components.append((rest, turn))
    north_up = np.stack([each[0] for each in components], axis=2), np.stack([each[1] for each in components], axis=2)
    latitudes = np.append(np.linspace(-0.5 * np.pi, 0.5 * np.pi, 1801), latitude + 1e-4)
    changes = np.array([earth_rate(each) for each in latitudes.tolist()])[:, :2] - stated[:2]
    chi_square = np.zeros(len(changes))
    for each in projections(rows, VarianceComponents(), *north_up):
        chi_square += ((each.residual - changes * each.length @ each.triangle.T) ** 2).sum(axis=1)
    best = int(np.argmin(chi_square))
    chord = changes[best] / (latitudes[best] - latitude)
    rest, turn = (each @ chord for each in north_up)

    yield Candidate(
        name="latitude",
        concerns=(),
        columns=(rest[..., None], turn[..., None]),
        unit=(DEGREE, "°"),
        sentences=[
            Advised(
                "a latitude that the gyros contradict by {size}",
                f"look at latitude_deg in [site], and its sign; about {latitudes[best] / DEGREE:z.0f}° would fit",
            )
        ],
        largest_u=EARTH_RATE_U,
    )
    by_clock = {name: size for name, size in session.observations.by_clock.items() if name == group_name(name)}
    u = max(map(abs, by_clock.values()), default=1.0)
    yield Candidate(
        name="clock",
        concerns=(),
        columns=(north_up[0] @ stated[:2, None], north_up[1] @ stated[:2, None]),
        unit=(1e-2, "%"),
        sentences=[
            Advised(
                "a clock of the log that the Earth's rate contradicts by {size}",
                "look at rate_hz, or the time column and its unit, in [log]",
            )
        ],
        largest_u=EARTH_RATE_U,
        direct={group: (size / u, size) for group, size in by_clock.items()},
    )


# ---- rounding, which needs no columns


def quantisation(session: LinearisedSession, s: int) -> Iterator[Finding]:
    """Yield kinds of sensors of session s whose rounding errors are large beside the noise of the mean of a rest."""
    rests = session.problem.parts[s].rests
    for kind, _ in session.kinds:
        rounding = session.observations.rounding.get(kind)
        if rounding is None or not rounding.common_u.any():
            continue
        covariance = getattr(session.observations.rests, f"{kind}_covariance")[rests]
        variance = np.median(np.diagonal(covariance, axis1=1, axis2=2), axis=0) - rounding.rest_u**2
        coarse = rounding.common_u > COARSE_ROUNDING * np.sqrt(np.maximum(variance, 0.0))
        if coarse.any():
            worst = int(np.argmax(np.where(coarse, rounding.common_u, 0.0)))
            step, error = float(rounding.step[worst]), float(rounding.common_u[worst])
            scale, unit = BIAS_UNITS[kind]
            yield Finding(
                causes=("quantisation",),
                concerns=(kind,),
                sentence=Advised(
                    f"steps of the {SENSORS[kind]} of {two_digits(step / scale)} {unit}, too coarse for the noise of a "
                    f"reading, {two_digits(rounding.noise[worst] / scale)} {unit}, to average their rounding out: the "
                    f"mean of a rest errs by up to {two_digits(error / scale)} {unit}",
                    "log with more digits, or use a smaller range",
                ),
            )
