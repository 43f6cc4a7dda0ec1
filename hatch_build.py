"""Compiles the loops over samples when tumble is built: `pip install .`, `pip install -e .`, `python -m build`, or
`make kernels` after one of them was changed.

Cython makes C of the modules that `tumble.compiled.LOOPS` names, and a compiler of C, the system's own or the one that
the package ziglang brings, makes machine code of that, which Python imports in place of the source beside it. It holds
for every Python from 3.11 (the limited API). On x86-64 the same C is compiled for three generations of processors, and
which of them is used is decided when it is imported; so what was built on one machine runs on every other.

Lines of a module that begin with `# C: ` are declarations for Cython: which functions become functions of C, and the
types of their arguments and of sums. What was not changed since is not compiled again. Modules are put beside their
sources once all of them are made, so that a build that fails changes nothing; where nothing can be compiled, tumble is
installed all the same, and the loops run as plain Python.
"""

from __future__ import annotations

import hashlib
import importlib.util
import os
import platform
import re
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

ROOT = Path(__file__).parent
SOURCE = ROOT / "src"
LIMITED_API = "0x030B0000"
ENDING = ".pyd" if sys.platform == "win32" else ".abi3.so"
SHARED = "tumble/memoryviews"
"""What all modules share of Cython's own."""

DIRECTIVES = {
    "language_level": 3,
    "annotation_typing": False,  # types are those of DECLARED alone
    "infer_types": True,
    "boundscheck": False,
    "wraparound": False,
    "initializedcheck": False,
    "cdivision": True,
    "emit_code_comments": False,
}
FLAGS = ("-O3", "-fPIC", "-fno-math-errno", "-fno-trapping-math", "-fvisibility=hidden", "-w")
GCC_FLAGS = ("--param=vect-max-version-for-alias-checks=1000",)
FUSED = {"reduction/turns/moment_kernels"}
"""Modules whose products and sums may be rounded once; the others give the same bits on all processors."""
REORDERED = {"reduction/turns/moment_kernels"}
"""Those among them whose sums over samples may be taken in another order."""
PLAIN = {"reduction/kernels"}
"""Modules that newer processors do not run faster."""
INDEPENDENT = {"reduction/turns/moment_kernels"}
"""Modules in which the steps of a loop over `i` do not depend on one another. GCC does not see it, and would ask in
every loop over lanes whether rows overlap."""
AVX2 = ("-mavx2", "-mfma", "-mbmi2")
AVX512 = (*AVX2, "-mavx512f", "-mavx512vl", "-mavx512dq", "-mavx512bw", "-mprefer-vector-width=512")
OLD = ("-O1",)
"""For processors from before 2013 the loops are compiled in a third of the time, and run at two thirds of the speed."""
GENERATIONS = {"_avx512": AVX512, "_avx2": AVX2, "": OLD}

DECLARED = re.compile(r"^# C: (.*)$", re.MULTILINE)
CHECK = """

from pathlib import Path as _Path

from tumble.compiled import expect_source as _expect_source

COMPILER = {compiler!r}
_expect_source(_Path(__file__).with_name(__name__.rpartition(".")[2] + ".py"), {built_from!r})
"""
"""What a compiled module ends with."""

LOOP_OVER_I = re.compile(r"for \((__pyx_t_\d+) = 0; \1 < __pyx_t_\d+; \1\+=1\) {\s*__pyx_v_i = \1;")
"""A loop over `i`, to a number that the compiler does not know, as Cython writes it."""

CHOICE = """
#include <Python.h>
extern PyObject *PyInit_{name}_avx512(void), *PyInit_{name}_avx2(void), *PyInit_{name}_any(void);
__attribute__((visibility("default"))) PyObject *PyInit_{name}(void) {{
    __builtin_cpu_init();
    if (!__builtin_cpu_supports("avx2") || !__builtin_cpu_supports("fma") || !__builtin_cpu_supports("bmi2"))
        return PyInit_{name}_any();
    if (__builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512vl") && __builtin_cpu_supports("avx512dq")
            && __builtin_cpu_supports("avx512bw"))
        return PyInit_{name}_avx512();
    return PyInit_{name}_avx2();
}}
"""


