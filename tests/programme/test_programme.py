"""Attitude codes, the built-in programmes, and what they can tell about an IMU."""

from __future__ import annotations

import math
from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tumble.errors import ProgrammeError
from tumble.programme.positions import (
    ANY_MOVE,
    BUILT_IN,
    TRIPLES,
    Move,
    Programme,
    attitude,
    from_attitudes,
    programme,
    timetable,
)
from tumble.rotation import rotation_matrix, skew
from tumble.units import DEGREE, Array

N, U, E = np.eye(3)
R = 0.5**0.5
OBLIQUE_U = [(R, -R, 0), (R, 0, -R), (0, R, -R)]


turns = st.tuples(st.sampled_from("NUE"), st.sampled_from("+-"), st.floats(0.0, 360.0))


def triples() -> list[str]:
    """The 24 right-handed ones, by the determinant."""
    vectors = dict(zip("NUESDW", (N, U, E, -N, -U, -E), strict=True))
    return [
        "".join(t)
        for t in product("NUESDW", repeat=3)
        if np.linalg.det(np.column_stack([vectors[letter] for letter in t])) > 0.5
    ]


@given(st.sampled_from(triples()), st.lists(turns, max_size=4))
def test_attitudes_are_rotations(letters: str, turned: list[tuple[str, str, float]]) -> None:
    code = " ".join([letters, *(f"{axis}{sign}{angle:.6f}" for axis, sign, angle in turned)])
    matrix = attitude(code)
    np.testing.assert_allclose(matrix @ matrix.T, np.eye(3), atol=1e-14)
    assert math.isclose(float(np.linalg.det(matrix)), 1.0, abs_tol=1e-14)


def test_letters_say_where_body_axes_point() -> None:
    assert len(triples()) == 24
    np.testing.assert_array_equal(attitude("NUE"), np.eye(3))
    np.testing.assert_array_equal(attitude("ENU"), np.column_stack([E, N, U]))
    np.testing.assert_array_equal(attitude("DWN"), np.column_stack([-U, -E, N]))


@pytest.mark.parametrize(
    ("turned", "letters"),
    [
        ("NUE N+90", "NED"),  # N × U = E
        ("NUE U+90", "WUN"),  # U × E = N, so N goes to W
        ("NUE E+90", "USE"),  # E × N = U
        ("NUE N-90", "NWU"),
        ("NUE N+90 U+90", "WND"),  # in the order written: first about N, then X to W and Y, at E, to N
        ("NUE U+90 N+90", "UEN"),  # X, at W, goes to U and Y to E
        ("ENU N+180 U+180 N-180", "WSU"),
    ],
)
def test_turns_are_right_handed_about_geographic_axes_and_in_order(turned: str, letters: str) -> None:
    np.testing.assert_allclose(attitude(turned), attitude(letters), atol=1e-15)


def test_fractions_of_a_degree_and_spaces_are_read() -> None:
    expected = rotation_matrix(-90.5 * DEGREE * E) @ rotation_matrix(45 * DEGREE * N)
    np.testing.assert_allclose(attitude("  NUE   N+45. E-90.5 "), expected, atol=1e-15)


@pytest.mark.parametrize(
    ("code", "said"),
    [
        ("", 'expected three of N S E W U D, where body X, Y, Z point, found ""'),
        ("NUEE", 'found "NUEE"'),
        ("NUS", 'expected three perpendicular directions, found "NUS"'),
        ("UNE", 'found left-handed "UNE"; with this X and Y it is "UNW"'),
        ("NUE N45", 'such as N+45 or E-90.5, found "N45"'),
        ("NUE S+45", 'found "S+45"'),
        ("NUE N+nan", 'found "N+nan"'),
        ("NUE N+360.5", 'found "N+360.5"'),
        ("NUE\nN+4\n5", 'attitude "NUE N+4 5"'),
    ],
)
def test_a_bad_code_is_one_line_that_says_what_was_expected(code: str, said: str) -> None:
    with pytest.raises(ProgrammeError) as caught:
        attitude(code)
    assert said in str(caught.value)
    assert "expected" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_the_code_suggested_for_a_left_handed_one_is_right_handed() -> None:
    right = set(triples())
    left = {t[:2] + dict(zip("NSUDEW", "SNDUWE", strict=True))[t[2]] for t in right}
    assert len(left) == 24
    for code in left:
        with pytest.raises(ProgrammeError) as caught:
            attitude(code)
        assert str(caught.value).split('"')[-2] in right


