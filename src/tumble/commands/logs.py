"""Logs where a session is expected: the session that is made of one, and logs of gyros alone."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tumble.commands import tell
from tumble.errors import InputError

if TYPE_CHECKING:
    from tumble.drafting.new_session import Given
    from tumble.run.gyros_alone import GyroRests


def is_log(path: Path) -> bool:
    """Whether a path is that of a log, or of a folder of files without a session.toml, such as a file a sensor."""
    if path.is_dir():
        return not (path / "session.toml").exists() and any(each.is_file() for each in path.iterdir())
    return path.is_file() and path.suffix != ".toml"


@contextmanager
def session_folder(path: Path) -> Iterator[Path]:
    """The folder of a session, that of a log beside it."""
    if not is_log(path):
        yield path
        return
    from tumble.drafting.made_session import session_of_log
    from tumble.drafting.new_session import NOTHING_GIVEN

    with session_of_log(path, NOTHING_GIVEN, tell.with_progress) as (folder, state, _, _):
        tell.say(state)
        yield folder


def gyros_of(log: Path, given: Given) -> GyroRests:
    """The rests of a log of gyros alone."""
    from tempfile import TemporaryDirectory

    from tumble.drafting.new_session import drafted_log
    from tumble.files import OutputFolder
    from tumble.run.gyros_alone import gyro_rests

    with TemporaryDirectory() as folder:
        draft, _ = drafted_log(OutputFolder(Path(folder)), [log], given, tell.with_progress, gyros_suffice=True)
        if draft.rate_guessed:
            raise InputError(f"{log}: expected a time column (--time) or the rate (--sample-rate), found neither")
        content: dict[str, Any] = dict(draft.content)
        content["device"] = {"serial": given.serial or log.stem}
        content["log"] = dict(content["log"]) | ({"doubt": "; ".join(draft.doubts)} if draft.doubts else {})
        return gyro_rests(content, tell.with_progress)
