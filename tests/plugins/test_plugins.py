"""What other packages bring by entry points: the example package of the documentation, installed and run; and packages
that are broken."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import polars as pl
import pytest

from tests.support import ROOT
from tests.support.calibrated import calibration

EXAMPLE = ROOT / "docs/examples/tumble-example"
RUN = """
import json, sys
from click.testing import CliRunner
from tumble.cli import main
done = [CliRunner().invoke(main, words) for words in json.loads(sys.argv[1])]
print(json.dumps([[one.exit_code, one.stdout, one.stderr] for one in done]))
"""


class Done(NamedTuple):
    """Exit status and output of a command."""

    status: int
    out: str
    err: str


def run(site: Path, *commands: list[object]) -> list[Done]:
    """Commands in a process of their own, in which the packages of a folder are installed."""
    env = os.environ | {"PYTHONPATH": os.pathsep.join([str(site), *sys.path])}
    words = json.dumps([[str(word) for word in words] for words in commands])
    done = subprocess.run([sys.executable, "-c", RUN, words], env=env, capture_output=True, text=True, check=True)
    return [Done(*one) for one in json.loads(done.stdout)]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The example, installed into a folder."""
    pytest.importorskip("setuptools", minversion="70.1")  # from which on it builds wheels by itself
    folder, source = tmp_path_factory.mktemp("site"), tmp_path_factory.mktemp("source") / "example"
    shutil.copytree(EXAMPLE, source)  # which building writes into
    words = ["--quiet", "--no-deps", "--no-build-isolation", "--disable-pip-version-check", "--target"]
    subprocess.run([sys.executable, "-m", "pip", "install", *words, folder, source], check=True)
    return folder


def test_the_example_brings_one_of_each(site: Path, tmp_path: Path) -> None:
    calibration().write(tmp_path / "c.json")
    listed, biases, exported, sheet, simulated, calibrated = run(
        site,
        ["--help"],
        ["biases", tmp_path / "c.json"],
        ["export", tmp_path / "c.json", "--to", "slowfly", "-o", tmp_path / "imu.cfg"],
        ["programme", "seesaw"],
        ["simulate", tmp_path / "s", "--programme", "seesaw", "--grade", "mems", "--rest", 5, "--turn-rate", 60],
        ["calibrate", tmp_path / "s"],
    )
    assert "From tumble-example" in listed.out
    assert "Print the biases of CALIBRATION" in listed.out
    assert biases.out.splitlines()[0].startswith("accel.bias.x\t")
    assert len(biases.out.splitlines()) == 6
    assert "SlowFly zeroes the gyros at every start" in exported.err
    assert "\n[accelerometer]\nx = " in (tmp_path / "imu.cfg").read_text()
    assert "seesaw" in sheet.out
    assert simulated.status == 0, simulated.err
    assert 'name = "seesaw"' in (tmp_path / "s/session.toml").read_text()
    assert calibrated.status == 0, calibrated.err
    names = {p["name"] for p in json.loads((tmp_path / "s/calibration.json").read_text())["parameters"]}
    assert {f"accel.product.{axis}" for axis in "xyz"} <= names

    log = pl.read_parquet(tmp_path / "s/log.parquet")
    records = b"".join(
        row[:1].to_numpy().astype("<f8").tobytes() + row[1:].to_numpy().astype("<f4").tobytes()
        for row in (pl.Series(r) for r in log.select("t", "ax", "ay", "az", "gx", "gy", "gz").iter_rows())
    )
    (tmp_path / "r.sfl").write_bytes(b"SLOWFLY1" + records)
    (tmp_path / "bad.sfl").write_bytes(b"nothing")
    new, inspected, damaged = run(
        site,
        ["new", tmp_path / "n", tmp_path / "r.sfl", "--latitude", 56.84],
        ["inspect", tmp_path / "n"],
        ["new", tmp_path / "m", tmp_path / "bad.sfl"],
    )
    assert (new.status, inspected.status) == (0, 0), new.err + inspected.err
    assert damaged.status == 2
    assert damaged.err.startswith(f"tumble: {tmp_path}/bad.sfl: expected an intact recording")


