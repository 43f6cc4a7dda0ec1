"""Chunks of tasks on a cluster of processes: one of this machine, or one that is there already.

The processes are those of dask.distributed, which gives the work of a process that dies to another. They are spawned,
never forked: a copy of a process that has threads of polars hangs. Everything listens on the loopback alone.

A chunk whose process died comes back as KilledWorker. Most are innocent: someone ended the process, or its memory ran
out. So its tasks are set aside, and tried one by one at the end, when nothing else runs: what then ends its process
again has failed.
"""

from __future__ import annotations

import logging
import os
import time
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from functools import partial
from typing import TYPE_CHECKING, Any, cast

from tumble import __version__
from tumble.campaigns.engine import Chunk, Chunks, Done, Executor, Job, compute, failed, parquet_of, serially
from tumble.errors import InputError, MissingExtraError, TumbleError
from tumble.recording.panic import COMMAND_LINE

if TYPE_CHECKING:
    from distributed import Client, Future

ALLOWED_DEATHS = 0
"""How many processes of the local cluster may die with a chunk before it is set aside, or with a task that is tried
alone before it has failed. An existing cluster has its own setting, distributed.scheduler.allowed-failures."""

AHEAD = 2
"""Chunks that are sent out for each process: one at work, one waiting for it."""

CONNECT_SECONDS = 10
LOOK_SECONDS = 5.0
LOST_SECONDS = 60.0
"""How long there may be no process at all: on a busy machine one takes half a minute to begin."""
_GO_ON = "what was computed is kept: give the same command again to go on"

_SETTINGS = {
    "distributed.worker.multiprocessing-method": "spawn",
    "distributed.scheduler.allowed-failures": ALLOWED_DEATHS,
    "distributed.worker.profile.enabled": False,  # it would look at every process a hundred times a second, idle or not
    "distributed.scheduler.http.routes": [],  # the servers cannot be left out, but serve nothing
    "distributed.worker.http.routes": [],
    # Ctrl-C goes to all processes of a terminal: this one ends the others
    "distributed.worker.preload": ["import signal; signal.signal(signal.SIGINT, signal.SIG_IGN)"],
}


def executor_for(
    *, serial: bool = False, cluster: str | None = None, workers: int | None = None
) -> AbstractContextManager[Executor]:
    """Where to compute, to be used in a `with`: in this process, on the cluster whose scheduler is at an address such
    as tcp://10.0.0.5:8786, or on a new one of so many processes, by default one a core.

    Raises InputError for a contradiction or an address at which nobody answers, MissingExtraError
    without distributed."""
    if serial and (cluster or workers):
        raise InputError("--in-process: expected neither --cluster nor --workers with it, found one; leave one out")
    if cluster and workers:
        raise InputError("--workers: expected none with --cluster, whose workers are there already; leave it out")
    if serial:
        return nullcontext(serially)
    return _existing(cluster) if cluster else _local(workers or cores())


