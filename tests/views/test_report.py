"""Reports: what stands in them is what the calibration file says, and nothing in them acts, loads or is missing.

HTML is read back with the parser of the standard library, PDF with MuPDF, and the page is opened in a real browser.
"""

from __future__ import annotations

import copy
import hashlib
import json
import math
import os
import re
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner, Result
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.figure import Figure

from tests.support.browser import Browser, chromium, eventually
from tests.support.calibrated import HEXAD
from tests.support.calibrated import calibration as exact
from tests.support.linear_instrument import stated_linear
from tests.support.pages import Page, last_digit, number, opened, pdf_text
from tests.support.shared import copy_of
from tests.support.shared import session as shared
from tumble.cli import main
from tumble.errors import MissingExtraError
from tumble.inference.estimate import Outcome
from tumble.inference.prediction import Prediction
from tumble.planning.setup import Setup
from tumble.result.calibration import read_calibration
from tumble.result.further import parameter_words
from tumble.result.parts import coverage_factor
from tumble.run.calibrate import calibrate
from tumble.run.from_readings import calibrate_readings
from tumble.sensors.model import SensorModel
from tumble.sensors.parameters import FURTHER, Terms
from tumble.simulation.session import simulate_session
from tumble.units import ARCSEC, DEGREE, DEGREE_PER_HOUR, G_STANDARD
from tumble.views.numbers import fixed, significant
from tumble.views.render.characters import drawable, visible
from tumble.views.render.pages import page as to_page
from tumble.views.render.pages import pdf as to_pdf
from tumble.views.render.pictures import svg_of
from tumble.views.report.document import ReportedFile, report_of, sources_of, write_report
from tumble.views.report.result import before_and_after, contents_of_u

SHORT = Setup.of(grade="tactical", rest=10.0, rate_deg_s=45.0, sample_rate=50.0)
SIZES = {
    "µg": 1e-6 * G_STANDARD,
    "mg": 1e-3 * G_STANDARD,
    "ppm": 1e-6,
    '"': ARCSEC,
    "mrad": 1e-3,
    "°/h": DEGREE_PER_HOUR,
    "°/s": DEGREE,
} | {name: size for group in FURTHER for size, name in group.shown}
SCRIPT = "<script>alert(1)</script>"
MARKUP = '#panic("x") $x^2$ *b* _i_ `c` \\ ]#[ {{ 7*7 }} {% raise %} --> & <img src=x>'


# -------------------- calibrations and their reports --------------------


@pytest.fixture(scope="session")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return copy_of(shared(SHORT, seed=3), tmp_path_factory.mktemp("report") / "one")


@pytest.fixture(scope="session")
def file(session: Path) -> Path:
    path = session.parent / "joint.json"
    calibrate(stated_linear(session), terms="linear").write(path)
    return path


@pytest.fixture(scope="session")
def other_method(session: Path) -> Path:
    path = session.parent / "scalar.json"
    calibrate(stated_linear(session), method="scalar", terms="linear").write(path)
    return path


@pytest.fixture(scope="session")
def content(file: Path) -> Any:
    return json.loads(file.read_text(encoding="utf-8"))


@pytest.fixture(scope="session")
def html(file: Path) -> Path:
    path = file.parent / "report.html"
    write_report([file], path)
    return path


@pytest.fixture(scope="session")
def page(html: Path) -> Page:
    return Page.of(html)


def changed(content: Any, tmp_path: Path, change: Callable[[Any], None]) -> Path:
    """A calibration file with a change to its content."""
    other = copy.deepcopy(content)
    change(other)
    path = tmp_path / "changed.json"
    path.write_text(json.dumps(other), encoding="utf-8")
    return path


def command(*arguments: object) -> Result:
    result = CliRunner().invoke(main, ["report", *map(str, arguments)])
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    return result


# -------------------- the content --------------------


