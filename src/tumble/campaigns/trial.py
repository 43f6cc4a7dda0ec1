"""One trial of a campaign: a device is drawn and put through a programme, and calibrated by every method.

The random numbers of trial i come from the i-th child of the seed (numpy.random.SeedSequence), so that its rows depend
on the seed and i alone. In a trial all methods see the same observations.

Where the observations come from. "observations": directly from the truth, without a log (`simulated_observations`),
about a hundred times as fast; noise covariances are the true ones. "log": from a sampled log through the whole chain,
finding rests, matching them and estimating the noise included: for what those may spoil.

A trial of rests alone (`statics_rows`) is a block of BLOCK triads at once, and its row holds their moments.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any, Literal

import numpy as np

from tumble.campaigns.engine import Row
from tumble.campaigns.triads import PARAMETERS, fit_statics
from tumble.diagnosis.verdict import verdict
from tumble.errors import InputError
from tumble.inference.estimate import DETERMINED
from tumble.inference.likelihood import Point, Problem
from tumble.inference.linearisation import linearised
from tumble.inference.turns_about import TurnsAbout
from tumble.planning.bounds import bound_by, components_of
from tumble.planning.setup import NAMES, Setup
from tumble.recording.session import Session
from tumble.reduction.observations import Observations
from tumble.rotation import rotation_matrix, unit_vector
from tumble.run.calibrate import ITERATED_METHODS, METHODS, Method, calibrate
from tumble.sensors.model import triad_model
from tumble.sensors.parameters import limits_of
from tumble.simulation.observations import simulate_observations
from tumble.simulation.scenario import Scenario, itinerary, scenario_of
from tumble.simulation.session import session_in_memory
from tumble.units import Array

Source = Literal["observations", "log"]

BLOCK = 4096
"""Triads in a trial of rests alone."""

NEGLIGIBLE = 1e-2
"""Of its uncertainty: a last step that means nothing."""


Cell = Mapping[str, Any]
"""A point of a campaign's grid: by axis the words of `Setup.of`, which makes the set-up of it."""


