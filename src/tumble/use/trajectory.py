"""Trajectories of vehicles: built in as data, or from the user's own file of time, position and attitude.

A built-in one is a list of segments, (duration s, speed m/s at the end, turn °, rate of climb m/s at the end). Speed,
heading and rate of climb go from one value to the next by 10 s³ − 15 s⁴ + 6 s⁵, so that forces and rates are
continuous. What stands or drives is level; what flies has its up axis along the specific force.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tumble.earth import normal_gravity, radii_of_curvature
from tumble.errors import InputError, did_you_mean
from tumble.files import FilePath
from tumble.rotation import UP, rotation_matrix, rotation_vector, unit_vector
from tumble.units import DEGREE, Array

STEP = 0.05
"""s, between the points of a trajectory."""
LONGEST = 4 * 3600.0
"""s, of a trajectory from a file."""

Segment = tuple[float, float, float, float]

_STANDING: tuple[Segment, ...] = ((600.0, 0, 0, 0),)
_CAR: tuple[Segment, ...] = (
    (3, 0, 0, 0), (8, 14, 0, 0), (9, 14, 10, 0), (5, 6, 0, 0), (5, 6, 90, 0),
    (8, 17, 0, 0), (8, 17, -40, 0), (6, 5, 0, 0), (5, 5, 90, 0), (3, 0, 0, 0),
)  # fmt: skip
_ROW: tuple[Segment, ...] = ((5, 10, 0, 0.5), (9, 10, 0, 0))
_CIRCUIT: tuple[Segment, ...] = (
    *_ROW, (4, 6, 90, -0.5), (4, 6, 90, 0),
    *_ROW, (4, 6, -90, -0.5), (4, 6, -90, 0), (28, 10, 0, 0),
)  # fmt: skip
_QUADROTOR: tuple[Segment, ...] = (
    (4, 0, 0, 0), (6, 0, 0, 2), (4, 0, 0, 0), *8 * _CIRCUIT, (4, 0, 0, -2), (4, 0, 0, -1), (2, 0, 0, 0),
)  # fmt: skip
BUILT_IN = {"standing": _STANDING, "car": _CAR, "quadrotor": _QUADROTOR}
"""By name: ten minutes at rest, a minute in town, ten minutes over a field, row beside row."""
_FLYING = ("quadrotor",)

AXES = ("x", "-x", "y", "-y", "z", "-z")
"""Axes of the body that may point forward or up in the vehicle."""
_LOCAL, _GEODETIC = ("north", "up", "east"), ("latitude", "longitude", "height")
_ANGLES = ("roll", "pitch", "heading")


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Trajectory:
    """Where a vehicle is and how it is turned, from its start on: every STEP from time 0 the position (N, 3), m north,
    up and east of the start, the velocity (N, 3), m/s, and the matrix (N, 3, 3) that takes body axes to N, U, E;
    `latitude`, rad, and `height`, m, of the start."""

    name: str
    position: Array
    velocity: Array
    mat_nb: Array
    latitude: float
    height: float

    @property
    def duration(self) -> float:
        """From the first point to the last, s."""
        return STEP * (len(self.position) - 1)


def built_in(name: str, latitude: float, height: float, mat_vb: Array) -> Trajectory:
    """A built-in trajectory that starts northwards at a place."""
    segments = np.array(BUILT_IN[name])
    ends = np.cumsum(segments[:, 0])
    time = np.arange(round(ends[-1] / STEP) + 1) * STEP
    k = np.minimum(np.searchsorted(ends, time, side="right"), len(ends) - 1)
    s = (time - (ends - segments[:, 0])[k]) / segments[k, 0]
    eased = s**3 * (10.0 - 15.0 * s + 6.0 * s**2)

    def course(at_end: Array) -> Array:
        before = np.concatenate([[0.0], at_end[:-1]])
        return np.asarray(before[k] + (at_end - before)[k] * eased)

    heading = course(np.cumsum(segments[:, 2]) * DEGREE)
    speed, climb = course(segments[:, 1]), course(segments[:, 3])
    ahead = np.column_stack([np.cos(heading), np.zeros_like(heading), np.sin(heading)])
    velocity = speed[:, None] * ahead + climb[:, None] * UP
    steps = 0.5 * STEP * (velocity[1:] + velocity[:-1])
    up = np.broadcast_to(UP, velocity.shape)
    if name in _FLYING:
        up = unit_vector(np.gradient(velocity, STEP, axis=0) + normal_gravity(latitude, height) * UP)
    forward = unit_vector(ahead - np.sum(ahead * up, axis=1, keepdims=True) * up)
    mat_nv = np.stack([forward, up, np.cross(forward, up)], axis=-1)
    position = np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])
    return Trajectory(
        name=name, position=position, velocity=velocity, mat_nb=mat_nv @ mat_vb, latitude=latitude, height=height
    )


def from_file(path: Path, latitude: float, height: float, mat_vb: Array) -> Trajectory:
    """The trajectory of a CSV or Parquet file with columns time, s; latitude, longitude, °, and height, m, or north, up
    and east, m; roll, pitch and heading of the vehicle, °: right side down, nose up, clockwise from north. Between its
    rows positions are on a cubic spline, and attitudes turn evenly. Raises InputError for a file that is none."""
    import polars as pl
    from scipy.interpolate import CubicSpline

    try:
        frame = pl.read_parquet(path) if path.suffix == ".parquet" else pl.read_csv(path)
    except (OSError, pl.exceptions.PolarsError) as error:
        raise InputError(f"{path}: expected a table of a trajectory, CSV or Parquet, found none: {error}") from error
    place = _GEODETIC if set(_GEODETIC) <= set(frame.columns) else _LOCAL
    wanted = ["time", *place, *_ANGLES]
    if missing := [name for name in wanted if name not in frame.columns]:
        raise InputError(
            f"{path}: expected columns time, latitude, longitude, height (or north, up, east), roll, pitch, heading, "
            f"found no {', '.join(missing)}"
        )
    try:
        table = frame.select(wanted).cast(pl.Float64).to_numpy()
    except pl.exceptions.PolarsError as error:
        raise InputError(f"{path}: expected numbers, found others in {', '.join(wanted)}") from error
    time = table[:, 0] - (table[0, 0] if len(table) else 0.0)
    if len(table) < 4 or not np.isfinite(table).all() or np.any(np.diff(time) <= 0.0) or time[-1] > LONGEST:
        raise InputError(
            f"{path}: expected four rows or more of finite numbers, time growing, over {LONGEST / 3600:g} h at most, "
            f"found {len(table)} rows"
        )
    position = table[:, 1:4]
    if place == _GEODETIC:
        angles, h = table[:, 1:3] * DEGREE, table[:, 3]
        latitude, height = float(angles[0, 0]), float(h[0])
        along, across = radii_of_curvature(angles[:, 0])
        east = (np.unwrap(angles[:, 1]) - angles[0, 1]) * (across + h) * np.cos(angles[:, 0])
        position = np.column_stack([(angles[:, 0] - latitude) * (along + h), h - height, east])
    roll, pitch, heading = table[:, 4:].T * DEGREE
    zero, level = np.zeros_like(roll), np.array([np.cos(heading), np.zeros_like(heading), np.sin(heading)])
    forward = (np.cos(pitch) * level + np.array([zero, np.sin(pitch), zero])).T
    up = (-np.sin(pitch) * level + np.array([zero, np.cos(pitch), zero])).T
    right = np.cross(forward, up)
    c, s = np.cos(roll)[:, None], np.sin(roll)[:, None]
    mat_nb = np.stack([forward, c * up + s * right, c * right - s * up], axis=-1) @ mat_vb

    spline = CubicSpline(time, position - position[0])
    at = np.arange(math.floor(time[-1] / STEP + 1e-9) + 1) * STEP
    k = np.minimum(np.searchsorted(time, at, side="right"), len(time) - 1) - 1
    turn = rotation_vector(np.swapaxes(mat_nb[:-1], 1, 2) @ mat_nb[1:])
    part = ((at - time[k]) / np.diff(time)[k])[:, None]
    return Trajectory(
        name=path.name,
        position=spline(at),
        velocity=spline(at, 1),
        mat_nb=mat_nb[k] @ rotation_matrix(part * turn[k]),
        latitude=latitude,
        height=height,
    )


def trajectory_of(given: FilePath, latitude: float, height: float, forward: str = "x", up: str = "z") -> Trajectory:
    """A built-in trajectory by its name, or that of a file, for a body with these axes forward and up in the vehicle.
    Raises InputError for anything else."""
    for name, axis in (("forward", forward), ("up", up)):
        if axis not in AXES:
            raise InputError(f"{name}: expected one of {', '.join(AXES)}, found {axis!r}")
    if forward[-1] == up[-1]:
        raise InputError(f"up: expected another axis than forward, {forward}, found {up}")
    first, second = (np.eye(3)["xyz".index(axis[-1])] * (-1.0 if axis[0] == "-" else 1.0) for axis in (forward, up))
    mat_vb = np.array([first, second, np.cross(first, second)])  # body axes to forward, up and right in the vehicle
    if str(given) in BUILT_IN:
        return built_in(str(given), latitude, height, mat_vb)
    if not Path(given).is_file():
        advice = did_you_mean(str(given), BUILT_IN)
        raise InputError(f"trajectory: expected {', '.join(BUILT_IN)} or a file, found {str(given)!r}{advice}")
    return from_file(Path(given), latitude, height, mat_vb)
