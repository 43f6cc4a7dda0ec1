"""The targets that are templates: each file is parsed as its consumer reads it and applied to raw readings by the
consumer's formula, written down here anew from the sources that the templates name."""

from __future__ import annotations

import json
import re
import subprocess
from collections.abc import Callable
from dataclasses import replace
from math import cos, radians, sin
from pathlib import Path

import numpy as np
import pytest
import yaml
from click.testing import CliRunner

from tests.support.calibrated import calibration, with_fields
from tumble.cli import main
from tumble.errors import InputError
from tumble.export import TEMPLATES, export_calibration
from tumble.export.templates import read_template
from tumble.result.parts import Readings
from tumble.rotation import rotation_matrix
from tumble.sensors.model import SensorModel
from tumble.units import DEGREE, G_STANDARD, Array

NUMBER = r"-?\d+(?:\.\d+)?(?:e-?\d+)?"
Parser = Callable[[str, str, Array], Array]
"""What a target makes of readings (N, 3) of a kind of sensors, SI, by the text of its file."""


def named(text: str, pattern: str, names: list[str]) -> Array:
    """The numbers of lines that a pattern with the place of a name and a number matches."""
    found = dict(re.findall(pattern, text, re.MULTILINE))
    return np.array([float(found[name]) for name in names])


def counts_of(kind: str, accel: float = 2048.0, gyro: float = 16.4) -> float:
    """Counts an m/s² or a rad/s of those a g and a °/s."""
    return accel / G_STANDARD if kind == "accel" else gyro / DEGREE


def inav(text: str, kind: str, readings: Array) -> Array:
    """applyAccelerationZero: (count − zero) · gain / 4096, whole numbers."""
    zero, gain = (
        named(text, rf"^set ({word}_\w) = (-?\d+)$", [f"{word}_{a}" for a in "xyz"]) for word in ("acczero", "accgain")
    )
    assert ((gain >= 1) & (gain <= 8192)).all()
    per_si = counts_of(kind)
    return np.asarray((readings * per_si - zero) * gain / 4096 / per_si)


def betaflight(text: str, kind: str, readings: Array) -> Array:
    """buildRotationMatrix, applyRotationMatrix, which multiplies by the transposed matrix, then accZero."""
    found = dict(re.findall(r"^set (\w+) = (\S+)$", text, re.MULTILINE))
    x, y, z = (radians(int(found.get(f"align_board_{name}", 0))) for name in ("roll", "pitch", "yaw"))
    m = [
        [cos(z) * cos(y), -cos(y) * sin(z), sin(y)],
        [sin(z) * cos(x) + sin(x) * cos(z) * sin(y), cos(z) * cos(x) - sin(x) * sin(z) * sin(y), -sin(x) * cos(y)],
        [sin(x) * sin(z) - cos(z) * cos(x) * sin(y), sin(x) * cos(z) + sin(z) * cos(x) * sin(y), cos(y) * cos(x)],
    ]
    *zero, done = (int(number) for number in found["acc_calibration"].split(","))
    assert done == 1
    raw = readings * counts_of(kind)
    out = [[sum(m[k][i] * v[k] for k in range(3)) - zero[i] for i in range(3)] for v in raw]
    return np.array(out) / counts_of(kind)


def slimevr(text: str, kind: str, readings: Array) -> Array:
    """scaleAccelSample, scaleGyroSample: a matrix times what is left of the counts; gyros have an offset alone."""
    rows = {
        name: np.array([float(v) for v in re.findall(NUMBER, rest)])
        for name, rest in re.findall(r"^\.(\w+) = (.*)$", text, re.M)
    }
    raw = readings * counts_of(kind)
    left = raw - rows["A_B" if kind == "accel" else "G_off"]
    matrix = rows["A_Ainv"].reshape(3, 3) if kind == "accel" else np.eye(3)
    return np.asarray(left @ matrix.T / counts_of(kind))


def m5unified(text: str, kind: str, readings: Array) -> Array:
    """getImuData: offsets in 2⁻¹⁶ of a count."""
    assert text.splitlines()[-1] == "M5.Imu.saveOffsetToNVS();"
    assert "M5.Imu.setCalibration(0, 0, 0);" in text
    first = 0 if kind == "accel" else 3
    offset = named(text, rf"setOffsetData\((\d), ({NUMBER})\)", [str(first + i) for i in range(3)])
    per_si = counts_of(kind, 4096.0, 16.384)
    return np.asarray((readings * per_si * 65536 - offset) / 65536 / per_si)


