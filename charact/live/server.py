"""Server of the live page, with access control."""

import hmac
import ipaddress
import secrets
import socket
import threading
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from charact.live.live_loop import LiveLoop
from labdata.errors import BadInput

if TYPE_CHECKING:
    from starlette.requests import Request

LOOPBACK_NAMES = ("localhost", "127.0.0.1", "[::1]")
HEADERS = {
    "content-security-policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; "
        "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "referrer-policy": "no-referrer",
    "x-content-type-options": "nosniff",
    "cache-control": "no-store",
}


def is_loopback(host: str) -> bool:
    """Whether an address or name is of the loopback."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return False


class PageAccess:
    """ASGI middleware that passes only requests for this server, from its own page, with its token.

    Another page in the same browser must not read the frames. It can send requests here, and can
    make its own name resolve to this address, but cannot choose the headers Host, Origin and
    Sec-Fetch-Site (https://fetch.spec.whatwg.org, https://www.w3.org/TR/fetch-metadata). `hosts`:
    names of this server, without port; `token`: secret of every request, in the first address and
    then in a cookie; None: only on the loopback, else BadInput.
    """

    def __init__(self, app: Any, *, hosts: tuple[str, ...], port: int, token: str | None) -> None:
        if token is None and (open_ := [host for host in hosts if not is_loopback(host)]):
            raise BadInput(
                f"a page on an address other than loopback must have a token, got none for "
                f"{open_[0]}"
            )
        self._app, self._token, self._cookie = app, token, f"charact-{port}"
        self._hosts = {f"{host.lower()}:{port}" for host in hosts}
        if port == 80:
            self._hosts |= {host.lower() for host in hosts}

    async def __call__(self, scope: dict, receive: Any, send: Any) -> None:
        """Pass one request to the application, or refuse it."""
        from starlette.datastructures import MutableHeaders
        from starlette.requests import Request
        from starlette.responses import PlainTextResponse, RedirectResponse

        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
        if scope["type"] != "http":
            return  # no web sockets

        async def send_hardened(message: Any) -> None:
            if message["type"] == "http.response.start":
                MutableHeaders(scope=message).update(HEADERS)
            await send(message)

        request, answer = Request(scope), self._app
        tokens = request.query_params.getlist("token")
        if why := self._why_not(request):
            answer = PlainTextResponse(why, 403)
        elif len(tokens) == 1 and self._shows(tokens[0]):
            # The token moves from the address, which the browser history keeps, to a cookie.
            answer = RedirectResponse("/", 303)
            answer.set_cookie(self._cookie, tokens[0], httponly=True, samesite="strict")
        elif self._token is not None and not self._shows(request.cookies.get(self._cookie)):
            answer = PlainTextResponse(
                "this page needs the token in the address printed by charact", 401
            )
        await answer(scope, receive, send_hardened)

    def _why_not(self, request: "Request") -> str | None:
        """Return the reason to refuse a request, or None."""
        host, origin, site = (
            # Of a repeated header no value is right.
            ", ".join(values) if (values := request.headers.getlist(name)) else None
            for name in ("host", "origin", "sec-fetch-site")
        )
        if host is None or host.lower() not in self._hosts | self._local_address(request.scope):
            return f"this page is not at {host!r}"
        if origin is not None and origin.lower() != f"http://{host.lower()}":
            return "this page answers no other origin"
        if site not in (None, "same-origin", "none"):
            return "this page answers no other site"
        if request.method not in ("GET", "HEAD") and origin is None:
            return "a request that changes state needs an Origin header"
        return None

    def _local_address(self, scope: Any) -> set[str]:
        """Return the local address of a connection, if the server is not on the loopback."""
        if self._token is None or not scope.get("server"):
            return set()
        address, port = scope["server"][:2]
        return {f"[{address}]:{port}" if ":" in address else f"{address}:{port}"}

    def _shows(self, shown: str | None) -> bool:
        # Constant time: the duration must not depend on the correct part of a guess.
        if shown is None or self._token is None:
            return False
        return hmac.compare_digest(shown.encode(), self._token.encode())


def new_token() -> str:
    """Return a random token."""
    return secrets.token_urlsafe(32)


NEEDS = "the live page needs packages that are not installed: pip install 'charact[live]'"


def serve(
    running: LiveLoop,
    *,
    title: str,
    focus_first: bool = False,
    host: str = "127.0.0.1",
    port: int = 0,
    tell: Callable[[str], None],
) -> None:
    """Serve the live page until the frames end or the user interrupts.

    Parameters
    ----------
    running, title, focus_first
        As `charact.live.page.page`.
    host, port
        Address or name to listen on, and port (0: a free one). The page requires a token, new for
        every start and printed with the address: other users of a machine reach its loopback.
    tell
        Prints the address of the page.

    Raises
    ------
    BadInput
        If packages are missing, the address is not available, or the frames ended.
    """
    try:
        import uvicorn

        from charact.live.page import page
    except ImportError as error:
        raise BadInput(f"{NEEDS} (missing: {error.name})") from None
    with _listening(host, port) as listener:
        port = listener.getsockname()[1]
        token = new_token()
        app = PageAccess(
            page(
                running,
                title=title,
                focus_first=focus_first,
                is_closing=lambda: server.should_exit,
            ),
            hosts=_names(host),
            port=port,
            token=token,
        )
        server = uvicorn.Server(
            uvicorn.Config(
                app,
                # A viewer that is cut off is no error, and a full pipe of messages would block.
                log_level="critical",
                access_log=False,
                lifespan="off",
                ws="none",
                server_header=False,
                proxy_headers=False,
                timeout_graceful_shutdown=1,
            )
        )
        threading.Thread(target=_stop_at_end, args=(running, server), daemon=True).start()
        tell(_address(host, port, token))
        server.run(sockets=[listener])
    if running.newest.end_reason is not None:
        raise BadInput(running.newest.end_reason)


def _listening(host: str, port: int) -> socket.socket:
    if not 0 <= port <= 65535:
        raise BadInput(f"a port must lie between 0 and 65535, got {port}")
    try:
        family, _, _, _, address = socket.getaddrinfo(
            host.strip("[]"), port, type=socket.SOCK_STREAM
        )[0]
        listener = socket.socket(family, socket.SOCK_STREAM)
    except OSError as error:
        raise BadInput(
            f"`host` must be an address of this machine, got {host!r} ({error.strerror})"
        ) from None
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind(address)
        listener.listen()  # who gets the address may connect before the server runs
    except OSError as error:
        listener.close()
        raise BadInput(
            f"`port` must be a free port of this machine, got {host}:{port} ({error.strerror})"
        ) from None
    return listener


def _names(host: str) -> tuple[str, ...]:
    """Return the host names of the page."""
    if is_loopback(host):
        return tuple(dict.fromkeys((*LOOPBACK_NAMES, _with_brackets(host))))
    return (_with_brackets(host), socket.gethostname(), socket.getfqdn())


def _address(host: str, port: int, token: str) -> str:
    everywhere = host.strip("[]") in ("0.0.0.0", "::")
    name = socket.gethostname() if everywhere else _with_brackets(host)
    return f"http://{name}:{port}/?token={token}"


def _with_brackets(host: str) -> str:
    return f"[{host}]" if ":" in host and not host.startswith("[") else host


def _stop_at_end(running: LiveLoop, server) -> None:
    """Stop the server after the end of the frames has been sent to the pages."""
    while running.newest.end_reason is None:
        running.newest.after(2**62, timeout_s=1.0)
    threading.Event().wait(0.5)
    server.should_exit = True
