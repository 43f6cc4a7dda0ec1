"""The session that `calibrate LOG` makes beside a log, and reuses if the content of the log is the same.

`made.json` in the session's folder has the hash of the log, the stated options, the name of the log and the version.
The same log with the same options, or none, has the same session, with any corrections by hand; a renamed log keeps the
serial number of its first name unless one is stated. With other options another session is made beside the former,
which stays with its calibration: no session is replaced.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, replace
from itertools import count
from pathlib import Path
from typing import Any

from tumble import __version__
from tumble.drafting.containers import files_of
from tumble.drafting.new_session import Given, written_session
from tumble.errors import InputError
from tumble.files import in_use, nothing_left, whole_file
from tumble.recording.log_source import readable
from tumble.recording.session_file import SESSION_FILE
from tumble.run.observed import Progress

MADE = "made.json"


@contextmanager
def session_of_log(log: Path, given: Given, progress: Progress) -> Iterator[tuple[Path, str, Sequence[str]]]:
    """Yield the folder of the session of a log, its origin in words, and remarks on each part.

    A session that is made here is removed if the block fails. Raises InputError for a log that cannot be read."""
    log = log if log.name else log.resolve()
    if not log.name:
        raise InputError(f"{log}: expected a log or a folder of logs, found the root of the file system")
    stem = re.sub(r"[*?\[\]]", "", log.name)
    for ending in (".gz", ".zst"):
        stem = stem.removesuffix(ending)
    stem = Path(f"_{stem}").stem[1:].lstrip("-. ") or "log"  # neither hidden nor like an option
    sha256 = hashlib.sha256()
    for file in files_of(log):
        for part in sorted(p for p in file.rglob("*") if p.is_file()) if file.is_dir() else [file]:
            with readable(part), part.open("rb", buffering=0) as stream:
                hashlib.file_digest(stream, lambda: sha256)
    made = {folder: _made(folder) for folder in log.parent.glob("*-session")}
    of_log = [folder for folder, content in made.items() if content.get("log_sha256") == sha256.hexdigest()]
    of_log.sort(key=lambda folder: (folder / MADE).stat().st_mtime_ns, reverse=True)
    latest: dict[str, Any] = made[of_log[0]] if of_log else {}
    name = latest.get("name", stem)
    whose = "" if given.serial or name == stem else f" (serial number {name!r})"
    if given == Given():  # what was stated last holds
        given = Given(**{key: value for key, value in latest.get("given", {}).items() if key in asdict(given)})
    given = replace(given, serial=given.serial or name)
    stated = json.loads(json.dumps({key: value for key, value in asdict(given).items() if value}))
    for folder in of_log:
        edited = made[folder].get("session_sha256") != _sha256(folder / SESSION_FILE)
        if made[folder].get("given") == stated and (edited or made[folder].get("version") == __version__):
            by_hand = ", corrected by hand" if edited else ""
            with in_use(folder, shared=True):
                yield folder, f"{folder / SESSION_FILE}: the session made earlier from this log{whose}{by_hand}", []
            return
    origin, before = "", latest.get("given", {})
    if of_log:
        other = [key for key in {**before, **stated} if before.get(key) != stated.get(key)]
        options = f" ({', '.join(f'--{key}' for key in other).replace('_', '-')})" if other else ""
        origin = f"new session, as options or the version of tumble differ{options}; {of_log[0]} is kept too; "
    names = (f"{stem}-session" if number == 1 else f"{stem}-{number}-session" for number in count(1))
    folder = next(path for path in map(log.with_name, names) if not path.exists())
    if not os.access(log.parent, os.W_OK):
        advice = f"copy the log, or make a session elsewhere: tumble new SESSION {log}"
        raise InputError(f"{folder}: expected a folder that can be made, found {log.parent} read-only; {advice}")
    with nothing_left(folder) as output:
        draft, _ = written_session(output, log, given, progress)
        content = {"log_sha256": sha256.hexdigest(), "name": name, "given": stated, "version": __version__}
        content["session_sha256"] = _sha256(folder / SESSION_FILE)
        with whole_file(output.new_file(MADE)) as temporary:
            temporary.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
        origin += f"kept in {folder / SESSION_FILE}"
        if draft.magnetometer is not None:
            origin += ", where the magnetometer is commented out: remove the # to calibrate it too"
        yield folder, origin, draft.remarks


def _made(folder: Path) -> dict[str, Any]:
    """Return the content of made.json; empty without one."""
    with suppress(OSError, ValueError):
        made = json.loads((folder / MADE).read_bytes()) if (folder / SESSION_FILE).is_file() else {}
        return made if isinstance(made, dict) else {}
    return {}


def _sha256(file: Path) -> str:
    return hashlib.sha256(file.read_bytes()).hexdigest()
