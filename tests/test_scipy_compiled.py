"""SciPy's compiled functions without its packages: the same functions, and packages that load as ever afterwards."""

import re
import subprocess
import sys
from pathlib import Path

import pytest
import scipy.linalg
import scipy.special

import tumble
from tumble.scipy_compiled import lapack, special

ALONE = """
import sys
from tumble.scipy_compiled import lapack, special
assert "numpy.f2py" not in sys.modules and "scipy.special" not in sys.modules and "scipy.linalg" not in sys.modules
"""
WHOLE = """
import scipy.linalg, scipy.special, scipy.stats
from tumble.scipy_compiled import lapack, special
"""
THE_SAME = """
import scipy.linalg, scipy.special, scipy.stats
assert special.fdtrc is scipy.special.fdtrc and special.stdtridf is scipy.special.stdtridf
assert lapack.dtpqrt is scipy.linalg.lapack.dtpqrt
assert abs(scipy.stats.chi2.sf(3.0, 2) - special.chdtrc(2.0, 3.0)) < 1e-15
"""
ELSEWHERE = """
import sys
class Moved:
    def find_spec(self, name, path=None, target=None):
        bare = not hasattr(sys.modules[name.rpartition(".")[0]], "__file__") if "." in name else False
        if bare and name in ("scipy.special._ufuncs", "scipy.linalg._flapack"):
            raise ImportError(name)
sys.meta_path.insert(0, Moved())
from tumble.scipy_compiled import lapack, special
"""


@pytest.mark.parametrize("first", [ALONE, WHOLE, ELSEWHERE], ids=["alone", "after the packages", "kept elsewhere"])
def test_functions_are_those_of_the_packages(first: str) -> None:
    subprocess.run([sys.executable, "-W", "error", "-c", first + THE_SAME], check=True)


def test_every_function_that_is_used_is_the_public_one() -> None:
    sources = "\n".join(file.read_text() for file in Path(tumble.__file__).parent.rglob("*.py"))
    for compiled, name, public in (
        (special, "special", scipy.special),
        (lapack, "lapack", scipy.linalg.lapack),
    ):
        used = set(re.findall(rf"\b{name}\.([a-z]\w+)\(", sources))
        assert used
        assert [function for function in used if getattr(compiled, function) is not getattr(public, function)] == []


def test_a_calibration_starts_without_the_packages() -> None:
    start = "import sys, tumble.commands.calibrate, tumble.run.calibrate, tumble.views.calibration\n"
    absent = "assert not {'scipy.special', 'scipy.linalg', 'scipy.optimize', 'numpy.f2py'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", start + absent], check=True)
