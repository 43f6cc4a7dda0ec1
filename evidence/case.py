"""What the benchmark hands to a program, and what it takes back: cases, estimates, refusals, programs.

Nothing of tumble is imported here. Units are SI and radians; temperatures are in °C. The model of every estimate is

    reading = matrix @ true + bias        true: specific force, m/s², or angular rate, rad/s, in the body

with any 3×3 matrix. Programs choose the frame of the body differently (upper or lower triangular, symmetric, that of
the case): `parameters_of` turns all of them into the frame that the accelerometers fix, X along the X accelerometer, Z
normal to the plane of X and Y, and gives the names and angles in which the truth of a case is stated:

    matrix = diag(1 + k) A(γ)      row p of A is a unit vector that leans by γ_pq towards the body axis q

            ⎡ cos γxy cos γxz   sin γxy           cos γxy sin γxz ⎤
    A(γ) =  ⎢ cos γyz sin γyx   cos γyz cos γyx   sin γyz         ⎥
            ⎣ sin γzx           cos γzx sin γzy   cos γzx cos γzy ⎦
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.floating]
Kind = Literal["accel", "gyro"]
Need = Literal["accel", "gyro", "latitude", "faces", "turns of 360°", "long rest", "magnetometer", "temperatures"]
"""What a program asks of a case: sensors; the latitude; rests with each axis up and down; sections that are full turns
about each axis; a rest at the beginning for the gyros' biases; a range of temperatures that the device passed at
rest."""

ACCEL_NAMES = (*(f"accel.{what}.{axis}" for what in ("bias", "scale") for axis in "xyz"),
               *(f"accel.axis.{pair}" for pair in ("yx", "zx", "zy")))  # fmt: skip
GYRO_NAMES = (*(f"gyro.{what}.{axis}" for what in ("bias", "scale") for axis in "xyz"),
              *(f"gyro.axis.{pair}" for pair in ("xy", "xz", "yx", "yz", "zx", "zy")))  # fmt: skip
NAMES = (*ACCEL_NAMES, *GYRO_NAMES)
"""The 21 in which truths are stated, and every estimate is compared with them."""
MAG_NAMES = tuple(name.replace("gyro", "mag") for name in GYRO_NAMES)
CHANGES = tuple(f"{kind}.{what}.{axis}.{end}" for what in ("change", "thermal") for kind in ("accel", "gyro")
                for axis in "xyz" for end in ("low", "high"))  # fmt: skip
"""Changes of the readings at rest, and of the biases alone, from the middle of a range of temperatures to its ends."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Reference:
    """What somebody else found of the same device, by name of the parameter, and the standard uncertainty of each."""

    values: Mapping[str, float]
    u: Mapping[str, float]
    origin: str


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Case:
    """A recording, and all that a program may know of it. Readings are what the data sheet makes of the raw ones: in
    m/s² and rad/s by nominal factors, uncalibrated."""

    name: str
    kind: str
    """Cases of one kind are tabulated together."""
    time: Array
    """End of each sample's interval (N,), s; a stamp that is later than the rate lets expect is a gap."""
    accel: Array
    """(N, 3), m/s²; (N, 0) of gyros alone."""
    gyro: Array | None
    """(N, 3), rad/s."""
    temperature: Array | None = None
    """(N,), °C."""
    ends: tuple[float, float, float] | None = None
    """°C: the temperatures between which changes are to be told, and the middle, of a device that lies still."""
    mag: Array | None = None
    """(N, 3), µT."""
    mag_field: float | None = None
    """Its modulus, µT."""
    gravity: float
    """m/s², at the place."""
    gravity_u: float
    """Its standard uncertainty."""
    latitude: float | None = None
    """rad."""
    programme: str | None = None
    """The programme of nominal attitudes in which it was recorded, by tumble's name for it."""
    sections: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """What the operator noted, begin and end in s: `x+`, `x-`, … are rests with that axis up and down, `x turn`, … full
    turns about it."""
    turn_angle: float | None = None
    """rad, the angle of the noted turns, positive by the right-hand rule."""
    clock_ppm_u: float | None = None
    """Standard uncertainty of the time base, parts per million; None where nobody stated it."""
    truth: Mapping[str, float] | None = None
    """Of a simulated case, by parameter."""
    reference: Reference | None = None
    table: bool = False
    """Every row is the mean reading of a rest of its own, in no order of time."""
    device: str = ""
    """Cases of the same device are compared with one another."""
    licence: str = ""
    source: str = ""

    @property
    def rate(self) -> float:
        """Samples a second, from the median interval."""
        return float(1.0 / np.median(np.diff(self.time)))

    def between(self, start: float, stop: float) -> Case:
        """The part of a case from start (excluded) to stop, s."""
        return self.where((self.time > start) & (self.time <= stop))

    def where(self, kept: npt.NDArray[np.bool_]) -> Case:
        """The samples that are kept (N,)."""
        return replace(
            self,
            time=self.time[kept],
            accel=self.accel[kept],
            gyro=None if self.gyro is None else self.gyro[kept],
            temperature=None if self.temperature is None else self.temperature[kept],
            mag=None if self.mag is None else self.mag[kept],
        )


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Estimate:
    """What a program found. Matrices are 3×3, in the program's own frame of the body, the same for both; None is what
    it did not estimate."""

    accel: Array | None = None
    accel_bias: Array | None = None
    gyro: Array | None = None
    gyro_bias: Array | None = None
    mag: Array | None = None
    mag_bias: Array | None = None
    changes: Mapping[str, float] = field(default_factory=dict)
    """Those of CHANGES that it tells."""
    u: Mapping[str, float] | None = None
    """Standard uncertainties in the frame of `parameters_of`; None where the program states none."""
    expanded: Mapping[str, float] | None = None
    """Half widths of the intervals it states for 95 %."""
    whole_model: Callable[[Array, Array | None], tuple[Array, Array | None]] | None = None
    """Corrects readings (N, 3) of accelerometers and gyros, where the program knows more than matrices and biases."""
    accepted: bool = True
    """False where the program gives numbers and says that some of them are not to be used."""
    refused: frozenset[Kind] = frozenset()
    """Those of which it says so."""
    verdict: str = ""

    def gives(self, kind: Kind) -> bool:
        """Whether the program has numbers for these sensors and stands by them."""
        matrix = self.accel if kind == "accel" else self.gyro
        return matrix is not None and bool(np.isfinite(matrix).all()) and (self.accepted or kind not in self.refused)

    def corrected(self, accel: Array, gyro: Array | None) -> tuple[Array, Array | None]:
        """Specific force and rates (N, 3) of readings by all that the program knows; needs accelerometers."""
        if self.whole_model is not None:
            return self.whole_model(accel, gyro)
        assert self.accel is not None
        assert self.accel_bias is not None
        force = np.linalg.solve(self.accel, (accel - self.accel_bias).T).T
        if gyro is None or self.gyro is None or self.gyro_bias is None:
            return force, None
        return force, np.linalg.solve(self.gyro, (gyro - self.gyro_bias).T).T


