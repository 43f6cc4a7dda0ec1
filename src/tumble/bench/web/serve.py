"""Runs the server of a bench until the process is ended."""

from __future__ import annotations

import socket
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from tumble.bench.station import Station
from tumble.bench.web.access import Access, lasting_token
from tumble.errors import InputError, needs_extra
from tumble.files import nothing_left
from tumble.recording.live.sources import LOOPBACK
from tumble.recording.session_file import SESSION_FILE

_ANY = ("0.0.0.0", "::")


def serve(
    station_of: Callable[[], Station],
    *,
    folder: Path,
    host: str = LOOPBACK,
    port: int = 8422,
    say: Callable[[str], None],
) -> None:
    """Serve the page of a station until the process is interrupted.

    `station_of` opens the station once the address is bound; if that fails, a new `folder` is removed. The link is
    passed to `say`."""
    with needs_extra("the bench page", "bench", "uvicorn", "starlette"):
        import uvicorn

        from tumble.bench.web.connections import ACCEPTED_AT_ONCE, WAITING, Connection
        from tumble.bench.web.server import app_of
    with _listening(host, port) as bound, ExitStack() as running:
        with ExitStack() as new:
            if not folder.exists():
                created = new.enter_context(nothing_left(folder))
                created.written += [folder / name for name in (SESSION_FILE, "log.csv")]
            station = station_of()
            try:
                station.start()
            except BaseException:  # before the new folder is removed
                station.stop()
                raise
        running.callback(station.stop)
        port = bound.getsockname()[1]
        access = Access(host=host, port=port, token=lasting_token())
        app = app_of(station, access)

        class Server(uvicorn.Server):
            """Ends the event streams at shutdown, and allows WAITING connections."""

            async def startup(self, sockets: list[socket.socket] | None = None) -> None:
                await super().startup(sockets)
                bound.listen(WAITING)

            async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
                app.state.stopping = True
                await super().shutdown(sockets)

        config = uvicorn.Config(
            app,
            http=Connection,
            ws="none",
            lifespan="off",
            backlog=ACCEPTED_AT_ONCE,
            log_config=None,
            log_level="error",  # invalid requests of strangers are not logged
            access_log=False,  # requests may contain the token
            timeout_graceful_shutdown=3,
        )
        link = f"http://{_reachable(host)}:{port}/?token={access.token}"
        say(f"the page: {link}")
        if not access.loopback:
            say(_qr(link))
        Server(config).run(sockets=[bound])


@contextmanager
def _listening(host: str, port: int) -> Iterator[socket.socket]:
    with ExitStack() as opened:
        try:
            family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][0]
            bound = opened.enter_context(socket.socket(family, socket.SOCK_STREAM))
            bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            bound.bind((host, port))
            bound.listen()
        except OSError as error:
            raise InputError(f"--host {host} --port {port}: expected a free address, found: {error.strerror}") from None
        yield bound


def _reachable(host: str) -> str:
    """Return the address of this machine for a link; if all are listened to, that towards the network."""
    if host not in _ANY:
        return f"[{host}]" if ":" in host else host
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))  # sends nothing, only finds the route
        except OSError:
            return LOOPBACK
        return str(probe.getsockname()[0])


def _qr(link: str) -> str:
    """Return a link as a QR code in characters."""
    with needs_extra("a QR code", "bench", "qrcode"):
        import qrcode
    import io

    code, out = qrcode.QRCode(border=1), io.StringIO()
    code.add_data(link)
    code.print_ascii(out=out, invert=True)
    return out.getvalue()
