"""What does a Kalman filter over the log make of it, beside the staged and the joint method?

The filter has 24 states: the error ψ of the attitude, L̂ = (I + [ψ×]) L, and what is left of the 21 parameters, 9 of
the accelerometers and 12 of the gyros. It goes through the log once, second by second, with all sensors linearised
about what it has found so far:

    turning   L̂⁺ = exp(−[Ω h×]) L̂ Ĉ,   ψ⁺ = Φ (ψ + L̂ (M : E + B δ)) + noise of the gyros, Ĉ, M, B of the second
    at rest   ŵ = S_A Lᵀ g e_U + δw + noise,   ω̂ = S_G LᵀΩ + δω + noise, mean readings of the second

It starts from an attitude by TRIAD of uncertainty 2° (level) and 20° (azimuth) and from perfect sensors with the
spreads of the grade. A second pass starts from the sensors of the first with the uncertainty of the start, so that
nothing is linearised about perfect sensors any more. Where the rests are it is told: by the staged method.

Logs are simulated sessions of rough-table, navigation grade, rests of 30 s, 50 Hz: with white noise, which the filter
knows; and with an instability of 2e-5 m/s² and 0.01 °/h between rests as well, of which the filter, with constant
parameters, knows nothing. Times
are those of one run over the logs in memory: the filter's; the estimates of staged and joint method; and the reduction
of the log to observations, which both need.

    python studies/kalman_filter.py [--short]

The answer is printed last.
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from paper_device import INSTABILITY

from tests.support.staged import staged
from tumble.earth import earth_rate
from tumble.inference.joint import joint
from tumble.methods.paper.gyros import triad
from tumble.planning.setup import Setup
from tumble.recording.log import Chunk
from tumble.recording.session import Site
from tumble.reduction.blocks.reducer import Reducer
from tumble.reduction.observations import Observations, observe
from tumble.reduction.rests.segmentation import find_rests
from tumble.reduction.turns.moments import BlockCompensation, Compensation, Pieces, integrate
from tumble.rotation import rotation_matrix, skew
from tumble.sensors.grades import NoiseModel
from tumble.simulation.recording import Recording, record
from tumble.simulation.scenario import Scenario, scenario_of
from tumble.units import DEGREE, Array

REQUEST = Setup.of(rest=30.0, sample_rate=50.0)
ALIKE = 0.5
"""Part of the errors of the joint method by which the filter's may differ from them and be the same."""
STEP = 1.0
"""s."""
START = np.array([2.0, 20.0, 2.0]) * DEGREE
"""Standard uncertainties of the attitude at the start, about N, U, E."""
GROUPS = ("accel.bias", "accel.scale", "accel.axis", "gyro.bias", "gyro.scale", "gyro.axis")
UP = np.array([0.0, 1.0, 0.0])


# -------------------- the filter --------------------


@dataclass(kw_only=True)
class Filter:
    """Attitude, parameters of both blocks and the covariance (24, 24) of ψ and of true less estimated parameters."""

    scenario: Scenario
    attitude: Array
    accel: Array
    gyro: Array
    P: Array

    @property
    def values(self) -> Array:
        """All parameters (21,)."""
        return np.concatenate([self.accel, self.gyro])

    def turn(self, readings: Array, dt: float) -> None:
        """Carry the attitude through gyro readings (n + 1, 3), the first of which is the sample before."""
        block, noise = self.scenario.gyro, self.scenario.setup.noise.gyro_white
        model, h = block.model(self.gyro), dt * (len(readings) - 1)
        inverse = np.linalg.inv(model.matrix)
        each = np.full(len(readings), dt)
        one, last = np.array([1]), np.array([len(readings)])
        accel = self.scenario.accel
        compensation = Compensation(
            gyro=BlockCompensation.of(block.axes, model),
            accel=BlockCompensation.of(accel.axes, accel.nominal()),
            g_sensitivity=np.zeros((3, 3)),
            delay=0.0,
        )
        still = np.zeros_like(readings)
        turn = Pieces(rates=readings, forces=still, intervals=each, turn=one - 1, start=one, stop=last)
        found = integrate([turn], 1, compensation)
        C, M, B = found.C[0], found.Phi[0, ..., 1:4], found.Phi[0, ..., 0]
        by_reading = np.einsum("ap,pqm->aqm", inverse, block.jacobian(self.gyro))
        turned = np.einsum("ipq,pqm->im", M, by_reading[:, :3]) + B @ by_reading[:, 3]
        F = np.eye(24)
        F[:3, :3] = rotation_matrix(-self.earth * h)
        F[:3, 12:] = F[:3, :3] @ self.attitude @ turned
        self.attitude = F[:3, :3] @ self.attitude @ C
        self.P = F @ self.P @ F.T
        self.P[:3, :3] += noise**2 * h * np.eye(3)

    def rest(self, accel: Array, gyro: Array, h: float) -> None:
        """Take in mean readings (3,) of h seconds at rest."""
        noise, g = self.scenario.setup.noise, self.scenario.site.gravity
        H = np.zeros((6, 24))
        residual = np.empty(6)
        for rows, block, values, columns, vector, reading in (
            (slice(0, 3), self.scenario.accel, self.accel, slice(3, 12), g * UP, accel),
            (slice(3, 6), self.scenario.gyro, self.gyro, slice(12, 24), self.earth, gyro),
        ):
            model, true = block.model(values), self.attitude.T @ vector
            residual[rows] = reading - model.predict(true)
            H[rows, :3] = -model.matrix @ self.attitude.T @ skew(vector)
            H[rows, columns] = block.jacobian(values)[:, :3].swapaxes(1, 2) @ true + block.jacobian(values)[:, 3]
        R = np.repeat([noise.accel_white**2, noise.gyro_white**2], 3) / h
        gain = np.linalg.solve(H @ self.P @ H.T + np.diag(R), H @ self.P).T
        step = gain @ residual
        left = np.eye(24) - gain @ H
        self.P = left @ self.P @ left.T + (gain * R) @ gain.T
        self.attitude = rotation_matrix(-step[:3]) @ self.attitude
        self.accel, self.gyro = self.accel + step[3:12], self.gyro + step[12:]

    @property
    def earth(self) -> Array:
        """Ω (3,) in N, U, E, rad/s."""
        return np.array(earth_rate(self.scenario.site.latitude))


