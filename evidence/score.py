"""Scores: what a program made of a case, and what is said of many.

A `Row` is one program and one case. Of a case whose truth is known it has the errors of the parameters over the
standard uncertainty that the program states (z), how many of its 95 % intervals contain the truth, and, by group of
parameters, the rms of the errors and of what there was to find, in SI. Scores are of a kind, and of all kinds:

    left           rms of the errors over rms of what there was to find, the geometric mean over sessions: 1 is an
                   uncalibrated device
    rms, beyond    of z: rms, shares beyond 2 and 3; of normal errors and a true u 1, 4.6 %, 0.3 %
    covered        share of the 95 % intervals that contain the truth
    silent wrong   accepted without a remark, and a parameter more than 4 u off
    refused        good recordings that are refused, with a share of those that may be accepted
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from evidence.case import CHANGES, MAG_NAMES, NAMES, Case, Estimate, Refusal, parameters_of

Verdict = Literal["accepted", "with scatter", "not accepted", "gave up", "cannot run"]
GROUPS = tuple(f"{kind}.{what}" for kind in ("accel", "gyro") for what in ("bias", "scale", "axis"))
FURTHER = (*(f"mag.{what}" for what in ("bias", "scale", "axis")), "accel.change", "gyro.change")
"""Groups of recordings of other kinds."""
EVERY = (*NAMES, *MAG_NAMES, *CHANGES)
SILENT_WRONG = 4.0
"""Times u."""
DIGITS = 4
"""Significant ones in files: what another machine changes is beyond them."""
SAID = 600
"""Characters of a verdict that are kept."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Row:
    """One program and one case."""

    case: str
    kind: str
    program: str
    verdict: Verdict
    said: str
    z: Mapping[str, float]
    """Error over u of the parameters that have both."""
    covered: int
    intervals: int
    """How many of the 95 % intervals that are stated contain the truth."""
    errors: Mapping[str, tuple[float, float]]
    """By group, rms of the errors and of the truths, SI."""

    @property
    def worst(self) -> tuple[str, float]:
        """The parameter that is the most u off, and by how many."""
        name = max(self.z, key=lambda n: abs(self.z[n]), default="")
        return (name, self.z[name]) if name else ("", 0.0)

    @property
    def silent_wrong(self) -> bool:
        """Accepted without a remark, and wrong."""
        return self.verdict == "accepted" and abs(self.worst[1]) > SILENT_WRONG

    def content(self) -> dict[str, Any]:
        """As a file has it."""
        names = EVERY if set(self.z) - set(NAMES) else NAMES
        return {
            "case": self.case, "kind": self.kind, "program": self.program, "verdict": self.verdict, "said": self.said,
            "z": [self.z.get(name) for name in names], "covered": self.covered, "intervals": self.intervals,
            "errors": {group: list(values) for group, values in self.errors.items()},
        }  # fmt: skip

    @staticmethod
    def from_content(content: Mapping[str, Any]) -> Row:
        """The row of what `content` gave."""
        z = {name: value for name, value in zip(EVERY, content["z"], strict=False) if value is not None}
        errors = {group: (values[0], values[1]) for group, values in content["errors"].items()}
        return Row(**{**content, "z": z, "errors": errors})


def rounded(value: float) -> float:
    """To DIGITS significant digits."""
    return float(f"{value:.{DIGITS - 1}e}")


def row_of(case: Case, program: str, found: Estimate | Refusal) -> Row:
    """What a program made of a case."""
    if isinstance(found, Refusal):
        verdict: Verdict = "cannot run" if found.reason.startswith("needs ") else "gave up"
        return Row(
            case=case.name, kind=case.kind, program=program, verdict=verdict, said=found.reason[:SAID],
            z={}, covered=0, intervals=0, errors={},
        )  # fmt: skip
    if not found.accepted:
        verdict = "not accepted"
    else:
        verdict = "with scatter" if found.verdict.startswith("accepted with scatter") else "accepted"
    truth, u, half = case.truth or {}, found.u or {}, found.expanded or {}
    values = parameters_of(found)
    off = {name: values[name] - truth[name] for name in values if name in truth}
    errors = {}
    for group in (*GROUPS, *FURTHER):
        names = [name for name in off if name.startswith(f"{group}.")]
        if names:
            rms = (np.sqrt(np.mean([x**2 for x in xs])) for xs in ([off[n] for n in names], [truth[n] for n in names]))
            errors[group] = (rounded(next(rms)), rounded(next(rms)))
    return Row(
        case=case.name,
        kind=case.kind,
        program=program,
        verdict=verdict,
        said=found.verdict[:SAID],
        z={name: rounded(off[name] / u[name]) for name in off if name in u},
        covered=sum(abs(off[name]) <= half[name] for name in off if name in half),
        intervals=sum(name in half for name in off),
        errors=errors,
    )


