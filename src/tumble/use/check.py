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
from scipy.linalg import block_diag

from tumble.brief import Brief
from tumble.errors import CalibrationError, InputError
from tumble.files import FilePath
from tumble.inference.estimate import Outcome
from tumble.inference.prediction import prediction
from tumble.inference.variables import variables_of
from tumble.methods.field_check import ChangedParameter, CheckResult, KnownBefore, field_check
from tumble.planning.bounds import components_of
from tumble.recording.session import Circumstances, Session, Site
from tumble.recording.session_file import session_from
from tumble.reduction.observations import Observations
from tumble.result.accepted import accepted_accelerometers
from tumble.result.calibration import Calibration, calibration_from
from tumble.result.correction import reference_of_parameter
from tumble.result.coverage import by_gravity, shared_gravity
from tumble.result.launch_variances import LaunchVariances, launch_variances
from tumble.result.parts import learned_fraction
from tumble.run.calibrate import grade_of, provenance_of
from tumble.run.from_estimate import readings_of_session, reference_of, references_of
from tumble.run.observed import inspect_session, observations_for_calibration
from tumble.sensors.grades import GRADES, TURN_ON, spread_of
from tumble.sensors.instrument import Instrument
from tumble.sensors.parameters import group_of, sensor_kind, shown_in, to_temperature, usual_sizes, variable_of
from tumble.use.verify import check_device

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
            return tuple(change_text(change) for change in self.result.changes)
        fit = self.result.misfit
        agree = "its rests alone agree with the calibration, so that the turns are to blame; "
        turns = agree if self.rests_agree else ""
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
        return _updated(self, self.reasons).in_frame(self.frame)


def change_text(change: ChangedParameter) -> str:
    """That a parameter has changed, by how much, and what would explain as much."""
    (size, unit), value = shown_in(change.name, change.unit, change.value), change.value
    text = f"{change.name} has changed by {value / size:+.3g} {unit} (u {change.u / size:.2g} {unit})"
    for name, value in change.others.items():
        size, unit = shown_in(name, group_of(name).unit, value)
        text += f", or {name} by {value / size:+.3g} {unit}"
    return text


