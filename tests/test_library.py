"""The library: names that type checkers and dir() see, a quick start, results that show themselves."""

from __future__ import annotations

import inspect
import json
import os
import pickle
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import fields, replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any, get_args, get_type_hints

import numpy as np
import polars as pl
import pytest

import tumble
import tumble.types
from tests.support import ROOT
from tests.support.calibrated import of_device
from tests.support.shared import calibrated, session
from tumble.errors import InputError
from tumble.inference.estimate import Outcome
from tumble.planning.setup import Setup
from tumble.recording.arrays import session_of_arrays
from tumble.result.parts import Evidence, Provenance

MOMENTS = np.arange(300).astype("datetime64[ms]")
CACHE = ROOT / ".mypy_cache" / "user"


@pytest.fixture(scope="module")
def calibration() -> tumble.Calibration:
    return calibrated(Setup.of(grade="mems", positions=12, rest=3.0), seed=4, words={"terms": "linear"})


# -------------------- names --------------------


def run(code: str) -> str:
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return done.stdout


def test_import_loads_neither_numpy_nor_scipy() -> None:
    heavy = "{'numpy', 'scipy', 'polars', 'pydantic', 'matplotlib'}"
    assert run(f"import sys, tumble; dir(tumble); print(sorted({heavy} & set(sys.modules)))") == "[]\n"
    assert run(f"import sys, tumble.cli; print(sorted({heavy} & set(sys.modules)))") == "[]\n"


def test_dir_shows_the_public_names() -> None:
    assert set(dir(tumble)) == set(tumble.__all__)
    assert "SensorArrays" in dir(tumble.types)
    for name in tumble.__all__:
        assert getattr(tumble, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'calibrat'"):
        tumble.calibrat  # type: ignore[attr-defined]  # noqa: B018


def checked(tmp_path: Path, code: str) -> str:
    """What mypy says of a user's file."""
    (tmp_path / "user.py").write_text(code)
    options = ["--strict", "--config-file=", "--follow-imports=silent", f"--cache-dir={CACHE}"]
    environment = {"MYPYPATH": str(ROOT / "src"), "PATH": ""}
    mypy = [sys.executable, "-m", "mypy", *options, "user.py"]
    return subprocess.run(mypy, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False).stdout


@pytest.mark.weekly
def test_a_type_checker_catches_a_wrong_call(tmp_path: Path) -> None:
    said = checked(
        tmp_path,
        "import tumble\n"
        'tumble.calibrate(42, metod="joint")\n'
        "tumble.calibrat()\n"
        'tumble.read_calibration("a.json").tabel()\n'
        "n: int = tumble.read_calibration(7)\n",
    )
    assert re.search(r"user.py:2: error: Argument 1 to \"calibrate\" has incompatible type", said), said
    assert re.search(r'user.py:3: error: Module has no attribute "calibrat"', said), said
    assert re.search(r'user.py:4: error: "Calibration" has no attribute "tabel"', said), said
    assert re.search(r"user.py:5: error: Incompatible types in assignment", said), said
    assert re.search(r"user.py:5: error: Argument 1 to \"read_calibration\"", said), said


@pytest.mark.weekly
def test_a_type_checker_knows_every_public_name_and_accepts_right_calls(tmp_path: Path) -> None:
    names = ", ".join(name for name in tumble.__all__ if name != "__version__")
    said = checked(
        tmp_path,
        f"from tumble import {names}\n"
        "from pathlib import Path\n"
        "import numpy as np\n"
        "import polars as pl\n"
        "import tumble\n"
        "a: tumble.Calibration = tumble.calibrate(Path('session'), method='ellipsoid')\n"
        "b = tumble.calibrate(accel=np.ones((9, 3)), gyro=pl.DataFrame(), rate=100.0, latitude=1.0)\n"
        "p: tumble.Parameter = b['accel.bias.x']\n"
        "v: tumble.FieldCheck = tumble.check_calibration('a.json', 'check')\n"
        "c: tumble.Comparison = tumble.compare_calibrations(a, 'b.json')\n"
        "f: pl.DataFrame = a.to_polars()\n"
        "print(a.outcome.accepted, a.table(), p.value, v.reasons, c.agree, f)\n",
    )
    assert said.startswith("Success"), said


FUNCTIONS = [name for name in tumble.__all__ if inspect.isfunction(getattr(tumble, name))]
TYPED_ELSEWHERE = ("Data | None", "NoiseDensities | Session | FilePath | None")
"""Annotations with a type that is there for type checkers alone."""


@pytest.mark.parametrize("name", FUNCTIONS)
def test_arguments_of_another_type_are_refused_in_one_line(name: str) -> None:
    function, of = getattr(tumble, name), inspect.Parameter
    parameters = inspect.signature(function).parameters
    named = [each for each in parameters.values() if each.kind is not of.VAR_KEYWORD]
    needed = dict.fromkeys([p.name for p in named if p.default is of.empty and p.kind is not of.VAR_POSITIONAL], "x")
    for p in named:
        if p.annotation in TYPED_ELSEWHERE:
            continue
        args, kwargs = ([], needed | {p.name: Stranger()}) if p.kind is not of.VAR_POSITIONAL else ([Stranger()], {})
        with pytest.raises(InputError, match=f"^({'|'.join(parameters)}): expected .*, found (Stranger|'x')") as caught:
            function(*args, **kwargs)
        assert "\n" not in str(caught.value)


class Stranger:
    """Of no type that anything takes."""


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (
            lambda: tumble.calibrate_launches("x"),
            r"sessions: expected several, each Session or a path, found 'x'",
        ),
        (lambda: tumble.noise_of(np.zeros((9, 3))), r"recordings: expected .*, found ndarray"),  # type: ignore[arg-type]
        (lambda: tumble.calibrate("x", without=3), "without: expected several, each a whole"),  # type: ignore[arg-type]
        (
            lambda: tumble.calibrate_readings(np.zeros((9, 2))),
            r"readings: expected an array \(N, 3\), .* shape \(9, 2\)",
        ),
        (
            lambda: tumble.normal_gravity(56.8, 0.0),
            r"latitude: expected radians from -π/2 to π/2, found 56\.8; for deg",
        ),
        (lambda: tumble.normal_gravity("a", 0.0), r"latitude: expected a number, found 'a'"),  # type: ignore[arg-type]
    ],
)
def test_what_is_no_session_no_table_and_no_latitude_is_said(call: Callable[[], object], said: str) -> None:
    with pytest.raises(InputError, match=said):
        call()


