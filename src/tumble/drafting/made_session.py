"""The session that `calibrate LOG` makes beside a log, and reuses if the content of the log is the same.

`made.json` in the session's folder has the hash of the log, the stated options, the version, and the files made. The
same log with the same options, or none, has the same session, with any corrections by hand; a renamed log keeps the
serial number of its first name unless one is stated. With other options the session is made anew, unless it was
corrected by hand, and its calibration is kept under another name; a command that only reads makes it in a folder for
the time being.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import secrets
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, replace
from itertools import count
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from tumble import __version__
from tumble.drafting.containers import files_of
from tumble.drafting.new_session import Given, written_session
from tumble.errors import InputError
from tumble.files import OutputFolder, in_use, nothing_left, whole_file
from tumble.recording.log_source import readable
from tumble.recording.session_file import SESSION_FILE
from tumble.run.observed import Progress

MADE = "made.json"
_RESULT = "calibration.json"


@contextmanager
def session_of_log(
    log: Path, given: Given, progress: Progress, *, reads_only: bool = False
) -> Iterator[tuple[Path, str, Sequence[str]]]:
    """Yield the folder of the session of a log, its origin in words, and remarks on each part.

    A session that is made here is removed, or the former one put back, if the block fails. With `reads_only` a session
    made with other options stays. Raises InputError for a log that cannot be read, and if a session corrected by hand
    would be made anew."""
    log = log if log.name else log.resolve()
    stem = re.sub(r"[*?\[\]]", "", log.name)
    for ending in (".gz", ".zst"):
        stem = stem.removesuffix(ending)
    stem = Path(f"_{stem}").stem[1:].lstrip("-. ") or "log"  # neither hidden nor like an option
    sha256 = hashlib.sha256()
    for file in files_of(log):
        for part in sorted(p for p in file.rglob("*") if p.is_file()) if file.is_dir() else [file]:
            with readable(part), part.open("rb", buffering=0) as stream:
                hashlib.file_digest(stream, lambda: sha256)
    digest = sha256.hexdigest()
    first, second = (log.with_name(f"{name}-session") for name in (stem, f"{stem}-{digest[:8]}"))
    _bring_back(first)
    _bring_back(second)
    folder = next((f for f in sorted(log.parent.glob("*-session")) if _made(f).get("log_sha256") == digest), None)
    made = {} if folder is None else _made(folder)
    former = made.get("given", {}).get("serial", stem)
    default = former if folder is not None and folder.name.startswith(f"{former}-") else stem
    whose = "" if given.serial or default == stem else f" (serial number {default!r})"
    if given == Given():  # what was stated before holds
        given = Given(**{key: value for key, value in made.get("given", {}).items() if key in asdict(given)})
    given = replace(given, serial=given.serial or default)
    stated, origin = {key: value for key, value in asdict(given).items() if value}, ""
    content = {"log_sha256": digest, "given": json.loads(json.dumps(stated)), "version": __version__}
    if folder is not None:
        edited = made.get("session_sha256") != _sha256(folder / SESSION_FILE)
        if made.get("given") == content["given"] and (edited or made.get("version") == __version__):
            by_hand = ", corrected by hand" if edited else ""
            with in_use(folder, shared=True):
                yield folder, f"{folder / SESSION_FILE}: the session made of this log before{whose}{by_hand}", []
            return
        before = made.get("given", {})
        other = [key for key in {**before, **content["given"]} if before.get(key) != content["given"].get(key)]
        options = ", ".join(f"--{key}" for key in other).replace("_", "-")
        others = f" ({options})" if other else ""
        if edited:
            raise InputError(
                f"{folder}: expected the options with which the session of this log was made, found others{others}, "
                f"and the session corrected by hand; calibrate it as it is (tumble calibrate {folder}), or remove it"
            )
        if reads_only:
            beside = log.parent if os.access(log.parent, os.W_OK) else None
            with TemporaryDirectory(prefix=".tumble-", dir=beside) as temporary:
                draft, _ = written_session(OutputFolder(Path(temporary)), log, given, progress)
                state = f"{folder} is of other options or another version{others} and stays; the log is read anew"
                yield Path(temporary), state, draft.remarks
            return
        origin = (
            f"{folder}: made anew, with other options or by another version{others}, in place of the session of serial "
            f"number {former!r}; "
        )
        if (folder / _RESULT).exists():
            origin += f"its calibration is kept as {_former_result(folder)}; "
    else:
        with in_use(first, shared=True):  # it may be being made
            pass
        folder = second if first.exists() else first
        if not os.access(log.parent, os.W_OK):
            advice = f"copy the log, or make a session elsewhere: tumble new SESSION {log}"
            raise InputError(f"{folder}: expected a folder that can be made, found {log.parent} read-only; {advice}")
    with _put_aside(folder), nothing_left(folder) as output:
        draft, _ = written_session(output, log, given, progress)
        content["session_sha256"] = _sha256(folder / SESSION_FILE)
        content["files"] = [file.name for file in output.written]
        with whole_file(output.new_file(MADE)) as temporary:
            temporary.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
        origin += f"kept in {folder / SESSION_FILE}"
        if draft.magnetometer is not None:
            origin += ", where the magnetometer is commented out: remove the # to calibrate it too"
        yield folder, origin, draft.remarks


@contextmanager
def _put_aside(folder: Path) -> Iterator[None]:
    """Move the folder of a session aside while it is made anew.

    Other files are moved back afterwards; if the block fails, so are those of the former session."""
    if not folder.exists():
        yield
        return
    aside = folder.with_name(f".{folder.name}.{secrets.token_hex(4)}")
    with in_use(folder):
        folder.rename(aside)
        try:
            yield
        except BaseException:
            aside.rename(folder)
            raise
    _bring_back(folder)


def _bring_back(folder: Path) -> None:
    """Move back files of a folder that were put aside: those of the user if the session was made anew, all if the
    process was killed."""
    for aside in folder.parent.glob(f".{folder.name}.*/"):
        with in_use(aside):  # not by the process that makes the session anew
            if not _made(folder):
                shutil.rmtree(folder, ignore_errors=True)
                aside.rename(folder)
                continue
            old = {*_made(aside).get("files", []), MADE}
            with suppress(FileNotFoundError):
                (aside / _RESULT).rename(aside / _former_result(aside))
            for file in aside.iterdir():
                if file.name not in old and not (folder / file.name).exists():
                    file.rename(folder / file.name)
            shutil.rmtree(aside)


def _former_result(folder: Path) -> str:
    """Return the name under which the calibration in a folder is kept where the session is made anew."""
    names = (f"calibration-{number}.json" for number in count(1))
    return next(name for name in names if not (folder / name).exists())


def _made(folder: Path) -> dict[str, Any]:
    """Return the content of made.json; empty without one."""
    with suppress(OSError, ValueError):
        made = json.loads((folder / MADE).read_bytes()) if (folder / SESSION_FILE).is_file() else {}
        return made if isinstance(made, dict) else {}
    return {}


def _sha256(file: Path) -> str:
    return hashlib.sha256(file.read_bytes()).hexdigest()