def _compiled() -> Any:
    """tumble.compiled, by its path: tumble cannot be imported while it is built."""
    spec = importlib.util.spec_from_file_location("compiled", SOURCE / "tumble/compiled.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def _run(*command: object) -> str:
    """What a command prints; its complaint is raised as an OSError."""
    done = subprocess.run([str(word) for word in command], capture_output=True, text=True, check=False)
    if done.returncode:
        raise OSError((done.stderr.strip() or done.stdout.strip() or str(command[0])).splitlines()[-1])
    return done.stdout


def system_compiler() -> list[str]:
    """The system's compiler of C, if it has one that makes a shared library; MSVC is not one of them."""
    if sys.platform == "win32":
        return []
    for name in (os.environ.get("CC", ""), "cc", "gcc", "clang"):
        if not name or not shutil.which(name.split()[0]):
            continue
        with tempfile.TemporaryDirectory() as folder:
            source = Path(folder) / "any.c"
            source.write_text("#include <math.h>\n#include <stdio.h>\n")
            try:
                _run(*name.split(), "-shared", "-fPIC", source, "-o", source.with_suffix(".so"))
            except OSError:
                continue
        return name.split()
    return []


class Compiler:
    """A compiler of C and its flags."""

    def __init__(self) -> None:
        self.command = system_compiler() or [sys.executable, "-m", "ziglang", "cc"]
        if sys.platform == "win32":
            self.command += ["-target", f"{platform.machine().lower().replace('amd64', 'x86_64')}-windows-gnu"]
        self.version = _run(*self.command, "--version").splitlines()[0]
        clang = "clang" in self.version.lower()
        python = sysconfig.get_path("include")
        if not (Path(python) / "Python.h").exists():
            raise OSError(f"{python}/Python.h is missing: the headers of this Python are not installed")
        self.flags = [*FLAGS, *(() if clang else GCC_FLAGS), f"-DPy_LIMITED_API={LIMITED_API}", f"-I{python}"]

    def compile(self, source: Path, target: Path, *flags: str) -> Path:
        """An object file."""
        _run(*self.command, *self.flags, *flags, "-c", source, "-o", target)
        return target

    def link(self, objects: Sequence[Path], target: Path) -> None:
        """A module that Python imports."""
        how = {
            "darwin": ("-bundle", "-undefined", "dynamic_lookup"),
            "win32": ("-shared", f"-L{sys.base_prefix}/libs", "-lpython3"),
        }.get(sys.platform, ("-shared", "-lm"))
        _run(*self.command, *objects, *how, "-o", target)


def _c_of_shared(folder: Path) -> Path:
    """Cython's own part."""
    source = folder / f"{Path(SHARED).name}.c"
    name = SHARED.replace("/", ".")
    _run(sys.executable, "-m", "cython", f"--generate-shared={source}", "-M", "--module-name", name)
    return source


def _c_of(loops: str, folder: Path, built_from: str, compiler: str) -> Path:
    """A module of LOOPS as C, by a copy of it that knows what it was made of, with its declarations beside it."""
    text = (SOURCE / f"tumble/{loops}.py").read_text(encoding="utf-8")
    copy = folder / f"tumble/{loops}.py"
    copy.parent.mkdir(parents=True, exist_ok=True)
    for package in copy.parents:
        if folder in package.parents:
            (package / "__init__.py").touch()
    copy.write_text(text + CHECK.format(built_from=built_from, compiler=compiler), encoding="utf-8")
    declared = "".join(f"{line}\n" for line in DECLARED.findall(text))
    copy.with_suffix(".pxd").write_text(f"cimport cython\n{declared}", encoding="utf-8")
    source = folder / f"{Path(loops).name}.c"
    directives = (word for key, value in DIRECTIVES.items() for word in ("-X", f"{key}={value}"))
    _run(sys.executable, "-m", "cython", *directives, f"--shared={SHARED.replace('/', '.')}", copy, "-o", source)
    if loops in INDEPENDENT:
        source.write_text(LOOP_OVER_I.sub(r"\n#pragma GCC ivdep\n\g<0>", source.read_text()))
    return source


def _make(compiler: Compiler, loops: str, folder: Path, built_from: str, mark: str) -> None:
    """A module of LOOPS as machine code, in a folder."""
    source, name = _c_of(loops, folder, built_from, compiler.version), Path(loops).name
    sums = [f"-ffp-contract={'fast' if loops in FUSED else 'off'}"]
    sums += ["-fassociative-math", "-fno-signed-zeros"] if loops in REORDERED else []
    choice = folder / f"{name}_choice.c"
    choice.write_text(f'const char {name}_built_from[] __attribute__((used)) = "{mark}";\n')
    objects = []
    if loops in PLAIN or platform.machine().lower() not in ("x86_64", "amd64"):
        objects.append(compiler.compile(source, folder / f"{name}.o", *sums))
    else:
        for generation, flags in GENERATIONS.items():
            ending = generation or "_any"
            whole = "__pyx_module_is_main_" + "__".join(("tumble", *loops.split("/")))
            renamed = (f"-D{symbol}={symbol}{ending}" for symbol in (f"PyInit_{name}", whole))
            objects.append(compiler.compile(source, folder / f"{name}{ending}.o", *sums, *flags, *renamed))
        choice.write_text(choice.read_text() + CHOICE.format(name=name))
    objects.append(compiler.compile(choice, choice.with_suffix(".o")))
    compiler.link(objects, folder / f"tumble/{loops}{ENDING}")


def _make_shared(compiler: Compiler, folder: Path) -> None:
    source = _c_of_shared(folder)
    compiler.link([compiler.compile(source, source.with_suffix(".o"), "-O1")], folder / (SHARED + ENDING))


def build() -> str:
    """Compile what is not compiled yet or was changed, this file included, and put it in place once all of it is made;
    what was done in words."""
    compiled = _compiled()
    recipe = hashlib.sha256(Path(__file__).read_bytes()).hexdigest()
    hashes = {loops: compiled.source_hash(SOURCE / f"tumble/{loops}.py") for loops in compiled.LOOPS}
    marks = {loops: f"tumble loops {built_from} {recipe}" for loops, built_from in hashes.items()}
    targets = {loops: SOURCE / f"tumble/{loops}{ENDING}" for loops in hashes}
    old = [k for k, file in targets.items() if not file.exists() or marks[k].encode() not in file.read_bytes()]
    shared = SOURCE / (SHARED + ENDING)
    if not old and shared.exists():
        return "compiled already"
    compiler = Compiler()
    beside = tempfile.TemporaryDirectory(dir=SOURCE, prefix=".compiled")
    with beside as name, ThreadPoolExecutor(os.cpu_count()) as pool:
        folder = Path(name)
        (folder / "tumble").mkdir()
        longest_first = sorted(old, key=lambda loops: -(SOURCE / f"tumble/{loops}.py").stat().st_size)
        jobs = [pool.submit(_make, compiler, k, folder, hashes[k], marks[k]) for k in longest_first]
        jobs.append(pool.submit(_make_shared, compiler, folder))
        for job in jobs:
            job.result()
        (folder / (SHARED + ENDING)).replace(shared)
        for loops in old:
            (folder / f"tumble/{loops}{ENDING}").replace(targets[loops])
    return f"compiled {', '.join(old) or SHARED}: {compiler.version}"


def remove() -> None:
    """Remove all that is compiled, so that the sources run."""
    for file in (SOURCE / "tumble").rglob(f"*{ENDING}"):
        file.unlink()


class Loops(BuildHookInterface):  # type: ignore[type-arg]
    """Compiles the loops for the wheel, or beside their source for an installation that is edited."""

    def dependencies(self) -> list[str]:
        """What has to be installed to build."""
        return ["cython>=3.2", *([] if system_compiler() else ["ziglang>=0.13"])]

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:  # noqa: ARG002
        """Compile; where that cannot be done, say so and go on."""
        try:
            build()
        except OSError as error:
            remove()
            self.app.display_warning(f"tumble: the loops over samples stay plain Python and are slow: {error}")
            return
        build_data["pure_python"] = False
        system = sysconfig.get_platform().replace("universal2", platform.machine())  # one architecture is compiled for
        build_data["tag"] = f"cp311-abi3-{system.replace('-', '_').replace('.', '_')}"
        build_data["artifacts"] += [f"src/tumble/**/*{ENDING}"]


if __name__ == "__main__":
    print(build())  # noqa: T201