def check_calibration(
    calibration: Calibration | FilePath, session: Session | FilePath, *, launches: Sequence[LaunchVariances] = ()
) -> FieldCheck:
    """Whether a calibration, or that of a file, still holds for its device, by three to five rests in any attitude and
    the turns between them: a `Session` or its folder. With `launches`, as `Registry.launches` has them, it is
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
    check_given(given, session)
    own = given.in_frame("accelerometer")
    observed = inspect_session(replace(session, programme=None))
    observations = observations_for_calibration(observed)
    if isinstance(observations, Outcome):
        raise InputError(f"{session.name}: expected rests to check with, found {'; '.join(observations.reasons)}")
    if own.gyro is None and observations.gyro_block is not None:
        observations = observations.of_accelerometers()
    grade, guessed_from = grade_of(session, observations)
    launches = _launches(own, launches)
    known = known_before(own, observations, grade, session.device.prior, launches)
    result = field_check(observations, known)
    rests_agree = False
    if not result.explained and observations.gyro_block is not None:
        at_rest = observations.of_accelerometers()
        rests_agree = field_check(at_rest, known_before(own, at_rest, grade, session.device.prior, launches)).valid

    # what was supposed
    origin = f", guessed from {guessed_from}; [device] grade says another" if guessed_from else ""
    count = sum(each.degrees + 1 for each in launches)
    of_device = f", or as from launch to launch of {count} launches of the device" if launches else ""
    notes = [
        *own.absent,
        f"what turning on again changes: as usual of the grade {grade}{of_device}{origin}; it is allowed for, and "
        "`tumble verify` judges the same session without",
    ]
    then, now = own.reference_temperature, reference_of(observations)
    if then is None or now is None:
        notes.append("the temperatures of calibration and check are not both known: no difference is allowed for")
    elif abs(now - then) > 1.0:
        notes.append(f"calibrated at {then:.1f} °C, checked at {now:.1f} °C: parameters by their slopes and curvatures")
    return FieldCheck(
        calibration=own,
        session=session.name,
        sha256=observed.sha256,
        rests=len(observations.rests),
        turns=0 if observations.turns is None else len(observations.turns),
        result=result,
        rests_agree=rests_agree,
        notes=tuple(notes),
        frame=given.frame,
        instrument=known.instrument,
        temperature=now,
        references=references_of(observations),
        site=session.site,
        circumstances=observed.circumstances,
        sample_rate=observed.rate,
    )


def check_given(calibration: Calibration, session: Session) -> None:
    """A calibration that can be checked, and a session of its device."""
    if calibration.covariance is None:
        raise CalibrationError(f"calibration of {calibration.serial!r}: expected one with uncertainties, found none")
    check_device(calibration, session)
    for block, model in ((session.accel_block, calibration.accel), (session.gyro_block, calibration.gyro)):
        if block is not None and model is not None and len(model.bias) != block.size:
            raise InputError(
                f"{session.name}: log.{block.kind}: expected the {len(model.bias)} sensors of the calibration, found "
                f"{block.size}"
            )
    for kind, now in readings_of_session(session).items():
        then = calibration.readings.get(kind)
        raw = then is not None and (now.unit in _RAW or then.unit in _RAW)
        if then is not None and raw and (now.scale, now.offset) != (then.scale, then.offset):
            raise InputError(
                f"{session.name}: log.{kind}: expected the nominal scale and offset of the calibration, {then.scale} "
                f"and {then.offset}, found {now.scale} and {now.offset}"
            )


def _launches(calibration: Calibration, others: Sequence[LaunchVariances]) -> Sequence[LaunchVariances]:
    """The launches behind a calibration and those of other ones of its device, each once."""
    own = launch_variances(calibration)
    return others if own is None else (own, *(each for each in others if not each.logs & own.logs))


# What was known before


def known_before(
    calibration: Calibration,
    observations: Observations,
    grade: str,
    data_sheet: Mapping[str, float],
    launches: Sequence[LaunchVariances] = (),
) -> KnownBefore:
    """Parameters and covariance at the check by the calibration, in the frame `accelerometer`, Eq. (1), of a device of
    which `launches` of other calibrations are known."""
    usual = usual_sizes(grade, data_sheet)
    instrument = Instrument.of(
        observations.accel_block, observations.gyro_block, set(usual), variables_of(observations)
    )
    names, linear = instrument.names, instrument.names[: instrument.linear_count]

    # Σ with the uncertainty of gravity before it: by the calibration, and of the usual size what it does not have
    given = {p.name: p.value for p in calibration.parameters if variable_of(p.name) != "time"}
    missing = [name for name in linear if name not in given]
    if missing or calibration.covariance is None:
        raise InputError(
            f"calibration of {calibration.serial!r}: expected the parameters of the session's sensors, found none of "
            f"{', '.join(missing)}; check with recordings of the same device"
        )
    values, whole = np.zeros(len(names)), np.zeros((len(names) + 1,) * 2)
    gravity, covariance = observations.site.gravity_u, whole[1:, 1:]
    whole[0, 0] = gravity**2
    for group, members in instrument.members.items():
        covariance[members, members] = usual[group] ** 2 * np.eye(members.stop - members.start)
    at = [i for i, name in enumerate(names) if name in given]
    values[at] = [given[names[i]] for i in at]
    covariance[np.ix_(at, at)] = calibration.covariance_of([names[i] for i in at])
    if shared_gravity(calibration.site, observations.site):
        change = by_gravity(calibration.parameters, calibration.covariance, calibration.site)
        by_name = {p.name: c for p, c in zip(calibration.parameters, change.tolist(), strict=True)}
        whole[0, 1:] = whole[1:, 0] = gravity * np.array([by_name.get(name, 0.0) for name in names])

    # at the temperature of the session
    now, J = references_of(observations), np.eye(len(whole))
    if calibration.reference_temperature is not None and now:
        here = replace(calibration, temperature=replace(calibration.temperature, references=now))
        warmer = [reference_of_parameter(here, name) - reference_of_parameter(calibration, name) for name in names]
        J[1:, 1:] = to_temperature(names, np.array(warmer))
    # s² and 1/ν_s of another power-on, Eq. (2); a single launch is as far from the mean of all as the one checked,
    # while u of several together has what they change by
    single = len(calibration.launches) < 2 and not calibration.together
    others = _launches(calibration, launches)
    turned_on, inverse_degrees = np.zeros((2, len(whole)))
    for i, name in enumerate(linear, 1):
        seen = [(each.degrees, each.variances[name][0]) for each in others if name in each.variances]
        degrees = sum(count for count, _ in seen)
        own = sum(count * between for count, between in seen) / max(degrees, 1)
        pooled = USUAL_DEGREES * spread_of(TURN_ON[grade], name) ** 2 + degrees * own
        pooled /= USUAL_DEGREES + degrees
        turned_on[i] = max(own, pooled) * (2.0 if single else 1.0)
        if degrees:
            inverse_degrees[i] = 1.0 / degrees if own > pooled else 1.0 / (USUAL_DEGREES + degrees)

    inverse = {p.name: 1.0 / p.dof for p in calibration.parameters if p.dof is not None}
    fits = calibration.fits
    scatter: dict[str, Any] = {name: fits[fit].scatter for name, fit in _FITS.items() if fit in fits}
    return KnownBefore(
        instrument=instrument,
        values=J[1:, 1:] @ values,
        calibrated=J @ whole @ J.T,
        turned_on=turned_on,
        inverse_degrees=np.array([0.0, *(inverse.get(name, 0.0) for name in names)]),
        turned_on_inverse_degrees=inverse_degrees,
        to_temperature=J,
        components=replace(components_of(GRADES[grade].noise), **scatter),
    )


# The updated calibration


def _updated(check: FieldCheck, reasons: tuple[str, ...]) -> Calibration:
    """The calibration by the check, at the temperature of the check."""
    before, result, instrument = check.calibration, check.result, check.instrument
    assert before.covariance is not None
    u, changed = np.sqrt(np.diag(result.covariance)), {change.name for change in result.changes}
    parameters, at = [], []
    for p in before.parameters:
        if variable_of(p.name) == "time" or p.name not in instrument.names:
            continue
        i = instrument.names.index(p.name)
        value, own_u, learned = float(result.values[i]), float(u[i]), p.learned
        if p.prior is not None and learned is not None:
            learned = learned_fraction(own_u, p.prior)
        dof = None if p.name in changed else p.dof  # what is of the check alone has none of the calibration
        parameters.append(replace(p, value=value, u=own_u, deviation=None, run_to_run=None, dof=dof, learned=learned))
        at.append(i)
    others = [i for i, p in enumerate(before.parameters) if sensor_kind(p.name) == "mag"]  # took no part
    gyro = instrument.gyro
    warm = before.reference_temperature is not None
    at_rate = None if before.prediction is None else before.prediction.at_rate
    note = (
        f"no calibration of its own: that of {before.provenance.get('created', 'an unknown date')}, updated by a field "
        f"check of {check.rests} rests ({check.session}): "
        f"{'; '.join(reasons) or 'nothing had changed beyond chance'}"
    )
    return Calibration(
        # the device and its sensors
        device=before.device,
        axes=before.axes,
        readings=before.readings,
        frame=before.frame,
        # what still rests on the calibration
        absent=before.absent,
        method=before.method,
        outcome=before.outcome,
        fits=before.fits,
        groups=tuple(group for group in before.groups if variable_of(group.name) != "time"),
        mag=before.mag,
        # what the check says
        parameters=(*parameters, *(before.parameters[i] for i in others)),
        covariance=block_diag(result.covariance[np.ix_(at, at)], before.covariance[np.ix_(others, others)]),
        accel=instrument.model(instrument.accel, result.values),
        gyro=None if gyro is None else instrument.model(gyro, result.values),
        prediction=None
        if before.site is None
        else prediction(instrument, result.values, result.covariance, gravity=before.site.gravity, rate=at_rate),
        temperature=replace(
            before.temperature,
            reference=check.temperature if warm else None,
            range=before.temperature_range,  # on which it still rests
            references=check.references if warm else {},
        ),
        site=before.site if before.site == check.site else None,
        circumstances=check.circumstances,
        sample_rate=check.sample_rate,
        notes=(note, *before.notes),
        provenance={
            **provenance_of(check.sha256),
            "calibrated_log_sha256": before.provenance.get("log_sha256", "unknown"),
        },
    )
