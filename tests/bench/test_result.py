"""From a source to the result: that of `tumble calibrate`, to the last digit, and what fails beside the recording."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.support.bench_driver import SITE, Bench
from tests.support.browser import eventually
from tumble.bench import results
from tumble.bench.station import Station, station_of
from tumble.errors import CalibrationError, InputError
from tumble.planning.setup import Setup
from tumble.recording.log import open_log
from tumble.recording.session_file import read_session
from tumble.run.calibrate import calibrate
from tumble.simulation.session import simulate_session

EXAMPLE = Path(__file__).with_name("example.json")
NOT_STOPPED = threading.Event()


@pytest.fixture(scope="module")
def sent(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A session that is sent to benches."""
    setup = Setup.of(grade="mems", programme="nine", rest=10.0, rate_deg_s=60.0)
    return simulate_session(tmp_path_factory.mktemp("sent") / "launch", setup, seed=4, log_format="csv")


@pytest.fixture
def recording(sent: Path, tmp_path: Path) -> Iterator[Station]:
    """A bench that records it."""
    station = station_of(tmp_path / "launch", f"replay:{sent}@20x", site=SITE)
    station.start()
    yield station
    station.stop()


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    made = Bench(tmp_path / "launch")
    yield made
    made.close()


def rows(station: Station) -> int:
    return (station.folder / "log.csv").read_text().count("\n")


def grows(station: Station) -> None:
    before = rows(station)
    eventually(lambda: rows(station) > before + 20)


# -------------------- the result --------------------


def without_date(path: Path) -> dict[str, Any]:
    content = dict(json.loads(path.read_text()))
    del content["provenance"]["created"]
    return content


def test_the_result_is_that_of_the_batch_to_the_last_digit(sent: Path, tmp_path: Path) -> None:
    registry = str(tmp_path / "registry.sqlite")
    station = station_of(tmp_path / "launch", f"replay:{sent}@max", site=SITE, registry=registry)
    station.start()
    try:
        eventually(lambda: station.state["received"]["ended"] and station.state["screen"] == "done", 120.0)
        assert station.command("register") == "nothing is calibrated yet"
        assert station.command("calibrate") == "calibrated: accepted"
        assert "record 1" in station.command("register")
        result = eventually(lambda: _registered(station))
        assert "record 1" in result["registered"]
        assert station.command("export", result["formats"][0]).startswith("written: export-")
        shown = _when_estimated(station)
    finally:
        station.stop()
    assert (tmp_path / "launch" / "log.csv").read_bytes() == (sent / "log.csv").read_bytes()
    calibrate(sent).write(tmp_path / "batch.json")
    assert without_date(tmp_path / "launch" / "calibration.json") == without_date(tmp_path / "batch.json")
    again = Station(tmp_path / "launch", None)  # a page that is started again says the same
    again.start()
    assert _when_estimated(again) == shown
    assert again.command("calibrate") == "calibrated: accepted"
    assert again.command("register").endswith("found none; start `tumble bench` with --registry FILE")
    again.stop()


def _registered(station: Station) -> dict[str, Any] | None:
    result = station.state["result"]
    return result if result is not None and result["registered"] else None


def _when_estimated(station: Station) -> dict[str, Any]:
    """What the page shows with the estimate from all rests."""

    def shown() -> dict[str, Any] | None:
        state: dict[str, Any] = {**station.state}
        all_rests = state["estimate"] is not None and state["estimate"]["rests"] == 9
        return {key: state[key] for key in ("screen", "headline", "rest", "sphere")} if all_rests else None

    return dict(eventually(shown, 60.0))


def test_what_is_stated_of_a_replay_comes_before_what_its_session_has(sent: Path, tmp_path: Path) -> None:
    stated = {"latitude_deg": -33.0, "gravity": 9.797}
    source = f"replay:{sent}@max"
    station = station_of(tmp_path / "launch", source, serial="B-8", site=stated, programme="cube-14")
    assert station.task.session.device.serial == "B-8"
    assert station.task.session.site.gravity == 9.797
    assert station.task.programme is not None
    assert station.task.programme.name == "cube-14"
    plain = station_of(tmp_path / "plain", source, site={})
    assert plain.task.session.device.serial == read_session(sent).device.serial
    assert plain.task.session.site == read_session(sent).site


