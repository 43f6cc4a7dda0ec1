"""Real recordings as cases: read from the data folder (TUMBLE_DATA) and the cache of `evidence.real.get`.

What is not there is left out, and `missing` says so. Readings are converted by the factors of the data sheets; gravity
is what the authors state or the normal gravity of the place (GRS80), with a u that covers what is not known of either.
"""

from __future__ import annotations

import json
import os
import tomllib
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl
from scipy.io import loadmat

from evidence.case import NAMES, Array, Case
from evidence.real.get import Source, named, place_of

DEGREE = np.pi / 180.0
G0 = 9.80665
SIMULATED = ("truth-turntable", "truth-handheld", "truth-full", "psins-systematic")
"""Sources that are no recordings."""
WHERE = {
    "xsens-mti": (45.41, 12.0), "imucal-ferraris": (49.57, 280.0), "mimu4444": (59.35, 30.0),
    "openaxes-imu9": (52.38, 60.0),
    "ln100-updown": (51.08, 1100.0), "mpu9150": (61.79, 80.0), "suarez": (-32.88, 830.0), "mascia": (41.93, 30.0),
    "rohac": (50.10, 200.0), "broad": (52.51, 40.0),
}  # fmt: skip
"""Latitude, °, and height, m, of those whose authors do not state gravity."""


def normal_gravity(latitude: float, height: float) -> float:
    """GRS80 by Somigliana, with the free-air gradient, m/s²."""
    s2 = np.sin(latitude) ** 2
    surface = 9.7803267715 * (1.0 + 0.001931851353 * s2) / np.sqrt(1.0 - 0.0066943800229 * s2)
    return float(surface - 3.086e-6 * height)


def data_folder() -> Path:
    """Where the recordings of TUMBLE_DATA are."""
    return Path(os.environ.get("TUMBLE_DATA") or Path(__file__).parents[3] / "shared" / "data")


def case(source: Source, part: str, device: str, time: Array, accel: Array, gyro: Array | None, kind: str) -> Case:
    """A case with gravity, place, licence and address of its source."""
    latitude, height = WHERE.get(source.name, (np.nan, 0.0))
    known = np.isfinite(latitude)
    address = source.address or f"https://github.com/{source.repository}, {source.commit[:8]}"
    return Case(
        name=f"{source.name} {part}".strip(), kind=kind, device=f"{source.name} {device}".strip(),
        time=time - time[0], accel=accel, gyro=gyro, licence=source.licence, source=address,
        gravity=normal_gravity(latitude * DEGREE, height) if known else G0, gravity_u=1e-3,
        latitude=latitude * DEGREE if known else None,
    )  # fmt: skip


def xsens(source: Source) -> Iterator[Case]:
    """Counts of an Xsens MTi. Its certificate rounds misalignments to 0.01: no reference for axes."""
    log = pl.read_csv(data_folder() / source.name / "log.csv")
    accel = (log.select("acc_x", "acc_y", "acc_z").to_numpy() - 32768.0) / 415.0
    gyro = (log.select("gyr_x", "gyr_y", "gyr_z").to_numpy() - 32768.0) / 4770.0
    yield case(source, "", "", log["t"].to_numpy(), accel, gyro, "by hand")


def imucal(source: Source) -> Iterator[Case]:
    """Six faces and a full turn about each axis: one recording cut into its sections, which are set ten seconds apart,
    and one whole."""
    folder = data_folder() / source.name
    log = pl.read_csv(folder / "annotated_session.csv").sort("samples")
    part = log["part"].to_numpy()
    cuts = np.cumsum(np.concatenate([[False], part[1:] != part[:-1]]))
    time = (log["samples"].to_numpy() + 1) / 204.8 + 10.0 * cuts
    accel = log.select("acc_x", "acc_y", "acc_z").to_numpy() / 2048.0 * G0
    gyro = log.select("gyr_x", "gyr_y", "gyr_z").to_numpy() / 16.4 * DEGREE
    cut = case(source, "annotated", "1", time, accel, gyro, "six faces by hand")
    times = {name: cut.time[part == name] for name in np.unique(part)}
    spans = {name: (float(t[0]) - 0.5 / 204.8, float(t[-1]) + 0.5 / 204.8) for name, t in times.items()}
    yield replace(cut, sections=noted(spans), turn_angle=2.0 * np.pi)
    log = pl.read_csv(folder / "example_ferraris_session.csv")
    listed = json.loads((folder / "example_ferraris_session_list.json").read_text())
    gyro = log.select("gyr_x", "gyr_y", "gyr_z").to_numpy() * DEGREE
    time, accel = np.arange(1, len(log) + 1) / 102.4, log.select("acc_x", "acc_y", "acc_z").to_numpy()
    whole = case(source, "session", "2", time, accel, gyro, "six faces by hand")
    spans = {name: (one["start"] / 102.4, one["end"] / 102.4) for name, one in listed.items()}
    yield replace(whole, sections=noted(spans), turn_angle=2.0 * np.pi)


