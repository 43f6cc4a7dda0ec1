"""The command line in hostile and in clumsy hands: one clear line and exit status 2 for what cannot be used, nothing
written, never a traceback. What a recording may suffer from is in test_refusals.py."""

from __future__ import annotations

import hashlib
import importlib
import json
import os
import pkgutil
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click
import numpy as np
import polars as pl
import pytest
import tomli_w
from click.shell_completion import ShellComplete
from click.testing import CliRunner, Result

import tumble.commands
from tests.support.calibrated import calibration
from tests.support.shared import copy_of, session
from tumble import __version__
from tumble.cli import first_sentence, main
from tumble.planning.setup import Setup
from tumble.run.observed import inspect_session
from tumble.views.inspection import inspection_blocks
from tumble.views.render.terminal import text_of

HAND = Setup.of(grade="mems", positions=12, rest=4.0, rate_deg_s=150.0, sample_rate=50.0)
FEW = Setup.of(grade="mems", positions=3, rest=3.0, rate_deg_s=200.0, sample_rate=20.0)
QUICK = ("--positions", "3", "--rest", "3", "--sample-rate", "20", "--turn-rate", "200")
SENSORS = ("ax", "ay", "az", "gx", "gy", "gz")


def run(*words: object) -> Result:
    """A command in this process; an exception is a traceback to the user."""
    result = CliRunner().invoke(main, [str(word) for word in words], prog_name="tumble")
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise AssertionError(f"tumble {' '.join(map(str, words))}") from result.exception
    return result


