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
from dataclasses import asdict, dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from tumble import __version__
from tumble.case import CaseAlignment, estimate_in
from tumble.diagnose import no_rests, recording_faults, sense_faults, verdict
from tumble.errors import CalibrationError, InputError
from tumble.estimate import Estimate, Fit, Outcome
from tumble.frames import Convention, Frame, Framed, convert, frame_of, triad_axes
from tumble.log import Chunk, Log, open_log
from tumble.match import Match, match_rests
from tumble.methods.ellipsoid import ellipsoid
from tumble.methods.joint import joint
from tumble.methods.magnetometer import NAMES as MAGNETOMETER_NAMES
from tumble.methods.magnetometer import magnetometer
from tumble.methods.scalar import scalar
from tumble.methods.sequential import sequential
from tumble.methods.staged import staged
from tumble.model import Block, SensorModel
from tumble.observe import Observations, observe
from tumble.segment import Segmentation, find_rests, reduce_log
from tumble.session import Channels, Session, Site, read_session
from tumble.units import DEGREE, Array

FORMAT = 1
DEFAULT_METHOD = "staged"
METHODS: Mapping[str, Callable[[Observations], Estimate]] = {"staged": staged, "joint": joint, "ellipsoid": ellipsoid}
ITERATED_METHODS: Mapping[str, Callable[[Observations, int], Estimate]] = {"sequential": sequential, "scalar": scalar}
"""The pipelines of the paper, which take a number of iterations."""
Progress = Callable[[Log], Iterable[Chunk]]
_Value = TypeVar("_Value")


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
class Readings:
    """What the readings of n sensors are: SI = (raw − offset) / scale of the log's columns, for increments divided by
    the interval of the sample. `scale` (n,) and `offset` (n,) are in the log's `unit`."""

    columns: tuple[str, ...]
    unit: str
    increments: bool
    scale: tuple[float, ...]
    offset: tuple[float, ...]


@dataclass(frozen=True, kw_only=True, slots=True)
class SensorsAtRest:
    """Of each of n sensors over a rest, SI: mean reading, density of its noise (unit/√Hz) and drift, its change."""

    mean: tuple[float, ...]
    noise: tuple[float, ...]
    drift: tuple[float, ...]


@dataclass(frozen=True, kw_only=True, slots=True)
class RestResult:
    """A rest as used: times (s), residual |corrected reading| − g (m/s²) and how many sigmas it is from the fit; the
    code of its attitude in the programme, what its sensors read, and the temperature (°C), where there are such."""

    file: int
    start: float
    stop: float
    residual: float
    sigmas: float
    attitude: str | None = None
    accel: SensorsAtRest | None = None
    gyro: SensorsAtRest | None = None
    temperature: float | None = None


@dataclass(frozen=True, kw_only=True, slots=True)
class TurnResult:
    """A turn from one rest to another (from 0) as used: its duration (s), its angle as the calibrated gyros saw it and
    as the programme has it (rad, 0 … π; None where there is none) and how many sigmas it is from the fit."""

    first: int
    last: int
    duration: float
    angle: float | None
    programmed: float | None
    sigmas: float


@dataclass(frozen=True, kw_only=True, slots=True)
class Launch:
    """One of several sessions behind a calibration."""

    session: str
    parameters: tuple[Parameter, ...]
    covariance: Array | None
    log_sha256: str
    site: Site | None = None
    rests: tuple[RestResult, ...] = ()
    turns: tuple[TurnResult, ...] = ()
    fits: Mapping[str, Fit] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True, slots=True)