def test_rough_table_stands_as_the_method_says() -> None:
    """Turntable method §6.3 and, for the oblique rests, §3."""
    x, y, z = np.eye(3)
    series = [u for axis in (y, z, x) for u in (axis, -axis, -axis, axis)]
    made = programme("rough-table")
    found = np.array([p.vertical_b for p in made.positions])
    np.testing.assert_allclose(found, [*series, *np.array(OBLIQUE_U)], atol=1e-15)
    assert made.ordered
    assert [p.attitude for p in made.positions[::4]] == ["NUE", "ENU", "UEN", "UEN N+45"]
    for first, (north, up) in zip((0, 4, 8), ((x, y), (y, z), (z, x)), strict=True):
        np.testing.assert_allclose(made.positions[first].matrix @ north, N, atol=1e-15)
        np.testing.assert_allclose(made.positions[first].matrix @ up, U, atol=1e-15)
    for position, third in zip(made.positions[12:], (z, y, x), strict=True):
        np.testing.assert_allclose(position.matrix @ third, N, atol=1e-15)


def test_rough_table_turns_lead_from_each_position_to_the_next() -> None:
    made = programme("rough-table")
    named = [i for i, move in enumerate(made.moves) if move.angle is not None]
    assert named == [0, 1, 2, 4, 5, 6, 8, 9, 10]
    assert all(made.moves[i] is ANY_MOVE for i in (3, 7, 11, 12, 13))
    for i in named:
        axis, angle = made.moves[i].axis, made.moves[i].angle
        assert axis is not None
        assert angle is not None
        turned = rotation_matrix(angle * axis) @ made.positions[i].matrix
        np.testing.assert_allclose(turned, made.positions[i + 1].matrix, atol=1e-15)
        expected = (math.pi * N, math.pi * U, -math.pi * N)[i % 4]
        np.testing.assert_allclose(angle * axis, expected, rtol=1e-15)


def rows_of_rests(made: Programme) -> Array:
    """H of Eq. (13), (N, 9): bias/g, scale factors and axis angles of three accelerometers in (w² − g²)/2g²."""
    u = np.array([p.vertical_b for p in made.positions])
    return np.column_stack([u, u**2, u[:, 0] * u[:, 1], u[:, 0] * u[:, 2], u[:, 1] * u[:, 2]])


def rows_of_turns(made: Programme) -> Array:
    """H_G (2K, 9) of Eq. (6.2), for perfect accelerometers: the gyro matrix in the tilts after the programmed turns,
    or if there are none, after moves from each position to the next the shortest way."""
    rows: list[Array] = []
    named = any(move.angle is not None for move in made.moves)
    for start, end, move in zip(made.positions[:-1], made.positions[1:], made.moves, strict=True):
        if move.axis is None or move.angle is None:
            if named:
                continue
            vector = Rotation.from_matrix(end.matrix @ start.matrix.T).as_rotvec()
            angle = float(np.linalg.norm(vector))
            n = vector / angle
        else:
            n, angle = move.axis, move.angle
        along = np.outer(n, n)
        K = angle * along + math.sin(angle) * (np.eye(3) - along) + (1.0 - math.cos(angle)) * skew(n)
        psi = np.einsum("ij,ja,b->iab", K, start.matrix, start.matrix.T @ n).reshape(3, 9)  # of F n, F = C E Cᵀ
        rows += [-psi[2], psi[0]]
    return np.array(rows)


def test_rough_table_turns_have_the_published_condition_number() -> None:
    assert np.linalg.cond(rows_of_turns(programme("rough-table"))) == pytest.approx(2.2214, abs=5e-5)


@pytest.mark.parametrize("name", BUILT_IN)
def test_every_built_in_programme_shows_all_scale_factors_and_angles(name: str) -> None:
    """Accelerometers by the rests, gyros by the turns; well enough that no direction is seen 10 times worse."""
    made = programme(name)
    for H in (rows_of_rests(made), rows_of_turns(made)):
        assert H.shape[1] == 9
        assert np.linalg.cond(H) < 10.0


def test_nine_positions_are_the_published_directions() -> None:
    u = np.array([p.vertical_b for p in programme("nine").positions])
    x, y, z = np.eye(3)
    np.testing.assert_allclose(u, [x, -x, y, -y, z, -z, *np.array(OBLIQUE_U)], atol=1e-15)


@pytest.mark.parametrize(
    ("name", "kinds"),
    [("cube-14", {1, 3}), ("cube-26", {1, 2, 3}), ("cube-12", {2}), ("faces-edges-18", {1, 2})],
)
def test_a_cube_stands_on_every_face_edge_or_vertex_once(name: str, kinds: set[int]) -> None:
    made = programme(name)
    signs = np.array([s for s in product((-1.0, 0.0, 1.0), repeat=3) if np.count_nonzero(s) in kinds])
    expected = signs / np.linalg.norm(signs, axis=1)[:, None]
    found = np.array([p.vertical_b for p in made.positions])
    assert len(found) == len(expected) == int(name[-2:])
    np.testing.assert_allclose(np.sort((expected @ found.T).max(axis=1)), 1.0, rtol=1e-14)
    np.testing.assert_allclose(found[np.argmax(expected @ found.T, axis=1)], expected, atol=1e-15)
    assert not made.ordered