def tree(folder: Path) -> dict[str, str]:
    """Every file below a folder, with its content's digest."""
    files = (path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


def refused(*words: object, below: Path) -> str:
    """The one line for which a command is refused; it left everything below a folder as it was."""
    before = tree(below)
    result = run(*words)
    assert result.exit_code == 2, result.output
    assert result.stdout == ""
    assert re.fullmatch(r"tumble: [^\n]+\n", result.stderr), result.stderr
    assert tree(below) == before
    return result.stderr.removeprefix("tumble: ").rstrip("\n")


@pytest.fixture(scope="session")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with two launches of a device, `one` and `two`, another device, `other`, and one with too few positions,
    `few`."""
    folder = tmp_path_factory.mktemp("cli")
    copy_of(session(HAND, seed=7, launch=1), folder / "one")
    copy_of(session(HAND, seed=7, launch=2), folder / "two")
    copy_of(session(HAND, seed=8), folder / "other")
    copy_of(session(FEW, seed=1), folder / "few")
    return folder


@pytest.fixture
def sessions(made: Path, tmp_path: Path) -> Path:
    """A copy of them to work in."""
    return Path(shutil.copytree(made, tmp_path / "sessions"))


# -------------------- what the commands are --------------------


def commands(
    command: click.Command = main, words: tuple[str, ...] = ()
) -> Iterator[tuple[tuple[str, ...], click.Command]]:
    """Every command with the words that call it."""
    yield words, command
    if isinstance(command, click.Group):
        context = click.Context(command)
        for name in command.list_commands(context):
            part = command.get_command(context, name)
            assert part is not None
            yield from commands(part, (*words, name))


ALL = list(commands())


@pytest.mark.parametrize(("words", "command"), ALL, ids=[" ".join(words) or "tumble" for words, _ in ALL])
def test_every_command_explains_itself_and_each_of_its_options(words: tuple[str, ...], command: click.Command) -> None:
    result = run(*words, "--help")
    assert result.exit_code == 0
    assert result.stdout.startswith(f"Usage: {' '.join(('tumble', *words))} ")
    assert result.stdout == run(*words, "-h").stdout
    for parameter in command.params:
        if isinstance(parameter, click.Option):
            assert parameter.help or isinstance(parameter.type, click.Choice) or parameter.is_eager, parameter.name
            assert all(option in result.stdout for option in parameter.opts)


def test_the_version_is_that_of_the_package() -> None:
    for words in ((), ("calibrate",), ("registry", "add")):
        assert run(*words, "--version").stdout == f"tumble, version {__version__}\n"


HEAVY = ("numpy", "scipy", "polars", "pydantic", "matplotlib")


@pytest.mark.parametrize("words", [("--help",), ("calibrate", "--help"), ("simulate", "--help"), ("--version",)])
def test_help_needs_nothing_heavy(words: tuple[str, ...]) -> None:
    code = (
        "import sys\n"
        "from tumble.cli import main\n"
        f"try: main({list(words)!r})\n"
        "except SystemExit as done: assert done.code == 0\n"
        f"print([name for name in {HEAVY!r} if name in sys.modules])\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"


@pytest.mark.parametrize(
    ("typed", "begun", "offered"),
    [
        (["plan", "--grade"], "m", ["mems"]),
        (["simulate", "--programme"], "cube-1", ["cube-14", "cube-12"]),
        (["programme"], "ni", ["nine"]),
    ],
)
def test_the_tab_key_completes_names(typed: list[str], begun: str, offered: list[str]) -> None:
    found = ShellComplete(main, {}, "tumble", "_TUMBLE_COMPLETE").get_completions(typed, begun)
    assert [each.value for each in found] == offered


def test_no_argument_at_all_shows_the_commands() -> None:
    result = run()
    assert result.exit_code == 2
    assert "Commands:" in result.output


# -------------------- arguments that cannot be used --------------------


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["calibrat"], "No such command 'calibrat'; did you mean 'calibrate'?"),
        (["--force"], "No such option '--force'; see `tumble --help`"),
        (["calibrate"], "Missing argument 'SESSION...'; see `tumble calibrate --help`"),
        (["calibrate", "few", "--ouput", "x.json"], "No such option '--ouput'"),
        (["calibrate", "few", "--out"], "requires an argument"),
        (["calibrate", "few", "--out", ""], "expected a path, found an empty one"),
        (["calibrate", "few", "--out", "."], "is a directory"),
        (["calibrate", "few", "--out", "no/such/file.json"], "cannot be written: the folder no/such does not exist"),
        (["calibrate", "few", "--method", "jiont"], "'jiont' is not"),
        (["calibrate", "few", "--iterations", "0", "--method", "scalar"], "0 is not in the range x>=1"),
        (["calibrate", "few", "--iterations", "3"], "expected none with the method 'joint'"),
        (["calibrate", ""], "expected a path, found an empty one"),
        (["calibrate", "none"], "none: expected a session folder or its session.toml, found no such file or folder"),
        (["calibrate", "."], "session.toml: expected a session folder with a session.toml, found none; `tumble new`"),
        (["calibrate", "one/log.parquet", "two/log.parquet"], "a log among 2 arguments; positions of one"),
        (["calibrate", "one/log.parquet", "--latitude", "48,1"], "south negative, such as 48.1, found '48,1'"),
        (["export", "one/session.toml", "--to", "ros", "-o", "x"], "found text that is no JSON; is it the log?"),
        (["calibrate", "one", "two"], "--out: expected a file for the result of several sessions, found none"),
        (["calibrate", "one", "one", "--out", "x.json"], "holds the same recording as one"),
        (["calibrate", "one", "other", "--out", "x.json"], "expected a launch of device 'mems-7'"),
        (["calibrate", "one", "none", "--out", "x.json"], "none: expected a session folder or its session.toml"),
        (["calibrate", "few", "--truth", "none.json"], "none.json: expected a truth.json as `tumble simulate` writes"),
        (["calibrate", "few", "--truth", "few/session.toml"], "session.toml: expected a truth.json"),
        (["calibrate", "few", "--truth", "few/log.parquet"], "log.parquet: expected a truth.json"),
        (["plan", "--turn-rate", "1e18"], "turn_rate: expected at most 1e5 deg/s, found 1e+18"),
        (["inspect"], "Missing argument 'SESSION|LOG'"),
        (["inspect", "none"], "none: expected a session folder or its session.toml"),
        (["inspect", "one", "two"], "Got unexpected extra argument (two)"),
        (["inspect", "one", "two\nthree"], "Got unexpected extra argument (two three); see `tumble inspect --help`"),
        (["simulate"], "Missing argument 'FOLDER'"),
        (["simulate", ""], "expected a path, found an empty one"),
        (["simulate", "few", *QUICK], "few: expected a new folder, found a session in it"),
        (["simulate", "few/log.parquet", *QUICK], "log.parquet: expected a folder to write to, found: File exists"),
        (["simulate", "few/log.parquet/x", *QUICK], "expected a folder to write to, found: Not a directory"),
        (["simulate", "new", "--grade", "navigatoin"], "found 'navigatoin'; did you mean 'navigation'?"),
        (["simulate", "new", "--grade", "tactial"], "did you mean 'tactical'?"),
        (["simulate", "new", "--programme", "rough_table"], "found 'rough_table'; did you mean 'rough-table'?"),
        (["simulate", "new", "--programme", "cube14"], "did you mean 'cube-14'?"),
        (["simulate", "new", "--positions", "0"], "positions: expected at least 1, found 0"),
        (["simulate", "new", "--positions", "1" * 400], "positions: expected at most 100000, found 1.11111e+399"),
        (["simulate", "new", "--positions", "-3"], "positions: expected at least 1, found -3"),
        (["simulate", "new", "--positions", "2.5"], "'2.5' is not a valid integer"),
        (["simulate", "new", "--rest", "-1"], "rest: expected at least two samples"),
        (["simulate", "new", "--rest", "nan"], "rest: expected at least two samples"),
        (["simulate", "new", "--rest", "inf"], "rest: expected at least two samples"),
        (["simulate", "new", "--rest", "1e9"], "session: expected at most 3e+07 samples"),
        (["simulate", "new", "--turn-rate", "0"], "rate: expected more than 0, in deg/s, found 0"),
        (["simulate", "new", "--turn-rate", "-10"], "rate: expected more than 0, in deg/s, found -10"),
        (["simulate", "new", "--turn-rate", "1e-9"], "session: expected at most 3e+07 samples"),
        (["simulate", "new", "--sample-rate", "0"], "sample rate: expected more than 0, in Hz, found 0"),
        (["simulate", "new", "--sample-rate", "-50"], "sample rate: expected more than 0, in Hz, found -50"),
        (["simulate", "new", "--sample-rate", "nan"], "sample rate: expected more than 0, in Hz, found nan"),
        (["simulate", "new", "--sample-rate", "1e12"], "session: expected at most 3e+07 samples"),
        (["simulate", "new", "--table-error", "-1"], "table error: expected 0 or more, in deg, found -1"),
        (["simulate", "new", "--mounting-error", "nan"], "mounting error: expected 0 or more, in deg, found nan"),
        (["simulate", "new", "--latitude", "91"], "latitude: expected -90 to 90 degrees, found 91"),
        (["simulate", "new", "--latitude", "nan"], "latitude: expected -90 to 90 degrees, found nan"),
        (["simulate", "new", "--vibration", "0.05"], "vibration: expected AMPLITUDE@HZ in m/s^2 and Hz"),
        (["simulate", "new", "--vibration", "-1@5"], "vibration: expected AMPLITUDE@HZ in m/s^2 and Hz"),
        (["simulate", "new", "--format", "xls"], "'xls' is not one of 'csv', 'parquet'"),
        (["simulate", "new", "--seed", "-1"], "-1 is not in the range x>=0"),
        (["simulate", "new", "--seed", "one"], "'one' is not a valid integer range"),
        (["noise", "none"], "none: expected"),
        (["noise", "few/log.parquet", "--accel", "ax,ay,q", "--time", "t"], "or numbers from 1 to 7, found 'q'"),
        (["noise", "few", "--plot", "x.xyz"], "expected a file that ends in .svg, .png or .pdf"),
        (["programme"], "expected either the NAME of a programme (rough-table, "),
        (["programme", "nin"], "found 'nin'; did you mean 'nine'?"),
        (["programme", "--attitude", "NUX"], 'expected three of N S E W U D, where body X, Y, Z point, found "NUX"'),
        (["programme", "nine", "--rest", "-1"], "rest: expected a positive number"),
        (["plan", "--table-error", "-1"], "expected 0 or more"),
        (["plan", "--rest", "nan"], "expected more than 0"),
        (["plan", "cube-14", "--method", "sequential"], "expected rests with X 45° above and Y 45° below the horizon"),
        (["plan", "--want", "accel.scale=3furlong"], "expected a number and one of ppm, %"),
        (["programme", "nine", "-o", "x.xyz"], "expected a file that ends in .html, .pdf or .svg"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)  # fmt: skip
def test_bad_arguments_are_refused_in_one_line(
    made: Path, words: list[str], said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(made)
    assert said in refused(*words, below=made)


def test_a_calibration_file_is_no_log(tmp_path: Path) -> None:
    calibration().write(tmp_path / "imu.json")
    assert "expected a session or a log, found a calibration file" in refused(
        "calibrate", tmp_path / "imu.json", below=tmp_path
    )


def test_a_folder_is_simulated_whole_or_not_at_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the disk is full, no session.toml says that there is a session, and it can be tried again."""

    def no_space(*_: object) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr(pl.DataFrame, "write_parquet", no_space)
        result = run("simulate", tmp_path / "new", *QUICK)
    assert result.exit_code == 2
    assert (
        result.stderr == f"tumble: {tmp_path / 'new'}: expected a folder to write to, found: No space left on device\n"
    )
    assert not (tmp_path / "new" / "session.toml").exists()
    assert run("simulate", tmp_path / "new", *QUICK).exit_code == 0


def test_the_same_seed_gives_the_same_session_and_an_existing_one_stays(tmp_path: Path) -> None:
    for name in ("a", "b"):
        assert run("simulate", tmp_path / name, *QUICK, "--seed", "5").exit_code == 0
    assert tree(tmp_path / "a") == tree(tmp_path / "b")
    assert "found a session in it" in refused("simulate", tmp_path / "a", *QUICK, "--seed", "6", below=tmp_path)


# -------------------- truth --------------------


def test_truth_is_shown_beside_the_result(sessions: Path) -> None:
    result = run("calibrate", sessions / "one", "--truth", sessions / "one" / "truth.json")
    assert result.exit_code == 0, result.stderr
    assert "(value − truth)/u" in result.stdout
    assert "truth: 21 parameters, rms of (value − truth)/u " in result.stdout


@pytest.mark.parametrize(
    "text", ["[1]", "7", "hello", '{"accel.bias.x": "much"}', '{"accel.bias.x": NaN}', '{"accel.bias.x": true}', ""]
)
def test_a_truth_that_is_none_is_refused_before_anything_is_written(sessions: Path, text: str) -> None:
    (sessions / "truth.json").write_text(text, encoding="utf-8")
    assert "truth.json: expected" in refused(
        "calibrate", sessions / "one", "--truth", sessions / "truth.json", below=sessions
    )


def test_truth_of_other_parameters_is_left_out(sessions: Path) -> None:
    (sessions / "truth.json").write_text('{"accel.bias.x": 0.0, "mag.bias.x": 1.0}', encoding="utf-8")
    result = run("calibrate", sessions / "one", "--truth", sessions / "truth.json")
    assert "truth: 1 parameters" in result.stdout


# -------------------- where the results go --------------------


def test_results_go_to_standard_output_and_talk_to_standard_error(sessions: Path) -> None:
    result = run("calibrate", sessions / "one")
    assert result.exit_code == 0
    assert "gyro.axis" in result.stdout
    assert result.stdout.splitlines()[1] == "accepted"
    assert result.stderr == f"written to {sessions / 'one' / 'calibration.json'}\n"
    shown = run("inspect", sessions / "one")
    assert shown.exit_code == 0
    assert shown.stderr == ""
    assert "vertical in the body" in shown.stdout


def test_a_session_may_be_named_by_its_toml(sessions: Path) -> None:
    assert run("calibrate", sessions / "one" / "session.toml").exit_code == 0
    assert (sessions / "one" / "calibration.json").exists()


def test_launches_are_averaged_into_the_file_that_is_named(sessions: Path) -> None:
    out = sessions / "mean.json"
    result = run("calibrate", sessions / "one", sessions / "two", "--out", out)
    assert result.exit_code == 0, result.stderr
    assert "from launch to launch: accel.bias " in result.stdout
    assert [launch["session"] for launch in json.loads(out.read_text(encoding="utf-8"))["launches"]] == ["one", "two"]
    assert not (sessions / "one" / "calibration.json").exists()


def test_a_launch_that_is_refused_refuses_the_mean_and_is_named(sessions: Path) -> None:
    _edit(sessions / "two", lambda content: content["log"]["accel"].update(columns=["ay", "ax", "az"]))
    result = run("calibrate", sessions / "one", sessions / "two", "--out", sessions / "mean.json")
    assert result.exit_code == 1
    assert "not accepted: two: the gyros do not carry the vertical" in result.stderr


def test_reasons_are_a_few_lines_unless_all_is_asked_for(sessions: Path) -> None:
    """Clauses in the middle are left out, not what was found nor what to do; the file has every word."""
    log = sessions / "one" / "log.parquet"
    _edit(sessions / "one", lambda content: content["log"].pop("gyro"))  # with gyros it would be calibrated in motion
    pl.read_parquet(log).with_columns(ax=3.0 * pl.col("t").sin(), ay=9.0 * pl.col("t").cos()).write_parquet(log)
    result = run("calibrate", sessions / "one")
    assert result.exit_code == 1
    (whole,) = json.loads((sessions / "one/calibration.json").read_text(encoding="utf-8"))["outcome"]["reasons"]
    assert f"not accepted: {whole}\n" in run("calibrate", sessions / "one", "--all").stderr
    (shown,) = [line for line in result.stderr.splitlines() if line.startswith("not accepted: ")]
    begun, last = shown.removeprefix("not accepted: ").removesuffix(" (more: --all)").split("; …; ")
    assert len(whole) > 400
    assert 200 < len(begun) <= 300
    assert whole.startswith(f"{begun}; ")
    assert whole.endswith(f"; {last}")


def test_names_that_look_like_markup_are_shown_as_they_are(sessions: Path) -> None:
    names = ("run[red]", "run[bold]two[")
    for old, new in zip(("one", "two"), names, strict=True):
        (sessions / old).rename(sessions / new)
        _edit(sessions / new, lambda content: content["device"].update(serial="A[/red]7", model="[bold]"))
    result = run("calibrate", *(sessions / name for name in names), "--out", sessions / "mean.json", "--all")
    assert result.exit_code == 0, result.stderr
    assert "A[/red]7 ([bold])" in result.stdout
    for name in names:
        assert name in result.stdout


def _edit(folder: Path, change: Any) -> None:
    content = tomllib.loads((folder / "session.toml").read_text(encoding="utf-8"))
    change(content)
    (folder / "session.toml").write_text(tomli_w.dumps(content), encoding="utf-8")


# -------------------- sessions and logs that cannot be used --------------------


def _log(**changes: Any) -> Any:
    return lambda content: content["log"].update(changes)


def _accel(**changes: Any) -> Any:
    return lambda content: content["log"]["accel"].update(changes)


def _rest_at(start: float, stop: float) -> Any:
    position = {"attitude": "NUE", "start": start, "stop": stop}
    return lambda content: content.update(programme={"position": [position]})


# what each file may not hold is in tests/recording
@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda content: content.clear(), "device: expected the table [device], found none"),
        (lambda content: content.update(formt=1), "unknown key 'formt' at the top level; did you mean 'format'?"),
        (lambda content: content["device"].update(systematic="none.json"), "none.json, found no such file"),
        (_log(file="none.csv"), "log.file: expected a log at"),
        (_log(file="session.toml"), "session.toml: expected a file that ends in .csv"),
        (_log(time="tt"), "log.parquet: expected a column 'tt', found t, ax"),
        (_log(time_unit="ns"), "s; is the time 't' in us, "),
        (_accel(unit="count"), "log.accel.scale: expected the nominal output per unit"),
        (lambda content: content.update(programme={"name": "nin"}), "programme.name: expected one of rough-table"),
        (lambda content: content.update(programme={"name": "nine"}), "programme nine"),
        (_rest_at(1e6, 2e6), "expected"),
        (_rest_at(-20.0, -10.0), "expected"),
        (_rest_at(1.0, 1.01), "expected"),
    ],
)
@pytest.mark.parametrize("command", ["calibrate", "inspect"])
def test_a_session_that_cannot_be_used_is_refused_in_one_line(
    sessions: Path, command: str, change: Any, said: str
) -> None:
    folder = sessions / "one"
    _edit(folder, change)
    written = (folder / "session.toml").read_text(encoding="utf-8")
    if command == "inspect" and "[programme]" in written and "programme." not in said:
        assert run("inspect", folder).exit_code == 0  # it shows what was found, whatever the programme
        return
    assert said in refused(command, folder, below=sessions)


