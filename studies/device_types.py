"""Types instead of grades: coverage, gain and outliers of a prior that is learned from other units of a type.

A type is drawn once: the mean of every parameter from the usual spread of MEMS, units about it with a part of that
spread (`SPREAD`), drifts in every recording anew. Each unit is recorded twice by hand, with all the rests and with half
of them, and estimated by the method joint with the usual sizes of the grade. Then, for n known units out of the others,
the recording with half the rests is combined with the type (`tumble.inference.prior`), as `tumble calibrate --registry`
does. A unit is either a complete session, or drawn by the information of one (`--linear`): then its estimate has that
session's covariance, and thousands are cheap. Beside it stands what is possible at all: u where means and spreads of
the type are known exactly, and the power of the best test for an outlier.

    python studies/device_types.py --linear        1,000 units by the information of a session, some ten minutes
    python studies/device_types.py --units 150     complete sessions, a second a unit
    python studies/device_types.py --short         24 units by the information of a session, for a look
    python studies/device_types.py --chips FOLDER  leave one out over the eight chips of the recordings of mimu4444
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import polars as pl
from scipy.stats import t

from tumble.inference.estimate import Estimate
from tumble.inference.joint import joint
from tumble.inference.prior import with_prior
from tumble.inference.sources import UncertaintyBudget, source
from tumble.lab.device_type import Unit as Recorded
from tumble.lab.device_type import prior_of, unit_by, unit_of
from tumble.planning.setup import Setup
from tumble.recording.session_file import session_of
from tumble.reduction.observations import Observations
from tumble.run.calibrate import calibrate
from tumble.run.from_estimate import build_parameters
from tumble.sensors.grades import spread_of
from tumble.sensors.parameters import group_name, variable_of
from tumble.simulation.observations import simulate_observations
from tumble.simulation.scenario import scenario_of
from tumble.units import Array

SEED = 29
ALL, HALF = 24, 12
"""Rests."""
SPREAD = 0.2
"""Between units, in parts of the usual spread of the grade; another by --spread."""
OFFSET = 5.0
"""Of an outlier, in parts of the standard deviation of what a recording of a unit differs from its type by."""
KNOWN = (3, 5, 8, 20)
"""How many units are known."""
SETUP = Setup.of(grade="mems", positions=ALL, terms="full")


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Unit:
    """A unit: its true values, the estimates from all and from half the rests, what the latter was made from, and what
    the recording with all the rests says by itself."""

    truth: Mapping[str, float]
    whole: Estimate
    half: Estimate
    observations: Observations
    known: Recorded


def spreads_of(names: Sequence[str]) -> Array:
    """The usual spreads of parameters."""
    return np.array([SETUP.further.get(group_name(n)) or spread_of(SETUP, n) for n in names])


def truth_of(names: Sequence[str], number: int, part: float) -> Array:
    """True values of the unit of a number, of the type of the seed, with a part of the usual spreads between units."""
    mean = np.random.default_rng(SEED).standard_normal(len(names))
    own = np.random.default_rng([SEED, number]).standard_normal(len(names))
    changes = np.array([variable_of(name) == "time" for name in names])
    return spreads_of(names) * np.where(changes, own, mean + part * own)


def session(number: int, part: float) -> Unit:
    """The unit of a number, by complete sessions."""
    rng = np.random.default_rng([SEED, number, 1])
    drawn = scenario_of(SETUP, rng)
    drawn = replace(drawn, truth=dict(zip(drawn.names, truth_of(drawn.names, number, part).tolist(), strict=True)))
    estimates, observed = [], []
    for rests in (ALL, HALF):
        observed.append(simulate_observations(drawn.changed(by_hand=rests), rng))
        estimates.append(joint(observed[-1]))
    return _unit(number, drawn.truth, estimates, observed[-1])


def by_information(of: Unit, number: int, part: float) -> Unit:
    """A unit whose estimates have the covariances of another's: x = C (Λ x_true + e), e ~ N(0, Λ), C = (Λ + P)⁻¹."""
    rng, names = np.random.default_rng([SEED, number, 1]), of.whole.names
    truth, estimates = truth_of(names, number, part), []
    for each in (of.whole, of.half):
        assert each.budget is not None
        by_prior = [s.name.removeprefix("prior.") for s in each.budget.sources]
        further = np.array([name in SETUP.further for name in by_prior])
        data, size, inverse = _information(each)
        precision = np.array([SETUP.further.get(group_name(name), np.inf) ** -2.0 for name in names])
        C = np.linalg.inv((data + np.diag(precision)) * np.outer(size, size)) * np.outer(size, size)
        noise = inverse @ size_root(each.budget.covariances[~further].sum(axis=0)) @ rng.standard_normal(len(names))
        groups = [group_name(name) for name in names]
        sources = [(source("fit"), C @ data @ C)]
        for group in SETUP.further:
            own = np.array([g == group for g in groups])
            sources.append((source(f"prior.{group}"), C @ np.diag(precision * own) @ C))
        budget = UncertaintyBudget(sources=tuple(s for s, _ in sources), covariances=np.array([S for _, S in sources]))
        values = C @ (data @ truth + noise)
        widths = {g: SETUP.further[g] for g in SETUP.further}
        findings = tuple(replace(g, prior=widths[g.name], prior_widened=1.0, kept=True) for g in each.groups)
        estimates.append(
            replace(each, values=values, covariance=C, budget=budget, groups=findings, observable=np.ones(len(C)) > 0)
        )
    return _unit(number, dict(zip(names, truth.tolist(), strict=True)), estimates, of.observations)