def test_a_session_in_another_format_is_replayed_to_the_last_digit(tmp_path: Path) -> None:
    setup = Setup.of(grade="mems", positions=4, rest=3.0, rate_deg_s=90.0)
    sent = simulate_session(tmp_path / "sent", setup, seed=5, log_format="parquet")
    station = station_of(tmp_path / "launch", f"replay:{sent}@max", site=SITE)
    station.start()
    try:
        eventually(lambda: station.state["received"]["ended"], 60.0)
        eventually(lambda: station.state["headline"] == "The recording has ended", 10.0)
    finally:
        station.stop()
    received, original = (
        [
            np.column_stack([c.time, c.accel, *([] if c.gyro is None else [c.gyro])])
            for c in open_log(read_session(folder)).chunks()
        ]
        for folder in (tmp_path / "launch", sent)
    )
    np.testing.assert_array_equal(np.concatenate(received), np.concatenate(original))


# -------------------- the calibration in a process of its own --------------------


@pytest.fixture
def child(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """What the process that calibrates does, in place of tumble: Python that knows the file `out` it is to write."""
    package = tmp_path / "path" / "tumble"
    package.mkdir(parents=True)
    (package / "__init__.py").touch()
    monkeypatch.setenv("PYTHONPATH", str(package.parent))
    return package / "__main__.py"


def does(child: Path, code: str) -> None:
    child.write_text(f"import shutil, sys\nout = sys.argv[sys.argv.index('--out') + 1]\n{code}\n")


WRITES = f"shutil.copyfile({str(EXAMPLE)!r}, out)"


@pytest.mark.parametrize(
    ("code", "said"),
    [
        ("raise ValueError('Out of range')", "has ended without a result; ValueError: Out of range"),
        ("sys.exit(0)", "has ended without a result"),
        (f"{WRITES}; sys.exit(1)", "expected a result that agrees with how it has ended, accepted: False"),
        (f"{WRITES}; sys.exit(70)", "ended with the status 70"),
        ("print('tumble: an error of the program: x', file=sys.stderr); sys.exit(70)", "an error of the program: x"),
        ("import os, signal; os.kill(os.getpid(), signal.SIGKILL)", "ended with the status -9"),
        ("print('{', file=open(out, 'w'))", "expected"),
    ],
)
def test_a_crash_is_no_verdict_and_an_old_calibration_no_new_one(
    child: Path, bench: Bench, code: str, said: str
) -> None:
    station = bench.station
    does(child, WRITES)
    assert station.command("calibrate") == "calibrated: accepted"
    before = (station.folder / "calibration.json").read_bytes()
    does(child, code)
    assert said in station.command("calibrate")
    station.step()
    assert station.state["result"] is None
    assert not station.state["calibrating"]
    assert station.command("report") == "nothing is calibrated yet"
    assert station.file("calibration.json") is None
    assert (station.folder / "calibration.json").read_bytes() == before
    assert {path.name for path in station.folder.iterdir()} == {"calibration.json", "log.csv", "session.toml"}


def test_what_is_left_out_makes_a_result_an_old_one(child: Path, bench: Bench) -> None:
    bench.until(lambda: bench.screen == "rest")
    does(child, WRITES)
    bench.station.command("calibrate")
    bench.unit.mischief("knock", 0.1)
    bench.until(lambda: bench.screen == "fault")
    bench.station.command("again")
    bench.run(0.2)
    assert bench.state["excluded"] == 1
    assert bench.state["result"] is None


def test_no_module_of_the_working_folder_is_run(bench: Bench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    hostile = tmp_path / "from a mail"
    hostile.mkdir()
    for name in ("click", "tumble", "json", "numpy"):
        (hostile / f"{name}.py").write_text(f"open({str(tmp_path / 'run')!r}, 'w').close()\nraise SystemExit(0)\n")
    monkeypatch.chdir(hostile)
    with pytest.raises(CalibrationError, match=r"log\.csv"):
        results.calibrate_folder(bench.station.folder, NOT_STOPPED)
    assert not (tmp_path / "run").exists()


def test_a_calibration_ends_with_the_bench(child: Path, bench: Bench) -> None:
    does(child, "import time; time.sleep(600)")
    stopped = threading.Event()
    threading.Timer(0.3, stopped.set).start()
    with pytest.raises(CalibrationError, match="ended with the status -15"):
        results.calibrate_folder(bench.station.folder, stopped)


# -------------------- errors, stops, units --------------------


def test_an_error_of_the_program_is_said_and_the_page_goes_on(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(results, "calibrate_folder", lambda *_: [][1])
    said = bench.station.command("calibrate")
    assert said == "calibrate: not done (IndexError: list index out of range)"
    assert bench.station.command("go_on") == "going on"
    assert bench.station.command("table") == "no such command"
    monkeypatch.setattr(bench.station, "step", lambda: [][1])
    bench.station.start()
    eventually(lambda: "the page stands still" in bench.state["message"])


def test_a_recording_that_was_stopped_can_always_go_on(recording: Station, monkeypatch: pytest.MonkeyPatch) -> None:
    eventually(lambda: recording.state["received"]["samples"] > 500)
    assert not recording.command("calibrate").startswith("calibrated")
    state = eventually(lambda: recording.state if recording.state["answers"] else None)
    assert {each["do"]: each["primary"] for each in state["answers"]} == {"resume": True, "calibrate": False}
    with monkeypatch.context() as patched:
        patched.setattr(recording, "_listen", lambda: (_ for _ in ()).throw(InputError("--listen: it is gone")))
        assert recording.command("resume") == "--listen: it is gone"
    assert recording.command("resume") == "recording goes on"
    grows(recording)
    assert recording.command("stop") == "recording has stopped"
    times = np.loadtxt(recording.folder / "log.csv", delimiter=",", skiprows=1)[:, 0]
    assert (np.diff(times) > 0.0).all()


def test_units_one_after_the_other_have_folders_of_their_own(
    recording: Station, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = recording.folder
    with monkeypatch.context() as patched:
        patched.setattr("tumble.bench.session_folder.begin_next", lambda *_: Path("no/such/folder").mkdir())
        assert "No such file" in recording.command("next_unit", "B-2")
    assert "expected 1 to 200 printable" in recording.command("next_unit", "9" * 400)
    assert recording.command("next_unit", " ") == "expected the serial number of the next unit"
    assert recording.folder == folder  # a unit that is refused does not stop the recording
    grows(recording)
    for given, serial in (
        ("é" * 200, "é" * 200),
        ("]C1010461234567890\x1d10LOT\n", "]C1010461234567890 10LOT"),
        ("<script>B-2</script>", "<script>B-2</script>"),
    ):
        assert recording.command("next_unit", given) == f"next unit: {serial}"
        grows(recording)
        assert read_session(recording.folder).device.serial == serial
        assert recording.folder.parent == tmp_path


def test_a_new_session_wants_a_serial_number_and_a_place(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"found no serial$"):
        station_of(tmp_path / "new", "udp:0", site=SITE)
    with pytest.raises(InputError, match=r"found no latitude$"):
        station_of(tmp_path / "new", "udp:0", serial="A", site={"gravity": 9.81})
    with pytest.raises(InputError, match="expected a session folder, or listen"):
        station_of(tmp_path / "new", None, site=SITE)
    with pytest.raises(InputError, match=r"session\.toml"):
        station_of(tmp_path / "new", f"replay:{tmp_path}@2x", site=SITE)
    assert list(tmp_path.iterdir()) == []
