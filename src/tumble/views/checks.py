"""A calibration against another recording: two calibrations side by side, check positions, a field check, readings at
rest before and after correction."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict

import numpy as np

from tumble.methods.field_check import CHANCE
from tumble.methods.rest_chain import MovedBias
from tumble.sensors.parameters import group_name, group_of, positions_by_group, sensor_kind, shown_in
from tumble.units import G_STANDARD, engineering, two_digits
from tumble.use.apply import RestResidual
from tumble.use.check import FieldCheck, change_text
from tumble.use.compare import Comparison
from tumble.use.verify import Verification
from tumble.use.watch import Event, Notice
from tumble.views.blocks import Block, Table, table
from tumble.views.numbers import cells, probability_text, units_of_values
from tumble.views.render.data import Content, fields, judged, rows

# -------------------- two calibrations --------------------


def comparison_blocks(comparison: Comparison) -> list[Block]:
    """Values, difference, its uncertainty and E_n of every common parameter, and what they say together."""
    differences, shown = comparison.differences, []
    units = units_of_values((d.name, value, d.unit) for d in differences for value in (d.first, d.second))
    for d in differences:
        size, unit = units[d.name]
        first, second, difference = (cells(value, d.u or 0.0, size)[0] for value in (d.first, d.second, d.value))
        judged = ("", "") if d.e_n is None or not d.u else (f"{d.value / d.u:+z.2f}", f"{d.e_n:+z.2f}")
        row = {"parameter": d.name, "first": first, "second": second, "difference": difference}
        row |= {"u (k=1)": cells(0.0, d.u, size)[1] if d.u else "", "unit": unit, "d/u": judged[0], "E_n": judged[1]}
        shown.append(row)
    return [f"frame {comparison.frame}", table(shown), *judged_lines(comparison)]


def judged_lines(comparison: Comparison) -> list[str]:
    """How many differences are beyond their U, how likely chance makes the largest of so many, and χ² of all together,
    in sentences."""
    judged = [d for d in comparison.differences if d.e_n is not None]
    lines = [f"{sum(abs(d.e_n or 0.0) > 1.0 for d in judged)} of {len(judged)} |E_n| beyond 1"]
    if comparison.largest_by_chance is not None:
        chance = probability_text(comparison.largest_by_chance)
        lines[0] += f", one as large as the largest by chance with probability {chance}"
    if comparison.probability is not None:
        lines.append(
            f"all together: χ² {comparison.chi_square:.1f} for {comparison.degrees}, exceeded by chance with "
            f"probability {probability_text(comparison.probability)}"
        )
    return lines


# -------------------- check positions --------------------


def verification_blocks(verification: Verification) -> list[Block]:
    """A table of the positions and the verdict."""
    how = "each of the calibration's own positions, left out in turn" if verification.left_out else "check positions"
    verdict = "not accepted" if verification.reasons else "accepted"
    known = np.isfinite(verification.sigmas)
    if not known.any():
        return [f"{how}\n", verdict]
    size, unit = engineering("m/s^2", float(np.nanmax([np.abs(verification.difference), verification.u])))
    shown = []
    values = zip(verification.labels, verification.difference, verification.u, verification.sigmas, strict=True)
    for label, difference, u, ratio in values:
        row = {"position": label, f"Δg {unit}": f"{difference / size:+z.1f}"}
        row |= {f"u (k=1) {unit}": f"{u / size:.1f}", "|Δg|/u": f"{ratio:.2f}"}
        shown.append(row if np.isfinite(ratio) else dict.fromkeys(row, "") | {"position": label})
    summary = (
        f"largest |Δg| {np.nanmax(np.abs(verification.difference)) / size:.3g} {unit}; largest |Δg|/u "
        f"{np.nanmax(verification.sigmas):.2f} of {known.sum()} positions, at most {verification.limit:.2f} in 99 of "
        "100 good calibrations"
    )
    return [how, table(shown, words=("position",)), summary, verdict]


def verification_data(verification: Verification) -> Content:
    """Check positions and the verdict."""
    v = verification
    positions = rows("label difference u sigmas", v.labels, v.difference, v.u, v.sigmas)
    return judged(v.reasons) | fields(v, "left_out limit") | {"positions": positions}


def residual_table(rests: Sequence[RestResidual]) -> Table:
    """Residuals of rests, mg before and after correction, and their root mean squares."""
    both = np.array([[rest.before, rest.after] for rest in rests]) / (1e-3 * G_STANDARD)
    shown = [
        (str(i), f"{rest.start:z.1f}", f"{rest.stop:z.1f}", *(f"{number:+z.4f}" for number in numbers))
        for i, (rest, numbers) in enumerate(zip(rests, both, strict=True), 1)
    ]
    shown.append(("rms", "", "", *(f"{number:.4f}" for number in np.sqrt(np.mean(both**2, axis=0)))))
    return Table(columns=("rest", "start s", "stop s", "before mg", "after mg"), rows=tuple(shown), text=())


# -------------------- a field check --------------------


def field_check_blocks(check: FieldCheck) -> list[Block]:
    """What each parameter would have changed by, alone, what would have been found, and the verdict."""
    result, shown = check.result, []
    turns = f" and {check.turns} turns" if check.turns else ", no turns"
    units = units_of_values((name, least, group_of(name).unit) for name, least in result.detectable.items())
    for name, (change, u) in result.tests.items():
        size, unit = units[name]
        value, uncertainty = cells(change, u, size)
        row = {"parameter": name, "change": value, "u (k=1)": uncertainty, "change/u": f"{change / u:+z.2f}"}
        shown.append(row | {"detectable": cells(0.0, result.detectable[name], size)[1], "unit": unit})
    blocks: list[Block] = [f"{check.rests} rests{turns}"]
    if shown:
        largest = (
            f"largest |change|/u {result.largest:.2f}, at most {result.limit:.2f} in {100.0 * (1.0 - CHANCE):.1f} of "
            "100 checks where nothing has changed"
        )
        blocks += [table(shown), largest]
    misfit = (
        f"what no change explains: χ² {result.misfit.chi_square:.1f} for {result.misfit.degrees:.0f}, by chance "
        f"with probability {probability_text(result.misfit.probability)}"
    )
    blocks.append(misfit if shown else f"\n{misfit}")
    seen = {group_name(name) for name in result.tests}
    linear = positions_by_group(check.instrument.names[: check.instrument.linear_count])
    if unseen := [group for group in linear if group not in seen]:
        blocks.append(f"not seen by these rests: {', '.join(unseen)}")
    worst = dict.fromkeys(map(group_name, result.detectable), "")  # of each group, at its sensor that is seen least
    for name in sorted(result.detectable, key=lambda name: result.detectable[name]):
        worst[group_name(name)] = f"{two_digits(result.detectable[name] / units[name][0])} {units[name][1]}"
    sizes = ", ".join(f"{group} {size}" for group, size in worst.items())
    unchanged = f"no change is shown, and none larger than\n{sizes}"
    return [*blocks, unchanged if check.valid else "changed"]


def field_check_data(check: FieldCheck) -> Content:
    """What has changed since a calibration, and what would have been found."""
    result = check.result
    return {
        **judged(check.reasons),
        **fields(check, "rests turns"),
        "changes": result.changes,
        "parameters": [
            {"name": name, "change": change, "u": u, "detectable": result.detectable[name]}
            for name, (change, u) in result.tests.items()
        ],
        **fields(result, "largest limit"),
        "misfit": result.misfit,
        "notes": check.notes,
    }


# -------------------- a watch --------------------


def watch_line(event: Event) -> str:
    """A rest, or what is to be said of the stream, in one line."""
    if isinstance(event, Notice):
        return f"{event.time:.1f} s: {event.text}"
    parts = ["no rest" if event.number is None else f"rest {event.number}", f"{event.start:.1f}–{event.stop:.1f} s"]
    parts += [] if event.celsius is None else [f"{event.celsius:.1f} °C"]
    size, unit = engineering("m/s^2", max(abs(event.force), event.force_u or 0.0))
    parts.append(f"|f|−g {_off(event.force / size, unit, event.force_sigmas)}")
    judged = event.judged
    if judged is None:
        return "  ".join([*parts, event.why])
    gyros = {name: test for name, test in judged.tests.items() if sensor_kind(name) == "gyro"}
    if gyros:
        name = max(gyros, key=lambda name: abs(gyros[name].sigmas))
        size, unit = shown_in(name, group_of(name).unit, max(abs(gyros[name].change), gyros[name].u))
        parts.append(f"{name} {_off(gyros[name].change / size, unit, gyros[name].sigmas)}")
    parts += [f"outside in {', '.join(event.outside)}"] if event.outside else []
    parts += [] if judged.learned else ["off: the next ones decide"]
    return "  ".join(parts)


def _off(value: float, unit: str, sigmas: float | None) -> str:
    return f"{value:+z.3g} {unit}" + ("" if sigmas is None else f" ({sigmas:+z.1f} u)")


def moved_line(moved: MovedBias) -> str:
    """That a bias has moved, by how much and since when."""
    return f"{change_text(moved)}, since about {moved.since:.1f} s, rest {moved.rest + 1}"


def watch_data(event: Event) -> Content:
    """The same as data."""
    if isinstance(event, Notice):
        return {"event": "notice", **fields(event, "time text")}
    judged = event.judged
    number = None if event.number is None else event.number - 1
    content = {
        "event": "rest",
        "number": number,
        **fields(event, "start stop celsius force force_u force_sigmas outside why"),
    }
    if judged is None:
        return content | {"used": False}
    return content | {
        "used": True,
        "learned": judged.learned,
        "biases": [{"name": name, **asdict(test)} for name, test in judged.tests.items()],
        "misfit": judged.misfit,
        "moved": [asdict(each) for each in judged.moved],
    }

