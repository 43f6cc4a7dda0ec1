"""The registry: records are added and kept, whoever writes."""

from __future__ import annotations

import json
import multiprocessing
import shutil
import sqlite3
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.support.calibrated import calibration as calibrated
from tests.support.calibrated import with_fields
from tests.support.postgresql_server import postgresql_server
from tests.support.registry_files import NAMES, added, content, digest, write
from tests.support.registry_writer import write_all
from tumble.errors import InputError
from tumble.inference.estimate import Outcome
from tumble.lab.registry import database
from tumble.lab.registry.records import State
from tumble.lab.registry.registry import Registry, open_registry
from tumble.recording.session import Circumstances
from tumble.result.calibration import calibration_of

LIMITS = 'format = 1\n[periodic]\n"accel.bias" = "5 mg"\n'


@pytest.fixture
def place(tmp_path: Path) -> str:
    return str(tmp_path / "registry.sqlite")


@pytest.fixture
def registry(place: str) -> Iterator[Registry]:
    with open_registry(place, create=True) as opened:
        yield opened


# -------------------- records are kept as they were added --------------------


def test_a_calibration_that_is_not_accepted_withdraws_the_device_until_it_is_calibrated(
    registry: Registry, tmp_path: Path
) -> None:
    added(registry)
    whole = content()
    whole["outcome"] = {"accepted": False, "reasons": ["rest 3 moved"]}
    whole["provenance"] |= {"log_sha256": "e" * 64}
    record = registry.add_calibration(write(tmp_path / "bad.json", whole))
    assert (record.verdict, record.accepted, registry.verdict(record)) == ("not accepted", False, None)
    assert [due.withdrawn for due in registry.due()] == [True]
    assert len(registry.trend(record.serial).parameters[0].points) == 1
    mended = content() | {"provenance": whole["provenance"]}  # the same log, without what was wrong in it
    registry.add_calibration(write(tmp_path / "good.json", mended))
    assert [due.withdrawn for due in registry.due()] == [False]


def test_serial_numbers_that_look_alike_are_named(registry: Registry, tmp_path: Path) -> None:
    first, other = (
        registry.add_calibration(
            write(tmp_path / "c.json", content() | {"device": {"serial": serial}, "provenance": origin})
        )
        for serial, origin in (
            ("N-101", {"created": "2026-03-01", "log_sha256": "1" * 64}),
            (" n-1O1 ", {"created": "2026-03-02", "log_sha256": "2" * 64}),
        )
    )
    assert other.serial == "n-1O1"
    assert registry.similar(first) == ["n-1O1"]
    assert registry.similar(other) == ["N-101"]


def test_a_record_keeps_the_whole_file(registry: Registry, tmp_path: Path) -> None:
    values = {"accel.bias.x": 0.1 + 0.2, "gyro.axis.zy": -1e-300}  # every bit of them
    launches = [{"accel.bias.x": 0.25}, {"accel.bias.x": 0.35}]
    file = write(tmp_path / "calibration.json", content(values=values, launches=launches))
    record = registry.add_calibration(file)
    assert registry.file(record) == file.read_text(encoding="utf-8")
    kept = registry.calibration(record)
    assert [p.name for p in kept.parameters] == [*NAMES]
    assert {p.name: p.value for p in kept.parameters if p.name in values} == values
    assert [launch.parameters[0].value for launch in kept.evidence.launches] == [0.25, 0.35]


def test_the_same_calibration_is_one_record_however_its_file_is_laid_out(registry: Registry, tmp_path: Path) -> None:
    file, records = tmp_path / "calibration.json", []
    layouts: tuple[dict[str, Any], ...] = ({}, {"indent": 4}, {"sort_keys": True}, {"ensure_ascii": False})
    for layout in layouts:
        file.write_text(json.dumps(content(), **layout), encoding="utf-8")
        records.append(registry.add_calibration(file))
    assert records == [records[0]] * 4
    assert registry.records() == [records[0]]


def test_the_database_itself_refuses_changes(registry: Registry, place: str, tmp_path: Path) -> None:
    (tmp_path / "limits.toml").write_text(LIMITS, encoding="utf-8")
    registry.set_limits("BCHE-501", tmp_path / "limits.toml")
    before = added(registry), registry.limits()
    for table, column in (("calibration", "serial"), ("calibration_log", "sha256"), ("limits", "file")):
        for statement in (f"UPDATE {table} SET {column} = 'x'", f"DELETE FROM {table}"):
            with (
                sqlite3.connect(place) as raw,
                pytest.raises(sqlite3.IntegrityError, match="a registry is added to, never changed"),
            ):
                raw.execute(statement)
            raw.close()
    assert (registry.records()[0], registry.limits()) == before


