"""`tumble require`: what a wanted accuracy needs."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from tumble.commands import ask, tell

if TYPE_CHECKING:
    from tumble.planning.budget import PlannedMethod
    from tumble.planning.requirements import BiasEstimator


@click.command(epilog=ask.examples("tumble require --want accel.scale=3.5ppm"))
@ask.setup(None)
@ask.WANT
@ask.option("--relative", "Wanted of every group: part of its spread, %.", type=float, metavar="PERCENT")
@ask.method(["joint", *ask.BUDGETED_METHODS], "joint", "To use; the others are of the linear model.")
@ask.option("--iterations", "Passes of the method.", 1, type=click.IntRange(1, 5))
@ask.option(
    "--gyro-bias",
    "From all rests, or from one with the axis vertical or along the Earth's axis.",
    "programme",
    type=click.Choice(["programme", "vertical", "polar"]),
)
@ask.JSON
def require(
    wanted: tuple[str, ...],
    relative: float | None,
    method: PlannedMethod,
    iterations: int,
    gyro_bias: BiasEstimator,
    as_json: bool,
    **options: Any,
) -> None:
    """The table, the mounting and the rests that a wanted accuracy needs; what no table can give is named."""
    from tumble.planning.requirements import require, wanted_of
    from tumble.views.planning import requirement_blocks, requirements_data

    options["terms"] = options["terms"] or ("full" if method == "joint" else "linear")
    setup = ask.setup_of(options)
    asked = wanted_of(wanted, relative, setup)
    with tell.working("planning"):
        needs = require(asked, setup, method=method, iteration=iterations, gyro_bias=gyro_bias)
    tell.show(as_json, lambda: requirements_data(needs), lambda: requirement_blocks(needs))
    tell.end([] if needs.feasible else ["not feasible: no table gives everything that is wanted; see what is limited"])
