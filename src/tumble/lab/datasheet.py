"""Data sheet of a device type: the distribution of its units in the registry, parameter by parameter.

For the n units of a parameter, each estimated from its own recording (`Unit.estimates`): the least, the mean and the
largest value, their standard deviation s, and the interval that contains 95 % of all units of the type with 95 %
confidence if they are normally distributed,

    x̄ ± k s,   k:  √(2n/π) ∫₀^∞ P(χ²_{n−1} > (n − 1) r²(z)/k²) e^{−n z²/2} dz = 0.95                               (1)

where r²(z) is the 0.95 quantile of the noncentral χ² with one degree of freedom and noncentrality z². In-run biases are
standard deviations, so their logarithms are used. s includes u, the uncertainty that the recordings leave.

The terms are those of IEEE Std 2700 for parameters of MEMS sensors, as far as its definitions are public. An in-run
bias is not the bias instability, which is flicker noise, but exponentially correlated noise (IEEE Std 952, annex C).

Source: ISO 16269-6:2014, annex of exact factors; Odeh & Owen, Tables for Normal Tolerance Limits (1980).
"""

from __future__ import annotations

import tomllib
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
from scipy.optimize import brentq
from scipy.stats import chi2, ncx2

from tumble.brief import Brief
from tumble.errors import InputError
from tumble.files import ending_in
from tumble.lab.device_type import MIN_UNITS, Unit, in_run_sizes, mean_temperature, run_to_run
from tumble.sensors.model import WORDS
from tumble.sensors.parameters import group_name, group_of, shown_in
from tumble.units import Array
from tumble.views.blocks import Block, Document, Facts, Part, Table, Text, section
from tumble.views.numbers import quantity_table
from tumble.views.report.document import write_document

CONTENT = CONFIDENCE = 0.95

TERMS: Mapping[str, str] = tomllib.loads((Path(__file__).parent / "terms.toml").read_text(encoding="utf-8"))
"""Terms of IEEE Std 2700 for parameter groups, and of IEEE Std 952 for in-run biases."""


@dataclass(frozen=True, kw_only=True, slots=True)
class DatasheetRow:
    """A parameter of a device type, SI, with its `term` in the standards.

    `least`, `typical` (mean), `most` and `between` (standard deviation) describe the values of the units; `run_to_run`
    is the standard deviation between launches, None if no unit has several; `u` the root mean square of the standard
    uncertainties; `low` and `high` bound the tolerance interval."""

    name: str
    term: str
    unit: str
    units: int
    least: float
    typical: float
    most: float
    between: float
    run_to_run: float | None
    u: float | None
    low: float
    high: float


@dataclass(frozen=True, kw_only=True, slots=True, repr=False)
class Datasheet(Brief):
    """Distribution of the `units` of a device type at a `reference` temperature in °C, None if it is not known.
    Tolerance intervals have a `content` and a `confidence`."""

    model: str
    units: int
    reference: float | None
    rows: tuple[DatasheetRow, ...]
    content: float = CONTENT
    confidence: float = CONFIDENCE


def datasheet_of(units: Sequence[Unit], model: str) -> Datasheet:
    """Return the data sheet of a type from its units. Raises InputError for fewer than MIN_UNITS."""
    if len(units) < MIN_UNITS:
        raise InputError(f"type {model!r}: expected at least {MIN_UNITS} units in the registry, found {len(units)}")
    reference, estimates = mean_temperature(units), defaultdict[str, list[tuple[float, float]]](list)
    for unit in units:
        for name, value_and_variance in unit.at(reference).estimates().items():
            estimates[name].append(value_and_variance)
    rows = []
    for name, known in estimates.items():
        if len(known) >= MIN_UNITS:
            values, variances = np.array(known).T
            u = float(np.sqrt(variances.mean()))
            rows.append(_row(name, values, run_to_run=run_to_run(units, name), u=u))
    for kind in ("accel", "gyro"):
        sizes = in_run_sizes(units, kind)
        if len(sizes) >= MIN_UNITS:
            rows.append(_row(f"{kind}.in_run", sizes))
    return Datasheet(model=model, units=len(units), reference=reference, rows=tuple(rows))


