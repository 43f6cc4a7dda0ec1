"""Findings about an estimate, and the units and words of their sentences."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from tumble.advice import advised
from tumble.inference.estimate import Outcome
from tumble.sensors.parameters import sensor_kind
from tumble.units import DEGREE, DEGREE_PER_HOUR, G_STANDARD

SENSORS = {"accel": "accelerometers", "gyro": "gyros"}
BIAS_UNITS = {"accel": "µg", "gyro": "°/h"}
TURN_GROUPS = ("gyro.scale", "gyro.axis")  # groups of parameters that are determined by turns
IN_U = "; u contains it"
UNITS = {
    "µg": 1e-6 * G_STANDARD, "µg/g": 1e-6, "µg/g²": 1e-6 / G_STANDARD,
    "°/h": DEGREE_PER_HOUR, "°/h/g": DEGREE_PER_HOUR / G_STANDARD, "°/h/g²": DEGREE_PER_HOUR / G_STANDARD**2,
    "°": DEGREE, "%": 1e-2, "ppm": 1e-6, "ppm at 10 °/s": 1e-6 / (10.0 * DEGREE) ** 2, "mm/s": 1e-3,
}  # fmt: skip
"""SI values of the units in sentences."""


def with_unit(value: float, unit: str) -> str:
    """Return a quantity (SI) with two digits in a unit."""
    return f"{value / UNITS[unit]:.2g} {unit}".replace(" °", "°")


@dataclass(frozen=True, kw_only=True, slots=True)
class Finding:
    """A finding about an estimate, from which its outcome is made.

    Attributes
    ----------
    sentence : str
        What was found, with cause and remedy.
    concerns : tuple of str
        Kinds of sensors ("gyro") or groups of parameters ("gyro.bias") that it concerns; empty for all.
    refuses : bool
        Whether they cannot be used; otherwise the finding is a remark.
    causes : tuple of str
        Names of possible causes, the most likely first.
    unsteady : bool
        Whether parameters changed in the session by more than is usual.
    p_value : float
        Probability that chance alone explains the residuals as well as the cause does.
    by_group : mapping of str to float
        Largest error of a parameter, in its u, if the cause is left out, for each group of the linear model.
    """

    sentence: str
    concerns: tuple[str, ...] = ()
    refuses: bool = False
    causes: tuple[str, ...] = ()
    unsteady: bool = False
    p_value: float = 0.0
    by_group: Mapping[str, float] = field(default_factory=dict)

    @property
    def cause(self) -> str:
        """Name of the most likely cause; empty if there is none."""
        return self.causes[0] if self.causes else ""

    @property
    def damage(self) -> float:
        """Largest error of any parameter if the cause is left out, in its u."""
        return max(self.by_group.values(), default=0.0)

    @property
    def kinds(self) -> tuple[str, ...]:
        """The kind of sensor that it concerns; empty if it concerns both."""
        kinds = {sensor_kind(part) for part in self.concerns}
        return tuple(kinds) if len(kinds) == 1 else ()


def remark(found: str, remedy: str = "", *, concerns: tuple[str, ...] = ()) -> Finding:
    """Return a finding that does not refuse anything."""
    return Finding(sentence=advised(found, remedy), concerns=concerns)


def refusal(found: str, remedy: str = "", *, concerns: tuple[str, ...] = ()) -> Finding:
    """Return a finding that refuses the parameters it concerns."""
    return Finding(sentence=advised(found, remedy), concerns=concerns, refuses=True)


def outcome_of(findings: Iterable[Finding], unobservable: tuple[str, ...] = ()) -> Outcome:
    """Build an `Outcome` from findings and the names of undetermined parameters.

    Sentences are in the order of the findings, remarks on changed parameters before others."""
    findings = sorted(findings, key=lambda finding: not (finding.unsteady or finding.refuses))
    return Outcome(
        reasons=tuple(finding.sentence for finding in findings if finding.refuses),
        remarks=tuple(finding.sentence for finding in findings if not finding.refuses),
        unobservable=unobservable,
        concerns={finding.sentence: finding.concerns for finding in findings if finding.concerns},
        unsteady=tuple(finding.sentence for finding in findings if finding.unsteady and not finding.refuses),
    )


def causes_of(findings: Iterable[Finding]) -> tuple[str, ...]:
    """Return the names of the causes of findings, without duplicates."""
    return tuple(dict.fromkeys(cause for finding in findings for cause in finding.causes))