@dataclass(frozen=True, kw_only=True, slots=True)
class Refusal:
    """No numbers, and why."""

    reason: str


class GaveUpError(Exception):
    """Raised inside an adapter; its program returns a `Refusal` with the message."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Program:
    """A calibration program: its name, what it needs of a case, its source, and how it is called."""

    name: str
    needs: frozenset[Need]
    estimate: Callable[[Case], Estimate]
    """Raises GaveUpError where the program would give up."""
    source: str
    ours: bool = False
    """A method of tumble."""

    def lacks(self, case: Case) -> str:
        """What it needs and the case has not; empty where it can run."""
        has = {
            "accel": case.accel.shape[1] > 0,
            "gyro": case.gyro is not None,
            "magnetometer": case.mag is not None,
            "temperatures": case.ends is not None,
            "latitude": case.latitude is not None,
            "faces": all(f"{axis}{sign}" in case.sections for axis in "xyz" for sign in "+-"),
            "turns of 360°": all(f"{axis} turn" in case.sections for axis in "xyz"),
        }
        return ", ".join(sorted(need for need in self.needs if not has.get(need, True)))

    def calibrate(self, case: Case) -> Estimate | Refusal:
        """The estimate, or why there is none."""
        lacking = self.lacks(case)
        if lacking:
            return Refusal(reason=f"needs {lacking}")
        try:
            return self.estimate(case)
        except (GaveUpError, np.linalg.LinAlgError) as error:
            return Refusal(reason=str(error))


# -------------------- from any frame to the names of the truth --------------------


def lower_triangular(matrix: Array) -> tuple[Array, Array]:
    """L with a positive diagonal and the rotation Q of matrix = L Q: Q takes the program's body to the frame that the
    accelerometers fix."""
    q, r = np.linalg.qr(matrix.T)
    sign = np.where(np.diag(r) < 0.0, -1.0, 1.0)
    return r.T * sign, (q * sign).T


def angles_of(matrix: Array) -> tuple[Array, dict[str, float]]:
    """k (3,) and γ by pair of axes, of matrix = diag(1 + k) A(γ)."""
    length = np.linalg.norm(matrix, axis=1)
    x, y, z = matrix / length[:, None]
    angles = {
        "xy": np.arcsin(x[1]), "xz": np.arctan2(x[2], x[0]),
        "yx": np.arctan2(y[0], y[1]), "yz": np.arcsin(y[2]),
        "zx": np.arcsin(z[0]), "zy": np.arctan2(z[1], z[2]),
    }  # fmt: skip
    return length - 1.0, {pair: float(angle) for pair, angle in angles.items()}


def matrix_of(parameters: Mapping[str, float], kind: Kind) -> Array:
    """diag(1 + k) A(γ) of named parameters; those that are not there are nothing."""
    cos, sin = ({p: f(parameters.get(f"{kind}.axis.{p}", 0.0)) for p in ("xy", "xz", "yx", "yz", "zx", "zy")}
                for f in (np.cos, np.sin))  # fmt: skip
    axes = np.array([
        [cos["xy"] * cos["xz"], sin["xy"], cos["xy"] * sin["xz"]],
        [cos["yz"] * sin["yx"], cos["yz"] * cos["yx"], sin["yz"]],
        [sin["zx"], cos["zx"] * sin["zy"], cos["zx"] * cos["zy"]],
    ])  # fmt: skip
    scale = np.array([1.0 + parameters.get(f"{kind}.scale.{axis}", 0.0) for axis in "xyz"])
    return np.asarray(scale[:, None] * axes, dtype=float)


def parameters_of(found: Estimate) -> dict[str, float]:
    """An estimate under the names of the truth: nine of accelerometers, twelve of gyros and of a magnetometer, and
    changes, whichever are there. Without accelerometers the others stay in the program's own frame."""
    values: dict[str, float] = {}
    turned: Array = np.eye(3)
    for kind, matrix, bias in (
        ("accel", found.accel, found.accel_bias),
        ("gyro", found.gyro, found.gyro_bias),
        ("mag", found.mag, found.mag_bias),
    ):
        if kind == "accel" and matrix is not None:
            matrix, turned = lower_triangular(matrix)
        elif matrix is not None:
            matrix = matrix @ turned.T
        if bias is not None:
            values |= {f"{kind}.bias.{axis}": float(b) for axis, b in zip("xyz", bias, strict=True)}
        if matrix is not None:
            scale, angles = angles_of(matrix)
            values |= {f"{kind}.scale.{axis}": float(k) for axis, k in zip("xyz", scale, strict=True)}
            values |= {f"{kind}.axis.{pair}": angle for pair, angle in angles.items()}
    return {name: values[name] for name in (*NAMES, *MAG_NAMES) if name in values} | dict(found.changes)
