"""What `--json` prints fits its JSON Schema, of every command that has the option."""

from __future__ import annotations

import json
from collections.abc import Iterator
from importlib.resources import files
from pathlib import Path
from typing import Any

import polars as pl
import pytest
from click.testing import CliRunner
from jsonschema import Draft202012Validator, FormatChecker

from tests.commands.test_cli import ALL
from tests.support.json_schemas import RESULTS, text_of
from tests.support.shared import copy_of, session
from tumble.cli import main
from tumble.planning.setup import Setup
from tumble.result.calibration import read_calibration

HAND = Setup.of(grade="mems", positions=12, rest=4.0, rate_deg_s=150.0, sample_rate=50.0)
LIMITS = 'format = 1\ninterval_months = 12\n[incoming]\n"accel.bias" = "50 mg"\n[periodic]\n"accel.scale" = "2 %"\n'
CAMPAIGN = 'trials = 2\n[grid]\nmethod = ["joint", "ellipsoid"]\ngrade = "mems"\npositions = 12\n'
WORDS = (
    "calibrate {}/one --json --force",
    "calibrate {}/one --json --force --method joint --method ellipsoid",
    "calibrate {}/one {}/two --json -o {}/mean.json",
    "calibrate {}/few --json -o {}/few.json",
    "ellipsoid {}/readings.csv --unit m/s^2 --json",
    "inspect {}/one --json",
    "noise {}/one --json",
    "check {}/one.json {}/two --json",
    "check {}/one.json {}/readings.csv --json",
    "check {}/one.json --listen replay:{}/two@max --json",
    "compare {}/one.json {}/two.json --json",
    "plan --json",
    "plan nine --grade mems --terms linear --accel-only --json",
    "plan --method sequential --want accel.scale=6ppm --want gyro.bias=1deg/h --json",
    "campaign {}/campaign.toml --in-process -o {}/campaign --json",
    "fleet {}/[of]* --in-process -o {}/fleet --json",
    "registry limits MODEL {}/limits.toml --registry {}/new.sqlite --json",
    "registry limits --registry {}/r.sqlite --json",
    "registry add {}/one.json --registry {}/new.sqlite --json",
    "registry show 1 --registry {}/r.sqlite --json",
    "registry show --type MODEL --registry {}/r.sqlite --json",
    "registry list --registry {}/r.sqlite --json",
    "registry trend mems-7 --registry {}/r.sqlite --json",
    "registry due --registry {}/r.sqlite --json",
    "selftest --json",
)


def run(words: str, folder: Path) -> tuple[int, str]:
    done = CliRunner().invoke(main, words.replace("{}", str(folder)).split(), prog_name="tumble")
    assert done.exit_code in (0, 1), done.output
    return done.exit_code, done.stdout


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Sessions and calibrations of three devices, one with two launches, the means of its rests, and a registry."""
    folder = tmp_path_factory.mktemp("schemas")
    (folder / "limits.toml").write_text(LIMITS, encoding="utf-8")
    (folder / "campaign.toml").write_text(CAMPAIGN, encoding="utf-8")
    copy_of(session(Setup.of(grade="mems", positions=3, rest=3.0, sample_rate=20.0), seed=1), folder / "few")
    run("registry limits MODEL {}/limits.toml --registry {}/r.sqlite", folder)
    for name, seed, launch in (("one", 7, 1), ("two", 7, 2), ("other", 8, 1), ("third", 9, 1)):
        copy_of(session(HAND, seed=seed, launch=launch), folder / name)
        described = folder / name / "session.toml"
        text = described.read_text(encoding="utf-8")
        described.write_text(text.replace("[device]\n", '[device]\nmodel = "MODEL"\n'), encoding="utf-8")
        run(f"calibrate {{}}/{name} -o {{}}/{name}.json", folder)
        run(f"registry add {{}}/{name}.json --registry {{}}/r.sqlite --date 2026-0{seed - 5 + launch}-01", folder)
    rests = read_calibration(folder / "one.json").evidence.rests
    readings = [rest.accel.mean for rest in rests if rest.accel is not None]
    pl.DataFrame(readings, schema=["ax", "ay", "az"], orient="row").write_csv(folder / "readings.csv")
    return folder


def shipped(command: str) -> Draft202012Validator:
    schema = json.loads(files("tumble").joinpath(f"schemas/{command}.json").read_text(encoding="utf-8"))
    Draft202012Validator.check_schema(schema)
    return Draft202012Validator(schema, format_checker=FormatChecker())


def documents(text: str) -> Iterator[Any]:
    """The objects that are printed: one, or one a line."""
    decoder, at = json.JSONDecoder(), 0
    while at < len(text.rstrip()):
        found, at = decoder.raw_decode(text, at)
        at += 1
        yield found


@pytest.mark.parametrize("words", WORDS)
def test_what_is_printed_fits_the_schema(words: str, made: Path) -> None:
    _, text = run(words, made)
    name = "-".join(words.split()[: 2 if words.startswith("registry") else 1])
    validator = shipped(name)
    for document in documents(text):
        assert [f"{fault.json_path}: {fault.message}"[:300] for fault in validator.iter_errors(document)] == []


@pytest.mark.parametrize("command", RESULTS)
def test_the_schemas_are_those_of_the_types(command: str) -> None:
    """They are written anew by `python -m tests.support.json_schemas`."""
    stored = files("tumble").joinpath(f"schemas/{command}.json")
    assert stored.read_text(encoding="utf-8") == text_of(command)


def test_every_command_that_prints_json_has_a_schema_and_is_tried() -> None:
    having = {"-".join(words) for words, command in ALL if any(p.name == "as_json" for p in command.params)}
    assert having == set(RESULTS)
    assert {words.partition(" -")[0].replace("registry ", "registry-").split()[0] for words in WORDS} == having


@pytest.mark.parametrize(
    ("command", "spoil"),
    [
        ("plan", lambda d: d.pop("groups")),
        ("plan", lambda d: d.update(more=1)),
        ("plan", lambda d: d["groups"][0].update(u="much")),
        ("plan", lambda d: d.update(format=2)),
    ],
)
def test_another_document_does_not_fit(command: str, spoil: Any, made: Path) -> None:
    (document,) = documents(run(f"{command} --json", made)[1])
    assert shipped(command).is_valid(document)
    spoil(document)
    assert not shipped(command).is_valid(document)
