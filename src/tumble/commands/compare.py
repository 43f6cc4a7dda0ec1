"""`tumble compare`: two calibrations side by side."""

from __future__ import annotations

from pathlib import Path

import click

from tumble.commands.arguments import FILE, JSON, end, option, say, show


@click.command()
@click.argument("first", type=FILE)
@click.argument("second", type=FILE)
@option("--gyro-file", "SECOND is the file of the accelerometers of imu_tk: that of its gyros.", type=FILE)
@JSON
def compare(first: Path, second: Path, gyro_file: Path | None, as_json: bool) -> None:
    """Differences of two calibration files in units of their combined uncertainty, and E_n numbers.

    SECOND may also be a result of Kalibr (YAML, with scale and misalignment) or of imu_tk, for the same readings.

    Exit status 0: the largest |E_n| and χ² are within chance (probability 0.01 of so many, and 0.001); 1: otherwise.
    """
    from tumble.use.compare import compare_calibrations
    from tumble.views.checks import comparison_blocks, comparison_data

    found = compare_calibrations(first, second, gyro=gyro_file)
    show(as_json, lambda: comparison_data(found), lambda: comparison_blocks(found))
    for remark in found.remarks:
        say(f"note: {remark}")
    if found.missing:
        say(f"note: only one of them has {', '.join(found.missing)}")
    end([] if found.agree else ["different: by more than chance and their uncertainties make"])
