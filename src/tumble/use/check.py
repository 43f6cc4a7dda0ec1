"""The field check: whether a calibration still holds, from a few rests in any attitude, and what has changed.

What is known of the parameters at the check is the calibration, with

    P = Σ + diag(s²),   D = N Σ N + diag(s²/√ν_s),   N = diag(ν^(−1/4))                                         (1)

Σ its covariance, estimated with ν degrees of freedom for each parameter, and s what turning on again changes. That is
√2 times what is usual of the grade, s_g (`tumble.sensors.grades`), where 1/ν_s = 0: a single launch is as far from the
mean of all as the one that is checked. Where launches of the device are known, those behind the calibration and those
behind its other ones in a registry, with the pooled standard deviation s_L of ν_L degrees of freedom, s_g becomes

    s² = max(s_L², [4 s_g² + ν_L s_L²]/(ν_L + 4)),   ν_s = ν_L or ν_L + 4                                         (2)

for two launches that happen to agree do not say that the third will: s_g counts as if it were known by four degrees.
The mean of several launches has its part in Σ, so that it is without the factor √2. D says how well P itself is known,
and with it by how much more than normal numbers the tests exceed a limit. Groups of parameters that the calibration
does not have, and drifts, which belong to a session, are zero with the usual size of the grade. Where the calibration
and the session have temperatures, parameters are taken to that of the session by their slopes and curvatures, with the
usual size of those that are not known. Where both use the same stated gravity, its error is in the scale factors too,
with the opposite sign.

Rests and turns scatter as they did in the calibration, and in-run biases are as large as is usual of the grade.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tumble.brief import Brief
from tumble.errors import CalibrationError, InputError
from tumble.files import FilePath
from tumble.inference.estimate import Outcome
from tumble.inference.hyperparameters import Components
from tumble.inference.prediction import prediction
from tumble.inference.variables import variables_of
from tumble.methods.field_check import ChangedParameter, CheckResult, KnownBefore, field_check
from tumble.planning.bounds import components_of
from tumble.recording.circumstances import Circumstances
from tumble.recording.session import Session, Site
from tumble.recording.session_file import session_from
from tumble.reduction.observations import Observations
from tumble.result.accepted import accepted_accelerometers
from tumble.result.calibration import Calibration, calibration_from
from tumble.result.coverage import by_gravity, shared_gravity
from tumble.result.parts import Parameter
from tumble.run.calibrate import grade_of, provenance_of
from tumble.run.from_estimate import readings_of_session, reference_of, references_of
from tumble.run.observed import inspect_session, observations_for_calibration
from tumble.run.type_spread import KnownLaunches, known_launches
from tumble.sensors.grades import GRADES, TURN_ON, spread_of
from tumble.sensors.instrument import Instrument
from tumble.sensors.parameters import group_of, sensor_kind, shown_in, to_temperature, usual_sizes, variable_of
from tumble.units import Array
from tumble.use.thermometers import check_thermometers

_FITS = {"accel": "accelerometers", "gyro": "gyro rests", "turn": "gyro turns", "velocity": "velocities of turns"}
_RAW = ("count", "V")

USUAL_DEGREES = 4.0
"""Degrees of freedom for which what is usual of a grade counts: it is known to a third."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False, repr=False)
class FieldCheck(Brief):
    """What a session of `rests` rests and `turns` turns says of a calibration: the `result`, in SI, what was supposed,
    in sentences, the calibration in the frame `accelerometer` with the instrument it was taken for, and where, when,
    how and with which sample rate (Hz) the session was recorded."""

    calibration: Calibration
    session: str
    sha256: str
    rests: int
    turns: int
    result: CheckResult
    notes: tuple[str, ...]
    frame: str
    instrument: Instrument
    temperature: float | None
    references: Mapping[str, tuple[float, ...]]
    site: Site
    circumstances: Circumstances
    sample_rate: float
    rests_agree: bool = False
    """Whether the rests alone find nothing changed, where the session as a whole is not explained."""

    @property
    def valid(self) -> bool:
        """Whether the calibration still holds, as far as the session sees."""
        return self.result.valid

    @property
    def reasons(self) -> tuple[str, ...]:
        """What has changed, in sentences; none where the calibration holds."""
        if self.result.explained:
            return tuple(_said(change) for change in self.result.changes)
        fit = self.result.misfit
        turns = (
            "its rests alone agree with the calibration, so that the turns are to blame; " if self.rests_agree else ""
        )
        return (
            f"no change of biases, scale factors or axes explains the session, so that it says nothing of them: "
            f"χ² {fit.chi_square:.1f} for {fit.degrees:.0f}, by chance with probability {fit.probability:.1g}; {turns}"
            "look at it with `tumble inspect`, repeat the check at rest, or calibrate",
        )

    def updated(self) -> Calibration:
        """The calibration with what the check says of the parameters; those that have changed are known by the check
        alone. It says so in its notes. Raises CalibrationError where no change explains the session."""
        if not self.result.explained:
            raise CalibrationError(f"{self.session}: expected a check that is explained, found {self.reasons[-1]}")
        return _updated(self).in_frame(self.frame)


