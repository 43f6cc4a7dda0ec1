"""Set-up of a calibration: instrument, programme on a table or positions by hand, and site.

    setup = Setup.of(grade="mems", programme="nine", rest=20.0)      in units of the command line
    setup = replace(setup, table_error=0.1 * DEGREE)                 in SI

Plans, simulated sessions and the cells of campaigns are made from it. Defaults are those of `tumble.usual_setup`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cache
from typing import Literal

import numpy as np

from tumble import usual_setup
from tumble.arguments import checked
from tumble.brief import Brief
from tumble.earth import normal_gravity
from tumble.errors import InputError
from tumble.programme.positions import Programme, timetable
from tumble.programme.positions import programme as built_in
from tumble.recording.session import USUAL_CLOCK_U
from tumble.sensors.grades import GRADES, NoiseModel, Spread, Spreads
from tumble.sensors.grades import grade as grade_named
from tumble.sensors.model import Block
from tumble.sensors.parameters import Terms, group_of, positions_by_group, quantity_of, usual_sizes
from tumble.units import DEGREE

ACCEL, GYRO = (Block(kind=kind, axes=np.eye(3)) for kind in ("accel", "gyro"))  # triads along the body axes
NAMES = ACCEL.names + GYRO.names  # the 21 parameters of the linear model, in the order of the calibration file
MEMBERS = {group: np.array(members) for group, members in positions_by_group(NAMES).items()}  # their indices
GROUPS = tuple(MEMBERS)  # groups of the linear model, in the order of the calibration file
UNITS = {group: group_of(group).unit for group in GROUPS}  # SI
LARGEST = 1e30  # size of a number of a set-up; the smallest that is not zero is its inverse

_programme = cache(built_in)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False, repr=False)
class Setup(Spreads, Brief):
    """Instrument, programme and site of a calibration, in SI and radians.

    Attributes
    ----------
    by_hand : int or None
        Number of positions in random attitudes by hand, instead of the programme.
    table_error, mounting_error : float
        Largest rotation about each axis, uniform within ±, of every position and of the whole launch; none by hand.
    first_rest, ramp : float
        Least duration of the first rest, and time in which turns reach, and again leave, their rate.
    instrument : str
        A grade, or the name of another instrument.
    accel, gyro, further
        Standard deviations of the linear parameters over instruments, and of groups beyond the linear model, which are
        their priors too.
    gravity_u, clock_u : float
        Standard uncertainty of gravity (`earth.NORMAL_GRAVITY_U` if not measured), relative one of the time base.
    """

    programme: Programme = field(default_factory=lambda: _programme(usual_setup.PROGRAMME))
    by_hand: int | None = None
    table_error: float = usual_setup.TABLE_ERROR_DEG * DEGREE
    mounting_error: float = usual_setup.MOUNTING_ERROR_DEG * DEGREE
    first_rest: float = usual_setup.ON_TABLE.first_rest
    rest: float = usual_setup.ON_TABLE.rest
    turn_rate: float = usual_setup.ON_TABLE.rate_deg_s * DEGREE
    ramp: float = usual_setup.ON_TABLE.ramp
    sample_rate: float = usual_setup.SAMPLE_RATE
    instrument: str = usual_setup.GRADE
    noise: NoiseModel = GRADES[usual_setup.GRADE].noise
    accel: Spread = GRADES[usual_setup.GRADE].accel
    gyro: Spread = GRADES[usual_setup.GRADE].gyro
    further: Mapping[str, float] = field(default_factory=dict, hash=False)
    latitude: float
    height: float = usual_setup.HEIGHT
    gravity: float
    gravity_u: float = usual_setup.GRAVITY_U
    clock_u: float = USUAL_CLOCK_U

    @staticmethod
    @checked
    def of(
        *,
        grade: str = usual_setup.GRADE,
        programme: str = usual_setup.PROGRAMME,
        positions: int | None = None,
        rest: float | None = None,
        rate_deg_s: float | None = None,
        sample_rate: float | None = None,
        table_error_deg: float = usual_setup.TABLE_ERROR_DEG,
        mounting_error_deg: float = usual_setup.MOUNTING_ERROR_DEG,
        latitude_deg: float = usual_setup.LATITUDE_DEG,
        gravity: float | None = None,
        gravity_u: float = usual_setup.GRAVITY_U,
        clock_ppm_u: float = 1e6 * USUAL_CLOCK_U,
        noise_factor: float = 1.0,
        instability_time: float = usual_setup.INSTABILITY_TIME,
        terms: Terms = "linear",
    ) -> Setup:
        """Return the set-up of a built-in programme, or of a number of positions by hand, in command-line units.

        Parameters are those of `Setup`; those that are None have the usual values on a table, or by hand with
        `positions`. `noise_factor` multiplies the noise of the grade, whose in-run biases have the correlation time
        `instability_time`, s. With the `terms` "full" the instrument has all groups of parameters, of usual sizes.

        Raises
        ------
        InputError
            For an unknown grade or programme, and for impossible numbers.

        Examples
        --------
        >>> import tumble
        >>> tumble.Setup.of(grade="mems", positions=30).rest
        5.0
        """
        if not abs(latitude_deg) <= 90.0:
            raise InputError(f"latitude: expected -90 to 90 degrees, found {latitude_deg:g}")
        if positions is not None and positions < 1:
            raise InputError(f"positions: expected at least 1, found {positions}")
        expect("noise_factor", noise_factor, least="0 or more")
        kind, usual = grade_named(grade), usual_setup.ON_TABLE if positions is None else usual_setup.BY_HAND
        latitude = latitude_deg * DEGREE
        return Setup(
            programme=_programme(programme),
            by_hand=positions,
            table_error=table_error_deg * DEGREE,
            mounting_error=mounting_error_deg * DEGREE,
            first_rest=usual.first_rest,
            rest=usual.rest if rest is None else rest,
            turn_rate=(usual.rate_deg_s if rate_deg_s is None else rate_deg_s) * DEGREE,
            ramp=usual.ramp,
            sample_rate=usual_setup.SAMPLE_RATE if sample_rate is None else sample_rate,
            instrument=grade,
            noise=replace(kind.noise.scaled(noise_factor), instability_time=instability_time),
            accel=kind.accel,
            gyro=kind.gyro,
            further=usual_sizes(grade) if terms == "full" else {},
            latitude=latitude,
            gravity=normal_gravity(latitude, usual_setup.HEIGHT) if gravity is None else gravity,
            gravity_u=gravity_u,
            clock_u=1e-6 * clock_ppm_u,
        )


def time_of(programme: Programme, setup: Setup) -> float:
    """Return the duration of a programme on the table of a set-up, s, to the end of its last rest."""
    return float(timetable(programme, rest=setup.rest, rate=setup.turn_rate, move=usual_setup.MOVE)[-1, 1])


def with_all_groups(setup: Setup) -> Setup:
    """Return the set-up with all groups of parameters, of the usual sizes of its grade unless stated.

    An instrument that is no grade, or has no noise, has the stated groups only."""
    if setup.instrument not in GRADES or setup.noise == setup.noise.scaled(0.0):
        return setup
    return replace(setup, further=usual_sizes(setup.instrument) | dict(setup.further))


def check_setup(setup: Setup) -> None:
    """Raise InputError for invalid values, and for a set-up that is not on a table."""
    if setup.by_hand is not None:
        raise InputError(f"programme: expected one on a table, found {setup.by_hand} positions by hand")
    if not abs(setup.latitude) < 0.5 * math.pi - DEGREE:
        found = setup.latitude / DEGREE
        raise InputError(f"latitude: expected within ±89 degrees, where TRIAD has an azimuth, found {found:g}")
    for name in ("rest", "turn_rate", "sample_rate", "gravity"):
        expect(name, getattr(setup, name), least="more than 0")
    if not 1.0 <= setup.gravity <= 100.0:
        raise InputError(f"gravity: expected 1 to 100 m/s^2, as a planet has, found {setup.gravity:g}")
    if setup.turn_rate > 1e5 * DEGREE:
        raise InputError(f"turn_rate: expected at most 1e5 deg/s, found {setup.turn_rate / DEGREE:g}")
    for name in ("table_error", "mounting_error", "gravity_u", "clock_u"):
        expect(name, getattr(setup, name), least="0 or more")
    for noise in fields(setup.noise):
        expect(f"noise.{noise.name}", getattr(setup.noise, noise.name), least="0 or more")
    for kind in ("accel", "gyro"):
        for what in ("bias", "scale", "axis"):
            expect(f"{kind}.{what}", getattr(getattr(setup, kind), what), least="more than 0")


def wanted_accuracies(texts: Sequence[str]) -> dict[str, float]:
    """Return wanted standard uncertainties, SI, by group, from texts such as "accel.scale=3.5ppm"; raise InputError."""
    wanted = dict[str, float]()
    for text in texts:
        name, _, value = text.partition("=")
        if name not in GROUPS:
            raise InputError(f"--want {text}: expected one of {', '.join(GROUPS)} before '=', found {name!r}")
        try:
            wanted[name] = quantity_of(group_of(name), value)
        except ValueError as error:
            raise InputError(f"--want {text}: {error}") from None
    return wanted


def expect(name: str, value: float, *, least: Literal["more than 0", "0 or more"]) -> None:
    """Raise InputError unless a value, SI, is `least`, and zero or between 1/LARGEST and LARGEST."""
    if not (0.0 < value < math.inf or (value == 0.0 and least == "0 or more")):
        raise InputError(f"{name}: expected {least}, in SI, found {value:g}")
    if value != 0.0 and not 1.0 / LARGEST <= value <= LARGEST:
        raise InputError(f"{name}: expected from {1.0 / LARGEST:g} to {LARGEST:g} in size, found {value:g}")
