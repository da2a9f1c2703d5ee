"""Who may see the bench: requests that name this server, come from its own page, and show its token if it has one.

A picture of the bench must not leave it through another page that is open in the same browser. Such a page can make the
browser ask us, and can even make its own name resolve to our address, but it cannot choose what the browser writes into
Host, Origin and Sec-Fetch-Site (https://fetch.spec.whatwg.org, https://www.w3.org/TR/fetch-metadata).
"""

import hmac
import ipaddress
import secrets
from http.cookies import CookieError, SimpleCookie
from typing import Any
from urllib.parse import parse_qs

from labdata.errors import BadInput

LOOPBACK_NAMES = ("localhost", "127.0.0.1", "[::1]")
HEADERS = (
    (b"content-security-policy", b"default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; "
     b"connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"),
    (b"cross-origin-opener-policy", b"same-origin"),
    (b"cross-origin-resource-policy", b"same-origin"),
    (b"referrer-policy", b"no-referrer"),
    (b"x-content-type-options", b"nosniff"),
    (b"cache-control", b"no-store"),
)  # fmt: skip


def is_loopback(host: str) -> bool:
    """Whether an address or name to bind to can be reached from this machine alone."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return False


class PageAccess:
    """Middleware between the network and the page; what it refuses never reaches the page.

    Parameters
    ----------
    app
        The application behind it, ASGI.
    hosts
        Names by which this server may be called, without port.
    port
        The port it listens on.
    token
        Secret that every request must show, in the address once and in a cookie from then on; None: none is needed,
        because only this machine can reach the server.

    Raises
    ------
    BadInput
        If there is no token and a name is not of the loopback.
    """

    def __init__(self, app: Any, *, hosts: tuple[str, ...], port: int, token: str | None) -> None:
        if token is None and (open_ := [host for host in hosts if not is_loopback(host)]):
            raise BadInput(f"a page that others can reach must have a token, got none for {open_[0]}")
        self._app, self._token, self._cookie = app, token, f"charact-{port}"
        self._hosts = {f"{host.lower()}:{port}" for host in hosts}
        if port == 80:
            self._hosts |= {host.lower() for host in hosts}

    async def __call__(self, scope: dict, receive: Any, send: Any) -> None:
        """Answer one request, or refuse it in a sentence."""
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
        elif scope["type"] != "http":
            return  # a web socket is never accepted
        elif why := self._why_not(scope):
            await _answer(send, 403, why)
        elif self._token is not None and self._shows(_query_token(scope)):
            await self._give_cookie(send)
        elif self._token is not None and not self._shows(self._cookie_of(scope)):
            await _answer(send, 401, "this page needs the token of the address that charact printed")
        else:
            await self._app(scope, receive, _with_security_headers(send))

    def _why_not(self, scope: dict) -> str | None:
        """Return why a request is not one of our own page, None where it is."""
        host = _only(scope, b"host")
        if host is None or host.lower() not in self._hosts | self._local_address(scope):
            return f"this page is not at {host!r}"
        origin = _only(scope, b"origin")
        if origin is not None and origin.lower() != f"http://{host.lower()}":
            return "this page answers no other origin"
        if _only(scope, b"sec-fetch-site") not in (None, "same-origin", "none"):
            return "this page answers no other site"
        if scope["method"] not in ("GET", "HEAD") and origin is None:
            return "what changes something must say where it comes from"
        return None

    def _local_address(self, scope: dict) -> set[str]:
        """Return the address of ours that a connection came in on, where others may come in."""
        if self._token is None or not scope.get("server"):
            return set()
        address, port = scope["server"][:2]
        return {f"[{address}]:{port}" if ":" in address else f"{address}:{port}"}

    def _shows(self, shown: str | None) -> bool:
        # In constant time: how long a refusal takes must not tell how much of a guess was right.
        return shown is not None and hmac.compare_digest(shown.encode(), (self._token or "").encode())

    def _cookie_of(self, scope: dict) -> str | None:
        try:
            morsel = SimpleCookie(_only(scope, b"cookie") or "").get(self._cookie)
        except CookieError:
            return None
        return morsel.value if morsel else None

    async def _give_cookie(self, send: Any) -> None:
        """Move the token out of the address, where history and bookmarks would keep it."""
        cookie = f"{self._cookie}={self._token}; HttpOnly; SameSite=Strict; Path=/"
        await _answer(send, 303, "", ((b"location", b"/"), (b"set-cookie", cookie.encode())))


def new_token() -> str:
    """Return a token nobody can guess."""
    return secrets.token_urlsafe(32)


def _query_token(scope: dict) -> str | None:
    values = parse_qs(scope["query_string"].decode("latin-1")).get("token", [])
    return values[0] if len(values) == 1 else None


def _only(scope: dict, name: bytes) -> str | None:
    """Return a header's value; one that comes twice is none that we know."""
    values = [value for key, value in scope["headers"] if key == name]
    if not values:
        return None
    return values[0].decode("latin-1") if len(values) == 1 else "(twice)"


def _with_security_headers(send: Any) -> Any:
    async def sending(message: dict) -> None:
        if message["type"] == "http.response.start":
            message = {**message, "headers": [*message["headers"], *HEADERS]}
        await send(message)

    return sending


async def _answer(send: Any, status: int, sentence: str, headers: tuple = ()) -> None:
    body = sentence.encode()
    plain = ((b"content-type", b"text/plain; charset=utf-8"), (b"content-length", str(len(body)).encode()))
    hardened = _with_security_headers(send)
    await hardened({"type": "http.response.start", "status": status, "headers": [*plain, *headers]})
    await hardened({"type": "http.response.body", "body": body})
