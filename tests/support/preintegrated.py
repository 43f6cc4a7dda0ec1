"""Rotations of turns and their sensitivities to the gyros, of the moments of samples."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from tumble.reduction.turns.moments import (
    NO_OWN_AXES,
    BlockCompensation,
    Compensation,
    Moments,
    OwnAxes,
    Pieces,
    integrate,
)
from tumble.units import Array

IntArray = npt.NDArray[np.int64]


def moments_of(pieces: Pieces, compensation: Compensation, own: OwnAxes = NO_OWN_AXES) -> Moments:
    """Moments of every single piece."""
    count = len(pieces.start)
    return integrate([replace(pieces, turn=np.arange(count))], count, compensation, own)


def preintegrate(
    increment: Array, dt: Array, starts: IntArray, stops: IntArray, transform: Array, offset: Array
) -> tuple[Array, Array, Array]:
    """C, M = ∫ C ⊗ ω dt and B = ∫ C dt of turns, of the moments of samples compensated to transform @ Δθ + offset
    dt."""
    nominal = np.eye(3), np.eye(3)
    gyro = BlockCompensation(
        axes=nominal[0],
        to_body=nominal[1],
        matrix=transform,
        bias=np.asarray(-np.linalg.solve(transform, offset)),
        terms=np.zeros((3, 3)),
    )
    accel = replace(gyro, matrix=np.eye(3), bias=np.zeros(3))
    pieces = Pieces(
        rates=increment / dt[:, None],
        forces=np.zeros_like(increment),
        intervals=dt,
        turn=np.arange(len(starts)),
        start=starts,
        stop=stops,
    )
    found = moments_of(pieces, Compensation(gyro=gyro, accel=accel, g_sensitivity=np.zeros((3, 3)), delay=0.0))
    return found.C, found.Phi[..., 1:4], found.Phi[..., 0]
