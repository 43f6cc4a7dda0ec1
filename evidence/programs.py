"""All programs of the benchmark: tumble's methods and the peers."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

from evidence import peers, tumble_methods
from evidence.case import Program

PROGRAMS: tuple[Program, ...] = (*tumble_methods.PROGRAMS, *peers.PROGRAMS)
FURTHER: tuple[Program, ...] = (tumble_methods.PROGRAMS[0], *peers.FURTHER)
"""Those of recordings of other kinds."""
LINEAR = replace(
    tumble_methods.PROGRAMS[0],
    name="tumble joint, linear",
    estimate=partial(tumble_methods.estimate, method="joint", terms="linear"),
)
"""The default method with the unknowns of the peers, beside it on real recordings."""


def named(name: str) -> Program:
    """The program of a name."""
    return next(program for program in (*PROGRAMS, *FURTHER, LINEAR) if program.name == name)
