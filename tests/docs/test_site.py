"""The site of the documentation builds without network, loads nothing from elsewhere, and shows all public names."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

import tumble
from tests.support import ROOT

LOADED = re.compile(r"""<(?:script|img|iframe|link)\b[^>]*?(?:src|href)=["']?(https?:)?//""")


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site, built with every warning an error (a link that leads nowhere, a name that is not there) and with
    proxies that lead nowhere."""
    folder = tmp_path_factory.mktemp("site")
    nowhere = dict.fromkeys(("http_proxy", "https_proxy", "HTTP_PROXY", "HTTPS_PROXY"), "http://127.0.0.1:9")
    built = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--quiet", "--strict", "--site-dir", str(folder)],
        cwd=ROOT,
        env={**os.environ, **nowhere, "NO_MKDOCS_2_WARNING": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert built.returncode == 0, built.stderr
    return folder


def test_every_page_of_the_documentation_is_in_the_site(site: Path) -> None:
    pages = {p.relative_to(ROOT / "docs").with_suffix(".html").as_posix() for p in (ROOT / "docs").rglob("*.md")}
    built = {p.relative_to(site).as_posix() for p in site.rglob("*.html")}
    assert pages <= built
    assert {"start.html", "CHANGELOG.html"} <= built


def test_every_page_is_in_the_navigation(site: Path) -> None:
    shown = (site / "index.html").read_text(encoding="utf-8")
    for page in (ROOT / "docs").rglob("*.md"):
        assert f'href="{page.relative_to(ROOT / "docs").with_suffix(".html").as_posix()}"' in shown


def test_the_site_loads_nothing_from_elsewhere(site: Path) -> None:
    for page in site.rglob("*.html"):
        assert LOADED.search(page.read_text(encoding="utf-8")) is None, page.name


def test_every_public_name_is_described(site: Path) -> None:
    shown = (site / "reference/api.html").read_text(encoding="utf-8")
    for name in set(tumble.__all__) - {"__version__"}:
        assert re.search(rf'id="tumble\.[\w.]+\.{name}"', shown), name


def test_the_page_of_the_library_lists_the_public_names_where_they_are() -> None:
    page = (ROOT / "docs/reference/api.md").read_text(encoding="utf-8")
    listed = re.findall(r"^::: ([\w.]+)$", page, flags=re.MULTILINE)
    for path in listed:
        module, _, name = path.rpartition(".")
        assert getattr(tumble, name) is getattr(import_module(module), name)
    assert sorted(path.rpartition(".")[2] for path in listed) == sorted(set(tumble.__all__) - {"__version__"})
