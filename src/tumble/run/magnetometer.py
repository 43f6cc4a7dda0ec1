"""The magnetometer of a session in its calibration: its parameters beside the others, and what is said of it.

It is part of the estimate of the method `joint` (`tumble.inference.magnetometer`); its parameters are in the frame of
the accelerometers, whatever that of the others is. In the words of its users, the bias is the hard iron (the constant
field that turns with the device), and scale-factor errors and axis angles together are the soft iron (fields induced in
the device, and the errors of the channels, which cannot be told from them).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import groupby

import numpy as np

from tumble.inference.estimate import Estimate
from tumble.inference.fits import MAGNETOMETER
from tumble.inference.magnetic_estimate import NEAR_EQUATOR, MagnetometerEstimate
from tumble.inference.sources import UncertaintyBudget, source
from tumble.recording.session import Channels
from tumble.reduction.observations import Observations
from tumble.result.calibration import Calibration
from tumble.result.parts import Parameter
from tumble.result.uncertainty_budget import contributions_of
from tumble.sensors.model import Block
from tumble.units import DEGREE, Array

PARAMETER_NAMES = Block(kind="mag", axes=np.eye(3)).names
"""The parameters of a magnetometer."""
MOST_NAMED = 6
"""Stretches of nodes that are named of those left out."""


def with_magnetometer(
    calibration: Calibration, estimate: Estimate, spec: Channels, observations: Observations
) -> Calibration:
    """A calibration with the parameters of the session's magnetometer; where that cannot be calibrated, without them,
    and a note says why."""
    magnetometer, covariance = estimate.magnetometer, calibration.covariance
    if not isinstance(magnetometer, MagnetometerEstimate) or magnetometer.refused or covariance is None:
        why = magnetometer if isinstance(magnetometer, str) else magnetometer.refused if magnetometer else ""
        why = why or "it is calibrated with the other sensors by the method joint: take that"
        note = f"magnetometer: {why}, or leave [log.magnetometer] out; the rest of the session is calibrated without it"
        missing = replace(calibration.outcome, unobservable=calibration.outcome.unobservable + PARAMETER_NAMES)
        provenance = replace(calibration.provenance, notes=(*calibration.provenance.notes, note))
        return replace(calibration, outcome=missing, provenance=provenance)
    whole = _with_covariance(calibration, magnetometer, estimate.names, covariance)
    own, unit = whole[len(covariance) :, len(covariance) :], spec.unit_name
    numbers = zip(magnetometer.names, magnetometer.values.tolist(), np.sqrt(own.diagonal()).tolist(), strict=True)
    units = (unit,) * 3 + ("1",) * 3 + ("rad",) * 6
    by_fit = UncertaintyBudget(sources=(source("mag.fit"),), covariances=own[None])
    notes = calibration.provenance.notes + tuple(_notes(magnetometer, observations, spec))
    evidence = calibration.evidence
    return replace(
        calibration,
        parameters=calibration.parameters
        + tuple(Parameter(name=n, value=x, u=u, unit=w) for (n, x, u), w in zip(numbers, units, strict=True)),
        covariance=whole,
        mag=magnetometer.model,
        evidence=replace(
            evidence,
            fits={**evidence.fits, MAGNETOMETER: replace(magnetometer.fit, unit=unit)},
            budget=(*evidence.budget, *contributions_of(by_fit, magnetometer.names)),
        ),
        provenance=replace(calibration.provenance, notes=notes),
    )


def _with_covariance(
    calibration: Calibration, magnetometer: MagnetometerEstimate, names: tuple[str, ...], covariance: Array
) -> Array:
    """The covariance of the parameters of a calibration and those of its magnetometer, which depend on the others by
    their derivatives; in another frame than that of the accelerometers as if by none."""
    G = np.zeros((len(magnetometer.values), len(covariance)))
    if calibration.frame == "accelerometer":
        columns = dict(zip(names, magnetometer.by_parameters.T, strict=True))
        for i, parameter in enumerate(calibration.parameters):
            G[:, i] = columns[parameter.name]
    across = G @ covariance
    return np.block([[covariance, across.T], [across, magnetometer.covariance + across @ G.T]])


def _notes(magnetometer: MagnetometerEstimate, observations: Observations, spec: Channels) -> Iterator[str]:
    """The result in the words of its users, readings that were left out, and what is not known."""
    model, unit, rests = magnetometer.model, spec.unit_name, observations.rests
    hard = ", ".join(f"{b:.4g}" for b in model.bias)
    soft = np.linalg.svd(model.matrix, compute_uv=False)
    yield (
        f"magnetometer: hard iron ({hard}) {unit}, to be subtracted; soft iron: the field is read {soft[2]:.4f} to "
        f"{soft[0]:.4f} times its size, depending on its direction, which matrix⁻¹ undoes; the field dips by "
        f"{magnetometer.dip / DEGREE:.1f}°"
    )
    if observations.site.field is None:
        yield (
            f"magnetometer: the field is not known (site.field) and was taken as {magnetometer.magnetometer.field:.5g} "
            f"{unit}, so that mag.scale is relative to the mean of the three; mag.bias and mag.axis do not depend on it"
        )
    out = np.flatnonzero(magnetometer.left_out)
    for i in out[out < len(rests)].tolist():
        yield (
            f"magnetometer: rest {i + 1} ({rests.start[i]:z.1f}–{rests.stop[i]:z.1f} s) was left out: "
            f"{magnetometer.sigmas[i]:.1f} sigma, the field is {magnetometer.off[i]:+.3g} {unit} off"
        )
    nodes = [
        list(run) for _, run in groupby(enumerate(out[out >= len(rests)].tolist()), lambda pair: pair[1] - pair[0])
    ]
    for run in nodes[:MOST_NAMED]:
        some = [i for _, i in run]
        yield (
            f"magnetometer: its readings from {magnetometer.time[some[0]]:.1f} to {magnetometer.time[some[-1]]:.1f} s "
            f"were left out: up to {magnetometer.sigmas[some].max():.1f} sigma"
        )
    if len(nodes) > MOST_NAMED:
        yield f"magnetometer: {len(nodes) - MOST_NAMED} more such stretches were left out"
    yield from _exchanged(magnetometer, observations, spec)


def _exchanged(magnetometer: MagnetometerEstimate, observations: Observations, spec: Channels) -> Iterator[str]:
    """That the columns are not in the order and of the signs of the axes of the accelerometers, if they are not: then
    the one that is, or, where the latitude does not tell, both."""
    axes, latitude = magnetometer.magnetometer.block.axes, observations.site.latitude
    if np.array_equal(axes, np.eye(3)):
        return
    known = latitude is not None and abs(latitude) > NEAR_EQUATOR
    possible = [axes] if known else sorted((axes, -axes), key=lambda P: int((P < 0.0).sum()))
    orders = [  # such as "(my, mx, −mz)"
        ", ".join(("−" if row.sum() < 0.0 else "") + spec.columns[int(np.argmax(np.abs(row)))] for row in P.T)
        for P in possible
    ]
    yield (
        f"magnetometer: the field goes with the verticals with {' or '.join(f'({order})' for order in orders)} in "
        f"place of ({', '.join(spec.columns)}): columns are exchanged or mirrored, or its axes are not those of the "
        "accelerometers, in whose axes its parameters are"
    )
