"""What `plan` says of the method joint: u by source, the best next positions, what a wanted accuracy needs, and the
command."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result

from tests.support.formula_setup import bound, bound_of, device_setup
from tumble.cli import main
from tumble.errors import InputError, ProgrammeError
from tumble.planning.bounds import Bound, expected_bound
from tumble.planning.itinerary import Itinerary, itinerary_of
from tumble.planning.next_positions import NextPosition, TurnTable, next_positions
from tumble.planning.plan import Plan, PlannedMethod, largest_errors, least_rest, plan
from tumble.planning.setup import GROUPS, NAMES, Setup, with_all_groups
from tumble.programme.positions import from_attitudes, programme
from tumble.rotation import rotation_vector
from tumble.run.calibrate import calibrate
from tumble.sensors.grades import GRADES
from tumble.sensors.parameters import limits_of
from tumble.simulation.session import simulate_session
from tumble.units import DEGREE

SETUP = device_setup(latitude=56.84 * DEGREE, gravity=9.8157883)
NINE = replace(SETUP, programme=programme("nine"))
FACES = from_attitudes([position.attitude for position in programme("cube-26").positions[:6]])
HELD = TurnTable(axes="NU", by_hand=False)


# -------------------- what will be stated --------------------


@pytest.mark.parametrize("grade", ["navigation", "mems"])
def test_a_plan_is_what_will_be_stated_by_source(grade: str) -> None:
    """The parts of gravity and of the time base are what u² loses without them, where the rest does not depend on it:
    these are in accelerometer and gyro scale factors in common."""
    setup = replace(Setup.of(grade=grade), gravity_u=3e-4)
    found, whole = plan(setup), expected_bound(with_all_groups(setup))
    for row in found.groups:
        assert row.u == whole.rms(row.group)
        assert math.hypot(*row.sources.values()) == pytest.approx(row.u, rel=1e-9)
        assert math.sqrt(np.mean(np.square(list(row.parameters.values())))) == pytest.approx(row.u, rel=1e-12)
    assert found.group("gyro.scale").sources["time base of the log"] == pytest.approx(setup.clock_u, rel=1e-9)
    in_scale = found.group("accel.scale").sources["gravity of the site"]
    assert in_scale == pytest.approx(setup.gravity_u / setup.gravity, rel=0.05)
    linear = plan(setup, terms="linear")
    assert tuple(row.group for row in linear.groups) == GROUPS
    assert tuple(name for row in linear.groups for name in row.parameters) == NAMES


def test_priors_of_groups_are_the_sources_that_go_with_them() -> None:
    """A prior that is a tenth leaves a part that is a hundredth where the programme does not see the group, as rests
    and half turns of rough-table do not see a drift of the scale factors of gyros."""
    setup = with_all_groups(Setup.of())
    small = replace(setup, further={**setup.further, "gyro.scale.drift": 0.1 * setup.further["gyro.scale.drift"]})
    before, after = (plan(each).group("gyro.scale.drift") for each in (setup, small))
    assert before.largest == after.largest == "gyro.scale.drift"
    assert after.u < 0.2 * before.u


# -------------------- one more position --------------------


def value(found: Bound) -> float:
    """The criterion by its definition."""
    scaled = found.covariance / np.outer(limits_of(found.names), limits_of(found.names))
    return float(np.sqrt(np.trace(scaled) / len(scaled)))


@pytest.mark.parametrize("gyros", [True, False], ids=["gyros", "accelerometers"])
@pytest.mark.parametrize("table", [TurnTable(), HELD], ids=["by hand", "held"])
def test_the_best_next_position_is_the_best_of_all(gyros: bool, table: TurnTable) -> None:
    """Every candidate's criterion against a whole bound."""
    found = next_positions(NINE, gyros=gyros, table=table)
    before = value(bound(NINE, gyros=gyros))
    end = NINE.programme.positions[-1].matrix
    attitudes = np.array([position.matrix for position in table.positions(NINE.programme.positions[-1])])
    places, moves, _ = table.moves(end, attitudes)
    whole = [
        value(bound_of(added(itinerary_of(NINE), attitudes[place], move), NINE, gyros=gyros)) / before
        for place, move in zip(places, moves, strict=True)
    ]
    assert len(whole) >= 16
    assert sum(one.as_good + 1 for one in found) == len(whole)
    ratios = np.repeat([one.ratio for one in found], [one.as_good + 1 for one in found])
    np.testing.assert_allclose(ratios, sorted(whole), rtol=2e-6)
    assert value(bound(found[0].added(NINE), gyros=gyros)) / before == pytest.approx(min(whole), rel=1e-6)


