"""A hook of mkdocs: the pages that stand outside docs/ (README, changelog) become pages of the site, and files that
pages link to (studies, benchmarks) go with it."""

from __future__ import annotations

import re
from html import unescape
from pathlib import Path
from posixpath import dirname, join, normpath, relpath
from typing import Any

from latex2mathml.converter import convert
from mkdocs.structure.files import File, Files

ROOT = Path(__file__).parents[1]
RENAMED = {"README.md": "start.md"}  # a README would be taken for the index
FORMULA = re.compile(r'<(span|div) class="arithmatex">\\([(\[])(.*?)\\[)\]]</\1>', re.S)
LINK = re.compile(r"(\]\()([^)#\s:]+)(?=[)#])")


def on_files(files: Files, config: Any) -> Files:
    """Add what is linked to from inside and lies outside of docs/."""
    waiting = [file.src_uri for file in files.documentation_pages()]
    while waiting:
        page = waiting.pop()
        source = _source(page)
        for target in LINK.findall(source.read_text(encoding="utf-8")):
            uri = _site_uri(target[1], source)
            if files.get_file_from_path(uri) is None and _source(uri).is_file():
                files.append(File.generated(config, uri, abs_src_path=str(_source(uri))))
                waiting += [uri] if uri.endswith(".md") else []
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Links as they are from the page's place in the site."""
    source = Path(page.file.abs_src_path)
    here = page.file.src_uri

    def moved(match: re.Match[str]) -> str:
        return match[1] + relpath(_site_uri(match[2], source), dirname(here) or ".")

    return LINK.sub(moved, markdown)


def on_page_content(html: str, **_: Any) -> str:
    """Formulas as MathML, which browsers show without a script."""

    def formula(match: re.Match[str]) -> str:
        display = "block" if match[2] == "[" else "inline"
        text, tagged, number = unescape(match[3]).partition(r"\tag{")
        shown = convert(text.strip(), display=display)
        return f'<div class="formula">{shown}<span>({number.rstrip("} ")})</span></div>' if tagged else shown

    return FORMULA.sub(formula, html)


def _site_uri(target: str, source: Path) -> str:
    """Where the target of a link stands in the site: docs/x.md as x.md, everything else by its place in the project."""
    folder = dirname(source.relative_to(ROOT).as_posix())
    uri = normpath(join(folder, target)).removeprefix("docs/")
    return RENAMED.get(uri, uri)


def _source(uri: str) -> Path:
    """The file behind a page of the site."""
    inside = ROOT / "docs" / uri
    original = {new: old for old, new in RENAMED.items()}.get(uri, uri)
    return inside if inside.is_file() else ROOT / original
