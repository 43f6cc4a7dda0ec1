"""A calibration file of tumble as what corrects the samples of an IMU, one by one, in plain Python.

    readings of the three accelerometers      y = S f + b + K₂ own² + a |own| + K₃ own³        own = axis · f
    of the three gyros                        ω̂ = G ω + d + D f + a |own| + K₃ own³            own = axis · ω

These are undone in six steps x ← S⁻¹ (y − b − what is not linear in x), as many as `tumble apply` makes, whose numbers
these are to rounding. Over temperature b and the rows of S change with T − T₀; the sensors follow the thermometer with
a lag. Where accelerometers have lever arms r from the last one, with the rate ω and its change ω̇

    S f_p = S (f + ω̇ × r + ω × (ω × r))

is taken off each. ω̇ is a central difference, so that a sample is corrected when the next one is there: `delay` is 1.
Drifts within the session and hysteresis belong to the recording, and delays are not undone.
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any, NamedTuple

STEPS = 6
"""A linear one, and five more: each leaves a part of 1e-3 to 1e-2 of what is not linear."""
LONGEST_STEP = 3.5
"""Of usual intervals: neighbours further apart say nothing of the angular acceleration."""

Vector = tuple[float, float, float]
KNOWN = {
    *("accel.bias", "accel.scale", "accel.axis", "gyro.bias", "gyro.scale", "gyro.axis"),
    *("accel.quadratic", "accel.cubic", "accel.asymmetry", "gyro.cubic", "gyro.asymmetry", "gyro.g_sensitivity"),
    *("accel.lever", "accel.delay", "temperature.lag", "mag.bias", "mag.scale", "mag.axis"),
}
"""Groups that are corrected, or known to be none of a sample."""


class CalibrationError(ValueError):
    """A file that is no calibration, or none that corrects the three axes of an Imu message."""


class Sample(NamedTuple):
    """Time, s, specific force, m/s², angular rate, rad/s, and what the thermometer reads, °C, if known."""

    time: float
    force: Vector
    rate: Vector
    celsius: float | None = None


class Correction:
    """What corrects samples in the order of their times. `delay` is how many samples later a corrected one comes."""

    def __init__(self, content: dict[str, Any], sample_rate: float | None = None) -> None:
        """The content of a calibration file, and the samples a second, of the recording unless given."""
        if content.get("format") != 1 or not isinstance(content.get("parameters"), list):
            raise CalibrationError("expected a calibration file of tumble, format 1, found something else")
        outcome = content["outcome"]
        if not outcome["accepted"]:
            raise CalibrationError(f"expected an accepted calibration, found: {'; '.join(outcome['reasons'])}")
        if any(content[kind] is None or len(content[kind]["bias"]) != 3 for kind in ("accel", "gyro")):
            raise CalibrationError("expected three accelerometers and three gyros, found others")
        self.serial = str(content["device"]["serial"])
        self.frame = str(content["frame"])
        values = {p["name"]: p["value"] for p in content["parameters"]}
        unknown = sorted(n for n in values if ".".join(n.split(".")[:2]) not in KNOWN)
        if unknown:
            raise CalibrationError(f"expected the parameters of this version, found {', '.join(unknown)}")
        self.accel = _Triad("accel", content, values)
        self.gyro = _Triad("gyro", content, values)
        self.levers = [tuple(values.get(f"accel.lever.{s}.{c}", 0.0) for c in "xyz") for s in "xyz"]
        self.lag = content["temperature"].get("lag") or 0.0
        if self.lag < 0.0:
            raise CalibrationError(f"temperature.lag: expected none or a positive one, found {self.lag:g} s")
        self.interval = 1.0 / (sample_rate or content["sample_rate"])
        ranges = content["temperature"]["range"]
        self.temperature_range = None if ranges is None else tuple(ranges)
        self.warm = self.accel.warm or self.gyro.warm
        self.delay = int(any(any(r) for r in self.levers))
        self.covariance = _covariances(content)
        self.reset()

    def reset(self) -> None:
        """Forget all samples."""
        self._behind: float | None = None
        self._thermometer: float | None = None
        self._time = 0.0
        self._rows: list[tuple[Sample, float | None, Vector]] = []

    def add(self, sample: Sample) -> Sample | None:
        """The next sample that is correct, or None while the delay lasts. Times must grow."""
        celsius = self._of_sensors(sample.celsius, sample.time)
        if not self.delay:
            return self._corrected(sample, celsius, sample.force)
        rate = self.gyro.solved(sample.rate, self.accel.solved(sample.force, None, celsius), celsius)
        self._rows.append((sample, celsius, rate))
        if len(self._rows) == 1:
            return None
        corrected = self._moved(self._rows[-2], self._rows[0], self._rows[-1])
        del self._rows[:-2]
        return corrected

    def finish(self) -> Sample | None:
        """The last sample, where one is left."""
        return self._moved(self._rows[-1], self._rows[0], self._rows[-1]) if self._rows else None

    def _moved(self, row: Any, before: Any, after: Any) -> Sample:
        """A sample with its accelerometers at one point, by the rates of its neighbours."""
        sample, celsius, rate = row
        step = after[0].time - before[0].time
        if not 0.0 < step <= LONGEST_STEP * self.interval:
            return self._corrected(sample, celsius, sample.force)
        change = [(a - b) / step for a, b in zip(after[2], before[2])]  # noqa: B905  # strict came after Python 3.9
        readings = list(sample.force)
        for p, r in enumerate(self.levers):
            added = _plus(_cross(change, r), _cross(rate, _cross(rate, r)))
            there = readings[p] - _dot(self.accel.matrix[p], added)
            readings[p] = there if math.isfinite(there) else readings[p]
        return self._corrected(sample, celsius, tuple(readings))

    def _corrected(self, sample: Sample, celsius: float | None, readings: Any) -> Sample:
        force = self.accel.solved(readings, None, celsius)
        return Sample(sample.time, force, self.gyro.solved(sample.rate, force, celsius), sample.celsius)

    def _of_sensors(self, thermometer: float | None, time: float) -> float | None:
        """The temperature of the sensors, which follow the thermometer by the times of the samples, exact where it is
        straight between them."""
        passed, self._time = time - self._time, time
        if not self.warm:
            return None
        if thermometer is None or not math.isfinite(thermometer):
            thermometer = self._thermometer
        if thermometer is None:
            return None
        if self.lag == 0.0 or self._behind is None or self._thermometer is None:
            behind = thermometer
        else:
            h, lag = passed if passed > 0.0 else self.interval, self.lag
            a = math.exp(-h / lag)
            rise = thermometer - self._thermometer
            behind = a * self._behind + thermometer - a * self._thermometer - rise / h * lag * (1.0 - a)
        self._thermometer, self._behind = thermometer, behind
        return behind

    def outside(self, sample: Sample) -> str:
        """Why a sample is outside of what was calibrated, in words; empty where it is not."""
        limits = self.temperature_range
        if sample.celsius is not None and limits is not None and not limits[0] <= sample.celsius <= limits[1]:
            return f"{sample.celsius:.1f} °C, calibrated from {limits[0]:.1f} to {limits[1]:.1f} °C"
        return ""


class _Triad:
    """Three sensors of a kind: their matrix and its inverse, bias, what is not linear, and changes over temperature."""

    def __init__(self, kind: str, content: dict[str, Any], values: dict[str, float]) -> None:
        of, names = content[kind], "xyz"
        self.of_force = kind == "accel"
        self.matrix: list[list[float]] = of["matrix"]
        self.bias: list[float] = of["bias"]
        self.inverse = _inverse(self.matrix)
        self.axes: list[list[float]] = content["axes"][kind]
        self.square = [values.get(f"{kind}.quadratic.{s}", 0.0) for s in names]
        self.cube = [values.get(f"{kind}.cubic.{s}", 0.0) for s in names]
        self.size = [values.get(f"{kind}.asymmetry.{s}", 0.0) for s in names]
        by_force = [[values.get(f"{kind}.g_sensitivity.{s}{c}", 0.0) for c in names] for s in names]
        self.by_force = by_force if any(map(any, by_force)) else None
        self.linear = not any((*self.square, *self.cube, *self.size))
        changes = [
            [(values.get(f"{kind}.{what}.{s}.t1", 0.0), values.get(f"{kind}.{what}.{s}.t2", 0.0)) for s in names]
            for what in ("bias", "scale")
        ]
        self.warm = any(any(change) for by in changes for change in by)
        self.bias_changes, self.scale_changes = changes
        self.norm = [math.sqrt(_dot(row, row)) for row in self.matrix]
        temperature = content["temperature"]
        references = temperature.get("references") or {}
        reference = references.get(kind) or [temperature["reference"]] * 3
        self.reference = list(reference)

    def solved(self, readings: Any, force: Vector | None, celsius: float | None) -> Vector:
        """What three readings are of: the specific force, or in a specific force the rate."""
        known, gain = [], []
        for p in range(3):
            value, factor = readings[p] - self.bias[p], 1.0
            if self.warm and celsius is not None and self.reference[p] is not None:
                d = celsius - self.reference[p]
                (b1, b2), (s1, s2) = self.bias_changes[p], self.scale_changes[p]
                value, factor = value - d * (b1 + d * b2), 1.0 + d * (s1 + d * s2) / self.norm[p]
            if self.by_force is not None and force is not None:
                value -= _dot(self.by_force[p], force)
            known.append(value)
            gain.append(factor)
        x: Vector = (0.0, 0.0, 0.0)
        for _ in range(1 if self.linear else STEPS):
            left = []
            for p in range(3):
                own = _dot(self.axes[p], x)
                beyond = own * (own * (self.square[p] + own * self.cube[p])) + abs(own) * self.size[p]
                left.append((known[p] - beyond) / gain[p])
            x = (_dot(self.inverse[0], left), _dot(self.inverse[1], left), _dot(self.inverse[2], left))
        return x


def read(file: str | Path, sample_rate: float | None = None) -> Correction:
    """The correction of a calibration file. Raises CalibrationError, in one line."""
    try:
        return Correction(json.loads(Path(file).read_text(encoding="utf-8")), sample_rate)
    except (OSError, KeyError, TypeError, ValueError) as error:
        words = str(error) if isinstance(error, (OSError, ValueError)) else f"{type(error).__name__}: {error}"
        raise CalibrationError(f"{file}: {words}") from error


def _covariances(content: dict[str, Any]) -> dict[str, list[float]]:
    """Row-major covariances (9) that the calibration adds to a sample: of the specific force at 1 g, of the rate at the
    rate of the turns it was made with, both the mean over attitudes."""
    u = {"accel": content["prediction"]["force_u"], "gyro": content["prediction"]["rate_u"]}
    return {kind: [u[kind] ** 2 if i % 4 == 0 else 0.0 for i in range(9)] for kind in u}


def _dot(a: Any, b: Any) -> float:
    return float(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


def _plus(a: Vector, b: Vector) -> Vector:
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


def _cross(a: Any, b: Any) -> Vector:
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def _inverse(m: Any) -> list[list[float]]:
    """Of a matrix (3, 3), by its cofactors."""
    rows = [_cross(m[1], m[2]), _cross(m[2], m[0]), _cross(m[0], m[1])]
    determinant = _dot(m[0], rows[0])
    return [[rows[j][i] / determinant for j in range(3)] for i in range(3)]
