"""A watch: rests of a day against a calibration, by the rows of a field check; what has moved is found, what has not is
not called so. How often `studies/watched_days.py` counts."""

from __future__ import annotations

import io
import json
import os
import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from click.testing import CliRunner
from tumble.use.listening import LiveSamples, opened
from tumble.use.watch import LONGEST, Event, Notice, Watch, WatchedRest, watch_session, watched

from tests.use.test_check import device, seen
from tumble.cli import main
from tumble.errors import InputError
from tumble.methods.field_check import field_check
from tumble.methods.rest_chain import JudgedRest, RestChain
from tumble.planning.setup import Setup
from tumble.recording.live.sources import Ended, LineSource
from tumble.recording.log import Chunk, open_log
from tumble.recording.session_file import read_session, session_of
from tumble.reduction.observations import Observations
from tumble.result.calibration import Calibration, read_calibration
from tumble.run.calibrate import calibrate
from tumble.sensors.parameters import usual_sizes
from tumble.simulation.session import simulate_session
from tumble.simulation.temperature_profile import temperature_profile
from tumble.units import DEGREE, Array
from tumble.use.check import known_before

MG = 9.80665e-3
MOVED_AT = 150.0


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A calibrated device, "calibration.json", and a day of it, "day", of 30 rests, and "warm", with a thermometer."""
    out = tmp_path_factory.mktemp("watch")
    setup = Setup.of(grade="mems", positions=18)
    calibrate(simulate_session(out / "calibrated", setup, seed=3)).write(out / "calibration.json")
    simulate_session(out / "day", Setup.of(grade="mems", positions=30), seed=3)
    return out


def chained(observations: Observations, calibration: Calibration) -> tuple[RestChain, list[JudgedRest]]:
    """Rests judged one after the other."""
    chain, judged = None, list[JudgedRest]()
    for k in range(len(observations.rests)):
        alone = observations.of_rest(k)
        known = known_before(calibration, alone, "mems", {})
        chain = chain or RestChain(known, usual_sizes("mems"))
        judged.append(chain.add(alone, known))
    assert chain is not None
    return chain, judged


def only_rests(observations: Observations) -> Observations:
    return replace(observations, turns=None, turn_samples=None)


def test_the_first_rest_is_judged_as_a_field_check_of_it_alone() -> None:
    first = seen(8, turns=False).of_rest(0)
    known = known_before(device()[1], first, "mems", {})
    judged = RestChain(known, {}).add(first, known)
    alone = field_check(first, known)
    for name, test in judged.tests.items():
        change, u = alone.tests[name]
        assert test.change == pytest.approx(change, abs=0.02 * u), name
        assert test.u == pytest.approx(u, rel=0.02), name
    assert judged.misfit.chi_square == pytest.approx(alone.misfit.chi_square, rel=0.1, abs=0.1)


def test_all_rests_together_say_what_a_field_check_of_one_session_says() -> None:
    """Rest by rest, in-run biases carried along, without the wandering: not a second mechanism."""
    observations = only_rests(seen(25, turns=False))
    calibration = device()[1]
    chain = None
    for k in range(len(observations.rests)):
        alone = observations.of_rest(k)
        known = known_before(calibration, alone, "mems", {})
        chain = chain or RestChain(known, {})
        chain.add(alone, known)
    assert chain is not None
    by_rest, at_once = chain.result(), field_check(observations, known_before(calibration, observations, "mems", {}))
    assert by_rest.valid
    assert at_once.valid
    assert by_rest.tests.keys() == at_once.tests.keys()
    for name, (change, u) in at_once.tests.items():
        assert by_rest.tests[name][0] == pytest.approx(change, abs=0.35 * u), name
        assert by_rest.tests[name][1] == pytest.approx(u, rel=0.15), name
    assert by_rest.misfit.degrees == at_once.misfit.degrees


@pytest.mark.parametrize(
    ("kind", "axis", "size", "within"),
    [
        ("gyro", 1, 0.2 * DEGREE, 3),
        ("gyro", 2, -0.02 * DEGREE, 10),
        ("accel", 0, 5.0 * MG, 6),
        ("gyro", 0, 5.0 * DEGREE, 2),
    ],
)
def test_a_bias_that_moves_is_found_within_some_rests(kind: str, axis: int, size: float, within: int) -> None:
    observations = only_rests(seen(40, turns=False))
    readings = getattr(observations.rests, kind).copy()
    readings[20:, axis] += size
    changed = replace(observations, rests=replace(observations.rests, **{kind: readings}))
    _, judged = chained(changed, device()[1])
    moved = [(k, each) for k, rest in enumerate(judged) for each in rest.moved]
    ((at, found),) = moved
    named = {found.name: found.value, **found.others}
    assert f"{kind}.bias.{'xyz'[axis]}" in named
    assert 20 < at < 20 + within
    assert 17 <= found.rest <= 20
    assert named[f"{kind}.bias.{'xyz'[axis]}"] == pytest.approx(size, abs=4.0 * found.u)


def test_parameters_after_a_day_are_those_of_the_device_as_it_is_now() -> None:
    observations = only_rests(seen(40, turns=False))
    readings = observations.rests.gyro.copy()
    readings[20:, 1] += 0.2 * DEGREE
    scenario, calibration = device()
    changed = replace(observations, rests=replace(observations.rests, gyro=readings))
    chain, judged = chained(changed, calibration)
    result, names = chain.result(tuple(each for rest in judged for each in rest.moved)), chain.instrument.names
    u = np.sqrt(np.diag(result.covariance))
    for name, more in (("gyro.bias.y", 0.2 * DEGREE), ("gyro.bias.x", 0.0), ("accel.scale.z", 0.0)):
        i = names.index(name)
        assert result.values[i] == pytest.approx(scenario.truth[name] + more, abs=4.0 * u[i]), name


def test_nothing_is_said_of_what_stays() -> None:
    chain, judged = chained(only_rests(seen(60, turns=False)), device()[1])
    assert not [rest for rest in judged if rest.moved or not rest.learned]
    assert chain.result().valid


def test_one_rest_alone_says_nothing_and_is_not_learned_from() -> None:
    """A car on a bend, a lift: |f| is not gravity, once."""
    observations = only_rests(seen(30, turns=False))
    accel = observations.rests.accel.copy()
    accel[12] *= 1.05
    _, judged = chained(replace(observations, rests=replace(observations.rests, accel=accel)), device()[1])
    assert [k for k, rest in enumerate(judged) if not rest.learned] == [12]
    assert not [rest for rest in judged if rest.moved]


def test_a_sum_of_likelihood_ratios_is_one_in_the_mean() -> None:
    """E e^ℓ = 1 of Eq. (3), by which the rate of false alarms is bounded."""
    zeta, size = np.random.default_rng(0).standard_normal(200_000), 1.3
    ratio = np.exp(size * zeta - 0.5 * size**2)
    assert ratio.mean() == pytest.approx(1.0, abs=5.0 * ratio.std() / np.sqrt(len(zeta)))


# -------------------- streams --------------------


def events_of(folder: Path, name: str, rows: int = 65536) -> list[Event]:
    log = open_log(read_session(folder / name))
    return list(watched(Watch(folder / "calibration.json", log.session, sample_rate=log.rate), log.chunks(rows)))


def test_the_same_is_said_however_the_stream_is_cut(folder: Path) -> None:
    first, second = events_of(folder, "day"), events_of(folder, "day", 977)
    assert len(first) == 30
    for one, other in zip(first, second, strict=True):
        assert isinstance(one, WatchedRest)
        assert isinstance(other, WatchedRest)
        assert (one.number, one.start, one.stop) == (other.number, other.start, other.stop)
        assert one.judged is not None
        assert other.judged is not None
        assert one.judged.tests == other.judged.tests
        assert one.force == pytest.approx(other.force, abs=1e-12)


def moved_copy(folder: Path, to: Path, *changes: pl.Expr, keep: pl.Expr | None = None) -> Path:
    """The day with another log."""
    to.mkdir()
    log = pl.read_parquet(folder / "day" / "log.parquet").with_columns(*changes)
    (log if keep is None else log.filter(keep)).write_parquet(to / "log.parquet")
    (to / "session.toml").write_text((folder / "day" / "session.toml").read_text())
    return to


def test_a_day_in_which_an_accelerometer_moves(folder: Path, tmp_path: Path) -> None:
    later = pl.when(pl.col("t") > MOVED_AT)
    day = moved_copy(
        folder, tmp_path / "moved", later.then(pl.col("ax") + 5.0 * MG).otherwise(pl.col("ax")).alias("ax")
    )
    before = (folder / "calibration.json").read_bytes()
    done = CliRunner().invoke(main, ["watch", str(folder / "calibration.json"), str(day)])
    assert done.exit_code == 1, done.stderr
    (said,) = [line for line in done.stderr.splitlines() if line.startswith("moved: ")]
    assert said.startswith("moved: accel.bias.x has changed by +")
    assert done.stdout.rstrip().endswith("changed")
    assert (folder / "calibration.json").read_bytes() == before
    quiet = CliRunner().invoke(main, ["watch", str(folder / "calibration.json"), str(folder / "day")])
    assert quiet.exit_code == 0, quiet.stderr
    assert "no change is shown, and none larger than\naccel.bias " in quiet.stdout
    assert quiet.stdout.count("|f|−g") == 30


def test_a_stream_that_drops_and_resumes_goes_on(folder: Path, tmp_path: Path) -> None:
    keep = (pl.col("t") < 100.0) | (pl.col("t") > 130.0)
    day = moved_copy(folder, tmp_path / "dropped", keep=keep)
    events = list(watch_session(folder / "calibration.json", day))
    (notice,) = [event for event in events if isinstance(event, Notice)]
    assert notice.text.startswith("nothing came for 30.0 s")
    rests = [event for event in events if isinstance(event, WatchedRest)]
    assert 24 <= len(rests) <= 29
    assert not [rest for rest in rests if rest.moved]
    assert all(not (rest.start < 100.0 < rest.stop) and not (rest.start < 130.0 < rest.stop) for rest in rests)


def test_a_clock_that_begins_anew_is_another_power_on(folder: Path) -> None:
    """Another power-on may have other biases: what the last one taught is as good as the calibration again."""
    log = pl.read_parquet(folder / "day" / "log.parquet")
    again = log.filter(pl.col("t") > MOVED_AT).with_columns(pl.col("t") - MOVED_AT, gy=pl.col("gy") + 0.03 * DEGREE)
    sent = Sent(pl.concat([log.filter(pl.col("t") <= MOVED_AT), again]))
    calibration = read_calibration(folder / "calibration.json")
    samples = LiveSamples(sent, calibration)
    chunks = list(samples.chunks())
    assert chunks[0].file == 0
    assert chunks[-1].file == 1
    assert samples.interval is not None
    watch = Watch(calibration, samples.session, sample_rate=1.0 / samples.interval)
    events = list(watched(watch, chunks))
    assert [e.text for e in events if isinstance(e, Notice)] == ["the clock begins anew: taken for another power-on"]
    assert watch.rests >= 27
    assert not watch.moved


class Sent(LineSource):
    """Lines as a device sends them, in pieces."""

    name = "device"

    def __init__(self, log: pl.DataFrame) -> None:
        out = io.BytesIO()
        log.write_csv(out)
        self._data = out.getvalue()

    def read(self, timeout: float) -> bytes:  # noqa: ARG002
        if not self._data:
            raise Ended
        piece, self._data = self._data[:50_001], self._data[50_001:]
        return piece


def test_lines_on_standard_input_are_watched(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    log = pl.read_parquet(folder / "day" / "log.parquet")
    out = io.BytesIO()
    log.write_csv(out)
    read, write = os.pipe()

    def send() -> None:
        with os.fdopen(write, "wb") as pipe:
            pipe.write(out.getvalue())

    threading.Thread(target=send, daemon=True).start()
    with os.fdopen(read) as stdin:
        monkeypatch.setattr("tumble.recording.live.sources.sys.stdin", stdin)
        watch, chunks = opened("stdin", read_calibration(folder / "calibration.json"), None)
        live = [event for event in watched(watch, chunks) if isinstance(event, WatchedRest)]
    recorded = [event for event in events_of(folder, "day") if isinstance(event, WatchedRest)]
    assert len(live) == len(recorded)
    for one, other in zip(live, recorded, strict=True):
        assert one.start == pytest.approx(other.start, abs=0.11)
        assert one.force == pytest.approx(other.force, abs=0.2 * MG)


def test_what_is_printed_as_data_is_a_line_each(folder: Path) -> None:
    done = CliRunner().invoke(main, ["watch", str(folder / "calibration.json"), str(folder / "day"), "--json"])
    lines = [json.loads(line) for line in done.stdout.splitlines()]
    assert [line["event"] for line in lines] == ["rest"] * 30 + ["check"]
    assert lines[0]["number"] == 0
    assert lines[0]["used"]
    assert {bias["name"] for bias in lines[0]["biases"]} >= {"gyro.bias.x", "gyro.bias.y", "gyro.bias.z"}
    assert lines[-1]["verdict"] == "accepted"
    assert lines[-1]["rests"] == 30


def still(seconds: float, *, celsius: float = 20.0, shake: float = 0.0, seed: int = 0) -> dict[str, Array]:
    """Readings at rest, 100 Hz, of a perfect MEMS device on its back, perhaps with vibration."""
    rng, n = np.random.default_rng(seed), int(100 * seconds)
    force = np.array([0.0, 0.0, 9.81553]) + 0.015 * rng.standard_normal((n, 3)) + shake * rng.standard_normal((n, 3))
    rate = 1.7e-3 * rng.standard_normal((n, 3)) + 0.1 * shake * rng.standard_normal((n, 3))
    return {"accel": force, "gyro": rate, "temperature": np.full((n, 1), celsius + 273.15)}


def chunks_of(*parts: dict[str, Array]) -> Iterator[Chunk]:
    """Parts one after the other."""
    at = 0.0
    for part in parts:
        n = len(part["accel"])
        time: Array = at + 0.01 * np.arange(1.0, n + 1.0)
        at = float(time[-1])
        arrays = {name: part[name] for name in ("accel", "gyro", "temperature")}
        yield Chunk(file=0, time=time, dt=np.full(n, 0.01), **arrays)


@pytest.fixture(scope="module")
def warm(tmp_path_factory: pytest.TempPathFactory) -> Calibration:
    """A calibration over 10 to 30 °C."""
    out = tmp_path_factory.mktemp("warm")
    setup = Setup.of(grade="mems", positions=18)
    return calibrate(simulate_session(out / "calibrated", setup, seed=5, temperature=temperature_profile("10:30")))


def watch_of(calibration: Calibration) -> Watch:
    log = {
        "time": "t",
        "accel": {"columns": ["ax", "ay", "az"], "unit": "m/s^2"},
        "gyro": {"columns": ["gx", "gy", "gz"], "unit": "rad/s"},
        "temperature": {"columns": ["temperature"], "unit": "degC"},
    }
    names = ("t", "ax", "ay", "az", "gx", "gy", "gz", "temperature")
    site = {"latitude_deg": 55.0}
    described = {"format": 1, "device": {"serial": calibration.serial}, "site": site, "log": log}
    session = session_of(described, {name: np.zeros(1) for name in names})
    return Watch(calibration, session, sample_rate=100.0)


def test_a_temperature_outside_of_what_was_calibrated_is_said(warm: Calibration) -> None:
    watch = watch_of(warm)
    events = list(watched(watch, chunks_of(still(60.0), still(5.0, shake=3.0), still(60.0, celsius=55.0, seed=1))))
    notices = [event.text for event in events if isinstance(event, Notice)]
    assert len(notices) == 1
    assert notices[0].startswith("temperature outside 1")
    assert notices[0].endswith("°C, which was calibrated")
    rests = [event for event in events if isinstance(event, WatchedRest)]
    assert rests[-1].outside == ("temperature",)
    assert rests[-1].celsius is not None
    assert watch.check().references == warm.temperature.references  # at which its parameters are


def test_flight_without_a_rest_is_none(warm: Calibration) -> None:
    """The floors are then those of the vibration, and the calmest part seems to rest."""
    watch = watch_of(warm)
    events = list(watched(watch, chunks_of(still(120.0, shake=3.0))))
    rests = [event for event in events if isinstance(event, WatchedRest)]
    assert all(rest.judged is None and "times as noisy" in rest.why for rest in rests)
    assert not watch.rests
    with pytest.raises(InputError, match="expected rests to test the calibration with, found none"):
        watch.check()


def test_what_lasts_counts_anew_and_memory_does_not_grow(warm: Calibration) -> None:
    watch = watch_of(warm)
    kept = []
    for k, chunk in enumerate(chunks_of(*(still(60.0, seed=k) for k in range(40)))):
        watch.feed(chunk)
        kept.append(sum(len(piece.time) for piece, *_ in watch._kept))
        del k
    watch.finish()
    assert watch.rests == pytest.approx(2400.0 / LONGEST, abs=1)
    assert max(kept) <= 100 * 660
