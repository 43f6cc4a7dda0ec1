"""Next positions and optimised programmes: against trying everything, one by one."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from click.testing import CliRunner, Result

from tests.support.formula_setup import device_setup
from tumble.cli import main
from tumble.errors import InputError
from tumble.inference.elimination import eliminate, fold
from tumble.inference.likelihood import weights
from tumble.inference.step import tell
from tumble.planning.best_positions import (
    COMPARED,
    Aim,
    Criterion,
    Letter,
    candidates,
    compared,
    next_positions,
    optimised,
    value_of,
)
from tumble.planning.bounds import Bound, bound, bound_of, view
from tumble.planning.itinerary import Itinerary, itinerary_of
from tumble.planning.reachable_attitudes import Places, TurnTable
from tumble.programme.positions import Programme, from_attitudes, programme
from tumble.rotation import rotation_vector
from tumble.sensors.grades import GRADES, NoiseModel
from tumble.sensors.parameters import limits_of
from tumble.units import DEGREE

SETUP = device_setup(latitude=56.84 * DEGREE, gravity=9.8157883)
NINE = replace(SETUP, programme=programme("nine"))
FACES = from_attitudes([position.attitude for position in programme("cube-26").positions[:6]])
HELD = TurnTable.of("N,U", 45.0)


def value(found: Bound, letter: str) -> float:
    """The criterion by its definition."""
    scaled = found.covariance / np.outer(limits_of(found.names), limits_of(found.names))
    if letter == "A":
        return float(np.sqrt(np.trace(scaled) / len(scaled)))
    return float(np.exp(0.5 * np.linalg.slogdet(scaled)[1] / len(scaled)))


# -------------------- one more position --------------------


@pytest.mark.parametrize("letter", ["A", "D"])
@pytest.mark.parametrize("gyros", [True, False], ids=["gyros", "accelerometers"])
@pytest.mark.parametrize("table", [TurnTable(), HELD], ids=["by hand", "held"])
def test_what_a_candidate_shows_is_the_bound_with_it(letter: str, gyros: bool, table: TurnTable) -> None:
    """Every candidate's criterion against a whole bound, so that the best is the best of all."""
    aim = Aim(letter=letter, gyros=gyros)  # type: ignore[arg-type]
    places = Places.of(table, NINE, gyros=gyros, last=NINE.programme.positions[-1])
    before, values, legs = candidates(NINE, aim, places)
    assert before == pytest.approx(value(bound(NINE, gyros=gyros), letter), rel=1e-6)
    whole = [
        value(bound_of(added(itinerary_of(NINE), places.attitudes[place], move), NINE, gyros=gyros), letter)
        for place, move in zip(legs.places[:, 0], legs.moves[:, 0], strict=True)
    ]
    assert len(whole) >= 16
    np.testing.assert_allclose(values, whole, rtol=1e-6)
    best = next_positions(NINE, aim, table, count=1)[0]
    assert best.ratio == pytest.approx(min(whole) / before, rel=1e-6)
    assert value(best.bound, letter) == pytest.approx(min(whole), rel=1e-6)


@pytest.mark.parametrize("gyros", [True, False], ids=["gyros", "accelerometers"])
def test_what_a_candidate_shows_has_the_states_of_in_run_biases(gyros: bool) -> None:
    """Of some candidates, against the elimination of a whole course; biases are the means of their processes."""
    aim, setup = Aim(gyros=gyros), replace(NINE, noise=GRADES["mems"].noise)
    criterion, places = Criterion.of(aim, setup), Places.of(HELD, setup, gyros=gyros, last=NINE.programme.positions[-1])
    before, values, legs = candidates(setup, aim, places)
    courses = [itinerary_of(setup)]
    for place, move in zip(legs.places[:6, 0], legs.moves[:6, 0], strict=True):
        courses.append(added(courses[0], places.attitudes[place], move))
    for course, found in zip(courses, [before, *values[:6]], strict=True):
        triangle, seen = criterion.known.copy(), view(course, setup, gyros=gyros)
        told = tell(seen.problem, seen.rows, weights(seen.problem, seen.rows, seen.components))
        fold(told.sessions[0], triangle)
        assert found == pytest.approx(float(criterion.of_triangles(triangle[None])[0]), rel=1e-6)


