"""Simulated session folders with a log and the true parameters (truth.json)."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from tumble.arguments import checked
from tumble.documents import json_of, text_of_document
from tumble.errors import InputError
from tumble.files import FilePath, nothing_left, whole_file
from tumble.planning.setup import Setup
from tumble.programme.positions import programmes
from tumble.recording.session import Session
from tumble.recording.session_file import SESSION_FILE, session_of, write_session
from tumble.sensors.model import Block
from tumble.simulation.recording import Recording, record
from tumble.simulation.scenario import NO_VIBRATION, Scenario, Vibration, itinerary, scenario_of
from tumble.simulation.temperature_profile import (
    REFERENCE_NAME,
    TemperatureProfile,
    draw_lags,
    draw_thermal,
    thermometer_columns,
)
from tumble.units import DEGREE, G_STANDARD, ZERO_CELSIUS, Array

LogFormat = Literal["parquet", "csv", "counts"]
COUNTS: Mapping[str, tuple[str, float]] = {"a": ("acc_", 4096.0 / G_STANDARD), "g": ("gyr_", 32.8 / DEGREE)}
"""For a log in counts, the prefixes of the columns of accelerometers and gyros, and counts per m/s² and rad/s."""
TRUTH_FILE = "truth.json"


@checked
def simulate_session(
    folder: FilePath,
    setup: Setup,
    *,
    seed: int,
    launch: int = 1,
    vibration: Vibration = NO_VIBRATION,
    temperature: TemperatureProfile | None = None,
    log_format: LogFormat = "parquet",
) -> Path:
    """Write a simulated session, session.toml, log and truth.json, into a new folder.

    Parameters
    ----------
    folder
        A folder without a session.
    setup
        Instrument, programme and site.
    seed
        Seed of the random numbers. The same set-up, seed and launch give the same session.
    launch
        Number of the power-on: the same device, put on the table and turned anew.
    vibration
        Vertical vibration throughout the log.
    temperature
        Temperatures of the session. The log then has a thermometer, and biases and scale factors change as usual for
        the grade; with all terms the sensors lag behind the thermometer, and biases have a hysteresis.
    log_format
        "parquet" or "csv", in SI; or "counts", whole counts and milliseconds without a session.toml.

    Returns
    -------
    Path
        The folder.

    Raises
    ------
    InputError
        For an impossible set-up or number, and for a folder that has a session.

    Examples
    --------
    >>> import tumble
    >>> tumble.simulate_session("session", tumble.Setup.of(grade="mems", positions=4), seed=1).name
    'session'
    """
    for name, number in (("seed", seed), ("launch", launch)):
        if number < 0:
            raise InputError(f"{name}: expected 0 or more, found {number}")
    of_device, of_launch = np.random.default_rng(seed), np.random.default_rng([seed, launch])
    scenario = scenario_of(setup, of_device, serial=f"{setup.instrument}-{seed}", vibration=vibration)
    if temperature is not None:
        geometry, _ = np.random.default_rng([seed, launch]).spawn(2)  # that of `record`, for the duration
        duration = float(itinerary(scenario, geometry).rests[-1, 1])
        accel, gyro = temperature.blocks(scenario.accel, scenario.gyro)
        thermal = draw_thermal(setup.further, setup.instrument, {"accel": accel, "gyro": gyro}, of_device)
        climate = temperature.climate(duration, draw_lags(setup.further, of_device))
        scenario = replace(scenario, accel=accel, gyro=gyro, truth={**scenario.truth, **thermal}, climate=climate)
    return write_simulation(Path(folder), scenario, of_launch, log_format=log_format)


def vibration_of(text: str) -> Vibration:
    """Return the vibration of a text AMPLITUDE@HZ, such as "0.05@30" for 0.05 m/s² at 30 Hz."""
    amplitude, separator, frequency = text.partition("@")
    try:
        vibration = Vibration(amplitude=float(amplitude), frequency=float(frequency))
    except ValueError:
        vibration = Vibration(amplitude=math.nan)
    if not separator or not (0.0 <= vibration.amplitude < math.inf and 0.0 < vibration.frequency < math.inf):
        raise InputError(f"vibration: expected AMPLITUDE@HZ in m/s^2 and Hz, such as 0.05@30, found {text!r}")
    return vibration


def write_simulation(
    folder: Path, scenario: Scenario, rng: np.random.Generator, *, log_format: LogFormat = "parquet"
) -> Path:
    """Record a scenario and write it as a new session folder; raise InputError if it has a session.

    session.toml names a built-in programme, lists the positions of another one, and has none for random positions."""
    import polars as pl  # slow to import

    log = f"log.{log_format}" if log_format != "counts" else "log.csv"
    try:
        with nothing_left(folder) as output:
            for name, what in ((SESSION_FILE, "a session"), (log, log), (TRUTH_FILE, TRUTH_FILE)):
                if (folder / name).exists():
                    raise InputError(f"{folder}: expected a new folder, found {what} in it; give another one")
            recording = record(scenario, rng)
            truth = {name: scenario.truth[name] for name in scenario.names}
            if (climate := scenario.climate) is not None:
                truth |= {REFERENCE_NAME: climate.reference - ZERO_CELSIUS}
                truth |= {f"{kind}.lag": lag for kind, lag in climate.lags.items()}
            frame = pl.DataFrame(_columns_of(scenario, recording))  # SI; float64 survives in both formats
            if log_format == "counts":
                counted = {"t": ("ms", 1e3)}
                for column in frame.columns:
                    if column[0] in COUNTS:
                        name, counts = COUNTS[column[0]]
                        counted[column] = f"{name}{column[1:]}", counts
                whole = [(size * pl.col(c)).round().cast(pl.Int64).alias(name) for c, (name, size) in counted.items()]
                frame = frame.select(*whole, *(c for c in frame.columns if c not in counted))
            with whole_file(output.new_file(log)) as temporary:
                (frame.write_parquet if log_format == "parquet" else frame.write_csv)(temporary)
            with whole_file(output.new_file(TRUTH_FILE)) as temporary:
                temporary.write_text(json.dumps(truth, indent=1) + "\n", encoding="utf-8")
            if log_format != "counts":
                write_session(output.new_file(SESSION_FILE).parent, _content(scenario, log_format))
    except OSError as error:
        raise InputError(f"{folder}: expected a folder to write to, found: {error.strerror or error}") from None
    return folder


def session_in_memory(scenario: Scenario, rng: np.random.Generator) -> Session:
    """Record a scenario as a session in memory, equal to that of `write_simulation`."""
    content = _content(scenario, "parquet")
    log = {key: value for key, value in content["log"].items() if key != "file"}
    return session_of(content | {"log": log}, _columns_of(scenario, record(scenario, rng)))


_LARGEST = 1e60  # of a true value


def read_truth(path: Path) -> dict[str, float]:
    """Read the true values by parameter name from a truth.json; raise InputError for another file."""
    try:
        content = json_of(text_of_document(path))
    except (InputError, ValueError) as error:
        fault = str(error).removeprefix(f"{path}: ")
        raise InputError(f"{path}: expected a truth.json as `tumble simulate` writes it: {fault}") from error
    numbers: list[Any] = list(content.values()) if isinstance(content, dict) else [None]
    if not all(type(each) in (int, float) and abs(each) < _LARGEST for each in numbers):
        raise InputError(f"{path}: expected an object of parameter names and numbers, found something else")
    return dict(content)


def _columns(block: Block) -> list[str]:
    """Return the column names of a block: ax, ay, az along the body axes, otherwise a0, a1, …"""
    along = np.array_equal(block.axes, np.eye(3))
    return [f"{block.kind[0]}{'xyz'[p] if along else p}" for p in range(block.size)]


def _columns_of(scenario: Scenario, recording: Recording) -> dict[str, Array]:
    """Return the columns of the log by name, SI."""
    accel = dict(zip(_columns(scenario.accel), recording.accel.T, strict=True))
    columns = {"t": recording.time} | accel | dict(zip(_columns(scenario.gyro), recording.gyro.T, strict=True))
    if scenario.climate is not None:
        middle = recording.time - 0.5 / scenario.setup.sample_rate
        columns |= thermometer_columns(scenario.climate, middle)
    return columns


def _content(scenario: Scenario, log_format: LogFormat) -> dict[str, Any]:
    """Return the content of session.toml."""
    setup = scenario.setup
    content: dict[str, Any] = {
        "format": 1,
        "device": {"serial": scenario.serial},
        "site": {
            "latitude_deg": round(setup.latitude / DEGREE, 12),
            "height_m": setup.height,
            "gravity": setup.gravity,
            "gravity_u": setup.gravity_u,
        },
        "log": {
            "file": f"log.{log_format}",
            "time": "t",
            "clock_ppm_u": 0,
            "accel": {"columns": _columns(scenario.accel), "unit": "m/s^2"},
            "gyro": {"columns": _columns(scenario.gyro), "unit": "rad/s"},
        },
    }
    for block in (scenario.accel, scenario.gyro):
        if not np.array_equal(block.axes, np.eye(3)):
            content["log"][block.kind]["axes"] = block.axes.tolist()
    if scenario.climate is not None:
        names = list(thermometer_columns(scenario.climate, np.zeros(1)))
        content["log"]["temperature"] = {"columns": names, "unit": "degC"}
    if (listed := scenario.programme) is not None:
        attitudes = [{"attitude": position.attitude} for position in listed.positions]
        content["programme"] = {"name": listed.name} if listed.name in programmes() else {"position": attitudes}
    return content
