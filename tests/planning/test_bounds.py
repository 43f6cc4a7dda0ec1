"""The Cramér–Rao bound of a programme: the published figures, what `joint` states, and what any bound must do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.support.formula_setup import bound, bound_of, device_setup
from tumble.diagnosis.observability import in_words
from tumble.errors import InputError
from tumble.inference.integrated_turns import IntegratedTurns
from tumble.inference.linearisation import linearise
from tumble.inference.normal_equations import solve
from tumble.inference.problem import Point, Problem
from tumble.planning.itinerary import Itinerary, itinerary_of
from tumble.planning.setup import GROUPS, NAMES, Setup
from tumble.programme.positions import TRIPLES, Programme, from_attitudes, programme
from tumble.reduction.observations import Observations
from tumble.sensors.grades import GRADES, NoiseModel
from tumble.simulation.observations import simulate_observations
from tumble.simulation.scenario import Scenario, itinerary, scenario_of
from tumble.units import ARCSEC, DEGREE, DEGREE_PER_HOUR, Array

GRAVITY = 9.815817
SETUP = device_setup(latitude=56.8 * DEGREE, gravity=GRAVITY, rest=120.0, turn_rate=9.0 * DEGREE)
"""§8 of the turntable method: rests of 120 s, half turns of 20 s."""

TENTH_OF_MG = replace(SETUP, noise=NoiseModel(accel_white=1e-4 * GRAVITY * np.sqrt(SETUP.rest)))


LEVERS = ("accel.lever", "accel.delay")
QUADRATIC = (*LEVERS, "accel.quadratic")
MICRO_G = 1e-6 * GRAVITY
SECTION_4 = {
    LEVERS: {
        "gyro.bias": 0.0042 * DEGREE_PER_HOUR,
        "gyro.scale": 0.902e-6,
        "accel.bias": 0.389 * MICRO_G,
        "accel.scale": 0.430e-6,
    },
    QUADRATIC: {
        "gyro.bias": 0.0042 * DEGREE_PER_HOUR,
        "gyro.scale": 0.909e-6,
        "accel.bias": 0.951 * MICRO_G,
        "accel.scale": 0.431e-6,
        "accel.quadratic": 1.07e-6 / GRAVITY,
        "accel.delay": 6.7e-6,
    },
    (*QUADRATIC, "gyro.asymmetry", "gyro.g_sensitivity"): {
        "accel.scale": 0.432e-6,
        "accel.delay": 6.8e-6,
        "gyro.g_sensitivity": 0.0074 * DEGREE_PER_HOUR / GRAVITY,
    },
    (*QUADRATIC, "accel.asymmetry"): {
        "accel.scale": 0.439e-6,
        "gyro.scale": 0.913e-6,
        "accel.delay": 6.8e-6,
    },
}
"""§4 of the dynamics method, 15 rests of 120 s and 14 turns: SI, by the groups the instrument has. Left out are figures
that depend on what is not published: asymmetries on the way the moves between the series go, angles and levers on how
the rate changes within a turn."""


def with_programme(setup: Setup, listed: Programme | str) -> Setup:
    return replace(setup, programme=programme(listed) if isinstance(listed, str) else listed)


def cube(*chosen: int) -> Programme:
    """Some positions of cube-26: faces 0–5, edges 6–17, vertices 18–25."""
    return from_attitudes([programme("cube-26").positions[i].attitude for i in chosen])


def programmed(setup: Setup) -> Itinerary:
    """That of a programme with its own turns alone in the log."""
    return replace(itinerary_of(setup), turned=np.array([move.axis is not None for move in setup.programme.moves]))


# -------------------- published figures --------------------


@pytest.mark.parametrize(
    ("name", "condition", "scale", "axis", "bias"),
    [
        ("cube-12", "2.00", "87", "100", "50"),
        ("cube-14", "2.29", "64", "106", "46"),
        ("faces-edges-18", "2.45", "53", "100", "41"),
        ("cube-26", "2.14", "51", "73", "34"),
        ("nine", "6.48", "71", "265", "71"),
    ],
)
def test_accelerometers_alone_are_bounded_as_published(
    name: str, condition: str, scale: str, axis: str, bias: str
) -> None:
    """§3 of the ellipsoid method, to its digits: 0.1 mg a position; ppm, µrad, µg, the largest of the three axes."""
    found = bound(with_programme(TENTH_OF_MG, name), gyros=False)
    assert found.rank == 9
    assert f"{found.condition:.2f}" == condition
    u = dict(zip(found.names, found.u, strict=True))
    largest = {group: max(v for n, v in u.items() if n.startswith(group)) for group in GROUPS[:3]}
    assert f"{1e6 * largest['accel.scale']:.0f}" == scale
    assert f"{1e6 * largest['accel.axis']:.0f}" == axis
    assert f"{1e6 * largest['accel.bias'] / GRAVITY:.0f}" == bias


def test_the_bound_of_the_rough_table_is_the_published_one() -> None:
    """§8, with the nine programme turns: to 0.5 %, as it was printed to three digits from one tilted table."""
    found, all_moves = bound_of(programmed(SETUP), SETUP), bound(SETUP)
    published = {
        "accel.bias": 4.15e-6,
        "accel.scale": 4.57e-7,
        "accel.axis": 0.338 * ARCSEC,
        "gyro.bias": 4.39e-3 * DEGREE_PER_HOUR,
        "gyro.scale": 9.37e-7,
        "gyro.axis": 0.406 * ARCSEC,
    }
    for group, expected in published.items():
        assert found.rms(group) == pytest.approx(expected, rel=0.005), group
    assert all_moves.rms("gyro.axis") == pytest.approx(0.318 * ARCSEC, rel=0.06)  # other moves between the series


@pytest.mark.parametrize("groups", list(SECTION_4))
def test_groups_beyond_the_linear_model_are_bounded_as_published(groups: tuple[str, ...]) -> None:
    """§4 of the dynamics method, every turn in 20 s, without priors: rms by group within 6 %."""
    setup = replace(SETUP, further=dict.fromkeys(groups, 1.0))
    course = itinerary_of(setup)
    start = (setup.rest + 20.0) * np.arange(len(course.rests))
    found = bound_of(replace(course, rests=np.column_stack([start, start + setup.rest])), setup)
    for group, expected in SECTION_4[groups].items():
        assert found.rms(group) == pytest.approx(expected, rel=0.06), group


def test_one_more_turn_a_series_shows_the_asymmetry_of_the_gyros() -> None:
    """§4 of the dynamics method: 0.91 ppm with 15 rests of the series; three oblique ones and the moves to them make it
    a little less. From the programmed turns alone of rough-table it is 40 ppm in the scale factors."""
    further = dict.fromkeys((*LEVERS, "accel.quadratic", "gyro.asymmetry", "gyro.g_sensitivity"), 1.0)
    setup = replace(SETUP, turn_rate=9.0 * DEGREE, further=further)
    more = with_programme(setup, "rough-table-18")
    assert bound_of(programmed(more), more).rms("gyro.asymmetry") == pytest.approx(0.91e-6, rel=0.1)
    assert bound(more).rms("gyro.asymmetry") < 1e-6
    assert bound_of(programmed(setup), setup).rms("gyro.asymmetry") > 20e-6


# -------------------- what joint states --------------------


def test_the_bound_is_that_of_the_joint_likelihood() -> None:
    """On observations of the same tilted table, to 2e-5 of u u': samples there are means, here they are values in the
    middle of their intervals."""
    expected, observations = bound_of(way_of(TILTED), SETUP).covariance, noiseless(TILTED)
    problem = Problem.of(observations)
    point = Point(values=np.zeros(len(NAMES)), gravity=GRAVITY, attitudes=way_of(TILTED).attitudes)
    rows = linearise(problem, point, IntegratedTurns.of(observations, problem.instrument, point.values))
    found = solve(rows).covariance[1:, 1:]
    assert off(found, expected) < 2e-5


TILTED = replace(scenario_of(SETUP, np.random.default_rng(0)), truth=dict.fromkeys(NAMES, 0.0))
"""Perfect sensors on a table of ±1°."""


def off(found: Array, expected: Array) -> float:
    """Largest difference of two covariances, in units of u u'."""
    u = np.sqrt(np.diag(expected))
    return float(np.abs((found - expected) / np.outer(u, u)).max())