def added(course: Itinerary, attitude: np.ndarray, move: np.ndarray) -> Itinerary:
    """The same with one more rest."""
    attitudes, moves = (np.concatenate([course.attitudes, attitude[None]]), np.concatenate([course.moves, move[None]]))
    return Itinerary.through(attitudes, moves, SETUP)


def test_next_positions_come_best_first_and_equally_good_ones_once() -> None:
    """From the faces the twelve edges are as good as each other for accelerometers alone, in every azimuth."""
    setup = replace(SETUP, programme=FACES)
    found = next_positions(setup, Aim(gyros=False))
    assert [one.ratio for one in found] == sorted(one.ratio for one in found)
    assert found[0].as_good == 47
    assert sorted(np.round(np.abs(found[0].position.vertical_b), 3)) == [0.0, 0.707, 0.707]
    assert found[0].bound.rank == 7
    assert found[0].move.axis is not None  # of as many as there are, a turn


def test_a_held_device_makes_single_turns_from_where_it_is() -> None:
    for one in next_positions(SETUP, table=HELD, count=20):
        assert one.move.axis is not None
        assert one.move.angle is not None
        assert one.move.axis[2] == 0.0
        turned = rotation_vector(one.position.matrix @ SETUP.programme.positions[-1].matrix.T)
        difference = (turned - one.move.angle * one.move.axis) / (2.0 * np.pi)
        assert np.linalg.norm(difference - np.round(difference)) < 1e-9
        assert one.move.angle / DEGREE % 45.0 == pytest.approx(0.0, abs=1e-9)


def test_a_position_off_the_grid_can_be_gone_on_from() -> None:
    tilted = replace(SETUP, programme=from_attitudes(["NUE", "UEN", "ENU N+10", "NUE N+45", "UEN E+20"]))
    for table in (TurnTable(), HELD):
        found = next_positions(tilted, Aim(gyros=False), table)
        assert 0.0 < found[0].ratio < 1.0


# -------------------- optimised programmes --------------------


@cache
def found_for(count: int, letter: Letter = "A", *, gyros: bool = True) -> Programme:
    """The programme that is found for the usual set-up, once for all tests."""
    return optimised(SETUP, count, Aim(letter=letter, gyros=gyros))


@pytest.mark.parametrize(("gyros", "count"), [(True, 9), (False, 10)])
def test_no_exchange_of_a_position_makes_an_optimised_programme_better(gyros: bool, count: int) -> None:
    """Every place instead of every position, by whole bounds; the moves taken are those of the grid or the shortest."""
    found = found_for(count, gyros=gyros)
    at = replace(SETUP, programme=found)
    best = value_of(at, Aim(gyros=gyros))
    assert best == pytest.approx(value(bound(at, gyros=gyros), "A"), rel=1e-6)
    places, course = Places.of(TurnTable(), SETUP, gyros=gyros), itinerary_of(at)
    tried = 0
    for i in range(count):
        for attitude in places.attitudes[:: 1 if gyros else 4]:
            attitudes = course.attitudes.copy()
            attitudes[i] = attitude
            moves = course.moves.copy()
            if i > 0:
                moves[i - 1] = rotation_vector(attitude @ attitudes[i - 1].T)
            if i < count - 1:
                moves[i] = rotation_vector(attitudes[i + 1] @ attitude.T)
            if min(np.linalg.norm(moves, axis=1)) < 1e-9:
                continue
            other = bound_of(Itinerary.through(attitudes, moves, SETUP), SETUP, gyros=gyros)
            assert value(other, "A") > best * (1.0 - 1e-6) or other.rank < len(other.names)
            tried += 1
    assert tried > 200


