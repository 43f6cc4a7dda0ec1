"""The end of a session: its calibration, and what is made of that."""

from __future__ import annotations

import subprocess
import sys
import tempfile
import threading
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tumble.errors import CalibrationError
from tumble.export import export_calibration, target, targets
from tumble.files import whole_file
from tumble.sensors.parameters import group_name
from tumble.units import rounded

if TYPE_CHECKING:
    from tumble.result.calibration import Calibration

CALIBRATION_FILE = "calibration.json"
REPORT_FILE = "report.html"
_LOOK_SECONDS = 0.05


def shown(calibration: Calibration) -> dict[str, Any]:
    """A calibration as the page shows it: the verdict with its reasons, the parameters in the units of `tumble
    calibrate`, the files that can be fetched, the formats for export, and the answer of the registry, empty as yet."""
    from tumble.result.unaided import improvement
    from tumble.views.numbers import shown_units

    units, rows = shown_units(calibration.parameters), []
    for each in calibration.parameters:
        size, unit = units[each.name]
        value, u = rounded(each.value / size, (each.u or 0.0) / size)
        row = {"name": each.name, "group": group_name(each.name), "value": value, "u": u, "unit": unit}
        rows.append(row | {"size": size, "u_si": each.u})
    return {
        "accepted": calibration.outcome.accepted,
        "reasons": list(calibration.outcome.reasons),
        "before_and_after": list(improvement(calibration)) if calibration.outcome.accepted else [],
        "parameters": rows,
        "files": [CALIBRATION_FILE],
        "formats": [name for name in targets() if not target(name).needs],
        "registered": "",
    }


def calibrated(folder: Path, stopped: threading.Event) -> Calibration:
    """Calibrate a session folder by `tumble calibrate`, which writes into it.

    Raises CalibrationError if that fails, or if its exit status does not agree with the verdict in the file. The file
    of an earlier calibration then stays as it is."""
    from tumble.result.calibration import read_calibration

    with whole_file(folder / CALIBRATION_FILE) as fresh:
        accepted = _made(fresh, "calibrate", "--force", "--out", str(fresh), "--", str(folder), stopped=stopped)
        calibration = read_calibration(fresh)
        if calibration.outcome.accepted is not accepted:
            raise CalibrationError(
                f"calibrate: expected a result that agrees with how it has ended, accepted: {accepted}, found another"
            )
    return calibration


def _made(fresh: Path, *words: str, stopped: threading.Event) -> bool:
    """Run a command of tumble that writes the file `fresh`, and return whether its exit status is 0.

    Raises CalibrationError, with the last line of its standard error, for a status above 1 and for an empty file."""
    status, said = _ended(*words, stopped=stopped)
    last = said[-1] if said else ""
    if status not in (0, 1):
        raise CalibrationError(last or f"{words[0]}: it was ended with the status {status}")
    if not fresh.stat().st_size:
        raise CalibrationError(f"{words[0]}: it has ended without a result; {last}")
    return status == 0


def _ended(*words: str, stopped: threading.Event) -> tuple[int, list[str]]:
    """Run a command of tumble in a process of its own; its exit status and the lines of its standard error.

    The process is ended when the bench is `stopped`. It takes no module from the folder it runs in (-P)."""
    command = [sys.executable, "-P", "-m", "tumble", *words]
    nowhere = subprocess.DEVNULL
    with (
        tempfile.TemporaryFile() as said,
        subprocess.Popen(command, stdin=nowhere, stdout=nowhere, stderr=said) as process,
    ):
        while process.poll() is None:
            if stopped.wait(_LOOK_SECONDS):
                process.terminate()
                process.wait()
        said.seek(0)
        lines = said.read().decode("utf-8", errors="replace").strip().splitlines()
    return process.returncode, [line.removeprefix("tumble: ") for line in lines]


def report_of(folder: Path, stopped: threading.Event) -> str:
    """Write the report of a calibration beside it, and return the name of its file."""
    with whole_file(folder / REPORT_FILE) as fresh:
        _made(fresh, "report", "--out", str(fresh), "--", str(folder / CALIBRATION_FILE), stopped=stopped)
    return REPORT_FILE


def exported(folder: Path, to: str) -> tuple[str, str]:
    """Export a calibration into a file beside it, and return the name of that and the worst that it cannot hold."""
    made = export_calibration(folder / CALIBRATION_FILE, to)
    name = f"export-{to}{target(to).ending}"
    with whole_file(folder / name) as temporary:
        temporary.write_bytes(made.content)
    return name, next(iter(made.losses), "")


def registered(folder: Path, place: str | None, stopped: threading.Event) -> str:
    """Add a calibration to a registry by `tumble registry add`, and return its messages. `place` None: the user's."""
    where = [] if place is None else ["--registry", place]
    status, said = _ended("registry", "add", *where, "--", str(folder / CALIBRATION_FILE), stopped=stopped)
    if status not in (0, 1):
        raise CalibrationError(said[-1] if said else f"registry: it was ended with the status {status}")
    return "; ".join(said)