def _information(estimate: Estimate) -> tuple[Array, Array, Array]:
    """What the data of an estimate say beside the usual sizes, (m, m); its u (m,), and C⁻¹ (m, m)."""
    assert estimate.budget is not None
    by_prior = [each.name.removeprefix("prior.") in SETUP.further for each in estimate.budget.sources]
    size = np.sqrt(np.diag(estimate.covariance))
    inverse = np.linalg.inv(estimate.covariance / np.outer(size, size)) / np.outer(size, size)
    return inverse @ estimate.budget.covariances[~np.array(by_prior)].sum(axis=0) @ inverse, size, inverse


def size_root(covariance: Array) -> Array:
    """A root R of a covariance, R Rᵀ."""
    size = np.sqrt(np.diag(covariance))
    value, vectors = np.linalg.eigh(covariance / np.outer(size, size))
    return np.asarray(size[:, None] * vectors * np.sqrt(np.maximum(value, 0.0)))


def _unit(number: int, truth: Mapping[str, float], estimates: Sequence[Estimate], observed: Observations) -> Unit:
    whole, half = estimates
    seen = np.flatnonzero(whole.observable)
    every, covariance = build_parameters(whole, seen), whole.covariance[np.ix_(seen, seen)]
    known = unit_by(every, covariance, serial=str(number), in_run={})
    return Unit(truth=truth, whole=whole, half=half, observations=observed, known=known)


