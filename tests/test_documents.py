"""Documents that are damaged: one line that says what and where, and nothing that does something to a terminal."""

from __future__ import annotations

import copy
import json
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

from tests.support.registry_files import content
from tumble.documents import LONGEST_LINE, as_json, json_of, one_line, plain, toml_of
from tumble.errors import CalibrationError, InputError, SessionError
from tumble.recording.session_file import read_session, session_of
from tumble.result.calibration import calibration_of

LOG = {"file": "log.csv", "rate_hz": 100.0, "accel": {"columns": ["ax", "ay", "az"], "unit": "g"}}


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("x = " + "1" * 5000, "a number or a nesting without measure"),
        ("x = " + "[" * 5000, "a number or a nesting without measure"),
        ("x = 2026-13-45", "an error in its syntax"),
        ("x = '\x1b[31m'", "an error in its syntax"),
    ],
)
def test_toml_without_measure_is_one_line(text: str, said: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=rf"^file: expected TOML, found {said}") as caught:
        toml_of(text, "file")
    assert "\n" not in str(caught.value)
    (tmp_path / "session.toml").write_text(text, encoding="utf-8")
    with pytest.raises(SessionError, match=said):
        read_session(tmp_path)


@pytest.mark.parametrize("text", ["1" * 5000, "[" * 100_000, "[NaN]", "[Infinity]", "{", "²"])
def test_json_without_measure_is_a_value_error(text: str) -> None:
    with pytest.raises(ValueError, match=r"^[^\n]+$"):
        json_of(text)


def test_what_moves_a_cursor_is_not_shown() -> None:
    assert plain("A\x1b[31m\u202eB\nC\x9b\ud800") == "A\ufffd[31m\ufffdB\nC\ufffd\ufffd"
    assert plain("27 °/h, χ² – 3 µg") == "27 °/h, χ² – 3 µg"


def test_a_message_is_one_line_that_can_be_read() -> None:
    line = one_line("expected\na number, found " + "9" * 5000 + "; correct it")
    assert len(line) < 250
    assert line.startswith("expected a number, found 999")
    assert line.endswith("999; correct it")
    assert len(one_line("word " * 5000)) == LONGEST_LINE


@pytest.mark.parametrize("serial", ["A\x1b[31m7", "A\n7", "A\u202e7", " ", "A" * 201])
def test_a_serial_number_is_printable(serial: str) -> None:
    with pytest.raises(SessionError, match=r"device\.serial: expected 1 to 200 printable characters") as caught:
        session_of({"format": 1, "device": {"serial": serial}, "log": LOG})
    assert str(caught.value).isprintable()


REST = {"start": 0.0, "stop": 1.0, "residual": 0.0}
READ = {"columns": ["x", "y", "z"], "unit": "m/s^2", "increments": False, "scale": [1.0] * 3, "offset": [0.0] * 3}
TURN = {"first": 0, "last": 1, "duration": 1.0, "angle": None, "programmed": None, "sigmas": 0.0}


def test_a_turn_between_rests_that_are_not_there_is_named() -> None:
    whole = content() | {"rests": [REST], "turns": [TURN]}
    with pytest.raises(CalibrationError, match=r"turns\[1\]: expected two of 1 rests, in their order"):
        calibration_of(json.dumps(whole), "file")


