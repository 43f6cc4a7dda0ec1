"""Chunks of tasks on a cluster of processes: one of this machine, or one that is there already.

The processes are those of dask.distributed. They are spawned, never forked: a copy of a process that has threads of
polars hangs. Everything listens on the loopback alone.

A chunk whose process died comes back as KilledWorker. Most of its tasks are innocent: someone ended the process, or its
memory ran out. So they are set aside and tried one by one at the end, while nothing else runs; and those that fail
then, again when all others are done, for a process may have been dying of the task before, or the machine been busy. A
task has failed when it did so ATTEMPTS times.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from functools import partial
from typing import TYPE_CHECKING, Any, TypedDict, Unpack, cast

from tumble import __version__
from tumble.campaigns.engine import Chunk, Done, Executor, Job, chunks, compute, failed, parquet_of, serially
from tumble.errors import InputError, MissingExtraError, TumbleError
from tumble.recording.panic import COMMAND_LINE

if TYPE_CHECKING:
    from distributed import Client, Future

ATTEMPTS = 3
AHEAD = 2
"""Chunks that are sent out for each process: one at work, one waiting for it."""
CONNECT_SECONDS = 10
LOST_SECONDS = 60.0
"""How long nothing may be done while there is no process: on a busy machine one takes half a minute to begin."""
_GO_ON = "what was computed is kept: give the same command again to go on"
_SETTINGS = {
    "distributed.worker.multiprocessing-method": "spawn",
    "distributed.scheduler.allowed-failures": 0,
    "distributed.deploy.lost-worker-timeout": "30 days",  # by default a process is given up after 15 s
    "distributed.worker.profile.enabled": False,  # it would look at every process a hundred times a second, idle or not
    "distributed.scheduler.http.routes": [],  # the servers cannot be left out, but serve nothing
    "distributed.worker.http.routes": [],
    # Ctrl-C goes to all processes of a terminal: this one ends the others
    "distributed.worker.preload": ["import signal; signal.signal(signal.SIGINT, signal.SIG_IGN)"],
}


class Place(TypedDict, total=False):
    """Where to compute, by default on a new cluster of one process a core.

    Attributes
    ----------
    serial : bool
        In this process.
    cluster : str
        On the cluster whose scheduler is at an address such as tcp://10.0.0.5:8786.
    workers : int
        On a new cluster of so many processes.
    """

    serial: bool
    cluster: str | None
    workers: int | None


def executor_for(**place: Unpack[Place]) -> AbstractContextManager[Executor]:
    """What computes at a place, to be used in a `with`.

    Raises InputError for a contradiction or an address at which nobody answers, MissingExtraError without
    distributed."""
    serial, cluster, workers = place.get("serial", False), place.get("cluster"), place.get("workers")
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
        yield partial(_computed, opened.enter_context(client))


@contextmanager
def _existing(address: str) -> Iterator[Executor]:
    """A cluster that is there already. Raises InputError unless it has workers, all with this version of tumble."""
    _, distributed = _imported()
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
        yield partial(_computed, client)


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


def _computed(client: Client, job: Job, pending: Sequence[int]) -> Iterator[Done]:
    """Chunks of tasks with their rows, as the processes of a client finish them."""
    from distributed import KilledWorker

    set_aside: list[int] = []
    workers = max(1, sum(cast(Any, client).nthreads().values()))
    waiting, sent = chunks(pending, workers=workers), dict[Any, Chunk]()
    try:
        while True:
            while len(sent) < AHEAD * workers and (chunk := next(waiting, None)):
                sent[_submit(job, chunk, client)] = chunk
            if not sent:
                break
            for future in _first_done(sent, client):
                chunk = sent.pop(future)
                try:
                    yield chunk, future.result()
                except CancelledError:
                    raise
                except Exception:
                    set_aside += chunk
        why: dict[int, str] = {}
        for _ in range(ATTEMPTS):
            why = dict.fromkeys(set_aside, "")
            for number in set_aside:
                (future,) = _first_done([_submit(job, (number,), client)], client)
                try:
                    yield (number,), future.result()
                except CancelledError:
                    raise
                except KilledWorker:
                    why[number] = f"each of {ATTEMPTS} processes that computed it alone died"
                except Exception as error:
                    why[number] = f"{type(error).__name__}: {error}"
            set_aside = [number for number in set_aside if why[number]]
        for number in set_aside:
            row = failed(number, job.label(job.items[number]), why[number])
            yield (number,), parquet_of([row], job.columns)
    except (CancelledError, OSError) as error:
        raise TumbleError(f"the cluster is lost; {_GO_ON}") from error


def _first_done(sent: Iterable[Future[Any]], client: Client) -> set[Future[Any]]:
    """Those that are done, as soon as one is. Raises TumbleError where nothing was done in a minute, and no process is
    there."""
    _, distributed = _imported()
    while True:
        try:
            waited = distributed.wait(list(sent), timeout=LOST_SECONDS, return_when="FIRST_COMPLETED")
            return cast("set[Future[Any]]", waited.done)
        except TimeoutError:
            if not cast(Any, client).nthreads():
                raise TumbleError(f"the processes were ended, and no other has begun; {_GO_ON}") from None


def _submit(job: Job, chunk: Chunk, client: Client) -> Future[Any]:
    tasks = [(number, job.items[number]) for number in chunk]
    return client.submit(_computed_there, job.task, job.label, job.columns, tasks, pure=False)


def _computed_there(*work: Any) -> bytes:
    """`compute` in a process of the cluster, which does nothing else."""
    COMMAND_LINE.set(True)
    return compute(*work)
