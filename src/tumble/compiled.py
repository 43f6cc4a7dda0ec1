"""Whether the loops over samples run as machine code, as the modules that are loaded have it.

A compiled module says what compiled it and the hash of its source, and is not imported where the source beside it is
another. hatch_build.py, which compiles, reads this file too; so it imports nothing of tumble.
"""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

FOLDER = Path(__file__).parent
LOOPS = (
    "reduction/kernels",
    "reduction/turns/moment_kernels",
    "inference/elimination",
    "sensors/fixed_point",
)


def source_hash(source: Path) -> str:
    """SHA-256 of what a module of LOOPS is compiled from."""
    import hashlib

    return hashlib.sha256(source.read_bytes().replace(b"\r\n", b"\n")).hexdigest()


def expect_source(source: Path, built_from: str) -> None:
    """Raise ImportError in a compiled module whose source was changed after it was compiled."""
    if source.exists() and source_hash(source) != built_from:
        raise ImportError(
            f"{source}: expected the source that the compiled module beside it was made of, found another; run "
            "`make kernels`, or `pip install -e .` again"
        )


def _name(loops: str) -> str:
    return f"tumble.{loops.replace('/', '.')}"


def as_python() -> tuple[str, ...]:
    """Modules of LOOPS that Python finds as source, without loading them."""
    specs = {loops: find_spec(_name(loops)) for loops in LOOPS}
    return tuple(loops for loops, spec in specs.items() if spec is None or str(spec.origin).endswith(".py"))


def words() -> str:
    """What the loops over samples run as, in a few words, by the modules as they are loaded."""
    compilers = {loops: getattr(import_module(_name(loops)), "COMPILER", None) for loops in LOOPS}
    plain = [loops for loops, compiler in compilers.items() if compiler is None]
    if len(plain) == len(LOOPS):
        return "plain Python, some hundred times slower"
    by = f"compiled, {'; '.join(sorted({compiler for compiler in compilers.values() if compiler}))}"
    return f"{by}; plain Python, some hundred times slower: {', '.join(plain)}" if plain else by
