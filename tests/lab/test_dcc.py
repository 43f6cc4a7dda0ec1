"""The Digital Calibration Certificate: valid against PTB's schema, read back with pydcc."""

from __future__ import annotations

import re
import sys
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from tests.support import ROOT
from tests.support.calibrated import HEXAD, calibration, of_device, with_fields
from tests.support.exports import CERTIFICATE
from tests.views.test_certificate import CERTIFICATE as EVERYTHING
from tests.views.test_certificate import files
from tumble.cli import main
from tumble.errors import InputError
from tumble.export import export_calibration
from tumble.lab.certificate import read_certificate
from tumble.lab.dcc import d_si
from tumble.recording.session import Circumstances, Site
from tumble.result.calibration import Calibration, read_calibration

NAMESPACES = {"dcc": "https://ptb.de/dcc", "si": "https://ptb.de/si"}
TOML = """
number = "2026-0042"
country = "DE"
begin = 2026-05-04
end = 2026-05-05
issued = 2026-05-07
procedure = "IMU-7, issue 3"
traceability = ["gravity: point 1234"]

[laboratory]
name = "Inertial laboratory"
code = "D-K-00000"
email = "lab@example.org"
street = "Bundesallee"
postcode = "38116"
city = "Braunschweig"
country = "DE"

[customer]
name = "A customer"
city = "Perm"
country = "RU"

[[person]]
name = "N. N."
role = "head of the laboratory"

[[person]]
name = "M. M."
"""
SITE = Site(latitude=0.99, height=270.0, gravity=9.81594, gravity_u=2e-6)


def content(made: Calibration) -> bytes:
    return export_calibration(made, "dcc", certificate=CERTIFICATE).content


def certificate_file(folder: Path, text: str = TOML) -> Path:
    path = folder / "certificate.toml"
    path.write_text(text, encoding="utf-8")
    return path


# -------------------- the schema --------------------


@pytest.fixture(scope="module")
def schema() -> Any:
    """Schema 3.3.0 of the DCC with D-SI 2.2.1."""
    import xmlschema

    folder = ROOT / "tests/support/schemas"
    locations = {
        "https://ptb.de/si": str(folder / "SI_Format.xsd"),
        "http://qudt.org/vocab/": str(folder / "qudt.xsd"),
        "http://www.w3.org/2000/09/xmldsig#": str(folder / "xmldsig-core-schema.xsd"),
    }
    return xmlschema.XMLSchema(str(folder / "dcc.xsd"), locations=locations, allow="local")


@pytest.mark.parametrize(
    "made",
    [
        calibration(),
        with_fields(calibration(), site=SITE),
        calibration(accel=HEXAD),
        of_device(calibration(with_gyro=False), model=None),
        replace(calibration(), covariance=None, parameters=tuple(replace(p, u=None) for p in calibration().parameters)),
        of_device(calibration(), serial="<A> & \u0007 0007 "),
    ],
    ids=["triads", "with gravity", "six sensors", "accelerometers", "no uncertainties", "odd serial"],
)
def test_the_certificate_is_valid_against_the_published_schema(schema: Any, made: Calibration) -> None:
    errors = [str(error.reason) for error in schema.iter_errors(content(made).decode(), use_location_hints=False)]
    assert errors == []


def test_traceability_names_standards_and_no_table(tmp_path: Path) -> None:
    stated = Circumstances(equipment=("turntable T-12", "gravity: gravimeter 7"))
    made = with_fields(calibration(), circumstances=stated)
    root = ET.fromstring(export_calibration(made, "dcc", certificate=certificate_file(tmp_path)).content)
    equipment = root.findall(".//dcc:measuringEquipment", NAMESPACES)
    assert [each.get("refType") for each in equipment] == [None, "basic_measurementStandard"]
    traced = root.find(".//dcc:statement[@refType='basic_metrologicallyTraceableToSI']/dcc:declaration", NAMESPACES)
    assert traced is not None
    assert "".join(traced.itertext()) == "gravity: point 1234"


def test_every_entry_of_the_certificate_file_is_valid(schema: Any, tmp_path: Path) -> None:
    made = export_calibration(calibration(), "dcc", certificate=read_certificate(certificate_file(tmp_path)))
    assert schema.is_valid(made.content.decode(), use_location_hints=False)


def test_the_schema_sees_what_is_wrong(schema: Any) -> None:
    """Otherwise the tests above prove nothing."""
    text = content(calibration()).decode()
    for old, new in (("<si:value>", "<si:value>x"), ('schemaVersion="3.3.0"', 'schemaVersion="3.2.0"')):
        assert text.count(old)
        assert not schema.is_valid(text.replace(old, new, 1), use_location_hints=False)


# -------------------- an independent reader --------------------