@pytest.mark.parametrize("text", [b"", b"[", b"\xff\xfe", b"format = 1", b"\x00" * 100, b"format = 1\n[log]\nfile = 3"])
def test_a_session_toml_that_is_none_is_refused_in_one_line(sessions: Path, text: bytes) -> None:
    (sessions / "one" / "session.toml").write_bytes(text)
    assert "session.toml: " in refused("calibrate", sessions / "one", below=sessions)


def _csv(folder: Path) -> list[str]:
    """The log as lines of CSV, and a session that names it."""
    pl.read_parquet(folder / "log.parquet").write_csv(folder / "log.csv")
    _edit(folder, _log(file="log.csv"))
    return (folder / "log.csv").read_text(encoding="utf-8").splitlines()


def _value(text: str) -> Any:
    """Another text in the second column of row 500."""

    def put(lines: list[str]) -> list[str]:
        values = lines[500].split(",")
        return [*lines[:500], ",".join([values[0], text, *values[2:]]), *lines[501:]]

    return put


def _clock(interval: float) -> Any:
    return lambda log: log.with_columns(pl.Series("t", np.arange(1, log.height + 1) * interval))


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (b"", "found an empty file"),
        (b"hello, world", "expected a readable .parquet file, found it damaged"),
        (lambda log: log[:20], "expected at least 50 samples, found 20"),
        (lambda log: pl.concat([log[:500], log[1:400]]), "running backwards"),
        (_clock(1e-300), "expected"),
        (_clock(1e-30), "expected"),
    ],
)
def test_a_log_that_cannot_be_used_is_refused_in_one_line(sessions: Path, spoil: Any, said: str) -> None:
    file = sessions / "one" / "log.parquet"
    if isinstance(spoil, bytes):
        file.write_bytes(spoil)
    else:
        spoil(pl.read_parquet(file)).write_parquet(file)
    for command in ("calibrate", "inspect"):
        message = refused(command, sessions / "one", below=sessions)
        assert message.startswith(f"{file}: ")
        assert said in message


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda lines: [*lines[:500], "1,2,3", *lines[500:]], "row 500"),
        (_value("-"), "row 500"),
        (_value(""), "row 500"),
        (lambda lines: [*lines[:500], lines[499], *lines[500:]], "row 500"),
        (lambda lines: [*lines[:500], *lines[600:]], "row 500"),
    ],
)  # fmt: skip
def test_a_blemish_in_a_log_is_reported_and_no_reason_to_refuse_it(sessions: Path, spoil: Any, said: str) -> None:
    folder = sessions / "one"
    (folder / "log.csv").write_text("\n".join(spoil(_csv(folder))) + "\n", encoding="utf-8")
    result = run("calibrate", folder, "--terms", "linear", "--all")
    assert result.exit_code == 0, result.output
    assert said in result.output


