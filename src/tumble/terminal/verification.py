"""Check positions, as text."""

from __future__ import annotations

import numpy as np
from rich.console import Group, RenderableType
from rich.text import Text

from tumble.calibration.verify import Verification
from tumble.terminal.table import add_numbers, plain_table
from tumble.units import engineering


def verification_report(verification: Verification) -> RenderableType:
    """A table of the positions and the verdict."""
    how = "each of the calibration's own positions, left out in turn" if verification.left_out else "check positions"
    verdict = Text("not accepted" if verification.reasons else "accepted")
    found = np.isfinite(verification.sigmas)
    if not found.any():
        return Group(Text(how), Text(""), verdict)
    size, unit = engineering("m/s^2", float(np.nanmax([np.abs(verification.difference), verification.u])))
    table = plain_table()
    table.add_column("position", no_wrap=True)
    add_numbers(table, f"Δg {unit}", f"u (k=1) {unit}", "|Δg|/u")
    rows = zip(verification.labels, verification.difference, verification.u, verification.sigmas, strict=True)
    for label, difference, u, ratio in rows:
        numbers = (f"{difference / size:+z.1f}", f"{u / size:.1f}", f"{ratio:.2f}")
        table.add_row(Text(label), *(numbers if np.isfinite(ratio) else ("", "", "")))
    worst = float(np.nanmax(verification.sigmas))
    summary = (
        f"largest |Δg| {np.nanmax(np.abs(verification.difference)) / size:.3g} {unit}; largest |Δg|/u {worst:.2f} of "
        f"{found.sum()} positions, at most {verification.limit:.2f} in 99 of 100 good calibrations"
    )
    return Group(Text(how), Text(""), table, Text(""), Text(summary), verdict)
