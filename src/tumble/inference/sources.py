"""Sources of uncertainty, the covariance of an estimate by source, and errors common to a whole session.

Common errors do not appear in residuals:

Rounding. If noise does not cover the steps L of a channel, the error of the mean of many samples is a sawtooth of the
position of the true value between two steps (`tumble.reduction.noise.rounding`). Rests with equal readings have equal
errors, and so does a turn about another axis: the error is one of the bias. For rests whose true values scatter by s,
the part e^(−2π²s²/L²) of the error is common; for accelerometers in several attitudes, no part is. Readings scatter by
up to 1 + 2 Σ_k e^(−2π²k²σ²/L²) times as much as the true values between two steps. Where decimals round what a chip
has rounded before, the part by the chip decreases with the width √(σ² + s²) of the readings only as its square root.

Time base. A clock that is fast by ε makes every turn longer by ε, and the scale factors of gyros larger by ε, unless
their readings are increments of angle. Accelerometers are compared with gravity, independently of time; but readings
that are increments of velocity divided by their interval are smaller by ε. Biases, delays and levers change by a
negligible ε of themselves.

Earth's rate. In one attitude it is constant in the body and adds to the biases of the gyros. Its vertical part is known
if the latitude is; its horizontal part, Ω cos φ, has an unknown heading, over which its mean is zero and its covariance
½ Ω² cos² φ (1 − u uᵀ), however many rests there are.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from tumble.earth import EARTH_RATE
from tumble.rotation import onto_body, unit_vector
from tumble.sensors.instrument import Instrument
from tumble.sensors.parameters import group_name
from tumble.units import Array

if TYPE_CHECKING:
    from tumble.reduction.noise.rounding import Rounding
    from tumble.reduction.observations import Observations

Evaluation = Literal["A", "B"]  # of a standard uncertainty: by statistics of this recording, or otherwise
_WORDS = tomllib.loads((Path(__file__).parent / "sources.toml").read_text(encoding="utf-8"))  # by evaluation


@dataclass(frozen=True, kw_only=True, slots=True)
class Source:
    """Source of uncertainty.

    `u` is its standard uncertainty in `unit`, None if it has several quantities; `dof` are degrees of freedom, None if
    many; `basis` is the origin of the prior size of a group."""

    name: str
    words: str
    type: Evaluation
    u: float | None = None
    unit: str = ""
    dof: float | None = None
    basis: str = ""

    @property
    def distribution(self) -> str:
        """Distribution of the error: rectangular for rounding, t if u has degrees of freedom, else normal."""
        return "rectangular" if self.name == "rounding" else "normal" if self.dof is None else "t"


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class UncertaintyBudget:
    """Covariance of an estimate by source: the sum of `covariances` (S, m, m), SI, of S `sources`."""

    sources: tuple[Source, ...]
    covariances: Array

    def carried(self, jacobian: Array) -> UncertaintyBudget:
        """Return the budget of functions of the parameters with this `jacobian` (q, m)."""
        return replace(self, covariances=jacobian @ self.covariances @ jacobian.T)

    def with_source(self, source: Source, covariance: Array) -> UncertaintyBudget:
        """Return the budget with another source, unless its covariance (m, m) is zero."""
        if not covariance.any():
            return self
        covariances = np.concatenate([self.covariances, covariance[None]])
        return UncertaintyBudget(sources=(*self.sources, source), covariances=covariances)

    def variances_from(self, name: str) -> Array:
        """Return the variances (m,) of the parameters from the sources with a name; zero without any."""
        rows = [i for i, each in enumerate(self.sources) if each.name == name]
        return np.asarray(np.diagonal(self.covariances[rows], axis1=1, axis2=2).sum(axis=0))


def source(name: str, u: float | None = None, unit: str = "", dof: float | None = None) -> Source:
    """Return the source with a name in `sources.toml`, or that of the prior of a group."""
    group = name.removeprefix("prior.")
    evaluation: Evaluation = "A" if name in _WORDS["A"] else "B"
    words = _WORDS[evaluation].get(name, f"usual size of {group}")
    return Source(name=name, words=words, type=evaluation, u=u, unit=unit, dof=dof)


def fit_budget(covariance: Array, by_gravity: Array, gravity_u: float, degrees: float) -> UncertaintyBudget:
    """Return the budget of a fit with uncertainties from its residuals.

    Parameters
    ----------
    covariance : (m, m)
        Covariance of the parameters.
    by_gravity : (m,)
        Change of the parameters by one standard uncertainty of gravity.
    gravity_u
        Standard uncertainty of gravity, m/s².
    degrees
        Degrees of freedom of the residuals.
    """
    gravity_part = np.outer(by_gravity, by_gravity)
    budget = UncertaintyBudget(
        sources=(source("fit", dof=degrees if np.isfinite(degrees) else None),),
        covariances=(covariance - gravity_part)[None],
    )
    return budget.with_source(source("gravity", gravity_u, "m/s^2"), gravity_part)


_HARMONICS = np.arange(1, 40)
_ONE_EDGE = 0.5 / np.sqrt(np.pi)  # steps: width of normal readings up to which one edge between two steps decides


def common_covariances(observations: Observations, instrument: Instrument) -> dict[str, Array]:
    """Return covariances (m, m) of the parameters by rounding, time base (`clock`) and, in one attitude, `earth`."""
    by_clock, u = clock_errors(instrument.names, observations.by_clock), np.zeros(len(instrument.names))
    for block, readings in ((instrument.accel, observations.rests.accel), (instrument.gyro, observations.rests.gyro)):
        if block is not None and block.kind in observations.rounding:
            size = common_rounding(observations.rounding[block.kind], readings)
            u[instrument.group_columns[f"{block.kind}.bias"]] = size[block.channels]
    common = {"rounding": np.diag(u**2), "clock": np.outer(by_clock, by_clock)}
    if instrument.gyro is not None and observations.one_attitude:
        up = unit_vector(onto_body(observations.accel_block.axes) @ observations.rests.accel.mean(axis=0))
        axes = np.zeros((len(u), 3))
        axes[instrument.group_columns["gyro.bias"]] = instrument.gyro.axes[instrument.gyro.channels]
        common["earth"] = axes @ earth_at_rest(up, observations.site.latitude)[1] @ axes.T
    return common


def earth_at_rest(up: Array | None, latitude: float | None) -> tuple[Array, Array]:
    """Return mean (3,) and covariance (3, 3) of the Earth's rate in the body at rest, rad/s, over unknown headings.

    Without a vertical (3,) or a latitude, rad, they are those over all directions."""
    if up is None or latitude is None:
        return np.zeros(3), EARTH_RATE**2 / 3.0 * np.eye(3)
    level = 0.5 * (EARTH_RATE * np.cos(latitude)) ** 2 * (np.eye(3) - np.outer(up, up))
    return EARTH_RATE * np.sin(latitude) * up, level


def common_rounding(rounding: Rounding, readings: Array) -> Array:
    """Return the standard uncertainty (n,) by rounding that is common to the mean readings (N, n) of all rests."""
    step = np.where(rounding.step > 0.0, rounding.step, 1.0)
    smoothed = np.exp(-2.0 * (np.pi * np.outer(rounding.noise / step, _HARMONICS)) ** 2)
    scatter = readings.std(axis=0) / step / (1.0 + 2.0 * smoothed.sum(axis=1))
    width = np.maximum(np.hypot(rounding.noise / step, scatter), _ONE_EDGE)
    by_position = (rounding.common_u**2 - np.square(rounding.decimal_u)) * np.exp(-4.0 * (np.pi * scatter) ** 2)
    return np.asarray(np.sqrt(by_position + np.square(rounding.decimal_u) * _ONE_EDGE / width))


def clock_effects(clock_u: float, increments: Mapping[str, bool]) -> dict[str, float]:
    """Return the changes of parameters, by group, by one relative standard uncertainty of the time base.

    `increments` is True for each kind of sensor whose readings are increments."""
    sizes = {"gyro.scale": clock_u * (not increments.get("gyro", True)), "accel.scale": -clock_u * increments["accel"]}
    return {group: size for group, size in sizes.items() if size != 0.0}


def clock_errors(names: Sequence[str], by_clock: Mapping[str, float]) -> Array:
    """Return the changes (m,) of parameters of these names from those by group or by name."""
    return np.array([by_clock.get(group_name(name), 0.0) + by_clock.get(name, 0.0) for name in names])