def added(course: Itinerary, attitude: np.ndarray, move: np.ndarray) -> Itinerary:
    """The same with one more rest."""
    attitudes, moves = (np.concatenate([course.attitudes, attitude[None]]), np.concatenate([course.moves, move[None]]))
    return Itinerary.through(attitudes, moves, SETUP)


def test_in_run_biases_and_all_groups_are_in_the_search() -> None:
    """The ranking of candidates is that of what is stated: the first is better than the last by as much, to a fifth."""
    setup = with_all_groups(replace(NINE, noise=GRADES["mems"].noise, instrument="mems", clock_u=0.0))
    found = next_positions(setup, wanted={"accel.scale": 1e-6})
    setups = setup, found[0].added(setup), found[-1].added(setup)
    before, best, worst = (expected_bound(each).rms("accel.scale") for each in setups)
    assert best < worst
    assert best / before == pytest.approx(found[0].ratio, rel=0.2)


def test_equally_good_positions_are_given_once() -> None:
    """From the faces the twelve edges are as good as each other for accelerometers alone, in every azimuth."""
    found = next_positions(replace(SETUP, programme=FACES), gyros=False)
    assert [one.ratio for one in found] == sorted(one.ratio for one in found)
    assert found[0].as_good == 47
    assert sorted(np.round(np.abs(found[0].position.vertical_b), 3)) == [0.0, 0.707, 0.707]
    assert found[0].move.axis is not None  # of as many as there are, a turn


def test_a_held_device_makes_single_turns_from_where_it_is() -> None:
    tilted = replace(SETUP, programme=from_attitudes(["NUE", "UEN", "ENU N+10", "NUE N+45", "UEN E+20"]))
    for setup in (SETUP, tilted):
        found = next_positions(setup, table=HELD)
        assert 0.0 < found[0].ratio < 1.0
        assert all(turns_there(one, setup) for one in found)


def test_a_table_is_asked_for_no_attitude_that_its_axes_do_not_reach() -> None:
    """That of the rough table turns about N and U, and the device is mounted along N, U and E."""
    found = next_positions(Setup.of())
    assert len(found) > 10
    assert not any("E+" in one.position.attitude or "E-" in one.position.attitude for one in found)
    assert all(one.move.axis is None or one.move.axis[2] == 0.0 for one in found)


def turns_there(one: NextPosition, setup: Setup) -> bool:
    """Whether a move is a turn about N or U by a multiple of 45° that leads to its position."""
    assert one.move.axis is not None
    assert one.move.angle is not None
    turned = rotation_vector(one.position.matrix @ setup.programme.positions[-1].matrix.T)
    off = (turned - one.move.angle * one.move.axis) / (2.0 * np.pi)
    steps = one.move.angle / DEGREE / 45.0
    there = np.linalg.norm(off - np.round(off)) < 1e-9
    return bool(one.move.axis[2] == 0.0 and there and abs(steps - round(steps)) < 1e-9)


@pytest.mark.parametrize(
    ("axes", "step", "place"),
    [("NX", 45.0, "axes"), ("NN", 45.0, "axes"), ("", 45.0, "axes"), ("NUE", 7.0, "step"), ("NUE", 1.0, "step"),
     ("NUE", float("nan"), "step"), ("N", -45.0, "step")],
)  # fmt: skip
def test_a_table_that_does_not_exist_is_refused(axes: str, step: float, place: str) -> None:
    with pytest.raises(InputError, match=place):
        TurnTable(axes=axes, step=step * DEGREE)


# -------------------- what a wanted accuracy needs --------------------


