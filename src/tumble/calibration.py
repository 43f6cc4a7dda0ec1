"""The calibration: from a session to parameters with uncertainty, and the file that keeps them.

`calibrate` is the main job. The file is JSON as the contract of the project defines it: parameters in SI and radians
with standard uncertainties and covariance, the matrices and biases that apply them, the outcome with its reasons,
and where it all came from. It is written whole or not at all.
"""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from tumble import __version__
from tumble.diagnose import no_rests, recording_faults, sense_faults, verdict
from tumble.errors import CalibrationError, InputError
from tumble.estimate import Estimate, Fit, Outcome
from tumble.log import Chunk, Log, open_log
from tumble.match import Match, match_rests
from tumble.methods.scalar import scalar
from tumble.methods.sequential import sequential
from tumble.methods.staged import staged
from tumble.model import SensorModel
from tumble.observe import Observations, observe
from tumble.segment import Segmentation, find_rests, reduce_log
from tumble.session import Session, read_session
from tumble.units import Array

FORMAT = 1
DEFAULT_METHOD = "staged"
METHODS: Mapping[str, Callable[[Observations], Estimate]] = {"staged": staged}
ITERATED_METHODS: Mapping[str, Callable[[Observations, int], Estimate]] = {"sequential": sequential, "scalar": scalar}
"""The pipelines of the paper, which take a number of iterations."""
Progress = Callable[[Log], Iterable[Chunk]]


@dataclass(frozen=True, kw_only=True, slots=True)
class Parameter:
    """A named quantity with its standard uncertainty (None where the method gives none), SI; where the session names a
    systematic (passport) calibration, with the deviation from it; for the mean of several launches with the standard
    deviation from launch to launch."""

    name: str
    value: float
    u: float | None
    unit: str
    deviation: float | None = None
    run_to_run: float | None = None


@dataclass(frozen=True, kw_only=True, slots=True)
class RestResult:
    """A rest as used: times (s), residual |corrected reading| − g (m/s²) and how many sigmas it is from the fit."""

    file: int
    start: float
    stop: float
    residual: float
    sigmas: float


@dataclass(frozen=True, kw_only=True, slots=True)
class Launch:
    """One of several sessions behind a calibration."""

    session: str
    parameters: tuple[Parameter, ...]
    covariance: Array | None
    log_sha256: str


@dataclass(frozen=True, kw_only=True, slots=True)
class Calibration:
    """The result for one device. `covariance` is in the order of `parameters`; `accel` and `gyro` are None where
    a parameter they need is unobservable. `fits` are chi-square, degrees of freedom and estimated scatter."""

    serial: str
    model: str | None
    method: str
    frame: str
    parameters: tuple[Parameter, ...]
    covariance: Array | None
    accel: SensorModel | None
    gyro: SensorModel | None
    outcome: Outcome
    iterations: tuple[Mapping[str, float], ...] = ()
    rests: tuple[RestResult, ...] = ()
    turn_sigmas: tuple[float, ...] = ()
    fits: Mapping[str, Fit] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    launches: tuple[Launch, ...] = ()
    provenance: Mapping[str, str] = field(default_factory=dict)

    def __getitem__(self, name: str) -> Parameter:
        """The parameter of that name."""
        for parameter in self.parameters:
            if parameter.name == name:
                return parameter
        raise KeyError(f"no parameter {name!r}; there are {', '.join(p.name for p in self.parameters)}")

    def write(self, path: Path, *, force: bool = False) -> None:
        """Write the calibration file, whole or not at all. An existing file is replaced only if it came from the
        same log by the same method, or with `force`."""
        if path.exists():
            if not os.access(path, os.W_OK):
                raise CalibrationError(f"{path}: cannot be replaced: it is read-only; choose another --out")
            if not force:
                self._check_replaceable(path)
        text = json.dumps(self._content(), indent=1, ensure_ascii=False, allow_nan=False)
        _write_whole(path, text + "\n")

    def _check_replaceable(self, path: Path) -> None:
        advice = "give --force to replace it, or --out for another file"
        try:
            old = json.loads(path.read_text(encoding="utf-8"))
            same = old["method"] == self.method and old["provenance"]["log_sha256"] == self.provenance["log_sha256"]
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise CalibrationError(
                f"{path}: expected a calibration to replace, found another file; {advice}"
            ) from error
        if not same:
            raise CalibrationError(f"{path}: holds a calibration from another log or by another method; {advice}")

    def _content(self) -> dict[str, Any]:
        return {
            "format": FORMAT,
            "device": {"serial": self.serial, "model": self.model},
            "method": self.method,
            "frame": self.frame,
            "parameters": [_parameter_content(p) for p in self.parameters],
            "covariance": None if self.covariance is None else self.covariance.tolist(),
            "accel": _model_content(self.accel, "m/s^2"),
            "gyro": _model_content(self.gyro, "rad/s"),
            "outcome": {
                "accepted": self.outcome.accepted,
                "reasons": list(self.outcome.reasons),
                "unobservable": list(self.outcome.unobservable),
            },
            "iterations": [
                {"parameters": [{"name": n, "increment": v} for n, v in step.items()]} for step in self.iterations
            ],
            "rests": [
                {"file": r.file, "start": r.start, "stop": r.stop, "residual": r.residual, "sigmas": r.sigmas}
                for r in self.rests
            ],
            "turns": [{"sigmas": s} for s in self.turn_sigmas],
            "fits": {
                name: {
                    "chi_square": f.chi_square,
                    "degrees": f.degrees,
                    "probability": f.probability,
                    "scatter": f.scatter,
                    "unit": f.scatter_unit,
                }
                for name, f in self.fits.items()
            },
            "notes": list(self.notes),
            "launches": [
                {
                    "session": launch.session,
                    "parameters": [_parameter_content(p) for p in launch.parameters],
                    "covariance": None if launch.covariance is None else launch.covariance.tolist(),
                    "log_sha256": launch.log_sha256,
                }
                for launch in self.launches
            ],
            "provenance": dict(self.provenance),
        }


