"""The right to read the page and to command through it: decisions without a server."""

from __future__ import annotations

import hmac
import ipaddress
import secrets
from dataclasses import dataclass
from urllib.parse import urlsplit

TOKEN_BYTES = 24
_LOOPBACK_NAMES = ("localhost",)


def make_token() -> str:
    """Make a token that can't be guessed."""
    return secrets.token_urlsafe(TOKEN_BYTES)


def same_token(candidate: str, token: str) -> bool:
    """Compare a token in a time that doesn't tell how much of it was right."""
    # Bytes that are no text reach us as lone surrogates.
    return hmac.compare_digest(candidate.encode("utf-8", "surrogatepass"), token.encode())


def bearer(header: str | None) -> str:
    """Return the token of an Authorization header, empty without one."""
    scheme, _, token = (header or "").partition(" ")
    return token.strip() if scheme.lower() == "bearer" else ""


def _name_and_port(host: str) -> tuple[str, int] | None:
    try:
        split = urlsplit(f"//{host}")
        name, port = split.hostname, split.port
    except ValueError:
        return None
    if not name or split.username is not None or split.path or split.query or split.fragment:
        return None
    return name, 80 if port is None else port


def _address(name: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
    try:
        return ipaddress.ip_address(name)
    except ValueError:
        return None


def is_loopback(host: str) -> bool:
    """Tell whether a server that binds to this can be reached from this machine alone."""
    address = _address(host)
    return host in _LOOPBACK_NAMES if address is None else address.is_loopback


@dataclass(frozen=True, slots=True)
class AccessRules:
    """The rules of access to the page.

    Args:
        bind_address: the address that the server was bound to, as it was given.
        own_names: names of this machine, under which it may be addressed when it isn't on loopback.
    """

    bind_address: str
    port: int
    token: str
    own_names: tuple[str, ...] = ()

    @property
    def open_to_read(self) -> bool:
        """Tell whether reading needs no token, since only this machine can."""
        return is_loopback(self.bind_address)

    def knows_host(self, host: str | None) -> bool:
        """Tell whether a request's Host names this server by an address or a name that is its own.

        A page of somebody else whose name was made to point here (DNS rebinding) sends its own
        name, and is refused.
        """
        name_and_port = _name_and_port(host or "")
        if name_and_port is None or name_and_port[1] != self.port:
            return False
        name = name_and_port[0]
        address = _address(name)
        if self.open_to_read:
            return is_loopback(name)
        if address is not None:
            return True
        return name in (*_LOOPBACK_NAMES, self.bind_address, *self.own_names)

    def knows_origin(self, origin: str | None, host: str, fetch_site: str | None) -> bool:
        """Tell whether a request comes from this page, or from no page at all (a program)."""
        if fetch_site is not None and fetch_site not in ("same-origin", "none"):
            return False
        return origin is None or origin == f"http://{host}"


@dataclass
class TokenBucket:
    """Lets so many pass at once, and then so many a second.

    Args:
        size: at once.
        per_s: afterwards.
    """

    size: float
    per_s: float
    _left: float = -1.0
    _at_ns: int = 0

    def take(self, now_ns: int) -> bool:
        """Tell whether one more passes now (steady clock)."""
        if self._left < 0.0:
            self._left, self._at_ns = self.size, now_ns
        passed_s = max(0, now_ns - self._at_ns) / 1e9
        self._left = min(self.size, self._left + passed_s * self.per_s)
        self._at_ns = now_ns
        if self._left < 1.0:
            return False
        self._left -= 1.0
        return True