def test_numbers_and_sequences_of_numpy_are_taken() -> None:
    assert tumble.normal_gravity(np.float32(0.5), np.int64(0)) == pytest.approx(tumble.normal_gravity(0.5, 0.0))  # type: ignore[arg-type]
    with pytest.raises(InputError, match="nowhere"):
        tumble.calibrate("nowhere", without=np.array([1, 2]))


def test_a_table_of_readings_may_be_an_array(tmp_path: Path) -> None:
    rows = np.array([[0, 0, 1.0], [0, 0, -1], [0, 1, 0], [0, -1, 0], [1, 0, 0], [-1, 0, 0.5]])
    rows = np.vstack([rows, [[0.6, 0.8, 0], [0.6, -0.8, 0], [0, 0.6, 0.8], [0, 0.6, -0.8], [0.8, 0, 0.6]]])
    (tmp_path / "readings.csv").write_text("x,y,z\n" + "\n".join(",".join(map(str, row)) for row in rows.tolist()))
    of_array, of_file = (tumble.calibrate_readings(r, unit="g") for r in (rows, tmp_path / "readings.csv"))
    assert of_array.calibration.parameters == of_file.calibration.parameters


HELD = [tumble.Comparison, tumble.Corrected, tumble.Exported, tumble.FieldCheck, tumble.Observed, tumble.Plan]


