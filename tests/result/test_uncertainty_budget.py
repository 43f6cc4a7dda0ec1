"""The budget of a calibration: shares are the whole u² by every method, in every frame, of launches too; it survives
the file; and its sentence says what helps."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
from click.testing import CliRunner

from tests.support.calibrated import with_fields
from tumble import Setup, calibrate, calibrate_launches, read_calibration, read_session, simulate_session
from tumble.cli import main
from tumble.errors import CalibrationError
from tumble.result.calibration import Calibration
from tumble.result.uncertainty_budget import shares_by_group, what_would_help
from tumble.run.calibrate import Method
from tumble.run.launches import Run, mean_of_launches
from tumble.sensors.frames import Frame
from tumble.views.calibration import calibration_blocks
from tumble.views.render.terminal import text_of
from tumble.views.uncertainty_budget import budget_section


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Fourteen positions of a cube, MEMS."""
    return simulate_session(
        tmp_path_factory.mktemp("budget") / "s", Setup.of(grade="mems", programme="cube-14"), seed=1
    )


@pytest.fixture(scope="module")
def whole(session: Path) -> Calibration:
    return calibrate(session)


def assert_whole(calibration: Calibration) -> None:
    """Every parameter has a budget, whose shares are together 1."""
    assert calibration.evidence.budget
    for parameter in calibration.parameters:
        lines = calibration.uncertainty_budget(parameter.name)
        assert sum(line.share for line in lines) == pytest.approx(1.0, abs=1e-12), parameter.name
        assert lines == tuple(sorted(lines, key=lambda line: -line.contribution))


@pytest.mark.parametrize("frame", get_args(Frame))
def test_of_the_joint_method_in_every_frame(session: Path, whole: Calibration, frame: Frame) -> None:
    calibration = whole if frame == whole.frame else calibrate(session, frame=frame)
    assert_whole(calibration)
    assert ("case" in {source.name for source in calibration.evidence.budget}) == (frame == "case")


def test_of_the_ellipsoid_method(session: Path) -> None:
    """What the residuals say, gravity, and what it takes as nothing."""
    calibration = calibrate(session, method="ellipsoid")
    assert_whole(calibration)
    names = {source.name for source in calibration.evidence.budget}
    assert {"fit", "gravity"} <= names
    assert any(name.startswith("prior.") for name in names)


@pytest.mark.parametrize("method", ["sequential", "scalar"])
def test_of_the_methods_of_the_paper(tmp_path: Path, method: Method) -> None:
    folder = simulate_session(tmp_path / "s", Setup.of(programme="rough-table"), seed=2)
    assert_whole(calibrate(folder, method=method))


def test_of_launches(tmp_path: Path) -> None:
    """Within launches, from launch to launch with its degrees of freedom, and what they have in common."""
    setup = Setup.of(grade="mems", positions=12)
    folders = [simulate_session(tmp_path / f"{i}", setup, seed=1, launch=i) for i in (1, 2, 3)]
    mean = calibrate_launches(folders)
    assert_whole(mean)
    by_name = {source.name: source for source in mean.evidence.budget}
    assert by_name["launches"].dof == 2.0
    between = by_name["launches"].contributions
    assert between
    assert set(between) < {p.name for p in mean.parameters}, "of others launches differ by less than they know"


@pytest.mark.weekly
def test_of_launches_each_source_is_what_their_mean_varies_by(tmp_path: Path) -> None:
    """N = 500 times three launches, about the same values with the noise of one alone, and by what a device changes
    from launch to launch alone: the rms of their mean is the contribution of either, in the mean of squares."""
    setup, runs = Setup.of(grade="mems", positions=12), []
    for launch in (1, 2, 3):
        session = read_session(simulate_session(tmp_path / f"{launch}", setup, seed=1, launch=launch))
        runs.append(Run(session=session, calibration=calibrate(session, terms="linear")))
    names, C = list(runs[0].calibration), runs[0].calibration.covariance_of(list(runs[0].calibration))
    assert C is not None
    u, rng = np.sqrt(np.diag(C)), np.random.default_rng(9)
    root = u[:, None] * np.linalg.cholesky(C / np.outer(u, u))
    for source, noise in (("within launches", 1.0), ("launches", 1e-3)):
        errors, variances = [], []
        for _ in range(500):
            drawn = []
            for run in runs:
                off = root @ rng.standard_normal(len(u)) if noise == 1.0 else 3.0 * u * rng.standard_normal(len(u))
                made = run.calibration
                parameters = tuple(
                    replace(made[name], value=value, u=noise * own, dof=None, prior=None)
                    for name, value, own in zip(names, off.tolist(), u.tolist(), strict=True)
                )
                assert made.provenance.site is not None
                site = replace(made.provenance.site, gravity_u=0.0)
                drawn.append(with_fields(made, parameters=parameters, covariance=noise**2 * C, site=site))
            again = [replace(run, calibration=each) for run, each in zip(runs, drawn, strict=True)]
            mean = mean_of_launches(again)
            budget = next(each for each in mean.evidence.budget if each.name == source)
            errors.append([mean[name].value for name in names])
            variances.append([budget.contributions.get(name, 0.0) ** 2 for name in names])
        ratio = np.sqrt(np.mean(np.square(errors), axis=0) / np.mean(variances, axis=0))
        assert np.median(ratio) == pytest.approx(1.0, abs=0.05), source
        assert np.all(np.abs(ratio - 1.0) < 0.15), source


