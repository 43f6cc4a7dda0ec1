"""The documentation says what is true: commands run, outputs are those of the program, links lead somewhere.

A page of `RUN` is executed from top to bottom in an empty folder: files (```toml after `<!-- file: NAME -->`) are
written, the commands of ```console blocks run and their output compared, ```python blocks with >>> run as doctests.
A line `...` in an output stands for lines that are left out. Numbers may differ by LAST_DIGIT in the last one shown.

    python -m tests.docs.test_docs        puts the outputs of today into the pages, to be read before they are committed
"""

from __future__ import annotations

import contextlib
import doctest
import hashlib
import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, field, fields, replace
from importlib import import_module
from pathlib import Path

import click
import numpy as np
import pytest
from click.testing import CliRunner
from scipy.linalg import rq

from tests.support import ROOT, study
from tumble.cli import main
from tumble.diagnosis.turn_likelihood import WIDTHS
from tumble.recording.log import open_log
from tumble.recording.session_file import read_session
from tumble.reduction.blocks.tuning import USUAL
from tumble.run.calibrate import calibrate
from tumble.run.observed import inspect_session
from tumble.units import DEGREE, DEGREE_PER_HOUR, G_STANDARD, Array

RUN = (
    "README.md",
    "docs/tutorial/first-calibration.md",
    "docs/tutorial/rough-table.md",
    "docs/reference/conventions.md",
    "docs/howto/cube.md",
    "docs/howto/where-u-comes-from.md",
    "docs/howto/mission.md",
    "docs/howto/ellipsoid.md",
    "docs/howto/waved-about.md",
    "docs/evidence/xsens.md",
    "docs/evidence/imucal.md",
    "docs/evidence/ln100.md",
    "docs/evidence/psins.md",
    "docs/howto/recordings.md",
    "docs/howto/registry.md",
    "docs/howto/field-check.md",
    "docs/howto/watch.md",
    "docs/howto/campaigns.md",
    "docs/howto/plan.md",
    "docs/reference/api.md",
)
RECORDINGS = {
    "docs/tutorial/first-calibration.md": "xsens-mti",
    "docs/evidence/xsens.md": "xsens-mti",
    "docs/evidence/imucal.md": "imucal-ferraris",
    "docs/evidence/ln100.md": "ln100-updown",
    "docs/evidence/psins.md": "psins-systematic",
}
"""Pages that need a recording: the folder of the shared data that is copied into the empty one."""

BLOCK = re.compile(r"(?:^<!-- file: (?P<file>\S+) -->\n+)?^```(?P<language>\w+)\n(?P<text>.*?)^```$", re.M | re.S)
COMMAND = re.compile(r"^\$ (.*)\n", re.M)
NUMBER = re.compile(r"[-+−]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")
LAST_DIGIT = 2
"""What another machine, or a better rounding, may change of a number without the page being wrong."""

LINK = re.compile(r"(?<!`)!?\[[^\]]*\]\(([^)\s]+)\)")


# -------------------- pages that are run --------------------


@dataclass(kw_only=True)
class Reader:
    """Someone who does what a page says, in a folder of their own."""

    folder: Path
    status: int = 0
    names: dict[str, object] = field(default_factory=dict)

    def run(self, command: str) -> str:
        """What a command prints on both streams."""
        words = shlex.split(command)
        with contextlib.chdir(self.folder):
            if words[0] == "tumble":
                result = CliRunner().invoke(main, words[1:], prog_name="tumble")
                if result.exception is not None and not isinstance(result.exception, SystemExit):
                    raise result.exception
                self.status = result.exit_code
                return result.output
            shell = ["sh", "-c", command.replace("$?", str(self.status))]
            done = subprocess.run(shell, capture_output=True, text=True, check=False)
            self.status = done.returncode
            return done.stdout + done.stderr

    def doctest(self, text: str, name: str) -> str:
        """Run the examples of a Python block; the result is the report of failures."""
        said: list[str] = []
        test = doctest.DocTestParser().get_doctest(text, self.names, name, name, 0)
        with contextlib.chdir(self.folder):
            doctest.DocTestRunner(checker=Checker()).run(test, out=said.append, clear_globs=False)
        self.names = test.globs
        return "".join(said)