def run(scenario: Scenario, recording: Recording, rests: Array, start: Array) -> Filter:
    """One pass of the filter over a log whose rests are samples [first, last) (R, 2), from parameters (21,)."""
    dt, size = 1.0 / scenario.setup.sample_rate, round(STEP * scenario.setup.sample_rate)
    accel, gyro = scenario.accel.model(start[:9]), scenario.gyro.model(start[9:])
    first = slice(*rests[0])
    force = accel.apply(recording.accel[first].mean(axis=0))
    rate = gyro.apply(recording.gyro[first].mean(axis=0))
    spread = [getattr(getattr(REQUEST, kind), what) for kind, what in (name.split(".")[:2] for name in names(scenario))]
    found = Filter(
        scenario=scenario,
        attitude=triad(force, rate),
        accel=start[:9],
        gyro=start[9:],
        P=np.diag(np.concatenate([START, spread]) ** 2),
    )
    for i, (begin, end) in enumerate(rests):
        for a, b in pieces(begin, end, size):
            found.rest(recording.accel[a:b].mean(axis=0), recording.gyro[a:b].mean(axis=0), (b - a) * dt)
        for a, b in pieces(end, rests[i + 1][0], size) if i + 1 < len(rests) else ():
            found.turn(recording.gyro[a - 1 : b], dt)
    return found


def names(scenario: Scenario) -> tuple[str, ...]:
    """Names of the 21 parameters."""
    return scenario.accel.names + scenario.gyro.names


def pieces(begin: int, end: int, size: int) -> list[tuple[int, int]]:
    """Samples [begin, end) in pieces of `size`, the last one shorter."""
    edges = [*range(begin, end, size), end]
    return list(pairwise(edges))


# -------------------- beside the staged method --------------------


def observed(scenario: Scenario, recording: Recording) -> Observations:
    """The observations of a log in memory."""
    rate = scenario.setup.sample_rate
    reducer = Reducer(rate=rate, accel=scenario.accel, gyro=scenario.gyro)
    dt = np.full(len(recording.time), 1.0 / rate)
    reducer.feed(
        Chunk(file=0, time=recording.time, dt=dt, accel=recording.accel, gyro=recording.gyro, temperature=None)
    )
    reduction = reducer.now()
    rests = find_rests(reduction, scenario.accel, scenario.gyro).rests
    true = scenario.site
    site = Site(latitude=true.latitude, height=true.height, gravity=true.gravity, gravity_u=0.0)
    return observe(reduction, rests, scenario.accel, scenario.gyro, site)


@dataclass(frozen=True, kw_only=True, slots=True)
class Compared:
    """Errors (S, 21) and standard uncertainties (S, 21) by method, and seconds by what took them."""

    error: dict[str, Array]
    u: dict[str, Array]
    seconds: dict[str, float]