def test_without_it_its_names_are_unknown(tmp_path: Path) -> None:
    calibration().write(tmp_path / "c.json")
    (tmp_path / "r.sfl").write_bytes(b"SLOWFLY1")
    done = run(
        tmp_path,
        ["biases", "c.json"],
        ["export", tmp_path / "c.json", "--to", "slowfly", "-o", tmp_path / "x"],
        ["programme", "seesaw"],
        ["simulate", tmp_path / "s", "--programme", "seesaw"],
        ["new", tmp_path / "n", tmp_path / "r.sfl"],
    )
    assert [one.status for one in done] == [2] * 5
    assert all(one.err.startswith("tumble: ") and one.err.count("\n") == 1 for one in done)


BROKEN = """
[tumble.commands]
missing = broken.nowhere:command
wrong = broken:NUMBER
[tumble.exports]
missing = broken.nowhere:target
wrong = broken:NUMBER
failing = broken:TEMPLATE
[tumble.programmes]
wrong = broken:NUMBER
[tumble.readers]
missing = broken.nowhere:reader
"""


@pytest.fixture
def broken(tmp_path: Path) -> Path:
    """A folder with a package whose entry points name what is not there or something else."""
    site, template = tmp_path / "site", tmp_path / "bad.tmpl"
    (site / "broken-1.0.dist-info").mkdir(parents=True)
    (site / "broken-1.0.dist-info/METADATA").write_text("Metadata-Version: 2.1\nName: broken\nVersion: 1.0\n")
    (site / "broken-1.0.dist-info/entry_points.txt").write_text(BROKEN)
    (site / "broken.py").write_text(f"from pathlib import Path\nNUMBER = 1\nTEMPLATE = Path({str(template)!r})\n")
    template.write_text("no front matter")
    calibration().write(tmp_path / "c.json")
    (tmp_path / "r.sfl").write_bytes(b"SLOWFLY1")
    return site


def test_a_broken_package_is_one_line(broken: Path, tmp_path: Path) -> None:
    export: list[object] = ["export", tmp_path / "c.json", "-o", tmp_path / "x", "--to"]
    listed, *done = run(
        broken,
        ["--help"],
        ["missing"],
        ["wrong"],
        [*export, "missing"],
        [*export, "wrong"],
        [*export, "failing"],
        ["programme", "wrong"],
        ["new", tmp_path / "n", tmp_path / "r.sfl"],
    )
    assert listed.status == 0
    assert "Cannot be imported." in listed.out
    assert [one.status for one in done] == [2] * 7
    for one in done:
        assert one.err.startswith("tumble: ")
        assert one.err.count("\n") == 1
        assert "expected" in one.err
    assert "package broken, entry point tumble.commands: missing = broken.nowhere:command" in done[0].err
    assert "expected a Command, found a int; mend the package or uninstall it" in done[1].err
    (built_in,) = run(broken, [*export, "csv"])
    assert built_in.status == 0


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("accel.bias", "expected the name of a group that is new, such as accel.fifth, found 'accel.bias'"),
        ("mag.gain", "expected the name of a group that is new, such as accel.fifth, found 'mag.gain'"),
        ("accel.fifth", "expected regressors of the group 'accel.fifth', found none"),
    ],
)
def test_a_group_of_parameters_needs_a_name_of_its_own_and_regressors(name: str, expected: str, tmp_path: Path) -> None:
    (tmp_path / "groups-1.0.dist-info").mkdir()
    (tmp_path / "groups-1.0.dist-info/METADATA").write_text("Metadata-Version: 2.1\nName: groups\nVersion: 1.0\n")
    (tmp_path / "groups-1.0.dist-info/entry_points.txt").write_text("[tumble.parameters]\nother = own_groups:GROUP\n")
    (tmp_path / "own_groups.py").write_text(
        "from dataclasses import replace\nfrom tumble.sensors.parameters import LINEAR\n"
        f"GROUP = replace(LINEAR[0], name={name!r})\n"
    )
    (done,) = run(tmp_path, ["simulate", tmp_path / "s", "--terms", "full", "--grade", "mems"])
    assert done.status == 2
    assert expected in done.err
