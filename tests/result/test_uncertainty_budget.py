"""The budget of a calibration: shares are the whole u² by every method, in every frame, of launches too; it survives
the file; and its sentence says what helps."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
from click.testing import CliRunner

from tests.support.calibrated import with_fields
from tumble import Setup, calibrate, read_calibration, read_session, simulate_session
from tumble.cli import main
from tumble.earth import EARTH_RATE
from tumble.errors import CalibrationError
from tumble.result.calibration import Calibration
from tumble.result.parts import coverage_factor
from tumble.result.shared_errors import prior_sensitivities
from tumble.result.uncertainty_budget import shares_by_group, shares_of_priors
from tumble.run.calibrate import Method
from tumble.run.launches import LaunchRun, mean_of_launches
from tumble.sensors.frames import Frame
from tumble.sensors.parameters import Terms, beyond_linear
from tumble.views.calibration import calibration_blocks
from tumble.views.render.terminal import text_of
from tumble.views.uncertainty_budget import budget_blocks


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
    calibration = calibrate(folder, method=method)
    assert_whole(calibration)
    assert_as_in_ea_4_02(calibration)


def assert_as_in_ea_4_02(calibration: Calibration) -> None:
    """Every line of every parameter has an estimate, u, unit, distribution and sensitivity, of which the contribution
    is the product; the reference standards are among them."""
    assert calibration.provenance.site is not None
    for parameter in calibration.parameters:
        lines = {line.name: line for line in calibration.uncertainty_budget(parameter.name)}
        for line in lines.values():
            assert line.u is not None
            assert line.unit
            assert line.distribution in ("normal", "t", "rectangular")
            assert line.contribution == pytest.approx(line.sensitivity * line.u, rel=1e-12)
        assert lines["gravity"].estimate == calibration.provenance.site.gravity
        if parameter.name.startswith("gyro"):
            assert lines["earth"].estimate == EARTH_RATE
            assert lines["clock"].unit == "1"


def test_every_line_is_as_in_ea_4_02(whole: Calibration, session: Path) -> None:
    assert_as_in_ea_4_02(whole)
    assert_as_in_ea_4_02(calibrate(session, method="ellipsoid"))


@pytest.mark.parametrize("terms", ["full", "linear"])
def test_of_launches(tmp_path: Path, terms: Terms) -> None:
    """By the sources of its launches, from launch to launch with its degrees of freedom. What priors and gravity
    contribute does not average out, noise does."""
    setup = Setup.of(grade="mems", positions=12)
    folders = [simulate_session(tmp_path / f"{i}", setup, seed=1, launch=i) for i in (1, 2, 3)]
    runs = [LaunchRun(session=read_session(folder), calibration=calibrate(folder, terms=terms)) for folder in folders]
    mean = mean_of_launches(runs)
    assert_whole(mean)
    assert_as_in_ea_4_02(mean)
    by_name = {source.name: source for source in mean.evidence.budget}
    for source, averaged in (("accel.noise", 3.0), ("prior.accel.cubic", 1.0)):
        each = [{s.name: s for s in run.calibration.evidence.budget}[source] for run in runs]
        rms = np.sqrt(np.mean([one.contributions["accel.scale.x"] ** 2 for one in each]))
        assert by_name[source].contributions["accel.scale.x"] == pytest.approx(rms / np.sqrt(averaged), rel=0.05)
        assert by_name[source].u == pytest.approx(np.sqrt(np.mean([(one.u or 0.0) ** 2 for one in each])))
    assert by_name["launches"].dof == 2.0
    between = by_name["launches"].contributions
    assert between
    for parameter in mean.parameters:  # u of the line is s/√3, from which U is at least t(2) u
        (line,) = (line for line in mean.uncertainty_budget(parameter.name) if line.name == "launches")
        assert line.u == pytest.approx((parameter.run_to_run or 0.0) / np.sqrt(3.0))
        assert (parameter.k or np.inf) * (parameter.u or 0.0) >= 0.9999 * coverage_factor(2.0) * (line.u or 0.0)
    assert set(between) < {p.name for p in mean.parameters}, "of others launches differ by less than they know"


@pytest.mark.weekly
def test_of_launches_each_source_is_what_their_mean_varies_by(tmp_path: Path) -> None:
    """N = 500 times three launches, about the same values with the noise of one alone, and by what a device changes
    from launch to launch alone: the rms of their mean is the contribution of either, in the mean of squares."""
    setup, runs = Setup.of(grade="mems", positions=12), []
    for launch in (1, 2, 3):
        session = read_session(simulate_session(tmp_path / f"{launch}", setup, seed=1, launch=launch))
        runs.append(LaunchRun(session=session, calibration=calibrate(session, terms="linear")))
    names, C = list(runs[0].calibration), runs[0].calibration.covariance_of(list(runs[0].calibration))
    assert C is not None
    u, rng = np.sqrt(np.diag(C)), np.random.default_rng(9)
    root = u[:, None] * np.linalg.cholesky(C / np.outer(u, u))
    between, budgets = {"launches"}, [run.calibration.evidence.budget for run in runs]
    alone = [tuple(each for each in budget if not each.name.startswith("prior.")) for budget in budgets]
    within = {source.name for source in alone[0]} - {"gravity", "clock"}
    for sources, noise in ((within, 1.0), (between, 1e-3)):
        errors, variances = [], []
        for _ in range(500):
            drawn = []
            for run, budget in zip(runs, alone, strict=True):
                off = root @ rng.standard_normal(len(u)) if noise == 1.0 else 3.0 * u * rng.standard_normal(len(u))
                made = run.calibration
                parameters = tuple(
                    replace(made[name], value=value, u=noise * own, dof=None, prior=None)
                    for name, value, own in zip(names, off.tolist(), u.tolist(), strict=True)
                )
                assert made.provenance.site is not None
                site = replace(made.provenance.site, gravity_u=0.0)
                fields = {"parameters": parameters, "covariance": noise**2 * C, "site": site, "budget": budget}
                drawn.append(with_fields(made, **fields))
            again = [replace(run, calibration=each) for run, each in zip(runs, drawn, strict=True)]
            mean = mean_of_launches(again)
            shown = [each.contributions for each in mean.evidence.budget if each.name in sources]
            errors.append([mean[name].value for name in names])
            variances.append([sum(each.get(name, 0.0) ** 2 for each in shown) for name in names])
        ratio = np.sqrt(np.mean(np.square(errors), axis=0) / np.mean(variances, axis=0))
        assert np.median(ratio) == pytest.approx(1.0, abs=0.05), sources
        assert np.all(np.abs(ratio - 1.0) < 0.15), sources


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
    assert budget_blocks(turned) == []


def test_shares_by_group_are_whole(whole: Calibration) -> None:
    for share in shares_by_group(whole).values():
        assert share.sum() == pytest.approx(1.0)


def test_priors_err_by_what_the_budget_says(whole: Calibration) -> None:
    """Where the size of a group was found with the estimate, too."""
    changes = prior_sensitivities(whole.parameters, whole.covariance, whole.evidence.budget)
    of_cubic = np.linalg.norm([changes[f"accel.cubic.{axis}"] for axis in "xyz"], axis=0)
    stated = {each.name: each for each in whole.evidence.budget}["prior.accel.cubic"].contributions
    assert of_cubic == pytest.approx([stated.get(name, 0.0) for name in whole], rel=1e-9)


def test_priors_err_by_no_more_than_u(whole: Calibration) -> None:
    """What is left of the variance of a linear parameter, in every frame, is that of a difference from another session
    of the device."""
    for made in (whole, whole.in_frame("paper")):
        assert made.covariance is not None
        changes = prior_sensitivities(made.parameters, made.covariance, made.evidence.budget)
        shared = np.sum(np.square(list(changes.values())), axis=0)
        linear = [not beyond_linear(name) for name in made]
        assert np.all(shared[linear] < np.diag(made.covariance)[linear])


@pytest.mark.parametrize(
    ("device", "basis"),
    [("", "guessed grade mems"), ('grade = "mems"', "stated grade mems"), ("", "data sheet")],
)
def test_what_the_sizes_of_priors_rest_on(session: Path, tmp_path: Path, device: str, basis: str) -> None:
    """With its share of u²: a guessed grade, one that is stated, or a data sheet."""
    text = (session / "session.toml").read_text().replace("[device]", f"[device]\n{device}", 1)
    text += '[device.prior]\n"accel_cubic" = "100 µg/g³"\n' * (basis == "data sheet")
    shutil.copytree(session, tmp_path / "s")
    (tmp_path / "s" / "session.toml").write_text(text)
    made = calibrate(tmp_path / "s")
    shares = shares_of_priors(made)
    assert basis in shares
    lines = [line for line in made.uncertainty_budget("accel.scale.x") if line.basis == basis]
    assert 0.0 < shares[basis]["accel.scale"] < 1.0
    assert "prior.accel.cubic" in {line.name for line in lines}


def test_the_command_shows_it(session: Path, whole: Calibration, tmp_path: Path) -> None:
    """Shares by source where they are asked for; with --all the table of each parameter; JSON has the contributions."""
    asked = ["calibrate", str(session), "--budget", "--out", str(tmp_path / "c.json")]
    shown = CliRunner().invoke(main, asked).output
    assert "noise of the gyros in turns" in shown
    assert "Uncertainty budget of" not in shown
    assert "noise of the gyros in turns" not in text_of(calibration_blocks(whole))
    assert text_of(calibration_blocks(whole, every=True, budget=True)).count("Uncertainty budget of") == 21
    budget = {source["name"]: source for source in whole.content()["budget"]}
    assert budget["accel.noise"]["type"] == "A"
    assert budget["accel.noise"]["contributions"]["accel.bias.x"] > 0.0
