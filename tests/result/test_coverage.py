"""What ±U covers: Student's t where u was estimated, and what report, certificate and comparison say of it."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from tests.methods.test_ellipsoid import FOURTEEN, placed
from tests.support.calibrated import calibration, with_fields
from tests.support.exports import CERTIFICATE
from tumble.export import export_calibration
from tumble.inference.estimate import Fit
from tumble.lab.conformity import LimitJudgement, judge_calibration
from tumble.lab.limits import parse_limits
from tumble.lab.report import limits_section
from tumble.result.calibration import Calibration
from tumble.result.coverage import (
    degrees_through,
    expanded,
    expanded_of,
    u_and_degrees_of_mean,
    welch_satterthwaite,
    with_degrees,
)
from tumble.result.further import remarks
from tumble.result.parts import coverage_factor
from tumble.run.from_readings import calibrate_readings
from tumble.run.readings_table import ReadingsTable, read_table
from tumble.units import Array
from tumble.views.numbers import with_expanded
from tumble.views.report.document import ReportedFile, report_of

NAMESPACES = {"si": "https://ptb.de/si", "dcc": "https://ptb.de/dcc"}
PROBABILITY = 0.954499736103642
LIMITS = 'format = 1\n[periodic]\n"accel.bias" = "5 g"\n'


def scattered(degrees: float, scatter: float = 1e-4) -> Fit:
    """A group of residuals with a scatter that was estimated with so many degrees of freedom."""
    return Fit(chi_square=degrees, degrees=degrees, scatter=scatter, unit="m/s^2")


def of_groups(**fits: Fit) -> Calibration:
    """A calibration with these fits, an underscore in their names for a blank."""
    found = {name.replace("_", " "): fit for name, fit in fits.items()}
    made = calibration()
    return with_fields(made, parameters=with_degrees(made.parameters, found), fits=found)


def table(folder: Path, values: Array) -> ReadingsTable:
    path = folder / "r.csv"
    np.savetxt(path, values, delimiter=",", header="x,y,z", comments="", fmt="%.17g")
    return read_table(path)


def reported(made: Calibration) -> str:
    """All that the sections of a report say in sentences."""
    source = ReportedFile(file="c.json", sha256="0" * 64, calibration=made)
    limits = parse_limits(LIMITS, "limits.toml")
    return repr(report_of([source], [[limits_section(limits, judge_calibration(made, limits))]]))


def certified(made: Calibration) -> ET.Element:
    return ET.fromstring(export_calibration(made, "dcc", certificate=CERTIFICATE).content)


def probabilities(root: ET.Element) -> dict[str, tuple[str, ...]]:
    """Of every quantity that has a U: its coverage probability, its coverage factor and its distribution."""
    found = {}
    for quantity in root.iterfind(".//dcc:quantity[@id]", NAMESPACES):
        expanded = quantity.find(".//si:expandedMU", NAMESPACES)
        assert expanded is not None
        said = [
            expanded.findtext(f"si:{key}", "", NAMESPACES)
            for key in ("coverageProbability", "coverageFactor", "distribution")
        ]
        found[quantity.get("id", "")] = tuple(said)
    return found


# -------------------- the factor --------------------


def test_five_degrees_need_k_of_two_point_six_and_known_noise_two() -> None:
    made = of_groups(accelerometers=scattered(5.0), gyro_rests=scattered(30.0, scatter=0.0))
    assert made["accel.bias.x"].k == pytest.approx(stats.t.ppf(0.5 + 0.5 * PROBABILITY, 5), abs=1e-9)
    assert made["accel.bias.x"].k == pytest.approx(2.649, abs=5e-4)
    assert made["gyro.bias.x"].k == 2.0
    assert expanded(made["gyro.bias.x"]) == 2.0 * (made["gyro.bias.x"].u or 0.0)


def test_no_expanded_uncertainty_is_stated_with_less_than_one_degree_of_freedom() -> None:
    made = of_groups(accelerometers=scattered(0.24), gyro_rests=scattered(30.0, scatter=0.0))
    few, known = made["accel.bias.x"], made["gyro.bias.x"]
    assert (few.k, expanded(few), expanded_of(few.u or 0.0, few.dof)) == (None, None, None)
    assert few.u
    assert few.dof == 0.24
    assert expanded(known)
    said = next(each for each in remarks(made) if "no U is stated" in each)
    assert "no U is stated for 9 parameters, first accel.bias.x: u has 0.2 degrees of freedom" in said
    assert with_expanded(few, 1.0)[1] == ""
    certificate = certified(made)
    stated = certificate.findtext(".//dcc:quantity[@id='accel.bias.x']//si:valueStandardMU", "", NAMESPACES)
    assert stated == f"{few.u:.3g}"
    assert certificate.find(".//dcc:quantity[@id='accel.bias.x']//si:expandedMU", NAMESPACES) is None
    assert certificate.find(".//si:coverageFactorXMLList", NAMESPACES) is None
    judged = LimitJudgement(name="accel.bias.x", unit="1", value=0.0, u=1.0, dof=0.24, low=-1e9, high=1e9)
    assert judged.result == "undecided"


def test_gyros_have_the_fewer_degrees_of_rests_and_turns_that_scatter() -> None:
    groups = {
        "accelerometers": scattered(3.0),
        "gyro_rests": scattered(12.0),
        "gyro_turns": scattered(8.0),
        "noise_within_rests": scattered(2.0, scatter=0.0),
    }
    assert of_groups(**groups)["gyro.scale.y"].dof == 8.0
    quiet = of_groups(**groups | {"gyro_turns": scattered(8.0, scatter=0.0)})
    assert quiet["gyro.scale.y"].dof == 12.0
    assert quiet["accel.axis.yx"].dof == 3.0


def test_degrees_that_a_method_gives_stand() -> None:
    own = (replace(calibration().parameters[0], dof=7.0), *calibration().parameters[1:])
    assert with_degrees(own, {"accelerometers": scattered(3.0)}) == own


def test_another_frame_keeps_the_degrees_of_freedom() -> None:
    """Biases and scale factors are the same, axis angles are mixed of those of one kind."""
    made = of_groups(accelerometers=scattered(5.0)).in_frame("paper")
    for parameter in made.parameters:
        wanted = 5.0 if parameter.name.startswith("accel") else None
        if wanted is None and not parameter.name.startswith("gyro.axis"):
            assert parameter.dof is None
        elif wanted is not None:
            assert parameter.dof == pytest.approx(wanted)


def test_a_mixture_has_degrees_between_those_of_its_parts() -> None:
    same, mixed = degrees_through(np.array([[1.0, 0.0], [1.0, 1.0]]), np.ones(2), [4.0, 16.0])
    assert same == pytest.approx(4.0)
    assert mixed == pytest.approx(1.0 / (0.5 / 2.0 + 0.5 / 4.0) ** 2)
    assert degrees_through(np.eye(1), np.ones(1), [None]) == [None]


def test_the_sum_of_known_and_estimated_variance_has_more_degrees_than_the_estimated() -> None:
    assert welch_satterthwaite([(1.0, 3.0), (1.0, None)]) == pytest.approx(12.0)
    assert welch_satterthwaite([(1.0, None)]) is None


@pytest.mark.weekly
def test_the_error_of_a_table_is_within_u_as_often_as_stated(tmp_path: Path) -> None:
    """400 tables of 14 positions, 9 correlated parameters each: the part that is covered has a standard deviation of
    0.0056, so that 0.03 is five of them."""
    inside = []
    for seed in range(400):
        rng = np.random.default_rng(seed)
        values = placed(FOURTEEN, rng) + 1e-5 * rng.standard_normal((14, 3))
        own = table(tmp_path, values)
        made = calibrate_readings(own, unit="g", terms="linear").calibration
        inside.append([abs(p.value) <= (expanded(p) or 0.0) for p in made.parameters])
        assert {p.dof for p in made.parameters} == {5.0}
    assert np.mean(inside) == pytest.approx(0.9545, abs=0.03)


# -------------------- the mean of launches --------------------


@pytest.mark.parametrize(
    ("spread", "u", "degrees"),
    [(3.0, 3.0, 2.0), (0.1, 1.0, 15.0), (0.0, 1.0, 15.0)],
)
def test_the_mean_of_launches_is_known_from_what_its_u_is_made_of(spread: float, u: float, degrees: float) -> None:
    """Three launches: from the instability between them with two degrees of freedom, or, where that is small, from the
    launches' own five each."""
    found = u_and_degrees_of_mean([(1.0, 5.0)] * 3, spread, 0.0)
    assert found[0] * np.sqrt(3.0) == pytest.approx(u)
    assert found[1] == pytest.approx(degrees)


