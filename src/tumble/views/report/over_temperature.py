"""Section of a report on parameters over temperature, with U in the measured range and marked extrapolations."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from tumble.reduction.rests.thermometer import Thermometers
from tumble.result.calibration import Calibration
from tumble.result.temperature_curves import (
    measured_range,
    rests_with_temperature,
    temperature_curve,
    temperature_of,
    thermal_parameters,
    thermometer_notes,
)
from tumble.sensors.parameters import group_name, group_of, positions_by_group, sensor_kind, within_group
from tumble.units import Array, engineering
from tumble.views.blocks import Figure, Section, Table
from tumble.views.blocks import section as section_of
from tumble.views.numbers import cells, fixed, units_of_values
from tumble.views.render.characters import drawable
from tumble.views.render.pictures import COLOURS, FAINT, GREY, PAGE_WIDTH, grid, svg_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Canvas

MIN_PARTS = 5  # fewest parts of a rest that is drawn
EXTRAPOLATION = 0.12  # extent of the picture beyond the measured range, as a fraction of it


def section(calibration: Calibration, name: str) -> Section | None:
    """Return the section; None if no parameter changes with temperature or all rests had one temperature."""
    measured, reference = measured_range(calibration), calibration.reference_temperature
    names = thermal_parameters(calibration)
    if measured is None or reference is None or not names:
        return None
    (low, high), rows = measured, []
    celsius = np.array([low, reference, high])
    curves = [temperature_curve(calibration, each, celsius) for each in names]
    units = units_of_values((each.name, float(max(each.value, key=abs)), each.unit) for each in curves)
    for each in curves:
        size, unit = units[each.name]
        bands = [None] * 3 if each.expanded is None else each.expanded.tolist()
        shown = (cells(value, U, size) for value, U in zip(each.value.tolist(), bands, strict=True))
        rows.append((each.name, *(cell for pair in shown for cell in pair), unit))
    columns = ("parameter", *(cell for T in celsius.tolist() for cell in (f"at {fixed(T, 1)} °C", "U")), "unit")
    cubic = ", and + θ₃ (T − T₀)³ where there are some in t3" if any(n.endswith(".t3") for n in calibration) else ""
    text = (
        f"Measured from {fixed(low, 1)} to {fixed(high, 1)} °C. All other values in this report are "
        f"those at the reference temperature, {fixed(reference, 1)} °C; at T they are θ + θ₁ (T − T₀) + θ₂ (T − T₀)², "
        f"θ₁ and θ₂ being the parameters that end in t1 and t2{cubic}. U is that of the whole sum. Beyond the measured "
        "range the curve is an extrapolation, for which U does not stand."
    )
    text += "".join(f" {sentence[0].upper()}{sentence[1:]}." for sentence in thermometer_notes(calibration))
    has_dots = any(True for each in names for _ in rest_in_parts(calibration, each, reference))
    dots = "Dots: a rest in parts, moved onto the curve. " if has_dots else ""
    over = Figure(
        svg=_curves(name, calibration, names, measured, reference),
        caption=f"Change from the value at {fixed(reference, 1)} °C (upright line), with the band ±U of the value. "
        f"{dots}Marks at the foot: temperatures of the rests. Dashed, on grey: not measured.",
    )
    numbers = Table(columns=columns, rows=tuple(rows), text=(0, 7), dense=True)
    return section_of("Over temperature", text, numbers, over)


def _curves(
    name: str, calibration: Calibration, names: Sequence[str], measured: tuple[float, float], reference: float
) -> str:
    """Draw, in a panel for each group, the change of the parameters from their reference values, with ±U."""
    by_group = {group: [names[i] for i in members] for group, members in positions_by_group(names).items()}
    rests = rests_with_temperature(calibration)

    def draw(figure: Canvas) -> None:
        panels = figure.subplots(-(-len(by_group) // 2), 2, squeeze=False).ravel()
        for axes, members in zip(panels, by_group.values(), strict=False):
            _panel(axes, calibration, members, measured, reference)
            celsius = [temperature_of(rest, sensor_kind(members[0])) for rest in rests]
            marks: dict[str, Any] = {"color": GREY, "markersize": 4, "transform": axes.get_xaxis_transform()}
            axes.plot(celsius, np.zeros(len(celsius)), "|", **marks)
            axes.set_title(group_of(members[0]).words)
        for axes in panels[len(by_group) :]:
            axes.set_visible(False)
        for axes in panels[max(0, len(by_group) - 2) : len(by_group)]:
            axes.set_xlabel("°C")

    return svg_of(name, PAGE_WIDTH, 2.0 * -(-len(by_group) // 2) + 0.2, draw)


def rest_in_parts(calibration: Calibration, member: str, reference: float) -> Iterator[tuple[Array, Array]]:
    """Yield temperatures of the sensors, °C, which lag behind the thermometer, and readings of each rest in parts,
    shifted onto the curve of the bias; nothing for other parameters."""
    kind = sensor_kind(member)
    block, _ = calibration.compensator.sensors(kind)
    if group_name(member) != f"{kind}.bias" or block is None:
        return
    channel = dict(zip(block.sensors, block.channels.tolist(), strict=True))[within_group(member)]
    rests = [rest for rest in calibration.evidence.rests if getattr(rest, kind) is not None]
    begins = [not (b.file == a.file and b.start <= a.stop) for a, b in pairwise(rests)]
    for parts in np.split(np.arange(len(rests)), np.flatnonzero(begins) + 1):
        if len(parts) >= MIN_PARTS:
            thermometer = np.array([[temperature_of(rests[k], kind)] for k in parts])
            start, stop = (np.array([getattr(rests[k], end) for k in parts]) for end in ("start", "stop"))
            record = Thermometers.of({0: (0.5 * (start + stop), thermometer)})
            lag = calibration.compensator.lags.get(kind, 0.0)
            celsius = record.means(np.zeros(len(parts), int), start, stop, lag).kelvin[:, 0]
            read = np.array([getattr(rests[k], kind).mean[channel] for k in parts])
            at = temperature_curve(calibration, member, np.append(celsius, reference)).value
            yield celsius, read - (read - at[:-1] + at[-1]).mean()


def _panel(
    axes: Axes, calibration: Calibration, members: Sequence[str], measured: tuple[float, float], reference: float
) -> None:
    low, high = measured
    margin, inside, curves = EXTRAPOLATION * (high - low), np.linspace(low, high, 101), {}
    beyond = [np.linspace(start, start + margin, 15) for start in (low - margin, high)]
    for member in members:
        at_reference = temperature_curve(calibration, member, np.array([reference])).value[0]
        within = temperature_curve(calibration, member, inside)
        outside = [temperature_curve(calibration, member, T).value - at_reference for T in beyond]
        curves[member] = within.value - at_reference, within.expanded, outside
    size, unit = engineering(within.unit, max(float(np.abs(change).max()) for change, _, _ in curves.values()))
    for i, (member, (change, expanded, outside)) in enumerate(curves.items()):
        colour = COLOURS[i % len(COLOURS)]
        for celsius, read in rest_in_parts(calibration, member, reference):
            axes.plot(celsius, read / size, ".", color=colour, markersize=3.0, alpha=0.6)
        axes.plot(inside, change / size, color=colour, label=drawable(within_group(member)))
        if expanded is not None:
            least, most = (change - expanded) / size, (change + expanded) / size
            axes.fill_between(inside, least, most, color=colour, alpha=0.16, linewidth=0.0)
        for T, extrapolated in zip(beyond, outside, strict=True):
            axes.plot(T, extrapolated / size, color=colour, linestyle=(0, (3, 2)), linewidth=0.8)
    for T in beyond:
        axes.axvspan(float(T[0]), float(T[-1]), color=FAINT, alpha=0.45, linewidth=0.0, zorder=0)
    axes.axvline(reference, color=GREY, linewidth=0.6)
    axes.set(xlim=(beyond[0][0], beyond[1][-1]), ylabel=drawable(unit))
    grid(axes)
    axes.legend(loc="best", ncols=3, handlelength=1.0, columnspacing=1.0)