class Checker(doctest.OutputChecker):
    """Compares the outputs of Python examples like those of commands."""

    def check_output(self, want: str, got: str, optionflags: int) -> bool:  # noqa: ARG002
        """Whether an output is the expected one."""
        return same_output(lines_of(want), lines_of(got))


def lines_of(text: str) -> list[str]:
    """Lines without blanks at their ends and without empty lines at the end."""
    return [line.rstrip() for line in text.rstrip().splitlines()]


def same_line(expected: str, found: str) -> bool:
    """Whether two lines have the same words, and the same numbers up to LAST_DIGIT in the last digit that is shown."""
    if NUMBER.sub("#", expected).split() != NUMBER.sub("#", found).split():
        return False
    return all(map(same_number, NUMBER.findall(expected), NUMBER.findall(found)))


def same_number(expected: str, found: str) -> bool:
    """Whether two numbers are the same up to LAST_DIGIT in the last digit of the expected one, or to 1e-10 of it: of
    numbers that are written in full the digits behind are those of a processor and its linear algebra."""
    mantissa, _, exponent = expected.partition("e")
    last = 10.0 ** (int(exponent or 0) - len(mantissa.partition(".")[2]))
    a, b = (float(number.replace("−", "-")) for number in (expected, found))
    return abs(a - b) <= max((LAST_DIGIT + 0.01) * last, 1e-10 * abs(a))


def same_output(expected: list[str], found: list[str]) -> bool:
    """Whether an output is the expected one, `...` standing for any lines."""
    if not expected:
        return not found
    if expected[0].strip() == "...":
        return any(same_output(expected[1:], found[i:]) for i in range(len(found) + 1))
    return bool(found) and same_line(expected[0], found[0]) and same_output(expected[1:], found[1:])


def outputs_of(block: str) -> Iterator[tuple[str, str]]:
    """The commands of a console block, each with the output under it."""
    parts = COMMAND.split(block)
    assert parts[0] == "", f"a console block begins with a command, found {parts[0]!r}"
    yield from zip(parts[1::2], parts[2::2], strict=True)


@pytest.fixture(params=RUN)
def page(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """A page that is run, its recording copied to tmp_path."""
    name: str = request.param
    if name in RECORDINGS:
        recordings: Path = request.getfixturevalue("data")
        shutil.copytree(recordings / RECORDINGS[name], tmp_path / RECORDINGS[name])
    return ROOT / name


def test_every_pasted_output_is_that_of_the_program(page: Path, tmp_path: Path) -> None:
    reader = Reader(folder=tmp_path)
    checked = 0
    for block in BLOCK.finditer(page.read_text(encoding="utf-8")):
        text = block["text"]
        if block["file"]:
            (tmp_path / block["file"]).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / block["file"]).write_text(text, encoding="utf-8")
        elif block["language"] == "console":
            for command, expected in outputs_of(text):
                found = reader.run(command)
                assert same_output(lines_of(expected), lines_of(found)), f"$ {command}\n{found}"
                checked += 1
        elif block["language"] == "python" and ">>>" in text:
            failures = reader.doctest(text, page.name)
            assert not failures, failures
            checked += 1
    assert checked > 0, f"{page} has nothing to run"


# -------------------- commands, links, licence --------------------


def commands(group: click.Group = main, path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], click.Command]]:
    """All commands of the command line with the words that call them."""
    context = click.Context(group)
    for name in group.list_commands(context):
        command = group.get_command(context, name)
        assert command is not None
        yield (*path, name), command
        if isinstance(command, click.Group):
            yield from commands(command, (*path, name))


def section(text: str, heading: str) -> str:
    """The part of a page under a heading, without its subsections of the same level."""
    found = re.search(rf"^## {re.escape(heading)}$(.*?)(?=^## |\Z)", text, re.M | re.S)
    assert found is not None, f"docs/reference/commands.md has no section '## {heading}'"
    return found[1]


