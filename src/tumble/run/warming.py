"""Still and warming: how biases change with temperature, from a device that lies at rest while it warms or cools.

A sensor p at rest reads, with d = T − T₀ of its temperature, which follows the thermometer with a lag,

    y_p(t) = c_p + f_p Σ_k s_pk d^k + Σ_k b_pk d^k + β_p(t) + noise,     k = 1 … 3                                  (1)

f_p the specific force along its axis, s_pk and b_pk the coefficients of its scale factor and bias, β_p its in-run
process. A rest is cut into parts, which are rows of the joint estimate (`tumble.inference.joint`) as rests are: the
polynomials are parameter groups with priors of usual size, which decide how high a degree span and noise support; the
lags of both kinds, the sizes of the processes and their correlation times are integrated over. Parts of one rest have
no scatter beyond the process. Neighbouring parts are joined by turns about nothing, which leave the attitude as it is
but for a random walk (`CREEP`), whose two angles tilt all accelerometers alike; what a support creeps by beyond it the
in-run process takes.

**One attitude.** c_p, f_p and the mean of β_p are not told apart, nor are s_pk and b_pk: what is estimated is the
coefficient r_pk = b_pk + f_p s_pk of the reading. So the coefficient of the bias and its uncertainty are

    b_pk = r_pk − f_p ŝ_pk,     u²(b_pk) = u²(r_pk) + f_p² u²(s_pk)                                                 (2)

with ŝ_pk and u(s_pk) those of a calibration that has them, else zero and the usual size. Several attitudes tell them
apart, and s_pk are parameters too. The Earth's rate is constant in one attitude, and part of c_p of a gyro: of its
direction only the angle from the vertical is known, and that where the latitude is.

**With a calibration** at a temperature T_A, θ_A with covariance, the result is θ_A with the polynomials about T_A,

    b(T) = b_A + Σ_k b_k (T − T_A)^k                                                                                (3)

independent of θ_A but for (2): what the biases of this power-on differ by is in c_p alone. Where its temperature is not
known it may be any of those that were recorded, and the change of (3) over them is in u(b_A).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np
import scipy

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
from tumble.reduction.rests.warming import OVER_TEMPERATURE as WIDE
from tumble.result.accepted import accepted_part
from tumble.result.calibration import Calibration
from tumble.result.coverage import degrees_through, welch_satterthwaite
from tumble.result.parts import (
    CalibratedTemperature,
    Evidence,
    Parameter,
    Provenance,
    SourceContributions,
    learned_fraction,
)
from tumble.result.record import to_references
from tumble.result.uncertainty_budget import contributions_of
from tumble.run.from_estimate import (
    LAGS,
    check_sensors,
    reference_of,
    references_of,
    rest_results,
    without_result,
)
from tumble.run.observed import Observed, observations_in_parts
from tumble.sensors.model import Block, SensorModel
from tumble.sensors.parameters import (
    CURVED,
    OVER_TEMPERATURE,
    beyond_linear,
    group_name,
    groups,
    sensor_kind,
    to_temperature,
    units_of,
    variable_of,
)
from tumble.units import ZERO_CELSIUS, Array

PARTS = 40
"""Of a rest: what its in-run process and a lag do is seen at a fortieth of its length as well as it ever is."""
LEAST_CHANGE = 1.0
"""K: a recording whose temperature changes by less shows nothing over it."""
HELD = 1e-7
"""Standard deviation of scale factors and axis angles where no calibration says anything of them: slopes are known to
fewer digits than they change them by."""
FEWEST_DEGREES = 4.0
"""Of what a lag leaves open."""
CREEP = 1e-6
"""rad/√s: the random walk of the attitude of what lies on a table, 12″ in an hour."""


def lies_still(observed: Observed) -> bool:
    """Whether a device lay in one attitude while its temperature changed."""
    records = [file.temperature for file in observed.reduction.files if file.temperature is not None]
    if observed.faults or max((np.ptp(each, axis=0).max() for each in records), default=0.0) < LEAST_CHANGE:
        return False
    rests, files = _at_rest(observed).segmentation.rests, observed.reduction.by_file
    means = np.array([files[rest.file].accel.mean(rest.first, rest.last) for rest in rests])
    return one_direction(means)


def calibrate_warming(observed: Observed, base: Calibration | None, provenance: Provenance) -> Calibration:
    """The calibration of a device that lay at rest over temperature: `base`, a calibration of it at one temperature,
    whose biases get coefficients over temperature; without one the coefficients alone, and the biases of the gyros.

    Raises InputError for a log without thermometer, and for a calibration of other sensors.
    """
    session = observed.session
    taken = observations_in_parts(_at_rest(observed), PARTS)
    if isinstance(taken, Outcome):
        return without_result(session, "joint", taken, provenance)
    observations = taken[0].of_accelerometers() if observed.gyro_faults else taken[0]
    if observations.thermometers is None or observations.rests.temperatures is None:
        raise InputError(
            f"{session.name}: expected the temperature beside the readings, with which biases change, found none; name "
            "its column in [log.temperature]"
        )
    notes = (*observed.notes, *observations.notes)
    if base is not None:
        base = accepted_part(base)
        check_sensors(base, session)
        if base.covariance is None:
            raise InputError(f"calibration of {base.serial!r}: expected one with uncertainties, found none")
    readings = {f.file: (f.edges[1:], f.temperature) for f in observed.reduction.files if f.temperature is not None}
    estimate, observations = _estimated(session, observations, base, readings)
    made = _with_coefficients(base or _nominal(session, estimate, observations), estimate, observations, session)
    own, digest = made.provenance, provenance.log_sha256
    if base is not None:
        from tumble.run.launches import digest_of_all

        digest = digest_of_all([own.log_sha256 or "", digest or ""])
    return replace(
        made,
        provenance=replace(
            own,
            log_sha256=digest,
            software=provenance.software,
            created=provenance.created,
            sample_rate=own.sample_rate or observed.rate,
            notes=(*own.notes, *notes, *_notes(estimate, observations)),
            assumptions=(*own.assumptions, *_assumptions(observations, base)),
        ),
    )


def _at_rest(observed: Observed) -> Observed:
    """The same with the rests that the accelerometers show, where the gyros read alike from one second to the next in
    each: of a device that warms fast they leave the level that they have at rest."""
    rests = find_rests(observed.reduction, observed.session.accel_block, None).rests
    files, limit = observed.reduction.by_file, observed.segmentation.rate_limit
    second = max(1, round(1.0 / observed.reduction.block_seconds))
    for rest in rests if observed.session.gyro_block is not None else ():
        means = files[rest.file].gyro.means[rest.first : rest.last]
        seconds = means[: len(means) // second * second].reshape(-1, second, means.shape[1]).mean(axis=1)
        if limit is not None and len(seconds) > 1 and np.linalg.norm(np.diff(seconds, axis=0), axis=1).max() > limit:
            return observed
    return replace(observed, segmentation=replace(observed.segmentation, rests=rests))


def _blocks(observations: Observations) -> list[Block]:
    """Accelerometers, and gyros where there are some."""
    return [block for block in (observations.accel_block, observations.gyro_block) if block is not None]


# -------------------- the estimate --------------------


def _estimated(
    session: Session, observations: Observations, base: Calibration | None, readings: Mapping[int, tuple[Array, Array]]
) -> tuple[Estimate, Observations]:
    """The coefficients over temperature by the joint estimate, and the observations with the usual sizes of groups."""
    from tumble.run.calibrate import with_grade

    given, several = with_grade(session, observations), not one_direction(observations.rests.accel)
    turns = given.turns
    turned = turns is not None and bool((turns.duration > 0.0).any())
    if turns is not None:
        middle = 0.5 * (given.rests.start + given.rests.stop)
        walked = np.where(turns.duration > 0.0, 0.0, CREEP**2 * (middle[turns.last] - middle[turns.first]))
        turns = replace(turns, covariance=turns.covariance + walked[:, None, None] * np.eye(3))
    usual, sizes = dict(given.usual), dict[str, float]()
    for kind, separate in (("accel", several), ("gyro", turned)):
        usual[f"{kind}.bias.t3"] = CURVED * usual[f"{kind}.bias.t2"]
        names = (
            [f"bias.{power}" for power in OVER_TEMPERATURE] + ["lag"] + ["bias.hysteresis"] * ramps_up_and_down(given)
        )
        names += [f"scale.{power}" for power in OVER_TEMPERATURE] if separate else []
        sizes |= {f"{kind}.{name}": usual[f"{kind}.{name}"] for name in names if f"{kind}.{name}" in usual}
    known = {} if base is None else {p.name: p for p in base.in_frame("accelerometer").parameters}
    linear = [name for block in _blocks(given) for name in block.names]
    prior = {name: (known[name].u or HELD) if name in known else HELD for name in linear if ".bias" not in name}
    observations = replace(
        with_thermometer_errors(given, readings),
        turns=turns,
        usual=sizes,
        start={name: known[name].value for name in linear if name in known},
    )
    with np.errstate(invalid="ignore"):  # the mean rate of turns about nothing
        estimate = joint(observations, prior=Prior(parameters=prior, undisturbed=not several))
    return estimate, replace(observations, usual=usual)


# -------------------- what it gives --------------------


def _nominal(session: Session, estimate: Estimate, observations: Observations) -> Calibration:
    """What is known without a calibration: the biases of the gyros, and that the sensors are as they nominally are."""
    gyro, blocks, budget = observations.gyro_block, _blocks(observations), estimate.budget
    models = {block.kind: block.nominal() for block in blocks}
    names, values, covariance = list[str](), np.zeros(0), np.zeros((0, 0))
    assert budget is not None
    if gyro is not None:
        names = list(gyro.names[: gyro.size])
        at = [estimate.names.index(name) for name in names]
        values, budget = estimate.values[at], budget.carried(np.eye(len(estimate.names))[at])
        covariance = budget.covariances.sum(axis=0)
        read = np.zeros(gyro.size)
        read[gyro.channels] = values
        models["gyro"] = SensorModel(matrix=models["gyro"].matrix, bias=read)
    missing = tuple(name for block in blocks for name in block.names if name not in names)
    absent = f"{', '.join(dict.fromkeys(map(group_name, missing)))}: not shown at rest, taken as 0"
    provenance = Provenance(
        absent=(absent,),
        assumptions=(f"{absent}; tumble calibrate LOG --base FILE.json takes them from a calibration",),
    )
    nothing = without_result(session, "joint", Outcome(unobservable=missing), provenance)
    return replace(
        nothing,
        parameters=tuple(
            Parameter(name=name, value=float(value), u=float(u), unit="rad/s")
            for name, value, u in zip(names, values, np.sqrt(np.diag(covariance)), strict=True)
        ),
        covariance=covariance,
        accel=models["accel"],
        gyro=models.get("gyro"),
        axes={block.kind: tuple(map(tuple, block.axes.tolist())) for block in blocks},
        temperature=_temperature(session, observations),
        evidence=Evidence(
            fits=estimate.fits,
            hyperparameters=estimate.hyperparameters,
            integral=estimate.integral,
            budget=contributions_of(budget, names) if names else (),
        ),
        provenance=replace(nothing.provenance, site=observations.site),
    )


def _with_coefficients(
    base: Calibration, estimate: Estimate, observations: Observations, session: Session
) -> Calibration:
    """A calibration with these coefficients in the place of any that it has, Eq. (2) and (3)."""
    assert estimate.budget is not None
    assert base.covariance is not None
    new = [n for n in estimate.names if beyond_linear(n) and getattr(base, sensor_kind(n)) is not None]
    replaced = set(map(group_name, new))
    kept = [i for i, p in enumerate(base.parameters) if group_name(p.name) not in replaced]
    at, known = [base.parameters[i].name for i in kept], base.reference_temperature is not None
    names, first = [*at, *new], len(kept)
    move = np.eye(len(estimate.names))
    if known:  # from the references of this recording
        own = replace(base, temperature=_temperature(session, observations))
        move = to_references(own, estimate.names, base.temperature)
    move = move[[estimate.names.index(name) for name in new]]
    budget = estimate.budget.carried(move)
    of_data = move @ estimate.covariance @ move.T
    covariance = scipy.linalg.block_diag(base.covariance[np.ix_(kept, kept)], of_data)
    values = np.append([base.parameters[i].value for i in kept], move @ estimate.values)

    # Eq. (2)
    by_scale, block = np.eye(len(values)), observations.accel_block
    force = dict(zip(block.sensors, observations.rests.accel.mean(axis=0)[block.channels], strict=True))
    for power in OVER_TEMPERATURE if one_direction(observations.rests.accel) else ():
        of_scale, size = np.zeros(len(new)), observations.usual.get(f"accel.scale.{power}", 0.0)
        for sensor, f in force.items():
            name, scale = f"accel.bias.{sensor}.{power}", f"accel.scale.{sensor}.{power}"
            if scale in at:
                by_scale[first + new.index(name), at.index(scale)] = -f
            elif name in new:
                of_scale[new.index(name)] = size * f
        budget = budget.with_source(source(f"prior.accel.scale.{power}", size, "1/K"), np.diag(of_scale**2))
        covariance[first:, first:] += np.diag(of_scale**2)
    covariance, values = by_scale @ covariance @ by_scale.T, by_scale @ values
    lines = {line.name: line for line in base.evidence.budget}
    for line in contributions_of(budget, new, observations.size_basis):
        before = lines.get(line.name, line)
        lines[line.name] = replace(before, contributions={**before.contributions, **line.contributions})
    if not known:  # it may be any of the temperatures that were recorded
        of_course = _course(observations, names, values)[:first, :first]
        covariance[:first, :first] += of_course
        lines["temperature"] = SourceContributions(
            name="temperature",
            words="temperature of the calibration",
            type="B",
            contributions={name: float(u) for name, u in zip(at, np.sqrt(np.diag(of_course)), strict=True) if u > 0.0},
        )

    every = np.full(len(estimate.names), np.inf) if estimate.degrees is None else estimate.degrees
    degrees = degrees_through(move, estimate.u, every.tolist())
    of_lag = sum(c.diagonal() for c, each in zip(budget.covariances, budget.sources, strict=True) if each.name == "lag")
    of_lag, u = np.broadcast_to(of_lag, len(new)), np.sqrt(np.diag(covariance))
    sizes = {group.name: group.prior * group.prior_widened for group in estimate.groups}
    parameters = [replace(base.parameters[i], u=float(u[j])) for j, i in enumerate(kept)]
    for j, name in enumerate(new):
        variance, by_lag, size, of_name = float(of_data[j, j]), float(of_lag[j]), sizes[group_name(name)], u[first + j]
        parts = (variance - by_lag, degrees[j]), (by_lag, _degrees_of_lag(estimate, sensor_kind(name)))
        parameters.append(
            Parameter(
                name=name,
                value=float(values[first + j]),
                u=float(of_name),
                unit=units_of([name])[0],
                dof=welch_satterthwaite([*parts, (float(of_name) ** 2 - variance, None)]),
                prior=size,
                learned=learned_fraction(float(of_name), size),
            )
        )
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
        temperature=replace(base.temperature, range=None) if known else _temperature(session, observations),
        evidence=replace(base.evidence, rests=(*base.evidence.rests, *rests), budget=tuple(lines.values())),
    )


def _degrees_of_lag(estimate: Estimate, kind: str) -> float | None:
    """Degrees of freedom of what a lag leaves open: its likelihood is that with the likeliest in-run bias. With ln σ of
    that known to r, and a share p of it in the noise, the variance is known to 2 p r: ν = 1/(2 p² r²), but
    no fewer than FEWEST_DEGREES, white noise, which is known, being beside it."""
    budget = estimate.budget
    sizes = [h for h in estimate.hyperparameters if h.name == f"{kind}_in_run" and h.high > h.low]
    if not sizes or budget is None:
        return None
    own = [i for i, name in enumerate(estimate.names) if group_name(name) == f"{kind}.bias.t1"]
    by = dict(zip((s.name for s in budget.sources), budget.covariances[:, own, own].sum(axis=1), strict=True))
    whole = sum(by.get(f"{kind}.{name}", 0.0) for name in ("noise", "scatter", "in_run"))
    share, r = by.get(f"{kind}.in_run", 0.0) / max(whole, 1e-300), 0.5 * np.log(sizes[0].high / sizes[0].low)
    return max(0.5 / max(float(share * r), 1e-6) ** 2, FEWEST_DEGREES)


def _temperature(session: Session, observations: Observations) -> CalibratedTemperature:
    """Thermometers of a session, and their means as references."""
    channels = session.log.temperature
    assert channels is not None
    return CalibratedTemperature(
        reference=reference_of(observations),
        thermometers={block.kind: channels.names(block.kind) for block in _blocks(observations)},
        references=references_of(observations),
    )


def _kelvin(observations: Observations) -> Array:
    """Temperatures (N, T) of the rests, K."""
    assert observations.rests.temperatures is not None
    return observations.rests.temperatures


def _course(observations: Observations, names: list[str], values: Array) -> Array:
    """Covariance (m, m) of parameters over the temperatures of the rests, by how they change with them."""
    kelvin = _kelvin(observations)
    moves = [to_temperature(names, float(d)) for d in (kelvin - kelvin.mean(axis=0)).mean(axis=1)]
    return np.cov(np.array([(move - np.eye(len(names))) @ values for move in moves]), rowvar=False)


# -------------------- what is said of it --------------------


def _notes(estimate: Estimate, observations: Observations) -> Iterator[str]:
    """What the temperatures show, and what not."""
    celsius = _kelvin(observations) - ZERO_CELSIUS
    yield f"over temperature: {celsius.min():z.1f} to {celsius.max():z.1f} °C; beyond them nothing was measured"
    for name, sensors in LAGS.items():
        if name in estimate.names:
            i = estimate.names.index(name)
            yield f"the {sensors} are {estimate.values[i]:z.0f} s behind their thermometer, u {estimate.u[i]:.0f} s"
    if not any(variable_of(name) == "hysteresis" for name in estimate.names):
        yield (
            "the temperature went one way: a hysteresis is not seen, and in no u; let the device warm and cool in one "
            "recording"
        )
    if one_direction(observations.rests.accel):
        yield (
            "one attitude does not tell a change of the scale factor of an accelerometer from one of its bias: what is "
            "given is right in this attitude, and u holds what is usual for others; record another attitude too"
        )


def _assumptions(observations: Observations, base: Calibration | None) -> Iterator[str]:
    """What was taken for granted."""
    span = float(np.ptp(_kelvin(observations), axis=0).max())
    if span < WIDE:
        yield (
            f"the temperatures span {span:.1f} K, less than {WIDE:.0f}: curvatures are what is usual, and beyond these "
            "temperatures this says little; warm or cool the device through those of its use"
        )
    if base is not None and base.reference_temperature is None:
        yield (
            f"the calibration of {base.serial} does not say at which temperature it was made: any of this recording is "
            "taken, which is in the u of its biases; calibrate a recording with its thermometer"
        )
