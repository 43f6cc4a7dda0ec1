"""The benchmark: every program on every case, what was done before not done again.

    python -m evidence.run                        all cases of all programs, to evidence/results, and the pages of them
    python -m evidence.run simulated --sessions 3 --kinds 'hand-*'               some kinds, three sessions each
    python -m evidence.run further                recordings without rests, over temperature, with magnetometers
    python -m evidence.run --short --against evidence/results/short.json         what moved since these results

What is computed is kept (`evidence.work`): a run that is stopped goes on where it was. Rows and scores of two runs are
the same to the bit; times and memory stand apart.
"""

from __future__ import annotations

import argparse
import inspect
import json
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatch
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from evidence import programs as benchmark
from evidence.case import Case, Estimate, Refusal
from evidence.score import Row, by, row_of, score_of
from evidence.simulated import kinds as simulated_kinds
from evidence.simulated.kinds import FURTHER, KINDS, SEALED, SHORT, Kind, simulated
from evidence.state import FOLDER, digest_of, made_now
from evidence.work import Entry, answers, median_seconds

RESULTS = FOLDER / "results"
SESSIONS = {"simulated": 6, "short": 1, "further": 10}
"""Of every kind in the published tables of a set."""
FEWER = {"imu_tk": 2, "imu-calib": 2}
"""Sessions of every kind, at most, of programs that take long."""
MAKING = tuple(f"simulated/{name}.py" for name in ("motion", "waving", "device", "driver"))
DECIDES = (*MAKING, "peers", "case.py", "score.py", "programs.py", "tumble_methods.py")
"""What rows depend on in this folder."""
JUDGES = ("tumble joint",)
"""Programs whose verdicts are on the whole recording."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Results:
    """Of a set of cases: what was run, when and where (`made`), rows by case and program, and cost by program."""

    made: Mapping[str, Any]
    rows: tuple[Row, ...]
    cost: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    @property
    def expected(self) -> dict[str, tuple[str, str]]:
        """By kind what is expected, and the words of a cause."""
        return {kind.name: (kind.expected, kind.says) for kind in (*KINDS, *FURTHER)}

    def scores(self) -> dict[str, dict[str, Any]]:
        """By program, of all kinds and of each."""
        out: dict[str, dict[str, Any]] = {}
        for program, rows in by(self.rows, "program").items():
            expected = self.expected if program in JUDGES else None
            by_kind = {"all": rows, **by(rows, "kind")}
            out[program] = {kind: score_of(some, expected).content() for kind, some in by_kind.items()}
        return out

    def text(self) -> str:
        """As a file: a row is a line."""
        rows = ",\n".join("  " + json.dumps(row.content(), ensure_ascii=False) for row in self.rows)
        head = {"made": self.made, "cost": self.cost, "scores": self.scores()}
        parts = [f" {json.dumps(name)}: {json.dumps(value, ensure_ascii=False)}" for name, value in head.items()]
        return "{\n" + ",\n".join(parts) + ',\n "rows": [\n' + rows + "\n ]\n}\n"

    @staticmethod
    def read(path: Path) -> Results:
        """The results in a file."""
        content = json.loads(path.read_text(encoding="utf-8"))
        return Results(
            made=content["made"], cost=content["cost"], rows=tuple(Row.from_content(each) for each in content["rows"])
        )


# -------------------- what there is to do --------------------


def simulated_entries(series: str, sessions: int, kinds: Sequence[Kind] = KINDS) -> list[Entry]:
    """Sessions of all kinds of a table."""
    functions = (inspect.getsource(each) for each in (simulated_kinds.simulated, simulated_kinds.kept))
    making = digest_of(*(FOLDER / name for name in (*MAKING, "score.py")), *functions)
    return [
        Entry(
            name=f"{kind.name} {index}",
            kind=kind.name,
            key=digest_of(f"{making} {replace(kind, words='', says='', expected='accept')!r} {series} {index}"),
            make=_Simulated(kind.name, index, series),
            tell=told_of,
        )
        for index in range(sessions)
        for kind in kinds
    ]


@dataclass(frozen=True, slots=True)
class _Simulated:
    """Makes one session, in any process."""

    kind: str
    index: int
    series: str

    def __call__(self) -> Case:
        return simulated(simulated_kinds.named(self.kind), self.index, self.series)


def of_entry(entry: Entry, programs: Sequence[str]) -> list[str]:
    """The programs that are to have it."""
    index = int(entry.name.rpartition(" ")[2])
    return [name for name in programs if name not in FEWER or index < FEWER[name]]


def entries_of(name: str, sessions: int) -> list[Entry]:
    """The cases of a set: simulated, or short, one session of every kind with seeds of its own, or further, those of
    other kinds than rests and turns."""
    if name == "further":
        return simulated_entries(SEALED, sessions, FURTHER)
    return simulated_entries(SHORT, 1) if name == "short" else simulated_entries(SEALED, sessions)


def programs_of(name: str, patterns: Sequence[str]) -> list[str]:
    """Names of the programs of a set that fit one of the patterns."""
    programs = benchmark.FURTHER if name == "further" else benchmark.PROGRAMS
    return [p.name for p in programs if any(fnmatch(p.name, pattern) for pattern in patterns)]


# -------------------- doing it --------------------


def told_of(case: Case, program: str, found: Estimate | Refusal) -> dict[str, Any]:
    """The row of a program and a case, as a file has it."""
    return row_of(case, program, found).content()


def _peak(make: Callable[[], Case], program: str, answer: Any) -> None:
    """MB of memory, at most, of a process in which a program calibrates a case."""
    benchmark.named(program).calibrate(make())
    status = Path("/proc/self/status")
    words = status.read_text(encoding="utf-8").split() if status.exists() else []
    answer.send(int(words[words.index("VmHWM:") + 1]) / 1024.0 if "VmHWM:" in words else float("nan"))


def peak_of(make: Callable[[], Case], program: str) -> float:
    """The same, of a new process."""
    context = get_context("spawn")
    here, there = context.Pipe()
    process = context.Process(target=_peak, args=(make, program, there))
    process.start()
    there.close()
    peak = float(here.recv())
    process.join()
    return peak


def made_by(name: str, entries: Sequence[Entry], programs: Sequence[str]) -> dict[str, Any]:
    """What was run, when, where, of which state of the sources."""
    counts = {len(some) for some in _by_kind(entries).values()}
    return {
        "set": name,
        **made_now("src", *(f"evidence/{name}" for name in DECIDES)),
        "series": SHORT if name == "short" else SEALED,
        "kinds": len(_by_kind(entries)),
        "sessions": len(entries),
        "sessions_of_a_kind": min(counts),
        "programs": list(programs),
    }


def _by_kind(entries: Iterable[Entry]) -> dict[str, list[Entry]]:
    out: dict[str, list[Entry]] = {}
    for entry in entries:
        out.setdefault(entry.kind, []).append(entry)
    return out


def computed(
    name: str, *, sessions: int | None = None, kinds: Sequence[str] = ("*",), programs: Sequence[str] = ("*",),
    workers: int = 0, scheduler: str | None = None, memory: bool = True, say: Callable[[str], None] = lambda _: None,
) -> Results:  # fmt: skip
    """The results of a set of cases, or of the kinds and programs that fit one of the patterns."""
    every = entries_of(name, sessions or SESSIONS[name])
    entries = [e for e in every if any(fnmatch(e.kind, pattern) for pattern in kinds)]
    names = programs_of(name, programs)
    given = [(entry, names if name == "further" else of_entry(entry, names)) for entry in entries]
    told = answers(given, workers=workers, scheduler=scheduler, say=say)
    cost: dict[str, dict[str, float]] = {program: {"seconds": median_seconds(told, program)} for program in names}
    for program in names if memory else ():
        cost[program]["megabytes"] = round(peak_of(_Simulated("hand-30", 0, SEALED), program))
    rows = tuple(Row.from_content(each.content) for each in told.values())
    return Results(made=made_by(name, entries, names), rows=rows, cost=cost)


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; 1 where scores are worse than those they are held against."""
    parser = argparse.ArgumentParser(prog="python -m evidence.run", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("set", nargs="?", choices=tuple(SESSIONS), help="the cases; all sets where none is named")
    parser.add_argument("--kinds", nargs="+", default=["*"], help="some, by patterns such as 'hand-*'")
    parser.add_argument("--short", action="store_true", help="one session of every kind: two minutes")
    parser.add_argument("--sessions", type=int, help=f"of every kind (default {SESSIONS})")
    parser.add_argument("--programs", nargs="+", help="some, by patterns; of the short form those of tumble alone")
    parser.add_argument("--workers", type=int, default=0, help="processes; one a core where it is not given")
    parser.add_argument("--scheduler", help="of a dask cluster, as tcp://HOST:PORT")
    parser.add_argument("--out", type=Path, default=RESULTS, help="folder of the results (default evidence/results)")
    parser.add_argument("--no-memory", action="store_true", help="memory is not measured")
    parser.add_argument("--against", type=Path, help="results that the new ones are held against; nothing is written")
    given = parser.parse_args(arguments)
    names = [given.set] if given.set else ["short"] if given.short else list(SESSIONS)

    def say(words: str) -> None:
        print(f"\r{words}", end="", file=sys.stderr, flush=True)

    worse = False
    for name in names:
        found = computed(
            name, sessions=given.sessions, kinds=given.kinds,
            programs=given.programs or (["tumble *"] if name == "short" else ["*"]), workers=given.workers,
            scheduler=given.scheduler, memory=name != "further" and not (given.against or given.no_memory), say=say,
        )  # fmt: skip
        print(file=sys.stderr)
        if given.against:
            from evidence.drift import compared, told

            moved = compared(Results.read(given.against).rows, found.rows, found.expected)
            print(told(moved))
            worse |= any(each.worse for each in moved)
            continue
        given.out.mkdir(parents=True, exist_ok=True)
        (given.out / f"{name}.json").write_text(found.text(), encoding="utf-8")
        print(given.out / f"{name}.json")
    if given.out == RESULTS and not given.against:
        from evidence.pages import write

        write()
    return int(worse)


if __name__ == "__main__":
    sys.exit(main())