@pytest.mark.parametrize(
    ("path", "value", "said"),
    [
        ("parameters/2/value", "much", 'parameters[3].value: expected a number, found "much"'),
        ("parameters/2/value", 10**400, "parameters[3].value: expected a number, found a number without measure"),
        ("parameters/2/value", 1e300, "parameters[3].value: expected a number of at most 1e+60 in size, found 1e+300"),
        ("parameters/2/u", 1e-300, "parameters[3]: expected zero or a number from 1e-60 to 1e+60, found 1e-300"),
        ("parameters", None, "parameters: expected a list, found null"),
        ("parameters", {}, "parameters: expected a list, found a table"),
        ("accel/matrix", [[1, 0, 0], [0, 1, 0]], "accel: expected a matrix of three columns, with a row for each bias"),
        ("accel/matrix", [[1, 0, 0]] * 3, "accel: expected a matrix that can be inverted, found a singular one"),
        ("accel/bias", [0, "1", 0], 'accel.bias[2]: expected a number, found "1"'),
        ("outcome/accepted", [], None),
        ("outcome/reasons", "none", 'outcome.reasons: expected a list, found "none"'),
        ("device", "A-7", 'device: expected a table, found "A-7"'),
        ("method", "joint\x1b[2J", "method: expected 1 to 200 printable characters, found"),
        ("launches", [{}], "launches[1].parameters: expected this key, found none"),
        ("rests", [{"start": 0, "stop": True, "residual": 0}], "rests[1].stop: expected a number, found true"),
        ("rests", [REST | {"file": 3}, REST], "rests[2].file: expected 3 or a later file, found 0"),
        ("rests", [REST, REST | {"file": 10**6}], "rests[2].file: expected 0 or a later file, found 1000000"),
        ("readings", {"accel": READ | {"scale": [1.0, 1e-300, 1.0]}}, "readings.accel: expected a scale, not zero"),
        ("provenance/created", 7, "provenance.created: expected a text, found 7"),
        ("device/imu", {"gyro_number": 0}, "device.imu.gyro_number: expected a number from 1 to 9, found 0"),
        ("device/imu", {"accel_id": "7"}, 'device.imu.accel_id: expected a device id, a whole number, found "7"'),
        ("sample_rate", 0.0, "sample_rate: expected a larger number, found 0.0"),
        ("session", {"date": "today"}, "session.date: expected a date, or a date with a time, found 'today'"),
        ("session", {"operator": "\x1b[2J"}, "session.operator: expected at most 10000 characters and no control"),
        (
            "session",
            {"conditions": {"humidity_percent": "dry"}},
            'session.conditions.humidity_percent: expected a number from 0 to 100 (%), found "dry"',
        ),
        ("session", {"equipment": "a table"}, 'session.equipment: expected a list, found "a table"'),
        ("together", [{}], "together[1].session: expected this key, found none"),
        ("temperature", {"range": [20.0]}, "temperature.range: expected a longer list, found ["),
    ],
)
def test_every_fault_of_a_calibration_file_is_named_with_its_key(path: str, value: Any, said: str | None) -> None:
    whole = copy.deepcopy(content())
    *keys, last = path.split("/")
    part: Any = whole
    for key in keys:
        part = part[int(key) if key.isdigit() else key]
    part[last] = value
    if said is None:  # a key that is worked out, not read
        assert calibration_of(json.dumps(whole), "file").outcome.accepted
        return
    with pytest.raises(CalibrationError) as caught:
        calibration_of(json.dumps(whole), "file")
    assert str(caught.value).startswith("file: ")
    assert said in str(caught.value)
    assert str(caught.value).isprintable()


# -------------------- results as JSON --------------------


@dataclass(frozen=True)
class Columns:
    """Two columns of two rows, and one that is not known."""

    number: np.ndarray
    vector: np.ndarray
    celsius: np.ndarray | None = None

    def __len__(self) -> int:
        return len(self.number)


@dataclass(frozen=True)
class Found:
    """A result of which not everything is shown."""

    json_fields: ClassVar = ("double", "rests", "day", "file", "by_name")

    value: float
    rests: Columns
    day: date
    file: Path
    by_name: dict[str, float]

    @property
    def double(self) -> float:
        return 2.0 * self.value


def test_a_result_becomes_json_by_its_fields_and_columns_become_rows() -> None:
    rests = Columns(number=np.array([0, 1]), vector=np.array([[1.0, np.nan], [np.inf, 2.0]]))
    found = Found(1.5, rests, date(2026, 5, 4), Path("a/b"), {"x": np.float64(3.0)})
    assert json.loads(json.dumps(as_json(found), allow_nan=False)) == {
        "double": 3.0,
        "rests": [
            {"number": 0, "vector": [1.0, None], "celsius": None},
            {"number": 1, "vector": [None, 2.0], "celsius": None},
        ],
        "day": "2026-05-04",
        "file": "a/b",
        "by_name": {"x": 3.0},
    }
