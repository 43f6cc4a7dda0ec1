"""What does each procedure over temperature give, and is its uncertainty honest?

Instruments of the grade navigation with every parameter drawn from its usual size, coefficients over temperature
included; programme rough-table, rests of 120 s, half turns in about 20 s, 35 minutes. Observations are made directly
from the truth. Each session has biases of its own launch and drifts of its own.

Procedures: the programme at 0, 20 and 40 °C, a launch each; the programme twice in one recording while the temperature
goes from 0 to 40 °C and back; once while it goes from 0 to 40 °C; once at room temperature while the unit warms by
3 °C; and the same without any change of temperature. Sensors follow the thermometer with a lag, |N(0, 150 s)| where
none is stated, and have a hysteresis of the usual size on ramps.

Then the three procedures from logs of every sample, tactical instruments, rests of 30 s at 20 samples a second.

z: root mean square of (value − truth)/u over runs and parameters. Coverage: how often the truth is within the interval
of 95 %.
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import stats

from tumble.inference.estimate import Estimate, Fit
from tumble.inference.joint import joint
from tumble.inference.noise import NO_COMPONENTS
from tumble.inference.normal_equations import solve
from tumble.planning.setup import Setup
from tumble.programme.positions import ANY_MOVE, Programme, programme
from tumble.reduction.observations import Observations
from tumble.reduction.together import join_sessions
from tumble.result.calibration import Calibration
from tumble.run.calibrate import calibrate
from tumble.run.together import calibrate_together
from tumble.sensors.instrument import Instrument
from tumble.sensors.parameters import Variable, group_name, named_group, usual_sizes
from tumble.simulation.observations import simulate_observations
from tumble.simulation.scenario import Scenario, itinerary, scenario_of
from tumble.simulation.session import session_in_memory
from tumble.simulation.temperature_profile import REFERENCE as REFERENCE_CELSIUS
from tumble.simulation.temperature_profile import (
    REFERENCE_NAME,
    Climate,
    TemperatureProfile,
    draw_lags,
    draw_thermal,
)
from tumble.simulation.temperature_profile import truth_at as true_at
from tumble.units import DEGREE_PER_HOUR, G_STANDARD, ZERO_CELSIUS, Array

GRADE = "navigation"
FEW = 3
"""Devices of the short form."""
FROM_DEVICE_TO_DEVICE = 7.0
"""%: standard deviation of the share of coefficients of a device that are covered, which all move with its lag."""
SETUP = Setup.of(grade=GRADE, terms="full", rest=120.0)
REFERENCE = 20.0 + ZERO_CELSIUS
ONCE = programme("rough-table")
TWICE = Programme(
    name="twice",
    positions=ONCE.positions * 2,
    moves=(*ONCE.moves, ANY_MOVE, *ONCE.moves),
    ordered=True,
)
USUAL = usual_sizes(GRADE)
LAGS = ("accel.lag", "gyro.lag")
LAG = USUAL["accel.lag"]
LINEAR = ("accel.bias", "accel.scale", "accel.axis", "gyro.bias", "gyro.scale", "gyro.axis")
WITH_TEMPERATURE: tuple[Variable, ...] = ("temperature", "temperature²", "hysteresis")
SLOPES = {
    "accel.bias.t1": 20e-6 * G_STANDARD,
    "accel.scale.t1": 20e-6,
    "gyro.bias.t1": 0.01 * DEGREE_PER_HOUR,
    "gyro.scale.t1": 10e-6,
}
"""Of the warm-up: those of the method's table."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Procedure:
    """Courses of temperature, °C, of the sessions, each passed through at a constant rate, and the programme; whether
    there is hysteresis; the minutes of a warm-up, which goes as an exponential, else None; whether biases are steady,
    so that nothing scatters from rest to rest; for how long, s, the first ramp has been going on before the recording;
    and the groups beyond the linear model, all where None."""

    name: str
    courses: tuple[tuple[float, ...], ...]
    programme: Programme = ONCE
    hysteresis: bool = False
    warm_up: float | None = None
    steady: bool = False
    before: float = 0.0
    groups: Sequence[str] | None = None

    def has(self, name: str) -> bool:
        """Whether instruments have this parameter."""
        return self.groups is None or group_name(name) in (*self.groups, *LINEAR)