def test_values_and_u_are_those_of_the_file_to_two_digits_of_u(page: Page, content: Any) -> None:
    rows = page.table("parameter", "value", "U (95 %)", "unit")
    assert [row["parameter"] for row in rows] == [p["name"] for p in content["parameters"]]
    for row, p in zip(rows, content["parameters"], strict=True):
        size, value, expanded = SIZES[row["unit"]], row["value"], row["U (95 %)"]
        assert number(value) == pytest.approx(p["value"] / size, abs=0.5001 * last_digit(value)), p["name"]
        assert number(expanded) == pytest.approx(
            coverage_factor(p.get("dof", math.inf)) * p["u"] / size, abs=0.5001 * last_digit(expanded)
        )
        assert len(expanded.replace(".", "").lstrip("0")) == 2
        assert last_digit(value) == last_digit(expanded)


def test_the_front_says_which_device_where_and_how(page: Page, content: Any) -> None:
    site = content["site"]
    for said in (
        content["device"]["serial"],
        f"{site['latitude'] / DEGREE:.8g}°",
        f"{site['gravity']:.7f} m/s², U = {significant(2.0 * site['gravity_u'], 2)} m/s² (k = 2)",
        "rough-table",
        "joint, frame “accelerometer”",
        content["provenance"]["created"][:10],
        content["provenance"]["software"],
        content["provenance"]["log_sha256"],
    ):
        assert said in page.whole, said


def test_rests_stand_with_their_positions_and_how_far_they_are_off(page: Page, content: Any) -> None:
    """The angle between the nominal vertical and the corrected reading, from the file alone."""
    rows = page.table("rest", "position", "code", "off °", "residual µg", "sigmas")
    matrix, bias = np.array(content["accel"]["matrix"]), np.array(content["accel"]["bias"])
    nominal = {"X up": [1, 0, 0], "X down": [-1, 0, 0], "Y up": [0, 1, 0], "Y down": [0, -1, 0], "Z up": [0, 0, 1]}
    nominal |= {"Z down": [0, 0, -1], "X 45° up, Y 45° down": [1, -1, 0], "X 45° up, Z 45° down": [1, 0, -1]}
    nominal |= {"Y 45° up, Z 45° down": [0, 1, -1]}
    assert len(rows) == len(content["rests"]) == 15
    for row, rest in zip(rows, content["rests"], strict=True):
        force = np.linalg.solve(matrix, np.array(rest["accel"]["mean"]) - bias)
        wanted = np.array(nominal[row["position"]], float)
        cosine = force @ wanted / np.linalg.norm(force) / np.linalg.norm(wanted)
        assert number(row["off °"]) == pytest.approx(np.arccos(cosine) / DEGREE, abs=0.0051)
        assert number(row["residual µg"]) == pytest.approx(rest["residual"] / G_STANDARD * 1e6, abs=0.051)
        assert number(row["sigmas"]) == pytest.approx(rest["sigmas"], abs=0.051)
        assert row["code"] == rest["attitude"]


def test_programmed_turns_are_found_within_the_errors_of_the_table(page: Page, content: Any) -> None:
    """180° about one axis, each position within ±1° about three axes: the angle is within 4° of it."""
    rows = page.table("turn from rest", "programme °", "found °")
    assert len(rows) == len(content["turns"]) == 14
    programmed = [row for row in rows if row["programme °"] != "—"]
    assert len(programmed) == 9
    for row, turn in zip(rows, content["turns"], strict=True):
        assert number(row["found °"]) == pytest.approx(turn["angle"] / DEGREE, abs=0.0051)
    for row in programmed:
        assert row["programme °"] == "180"
        assert 176.0 < number(row["found °"]) <= 180.0


def test_the_strongest_correlations_are_those_of_the_covariance(page: Page, content: Any) -> None:
    names = [p["name"] for p in content["parameters"]]
    covariance = np.array(content["covariance"])
    u = np.sqrt(np.diag(covariance))
    r = covariance / np.outer(u, u)
    rows = page.table("parameter", "with", "coefficient")
    shown = [abs(number(row["coefficient"])) for row in rows]
    for row in rows:
        p, q = names.index(row["parameter"]), names.index(row["with"])
        assert p != q
        assert number(row["coefficient"]) == pytest.approx(r[p, q], abs=0.00051)
    others = sorted(np.abs(r[np.tril_indices(len(names), -1)]))[::-1]
    np.testing.assert_allclose(shown, others[: len(shown)], atol=0.00051)


