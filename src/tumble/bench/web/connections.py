"""Connections to the server: as many as the process has room for, and none that only waits.

A connection without a request is ended after ten seconds, however slowly its bytes come; where there are too many, the
one that has been without for longest is, for a new one. So neither sockets that stay open nor slow senders keep a page
from being served.
"""

from __future__ import annotations

import asyncio
import sys

from uvicorn.protocols.http.h11_impl import H11Protocol

REQUEST_SECONDS = 10.0
"""How long a connection may be without a whole head of a request."""
MOST = 256
"""Connections at once: forty pages with six connections each, and some."""
ACCEPTED_AT_ONCE = 4
"""Connections that are accepted before those that are too many are ended."""
WAITING = 128
"""Connections that wait to be accepted."""


def most_connections() -> int:
    """How many connections at once leave files for the recordings: a quarter of what the process may open."""
    if sys.platform == "win32":
        return MOST
    import resource

    allowed = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
    return MOST if allowed == resource.RLIM_INFINITY else min(MOST, max(4, allowed // 4))


class Connection(H11Protocol):
    """A connection that is ended when it is idle for too long, or for another one."""

    idle_since = 0.0
    """By the clock of the loop, s."""

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]  # as uvicorn has it
        super().connection_made(transport)
        self._wait()
        ours = [each for each in self.connections if isinstance(each, Connection)]
        lasting = [each for each in ours if not each.transport.is_closing()]
        if len(lasting) > most_connections():
            min((each for each in lasting if each.idle), key=lambda each: each.idle_since).transport.abort()

    def on_response_complete(self) -> None:
        super().on_response_complete()
        self._wait()

    @property
    def idle(self) -> bool:
        """Whether there is no request that is not answered."""
        return self.cycle is None or self.cycle.response_complete

    def _wait(self) -> None:
        self.idle_since = self.loop.time()
        self.loop.call_later(REQUEST_SECONDS, self._end_if_idle, self.idle_since)

    def _end_if_idle(self, since: float) -> None:
        if self.idle and self.idle_since == since:
            self.transport.abort()
