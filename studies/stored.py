"""Tables of a study as a file, from which pages take them.

    python studies/NAME.py --store         writes studies/results/NAME.json
    python -m evidence.pages               puts its tables into the pages that name them

A table is a list of rows of texts, the head first, as the page shows it; beside them stand the command, the state of
the sources, date, machine, seed and N.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

from evidence.state import made_now  # noqa: E402

BEGUN = made_now("src", "studies/*.py")
"""The state of the sources when the study began."""
RESULTS = ROOT / "studies" / "results"
Table = Sequence[Sequence[str]]


def shown(table: Table) -> str:
    """In Markdown."""
    head, *rows = table
    return "\n".join(f"| {' | '.join(cells)} |" for cells in (head, ["---"] * len(head), *rows))


def store(study: str, tables: Mapping[str, Table], figures: Mapping[str, str] | None = None, **said: object) -> None:
    """Write the tables of a study, and single figures of its text, with what else is said of the run: seed, N."""
    made = {"command": f"python studies/{study}.py --store", **said, **BEGUN}
    RESULTS.mkdir(exist_ok=True)
    content = {"made": made, "figures": dict(figures or {}), "tables": {name: list(t) for name, t in tables.items()}}
    text = json.dumps(content, ensure_ascii=False, indent=1) + "\n"
    (RESULTS / f"{study}.json").write_text(text, encoding="utf-8")
