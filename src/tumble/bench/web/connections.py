"""Connections to the server, limited in number and idle time.

A connection without a complete request is closed after ten seconds, however slowly its bytes arrive; with too many
connections the one that is idle for longest is closed. So neither open sockets nor slow senders block the page.
"""

from __future__ import annotations

import asyncio
import sys

from uvicorn.protocols.http.h11_impl import H11Protocol

REQUEST_SECONDS = 10.0  # until the head of a request is complete
MAX_CONNECTIONS = 256  # forty pages with six connections each
ACCEPTED_AT_ONCE = 4  # before surplus connections are closed
WAITING = 128  # connections that wait to be accepted


def max_connections() -> int:
    """Return the largest number of connections, a quarter of the limit of open files: recordings need files too."""
    if sys.platform == "win32":
        return MAX_CONNECTIONS
    import resource

    allowed = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
    return MAX_CONNECTIONS if allowed == resource.RLIM_INFINITY else min(MAX_CONNECTIONS, max(4, allowed // 4))


class Connection(H11Protocol):
    """A connection that is closed when it is idle for too long, or in favour of another."""

    idle_since = 0.0  # time of the loop, s

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]  # as uvicorn has it
        super().connection_made(transport)
        self._wait()
        ours = [each for each in self.connections if isinstance(each, Connection)]
        lasting = [each for each in ours if not each.transport.is_closing()]
        if len(lasting) > max_connections():
            min((each for each in lasting if each.idle), key=lambda each: each.idle_since).transport.abort()

    def on_response_complete(self) -> None:
        super().on_response_complete()
        self._wait()

    @property
    def idle(self) -> bool:
        """Whether all requests are answered."""
        return self.cycle is None or self.cycle.response_complete

    def _wait(self) -> None:
        self.idle_since = self.loop.time()
        self.loop.call_later(REQUEST_SECONDS, self._end_if_idle, self.idle_since)

    def _end_if_idle(self, since: float) -> None:
        if self.idle and self.idle_since == since:
            self.transport.abort()
