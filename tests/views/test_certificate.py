"""Certificates as documents, the dates of recordings, and the picture of a recording."""

from __future__ import annotations

import base64
import math
import os
import re
from collections.abc import Mapping
from dataclasses import replace
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
from click.testing import CliRunner

from tests.support.calibrated import calibration, of_device, warmed, with_fields
from tests.support.pages import Page, opened, pdf_text
from tumble.advice import Advised
from tumble.cli import main
from tumble.errors import InputError
from tumble.export import export_calibration
from tumble.inference.estimate import Outcome
from tumble.lab.certificate import Party, read_certificate
from tumble.lab.conformity import judge_calibration
from tumble.lab.limits import parse_limits
from tumble.lab.report import letterhead, write_certificate
from tumble.planning.setup import Setup
from tumble.recording.session import AirConditions, Circumstances, Site
from tumble.recording.session_file import session_of
from tumble.result.calibration import read_calibration
from tumble.result.coverage import expanded, expanded_of
from tumble.result.further import linear_errors_text
from tumble.result.parts import Launch, Parameter
from tumble.result.uncertainty_budget import shares_of_priors
from tumble.run.calibrate import calibrate
from tumble.run.observed import inspect_session
from tumble.simulation.session import simulate_session
from tumble.views.report.document import write_report

LOGO = '<svg xmlns="http://www.w3.org/2000/svg" width="9" height="9"><rect width="9" height="9"/></svg>'
LABORATORY = """
[laboratory]
name = "Inertial laboratory"
code = "D-K-00000"
city = "Braunschweig"
country = "DE"
logo = "logo.svg"

[[person]]
name = "N. N."
role = "head of the laboratory"
"""
CERTIFICATE = """
number = "2026-0042"
country = "DE"
laboratory = "lab/laboratory.toml"
received = 2025-03-01
issued = 2025-03-07
state = "as-left"
as_found = "before.json"
procedure = "IMU-7"
limits = "limits.toml"
agreed = "order 4711"
traceability = ["gravity: point 1234"]

[customer]
name = "A customer"
city = "Perm"
country = "RU"
"""
RECORDED = Circumstances(
    date="2025-03-04T09:30:00",
    operator="O. O.",
    conditions=AirConditions(temperature_degC=22.5, temperature_u=0.5, humidity_percent=40.0, pressure_hPa=1008.0),
    equipment=("turntable T-12, no. 7",),
)


def files(folder: Path, *, at: float = 0.5, certificate: str = CERTIFICATE) -> Path:
    """A calibration with a limit that is `at` times U above its first value, and what its certificate is made of."""
    made = with_fields(calibration(), circumstances=RECORDED)
    made.write(folder / "c.json")
    first = made.parameters[0]
    before = with_fields(
        made,
        parameters=(replace(first, value=first.value + 0.01), *made.parameters[1:]),
        circumstances=replace(RECORDED, date="2025-03-02"),
        log_sha256="b" * 64,
    )
    before.write(folder / "before.json")
    U = expanded(first)
    assert U is not None
    limit = f'"{first.name}" = {{ max = "{first.value + at * U!r} m/s^2" }}'
    (folder / "limits.toml").write_text(f"format = 1\n[periodic]\n{limit}\n", "utf-8")
    (folder / "lab").mkdir()
    (folder / "lab" / "laboratory.toml").write_text(LABORATORY, "utf-8")
    (folder / "lab" / "logo.svg").write_text(LOGO, "utf-8")
    (folder / "certificate.toml").write_text(certificate, "utf-8")
    return folder / "c.json"


