"""Biases of gyros from a log without accelerometers.

Rests are found by the gyros, with a constant vertical in place of the missing accelerometers. At rest a gyro reads its
bias, the component of the Earth's rate Ω along its axis, and G·f of the specific force f; neither direction is known.
With the means of N rests, whose noise is σ_k and whose scatter beyond it is s,

    u² = (s² + mean σ_k²)/N + Ω²/3 + (G g)²                                                                      (1)

where G is the usual g-sensitivity of the grade with the nearest noise. Rests do not determine scale factors or axes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from tumble.advice import Advised
from tumble.earth import EARTH_RATE
from tumble.errors import InputError
from tumble.inference.estimate import Outcome
from tumble.inference.sources import UncertaintyBudget, source
from tumble.recording.log import Log, open_log
from tumble.recording.session import Session
from tumble.reduction.blocks.reducer import reduce_log
from tumble.reduction.noise.coloured_noise import fit_coloured_noise
from tumble.reduction.rests.segmentation import Segmentation, find_rests
from tumble.result.calibration import Calibration
from tumble.result.parts import Evidence
from tumble.result.uncertainty_budget import contributions_of
from tumble.rotation import UP
from tumble.run.from_estimate import assemble, origin_of, parameters_of, readings_of_session
from tumble.run.observed import Progress
from tumble.sensors.grades import GRADES
from tumble.sensors.model import Block, SensorModel
from tumble.sensors.parameters import usual_sizes
from tumble.units import G_STANDARD, Array

WHAT_TO_RECORD = (
    "record the accelerometers beside them, put the device down in nine or more positions (`tumble programme` shows "
    "them), and calibrate that log"
)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class GyroRests:
    """Rests of a log of gyros at a sample `rate`, Hz, whose session has them in place of accelerometers.

    `mean` (N, 3) are the readings at rest, rad/s, and `noise` (N, 3) their standard deviations."""

    session: Session
    segmentation: Segmentation
    rate: float
    sha256: str
    mean: Array
    noise: Array


def gyro_rests(session: Session, progress: Progress = Log.chunks) -> GyroRests:
    """Find the rests of a session in which three gyros take the place of the accelerometers (`gyros_in_place`).

    Raises InputError for another number of gyros, and if nothing rests."""
    if session.accel_block.size != 3:
        raise InputError(
            f"gyro: expected three without accelerometers, found {session.accel_block.size}; give accel=… beside them"
        )
    log, gyro = open_log(session), replace(session.accel_block, kind="gyro")
    up = G_STANDARD * UP
    chunks = (replace(each, gyro=each.accel, accel=np.tile(up, (len(each.time), 1))) for each in progress(log))
    accel = Block(kind="accel", axes=np.eye(3))
    reduction = reduce_log(log, accel, gyro, chunks)
    segmentation = find_rests(reduction, accel, gyro)
    files = reduction.by_file
    # if nothing rests, the limit follows from movement, which no vertical reveals
    moved = session.log.accel.scale_stated and (segmentation.rate_limit or 0.0) > segmentation.tuning.level_drift
    if not segmentation.rests or moved:
        still = segmentation.tuning.rest_seconds
        raise InputError(f"{log.name}: expected gyros that lie still for {still} s or longer, found none that do")
    series = [files[rest.file].gyro.means[rest.first : rest.last] for rest in segmentation.rests]
    noise = fit_coloured_noise(series)
    variance = np.array([np.diag(noise.covariance_of_mean(len(each), i)) for i, each in enumerate(series)])
    return GyroRests(
        session=session,
        segmentation=segmentation,
        rate=reduction.rate,
        sha256=log.sha256(),
        mean=np.array([each.mean(axis=0) for each in series]),
        noise=np.sqrt(variance),
    )


def calibrate_gyros(rests: GyroRests) -> Calibration:
    """Return a calibration with the biases of gyros, Eq. (1). Raises InputError for counts of unknown scale."""
    session, N = rests.session, len(rests.mean)
    if not session.log.accel.scale_stated:
        raise InputError(
            f"{session.device.serial}: expected the unit of the gyros, found none, and it cannot be guessed without "
            "accelerometers; state --gyro-unit deg/s or another; `tumble noise` gives the noise in counts"
        )
    block = replace(session.accel_block, kind="gyro")
    seconds = np.array([rest.stop - rest.start for rest in rests.segmentation.rests])
    white = float(np.median(rests.noise * np.sqrt(seconds)[:, None]))
    grade = min(GRADES, key=lambda name: abs(math.log(max(white, 1e-15) / GRADES[name].noise.gyro_white)))
    by_force = usual_sizes(grade)["gyro.g_sensitivity"]
    noise_variance = (rests.noise**2).mean(axis=0)
    scatter = np.maximum(rests.mean.var(axis=0, ddof=1) - noise_variance, 0.0) if N > 1 else np.zeros(3)
    variances = {  # Eq. (1)
        source("gyro.noise"): noise_variance / N,
        source("gyro.scatter", dof=None if N < 2 else N - 1.0): scatter / N,
        source("earth", EARTH_RATE / math.sqrt(3.0), "rad/s"): np.full(3, EARTH_RATE**2 / 3.0),
        source("prior.gyro.g_sensitivity", by_force, "rad*s/m"): np.full(3, (by_force * G_STANDARD) ** 2),
    }
    budget = UncertaintyBudget(
        sources=tuple(variances), covariances=np.array([np.diag(each) for each in variances.values()])
    )
    names, covariance, bias = block.names[:3], budget.covariances.sum(axis=0), rests.mean.mean(axis=0)
    absent = "gyro.scale, gyro.axis: not shown by gyros alone, taken as 0"
    assumptions = (
        Advised(absent, f"to have them {WHAT_TO_RECORD}"),
        "the directions of the Earth's rate and of gravity are not known: u of gyro.bias includes both, gravity by the "
        f"g-sensitivity usual for the grade {grade}",
        *(f"doubt: {doubt}" for doubt in session.log.doubts),
    )
    provenance = origin_of(rests.sha256) | {
        "site": None,
        "sample_rate": rests.rate,
        "readings": {"gyro": readings_of_session(session)["accel"]},
        "absent": (absent,),
        "assumptions": assumptions,
    }
    return assemble(
        session,
        "rest",
        Outcome(unobservable=block.names[3:]),
        provenance,
        parameters=parameters_of(names, bias, np.sqrt(np.diag(covariance))),
        covariance=covariance,
        gyro=SensorModel(matrix=block.nominal().matrix, bias=bias),
        axes={"gyro": tuple(map(tuple, block.axes.tolist()))},
        evidence=Evidence(budget=contributions_of(budget, names, {"gyro.g_sensitivity": f"guessed grade {grade}"})),
    )
