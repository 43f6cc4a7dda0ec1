"""Access to the page: the token, the host names of the server, and the content that a page may load.

On the loopback interface anyone on the machine may view the page. Commands, and any access over the network, need the
token: it is in the printed link, and then in a cookie that no script and no other site can read. It stays the same when
the server is restarted, so that open pages continue.
"""

from __future__ import annotations

import hmac
import ipaddress
import logging
import os
import secrets
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urlsplit

TOKEN_VARIABLE = "TUMBLE_BENCH_TOKEN"
_MIN_LENGTH = 16  # of a token, characters
_OTHERS_MODE = 0 if os.name == "nt" else 0o077  # access bits for users other than the owner of a file

HEADERS: Mapping[str, str] = {
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; "
        "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cache-Control": "no-store",
}


def lasting_token() -> str:
    """Return the token of this user: from the environment, or from a file that only the user can read.

    The file is created if it is missing or readable by others, who may know the token."""
    given = os.environ.get(TOKEN_VARIABLE, "")
    if len(given) >= _MIN_LENGTH:
        return given
    state = Path(os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state") / "tumble"
    path = state / "bench-token"
    try:
        stored = path.read_text(encoding="ascii").strip()
        if len(stored) >= _MIN_LENGTH and not path.stat().st_mode & _OTHERS_MODE:
            return stored
    except (OSError, UnicodeDecodeError):
        pass
    token = secrets.token_urlsafe(24)
    try:
        state.mkdir(parents=True, exist_ok=True)
        path.unlink(missing_ok=True)
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        with os.fdopen(descriptor, "w", encoding="ascii") as file:
            file.write(token)
    except OSError as error:
        logging.getLogger(__name__).warning("the token cannot be kept (%s): open pages anew", error.strerror)
    return token


@dataclass(frozen=True, kw_only=True, slots=True)
class Access:
    """Decides on requests to a server at `host`:`port`."""

    host: str
    port: int
    token: str

    @property
    def loopback(self) -> bool:
        """Whether the server is reachable from this machine only."""
        address = _address(self.host)
        return address is not None and address.is_loopback

    @property
    def cookie(self) -> str:
        """Name of the cookie; servers on other ports have their own."""
        return f"tumble_bench_{self.port}"

    def is_token(self, token: str | None) -> bool:
        """Return True for the token, in a time that does not depend on it."""
        return hmac.compare_digest((token or "").encode("utf-8", "replace"), self.token.encode())

    def answers_to(self, host: str | None) -> bool:
        """Return True if a Host header names this server: by an address, localhost, or its configured name.

        Names of other sites that lead here are refused. Over the network the port may be that of a proxy."""
        try:
            parts = urlsplit(f"//{host or ''}")
            name, port = parts.hostname, 80 if parts.port is None else parts.port
        except ValueError:
            return False
        if name is None or (self.loopback and port != self.port):
            return False
        address = _address(name)
        return name == self.host or (address is not None and (address.is_loopback or not self.loopback))

    def same_origin(self, origin: str | None, host: str | None) -> bool:
        """Return True if a page of this server sends the request, directly or through an encrypting proxy."""
        return origin is not None and origin in (f"http://{host}", f"https://{host}")


def _address(name: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
    """Return the address in a name, None for other names; localhost is 127.0.0.1."""
    try:
        return ipaddress.ip_address("127.0.0.1" if name == "localhost" else name)
    except ValueError:
        return None