def certificate(folder: Path, ending: str, **how: Any) -> Path:
    out = folder / f"c.{ending}"
    write_certificate(files(folder, **how), out, folder / "certificate.toml")
    return out


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the certificate as HTML and as PDF."""
    folder = tmp_path_factory.mktemp("certificate")
    file = files(folder)
    for ending in ("html", "pdf"):
        write_certificate(file, folder / f"c.{ending}", folder / "certificate.toml")
    return folder


@pytest.mark.parametrize("ending", ["html", "pdf"])
def test_a_certificate_says_what_it_is_asked_for(made: Path, ending: str) -> None:
    out = made / f"c.{ending}"
    said = Page.of(out).whole if ending == "html" else pdf_text(out)
    for wanted in (
        "Calibration certificate",
        "Inertial laboratory",
        "accreditation D-K-00000",
        "A customer, Perm, RU",
        "2026-0042",
        "2025-03-04",
        "2025-03-01",
        "as left: calibrated after adjustment",
        "22.5 °C, U = 1 °C (k = 2)",
        "40 %",
        "1008 hPa",
        "O. O.",
        "turntable T-12, no. 7",
        "Traceability: gravity: point 1234.",
        "Agreed beforehand: order 4711.",
        "ILAC-G8:09/2019",
        "conditional pass",
        "JCGM 106:2012, 9.3.2",
        "Risk of the verdict “conditional pass” as a whole: at most 16 %.",
        "relates only to the item",
        "head of the laboratory",
        "End of the certificate 2026-0042",
    ):
        assert wanted in said, wanted


def test_it_names_what_priors_rest_on_with_its_share_of_the_variance(tmp_path: Path) -> None:
    session = simulate_session(tmp_path / "s", Setup.of(grade="mems", positions=12), seed=1)
    made = calibrate(session)
    files(tmp_path)
    plain = CERTIFICATE.replace('limits = "limits.toml"\n', "").replace('as_found = "before.json"\n', "")
    days = "begin = 2025-03-02\nend = 2025-03-03\n"
    (tmp_path / "certificate.toml").write_text(days + plain.replace("as-left", "unchanged"), "utf-8")
    made.write(tmp_path / "c.json", force=True)
    write_certificate(tmp_path / "c.json", tmp_path / "c.html", tmp_path / "certificate.toml")
    shares = shares_of_priors(made)["guessed grade mems"]
    said = Page.of(tmp_path / "c.html").whole
    assert "not from this recording but from the usual sizes of instruments of the kind (means over the" in said
    assert "by the guessed grade mems: " in said
    assert f"{100.0 * shares['accel.scale']:.0f} % of accel.scale" in said


def test_the_number_is_on_every_page_and_the_first_one_is_the_customers(made: Path) -> None:
    with opened(made / "c.pdf") as document:
        pages = [" ".join(page.get_text().split()) for page in document]
    assert len(pages) > 1
    for i, text in enumerate(pages, 1):
        assert "Calibration certificate 2026-0042" in text
        assert f"page {i} of {len(pages)}" in text
    assert "N. N. head of the laboratory" in pages[0]
    assert pages[1].startswith("Annexes")
    assert sum("End of the certificate" in text for text in pages) == 1
    assert "End of the certificate" in pages[-1]


def test_html_and_pdf_say_the_same(made: Path) -> None:
    said, page = pdf_text(made / "c.pdf"), Page.of(made / "c.html")
    cells = {" ".join(cell.split()) for table in page.tables for row in table for cell in row if cell}
    assert len(cells) > 150
    assert [cell for cell in cells if cell not in said] == []
    for heading in page.headings:
        assert heading.partition(" ")[2] in said


def test_the_pdf_is_for_the_archive(made: Path) -> None:
    """A4, PDF/A-2b by its own account, all fonts embedded, no link, script or attachment, the calibration's date."""
    calibration = read_calibration(made / "c.json")
    with opened(made / "c.pdf") as document:
        metadata = document.get_xml_metadata()
        assert "<pdfaid:part>2</pdfaid:part>" in metadata
        assert "<pdfaid:conformance>B</pdfaid:conformance>" in metadata
        assert document.embfile_count() == 0
        assert calibration.serial in document.metadata["title"]
        created = re.sub(r"\D", "", (calibration.provenance.created or "").split("+")[0])
        assert created in re.sub(r"\D", "", document.metadata["creationDate"])
        fonts = set()
        for sheet in document:
            assert [round(side / 72.0 * 25.4) for side in sheet.rect[2:]] == [210, 297]
            assert not [link for link in sheet.get_links() if "uri" in link or "file" in link]
            fonts |= {font[0] for font in sheet.get_fonts()}
        assert fonts
        assert all(document.extract_font(font)[3] for font in fonts)
    assert b"/JavaScript" not in (made / "c.pdf").read_bytes()


