"""Comparison of two calibrations: differences in units of their combined uncertainty, in one frame.

The difference d = second − first of a parameter has

    u(d)² = u₁² + u₂² − 2 Σ g₁ g₂,    U(d) = t₉₅.₄₅(ν) u(d),    E_n = d / U(d)

(ISO/IEC 17043, annex B, with ν of Welch and Satterthwaite in place of k = 2: `tumble.result.coverage`). g₁ and g₂ are
the changes of the parameter in the two calibrations by one standard uncertainty of an error that both share: that of
gravity, of the time base, or of a prior (`tumble.result.shared_errors`). All m parameters agree if chance makes the
largest |E_n| of m as large with a probability of at least CHANCE (Bonferroni's inequality, Student's t).

All m together, correlations included, are tested with χ² = dᵀ C⁻¹ d, C = C₁ + C₂ − Σ (g₁g₂ᵀ + g₂g₁ᵀ), without
parameters that are known only by their priors in both calibrations. If uncertainties were estimated, with ν the fewest
degrees of freedom, χ²/m has the F distribution with m and ν degrees of freedom (Hotelling). The uncertainties of a mean
of launches are estimated each by itself instead. If either calibration is one, each difference is replaced by the
normal deviate z that is as probable, by its own ν, and with the correlations R

    χ² = m Σ z²/tr R²,    m²/tr R² degrees of freedom,

has the first two moments of chi-square (Satterthwaite); ν is then the fewest of a calibration of one launch. Of 20,000
simulated comparisons of 24 or 72 parameters with 2 to 10 degrees of freedom each, at most 4.3 % are below a probability
of 5 % and 0.07 % below 0.1 %.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import inf, sqrt
from typing import Any, ClassVar, Self

import numpy as np
import scipy

from tumble.arguments import checked
from tumble.brief import Judged
from tumble.errors import InputError
from tumble.files import FilePath
from tumble.result.calibration import Calibration, calibration_from
from tumble.result.coverage import UNLEARNED, expanded_of, unshared_variance, welch_satterthwaite
from tumble.result.further import remarks as remarks_of
from tumble.result.parts import Estimated, Parameter
from tumble.result.shared_errors import shared_errors
from tumble.units import Array

CHANCE = 0.01
"""Probability that the largest difference of two calibrations that agree is significant."""
LEAST_PROBABILITY = 1e-3
"""Two calibrations contradict each other if chance exceeds their χ² with a smaller probability than this."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Difference:
    """A parameter in both calibrations, SI, with the standard uncertainty `u` of the difference.

    Shared errors are not in u. It is None if one of the two has no uncertainty, and zero if both are known only by the
    prior. `dof` are its degrees of freedom, None if infinite."""

    json_fields: ClassVar[tuple[str, ...]] = ("name", "unit", "first", "second", "value", "u", "dof", "e_n")

    name: str
    unit: str
    first: float
    second: float
    u: float | None
    dof: float | None = None

    @classmethod
    def between(cls, first: Estimated, second: Estimated, g: Array, h: Array, **others: Any) -> Self:
        """Return the difference of a parameter that k shared errors change by `g` (k,), g₁, in the first and by `h`
        (k,), g₂, in the second; `others` are the other fields."""
        parts: list[tuple[float, float | None]] = [
            (float(((g - h) ** 2).sum()), None),
            unshared_variance(first.u, first.dof, g.tolist()),
            unshared_variance(second.u, second.dof, h.tolist()),
        ]
        variance = sum(variance for variance, _ in parts)
        if variance < UNLEARNED * ((first.u or 0.0) ** 2 + (second.u or 0.0) ** 2):
            variance = 0.0
        uncertain = first.u is not None and second.u is not None
        u, dof = (sqrt(variance), welch_satterthwaite(parts)) if uncertain else (None, None)
        return cls(first=first.value, second=second.value, u=u, dof=dof, **others)

    @property
    def value(self) -> float:
        """second − first."""
        return self.second - self.first

    @property
    def expanded(self) -> float | None:
        """Expanded uncertainty U, SI; None without uncertainties."""
        return None if self.u is None else expanded_of(self.u, self.dof)

    @property
    def e_n(self) -> float | None:
        """E_n number, above 1 where the two contradict each other; None without an expanded uncertainty."""
        return self.value / self.expanded if self.expanded else None

    @property
    def by_chance(self) -> float | None:
        """Probability that chance makes the difference as large; None without an E_n number."""
        if self.e_n is None or not self.u:
            return None
        return float(2.0 * scipy.special.stdtr(inf if self.dof is None else self.dof, -abs(self.value) / self.u))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False, repr=False)
