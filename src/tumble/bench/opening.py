"""A bench from the words of the command line: the folder of its session, made where it is new, and its source."""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from tumble.bench import folder as folders
from tumble.bench.sources import MOTIONCAL_LOG, LineSource, in_si, is_recorded, source_of
from tumble.bench.station import Station
from tumble.bench.virtual_table import FULL_SCALE, GRAVITY
from tumble.errors import InputError
from tumble.programme.positions import programme as built_in
from tumble.recording.session_file import SESSION_FILE, read_session
from tumble.usual_setup import LATITUDE_DEG


def stations_of(
    folders: Sequence[Path],
    listen: Sequence[str] = (),
    *,
    serials: Sequence[str] = (),
    site: Mapping[str, Any],
    programme: str | None = None,
    wanted: tuple[str, ...] = (),
    grade: str = "mems",
    registry: str | None = None,
) -> list[Station]:
    """The benches of session folders: of each what stands after its --listen, and its --serial, in their order; of none
    where another program writes the log. Raises InputError."""
    for given, option in ((listen, "--listen"), (serials, "--serial")):
        if given and len(given) != len(folders):
            raise InputError(
                f"{option}: expected none, or one for each of the {len(folders)} sessions, found {len(given)}"
            )
    twice = [folder for k, folder in enumerate(folders) if folder.resolve() in [f.resolve() for f in folders[:k]]]
    if twice:
        raise InputError(
            f"{twice[0]}: expected every session once, found it twice; give each bench a folder of its own"
        )
    for folder in folders:
        if not listen and not (folder / SESSION_FILE).exists():
            raise InputError(
                f"{folder}: expected a session folder, or --listen with what to record into it, found neither"
            )
    return [
        station_of(
            folder,
            listen[k] if listen else None,
            serial=serials[k] if serials else None,
            site=site,
            programme=programme,
            wanted=wanted,
            grade=grade,
            registry=registry,
        )
        for k, folder in enumerate(folders)
    ]


def station_of(
    folder: Path,
    listen: str | None,
    *,
    serial: str | None = None,
    site: Mapping[str, Any],
    programme: str | None = None,
    wanted: tuple[str, ...] = (),
    grade: str = "mems",
    registry: str | None = None,
) -> Station:
    """The bench of a session folder and of what stands after --listen. Raises InputError."""
    if programme is not None:
        built_in(programme)
    if listen is not None and not (folder / SESSION_FILE).exists():
        _make(folder, listen, serial, site, programme)
    return Station(folder, None if listen is None else _Once(listen), wanted=wanted, grade=grade, registry=registry)


def _make(folder: Path, listen: str, serial: str | None, site: Mapping[str, Any], programme: str | None) -> None:
    """A session folder for a source: a copy of what is replayed, else of a source that sends SI, or MotionCal."""
    kind, _, rest = listen.partition(":")
    if kind == "replay":
        original = Path(rest.rpartition("@")[0] if "@" in rest else rest)
        source_of(listen).close()
        if is_recorded(read_session(original).log):
            folder.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(original / SESSION_FILE, folder / SESSION_FILE)
        else:
            folders.begin_as_csv(folder, original)
        return
    if kind == "simulator":
        log = in_si()
        log["gyro"] = log["gyro"] | {"range": FULL_SCALE}
        there = {"latitude_deg": LATITUDE_DEG, "gravity": GRAVITY}
        if {**there, **site} != there:
            raise InputError(
                f"--latitude, --gravity: expected those of the simulated unit, {LATITUDE_DEG}° and {GRAVITY} m/s², "
                "found others; leave them out"
            )
        site = there | {"gravity_u": 1e-6}
        programme, serial = programme or rest.partition("@")[0] or "rough-table", serial or "virtual-1"
        folders.begin(folder, log=log, serial=serial, site=site, programme=programme)
        return
    told = {"--serial": serial, "--latitude": site.get("latitude_deg")}
    missing = [option for option, given in told.items() if given is None]
    if serial is None or missing:
        raise InputError(
            f"{folder}: expected --serial (of the unit) and --latitude (of the place) for a new session, found no "
            f"{' and no '.join(missing)}"
        )
    log = dict(MOTIONCAL_LOG) if kind == "serial" and rest.endswith(":motioncal") else in_si()
    folders.begin(folder, log=log, serial=serial, site=site, programme=programme)


class _Once:
    """Makes the source anew each time recording begins."""

    def __init__(self, listen: str) -> None:
        self._listen = listen.removesuffix(":motioncal")

    def __call__(self) -> LineSource:
        return source_of(self._listen)