def test_the_values_as_found_stand_beside_those_as_left(made: Path) -> None:
    page = Page.of(made / "c.html")
    rows = page.table("parameter", "value", "as found", "k", "ν")
    left, found = (float(rows[0][column].replace("−", "-")) for column in ("value", "as found"))
    assert found - left == pytest.approx(0.01 / 9.80665e-3, rel=0.01)  # mg
    assert rows[1]["as found"] == rows[1]["value"]
    assert rows[1]["U as found"] == rows[1]["U (95 %)"]
    assert "As found: recorded 2025-03-02, method scalar; accepted, periodic check: fail: " in page.whole
    assert (rows[0]["k"], rows[0]["ν"]) == ("2.00", "∞")
    (judged,) = page.table("parameter", "low", "value", "high", "verdict")
    assert (judged["parameter"], judged["verdict"]) == (rows[0]["parameter"], "conditional pass")


@pytest.mark.parametrize(
    ("at", "outcome", "tone"),
    [
        (0.5, "conditional pass", "doubt"),
        (-0.5, "conditional fail", "bad"),
    ],
)
def test_the_badge_is_one_of_the_four_outcomes(tmp_path: Path, at: float, outcome: str, tone: str) -> None:
    text = certificate(tmp_path, "html", at=at).read_text("utf-8")
    assert re.findall(r'<p class="verdict (\w+)">([^<]+)</p>', text) == [(tone, outcome)]


def test_the_logo_is_in_the_page_and_the_page_loads_nothing(made: Path) -> None:
    page = Page.of(made / "c.html")
    (source,) = [attributes["src"] for tag, attributes in page.elements if tag == "img"]
    assert source == "data:image/svg+xml;base64," + base64.b64encode(LOGO.encode()).decode()


def test_a_number_cannot_leave_its_place_in_the_style_of_the_page(tmp_path: Path) -> None:
    acting = CERTIFICATE.replace("2026-0042", "2026 }</style><script>alert(1)</script>")
    page = Page.of(certificate(tmp_path, "html", certificate=acting))
    assert not [tag for tag, _ in page.elements if tag == "script"]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (("lab/laboratory.toml", "lab/none.toml"), "none.toml: cannot be read: No such file"),
        (('number = "2026-0042"', ""), "number: expected this key, found none; see docs/howto/reports.md"),
        (('number = "', 'number = "\\u0000'), "number: expected no control characters, found '\\x00"),
        (('city = "', 'city = "\\u0000'), "city: expected no control characters, found '\\x00"),
        (('"limits.toml"', '"none.toml"'), "none.toml: cannot be read"),
        (('"before.json"', '"none.json"'), "none.json: cannot be read"),
        (
            ("received = 2025-03-01", "received = 2025-03-05"),
            "begin: expected a day not before received, 2025-03-05, f",
        ),
        (("issued = 2025-03-07", "issued = 2025-03-03"), "issued: expected a day not before end, 2025-03-04, found"),
        (("issued = 2025-03-07", "issued = 2999-03-07"), "issued: expected a day that is not in the future, found"),
        (('state = "as', 'begin = 2025-03-05\nstate = "as'), "end: expected a day not before begin, 2025-03-05, found"),
        (
            ('state = "as', 'begin = 2025-03-05\nend = 2025-03-06\nstate = "as'),
            "begin, end: expected days that hold every recording, found 2025-03-05 to 2025-03-06 and a record",
        ),
        (('procedure = "IMU-7"\n', ""), "procedure: expected this key under an accreditation number (laboratory.code)"),
        (('traceability = ["gravity: point 1234"]\n', ""), "found none of traceability"),
        (("issued = 2025-03-07\n", ""), "found none of issued"),
        (('agreed = "order 4711"\n', ""), "found none of agreed"),
        (
            ("before.json", "c.json"),
            "as_found: expected a calibration from before the adjustment, found one of the same",
        ),
        (
            ('state = "as', 'replaces = "2026-0042"\nstate = "as'),
            "replaces: expected the number of another certificate",
        ),
        (('state = "as', 'check = "incoming"\nstate = "as'), "check: expected 'periodic', whose limits"),
    ],
)
def test_what_a_certificate_lacks_is_said_in_one_line(tmp_path: Path, change: tuple[str, str], said: str) -> None:
    with pytest.raises(InputError, match=re.escape(said)) as refused:
        certificate(tmp_path, "html", certificate=CERTIFICATE.replace(*change))
    assert "\n" not in str(refused.value)


def test_nothing_is_written_of_a_certificate_that_does_not_hold(tmp_path: Path) -> None:
    faulty = CERTIFICATE.replace("issued = 2025-03-07", "issued = 2025-03-03")
    with pytest.raises(InputError, match="issued: expected a day not before end"):
        certificate(tmp_path, "pdf", certificate=faulty)
    assert not (tmp_path / "c.pdf").exists()
    with pytest.raises(InputError, match="issued: expected a day not before end"):
        export_calibration(
            read_calibration(tmp_path / "c.json"), "dcc", certificate=read_certificate(tmp_path / "certificate.toml")
        )