def test_what_u_contains_is_what_its_budget_has(page: Page) -> None:
    """Linear terms of a session leave other groups out of the parameters, not out of u; those of a table do both."""
    groups, nonlinearity = "the groups beyond the linear model, as far as", "nonlinearity that is the same"
    assert groups in page.whole
    assert nonlinearity not in page.whole
    cube = np.array([[x, y, z] for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1) if x or y or z], dtype=float)
    cube /= np.linalg.norm(cube, axis=1)[:, None]
    cases: tuple[tuple[Terms, str], ...] = (("full", groups), ("linear", nonlinearity))
    for terms, contained in cases:
        table = calibrate_readings(cube, unit="g", grade="mems", terms=terms).calibration
        assert contained in contents_of_u(table)


def test_the_test_vectors_follow_from_the_printed_numbers(page: Page, content: Any) -> None:
    """With printed matrices and biases, and with those of the file; a reader without the file can check a program."""
    matrices = [np.array(m) for m in page.matrices()]
    assert len(matrices) == 10
    for kind, (matrix, bias, inverse, reading, true) in zip(
        ("accel", "gyro"), (matrices[:5], matrices[5:]), strict=True
    ):
        own = SensorModel(matrix=np.array(content[kind]["matrix"]), bias=np.array(content[kind]["bias"]))
        np.testing.assert_allclose(matrix, own.matrix, rtol=0.0, atol=0.51e-10)
        np.testing.assert_allclose(bias[:, 0], own.bias, rtol=0.0, atol=0.51e-10)
        np.testing.assert_allclose(true[:, 0], own.apply(reading[:, 0]), rtol=0.0, atol=0.51e-8)
        np.testing.assert_allclose(inverse @ (reading - bias), true, rtol=0.0, atol=1.01e-8)
        np.testing.assert_allclose(np.linalg.solve(matrix, reading - bias), true, rtol=0.0, atol=1.01e-8)


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("accel.bias.x", "X accelerometer, bias"),
        ("gyro.scale.z", "Z gyro, scale-factor error"),
        ("accel.axis.yx", "Y accelerometer, axis towards X"),
        ("accel.axis.3.1", "accelerometer 3, axis angle 1"),
        ("mag.bias.x", "X magnetometer, bias"),
        ("accel.bias", ""),
        (SCRIPT, ""),
    ],
)
def test_parameters_are_put_into_words(name: str, said: str) -> None:
    assert parameter_words(name) == said


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        (significant(2e-7, 2), "2·10⁻⁷"),
        (significant(-1234567.0, 3), "−1.23·10⁶"),
        (significant(0.5, 3), "0.5"),
        (fixed(-0.0004, 3), "0.000"),
        (fixed(-1.5, 1), "−1.5"),
    ],
)
def test_numbers_are_written_as_in_print(text: str, wanted: str) -> None:
    assert text == wanted


# -------------------- one file that needs nothing --------------------

LOADING = {"script", "link", "iframe", "object", "embed", "img", "image", "video", "audio", "source", "form", "base"}


def test_a_page_refers_to_nothing_outside(page: Page, html: Path) -> None:
    text = html.read_text(encoding="utf-8")
    assert "http" not in text.replace("http-equiv", "")
    assert "@import" not in text
    assert "@font-face" not in text
    assert set(re.findall(r"url\((.)", text)) <= {"#"}
    assert not LOADING & {tag for tag, _ in page.elements}
    named = [attributes["id"] for _, attributes in page.elements if "id" in attributes]
    assert len(named) == len(set(named))
    for tag, attributes in page.elements:
        for name, value in attributes.items():
            assert not name.startswith("on"), (tag, name)
            assert name not in ("src", "srcset", "data", "action", "poster", "ping"), (tag, name)
            if name.endswith("href"):
                assert (value or "").startswith("#"), (tag, name, value)
                assert (value or "")[1:] in named, (tag, name, value)
    assert set(re.findall(r"url\(#([^)]+)\)", text)) <= set(named)


def test_reports_of_the_same_file_are_the_same_bytes(file: Path, html: Path) -> None:
    digest = hashlib.sha256(file.read_bytes()).hexdigest()
    again = report_of([ReportedFile(file=file.name, sha256=digest, calibration=read_calibration(file))])
    assert to_page(again).encode() == html.read_bytes()


