"""Two calibrations compared: differences in units of their combined uncertainty, in one frame.

With d = second − first, how the second differs from the first or what has changed since,

    u(d)² = u₁² + u₂² − 2 Σ g₁ g₂,    U(d) = t₉₅.₄₅(ν) u(d),    E_n = d / U(d)

(ISO/IEC 17043, annex B, with ν of Welch and Satterthwaite in place of k = 2: `tumble.result.coverage`). g₁ and g₂
are what one standard uncertainty of what both share changes in each, gravity, the time base and what only priors say
of the device (`tumble.result.shared_errors`): the error of these is no part of a difference. |E_n| ≤ 1 is
agreement of a parameter. One honest value in twenty-two lies beyond, so that of 21 parameters one or two may. All m
agree where chance makes the largest of them in CHANCE of all comparisons or oftener: Bonferroni, Student's t.

χ² = dᵀ C⁻¹ d with C = C₁ + C₂ − Σ (g₁g₂ᵀ + g₂g₁ᵀ) judges all m of them together, correlations included; what
neither has learned anything of is left out. Where u was
estimated with ν degrees of freedom, the fewest of all differences, χ²/m is F distributed with m and ν (Hotelling).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import inf, sqrt
from pathlib import Path
from typing import Any, Protocol, Self

import numpy as np

from tumble.brief import Brief
from tumble.errors import InputError
from tumble.files import FilePath
from tumble.result.calibration import Calibration, calibration_from
from tumble.result.coverage import UNLEARNED, apart, expanded_of, welch_satterthwaite
from tumble.result.file import text_of
from tumble.result.further import remarks as remarks_of
from tumble.result.shared_errors import shared_errors
from tumble.scipy_compiled import special
from tumble.units import Array
from tumble.use.foreign import IMU_TK, KALIBR, foreign_calibration

CHANCE = 0.01
"""How often the largest difference of two calibrations that agree is called one."""
LEAST_PROBABILITY = 1e-3
"""Two calibrations contradict each other where chance exceeds their χ² less often than this."""


class KnownValue(Protocol):
    """A value as it is known, SI, in a calibration or over time."""

    @property
    def value(self) -> float: ...
    @property
    def u(self) -> float | None: ...
    @property
    def dof(self) -> float | None: ...


@dataclass(frozen=True, kw_only=True, slots=True)
class Difference:
    """A parameter of both calibrations, SI; `u` is the standard uncertainty of their difference without what both
    share, None where one of them has none, 0 where both know no more than their prior; `dof` its degrees of freedom,
    None where it is known."""

    name: str
    unit: str
    first: float
    second: float
    u: float | None
    dof: float | None = None

    @classmethod
    def between(cls, first: KnownValue, second: KnownValue, g: Array, h: Array, **others: Any) -> Self:
        """The difference of a parameter of which what both share changes the first by `g` (k,), the second by `h` (k,);
        `others` are the other fields."""
        parts: list[tuple[float, float | None]] = [
            (float(((g - h) ** 2).sum()), None),
            apart(first.u, first.dof, g.tolist()),
            apart(second.u, second.dof, h.tolist()),
        ]
        variance = sum(variance for variance, _ in parts)
        if variance < UNLEARNED * ((first.u or 0.0) ** 2 + (second.u or 0.0) ** 2):
            variance = 0.0
        known = first.u is not None and second.u is not None
        u, dof = (sqrt(variance), welch_satterthwaite(parts)) if known else (None, None)
        return cls(first=first.value, second=second.value, u=u, dof=dof, **others)

    @property
    def value(self) -> float:
        """second − first."""
        return self.second - self.first

    @property
    def expanded(self) -> float | None:
        """U, SI; None without uncertainties."""
        return None if self.u is None else expanded_of(self.u, self.dof)

    @property
    def e_n(self) -> float | None:
        """The E_n number, above 1 where the two contradict each other; None without uncertainties that have one."""
        return self.value / self.expanded if self.expanded else None

    @property
    def by_chance(self) -> float | None:
        """How probable chance alone makes so large a difference; None where there is no E_n number."""
        if self.e_n is None or not self.u:
            return None
        return float(2.0 * special.stdtr(inf if self.dof is None else self.dof, -abs(self.value) / self.u))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False, repr=False)
class Comparison(Brief):
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
        """Whether there are E_n numbers, and neither the largest of them nor χ² is beyond chance."""
        return self.largest_by_chance is not None and not self.changed and not self.contradicts

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why they do not agree."""
        return () if self.agree else ("by more than chance and their uncertainties make",)

    @property
    def largest_by_chance(self) -> float | None:
        """How probable chance alone makes one of so many differences as large as the largest; None without any."""
        judged = [d.by_chance for d in self.differences if d.by_chance is not None]
        return min(1.0, len(judged) * min(judged)) if judged else None

    @property
    def changed(self) -> list[str]:
        """The parameters whose difference by itself is beyond chance."""
        judged = [d for d in self.differences if d.by_chance is not None]
        return [d.name for d in judged if len(judged) * (d.by_chance or 0.0) < CHANCE]

    @property
    def contradicts(self) -> bool:
        """Whether chance makes so large a χ² too seldom."""
        return self.probability is not None and self.probability < LEAST_PROBABILITY