@pytest.mark.parametrize("letter", ["A", "D"])
def test_optimised_programmes_show_more_than_those_of_the_literature(letter: Letter) -> None:
    aim = Aim(letter=letter)
    for row in compared(SETUP, [programme(name) for name in COMPARED[:3]], aim):
        found = found_for(len(row.programme.positions), letter)
        assert len(found.positions) == len(row.programme.positions)
        assert value_of(replace(SETUP, programme=found), aim) < 0.97 * row.value, row.programme.name


def test_nine_positions_for_accelerometers_come_near_the_best_there_are() -> None:
    """§3 of the turntable method: of all sets of nine directions the least tr (HᵀH)⁻¹ is 7.98; the nine have 24.
    What is found on a table with stops of 15°, 8.986, is also the best of twenty random starts there."""
    sigma = 1e-4
    setup = replace(SETUP, noise=NoiseModel(accel_white=sigma * SETUP.gravity * np.sqrt(SETUP.rest)))
    wanted = {"accel.bias": SETUP.gravity, "accel.scale": 1.0, "accel.axis": 1.0}
    aim = Aim(wanted=wanted, gyros=False)
    found = optimised(setup, 9, aim, TurnTable(step=15.0 * DEGREE))
    traces = [
        9.0 * (value_of(replace(setup, programme=listed), aim) / sigma) ** 2 for listed in (found, programme("nine"))
    ]
    assert traces[1] == pytest.approx(24.0, abs=0.05)
    assert 7.97 < traces[0] < 9.0


def test_what_is_wanted_is_served() -> None:
    usual = bound(replace(SETUP, programme=optimised(SETUP, 8)))
    served = bound(replace(SETUP, programme=optimised(SETUP, 8, Aim(wanted={"gyro.scale": 1e-6}))))
    assert served.rms("gyro.scale") < 0.9 * usual.rms("gyro.scale")


def test_a_held_device_is_turned_from_position_to_position() -> None:
    found = optimised(SETUP, 12, Aim(), HELD)
    codes = [position.attitude for position in found.positions]
    assert bound(replace(SETUP, programme=found)).rank == 21
    for before, move, after in zip(found.positions[:-1], found.moves, found.positions[1:], strict=True):
        assert move.axis is not None
        assert move.angle is not None
        turn = f" {'NUE'[int(np.argmax(move.axis))]}{move.angle / DEGREE:+.10g}"
        turned = from_attitudes([before.attitude + turn]).positions[0]
        np.testing.assert_allclose(turned.matrix, after.matrix, atol=1e-12, err_msg=f"{codes}")
        assert move.axis[2] == 0.0


def test_a_turning_table_can_determine_accelerometers_alone() -> None:
    """About N and U alone some positions only bring another body axis to north."""
    found = optimised(SETUP, 12, Aim(gyros=False), HELD)
    assert bound(replace(SETUP, programme=found), gyros=False).rank == 9


def test_a_candidate_costs_no_more_in_a_long_programme(monkeypatch: pytest.MonkeyPatch) -> None:
    """Candidates are eliminations of two to four rests, counted, however long the programme is."""
    rests: list[int] = []

    def counted(rest: np.ndarray, *others: np.ndarray) -> None:
        rests.append(len(rest))
        eliminate(rest, *others)

    monkeypatch.setattr("tumble.planning.best_positions.eliminate", counted)
    long = Programme(
        name="long",
        positions=SETUP.programme.positions * 4,
        moves=((*SETUP.programme.moves, SETUP.programme.moves[3]) * 4)[:-1],
        ordered=True,
    )
    setup = replace(SETUP, programme=long)
    _, values, _ = candidates(setup, Aim(), Places.of(TurnTable(), setup, gyros=True))
    assert sorted(rests)[-2:] == [2, 60]
    assert len(rests) == len(values) + 1


# -------------------- refusals, and the command --------------------


