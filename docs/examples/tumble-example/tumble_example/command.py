"""A command: `tumble biases calibration.json`."""

from pathlib import Path

import click


@click.command()
@click.argument("calibration", type=click.Path(path_type=Path))
def biases(calibration: Path) -> None:
    """Print the biases of CALIBRATION with their standard uncertainties, SI."""
    import tumble  # imported when the command runs: the list of commands needs none of it

    for parameter in tumble.read_calibration(calibration).parameters:
        if ".bias." in parameter.name and parameter.name.count(".") == 2:
            click.echo(f"{parameter.name}\t{parameter.value:.6g}\t{parameter.u:.2g}\t{parameter.unit}")