def _said(change: ChangedParameter) -> str:
    size, unit = shown_in(change.name, change.unit, change.value)
    said = f"{change.name} has changed by {change.value / size:+.3g} {unit} (u {change.u / size:.2g} {unit})"
    for name, value in change.others.items():
        other, other_unit = shown_in(name, group_of(name).unit, value)
        said += f", or {name} by {value / other:+.3g} {other_unit}"
    return said


def check_calibration(
    calibration: Calibration | FilePath, session: Session | FilePath, *, launches: Sequence[KnownLaunches] = ()
) -> FieldCheck:
    """Whether a calibration, or that of a file, still holds for its device, by three to five rests in any attitude and
    the turns between them: a `Session` or its folder. With `launches`, as `tumble.device_launches` has them, it is
    judged by how much the device has changed from power-on to power-on in all its calibrations.

    Raises CalibrationError for a calibration that was not accepted, has no uncertainties or is in the frame of the
    case, and InputError for a session of another device or without rests.

    >>> import tumble
    >>> wanted = tumble.Setup.of(grade="mems", positions=18)
    >>> calibration = tumble.calibrate(tumble.simulate_session("calibrated", wanted, seed=1))
    >>> again = tumble.simulate_session("again", tumble.Setup.of(grade="mems", positions=4), seed=1)
    >>> found = tumble.check_calibration(calibration, again)
    >>> found.rests, found.valid
    (4, True)
    """
    given, session = calibration_from(calibration), session_from(session)
    given = accepted_accelerometers(given, "a check has its attitudes")
    _check_given(given, session)
    own = given.in_frame("accelerometer")
    observed = inspect_session(replace(session, programme=None))
    observations = observations_for_calibration(observed)
    if isinstance(observations, Outcome):
        raise InputError(f"{session.name}: expected rests to check with, found {'; '.join(observations.reasons)}")
    observations = _seen_by(own, observations)
    grade, guessed_from = grade_of(session, observations)
    known = known_before(own, observations, grade, session.device.prior, launches)
    result = field_check(observations, known)
    rests_agree = False
    if not result.explained and observations.gyro_block is not None:
        at_rest = observations.of_accelerometers()
        known_at_rest = known_before(own, at_rest, grade, session.device.prior, launches)
        rests_agree = field_check(at_rest, known_at_rest).valid
    return FieldCheck(
        calibration=own,
        session=session.name,
        sha256=observed.sha256,
        rests=len(observations.rests),
        turns=0 if observations.turns is None else len(observations.turns),
        result=result,
        rests_agree=rests_agree,
        notes=_notes(own, observations, (grade, guessed_from), _launches(own, launches)),
        frame=given.frame,
        instrument=known.instrument,
        temperature=reference_of(observations),
        references=references_of(observations),
        site=session.site,
        circumstances=observed.circumstances,
        sample_rate=observed.rate,
    )


