"""Benches from the words of the command line: the folder of a session, made where it is new, and its source."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import zip_longest
from pathlib import Path
from typing import Any

from tumble.bench.record.sources import source_of
from tumble.bench.session_folder import begin_for
from tumble.bench.station import Station
from tumble.errors import InputError
from tumble.programme.positions import programme as built_in
from tumble.recording.session_file import SESSION_FILE


def stations_of(
    folders: Sequence[Path],
    listen: Sequence[str] = (),
    *,
    serials: Sequence[str] = (),
    site: Mapping[str, Any],
    programme: str | None = None,
    **wishes: Any,
) -> list[Station]:
    """The benches of session folders: of each what stands after its --listen, and its --serial, in their order; of none
    where another program writes the log. `wishes` are those of a `Station`. Raises InputError."""
    for given, option in ((listen, "--listen"), (serials, "--serial")):
        if given and len(given) != len(folders):
            raise InputError(
                f"{option}: expected none, or one for each of the {len(folders)} sessions, found {len(given)}"
            )
    resolved = [folder.resolve() for folder in folders]
    for folder, place in zip(folders, resolved, strict=True):
        if resolved.count(place) > 1:
            raise InputError(
                f"{folder}: expected every session once, found it twice; give each bench a folder of its own"
            )
        if not listen and not (folder / SESSION_FILE).exists():
            raise InputError(
                f"{folder}: expected a session folder, or --listen with what to record into it, found neither"
            )
    return [
        station_of(folder, source, serial=serial, site=site, programme=programme, **wishes)
        for folder, source, serial in zip_longest(folders, listen, serials)
    ]


def station_of(
    folder: Path,
    listen: str | None,
    *,
    serial: str | None = None,
    site: Mapping[str, Any],
    programme: str | None = None,
    **wishes: Any,
) -> Station:
    """The bench of a session folder and of what stands after --listen; the source is made anew each time recording
    begins. Raises InputError."""
    if programme is not None:
        built_in(programme)
    if listen is None:
        return Station(folder, None, **wishes)
    if not (folder / SESSION_FILE).exists():
        begin_for(folder, listen, serial, site, programme)
    source = listen.removesuffix(":motioncal")
    return Station(folder, lambda: source_of(source), **wishes)