@pytest.fixture
def reader(monkeypatch: pytest.MonkeyPatch) -> Any:
    """pydcc, without the schemas that it would fetch from the network into the home folder, and without the library
    that checks signatures, which there are none of: it does not know versions of OpenSSL from 3.0.10 on."""
    unused = ModuleType("certvalidator")
    for name in ("CertificateValidator", "ValidationContext", "errors"):
        setattr(unused, name, None)
    monkeypatch.setitem(sys.modules, "certvalidator", unused)
    import dcc.dcc as pydcc  # type: ignore[import-untyped]

    monkeypatch.setattr(pydcc, "DCCXMLValidator", lambda: None)
    return lambda made: pydcc.DCC(byte_array=content(made))


def test_pydcc_reads_every_parameter_back(reader: Any) -> None:
    made = calibration()
    found = reader(made)
    assert found.is_loaded()
    assert found.uid() == "2026-0042"
    assert found.version() == "3.3.0"
    assert found.calibration_laboratory_name() == "Inertial laboratory"
    assert found.calibration_date().date() == CERTIFICATE.end
    assert found.item_id()["identifications"]["identification"]["value"] == "A-0007"
    results = {name.split()[-1]: entry for name, entry in found.get_calibration_results("name", "en")}
    for p in made.parameters:
        real = results[p.name]["real"]
        expanded = real["measurementUncertaintyUnivariate"]["expandedMU"]
        assert p.u is not None
        assert float(real["value"]) == pytest.approx(p.value, abs=0.005 * p.u)
        assert float(expanded["valueExpandedMU"]) == pytest.approx(2.0 * p.u, rel=0.005)
        assert len(expanded["valueExpandedMU"].partition("e")[0].strip("0.").replace(".", "")) <= 3
        assert (expanded["coverageFactor"], expanded["coverageProbability"]) == ("2", "0.9545")


def test_pydcc_reads_models_that_give_the_true_vectors(reader: Any) -> None:
    made = calibration(accel=HEXAD)
    lists = {
        name: entry["realListXMLList"]
        for name, entry in reader(made).get_calibration_results("name", "en")
        if "realListXMLList" in entry
    }
    for kind, title, n in (("accel", "accelerometers", 6), ("gyro", "gyros", 3)):
        model = made.accel if kind == "accel" else made.gyro
        assert model is not None
        matrix, bias, reading, true = (
            np.array(
                next(entry["valueXMLList"] for name, entry in lists.items() if f"{title}: {what}" in name).split(),
                float,
            )
            for what in ("matrix M", "bias b", "example: reading r", "example: true vector t")
        )
        np.testing.assert_array_equal(matrix.reshape(n, 3), model.matrix)
        np.testing.assert_array_equal(bias, model.bias)
        np.testing.assert_allclose(np.linalg.lstsq(matrix.reshape(n, 3), reading - bias)[0], true, atol=1e-12)


# -------------------- units, covariance, gravity --------------------


def test_a_parameter_has_words_degrees_of_freedom_and_limits_in_its_unit(tmp_path: Path) -> None:
    made = calibration()
    made = replace(made, parameters=tuple(replace(p, dof=7.25) for p in made.parameters))
    (tmp_path / "limits.toml").write_text('format = 1\n[periodic]\n"accel.scale" = "65 ppm"\n', "utf-8")
    path = certificate_file(tmp_path, 'limits = "limits.toml"\nagreed = "order 4711"\n' + TOML)
    text = export_calibration(made, "dcc", certificate=read_certificate(path)).content.decode()
    assert "X accelerometer, scale-factor error; u was estimated with 7.25 degrees of freedom" in text
    assert "limits -65 to 65 ppm" in text
    root = ET.fromstring(text)
    factors = {e.text for e in root.findall(".//dcc:quantity/si:real//si:coverageFactor", NAMESPACES)}
    assert factors == {"2.41"}  # of Student's t
    for value in root.findall(".//si:real/si:value", NAMESPACES):
        assert len((value.text or "").partition("e")[0].lstrip("-0.").replace(".", "")) <= 12


def test_a_text_stands_as_it_was_written() -> None:
    text = content(of_device(calibration(), serial="A\\7*/x", model="B\x1b\\C")).decode()
    assert "A\\7*/x" in text
    assert "B\N{REPLACEMENT CHARACTER}\\C" in text


def test_units_are_those_of_d_si() -> None:
    assert d_si("m/s^2") == r"\metre\second\tothe{-2}"
    assert d_si("rad/s") == r"\radian\second\tothe{-1}"
    assert d_si("1") == r"\one"
    assert d_si("rad*s/m") == r"\radian\second\metre\tothe{-1}"


# -------------------- what ISO/IEC 17025 asks for --------------------


