"""What a look at the recording says of a draft: the scales of counts, the unit of gyros, the rate, and what is wrong.

Accelerometers at rest read gravity, which tells their scale; gyros must carry the vertical from rest to rest, which
tells theirs, their unit, and the rate of a log without times. Where nothing turned, the Earth may tell their unit. The
log is read once: every candidate is a draft of its own, reduced from the same numbers.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np

from tumble.diagnosis.carried_vertical import fitting_unit, misses_by_unit
from tumble.drafting.draft import Draft
from tumble.drafting.hypotheses.rests_and_turns import (
    accel_scale,
    gyro_factor,
    more_than_gyros_read,
    reads_the_earth,
    telling_turns,
    tilts,
)
from tumble.drafting.times import ASSUMED_RATE, RATES_OF_LOGS
from tumble.errors import TumbleError
from tumble.recording.columns.names import ACCEL, GYRO
from tumble.recording.columns.scales import ScaleMatch, matched
from tumble.reduction.observations import Observations
from tumble.run.observed import Observed, Progress, inspect_session
from tumble.units import DEGREE, GYRO_UNITS

_LOW_RATES = 10, 12.5, 20, 25, 26, 50, 51.2, 52, 60, 62.5, 64, 100, 102.4, 104, 119, 120, 125, 128, 200, 204.8, 208
_HIGH_RATES = 238, 240, 250, 256, 300, 400, 416, 476, 500, 512, 800, 833, 952, 1000, 1024, 1600, 1660, 2000, 4000, 8000
_USUAL_RATES = tuple(map(float, (*_LOW_RATES, *_HIGH_RATES)))  # Hz
_DOUBLED_RATES = 25.0, 50.0, 100.0, 200.0, 400.0  # Hz: ranges are doubled too
_RATE_NEAR, _RATE_AGREES = 0.04, 1.7
_TRIAL_RATES = (ASSUMED_RATE, ASSUMED_RATE / 4.0, 4.0 * ASSUMED_RATE)
"""Hz: at too high a rate rests would be too short, at too low a one short ones pass."""
_FEWEST_TURNS = 3
"""Which the vertical moved in and no gyro was clipped in: a rate from fewer is as good as their worst."""
_RATE_UNITS = ("rad/s", "deg/s")
_EARTH_UNITS = ("rad/s", "deg/s", "deg/h")
"""Increments are not tried: in one of their units the usual biases of small gyros are the Earth's rate."""
_LARGEST_BIAS = 20.0  # deg/s: what reads more at rest has an offset


def tried(draft: Draft, progress: Progress) -> tuple[Draft, list[str]]:
    """A draft with what rests and turns say of its guesses, and the faults that are left."""
    looks = _Looks(progress=progress)
    if draft.log["accel"]["unit"] == "count":
        draft = _with_accel_scale(draft, looks)
    if draft.gyro_unknown and draft.log.get("gyro", {}).get("unit") == "count":
        draft = _with_gyro_scale(draft, looks)
    draft, turned = _with_gyro_unit(draft, looks)
    draft = _with_rate(_with_time_unit(draft, looks), turned, looks)
    return replace(draft, said=(*draft.said, *_evidence(draft, looks))), looks.at(draft).faults


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Look:
    """What a session of a candidate shows, None where it cannot be looked at, and what is wrong with it."""

    observed: Observed | None
    faults: list[str]

    @property
    def observations(self) -> Observations | None:
        return None if self.observed is None else self.observed.observations

    @property
    def turned(self) -> bool:
        return self.observations is not None and bool(self.observations.turns)

    @property
    def moves_the_vertical(self) -> bool:
        """Whether most turns end with another side up."""
        tilted = tilts(self.observations)
        return len(tilted) > 0 and 2 * int(np.count_nonzero(tilted)) >= len(tilted)

    def fitting_unit(self, of: Literal["gyro", "time"]) -> str | None:
        """The unit of the gyros, or of the times, that would fit better than the stated one."""
        found = self.observed
        if found is None or found.trial is None or not self.faults:
            return None
        return fitting_unit(found.trial, found.session, found.rate, of)


@dataclass(kw_only=True, slots=True)
class _Looks:
    """Looks at the recording, one for each candidate."""

    progress: Progress
    _taken: dict[str, _Look] = field(default_factory=dict)

    def at(self, draft: Draft) -> _Look:
        key = json.dumps(draft.content, sort_keys=True, default=str)
        if key not in self._taken:
            try:
                observed = inspect_session(draft.session(), progress=self.progress)
                self._taken[key] = _Look(observed=observed, faults=list(observed.faults))
            except (TumbleError, np.linalg.LinAlgError) as error:
                self._taken[key] = _Look(observed=None, faults=[str(error)])
        return self._taken[key]


