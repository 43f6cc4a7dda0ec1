"""`tumble compare`: two calibrations side by side."""

from __future__ import annotations

from pathlib import Path

import click

from tumble.commands import ask, tell


@click.command(epilog=ask.examples("tumble compare last-year.json imu-7/calibration.json"))
@click.argument("first", type=ask.FILE)
@click.argument("second", type=ask.FILE)
@ask.option("--gyro-file", "SECOND is the file of the accelerometers of imu_tk: that of its gyros.", type=ask.FILE)
@ask.JSON
def compare(first: Path, second: Path, gyro_file: Path | None, as_json: bool) -> None:
    """Differences of two calibration files in units of their combined uncertainty, and E_n numbers.

    SECOND may also be a result of Kalibr (YAML, with scale and misalignment) or of imu_tk, for the same readings.

    Exit status 0: the largest |E_n| and χ² are within chance (probability 0.01 of so many, and 0.001); 1: otherwise.
    """
    from tumble.use.compare import compare_calibrations
    from tumble.views.checks import comparison_blocks, comparison_data

    found = compare_calibrations(first, second, gyro=gyro_file)
    tell.show(as_json, lambda: comparison_data(found), lambda: comparison_blocks(found))
    for remark in found.remarks:
        tell.say(f"note: {remark}")
    if found.missing:
        tell.say(f"note: only one of them has {', '.join(found.missing)}")
    tell.end([] if found.agree else ["different: by more than chance and their uncertainties make"])
