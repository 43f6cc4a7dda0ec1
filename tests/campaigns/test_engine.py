"""Many tasks: the same rows whoever computes them, nothing lost or repeated, whatever dies."""

from __future__ import annotations

import json
import operator
import os
import signal
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import polars as pl
import psutil
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tumble.campaigns import cluster, engine
from tumble.campaigns.cluster import ATTEMPTS, executor_for
from tumble.campaigns.engine import Done, Executor, Job, Row, chunks, run, serially
from tumble.errors import InputError, MissingExtraError, TumbleError

BAD, DEADLY = 7, 13
SCHEMA = {"name": pl.String, "x": pl.Float64, "k": pl.Int64}


def drawn(number: int, _item: Row) -> list[Row]:
    """Two rows of random numbers that depend on the number alone; one task fails."""
    if number == BAD:
        raise ValueError("a number\nthat is bad")
    rng = np.random.default_rng(np.random.SeedSequence(5, spawn_key=(number,)))
    return [{"x": float(x), "k": k} for k, x in enumerate(rng.standard_normal(2))]


def noted(folder: Path, seconds: float, number: int, item: Row) -> list[Row]:
    """As `drawn`; that it was computed, and by which process, is noted in a folder."""
    with (folder / f"{os.getpid()}").open("a") as file:
        file.write(f"{number}\n")
    time.sleep(seconds)
    return drawn(number, item)


def deadly(home: int, number: int, item: Row) -> list[Row]:
    """As `drawn`; one task ends the process it runs in, unless that is the one of the tests."""
    if number == DEADLY and os.getpid() != home:
        os.kill(os.getpid(), signal.SIGKILL)
    return drawn(number, item)


def job(task: Callable[[int, Any], list[Row]] = drawn, tasks: int = 40) -> Job:
    return Job(definition={"seed": 5}, items=[{"name": f"task {i}"} for i in range(tasks)], task=task, schema=SCHEMA)


def rows(of: Job, folder: Path, executor: Executor = serially) -> pl.DataFrame:
    return pl.read_parquet(run(of, folder, executor=executor))


def computed(folder: Path) -> list[int]:
    """Numbers of the tasks that `noted` has noted."""
    return [int(line) for file in folder.iterdir() for line in file.read_text().split()]


@pytest.fixture(scope="module")
def expected(tmp_path_factory: pytest.TempPathFactory) -> pl.DataFrame:
    """The rows computed in this process."""
    return rows(job(), tmp_path_factory.mktemp("serial") / "out")


# The same rows


def test_every_task_has_its_rows_in_order(expected: pl.DataFrame) -> None:
    assert expected.columns == ["task", "name", "x", "k", "error"]
    good = expected.filter(pl.col("error").is_null())
    assert good["task"].to_list() == [i for i in range(40) if i != BAD for _ in range(2)]
    assert good["name"].to_list() == [f"task {i}" for i in good["task"]]
    assert good["x"].to_list() == [row["x"] for i in range(40) if i != BAD for row in drawn(i, {})]


def test_a_task_that_fails_is_a_row_with_its_error(expected: pl.DataFrame) -> None:
    (row,) = expected.filter(pl.col("task") == BAD).to_dicts()
    assert row == {
        "task": BAD,
        "name": f"task {BAD}",
        "x": None,
        "k": None,
        "error": "ValueError: a number that is bad",
    }


def test_an_existing_cluster_gives_the_same_rows(processes: Executor, expected: pl.DataFrame, tmp_path: Path) -> None:
    (client,) = cast("partial[Iterator[Done]]", processes).args
    with executor_for(cluster=client.scheduler.address) as executor:
        assert rows(job(), tmp_path / "out", executor).equals(expected)


@given(st.integers(0, 3000), st.integers(1, 9))
def test_chunks_hold_every_task_once(tasks: int, workers: int) -> None:
    assert [i for chunk in chunks(range(5, 5 + tasks), workers=workers) for i in chunk] == list(range(5, 5 + tasks))


# Interrupted and resumed


