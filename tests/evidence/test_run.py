"""The runner, the scores and the drift watch of the benchmark."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import cast

import numpy as np
import pytest

from evidence import programs, run, tumble_methods, work
from evidence.case import NAMES, Case, Estimate, Program, Refusal, matrix_of
from evidence.drift import compared, told
from evidence.score import Row, as_expected, row_of, score_of
from evidence.simulated.kinds import KINDS, named, simulated
from evidence.state import FOLDER, files_of, source_of
from tumble.campaigns.cluster import executor_for
from tumble.campaigns.engine import Done

pytestmark = pytest.mark.weekly

EXPECTED = {kind.name: (kind.expected, kind.says) for kind in KINDS}
KIND_NAMES = ("hand-8", "cube-alone", "in-g")


@pytest.fixture(autouse=True)
def cache(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """No test reads what was computed before."""
    monkeypatch.setattr(work, "CACHE", tmp_path / "cache")


def computed(kinds: Sequence[str] = KIND_NAMES, **options: object) -> run.Results:
    return run.computed("short", kinds=kinds, workers=1, memory=False, **options)  # type: ignore[arg-type]


# -------------------- scores --------------------


def answered(error_in_u: float, verdict: str = "accepted", u: float = 1e-3) -> tuple[Case, Estimate]:
    """A case, and an estimate that is off in accel.bias.x by so many u, elsewhere not."""
    case = simulated(named("hand-8"), 0, "test")
    assert case.truth is not None
    found = dict(case.truth) | {"accel.bias.x": case.truth["accel.bias.x"] + error_in_u * u}
    biases = [np.array([found[f"{kind}.bias.{axis}"] for axis in "xyz"]) for kind in ("accel", "gyro")]
    u_of = dict.fromkeys(NAMES, u)
    return case, Estimate(
        accel=matrix_of(found, "accel"), accel_bias=biases[0], gyro=matrix_of(found, "gyro"), gyro_bias=biases[1],
        u=u_of, expanded=dict.fromkeys(NAMES, 2.0 * u), verdict=verdict,
    )  # fmt: skip


def test_a_row_has_errors_over_u_and_intervals() -> None:
    row = row_of(answered(2.5)[0], "some", answered(2.5)[1])
    assert row.z["accel.bias.x"] == pytest.approx(2.5, rel=1e-3)
    assert max(abs(z) for name, z in row.z.items() if name != "accel.bias.x") < 1e-9
    assert (row.covered, row.intervals) == (20, 21)
    assert row.errors["accel.bias"][0] == pytest.approx(2.5e-3 / np.sqrt(3.0), rel=1e-3)
    assert not row.silent_wrong
    assert Row.from_content(json.loads(json.dumps(row.content()))) == row


@pytest.mark.parametrize(("verdict", "silent"), [("accepted", True), ("accepted with scatter; biases wander", False)])
def test_silently_wrong_is_accepted_without_a_remark_and_beyond_four_u(verdict: str, silent: bool) -> None:
    case, found = answered(-4.5, verdict)
    row = row_of(case, "some", found)
    assert row.worst[0] == "accel.bias.x"
    assert row.worst[1] == pytest.approx(-4.5, rel=1e-3)
    assert row.silent_wrong == silent
    assert not row_of(case, "some", replace(found, accepted=False)).silent_wrong


def test_scores_are_sums_over_rows_that_may_be_used() -> None:
    rows = [row_of(case, "some", found) for case, found in map(answered, (0.0, 2.5, 3.5))]
    refused = row_of(answered(0.0)[0], "some", Refusal(reason="too few rests"))
    score = score_of([*rows, refused], EXPECTED)
    assert score.sessions == 4
    assert score.verdicts == {"accepted": 3, "gave up": 1}
    assert score.as_expected == 3
    assert score.beyond_2 == pytest.approx(2 / 63)
    assert score.beyond_3 == pytest.approx(1 / 63)
    assert score.rms == pytest.approx(np.sqrt((2.5**2 + 3.5**2) / 63), rel=1e-3)
    assert score.covered == pytest.approx(61 / 63)
    assert 0.0 < score.left["accel.bias"] < 1.0
    assert score_of([refused]).rms is None


def test_a_verdict_is_held_against_what_is_expected() -> None:
    case, found = answered(0.0)
    accepted = row_of(case, "some", found)
    wanders = replace(
        accepted, verdict="with scatter", said="accepted with scatter; biases of the gyros wander by 5°/h"
    )
    gave_up = replace(accepted, verdict="gave up", said="the gyros are clipped")
    assert as_expected(accepted, "accept", "")
    assert not as_expected(wanders, "accept", "")
    assert as_expected(wanders, "accept with scatter", "wander")
    assert not as_expected(wanders, "accept with scatter", "temperature")
    assert as_expected(gave_up, "name the cause", "clip")
    assert not as_expected(gave_up, "name the cause", "memory")
    assert as_expected(gave_up, "refuse", "")
    assert not as_expected(accepted, "refuse", "")


# -------------------- the runner --------------------


def test_two_runs_are_the_same_to_the_bit(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    one = computed()
    monkeypatch.setattr(work, "CACHE", tmp_path / "another")
    other = computed()
    assert one.rows == other.rows
    assert json.dumps(one.scores()) == json.dumps(other.scores())
    assert len(one.rows) == len(KIND_NAMES) * len(programs.PROGRAMS)


def test_processes_of_a_cluster_make_what_one_process_makes(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    one = computed(("hand-8", "in-g"), programs=("tumble joint",))
    monkeypatch.setattr(work, "CACHE", tmp_path / "another")
    entries = [e for e in run.entries_of("short", 1) if e.kind in ("hand-8", "in-g")]
    with executor_for(workers=2) as processes:
        (client,) = cast("partial[Iterator[Done]]", processes).args
        told = work.answers([(entry, ["tumble joint"]) for entry in entries], scheduler=client.scheduler.address)
    assert tuple(Row.from_content(each.content) for each in told.values()) == one.rows


def test_a_run_goes_on_where_it_was_stopped(monkeypatch: pytest.MonkeyPatch) -> None:
    done: list[int] = []
    tried = work.tried

    def counted(make: Callable[[], Case], tell: work.Tell, names: Sequence[str]) -> list[dict[str, object]]:
        done.append(1)
        return tried(make, tell, names)

    monkeypatch.setattr(work, "tried", counted)
    computed(("hand-8",))
    computed(("hand-8", "cube-alone"))
    assert len(done) == 2


def test_what_a_program_hangs_on_is_its_own_file_and_what_it_imports() -> None:
    """Whatever changes in tumble, or in one peer, leaves what the other peers made as it is."""

    def files(module: str) -> set[str]:
        return {path.relative_to(FOLDER).as_posix() for path in files_of(module)}

    assert files("evidence.peers.imu_tk") == {"peers/imu_tk.py", "peers/rests.py", "case.py"}
    assert files("evidence.tumble_methods") == {"tumble_methods.py", "case.py"}
    for program in programs.PROGRAMS:
        module = getattr(program.estimate, "func", program.estimate).__module__
        assert module.startswith("evidence.tumble_methods" if program.ours else "evidence.peers."), program.name
    assert source_of("imu_tk") != source_of("Magneto")
    assert source_of("tumble joint") == source_of("tumble ellipsoid")


def test_an_error_of_a_program_is_its_result() -> None:
    def broken(_: Case) -> Estimate:
        raise ZeroDivisionError("by nothing")

    bad = Program(name="broken", needs=frozenset(), estimate=broken, source="")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(programs, "PROGRAMS", (bad,))
        row = work.tried(lambda: answered(0.0)[0], run.told_of, ["broken"])[0]["told"]
    assert row["verdict"] == "gave up"
    assert "ZeroDivisionError" in row["said"]


def test_results_say_of_what_they_are_and_are_read_again(tmp_path: Path) -> None:
    assert run.main(["short", "--kinds", "in-g", "--workers", "1", "--programs", "tumble joint",
                     "--out", str(tmp_path), "--no-memory"]) == 0  # fmt: skip
    found = run.Results.read(tmp_path / "short.json")
    assert {"commit", "date", "machine", "series", "sessions", "kinds"} <= set(found.made)
    assert found.made["sessions"] == len(found.rows) == 1
    assert found.text() == (tmp_path / "short.json").read_text(encoding="utf-8")


@pytest.mark.parametrize("index", [0, 1])
def test_a_wrong_hemisphere_is_named_at_middle_latitudes_without_a_programme(index: int) -> None:
    """Where the horizontal part of the Earth's rate is as large as the vertical one, which g-sensitivity can take."""
    case = simulated(named("wrong-hemisphere"), index, "test")
    assert case.latitude is not None
    for latitude, accepted in ((case.latitude, False), (-case.latitude, True)):
        row = row_of(case, "joint", programs.named("tumble joint").calibrate(replace(case, latitude=latitude)))
        assert ("latitude" in row.said) != accepted
        assert (row.verdict == "accepted") == accepted