@pytest.mark.parametrize(("words", "command"), [pytest.param(w, c, id="-".join(w)) for w, c in commands()])
def test_every_command_and_option_is_documented(words: tuple[str, ...], command: click.Command) -> None:
    text = section((ROOT / "docs/reference/commands.md").read_text(encoding="utf-8"), "tumble " + " ".join(words))
    for parameter in command.params:
        if isinstance(parameter, click.Option):
            for spelling in parameter.opts:
                assert f"`{spelling}" in text, f"tumble {' '.join(words)}: {spelling} is not documented"
            if isinstance(parameter.type, click.Choice):
                missing = [choice for choice in parameter.type.choices if f"`{choice}`" not in text]
                assert not missing, f"tumble {' '.join(words)} {parameter.opts[0]}: {missing} not documented"
        else:
            assert str(parameter.make_metavar(click.Context(command))).strip("[].") in text


def test_no_option_is_documented_that_does_not_exist() -> None:
    text = (ROOT / "docs/reference/commands.md").read_text(encoding="utf-8")
    for words, command in commands():
        known = {spelling for p in command.params if isinstance(p, click.Option) for spelling in p.opts} | {"--help"}
        named = set(re.findall(r"^\| `(--[a-z-]+)", section(text, "tumble " + " ".join(words)), re.M))
        assert named <= known, f"tumble {' '.join(words)}: {', '.join(sorted(named - known))} does not exist"
        rows = re.findall(r"^\|(.*)\|$", section(text, "tumble " + " ".join(words)), re.M)
        assert all(len(re.split(r"(?<!\\)\|", row)) == 3 for row in rows if row.startswith(" `-"))


def pages() -> list[Path]:
    """Every page of the documentation."""
    return sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md")])


@pytest.mark.parametrize("path", pages(), ids=lambda path: path.name)
def test_links_lead_to_files_and_headings_that_exist(path: Path) -> None:
    for target in LINK.findall(BLOCK.sub("", path.read_text(encoding="utf-8"))):
        if re.match(r"[a-z]+:", target):
            continue
        file, _, heading = target.partition("#")
        linked = (path.parent / file).resolve() if file else path
        assert linked.exists(), f"{path.relative_to(ROOT)}: no file {file}"
        assert not heading or heading in anchors(linked), f"{path.relative_to(ROOT)}: no heading #{heading} in {file}"


def anchors(path: Path) -> set[str]:
    """The headings of a page as they are linked to."""
    headings = re.findall(r"^#+ (.+)$", BLOCK.sub("", path.read_text(encoding="utf-8")), re.M)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def test_the_gallery_shows_the_lines_that_draw_it(tmp_path: Path) -> None:
    gallery = study("gallery")
    gallery.draw_all(tmp_path)
    assert len(list(tmp_path.glob("*.svg"))) == len(gallery.PICTURES)
    page = (ROOT / "docs/howto/gallery.md").read_text(encoding="utf-8")
    assert page == gallery.page(), "run python studies/gallery.py"


def test_every_page_is_in_index_and_navigation_by_its_title() -> None:
    """The navigation has no names of its own but those of two pages that stand outside docs/ and of the index."""
    index = (ROOT / "docs/index.md").read_text(encoding="utf-8")
    navigation = (ROOT / "mkdocs.yml").read_text(encoding="utf-8").partition("\nnav:\n")[2]
    listed = re.findall(r"^ +- (?:(.+): )?(\S+\.md)$", navigation, re.M)
    assert {name for name, _ in listed if name} == {"Contents", "Start", "Changelog"}
    for path in pages():
        page = path.relative_to(ROOT / "docs" if path.is_relative_to(ROOT / "docs") else ROOT).as_posix()
        if "/" not in page:
            continue
        title = path.read_text(encoding="utf-8").partition("\n")[0].removeprefix("# ")
        assert f"[{title}]({page})" in index
        assert ("", page) in listed


def test_the_licence_is_the_unmodified_text_of_apache_2_0() -> None:
    digest = hashlib.sha256((ROOT / "LICENSE").read_bytes()).hexdigest()
    assert digest == "c71d239df91726fc519c6eb72d318ec65820627232b2f796219e87dcf35d0ab4"


THRESHOLD = re.compile(r"^\| `([A-Z_]+)` \| ([a-z._]+) \| ([0-9.e-]+) ?(s|rad|°/s|°|mg|) \|", re.M)
SI = {"": 1.0, "s": 1.0, "rad": 1.0, "°": DEGREE, "°/s": DEGREE, "mg": 1e-3 * G_STANDARD}


