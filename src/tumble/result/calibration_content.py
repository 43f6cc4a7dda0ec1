"""What the calibration file holds of a calibration, as the contract of the project defines it."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from tumble.inference.estimate import GroupFinding
from tumble.recording.autopilot import sensors_content
from tumble.recording.circumstances import circumstances_content
from tumble.result.parts import Launch, fits_content, member_content, parameter_content
from tumble.sensors.model import SensorModel
from tumble.sensors.parameters import group_name, sensor_kind, within_group, within_kind

if TYPE_CHECKING:
    from tumble.result.calibration import Calibration

FORMAT = 1


def content_of(calibration: Calibration) -> dict[str, Any]:
    """What the calibration file holds, as JSON has it."""
    return {
        "format": FORMAT,
        "device": {"serial": calibration.serial, "model": calibration.model}
        | ({"imu": sensors_content(calibration.imu)} if calibration.imu else {}),
        "method": calibration.method,
        "frame": calibration.frame,
        "parameters": [parameter_content(p) for p in calibration.parameters],
        "covariance": None if calibration.covariance is None else calibration.covariance.tolist(),
        "accel": _with_further(calibration, "accel", _model_content(calibration.accel, "m/s^2")),
        "gyro": _with_further(calibration, "gyro", _model_content(calibration.gyro, "rad/s")),
        "mag": _model_content(calibration.mag, calibration["mag.bias.x"].unit if calibration.mag is not None else ""),
        "outcome": calibration.outcome.content(),
        "groups": [_group_content(group) for group in calibration.groups],
        "hyperparameters": [asdict(each) for each in calibration.hyperparameters],
        "integral": None if calibration.integral is None else asdict(calibration.integral),
        "process_bias": [asdict(each) for each in calibration.process_bias],
        "prediction": None if calibration.prediction is None else asdict(calibration.prediction),
        "axes": {kind: [list(axis) for axis in axes] for kind, axes in calibration.axes.items()},
        "temperature": _temperature_content(calibration),
        "iterations": [
            {"parameters": [{"name": n, "increment": v} for n, v in step.items()]} for step in calibration.iterations
        ],
        "sample_rate": calibration.sample_rate,
        "clock_u": calibration.clock_u,
        "site": None if calibration.site is None else asdict(calibration.site),
        "session": circumstances_content(calibration.circumstances),
        "programme": calibration.programme,
        "readings": {kind: asdict(readings) for kind, readings in calibration.readings.items()},
        "rests": [asdict(rest) for rest in calibration.rests],
        "turns": [asdict(turn) for turn in calibration.turns],
        "fits": fits_content(calibration.fits),
        "notes": list(calibration.notes),
        "absent": list(calibration.absent),
        "launches": [_launch_content(launch) for launch in calibration.launches],
        "together": [member_content(member) for member in calibration.together],
        "provenance": dict(calibration.provenance),
    }


def _model_content(model: SensorModel | None, unit: str) -> dict[str, Any] | None:
    if model is None:
        return None
    return {"matrix": model.matrix.tolist(), "bias": model.bias.tolist(), "unit": unit}


def _temperature_content(calibration: Calibration) -> dict[str, Any]:
    """The reference and the range, °C, and where they are known the thermometers and the lag behind them, s."""
    content: dict[str, Any] = {"reference": calibration.reference_temperature, "range": calibration.temperature_range}
    if calibration.thermometers:
        content["thermometers"] = {kind: list(of) for kind, of in calibration.thermometers.items()}
    if calibration.references:
        content["references"] = {kind: list(of) for kind, of in calibration.references.items()}
    lag = [p.value for p in calibration.parameters if p.name == "temperature.lag"]
    return content | ({"lag": lag[0]} if lag else {})


def _with_further(calibration: Calibration, kind: str, content: dict[str, Any] | None) -> dict[str, Any] | None:
    """The model of a kind of sensor, and beside it the values of the groups beyond it."""
    if content is None:
        return None
    further = {}
    for group in calibration.groups:
        members = [p for p in calibration.parameters if group_name(p.name) == group.name]
        if group.kept and sensor_kind(group.name) == kind and members:
            named = {within_group(p.name) or within_kind(p.name): p.value for p in members}
            further[within_kind(group.name)] = named
    return content | further


def _group_content(group: GroupFinding) -> dict[str, Any]:
    return {
        "name": group.name,
        "kept": group.kept,
        "prior": group.prior,
        "prior_widened": group.widened,
        "learned": list(group.learned),
    }


def _launch_content(launch: Launch) -> dict[str, Any]:
    return {
        "session": launch.session,
        "parameters": [parameter_content(p) for p in launch.parameters],
        "covariance": None if launch.covariance is None else launch.covariance.tolist(),
        "log_sha256": launch.log_sha256,
        "site": None if launch.site is None else asdict(launch.site),
        "circumstances": circumstances_content(launch.circumstances),
        "rests": [asdict(rest) for rest in launch.rests],
        "turns": [asdict(turn) for turn in launch.turns],
        "fits": fits_content(launch.fits),
    }
