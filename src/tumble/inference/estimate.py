"""Result types of all methods.

A method always returns an `Estimate`. A parameter that the data do not determine has no value and is named in the
outcome; if data do not fit, the outcome names the rest or turn and its distance from the fit.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, ClassVar, Literal

import numpy as np
import scipy

from tumble.brief import Brief
from tumble.inference.prediction import Prediction
from tumble.inference.sources import UncertaintyBudget
from tumble.sensors.instrument import Instrument
from tumble.sensors.model import SensorModel
from tumble.sensors.parameters import LINEAR
from tumble.units import Array, BoolArray

if TYPE_CHECKING:
    from tumble.inference.linearisation import Linearisation
    from tumble.inference.magnetic_estimate import MagnetometerEstimate

# Least ratio of the limit of a parameter to its u for the parameter to be determined. One with a larger u drifts during
# the iteration, and changes others.
DETERMINED = 10.0
UNOBSERVABLE_SHARE = 1e-3  # part of a parameter in the null space, in units of its spread, that makes it unobservable
FIT_SIGMAS = 5.0  # distance from the fit beyond which a rest or turn does not fit
KEPT = 1e-3  # least learned fraction of a group on which a session has information


Verdict = Literal["accepted", "accepted with scatter", "not accepted"]


@dataclass(frozen=True, kw_only=True, slots=True)
class Judgement:
    """Judgement on the use of a result.

    `reasons` against its use and `remarks` on residuals beyond the noise are sentences with cause and remedy."""

    json_fields: ClassVar[tuple[str, ...]] = ("verdict", "reasons", "remarks")

    reasons: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()

    @property
    def verdict(self) -> Verdict:
        """Verdict: not accepted if there is a reason, accepted with scatter if there is a remark."""
        if self.reasons:
            return "not accepted"
        return "accepted with scatter" if self.remarks else "accepted"

    @property
    def accepted(self) -> bool:
        """True if there is no reason against it."""
        return not self.reasons

    def __bool__(self) -> bool:
        """Return `accepted`."""
        return self.accepted


@dataclass(frozen=True, kw_only=True, slots=True)
class Outcome(Judgement):
    """Judgement on an estimate as a whole and by kind of sensor and group of parameters.

    `reasons` and `remarks` are all sentences, with the sensors at fault first. `concerns` has the kinds of sensors
    ("gyro") or groups of parameters ("gyro.bias") of a sentence that does not concern the whole estimate, so that
    accelerometers remain usable with bad gyros, and scale factors with bad biases. `unsteady` are the remarks that
    parameters changed while they were recorded, or from launch to launch, by more than is usual."""

    json_fields = (
        *("accepted", "verdict", "reasons", "remarks", "unobservable", "concerns", "unsteady"),
        *("accel", "gyro", "groups"),
    )

    unobservable: tuple[str, ...] = ()
    concerns: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    unsteady: tuple[str, ...] = ()

    @property
    def accel(self) -> Judgement:
        """Judgement on the accelerometers."""
        return self.of("accel")

    @property
    def gyro(self) -> Judgement:
        """Judgement on the gyros."""
        return self.of("gyro")

    def of(self, part: str) -> Judgement:
        """Return the judgement on a kind of sensors or a group of parameters.

        A sentence on a kind concerns all its groups, and a sentence on a group its kind."""

        def concerns(sentence: str) -> bool:
            parts = self.concerns.get(sentence, (part,))
            return any(f"{part}.".startswith(f"{other}.") or other.startswith(f"{part}.") for other in parts)

        return Judgement(reasons=tuple(filter(concerns, self.reasons)), remarks=tuple(filter(concerns, self.remarks)))

    def is_unsteady(self, part: str) -> bool:
        """Return whether a kind of sensors or a group of parameters changed by more than is usual."""
        return not {*self.of(part).remarks}.isdisjoint(self.unsteady)

    @property
    def groups(self) -> dict[str, Judgement]:
        """Judgements on groups of the linear model that differ from those on their kind of sensors."""
        judged = {group.name: (self.of(group.name), self.of(group.kind)) for group in LINEAR}
        return {name: by_group for name, (by_group, by_kind) in judged.items() if by_group != by_kind}


def chance_of(chi_square: float, degrees: float) -> float:
    """Return the probability that chi-square exceeds a value by chance; 1 without degrees of freedom."""
    return float(scipy.special.chdtrc(degrees, chi_square)) if degrees > 0.0 else 1.0


@dataclass(frozen=True, kw_only=True, slots=True)
class Fit:
    """Chi-square of a group of residuals.

    `degrees` of freedom may be fractional; `scatter` is the standard deviation, in `unit`, that was added to the noise
    within rests."""

    json_fields: ClassVar = ("chi_square", "degrees", "probability", "scatter", "unit")

    chi_square: float
    degrees: float
    scatter: float
    unit: str

    @property
    def probability(self) -> float:
        """Probability of a larger chi-square by chance."""
        return chance_of(self.chi_square, self.degrees)


@dataclass(frozen=True, kw_only=True, slots=True)
class GroupFinding:
    """Information of a session on a group of parameters beyond the linear model.

    `kept` is True if there is any, `prior` the usual prior standard deviation, SI, `prior_widened` its factor at the
    maximum, and `learned` the fraction 1 − u²/s² of each parameter, s being the widened standard deviation."""

    name: str
    kept: bool
    prior: float
    prior_widened: float
    learned: tuple[float, ...]

    @staticmethod
    def of(name: str, usual: Array, size: Array, variance: Array) -> GroupFinding:
        """Return the finding on parameters (k,) with these variances, prior standard deviations and usual ones."""
        learned = np.clip(1.0 - variance / size**2, 0.0, 1.0)
        return GroupFinding(
            name=name,
            kept=bool(learned.max() > KEPT),
            prior=float(usual[0]),
            prior_widened=float(size[0] / usual[0]),
            learned=tuple(learned.tolist()),
        )


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class OwnEstimate:
    """Parameters of each of several sessions: names and SI units (q,), values and u (S, q), and widened priors (q,)."""

    names: tuple[str, ...]
    units: tuple[str, ...]
    values: Array
    u: Array
    priors: Array


@dataclass(frozen=True, kw_only=True, slots=True)
class HyperparameterEstimate:
    """Estimate of a hyperparameter: median, limits of the middle 68 %, and the usual value, the centre of its prior."""

    name: str
    unit: str
    words: str
    value: float
    low: float
    high: float
    usual: float

    @property
    def root_mean_square(self) -> float:
        """Approximate root mean square over the posterior, from the three values."""
        return float(np.sqrt((self.low**2 + self.value**2 + self.high**2) / 3.0))


@dataclass(frozen=True, kw_only=True, slots=True)
class Integral:
    """Quality of the integral over the hyperparameters.

    Number of points, their effective number, the shape of the Pareto distribution of their weights, and the largest
    sampling error of a u, relative, or of a value, in u."""

    points: int
    effective: float
    pareto: float
    u_error: float = 0.0


@dataclass(frozen=True, kw_only=True, slots=True)
class ProcessBias:
    """Bias of a sensor as the mean of its in-run process, SI.

    `u` is that of the mean, `next_u` that of a prediction of the bias at another time, which includes the process."""

    name: str
    value: float
    u: float
    next_u: float


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Omitted:
    """Outliers left out: rests by their accelerometers (N,), rests by their gyros (N,), and turns (K,)."""

    accel: BoolArray
    gyro: BoolArray
    turn: BoolArray

    @property
    def any(self) -> bool:
        """True if there are any."""
        return bool(self.accel.any() or self.gyro.any() or self.turn.any())


@dataclass(frozen=True, kw_only=True, slots=True, eq=False, repr=False)
class Estimate(Brief):
    """Parameter values with covariance, and the evidence for them.

    Parameters
    ----------
    method, names, units
        Name of the method, and names and SI units of the parameters.
    values, covariance : (m,) and (m, m)
        Parameters and their covariance.
    observable, null : (m,) and (q, m)
        True for parameters that the data determine, the only ones with a meaningful value; and the combinations that
        they do not determine, in units of the spreads.
    accel, gyro
        Models of the sensors.
    rest_residual : (N,)
        |corrected reading| − g at each rest, m/s².
    rest_sigmas, gyro_rest_sigmas, turn_sigmas : (N,), (N,) and (K,)
        Distances from the fit of each rest, of its gyros alone (empty if not judged), and of each turn, as Gaussian
        sigmas.
    increments
        Steps of the parameters in each iteration.
    fits
        Chi-squares by group of residuals.
    converged
        True if the last step was negligible.
    reasons, remarks
        Sentences of the method against the result, and on residuals beyond the noise.
    instrument
        Instrument of the parameters, if it has groups beyond the linear model.
    groups
        Findings on these groups.
    degrees : (m,)
        Degrees of freedom of the u of the parameters, if the method computes them.
    prediction
        Uncertainty of corrected readings.
    linearised
        Linearisation at the estimate; for methods without a likelihood, the one by which they are judged.
    own
        Parameters of each of several sessions.
    hyperparameters, integral
        Estimates of the hyperparameters, and quality of the integral over them.
    of_type
        Standard deviations, SI, of the prior from other units of the type, by parameter.
    process_bias
        Biases as means of their processes, while the parameters are means over the session.
    budget
        Covariance by source.
    magnetometer
        Estimate of a magnetometer, or why there is none; None without one.
    left_out
        Outliers left out, if the method does so.
    """

    method: str
    names: tuple[str, ...]
    units: tuple[str, ...]
    values: Array
    covariance: Array
    observable: BoolArray
    null: Array
    accel: SensorModel
    gyro: SensorModel | None
    rest_residual: Array
    rest_sigmas: Array
    turn_sigmas: Array
    increments: tuple[Array, ...]
    fits: Mapping[str, Fit]
    converged: bool
    reasons: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()
    instrument: Instrument | None = None
    groups: tuple[GroupFinding, ...] = ()
    degrees: Array | None = None
    prediction: Prediction | None = None
    gyro_rest_sigmas: Array = field(default_factory=lambda: np.empty(0))
    linearised: Linearisation | None = None
    own: OwnEstimate | None = None
    hyperparameters: tuple[HyperparameterEstimate, ...] = ()
    of_type: Mapping[str, float] = field(default_factory=dict)
    integral: Integral | None = None
    process_bias: tuple[ProcessBias, ...] = ()
    budget: UncertaintyBudget | None = None
    magnetometer: MagnetometerEstimate | str | None = None
    left_out: Omitted | None = None

    @property
    def unobservable(self) -> tuple[str, ...]:
        """Names of the parameters that the data do not determine."""
        return tuple(name for name, observable in zip(self.names, self.observable, strict=True) if not observable)

    @property
    def u(self) -> Array:
        """Standard uncertainties."""
        return np.sqrt(np.diag(self.covariance))
