"""What ±U covers: Student's t where u was estimated, and what report, certificate and comparison say of it."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from calibrated import calibration
from scipy import stats
from test_ellipsoid import FOURTEEN, placed
from test_export import CERTIFICATE

from tumble.calibration.calibration_file import Calibration
from tumble.calibration.compare import compare_calibrations
from tumble.calibration.coverage import coverage, degrees_of_freedom, shortfalls
from tumble.calibration.from_readings import calibrate_table
from tumble.calibration.readings_table import ReadingsTable, nominal, read_table
from tumble.calibration.results import Launch
from tumble.estimation.estimate import Fit
from tumble.export import export_calibration
from tumble.registry.limits import parse_limits
from tumble.report.content import Source, document
from tumble.units import Array

NAMESPACES = {"si": "https://ptb.de/si", "dcc": "https://ptb.de/dcc"}
LIMITS = 'format = 1\n[periodic]\n"accel.bias" = "5 g"\n'


def scattered(degrees: float, scatter: float = 1e-4) -> Fit:
    """A group of residuals with a scatter that was estimated with so many degrees of freedom."""
    return Fit(chi_square=degrees, degrees=degrees, scatter=scatter, scatter_unit="m/s^2")


def of_groups(**fits: Fit) -> Calibration:
    """A calibration with these fits, an underscore in their names for a blank."""
    return replace(calibration(), fits={name.replace("_", " "): fit for name, fit in fits.items()})


def table(folder: Path, values: Array) -> ReadingsTable:
    path = folder / "r.csv"
    np.savetxt(path, values, delimiter=",", header="x,y,z", comments="", fmt="%.17g")
    return read_table(path)


def reported(made: Calibration) -> str:
    """All that the sections of a report say in sentences."""
    source = Source(file="c.json", sha256="0" * 64, calibration=made)
    return repr(document([source], parse_limits(LIMITS, None, "limits.toml")))


def certified(made: Calibration) -> ET.Element:
    return ET.fromstring(export_calibration(made, "dcc", certificate=CERTIFICATE).content)


def probabilities(root: ET.Element) -> dict[str, tuple[str, str]]:
    """Of every quantity that has a U: its coverage probability and its distribution."""
    found = {}
    for quantity in root.iterfind(".//dcc:quantity[@id]", NAMESPACES):
        expanded = quantity.find(".//si:expandedMU", NAMESPACES)
        assert expanded is not None
        said = [expanded.findtext(f"si:{key}", "", NAMESPACES) for key in ("coverageProbability", "distribution")]
        found[quantity.get("id", "")] = (said[0], said[1])
    return found


# -------------------- the probability --------------------


def test_five_degrees_cover_ninety_percent_and_known_noise_ninety_five() -> None:
    made = of_groups(accelerometers=scattered(5.0), gyro_rests=scattered(30.0, scatter=0.0))
    assert coverage(made, "accel.bias.x") == pytest.approx(2.0 * stats.t.cdf(2.0, 5) - 1.0, abs=1e-12)
    assert coverage(made, "accel.bias.x") == pytest.approx(0.898, abs=5e-4)
    assert coverage(made, "gyro.bias.x") == pytest.approx(0.9545, abs=5e-5)


def test_gyros_have_the_fewer_degrees_of_rests_and_turns_that_scatter() -> None:
    made = of_groups(
        accelerometers=scattered(3.0),
        gyro_rests=scattered(12.0),
        gyro_turns=scattered(8.0),
        noise_within_rests=scattered(2.0, scatter=0.0),
    )
    assert degrees_of_freedom(made, "gyro.scale.y") == 8.0
    quiet = replace(made, fits=dict(made.fits) | {"gyro turns": scattered(8.0, scatter=0.0)})
    assert degrees_of_freedom(quiet, "gyro.scale.y") == 12.0
    assert degrees_of_freedom(quiet, "accel.axis.yx") == 3.0


def test_the_error_of_a_table_is_within_u_as_often_as_stated(tmp_path: Path) -> None:
    """400 tables of 14 positions, 9 correlated parameters each: the part that is covered has a standard deviation of
    0.0076, so that 0.04 is five of them, and the 95.4 % of a normal distribution are seven away."""
    inside = []
    for seed in range(400):
        rng = np.random.default_rng(seed)
        values = placed(FOURTEEN, rng) + 1e-5 * rng.standard_normal((14, 3))
        own = table(tmp_path, values)
        made = calibrate_table(own, nominal(own, unit="g")).calibration
        inside.append([abs(p.value) <= 2.0 * (p.u or 0.0) for p in made.parameters])
        assert {round(coverage(made, p.name), 6) for p in made.parameters} == {0.898061}
    assert np.mean(inside) == pytest.approx(0.898, abs=0.04)


@pytest.mark.parametrize(("spread", "degrees"), [(3.0, 2.0), (0.1, 15.0), (None, 15.0)])
def test_the_mean_of_launches_is_known_from_what_its_u_is_made_of(spread: float | None, degrees: float) -> None:
    """Three launches: from the instability between them with two degrees of freedom, or, where that is small, from the
    launches' own five each."""
    one = calibration()
    launch = Launch(
        session="run",
        parameters=one.parameters,
        covariance=one.covariance,
        log_sha256="",
        fits={"accelerometers": scattered(5.0)},
    )
    parameters = tuple(replace(p, run_to_run=None if spread is None else spread * (p.u or 0.0)) for p in one.parameters)
    made = replace(one, parameters=parameters, launches=(launch,) * 3)
    assert degrees_of_freedom(made, "accel.bias.x") == pytest.approx(degrees)


