"""What `tumble noise` says of what it took for granted stands where the values are read."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import polars as pl
from click.testing import CliRunner

from tumble.cli import main


def still_log(path: Path, gyros: tuple[str, str, str]) -> Path:
    """A minute at rest, accelerometers in m/s², gyros in whatever their names say or not."""
    rng, count = np.random.default_rng(1), 6000
    accel = [0.0, 0.0, 9.81] + 0.02 * rng.standard_normal((count, 3))
    gyro = [0.01, 0.02, 0.0] + 0.002 * rng.standard_normal((count, 3))
    columns = {"t": 0.01 * np.arange(count), **dict(zip(("ax", "ay", "az"), accel.T, strict=True))}
    pl.DataFrame(columns | dict(zip(gyros, gyro.T, strict=True))).write_csv(path)
    return path


def output(*words: object) -> str:
    result = CliRunner().invoke(main, ["noise", *map(str, words)])
    assert result.exit_code == 0, result.output
    return result.stdout


def test_a_guessed_unit_of_the_gyros_is_doubted_beside_their_noise(tmp_path: Path) -> None:
    log = still_log(tmp_path / "still.csv", ("gx", "gy", "gz"))
    last = output(log).splitlines()[-1]
    assert last.startswith("doubt: gyros")
    assert "deg/s" in last
    assert json.loads(output(log, "--json"))["doubt"] == last.removeprefix("doubt: ")


def test_a_unit_that_is_stated_or_named_is_not_doubted(tmp_path: Path) -> None:
    log = still_log(tmp_path / "still.csv", ("gx", "gy", "gz"))
    assert "guess" not in output(log, "--gyro-unit", "rad/s")
    named = still_log(tmp_path / "named.csv", ("gx (rad/s)", "gy (rad/s)", "gz (rad/s)"))
    assert "guess" not in output(named)
