"""The compiled modules; all else that setuptools builds from stands in pyproject.toml."""

from Cython.Build import cythonize
from setuptools import Extension, setup

LIMITED_API = ("Py_LIMITED_API", "0x030B0000")  # of Python 3.11: one wheel for it and every later one
FLAGS = ["-O3", "-g0", "-fno-math-errno", "-fno-trapping-math", "-fvisibility=hidden"]
FLAGS += ["--param=vect-max-version-for-alias-checks=100"]  # loops over many rows become vector instructions, too
AS_WRITTEN = ["-ffp-contract=off"]
"""Sums are taken in the order that is written, and every processor gives the same bits."""
REORDERED = ["-ffp-contract=fast", "-fassociative-math", "-fno-signed-zeros"]
MODULES = {
    "tumble.reduction.kernels": AS_WRITTEN,
    "tumble.reduction.turns.moment_kernels": REORDERED,
    "tumble.inference.elimination_kernels": AS_WRITTEN,
    "tumble.sensors.fixed_point": AS_WRITTEN,
}

extensions = [
    Extension(
        name,
        [f"src/{name.replace('.', '/')}.pyx"],
        define_macros=[LIMITED_API],
        extra_compile_args=[*FLAGS, *sums],
        py_limited_api=True,
    )
    for name, sums in MODULES.items()
]
setup(
    ext_modules=cythonize(extensions, include_path=["src"], build_dir="build"),
    options={"bdist_wheel": {"py_limited_api": "cp311"}},
)
