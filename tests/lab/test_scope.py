"""The scope of an accreditation: no U below the capability, nowhere; what is outside is said to be."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.calibrated import calibration, warmed, with_fields
from tests.support.pages import Page
from tests.views.test_certificate import CERTIFICATE, LABORATORY, RECORDED, files
from tumble.errors import InputError
from tumble.export import export_calibration
from tumble.lab.certificate import read_certificate
from tumble.lab.report import write_certificate
from tumble.lab.scope import CMC, OUTSIDE, Capability, statement_of_scope, within_scope
from tumble.result.coverage import expanded
from tumble.result.temperature_curves import changing, curve, measured_range
from tumble.units import G_STANDARD

MILLI_G = 1e-3 * G_STANDARD
SCOPE = """
[[laboratory.scope]]
quantity = "accel.bias"
cmc = "1 mg"

[[laboratory.scope]]
quantity = "accel.bias.y"
max = "-1 g"
cmc = "1 mg"

[[laboratory.scope]]
quantity = "gyro.scale"
cmc = "1 ppm"
"""


def test_the_capability_stands_where_u_is_smaller_and_nothing_else_changes() -> None:
    made = calibration()
    scope = (Capability(quantity="accel.bias", cmc="1 mg"), Capability(quantity="gyro.scale", cmc="1 ppm"))
    stated, said = within_scope(made, scope)
    for before, after in zip(made.parameters, stated.parameters, strict=True):
        U, U_stated = expanded(before), expanded(after)
        assert U is not None
        assert after.value == before.value
        if before.name.startswith("accel.bias"):
            assert (U < MILLI_G, said[before.name]) == (True, CMC)
            assert U_stated == pytest.approx(MILLI_G)
            assert after.k == 2.0
        else:
            assert after == before
            assert said.get(before.name) == (None if before.name.startswith("gyro.scale") else OUTSIDE)
    assert stated.covariance is not None
    assert np.sqrt(np.diag(stated.covariance)) == pytest.approx([p.u for p in stated.parameters])
    assert np.all(np.linalg.eigvalsh(stated.covariance) > 0.0)
    assert within_scope(made, ()) == (made, {})


@given(st.floats(1e-3, 10.0))
def test_u_is_nowhere_below_the_capability_over_temperature(mg: float) -> None:
    made = warmed(calibration())
    stated, _ = within_scope(made, (Capability(quantity="accel.bias", cmc=f"{mg!r} mg"),))
    measured = measured_range(stated)
    assert measured is not None
    for name in (name for name in changing(stated) if name.startswith("accel.bias")):
        U = curve(stated, name, measured.temperatures(101)).expanded
        assert U is not None
        assert U.min() >= mg * MILLI_G * (1.0 - 1e-3)  # of a parabola between the temperatures that are looked at


def test_a_value_outside_the_range_of_an_entry_is_not_accredited() -> None:
    made = calibration()
    entry = Capability(quantity="accel.bias.x", max=f"{(made['accel.bias.x'].value - 1e-3) / MILLI_G!r} mg", cmc="1 mg")
    stated, said = within_scope(made, (entry,))
    assert said["accel.bias.x"] == OUTSIDE
    assert stated["accel.bias.x"] == made["accel.bias.x"]


def certified(folder: Path, scope: str = SCOPE, at: float = 0.5) -> Path:
    """A folder with a certificate whose laboratory has a scope; its limit is `at` times U above the first value."""
    file = files(folder, at=at, certificate=CERTIFICATE.replace('state = "as-left"\nas_found = "before.json"\n', ""))
    (folder / "lab" / "laboratory.toml").write_text(LABORATORY.replace("[[person]]", f"{scope}\n[[person]]"), "utf-8")
    return file


def test_certificate_verdict_and_dcc_are_by_the_capability(tmp_path: Path) -> None:
    """The first value is inside its limit by twice its U: that passes, and by the larger capability it does not."""
    file = certified(tmp_path, at=2.0)
    reasons = write_certificate(file, tmp_path / "c.html", tmp_path / "certificate.toml")
    assert reasons == ["c.json: periodic check: conditional pass: accel.bias.x"]
    page = Page.of(tmp_path / "c.html")
    assert statement_of_scope({"a": CMC, "b": OUTSIDE}) in page.whole
    assert CMC not in statement_of_scope({"b": OUTSIDE})
    assert statement_of_scope({}) == "What is not in the table of results is outside the scope"
    rows = {row["parameter"]: row for row in page.table("parameter", "U (95 %)", "scope")}
    assert [rows[name]["scope"] for name in ("accel.bias.x", "accel.bias.y", "gyro.scale.x", "accel.scale.x")] == [
        CMC,
        CMC,
        "",
        OUTSIDE,
    ]
    assert (rows["accel.bias.x"]["U (95 %)"], rows["accel.bias.x"]["unit"], rows["accel.bias.x"]["k"]) == (
        "1.0",
        "mg",
        "2.00",
    )
    exported = export_calibration(file, "dcc", certificate=tmp_path / "certificate.toml").content.decode()
    assert statement_of_scope({"a": CMC, "b": OUTSIDE}) in exported
    assert float(re.findall(r"<si:valueExpandedMU>(.*?)<", exported)[1]) == pytest.approx(MILLI_G, rel=1e-2)
    without = tmp_path / "without"
    without.mkdir()
    assert write_certificate(certified(without, "", at=2.0), without / "c.html", without / "certificate.toml") == []


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (('"accel.bias"', '"accel.bais"'), 'laboratory.scope[1].quantity: expected a name such as "accel.bias"'),
        (('cmc = "1 ppm"', 'cmc = "0 ppm"'), "cmc: expected more than 0, found '0 ppm'"),
        (('cmc = "1 ppm"', 'cmc = "1 mg"'), "found '1 mg'"),
        (('max = "-1 g"', 'max = "-1 g"\nmin = "2 g"'), "min: expected less than max, found '2 g' and '-1 g'"),
    ],
)
def test_a_scope_that_cannot_be_is_said_in_one_line(tmp_path: Path, change: tuple[str, str], said: str) -> None:
    certified(tmp_path, SCOPE.replace(*change))
    with pytest.raises(InputError, match=re.escape(said)) as caught:
        read_certificate(tmp_path / "certificate.toml")
    assert "\n" not in str(caught.value)


def test_the_budget_has_the_capability_as_a_source_of_its_own() -> None:
    from tumble.result.parts import SourceContributions
    from tumble.result.uncertainty_budget import shares_by_group

    made = with_fields(calibration(), circumstances=RECORDED)
    noise = SourceContributions(
        name="fit", words="fit", type="A", contributions={p.name: p.u for p in made.parameters if p.u}
    )
    stated, _ = within_scope(with_fields(made, budget=(noise,)), (Capability(quantity="accel.bias", cmc="1 mg"),))
    assert [source.name for source in stated.evidence.budget] == ["fit", "capability"]
    u = np.array([p.u for p in stated.parameters])
    parts = np.array(
        [[source.contributions.get(p.name, 0.0) for p in stated.parameters] for source in stated.evidence.budget]
    )
    assert np.sqrt((parts**2).sum(axis=0)) == pytest.approx(u)
    assert shares_by_group(stated)["accel.bias"].sum() == pytest.approx(1.0)