def full(folder: Path) -> bytes:
    """A certificate with everything that one may have, of a laboratory in a file of its own."""
    entries = EVERYTHING.replace("state =", 'replaces = "2026-0041"\nremarks = ["a remark"]\nstate =')
    made = with_fields(read_calibration(files(folder, certificate=entries)), site=SITE)
    return export_calibration(made, "dcc", certificate=read_certificate(folder / "certificate.toml")).content


def test_a_certificate_with_everything_is_valid_and_says_it(schema: Any, tmp_path: Path) -> None:
    text = full(tmp_path).decode()
    assert [str(error.reason) for error in schema.iter_errors(text, use_location_hints=False)] == []
    root = ET.fromstring(text)

    def said(path: str) -> list[str]:
        return [(element.text or "").strip() for element in root.findall(path, NAMESPACES)]

    assert said(".//dcc:beginPerformanceDate") == ["2025-03-04"]  # of the recording, not of computing
    assert (said(".//dcc:receiptDate"), said(".//dcc:issueDate")) == (["2025-03-01"], ["2025-03-07"])
    assert said(".//dcc:replacedUniqueIdentifier") == ["2026-0041"]
    assert said(".//dcc:measuringEquipment/dcc:name/dcc:content") == ["turntable T-12, no. 7"]
    units = said(".//dcc:influenceCondition//si:unit")
    assert units == [r"\metre\second\tothe{-2}", r"\degreecelsius", r"\percent", r"\hecto\pascal"]
    types = {element.get("refType") for element in root.iter() if element.get("refType")}
    assert {"basic_measuredValue", "basic_conformity", "basic_metrologicallyTraceableToSI"} < types
    assert any("point 1234" in each for each in said(".//dcc:statement/dcc:declaration/dcc:content"))
    assert any("relates only to the item" in each for each in said(".//dcc:statement/dcc:declaration/dcc:content"))
    assert said(".//dcc:measurementResult/dcc:measurementMetaData/dcc:metaData/dcc:conformity") == ["conditionalPass"]
    assert said(".//dcc:quantity/dcc:measurementMetaData/dcc:metaData/dcc:conformity") == ["conditionalPass"]
    assert any("order 4711" in each for each in said(".//dcc:metaData/dcc:description/dcc:content"))
    assert said(".//dcc:item/dcc:description/dcc:content") == ["as left: calibrated after adjustment"]


def test_a_certificate_without_any_date_is_refused(tmp_path: Path) -> None:
    undated = certificate_file(tmp_path, TOML.replace("begin = 2026-05-04\nend = 2026-05-05\n", ""))
    with pytest.raises(InputError, match="expected the day of the calibration, found none"):
        export_calibration(calibration(), "dcc", certificate=undated)


# -------------------- the certificate file --------------------


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('number = "2026-0042"', "", "number: expected this key, found none"),
        (
            'country = "DE"',
            'country = "Germany"',
            "country: expected two capital letters of ISO 3166-1, such as 'DE', found",
        ),
        ("end = 2026-05-05", "end = 2026-05-03", "expected a day not before the begin, 2026-05-04, found 2026-05-03"),
        ("[[person]]", "[[persona]]", "unknown key 'persona' at the top level; did you mean 'person'?"),
        ("begin =", "begin", "expected TOML"),
        ("end = 2026-05-05", 'state = "adjusted"', "state: expected 'as-found', 'as-left' or 'unchanged', found"),
        ("end = 2026-05-05", 'as_found = "before.json"', 'expected only with state = "as-left", found'),
        ('code = "D-K-00000"', 'mark = "x"', "unknown key 'mark' in [laboratory]"),
    ],
)
def test_a_fault_of_the_certificate_file_is_named_in_one_line(tmp_path: Path, old: str, new: str, said: str) -> None:
    path = certificate_file(tmp_path, TOML.replace(old, new))
    with pytest.raises(InputError, match=re.escape(said)) as raised:
        read_certificate(path)
    assert str(raised.value).startswith(f"{path}: ")
    assert "\n" not in str(raised.value)


def test_the_command_takes_the_certificate_file(tmp_path: Path) -> None:
    calibration().write(tmp_path / "c.json")
    words = ["export", str(tmp_path / "c.json"), "--to", "dcc", "-o", str(tmp_path / "c.xml")]
    assert CliRunner().invoke(main, words).exit_code == 2
    result = CliRunner().invoke(main, [*words, "--certificate", str(certificate_file(tmp_path))])
    assert result.exit_code == 0, result.stderr
    assert "neither signed nor sealed" in result.stderr
    persons = ET.parse(tmp_path / "c.xml").getroot().findall(".//dcc:respPerson", NAMESPACES)
    assert [p.findtext("dcc:mainSigner", "", NAMESPACES) for p in persons] == ["true", "false"]
