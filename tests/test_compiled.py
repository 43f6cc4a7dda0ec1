"""The compiled loops against the same source run as Python; what is compiled is of today's source."""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import sys
from dataclasses import fields
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from click.testing import CliRunner

from tumble import cli, compiled, uncompiled
from tumble.inference import elimination
from tumble.reduction import kernels
from tumble.reduction.turns import moment_kernels, moments
from tumble.reduction.turns.moments import BlockCompensation, Compensation, OwnAxes, Pieces, moments_of
from tumble.sensors import fixed_point
from tumble.units import Array

LOOPS = kernels, moment_kernels, elimination, fixed_point
MODULES = dict(zip(compiled.LOOPS, LOOPS, strict=True))
pytestmark = pytest.mark.skipif(bool(compiled.as_python()), reason="the loops are not compiled here")


def as_python(loops: str) -> ModuleType:
    """A module of loops that runs as it is written."""
    spec = importlib.util.spec_from_file_location("plain", compiled.FOLDER / f"{loops}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def rows(rests: int, angles: int, parameters: int, seed: int) -> tuple[tuple[npt.NDArray[Any], ...], Array, Array]:
    """Rows of rests and turns of a chain that is interrupted once, and memory for factors and triangle."""
    rng = np.random.default_rng(seed)
    link = np.append(np.arange(rests - 1), -1)
    link[rests // 2] = -1
    rest = rng.standard_normal((rests, 3, angles + parameters + 1))
    turn = rng.standard_normal((rests - 1, 6, 2 * angles + parameters + 1))
    factor = np.zeros((rests, angles, 2 * angles + parameters + 1))
    return (rest, turn, link), factor, np.zeros((parameters + 1, parameters + 1))


def chain(module: ModuleType) -> list[Array]:
    """All that elimination gives for a chain."""
    given, factor, triangle = rows(9, 3, 7, 1)
    module.eliminate(*given, factor, triangle)
    rng, solved = np.random.default_rng(2), module.put_back(factor)
    Z, component = rng.standard_normal((4, 5, 6)), np.array([0, 0, 1, 2, 2, 4])
    whitening = module.whitening(np.tile(np.eye(5), (4, 1, 1)), Z, component, np.array([0.1, 0.0, 0.3, 0.0, 0.2]))
    return [factor, triangle, *solved, module.given_parameters(*solved[:2]), whitening]


def test_elimination_is_that_of_python_to_the_bit() -> None:
    for found, expected in zip(chain(elimination), chain(as_python("inference/elimination")), strict=True):
        np.testing.assert_array_equal(found, expected)


def test_moments_are_those_of_python(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(3)
    rates, forces = 0.5 * rng.standard_normal((90, 3)), 10.0 * rng.standard_normal((90, 3))
    starts, stops = np.array([0, 30, 47]), np.array([25, 47, 90])
    pieces = Pieces(
        rates=rates, forces=forces, intervals=np.full(90, 0.01), turn=np.arange(3), start=starts, stop=stops
    )
    block = BlockCompensation(
        axes=np.eye(3),
        to_body=np.eye(3),
        matrix=np.eye(3) + 0.01 * rng.standard_normal((3, 3)),
        bias=0.1 * rng.standard_normal(3),
        terms=1e-3 * rng.standard_normal((3, 3)),
    )
    compensation = Compensation(gyro=block, accel=block, g_sensitivity=1e-3 * np.ones((3, 3)), delay=3e-3)
    own = OwnAxes(gyro=np.eye(3), accel=np.eye(3)[:2])
    found = moments_of(pieces, compensation, own)
    monkeypatch.setattr(moments, "_kernels", as_python("reduction/turns/moment_kernels"))
    expected = moments_of(pieces, compensation, own)
    for field in fields(found):
        ours, theirs = getattr(found, field.name), getattr(expected, field.name)
        assert np.isfinite(theirs).all()
        np.testing.assert_allclose(ours, theirs, rtol=1e-12, atol=1e-12, err_msg=field.name)


def test_sums_over_samples_are_those_of_python() -> None:
    rng = np.random.default_rng(4)
    phase, sizes = np.cumsum(rng.standard_normal(1001)), np.array([1, 7, 300, 500])
    values, time = np.round(rng.standard_normal((200, 2)), 1), 0.01 * np.arange(200.0)
    found = []
    for module in (kernels, as_python("reduction/kernels")):
        state, out, sums, filled = module.new_channel_state(2), np.zeros((30, 2)), np.zeros(2), np.array([3])
        blocks = module.block_sums(values, time, np.ones(200), 7, sums, filled, state, out)
        filters, powers, further = np.zeros((4, 4)), np.zeros(4), np.append([4.0, 2.0, 1.0, 0.5], np.zeros(300))
        orders = module.levinson(further[:4].copy(), filters, powers)
        module.continue_autocovariance(further, np.array([1.0, -0.5, 0.0, 0.1]), 1e-9)
        found.append([np.array([blocks, orders]), module.allan_sums(phase, sizes), state, out, sums, filled, filters])
        lagging = values[:, 0].copy()
        module.follow(lagging, 0.3)
        found[-1] += [powers, further, lagging]
    for ours, theirs in zip(*found, strict=True):
        np.testing.assert_array_equal(ours, theirs)


@pytest.mark.parametrize("of_force", [True, False])
def test_samples_are_solved_as_by_python_to_the_bit(of_force: bool) -> None:
    rng = np.random.default_rng(6)
    readings, other, celsius = (rng.standard_normal((150, columns)) for columns in (4, 3, 2))
    sheet, own = 1e-2 * rng.standard_normal((4, fixed_point.WIDTH)), np.array([0, 1, 1, 0])
    sheet[:, fixed_point.AXIS : fixed_point.AXIS + 3] = axes = rng.standard_normal((4, 3))
    sheet[:, fixed_point.INVERSE : fixed_point.AXIS] = np.linalg.pinv(axes).T
    readings[5, 2] = np.nan
    found, expected = (
        module.fixed_point(readings, celsius, own, other, sheet, 6, of_force=of_force, feels=True)
        for module in (fixed_point, as_python("sensors/fixed_point"))
    )
    np.testing.assert_array_equal(found, expected)
    assert np.flatnonzero(np.isnan(found).any(axis=1)).tolist() == [5]


def test_a_stream_is_corrected_as_by_python_to_the_bit() -> None:
    """With lever arms, a lag, lost and late samples, in two blocks."""
    rng = np.random.default_rng(7)
    accel, gyro, celsius = rng.standard_normal((40, 3)), rng.standard_normal((40, 3)), rng.standard_normal((40, 2))
    time, own = 0.01 * np.arange(40.0), np.array([0, 1, 1])
    accel[5, 1], gyro[9, 2], celsius[3, 1], time[12], time[20:] = np.nan, np.nan, np.nan, 0.105, time[20:] + 0.5
    sheets = [1e-2 * rng.standard_normal((3, fixed_point.WIDTH)) for _ in range(2)]
    for sheet in sheets:
        sheet[:, fixed_point.INVERSE : fixed_point.REFERENCE] += np.hstack([np.eye(3), np.eye(3)])
    settings = np.array([0.01, 0.3, np.exp(-0.01 / 0.3), -1.0, 1.0, 1.0, 0.0, 0.035, 2.0, 3.0, np.nan])
    found = []
    for module in (fixed_point, as_python("sensors/fixed_point")):
        rows, warmth = np.zeros((42, 2 + 9 + 2 + 9)), np.array([[0.0, np.nan]] * 2)
        state = rows, warmth, np.array([-np.inf, 0.0, 0.0]), np.zeros((2, 3))
        out, held, ready = (np.zeros((41, 4)), np.zeros((41, 3)), np.zeros((41, 3))), 0, 0
        for some, last in ((slice(17), False), (slice(17, None), True)):
            given, rest = (accel[some], gyro[some], time[some], celsius[some]), tuple(each[ready:] for each in out)
            sensors = (*sheets, own, own, 6, 6, True)
            more, held = module.advance(given, sensors, settings, state, held, rest, moved=True, last=last)
            ready += more
        found.append([*out, warmth, state[2], np.array([ready])])
    for ours, theirs in zip(*found, strict=True):
        np.testing.assert_array_equal(ours, theirs)
    assert found[0][-1] == 39
    assert np.isfinite(found[0][2][:39]).all(axis=1).sum() == 37


@pytest.mark.parametrize("loops", compiled.LOOPS)
def test_what_is_compiled_has_the_constants_of_its_source(loops: str) -> None:
    assert Path(str(MODULES[loops].__file__)).suffix != ".py"
    plain = vars(as_python(loops))
    constants = {name: value for name, value in plain.items() if name.strip("_").isupper() and isinstance(value, int)}
    assert {name: getattr(MODULES[loops], name) for name in constants} == constants


def test_words_say_what_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    assert compiled.words() == f"compiled, {kernels.COMPILER}"  # type: ignore[attr-defined]
    monkeypatch.delattr(fixed_point, "COMPILER")
    assert compiled.words().endswith("; plain Python, some hundred times slower: sensors/fixed_point")
    for module in MODULES.values():
        monkeypatch.delattr(module, "COMPILER", raising=False)
    assert compiled.words().startswith("plain Python")


IMPORTED = "import tumble.reduction.kernels as k, tumble.compiled as c; print(k.__file__, c.as_python())"


def test_old_machine_code_is_refused_and_without_it_the_source_runs(tmp_path: Path) -> None:
    package = tmp_path / "tumble"
    copied = shutil.ignore_patterns("__pycache__", "page", "*.html")
    shutil.copytree(compiled.FOLDER, package, ignore=copied)
    source = package / "reduction/kernels.py"

    def imported() -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, "-c", IMPORTED], env={**os.environ, "PYTHONPATH": str(tmp_path)}, capture_output=True,
            text=True, check=False,
        )  # fmt: skip

    (machine_code,) = (path for path in source.parent.glob("kernels.*") if path != source)
    assert imported().stdout == f"{machine_code} ()\n"
    source.write_text(source.read_text(encoding="utf-8") + "# changed\n", encoding="utf-8")
    refused = imported()
    assert refused.returncode != 0
    assert refused.stderr.splitlines()[-1] == (
        f"ImportError: {source}: expected the source that the compiled module beside it was made of, found another; "
        "run `make kernels`, or `pip install -e .` again"
    )
    machine_code.unlink()
    assert imported().stdout == f"{source} ('reduction/kernels',)\n"


def test_a_build_that_fails_changes_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("hatchling")
    pytest.importorskip("Cython")
    spec = importlib.util.spec_from_file_location("hatch_build", compiled.FOLDER.parents[1] / "hatch_build.py")
    assert spec is not None
    assert spec.loader is not None
    build = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(build)
    loops = tmp_path / "tumble/reduction"
    loops.mkdir(parents=True)
    shutil.copy(compiled.FOLDER / "compiled.py", tmp_path / "tumble")
    (loops / "good.py").write_text("COUNT = 3\n")
    (loops / "bad.py").write_text("# C: cdef no_type _f(nothing x)\ndef _f(x): return x\n")
    monkeypatch.setattr(build, "SOURCE", tmp_path)
    made = build._compiled()
    monkeypatch.setattr(made, "LOOPS", ("reduction/good", "reduction/bad"))
    monkeypatch.setattr(build, "_compiled", lambda: made)
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(OSError, match="is not a type identifier"):
        build.build()
    assert sorted(tmp_path.rglob("*")) == before


def test_where_nothing_is_compiled_a_line_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cli, "as_python", lambda: compiled.LOOPS)
    said = CliRunner().invoke(cli.main, ["programme", "none"]).stderr.splitlines()
    assert said[0] == "tumble: the loops over samples are not compiled and run as plain Python, slowly"
    assert "plain Python" not in CliRunner().invoke(cli.main, ["-q", "programme", "none"]).stderr


def test_what_stands_for_cython_has_what_the_loops_use() -> None:
    assert not uncompiled.compiled
    with uncompiled.nogil:
        pass
