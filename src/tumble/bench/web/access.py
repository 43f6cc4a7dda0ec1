"""Who may see and who may command: the token, the names the server answers to, and what a page may load.

On the loopback anyone on the machine may look. Commands, and everything beyond the loopback, need the token: it comes
once in the link that is printed, and is then in a cookie that no script and no other site can read. It is the same
when the server is started again, so that a page goes on.
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
_LEAST = 16
_OF_OTHERS = 0 if os.name == "nt" else 0o077
"""Bits of the mode of a file that let others than its owner at it."""

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
    """The token of this user: that of the environment, else that of a file only the user can read, made if need be;
    made anew where others could read the file, who may then know it."""
    given = os.environ.get(TOKEN_VARIABLE, "")
    if len(given) >= _LEAST:
        return given
    state = Path(os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state") / "tumble"
    path = state / "bench-token"
    try:
        found = path.read_text(encoding="ascii").strip()
        if len(found) >= _LEAST and not path.stat().st_mode & _OF_OTHERS:
            return found
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
    """Decides about requests to a server at `host`:`port`."""

    host: str
    port: int
    token: str

    @property
    def loopback(self) -> bool:
        """Whether only this machine can reach the server."""
        address = _address(self.host)
        return address is not None and address.is_loopback

    @property
    def cookie(self) -> str:
        """Name of the cookie; servers on other ports of the machine have their own."""
        return f"tumble_bench_{self.port}"

    def knows(self, token: str | None) -> bool:
        """Whether this is the token, in a time that does not depend on it."""
        return hmac.compare_digest((token or "").encode("utf-8", "replace"), self.token.encode())

    def answers_to(self, host: str | None) -> bool:
        """Whether a Host header names this server: by an address, by localhost, or as it was told to be called. Another
        site's name that leads here is none. Beyond the loopback the port may be that of a proxy before it."""
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
        """Whether a page of this server sends the request, itself or through a proxy that encrypts."""
        return origin is not None and origin in (f"http://{host}", f"https://{host}")


def _address(name: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
    """The address that a name is; None where it is none. That of localhost is this machine's own."""
    try:
        return ipaddress.ip_address("127.0.0.1" if name == "localhost" else name)
    except ValueError:
        return None