def test_an_adjustment_lies_between_as_found_and_as_left(tmp_path: Path) -> None:
    path = files(tmp_path)
    later = with_fields(read_calibration(tmp_path / "before.json"), circumstances=Circumstances(date="2025-03-06"))
    later.write(tmp_path / "before.json", force=True)
    with pytest.raises(InputError, match="as_found: expected a recording from before that of the result"):
        write_certificate(path, tmp_path / "r.html", tmp_path / "certificate.toml")


def test_a_statement_of_conformity_is_about_one_check(tmp_path: Path) -> None:
    path = files(tmp_path)
    limits = (tmp_path / "limits.toml").read_text("utf-8")
    (tmp_path / "limits.toml").write_text(limits + '[incoming]\n"accel.bias" = "9 g"\n', "utf-8")
    with pytest.raises(InputError, match=r"check: expected 'incoming' or 'periodic', for .* has limits of both"):
        write_certificate(path, tmp_path / "r.html", tmp_path / "certificate.toml")
    (tmp_path / "certificate.toml").write_text(CERTIFICATE.replace("agreed", 'check = "incoming"\nagreed'), "utf-8")
    assert write_certificate(path, tmp_path / "r.html", tmp_path / "certificate.toml") == []
    page = Page.of(tmp_path / "r.html")
    rows = page.table("parameter", "low", "high", "verdict")
    assert (rows[0]["low"], rows[0]["high"], rows[0]["verdict"]) == ("−9000", "9000", "pass")
    assert "periodic" not in page.whole


def test_every_recording_is_dated_on_the_first_page(tmp_path: Path) -> None:
    path = files(tmp_path, certificate=CERTIFICATE.replace("issued = 2025-03-07", "issued = 2025-03-09"))
    made = read_calibration(path)
    launches = tuple(
        Launch(
            session=f"run-{day}",
            parameters=made.parameters,
            covariance=made.covariance,
            log_sha256=str(day) * 64,
            circumstances=replace(RECORDED, date=f"2025-03-0{day}T09:30:00"),
        )
        for day in (3, 4, 5)
    )
    with_fields(made, launches=launches, circumstances=replace(RECORDED, date="2025-03-05T09:30:00")).write(
        path, force=True
    )
    write_certificate(path, tmp_path / "r.html", tmp_path / "certificate.toml")
    said = Page.of(tmp_path / "r.html").whole
    assert "recorded2025-03-03 09:30:00, 2025-03-04 09:30:00, 2025-03-05 09:30:00" in said
    assert "calibrated2025-03-03 to 2025-03-05" in said
    assert "It is of the mean of 3 power-ons; a single later one lies about the mean" in said


REMARKS = (
    Advised(
        "residuals larger than the noise; probable cause: the switch on was earlier",
        "state gyro_cubic in [device.prior]",
    ),
)


def test_a_customer_reads_no_opinions_and_no_advice_and_signs_beside_the_result(tmp_path: Path) -> None:
    many = ", ".join(f'"remark {i}: {"words " * 20}"'.replace(' "', '"') for i in range(9))
    text = CERTIFICATE.replace("[customer]", f"remarks = [{many}]\n[customer]", 1)
    path = files(tmp_path, certificate=text)
    made = read_calibration(path)
    outcome = Outcome(remarks=REMARKS, concerns=dict.fromkeys(REMARKS, ("gyro",)))
    notes = (
        Advised("all turns have about 50 °/s: scale factors hold at this rate", "state gyro_cubic in [device.prior]"),
        Advised("the field is not the same in all of them; look at it", "record away from steel, with motors off"),
        Advised("curvatures have their usual sizes; u includes this", "warm or cool the device as it is used"),
    )
    with_fields(made, outcome=outcome, notes=notes).write(path, force=True)
    for ending in ("html", "pdf"):
        write_certificate(path, tmp_path / f"r.{ending}", tmp_path / "certificate.toml")
    page = Page.of(tmp_path / "r.html").whole
    assert "probable cause" not in page
    assert "Residuals larger than the noise; what would explain the residuals: the switch on was earlier" in page
    assert "device.prior" not in page
    assert "Accepted with scatter" in page
    assert "scale factors hold at this rate" in page
    assert "curvatures have their usual sizes; u includes this" in page.replace("Curvatures", "curvatures")
    assert "look at it" in page  # no list of verbs tells what is advice
    assert "steel" not in page
    with opened(tmp_path / "r.pdf") as document:
        pages = [" ".join(each.get_text().split()) for each in document]
    assert "head of the laboratory" in pages[0]
    assert pages[1].startswith("Annexes")
    write_report(path, tmp_path / "laboratory.html")  # a report for those who run the program has all of it
    assert "probable cause" in Page.of(tmp_path / "laboratory.html").whole


