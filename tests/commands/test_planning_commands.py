"""The commands that plan a calibration: tumble programme, budget and require."""

from __future__ import annotations

import io
import json
import sys
from pathlib import Path

import click
import numpy as np
import pytest
from click.testing import CliRunner, Result

from tumble.cli import main
from tumble.commands.tell import working
from tumble.units import ARCSEC, DEGREE_PER_HOUR, G_STANDARD, quantity


def run(*arguments: str) -> Result:
    return CliRunner().invoke(main, list(arguments))


@pytest.mark.parametrize(
    ("text", "unit", "value"),
    [
        ("3.5ppm", "1", 3.5e-6),
        ("1 %", "1", 0.01),
        ("20 µg", "m/s^2", 20e-6 * G_STANDARD),
        ("20ug", "m/s^2", 20e-6 * G_STANDARD),
        ('5"', "rad", 5 * ARCSEC),
        ("1e-3 °/h", "rad/s", 1e-3 * DEGREE_PER_HOUR),
    ],
)
def test_a_quantity_is_read_in_its_units(text: str, unit: str, value: float) -> None:
    assert quantity(text, unit) == pytest.approx(value, rel=1e-14)


@pytest.mark.parametrize(
    ("text", "unit"), [("3kg", "1"), ("ppm", "1"), ("1 ppm", "rad"), ("", "rad/s"), ("1 2 ppm", "1")]
)
def test_a_quantity_that_is_none_is_refused(text: str, unit: str) -> None:
    with pytest.raises(ValueError, match="expected a number and one of"):
        quantity(text, unit)


def test_the_sheet_lists_every_position_and_is_written(tmp_path: Path) -> None:
    page = tmp_path / "sheet.html"
    result = run("programme", "rough-table", "-o", str(page))
    assert result.exit_code == 0, result.stderr
    assert sum(line.lstrip()[:2].strip().isdigit() for line in result.stdout.splitlines()) == 15
    assert page.read_text().count("<svg") >= 15


def test_the_sheet_of_attitudes_of_ones_own() -> None:
    result = run("programme", "--attitude", "NUE", "--attitude", "NUE N+45")
    assert result.exit_code == 0, result.stderr
    assert "NUE N+45" in result.stdout


@pytest.mark.parametrize("arguments", [(), ("nine", "--attitude", "NUE"), ("rough-tabel",), ("--attitude", "NUU")])
def test_a_programme_that_does_not_exist_is_refused(arguments: tuple[str, ...]) -> None:
    result = run("programme", *arguments)
    assert result.exit_code == 2
    assert len(result.stderr.strip().splitlines()) == 1


def test_the_budget_has_a_row_for_every_method_pass_and_group() -> None:
    result = run("budget", "--grade", "navigation", "--terms", "linear")
    assert result.exit_code == 0, result.stderr
    rows = [line.split()[:3] for line in result.stdout.splitlines()[1:] if line.strip()]
    assert len({tuple(row) for row in rows}) == (1 + 3 * 2) * 6


def test_the_budget_is_that_of_the_default_method_with_all_terms() -> None:
    result = run("budget", "--json")
    rows = json.loads(result.stdout)["rows"]
    assert {row["method"] for row in rows} == {"joint"}
    assert [row["error"] for row in rows] == [row["bound"] for row in rows]
    assert next(row for row in rows if row["group"] == "accel.scale")["error"] == pytest.approx(5.07e-6, rel=0.01)


def test_a_better_table_makes_the_first_pass_of_the_sequential_method_better() -> None:
    rough, fine = (
        run(
            "budget",
            "--method",
            "sequential",
            "--iterations",
            "1",
            "--noiseless",
            "--table-error",
            e,
            "--mounting-error",
            e,
        )
        for e in ("2", "0.2")
    )
    share = [
        float(next(line for line in r.stdout.splitlines() if "accel.scale" in line).split("%")[0].split()[-1])
        for r in (rough, fine)
    ]
    assert share[0] == pytest.approx(10.0 * share[1], rel=0.1)


def test_what_no_table_can_give_is_named_with_exit_status_1() -> None:
    wanted = ("--want", "accel.scale=3ppm")
    result = run("require", *wanted, "--want", "gyro.bias=0.0001 °/h", "--method", "sequential")
    assert result.exit_code == 1
    assert "no table" in result.stdout
    assert "instability" in result.stdout
    feasible = run("require", *wanted, "--method", "sequential")
    assert feasible.exit_code == 0
    assert "table within ±" in feasible.stdout
    default = run("require", *wanted)
    assert default.exit_code == 1
    assert "expected an accuracy of at least 4." in default.stdout


@pytest.mark.parametrize(
    "arguments", [(), ("--want", "accel.scale"), ("--want", "accel.scael=1ppm"), ("--relative", "-1")]
)
def test_a_requirement_that_cannot_be_read_is_refused(arguments: tuple[str, ...]) -> None:
    result = run("require", *arguments)
    assert result.exit_code == 2
    assert len(result.stderr.strip().splitlines()) == 1


def test_plans_and_requirements_are_data_too() -> None:
    plan = json.loads(run("plan", "--grade", "mems", "--json").stdout)
    assert plan["bound"]["rank"] == plan["bound"]["of"] == len(plan["parameters"]) == 21
    assert all(p["u"] <= p["u_with_all_groups"] * 2.0 for p in plan["parameters"])
    assert plan["positions"][1]["turn"]["angle"] == pytest.approx(np.pi)
    budget = json.loads(run("budget", "--grade", "mems", "--method", "staged", "--json").stdout)
    assert {row["method"] for row in budget["rows"]} == {"staged"}
    assert all(row["bound"] < row["error"] * 1.5 for row in budget["rows"])
    require = json.loads(run("require", "--want", "accel.scale=100ppm", "--grade", "mems", "--json").stdout)
    assert require["verdict"] == require["rows"][0]["verdict"] == "accepted"
    assert require["rows"][0]["wanted"] == pytest.approx(1e-4)


def test_plans_over_temperature_are_data_too() -> None:
    words = "plan --grade mems --programme rough-table --over-temperature -20/4,20,60 --want accel.bias=1ug --json"
    result = run(*words.split())
    plan = json.loads(result.stdout)
    assert result.exit_code == 1
    assert plan["reasons"][0].startswith("accel.bias: expected 1 µg (rms) from -20.0 to 60.0 °C".replace("-", "−"))
    assert [(each["name"], each["rests"]) for each in plan["recordings"]] == [("-20/4", 4), ("20", 15), ("60", 15)]
    assert plan["duration"] == pytest.approx(
        sum(each[part] for each in plan["recordings"] for part in ("change", "soak", "recording"))
    )
    of = {p["name"]: p for p in plan["parameters"]}
    assert of["accel.bias.x.t1"]["unit"] == "m/s^2/K"
    assert of["accel.bias.x"]["u"] < min(of["accel.bias.x"]["u_low"], of["accel.bias.x"]["u_high"])
    assert plan["recordings"][0]["alone"]["gyro.scale"] is None


class Terminal(io.StringIO):
    """Standard error that is a terminal."""

    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize(("quiet", "shown"), [(False, True), (True, False)])
def test_a_plan_shows_from_the_start_that_it_is_being_made(
    quiet: bool, shown: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setenv("TERM", "xterm")
    context = click.Context(click.Command("tumble"))
    context.params["quiet"] = quiet
    with context, working("planning") as told:
        told(1, 6)
    assert ("planning" in terminal.getvalue()) is shown
