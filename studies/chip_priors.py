"""How large are the groups beyond the linear model in real chips? Restricted likelihood over chips and sessions.

Every session of a chip is estimated with one group free (its size is the limit beyond which a value is impossible) and
all others as the grade has them. That gives x_i and covariance C_i of the group's parameters, everything else
eliminated with flat or usual priors. A chip's parameters c are the same in all its sessions; what a session adds of its
own, such as a strain of the board in its fixture, has a standard deviation t. With V_i = C_i + t² I a chip has

    A = Σ_i V_i⁻¹,    ĉ = A⁻¹ Σ_i V_i⁻¹ x_i

and with parameters that are normal of standard deviation s from chip to chip the restricted log-likelihood is

    ℓ(s, t) = −½ Σ_c [Σ_i ln det V_i + ln det A + Σ_i (x_i − ĉ)ᵀ V_i⁻¹ (x_i − ĉ)
                      + ln det (A⁻¹ + s² I) + ĉᵀ (A⁻¹ + s² I)⁻¹ ĉ],    ℓ(s) = max over t of ℓ(s, t)

The table has the s of the maximum, and in brackets where ℓ is 1.92 below it (95 %), for each source and for all; "at
most" stands where zero is within. Beside it stands the size that the table of parameters has for MEMS.

    python studies/chip_priors.py                     every real recording of evidence/real that is there
    python studies/chip_priors.py --sources mpu9150   some of them
    python studies/chip_priors.py FOLDER …            sessions of your own; those of one serial number are one chip
    python studies/chip_priors.py --short             three recordings, the quadratic terms alone, for a look
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from tumble.errors import InputError
from tumble.files import FilePath
from tumble.inference.joint import joint
from tumble.recording.arrays import session_of_arrays
from tumble.recording.session import Session
from tumble.recording.session_file import session_from
from tumble.reduction.observations import Observations
from tumble.run.observed import inspect_session, observations_for_calibration, with_grade
from tumble.sensors.parameters import positions_by_group, usual_sizes
from tumble.units import G_STANDARD, Array

sys.path.insert(0, str(Path(__file__).parents[1]))

from stored import shown

from evidence.case import Case
from evidence.real.cases import READERS, cases

GRADE = "mems"
GROUPS = {
    "accel.quadratic": ("µg/g²", 1e6 * G_STANDARD),
    "accel.cubic": ("µg/g³", 1e6 * G_STANDARD**2),
    "accel.asymmetry": ("ppm", 1e6),
    "gyro.asymmetry": ("ppm", 1e6),
    "gyro.g_sensitivity": ("°/h/g", np.degrees(1.0) * 3600.0 * G_STANDARD),
}
"""The groups with the unit in which they are shown."""
FREE = 100.0
"""Times the usual size: as good as flat."""
DROP = 1.92
"""Of ℓ at the ends of a 95 % interval: half the quantile of χ² with one degree of freedom."""
BETWEEN = np.concatenate([[0.0], np.geomspace(0.1, 100.0, 31)])
"""Scatters between sessions that are tried, in units of the usual size."""
SIZES = np.concatenate([[0.0], np.geomspace(1e-3, 1e3, 601)])
"""Sizes that are tried, in units of the usual one."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Seen:
    """What a session says of the parameters of a group: `values` (m,) and `covariance` (m, m), in usual sizes."""

    source: str
    chip: str
    values: Array
    covariance: Array


def session_of(case: Case) -> Session:
    """A recording of the benchmark as a session in memory."""
    return session_of_arrays(
        accel=case.accel, gyro=case.gyro, time=case.time, latitude=case.latitude, gravity=case.gravity,
        gravity_u=case.gravity_u, serial=case.device,
    )  # fmt: skip


def sessions(folders: Sequence[FilePath], sources: Sequence[str]) -> Iterator[tuple[str, Session]]:
    """The name of the source and the session, of folders or else of real recordings that are no tables."""
    for folder in folders:
        session = session_from(folder)
        yield session.device.serial, session
    if not folders:
        for case in cases(*sources):
            if not case.table and case.truth is None:
                yield next(name for name in READERS if case.name.startswith(name)), session_of(case)


def observations_of(session: Session) -> Observations | None:
    """The rests and turns of a session with the sizes of the grade; None, with the reason, where it has too few."""
    try:
        seen = observations_for_calibration(inspect_session(session))
    except InputError as error:
        print(f"{session.device.serial}: {error}", file=sys.stderr)
        return None
    if not isinstance(seen, Observations):
        print(f"{session.device.serial}: {'; '.join(seen.reasons)}", file=sys.stderr)
        return None
    stated = replace(session, device=replace(session.device, grade=GRADE))
    return with_grade(stated, seen)


