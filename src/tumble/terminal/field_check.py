"""A field check, as text."""

from __future__ import annotations

from collections.abc import Mapping

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from tumble.calibration.check import FieldCheck
from tumble.estimation.field_check import CHANCE, CheckResult
from tumble.sensors.parameters import group_name, group_of, positions_by_group, shown_in
from tumble.terminal.table import add_numbers, plain_table
from tumble.terminal.text import probability_text
from tumble.units import rounded, two_digits


def field_check_report(check: FieldCheck) -> RenderableType:
    """What each parameter would have changed by, alone, what would have been found, and the verdict."""
    result = check.result
    turns = f" and {check.turns} turns" if check.turns else ", no turns"
    parts: list[RenderableType] = [Text(f"{check.rests} rests{turns}"), Text("")]
    if result.tests:
        parts += [_table(result), Text(""), Text(_largest(result))]
    parts.append(
        Text(
            f"what no change explains: χ² {result.misfit.chi_square:.1f} for {result.misfit.degrees:.0f}, by chance "
            f"with probability {probability_text(result.misfit.probability)}"
        )
    )
    unseen = _unseen(check)
    if unseen:
        parts.append(Text(f"not seen by these rests: {', '.join(unseen)}"))
    parts.append(Text(_not_shown(result) if check.valid else "changed"))
    return Group(*parts)


def _largest(result: CheckResult) -> str:
    usual = 100.0 * (1.0 - CHANCE)
    return (
        f"largest |change|/u {result.largest:.2f}, at most {result.limit:.2f} in {usual:.1f} of 100 checks where "
        "nothing has changed"
    )


def _table(result: CheckResult) -> Table:
    """Each parameter as if it alone had changed, in the unit of its group."""
    table = plain_table("parameter")
    add_numbers(table, "change", "u (k=1)", "change/u", "detectable")
    table.add_column("unit")
    units = _units(result.detectable)
    for name, (change, u) in result.tests.items():
        size, unit = units[group_name(name)]
        value, uncertainty = rounded(change / size, u / size)
        least = rounded(0.0, result.detectable[name] / size)[1]
        table.add_row(name, value, uncertainty, f"{change / u:+z.2f}", least, unit)
    return table


def _not_shown(result: CheckResult) -> str:
    """How large a change of each group may be that these rests do not show: the largest of its sensors."""
    units = _units(result.detectable)
    largest: dict[str, float] = {}
    for name, size in result.detectable.items():
        largest[group_name(name)] = max(size, largest.get(group_name(name), 0.0))
    sizes = (f"{group} {two_digits(size / units[group][0])} {units[group][1]}" for group, size in largest.items())
    return f"no change is shown, and none larger than\n{', '.join(sizes)}"


def _units(detectable: Mapping[str, float]) -> dict[str, tuple[float, str]]:
    """The unit of each group, by its smallest change that is found."""
    return {
        group: shown_in(group, group_of(group).unit, min(list(detectable.values())[i] for i in members))
        for group, members in positions_by_group(detectable).items()
    }


def _unseen(check: FieldCheck) -> list[str]:
    """Groups of the linear model no parameter of which the session sees."""
    names = check.instrument.names[: check.instrument.linear_count]
    seen = {group_name(name) for name in check.result.tests}
    return [group for group in positions_by_group(names) if group not in seen]