@pytest.mark.parametrize("after", [1, 39])
def test_an_interrupted_job_is_resumed_without_losing_or_repeating_a_row(
    after: int, expected: pl.DataFrame, tmp_path: Path
) -> None:
    (tmp_path / "log").mkdir()
    once = job(partial(noted, tmp_path / "log", 0.0))

    def interrupt(done: int, _every: int) -> None:
        if done >= after:
            raise KeyboardInterrupt

    def one_by_one(of: Job, pending: Sequence[int]) -> Iterator[Done]:
        for i in pending:
            yield (i,), engine.compute(of.task, of.columns, [(i, of.items[i])])

    with pytest.raises(KeyboardInterrupt):
        run(once, tmp_path / "out", executor=one_by_one, progress=interrupt)
    assert len(computed(tmp_path / "log")) == after
    torn = tmp_path / "out" / "parts" / ".000000000-000000039-40.xyz.parquet"
    torn.write_bytes(b"PAR1 half of a part")
    assert rows(once, tmp_path / "out").equals(expected)
    assert sorted(computed(tmp_path / "log")) == list(range(40))


@pytest.mark.skipif(sys.platform == "win32", reason="no locks of folders")
def test_a_second_run_in_a_folder_is_refused_while_the_first_goes_on(expected: pl.DataFrame, tmp_path: Path) -> None:
    def joined(of: Job, pending: Sequence[int]) -> Iterator[Done]:
        with pytest.raises(InputError, match="expected a folder that no other process uses, found one in use"):
            run(of, tmp_path / "out")
        yield from serially(of, pending)

    assert rows(job(), tmp_path / "out", joined).equals(expected)


def test_progress_counts_to_the_end(tmp_path: Path) -> None:
    said: list[tuple[int, int]] = []
    run(job(), tmp_path / "out", progress=lambda done, every: said.append((done, every)))
    assert said[0] == (0, 40)
    assert said[-1] == (40, 40)
    assert said == sorted(said)


def test_another_job_in_the_folder_is_refused(tmp_path: Path) -> None:
    run(job(), tmp_path / "out")
    with pytest.raises(InputError, match="out: expected a new folder, found one that another job has begun"):
        run(job(tasks=41), tmp_path / "out")


