"""Every program on every real recording, and what two scores without a reference say of them.

    python -m evidence.real.run                 all cases, to evidence/results/real.json and docs/evidence/real.md
    python -m evidence.real.run xsens-mti kim   some sources, printed and not written
    python -m evidence.real.run --page          the page of the results that are there

What one program made of one case is a file in evidence/cache, by a hash of the readings, the program and its sources: a
run that is stopped goes on where it was.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass, replace
from multiprocessing import get_context
from typing import Any

import numpy as np

from evidence import programs as benchmark
from evidence.case import Case, Estimate, Kind, Refusal
from evidence.pages import OURS
from evidence.real.cases import READERS, cases, missing
from evidence.real.page import RESULTS, real_page
from evidence.real.scores import folds, prediction, repeatability
from evidence.score import row_of
from evidence.state import CACHE, FOLDER, digest_of, file_of, keep, made_now, source_of

SCORES = ("force", "shape", "tilt")
CHIPS = (1, 6)
"""Of the eight of the array, one of either side of the board."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Fit:
    """What a program made of a case, or of a part of it, and what that predicts of others, by their names."""

    case: str
    program: str
    found: Estimate | Refusal
    predicted: Mapping[str, Mapping[str, Any]]

    def gives(self, kind: Kind) -> bool:
        """Whether the program has these sensors and stands by them."""
        return isinstance(self.found, Estimate) and self.found.gives(kind)

    def accepted_part(self) -> Estimate | None:
        """The sensors the program stands by; None without accelerometers."""
        if isinstance(self.found, Refusal) or not self.found.gives("accel"):
            return None
        return self.found if self.found.gives("gyro") else replace(self.found, gyro=None, gyro_bias=None)


# -------------------- fits and their files --------------------


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
        return {"reason": found.reason, "seconds": found.seconds}
    arrays = {name: getattr(found, name) for name in ("accel", "accel_bias", "gyro", "gyro_bias")}
    return {
        **{name: None if value is None else np.asarray(value).tolist() for name, value in arrays.items()},
        "u": None if found.u is None else dict(found.u),
        "expanded": None if found.expanded is None else dict(found.expanded),
        "accepted": found.accepted, "refused": sorted(found.refused), "verdict": found.verdict,
        "seconds": found.seconds,
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
        refused=frozenset(content["refused"]), verdict=content["verdict"], seconds=content["seconds"],
    )  # fmt: skip


def fitted(case: Case, program: str, unseen: Sequence[Case]) -> dict[str, Any]:
    """What a program makes of a case, and what that predicts of others, as a file has it; an error of a program is a
    refusal with its name."""
    try:
        found = benchmark.named(program).calibrate(case)
        told = {} if isinstance(found, Refusal) else {one.name: asdict(prediction(found, one)) for one in unseen}
    except Exception as error:
        found, told = Refusal(reason=f"failed, {type(error).__name__}: {error}"), {}
    return {"found": content_of(found), "predicted": told}


def fits(todo: Sequence[tuple[Case, Sequence[Case]]], programs: Sequence[str], workers: int) -> list[Fit]:
    """All programs on all these cases, each with those that it is to predict, from their files where they are there."""
    scores = digest_of(FOLDER / "real" / "scores.py", FOLDER / "peers" / "rests.py")
    jobs = []
    for case, unseen in todo:
        key = " ".join(map(key_of, (case, *unseen)))
        for program in programs:
            jobs.append((case, program, unseen, file_of(CACHE / "real", key, program, source_of(program), scores)))
    pending = [job for job in jobs if not job[-1].exists()]
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        made = {pool.submit(fitted, case, name, unseen): path for case, name, unseen, path in pending}
        for number, done in enumerate(as_completed(made), start=1):
            keep(made[done], json.dumps(done.result()))
            print(f"\r{number} of {len(pending)} fits", end="", file=sys.stderr, flush=True)
    out = []
    for case, program, _, path in jobs:
        content = json.loads(path.read_text(encoding="utf-8"))
        found = found_from(content["found"])
        out.append(Fit(case=case.name, program=program, found=found, predicted=content["predicted"]))
    return out


# -------------------- results --------------------


def rounded(value: float | None) -> float | None:
    """To four digits."""
    return None if value is None else float(f"{value:.3e}")