# -------------------- recordings of other kinds --------------------


def test_other_kinds_are_run_by_their_programs_and_read_again(tmp_path: Path) -> None:
    found = run.computed("further", sessions=1, kinds=["gyros", "warming"], workers=1, memory=False)
    by_program = {(row.kind, row.program): row for row in found.rows}
    assert {program for _, program in by_program} == {program.name for program in programs.FURTHER}
    assert by_program["gyros", "imu_tk"].verdict == "cannot run"
    assert by_program["gyros", "tumble joint"].verdict == "accepted"
    assert abs(by_program["gyros", "tumble joint"].z["gyro.bias.x"]) < 4.0
    warming = by_program["warming", "tumble joint"]
    assert set(warming.errors) >= {"accel.change", "gyro.change"}
    assert warming.errors["gyro.change"][0] < by_program["warming", "PX4 thermal"].errors["gyro.change"][0]
    assert {name.split(".")[1] for name in warming.z} == {"thermal"}
    path = tmp_path / "further.json"
    path.write_text(found.text(), encoding="utf-8")
    assert run.Results.read(path).rows == found.rows


def test_a_magnetometer_is_calibrated_with_the_others() -> None:
    case = simulated(named("mag-turns"), 0, "test")
    row = row_of(case, "tumble joint", programs.named("tumble joint").calibrate(case))
    assert row.verdict == "accepted", row.said
    mag = [z for name, z in row.z.items() if name.startswith("mag.")]
    assert len(mag) == 12
    assert np.sqrt(np.mean(np.square(mag))) < 2.0
    assert row.errors["mag.bias"][0] < 0.1


