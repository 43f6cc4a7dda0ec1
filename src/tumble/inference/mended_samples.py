"""Replacement of suspect samples of turns, where the turn closes better without them.

A sample far off its neighbours may be corrupt, or a blow: a device that is put down at 0.1 m/s stops within a sample or
two, along the axis of one accelerometer if it stands on a face. The samples alone do not distinguish the two
(`tumble.reduction.rests.blemishes`), but the turn does. It begins and ends at rest, so that with calibrated sensors

    φ = û_a × C û_b = 0,    Δv = ∫ C f dt − g T û_a = 0,

û being the vertical at the rests a and b, C the rotation, f the specific force in the axes of the body at a and T the
duration. A blow stops the velocity of the approach: without it Δv is that velocity. A corrupt sample of force adds its
size times the interval to Δv; one of rate adds an angle to φ, and through it a velocity.

A suspect that is too large for a blow is replaced in any case. The parameters are those of the linear model at a robust
maximum, at first from turns in which all suspects are replaced, which lack blows but contain no corrupt sample, then
from those that result. With Q = |φ|²/σ_φ² + |Δv|²/σ_v² of a turn, σ² being medians over the turns, all suspects of a
turn are replaced at first unless Q is smaller by ALIKE with the recorded samples. Then runs of suspects are replaced or
put back one by one if Q falls, until none changes (at most ROUNDS times).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tumble.inference.lag import maximum_with_lags
from tumble.inference.maximum import MAX_ITERATIONS, without_outliers
from tumble.inference.problem import NO_PRIOR, Problem, instruments_of
from tumble.inference.start import initial_linearisation
from tumble.reduction.observations import Observations
from tumble.reduction.rests.blemishes import BadSamples, bad_sample_notes
from tumble.reduction.turns.turns import linear_compensation
from tumble.rotation import unit_vector
from tumble.units import Array, BoolArray, IntArray

ANGLE, VELOCITY = 1.0, 5.0  # rad, m/s: larger than a blow causes in a sample; a fall from 1.3 m ends with 5 m/s
ROUNDS = 3  # passes over all suspects, and fits; the second undoes what another suspect, or the first fit, caused
ALIKE = 4.0  # difference of Q, two standard deviations, up to which suspects are replaced: it is noise
MOST_RUNS = 12  # runs of suspects in one turn that are judged one by one; if there are more, all together


def with_mended_samples(observations: Observations) -> Observations:
    """Return observations in which suspect samples are replaced only where their turns close better without them.

    In the observations given, of one session, all suspects are replaced. A note names the turns with replaced samples.
    The same observations are returned if no parameters can be estimated."""
    if observations.turn_samples is None or not len(observations.turn_samples.bad.at):
        return observations
    suspects, samples = observations.turn_samples.bad, observations.turn_samples.samples
    impossible = np.zeros(len(suspects.at), dtype=bool)
    for i, at in enumerate(suspects.at.tolist()):
        rates, forces, dt = samples.read(at, at + 1)
        deviation = np.hstack([rates[0], forces[0]]) - suspects.values[i]
        angle, velocity = (float(np.abs(part).max() * dt[0]) for part in np.split(deviation, 2))
        impossible[i] = not (angle <= ANGLE and velocity <= VELOCITY)
    replaced = np.ones_like(impossible)
    starts = (np.diff(suspects.at) > 1) | (np.diff(suspects.turn) > 0)
    runs = np.concatenate([[0], np.cumsum(starts)])  # of consecutive samples in one turn
    for _ in range(0 if impossible.all() else ROUNDS):
        before, mended = replaced, observations.with_bad_samples(_chosen(suspects, replaced))
        try:
            with np.errstate(over="ignore", invalid="ignore"):
                replaced = impossible | _closing_best(mended, suspects, runs, impossible)[runs]
        except np.linalg.LinAlgError:
            return observations
        if np.array_equal(replaced, before):
            break
    if replaced.all():
        return observations
    assert observations.turns is not None
    bad, first = _chosen(suspects, replaced), observations.turns.first
    others = [note for note in observations.notes if note not in bad_sample_notes(suspects, first)]
    return replace(observations.with_bad_samples(bad), notes=(*others, *bad_sample_notes(bad, first)))


def _closing_best(mended: Observations, suspects: BadSamples, runs: IntArray, impossible: BoolArray) -> BoolArray:
    """Return True for the runs (r,) of suspects to replace, by parameters from the turns of `mended`; the `impossible`
    (m,) are replaced in any case."""
    linear = replace(mended, usual={})
    instrument, local = instruments_of(linear)
    problem = Problem.of(linear, NO_PRIOR, instrument=instrument, local=local, usual={})
    fitted, _ = maximum_with_lags(initial_linearisation(problem), MAX_ITERATIONS)
    if fitted.converged:
        fitted = without_outliers(fitted)
    turns, samples, gyro = linear.turns, linear.turn_samples, linear.gyro_block
    assert turns is not None
    assert samples is not None
    assert gyro is not None
    accel_model, gyro_model = problem.accel_model(fitted.point.values), problem.gyro_model(fitted.point.values)
    compensation = linear_compensation(gyro, gyro_model, linear.accel_block, accel_model)
    vertical = unit_vector(accel_model.apply(linear.rests.accel))
    before, after = vertical[turns.first], vertical[turns.last]

    def misclosure(replaced: BoolArray) -> tuple[Array, Array]:
        """Return |φ|², rad², and |Δv|², m²/s² (K,)."""
        bad = _chosen(suspects, replaced[runs] | impossible)
        moments = replace(linear, turn_samples=replace(samples, bad=bad)).moments_about(compensation)
        φ = np.cross(before, (moments.C @ after[:, :, None])[:, :, 0])
        Δv = moments.V - linear.site.gravity * moments.T[:, None] * before
        return (φ**2).sum(axis=1), (Δv**2).sum(axis=1)

    count = int(runs[-1]) + 1
    turn_of = suspects.turn[np.searchsorted(runs, np.arange(count))]
    run_in_turn = np.arange(count) - np.searchsorted(turn_of, turn_of)
    run_in_turn[np.bincount(turn_of)[turn_of] > MOST_RUNS] = 0
    replaced = np.zeros(count, dtype=bool)
    with_all, with_none = misclosure(~replaced), misclosure(replaced)
    noise = [float(np.median(np.trace(C, axis1=1, axis2=2))) for C in (turns.covariance, turns.velocity_covariance)]
    variance_φ, variance_v = (np.median(np.minimum(with_all[i], with_none[i])) + noise[i] for i in (0, 1))

    def weighed(misclosures: tuple[Array, Array]) -> Array:
        """Return Q (K,)."""
        return np.asarray(misclosures[0] / variance_φ + misclosures[1] / variance_v)

    Q, Q_all = weighed(with_none), weighed(with_all)
    all_at_first = ~(Q_all >= Q + ALIKE)  # also if either is NaN
    replaced, Q = all_at_first[turn_of], np.where(all_at_first, Q_all, Q)
    for _ in range(ROUNDS):
        settled = True
        for n in range(int(run_in_turn.max()) + 1):
            tried = replaced ^ (run_in_turn == n)
            Q_tried = weighed(misclosure(tried))
            better = Q_tried < Q
            taken = better[turn_of] & (run_in_turn == n)
            settled &= not taken.any()
            replaced, Q = np.where(taken, tried, replaced), np.where(better, Q_tried, Q)
        if settled:
            break
    return replaced


def _chosen(suspects: BadSamples, which: BoolArray) -> BadSamples:
    """Return the suspects with `which` True."""
    return BadSamples(at=suspects.at[which], turn=suspects.turn[which], values=suspects.values[which])