@pytest.mark.parametrize(
    ("axes", "step", "place"),
    [("N,X", 45.0, "axes"), ("N,N", 45.0, "axes"), ("", 45.0, "axes"), (None, 7.0, "step"), (None, 1.0, "step"),
     (None, float("nan"), "step"), ("N", -45.0, "step")],
)  # fmt: skip
def test_a_table_that_does_not_exist_is_refused(axes: str | None, step: float, place: str) -> None:
    with pytest.raises(InputError, match=place):
        TurnTable.of(axes, step)


def test_an_aim_that_cannot_be_is_refused() -> None:
    with pytest.raises(InputError, match="wanted"):
        next_positions(SETUP, Aim(wanted={"gyro.axis": 1e-6}, gyros=False))
    with pytest.raises(InputError, match="positions"):
        optimised(SETUP, 1)


def run(*arguments: str) -> Result:
    return CliRunner().invoke(main, ["plan", *arguments])


def test_the_plan_of_a_programme_has_every_parameter_and_the_next_positions() -> None:
    result = run()
    assert result.exit_code == 0, result.stderr
    for name in bound(SETUP).names:
        assert f"\n{name}  " in result.stdout
    assert "rank 21 of 21, condition 1" in result.stdout
    assert "worst determined: gyro.axis" in result.stdout
    assert "one more position" in result.stdout
    assert "turn −90° about N" in result.stdout


def test_six_faces_are_refused_in_words() -> None:
    faces = [word for position in FACES.positions for word in ("--attitude", position.attitude)]
    result = run("--accel-only", *faces)
    assert result.exit_code == 1
    assert result.stderr == "not determined: accel.axis.yx, accel.axis.zx, accel.axis.zy\n"
    assert "rank 6 of 9" in result.stdout


def test_a_found_programme_stands_beside_the_others() -> None:
    result = run("--positions", "9", "--accel-only")
    assert result.exit_code == 0, result.stderr
    rows = {line.split()[0]: line.split() for line in result.stdout.splitlines() if line.strip()}
    assert rows["A-optimal"][1] == "9"
    for name in ("nine", "cube-14", "rough-table", "faces-edges-18"):
        assert name in rows
    assert float(rows["nine"][-1]) > 1.2


def test_what_cannot_be_had_is_said() -> None:
    result = run("--want", "accel.scale=1ppm", "--want", 'accel.axis=0.2"')
    assert result.exit_code == 1
    assert result.stderr.startswith('accel.axis: expected 0.2 " (rms), found at best 0.3')
    assert len(result.stderr.splitlines()) == 1
    assert run("--want", "accel.scale=1ppm").exit_code == 0


@pytest.mark.parametrize(
    "arguments",
    [
        ("--noiseless",),
        ("--axes", "N,X"),
        ("--step", "7"),
        ("--accel-only", "--want", "gyro.scale=1ppm"),
        ("--want", "accel.scale"),
        ("--programme", "eleven"),
    ],
)
def test_what_makes_no_sense_is_refused_before_anything_is_printed(arguments: tuple[str, ...]) -> None:
    for more in ((), ("--positions", "5")):
        result = run(*arguments, *more)
        assert result.exit_code == 2
        assert result.stdout == ""
        assert len(result.stderr.strip().splitlines()) == 1


def test_a_budget_has_the_bound_beside_it() -> None:
    result = CliRunner().invoke(main, ["budget", "--method", "staged"])
    assert result.exit_code == 0
    assert "bound" in result.stdout.splitlines()[0]
    kind = GRADES["navigation"]
    least = bound(replace(SETUP, noise=kind.noise))
    ppm = [line for line in result.stdout.splitlines() if "accel.scale" in line]
    assert all(f"{1e6 * least.rms('accel.scale'):.3g} ppm" in line for line in ppm)
    assert "bound" not in CliRunner().invoke(main, ["budget", "--method", "staged", "--noiseless"]).stdout
