"""Commands that look at a recording: `new`, `inspect`, `noise`."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from tumble.commands import console, params
from tumble.errors import GyrosAloneError, InputError, tables_at

if TYPE_CHECKING:
    from tumble.drafting.foreign_log import Draft
    from tumble.drafting.new_session import Given
    from tumble.run.gyros_alone import GyroRests


@click.command(epilog=params.examples("tumble new imu-7 LOG0007.TXT --latitude 56.84 --serial A-7"))
@click.argument("folder", type=params.PATH)
@click.argument("more", metavar="[LOG]...", nargs=-1, type=params.PATH)
@params.option("--log", "The recording: a log, a folder, a pattern, a bag.", type=params.PATH, multiple=True)
@params.LOG
@params.programme("Built-in programme that was recorded.")
@params.option("--message", "Topic or message to use if the recording has several.", metavar="NAME")
def new(folder: Path, more: tuple[Path, ...], log: tuple[Path, ...], **options: Any) -> None:
    """Write a commented session.toml for a log into FOLDER, and say what was guessed.

    LOG, or --log, is one or more text files in any dialect, .parquet, .bag, .db3, .mcap, .ulg, .bin, .mat, .h5,
    .npy, a .zip of such, a ROS 2 folder, or a folder or a pattern of files that were recorded one after the other."""
    from tumble.drafting.new_session import new_session

    if not log and not more:
        raise click.UsageError("Missing argument 'LOG': the recording")
    given = params.given_of(options)
    draft, faults = new_session(folder, [*log, *more], given, progress=console.with_progress)
    for sentence in draft.remarks:
        console.say(sentence)
    for fault in faults:
        console.warn(f"look at this: {fault}")
    stated = {"the serial number": given.serial, "the place": given.latitude}
    missing = [what for what, value in stated.items() if value is None]
    console.say(f"written to {folder / 'session.toml'}" + (f"; fill in {' and '.join(missing)}" if missing else ""))
    if draft.doubts:
        console.answer(f"doubt: {'; '.join(draft.doubts)}")


_ALWAYS_PRINTED = re.compile(r"^undone: |\(--message takes another\)$")
"""Notes on corrections of a recording and on other sensors in it."""


@contextmanager
def session_folders(
    recordings: Sequence[Path], options: dict[str, Any], *, every: bool = False
) -> Iterator[Sequence[Path]]:
    """Yield the folders of sessions; a session made from a log is removed if the block fails.

    A log is a file other than session.toml, a folder without one, or anything given with `options` of `params.LOG`.
    With `every`, notes on how each part of the session was determined are printed, otherwise only those on other
    sensors in the recording and on corrections of it."""
    first = recordings[0]
    stated = any(value is not None for value in options.values())
    if not stated and (len(recordings) > 1 or not is_log(first)):
        yield recordings
        return
    if len(recordings) > 1 or (first.is_dir() and (first / "session.toml").exists()) or first.suffix == ".toml":
        raise InputError(
            "--latitude, --height, --serial, --sample-rate, --accel, --gyro, --time and units: expected one log with "
            "them, found a session; they stand in its session.toml"
        )
    from tumble.drafting.made_session import session_of_log

    made = session_of_log(first, params.given_of(options), console.with_progress)
    with made as (folder, state, sentences):
        for sentence in sentences:
            if every or _ALWAYS_PRINTED.search(sentence):
                console.say(sentence)
        try:
            yield [folder]
        except InputError as error:
            end = tables_at("a session.toml, which `tumble new SESSION LOG` writes", error.for_command_line)
            raise type(error)(error.for_command_line + end) from error
        console.say(state)


def check_recordings(recordings: Sequence[Path]) -> None:
    """Raise InputError for a calibration file, and for a log among several recordings."""
    for path in recordings:
        if path.suffix == ".json" and path.is_file():
            with path.open("rb") as file:
                if re.match(rb'\s*\{\s*"format"', file.read(100)):
                    raise InputError(f"{path}: expected a session or a log, found a calibration file")
    if len(recordings) > 1 and (log := next(filter(is_log, recordings), None)) is not None:
        if (missing := next((path for path in recordings if not path.exists() and not is_log(path)), None)) is not None:
            raise InputError(f"{missing}: expected a session or a log, found no such file or folder")
        raise InputError(
            f"{log}: expected one log, or sessions, found a log among {len(recordings)} arguments; positions of one "
            "recording: `tumble calibrate 'PATTERN'`, in quotes, or `tumble new SESSION FILE …`; else a session of each"
        )


def is_log(path: Path) -> bool:
    """Return True for the path of a log, a pattern of files, or a folder of files without a session.toml."""
    if path.is_dir():
        return not (path / "session.toml").exists() and any(each.is_file() for each in path.iterdir())
    files = [path] if path.exists() else path.parent.glob(path.name) if set(path.name) & set("*?[") else []
    return path.suffix != ".toml" and any(file.is_file() for file in files)


def gyros_of(log: Path, given: Given) -> GyroRests:
    """Find the rests of a log of gyros alone."""
    from tempfile import TemporaryDirectory

    from tumble.recording.session_file import session_of_gyros
    from tumble.run.gyros_alone import gyro_rests

    with TemporaryDirectory() as folder:
        (draft,) = _drafts([log], Path(folder), given)
        content: dict[str, Any] = dict(draft.content)
        content["device"] = {"serial": given.serial or log.stem}
        return gyro_rests(session_of_gyros(content), console.with_progress)


@click.command(epilog=params.examples("tumble inspect imu-7", "tumble inspect LOG0007.TXT --latitude 56.84"))
@click.argument("recording", metavar="SESSION|LOG", type=params.PATH)
@params.LOG
@params.option("--plot/picture", "Draw the recording with its rests into .svg, .png or .pdf.", type=params.FILE)
@params.JSON
def inspect(recording: Path, picture: Path | None, **options: Any) -> None:
    """Show the rests and turns found in SESSION or in LOG, and what was rejected and why.

    LOG may have only gyros. A session is made beside it, as `tumble calibrate` does."""
    from tumble.run.observed import inspect_session
    from tumble.views.inspection import inspection_blocks, plot

    stated = dict(options)
    try:
        with session_folders([recording], options) as (folder,):
            observed = inspect_session(folder, progress=console.with_progress)
    except GyrosAloneError:
        from tumble.views.inspection import gyro_blocks

        found = gyros_of(recording, params.given_of(stated))
        console.show(found.segmentation, lambda: gyro_blocks(found))
        sys.exit(0)
    if picture is not None:
        plot(observed, picture)
        console.say(f"written to {picture}")
    doubt = "; ".join(observed.session.log.doubts)
    console.show(observed, lambda: [*inspection_blocks(observed), *[f"doubt: {doubt}"] * bool(doubt)])
    for fault in (*observed.faults, *observed.gyro_faults, *observed.gyro_bias_faults):
        console.warn(f"fault: {fault}")
    sys.exit(1 if observed.faults else 0)


@click.command(
    epilog=params.examples(
        "tumble noise imu-7",
        "tumble noise still.csv --accel ax,ay,az --gyro gx,gy,gz --sample-rate 100",
        "tumble noise monday tuesday wednesday",
    )
)
@click.argument("recordings", metavar="SESSION|LOG...", type=params.PATH, nargs=-1, required=True)
@params.option("--plot/picture", "Draw the Allan deviations into this .svg, .png or .pdf.", type=params.FILE)
@params.COLUMNS
@params.JSON
def noise(recordings: tuple[Path, ...], picture: Path | None, **options: Any) -> None:
    """Allan deviation: the noise of every sensor, from the longest rest of SESSION or from all of a LOG at rest.

    LOG is a log in any dialect, also one with only gyros, or a folder of files: columns, units and times that no option
    gives are found as by `tumble new`. Several recordings of one device, either sessions or logs, are evaluated
    together."""
    from tempfile import TemporaryDirectory

    from tumble.run.quiet_samples import is_session, noise_of
    from tumble.views.noise import noise_blocks, plot

    if all(map(is_session, recordings)):
        found = noise_of(*recordings)
    else:
        with TemporaryDirectory() as folder:
            drafts = _drafts(recordings, Path(folder), params.given_of(options))
            layout = {key: value for key, value in drafts[0].log.items() if key != "file"}
            files = [file for draft in drafts for file in draft.files]
            found = noise_of(*files, layout=layout)
        for sentence in drafts[0].remarks:
            console.say(sentence)
    if picture is not None:
        plot(found.panels, picture)
        console.say(f"written to {picture}")
    console.show(found, lambda: noise_blocks(found))


def _drafts(recordings: Sequence[Path], folder: Path, given: Given) -> list[Draft]:
    """Return a draft for each log, or one for all if some have accelerometers and others gyros.

    Copies are written into the folder if needed."""
    from tumble.drafting.new_session import drafted_log
    from tumble.files import OutputFolder

    def drafted(name: str, logs: Sequence[Path]) -> Draft:
        draft, _ = drafted_log(OutputFolder(folder / name), logs, given, console.with_progress, gyros_suffice=True)
        if draft.rate_guessed:
            raise InputError(f"{logs[0]}: expected a time column (--time) or the rate (--sample-rate), found neither")
        return draft

    drafts = [drafted(str(number), [recording]) for number, recording in enumerate(recordings)]
    if len({frozenset(draft.triads) for draft in drafts}) > 1:
        drafts = [drafted("together", recordings)]
    return drafts
