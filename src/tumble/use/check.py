"""Check whether a calibration still holds for its device, by rests in any attitude, and find what has changed.

At the time of the check the parameters have the values of the calibration and the prior covariance P, with

    P = Σ + diag(s²),   D = N Σ N + diag(s²/√ν_s),   N = diag(ν^(−1/4))                                         (1)

Σ is the covariance of the calibration, estimated with ν degrees of freedom for each parameter, and D the uncertainty of
P (`tumble.methods.field_check`, Eq. (3)). s² is the variance of the changes from one power-on to the next. It is 2 s_g²
with 1/ν_s = 0, where s_g is the usual standard deviation for the grade: the calibrated launch and the checked launch
both differ from the mean of all launches. If several launches of the device are known, with the pooled variance s_L² of
ν_L degrees of freedom, s_g² is replaced by

    s² = max(s_L², [4 s_g² + ν_L s_L²]/(ν_L + 4)),   ν_s = ν_L or ν_L + 4                                         (2)

so that s_g² counts as an estimate with four degrees of freedom, because two launches may agree by chance. If the
calibration is the mean of several launches, the factor two is absent.

Groups of parameters that the calibration does not have, and drifts, which belong to a session, are zero with the usual
standard deviation for the grade. If the temperatures of calibration and check are known, the parameters are converted
to the temperature of the check. If both use the same stated gravity, its error is in the scale factors too, with the
opposite sign. The scatter is that of the calibration; in-run biases have the usual size for the grade.

The rests are also compared with gravity one by one (`tumble.use.positions`). This comparison alone decides for a table
of readings and for a calibration in the frame of the case.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from tumble.arguments import checked
from tumble.brief import Judged
from tumble.errors import CalibrationError, InputError
from tumble.files import FilePath
from tumble.inference.estimate import Fit, Outcome
from tumble.inference.variables import variables_of
from tumble.methods.field_check import (
    MISFIT_CHANCE,
    ChangedParameter,
    CheckPrior,
    CheckResult,
    ParameterTest,
    field_check,
)
from tumble.methods.rest_chain import JudgedRest
from tumble.planning.bounds import components_of
from tumble.recording.session import Session
from tumble.recording.session_file import session_from
from tumble.reduction.observations import Observations
from tumble.result.accepted import accepted_part
from tumble.result.calibration import Calibration, calibration_from
from tumble.result.coverage import gravity_sensitivity, shared_gravity
from tumble.result.launch_variances import LaunchVariances, launch_variances
from tumble.result.record import to_references
from tumble.run.from_estimate import check_sensors, mean_temperature, sensor_temperatures
from tumble.run.observed import grade_of, inspect_session, observations_for_calibration
from tumble.sensors.grades import GRADES, TURN_ON, spread_of
from tumble.sensors.instrument import Instrument
from tumble.sensors.parameters import group_name, group_of, shown_in, usual_sizes, variable_of
from tumble.units import ZERO_CELSIUS, engineering
from tumble.use.apply import check_device
from tumble.use.positions import PositionResiduals, fits_of, position_residuals, table_observations

_FITS = {"accel": "accelerometers", "gyro": "gyro rests", "turn": "gyro turns", "velocity": "velocities of turns"}
"""Fits of a calibration whose scatter the components of variance of the check take."""

GRADE_DEGREES = 4.0
"""Degrees of freedom of the variances usual for a grade: their standard deviations are uncertain by a third."""


@dataclass(frozen=True, kw_only=True, slots=True)
class CheckedRest:
    """A rest, or a position of a table, compared with gravity.

    `difference` is gravity less the modulus of the corrected reading, m/s², `u` its standard uncertainty and `sigmas`
    their ratio; both are None where nothing predicts the rest. In a stream the prediction uses the calibration and the
    earlier rests, `outside` names which of "temperature" and "force" are outside the calibrated range, `judged` are the
    tests of the biases by this rest, and `why` is the reason if a quiet stretch is not used as a rest."""

    label: str
    difference: float
    u: float | None = None
    sigmas: float | None = None
    start: float | None = None
    stop: float | None = None
    celsius: float | None = None
    outside: tuple[str, ...] = ()
    judged: JudgedRest | None = None
    why: str = ""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False, repr=False)
class FieldCheck(Judged):
    """Result of the check of a calibration.

    `rests` are those of the session, table or stream; chance makes their largest |difference|/u exceed `rest_limit` in
    one of 100 cases. `turns` is the number of turns used. `parameters` are the tests of the parameters that rests and
    turns determine, with the `largest` |change|/u and its `limit`; they are empty if the comparison with gravity alone
    decides. `changes` are the parameters that have changed, `unseen` the groups that are not determined, `misfit` the
    residuals that no change explains; `rests_agree`: the rests alone show no change, None without a
    test of the rests alone, which is made if no change explains rests and turns. `notes` are assumptions."""

    json_fields: ClassVar = (
        "verdict", "reasons", "source", "rests", "rest_limit", "turns", "changes", "parameters", "largest",
        "limit", "unseen", "misfit", "notes",
    )  # fmt: skip

    source: str
    rests: tuple[CheckedRest, ...]
    rest_limit: float | None = None
    turns: int = 0
    changes: tuple[ChangedParameter, ...] = ()
    parameters: tuple[ParameterTest, ...] = ()
    largest: float | None = None
    limit: float | None = None
    unseen: tuple[str, ...] = ()
    misfit: Fit | None = None
    rests_agree: bool | None = None
    notes: tuple[str, ...] = ()

    @property
    def valid(self) -> bool:
        """Whether the check shows no change."""
        return not self.reasons

    @property
    def explained(self) -> bool:
        """Whether chance and the changes found explain the rests and turns."""
        return self.misfit is None or self.misfit.probability >= MISFIT_CHANCE

    @property
    def reasons(self) -> tuple[str, ...]:
        """Sentences on what has changed; empty if the check shows no change."""
        if self.misfit is None:
            limit = np.inf if self.rest_limit is None else self.rest_limit
            judged = [(rest, abs(rest.sigmas)) for rest in self.rests if rest.sigmas is not None]
            size, unit = engineering("m/s^2", max((abs(rest.difference) for rest, _ in judged), default=0.0))
            return tuple(
                f"{rest.label}: g − |f| is {rest.difference / size:+.3g} {unit}, {sigmas:.1f} of its standard "
                f"uncertainty, expected at most {limit:.1f}"
                for rest, sigmas in judged
                if sigmas > limit
            )
        if self.explained:
            return tuple(change_text(change) for change in self.changes)
        agree = "its rests alone agree with the calibration: its turns, or gyros that drift between rests, do not; "
        turns = agree if self.rests_agree else ""
        return (
            f"no change of biases, scale factors or axes explains the session, so that it says nothing of them: "
            f"χ² {self.misfit.chi_square:.1f} for {self.misfit.degrees:.0f}, by chance with probability "
            f"{self.misfit.probability:.1g}; {turns}"
            "look at it with `tumble inspect`, repeat the check at rest, or calibrate",
        )


def parameter_test_fields(result: CheckResult) -> dict[str, Any]:
    """Return the fields of a `FieldCheck` that describe the tests of the parameters."""
    names = ("changes", "largest", "limit", "unseen", "misfit")
    return {name: getattr(result, name) for name in names} | {"parameters": tuple(result.tests.values())}


def change_text(change: ChangedParameter) -> str:
    """Return a sentence on the change of a parameter and on changes of others that explain the rests as well."""
    (size, unit), value = shown_in(change.name, change.unit, change.value), change.value
    text = f"{change.name} has changed by {value / size:+.3g} {unit} (u {change.u / size:.2g} {unit})"
    for name, value in change.others.items():
        size, unit = shown_in(name, group_of(name).unit, value)
        text += f", or {name} by {value / size:+.3g} {unit}"
    return text + f"; by chance with probability {change.probability:.1g} at most"


@checked
def check_calibration(
    calibration: Calibration | FilePath, readings: Session | FilePath, *, launches: Sequence[LaunchVariances] = ()
) -> FieldCheck:
    """Check whether a calibration still holds.

    Parameters
    ----------
    calibration
        An accepted calibration of accelerometers, or its file.
    readings
        A session of the device with three or more rests in any attitude, or its folder; or a file with a table of
        readings at rest, one row per position, in the unit of the table that the calibration was made from. The
        session or table of the calibration itself is refused.
    launches
        Launches of other calibrations of the device, from which its change between power-ons is estimated. By default
        the usual change for its grade.

    Returns
    -------
    FieldCheck
        The differences of the rests from gravity, and what has changed.

    Raises
    ------
    CalibrationError
        If the calibration is not accepted or has no uncertainties.
    InputError
        If the readings are those of another device, of other sensors, of the calibration itself, or without rests.

    Examples
    --------
    >>> import tumble
    >>> request = tumble.Setup.of(grade="mems", positions=18)
    >>> calibration = tumble.calibrate(tumble.simulate_session("calibrated", request, seed=1))
    >>> again = tumble.simulate_session("again", tumble.Setup.of(grade="mems", positions=4), seed=1)
    >>> check = tumble.check_calibration(calibration, again)
    >>> len(check.rests), check.valid
    (4, True)
    """
    accepted = accepted_for_check(calibration)
    if not isinstance(readings, Session) and not Path(readings).exists():
        raise InputError(f"{readings}: expected the folder of a session or a table of readings, found neither")
    if not isinstance(readings, Session) and not Path(readings).is_dir():
        rows, table = table_observations(accepted, Path(readings))
        labels = [f"position {i} (line {line})" for i, line in enumerate(table.lines, 1)]
        return _gravity_check(str(readings), position_residuals(accepted, rows, table.sha256), label=labels)
    session = session_from(readings)
    check_device(accepted, session)
    check_sensors(accepted, session)
    observed = inspect_session(replace(session, programme=None))
    observations = observations_for_calibration(observed)
    if isinstance(observations, Outcome):
        raise InputError(f"{session.name}: expected rests to check with, found {'; '.join(observations.reasons)}")
    grade, guessed_from = grade_of(session, observations)

    # each rest against gravity
    rests, kelvin = observations.rests, observations.rests.temperature
    start, stop = rests.start.tolist(), rests.stop.tolist()
    check = _gravity_check(
        session.name,
        position_residuals(accepted, observations, observed.sha256),
        label=[f"rest {i} ({t:z.1f}–{end:z.1f} s)" for i, (t, end) in enumerate(zip(start, stop, strict=True), 1)],
        start=start,
        stop=stop,
        celsius=len(rests) * [None] if kelvin is None else (kelvin - ZERO_CELSIUS).tolist(),
    )
    check = replace(check, notes=accepted.provenance.absent)
    if accepted.frame == "case":
        return check

    # all parameters
    converted = accepted.in_frame("accelerometer")
    if converted.gyro is None and observations.gyro_block is not None:
        observations = observations.of_accelerometers()
    data_sheet = session.device.prior
    result = field_check(observations, prior_at_check(converted, observations, grade, data_sheet, launches))
    rests_agree = None
    if not result.explained and observations.gyro_block is not None:
        at_rest = observations.of_accelerometers()
        rests_agree = field_check(at_rest, prior_at_check(converted, at_rest, grade, data_sheet, launches)).valid
    return replace(
        check,
        turns=0 if observations.turns is None else len(observations.turns),
        **parameter_test_fields(result),
        rests_agree=rests_agree,
        notes=(*check.notes, *_assumptions(converted, mean_temperature(observations), grade, guessed_from, launches)),
    )


def _gravity_check(source: str, residuals: PositionResiduals, **columns: Sequence[Any]) -> FieldCheck:
    """Return a check by the differences from gravity alone; `columns` are the other fields of its rests."""
    columns |= {name: getattr(residuals, name).tolist() for name in ("difference", "u", "sigmas")}
    rows = zip(*columns.values(), strict=True)
    rests = tuple(CheckedRest(**dict(zip(columns, row, strict=True))) for row in rows)
    return FieldCheck(source=source, rests=rests, rest_limit=residuals.limit)


def _assumptions(
    calibration: Calibration, celsius: float | None, grade: str, guessed_from: str, launches: Sequence[LaunchVariances]
) -> Iterator[str]:
    """Yield notes on changes from one power-on to the next, and on the temperature of the check, °C; `launches` are
    those of other calibrations of the device."""
    origin = f" (guessed from {guessed_from}; state it as [device] grade)" if guessed_from else ""
    count = sum(each.degrees + 1 for each in _all_launches(calibration, launches))
    by_launches = f", or as from launch to launch of {count} launches of the device" if count else ""
    yield (
        f"changes from one power-on to the next: allowed for as usual for the grade {grade}{by_launches}{origin}, in "
        "the tests of the parameters, not in u of g − |f|"
    )
    reference = calibration.reference_temperature
    if reference is None or celsius is None:
        yield "the temperature of the calibration or of the check is unknown: its change is not allowed for"
    elif abs(celsius - reference) > 1.0:
        temperatures = f"calibrated at {reference:.1f} °C, checked at {celsius:.1f} °C"
        yield f"{temperatures}: parameters by their slopes and curvatures"


def accepted_for_check(calibration: Calibration | FilePath) -> Calibration:
    """Return the accepted part of a calibration; raise CalibrationError without accelerometers or uncertainties."""
    accepted = accepted_part(calibration_from(calibration))
    if accepted.accel is None:
        why = "; ".join(accepted.provenance.absent) or "none of accelerometers"
        raise CalibrationError(
            f"calibration of {accepted.serial!r}: expected accepted accelerometers, by which a check has its "
            f"attitudes, found {why}"
        )
    if accepted.covariance is None:
        raise CalibrationError(f"calibration of {accepted.serial!r}: expected one with uncertainties, found none")
    return accepted


def _all_launches(calibration: Calibration, others: Sequence[LaunchVariances]) -> Sequence[LaunchVariances]:
    """Return the variances between the launches of a calibration, if it has several, and of other calibrations of its
    device that have no log in common with it."""
    own = launch_variances(calibration)
    return others if own is None else (own, *(each for each in others if not each.logs & own.logs))


# -------------------- the prior --------------------


def prior_at_check(
    calibration: Calibration,
    observations: Observations,
    grade: str,
    data_sheet: Mapping[str, float],
    launches: Sequence[LaunchVariances] = (),
) -> CheckPrior:
    """Return the prior of the parameters at the check, Eq. (1), from a calibration in the frame `accelerometer`.

    The data sheet has standard deviations by group, SI, which replace those of the grade; `launches` are those of other
    calibrations of the device."""
    sizes = usual_sizes(grade, data_sheet)
    instrument = Instrument.of(
        observations.accel_block, observations.gyro_block, set(sizes), variables_of(observations)
    )
    names, linear = instrument.names, instrument.names[: instrument.linear_count]

    # Σ with gravity as first row: from the calibration, and of the usual size for parameters that it does not have
    calibrated = {p.name: p.value for p in calibration.parameters if variable_of(p.name) != "time"}
    missing = [name for name in linear if name not in calibrated]
    if missing or calibration.covariance is None:
        raise InputError(
            f"calibration of {calibration.serial!r}: expected the parameters of the session's sensors, found none of "
            f"{', '.join(missing)}; check with recordings of the same device"
        )
    values = np.array([calibrated.get(name, 0.0) for name in names])
    gravity_u = observations.site.gravity_u
    covariance = np.diag([gravity_u**2, *(sizes.get(group_name(name), 0.0) ** 2 for name in names)])
    indices = 1 + np.flatnonzero([name in calibrated for name in names])
    covariance[np.ix_(indices, indices)] = calibration.covariance_of([names[i - 1] for i in indices])
    if shared_gravity(calibration.provenance.site, observations.site):
        change = gravity_sensitivity(calibration.parameters, calibration.covariance, calibration.provenance.site)
        by_name = dict(zip(calibration, change.tolist(), strict=True))
        covariance[0, 1:] = covariance[1:, 0] = gravity_u * np.array([by_name.get(name, 0.0) for name in names])

    # at the temperature of the check
    references = sensor_temperatures(observations)
    J = np.eye(len(covariance))
    if calibration.reference_temperature is not None and references:
        J[1:, 1:] = to_references(calibration, names, replace(calibration.temperature, references=references))

    # s² and 1/ν_s of another power-on, Eq. (2), with `between` for s_L²
    single = len(calibration.evidence.launches) < 2 and not calibration.evidence.together
    of_device = _all_launches(calibration, launches)
    turned_on, inverse_degrees = np.zeros((2, len(covariance)))
    for i, name in enumerate(linear, 1):
        variances = [(each.degrees, each.variances[name]) for each in of_device if name in each.variances]
        degrees = sum(count for count, _ in variances)
        between = sum(count * variance for count, variance in variances) / max(degrees, 1)
        total = GRADE_DEGREES + degrees
        pooled = (GRADE_DEGREES * spread_of(TURN_ON[grade], name) ** 2 + degrees * between) / total
        turned_on[i] = max(between, pooled) * (2.0 if single else 1.0)
        inverse_degrees[i] = 0.0 if not degrees else 1.0 / (degrees if between > pooled else total)

    inverse = {p.name: 1.0 / p.dof for p in calibration.parameters if p.dof is not None}
    fits = fits_of(calibration)
    scatter: dict[str, Any] = {name: fits[fit].scatter for name, fit in _FITS.items() if fit in fits}
    return CheckPrior(
        instrument=instrument,
        values=J[1:, 1:] @ values,
        calibrated=J @ covariance @ J.T,
        turned_on=turned_on,
        inverse_degrees=np.array([0.0, *(inverse.get(name, 0.0) for name in names)]),
        turned_on_inverse_degrees=inverse_degrees,
        to_temperature=J,
        components=replace(components_of(GRADES[grade].noise), **scatter),
    )
