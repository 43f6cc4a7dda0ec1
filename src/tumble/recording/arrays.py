"""Checked conversion of readings in memory, SI arrays or polars or pandas frames, to arrays and sessions."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, TypedDict, Unpack

import numpy as np
import numpy.typing as npt

from tumble.arguments import array_of
from tumble.errors import InputError
from tumble.recording.session import Session
from tumble.recording.session_file import session_of
from tumble.units import ACCEL_UNITS, DEGREE, GYRO_UNITS, ZERO_CELSIUS, Array

SI = {"accel": ("m/s^2", "m/s"), "gyro": ("rad/s", "rad")}
"""Units of rates and of increments."""
_UNITS = {"accel": ACCEL_UNITS, "gyro": GYRO_UNITS}
Temperatures = npt.ArrayLike | Mapping[str, npt.ArrayLike]
"""Temperatures of one thermometer, or by kind of sensor."""
_COLDEST = 150.0  # K; lower numbers are in °C
_GRAVITY_LIMITS = (7.0, 13.0)  # m/s², for the median length of readings that are mostly at rest


class SensorArrays(TypedDict, total=False):
    """Readings in memory in SI, as arrays, polars or pandas frames, and statements about them.

    Attributes
    ----------
    accel : array_like, shape (N, n)
        Specific force, m/s²; required except for the biases of gyros alone.
    gyro : array_like, shape (N, n)
        Angular rate, rad/s.
    time : array_like, shape (N,)
        Time at the end of each sample, s; either this or `rate` is required.
    rate : float
        Samples per second.
    temperature : array_like, shape (N,), or mapping of str to array_like
        Temperature, K; for several thermometers a mapping of "accel" and "gyro" to (N,) or (N, n).
    latitude, height : float
        Geodetic latitude, rad, and height, m; without a height, the uncertainty of gravity includes 1300 m.
    gravity, gravity_u : float
        Gravity and its standard uncertainty, m/s²; by default normal gravity.
    accel_axes, gyro_axes : array_like, shape (n, 3)
        Nominal sensing directions in the body, unit vectors; required for more than three sensors.
    programme : str or sequence of str
        Name of a programme, or attitudes of its positions in order.
    serial : str
        Serial number of the device.
    clock_ppm_u : float
        Standard uncertainty of the time base, parts per million, 0 for an exact one; by default 30 for times and 10,000
        for a rate.
    """

    accel: npt.ArrayLike
    gyro: npt.ArrayLike | None
    time: npt.ArrayLike | None
    rate: float | None
    temperature: Temperatures | None
    latitude: float | None
    height: float | None
    gravity: float | None
    gravity_u: float | None
    accel_axes: npt.ArrayLike | None
    gyro_axes: npt.ArrayLike | None
    programme: str | Sequence[str] | None
    serial: str
    clock_ppm_u: float | None


def session_of_arrays(**arrays: Unpack[SensorArrays]) -> Session:
    """Return the session of readings in memory.

    Parameters
    ----------
    **arrays
        Readings and statements about them, see `SensorArrays`.

    Raises
    ------
    InputError
        For another shape or unit, and for numbers that are not finite.

    Examples
    --------
    >>> import numpy as np
    >>> still = np.tile([0.0, 0.0, 9.81], (300, 1))
    >>> session_of_arrays(accel=still, rate=100.0, serial="A-0007").log.columns
    ('accel_x', 'accel_y', 'accel_z')
    """
    arguments = list(SensorArrays.__annotations__)
    if unexpected := [name for name in arrays if name not in arguments]:
        raise TypeError(f"unexpected argument {unexpected[0]!r}; expected one of {', '.join(arguments)}")
    given: dict[str, Any] = {name: value for name, value in arrays.items() if value is not None}
    if ("time" in given) == ("rate" in given):
        raise InputError(
            f"time, rate: expected one of them, the times of the samples, s, or their rate, Hz, found "
            f"{'both' if 'time' in given else 'none'}"
        )
    if "accel" not in given:
        raise InputError("accel: expected readings of accelerometers (samples, sensors), m/s^2, found none")
    log: dict[str, Any] = {"rate_hz": _number("rate", given["rate"])} if "rate" in given else {"time": "time"}
    data: dict[str, Array] = {}
    sensors: dict[str, int] = {}
    for kind in SI:
        if kind in given:
            readings = readings_of(kind, given[kind])
            sensors[kind] = readings.shape[1]
            if sensors[kind] > 3 and f"{kind}_axes" not in given:
                given_columns = f"{sensors[kind]}; choose three without times, or give {kind}_axes= as well"
                raise InputError(f"{kind}: expected three columns, found {given_columns}")
            columns = _columns(kind, sensors[kind])
            axes = {"axes": array_of("axes", given[f"{kind}_axes"]).tolist()} if f"{kind}_axes" in given else {}
            log[kind] = {"columns": columns, "unit": SI[kind][0], **axes}
            data |= dict(zip(columns, readings.T, strict=True))
    force = np.column_stack([data[column] for column in log["accel"]["columns"]])
    length = float(np.median(np.linalg.norm(force, axis=1)) * np.sqrt(3.0 / sensors["accel"]))
    if not _GRAVITY_LIMITS[0] <= length <= _GRAVITY_LIMITS[1]:
        raise InputError(
            f"accel: expected m/s^2, about 9.8 at rest, found {length:.4g} at the median; multiply readings in g by "
            "9.80665, divide increments by their intervals"
        )
    if "time" in given:
        data["time"] = _series("time", given["time"])
    if "temperature" in given:
        temperatures = _temperatures(given["temperature"], sensors)
        log["temperature"] = {"columns": [column for column, _ in temperatures], "unit": "degC"}
        data |= dict(temperatures)
    first, *others = data
    for name in others:
        if len(data[name]) != len(data[first]):
            raise InputError(
                f"{name}: expected {len(data[first])} samples, as many as {first} has, found {len(data[name])}"
            )
    if "clock_ppm_u" in given:
        log["clock_ppm_u"] = _number("clock_ppm_u", given["clock_ppm_u"])
    keys = {"height": "height_m", "gravity": "gravity", "gravity_u": "gravity_u"}
    site = {key: _number(name, given[name]) for name, key in keys.items() if name in given}
    if "latitude" in given:
        latitude = _number("latitude", given["latitude"])
        if not abs(latitude) <= np.pi / 2:
            raise InputError(f"latitude: expected radians from -π/2 to π/2, found {latitude:g}; use np.radians(…)")
        site["latitude_deg"] = latitude / DEGREE
    device = {"serial": arrays.get("serial", "unknown")}
    description: dict[str, Any] = {"format": 1, "device": device, "site": site, "log": log}
    if (programme := given.get("programme")) is not None:
        listed = {"position": [{"attitude": code} for code in programme]}
        description["programme"] = {"name": programme} if isinstance(programme, str) else listed
    return session_of(description, data)


def readings_of(kind: str, given: npt.ArrayLike) -> Array:
    """Return readings (N, n) in SI from an array or a frame. Raises InputError for other shapes and as `numbers_of`."""
    readings = numbers_of(kind, given)
    if readings.ndim != 2 or not len(readings) or readings.shape[1] < 3 or readings.shape[1] > max(len(readings), 3):
        turned = "; transpose it" if readings.ndim == 2 and 3 <= readings.shape[0] < readings.shape[1] else ""
        raise InputError(
            f"{kind}: expected an array of shape (samples, sensors) with three sensors or more, found the shape "
            f"{readings.shape}{turned}"
        )
    return readings


def numbers_of(what: str, given: npt.ArrayLike | None, *, increments: bool = False) -> Array:
    """Return an array of finite numbers in SI from an array or a frame; `what` is "accel" or "gyro" for readings.

    Raises InputError for anything else, and for columns of a frame with another unit in their names."""
    numbers = array_of(what, given)
    if not np.isfinite(numbers).all():
        at = tuple(int(i) for i in np.argwhere(~np.isfinite(numbers))[0])
        where = f"sample {at[0]}" + (f" of sensor {at[1]}" if len(at) > 1 else "")
        raise InputError(
            f"{what}: expected finite numbers, found {numbers[at]} in {where} (from 0); cut or fill such samples"
        )
    for column in map(str, getattr(given, "columns", ()) if what in SI else ()):
        from tumble.recording.columns.names import unit_of_name

        si, unit = SI[what][increments], unit_of_name(what, column)
        if unit not in (None, si):
            found = _UNITS[what][unit]
            advice = f"multiply it by {found.factor:.9g}" if found.kind == "rate" else "convert it"
            raise InputError(f"{what}: expected {si}, found a column {column!r} in {unit}; {advice}")
    return numbers


def _series(what: str, given: npt.ArrayLike) -> Array:
    values = np.squeeze(numbers_of(what, given))
    if values.ndim != 1:
        raise InputError(f"{what}: expected an array of shape (samples,), found the shape {values.shape}")
    return values


def _number(what: str, value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float | np.number):
        raise InputError(f"{what}: expected a number, found {value!r}")
    return float(value)


def _columns(kind: str, sensors: int) -> list[str]:
    return [f"{kind}_{'xyz'[i] if sensors == 3 else i}" for i in range(sensors)]


def _temperatures(given: Temperatures, sensors: Mapping[str, int]) -> list[tuple[str, Array]]:
    """Return the columns of the thermometers, one for all sensors or one per sensor, with temperatures in °C."""
    if not isinstance(given, Mapping):
        return [("temperature", celsius_of(_series("temperature", given)))]
    check_kinds(given, sensors)
    out: list[tuple[str, Array]] = []
    for kind, count in sensors.items():
        values = numbers_of(f"temperature of {kind}", given[kind])
        if values.ndim not in (1, 2) or values.shape[1:] not in ((), (count,)):
            raise InputError(
                f"temperature of {kind}: expected the shape (samples,) or (samples, {count}), found {values.shape}"
            )
        names = _columns(f"temperature_{kind}", count) if values.ndim == 2 else count * [f"temperature_{kind}"]
        columns = celsius_of(values).reshape(len(values), -1).T
        out += zip(names, columns if values.ndim == 2 else count * [columns[0]], strict=True)
    return out


def check_kinds(given: Mapping[str, npt.ArrayLike], kinds: Iterable[str]) -> None:
    """Raise InputError unless temperatures are given for exactly these kinds of sensors."""
    if set(given) != set(kinds):
        raise InputError(
            f"temperature: expected those of {' and '.join(kinds)}, found {', '.join(map(str, given)) or 'none'}"
        )


def check_kelvin(kelvin: Array) -> None:
    """Raise InputError for temperatures that look like degrees Celsius."""
    if kelvin.size and kelvin.min() < _COLDEST:
        raise InputError(f"temperature: expected kelvin, found {kelvin.min():.4g}; add 273.15 to degrees Celsius")


def celsius_of(kelvin: Array) -> Array:
    """Convert temperatures from K to °C. Raises InputError if they look like degrees Celsius."""
    check_kelvin(kelvin)
    return kelvin - ZERO_CELSIUS
