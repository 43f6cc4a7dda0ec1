"""Execution of tasks on a cluster of processes (dask.distributed), on this machine or one that is running already.

Processes are spawned, not forked: a forked copy of a process with threads of polars hangs. Everything listens on the
loopback interface alone.

A chunk whose process died comes back as KilledWorker. Usually only one of its tasks is the cause, or none: the process
may have been ended by someone, or memory ran out. The tasks of such a chunk are computed one by one after all others. A
task that is lost alone is tried again at the end, since its process may have been dying already or the machine been
busy. It counts as failed after ATTEMPTS attempts. A process has one chunk at a time, so that none dies with another.
"""

from __future__ import annotations

import logging
import os
from collections import Counter, deque
from collections.abc import Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from functools import partial
from typing import TYPE_CHECKING, Any, TypedDict, Unpack, cast

from tumble import __version__
from tumble.campaigns.engine import Chunk, Done, Executor, Job, Row, chunks, compute, serially
from tumble.errors import InputError, MissingExtraError, TumbleError
from tumble.recording.panic import COMMAND_LINE

if TYPE_CHECKING:
    from distributed import Client

ATTEMPTS = 3
CONNECT_SECONDS = 10
LOST_SECONDS = 60.0  # without processes and results; on a busy machine a process takes up to half a minute to start
_RESUME_ADVICE = "what was computed is kept: give the same command again to go on"
_SETTINGS = {
    "distributed.worker.multiprocessing-method": "spawn",
    "distributed.scheduler.allowed-failures": 0,
    "distributed.deploy.lost-worker-timeout": "30 days",  # default 15 s
    "distributed.worker.profile.enabled": False,  # it would sample every process 100 times a second
    "distributed.scheduler.http.routes": [],  # the servers cannot be disabled, but serve nothing
    "distributed.worker.http.routes": [],
    # Ctrl-C reaches all processes of a terminal; only this one handles it
    "distributed.worker.preload": ["import signal; signal.signal(signal.SIGINT, signal.SIG_IGN)"],
}


class Place(TypedDict, total=False):
    """Where tasks are computed; by default on a new cluster with one process per core.

    Attributes
    ----------
    serial : bool
        In this process.
    cluster : str
        On the cluster whose scheduler is at an address such as tcp://10.0.0.5:8786.
    workers : int
        On a new cluster with this number of processes.
    """

    serial: bool
    cluster: str | None
    workers: int | None


def executor_for(**place: Unpack[Place]) -> AbstractContextManager[Executor]:
    """Return a context manager that gives the executor for a place.

    Raises InputError for contradictory options or an address at which no scheduler answers, MissingExtraError without
    distributed."""
    serial, cluster, workers = place.get("serial", False), place.get("cluster"), place.get("workers")
    if serial and (cluster or workers):
        raise InputError("--in-process: expected neither --cluster nor --workers with it, found one; leave one out")
    if cluster and workers:
        raise InputError("--workers: expected none with --cluster, whose workers are there already; leave it out")
    if serial:
        return nullcontext(serially)
    if cluster:
        return _existing_cluster(cluster)
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return _local_cluster(workers or cores)


@contextmanager
def _local_cluster(workers: int) -> Iterator[Executor]:
    """Start processes of one thread each on this machine."""
    dask, distributed = _import_dask()
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
            raise TumbleError(f"the processes could not be begun ({error}); {_RESUME_ADVICE}") from error
        yield partial(_compute_on, opened.enter_context(client))


@contextmanager
def _existing_cluster(address: str) -> Iterator[Executor]:
    """Connect to a cluster. Raises InputError unless it has workers, all with this version of tumble."""
    _, distributed = _import_dask()
    try:
        client = distributed.Client(address, timeout=CONNECT_SECONDS)
    except (OSError, TimeoutError, ValueError) as error:
        expected = f"expected the scheduler of a dask cluster at {address}, as tcp://HOST:PORT"
        raise InputError(f"--cluster: {expected}, found none that answers") from error
    with client:
        try:
            versions: dict[str, str] = client.run(_version)
        except ModuleNotFoundError:
            versions = dict.fromkeys(client.nthreads(), "none")
        other = next((f"{version} at {worker}" for worker, version in versions.items() if version != __version__), None)
        if other or not versions:
            expected = f"expected workers at {address} with tumble {__version__}"
            raise InputError(f"--cluster: {expected}, found {other or 'no worker'}; start some with `dask worker`")
        yield partial(_compute_on, client)


def _version() -> str:
    return __version__


def _import_dask() -> tuple[Any, Any]:
    """Return dask and distributed with logging switched off: failures become rows or exceptions."""
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


def _compute_on(client: Client, job: Job, pending: Sequence[int]) -> Iterator[Done]:
    """Compute tasks on the processes of a client (an `Executor`). Raises TumbleError if the cluster is lost, or has no
    process for LOST_SECONDS."""
    _, distributed = _import_dask()

    def tasks_of(chunk: Chunk) -> list[tuple[int, Row]]:
        return [(number, job.items[number]) for number in chunk]

    lost = Counter[int]()
    workers = max(1, sum(cast(Any, client).nthreads().values()))
    waiting, sent = deque(chunks(pending, workers=workers)), dict[Any, Chunk]()
    try:
        while waiting or sent:
            while waiting and len(sent) < workers:
                chunk = waiting.popleft()
                work = job.task, job.columns, tasks_of(chunk)
                sent[client.submit(_compute_in_worker, *work, pure=False)] = chunk
            try:
                finished = distributed.wait(list(sent), timeout=LOST_SECONDS, return_when="FIRST_COMPLETED")
            except TimeoutError:
                if cast(Any, client).nthreads():
                    continue
                raise TumbleError(f"the processes were ended, and no other has begun; {_RESUME_ADVICE}") from None
            for future in finished.done:
                chunk = sent.pop(future)
                try:
                    yield chunk, future.result()
                except CancelledError:
                    raise
                except Exception as error:
                    lost.update(chunk)
                    waiting += ((number,) for number in chunk if lost[number] <= ATTEMPTS)
                    if max(lost[number] for number in chunk) > ATTEMPTS:
                        reason = f"{type(error).__name__}: {error}"
                        if isinstance(error, distributed.KilledWorker):
                            reason = f"each of {ATTEMPTS} processes that computed it alone died"
                        yield chunk, compute(partial(_failed, reason), job.columns, tasks_of(chunk))
    except (CancelledError, OSError) as error:
        raise TumbleError(f"the cluster is lost; {_RESUME_ADVICE}") from error


def _failed(reason: str, *_task: Any) -> list[Row]:
    return [{"error": reason}]


def _compute_in_worker(*work: Any) -> bytes:
    COMMAND_LINE.set(True)  # the process does nothing else
    return compute(*work)
