"""Frames: one block of sensors, seen in several of them, stays the same block."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import sqrtm

from tests.support.shared import calibrated, session
from tumble.cli import main
from tumble.commands.params import FRAMES as OFFERED
from tumble.errors import InputError
from tumble.planning.setup import Setup
from tumble.recording.session_file import read_session
from tumble.result.calibration import Calibration, read_calibration
from tumble.rotation import rotation_matrix
from tumble.run.calibrate import calibrate
from tumble.run.launches import LaunchRun, mean_of_launches
from tumble.sensors.frames import FRAMES, Alignment, Convention, Frame, convert, frame_of, rotation_to, triad_axes
from tumble.sensors.model import Block, SensorModel
from tumble.units import Array

TRIAD = np.eye(3)
PERMUTED = np.array([[0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
TETRAD = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [3**-0.5] * 3])
OF_TRIADS: tuple[Frame, ...] = ("accelerometer", "paper", "symmetric")
seeds = st.integers(min_value=0, max_value=2**32 - 1)


def blocks(axes: Array) -> tuple[Block, Block]:
    return Block(kind="accel", axes=axes), Block(kind="gyro", axes=axes)


def drawn(axes: Array, seed: int) -> tuple[Block, Block, Array]:
    """Two blocks and errors as large as a bad device has them: 3 % and 30 mrad."""
    accel, gyro = blocks(axes)
    values = 0.03 * np.random.default_rng(seed).standard_normal(len(accel.names) + len(gyro.names))
    return accel, gyro, values


def aligned(accel: Block, seed: int) -> Alignment:
    rng = np.random.default_rng(seed)
    return Alignment(
        mat_cb=rotation_matrix(0.03 * rng.standard_normal(3)),
        covariance=np.diag([1e-6, 4e-6, 9e-6]),
        by_parameters=rng.standard_normal((3, len(accel.names))),
    )


def known(covariance: Array | None) -> Array:
    assert covariance is not None
    return covariance


def derivative(of: Callable[[Array], Array], at: Array) -> Array:
    """Central differences, the argument last."""
    return np.stack([(of(at + h) - of(at - h)) / 2e-6 for h in 1e-6 * np.eye(len(at))], axis=-1)


# -------------------- what a frame is --------------------


@given(seeds)
def test_the_frame_of_the_paper_is_diagonal_times_unit_upper_triangular(seed: int) -> None:
    """Built the paper's way, turned by any rotation, and found again."""
    rng = np.random.default_rng(seed)
    k, (zx, yx, xx) = 1.0 + 0.05 * rng.standard_normal(3), 0.02 * rng.standard_normal(3)
    paper = np.diag(k) @ np.array([[1.0, zx, yx], [0.0, 1.0, xx], [0.0, 0.0, 1.0]])
    accel, _ = blocks(TRIAD)
    turned = SensorModel(matrix=paper @ rotation_matrix(rng.standard_normal(3)), bias=np.zeros(3))
    found = SensorModel(matrix=turned.matrix @ rotation_to("paper", accel, turned), bias=turned.bias)
    np.testing.assert_allclose(found.matrix, paper, atol=1e-14)
    np.testing.assert_allclose(
        Convention(frame="paper", block=accel).parameters(found), [0.0, 0.0, 0.0, *(k - 1.0), zx, yx, xx], atol=1e-14
    )


@given(seeds)
def test_the_symmetric_frame_has_the_root_of_m_mt(seed: int) -> None:
    accel, gyro, values = drawn(TRIAD, seed)
    framed = convert(accel, gyro, source="accelerometer", values=values, covariance=None, target="symmetric")
    matrix = accel.model(values[:9]).matrix
    np.testing.assert_allclose(framed.accel.matrix, sqrtm(matrix @ matrix.T), atol=1e-13)


@given(seeds)
def test_signs_and_order_of_channels_go_into_the_rows_alone(seed: int) -> None:
    """The frame is the same for channels in another order and of the other sign."""
    plain, swapped, values = blocks(TRIAD)[0], blocks(PERMUTED)[0], drawn(TRIAD, seed)[2][:9]
    for frame in ("paper", "symmetric"):
        a, b = (
            convert(block, None, source="accelerometer", values=values, covariance=None, target=frame)
            for block in (plain, swapped)
        )
        np.testing.assert_allclose(PERMUTED @ a.accel.matrix, b.accel.matrix, atol=1e-14)
        np.testing.assert_allclose(a.values, b.values, atol=1e-14)


