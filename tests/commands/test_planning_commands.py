"""The commands before a calibration: tumble programme and plan."""

from __future__ import annotations

import io
import json
import sys
import time
from pathlib import Path

import click
import numpy as np
import pytest
from click.core import ParameterSource
from click.testing import CliRunner, Result

from tumble.cli import main
from tumble.commands.console import working
from tumble.units import ARCSEC, DEGREE_PER_HOUR, G_STANDARD, READ, quantity


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
    assert quantity(text, READ[unit]) == pytest.approx(value, rel=1e-14)


@pytest.mark.parametrize(
    ("text", "unit"), [("3kg", "1"), ("ppm", "1"), ("1 ppm", "rad"), ("", "rad/s"), ("1 2 ppm", "1")]
)
def test_a_quantity_that_is_none_is_refused(text: str, unit: str) -> None:
    with pytest.raises(ValueError, match="expected a number and one of"):
        quantity(text, READ[unit])


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


def test_a_better_table_makes_the_first_pass_of_the_sequential_method_better() -> None:
    words = ("plan", "--method", "sequential", "--iterations", "1", "--noiseless", "--json")
    rough, fine = (
        json.loads(run(*words, "--table-error", e, "--mounting-error", e).stdout)["groups"] for e in ("2", "0.2")
    )
    assert rough[1]["group"] == "accel.scale"
    assert rough[1]["u"] == pytest.approx(10.0 * fine[1]["u"], rel=0.1)
    assert not any("quadratic" in source for row in rough for source in row["sources"])  # of the method alone
    (noisy,) = (
        each for each in json.loads(run(*words[:5], "--json").stdout)["groups"] if each["group"] == "accel.scale"
    )
    assert "accel.quadratic" in noisy["sources"]


def test_plans_are_data() -> None:
    plan = json.loads(run("plan", "--grade", "mems", "--want", "accel.scale=300ppm", "--json").stdout)
    assert plan["verdict"] == "accepted"
    assert plan["rank"] == 21
    assert plan["setup"]["programme"]["moves"][0]["angle"] == pytest.approx(np.pi)
    assert plan["requirements"][0]["wanted"] == pytest.approx(3e-4)
    assert plan["requirements"][0]["rest"] > 0.0
    assert len(plan["following"]) == 5


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
    context.set_parameter_source("quiet", ParameterSource.COMMANDLINE if quiet else ParameterSource.DEFAULT)
    with context, working("planning") as told:
        told(1, 6)
        deadline = time.monotonic() + 5.0
        while shown and "1 of 6" not in terminal.getvalue() and time.monotonic() < deadline:
            time.sleep(0.05)
    assert ("planning  1 of 6  " in terminal.getvalue()) is shown
    assert terminal.getvalue().endswith("\r\x1b[K") is shown  # the line is gone