def _check_given(calibration: Calibration, session: Session) -> None:
    """A calibration that can be checked, and a session of its device."""
    if calibration.covariance is None:
        raise CalibrationError(f"calibration of {calibration.serial!r}: expected one with uncertainties, found none")
    if session.device.serial != calibration.serial:
        raise InputError(
            f"{session.name}: expected a session of device {calibration.serial!r}, which was calibrated, found "
            f"{session.device.serial!r}"
        )
    blocks = [block for block in (session.accel_block, session.gyro_block) if block is not None]
    for block in blocks:
        model = calibration.accel if block.kind == "accel" else calibration.gyro
        if model is not None and len(model.bias) != block.size:
            raise InputError(
                f"{session.name}: log.{block.kind}: expected the {len(model.bias)} sensors of the calibration, found "
                f"{block.size}"
            )
    check_thermometers(calibration, session)
    for kind, now in readings_of_session(session).items():
        then = calibration.readings.get(kind)
        raw = then is not None and (now.unit in _RAW or then.unit in _RAW)
        if then is not None and raw and (now.scale, now.offset) != (then.scale, then.offset):
            raise InputError(
                f"{session.name}: log.{kind}: expected the nominal scale and offset of the calibration, {then.scale} "
                f"and {then.offset}, found {now.scale} and {now.offset}"
            )


def _seen_by(calibration: Calibration, observations: Observations) -> Observations:
    """The observations of the sensors that the calibration has."""
    with_gyros = calibration.gyro is not None or observations.gyro_block is None
    return observations if with_gyros else observations.of_accelerometers()


def _launches(calibration: Calibration, others: Sequence[KnownLaunches]) -> tuple[KnownLaunches, ...]:
    """The launches behind a calibration and those of other ones of its device, each once."""
    own = known_launches(calibration)
    if own is None:
        return tuple(others)
    return (own, *(each for each in others if not each.logs & own.logs))


def _notes(
    calibration: Calibration, observations: Observations, grade: tuple[str, str], launches: Sequence[KnownLaunches]
) -> tuple[str, ...]:
    """What was supposed."""
    name, guessed_from = grade
    origin = f", guessed from {guessed_from}; [device] grade says another" if guessed_from else ""
    count = sum(each.degrees + 1 for each in launches)
    known = f", or as from launch to launch of {count} launches of the device" if launches else ""
    notes = [
        *calibration.absent,
        f"what turning on again changes: as usual of the grade {name}{known}{origin}; it is allowed for, and "
        "`tumble verify` judges the same session without",
    ]
    then, now = calibration.reference_temperature, reference_of(observations)
    if then is None or now is None:
        notes.append("the temperatures of calibration and check are not both known: no difference is allowed for")
    elif abs(now - then) > 1.0:
        notes.append(f"calibrated at {then:.1f} °C, checked at {now:.1f} °C: parameters by their slopes and curvatures")
    return tuple(notes)


# What was known before


def known_before(
    calibration: Calibration,
    observations: Observations,
    grade: str,
    data_sheet: Mapping[str, float],
    launches: Sequence[KnownLaunches] = (),
) -> KnownBefore:
    """Parameters and covariance at the check by the calibration, in the frame `accelerometer`, Eq. (1), of a device of
    which `launches` of other calibrations are known."""
    usual = usual_sizes(grade, data_sheet)
    blocks = observations.accel_block, observations.gyro_block
    instrument = Instrument.of(*blocks, set(usual), variables_of(observations))
    values, own = _calibrated(calibration, instrument, usual)
    gravity = observations.site.gravity_u
    whole = np.zeros((len(values) + 1,) * 2)
    whole[0, 0], whole[1:, 1:] = gravity**2, own
    root = np.array([0.0, *_inverse_degrees(calibration, instrument)]) ** 0.25
    turned_on, inverse_degrees = _turned_on(calibration, instrument, grade, _launches(calibration, launches))
    if shared_gravity(calibration.site, observations.site):
        change = by_gravity(calibration.parameters, calibration.covariance, calibration.site)
        by_name = {p.name: c for p, c in zip(calibration.parameters, change.tolist(), strict=True)}
        whole[0, 1:] = whole[1:, 0] = gravity * np.array([by_name.get(name, 0.0) for name in instrument.names])
    J = np.eye(len(whole))
    J[1:, 1:] = _to_temperature(calibration, observations, instrument)
    known = J @ whole @ J.T
    return KnownBefore(
        instrument=instrument,
        values=J[1:, 1:] @ values,
        covariance=known + np.diag(np.append(0.0, turned_on)),
        doubt=root[:, None] * known * root + np.diag(np.append(0.0, turned_on * np.sqrt(inverse_degrees))),
        components=_components(calibration, grade),
    )


