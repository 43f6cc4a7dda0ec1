"""Reading and writing of session.toml, and sessions from the same description of samples in memory.

The keys are documented in docs/reference/session-file.md; `session.document` checks and converts them.
"""

from __future__ import annotations

from collections.abc import Mapping
from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import tomli_w

from tumble.arguments import checked
from tumble.documents import text_of_document, toml_of, validated
from tumble.errors import SessionError
from tumble.files import FilePath, whole_file
from tumble.recording.session import Session
from tumble.recording.session.document import SessionDocument

if TYPE_CHECKING:
    from tumble.recording.readers import Data, TableLog

SESSION_FILE = "session.toml"


@checked
def read_session(folder: FilePath) -> Session:
    """Read the session of a folder, or of the path of its session.toml.

    Raises SessionError, one line with up to three faults: no file, not TOML, an unknown key, an unexpected value, a log
    that does not exist.

    >>> import tumble
    >>> folder = tumble.simulate_session("session", tumble.Setup.of(grade="mems", positions=4), seed=1)
    >>> tumble.read_session(folder).device.serial
    'mems-1'
    """
    given = Path(folder)
    path = given if given.is_file() or given.name == SESSION_FILE else given / SESSION_FILE
    if path.name != SESSION_FILE:
        raise SessionError(
            f"{path}: expected a session folder or its {SESSION_FILE}, found another file; `tumble new` makes a "
            "session from a log, and so does `tumble calibrate` with --latitude"
        )
    if "\0" not in str(path) and not path.exists():
        if not path.parent.is_dir():
            raise SessionError(
                f"{given}: expected a session folder or its {SESSION_FILE}, found no such file or folder"
            )
        raise SessionError(
            f"{path}: expected a session folder with a {SESSION_FILE}, found none; `tumble new` makes a session from a "
            "log, and so does `tumble calibrate LOG` with --latitude"
        )
    content = toml_of(text_of_document(path, SessionError), str(path), SessionError)
    return _with_files(validated(SessionDocument, content, str(path), SessionError).si(path.parent), str(path))


@checked
def session_of(description: Mapping[str, Any], data: Data | None = None) -> Session:
    """Return the session of a description, the content of session.toml as a mapping.

    With `data` (arrays by column name, a polars or pandas frame, or a sequence of them for a log of several files) the
    description has no log.file; without, files are relative to the working folder. Raises SessionError as
    `read_session`, and LogError for data that are not columns of one length.

    >>> import numpy as np, tumble
    >>> accel = {"columns": ["ax", "ay", "az"], "unit": "count", "scale": 1000.0, "scale_per": "g"}
    >>> description = {"format": 1, "device": {"serial": "A-0007"}, "log": {"rate_hz": 100.0, "accel": accel}}
    >>> counts = {"ax": np.zeros(300), "ay": np.zeros(300), "az": np.full(300, 1000.0)}
    >>> from tumble.recording.log import open_log
    >>> chunk = next(open_log(tumble.session_of(description, counts)).chunks())
    >>> chunk.accel[0].tolist()
    [0.0, 0.0, 9.80665]
    """
    samples: tuple[TableLog, ...] = ()
    if data is not None:
        from tumble.recording.readers import samples_of  # polars is slow to import and only needed here

        log, samples = description.get("log"), samples_of(data)
        if isinstance(log, Mapping) and "file" in log:
            raise SessionError(f"session: log.file: expected none beside samples in memory, found {log['file']!r}")
        if isinstance(log, Mapping):
            description = {**description, "log": {**log, "file": [str(part.path) for part in samples]}}
    session = validated(SessionDocument, description, "session", SessionError).si(None)
    return _with_files(replace(session, log=replace(session.log, files=samples or session.log.files)), "session")


def session_of_gyros(description: Mapping[str, Any]) -> Session:
    """Return the session of a description without [log.accel], with the gyros in place of the accelerometers."""
    placeholder = {"columns": [f"no accelerometer {axis}" for axis in "xyz"], "unit": "m/s^2"}
    return gyros_in_place(session_of({**description, "log": {**description["log"], "accel": placeholder}}))


def gyros_in_place(session: Session) -> Session:
    """Return a session with the gyros in place of the accelerometers."""
    return replace(session, log=replace(session.log, accel=session.log.gyro or session.log.accel, gyro=None))


def _with_files(session: Session, where: str) -> Session:
    """Return a session after checking that its files exist."""
    log, passport = session.log, session.device.systematic
    for file in log.files:
        if isinstance(file, Path) and not file.is_file():
            raise SessionError(f"{where}: log.file: expected a log at {file}, found no such file")
    if passport is not None and not passport.is_file():
        raise SessionError(f"{where}: device.systematic: expected a calibration file at {passport}, found no such file")
    return session


def session_from(given: Session | FilePath) -> Session:
    """Return a session as it is, or read that of a folder."""
    return given if isinstance(given, Session) else read_session(given)


@checked
def write_session(folder: FilePath, content: Mapping[str, Any]) -> None:
    """Write session.toml with keys and values as in the file into a folder, made if need be.

    Raises SessionError for any other content; the log need not exist yet.

    >>> import tumble
    >>> log = {"file": "log.csv", "rate_hz": 100.0, "accel": {"columns": ["ax", "ay", "az"], "unit": "g"}}
    >>> tumble.write_session("session", {"format": 1, "device": {"serial": "A-0007"}, "log": log})
    """
    folder = Path(folder)
    path = folder / SESSION_FILE
    validated(SessionDocument, content, str(path), SessionError)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with whole_file(path) as temporary:
            temporary.write_text(tomli_w.dumps(content), encoding="utf-8")
    except OSError as error:
        raise SessionError(f"{path}: expected a folder to write to, found: {error.strerror}") from None


def description_of(session: Session) -> dict[str, Any]:
    """Return the content of session.toml for a session, without defaults and with absolute paths.

    There is no log.file if the samples are in memory.

    >>> import numpy as np, tumble
    >>> from tumble.recording.arrays import session_of_arrays
    >>> session = session_of_arrays(accel=np.tile([0.0, 0.0, 9.81], (300, 1)), rate=100.0)
    >>> description_of(session)["log"]
    {'rate_hz': 100.0, 'accel': {'columns': ['accel_x', 'accel_y', 'accel_z'], 'unit': 'm/s^2'}}
    """
    content = deepcopy(dict(session.description))
    files = [str(file.resolve()) for file in session.log.files if isinstance(file, Path)]
    del content["log"]["file"]
    content["log"] |= {"file": files[0] if len(files) == 1 else files} if files else {}
    if session.device.systematic is not None:
        content["device"]["systematic"] = str(session.device.systematic.resolve())
    return content
