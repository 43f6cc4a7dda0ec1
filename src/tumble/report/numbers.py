"""Numbers of a report as text: a real minus, digits by the uncertainty, the units of the trade."""

from __future__ import annotations

import math

from tumble.calibration.coverage import expanded
from tumble.calibration.results import Parameter
from tumble.units import rounded

NONE = "—"


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


def with_expanded(parameter: Parameter, size: float) -> tuple[str, str]:
    """Value and U of a parameter in a unit of this size, to the second significant digit of U."""
    if parameter.k is None:
        return with_standard(parameter, size)[0], NONE
    return _with(parameter, parameter.k, size)


def factor(parameter: Parameter) -> str:
    """The coverage factor, where U is stated."""
    return NONE if parameter.k is None else fixed(parameter.k, 2)


def degrees(parameter: Parameter) -> str:
    """The degrees of freedom of u; infinite where it is known."""
    return "∞" if parameter.dof is None else fixed(parameter.dof, 1 if parameter.dof < 100.0 else 0)


def limit_of(value: float, size: float) -> str:
    """An acceptance limit in a unit of this size, where there is one."""
    return minus(f"{value / size:.6g}") if math.isfinite(value) else NONE


def with_standard(parameter: Parameter, size: float) -> tuple[str, str]:
    """Value and u of a parameter in a unit of this size, to the second significant digit of u."""
    return _with(parameter, 1.0, size)


def _with(parameter: Parameter, factor: float, size: float) -> tuple[str, str]:
    """Value and `factor` u, to the second significant digit of the latter; never a negative zero."""
    if parameter.u is None:
        return significant(parameter.value / size, 6), NONE
    value, u = rounded(parameter.value / size, factor * parameter.u / size)
    return minus(value if float(value) else value.lstrip("-")), u


def as_value(number: float | None, parameter: Parameter, size: float) -> str:
    """Another number of a parameter, to the digits of its U."""
    if number is None:
        return NONE
    return minus(rounded(number / size, (expanded(parameter) or 0.0) / size)[0])
