"""Several benches on one server: what the list shows of each, and which of them the operator goes to next."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from tumble.bench.station import Station

WANTS = ("fault", "turn", "done")
"""Screens that want the operator, the most urgent first."""


def shown(number: int, state: Mapping[str, Any]) -> dict[str, Any]:
    """A bench in the list: its unit, what it says, how far it is, and the time to go, s, where that is known."""
    rest, fault = state.get("rest"), state["fault"]
    return {
        "number": number,
        "unit": state["unit"],
        "session": state["session"],
        "screen": state["screen"],
        "said": fault["said"] if fault else state["headline"],
        "headline": state["headline"],
        "at": rest["number"] if rest else 0,
        "of": rest["of"] if rest else None,
        "left": rest.get("left") if rest else None,
        "to_go": state.get("to_go"),
        "result": state["result"],
        "source": state["received"]["source"],
        "trouble": list(state["received"]["trouble"]),
    }


def listed(stations: Sequence[Station]) -> dict[str, Any]:
    """All benches by their numbers, from 1, and the number of the one to go to `next`."""
    benches = [shown(k, station.state) for k, station in enumerate(stations, 1)]
    return {"benches": benches, "next": min(benches, key=_order)["number"]}


def _order(bench: Mapping[str, Any]) -> tuple[int, float]:
    """The benches that want the operator first, then the one whose rest ends next."""
    if bench["screen"] in WANTS:
        return WANTS.index(bench["screen"]), 0.0
    return len(WANTS), math.inf if bench["left"] is None else bench["left"]
