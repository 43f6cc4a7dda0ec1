"""What is said of an estimate: a sentence, what it concerns, and what follows."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from tumble.inference.estimate import Outcome
from tumble.sensors.parameters import sensor_kind


@dataclass(frozen=True, kw_only=True, slots=True)
class Finding:
    """A finding about an estimate, of which an outcome is made.

    Attributes
    ----------
    sentence : str
        What is there, with cause and remedy.
    concerns : tuple of str
        The kinds of sensors ("gyro") or groups of parameters ("gyro.bias") that it concerns, all where none is named.
    refuses : bool
        Whether what it concerns cannot be used; else it is a remark.
    causes : tuple of str
        Names of the causes that it gives, the most likely first.
    """

    sentence: str
    concerns: tuple[str, ...] = ()
    refuses: bool = False
    causes: tuple[str, ...] = ()

    @property
    def kinds(self) -> tuple[str, ...]:
        """The kind of sensors that it concerns; none where it concerns both."""
        kinds = {sensor_kind(part) for part in self.concerns}
        return tuple(kinds) if len(kinds) == 1 else ()


def remark(sentence: str, *concerns: str) -> Finding:
    """A finding that is said beside a result."""
    return Finding(sentence=sentence, concerns=concerns)


def refusal(sentence: str, *concerns: str) -> Finding:
    """A finding by which what it concerns cannot be used."""
    return Finding(sentence=sentence, concerns=concerns, refuses=True)


def outcome_of(findings: Iterable[Finding], unobservable: tuple[str, ...] = ()) -> Outcome:
    """The outcome of findings, in their order, and of parameters that the data do not determine."""
    every = tuple(findings)
    return Outcome(
        reasons=tuple(each.sentence for each in every if each.refuses),
        remarks=tuple(each.sentence for each in every if not each.refuses),
        unobservable=unobservable,
        concerns={each.sentence: each.concerns for each in every if each.concerns},
    )


def causes_of(findings: Iterable[Finding]) -> tuple[str, ...]:
    """The names of the causes that findings give, each once."""
    return tuple(dict.fromkeys(cause for each in findings for cause in each.causes))