def test_the_thresholds_of_the_method_are_those_of_the_code() -> None:
    text = (ROOT / "docs/explanation/method-staged.md").read_text(encoding="utf-8")
    rows = THRESHOLD.findall(text)
    assert len(rows) == 10
    for name, module, value, unit in rows:
        assert getattr(import_module(f"tumble.{module}"), name) == pytest.approx(float(value) * SI[unit]), name
    for name in re.findall(r"`([A-Z][A-Z_]+)`", text):
        assert name in {row[0] for row in rows}, f"{name} is not in the table of thresholds"


def test_every_threshold_of_the_reduction_is_on_its_page() -> None:
    """With its value, what it means and what justifies it, as the record has them."""
    text = (ROOT / "docs/reference/tuning.md").read_text(encoding="utf-8")
    rows = [
        f"| `{each.name}` | {'{value:.3g} {unit}'.format(**each.metadata).strip()} | {each.metadata['words']} "
        f"| {each.metadata['why']} |"
        for each in fields(USUAL)
    ]
    assert re.findall(r"^\| `.*$", text.partition("\n## ")[0], re.M) == rows
    widths = [
        f"| `{width.name}` | {getattr(WIDTHS, width.name):g} | {width.metadata['words']} | {width.metadata['why']} |"
        for width in fields(WIDTHS)
    ]
    assert re.findall(r"^\| `.*$", text.partition("\n## ")[2], re.M) == widths


# -------------------- the figures of the real recording --------------------


def in_brackets(values: Array, u: Array, digits: int) -> str:
    """Values with their uncertainties in units of the last digit."""
    return ", ".join(f"{v:.{digits}f}({w * 10**digits:.0f})" for v, w in zip(values, u, strict=True))


def signed(value: float, digits: int) -> str:
    """A number with its sign, a real minus."""
    return f"{value:+.{digits}f}".replace("-", "−")


def figures_of_the_recording(folder: Path) -> list[str]:
    """What docs/evidence/xsens.md says in its text and tables, from two calibrations of the recording in `folder`."""
    session = read_session(folder)
    normal = calibrate(session)
    exact = calibrate(replace(session, site=replace(session.site, gravity=9.81744, gravity_u=0.0)))
    assert exact.accel is not None
    assert exact.gyro is not None
    observations = inspect_session(session).observations
    assert observations is not None
    rests = observations.rests
    force = exact.accel.apply(rests.accel)
    up = force / np.linalg.norm(force, axis=1, keepdims=True)
    residual = np.array([rest.residual for rest in normal.evidence.rests])
    coloured = np.sqrt(np.einsum("ip,ipq,iq->i", up, rests.accel_covariance, up))
    chunks = list(open_log(session).chunks())
    time, readings = (np.concatenate([getattr(chunk, name) for chunk in chunks]) for name in ("time", "accel"))
    white = []
    for u, start, stop in zip(up, rests.start, rests.stop, strict=True):
        along = readings[(time > start) & (time <= stop)] @ u
        white.append(along.std() / np.sqrt(len(along)))
    fit, gyro_fit = normal.evidence.fits["accelerometers"], normal.evidence.fits["gyro rests"]
    sizes = {"accel": 415.0 * np.ones(3), "gyro": 4770.0 * np.ones(3)}
    scale = {kind: np.array([exact[f"{kind}.scale.{axis}"].value for axis in "xyz"]) for kind in sizes}
    scale_u = {kind: np.array([exact[f"{kind}.scale.{axis}"].u for axis in "xyz"], dtype=float) for kind in sizes}
    length = {kind: sizes[kind] * (1.0 + scale[kind]) for kind in sizes}
    _, frame = rq(exact.accel.matrix)
    accel, gyro = (
        sizes[kind] * np.abs(1.0 / np.diag(np.linalg.inv(model.matrix @ frame.T)))
        for kind, model in (("accel", exact.accel), ("gyro", exact.gyro))
    )
    rows = []
    for axis in "xyz":
        a, b = normal[f"accel.scale.{axis}"], exact[f"accel.scale.{axis}"]
        assert a.u is not None
        assert b.u is not None
        rows.append(
            f"| `accel.scale.{axis}` | {signed(1e6 * a.value, 0)}({1e6 * a.u:.0f}) ppm "
            f"| {signed(1e6 * b.value, 0)}({1e6 * b.u:.0f}) ppm | {signed(1e6 * (b.value - a.value), 0)} ppm |"
        )
    return [
        f"miss g by {1e3 * np.sqrt(np.mean(residual**2)):.2f} mm/s² (rms)",
        f"would be known to {1e3 * np.median(white):.2f} mm/s² (median)",
        f"chi-square would be {np.sum((residual / white) ** 2) / fit.degrees:.0f} per degree",
        f"finds {1e3 * np.median(coloured):.2f} mm/s² for the mean of a rest",
        f"a scatter between rests of {1e3 * fit.scatter:.2f} mm/s² is estimated",
        f"scatter by {gyro_fit.scatter / DEGREE_PER_HOUR:.0f} °/h",
        *rows,
        f"| tumble, 1 + k | {in_brackets(length['accel'], sizes['accel'] * scale_u['accel'], 3)} "
        f"| {in_brackets(length['gyro'], sizes['gyro'] * scale_u['gyro'], 1)} |",
        f"| tumble, in imu_tk's convention | {', '.join(f'{v:.3f}' for v in accel)} "
        f"| {', '.join(f'{v:.1f}' for v in gyro)} |",
        f"| less the independent fit | {', '.join(signed(v, 3) for v in accel - [414.421, 412.031, 414.621])} |",
        f"| less imu_tk | {', '.join(signed(v, 2) for v in accel - [414.46, 412.01, 414.65])} "
        f"| {', '.join(signed(v, 1) for v in gyro - [4778.0, 4764.2, 4773.7])} |",
    ]