def test_a_log_is_inspected_as_it_is_calibrated(sessions: Path) -> None:
    """With the session that `calibrate` finds again; what cannot be read leaves nothing behind."""
    log = sessions / "log.csv"
    pl.read_parquet(sessions / "one" / "log.parquet").write_csv(log)
    seen = json.loads(run("inspect", log, "--latitude", "56.84", "--json").stdout)
    done = run("calibrate", log, "--latitude", "56.84", "--json")
    assert "log-session/session.toml: the session made earlier from this log" in done.stderr
    assert [rest["start"] for rest in seen["observations"]["rests"]] == [
        rest["start"] for rest in json.loads(done.stdout)["rests"]
    ]
    (sessions / "none.csv").write_text("no log\n", encoding="utf-8")
    assert "none.csv: " in refused("inspect", sessions / "none.csv", below=sessions)
    assert "expected one log with them" in refused("inspect", sessions / "one", "--latitude", "50", below=sessions)


def test_noise_that_is_refused_says_nothing_else(sessions: Path) -> None:
    """How the log was read is said with its result alone."""
    log = sessions / "one" / "log.csv"
    pl.read_parquet(sessions / "one" / "log.parquet").head(400).write_csv(log)
    words = "noise", log, "--accel", "ax,ay,az", "--time", "t"
    assert "accel: ax, ay, az, as stated" in run(*words).stderr
    pl.read_csv(log).head(30).write_csv(log)
    assert "expected at least 50 samples, found 30" in refused(*words, below=sessions)