class Calibration:
    """The result for one device. `covariance` is in the order of `parameters`; `accel` and `gyro` are None where
    a parameter they need is unobservable. `fits` are chi-square, degrees of freedom and estimated scatter; `programme`
    is the name of the programme, `readings` what the readings of "accel" and "gyro" are."""

    serial: str
    model: str | None
    method: str
    frame: str
    parameters: tuple[Parameter, ...]
    covariance: Array | None
    accel: SensorModel | None
    gyro: SensorModel | None
    outcome: Outcome
    mag: SensorModel | None = None
    """The magnetometer, in its own frame, fixed as that of the accelerometers, and in the unit of `mag.bias.x`."""
    iterations: tuple[Mapping[str, float], ...] = ()
    rests: tuple[RestResult, ...] = ()
    turns: tuple[TurnResult, ...] = ()
    fits: Mapping[str, Fit] = field(default_factory=dict)
    site: Site | None = None
    programme: str | None = None
    readings: Mapping[str, Readings] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    launches: tuple[Launch, ...] = ()
    provenance: Mapping[str, str] = field(default_factory=dict)

    def __getitem__(self, name: str) -> Parameter:
        """The parameter of that name."""
        for parameter in self.parameters:
            if parameter.name == name:
                return parameter
        raise KeyError(f"no parameter {name!r}; there are {', '.join(p.name for p in self.parameters)}")

    def apply(self, accel: Array, gyro: Array | None = None, *, dt: Array | None = None) -> tuple[Array, Array | None]:
        """Specific force and angular rate (..., 3), m/s² and rad/s in the calibration's frame, from readings (..., n) in
        SI after nominal scale and offset, of more than three sensors by least squares. With the intervals `dt` (...),
        s, of the samples both are increments, m/s and rad. Without gyro readings the rate is None.

        Raises InputError for another number of sensors than the calibration has."""
        force = corrected(_known(self.accel, "accel", accel), accel, dt)
        return force, None if gyro is None else corrected(_known(self.gyro, "gyro", gyro), gyro, dt)

    def in_frame(self, frame: str) -> Calibration:
        """This calibration of triads in the frame `accelerometer`, `paper` or `symmetric`, with covariance, iterations
        and launches; deviations from a systematic calibration are left out. A magnetometer keeps its own frame.

        Raises CalibrationError for the case, which only the session gives, where a parameter of accelerometers or
        gyros is missing, and for more than three of them."""
        if frame == self.frame:
            return self
        missing = self.outcome.unobservable or (() if self.accel is not None else ("those of accelerometers",))
        if missing:
            raise CalibrationError(f"frame {frame!r}: expected all parameters, found {', '.join(missing)} missing")
        try:
            return _reframed(self, frame_of(frame))
        except InputError as error:
            raise CalibrationError(str(error)) from error

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
            "mag": _model_content(self.mag, self["mag.bias.x"].unit if self.mag is not None else ""),
            "outcome": {
                "accepted": self.outcome.accepted,
                "reasons": list(self.outcome.reasons),
                "unobservable": list(self.outcome.unobservable),
            },
            "iterations": [
                {"parameters": [{"name": n, "increment": v} for n, v in step.items()]} for step in self.iterations
            ],
            "site": None if self.site is None else asdict(self.site),
            "programme": self.programme,
            "readings": {kind: asdict(readings) for kind, readings in self.readings.items()},
            "rests": [asdict(rest) for rest in self.rests],
            "turns": [asdict(turn) for turn in self.turns],
            "fits": _fits_content(self.fits),
            "notes": list(self.notes),
            "launches": [
                {
                    "session": launch.session,
                    "parameters": [_parameter_content(p) for p in launch.parameters],
                    "covariance": None if launch.covariance is None else launch.covariance.tolist(),
                    "log_sha256": launch.log_sha256,
                    "site": None if launch.site is None else asdict(launch.site),
                    "rests": [asdict(rest) for rest in launch.rests],
                    "turns": [asdict(turn) for turn in launch.turns],
                    "fits": _fits_content(launch.fits),
                }
                for launch in self.launches
            ],
            "provenance": dict(self.provenance),
        }


def corrected(model: SensorModel, readings: Array, dt: Array | None = None) -> Array:
    """True vectors (..., 3) of readings (..., n), SI; with the intervals `dt` (...), s, both are increments."""
    if dt is None:
        return model.apply(readings)
    offset = model.bias * np.asarray(dt)[..., None]
    return np.asarray((readings - offset) @ model.inverse().T)


def _known(model: SensorModel | None, kind: str, readings: Array) -> SensorModel:
    """The model of a kind of sensors, if it is there and fits the readings."""
    sensors = 0 if model is None else len(model.bias)
    if model is None or np.shape(readings)[-1:] != (sensors,):
        raise InputError(
            f"{kind} readings: expected {sensors} numbers a sample, one for each sensor of the calibration, found an "
            f"array of shape {np.shape(readings)}"
        )
    return model


