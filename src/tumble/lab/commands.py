"""Commands of the laboratory: `registry` and `selftest`."""

from __future__ import annotations

import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from tumble import lab
from tumble.commands import console, params
from tumble.errors import InputError

if TYPE_CHECKING:
    from tumble.lab.registry.records import Record
    from tumble.lab.registry.registry import Registry

_DAY: dict[str, Any] = {"type": click.DateTime(["%Y-%m-%d"]), "metavar": "YYYY-MM-DD"}
_PLACE = params.registry_place(required=True)


def _expect_new_file(out: Path | None, what: str) -> None:
    if out is not None and out.exists():
        raise InputError(f"{out}: expected a new file for the {what}, found one that exists")


@click.group(
    epilog=params.examples(
        "tumble registry add imu-7/calibration.json --registry lab.sqlite", "tumble registry due --registry lab.sqlite"
    )
)
def registry() -> None:
    """Devices, launches, calibrations and acceptance limits over years. Records are added, never changed."""


@registry.command
@click.argument("calibration", type=params.FILE)
@params.option(
    "--check/occasion", "Check; default: incoming, later periodic.", type=click.Choice(["incoming", "periodic"])
)
@params.option(
    "--state",
    "State of the device: before, after or without an adjustment.",
    "unchanged",
    type=click.Choice(["as-found", "as-left", "unchanged"]),
)
@params.option("--date/day", "Day of the calibration; default: that of the recording, else of the file.", **_DAY)
@_PLACE
@params.JSON
@params.EVERY
def add(calibration: Path, day: datetime | None, every: bool, place: str, **particulars: Any) -> None:
    """Add a CALIBRATION file and judge it by the limits in force. Exit status 1 if it does not pass."""
    begun = datetime.now(UTC)
    performed = None if day is None else day.replace(tzinfo=UTC)
    with lab.open_registry(place, create=True) as opened:
        record = opened.add_calibration(calibration, performed=performed, **particulars)
        action = "added as" if record.added >= begun else "the same calibration is there already:"
        console.say(f"{action} record {record.number} in {opened.name}")
        for serial in opened.similar(record):
            console.warn(
                f"device {record.serial!r} differs from {serial!r} by case, blanks, O/0 or I/1 alone: the same?"
            )
        passed = _show_record(opened, record, every)
    sys.exit(0 if passed else 1)


def _show_record(opened: Registry, record: Record, every: bool) -> bool:
    """Print a record with its verdict, and return True if it passes."""
    from tumble.lab.registry.registry import logs_of
    from tumble.lab.registry.views import record_blocks

    verdict, calibration = opened.verdict(record), opened.calibration(record)
    logs = [{"session": session, "log_sha256": log} for session, log in logs_of(calibration)]
    content = {"record": record, "launches": logs, "parameters": calibration.parameters, "acceptance": verdict}
    console.show(content, lambda: record_blocks(record, calibration, verdict, every=every))
    if verdict is None or verdict.result == "pass":
        return record.accepted
    for reason in verdict.reasons:
        console.warn(f"{verdict.occasion} check: {reason}")
    return False


@registry.command("list")
@click.argument("serial", required=False)
@_PLACE
@params.JSON
def list_(serial: str | None, place: str) -> None:
    """All devices with their latest record, or the records of the device SERIAL."""
    from tumble.lab.registry.views import device_table, record_table

    with lab.open_registry(place) as opened:
        records = opened.records(serial)
    console.show({"records": records}, lambda: [device_table(records) if serial is None else record_table(records)])


