"""Exports: a calibration as other programs read it, a file for each format.

`export_calibration` makes the bytes; nothing is written. What a target cannot hold comes with them in sentences.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from tumble.errors import InputError
from tumble.export.exported import NO_MAGNETOMETER

if TYPE_CHECKING:
    from tumble.acceptance.certificate import Certificate
    from tumble.calibration.calibration_file import Calibration
    from tumble.export.exported import Exported
    from tumble.export.kalibr import NoiseDensities
    from tumble.files import FilePath
    from tumble.recording.session import Session

_PLAIN = {
    "ros-imu-calib": "ros_imu_calib",
    "px4": "px4",
    "ardupilot": "ardupilot",
    "ardupilot-thermal": "ardupilot_thermal",
    "imucal": "imucal",
    "depthai": "depthai",
    "matlab-imu": "matlab_imu",
    "c": "c_header",
    "mat": "mat",
    "csv": "csv_table",
    "csv-thermal": "csv_thermal",
}
"""Formats that need nothing but the calibration: module, and function of the same name."""

FORMATS = ("kalibr", *_PLAIN, "px4-thermal", "dcc")

AUTOPILOTS = ("px4", "ardupilot")
"""Formats with parameters of several IMUs, as they are and over temperature."""


def export_calibration(
    calibration: Calibration | FilePath,
    to: str,
    *,
    noise: NoiseDensities | Session | FilePath | None = None,
    certificate: Certificate | FilePath | None = None,
    imu: int | None = None,
    sensor_ids: tuple[int, int] | None = None,
) -> Exported:
    """A calibration, or that of a file, in one of the `FORMATS`. `kalibr` takes the noise densities of the device or a
    session whose longest rest shows them, else those of the calibration's rests; `dcc` needs the administrative data of
    a certificate or their file; the formats of PX4 and ArduPilot take the number of the IMU whose parameters are to be
    written, from 1, where the recording does not say it; `px4-thermal` the device ids of accelerometer and gyro,
    likewise.

    Where the accelerometers or the gyros alone are accepted, they are written, and the others named as absent. Raises
    InputError for a calibration that was not accepted or that the format has no place for.

    >>> import tumble
    >>> folder = tumble.simulate_session("session", tumble.Setup.of(grade="mems", positions=12), seed=1)
    >>> exported = tumble.export_calibration(tumble.calibrate(folder), "csv")
    >>> exported.content.splitlines()[0].split(b",")[0]
    b'# device mems-1'
    """
    from tumble.calibration.calibration_file import calibration_from
    from tumble.calibration.half import accepted_part

    calibration = accepted_part(calibration_from(calibration))
    exported = _export(calibration, to, _noise(noise), _certificate(certificate), imu, sensor_ids)
    without = () if calibration.mag is None else (NO_MAGNETOMETER,)
    return replace(exported, losses=(*calibration.absent, *exported.losses, *without))


def _export(
    calibration: Calibration,
    to: str,
    noise: NoiseDensities | None,
    certificate: Certificate | None,
    imu: int | None,
    sensor_ids: tuple[int, int] | None,
) -> Exported:
    _check_wanted(to, noise, certificate, imu)
    if sensor_ids is not None and to != "px4-thermal":
        raise InputError(f"export: expected --sensor-ids with px4-thermal only, found it with {to}")
    if to == "px4-thermal":
        from tumble.export.px4_thermal import px4_thermal

        return px4_thermal(calibration, sensor_ids, imu)
    if to == "kalibr":
        from tumble.export.kalibr import kalibr

        return kalibr(calibration, noise)
    if to == "dcc" and certificate is not None:
        from tumble.export.dcc import dcc

        return dcc(calibration, certificate)
    function = _plain(to)
    return function(calibration) if imu is None else function(calibration, imu)


def _check_wanted(to: str, noise: NoiseDensities | None, certificate: Certificate | None, imu: int | None) -> None:
    """Check that what is given beside the calibration is what the format takes."""
    if (certificate is not None) != (to == "dcc"):
        found = "none" if certificate is None else f"it with {to}"
        raise InputError(f"export: expected --certificate with dcc and only there, found {found}")
    for what, given, takers in (("noise", noise, ("kalibr",)), ("imu", imu, AUTOPILOTS)):
        if given is not None and to.removesuffix("-thermal") not in takers:
            raise InputError(f"export: expected --{what} with {' or '.join(takers)} and only there, found it with {to}")


def _noise(given: NoiseDensities | Session | FilePath | None) -> NoiseDensities | None:
    from tumble.export.kalibr import NoiseDensities, noise_densities
    from tumble.recording.session_file import session_from

    return given if given is None or isinstance(given, NoiseDensities) else noise_densities(session_from(given))


def _certificate(given: Certificate | FilePath | None) -> Certificate | None:
    from tumble.acceptance.certificate import Certificate, read_certificate

    return given if given is None or isinstance(given, Certificate) else read_certificate(Path(given))


def _plain(to: str) -> Callable[..., Exported]:
    """The function of a format."""
    modules: Mapping[str, str] = _PLAIN
    if to not in modules:
        raise InputError(f"export: expected one of {', '.join(FORMATS)}, found {to!r}")
    function: Callable[..., Exported] = getattr(import_module(f"tumble.export.{modules[to]}"), modules[to])
    return function
