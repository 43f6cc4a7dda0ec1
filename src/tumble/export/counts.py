"""Settings of firmware that holds its corrections in counts of its converter, and of what counts Linux shows.

    iNav            (count − zero) · gain / 4096                       zero, gain whole numbers
    Betaflight      Rᵀ count − zero                                    zero whole numbers, R of whole degrees
    M5Unified       (2¹⁶ count − offset) / 2¹⁶                         offset a whole number
    SlimeVR         A⁻¹ (count − B) and, of the gyros, count − off     all of single precision
    Linux IIO       (count + calibbias) · calibscale                   both as the driver has them

in the order and the axes of the chip, before what the firmware turns them into, but for Betaflight: there the board is
turned first, by the roll, pitch and yaw of

    R = (cz cy, −cy sz, sy;  sz cx + sx cz sy, cz cx − sx sz sy, −sx cy;  sx sz − cz cx sy, sx cz + sz cx sy, cy cx)

How many counts a g and a °/s are, the calibration knows where the recording was in counts; else they are those of the
usual range, or of --counts.

Source: iNav, sensors/acceleration.c and settings.yaml; Betaflight, sensors/acceleration.c, sensors/boardalignment.c,
common/vector.c and cli/settings.c; M5Unified, utility/IMU_Class.cpp; SlimeVR-Tracker-ESP, SoftfusionCalibration.h and
configuration/SensorConfig.h; Linux, Documentation/ABI/testing/sysfs-bus-iio.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from tumble.errors import InputError
from tumble.export.autopilots import gyro_matrix_lost, worst
from tumble.export.exported import UNITS, Exported, example, losses_of, origin, shown, triads
from tumble.result.calibration import Calibration
from tumble.sensors.model import SensorKind, SensorModel
from tumble.units import DEGREE, G_STANDARD, Array

WHOLE = 2**15 - 1
"""The largest offset of 16 bits."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Firmware:
    """What holds corrections in counts: how many a g and a °/s are usual; by kind of sensors the text for three offsets
    and what a count is worth in them; for three factors, what 1 is in them, and between what they may be; for a matrix;
    for three angles of the board; what it makes of a kind that it has no text for; how a comment begins; and lines
    before and after."""

    counts: tuple[float, float]
    offset: Mapping[SensorKind, str]
    worth: float = 1.0
    whole: bool = True
    factor: Mapping[SensorKind, str] = field(default_factory=dict)
    one: float = 1.0
    factors: tuple[float, float] = (0.0, np.inf)
    matrix: Mapping[SensorKind, str] = field(default_factory=dict)
    board: str = ""
    instead: str = ""
    comment: str = "#"
    before: tuple[str, ...] = ()
    after: tuple[str, ...] = ()


_IIO: Mapping[SensorKind, str] = {"accel": "accel", "gyro": "anglvel"}
_FIRST: Mapping[SensorKind, int] = {"accel": 0, "gyro": 3}
FIRMWARE: Mapping[str, Firmware] = {
    "inav": Firmware(
        counts=(2048.0, 16.4),
        offset={"accel": "set acczero_x = {}\nset acczero_y = {}\nset acczero_z = {}"},
        factor={"accel": "set accgain_x = {}\nset accgain_y = {}\nset accgain_z = {}"},
        one=4096.0,
        factors=(1.0, 8192.0),
        instead="iNav zeroes the gyros at every start",
        after=("save",),
    ),
    "betaflight": Firmware(
        counts=(2048.0, 16.4),
        offset={"accel": "set acc_calibration = {},{},{},1"},
        board="set align_board_roll = {}\nset align_board_pitch = {}\nset align_board_yaw = {}",
        instead="Betaflight zeroes the gyros at every start",
        after=("save",),
    ),
    "m5unified": Firmware(
        counts=(4096.0, 16.384),
        offset={
            kind: "\n".join(f"M5.Imu.setOffsetData({first + i}, {{}});" for i in range(3))
            for kind, first in _FIRST.items()
        },
        worth=65536.0,
        comment="//",
        before=("M5.Imu.setCalibration(0, 0, 0);",),
        after=("M5.Imu.saveOffsetToNVS();",),
    ),
    "slimevr": Firmware(
        counts=(2048.0, 16.4),
        offset={"accel": ".A_B = {{{}, {}, {}}},", "gyro": ".G_off = {{{}, {}, {}}},"},
        whole=False,
        matrix={"accel": ".A_Ainv = {{{{{}, {}, {}}}, {{{}, {}, {}}}, {{{}, {}, {}}}}},"},
        comment="//",
    ),
    "iio": Firmware(
        counts=(2048.0, 16.4),
        offset={
            kind: "\n".join(f"echo {{}} > in_{name}_{axis}_calibbias" for axis in "xyz") for kind, name in _IIO.items()
        },
        worth=-1.0,
        factor={
            kind: "\n".join(f"echo {{}} > in_{name}_{axis}_calibscale" for axis in "xyz") for kind, name in _IIO.items()
        },
        before=("cd /sys/bus/iio/devices/iio:device0 || exit 1",),
    ),
}
"""Every one by its format's name: adding one is adding an entry, and a line in `tumble.export.FORMATS`."""


def counts_per_si(
    calibration: Calibration, kind: SensorKind, usual: tuple[float, float], given: tuple[float, float] | None
) -> tuple[float, str]:
    """How many counts an m/s² or a rad/s is, and in words where that is from."""
    at, size, unit = (0, G_STANDARD, "g") if kind == "accel" else (1, DEGREE, "deg/s")
    readings = calibration.readings.get(kind)
    if given is not None:
        counts, whence = given[at] / size, "--counts"
    elif readings is not None and readings.unit == "count" and np.ptp(readings.scale) == 0.0:
        counts, whence = float(readings.scale[0]), "the recording"
    else:
        counts, whence = usual[at] / size, "the usual range of the chip: see that it is yours, or give --counts"
    return counts, f"{kind}: {counts * size:.6g} counts a {unit}, by {whence}"


