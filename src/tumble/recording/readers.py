"""The files of a log: one reader per format, each giving tables of a bounded size; a table in memory is read as one."""

from __future__ import annotations

from pathlib import Path

from tumble.documents import check_regular
from tumble.errors import LogError
from tumble.recording.dialect import Dialect
from tumble.recording.log_source import (
    LogSource,
    ending_of,
    readable,
)
from tumble.recording.samples import Samples
from tumble.recording.table_log import TableLog, parquet_log
from tumble.recording.text_log import text_log

ENDINGS = (".csv", ".csv.gz", ".csv.zst", ".parquet")
"""Endings of the files that are read without being told how they are written."""


def source_of(file: Path | Samples, dialect: Dialect | None = None) -> LogSource:
    """The reader of a file, or of a table in memory; with a dialect, of a text file of any name. Raises LogError for a
    format that cannot be read and an empty or damaged file."""
    return TableLog.of(file.path, file.table.lazy) if isinstance(file, Samples) else _source_of_file(file, dialect)


def _source_of_file(path: Path, dialect: Dialect | None) -> LogSource:
    ending = ending_of(path)
    if ending not in ENDINGS and dialect is None:
        raise LogError(
            f"{path}: expected a file that ends in {', '.join(ENDINGS)}, found another; state log.delimiter for a text "
            "file, or let `tumble new` find out what it is"
        )
    check_regular(path)
    with readable(path):
        if path.stat().st_size == 0:
            raise LogError(f"{path}: expected a log, found an empty file")
        return parquet_log(path) if ending == ".parquet" else text_log(path, dialect)
