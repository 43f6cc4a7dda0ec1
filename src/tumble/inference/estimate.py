"""What every method returns.

An `Estimate` always comes back: when the data do not determine a parameter it has no value, and the outcome
names it; when they do not fit, the outcome says which rest or turn, and by how much.
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

DETERMINED = 10.0
"""How many times better than the spreads the data must know a combination of parameters for it to count as seen. One
that is hardly better known wanders while the estimate is iterated, and takes the others with it."""

UNOBSERVABLE_SHARE = 1e-3
"""A parameter is unobservable when more than this part of it (in units of its spread) is in the null space."""

FIT_SIGMAS = 5.0
"""A rest or turn further than this from the fit does not fit."""

KEPT = 1e-3
"""Learned fraction from which a session, or a programme, says anything of a group."""


Verdict = Literal["accepted", "accepted with scatter", "not accepted"]


@dataclass(frozen=True, kw_only=True, slots=True)
class Judgement:
    """Whether a result can be used: `reasons` against it, `remarks` on residuals that the noise does not explain, each
    a sentence with cause and remedy."""

    json_fields: ClassVar[tuple[str, ...]] = ("verdict", "reasons", "remarks")

    reasons: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()

    @property
    def verdict(self) -> Verdict:
        """Not accepted where there is a reason, with scatter where there is a remark."""
        if self.reasons:
            return "not accepted"
        return "accepted with scatter" if self.remarks else "accepted"

    @property
    def accepted(self) -> bool:
        """No reason against it."""
        return not self.reasons

    def __bool__(self) -> bool:
        """Whether it is accepted."""
        return self.accepted


@dataclass(frozen=True, kw_only=True, slots=True)
class Outcome(Judgement):
    """Whether an estimate can be used, and if not, why. `reasons` and `remarks` are all there are; those that do not
    concern everything have in `concerns` the kinds of sensors ("gyro") or groups of parameters ("gyro.bias") that they
    do: good accelerometers are not lost to bad gyros, and good scale factors not to bad biases. Of a verdict those at
    fault come first."""

    json_fields = ("accepted", "verdict", "reasons", "remarks", "unobservable", "concerns", "accel", "gyro", "groups")

    unobservable: tuple[str, ...] = ()
    concerns: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    @property
    def accel(self) -> Judgement:
        """Whether the accelerometers can be used."""
        return self.of("accel")

    @property
    def gyro(self) -> Judgement:
        """Whether the gyros can be used."""
        return self.of("gyro")

    def of(self, part: str) -> Judgement:
        """Whether a kind of sensors or a group of their parameters can be used: a group is what its kind is where a
        sentence concerns the kind, and a kind where one concerns a group of it."""

        def concerned(sentence: str) -> bool:
            parts = self.concerns.get(sentence, (part,))
            return any(f"{part}.".startswith(f"{each}.") or each.startswith(f"{part}.") for each in parts)

        return Judgement(reasons=tuple(filter(concerned, self.reasons)), remarks=tuple(filter(concerned, self.remarks)))

    @property
    def groups(self) -> dict[str, Judgement]:
        """The groups of the linear model that are judged otherwise than their kind of sensors."""
        judged = ((group.name, self.of(group.kind), self.of(group.name)) for group in LINEAR)
        return {name: of_group for name, of_kind, of_group in judged if of_group != of_kind}


def chance_of(chi_square: float, degrees: float) -> float:
    """Probability that chance alone exceeds a chi-square of so many degrees of freedom."""
    return float(scipy.special.chdtrc(degrees, chi_square)) if degrees > 0.0 else 1.0


@dataclass(frozen=True, kw_only=True, slots=True)
class Fit:
    """Chi-square of a group of residuals with its degrees of freedom and the scatter (SI) that was added to the
    noise within rests to explain it; `unit` is m/s^2, rad/s or rad."""

    json_fields: ClassVar = ("chi_square", "degrees", "probability", "scatter", "unit")

    chi_square: float
    degrees: float
    scatter: float
    unit: str

    @property
    def probability(self) -> float:
        """Probability that chance alone exceeds this chi-square."""
        return chance_of(self.chi_square, self.degrees)


@dataclass(frozen=True, kw_only=True, slots=True)
class GroupFinding:
    """A group of parameters beyond the linear model: whether the session says anything of it (`kept`), the standard
    deviation of its prior, SI, how many times that had to be widened (`prior_widened`), and the `learned` fraction
    1 − u²/s² of each parameter, s being the widened prior."""

    name: str
    kept: bool
    prior: float
    prior_widened: float
    learned: tuple[float, ...]

    @staticmethod
    def of(name: str, usual: Array, size: Array, variance: Array) -> GroupFinding:
        """Of a group whose parameters (k,) have these variances beside a prior of a size, where another is usual."""
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
    """What each of several sessions has of its own: names and SI units (q,), values and standard uncertainties (S, q),
    and the priors (q,), as widened."""

    names: tuple[str, ...]
    units: tuple[str, ...]
    values: Array
    u: Array
    priors: Array


@dataclass(frozen=True, kw_only=True, slots=True)
class HyperparameterEstimate:
    """What the session says of something that the model does not know about itself: name, SI unit and words, the value
    and the limits of its middle 68 %, and the usual value, about which its prior is."""

    name: str
    unit: str
    words: str
    value: float
    low: float
    high: float
    usual: float

    @property
    def root_mean_square(self) -> float:
        """About the root of the mean of its square over the posterior, by the three values."""
        return float(np.sqrt((self.low**2 + self.value**2 + self.high**2) / 3.0))


@dataclass(frozen=True, kw_only=True, slots=True)
class Integral:
    """How the posterior was integrated over the hyperparameters: at how many points, their effective number, the shape
    of the Pareto distribution of their weights, and the largest relative error of a u by the points, estimated from two
    independent sets of them."""

    points: int
    effective: float
    pareto: float
    u_error: float = 0.0


@dataclass(frozen=True, kw_only=True, slots=True)
class ProcessBias:
    """The bias of a sensor as the mean of its process, about which that of the next minute or of another day is: its
    value and standard uncertainty, SI, and u of the bias that is met next, the process's own spread included."""

    name: str
    value: float
    u: float
    next_u: float


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Omitted:
    """What was left out because it does not fit: rests by their accelerometers (N,), by their gyros (N,), and turns
    (K,)."""

    accel: BoolArray
    gyro: BoolArray
    turn: BoolArray

    @property
    def any(self) -> bool:
        """Whether something was."""
        return bool(self.accel.any() or self.gyro.any() or self.turn.any())


