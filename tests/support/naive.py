"""Plain twins of the compiled loops: the equations as they are printed, without regard to speed."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from tumble.sensors.model import Block
from tumble.units import Array

IntArray = npt.NDArray[np.int64]


def allan_sums(phase: Array, sizes: IntArray) -> Array:
    """Sums of the squared second differences of `phase` over each size: see `tumble.reduction.kernels.allan_sums`."""
    return np.array([np.sum((phase[2 * m :] - 2 * phase[m:-m] + phase[: -2 * m]) ** 2) for m in sizes])


def levinson(autocovariance: Array) -> tuple[list[Array], Array]:
    """Prediction-error filters and innovation variances of every order: see `tumble.reduction.kernels.levinson`."""
    filters, powers = [np.array([1.0])], [autocovariance[0]]
    for order in range(1, len(autocovariance)):
        previous = filters[-1]
        reflection = -(previous @ autocovariance[order:0:-1]) / powers[-1]
        if reflection**2 > 1.0 - 1e-9:
            break
        padded = np.append(previous, 0.0)
        filters.append(padded + reflection * padded[::-1])
        powers.append(powers[-1] * (1.0 - reflection**2))
    return filters, np.array(powers)


def fit_statics(readings: Array, gravity: float, steps: int) -> tuple[Array, Array]:
    """Values (9,) and variances (9,) of one triad from its mean readings (N, 3): see
    `tumble.campaigns.triads.fit_statics`."""
    block, values = Block(kind="accel", axes=np.eye(3)), np.zeros(9)
    for _ in range(steps):
        model, derivative = block.model(values), block.jacobian(values)
        rows, residual = np.empty((len(readings), 9)), np.empty(len(readings))
        for i, reading in enumerate(readings):
            a = np.linalg.solve(model.matrix, reading - model.bias)
            normal = np.linalg.solve(model.matrix.T, a / np.linalg.norm(a))
            rows[i] = normal @ np.einsum("pqm,q->pm", derivative, np.append(a, 1.0)) / np.linalg.norm(normal)
            residual[i] = (np.linalg.norm(a) - gravity) / np.linalg.norm(normal)
        values = values + np.linalg.lstsq(rows, residual)[0]
    return values, np.diag(np.linalg.inv(rows.T @ rows))