def _parameter_content(parameter: Parameter) -> dict[str, Any]:
    content = {"name": parameter.name, "value": parameter.value, "u": parameter.u, "unit": parameter.unit}
    more = {"deviation": parameter.deviation, "run_to_run": parameter.run_to_run}
    return content | {key: value for key, value in more.items() if value is not None}


def _model_content(model: SensorModel | None, unit: str) -> dict[str, Any] | None:
    if model is None:
        return None
    return {"matrix": model.matrix.tolist(), "bias": model.bias.tolist(), "unit": unit}


def _write_whole(path: Path, text: str) -> None:
    """Write a file so that a reader sees the old one or the new one."""
    try:
        descriptor, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
        temporary = Path(name)
        try:
            with os.fdopen(descriptor, "w", encoding="utf-8") as file:
                file.write(text)
                file.flush()
                os.fsync(file.fileno())
            temporary.chmod(0o666 & ~_umask())
            temporary.replace(path)
        except BaseException:
            temporary.unlink()
            raise
    except OSError as error:
        raise CalibrationError(f"{path}: cannot be written: {error.strerror}; choose another --out") from error


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def read_calibration(path: Path) -> Calibration:
    """A calibration file as written by `Calibration.write`."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"), parse_constant=_not_a_number)
        if content["format"] != FORMAT:
            raise CalibrationError(f"{path}: expected format {FORMAT}, found {content['format']!r}")
        return _from_content(content)
    except OSError as error:
        raise CalibrationError(f"{path}: cannot be read: {error.strerror}") from error
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        said = f"no key {error}" if isinstance(error, KeyError) else str(error)
        raise CalibrationError(f"{path}: expected a calibration file of tumble, found {said}") from error


def _not_a_number(name: str) -> float:
    raise ValueError(f"{name} in place of a number")


def _from_content(content: Mapping[str, Any]) -> Calibration:
    """A calibration from what the contract promises of a file; further keys may be there or not."""

    def model(part: Mapping[str, Any] | None) -> SensorModel | None:
        if part is None:
            return None
        return SensorModel(matrix=np.array(part["matrix"], float), bias=np.array(part["bias"], float))

    outcome = content["outcome"]
    return Calibration(
        serial=content["device"]["serial"],
        model=content["device"]["model"],
        method=content["method"],
        frame=content["frame"],
        parameters=tuple(map(_parameter, content["parameters"])),
        covariance=_matrix(content["covariance"]),
        accel=model(content["accel"]),
        gyro=model(content["gyro"]),
        outcome=Outcome(reasons=tuple(outcome["reasons"]), unobservable=tuple(outcome.get("unobservable", ()))),
        iterations=tuple({p["name"]: p["increment"] for p in i["parameters"]} for i in content["iterations"]),
        rests=tuple(
            RestResult(
                file=r.get("file", 0),
                start=r["start"],
                stop=r["stop"],
                residual=r["residual"],
                sigmas=r.get("sigmas", 0.0),
            )
            for r in content["rests"]
        ),
        turn_sigmas=tuple(t["sigmas"] for t in content.get("turns", ())),
        fits={
            name: Fit(chi_square=f["chi_square"], degrees=f["degrees"], scatter=f["scatter"], scatter_unit=f["unit"])
            for name, f in content.get("fits", {}).items()
        },
        notes=tuple(content.get("notes", ())),
        launches=tuple(
            Launch(
                session=launch["session"],
                parameters=tuple(map(_parameter, launch["parameters"])),
                covariance=_matrix(launch["covariance"]),
                log_sha256=launch.get("log_sha256", ""),
            )
            for launch in content.get("launches", ())
        ),
        provenance=content["provenance"],
    )


def _parameter(content: Mapping[str, Any]) -> Parameter:
    def number(key: str) -> float | None:
        return None if content.get(key) is None else float(content[key])

    return Parameter(
        name=content["name"],
        value=float(content["value"]),
        u=number("u"),
        unit=content["unit"],
        deviation=number("deviation"),
        run_to_run=number("run_to_run"),
    )


def _matrix(rows: list[list[float]] | None) -> Array | None:
    return None if rows is None else np.array(rows, dtype=float)


# From a session to a calibration


def calibrate(
    session: Session | Path,
    *,
    method: str = DEFAULT_METHOD,
    iterations: int | None = None,
    progress: Progress = Log.chunks,
) -> Calibration:
    """Calibrate the device of a session (a `Session` or the path of its folder). `iterations` is for the methods that
    iterate as the paper does (default 2). A recording that cannot be calibrated comes back with the reasons in its
    outcome; unusable input raises an `InputError`."""
    if isinstance(session, Path):
        session = read_session(session)
    estimator = _estimator(method, iterations)
    systematic = _systematic(session)
    log = open_log(session)
    with ThreadPoolExecutor(max_workers=1) as beside:
        digest = beside.submit(log.sha256)
        found = _estimated(session, log, estimator, systematic, progress)
        provenance = _provenance(digest.result())
    if isinstance(found, Outcome):
        return _without_result(session, log, method, found, provenance)
    return _result(session, log, *found, systematic, provenance)


def _estimator(method: str, iterations: int | None) -> Callable[[Observations], Estimate]:
    """The function of a method's name."""
    if method in ITERATED_METHODS:
        iterated = ITERATED_METHODS[method]
        return lambda observations: iterated(observations, 2 if iterations is None else iterations)
    if method not in METHODS:
        known = ", ".join([*METHODS, *ITERATED_METHODS])
        raise InputError(f"method: expected one of {known}, found {method!r}")
    if iterations is not None:
        raise InputError(
            f"iterations: expected none with the method {method!r}, which iterates until nothing changes, found "
            f"{iterations}; only {' and '.join(ITERATED_METHODS)} take a number"
        )
    return METHODS[method]