def test_scale_factors_are_sensitivities_along_the_sensors_but_in_the_paper() -> None:
    accel, gyro, values = drawn(TRIAD, 7)
    of = {
        frame: convert(accel, gyro, source="accelerometer", values=values, covariance=None, target=frame).values[3:6]
        for frame in OF_TRIADS
    }
    np.testing.assert_allclose(of["symmetric"], values[3:6], atol=1e-14)
    assert np.abs(of["paper"] - values[3:6]).max() > 1e-5


@pytest.mark.parametrize("axes", [TRIAD, PERMUTED], ids=["triad", "permuted"])
@pytest.mark.parametrize("frame", FRAMES)
def test_the_parameters_of_a_frame_make_the_model_and_back(frame: Frame, axes: Array) -> None:
    convention = Convention(frame=frame, block=blocks(axes)[0])
    assert len(convention.names) == (12 if frame == "case" else 9)
    values = 0.03 * np.random.default_rng(3).standard_normal(len(convention.names))
    np.testing.assert_allclose(convention.parameters(convention.model(values)), values, atol=1e-15)


@pytest.mark.parametrize("axes", [TRIAD, PERMUTED, TETRAD], ids=["triad", "permuted", "tetrad"])
@pytest.mark.parametrize("frame", FRAMES)
def test_the_derivatives_of_a_model_are_right(frame: Frame, axes: Array) -> None:
    if len(axes) > 3 and frame in ("paper", "symmetric"):
        return
    convention = Convention(frame=frame, block=blocks(axes)[0])
    values = 0.03 * np.random.default_rng(4).standard_normal(len(convention.names))

    def model(at: Array) -> Array:
        made = convention.model(at)
        return np.column_stack([made.matrix, made.bias])

    jacobian = convention.jacobian(values)
    np.testing.assert_allclose(jacobian, derivative(model, values), atol=1e-8)


# -------------------- changes of frame --------------------


@given(seeds, st.sampled_from(FRAMES))
@settings(max_examples=40)
def test_what_does_not_depend_on_the_frame_does_not_change(seed: int, frame: Frame) -> None:
    """Lengths of specific forces and rates, and the angle between them, of the same readings."""
    accel, gyro, values = drawn(PERMUTED, seed)
    framed = convert(
        accel,
        gyro,
        source="accelerometer",
        values=values,
        covariance=None,
        target=frame,
        alignment=aligned(accel, seed),
    )
    readings = 10.0 * np.random.default_rng(seed).standard_normal((2, 5, 3))
    count = len(accel.names)
    force, rate = accel.model(values[:count]).apply(readings[0]), gyro.model(values[count:]).apply(readings[1])
    assert framed.gyro is not None
    force_in, rate_in = framed.accel.apply(readings[0]), framed.gyro.apply(readings[1])
    for a, b in ((force, force), (rate, rate), (force, rate)):
        turned = {id(force): force_in, id(rate): rate_in}
        np.testing.assert_allclose(
            np.einsum("ij,ij->i", turned[id(a)], turned[id(b)]), np.einsum("ij,ij->i", a, b), rtol=1e-10, atol=1e-10
        )


@pytest.mark.parametrize("axes", [TRIAD, PERMUTED, TETRAD], ids=["triad", "permuted", "tetrad"])
@pytest.mark.parametrize("target", FRAMES)
def test_the_jacobian_of_a_change_is_that_of_finite_differences(target: Frame, axes: Array) -> None:
    """For the case the rotation itself changes with the parameters, as `by_parameters` says."""
    if len(axes) > 3 and target in ("paper", "symmetric"):
        return
    accel, gyro, values = drawn(axes, 5)
    count = len(accel.names)
    alignment = aligned(accel, 6)

    def converted(at: Array) -> Array:
        turn = rotation_matrix(alignment.by_parameters @ (at - values)[:count])
        moved = Alignment(
            mat_cb=turn @ alignment.mat_cb,
            covariance=alignment.covariance,
            by_parameters=alignment.by_parameters,
        )
        return convert(
            accel, gyro, source="accelerometer", values=at, covariance=None, target=target, alignment=moved
        ).values

    framed = convert(
        accel, gyro, source="accelerometer", values=values, covariance=None, target=target, alignment=alignment
    )
    np.testing.assert_allclose(framed.jacobian, derivative(converted, values), atol=2e-8)


