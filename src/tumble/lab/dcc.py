"""Digital Calibration Certificate: the XML of PTB's DCC, schema 3.3.0, with quantities in D-SI 2.2.1.

Every parameter of accelerometers and gyros is a quantity with its expanded uncertainty U = k u for the probability
0.9545, with its own coverage factor k: Student's t where u was estimated (`coverage`). The matrices and biases of the
model equation follow, with a worked example:

    reading = matrix · true + bias,    true = matrix⁻¹ (reading − bias)

The document is laid out in `templates/dcc.xml.j2`. It is neither signed nor sealed.

Source: PTB, DCC schema 3.3.0 and D-SI schema 2.2.1.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from math import floor, log10
from pathlib import Path
from typing import Any

import numpy as np

from tumble.documents import plain
from tumble.errors import InputError
from tumble.export import Target
from tumble.export.exported import Exported, models, origin, shown, table_notes
from tumble.files import FilePath
from tumble.lab.certificate import (
    SCOPE_STATEMENT,
    STATES,
    Certificate,
    certificate_limits,
    check_certificate,
    read_certificate,
    statements_of_result,
)
from tumble.lab.conformity import DECISION_RULE, RISK_DEFINITION, Verdict, judge_calibration
from tumble.lab.report import statement_of_priors
from tumble.result.calibration import Calibration
from tumble.result.correction import linear_example
from tumble.result.coverage import PROBABILITY
from tumble.result.further import parameter_words
from tumble.result.parts import Parameter, stated_factor
from tumble.sensors.model import UNITS, WORDS, SensorKind, SensorModel
from tumble.sensors.parameters import sensor_kind, shown_in
from tumble.units import Array
from tumble.views.render.pages import escaping_environment
from tumble.views.report.result import contents_of_u, scope_of_u

LOSSES = (
    "the file is neither signed nor sealed: sign it with the laboratory's tools",
    "not in this file: covariances, rests, turns, launches and iterations of the calibration",
)

_UNITS = {"m": "metre", "s": "second", "rad": "radian", "K": "kelvin", "degC": "degreecelsius", "%": "percent"}
_UNITS |= {"hPa": "hecto\\pascal"}
_FACTOR = re.compile(r"(?P<over>[*/]|^)(?P<unit>[A-Za-z%]+|1)(?:\^(?P<power>\d))?")
_CONFORMITY = {"conditional pass": "conditionalPass", "conditional fail": "conditionalFail"}
_CONFORMITY |= {"pass": "pass", "fail": "fail"}
"""Results by their names in the schema, which has none for undecided."""

U_DIGITS = 3  # digits of u and U: two significant digits, and one that makes rounding negligible


def d_si(unit: str) -> str:
    """Return a unit in D-SI notation: d_si("m/s^2") is \\metre\\second\\tothe{-2}."""
    factors, parts = list(_FACTOR.finditer(unit)), []
    for factor in factors:
        power = int(factor["power"] or 1) * (-1 if factor["over"] == "/" else 1)
        if factor["unit"] in _UNITS:
            parts.append(f"\\{_UNITS[factor['unit']]}" + ("" if power == 1 else f"\\tothe{{{power}}}"))
    known = all(factor["unit"] in (*_UNITS, "1") for factor in factors)
    if not known or "".join(factor[0] for factor in factors) != unit or not unit:
        raise InputError(f"calibration: expected the SI unit of a parameter, found {unit!r}; calibrate again")
    return "".join(parts) or "\\one"


def dcc(calibration: Calibration, *, certificate: Certificate | FilePath) -> Exported:
    """Return the XML file of a calibration with the administrative data of a certificate, or of its file."""
    if not isinstance(certificate, Certificate):
        certificate = read_certificate(Path(certificate))
    by_kind = models(calibration)
    check_certificate(certificate, calibration)
    limits = certificate_limits(certificate)
    checks = () if limits is None else tuple(judge_calibration(calibration, limits))
    inertial = [p for p in calibration.parameters if sensor_kind(p.name) != "mag"]
    provenance, circumstances = calibration.provenance, calibration.provenance.circumstances
    name, _, release = (provenance.software or "tumble 0").partition(" ")
    traceable = {_quantity(each) for each in certificate.traceability} - {""}
    same_frame = [verdict for verdict in checks if verdict.frame == calibration.frame]
    environment = escaping_environment("tumble.lab")
    environment.filters["line"] = lambda text: " ".join(plain(text).split())
    content = environment.get_template("dcc.xml.j2").render(
        certificate=certificate,
        software=(name, release or "unknown"),
        days=certificate.days(calibration),
        state=STATES[certificate.state],
        device=calibration.device,
        declarations=[
            *statements_of_result(calibration, *calibration.outcome.remarks),
            *filter(None, [statement_of_priors(calibration), certificate.changed]),
            SCOPE_STATEMENT,
            *certificate.remarks,
        ],
        traced="; ".join(certificate.traceability or circumstances.equipment),
        contents_of_u=f"{scope_of_u(calibration)} {contents_of_u(calibration)}",
        origin="; ".join(origin(calibration)),
        method=calibration.method,
        equipment=[(each, _quantity(each) in traceable) for each in circumstances.equipment],
        conditions=_conditions(calibration),
        probability=f"{PROBABILITY:g}",
        parameters=[_parameter(p, same_frame) for p in inertial],
        models={WORDS[kind]: _model(kind, model) for kind, model in by_kind.items()},
        statements=[_conformity(verdict, certificate.agreed) for verdict in checks],
    )
    lines = (line.strip() for line in content.splitlines())
    return Exported(
        content="\n".join(filter(None, lines)).encode() + b"\n",
        losses=(*LOSSES, *table_notes(calibration)),
        reasons=tuple(f"{each.occasion} check: {'; '.join(each.reasons)}" for each in checks if each.result != "pass"),
    )


TARGET = Target(
    write=dcc,
    about="Digital Calibration Certificate of PTB, XML",
    takes=("certificate",),
    needs=("certificate",),
    ending=".xml",
)
"""Target of `tumble export --to dcc`."""


def _quantity(equipment: str) -> str:
    """Return the quantity of "gravity: network point 4711"; empty without one."""
    quantity, colon, _ = equipment.partition(":")
    return quantity if colon else ""


def _conditions(calibration: Calibration) -> list[dict[str, Any]]:
    """Return gravity and the conditions of the air as quantities."""
    air, site = calibration.provenance.circumstances.conditions, calibration.provenance.site
    stated: list[tuple[str, str, float | None, float | None, str]] = [
        ("temperature", "basic_temperature", air.temperature_degC, air.temperature_u, "degC"),
        ("relative humidity", "basic_humidityRelative", air.humidity_percent, None, "%"),
        ("air pressure", "", air.pressure_hPa, None, "hPa"),
    ]
    if site is not None:
        name = "gravity at the place, the unit of the result" if site.gravity_is_unit else "local gravity"
        stated.insert(0, (name, "", site.gravity, site.gravity_u or None, "m/s^2"))
    return [
        {"kind": kind, "name": name, "quantity": _real(value, u, unit, None)}
        for name, kind, value, u, unit in stated
        if value is not None
    ]


def _conformity(verdict: Verdict, agreed: str | None) -> dict[str, Any]:
    """Return the statement of conformity for a check."""
    return {
        "name": f"{verdict.occasion} check against acceptance limits",
        "agreed": agreed and f"limits and decision rule as agreed: {agreed}",
        "norm": "ILAC-G8:09/2019",
        "declaration": f"{'; '.join((verdict.result, *verdict.reasons))}. {DECISION_RULE}. {RISK_DEFINITION}."
        f"{verdict.risk_sentence}",
        "conformity": _CONFORMITY.get(verdict.result),
    }


def _parameter(parameter: Parameter, verdicts: Sequence[Verdict]) -> dict[str, Any]:
    """Return a parameter with U, its description, and its statements of conformity in the checks `verdicts`."""
    statements = []
    for verdict, judgement in ((check, judgement) for check in verdicts for judgement in check.judgements):
        if judgement.name == parameter.name and judgement.result in _CONFORMITY:
            interval = (judgement.low, judgement.high)
            largest = max((abs(limit) for limit in interval if np.isfinite(limit)), default=0.0)
            size, unit = shown_in(judgement.name, judgement.unit, largest)
            low, high = (f"{limit / size:.6g}" for limit in interval)
            statement = {"name": f"{verdict.occasion} check", "agreed": None, "norm": None}
            statement |= {"declaration": f"limits {low} to {high} {unit}"}
            statements.append(statement | {"conformity": _CONFORMITY[judgement.result]})
    basis = "no uncertainty is stated"
    if parameter.u is not None:
        known, dof = "u is known (infinite degrees of freedom)", parameter.dof
        basis = known if dof is None else f"u was estimated with {dof:.3g} degrees of freedom"
    deviation = parameter.run_to_run
    spread = [] if deviation is None else [f"standard deviation from launch to launch {deviation:.2g} {parameter.unit}"]
    return {
        "name": parameter.name,
        "words": "; ".join(filter(None, (parameter_words(parameter.name), basis, *spread))),
        "quantity": _real(parameter.value, parameter.u, parameter.unit, parameter.dof),
        "statements": statements,
    }


def _real(value: float, u: float | None, unit: str, degrees: float | None) -> dict[str, Any]:
    """Return a value with its expanded uncertainty by its degrees of freedom, None if u is known; with u if too few."""
    k, digits = stated_factor(degrees), 12
    if u and value != 0.0:  # the value is rounded to the last digit of its u
        digits = min(max(U_DIGITS + floor(log10(abs(value))) - floor(log10(u)), 1), digits)
    return {
        "value": f"{value:.{digits}g}",
        "unit": d_si(unit),
        "u": None if u is None else f"{u:.{U_DIGITS}g}",
        "U": None if u is None or k is None else f"{k * u:.{U_DIGITS}g}",
        "k": None if k is None else f"{k:.{U_DIGITS}g}",
        "distribution": "normal" if degrees is None else "Student's t",
    }


def _model(kind: SensorKind, model: SensorModel) -> dict[str, dict[str, str]]:
    """Return matrix, bias and a worked example by name."""
    unit, worked, n = UNITS[kind], linear_example(kind, model), len(model.bias)

    def listed(label: str, vector: Array, axes: Sequence[Any] = range(1, n + 1)) -> dict[str, str]:
        return _list([f"{label}.{each}" for each in axes], shown(vector), [unit] * len(vector))

    entries = [f"matrix.{p}.{q}" for p in range(1, n + 1) for q in (1, 2, 3)]
    return {
        "matrix M, row by row": _list(entries, shown(model.matrix), ["1"] * len(entries)),
        "bias b": listed("bias", model.bias),
        "example: reading r": listed("reading", worked.reading),
        "example: true vector t": listed("true", worked.true, "xyz"),
    }


def _list(labels: Sequence[str], numbers: str, units: Sequence[str]) -> dict[str, Any]:
    """Return a list of formatted numbers, each with a label and a unit."""
    return {"labels": " ".join(labels), "numbers": numbers, "units": " ".join(map(d_si, units))}