# -------------------- at random --------------------

SEEDS = [*range(15), *(pytest.param(seed, marks=pytest.mark.weekly) for seed in range(15, 60))]


def _spoilt(log: pl.DataFrame, rng: np.random.Generator) -> pl.DataFrame:
    """A log with one thing wrong somewhere."""
    column = str(rng.choice(["t", *SENSORS]))
    values = log[column].to_numpy().astype(float).copy()
    first = int(rng.integers(len(values)))
    rows = slice(first, first + int(rng.choice([1, 3, 10, 300])))
    kind = rng.choice(
        ["put", "shift", "all", "ramp", "noise", "short", "thin", "int", "text", "drop", "repeat", "reverse"]
    )
    if kind == "put":
        values[rows] = rng.choice([np.nan, np.inf, -np.inf, 0.0, 1e-300, 1e8, 1e12, -1e40, 1e300])
    elif kind == "shift":
        values[rows] += rng.choice([-5.0, 0.02, 1.0, 50.0, 1e4, 1e8])
    elif kind == "all":
        values *= rng.choice([0.0, -1.0, 1e-300, 1e-9, 1e-3, 57.3, 1e3, 1e9])
    elif kind == "ramp":
        values += np.linspace(0.0, float(rng.choice([1.0, 100.0, 1e6])), len(values))
    elif kind == "noise":
        values = float(rng.choice([1e-3, 1.0, 1e3])) * rng.standard_normal(len(values))
    elif kind == "reverse":
        values = values[::-1].copy()
    log = log.with_columns(pl.Series(column, values))
    if kind == "short":
        return log[: int(rng.choice([0, 1, 60, 300, 1500]))]
    if kind == "thin":
        return log.gather_every(int(rng.choice([2, 5, 25])))
    if kind == "int":
        return log.with_columns((pl.col(column) * 1000).cast(pl.Int64, strict=False))
    if kind == "text":
        return log.with_columns(pl.col(column).cast(pl.String))
    if kind == "drop":
        return log.drop(column)
    return pl.concat([log, log]) if kind == "repeat" else log


