"""Results of Kalibr and imu_tk, to be compared with a calibration of the same readings.

Kalibr (`results-imucam….yaml`, `imu.yaml`; models scale-misalignment and scale-misalignment-size-effect):

    a_m = M_a a + b_a,    w_m = M_g C_gyro_i w + A C_gyro_i a + b_g                                              (1)

with M lower triangular: the accelerometers fix the frame, as they do here; the biases change with time and are not in
the file. With the size effect, rx_i, ry_i and rz_i are where the accelerometers are.

imu_tk (a file for each triad: misalignment T and scale K, 3 × 3, and bias B):

    true = T K (raw − B)                                                                                          (2)

in a frame of its own, which is turned into that of the accelerometers. Raw readings are those of the log that the
calibration was made from, in its unit, or in SI: whichever makes the sensitivities near one.

Source: Kalibr, IccSensors (the error terms of its IMU models); Rehder et al., Extending Kalibr, ICRA 2016; imu_tk,
CalibratedTriad; Tedaldi, Pretto, Menegatti, ICRA 2014.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from tumble.errors import InputError
from tumble.files import FilePath
from tumble.inference.estimate import Outcome
from tumble.result.calibration import Calibration
from tumble.result.file import text_of
from tumble.result.parts import Parameter
from tumble.sensors.model import Block, SensorModel, to_accelerometer_frame
from tumble.sensors.parameters import group_of

NEAR_ONE = 0.3
"""By how much a sensitivity may differ from one."""
KALIBR, IMU_TK = "kalibr", "imu_tk"

_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
_KEY = re.compile(r"( *)(\w+): *(.*)")
_Models = tuple[SensorModel, SensorModel | None]


def foreign_calibration(path: FilePath, gyro: FilePath | None, like: Calibration) -> Calibration:
    """The result of Kalibr or imu_tk (with the file of its gyros, where there is one) for the readings that the
    calibration `like` is of, in the frame `accelerometer`, without uncertainties. Raises InputError for another file,
    and for sensors that cannot be those."""
    path, text = Path(path), text_of(Path(path))
    blocks = like.compensator.accel, like.compensator.gyro
    if not blocks[0].triad or (blocks[1] is not None and not blocks[1].triad):
        raise InputError(f"{path}: expected a calibration of triads to compare it with, found another block of sensors")
    further: dict[str, float] = {}
    of_kalibr = "accelerometers:" in text
    if of_kalibr:
        if gyro is not None:
            raise InputError(f"{gyro}: expected no file of gyros beside {path}, which has them, found one")
        models, further = _of_kalibr(path, text, blocks)
        _check_near_one(path, models[0], like, "accel")
        note = "biases of Kalibr change with time and are not in its file"
    else:
        accel, note = _of_triad(path, like, "accel")
        gyros = None if gyro is None else _of_triad(Path(gyro), like, "gyro")[0]
        models = to_accelerometer_frame(blocks[0], accel, gyros)
    values: dict[str, float] = {}
    for block, model in zip(blocks, models, strict=True):
        if block is not None and model is not None:
            values |= dict(zip(block.names, block.parameters(model).tolist(), strict=True))
    values = {name: value for name, value in values.items() if not (of_kalibr and ".bias." in name)} | further
    return Calibration(
        device=replace(like.device, imu={}),
        method=KALIBR if of_kalibr else IMU_TK,
        frame="accelerometer",
        parameters=tuple(
            Parameter(name=name, value=value, u=None, unit=group_of(name).unit) for name, value in values.items()
        ),
        covariance=None,
        accel=models[0],
        gyro=models[1],
        outcome=Outcome(),
        notes=(note,),
        axes=like.axes,
    )


# Kalibr


def _of_kalibr(path: Path, text: str, blocks: tuple[Block, Block | None]) -> tuple[_Models, dict[str, float]]:
    """The models of a file of Kalibr without biases, whose readings are those of the channels if they are in the order
    X, Y, Z; and g-sensitivity and, of the model with the size effect, lever arms of accelerometers x and y from z."""
    numbers = dict(_numbers_by_key(text))
    first = sorted({key[0] for key in numbers if key[0].startswith("imu")})[:1]
    section = {key[len(first) :]: row for key, row in numbers.items() if list(key[: len(first)]) == first}
    matrices = []
    for key in (("accelerometers", "M"), ("gyroscopes", "M"), ("gyroscopes", "A"), ("gyroscopes", "C_gyro_i")):
        nine = section.get(key, [])
        if len(nine) != 9:
            raise InputError(
                f"{path}: {'.'.join(key)}: expected nine numbers, a matrix, as Kalibr writes with --imu-models "
                f"scale-misalignment, found {len(nine)}"
            )
        matrices.append(np.array(nine).reshape(3, 3))
    M_a, M_g, A, C = matrices
    accel, gyros = SensorModel(matrix=np.asarray(blocks[0].axes @ M_a), bias=np.zeros(3)), None
    further: dict[str, float] = {}
    if blocks[1] is not None:
        gyros = SensorModel(matrix=np.asarray(blocks[1].axes @ (M_g @ C)), bias=np.zeros(3))
        names = (f"gyro.g_sensitivity.{sensor}{axis}" for sensor in "xyz" for axis in "xyz")
        further |= dict(zip(names, (A @ C).ravel().tolist(), strict=True))
    x, y, z = (section.get(("accelerometers", f"r{sensor}_i")) for sensor in "xyz")
    for sensor, place in (("x", x), ("y", y)):
        if z is not None and len(z) == 3 and place is not None:
            further |= {f"accel.lever.{sensor}.{axis}": place[i] - z[i] for i, axis in enumerate("xyz")}
    return (accel, gyros), further


def _numbers_by_key(text: str) -> Iterator[tuple[tuple[str, ...], list[float]]]:
    """The numbers under each key of a YAML file as Kalibr writes it, row by row, by the path of the key."""
    above: list[tuple[int, str]] = []
    numbers: list[float] = []
    for line in text.splitlines():
        key = _KEY.match(line)
        if key is None:
            numbers += map(float, _NUMBER.findall(line.split("#")[0]))
            continue
        if numbers:
            yield tuple(name for _, name in above), numbers
        indent = len(key[1])
        above = [(depth, name) for depth, name in above if depth < indent] + [(indent, key[2])]
        numbers = [float(n) for n in _NUMBER.findall(key[3])] if key[3].startswith("[") else []
    if numbers:
        yield tuple(name for _, name in above), numbers


# imu_tk


def _of_triad(path: Path, like: Calibration, kind: str) -> tuple[SensorModel, str]:
    """Matrix and bias of a file of imu_tk for readings in SI, in its own frame, and in which unit it was."""
    words = text_of(path).split()
    try:
        numbers = np.array([float(word) for word in words])
    except ValueError:
        numbers = np.zeros(0)
    if len(numbers) != 21 or not np.isfinite(numbers).all():
        raise InputError(
            f"{path}: expected a calibration of tumble, a YAML file of Kalibr with scale and misalignment, or the 21 "
            f"numbers of imu_tk, found {len(words)} words"
        )
    T, K, bias = numbers[:9].reshape(3, 3), numbers[9:18].reshape(3, 3), numbers[18:]
    readings = like.readings.get(kind)
    found = [(SensorModel(matrix=np.linalg.inv(T @ K), bias=bias), "SI")]
    if readings is not None and not readings.increments:
        scale, offset = np.array(readings.scale), np.array(readings.offset)
        in_log = SensorModel(matrix=np.linalg.inv(T @ K @ np.diag(scale)), bias=(bias - offset) / scale)
        found.append((in_log, f"{readings.unit}, as in the log"))
    model, unit = min(found, key=lambda one: _off(one[0]))
    _check_near_one(path, model, like, kind)
    return model, f"{path.name}: raw readings taken as {unit}"


def _off(model: SensorModel) -> float:
    """By how much the sensitivities differ from one, in logarithms."""
    return float(np.abs(np.log(np.linalg.norm(model.matrix, axis=1))).max())


def _check_near_one(path: Path, model: SensorModel, like: Calibration, kind: str) -> None:
    if _off(model) > np.log1p(NEAR_ONE):
        sensitivity = ", ".join(f"{s:.4g}" for s in np.linalg.norm(model.matrix, axis=1))
        raise InputError(
            f"{path}: expected sensitivities near one of the readings that the calibration of {like.serial!r} is of "
            f"({kind}), found {sensitivity}; compare results from the same readings"
        )
