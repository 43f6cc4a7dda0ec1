"""What pages name exists: every command with its options and their choices, every name of the library."""

from __future__ import annotations

import contextlib
import re
import shlex
from collections.abc import Iterator
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import get_args

import click
import pytest

import tumble
from docs.made import walk
from tests.docs.test_docs import pages
from tests.support import ROOT
from tumble.cli import main
from tumble.commands.params import METHOD_NAMES
from tumble.plugins import Kind

PAGES = [page for page in pages() if page.stem != "CHANGELOG"]  # what was, is in the changelog
COMMANDS = {(): main, **dict(walk(main))}
FENCED = re.compile(r"^ *```(\w*)\n(.*?)^ *```$", re.M | re.S)
INLINE = re.compile(r"`([^`\n]+(?:\n[^`\n]+)?)`")
PLACEHOLDER = re.compile(r"[A-Z][A-Z_.|]*(?:\[.*)?|…|\.\.\.|<.*>")
MODULE = re.compile(r"\btumble(?:\.[a-z_]+)+(?:\.[A-Z]\w+)?")
GROUPS = {f"tumble.{kind}" for kind in get_args(Kind)}
"""Groups of entry points, which are no modules."""


SCRIPTS = [path for folder in ("studies", "evidence", "benchmarks") for path in sorted((ROOT / folder).rglob("*.py"))]
FOREIGN = {"--imu-models"} | {
    option for path in SCRIPTS for option in re.findall(r"[\"'](--[a-z-]+)[\"']", path.read_text(encoding="utf-8"))
}
"""Options of Kalibr, and those of studies and of the benchmark."""


def options(command: click.Command) -> dict[str, click.Option]:
    """The options of a command by their spellings."""
    return {
        spelling: parameter
        for parameter in command.params
        if isinstance(parameter, click.Option)
        for spelling in (*parameter.opts, *parameter.secondary_opts)
    }


HELP = {"-h", "--help"}
EVERYWHERE = {spelling for command in COMMANDS.values() for spelling in options(command)} | HELP


def called(text: str) -> Iterator[str]:
    """The calls of the program in a page, without what comes after a pipe or a comment."""
    for language, block in FENCED.findall(text):
        if language not in ("", "console", "sh"):
            continue
        for line in re.sub(r"\\\n", " ", block).splitlines():
            for part in re.split(r"\s\|\s|&&|;", line):
                if found := re.match(r"\s*(?:\$ )?(tumble(?: .*)?)$", part):
                    yield re.split(r"\s#|\s{3,}", found[1])[0]
    for inline in INLINE.findall(FENCED.sub("", text)):
        if inline.startswith("tumble ") and inline.split()[1] not in METHOD_NAMES:
            yield " ".join(inline.split())


def faults(call: str) -> Iterator[str]:
    """What a call names that the program does not have."""
    words = shlex.split(call)[1:]
    path: tuple[str, ...] = ()
    while words and (*path, words[0]) in COMMANDS:
        path = (*path, words.pop(0))
    command = COMMANDS[path]
    known = options(main) | options(command)
    named = words and not words[0].startswith("-") and not PLACEHOLDER.fullmatch(words[0])
    if isinstance(command, click.Group) and named:
        yield f"no command {words[0]}"
    for word, after in zip(words, [*words, ""][1:], strict=True):
        spelling, _, value = word.partition("=")
        if not re.match(r"--?[a-z]", spelling) or spelling in HELP:
            continue
        if spelling not in known:
            yield f"no option {spelling}"
        elif isinstance(choice := known[spelling].type, click.Choice):
            value = value or after
            if value and value not in choice.choices and not PLACEHOLDER.fullmatch(value):
                yield f"{spelling} has no {value}"


@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.stem)
def test_commands_and_options_of_a_page_exist(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    said = [f"{call}: {fault}" for call in called(text) for fault in faults(call)]
    assert said == []
    alone = set(re.findall(r"`(--[a-z][a-z-]*)", FENCED.sub("", text)))
    assert alone - EVERYWHERE - FOREIGN == set()


def test_commands_and_options_of_the_makefile_exist() -> None:
    calls = re.findall(r"^\t\$\(BIN\)/(tumble .*)$", (ROOT / "Makefile").read_text(encoding="utf-8"), re.M)
    assert len(calls) >= 4
    assert [f"{call}: {fault}" for call in calls for fault in faults(call)] == []


def exists(name: str) -> bool:
    """Whether a dotted name is a module of the library or something in one."""
    if hasattr(tumble, name.removeprefix("tumble.")):
        return True
    with contextlib.suppress(ModuleNotFoundError):
        if find_spec(name) is not None:
            return True
    owner, _, attribute = name.rpartition(".")
    with contextlib.suppress(ModuleNotFoundError):
        return hasattr(import_module(owner), attribute)
    module, _, item = owner.rpartition(".")
    return hasattr(getattr(import_module(module), item, None), attribute)


@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.stem)
def test_names_and_paths_on_a_page_exist(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert [name for name in sorted(set(MODULE.findall(text)) - GROUPS) if not exists(name)] == []
    paths = re.findall(r"`((?:studies|tests|docs|src|benchmarks|evidence)/[\w./-]*\w[\w./]*)`", text)
    assert [path for path in paths if not (ROOT / path).exists()] == []
