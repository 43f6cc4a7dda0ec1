"""Commands that write what is passed on: `report`, `export`."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import click

from tumble.commands import ask, tell
from tumble.errors import InputError

_IDS = ask.Numbers("the numbers in CAL_ACC0_ID and CAL_GYRO0_ID with a comma between", int, count=2)
_COUNTS = ask.Numbers("counts a g and a deg/s with a comma between", count=2, above=0.0)


@click.command(
    epilog=ask.examples(
        "tumble report imu-7/calibration.json -o imu-7.html",
        "tumble report imu-7/calibration.json -o imu-7.pdf --certificate certificate.toml",
    )
)
@click.argument("calibrations", metavar="CALIBRATION...", type=ask.FILE, nargs=-1, required=True)
@ask.out("File to write: .html; of a certificate also .pdf.", required=True)
@ask.option("--limits", "Acceptance limits (TOML): judge every parameter by them.", type=ask.FILE)
@ask.CERTIFICATE
def report(calibrations: tuple[Path, ...], out: Path, limits: Path | None, certificate: Path | None) -> None:
    """Report of a calibration, or of several of one device: a page that needs nothing else and prints well."""
    from types import FunctionType

    from tumble.plugins import load
    from tumble.views.report.document import write_report

    if limits is not None and certificate is not None:
        raise InputError("--limits: expected none with --certificate, whose file names the limits, found one")
    write, file = write_report, limits or certificate
    if file is not None:  # what the laboratory adds
        kind = "limits" if limits is not None else "certificate"
        found = load("reports", kind, FunctionType)
        if found is None:
            raise InputError(f"--{kind}: expected the reports of `tumble.lab`, found none; install tumble anew")
        write = partial(found, **{kind: file})
    reasons = write(calibrations, out)
    tell.say(f"written to {out}")
    tell.end(reasons, "not accepted: ")


class _ExportCommand(click.Command):
    """A command whose help lists the export targets with a few words on each."""

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        from tumble.export import described_targets

        super().format_options(ctx, formatter)
        with formatter.section("Targets"):
            formatter.write_dl([*described_targets()])


class _Target(click.ParamType[str]):
    """Name of an export target."""

    name = "target"

    def shell_complete(
        self, ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> list[click.shell_completion.CompletionItem]:
        from tumble.export import targets

        del ctx, param
        return [click.shell_completion.CompletionItem(name) for name in targets() if name.startswith(incomplete)]


@click.command(
    cls=_ExportCommand,
    epilog=ask.examples(
        "tumble export imu-7/calibration.json --to px4 -o imu-7.params",
        "tumble export imu-7/calibration.json --template slowfly.tmpl -o imu-7.cfg",
    ),
)
@click.argument("calibration", type=ask.FILE)
@ask.option("--to", "Format of the file, see below.", type=_Target())
@ask.option("--template", "A template of your own instead.", type=ask.FILE)
@ask.out("File to write.", required=True)
@ask.option("--noise", "kalibr: noise from this session's longest rest.", metavar="SESSION", type=ask.PATH)
@ask.CERTIFICATE
@ask.option("--imu", "px4, ardupilot, also thermal: of the N-th IMU, from 1.", metavar="N", type=int)
@ask.option(
    "--sensor-ids", "px4-thermal: the numbers in CAL_ACC0_ID and CAL_GYRO0_ID.", metavar="ACCEL,GYRO", type=_IDS
)
@ask.option(
    "--counts",
    "iNav, Betaflight, …: counts a g and a °/s; default: the recording's.",
    metavar="ACCEL,GYRO",
    type=_COUNTS,
)
@ask.force()
def export(calibration: Path, to: str | None, template: Path | None, out: Path, force: bool, **options: Any) -> None:
    """Write CALIBRATION, a calibration file, in the format of another program.

    What that format has no place for is said on standard error, and in the file where it has comments.
    """
    from tumble.export import export_calibration
    from tumble.files import whole_file

    if out.exists() and not force:
        raise InputError(f"{out}: expected a new file, found one that exists; give --force to replace it")
    exported = export_calibration(calibration, to, template=template, **options)
    with whole_file(out) as temporary:
        temporary.write_bytes(exported.content)
    tell.say(f"written to {out}")
    for loss in exported.losses:
        tell.say(f"note: {loss}")
