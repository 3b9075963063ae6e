"""Access control of a console. A token in the URL is exchanged for a cookie. Requests that name another host, or come
from pages of another origin, are refused.

A page of another site may make a browser send requests to this server, but the page can neither read the cookie nor
forge the origin of a web socket. Requests with a foreign host name that resolves to this machine (DNS rebinding) are
refused.
Source: OWASP, Cross-Site WebSocket Hijacking; docs page, Trust.
"""

import hmac
import secrets
import time
from collections import deque
from collections.abc import Callable, Mapping
from http.cookies import CookieError, SimpleCookie
from typing import Any

PILOT, OBSERVER = "pilot", "observer"
TOKEN_BYTES = 24
MOST_WRONG_TOKENS, WRONG_PERIOD = 10, 60.0
"""Maximum number of wrong tokens within a period, and this period (s). After this number, all tokens are refused until
the wrong tokens are older than the period."""
LOOPBACK_HOSTS = ("127.0.0.1", "localhost", "[::1]")
HEADERS = {
    "Content-Security-Policy": "default-src 'self'; frame-ancestors 'none'; base-uri 'none'; form-action 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}


class Access:
    """Tokens of a console for pilots and for observers, and the cookies that a browser gets for a token."""

    def __init__(self, host: str, port: int, is_encrypted: bool, note: Callable[[str], None]) -> None:
        """note: function that is called with a message for each refused token."""
        self._note = note
        self._tokens = {role: secrets.token_urlsafe(TOKEN_BYTES) for role in (PILOT, OBSERVER)}
        self._sessions = {role: secrets.token_urlsafe(TOKEN_BYTES) for role in (PILOT, OBSERVER)}
        self._wrong: deque[float] = deque(maxlen=MOST_WRONG_TOKENS)
        self._cookie = f"trimtab_{port}"
        self._scheme = "https" if is_encrypted else "http"
        names = LOOPBACK_HOSTS if host in ("127.0.0.1", "::1", "localhost") else (f"[{host}]" if ":" in host else host,)
        self._hosts = {f"{name}:{port}" for name in names}
        self._first_host = f"{names[0]}:{port}"

    def url(self, role: str) -> str:
        """Return the URL, including the token, for a pilot or an observer."""
        return f"{self._scheme}://{self._first_host}/?token={self._tokens[role]}"

    def is_own_host(self, host: str) -> bool:
        """Return True if a request names this server as its host."""
        return host.lower() in self._hosts

    def is_own_origin(self, origin: str) -> bool:
        """Return True if a web socket was opened by a page of this server."""
        scheme, _, host = origin.partition("://")
        return scheme == self._scheme and self.is_own_host(host)

    def exchange(self, token: str) -> str | None:
        """Return the cookie for a token, or None if the token is wrong or too many wrong tokens were used."""
        now = time.monotonic()
        if len(self._wrong) == MOST_WRONG_TOKENS and now - self._wrong[0] < WRONG_PERIOD:
            return None
        for role, own in self._tokens.items():
            if hmac.compare_digest(token.encode(), own.encode()):
                return self._session_cookie(role)
        self._wrong.append(now)
        self._note(f"console: a wrong token was used; {len(self._wrong)} wrong tokens recently")
        return None

    def role(self, headers: Mapping[str, str]) -> str | None:
        """Return the role (pilot or observer) of a request's cookie, or None without a valid cookie."""
        cookies: SimpleCookie = SimpleCookie()
        try:
            cookies.load(headers.get("cookie", ""))
        except CookieError:
            return None
        held = cookies.get(self._cookie)
        for role, own in self._sessions.items():
            if held is not None and hmac.compare_digest(held.value.encode(), own.encode()):
                return role
        return None

    def _session_cookie(self, role: str) -> str:
        cookie: Any = SimpleCookie({self._cookie: self._sessions[role]})
        cookie[self._cookie] |= {"httponly": True, "samesite": "Strict", "path": "/"}
        if self._scheme == "https":
            cookie[self._cookie]["secure"] = True
        return cookie.output(header="").strip()