# -------------------- the drift watch --------------------


def worsened(case: Case, by: float) -> Estimate:
    """What tumble finds, with the scale factors of the accelerometers by so many u wrong."""
    found = tumble_methods.estimate(case, "joint")
    assert found.accel is not None
    assert found.u is not None
    off = np.array([by * found.u[f"accel.scale.{axis}"] for axis in "xyz"])
    return replace(found, accel=found.accel * (1.0 + off)[:, None])


@pytest.fixture(scope="module")
def released() -> list[Row]:
    kinds = ("hand-8", "hand-12", "cube-26", "cube-alone", "hand-alone", "in-g")
    cases = [simulated(named(kind), 0, "test") for kind in kinds]
    return [row_of(case, "tumble joint", programs.named("tumble joint").calibrate(case)) for case in cases]


def test_nothing_moves_where_nothing_changed(released: list[Row]) -> None:
    assert compared(released, released, EXPECTED) == []
    assert told([]) == "nothing moved"


def test_an_estimate_that_is_worsened_is_named(released: list[Row]) -> None:
    bad = Program(name="tumble joint", needs=frozenset(), estimate=partial(worsened, by=6.0), source="")
    cases = [simulated(named(row.kind), 0, "test") for row in released]
    moved = compared(released, [row_of(case, bad.name, bad.calibrate(case)) for case in cases], EXPECTED)
    worse = {each.score for each in moved if each.worse}
    assert {"left of the errors, logarithm", "mean square of z"} <= worse
    (silent,) = (each for each in moved if each.score == "silently wrong")
    assert len(silent.cases) == 5
    assert "worse: tumble joint, mean square of z" in told(moved)


def test_u_that_is_stated_too_small_is_named_and_too_wide_is_not_for_the_worse(released: list[Row]) -> None:
    def by(factor: float) -> list[Row]:
        return [replace(row, z={name: factor * z for name, z in row.z.items()}) for row in released]

    small, wide = compared(released, by(1.4), EXPECTED), compared(released, by(0.7), EXPECTED)
    assert [each.worse for each in small if each.score == "mean square of z"] == [True]
    assert not any(each.worse for each in wide)


def test_a_good_recording_that_is_refused_is_named(released: list[Row]) -> None:
    changed = [replace(released[0], verdict="not accepted", said="poorly observable"), *released[1:]]
    (moved,) = (m for m in compared(released, changed, EXPECTED) if m.score == "verdicts as expected")
    assert moved.cases == ("hand-8 0 (accepted, now not accepted)",)
    assert not moved.worse  # one of six: chance


def test_an_error_of_the_program_is_worse_even_once(released: list[Row]) -> None:
    changed = [replace(released[0], verdict="gave up", said="failed, ImportError: no such module"), *released[1:]]
    (moved,) = (m for m in compared(released, changed, EXPECTED) if m.score == "ends in an error")
    assert moved.worse
    assert not any(m.worse for m in compared(changed, released, EXPECTED))


def test_changes_within_rounding_are_none_that_matter(released: list[Row]) -> None:
    other = [replace(row, z={name: z * (1.0 + 1e-4) for name, z in row.z.items()}) for row in released]
    assert not any(each.beyond for each in compared(released, other, EXPECTED))
