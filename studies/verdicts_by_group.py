"""Does what a verdict spares hold, where it refuses a part of the parameters?

Where something is wrong with a group of parameters, `gyro.bias`, the others of the kind may be accepted. Sessions with
departures as in `studies/departures.py`, with a wrong latitude or gravity, and recordings by hand of MEMS devices whose
gyros jump once. Of the sessions that are not accepted those groups that are: errors over u must have an rms of at most
1.15, and at most 1 % may be beyond 3 u.

    python studies/verdicts_by_group.py 40        40 sessions a line, in Markdown; more words: of such lines alone
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import polars as pl
from departures import CLEAN, DEPARTURES, SETTINGS, Departure, Setting, session
from scipy.stats import binom

from tumble.diagnosis.verdict import verdict
from tumble.inference.estimate import Outcome
from tumble.inference.joint import joint
from tumble.planning.setup import Setup
from tumble.reduction.observations import Observations
from tumble.rotation import unit_vector
from tumble.run.calibrate import calibrate
from tumble.run.observed import inspect_session
from tumble.sensors.parameters import LINEAR, group_name
from tumble.simulation.session import read_truth, simulate_session
from tumble.units import DEGREE

MOST_RMS, MOST_BEYOND = 1.15, 0.01
TABLE, CUBE, HAND = SETTINGS
NAMED = {off.name: off for off in DEPARTURES}

Tried = tuple[Outcome, Mapping[str, float]]
"""What is said of a session, and the errors of its parameters over u."""


def departed(
    setting: Setting, off: Departure = CLEAN, change: Callable[[Observations], Observations] = lambda same: same
) -> Callable[[int], Tried]:
    """Sessions with a departure, of which something is stated otherwise than it is."""

    def tried(seed: int) -> Tried:
        observations, truth = session(setting, off, seed)
        observations = change(observations)
        try:
            estimate = joint(observations)
        except np.linalg.LinAlgError as error:
            return Outcome(reasons=(str(error),)), {}
        seen = [i for i, name in enumerate(estimate.names) if name in truth and estimate.observable[i]]
        errors = {
            estimate.names[i]: (estimate.values[i] - truth[estimate.names[i]]) / float(estimate.u[i]) for i in seen
        }
        return verdict(estimate, observations), errors

    return tried


def stated(**off: float) -> Callable[[Observations], Observations]:
    """Observations whose site is stated wrong by so much, SI."""

    def change(observations: Observations) -> Observations:
        site = observations.site
        return replace(
            observations, site=replace(site, **{name: getattr(site, name) + size for name, size in off.items()})
        )

    return change


def jumped(size: float) -> Callable[[int], Tried]:
    """Recordings of eighteen rests by hand, in which the biases of the gyros change by a size, °/s, between two."""

    def tried(seed: int) -> Tried:
        with TemporaryDirectory() as place:
            folder = simulate_session(Path(place) / "s", Setup.of(grade="mems", positions=18), seed=seed)
            truth, log = read_truth(folder / "truth.json"), pl.read_parquet(folder / "log.parquet")
            found = inspect_session(folder)
        rests, site = found.segmentation.rests, found.session.site
        rng = np.random.default_rng([seed, 7])
        direction = unit_vector(rng.normal(size=3))
        after, time = int(rng.integers(3, len(rests) - 3)), log["t"].to_numpy()
        step = time > 0.5 * (rests[after - 1].stop + rests[after].start)
        made = calibrate(
            accel=log.select("ax", "ay", "az").to_numpy(),
            gyro=log.select("gx", "gy", "gz").to_numpy() + np.outer(step, size * DEGREE * direction),
            time=time,
            latitude=site.latitude,
            height=site.height,
            gravity=site.gravity,
            gravity_u=site.gravity_u,
        )
        known = [p for p in made.parameters if p.u and p.name in truth]
        return made.outcome, {p.name: (p.value - truth[p.name]) / (p.u or np.nan) for p in known}

    return tried


CASES: Mapping[str, tuple[Callable[[int], Tried], int]] = {
    "gravity wrong by 1,200 mGal, by hand": (departed(HAND, change=stated(gravity=0.012)), 500),
    "gyros that jump by 0.5 °/s, by hand": (jumped(0.5), 300),
    "gyros that jump by 3 °/s, by hand": (jumped(3.0), 200),
    "latitude wrong by 0.05 rad, rough table": (departed(TABLE, change=stated(latitude=0.05)), 500),
    **{
        f"{name}, × 3, rough table": (departed(TABLE, NAMED[name].times(3.0)), 500)
        for name in ("hysteresis 10 µg", "memory 50 ppm over 60 s", "gyro nonlinearity 20 ppm at 10 °/s")
    },
    "0.2 % of samples lost, rough table": (departed(TABLE, NAMED["0.2 % of samples lost"]), 500),
    "1 % of samples lost, cube-26": (departed(CUBE, NAMED["1 % of samples lost"]), 500),
}
"""What is tried, and the seed of the first session."""


def main() -> None:
    short = "--short" in sys.argv
    count, words, bad = 3 if short else int(sys.argv[1]), sys.argv[2:], []
    print("| what is wrong | N | refused | of those accepted (sessions: rms of errors over u) | rms | beyond 3 u |")
    print("|---|---|---|---|---|---|")
    for name, (tried, first) in list(CASES.items())[: 1 if short else None]:
        if words and not short and not any(word in name for word in words):
            continue
        refused = [(outcome, z) for outcome, z in map(tried, range(first, first + count)) if not outcome.accepted]
        errors, of_groups = np.zeros(0), []
        for group in LINEAR:
            spared = [z for outcome, z in refused if outcome.of(group.name)]
            of_group = np.array([each for z in spared for each in (z[n] for n in z if group_name(n) == group.name)])
            errors = np.append(errors, of_group)
            if len(of_group):
                of_groups.append(f"{group.name} ({len(spared)}: {np.sqrt(np.mean(of_group**2)):.2f})")
        errors = errors if len(errors) else np.zeros(1)
        rms, beyond = float(np.sqrt(np.mean(errors**2))), float(np.mean(np.abs(errors) > 3.0))
        print(
            f"| {name} | {count} | {len(refused)} | {', '.join(of_groups)} | {rms:.2f} | {100.0 * beyond:.1f} % |",
            flush=True,
        )
        by_chance = binom.sf(np.sum(np.abs(errors) > 3.0) - 1, len(errors), MOST_BEYOND)  # of so many or more
        if rms > MOST_RMS or (beyond > MOST_BEYOND and by_chance < (1e-6 if short else 0.05)):
            bad.append(name)
    print(f"Does what is spared hold? {'Yes' if not bad else 'No: ' + '; '.join(bad)}")
    if bad:
        sys.exit(1)


if __name__ == "__main__":
    main()
