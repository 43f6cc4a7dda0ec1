"""`tumble budget`: expected errors before anything is measured."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from tumble.commands import ask, tell

if TYPE_CHECKING:
    from tumble.planning.budget import PlannedMethod


@click.command(epilog=ask.examples("tumble budget --grade mems --table-error 0.5 --rest 10"))
@ask.setup(None)
@ask.method(["joint", *ask.BUDGETED_METHODS], None, "Repeat; default: joint, of the linear model all.", multiple=True)
@ask.option("--iterations", "Passes of the methods.", 2, type=click.IntRange(1, 5))
@ask.JSON
def budget(method: tuple[PlannedMethod, ...], iterations: int, as_json: bool, **options: Any) -> None:
    """Expected errors of a calibration before it is made, from the accuracy formulas, and the least possible."""
    from tumble.planning.bounds import bound
    from tumble.planning.budget import budget
    from tumble.views.planning import budget_data, budget_table

    methods = method
    if not methods:
        linear = options["noiseless"] or options["terms"] == "linear"
        methods = tuple(ask.BUDGETED_METHODS) if linear else ()
        methods = methods if options["noiseless"] else ("joint", *methods)
    options["terms"] = options["terms"] or ("full" if methods == ("joint",) else "linear")
    setup = ask.setup_of(options)
    with tell.working("planning"):
        expected = budget(setup, methods=methods, iterations=iterations)
        least = None if options["noiseless"] else bound(setup)
    tell.show(as_json, lambda: budget_data(expected, least), lambda: [budget_table(expected, least)])
    for remark in expected.remarks:
        tell.say(f"note: {remark}")
