"""`tumble campaign`: many simulated calibrations over a grid."""

from __future__ import annotations

from pathlib import Path

import click

from tumble.commands.arguments import FILE, cluster_options, task_progress
from tumble.errors import TumbleError


@click.command()
@click.argument("file", metavar="FILE.toml", type=FILE)
@cluster_options
def campaign(file: Path, serial: bool, cluster: str | None, workers: int | None, out: Path) -> None:
    """Simulate and calibrate many times over the grid of FILE.toml: errors against the truth, their ratio to the
    Cramér–Rao bound, coverage, failures.

    A campaign that was interrupted goes on where it was when the same command is given again.
    """
    from tumble.campaigns.campaign import read_campaign, run_campaign
    from tumble.campaigns.cluster import executor_for
    from tumble.campaigns.summary import summary, write_summary
    from tumble.report.campaign_picture import plot
    from tumble.terminal.campaign import summary_report
    from tumble.terminal.text import print_report

    planned = read_campaign(file)
    place = executor_for(serial=serial, cluster=cluster, workers=workers)
    with task_progress("trials") as progress, place as executor:
        rows = run_campaign(planned, out, executor=executor, progress=progress)
    lines = summary(rows)
    write_summary(lines, out / "summary.csv")
    print_report(summary_report(lines))
    written = [rows.name, "summary.csv"]
    try:
        plot(lines, out / "rms.svg")
        written.append("rms.svg")
    except TumbleError as error:
        click.echo(f"not drawn: {error}", err=True)
    click.echo(f"written to {out}: {', '.join(written)}", err=True)