# -------------------- counts, from rests and turns --------------------


def _with_accel_scale(draft: Draft, looks: _Looks) -> Draft:
    """With the scale and offset of accelerometers in counts, from the rests."""
    accel, named = draft.log["accel"], ", ".join(draft.log["accel"]["columns"])
    observations = looks.at(draft).observations
    if observations is None and "gyro" in draft.log:  # in counts they can hide the rests, which accelerometers show
        alone = {key: value for key, value in draft.log.items() if key != "gyro"}
        observations = looks.at(replace(draft, content={**draft.content, "log": alone})).observations
    means = observations.rests.accel if observations is not None else np.empty((0, 3))
    seen = f"from {len(means)} rests" if len(means) >= 4 else "a guess from too few rests: state the data sheet's"
    sphere = accel_scale(means)
    if sphere is None:
        radius = float(np.median(np.linalg.norm(means, axis=1))) if len(means) else draft.accel_magnitude
        seen = seen if len(means) else "a guess, for there are no rests, from their median magnitude"
        sphere = radius, [0.0] * 3
    offset: Any = sphere[1][0] if len(set(sphere[1])) == 1 else sphere[1]
    table = {"columns": accel["columns"], "unit": "count", "scale": 1.0, "scale_per": "g", "offset": offset}
    if sphere[0] == 0.0:
        said = f"accelerometers: {named} in counts; they read zero, so that the scale is unknown: put that of the "
        return draft.with_log([said + "data sheet there"], accel=table)
    scale = matched(ACCEL, sphere[0], whole=draft.accel_whole)
    table["scale"] = scale.value
    if scale.unit is not None:
        table = table if offset else {"columns": accel["columns"], "unit": scale.unit}
        return draft.with_log(
            [f"accelerometers: {named} in {scale.unit} ({scale.said}), zero at {offset} ({seen})"], accel=table
        )
    told = [f"accelerometers: {named} in counts: {scale.said}, zero at {offset} ({seen})"]
    if not (scale.known or draft.accel_whole):
        told.append(
            f"accelerometers: {named} are no whole numbers as counts are, and read gravity in no unit: are they volts, "
            "or what a filter has left without gravity? That cannot be calibrated"
        )
    return draft.with_log(told, accel=table)


def _with_gyro_scale(draft: Draft, looks: _Looks) -> Draft:
    """With the scale of gyros in counts, from the turns; the offset is none or the mean at rest."""
    gyro, named = draft.log["gyro"], ", ".join(draft.log["gyro"]["columns"])
    observations = looks.at(draft).observations
    bias = np.zeros(3) if observations is None else np.median(observations.rests.gyro, axis=0) / DEGREE
    centred = {**gyro, "offset": [float(f"{b:.6g}") for b in bias]}
    observations = looks.at(draft.with_log(gyro=centred)).observations
    factor = None if observations is None else gyro_factor(observations)
    if factor is None:
        said = f"gyros: {named} in counts; the offset is their reading at rest, the scale is unknown, for no turns "
        return draft.with_log([said + "show it: put that of the data sheet there"], gyro=centred)
    scale = matched(GYRO, factor, whole=draft.gyro_whole)
    if scale.unit is not None:
        said = f"gyros: {named} in {scale.unit}: so they carry the vertical from rest to rest: {scale.said}"
        return draft.with_log([said], gyro={"columns": gyro["columns"], "unit": scale.unit})
    high = float(np.abs(bias).max()) > _LARGEST_BIAS * scale.value
    said = f"gyros: {named} in counts: {scale.said} (from the turns)"
    return draft.with_log([said, *_doubts(draft, scale)], gyro={**(centred if high else gyro), "scale": scale.value})


def _doubts(draft: Draft, scale: ScaleMatch) -> list[str]:
    """That the time may be what is wrong: where the rate is a guess, what the counts are at other rates; where the unit
    of a time is one and no data sheet has what the turns show."""
    if draft.rate_guessed:
        at = {rate: matched(GYRO, scale.found * draft.rate / rate, whole=True) for rate in _DOUBLED_RATES}
        others = [f"{match.value:g} at {rate:g} Hz" for rate, match in at.items() if match.known and rate != draft.rate]
        return [f"gyros: the rate is a guess, and so is their scale: {', '.join(others)} would fit too"]
    if not draft.time_guessed or scale.known:
        return []
    return [
        f"time: the unit of column {draft.log['time']!r} is a guess, and no data sheet has the gyros' {scale.value:g} "
        "counts per deg/s: if it counts samples or ticks, give the rate (--sample-rate)"
    ]


