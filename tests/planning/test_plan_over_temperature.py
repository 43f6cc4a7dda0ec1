"""Plans over temperature: u as the estimate states it, what a plan says, and the time in a chamber."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner, Result

from tumble.cli import main
from tumble.inference.likelihood import Problem, instruments_of
from tumble.inference.start import start_of
from tumble.planning.bounds import bound_by
from tumble.planning.itinerary import itinerary_of
from tumble.planning.over_temperature import (
    SETTLED,
    Chamber,
    ChamberSession,
    plan_over_temperature,
    rests_of,
    soak_of,
    view_of,
)
from tumble.planning.setup import Setup, with_all_groups
from tumble.programme.positions import from_attitudes, programme
from tumble.reduction.observations import Observations
from tumble.reduction.together import joined
from tumble.reduction.turns.turns import VELOCITY_FLOOR
from tumble.run.observed import inspect_session, observations_for_calibration, observations_in_parts
from tumble.sensors.instrument import Instrument
from tumble.sensors.parameters import group_name, usual_sizes
from tumble.simulation.scenario import Scenario, itinerary, scenario_of
from tumble.simulation.session import session_in_memory
from tumble.simulation.temperature_profile import Climate, chamber_sessions
from tumble.units import ZERO_CELSIUS

NINE = from_attitudes(
    ["UNW E+45", "NDW E+45", "ENU", "DES U+45", "WDS U+45", "SUW N+45", "DSW N+45", "NED U+45", "EUS E+45"]
)
"""Whose moves have one shortest way."""
LAG = 100.0
LEVERS = 0.06
"""Of the u of lever arms, which the ramps of the turns count for."""


def setup_of(grade: str) -> Setup:
    """Without instability, so that there is no scatter to be found out."""
    setup = Setup.of(
        grade=grade, rest=120.0, rate_deg_s=20.0, sample_rate=25.0, table_error_deg=0.01, mounting_error_deg=0.01
    )
    quiet = replace(setup.noise, accel_instability=0.0, gyro_instability=0.0)
    return replace(setup, programme=NINE, noise=quiet)


def devices(setup: Setup, sessions: tuple[ChamberSession, ...], seed: int) -> list[Scenario]:
    """A nearly perfect device with slopes of the usual size in each session's climate, behind by the usual lag."""
    rng, usual = np.random.default_rng(seed), usual_sizes(setup.instrument)
    base = scenario_of(with_all_groups(setup), rng)
    truth = {name: 0.01 * value if group_name(name) not in usual else 0.0 for name, value in base.truth.items()}
    every = Instrument.of(base.accel, base.gyro, usual, {"temperature"})
    slopes = {
        name: usual[group.name]
        for group in every.further
        if group.variable == "temperature"
        for name in group.names(every.block(group))
    }
    out = []
    for session in sessions:
        still = replace(base.changed(programme=session.programme), truth=truth)
        time, kelvin = session.course(float(itinerary(still, np.random.default_rng(0)).rests[-1, 1]))
        climate = Climate(time=time, kelvin=kelvin[:, None], reference=20.0 + ZERO_CELSIUS, lag=LAG)
        out.append(replace(still.changed(further=usual), truth=truth | slopes, climate=climate))
    return out


def stated(observations: Observations, setup: Setup) -> Observations:
    """With the noise of the set-up, of which a hundredth part is there: no scatter is found by chance, and what is
    compared is not how well the log shows its noise."""
    rests, turns, noise = observations.rests, observations.turns, setup.noise
    assert turns is not None
    seconds, turned = (each[:, None, None] for each in (rests.stop - rests.start, turns.duration))
    moves = turned > 0.0
    return replace(
        observations,
        rests=replace(
            rests,
            accel_covariance=noise.accel_white**2 / seconds * np.eye(3),
            gyro_covariance=noise.gyro_white**2 / seconds * np.eye(3),
        ),
        turns=replace(
            turns,
            covariance=np.where(moves, noise.gyro_white**2 * turned * np.eye(3), turns.covariance),
            velocity_covariance=noise.accel_white**2 * turned * np.eye(3) + VELOCITY_FLOOR**2 * np.eye(3),
        ),
    )


