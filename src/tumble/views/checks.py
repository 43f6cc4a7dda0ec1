"""Checks and comparisons of calibrations."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from tumble.inference.estimate import Fit
from tumble.methods.field_check import CHANCE, ParameterTest
from tumble.sensors.parameters import group_name, group_of, sensor_kind, shown_in
from tumble.units import engineering, two_digits
from tumble.use.check import CheckedRest, FieldCheck
from tumble.use.compare import Comparison, Difference
from tumble.use.stream import Event, Notice
from tumble.views.blocks import Block, Table, table
from tumble.views.numbers import Units, cells, probability_text, quantity_table, to_digits_of, units_of_values

MOST_SHOWN = 10
"""Rests in a table, and sentences on them."""

# -------------------- two calibrations --------------------


def comparison_blocks(comparison: Comparison) -> list[Block]:
    """Return a table of the differences of the common parameters with E_n, and the tests of all together."""
    differences = comparison.differences
    units = units_of_values((d.name, value, d.unit) for d in differences for value in (d.first, d.second))

    def row(d: Difference, size: float, unit: str) -> dict[str, str]:
        values = {"first": d.first, "second": d.second, "difference": d.value}
        shown = {heading: to_digits_of(value, d.u, size) for heading, value in values.items()}
        ratio, e_n = ("", "") if d.e_n is None or not d.u else (f"{d.value / d.u:+z.2f}", f"{d.e_n:+z.2f}")
        u = cells(0.0, d.u, size)[1] if d.u else ""
        return {**shown, "u (k=1)": u, "unit": unit, "d/u": ratio, "E_n": e_n}

    return [f"frame {comparison.frame}", quantity_table(differences, units, row), *comparison_lines(comparison)]


def comparison_lines(comparison: Comparison) -> list[str]:
    """Return sentences on the number of differences beyond U, the probability of the largest, and χ² of all
    together."""
    judged = [d for d in comparison.differences if d.e_n is not None]
    lines = [f"{sum(abs(d.e_n or 0.0) > 1.0 for d in judged)} of {len(judged)} |E_n| exceed 1"]
    if comparison.largest_by_chance is not None:
        chance = probability_text(comparison.largest_by_chance)
        lines[0] += f", the largest is exceeded by chance with probability {chance}"
    if comparison.probability is not None:
        lines.append(
            f"all together: χ² {comparison.chi_square:.1f} with {comparison.degrees:.3g} degrees of freedom, exceeded "
            f"by chance with probability {probability_text(comparison.probability)}"
        )
    return lines


# -------------------- a check --------------------


def check_blocks(check: FieldCheck, *, rests: bool = True) -> list[Block]:
    """Return the rests against gravity, the test of every parameter, and the verdict.

    Without `rests` for a stream, whose rests were shown one by one."""
    turns = f" and {check.turns} turns" if check.turns else ""
    blocks: list[Block] = [f"{sum(not rest.why for rest in check.rests)} rests{turns}"]
    compared = [rest for rest in check.rests if rest.u is not None and math.isfinite(rest.u)]
    if rests and compared:
        more = len(check.rests) - MOST_SHOWN
        blocks += [_rest_table(check.rests), *([f"and {more} others with smaller ratios"] if more > 0 else [])]
        largest, ratio = max(abs(r.difference) for r in compared), max(abs(r.sigmas or 0.0) for r in compared)
        size, unit = engineering("m/s^2", largest)
        summary = (
            f"largest |g−|f|| {largest / size:.3g} {unit}; largest ratio {ratio:.2f} of {len(compared)}, at most "
            f"{check.rest_limit:.2f} in 99 of 100 good calibrations"
        )
        if check.misfit is not None and not check.reasons and ratio > (check.rest_limit or math.inf):
            summary += " from the same power-on; the excess is within the usual changes from one power-on to the next"
        blocks.append(summary)
    units = units_of_values((test.name, test.detectable, test.unit) for test in check.parameters)
    blocks += [] if check.misfit is None else _test_blocks(check, check.misfit, units)
    if check.reasons:
        return [*blocks, "changed"]
    worst = dict[str, str]()  # largest detectable change of a parameter by group
    for group in dict.fromkeys(group_name(test.name) for test in check.parameters):
        test = max((t for t in check.parameters if group_name(t.name) == group), key=lambda t: t.detectable)
        size, unit = units[test.name]
        worst[group] = f"{group} {two_digits(test.detectable / size)} {unit}"
    limits = f"; larger than these, it would be in nine of ten cases:\n{', '.join(worst.values())}" if worst else ""
    return [*blocks, f"no change is detected{limits}"]


def _rest_table(rests: Sequence[CheckedRest]) -> Table:
    """Return a table of the differences from gravity at the rests or positions with the largest ratios, in their order,
    with empty cells without a prediction. The unit is that of the largest u."""
    size, unit = engineering("m/s^2", max(rest.u for rest in rests if rest.u is not None and math.isfinite(rest.u)))
    order, rows = sorted(range(len(rests)), key=lambda i: -abs(rests[i].sigmas or 0.0)), []
    for rest in (rests[i] for i in sorted(order[:MOST_SHOWN])):
        row = {"": rest.label, f"g−|f| {unit}": "", f"u (k=1) {unit}": "", "ratio": ""}
        if rest.u is not None and math.isfinite(rest.u):
            numbers = f"{rest.difference / size:+z.1f}", f"{rest.u / size:.1f}", f"{rest.sigmas:+z.2f}"
            row = dict(zip(row, (rest.label, *numbers), strict=True))
        rows.append(row)
    return table(rows, words=("",))


def _test_blocks(check: FieldCheck, misfit: Fit, units: Units) -> Iterator[Block]:
    """Yield the tests of the parameters, and of the residuals that no change explains."""

    def row(test: ParameterTest, size: float, unit: str) -> dict[str, str]:
        change, u = cells(test.change, test.u, size)
        ratio, detectable = f"{test.change / test.u:+z.2f}", cells(0.0, test.detectable, size)[1]
        return {"change": change, "u (k=1)": u, "change/u": ratio, "detectable": detectable, "unit": unit}

    if check.parameters and check.explained:  # else the changes say nothing
        yield quantity_table(check.parameters, units, row)
        yield (
            f"largest |change|/u {check.largest:.2f}, at most {check.limit:.2f} in {100.0 * (1.0 - CHANCE):.1f} of "
            "100 checks where nothing has changed"
        )
    yield (
        f"residuals that no change explains: χ² {misfit.chi_square:.1f} with {misfit.degrees:.0f} degrees of freedom, "
        f"exceeded by chance with probability {probability_text(misfit.probability)}"
    )
    if check.unseen:
        yield f"not seen by these rests: {', '.join(check.unseen)}"


def event_line(event: Event) -> str:
    """Return a rest or a notice of a stream as one line."""
    if isinstance(event, Notice):
        return f"{event.time:.1f} s: {event.text}"
    parts = [event.label] + ([] if event.celsius is None else [f"{event.celsius:.1f} °C"])
    size, unit = engineering("m/s^2", max(abs(event.difference), event.u or 0.0))
    parts.append(f"g−|f| {_with_sigmas(event.difference / size, unit, event.sigmas)}")
    if event.judged is None:
        return "  ".join([*parts, event.why])
    tests = event.judged.tests
    gyros = [name for name in tests if sensor_kind(name) == "gyro"]
    if gyros:
        name = max(gyros, key=lambda name: abs(tests[name].sigmas))
        size, unit = shown_in(name, group_of(name).unit, max(abs(tests[name].change), tests[name].u))
        parts.append(f"{name} {_with_sigmas(tests[name].change / size, unit, tests[name].sigmas)}")
    parts += [f"outside in {', '.join(event.outside)}"] if event.outside else []
    parts += [] if event.judged.learned else ["off: the next ones decide"]
    return "  ".join(parts)


def _with_sigmas(value: float, unit: str, sigmas: float | None) -> str:
    return f"{value:+z.3g} {unit}" + ("" if sigmas is None else f" ({sigmas:+z.1f} u)")
