"""What programs make of cases, computed where it is not known yet and kept: the one way of both sets of the benchmark.

What one program made of one case is a file in evidence/cache, by a hash of all that it hangs on: the case and what is
told of it, the sources of this program and of no other, versions of libraries. A run that is stopped goes on where it
was; after a change only what it touches is computed again. With a scheduler cases go to the processes of a dask
cluster, which need this folder on their path.
"""

from __future__ import annotations

import io
import json
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from evidence import programs as benchmark
from evidence.case import Case, Estimate, Refusal
from evidence.state import CACHE, file_of, keep, source_of

Tell = Callable[[Case, str, Estimate | Refusal], Mapping[str, Any]]


@dataclass(frozen=True, kw_only=True, slots=True)
class Entry:
    """A case that is not made yet, and what is to be told of what a program makes of it, as JSON has it: `key` stands
    for all that both depend on. `make` and `tell` are sent to other processes."""

    name: str
    kind: str
    key: str
    make: Callable[[], Case]
    tell: Tell


@dataclass(frozen=True, kw_only=True, slots=True)
class Told:
    """What is told of a program and a case, and the seconds of the processor that it took."""

    content: Mapping[str, Any]
    seconds: float


def cached(entry: Entry, program: str) -> Path:
    """The file of what a program made of a case."""
    return file_of(CACHE, entry.key, program, source_of(program))


def tried(make: Callable[[], Case], tell: Tell, programs: Iterable[str]) -> list[dict[str, Any]]:
    """What programs make of one case, and the seconds of each."""
    case, out = make(), []
    for name in programs:
        start = time.process_time()
        try:
            found = benchmark.named(name).calibrate(case)
        except Exception as error:  # an error of a program is a result, of that program
            found = Refusal(reason=f"failed, {type(error).__name__}: {error}")
        seconds = time.process_time() - start
        out.append({"program": name, "told": dict(tell(case, name, found)), "seconds": seconds})
    return out


Item = tuple[Callable[[], Case], Tell, Sequence[str]]


def _task(items: Sequence[Item], number: int, _: Any) -> list[Mapping[str, Any]]:
    return [{"program": each["program"], "text": json.dumps(each)} for each in tried(*items[number])]


def answers(
    todo: Sequence[tuple[Entry, Sequence[str]]], *, workers: int = 0, scheduler: str | None = None,
    say: Callable[[str], None] = lambda _: None,
) -> dict[tuple[str, str], Told]:  # fmt: skip
    """By names of case and program, what is told of the programs of every case, in this order. With `workers` 1 it is
    computed in this process, with 0 in one process a core."""
    import polars as pl

    from tumble.campaigns.cluster import executor_for
    from tumble.campaigns.engine import Job

    missing = [(entry, [name for name in names if not cached(entry, name).exists()]) for entry, names in todo]
    pending = [(entry, names) for entry, names in missing if names]
    job = Job(
        definition={"what": "evidence"},
        items=[{}] * len(pending),
        task=partial(_task, [(entry.make, entry.tell, names) for entry, names in pending]),
        schema={"program": pl.String, "text": pl.String},
    )
    serial = workers == 1 or len(pending) < 2
    done = 0
    with executor_for(serial=serial, cluster=scheduler, workers=None if serial or scheduler else workers or None) as go:
        for numbers, part in go(job, range(len(pending))) if pending else ():
            for made in pl.read_parquet(io.BytesIO(part)).iter_rows(named=True):
                if made["error"] is not None:
                    raise RuntimeError(f"{pending[made['task']][0].name}: {made['error']}")
                keep(cached(pending[made["task"]][0], made["program"]), made["text"])
            done += len(numbers)
            say(f"{done} of {len(pending)} cases")
    out = {}
    for entry, names in todo:
        for name in names:
            content = json.loads(cached(entry, name).read_text(encoding="utf-8"))
            out[entry.name, name] = Told(content=content["told"], seconds=content["seconds"])
    return out


def median_seconds(told: Mapping[tuple[str, str], Told], program: str) -> float:
    """Of a program over its cases."""
    return round(float(np.median([each.seconds for (_, name), each in told.items() if name == program])), 3)
