"""`tumble require`: what a wanted accuracy needs."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from tumble.commands.arguments import (
    BUDGETED_METHODS,
    JSON,
    WANT,
    end,
    method_option,
    option,
    setup_of,
    setup_options,
    show,
    working,
)

if TYPE_CHECKING:
    from tumble.planning.budget import PlannedMethod
    from tumble.planning.requirements import BiasEstimator


@click.command()
@setup_options(terms=None)
@WANT
@option("--relative", "Wanted of every group: part of its spread, %.", type=float, metavar="PERCENT")
@method_option(["joint", *BUDGETED_METHODS], "joint", "To use; the others are of the linear model.")
@option("--iterations", "Passes of the method.", 1, type=click.IntRange(1, 5))
@option(
    "--gyro-bias",
    "From all rests, or from one with the axis vertical or along the Earth's axis.",
    "programme",
    type=click.Choice(["programme", "vertical", "polar"]),
)
@JSON
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
    setup = setup_of(options)
    asked = wanted_of(wanted, relative, setup)
    with working("planning"):
        needs = require(asked, setup, method=method, iteration=iterations, gyro_bias=gyro_bias)
    show(as_json, lambda: requirements_data(needs), lambda: requirement_blocks(needs))
    end([] if needs.feasible else ["not feasible: no table gives everything that is wanted; see what is limited"])
