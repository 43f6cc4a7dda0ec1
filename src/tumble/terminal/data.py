"""Results as JSON: what the tables of the command line say, in SI and by name, for other programs.

Keys are those of the result's dataclasses and of the calibration file; an angle is in rad, a rate in rad/s, the
temperature of a rest in °C, what is not known is null; `format` is that of the keys. Rests, turns and files are counted
from 0, as in the calibration file.
"""

from __future__ import annotations

import json
import math
from dataclasses import asdict, is_dataclass
from datetime import date
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from tumble.calibration.results import fits_content
from tumble.units import ZERO_CELSIUS

if TYPE_CHECKING:
    from tumble.calibration.calibration_file import Calibration
    from tumble.calibration.check import FieldCheck
    from tumble.calibration.compare import Comparison
    from tumble.calibration.observed import Observed
    from tumble.calibration.quiet_samples import RecordedNoise
    from tumble.calibration.verify import Verification
    from tumble.reduction.observations import Observations


def print_data(content: dict[str, Any]) -> None:
    """Print a result as JSON on standard output, in characters that every terminal has."""
    click.echo(json.dumps({"format": 1} | _plain(content), indent=1, allow_nan=False))


def calibration_data(calibration: Calibration, *others: Calibration) -> dict[str, Any]:
    """The content of the calibration file; those of other methods, where there are any, under `others`."""
    content = calibration.content()
    return content | {"others": [other.content() for other in others]} if others else content


def inspection_data(observed: Observed) -> dict[str, Any]:
    """Rests, turns and what was rejected."""
    found, observations = observed.segmentation, observed.observations
    return {
        "rate": observed.rate,
        "scatter_limit": found.scatter_limit,
        "rate_limit": found.rate_limit,
        "rests": [] if observations is None else _rests(observations),
        "turns": [] if observations is None else _turns(observations),
        "rejected": [asdict(stretch) for stretch in found.rejected],
        "notes": [] if observations is None else list(observations.notes),
        "faults": [*observed.faults, *observed.gyro_faults],
    }


def _rests(observations: Observations) -> list[dict[str, Any]]:
    rests = observations.rests
    force = observations.accel_block.nominal().apply(rests.accel)
    vertical = force / np.linalg.norm(force, axis=1, keepdims=True)
    kinds = ["accel", *(["gyro"] if rests.gyro.shape[1] else [])]
    return [
        {
            "file": rests.file[i],
            "start": rests.start[i],
            "stop": rests.stop[i],
            "vertical": vertical[i],
            "temperature": None if rests.temperature is None else rests.temperature[i] - ZERO_CELSIUS,
        }
        | {
            kind: {
                "mean": getattr(rests, kind)[i],
                "u": np.sqrt(np.diag(getattr(rests, f"{kind}_covariance")[i])),
                "drift": getattr(rests, f"{kind}_drift")[i],
                "noise": getattr(rests, f"{kind}_noise")[i],
            }
            for kind in kinds
        }
        for i in range(len(rests))
    ]


def _turns(observations: Observations) -> list[dict[str, Any]]:
    turns = observations.turns
    if turns is None:
        return []
    return [
        {"first": turns.first[k], "last": turns.last[k], "duration": turns.duration[k], "rotation": turns.C[k]}
        for k in range(len(turns))
    ]


def verification_data(verification: Verification) -> dict[str, Any]:
    """Check positions and the verdict."""
    return {
        "accepted": not verification.reasons,
        "reasons": list(verification.reasons),
        "left_out": verification.left_out,
        "limit": verification.limit,
        "positions": [
            {"label": label, "difference": d, "u": u, "sigmas": s}
            for label, d, u, s in zip(
                verification.labels, verification.difference, verification.u, verification.sigmas, strict=True
            )
        ],
    }


def field_check_data(check: FieldCheck) -> dict[str, Any]:
    """What has changed since a calibration, and what would have been found."""
    result = check.result
    return {
        "valid": check.valid,
        "reasons": list(check.reasons),
        "rests": check.rests,
        "turns": check.turns,
        "changes": [asdict(change) for change in result.changes],
        "parameters": [
            {"name": name, "change": change, "u": u, "detectable": result.detectable[name]}
            for name, (change, u) in result.tests.items()
        ],
        "largest": result.largest,
        "limit": result.limit,
        "misfit": fits_content({"misfit": result.misfit})["misfit"],
        "notes": list(check.notes),
    }


def comparison_data(comparison: Comparison) -> dict[str, Any]:
    """Differences of two calibrations."""
    return {
        "agree": comparison.agree,
        "frame": comparison.frame,
        "parameters": [asdict(d) | {"difference": d.value, "e_n": d.e_n} for d in comparison.differences],
        "covariance": comparison.covariance,
        "chi_square": comparison.chi_square,
        "degrees": comparison.degrees,
        "probability": comparison.probability,
        "largest_by_chance": comparison.largest_by_chance,
        "missing": list(comparison.missing),
        "remarks": list(comparison.remarks),
    }


def noise_data(noise: RecordedNoise) -> dict[str, Any]:
    """Noise coefficients of every channel."""
    return {
        "source": noise.source,
        "rate": noise.rate,
        "channels": [
            {"name": name, "unit": panel.unit, "noise": asdict(parameters)}
            for panel in noise.panels
            for name, parameters in zip(panel.channels, panel.parameters, strict=True)
        ],
    }


def _plain(value: Any) -> Any:
    """A value as JSON has it; numbers that are not finite are null."""
    if isinstance(value, dict):
        return {key: _plain(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(each) for each in value]
    if isinstance(value, np.ndarray | np.generic):
        return _plain(value.tolist())
    if isinstance(value, date):
        return value.isoformat()
    if is_dataclass(value) and not isinstance(value, type):
        return _plain(asdict(value))
    return None if isinstance(value, float) and not math.isfinite(value) else value