def _reframed(calibration: Calibration, frame: Frame) -> Calibration:
    """`Calibration.in_frame` of a complete calibration."""
    assert calibration.accel is not None
    accel = Block(kind="accel", axes=triad_axes(calibration.accel.matrix))
    gyro = None
    if calibration.gyro is not None:
        gyro = Block(kind="gyro", axes=triad_axes(calibration.gyro.matrix))
    own = len([p for p in calibration.parameters if not p.name.startswith("mag")])

    def framed(parameters: tuple[Parameter, ...], covariance: Array | None) -> Framed:
        return convert(
            accel,
            gyro,
            source=frame_of(calibration.frame),
            values=np.array([p.value for p in parameters[:own]]),
            covariance=None if covariance is None else covariance[:own, :own],
            target=frame,
        )

    mean = framed(calibration.parameters, calibration.covariance)
    launches = [framed(launch.parameters, launch.covariance) for launch in calibration.launches]
    spread = np.std([launch.values for launch in launches], axis=0, ddof=1) if launches else None
    steps = [
        mean.jacobian @ [step.get(p.name, 0.0) for p in calibration.parameters[:own]] for step in calibration.iterations
    ]
    return replace(
        calibration,
        frame=frame,
        parameters=_parameters_of(mean, spread) + calibration.parameters[own:],
        covariance=_with_rest(mean, calibration.covariance, own),
        accel=mean.accel,
        gyro=mean.gyro,
        iterations=tuple(dict(zip(mean.names, step.tolist(), strict=True)) for step in steps),
        launches=tuple(
            replace(
                launch,
                parameters=_parameters_of(each, None) + launch.parameters[own:],
                covariance=_with_rest(each, launch.covariance, own),
            )
            for launch, each in zip(calibration.launches, launches, strict=True)
        ),
    )


def _with_rest(framed: Framed, covariance: Array | None, own: int) -> Array | None:
    """The covariance of all parameters, those beyond the first `own` unchanged."""
    if covariance is None:
        return None
    carry = np.zeros((len(framed.names) + len(covariance) - own, len(covariance)))
    carry[: len(framed.names), :own] = framed.jacobian
    carry[len(framed.names) :, own:] = np.eye(len(covariance) - own)
    return np.asarray(carry @ covariance @ carry.T)


def _parameters_of(framed: Framed, spread: Array | None) -> tuple[Parameter, ...]:
    u = None if framed.covariance is None else np.sqrt(np.diag(framed.covariance))
    return tuple(
        Parameter(
            name=name,
            value=float(framed.values[i]),
            u=None if u is None else float(u[i]),
            unit=framed.units[i],
            run_to_run=None if spread is None else float(spread[i]),
        )
        for i, name in enumerate(framed.names)
    )


def _parameter_content(parameter: Parameter) -> dict[str, Any]:
    content = {"name": parameter.name, "value": parameter.value, "u": parameter.u, "unit": parameter.unit}
    more = {"deviation": parameter.deviation, "run_to_run": parameter.run_to_run}
    return content | {key: value for key, value in more.items() if value is not None}


def _fits_content(fits: Mapping[str, Fit]) -> dict[str, Any]:
    return {
        name: {
            "chi_square": f.chi_square,
            "degrees": f.degrees,
            "probability": f.probability,
            "scatter": f.scatter,
            "unit": f.scatter_unit,
        }
        for name, f in fits.items()
    }


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
        matrix, bias = np.array(part["matrix"], float), np.array(part["bias"], float)
        if matrix.shape != (len(bias), 3) or bias.ndim != 1:
            raise ValueError(f"a matrix of shape {matrix.shape} with a bias of shape {bias.shape}")
        return SensorModel(matrix=matrix, bias=bias)

    outcome = content["outcome"]
    parameters = tuple(map(_parameter, content["parameters"]))
    return Calibration(
        serial=_text(content["device"]["serial"]),
        model=_optional(_text, content["device"]["model"]),
        method=_text(content["method"]),
        frame=_text(content["frame"]),
        parameters=parameters,
        covariance=_matrix(content["covariance"], len(parameters)),
        accel=model(content["accel"]),
        gyro=model(content["gyro"]),
        mag=model(content.get("mag")),
        outcome=Outcome(
            reasons=tuple(map(_text, outcome["reasons"])),
            unobservable=tuple(map(_text, outcome.get("unobservable", ()))),
        ),
        iterations=tuple(
            {_text(p["name"]): float(p["increment"]) for p in i["parameters"]} for i in content["iterations"]
        ),
        rests=tuple(map(_rest, content["rests"])),
        turns=tuple(map(_turn, content.get("turns", ()))),
        fits=_fits(content),
        site=_site(content),
        programme=_optional(_text, content.get("programme")),
        readings={kind: _readings(each) for kind, each in content.get("readings", {}).items()},
        notes=tuple(map(_text, content.get("notes", ()))),
        launches=tuple(
            Launch(
                session=_text(launch["session"]),
                parameters=tuple(map(_parameter, launch["parameters"])),
                covariance=_matrix(launch["covariance"], len(launch["parameters"])),
                log_sha256=_text(launch.get("log_sha256", "")),
                site=_site(launch),
                rests=tuple(map(_rest, launch.get("rests", ()))),
                turns=tuple(map(_turn, launch.get("turns", ()))),
                fits=_fits(launch),
            )
            for launch in content.get("launches", ())
        ),
        provenance={_text(key): _text(value) for key, value in content["provenance"].items()},
    )


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise TypeError(f"{value!r} in place of a text")
    return value