@pytest.mark.parametrize(("text", "grade"), [("-20,20,60", "tactical"), ("-20:60:-20/18", "navigation")])
def test_u_is_that_by_the_rows_of_logs(text: str, grade: str) -> None:
    """Of three levels together, and of a ramp there and back, to 2 %, of every parameter, with known noise."""
    setup = setup_of(grade)
    sessions = chamber_sessions(text, setup)
    made = []
    for i, scenario in enumerate(devices(replace(setup, noise=setup.noise.scaled(0.01)), sessions, 1)):
        session = replace(session_in_memory(scenario, np.random.default_rng(i)), programme=None)
        seen = inspect_session(session)
        parts = observations_in_parts(seen) if len(sessions) > 1 else observations_for_calibration(seen)
        observations = parts[0] if isinstance(parts, tuple) else parts
        assert isinstance(observations, Observations)
        made.append(replace(stated(observations, setup), usual=with_all_groups(setup).further))
    numbers = [np.arange(len(each.rests)) for each in made]
    whole = made[0] if len(made) == 1 else joined(made, [str(i) for i in range(len(made))], numbers)
    truth = {**devices(setup, sessions, 1)[0].truth, "temperature.lag": LAG}
    whole = replace(whole, start=truth)
    instrument, of_each = instruments_of(whole)
    own = Problem.of(whole, instrument=instrument, own=of_each, usual=whole.usual)
    at = start_of(own)[0]
    courses = [itinerary_of(replace(setup, programme=session.programme)) for session in sessions]
    planned = view_of(with_all_groups(setup), sessions, courses, gyros=True)
    assert own.instrument.names == planned.problem.instrument.names
    of_logs = replace(planned, problem=own.warmed(at.point), rows=at.rows, noise=at.noise)
    u, expected = (
        np.sqrt(np.diag(bound_by(seen, setup.turn_rate, setup.clock_u).covariance)) for seen in (of_logs, planned)
    )
    found = dict(zip(own.instrument.names, (u / expected).tolist(), strict=True))
    off = {name: ratio for name, ratio in found.items() if abs(ratio - 1.0) > (LEVERS if "lever" in name else 0.02)}
    assert off == {}


def test_a_plan_says_what_the_temperatures_do_not_show() -> None:
    setup = setup_of("navigation")

    def notes(text: str) -> str:
        return " ".join(plan_over_temperature(setup, chamber_sessions(text, setup)).notes)

    assert "at two temperatures slopes are seen and no curvature" in notes("-20,60")
    assert "the temperatures span less than 10 K" in notes("20,23")
    assert "no temperature is passed both ways" in notes("-20:60")
    assert "passed both ways" not in notes("-20:60:-20/18")
    assert "its 3 rests determine biases, and accel.scale and gyro.scale hardly" in notes("-20/3,20,60")


def test_a_unit_soaks_until_its_sensors_are_as_warm_as_its_thermometer() -> None:
    """λ dT/dt of an exponential is SETTLED at the end."""
    chamber, lag, difference = Chamber(time_constant=600.0), 200.0, 40.0
    t = soak_of(chamber, difference, lag)
    left = difference / chamber.time_constant * np.exp(-t / chamber.time_constant)
    assert lag * left == pytest.approx(SETTLED)
    assert soak_of(chamber, 0.1, lag) == 0.0


def test_a_programme_begins_anew_after_its_last_rest() -> None:
    twice = rests_of(programme("rough-table"), 18)
    assert [p.attitude for p in twice.positions[15:]] == [p.attitude for p in twice.positions[:3]]
    assert len(twice.moves) == 17
    assert twice.moves[14].axis is None
    assert twice.moves[15] == twice.moves[0]


def run(*arguments: str) -> Result:
    return CliRunner().invoke(main, ["plan", "--programme", "nine", *arguments])


def test_the_command_prints_what_the_recordings_give_and_what_is_wanted_in_vain() -> None:
    done = run("--over-temperature", "-20/4,20,60", "--want", "accel.bias.t1=1.5ug/K", "--want", "gyro.scale=1ppm")
    assert done.exit_code == 1
    assert "−20.0 to 60.0 °C, in the chamber" in done.output
    assert "gyro.scale: expected 1 ppm (rms) from −20.0 to 60.0 °C, found at best" in done.output
    assert "accel.bias.t1: expected" not in done.output


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--over-temperature", "20/0"), "expected how many rests, 1 to 200, after the slash, found '0'"),
        (("--over-temperature", "warm"), "temperature: expected -100 to 200 degC"),
        (("--over-temperature", "20", "--positions", "9"), "--positions: expected none with --over-temperature"),
        (
            ("--over-temperature", "20", "--chamber-rate", "0"),
            "chamber rate: expected more than 0, in K a minute, found 0",
        ),
        (("--over-temperature", "20", "--want", "mass=1kg"), "--want mass=1kg: expected a group such as accel.bias"),
    ],
)
def test_what_is_no_plan_is_refused_in_one_line(arguments: tuple[str, ...], said: str) -> None:
    done = run(*arguments)
    assert done.exit_code == 2
    assert said in done.output
    assert len(done.output.strip().splitlines()) == 1