@pytest.mark.parametrize("seed", SEEDS)
def test_no_damage_to_a_log_leads_to_a_traceback(sessions: Path, seed: int) -> None:
    """Accepted, refused with reasons that are in the file, or unusable in one line with nothing written. Warnings are
    errors, so that standard error holds nothing else."""
    folder, rng = sessions / "one", np.random.default_rng(seed)
    log = _spoilt(pl.read_parquet(folder / "log.parquet"), rng)
    log.write_parquet(folder / "log.parquet")
    assert run("inspect", folder).exit_code in (0, 1, 2)
    result = run("calibrate", folder, "--all")
    if result.exit_code == 2:
        assert re.fullmatch(r"tumble: [^\n]+\n", result.stderr)
        assert not (folder / "calibration.json").exists()
        return
    assert result.exit_code in (0, 1)
    reasons = json.loads((folder / "calibration.json").read_text(encoding="utf-8"))["outcome"]["reasons"]
    lines = result.stderr.splitlines()
    assert lines[0].startswith("written to ")
    assert lines[1:] == [f"not accepted: {reason}" for reason in reasons]
    assert (result.exit_code == 0) == (not reasons)


VALUES: tuple[Any, ...] = (
    "", "x", 0, -1, 1e308, 1e-320, True, [], [1], {}, "NUE", "rad/s", "count", "g", "m/s", 32768.0, 49.0, "ms",
    float("nan"), float("inf"), ["ax", "ay", "az", "gx"], ["gx", "gy", "gz"], ["ax", "ay", "t"], "log.parquet",
    ["log.parquet", "log.parquet"], "nine", "rough-table", [[0, 1, 0], [1, 0, 0], [0, 0, 1]], [[1, 0, 0]] * 3,
)  # fmt: skip