LEVELS = Procedure(name="three levels", courses=((0.0, 0.0), (20.0, 20.0), (40.0, 40.0)))
BOTH_WAYS = Procedure(name="up and down", courses=((0.0, 40.0, 0.0),), programme=TWICE, hysteresis=True)
ONE_WAY = Procedure(name="up", courses=((0.0, 40.0),), hysteresis=True)
WARM_UP = Procedure(name="warm-up of 3 °C", courses=((20.0, 23.0),), warm_up=5.0)
ISOTHERMAL = Procedure(name="no change", courses=((20.0, 20.0),))


def session(procedure: Procedure, course: Sequence[float], lag: float) -> tuple[Climate, float]:
    """The climate of a session, and how long it takes, s."""
    turns = len(procedure.programme.moves) * (np.pi / SETUP.turn_rate)
    long = SETUP.first_rest + SETUP.rest * len(procedure.programme.positions) + turns
    kelvin = np.array(course) + ZERO_CELSIUS
    time = np.linspace(0.0, long, len(kelvin))
    if procedure.warm_up is not None:
        time = np.arange(0.0, long, 5.0)
        kelvin = kelvin[0] + (kelvin[-1] - kelvin[0]) * (1.0 - np.exp(-time / (60.0 * procedure.warm_up)))
    if procedure.before > 0.0:
        fallen = procedure.before * (kelvin[1] - kelvin[0]) / (time[1] - time[0])
        time, kelvin = np.append(-procedure.before, time), np.append(kelvin[0] - fallen, kelvin)
    span = 0.5 * (kelvin.min() + kelvin.max()), max(0.5 * float(np.ptp(kelvin)), 1.0)
    lags = {"accel": lag, "gyro": lag}
    return Climate(time=time, kelvin=kelvin[:, None], reference=REFERENCE, lags=lags, span=span), long


def device(procedure: Procedure, rng: np.random.Generator) -> Scenario:
    """An instrument with every parameter of the usual size."""
    scenario = scenario_of(SETUP, rng)
    every = Instrument.of(scenario.accel, scenario.gyro, USUAL, WITH_TEMPERATURE)
    more = {
        name: float(USUAL[group.name] * rng.standard_normal())
        for group in every.further
        if group.variable in WITH_TEMPERATURE and (procedure.hysteresis or group.variable != "hysteresis")
        for name in group.names(every.block(group))
    }
    if procedure in (WARM_UP, ISOTHERMAL):
        for name in more:
            more[name] *= SLOPES.get(group_name(name), 0.0) / USUAL[group_name(name)]
    if procedure.steady:
        noise = replace(scenario.setup.noise, accel_instability=0.0, gyro_instability=0.0)
        scenario = scenario.changed(noise=noise)
    truth = {name: value if procedure.has(name) else 0.0 for name, value in (dict(scenario.truth) | more).items()}
    usual = {name: size for name, size in USUAL.items() if procedure.has(name)}
    return replace(scenario.changed(further=usual, programme=procedure.programme), truth=truth)


def of_launch(scenario: Scenario, rng: np.random.Generator, *, several: bool) -> Scenario:
    """The instrument in another session: with drifts of its own, and of several, with biases of its own."""
    truth = dict(scenario.truth)
    for name in truth:
        group, size = group_name(name), scenario.setup.further.get(f"{group_name(name)}.launch")
        if group.endswith(".drift"):
            truth[name] = float(scenario.setup.further.get(group, 0.0) * rng.standard_normal())
        elif several and size is not None:
            truth[name] += float(size * rng.standard_normal())
    return replace(scenario, truth=truth)


def observed(procedure: Procedure, number: int, lag: float | None) -> tuple[Scenario, Observations]:
    """A device and the observations of a procedure."""
    rng = np.random.default_rng([12, number])
    scenario, drawn = device(procedure, rng), abs(LAG * rng.standard_normal())
    sessions, several = [], len(procedure.courses) > 1
    for course in procedure.courses:
        climate, _ = session(procedure, course, drawn if lag is None else lag)
        mine = replace(of_launch(scenario, rng, several=several), climate=climate)
        sessions.append(simulate_observations(mine, rng))
    scenario = replace(mine if not several else scenario, climate=climate)
    if not several:
        return scenario, sessions[0]
    names = [f"session {i + 1}" for i in range(len(sessions))]
    return scenario, join_sessions(sessions, names, [np.arange(len(each.rests)) for each in sessions])


RECORDED = Setup.of(grade="tactical", terms="full", rest=30.0, rate_deg_s=40.0, sample_rate=20.0)
"""What is sampled: short sessions at a low rate."""