def _systematic(session: Session) -> Mapping[str, float]:
    """Values of the systematic (passport) calibration a session names, by parameter name."""
    if session.device.systematic is None:
        return {}
    passport = read_calibration(session.device.systematic)
    if passport.frame != "accelerometer":
        raise CalibrationError(
            f"{session.device.systematic}: expected a calibration in the frame 'accelerometer', found "
            f"{passport.frame!r}; "
            "calibrate without --frame to get one"
        )
    return {p.name: p.value for p in passport.parameters}


def _estimated(
    session: Session,
    log: Log,
    method: Callable[[Observations], Estimate],
    start: Mapping[str, float],
    progress: Progress,
) -> tuple[Estimate, Observations] | Outcome:
    """The estimate and what it was made from, or why there is none."""
    reduction = reduce_log(log, session.accel_block, session.gyro_block, progress(log))
    faults = recording_faults(reduction, session)
    if faults:
        return Outcome(reasons=tuple(faults))
    segmentation = find_rests(reduction, session.accel_block, session.gyro_block)
    found = None
    # where the unit of the gyros makes every turn too slow to be one, the accelerometers still show the rests
    rests = segmentation.rests or find_rests(reduction, session.accel_block, None).rests
    if rests:
        everything = Match(rests=rests, programme=None, position=None)
        with np.errstate(over="ignore", invalid="ignore"):  # in a wrong unit
            found = observe(reduction, everything, session.accel_block, session.gyro_block, session.site)
        faults = sense_faults(found, session, reduction.rate)
        if faults:
            return Outcome(reasons=tuple(faults))
    match = match_rests(session, reduction, segmentation)
    if not match.rests:
        return no_rests(segmentation)
    if found is not None and match.rests == segmentation.rests:
        observations = replace(found, programme=match.programme, position=match.position)
    else:
        observations = observe(reduction, match, session.accel_block, session.gyro_block, session.site)
    observations = replace(observations, start=start)
    try:
        return method(observations), observations
    except np.linalg.LinAlgError as error:
        said = f"the estimate broke down ({error}): the data contradict the model; look at them with `tumble inspect`"
        return Outcome(reasons=(said,))


