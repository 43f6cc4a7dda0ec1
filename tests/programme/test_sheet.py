"""The operator's sheet: words, pictures and page say what the programme says, and the documentation is current.

`python -m tests.programme.test_sheet` draws the picture of docs/reference/programmes.md anew.
"""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.programme.test_programme import triples
from tests.support import ROOT
from tumble.errors import InputError, ProgrammeError
from tumble.programme.positions import (
    ANY_MOVE,
    BUILT_IN,
    Move,
    Position,
    Programme,
    attitude,
    from_attitudes,
    programme,
)
from tumble.programme.sheet import AXIS, CUBE, SCALE, VIEW, legend, picture, sheet_drawing, sheet_page
from tumble.programme.sheet_words import clock, direction, move_text, sheet_rows
from tumble.rotation import rotation_matrix
from tumble.units import DEGREE, Array
from tumble.views.render import terminal
from tumble.views.sheet import sheet_blocks, write_sheet

SVG = "{http://www.w3.org/2000/svg}"
N, U, E = np.eye(3)
DOCS = ROOT / "docs"
PICTURES = {"sheet-rough-table.svg": "rough-table"}

MADE = {name: programme(name) for name in BUILT_IN}

units = st.tuples(*[st.floats(-1.0, 1.0)] * 3).map(np.array).filter(lambda v: float(np.linalg.norm(v)) > 0.1)
units = units.map(lambda v: v / np.linalg.norm(v))
codes = st.builds(
    lambda letters, turns: " ".join([letters, *(f"{a}{t:+.3f}" for a, t in turns)]),
    st.sampled_from(triples()),
    st.lists(st.tuples(st.sampled_from("NUE"), st.floats(-360.0, 360.0)), max_size=3),
)


def position(code: str) -> Position:
    return from_attitudes([code]).positions[0]


# -------------------- words --------------------


@pytest.mark.parametrize(
    ("vector", "said"),
    [
        ((1.0, 0.0, 0.0), "N"),
        ((0.0, -1.0, 0.0), "D"),
        ((1.0, 0.0, 1.0), "NE"),
        ((-1.0, 0.0, -1.0), "SW"),
        ((0.0, 1.0, 1.0), "45° up to E"),
        ((-1.0, -1.0, 0.0), "45° down to S"),
        ((-0.5, 0.0, math.sqrt(0.75)), "120°"),
        ((math.cos(0.05), math.tan(0.5), math.sin(0.05)), "29° up to 003°"),
        ((math.cos(0.004), 0.0, -math.sin(0.004)), "N"),
    ],
)
def test_directions_are_said_by_letters_or_by_elevation_and_bearing(vector: tuple[float, ...], said: str) -> None:
    assert direction(np.array(vector) / np.linalg.norm(vector)) == said


def pointed(said: str) -> Array:
    """The vector that words of `direction` mean, read independently."""
    if said in ("U", "D"):
        return U if said == "U" else -U
    found = re.fullmatch(r"(?:(\d+)° (up|down) to )?(?:([NESW]+)|(\d{3})°)", said)
    assert found is not None, said
    elevation = DEGREE * int(found[1] or 0) * (1 if found[2] == "up" else -1)
    course = ["N", "NE", "E", "SE", "S", "SW", "W", "NW"].index(found[3]) * 45 if found[3] else int(found[4])
    bearing = DEGREE * course
    level = math.cos(bearing) * N + math.sin(bearing) * E
    return np.asarray(math.cos(elevation) * level + math.sin(elevation) * U)


@given(units)
def test_words_for_a_direction_mean_it_to_a_degree(vector: Array) -> None:
    assert math.acos(min(1.0, float(vector @ pointed(direction(vector))))) < 0.75 * DEGREE


def test_moves_are_said_with_sign_and_axis() -> None:
    moves = [move_text(m) for m in programme("rough-table").moves[:4]]
    assert moves == ["turn +180° about N", "turn +180° about U", "turn −180° about N", "any move"]
    assert move_text(Move(axis=-E, angle=-90.5 * DEGREE)) == "turn −90.5° about W"


@pytest.mark.parametrize(
    ("seconds", "said"), [(0.0, "0:00"), (59.6, "1:00"), (1212.03, "20:12"), (3599.6, "1:00:00"), (3725.0, "1:02:05")]
)
def test_times_are_minutes_and_seconds(seconds: float, said: str) -> None:
    assert clock(seconds) == said


