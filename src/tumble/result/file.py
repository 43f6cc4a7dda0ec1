"""Writing, reading and checking of calibration files.

A file is JSON, in SI and radians. Its keys are the fields of `Calibration`, `Evidence` and `Provenance`, side by side;
the types of these fields have the checks, and unknown keys are ignored. Messages name the key, such as
parameters[3].value.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import asdict, fields, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import TypeAdapter, ValidationError

from tumble.advice import Advised, advised
from tumble.documents import as_json, dotted, faults_of, is_plain, json_of, keys_of, shown, text_of_document
from tumble.errors import CalibrationError, InputError
from tumble.inference.estimate import Fit, Outcome
from tumble.recording.session import Circumstances, sensors_content
from tumble.result.correction import correction_content
from tumble.result.coverage import with_degrees
from tumble.result.parts import LARGEST, CalibratedDevice, Evidence, Parameter, Provenance, check_result
from tumble.result.record import AnyCalibration, CalibrationData
from tumble.sensors.model import UNITS, SensorModel
from tumble.sensors.parameters import group_name, sensor_kind, within_group, within_kind

FORMAT = 1
LONGEST_TEXT = 10_000
ORIGIN = ("log_sha256", "software", "created", "prior")  # fields of `Provenance` in the table "provenance"
_NESTED = re.compile(rf"^(evidence|provenance)\.(?!({'|'.join(ORIGIN)})\b)")  # before keys that are side by side
# keys of texts that may have control characters
_SENTENCES = ("notes", "assumptions", "unstated", "absent", "remedies")


# -------------------- writing --------------------


def content_of(calibration: CalibrationData) -> dict[str, Any]:
    """Return the content of the calibration file in the types of JSON.

    Besides the fields it has the correction, the range of temperatures of the rests, the lags behind the thermometer,
    and with each sensor model its unit and the values of the groups beyond it."""
    outcome, evidence, origin = calibration.outcome, calibration.evidence, calibration.provenance
    values = {each.name: getattr(part, each.name) for part in (calibration, evidence, origin) for each in fields(part)}
    provenance = {key: value for key in ORIGIN if (value := values.pop(key)) is not None}
    sentences = (*outcome.reasons, *outcome.remarks, *origin.notes, *origin.assumptions)
    values |= {
        "correction": correction_content(calibration),
        "remedies": {sentence: sentence.remedy for sentence in sentences if isinstance(sentence, Advised)},
        "session": values.pop("circumstances"),
        "provenance": provenance,
    }
    del values["evidence"]
    content: dict[str, Any] = as_json(values, _AS_TABLES)
    content["iterations"] = [
        {"parameters": [{"name": name, "increment": value} for name, value in step.items()]}
        for step in evidence.iterations
    ]
    limits = calibration.temperature_range
    lags = {kind: calibration[f"{kind}.lag"].value for kind in ("accel", "gyro") if f"{kind}.lag" in calibration}
    temperature = content["temperature"] | {"range": None if limits is None else list(limits), "lag": lags}
    content["temperature"] = {key: value for key, value in temperature.items() if value != {}}
    for kind, unit in (*UNITS.items(), ("mag", calibration["mag.bias.x"].unit if calibration.mag else "")):
        if content[kind] is not None:
            content[kind]["unit"] = unit
            for group in calibration.groups:
                members = [p for p in calibration.parameters if group_name(p.name) == group.name]
                if group.kept and sensor_kind(group.name) == kind and members:
                    named = {within_group(p.name) or within_kind(p.name): p.value for p in members}
                    content[kind][within_kind(group.name)] = named
    return {"format": FORMAT} | content


def _parameter_content(parameter: Parameter) -> dict[str, Any]:
    always = {key: getattr(parameter, key) for key in ("name", "value", "u", "unit", "prior", "k")}
    others = {key: getattr(parameter, key) for key in ("deviation", "run_to_run", "learned", "dof")}
    return always | {key: value for key, value in others.items() if value is not None}


def _known_content(circumstances: Circumstances) -> dict[str, Any]:
    content = asdict(circumstances) | {"equipment": list(circumstances.equipment)}
    content["conditions"] = circumstances.conditions.model_dump(exclude_none=True)
    return {key: value for key, value in content.items() if value}


def _device_content(device: CalibratedDevice) -> dict[str, Any]:
    return {"serial": device.serial, "model": device.model} | (
        {"imu": sensors_content(device.imu)} if device.imu else {}
    )


_AS_TABLES: Mapping[type, Callable[[Any], Any]] = {
    np.ndarray: np.ndarray.tolist,
    CalibratedDevice: _device_content,
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


@cache
def _adapter(kind: type[AnyCalibration]) -> TypeAdapter[AnyCalibration]:
    return TypeAdapter(kind)


def schema_of(kind: type[CalibrationData]) -> dict[str, Any]:
    """Return the JSON Schema of the file of a calibration."""
    schema = _adapter(kind).json_schema()
    definitions, properties = schema["$defs"], {"format": {"const": FORMAT, "type": "integer"}} | schema["properties"]
    for result in (Outcome, Fit):  # keys that follow from others
        described = definitions[result.__name__]["properties"]
        described |= {key: {} for key in result.json_fields if key not in described}
    keys = {
        key: each for part in ("Evidence", "Provenance") for key, each in definitions.pop(part)["properties"].items()
    }
    del properties["evidence"]
    table = {"type": "object"}
    properties |= keys | {"correction": table, "remedies": table}
    properties["provenance"] = table | {"properties": {key: properties.pop(key) for key in ORIGIN}}
    return schema | {"properties": properties}


def calibration_of_text(kind: type[AnyCalibration], text: str, name: str) -> AnyCalibration:
    """Read a calibration from the text of a file, named `name` in messages. Raises CalibrationError with the first
    fault."""
    try:
        content = json_of(text)
    except ValueError as error:
        raise _no_calibration(name, error) from error
    if not isinstance(content, dict) or "format" not in content:
        raise _no_calibration(name, "no key 'format'")
    if content["format"] != FORMAT:
        raise CalibrationError(f"{name}: expected format {FORMAT}, found {shown(content['format'])}")

    def part(record: type, values: Mapping[str, Any]) -> dict[str, Any]:
        return {key: values[key] for key in keys_of(record) if key in values}

    origin = content.get("provenance", {})
    if isinstance(origin, dict):
        origin = part(Provenance, content | {key: origin.get(key) for key in ORIGIN})
    nested = part(kind, content) | {"evidence": part(Evidence, content), "provenance": origin}
    try:
        _check_numbers(content)
        read: AnyCalibration = _adapter(kind).validate_json(json.dumps(nested))
        calibration = _checked(read, content.get("remedies", {}))
        _check_texts(content)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        if first["type"] == "json_invalid":
            raise _no_calibration(name, first["msg"].removeprefix("Invalid JSON: ")) from None
        fault = _NESTED.sub("", faults_of(error, nested, kind)[0])
        raise CalibrationError(f"{name}: {fault}") from None
    except ValueError as error:
        raise CalibrationError(f"{name}: {error}") from None
    return calibration


def _checked(read: AnyCalibration, remedies: Any) -> AnyCalibration:
    """Return a calibration as read, with its remedies. Raises ValueError if parts contradict each other."""
    check_result(read.as_launch(""))
    _check_sensors(read)
    if not isinstance(remedies, dict) or not all(isinstance(remedy, str) for remedy in remedies.values()):
        raise ValueError(f"remedies: expected a table of texts, found {shown(remedies)}")
    outcome, evidence, origin = read.outcome, read.evidence, read.provenance

    def with_remedies(sentences: Iterable[str]) -> tuple[str, ...]:
        out = list[str]()
        for each in sentences:
            remedy = remedies.get(each, "")
            if not each.endswith(remedy):
                raise ValueError(f"remedies: expected the end of {shown(each)}, found {shown(remedy)}")
            out.append(advised(each.removesuffix(f"; {remedy}"), remedy))
        return tuple(out)

    launches = (replace(x, parameters=with_degrees(x.parameters, x.fits)) for x in evidence.launches)
    notes, assumptions = with_remedies(origin.notes), with_remedies(origin.assumptions)
    reasons, remarks = with_remedies(outcome.reasons), with_remedies(outcome.remarks)
    return replace(
        read,
        parameters=with_degrees(read.parameters, evidence.fits),
        outcome=replace(outcome, reasons=reasons, remarks=remarks),
        evidence=replace(evidence, launches=tuple(launches)),
        provenance=replace(origin, notes=notes, assumptions=assumptions),
    )


def _check_sensors(calibration: CalibrationData) -> None:
    """Raise ValueError if parts of the file, named by their keys, have different numbers of sensors."""
    evidence, temperature = calibration.evidence, calibration.temperature
    recorded = {"rests": evidence.rests} | {
        f"launches[{number}].rests": launch.rests for number, launch in enumerate(evidence.launches, 1)
    }
    for kind in ("accel", "gyro"):
        model, readings = getattr(calibration, kind), calibration.provenance.readings.get(kind)
        parts: dict[str, Any] = {
            f"{kind}.bias": model and model.bias,
            f"axes.{kind}": calibration.axes.get(kind),
            f"readings.{kind}": readings and readings.columns,
            f"temperature.thermometers.{kind}": temperature.thermometers.get(kind),
            f"temperature.references.{kind}": temperature.references.get(kind),
        }
        for place, rests in recorded.items():
            for number, rest in enumerate(rests, 1):
                sensors = getattr(rest, kind)
                parts[f"{place}[{number}].{kind}"] = sensors and sensors.mean
        counts = {key: len(part) for key, part in parts.items() if part is not None}
        first = next(iter(counts), "")
        for key, found in counts.items():
            if found != counts[first]:
                raise ValueError(f"{key}: expected {counts[first]} sensors, as {first} has, found {found}")


def _check_numbers(content: Mapping[str, Any]) -> None:
    """Raise ValueError for numbers of a document that are too large."""
    for key, value in _leaves(content, ()):
        if isinstance(value, float) and abs(value) > LARGEST:
            size = f"expected a number of at most {LARGEST:g} in size, found {value:g}"
            raise ValueError(f"{dotted(key)[:80]}: {size}")


def _check_texts(content: Mapping[str, Any]) -> None:
    """Raise ValueError for texts of a document that are too long, and for control characters outside of sentences."""
    for key, text in _leaves(content, ()):
        may_have_any = bool(key) and key[0] in _SENTENCES
        if isinstance(text, str) and (len(text) > LONGEST_TEXT or not (may_have_any or is_plain(text))):
            limits = f"at most {LONGEST_TEXT} characters and no control characters"
            raise ValueError(f"{dotted(key)[:80]}: expected {limits}, found {shown(text)}")


def _leaves(content: Any, key: tuple[int | str, ...]) -> Iterator[tuple[tuple[int | str, ...], Any]]:
    """Yield the values of a document with their keys, and the names of keys with those of their tables."""
    for name, each in content.items() if isinstance(content, dict) else enumerate(content):
        yield key, name
        if isinstance(each, dict | list):
            yield from _leaves(each, (*key, name))
        else:
            yield (*key, name), each


def _no_calibration(name: str, found: object) -> CalibrationError:
    return CalibrationError(f"{name}: expected a calibration file of tumble, found {found}")