def noiseless(loud: Scenario) -> Observations:
    """Exact observations with the covariances of the noise."""
    seen, noisy = (
        simulate_observations(one, np.random.default_rng(3)) for one in (loud.changed(noise=NoiseModel()), loud)
    )
    assert seen.turns is not None
    assert noisy.turns is not None
    stated = {name: getattr(noisy.rests, name) for name in ("accel_covariance", "gyro_covariance")}
    noise = {name: getattr(noisy.turns, name) for name in ("covariance", "velocity_covariance")}
    turns = replace(seen.turns, **noise)
    return replace(seen, rests=replace(seen.rests, **stated), turns=turns)


def way_of(scenario: Scenario) -> Itinerary:
    """That of `simulate_observations` with the same seed."""
    return itinerary(scenario, np.random.default_rng(3).spawn(3)[0])


def test_a_degree_of_the_table_changes_the_bound_by_less_than_a_hundredth() -> None:
    """So that the programme itself stands for what is done; both with the seconds that the ramps of turns take."""
    tilted, exact = way_of(TILTED), itinerary_of(SETUP)
    found, expected = (bound_of(one, SETUP) for one in (tilted, replace(exact, rests=tilted.rests)))
    for group in GROUPS:
        assert found.rms(group) == pytest.approx(expected.rms(group), rel=0.01), group


