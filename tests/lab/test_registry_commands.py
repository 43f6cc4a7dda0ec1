"""`tumble registry` on the command line: what it prints, its exit statuses, one line for what cannot be used."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner, Result

from tests.support.registry_files import content, write
from tumble.cli import main
from tumble.sensors.parameters import group_of
from tumble.units import G_STANDARD

MG = 1e-3 * G_STANDARD
LIMITS = """
format = 1
interval_months = 12
[incoming]
"accel.bias" = "5 mg"
[periodic]
"accel.bias" = "4 mg"
"""


def run(*words: object) -> Result:
    """A command in this process; an exception is a traceback to the user."""
    result = CliRunner().invoke(main, ["registry", *map(str, words)], prog_name="tumble")
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise AssertionError(f"tumble registry {' '.join(map(str, words))}") from result.exception
    return result


def refused(*words: object) -> str:
    """The one line for which a command is refused."""
    result = run(*words)
    assert result.exit_code == 2, result.output
    assert result.stdout == ""
    assert re.fullmatch(r"tumble: [^\n]+\n", result.stderr), result.stderr
    return result.stderr.removeprefix("tumble: ").rstrip("\n")


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working folder with limits and calibrations of one device; its registry is named by the environment."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("TUMBLE_REGISTRY", "r.sqlite")
    (tmp_path / "limits.toml").write_text(LIMITS, encoding="utf-8")
    for name, bias in (("new", 1.0), ("old", 1.5), ("worn", 4.2), ("edge", 4.0)):
        write(tmp_path / f"{name}.json", content(log=name, values={"accel.bias.x": bias * MG}))
    return tmp_path


@pytest.fixture
def filled(folder: Path) -> Path:
    """With limits and two calibrations in the registry."""
    assert run("limits", "BCHE-501", "limits.toml").exit_code == 0
    assert run("add", "new.json", "--date", "2024-03-01").exit_code == 0
    assert run("add", "old.json", "--date", "2025-03-01", "--state", "as-found").exit_code == 0
    return folder


def test_nothing_is_said_to_be_added_to_a_registry_with_a_damaged_page(filled: Path) -> None:
    """A page at a time, those behind the last record as well."""
    sound, page = (filled / "r.sqlite").read_bytes(), 4096
    damaged = filled / "damaged.sqlite"
    statuses = set()
    for start in range(page, len(sound), page):
        for part in filled.glob("damaged.sqlite*"):
            part.unlink()
        damaged.write_bytes(sound[:start] + bytes(page) + sound[start + page :])
        result = run("add", "worn.json", "--registry", damaged)
        statuses.add(result.exit_code)
        assert result.exit_code != 2 or "added" not in result.stderr
    assert 2 in statuses


@pytest.mark.usefixtures("filled")
def test_a_calibration_is_judged_when_it_is_added() -> None:
    again = run("add", "new.json")
    assert again.exit_code == 0
    assert again.stderr == "the same calibration is there already: record 1 in r.sqlite\n"
    assert "verdict: pass" in again.stdout
    for name, number, said in (("worn", 3, "fail"), ("edge", 4, "conditional pass")):
        result = run("add", f"{name}.json", "--date", "2026-03-01")
        assert result.exit_code == 1
        assert f"added as record {number} in r.sqlite\nperiodic check: {said}: accel.bias.x\n" == result.stderr
        assert "decision rule: pass where the value is inside its limits by at least U (95.45 %)" in result.stdout
        assert run("show", number).exit_code == 1
    assert len(run("list", "A-0007").stdout.splitlines()) == 1 + 4


def test_the_calibration_file_comes_back_as_it_was(filled: Path) -> None:
    assert run("show", 1, "-o", "back.json").stderr == "written to back.json\n"
    assert (filled / "back.json").read_text() == (filled / "new.json").read_text()
    assert (
        refused("show", 1, "-o", "back.json")
        == "back.json: expected a new file for the calibration, found one that exists"
    )


@pytest.mark.usefixtures("filled")
def test_a_trend_has_a_line_for_each_parameter() -> None:
    result = run("trend", "A-0007")
    assert result.exit_code == 1  # the bias has changed by 1500 µg with U = 3 µg
    assert result.stderr == "changed: accel.bias.x\n"
    line = next(line for line in result.stdout.splitlines() if line.startswith("accel.bias.x"))
    assert line.split()[1:6] == ["▁█", "1500.0", "2.0", "-4000", "4000"]
    assert line.split()[-1] == "pass"


@pytest.mark.usefixtures("filled")
def test_what_is_due_depends_on_the_day() -> None:
    before, after = run("due", "--on", "2026-02-27"), run("due", "--on", "2026-03-02")
    assert (before.exit_code, after.exit_code) == (0, 1)
    assert "in 2 d" in before.stdout
    assert "overdue by 1 d" in after.stdout
    assert after.stderr == "overdue: A-0007\n"
    assert run("add", "worn.json", "--date", "2026-03-01").exit_code == 1
    withdrawn = run("due", "--on", "2026-03-02")
    assert (withdrawn.exit_code, withdrawn.stderr) == (1, "withdrawn: A-0007\n")
    assert "withdrawn until calibrated again: fail" in withdrawn.stdout


def test_limits_are_listed_and_shown(filled: Path) -> None:
    assert (
        run("limits", "BCHE-501", "limits.toml").stderr == "limits 1 were in force already for BCHE-501 in r.sqlite\n"
    )
    (filled / "limits.toml").write_text(LIMITS.replace("5 mg", "3 mg"), encoding="utf-8")
    assert run("limits", "BCHE-501", "limits.toml").stderr == "limits 2 in force for BCHE-501 in r.sqlite\n"
    assert [line.split()[-1] for line in run("limits").stdout.splitlines()[1:]] == ["replaced", "force"]
    assert '"accel.bias" = "3 mg"' in run("limits", "BCHE-501").stdout


def test_no_calibration_is_of_a_day_before_its_recording(folder: Path) -> None:
    write(folder / "dated.json", content(log="dated") | {"session": {"date": "2025-03-02T09:30:00+02:00"}})
    said = "expected 2025-03-02, the day of the recording, or later, found 2025-03-01"
    assert said in refused("add", "dated.json", "--date", "2025-03-01")
    assert "performed 2025-03-02" in run("add", "dated.json", "--date", "2025-03-02").stdout


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["add", "none.json"], "none.json: cannot be read: No such file or directory"),
        (["add", "limits.toml"], "limits.toml: expected a calibration file of tumble, found"),
        (["add", "new.json", "--date", "1.3.2026"], "'1.3.2026' does not match the format"),
        (["add", "new.json", "--date", "2999-01-01"], "expected a date that is past, found 2999-01-01"),
        (["add", "new.json", "--registry", ""], "postgresql://USER@HOST/NAME, found an empty name"),
        (["list"], "r.sqlite: expected a registry, found no such file; `tumble registry add` makes one"),
        (["limits", "BCHE-501", "new.json"], "new.json: expected TOML, found an error in its syntax"),
        (["show"], "show: expected the NUMBER of a record or --type MODEL, found none of them or both"),
        (["show", "one"], "Invalid value for '[NUMBER]': 'one' is not a valid integer range"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)  # fmt: skip
def test_what_cannot_be_used_is_refused_in_one_line(folder: Path, words: Sequence[str], said: str) -> None:
    assert (folder / "new.json").exists()
    assert said in refused(*words)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["list", "B"], "device 'B': expected a device of the registry, found none of this serial number"),
        (["show", 9], "record 9: expected a record of the registry, found none of this number"),
        (["limits", "other"], "type 'other': expected a device type with limits, found none for it"),
        (["show", "--type", "other"], "type 'other': expected at least 3 units in the registry, found 0"),
    ],
)
def test_what_is_not_there_is_refused_in_one_line(filled: Path, words: Sequence[object], said: str) -> None:
    before = (filled / "r.sqlite").read_bytes()
    assert said in refused(*words)
    assert (filled / "r.sqlite").read_bytes() == before


def test_names_that_look_like_markup_are_shown_as_they_are(folder: Path) -> None:
    write(folder / "x.json", content(serial="A[/red]7", model="[bold]", log="x"))
    assert "A[/red]7 ([bold])" in run("add", "x.json").stdout
    assert "A[/red]7" in run("list").stdout
    assert "A[/red]7 ([bold])" in run("trend", "A[/red]7").stdout
    assert "A[/red]7" in run("due").stdout


@pytest.mark.usefixtures("filled")
def test_what_the_registry_shows_is_data_too() -> None:
    listed = data("list")["records"]
    assert [record["serial"] for record in listed] == ["A-0007"] * 2
    shown = data("show", 1)
    assert shown["record"] == listed[0]
    assert {"name", "value", "u", "unit", "dof"} <= set(shown["parameters"][0])
    assert shown["acceptance"]["result"] == "pass"
    bias = data("trend", "A-0007")["parameters"][0]
    assert (bias["name"], [point["number"] for point in bias["points"]]) == ("accel.bias.x", [1, 2])
    (due,) = data("due", "--on", "2030-01-01")["devices"]
    assert (due["day"], due["overdue"], due["withdrawn"]) == ("2026-03-01", True, False)
    assert [limits["in_force"] for limits in data("limits")["limits"]] == [True]


def data(*words: object) -> dict[str, Any]:
    return dict(json.loads(run(*words, "--json").stdout))


def test_parameters_beyond_the_linear_model_are_counted_and_shown_on_request(folder: Path) -> None:
    whole = content(log="more")
    further = [
        {"name": f"accel.quadratic.{axis}", "value": 1e-6, "u": 1e-7, "unit": group_of("accel.quadratic.x").unit}
        for axis in "xyz"
    ]
    whole["parameters"] += further
    whole["covariance"] = np.diag([p["u"] ** 2 for p in whole["parameters"]]).tolist()
    write(folder / "more.json", whole)
    for words in (("add", "more.json"), ("show", 1), ("trend", "A-0007")):
        short, full = run(*words).stdout, run(*words, "--all").stdout
        assert "and 3 parameters beyond bias, scale and axes, in 1 group: --all shows them" in short
        assert "accel.quadratic.x" not in short
        assert "accel.quadratic.x" in full
        assert "--all" not in full