@pytest.mark.parametrize("seed", SEEDS)
def test_no_value_in_session_toml_leads_to_a_traceback(sessions: Path, seed: int) -> None:
    folder, rng = sessions / "few", np.random.default_rng(seed)
    content = tomllib.loads((folder / "session.toml").read_text(encoding="utf-8"))
    log = content["log"]
    tables = [content, content["device"], content["site"], log, log["accel"], log["gyro"]]
    table = tables[int(rng.integers(len(tables)))]
    known = [
        "scale",
        "offset",
        "axes",
        "range",
        "scale_per",
        "rate_hz",
        "time_unit",
        "programme",
        "systematic",
        "model",
    ]
    key = str(rng.choice([*table, *known]))
    table[key] = VALUES[int(rng.integers(len(VALUES)))]
    (folder / "session.toml").write_text(tomli_w.dumps(content), encoding="utf-8")
    for command in ("calibrate", "inspect"):
        result = run(command, folder)
        assert result.exit_code in (0, 1, 2)
        if result.exit_code == 2:
            assert re.fullmatch(r"tumble: [^\n]+\n", result.stderr)
            assert not (folder / "calibration.json").exists()


# -------------------- the program as it is installed --------------------


def program(*words: object, **settings: Any) -> subprocess.CompletedProcess[str]:
    """A run of `python -m tumble` in a process of its own."""
    command = [sys.executable, "-m", "tumble", *map(str, words)]
    return subprocess.run(command, stderr=subprocess.PIPE, text=True, encoding="utf-8", check=False, **settings)


def test_the_exit_status_tells_accepted_from_refused_from_unusable(sessions: Path) -> None:
    statuses = []
    for name in ("one", "few", "none"):
        done = program("calibrate", sessions / name, stdout=subprocess.PIPE)
        statuses.append(done.returncode)
        assert "Traceback" not in done.stderr
        assert "Warning" not in done.stderr
    assert statuses == [0, 1, 2]


def test_a_terminal_without_greek_gets_question_marks_and_no_traceback(sessions: Path) -> None:
    settings = os.environ | {"PYTHONIOENCODING": "ascii"}
    done = program("calibrate", sessions / "one", stdout=subprocess.PIPE, env=settings)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("device mems-7 ? method joint ? frame accelerometer")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is always full")
def test_an_output_that_cannot_be_written_is_said_in_one_line(sessions: Path) -> None:
    with Path("/dev/full").open("w") as full:
        done = program("inspect", sessions / "few", stdout=full)
    assert done.returncode == 2
    assert done.stderr == "tumble: standard output: No space left on device\n"


# -------------------- for other programs, and for narrow terminals --------------------


def test_results_are_printed_as_data(sessions: Path) -> None:
    """The content of the calibration file, and what the tables of the others say."""
    done = run("calibrate", sessions / "one", "--json", "--force")
    assert json.loads(done.stdout) == json.loads((sessions / "one/calibration.json").read_text(encoding="utf-8"))
    seen = json.loads(run("inspect", sessions / "one", "--json").stdout)
    observed = seen["observations"]
    assert [rest["start"] for rest in observed["rests"]] == [rest["start"] for rest in json.loads(done.stdout)["rests"]]
    assert len(observed["turns"]) == len(observed["rests"]) - 1
    file = sessions / "one/calibration.json"
    compared = json.loads(run("compare", file, file, "--json").stdout)
    assert compared["verdict"] == "accepted"
    assert {each["value"] for each in compared["differences"]} == {0.0}


def test_quiet_leaves_results_reasons_and_errors(sessions: Path) -> None:
    words = "calibrate", sessions / "one", "--terms", "linear"
    assert "written to" in run(*words).stderr
    assert run("-q", *words).stderr == run(*words, "--quiet").stderr == run("calibrate", "-q", *words[1:]).stderr == ""
    assert run("-q", *words).stdout == run(*words).stdout
    assert "not accepted: " in run("-q", "calibrate", sessions / "few").stderr
    assert run("-q", "calibrate", sessions / "none").stderr.startswith("tumble: ")


def test_a_log_is_calibrated_without_a_session(sessions: Path) -> None:
    """As through `tumble new`; how it was read is said with --all. A log that cannot be used leaves nothing."""
    log = shutil.copy(sessions / "one/log.parquet", sessions / "mine.parquet")
    done = run("calibrate", log, "--latitude", "56.84", "--serial", "A-7", "--terms", "linear", "--json", "--all")
    assert done.exit_code == 0, done.stderr
    assert json.loads(done.stdout)["device"]["serial"] == "A-7"
    assert "time: column 't' in s" in done.stderr
    kept = {"session.toml", "calibration.json", "made.json"}
    assert {path.name for path in (sessions / "mine-session").iterdir()} == kept
    again = run("calibrate", log, "--latitude", "56.84", "--serial", "A-7", "--terms", "linear", "--json")
    assert again.exit_code == 0, again.stderr
    once, twice = (json.loads(each.stdout) for each in (done, again))
    assert {**twice["provenance"], "created": ""} == {**once["provenance"], "created": ""}
    assert {**twice, "provenance": ""} == {**once, "provenance": ""}
    anew = run("calibrate", log, "--latitude", "50", "--terms", "linear", "--json")
    assert "new session, as options or the version of tumble differ" in anew.stderr
    assert json.loads(anew.stdout)["device"]["serial"] == "mine"
    (sessions / "letter.txt").write_text("Dear all,", encoding="utf-8")
    assert "expected rows of readings" in refused(
        "calibrate", sessions / "letter.txt", "--latitude", "50", below=sessions
    )
    assert "they stand in its session.toml" in refused(
        "calibrate", sessions / "one", "--latitude", "50", below=sessions
    )


