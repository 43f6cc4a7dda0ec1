"""Of which state of the sources a result is, and the files of what was computed, which are not computed again."""

from __future__ import annotations

import hashlib
import os
import platform
import subprocess
from collections.abc import Sequence
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

from evidence import programs as benchmark

FOLDER = Path(__file__).parent
CACHE = FOLDER / "cache"
LIBRARIES = ("numpy", "scipy", "polars")


def digest_of(*parts: Path | str) -> str:
    """The hash of files and texts."""
    digest = hashlib.sha256()
    for part in parts:
        digest.update(part.read_bytes() if isinstance(part, Path) else part.encode())
    return digest.hexdigest()


@cache
def source_of(program: str) -> str:
    """The hash of all that a program's answers depend on beside the case."""
    ours = [*FOLDER.parent.joinpath("src/tumble").rglob("*.py"), FOLDER / "tumble_methods.py"]
    peers = FOLDER.joinpath("peers").glob("*.py")
    files = sorted(ours if benchmark.named(program).ours else peers)
    libraries = " ".join(f"{name} {version(name)}" for name in LIBRARIES)
    return digest_of(*files, FOLDER / "case.py", FOLDER / "score.py", libraries)


def file_of(folder: Path, *parts: str) -> Path:
    """The file of what depends on these."""
    name = digest_of(" ".join(parts))
    return folder / name[:2] / f"{name}.json"


def keep(path: Path, text: str) -> None:
    """Write a file whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.with_suffix(".part").write_text(text, encoding="utf-8")
    path.with_suffix(".part").replace(path)


def made_now(decides: Sequence[str]) -> dict[str, Any]:
    """Of which state of the sources, when and where something is made; of this folder these files decide."""

    def git(*words: str) -> str:
        done = subprocess.run(["git", *words], cwd=FOLDER.parent, capture_output=True, text=True, check=False)
        return done.stdout.strip()

    changed = git("status", "--porcelain", "--", "src", *(f"evidence/{name}" for name in decides))
    info = Path("/proc/cpuinfo")
    lines = info.read_text(encoding="utf-8").splitlines() if info.exists() else []
    model = next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), "")
    return {
        "commit": git("rev-parse", "HEAD") + (", changed" if changed else ""),
        "date": datetime.now(UTC).date().isoformat(),
        "machine": f"{model or platform.machine()}, {os.cpu_count()} cores",
        "system": f"{platform.system()} {platform.machine()}, Python {platform.python_version()}",
        "libraries": {library: version(library) for library in LIBRARIES},
    }
