"""tumble: calibration of strapdown inertial measurement units from recordings made on rough equipment.

The way the data go
    session.toml + log → Session, Log → rests and turns → Observations → method → Estimate → Calibration

Conventions, for every module
    units     SI and radians inside; a name that is not SI carries its unit (`latitude_deg`)
    frames    b  body X, Y, Z, fixed by the accelerometers (see `model`)
              n  geographic N (north), U (up), E (east), right-handed in the order N, U, E
              s  sensor: one coordinate a sensor
    vectors   `vec_a` is resolved in frame a; `mat_ab` takes coordinates in b to a
    model     reading = matrix @ true + bias; matrix n×3 = diag(1 + k) A(γ), Eq. (1) of the turntable method
    gravity   an accelerometer at rest with its axis up reads +g; g is positive, m/s²
    samples   a sample is the mean over the interval that ends at its time stamp
    u         standard uncertainty (k = 1)

Symbols used as names where an equation is printed
    S   matrix of a block                u   direction of the vertical in the body, a unit vector
    C   rotation of a turn, body at its end → body at its start
    M   ∫ C ⊗ ω dt, B   ∫ C dt           sensitivities of a turn to gyro matrix and bias
    k   scale-factor error               γ   axis angle        Ω   Earth's rate
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

__version__ = "0.1.0"

_PUBLIC = {
    "Session": "recording.session",
    "read_session": "recording.session",
    "open_log": "recording.log",
    "Block": "sensors.model",
    "SensorModel": "sensors.model",
    "Observations": "reduction.observations",
    "Calibration": "calibration.calibration_file",
    "Parameter": "calibration.results",
    "calibrate": "calibration.calibrate",
    "inspect_session": "calibration.calibrate",
    "read_calibration": "calibration.calibration_file",
    "Run": "calibration.launches",
    "mean_of_launches": "calibration.launches",
    "fit_ellipsoid": "estimation.ellipsoid",
    "compare_calibrations": "calibration.compare",
    "positions_of": "calibration.verify",
    "verify_calibration": "calibration.verify",
    "apply_to_session": "calibration.apply",
    "export_calibration": "export",
    "write_report": "report.write",
    "open_registry": "registry.connect",
    "Setup": "planning.setup",
    "simulate_session": "simulation.session",
    "allan_deviation": "reduction.allan_deviation",
    "normal_gravity": "earth",
    "TumbleError": "errors",
    "InputError": "errors",
    "MissingExtraError": "errors",
}

__all__ = ["__version__", *sorted(_PUBLIC)]


def __getattr__(name: str) -> Any:
    """Public names are imported when they are first used: the command line starts without NumPy."""
    if name not in _PUBLIC:
        raise AttributeError(f"module 'tumble' has no attribute {name!r}")
    return getattr(import_module(f"tumble.{_PUBLIC[name]}"), name)
