"""What session.toml leaves out is left out, and said."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from tests.support.shared import copy_of, session
from tumble.cli import main
from tumble.errors import InputError, SessionError
from tumble.planning.setup import Setup
from tumble.recording.session_file import read_session
from tumble.result.calibration import Calibration, read_calibration
from tumble.run.calibrate import calibrate

RESTS = 9


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    setup = Setup.of(grade="mems", programme="nine", rest=8.0, rate_deg_s=60.0)
    return copy_of(session(setup, seed=5, log_format="csv"), tmp_path_factory.mktemp("nine") / "launch")


def _calibrated(folder: Path, exclude: str) -> Calibration:
    path = folder / "session.toml"
    text = path.read_text(encoding="utf-8")
    try:
        path.write_text(f"{text}\n[[exclude]]\n{exclude}\n", encoding="utf-8")
        return calibrate(folder)
    finally:
        path.write_text(text, encoding="utf-8")


def test_a_rest_by_number_is_left_out_of_a_programme_and_said(whole: Path) -> None:
    all_of_it, found = calibrate(whole), _calibrated(whole, 'rest = 4\nreason = "knocked"')
    starts = [rest.start for rest in all_of_it.evidence.rests]
    assert [rest.start for rest in found.evidence.rests] == starts[:3] + starts[4:]
    assert "left out by session.toml: rest 4: knocked" in found.provenance.notes


def test_rests_are_left_out_by_request_as_by_the_file_and_said(whole: Path) -> None:
    by_request, by_file = calibrate(whole, without=(4,)), _calibrated(whole, "rest = 4")
    assert [p.value for p in by_request.parameters] == [p.value for p in by_file.parameters]
    assert "left out by request: rest 4" in by_request.provenance.notes


def test_the_command_leaves_out_what_the_library_does(whole: Path, tmp_path: Path) -> None:
    out = tmp_path / "without.json"
    ran = CliRunner().invoke(main, ["calibrate", str(whole), "--without", "4,6", "-o", str(out)])
    assert ran.exit_code == 0, ran.stderr
    assert len(read_calibration(out).evidence.rests) == RESTS - 2


@pytest.mark.parametrize(
    ("numbers", "said"), [((0,), "found 0"), ((1.5,), r"found \(1.5,\)"), ((10,), "a rest from 1 to 9, found 10")]
)
def test_numbers_that_are_none_of_a_rest_are_refused(whole: Path, numbers: tuple[int, ...], said: str) -> None:
    with pytest.raises(InputError, match=f"without: expected .*{said}"):
        calibrate(whole, without=numbers)


def test_what_is_no_list_of_numbers_is_refused(whole: Path) -> None:
    ran = CliRunner().invoke(main, ["calibrate", str(whole), "--without", "3;7"])
    assert ran.exit_code == 2
    assert "--without: expected numbers of rests such as 3,7, found '3;7'" in ran.stderr


def test_times_shorten_a_rest_and_its_longer_part_remains(whole: Path) -> None:
    rest = calibrate(whole).evidence.rests[2]
    found = _calibrated(whole, f"start = {rest.stop - 3.0}\nstop = {rest.stop + 1.0}")
    assert len(found.evidence.rests) == RESTS
    np.testing.assert_allclose(
        [found.evidence.rests[2].start, found.evidence.rests[2].stop], [rest.start, rest.stop - 3.0], atol=0.11
    )


def test_a_turn_by_number_is_left_out(whole: Path) -> None:
    found = _calibrated(whole, "turn = 2")
    assert [turn.first for turn in found.evidence.turns] == [0, *range(2, RESTS - 1)]
    assert "left out by session.toml: turn 2" in found.provenance.notes
    assert not any("samples are lost" in note for note in found.provenance.notes)
    assert len(found.evidence.rests) == RESTS


def test_a_number_that_does_not_exist_is_refused(whole: Path) -> None:
    with pytest.raises(SessionError, match=r"exclude\.rest: expected a rest from 1 to 9, found 10"):
        _calibrated(whole, "rest = 10")


@pytest.mark.parametrize("exclude", ["rest = 3\nturn = 2", "start = 1.0", "start = 3.0\nstop = 2.0", 'reason = "why"'])
def test_a_table_that_says_not_what_is_refused(whole: Path, exclude: str) -> None:
    path = whole / "session.toml"
    text = path.read_text(encoding="utf-8")
    path.write_text(f"{text}\n[[exclude]]\n{exclude}\n", encoding="utf-8")
    try:
        with pytest.raises(SessionError, match="exclude"):
            read_session(whole)
    finally:
        path.write_text(text, encoding="utf-8")
