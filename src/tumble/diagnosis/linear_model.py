"""The linear model where the instrument has more: whether the session shows it, and by how much it moves the result.

The methods beside `joint` have bias, scale factor and axis angles alone, and take what else there is for one of these:
a quadratic term of the accelerometers for a bias and scale factors. Two things are asked of such an estimate.

Its residuals are judged about the estimate that `joint` makes of the same model (`judged`), for the turns show most of
what rests alone can be fitted to. And what they do not show is counted (`tumble.diagnosis.left_out`): in u by the
method ellipsoid, which has no turns, in a note by the others.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tumble.diagnosis.left_out import left_out_of
from tumble.diagnosis.misfit import lost_by_velocities
from tumble.diagnosis.undetermined import linear_names
from tumble.inference.estimate import Estimate
from tumble.inference.joint import joint
from tumble.inference.likelihood import Linearised
from tumble.reduction.observations import Observations
from tumble.sensors.parameters import positions_by_group, shown_in
from tumble.units import Array


def judged(estimate: Estimate, observations: Observations, whole: Observations) -> Estimate:
    """An estimate of the linear model with a likelihood by which its residuals are judged, and with what the velocities
    of turns say of lost samples; `whole` are the observations that know the usual sizes of all groups."""
    if estimate.linearised is None:
        estimate = replace(estimate, linearised=_likelihood(estimate, observations))
    if estimate.linearised is None or not whole.unstamped or estimate.gyro is None:
        return estimate
    reasons, remarks = lost_by_velocities(estimate.linearised, whole)
    return replace(estimate, reasons=(*estimate.reasons, *reasons), remarks=(*estimate.remarks, *remarks))


def _likelihood(estimate: Estimate, observations: Observations) -> Linearised | None:
    """The likelihood about the joint estimate of the same sensors; None where there is none."""
    if estimate.unobservable or not estimate.converged:
        return None
    seen = observations if estimate.gyro is not None else observations.of_accelerometers()
    try:
        beside = joint(seen)
    except np.linalg.LinAlgError:
        return None
    return beside.linearised if beside.converged and not linear_names(beside.unobservable) else None


def left_out(estimate: Estimate, observations: Observations, whole: Observations) -> tuple[str, ...]:
    """What an estimate of the linear model leaves out, and by how much more than u that moves it, as a note."""
    block = observations.accel_block
    names = {name for name in whole.usual if name in _AT_REST}
    if not names or not set(block.names) <= set(estimate.names) or estimate.unobservable:
        return ()
    moved, u = moved_by(names, whole), estimate.u[: len(block.names)]
    said = []
    for name, at in positions_by_group(block.names).items():
        by, known = float(np.sqrt((moved[at] ** 2).mean())), float(np.sqrt((u[at] ** 2).mean()))
        if by > known:
            size, unit = shown_in(name, block.units[at[0]], by)
            said.append(f"{_WORDS[name]} by {by / size:.2g} {unit}")
    if not said:
        return ()
    return (
        f"not in the model: {', '.join(_AT_REST[name] for name in _AT_REST if name in names)} of the accelerometers; "
        f"where they are of the size usual in instruments of the grade, they move {', '.join(said)} (rms), which u "
        "does not contain; the method joint with all its terms does",
    )


def taken_as_nothing(estimate: Estimate) -> tuple[str, ...]:
    """That groups are nothing by the method and in its u by their size, where an estimate has such, as a note."""
    if not estimate.groups:
        return ()
    return (
        f"the method {estimate.method} takes all of it as nothing and has its usual size in u; the method joint finds "
        "what the session shows of it, and --terms linear leaves it out",
    )


_AT_REST = {
    "accel.quadratic": "quadratic terms",
    "accel.cubic": "cubic terms",
    "accel.asymmetry": "asymmetry",
}
"""Groups that change readings of the accelerometers at rest."""
_WORDS = {"accel.bias": "biases", "accel.scale": "scale factors", "accel.axis": "axis angles"}


def moved_by(names: set[str], observations: Observations) -> Array:
    """Standard deviations (m,) by which groups of their usual sizes move bias, scale factors and axis angles of the
    accelerometers in a fit to the rests that does not have them."""
    return np.asarray(np.linalg.norm(left_out_of(observations, names=names).by_usual, axis=1))
