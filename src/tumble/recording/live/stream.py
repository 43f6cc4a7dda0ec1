"""The samples of a live source: rows in the order of their times become SI arrays, without a file on disk."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing, suppress
from itertools import pairwise

import numpy as np

from tumble.recording.live.lines import Lines
from tumble.recording.live.samples import SI_LOG, StreamedSamples
from tumble.recording.live.sources import Ended, LineSource
from tumble.recording.log import Chunk
from tumble.recording.session import Session, Site
from tumble.recording.session_file import session_of
from tumble.units import DEGREE

READ_SECONDS = 0.2
CLOCK_BACK = 1.0
"""Time (s) by which a stamp is before the last one at least if the clock has started anew."""
TEMPERATURE = "temperature"
"""Name of the column with the temperature, °C, of a source in SI."""


class SampleStream:
    """Samples of a live source.

    Parameters
    ----------
    source
        Where the lines come from.
    session
        Describes columns and sensors. None for a source that sends t, ax, ay, az, gx, gy, gz in s, m/s² and rad/s, and
        a temperature in °C if its first line names such a column.
    serial, site, gyros
        Device, place, and whether gyros are read, of a source without a session.
    """

    def __init__(
        self,
        source: LineSource,
        session: Session | None,
        *,
        serial: str = "",
        site: Site | None = None,
        gyros: bool = True,
    ) -> None:
        self._source, self._before = source, b""
        if session is None:
            with suppress(Ended):
                while b"\n" not in self._before:
                    self._before += source.read(READ_SECONDS)
            session = _in_si(self._before.partition(b"\n")[0], serial, site, gyros=gyros)
        self.session, spec = session, session.log
        self._lines = Lines(columns=spec.columns, clock=spec.time, refuse=lambda _: None)
        self._samples = StreamedSamples(spec)

    @property
    def interval(self) -> float | None:
        """Time from sample to sample, s; None while too few have come."""
        return self._samples.interval

    def chunks(self) -> Iterator[Chunk]:
        """The samples as they come, until the source ends. A clock that goes back begins another file."""
        spec, file, last, ended = self.session.log, 0, -np.inf, False
        with closing(self._source):
            while not ended:
                try:
                    data, self._before = self._before or self._source.read(READ_SECONDS), b""
                except Ended:
                    data, ended = b"\n", True
                rows = self._lines.numbers(self._lines.cut(data))
                back = np.zeros(0, dtype=int)
                if spec.time is not None and len(rows):
                    time = rows[:, spec.columns.index(spec.time)] * spec.time_factor
                    back = np.flatnonzero(np.diff(time, prepend=last) < -CLOCK_BACK)
                    last = float(time[-1])
                for begin, end in pairwise([0, *back.tolist(), len(rows)]):
                    if begin in back:
                        file += 1
                        self._samples = StreamedSamples(spec, interval=self._samples.interval, file=file)
                    chunk = self._samples.feed(rows[begin:end]) if end > begin else None
                    if chunk is not None:
                        yield chunk


def _in_si(first_line: bytes, serial: str, site: Site | None, *, gyros: bool) -> Session:
    """The session of a source in SI."""
    log = {key: value for key, value in SI_LOG.items() if key != "file" and (gyros or key != "gyro")}
    columns = [log["time"], *log["accel"]["columns"], *(log["gyro"]["columns"] if gyros else [])]
    if TEMPERATURE in [column.strip() for column in first_line.decode("utf-8", errors="replace").split(",")]:
        log[TEMPERATURE] = {"columns": [TEMPERATURE], "unit": "degC"}
        columns.append(TEMPERATURE)
    place = {}
    if site is not None:
        place = {"height_m": site.height, "gravity": site.gravity, "gravity_u": site.gravity_u}
        place |= {} if site.latitude is None else {"latitude_deg": site.latitude / DEGREE}
    described = {"format": 1, "device": {"serial": serial}, "site": place, "log": log}
    return session_of(described, {column: np.zeros(1) for column in columns})