@pytest.mark.parametrize("name", BUILT_IN)
def test_every_position_and_move_is_in_the_rows_in_order(name: str) -> None:
    made = MADE[name]
    rows = sheet_rows(made, rest=10.0, rate=math.pi / 20.0, move=5.0)
    assert [row.number for row in rows] == list(range(1, len(made.positions) + 1))
    if made.ordered:
        assert [row.how for row in rows] == ["start", *(move_text(m) for m in made.moves)]
    else:
        off = [int(np.count_nonzero(np.abs(stood.vertical_b) > 0.1)) for stood in made.positions]
        assert [row.how for row in rows] == [{1: "on a face", 2: "on an edge", 3: "on a corner"}[k] for k in off]
    now = 0.0
    for row, stood in zip(rows, made.positions, strict=True):
        if row.number > 1:
            now += 20.0 if row.how.startswith("turn") else 5.0
        assert (row.start, row.stop) == pytest.approx((now, now + 10.0))
        now = row.stop
        np.testing.assert_allclose(attitude(row.attitude), stood.matrix, atol=1e-6)
        for axis, said in zip(stood.matrix.T, row.points, strict=True):
            assert float(axis @ pointed(said)) > math.cos(DEGREE)


def printed(made: Programme) -> str:
    return terminal.text_of(sheet_blocks(made))


@pytest.mark.parametrize("name", BUILT_IN)
def test_the_table_fits_into_a_hundred_columns(name: str) -> None:
    table, _ = printed(MADE[name]).split("\n\n", 2)[1:]
    assert max(map(len, table.splitlines())) <= 100


def test_the_table_takes_codes_as_they_are_not_as_markup() -> None:
    odd = replace(position("NUE"), attitude="[red]NUE[/red]", label="[/]")
    text = printed(Programme(name="[bold]odd", positions=(odd,), moves=(), ordered=True))
    assert "[red]NUE[/red]" in text
    assert "[bold]odd" in text
    assert "[/]" in text


# -------------------- pictures --------------------


def numbers(points: str) -> Array:
    """Points of a polygon in picture coordinates, y up."""
    return np.array([[float(v) for v in p.split(",")] for p in points.split()]) / SCALE * [1.0, -1.0]


def groups(text: str) -> list[tuple[str, ET.Element]]:
    """Class and element of the groups of a picture, from back to front."""
    return [(g.get("class") or "", g) for g in ET.fromstring(text).findall(f"{SVG}g")]


def tip(group: ET.Element) -> Array:
    cone = group.find(f"{SVG}polygon")
    assert cone is not None
    return np.asarray(numbers(cone.get("points") or "")[0])


def test_the_viewer_stands_south_and_above_and_nothing_is_mirrored() -> None:
    np.testing.assert_allclose(VIEW @ VIEW.T, np.eye(3), atol=1e-15)
    assert float(np.linalg.det(VIEW)) == pytest.approx(1.0)
    north, up, east = VIEW.T
    assert up[0] == pytest.approx(0.0, abs=1e-15)
    assert up[1] > 0.7
    assert east[0] > 0.9
    assert north[1] > 0.5
    assert up[2] > 0.0 > north[2]


def test_the_legend_points_to_north_up_and_east() -> None:
    drawn = dict(groups(legend()))
    for letter, vector in zip("NUE", (N, U, E), strict=True):
        np.testing.assert_allclose(tip(drawn[f"axis-{letter}"]), (AXIS * VIEW @ vector)[:2], atol=0.06 / SCALE)


@given(codes)
def test_arrows_of_any_attitude_end_where_it_says(code: str) -> None:
    check_arrows(position(code))


def check_arrows(stood: Position) -> None:
    drawn = dict(groups(picture(stood)))
    letters = []
    for axis, vector in zip("XYZ", stood.matrix.T, strict=True):
        group = drawn[f"axis-{axis}"]
        at = AXIS * VIEW @ vector
        np.testing.assert_allclose(tip(group), at[:2], atol=0.06 / SCALE)
        shaft, label = group.find(f"{SVG}line"), group.find(f"{SVG}text")
        assert shaft is not None
        assert label is not None
        start = np.array([float(shaft.get("x1") or ""), -float(shaft.get("y1") or "")]) / SCALE
        np.testing.assert_allclose(start, CUBE / AXIS * at[:2], atol=0.06 / SCALE)
        letter = np.array([float(label.get("x") or ""), -float(label.get("y") or "")]) / SCALE
        assert float(np.linalg.norm(letter - at[:2])) < 0.25 < AXIS
        letters.append(label.text)
    assert letters == ["X", "Y", "Z"]


