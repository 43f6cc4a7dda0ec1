"""Results of Kalibr and imu_tk beside a calibration of the same readings: files made by the published formulas."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from click.testing import CliRunner

from tests.support.calibrated import calibration
from tumble.cli import main
from tumble.errors import InputError
from tumble.result.calibration import Calibration
from tumble.result.parts import Parameter, Readings
from tumble.rotation import rotation_matrix
from tumble.units import Array
from tumble.use.compare import compare_calibrations

G_SENSITIVITY = np.arange(1.0, 10.0).reshape(3, 3) * 1e-5


def lower_times_rotation(matrix: Array) -> tuple[Array, Array]:
    """L Q = M, L lower triangular with a positive diagonal."""
    Q, R = np.linalg.qr(matrix.T)
    signs = np.sign(np.diag(R))
    return R.T * signs, signs[:, None] * Q.T


def kalibr_content(made: Calibration) -> dict[str, object]:
    """What Kalibr would have found of this device: w_m = M C w + A C a."""
    assert made.accel is not None
    assert made.gyro is not None
    M, C = lower_times_rotation(made.gyro.matrix)
    return {
        "imu0": {
            "T_i_b": np.eye(4).tolist(),
            "accelerometer_noise_density": 0.00668,
            "accelerometers": {"M": made.accel.matrix.tolist()},
            "gyroscopes": {"A": (G_SENSITIVITY @ C.T).tolist(), "C_gyro_i": C.tolist(), "M": M.tolist()},
            "model": "scale-misalignment",
            "rostopic": "/imu0",
            "update_rate": 200.0,
        }
    }


@pytest.mark.parametrize("flow", [None, False])
def test_a_result_of_kalibr_agrees_but_for_its_biases(tmp_path: Path, flow: bool | None) -> None:
    """Both styles in which versions of its YAML library write."""
    made = calibration()
    path = tmp_path / "camchain-imucam.yaml"
    path.write_text(yaml.dump(kalibr_content(made), default_flow_style=flow))
    G = tuple(
        Parameter(name=f"gyro.g_sensitivity.{s}{a}", value=float(G_SENSITIVITY[i, j]), u=None, unit="rad*s/m")
        for i, s in enumerate("xyz")
        for j, a in enumerate("xyz")
    )
    found = compare_calibrations(replace(made, parameters=made.parameters + G, covariance=None), path)
    names = [d.name for d in found.differences]
    assert len(names) == 24
    assert not [name for name in names if ".bias." in name]
    np.testing.assert_allclose([d.value for d in found.differences], 0.0, atol=1e-12)
    assert "biases of Kalibr change with time and are not in its file" in found.remarks
    assert not found.agree  # nothing is judged: Kalibr gives no uncertainties


def test_the_size_effect_of_kalibr_is_lever_arms(tmp_path: Path) -> None:
    made, content = calibration(), kalibr_content(calibration())
    accelerometers = content["imu0"]["accelerometers"]  # type: ignore[index]
    accelerometers |= {"rx_i": [0.01, 0.0, 0.002], "ry_i": [0.0, 0.02, 0.0], "rz_i": [0.001, 0.0, 0.0]}
    path = tmp_path / "k.yaml"
    path.write_text(yaml.dump(content))
    levers = tuple(Parameter(name=f"accel.lever.{s}.{a}", value=0.0, u=1e-3, unit="m") for s in "xy" for a in "xyz")
    found = compare_calibrations(replace(made, parameters=made.parameters + levers, covariance=None), path)
    second = {d.name: d.second for d in found.differences}
    assert [second[f"accel.lever.x.{a}"] for a in "xyz"] == pytest.approx([0.009, 0.0, 0.002])
    assert [second[f"accel.lever.y.{a}"] for a in "xyz"] == pytest.approx([-0.001, 0.02, 0.0])


def imu_tk_texts(made: Calibration, scale: float, offset: float) -> tuple[str, str]:
    """Both files of imu_tk for raw = offset + scale · reading: true' = T K (raw − B), T upper triangular with ones on
    its diagonal for the accelerometers, in a frame where the Z accelerometer is along Z."""
    assert made.accel is not None
    assert made.gyro is not None
    raw_to_true = np.linalg.inv(made.accel.matrix) / scale
    Q, R = np.linalg.qr(raw_to_true)  # Qᵀ turns into the frame of imu_tk
    signs = np.sign(np.diag(R))
    Q, R = Q * signs, signs[:, None] * R
    out = []
    for matrix, bias in ((R, made.accel.bias), (Q.T @ np.linalg.inv(made.gyro.matrix) / scale, made.gyro.bias)):
        K = np.diag(np.diag(matrix))
        parts = (matrix @ np.linalg.inv(K), K, (offset + scale * bias)[:, None])
        out.append(
            "\n\n".join("\n".join(" ".join(f"{x:.17g}" for x in row) for row in part) for part in parts) + "\n\n"
        )
    return out[0], out[1]


@pytest.mark.parametrize(("scale", "offset"), [(1.0, 0.0), (3754.87, 32768.0)])
def test_results_of_imu_tk_agree_in_the_frame_of_the_accelerometers(
    tmp_path: Path, scale: float, offset: float
) -> None:
    """For readings in SI, and for counts of the calibration's log."""
    made = calibration()
    readings = {
        kind: Readings(
            columns=("x", "y", "z"), unit="count", increments=False, scale=(3754.87,) * 3, offset=(32768.0,) * 3
        )
        for kind in ("accel", "gyro")
    }
    made = replace(made, readings=readings)
    for name, text in zip(("acc", "gyro"), imu_tk_texts(made, scale, offset), strict=True):
        (tmp_path / name).write_text(text)
    found = compare_calibrations(made, tmp_path / "acc", gyro=tmp_path / "gyro")
    assert len(found.differences) == 21
    np.testing.assert_allclose([d.value for d in found.differences], 0.0, atol=1e-9)
    assert any("raw readings taken as " + ("SI" if scale == 1.0 else "count") in r for r in found.remarks)
    assert len(compare_calibrations(made, tmp_path / "acc").differences) == 9