def _optional(read: Callable[[Any], _Value], value: Any) -> _Value | None:
    return None if value is None else read(value)


def _parameter(content: Mapping[str, Any]) -> Parameter:
    return Parameter(
        name=_text(content["name"]),
        value=float(content["value"]),
        u=_optional(float, content.get("u")),
        unit=_text(content["unit"]),
        deviation=_optional(float, content.get("deviation")),
        run_to_run=_optional(float, content.get("run_to_run")),
    )


def _rest(content: Mapping[str, Any]) -> RestResult:
    return RestResult(
        file=int(content.get("file", 0)),
        start=float(content["start"]),
        stop=float(content["stop"]),
        residual=float(content["residual"]),
        sigmas=float(content.get("sigmas", 0.0)),
        attitude=_optional(_text, content.get("attitude")),
        accel=_optional(_at_rest, content.get("accel")),
        gyro=_optional(_at_rest, content.get("gyro")),
        temperature=_optional(float, content.get("temperature")),
    )


def _at_rest(content: Mapping[str, Any]) -> SensorsAtRest:
    return SensorsAtRest(**{key: tuple(map(float, content[key])) for key in ("mean", "noise", "drift")})


def _turn(content: Mapping[str, Any]) -> TurnResult:
    return TurnResult(
        first=int(content["first"]),
        last=int(content["last"]),
        duration=float(content["duration"]),
        angle=_optional(float, content["angle"]),
        programmed=_optional(float, content["programmed"]),
        sigmas=float(content["sigmas"]),
    )


def _fits(content: Mapping[str, Any]) -> dict[str, Fit]:
    return {
        name: Fit(
            chi_square=float(f["chi_square"]),
            degrees=float(f["degrees"]),
            scatter=float(f["scatter"]),
            scatter_unit=_text(f["unit"]),
        )
        for name, f in content.get("fits", {}).items()
    }


def _site(content: Mapping[str, Any]) -> Site | None:
    site = content.get("site")
    if site is None:
        return None
    return Site(
        latitude=_optional(float, site["latitude"]),
        height=float(site["height"]),
        gravity=float(site["gravity"]),
        gravity_u=float(site["gravity_u"]),
        field=_optional(float, site.get("field")),
    )


def _readings(content: Mapping[str, Any]) -> Readings:
    return Readings(
        columns=tuple(map(_text, content["columns"])),
        unit=_text(content["unit"]),
        increments=bool(content["increments"]),
        scale=tuple(map(float, content["scale"])),
        offset=tuple(map(float, content["offset"])),
    )


def _matrix(rows: list[list[float]] | None, size: int) -> Array | None:
    if rows is None:
        return None
    matrix = np.array(rows, dtype=float)
    if matrix.shape != (size, size) and not size == matrix.size == 0:
        raise ValueError(f"a covariance of shape {matrix.shape} for {size} parameters")
    return matrix.reshape(size, size)


# From a session to a calibration