@pytest.mark.parametrize("groups", [False, True], ids=["without groups", "with them"])
def test_rests_and_positions_that_are_required_give_what_is_wanted(groups: bool) -> None:
    """With the rest that is required u is the wanted one; with so many positions, each the best next, it is reached,
    and with one fewer not; what neither gives is refused with what the method has."""
    setup = Setup.of(terms="full") if groups else replace(Setup.of(), instrument="one without groups")
    u = plan(setup).group("accel.scale").u
    assert u == pytest.approx(6.13e-6 if groups else 0.790e-6, rel=0.01)
    served = plan(setup, wanted={"accel.scale": 0.8 * u})
    (row,) = served.requirements
    assert (
        expected_bound(replace(setup, rest=row.rest)).rms("accel.scale") <= 0.8 * u if math.isfinite(row.rest) else True
    )
    assert row.positions is not None
    longer, counts = setup, []
    while len(longer.programme.positions) < row.positions:
        counts.append(expected_bound(longer).rms("accel.scale"))
        longer = next_positions(longer, wanted={"accel.scale": 1.0})[0].added(longer)
    assert min(counts) > 0.8 * u >= expected_bound(longer).rms("accel.scale")
    (met,) = plan(setup, wanted={"accel.scale": 1.02 * u}).requirements
    assert met.positions == 15
    assert expected_bound(replace(setup, rest=met.rest)).rms("accel.scale") == pytest.approx(1.02 * u, rel=0.01)


@pytest.mark.parametrize("rate_deg_s", [10.0, 40.0])
def test_rests_that_are_required_are_found_by_calibrate(tmp_path: Path, rate_deg_s: float) -> None:
    """A wanted accuracy that any rest gives requires the least rest, whose u is smaller than wanted, and a session with
    such rests is accepted. A plan refuses shorter ones."""
    setup = Setup.of(grade="mems", rate_deg_s=rate_deg_s, sample_rate=50.0)
    needed, shorter = (replace(setup, rest=least_rest(setup) - less) for less in (0.0, 0.5))
    expected: tuple[tuple[PlannedMethod, float], ...] = (("joint", 1e-3), ("scalar", 1e-2))
    for method, wanted in expected:
        (row,) = plan(setup, method=method, wanted={"accel.scale": wanted}).requirements
        assert row.rest == needed.rest
        assert row.reached < 0.8 * wanted
        assert not plan(needed, method=method).reasons
        assert "so that `calibrate` finds every one" in plan(shorter, method=method).reasons[0]
    (row,) = plan(setup, wanted={"accel.scale": 1e-3}).requirements
    assert row.reached == plan(needed).group("accel.scale").u
    session = simulate_session(tmp_path / "needed", needed, seed=1)
    assert calibrate(session, terms="linear").outcome.accepted


def test_what_no_set_up_gives_is_named_with_its_source() -> None:
    found = plan(Setup.of(), wanted={"gyro.scale": 2e-6, "accel.scale": 10e-6})
    (reason,) = found.reasons
    assert reason.startswith("gyro.scale: expected an accuracy of at least 30.1 ppm")
    assert "mostly time base of the log" in reason
    assert reason.endswith("found 2 ppm; state how good the time base is (clock_ppm_u)")
    assert [row.reason for row in found.requirements] == [reason, ""]


@pytest.mark.parametrize(
    ("wanted", "words"), [({"gyro.colour": 1.0}, "gyro.colour"), ({"accel.bias": 0.0}, "more than 0")]
)
def test_impossible_wishes_are_refused(wanted: dict[str, float], words: str) -> None:
    with pytest.raises(InputError, match=words):
        plan(SETUP, wanted=wanted)
    with pytest.raises(InputError, match=r"found 'gyro\.axis'"):
        plan(SETUP, wanted={"gyro.axis": 1e-6}, gyros=False)


@pytest.mark.parametrize(("times", "accepted"), [(1.0, True), (2.0, False)])
def test_tables_that_calibrate_refuses_are_not_any(tmp_path: Path, times: float, accepted: bool) -> None:
    """With the largest errors that a plan allows every rest is in its position; with twice as large ones it is not,
    and the plan refuses it too."""
    setup = Setup.of(sample_rate=10.0, rest=20.0, rate_deg_s=30.0)
    table, mounting = (times * error for error in largest_errors(setup))
    setup = replace(setup, table_error=table, mounting_error=mounting)
    assert bool(plan(setup, terms="linear").reasons) is not accepted
    assert bool(plan(setup, method="scalar").reasons) is not accepted
    for seed in range(3):
        folder = simulate_session(tmp_path / f"{seed}", setup, seed=seed)
        if accepted:
            assert calibrate(folder, terms="linear").outcome.accepted
        else:
            with pytest.raises(ProgrammeError, match="at most 7° can be the same position"):
                calibrate(folder, terms="linear")


# -------------------- the command --------------------


def run(*arguments: str) -> Result:
    return CliRunner().invoke(main, ["plan", *arguments])