@pytest.mark.parametrize("held", [*HELD, tumble.Programme, tumble.Session, tumble.Setup, tumble.types.RecordedNoise])
def test_what_a_user_holds_shows_itself_in_a_line_and_in_a_table(held: type) -> None:
    names = [each.name for each in fields(held) if each.repr]
    shown: Any = object.__new__(held)
    for name in names:
        object.__setattr__(shown, name, np.zeros((1000, 3)) if name == names[0] else "<script>" * 10)
    assert repr(shown).startswith(f"{held.__name__}({names[0]}=array(1000, 3)")
    assert "\n" not in repr(shown)
    html = shown._repr_html_()
    assert f"<tr><th>{names[0]}</th><td>array(1000, 3)</td></tr>" in html
    assert "<script>" not in html


# -------------------- equality --------------------


def test_results_can_be_compared(calibration: tumble.Calibration) -> None:
    again, other = replace(calibration), of_device(calibration, serial="another")
    assert calibration == again
    assert calibration != other
    assert len({calibration, again, other}) == 2


# -------------------- a calibration shows itself --------------------


def test_repr_is_a_line(calibration: tumble.Calibration) -> None:
    assert repr(calibration) == "<Calibration of mems-4: joint, 21 parameters, accepted>"
    refused = replace(calibration, outcome=Outcome(reasons=("too few rests",)))
    assert repr(refused) == "<Calibration of mems-4: joint, 21 parameters, not accepted>"


def test_the_table_has_a_row_for_every_parameter_rounded_by_its_uncertainty(calibration: tumble.Calibration) -> None:
    lines = calibration.table().splitlines()
    rows = {line.split()[0]: line.split() for line in lines[2:] if not line.startswith("note: ")}
    assert set(rows) == {p.name for p in calibration.parameters}
    bias = calibration["accel.bias.x"]
    assert bias.u is not None
    _, value, u, expanded, unit, *_ = rows["accel.bias.x"]
    assert unit in ("µg", "mg")
    size = 9.80665e-6 if unit == "µg" else 9.80665e-3
    assert float(value) * size == pytest.approx(bias.value, abs=bias.u)
    assert float(expanded) == pytest.approx(2.0 * float(u), rel=0.1)


def test_tables_of_a_file_that_was_not_written_are_told_in_words_of_arguments(calibration: tumble.Calibration) -> None:
    where = "names in [ ] are tables of session.toml; for arrays use the argument of that name without unit"
    noted = replace(calibration, provenance=replace(calibration.provenance, notes=("state grade in [device]",)))
    assert f"note: {where}" in noted.table()
    assert where in str(tumble.InputError("[site]: expected latitude_deg, found none"))
    assert where not in str(tumble.InputError("session.toml: expected the table [device], found none"))


class Text(HTMLParser):
    """What a page says, and its tags."""

    def __init__(self) -> None:
        super().__init__()
        self.said: list[str] = []
        self.tags: list[str] = []

    def handle_data(self, data: str) -> None:
        self.said.append(data)

    def handle_starttag(self, tag: str, attrs: Any) -> None:  # noqa: ARG002
        self.tags.append(tag)


def test_html_is_escaped(calibration: tumble.Calibration) -> None:
    page = Text()
    evil = replace(
        calibration,
        device=replace(calibration.device, serial="<script>alert(1)</script>"),
        outcome=Outcome(reasons=("a < b & c",)),
    )
    page.feed(evil._repr_html_())
    assert "script" not in page.tags
    assert "a < b & c" in page.said
    assert page.tags.count("tr") == 1 + len(calibration.parameters)


def test_a_polars_frame_has_the_parameters_in_si(calibration: tumble.Calibration) -> None:
    frame = calibration.to_polars()
    assert frame["value"].to_list() == [p.value for p in calibration.parameters]
    assert frame["u"].to_list() == [p.u for p in calibration.parameters]
    assert frame.schema["deviation"] == pl.Float64


# -------------------- apply --------------------


