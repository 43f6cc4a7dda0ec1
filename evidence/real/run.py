"""Every program on every real recording, and what two scores without a reference say of them.

    python -m evidence.real.run                 all cases, to evidence/results/real.json, and the figures in pages
    python -m evidence.real.run xsens-mti kim   some sources, printed and not written
    python -m evidence.real.run --programs 'imu*'    some programs: computed and kept, nothing written

What is computed is kept (`evidence.work`): a run that is stopped goes on where it was.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import re
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from fnmatch import fnmatch
from functools import lru_cache
from typing import Any

import numpy as np

from evidence import programs as benchmark
from evidence.case import Case, Estimate, Kind, Refusal
from evidence.pages import OURS, write
from evidence.real.cases import READERS, cases, missing
from evidence.real.page import RESULTS, real_losses
from evidence.real.scores import folds, prediction, repeatability
from evidence.score import row_of
from evidence.state import FOLDER, digest_of, made_now
from evidence.work import Entry, Told, answers

SCORES = ("force", "shape", "tilt")
PROGRAMS = (OURS, benchmark.LINEAR.name, *(p.name for p in benchmark.PROGRAMS if p.name != OURS))
CHIPS = tuple(range(1, 9))
"""Of the array."""
FEWER: Mapping[str, tuple[int, ...]] = {"imu-calib": (1, 6)}
"""Chips of the array, one of either side of the board, for programs that take long."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Fit:
    """What a program made of a case, or of a part of it, what that predicts of others, by their names, and the seconds
    of the processor that it took."""

    found: Estimate | Refusal
    predicted: Mapping[str, Mapping[str, Any]]
    seconds: float

    def gives(self, kind: Kind) -> bool:
        """Whether the program has these sensors and stands by them."""
        return isinstance(self.found, Estimate) and self.found.gives(kind)

    def accepted_part(self) -> Estimate | None:
        """The sensors the program stands by; None without accelerometers."""
        if isinstance(self.found, Refusal) or not self.found.gives("accel"):
            return None
        return self.found if self.found.gives("gyro") else replace(self.found, gyro=None, gyro_bias=None)


# -------------------- fits, and what is told of them --------------------


@dataclass(frozen=True, slots=True)
class Part:
    """Makes a case anew in any process: a recording, or what is fitted or held out in one of its folds."""

    source: str
    recording: str
    fold: int | None = None
    held: bool = False

    @property
    def name(self) -> str:
        """Of the case."""
        role = "held out" if self.held else "fitted"
        return self.recording if self.fold is None else f"{self.recording}, fold {self.fold + 1}, {role}"

    def __call__(self) -> Case:
        whole = recording_of(self.source, self.recording)
        return whole if self.fold is None else replace(folds(whole)[self.fold][self.held], name=self.name)


@lru_cache(maxsize=4)
def recording_of(source: str, name: str) -> Case:
    """The recording of a name, read once for what is fitted to it and predicted of it."""
    return next(case for case in cases(source) if case.name == name)


@dataclass(frozen=True, slots=True)
class Predicts:
    """Tells what a program made of a case, and what that predicts of others."""

    unseen: tuple[Part, ...]

    def __call__(self, case: Case, program: str, found: Estimate | Refusal) -> dict[str, Any]:  # noqa: ARG002
        if isinstance(found, Estimate):
            try:
                told = {part.name: asdict(prediction(found, part())) for part in self.unseen}
                return {"found": content_of(found), "predicted": told}
            except Exception as error:  # as of the program
                found = Refusal(reason=f"failed, {type(error).__name__}: {error}")
        return {"found": content_of(found), "predicted": {}}


def of_case(case: str, programs: Sequence[str]) -> list[str]:
    """The programs that are to have it."""
    chip = re.search(r" chip (\d)", case)
    return [name for name in programs if not chip or name not in FEWER or int(chip[1]) in FEWER[name]]


def key_of(case: Case) -> str:
    """The hash of all that a program is told."""
    digest = hashlib.sha256(repr((case.gravity, case.gravity_u, case.latitude, case.programme, case.table)).encode())
    digest.update(repr((sorted(case.sections.items()), case.turn_angle, case.clock_ppm_u)).encode())
    for readings in (case.time, case.accel, case.gyro):
        digest.update(b"" if readings is None else np.ascontiguousarray(readings).tobytes())
    return digest.hexdigest()


def content_of(found: Estimate | Refusal) -> dict[str, Any]:
    """As a file has it."""
    if isinstance(found, Refusal):
        return {"reason": found.reason}
    arrays = {name: getattr(found, name) for name in ("accel", "accel_bias", "gyro", "gyro_bias")}
    return {
        **{name: None if value is None else np.asarray(value).tolist() for name, value in arrays.items()},
        "u": None if found.u is None else dict(found.u),
        "expanded": None if found.expanded is None else dict(found.expanded),
        "accepted": found.accepted, "refused": sorted(found.refused), "verdict": found.verdict,
    }  # fmt: skip


