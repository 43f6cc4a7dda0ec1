"""Certificates as documents, the dates of recordings, and the picture of a recording."""

from __future__ import annotations

import base64
import re
from collections.abc import Mapping
from dataclasses import replace
from datetime import date, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
from calibrated import calibration
from click.testing import CliRunner
from test_report import Page, opened, pdf_text

from tumble.calibration.calibration_file import read_calibration
from tumble.calibration.coverage import expanded
from tumble.calibration.observed import inspect_session
from tumble.cli import main
from tumble.errors import InputError
from tumble.planning.setup import Setup
from tumble.recording.circumstances import AirConditions, Circumstances
from tumble.recording.session_file import session_of
from tumble.registry.limits import judge_value
from tumble.registry.records import Particulars, read_submission
from tumble.report.write import write_report
from tumble.simulation.session import simulate_session

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
received = 2026-05-01
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
    air=AirConditions(temperature=22.5, temperature_u=0.5, humidity=40.0, pressure=1008.0),
    equipment=("turntable T-12, no. 7",),
)


def files(folder: Path, *, at: float = 0.5, certificate: str = CERTIFICATE) -> Path:
    """A calibration with a limit that is `at` times U above its first value, and what its certificate is made of."""
    made = replace(calibration(), circumstances=RECORDED)
    made.write(folder / "c.json")
    first = made.parameters[0]
    before = replace(made, parameters=(replace(first, value=first.value + 0.01), *made.parameters[1:]))
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
    write_report(files(folder, **how), out, certificate=folder / "certificate.toml")
    return out


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the certificate as HTML and as PDF."""
    folder = tmp_path_factory.mktemp("certificate")
    file = files(folder)
    for ending in ("html", "pdf"):
        write_report(file, folder / f"c.{ending}", certificate=folder / "certificate.toml")
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
        "2026-05-01",
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
        "relates only to the item",
        "head of the laboratory",
        "End of the certificate 2026-0042",
    ):
        assert wanted in said, wanted


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


def test_the_values_as_found_stand_beside_those_as_left(made: Path) -> None:
    page = Page.of(made / "c.html")
    rows = page.table("parameter", "value", "as found", "verdict")
    left, found = (float(rows[0][column].replace("−", "-")) for column in ("value", "as found"))
    assert found - left == pytest.approx(0.01 / 9.80665e-3, rel=0.01)  # mg
    assert rows[1]["as found"] == rows[1]["value"]
    assert (rows[0]["verdict"], rows[1]["verdict"]) == ("conditional pass", "—")


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


def test_outcomes_without_a_value_or_u_are_undecided() -> None:
    def judged(value: float, expanded: float | None, low: float = -1.0) -> str:
        u = None if expanded is None else 0.5 * expanded
        return judge_value(value, u, low, 1.0)

    assert [judged(v, 0.2) for v in (0.0, 0.9, 1.1, 1.3)] == ["pass", "conditional pass", "conditional fail", "fail"]
    assert [judged(0.0, None), judged(0.0, 0.2, np.nan)] == ["undecided"] * 2


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
        (("lab/laboratory.toml", "lab/none.toml"), "none.toml: expected a TOML file"),
        (('number = "2026-0042"', ""), "number: expected this key, found none; see docs/certificate.md"),
        (('"limits.toml"', '"none.toml"'), "none.toml: cannot be read"),
        (('"before.json"', '"none.json"'), "none.json: cannot be read"),
    ],
)
def test_what_a_certificate_lacks_is_said_in_one_line(tmp_path: Path, change: tuple[str, str], said: str) -> None:
    with pytest.raises(InputError, match=re.escape(said)) as refused:
        certificate(tmp_path, "html", certificate=CERTIFICATE.replace(*change))
    assert "\n" not in str(refused.value)


def test_a_logo_that_is_none_and_another_device_as_found_are_refused(tmp_path: Path) -> None:
    path = files(tmp_path)
    (tmp_path / "lab" / "logo.svg").write_text("no picture", "utf-8")
    with pytest.raises(InputError, match=r"logo\.svg: expected a picture in SVG, found another file"):
        write_report(path, tmp_path / "r.html", certificate=tmp_path / "certificate.toml")
    (tmp_path / "lab" / "logo.svg").write_text(LOGO, "utf-8")
    replace(read_calibration(path), serial="B").write(tmp_path / "before.json", force=True)
    with pytest.raises(InputError, match="as_found: expected a calibration of device 'A-0007' in the frame"):
        write_report(path, tmp_path / "r.html", certificate=tmp_path / "certificate.toml")


def test_a_certificate_is_of_one_calibration_with_a_date(tmp_path: Path) -> None:
    path = files(tmp_path)
    with pytest.raises(InputError, match="--certificate: expected one calibration, found 2"):
        write_report([path, tmp_path / "before.json"], tmp_path / "r.html", certificate=tmp_path / "certificate.toml")
    replace(read_calibration(path), circumstances=Circumstances()).write(tmp_path / "undated.json")
    with pytest.raises(InputError, match="expected the day of the calibration, found none"):
        write_report(tmp_path / "undated.json", tmp_path / "r.html", certificate=tmp_path / "certificate.toml")


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
    assert described(1e9 * (1_750_000_000.0 + steps), time_unit="ns").day == date(2025, 6, 15)
    begin = datetime(2024, 2, 29, 8)
    moments = pl.Series("t", [begin + timedelta(seconds=step) for step in steps.tolist()])
    assert described(moments, time_unit="iso8601").date == "2024-02-29T08:00:00"


def test_a_session_states_its_circumstances_and_the_file_keeps_them(tmp_path: Path) -> None:
    path = files(tmp_path)
    assert read_calibration(path).circumstances == RECORDED
    assert read_submission(path, Particulars()).performed.date() == date(2025, 3, 4)


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
