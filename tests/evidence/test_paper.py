"""The manuscript: its form, its citations, its figures.

That figures are those of the results is asked of it like of all pages (`test_pages.py`).
"""

from __future__ import annotations

import re

import yaml

from tests.support import ROOT

PAPER = ROOT / "paper" / "paper.md"
TEXT = PAPER.read_text(encoding="utf-8")
BIBLIOGRAPHY = (PAPER.parent / "paper.bib").read_text(encoding="utf-8")


def test_the_head_has_what_the_journal_asks_for() -> None:
    head = yaml.safe_load(TEXT.split("---")[1])
    assert {"title", "tags", "authors", "affiliations", "date", "bibliography"} <= set(head)
    assert head["bibliography"] == "paper.bib"
    known = {str(one["index"]) for one in head["affiliations"]}
    assert all(str(author["affiliation"]) in known for author in head["authors"])


def test_it_has_the_length_and_the_sections_that_the_journal_asks_for() -> None:
    body = re.sub(r"<!--.*?-->", "", TEXT.split("---", 2)[2], flags=re.S)
    assert 750 <= len(body.split()) <= 1750
    for section in ("Summary", "Statement of need", "Evidence", "Limits", "References"):
        assert f"\n# {section}\n" in TEXT


def test_all_that_is_cited_is_in_the_bibliography_and_the_reverse() -> None:
    cited = set(re.findall(r"@(\w+)", TEXT.split("---", 2)[2]))
    entries = set(re.findall(r"^@\w+\{(\w+),", BIBLIOGRAPHY, re.M))
    assert cited == entries


def test_every_entry_has_its_author_title_and_year() -> None:
    for entry in re.split(r"^@", BIBLIOGRAPHY, flags=re.M)[1:]:
        assert {"author", "title", "year"} <= set(re.findall(r"(\w+) = \{", entry)), entry[:40]
