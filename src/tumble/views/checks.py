"""A calibration against another recording: two calibrations side by side, check positions, a field check, readings at
rest before and after correction; and the cases of a self-test."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tumble.calibration.apply import RestResidual
from tumble.calibration.check import FieldCheck
from tumble.calibration.compare import Comparison
from tumble.calibration.results import Parameter
from tumble.calibration.verify import Verification
from tumble.methods.field_check import CHANCE
from tumble.selftest import SelftestRecord
from tumble.sensors.parameters import group_name, group_of, positions_by_group
from tumble.units import G_STANDARD, engineering, two_digits
from tumble.views.blocks import Block, Table, Text, table
from tumble.views.numbers import cells, probability_text, shown_units

# -------------------- two calibrations --------------------


def comparison_blocks(comparison: Comparison) -> list[Block]:
    """Values, difference, its uncertainty and E_n of every common parameter, and what they say together."""
    differences, rows = comparison.differences, []
    both = ((d, value) for d in differences for value in (d.first, d.second))
    units = shown_units([Parameter(name=d.name, value=value, u=None, unit=d.unit) for d, value in both])
    for d in differences:
        size, unit = units[d.name]
        first, second, difference = (cells(value, d.u or 0.0, size)[0] for value in (d.first, d.second, d.value))
        judged = ("", "") if d.e_n is None or not d.u else (f"{d.value / d.u:+z.2f}", f"{d.e_n:+z.2f}")
        row = {"parameter": d.name, "first": first, "second": second, "difference": difference}
        row |= {"u (k=1)": cells(0.0, d.u, size)[1] if d.u else "", "unit": unit, "d/u": judged[0], "E_n": judged[1]}
        rows.append(row)
    said = (Text(text=line) for line in judged_lines(comparison))
    return [Text(text=f"frame {comparison.frame}"), table(rows), *said]


def judged_lines(comparison: Comparison) -> list[str]:
    """How many differences are beyond their U, how likely chance makes the largest of so many, and χ² of all together,
    in sentences."""
    judged = [d for d in comparison.differences if d.e_n is not None]
    line = f"{sum(abs(d.e_n or 0.0) > 1.0 for d in judged)} of {len(judged)} |E_n| beyond 1"
    if comparison.largest_by_chance is not None:
        chance = probability_text(comparison.largest_by_chance)
        line += f", one as large as the largest by chance with probability {chance}"
    if comparison.probability is None:
        return [line]
    together = (
        f"all together: χ² {comparison.chi_square:.1f} for {comparison.degrees}, exceeded by chance with probability "
        f"{probability_text(comparison.probability)}"
    )
    return [line, together]


# -------------------- check positions --------------------


def verification_blocks(verification: Verification) -> list[Block]:
    """A table of the positions and the verdict."""
    how = "each of the calibration's own positions, left out in turn" if verification.left_out else "check positions"
    verdict = Text(text="not accepted" if verification.reasons else "accepted")
    known = np.isfinite(verification.sigmas)
    if not known.any():
        return [Text(text=f"{how}\n"), verdict]
    size, unit = engineering("m/s^2", float(np.nanmax([np.abs(verification.difference), verification.u])))
    headings = "position", f"Δg {unit}", f"u (k=1) {unit}", "|Δg|/u"
    rows = []
    values = zip(verification.labels, verification.difference, verification.u, verification.sigmas, strict=True)
    for label, difference, u, ratio in values:
        numbers = (f"{difference / size:+z.1f}", f"{u / size:.1f}", f"{ratio:.2f}")
        rows.append(dict(zip(headings, (label, *(numbers if np.isfinite(ratio) else [""] * 3)), strict=True)))
    summary = (
        f"largest |Δg| {np.nanmax(np.abs(verification.difference)) / size:.3g} {unit}; largest |Δg|/u "
        f"{np.nanmax(verification.sigmas):.2f} of {known.sum()} positions, at most {verification.limit:.2f} in 99 of "
        "100 good calibrations"
    )
    return [Text(text=how), table(rows, words=("position",)), Text(text=summary), verdict]


def residual_table(rests: Sequence[RestResidual]) -> Table:
    """Residuals of rests, mg before and after correction, and their root mean squares."""
    both = np.array([[rest.before, rest.after] for rest in rests]) / (1e-3 * G_STANDARD)
    rows = [
        (str(i), f"{rest.start:z.1f}", f"{rest.stop:z.1f}", *(f"{number:+z.4f}" for number in numbers))
        for i, (rest, numbers) in enumerate(zip(rests, both, strict=True), 1)
    ]
    rows.append(("rms", "", "", *(f"{number:.4f}" for number in np.sqrt(np.mean(both**2, axis=0)))))
    return Table(columns=("rest", "start s", "stop s", "before mg", "after mg"), rows=tuple(rows), text=())


# -------------------- a field check --------------------


def field_check_blocks(check: FieldCheck) -> list[Block]:
    """What each parameter would have changed by, alone, what would have been found, and the verdict."""
    result, rows = check.result, []
    turns = f" and {check.turns} turns" if check.turns else ", no turns"
    units = shown_units(
        [Parameter(name=n, value=least, u=None, unit=group_of(n).unit) for n, least in result.detectable.items()]
    )
    for name, (change, u) in result.tests.items():
        size, unit = units[name]
        value, uncertainty = cells(change, u, size)
        row = {"parameter": name, "change": value, "u (k=1)": uncertainty, "change/u": f"{change / u:+z.2f}"}
        rows.append(row | {"detectable": cells(0.0, result.detectable[name], size)[1], "unit": unit})
    blocks: list[Block] = [Text(text=f"{check.rests} rests{turns}")]
    if rows:
        largest = (
            f"largest |change|/u {result.largest:.2f}, at most {result.limit:.2f} in {100.0 * (1.0 - CHANCE):.1f} of "
            "100 checks where nothing has changed"
        )
        blocks += [table(rows), Text(text=largest)]
    misfit = (
        f"what no change explains: χ² {result.misfit.chi_square:.1f} for {result.misfit.degrees:.0f}, by chance "
        f"with probability {probability_text(result.misfit.probability)}"
    )
    blocks.append(Text(text=misfit if rows else f"\n{misfit}"))
    seen = {group_name(name) for name in result.tests}
    linear = positions_by_group(check.instrument.names[: check.instrument.linear_count])
    if unseen := [group for group in linear if group not in seen]:
        blocks.append(Text(text=f"not seen by these rests: {', '.join(unseen)}"))
    largest_of: dict[str, str] = {}  # of each group, by its sensor of the largest change that is not shown
    for name in sorted(result.detectable, key=lambda name: result.detectable[name]):
        largest_of[group_name(name)] = f"{two_digits(result.detectable[name] / units[name][0])} {units[name][1]}"
    groups = dict.fromkeys(map(group_name, result.detectable))
    sizes = ", ".join(f"{group} {largest_of[group]}" for group in groups)
    unchanged = f"no change is shown, and none larger than\n{sizes}"
    return [*blocks, Text(text=unchanged if check.valid else "changed")]


# -------------------- a self-test --------------------


def selftest_table(record: SelftestRecord) -> Table:
    """The cases of a record."""
    rows = []
    for case in record.cases:
        allowed = f"{case.low:g} … {case.high:g}" if case.low > 0.0 else f"≤ {case.high:g}"
        row = {"case": case.name, "compared with": case.source, "found": f"{case.figure:.3g}"}
        row |= {"allowed": f"{allowed} {case.unit}".removesuffix(" 1"), "": "passed" if case.passed else "FAILED"}
        rows.append(row)
    return table(rows, words=("case", "compared with", ""))