def test_the_figures_of_the_real_recording_are_those_of_the_program(data: Path) -> None:
    text = " ".join((ROOT / "docs/evidence/xsens.md").read_text(encoding="utf-8").split())
    for figure in figures_of_the_recording(data / "xsens-mti"):
        words = f"({NUMBER.pattern})".join(map(re.escape, NUMBER.split(figure)))
        found = re.search(words, text)
        assert found is not None, figure
        assert all(map(same_number, found.groups(), NUMBER.findall(figure))), f"{figure}, the page has {found[0]}"


# -------------------- today's outputs --------------------


def renewed(expected: str, found: str) -> str:
    """An output of today, shortened as the expected one was: as many lines before the first `...` and after the last,
    and between two of them from the line that begins with the same word."""
    old, new = lines_of(expected), lines_of(found)
    if "..." not in old:
        return "".join(line + "\n" for line in new)
    segments: list[list[str]] = [[]]
    for line in old:
        segments.append([]) if line == "..." else segments[-1].append(line)
    out = new[: len(segments[0])]
    for middle in segments[1:-1]:
        first = next(i for i, line in enumerate(new) if line.split()[:1] == middle[0].split()[:1])
        out += ["...", *new[first : first + len(middle)]]
    out += ["...", *new[len(new) - len(segments[-1]) :]]
    return "".join(line + "\n" for line in out)


def renew(path: Path, folder: Path) -> None:
    """Put the outputs of today into a page."""
    reader, text, at, out = Reader(folder=folder), path.read_text(encoding="utf-8"), 0, []
    for block in BLOCK.finditer(text):
        if block["file"]:
            (folder / block["file"]).parent.mkdir(parents=True, exist_ok=True)
            (folder / block["file"]).write_text(block["text"], encoding="utf-8")
        elif block["language"] == "console":
            out.append(text[at : block.start("text")])
            for command, expected in outputs_of(block["text"]):
                out.append(f"$ {command}\n{renewed(expected, reader.run(command))}")
            at = block.end("text")
        elif block["language"] == "python" and ">>>" in block["text"]:
            sys.stdout.write(reader.doctest(block["text"], path.name))
    path.write_text("".join(out) + text[at:], encoding="utf-8")


if __name__ == "__main__":
    for name in sys.argv[1:] or RUN:
        with tempfile.TemporaryDirectory() as temporary:
            if name in RECORDINGS:
                shared = Path(os.environ.get("TUMBLE_DATA") or ROOT.parent / "shared" / "data")
                shutil.copytree(shared / RECORDINGS[name], Path(temporary) / RECORDINGS[name])
            renew(ROOT / name, Path(temporary))
