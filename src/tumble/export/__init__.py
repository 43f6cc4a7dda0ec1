"""Exports: a calibration as other programs read it.

`export_calibration` makes the bytes; nothing is written. What a target cannot hold comes with them in sentences.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from tumble.errors import InputError

if TYPE_CHECKING:
    from tumble.export.exported import Exported
    from tumble.export.robots import NoiseDensities
    from tumble.files import FilePath
    from tumble.lab.certificate import Certificate
    from tumble.recording.session import Session
    from tumble.result.calibration import Calibration


@dataclass(frozen=True, kw_only=True, slots=True)
class Target:
    """A format: the module and the function that make it, what that takes beside the calibration, the ending of a file
    of it, and whether that is text."""

    module: str
    function: str
    takes: tuple[str, ...] = ()
    ending: str = ".txt"
    text: bool = True


FORMATS: Mapping[str, Target] = {
    "kalibr": Target(module="robots", function="kalibr", takes=("noise",)),
    "ros-imu-calib": Target(module="robots", function="ros_imu_calib"),
    "fusion": Target(module="robots", function="fusion", ending=".h"),
    "autoware": Target(module="robots", function="autoware", ending=".yaml"),
    "px4": Target(module="autopilots", function="px4", takes=("imu",), ending=".params"),
    "px4-thermal": Target(module="autopilots", function="px4_thermal", takes=("imu", "sensor-ids"), ending=".params"),
    "ardupilot": Target(module="autopilots", function="ardupilot", takes=("imu",), ending=".parm"),
    "ardupilot-thermal": Target(module="autopilots", function="ardupilot_thermal", takes=("imu",), ending=".parm"),
    "inav": Target(module="counts", function="inav", takes=("counts",)),
    "betaflight": Target(module="counts", function="betaflight", takes=("counts",)),
    "slimevr": Target(module="counts", function="slimevr", takes=("counts",), ending=".h"),
    "m5unified": Target(module="counts", function="m5unified", takes=("counts",), ending=".h"),
    "iio": Target(module="counts", function="iio", takes=("counts",), ending=".sh"),
    "realsense": Target(module="json_files", function="realsense", ending=".json"),
    "imucal": Target(module="json_files", function="imucal"),
    "depthai": Target(module="json_files", function="depthai"),
    "matlab-imu": Target(module="json_files", function="matlab_imu"),
    "c": Target(module="c_header", function="c_header", ending=".h"),
    "firmware": Target(module="firmware", function="firmware", takes=("full-scale",), ending=".zip", text=False),
    "mat": Target(module="tables", function="mat", ending=".mat", text=False),
    "csv": Target(module="tables", function="csv_table", ending=".csv"),
    "csv-thermal": Target(module="tables", function="csv_thermal", ending=".csv"),
    "dcc": Target(module="dcc", function="dcc", takes=("certificate",), ending=".xml"),
}
"""Every format by its name; the only list of them."""

FROM_THE_CALIBRATION_ALONE = tuple(name for name, target in FORMATS.items() if "certificate" not in target.takes)
"""Formats that can do without anything beside the calibration."""


def export_calibration(
    calibration: Calibration | FilePath,
    to: str,
    *,
    noise: NoiseDensities | Session | FilePath | None = None,
    certificate: Certificate | FilePath | None = None,
    imu: int | None = None,
    sensor_ids: tuple[int, int] | None = None,
    full_scale: tuple[float, float] | None = None,
    counts: tuple[float, float] | None = None,
) -> Exported:
    """A calibration, or that of a file, in one of the `FORMATS`. `kalibr` takes the noise densities of the device or a
    session whose longest rest shows them, else those of the calibration's rests; `dcc` needs the administrative data of
    a certificate or their file; the formats of PX4 and ArduPilot take the number of the IMU whose parameters are to be
    written, from 1, where the recording does not say it; `px4-thermal` the device ids of accelerometer and gyro,
    likewise; `firmware` the range of readings in fixed point, g and °/s; formats in counts how many a g and a °/s are,
    where the recording was not in counts.

    Where the accelerometers or the gyros alone are accepted, they are written, and the others named as absent. Raises
    InputError for a calibration that was not accepted or that the format has no place for.

    >>> import tumble
    >>> folder = tumble.simulate_session("session", tumble.Setup.of(grade="mems", positions=12), seed=1)
    >>> exported = tumble.export_calibration(tumble.calibrate(folder), "csv")
    >>> exported.content.splitlines()[0].split(b",")[0]
    b'# device mems-1'
    """
    from tumble.export.exported import NO_MAGNETOMETER
    from tumble.lab.certificate import Certificate, read_certificate
    from tumble.result.accepted import accepted_part
    from tumble.result.calibration import calibration_from

    calibration = accepted_part(calibration_from(calibration))
    if to not in FORMATS:
        raise InputError(f"export: expected one of {', '.join(FORMATS)}, found {to!r}")
    if to == "dcc" and certificate is None:
        raise InputError("export: expected --certificate with dcc and only there, found none")
    if noise is not None:
        from tumble.export.robots import NoiseDensities, noise_densities
        from tumble.recording.session_file import session_from

        noise = noise if isinstance(noise, NoiseDensities) else noise_densities(session_from(noise))
    if certificate is not None and not isinstance(certificate, Certificate):
        certificate = read_certificate(Path(certificate))
    given = {"noise": noise, "certificate": certificate, "imu": imu, "sensor-ids": sensor_ids, "full-scale": full_scale}
    given["counts"] = counts
    target = FORMATS[to]
    for what, value in given.items():
        if value is not None and what not in target.takes:
            every = [name for name, other in FORMATS.items() if what in other.takes]
            takers = [name for name in every if name.removesuffix("-thermal") not in {*every} - {name}]
            raise InputError(f"export: expected --{what} with {' or '.join(takers)} and only there, found it with {to}")
    function: Callable[..., Exported] = getattr(import_module(f"tumble.export.{target.module}"), target.function)
    exported = function(calibration, *(given[what] for what in target.takes))
    without = () if calibration.mag is None or exported.magnetometer else (NO_MAGNETOMETER,)
    return replace(exported, losses=(*calibration.absent, *exported.losses, *without))
