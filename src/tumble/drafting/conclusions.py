"""Conclusions from the hypothesis of least cost: units, scales and times of a draft, remarks on how they were found,
and doubts about what would fit too."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from tumble.diagnosis.turn_likelihood import WIDTHS, Widths, columns_text
from tumble.drafting.draft import Draft
from tumble.drafting.hypotheses import Evidence, Hypothesis, evidence_of, ranked
from tumble.errors import InputError, TumbleError
from tumble.recording.columns.names import ACCEL, GYRO
from tumble.recording.columns.patterns import WITHOUT_GRAVITY
from tumble.recording.columns.scales import ONE, PER, KnownScale
from tumble.run.observed import Progress, inspect_session
from tumble.units import ACCEL_UNITS, DEGREE, GYRO_UNITS

_TOLERANCE = 0.3
"""Part of gravity by which the magnitude of accelerometers in a stated unit may be off."""
_LARGEST_BIAS = 20.0  # °/s: what reads more at rest has an offset
_MOST_RATES = 8
_TIME_KEYS = ("time", "time_unit", "regular", "rate_hz")


def completed(draft: Draft, progress: Progress, widths: Widths = WIDTHS) -> tuple[Draft, list[str]]:
    """Complete a draft, whose sensors are raw numbers, by what its rests and turns show: with units, scales and times,
    and the faults of its recording. `widths` are the standard deviations of the cost of hypotheses."""
    shown = evidence_of(draft, progress, widths)
    every = ranked(shown, draft, widths)
    best = every[0]
    near = [hypothesis for hypothesis in every[1:] if hypothesis.cost < best.cost + widths.near]
    log = {key: value for key, value in draft.log.items() if key not in _TIME_KEYS} | best.times.keys
    remarks = _of_times(draft, best)
    if ACCEL in draft.triads:
        log[ACCEL], of_accel = _accel(draft, best, shown)
        remarks += of_accel
    if best.gyro is not None:
        log[GYRO], of_gyro = _gyro(draft, best, best.gyro, shown, near)
        remarks += of_gyro
    doubts = (*_no_gravity(draft, best, shown), *_doubts(draft, log, best, near), *draft.doubts)
    log |= {"doubt": "; ".join(doubts)} if doubts else {}
    content = {**draft.content, "log": log}
    out = replace(draft, content=content, remarks=(*draft.remarks, *remarks), doubts=doubts, rate=best.times.rate)
    if ACCEL not in draft.triads:
        return out, []
    try:
        faults = list(inspect_session(out.session(), progress=progress).faults)
    except (TumbleError, np.linalg.LinAlgError) as error:
        faults = [str(error)]
    if best.profile is None or best.gyro is None:
        return out, faults
    if best.profile.exchanged:
        faults = [f"the gyros carry the vertical from rest to rest only where {columns_text(best.profile.exchange)}"]
    if not (best.gyro.known or best.accel.unit is None or draft.whole[GYRO]):
        written = f"; column {best.times.keys['time']!r} is taken as it is written" if best.times.stamped else ""
        faults.append(
            f"the gyros carry the vertical only with {best.gyro.value:.4g} numbers per deg/s, as in no unit and on no "
            f"data sheet{written}: is their unit right?"
        )
    return out, faults


def _no_gravity(draft: Draft, best: Hypothesis, shown: Evidence) -> Iterator[str]:
    """Doubts about accelerometers that do not read gravity, in the unit of their names or in any unit. Raises
    InputError if they read none and are named as linear acceleration."""
    if ACCEL not in draft.triads:
        return
    unit, columns = draft.unit(ACCEL), draft.triads[ACCEL].columns
    if unit is not None and ACCEL_UNITS[unit].kind != "raw":
        length = shown.length * ACCEL_UNITS[unit].per_second(best.times.rate) / ONE[ACCEL]
        if abs(length - 1.0) > _TOLERANCE:
            read = f"the accelerometers read {length:.3g} g at rest in {unit}, as their names say"
            yield f"{read}: if another unit is right, state --accel-unit; without gravity none is calibrated"
    elif not (best.accel.known or draft.whole[ACCEL] or unit == "V"):
        if WITHOUT_GRAVITY.search(columns[0]):
            raise InputError(
                f"{draft.files[0]}: expected readings of accelerometers, found linear acceleration, which a filter has "
                f"taken gravity off ({', '.join(columns)[:120]}); log the raw accelerometers"
            )
        seen = "the accelerometers read no whole numbers as counts are, and gravity in no unit"
        if shown.rests >= 4 and shown.length_u < _TOLERANCE:
            yield f"{seen}: rests in several attitudes read {shown.length:.4g} per g, which is taken for their scale"
        else:
            yield (
                f"{seen}: if they are volts, state --accel-unit V; what a filter has left without gravity cannot be "
                "calibrated"
            )


def _doubts(draft: Draft, log: Mapping[str, Any], best: Hypothesis, near: Sequence[Hypothesis]) -> Iterator[str]:
    """Doubts about units and rate: the consequence of each, and the option that settles it."""
    for kind, sensors, scale in ((ACCEL, "accelerometers", best.accel), (GYRO, "gyros", best.gyro)):
        if scale is None or kind not in draft.triads:
            continue
        with_accel = ACCEL in draft.triads
        alone = "the accelerometers alone are calibrated, " if with_accel else ""
        rivals = [h.accel if kind == ACCEL else h.gyro for h in near if kind in h.differs(best)]
        others = " or ".join(dict.fromkeys(rival.label for rival in rivals if rival is not None and rival.known))
        if log[kind]["unit"] == "count" and "scale" not in log[kind]:
            yield (
                f"no turn tells what the gyros' counts are worth: {alone}noise is as if one were 1 deg/s; put the data "
                "sheet's scale into [log.gyro]"
            )
        elif others and draft.unit(kind) is None:
            yield (
                f"{sensors} in {scale.label} by a guess, {others} would fit too: all their values hang on it; state "
                f"--{kind}-unit"
            )
    rates = [h.times.rate for h in near if "time" in h.differs(best)]
    if draft.rate_guessed or rates:
        how = "by the turns" if best.profile is not None else "by a guess"
        others = ", ".join(f"{rate:g}" for rate in list(dict.fromkeys(rates))[:_MOST_RATES])
        also = f", {others} would fit too" if rates else ""
        hang = "the gyros' scale factors hang" if best.gyro is not None else "how long rests are hangs"
        yield f"{best.times.rate:g} samples per second {how}{also}: {hang} on it; state --sample-rate"


def _of_times(draft: Draft, best: Hypothesis) -> list[str]:
    """Remarks on the times or the rate."""
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
        found = _found(best, best.gyro) * taken.rate / best.gyro.value
        guess = f"rate_hz = {taken.rate:g} from the turns ({found:.4g} found): a guess to some percent"
        remarks.append(f"time: {guess}; put the log's rate there")
    return remarks


def _found(best: Hypothesis, gyro: KnownScale) -> float:
    """Reading of the gyros for 1 °/s by the turns, near the scale of a hypothesis."""
    assert best.profile is not None
    rate = best.times.rate
    return best.profile.found(math.log(gyro.reads(rate) * rate / DEGREE)) * DEGREE / rate


def _comes_near(kind: str, scale: KnownScale, shown: Evidence, best: Hypothesis) -> str:
    """A unit or a count beside the length of gravity or the rate that the recording shows."""
    found, per = shown.length if kind == ACCEL else _found(best, scale), PER[kind]
    off = f"({math.log(found / scale.reads(best.times.rate)):+.1%})"
    if scale.unit is not None:
        return f"{scale.unit} (a guess): one {per} reads {found:.4g} {off}"
    if scale.known:
        return f"counts: {scale.value:.6g} counts per {per} as in data sheets, {found:.4g} found {off}"
    return f"counts: {found:.4g} counts per {per} found, and no data sheet has a value near it"


def _counts(columns: list[str], scale: float, per: str, zero: Any, unit: str = "count") -> dict[str, Any]:
    """The table of sensors in counts or volts."""
    value = float(f"{scale:.6g}")
    return {"columns": columns, "unit": unit, "scale": value, "scale_per": per, "offset": zero}


def _accel(draft: Draft, best: Hypothesis, shown: Evidence) -> tuple[dict[str, Any], list[str]]:
    """The table [log.accel] and remarks on it."""
    columns, scale = list(draft.triads[ACCEL].columns), best.accel
    named, unit, found = f"accelerometers: {', '.join(columns)}", draft.unit(ACCEL), shown.length
    if unit is not None and ACCEL_UNITS[unit].kind != "raw":
        remarks = [f"{named} in {unit} (from the name or the format), magnitude {found:.6g}"]
        return {"columns": columns, "unit": unit}, remarks
    zero: Any = shown.zero[0] if len(set(shown.zero)) == 1 else shown.zero
    seen = f"from {shown.rests} rests" if shown.rests >= 4 else "a guess from too few rests: state the data sheet's"
    seen = seen if shown.rests else "a guess, for there are no rests, from their median magnitude"
    about = f", zero at {zero}" if zero or scale.unit is None else ""
    near_to = f"V: {found:.4g} V per g found" if unit == "V" else _comes_near(ACCEL, scale, shown, best)
    remarks = [f"{named} in {near_to}{about} ({seen})"]
    if scale.unit is not None and not zero:
        return {"columns": columns, "unit": scale.unit}, remarks
    raw = "V" if unit == "V" else "count"
    return _counts(columns, scale.value if scale.known else float(f"{found:.4g}"), "g", zero, raw), remarks


def _gyro(
    draft: Draft, best: Hypothesis, gyro: KnownScale, shown: Evidence, near: Sequence[Hypothesis]
) -> tuple[dict[str, Any], list[str]]:
    """The table [log.gyro] and remarks on it."""
    columns, stated = list(draft.triads[GYRO].columns), draft.unit(GYRO)
    named, table = f"gyros: {', '.join(columns)} in", {"columns": columns, "unit": gyro.unit}
    centred = [float(f"{b:.6g}") for b in shown.bias]
    if gyro.unit is not None and stated == gyro.unit:
        return table, [f"{named} {gyro.unit} (from the name or the format)"]
    rivals = {h.gyro.value for h in near if h.gyro is not None and h.gyro.known and h.gyro.unit is None}
    alone = shown.turns == 1 and not draft.rate_guessed  # else the turn shows the product of scale and rate
    open_scale = alone and gyro.unit is None and bool(rivals - {gyro.value})
    if best.profile is not None and not open_scale:
        by = f"by {shown.turns} turns" if shown.turns > 1 else "by one turn"
        remark = f"{named} {_comes_near(GYRO, gyro, shown, best)} ({by})"
        if gyro.unit is not None:
            return table, [remark]
        offset = centred if np.abs(shown.bias).max() > _LARGEST_BIAS * gyro.value else 0.0
        return _counts(columns, gyro.value, "deg/s", offset), [remark]
    if gyro.unit is None:
        fitting = " or ".join(f"{value:.6g}" for value in sorted(rivals | {gyro.value}))
        shows = f"{fitting} per deg/s fit the only turn" if open_scale else "no turns show it"
        unknown = f"the offset is their reading at rest, the scale is unknown, for {shows}"
        counts = {"columns": columns, "unit": "count", "scale_per": "deg/s", "offset": centred}
        return counts, [f"{named} counts; {unknown}: put that of the data sheet there"]
    remarks = [f"{named} {gyro.unit} (a guess)"]
    if shown.rests:
        length = float(np.linalg.norm(shown.bias))
        sizes = (f"{length * GYRO_UNITS[u].factor / DEGREE:.2g} °/s in {u}" for u in ("rad/s", "deg/s", "mdeg/s"))
        remarks.append(f"gyros: no turn shows their unit; at rest they read {length:.3g}: {', '.join(sizes)}")
    return table, remarks
