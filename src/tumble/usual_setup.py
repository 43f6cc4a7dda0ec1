"""Defaults of a set-up for the library, the command line, campaigns and the operator's sheet, in the units of the
command line."""

from __future__ import annotations

from dataclasses import dataclass

GRADE = "navigation"
PROGRAMME = "rough-table"

LATITUDE_DEG = 56.84
HEIGHT = 270.0  # m over the ellipsoid, for normal gravity
GRAVITY_U = 1e-7  # m/s², standard uncertainty of measured gravity
TABLE_ERROR_DEG = 1.0
MOUNTING_ERROR_DEG = 1.0
SAMPLE_RATE = 100.0  # Hz


@dataclass(frozen=True, kw_only=True, slots=True)
class Pace:
    """Durations of rests and rate of turns: the first rest lasts at least `first_rest` s, every rest `rest` s; turns
    accelerate in `ramp` s to the rate `rate_deg_s`, °/s."""

    first_rest: float
    rest: float
    rate_deg_s: float
    ramp: float


ON_TABLE = Pace(first_rest=0.0, rest=60.0, rate_deg_s=10.0, ramp=1.0)
BY_HAND = Pace(first_rest=40.0, rest=5.0, rate_deg_s=80.0, ramp=0.5)

INSTABILITY_TIME = 300.0  # s, correlation time of in-run biases
MOVE = 30.0  # s, time on the operator's sheet for a move other than a turn of the table