def _calibrated(calibration: Calibration, instrument: Instrument, usual: Mapping[str, float]) -> tuple[Array, Array]:
    """Values (m,) and covariance (m, m) of an instrument's parameters by the calibration at its own temperature."""
    found = {p.name: i for i, p in enumerate(calibration.parameters) if variable_of(p.name) != "time"}
    missing = [name for name in instrument.names[: instrument.linear_count] if name not in found]
    if missing or calibration.covariance is None:
        raise InputError(
            f"calibration of {calibration.serial!r}: expected the parameters of the session's sensors, found none of "
            f"{', '.join(missing)}; check with recordings of the same device"
        )
    values, covariance = np.zeros(len(instrument.names)), np.zeros((len(instrument.names),) * 2)
    for name, members in instrument.members.items():
        covariance[members, members] = usual[name] ** 2 * np.eye(members.stop - members.start)
    at = [i for i, name in enumerate(instrument.names) if name in found]
    of = [found[instrument.names[i]] for i in at]
    parameters = [calibration.parameters[i] for i in of]
    values[at] = [p.value for p in parameters]
    covariance[np.ix_(at, at)] = calibration.covariance[np.ix_(of, of)]
    return values, covariance


def _inverse_degrees(calibration: Calibration, instrument: Instrument) -> list[float]:
    """1/ν of the calibrated u of an instrument's parameters; 0 where it is known."""
    found = {p.name: 1.0 / p.dof for p in calibration.parameters if p.dof is not None}
    return [found.get(name, 0.0) for name in instrument.names]


def _to_temperature(calibration: Calibration, observations: Observations, instrument: Instrument) -> Array:
    """The matrix (m, m) that takes parameters from the temperature of the calibration to that of the session."""
    now = references_of(observations)
    if calibration.reference_temperature is None or not now:
        return np.eye(len(instrument.names))
    here = replace(calibration, references=now)
    warmer = [here.reference_of(name) - calibration.reference_of(name) for name in instrument.names]
    return to_temperature(instrument.names, np.array(warmer))


def _turned_on(
    calibration: Calibration, instrument: Instrument, grade: str, launches: Sequence[KnownLaunches]
) -> tuple[Array, Array]:
    """Variances (m,) by which parameters change from the calibration to another power-on, and 1/ν of each, Eq. (2)."""
    names = instrument.names[: instrument.linear_count]
    # the values of a single launch are as far from the mean; u of several together has what they change by
    single = len(calibration.launches) < 2 and not calibration.together
    variance, inverse_degrees = np.zeros((2, len(instrument.names)))
    for i, name in enumerate(names):
        usual = spread_of(TURN_ON[grade], name) ** 2
        known = [(each.degrees, each.variances[name][0]) for each in launches if name in each.variances]
        degrees = sum(count for count, _ in known)
        own = sum(count * between for count, between in known) / max(degrees, 1)
        pooled = (USUAL_DEGREES * usual + degrees * own) / (USUAL_DEGREES + degrees)
        variance[i] = max(own, pooled) * (2.0 if single else 1.0)
        if degrees:
            inverse_degrees[i] = 1.0 / degrees if own > pooled else 1.0 / (USUAL_DEGREES + degrees)
    return variance, inverse_degrees