def test_what_launches_have_in_common_does_not_average_out() -> None:
    u, degrees = u_and_degrees_of_mean([(1.0, None)] * 4, 2.0, 3.0)
    assert u == pytest.approx(np.sqrt(4.0 / 4.0 + 9.0))
    assert degrees == pytest.approx(10.0**2 / (1.0 / 3.0))


def test_u_of_a_mean_is_as_wide_as_either_that_it_is_made_of() -> None:
    """Two launches: never less than t₁ s, nor than what they know of themselves, however much they agree."""
    for spread in (0.01, 0.2, 0.7, 0.99, 1.5, 20.0):
        u, dof = u_and_degrees_of_mean([(1.0, None)] * 2, spread, 0.0)
        U = coverage_factor(np.inf if dof is None else dof) * u
        assert U * np.sqrt(2.0) == pytest.approx(max(coverage_factor(1.0) * spread, 2.0), rel=1e-4)


@pytest.mark.parametrize("run_to_run", [0.0, 1.0, 2.0, 30.0])
@pytest.mark.parametrize("launches", [2, 3, 5])
def test_u_of_a_mean_covers_as_stated(launches: int, run_to_run: float) -> None:
    """Launches with noise of 1 and a common error of 0.5: at least 95.45 % whatever the instability. Of 4000 cases the
    standard deviation is 0.33 %, and 0.02 six of them."""
    rng = np.random.default_rng(launches)
    inside = []
    for _ in range(4000):
        common = 0.5 * rng.standard_normal()
        values = np.hypot(1.0, run_to_run) * rng.standard_normal(launches) + common
        u, dof = u_and_degrees_of_mean([(1.0, None)] * launches, float(values.std(ddof=1)), 0.5)
        inside.append(abs(values.mean()) <= coverage_factor(np.inf if dof is None else dof) * u)
    assert np.mean(inside) > 0.9545 - 0.02
    assert run_to_run != 30.0 or np.mean(inside) == pytest.approx(0.9545, abs=0.02)


