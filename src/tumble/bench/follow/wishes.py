"""What is to be recorded at a bench: the session, its programme, the uncertainties that are wanted, and what of them is
reached."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from tumble.bench.state import GroupShown
from tumble.inference.estimate import Estimate
from tumble.planning.requirements import wanted_of
from tumble.planning.setup import Setup
from tumble.programme.positions import ANY_MOVE, Move, Programme, from_attitudes
from tumble.programme.positions import programme as built_in
from tumble.recording.session import Session
from tumble.sensors.grades import Grade, grade
from tumble.sensors.model import Block
from tumble.sensors.parameters import group_name, positions_by_group, shown_in, usual_sizes
from tumble.units import Array

PART_OF_SPREAD = 0.05
"""What a calibration is to leave of the errors before it, where the noise of the grade allows that."""
PART_OF_WISH = 0.2
"""Of the wanted u of a bias: what the noise of one rest may leave."""
LEAST_WARMING = 1.0
"""K."""
_REST = 60.0
_MORE = 5


def wishes(texts: Sequence[str], grade_name: str) -> dict[str, float]:
    """Wanted standard uncertainties, SI, by group: those in texts such as "gyro.scale=2ppm" and, for the others, of the
    grade: a twentieth of its errors before calibration or, where that is more, what a minute of its noise leaves."""
    kind = grade(grade_name)
    stated = wanted_of(texts, None, Setup.of(grade=grade_name)) if texts else {}
    return _of_grade(kind) | stated


@dataclass(frozen=True, kw_only=True, slots=True)
class Wanted:
    """What is wanted of a session: standard uncertainties, SI, by `group`; u of the mean of a rest, `accel`, m/s², and
    `gyro`, rad/s; how long a `rest` of the white noise of the grade alone is then, s; and by how much, K, the
    temperature may change, the `warming`."""

    group: Mapping[str, float]
    accel: float
    gyro: float
    rest: float
    warming: float

    @staticmethod
    def of(texts: Sequence[str], grade_name: str) -> Wanted:
        """What texts and a grade ask for (`wishes`). The mean of a rest is to be known to a fifth of the u of the
        biases or, where that is more, to what a minute of the noise of the grade leaves. The temperature may change by
        as much as moves a bias of instruments of the grade by what is wanted of it, and by LEAST_WARMING at least."""
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


def _of_grade(kind: Grade) -> dict[str, float]:
    noise, wanted = kind.noise, {}
    for name, spread, white, instability, seconds, signal in (
        ("accel", kind.accel, noise.accel_white / _REST**0.5, noise.accel_instability, 1.0, 9.8),
        ("gyro", kind.gyro, noise.gyro_white * _REST**0.5, noise.gyro_instability * _REST, _REST, math.pi),
    ):
        level = math.hypot(white, instability)
        wanted[f"{name}.bias"] = max(PART_OF_SPREAD * spread.bias, level / seconds)
        wanted[f"{name}.scale"] = max(PART_OF_SPREAD * spread.scale, level / signal)
        wanted[f"{name}.axis"] = max(PART_OF_SPREAD * spread.axis, 2.0 * level / signal)
    return wanted


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
        spec, programme = session.programme, None
        if spec is not None:
            attitudes = [position.attitude for position in spec.positions]
            programme = from_attitudes(attitudes) if spec.name is None else built_in(spec.name)
        return Task(session=session, programme=programme, grade=session.device.grade or grade, wanted=wanted)

    @property
    def positions(self) -> int | None:
        """How many positions there are to take; None where they are free."""
        return None if self.programme is None else len(self.programme.positions)

    def move(self, index: int) -> Move:
        """The turn into a position, from 0, of the programme; any where its order or its positions are free."""
        if self.programme is None or not self.programme.ordered or not 0 < index <= len(self.programme.moves):
            return ANY_MOVE
        return self.programme.moves[index - 1]


def reached(estimate: Estimate, wanted: Mapping[str, float]) -> list[GroupShown]:
    """What of the wishes an estimate reaches, by group in the order of its parameters, other groups passed over: the
    largest u of its parameters in the unit in which `tumble calibrate` shows them, and whether the data tell all."""
    groups: list[GroupShown] = []
    for group, rows in positions_by_group(estimate.names).items():
        if group not in wanted:
            continue
        u, determined = float(estimate.u[rows].max()), bool(estimate.observable[rows].all())
        rms = float(np.sqrt(np.mean(estimate.values[rows] ** 2)))
        size, unit = shown_in(group, estimate.units[rows[0]], rms)
        groups.append(
            {
                "group": group,
                "unit": unit,
                "u": u / size,
                "wanted": wanted[group] / size,
                "determined": determined,
                "enough": determined and u <= wanted[group],
            }
        )
    return groups


def better_by(rests: int) -> float:
    """How many times better five more rests would make it, as the root of their number."""
    return math.sqrt((rests + _MORE) / rests)


DIRECTIONS = np.array([d for d in np.ndindex(3, 3, 3) if d != (1, 1, 1)], dtype=float) - 1.0
DIRECTIONS /= np.linalg.norm(DIRECTIONS, axis=1, keepdims=True)
"""The 26 faces, edges and corners of a cube, from its middle."""


def gains(estimate: Estimate, wanted: Mapping[str, float], block: Block, rest_u: float, gravity: float) -> Array:
    """What a further rest with the vertical along each of DIRECTIONS (26,) leaves of the accelerometers' u over the
    wanted ones (root mean square), from what is measured so far: its reading has the length of gravity, which is one
    row of the covariance of the estimate, without what its turn would tell of the gyros."""
    rows = [estimate.names.index(name) for name in block.names]
    C = estimate.covariance[np.ix_(rows, rows)]
    weight = np.array([wanted.get(group_name(name), np.inf) for name in block.names])
    before = float(np.sqrt((np.diag(C) / weight**2).sum()))
    J = np.einsum("pn,nkm->pkm", np.linalg.pinv(block.axes), block.jacobian(np.zeros(len(rows))))
    force = np.column_stack([gravity * DIRECTIONS, np.ones(len(DIRECTIONS))])
    h = np.einsum("qp,pkm,qk->qm", DIRECTIONS, J, force)
    Ch = h @ C
    left = np.diag(C) - Ch**2 / (rest_u**2 + np.einsum("qm,qm->q", h, Ch))[:, None]
    return np.asarray(np.sqrt((np.maximum(left, 0.0) / weight**2).sum(axis=1)) / before)
