"""Summary of a campaign: outcomes of the trials, and their errors."""

from __future__ import annotations

from collections.abc import Sequence

from tumble.campaigns.campaign import SummaryLine, varying
from tumble.sensors.parameters import shown_in
from tumble.views.blocks import Block, table


def summary_blocks(lines: Sequence[SummaryLine]) -> list[Block]:
    """Return a table of the outcomes of the trials, and one of their errors."""
    axes, outcomes, errors = varying(lines), [], []
    previous: dict[str, str] = {}
    for line in lines:
        stated = {axis: value for axis in axes if (value := line.point[axis]) is not None}
        point = {axis: f"{value:g}" if isinstance(value, float) else str(value) for axis, value in stated.items()}
        point = dict.fromkeys(axes, "") | point | {"method": line.method}
        if point != previous:
            refused = line.trials - line.accepted - line.failed
            counts = {"trials": line.trials, "accepted": line.accepted, "not accepted": refused, "failed": line.failed}
            outcomes.append(point | {name: str(count) for name, count in counts.items()})
        if line.rms is not None and line.bias is not None and line.scatter is not None:
            size, unit = shown_in(line.group, line.unit, line.rms)
            sizes = {"bias": line.bias, "scatter": line.scatter, "rms": line.rms}
            row = dict(point) if point != previous else dict.fromkeys(point, "")
            row |= {"parameters": line.group} | {name: f"{value / size:.3g}" for name, value in sizes.items()}
            row |= {"unit": unit, "rms/bound": "" if line.to_bound is None else f"{line.to_bound:.3f}"}
            errors.append(row | {"coverage": "" if line.coverage is None else f"{line.coverage:.1%}"})
        previous = point
    words = ("method", "parameters", "unit")
    return [table(rows, words=words) for rows in (outcomes, errors) if rows]