def calibrated(procedure: Procedure, number: int) -> tuple[Calibration, dict[str, float]]:
    """The calibration of a device from logs of every sample, and the truth at its reference temperature."""
    rng = np.random.default_rng([13, number])
    scenario = scenario_of(RECORDED, rng)
    blocks = {"accel": scenario.accel, "gyro": scenario.gyro}
    thermal, late = draw_thermal(RECORDED.further, "tactical", blocks, rng), draw_lags(RECORDED.further, rng)
    if not procedure.hysteresis:
        thermal = {name: value for name, value in thermal.items() if not name.endswith("hysteresis")}
    scenario = scenario.changed(programme=procedure.programme)
    duration = float(itinerary(scenario, rng.spawn(1)[0]).rests[-1, 1])
    scenario = replace(scenario, truth=dict(scenario.truth) | thermal)
    sessions, several = [], len(procedure.courses) > 1
    for celsius in procedure.courses:
        mine = of_launch(scenario, rng, several=several)
        climate = TemperatureProfile(celsius=celsius).climate(duration, late)
        sessions.append(session_in_memory(replace(mine, climate=climate), rng))
    found = calibrate_together(sessions) if several else calibrate(sessions[0])
    truth = dict(scenario.truth if several else mine.truth) | {REFERENCE_NAME: REFERENCE_CELSIUS}
    return found, true_at(truth, found.reference_temperature) | {f"{kind}.lag": lag for kind, lag in late.items()}


def samples(count: int) -> float:
    """Print what calibrations of logs give; the worst of the coverages of their coefficients, from 95 %."""
    worst = 0.0
    for procedure in (LEVELS, BOTH_WAYS, ONE_WAY):
        runs = [calibrated(procedure, number) for number in range(count)]
        verdicts = Counter(run[0].outcome.verdict for run in runs)
        z = {"all": list[float](), "coefficients": list[float](), "lag": list[float]()}
        within = {kind: list[bool]() for kind in z}
        for found, truth in runs:
            for p in (p for p in found.parameters if p.u and p.name in truth):
                group = group_name(p.name)
                mine = ["coefficients"] if group in THERMAL else ["lag"] if p.name in LAGS else []
                for kind in ("all", *mine):
                    error = (p.value - truth[p.name]) / (p.u or 1.0)
                    z[kind].append(error)
                    within[kind].append(abs(error) < (stats.norm if p.dof is None else stats.t(p.dof)).ppf(0.975))
        print(f"{procedure.name}, {count} devices from logs: {dict(verdicts)}")
        for kind in (kind for kind in z if z[kind]):
            said = f"z {np.sqrt(np.mean(np.square(z[kind]))):.2f}, covered {100.0 * np.mean(within[kind]):.1f} %"
            print(f"  {kind}: {said} of {len(z[kind])}")
        worst = max(worst, abs(100.0 * float(np.mean(within["coefficients"])) - 95.0))
    return worst


def truth_at(scenario: Scenario, kelvin: float) -> dict[str, float]:
    """True values about another reference temperature."""
    truth, warmer = dict(scenario.truth), kelvin - REFERENCE
    for name, value in scenario.truth.items():
        base, _, ending = name.rpartition(".")
        if ending == "t1":
            curvature = scenario.truth[f"{base}.t2"]
            truth[base] += value * warmer + curvature * warmer**2
            truth[name] += 2.0 * curvature * warmer
    assert scenario.climate is not None
    return truth | {f"{kind}.lag": lag for kind, lag in scenario.climate.lags.items()}


@dataclass(frozen=True, kw_only=True, slots=True)
class Found:
    """Of one run, by parameter: errors in units of u, u, and whether the interval of 95 % contains the truth."""

    z: dict[str, float]
    u: dict[str, float]
    covered: dict[str, bool]
    values: dict[str, float]
    chi_square: float


def found(scenario: Scenario, observations: Observations, leave: Sequence[str] = ()) -> Found:
    """What an estimate gives, without groups that are left out."""
    usual = {name: size for name, size in observations.usual.items() if name not in leave}
    estimate: Estimate = joint(replace(observations, usual=usual))
    kelvin = observations.rests.temperature
    assert kelvin is not None
    assert estimate.degrees is not None
    truth = truth_at(scenario, float(kelvin.mean()))
    error = estimate.values - np.array([truth.get(name, 0.0) for name in estimate.names])
    within = np.abs(error) < stats.t.ppf(0.975, estimate.degrees) * estimate.u
    kept = [i for i, seen in enumerate(estimate.observable) if seen]
    total = estimate.fits["noise within rests"]
    return Found(
        z={estimate.names[i]: float(error[i] / estimate.u[i]) for i in kept},
        u={estimate.names[i]: float(estimate.u[i]) for i in kept},
        covered={estimate.names[i]: bool(within[i]) for i in kept},
        values={estimate.names[i]: float(estimate.values[i]) for i in kept},
        chi_square=total.chi_square / total.degrees,
    )