@pytest.mark.parametrize("name", BUILT_IN)
def test_what_the_cube_hides_is_drawn_before_it(name: str) -> None:
    """Along the ray from a point of an arrow to the viewer, and away from the viewer, is there cube?"""
    hidden_at_all = 0
    for stood in MADE[name].positions:
        order = [kind for kind, _ in groups(picture(stood))]
        assert sorted(order) == ["axis-X", "axis-Y", "axis-Z", "cube"]
        for axis, letter in enumerate("XYZ"):
            points = np.linspace(CUBE + 1e-6, AXIS, 15)[:, None, None] * np.eye(3)[axis]
            steps = np.linspace(1e-3, 4.0, 400)[:, None] * (VIEW @ stood.matrix)[2]
            hidden, hiding = in_cube(points + steps), in_cube(points - steps)
            assert not (hidden and hiding)
            before = order.index(f"axis-{letter}") < order.index("cube")
            assert not (hidden and not before)
            assert not (hiding and before)
            hidden_at_all += hidden
    assert hidden_at_all > len(MADE[name].positions) / 2


def in_cube(points_b: Array) -> bool:
    """Whether any of the points is in the cube."""
    return bool(np.any(np.all(np.abs(points_b) < CUBE - 1e-9, axis=-1)))


@pytest.mark.parametrize("name", BUILT_IN)
def test_the_three_faces_drawn_are_those_turned_to_the_viewer(name: str) -> None:
    for stood in MADE[name].positions:
        L = VIEW @ stood.matrix
        cube = dict(groups(picture(stood)))["cube"]
        faces = [numbers(p.get("points") or "") for p in cube.findall(f"{SVG}polygon")]
        expected = [(k, s) for k in range(3) for s in (1.0, -1.0) if s * L[2, k] > 0.0]
        assert len(faces) == len(expected) == 3
        for face, (k, s) in zip(faces, expected, strict=True):
            others = np.delete(np.eye(3), k, axis=0)
            signs = ((1, 1), (1, -1), (-1, 1), (-1, -1))
            corners = [(CUBE * L @ (s * np.eye(3)[k] + a * others[0] + b * others[1]))[:2] for a, b in signs]
            apart = np.linalg.norm(np.array(corners)[:, None] - face, axis=-1)
            assert sorted(np.argmin(apart, axis=1)) == [0, 1, 2, 3]
            np.testing.assert_allclose(apart.min(axis=1), 0.0, atol=0.1 / SCALE)
            x, y = face.T
            area = 0.5 * abs(float(x @ np.roll(y, 1) - y @ np.roll(x, 1)))
            assert area == pytest.approx((2.0 * CUBE) ** 2 * abs(L[2, k]), abs=0.01), "edges follow each other"


@pytest.mark.parametrize("axis", [N, U, E, -N, -U, -E, np.array([0.6, 0.64, 0.48])])
@pytest.mark.parametrize("angle", [math.pi, -math.pi, 0.5 * math.pi, -0.5 * math.pi, 2.0])
def test_a_turn_is_drawn_about_its_axis_the_right_way_round(axis: Array, angle: float) -> None:
    """The arc is the path of a point that is turned by the angle, and its arrow lies ahead of its end."""
    turn = dict(groups(picture(position("NUE"), Move(axis=axis, angle=angle))))["turn"]
    arc, head = turn.find(f"{SVG}polyline"), turn.find(f"{SVG}polygon")
    assert arc is not None
    assert head is not None
    path = numbers(arc.get("points") or "")
    # The arc about a point c of the axis: the path is c + rotated(offset), so with two unknown scalars it is linear.
    flat = (VIEW @ axis)[:2]
    steps = np.linspace(0.0, angle, len(path))
    tangent = np.cross(axis, [0.31, 0.52, -0.8])
    basis = [tangent, np.cross(axis, tangent)]
    columns = [np.concatenate([(VIEW @ rotation_matrix(s * axis) @ b)[:2] for s in steps]) for b in basis]
    columns.append(np.tile(flat, len(path)))
    A = np.column_stack(columns)
    fit, *_ = np.linalg.lstsq(A, path.ravel(), rcond=None)
    np.testing.assert_allclose(A @ fit, path.ravel(), atol=0.08 / SCALE)
    assert fit[2] > 1.0, "at the end the axis points to"
    assert 0.2 < float(np.linalg.norm(fit[0] * basis[0] + fit[1] * basis[1])) < 0.4
    point, back, _ = numbers(head.get("points") or "")
    assert float((point - path[-1]) @ (path[-1] - path[-2])) > 0.0
    assert float(np.linalg.norm(back - path[-1])) < 0.12