def stream(seed: int, number: int) -> np.random.Generator:
    """The random numbers of a trial."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(number,)))


# Sessions


def session_rows(seed: int, source: Source, methods: Sequence[Method], number: int, cell: Cell) -> list[Row]:
    """A row for each method: whether the calibration was accepted, if not why, and for every parameter p of the
    instrument `error.p`, its value less the truth, `u.p`, its standard uncertainty, and, without a log, `bound.p`, the
    Cramér–Rao bound of the observations; nothing where there is none."""
    rng = stream(seed, number)
    scenario = scenario_of(Setup.of(**cell), rng)
    bounds: dict[str, float] = {}
    if source == "log":
        calibrated = partial(_of_session, session_in_memory(scenario, rng))
    else:
        way = itinerary(scenario, stream(seed, number).spawn(1)[0])  # that of simulate_observations
        observations = simulate_observations(scenario, rng)
        calibrated = partial(_of_observations, observations)
        bounds = {f"bound.{name}": u for name, u in bound(scenario, way.attitudes, observations).items()}
    out: list[Row] = []
    for method in methods:
        try:
            reasons, values = calibrated(method)
        except (InputError, np.linalg.LinAlgError) as error:
            out.append({"method": method, "error": f"{type(error).__name__}: {error}"} | bounds)
            continue
        row: dict[str, Any] = {"method": method, "accepted": not reasons, "reasons": "; ".join(reasons)} | bounds
        for name in values.keys() & scenario.truth.keys():
            value, u = values[name]
            row |= {f"error.{name}": value - scenario.truth[name], f"u.{name}": u}
        out.append(row)
    return out


_Values = Mapping[str, tuple[float, float | None]]


def _of_observations(observations: Observations, method: Method) -> tuple[Sequence[str], _Values]:
    """Why a method does not accept its estimate, and value and u by parameter; those beyond the linear model have a
    value in any case."""
    estimate = METHODS[method](observations) if method in METHODS else ITERATED_METHODS[method](observations, 2)
    linear = len(estimate.names) if estimate.instrument is None else estimate.instrument.linear_count
    return verdict(estimate, observations).reasons, {
        name: (float(estimate.values[i]), float(estimate.u[i]))
        for i, name in enumerate(estimate.names)
        if estimate.observable[i] or i >= linear
    }


def _of_session(session: Session, method: Method) -> tuple[Sequence[str], _Values]:
    """The same of a log through the whole chain."""
    calibration = calibrate(session, method=method)
    return calibration.outcome.reasons, {p.name: (p.value, p.u) for p in calibration.parameters}


def bound(scenario: Scenario, attitudes: Array, observations: Observations) -> dict[str, float]:
    """Square roots of the Cramér–Rao bounds of the parameters that observations determine, by name, SI: of the joint
    likelihood at the true parameters and attitudes (N, 3, 3), with the true in-run instability as a bias that lasts
    from a rest through the turn that follows, and the spreads of groups beyond the linear model as priors."""
    instrument, truth = scenario.instrument, scenario.values
    problem = Problem.of(observations, instrument=instrument, usual=observations.usual)
    about = TurnsAbout.of(observations, instrument, truth)
    point = Point(values=truth, gravity=scenario.setup.gravity, attitudes=attitudes)
    seen = linearised(problem, point, about, components_of(scenario.setup.noise))
    least = bound_by(seen, scenario.setup.turn_rate)
    return {name: float(u) for name, u in zip(least.names, least.u, strict=True) if np.isfinite(u)}


# Rests alone


def statics_rows(seed: int, number: int, cell: Cell) -> list[Row]:
    """One row for BLOCK triads of accelerometers, calibrated from rests alone: how many, how many of them `failed`,
    and over the others, for every parameter p, the means `mean.p` of the errors, `square.p` of their squares, `bound.p`
    of the variances by the Cramér–Rao bound, and the part `covered.p` of the errors within 1.96 u."""
    rng, setup = stream(seed, number), Setup.of(**cell)
    scenario = scenario_of(setup, rng)
    gravity, noise, spread = setup.gravity, setup.noise, setup.accel
    sigma = float(np.hypot(noise.accel_white / np.sqrt(setup.rest), noise.accel_instability))  # of a mean
    truth = np.repeat([spread.bias, spread.scale, spread.axis], 3) * rng.standard_normal((BLOCK, PARAMETERS))
    force = gravity * _verticals(setup, rng)
    model = triad_model(truth[:, :3], truth[:, 3:6], truth[:, 6:])
    readings = force @ np.ascontiguousarray(np.swapaxes(model.matrix, 1, 2)) + model.bias[:, None]
    readings += sigma * rng.standard_normal(readings.shape)
    values, variance, step = fit_statics(readings, gravity)
    variance *= sigma**2
    with np.errstate(invalid="ignore"):
        u = np.sqrt(variance)
        good = ((np.abs(step) <= NEGLIGIBLE * u + 1e-15) & (u < limits_of(scenario.accel.names) / DETERMINED)).all(
            axis=1
        )
    error, variance = (values - truth)[good], variance[good]
    row: dict[str, Any] = {"method": "rests alone", "triads": BLOCK, "failed": int(BLOCK - good.sum())}
    if good.any():
        columns = {
            "mean": error.mean(axis=0),
            "square": (error**2).mean(axis=0),
            "bound": variance.mean(axis=0),
            "covered": (np.abs(error) <= 1.96 * np.sqrt(variance)).mean(axis=0),
        }
        row |= {f"{what}.{name}": float(v) for what, of in columns.items() for name, v in zip(NAMES, of, strict=False)}
    return [row]


def _verticals(setup: Setup, rng: np.random.Generator) -> Array:
    """Directions (BLOCK, N, 3) of the vertical in the body: Mᵀ Lᵀ Rᵀ e_U with the errors R of the table at every
    position and M of the mounting."""
    if setup.by_hand is not None:
        return unit_vector(rng.standard_normal((BLOCK, setup.by_hand, 3)))
    nominal = np.array([position.matrix for position in setup.programme.positions])
    table = setup.table_error * rng.uniform(-1.0, 1.0, (BLOCK, len(nominal), 3))
    mounting = rotation_matrix(setup.mounting_error * rng.uniform(-1.0, 1.0, (BLOCK, 3)))
    up = _up_after(table)
    for i, matrix in enumerate(nominal):
        up[:, i] = up[:, i] @ matrix
    return np.asarray(up @ mounting)


def _up_after(vector: Array) -> Array:
    """exp(−[v×]) e_U (..., 3) for rotation vectors v, rad (Rodrigues, for one direction)."""
    angle = np.linalg.norm(vector, axis=-1)
    out = (0.5 * np.sinc(0.5 * angle / np.pi) ** 2 * vector[..., 1])[..., None] * vector
    sine = np.sinc(angle / np.pi)
    out[..., 0] += sine * vector[..., 2]
    out[..., 1] += np.cos(angle)
    out[..., 2] -= sine * vector[..., 0]
    return np.asarray(out)
