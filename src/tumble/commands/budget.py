"""`tumble budget`: expected errors before anything is measured."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import click

from tumble.commands.arguments import BUDGETED_METHODS, JSON, say, setup_of, setup_options, working

if TYPE_CHECKING:
    from tumble.planning.budget import PlannedMethod


@click.command()
@partial(setup_options, terms=None)
@click.option(
    "--method",
    "methods",
    type=click.Choice(["joint", *BUDGETED_METHODS]),
    multiple=True,
    help="Repeat; default: joint, of the linear model all.",
)
@click.option("--iterations", type=click.IntRange(1, 5), default=2, show_default=True, help="Passes.")
@JSON
def budget(methods: tuple[PlannedMethod, ...], iterations: int, as_json: bool, **options: Any) -> None:
    """Expected errors of a calibration before it is made, from the accuracy formulas, and the least possible."""
    from tumble.planning.bounds import bound
    from tumble.planning.budget import budget
    from tumble.views.planning import budget_data, budget_table
    from tumble.views.render.data import print_data
    from tumble.views.render.terminal import print_blocks

    if not methods:
        linear = options["noiseless"] or options["terms"] == "linear"
        methods = tuple(BUDGETED_METHODS) if linear else ()
        methods = methods if options["noiseless"] else ("joint", *methods)
    options["terms"] = options["terms"] or ("full" if methods == ("joint",) else "linear")
    setup = setup_of(options)
    with working("planning"):
        expected = budget(setup, methods=methods, iterations=iterations)
        least = None if options["noiseless"] else bound(setup)
    if as_json:
        print_data(budget_data(expected, least))
    else:
        print_blocks(budget_table(expected, least))
    for remark in expected.remarks:
        say(f"note: {remark}")
