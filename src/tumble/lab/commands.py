"""The commands `registry`, devices, launches, calibrations and limits over years, and `selftest`."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from tumble.commands import ask, tell
from tumble.errors import InputError

if TYPE_CHECKING:
    from datetime import datetime

    from tumble.lab.registry.store.connect import Registry
    from tumble.lab.registry.types import Record


_DAY: dict[str, Any] = {"type": click.DateTime(["%Y-%m-%d"]), "metavar": "YYYY-MM-DD"}


def _number(ctx: click.Context, parameter: click.Parameter, text: str | None) -> int | None:
    """The number of a record, such as a database can hold."""
    if text is not None and not re.fullmatch(r"0*[1-9][0-9]{0,17}", text):
        said = "expected the number of a record as `tumble registry list` shows it"
        raise click.BadParameter(f"{said}, found {text!r}", ctx, parameter)
    return None if text is None else int(text)


@click.group(epilog=ask.examples("tumble registry add imu-7/calibration.json", "tumble registry due"))
def registry() -> None:
    """Devices, launches, calibrations and acceptance limits over years. Records are added, never changed."""


def _command(name: str, *, opens: bool = True) -> Callable[[Callable[..., None]], click.Command]:
    """A command of the registry, which it gets `opened`, or its `place` where that may be made first; with a line for
    the extra where it is missing."""

    def made(function: Callable[..., None]) -> click.Command:
        @wraps(function)
        def in_registry(*args: Any, place: str | None, **options: Any) -> None:
            from tumble.lab.registry.store.connect import extra_named

            with extra_named():
                from tumble.lab.registry.store.connect import open_registry

                if not opens:
                    function(*args, place=place, **options)
                    return
                with open_registry(place) as opened:
                    function(*args, opened=opened, **options)

        return registry.command(name)(ask.REGISTRY(in_registry))

    return made


def _whole_new_file(out: Path, what: str, lines: Callable[[], Any]) -> None:
    from tumble.files import whole_file

    if out.exists():
        raise InputError(f"{out}: expected a new file for the {what}, found one that exists")
    with whole_file(out) as temporary, temporary.open("w", encoding="utf-8") as file:
        file.writelines(lines())
    tell.say(f"written to {out}")


@_command("add", opens=False)
@click.argument("calibration", type=ask.FILE)
@ask.option("--check/occasion", "Default: incoming the first time.", type=click.Choice(["incoming", "periodic"]))
@ask.option("--state", "Before or after an adjustment, if there is one.", type=click.Choice(["as-found", "as-left"]))
@ask.option("--date/day", "When it was performed; default: when recorded, or the file made.", **_DAY)
@ask.option("--supersedes", "The record that this one corrects.", metavar="NUMBER", callback=_number)
@ask.option("--reason", "Why it is corrected.")
@ask.JSON
@ask.EVERY
def add(
    calibration: Path, day: datetime | None, state: Any, every: bool, place: str | None, **particulars: Any
) -> None:
    """Add a CALIBRATION file, judge it by the limits in force, and say so. Exit status 1 if it does not pass."""
    from datetime import UTC

    from tumble.lab.registry.adding import Particulars, read_submission
    from tumble.lab.registry.adding import add as add_to
    from tumble.lab.registry.store.connect import open_registry

    performed = None if day is None else day.replace(tzinfo=UTC)
    stated = Particulars(performed=performed, state=state or "unchanged", **particulars)
    submission = read_submission(calibration, stated)
    with open_registry(place, create=True) as opened:
        added = add_to(opened, submission)
        said = "added as" if added.new else "the same calibration is there already:"
        tell.say(f"{said} record {added.record.number} in {opened.name}")
        passed = _print_record(opened, added.record, every)
    sys.exit(0 if passed else 1)


def _print_record(opened: Registry, record: Record, every: bool) -> bool:
    """Print a record with the verdict on it, and whether it passes."""
    from tumble.lab.registry.series import calibration_in, verdict_of
    from tumble.views.registry import record_blocks, record_data

    verdict, calibration = verdict_of(opened, record), calibration_in(opened, record, record.frame)
    tell.show(
        lambda: record_data(record, calibration, verdict),
        lambda: record_blocks(record, calibration, verdict, every=every),
    )
    if verdict is None or verdict.result == "pass":
        return True
    for reason in verdict.reasons():
        tell.warn(f"{verdict.occasion} check: {reason}")
    return False


@_command("list")
@click.argument("serial", required=False)
@ask.JSON
def list_(serial: str | None, opened: Registry) -> None:
    """All devices with their latest record, or the records of the device SERIAL."""
    from tumble.lab.registry.due import due as due_of
    from tumble.lab.registry.due import records
    from tumble.views.registry_lists import device_table, devices_data, record_table

    if serial is not None:
        found = records(opened, serial)
        tell.show(lambda: {"records": found}, lambda: [record_table(found)])
        return
    latest = sorted(due_of(opened), key=lambda item: item.record.serial)
    tell.show(lambda: devices_data(latest), lambda: [device_table(latest)])


@_command("show")
@click.argument("number", callback=_number)
@ask.out("Write the calibration file of the record, as it was added.")
@ask.JSON
@ask.EVERY
def show_(number: int, out: Path | None, every: bool, opened: Registry) -> None:
    """The record NUMBER with the verdict on each parameter. Exit status 1 if it does not pass."""
    from tumble.lab.registry.store.rows import file_of, record_of

    with opened.reading() as connection:
        record, text = record_of(connection, number), file_of(connection, number)
    if out is not None:
        _whole_new_file(out, "calibration", lambda: [text])
    passed = _print_record(opened, record, every)
    sys.exit(0 if passed else 1)


@_command("trend")
@click.argument("serial")
@click.argument("parameter", required=False)
@ask.out("Draw control charts into this .html or .svg; needs matplotlib.")
@ask.JSON
@ask.EVERY
def trend(serial: str, parameter: str | None, out: Path | None, every: bool, opened: Registry) -> None:
    """Every parameter of the device SERIAL over its calibrations, or one PARAMETER in every calibration.

    Exit status 1 if the device has changed since the calibration before by more than chance makes, in a parameter or
    in all together, as `tumble compare` says it of both.
    """
    from tumble.lab.registry.monitor import monitored
    from tumble.views.registry import history_blocks, trend_blocks, trend_data

    found = monitored(opened, serial, parameter)
    if out is not None:
        from tumble.views.control_chart import write_chart

        write_chart(out, found)
        tell.say(f"written to {out}")
    tell.show(
        lambda: trend_data(found),
        lambda: trend_blocks(found, every=every) if parameter is None else history_blocks(found),
    )
    changed = found.changed()
    if changed:
        tell.say(f"changed: {', '.join(changed)}")
    sys.exit(1 if changed else 0)


@_command("limits", opens=False)
@click.argument("model", required=False)
@click.argument("file", type=ask.FILE, required=False)
@ask.JSON
def limits(model: str | None, file: Path | None, place: str | None) -> None:
    """Put the acceptance limits of FILE (TOML) in force for the device type MODEL.

    Without FILE those of MODEL are shown, without MODEL those of all types are listed.
    """
    from tumble.lab.limits import read_limits
    from tumble.lab.registry.adding import set_limits
    from tumble.lab.registry.store.connect import open_registry
    from tumble.lab.registry.store.rows import every_limits
    from tumble.views.registry import limits_blocks
    from tumble.views.registry_lists import limits_data, limits_table

    given = None if file is None else read_limits(file)
    with open_registry(place, create=given is not None) as opened:
        if model is not None and given is not None:
            record, new = set_limits(opened, model, *given)
            said = "in force for" if new else "were in force already for"
            tell.say(f"limits {record.number} {said} {record.model} in {opened.name}")
            return
        with opened.reading() as connection:
            every = every_limits(connection)
    in_force = {each.model: each for each in every}
    if model is not None and model not in in_force:
        raise InputError(f"type {model!r}: expected a device type with limits, found none for it")
    tell.show(
        lambda: limits_data(every if model is None else [in_force[model]], in_force),
        lambda: [limits_table(every, in_force)] if model is None else limits_blocks(in_force[model]),
    )


@_command("due")
@ask.option("--on/day", "As on this day; default: today.", **_DAY)
@ask.JSON
def due(day: datetime | None, opened: Registry) -> None:
    """What is to be calibrated again, and when: by the calendar, or before where a drift may meet a limit.

    The most urgent first. Exit status 1 if anything is overdue.
    """
    from datetime import UTC, date, datetime

    from tumble.lab.registry.due import due as due_of
    from tumble.views.registry_lists import due_data, due_table

    today = datetime.now(UTC).date() if day is None else day.date()
    found = due_of(opened)
    tell.show(lambda: due_data(found, today), lambda: [due_table(found, today)])
    overdue = [item.record.serial for item in found if (item.day or date.max) < today]
    tell.end([f"overdue: {', '.join(overdue)}"] if overdue else [])


@_command("datasheet")
@click.argument("model")
@ask.out("File to write: .md, .html or .pdf; default: the terminal.")
@ask.JSON
def datasheet(model: str, out: Path | None, opened: Registry) -> None:
    """What the units of the type MODEL are like: min, typical, max and tolerance intervals of every parameter."""
    from datetime import UTC, datetime

    from tumble.lab.datasheet import datasheet as datasheet_of
    from tumble.views.datasheet import datasheet_blocks, datasheet_data, write_datasheet

    sheet = datasheet_of(opened, model)
    if out is None:
        tell.show(lambda: datasheet_data(sheet), lambda: datasheet_blocks(sheet))
        return
    write_datasheet(sheet, out, datetime.now(UTC).isoformat(timespec="seconds"))
    tell.say(f"written to {out}")


@_command("export")
@ask.out("File to write; default: standard output.")
def export(out: Path | None, opened: Registry) -> None:
    """Everything in the registry as JSON lines."""
    from tumble.lab.registry.exchange import export_lines

    if out is not None:
        _whole_new_file(out, "export", lambda: (f"{line}\n" for line in export_lines(opened)))
        return
    for line in export_lines(opened):
        click.echo(line)


@_command("import", opens=False)
@click.argument("file", type=ask.FILE)
def import_(file: Path, place: str | None) -> None:
    """Add what FILE, an export, holds and the registry does not; nothing of a file that is no whole export."""
    from tumble.lab.registry.exchange import import_export, read_export
    from tumble.lab.registry.store.connect import open_registry

    export = read_export(file)
    with open_registry(place, create=True) as opened:
        done = import_export(opened, export)
        tell.say(f"{done.added} calibrations added to {opened.name}, {done.known} were there already")


@click.command(epilog=ask.examples("tumble selftest -o record.json"))
@ask.out("Write the record, JSON, with versions, machine, figures and hashes.")
@ask.option("--by", "Who runs it and stands for it; default: the name of the user.", metavar="NAME")
def selftest(out: Path | None, by: str | None) -> None:
    """Run the reference cases on this machine and compare them with published values, closed forms and truth."""
    from tumble.lab.selftest import run_selftest
    from tumble.views.checks import selftest_table
    from tumble.views.render.terminal import print_blocks

    if out is not None and out.exists():
        raise InputError(f"{out}: expected a new file for the record, found one that exists; records are kept")
    record = run_selftest(by=by, progress=lambda name: tell.say(f"running: {name}"))
    print_blocks(selftest_table(record))
    click.echo(f"{record.software} on {record.machine['system']}, {record.date}, run by {record.by}")
    click.echo(f"loops over samples: {record.machine['loops']}")
    click.echo("passed" if record.passed else "FAILED")
    if out is not None:
        record.write(out)
        tell.say(f"written to {out}")
    sys.exit(0 if record.passed else 1)
