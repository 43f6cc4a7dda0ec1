"""One estimate of a made-up recording, so that nothing is left to be compiled when the operator waits for the first: on
a machine where tumble has never run that takes half a minute."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from tumble.bench.chain import Chain
from tumble.bench.folder import begin, session_to_record
from tumble.bench.follow import SoundSamples
from tumble.bench.sources import in_si
from tumble.bench.virtual_table import SAMPLE_RATE, VirtualTable
from tumble.units import Array

_REST = round(5.0 * SAMPLE_RATE)
_POSITIONS = 4


def warm_up() -> None:
    """Have the loops of the chain compiled."""
    with tempfile.TemporaryDirectory() as made:
        begin(Path(made) / "none", log=in_si(), serial="none", site={"latitude_deg": 56.84}, programme=None)
        session = session_to_record(Path(made) / "none")
    rows = _recorded()
    chain = Chain(session, 1.0 / SAMPLE_RATE, "mems")
    every = np.full(len(rows), 1.0 / SAMPLE_RATE)
    chain.feed(SoundSamples(time=rows[:, 0], dt=every, values=rows[:, 1:], lost=np.zeros(len(rows))))
    reduction = chain.now()
    found = chain.rests(reduction, ())
    if found is not None and found.rests:
        chain.known(reduction, found.rests[0].first, found.rests[0].last)
        chain.estimate(reduction, found.rests, ())


def _recorded() -> Array:
    """Rows of a unit in a few positions of the virtual table."""
    table, lines = VirtualTable("nine"), []
    for position in range(_POSITIONS):
        table.go_to(position)
        while table.moving:
            lines.append(table.line())
        lines += [table.line() for _ in range(_REST)]
    return np.array([line.split(",") for line in lines], dtype=float)