@registry.command
@click.argument("number", type=click.IntRange(1, 10**18), required=False)
@params.option("--type/model", "Show the data sheet of a device type, instead of a record.", metavar="MODEL")
@params.out("Write the calibration file of the record, as it was added, or the data sheet (.html).")
@_PLACE
@params.JSON
@params.EVERY
def show(number: int | None, model: str | None, out: Path | None, every: bool, place: str) -> None:
    """The record NUMBER with the verdict on each parameter, or the data sheet of a device type.

    Exit status 1 if the record does not pass."""
    from tumble.files import whole_file
    from tumble.lab.datasheet import datasheet_blocks, write_datasheet

    if (number is None) == (model is None):
        raise click.UsageError("show: expected the NUMBER of a record or --type MODEL, found none of them or both")
    with lab.open_registry(place) as opened:
        if model is not None:
            sheet = opened.datasheet(model)
            if out is not None:
                write_datasheet(sheet, out, datetime.now(UTC).isoformat(timespec="seconds"))
                console.say(f"written to {out}")
            console.show(sheet, lambda: datasheet_blocks(sheet))
            return
        record = opened.record(number or 0)
        if out is not None:
            _expect_new_file(out, "calibration")
            with whole_file(out) as temporary:
                temporary.write_text(opened.file(record), encoding="utf-8")
            console.say(f"written to {out}")
        passed = _show_record(opened, record, every)
    sys.exit(0 if passed else 1)


@registry.command
@click.argument("serial")
@_PLACE
@params.JSON
@params.EVERY
def trend(serial: str, every: bool, place: str) -> None:
    """Every parameter of the device SERIAL over its calibrations.

    Exit status 1 if the device has changed significantly since the calibration before, in one parameter or in all
    together, as in `tumble compare`."""
    from tumble.lab.registry.views import trend_blocks

    with lab.open_registry(place) as opened:
        result = opened.trend(serial)
    console.show(result, lambda: trend_blocks(result, every=every))
    if result.changed:
        console.say(f"changed: {', '.join(result.changed)}")
    sys.exit(1 if result.changed else 0)


@registry.command
@click.argument("model", required=False)
@click.argument("file", type=params.FILE, required=False)
@_PLACE
@params.JSON
def limits(model: str | None, file: Path | None, place: str) -> None:
    """Put the acceptance limits of FILE (TOML) in force for the device type MODEL.

    Without FILE those of MODEL are shown, without MODEL those of all types are listed."""
    from tumble.lab.registry.views import limits_blocks, limits_table

    begun = datetime.now(UTC)
    with lab.open_registry(place, create=file is not None) as opened:
        if model is not None and file is not None:
            record = opened.set_limits(model, file)
            state = "in force for" if record.added >= begun else "were in force already for"
            console.say(f"limits {record.number} {state} {model} in {opened.name}")
            return
        records = opened.limits()
    shown = [each for each in records if model is None or (each.model == model and each.in_force)]
    if model is not None and not shown:
        raise InputError(f"type {model!r}: expected a device type with limits, found none for it")
    console.show({"limits": shown}, lambda: [limits_table(shown)] if model is None else limits_blocks(shown[0]))


@registry.command
@params.option("--on/day", "Day for which the list is made; default: today.", **_DAY)
@_PLACE
@params.JSON
def due(day: datetime | None, place: str) -> None:
    """When each device is to be calibrated again, the most urgent first.

    A device that failed its latest check is withdrawn until it is calibrated again. Exit status 1 if any device is
    withdrawn or overdue."""
    from tumble.lab.registry.views import due_table

    with lab.open_registry(place) as opened:
        items = opened.due(None if day is None else day.date())
    console.show({"devices": items}, lambda: [due_table(items)])
    for state in ("withdrawn", "overdue"):
        if serials := [item.record.serial for item in items if getattr(item, state)]:
            console.warn(f"{state}: {', '.join(serials)}")
    sys.exit(1 if any(item.withdrawn or item.overdue for item in items) else 0)


@click.command(epilog=params.examples("tumble selftest -o record.json"))
@params.out("Write the record, JSON, with versions, machine, figures and hashes.")
@params.option("--by", "Name of the responsible operator; default: the name of the user.", metavar="NAME")
@params.JSON
def selftest(out: Path | None, by: str | None) -> None:
    """Run the reference cases on this machine and compare them with published values, closed forms and truth."""
    from tumble.lab.selftest import run_selftest, selftest_blocks

    _expect_new_file(out, "record")
    record = run_selftest(by=by, progress=lambda name: console.say(f"running: {name}"))
    console.show(record, lambda: selftest_blocks(record))
    if out is not None:
        record.write(out)
        console.say(f"written to {out}")
    sys.exit(0 if record.passed else 1)
