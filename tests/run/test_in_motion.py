"""Recordings of a device that never lies still, calibrated from node to node."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import tumble
from tests.support.moving import G, Motion, Noise, Recording, lay, record
from tests.support.plain_rows import plain_rows
from tumble.diagnosis.verdict import unused_quiet_time
from tumble.errors import InputError
from tumble.inference.integrated_turns import IntegratedTurns
from tumble.inference.joint import joint
from tumble.inference.linearisation import linearise
from tumble.inference.problem import Point, Problem, instruments_of
from tumble.inference.start import initial_linearisation
from tumble.recording.arrays import session_of_arrays
from tumble.reduction.observations import Observations
from tumble.result.calibration import Calibration
from tumble.run.observed import inspect_session, observations_for_calibration, with_grade
from tumble.units import Array
from tumble.views.calibration import calibration_blocks
from tumble.views.render.terminal import text_of

PIVOT = Motion()
HAND = Motion(sway=0.1, frequency=0.6, lever=(0.0, 0.0, 0.0))


def calibrated(recording: Recording) -> Calibration:
    """The calibration of a recording at an unknown place of known gravity."""
    return tumble.calibrate(
        accel=recording.accel, gyro=recording.gyro, time=np.arange(len(recording.gyro)) / recording.rate, gravity=G,
        gravity_u=1e-4, serial="A",
    )  # fmt: skip


def errors(recording: Recording, calibration: Calibration) -> Array:
    """Errors over u of the 21 parameters."""
    out = []
    for kind, matrix, bias in (
        ("accel", recording.accel_matrix, recording.accel_bias),
        ("gyro", recording.gyro_matrix, recording.gyro_bias),
    ):
        truth = {f"{kind}.bias.{a}": bias[k] for k, a in enumerate("xyz")}
        truth |= {f"{kind}.scale.{a}": matrix[k, k] - 1.0 for k, a in enumerate("xyz")}
        truth |= {
            f"{kind}.axis.{a}{b}": matrix[k, j] for k, a in enumerate("xyz") for j, b in enumerate("xyz") if j != k
        }
        out += [(p.value - truth[p.name]) / p.u for p in calibration.parameters if p.name in truth]
    assert len(out) == 21
    return np.array(out)


@pytest.mark.parametrize("motion", [PIVOT, HAND, replace(HAND, rests=4)], ids=["pivot", "hand", "hand with rests"])
def test_a_device_that_is_moved_is_calibrated(motion: Motion) -> None:
    """Motion that is not the process of the estimate (harmonics), of instruments with errors beyond the linear model:
    N = 4 recordings of 120 s, every parameter within 6 u, and together within 2 u, root mean square."""
    every = []
    for seed in range(4):
        recording = record(motion, seed, further=1.0)
        calibration = calibrated(recording)
        assert calibration.outcome.verdict == "accepted", calibration.outcome
        every.append(errors(recording, calibration))
    assert np.abs(every).max() < 6.0
    assert np.sqrt(np.mean(np.square(every))) < 2.0


FACES = np.array([[0, 0, 1], [0, 0, -1], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]], dtype=float)


def in_motion(calibration: Calibration) -> bool:
    """Whether the note of a result says that it is from motion."""
    return any(note.startswith("calibrated in motion") for note in calibration.provenance.notes)


def test_a_device_laid_by_hand_on_its_faces_is_calibrated_by_rests_and_turns() -> None:
    """N = 8 recordings of 6 faces, 4 of 5 and 4 of 7 positions, lifted by 15 cm: no parameter but gyro biases, which
    wander, off by 4 u, together 1.2 u; from 6 faces on u of accel.scale below 400 ppm, and below 4 times the errors.

    From node to node a cubic term of 134 times the usual size followed the way by hand: -30600 ± 5300 ppm."""
    every, scale, scale_u = [], [], []
    for number, seeds in ((6, 8), (5, 4), (7, 4)):
        for seed in range(seeds):
            order = np.random.default_rng(seed).permutation(6)
            recording = lay(np.vstack([FACES[order], [[0.7, 0.7, 0.0]]])[:number], seed)
            calibration = calibrated(recording)
            assert calibration.outcome.accel.accepted, calibration.outcome
            assert not in_motion(calibration)
            z = errors(recording, calibration)
            u = np.array([p.u for p in calibration.parameters if p.name.startswith("accel.scale.")][:3])
            every.append(np.delete(z, slice(9, 12)))
            if number >= 6:
                scale += (z[3:6] * u).tolist()
                scale_u += u.tolist()
    assert np.abs(every).max() < 4.0
    assert np.sqrt(np.mean(np.square(every))) < 1.2
    assert max(scale_u) < 400e-6
    assert np.median(scale_u) < 4.0 * np.sqrt(np.mean(np.square(scale)))


def test_a_well_known_correlation_time_needs_few_points() -> None:
    """A hand that sways slowly: its correlation time of 3 s is known to a tenth, and the first points are enough."""
    recording = record(replace(HAND, frequency=0.2), 2)
    calibration = calibrated(recording)
    integral = calibration.evidence.integral
    assert integral is not None
    assert integral.points < 100
    assert np.abs(errors(recording, calibration)).max() < 6.0


def test_motion_in_one_place_adds_to_rests_that_would_suffice() -> None:
    """Six pauses in two minutes on a pivot: u of accelerometer axes is a third of that of rests and turns, or less."""
    recording = record(replace(PIVOT, rests=6), 0, further=1.0)
    calibration = calibrated(recording)
    assert in_motion(calibration)
    assert np.abs(errors(recording, calibration)).max() < 6.0
    session = session_of_arrays(
        accel=recording.accel, gyro=recording.gyro, time=np.arange(len(recording.gyro)) / recording.rate, gravity=G,
        gravity_u=1e-4,
    )  # fmt: skip
    at_rest = observations_for_calibration(inspect_session(session), joint=True, motion=False)
    assert isinstance(at_rest, Observations)
    assert at_rest.links is None
    by_rests = joint(with_grade(session, at_rest), intervals=False)
    axes = [i for i, name in enumerate(by_rests.names) if name.startswith("accel.axis.")]
    u = np.array([p.u for p in calibration.parameters if p.name.startswith("accel.axis.")])
    assert np.all(u < by_rests.u[axes] / 3.0)


def test_the_linear_model_has_what_it_leaves_out_in_motion_too() -> None:
    """Every parameter within 6 u."""
    recording = record(PIVOT, 3)
    arrays: dict[str, Any] = {
        "accel": recording.accel,
        "gyro": recording.gyro,
        "time": np.arange(len(recording.gyro)) / recording.rate,
    }
    linear = tumble.calibrate(**arrays, gravity=G, gravity_u=1e-4, serial="A", terms="linear")
    assert linear.outcome.verdict == "accepted"
    assert np.abs(errors(recording, linear)).max() < 6.0


def test_other_methods_than_joint_want_rests() -> None:
    recording = record(replace(PIVOT, seconds=30.0), 3)
    arrays: dict[str, Any] = {"accel": recording.accel, "gyro": recording.gyro, "rate": recording.rate}
    outcome = tumble.calibrate(**arrays, method="ellipsoid", serial="A").outcome
    assert not outcome.accepted
    assert outcome.reasons[0].startswith("no rest found")


def test_the_lever_is_found() -> None:
    """The place of the accelerometers from the pivot, within 3 mm, in the note of the result."""
    (note,) = (
        note for note in calibrated(record(PIVOT, 5)).provenance.notes if note.startswith("calibrated in motion")
    )
    found = [float(x) for x in note.rpartition("(")[2].partition(")")[0].split(",")]
    np.testing.assert_allclose(found, [100.0, 50.0, -30.0], atol=3.0)


@pytest.mark.parametrize("motion", [replace(PIVOT, follows=0.01), replace(PIVOT, bends=0.015)], ids=["sags", "bends"])
def test_a_stand_that_gives_way_is_among_the_unknowns(motion: Motion) -> None:
    recording = record(motion, 2)
    z = errors(recording, calibrated(recording))
    assert np.sqrt((z**2).mean()) < 1.4
    assert np.abs(z).max() < 3.5


def test_little_motion_is_refused_with_what_would_help() -> None:
    calibration = calibrated(record(replace(HAND, seconds=30.0, rate=np.radians(10.0)), 1))
    outcome, shown = calibration.outcome, text_of(calibration_blocks(calibration), 100)
    assert not outcome.accepted
    assert "calibrated in motion" not in shown
    assert "rests and turns that were found" not in shown
    assert "30 s of motion do not determine accel.bias" in outcome.reasons[0]
    assert "turn it for two minutes" in outcome.reasons[0]


def moving(seed: int = 2) -> Observations:
    """Observations of a device on a pivot."""
    recording = record(replace(PIVOT, seconds=30.0), seed)
    session = session_of_arrays(
        accel=recording.accel, gyro=recording.gyro, rate=recording.rate, latitude=0.9, gravity=G, gravity_u=1e-3
    )
    observations = observations_for_calibration(inspect_session(session), joint=True)
    assert isinstance(observations, Observations)
    return observations


def test_rows_of_links_are_derivatives_of_their_residuals() -> None:
    """Every column of attitudes, velocities, lever, what holds the device, gravity and the parameters against
    differences, at a point that is not the start, and where what holds the device does not give way."""
    observations = moving()
    problem = Problem.of(observations, instrument=instruments_of(observations)[0], usual=observations.usual)
    start, rng = initial_linearisation(problem), np.random.default_rng(1)
    M, m, q = len(problem.chain), len(problem.instrument.names), len(problem.local_u)
    point = start.point.moved(
        np.append(1e-3, 1e-3 * problem.spread * rng.normal(size=m)), 1e-3 * rng.normal(size=(M, 3)),
        np.append(0.03 * rng.normal(size=3), np.zeros(q - 3))[None], 0.1 * rng.normal(size=(M, 3)), np.zeros((M, 3)),
    )  # fmt: skip
    integrated = IntegratedTurns.of(observations, problem.instrument, point.values)
    rows, n = plain_rows(linearise(problem, point, integrated)), 6

    def residuals(at: Point) -> Array:
        return np.asarray(linearise(problem, at, integrated).rows["link"][:, :, -1])

    def moved(parameters: Array, angles: Array, local: Array, velocities: Array) -> Array:
        """By how much the predictions move, by central differences."""
        step = 1e-4
        there, back = (
            residuals(point.moved(s * parameters, s * angles, s * local, s * velocities)) for s in (step, -step)
        )
        return (back - there) / (2.0 * step)

    links, nothing = observations.links, (np.zeros(1 + m), np.zeros((M, 3)), np.zeros((1, q)), np.zeros((M, 3)))
    assert links is not None
    i = links.before
    for k in range(3):
        angles, velocities = np.zeros((M, 3)), np.zeros((M, 3))
        angles[::2, k], velocities[::2, k] = 1.0, 1.0
        even = (i % 2 == 0)[:, None]
        got = moved(nothing[0], angles, nothing[2], nothing[3])
        expected = np.where(even, rows.link[:, :, k], rows.link[:, :, n + k])
        np.testing.assert_allclose(got, expected, atol=2e-5)
        got = moved(nothing[0], nothing[1], nothing[2], velocities)
        np.testing.assert_allclose(got, np.where(even, rows.link[:, :, 3 + k], rows.link[:, :, 9 + k]), atol=1e-8)
    for k in range(q):
        local = np.zeros((1, q))
        local[0, k] = 1.0
        got = moved(nothing[0], nothing[1], local, nothing[3])
        np.testing.assert_allclose(got, rows.link[:, :, 19 + m + k], atol=1e-8)
    for k in range(m + 1):
        parameters = np.zeros(1 + m)
        parameters[k] = 1.0 if k == 0 else problem.spread[k - 1]
        got = moved(parameters, *nothing[1:]) / parameters[k]
        size = np.abs(rows.link[:, :, 18 + k]).max() + 1e-12
        np.testing.assert_allclose(got / size, rows.link[:, :, 18 + k] / size, atol=0.03)


def test_a_heading_changes_nothing_where_the_place_is_unknown() -> None:
    """All attitudes turned about the vertical: residuals of the links to 1e-9."""
    observations = moving()
    observations = replace(observations, site=replace(observations.site, latitude=None))
    problem = Problem.of(observations, instrument=instruments_of(observations)[0], usual=observations.usual)
    here = initial_linearisation(problem)
    turned = here.point.moved(
        np.zeros(1 + len(here.point.values)), np.tile([0.0, 0.0, 0.7], (len(problem.chain), 1)),
    )  # fmt: skip
    there = linearise(problem, turned, here.integrated)
    np.testing.assert_allclose(there.rows["link"][:, :, -1], here.rows["link"][:, :, -1], atol=1e-9)


TACTICAL = Noise(accel=5e-4, gyro=np.radians(8e-4), accel_in_run=1e-4, gyro_in_run=np.radians(1.0 / 3600.0))


@pytest.mark.parametrize("seed", [6, 13])
def test_gyros_that_see_the_earth_in_motion_start_to_the_north(seed: int) -> None:
    """The heading of the first node, within 0.7 rad at the start. By steps of the estimate alone that of these two was
    2.8 and 0.8 rad off in the end, and gyro biases three times as uncertain."""
    latitude = 0.84
    recording = record(PIVOT, seed, noise=TACTICAL, errors=0.1, latitude=latitude)
    session = session_of_arrays(
        accel=recording.accel, gyro=recording.gyro, rate=recording.rate, latitude=latitude, gravity=G, gravity_u=1e-4
    )
    observations = observations_for_calibration(inspect_session(session), joint=True)
    assert isinstance(observations, Observations)
    problem = Problem.of(observations, instrument=instruments_of(observations)[0], usual=observations.usual)
    turned = initial_linearisation(problem).point.attitudes[0] @ recording.attitudes[0].T  # about the vertical
    assert abs(np.arctan2(turned[0, 2], turned[0, 0])) < 0.7


def test_enough_rests_are_rests() -> None:
    """A recording of nine rests and more has turns, and no links."""
    recording = record(replace(PIVOT, seconds=120.0, rests=12, sway=0.0), 4)
    session = session_of_arrays(accel=recording.accel, gyro=recording.gyro, rate=recording.rate, latitude=0.9)
    found = observations_for_calibration(inspect_session(session), joint=True)
    assert isinstance(found, Observations)
    assert (found.links is None) == (len(found.rests) >= 9)


def test_a_device_that_is_shaken_where_it_lies_is_not_in_motion() -> None:
    """Twelve rests beside a fan near the sample rate: the gyros are at rest, and gravity seems to wander.
    Its aliased shaking is not followed from node to node; what is shaken of fewer rests is a remark."""
    recording = record(replace(PIVOT, seconds=120.0, rests=12, sway=0.0), 4, rate=50.0)
    beat = 3.0 * np.sin(2.0 * np.pi * 0.4 * np.arange(len(recording.accel)) / 50.0)
    shaken = replace(recording, accel=recording.accel + recording.attitudes[:, 2] * beat[:, None])
    outcome = calibrated(shaken).outcome
    assert not outcome.accepted
    assert outcome.reasons[0].startswith("no rest found")
    assert "are shaken: the gyros are at rest, the accelerometers are not" in outcome.reasons[0]
    session = session_of_arrays(accel=shaken.accel, gyro=shaken.gyro, rate=50.0, gravity=G)
    found = inspect_session(session).segmentation
    assert len(found.shaken) == 12
    assert unused_quiet_time(found, in_motion=True)
    assert not unused_quiet_time(replace(found, rejected=()), in_motion=True)


def moved_observations(recording: Recording, keep: Array | None = None) -> Observations:
    """The observations of a recording, or of the samples that were kept."""
    time = np.arange(len(recording.gyro)) / recording.rate
    some = np.ones(len(time), dtype=bool) if keep is None else keep
    session = session_of_arrays(
        accel=recording.accel[some], gyro=recording.gyro[some], time=time[some], gravity=G, gravity_u=1e-4
    )
    found = observations_for_calibration(inspect_session(session), joint=True)
    assert isinstance(found, Observations)
    return found


@pytest.mark.parametrize(("tremor", "held"), [(0.0, 0.0), (0.2, 1e-3), (0.5, 2e-3), (1.0, 5e-3)])
def test_a_device_that_is_put_down_rests_and_one_that_pauses_in_the_hand_does_not(tremor: float, held: float) -> None:
    """Four pauses of 3 s in 120 s: a twentieth of the time is quiet. A hand trembles by 0.2 to 1 °/s."""
    motion = replace(HAND, rests=4, tremor=np.radians(tremor), held=held)
    for seed in range(2):
        found = moved_observations(record(motion, seed))
        assert found.links is not None
        assert len(found.rests) == (4 if tremor == 0.0 else 0)
        paused = [note for note in found.notes if note.startswith("held in the hand in ")]
        assert len(found.rests) == 4 or paused or tremor > 0.2  # a larger tremor is not quiet at all


def test_rests_on_a_table_are_better_than_pauses_in_the_hand() -> None:
    """u of all accelerometer biases; and both within 6 u."""
    table, hand = (
        record(replace(HAND, rests=4, tremor=tremor, held=held), 1) for tremor, held in ((0.0, 0.0), (0.01, 2e-3))
    )
    u = []
    for recording in (table, hand):
        calibration = calibrated(recording)
        assert np.abs(errors(recording, calibration)).max() < 6.0
        u.append([p.u for p in calibration.parameters if p.name.startswith("accel.bias.")][:3])
    assert np.all(np.array(u[0]) < 0.9 * np.array(u[1]))


WILD = 9137
"""A sample in the middle of the motion."""


@pytest.mark.parametrize(("kind", "size"), [("accel", 100.0), ("accel", 10.0), ("gyro", 10.0), ("gyro", 1.0)])
def test_a_wild_sample_costs_the_link_it_falls_in(kind: str, size: float) -> None:
    recording = record(PIVOT, 3)
    wild = getattr(recording, kind).copy()
    wild[WILD, 1] += size
    sound, found = (moved_observations(each) for each in (recording, replace(recording, **{kind: wild})))
    assert sound.links is not None
    assert found.links is not None
    lost = set(sound.links.before.tolist()) - set(found.links.before.tolist())
    (link,) = lost
    assert sound.links.time[link] < WILD / recording.rate < sound.links.time[link + 1]
    assert len(found.links) == len(sound.links) - 1
    assert sound.links.bad_samples == 0
    assert any(note.startswith("1 bad sample in motion") for note in found.notes)


def test_a_gap_costs_the_link_it_falls_in() -> None:
    """0.2 s that are missing."""
    recording = record(PIVOT, 3)
    keep = np.ones(len(recording.gyro), dtype=bool)
    keep[WILD : WILD + 40] = False
    sound, found = moved_observations(recording), moved_observations(recording, keep)
    assert sound.links is not None
    assert found.links is not None
    assert len(sound.links) - 2 <= len(found.links) < len(sound.links)


def test_a_wild_sample_does_not_move_the_result() -> None:
    """By less than 2 u of any parameter, where u grows by less than a tenth (by 235 u before)."""
    recording = record(PIVOT, 4)
    wild = recording.accel.copy()
    wild[WILD, 1] += 100.0
    sound, found = calibrated(recording), calibrated(replace(recording, accel=wild))
    assert [p.name for p in sound.parameters] == [p.name for p in found.parameters]
    u = np.array([p.u for p in sound.parameters])
    moved = np.array([p.value - q.value for p, q in zip(found.parameters, sound.parameters, strict=True)])
    assert np.abs(moved / u).max() < 2.0
    np.testing.assert_allclose(np.array([p.u for p in found.parameters]), u, rtol=0.1)


@pytest.mark.parametrize(("motion", "kelvin"), [(replace(PIVOT, seconds=40.0), 6.0), (replace(HAND, rests=4), 6.0)])
def test_warmth_in_motion_is_said(motion: Motion, kelvin: float) -> None:
    """A change by several K is a remark, and is no parameter, with or without rests; a tenth of a kelvin is neither."""
    recording = record(motion, 3)
    n = len(recording.gyro)
    for change in (kelvin, 0.1):
        calibration = tumble.calibrate(
            accel=recording.accel, gyro=recording.gyro, rate=recording.rate, gravity=G, gravity_u=1e-4, serial="A",
            temperature=298.0 + change * np.arange(n) / n,
        )  # fmt: skip
        notes = [note for note in calibration.provenance.notes if "temperature changed by" in note]
        assert len(notes) == (change > 1.0)
        assert all("biases are followed in time" in note for note in notes)
        assert not any(".t1" in p.name for p in calibration.parameters)


def test_sessions_in_motion_are_launches_and_no_one_estimate() -> None:
    sessions = []
    for seed in (1, 2):
        made = record(replace(PIVOT, seconds=30.0), seed)
        warmth = np.full(len(made.gyro), 298.0)
        sessions.append(
            session_of_arrays(
                accel=made.accel, gyro=made.gyro, rate=made.rate, temperature=warmth, gravity=G, serial="A"
            )
        )
    with pytest.raises(InputError, match=r"expected rests, found a device in motion; .* as launches"):
        tumble.calibrate_together(sessions)