class Comparison(Judged):
    """Differences of two calibrations in one frame, with their covariance (m, m).

    `chi_square` of all differences has `degrees` of freedom and is exceeded by chance with `probability`; these are
    None without covariances. `missing` are the parameters that only one calibration has."""

    json_fields: ClassVar = (
        *("verdict", "reasons", "frame", "differences", "covariance", "chi_square", "degrees", "probability"),
        *("largest_by_chance", "missing", "remarks"),
    )

    frame: str
    differences: tuple[Difference, ...]
    covariance: Array | None
    chi_square: float | None
    degrees: float | None
    probability: float | None
    missing: tuple[str, ...]
    remarks: tuple[str, ...]

    @property
    def agree(self) -> bool:
        """Whether there are E_n numbers, and chance explains the largest of them and χ²."""
        return self.largest_by_chance is not None and not self.changed and not self.contradicts

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why the calibrations do not agree."""
        return () if self.agree else ("by more than chance and their uncertainties make",)

    @property
    def largest_by_chance(self) -> float | None:
        """Upper bound of the probability that chance makes the largest difference as large; None without any."""
        judged = [d.by_chance for d in self.differences if d.by_chance is not None]
        return min(1.0, len(judged) * min(judged)) if judged else None

    @property
    def changed(self) -> list[str]:
        """The parameters whose difference chance does not explain."""
        judged = [d for d in self.differences if d.by_chance is not None]
        return [d.name for d in judged if len(judged) * (d.by_chance or 0.0) < CHANCE]

    @property
    def contradicts(self) -> bool:
        """Whether chance does not explain χ² of all parameters."""
        return self.probability is not None and self.probability < LEAST_PROBABILITY


@checked
def compare_calibrations(first: Calibration | FilePath, second: Calibration | FilePath) -> Comparison:
    """Compare two calibrations parameter by parameter.

    Parameters
    ----------
    first, second
        Calibrations or their files. The second is converted to the frame of the first if they differ; if the first is
        in the frame of the case, to which there is no conversion, the first is converted.

    Returns
    -------
    Comparison
        Differences second − first, with their uncertainties.

    Raises
    ------
    InputError
        If they have no parameter in common.
    CalibrationError
        If they cannot be converted.

    Examples
    --------
    >>> import tumble
    >>> folder = tumble.simulate_session("session", tumble.Setup.of(grade="mems", positions=12), seed=1)
    >>> full, linear = (tumble.calibrate(folder, terms=terms) for terms in ("full", "linear"))
    >>> comparison = tumble.compare_calibrations(full, linear)
    >>> comparison.agree, len(comparison.differences)
    (True, 21)
    """
    first, second = calibration_from(first), calibration_from(second)
    frame = second.frame if first.frame == "case" else first.frame
    a, b = first.in_frame(frame), second.in_frame(frame)
    common = [name for name in a if name in b]
    if not common:
        raise InputError(
            f"compare: expected calibrations with parameters in common, found {len(a)} and {len(b)} parameters and "
            "none in both; compare devices of one kind"
        )
    sources = shared_errors(a, b)
    shared = []  # changes (m, k) of the common parameters by one standard uncertainty of each of k shared errors
    for i, calibration in enumerate((a, b)):
        order = list(calibration)
        changes = np.concatenate([np.zeros((len(order), 0)), *(each[i] for each in sources.values())], axis=1)
        shared.append(changes[[order.index(name) for name in common]])
    differences = tuple(
        Difference.between(a[name], b[name], g, h, name=name, unit=a[name].unit)
        for name, g, h in zip(common, *shared, strict=True)
    )
    covariance = None
    C1, C2 = a.covariance_of(common), b.covariance_of(common)
    if C1 is not None and C2 is not None:
        covariance = C1 + C2 - shared[0] @ shared[1].T - shared[1] @ shared[0].T
    learned = [i for i, d in enumerate(differences) if d.u != 0.0]
    chi_square, degrees, probability = _chi_square(
        [differences[i] for i in learned],
        None if covariance is None else covariance[np.ix_(learned, learned)],
        [each for each in (a, b) if not each.evidence.launches],
    )
    remarks = list(_remarks(first, second, frame))
    if sources:
        remarks.append(f"common to both, and not in u of the differences: errors of {' and of '.join(sources)}")
    return Comparison(
        frame=frame,
        differences=differences,
        covariance=covariance,
        chi_square=chi_square,
        degrees=degrees,
        probability=probability,
        missing=tuple(name for name in (*a, *b) if name not in common),
        remarks=tuple(remarks),
    )


def _chi_square(
    differences: Sequence[Difference], covariance: Array | None, single: Sequence[Calibration]
) -> tuple[float, float, float] | tuple[None, None, None]:
    """Return chi-square, its degrees of freedom, and the probability that chance exceeds it (module docstring).

    `single` are the calibrations, of the two, that are of one launch."""
    if covariance is None or np.any(np.diag(covariance) <= 0.0):
        return None, None, None
    u = np.sqrt(np.diag(covariance))
    correlation = covariance / np.outer(u, u)
    estimated: Sequence[Difference | Parameter] = differences
    if len(single) == 2:
        d_over_u = np.array([d.value for d in differences]) / u
        degrees = float(np.linalg.matrix_rank(correlation, hermitian=True))
        chi_square = max(0.0, float(d_over_u @ np.linalg.pinv(correlation, hermitian=True) @ d_over_u))
    else:  # of normal deviates z, by Satterthwaite
        estimated = [each[d.name] for each in single for d in differences]
        tails = [max(0.5 * (d.by_chance or 0.0), 1e-300) for d in differences]  # the deviates are finite
        z = scipy.special.ndtri(tails)
        scale = len(z) / float(np.sum(correlation**2))  # m/tr R²
        chi_square = scale * float(z @ z)
        degrees = scale * len(z)
    fewest = min((each.dof for each in estimated if each.u and each.dof is not None), default=None)
    if fewest is None:
        return chi_square, degrees, float(scipy.special.chdtrc(degrees, chi_square))
    return chi_square, degrees, float(scipy.special.fdtrc(degrees, fewest, chi_square / degrees))


def _remarks(first: Calibration, second: Calibration, frame: str) -> Iterator[str]:
    if first.serial != second.serial:
        yield f"different devices: {first.serial} and {second.serial}"
    for which, calibration in (("first", first), ("second", second)):
        if calibration.frame != frame:
            yield f"the {which} was converted from the frame {calibration.frame!r} to {frame!r}"
        if not calibration.outcome.accepted:
            yield f"the {which} was not accepted: {'; '.join(calibration.outcome.reasons)}"
        if all(p.u is None for p in calibration.parameters):
            yield f"the {which} has no uncertainties: nothing is judged"
        yield from (f"the {which}: {remark}" for remark in remarks_of(calibration))
    logs = [calibration.provenance.log_sha256 for calibration in (first, second)]
    if logs[0] is not None and logs[0] == logs[1]:
        yield "both come from the same log: their differences are smaller than their uncertainties allow"
