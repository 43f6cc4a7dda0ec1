"""Recordings over temperature as they are asked for: a text such as "-20/4,20,60" or "-20:60:-20/30"."""

from __future__ import annotations

import re

from tumble.errors import InputError
from tumble.planning.chamber_recordings import ChamberSession, CourseOfTemperature, rests_of
from tumble.planning.setup import Setup
from tumble.simulation.temperature_profile import TemperatureProfile, temperature_profile
from tumble.units import Array

MOST_RESTS = 200
"""Of one recording."""


def chamber_sessions(text: str, setup: Setup) -> tuple[ChamberSession, ...]:
    """The recordings of a text: between commas the temperature of each, °C, as `simulate --temperature` takes it, and
    after a slash how many rests of the set-up's programme it has, which begins anew after its last. Raises InputError,
    one line.

    >>> [len(one.programme.positions) for one in chamber_sessions("-20/4,20,-20:60:-20/30", Setup.of())]
    [4, 15, 30]
    """
    return tuple(_session(part.strip(), setup) for part in text.split(","))


def _session(text: str, setup: Setup) -> ChamberSession:
    profile, slash, count = text.partition("/")
    course, programme = temperature_profile(profile), setup.programme
    if slash:
        if not re.fullmatch(r"\d{1,3}", count) or not 1 <= int(count) <= MOST_RESTS:
            raise InputError(
                f"temperature: {text!r}: expected how many rests, 1 to {MOST_RESTS}, after the slash, found {count!r}"
            )
        programme = rests_of(programme, int(count))
    return ChamberSession(name=text, programme=programme, course=_course(course))


def _course(profile: TemperatureProfile) -> CourseOfTemperature:
    """The mean of its thermometers."""

    def course(duration: float) -> tuple[Array, Array]:
        climate = profile.climate(duration)
        return climate.time, climate.kelvin.mean(axis=1)

    return course