def found_from(content: Mapping[str, Any]) -> Estimate | Refusal:
    """The same back."""
    if "reason" in content:
        return Refusal(**content)
    accel, accel_bias, gyro, gyro_bias = (
        None if content[name] is None else np.array(content[name], dtype=float)
        for name in ("accel", "accel_bias", "gyro", "gyro_bias")
    )
    return Estimate(
        accel=accel, accel_bias=accel_bias, gyro=gyro, gyro_bias=gyro_bias,
        u=content["u"], expanded=content["expanded"], accepted=content["accepted"],
        refused=frozenset(content["refused"]), verdict=content["verdict"],
    )  # fmt: skip


# -------------------- results --------------------


def rounded(value: float | None) -> float | None:
    """To four digits."""
    return None if value is None else float(f"{value:.3e}")


def predictions(of: Mapping[tuple[str, str], Fit], programs: Iterable[str],
                pairs: Iterable[tuple[str, str]]) -> Iterator[dict[str, Any]]:  # fmt: skip
    """Of every pair, what was fitted and what is predicted, a row a program."""
    for trained, unseen in pairs:
        for program in programs:
            if (trained, program) not in of:
                continue
            told = of[trained, program].predicted.get(unseen, {})
            numbers = {name: rounded(told[name]) for name in SCORES if told.get(name) is not None}
            counts = {name: told[name] for name in ("rests", "turns") if name in told}
            yield {"fitted": trained, "predicted": unseen, "program": program, **counts, **numbers}


def pairs_of(real: Mapping[Part, Case]) -> list[tuple[Part, Part]]:
    """What is fitted and what is predicted: of a device with several sessions the next session, else folds of the
    recording."""
    pairs = []
    sessions: dict[str, list[Part]] = {}
    for part, case in real.items():
        sessions.setdefault(case.device, []).append(part)
    for device, of_device in sessions.items():
        if "mimu4444" in device and len(of_device) > 1:
            pairs += [(of_device[i], of_device[(i + 1) % len(of_device)]) for i in range(len(of_device))]
            continue
        for part in of_device:
            try:
                cut = folds(real[part])
            except Exception as error:  # no rests
                print(f"{part.name}: {error}", file=sys.stderr)
                continue
            pairs += [(replace(part, fold=i), replace(part, fold=i, held=True)) for i in range(len(cut))]
    return pairs


def entries_of(whole: Mapping[Part, Case], pairs: Iterable[tuple[Part, Part]]) -> list[Entry]:
    """All that is to be fitted, each with what it is to predict."""
    scores = digest_of(FOLDER / "real" / "scores.py", FOLDER / "peers" / "rests.py")
    keys = {part: key_of(case) for part, case in whole.items()}
    unseen: dict[Part, list[Part]] = {part: [] for part in whole}
    for fitted, held in pairs:
        unseen.setdefault(fitted, []).append(held)
    return [
        Entry(
            name=part.name,
            kind=part.source,
            key=" ".join((scores, *(keys.get(one) or key_of(one()) for one in (part, *held)))),
            make=part,
            tell=Predicts(tuple(held)),
        )
        for part, held in unseen.items()
    ]


@dataclass(frozen=True, kw_only=True, slots=True)
class Plan:
    """Cases by what makes them, and what is fitted to predict what."""

    cases: Mapping[Part, Case]
    pairs: Sequence[tuple[Part, Part]]


def planned(names: Sequence[str], chips: Sequence[int] = CHIPS) -> Plan:
    """The cases of these sources, or of all, of the array those of some chips."""
    kept = tuple(f"chip {chip}" for chip in chips)
    every = {
        Part(source, case.name): case
        for source in names or READERS
        for case in cases(source)
        if "chip" not in case.name or case.name.endswith(kept)
    }
    return Plan(cases=every, pairs=pairs_of({part: case for part, case in every.items() if case.truth is None}))


