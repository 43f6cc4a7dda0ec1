"""Recordings of which a part is bad: what is refused by name, what is left, and what is said."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import polars as pl
import pytest
import scipy

import tumble
from tumble.advice import found_in
from tumble.recording.arrays import session_of_arrays
from tumble.recording.session import Exclusion, Session
from tumble.result.calibration import Calibration
from tumble.result.further import accepted_groups
from tumble.run.launches import calibrate_launches
from tumble.simulation.session import read_truth
from tumble.units import DEGREE, Array

SITE = {"latitude": 56.84 * DEGREE, "height": 270.0, "gravity": 9.815788295915675, "gravity_u": 1e-7}


@dataclass(frozen=True, kw_only=True, eq=False)
class Recorded:
    """A recording by hand of a MEMS device: its folder, truth, rests (start, stop), s, and samples, SI."""

    folder: Path
    truth: dict[str, float]
    rests: list[tuple[float, float]]
    time: Array
    accel: Array
    gyro: Array

    def session(self, *, accel: Array | None = None, gyro: Array | None = None, **more: object) -> Session:
        """The session with other samples or another site."""
        given = SITE | {"accel": self.accel if accel is None else accel, "time": self.time} | more
        return session_of_arrays(**(given | {"gyro": self.gyro if gyro is None else gyro}))  # type: ignore[arg-type]

    def errors(self, made: Calibration, kind: str = "accel", what: Sequence[str] = ("bias", "scale", "axis")) -> Array:
        """Errors in u of linear parameters."""
        names = [p.name for p in made.parameters if p.name.startswith(f"{kind}.") and p.name.count(".") == 2]
        linear = [name for name in names if name.split(".")[1] in what]
        return np.array([(made[n].value - self.truth[n]) / (made[n].u or np.nan) for n in linear])


@pytest.fixture(scope="module")
def hand(tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    folder = tmp_path_factory.mktemp("hand") / "s"
    tumble.simulate_session(folder, tumble.Setup.of(grade="mems", positions=18), seed=1)
    log = pl.read_parquet(folder / "log.parquet")
    return Recorded(
        folder=folder,
        truth=read_truth(folder / "truth.json"),
        rests=[(r.start, r.stop) for r in tumble.inspect_session(folder).segmentation.rests],
        time=log["t"].to_numpy(),
        accel=log.select("ax", "ay", "az").to_numpy(),
        gyro=log.select("gx", "gy", "gz").to_numpy(),
    )


def jumped(hand: Recorded, size: float, after: int) -> Array:
    """Gyros whose biases change by so much, °/s, after so many rests."""
    at = 0.5 * (hand.rests[after - 1][1] + hand.rests[after][0])
    return hand.gyro + np.outer(hand.time > at, size * DEGREE * np.array([0.6, -0.48, 0.64]))


@pytest.mark.parametrize(("kind", "size"), [("gyro", 0.03 * DEGREE), ("gyro", 0.1 * DEGREE), ("accel", 0.1)])
def test_a_jump_of_one_sensor_is_no_wander_and_is_named_where_it_is(hand: Recorded, kind: str, size: float) -> None:
    """In-run biases that are large enough follow it, and a drift was named as the cause."""
    at = 0.5 * (hand.rests[8][1] + hand.rests[9][0])
    readings = getattr(hand, kind) + np.outer(hand.time > at, [0.0, size, 0.0])
    made = tumble.calibrate(hand.session(**{kind: readings}))
    said = [one for one in (*made.outcome.reasons, *made.outcome.remarks) if "jump" in one]
    assert any("after rest 9 " in one for one in said), made.outcome


@pytest.mark.parametrize("seed", [5, 6])
def test_rows_lost_without_time_stamps_are_no_jump_that_no_rest_shows(seed: int, tmp_path: Path) -> None:
    setup = tumble.Setup.of(grade="mems", positions=14, sample_rate=50.0)
    log = pl.read_parquet(tumble.simulate_session(tmp_path / "s", setup, seed=seed) / "log.parquet")
    log = log.filter(np.random.default_rng(seed).uniform(size=log.height) > 0.005)
    accel, gyro = (log.select(f"{kind}{axis}" for axis in "xyz").to_numpy() for kind in "ag")
    made = tumble.calibrate(accel=accel, gyro=gyro, rate=50.0, latitude=SITE["latitude"], height=SITE["height"])
    said = [*made.outcome.reasons, *made.outcome.remarks]
    assert any("samples are missing or held" in one for one in said)
    assert not any("biases of the gyros jump" in one for one in said)


@pytest.mark.parametrize("size", [0.3, 1.0, 3.0])
def test_a_jump_of_the_gyros_is_named_and_spoils_their_biases_alone(hand: Recorded, size: float) -> None:
    made = tumble.calibrate(hand.session(gyro=jumped(hand, size, 9)))
    assert (made.outcome.accel.accepted, made.outcome.gyro.accepted) == (True, False)
    assert accepted_groups(made) == ("gyro.scale", "gyro.axis")
    (said,) = [reason for reason in made.outcome.gyro.reasons if "jump" in reason]
    assert "after rest 9 " in said or "between rest 9 (" in said
    assert "[[exclude]]" in said
    assert len(made.evidence.rests) == len(hand.rests)
    assert np.abs(hand.errors(made)).max() < 4.0
    assert np.abs(hand.errors(made, "gyro", ("scale", "axis"))).max() < 4.0


def test_methods_without_a_process_of_biases_refuse_gyros_that_jump(tmp_path: Path) -> None:
    setup = tumble.Setup.of(grade="mems", rest=10.0, sample_rate=50.0)
    folder = tumble.simulate_session(tmp_path / "table", setup, seed=4)
    log = pl.read_parquet(folder / "log.parquet")
    late = pl.col("t") > 0.6 * pl.col("t").max()
    log.with_columns(pl.when(late).then(pl.col("gx") + 0.02).otherwise(pl.col("gx")).alias("gx")).write_parquet(
        folder / "log.parquet"
    )
    made = tumble.calibrate(folder, method="scalar")
    assert (made.outcome.accel.accepted, made.outcome.gyro.accepted) == (True, False)
    assert accepted_groups(made) == ()
    assert made.gyro is None


def test_accelerometers_that_gyros_would_spoil_are_estimated_alone(hand: Recorded) -> None:
    bent = hand.gyro * (1.0 + 0.01 * (hand.gyro / (100.0 * DEGREE)) ** 2)
    made = tumble.calibrate(hand.session(gyro=bent))
    assert (made.outcome.accel.accepted, made.outcome.gyro.accepted) == (True, False)
    (why,) = made.outcome.gyro.reasons
    assert why.startswith("scale factors of the gyros that depend on the rate")
    assert found_in(why).endswith("the accelerometers are estimated alone")
    assert np.abs(hand.errors(made)).max() < 4.0


def test_the_parts_before_and_after_a_jump_are_launches_of_one_log(hand: Recorded) -> None:
    whole = hand.session(gyro=jumped(hand, 1.0, 9))
    at = 0.5 * (hand.rests[8][1] + hand.rests[9][0])
    ends = (0.0, at), (at, float(hand.time[-1]))
    parts = [replace(whole, excluded=(Exclusion(start=start, stop=stop, reason="jump"),)) for start, stop in ends]
    made = calibrate_launches(parts, terms="linear")
    assert made.outcome.accepted
    assert len(made.evidence.launches) == 2
    change = [
        made.evidence.launches[1].parameters[i].value - made.evidence.launches[0].parameters[i].value
        for i in range(9, 12)
    ]
    names = [made.evidence.launches[0].parameters[i].name for i in range(9, 12)]
    assert names == ["gyro.bias.x", "gyro.bias.y", "gyro.bias.z"]
    moved = np.linalg.norm(np.abs(change)) / DEGREE
    assert moved == pytest.approx(1.0, abs=0.05)


def test_a_quiet_stretch_that_is_not_used_is_said_with_its_time_and_why(hand: Recorded) -> None:
    session = hand.session(gyro=jumped(hand, 1.0, 17))
    (said,) = [note for note in tumble.calibrate(session).provenance.notes if note.startswith("not used as rests")]
    (inspected,) = tumble.inspect_session(session).segmentation.unused()
    assert said == inspected
    start, stop = (float(word) for word in said.split()[4].split("–"))
    assert hand.rests[17][0] - 1.0 < start < stop
    assert "the gyros read 1 °/s off their level at rest" in said


@pytest.mark.parametrize("soft", [False, True])
@pytest.mark.parametrize("width", [0.02, 0.15, 0.5])
def test_a_dead_zone_is_named_and_the_gyros_are_refused(hand: Recorded, width: float, soft: bool) -> None:
    zone = width * DEGREE
    beyond = hand.gyro - zone * np.sign(hand.gyro) if soft else hand.gyro
    made = tumble.calibrate(hand.session(gyro=np.where(np.abs(hand.gyro) < zone, 0.0, beyond)))
    assert made.outcome.accel.accepted
    assert any("a dead zone of the driver" in reason for reason in made.outcome.gyro.reasons)


@pytest.mark.parametrize("beyond", [1.5, 2.3])
def test_a_dead_zone_that_cuts_a_tail_of_the_noise_is_named(hand: Recorded, beyond: float) -> None:
    """Of gyros with a bias of so many standard deviations more than its width."""
    at_rest = hand.gyro[hand.time < hand.rests[0][1]]
    zone = beyond * at_rest.std(axis=0)
    gyro = hand.gyro - at_rest.mean(axis=0) + zone + 0.5 * DEGREE
    gyro = np.where(np.abs(gyro) < 0.5 * DEGREE, 0.0, gyro)
    assert "a dead zone of the driver" in tumble.inspect_session(hand.session(gyro=gyro)).gyro_faults[0]


@pytest.mark.parametrize("step", [1e-4, 2e-3, 0.01])
def test_coarse_gyros_have_no_dead_zone(hand: Recorded, step: float) -> None:
    rounded = step * np.round(hand.gyro / step)
    assert tumble.inspect_session(hand.session(gyro=rounded)).gyro_faults == ()


def test_normalised_accelerometers_are_a_fault_with_and_without_gyros(hand: Recorded) -> None:
    unit = 9.80665 * hand.accel / np.linalg.norm(hand.accel, axis=1, keepdims=True)
    session = hand.session(accel=unit)
    for each in (session, replace(session, log=replace(session.log, gyro=None))):
        (fault,) = tumble.inspect_session(each).faults
        assert "a driver has normalised them" in fault
    assert tumble.calibrate(hand.session(accel=unit), terms="linear").outcome.verdict == "not accepted"
    assert tumble.inspect_session(hand.session()).faults == ()


@pytest.mark.parametrize("digits", [3, 6])
def test_normalised_accelerometers_may_be_rounded(hand: Recorded, digits: int) -> None:
    unit = (9.80665 * hand.accel / np.linalg.norm(hand.accel, axis=1, keepdims=True)).round(digits)
    (fault,) = tumble.inspect_session(hand.session(accel=unit)).faults
    assert "normalised" in fault


@pytest.mark.parametrize("size", [0.05, 0.1, 0.2])
def test_vibration_across_gravity_is_no_normalisation(hand: Recorded, size: float) -> None:
    """By a fan, of so many g in a direction that is horizontal in every attitude."""
    across = np.cross(hand.accel, [0.36, 0.48, 0.8])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    shaken = hand.accel + 9.8 * size * np.sin(2.0 * np.pi * 23.3 * hand.time)[:, None] * across
    assert tumble.inspect_session(hand.session(accel=shaken)).faults == ()


def test_stamps_of_bursts_are_those_of_even_rows(hand: Recorded) -> None:
    """Ten samples are read at once, late by about 5 ms, and spread over the time since the last ten; where rows are
    missing the stamps stay as they are."""
    n = len(hand.time) // 10 * 10
    read = hand.time[9:n:10] + 0.005 * np.abs(np.random.default_rng(5).standard_normal(n // 10))
    before = np.concatenate([[0.0], read[:-1]])
    stamps = (before[:, None] + np.outer(read - before, np.arange(1, 11) / 10)).ravel()
    even, burst = (
        tumble.calibrate(hand.session(accel=hand.accel[:n], gyro=hand.gyro[:n], time=time))
        for time in (hand.time[:n], stamps)
    )
    assert burst.outcome.verdict == even.outcome.verdict == "accepted"
    assert any("time stamps are those of bursts" in note for note in burst.provenance.notes)
    for name in ("gyro.scale.x", "gyro.axis.xy", "accel.scale.z"):
        assert burst[name].value == pytest.approx(even[name].value, abs=0.3 * (even[name].u or 0.0))
    kept = np.delete(np.arange(n), slice(n // 2, n // 2 + 30))
    torn = hand.session(accel=hand.accel[kept], gyro=hand.gyro[kept], time=stamps[kept])
    assert not tumble.inspect_session(torn).notes


@pytest.mark.parametrize("constant", [0.2, 1.0, 5.0])
def test_gyros_behind_a_high_pass_filter_leave_the_accelerometers(hand: Recorded, constant: float) -> None:
    a = float(np.exp(-np.diff(hand.time).mean() / constant))
    filtered = scipy.signal.lfilter([a, -a], [1.0, -a], hand.gyro - hand.gyro[0], axis=0)
    made = tumble.calibrate(hand.session(gyro=filtered))
    assert (made.outcome.accel.accepted, made.outcome.gyro.accepted) == (True, False)
    assert any("a high-pass filter on the chip or in the driver" in reason for reason in made.outcome.gyro.reasons)
    assert np.abs(hand.errors(made)).max() < 4.0


def test_accelerometers_late_by_another_time_in_each_turn_are_no_lost_samples(hand: Recorded) -> None:
    late, rng = np.zeros(len(hand.time)), np.random.default_rng(2)
    for (_, start), (stop, _) in pairwise(hand.rests):
        late[(hand.time > start) & (hand.time < stop)] = rng.uniform(0.0, 0.02)
    accel = np.column_stack([np.interp(hand.time - late, hand.time, column) for column in hand.accel.T])
    made = tumble.calibrate(hand.session(accel=accel))
    assert made.outcome.gyro.accepted
    assert np.abs(hand.errors(made, "gyro")).max() < 4.0


def test_a_level_of_the_gyros_that_steps_after_the_last_rest_is_no_jump(hand: Recorded) -> None:
    """Three stretches follow in which the device is tilted slowly, too far for a rest."""
    dt, rng = float(np.diff(hand.time).mean()), np.random.default_rng(4)
    accel, gyro = [hand.accel], [hand.gyro]
    for up in (hand.accel[0], hand.accel[len(hand.time) // 2], -hand.accel[0]):
        across = np.cross(up, [0.3, 0.4, 0.6])
        tilt = 0.35 * DEGREE * np.arange(0.0, 15.0, dt)[:, None]
        still = np.cos(tilt) * up + np.sin(tilt) * across * np.linalg.norm(up) / np.linalg.norm(across)
        blow = 3.0 * rng.standard_normal((round(2.0 / dt), 3))
        accel += [up + blow, still + 0.01 * rng.standard_normal(still.shape)]
        rates = hand.gyro[rng.integers(0, round(hand.rests[0][1] / dt), len(still))]
        gyro += [blow, rates + np.array([1.3, 0.6, 0.0]) * DEGREE]
    a, g = np.concatenate(accel), np.concatenate(gyro)
    found = tumble.inspect_session(hand.session(accel=a, gyro=g, time=dt * np.arange(1, len(a) + 1)))
    assert found.segmentation.jump is None
    assert len(found.segmentation.rests) == len(hand.rests)


def leaning(hand: Recorded) -> Array:
    """Accelerometers that were touched in the sixth rest."""
    start, stop = hand.rests[5]
    return hand.accel + np.outer((hand.time > start - 0.1) & (hand.time < stop + 0.1), [0.03, 0.0, 0.02])


def test_a_small_jump_of_the_gyros_is_in_the_process_of_their_biases(hand: Recorded) -> None:
    made = tumble.calibrate(hand.session(gyro=jumped(hand, 0.05, 9)))
    assert made.outcome.accepted
    assert np.abs(hand.errors(made)).max() < 4.0


def test_a_rest_that_was_touched_is_left_out_and_said(hand: Recorded) -> None:
    made = tumble.calibrate(hand.session(accel=leaning(hand)))
    assert made.outcome.accel.accepted
    assert any(remark.startswith("rest 6 ") and "was left out" in remark for remark in made.outcome.remarks)
    assert np.abs(hand.errors(made)).max() < 4.0
    assert tumble.calibrate(hand.session(accel=leaning(hand)), without=[6]).outcome.accepted
    again = tumble.calibrate(hand.session(), without=[6])
    assert again.outcome.verdict == "accepted"
    assert "with what was left out: accepted" in again.provenance.notes


def test_a_latitude_that_may_be_in_radians_is_noted(hand: Recorded) -> None:
    made = tumble.calibrate(accel=hand.accel, gyro=hand.gyro, time=hand.time, latitude=float(np.radians(0.8395)))
    assert "latitude 0.8395° as stated; 48.1° if radians were meant" in made.provenance.notes
    assert not any("radians" in remark for remark in made.outcome.remarks)


def test_without_a_place_everything_is_given_with_gravity_in_u(hand: Recorded) -> None:
    made = tumble.calibrate(accel=hand.accel, gyro=hand.gyro, time=hand.time)
    assert made.outcome.verdict == "accepted with scatter"
    (said,) = made.outcome.remarks
    assert said.endswith("state latitude_deg and height_m in [site] (--latitude, --height), or gravity")
    assert not any("gravity" in sentence for sentence in made.provenance.assumptions)
    assert made.outcome.gyro.verdict == "accepted"
    scales = [made[f"accel.scale.{axis}"].u or 0.0 for axis in "xyz"]
    assert 0.0030 < min(scales) < max(scales) < 0.0034
    assert np.abs(hand.errors(made)).max() < 4.0


def six_faces(rng: np.random.Generator) -> tuple[Array, Array, dict[str, float]]:
    """Accelerometers at 100 Hz for five seconds on each face, to 1°, and three on the way; and their parameters."""
    bias, scale, g = rng.normal(0.0, 0.03, 3), rng.normal(0.0, 0.005, 3), SITE["gravity"]
    ups = np.vstack([np.eye(3), -np.eye(3)]) + 0.017 * rng.standard_normal((6, 3))
    path = [np.tile(ups[0], (500, 1))]
    for before, after in pairwise(ups):
        share = 0.5 - 0.5 * np.cos(np.pi * np.linspace(0.0, 1.0, 300))[:, None]
        path += [before + share * (after - before) + 0.3 * share * (1.0 - share), np.tile(after, (500, 1))]
    up = np.vstack(path)
    force: Array = g * up / np.linalg.norm(up, axis=1, keepdims=True)
    sheared = np.eye(3) + np.tril(rng.normal(0.0, 3e-3, (3, 3)), -1)
    read: Array = (1.0 + scale) * (force @ sheared.T) + bias + rng.normal(0.0, 0.02, force.shape)
    true = {f"accel.{what}.{a}": v[i] for what, v in (("bias", bias), ("scale", scale)) for i, a in enumerate("xyz")}
    time: Array = 0.01 * np.arange(1.0, 1.0 + len(read))
    return time, read, true


def test_six_faces_give_bias_and_scale_of_each_axis_and_say_what_is_absent(tmp_path: Path) -> None:
    time, accel, true = six_faces(np.random.default_rng(2))
    made = tumble.calibrate(session_of_arrays(accel=accel, time=time, **SITE))  # type: ignore[arg-type]
    assert [p.name for p in made.parameters] == list(true)
    assert made.outcome.verdict == "accepted with scatter"
    assert "six faces give bias and scale factor of each axis alone" in made.outcome.remarks[0]
    assert made.outcome.unobservable == ("accel.axis.yx", "accel.axis.zx", "accel.axis.zy")
    z = [(p.value - true[p.name]) / (p.u or np.nan) for p in made.parameters]
    assert np.abs(z).max() < 3.0
    made.write(tmp_path / "c.json")
    again = tumble.read_calibration(tmp_path / "c.json")
    assert again.provenance.absent == made.provenance.absent
    assert tumble.export_calibration(again, "csv").losses[0].startswith("accel.axis.yx, accel.axis.zx, accel.axis.zy")
    force, _ = again.apply(accel[:400])
    assert abs(np.linalg.norm(force.mean(axis=0)) - SITE["gravity"]) < 1e-3


def described(samples: dict[str, Array], gyro: dict[str, object] | None = None) -> Session:
    """A session in memory of accelerometers in m/s², with or without gyros in counts."""
    log: dict[str, object] = {"time": "t", "accel": {"columns": ["ax", "ay", "az"], "unit": "m/s^2"}}
    if gyro is not None:
        log["gyro"] = {"columns": ["gx", "gy", "gz"], "unit": "count", "scale_per": "deg/s"} | gyro
    site = {"gravity": SITE["gravity"], "gravity_u": SITE["gravity_u"]}
    return tumble.session_of({"format": 1, "device": {"serial": "A"}, "site": site, "log": log}, samples)


def test_gyros_in_counts_of_an_unknown_scale_do_not_throw_out_rests() -> None:
    """Fourteen counts of 131 per °/s between attitudes were 14 °/s off their level at rest."""
    rng = np.random.default_rng(2)
    time, accel, true = six_faces(rng)
    up = accel / np.linalg.norm(accel, axis=1, keepdims=True)
    counts = np.round([-550.0, 110.0, -70.0] + 14.0 * up + 4.0 * rng.standard_normal(accel.shape))
    samples = {"t": time} | dict(zip(("ax", "ay", "az"), accel.T, strict=True))
    gyros = dict(zip(("gx", "gy", "gz"), counts.T, strict=True))
    made = tumble.calibrate(described(samples | gyros, {"offset": [-550.0, 110.0, -70.0]}))
    alone = tumble.calibrate(described(samples))
    assert len(made.evidence.rests) == 6
    assert [(p.name, p.value, p.u) for p in made.parameters] == [(p.name, p.value, p.u) for p in alone.parameters]
    assert [p.name for p in made.parameters] == list(true)
    assert "the scale of the counts of the gyros is not stated" in made.provenance.notes[-1]


@pytest.mark.parametrize("part", [0.0, 0.1])
def test_an_axis_that_level_faces_contradict_is_in_u_and_said(part: float) -> None:
    """z reads +0.9 and −1.1 g, and 0 at level: z was −99.9 ± 1.6 mg, and x and y 5 u off, accepted."""
    rng = np.random.default_rng(7)
    force = np.repeat(np.vstack([np.eye(3), -np.eye(3)]), 400, axis=0) + 2e-3 * np.repeat(
        rng.standard_normal((6, 3)), 400, 0
    )
    force *= SITE["gravity"] / np.linalg.norm(force, axis=1, keepdims=True)
    read = force + 0.02 * rng.standard_normal(force.shape)
    read[:, 2] -= part / SITE["gravity"] * force[:, 2] ** 2
    time = np.repeat(10.0 * np.arange(6.0), 400) + 0.01 * np.tile(np.arange(400.0), 6)
    made = tumble.calibrate(described({"t": time} | dict(zip(("ax", "ay", "az"), read.T, strict=True))))
    said = [remark for remark in made.outcome.remarks if "beside its bias on all faces" in remark]
    assert len(said) == (part > 0.0)
    assert ("accel.bias.z" in made.outcome.unobservable) == (part > 0.0)
    for name in ("accel.scale.x", "accel.scale.y"):
        assert abs(made[name].value) < 1.5 * (made[name].u or 0.0)
        assert (made[name].u or 0.0) < (0.008 if part else 0.003)


def between_rests(hand: Recorded, change: Callable[[int], Array]) -> Array:
    """Gyros that are changed in the turn after each rest."""
    out = hand.gyro.copy()
    for number, ((_, start), (stop, _)) in enumerate(pairwise(hand.rests)):
        out[(hand.time > start + 0.2) & (hand.time < stop - 0.2)] += change(number)
    return out


def test_bad_turns_leave_good_rests_their_accelerometers(hand: Recorded) -> None:
    rng = np.random.default_rng(5)
    made = tumble.calibrate(hand.session(gyro=between_rests(hand, lambda _: 0.05 * rng.standard_normal(3))))
    assert made.outcome.accel.reasons == ()
    assert any("turns scatter" in reason for reason in made.outcome.gyro.reasons)
    assert np.abs(hand.errors(made)).max() < 4.0


def test_a_check_that_nothing_explains_says_so_first_and_blames_the_turns(hand: Recorded) -> None:
    made = tumble.calibrate(hand.folder)
    rng = np.random.default_rng(6)
    bad = hand.session(gyro=between_rests(hand, lambda _: 0.05 * rng.standard_normal(3)), serial=made.serial)
    found = tumble.check_calibration(made, bad)
    assert found.rests_agree
    (said,) = found.reasons
    assert said.startswith("no change of biases, scale factors or axes explains the session, so that it says nothing")
    assert "its turns, or gyros that drift between rests, do not" in said
