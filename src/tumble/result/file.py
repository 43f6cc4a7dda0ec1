"""Writing, reading and checking of calibration files.

A file is JSON, in SI and radians. Its keys are the fields of `Calibration`, `Evidence` and `Provenance`, side by side;
the types of these fields have the checks, and unknown keys are ignored. Messages name the key, such as
parameters[3].value.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import asdict, field, fields, make_dataclass
from functools import cache
from pathlib import Path
from typing import Any, Literal, get_type_hints

import numpy as np
from pydantic import ConfigDict, TypeAdapter, ValidationError

from tumble.advice import Advised
from tumble.documents import as_json, dotted, faults_of, is_plain, json_of, shown, text_of_document
from tumble.errors import CalibrationError, InputError
from tumble.recording.session import Circumstances, sensors_content
from tumble.result.correction import correction_content
from tumble.result.parts import LARGEST, Parameter
from tumble.result.record import AnyCalibration, CalibrationData
from tumble.sensors.model import UNITS, SensorModel
from tumble.sensors.parameters import group_name, sensor_kind, within_group, within_kind

FORMAT = 1
LONGEST_TEXT = 10_000
KEYS = (
    *("format", "device", "method", "frame", "parameters", "covariance", "site", "rests", "turns", "fits"),
    *("accel", "gyro", "mag", "correction", "outcome", "groups", "hyperparameters", "integral", "process_bias"),
    *("budget", "prediction", "axes", "temperature", "iterations", "sample_rate", "clock_u", "circumstances"),
    *("programme", "readings", "notes", "assumptions", "unstated", "absent", "remedies"),
    *("launches", "together", "provenance"),
)
"""Keys of the file in their order; `circumstances` is written as "session"."""
# keys of texts that may have control characters
_SENTENCES = ("notes", "assumptions", "unstated", "absent", "remedies")
ORIGIN = ("log_sha256", "software", "created", "prior")  # fields of `Provenance` in the table "provenance"


def file_record(*parts: type) -> type:
    """Return a dataclass whose fields are the keys of the file, from the fields of `Calibration` and its parts."""
    described: dict[str, tuple[Any, Any]] = {
        "format": (Literal[1], field(default=FORMAT)),
        "provenance": (Mapping[str, str], field(default_factory=dict)),
        "correction": (Mapping[str, Any], field(default_factory=dict)),
        "remedies": (Mapping[str, str], field(default_factory=dict)),
    }
    for part in parts:
        hints = get_type_hints(part, include_extras=True)
        for each in fields(part):
            default = field(default=each.default, default_factory=each.default_factory)
            described.setdefault(each.name, (hints[each.name], default))
    return make_dataclass(
        "Calibration",
        [(key, *described[key]) for key in KEYS],
        kw_only=True,
        namespace={"__pydantic_config__": ConfigDict(extra="ignore", strict=True, allow_inf_nan=False)},
    )


@cache
def adapter_of(record: type) -> TypeAdapter[Any]:
    """Return the pydantic adapter that reads a `file_record` and provides its schema."""
    return TypeAdapter(record)


# -------------------- writing --------------------


def content_of(calibration: CalibrationData) -> dict[str, Any]:
    """Return the content of the calibration file in the types of JSON.

    Besides the fields it has the correction, the range of temperatures of the rests, the lags behind the thermometer,
    and with each sensor model its unit and the values of the groups beyond it."""
    values: dict[str, Any] = {"format": FORMAT}
    for part in (calibration, calibration.evidence, calibration.provenance):
        values |= {each.name: getattr(part, each.name) for each in fields(part)}
    values["correction"] = correction_content(calibration)
    outcome, origin = calibration.outcome, calibration.provenance
    sentences = (*outcome.reasons, *outcome.remarks, *origin.notes, *origin.assumptions)
    values["remedies"] = {sentence: sentence.remedy for sentence in sentences if isinstance(sentence, Advised)}
    values["provenance"] = {key: values[key] for key in ORIGIN if values[key] is not None}
    content: dict[str, Any] = {
        "session" if key == "circumstances" else key: as_json(values[key], _AS_TABLES) for key in KEYS
    }
    content["iterations"] = [
        {"parameters": [{"name": name, "increment": value} for name, value in step.items()]}
        for step in calibration.evidence.iterations
    ]
    content["device"]["imu"] = sensors_content(calibration.imu)
    limits = calibration.temperature_range
    temperature = content["temperature"] | {"range": None if limits is None else list(limits)}
    lags = {kind: calibration[f"{kind}.lag"].value for kind in ("accel", "gyro") if f"{kind}.lag" in calibration}
    temperature |= {"lag": lags} if lags else {}
    content["temperature"] = {key: value for key, value in temperature.items() if value != {}}
    content["device"] = {key: value for key, value in content["device"].items() if value != {}}
    for kind, unit in (*UNITS.items(), ("mag", calibration["mag.bias.x"].unit if calibration.mag else "")):
        if content[kind] is not None:
            content[kind]["unit"] = unit
            for group in calibration.groups:
                members = [p for p in calibration.parameters if group_name(p.name) == group.name]
                if group.kept and sensor_kind(group.name) == kind and members:
                    values = {within_group(p.name) or within_kind(p.name): p.value for p in members}
                    content[kind][within_kind(group.name)] = values
    return content


def _parameter_content(parameter: Parameter) -> dict[str, Any]:
    always = {key: getattr(parameter, key) for key in ("name", "value", "u", "unit", "prior", "k")}
    others = {key: getattr(parameter, key) for key in ("deviation", "run_to_run", "learned", "dof")}
    return always | {key: value for key, value in others.items() if value is not None}


def _known_content(circumstances: Circumstances) -> dict[str, Any]:
    content = asdict(circumstances) | {"equipment": list(circumstances.equipment)}
    content["conditions"] = circumstances.conditions.model_dump(exclude_none=True)
    return {key: value for key, value in content.items() if value}


_AS_TABLES: Mapping[type, Callable[[Any], Any]] = {
    np.ndarray: np.ndarray.tolist,
    Parameter: _parameter_content,
    SensorModel: lambda model: {"matrix": model.matrix.tolist(), "bias": model.bias.tolist(), "unit": ""},
    Circumstances: _known_content,
}
"""Content of types that are not written field by field."""


def check_replaceable(new: CalibrationData, path: Path, *, force: bool) -> None:
    """Raise CalibrationError unless a calibration may replace a file."""
    if not os.access(path, os.W_OK):
        raise CalibrationError(f"{path}: cannot be replaced: it is read-only; choose another --out")
    if not path.stat().st_size:
        return
    try:
        old = json_of(text_of_document(path))
        same = old["method"] == new.method and old["provenance"]["log_sha256"] == new.provenance.log_sha256
        is_usable = any(not old["outcome"][kind]["reasons"] and old[kind] is not None for kind in ("accel", "gyro"))
    except (ValueError, KeyError, TypeError, InputError) as error:
        raise CalibrationError(
            f"{path}: expected a calibration to replace, found another file; remove it, or choose another --out"
        ) from error
    if is_usable and not same and not force:
        raise CalibrationError(
            f"{path}: holds a calibration from another log or by another method; give --force to replace it, or "
            "--out for another file"
        )


# -------------------- reading --------------------


def text_of(path: Path) -> str:
    """Return the text of a calibration file, not yet checked."""
    return text_of_document(path, CalibrationError)


def parsed(record: type, text: str, name: str, build: Callable[[Any], AnyCalibration]) -> AnyCalibration:
    """Read a calibration from the text of a file, named `name` in messages.

    `record` is a `file_record`; `build` returns the calibration of such a record, and raises ValueError if its parts
    contradict each other. Raises CalibrationError with the first fault."""
    try:
        content = json_of(text)
    except ValueError as error:
        raise _no_calibration(name, error) from error
    if not isinstance(content, dict) or "format" not in content:
        raise _no_calibration(name, "no key 'format'")
    if content["format"] != FORMAT:
        raise CalibrationError(f"{name}: expected format {FORMAT}, found {shown(content['format'])}")
    try:
        for key, value in _first(content, lambda value, _: isinstance(value, float) and abs(value) > LARGEST):
            size = f"expected a number of at most {LARGEST:g} in size, found {value:g}"
            raise ValueError(f"{dotted(key)[:80]}: {size}")
        result = build(adapter_of(record).validate_json(text))
        for key, value in _first(content, _is_no_text):
            limits = f"at most {LONGEST_TEXT} characters and no control characters"
            raise ValueError(f"{dotted(key)[:80]}: expected {limits}, found {shown(value)}")
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        if first["type"] == "json_invalid":
            raise _no_calibration(name, first["msg"].removeprefix("Invalid JSON: ")) from None
        raise CalibrationError(f"{name}: {faults_of(error, content, record)[0]}") from None
    except ValueError as error:
        raise CalibrationError(f"{name}: {error}") from None
    return result


def _first(
    content: Any, wrong: Callable[[Any, int | str], bool], key: tuple[int | str, ...] = ()
) -> list[tuple[tuple[int | str, ...], Any]]:
    """Return the first value or key name that is `wrong`, with its key, or nothing.

    `wrong` is called with the value and its key at the top level."""
    for name, each in content.items() if isinstance(content, dict) else enumerate(content):
        top = key[0] if key else name
        if isinstance(name, str) and wrong(name, key[0] if key else ""):
            return [(key, name)]
        if isinstance(each, dict | list):
            if found := _first(each, wrong, (*key, name)):
                return found
        elif wrong(each, top):
            return [((*key, name), each)]
    return []


def _is_no_text(value: Any, top: int | str) -> bool:
    return isinstance(value, str) and (len(value) > LONGEST_TEXT or (top not in _SENTENCES and not is_plain(value)))


def _no_calibration(name: str, found: object) -> CalibrationError:
    return CalibrationError(f"{name}: expected a calibration file of tumble, found {found}")