@pytest.mark.parametrize("name", BUILT_IN)
def test_every_built_in_programme_keeps_its_name_and_has_a_move_between_positions(name: str) -> None:
    made = programme(name)
    assert made.name == name
    assert len(made.moves) == len(made.positions) - 1
    for position in made.positions:
        np.testing.assert_array_equal(position.matrix, attitude(position.attitude))


def test_labels_say_what_is_up() -> None:
    labels = [p.label for p in programme("nine").positions]
    assert labels == [
        "X up", "X down", "Y up", "Y down", "Z up", "Z down",
        "X 45° up, Y 45° down", "X 45° up, Z 45° down", "Y 45° up, Z 45° down",
    ]  # fmt: skip
    assert from_attitudes(["NUE E+30"]).positions[0].label == "X 30° up, Y 60° up"


def test_listed_positions_keep_their_order_and_any_move_joins_them() -> None:
    made = from_attitudes(["NUE", "NUE N+45", "ENU"])
    assert [p.attitude for p in made.positions] == ["NUE", "NUE N+45", "ENU"]
    assert made.moves == (ANY_MOVE, ANY_MOVE)
    assert made.ordered
    assert made.name not in BUILT_IN


@pytest.mark.parametrize("name", ["rough", "", "rough-table\n", "Nine"])
def test_an_unknown_programme_is_one_line_that_lists_the_known_ones(name: str) -> None:
    with pytest.raises(ProgrammeError) as caught:
        programme(name)
    assert all(known in str(caught.value) for known in BUILT_IN)
    assert "\n" not in str(caught.value)


def test_no_positions_is_an_error() -> None:
    with pytest.raises(ProgrammeError, match="expected at least one position, found none"):
        from_attitudes([])


def test_rough_table_takes_twenty_minutes_at_rests_of_a_minute() -> None:
    """15 rests of 60 s, nine turns by 180° at 10°/s, five other moves of 30 s."""
    made = programme("rough-table")
    asked = {"rest": 60.0, "rate": 10.0 * DEGREE, "move": 30.0}
    assert timetable(made, **asked)[-1, 1] == pytest.approx(15 * 60 + 9 * 18 + 5 * 30, rel=1e-12)
    starts = [0, 78, 156, 234, 324, 402, 480, 558, 648, 726, 804, 882, 972, 1062, 1152]
    np.testing.assert_allclose(timetable(made, **asked), [[s, s + 60] for s in starts], rtol=1e-12)


@given(
    st.lists(st.one_of(st.none(), st.floats(-6.28, 6.28)), max_size=8),
    st.floats(0.1, 1e4),
    st.floats(1e-3, 10.0),
    st.floats(0.0, 1e4),
)
def test_a_programme_takes_as_long_as_its_rests_turns_and_moves(
    angles: list[float | None], rest: float, rate: float, move: float
) -> None:
    moves = tuple(ANY_MOVE if a is None else Move(axis=U, angle=a) for a in angles)
    listed = from_attitudes(["NUE"] * (len(angles) + 1))
    made = Programme(name="made", positions=listed.positions, moves=moves, ordered=True)
    moving = sum(move if a is None else abs(a) / rate for a in angles)
    stop = timetable(made, rest=rest, rate=rate, move=move)[-1, 1]
    assert stop == pytest.approx((len(angles) + 1) * rest + moving, rel=1e-9)


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ({"rest": 0.0}, "rest: expected a positive number of seconds, found 0"),
        ({"rate": -10.0 * DEGREE}, "rate: expected a positive number of deg/s, found -10"),
        ({"rate": math.inf}, "rate: expected a positive number of deg/s, found inf"),
        ({"move": -1.0}, "move: expected a number of seconds, not negative, found -1"),
    ],
)
def test_an_impossible_pace_is_one_line(asked: dict[str, float], said: str) -> None:
    with pytest.raises(ProgrammeError) as caught:
        timetable(programme("nine"), **({"rest": 60.0, "rate": 0.2, "move": 30.0} | asked))
    assert str(caught.value) == said


@pytest.mark.parametrize("signs", ["+X+Y+Z", "+X-Y-Z", "-X+Y-Z"])
def test_a_corner_has_a_name(signs: str) -> None:
    up = attitude(f"corner {signs}")[1]
    assert np.allclose(up, [float(f"{s}1") / np.sqrt(3.0) for s in signs[::2]], atol=1e-15)
    turned = attitude(f"corner {signs} U+120")
    assert np.allclose(turned[1], up, atol=1e-15)
    assert any(np.allclose(turned, attitude(f"{letters} N+45 E+35.26438968275465"), atol=1e-12) for letters in TRIPLES)


@pytest.mark.parametrize("code", ["corner", "corner XYZ", "corner +X+Y", "corner +X+Y+Z+"])
def test_a_corner_that_is_none_is_named(code: str) -> None:
    with pytest.raises(ProgrammeError, match=r"such as corner \+X-Y\+Z, found"):
        attitude(code)


def test_codes_of_cubes_have_no_decimals() -> None:
    assert not any("." in p.attitude for p in programme("cube-26").positions)