def noted(spans: dict[str, tuple[float, float]]) -> dict[str, tuple[float, float]]:
    """imucal's names of sections (x_p, x_a, x_rot) as those of a case."""
    words = {"p": "+", "a": "-", "rot": " turn"}
    return {name.split("_")[0] + words[name.split("_")[1]]: span for name, span in spans.items()}


def mimu(source: Source) -> Iterator[Case]:
    """Nine sessions of eight chips: packets of a header 0xAA, a counter, the length, time in 1/(64 MHz), 48 readings
    (three accelerometers and three gyros a chip), all big-endian, and the sum of all bytes before."""
    layout = np.dtype([("head", "u1"), ("count", ">u2"), ("length", "u1"), ("ticks", ">u4"), ("read", ">i2", (8, 6)),
                       ("sum", ">u2")])  # fmt: skip
    for file in source.files:
        raw = place_of(source, file).read_bytes()
        start = raw.index(b"\xaa", 4)
        packets = np.frombuffer(raw, layout, (len(raw) - start) // layout.itemsize, start)
        packets = packets[(packets["head"] == 0xAA) & (packets["length"] == layout.itemsize - 6)]
        ticks = np.cumsum(np.diff(packets["ticks"].astype(np.int64), prepend=int(packets["ticks"][0])) % 2**32)
        session = file.split("_")[-1].split("/")[0]
        for chip in range(8):
            accel = packets["read"][:, chip, :3] / 2048.0 * G0
            gyro = packets["read"][:, chip, 3:] / 16.4 * DEGREE
            part, device = f"session {session} chip {chip + 1}", f"chip {chip + 1}"
            yield case(source, part, device, ticks / 64e6, accel, gyro, "icosahedron by hand, chips of an array")


def openaxes(source: Source) -> Iterator[Case]:
    """Accelerometers of two chips, and the gyros of one. The times are those of arrival in bursts, and no sample is
    lost: the samples stand evenly on the line through the times."""
    log = pl.read_parquet(data_folder() / source.name / "log.parquet")
    count = log["INDEX"].to_numpy().astype(float)
    arrival = 1e-6 * (log["TIME"] - log["TIME"][0]).to_numpy().astype(float)
    time = np.polyval(np.polyfit(count, arrival, 1), count)
    gyro = log.select(*(f"GYRO_{axis}" for axis in range(3))).to_numpy()
    for chip in ("BMI160", "ADXL355"):
        accel = log.select(*(f"ACCEL_{chip}_{axis}" for axis in range(3))).to_numpy()
        yield case(source, chip, chip, time, accel, gyro, "icosahedron by hand")


def ln100(source: Source) -> Iterator[Case]:
    """Two rests, X up and down: too little for any nine parameters; a program must say so."""
    for device in ("ln100", "adi"):
        logs = [pl.read_csv(data_folder() / source.name / f"{device}_x_{side}.csv") for side in ("up", "down")]
        up, down = sorted(logs, key=lambda one: float(one["t"][0]))
        if float(down["t"][0]) <= float(up["t"][-1]):  # stamps that start again: recorded one after the other
            down = down.with_columns(pl.col("t") + float(up["t"][-1]) - float(down["t"][0]) + 30.0)
        log = pl.concat([up, down])
        accel = log.select("acc_x", "acc_y", "acc_z").to_numpy().astype(float)
        gyro = log.select("gyr_x", "gyr_y", "gyr_z").to_numpy().astype(float) * DEGREE
        yield case(source, device, device, log["t"].to_numpy(), accel, gyro, "one axis up and down")


def mpu9150(source: Source) -> Iterator[Case]:
    """Five devices, m/s² and rad/s at 100 Hz, without stamps."""
    for number, file in enumerate(source.files, start=1):
        log = np.loadtxt(place_of(source, file))
        time = np.arange(1, len(log) + 1) / 100.0
        yield case(source, f"device {number}", f"device {number}", time, log[:, :3], log[:, 3:6], "by hand")


def kim(source: Source) -> Iterator[Case]:
    """Three recordings of one device; the author states gravity."""
    for number, file in enumerate(source.files, start=1):
        log = np.loadtxt(place_of(source, file))
        log = log[np.concatenate([[True], np.diff(log[:, 0]) > 0.0])]
        one = case(source, f"recording {number}", "", log[:, 0], log[:, 1:4], log[:, 4:7], "by hand")
        yield replace(one, gravity=9.79871, latitude=37.46 * DEGREE)


def suarez(source: Source) -> Iterator[Case]:
    """Counts of an MPU-6050 (16384 per g, 131 per °/s) at 100 Hz, without stamps."""
    (file,) = source.files
    log = np.loadtxt(place_of(source, file), delimiter=",", skiprows=5)
    time, gyro = np.arange(1, len(log) + 1) / 100.0, log[:, 3:6] / 131.0 * DEGREE
    yield case(source, "", "", time, log[:, :3] / 16384.0 * G0, gyro, "by hand")


def mascia(source: Source) -> Iterator[Case]:
    """Accelerometers alone, m/s², 1200 Hz."""
    (file,) = source.files
    accel = loadmat(place_of(source, file))["static_acc"]
    yield case(source, "", "", np.arange(1, len(accel) + 1) / 1200.0, accel, None, "accelerometers by hand")


def wrona(source: Source) -> Iterator[Case]:
    """Readings in g, a row a position."""
    (file,) = source.files
    yield table_of(source, "", np.loadtxt(place_of(source, file)))


def rohac(source: Source) -> Iterator[Case]:
    """Mean readings of 10 s in g; the 24 positions are among the 49."""
    for file in source.files:
        readings = loadmat(place_of(source, file))["ACC_meas"].T
        yield table_of(source, f"{len(readings)} positions", readings)


def table_of(source: Source, part: str, readings: Array) -> Case:
    """A table of readings in g."""
    time = np.arange(1.0, len(readings) + 1.0)
    return replace(case(source, part, "", time, readings * G0, None, "table of readings"), table=True)


def simulated_by_others(source: Source) -> Iterator[Case]:
    """Sessions that others have simulated, with what they put in."""
    folder = data_folder() / source.name
    (file,) = folder.glob("log.*")
    log = pl.read_parquet(file) if file.suffix == ".parquet" else pl.read_csv(file)
    if source.name == "psins-systematic":
        time = np.arange(1, len(log) + 1) / 100.0  # its stamps are 32-bit numbers
        accel = 100.0 * log.select("dv_x", "dv_y", "dv_z").to_numpy().astype(float)
        gyro = 100.0 * log.select("dtheta_x", "dtheta_y", "dtheta_z").to_numpy().astype(float)
        s2 = np.sin(34.0 * DEGREE) ** 2
        gravity = PSINS_G * (1.0 + 5.27094e-3 * s2 + 2.32718e-5 * s2**2)
        place, truth = (34.0, gravity), psins_truth()
    else:
        time, accel, gyro = (log.select(*names).to_numpy() for names in ("t", ("ax", "ay", "az"), ("gx", "gy", "gz")))
        time, site = time[:, 0], tomllib.loads((folder / "session.toml").read_text())["site"]
        place = site["latitude_deg"], site["gravity"]
        truth = {name: v for name, v in json.loads((folder / "truth.json").read_text()).items() if name in NAMES}
    one = case(source, "", "", time, accel, gyro, "simulated by others")
    programme = "rough-table" if source.name == "truth-turntable" else None
    yield replace(
        one, latitude=place[0] * DEGREE, gravity=place[1], gravity_u=1e-6, truth=truth, programme=programme,
        clock_ppm_u=0.0,
    )  # fmt: skip


PSINS_G = 9.7803267715


def psins_truth() -> dict[str, float]:
    """What PSINS put in, with the signs of a reading's errors: its numbers are corrections, but for angles. Scale
    factors are lengths of rows here, diagonals there."""
    second, truth = DEGREE / 3600.0, dict[str, float]()
    for number, axis in enumerate("xyz", start=1):
        truth[f"gyro.bias.{axis}"], truth[f"gyro.scale.{axis}"] = -0.1 * number * second, -10e-6 * number
        truth[f"accel.bias.{axis}"], truth[f"accel.scale.{axis}"] = -10e-6 * PSINS_G * number, -10e-6 * number
    angles = {"accel": {"yx": 10, "zx": 20, "zy": 30}}
    angles["gyro"] = {"xy": 10, "xz": 20, "yx": 30, "yz": 40, "zx": 50, "zy": 60}
    for kind, by_pair in angles.items():
        for pair, size in by_pair.items():
            truth[f"{kind}.axis.{pair}"] = size * second
            truth[f"{kind}.scale.{pair[0]}"] += 0.5 * (size * second) ** 2
    return truth


READERS: dict[str, Callable[[Source], Iterator[Case]]] = {
    "xsens-mti": xsens, "imucal-ferraris": imucal, "mimu4444": mimu, "openaxes-imu9": openaxes, "ln100-updown": ln100,
    "mpu9150": mpu9150, "kim": kim, "suarez": suarez, "mascia": mascia, "wrona": wrona, "rohac": rohac,
    **dict.fromkeys(SIMULATED, simulated_by_others),
}  # fmt: skip


def cases(*names: str) -> Iterator[Case]:
    """The cases of these sources, or of all, that are there."""
    for name in names or READERS:
        source = named(name)
        try:
            yield from READERS[name](source)
        except FileNotFoundError:
            continue


def missing() -> list[str]:
    """The names of the sources of which a file is not there."""
    folder = data_folder()
    return [
        name
        for name in READERS
        if not all(place_of(named(name), file).exists() for file in named(name).files)
        or not (named(name).files or (folder / name).is_dir())
    ]
