"""A stream: rests of a day against a calibration, by the rows of a field check; what has moved is found, and nothing
else. How often `studies/watched_days.py` counts."""

from __future__ import annotations

import io
import json
import os
import threading
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from click.testing import CliRunner, Result

from tests.support.shared import calibrated
from tests.use.test_check import device, seen
from tumble.cli import main
from tumble.errors import InputError
from tumble.methods.field_check import field_check
from tumble.methods.rest_chain import JudgedRest, RestChain
from tumble.planning.setup import Setup
from tumble.recording.live.samples import SI_LOG
from tumble.recording.live.sources import Ended, LineSource
from tumble.recording.log import Chunk, open_log
from tumble.recording.session_file import read_session, session_of
from tumble.reduction.observations import Observations
from tumble.reduction.rest_stream import LONGEST
from tumble.result.calibration import Calibration
from tumble.run.observed import inspect_session
from tumble.sensors.parameters import usual_sizes
from tumble.simulation.session import simulate_session
from tumble.simulation.temperature_profile import temperature_profile
from tumble.units import DEGREE, Array
from tumble.use.check import CheckedRest, prior_at_check
from tumble.use.stream import Event, Notice, StreamCheck, check_stream

MG = 9.80665e-3
MOVED_AT = 150.0


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A calibrated device, "calibration.json", and a day of it, "day", of 30 rests, and "warm", with a thermometer."""
    out = tmp_path_factory.mktemp("watch")
    calibrated(Setup.of(grade="mems", positions=18), seed=3).write(out / "calibration.json")
    simulate_session(out / "day", Setup.of(grade="mems", positions=30), seed=3)
    return out


def chained(
    observations: Observations, calibration: Calibration, grade: str = "mems"
) -> tuple[RestChain, list[JudgedRest]]:
    """Rests judged one after the other."""
    chain, judged = None, list[JudgedRest]()
    for k in range(len(observations.rests)):
        alone = observations.of_rest(k)
        known = prior_at_check(calibration, alone, grade, {})
        chain = chain or RestChain(known, usual_sizes(grade))
        judged.append(chain.add(alone, known))
    assert chain is not None
    return chain, judged


def only_rests(observations: Observations) -> Observations:
    return replace(observations, turns=None, turn_samples=None)


def test_the_first_rest_is_judged_as_a_field_check_of_it_alone() -> None:
    first = seen(8, turns=False).of_rest(0)
    known = prior_at_check(device()[1], first, "mems", {})
    judged = RestChain(known, {}).add(first, known)
    alone = field_check(first, known)
    for name, test in judged.tests.items():
        assert test.change == pytest.approx(alone.tests[name].change, abs=0.02 * test.u), name
        assert test.u == pytest.approx(alone.tests[name].u, rel=0.02), name
    assert judged.misfit.chi_square == pytest.approx(alone.misfit.chi_square, rel=0.1, abs=0.1)


def test_all_rests_together_say_what_a_field_check_of_one_session_says() -> None:
    """Rest by rest, in-run biases carried along, without the wandering: not a second mechanism."""
    observations = only_rests(seen(25, turns=False))
    calibration = device()[1]
    chain = None
    for k in range(len(observations.rests)):
        alone = observations.of_rest(k)
        known = prior_at_check(calibration, alone, "mems", {})
        chain = chain or RestChain(known, {})
        chain.add(alone, known)
    assert chain is not None
    by_rest, at_once = chain.result(), field_check(observations, prior_at_check(calibration, observations, "mems", {}))
    assert by_rest.valid
    assert at_once.valid
    assert by_rest.tests.keys() == at_once.tests.keys()
    for name, test in at_once.tests.items():
        assert by_rest.tests[name].change == pytest.approx(test.change, abs=0.35 * test.u), name
        assert by_rest.tests[name].u == pytest.approx(test.u, rel=0.15), name
    assert by_rest.misfit.degrees == at_once.misfit.degrees


@pytest.mark.parametrize("grade", ["tactical", "navigation"])
def test_the_level_rate_of_the_earth_is_no_change_of_gyros_that_see_it(grade: str) -> None:
    """Rests whose headings nobody knows, of gyros known far better than the Earth turns, 15°/h."""
    observations = only_rests(seen(12, turns=False, grade=grade))
    assert observations.site.latitude
    chain, judged = chained(observations, device(grade)[1], grade)
    assert chain.result().explained
    assert not any(rest.moved for rest in judged)
    assert all(rest.learned for rest in judged)


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


# -------------------- streams --------------------


def run(*words: str | Path) -> Result:
    return CliRunner().invoke(main, list(map(str, words)))


def events_of(folder: Path, name: str, rows: int = 65536) -> tuple[StreamCheck, list[Event]]:
    """The events of a recorded day as a stream, cut into chunks of so many rows."""
    log = open_log(read_session(folder / name))
    check = StreamCheck(folder / "calibration.json", log.session, sample_rate=log.rate)
    return check, [*(event for chunk in log.chunks(rows) for event in check.feed(chunk)), *check.finish()]


def rests_in(events: list[Event]) -> list[CheckedRest]:
    return [event for event in events if isinstance(event, CheckedRest)]


def notices_in(events: list[Event]) -> list[str]:
    return [event.text for event in events if isinstance(event, Notice)]


def test_a_stream_has_the_rests_of_the_log_however_it_is_cut(folder: Path) -> None:
    """Whole, and in pieces of 977 rows: the rests that the reduction of the whole log finds, and the same tests."""
    first, second = rests_in(events_of(folder, "day")[1]), rests_in(events_of(folder, "day", 977)[1])
    assert first == second
    spans = inspect_session(folder / "day").segmentation.rests
    for name in ("start", "stop"):
        assert [getattr(rest, name) for rest in first] == pytest.approx([getattr(span, name) for span in spans])
    assert [rest.label.split(" (")[0] for rest in first] == [f"rest {i}" for i in range(1, 31)]


def changed_day(folder: Path, to: Path, *changes: pl.Expr, keep: pl.Expr | None = None) -> Path:
    """The day with another log."""
    to.mkdir()
    log = pl.read_parquet(folder / "day" / "log.parquet").with_columns(*changes)
    (log if keep is None else log.filter(keep)).write_parquet(to / "log.parquet")
    (to / "session.toml").write_text((folder / "day" / "session.toml").read_text())
    return to


def test_a_day_in_which_an_accelerometer_moves(folder: Path, tmp_path: Path) -> None:
    later = pl.when(pl.col("t") > MOVED_AT)
    moved = later.then(pl.col("ax") + 5.0 * MG).otherwise(pl.col("ax")).alias("ax")
    made, day = folder / "calibration.json", changed_day(folder, tmp_path / "moved", moved)
    before = made.read_bytes()
    done = run("check", made, "--listen", f"replay:{day}@max")
    assert done.exit_code == 1, done.stderr
    (said,) = [line for line in done.stderr.splitlines() if line.startswith("moved: ")]
    assert said.startswith("moved: accel.bias.x has changed by +")
    assert done.stdout.rstrip().endswith("changed")
    assert made.read_bytes() == before
    data = run("check", made, "--listen", f"replay:{folder / 'day'}@max", "--json")
    assert data.exit_code == 0, data.stderr
    lines = [json.loads(line) for line in data.stdout.splitlines()]
    assert [line["event"] for line in lines] == ["rest"] * 30 + ["check"]
    assert lines[0]["judged"]["tests"].keys() >= {"gyro.bias.x", "gyro.bias.y", "gyro.bias.z"}
    assert (lines[-1]["verdict"], len(lines[-1]["rests"])) == ("accepted", 30)


def test_what_is_of_a_stream_alone_is_refused_without_one(folder: Path) -> None:
    made, day = folder / "calibration.json", folder / "day"
    made_with: tuple[list[str | Path], ...] = (
        [],
        [day, "--listen", "stdin"],
        [day, "--session", day],
        ["--listen", "stdin", "--registry", day / "r.sqlite"],
    )
    for words in made_with:
        done = run("check", made, *words)
        assert done.exit_code == 2
        assert done.stderr.startswith("tumble: check: expected ")


def test_a_stream_that_drops_and_resumes_goes_on(folder: Path, tmp_path: Path) -> None:
    keep = (pl.col("t") < 100.0) | (pl.col("t") > 130.0)
    changed_day(folder, tmp_path / "dropped", keep=keep)
    (tmp_path / "calibration.json").write_bytes((folder / "calibration.json").read_bytes())
    check, events = events_of(tmp_path, "dropped")
    (notice,) = notices_in(events)
    assert notice.startswith("nothing came for 30.0 s")
    assert 24 <= len(rests_in(events)) <= 29
    assert not check.moved
    for at in (100.0, 130.0):
        assert not [r for r in rests_in(events) if r.start is not None and r.stop is not None and r.start < at < r.stop]


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


def test_a_clock_that_begins_anew_is_another_power_on(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Another power-on may have other biases: what the last one taught is as good as the calibration again."""
    log = pl.read_parquet(folder / "day" / "log.parquet")
    again = log.filter(pl.col("t") > MOVED_AT).with_columns(pl.col("t") - MOVED_AT, gy=pl.col("gy") + 0.03 * DEGREE)
    sent = Sent(pl.concat([log.filter(pl.col("t") <= MOVED_AT), again]))
    monkeypatch.setattr("tumble.use.stream.source_of", lambda _: sent)
    events = list[Event]()
    found = check_stream(folder / "calibration.json", "device", show=events.append)
    assert notices_in(events) == ["the clock begins anew: taken for another power-on"]
    assert len(found.rests) >= 27
    assert found.valid


