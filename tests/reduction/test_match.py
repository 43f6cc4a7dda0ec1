"""Rests and the positions of a programme: what fits is matched, and what does not is named."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tumble.errors import ProgrammeError
from tumble.planning.setup import Setup
from tumble.programme.positions import ANY_MOVE, Programme, programme
from tumble.recording.log import Chunk
from tumble.recording.session import Channels, Device, ListedPosition, LogSpec, ProgrammeSpec, Session, Site
from tumble.reduction.blocks.reducer import Reducer, Reduction
from tumble.reduction.rests.matching import match_rests
from tumble.reduction.rests.segmentation import Segmentation, find_rests
from tumble.rotation import rotation_matrix
from tumble.sensors.model import Block
from tumble.simulation.recording import Recording, record
from tumble.simulation.scenario import scenario_of
from tumble.units import ACCEL_UNITS, DEGREE, GYRO_UNITS, Array

RATE = 20.0
ACCEL, GYRO = Block(kind="accel", axes=np.eye(3)), Block(kind="gyro", axes=np.eye(3))
ROUGH = programme("rough-table")
NORTH = np.array([1.0, 0.0, 0.0])


def recorded(
    course: Programme,
    *,
    grade: str = "mems",
    table_error: float = 2.0,
    seed: int = 61,
    rest: float = 5.0,
    turning: float = 40.0,
) -> Recording:
    """A short session of a course on a table with errors of so many degrees."""
    scenario = scenario_of(Setup.of(grade=grade), np.random.default_rng(seed), serial="S")
    scenario = scenario.changed(
        programme=course,
        table_error=table_error * DEGREE,
        mounting_error=table_error * DEGREE,
        first_rest=rest,
        rest=rest,
        turn_rate=turning * DEGREE,
        ramp=0.5,
        sample_rate=RATE,
    )
    return record(scenario, np.random.default_rng(seed))


def session_of(spec: ProgrammeSpec | None, *, gyros: bool = True) -> Session:
    def channels(kind: str) -> Channels:
        return Channels(
            columns=(f"{kind}x", f"{kind}y", f"{kind}z"),
            unit=ACCEL_UNITS["m/s^2"] if kind == "a" else GYRO_UNITS["rad/s"],
            unit_name="m/s^2" if kind == "a" else "rad/s",
            scale=np.ones(3),
            offset=np.zeros(3),
            axes=np.eye(3),
            range=None,
        )

    return Session(
        folder=Path(),
        device=Device(serial="S", model=None, systematic=None),
        site=Site(latitude=56.84 * DEGREE, height=0.0, gravity=9.8159, gravity_u=0.0),
        log=LogSpec(
            files=(Path("log.csv"),),
            time="t",
            time_factor=1.0,
            rate=None,
            accel=channels("a"),
            gyro=channels("g") if gyros else None,
            temperature=None,
        ),
        programme=spec,
    )


def reduced(recording: Recording, accel: Array | None = None, *, gyros: bool = True) -> Reduction:
    reducer = Reducer(rate=RATE, accel=ACCEL, gyro=GYRO if gyros else None)
    count = len(recording.time)
    reducer.feed(
        Chunk(
            file=0,
            time=recording.time,
            dt=np.full(count, 1.0 / RATE),
            accel=recording.accel if accel is None else accel,
            gyro=recording.gyro if gyros else None,
            temperature=None,
        )
    )
    return reducer.now()


def matched(recording: Recording, spec: ProgrammeSpec | None, *, gyros: bool = True) -> Segmentation:
    reduction = reduced(recording, gyros=gyros)
    segmentation = find_rests(reduction, ACCEL, GYRO if gyros else None)
    return match_rests(session_of(spec, gyros=gyros), reduction, segmentation)


def named(name: str) -> ProgrammeSpec:
    return ProgrammeSpec(name=name)


def listed(codes: Sequence[str]) -> ProgrammeSpec:
    return ProgrammeSpec(position=[ListedPosition(attitude=code) for code in codes])


def course(indices: Sequence[int]) -> Programme:
    """These positions of the rough table, reached in any way."""
    positions = tuple(ROUGH.positions[i] for i in indices)
    return replace(ROUGH, positions=positions, moves=(ANY_MOVE,) * (len(positions) - 1))


# -------------------- what fits --------------------


@pytest.mark.parametrize("grade", ["navigation", "consumer"])
@pytest.mark.parametrize("seed", [62, 63, 64])
def test_a_rough_table_is_matched(grade: str, seed: int) -> None:
    """Tables and mountings off by up to 2° about every axis, accelerometers off by up to 0.3 m/s²."""
    match = matched(recorded(ROUGH, grade=grade, seed=seed), named("rough-table"))
    assert match.position is not None
    assert match.programme is not None
    assert match.programme.name == ROUGH.name
    assert [p.label for p in match.programme.positions] == [p.label for p in ROUGH.positions]
    np.testing.assert_array_equal(match.position, np.arange(15))


def test_without_a_programme_all_rests_are_used() -> None:
    match = matched(recorded(ROUGH), None)
    assert len(match.rests) == 15
    assert match.programme is None
    assert match.position is None


def test_positions_listed_by_their_codes_are_matched() -> None:
    codes = ("NUE", "ENU", "UEN N+45", "NUE N+180")
    match = matched(recorded(_listed_course(codes)), listed(codes))
    assert match.position is not None
    np.testing.assert_array_equal(match.position, np.arange(4))


def _listed_course(codes: Sequence[str]) -> Programme:
    from tumble.programme.positions import from_attitudes

    return from_attitudes(codes)


def test_a_cube_is_matched_in_any_order() -> None:
    for seed in (65, 66, 67):
        recording = recorded(programme("cube-14"), seed=seed)
        match = matched(recording, named("cube-14"))
        assert match.position is not None
        np.testing.assert_array_equal(match.position, recording.positions)
        assert sorted(recording.positions) == list(range(14))


def test_a_knock_that_splits_a_rest_does_not_break_the_match() -> None:
    recording = recorded(ROUGH, rest=12.0)
    accel = recording.accel.copy()
    knock = round((recording.rests[6, 0] + 6.0) * RATE)
    accel[knock] += 20.0
    reduction = reduced(recording, accel)
    segmentation = find_rests(reduction, ACCEL, GYRO)
    assert len(segmentation.rests) == 16
    match = match_rests(session_of(named("rough-table")), reduction, segmentation)
    assert match.position is not None
    np.testing.assert_array_equal(match.position, [*range(7), *range(6, 15)])


def test_stated_times_replace_what_was_found_there() -> None:
    """Two positions with times, the others found; the times are kept to a block."""
    codes = ("NUE", "ENU", "UEN N+45")
    recording = recorded(_listed_course(codes), rest=12.0)
    start, stop = recording.rests[1]
    spec = ProgrammeSpec(
        position=[
            ListedPosition(attitude=codes[0], start=2.0, stop=9.0),
            ListedPosition(attitude=codes[1], start=start + 3.0, stop=stop - 4.0),
            ListedPosition(attitude=codes[2]),
        ]
    )
    match = matched(recording, spec)
    times = np.array([(r.start, r.stop) for r in match.rests])
    np.testing.assert_allclose(times[:2], [(2.0, 9.0), (start + 3.0, stop - 4.0)], atol=0.1)
    assert len(times) == 3
    assert match.position is not None
    np.testing.assert_array_equal(match.position, [0, 1, 2])


@pytest.mark.parametrize("grade", ["navigation", "mems", "consumer"])
def test_without_gyros_turns_about_the_vertical_need_not_be_seen(grade: str) -> None:
    """A turn about the vertical joins two positions, or is cut, when only accelerometers look."""
    match = matched(recorded(ROUGH, grade=grade, rest=20.0, turning=10.0), named("rough-table"), gyros=False)
    assert match.position is not None
    assert np.all(np.diff(match.position) >= 0)
    needed = {
        0,
        1,
        3,
        4,
        5,
        7,
        8,
        9,
        11,
        12,
        13,
        14,
    }  # 2, 6 and 10 come from the one before by a turn about the vertical
    assert needed <= set(match.position.tolist())


# -------------------- what does not --------------------


def refused(recording: Recording, spec: ProgrammeSpec, *, gyros: bool = True) -> str:
    with pytest.raises(ProgrammeError) as caught:
        matched(recording, spec, gyros=gyros)
    message = str(caught.value)
    assert "\n" not in message
    return message


@pytest.mark.parametrize(("a", "b"), [(1, 4), (5, 12), (13, 14)])
def test_two_positions_exchanged_are_named(a: int, b: int) -> None:
    order = list(range(15))
    order[a], order[b] = b, a
    message = refused(recorded(course(order)), named("rough-table"))
    assert f"position {a + 1} of 15 ({ROUGH.positions[a].attitude!r}, {ROUGH.positions[a].label})" in message
    assert "which is that of position" in message
    assert ROUGH.positions[b].label in message


@pytest.mark.parametrize("missing", [0, 6, 9, 14])
def test_a_missing_position_is_named(missing: int) -> None:
    """Where two positions in a row have one vertical, either of them may be the one that is missing."""
    message = refused(recorded(course([i for i in range(15) if i != missing])), named("rough-table"))
    assert "expected 15 rests, found 14" in message
    position = ROUGH.positions[missing]
    alike = [i for i, p in enumerate(ROUGH.positions) if p.vertical_b @ position.vertical_b > 0.999]
    assert any(f"no rest for position {i + 1} of 15" in message for i in alike if abs(i - missing) <= 1)
    assert position.label in message


@pytest.mark.parametrize("surplus", [0, 5, 12])
def test_a_surplus_rest_is_named_by_its_times(surplus: int) -> None:
    """An oblique rest where none belongs."""
    order = [*range(surplus), 13 if surplus != 12 else 0, *range(surplus, 15)]
    recording = recorded(course(order))
    message = refused(recording, named("rough-table"))
    assert "expected 15 rests, found 16" in message
    start, stop = recording.rests[surplus]
    said = message.split("the rest at ")[1].split(" s ")[0]
    first, last = (float(t) for t in said.split("–"))
    assert start <= first < last <= stop


@pytest.mark.parametrize("turn", [0, 1, 6, 10])
def test_a_turn_in_the_wrong_direction_is_named(turn: int) -> None:
    """The attitudes after it are the same: only the gyros tell."""
    moves = list(ROUGH.moves)
    angle = moves[turn].angle
    assert angle is not None
    moves[turn] = replace(moves[turn], angle=-angle)
    message = refused(recorded(replace(ROUGH, moves=tuple(moves)), table_error=1.0), named("rough-table"))
    assert f"turn from position {turn + 1} of 15" in message
    assert f"to position {turn + 2} of 15" in message
    assert "direction" in message


@pytest.mark.parametrize("where", [2, 8, 13])
@pytest.mark.parametrize("off", [-8.0, 8.0])
def test_a_table_8_degrees_off_is_named(where: int, off: float) -> None:
    positions = list(ROUGH.positions)
    tilted = rotation_matrix(off * DEGREE * NORTH) @ positions[where].matrix
    positions[where] = replace(positions[where], matrix=tilted)
    moved = replace(ROUGH, positions=tuple(positions))
    message = refused(recorded(moved, grade="tactical", table_error=0.1), named("rough-table"))
    assert f"position {where + 1} of 15" in message
    said = float(message.split("° off")[0].split(" ")[-1])
    assert said == pytest.approx(8.0, abs=0.4)


def test_a_missing_face_of_a_cube_is_named() -> None:
    cube = programme("cube-14")
    recording = recorded(replace(cube, positions=cube.positions[1:], moves=cube.moves[1:]))
    message = refused(recording, named("cube-14"))
    assert f"no rest for position 1 of 14 ({cube.positions[0].attitude!r}, {cube.positions[0].label})" in message


def test_a_cube_off_its_faces_is_named() -> None:
    """An edge is 35° from the next vertex."""
    cube, edges = programme("cube-14"), programme("cube-12")
    positions = (*cube.positions, edges.positions[0])
    recording = recorded(replace(cube, positions=positions, moves=(*cube.moves, ANY_MOVE)))
    message = refused(recording, named("cube-14"))
    assert "of 14" in message
    assert float(message.split("° off")[0].split(" ")[-1]) == pytest.approx(35.0, abs=5.0)


def test_without_gyros_a_missing_face_is_still_named() -> None:
    order = [0, 1, 2, 3, 4, 5, 6, 8, 9, 10, 11, 12, 13, 14]
    message = refused(recorded(course(order)), named("rough-table"), gyros=False)
    assert "no rest for position 8 of 15" in message


def test_times_without_a_sample_are_refused() -> None:
    recording = recorded(_listed_course(("NUE", "ENU")))
    beyond = float(recording.time[-1]) + 100.0
    spec = ProgrammeSpec(
        position=[
            ListedPosition(attitude="NUE"),
            ListedPosition(attitude="ENU", start=beyond, stop=beyond + 10.0),
        ]
    )
    assert "position 2" in refused(recording, spec)