# -------------------- what any bound does --------------------


@settings(max_examples=25, deadline=None)
@given(
    st.lists(st.sampled_from(TRIPLES), min_size=2, max_size=6),
    st.sampled_from(TRIPLES),
    st.sampled_from(["", " N+45", " U-30", " E+110"]),
    st.sampled_from(list(GRADES)),
    st.booleans(),
)
def test_one_more_position_never_hurts(codes: list[str], letters: str, turn: str, name: str, wanders: bool) -> None:
    """Of biases that wander, what is asked for is their mean over all rests, which is another then."""
    noise = GRADES[name].noise
    setup = replace(
        SETUP, noise=noise if wanders else NoiseModel(accel_white=noise.accel_white, gyro_white=noise.gyro_white)
    )
    before = [*programme("nine").positions, *from_attitudes(codes).positions]
    listed = [position.attitude for position in before]
    for gyros in (True, False):
        fewer, more = (
            bound(with_programme(setup, from_attitudes(some)), gyros=gyros)
            for some in (listed, [*listed, letters + turn])
        )
        asked = np.array([not (wanders and ".bias." in name) for name in more.names])
        assert np.all(more.u[asked] <= fewer.u[asked] * (1.0 + 1e-9))


def test_uncertain_gravity_is_in_the_scale_factors_together_and_nowhere_else() -> None:
    gravity_u = 3e-5
    exact, uncertain = bound(SETUP), bound(replace(SETUP, gravity_u=gravity_u))
    scale = np.array([name.startswith("accel.scale") for name in NAMES])
    more = np.outer(scale, scale) * (gravity_u / GRAVITY) ** 2
    u = np.sqrt(np.diag(uncertain.covariance))
    np.testing.assert_allclose(
        uncertain.covariance / np.outer(u, u), (exact.covariance + more) / np.outer(u, u), rtol=0.0, atol=1e-6
    )


def test_what_six_faces_do_not_determine_is_named() -> None:
    six = bound(with_programme(SETUP, cube(*range(6))), gyros=False)
    assert in_words(six.null, six.names) == ["accel.axis.yx", "accel.axis.zx", "accel.axis.zy"]
    assert six.observable.tolist() == [True] * 6 + [False] * 3
    assert np.isinf(six.rms("accel.axis"))
    assert (six.rank, six.condition) == (6, np.inf)
    eight = bound(with_programme(SETUP, cube(*range(18, 26))), gyros=False)
    assert eight.rank == 7
    said = in_words(eight.null, eight.names)
    assert len(said) == 2
    assert all("accel.scale" in words and "−" in words for words in said)


def test_turns_show_the_angles_that_upright_rests_do_not() -> None:
    """§6.3 of the turntable method: without the 45° rests, from the turns, 0.53″; with them 0.34″."""
    whole = SETUP.programme
    upright = replace(whole, positions=whole.positions[:12], moves=whole.moves[:11])
    alone = bound(with_programme(SETUP, upright), gyros=False)
    assert not alone.observable[[name.startswith("accel.axis") for name in alone.names]].any()
    found = bound_of(programmed(with_programme(SETUP, upright)), SETUP)
    assert found.rms("accel.axis") == pytest.approx(0.53 * ARCSEC, rel=0.02)


@pytest.mark.parametrize(
    ("change", "place"),
    [
        ({"noise": NoiseModel()}, "noise"),
        ({"noise": NoiseModel(accel_white=1e-4)}, "gyros"),
        ({"latitude": 90.0 * DEGREE}, "latitude"),
        ({"rest": 0.0}, "rest"),
    ],
)
def test_a_set_up_without_a_bound_is_refused(change: dict[str, object], place: str) -> None:
    with pytest.raises(InputError, match=place) as refusal:
        bound(replace(SETUP, **change))  # type: ignore[arg-type]
    assert "\n" not in str(refusal.value)