def test_a_log_does_not_count_twice(registry: Registry) -> None:
    """Not by another method, not within the mean of several launches."""
    added(registry, log="one-1")
    with pytest.raises(InputError, match=r"expected a log that is not in the registry, found that of record 1"):
        added(registry, values={"accel.bias.x": 1.0}, log="one-1")
    with pytest.raises(InputError, match="found that of record 1"):
        added(registry, log="one", launches=[{}, {}])  # the log of its first launch is one-1
    assert len(registry.records()) == 1


def test_a_serial_number_is_of_one_type(registry: Registry) -> None:
    added(registry, log="a")
    with pytest.raises(InputError, match=r"device.model: expected 'BCHE-501', as device A-0007 has it in record 1"):
        added(registry, model="other", log="b")
    assert added(registry, model=None, log="c").model == "BCHE-501"
    assert added(registry, serial="B", model="other", log="d").model == "other"


def test_the_first_check_is_incoming_and_later_ones_are_periodic(registry: Registry) -> None:
    occasions = [added(registry, log=log).occasion for log in "abc"]
    again = added(registry, occasion="incoming", log="d").occasion
    assert [*occasions, again] == ["incoming", "periodic", "periodic", "incoming"]
    assert added(registry, log="e", performed=datetime(2001, 1, 1, tzinfo=UTC)).occasion == "incoming"  # the earliest


def test_records_of_a_device_are_in_the_order_in_which_they_were_performed(registry: Registry) -> None:
    for year in (2024, 2022, 2023):
        added(registry, performed=datetime(year, 1, 1, tzinfo=UTC), log=str(year))
    assert [r.performed.year for r in registry.records("A-0007")] == [2022, 2023, 2024]
    with pytest.raises(InputError, match="device 'B': expected a device of the registry, found none"):
        registry.records("B")


def test_a_time_keeps_its_moment(registry: Registry) -> None:
    moment = datetime.fromisoformat("2026-03-01T23:30:00.123456-05:00")
    assert added(registry, performed=moment).performed == moment
    assert registry.record(1).performed == moment


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
        (change("parameters", []), "expected a row and a column for each parameter, found one of 21"),
        (change("parameters/0/value", float("inf")), "expected a calibration file of tumble, found Infinity in place"),
        (change("device/serial", "A\0B"), "device.serial: expected 1 to 200 printable characters"),
        (change("provenance/created", "yesterday"), "provenance.created: expected a date such as 2026-03-31, found"),
        (change("provenance/created", "2999-01-01"), "expected a date that is past, found 2999-01-01; give date"),
        (change("provenance", {}), "provenance.created: expected a time, found none; give date"),
        (change("format", 2), "expected format 1, found 2"),
    ],
)  # fmt: skip
def test_what_is_no_calibration_to_keep_is_refused_in_one_line(
    edit: Callable[[dict[str, Any]], None], said: str, registry: Registry, tmp_path: Path
) -> None:
    whole = content()
    edit(whole)
    with pytest.raises(InputError) as refused:
        registry.add_calibration(write(tmp_path / "calibration.json", whole))
    assert said in str(refused.value)
    assert str(refused.value).startswith(str(tmp_path / "calibration.json"))
    assert "\n" not in str(refused.value)
    assert registry.records() == []


def test_launches_of_a_device_have_their_degrees_of_freedom(registry: Registry) -> None:
    name = "accel.bias.x"
    for serial, values in (("A", (1.0, 3.0)), ("B", (2.0, 2.0, 5.0)), ("C", (0.0,))):
        whole = content(serial=serial, log=serial, launches=[{name: value} for value in values])
        for parameter in whole["parameters"]:
            parameter["run_to_run"] = (
                float(np.std(values, ddof=1)) if parameter["name"] == name and values[1:] else None
            )
        registry.add_calibration(calibration_of(json.dumps(whole), "file"))
    known = (*registry.launches("A"), *registry.launches("B"))
    assert [(each.serial, each.degrees) for each in known] == [("A", 1), ("B", 2)]
    assert known[0].variances[name] == pytest.approx(2.0)
    assert known[1].logs == {digest(f"B-{i}") for i in (1, 2, 3)}
    with pytest.raises(InputError, match="expected several launches of one device in the registry, found none"):
        registry.launches("C")


