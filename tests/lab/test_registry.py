"""The registry: records are added and kept, whoever writes, on SQLite and on PostgreSQL."""

from __future__ import annotations

import json
import multiprocessing
import os
import sqlite3
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from itertools import islice
from pathlib import Path
from typing import Any, cast

import pytest
from sqlalchemy import text

from tests.support import ROOT
from tests.support.postgresql_server import Server, postgresql_server
from tests.support.registry_files import NAMES, content, digest, file_of, limits_records, record, write
from tests.support.registry_writer import write_all
from tumble.errors import InputError, MissingExtraError
from tumble.lab.registry import exchange
from tumble.lab.registry.adding import Added, Particulars, Submission, add, read_submission, set_limits, submission
from tumble.lab.registry.due import due, records
from tumble.lab.registry.exchange import Imported, export_lines, import_file
from tumble.lab.registry.series import calibration_in
from tumble.lab.registry.store import connect
from tumble.lab.registry.store.connect import Registry, open_registry
from tumble.lab.registry.store.tables import METADATA, VERSION
from tumble.lab.registry.types import LimitsRecord

LIMITS = 'format = 1\n[periodic]\n"accel.bias" = "5 mg"\n'
CORRECTION = Particulars(supersedes=1, reason="wrong gravity")


@pytest.fixture(scope="session")
def server() -> Iterator[Server]:
    with postgresql_server() as running:
        yield running