def seen_of(source: str, chip: str, observations: Observations, group: str) -> Seen | None:
    """The parameters of a group with the group free; None where the session has none or does not converge."""
    usual = usual_sizes(GRADE)[group]
    if group.startswith("gyro") and observations.turns is None:
        return None
    free = replace(observations, usual={**observations.usual, group: FREE * usual})
    try:
        found = joint(free, intervals=False)
    except np.linalg.LinAlgError:  # the data contradict the model
        return None
    places = positions_by_group(found.names).get(group, [])
    if not found.converged or not places:
        return None
    return Seen(
        source=source,
        chip=chip,
        values=found.values[places] / usual,
        covariance=found.covariance[np.ix_(places, places)] / usual**2,
    )


def solution_at(every: Sequence[Seen]) -> Array:
    """ℓ of each of SIZES, at the likeliest scatter between sessions for each."""
    chips = [[seen for seen in every if seen.chip == chip] for chip in dict.fromkeys(seen.chip for seen in every)]
    scatters = BETWEEN if any(len(of) > 1 for of in chips) else BETWEEN[:1]
    return np.max([sum(_of_chip(of, t) for of in chips) for t in scatters], axis=0)


def _of_chip(sessions: Sequence[Seen], t: float) -> Array:
    """ℓ(s, t) of a chip for each s of SIZES."""
    V = [seen.covariance + t**2 * np.eye(len(seen.values)) for seen in sessions]
    weights = [np.linalg.inv(each) for each in V]
    A = np.sum(weights, axis=0)
    c = np.linalg.solve(A, np.sum([W @ seen.values for W, seen in zip(weights, sessions, strict=True)], axis=0))
    off = [seen.values - c for seen in sessions]
    within = sum(np.linalg.slogdet(each)[1] for each in V) + np.linalg.slogdet(A)[1]
    within += sum(float(e @ W @ e) for e, W in zip(off, weights, strict=True))
    eigenvalues, vectors = np.linalg.eigh(np.linalg.inv(A))
    variances = eigenvalues + SIZES[:, None] ** 2
    return -0.5 * (within + (np.log(variances) + (vectors.T @ c) ** 2 / variances).sum(axis=1))


def size_of(every: Sequence[Seen], factor: float) -> str:
    """The size of the maximum with its interval, times `factor`."""
    if not every:
        return "–"
    likelihood = solution_at(every)
    within = np.flatnonzero(likelihood > likelihood.max() - DROP)
    low, best, high = (factor * SIZES[at] for at in (within[0], likelihood.argmax(), within[-1]))
    return f"at most {high:.3g}" if low == 0.0 else f"{best:.3g} [{low:.3g}, {high:.3g}]"


def table_of(every: Mapping[str, Sequence[Seen]]) -> list[list[str]]:
    """A row a source, and one of all, a column a group."""
    sources = list(dict.fromkeys(seen.source for group in every.values() for seen in group))
    rows = [["source", "chips", "sessions", *(f"{group}, {GROUPS[group][0]}" for group in every)]]
    for source in (*sources, "all"):
        of = {group: [s for s in seen if source in (s.source, "all")] for group, seen in every.items()}
        most = max(of.values(), key=len)
        cells = [size_of(seen, usual_sizes(GRADE)[group] * GROUPS[group][1]) for group, seen in of.items()]
        rows.append([source, f"{len({s.chip for s in most})}", f"{len(most)}", *cells])
    usual = (f"{usual_sizes(GRADE)[group] * GROUPS[group][1]:.3g}" for group in every)
    return [*rows, ["as the table of parameters has it", "", "", *usual]]


def main() -> None:
    parser = argparse.ArgumentParser(description="Sizes of the groups beyond the linear model in real chips")
    parser.add_argument("folders", nargs="*", type=Path, help="sessions; the real recordings where none is named")
    parser.add_argument("--sources", nargs="+", default=[], choices=list(READERS), help="some of the recordings")
    parser.add_argument("--short", action="store_true", help="three recordings, the quadratic terms alone")
    given = parser.parse_args()
    sources = ("xsens-mti", "openaxes-imu9") if given.short else given.sources
    groups = ["accel.quadratic"] if given.short else list(GROUPS)
    every: dict[str, list[Seen]] = {group: [] for group in groups}
    for source, session in sessions(given.folders, sources):
        observations = observations_of(session)
        for group in groups if observations is not None else ():
            assert observations is not None
            if (seen := seen_of(source, session.device.serial, observations, group)) is not None:
                every[group].append(seen)
    table = table_of(every)
    print(shown(table))
    usual, of_all = (float(table[row][3].split()[0].replace("at", "nan")) for row in (-1, -2))
    answer = "Yes" if not of_all > 3.0 * usual else "No: by more than three times"
    print(f"\nAre the {groups[0]} terms of these chips as small as the table has them? {answer}.")


if __name__ == "__main__":
    main()
