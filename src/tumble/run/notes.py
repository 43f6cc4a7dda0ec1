"""Notes of a calibration: what was bridged or left out, and what the session does not tell, over temperature too."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from tumble.inference.estimate import Estimate
from tumble.inference.variables import at_two_temperatures, both_ways, over_a_range
from tumble.recording.rows.gaps import Gap
from tumble.reduction.observations import Observations
from tumble.reduction.rests.warming import OVER_TEMPERATURE
from tumble.run.case import CaseAlignment
from tumble.sensors.parameters import THERMAL, group_name, variable_of
from tumble.units import DEGREE, ZERO_CELSIUS

_GAPS_SHOWN = 5
ONE_RATE = 1.3
"""The largest rate of the turns, root mean square, in parts of the smallest, where they count as one rate: at rest,
scale factors that change with the square of the rate would be known seven times worse than at it."""


def bridged_in(found: Sequence[Gap]) -> tuple[str, ...]:
    """What was bridged or left out in the log, as notes: the first of each kind, and how many more."""
    kinds = {
        "bridged": [g for g in found if g.samples and g.integrable],
        "left out": [g for g in found if not g.samples],
        "gap": [g for g in found if not g.integrable],
    }
    notes = []
    for kind, gaps in kinds.items():
        for g in gaps[:_GAPS_SHOWN]:
            lost = f" ({g.samples} samples)" if g.samples > 1 else ""
            notes.append(
                f"{kind}: file {g.file + 1}, row {g.row}, {g.time:.3f} s: {g.what.removesuffix(': left out')}{lost}"
            )
        if len(gaps) > _GAPS_SHOWN:
            lost = f", {sum(g.samples for g in gaps)} samples in all" if gaps[0].samples else ""
            notes.append(f"{kind}: {len(gaps) - _GAPS_SHOWN} more such places{lost}")
    return tuple(notes)


def unchecked(estimate: Estimate) -> tuple[str, ...]:
    """What no redundancy checks, as notes."""
    fit = estimate.fits["accelerometers"]
    if fit.degrees >= 0.5 or estimate.unobservable:
        return ()
    return ("as many rests as accelerometer parameters: nothing checks the fit, a bad rest would go unnoticed",)


def one_rate(estimate: Estimate, observations: Observations) -> tuple[str, ...]:
    """Where all turns have about one rate, what the scale factors of the gyros are, as a note."""
    turns = observations.turns
    if estimate.method != "joint" or turns is None or any(group_name(name) == "gyro.cubic" for name in estimate.names):
        return ()
    about = None if estimate.linearised is None else estimate.linearised.about
    if about is None:
        return ()
    made = turns.duration > 0.0  # between the parts of a rest nothing is turned
    rates = np.sqrt(about.moments.body_rates[made][:, [0, 3, 5]].sum(axis=1) / turns.duration[made])
    if not len(rates) or not rates.max() < ONE_RATE * rates.min():
        return ()
    return (
        f"all turns have about {rates.mean() / DEGREE:.2g} °/s: the scale factors of the gyros hold at this rate; "
        "for others turn at a second rate too, or state gyro_cubic in [device.prior]",
    )


def case_found(case: CaseAlignment | None) -> tuple[str, ...]:
    """How the case was found, as a note."""
    if case is None:
        return ()
    u = np.sqrt(np.diag(case.alignment.covariance)) / DEGREE
    text = (
        f"case: from {len(case.rests)} rests on its six faces, which scatter by {case.scatter / DEGREE:.2g}° an axis; "
        f"standard uncertainty of its alignment {u[0]:.2g}°, {u[1]:.2g}°, {u[2]:.2g}° about X, Y, Z"
    )
    if not len(case.tilt):
        return (f"{text}; azimuths are not known, so that the tilt of the plate is part of the scatter",)
    lean = np.linalg.norm(case.tilt) / DEGREE
    return (f"{text}; the plate leans by {lean:.2g}° (u {np.linalg.norm(case.tilt_u) / DEGREE:.1g}°)",)


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