JUMP = Advised(
    "probable cause: biases of the gyros jump by 30°/h after rest 8 (291.2–309.2 s), as of a driver that measures them "
    "anew or of another device",
    "calibrate what is before and what is after as launches, each with the times of the other in [[exclude]]",
)


def test_a_device_that_changed_while_it_was_recorded_needs_a_statement_and_is_not_judged(tmp_path: Path) -> None:
    path = files(tmp_path, certificate=CERTIFICATE.replace('state = "as-left"\nas_found = "before.json"\n', ""))
    outcome = Outcome(remarks=(JUMP,), concerns={JUMP: ("gyro",)}, unsteady=(JUMP,))
    with_fields(read_calibration(path), outcome=outcome).write(path, force=True)
    (tmp_path / "limits.toml").write_text('format = 1\n[periodic]\n"gyro.bias" = "90 deg/h"\n', "utf-8")
    stated = tmp_path / "certificate.toml"
    for write in (
        lambda: write_certificate(path, tmp_path / "r.html", stated),
        lambda: export_calibration(path, "dcc", certificate=stated),
    ):
        with pytest.raises(InputError, match=r"changed: expected a statement .* biases of the gyros jump by 30°/h"):
            write()
    stated.write_text(stated.read_text("utf-8").replace("[customer]", 'changed = "The Y gyro jumped."\n[customer]', 1))
    reasons = write_certificate(path, tmp_path / "r.html", stated)
    assert [reason.partition(": ")[2] for reason in reasons] == [
        "periodic check: changed while it was recorded: gyro.bias.x, gyro.bias.y, gyro.bias.z"
    ]
    seen = "jump by 30°/h after rest 8 (291.2–309.2 s), as of a driver that measures them anew or of another device"
    dcc = export_calibration(path, "dcc", certificate=stated).content.decode()
    for text in (Page.of(tmp_path / "r.html").whole, dcc):
        assert seen in text
        assert "The Y gyro jumped." in text
        assert "exclude" not in text


def test_scale_factors_in_gravity_at_the_place_are_not_certified(tmp_path: Path) -> None:
    path = files(tmp_path)
    made = read_calibration(path)
    site = Site(latitude=None, height=0.0, gravity=9.80665, gravity_u=0.0, gravity_is_unit=True)
    with_fields(made, site=site).write(path, force=True)
    with pytest.raises(InputError, match="expected scale factors in SI, found gravity at the place"):
        write_certificate(path, tmp_path / "r.html", tmp_path / "certificate.toml")
    limits = parse_limits('format = 1\n[periodic]\n"accel.scale" = "5000 ppm"\n', "limits")
    (verdict,) = judge_calibration(read_calibration(path), limits)
    assert [j.expanded for j in verdict.judgements] == pytest.approx([2.0 * 0.03 / 9.80665] * 3, rel=0.1)
    few = tuple(replace(p, u=0.02, dof=2.0) if p.name.startswith("accel.scale") else p for p in made.parameters)
    (verdict,) = judge_calibration(replace(read_calibration(path), parameters=few), limits)
    assert [j.expanded for j in verdict.judgements] == pytest.approx(
        [expanded_of(math.hypot(0.02, 0.03 / 9.80665), 2.1)] * 3, rel=0.05
    )


