"""A recording as a document of JSON and as a workbook, in the published formats. Nothing here is read by the
project."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tumble.units import Array

Write = Callable[[Array, Path], Path]
"""Writes times, accelerometers and gyros (m, 7) into a folder."""


def _json(document: Callable[[Array], Any], *, indent: int | None = None) -> Write:
    def write(rows: Array, folder: Path) -> Path:
        (folder / "imu.json").write_text(json.dumps(document(rows), indent=indent), encoding="utf-8")
        return folder / "imu.json"

    return write


def _named(rows: Array) -> dict[str, list[float]]:
    return dict(zip(("t", "ax", "ay", "az", "gx", "gy", "gz"), rows.T.tolist(), strict=True))


def _threes(rows: Array) -> dict[str, Any]:
    return {"device": "A", "time": rows[:, 0].tolist(), "acc": rows[:, 1:4].tolist(), "gyr": rows[:, 4:].tolist()}


def _axes(values: Array) -> dict[str, list[float]]:
    return dict(zip("xyz", values.T.tolist(), strict=True))


def _apart(rows: Array) -> dict[str, Any]:
    """As of phones: each with times of its own."""
    t = rows[:, 0]
    return {
        "accelerometer": {"time": t.tolist(), **_axes(rows[:, 1:4])},
        "gyroscope": {"time": t.tolist(), **_axes(rows[:, 4:])},
    }


def _samples(rows: Array) -> list[dict[str, Any]]:
    return [
        {"timestamp": t, "accel": dict(zip("xyz", a, strict=True)), "gyro": dict(zip("xyz", g, strict=True))}
        for t, a, g in zip(rows[:, 0].tolist(), rows[:, 1:4].tolist(), rows[:, 4:].tolist(), strict=True)
    ]


def _sensor_logger(rows: Array) -> list[dict[str, str]]:
    """The JSON of Sensor Logger: a row for each sensor, numbers as text, and what it says of the phone."""
    out = [{"sensor": "Metadata", "version": "3", "device name": "phone"}]
    for row in rows:
        time = {"time": str(1_700_000_000_000_000_000 + round(row[0] * 1e9)), "seconds_elapsed": repr(float(row[0]))}
        for sensor, values in (("TotalAcceleration", row[1:4]), ("Gyroscope", row[4:])):
            out.append({"sensor": sensor, **time, **dict(zip("xyz", map(repr, values.tolist()), strict=True))})
        out.append({"sensor": "Orientation", **time, "qx": "0.1", "qy": "0.2", "qz": "0.1", "qw": "0.9"})
    return out


def printed_by_python(rows: Array, folder: Path) -> Path:
    """A dictionary a line, as Python prints it."""
    (folder / "imu.csv").write_text("".join(f"{sample}\n" for sample in _samples(rows)), encoding="utf-8")
    return folder / "imu.csv"


DOCUMENTS: dict[str, Write] = {
    "columns": _json(_named),
    "threes, indented": _json(_threes, indent=1),
    "within an object": _json(lambda rows: {"rate": 50, "data": {"bands": list(range(64)), **_named(rows)}}),
    "sensors apart": _json(_apart),
    "samples": _json(_samples),
    "samples, indented": _json(lambda rows: {"samples": _samples(rows)}, indent=2),
    "rows": _json(lambda rows: rows.tolist()),
    "Sensor Logger": _json(_sensor_logger),
    "printed by Python": printed_by_python,
}

# -------------------- workbooks --------------------

_MAIN = 'xmlns="http://schemas.openxmlformats.org/spreadsheetml/2006/main"'
_RELATION = "http://schemas.openxmlformats.org/officeDocument/2006/relationships"
_PACKAGE = "http://schemas.openxmlformats.org/package/2006"
_TYPE = "application/vnd.openxmlformats-officedocument.spreadsheetml.sheet.main+xml"


def _cell(place: str, value: str | float) -> str:
    if isinstance(value, str):
        return f'<c r="{place}" t="inlineStr"><is><t>{value}</t></is></c>'
    return f'<c r="{place}"><v>{value!r}</v></c>'


def _sheet(rows: Sequence[Sequence[str | float]]) -> str:
    lines = (
        f'<row r="{i}">{"".join(_cell(f"{chr(65 + j)}{i}", v) for j, v in enumerate(row))}</row>'
        for i, row in enumerate(rows, 1)
    )
    return f"<worksheet {_MAIN}><sheetData>{''.join(lines)}</sheetData></worksheet>"


def workbook(path: Path, sheets: dict[str, Sequence[Sequence[str | float]]]) -> Path:
    """An XLSX file with these sheets."""
    listed = list(enumerate(sheets.items(), 1))
    names = "".join(f'<sheet name="{name}" sheetId="{k}" r:id="r{k}"/>' for k, (name, _) in listed)
    parts = "".join(
        f'<Relationship Id="r{k}" Type="{_RELATION}/worksheet" Target="worksheets/sheet{k}.xml"/>' for k, _ in listed
    )
    main = f'<Relationship Id="r1" Type="{_RELATION}/officeDocument" Target="xl/workbook.xml"/>'
    kinds = '<Default Extension="xml" ContentType="application/xml"/>'
    kinds += f'<Override PartName="/xl/workbook.xml" ContentType="{_TYPE}"/>'
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("[Content_Types].xml", f'<Types xmlns="{_PACKAGE}/content-types">{kinds}</Types>')
        archive.writestr("_rels/.rels", f'<Relationships xmlns="{_PACKAGE}/relationships">{main}</Relationships>')
        archive.writestr(
            "xl/workbook.xml", f'<workbook {_MAIN} xmlns:r="{_RELATION}"><sheets>{names}</sheets></workbook>'
        )
        archive.writestr(
            "xl/_rels/workbook.xml.rels", f'<Relationships xmlns="{_PACKAGE}/relationships">{parts}</Relationships>'
        )
        for k, (_, rows) in listed:
            archive.writestr(f"xl/worksheets/sheet{k}.xml", _sheet(rows))
    return path


def phone_workbook(rows: Array, folder: Path) -> Path:
    """phyphox: a sheet for each sensor, and what it says of the phone."""
    accel = [["Time (s)", *(f"Acceleration {a} (m/s^2)" for a in "xyz")], *rows[:, :4].tolist()]
    gyro = [["Time (s)", *(f"Gyroscope {a} (rad/s)" for a in "xyz")], *rows[:, [0, 4, 5, 6]].tolist()]
    about = [["property", "value"], ["version", "1.1"]]
    return workbook(folder / "phyphox.xlsx", {"Accelerometer": accel, "Gyroscope": gyro, "Metadata Device": about})


def table_workbook(rows: Array, folder: Path) -> Path:
    """A laboratory's: one sheet, with a title above."""
    names = ["t [s]", *(f"a{x} [g]" for x in "xyz"), *(f"w{x} [rad/s]" for x in "xyz")]
    table = np.column_stack([rows[:, 0], rows[:, 1:4] / 9.80665, rows[:, 4:]])
    return workbook(folder / "lab.xlsx", {"Tabelle 1": [["Messung", "3"], [], names, *table.tolist()]})
