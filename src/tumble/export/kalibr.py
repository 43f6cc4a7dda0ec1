"""Kalibr and OpenVINS: the file kalibr_imu_chain.yaml of OpenVINS, whose IMU model "kalibr" is that of Kalibr.

    a_m = Ta R_IMUtoACC a + b_a
    w_m = Tw R_IMUtoGYRO w + Tg a + b_g        Ta, Tw lower triangular

so a = R_IMUtoACCᵀ Ta⁻¹ (a_m − b_a) and w = R_IMUtoGYROᵀ Tw⁻¹ (w_m − b_g − Tg a). The accelerometers define the IMU
frame, R_IMUtoACC = 1. With M = L Q, L lower triangular with a positive diagonal and Q a rotation, Ta = L of the
accelerometers, and, of the gyros in the frame Q of the accelerometers, Tw = L and R_IMUtoGYRO = Q. Both matrices are
represented completely. Kalibr calls them M and C_gyro_i.

The noise densities are continuous-time, those of the processes of `tumble noise`.

Source: OpenVINS, documentation and VioManagerOptions; Kalibr, wiki "IMU noise model" and "Multi IMU and IMU intrinsic
calibration"; Rehder et al., Extending Kalibr, ICRA 2016.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tumble.errors import InputError
from tumble.export.exported import Exported, example_line, g_sensitivity, notes_of, origin, shown, triads
from tumble.export.templates import render_layout
from tumble.files import FilePath
from tumble.recording.session import Session
from tumble.recording.session_file import session_from
from tumble.reduction.noise.wavelet_moments import FilterDensities, filter_densities
from tumble.result.calibration import Calibration
from tumble.result.correction import linear_example
from tumble.result.parts import SensorsAtRest
from tumble.run.quiet_samples import longest_rest, noise_panels
from tumble.sensors.model import UNITS
from tumble.units import Array


@dataclass(frozen=True, kw_only=True, slots=True)
class NoiseDensities:
    """Noise densities of both kinds of sensors, the sample rate, Hz, None if it is not known, and their source."""

    accel: FilterDensities
    gyro: FilterDensities
    rate: float | None
    source: str


def noise_densities(session: Session) -> NoiseDensities:
    """Estimate noise densities from the longest rest of a session, as `tumble noise` does.

    Raises InputError without a rest or without gyros."""
    record = longest_rest(session)
    panels = noise_panels([record])
    if len(panels) != 2:
        raise InputError(f"{session.name}: expected accelerometers and gyros to take the noise from, found no gyros")
    accel, gyro = (filter_densities(panel, record.rate) for panel in panels)
    return NoiseDensities(accel=accel, gyro=gyro, rate=record.rate, source=record.source)


DRIFT_VARIANCE = 1.2
"""Variance of the drift within a rest (slope times T) over K² T, for a random walk of the bias: 6/5."""
DRIFT_BOUND = (
    "random walks are the largest that the drifts within the rests allow: record an hour at rest and give it with "
    "--noise"
)


def _noise_of_rests(calibration: Calibration) -> NoiseDensities:
    """Return the median noise density within the rests of a calibration, and the random walk of their drifts.

    Raises InputError for a calibration without rests or gyros."""
    densities, all_rests = [], calibration.evidence.all_rests
    seconds = np.array([rest.stop - rest.start for rest in all_rests])
    for kind in UNITS:
        rests: list[SensorsAtRest | None] = [getattr(rest, kind) for rest in all_rests]
        sensors_at_rest = [sensors for sensors in rests if sensors is not None]
        if not sensors_at_rest or len(sensors_at_rest) < len(rests):
            raise InputError(
                "export to kalibr: expected --noise, found none, nor rests of accelerometers and gyros in the "
                "calibration; give a session of the device"
            )
        white = np.median([sensors.noise for sensors in sensors_at_rest], axis=0).max()
        walks = np.array([sensors.drift for sensors in sensors_at_rest]) ** 2 / (DRIFT_VARIANCE * seconds[:, None])
        walk = float(np.sqrt(walks.mean(axis=0).max()))
        densities.append(FilterDensities(white=float(white), walk=walk, bounds=(DRIFT_BOUND,)))
    source = f"{len(all_rests)} rests of the calibration"
    return NoiseDensities(accel=densities[0], gyro=densities[1], rate=calibration.provenance.sample_rate, source=source)


def kalibr(calibration: Calibration, *, noise: NoiseDensities | Session | FilePath | None = None) -> Exported:
    """Return the file of a calibration of right-handed triads: YAML below the line `%YAML:1.0`, as OpenCV reads it.

    `noise` are noise densities, or a session from whose longest rest they are estimated; default: from the rests of the
    calibration."""
    held = {"gyro.g_sensitivity"}
    by_kind = triads(calibration, "kalibr", held=held)
    if noise is None:
        noise = _noise_of_rests(calibration)
    elif not isinstance(noise, NoiseDensities):
        noise = noise_densities(session_from(noise))
    Ta, to_accel = _lq(by_kind["accel"].matrix, "accelerometers")
    Tw, to_gyro = _lq(by_kind["gyro"].matrix @ to_accel.T, "gyros")
    sensitivity = g_sensitivity(calibration)
    biases = " and ".join(f"{shown(by_kind[kind].bias.round(9))} {unit}" for kind, unit in UNITS.items())
    losses = notes_of(
        calibration,
        corrections={kind: model.apply for kind, model in by_kind.items()},
        held=held,
        lacks=[f"biases, which OpenVINS estimates while it runs: {biases}", "noise of single axes", "uncertainties"],
        see_to=dict.fromkeys([*noise.accel.bounds, *noise.gyro.bounds]),
    )
    worked = {kind: linear_example(kind, model) for kind, model in by_kind.items()}
    is_same_frame = np.allclose(to_accel, np.eye(3), rtol=0.0, atol=1e-12)
    comments = [
        *origin(calibration),
        f"noise from {noise.source}",
        *([] if is_same_frame else [f"IMU frame: rows in the frame of the calibration {shown(to_accel)}"]),
        "set rostopic" if noise.rate is not None else "set rostopic, add update_rate",
        *(example_line(kind, replace(each, true=to_accel @ each.true)) for kind, each in worked.items()),
        *(["the example of the gyros is without acceleration"] if np.any(sensitivity) else []),
        *losses,
    ]
    matrices = {"Tw": Tw, "R_IMUtoGYRO": to_gyro, "Ta": Ta, "R_IMUtoACC": np.eye(3), "Tg": sensitivity @ to_accel.T}
    text = render_layout("kalibr_imu_chain.yaml.j2", comments=comments, noise=noise, matrices=matrices)
    return Exported(content=text.encode(), losses=losses)


def _lq(matrix: Array, kind: str) -> tuple[Array, Array]:
    """Factor M = L Q: L lower triangular with a positive diagonal, Q a rotation."""
    Q, R = np.linalg.qr(matrix.T)
    signs = np.sign(np.diag(R))
    lower, rotation = R.T * signs, signs[:, None] * Q.T
    if np.linalg.det(rotation) < 0.0:
        raise InputError(
            f"export to kalibr: expected right-handed {kind}, found their channels left-handed, which the target has "
            "no place for: name the columns of the session in another order, or with the other sign"
        )
    return np.tril(lower), rotation
