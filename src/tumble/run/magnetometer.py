"""Parameters of the magnetometer of a session in its calibration.

The method `joint` estimates them (`tumble.inference.magnetometer`), always in the frame of the accelerometers. The bias
is what users call hard iron (the constant field that turns with the device); scale-factor errors and axis angles
together are the soft iron (fields induced in the device, from which errors of the channels cannot be separated).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from tumble.inference.estimate import Estimate
from tumble.inference.fits import MAGNETOMETER
from tumble.inference.magnetic_estimate import NEAR_EQUATOR, MagnetometerEstimate
from tumble.inference.sources import UncertaintyBudget, source
from tumble.recording.session import Channels
from tumble.reduction.observations import Observations
from tumble.result.calibration import Calibration
from tumble.result.uncertainty_budget import contributions_of
from tumble.run.from_estimate import extended, parameters_of
from tumble.sensors.model import Block
from tumble.units import DEGREE

PARAMETER_NAMES = Block(kind="mag", axes=np.eye(3)).names
MOST_NAMED = 6  # largest number of listed stretches of excluded nodes


def with_magnetometer(
    calibration: Calibration, estimate: Estimate, spec: Channels, observations: Observations
) -> Calibration:
    """Return a calibration with the parameters of the session's magnetometer, or with a note why it has none."""
    magnetometer, covariance = estimate.magnetometer, calibration.covariance
    if not isinstance(magnetometer, MagnetometerEstimate) or magnetometer.refused or covariance is None:
        why = magnetometer if isinstance(magnetometer, str) else magnetometer.refused if magnetometer else ""
        why = why or "it is calibrated with the other sensors by the method joint: take that"
        note = f"magnetometer: {why}, or leave [log.magnetometer] out; the rest of the session is calibrated without it"
        return extended(calibration, unobservable=PARAMETER_NAMES, notes=[note])
    # derivatives by the other parameters, which are neglected in another frame than `accelerometer`
    G, unit = np.zeros((len(magnetometer.values), len(covariance))), spec.unit_name
    if calibration.frame == "accelerometer":
        G = magnetometer.by_parameters[:, [estimate.names.index(p.name) for p in calibration.parameters]]
    across = G @ covariance
    joint_covariance = np.block([[covariance, across.T], [across, magnetometer.covariance + across @ G.T]])
    mag_covariance = joint_covariance[len(covariance) :, len(covariance) :]
    units, u = (unit,) * 3 + ("1",) * 3 + ("rad",) * 6, np.sqrt(mag_covariance.diagonal())
    by_fit = UncertaintyBudget(sources=(source("mag.fit"),), covariances=mag_covariance[None])
    parameters, evidence = parameters_of(magnetometer.names, magnetometer.values, u, unit=units), calibration.evidence
    with_parameters = replace(
        calibration,
        parameters=calibration.parameters + parameters,
        covariance=joint_covariance,
        mag=magnetometer.model,
        evidence=replace(
            evidence,
            fits={**evidence.fits, MAGNETOMETER: replace(magnetometer.fit, unit=unit)},
            budget=(*evidence.budget, *contributions_of(by_fit, magnetometer.names)),
        ),
    )
    return extended(with_parameters, notes=_notes(magnetometer, observations, spec))


def _notes(magnetometer: MagnetometerEstimate, observations: Observations, spec: Channels) -> Iterator[str]:
    """Return notes on hard and soft iron, an unknown field, and readings that were left out."""
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
    nodes = out[out >= len(rests)]
    stretches = np.split(nodes, np.flatnonzero(np.diff(nodes) > 1) + 1) if len(nodes) else []
    for stretch in stretches[:MOST_NAMED]:
        start, stop = magnetometer.time[stretch[[0, -1]]]
        yield (
            f"magnetometer: its readings from {start:.1f} to {stop:.1f} s were left out: up to "
            f"{magnetometer.sigmas[stretch].max():.1f} sigma"
        )
    if len(stretches) > MOST_NAMED:
        yield f"magnetometer: {len(stretches) - MOST_NAMED} more such stretches were left out"
    # order or signs of columns that differ from the accelerometers'; the latitude decides a common sign
    axes, latitude = magnetometer.magnetometer.block.axes, observations.site.latitude
    if np.array_equal(axes, np.eye(3)):
        return
    is_known = latitude is not None and abs(latitude) > NEAR_EQUATOR
    possible = [axes] if is_known else sorted((axes, -axes), key=lambda P: int((P < 0.0).sum()))
    orders = [  # such as "(my, mx, −mz)"
        ", ".join(("−" if row.sum() < 0.0 else "") + spec.columns[int(np.argmax(np.abs(row)))] for row in P.T)
        for P in possible
    ]
    yield (
        f"magnetometer: the field goes with the verticals with {' or '.join(f'({order})' for order in orders)} in "
        f"place of ({', '.join(spec.columns)}): columns are exchanged or mirrored, or its axes are not those of the "
        "accelerometers, in whose axes its parameters are"
    )