def in_counts(name: str, calibration: Calibration, counts: tuple[float, float] | None = None) -> Exported:
    """The settings of a calibration; `counts` are those a g and a °/s. Raises InputError for what does not fit."""
    target, lines = FIRMWARE[name], list[str]()
    known = triads(calibration, name, needed=() if "gyro" in target.offset else ("accel",))
    told, losses = list[str](), list[str]()
    for kind, model in known.items():
        if kind not in target.offset:
            losses.append(target.instead)
            continue
        per_si, whence = counts_per_si(calibration, kind, target.counts, counts)
        told.append(whence)
        turned = np.eye(3)
        if target.board:
            angles = board_angles(model)
            turned = board_matrix(angles * DEGREE).T
            lines.append(target.board.format(*(f"{angle:.0f}" for angle in angles)))
        offset = _rounded(turned @ model.bias * per_si * target.worth, whole=target.whole)
        if target.whole and np.abs(offset / target.worth).max() > WHOLE:
            raise InputError(
                f"export to {name}: expected offsets within 16 bits of counts, found {np.abs(offset).max():.3g}; give "
                "--counts of the chip"
            )
        lines.append(target.offset[kind].format(*_texts(offset, whole=target.whole)))
        applied = turned
        if kind in target.factor:
            factor = _rounded(target.one / np.diag(model.matrix), whole=target.one != 1.0)
            low, high = target.factors
            if not np.all((factor >= low) & (factor <= high)):
                raise InputError(f"export to {name}: expected factors from {low:g} to {high:g}, found {shown(factor)}")
            lines.append(target.factor[kind].format(*_texts(factor, whole=target.one != 1.0)))
            applied = np.diag(factor / target.one)
        elif kind in target.matrix:
            applied = model.inverse().astype(np.float32).astype(float)
            lines.append(target.matrix[kind].format(*_texts(applied.ravel(), whole=False)))
        worked = example(kind, model)
        zero = offset / target.worth / per_si
        becomes = turned @ worked.reading - zero if target.board else applied @ (worked.reading - zero)
        told.append(
            f"example {kind}: reading {shown(worked.reading)} becomes {shown(becomes.round(6))}; it is "
            f"{shown(worked.true.round(6))} {UNITS[kind]}"
        )
        losses += _lost(kind, model, applied, per_si, whole=target.whole)
    lost = losses_of(calibration, *losses)
    comments = [f"{target.comment} {line}" for line in (*origin(calibration), *told, *lost)]
    text = "\n".join([*comments, *target.before, *lines, *target.after, ""])
    return Exported(content=text.encode(), losses=lost)


inav, betaflight, m5unified, slimevr, iio = (partial(in_counts, name) for name in FIRMWARE)


def _lost(kind: SensorKind, model: SensorModel, applied: Array, per_si: float, *, whole: bool) -> list[str]:
    """What is left of a matrix, and what rounding to whole counts does."""
    error, losses = applied @ model.matrix - np.eye(3), list[str]()
    if np.array_equal(applied, np.eye(3)) and kind == "gyro":
        losses.append(gyro_matrix_lost(model))
    elif worst(error) > 1e-6:
        felt = f"in 1 g an error of up to {G_STANDARD * worst(error):.3g} m/s^2"
        rate = f"an error of up to {100.0 * worst(error):.3g} % of the rate"
        losses.append(f"what is left of scale factors and misalignment ({kind}): {felt if kind == 'accel' else rate}")
    if whole:
        losses.append(f"offsets ({kind}) are whole counts: up to {0.5 / per_si:.3g} {UNITS[kind]} off")
    return losses


def board_angles(model: SensorModel) -> Array:
    """Roll, pitch and yaw of the board, whole degrees, by which Betaflight turns readings most nearly into the frame
    of the calibration: of the rotation nearest to M⁻¹."""
    U, _, V = np.linalg.svd(model.inverse())
    R = (U @ np.diag([1.0, 1.0, np.linalg.det(U @ V)]) @ V).T
    angles = np.array([
        np.arctan2(-R[1, 2], R[2, 2]), np.arcsin(np.clip(R[0, 2], -1.0, 1.0)), np.arctan2(-R[0, 1], R[0, 0]),
    ])  # fmt: skip
    return np.asarray(np.rint(angles / DEGREE) + 0.0)


def board_matrix(angles: Array) -> Array:
    """R (3, 3) of roll, pitch and yaw, rad; see the module's docstring."""
    (sx, sy, sz), (cx, cy, cz) = np.sin(angles), np.cos(angles)
    return np.array([
        [cz * cy, -cy * sz, sy],
        [sz * cx + sx * cz * sy, cz * cx - sx * sz * sy, -sx * cy],
        [sx * sz - cz * cx * sy, sx * cz + sz * cx * sy, cy * cx],
    ])  # fmt: skip


def _rounded(values: Array, *, whole: bool) -> Array:
    return np.asarray(np.rint(values) + 0.0 if whole else values.astype(np.float32).astype(float))


def _texts(values: Array, *, whole: bool) -> list[str]:
    """Numbers as whole ones, or to the digits of single precision."""
    return [f"{value:.0f}" if whole else np.format_float_positional(np.float32(value), trim="0") for value in values]