def test_arrays_lists_and_frames_are_corrected_alike(calibration: tumble.Calibration) -> None:
    readings = np.array([[0.1, 0.2, 9.8], [9.8, 0.0, 0.1]])
    expected, none = calibration.apply(readings)
    assert none is None
    for given in (readings.tolist(), pl.DataFrame(readings, schema=["ax", "ay", "az"])):
        np.testing.assert_array_equal(calibration.apply(given)[0], expected)
    np.testing.assert_allclose(calibration.apply(readings[0])[0], expected[0], rtol=1e-15, atol=1e-15)


@pytest.mark.parametrize(
    ("accel", "gyro", "dt", "expected"),
    [
        (np.ones((5, 4)), None, None, "accel readings: expected 3 numbers a sample, one for each sensor"),
        (np.ones((5, 3)), np.ones((3, 5)), None, "gyro readings: expected 3 numbers a sample"),
        (np.full((5, 3), np.nan), None, None, "accel: expected finite numbers, found nan in sample 0 of sensor 0"),
        (
            pl.DataFrame({"ax [g]": [1.0], "b": [0.0], "c": [0.0]}),
            None,
            None,
            "expected m/s^2, found a column 'ax [g]'",
        ),
        ([["x", "y", "z"]], None, None, "accel: expected an array of numbers, found list"),
        ([["1.0", "0.0", "9.8"]], None, None, "accel: expected an array of numbers, found list: it has text"),
        (np.full((5, 3), "1.0"), None, None, "accel: expected an array of numbers, found ndarray: it has text"),
        (pl.DataFrame({"x": ["1.0"], "y": [0.0], "z": [0.0]}), None, None, "found DataFrame: it has text; convert"),
        (np.ones((5, 3)), None, [b"0.01"] * 5, "dt: expected an array of numbers, found list: it has text"),
        (np.ones((5, 3)), None, np.ones(4), "dt: expected a number for each sample, (5,), found the shape (4,)"),
    ],
)
def test_readings_that_do_not_fit_are_refused(
    calibration: tumble.Calibration, accel: Any, gyro: Any, dt: Any, expected: str
) -> None:
    with pytest.raises(InputError, match=re.escape(expected)):
        calibration.apply(accel, gyro, dt=dt)


def test_a_calibration_is_a_mapping_of_its_parameters(calibration: tumble.Calibration) -> None:
    assert list(calibration) == [parameter.name for parameter in calibration.parameters]
    assert len(calibration) == len(calibration.parameters)
    assert dict(calibration)["accel.bias.x"] is calibration["accel.bias.x"]
    assert "accel.bias.x" in calibration
    assert "accel.bias.w" not in calibration
    with pytest.raises(KeyError, match=r"no parameter 'accel\.bais\.x'; did you mean 'accel\.bias\.x'\?"):
        calibration["accel.bais.x"]
    with pytest.raises(KeyError, match=r"no parameter 'q'; there are accel\.bias\.x, "):
        calibration["q"]


def test_a_calibration_equals_its_copy_and_its_file(calibration: tumble.Calibration, tmp_path: Path) -> None:
    calibration.write(tmp_path / "c.json")
    for copy in (pickle.loads(pickle.dumps(calibration)), tumble.read_calibration(tmp_path / "c.json")):
        assert copy == calibration
        assert hash(copy) == hash(calibration)
    assert calibration != of_device(calibration, serial="another")


def test_a_refused_calibration_says_why_it_has_no_parameters(calibration: tumble.Calibration) -> None:
    refused = replace(
        calibration, parameters=(), covariance=None, accel=None, outcome=tumble.Outcome(reasons=("no rests",))
    )
    assert not refused.outcome
    with pytest.raises(KeyError, match="not calibrated: no rests"):
        refused["accel.bias.x"]
    with pytest.raises(tumble.InputError, match="expected accepted accelerometers or gyros, found: no rests"):
        refused.apply(np.tile([0.0, 0.0, 9.8], (4, 1)))


def test_a_parameter_that_is_not_known_is_refused(calibration: tumble.Calibration, tmp_path: Path) -> None:
    content = calibration.content()
    content["parameters"][0] |= {"name": "accel.hum.x"}
    (tmp_path / "c.json").write_text(json.dumps(content))
    with pytest.raises(tumble.InputError, match=r"this version of tumble knows, found 'accel\.hum\.x'"):
        tumble.read_calibration(tmp_path / "c.json")