# -------------------- the unit of the gyros --------------------


def _with_gyro_unit(draft: Draft, looks: _Looks) -> tuple[Draft, bool]:
    """A draft with the gyros' unit in which they carry the vertical from rest to rest, or, where nothing turned, read
    the rate of the Earth, or no more at rest than gyros do; and whether anything turned."""
    look, gyro = looks.at(draft), draft.log.get("gyro", {})
    fitting = look.fitting_unit("gyro")
    if draft.gyro_unknown and not look.turned and fitting is None and gyro["unit"] in _EARTH_UNITS:
        latitude_deg = draft.content.get("site", {}).get("latitude_deg")
        for unit in _EARTH_UNITS:
            trial = draft.with_log(gyro={**gyro, "unit": unit})
            observations = looks.at(trial).observations
            why = None if observations is None else reads_the_earth(observations, latitude_deg)
            if why is not None:
                return replace(trial, said=(*draft.said, f"gyros: in {unit}: {why}")), True
    if draft.gyro_unknown and not look.moves_the_vertical:
        observations = look.observations if gyro["unit"] == "rad/s" and not draft.gyro_whole else None
        why = None if observations is None else more_than_gyros_read(observations)
        if why is not None:
            gyro = {**gyro, "unit": "deg/s"}
            draft = draft.with_log([f"gyros: in deg/s, not rad/s (a guess): {why}"], gyro=gyro)
            look = looks.at(draft)
            fitting = look.fitting_unit("gyro")
    clocked = not (draft.rate_guessed or (draft.time_guessed and not draft.gyro_whole))  # else these may be wrong
    if look.faults and draft.gyro_unknown and clocked and fitting is None and gyro["unit"] == "rad/s":
        return _with_gyros_in_counts(draft, looks), True
    if fitting is not None and gyro["unit"] != "count" and look.moves_the_vertical:
        said = f"gyros: in {fitting}, not {gyro['unit']}: so they carry the vertical from rest to rest"
        trial = draft.with_log([said], gyro={**gyro, "unit": fitting})
        if not looks.at(trial).faults:
            return trial, True
    return draft, look.turned


def _with_gyros_in_counts(draft: Draft, looks: _Looks) -> Draft:
    """With the gyros in counts, where that makes them carry the vertical and no unit does."""
    observations = looks.at(draft).observations
    factor = None if observations is None else gyro_factor(observations)
    if factor is None:
        return draft
    scale = matched(GYRO, factor * DEGREE, whole=draft.gyro_whole)
    columns = draft.log["gyro"]["columns"]
    table = {"columns": columns, "unit": "count", "scale": scale.value, "scale_per": "deg/s", "offset": 0.0}
    said = f"gyros: not in rad/s but in counts: {scale.said}: so they carry the vertical from rest to rest"
    trial = draft.with_log([said, *_doubts(draft, scale)], gyro=table)
    return draft if looks.at(trial).faults else trial


def _evidence(draft: Draft, looks: _Looks) -> list[str]:
    """How well gyros whose unit is a guess carry the vertical in it, beside the next best unit; of those that nothing
    turned, what they read at rest in each."""
    gyro = draft.log.get("gyro")
    look = looks.at(draft)
    found, observations = look.observed, look.observations
    if gyro is None or gyro["unit"] == "count" or not draft.gyro_unknown or found is None or observations is None:
        return []
    unit = gyro["unit"]
    misses = misses_by_unit(observations, found.session, found.rate)
    rival = next((other for other in misses if other != unit), None)
    if rival is not None and look.moves_the_vertical:
        by, next_by = misses[unit] / DEGREE, misses[rival] / DEGREE
        told = f"they miss the vertical by {by:.2g}° after a turn, in {rival}, the next, by {next_by:.2g}°"
        return [f"gyros: in {unit} {told}"]
    bias = float(np.linalg.norm(np.median(observations.rests.gyro, axis=0)))
    bias /= GYRO_UNITS[unit].per_second(found.rate)
    sizes = [f"{bias * GYRO_UNITS[unit].factor / DEGREE:.2g} °/s in {unit}" for unit in ("rad/s", "deg/s", "mdeg/s")]
    return [f"gyros: no turn tells their unit; at rest they read {bias:.3g}: {', '.join(sizes)}"]


