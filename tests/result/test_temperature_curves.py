"""Parameters over temperature: the curve and its U, the measured range, and the section of the report."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.support.calibrated import HEXAD, calibration, warmed, with_fields
from tumble.result.calibration import read_calibration
from tumble.result.parts import Launch, Parameter, coverage_factor
from tumble.result.temperature_curves import (
    measured_range,
    rests_with_temperature,
    temperature_curve,
    thermal_parameters,
)
from tumble.units import G_STANDARD
from tumble.views.blocks import Figure, Table
from tumble.views.report.document import ReportedFile, report_of
from tumble.views.report.over_temperature import section


def test_the_model_at_a_temperature_corrects_as_the_calibration_does_there() -> None:
    """Slopes alone, in three and in six sensors, against `Calibration.apply` with a temperature."""
    rng = np.random.default_rng(1)
    six = HEXAD / np.linalg.norm(HEXAD, axis=1)[:, None]
    for axes in (None, six):
        made = warmed(calibration(accel=axes, gyro=axes), curved=False)
        true = rng.normal(size=(50, 3))
        for celsius in (-10.0, 44.0):
            accel, gyro = (made.compensator.model(kind, celsius).predict(true) for kind in ("accel", "gyro"))
            force, rate = made.apply(accel, gyro, temperature=celsius + 273.15)
            assert rate is not None
            np.testing.assert_allclose(force, true, atol=1e-12)
            np.testing.assert_allclose(rate, true, atol=1e-12)


def test_u_of_a_curve_has_the_degrees_of_freedom_of_the_sum() -> None:
    """Welch and Satterthwaite, but no less than a single term: at the reference the k of the value, far from it that of
    the highest power."""
    made = warmed(calibration())
    degrees = {"accel.bias.x": 20.0, "accel.bias.x.t1": 3.0, "accel.bias.x.t2": None}
    made = replace(made, parameters=tuple(replace(p, dof=degrees.get(p.name)) for p in made.parameters))
    assert made.reference_temperature is not None
    u = {name: made[name].u or 0.0 for name in degrees}
    for warmer in (0.0, 10.0, 1e6):
        found = temperature_curve(made, "accel.bias.x", np.array([made.reference_temperature + warmer]))
        parts = [u["accel.bias.x"], u["accel.bias.x.t1"] * warmer, u["accel.bias.x.t2"] * warmer**2]
        combined = np.sqrt(np.sum(np.square(parts)))
        nu = combined**4 / (parts[0] ** 4 / 20.0 + parts[1] ** 4 / 3.0)
        assert found.expanded is not None
        terms = (coverage_factor(20.0) * parts[0], coverage_factor(3.0) * parts[1])
        assert found.expanded[0] == pytest.approx(max(coverage_factor(float(nu)) * combined, *terms), rel=1e-6)


def test_more_terms_never_make_u_smaller_than_that_of_one_of_them() -> None:
    """A bias of three launches, with two degrees of freedom, and a slope that is well known."""
    made = warmed(calibration())
    made = replace(
        made, parameters=tuple(replace(p, dof=2.0 if "." not in p.name[11:] else None) for p in made.parameters)
    )
    assert made.reference_temperature is not None
    u = made["accel.bias.x"].u or 0.0
    ratios = np.array([0.0, 0.3, 1.0, 3.0])
    celsius = made.reference_temperature + ratios * u / (made["accel.bias.x.t1"].u or 1.0)
    found = temperature_curve(made, "accel.bias.x", celsius)
    assert found.expanded is not None
    assert np.all(found.expanded >= coverage_factor(2.0) * u * (1.0 - 1e-9))


def test_a_curve_of_too_few_degrees_of_freedom_has_no_u() -> None:
    """As a single parameter has none: t of half a degree of freedom is 199."""
    made = warmed(calibration())
    assert made.reference_temperature is not None
    for degrees, stated in ((0.5, False), (1.5, True)):
        few = replace(made, parameters=tuple(replace(p, dof=degrees) for p in made.parameters))
        found = temperature_curve(few, "accel.bias.x", np.array([made.reference_temperature]))
        assert (found.expanded is not None) == stated
        assert np.isfinite(found.value).all()


def test_coefficients_against_each_other_leave_u_its_degrees_of_freedom() -> None:
    """Where the sum is known a thousand times better than its parts, k is at most that of the part with fewest."""
    made = warmed(calibration(), curved=False)
    place = {p.name: i for i, p in enumerate(made.parameters)}
    i, j = place["accel.bias.x"], place["accel.bias.x.t1"]
    reference = made.reference_temperature
    assert made.covariance is not None
    assert reference is not None
    covariance, u = made.covariance.copy(), float(np.sqrt(made.covariance[i, i]))
    covariance[j, j] = (0.1 * u) ** 2
    covariance[i, j] = covariance[j, i] = -0.999999 * 0.1 * u**2
    parameters = tuple(replace(p, dof=12.0) if p.name.startswith("accel.bias.x") else p for p in made.parameters)
    made = replace(made, parameters=parameters, covariance=covariance)
    found = temperature_curve(made, "accel.bias.x", np.array([reference + 10.0]))
    assert found.expanded is not None
    assert found.expanded[0] == pytest.approx(coverage_factor(12.0) * u * np.sqrt(2e-6), rel=1e-3)


def test_the_range_is_that_of_the_rests_of_all_launches() -> None:
    made = warmed(calibration())
    empty = Launch(session="a", parameters=(), covariance=None, log_sha256="", rests=made.evidence.rests[:2])
    launches = with_fields(made, rests=(), launches=(empty, replace(empty, rests=made.evidence.rests[3:])))
    assert measured_range(launches) == (-18.5, 57.25)
    assert len(rests_with_temperature(launches)) == 3
    assert measured_range(calibration()) is None
    assert thermal_parameters(calibration()) == ()
    assert measured_range(warmed(calibration(), low=22.0, high=22.01)) is None


def test_the_range_is_in_the_file_of_launches_and_survives_where_rests_do_not(tmp_path: Path) -> None:
    made = warmed(calibration())
    first = Launch(session="a", parameters=(), covariance=None, log_sha256="", rests=made.evidence.rests[:2])
    launches = with_fields(made, rests=(), launches=(first, replace(first, session="b", rests=made.evidence.rests[2:])))
    launches.write(tmp_path / "launches.json")
    kept = json.loads((tmp_path / "launches.json").read_text())["temperature"]["range"]
    assert kept == list(made.temperature_range or ())
    updated = with_fields(made, rests=(), temperature=replace(made.temperature, range=made.temperature_range))
    updated.write(tmp_path / "updated.json")
    assert measured_range(read_calibration(tmp_path / "updated.json")) == measured_range(made)


def test_what_changes_with_temperature_survives_the_file(tmp_path: Path) -> None:
    made = warmed(calibration())
    made.write(tmp_path / "c.json")
    back = read_calibration(tmp_path / "c.json")
    assert thermal_parameters(back) == thermal_parameters(made)
    assert len(thermal_parameters(back)) == 12
    assert measured_range(back) == measured_range(made)


def test_the_report_has_every_parameter_at_both_ends_and_at_the_reference() -> None:
    made = warmed(calibration())
    part = report_of([ReportedFile(file="c.json", sha256="0", calibration=made)]).parts[0]
    found = next(each for each in part.sections if each.title == "Over temperature")
    table = next(block for block in found.blocks if isinstance(block, Table))
    assert table.columns == ("parameter", "at −18.5 °C", "U", "at 19.4 °C", "U", "at 57.2 °C", "U", "unit")
    assert [row[0] for row in table.rows] == list(thermal_parameters(made))
    row = next(row for row in table.rows if row[0] == "accel.bias.y")
    own = temperature_curve(made, "accel.bias.y", np.array([-18.5, 57.25]))
    assert own.expanded is not None
    assert row[-1] == "mg"
    for cell, value in ((row[1], own.value[0]), (row[2], own.expanded[0]), (row[5], own.value[1])):
        assert float(cell.replace("−", "-")) == pytest.approx(value / (1e-3 * G_STANDARD), abs=0.051)


def test_each_coefficient_is_in_one_table_with_its_u_and_its_number_in_si() -> None:
    """Coefficients of temperature in the result, other further parameters in their section."""
    more = Parameter(name="accel.cubic.x", value=2e-7, u=1e-7, unit="s^4/m^2")
    made = warmed(calibration())
    made = replace(made, parameters=(*made.parameters, more), covariance=None)
    sections = report_of([ReportedFile(file="c.json", sha256="0", calibration=made)]).parts[0].sections
    tables = {
        each.title: [block for block in each.blocks if isinstance(block, Table) and "value, SI" in block.columns]
        for each in sections
    }
    shown = {title: [row[0] for table in found for row in table.rows] for title, found in tables.items() if found}
    slopes = [p.name for p in made.parameters if p.name.endswith((".t1", ".t2"))]
    assert shown == {"Result": slopes, "Beyond bias, scale factors and axes": ["accel.cubic.x"]}
    (table,) = tables["Result"]
    row = dict(zip(table.columns, table.rows[0], strict=True))
    assert float(row["value, SI"].replace("−", "-")) == pytest.approx(made[slopes[0]].value, rel=1e-7)
    assert (row["unit"], row["SI unit"]) == ("µg/°C", "m/s²/K")
    assert float(row["U (95 %)"]) == pytest.approx(2.0 * (made[slopes[0]].u or 0.0) / G_STANDARD * 1e6, rel=0.05)


def test_the_picture_has_a_panel_for_each_group_and_marks_what_was_not_measured() -> None:
    for made, panels in ((warmed(calibration()), 4), (warmed(calibration(with_gyro=False)), 2)):
        found = section(made, "t")
        assert found is not None
        figure = next(block for block in found.blocks if isinstance(block, Figure))
        assert "Dashed, on grey: not measured" in figure.caption
        assert figure.svg.count("stroke-dasharray: 2.4,1.6") == panels * 3 * 2  # three sensors, two sides


def test_without_a_thermometer_or_without_covariance_the_report_holds_what_there_is() -> None:
    assert section(calibration(), "t") is None
    assert section(warmed(calibration(), low=20.0, high=20.0), "t") is None
    found = section(replace(warmed(calibration()), covariance=None), "t")
    assert found is not None
    table = next(block for block in found.blocks if isinstance(block, Table))
    assert {row[2] for row in table.rows} == {""}
