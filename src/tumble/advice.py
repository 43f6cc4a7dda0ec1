"""Sentences on a result with what to do about it.

Who calibrates reads a sentence whole; the reader of a certificate reads what was found alone.
"""

from __future__ import annotations


class Advised(str):
    """A sentence "found; remedy": what was found, and what to do about it."""

    found: str
    remedy: str

    def __new__(cls, found: str, remedy: str) -> Advised:
        sentence = super().__new__(cls, f"{found}; {remedy}")
        sentence.found, sentence.remedy = found, remedy
        return sentence

    def __reduce__(self) -> tuple[type[Advised], tuple[str, str]]:
        return Advised, (self.found, self.remedy)


def advised(found: str, *remedies: str) -> str:
    """Return a sentence with the remedies that are not empty; without any, what was found."""
    remedy = "; ".join(filter(None, remedies))
    return Advised(found, remedy) if remedy else found


def found_in(sentence: str) -> str:
    """Return what a sentence says was found."""
    return sentence.found if isinstance(sentence, Advised) else sentence


def remedy_of(sentence: str) -> str:
    """Return what to do about a sentence; empty if it does not say."""
    return sentence.remedy if isinstance(sentence, Advised) else ""


def prefixed(prefix: str, sentence: str) -> str:
    """Return a sentence after a prefix, such as the name of a session."""
    return advised(prefix + found_in(sentence), remedy_of(sentence))
