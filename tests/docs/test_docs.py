"""The documentation says what is true: commands run, outputs are those of the program, links lead somewhere.

A page of `RUN` is executed from top to bottom in an empty folder: files (a block after `<!-- file: NAME -->`) are
written, the commands of ```console blocks run and their output compared, ```python blocks with >>> run as doctests.
A line `...` in an output stands for lines that are left out. Numbers may differ by LAST_DIGIT in the last one shown.

    python -m tests.docs.test_docs        puts the outputs of today into the pages, to be read before they are committed

The site itself (`make docs`) is checked by Sphinx with warnings as errors and by docs/site_tools.py.
"""

from __future__ import annotations

import contextlib
import doctest
import hashlib
import re
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from docs.made import walk
from tests.support import ROOT
from tumble.cli import main

RUN = (
    "README.md",
    "docs/tutorial/first-calibration.md",
    "docs/tutorial/rough-table.md",
    "docs/howto/recordings.md",
    "docs/howto/cube.md",
    "docs/howto/ellipsoid.md",
    "docs/howto/plan.md",
    "docs/howto/thermal.md",
    "docs/howto/check.md",
    "docs/howto/reports.md",
    "docs/howto/registry.md",
    "docs/reference/conventions.md",
    "docs/reference/api.md",
)
MOST_PAGES, MOST_WORDS, MOST_ENTRIES = 40, 45_000, 25
"""What the documentation may have: pages, words in them, and entries of the side list that are not folded."""

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


@pytest.mark.parametrize("page", [ROOT / name for name in RUN], ids=RUN)
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


# -------------------- commands, links, size, licence --------------------


@pytest.mark.parametrize(("words", "command"), [pytest.param(w, c, id="-".join(w)) for w, c in walk(main)])
def test_every_command_says_what_it_does_and_what_each_option_means(
    words: tuple[str, ...], command: click.Command
) -> None:
    """The page of commands is made of these texts."""
    assert command.help, words
    silent = [p.opts[0] for p in command.params if isinstance(p, click.Option) and not (p.hidden or p.help)]
    assert silent == []


def pages() -> list[Path]:
    """Every page of the documentation."""
    return sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md")])


@pytest.mark.parametrize("path", [*ROOT.glob("*.md"), *ROOT.glob("*/*.md")], ids=lambda path: path.name)
def test_links_of_pages_outside_the_site_lead_to_files(path: Path) -> None:
    """Sphinx checks those of the site, with their anchors."""
    text = BLOCK.sub("", path.read_text(encoding="utf-8"))
    links = [link.partition("#")[0] for link in LINK.findall(text) if not re.match(r"[a-z]+:|#", link)]
    assert [link for link in links if not (path.parent / link).exists()] == []


def test_the_documentation_is_no_larger_than_it_may_be() -> None:
    texts = [path.read_text(encoding="utf-8") for path in ROOT.glob("docs/**/*.md")]
    assert len(texts) <= MOST_PAGES
    assert sum(len(text.split()) for text in texts) <= MOST_WORDS
    index = (ROOT / "docs/index.md").read_text(encoding="utf-8")
    assert len(re.findall(r"^(?:\w+/)?[\w-]+$", index, re.M)) <= MOST_ENTRIES


def test_the_licence_is_the_unmodified_text_of_apache_2_0() -> None:
    digest = hashlib.sha256((ROOT / "LICENSE").read_bytes()).hexdigest()
    assert digest == "c71d239df91726fc519c6eb72d318ec65820627232b2f796219e87dcf35d0ab4"


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
            renew(ROOT / name, Path(temporary))