def test_a_stream_is_no_path(sessions: Path) -> None:
    made = run("calibrate", sessions / "one", "--quiet").exit_code
    assert made == 0
    for words in (("export", sessions / "one" / "calibration.json", "--to", "px4", "-o", "-"), ("calibrate", "-")):
        assert "expected a path, found '-', and no stream is read or written" in refused(*words, below=sessions)
    assert "did you mean 'px4'?" in refused(
        "export", sessions / "one" / "calibration.json", "--to", "PX4", "-o", sessions / "x", below=sessions
    )


def test_a_recording_that_is_there_twice_is_refused(sessions: Path) -> None:
    """Which would make u too small; as a folder of a log and a copy of it."""
    (sessions / "logs").mkdir()
    for name in ("a", "b"):
        shutil.copy(sessions / "one" / "log.parquet", sessions / "logs" / f"{name}.parquet")
    said = refused("calibrate", sessions / "logs", "--latitude", 50, below=sessions)
    assert "b.parquet: holds the same recording as" in said
    said = refused("calibrate", sessions / "logs" / "a.parquet", 50, below=sessions)
    assert said == "50: expected a session or a log, found no such file or folder"


def test_who_wrote_no_session_toml_is_told_where_its_tables_are(sessions: Path) -> None:
    log = sessions / "log.parquet"
    pl.read_parquet(sessions / "one" / "log.parquet").drop("t").write_parquet(log)
    done = run("calibrate", log, "--latitude", 50, "--sample-rate", 50)
    assert "in [log], 0 where it is exact" in " ".join(done.stdout.split())
    assert f"; names in [ ] are tables of {sessions / 'log-session'}/session.toml" in " ".join(done.stdout.split())
    shutil.rmtree(sessions / "log-session")
    said = refused("calibrate", log, "--latitude", 50, "--sample-rate", 50, "--frame", "case", below=sessions)
    assert "[programme]" in said
    assert said.endswith("; names in [ ] are tables of a session.toml, which `tumble new SESSION LOG` writes")


def test_a_stated_rate_that_contradicts_the_times_is_taken_and_said(sessions: Path) -> None:
    """The recording has 50 samples per second."""
    log, shown = shutil.copy(sessions / "one/log.parquet", sessions / "mine.parquet"), []
    for rate in ("45", "50"):
        done = run("calibrate", log, "--latitude", "56.84", "--terms", "linear", "--sample-rate", rate)
        assert done.exit_code == 0, done.stderr
        shown.append(" ".join(done.stdout.split()))
    assert "--sample-rate 45 is taken as stated, but the times in 't' show 50 per second" in shown[0]
    assert "is taken as stated" not in shown[1]


LISTED = main.list_commands(click.Context(main))


@pytest.mark.parametrize("name", LISTED)
def test_examples_in_the_help_are_commands(name: str) -> None:
    lines = (dict(ALL)[(name,)].epilog or "").removeprefix("\b\nExamples:\n").splitlines()
    assert lines
    for line in lines:
        program, *words = shlex.split(line)
        assert program == "tumble"
        command: click.Command = main
        while isinstance(command, click.Group):
            part = command.get_command(click.Context(command), words.pop(0))
            assert part is not None
            command = part
        with command.make_context(name, words):
            pass


def test_every_command_is_listed_with_its_first_sentence() -> None:
    modules = [module.name for module in pkgutil.iter_modules(tumble.commands.__path__, "tumble.commands.")]
    modules += ["tumble.lab.commands", "tumble.bench.commands"]
    known = [value for module in modules for value in vars(importlib.import_module(module)).values()]
    every = [command for command in known if isinstance(command, click.Command)]
    parts = [part for command in every for part in getattr(command, "commands", {}).values()]
    assert sorted(str(command.name) for command in every if command not in parts) == sorted(LISTED)
    shown = " ".join(run("--help").stdout.split())
    for words, command in ALL:
        if len(words) == 1:
            assert f" {words[0]} {first_sentence(command.help or '')}" in shown


@pytest.mark.parametrize("width", [60, 80])
def test_no_number_is_cut_on_a_narrow_terminal(width: int, sessions: Path) -> None:
    observed = inspect_session(sessions / "one")
    shown, wide = (text_of(inspection_blocks(observed), columns) for columns in (width, 200))
    assert max(map(len, shown.splitlines())) <= width
    assert "…" not in shown
    number = re.compile(r"[-+]?[0-9]+[.][0-9]+")
    assert set(number.findall(wide)) <= set(number.findall(shown))