def inspect_session(
    session: Session, *, progress: Progress = Log.chunks
) -> tuple[Segmentation, Observations | None, list[str]]:
    """The rests and turns of a session as `tumble inspect` shows them, without matching them to a programme, and what
    is wrong with the recording."""
    log = open_log(session)
    reduction = reduce_log(log, session.accel_block, session.gyro_block, progress(log))
    faults = recording_faults(reduction, session)
    with np.errstate(over="ignore", invalid="ignore"):  # in a wrong unit, or of damaged samples
        segmentation = find_rests(reduction, session.accel_block, session.gyro_block)
        if not segmentation.rests:
            return segmentation, None, faults
        match = Match(rests=segmentation.rests, programme=None, position=None)
        found = observe(reduction, match, session.accel_block, session.gyro_block, session.site)
    return segmentation, found, faults or sense_faults(found, session, reduction.rate)


def _provenance(log_sha256: str) -> dict[str, str]:
    return {
        "log_sha256": log_sha256,
        "software": f"tumble {__version__}",
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
    }


def _bridged(log: Log) -> tuple[str, ...]:
    """What was bridged in the log, as notes."""
    return tuple(f"bridged: file {g.file + 1}, row {g.row}, {g.time:.3f} s: {g.what}" for g in log.gaps)


def _unchecked(estimate: Estimate) -> tuple[str, ...]:
    """What no redundancy checks, as notes."""
    fit = estimate.fits["accelerometers"]
    if fit.degrees >= 0.5 or estimate.unobservable:
        return ()
    return ("as many rests as accelerometer parameters: nothing checks the fit, a bad rest would go unnoticed",)


def _without_result(
    session: Session, log: Log, method: str, outcome: Outcome, provenance: Mapping[str, str]
) -> Calibration:
    return Calibration(
        serial=session.device.serial,
        model=session.device.model,
        method=method,
        frame="accelerometer",
        parameters=(),
        covariance=None,
        accel=None,
        gyro=None,
        outcome=outcome,
        notes=_bridged(log),
        provenance=provenance,
    )


def _result(
    session: Session,
    log: Log,
    estimate: Estimate,
    observations: Observations,
    systematic: Mapping[str, float],
    provenance: Mapping[str, str],
) -> Calibration:
    seen = np.flatnonzero(estimate.observable)
    parameters = tuple(
        Parameter(
            name=estimate.names[i],
            value=float(estimate.values[i]),
            u=float(estimate.u[i]),
            unit=estimate.units[i],
            deviation=float(estimate.values[i]) - systematic[estimate.names[i]]
            if estimate.names[i] in systematic
            else None,
        )
        for i in seen
    )
    missing = {name.split(".")[0] for name in estimate.unobservable}
    rests = observations.rests
    return Calibration(
        serial=session.device.serial,
        model=session.device.model,
        method=estimate.method,
        frame="accelerometer",
        parameters=parameters,
        covariance=estimate.covariance[np.ix_(seen, seen)],
        accel=None if "accel" in missing else estimate.accel,
        gyro=None if missing else estimate.gyro,
        outcome=verdict(estimate, observations),
        iterations=tuple({estimate.names[i]: float(step[i]) for i in seen} for step in estimate.increments),
        rests=tuple(
            RestResult(
                file=int(rests.file[i]),
                start=float(rests.start[i]),
                stop=float(rests.stop[i]),
                residual=float(estimate.rest_residual[i]),
                sigmas=float(estimate.rest_sigmas[i]),
            )
            for i in range(len(rests))
        ),
        turn_sigmas=tuple(float(s) for s in estimate.turn_sigmas),
        fits=estimate.fits,
        notes=_bridged(log) + _unchecked(estimate),
        provenance=provenance,
    )
