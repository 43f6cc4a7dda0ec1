"""SciPy's compiled functions without its packages: the same functions, and packages that load as ever afterwards."""

import subprocess
import sys

import pytest

ALONE = """
import sys
from tumble.scipy_compiled import blas, lapack, special
assert "numpy.f2py" not in sys.modules and "scipy.special" not in sys.modules and "scipy.linalg" not in sys.modules
"""
WHOLE = """
import scipy.linalg, scipy.special, scipy.stats
from tumble.scipy_compiled import blas, lapack, special
"""
THE_SAME = """
import scipy.linalg, scipy.special, scipy.stats
assert special.fdtrc is scipy.special.fdtrc and special.stdtridf is scipy.special.stdtridf
assert lapack.dtpqrt is scipy.linalg.lapack.dtpqrt and blas.dsyrk is scipy.linalg.blas.dsyrk
assert abs(scipy.stats.chi2.sf(3.0, 2) - special.chdtrc(2.0, 3.0)) < 1e-15
"""
ELSEWHERE = """
import sys
class Moved:
    def find_spec(self, name, path=None, target=None):
        bare = not hasattr(sys.modules[name.rpartition(".")[0]], "__file__") if "." in name else False
        if bare and name in ("scipy.special._ufuncs", "scipy.linalg._fblas"):
            raise ImportError(name)
sys.meta_path.insert(0, Moved())
from tumble.scipy_compiled import blas, lapack, special
"""


@pytest.mark.parametrize("first", [ALONE, WHOLE, ELSEWHERE], ids=["alone", "after the packages", "kept elsewhere"])
def test_functions_are_those_of_the_packages(first: str) -> None:
    subprocess.run([sys.executable, "-W", "error", "-c", first + THE_SAME], check=True)
