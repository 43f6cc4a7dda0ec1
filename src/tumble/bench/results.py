"""Calibration at the end of a session, with report, export and registration."""

from __future__ import annotations

import os
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
_POLL_SECONDS = 0.05


def page_content(calibration: Calibration) -> dict[str, Any]:
    """Return a calibration for the page: verdict with reasons, parameters in the units of `tumble calibrate`, files,
    export formats, and the answer of the registry, empty at first."""
    from tumble.result.further import improvement
    from tumble.views.numbers import shown_units

    units, rows = shown_units(calibration.parameters), []
    for p in calibration.parameters:
        size, unit = units[p.name]
        value, u = rounded(p.value / size, (p.u or 0.0) / size)
        row = {"name": p.name, "group": group_name(p.name), "value": value, "u": u, "unit": unit}
        rows.append(row | {"size": size, "u_si": p.u})
    return {
        "accepted": calibration.outcome.accepted,
        "reasons": list(calibration.outcome.reasons),
        "before_and_after": list(improvement(calibration)) if calibration.outcome.accepted else [],
        "parameters": rows,
        "files": [CALIBRATION_FILE],
        "formats": [name for name in targets() if not target(name).needs],
        "registered": "",
    }


def calibrate_folder(folder: Path, stopped: threading.Event) -> Calibration:
    """Calibrate a session folder by `tumble calibrate`, which writes into it.

    Raises CalibrationError if that fails, or if its exit status contradicts the verdict in the file. The file of an
    earlier calibration is then kept."""
    from tumble.result.calibration import read_calibration

    with whole_file(folder / CALIBRATION_FILE) as fresh:
        accepted = _run_writing(fresh, "calibrate", "--force", "--out", str(fresh), "--", str(folder), stopped=stopped)
        calibration = read_calibration(fresh)
        if calibration.outcome.accepted is not accepted:
            raise CalibrationError(
                f"calibrate: expected a result that agrees with how it has ended, accepted: {accepted}, found another"
            )
    return calibration


def _run_writing(fresh: Path, *words: str, stopped: threading.Event) -> bool:
    """Run a command of tumble that writes the file `fresh`, and return True for exit status 0.

    Raises CalibrationError, with the last line of its standard error, for a status above 1 and for an empty file."""
    status, messages = _run(*words, stopped=stopped)
    last = messages[-1] if messages else ""
    if status not in (0, 1):
        raise CalibrationError(last or f"{words[0]}: it was ended with the status {status}")
    if not fresh.stat().st_size:
        raise CalibrationError(f"{words[0]}: it has ended without a result; {last}")
    return status == 0


def _run(*words: str, stopped: threading.Event) -> tuple[int, list[str]]:
    """Run a command of tumble as a process, and return its exit status and the lines of its standard error.

    The process is ended when the bench is `stopped`. It imports no module from the working folder (-P)."""
    command = [sys.executable, "-P", "-m", "tumble", *words]
    null = subprocess.DEVNULL
    with (
        tempfile.TemporaryFile() as stderr,
        subprocess.Popen(command, stdin=null, stdout=null, stderr=stderr) as process,
    ):
        while process.poll() is None:
            if stopped.wait(_POLL_SECONDS):
                process.terminate()
                process.wait()
        stderr.seek(0)
        lines = stderr.read().decode("utf-8", errors="replace").strip().splitlines()
    return process.returncode, [line.removeprefix("tumble: ") for line in lines]


def write_report(folder: Path, stopped: threading.Event) -> str:
    """Write the report of a calibration beside it, and return the name of the file."""
    with whole_file(folder / REPORT_FILE) as fresh:
        _run_writing(fresh, "report", "--out", str(fresh), "--", str(folder / CALIBRATION_FILE), stopped=stopped)
    return REPORT_FILE


def write_export(folder: Path, to: str) -> tuple[str, str]:
    """Export a calibration into a file beside it, and return its name and the most important loss."""
    exported = export_calibration(folder / CALIBRATION_FILE, to)
    name = f"export-{to}{target(to).ending}"
    with whole_file(folder / name) as temporary:
        temporary.write_bytes(exported.content)
    return name, next(iter(exported.losses), "")


def register(folder: Path, place: str | None, stopped: threading.Event) -> str:
    """Add a calibration to a registry (None: the user's) by `tumble registry add`, and return its messages."""
    place = place or os.environ.get("TUMBLE_REGISTRY")
    if not place:
        raise CalibrationError("registry: expected one, found none; start `tumble bench` with --registry FILE")
    words = "registry", "add", "--registry", place, "--", str(folder / CALIBRATION_FILE)
    status, messages = _run(*words, stopped=stopped)
    if status not in (0, 1):
        raise CalibrationError(messages[-1] if messages else f"registry: it was ended with the status {status}")
    return "; ".join(messages)