def test_launches_that_were_added_one_by_one_pool(registry: Registry) -> None:
    """Those of one device between two adjustments, by their scatter, beside those of several launches."""
    name, bias = "accel.bias.x", (1.0, 3.0, 8.0, 10.0, 12.0)
    for i, value in enumerate(bias):
        state: State = "as-left" if i == 2 else "unchanged"
        when = datetime(2025, 1 + i, 1, tzinfo=UTC)
        added(registry, serial="A", log=f"A{i}", values={name: value}, state=state, performed=when)
    added(registry, serial="B", log="B", values={name: 7.0})
    first, second = registry.launches("A")
    assert (first.degrees, second.degrees) == (1, 2)
    assert first.variances[name] == pytest.approx(2.0)
    assert second.variances[name] == pytest.approx(4.0)
    assert first.logs == {digest("A0"), digest("A1")}
    with pytest.raises(InputError, match="device 'B': expected several launches of one device"):
        registry.launches("B")


def test_of_a_calibration_with_bad_gyros_the_accelerometers_are_registered(registry: Registry) -> None:
    bad = Outcome(reasons=("gyros are noisy",), concerns={"gyros are noisy": ("gyro",)})
    made = replace(calibrated(), outcome=bad)
    record = registry.add_calibration(made)
    assert {name.split(".")[0] for name in registry.calibration(record)} == {"accel"}
    assert {each.name.split(".")[0] for each in registry.trend(made.serial).parameters} == {"accel"}


def test_a_calibration_is_performed_when_it_was_recorded(registry: Registry) -> None:
    recorded = with_fields(calibrated(), circumstances=Circumstances(date="2025-03-04T09:30:00"))
    assert registry.add_calibration(recorded).performed == datetime(2025, 3, 4, 9, 30, tzinfo=UTC)


# -------------------- writers and readers at once --------------------


def written_at_once(place: str, folder: Path, writers: int = 8, each: int = 6) -> None:
    """Writers make the registry at once, and all add the same calibrations of a common device beside their own."""
    serials = [f"device-{i}" for i in range(writers)]
    files = {
        serial: [
            write(folder / f"{serial}-{i}.json", content(serial=serial, log=f"{serial}-{i}"))
            for i in range(each)
        ]
        for serial in [*serials, "common"]
    }  # fmt: skip
    context = multiprocessing.get_context("forkserver")  # of a process that has imported no more than this
    context.set_forkserver_preload(["pytest", "psycopg", "tests.support.registry_writer"])
    mixed = [[*files[serial][:3], *files["common"], *files[serial][3:]] for serial in serials]
    processes = [context.Process(target=write_all, args=(place, own)) for own in mixed]
    for process in processes:
        process.start()
    for process in processes:
        process.join()
    assert [process.exitcode for process in processes] == [0] * writers
    with open_registry(place) as registry:
        records = registry.records()
        texts = {registry.file(record) for record in records}
    assert texts == {file.read_text(encoding="utf-8") for own in files.values() for file in own}
    assert len(records) == len({r.number for r in records}) == (writers + 1) * each
    assert sorted(r.serial for r in records if r.occasion == "incoming") == sorted(files)


def test_eight_writers_at_once_lose_nothing(place: str, tmp_path: Path) -> None:
    written_at_once(place, tmp_path)


def test_a_reader_does_not_stop_a_writer_and_one_that_waits_in_vain_says_so(
    place: str, registry: Registry, monkeypatch: pytest.MonkeyPatch
) -> None:
    added(registry, log="a")
    with open_registry(place) as other, other.database.reading() as rows:
        assert len(rows.records()) == 1
        added(registry, log="b")
        assert len(rows.records()) == 1  # one state of the database
    monkeypatch.setattr(database, "LOCK_TIMEOUT", 1.0)
    said = "another writer has held it for 1 s; try again"
    with (
        open_registry(place) as other,
        other.database.writing(),
        open_registry(place) as late,
        pytest.raises(InputError, match=said),
    ):
        added(late, log="c")
    assert len(registry.records()) == 2


def test_what_goes_wrong_on_the_way_leaves_nothing(registry: Registry) -> None:
    def interrupted() -> None:
        with registry.database.writing() as rows:
            rows.add(database.LIMITS, model="M", file=LIMITS)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert registry.limits() == []


