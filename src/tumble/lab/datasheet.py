"""The data sheet of a device type: what its units in the registry are like, parameter by parameter.

Of the n units of a parameter, each by its own recording (`Unit.alone`), the least, the mean and the largest value,
their standard deviation s, and the interval that contains 95 % of all units of the type with 95 % confidence, if they
are normally distributed,

    x̄ ± k s,   k:  √(2n/π) ∫₀^∞ P(χ²_{n−1} > (n − 1) r²(z)/k²) e^{−n z²/2} dz = 0.95                               (1)

r²(z) being the 0.95 quantile of the noncentral χ² of one degree of freedom with noncentrality z². In-run biases, which
are sizes, are judged by their logarithms. s contains u, what the recordings do not know of the units.

Terms are those of IEEE Std 2700, parameters of MEMS sensors, as far as its definitions are public. An in-run bias is no
bias instability, which is flicker noise: it is the exponentially correlated noise of IEEE Std 952, annex C.

Source: ISO 16269-6:2014, annex of exact factors; Odeh & Owen, Tables for Normal Tolerance Limits (1980).
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
from scipy.optimize import brentq
from scipy.stats import chi2, ncx2

from tumble.brief import Brief
from tumble.errors import InputError
from tumble.files import ending_in, whole_file
from tumble.lab.device_type import FEWEST_UNITS, Unit, in_run_sizes, mean_temperature, run_to_run
from tumble.sensors.model import WORDS
from tumble.sensors.parameters import group_name, group_of, shown_in
from tumble.units import Array
from tumble.views.blocks import Block, Document, Facts, Part, Table, Text, section
from tumble.views.numbers import quantity_table

CONTENT = CONFIDENCE = 0.95

TERMS: Mapping[str, str] = tomllib.loads((Path(__file__).parent / "terms.toml").read_text(encoding="utf-8"))
"""What IEEE Std 2700 calls groups of parameters, and IEEE Std 952 in-run biases."""


@dataclass(frozen=True, kw_only=True, slots=True)
class DatasheetRow:
    """A parameter of a type, SI, with the `term` of the standards (`TERMS`): least, mean and largest value of the units
    and their standard deviation `between` them; the standard deviation from launch to launch, None if no unit has
    several; `u`, the root mean square of the standard uncertainties that the recordings leave; and the tolerance
    interval from `low` to `high`."""

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
    """What `units` units of a type are like at the temperature `reference`, °C, if it is known; tolerance intervals
    have a `content` with a `confidence`."""

    model: str
    units: int
    reference: float | None
    rows: tuple[DatasheetRow, ...]
    content: float = CONTENT
    confidence: float = CONFIDENCE


def datasheet_of(units: Sequence[Unit], model: str) -> Datasheet:
    """The data sheet of a type by its units, each once. Raises InputError for fewer than FEWEST_UNITS."""
    if len(units) < FEWEST_UNITS:
        raise InputError(f"type {model!r}: expected at least {FEWEST_UNITS} units in the registry, found {len(units)}")
    reference, seen = mean_temperature(units), dict[str, list[tuple[float, float]]]()
    for unit in units:
        for name, value_and_variance in unit.at(reference).alone().items():
            seen.setdefault(name, []).append(value_and_variance)
    rows = []
    for name, each in seen.items():
        if len(each) >= FEWEST_UNITS:
            values, variances = np.array(each).T
            row = _row(name, values, run_to_run=run_to_run(units, name), u=float(np.sqrt(variances.mean())))
            rows.append(row)
    for kind in ("accel", "gyro"):
        sizes = in_run_sizes(units, kind)
        if len(sizes) >= FEWEST_UNITS:
            rows.append(_row(f"{kind}.in_run", sizes))
    return Datasheet(model=model, units=len(units), reference=reference, rows=tuple(rows))


def _row(name: str, values: Array, *, run_to_run: float | None = None, u: float | None = None) -> DatasheetRow:
    """The row of a parameter with these values of the units; of a size, if it is that of in-run biases."""
    is_size = name.endswith(".in_run")
    normal = np.log(values) if is_size else values
    half = tolerance_factor(len(values)) * float(normal.std(ddof=1))
    ends = np.array([normal.mean() - half, normal.mean() + half])
    low, high = (np.exp(ends) if is_size else ends).tolist()
    return DatasheetRow(
        name=name,
        term=TERMS.get(name if is_size else group_name(name), ""),
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
    """The factor k of two-sided tolerance intervals x̄ ± k s of n normal values with unknown mean, Eq. (1)."""
    nodes, weights = np.polynomial.legendre.leggauss(80)
    z = 0.5 * (nodes + 1.0) * 8.5 / np.sqrt(n)
    density = weights * 8.5 / np.sqrt(n) * 0.5 * np.sqrt(2.0 * n / np.pi) * np.exp(-0.5 * n * z**2)
    quantile = ncx2.ppf(CONTENT, 1, z**2)

    def confident(k: float) -> float:
        return float(density @ chi2.sf((n - 1) * quantile / k**2, n - 1)) - CONFIDENCE

    return float(brentq(confident, 1.0, 1e4, xtol=1e-10))


# -------------------- as tables, and as a page --------------------


_MEANING = (
    "Min, typical (mean) and max of the units by their own recordings; s is the standard deviation between them, of "
    "which u is what the recordings do not know; run to run is what a unit changes by from power-on to power-on. The "
    "tolerance interval contains 95 % of all units of the type with 95 % confidence, where they are normally "
    "distributed (ISO 16269-6). Terms by IEEE Std 2700 and 952."
)


def datasheet_blocks(sheet: Datasheet) -> list[Block]:
    """The facts of a data sheet, a table for each kind of sensor, and what the columns are."""
    return [Facts(rows=_facts(sheet)), *_tables(sheet), Text(text=_MEANING, tone="small")]


def _facts(sheet: Datasheet) -> tuple[tuple[str, str], ...]:
    facts = [("type", sheet.model), ("units", str(sheet.units))]
    return (*facts, *([] if sheet.reference is None else [("at", f"{sheet.reference:.1f} °C")]))


def _tables(sheet: Datasheet) -> Iterator[Table]:
    """A table for each kind of sensor; a parameter is shown in the unit of its largest value."""
    for kind, words in WORDS.items():
        rows = [row for row in sheet.rows if row.name.startswith(f"{kind}.")]
        units = {
            row.name: shown_in(row.name.replace(".in_run", ".bias.x"), row.unit, max(abs(row.least), abs(row.most)))
            for row in rows
        }
        if rows:
            yield quantity_table(rows, units, _cells, words=("term",), caption=words.capitalize(), dense=True)


def _cells(row: DatasheetRow, size: float, unit: str) -> dict[str, str]:
    """The cells of a parameter by their headings."""

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


def write_datasheet(sheet: Datasheet, out: Path, created: str) -> None:
    """Write a data sheet, `created` at a time (ISO 8601), as a page (.html). Raises InputError for another ending."""
    ending_in(out, ".html")
    sections = tuple(section(each.caption, replace(each, caption="")) for each in _tables(sheet))
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
    from tumble.views.render.pages import page

    with whole_file(out) as temporary:
        temporary.write_text(page(document), encoding="utf-8")