def iio(text: str, kind: str, readings: Array) -> Array:
    """sysfs-bus-iio: calibbias is added, calibscale multiplies."""
    checked = subprocess.run(["sh", "-n"], input=text, text=True, capture_output=True, check=False)
    assert checked.returncode == 0, checked.stderr
    found = {name: float(value) for value, name in re.findall(rf"^echo ({NUMBER}) > (\w+)$", text, re.MULTILINE)}
    stem = "in_accel" if kind == "accel" else "in_anglvel"
    bias, scale = (np.array([found[f"{stem}_{a}_{what}"] for a in "xyz"]) for what in ("calibbias", "calibscale"))
    assert (bias == bias.round()).all()
    return np.asarray((readings * counts_of(kind) + bias) * scale / counts_of(kind))


def ros_imu_calib(text: str, _: str, readings: Array) -> Array:
    """AccelCalib: SM · raw − bias, row by row."""
    content = yaml.safe_load(text)
    assert set(content) == {"SM", "bias"}
    return np.asarray(readings @ np.array(content["SM"]).reshape(3, 3).T - content["bias"])


def autoware(text: str, _: str, readings: Array) -> Array:
    """imu_corrector: offsets are taken off."""
    (node,) = yaml.safe_load(text).values()
    return np.asarray(readings - [node["ros__parameters"][f"angular_velocity_offset_{axis}"] for axis in "xyz"])


def fusion(text: str, kind: str, readings: Array) -> Array:
    """FusionCalibrationInertial: misalignment · (sensitivity ∘ (uncalibrated − offset)), g and °/s, float."""
    name, size = ("accelerometer", G_STANDARD) if kind == "accel" else ("gyroscope", DEGREE)
    constants = {
        what: np.array([float(v) for v in re.findall(rf"({NUMBER})f", rest)], dtype=np.float32)
        for what, rest in re.findall(rf"^static const Fusion\w+ {name}(\w+) = (.*);$", text, re.M)
    }
    left = (np.float32(readings / size) - constants["Offset"]) * constants["Sensitivity"]
    return np.asarray(left @ constants["Misalignment"].reshape(3, 3).T, dtype=float) * size


def realsense(text: str, kind: str, readings: Array) -> Array:
    """check_X of rs-imu-calibration: numpy.dot(reading, X[:3]) − X[3]."""
    (imu,) = json.loads(text)["imus"]
    part = imu["accelerometer" if kind == "accel" else "gyroscope"]
    X = np.array([*part["scale_and_alignment"], *part["bias"]]).reshape(4, 3)
    return np.array([np.dot(reading, X[:3]) - X[3] for reading in readings])


def imucal(text: str, kind: str, readings: Array) -> Array:
    """FerrarisCalibrationInfo: acc = R_a⁻¹ K_a⁻¹ (acc − b_a), gyr = R_g⁻¹ K_g⁻¹ (gyr − K_ga acc − b_g), here without
    acceleration; m/s² and °/s."""
    content = json.loads(text)
    keys = {f"{unit}_unit" for unit in ("acc", "gyr", "from_acc", "from_gyr")} | {"comment", "cal_type"}
    assert content.keys() == keys | {"_format_version", "K_a", "R_a", "b_a", "K_g", "R_g", "K_ga", "b_g"}
    assert (content["cal_type"], content["_format_version"]) == ("Ferraris", "2.0.0")
    K, R, b = (np.array(content[f"{name}_{kind[0]}"]) for name in "KRb")
    np.testing.assert_array_equal(K, np.diag(np.diag(K)))
    np.testing.assert_allclose(np.linalg.norm(R, axis=1), 1.0, atol=1e-15)
    size = 1.0 if kind == "accel" else DEGREE
    return np.asarray((np.linalg.inv(R) @ np.linalg.inv(K) @ (readings / size - b).T).T * size)


def depthai(text: str, kind: str, readings: Array) -> Array:
    """ImuCalibrationParams: [A | b] in single precision."""
    content = json.loads(text)
    assert content.keys() == {"comment", "noise", "accelerometer", "gyroscope"}
    assert content["noise"].keys() == {"name", "accelerometer", "gyroscope"}
    assert content["noise"]["gyroscope"]["z"].keys() == {"noiseDensity", "randomWalk", "biasStability"}
    affine = np.array(content["accelerometer" if kind == "accel" else "gyroscope"], dtype=np.float32).astype(float)
    assert affine.shape == (3, 4)
    return np.asarray(readings @ affine[:, :3].T + affine[:, 3])


def matlab_imu(text: str, kind: str, readings: Array) -> Array:
    """imuSensor reads 1/100 M v + ConstantBias, its accelerometers −f; solved for v. A part has a name MATLAB takes."""
    ((name, part),) = [(key, value) for key, value in json.loads(text).items() if key != "comment"]
    assert re.fullmatch(r"[A-Za-z]\w*", name, flags=re.ASCII)
    part, sign = part["Accelerometer" if kind == "accel" else "Gyroscope"], -1.0 if kind == "accel" else 1.0
    matrix, bias = np.array(part["AxesMisalignment"]) / 100.0, np.array(part["ConstantBias"])
    return np.linalg.solve(matrix, (sign * readings - bias).T).T * sign


