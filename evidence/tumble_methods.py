"""tumble's methods as programs of the benchmark, by the public library alone."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal

import numpy as np

import tumble
from evidence.case import NAMES, Array, Case, Estimate, GaveUpError, Kind, Program

Method = Literal["joint", "ellipsoid", "scalar", "sequential"]
Terms = Literal["full", "linear"]
KINDS: tuple[Kind, ...] = ("accel", "gyro")


def estimate(case: Case, method: Method, terms: Terms = "full") -> Estimate:
    """A session in memory, calibrated as a user would who states what the case states."""
    try:
        found = (
            of_table(case, terms)
            if case.table
            else tumble.calibrate(
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
        )
    except tumble.InputError as error:
        raise GaveUpError(str(error)) from error
    outcome = found.outcome
    if found.accel is None and found.gyro is None:
        raise GaveUpError("; ".join(outcome.reasons))
    given = {name: found[name] for name in NAMES if name in found}
    return Estimate(
        accel=None if found.accel is None else np.asarray(found.accel.matrix),
        accel_bias=None if found.accel is None else np.asarray(found.accel.bias),
        gyro=None if found.gyro is None else np.asarray(found.gyro.matrix),
        gyro_bias=None if found.gyro is None else np.asarray(found.gyro.bias),
        whole_model=partial(corrected, found) if outcome.accepted or any(map(outcome.of, KINDS)) else None,
        u={name: p.u for name, p in given.items() if p.u},
        expanded={name: p.k * p.u for name, p in given.items() if p.u and p.k},
        accepted=outcome.accepted,
        refused=frozenset(kind for kind in KINDS if not outcome.of(kind)),
        verdict="; ".join((outcome.verdict, *outcome.reasons, *outcome.remarks)),
    )


def corrected(found: tumble.Calibration, accel: Array, gyro: Array | None) -> tuple[Array, Array | None]:
    """By the whole model; of gyros only where the calibration has them."""
    return found.apply(accel, None if found.gyro is None else gyro)


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
