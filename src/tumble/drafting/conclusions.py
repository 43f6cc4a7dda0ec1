"""Units, scales and times of a draft from the hypothesis of least cost, with remarks on how they were found and doubts
about hypotheses that are nearly as likely."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from tumble.diagnosis.channels import like_gravity
from tumble.diagnosis.turn_likelihood import columns_text
from tumble.drafting.foreign_log import Draft, linear_acceleration
from tumble.drafting.hypotheses import Evidence, Hypothesis, gather_evidence, ranked_hypotheses
from tumble.errors import InputError, TumbleError
from tumble.recording.columns.names import ACCEL, GYRO, NAMED
from tumble.recording.columns.scales import COUNTS_PER, COUNTS_PER_SI, SensorScale
from tumble.recording.session import USUAL_RATE_U
from tumble.run.observed import Progress, inspect_session
from tumble.units import ACCEL_UNITS, DEGREE, GYRO_UNITS

_GRAVITY_TOLERANCE = 0.3  # of gravity, for accelerometers in a stated unit
_FEWEST_FOR_GRAVITY = 4  # rests in several attitudes that determine the length of a vector
_LARGEST_BIAS = 20.0  # °/s; gyros that read more at rest have an offset
_MOST_RIVALS = 3  # listed in a doubt, the likeliest
_TIME_KEYS = ("time", "time_unit", "regular", "rate_hz")


def complete_draft(draft: Draft, progress: Progress) -> list[str]:
    """Add units, scales and times to a draft whose sensors are raw numbers, and return the faults of its recording."""
    evidence = gather_evidence(draft, progress)
    best, *others = ranked_hypotheses(evidence, draft)
    rivals = [hypothesis for hypothesis in others if hypothesis.cost < best.cost + draft.widths.near]
    log = {key: value for key, value in draft.log.items() if key not in _TIME_KEYS} | best.times.keys
    draft.content["log"] = log
    draft.say(*_time_remarks(draft, best))
    if ACCEL in draft.triads:
        log[ACCEL] = _accel_table(draft, best, evidence)
    if best.gyro is not None:
        if draft.rate_guessed and best.profile is not None:  # the other rates that the turns fit are in u
            rates = [h.times.rate for h in rivals if h.gyro == best.gyro]
            rate_u = max((abs(math.log(rate / best.times.rate)) for rate in rates), default=0.0)
            log |= {"clock_ppm_u": round(1e6 * min(rate_u, 1.0))} if rate_u > USUAL_RATE_U else {}
        log[GYRO] = _gyro_table(draft, best, best.gyro, evidence, rivals)
    of_gravity = _doubts_of_gravity(draft, best, evidence)
    of_units = [*_doubts_of_units(draft, best, rivals), *_doubts_of_scale(best, evidence)]
    of_log = (*of_gravity, *(doubt for kind, doubt in of_units if not kind), *draft.doubts)
    log |= {"doubt": "; ".join(of_log)} if of_log else {}
    for kind, doubt in of_units:
        log |= {kind: log[kind] | {"doubt": doubt}} if kind else {}
    draft.doubts, draft.times = (*(doubt for kind, doubt in of_units if kind), *of_log), best.times
    if ACCEL not in draft.triads:
        return []
    try:
        observed = inspect_session(draft.session(), progress=progress)
        faults = [*observed.faults, *observed.gyro_faults]
    except (TumbleError, np.linalg.LinAlgError) as error:
        faults = [str(error)]
    if best.profile is None or best.gyro is None:
        return faults
    if best.profile.exchanged:
        faults = [f"the gyros carry the vertical from rest to rest only where {columns_text(best.profile.exchange)}"]
    return faults


def _doubts_of_gravity(draft: Draft, best: Hypothesis, evidence: Evidence) -> Iterator[str]:
    """Yield doubts about accelerometers that do not read gravity in a unit.

    Raises InputError if such accelerometers are named as linear acceleration, or if the gyros read gravity and the
    columns are not stated by the user."""
    if ACCEL not in draft.triads:
        return
    unit, columns = draft.unit(ACCEL), draft.triads[ACCEL].columns
    if unit is not None and ACCEL_UNITS[unit].kind != "raw":
        length = evidence.length * ACCEL_UNITS[unit].per_second(best.times.rate) / COUNTS_PER_SI[ACCEL]
        if abs(length - 1.0) > _GRAVITY_TOLERANCE:
            reading = f"the accelerometers read {length:.3g} g at rest in {unit}, as their names say"
            yield f"{reading}: if another unit is right, state --accel-unit; without gravity none is calibrated"
    elif not (evidence.whole[ACCEL] or unit == "V") and (
        not best.accel.listed or abs(evidence.length / best.accel.reading(best.times.rate) - 1.0) > _GRAVITY_TOLERANCE
    ):
        if NAMED["without_gravity"].search(columns[0]):
            raise linear_acceleration(draft.files[0], columns)
        by_names = GYRO in draft.triads and not (draft.given.accel or draft.given.gyro)
        if by_names and evidence.rests >= _FEWEST_FOR_GRAVITY and like_gravity(evidence.gyro):
            gyros = draft.triads[GYRO].columns
            raise InputError(
                f"{draft.files[0]}: expected gravity in the columns of the accelerometers, found it in those of the "
                f"gyros ({', '.join(gyros)}), one length in many directions: their names are exchanged; state --accel "
                f"{','.join(gyros)} --gyro {','.join(columns)}"
            )
        finding = "the accelerometers read no whole numbers as counts are, and gravity in no unit"
        if evidence.rests >= _FEWEST_FOR_GRAVITY and evidence.length_u < _GRAVITY_TOLERANCE:
            rests = f"rests in several attitudes read {evidence.length:.4g} per g, which is taken for their scale"
            yield f"{finding}: {rests}"
        else:
            yield (
                f"{finding}: if they are volts, state --accel-unit V; what a filter has left without gravity cannot be "
                "calibrated"
            )


def _doubts_of_scale(best: Hypothesis, evidence: Evidence) -> Iterator[tuple[str, str]]:
    """Yield the doubt about gyros, not in counts, whose turns give a scale of no unit and no data sheet."""
    gyro = best.gyro
    if best.profile is None or gyro is None or gyro.listed or best.accel.unit is None or evidence.whole[GYRO]:
        return
    written = f"; column {best.times.keys['time']!r} is taken as it is written" if best.times.stamped else ""
    yield (
        "",
        f"the gyros carry the vertical only with {gyro.value:.4g} numbers per deg/s, as in no unit and on no data "
        f"sheet{written}: is their unit right? Biases and scale factors are relative to this scale",
    )


def _doubts_of_units(draft: Draft, best: Hypothesis, rivals: Sequence[Hypothesis]) -> Iterator[tuple[str, str]]:
    """Yield doubts about units and the rate, with the consequence of each and the option that settles it.

    A doubt that ends where a recording determines the scale of sensors comes with their kind, others with ""."""
    rates = [h.times.rate for h in rivals if "time" in h.differs(best)]
    for kind, sensors, scale in ((ACCEL, "accelerometers", best.accel), (GYRO, "gyros", best.gyro)):
        if scale is None or kind not in draft.triads:
            continue
        only = "the accelerometers alone are calibrated, " if ACCEL in draft.triads else ""
        scales = [h.accel if kind == ACCEL else h.gyro for h in rivals if kind in h.differs(best)]
        labels = dict.fromkeys(rival.label for rival in scales if rival is not None and rival.listed)
        others = " or ".join(list(labels)[:_MOST_RIVALS])
        unscaled = draft.log[kind]["unit"] == "count" and "scale" not in draft.log[kind]
        if unscaled and draft.rate_guessed and best.profile is not None:
            pairs = [(h.gyro.value, h.times.rate) for h in (best, *rivals) if h.gyro is not None and h.gyro.listed]
            rate_of = dict(reversed(pairs))  # the likeliest of each scale
            values = list(dict.fromkeys(value for value, _ in pairs))[:_MOST_RIVALS]
            fitting = ", ".join(f"{value:g} per deg/s at {rate_of[value]:g} Hz" for value in values)
            yield (
                "",
                f"the rate of the samples is unknown, and with it the scale of the gyros' counts ({fitting} fit): "
                f"{only}state --sample-rate",
            )
            return
        if unscaled:
            yield (
                "",
                f"no turn determines the scale of the gyros' counts: {only}noise is given as if a count were 1 deg/s; "
                "put the scale of the data sheet into [log.gyro]",
            )
        elif others and draft.unit(kind) is None:
            yield (
                "" if draft.rate_guessed or rates else kind,  # turns determine the product of scale and rate
                f"{sensors} in {scale.label} by a guess, {others} would fit too: all their values depend on it; state "
                f"--{kind}-unit",
            )
    if draft.rate_guessed or rates:
        how = "by the turns" if best.profile is not None else "by a guess"
        others = ", ".join(f"{rate:g}" for rate in list(dict.fromkeys(rates))[:_MOST_RIVALS])
        also = f", {others} would fit too" if rates else ""
        follows = "the gyros' scale factors depend" if best.gyro is not None else "the length of rests depends"
        yield "", f"{best.times.rate:g} samples per second {how}{also}: {follows} on it; state --sample-rate"


def _time_remarks(draft: Draft, best: Hypothesis) -> list[str]:
    """Return remarks on the times or the rate."""
    first, taken = draft.times, best.times
    remarks = list(first.remarks)
    if taken.keys == first.keys and (taken.stamped or not first.rivals):
        return remarks
    if taken.stamped:
        units = f"in {taken.keys.get('time_unit', 's')}, not {first.keys.get('time_unit', 's')}"
        return [*taken.remarks, f"time: {units}: so the gyros carry the vertical from rest to rest (a guess)"]
    turned = best.profile is not None and best.gyro is not None
    if first.stamped:
        why = ": in no unit do the gyros fit it" if turned else ", by its steps"
        remarks = [f"time: column {first.keys['time']!r} counts samples or ticks{why}"]
    if turned and best.gyro is not None:
        rate = _measured_gyro_scale(best, best.gyro) * taken.rate / best.gyro.value
        guess = f"rate_hz = {taken.rate:g} from the turns ({rate:.4g} found): a guess to some percent"
        remarks.append(f"time: {guess}; put the log's rate there")
    return remarks


def _measured_gyro_scale(best: Hypothesis, gyro: SensorScale) -> float:
    """Return the reading of the gyros for 1 °/s from the turns, near the scale of a hypothesis."""
    assert best.profile is not None
    rate = best.times.rate
    return best.profile.best_q(math.log(gyro.reading(rate) * rate / DEGREE)) * DEGREE / rate


def _scale_remark(kind: str, scale: SensorScale, evidence: Evidence, best: Hypothesis) -> str:
    """Return a sentence with a nominal and the measured scale."""
    measured = evidence.length if kind == ACCEL else _measured_gyro_scale(best, scale)
    off, per = f"({math.log(measured / scale.reading(best.times.rate)):+.1%})", COUNTS_PER[kind]
    if scale.unit is not None:
        return f"{scale.unit} (a guess): one {per} reads {measured:.4g} {off}"
    if scale.listed:
        return f"counts: {scale.value:.6g} counts per {per} as in data sheets, {measured:.4g} found {off}"
    return f"counts: {measured:.4g} counts per {per} found, and no data sheet has a value near it"


def _raw_table(columns: list[str], scale: float, per: str, zero: Any, unit: str = "count") -> dict[str, Any]:
    """Return the table of sensors in counts or volts."""
    value = float(f"{scale:.6g}")
    return {"columns": columns, "unit": unit, "scale": value, "scale_per": per, "offset": zero}


def _accel_table(draft: Draft, best: Hypothesis, evidence: Evidence) -> dict[str, Any]:
    """Return the table [log.accel], and add remarks on it."""
    columns, scale = list(draft.triads[ACCEL].columns), best.accel
    subject, unit, length = f"accelerometers: {', '.join(columns)}", draft.unit(ACCEL), evidence.length
    if unit is not None and ACCEL_UNITS[unit].kind != "raw":
        draft.say(f"{subject} in {unit} (from the name or the format), magnitude {length:.6g}")
        return {"columns": columns, "unit": unit}
    zero: Any = evidence.zero[0] if len(set(evidence.zero)) == 1 else evidence.zero
    if not evidence.rests:
        how = "a guess, for there are no rests, from their median magnitude"
    elif evidence.rests < 4:
        how = "a guess from too few rests: state the data sheet's"
    else:
        how = f"from {evidence.rests} rests"
    at_zero = f", zero at {zero}" if zero or scale.unit is None else ""
    nominal = f"V: {length:.4g} V per g found" if unit == "V" else _scale_remark(ACCEL, scale, evidence, best)
    draft.say(f"{subject} in {nominal}{at_zero} ({how})")
    if scale.unit is not None and not (zero and evidence.whole[ACCEL]):  # in a unit, a zero is a bias
        return {"columns": columns, "unit": scale.unit}
    raw = "V" if unit == "V" else "count"
    return _raw_table(columns, scale.value if scale.listed else float(f"{length:.4g}"), "g", zero, raw)


def _gyro_table(
    draft: Draft, best: Hypothesis, gyro: SensorScale, evidence: Evidence, rivals: Sequence[Hypothesis]
) -> dict[str, Any]:
    """Return the table [log.gyro], and add remarks on it."""
    columns = list(draft.triads[GYRO].columns)
    subject, table = f"gyros: {', '.join(columns)} in", {"columns": columns, "unit": gyro.unit}
    bias = [float(f"{b:.6g}") for b in evidence.bias]
    if gyro.unit is not None and draft.unit(GYRO) == gyro.unit:
        draft.say(f"{subject} {gyro.unit} (from the name or the format)")
        return table
    scales = {h.gyro.value for h in rivals if h.gyro is not None and h.gyro.listed and h.gyro.unit is None}
    # turns at an unknown rate give the product of scale and rate
    unsure = evidence.turns == 1 or draft.rate_guessed
    undecided = unsure and gyro.unit is None and bool(scales - {gyro.value})
    if best.profile is not None and not undecided:
        by = f"by {evidence.turns} turns" if evidence.turns > 1 else "by one turn"
        draft.say(f"{subject} {_scale_remark(GYRO, gyro, evidence, best)} ({by})")
        if gyro.unit is not None:
            return table
        offset = bias if np.abs(evidence.bias).max() > _LARGEST_BIAS * gyro.value else 0.0
        return _raw_table(columns, gyro.value, "deg/s", offset)
    if gyro.unit is None:
        fitting = " or ".join(f"{value:.6g}" for value in sorted(scales | {gyro.value}))
        turns = "only turn" if evidence.turns == 1 else "turns, each at another rate"
        reason = f"{fitting} per deg/s fit the {turns}" if undecided else "no turns show it"
        unknown = f"the offset is their reading at rest, the scale is unknown, for {reason}"
        draft.say(f"{subject} counts; {unknown}: put that of the data sheet there")
        return {"columns": columns, "unit": "count", "scale_per": "deg/s", "offset": bias}
    draft.say(f"{subject} {gyro.unit} (a guess)")
    if evidence.rests:
        length = float(np.linalg.norm(evidence.bias))
        sizes = (f"{length * GYRO_UNITS[u].factor / DEGREE:.2g} °/s in {u}" for u in ("rad/s", "deg/s", "mdeg/s"))
        draft.say(f"gyros: no turn shows their unit; at rest they read {length:.3g}: {', '.join(sizes)}")
    return table