def studied(units: Sequence[Unit], n: int, part: float, *, outliers: bool = False) -> dict[str, object]:
    """Every unit by half its rests beside n others: coverage of 95 % and rms of (value − truth)/u of the linear
    parameters and of the groups, and without the type; u over that of all the rests without the type, by group, root
    mean square; how many units are named unlike the type. With one accelerometer parameter of each, as it is estimated,
    OFFSET standard deviations off the mean of its type: how many are named for that, and how many the best test
    finds."""
    z: dict[str, list[tuple[float, float]]] = {}
    gain: dict[str, list[tuple[float, float, float]]] = {}
    named = found = judged = 0
    for number, each in enumerate(units):
        rng = np.random.default_rng([SEED, n, number])
        others = [i for i in rng.permutation(len(units)).tolist() if i != number][:n]
        known = prior_of([units[i].known for i in others], "type")
        estimate, truth = each.half, dict(each.truth)
        if outliers:
            name = str(rng.choice(estimate.names[:9]))
            i = estimate.names.index(name)
            mean = np.random.default_rng(SEED).standard_normal(len(estimate.names))[i]
            spread = float(spreads_of([name])[0])
            values, off = estimate.values.copy(), OFFSET * np.hypot(part * spread, estimate.u[i])
            values[i] = spread * mean + (off if rng.random() < 0.5 else -off)
            estimate = replace(estimate, values=values)
            judged = judged or len(known.names)
        made, said = with_prior(estimate, each.observations, known)
        unlike = [sentence for sentence in said if sentence.startswith("unlike")]
        named += bool(unlike)
        found += outliers and any(f" {name} " in sentence for sentence in unlike)
        for i, parameter in enumerate(made.names):
            if variable_of(parameter) == "time" or not made.observable[i]:
                continue
            kind = group_name(parameter)
            both = [(x.values[i] - truth[parameter]) / x.u[i] for x in (made, estimate)]
            z.setdefault(kind, []).append((both[0], both[1]))
            gain.setdefault(kind, []).append((made.u[i], each.whole.u[i], each.half.u[i]))
    linear = [g for g in z if g.split(".")[1] in ("bias", "scale", "axis")]
    linear_z = np.concatenate([z[g] for g in linear])
    further_z = np.concatenate([z[g] for g in z if g not in linear])
    k = 1.959964
    out: dict[str, object] = {"units known": n, "N": len(units), "named": named / len(units)}
    if outliers:
        best = {"best test": power(n, judged), "of one parameter alone": power(n, 1, share=1)}
        return out | {"offset": OFFSET, "found": found / len(units), "parameters": judged, **best}
    for what, all_z in (("linear", linear_z), ("further", further_z)):
        out[f"{what} parameters"] = len(all_z) // len(units)
        for by, own in (("", all_z[:, 0]), (" without type", all_z[:, 1])):
            out |= {f"{what} coverage{by}": float(np.mean(np.abs(own) < k))}
            out |= {f"{what} rms{by}": float(np.sqrt(np.mean(own**2)))}
    ratios = {g: np.sqrt(np.mean(np.square(gain[g]), axis=0)) for g in gain}
    out["u over all rests"] = {g: float(u[0] / u[1]) for g, u in ratios.items()}
    out["without type"] = {g: float(u[2] / u[1]) for g, u in ratios.items()}
    return out


def possible(of: Unit, part: float, correlation: float = 0.0) -> dict[str, object]:
    """u from half the rests where the means of the type and what units differ by are known exactly, over u from all the
    rests without a type, by group, root mean square: no prior that is learned does better. Parameters of a group are
    correlated between units by `correlation`."""
    names = of.whole.names
    groups, u = [group_name(name) for name in names], dict[str, Array]()
    for what, each in (("whole", of.whole), ("half", of.half)):
        data, size, _ = _information(each)
        precision = np.diag([SETUP.further.get(group, np.inf) ** -2.0 for group in groups])
        if what == "half":
            for group in {group for group, name in zip(groups, names, strict=True) if variable_of(name) != "time"}:
                at = np.array([i for i, own in enumerate(groups) if own == group])
                spread = part * spreads_of([names[i] for i in at])
                apart = correlation + (1.0 - correlation) * np.eye(len(at))
                precision[np.ix_(at, at)] = np.linalg.inv(np.outer(spread, spread) * apart)
        C = np.linalg.inv((data + precision) * np.outer(size, size)) * np.outer(size, size)
        u[what] = np.sqrt(np.diag(C))
    ratios = dict[str, float]()
    for group in dict.fromkeys(groups):
        at = np.array([i for i, own in enumerate(groups) if own == group])
        ratios[group] = float(np.linalg.norm(u["half"][at]) / np.linalg.norm(u["whole"][at]))
    return {"type known exactly, correlation": correlation, "u over all rests": ratios}


