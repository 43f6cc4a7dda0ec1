"""The best a programme allows, the best next position, and programmes beside each other, for one set-up."""

from __future__ import annotations

from dataclasses import dataclass, replace

from tumble.brief import Brief
from tumble.planning.best_positions import (
    Aim,
    Compared,
    Next,
    Progress,
    compared,
    next_positions,
    of_the_literature,
    optimised,
    untold,
)
from tumble.planning.bounds import Bound, bound, stated
from tumble.planning.reachable_attitudes import ANY, TurnTable
from tumble.planning.setup import Setup, check_setup, with_all_groups

FOR_ALL = Aim()
"""The mean uncertainty of all parameters in units of their spreads, gyros included."""


@dataclass(frozen=True, kw_only=True, slots=True, repr=False)
class PlanResult(Brief):
    """What a set-up's programme can show at best, of the linear model, and what `calibrate` will state of the `whole`
    instrument. `following`
    are the positions it would gain most by, where it was given; `programmes` the programme that was found and those of
    the literature, where one was to be found."""

    setup: Setup
    bound: Bound
    whole: Bound
    following: tuple[Next, ...]
    programmes: tuple[Compared, ...]


def plan(
    setup: Setup,
    *,
    positions: int | None = None,
    aim: Aim = FOR_ALL,
    table: TurnTable = ANY,
    progress: Progress = untold,
) -> PlanResult:
    """The least uncertainty that the programme of a set-up allows, and the best next positions on a table; with
    `positions` the best programme of so many that is found, beside those of the literature, its search told to
    `progress`. Raises InputError for values that make no sense, and where there is no noise.

    >>> import tumble
    >>> setup = tumble.Setup.of(rest=120.0)
    >>> found = tumble.plan(setup)
    >>> len(found.following), found.bound.groups[0]
    (5, 'accel.bias')
    """
    check_setup(setup, 1)
    if positions is None:
        return PlanResult(
            setup=setup,
            bound=bound(setup, gyros=aim.gyros),
            whole=stated(with_all_groups(setup), gyros=aim.gyros),
            following=next_positions(setup, aim, table),
            programmes=(),
        )
    setup = replace(setup, programme=optimised(setup, positions, aim, table, progress))
    rows = compared(setup, (setup.programme, *of_the_literature()), aim)
    whole = stated(with_all_groups(setup), gyros=aim.gyros)
    return PlanResult(setup=setup, bound=rows[0].bound, whole=whole, following=(), programmes=rows)
