"""Temperature coefficients of biases, from a device that lies at rest while it warms or cools.

With d = T − T₀, where the temperature T of the sensor follows the thermometer with a lag, sensor p at rest reads

    y_p(t) = c_p + f_p Σ_k s_pk d^k + Σ_k b_pk d^k + β_p(t) + noise,     k = 1 … 3                                  (1)

f_p is the specific force along its axis, s_pk and b_pk are the coefficients of its scale factor and bias, and β_p is
its in-run process. A rest is cut into parts, which enter the joint estimate (`tumble.inference.joint`) as rests do. The
polynomials are parameter groups with priors of usual size, by which span and noise decide the degree; the lags of both
kinds of sensors, the sizes of the processes and their correlation times are integrated over. Parts of one rest have no
scatter beyond the process. Neighbouring parts are joined by turns of zero angle with a random walk of the attitude
(`CREEP`), whose two angles tilt all accelerometers alike; a larger creep of the support is taken up by the in-run
process.

**One attitude.** c_p, f_p and the mean of β_p cannot be separated, nor can s_pk and b_pk: the estimate is the
coefficient r_pk = b_pk + f_p s_pk of the reading. So the coefficient of the bias and its uncertainty are

    b_pk = r_pk − f_p ŝ_pk,     u²(b_pk) = u²(r_pk) + f_p² u²(s_pk)                                                 (2)

with ŝ_pk and u(s_pk) from a calibration that has them, else zero and the usual size. Several attitudes separate them,
and s_pk are parameters too. In one attitude the Earth's rate is a constant part of c_p of a gyro; of its direction only
the angle from the vertical is known, if the latitude is. A gyro also reads G·f of the specific force, which adds (G g)²
to u² of its bias, G being the usual g-sensitivity; with a calibration, its biases stay those of (3).

**With a calibration** at a temperature T_A, with parameters θ_A, the result is θ_A with polynomials about T_A,

    b(T) = b_A + Σ_k b_k (T − T_A)^k                                                                                (3)

which are independent of θ_A except through (2): the change of the biases since then is only in c_p.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
import scipy

from tumble.advice import Advised
from tumble.errors import InputError
from tumble.inference.estimate import Estimate, Outcome
from tumble.inference.joint import joint
from tumble.inference.problem import Prior
from tumble.inference.sources import source
from tumble.inference.variables import ramps_up_and_down
from tumble.recording.session import Session
from tumble.reduction.observations import Observations, one_direction
from tumble.reduction.rests.segmentation import find_rests
from tumble.reduction.rests.thermometer_errors import with_thermometer_errors
from tumble.reduction.rests.warming import LEAST_CHANGE
from tumble.reduction.rests.warming import OVER_TEMPERATURE as WIDE
from tumble.result.accepted import accepted_part
from tumble.result.calibration import Calibration
from tumble.result.coverage import degrees_through, welch_satterthwaite
from tumble.result.parts import Evidence
from tumble.result.record import to_references
from tumble.result.uncertainty_budget import contributions_of
from tumble.run.from_estimate import (
    LAGS,
    assemble,
    blocks_of,
    calibrated_temperature,
    check_sensors,
    extended,
    origin_of,
    parameters_of,
    rest_results,
)
from tumble.run.observed import Observed, observations_in_parts, with_grade
from tumble.sensors.model import SensorModel
from tumble.sensors.parameters import (
    CURVED,
    OVER_TEMPERATURE,
    beyond_linear,
    group_name,
    groups,
    sensor_kind,
    variable_of,
)
from tumble.units import ZERO_CELSIUS, Array

PARTS = 40  # of a rest; shorter parts do not improve the in-run process and the lag
HELD = 1e-7  # prior of scale factors and axis angles without a calibration, much smaller than relative errors of slopes
LEAST_LAG_DEGREES = 4.0  # degrees of freedom of the variance that a lag adds
CREEP = 1e-6  # rad/√s, random walk of the attitude of a device on a table, 12″ in an hour


def is_still(observed: Observed) -> bool:
    """Return True if a device lay in one attitude while its temperature changed."""
    records = [file.temperature for file in observed.reduction.files if file.temperature is not None]
    if observed.faults or max((np.ptp(each, axis=0).max() for each in records), default=0.0) < LEAST_CHANGE:
        return False
    rests, files = _at_rest(observed).segmentation.rests, observed.reduction.by_file
    means = np.array([files[rest.file].accel.mean(rest.first, rest.last) for rest in rests])
    return one_direction(means)


def calibrate_warming(observed: Observed, base: Calibration | None) -> Calibration:
    """Calibrate a device that lay at rest over temperature.

    The biases of `base`, its calibration at one temperature, get coefficients over temperature; without it the result
    has the coefficients and the biases of the gyros. Raises InputError for a log without thermometer, and for a
    calibration of other sensors."""
    session = observed.session
    matched = observations_in_parts(_at_rest(observed), PARTS)
    if isinstance(matched, Outcome):
        return assemble(session, "joint", matched, observed.origin)
    observations = matched[0].of_accelerometers() if observed.gyro_faults else matched[0]
    if observations.thermometers is None or observations.rests.temperatures is None:
        raise InputError(
            f"{session.name}: expected the temperature beside the readings, with which biases change, found none; name "
            "its column in [log.temperature]"
        )
    if base is not None:
        base = accepted_part(base)
        check_sensors(base, session)
        if base.covariance is None:
            raise InputError(f"calibration of {base.serial!r}: expected one with uncertainties, found none")
        if base.reference_temperature is None:
            raise InputError(
                f"calibration of {base.serial!r}: expected one that states its temperature, about which biases change, "
                "found none; calibrate a recording with its thermometer"
            )
    readings = {f.file: (f.edges[1:], f.temperature) for f in observed.reduction.files if f.temperature is not None}
    notes = (*observed.notes, *observations.notes)
    estimate, observations = _estimated(session, observations, base, readings)
    calibration = base or _nominal(observed, estimate, observations)
    calibration = _with_coefficients(calibration, estimate, observations, session)
    before, digests = calibration.provenance, [observed.sha256]
    if base is not None:
        digests.insert(0, before.log_sha256 or "")
    return extended(
        calibration,
        notes=(*notes, *_notes(estimate, observations, base)),
        assumptions=(*before.assumptions, *_assumptions(observations, session.log.doubts)),
        sample_rate=before.sample_rate or observed.rate,
        **origin_of(*digests),
    )


def _at_rest(observed: Observed) -> Observed:
    """Use the rests found by the accelerometers if the gyros are steady from second to second in each.

    The gyros of a device that warms fast drift away from their level at rest."""
    rests = find_rests(observed.reduction, observed.session.accel_block, None).rests
    files, limit = observed.reduction.by_file, observed.segmentation.rate_limit
    second = max(1, round(1.0 / observed.reduction.block_seconds))
    for rest in rests if observed.session.gyro_block is not None else ():
        means = files[rest.file].gyro.means[rest.first : rest.last]
        seconds = means[: len(means) // second * second].reshape(-1, second, means.shape[1]).mean(axis=1)
        if limit is not None and len(seconds) > 1 and np.linalg.norm(np.diff(seconds, axis=0), axis=1).max() > limit:
            return observed
    return replace(observed, segmentation=replace(observed.segmentation, rests=rests))


# -------------------- the estimate --------------------


def _estimated(
    session: Session, observations: Observations, base: Calibration | None, readings: Mapping[int, tuple[Array, Array]]
) -> tuple[Estimate, Observations]:
    """Return the joint estimate of the temperature coefficients, and the observations with the usual sizes of
    groups."""
    graded, has_attitudes = with_grade(session, observations), not one_direction(observations.rests.accel)
    turns = graded.turns
    has_turns = turns is not None and bool((turns.duration > 0.0).any())
    if turns is not None:
        middle = 0.5 * (graded.rests.start + graded.rests.stop)
        creep = np.where(turns.duration > 0.0, 0.0, CREEP**2 * (middle[turns.last] - middle[turns.first]))
        turns = replace(turns, covariance=turns.covariance + creep[:, None, None] * np.eye(3))
    usual, sizes = dict(graded.usual), dict[str, float]()
    for kind, separate in (("accel", has_attitudes), ("gyro", has_turns)):
        usual[f"{kind}.bias.t3"] = CURVED * usual[f"{kind}.bias.t2"]
        names = (
            [f"bias.{power}" for power in OVER_TEMPERATURE] + ["lag"] + ["bias.hysteresis"] * ramps_up_and_down(graded)
        )
        names += [f"scale.{power}" for power in OVER_TEMPERATURE] if separate else []
        sizes |= {f"{kind}.{name}": usual[f"{kind}.{name}"] for name in names if f"{kind}.{name}" in usual}
    calibrated = {} if base is None else {p.name: p for p in base.in_frame("accelerometer").parameters}
    linear = [name for block in blocks_of(graded) for name in block.names]
    held = [name for name in linear if ".bias" not in name]
    prior = {name: (calibrated[name].u or HELD) if name in calibrated else HELD for name in held}
    observations = replace(
        with_thermometer_errors(graded, readings),
        turns=turns,
        usual=sizes,
        start={name: calibrated[name].value for name in linear if name in calibrated},
    )
    with np.errstate(invalid="ignore"):  # mean rate of turns of zero duration
        estimate = joint(observations, prior=Prior(parameters=prior, undisturbed=not has_attitudes))
    return estimate, replace(observations, usual=usual)


# -------------------- the calibration --------------------


def _nominal(observed: Observed, estimate: Estimate, observations: Observations) -> Calibration:
    """Return a calibration of nominal sensors, in which the biases of the gyros are estimated, without parameters."""
    blocks, session = blocks_of(observations), observed.session
    models = {block.kind: block.nominal() for block in blocks}
    names = [name for block in blocks for name in block.names if group_name(name) != "gyro.bias"]
    if (gyro := observations.gyro_block) is not None:
        bias = np.zeros(gyro.size)
        bias[gyro.channels] = estimate.values[[estimate.names.index(name) for name in gyro.names[: gyro.size]]]
        models["gyro"] = SensorModel(matrix=models["gyro"].matrix, bias=bias)
    absent = f"{', '.join(dict.fromkeys(map(group_name, names)))}: not shown at rest, taken as 0"
    assumption = Advised(absent, "tumble calibrate LOG --base FILE.json takes them from a calibration")
    return assemble(
        session,
        "joint",
        Outcome(unobservable=tuple(names)),
        {"circumstances": observed.circumstances, "absent": (absent,), "assumptions": (assumption,)},
        covariance=np.zeros((0, 0)),
        accel=models["accel"],
        gyro=models.get("gyro"),
        axes={block.kind: tuple(map(tuple, block.axes.tolist())) for block in blocks},
        temperature=calibrated_temperature(session, observations),
        evidence=Evidence(fits=estimate.fits, hyperparameters=estimate.hyperparameters, integral=estimate.integral),
    )


def _with_coefficients(
    base: Calibration, estimate: Estimate, observations: Observations, session: Session
) -> Calibration:
    """Return a calibration with its temperature coefficients replaced by these, Eq. (2) and (3), and with the biases of
    the gyros if it has none."""
    assert estimate.budget is not None
    assert base.covariance is not None
    new = [
        name
        for name in estimate.names
        if getattr(base, sensor_kind(name)) is not None
        and (beyond_linear(name) or (group_name(name) == "gyro.bias" and name not in base))
    ]
    replaced = set(map(group_name, new))
    kept = [i for i, p in enumerate(base.parameters) if group_name(p.name) not in replaced]
    kept_names, first = [base.parameters[i].name for i in kept], len(kept)
    names, here = [*kept_names, *new], replace(base, temperature=calibrated_temperature(session, observations))
    move = to_references(here, estimate.names, base.temperature)[[estimate.names.index(name) for name in new]]
    budget = estimate.budget.carried(move)
    estimated = move @ estimate.covariance @ move.T
    covariance = scipy.linalg.block_diag(base.covariance[np.ix_(kept, kept)], estimated)
    values = np.append([base.parameters[i].value for i in kept], move @ estimate.values)

    # Eq. (2), and what the g-sensitivity adds to the biases of gyros; by group of unit usual size, their change
    by_scale, block = np.eye(len(values)), observations.accel_block
    is_bias = np.array([group_name(name) == "gyro.bias" for name in new], dtype=bool)
    unseen = {"gyro.g_sensitivity": observations.site.gravity * is_bias}
    force = dict(zip(block.sensors, observations.rests.accel.mean(axis=0)[block.channels], strict=True))
    for power in OVER_TEMPERATURE if one_direction(observations.rests.accel) else ():
        unseen[f"accel.scale.{power}"] = np.zeros(len(new))
        for sensor, f in force.items():
            name, scale = f"accel.bias.{sensor}.{power}", f"accel.scale.{sensor}.{power}"
            if scale in kept_names:
                by_scale[first + new.index(name), kept_names.index(scale)] = -f
            elif name in new:
                unseen[f"accel.scale.{power}"][new.index(name)] = f
    for group, change in unseen.items():
        size = observations.usual.get(group, 0.0)
        part = np.diag((size * change) ** 2)
        unit = "1/K" if group.startswith("accel") else "rad*s/m"
        budget = budget.with_source(source(f"prior.{group}", size, unit), part)
        covariance[first:, first:] += part
    covariance, values = by_scale @ covariance @ by_scale.T, by_scale @ values
    lines = {line.name: line for line in base.evidence.budget}
    for line in contributions_of(budget, new, observations.size_basis):
        before = lines.get(line.name, line)
        lines[line.name] = replace(before, contributions={**before.contributions, **line.contributions})

    u = np.sqrt(np.diag(covariance))
    sizes = {group.name: group.prior * group.prior_widened for group in estimate.groups}
    priors = [sizes.get(group_name(name)) for name in new]
    dof = _degrees_of(estimate, move, new, u[first:] ** 2)
    parameters = [replace(base.parameters[i], u=float(u[j])) for j, i in enumerate(kept)]
    parameters += parameters_of(new, values[first:], u[first:], dof=dof, prior=priors)
    order = {group.name: i for i, group in enumerate(groups())}
    ranked = sorted(range(len(names)), key=lambda i: order.get(group_name(names[i]), len(order)))
    shift = 1 + max((rest.file for rest in base.evidence.rests), default=-1)
    rests = (replace(rest, file=rest.file + shift) for rest in rest_results(estimate, observations))
    unsettled = () if estimate.converged else ("the coefficients over temperature did not settle",)
    return replace(
        base,
        parameters=tuple(parameters[i] for i in ranked),
        covariance=covariance[np.ix_(ranked, ranked)],
        outcome=replace(base.outcome, remarks=(*base.outcome.remarks, *unsettled)),
        groups=(
            *(group for group in base.groups if group.name not in replaced),
            *(replace(group, kept=True) for group in estimate.groups if group.name in replaced),
        ),
        temperature=replace(base.temperature, range=None),
        evidence=replace(base.evidence, rests=(*base.evidence.rests, *rests), budget=tuple(lines.values())),
    )


def _degrees_of(estimate: Estimate, move: Array, names: Sequence[str], variances: Array) -> list[float | None]:
    """Return the degrees of freedom of parameters with these names and variances (q,).

    The parameters are `move` (q, m) times those of the estimate. What their variances have beyond those of the estimate
    is known, and its part from a lag has the degrees of freedom of the lag."""
    assert estimate.budget is not None
    degrees = np.full(len(estimate.names), np.inf) if estimate.degrees is None else estimate.degrees
    moved_degrees = degrees_through(move, estimate.u, degrees.tolist())
    estimated = np.diag(move @ estimate.covariance @ move.T)
    by_lag = estimate.budget.carried(move).variances_from("lag")
    out = list[float | None]()
    for name, variance, dof, whole, lag in zip(names, estimated, moved_degrees, variances, by_lag, strict=True):
        lag_dof = _lag_degrees(estimate, sensor_kind(name))
        out.append(welch_satterthwaite([(variance - lag, dof), (lag, lag_dof), (whole - variance, None)]))
    return out


def _lag_degrees(estimate: Estimate, kind: str) -> float | None:
    """Return the degrees of freedom of the variance that a lag adds, at least LEAST_LAG_DEGREES.

    The lag is estimated with the likeliest size σ of the in-run bias. If ln σ is known to r, and the bias has the share
    p of the variance, this is known to 2 p r, so that ν = 1/(2 p² r²)."""
    budget = estimate.budget
    sizes = [h for h in estimate.hyperparameters if h.name == f"{kind}_in_run" and h.high > h.low]
    if not sizes or budget is None:
        return None
    slopes = [i for i, name in enumerate(estimate.names) if group_name(name) == f"{kind}.bias.t1"]
    parts = ("noise", "scatter", "in_run")
    variances = {part: budget.variances_from(f"{kind}.{part}")[slopes].sum() for part in parts}
    share, r = variances["in_run"] / max(sum(variances.values()), 1e-300), 0.5 * np.log(sizes[0].high / sizes[0].low)
    return max(0.5 / max(float(share * r), 1e-6) ** 2, LEAST_LAG_DEGREES)


# -------------------- notes --------------------


def _notes(estimate: Estimate, observations: Observations, base: Calibration | None) -> Iterator[str]:
    assert observations.rests.temperatures is not None
    celsius = observations.rests.temperatures - ZERO_CELSIUS
    yield f"over temperature: {celsius.min():z.1f} to {celsius.max():z.1f} °C; beyond them nothing was measured"
    for name, sensors in LAGS.items():
        if name in estimate.names:
            i = estimate.names.index(name)
            yield f"the {sensors} are {estimate.values[i]:z.0f} s behind their thermometer, u {estimate.u[i]:.0f} s"
    if not any(variable_of(name) == "hysteresis" for name in estimate.names):
        yield Advised(
            "the temperature only rose or only fell: hysteresis is not determined, and not in u",
            "let the device warm and cool in one recording",
        )
    if base is None and observations.gyro_block is not None:
        yield "u of gyro.bias includes gravity, by the g-sensitivity that is usual for the grade"
    if one_direction(observations.rests.accel):
        yield Advised(
            "in one attitude a change of the scale factor of an accelerometer looks like one of its bias: the result "
            "is right in this attitude, and u includes the usual difference in others",
            "record another attitude too",
        )


def _assumptions(observations: Observations, doubts: Iterable[str]) -> Iterator[str]:
    yield from (f"doubt: {doubt}" for doubt in doubts)
    assert observations.rests.temperatures is not None
    span = float(np.ptp(observations.rests.temperatures, axis=0).max())
    if span < WIDE:
        yield Advised(
            f"the temperatures span {span:.1f} K, less than {WIDE:.0f}: curvatures have their usual sizes, and beyond "
            "these temperatures the result is hardly valid",
            "warm or cool the device through those of its use",
        )