def _row(name: str, values: Array, *, run_to_run: float | None = None, u: float | None = None) -> DatasheetRow:
    """Return the row of a parameter from the `values` of the units."""
    is_deviation = name.endswith(".in_run")
    normal = np.log(values) if is_deviation else values
    half_width = tolerance_factor(len(values)) * float(normal.std(ddof=1))
    interval = np.array([normal.mean() - half_width, normal.mean() + half_width])
    low, high = (np.exp(interval) if is_deviation else interval).tolist()
    return DatasheetRow(
        name=name,
        term=TERMS.get(name if is_deviation else group_name(name), ""),
        unit=group_of(name.replace(".in_run", ".bias.x")).unit,
        units=len(values),
        least=float(values.min()),
        typical=float(values.mean()),
        most=float(values.max()),
        between=float(values.std(ddof=1)),
        run_to_run=run_to_run,
        u=u,
        low=low,
        high=high,
    )


@cache
def tolerance_factor(n: int) -> float:
    """Return k of the two-sided tolerance interval x̄ ± k s of n normal values, Eq. (1)."""
    nodes, weights = np.polynomial.legendre.leggauss(80)  # k to more than ten digits
    half_range = 0.5 * 8.5 / np.sqrt(n)  # beyond 8.5 standard deviations of z, 1/√n, there is a probability of 2e-17
    z = (nodes + 1.0) * half_range
    density = weights * half_range * np.sqrt(2.0 * n / np.pi) * np.exp(-0.5 * n * z**2)
    quantile = ncx2.ppf(CONTENT, 1, z**2)

    def excess_confidence(k: float) -> float:
        return float(density @ chi2.sf((n - 1) * quantile / k**2, n - 1)) - CONFIDENCE

    return float(brentq(excess_confidence, 1.0, 1e4, xtol=1e-10))


# -------------------- tables and page --------------------


_MEANING = (
    "Min, typical (mean) and max of the units by their own recordings; s is the standard deviation between them, of "
    "which u is the part due to the uncertainty of the recordings; run to run is the change of a unit from power-on "
    "to power-on. The tolerance interval contains 95 % of all units of the type with 95 % confidence, where they are "
    "normally distributed (ISO 16269-6). Terms by IEEE Std 2700 and 952."
)


def datasheet_blocks(sheet: Datasheet) -> list[Block]:
    """Return the facts of a data sheet, a table for each kind of sensor, and an explanation of the columns."""
    return [Facts(rows=_facts(sheet)), *_tables(sheet), Text(text=_MEANING, tone="small")]


def _facts(sheet: Datasheet) -> tuple[tuple[str, str], ...]:
    facts = [("type", sheet.model), ("units", str(sheet.units))]
    return (*facts, *([] if sheet.reference is None else [("at", f"{sheet.reference:.1f} °C")]))


def _tables(sheet: Datasheet) -> Iterator[Table]:
    """Yield a table for each kind of sensor, with each parameter in the unit of its largest value."""

    def cells(row: DatasheetRow, size: float, unit: str) -> dict[str, str]:
        def cell(value: float | None, digits: int = 3) -> str:
            return "" if value is None else f"{float(f'{value / size:.{digits}g}'):.10g}"

        return {
            "term": row.term,
            "N": str(row.units),
            "min": cell(row.least),
            "typical": cell(row.typical),
            "max": cell(row.most),
            "s": cell(row.between),
            "run to run": cell(row.run_to_run),
            "u": cell(row.u, 2),
            "95/95 from": cell(row.low),
            "to": cell(row.high),
            "unit": unit,
        }

    for kind, words in WORDS.items():
        rows = [row for row in sheet.rows if row.name.startswith(f"{kind}.")]
        units = {
            row.name: shown_in(row.name.replace(".in_run", ".bias.x"), row.unit, max(abs(row.least), abs(row.most)))
            for row in rows
        }
        if rows:
            yield quantity_table(rows, units, cells, words=("term",), caption=words.capitalize(), dense=True)


def write_datasheet(sheet: Datasheet, out: Path, created: str) -> None:
    """Write a data sheet, `created` at a time (ISO 8601), as a page (.html). Raises InputError for another suffix."""
    ending_in(out, ".html")
    sections = tuple(section(table.caption, replace(table, caption="")) for table in _tables(sheet))
    document = Document(
        title="Data sheet",
        device=sheet.model,
        tone="good",
        verdict=f"{sheet.units} units",
        facts=_facts(sheet),
        created=created,
        parts=(Part(title="", sections=sections, customer=len(sections)),),
        statements=(_MEANING,),
        closing="End of the data sheet",
    )
    write_document(document, out)
