"""A Digital Calibration Certificate: the XML of PTB's DCC, schema 3.3.0, with quantities in D-SI 2.2.1.

Every parameter of accelerometers and gyros is a quantity with its expanded uncertainty U = k u, of the
probability 0.9545, with its own coverage factor k: Student's t where u was estimated (`coverage`). A list of all of
them has their covariance matrix, the matrices and biases of the model equation follow, and an example worked with it:

    reading = matrix · true + bias,    true = matrix⁻¹ (reading − bias)

The file is neither signed nor sealed.

Source: PTB, DCC schema 3.3.0 and D-SI schema 2.2.1.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from datetime import date
from math import floor, log10

import numpy as np
from scipy.special import chdtri, fdtri

from tumble.acceptance.certificate import RELATES, STATES, Certificate, Party, check_certificate, judged_by
from tumble.acceptance.conformity import RULE, LimitJudgement, Verdict, verdicts
from tumble.calibration.calibration_file import Calibration, read_calibration
from tumble.calibration.coverage import PROBABILITY, degrees_of_freedom
from tumble.calibration.further import described
from tumble.calibration.results import FEWEST_DEGREES, Parameter, stated_factor
from tumble.errors import InputError
from tumble.export.exported import UNITS, Exported, example, models, one_line, origin, shown
from tumble.export.larger_model import NOT_IN_MATRIX, not_held
from tumble.sensors.model import SensorKind, SensorModel
from tumble.sensors.parameters import sensor_kind, shown_in
from tumble.units import Array

VERSION = "3.3.0"
_DCC, _SI, _XSI = "https://ptb.de/dcc", "https://ptb.de/si", "http://www.w3.org/2001/XMLSchema-instance"
REGION_PROBABILITY = 0.95
"""What the ellipsoid of all parameters covers."""

LOSSES = (
    "the file is neither signed nor sealed: sign it with the laboratory's tools",
    "rests, turns, launches and iterations of the calibration have no place in this file",
)

_DIMENSIONS: Mapping[str, Mapping[str, int]] = {
    "m/s^2": {"metre": 1, "second": -2},
    "rad/s": {"radian": 1, "second": -1},
    "rad": {"radian": 1},
    "1": {},
    "m": {"metre": 1},
    "s": {"second": 1},
    "s^2/m": {"second": 2, "metre": -1},
    "s^4/m^2": {"second": 4, "metre": -2},
    "s^2/rad^2": {"second": 2, "radian": -2},
    "rad*s/m": {"radian": 1, "second": 1, "metre": -1},
    "m/s^2/s": {"metre": 1, "second": -3},
    "rad/s/s": {"radian": 1, "second": -2},
    "1/s": {"second": -1},
    "m/s^2/K": {"metre": 1, "second": -2, "kelvin": -1},
    "rad/s/K": {"radian": 1, "second": -1, "kelvin": -1},
    "1/K": {"kelvin": -1},
    "degC": {"degreecelsius": 1},
    "%": {"percent": 1},
    "hPa": {"hecto\\pascal": 1},
    "m/s^2/K^2": {"metre": 1, "second": -2, "kelvin": -2},
    "rad/s/K^2": {"radian": 1, "second": -1, "kelvin": -2},
    "1/K^2": {"kelvin": -2},
}
_CONFORMITY: Mapping[str, str] = {
    "pass": "pass",
    "conditional pass": "conditionalPass",
    "conditional fail": "conditionalFail",
    "fail": "fail",
}
"""Outcomes as the schema has them; it has none for what is undecided."""

U_DIGITS = 3
"""Digits of u and U: two that matter, and one so that rounding adds nothing."""
_COVARIANCE_DIGITS = 10
"""Of covariances, so that a matrix of strong correlations stays positive."""

_TITLES = {"accel": "accelerometers", "gyro": "gyros"}


def d_si(*units: str) -> str:
    """The product of units as D-SI writes it: d_si("m/s^2") is \\metre\\second\\tothe{-2}."""
    powers: Counter[str] = Counter()
    for unit in units:
        if unit not in _DIMENSIONS:
            raise InputError(f"calibration: expected the SI unit of a parameter, found {unit!r}; calibrate again")
        powers.update(_DIMENSIONS[unit])
    parts = [f"\\{name}" + ("" if power == 1 else f"\\tothe{{{power}}}") for name, power in powers.items() if power]
    return "".join(parts) or "\\one"


def dcc(calibration: Calibration, certificate: Certificate) -> Exported:
    """The XML file of a calibration with the administrative data of its certificate."""
    known = models(calibration)
    check_certificate(
        certificate, calibration, None if certificate.as_found is None else read_calibration(certificate.as_found)
    )
    limits = judged_by(certificate)
    judged = () if limits is None else tuple(verdicts(calibration, limits))
    losses = (*LOSSES, *not_held(calibration, said=NOT_IN_MATRIX))
    inertial = [i for i, p in enumerate(calibration.parameters) if sensor_kind(p.name) != "mag"]
    calibration = replace(
        calibration,
        parameters=tuple(calibration.parameters[i] for i in inertial),
        covariance=None if calibration.covariance is None else calibration.covariance[np.ix_(inertial, inertial)],
    )
    ET.register_namespace("dcc", _DCC)
    ET.register_namespace("si", _SI)
    root = ET.Element(f"{{{_DCC}}}digitalCalibrationCertificate", {"schemaVersion": VERSION})
    root.set(f"{{{_XSI}}}schemaLocation", f"{_DCC} {_DCC}/v{VERSION}/dcc.xsd")
    _administrative(_child(root, "administrativeData"), calibration, certificate)
    result = _child(_child(root, "measurementResults"), "measurementResult")
    _results(result, calibration, certificate, known, judged)
    ET.indent(root)
    return Exported(content=ET.tostring(root, encoding="utf-8", xml_declaration=True) + b"\n", losses=losses)


def _child(parent: ET.Element, name: str, text: str | None = None, namespace: str = _DCC) -> ET.Element:
    element = ET.SubElement(parent, f"{{{namespace}}}{name}")
    element.text = text
    return element


def _named(parent: ET.Element, name: str, text: str) -> ET.Element:
    """A child whose own child `content` has the text in English."""
    element = _child(parent, name)
    _child(element, "content", one_line(text)).set("lang", "en")
    return element


# -------------------- who, what, when --------------------


def _administrative(parent: ET.Element, calibration: Calibration, certificate: Certificate) -> None:
    name, _, release = calibration.provenance.get("software", "tumble 0").partition(" ")
    software = _child(_child(parent, "dccSoftware"), "software")
    _named(software, "name", name)
    _child(software, "release", release or "unknown")
    _core(_child(parent, "coreData"), certificate, certificate.days(calibration))
    _item(_child(_child(parent, "items"), "item"), calibration, certificate)
    laboratory = _child(parent, "calibrationLaboratory")
    if certificate.laboratory.code is not None:
        _child(laboratory, "calibrationLaboratoryCode", certificate.laboratory.code)
    _contact(_child(laboratory, "contact"), certificate.laboratory)
    persons = _child(parent, "respPersons")
    for i, person in enumerate(certificate.person):
        entry = _child(persons, "respPerson")
        _named(_child(entry, "person"), "name", person.name)
        if person.role is not None:
            _child(entry, "role", person.role)
        _child(entry, "mainSigner", "true" if i == 0 else "false")
    _contact(_child(parent, "customer"), certificate.customer)
    statements = _child(parent, "statements")
    for remark in (RELATES, *certificate.remarks):
        _named(_child(statements, "statement"), "declaration", remark)
    traced = (*certificate.traceability, *calibration.circumstances.equipment)
    if traced:
        statement = _typed(_child(statements, "statement"), "basic_metrologicallyTraceableToSI")
        _named(statement, "name", "metrological traceability")
        _named(statement, "declaration", "; ".join(traced))


def _core(parent: ET.Element, certificate: Certificate, days: tuple[date, date]) -> None:
    _child(parent, "countryCodeISO3166_1", certificate.country)
    _child(parent, "usedLangCodeISO639_1", "en")
    _child(parent, "mandatoryLangCodeISO639_1", "en")
    _child(parent, "uniqueIdentifier", certificate.number)
    if certificate.received is not None:
        _child(parent, "receiptDate", certificate.received.isoformat())
    _child(parent, "beginPerformanceDate", days[0].isoformat())
    _child(parent, "endPerformanceDate", days[1].isoformat())
    _child(parent, "performanceLocation", certificate.place)
    if certificate.issued is not None:
        _child(parent, "issueDate", certificate.issued.isoformat())
    if certificate.replaces is not None:
        change = _child(parent, "reportAmendedSubstituted")
        _child(change, "typeOfChange", "substituted")
        _child(change, "replacedUniqueIdentifier", certificate.replaces)


def _item(parent: ET.Element, calibration: Calibration, certificate: Certificate) -> None:
    _named(parent, "name", "inertial measurement unit")
    _named(parent, "description", STATES[certificate.state])
    if calibration.model is not None:
        _child(parent, "model", one_line(calibration.model))
    identification = _child(_child(parent, "identifications"), "identification")
    _child(identification, "issuer", "manufacturer")
    _child(identification, "value", one_line(calibration.serial))
    _named(identification, "name", "serial number")


def _contact(parent: ET.Element, party: Party) -> None:
    _named(parent, "name", party.name)
    if party.email is not None:
        _child(parent, "eMail", party.email)
    location = _child(parent, "location")
    for name, text in (("street", party.street), ("postCode", party.postcode), ("city", party.city)):
        if text is not None:
            _child(location, name, text)
    _child(location, "countryCode", party.country)


# -------------------- results --------------------


def _results(
    parent: ET.Element,
    calibration: Calibration,
    certificate: Certificate,
    known: Mapping[SensorKind, SensorModel],
    judged: Sequence[Verdict],
) -> None:
    _named(parent, "name", "calibration parameters of the inertial measurement unit")
    _named(parent, "description", "; ".join(origin(calibration)))
    _methods(_child(parent, "usedMethods"), calibration, certificate)
    equipment = calibration.circumstances.equipment
    if equipment:
        every = _child(parent, "measuringEquipments")
        for each in equipment:
            _named(_typed(_child(every, "measuringEquipment"), "basic_measurementStandard"), "name", each)
    _conditions(parent, calibration)
    results = _child(parent, "results")
    alike = [verdict for verdict in judged if verdict.frame == calibration.frame]
    _parameters(_result(results, "parameters"), calibration, alike)
    if calibration.covariance is not None:
        _covariance(_result(results, "parameters with covariance"), calibration, calibration.covariance)
    for kind, model in known.items():
        _model(_result(results, f"model of the {_TITLES[kind]}"), kind, model)
    if judged:
        _conformity(_child(parent, "measurementMetaData"), certificate, judged)


def _methods(parent: ET.Element, calibration: Calibration, certificate: Certificate) -> None:
    """The method of the calibration, and that of its uncertainty."""
    method = _typed(_child(parent, "usedMethod"), "basic_calibrationMethod")
    _named(method, "name", f"method {calibration.method} of tumble")
    if certificate.procedure is not None:
        _named(method, "description", certificate.procedure)
    uncertainty = _typed(_child(parent, "usedMethod"), "basic_methodMeasurementUncertainty")
    _named(uncertainty, "name", "expanded uncertainty")
    _named(uncertainty, "description", "U = k u covers 95.45 %; k = 2, or Student's t where u was estimated")
    _child(uncertainty, "norm", "JCGM 100:2008")


def _conditions(parent: ET.Element, calibration: Calibration) -> None:
    """Gravity and the air."""
    air, site = calibration.circumstances.air, calibration.site
    found: list[tuple[str, str | None, float | None, float | None, str]] = [
        ("temperature", "basic_temperature", air.temperature, air.temperature_u, "degC"),
        ("relative humidity", "basic_humidityRelative", air.humidity, None, "%"),
        ("air pressure", None, air.pressure, None, "hPa"),
    ]
    if site is not None:
        said = "gravity at the place, the unit of the result" if site.gravity_is_unit else "local gravity"
        found.insert(0, (said, None, site.gravity, site.gravity_u or None, "m/s^2"))
    known = [(name, kind, value, u, unit) for name, kind, value, u, unit in found if value is not None]
    every = _child(parent, "influenceConditions") if known else parent
    for name, kind, value, u, unit in known:
        condition = _typed(_child(every, "influenceCondition"), kind)
        _named(condition, "name", name)
        _real(_child(_child(condition, "data"), "quantity"), value, u, unit, np.inf)


def _conformity(parent: ET.Element, certificate: Certificate, judged: Sequence[Verdict]) -> None:
    """A statement of conformity for each check, by the decision rule."""
    for verdict in judged:
        statement = _typed(_child(parent, "metaData"), "basic_conformity")
        _named(statement, "name", f"{verdict.occasion} check against acceptance limits")
        if certificate.agreed is not None:
            _named(statement, "description", f"limits and decision rule as agreed: {certificate.agreed}")
        _child(statement, "norm", "ILAC-G8:09/2019")
        _named(statement, "declaration", RULE)
        if verdict.result in _CONFORMITY:
            _child(statement, "conformity", _CONFORMITY[verdict.result])


def _typed(element: ET.Element, kind: str | None) -> ET.Element:
    """An element with its refType, one of good practice, where it has one."""
    if kind is not None:
        element.set("refType", kind)
    return element


def _result(parent: ET.Element, name: str) -> ET.Element:
    """The data of a new result."""
    result = _child(parent, "result")
    _named(result, "name", name)
    return _child(result, "data")


def _behind(parameter: Parameter) -> str:
    """What stands behind u, in words."""
    if parameter.u is None:
        return "no uncertainty is stated"
    if parameter.dof is None:
        return "u is known (infinite degrees of freedom)"
    return f"u was estimated with {parameter.dof:.3g} degrees of freedom"


def _limits(judgement: LimitJudgement) -> str:
    """The limits of a parameter in its usual unit."""
    finite = [limit for limit in (judgement.low, judgement.high) if np.isfinite(limit)]
    size, unit = shown_in(judgement.name, judgement.unit, max(map(abs, finite), default=0.0))
    low, high = (f"{limit / size:.6g}" for limit in (judgement.low, judgement.high))
    return f"{low} to {high} {unit}"


def _over(judgement: LimitJudgement) -> str:
    """At which temperature a parameter over temperature was judged."""
    return "" if judgement.at is None else f", worst at {judgement.at:.1f} degC: {judgement.value:g}"


def _parameters(data: ET.Element, calibration: Calibration, judged: Sequence[Verdict]) -> None:
    for parameter in calibration.parameters:
        quantity = _typed(_child(data, "quantity"), "basic_measuredValue")
        quantity.set("id", parameter.name)
        _named(quantity, "name", parameter.name)
        _named(
            quantity, "description", "; ".join(each for each in (described(parameter.name), _behind(parameter)) if each)
        )
        _real(quantity, parameter.value, parameter.u, parameter.unit, degrees_of_freedom(parameter))
        found = [(v.occasion, j) for v in judged for j in v.judgements if j.name == parameter.name]
        told = [(occasion, j) for occasion, j in found if j.result in _CONFORMITY]
        every = _child(quantity, "measurementMetaData") if told else quantity
        for occasion, judgement in told:
            statement = _typed(_child(every, "metaData"), "basic_conformity")
            _named(statement, "name", f"{occasion} check")
            _named(
                statement,
                "declaration",
                f"limits {_limits(judgement)}{_over(judgement)}",
            )
            _child(statement, "conformity", _CONFORMITY[judgement.result])


def _real(quantity: ET.Element, value: float, u: float | None, unit: str, degrees: float) -> None:
    """A value with its expanded uncertainty, where it has one, of a u with so many degrees of freedom; with u where
    these are too few."""
    real = _child(quantity, "real", namespace=_SI)
    _child(real, "value", to_digits(value, u), _SI)
    _child(real, "unit", d_si(unit), _SI)
    if u is None:
        return
    univariate, k = _child(real, "measurementUncertaintyUnivariate", namespace=_SI), stated_factor(degrees)
    if k is None:
        standard = _child(univariate, "standardMU", namespace=_SI)
        _child(standard, "valueStandardMU", f"{u:.{U_DIGITS}g}", _SI)
    else:
        expanded = _child(univariate, "expandedMU", namespace=_SI)
        _child(expanded, "valueExpandedMU", f"{k * u:.{U_DIGITS}g}", _SI)
        _child(expanded, "coverageFactor", f"{k:.{U_DIGITS}g}", _SI)
        _child(expanded, "coverageProbability", f"{PROBABILITY:g}", _SI)
        _child(expanded, "distribution", "normal" if np.isinf(degrees) else "Student's t", _SI)


def to_digits(value: float, u: float | None) -> str:
    """A value to the last of the digits of its u that are given."""
    if not u or value == 0.0:
        return f"{value:.12g}"
    digits = U_DIGITS + floor(log10(abs(value))) - floor(log10(u))
    return f"{value:.{min(max(digits, 1), 12)}g}"


def _covariance(data: ET.Element, calibration: Calibration, covariance: Array) -> None:
    """All parameters in one list with the matrix of their covariances, column by column; nothing where too few degrees
    of freedom stand behind it for a region of 95 %."""
    parameters = calibration.parameters
    fewest = min(degrees_of_freedom(p) for p in parameters)
    if fewest < FEWEST_DEGREES:
        return
    quantity = _child(data, "quantity")
    _named(quantity, "name", "all parameters")
    units = [p.unit for p in parameters]
    entries = _list(
        quantity, [p.name for p in parameters], " ".join(to_digits(p.value, p.u) for p in parameters), units
    )
    several = _child(entries, "measurementUncertaintyMultivariateXMLList", namespace=_SI)
    region = _child(several, "ellipsoidalRegionMUXMLList", namespace=_SI)
    matrix = _child(region, "covarianceMatrixXMLList", namespace=_SI)
    for j, unit in enumerate(units):
        column = _child(_child(matrix, "columnXMLList", namespace=_SI), "covarianceXMLList", namespace=_SI)
        _child(
            column,
            "valueXMLList",
            " ".join(f"{each:.{_COVARIANCE_DIGITS}g}" for each in covariance[:, j].tolist()),
            _SI,
        )
        _child(column, "unitXMLList", " ".join(d_si(other, unit) for other in units), _SI)
    _child(region, "coverageFactorXMLList", f"{_region_factor(len(units), fewest):.6f}", _SI)
    _child(region, "coverageProbabilityXMLList", str(REGION_PROBABILITY), _SI)


def _region_factor(count: int, degrees: float) -> float:
    """How many standard deviations the ellipsoid of so many parameters is large, of a covariance that was estimated
    with so many degrees of freedom."""
    if np.isinf(degrees):
        return float(np.sqrt(chdtri(count, 1.0 - REGION_PROBABILITY)))
    return float(np.sqrt(count * fdtri(count, degrees, REGION_PROBABILITY)))


def _model(data: ET.Element, kind: SensorKind, model: SensorModel) -> None:
    """Model equation, matrix, bias and an example."""
    _child(_child(data, "formula"), "latex", r"r = M t + b, \quad t = M^{+} (r - b)")
    unit, worked = UNITS[kind], example(kind, model)
    n = len(model.bias)
    rows = [f"matrix.{p + 1}.{q + 1}" for p in range(n) for q in range(3)]
    for name, labels, values, of in (
        ("matrix M, row by row", rows, model.matrix, "1"),
        ("bias b", [f"bias.{p + 1}" for p in range(n)], model.bias, unit),
        ("example: reading r", [f"reading.{p + 1}" for p in range(n)], worked.reading, unit),
        ("example: true vector t", ["true.x", "true.y", "true.z"], worked.true, unit),
    ):
        quantity = _child(data, "quantity")
        _named(quantity, "name", f"{_TITLES[kind]}: {name}")
        _list(quantity, labels, shown(values), [of] * len(labels))


def _list(quantity: ET.Element, labels: Sequence[str], values: str, units: Sequence[str]) -> ET.Element:
    """Values, as words, with a label and a unit each."""
    entries = _child(quantity, "realListXMLList", namespace=_SI)
    _child(entries, "labelXMLList", " ".join(labels), _SI)
    _child(entries, "valueXMLList", values, _SI)
    _child(entries, "unitXMLList", " ".join(map(d_si, units)), _SI)
    return entries