def cores() -> int:
    """How many processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextmanager
def _local(workers: int) -> Iterator[Executor]:
    """A cluster of so many processes of one thread each on this machine."""
    dask, distributed = _imported()
    with dask.config.set(_SETTINGS), ExitStack() as opened:
        try:
            cluster = distributed.LocalCluster(
                n_workers=workers,
                threads_per_worker=1,
                processes=True,
                host="127.0.0.1",
                dashboard_address="127.0.0.1:0",  # None would be port 8787
                scheduler_kwargs={"dashboard": False},
                silence_logs=logging.CRITICAL,
            )
            client = distributed.Client(opened.enter_context(cluster))
        except (OSError, RuntimeError) as error:
            raise TumbleError(f"the processes could not be begun ({error}); {_GO_ON}") from error
        yield on_cluster(opened.enter_context(client))


@contextmanager
def _existing(address: str) -> Iterator[Executor]:
    """A cluster that is there already. Raises InputError unless it has workers, all with this version of tumble."""
    _, distributed = _imported()
    expected = f"--cluster: expected the scheduler of a dask cluster at {address}, as tcp://HOST:PORT"
    try:
        client = distributed.Client(address, timeout=CONNECT_SECONDS)
    except (OSError, TimeoutError, ValueError) as error:
        raise InputError(f"{expected}, found none that answers") from error
    with client:
        try:
            versions: dict[str, str] = client.run(_version)
        except ModuleNotFoundError as error:
            raise InputError(
                f"--cluster: expected workers of {address} with tumble {__version__}, found no tumble; install it there"
            ) from error
        if not versions:
            raise InputError(f"--cluster: expected workers at {address}, found none; start some with `dask worker`")
        for worker, version in versions.items():
            if version != __version__:
                raise InputError(f"--cluster: expected tumble {__version__} at worker {worker}, found {version}")
        yield on_cluster(client)


def _version() -> str:
    return __version__


def _imported() -> tuple[Any, Any]:
    """dask and distributed, which are silent here: what fails becomes a row or an exception."""
    try:
        import dask
        import distributed
    except ModuleNotFoundError as error:
        raise MissingExtraError(
            "work on several processes needs distributed; install it with: pip install 'tumble[cluster]', or give "
            "--in-process to compute in this process"
        ) from error
    for name in ("distributed", "distributed.client"):
        logging.getLogger(name).setLevel(logging.CRITICAL)
    return dask, distributed


def on_cluster(client: Client) -> Executor:
    """The processes of a client. Raises TumbleError, while it computes, if the cluster is lost."""
    return partial(_computed, client)


def _computed(client: Client, job: Job, pending: Sequence[int]) -> Iterator[Done]:
    """Chunks of tasks with their rows, as the processes finish them."""
    suspects: list[int] = []
    try:
        yield from _spread(job, pending, client, suspects)
        for number in suspects:
            yield [number], _alone(job, number, client)
    except (CancelledError, OSError) as error:
        raise TumbleError(f"the cluster is lost; {_GO_ON}") from error


def _spread(job: Job, pending: Sequence[int], client: Client, suspects: list[int]) -> Iterator[Done]:
    """Chunks that were finished; the tasks of the others are added to `suspects`."""
    workers = max(1, sum(cast(Any, client).nthreads().values()))
    chunks = Chunks(pending, workers=workers)
    sent: dict[Future[Any], Chunk] = {}
    while True:
        while len(sent) < AHEAD * workers and (chunk := chunks.next()):
            sent[_submit(job, chunk, client)] = chunk
        if not sent:
            return
        for future in _first_done(sent, client):
            chunk = sent.pop(future)
            try:
                part, seconds = future.result()
            except CancelledError:
                raise
            except Exception:
                suspects += chunk
                continue
            chunks.took(len(chunk), seconds)
            yield chunk, part


def _first_done(sent: Iterable[Future[Any]], client: Client) -> set[Future[Any]]:
    """Those that are done, as soon as one is. Raises TumbleError where no process has been there for a minute."""
    _, distributed = _imported()
    seen = time.monotonic()
    while True:
        try:
            waited = distributed.wait(list(sent), timeout=LOOK_SECONDS, return_when="FIRST_COMPLETED")
        except TimeoutError:
            if cast(Any, client).nthreads():
                seen = time.monotonic()
            elif time.monotonic() - seen > LOST_SECONDS:
                raise TumbleError(f"the processes were ended, and no other has begun; {_GO_ON}") from None
        else:
            return cast(set[Any], waited.done)


def _alone(job: Job, number: int, client: Client) -> bytes:
    """The rows of a task while nothing else runs."""
    from distributed import KilledWorker

    try:
        (done,) = _first_done([_submit(job, [number], client)], client)
        return bytes(done.result()[0])
    except CancelledError:
        raise
    except KilledWorker:
        said: BaseException | str = "every process that computed it died"
    except Exception as error:
        said = error
    return parquet_of([failed(number, job.label(job.items[number]), said)], job.columns)


def _computed_there(*work: Any) -> tuple[bytes, float]:
    """`compute` in a process of the cluster, which is nobody's but ours."""
    COMMAND_LINE.set(True)
    return compute(*work)


def _submit(job: Job, chunk: Chunk, client: Client) -> Future[Any]:
    tasks = [(number, job.items[number]) for number in chunk]
    return client.submit(_computed_there, job.task, job.label, job.columns, tasks, pure=False)
