"""The kinds of simulated sessions: each one entry of a table with what is to be expected of a program.

`simulated(kind, index)` is one session of a kind. Its seed is drawn from the name of a series, of the kind and the
index: the published tables are of the series SEALED, the short form in continuous integration is of SHORT, and tests
use others. Motion, device, noise and driver have streams of their own.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from evidence.case import Case
from evidence.simulated.device import G0, Magnetometer, Process, Sensors, Sweep, readings
from evidence.simulated.driver import Driver, through
from evidence.simulated.motion import DEG, Handling, course
from evidence.simulated.waving import Waving, waved

SEALED, SHORT = "evidence 1", "short 1"
Expected = Literal["accept", "accept with scatter", "name the cause", "refuse"]
GRAVITY_U = 1e-5
"""m/s², with which the gravity of a place is stated: 1 mGal."""


HAND, MEMS, CRYSTAL = Handling(), Sensors(), Driver(clock_ppm=15.0)


@dataclass(frozen=True, kw_only=True, slots=True)
class Kind:
    """One kind of sessions: in words, what is expected of a program that judges, and what makes it."""

    name: str
    words: str
    expected: Expected
    says: str = ""
    """A regular expression that a verdict which names the cause fits."""
    handling: Handling = HAND
    sensors: Sensors = MEMS
    driver: Driver = CRYSTAL
    alone: bool = False
    """Without gyros."""
    south: bool = False
    """The latitude is stated with the wrong sign."""
    waving: Waving | None = None
    """A device that never lies still, or is never moved, in place of rests and turns."""
    gyros_alone: bool = False
    device: str = ""
    """Kinds with this name are recorded with the same devices."""


EXACT = Driver(clock_ppm_u=0.0)
TABLE = Handling(programme="table", rest=40.0, first_rest=40.0, turn=18.0, off=1.5 * DEG)
CUBE = Handling(programme="cube", off=1.0 * DEG)
FACES = Handling(programme="faces", rest=10.0, off=1.0 * DEG)
TURNS = Handling(programme="turns", rest=10.0, turn=6.0, off=1.0 * DEG)
NAVIGATION = Sensors(grade="navigation", rate=50.0)


def _file(**changes: Any) -> Driver:
    """Return the driver of an ordinary unit with an unspecified clock, with some changes."""
    return replace(CRYSTAL, **changes)


KINDS = (
    # good recordings
    Kind(name="hand-30", words="by hand, 30 rests, MEMS", expected="accept"),
    Kind(name="hand-8", words="by hand, 8 rests, MEMS", expected="accept", handling=Handling(rests=8)),
    Kind(name="hand-12", words="by hand, 12 rests, MEMS", expected="accept", handling=Handling(rests=12)),
    Kind(name="hand-40", words="by hand, 40 rests, MEMS", expected="accept", handling=Handling(rests=40)),
    Kind(name="hand-consumer", words="by hand, 30 rests, a consumer unit", expected="accept",
         sensors=Sensors(grade="consumer")),
    Kind(name="table-navigation", words="rough table, 1.5°, navigation unit", expected="accept", handling=TABLE,
         sensors=NAVIGATION, driver=EXACT),
    Kind(name="table-tactical", words="rough table, 1.5°, tactical unit", expected="accept", handling=TABLE,
         sensors=Sensors(grade="tactical", rate=50.0), driver=EXACT),
    Kind(name="cube-26", words="cube tilter, 26 positions, MEMS", expected="accept", handling=CUBE),
    Kind(name="cube-alone", words="cube tilter, accelerometers only", expected="accept", handling=CUBE, alone=True),
    Kind(name="hand-alone", words="by hand, accelerometers only", expected="accept", alone=True),
    Kind(name="faces-alone", words="six faces once each, accelerometers only: their axes are not determined",
         expected="name the cause", says="six faces|faces|axes|axis", handling=FACES, alone=True),
    Kind(name="faces", words="six faces once each, MEMS with gyros", expected="accept", handling=FACES),
    Kind(name="full-turns", words="six faces and a full turn about each axis, MEMS", expected="accept", handling=TURNS),
    Kind(name="tremor", words="by hand, tremor of 2° at 4–10 Hz in the turns", expected="accept",
         handling=Handling(tremor=2.0 * DEG)),
    Kind(name="soft-mount", words="rings with 1° at 8 Hz for 0.3 s after every stop", expected="accept",
         handling=Handling(ringing=(1.0 * DEG, 8.0, 0.3))),
    Kind(name="creeping", words="creeps by 0.1° within a few seconds after every stop", expected="accept",
         handling=Handling(ringing=(0.1 * DEG, 0.0, 1.0))),
    Kind(name="knocks", words="six knocks of 2 g at random times", expected="accept", handling=Handling(knocks=6)),
    Kind(name="held", words="held in the hand at rest, tremor of 0.05°", expected="accept with scatter",
         says="scatter|residual|noise", handling=Handling(tremor=2.0 * DEG, tremor_at_rest=0.05 * DEG)),
    Kind(name="low-pass-20", words="low-pass filter of 20 Hz before sampling", expected="accept",
         sensors=Sensors(cutoff=20.0)),
    Kind(name="instantaneous", words="instantaneous samples instead of means", expected="accept",
         sensors=Sensors(instantaneous=True)),
    Kind(name="late-30-ms", words="accelerometers delayed by 30 ms", expected="accept",
         sensors=Sensors(accel_delay=0.03)),
    Kind(name="beyond-3", words="all parameters beyond the linear model at three times their usual size",
         expected="accept", sensors=Sensors(beyond=3.0)),
    Kind(name="beyond-3-table", words="the same, navigation unit on a rough table", expected="accept", handling=TABLE,
         sensors=Sensors(grade="navigation", rate=50.0, beyond=3.0), driver=EXACT),
    Kind(name="sixteen-bits", words="16-bit readings, ±16 g and ±2000 °/s", expected="accept",
         driver=_file(step=(16.0 * G0 / 32768.0, 2000.0 * DEG / 32768.0))),
    Kind(name="jitter", words="time stamps jitter by 1 ms", expected="accept", driver=_file(jitter=1e-3)),
    Kind(name="twice", words="0.5 % of the rows repeated", expected="accept", driver=_file(twice=0.005)),
    Kind(name="spikes", words="five single readings wrong by up to 8 g or 1000 °/s", expected="accept",
         driver=_file(spikes=5)),
    Kind(name="held-samples", words="five samples repeat the previous one", expected="accept", driver=_file(held=5)),
    Kind(name="smoothed", words="exponential average of 50 ms in the driver", expected="accept",
         driver=_file(smoothing=0.05)),
    Kind(name="warm-8", words="warms by 8 K in minutes, with a thermometer", expected="accept",
         sensors=Sensors(warming=(8.0, 100.0, 0.0))),
    Kind(name="warm-8-lag", words="the same, the sensors lag 30 s behind the thermometer", expected="accept",
         sensors=Sensors(warming=(8.0, 100.0, 30.0))),
    # biases that move
    Kind(name="markov-30", words="biases wander: Gauss–Markov process of 30 s, six times the usual size",
         expected="accept with scatter", says="wander|bias|scatter|in-run",
         sensors=Sensors(in_run=Process(form="markov", size=6.0, memory=30.0))),
    Kind(name="markov-300", words="the same with 300 s", expected="accept with scatter",
         says="wander|bias|scatter|in-run|drift",
         sensors=Sensors(in_run=Process(form="markov", size=6.0, memory=300.0))),
    Kind(name="walk", words="biases: random walk to six times the usual size", expected="accept with scatter",
         says="wander|bias|scatter|in-run|drift", sensors=Sensors(in_run=Process(form="walk", size=6.0))),
    Kind(name="flicker", words="biases: flicker noise of six times the usual size", expected="accept with scatter",
         says="wander|bias|scatter|in-run", sensors=Sensors(in_run=Process(form="flicker", size=6.0))),
    Kind(name="anew", words="biases independent in every rest, six times the usual size",
         expected="accept with scatter", says="wander|bias|scatter|in-run",
         sensors=Sensors(in_run=Process(form="white", size=6.0))),
    Kind(name="warm-up", words="warm-up with a time constant of 100 s, without a thermometer",
         expected="accept with scatter", says="warm|drift|wander|bias|scatter",
         sensors=Sensors(in_run=Process(form="exponential", size=40.0, memory=100.0))),
    Kind(name="warm-unseen", words="warms by 14 K, without a thermometer", expected="accept with scatter",
         says="warm|drift|wander|bias|scatter|temperature",
         sensors=Sensors(warming=(14.0, 100.0, 0.0), thermometer=False)),
    Kind(name="one-scatters", words="one accelerometer steps by 25 µg from rest to rest, navigation unit",
         expected="accept with scatter", says="scatter|wander", handling=TABLE,
         sensors=Sensors(grade="navigation", rate=50.0, scatter_of_one=25e-6 * G0), driver=EXACT),
    # what the model has not
    Kind(name="jump", words="gyro biases jump by 0.3 °/s half way", expected="name the cause", says="jump",
         sensors=Sensors(jump=0.3 * DEG)),
    Kind(name="nonlinear-gyros", words="gyro scale factors change with the square of the rate, 0.5 % at 100 °/s",
         expected="name the cause", says="nonlinear|rate|cubic|square", sensors=Sensors(gyro_cubic=0.005)),
    Kind(name="cross-products", words="cross products of forces in the accelerometers, 2 mg", expected="name the cause",
         says="product|cross", sensors=Sensors(cross=2e-3 * G0)),
    Kind(name="wrong-hemisphere", words="latitude with the wrong sign, navigation unit", expected="name the cause",
         says="latitude", handling=TABLE, sensors=NAVIGATION, driver=EXACT, south=True),
    Kind(name="memory", words="accelerometers remember 0.1 % of the force over 60 s, navigation unit",
         expected="name the cause", says="memory|hysteresis|remember", handling=TABLE,
         sensors=Sensors(grade="navigation", rate=50.0, remembers=(1e-3, 60.0)), driver=EXACT),
    # drivers and files
    Kind(name="dead-zone", words="gyros below 0.15 °/s are written as 0", expected="name the cause",
         says="dead zone|written as 0|small rates|exact", driver=_file(dead_zone=0.15 * DEG)),
    Kind(name="self-zeroed", words="the driver subtracts the gyro mean of the first 2 s of every rest",
         expected="name the cause", says="wander|bias|zero|scatter|jump", driver=_file(zeroed=2.0)),
    Kind(name="clipped", words="gyros are clipped at 60 °/s in some turns, which are left out", expected="accept",
         driver=_file(limit=(16.0 * G0, 60.0 * DEG))),
    Kind(name="normalised", words="accelerometers normalised to g", expected="refuse", driver=_file(normalised=True)),
    Kind(name="no-gravity", words="accelerometers with gravity removed by a fusion filter", expected="refuse",
         driver=_file(without_gravity=True)),
    Kind(name="in-g", words="accelerometers in g, declared as m/s²", expected="refuse",
         driver=_file(accel_factor=1.0 / G0)),
    Kind(name="in-degrees", words="gyros in °/s, declared as rad/s", expected="refuse",
         driver=_file(gyro_factor=1.0 / DEG)),
    Kind(name="mirrored", words="a left-handed frame: y of accelerometers and gyros reversed", expected="refuse",
         driver=_file(mirrored=True)),
    Kind(name="swapped-gyros", words="the gyros' x and y exchanged", expected="refuse",
         driver=_file(swapped_gyros=True)),
    Kind(name="lost-counted", words="0.5 % of the rows lost, time stamps counted from the rows",
         expected="name the cause", says="lost|sample|missing", driver=_file(lost=0.005, counted=True)),
    Kind(name="lost-stamped", words="0.5 % of the rows lost, correct time stamps", expected="accept",
         driver=_file(lost=0.005)),
    Kind(name="clock-50", words="a clock 50 ppm fast with unspecified accuracy; tactical unit on a rough table",
         expected="accept", handling=TABLE, sensors=Sensors(grade="tactical", rate=50.0),
         driver=Driver(clock_error_ppm=50.0)),
)  # fmt: skip


IN_RUN = Process(form="markov", memory=300.0)
WAVED = Sensors(in_run=IN_RUN)
BOARD = Waving(style="still", seconds=1200.0)
TURNED = Handling(rests=20, first_rest=6.0, rest=4.0, turn=2.5)
"""Rests and turns of two minutes and a quarter."""


def _swept(way: Literal["warming", "cooling", "both"], whole: bool = False) -> Sensors:
    """A board of 25 samples a second whose temperature changes."""
    return Sensors(rate=25.0, in_run=IN_RUN, sweep=Sweep(way=way, whole=whole))


def _compass(soft: float = 0.02) -> Sensors:
    return Sensors(in_run=IN_RUN, magnetometer=Magnetometer(soft=soft))


FURTHER = (
    # the same devices for two minutes each
    Kind(name="rests-120", words="17 rests of 4 s with turns between them, 120 s", expected="accept", device="waved",
         handling=Handling(rests=18, first_rest=10.0, rest=4.0, turn=2.5), sensors=WAVED),
    Kind(name="pivot", words="on a pivot, rhythmic", expected="accept", device="waved", waving=Waving(),
         sensors=WAVED),
    Kind(name="pivot-jerky", words="on a pivot, jerky", expected="accept", device="waved",
         waving=Waving(style="jerky"), sensors=WAVED),
    Kind(name="pivot-regrip", words="on a pivot, with three changes of grip", expected="accept", device="waved",
         waving=Waving(grips=3), sensors=WAVED),
    Kind(name="hand-waved", words="in the hand, rhythmic", expected="accept", device="waved",
         waving=Waving(sway=0.05), sensors=WAVED),
    Kind(name="hand-drifting", words="in a hand that drifts by half a metre, jerky", expected="accept",
         device="waved", waving=Waving(style="jerky", sway=0.05, drift=0.25), sensors=WAVED),
    # still
    Kind(name="warming", words="a board that lies still and warms by 5 to 60 K, sensors lagging by up to 200 s",
         expected="accept", waving=BOARD, sensors=_swept("warming")),
    Kind(name="cooling", words="the same, cooling", expected="accept", waving=BOARD, sensors=_swept("cooling")),
    Kind(name="up-and-down", words="the same, warming and cooling", expected="accept", waving=BOARD,
         sensors=_swept("both")),
    Kind(name="whole-degrees", words="warming, thermometer with a resolution of 1 °C", expected="accept", waving=BOARD,
         sensors=_swept("warming", whole=True)),
    Kind(name="gyros", words="gyros only, 10 minutes at rest", expected="accept", gyros_alone=True,
         waving=Waving(style="still", seconds=600.0), sensors=WAVED),
    # a magnetometer
    Kind(name="mag-turns", words="a magnetometer, 20 rests with turns between them", expected="accept",
         device="compass", handling=TURNED, sensors=_compass()),
    Kind(name="mag-pivot", words="the same magnetometer on a pivot, rhythmic", expected="accept", device="compass",
         waving=Waving(), sensors=_compass()),
    Kind(name="soft-iron", words="soft iron of 15 %, 20 rests with turns between them", expected="accept",
         handling=TURNED, sensors=_compass(soft=0.15)),
)  # fmt: skip
"""Recordings other than rests and turns, listed in separate tables."""


def named(name: str) -> Kind:
    """The kind of a name."""
    return next(kind for kind in (*KINDS, *FURTHER) if kind.name == name)


def seed_of(series: str, kind: str, index: int) -> int:
    """64 bits by which a session is drawn."""
    return int.from_bytes(hashlib.sha256(f"{series}/{kind}/{index}".encode()).digest()[:8], "big")


def kept(kind: Kind, name: str) -> bool:
    """Whether a recording of a kind is to show a parameter: of a board that lies still none but what changes, of gyros
    alone the bias."""
    if kind.sensors.sweep is not None:
        return ".change." in name or ".thermal." in name
    if kind.gyros_alone:
        return name.startswith("gyro.bias")
    return not kind.alone or name.startswith("accel")


def simulated(kind: Kind, index: int, series: str = SEALED) -> Case:
    """One session of a kind."""
    seed = seed_of(series, kind.name, index)
    motion, device, noise, driver = (np.random.default_rng([seed, stream]) for stream in range(4))
    if kind.device:
        device = np.random.default_rng([seed_of(series, kind.device, index), 1])
    way = course(kind.handling, motion) if kind.waving is None else waved(kind.waving, motion)
    made = through(kind.driver, readings(kind.sensors, way, device, noise), way, driver)
    truth = {name: value for name, value in made.truth.items() if kept(kind, name)}
    return Case(
        name=f"{kind.name} {index}",
        kind=kind.name,
        time=made.time,
        accel=made.accel[:, :0] if kind.gyros_alone else made.accel,
        gyro=None if kind.alone else made.gyro,
        temperature=made.temperature,
        ends=made.ends,
        mag=made.mag,
        mag_field=made.mag_field,
        gravity=way.gravity + GRAVITY_U * float(driver.normal()),
        gravity_u=GRAVITY_U,
        latitude=-way.latitude if kind.south else way.latitude,
        sections=way.sections,
        turn_angle=2.0 * np.pi if kind.handling.programme == "turns" else None,
        clock_ppm_u=kind.driver.clock_ppm_u,
        truth=truth,
        device=f"simulated {seed:016x}",
        source=f"evidence.simulated.kinds, series {series!r}",
    )
