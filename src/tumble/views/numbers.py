"""Numbers and names as text: one choice of units, one formatting of a value and its uncertainty.

Cells of tables have a hyphen for a minus and nothing where a number is not known; sentences of a page have a real minus
(`fixed`, `significant`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Mapping
from typing import Protocol, TypeVar

from tumble.result.coverage import expanded_of
from tumble.result.parts import Estimated, Parameter
from tumble.sensors.parameters import group_name, shown_in
from tumble.units import engineering, rounded
from tumble.views.blocks import Table, table

NONE = "—"
"""What a page shows where there is no number."""


class Named(Protocol):
    """What has the name of a parameter."""

    @property
    def name(self) -> str: ...


class Quantity(Named, Protocol):
    """What has a value and a unit too, SI: a parameter of a calibration or of a registry."""

    @property
    def value(self) -> float: ...
    @property
    def unit(self) -> str: ...


Q = TypeVar("Q", bound=Named)
Units = Mapping[str, tuple[float, str]]
"""The unit in which each quantity is shown, by its name: (size in SI, name of the unit)."""


def shown_units(quantities: Iterable[Quantity]) -> Units:
    """The unit in which each quantity is shown: one for all of a group, by their root mean square."""
    return units_of_values((q.name, q.value, q.unit) for q in quantities)


def units_of_values(values: Iterable[tuple[str, float, str]]) -> Units:
    """The same of names with values and their SI unit; a name may have several values."""
    groups: dict[str, list[tuple[str, float, str]]] = {}
    for value in values:
        groups.setdefault(group_name(value[0]), []).append(value)
    units: dict[str, tuple[float, str]] = {}
    for group, members in groups.items():
        rms = math.sqrt(sum(value**2 for _, value, _ in members) / len(members))
        units |= dict.fromkeys((name for name, _, _ in members), shown_in(group, members[0][2], rms))
    return units


def cells(value: float | None, u: float | None, size: float = 1.0) -> tuple[str, str]:
    """A value and its uncertainty (standard or expanded) in a unit of this size, both to the second significant digit
    of the uncertainty; without one the value to six digits."""
    if value is None:
        return "", ""
    if u is None:
        return f"{value / size:.6g}", ""
    return rounded(value / size, u / size)


def to_digits_of(value: float | None, u: float | None, size: float) -> str:
    """Another number of a quantity, to the digits of its uncertainty."""
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
    """A table with one row for each quantity, which begins with its name; without quantities it has no columns, and
    nothing of it is shown.

    `units` are those in which each is shown, by its name (`shown_units`, `units_of_values`); `row` gives the further
    cells of a quantity by their headings, from the quantity, the size in SI of its unit, and the name of this unit.
    `name` is the heading of the names, `words` are those of further columns of words beside "unit"."""
    rows = [{name: q.name} | row(q, *units[q.name]) for q in quantities]
    return table(rows, words={name, "unit", *words}, caption=caption, dense=dense, halves=halves)


def in_engineering(unit: str, value: float, digits: int = 3) -> str:
    """A quantity of an SI unit to so many digits, with the engineering unit of its size; a dash if infinite."""
    size, shown = engineering(unit, value)
    return f"{value / size:.{digits}g} {shown}" if math.isfinite(value) else "–"


def probability_text(probability: float) -> str:
    """A probability to two digits, none as if it were 1."""
    return "above 0.99" if probability > 0.99 else f"{probability:.2g}"


def percent(fraction: float | None) -> str:
    """A fraction in whole %."""
    return "" if fraction is None else f"{100.0 * fraction:.0f} %"


def minus(text: str) -> str:
    """A number with a real minus."""
    return text.replace("-", "−")


def fixed(value: float, digits: int) -> str:
    """A number with so many digits behind the point; never a negative zero."""
    return minus(f"{value:z.{digits}f}")


def significant(value: float, digits: int) -> str:
    """A number with so many significant digits, a small or large one with a power of ten."""
    mantissa, _, exponent = f"{value:.{digits}g}".partition("e")
    return minus(mantissa) + (f"·10{raised(int(exponent))}" if exponent else "")


def raised(exponent: int) -> str:
    """An exponent as it stands above the line."""
    return str(exponent).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))


def limit_cell(value: float, size: float) -> str:
    """An acceptance limit in a unit of this size, where there is one."""
    return f"{value / size:.6g}" if math.isfinite(value) else ""


def with_expanded(quantity: Estimated, size: float) -> tuple[str, str]:
    """Value and U in a unit of this size, to the second significant digit of U; where none is stated to that of u."""
    U = None if quantity.u is None else expanded_of(quantity.u, quantity.dof)
    if U is None:
        return cells(quantity.value, quantity.u, size)[0], ""
    return cells(quantity.value, U, size)


def factor(parameter: Parameter) -> str:
    """The coverage factor, where U is stated."""
    return "" if parameter.k is None else f"{parameter.k:.2f}"


def degrees(parameter: Parameter) -> str:
    """The degrees of freedom of u; infinite where it is known."""
    return "∞" if parameter.dof is None else f"{parameter.dof:.{1 if parameter.dof < 100.0 else 0}f}"


def unit_text(unit: str) -> str:
    """An SI unit with its exponents above the line and products with a dot: m/s², rad·s/m."""
    return unit.translate({ord("^"): None, ord("*"): "·"} | dict(zip(map(ord, "24"), "²⁴", strict=True)))


def device_name(serial: str, model: str | None) -> str:
    """A device by its serial number, with its type."""
    return serial if model is None else f"{serial} ({model})"
