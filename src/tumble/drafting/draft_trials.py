"""What a look at the recording says of a draft: the scales of counts, the unit of gyros, the rate, and what is wrong.

Accelerometers at rest read gravity, which tells their scale; gyros must carry the vertical from rest to rest, which
tells theirs, their unit, and the rate of a log without times. Where nothing turned, the Earth may tell their unit.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tumble.calibration.observed import Observed, Progress, inspect_session
from tumble.drafting.draft import Draft
from tumble.drafting.gyro_unit_at_rest import more_than_gyros_read
from tumble.drafting.gyro_unit_by_earth import RATES, reads_the_earth
from tumble.drafting.log_times import ASSUMED_RATE, RATES_OF_LOGS
from tumble.drafting.raw_scale import accel_scale, gyro_factor
from tumble.errors import TumbleError
from tumble.estimation.diagnosis.carried_vertical import fitting_gyro_unit, fitting_time_unit, misses_by_unit
from tumble.recording.formats.columns import ACCEL, GYRO
from tumble.recording.formats.scales import ScaleMatch, matched
from tumble.recording.session_file import session_of
from tumble.reduction.observations import Observations
from tumble.rotation import unit_vector
from tumble.units import DEGREE, GYRO_UNITS

_LOW_RATES = 10, 12.5, 20, 25, 26, 50, 51.2, 52, 60, 62.5, 64, 100, 102.4, 104, 119, 120, 125, 128, 200, 204.8, 208
_HIGH_RATES = 238, 240, 250, 256, 300, 400, 416, 476, 500, 512, 800, 833, 952, 1000, 1024, 1600, 1660, 2000, 4000, 8000
_USUAL_RATES = np.array([*_LOW_RATES, *_HIGH_RATES])  # Hz
_DOUBLED_RATES = 25.0, 50.0, 100.0, 200.0, 400.0  # Hz: ranges are doubled too
_RATE_NEAR, _RATE_AGREES = 0.04, 1.7
_TRIAL_RATES = (ASSUMED_RATE, ASSUMED_RATE / 4.0, 4.0 * ASSUMED_RATE)
"""Hz: at too high a rate rests would be too short, at too low a one short ones pass."""
_FEWEST_TURNS = 3
"""Which the vertical moved in and no gyro was clipped in: a rate from fewer is as good as their worst."""
_RATE_UNITS = ("rad/s", "deg/s")
_TURNED = 0.99  # cosine of 8°
_LARGEST_BIAS = 20.0  # deg/s: what reads more at rest has an offset


def tried(draft: Draft, progress: Progress) -> tuple[Draft, list[str]]:
    """A draft with what rests and turns say of its guesses, and the faults that are left."""
    draft, faults, turned = _checked(_scaled(draft, progress), progress)
    draft, faults = _with_rate(draft, faults, turned, progress)
    return replace(draft, said=(*draft.said, *_evidence(draft, progress))), faults


# -------------------- counts and rates, from rests and turns --------------------


def _scaled(draft: Draft, progress: Progress) -> Draft:
    """A draft with the scales of counts, and the rate of a log without times, as rests and turns show them."""
    log = draft.content["log"]
    gyro = log.get("gyro")
    raw_gyro = gyro is not None and draft.gyro_unknown and gyro["unit"] == "count"
    raw_accel = log["accel"]["unit"] == "count"
    if not (raw_accel or raw_gyro):
        return draft
    observations = _observed(draft.content, progress)
    said: list[str] = []
    if raw_accel:
        log, more = _accel_scaled(log, observations, progress, draft)
        said += more
    if raw_gyro:
        content = {**draft.content, "log": log}
        observations = _observed(content, progress) if raw_accel else observations
        log, more = _gyro_scaled(replace(draft, content=content), observations, progress)
        said += more
    return replace(draft, content={**draft.content, "log": log}, said=(*draft.said, *said))


def _observed(content: Mapping[str, Any], progress: Progress) -> Observations | None:
    """Rests and turns of a session of this content; None where there are none."""
    found = _inspected(content, progress)
    return None if found is None else found.observations


def _inspected(content: Mapping[str, Any], progress: Progress) -> Observed | None:
    """What a look at a session of this content finds; None where it cannot be looked at."""
    try:
        return inspect_session(session_of(content), progress=progress)
    except (TumbleError, np.linalg.LinAlgError):
        return None


def _accel_scaled(
    log: Mapping[str, Any], observations: Observations | None, progress: Progress, draft: Draft
) -> tuple[dict[str, Any], list[str]]:
    """[log] with the scale and offset of accelerometers in counts, from the rests."""
    accel, named = log["accel"], ", ".join(log["accel"]["columns"])
    if observations is None and "gyro" in log:  # gyros in counts can hide the rests: the accelerometers alone show them
        alone = {key: value for key, value in log.items() if key != "gyro"}
        observations = _observed({**draft.content, "log": alone}, progress)
    means = observations.rests.accel if observations is not None else np.empty((0, 3))
    sphere = accel_scale(means)
    seen = f"from {len(means)} rests" if len(means) >= 4 else "a guess from too few rests: state the data sheet's"
    if sphere is None:
        radius = float(np.median(np.linalg.norm(means, axis=1))) if len(means) else draft.accel_magnitude
        seen = seen if len(means) else "a guess, for there are no rests, from their median magnitude"
        sphere = radius, [0.0] * 3
    offset: Any = sphere[1][0] if len(set(sphere[1])) == 1 else sphere[1]
    made = {"columns": accel["columns"], "unit": "count", "scale": 1.0, "scale_per": "g", "offset": offset}
    if sphere[0] == 0.0:
        said = f"accelerometers: {named} in counts; they read zero, so that the scale is unknown: put that of the "
        return {**log, "accel": made}, [said + "data sheet there"]
    scale = matched(ACCEL, sphere[0], whole=draft.accel_whole)
    if scale.unit is not None:
        told = [f"accelerometers: {named} in {scale.unit} ({scale.said}), zero at {offset} ({seen})"]
        if offset == 0.0:
            return {**log, "accel": {"columns": accel["columns"], "unit": scale.unit}}, told
        return {**log, "accel": made | {"scale": scale.value}}, told
    told = [f"accelerometers: {named} in counts: {scale.said}, zero at {offset} ({seen})"]
    if not (scale.known or draft.accel_whole):
        told.append(
            f"accelerometers: {named} are no whole numbers as counts are, and read gravity in no unit: are they volts, "
            "or what a filter has left without gravity? That cannot be calibrated"
        )
    return {**log, "accel": made | {"scale": scale.value}}, told


def _gyro_scaled(
    draft: Draft, observations: Observations | None, progress: Progress
) -> tuple[dict[str, Any], list[str]]:
    """[log] with the scale of gyros in counts, from the turns; the offset is none or the mean at rest."""
    content, log = draft.content, draft.content["log"]
    gyro, named = log["gyro"], ", ".join(log["gyro"]["columns"])
    bias = np.zeros(3) if observations is None else np.median(observations.rests.gyro, axis=0) / DEGREE
    centred = {**gyro, "offset": [float(f"{b:.6g}") for b in bias]}
    observations = _observed({**content, "log": {**log, "gyro": centred}}, progress)
    factor = None if observations is None else gyro_factor(observations)
    if factor is None:
        said = (
            f"gyros: {named} in counts; the offset is their reading at rest, the scale is unknown, for no turns show "
            "it: put that of the data sheet there"
        )
        return {**log, "gyro": centred}, [said]
    scale = matched(GYRO, factor, whole=draft.gyro_whole)
    if scale.unit is not None:
        said = f"gyros: {named} in {scale.unit}: so they carry the vertical from rest to rest: {scale.said}"
        return {**log, "gyro": {"columns": gyro["columns"], "unit": scale.unit}}, [said]
    high = float(np.abs(bias).max()) > _LARGEST_BIAS * scale.value
    made = {**(centred if high else gyro), "scale": scale.value}
    return {**log, "gyro": made}, [f"gyros: {named} in counts: {scale.said} (from the turns)", *_doubts(draft, scale)]


def _doubts(draft: Draft, scale: ScaleMatch) -> list[str]:
    """That the time may be what is wrong: where the rate is a guess, what the counts are at other rates; where the unit
    of a time is one and no data sheet has what the turns show."""
    if draft.rate_guessed:
        at = {rate: matched(GYRO, scale.found * draft.rate / rate, whole=True) for rate in _DOUBLED_RATES}
        others = [f"{match.value:g} at {rate:g} Hz" for rate, match in at.items() if match.known and rate != draft.rate]
        return [f"gyros: the rate is a guess, and so is their scale: {', '.join(others)} would fit too"]
    if not draft.time_guessed or scale.known:
        return []
    column = draft.content["log"]["time"]
    return [
        f"time: the unit of column {column!r} is a guess, and no data sheet has the gyros' {scale.value:g} counts "
        "per deg/s: if it counts samples or ticks, give the rate (--sample-rate)"
    ]


def _evidence(draft: Draft, progress: Progress) -> list[str]:
    """How well gyros whose unit is a guess carry the vertical in it, beside the next best unit; of those that nothing
    turned, what they read at rest in each."""
    gyro = draft.content["log"].get("gyro")
    if gyro is None or gyro["unit"] == "count" or not draft.gyro_unknown:
        return []
    found = _inspected(draft.content, progress)
    if found is None or found.observations is None:
        return []
    misses = misses_by_unit(found.observations, found.session, found.rate)
    unit = gyro["unit"]
    rival = next((other for other in misses if other != unit), None)
    if rival is not None and _moves_the_vertical(found.observations):
        by, next_by = misses[unit] / DEGREE, misses[rival] / DEGREE
        told = f"they miss the vertical by {by:.2g}° after a turn, in {rival}, the next, by {next_by:.2g}°"
        return [f"gyros: in {unit} {told}"]
    bias = float(np.linalg.norm(np.median(found.observations.rests.gyro, axis=0)))
    bias /= GYRO_UNITS[unit].per_second(found.rate)
    sizes = [f"{bias * GYRO_UNITS[unit].factor / DEGREE:.2g} °/s in {unit}" for unit in ("rad/s", "deg/s", "mdeg/s")]
    return [f"gyros: no turn tells their unit; at rest they read {bias:.3g}: {', '.join(sizes)}"]


def _with_time_unit(draft: Draft, faults: list[str], progress: Progress) -> tuple[Draft, list[str]]:
    """A draft whose times, if their unit is a guess, are in that in which the gyros carry the vertical."""
    found = _inspected(draft.content, progress) if draft.time_guessed and faults else None
    if found is None or found.trial is None:
        return draft, faults
    unit = fitting_time_unit(found.trial, found.session, found.rate)
    content = {**draft.content, "log": {**draft.content["log"], "time_unit": unit}}
    left = faults if unit is None else _looked_at(content, progress)[1]
    if left:
        return draft, faults
    before = draft.content["log"].get("time_unit", "s")
    told = f"time: in {unit}, not {before}: so the gyros carry the vertical from rest to rest (a guess)"
    return replace(draft, content=content, said=(*draft.said, told)), []


def _with_rate(draft: Draft, faults: list[str], turned: bool, progress: Progress) -> tuple[Draft, list[str]]:
    """A draft whose rate, if it or the unit of the time is a guess, is that at which gyros in a known unit carry the
    vertical from rest to rest; and where their unit is a guess too, in that unit which makes it a usual one."""
    draft, faults = _with_time_unit(draft, faults, progress)
    log = draft.content["log"]
    doubted = draft.time_guessed and (bool(faults) or not turned)
    if not (draft.rate_guessed or doubted):
        return draft, faults
    even = {key: value for key, value in log.items() if key not in ("time", "time_unit", "regular")}
    rests: dict[float, int] = {}
    found = None
    for trial in _TRIAL_RATES:
        observations = _observed({**draft.content, "log": {**even, "rate_hz": trial}}, progress)
        rests[trial] = 0 if observations is None else len(observations.rests)
        if "gyro" not in log or log["gyro"]["unit"] not in _RATE_UNITS or observations is None:
            continue
        factor = gyro_factor(observations) if _telling_turns(observations) >= _FEWEST_TURNS else None
        if factor is not None and RATES_OF_LOGS[0] <= trial * factor <= RATES_OF_LOGS[1]:
            found = trial * factor
            break
    if found is None:
        return (replace(draft, said=(*draft.said, *_rests_by_rate(rests))) if draft.rate_guessed else draft), faults
    unit, rate = _unit_and_rate(found, log["gyro"]["unit"], draft)
    if doubted and not rate.usual:
        told = (
            f"time: column {log['time']!r} is taken as it is written, though the gyros would carry the vertical at "
            f"{rate.found:.4g} samples per second: is their unit right? If it counts samples or ticks, give the rate "
            "(--sample-rate)"
        )
        return replace(draft, said=(*draft.said, told)), faults
    if doubted and max(rate.found / draft.rate, draft.rate / rate.found) < _RATE_AGREES:
        if unit == log["gyro"]["unit"]:  # the scale of the gyros is wrong, or a turn, and not the time
            return draft, faults
        content = _with_gyro_unit(draft.content, unit)
        told = f"gyros: in {unit}, not {log['gyro']['unit']}: so they carry the vertical at the rate of the times"
        return replace(draft, content=content, said=(*draft.said, told)), _looked_at(content, progress)[1]
    seen = f"{rate.found:.4g} found"
    said = [
        f"time: rate_hz = {rate.value:g} from the turns ({seen}): a guess to some percent; put the log's rate there"
    ]
    if doubted:
        said.insert(0, f"time: column {log['time']!r} counts samples or ticks: in no unit do the gyros fit it")
    if unit != log["gyro"]["unit"]:
        said.append(f"gyros: in {unit}, not {log['gyro']['unit']}: in that the rate is a usual one (a guess)")
    content = {**draft.content, "log": {**even, "rate_hz": rate.value, "gyro": {**log["gyro"], "unit": unit}}}
    left = _looked_at(content, progress)[1]
    if doubted and left:  # what is wrong is not the time alone
        return draft, faults
    return replace(draft, content=content, said=(*draft.said, *said)), left


def _telling_turns(observations: Observations) -> int:
    """How many turns end with another side up and have no clipped gyro, one that reads the most it reads in any turn
    in two samples in a row."""
    turns, samples = observations.turns, observations.turn_samples
    if turns is None or samples is None or not len(turns):
        return 0
    vertical = unit_vector(observations.rests.accel)
    tilted = (vertical[turns.first] * vertical[turns.last]).sum(axis=1) < _TURNED
    spans = zip(samples.start.tolist(), samples.stop.tolist(), strict=True)
    rates = [np.abs(samples.samples.read_with_spare(start, stop)[0]) for start, stop in spans]
    at_limit = [rate == np.max([each.max(axis=0) for each in rates], axis=0) for rate in rates]
    clipped = np.array([bool((each[1:] & each[:-1]).any()) for each in at_limit])
    return int(np.count_nonzero(tilted & ~clipped))


def _rests_by_rate(rests: Mapping[float, int]) -> list[str]:
    """What there is to say where the number of rests hangs on a rate that is a guess."""
    if len(set(rests.values())) < 2:
        return []
    counts = ", ".join(f"{count} at {rate:g} Hz" for rate, count in sorted(rests.items()))
    return [
        f"time: how many rests there are depends on the rate, which no turns show: {counts}; give it (--sample-rate)"
    ]


@dataclass(frozen=True, kw_only=True, slots=True)
class _Rate:
    """A rate, Hz, as found and as it is usual, if it is near to such a one."""

    found: float

    @property
    def value(self) -> float:
        return self._near if self.usual else float(f"{self.found:.4g}")

    @property
    def usual(self) -> bool:
        return abs(self._near / self.found - 1.0) < _RATE_NEAR

    @property
    def _near(self) -> float:
        return float(_USUAL_RATES[np.argmin(np.abs(np.log(_USUAL_RATES / self.found)))])


def _unit_and_rate(found: float, unit: str, draft: Draft) -> tuple[str, _Rate]:
    """The unit of the gyros and the rate; `found`, Hz, is the latter if the former is the one of the draft."""
    if not draft.gyro_unknown:
        return unit, _Rate(found=found)
    size = {name: found * GYRO_UNITS[name].factor / GYRO_UNITS[unit].factor for name in _RATE_UNITS}
    rates = {name: _Rate(found=rate) for name, rate in size.items()}
    return next(((name, rate) for name, rate in rates.items() if rate.usual), (unit, rates[unit]))


# -------------------- what the recording says of the guesses --------------------


def _checked(draft: Draft, progress: Progress) -> tuple[Draft, list[str], bool]:
    """A draft with the gyros' unit in which they carry the vertical from rest to rest, or, where nothing turned, read
    the rate of the Earth; the faults left; and whether anything turned."""
    unit, faults, turned = _looked_at(draft.content, progress)
    if draft.gyro_unknown and not turned and unit is None:
        still = _by_the_earth(draft, progress)
        if still is not draft:
            return still, _looked_at(still.content, progress)[1], True
    if draft.gyro_unknown and not (turned and _moves_the_vertical(_observed(draft.content, progress))):
        draft = _by_rests(draft, progress)
        unit, faults, turned = _looked_at(draft.content, progress)
    clocked = not (draft.rate_guessed or (draft.time_guessed and not draft.gyro_whole))  # else these may be wrong
    if faults and draft.gyro_unknown and clocked and unit is None and draft.content["log"]["gyro"]["unit"] == "rad/s":
        return *_in_counts(draft, faults, progress), True
    gyro = draft.content["log"].get("gyro")
    if (
        not faults
        or unit is None
        or gyro["unit"] == "count"
        or not _moves_the_vertical(_observed(draft.content, progress))
    ):
        return draft, faults, turned
    trial = _with_gyro_unit(draft.content, unit)
    if _looked_at(trial, progress)[1]:
        return draft, faults, turned
    said = f"gyros: in {unit}, not {gyro['unit']}: so they carry the vertical from rest to rest"
    return replace(draft, content=trial, said=(*draft.said, said)), [], True


def _moves_the_vertical(observations: Observations | None) -> bool:
    """Whether most turns end with another side up: where they do not, gyros taken for too small carry it too."""
    if observations is None or not observations.turns:
        return False
    vertical = unit_vector(observations.rests.accel)
    cosine = (vertical[observations.turns.first] * vertical[observations.turns.last]).sum(axis=1)
    return bool(np.median(cosine) < _TURNED)


def _by_the_earth(draft: Draft, progress: Progress) -> Draft:
    """A draft with the unit in which gyros that nothing has turned read the rate of the Earth."""
    if draft.content["log"]["gyro"]["unit"] not in RATES:
        return draft
    latitude_deg = draft.content.get("site", {}).get("latitude_deg")
    for unit in RATES:
        trial = _with_gyro_unit(draft.content, unit)
        observations = _observed(trial, progress)
        said = None if observations is None else reads_the_earth(observations, latitude_deg)
        if said is not None:
            return replace(draft, content=trial, said=(*draft.said, f"gyros: in {unit}: {said}"))
    return draft


def _by_rests(draft: Draft, progress: Progress) -> Draft:
    """A draft with gyros in deg/s, where they read more at rest than gyros do in rad/s."""
    gyro = draft.content["log"]["gyro"]
    observations = _observed(draft.content, progress) if gyro["unit"] == "rad/s" and not draft.gyro_whole else None
    why = None if observations is None else more_than_gyros_read(observations)
    if why is None:
        return draft
    told = f"gyros: in deg/s, not rad/s (a guess): {why}"
    return replace(draft, content=_with_gyro_unit(draft.content, "deg/s"), said=(*draft.said, told))


def _in_counts(draft: Draft, faults: list[str], progress: Progress) -> tuple[Draft, list[str]]:
    """A draft with the gyros in counts, where that makes them carry the vertical and no unit does."""
    log = draft.content["log"]
    factor = None if (observations := _observed(draft.content, progress)) is None else gyro_factor(observations)
    if factor is None:
        return draft, faults
    scale = matched(GYRO, factor * DEGREE, whole=draft.gyro_whole)
    gyro = {
        "columns": log["gyro"]["columns"],
        "unit": "count",
        "scale": scale.value,
        "scale_per": "deg/s",
        "offset": 0.0,
    }
    trial = {**draft.content, "log": {**log, "gyro": gyro}}
    left = _looked_at(trial, progress)[1]
    if left:
        return draft, faults
    said = f"gyros: not in rad/s but in counts: {scale.said}: so they carry the vertical from rest to rest"
    return replace(draft, content=trial, said=(*draft.said, said)), _doubts(draft, scale)


def _with_gyro_unit(content: Mapping[str, Any], unit: str) -> dict[str, Any]:
    log = content["log"]
    return {**content, "log": {**log, "gyro": {**log["gyro"], "unit": unit}}}


def _looked_at(content: Mapping[str, Any], progress: Progress) -> tuple[str | None, list[str], bool]:
    """The unit of the gyros that would fit better than the stated one, what a look at the recording finds wrong with a
    session of this content, and whether there are turns in it, as far as can be told."""
    try:
        found = inspect_session(session_of(content), progress=progress)
    except TumbleError as error:
        return None, [str(error)], False
    turned = found.observations is not None and bool(found.observations.turns)
    unit = None
    if found.trial is not None and found.faults:
        unit = fitting_gyro_unit(found.trial, found.session, found.rate)
    return unit, list(found.faults), turned
