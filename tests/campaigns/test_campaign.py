"""Campaigns: what is simulated, that its rows depend on seed and number alone, and what is made of them."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
from click.testing import CliRunner, Result

from tumble.campaigns import trial
from tumble.campaigns.campaign import Campaign, read_campaign, summary
from tumble.campaigns.engine import Executor, run, serially
from tumble.campaigns.trial import Cell, session_rows
from tumble.cli import main
from tumble.diagnosis.verdict import verdict
from tumble.errors import InputError
from tumble.inference.joint import joint
from tumble.planning.setup import NAMES, Setup
from tumble.sensors.grades import NoiseModel
from tumble.simulation.observations import simulate_observations
from tumble.simulation.scenario import itinerary, scenario_of

TABLE: Cell = {"rest": 20.0}
SESSIONS = {"seed": 3, "trials": 4, "grid": {"method": ["joint", "ellipsoid"], "table_error_deg": [0.5, 5]}}


def rows(of: Campaign, folder: Path, executor: Executor = serially) -> pl.DataFrame:
    return pl.read_parquet(run(of.job(), folder, executor=executor))


def cli(*arguments: str | Path) -> Result:
    return CliRunner().invoke(main, ["campaign", *map(str, arguments)])


# Trials


def test_rows_depend_on_the_seed_and_the_number_alone(processes: Executor, tmp_path: Path) -> None:
    campaign = Campaign.model_validate(SESSIONS)
    serial = rows(campaign, tmp_path / "serial")
    assert rows(campaign, tmp_path / "processes", processes).equals(serial)
    job = campaign.job()
    alone = pl.DataFrame(
        [{"task": 5, **job.items[5], **row} for row in job.task(5, job.items[5])], schema=serial.schema
    )
    assert alone.equals(serial.filter(pl.col("task") == 5))
    other = rows(Campaign.model_validate(SESSIONS | {"seed": 4}), tmp_path / "other")
    assert not np.isin(other["error.accel.bias.x"].drop_nulls(), serial["error.accel.bias.x"].drop_nulls()).any()


def test_intervals_change_u_and_are_taken_where_they_are_asked_for(tmp_path: Path) -> None:
    content = {"trials": 1, "grid": {"grade": "mems", "positions": 12}}
    at_maximum, integrated = (
        rows(Campaign.model_validate(content | {"intervals": asked}), tmp_path / str(asked)) for asked in (False, True)
    )
    (first, second) = (frame["u.accel.bias.x"].item() for frame in (at_maximum, integrated))
    assert first != second
    assert first == pytest.approx(second, rel=0.5)


def test_the_bound_is_taken_where_the_observations_are() -> None:
    noiseless = dataclasses.replace(Setup.of(**TABLE), noise=NoiseModel())
    scenario = scenario_of(noiseless, trial.random_numbers(1, 4))
    rng = trial.random_numbers(1, 4)
    scenario_of(noiseless, rng)
    observations = simulate_observations(scenario, rng)
    way = itinerary(scenario, trial.random_numbers(1, 4).spawn(1)[0])
    accel = scenario.accel.model(np.array([scenario.truth[name] for name in scenario.accel.names]))
    expected = accel.predict(scenario.site.gravity * way.attitudes[:, 1])
    np.testing.assert_allclose(observations.rests.accel, expected, rtol=0.0, atol=1e-12)


def test_the_uncertainty_that_a_method_states_is_never_far_below_the_bound() -> None:
    for number in range(5):
        (row,) = session_rows(2, ["joint"], False, number, TABLE)
        for name in NAMES:
            assert row[f"u.{name}"] > 0.9 * row[f"bound.{name}"]
            assert abs(row[f"error.{name}"]) < 7.0 * row[f"u.{name}"]


def test_a_trial_has_the_maximum_and_the_acceptance_of_a_calibration() -> None:
    for number in range(4):
        (row,) = session_rows(2, ["joint"], False, number, TABLE)
        rng = trial.random_numbers(2, number)
        scenario = scenario_of(Setup.of(**TABLE), rng)
        observations = simulate_observations(scenario, rng)
        whole = joint(observations, intervals=False)
        assert row["accepted"] == verdict(whole, observations).accepted
        for name, value, u in zip(whole.names, whole.values, whole.u, strict=True):
            assert row[f"error.{name}"] == pytest.approx(value - scenario.truth[name], abs=1e-9 * u)


def test_a_method_that_cannot_use_the_observations_fails_and_the_others_do_not() -> None:
    by_hand = {"positions": 20, "grade": "mems"}
    first, second = session_rows(1, ["sequential", "joint"], False, 0, by_hand)
    assert first["method"] == "sequential"
    assert "programme" in first["error"]
    assert second.get("error") is None
    assert second["error.gyro.scale.x"] is not None


# The file


def test_every_combination_is_a_point_of_the_grid() -> None:
    campaign = Campaign.model_validate(
        {"trials": 2, "grid": {"rest": [30, 60, 90], "noise_factor": [1, 2], "method": "scalar"}}
    )
    assert {(c["rest"], c["noise_factor"]) for c in campaign.cells} == {(r, f) for r in (30, 60, 90) for f in (1, 2)}
    assert len(campaign.job().items) == 12


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "trials: expected a whole number from 1 to 1e.07, found none"),
        ("trials = 1\nseeds = 2", "unknown key 'seeds' at the top level; did you mean 'seed'?"),
        ("trials = 1\n[grid]\ntable_error = 2", r"unknown key 'table_error' in \[grid\]; did you mean 'table_er"),
        ("trials = 1\n[grid]\nrest = [60, -1]", "grid.rest: expected a number from 0.1 to 86400, found -1"),
        ("trials = 1\n[grid]\nrest = true", "grid.rest: expected a number from 0.1 to 86400, found True"),
        ("trials = 1\n[grid]\nmethod = 'joit'", "grid.method: expected one of joint, .*found 'joit'"),
        ("trials = 1\n[grid]\nrest = []", "grid.rest: expected a value or more, found none"),
        ("trials = 1\n[grid]\npositions = 20.5", "grid.positions: expected a whole number from 1 to 1000, found 20.5"),
        ("trials = 1\n[grid]\npositions = 20\nprogramme = 'nine'", "grid.positions: expected no grid.programme"),
        ("trials = 1\ngrid = 1", "grid: expected a table, found 1"),
        ("trials = 1\nintervals = 1", "intervals: expected true or false, found 1"),
        ("trials = 6000000\n[grid]\nrest = [1, 2]", "trials: expected at most 10000000 over all points"),
        ("trials = ", "expected TOML, found an error in its syntax"),
    ],
)
def test_a_fault_in_the_file_is_told_in_one_line(text: str, said: str, tmp_path: Path) -> None:
    file = tmp_path / "campaign.toml"
    file.write_text(text)
    with pytest.raises(InputError, match=said) as caught:
        read_campaign(file)
    assert str(caught.value).startswith(f"{file}: ")
    assert "\n" not in str(caught.value)


# The summary


def table(folder: Path, **columns: Any) -> Path:
    """Rows of a campaign of one point with these columns."""
    campaign = Campaign.model_validate({"trials": 1})
    job = campaign.job()
    given = [dict(zip(columns, values, strict=True)) for values in zip(*columns.values(), strict=True)]
    schema = {"task": pl.Int64, **job.schema, "error": pl.String}
    frame = pl.DataFrame([{"task": i, **job.items[0], **row} for i, row in enumerate(given)], schema=schema)
    frame.write_parquet(folder / "rows.parquet")
    return folder / "rows.parquet"


def test_bias_scatter_rms_ratio_and_coverage_of_rows(tmp_path: Path) -> None:
    path = table(
        tmp_path,
        method=["joint"] * 6,
        accepted=[True, True, True, True, False, None],
        error=[None] * 5 + ["ValueError: no"],
        **{f"error.accel.bias.{a}": [1.0, 3.0, 1.0, 3.0, 99.0, None] for a in "xyz"},
        **{f"u.accel.bias.{a}": [1.0, 1.0, 1.0, 2.0, 1.0, None] for a in "xyz"},
        **{f"bound.accel.bias.{a}": [2.0, 2.0, 2.0, 2.0, 1.0, 1.0] for a in "xyz"},
    )
    (line,) = summary(path)
    assert (line.method, line.group, line.unit) == ("joint", "accel.bias", "m/s^2")
    assert (line.trials, line.accepted, line.failed) == (6, 4, 1)
    assert line.bias == pytest.approx(2.0)
    assert line.scatter == pytest.approx(1.0)
    assert line.rms == pytest.approx(np.sqrt(5.0))
    assert line.to_bound == pytest.approx(np.sqrt(5.0) / 2.0)
    assert line.coverage == pytest.approx(0.75)


def test_a_point_without_an_accepted_trial_has_counts_and_no_errors(tmp_path: Path) -> None:
    lines = summary(table(tmp_path, method=["joint"], error=["ValueError: no"]))
    assert {line.group for line in lines} == {line.group for line in lines if line.rms is None and line.failed == 1}
    assert {line.why for line in lines} == {"ValueError: no"}


def test_the_command_writes_rows_and_summary_and_resumes(tmp_path: Path) -> None:
    file, out = tmp_path / "campaign.toml", tmp_path / "out"
    file.write_text("trials = 2\n[grid]\ntable_error_deg = [1, 3]\n")
    first = cli(file, "--in-process", "-o", out)
    assert first.exit_code == 0, first.output
    assert {path.name for path in out.iterdir()} == {"manifest.json", "rows.parquet", "summary.csv"}
    assert "gyro.axis" in first.stdout
    assert pl.read_csv(out / "summary.csv")["rms"].len() == 12
    changed = (out / "rows.parquet").stat().st_mtime_ns
    again = cli(file, "--in-process", "-o", out)
    assert again.stdout == first.stdout
    assert (out / "rows.parquet").stat().st_mtime_ns == changed
    file.write_text("trials = 3\n[grid]\ntable_error_deg = [1, 3]\n")
    refused = cli(file, "--in-process", "-o", out)
    assert refused.exit_code == 2
    assert "out was complete: no trials were computed" in again.stderr
    assert "expected a new folder, found one that another job has begun; give another" in refused.stderr
    assert refused.stderr.strip().count("\n") == 0