# -------------------- beyond the linear model --------------------


def with_groups(content: Any) -> None:
    """Two groups beyond the linear model, one of them by name unknown to the table, and remarks of the gyros."""
    size = len(content["parameters"])
    own = {"value": -3e-5, "u": 1e-5, "unit": "s^2/m", "prior": 5e-5, "learned": 0.96, "dof": 5.0}
    content["parameters"].append({"name": "accel.quadratic.x", **own})
    covariance = np.zeros((size + 1, size + 1))
    covariance[:size, :size] = content["covariance"]
    covariance[size, size] = 1e-10
    content["covariance"] = covariance.tolist()
    content["groups"] = [
        {"name": "accel.quadratic", "kept": True, "prior": 5e-5, "prior_widened": 2.5, "learned": [0.96]},
        {"name": SCRIPT, "kept": False, "prior": 1e-3, "prior_widened": 1.0, "learned": [0.0]},
    ]
    content["prediction"] = {"force_u": 1.7e-5, "rate_u": 2e-6, "at_rate": 0.4}
    fine: dict[str, list[str]] = {"reasons": [], "remarks": []}
    said = {"verdict": "accepted with scatter", "reasons": [], "remarks": [MARKUP]}
    concerns = {MARKUP: ["gyro"]}
    content["outcome"] = {
        "accepted": True,
        **said,
        "unobservable": [],
        "concerns": concerns,
        "accel": fine,
        "gyro": said,
    }


@pytest.fixture(scope="session")
def with_groups_page(content: Any, tmp_path_factory: pytest.TempPathFactory) -> Page:
    file = changed(content, tmp_path_factory.mktemp("groups"), with_groups)
    write_report(file, file.with_suffix(".html"))
    return Page.of(file.with_suffix(".html"))


def test_groups_have_a_section_with_their_priors(with_groups_page: Page) -> None:
    page = with_groups_page
    assert [heading.partition(" ")[2] for heading in page.headings][:3] == ["Result", "Notes", "How to apply it"]
    assert len(page.table("parameter", "value", "U (95 %)", "unit")) == 21
    known, unknown = page.table("group", "largest", "from data")
    assert known["what it is"] == "quadratic nonlinearity of the accelerometers, K₂"
    assert known["unit"] == "µg/g²"
    assert number(known["largest"]) == pytest.approx(3e-5 * G_STANDARD * 1e6, abs=5.0)
    assert known["from data"] == "96 %"
    assert known[""] == "2.5 times the usual size"
    assert (unknown["group"], unknown[""]) == (SCRIPT, "not determined")
    (row,) = page.table("parameter", "u", "k", "prior", "from data")
    assert row["parameter"] == "accel.quadratic.x"
    assert number(row["k"]) == pytest.approx(2.65, abs=0.02)
    assert "corrected specific force at 1 g: u 1.7 µg; corrected rate at 23 °/s: u 0.41 °/h" in page.whole


def test_scatter_has_its_own_colour_and_its_causes(with_groups_page: Page) -> None:
    assert ("p", {"class": "verdict doubt"}) in with_groups_page.elements
    assert not LOADING & {tag for tag, _ in with_groups_page.elements}
    for wanted in (
        "Accepted with scatter",
        "Accelerometers: accepted; gyros: accepted with scatter.",
        MARKUP,
        SCRIPT,
    ):
        assert wanted in with_groups_page.whole


# -------------------- nothing from a file acts --------------------


def hostile(content: Any) -> None:
    """Texts that would act in HTML, in typst, in matplotlib or on the eye."""
    content["device"] = {"serial": SCRIPT, "model": MARKUP}
    content["method"], content["programme"] = SCRIPT, MARKUP
    content["notes"] = [SCRIPT, MARKUP, "a" * 300, "\u202egnirts \u0000 \u4e2d"]
    content["outcome"] = {"accepted": False, "reasons": [SCRIPT, MARKUP], "unobservable": [SCRIPT]}
    content["provenance"] = {"log_sha256": SCRIPT, "software": MARKUP, "created": SCRIPT}
    content["rests"][0]["attitude"] = SCRIPT
    content["readings"]["accel"] |= {"columns": [SCRIPT, r"$\frac", "-->"], "unit": MARKUP}
    content["parameters"][0]["name"] = f"accel.bias.{SCRIPT}"
    content["parameters"][1]["unit"] = MARKUP
    content["fits"][SCRIPT] = content["fits"].pop("gyro turns")