# -------------------- the time --------------------


def _with_time_unit(draft: Draft, looks: _Looks) -> Draft:
    """A draft whose times, if their unit is a guess, are in that in which the gyros carry the vertical."""
    unit = looks.at(draft).fitting_unit("time") if draft.time_guessed else None
    if unit is None:
        return draft
    before = draft.log.get("time_unit", "s")
    told = f"time: in {unit}, not {before}: so the gyros carry the vertical from rest to rest (a guess)"
    trial = draft.with_log([told], time_unit=unit)
    return draft if looks.at(trial).faults else trial


def _with_rate(draft: Draft, turned: bool, looks: _Looks) -> Draft:
    """A draft whose rate, if it or the unit of the time is a guess, is that at which gyros in a known unit carry the
    vertical from rest to rest; and where their unit is a guess too, in that unit which makes it a usual one."""
    log = draft.log
    doubted = draft.time_guessed and (bool(looks.at(draft).faults) or not turned)
    if not (draft.rate_guessed or doubted):
        return draft
    even = {key: value for key, value in log.items() if key not in ("time", "time_unit", "regular")}
    rests: dict[float, int] = {}
    for trial in _TRIAL_RATES:
        at_rate = replace(draft, content={**draft.content, "log": {**even, "rate_hz": trial}})
        observations = looks.at(at_rate).observations
        rests[trial] = 0 if observations is None else len(observations.rests)
        if "gyro" not in log or log["gyro"]["unit"] not in _RATE_UNITS or observations is None:
            continue
        factor = gyro_factor(observations) if telling_turns(observations) >= _FEWEST_TURNS else None
        if factor is not None and RATES_OF_LOGS[0] <= trial * factor <= RATES_OF_LOGS[1]:
            rate = trial * factor
            break
    else:
        counts = ", ".join(f"{count} at {rate:g} Hz" for rate, count in sorted(rests.items()))
        told = f"time: how many rests there are depends on the rate, which no turns show: {counts}"
        told += "; give it (--sample-rate)"
        return draft.with_log([told]) if draft.rate_guessed and len(set(rests.values())) > 1 else draft
    stated = unit = log["gyro"]["unit"]
    if draft.gyro_unknown:
        rates = {name: rate * GYRO_UNITS[name].factor / GYRO_UNITS[stated].factor for name in _RATE_UNITS}
        unit = next((name for name, at in rates.items() if _usual(at)), stated)
        rate = rates[unit]
    usual = _usual(rate)
    if doubted and not usual:
        told = (
            f"time: column {log['time']!r} is taken as it is written, though the gyros would carry the vertical at "
            f"{rate:.4g} samples per second: is their unit right? If it counts samples or ticks, give the rate "
            "(--sample-rate)"
        )
        return draft.with_log([told])
    gyro = {**log["gyro"], "unit": unit}
    if doubted and max(rate / draft.rate, draft.rate / rate) < _RATE_AGREES:
        told = f"gyros: in {unit}, not {stated}: so they carry the vertical at the rate of the times"
        # in the unit stated, the scale of the gyros is wrong, or a turn, and not the time
        return draft if unit == stated else draft.with_log([told], gyro=gyro)
    value, *rivals = usual or [float(f"{rate:.4g}")]
    also = f"{' or '.join(f'{rival:g}' for rival in rivals)} would fit too; " if rivals else ""
    seen = f"from the turns ({rate:.4g} found): a guess to some percent; {also}put the log's rate there"
    said = [f"time: rate_hz = {value:g} {seen}"]
    if doubted:
        said.insert(0, f"time: column {log['time']!r} counts samples or ticks: in no unit do the gyros fit it")
    if unit != stated:
        said.append(f"gyros: in {unit}, not {stated}: in that the rate is a usual one (a guess)")
    content: Mapping[str, Any] = {**draft.content, "log": {**even, "rate_hz": value, "gyro": gyro}}
    changed = replace(draft, content=content, said=(*draft.said, *said))
    return draft if doubted and looks.at(changed).faults else changed  # what is wrong may not be the time alone


def _usual(rate: float) -> list[float]:
    """The usual rates near to one, Hz, the nearest first."""
    ranked = sorted(_USUAL_RATES, key=lambda usual: abs(np.log(usual / rate)))
    return [usual for usual in ranked if abs(usual / rate - 1.0) < _RATE_NEAR]
