"""What is to be recorded at a bench: the session, its programme, and the uncertainties that are wanted."""

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

PART_OF_SPREAD = 0.05
"""What a calibration is to leave of the errors before it, where the noise of the grade allows that."""
PART_OF_WISH = 0.2
"""Of the wanted u of a bias: what the noise of one rest may leave."""
LEAST_WARMING = 1.0
"""K."""
_REST = 60.0


def wishes(texts: Sequence[str], grade_name: str) -> dict[str, float]:
    """Wanted standard uncertainties, SI, by group.

    Those in texts such as "gyro.scale=2ppm"; for the other groups a twentieth of the errors of the grade before
    calibration or, if larger, what a minute of its noise leaves."""
    kind, wanted = grade(grade_name), {}
    noise = kind.noise
    for name, spread, white, instability, seconds, signal in (
        ("accel", kind.accel, noise.accel_white / _REST**0.5, noise.accel_instability, 1.0, 9.8),
        ("gyro", kind.gyro, noise.gyro_white * _REST**0.5, noise.gyro_instability * _REST, _REST, math.pi),
    ):
        level = math.hypot(white, instability)
        wanted[f"{name}.bias"] = max(PART_OF_SPREAD * spread.bias, level / seconds)
        wanted[f"{name}.scale"] = max(PART_OF_SPREAD * spread.scale, level / signal)
        wanted[f"{name}.axis"] = max(PART_OF_SPREAD * spread.axis, 2.0 * level / signal)
    return wanted | wanted_accuracies(texts)


@dataclass(frozen=True, kw_only=True, slots=True)
class Wanted:
    """What is wanted of a session: standard uncertainties, SI, by `group` of parameters, and of the mean of a rest,
    m/s² and rad/s; the duration of such a `rest` in white noise of the grade, s; and by how much the temperature may
    change, K (`warming`)."""

    group: Mapping[str, float]
    accel: float
    gyro: float
    rest: float
    warming: float

    @staticmethod
    def of(texts: Sequence[str], grade_name: str) -> Wanted:
        """Wishes in texts, completed by a grade (`wishes`).

        The uncertainty of the mean of a rest is a fifth of that of the biases or, if larger, what a minute of the noise
        of the grade leaves. The temperature may change until it moves a bias of the grade by its wanted uncertainty,
        and by LEAST_WARMING in any case."""
        group, noise, usual = wishes(texts, grade_name), grade(grade_name).noise, usual_sizes(grade_name)
        accel = max(PART_OF_WISH * group["accel.bias"], noise.accel_white / _REST**0.5)
        gyro = max(PART_OF_WISH * group["gyro.bias"], noise.gyro_white / _REST**0.5)
        return Wanted(
            group=group,
            accel=accel,
            gyro=gyro,
            rest=max(noise.accel_white / accel, noise.gyro_white / gyro) ** 2,
            warming=max(LEAST_WARMING, *(group[name] / usual[f"{name}.t1"] for name in ("accel.bias", "gyro.bias"))),
        )


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Task:
    """A session, its programme, None in free positions, the grade of its unit and what is `wanted` of it."""

    session: Session
    programme: Programme | None
    grade: str
    wanted: Wanted

    @staticmethod
    def of(session: Session, wanted: Wanted, grade: str) -> Task:
        """Of a session; `grade` is that of a unit whose session does not say one."""
        programme = None if session.programme is None else session.programme.listed
        return Task(session=session, programme=programme, grade=session.device.grade or grade, wanted=wanted)

    @property
    def positions(self) -> int | None:
        """How many positions there are to take; None where they are free."""
        return None if self.programme is None else len(self.programme.positions)

    def move(self, index: int | None) -> Move:
        """The turn into a position, from 0, of the programme; any where its order or its positions are free."""
        if self.programme is None or not self.programme.ordered or not 0 < (index or 0) <= len(self.programme.moves):
            return ANY_MOVE
        return self.programme.moves[(index or 0) - 1]

    def turn_b(self, index: int | None) -> tuple[Array, float] | None:
        """Axis (3,), in the body before it, and angle, rad, of that turn; None where any is as good."""
        move = self.move(index)
        if self.programme is None or index is None or move.axis is None or move.angle is None:
            return None
        return self.programme.positions[index - 1].matrix.T @ move.axis, move.angle
