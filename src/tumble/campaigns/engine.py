"""Numbered tasks that each give rows of one table, computed in this process or on a cluster, and resumable.

The rows of a task depend on its number alone, not on where or when it is computed. The rows of a chunk of tasks are
written as a part, a Parquet file that is complete or absent. When all parts are there, they become one table, sorted by
task:

    FOLDER/manifest.json      what is computed, with a hash: only the same job can resume in a folder
    FOLDER/parts/*.parquet    rows of finished chunks, removed when the table is complete
    FOLDER/rows.parquet       the table

A task that raises an exception becomes a row with the exception in its column `error`.
"""

from __future__ import annotations

import hashlib
import io
import json
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import polars as pl

from tumble import __version__
from tumble.documents import json_of, text_of_document
from tumble.errors import InputError
from tumble.files import in_use, whole_file

CHUNKS_PER_WORKER = 32  # so that all processes end at about the same time
LARGEST_CHUNK = 64  # tasks

TABLE = "rows.parquet"
MANIFEST = "manifest.json"

Row = Mapping[str, Any]
Progress = Callable[[int, int], None]
"""Function of the number of finished tasks and the number of all tasks."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Job:
    """A table to be computed: task i is `task(i, items[i])`, which returns at least one row.

    `definition` are JSON values that determine the rows. An item has the columns that its rows have even if the task
    fails, `schema` the polars types of the columns between `task` and `error`. `task` and the items are sent to other
    processes: it must be a function of a module or `partial` of one."""

    definition: Mapping[str, Any]
    items: Sequence[Row]
    task: Callable[[int, Any], list[Row]]
    schema: Mapping[str, Any]

    @property
    def identity(self) -> dict[str, Any]:
        """Definition, number of tasks and version of tumble, as in the manifest."""
        return {**self.definition, "tasks": len(self.items), "software": f"tumble {__version__}"}

    @property
    def columns(self) -> dict[str, Any]:
        """Polars types of all columns of the table."""
        return {"task": pl.Int64, **self.schema, "error": pl.String}


Chunk = tuple[int, ...]
Done = tuple[Chunk, bytes]
"""A chunk and its rows as a Parquet file."""
Executor = Callable[[Job, Sequence[int]], Iterator[Done]]
"""Function that computes tasks, given by their numbers, and yields chunks as they are finished, in any order."""


def run(
    job: Job, folder: Path, *, executor: Executor | None = None, progress: Progress = lambda _done, _all: None
) -> Path:
    """Compute the missing tasks of a job in a folder, and return the path of its table.

    Tasks are computed in this process by default, else by an `executor` (see `tumble.campaigns.cluster`). Raises
    InputError if the folder has other content, belongs to another job or is in use, TumbleError if a cluster is lost;
    finished chunks are kept."""
    _open_folder(job, folder)
    table, parts = folder / TABLE, folder / "parts"
    with in_use(folder):
        if table.exists():
            return table
        parts.mkdir(exist_ok=True)
        done = _rows_of(parts, job).select("task").collect()["task"]
        pending = sorted({*range(len(job.items))}.difference(done))
        count = len(job.items) - len(pending)
        progress(count, len(job.items))
        for numbers, part in (executor or serially)(job, pending):
            name = f"{numbers[0]:09d}-{numbers[-1]:09d}-{len(numbers)}.parquet"
            with whole_file(parts / name) as temporary:
                temporary.write_bytes(part)
            count += len(numbers)
            progress(count, len(job.items))
        rows = _rows_of(parts, job).sort("task", maintain_order=True).collect()
        with whole_file(table) as temporary:
            rows.write_parquet(temporary)
        shutil.rmtree(parts)
    return table


def _rows_of(parts: Path, job: Job) -> pl.LazyFrame:
    """Return the rows of the finished chunks."""
    files = sorted(path for path in parts.iterdir() if path.match("[0-9]*.parquet"))
    return pl.scan_parquet(files) if files else pl.LazyFrame(schema=job.columns)


# -------------------- tasks --------------------


def serially(job: Job, pending: Sequence[int]) -> Iterator[Done]:
    """Compute tasks in this process (an `Executor`)."""
    for chunk in chunks(pending, workers=1):
        yield chunk, compute(job.task, job.columns, [(number, job.items[number]) for number in chunk])


def chunks(pending: Sequence[int], *, workers: int) -> Iterator[Chunk]:
    """Yield tasks in chunks of one size, small enough for all workers to end at about the same time."""
    size = min(max(len(pending) // (CHUNKS_PER_WORKER * workers), 1), LARGEST_CHUNK)
    return (tuple(pending[first : first + size]) for first in range(0, len(pending), size))


def compute(
    task: Callable[[int, Any], list[Row]], columns: Mapping[str, Any], tasks: Iterable[tuple[int, Row]]
) -> bytes:
    """Compute tasks and return their rows as a Parquet file."""
    rows: list[Row] = []
    for number, item in tasks:
        try:
            rows += [{"task": number, **item, **row} for row in task(number, item)]
        except Exception as error:
            reason = " ".join(f"{type(error).__name__}: {error}".split())
            rows.append({"task": number, **item, "error": reason})
    file = io.BytesIO()
    pl.DataFrame(rows, schema=columns).write_parquet(file)
    return file.getvalue()


# -------------------- the folder --------------------


def _open_folder(job: Job, folder: Path) -> None:
    """Check that a folder belongs to this job; initialise a new folder. Raises InputError for others."""
    manifest = folder / MANIFEST
    sha256 = hashlib.sha256(json.dumps(job.identity, sort_keys=True, allow_nan=False).encode()).hexdigest()
    if manifest.exists():
        try:
            same_job = json_of(text_of_document(manifest))["sha256"] == sha256
        except (InputError, ValueError, KeyError, TypeError) as error:
            raise InputError(f"{manifest}: expected the manifest of a job of tumble, found another file") from error
        if not same_job:
            raise InputError(f"{folder}: expected a new folder, found one that another job has begun; give another")
        return
    if folder.exists() and not (folder.is_dir() and all(path.name.startswith(".") for path in folder.iterdir())):
        raise InputError(f"{folder}: expected a new folder, or one that was begun by the same command, found another")
    folder.mkdir(parents=True, exist_ok=True)
    content = {"format": 1, "sha256": sha256, **job.identity}
    with whole_file(manifest) as temporary:
        temporary.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
