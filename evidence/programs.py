"""All programs of the benchmark: tumble's methods and the peers."""

from __future__ import annotations

from evidence import peers, tumble_methods
from evidence.case import Program

PROGRAMS: tuple[Program, ...] = (*tumble_methods.PROGRAMS, *peers.PROGRAMS)


def named(name: str) -> Program:
    """The program of a name."""
    return next(program for program in PROGRAMS if program.name == name)
