"""What the temperatures of a calibration determine and what they leave to what is usual, as notes."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from tumble.inference.estimate import Estimate
from tumble.inference.variables import at_two_temperatures, both_ways, over_a_range
from tumble.reduction.observations import Observations
from tumble.reduction.rests.warming import OVER_TEMPERATURE
from tumble.sensors.parameters import THERMAL, variable_of
from tumble.units import ZERO_CELSIUS


def over_temperature(estimate: Estimate, observations: Observations) -> Iterator[str]:
    """What the temperatures of several sessions, or of a session over temperature, determine, and what not."""
    kelvin = observations.rests.temperature
    if kelvin is None or (observations.together is None and not over_a_range(observations)):
        return
    low, high = kelvin.min() - ZERO_CELSIUS, kelvin.max() - ZERO_CELSIUS
    yield f"temperatures of the rests: {low:z.1f} to {high:z.1f} °C; beyond them nothing was measured"
    if not over_a_range(observations):
        yield (
            f"temperatures span {np.ptp(kelvin):.1f} K, less than {OVER_TEMPERATURE:.0f}: coefficients over "
            "temperature are mostly what is usual; take sessions at temperatures further apart"
        )
        return
    yield from _left_open(estimate, observations)
    turned = observations.turns is not None and bool((observations.turns.duration > 0.0).any())
    if turned:
        yield from _where_turned(observations)
    lag = next((group for group in estimate.groups if group.name == "temperature.lag" and group.kept), None)
    if lag is not None and not both_ways(observations):
        u = float(estimate.u[estimate.names.index("temperature.lag")])
        yield (
            f"the temperature was not passed both ways: the lag behind the thermometer is known to {u:.0f} s only, and "
            "hysteresis not at all, which is in u by its usual size; ramp up and down in one recording"
        )


def _left_open(estimate: Estimate, observations: Observations) -> Iterator[str]:
    """Which coefficients the temperatures say nothing of, and why."""
    if at_two_temperatures(observations):
        yield (
            "coefficients t2 are what is usual, which is in the u of biases and scale factors at the reference "
            "temperature: two temperatures show slopes and no curvature; take a third between them"
        )
        return
    left = [group.name for group in estimate.groups if variable_of(group.name) in THERMAL and not group.kept]
    if left:
        yield f"nothing is seen of {', '.join(left)}: turn at more temperatures, each axis up and down"


def _where_turned(observations: Observations) -> Iterator[str]:
    """Whether rests that are joined by turns, which alone show scale factors, span the temperatures."""
    kelvin, turns = observations.rests.temperature, observations.turns
    assert kelvin is not None
    assert turns is not None
    really = turns.duration > 0.0
    at = kelvin[np.concatenate([turns.first[really], turns.last[really]])]
    if np.ptp(at) < 0.5 * np.ptp(kelvin):
        yield (
            f"turns span {at.min() - ZERO_CELSIUS:z.1f} to {at.max() - ZERO_CELSIUS:z.1f} °C only: how scale factors "
            "change beyond that is what is usual; turn at the other temperatures too"
        )
