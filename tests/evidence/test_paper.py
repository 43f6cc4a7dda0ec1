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
    sections = dict(re.findall(r"^# (.+)\n((?:(?!^# ).*\n?)*)", body, re.M))
    assert {"Summary", "Statement of need", "Evidence", "Limits", "Software design", "References"} <= set(sections)
    assert 100 <= len(sections["Summary"].split()) <= 250
    assert not re.findall(r"^#{2,}", body, re.M)


def test_every_picture_is_there() -> None:
    for path in re.findall(r"!\[[^\]]*\]\(([^)]+)\)", TEXT):
        assert (PAPER.parent / path).exists(), path


def test_every_number_of_the_evidence_is_of_a_result_or_counts_what_a_test_counts() -> None:
    """Digits in the section that are put there by no result file: only those of names and published digits, which
    tests/evidence/test_peers.py compares."""
    evidence = TEXT.split("\n# Evidence\n")[1].split("\n# ")[0]
    by_hand = re.sub(r"<!-- figure: .*?<!-- end -->|\[@\w+\]|!\[[^\]]*\]\([^)]*\)", "", evidence, flags=re.S)
    assert set(re.findall(r"\d[\d.]*", by_hand)) <= {"0.035", "0.02", "1", "4", "95"}


def test_all_that_is_cited_is_in_the_bibliography_and_the_reverse() -> None:
    cited = set(re.findall(r"@(\w+)", TEXT.split("---", 2)[2]))
    entries = set(re.findall(r"^@\w+\{(\w+),", BIBLIOGRAPHY, re.M))
    assert cited == entries


def test_every_entry_has_its_author_title_and_year() -> None:
    for entry in re.split(r"^@", BIBLIOGRAPHY, flags=re.M)[1:]:
        assert {"author", "title", "year"} <= set(re.findall(r"(\w+) = \{", entry)), entry[:40]