def planned(*arguments: str) -> dict[str, dict[str, float]]:
    """u and its sources by group, of the command."""
    result = run("--json", *arguments)
    assert result.exit_code == 0, result.stderr
    return {row["group"]: {"u": row["u"], **row["sources"]} for row in json.loads(result.stdout)["groups"]}


def library(found: Plan) -> dict[str, dict[str, float]]:
    return {row.group: {"u": row.u, **row.sources} for row in found.groups}


def test_the_command_is_the_function_with_the_same_defaults() -> None:
    for arguments, found in (
        ((), plan(Setup.of())),
        (("nine", "--grade", "mems", "--accel-only"), plan(Setup.of(programme="nine", grade="mems"), gyros=False)),
        (("--method", "scalar"), plan(Setup.of(), method="scalar")),
    ):
        assert planned(*arguments) == library(found)


def test_the_command_shows_groups_sources_and_next_positions() -> None:
    result = run("--sources")
    assert result.exit_code == 0, result.stderr
    for name in (*GROUPS, "accel.cubic", "time base of the log"):
        assert name in result.stdout
    assert "determined: 21 of 21 linear parameters, condition" in result.stdout
    assert "one more position" in result.stdout
    assert "u/before above 100 %: the programme does not determine such a group" in " ".join(result.stdout.split())


def test_what_a_session_must_state_is_said_and_counts_as_calibrate_counts_it() -> None:
    """A sample rate without time stamps has 1 %, an unstated height 4 mm/s² of gravity."""
    bare = run("--clock-ppm-u", "10000", "--gravity-u", "4e-3", "--json")
    found = json.loads(bare.stdout)
    u = {row["group"]: row["u"] for row in found["groups"]}
    assert u["gyro.scale"] == pytest.approx(1e-2, rel=1e-3)
    assert u["accel.scale"] == pytest.approx(4e-3 / 9.816, rel=1e-3)
    height, clock = found["assumptions"]
    assert "states neither gravity nor height, 408 ppm are in u of accel.scale" in height
    assert "1e+04 ppm, which are in u of gyro.scale" in clock
    assert height in " ".join(run("--gravity-u", "4e-3").stdout.split())


def test_linear_terms_have_what_they_leave_out_in_u() -> None:
    """As `calibrate --terms linear` has it: the squares of what each group moves. Drifts are in the process too."""
    setup = Setup.of(clock_ppm_u=0.0)
    linear, bare = plan(setup, terms="linear"), plan(replace(setup, instrument="one without groups"), terms="linear")
    for row in linear.groups:
        left = [u for name, u in row.sources.items() if name in with_all_groups(setup).further]
        assert row.u == pytest.approx(math.hypot(bare.group(row.group).u, *left), rel=5e-3)
    assert linear.group("accel.bias").u > 10.0 * bare.group("accel.bias").u


def test_what_six_faces_do_not_determine_is_said_with_status_1() -> None:
    faces = [word for position in FACES.positions for word in ("--attitude", position.attitude)]
    result = run("--accel-only", *faces)
    assert result.exit_code == 1
    assert result.stderr == "not determined: accel.axis.yx, accel.axis.zx, accel.axis.zy\n"
    assert "determined: 6 of 9" in result.stdout


def test_what_a_wanted_accuracy_needs_is_a_row() -> None:
    result = run("--method", "sequential", "--want", "accel.scale=12ppm", "--want", "gyro.bias=0.0001 °/h")
    assert result.exit_code == 1
    assert "±" in result.stdout
    assert "no table" in result.stdout
    assert "instability" in result.stderr
    assert run("--want", "accel.scale=10ppm").exit_code == 0


@pytest.mark.parametrize(
    "arguments",
    [
        ("--noiseless",),
        ("--accel-only", "--want", "gyro.scale=1ppm"),
        ("--accel-only", "--method", "scalar"),
        ("--want", "accel.scale"),
        ("--want", "accel.scael=1ppm"),
        ("--want", "accel.scale=3furlong"),
        ("--table-error", "-1"),
        ("--rest", "nan"),
        ("eleven",),
        ("cube-14", "--method", "sequential"),
    ],
)
def test_what_makes_no_sense_is_refused_before_anything_is_printed(arguments: tuple[str, ...]) -> None:
    result = run(*arguments)
    assert result.exit_code == 2
    assert result.stdout == ""
    assert len(result.stderr.strip().splitlines()) == 1