def results_of(plan: Plan, told: Mapping[tuple[str, str], Told]) -> dict[str, Any]:
    """All results, of what all programs made of all cases."""
    whole, pairs, programs = list(plan.cases.values()), plan.pairs, PROGRAMS
    real = [case for case in whole if case.truth is None]
    of = {
        (case, program): Fit(
            found=found_from(each.content["found"]), predicted=each.content["predicted"], seconds=each.seconds
        )
        for (case, program), each in told.items()
    }
    rows = []
    for case in whole:
        for program in programs:
            if (case.name, program) not in of:
                continue
            fit = of[case.name, program]
            found = fit.found
            rows.append({
                "case": case.name, "kind": case.kind, "program": program,
                "accel": fit.gives("accel"), "gyro": fit.gives("gyro"),
                "said": (found.reason if isinstance(found, Refusal) else found.verdict)[:300],
                "estimate": not isinstance(found, Refusal),
            })  # fmt: skip
    devices: dict[str, dict[str, list[Estimate | None]]] = {}
    for case in real:
        if "mimu4444" in case.device:
            for program in programs:
                if (case.name, program) not in of:
                    continue
                of_device = devices.setdefault(program, {}).setdefault(case.device, [])
                of_device.append(of[case.name, program].accepted_part())
    repeated = {program: repeated_of(devices[program], devices[OURS]) for program in devices}
    truths = [
        row_of(case, program, of[case.name, program].found).content()
        for case in whole if case.truth is not None for program in programs
    ]  # fmt: skip
    return {
        "made": {
            **made_now("src", "evidence/*.py"),
            "cases": len(real),
            "programs": list(programs),
            "fewer": {program: [f"chip {chip}" for chip in chips] for program, chips in FEWER.items()},
            "missing": missing(),
        },
        "recordings": recordings(real),
        "rows": rows,
        "predictions": list(predictions(of, programs, [(fitted.name, held.name) for fitted, held in pairs])),
        "repeatability": repeated,
        "seconds": {
            program: round(
                float(np.median([of[case.name, program].seconds for case in real if (case.name, program) in of])), 3
            )
            for program in programs
        },
        "simulated_by_others": truths,
    }


def repeated_of(
    devices: Mapping[str, Sequence[Estimate | None]], first: Mapping[str, Sequence[Estimate | None]]
) -> dict[str, Any]:
    """By group, the repeatability of a program over sessions, None where it stands by nothing, and its standard
    deviation over that of the first program in the sessions that both have."""
    made = repeatability([one for one in sessions if one is not None] for sessions in devices.values())
    both = [
        [(one, other) for one, other in zip(devices[name], first[name], strict=True) if one and other]
        for name in devices
    ]  # fmt: skip
    own, others = (repeatability([[pair[side] for pair in pairs] for pairs in both]) for side in (0, 1))
    return {
        group: {
            "deviation": rounded(deviation), "degrees": made.degrees[group], "over_u": rounded(made.over_u[group]),
            "over_first": rounded(own.deviation[group] / others.deviation[group])
            if own.degrees.get(group) and own.degrees[group] == others.degrees.get(group) and own.deviation[group]
            else None,
        }
        for group, deviation in made.deviation.items()
    }  # fmt: skip


def recordings(real: Sequence[Case]) -> list[dict[str, Any]]:
    """What there is, by source: chips of an array that were recorded together are one recording."""
    out: dict[str, dict[str, Any]] = {}
    for case in real:
        name = next(each for each in READERS if case.name.startswith(each))
        one = out.setdefault(name, {"source": name, "recordings": set(), "devices": set(), "cases": 0})
        one["recordings"].add(case.name.partition(" chip")[0])
        one["devices"].add(case.device)
        one["cases"] += 1
        one["licence"], one["address"] = case.licence, case.source
    return [{**one, "recordings": len(one["recordings"]), "devices": len(one["devices"])} for one in out.values()]


def main() -> None:
    parser = argparse.ArgumentParser(description="Programs on real recordings")
    parser.add_argument("sources", nargs="*", choices=[[], *READERS], help="some; all where none is named")
    parser.add_argument("--programs", nargs="+", default=["*"], help="some, by patterns such as 'imu*'")
    parser.add_argument("--workers", type=int, default=0, help="processes; one a core where it is not given")
    parser.add_argument("--scheduler", help="of a dask cluster, as tcp://HOST:PORT")
    parser.add_argument("--chips", type=int, nargs="+", default=CHIPS, help="of the array (default all eight)")
    given = parser.parse_args()
    plan = planned(given.sources, given.chips)
    programs = [p for p in PROGRAMS if any(fnmatch(p, pattern) for pattern in given.programs)]
    entries = entries_of(plan.cases, plan.pairs)
    told = answers(
        [(entry, of_case(entry.name, programs)) for entry in entries], workers=given.workers,
        scheduler=given.scheduler, say=lambda words: print(f"\r{words}", end="", file=sys.stderr, flush=True),
    )  # fmt: skip
    print(file=sys.stderr)
    if programs != list(PROGRAMS):
        return
    results = results_of(plan, told)
    if given.sources:
        print(real_losses(results))
        return
    RESULTS.parent.mkdir(exist_ok=True)
    RESULTS.write_text(json.dumps(results, ensure_ascii=False, indent=1) + "\n", encoding="utf-8")
    write()


if __name__ == "__main__":
    main()