def _components(calibration: Calibration, grade: str) -> Components:
    """The scatter of the rests and turns of the calibration, and the in-run instability of the grade."""
    scatter: dict[str, Any] = {
        name: calibration.fits[fit].scatter for name, fit in _FITS.items() if fit in calibration.fits
    }
    return replace(components_of(GRADES[grade].noise), **scatter)


# The updated calibration


def _updated(check: FieldCheck) -> Calibration:
    """The calibration by the check, at the temperature of the check."""
    before, result, instrument = check.calibration, check.result, check.instrument
    kept = [p for p in before.parameters if variable_of(p.name) != "time" and p.name in instrument.names]
    others = [p for p in before.parameters if sensor_kind(p.name) == "mag"]
    at = [instrument.names.index(p.name) for p in kept]
    u = np.sqrt(np.diag(result.covariance))
    changed = {change.name for change in result.changes}
    parameters = tuple(
        _moved_to(p, float(result.values[i]), float(u[i]), by_check=p.name in changed)
        for p, i in zip(kept, at, strict=True)
    )
    rate = None if before.prediction is None else before.prediction.at_rate
    gyro = instrument.gyro
    known = before.reference_temperature is not None
    return Calibration(
        # the device and its sensors
        serial=before.serial,
        model=before.model,
        axes=before.axes,
        readings=before.readings,
        thermometers=before.thermometers,
        imu=before.imu,
        frame=before.frame,
        # what still rests on the calibration
        absent=before.absent,
        method=before.method,
        outcome=before.outcome,
        fits=before.fits,
        groups=tuple(group for group in before.groups if variable_of(group.name) != "time"),
        mag=before.mag,
        measured_between=before.temperature_range,
        # what the check says
        parameters=(*parameters, *others),
        covariance=_with_others(before, others, result.covariance[np.ix_(at, at)]),
        accel=instrument.model(instrument.accel, result.values),
        gyro=None if gyro is None else instrument.model(gyro, result.values),
        prediction=None
        if before.site is None
        else prediction(instrument, result.values, result.covariance, gravity=before.site.gravity, rate=rate),
        reference_temperature=check.temperature if known else None,
        references=check.references if known else {},
        site=before.site if before.site == check.site else None,
        circumstances=check.circumstances,
        sample_rate=check.sample_rate,
        notes=(_how(check), *before.notes),
        provenance={
            **provenance_of(check.sha256),
            "calibrated_log_sha256": before.provenance.get("log_sha256", "unknown"),
        },
    )


def _moved_to(parameter: Parameter, value: float, u: float, *, by_check: bool) -> Parameter:
    """A parameter after the check; what is of the check alone has no degrees of freedom of the calibration."""
    learned = parameter.learned
    if parameter.prior is not None and learned is not None:
        learned = min(max(1.0 - (u / parameter.prior) ** 2, 0.0), 1.0)
    dof = None if by_check else parameter.dof
    return replace(parameter, value=value, u=u, deviation=None, run_to_run=None, dof=dof, learned=learned)


def _with_others(before: Calibration, others: list[Parameter], covariance: Array) -> Array:
    """The covariance with that of parameters which took no part."""
    assert before.covariance is not None
    index = [i for i, p in enumerate(before.parameters) if p in others]
    apart = np.zeros((len(covariance), len(index)))
    return np.block([[covariance, apart], [apart.T, before.covariance[np.ix_(index, index)]]])


def _how(check: FieldCheck) -> str:
    """How the calibration was updated."""
    changed = "; ".join(check.reasons) or "nothing had changed beyond chance"
    made = check.calibration.provenance.get("created", "an unknown date")
    return (
        f"no calibration of its own: that of {made}, updated by a field check of {check.rests} rests "
        f"({check.session}): {changed}"
    )
