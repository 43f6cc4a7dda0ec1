"""What makes the readings of a calibrated device wrong: parameters as the calibration knows them, noise, in-run bias,
temperature, the next power-on; and how a reading changes with each parameter in motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tumble.result.calibration import Calibration
from tumble.rotation import skew
from tumble.sensors import grades
from tumble.sensors.instrument import Instrument
from tumble.units import Array
from tumble.use.trajectory import STEP


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class SensorNoise:
    """Of one kind of sensors the density (n,) of the white noise, unit/√Hz, and the standard deviation (n,) and the
    correlation time, s, of the in-run biases."""

    white: Array
    in_run: Array
    time: float


def white_noise(given: Calibration) -> dict[str, Array]:
    """The density (n,) of the white noise of "accel" and "gyro", unit/√Hz, as the rests have it, where they do."""
    white = {}
    for kind in ("accel", "gyro"):
        rests = [sensors.noise for rest in given.rests if (sensors := getattr(rest, kind)) is not None]
        if rests:
            white[kind] = np.sqrt(np.mean(np.square(rests), axis=0))
    return white


def noise_of(given: Calibration, name: str | None) -> tuple[str, list[SensorNoise], list[str]]:
    """The grade, that of this name or the nearest; the noise of accelerometers and gyros, as the rests and the process
    of the biases have it, or where the file has nothing of it as is usual; and remarks on what was taken so."""
    white, remarks = white_noise(given), []
    if name is None:
        assert given.gyro is not None
        accel, gyro = (float(np.mean(white[kind])) if kind in white else None for kind in ("accel", "gyro"))
        largest = float(np.max(np.abs(given.gyro.bias)))
        name = grades.guessed_grade(accel or grades.GRADES["mems"].noise.accel_white, gyro, largest)[0]
        remarks.append(f"before calibration: as is usual for the grade {name}, which the noise is nearest to")
    usual, out = grades.grade(name).noise, []
    times = {h.name: h.value for h in given.hyperparameters}
    for kind, block, densities in (
        ("accel", given.compensator.accel, (usual.accel_white, usual.accel_instability)),
        ("gyro", given.compensator.gyro, (usual.gyro_white, usual.gyro_instability)),
    ):
        assert block is not None
        process = [bias.next_u**2 - bias.u**2 for bias in given.process_bias if bias.name.startswith(kind)]
        if kind not in white or not process:
            remarks.append(
                f"{kind}: noise and in-run bias are those of the grade {name} where the calibration has none"
            )
        in_run = np.full(block.size, densities[1])
        if process:
            in_run[block.channels] = np.sqrt(np.maximum(process, 0.0))
        density = white.get(kind, np.full(block.size, densities[0]))
        out.append(SensorNoise(white=density, in_run=in_run, time=times.get(f"{kind}_time", usual.instability_time)))
    return name, out, remarks


def calibrated(given: Calibration, names: tuple[str, ...], usual: Array) -> tuple[Array, Array]:
    """Covariance (m, m) of the parameters after calibration: its own, with biases as the means of their processes, and
    of those that it does not have the usual one; and that of what another power-on changes."""
    here, after, turned_on = [i for i, name in enumerate(names) if name in given], usual.copy(), np.zeros_like(usual)
    after[np.ix_(here, here)] = given.covariance_of([names[i] for i in here])
    for bias in given.process_bias:
        i = names.index(bias.name)
        after[i, i] = max(after[i, i], bias.u**2)
    turned_on[here, here] = [(given[names[i]].run_to_run or 0.0) ** 2 for i in here]
    return after, turned_on


def derivative(instrument: Instrument, values: Array, warmer: float) -> Array:
    """∂K/∂θ (n, 15, m) of accelerometers and gyros about the calibration, of slopes, curvatures and hysteresis that of
    the parameters which they change, at a temperature so many K from the reference."""
    D = instrument.linearised(values)[1].copy()
    by = {"temperature": warmer, "temperature²": warmer**2, "hysteresis": float(warmer != 0.0)}
    for own, base, variable in instrument.changes:
        D[:, :, own] = by[variable] * D[:, :, base]
    return D


def in_motion(instrument: Instrument, force: Array, rate: Array) -> Array:
    """∂y/∂θ (K, n, m) of lever arms and delays: an accelerometer with axis a at l feels a · (ω̇ × l + ω × (ω × l)),
    one that is late by τ feels -a · ḟ τ."""
    accel, m = instrument.accel, len(instrument.names)
    out = np.zeros((len(force), accel.size + (0 if instrument.gyro is None else instrument.gyro.size), m))
    late = -np.gradient(force, STEP, axis=0) @ accel.axes.T
    about = skew(np.gradient(rate, STEP, axis=0)) + skew(rate) @ skew(rate)
    levers, delay, single = (instrument.in_motion(motion) for motion in ("lever", "delay", "single delay"))
    if delay is not None:
        out[:, : accel.size, delay.start] = late
    for j, p in enumerate(accel.channels[:-1].tolist()):
        if single is not None:
            out[:, p, single.start + j] = late[:, p]
        if levers is not None:
            out[:, p, levers.start + 3 * j : levers.start + 3 * j + 3] = accel.axes[p] @ about
    return out
