"""A Digital Calibration Certificate: the XML of PTB's DCC, schema 3.3.0, with quantities in D-SI 2.2.1.

Every parameter of accelerometers and gyros is a quantity with its expanded uncertainty U = k u, of the
probability 0.9545, with its own coverage factor k: Student's t where u was estimated (`coverage`). A list of all of
them has their covariance matrix, the matrices and biases of the model equation follow, and an example worked with it:

    reading = matrix · true + bias,    true = matrix⁻¹ (reading − bias)

The file is neither signed nor sealed.

Source: PTB, DCC schema 3.3.0 and D-SI schema 2.2.1.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import floor, log10, sqrt
from pathlib import Path
from typing import Any

import numpy as np
import scipy

from tumble.documents import plain
from tumble.errors import InputError
from tumble.export import Target
from tumble.export.exported import Exported, models, not_held, origin, shown
from tumble.files import FilePath
from tumble.lab.certificate import RELATES, STATES, Certificate, Party, check_certificate, judged_by, read_certificate
from tumble.lab.conformity import RISK, RULE, Verdict, verdicts
from tumble.lab.scope import statement_of_scope, within_scope
from tumble.result.applied_correction import linear_example
from tumble.result.calibration import Calibration, read_calibration
from tumble.result.coverage import PROBABILITY, degrees_of_freedom
from tumble.result.further import described
from tumble.result.parts import FEWEST_DEGREES, Parameter, stated_factor
from tumble.sensors.model import UNITS, SensorKind, SensorModel
from tumble.sensors.parameters import sensor_kind, shown_in
from tumble.units import Array

VERSION = "3.3.0"
_DCC, _XSI = "https://ptb.de/dcc", "http://www.w3.org/2001/XMLSchema-instance"
_NAMESPACES = {"dcc": _DCC, "si": "https://ptb.de/si"}
REGION_PROBABILITY = 0.95
"""What the ellipsoid of all parameters covers."""

LOSSES = (
    "the file is neither signed nor sealed: sign it with the laboratory's tools",
    "rests, turns, launches and iterations of the calibration have no place in this file",
)

_UNITS = {"m": "metre", "s": "second", "rad": "radian", "K": "kelvin", "degC": "degreecelsius", "%": "percent"}
_UNITS |= {"hPa": "hecto\\pascal"}
_FACTOR = re.compile(r"(?P<over>[*/]|^)(?P<unit>[A-Za-z%]+|1)(?:\^(?P<power>\d))?")
_CONFORMITY = {"conditional pass": "conditionalPass", "conditional fail": "conditionalFail"}
_CONFORMITY |= {result: result for result in ("pass", "fail")}
"""Outcomes as the schema has them; it has none for what is undecided."""

U_DIGITS = 3
"""Digits of u and U: two that matter, and one so that rounding adds nothing."""
_COVARIANCE_DIGITS = 10
"""Of covariances, so that a matrix of strong correlations stays positive."""

_TITLES = {"accel": "accelerometers", "gyro": "gyros"}


def d_si(*units: str) -> str:
    """The product of units as D-SI writes it: d_si("m/s^2") is \\metre\\second\\tothe{-2}."""
    powers: Counter[str] = Counter()
    for text in units:
        factors = list(_FACTOR.finditer(text))
        translated = all(factor["unit"] in (*_UNITS, "1") for factor in factors)
        if not translated or "".join(factor[0] for factor in factors) != text or not text:
            raise InputError(f"calibration: expected the SI unit of a parameter, found {text!r}; calibrate again")
        for factor in (each for each in factors if each["unit"] != "1"):
            power = int(factor["power"] or 1)
            powers[_UNITS[factor["unit"]]] += -power if factor["over"] == "/" else power
    parts = [f"\\{name}" + ("" if power == 1 else f"\\tothe{{{power}}}") for name, power in powers.items() if power]
    return "".join(parts) or "\\one"


def dcc(calibration: Calibration, *, certificate: Certificate | FilePath) -> Exported:
    """The XML file of a calibration with the administrative data of its certificate, or of its file."""
    if not isinstance(certificate, Certificate):
        certificate = read_certificate(Path(certificate))
    by_kind = models(calibration)
    calibration, scope = within_scope(calibration, certificate.laboratory.scope)
    check_certificate(
        certificate, calibration, None if certificate.as_found is None else read_calibration(certificate.as_found)
    )
    limits = judged_by(certificate)
    judged = () if limits is None else tuple(verdicts(calibration, limits))
    losses = (*LOSSES, *not_held(calibration))
    inertial = [i for i, p in enumerate(calibration.parameters) if sensor_kind(p.name) != "mag"]
    calibration = replace(
        calibration,
        parameters=tuple(calibration.parameters[i] for i in inertial),
        covariance=None if calibration.covariance is None else calibration.covariance[np.ix_(inertial, inertial)],
    )
    for prefix, address in _NAMESPACES.items():
        ET.register_namespace(prefix, address)
    root = ET.Element(f"{{{_DCC}}}digitalCalibrationCertificate", {"schemaVersion": VERSION})
    root.set(f"{{{_XSI}}}schemaLocation", f"{_DCC} {_DCC}/v{VERSION}/dcc.xsd")
    _add(root, "administrativeData", _administrative(calibration, certificate, scope))
    _add(root, "measurementResults", {"measurementResult": _results(calibration, certificate, by_kind, judged, scope)})
    ET.indent(root)
    return Exported(content=ET.tostring(root, encoding="utf-8", xml_declaration=True) + b"\n", losses=losses)


TARGET = Target(write=dcc, takes=("certificate",), needs=("certificate",), ending=".xml")
"""What `tumble export --to dcc` writes."""


def _add(parent: ET.Element, name: str, content: Any) -> None:
    """Add an element with its content: a text; by name what is in it, "@name" an attribute, "si:name" of D-SI; one
    element for each of a list; none at all for None."""
    if content is None:
        return
    for each in content if isinstance(content, list) else [content]:
        prefix, _, local = name.rpartition(":")
        element = ET.SubElement(parent, f"{{{_NAMESPACES[prefix or 'dcc']}}}{local}")
        if isinstance(each, str):
            element.text = each
            continue
        for part, value in each.items():
            if part.startswith("@"):
                element.attrib.update({} if value is None else {part[1:]: value})
            elif part == "":
                element.text = value
            else:
                _add(element, part, value)


def _line(text: str) -> str:
    """A text on one line, without characters that XML does not have."""
    return " ".join(plain(text).split())


def _text(text: str | None) -> dict[str, Any] | None:
    """A text in English; nothing where there is none."""
    return None if text is None else {"content": {"@lang": "en", "": _line(text)}}


# -------------------- who, what, when --------------------


def _administrative(calibration: Calibration, certificate: Certificate, scope: Mapping[str, str]) -> dict[str, Any]:
    name, _, release = (calibration.provenance.software or "tumble 0").partition(" ")
    begin, end = certificate.days(calibration)
    replaced = {"typeOfChange": "substituted", "replacedUniqueIdentifier": certificate.replaces}
    core = {
        "countryCodeISO3166_1": certificate.country,
        "usedLangCodeISO639_1": "en",
        "mandatoryLangCodeISO639_1": "en",
        "uniqueIdentifier": certificate.number,
        "receiptDate": None if certificate.received is None else certificate.received.isoformat(),
        "beginPerformanceDate": begin.isoformat(),
        "endPerformanceDate": end.isoformat(),
        "performanceLocation": certificate.place,
        "issueDate": None if certificate.issued is None else certificate.issued.isoformat(),
        "reportAmendedSubstituted": None if certificate.replaces is None else replaced,
    }
    serial = {"issuer": "manufacturer", "value": _line(calibration.serial), "name": _text("serial number")}
    item = {
        "name": _text("inertial measurement unit"),
        "description": _text(STATES[certificate.state]),
        "model": None if calibration.model is None else _line(calibration.model),
        "identifications": {"identification": serial},
    }
    code, contact = certificate.laboratory.code, _contact(certificate.laboratory)
    persons = [
        {"person": {"name": _text(one.name)}, "role": one.role, "mainSigner": "false" if i else "true"}
        for i, one in enumerate(certificate.person)
    ]
    said = (RELATES, *([statement_of_scope(scope)] if certificate.laboratory.scope else []), *certificate.remarks)
    statements: list[dict[str, Any]] = [{"declaration": _text(each)} for each in said]
    if traced := (*certificate.traceability, *calibration.provenance.circumstances.equipment):
        kind = {"@refType": "basic_metrologicallyTraceableToSI", "name": _text("metrological traceability")}
        statements.append(kind | {"declaration": _text("; ".join(traced))})
    return {
        "dccSoftware": {"software": {"name": _text(name), "release": release or "unknown"}},
        "coreData": core,
        "items": {"item": item},
        "calibrationLaboratory": {"calibrationLaboratoryCode": code, "contact": contact},
        "respPersons": {"respPerson": persons},
        "customer": _contact(certificate.customer),
        "statements": {"statement": statements},
    }


def _contact(party: Party) -> dict[str, Any]:
    place = {"street": party.street, "postCode": party.postcode, "city": party.city, "countryCode": party.country}
    return {"name": _text(party.name), "eMail": party.email, "location": place}


# -------------------- results --------------------


def _results(
    calibration: Calibration,
    certificate: Certificate,
    known: Mapping[SensorKind, SensorModel],
    judged: Sequence[Verdict],
    scope: Mapping[str, str],
) -> dict[str, Any]:
    methods: list[dict[str, Any]] = [
        {
            "@refType": "basic_calibrationMethod",
            "name": _text(f"method {calibration.method} of tumble"),
            "description": _text(certificate.procedure),
        },
        {
            "@refType": "basic_methodMeasurementUncertainty",
            "name": _text("expanded uncertainty"),
            "description": _text("U = k u covers 95.45 %; k = 2, or Student's t where u was estimated"),
            "norm": "JCGM 100:2008",
        },
    ]
    equipment = [
        {"@refType": "basic_measurementStandard", "name": _text(each)}
        for each in calibration.provenance.circumstances.equipment
    ]
    air, site = calibration.provenance.circumstances.conditions, calibration.provenance.site
    stated: list[tuple[str, str | None, float | None, float | None, str]] = [
        ("temperature", "basic_temperature", air.temperature_degC, air.temperature_u, "degC"),
        ("relative humidity", "basic_humidityRelative", air.humidity_percent, None, "%"),
        ("air pressure", None, air.pressure_hPa, None, "hPa"),
    ]
    if site is not None:
        name = "gravity at the place, the unit of the result" if site.gravity_is_unit else "local gravity"
        stated.insert(0, (name, None, site.gravity, site.gravity_u or None, "m/s^2"))
    conditions = [
        {"@refType": kind, "name": _text(name), "data": {"quantity": {"si:real": _real(value, u, unit, np.inf)}}}
        for name, kind, value, u, unit in stated
        if value is not None
    ]
    alike = [verdict for verdict in judged if verdict.frame == calibration.frame]
    quantities = [_parameter(p, alike, scope.get(p.name, "")) for p in calibration.parameters]
    data: dict[str, Any] = {"parameters": {"quantity": quantities}}
    if calibration.covariance is not None:
        data["parameters with covariance"] = {"quantity": _covariance(calibration, calibration.covariance)}
    data |= {f"model of the {_TITLES[kind]}": _model(kind, model) for kind, model in known.items()}
    statements = [  # of conformity for each check, by the decision rule
        {
            "@refType": "basic_conformity",
            "name": _text(f"{verdict.occasion} check against acceptance limits"),
            "description": _text(certificate.agreed and f"limits and decision rule as agreed: {certificate.agreed}"),
            "norm": "ILAC-G8:09/2019",
            "declaration": _text(f"{RULE}. {RISK}.{verdict.whole_risk}"),
            "conformity": _CONFORMITY.get(verdict.result),
        }
        for verdict in judged
    ]
    return {
        "name": _text("calibration parameters of the inertial measurement unit"),
        "description": _text("; ".join(origin(calibration))),
        "usedMethods": {"usedMethod": methods},
        "measuringEquipments": {"measuringEquipment": equipment} if equipment else None,
        "influenceConditions": {"influenceCondition": conditions} if conditions else None,
        "results": {"result": [{"name": _text(name), "data": each} for name, each in data.items()]},
        "measurementMetaData": {"metaData": statements} if statements else None,
    }


def _parameter(parameter: Parameter, judged: Sequence[Verdict], scope: str) -> dict[str, Any]:
    statements = []
    for verdict, judgement in ((check, each) for check in judged for each in check.judgements):
        if judgement.name == parameter.name and judgement.result in _CONFORMITY:
            between = (judgement.low, judgement.high)
            largest = max((abs(limit) for limit in between if np.isfinite(limit)), default=0.0)
            size, unit = shown_in(judgement.name, judgement.unit, largest)
            low, high = (f"{limit / size:.6g}" for limit in between)
            over = "" if judgement.at is None else f", worst at {judgement.at:.1f} degC: {judgement.value:g}"
            statement = {"@refType": "basic_conformity", "name": _text(f"{verdict.occasion} check")}
            statement |= {"declaration": _text(f"limits {low} to {high} {unit}{over}")}
            statements.append(statement | {"conformity": _CONFORMITY[judgement.result]})
    behind = "no uncertainty is stated"
    if parameter.u is not None:
        known, dof = "u is known (infinite degrees of freedom)", parameter.dof
        behind = known if dof is None else f"u was estimated with {dof:.3g} degrees of freedom"
    return {
        "@refType": "basic_measuredValue",
        "@id": parameter.name,
        "name": _text(parameter.name),
        "description": _text("; ".join(filter(None, (described(parameter.name), behind, scope)))),
        "si:real": _real(parameter.value, parameter.u, parameter.unit, degrees_of_freedom(parameter)),
        "measurementMetaData": {"metaData": statements} if statements else None,
    }


def _real(value: float, u: float | None, unit: str, degrees: float) -> dict[str, Any]:
    """A value with its expanded uncertainty, where it has one, of a u with so many degrees of freedom; with u where
    these are too few."""
    k, uncertainty = stated_factor(degrees), dict[str, Any]()
    if u is not None and k is None:
        uncertainty = {"si:standardMU": {"si:valueStandardMU": f"{u:.{U_DIGITS}g}"}}
    elif u is not None and k is not None:
        uncertainty = {
            "si:expandedMU": {
                "si:valueExpandedMU": f"{k * u:.{U_DIGITS}g}",
                "si:coverageFactor": f"{k:.{U_DIGITS}g}",
                "si:coverageProbability": f"{PROBABILITY:g}",
                "si:distribution": "normal" if np.isinf(degrees) else "Student's t",
            }
        }
    value_and_unit = {"si:value": to_digits(value, u), "si:unit": d_si(unit)}
    return value_and_unit | {"si:measurementUncertaintyUnivariate": uncertainty or None}


def to_digits(value: float, u: float | None) -> str:
    """A value to the last of the digits of its u that are given."""
    if not u or value == 0.0:
        return f"{value:.12g}"
    digits = U_DIGITS + floor(log10(abs(value))) - floor(log10(u))
    return f"{value:.{min(max(digits, 1), 12)}g}"


def _covariance(calibration: Calibration, covariance: Array) -> dict[str, Any] | None:
    """All parameters in one list with the matrix of their covariances, column by column; nothing where too few degrees
    of freedom stand behind it for a region of 95 %."""
    parameters, units = calibration.parameters, [p.unit for p in calibration.parameters]
    fewest = min(degrees_of_freedom(p) for p in parameters)
    if fewest < FEWEST_DEGREES:
        return None
    columns = []
    for unit, column in zip(units, covariance.T.tolist(), strict=True):
        values = " ".join(f"{each:.{_COVARIANCE_DIGITS}g}" for each in column)
        of_unit = " ".join(d_si(other, unit) for other in units)
        columns.append({"si:covarianceXMLList": {"si:valueXMLList": values, "si:unitXMLList": of_unit}})
    n, exact = len(units), np.isinf(fewest)  # how many standard deviations the ellipsoid is large
    square = (
        scipy.special.chdtri(n, 1.0 - REGION_PROBABILITY)
        if exact
        else n * scipy.special.fdtri(n, fewest, REGION_PROBABILITY)
    )
    region = {
        "si:covarianceMatrixXMLList": {"si:columnXMLList": columns},
        "si:coverageFactorXMLList": f"{sqrt(square):.6f}",
        "si:coverageProbabilityXMLList": str(REGION_PROBABILITY),
    }
    values = " ".join(to_digits(p.value, p.u) for p in parameters)
    entries = _list([p.name for p in parameters], values, units)
    entries["si:measurementUncertaintyMultivariateXMLList"] = {"si:ellipsoidalRegionMUXMLList": region}
    return {"name": _text("all parameters"), "si:realListXMLList": entries}


def _model(kind: SensorKind, model: SensorModel) -> dict[str, Any]:
    """Model equation, matrix, bias and an example."""
    unit, worked = UNITS[kind], linear_example(kind, model)
    n = len(model.bias)
    rows = [f"matrix.{p + 1}.{q + 1}" for p in range(n) for q in range(3)]
    lists: list[tuple[str, list[str], Array, str]] = [
        ("matrix M, row by row", rows, model.matrix, "1"),
        ("bias b", [f"bias.{p + 1}" for p in range(n)], model.bias, unit),
        ("example: reading r", [f"reading.{p + 1}" for p in range(n)], worked.reading, unit),
        ("example: true vector t", ["true.x", "true.y", "true.z"], worked.true, unit),
    ]
    quantities = [
        {
            "name": _text(f"{_TITLES[kind]}: {name}"),
            "si:realListXMLList": _list(labels, shown(numbers), [unit] * len(labels)),
        }
        for name, labels, numbers, unit in lists
    ]
    return {"formula": {"latex": r"r = M t + b, \quad t = M^{+} (r - b)"}, "quantity": quantities}


def _list(labels: Sequence[str], values: str, units: Sequence[str]) -> dict[str, Any]:
    """Values, as words, with a label and a unit each."""
    return {
        "si:labelXMLList": " ".join(labels),
        "si:valueXMLList": values,
        "si:unitXMLList": " ".join(map(d_si, units)),
    }
