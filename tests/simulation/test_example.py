"""The example: a log in counts without a session, of which `tumble calibrate` makes what its truth.json says."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import polars as pl
from click.testing import CliRunner

from tumble.cli import main
from tumble.result.calibration import read_calibration
from tumble.simulation.session import read_truth


def test_the_example_is_calibrated_as_it_is_read_and_is_as_its_truth_says(tmp_path: Path) -> None:
    """Columns, units and times are found; 51 parameters within what u allows: rms below 1.3, four sigmas of 51."""
    written = CliRunner().invoke(main, ["example", str(tmp_path / "first")])
    assert written.exit_code == 0, written.stderr
    assert {file.name for file in (tmp_path / "first").iterdir()} == {"log.csv", "truth.json"}
    log = pl.read_csv(tmp_path / "first/log.csv")
    assert all(kind == pl.Int64 for kind in log.dtypes)
    command = written.stderr.partition("next: tumble ")[2].split()
    done = CliRunner().invoke(main, [*command, "--truth", str(tmp_path / "first/truth.json")])
    assert done.exit_code == 0, done.stderr
    found = read_calibration(tmp_path / "first/log-session/calibration.json")
    truth = read_truth(tmp_path / "first/truth.json")
    z = [(p.value - truth[p.name]) / p.u for p in found.parameters if p.u and p.name in truth]
    assert len(z) > 40
    assert np.sqrt(np.mean(np.square(z))) < 1.3


def test_the_next_command_that_is_printed_is_one(tmp_path: Path) -> None:
    folder = str(tmp_path / "first")
    CliRunner().invoke(main, ["example", folder])
    done = CliRunner().invoke(main, ["calibrate", f"{folder}/log.csv", "--latitude", "56.84"])
    words = " ".join(done.stdout.split()).partition("next: tumble ")[2].partition(" (")[0].split()
    words[words.index("imu.json")] = str(tmp_path / "imu.json")
    exported = CliRunner().invoke(main, words)
    assert exported.exit_code == 0, exported.stderr
    assert (tmp_path / "imu.json").is_file()
