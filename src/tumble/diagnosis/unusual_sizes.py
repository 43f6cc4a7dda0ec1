"""Findings from groups of parameters, drifts and in-run biases whose estimated sizes are far from the usual ones."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from tumble.advice import Advised, advised
from tumble.diagnosis.findings import BIAS_UNITS, IN_U, SENSORS, Finding, with_unit
from tumble.inference.estimate import Estimate, HyperparameterEstimate
from tumble.inference.linearisation import Linearisation
from tumble.sensors.parameters import group_of, shown_in
from tumble.units import two_digits

UNUSUAL_RATIO = 3.0
"""Ratio to the usual size above which, by the lower limit of the 68 % interval, an in-run bias or a drift is reported,
and the in-run bias of one sensor against those of its kind."""
UNUSUAL_GROUP_RATIO, WIDENED_RATIO = 5.0, 10.0
"""The same for the size of a group of parameters, and for the widening of its prior at the maximum."""


def unusual_groups(estimate: Estimate) -> Iterator[Finding]:
    """Yield the groups beyond the linear model, without drifts, that are far larger than usual, by kind of sensor."""
    sizes = {h.name: h for h in estimate.hyperparameters}
    by_kind = dict[str, dict[str, str]]()
    for finding in estimate.groups:
        group, size, widened = group_of(finding.name), sizes.get(finding.name), finding.prior_widened
        if group.variable == "time":
            continue
        if (widened if size is None else size.low) > UNUSUAL_GROUP_RATIO or widened > WIDENED_RATIO:
            unit, name = shown_in(group.name, group.unit, finding.prior)
            times, usual = max(0.0 if size is None else size.value, widened), two_digits(finding.prior / unit)
            words = f"{group.words} (about {times:.2g} times the usual {usual} {name})".replace(" °", "°")
            by_kind.setdefault(group.kind, {})[group.name] = words
    for kind, groups in by_kind.items():
        sentence = Advised(
            f"larger than usual: {', '.join(groups.values())}{IN_U}",
            "if the device is like that, state sizes in [device.prior] or another grade; otherwise look for "
            "disturbances in the log",
        )
        yield Finding(sentence=sentence, concerns=(kind,), causes=tuple(groups))


def usual_sizes(estimate: Estimate, linearised: Linearisation, factor: float = 1.0) -> dict[str, float]:
    """Return the usual sizes of the hyperparameters by name, SI.

    That of an in-run bias includes the standard deviation d T/√12 of a drift over the session, where d is `factor`
    times the usual drift, if the process includes the drift."""
    drift, duration = linearised.problem.observations.drift, _longest_session(linearised)
    by_drift = {f"{kind}_in_run": factor * rate * duration / np.sqrt(12.0) for kind, rate in drift.items()}
    return {h.name: float(np.hypot(h.usual, by_drift.get(h.name, 0.0))) for h in estimate.hyperparameters}


def _longest_session(linearised: Linearisation) -> float:
    """Return the time from the first rest of a session to its last, s, of the longest session."""
    rests, parts = linearised.problem.observations.rests, linearised.problem.session_spans
    return max(float(rests.stop[part.rests].max() - rests.start[part.rests].min()) for part in parts)


def varying_parameters(estimate: Estimate, linearised: Linearisation) -> Iterator[Finding]:
    """Yield drifts of biases and scale factors, and in-run biases, that are far larger than usual."""
    by_name, problem = {h.name: h for h in estimate.hyperparameters}, linearised.problem
    longest, usual = _longest_session(linearised), usual_sizes(estimate, linearised)

    def unusual(name: str) -> HyperparameterEstimate | None:
        size = by_name.get(name)
        return size if size is not None and size.low > UNUSUAL_RATIO * usual[name] else None

    def finding(cause: str, parameters: str, found: str, remedy: str = "") -> Finding:
        sentence = advised(f"{found}{IN_U}", remedy)
        return Finding(sentence=sentence, concerns=(parameters,), causes=(cause,), unsteady=True)

    for block in problem.instrument.blocks:
        kind, words, unit = block.kind, SENSORS[block.kind], BIAS_UNITS[block.kind]
        for what, cause, parameters, drift_unit in (
            ("bias", "drift", f"biases of the {words}", unit),
            ("scale", "scale-factor drift", f"scale factors of the {words}", "ppm"),
        ):
            name = f"{kind}.{what}.drift"
            if unusual(name):
                if name in problem.instrument.members:
                    drifts = estimate.values[problem.instrument.members[name]]
                else:  # of the sessions
                    assert estimate.own is not None
                    drifts = estimate.own.values[:, problem.local_members[name]]
                changed = with_unit(longest * float(np.abs(drifts).max()), drift_unit)
                yield finding(
                    cause,
                    f"{kind}.{what}",
                    f"{parameters} drift by {changed} over the session, the values given are means over its rests",
                    "let the device warm up, or make the session shorter",
                )
        size, time = by_name.get(f"{kind}_in_run"), by_name.get(f"{kind}_time")
        if size is None or time is None:
            continue
        in_run = with_unit(size.value, unit)
        if unusual(size.name) and not unusual(f"{kind}.bias.drift"):
            beside = with_unit(usual[size.name], unit)
            found = f"biases of the {words} wander by {in_run} in the session, where {beside} is usual"
            if time.value > longest:
                found += ", and last longer than the session: a drift, a jump, or warm-up after power-on"
                yield finding("drift", f"{kind}.bias", found, "switch on earlier")
            else:
                yield finding("in-run bias", f"{kind}.bias", found)
        for sensor in block.sensors:
            if ratio := unusual(f"{kind}.in_run.{sensor}"):
                wander = with_unit(ratio.value * size.value, unit)
                found = f"{kind}.bias.{sensor} wanders by {wander}, those of the other {words} by {in_run}"
                yield finding("wandering sensor", f"{kind}.bias", found)