# -------------------- what is said --------------------


def test_a_report_says_what_u_covers() -> None:
    estimated, known = reported(of_groups(accelerometers=scattered(5.0))), reported(calibration())
    said = (
        "the u of the accelerometers was estimated with 5 degrees of freedom: k = 2 covers at least 89.8 %, "
        "k = 2.57 at least 95 %"
    )
    assert estimated.count(said) == 2  # with the result, and with the verdict on the limits
    assert "was estimated with" not in known
    assert "k = 2, which covers 95.4 % where u is known" in known


def test_enough_degrees_of_freedom_need_no_word() -> None:
    assert shortfalls(of_groups(accelerometers=scattered(70.0))) == ()
    assert len(shortfalls(of_groups(accelerometers=scattered(50.0), gyro_turns=scattered(1.0)))) == 2


def test_a_certificate_has_the_probability_of_every_value() -> None:
    found = probabilities(certified(of_groups(accelerometers=scattered(5.0))))
    assert len(found) == len(calibration().parameters)
    for name, said in found.items():
        assert said == (("0.898", "Student's t") if name.startswith("accel") else ("0.954", "normal"))


def test_the_ellipsoid_of_a_certificate_is_that_of_an_estimated_covariance() -> None:
    """Hotelling: the squared radius is n F(0.95; n, ν), and χ²(0.95; n) where the covariance is known."""
    count = len(calibration().parameters)
    for made, square in (
        (calibration(), stats.chi2.ppf(0.95, count)),
        (of_groups(accelerometers=scattered(5.0)), count * stats.f.ppf(0.95, count, 5.0)),
    ):
        factor = certified(made).findtext(".//si:coverageFactorXMLList", "", NAMESPACES)
        assert float(factor) == pytest.approx(np.sqrt(square), abs=1e-6)


def test_a_comparison_says_what_the_u_of_both_covers() -> None:
    found = compare_calibrations(calibration(), of_groups(accelerometers=scattered(5.0)))
    assert [remark for remark in found.remarks if "89.8 %" in remark] == [
        "the second: the u of the accelerometers was estimated with 5 degrees of freedom: k = 2 covers at least "
        "89.8 %, k = 2.57 at least 95 %"
    ]