def calibrate(
    session: Session | Path,
    *,
    method: str = DEFAULT_METHOD,
    iterations: int | None = None,
    frame: Frame = "accelerometer",
    progress: Progress = Log.chunks,
) -> Calibration:
    """Calibrate the device of a session (a `Session` or the path of its folder). `iterations` is for the methods that
    iterate as the paper does (default 2). The result is given in `frame` (see `frames`). A recording that cannot be
    calibrated comes back with the reasons in its outcome; unusable input raises an `InputError`."""
    if isinstance(session, Path):
        session = read_session(session)
    estimator = _estimator(method, iterations)
    Convention(frame=frame, block=session.accel_block)
    systematic = _systematic(session)
    log = open_log(session)
    with ThreadPoolExecutor(max_workers=1) as beside:
        digest = beside.submit(log.sha256)
        found = _estimated(session, log, estimator, systematic, progress)
        provenance = _provenance(digest.result())
    if isinstance(found, Outcome):
        return _without_result(session, log, method, found, provenance)
    return _with_magnetometer(_result(session, log, *found, systematic, frame, provenance), session, found[1])


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
        site=session.site,
        readings=_readings_of(session),
        notes=_bridged(log),
        provenance=provenance,
    )


def _readings_of(session: Session) -> dict[str, Readings]:
    """What the readings of a session are."""
    given = {"accel": session.log.accel, "gyro": session.log.gyro}
    readings = {kind: _readings_in(channels) for kind, channels in given.items() if channels is not None}
    mag, ones, zeros = session.log.magnetometer, (1.0, 1.0, 1.0), (0.0, 0.0, 0.0)
    if mag is not None:
        readings["mag"] = Readings(columns=mag.columns, unit=mag.unit, increments=False, scale=ones, offset=zeros)
    return readings


def _readings_in(channels: Channels) -> Readings:
    return Readings(
        columns=channels.columns,
        unit=channels.unit_name,
        increments=channels.unit.kind == "increment",
        scale=tuple((channels.scale / channels.unit.factor).tolist()),
        offset=tuple(channels.offset.tolist()),
    )


def _rest_results(estimate: Estimate, observations: Observations) -> tuple[RestResult, ...]:
    rests = observations.rests
    return tuple(
        RestResult(
            file=int(rests.file[i]),
            start=float(rests.start[i]),
            stop=float(rests.stop[i]),
            residual=float(estimate.rest_residual[i]),
            sigmas=float(estimate.rest_sigmas[i]),
            attitude=_attitude(observations, i),
            accel=_sensors_at_rest(rests.accel[i], rests.accel_noise[i], rests.accel_drift[i]),
            gyro=_sensors_at_rest(rests.gyro[i], rests.gyro_noise[i], rests.gyro_drift[i]),
            temperature=None if rests.temperature is None else float(rests.temperature[i]),
        )
        for i in range(len(rests))
    )


def _attitude(observations: Observations, rest: int) -> str | None:
    if observations.programme is None or observations.position is None:
        return None
    return observations.programme.positions[int(observations.position[rest])].attitude


def _sensors_at_rest(mean: Array, noise: Array, drift: Array) -> SensorsAtRest | None:
    if len(mean) == 0:
        return None
    return SensorsAtRest(mean=tuple(mean.tolist()), noise=tuple(noise.tolist()), drift=tuple(drift.tolist()))


def _turn_results(estimate: Estimate, observations: Observations) -> tuple[TurnResult, ...]:
    if observations.turns is None or not len(estimate.turn_sigmas):
        return ()
    turns = observations.turns if estimate.gyro is None else observations.turns_about(estimate.gyro)
    angles = np.arccos(np.clip(0.5 * (np.trace(turns.C, axis1=1, axis2=2) - 1.0), -1.0, 1.0))
    return tuple(
        TurnResult(
            first=int(turns.first[k]),
            last=int(turns.last[k]),
            duration=float(turns.duration[k]),
            angle=None if estimate.gyro is None else float(angles[k]),
            programmed=_programmed_angle(observations, int(turns.first[k]), int(turns.last[k])),
            sigmas=float(estimate.turn_sigmas[k]),
        )
        for k in range(len(turns))
    )


def _programmed_angle(observations: Observations, first: int, last: int) -> float | None:
    """Angle (rad, not negative) of the programme's turn from one rest to the next."""
    if observations.programme is None or observations.position is None or not observations.programme.ordered:
        return None
    before, after = int(observations.position[first]), int(observations.position[last])
    angle = observations.programme.moves[before].angle if after == before + 1 else None
    return None if angle is None else abs(angle)