def test_a_turn_is_drawn_where_there_is_one_and_nowhere_else() -> None:
    for row in sheet_rows(programme("rough-table")):
        drawn = [kind for kind, _ in groups(picture(row.position, row.move))]
        assert ("turn" in drawn) is row.how.startswith("turn")
    assert "turn" not in [kind for kind, _ in groups(picture(position("NUE"), ANY_MOVE))]


@given(codes, st.one_of(st.just(ANY_MOVE), st.builds(lambda n, a: Move(axis=n, angle=a), units, st.floats(-7.0, 7.0))))
def test_pictures_are_well_formed_and_stay_within_their_edges(code: str, move: Move) -> None:
    root = ET.fromstring(picture(position(code), move))
    left, top, width, height = (float(v) for v in (root.get("viewBox") or "").split())
    for element in root.iter():
        for key, value in element.attrib.items():
            assert not {"nan", "inf"} & set(re.findall("[a-z]+", value)), (key, value)
    for axis in "XYZ":
        group = root.find(f"{SVG}g[@class='axis-{axis}']")
        assert group is not None
        x, y = tip(group) * [SCALE, -SCALE]
        assert left < x < left + width
        assert top < y < top + height


# -------------------- drawing and page --------------------


def parsed(page: str) -> ET.Element:
    return ET.fromstring(page.removeprefix("<!DOCTYPE html>\n"))


def text_of(element: ET.Element) -> str:
    return "".join(element.itertext())


@pytest.mark.parametrize("name", BUILT_IN)
def test_page_drawing_and_table_have_every_position_with_its_picture_and_words(name: str) -> None:
    made = MADE[name]
    lines = parsed(sheet_page(made)).findall("./body/table/tbody/tr")
    cells = ET.fromstring(sheet_drawing(made)).findall(f"{SVG}g")[1:]
    text = " ".join(printed(made).split())
    for line, cell, row in zip(lines, cells, sheet_rows(made), strict=True):
        drawn, scene = line.find(f".//{SVG}svg"), cell.find(f"{SVG}g")
        assert drawn is not None
        assert scene is not None
        expected = [ET.tostring(group) for _, group in groups(picture(row.position, row.move))]
        assert [ET.tostring(group) for group in drawn.findall(f"{SVG}g")] == expected
        assert [ET.tostring(group) for group in scene.findall(f"{SVG}g")] == expected
        for words in (row.how, row.position.label, row.attitude):
            assert words in text_of(line)
            assert words in text_of(cell)
            assert words in text
        for axis, where in zip("XYZ", row.points, strict=True):
            assert f"{axis} → {where}" in text_of(line)


HOSTILE = '<script>alert("x")</script>&amp;\''


def test_names_and_serial_numbers_are_text_not_markup() -> None:
    odd = replace(position("NUE"), attitude=HOSTILE, label=HOSTILE)
    made = Programme(name=HOSTILE, positions=(odd, odd), moves=(ANY_MOVE,), ordered=True)
    page = sheet_page(made, serial=HOSTILE)
    said = text_of(parsed(page))
    assert said.count(HOSTILE) >= 2 + 1 + 3 * 2  # title, heading, serial; picture, label and code of two positions
    assert f"Device {HOSTILE}" in said
    drawing = sheet_drawing(made)
    assert text_of(ET.fromstring(drawing)).count(HOSTILE) >= 2 + 2 * 2
    for markup in (page, drawing, picture(odd)):
        assert "<script" not in markup