def compare_calibrations(
    first: Calibration | FilePath, second: Calibration | FilePath, *, gyro: FilePath | None = None
) -> Comparison:
    """Compare two calibrations parameter by parameter. The second is converted to the frame of the first where they
    differ; to the case only what is in it already can be compared, so then the first is converted.

    The second may be the file of a result of Kalibr, or of imu_tk, whose gyros are in another file, `gyro`: then the
    first is taken into the frame of the accelerometers.

    Raises InputError where they have no parameter in common, CalibrationError where they cannot be converted.

    >>> import tumble
    >>> folder = tumble.simulate_session("session", tumble.Setup.of(grade="mems", positions=12), seed=1)
    >>> found = tumble.compare_calibrations(tumble.calibrate(folder), tumble.calibrate(folder, method="ellipsoid"))
    >>> found.agree, len(found.differences)
    (True, 9)
    """
    first = calibration_from(first)
    if not isinstance(second, Calibration) and not text_of(Path(second)).lstrip().startswith("{"):  # no JSON
        second = foreign_calibration(second, gyro, first)
    elif gyro is not None:
        raise InputError(f"{gyro}: expected a file of gyros beside one of imu_tk only, found it beside a calibration")
    else:
        second = calibration_from(second)
    foreign = second.method in (KALIBR, IMU_TK)
    frame = second.frame if first.frame == "case" or foreign else first.frame
    a, b = first.in_frame(frame), second.in_frame(frame)
    common = [name for name in a if name in b]
    if not common:
        raise InputError(
            f"compare: expected calibrations with parameters in common, found {len(a)} and {len(b)} parameters and "
            "none in both; compare devices of one kind"
        )
    sources = shared_errors(a, b)
    shared = []  # what one standard uncertainty of each error that both share changes in the parameters, (m, k)
    for k, calibration in enumerate((a, b)):
        order, changes = list(calibration), [np.zeros((len(calibration), 0)), *(each[k] for each in sources.values())]
        shared.append(np.concatenate(changes, axis=1)[[order.index(name) for name in common]])
    differences = tuple(
        Difference.between(a[name], b[name], g, h, name=name, unit=a[name].unit)
        for name, g, h in zip(common, *shared, strict=True)
    )
    covariances, covariance = (a.covariance_of(common), b.covariance_of(common)), None
    if covariances[0] is not None and covariances[1] is not None:
        covariance = covariances[0] + covariances[1] - shared[0] @ shared[1].T - shared[1] @ shared[0].T
    learned = np.array([d.u != 0.0 for d in differences])
    chi_square, degrees, probability = _chi_square(
        np.array([d.value for d in differences])[learned],
        None if covariance is None else covariance[np.ix_(learned, learned)],
        min((d.dof for d in differences if d.u and d.dof is not None), default=None),
    )
    remarks = list(_remarks(first, second, frame))
    if sources:
        remarks.append(f"the same error of {' and of '.join(sources)} in both is no part of their differences")
    return Comparison(
        frame=frame,
        differences=differences,
        covariance=covariance,
        chi_square=chi_square,
        degrees=degrees,
        probability=probability,
        missing=tuple(name for name in (*a, *b) if name not in common),
        remarks=(*remarks, *(second.notes if foreign else ())),
    )


def _chi_square(
    differences: Array, covariance: Array | None, fewest: float | None
) -> tuple[float, int, float] | tuple[None, None, None]:
    """dᵀ C⁻¹ d in units of the uncertainties, the rank of C, and the probability that chance alone exceeds it, C being
    known (None) or estimated with the `fewest` degrees of freedom."""
    if covariance is None or np.any(np.diag(covariance) <= 0.0):
        return None, None, None
    u = np.sqrt(np.diag(covariance))
    correlation, scaled = covariance / np.outer(u, u), differences / u
    rank = int(np.linalg.matrix_rank(correlation, hermitian=True))
    chi_square = max(0.0, float(scaled @ np.linalg.pinv(correlation, hermitian=True) @ scaled))
    if fewest is None:
        return chi_square, rank, float(special.chdtrc(rank, chi_square))
    return chi_square, rank, float(special.fdtrc(rank, fewest, chi_square / rank))


def _remarks(first: Calibration, second: Calibration, frame: str) -> Iterator[str]:
    """What a reader must know about the two."""
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
    logs = [calibration.provenance.get("log_sha256") for calibration in (first, second)]
    if logs[0] is not None and logs[0] == logs[1]:
        yield "both come from the same log: their differences are smaller than their uncertainties allow"
