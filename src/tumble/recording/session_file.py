"""Sessions read from session.toml, checked and written, and made of the same description of samples in memory.

The keys, with examples, are in docs/reference/session-file.md; `session.document` describes and checks them, and gives
what they say in SI and radians.
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
    """The session of a folder, or of the path of its session.toml.

    Raises SessionError, one line, with up to three faults of the file: missing, not TOML, an unknown key, a
    value that is not what its key expects, a log that does not exist.

    >>> import tumble
    >>> folder = tumble.simulate_session("session", tumble.Setup.of(grade="mems", positions=4), seed=1)
    >>> tumble.read_session(folder).device.serial
    'mems-1'
    """
    given = Path(folder)
    path = given if given.is_file() or given.name == SESSION_FILE else given / SESSION_FILE
    if path.name != SESSION_FILE:
        raise SessionError(
            f"{path}: expected a session folder or its {SESSION_FILE}, found another file; of a log `tumble new` makes "
            "a session, and so does `tumble calibrate` with --latitude"
        )
    if "\0" not in str(path) and not path.exists():
        if not path.parent.is_dir():
            raise SessionError(
                f"{given}: expected a session folder or its {SESSION_FILE}, found no such file or folder"
            )
        raise SessionError(
            f"{path}: expected a session folder with a {SESSION_FILE}, found none; of a log `tumble new` makes a "
            "session, and so does `tumble calibrate LOG` with --latitude"
        )
    content = toml_of(text_of_document(path, SessionError), str(path), SessionError)
    return _complete(validated(SessionDocument, content, str(path), SessionError).si(path.parent), str(path))


@checked
def session_of(description: Mapping[str, Any], data: Data | None = None) -> Session:
    """The session of a description, the content of session.toml as a mapping. With `data` (arrays by column name, a
    polars or a pandas frame, or a sequence of them for a log of several files) the description names no log.file;
    without, its files are relative to the working folder.

    Raises SessionError as `read_session`, and LogError for data that are not columns of one length.

    >>> import numpy as np, tumble
    >>> accel = {"columns": ["ax", "ay", "az"], "unit": "count", "scale": 1000.0, "scale_per": "g"}
    >>> description = {"format": 1, "device": {"serial": "A-0007"}, "log": {"rate_hz": 100.0, "accel": accel}}
    >>> counts = {"ax": np.zeros(300), "ay": np.zeros(300), "az": np.full(300, 1000.0)}
    >>> from tumble.recording.log import open_log
    >>> chunk = next(open_log(tumble.session_of(description, counts)).chunks())
    >>> chunk.accel[0].tolist()
    [0.0, 0.0, 9.80665]
    """
    where = "session"
    samples: tuple[TableLog, ...] = ()
    if data is not None:
        from tumble.recording.readers import samples_of  # polars is heavy, and only needed here

        log, samples = description.get("log"), samples_of(data)
        if isinstance(log, Mapping) and "file" in log:
            raise SessionError(f"{where}: log.file: expected none beside samples in memory, found {log['file']!r}")
        if isinstance(log, Mapping):
            description = {**description, "log": {**log, "file": [str(part.path) for part in samples]}}
    session = validated(SessionDocument, description, where, SessionError).si(None)
    return _complete(replace(session, log=replace(session.log, files=samples or session.log.files)), where)


def session_of_gyros(description: Mapping[str, Any]) -> Session:
    """The session of a description without [log.accel], with the gyros in place of the accelerometers."""
    some = {"columns": [f"no accelerometer {axis}" for axis in "xyz"], "unit": "m/s^2"}
    return gyros_in_place(session_of({**description, "log": {**description["log"], "accel": some}}))


def gyros_in_place(session: Session) -> Session:
    """A session in which the gyros stand for the accelerometers, so that their readings are those of the session."""
    return replace(session, log=replace(session.log, accel=session.log.gyro or session.log.accel, gyro=None))


def _complete(session: Session, where: str) -> Session:
    """A session whose files are there."""
    log, passport = session.log, session.device.systematic
    for file in log.files:
        if isinstance(file, Path) and not file.is_file():
            raise SessionError(f"{where}: log.file: expected a log at {file}, found no such file")
    if passport is not None and not passport.is_file():
        raise SessionError(f"{where}: device.systematic: expected a calibration file at {passport}, found no such file")
    return session


def session_from(given: Session | FilePath) -> Session:
    """A session as it is, or that of a folder."""
    if isinstance(given, Session):
        return given
    return read_session(given)


@checked
def write_session(folder: FilePath, content: Mapping[str, Any]) -> None:
    """Write session.toml with this content, keys and values as in the file, into a folder, made if need be.

    Raises SessionError if the content is not a session's; the log need not exist yet.

    >>> import numpy as np, tumble
    >>> from tumble.recording.arrays import session_of_arrays
    >>> session = session_of_arrays(accel=np.tile([0.0, 0.0, 9.81], (300, 1)), rate=100.0)
    >>> content = description_of(session)
    >>> tumble.write_session("session", content | {"log": {"file": "log.csv", **content["log"]}})
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
    """What session.toml says of a session, or the description that it was made of, with its defaults left out and its
    paths absolute; without log.file where its samples are in memory.

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
