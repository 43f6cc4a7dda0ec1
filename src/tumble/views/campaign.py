"""How the trials of a campaign ended, and their errors."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from tumble.campaigns.campaign import SummaryLine, varying
from tumble.sensors.parameters import shown_in
from tumble.views.blocks import Block, table


def summary_blocks(lines: Sequence[SummaryLine]) -> list[Block]:
    """How the trials ended, then the errors, where there are any."""
    axes, ended, errors = varying(lines), [], []
    before: dict[str, str] = {}
    for line in lines:
        where = {axis: said(line.point[axis]) for axis in axes} | {"method": line.method}
        if where != before:
            refused = line.trials - line.accepted - line.failed
            counts = {"trials": line.trials, "accepted": line.accepted, "not accepted": refused, "failed": line.failed}
            ended.append(where | {name: str(count) for name, count in counts.items()})
        if line.rms is not None and line.bias is not None and line.scatter is not None:
            size, unit = shown_in(line.group, line.unit, line.rms)
            named = where if where != before else dict.fromkeys(where, "")
            sizes = {"bias": line.bias, "scatter": line.scatter, "rms": line.rms}
            errors.append(
                named
                | {"parameters": line.group}
                | {name: f"{value / size:.3g}" for name, value in sizes.items()}
                | {
                    "unit": unit,
                    "rms/bound": "" if line.to_bound is None else f"{line.to_bound:.3f}",
                    "coverage": "" if line.coverage is None else f"{line.coverage:.1%}",
                }
            )
        before = where
    words = ("method", "parameters", "unit")
    return [table(rows, words=words) for rows in (ended, errors) if rows]


def said(value: Any) -> str:
    """The value of an axis in words, nothing for none."""
    return "" if value is None else f"{value:g}" if isinstance(value, float) else str(value)