@pytest.fixture(scope="session")
def hostile_html(content: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("hostile")
    reasons = write_report([changed(content, folder, hostile)], folder / "report.html")
    assert reasons == [f"not accepted: changed.json: {SCRIPT}", f"not accepted: changed.json: {MARKUP}"]
    return folder / "report.html"


def test_a_report_opens_with_the_picture_before_and_after(tmp_path: Path) -> None:
    """In the first section, above the table of parameters; of refused sensors there is none."""
    made = replace(exact(), prediction=Prediction(force_u=4e-3, rate_u=3e-4, at_rate=1.0))
    write_report(made, tmp_path / "r.html")
    page = (tmp_path / "r.html").read_text(encoding="utf-8")
    opening = [page.index(text) for text in ("At rest off by ", "What each parameter makes", "<td>")]
    assert opening == sorted(opening)
    write_report(replace(made, outcome=Outcome(reasons=("no",))), tmp_path / "refused.html")
    assert "What each parameter makes" not in (tmp_path / "refused.html").read_text(encoding="utf-8")


def test_texts_of_a_file_show_as_text_in_html(hostile_html: Path) -> None:
    page = Page.of(hostile_html)
    assert not LOADING & {tag for tag, _ in page.elements}
    assert page.whole.count(SCRIPT) > 8
    assert MARKUP in page.whole
    assert "[U+202E]gnirts [U+0000] \u4e2d" in page.whole
    assert "<script" not in hostile_html.read_text(encoding="utf-8")


def test_texts_of_a_file_show_as_text_in_pdf(content: Any, tmp_path: Path) -> None:
    out = tmp_path / "report.pdf"
    out.write_bytes(to_pdf(report_of(sources_of(changed(content, tmp_path, hostile)))))
    said = pdf_text(out)
    assert said.count(SCRIPT) > 8
    assert MARKUP in said
    assert "[U+202E]gnirts [U+0000] [U+4E2D]" in said
    with opened(out) as document:
        for sheet in document:
            assert not sheet.get_links()


@given(st.text(alphabet=st.characters(codec=None), max_size=20))
def test_no_character_acts_hides_or_is_missing(text: str) -> None:
    """Whatever the text, what is shown can be printed and encoded, and the fonts have every character of it."""
    shown = visible(text)
    assert shown.isprintable() or all(c.isprintable() or c.isspace() for c in shown)
    shown.encode()
    assert visible(shown) == shown
    assert drawable(drawable(text)) == drawable(text)
    assert len(drawable(text)) >= len(text)
    assert drawable("№ 7 ИНС µ″√≤⁻⁷ A-0007/β") == "№ 7 ИНС µ″√≤⁻⁷ A-0007/β"


def test_a_figure_does_not_depend_on_what_its_letters_say() -> None:
    """Text that would be mathematics, a comment or an element stays letters; outlines hold none of it."""

    def draw(figure: Figure) -> None:
        figure.add_subplot().set_title(f"$\\frac{{{SCRIPT} --> ")

    svg = svg_of("f", 2.0, 1.0, draw)
    assert "alert" not in svg
    assert "<!--" not in svg
    assert svg.startswith("<svg")


# -------------------- calibrations of every kind --------------------


CONTRACT: Mapping[str, Any] = {
    "format": 1,
    "device": {"serial": "A-0007", "model": None},
    "method": "joint",
    "frame": "accelerometer",
    "parameters": [{"name": "accel.bias.x", "value": 0.00135, "u": 4.2e-06, "unit": "m/s^2"}],
    "covariance": [[1.764e-11]],
    "accel": {"matrix": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "bias": [0.00135, 0, 0], "unit": "m/s^2"},
    "gyro": None,
    "outcome": {"accepted": True, "reasons": []},
    "iterations": [{"parameters": [{"name": "accel.bias.x", "increment": 0.00135}]}],
    "rests": [{"start": 0.0, "stop": 60.0, "residual": 1.1e-6}],
    "launches": [],
    "provenance": {"log_sha256": "00", "software": "tumble 0.1.0", "created": "2024-01-01T00:00:00+00:00"},
}


def without_u(content: Any) -> None:
    content["covariance"] = None
    for parameter in content["parameters"]:
        parameter["u"] = None


def refused(content: Any) -> None:
    content |= {"parameters": [], "covariance": None, "accel": None, "iterations": [], "rests": [], "provenance": {}}
    content["outcome"] = {"accepted": False, "reasons": ["no rests were found"]}


def redundant(content: Any) -> None:
    content["accel"]["matrix"].append([0.577, 0.577, 0.577])
    content["accel"]["bias"].append(0.01)


def four_gyros(content: Any) -> None:
    content["gyro"] = {"matrix": [[1, 0, 0], [0, 1, 0], [0, 0, 1], [0.5, 0.5, 0.7]], "bias": [0] * 4, "unit": "rad/s"}


def as_it_is(content: Any) -> None:
    assert content["format"] == 1


@pytest.mark.parametrize("change", [as_it_is, without_u, refused, redundant, four_gyros])
def test_a_file_with_only_the_keys_of_the_contract_has_a_report(tmp_path: Path, change: Callable[[Any], None]) -> None:
    out = tmp_path / "report.html"
    reasons = write_report([changed(CONTRACT, tmp_path, change)], out)
    said = Page.of(out).whole
    assert "A-0007" in said
    assert (reasons == []) == (change is not refused)
    if change is refused:
        assert "Not accepted" in said
        assert "no rests were found" in said
    else:
        assert "accel.bias.x" in said
        assert "Accepted" in said


def test_launches_stand_beside_each_other(session: Path, tmp_path: Path) -> None:
    second = simulate_session(tmp_path / "two", SHORT, seed=3, launch=2)
    made = CliRunner().invoke(main, ["calibrate", str(session), str(second), "--out", str(tmp_path / "both.json")])
    assert made.exit_code == 0, made.output
    assert command(tmp_path / "both.json", "-o", tmp_path / "both.html").exit_code == 0
    page, content = Page.of(tmp_path / "both.html"), json.loads((tmp_path / "both.json").read_text())
    rows = [row for table in page.all_tables("parameter", "one", "two", "run to run") for row in table]
    assert len(page.table("parameter", "one", "two", "run to run")) == 21
    for row, p, q in zip(rows, content["launches"][0]["parameters"], content["launches"][1]["parameters"], strict=True):
        size = SIZES[row["unit"]]
        for text, own in ((row["one"], p), (row["two"], q)):  # to the second digit of U
            exponent = f"{(own['k'] or 2.0) * own['u'] / size:.1e}".partition("e")[2]
            last = max(last_digit(text), 10.0 ** (int(exponent) - 1))
            assert number(text) == pytest.approx(own["value"] / size, abs=0.5001 * last)
    assert "the changes between the launches. It does not contain ageing" in page.whole
    for launch in content["launches"]:
        assert launch["log_sha256"] in page.whole
        assert any(f"Residuals: {launch['session']}" in heading for heading in page.headings)


@pytest.mark.parametrize(("positions", "checked"), [(14, True), (9, False)])
def test_a_table_of_readings_has_its_scatter_and_whether_anything_checks_it(
    tmp_path: Path, positions: int, checked: bool
) -> None:
    rng = np.random.default_rng(positions)
    faces = [sign * axis for axis in np.eye(3) for sign in (1.0, -1.0)]
    corners = np.array([[x, y, z] for x in (1, -1) for y in (1, -1) for z in (1, -1)]) / np.sqrt(3.0)
    edges = np.array([[1, 1, 0], [0, 1, -1], [1, 0, 1]]) / np.sqrt(2.0)
    directions = np.vstack([faces, corners if checked else edges])
    np.savetxt(
        tmp_path / "r.csv",
        directions + 1e-5 * rng.standard_normal(directions.shape),
        delimiter=",",
        header="x,y,z",
        comments="",
    )
    made = CliRunner().invoke(main, ["ellipsoid", str(tmp_path / "r.csv"), "--unit", "g", "--frame", "paper"])
    assert made.exit_code == 0, made.output
    assert command(tmp_path / "r.calibration.json", "-o", tmp_path / "r.html").exit_code == 0
    page = Page.of(tmp_path / "r.html")
    (row,) = page.table("residuals of", "chi-square", "scatter added")
    assert number(row["degrees of freedom"]) == positions - 9
    assert row["scatter added"].endswith("µg") == checked
    assert ("Nothing checks the accelerometers" in page.whole) != checked
    assert "k belongs to the diagonal of the matrix" in page.whole  # the frame of the paper has its own parameters
    assert not any(heading.startswith("height") for heading in page.text)


def test_a_height_that_was_not_stated_is_not_zero(content: Any, tmp_path: Path) -> None:
    for height, shown in ((None, "heightnot stated"), (0.0, "height0.0 m")):
        site = content["site"] | {"height": height}
        file = changed(content, tmp_path, partial(dict.update, site=site))
        write_report(file, tmp_path / "c.html")
        assert shown in Page.of(tmp_path / "c.html").whole


@pytest.mark.parametrize("biases_alone", [True, False])
def test_no_dot_of_the_picture_before_and_after_is_cut(biases_alone: bool) -> None:
    """Also not where there are three rows, as of a device that lay still."""
    made = exact()
    if biases_alone:
        parameters = tuple(p for p in made.parameters if p.name.startswith("gyro.bias"))
        made = replace(made, parameters=parameters, covariance=None)
    svg = before_and_after("p", made)
    frames = re.findall(r'<clipPath id="([^"]*)">\s*<rect x="[^"]*" y="([^"]*)" width="[^"]*" height="([^"]*)"', svg)
    count = 0
    for name, top, height in frames:
        for group in re.findall(rf'<g clip-path="url\(#{name}\)">(.*?)</g>', svg, re.DOTALL):
            dots = [float(y) for y in re.findall(r'<use [^>]*y="([0-9.]*)"', group)]
            count += len(dots)
            assert all(float(top) + 2.0 <= y <= float(top) + float(height) - 2.0 for y in dots)
    assert count == 2 * len(made.parameters)


def result_alone(content: Any) -> None:
    content |= {"rests": [], "turns": [], "iterations": [], "covariance": None}


def test_several_files_of_a_device_are_reported_one_after_the_other(
    file: Path, other_method: Path, tmp_path: Path
) -> None:
    for name, path in (("one", file), ("other", other_method)):
        (tmp_path / name).mkdir()
        changed(json.loads(path.read_text(encoding="utf-8")), tmp_path / name, result_alone)
    out = tmp_path / "report.html"
    assert write_report([tmp_path / "one/changed.json", tmp_path / "other/changed.json"], out) == []
    page = Page.of(out)
    tables = page.all_tables("parameter", "value", "U (95 %)", "unit")
    for rows, path in zip(tables, (file, other_method), strict=True):
        one = read_calibration(path)
        assert len(rows) == len(one.parameters) == 21
        for row in rows:
            p, size = one[row["parameter"]], SIZES[row["unit"]]
            assert number(row["value"]) == pytest.approx(p.value / size, abs=0.5001 * last_digit(row["value"]))
    assert page.headings.count("1 Result") == 2
    named = [attributes["id"] for _, attributes in page.elements if "id" in attributes]
    assert len(named) == len(set(named))


def test_devices_are_not_mixed(file: Path, content: Any, tmp_path: Path) -> None:
    other = changed(content, tmp_path, lambda c: c["device"].update(serial="B"))
    result = command(file, other, "-o", tmp_path / "report.html")
    assert result.exit_code == 2
    assert result.stderr.count("\n") == 1
    assert "expected a calibration of device 'tactical-3' like joint.json, found 'B'" in result.stderr
    assert not (tmp_path / "report.html").exists()


# -------------------- the command --------------------


def test_a_report_of_what_is_not_accepted_is_written_and_says_so(tmp_path: Path) -> None:
    path = changed(CONTRACT, tmp_path, lambda c: c["outcome"].update(accepted=False, reasons=["rest 3 does not fit"]))
    result = command(path, "-o", tmp_path / "report.html")
    assert result.exit_code == 1
    assert result.stdout == ""
    assert "not accepted: changed.json: rest 3 does not fit" in result.stderr
    assert "rest 3 does not fit" in Page.of(tmp_path / "report.html").whole


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["{file}", "-o", "report.txt"], "report.txt: expected a file that ends in .html, found '.txt'"),
        (["{file}", "-o", "report.pdf"], "found '.pdf'; print the page for a PDF"),
        (["{file}", "-o", "report"], "found 'no ending'"),
        (["none.json", "-o", "report.html"], "none.json: cannot be read: No such file or directory"),
        (["{file}", "-o", "no/report.html"], "report.html: cannot be written: the folder no does not exist"),
        (["{file}", "-o", "r.html", "--limits", "a.toml", "--certificate", "b.toml"], "--limits: expected none with"),
        (["{file}"], "Missing option '-o'"),
    ],
)
def test_what_cannot_be_used_is_said_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str], said: str
) -> None:
    (tmp_path / "empty").mkdir()
    monkeypatch.chdir(tmp_path / "empty")
    file = changed(CONTRACT, tmp_path, as_it_is)
    result = command(*(argument.format(file=file) for argument in arguments))
    assert result.exit_code == 2
    assert result.stdout == ""
    assert result.stderr.startswith("tumble: ")
    assert said in result.stderr
    assert result.stderr.count("\n") == 1
    assert list((tmp_path / "empty").iterdir()) == []


