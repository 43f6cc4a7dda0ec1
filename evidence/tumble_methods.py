"""tumble's methods as programs of the benchmark, by the public library alone."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal

import numpy as np
import polars as pl

import tumble
from evidence.case import MAG_NAMES, NAMES, Array, Case, Estimate, GaveUpError, Kind, Program

Method = Literal["joint", "ellipsoid", "scalar", "sequential"]
Terms = Literal["full", "linear"]
KINDS: tuple[Kind, ...] = ("accel", "gyro")


def estimate(case: Case, method: Method, terms: Terms = "full") -> Estimate:
    """A session in memory, calibrated as a user would who states what the case states."""
    try:
        if case.table:
            found = of_table(case, terms)
        elif not case.accel.shape[1]:
            found = tumble.calibrate(gyro=case.gyro, time=case.time)
        elif case.mag is not None:
            found = of_session(case, method, terms)
        else:
            found = tumble.calibrate(
                accel=case.accel,
                gyro=None if method == "ellipsoid" else case.gyro,
                time=case.time,
                temperature=None if case.temperature is None else case.temperature + 273.15,
                latitude=case.latitude,
                gravity=case.gravity,
                gravity_u=case.gravity_u,
                programme=case.programme,
                clock_ppm_u=case.clock_ppm_u,
                serial=case.device or case.name,
                method=method,
                terms=terms,
            )
    except tumble.InputError as error:
        raise GaveUpError(str(error)) from error
    outcome = found.outcome
    given = {name: found[name] for name in (*NAMES, *MAG_NAMES) if name in found}
    changes, u, expanded = changes_of(found, case.ends) if case.ends else ({}, {}, {})
    if not given and not changes:
        raise GaveUpError("; ".join(outcome.reasons))
    biases = {kind: [found[f"{kind}.bias.{axis}"].value for axis in "xyz"] for kind in ("accel", "gyro", "mag")
              if f"{kind}.bias.x" in found}  # fmt: skip
    return Estimate(
        accel=None if found.accel is None else np.asarray(found.accel.matrix),
        accel_bias=np.array(biases["accel"]) if "accel" in biases else None,
        gyro=None if found.gyro is None else np.asarray(found.gyro.matrix),
        gyro_bias=np.array(biases["gyro"]) if "gyro" in biases else None,
        mag=None if found.mag is None else np.asarray(found.mag.matrix),
        mag_bias=np.array(biases["mag"]) if "mag" in biases else None,
        changes=changes,
        whole_model=partial(corrected, found) if outcome.accepted or any(map(outcome.of, KINDS)) else None,
        u={name: p.u for name, p in given.items() if p.u} | u,
        expanded={name: p.k * p.u for name, p in given.items() if p.u and p.k} | expanded,
        accepted=outcome.accepted,
        refused=frozenset(kind for kind in KINDS if not outcome.of(kind)),
        verdict="; ".join((outcome.verdict, *outcome.reasons, *outcome.remarks)),
    )


def corrected(found: tumble.Calibration, accel: Array, gyro: Array | None) -> tuple[Array, Array | None]:
    """By the whole model; of gyros only where the calibration has them."""
    return found.apply(accel, None if found.gyro is None else gyro)


def of_session(case: Case, method: Method, terms: Terms) -> tumble.Calibration:
    """A session in a folder, which can have a magnetometer."""
    sensors = {"accel": (case.accel, "m/s^2"), "gyro": (case.gyro, "rad/s"), "magnetometer": (case.mag, "uT")}
    there = {name: (read, unit) for name, (read, unit) in sensors.items() if read is not None}
    columns = {f"{name}_{axis}": read[:, i] for name, (read, _) in there.items() for i, axis in enumerate("xyz")}
    site = {"latitude_deg": None if case.latitude is None else float(np.degrees(case.latitude)),
            "gravity": case.gravity, "gravity_u": case.gravity_u, "field": case.mag_field}  # fmt: skip
    content = {
        "format": 1,
        "device": {"serial": case.device or case.name},
        "site": {name: value for name, value in site.items() if value is not None},
        "log": {"file": "log.parquet", "time": "t"}
        | {name: {"columns": [f"{name}_{axis}" for axis in "xyz"], "unit": unit} for name, (_, unit) in there.items()},
    }
    with TemporaryDirectory() as folder:
        pl.DataFrame({"t": case.time, **columns}).write_parquet(Path(folder) / "log.parquet")
        tumble.write_session(folder, content)
        return tumble.calibrate(folder, method=method, terms=terms)


def changes_of(
    found: tumble.Calibration, ends: tuple[float, float, float]
) -> tuple[dict[str, float], dict[str, float], dict[str, float]]:
    """Changes of readings and of biases between temperatures, °C, and u and the half widths of the intervals of those
    of biases, which it states: what scale factors do is in these, not in the changes of readings."""
    changes, u, expanded = dict[str, float](), dict[str, float](), dict[str, float]()
    at = found.reference_temperature
    for kind in KINDS:
        for axis in "xyz":
            terms = {f"{kind}.bias.{axis}.t{power}": power for power in (1, 2, 3)}
            known = {name: power for name, power in terms.items() if name in found}
            if at is None or not known:
                continue
            covariance = found.covariance_of(list(known))
            k = max(found[name].k or 2.0 for name in known)
            for end, celsius in (("low", ends[0]), ("high", ends[2])):
                p = np.array([(celsius - at) ** power - (ends[1] - at) ** power for power in known.values()])
                change = float(p @ [found[name].value for name in known])
                changes |= {f"{kind}.{what}.{axis}.{end}": change for what in ("change", "thermal")}
                u[f"{kind}.thermal.{axis}.{end}"] = float(np.sqrt(p @ covariance @ p))
                expanded[f"{kind}.thermal.{axis}.{end}"] = k * u[f"{kind}.thermal.{axis}.{end}"]
    return changes, u, expanded


def of_table(case: Case, terms: Terms) -> tumble.Calibration:
    """A table of readings, which only the ellipsoid method takes, whatever method is asked for."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "readings.csv"
        np.savetxt(path, case.accel, delimiter=",", header="x,y,z", comments="")
        made = tumble.calibrate_readings(
            path, unit="m/s^2", terms=terms, gravity=case.gravity, gravity_u=case.gravity_u
        )  # fmt: skip
        return made.calibration


def program(method: Method, gyro: bool = True) -> Program:
    """A method as a program."""
    return Program(
        name=f"tumble {method}",
        needs=frozenset({"gyro"}) if gyro else frozenset(),
        estimate=partial(estimate, method=method),
        source="tumble.calibrate",
        ours=True,
    )


PROGRAMS = (program("joint", gyro=False), program("ellipsoid", gyro=False))
