"""Formatting of numbers and names: units, values with uncertainties, tables of quantities.

Cells of tables have a hyphen as minus and are empty without a number; sentences of a page have a real minus (`fixed`,
`significant`).
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Collection, Iterable, Mapping
from typing import Protocol, TypeVar

from tumble.result.coverage import expanded_of
from tumble.result.parts import Estimated, Parameter
from tumble.sensors.parameters import group_name, shown_in
from tumble.units import engineering, rounded, two_digits
from tumble.views.blocks import Table, table

NONE = "—"  # on a page, in place of a number
FROM_DATA = "from data"  # heading of `Parameter.learned`, by which part the data reduced the variance of the prior


class Named(Protocol):
    """Object with the name of a parameter."""

    @property
    def name(self) -> str: ...


class Quantity(Named, Protocol):
    """Object with name, value and unit, SI: a parameter of a calibration or of a registry."""

    @property
    def value(self) -> float: ...
    @property
    def unit(self) -> str: ...


Q = TypeVar("Q", bound=Named)
Units = Mapping[str, tuple[float, str]]
"""Display unit of each quantity by its name: (size in SI, name of the unit)."""


def shown_units(quantities: Iterable[Quantity]) -> Units:
    """Return the display unit of each quantity, the same within a group, by the root mean square of its values."""
    return units_of_values((q.name, q.value, q.unit) for q in quantities)


def units_of_values(values: Iterable[tuple[str, float, str]]) -> Units:
    """Return the display units of (name, value, SI unit); a name may have several values."""
    groups = defaultdict[str, list[tuple[str, float, str]]](list)
    for value in values:
        groups[group_name(value[0])].append(value)
    units: dict[str, tuple[float, str]] = {}
    for group, members in groups.items():
        rms = math.sqrt(sum(value**2 for _, value, _ in members) / len(members))
        units |= dict.fromkeys((name for name, _, _ in members), shown_in(group, members[0][2], rms))
    return units


def cells(value: float | None, u: float | None, size: float = 1.0) -> tuple[str, str]:
    """Format a value and its uncertainty in a unit of this size, both to the second significant digit of the
    uncertainty; a value without uncertainty to six digits."""
    if value is None:
        return "", ""
    if u is None:
        return f"{value / size:.6g}", ""
    return rounded(value / size, u / size)


def to_digits_of(value: float | None, u: float | None, size: float) -> str:
    """Format a value to the second significant digit of an uncertainty, in a unit of this size."""
    return cells(value, u or 0.0, size)[0]


def quantity_table(
    quantities: Iterable[Q],
    units: Units,
    row: Callable[[Q, float, str], dict[str, str]],
    *,
    name: str = "parameter",
    words: Collection[str] = (),
    caption: str = "",
    dense: bool = False,
    halves: bool = False,
) -> Table:
    """Return a table with one row for each quantity; without quantities it has no columns.

    `units` are display units by name (`shown_units`, `units_of_values`). `row` is called with a quantity, the size of
    its display unit in SI and the name of the unit, and returns the cells after the name by heading. `name` is the
    heading of the names, `words` are headings of columns of words beside "unit"; for the others see `Table`."""
    rows = [{name: q.name} | row(q, *units[q.name]) for q in quantities]
    return table(rows, words={name, "unit", *words}, caption=caption, dense=dense, halves=halves)


def in_engineering(unit: str, value: float, digits: int = 3) -> str:
    """Format a quantity of an SI unit with an engineering unit; a dash if infinite."""
    size, shown = engineering(unit, value)
    return f"{value / size:.{digits}g} {shown}" if math.isfinite(value) else "–"


def probability_text(probability: float) -> str:
    """Format a probability to two digits, without rounding up to 1."""
    return "above 0.99" if probability > 0.99 else "below 1e-99" if probability < 1e-99 else f"{probability:.2g}"


def percent(fraction: float | None) -> str:
    """Format a fraction in whole per cent."""
    return "" if fraction is None else f"{100.0 * fraction:.0f} %"


def minus(text: str) -> str:
    """Replace hyphens by real minuses."""
    return text.replace("-", "−")


def fixed(value: float, digits: int) -> str:
    """Format a number with so many decimals and a real minus, without negative zero."""
    return minus(f"{value:z.{digits}f}")


def significant(value: float, digits: int) -> str:
    """Format a number with so many significant digits and a real minus, if necessary with a power of ten."""
    mantissa, _, exponent = f"{value:.{digits}g}".partition("e")
    superscript = str(int(exponent or 0)).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
    return minus(mantissa) + (f"·10{superscript}" if exponent else "")


def limit_cell(value: float, size: float) -> str:
    """Format an acceptance limit in a unit of this size; empty if infinite."""
    return f"{value / size:.6g}" if math.isfinite(value) else ""


def with_expanded(quantity: Estimated, size: float) -> tuple[str, str]:
    """Format value and U in a unit of this size, to the second digit of U; to that of u if no U is stated."""
    U = None if quantity.u is None else expanded_of(quantity.u, quantity.dof)
    if U is None:
        return cells(quantity.value, quantity.u, size)[0], ""
    return cells(quantity.value, U, size)


def run_to_run(deviation: float | None, size: float) -> str:
    """Format a standard deviation from launch to launch to two digits of its own; empty without one."""
    return "" if deviation is None else two_digits(deviation / size)


def factor(parameter: Parameter) -> str:
    """Format the coverage factor; empty if no U is stated."""
    return "" if parameter.k is None else f"{parameter.k:.2f}"


def degrees(parameter: Parameter) -> str:
    """Format the degrees of freedom of u."""
    return "∞" if parameter.dof is None else f"{parameter.dof:.{1 if parameter.dof < 100.0 else 0}f}"


def unit_text(unit: str) -> str:
    """Format an SI unit with superscript exponents and dots: m/s², rad·s/m."""
    return unit.translate({ord("^"): None, ord("*"): "·"} | dict(zip(map(ord, "234"), "²³⁴", strict=True)))


def device_name(serial: str, model: str | None) -> str:
    """Return the serial number of a device with its type."""
    return serial if model is None else f"{serial} ({model})"
