"""Many numbered tasks, each of which gives rows of one table: in this process or on a cluster, interrupted and resumed.

A task is identified by its number alone, so that its rows depend neither on who computes it nor on when. The rows of a
chunk of tasks are written as a part, a Parquet file that is there whole or not at all; tasks whose parts are there are
done. When all are done the parts become one table, sorted by task:

    FOLDER/manifest.json      what is computed, with a hash: a folder that was begun is resumed by the same job only
    FOLDER/parts/*.parquet    rows of finished chunks; gone when the table is complete
    FOLDER/rows.parquet       the table

A task that raises an exception becomes a row with the exception in its column `error`, and the others go on.
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

from tumble import __version__
from tumble.documents import json_of, text_of_document
from tumble.errors import InputError
from tumble.files import whole_file

CHUNKS_EACH, LARGEST_CHUNK = 32, 64
"""Chunks for each process, so that all end at about the same time; and the most tasks of one."""

TABLE = "rows.parquet"
MANIFEST = "manifest.json"

Row = Mapping[str, Any]
Progress = Callable[[int, int], None]
"""Called with the number of tasks that are done and of all tasks."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Job:
    """What is to be computed.

    `definition`, of JSON values, holds all that the rows depend on. Task i is `task(i, items[i])`, which returns its
    rows, at least one; `label(items[i])` are the columns that a row has even if the task fails. `schema` has the polars
    type of every column; `task` comes before them and `error` after them. `task`, `label` and the items are sent to
    other processes: functions of a module or `functools.partial` of one."""

    definition: Mapping[str, Any]
    items: Sequence[Any]
    task: Callable[[int, Any], list[Row]]
    label: Callable[[Any], Row]
    schema: Mapping[str, Any]

    @property
    def identity(self) -> dict[str, Any]:
        """The definition, the number of tasks and the version of tumble."""
        return {**self.definition, "tasks": len(self.items), "software": f"tumble {__version__}"}

    @property
    def sha256(self) -> str:
        """The hash of the identity."""
        return hashlib.sha256(json.dumps(self.identity, sort_keys=True, allow_nan=False).encode()).hexdigest()

    @property
    def columns(self) -> dict[str, Any]:
        """The polars types of all columns of the table."""
        import polars as pl

        return {"task": pl.Int64, **self.schema, "error": pl.String}


Chunk = tuple[int, ...]
Done = tuple[Chunk, bytes]
"""Numbers of tasks, and their rows as a Parquet file."""
Executor = Callable[[Job, Sequence[int]], Iterator[Done]]
"""Computes tasks, given by their numbers, and yields them chunk by chunk as they are finished, in any order."""


def run(
    job: Job, folder: Path, *, executor: Executor | None = None, progress: Progress = lambda _done, _all: None
) -> Path:
    """Compute what is missing of a job in a folder, and return the path of the table. Without an executor (see
    `tumble.campaigns.cluster`) everything happens in this process.

    Raises InputError if the folder holds something else or was begun by another job, TumbleError if a cluster is lost;
    what was computed is then kept."""
    table = folder / TABLE
    if _begun(job, folder) and table.exists():
        return table
    try:
        (folder / "parts").mkdir(exist_ok=True)
        done = _tasks_of_parts(folder)
        pending = [number for number in range(len(job.items)) if number not in done]
        count = len(job.items) - len(pending)
        progress(count, len(job.items))
        for numbers, part in (executor or serially)(job, pending):
            name = f"{numbers[0]:09d}-{numbers[-1]:09d}-{len(numbers)}.parquet"
            with whole_file(folder / "parts" / name) as temporary:
                temporary.write_bytes(part)
            count += len(numbers)
            progress(count, len(job.items))
        _join_parts(job, folder)
    except FileNotFoundError:  # another run in the same folder has made the table meanwhile
        if not table.exists():
            raise
    return table


# -------------------- tasks --------------------


def serially(job: Job, pending: Sequence[int]) -> Iterator[Done]:
    """Chunks of tasks with their rows, computed in this process."""
    for chunk in chunks(pending, workers=1):
        yield chunk, compute(job.task, job.label, job.columns, [(number, job.items[number]) for number in chunk])


def chunks(pending: Sequence[int], *, workers: int) -> Iterator[Chunk]:
    """Tasks in chunks of one size, small enough for so many processes to end together."""
    size = min(max(len(pending) // (CHUNKS_EACH * workers), 1), LARGEST_CHUNK)
    return (tuple(pending[first : first + size]) for first in range(0, len(pending), size))


def compute(
    task: Callable[[int, Any], list[Row]],
    label: Callable[[Any], Row],
    columns: Mapping[str, Any],
    tasks: Iterable[tuple[int, Any]],
) -> bytes:
    """The rows of tasks as a Parquet file with these columns."""
    rows: list[Row] = []
    for number, item in tasks:
        try:
            computed: list[Row] = task(number, item)
        except Exception as error:
            rows.append(failed(number, label(item), f"{type(error).__name__}: {error}"))
        else:
            rows += [{"task": number, **label(item), **row} for row in computed]
    return parquet_of(rows, columns)


def parquet_of(rows: Sequence[Row], columns: Mapping[str, Any]) -> bytes:
    """Rows as a Parquet file."""
    import polars as pl

    file = io.BytesIO()
    pl.DataFrame(rows, schema=columns).write_parquet(file)
    return file.getvalue()


def failed(number: int, label: Row, why: str) -> Row:
    """The row of a task that failed."""
    return {"task": number, **label, "error": " ".join(why.split())}


# -------------------- the folder --------------------


def _begun(job: Job, folder: Path) -> bool:
    """Whether the folder was begun by this job; if it is new, it is begun."""
    manifest = folder / MANIFEST
    if manifest.exists():
        try:
            content = json_of(text_of_document(manifest))
            same = content["sha256"] == job.sha256
        except (InputError, ValueError, KeyError, TypeError) as error:
            raise InputError(f"{manifest}: expected the manifest of a job of tumble, found another file") from error
        if not same:
            raise InputError(f"{folder}: expected a new folder, found one that another job has begun; give another")
        return True
    if folder.exists() and not (folder.is_dir() and all(path.name.startswith(".") for path in folder.iterdir())):
        raise InputError(f"{folder}: expected a new folder, or one that was begun by the same command, found another")
    folder.mkdir(parents=True, exist_ok=True)
    content = {"format": 1, "sha256": job.sha256, **job.identity}
    with whole_file(manifest) as temporary:
        temporary.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    return False


def _parts(folder: Path) -> list[Path]:
    return sorted(path for path in (folder / "parts").iterdir() if path.match("[0-9]*.parquet"))


def _tasks_of_parts(folder: Path) -> set[int]:
    """Numbers of the tasks that are done."""
    import polars as pl

    parts = _parts(folder)
    return set(pl.scan_parquet(parts).select("task").collect().to_series().to_list()) if parts else set()


def _join_parts(job: Job, folder: Path) -> None:
    """Make one table of the parts, sorted by task. Where two runs shared a folder and both did a task, its rows are
    equal, and those of one part are taken. The parts leave their place at once: another run finds all or none."""
    import polars as pl

    parts = _parts(folder)
    frame = pl.scan_parquet(parts, include_file_paths="part") if parts else pl.DataFrame(schema=job.columns).lazy()
    if parts:
        frame = frame.filter(pl.col("part") == pl.col("part").min().over("task")).drop("part")
    table = frame.sort("task", maintain_order=True).collect()
    with whole_file(folder / TABLE) as temporary:
        table.write_parquet(temporary)
    shutil.rmtree((folder / "parts").rename(folder / "joined"))
