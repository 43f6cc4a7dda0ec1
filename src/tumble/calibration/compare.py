"""Two calibrations compared: differences in units of their combined uncertainty, in one frame.

With d = first − second and uncertainties u₁, u₂ of two recordings that have nothing in common,

    u(d)² = u₁² + u₂²,    E_n = d / √(U₁² + U₂²) = d / 2u(d)        U = 2u (k = 2)

(ISO/IEC 17043, annex B). |E_n| ≤ 1 is agreement. One honest value in twenty-two lies beyond, so that of 21 parameters
one or two may, and more where u was estimated with few degrees of freedom (`coverage`); χ² = dᵀ (C₁ + C₂)⁻¹ d judges
all of them together, correlations included. What both recordings have in common, such as an error of the site's
gravity, is counted twice in u(d), which errs on the side of agreement.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import sqrt

import numpy as np
from scipy.stats import chi2

from tumble.calibration.calibration_file import Calibration, calibration_from
from tumble.calibration.coverage import COVERAGE, shortfalls
from tumble.calibration.results import Parameter
from tumble.errors import InputError
from tumble.files import FilePath
from tumble.units import Array


@dataclass(frozen=True, kw_only=True, slots=True)
class Difference:
    """A parameter of both calibrations, SI; `u` is the standard uncertainty of first − second, None where one of them
    has none."""

    name: str
    unit: str
    first: float
    second: float
    u: float | None

    @property
    def value(self) -> float:
        """first − second."""
        return self.first - self.second

    @property
    def e_n(self) -> float | None:
        """The E_n number; None without uncertainties."""
        return self.value / (COVERAGE * self.u) if self.u else None


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Comparison:
    """All that two calibrations have in common, in the frame of both. `covariance` (m, m) is that of the differences;
    `chi_square` with its `degrees` of freedom and the `probability` that chance alone exceeds it; all three are None
    without covariances. `missing` are parameters of one calibration only; `remarks` what a user should know."""

    frame: str
    differences: tuple[Difference, ...]
    covariance: Array | None
    chi_square: float | None
    degrees: int | None
    probability: float | None
    missing: tuple[str, ...]
    remarks: tuple[str, ...]

    @property
    def agree(self) -> bool:
        """Whether there are E_n numbers and none exceeds 1 in size."""
        judged = [abs(d.e_n) for d in self.differences if d.e_n is not None]
        return bool(judged) and max(judged) <= 1.0


def compare_calibrations(first: Calibration | FilePath, second: Calibration | FilePath) -> Comparison:
    """Compare two calibrations parameter by parameter. The second is converted to the frame of the first where they
    differ; to the case only what is in it already can be compared, so then the first is converted.

    Raises InputError where they have no parameter in common, CalibrationError where they cannot be converted.

    >>> import tumble
    >>> folder = tumble.simulate_session("session", tumble.Setup.of(grade="mems", positions=12), seed=1)
    >>> found = tumble.compare_calibrations(tumble.calibrate(folder), tumble.calibrate(folder, method="staged"))
    >>> found.agree, len(found.differences)
    (True, 21)
    """
    first, second = calibration_from(first), calibration_from(second)
    frame = second.frame if first.frame == "case" else first.frame
    a, b = first.in_frame(frame), second.in_frame(frame)
    ours, theirs = ({p.name: p for p in c.parameters} for c in (a, b))
    common = [name for name in ours if name in theirs]
    if not common:
        raise InputError(
            f"compare: expected calibrations with parameters in common, found {len(ours)} and {len(theirs)} parameters "
            "and none in both; compare devices of one kind"
        )
    differences = tuple(_difference(ours[name], theirs[name]) for name in common)
    covariance = _covariance(a, b, common)
    chi_square, degrees, probability = _chi_square(np.array([d.value for d in differences]), covariance)
    return Comparison(
        frame=frame,
        differences=differences,
        covariance=covariance,
        chi_square=chi_square,
        degrees=degrees,
        probability=probability,
        missing=tuple(name for name in (*ours, *theirs) if name not in common),
        remarks=tuple(_remarks(first, second, frame)),
    )


def _difference(first: Parameter, second: Parameter) -> Difference:
    known = first.u is not None and second.u is not None
    u = sqrt((first.u or 0.0) ** 2 + (second.u or 0.0) ** 2) if known else None
    return Difference(name=first.name, unit=first.unit, first=first.value, second=second.value, u=u)


def _covariance(first: Calibration, second: Calibration, names: Sequence[str]) -> Array | None:
    """Covariance (m, m) of the differences of these parameters."""
    total = np.zeros((len(names), len(names)))
    for calibration in (first, second):
        if calibration.covariance is None:
            return None
        order = [p.name for p in calibration.parameters]
        chosen = [order.index(name) for name in names]
        total += calibration.covariance[np.ix_(chosen, chosen)]
    return total


def _chi_square(differences: Array, covariance: Array | None) -> tuple[float, int, float] | tuple[None, None, None]:
    """dᵀ C⁻¹ d in units of the uncertainties, the rank of C, and the probability that chance alone exceeds it."""
    if covariance is None or not np.diag(covariance).all():
        return None, None, None
    u = np.sqrt(np.diag(covariance))
    correlation = covariance / np.outer(u, u)
    scaled = differences / u
    rank = int(np.linalg.matrix_rank(correlation, hermitian=True))
    chi_square = float(scaled @ np.linalg.pinv(correlation, hermitian=True) @ scaled)
    return chi_square, rank, float(chi2.sf(chi_square, rank))


def _remarks(first: Calibration, second: Calibration, frame: str) -> list[str]:
    """What a reader must know about the two."""
    out = []
    if first.serial != second.serial:
        out.append(f"different devices: {first.serial} and {second.serial}")
    for which, calibration in (("first", first), ("second", second)):
        if calibration.frame != frame:
            out.append(f"the {which} was converted from the frame {calibration.frame!r} to {frame!r}")
        if not calibration.outcome.accepted:
            out.append(f"the {which} was not accepted: {'; '.join(calibration.outcome.reasons)}")
        if all(p.u is None for p in calibration.parameters):
            out.append(f"the {which} has no uncertainties: nothing is judged")
        out += [f"the {which}: {shortfall}" for shortfall in shortfalls(calibration)]
    digests = [c.provenance.get("log_sha256") for c in (first, second)]
    if digests[0] is not None and digests[0] == digests[1]:
        out.append("both come from the same log: their differences are smaller than their uncertainties allow")
    return out


# -------------------- as text --------------------
