"""`tumble require`: what a wanted accuracy needs."""

from __future__ import annotations

import sys
from functools import partial
from typing import TYPE_CHECKING, Any

import click

from tumble.commands.arguments import BUDGETED_METHODS, JSON, setup_of, setup_options, warn, working

if TYPE_CHECKING:
    from tumble.planning.budget import PlannedMethod
    from tumble.planning.requirements import BiasEstimator


@click.command()
@partial(setup_options, terms=None)
@click.option("--want", "wanted", multiple=True, metavar="GROUP=VALUE", help="E.g. accel.scale=3.5ppm; repeat.")
@click.option("--relative", type=float, metavar="PERCENT", help="Wanted of every group: part of its spread, %.")
@click.option(
    "--method",
    type=click.Choice(["joint", *BUDGETED_METHODS]),
    default="joint",
    show_default=True,
    help="To use; the others are of the linear model.",
)
@click.option("--iterations", type=click.IntRange(1, 5), default=1, show_default=True, help="After so many passes.")
@click.option(
    "--gyro-bias",
    type=click.Choice(["programme", "vertical", "polar"]),
    default="programme",
    show_default=True,
    help="From all rests, or from one with the axis vertical or along the Earth's axis.",
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
    from tumble.views.render.data import print_data
    from tumble.views.render.terminal import print_blocks

    options["terms"] = options["terms"] or ("full" if method == "joint" else "linear")
    setup = setup_of(options)
    asked = wanted_of(wanted, relative, setup)
    with working("planning"):
        needs = require(asked, setup, method=method, iteration=iterations, gyro_bias=gyro_bias)
    if as_json:
        print_data(requirements_data(needs))
    else:
        print_blocks(*requirement_blocks(needs))
    if not needs.feasible:
        warn("not feasible: no table gives everything that is wanted; see what is limited")
    sys.exit(0 if needs.feasible else 1)