@pytest.mark.parametrize("name", BUILT_IN)
def test_the_page_needs_nothing_else(name: str) -> None:
    page = sheet_page(MADE[name], serial="A-0007")
    assert set(re.findall(r"\w+://[^\"'\s<]+", page)) == {"http://www.w3.org/2000/svg"}  # a name, not an address
    assert "url(" not in page
    assert "@import" not in page
    elements = list(parsed(page).iter())
    tags = {element.tag.rpartition("}")[2] for element in elements}
    assert not tags & {"script", "link", "img", "iframe", "object", "image", "use", "a"}
    assert not any(key.startswith("on") or key in {"src", "href"} for element in elements for key in element.attrib)


def test_a_file_is_a_page_or_a_drawing_by_its_ending(tmp_path: Path) -> None:
    made = from_attitudes(["NUE", "UEN N+45"])
    write_sheet(tmp_path / "sheet.html", made, rest=5.0, move=2.0, serial="Ж-7")
    write_sheet(tmp_path / "sheet.svg", made, rest=5.0, move=2.0)
    page = (tmp_path / "sheet.html").read_text(encoding="utf-8")
    assert page == sheet_page(made, rest=5.0, move=2.0, serial="Ж-7")
    assert "2 positions, 0:12 in all: rests of 5 s, 2 s for a move" in page
    assert (tmp_path / "sheet.svg").read_text(encoding="utf-8") == sheet_drawing(made, rest=5.0, move=2.0)


def test_a_sheet_as_pdf_is_the_same_bytes_and_takes_any_name(tmp_path: Path) -> None:
    """In the archive form, every position on it; what a name contains is no markup of the typesetter."""
    odd = replace(position("NUE"), attitude="#panic()", label="*[$")
    made = Programme(name='#read("/etc/passwd")', positions=(odd, odd), moves=(ANY_MOVE,), ordered=True)
    for name in ("one.pdf", "two.pdf"):
        write_sheet(tmp_path / name, made, serial="Ж-7", number="#1", revision="\\")
    content = (tmp_path / "one.pdf").read_bytes()
    assert content.startswith(b"%PDF-")
    assert b"pdfaid" in content
    assert content == (tmp_path / "two.pdf").read_bytes()


@pytest.mark.parametrize(("file", "said"), [("sheet.doc", "found '.doc'"), ("sheet", "found 'no ending'")])
def test_another_ending_is_one_line_and_writes_nothing(tmp_path: Path, file: str, said: str) -> None:
    with pytest.raises(InputError) as caught:
        write_sheet(tmp_path / file, programme("nine"))
    assert "expected a file that ends in .html, .pdf or .svg" in str(caught.value)
    assert said in str(caught.value)
    assert not list(tmp_path.iterdir())


def test_a_folder_that_is_not_there_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no/sheet\.svg: expected a file that can be written: the folder"):
        write_sheet(tmp_path / "no" / "sheet.svg", programme("nine"))


def test_an_impossible_pace_is_refused() -> None:
    with pytest.raises(ProgrammeError, match="rest: expected a positive number of seconds, found -1"):
        sheet_page(programme("nine"), rest=-1.0)


# -------------------- documentation --------------------


def test_codes_of_the_documentation_point_where_it_says() -> None:
    text = (DOCS / "reference/programmes.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `([NSEWUD]{3}[^`]*)` \| ([^|]+) \| ([^|]+) \| ([^|]+) \|$", text, flags=re.MULTILINE)
    assert len(rows) == 5
    for code, *points in rows:
        assert [direction(axis) for axis in attitude(code).T] == points


@pytest.mark.parametrize("file", PICTURES)
def test_the_pictures_of_the_documentation_are_current(file: str) -> None:
    """The same words and, to the last digit written, the same numbers."""
    number = re.compile(r"-?\d+\.\d+")
    kept = (DOCS / "pictures" / file).read_text(encoding="utf-8")
    made = sheet_drawing(programme(PICTURES[file]))
    assert number.sub("#", kept) == number.sub("#", made)
    np.testing.assert_allclose(
        [float(v) for v in number.findall(kept)], [float(v) for v in number.findall(made)], atol=0.1001
    )


if __name__ == "__main__":
    for file, name in PICTURES.items():
        write_sheet(DOCS / "pictures" / file, programme(name))