def compare(noise: NoiseModel, sessions: int) -> Compared:
    """Both methods over the same logs."""
    error: dict[str, list[Array]] = {"staged": [], "joint": [], "filter, 1 pass": [], "filter, 2 passes": []}
    u: dict[str, list[Array]] = {name: [] for name in error}
    seconds = dict.fromkeys(("reduction", "staged", "joint", "filter"), 0.0)
    for seed in range(sessions):
        scenario = scenario_of(REQUEST, np.random.default_rng([51, seed]), serial="")
        scenario = scenario.changed(noise=noise)
        recording = record(scenario, np.random.default_rng([52, seed]))
        truth = np.array([scenario.truth[name] for name in names(scenario)])
        clock = [time.perf_counter()]
        observations = observed(scenario, recording)
        clock.append(time.perf_counter())
        by_stages = staged(observations)
        clock.append(time.perf_counter())
        jointly = joint(observations)
        clock.append(time.perf_counter())
        times = np.column_stack([observations.rests.start, observations.rests.stop])
        rests = np.rint(times * scenario.setup.sample_rate).astype(int)
        one = run(scenario, recording, rests, np.zeros(21))
        clock.append(time.perf_counter())
        two = run(scenario, recording, rests, one.values)
        if seed:  # the first session loads the libraries
            for name, passed in zip(seconds, np.diff(clock), strict=True):
                seconds[name] += passed
        for name, values, uncertainty in (
            ("staged", by_stages.values, by_stages.u),
            ("joint", jointly.values, jointly.u),
            ("filter, 1 pass", one.values, np.sqrt(np.diag(one.P)[3:])),
            ("filter, 2 passes", two.values, np.sqrt(np.diag(two.P)[3:])),
        ):
            error[name].append(values - truth)
            u[name].append(uncertainty)
    return Compared(
        error={name: np.array(e) for name, e in error.items()},
        u={name: np.array(e) for name, e in u.items()},
        seconds=seconds,
    )


def grouped(values: Array) -> Array:
    """Rms (6,) over sessions and the parameters of each group."""
    squares = (values**2).mean(axis=0)
    return np.sqrt([part.mean() for part in np.split(squares, [3, 6, 9, 12, 15])])


def main(arguments: list[str]) -> int:
    """Print the tables and the answer."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--short", action="store_true", help="fewer sessions")
    sessions = 2 if parser.parse_args(arguments).short else 40
    white = NoiseModel(accel_white=REQUEST.noise.accel_white, gyro_white=REQUEST.noise.gyro_white)
    spreads = np.array([getattr(getattr(REQUEST, kind), what) for kind, what in (g.split(".") for g in GROUPS)])
    found = {"white noise": compare(white, sessions), "and instability": compare(INSTABILITY, sessions)}
    for title, at in found.items():
        print(f"\n{title}: rms errors, % of the spread before calibration; rms of error/u; {sessions} sessions")
        print(f"  {'':<18}" + "".join(f"{group:>18}" for group in GROUPS))
        for name in at.error:
            parts = 100.0 * grouped(at.error[name]) / spreads
            ratios = grouped(at.error[name] / at.u[name])
            print(f"  {name:<18}" + "".join(f"{p:11.3f}{z:7.2f}" for p, z in zip(parts, ratios, strict=True)))
        unit = at.seconds["staged"]
        parts = ", ".join(f"{name} {at.seconds[name] / unit:.1f}" for name in ("reduction", "joint", "filter"))
        print(f"  times as multiples of that of the staged estimate: {parts} a pass")
    calm, unstable = found.values()
    ratio = {name: grouped(calm.error[name]) / grouped(calm.error["staged"]) for name in calm.error}
    won = float(np.sqrt((ratio["filter, 2 passes"] ** 2).mean())) < 0.9
    shares = ", ".join(f"{group} {r:.2f}" for group, r in zip(GROUPS, ratio["filter, 2 passes"], strict=True))
    apart = calm.error["filter, 2 passes"] - calm.error["joint"]
    same = (grouped(apart) / grouped(calm.error["joint"])).max()
    times = calm.seconds["filter"] / (calm.seconds["reduction"] + calm.seconds["joint"])
    z = {name: grouped(unstable.error[name] / unstable.u[name]).max() for name in unstable.error}
    holds = won and same < ALIKE and z["filter, 2 passes"] > max(z["staged"], z["joint"])
    print(
        f"\nDoes the Kalman filter win? {'In' if won else 'Not even in'} accuracy, where every turn ties the attitudes "
        f"of two rests together: its errors, as parts of those of the staged method, are {shares}. The joint method "
        f"has the same, to {100.0 * same:.0f} % of them, and with the reduction of the log a pass takes {times:.1f} "
        "times as long. Where sensors change between rests, the filter's errors are up to "
        f"{z['filter, 2 passes']:.1f} times the uncertainties it gives; those of the staged and the joint method, "
        f"which estimate that change, {z['staged']:.1f} and {z['joint']:.1f} times."
    )
    return 0 if holds else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
