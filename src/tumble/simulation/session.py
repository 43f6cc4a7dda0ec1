"""Session folders with known truth: a request in the words of the command line becomes a scenario, its log and
truth.json."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from tumble.earth import normal_gravity
from tumble.errors import InputError
from tumble.files import FilePath, whole_file
from tumble.programme.positions import BUILT_IN, Programme, programme
from tumble.recording.session import Session, Site, session_of, write_session
from tumble.sensors.grades import NoiseModel
from tumble.sensors.grades import grade as typical
from tumble.sensors.model import Block
from tumble.simulation.recording import Recording, record
from tumble.simulation.scenario import (
    IN_HAND,
    NO_VIBRATION,
    ON_TABLE,
    HandHeld,
    OnTable,
    Profile,
    Scenario,
    Vibration,
    draw_parameters,
)
from tumble.units import DEGREE, Array

LogFormat = Literal["parquet", "csv"]
TRUTH_FILE = "truth.json"


@dataclass(frozen=True, kw_only=True, slots=True)
class Request:
    """What to simulate, in the words of the command line: a typical instrument of a `grade` in a built-in
    programme or, if `positions` is given, in the hand at so many random positions.

    `rest` (s), `rate_deg_s` and `sample_rate` (Hz) are those of `ON_TABLE` or `IN_HAND` where None. The
    errors of table and mounting do not apply in the hand. `noiseless` leaves out noise and instability."""

    grade: str = "navigation"
    programme: str = "rough-table"
    positions: int | None = None
    rest: float | None = None
    rate_deg_s: float | None = None
    sample_rate: float | None = None
    table_error_deg: float = 1.0
    mounting_error_deg: float = 1.0
    latitude_deg: float = 56.84
    noiseless: bool = False
    vibration: Vibration = NO_VIBRATION


def simulate_session(
    folder: FilePath, request: Request, *, seed: int, launch: int = 1, log_format: LogFormat = "parquet"
) -> Path:
    """Write a simulated session, session.toml, log and truth.json, into a new folder, and return the folder.

    The same request, seed and launch give the same numbers; another launch of a seed is the same device, put on the
    table and turned anew. Raises InputError, one line, for a request that cannot be met, and for a folder that holds a
    session already.

    >>> import tumble
    >>> tumble.simulate_session("session", tumble.Request(grade="mems", positions=4), seed=1).name
    'session'
    """
    truth, course = np.random.default_rng(seed), np.random.default_rng([seed, launch])
    scenario = typical_scenario(request, truth, serial=f"{request.grade}-{seed}")
    return write_simulation(Path(folder), scenario, course, log_format=log_format)


def typical_scenario(request: Request, rng: np.random.Generator, *, serial: str) -> Scenario:
    """The scenario of a request: a triad of each kind along the body axes, errors drawn from its grade."""
    grade = typical(request.grade)
    accel, gyro = (Block(kind=kind, axes=np.eye(3)) for kind in ("accel", "gyro"))
    return Scenario(
        course=_course(request),
        accel=accel,
        gyro=gyro,
        truth=draw_parameters(request.grade, (accel, gyro), rng),
        noise=NoiseModel() if request.noiseless else grade.noise,
        profile=_profile(request),
        site=_site(request.latitude_deg),
        vibration=request.vibration,
        serial=serial,
    )


def _course(request: Request) -> OnTable | HandHeld:
    if request.positions is not None:
        return HandHeld(positions=request.positions)
    return OnTable(
        programme=programme(request.programme),
        table_error=request.table_error_deg * DEGREE,
        mounting_error=request.mounting_error_deg * DEGREE,
    )


def _profile(request: Request) -> Profile:
    """The usual profile with what the request changes; on a table the first rest is like the others."""
    usual = ON_TABLE if request.positions is None else IN_HAND
    rest = usual.rest if request.rest is None else request.rest
    return Profile(
        first_rest=rest if request.positions is None else max(rest, usual.first_rest),
        rest=rest,
        rate=usual.rate if request.rate_deg_s is None else request.rate_deg_s * DEGREE,
        ramp=usual.ramp,
        sample_rate=usual.sample_rate if request.sample_rate is None else request.sample_rate,
    )


def _site(latitude_deg: float) -> Site:
    """A site 270 m up whose gravity, the normal one, has been measured."""
    if not abs(latitude_deg) <= 90.0:
        raise InputError(f"latitude: expected -90 to 90 degrees, found {latitude_deg:g}")
    latitude, height = latitude_deg * DEGREE, 270.0
    return Site(latitude=latitude, height=height, gravity=normal_gravity(latitude, height), gravity_u=1e-7)


def vibration_of(text: str) -> Vibration:
    """A vibration written as AMPLITUDE@HZ, such as "0.05@30" for 0.05 m/s² at 30 Hz."""
    amplitude, at, frequency = text.partition("@")
    try:
        found = Vibration(amplitude=float(amplitude), frequency=float(frequency))
    except ValueError:
        found = Vibration(amplitude=math.nan)
    if not at or not (0.0 <= found.amplitude < math.inf and 0.0 < found.frequency < math.inf):
        raise InputError(f"vibration: expected AMPLITUDE@HZ in m/s^2 and Hz, such as 0.05@30, found {text!r}")
    return found


def write_simulation(
    folder: Path, scenario: Scenario, rng: np.random.Generator, *, log_format: LogFormat = "parquet"
) -> Path:
    """Record a scenario and write it as a session folder, which must not hold a session yet.

    session.toml names a built-in programme, lists the positions of another, and names none for random ones.
    Raises InputError."""
    if (folder / "session.toml").exists():
        raise InputError(f"{folder}: expected a new folder, found a session in it; give another one")
    recording = record(scenario, rng)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        _write_log(folder / f"log.{log_format}", scenario, recording)
        truth = {name: scenario.truth[name] for name in scenario.names}
        with whole_file(folder / TRUTH_FILE) as temporary:
            temporary.write_text(json.dumps(truth, indent=1) + "\n", encoding="utf-8")
    except OSError as error:
        raise InputError(f"{folder}: expected a folder to write to, found: {error.strerror or error}") from None
    write_session(folder, _content(scenario, log_format))
    return folder


def session_in_memory(scenario: Scenario, rng: np.random.Generator) -> Session:
    """A scenario recorded as a session in memory, the same as `write_simulation` writes."""
    content = _content(scenario, "parquet")
    log = {key: value for key, value in content["log"].items() if key != "file"}
    return session_of(content | {"log": log}, _columns_of(scenario, record(scenario, rng)))


def read_truth(path: Path) -> dict[str, float]:
    """True values by parameter name from a truth.json. Raises InputError for a file that is none."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path}: expected a truth.json as `tumble simulate` writes it: {error.strerror}") from error
    except ValueError as error:
        raise InputError(f"{path}: expected a truth.json as `tumble simulate` writes it: {error}") from error
    if not isinstance(content, dict) or not all(map(_finite, content.values())):
        raise InputError(f"{path}: expected an object of parameter names and numbers, found something else")
    return content


