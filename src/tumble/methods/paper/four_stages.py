"""The four stages of the paper's method, each with the results of the stage before, and what they need to know.

    1  biases and scale factors of the accelerometers     from rests
    2  angles between the axes of the accelerometers      from rests (the scalar method does 1 and 2 at once)
    3  biases of the gyros                                from rests in which each is vertical, Eq. (18)
    4  scale factors and axis angles of the gyros         from turns, by the indirect method

All stages together are a pass. It starts from the models of the pass before (at first from nominal sensors), looks at
readings compensated by them, and composes what it finds with them, exactly. `iterations` repeats it.
Stage 3 is the one of the paper's ways that needs neither more positions nor an azimuth: it holds for any bias, where
the polar axis (17) and the scalar method want one far below the Earth's rate. Stage 4 uses the programme matrix of
§6.3 and plain least squares, as the paper has it.

The stages take any leading axes. Source: Vodicheva & Parysheva 2019; the turntable method, §2 to §6.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from tumble.earth import earth_rate
from tumble.errors import InputError, ProgrammeError, SessionError
from tumble.methods.paper.accuracy_formulas import solved
from tumble.methods.paper.gyro_bias import STANDING, vertical_bias
from tumble.methods.paper.indirect import (
    RecordedTurn,
    Series,
    check_directions,
    horizontal_differences,
    known_turns,
    programme_matrix,
)
from tumble.methods.paper.levelling import triad
from tumble.programme.positions import Programme
from tumble.reduction.observations import Observations
from tumble.sensors.model import SensorModel, triad_model
from tumble.units import Array


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class PaperMethod:
    """What tells the pipelines apart. `accelerometers(readings, nominal, gravity)` is stages 1 and 2, and
    `check(nominal)` raises ProgrammeError where the rests, with nominal verticals (N, 3), are not enough."""

    name: str
    accelerometers: Callable[[Array, Array, Array], SensorModel]
    check: Callable[[Array], None]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ProgrammeCourse:
    """What is known of a session's rests and turns from its programme: nominal verticals (N, 3) in the body, series
    of recorded turns, durations (K,) of all turns, the Earth's rate (3,) in N, U, E, and the programme matrix."""

    nominal: Array
    series: tuple[Series, ...]
    duration: Array
    earth_rate: Array
    matrix: Array


# One pass


def accelerometer_pass(
    method: PaperMethod, course: ProgrammeCourse, readings: Array, gravity: Array, before: SensorModel
) -> SensorModel:
    """Stages 1 and 2: the model after a pass over readings (..., N, 3), given the one before."""
    return before.composed(method.accelerometers(before.apply(readings), course.nominal, gravity))


def gyro_bias_pass(course: ProgrammeCourse, rates: Array, force: Array, before: SensorModel) -> SensorModel:
    """Stage 3: the gyro model with the biases of this pass, from rates (..., N, 3) and calibrated specific forces."""
    bias = vertical_bias(before.apply(rates), force, course.earth_rate, course.nominal)
    return before.composed(SensorModel(matrix=np.eye(3), bias=bias))


def gyro_matrix_pass(course: ProgrammeCourse, rates: Array, force: Array, C: Array, before: SensorModel) -> SensorModel:
    """Stage 4: the gyro model after a pass, with turns C (..., K, 3, 3) integrated about the model `before`."""
    x = solved(course.matrix, differences(course, rates, force, C, before))
    return before.composed(triad_model(np.zeros_like(x[..., :3]), x[..., :3], x[..., 3:]))


def differences(course: ProgrammeCourse, rates: Array, force: Array, C: Array, model: SensorModel) -> Array:
    """y (..., 2T) of the indirect method for a gyro model and the turns integrated about it."""
    attitude = triad(force, model.apply(rates))
    return horizontal_differences(course.series, attitude, force, C, course.duration, course.earth_rate)


# The course of a session


def course_of(observations: Observations, method: PaperMethod) -> ProgrammeCourse:
    """The course of a session, with everything the method needs checked. Raises InputError."""
    programme, position = observations.programme, observations.position
    if programme is None or position is None:
        raise ProgrammeError(
            f"method {method.name}: expected a programme with known positions and turns, such as rough-table, "
            "found none; give [programme] in session.toml or take the method staged"
        )
    _check_sensors(observations, method)
    nominal = np.array([programme.positions[k].vertical_b for k in position])
    method.check(nominal)
    if observations.gyro_block is None:
        return ProgrammeCourse(
            nominal=nominal, series=(), duration=np.empty(0), earth_rate=np.zeros(3), matrix=np.empty((0, 9))
        )
    _check_standing(nominal, method)
    check_directions(programme)
    return ProgrammeCourse(
        nominal=nominal,
        series=_recorded(observations, programme),
        duration=np.empty(0) if observations.turns is None else observations.turns.duration,
        earth_rate=_earth_rate(observations, method),
        matrix=programme_matrix(programme)[0],
    )


def _check_sensors(observations: Observations, method: PaperMethod) -> None:
    for block in (observations.accel_block, observations.gyro_block):
        if block is not None and not block.triad:
            raise InputError(
                f"method {method.name}: expected three sensors of a kind along the body axes, found {block.size} "
                f"({block.kind}) with other directions; take the method staged"
            )


def _check_standing(nominal: Array, method: PaperMethod) -> None:
    if not np.all(np.any(np.abs(nominal) > 1.0 - STANDING, axis=0)):
        raise ProgrammeError(
            f"method {method.name}: expected rests in which X, Y and Z each are vertical, found others in the "
            "programme; take the programme rough-table or the method staged"
        )


def _earth_rate(observations: Observations, method: PaperMethod) -> Array:
    if observations.site.latitude is None:
        raise SessionError(
            f"[site]: expected latitude_deg, from which the method {method.name} has the Earth's rate, found none; "
            "give it or take the method staged"
        )
    return np.array(earth_rate(observations.site.latitude))


def _recorded(observations: Observations, programme: Programme) -> tuple[Series, ...]:
    """The recorded turns of every series of known turns, from the first rest in its first position on."""
    assert observations.position is not None
    between = {} if observations.turns is None else {int(a): k for k, a in enumerate(observations.turns.first)}
    course = []
    for moves in known_turns(programme):
        rests = np.flatnonzero((observations.position >= moves[0]) & (observations.position <= moves[-1] + 1))
        for rest in rests[:-1]:
            if int(rest) not in between:
                raise ProgrammeError(
                    f"programme {programme.name}: expected the turn from rest {rest + 1} to rest {rest + 2} in the "
                    "log, found the end of a file; record every series in one file or take the method staged"
                )
        course.append(
            tuple(
                RecordedTurn(
                    turn=between[int(a)],
                    first=int(a),
                    last=int(b),
                    counts=bool(observations.position[a] != observations.position[b]),
                )
                for a, b in pairwise(rests)
            )
        )
    return tuple(course)