@pytest.fixture(params=["sqlite", "postgresql"])
def place(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    """Where an empty registry may be made."""
    if request.param == "sqlite":
        return str(tmp_path / "registry.sqlite")
    running: Server = request.getfixturevalue("server")
    return running.new_database()


@pytest.fixture
def registry(place: str) -> Iterator[Registry]:
    with open_registry(place, create=True) as opened:
        yield opened


@pytest.fixture
def file_registry(tmp_path: Path) -> Iterator[Registry]:
    """A registry on SQLite, where the database makes no difference."""
    with open_registry(str(tmp_path / "file.sqlite"), create=True) as opened:
        yield opened


def in_force(registry: Registry) -> dict[str, LimitsRecord]:
    """The limits in force, by device type."""
    return {limits.model: limits for limits in limits_records(registry)}


def added(registry: Registry, particulars: Particulars | None = None, **what: Any) -> Added:
    """A calibration with `what` in it, added."""
    return add(registry, submission(json.dumps(content(**what)), "file", particulars or Particulars()))


# -------------------- records are kept as they were added --------------------


def test_a_record_keeps_the_whole_file(registry: Registry, tmp_path: Path) -> None:
    values = {"accel.bias.x": 0.1 + 0.2, "gyro.axis.zy": -1e-300}  # every bit of them
    launches = [{"accel.bias.x": 0.25}, {"accel.bias.x": 0.35}]
    file = write(tmp_path / "calibration.json", content(values=values, launches=launches))
    kept = add(registry, read_submission(file, Particulars())).record
    assert file_of(registry, kept.number) == file.read_text(encoding="utf-8")
    calibration = calibration_in(registry, kept, "accelerometer")
    assert [p.name for p in calibration.parameters] == [*NAMES]
    assert {p.name: p.value for p in calibration.parameters if p.name in values} == values
    assert [launch.parameters[0].value for launch in calibration.launches] == [0.25, 0.35]


def test_the_same_calibration_is_one_record_however_its_file_is_laid_out(registry: Registry) -> None:
    whole = content()
    first = added(registry)
    for layout in ({}, {"indent": 4}, {"sort_keys": True}, {"ensure_ascii": False, "separators": (" , ", " : ")}):
        again = add(registry, submission(json.dumps(whole, **layout), "again", Particulars()))
        assert (again.new, again.record) == (False, first.record)
    assert first.new
    assert len(records(registry)) == 1


def test_a_correction_supersedes_and_what_it_corrects_stays(registry: Registry) -> None:
    added(registry, values={"accel.bias.x": 1.0})
    before = record(registry, 1), file_of(registry, 1)
    corrected = added(registry, CORRECTION, values={"accel.bias.x": 2.0}).record
    assert (corrected.number, corrected.supersedes, corrected.reason) == (2, 1, "wrong gravity")
    assert corrected.occasion == before[0].occasion == "incoming"
    after = record(registry, 1), file_of(registry, 1)
    assert after == (replace(before[0], superseded_by=2), *before[1:])
    with pytest.raises(InputError, match="record 1: expected one that is in force, found one superseded by 2"):
        added(registry, CORRECTION, values={"accel.bias.x": 3.0})
    assert len(records(registry)) == 2


@pytest.mark.parametrize("particulars", [Particulars(supersedes=1), Particulars(reason="because")])
def test_a_correction_needs_a_record_and_a_reason(file_registry: Registry, particulars: Particulars) -> None:
    added(file_registry)
    with pytest.raises(InputError, match="expected supersedes NUMBER with reason TEXT, found one of them"):
        added(file_registry, particulars, log="other")


def test_a_correction_of_nothing_is_refused(file_registry: Registry) -> None:
    with pytest.raises(InputError, match="record 1: expected a record of the registry, found none"):
        added(file_registry, CORRECTION)


def test_the_database_itself_refuses_changes(registry: Registry) -> None:
    added(registry)
    set_limits(registry, "BCHE-501", LIMITS, None)
    before = list(export_lines(registry))
    kept = (("calibration", "serial"), ("content", "file"), ("log", "sha256"), ("limits", "file"), ("forecast", "name"))
    assert {table for table, _ in kept} == set(METADATA.tables) - {"schema_version"}
    for table, column in kept:
        for statement in (f"UPDATE {table} SET {column} = 'x'", f"DELETE FROM {table}"):
            with pytest.raises(InputError, match="a registry is added to, never changed"), registry.writing() as c:
                c.execute(text(statement))
    assert list(export_lines(registry)) == before


def test_a_log_does_not_count_twice(file_registry: Registry) -> None:
    """Not by another method, not within the mean of several launches, until its record is superseded."""
    added(file_registry, log="one-1")
    with pytest.raises(InputError, match=r"found that of record 1 .* to correct that record give supersedes 1"):
        added(file_registry, values={"accel.bias.x": 1.0}, log="one-1")
    with pytest.raises(InputError, match="found that of record 1"):
        added(file_registry, log="one", launches=[{}, {}])  # the log of its first launch is one-1
    added(file_registry, CORRECTION, values={"accel.bias.x": 1.0}, log="one-1")
    with pytest.raises(InputError, match="found that of record 2"):
        added(file_registry, log="one", launches=[{}, {}])


def test_a_serial_number_is_of_one_type(file_registry: Registry) -> None:
    added(file_registry, log="a")
    with pytest.raises(InputError, match=r"device.model: expected 'BCHE-501', as device A-0007 has it in record 1"):
        added(file_registry, model="other", log="b")
    assert added(file_registry, model=None, log="c").record.model == "BCHE-501"
    assert added(file_registry, serial="B", model="other", log="d").record.model == "other"


def test_the_first_check_is_incoming_and_later_ones_are_periodic(file_registry: Registry) -> None:
    occasions = [added(file_registry, log=log).record.occasion for log in "abc"]
    again = added(file_registry, Particulars(occasion="incoming"), log="d").record.occasion
    assert [*occasions, again] == ["incoming", "periodic", "periodic", "incoming"]


def test_records_of_a_device_are_in_the_order_in_which_they_were_performed(file_registry: Registry) -> None:
    for year in (2024, 2022, 2023):
        added(file_registry, Particulars(performed=datetime(year, 1, 1, tzinfo=UTC)), log=str(year))
    assert [r.performed.year for r in records(file_registry, "A-0007")] == [2022, 2023, 2024]
    with pytest.raises(InputError, match="device 'B': expected a device of the registry, found none"):
        records(file_registry, "B")


def test_a_time_keeps_its_moment(registry: Registry) -> None:
    moment = datetime.fromisoformat("2026-03-01T23:30:00.123456-05:00")
    assert added(registry, Particulars(performed=moment)).record.performed == moment
    assert record(registry, 1).performed == moment


def change(path: str, value: object) -> Callable[[dict[str, Any]], None]:
    """Puts a value at a path of keys into a content."""

    def changed(whole: Any) -> None:
        *keys, last = path.split("/")
        for key in keys:
            whole = whole[int(key) if key.isdigit() else key]
        whole[last] = value

    return changed


@pytest.mark.parametrize(
    ("edit", "said"),
    [
        (change("outcome", {"accepted": False, "reasons": ["rest 3 moved"]}), "an accepted one, found: rest 3 moved"),
        (change("parameters", []), "expected a row and a column for each parameter, found one of 21"),
        (change("parameters/0/value", float("inf")), "expected a calibration file of tumble, found Infinity in place"),
        (change("parameters/0/u", -1.0), "parameters[1]: expected zero or a number from 1e-60 to 1e+60, found -1"),
        (change("parameters/1/name", "accel.bias.x"), "expected every name once, found 'accel.bias.x' twice"),
        (change("parameters/1/name", "accel\x1b[31m"), "parameters[2].name: expected 1 to 200 printable characters"),
        (change("device/serial", ""), "device.serial: expected 1 to 200 printable characters, found ''"),
        (change("device/serial", "A\0B"), "device.serial: expected 1 to 200 printable characters"),
        (change("device/serial", "A" * 201), "device.serial: expected 1 to 200 printable characters"),
        (change("device/model", "\ud800"), "expected a calibration file of tumble, found unexpected end of hex escape"),
        (change("device/serial", 7), "device.serial: expected a text, found 7"),
        (change("provenance/created", "yesterday"), "provenance.created: expected a date such as 2026-03-31, found"),
        (change("provenance/created", "2999-01-01"), "expected a date that is past, found 2999-01-01; give date"),
        (change("provenance", {}), "provenance.created: expected a time, found none; give date"),
        (change("format", 2), "expected format 1, found 2"),
    ],
)  # fmt: skip
def test_what_is_no_calibration_to_keep_is_refused_in_one_line(
    edit: Callable[[dict[str, Any]], None], said: str, tmp_path: Path
) -> None:
    whole = content()
    edit(whole)
    with pytest.raises(InputError) as refused:
        read_submission(write(tmp_path / "calibration.json", whole), Particulars())
    assert said in str(refused.value)
    assert str(refused.value).startswith(str(tmp_path / "calibration.json"))
    assert "\n" not in str(refused.value)


def test_a_number_too_large_for_a_float_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "calibration.json"
    file.write_text(json.dumps(content()).replace('"value": 0.0', '"value": 1e999', 1), encoding="utf-8")
    with pytest.raises(
        InputError, match=r"parameters\[1\].value: expected a number of at most 1e\+60 in size, found inf"
    ):
        read_submission(file, Particulars())


# -------------------- writers and readers at once --------------------


def test_eight_writers_at_once_lose_nothing(place: str) -> None:
    """They also make the registry at once, and all add the same calibrations of a common device."""
    writers, each = 8, 10

    def several(serial: str) -> list[Submission]:
        return [
            submission(json.dumps(content(serial=serial, log=f"{serial}-{i}")), "file", Particulars())
            for i in range(each)
        ]

    context = multiprocessing.get_context("forkserver")  # of a process that has imported no more than this
    context.set_forkserver_preload(["pytest", "psycopg", "tests.support.registry_writer"])
    mixed = [[*several(f"device-{i}")[:5], *several("common"), *several(f"device-{i}")[5:]] for i in range(writers)]
    processes = [context.Process(target=write_all, args=(place, own)) for own in mixed]
    for process in processes:
        process.start()
    for process in processes:
        process.join()
    assert [process.exitcode for process in processes] == [0] * writers
    with open_registry(place) as registry:
        found = records(registry)
        files = {file_of(registry, r.number) for r in found}
    serials = [f"device-{i}" for i in range(writers)] + ["common"]
    expected = [own for serial in serials for own in several(serial)]
    assert {r.sha256 for r in found} == {own.sha256 for own in expected}
    assert files == {own.file for own in expected}
    assert len(found) == len({r.number for r in found}) == 90
    assert sorted(r.serial for r in found if r.occasion == "incoming") == sorted(serials)


def test_a_killed_writer_leaves_every_acknowledged_record(server: Server) -> None:
    """On PostgreSQL; test_studies.py runs the same on SQLite."""
    study = ROOT / "studies" / "registry_interruptions.py"
    command = [sys.executable, "-W", "error", str(study), "--short", "--registry", server.new_database()]
    done = subprocess.run(command, capture_output=True, encoding="utf-8", check=False, timeout=120)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "20 writers killed" in done.stdout
    assert done.stdout.endswith("when its writer is killed? No.\n")


def test_a_reader_sees_one_state_and_a_writer_does_not_wait_for_it(place: str, registry: Registry) -> None:
    added(registry, log="a")
    with open_registry(place) as other, other.reading() as reading:
        counted = text("SELECT count(*) FROM calibration")
        assert reading.execute(counted).scalar() == 1
        added(registry, log="b")
        assert reading.execute(counted).scalar() == 1
    assert len(records(registry)) == 2


def test_a_writer_that_waits_in_vain_says_so(place: str, registry: Registry, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connect, "PATIENCE", 1.0)
    said = "another writer has held it for 1 s; try again"
    with (
        open_registry(place) as other,
        other.writing(),
        open_registry(place) as late,
        pytest.raises(InputError, match=said),
    ):
        added(late)
    assert records(registry) == []


def test_what_goes_wrong_on_the_way_leaves_nothing(registry: Registry) -> None:
    whole = submission(json.dumps(content()), "file", Particulars())
    broken = replace(whole, file=cast(str, None))  # which comes after the record
    with pytest.raises(InputError):
        add(registry, broken)
    assert records(registry) == []
    assert add(registry, whole).record.number >= 1


# -------------------- export and import --------------------


def filled(registry: Registry) -> None:
    """Limits that were replaced, and records of two devices, one of them corrected."""
    set_limits(registry, "BCHE-501", LIMITS, json.dumps(content(serial="passport")))
    added(registry, log="a")
    set_limits(registry, "BCHE-501", LIMITS.replace("5", "6"), None)
    added(registry, CORRECTION, log="b", serial="Ж-7 \"<'")
    added(registry, Particulars(state="as-found"), log="c", launches=[{}, {}])


def exported(registry: Registry, path: Path) -> Path:
    path.write_text("".join(f"{line}\n" for line in export_lines(registry)), encoding="utf-8")
    return path


def test_an_export_is_imported_whole_and_only_once(
    registry: Registry, file_registry: Registry, server: Server, tmp_path: Path
) -> None:
    filled(registry)
    file = exported(registry, tmp_path / "export.jsonl")
    for place in (str(tmp_path / "other.sqlite"), server.new_database()):
        with open_registry(place, create=True) as other:
            added(other, serial="own", log="own")  # so that numbers differ
            assert import_file(other, file) == Imported(added=3, known=0)
            assert import_file(other, file) == Imported(added=0, known=3)
            assert [r.superseded_by is None for r in records(other, "A-0007")] == [False, True]
            assert in_force(other) == in_force(registry)
    assert import_file(file_registry, file).added == 3
    assert exported(file_registry, tmp_path / "again.jsonl").read_text() == file.read_text()


def test_others_write_while_an_import_goes_on(
    place: str, registry: Registry, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Before every line and before every batch another writer adds a record, and is not made to wait."""
    with open_registry(str(tmp_path / "other.sqlite"), create=True) as other:
        for i in range(6):
            added(other, serial=f"S-{i}", log=f"imported {i}")
        file = exported(other, tmp_path / "export.jsonl")
    monkeypatch.setattr(connect, "PATIENCE", 0.2)
    monkeypatch.setattr(exchange, "BATCH", 2)
    looked, batches, written = submission, islice, iter(range(100))

    def meanwhile() -> None:
        with open_registry(place) as another:
            added(another, serial="W", log=f"meanwhile {next(written)}")

    def looking(*arguments: Any) -> Submission:
        meanwhile()
        return looked(*arguments)

    def taking(*arguments: Any) -> Any:
        meanwhile()
        return batches(*arguments)

    monkeypatch.setattr(exchange, "submission", looking)
    monkeypatch.setattr(exchange, "islice", taking)
    assert import_file(registry, file) == Imported(added=6, known=0)
    assert len(records(registry, "W")) == next(written) == 16  # a line is looked at twice
    assert len(records(registry)) == 22


def test_an_import_that_is_at_odds_with_the_registry_says_so_and_can_go_on(
    file_registry: Registry, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(exchange, "BATCH", 2)
    with open_registry(str(tmp_path / "other.sqlite"), create=True) as other:
        for i in range(5):
            added(other, serial=f"S-{i}", log=f"log {i}", values={"accel.bias.x": 0.1})
        file = exported(other, tmp_path / "export.jsonl")
    standing = added(file_registry, serial="S-3", log="log 3").record  # another calibration of the same log
    with pytest.raises(InputError, match="line 5: expected a log that is not in the registry, found that of record 1"):
        import_file(file_registry, file)
    assert sorted(r.serial for r in records(file_registry)) == ["S-0", "S-1", "S-3"]
    assert record(file_registry, standing.number) == standing


def limits_of(size: int) -> str:
    return f'format = 1\n[periodic]\n"accel.bias" = "{size} mg"\n'


def export_with(limits: tuple[str, str], path: Path) -> Path:
    """An export of the limits (file, time) of a type, and of a calibration that was judged by them."""
    file, moment = limits
    sha = digest(file + moment)
    lines = [
        {"kind": "tumble registry", "format": 1, "limits": 1, "calibrations": 1},
        {"kind": "limits", "sha256": sha, "model": "BCHE-501", "added": moment, "file": file, "systematic": None},
        {
            "kind": "calibration", "performed": "2019-03-01", "occasion": "periodic", "state": "unchanged",
            "limits": sha, "supersedes": None, "reason": None, "added": moment,
            "file": json.dumps(content(log=f"of {moment}", created="2019-03-01")),
        },
    ]  # fmt: skip
    path.write_text("".join(f"{json.dumps(line)}\n" for line in lines), encoding="utf-8")
    return path


def test_limits_of_an_older_export_are_kept_but_not_put_in_force(registry: Registry, tmp_path: Path) -> None:
    set_limits(registry, "BCHE-501", limits_of(1), None)
    old = export_with((limits_of(500), "2019-03-01T12:00:00+00:00"), tmp_path / "old.jsonl")
    assert import_file(registry, old) == Imported(added=1, known=0)
    assert in_force(registry)["BCHE-501"].file == limits_of(1)
    by = {own.number: own.file for own in limits_records(registry)}
    assert by[records(registry)[0].limits or 0] == limits_of(500)  # by which it was judged then
    now = added(registry, Particulars(occasion="periodic"), log="now")
    assert by[now.record.limits or 0] == limits_of(1)
    assert not set_limits(registry, "BCHE-501", limits_of(1), None)[1]


def test_limits_of_a_newer_export_come_in_force_and_others_after_them(file_registry: Registry, tmp_path: Path) -> None:
    set_limits(file_registry, "BCHE-501", limits_of(1), None)
    ahead = (datetime.now(UTC) + timedelta(hours=12)).isoformat()  # the other registry's clock
    import_file(file_registry, export_with((limits_of(2), ahead), tmp_path / "new.jsonl"))
    assert in_force(file_registry)["BCHE-501"].file == limits_of(2)
    assert set_limits(file_registry, "BCHE-501", limits_of(3), None)[1]
    assert in_force(file_registry)["BCHE-501"].file == limits_of(3)
    beyond = export_with((limits_of(4), "2199-01-01T00:00:00+00:00"), tmp_path / "beyond.jsonl")
    with pytest.raises(InputError, match="line 2: added: expected a date that is past"):
        import_file(file_registry, beyond)


def last(edit: Callable[[str], str]) -> Callable[[list[str]], list[str]]:
    """Changes the last line."""
    return lambda lines: [*lines[:-1], edit(lines[-1])]


def lines_without(number: int) -> Callable[[list[str]], list[str]]:
    """Leaves out a line."""
    return lambda lines: lines[:number] + lines[number + 1 :]


@pytest.mark.parametrize(
    ("edit", "said"),
    [
        (lambda lines: lines[:-1], "that line 1 says, 2 limits and 3 calibrations, found 2 limits and 2 calibrations"),
        (lambda lines: [*lines[:-1], lines[-1][:100]], "line 6: expected a line of JSON, found an error in its syntax"),
        (lambda _: [], "line 1: expected a line of JSON"),
        (lambda lines: lines[1:], "line 1: expected an export of a tumble registry of format 1, found another file"),
        (last(lambda _: '{"kind": "calibration"}'), "line 6: expected a line of an export, found one without"),
        (last(lambda _: '{"kind": "device"}'), "line 6: kind: expected limits or calibration, found 'device'"),
        (last(lambda _: "[]"), "line 6: expected a JSON object"),
        (last(lambda line: line.replace('"as-found"', '"lost"')), "line 6: state: expected one of as-found,"),
        (last(lambda line: line.replace('"incoming"', '"x"')), "line 6: occasion: expected one of incoming,"),
        (last(lambda line: line.replace('reasons\\": []', 'reasons\\": [\\"no\\"]')), "line 6: expected an accepted"),
        (lambda lines: [lines[0], lines[1].replace("5 mg", "5 furlong"), *lines[2:]], "line 2: periodic: accel.bias"),
        (
            lambda lines: [lines[0].replace('"calibrations": 3', '"calibrations": 2'), *lines_without(3)(lines)[1:]],
            "line 4: expected a line of an export, found one without",
        ),
    ],
)  # fmt: skip
def test_an_export_that_cannot_be_imported_adds_nothing(
    edit: Callable[[list[str]], list[str]], said: str, file_registry: Registry, tmp_path: Path
) -> None:
    filled(file_registry)
    file = exported(file_registry, tmp_path / "export.jsonl")
    whole = file.read_text(encoding="utf-8").splitlines()
    assert len(whole) == 6
    file.write_text("\n".join(edit(whole)), encoding="utf-8")
    with open_registry(str(tmp_path / "other.sqlite"), create=True) as other:
        with pytest.raises(InputError) as refused:
            import_file(other, file)
        assert said in str(refused.value)
        assert str(file) in str(refused.value)
        assert "\n" not in str(refused.value)
        assert records(other) == []
        assert in_force(other) == {}


# -------------------- the schema --------------------


@pytest.mark.parametrize("version", ["v0001", "v0999"])
def test_a_registry_of_another_version_says_what_to_do(version: str, registry: Registry, place: str) -> None:
    with registry.writing() as connection:
        connection.execute(text(f"UPDATE schema_version SET version_num = '{version}'"))
    said = (
        f"expected a registry of version {VERSION}, found {version}, written by another tumble; with that one `tumble "
        "registry export -o FILE`, with this one `tumble registry import FILE"
    )
    with pytest.raises(InputError, match=said), open_registry(place):
        pass


def test_a_damaged_column_is_said_in_one_line(tmp_path: Path) -> None:
    place = str(tmp_path / "r.sqlite")
    with open_registry(place, create=True) as registry:
        added(registry)
    with sqlite3.connect(place) as raw:
        raw.execute("DROP TRIGGER calibration_no_update")
        raw.execute("UPDATE calibration SET performed = 'the day before'")
    with open_registry(place) as registry:
        for look in (lambda: records(registry), lambda: records(registry, "A-0007"), lambda: due(registry)):
            with pytest.raises(InputError, match="expected what was written into it, found a damaged value") as refused:
                look()
            assert "\n" not in str(refused.value)


def test_a_registry_on_a_medium_that_nobody_can_write_to_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    place = tmp_path / "a #%? name" / "r.sqlite"
    place.parent.mkdir()
    with open_registry(str(place), create=True) as registry:
        added(registry)
    monkeypatch.setattr(os, "access", lambda *_: False)
    with open_registry(str(place)) as registry:
        assert [record.serial for record in records(registry)] == ["A-0007"]
        assert [path.name for path in place.parent.iterdir()] == ["r.sqlite"]  # none beside it
        with pytest.raises(InputError, match="the registry cannot be used: attempt to write a readonly database"):
            added(registry, log="b")


# -------------------- places that cannot be used --------------------


def refused(place: str, *, create: bool = False) -> str:
    """The one line for which a registry is not opened."""
    with pytest.raises(InputError) as error, open_registry(place, create=create):
        pass
    said = str(error.value)
    assert "\n" not in said
    return said


def test_places_that_cannot_be_used_are_refused_in_one_line(tmp_path: Path) -> None:
    missing, note = tmp_path / "none.sqlite", tmp_path / "note.txt"
    note.write_text("This is a note, and it is longer than the header of a database would be. " * 3, encoding="utf-8")
    assert (
        refused(str(missing)) == f"{missing}: expected a registry, found no such file; `tumble registry add` makes one"
    )
    assert not missing.exists()
    assert refused(str(tmp_path)) == f"{tmp_path}: expected a registry, found a folder"
    assert "expected a folder for the registry, found no" in refused(str(tmp_path / "no" / "x.sqlite"), create=True)
    assert "file is not a database" in refused(str(note), create=True)
    form = "registry: expected a file or postgresql://USER@HOST/NAME, found a URL of "
    assert refused("mysql://user:secret@localhost/x") == f"{form}'mysql'"
    assert refused("oddbase://user:secret@localhost/x").startswith(form)
    assert refused("sqlite:///:memory:") == f"{form}'sqlite'"
    assert "secret" not in refused("postgresql://user:secret@localhost:port/x")


def test_the_database_of_another_program_is_left_alone(place: str) -> None:
    if "://" in place:
        import psycopg

        with psycopg.connect(place) as connection:
            connection.execute("CREATE TABLE device (serial text)")
    else:
        with sqlite3.connect(place) as other:
            other.execute("CREATE TABLE device (serial text)")
        other.close()
    assert "expected a registry or an empty database, found the tables of another program" in refused(
        place, create=True
    )


def test_an_empty_database_is_no_registry_to_read(server: Server) -> None:
    url = server.new_database()
    assert "expected a registry, found an empty database; `tumble registry add` makes one" in refused(url)


def test_a_server_that_does_not_answer_is_named_without_the_password(server: Server) -> None:
    said = refused(server.url("nowhere"))
    assert 'database "nowhere" does not exist' in said
    assert server.password not in said
    wrong = refused(server.url("postgres").replace(server.password, "hunter2"))
    assert "password authentication failed" in wrong
    assert "hunter2" not in wrong


def test_the_default_is_a_file_in_the_users_data_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("platformdirs.user_data_path", lambda name, **_: tmp_path / name)
    with open_registry(create=True) as registry:
        added(registry)
    assert (tmp_path / "tumble" / "registry.sqlite").exists()


@pytest.mark.parametrize("module", ["sqlalchemy", "psycopg", "platformdirs"])
def test_without_the_extra_it_is_named(module: str, tmp_path: Path) -> None:
    place = {"psycopg": "postgresql://localhost/x", "platformdirs": None}.get(module, str(tmp_path / "r.sqlite"))
    code = (
        f"import sys; sys.modules[{module!r}] = None\n"
        "from tumble.errors import MissingExtraError\n"
        "from tumble.lab.registry.store.connect import open_registry\n"
        "try:\n"
        f"    with open_registry({place!r}, create=True): pass\n"
        "except MissingExtraError as error: print(error)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == f"the registry needs {module}; install it with: pip install 'tumble[lab]'\n"
    assert MissingExtraError.__name__ in code


@pytest.mark.parametrize(
    ("column", "value"), [("version", "1"), ("version_num", 5), ("version_num", b"\xff"), ("version_num", "a9c1")]
)
def test_the_schema_version_of_another_program_is_none(column: str, value: object, tmp_path: Path) -> None:
    with closing(sqlite3.connect(tmp_path / "r.sqlite", isolation_level=None)) as opened:
        opened.execute(f"CREATE TABLE schema_version ({column})")
        opened.execute("INSERT INTO schema_version VALUES (?)", (value,))
    with pytest.raises(InputError, match="found the tables of another program"), open_registry(tmp_path / "r.sqlite"):
        pass