def test_lines_on_standard_input_are_those_of_the_log(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By the command, in SI, without a session that describes them."""
    sent = Sent(pl.read_parquet(folder / "day" / "log.parquet"))
    read, write = os.pipe()

    def send() -> None:
        with os.fdopen(write, "wb") as pipe, suppress(Ended):
            while True:
                pipe.write(sent.read(0.0))

    threading.Thread(target=send, daemon=True).start()
    with os.fdopen(read) as stdin:
        monkeypatch.setattr("tumble.recording.live.sources.sys.stdin", stdin)
        live = check_stream(folder / "calibration.json", "stdin").rests
    recorded = rests_in(events_of(folder, "day")[1])
    assert len(live) == len(recorded)
    for one, other in zip(live, recorded, strict=True):
        assert one.start == pytest.approx(other.start, abs=0.11)
        assert one.difference == pytest.approx(other.difference, abs=0.2 * MG)


def still(seconds: float, *, celsius: float = 20.0, shake: float = 0.0, seed: int = 0) -> dict[str, Array]:
    """Readings at rest, 100 Hz, of a perfect MEMS device on its back, perhaps with vibration."""
    rng, n = np.random.default_rng(seed), int(100 * seconds)
    force = np.array([0.0, 0.0, 9.81553]) + 0.015 * rng.standard_normal((n, 3)) + shake * rng.standard_normal((n, 3))
    rate = 1.7e-3 * rng.standard_normal((n, 3)) + 0.1 * shake * rng.standard_normal((n, 3))
    return {"accel": force, "gyro": rate, "temperature": np.full((n, 1), celsius + 273.15)}


@pytest.fixture
def warm() -> Calibration:
    """A calibration over 10 to 30 °C."""
    return calibrated(Setup.of(grade="mems", positions=18), seed=5, temperature=temperature_profile("10:30"))


def checked(calibration: Calibration, *parts: dict[str, Array]) -> tuple[StreamCheck, list[Event]]:
    """The events of parts that come one after the other."""
    log = {name: value for name, value in SI_LOG.items() if name != "file"}
    log |= {"temperature": {"columns": ["temperature"], "unit": "degC"}}
    site = {"latitude_deg": 55.0}
    described = {"format": 1, "device": {"serial": calibration.serial}, "site": site, "log": log}
    names = ("t", "ax", "ay", "az", "gx", "gy", "gz", "temperature")
    session = session_of(described, {name: np.zeros(1) for name in names})
    check, events, at = StreamCheck(calibration, session, sample_rate=100.0), list[Event](), 0.0
    for part in parts:
        n = len(part["accel"])
        time: Array = at + 0.01 * np.arange(1.0, n + 1.0)
        at = float(time[-1])
        events += check.feed(Chunk(file=0, time=time, dt=np.full(n, 0.01), **part))
    return check, events + check.finish()


def test_a_temperature_outside_of_what_was_calibrated_is_said(warm: Calibration) -> None:
    _, events = checked(warm, still(60.0), still(5.0, shake=3.0), still(60.0, celsius=55.0, seed=1))
    (notice,) = notices_in(events)
    assert notice.startswith("temperature outside 1")
    assert notice.endswith("°C, which was calibrated")
    assert rests_in(events)[-1].outside == ("temperature",)
    assert rests_in(events)[-1].celsius is not None


def test_flight_without_a_rest_is_none(warm: Calibration) -> None:
    """The floors are then those of the vibration, and the calmest part seems to rest."""
    check, events = checked(warm, still(120.0, shake=3.0))
    assert all(rest.judged is None and "times as noisy" in rest.why for rest in rests_in(events))
    with pytest.raises(InputError, match="expected rests to check with, found none"):
        check.result()


def test_what_lasts_counts_anew(warm: Calibration) -> None:
    check, _ = checked(warm, *(still(60.0, seed=k) for k in range(40)))
    assert len(check.rests) == pytest.approx(2400.0 / LONGEST, abs=1)
