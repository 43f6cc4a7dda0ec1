"""Commands that write a calibration for others: `report`, `export`."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import click

from tumble.commands import console, params
from tumble.errors import InputError

_IDS = params.Numbers("the numbers in CAL_ACC0_ID and CAL_GYRO0_ID with a comma between", int, count=2)
_COUNTS = params.Numbers("counts a g and a deg/s with a comma between", count=2, above=0.0)


@click.command(
    epilog=params.examples(
        "tumble report imu-7/calibration.json -o imu-7.html",
        "tumble report imu-7/calibration.json -o imu-7.pdf --certificate certificate.toml",
    )
)
@click.argument("calibrations", metavar="CALIBRATION...", type=params.FILE, nargs=-1, required=True)
@params.out("File to write: .html; for a certificate also .pdf.", required=True)
@params.option("--limits", "Acceptance limits (TOML): judge every parameter by them.", type=params.FILE)
@params.CERTIFICATE
def report(calibrations: tuple[Path, ...], out: Path, limits: Path | None, certificate: Path | None) -> None:
    """Report of one or several calibrations of a device: a self-contained page that prints well."""
    from types import FunctionType

    from tumble.plugins import load
    from tumble.views.report.document import write_report

    if limits is not None and certificate is not None:
        raise InputError("--limits: expected none with --certificate, whose file names the limits, found one")
    write, file = write_report, limits or certificate
    if file is not None:
        kind = "limits" if limits is not None else "certificate"
        found = load("reports", kind, FunctionType)
        if found is None:
            raise InputError(f"--{kind}: expected the reports of `tumble.lab`, found none; install tumble anew")
        write = partial(found, **{kind: file})
    reasons = write(calibrations, out)
    console.say(f"written to {out}")
    console.end(reasons)


class _ExportCommand(click.Command):
    """A command whose help lists and describes the export targets."""

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
    epilog=params.examples(
        "tumble export imu-7/calibration.json --to px4 -o imu-7.params",
        "tumble export imu-7/calibration.json --template slowfly.tmpl -o imu-7.cfg",
    ),
)
@click.argument("calibration", type=params.FILE)
@params.option("--to", "Format of the file, see below.", type=_Target())
@params.option("--template", "Your own template, instead of --to.", type=params.FILE)
@params.out("File to write.", required=True)
@params.option("--noise", "kalibr: noise from this session's longest rest.", metavar="SESSION", type=params.PATH)
@params.CERTIFICATE
@params.option("--imu", "px4, ardupilot, also -thermal: number of the IMU, from 1.", metavar="N", type=int)
@params.option(
    "--sensor-ids", "px4-thermal: the numbers in CAL_ACC0_ID and CAL_GYRO0_ID.", metavar="ACCEL,GYRO", type=_IDS
)
@params.option(
    "--counts",
    "iNav, Betaflight, …: counts per g and per °/s; default: those of the recording.",
    metavar="ACCEL,GYRO",
    type=_COUNTS,
)
@params.force()
def export(calibration: Path, to: str | None, template: Path | None, out: Path, force: bool, **options: Any) -> None:
    """Write CALIBRATION, a calibration file, in the format of another program.

    What the format cannot hold is listed on standard error, and in comments of the file if it has comments.
    Exit status 1 if a certificate in it states that not everything passes."""
    from tumble.export import export_calibration
    from tumble.files import whole_file

    if out.exists() and not force:
        raise InputError(f"{out}: expected a new file, found one that exists; give --force to replace it")
    exported = export_calibration(calibration, to, template=template, **options)
    with whole_file(out) as temporary:
        temporary.write_bytes(exported.content)
    console.say(f"written to {out}")
    for loss in exported.losses:
        console.say(f"note: {loss}")
    console.end(exported.reasons)