def test_of_a_new_registry_nothing_is_left_where_nothing_was_added(
    place: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(_: object) -> None:
        raise sqlite3.OperationalError("disk I/O error")

    (tmp_path / "limits.toml").write_text("format = 1\n", encoding="utf-8")
    with pytest.raises(InputError, match="expected limits"), open_registry(place, create=True) as registry:
        registry.set_limits("M", tmp_path / "limits.toml")
    monkeypatch.setattr(database, "_make_tables", full)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=4096))
    with (
        pytest.raises(InputError, match="cannot be used: No space left"),
        open_registry(place, create=True) as registry,
    ):
        added(registry)
    assert [path.name for path in tmp_path.iterdir()] == ["limits.toml"]


def test_postgresql_keeps_records_refuses_changes_and_is_named_without_the_password(tmp_path: Path) -> None:
    import psycopg

    with postgresql_server() as server:
        place = server.new_database()
        with pytest.raises(InputError, match="expected a registry, found an empty database"), open_registry(place):
            pass
        written_at_once(place, tmp_path, writers=4)
        with open_registry(place) as registry:
            before = registry.records()
            moment = datetime.fromisoformat("2026-03-01T23:30:00.123456-05:00")
            assert added(registry, performed=moment, log="more").performed == moment
            assert registry.trend("common").parameters[0].name == NAMES[0]
        with psycopg.connect(place) as raw, pytest.raises(psycopg.Error, match="a registry is added to, never changed"):
            raw.execute("UPDATE calibration SET serial = 'x'")
        with open_registry(place) as registry:
            assert registry.records()[:1] == before[:1]
        for url, said in (
            (server.url("nowhere"), 'database "nowhere" does not exist'),
            (server.url("postgres").replace(server.password, "hunter2"), "password authentication failed"),
        ):
            message = refused(url)
            assert said in message
            assert server.password not in message
            assert "hunter2" not in message


# -------------------- places that cannot be used --------------------


def refused(place: str, *, create: bool = False) -> str:
    """The one line for which a registry is not opened."""
    with pytest.raises(InputError) as error, open_registry(place, create=create):
        pass
    said = str(error.value)
    assert "\n" not in said
    return said


def test_places_that_cannot_be_used_are_refused_in_one_line(tmp_path: Path) -> None:
    missing, note, other = tmp_path / "none.sqlite", tmp_path / "note.txt", tmp_path / "other.sqlite"
    note.write_text("This is a note, and it is longer than the header of a database would be. " * 3, encoding="utf-8")
    with sqlite3.connect(other) as raw:
        raw.execute("CREATE TABLE device (serial text)")
    raw.close()
    expected = f"{missing}: expected a registry, found no such file; `tumble registry add` makes one"
    assert refused(str(missing)) == expected
    assert not missing.exists()
    assert refused(str(tmp_path)) == f"{tmp_path}: expected a registry, found a folder"
    assert "expected a folder for the registry, found no" in refused(str(tmp_path / "no" / "x.sqlite"), create=True)
    assert "file is not a database" in refused(str(note), create=True)
    assert "found tables of another program, or of another version" in refused(str(other), create=True)
    form = "registry: expected a file or postgresql://USER@HOST/NAME, found a URL of "
    assert refused("mysql://user:secret@localhost/x") == f"{form}'mysql'"
    assert refused("oddbase://user:secret@localhost/x").startswith(form)
    assert refused("sqlite:///:memory:") == f"{form}'sqlite'"
    assert "secret" not in refused("postgresql://user:secret@localhost:port/x")


@pytest.mark.parametrize("damage", ["the day before", ""])
def test_a_damaged_column_is_said_in_one_line(damage: str, place: str, registry: Registry) -> None:
    added(registry)
    with sqlite3.connect(place) as raw:
        raw.execute("DROP TRIGGER calibration_no_update")
        raw.execute("UPDATE calibration SET performed = ?", (damage,))
    raw.close()
    for look in (registry.records, registry.due, lambda: added(registry)):
        with pytest.raises(InputError, match="expected what was written into it, found a damaged value") as said:
            look()
        assert "\n" not in str(said.value)


@pytest.mark.parametrize("module", ["sqlalchemy", "psycopg"])
def test_without_the_extra_it_is_named(module: str, tmp_path: Path) -> None:
    place = "postgresql://localhost/x" if module == "psycopg" else str(tmp_path / "r.sqlite")
    code = (
        f"import sys; sys.modules[{module!r}] = None\n"
        "import tumble\n"
        "from tumble.lab import open_registry\n"
        "try:\n"
        f"    with open_registry({place!r}, create=True): pass\n"
        "except tumble.MissingExtraError as error: print(error)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == (
        f"the registry needs {module}; install it with: pip install 'tumble[lab]', or in the folder of its source: "
        "pip install '.[lab]'\n"
    )