def rms(runs: Sequence[Found], groups: Sequence[str] = ()) -> float:
    """Root mean square of z of groups, all where none is named."""
    z = [value for run in runs for name, value in run.z.items() if not groups or group_name(name) in groups]
    return float(np.sqrt(np.mean(np.square(z))))


THERMAL = tuple(f"{base}.{ending}" for ending in ("t1", "t2") for base in LINEAR if "axis" not in base)


def procedures(count: int) -> float:
    """Print what each procedure gives; the worst of the coverages of its coefficients, from 95 %."""
    worst = 0.0
    for procedure in (LEVELS, BOTH_WAYS, ONE_WAY):
        runs = [found(*observed(procedure, number, None)) for number in range(count)]
        print(f"\n{procedure.name}: {count} devices; z {rms(runs):.2f}, of the linear model {rms(runs, LINEAR):.2f}")
        for group in (*LINEAR, *THERMAL, *LAGS, "accel.bias.hysteresis", "gyro.bias.hysteresis"):
            names = [name for run in runs for name in run.z if group_name(name) == group]
            if not names:
                continue
            covered = 100.0 * np.mean([run.covered[n] for run in runs for n in run.covered if group_name(n) == group])
            u = np.sqrt(np.mean([run.u[n] ** 2 for run in runs for n in run.u if group_name(n) == group]))
            entry = named_group(group)
            size, unit = entry.shown[0] if entry and entry.shown else (1e-6, "µrad")
            print(f"  {group:24s} u {u / size:9.3g} {unit:8s} z {rms(runs, (group,)):.2f}  covered {covered:.1f} %")
        thermal = [run.covered[name] for run in runs for name in run.covered if group_name(name) in THERMAL]
        covered = 100.0 * float(np.mean(thermal))
        print(f"  coefficients over temperature together: covered {covered:.1f} % of {len(thermal)}")
        worst = max(worst, abs(covered - 95.0))
    return worst


def without_scatter(estimate: Estimate) -> tuple[Array, Array]:
    """Values and u of an estimate with the noise within rests alone, whatever the residuals are."""
    likelihood = estimate.linearised
    assert likelihood is not None
    step = solve(likelihood, NO_COMPONENTS)
    return likelihood.point.values + step.parameters[1:], np.sqrt(np.diag(step.covariance)[1:])


def bare(scenario: Scenario, observations: Observations, leave: Sequence[str]) -> tuple[float, float, Fit]:
    """Errors over u with the noise within rests alone, rms: of biases, scale factors and their coefficients, and of
    biases and scale factors; and the chi-square, without groups that are left out."""
    usual = {name: size for name, size in observations.usual.items() if name not in leave}
    estimate = joint(replace(observations, usual=usual))
    assert observations.rests.temperature is not None
    truth = truth_at(scenario, float(observations.rests.temperature.mean()))
    values, u = without_scatter(estimate)
    z = {n: float((v - truth.get(n, 0.0)) / s) for n, v, s in zip(estimate.names, values, u, strict=True)}
    every = [z[name] for name in z if group_name(name) in (*THERMAL, *AT_REFERENCE)]
    there = [z[name] for name in z if group_name(name) in AT_REFERENCE]
    return rms_of(every), rms_of(there), estimate.fits["noise within rests"]


def rms_of(values: Sequence[float]) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


AT_REFERENCE = ("accel.bias", "accel.scale", "gyro.bias", "gyro.scale")
HYSTERESIS, LAG_ALONE = ("accel.bias.hysteresis", "gyro.bias.hysteresis"), LAGS


IN_A5 = ("accel.quadratic", "accel.lever", "accel.delay", *THERMAL, *LAGS)
"""The groups of the method's A5, by its degrees of freedom: 74 in one programme."""


def lags(count: int) -> None:
    """Print the table of the method's A5 of lags, with its groups, over 20 °C; and of single ramps that had been going
    on before the recording, and over 40 °C."""
    print(f"\nlag, {count} devices each: errors over u where it is ignored (at T0; chi-square for degrees) → estimated")
    there, back = replace(ONE_WAY, courses=((10.0, 30.0),)), replace(BOTH_WAYS, courses=((10.0, 30.0, 10.0),))
    for procedure, lag, before in (
        (back, 30.0, 0.0),
        (back, 100.0, 0.0),
        (back, 300.0, 0.0),
        (there, 100.0, 0.0),
        (there, 300.0, 0.0),
        (there, 100.0, 50.0),
        (there, 100.0, 2000.0),
        (ONE_WAY, 100.0, 0.0),
        (ONE_WAY, 100.0, 2000.0),
    ):
        a_lag(replace(procedure, groups=IN_A5, before=before), lag, count)


