"""Whether the loops over samples run as machine code, and of which source it was made.

hatch_build.py, which makes it, reads this file too; so it imports nothing of tumble.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

FOLDER = Path(__file__).parent
LOOPS = (
    "reduction/kernels",
    "reduction/moment_kernels",
    "inference/elimination",
    "inference/row_loops",
    "inference/residual_loops",
    "sensors/fixed_point",
    "sensors/triad_axes",
)
RECORD = FOLDER / "compiled.json"
"""What was compiled: `compiler`, and under `sources` the hash of the source of each of LOOPS."""


def source_hash(loops: str) -> str:
    """SHA-256 of what a module of LOOPS is compiled from."""
    import hashlib

    digest = hashlib.sha256()
    for ending in (".py", ".pxd"):
        digest.update((FOLDER / (loops + ending)).read_bytes().replace(b"\r\n", b"\n"))
    return digest.hexdigest()


def record() -> dict[str, Any]:
    """What was compiled; empty where nothing was."""
    import json

    return json.loads(RECORD.read_text(encoding="utf-8")) if RECORD.exists() else {}


def stale() -> list[str]:
    """Modules of LOOPS whose source was changed after they were compiled."""
    made = record().get("sources", {})
    return [loops for loops in LOOPS if loops in made and made[loops] != source_hash(loops)]


def words() -> str:
    """Says in a few words what the loops over samples run as."""
    made = record()
    if not made:
        return "plain Python, some hundred times slower"
    return f"compiled, {made['compiler']}" + (f"; older than their source: {', '.join(stale())}" if stale() else "")