def test_the_uncertainty_of_the_alignment_goes_into_all_angles_of_both_blocks() -> None:
    accel, gyro, values = drawn(TRIAD, 8)
    alignment = aligned(accel, 9)

    def turned(psi: Array) -> Array:
        moved = Alignment(
            mat_cb=rotation_matrix(psi) @ alignment.mat_cb,
            covariance=alignment.covariance,
            by_parameters=alignment.by_parameters,
        )
        return convert(
            accel, gyro, source="accelerometer", values=values, covariance=None, target="case", alignment=moved
        ).values

    framed = convert(
        accel,
        gyro,
        source="accelerometer",
        values=values,
        covariance=np.zeros((21, 21)),
        target="case",
        alignment=alignment,
    )
    J = derivative(turned, np.zeros(3))
    np.testing.assert_allclose(known(framed.covariance), J @ alignment.covariance @ J.T, atol=1e-12)
    angles = np.array(["axis" in name for name in framed.names])
    assert np.diag(known(framed.covariance))[angles].min() > 0.9e-6
    assert np.diag(known(framed.covariance))[~angles].max() < 1e-12


@given(seeds, st.sampled_from(FRAMES), st.sampled_from(OF_TRIADS))
@settings(max_examples=40)
def test_there_and_back_nothing_has_changed(seed: int, first: Frame, second: Frame) -> None:
    accel, gyro, values = drawn(TRIAD, seed)
    root = np.random.default_rng(seed).standard_normal((21, 21))
    there = convert(
        accel,
        gyro,
        source="accelerometer",
        values=values,
        covariance=root @ root.T,
        target=first,
        alignment=aligned(accel, seed),
    )
    on = convert(accel, gyro, source=first, values=there.values, covariance=there.covariance, target=second)
    back = convert(accel, gyro, source=second, values=on.values, covariance=on.covariance, target="accelerometer")
    np.testing.assert_allclose(back.values, values, atol=1e-13)
    np.testing.assert_allclose(known(back.covariance), root @ root.T, atol=1e-9)


def test_without_gyros_the_accelerometers_are_converted_alone() -> None:
    accel, gyro, values = drawn(TRIAD, 10)
    both = convert(accel, gyro, source="accelerometer", values=values, covariance=np.eye(21), target="paper")
    alone = convert(accel, None, source="accelerometer", values=values[:9], covariance=np.eye(9), target="paper")
    assert alone.gyro is None
    assert alone.names == both.names[:9]
    np.testing.assert_allclose(alone.values, both.values[:9], atol=0.0)
    np.testing.assert_allclose(known(alone.covariance), known(both.covariance)[:9, :9], atol=1e-15)


# -------------------- refusals --------------------


def test_frames_that_do_not_exist_are_refused() -> None:
    accel, _, values = drawn(TRIAD, 11)
    tetrad = blocks(TETRAD)[0]
    with pytest.raises(InputError, match="expected one of accelerometer, case, paper, symmetric, found 'body'"):
        frame_of("body")
    for frame in ("paper", "symmetric"):
        with pytest.raises(InputError, match=f"frame '{frame}': expected three accelerometers"):
            Convention(frame=frame, block=tetrad)
    with pytest.raises(InputError, match="frame 'case': expected the alignment"):
        convert(accel, None, source="accelerometer", values=values[:9], covariance=None, target="case")
    mirrored = SensorModel(matrix=np.diag([1.0, 1.0, -1.0]), bias=np.zeros(3))
    with pytest.raises(InputError, match="left-handed"):
        rotation_to("symmetric", accel, mirrored)


def test_nominal_axes_are_found_in_a_matrix() -> None:
    accel, _, values = drawn(PERMUTED, 12)
    np.testing.assert_array_equal(triad_axes(accel.model(values[:9]).matrix), PERMUTED)
    with pytest.raises(InputError, match="one along each body axis"):
        triad_axes(TETRAD)


