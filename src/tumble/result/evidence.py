"""What stands behind the parameters of a calibration: the evidence for them, and where it comes from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated

from pydantic import AfterValidator, Field

from tumble.inference.estimate import HyperparameterEstimate, Integral, ProcessBias
from tumble.recording.session import UNKNOWN, Circumstances
from tumble.result.parts import (
    LEAST,
    MOST_LAUNCHES,
    MOST_PARAMETERS,
    Fits,
    Increments,
    Launch,
    Member,
    Place,
    Positive,
    Readings,
    Rests,
    Size,
    SourceContributions,
    Turns,
    checked_result,
    checked_sizes,
)


def _check_scales(readings: Readings) -> Readings:
    nonzero = all(abs(scale) >= LEAST for scale in readings.scale)
    if not len(readings.columns) == len(readings.scale) == len(readings.offset) or not nonzero:
        raise ValueError("expected a scale, not zero, and an offset for every column, found others")
    if len(readings.row_u) not in (0, len(readings.columns)):
        raise ValueError("expected row_u for every column or none, found others")
    return readings


_PerParameter, _PerSession = Field(max_length=MOST_PARAMETERS), Field(max_length=MOST_LAUNCHES)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Evidence:
    """Data and fit behind the parameters of a calibration.

    Attributes
    ----------
    rests, turns : tuple
        Rests and turns that were used, with their residuals.
    fits : mapping of str to Fit
        Chi-square, degrees of freedom and estimated scatter by group of residuals.
    hyperparameters : tuple
        Quantities of the noise model that were estimated: scatter, in-run biases, sizes of groups of parameters.
    integral : Integral or None
        How the posterior was integrated over the hyperparameters.
    process_bias : tuple
        Biases as the means of their processes, about which those of the next minutes vary; the parameters are those of
        the session. Empty unless the frame is that of the accelerometers.
    budget : tuple
        Contributions to the u of every parameter by source; empty in a frame other than that of the estimate.
    iterations : tuple of mapping
        Increment of every parameter in each iteration.
    launches : tuple of Launch
        Sessions whose calibrations were averaged.
    together : tuple of Member
        Sessions that were estimated together.
    """

    rests: Rests = ()
    turns: Turns = ()
    fits: Fits = field(default_factory=dict)
    hyperparameters: Annotated[
        tuple[Annotated[HyperparameterEstimate, checked_sizes("value", "low", "high", "usual")], ...], _PerParameter
    ] = ()
    integral: Integral | None = None
    process_bias: Annotated[tuple[Annotated[ProcessBias, checked_sizes("u", "next_u")], ...], _PerParameter] = ()
    budget: Annotated[tuple[Annotated[SourceContributions, checked_sizes("u")], ...], _PerParameter] = ()
    iterations: tuple[Increments, ...] = ()
    launches: Annotated[tuple[Annotated[Launch, AfterValidator(checked_result)], ...], _PerSession] = ()
    together: Annotated[tuple[Member, ...], _PerSession] = ()


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Provenance:
    """Recording, circumstances and software that a calibration comes from.

    Attributes
    ----------
    log_sha256 : str or None
        SHA-256 of the log; of several logs, of the list of theirs.
    software : str or None
        Program and version.
    created : str or None
        Time of computing, ISO 8601.
    prior : str or None
        Devices of the same type whose calibrations served as prior.
    site : Site or None
        Place of the recording.
    sample_rate : float or None
        Samples per second of the recording.
    clock_u : float
        Relative standard uncertainty of the time base, as it is in the scale factors of the gyros.
    circumstances : Circumstances
        Date, operator, equipment and air of the recording.
    programme : str or None
        Name of the programme.
    readings : mapping of str to Readings
        Columns, unit and nominal scale of "accel", "gyro" and "mag".
    notes : tuple of str
        Remarks on the recording and the estimate.
    assumptions : tuple of str
        What was taken for granted of the log and the place, and what to state instead.
    absent : tuple of str
        Sensors of the device that the calibration does not have, and why.
    """

    log_sha256: str | None = None
    software: str | None = None
    created: str | None = None
    prior: str | None = None
    site: Place | None = None
    sample_rate: Positive | None = None
    clock_u: Size = 0.0
    circumstances: Annotated[Circumstances, Field(alias="session")] = UNKNOWN
    programme: str | None = None
    readings: Mapping[str, Annotated[Readings, AfterValidator(_check_scales)]] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    assumptions: tuple[str, ...] = ()
    absent: tuple[str, ...] = ()