@dataclass(frozen=True, kw_only=True, slots=True, eq=False, repr=False)
class Estimate(Brief):
    """Parameter values with covariance in the order of `names`; `observable` marks those the data determine, and
    only these mean anything; `null` (q, m) are the combinations they do not, in units of the spreads.
    `converged` says whether the last step was negligible. `rest_residual` (N,) is |corrected reading| − g, m/s²;
    `rest_sigmas` and `turn_sigmas` say how far each rest and turn is from the fit. `increments` are the parameter
    changes of each iteration, `fits` the chi-squares by what they judge."""

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
    """What the method itself has against the result."""
    remarks: tuple[str, ...] = ()
    """What it says of residuals that the noise does not explain."""
    instrument: Instrument | None = None
    """The instrument whose parameters these are, where it has groups beyond the linear model."""
    groups: tuple[GroupFinding, ...] = ()
    degrees: Array | None = None
    """Degrees of freedom (m,) behind the u of the parameters, where the method knows them."""
    prediction: Prediction | None = None
    """What corrected readings are known to."""
    gyro_rest_sigmas: Array = field(default_factory=lambda: np.empty(0))
    """How far the gyros alone are from the fit at each rest (N,); empty where the method does not judge them."""
    linearised: Linearisation | None = None
    """The likelihood about the estimate, or where the method has none, that by which it is judged."""
    own: OwnEstimate | None = None
    """Of several sessions, what each has of its own."""
    hyperparameters: tuple[HyperparameterEstimate, ...] = ()
    """What the model did not know about itself."""
    of_type: Mapping[str, float] = field(default_factory=dict)
    """Standard deviation, SI, of what other units of the type of the device say of parameters, by name."""
    integral: Integral | None = None
    """How that was integrated over."""
    process_bias: tuple[ProcessBias, ...] = ()
    """The biases as the means of their processes; the parameters are those of the session."""
    budget: UncertaintyBudget | None = None
    """The covariance by source."""
    magnetometer: MagnetometerEstimate | str | None = None
    """What it says of a magnetometer, or why that is not in it; None without one."""
    left_out: Omitted | None = None
    """What was left out because it does not fit, where the method leaves out."""

    @property
    def unobservable(self) -> tuple[str, ...]:
        """Names of the parameters the data do not determine."""
        return tuple(name for name, seen in zip(self.names, self.observable, strict=True) if not seen)

    @property
    def u(self) -> Array:
        """Standard uncertainties."""
        return np.sqrt(np.diag(self.covariance))