@pytest.mark.parametrize("launches", [2, 3, 5])
def test_a_common_error_does_not_make_u_of_a_mean_too_small(launches: int) -> None:
    """Instability of 1 with a common error of 0.3/√L: Welch and Satterthwaite alone cover 88 %, 93 % and 95 %.

    Of 10,000 cases the standard deviation is 0.2 %."""
    rng, common = np.random.default_rng(launches), 0.3 / np.sqrt(launches)
    inside = []
    for _ in range(10_000):
        values = rng.standard_normal(launches) + common * rng.standard_normal()
        spread = float(values.std(ddof=1))
        u, dof = u_and_degrees_of_mean([(1e-8, None)] * launches, spread, common)
        U = coverage_factor(np.inf if dof is None else dof) * u
        assert (1.0 - 1e-9) * coverage_factor(launches - 1.0) * spread / np.sqrt(launches) <= U
        inside.append(abs(values.mean()) <= U)
    assert np.mean(inside) > 0.9545 - 5.0 * 0.0021


# -------------------- what is said --------------------


def test_a_report_says_what_u_covers() -> None:
    """In the notes, which stand once, whatever limits there are."""
    hidden = Fit(chi_square=3.0, degrees=3.0, scatter=0.0, unit="m/s^2")
    said = reported(of_groups(accelerometers=hidden))
    assert said.count("no scatter of the accelerometers was detected, with 3 degrees of freedom to show one") == 1
    assert "may be undetected" not in reported(of_groups(accelerometers=scattered(5.0)))
    assert "which covers 95.45 %: k = 2 where u is known" in said


def test_a_scatter_that_may_be_there_unseen_is_told_as_large_as_it_could_be() -> None:
    """With this scatter the chi-square would be as small as it is, or smaller, in 5 % of all sessions."""
    (said,) = remarks(of_groups(accelerometers=replace(scattered(3.0, scatter=0.0), chi_square=2.0)))
    ratio = float(said.partition("up to ")[2].split()[0])
    assert stats.chi2.cdf(2.0 / (1.0 + ratio**2), 3.0) == pytest.approx(0.05, abs=0.002)
    assert remarks(of_groups(accelerometers=scattered(50.0, scatter=0.0))) == ()


def test_a_certificate_has_probability_and_factor_of_every_value() -> None:
    found = probabilities(certified(of_groups(accelerometers=scattered(5.0))))
    assert len(found) == len(calibration().parameters)
    for name, said in found.items():
        estimated = name.startswith("accel")
        assert said == ("0.9545", "2.65" if estimated else "2", "Student's t" if estimated else "normal")