@pytest.mark.parametrize("dt", [0.0, -0.01])
def test_intervals_that_are_not_positive_are_refused(calibration: tumble.Calibration, dt: float) -> None:
    with pytest.raises(tumble.InputError, match="expected intervals above 0 s"):
        calibration.apply(np.tile([0.0, 0.0, 0.098], (4, 1)), dt=dt)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"accel": None, "rate": 100.0}, "accel: expected readings"),
        ({"accel": np.ones((300, 2)), "rate": 100.0}, r"found the shape \(300, 2\)$"),
        ({"accel": np.ma.masked_equal(np.tile([1.0, 2.0, 9.0], (300, 1)), 1.0), "rate": 100.0}, "300 that are masked"),
        (
            {"accel": np.tile([0.0, 0.0, 9.8], (300, 1)), "time": np.arange(300).astype("datetime64[ms]")},
            r"time: expected numbers, found datetime64\[ms\]; give seconds",
        ),
        (
            {"accel": np.tile([0.0, 0.0, 9.8 + 0j], (300, 1)), "rate": 100.0},
            "accel: expected numbers, found complex128",
        ),
        (
            {"accel": np.tile([0.0, 0.0, 9.8], (300, 1)), "rate": 100.0, "terms": "all"},
            "terms: expected full or linear",
        ),
    ],
)
def test_readings_that_mean_nothing_are_refused(given: dict[str, Any], message: str) -> None:
    with pytest.raises(tumble.InputError, match=message):
        tumble.calibrate(**given)


@pytest.mark.parametrize(
    "time",
    [
        pl.Series(MOMENTS),
        pl.Series(MOMENTS - MOMENTS[0]),
        pl.DataFrame({"t": MOMENTS}),
        lambda pd: pd.Series(MOMENTS),
        lambda pd: pd.Series(MOMENTS).dt.tz_localize("UTC"),
        lambda pd: pd.DatetimeIndex(MOMENTS),
    ],
)
def test_moments_and_durations_of_frames_are_refused(time: Any) -> None:
    given = time(pytest.importorskip("pandas")) if callable(time) else time
    with pytest.raises(tumble.InputError, match=r"^time: expected numbers, found .*; give seconds: .t - t.0.. ?[/.]"):
        tumble.calibrate(accel=np.tile([0.0, 0.0, 9.8], (300, 1)), time=given)


def test_numbers_of_rests_may_be_numpys() -> None:
    session = session_of_arrays(accel=np.tile([0.0, 0.0, 9.8], (300, 1)), rate=100.0)
    assert [each.rest for each in session.without(np.array([3])).excluded] == [3]


@pytest.mark.parametrize("wrong", [{"rest": -5.0}, {"rate_deg_s": 0.0}, {"table_error_deg": -1.0}, {"positions": 0}])
def test_a_set_up_of_nothing_is_refused(wrong: dict[str, Any], tmp_path: Path) -> None:
    with pytest.raises(tumble.InputError, match="expected"):
        tumble.simulate_session(tmp_path / "new", tumble.Setup.of(**wrong), seed=1)


def test_errors_name_arguments_to_callers_and_options_at_the_command_line() -> None:
    error = tumble.InputError("--gravity-u: expected --gravity with it, found it alone")
    assert str(error) == "gravity_u: expected gravity with it, found it alone"
    assert error.for_command_line.startswith("--gravity-u")


def test_results_show_themselves_in_a_line(calibration: tumble.Calibration) -> None:
    for result in (calibration, tumble.Setup.of(), tumble.plan(tumble.Setup.of()), calibration.outcome):
        assert len(repr(result)) < 700