def _result(
    session: Session,
    log: Log,
    estimate: Estimate,
    observations: Observations,
    systematic: Mapping[str, float],
    frame: Frame,
    provenance: Mapping[str, str],
) -> Calibration:
    outcome = verdict(estimate, observations)
    rests, turns = _rest_results(estimate, observations), _turn_results(estimate, observations)
    complete = bool(estimate.observable[: len(observations.accel_block.names)].all())
    estimate, case = estimate_in(frame, estimate, observations)
    systematic = _systematic_in(frame, systematic, observations, estimate.gyro is not None, case)
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
    return Calibration(
        serial=session.device.serial,
        model=session.device.model,
        method=estimate.method,
        frame=frame if complete else "accelerometer",
        parameters=parameters,
        covariance=estimate.covariance[np.ix_(seen, seen)],
        accel=None if "accel" in missing else estimate.accel,
        gyro=None if missing else estimate.gyro,
        outcome=outcome,
        iterations=tuple({estimate.names[i]: float(step[i]) for i in seen} for step in estimate.increments),
        rests=rests,
        turns=turns,
        fits=estimate.fits,
        site=observations.site,
        programme=None if observations.programme is None else observations.programme.name,
        readings=_readings_of(session),
        notes=_bridged(log) + _unchecked(estimate) + _aligned(case),
        provenance=provenance,
    )


def _with_magnetometer(calibration: Calibration, session: Session, observations: Observations) -> Calibration:
    """A calibration with the parameters of the session's magnetometer, where it has one."""
    spec = session.log.magnetometer
    if spec is None:
        return calibration
    found, outcome = magnetometer(observations, spec.unit), calibration.outcome
    missing = MAGNETOMETER_NAMES if found.values is None else ()
    parameters, covariance = calibration.parameters, calibration.covariance
    if found.values is not None and found.covariance is not None and covariance is not None:
        u, units = np.sqrt(np.diag(found.covariance)), (spec.unit,) * 3 + ("1",) * 3 + ("rad",) * 3
        parameters += tuple(
            Parameter(name=name, value=float(value), u=float(each), unit=unit)
            for name, value, each, unit in zip(MAGNETOMETER_NAMES, found.values, u, units, strict=True)
        )
        apart = np.zeros((len(covariance), 9))
        covariance = np.block([[covariance, apart], [apart.T, found.covariance]])
    return replace(
        calibration,
        parameters=parameters,
        covariance=covariance,
        mag=found.model,
        outcome=Outcome(reasons=outcome.reasons + found.reasons, unobservable=outcome.unobservable + missing),
        fits=dict(calibration.fits) | found.fits,
        notes=calibration.notes + found.notes,
    )


def _systematic_in(
    frame: Frame, systematic: Mapping[str, float], observations: Observations, gyros: bool, case: CaseAlignment | None
) -> Mapping[str, float]:
    """Values of the systematic calibration in another frame; none where it lacks one of them."""
    if frame == "accelerometer":
        return systematic
    accel, gyro = observations.accel_block, observations.gyro_block if gyros else None
    names = accel.names + (() if gyro is None else gyro.names)
    if not set(names) <= set(systematic) or (frame == "case" and case is None):
        return {}
    framed = convert(
        accel,
        gyro,
        source="accelerometer",
        values=np.array([systematic[name] for name in names]),
        covariance=None,
        target=frame,
        alignment=None if case is None else case.alignment,
    )
    return dict(zip(framed.names, framed.values.tolist(), strict=True))


def _aligned(case: CaseAlignment | None) -> tuple[str, ...]:
    """How the case was found, as a note."""
    if case is None:
        return ()
    u = np.sqrt(np.diag(case.alignment.covariance)) / DEGREE
    text = (
        f"case: from {len(case.rests)} rests on its six faces, which scatter by {case.scatter / DEGREE:.2g}° an axis; "
        f"standard uncertainty of its alignment {u[0]:.2g}°, {u[1]:.2g}°, {u[2]:.2g}° about X, Y, Z"
    )
    if not len(case.tilt):
        return (f"{text}; azimuths are not known, so that the tilt of the plate is part of the scatter",)
    lean = np.linalg.norm(case.tilt) / DEGREE
    return (f"{text}; the plate leans by {lean:.2g}° (u {np.linalg.norm(case.tilt_u) / DEGREE:.1g}°)",)