def test_a_calibration_in_another_frame_is_converted_first(tmp_path: Path) -> None:
    made = calibration()
    path = tmp_path / "k.yaml"
    path.write_text(yaml.dump(kalibr_content(made)))
    found = compare_calibrations(made.in_frame("symmetric"), path)
    assert found.frame == "accelerometer"
    np.testing.assert_allclose([d.value for d in found.differences], 0.0, atol=1e-12)


def test_other_files_and_other_readings_are_refused(tmp_path: Path) -> None:
    made, path = calibration(), tmp_path / "f"
    path.write_text("imu0:\n  accelerometers:\n    M:\n    - [1.0, 0.0]\n")
    with pytest.raises(InputError, match=r"accelerometers\.M: expected nine numbers"):
        compare_calibrations(made, path)
    path.write_text("time ax ay az\n")
    with pytest.raises(InputError, match="or the 21 numbers of imu_tk, found 4 words"):
        compare_calibrations(made, path)
    path.write_text(imu_tk_texts(made, 100.0, 0.0)[0])
    with pytest.raises(InputError, match="expected sensitivities near one"):
        compare_calibrations(made, path)
    made.write(tmp_path / "c.json")
    with pytest.raises(InputError, match="beside one of imu_tk only"):
        compare_calibrations(made, tmp_path / "c.json", gyro=path)


def test_the_command_shows_both(tmp_path: Path) -> None:
    made = calibration()
    made.write(tmp_path / "c.json")
    acc, gyro = imu_tk_texts(made, 1.0, 0.0)
    (tmp_path / "acc").write_text(acc)
    (tmp_path / "gyro").write_text(gyro)
    done = CliRunner().invoke(
        main, ["compare", str(tmp_path / "c.json"), str(tmp_path / "acc"), "--gyro-file", str(tmp_path / "gyro")]
    )
    assert done.exit_code == 1
    assert "gyro.scale.z" in done.stdout
    assert "the second has no uncertainties: nothing is judged" in done.stderr


def test_the_frame_of_a_turned_device_does_not_matter() -> None:
    """The formula of imu_tk, read by itself: a raw reading is corrected to the length of the true vector."""
    made = calibration()
    assert made.accel is not None
    numbers = np.array(imu_tk_texts(made, 1.0, 0.0)[0].split(), dtype=float)
    T, K, B = numbers[:9].reshape(3, 3), numbers[9:18].reshape(3, 3), numbers[18:]
    turned = rotation_matrix(np.array([[0.1, 0.2, 0.3]]))[0]
    raw = made.accel.predict(np.array([[1.0, 2.0, 9.0]]) @ turned)[0]
    assert np.linalg.norm(T @ K @ (raw - B)) == pytest.approx(np.linalg.norm([1.0, 2.0, 9.0]), rel=1e-12)
    assert np.abs(np.tril(T, -1)).max() < 1e-12