def predictions(of: Mapping[tuple[str, str], Fit], programs: Iterable[str],
                pairs: Iterable[tuple[str, str]]) -> Iterator[dict[str, Any]]:  # fmt: skip
    """Of every pair, what was fitted and what is predicted, a row a program."""
    for trained, unseen in pairs:
        for program in programs:
            told = of[trained, program].predicted.get(unseen, {})
            numbers = {name: rounded(told[name]) for name in SCORES if told.get(name) is not None}
            counts = {name: told[name] for name in ("rests", "turns") if name in told}
            yield {"fitted": trained, "predicted": unseen, "program": program, **counts, **numbers}


def pairs_of(whole: Sequence[Case]) -> tuple[list[Case], list[tuple[str, str]]]:
    """Parts of recordings, and pairs of what is fitted and what is predicted: of a device with several sessions the
    next session, else folds of the recording."""
    parts, pairs = [], []
    sessions: dict[str, list[Case]] = {}
    for case in whole:
        sessions.setdefault(case.device, []).append(case)
    for of_device in sessions.values():
        if "mimu4444" in of_device[0].device and len(of_device) > 1:
            pairs += [(of_device[i].name, of_device[(i + 1) % len(of_device)].name) for i in range(len(of_device))]
            continue
        for case in of_device:
            try:
                cut = folds(case)
            except Exception as error:  # no rests
                print(f"{case.name}: {error}", file=sys.stderr)
                continue
            for number, (to_fit, held) in enumerate(cut, start=1):
                names = f"{case.name}, fold {number}, fitted", f"{case.name}, fold {number}, held out"
                parts += [replace(part, name=name) for part, name in zip((to_fit, held), names, strict=True)]
                pairs.append(names)
    return parts, pairs


def computed(names: Sequence[str], workers: int, chips: Sequence[int] = CHIPS) -> dict[str, Any]:
    """All results of these sources, of the array those of some chips."""
    first, *others = (program.name for program in benchmark.PROGRAMS)
    programs = [first, benchmark.LINEAR.name, *others]
    kept = tuple(f"chip {chip}" for chip in chips)
    whole = [case for case in cases(*names) if "chip" not in case.name or case.name.endswith(kept)]
    real = [case for case in whole if case.truth is None]
    parts, pairs = pairs_of(real)
    every = {case.name: case for case in (*whole, *parts)}
    unseen: dict[str, list[Case]] = {case.name: [] for case in whole}
    for trained, held in pairs:
        unseen.setdefault(trained, []).append(every[held])
    todo = [(every[name], held) for name, held in unseen.items()]
    of = {(fit.case, fit.program): fit for fit in fits(todo, programs, workers)}
    rows = []
    for case in whole:
        for program in programs:
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
                of_device = devices.setdefault(program, {}).setdefault(case.device, [])
                of_device.append(of[case.name, program].accepted_part())
    repeated = {program: repeated_of(devices[program], devices[OURS]) for program in devices}
    truths = [
        row_of(case, program, of[case.name, program].found).content()
        for case in whole if case.truth is not None for program in programs
    ]  # fmt: skip
    return {
        "made": {
            **made_now(("*.py",)),
            "cases": len(real),
            "programs": list(programs),
            "missing": missing(),
        },
        "recordings": recordings(real),
        "rows": rows,
        "predictions": list(predictions(of, programs, pairs)),
        "repeatability": repeated,
        "seconds": {
            program: round(float(np.median([of[case.name, program].found.seconds for case in real])), 3)
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
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--chips", type=int, nargs="+", default=CHIPS, help="of the array (default 1 and 6)")
    parser.add_argument("--page", action="store_true", help="only write the page of the results that are there")
    given = parser.parse_args()
    if not given.page:
        results = computed(given.sources, given.workers, given.chips)
        if given.sources:
            print(real_page(results))
            return
        RESULTS.parent.mkdir(exist_ok=True)
        RESULTS.write_text(json.dumps(results, ensure_ascii=False, indent=1) + "\n", encoding="utf-8")
    target = FOLDER.parent / "docs" / "evidence" / "real.md"
    target.write_text(real_page(json.loads(RESULTS.read_text(encoding="utf-8"))), encoding="utf-8")


if __name__ == "__main__":
    main()