PARSERS: dict[str, Parser] = {
    "inav": inav,
    "betaflight": betaflight,
    "slimevr": slimevr,
    "m5unified": m5unified,
    "iio": iio,
    "ros-imu-calib": ros_imu_calib,
    "autoware": autoware,
    "fusion": fusion,
    "realsense": realsense,
    "imucal": imucal,
    "depthai": depthai,
    "matlab-imu": matlab_imu,
}
NAMES = sorted(file.stem for file in TEMPLATES.glob("*.tmpl"))
KINDS = [
    (name, kind)
    for name in NAMES
    for kind in ("accel", "gyro")
    if kind in read_template(TEMPLATES / f"{name}.tmpl", name).front.test
]
WHOLE = {"ros-imu-calib", "fusion", "realsense", "imucal", "depthai", "matlab-imu"}
"""Targets that hold matrix and bias."""


def test_every_template_has_a_parser_and_a_test_vector() -> None:
    assert sorted(PARSERS) == NAMES
    assert {name for name, _ in KINDS} == set(NAMES)


@pytest.mark.parametrize(("name", "kind"), KINDS)
def test_the_target_makes_of_the_test_vector_what_the_template_says(name: str, kind: str) -> None:
    test = read_template(TEMPLATES / f"{name}.tmpl", name).front.test[kind]  # type: ignore[index]
    model = SensorModel(matrix=np.array(test.matrix), bias=np.array(test.bias))
    other = calibration(0)
    made = with_fields(other, **{kind: model})
    found = PARSERS[name](export_calibration(made, name).content.decode(), kind, np.array([test.reading]))
    np.testing.assert_allclose(found[0], test.corrected, rtol=0.0, atol=2e-6)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(("name", "kind"), KINDS)