def a_lag(procedure: Procedure, lag: float, count: int) -> None:
    """Print what a lag costs where it is ignored and nothing but the noise within rests is allowed for, and how it is
    estimated. Bias scatters in no rest."""
    quiet = replace(procedure, hysteresis=False, steady=True)
    made = [observed(quiet, number, lag) for number in range(count)]
    with_lag = [found(*each, leave=HYSTERESIS) for each in made]
    without = [bare(*each, leave=(*LAG_ALONE, *HYSTERESIS)) for each in made]
    known = [(run.values[name], run.u[name]) for run in with_lag for name in LAGS if name in run.values]
    every, there = rms_of([each[0] for each in without]), rms_of([each[1] for each in without])
    chi, degrees = (np.mean([getattr(each[2], what) for each in without]) for what in ("chi_square", "degrees"))
    print(f"  {procedure.name}, {procedure.courses[0]} °C, {procedure.before:.0f} s before, {lag:.0f} s:", end=" ")
    print(f"{every:5.1f} ({there:.1f}; {chi:.0f} for {degrees:.0f})", end=" ")
    print(f"→ {rms(with_lag, (*LINEAR, *THERMAL)):.2f};", end=" ")
    values, u = np.array(known).T
    print(f"{values.mean():.1f} ± {values.std(ddof=1):.1f} s, u {rms_of(u):.1f} s of {len(known)}", flush=True)


def hysteresis(count: int) -> None:
    """Print its table of hysteresis, without a lag and with one of 60 s."""
    print(f"\nhysteresis, {count} devices each: errors over the u of the noise within rests")
    made = [observed(replace(BOTH_WAYS, steady=True), number, 60.0) for number in range(count)]
    for what, leave in (
        ("both ignored", HYSTERESIS + LAG_ALONE),
        ("lag alone", HYSTERESIS),
        ("hysteresis alone", LAG_ALONE),
        ("both", ()),
    ):
        print(f"  hysteresis with a lag of 60 s, {what}: {rms_of([bare(*each, leave)[0] for each in made]):.2f}")
    made = [observed(replace(BOTH_WAYS, steady=True), number, 0.0) for number in range(count)]
    for what, leave in (("ignored", HYSTERESIS + LAG_ALONE), ("fitted", LAG_ALONE)):
        print(f"  hysteresis without lag, {what}: {rms_of([bare(*each, leave)[0] for each in made]):.2f}")


def warm_up(count: int) -> tuple[float, float]:
    """Print what a warm-up costs: z of the linear parameters, and the mean of u over that of an isothermal session."""
    leave = tuple(name for name in USUAL if name.endswith((".t1", ".t2")))
    warm = [observed(WARM_UP, number, 0.0) for number in range(count)]
    runs = [found(*each) for each in warm]
    ignored = [found(*each, leave=leave) for each in warm]
    still = [found(*observed(ISOTHERMAL, number, 0.0), leave=leave) for number in range(count)]
    names = [name for name in runs[0].u if group_name(name) in LINEAR]
    ratio = np.array([[run.u[n] / other.u[n] for n in names] for run, other in zip(runs, still, strict=True)])
    z, without = rms(runs, LINEAR), rms(ignored, LINEAR)
    print(
        f"\nwarm-up of 3 °C, {count} devices: z {z:.2f} (without coefficients over temperature {without:.2f});", end=" "
    )
    print(f"u {ratio.mean():.2f} times that without a change, at most {ratio.mean(axis=0).max():.2f}")
    return z, float(ratio.mean())


def main() -> int:
    short = "--short" in sys.argv
    worst = procedures(FEW if short else 1000)
    if not short:
        worst = max(worst, samples(60))
        lags(24)
        hysteresis(40)
    z, ratio = warm_up(3 if short else 30)
    limits = (5.0 * FROM_DEVICE_TO_DEVICE / FEW**0.5, 1.3, 1.4) if short else (2.0, 1.05, 1.2)
    honest = all(found < limit for found, limit in zip((worst, z, ratio), limits, strict=True))
    print(f"\nIs u over temperature honest, and does a warm-up cost little? {'Yes' if honest else 'No'}")
    return 0 if honest else 1


if __name__ == "__main__":
    sys.exit(main())