# -------------------- sessions --------------------


CUBE = Setup.of(programme="cube-14", rest=8.0, rate_deg_s=40.0, sample_rate=50.0)


@pytest.fixture
def folder() -> Path:
    return session(CUBE, seed=21)


@pytest.fixture
def plain() -> Calibration:
    return calibrated(CUBE, seed=21, words={"terms": "linear"})


def test_the_command_offers_every_frame() -> None:
    assert tuple(OFFERED) == FRAMES


@pytest.mark.parametrize("frame", FRAMES)
def test_a_calibration_is_written_and_read_in_every_frame(
    frame: Frame, folder: Path, plain: Calibration, tmp_path: Path
) -> None:
    out = tmp_path / "c.json"
    result = CliRunner().invoke(
        main, ["calibrate", str(folder), "--terms", "linear", "--frame", frame, "--out", str(out)]
    )
    assert result.exit_code == 0, result.output
    found = read_calibration(out)
    assert found.frame == frame
    assert found.accel is not None
    assert found.gyro is not None
    assert plain.accel is not None
    assert plain.gyro is not None
    convention = Convention(frame=frame, block=blocks(TRIAD)[0])
    values = np.array([p.value for p in found.parameters])
    count = len(convention.names)
    assert tuple(p.name for p in found.parameters) == convention.names + blocks(TRIAD)[1].names
    np.testing.assert_allclose(convention.model(values[:count]).matrix, found.accel.matrix, atol=1e-14)
    np.testing.assert_allclose(blocks(TRIAD)[1].model(values[count:]).matrix, found.gyro.matrix, atol=1e-14)
    u = np.array([p.u for p in found.parameters], dtype=float)
    np.testing.assert_allclose(np.sqrt(np.diag(known(found.covariance))), u, rtol=1e-12)
    turn = np.linalg.solve(plain.accel.matrix, found.accel.matrix)
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-13)
    np.testing.assert_allclose(plain.gyro.matrix @ turn, found.gyro.matrix, atol=1e-13)
    assert [r.residual for r in found.evidence.rests] == [r.residual for r in plain.evidence.rests]


def test_the_mean_of_launches_is_in_their_frame(folder: Path) -> None:
    sessions = [read_session(each) for each in (folder, session(CUBE, seed=21, launch=2))]
    mean = mean_of_launches(
        [LaunchRun(session=s, calibration=calibrate(s, frame="paper", terms="linear")) for s in sessions]
    )
    assert mean.frame == "paper"
    assert mean.accel is not None
    np.testing.assert_allclose(np.tril(mean.accel.matrix, -1), 0.0, atol=1e-15)
    np.testing.assert_allclose(np.diag(mean.accel.matrix), [1.0 + mean[f"accel.scale.{a}"].value for a in "xyz"])


def test_deviations_from_the_passport_are_given_in_its_frame(folder: Path, plain: Calibration, tmp_path: Path) -> None:
    """The passport is the calibration itself: nothing deviates from it; in another frame none are given."""
    plain.write(tmp_path / "passport.json")
    text = (folder / "session.toml").read_text(encoding="utf-8")
    (tmp_path / "session.toml").write_text(text.replace("[device]\n", '[device]\nsystematic = "passport.json"\n'))
    (tmp_path / "log.parquet").symlink_to(folder / "log.parquet")
    for frame in FRAMES:
        found = calibrate(tmp_path, frame=frame, terms="linear")
        assert found.frame == frame
        for parameter in found.parameters:
            assert (parameter.deviation is not None) == (frame == "accelerometer")
            assert parameter.u
            assert abs(parameter.deviation or 0.0) < 0.02 * parameter.u


def test_truth_is_shown_in_its_own_frame_only(folder: Path, tmp_path: Path) -> None:
    arguments = ["calibrate", str(folder), "--frame", "paper", "--truth", str(folder / "truth.json")]
    result = CliRunner().invoke(main, [*arguments, "--out", str(tmp_path / "c.json")])
    assert result.exit_code == 2
    assert "--truth: expected the frame 'accelerometer'" in result.output
    assert json.loads((folder / "truth.json").read_text())
