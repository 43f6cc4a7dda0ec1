"""Whether two recordings are one, given twice: in other formats, or with other digits."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from tumble.errors import InputError
from tumble.units import Array, BoolArray

CLOSE = 0.5
"""Standard uncertainties of the noise of a mean: rounding changes it by less, and another recording of the same
attitude, whose means differ by √2 of them, is as close in six channels once in 2,500 times."""
SHARE = 0.5
"""Of the rests of the shorter recording, that have one like them in the other; chance makes two of them once in
millions."""
EQUAL = 1e-9
"""Relative: means of equal numbers that were added up in another way."""

Means = tuple[Array, Array]
"""Mean readings (N, n) of all channels at rest, and the standard uncertainties (N, n) of their noise."""


def check_recordings(recordings: Sequence[tuple[str, str, Means]]) -> None:
    """Raises InputError where two recordings, each with its name, the SHA-256 of the log and what its rests read, are
    one: they read the same to rounding, or neither rests and they are of one log."""
    for (name, digest, means), (other, other_digest, other_means) in combinations(recordings, 2):
        if same_recording(means, other_means) or (digest == other_digest and not len(means[0])):
            raise InputError(
                f"{other}: holds the same recording as {name}, their rests read the same to rounding; name every "
                "recording once"
            )


def same_recording(first: Means, second: Means) -> bool:
    """Whether rests of two recordings read the same values to rounding."""
    fewer = min(len(first[0]), len(second[0]))
    if not fewer or first[0].shape[1] != second[0].shape[1]:
        return False
    apart = np.abs(first[0][:, None] - second[0][None])
    near = CLOSE * np.minimum(first[1][:, None], second[1][None]) + EQUAL * np.abs(first[0][:, None])
    alike: BoolArray = np.asarray((apart <= near).all(axis=2))
    return bool(np.count_nonzero(alike.any(axis=1)) >= max(SHARE * fewer, 1))