def _finite(value: object) -> bool:
    return isinstance(value, float | int) and not isinstance(value, bool) and math.isfinite(value)


def _columns(block: Block) -> list[str]:
    """Column names of a block: ax, ay, az if it is along the body axes, else a0, a1, …"""
    along = np.array_equal(block.axes, np.eye(3))
    return [f"{block.kind[0]}{'xyz'[p] if along else p}" for p in range(block.size)]


def _columns_of(scenario: Scenario, recording: Recording) -> dict[str, Array]:
    """The log by the names of its columns, SI."""
    accel = dict(zip(_columns(scenario.accel), recording.accel.T, strict=True))
    return {"t": recording.time} | accel | dict(zip(_columns(scenario.gyro), recording.gyro.T, strict=True))


def _write_log(file: Path, scenario: Scenario, recording: Recording) -> None:
    """The log in SI; float64 survives in both formats."""
    import polars as pl  # heavy, and only needed here

    frame = pl.DataFrame(_columns_of(scenario, recording))
    with whole_file(file) as temporary:
        if file.suffix == ".csv":
            frame.write_csv(temporary)
        else:
            frame.write_parquet(temporary)


def _content(scenario: Scenario, log_format: LogFormat) -> dict[str, Any]:
    """What session.toml says."""
    site = scenario.site
    content: dict[str, Any] = {
        "format": 1,
        "device": {"serial": scenario.serial},
        "site": {
            "latitude_deg": round(scenario.latitude / DEGREE, 12),
            "height_m": site.height,
            "gravity": site.gravity,
            "gravity_u": site.gravity_u,
        },
        "log": {
            "file": f"log.{log_format}",
            "time": "t",
            "accel": _block_content(scenario.accel, "m/s^2"),
            "gyro": _block_content(scenario.gyro, "rad/s"),
        },
    }
    if isinstance(scenario.course, OnTable):
        content["programme"] = _programme_content(scenario.course.programme)
    return content


def _block_content(block: Block, unit: str) -> dict[str, Any]:
    content: dict[str, Any] = {"columns": _columns(block), "unit": unit}
    if not np.array_equal(block.axes, np.eye(3)):
        content["axes"] = block.axes.tolist()
    return content


def _programme_content(listed: Programme) -> dict[str, Any]:
    if listed.name in BUILT_IN:
        return {"name": listed.name}
    return {"position": [{"attitude": position.attitude} for position in listed.positions]}
