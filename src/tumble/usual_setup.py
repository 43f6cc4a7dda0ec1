"""What a set-up is where nothing else is stated: the one place of these numbers, for the library, the command line,
campaigns and the operator's sheet, in the units of the command line. `tumble.planning.setup` makes set-ups of them.
"""

from __future__ import annotations

from dataclasses import dataclass

GRADE = "navigation"
PROGRAMME = "rough-table"

LATITUDE_DEG = 56.84
HEIGHT = 270.0
"""m over the ellipsoid, where gravity is the normal one."""

GRAVITY_U = 1e-7
"""m/s², standard uncertainty of gravity, which has been measured."""

TABLE_ERROR_DEG = 1.0
MOUNTING_ERROR_DEG = 1.0
SAMPLE_RATE = 100.0
"""Hz."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Pace:
    """How long rests last and how fast the turns between them are: the first rest lasts `first_rest` s at least, every
    rest `rest` s; turns have the rate `rate_deg_s`, °/s, reached and left in `ramp` s."""

    first_rest: float
    rest: float
    rate_deg_s: float
    ramp: float


ON_TABLE = Pace(first_rest=0.0, rest=60.0, rate_deg_s=10.0, ramp=1.0)
BY_HAND = Pace(first_rest=40.0, rest=5.0, rate_deg_s=80.0, ramp=0.5)

INSTABILITY_TIME = 300.0
"""s, correlation time of in-run biases."""

MOVE = 30.0
"""s, what the operator's sheet allows for a move that is not a turn of the table."""
