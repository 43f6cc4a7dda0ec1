"""`tumble selftest`: the reference cases on this machine."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from tumble.commands import ask, tell


@click.command(epilog=ask.examples("tumble selftest -o record.json"))
@ask.out("Write the record, JSON, with versions, machine, figures and hashes.")
@ask.option("--by", "Who runs it and stands for it; default: the name of the user.", metavar="NAME")
def selftest(out: Path | None, by: str | None) -> None:
    """Run the reference cases on this machine and compare them with published values, closed forms and truth."""
    from tumble.errors import InputError
    from tumble.selftest import run_selftest
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
