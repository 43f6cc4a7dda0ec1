"""The section on temperature: every parameter that changes with it over the range that was measured, with U; what lies
beyond is drawn apart, as an extrapolation."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from tumble.result.calibration import Calibration
from tumble.result.parts import Parameter, RestResult
from tumble.result.temperature_curves import (
    Range,
    changing,
    curve,
    measured_range,
    own_thermometers,
    temperature_of,
    warm_rests,
)
from tumble.sensors.parameters import group_of, positions_by_group, sensor_kind, within_group
from tumble.units import engineering
from tumble.views.blocks import Block, Figure, Section, Table, Text
from tumble.views.numbers import cells, fixed, shown_units
from tumble.views.render.characters import drawable
from tumble.views.render.pictures import COLOURS, FAINT, GREY, PAGE, drawn, grid

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Canvas

BEYOND = 0.12
"""How far beyond the measured range the picture goes, in parts of it."""


def section(calibration: Calibration, name: str) -> Section | None:
    """Parameters over temperature; None where none changes with it or all rests had one temperature."""
    measured, reference, names = measured_range(calibration), calibration.reference_temperature, changing(calibration)
    if measured is None or reference is None or not names:
        return None
    text = (
        f"Measured from {fixed(measured.low, 1)} to {fixed(measured.high, 1)} °C. All other values in this report are "
        f"those at the reference temperature, {fixed(reference, 1)} °C; at T they are θ + θ₁ (T − T₀) + θ₂ (T − T₀)², "
        "θ₁ and θ₂ being the parameters that end in t1 and t2. U is that of the whole sum. Beyond the measured range "
        "the curve is an extrapolation, for which U does not stand."
    )
    text += "".join(f" {said[0].upper()}{said[1:]}." for said in own_thermometers(calibration))
    blocks: list[Block] = [Text(text=text), _table(calibration, names, measured, reference)]
    svg = picture(name, calibration, names, measured, reference)
    caption = (
        f"Change from the value at {fixed(reference, 1)} °C (upright line), with the band ±U of the value. Marks at "
        "the foot: temperatures of the rests. Dashed, on grey: not measured."
    )
    blocks.append(Figure(svg=svg, caption=caption))
    if seen := warm_rests(calibration):
        said = (
            "What is left of the specific force at each rest, by its temperature, and how far the rest is from the "
            "fit, in sigmas. Residuals that follow the temperature are what the coefficients do not hold."
        )
        blocks.append(Figure(svg=residuals_picture(f"{name}-left", seen), caption=said))
    return Section(title="Over temperature", blocks=tuple(blocks))


def _table(calibration: Calibration, names: tuple[str, ...], measured: Range, reference: float) -> Table:
    at = np.array([measured.low, reference, measured.high])
    curves = [curve(calibration, name, at) for name in names]
    largest = [max(each.value, key=abs) for each in curves]
    units = shown_units(
        [Parameter(name=c.name, value=float(v), u=None, unit=c.unit) for c, v in zip(curves, largest, strict=True)]
    )
    rows = []
    for each in curves:
        size, unit = units[each.name]
        bands = [None] * 3 if each.expanded is None else each.expanded
        shown = (cells(float(v), None if u is None else float(u), size) for v, u in zip(each.value, bands, strict=True))
        rows.append((each.name, *(cell for pair in shown for cell in pair), unit))
    columns = tuple(cell for T in at for cell in (f"at {fixed(float(T), 1)} °C", "U"))
    return Table(columns=("parameter", *columns, "unit"), rows=tuple(rows), text=(0, 7), dense=True)


def _by_group(names: Sequence[str]) -> dict[str, list[str]]:
    """Names of parameters by their group."""
    return {group: [names[i] for i in own] for group, own in positions_by_group(names).items()}


def picture(name: str, calibration: Calibration, names: tuple[str, ...], measured: Range, reference: float) -> str:
    """A panel for each group: the change of every sensor's parameter from the reference, with ±U."""
    by_group, rests = _by_group(names), warm_rests(calibration)

    def draw(figure: Canvas) -> None:
        panels = figure.subplots(-(-len(by_group) // 2), 2, squeeze=False).ravel()
        for axes, members in zip(panels, by_group.values(), strict=False):
            _panel(axes, calibration, members, measured, reference)
            seen = [temperature_of(rest, sensor_kind(members[0])) for rest in rests]
            axes.plot(seen, np.zeros(len(seen)), "|", color=GREY, markersize=4, transform=axes.get_xaxis_transform())
            axes.set_title(group_of(members[0]).words)
        for axes in panels[len(by_group) :]:
            axes.set_visible(False)
        for axes in panels[max(0, len(by_group) - 2) : len(by_group)]:
            axes.set_xlabel("°C")

    return drawn(name, PAGE, 2.0 * -(-len(by_group) // 2) + 0.2, draw)


def residuals_picture(name: str, rests: list[RestResult]) -> str:
    """Residuals of the specific force, and sigmas, of rests over the temperatures of the accelerometers."""
    celsius = np.array([temperature_of(rest, "accel") for rest in rests])
    left = np.array([rest.residual for rest in rests])
    sigmas = np.array([rest.sigmas for rest in rests])

    def draw(figure: Canvas) -> None:
        panels = figure.subplots(1, 2)
        size, unit = engineering("m/s^2", float(np.abs(left).max()))
        for axes, values, label in zip(panels, (left / size, sigmas), (unit, "sigmas"), strict=True):
            axes.plot(celsius, values, "o", color=COLOURS[0], markersize=3.0)
            axes.axhline(0.0, color=GREY, linewidth=0.6)
            margin, ends = 0.03 * float(np.ptp(celsius)), (float(celsius.min()), float(celsius.max()))
            axes.set(xlim=(ends[0] - margin, ends[1] + margin), xlabel="°C", ylabel=drawable(label))
            grid(axes)
        panels[0].set_title("residuals of the specific force")
        panels[1].set_title("distance from the fit")

    return drawn(name, PAGE, 2.0, draw)


def _panel(axes: Axes, calibration: Calibration, members: list[str], measured: Range, reference: float) -> None:
    margin = BEYOND * (measured.high - measured.low)
    inside = measured.temperatures(101)
    low, high = (np.linspace(start, start + margin, 15) for start in (measured.low - margin, measured.high))
    curves = {member: curve(calibration, member, inside) for member in members}
    at_reference = {member: curve(calibration, member, np.array([reference])).value[0] for member in members}
    largest = max(float(np.abs(each.value - at_reference[member]).max()) for member, each in curves.items())
    size, unit = engineering(next(iter(curves.values())).unit, largest)
    for i, (member, each) in enumerate(curves.items()):
        colour, change = COLOURS[i % len(COLOURS)], (each.value - at_reference[member]) / size
        axes.plot(inside, change, color=colour, label=drawable(within_group(member)))
        if each.expanded is not None:
            band = each.expanded / size
            axes.fill_between(inside, change - band, change + band, color=colour, alpha=0.16, linewidth=0.0)
        for beyond in (low, high):
            extrapolated = (curve(calibration, member, beyond).value - at_reference[member]) / size
            axes.plot(beyond, extrapolated, color=colour, linestyle=(0, (3, 2)), linewidth=0.8)
    for edge in (low, high):
        axes.axvspan(float(edge[0]), float(edge[-1]), color=FAINT, alpha=0.45, linewidth=0.0, zorder=0)
    axes.axvline(reference, color=GREY, linewidth=0.6)
    axes.set(xlim=(low[0], high[-1]), ylabel=drawable(unit))
    grid(axes)
    axes.legend(loc="best", ncols=3, handlelength=1.0, columnspacing=1.0)