def test_what_the_target_gets_wrong_is_what_is_said(name: str, kind: str, seed: int) -> None:
    """In all directions of 1 g and of 100 °/s; and the example in the file is what its numbers make."""
    made = calibration(seed)
    exported = export_calibration(made, name)
    model, text, size = (made.accel, made.gyro)[kind == "gyro"], exported.content.decode(), 100.0 * DEGREE
    size = G_STANDARD if kind == "accel" else size
    assert model is not None
    rng = np.random.default_rng(seed)
    directions = rng.standard_normal((20_000, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    parse = PARSERS[name]
    error = parse(text, kind, model.predict(size * directions)) - size * directions
    largest, note = np.linalg.norm(error, axis=1).max(), exported.losses[0]
    words = "accelerometers" if kind == "accel" else "gyros"
    said = re.search(rf"{words} by up to ([\d.e-]+) (mg|deg/s)", note)
    stated = 0.0 if said is None else float(said[1]) * {"mg": 1e-3 * G_STANDARD, "deg/s": DEGREE}[said[2]]
    assert largest == pytest.approx(stated, rel=0.01, abs=3e-5)
    if name in WHOLE:
        assert said is None
    example = re.search(rf"example {kind}: reading ([-\d. e]+) (?:becomes|is) ([-\d. e]+)", text)
    assert example is not None
    reading, becomes = (np.array(part.split(), dtype=float) for part in example.groups())
    np.testing.assert_allclose(parse(text, kind, reading[None])[0], becomes, rtol=0.0, atol=2e-5)


@pytest.mark.parametrize("angle", [[3.0, -7.0, 21.0], [-170.0, 45.0, 3.0], [10.0, -20.0, 135.0]])
def test_betaflight_turns_a_board_that_is_mounted_askew(angle: list[float]) -> None:
    made = calibration(2)
    assert made.accel is not None
    turned = np.asarray(made.accel.matrix @ rotation_matrix(np.array(angle) * DEGREE), dtype=float)
    model = SensorModel(matrix=turned, bias=made.accel.bias)
    other = replace(made, accel=model)
    true = G_STANDARD * np.random.default_rng(1).standard_normal((50, 3))
    found = betaflight(export_calibration(other, "betaflight").content.decode(), "accel", model.predict(true))
    assert np.abs(found - true).max() < (0.02 + 3 * 0.5 * DEGREE) * np.linalg.norm(true, axis=1).max() + 0.01


def test_betaflight_keeps_the_alignment_of_a_board_that_needs_no_turn() -> None:
    text = export_calibration(calibration(2), "betaflight").content.decode()
    assert "set align_board" not in text
    assert text.count("set acc_calibration") == 1
    assert "after acc_calibration: add" in text


def test_counts_are_those_given_else_those_of_the_recording() -> None:
    made = calibration(2)
    assert made.accel is not None
    raw = Readings(columns=("x", "y", "z"), unit="count", scale=(100.0,) * 3, offset=(0.0,) * 3, increments=False)
    recorded = with_fields(made, readings={"accel": raw})
    for each, given, per_si in ((made, (1024.0, 16.4), 1024.0 / G_STANDARD), (recorded, None, 100.0)):
        text = export_calibration(each, "inav", counts=given).content.decode()
        zero = named(text, r"^set (acczero_\w) = (-?\d+)$", [f"acczero_{a}" for a in "xyz"])
        np.testing.assert_allclose(zero, made.accel.bias * per_si, rtol=0.0, atol=0.5)
    with pytest.raises(InputError, match=r"expected zero from -32767 to 32767, found .*; give counts of the chip"):
        export_calibration(made, "inav", counts=(1e9, 16.4))
    with pytest.raises(InputError, match="export to px4: expected imu, found counts"):
        export_calibration(made, "px4", counts=(2048.0, 16.4))


# -------------------- templates of one's own --------------------

OWN = """\
+++
about = "A target"
formula = "corrected = M (reading - b)"
source = "nobody"
needs = ["accel"]

[accel]
numbers.M = "inverse"
numbers.b = "bias"
corrected = "dot(M, reading - b)"

[test.accel]
matrix = [[2.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
bias = [1.0, 0.0, 0.0]
reading = [3.0, 0.0, 0.0]
corrected = [1.0, 0.0, 0.0]
+++
{% for line in comments %}
; {{ line }}
{% endfor %}
M = {{ accel.M | json }}
"""


def test_a_template_of_ones_own_is_filled_in(tmp_path: Path) -> None:
    made = calibration()
    assert made.accel is not None
    made.write(tmp_path / "c.json")
    (tmp_path / "own.tmpl").write_text(OWN)
    words = ["export", str(tmp_path / "c.json"), "--template", str(tmp_path / "own.tmpl"), "-o", str(tmp_path / "o")]
    done = CliRunner().invoke(main, words)
    assert done.exit_code == 0, done.stderr
    assert "note: gyros: not in this file" in done.stderr
    matrix = json.loads((tmp_path / "o").read_text().rpartition("M = ")[2])
    np.testing.assert_array_equal(matrix, made.accel.inverse())
    both = CliRunner().invoke(main, [*words, "--to", "csv", "--force"])
    assert "expected --to with the name of a target, or --template with a file, found both" in both.stderr


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("+++\nabout", "about", "expected a front matter of TOML between two lines +++, found none"),
        ('about = "A target"', "about = A", "expected TOML, found an error in its syntax"),
        ('source = "nobody"', 'sauce = "nobody"', "unknown key 'sauce' at the top level; did you mean 'source'?"),
        ('formula = "corrected = M (reading - b)"\n', "", "formula: expected this key, found none"),
        ("1.0, 0.0, 0.0]\n+++", "2.0, 0.0, 0.0]\n+++", "[test.accel] corrected: expected what the formula gives"),
        ('"inverse"', '"invers"', "[accel] M: expected an expression with a value, found 'invers' is undefined"),
        (
            '"inverse"',
            '"invert(matrix)"',
            "found 'invert' is undefined; there are matrix, bias, inverse, counts, g_sens",
        ),
        ('"inverse"', '"invert(matrix)"', "force, dot, transpose, inverted, diagonal, lengths, column"),
        ("accel.M | json", "accel.M | yml", "'yml'.; there are json, yaml, identifier, float32"),
        ('"inverse"', "\"inverse.tofile('x')\"", "access to attribute 'tofile' of 'ndarray' object is unsafe"),
        ('"dot(M, reading - b)"', '"1 / 0"', "[accel] corrected: expected an expression with a value, found division"),
        ("accel.M |", "accel.N |", "expected a body that can be filled in, found 'dict object' has no attribute 'N'"),
        ("{% endfor %}", "", "line 21: expected a body that can be filled in, found Unexpected end of template"),
        ("accel.M | json", "comments.__class__.__mro__", "access to attribute '__class__' of 'list' object is unsafe"),
    ],
)
def test_a_template_that_is_wrong_is_refused_in_one_line(old: str, new: str, expected: str, tmp_path: Path) -> None:
    file = tmp_path / "own.tmpl"
    assert old in OWN
    file.write_text(OWN.replace(old, new, 1))
    with pytest.raises(InputError) as error:
        export_calibration(calibration(), template=file)
    assert expected in str(error.value)
    assert str(error.value).startswith(str(file))
    assert "\n" not in str(error.value)
    assert not Path("x").exists()