def test_type_b_of_gravity_and_time_base(tmp_path: Path) -> None:
    """Gravity to 1e-4 and a clock to 100 ppm are, in the scale factors, what they are: 100 ppm, with sensitivities 1/g
    and 1."""
    folder = simulate_session(tmp_path / "s", Setup.of(grade="mems", positions=12), seed=3)
    text = (folder / "session.toml").read_text()
    text = text.replace("gravity_u = 1e-07", "gravity_u = 9.81579e-4", 1)
    lines = [line for line in text.splitlines() if not line.startswith("clock_ppm_u")]
    (folder / "session.toml").write_text("\n".join(lines).replace("[log]", "[log]\nclock_ppm_u = 100.0", 1) + "\n")
    calibration = calibrate(folder)
    of_gravity = {line.name: line for line in calibration.uncertainty_budget("accel.scale.x")}["gravity"]
    assert of_gravity.type == "B"
    assert of_gravity.u == pytest.approx(9.81579e-4)
    assert of_gravity.sensitivity == pytest.approx(1.0 / 9.81579, rel=0.1)
    of_clock = {line.name: line for line in calibration.uncertainty_budget("gyro.scale.x")}["clock"]
    assert of_clock.u == pytest.approx(1e-4)
    assert of_clock.sensitivity == pytest.approx(1.0)
    assert "half the u of the time base" in what_would_help(calibration)


def test_the_file_keeps_it(whole: Calibration, tmp_path: Path) -> None:
    whole.write(tmp_path / "c.json")
    again = read_calibration(tmp_path / "c.json")
    assert again.evidence.budget == whole.evidence.budget
    assert again.uncertainty_budget("accel.scale.x") == whole.uncertainty_budget("accel.scale.x")


def test_without_one_it_says_so(whole: Calibration) -> None:
    turned = whole.in_frame("paper")
    with pytest.raises(CalibrationError, match="calibrate again with this frame"):
        turned.uncertainty_budget(next(iter(turned)))
    with pytest.raises(KeyError, match=r"no parameter 'accel\.scale\.q'"):
        whole.uncertainty_budget("accel.scale.q")
    assert what_would_help(turned) == ""
    assert budget_section(turned, "b") is None


def test_longer_rests_are_said_to_help_where_noise_is_all(whole: Calibration) -> None:
    """A quarter of a variance that is all there is halves u."""
    noise = next(source for source in whole.evidence.budget if source.name == "accel.noise")
    of_all = {p.name: p.u for p in whole.parameters if p.u is not None}
    alone = with_fields(whole, budget=(replace(noise, contributions=of_all),))
    assert what_would_help(alone).startswith("u would be smaller 2.00 times with rests four times as long")


def test_shares_by_group_are_whole(whole: Calibration) -> None:
    for share in shares_by_group(whole).values():
        assert share.sum() == pytest.approx(1.0)


def test_the_command_shows_it(session: Path, whole: Calibration, tmp_path: Path) -> None:
    """Shares by source where they are asked for; with --all the table of each parameter; JSON has the contributions."""
    asked = ["calibrate", str(session), "--budget", "--out", str(tmp_path / "c.json")]
    shown = CliRunner().invoke(main, asked).output
    assert "u would be smaller " in shown
    assert "noise of the gyros in turns" in shown
    assert "Uncertainty budget of" not in shown
    assert "noise of the gyros in turns" not in text_of(calibration_blocks(whole))
    assert text_of(calibration_blocks(whole, every=True, budget=True)).count("Uncertainty budget of") == 21
    budget = {source["name"]: source for source in whole.content()["budget"]}
    assert budget["accel.noise"]["type"] == "A"
    assert budget["accel.noise"]["contributions"]["accel.bias.x"] > 0.0


def test_the_page_has_a_bar_for_each_parameter(whole: Calibration) -> None:
    section = budget_section(whole, "b")
    assert section is not None
    svg = next(block.svg for block in section.blocks if block.kind == "figure")
    assert svg.count('clip-path="url(#') >= 21