# -------------------- scores of many --------------------


@dataclass(frozen=True, kw_only=True, slots=True)
class Score:
    """Of the sessions of one program: how many there are, by verdict; of those accepted, without a remark and with
    scatter together where nothing else is said, how wrong they are."""

    sessions: int
    verdicts: Mapping[str, int]
    as_expected: int | None
    """Sessions whose verdict is the expected one; None where nothing is expected or the program does not judge."""
    silent_wrong: int
    rms: float | None
    beyond_2: float | None
    beyond_3: float | None
    largest: float | None
    covered: float | None
    left: Mapping[str, float]
    """By group, the geometric mean of the share of the errors that is left."""

    def content(self) -> dict[str, Any]:
        """As a file has it."""
        numbers = {name: getattr(self, name) for name in ("rms", "beyond_2", "beyond_3", "largest", "covered")}
        return {
            "sessions": self.sessions, "verdicts": dict(self.verdicts), "as_expected": self.as_expected,
            "silent_wrong": self.silent_wrong,
            **{name: None if value is None else rounded(value) for name, value in numbers.items()},
            "left": {group: rounded(value) for group, value in self.left.items()},
        }  # fmt: skip


USABLE = ("accepted", "with scatter")


def score_of(rows: Sequence[Row], expected: Mapping[str, tuple[str, str]] | None = None) -> Score:
    """The score of rows of one program; `expected` has by kind what is expected and the words that name a cause."""
    usable = [row for row in rows if row.verdict in USABLE]
    z = np.array([value for row in usable for value in row.z.values()])
    intervals = sum(row.intervals for row in usable)
    left = {}
    for group in (*GROUPS, *FURTHER):
        pairs = np.array([row.errors[group] for row in usable if all(row.errors.get(group, (0.0,)))])
        if len(pairs):
            left[group] = float(np.exp(np.mean(np.log(pairs[:, 0] / pairs[:, 1]))))
    judged = [row for row in rows if expected and row.kind in expected]
    return Score(
        sessions=len(rows),
        verdicts={v: n for v in ("accepted", "with scatter", "not accepted", "gave up", "cannot run")
                  if (n := sum(row.verdict == v for row in rows))},
        as_expected=sum(as_expected(row, *(expected or {})[row.kind]) for row in judged) if judged else None,
        silent_wrong=sum(row.silent_wrong for row in rows),
        rms=float(np.sqrt(np.mean(z**2))) if len(z) else None,
        beyond_2=float(np.mean(np.abs(z) > 2.0)) if len(z) else None,
        beyond_3=float(np.mean(np.abs(z) > 3.0)) if len(z) else None,
        largest=float(np.abs(z).max()) if len(z) else None,
        covered=sum(row.covered for row in usable) / intervals if intervals else None,
        left=left,
    )  # fmt: skip


def as_expected(row: Row, expected: str, says: str) -> bool:
    """Whether a verdict is the expected one: a good recording is accepted without a remark; one that scatters is
    accepted with the remark that says so; of a cause the words are among those of a remark or a refusal; what is of no
    use is not accepted."""
    refused = row.verdict in ("not accepted", "gave up")
    named = bool(re.search(says, row.said, re.IGNORECASE)) if says else True
    match expected:
        case "accept":
            return row.verdict == "accepted"
        case "accept with scatter":
            return row.verdict == "with scatter" and named
        case "name the cause":
            return (refused or row.verdict == "with scatter") and named
        case "refuse":
            return refused
    raise ValueError(expected)


def by(rows: Iterable[Row], key: str) -> dict[str, list[Row]]:
    """Rows by kind or program, in their order."""
    out: dict[str, list[Row]] = {}
    for row in rows:
        out.setdefault(getattr(row, key), []).append(row)
    return out
