"""The end of a session: its calibration, and what is made of that."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tumble.errors import CalibrationError
from tumble.files import whole_file

if TYPE_CHECKING:
    from tumble.calibration.calibration_file import Calibration

CALIBRATION_FILE = "calibration.json"
REPORT_FILE = "report.html"
_RESULTS = (0, 1)  # accepted and not
_ENDINGS = {"c": ".h", "px4": ".params", "ardupilot": ".parm", "csv": ".csv", "mat": ".mat", "dcc": ".xml"}


@dataclass(frozen=True, kw_only=True, slots=True)
class Results:
    """What has come of a session: whether its calibration is accepted, and the reasons; how many parameters it has; the
    files that can be fetched, and what the registry said."""

    accepted: bool
    reasons: tuple[str, ...]
    parameters: int
    files: tuple[str, ...] = (CALIBRATION_FILE,)
    registered: str = ""

    @staticmethod
    def of(calibration: Calibration) -> Results:
        """Of a calibration that is written."""
        outcome = calibration.outcome
        return Results(
            accepted=outcome.accepted, reasons=tuple(outcome.reasons), parameters=len(calibration.parameters)
        )

    def with_file(self, name: str) -> Results:
        """With one file more."""
        return self if name in self.files else replace(self, files=(*self.files, name))

    def registered_as(self, said: str) -> Results:
        """With what the registry said."""
        return replace(self, registered=said)

    def shown(self) -> dict[str, Any]:
        """For the page."""
        return asdict(self)


def calibrated(folder: Path) -> Calibration:
    """The calibration of a session folder, written into it by `tumble calibrate`: in a process of its own, which leaves
    this one its time and gives back its memory. Raises CalibrationError with what that says."""
    from tumble.calibration.calibration_file import read_calibration

    target = folder / CALIBRATION_FILE
    words = ["calibrate", "--force", "--out", str(target), "--", str(folder)]
    run = subprocess.run(
        [sys.executable, "-m", "tumble", *words],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        check=False,
    )
    if run.returncode not in _RESULTS:
        said = run.stderr.strip().splitlines() or [f"it ended with status {run.returncode}"]
        raise CalibrationError(said[-1].removeprefix("tumble: "))
    return read_calibration(target)


def report_of(folder: Path) -> str:
    """Write the report of a calibration beside it; the name of its file."""
    from tumble.report.write import write_report

    write_report([folder / CALIBRATION_FILE], folder / REPORT_FILE)
    return REPORT_FILE


def exported(folder: Path, to: str) -> str:
    """Write a calibration as another program reads it, beside it; the name of the file."""
    from tumble.calibration.calibration_file import read_calibration
    from tumble.export import export_calibration

    found = export_calibration(read_calibration(folder / CALIBRATION_FILE), to)
    name = f"export-{to}{_ENDINGS.get(to, '.txt')}"
    with whole_file(folder / name) as temporary:
        temporary.write_bytes(found.content)
    return name


def registered(folder: Path, place: str | None) -> str:
    """Add a calibration to the registry at `place`, as `tumble registry add` does; under which number, and what its
    limits say of it."""
    from tumble.registry.connect import extra_named

    with extra_named():
        from tumble.registry.connect import open_registry
        from tumble.registry.records import Particulars, read_submission
        from tumble.registry.store import add

        submission = read_submission(folder / CALIBRATION_FILE, Particulars())
        with open_registry(place, create=True) as opened:
            added = add(opened, submission)
    verdict = added.record.verdict
    said = "registered as" if added.new else "registered before: it is"
    judged = "no limits are set for it" if verdict is None else f"its limits say: {verdict}"
    return f"{said} record {added.record.number}; {judged}"