def test_a_folder_of_something_else_is_refused(tmp_path: Path) -> None:
    (tmp_path / "thesis.txt").write_text("precious")
    with pytest.raises(InputError, match="expected a new folder"):
        run(job(), tmp_path)
    (tmp_path / engine.MANIFEST).write_text(json.dumps(["precious"]))
    with pytest.raises(InputError, match="expected the manifest of a job"):
        run(job(), tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {"thesis.txt", engine.MANIFEST}


# What dies


@pytest.mark.weekly
def test_a_worker_killed_in_the_middle_costs_no_row(processes: Executor, tmp_path: Path) -> None:
    (tmp_path / "log").mkdir()
    many = job(partial(noted, tmp_path / "log", 0.02), tasks=120)
    killed: list[int] = []

    def kill(done: int, every: int) -> None:
        if not killed and done > every // 4:
            pid = next(int(file.name) for file in (tmp_path / "log").iterdir())
            os.kill(pid, signal.SIGKILL)
            killed.append(pid)

    found = pl.read_parquet(run(many, tmp_path / "out", executor=processes, progress=kill))
    assert killed
    assert not psutil.pid_exists(killed[0])
    assert len(computed(tmp_path / "log")) >= 120
    assert found.equals(rows(job(tasks=120), tmp_path / "serial"))


@pytest.mark.weekly
def test_a_task_that_ends_every_process_is_a_row_and_the_others_finish(processes: Executor, tmp_path: Path) -> None:
    found = rows(job(partial(deadly, os.getpid())), tmp_path / "out", processes)
    (row,) = found.filter(pl.col("task") == DEADLY).to_dicts()
    assert row["error"] == f"each of {ATTEMPTS} processes that computed it alone died"
    assert row["name"] == f"task {DEADLY}"
    serial = rows(job(partial(deadly, os.getpid())), tmp_path / "serial")
    assert found.filter(pl.col("task") != DEADLY).equals(serial.filter(pl.col("task") != DEADLY))


def deadly_at_first(folder: Path, number: int, item: Row) -> list[Row]:
    """As `drawn`; one task ends the processes of its first two attempts, as others may have done."""
    attempts = folder / "attempts"
    if number == DEADLY:
        with attempts.open("a") as file:
            file.write("once ")
        if len(attempts.read_text().split()) < ATTEMPTS:
            os.kill(os.getpid(), signal.SIGKILL)
    return drawn(number, item)


@pytest.mark.weekly
def test_a_task_has_not_failed_before_it_was_tried_again_alone(
    processes: Executor, expected: pl.DataFrame, tmp_path: Path
) -> None:
    assert rows(job(partial(deadly_at_first, tmp_path)), tmp_path / "out", processes).equals(expected)


class Deserted:
    """A cluster whose processes were ended, and begin no more."""

    def nthreads(self) -> dict[str, int]:
        return {}

    def submit(self, *_work: object, **_how: object) -> object:
        return object()


class Reply:
    """A future."""

    def __init__(self, work: Callable[[], Any]) -> None:
        self.result = work


class Busy:
    """A process on a busy machine: of the chunks with one task those before the last attempt are lost on the way."""

    lost = 0

    def nthreads(self) -> dict[str, int]:
        return {"here": 1}

    def submit(self, computed: Callable[..., bytes], *work: Any, pure: bool) -> Reply:
        assert not pure
        if DEADLY in [number for number, _ in work[-1]] and self.lost < ATTEMPTS:
            self.lost += 1
            return Reply(partial(operator.truediv, 1, 0))
        return Reply(partial(computed, *work))


def test_what_was_lost_alone_on_a_busy_machine_is_tried_again(
    expected: pl.DataFrame, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("distributed.wait", lambda sent, **_: SimpleNamespace(done=sent[:1]))
    busy = Busy()
    assert rows(job(), tmp_path / "out", partial(cluster._compute_on, cast(Any, busy))).equals(expected)
    assert busy.lost == ATTEMPTS


def test_a_cluster_that_has_lost_all_processes_is_not_waited_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def nothing_done(*_: object, **__: object) -> None:
        raise TimeoutError

    monkeypatch.setattr("distributed.wait", nothing_done)
    expected = "the processes were ended, and no other has begun; what was computed is kept"
    with pytest.raises(TumbleError, match=expected):
        run(job(), tmp_path / "out", executor=partial(cluster._compute_on, cast(Any, Deserted())))


def test_everything_listens_on_the_loopback_and_not_at_the_port_of_a_dashboard(processes: Executor) -> None:
    assert processes is not None
    here = psutil.Process()
    listening = [
        connection.laddr
        for process in [here, *here.children(recursive=True)]
        for connection in process.net_connections(kind="tcp")
        if connection.status == psutil.CONN_LISTEN
    ]
    assert len(listening) > 2
    assert {address.ip for address in listening} == {"127.0.0.1"}
    assert 8787 not in {address.port for address in listening}


# Arguments


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"serial": True, "workers": 2}, "in_process: expected neither cluster nor workers"),
        ({"serial": True, "cluster": "tcp://127.0.0.1:1"}, "in_process: expected neither"),
        ({"cluster": "tcp://127.0.0.1:1", "workers": 2}, "workers: expected none with cluster"),
        ({"cluster": "nonsense://x"}, "expected the scheduler of a dask cluster at nonsense://x"),
        ({"cluster": "tcp://127.0.0.1:1"}, "found none that answers"),
    ],
)
def test_places_that_cannot_be_are_refused(options: dict[str, Any], said: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tumble.campaigns.cluster.CONNECT_SECONDS", 0.5)
    with pytest.raises(InputError, match=said) as caught, executor_for(**options):
        pass
    assert "\n" not in str(caught.value)


def test_without_distributed_the_message_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with (
        pytest.raises(MissingExtraError, match=r"install it with: pip install 'tumble\[cluster\]', or give in_process"),
        executor_for(workers=2),
    ):
        pass
