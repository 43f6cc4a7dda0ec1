"""Task of a bench: session, programme, and wanted uncertainties."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from tumble.planning.setup import wanted_accuracies
from tumble.programme.positions import ANY_MOVE, Move, Programme
from tumble.recording.session import Session
from tumble.sensors.grades import grade
from tumble.sensors.parameters import usual_sizes
from tumble.units import Array

REMAINING_ERROR = 0.05  # fraction of the errors before calibration, if the noise of the grade allows
REST_NOISE = 0.2  # u of the mean of a rest, as a fraction of the wanted u of a bias
MIN_WARMING = 1.0  # K
_REST = 60.0  # s


def wanted_by_group(texts: Sequence[str], grade_name: str) -> dict[str, float]:
    """Return wanted standard uncertainties, SI, by group.

    They are given by texts such as "gyro.scale=2ppm"; for other groups they are a twentieth of the errors of the grade
    before calibration or, if larger, the u by one minute of its noise."""
    kind, wanted = grade(grade_name), {}
    noise = kind.noise
    for name, spread, white, instability, seconds, signal in (
        ("accel", kind.accel, noise.accel_white / _REST**0.5, noise.accel_instability, 1.0, 9.8),
        ("gyro", kind.gyro, noise.gyro_white * _REST**0.5, noise.gyro_instability * _REST, _REST, math.pi),
    ):
        level = math.hypot(white, instability)
        wanted[f"{name}.bias"] = max(REMAINING_ERROR * spread.bias, level / seconds)
        wanted[f"{name}.scale"] = max(REMAINING_ERROR * spread.scale, level / signal)
        wanted[f"{name}.axis"] = max(REMAINING_ERROR * spread.axis, 2.0 * level / signal)
    return wanted | wanted_accuracies(texts)


@dataclass(frozen=True, kw_only=True, slots=True)
class Wanted:
    """Wanted standard uncertainties, SI, by `group` of parameters, and of the mean of a rest (`accel`, `gyro`).

    `rest` is the duration of such a rest in white noise of the grade, s, `warming` the allowed change of temperature,
    K."""

    group: Mapping[str, float]
    accel: float
    gyro: float
    rest: float
    warming: float

    @staticmethod
    def of(texts: Sequence[str], grade_name: str) -> Wanted:
        """Return the uncertainties in texts, completed by a grade (`wanted_by_group`).

        u of the mean of a rest is a fifth of that of the biases or, if larger, that by one minute of noise. The allowed
        change of temperature changes a bias by its wanted u; it is at least MIN_WARMING."""
        group, noise, usual = wanted_by_group(texts, grade_name), grade(grade_name).noise, usual_sizes(grade_name)
        accel = max(REST_NOISE * group["accel.bias"], noise.accel_white / _REST**0.5)
        gyro = max(REST_NOISE * group["gyro.bias"], noise.gyro_white / _REST**0.5)
        return Wanted(
            group=group,
            accel=accel,
            gyro=gyro,
            rest=max(noise.accel_white / accel, noise.gyro_white / gyro) ** 2,
            warming=max(MIN_WARMING, *(group[name] / usual[f"{name}.t1"] for name in ("accel.bias", "gyro.bias"))),
        )


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Task:
    """A session, its programme (None: free positions), the grade of its unit, and the `wanted` uncertainties."""

    session: Session
    programme: Programme | None
    grade: str
    wanted: Wanted

    @staticmethod
    def of(session: Session, wanted: Wanted, grade: str) -> Task:
        """Return the task of a session; `grade` is used if the session gives none."""
        programme = None if session.programme is None else session.programme.listed
        return Task(session=session, programme=programme, grade=session.device.grade or grade, wanted=wanted)

    @property
    def positions(self) -> int | None:
        """Number of positions; None if they are free."""
        return None if self.programme is None else len(self.programme.positions)

    def move(self, index: int | None) -> Move:
        """Return the programme's turn into a position, from 0; ANY_MOVE if order or positions are free."""
        if self.programme is None or not self.programme.ordered or not 0 < (index or 0) <= len(self.programme.moves):
            return ANY_MOVE
        return self.programme.moves[(index or 0) - 1]

    def turn_b(self, index: int | None) -> tuple[Array, float] | None:
        """Return axis (3,), in the body frame before it, and angle, rad, of that turn; None for any turn."""
        move = self.move(index)
        if self.programme is None or index is None or move.axis is None or move.angle is None:
            return None
        return self.programme.positions[index - 1].matrix.T @ move.axis, move.angle