def test_without_the_extra_one_line_says_what_to_install(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in [n for n in sys.modules if n.startswith("tumble.views.") and n != "tumble.views.report.document"]:
        monkeypatch.delitem(sys.modules, name)
    for name in [n for n in sys.modules if n.split(".")[0] == "matplotlib"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(
        MissingExtraError,
        match=r"^a figure needs matplotlib; .*pip install 'tumble\[lab\]', .*pip install '\.\[lab\]'$",
    ):
        write_report([file], tmp_path / "report.html")


# -------------------- in a browser --------------------


@pytest.fixture
def browser(tmp_path: Path) -> Iterator[Browser]:
    if chromium() is None:
        missing = "no chromium: install Debian's package chromium to open reports in a browser"
        if os.environ.get("CI") == "true":
            pytest.fail(missing)
        pytest.skip(missing)
    opened = Browser(tmp_path)
    yield opened
    opened.close()


def test_a_browser_finds_no_error_and_nothing_to_load(
    browser: Browser, html: Path, hostile_html: Path, tmp_path: Path
) -> None:
    """On the report, on one of hostile texts, at the width of a desk and of a phone; and a page that does load and err
    is seen to."""

    def visited(page: Path, width: int) -> tuple[list[str], list[str]]:
        browser.console.clear()
        browser.requests.clear()
        browser.size(width, 1200)
        browser.open(page.as_uri())
        eventually(lambda: browser.js("document.readyState") == "complete" and page.name in browser.js("location.href"))
        return browser.console, browser.requests

    probe = tmp_path / "probe.html"
    probe.write_text("<img src='http://127.0.0.1:9/a.png'><script>nothing()</script>", encoding="utf-8")
    console, requests = visited(probe, 800)
    assert any("nothing is not defined" in line for line in console)
    assert requests == [probe.as_uri(), "http://127.0.0.1:9/a.png"]
    for page, width in ((html, 1100), (html, 390), (hostile_html, 1000)):
        assert visited(page, width) == ([], [page.as_uri()])
    assert browser.js("document.documentElement.scrollWidth <= innerWidth")


def test_a_block_of_six_is_applied_by_the_pseudo_inverse_and_has_its_own_frame() -> None:
    made = exact(accel=HEXAD, with_gyro=False)
    document_of = report_of([ReportedFile(file="c.json", sha256="0" * 64, calibration=made)])
    said = repr(document_of)
    assert "Formula(name='apply_redundant'" in said
    assert "Formula(name='axes'" not in said
    assert "Formula(name='apply'," not in said
    assert "Accelerometer 0 is along its nominal axis" in said
    assert "true = <b>matrix</b><sup>+</sup>" in to_page(document_of)
    assert to_pdf(document_of).startswith(b"%PDF")