def power(n: int, parameters: int, share: int = 3, offset: float = OFFSET) -> float:
    """How often the best test, Student's, of 1 % over so many parameters finds a value `offset` standard deviations off
    the mean of a type by n units, which `share` parameters tell the standard deviation of."""
    rng, degrees, count = np.random.default_rng(SEED), share * (n - 1), 200_000
    limit = t.isf(0.5 * -np.expm1(np.log(0.99) / parameters), degrees) * np.sqrt(1.0 + 1.0 / n)
    size = np.sqrt(rng.chisquare(degrees, count) / degrees)
    return float(np.mean(np.abs(offset - rng.standard_normal(count) / np.sqrt(n)) > limit * size))


def chips(folder: Path) -> Iterator[dict[str, object]]:
    """Every chip of each recording of mimu4444 beside the seven others: how many of its values, by the recording alone,
    are within the 95 % that they predict, and which are named."""
    for file in sorted(folder.glob("exp_*.parquet")):
        log, known = pl.read_parquet(file), []
        for chip in range(1, 9):
            columns = {kind: [f"{kind[0]}{chip}{axis}" for axis in "xyz"] for kind in ("accel", "gyro")}
            content = {
                "format": 1,
                "device": {"serial": f"chip-{chip}", "model": "MPU-9150", "grade": "mems"},
                "site": {"latitude_deg": 59.35},
                "log": {
                    "time": "t",
                    "accel": {"columns": columns["accel"], "unit": "count", "scale": 2048.0, "scale_per": "g"},
                    "gyro": {"columns": columns["gyro"], "unit": "count", "scale": 16.4, "scale_per": "deg/s"},
                },
            }
            names = ["t", *columns["accel"], *columns["gyro"]]
            made = calibrate(session_of(content, {name: log[name].to_numpy().astype(float) for name in names}))
            known.append(unit_of(made))
        units = [each for each in known if each is not None]
        inside = dict[str, list[bool]]()
        for each in units:
            prior = prior_of([other for other in units if other is not each], "MPU-9150")
            for name, (value, variance) in each.alone().items():
                if name in prior.names:
                    i = prior.names.index(name)
                    off = abs(value - prior.mean[i]) / np.sqrt(variance + prior.covariance[i, i])
                    inside.setdefault(group_name(name), []).append(bool(off < 1.96))
        every = [each for group in inside.values() for each in group]
        groups = {group: round(float(np.mean(values)), 3) for group, values in inside.items()}
        yield {
            "recording": file.stem,
            "units": len(units),
            "values": len(every),
            "inside": float(np.mean(every)),
            **groups,
        }


def main() -> None:
    """The study, as JSON lines, and its answer."""
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("--short", action="store_true")
    arguments.add_argument("--linear", action="store_true")
    arguments.add_argument("--units", type=int, default=1000)
    arguments.add_argument("--known", type=int, nargs="*", default=KNOWN)
    arguments.add_argument("--spread", type=float, default=SPREAD)
    arguments.add_argument("--chips", type=Path)
    options = arguments.parse_args()
    if options.chips is not None:
        for line in chips(options.chips):
            print(json.dumps(line), flush=True)
        return
    part, count = options.spread, 24 if options.short else options.units
    first, honest = session(0, part), True
    if options.short or options.linear:
        units = [by_information(first, number, part) for number in range(count)]
    else:
        units = [first, *(session(number, part) for number in range(1, count))]
    for correlation in (0.0, 0.5, 0.9):
        print(json.dumps(possible(first, part, correlation)), flush=True)
    for n in KNOWN[:1] if options.short else options.known:
        found = studied(units, n, part)
        print(json.dumps(found), flush=True)
        for what in ("linear", "further"):
            error = np.sqrt(0.05 * 0.95 / float(str(found[f"{what} parameters"])))  # the means of the type are common
            honest &= float(str(found[f"{what} coverage"])) > 0.95 - 3.0 * error
        honest &= float(str(found["named"])) < 0.05
        if not options.short:
            print(json.dumps(studied(units[:300], n, part, outliers=True)), flush=True)
    print(f"Is a type of three units or more an honest prior? {'Yes' if honest else 'No'}")
    if not honest:
        sys.exit(1)


if __name__ == "__main__":
    main()