@pytest.fixture(scope="module")
def real(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The certificate, as HTML and PDF, of a simulated MEMS device with all groups of parameters."""
    folder = tmp_path_factory.mktemp("real")
    session = simulate_session(folder / "session", Setup.of(grade="mems", positions=14), seed=3)
    files(folder, certificate=CERTIFICATE.replace('state = "as-left"\nas_found = "before.json"\n', ""))
    with_fields(calibrate(session), circumstances=RECORDED).write(folder / "real.json")
    for ending in ("html", "pdf"):
        write_certificate(folder / "real.json", folder / f"c.{ending}", folder / "certificate.toml")
    return folder


def test_a_certificate_of_all_groups_has_eight_pages_at_most_and_no_large_file(real: Path) -> None:
    with opened(real / "c.pdf") as document:
        pages = [" ".join(page.get_text().split()) for page in document]
    assert len(pages) <= 8
    for wanted in ("Known to", "matrix⁻¹ · (reading − bias)", "K₂ (a·f)²", "accel.lever", "head of the laboratory"):
        assert wanted in pages[0]  # formula and residual terms where it is said what readings are known to
    assert all(len(text) > 300 for text in pages)  # no line that has spilt over
    assert (real / "c.html").stat().st_size < 300_000
    assert (real / "c.pdf").stat().st_size < 300_000


def test_the_whole_correction_is_printed_and_its_test_vector_follows_from_what_is_printed(real: Path) -> None:
    """The reading by the printed formula at the printed true values, written out here, is the printed reading."""
    page = Page.of(real / "c.html")
    table = page.table("parameter", "value, SI", "SI unit")
    value = {row["parameter"]: printed(row["value, SI"]) for row in table}
    matrices = [np.array(matrix) for matrix in page.matrices()]
    (A, a0), (G, g0) = matrices[:2], matrices[5:7]
    reading, f, turning, w = (matrix[:, 0] for matrix in matrices[10:])
    accel, gyro = A @ f + a0[:, 0], G @ w + g0[:, 0]
    for i, axis in enumerate("xyz"):
        accel[i] += value[f"accel.quadratic.{axis}"] * f[i] ** 2 + value[f"accel.cubic.{axis}"] * f[i] ** 3
        accel[i] += value[f"accel.asymmetry.{axis}"] * abs(f[i])
        gyro[i] += value[f"gyro.asymmetry.{axis}"] * abs(w[i])
        gyro[i] += sum(value[f"gyro.g_sensitivity.{axis}{by}"] * f[j] for j, by in enumerate("xyz"))
    np.testing.assert_allclose(accel, reading, rtol=0.0, atol=2e-8)
    np.testing.assert_allclose(gyro, turning, rtol=0.0, atol=2e-8)
    assert not np.allclose(A @ f + a0[:, 0], reading, rtol=0.0, atol=1e-5)
    left = linear_errors_text(read_calibration(real / "real.json"))
    assert left
    assert left in page.whole


def printed(text: str) -> float:
    """A number with a power of ten as a report writes it."""
    mantissa, _, power = text.replace("−", "-").partition("·10")
    return float(mantissa) * 10.0 ** int(power.translate(str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")) or "0")


def test_the_correction_over_temperature_follows_from_what_is_printed(tmp_path: Path) -> None:
    """The reading 10 K above the reference, by the printed matrix, bias and coefficients at the printed true values."""
    files(tmp_path, certificate=CERTIFICATE.replace('state = "as-left"\nas_found = "before.json"\n', ""))
    with_fields(warmed(calibration()), circumstances=RECORDED).write(tmp_path / "warm.json")
    write_certificate(tmp_path / "warm.json", tmp_path / "c.html", tmp_path / "certificate.toml")
    page = Page.of(tmp_path / "c.html")
    assert "with matrix and bias alone: exact at the reference temperature" in page.whole
    assert "of its sensor: ." not in page.whole
    value = {row["parameter"]: printed(row["value, SI"]) for row in page.table("parameter", "value, SI", "SI unit")}
    matrices = [np.array(matrix) for matrix in page.matrices()]
    for kind, (M, b), (reading, true) in (
        ("accel", matrices[:2], matrices[10:12]),
        ("gyro", matrices[5:7], matrices[12:14]),
    ):
        bias, scale = (
            np.array([10.0 * value[f"{kind}.{what}.{i}.t1"] + 100.0 * value[f"{kind}.{what}.{i}.t2"] for i in "xyz"])
            for what in ("bias", "scale")
        )
        longer = 1.0 + scale / np.linalg.norm(M, axis=1)
        np.testing.assert_allclose((M @ true[:, 0]) * longer + b[:, 0] + bias, reading[:, 0], rtol=0.0, atol=2e-8)


def test_what_matrix_and_bias_leave_is_the_size_of_what_they_have_not() -> None:
    """One K₂ alone: K₂ f² of a reading at 1 g, in every axis."""
    made = calibration()
    more = Parameter(name="accel.quadratic.x", value=50e-6 / 9.80665, u=1e-7, unit="s^2/m")
    bent = replace(made, parameters=(*made.parameters, more), covariance=None)
    left = linear_errors_text(bent)
    largest = re.fullmatch(r"with matrix and bias alone: off by up to ([0-9.]+) µg \(rms [0-9.]+ µg\) at 1 g", left)
    assert largest is not None  # and nothing of a rate
    assert float(largest[1]) == pytest.approx(50.0, rel=0.02)
    assert linear_errors_text(made) == ""


def test_a_logo_that_is_none_and_another_device_as_found_are_refused(tmp_path: Path) -> None:
    path = files(tmp_path)
    (tmp_path / "lab" / "logo.svg").write_text("no picture", "utf-8")
    with pytest.raises(InputError, match=r"logo\.svg: expected a picture in SVG, found another file"):
        write_certificate(path, tmp_path / "r.html", tmp_path / "certificate.toml")
    (tmp_path / "lab" / "logo.svg").write_text(LOGO, "utf-8")
    of_device(read_calibration(path), serial="B").write(tmp_path / "before.json", force=True)
    with pytest.raises(InputError, match="as_found: expected a calibration of device 'A-0007' in the frame"):
        write_certificate(path, tmp_path / "r.html", tmp_path / "certificate.toml")


def test_a_certificate_is_of_one_calibration_with_a_date(tmp_path: Path) -> None:
    path = files(tmp_path)
    with pytest.raises(InputError, match="certificate: expected one calibration, found 2"):
        write_certificate([path, tmp_path / "before.json"], tmp_path / "r.html", tmp_path / "certificate.toml")
    with_fields(read_calibration(path), circumstances=Circumstances()).write(tmp_path / "undated.json")
    with pytest.raises(InputError, match="expected the day of the calibration, found none"):
        write_certificate(tmp_path / "undated.json", tmp_path / "r.html", tmp_path / "certificate.toml")


# -------------------- dates --------------------


def described(times: Any, **log: Any) -> Circumstances:
    data = {"t": times, "ax": np.zeros(300), "ay": np.zeros(300), "az": np.full(300, 9.81)}
    accel = {"columns": ["ax", "ay", "az"], "unit": "m/s^2"}
    content: Mapping[str, Any] = {"format": 1, "device": {"serial": "A"}, "log": {"time": "t", "accel": accel, **log}}
    return inspect_session(session_of(content, data)).circumstances


def test_the_date_is_that_of_the_log_where_its_times_are_absolute() -> None:
    steps = np.arange(300) / 100.0
    assert described(steps).date is None
    assert described(1_750_000_000.0 + steps).date == "2025-06-15T15:06:40+00:00"
    assert described(1e9 * (1_750_000_000.0 + steps), time_unit="ns").date == "2025-06-15T15:06:40+00:00"
    begin = datetime(2024, 2, 29, 8)
    moments = pl.Series("t", [begin + timedelta(seconds=step) for step in steps.tolist()])
    assert described(moments, time_unit="iso8601").date == "2024-02-29T08:00:00"


# -------------------- the picture of a recording --------------------


def test_inspect_draws_the_recording(tmp_path: Path) -> None:
    simulate_session(tmp_path / "s", Setup.of(grade="mems", positions=3, rest=3.0), seed=1)
    run = CliRunner().invoke(main, ["inspect", str(tmp_path / "s"), "--plot", str(tmp_path / "r.svg")])
    assert run.exit_code == 0, run.output
    first = (tmp_path / "r.svg").read_bytes()
    assert first.startswith(b"<?xml")
    assert f"written to {tmp_path / 'r.svg'}" in run.stderr
    CliRunner().invoke(main, ["inspect", str(tmp_path / "s"), "--plot", str(tmp_path / "r.svg")])
    assert (tmp_path / "r.svg").read_bytes() == first
    refused = CliRunner().invoke(main, ["inspect", str(tmp_path / "s"), "--plot", str(tmp_path / "r.txt")])
    assert refused.exit_code == 2
    assert "expected a file that ends in .svg, .png or .pdf, found '.txt'" in refused.stderr


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no pipes with names")
def test_a_logo_that_is_no_file_is_refused(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "logo.png")
    with pytest.raises(InputError, match="expected a file, found a device or a pipe"):
        letterhead(Party(name="L", city="B", country="DE", logo=str(tmp_path / "logo.png")))