def test_every_type_of_a_public_signature_can_be_imported() -> None:
    public = {getattr(tumble, name) for name in dir(tumble) if isinstance(getattr(tumble, name), type)}
    public |= {getattr(tumble.types, name) for name in vars(tumble.types)["__all__"]}
    missing = {
        f"{own.__module__}.{own.__name__}"
        for each in (tumble.Calibration, Evidence, Provenance, tumble.Session, tumble.Comparison, tumble.FieldCheck)
        for hint in get_type_hints(each).values()
        for own in (hint, *get_args(hint))
        if isinstance(own, type) and own.__module__.startswith("tumble") and own not in public
    }
    assert not missing


_FORKED = """
import multiprocessing, sys
import tumble

def again(_):
    return repr(tumble.calibrate(sys.argv[1], method="joint"))

if __name__ == "__main__":
    tumble.calibrate(sys.argv[1], method="joint")
    with multiprocessing.get_context("fork").Pool(1) as pool:
        pool.map(again, [0])
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="processes do not fork here")
def test_a_process_forked_after_a_calibration_says_that_it_cannot_read(tmp_path: Path) -> None:
    folder = session(tumble.Setup.of(grade="mems", positions=9, rest=2.0), seed=1)
    (tmp_path / "forked.py").write_text(_FORKED)
    words = [sys.executable, str(tmp_path / "forked.py"), str(folder)]
    ended = subprocess.run(words, capture_output=True, text=True, timeout=120, check=False)
    assert ended.returncode == 1
    assert "was forked from one that had read logs" in ended.stderr


# -------------------- arguments that mean nothing --------------------


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda c: c.apply(None), "^accel: expected an array of numbers, found NoneType"),
        (lambda c: c.write(3), "^path: expected a path, found 3"),
        (lambda c: c.in_frame(3), "^frame: expected text, found 3"),
        (lambda c: c.accel.apply("ab"), "^readings: expected an array of numbers, found str"),
        (lambda c: c.accel.apply(np.ones((2, 2))), r"^readings: expected the shape \(\.\.\., 3\), .*found \(2, 2\)"),
        (lambda c: tumble.Corrector(c, sample_rate="200"), "^sample_rate: .*'200'; see help.tumble.Corrector.$"),  # type: ignore[arg-type]
        (lambda c: tumble.Corrector(c).add("a", "b"), "^accel readings: expected an array of numbers, found str"),
        (lambda c: tumble.check_calibration(c, "nowhere"), "^nowhere: expected the folder of a session or a table"),
        (
            lambda _: tumble.calibrate(accel=np.tile([0.0, 0.1, 0.0, 9.8], (300, 1)), rate=100.0),
            "^accel: expected three columns, found 4; choose three without times",
        ),
        (
            lambda _: tumble.plan(Setup.of(), wanted={"accel.scale": "200ppm"}),  # type: ignore[dict-item]
            "^wanted: expected a mapping of names to a number or None, found {'accel.scale': '200ppm'}",
        ),
        (lambda _: tumble.simulate_session("new", Setup.of(), seed=-1), "^seed: expected 0 or more, found -1"),
        (lambda _: Setup.of(rest="5"), "^rest: expected a number or None, found '5'; see help.tumble.Setup.of.$"),  # type: ignore[arg-type]
        (lambda _: Setup.of(positions=-1), "^positions: expected at least 1, found -1"),
        (lambda _: tumble.plan(Setup.of(sample_rate=-1.0)), "^sample_rate: expected more than 0"),
        (lambda _: Setup.of(noise_factor=-1.0), "^noise_factor: expected 0 or more"),
    ],
)
def test_what_means_nothing_is_refused_in_a_line(
    calibration: tumble.Calibration, call: Callable[[Any], object], said: str
) -> None:
    with pytest.raises(InputError, match=said) as caught:
        call(calibration)
    assert "\n" not in str(caught.value)


def test_a_binary_file_is_no_calibration(tmp_path: Path) -> None:
    np.savez(tmp_path / "readings.npz", accel=np.full(9, 0.1))
    with pytest.raises(InputError, match=r"expected UTF-8 text, found a binary file$"):
        tumble.read_calibration(tmp_path / "readings.npz")
