"""Serving the page: on the loopback unless told otherwise, behind its guard, until the frames or the person end it."""

import socket
import threading
from collections.abc import Callable

from charact.live.guard import LOOPBACK_NAMES, PageAccess, is_loopback, new_token
from charact.live.live_loop import LiveLoop
from labdata.errors import BadInput

LOOPBACK = "127.0.0.1"
LAST_WORDS_S = 0.5
NEEDS = "the live page needs packages that are not installed: pip install 'charact[live]'"


def serve(
    running: LiveLoop,
    *,
    title: str,
    focus_first: bool = False,
    host: str = LOOPBACK,
    port: int = 0,
    tell: Callable[[str], None],
) -> None:
    """Serve the page of a bench until interrupted.

    Parameters
    ----------
    running
        The bench at work.
    title, focus_first
        As `charact.live.page.page`.
    host
        Address or name to listen on. Anything but the loopback can be reached by others: a token is then needed,
        made anew for every start and printed within the address.
    port
        Port; 0: any free one.
    tell
        Told the page's address, once.

    Raises
    ------
    BadInput
        If the packages are missing, the address cannot be listened on, or the frames ended.
    """
    try:
        import uvicorn

        from charact.live.page import page
    except ImportError as error:
        raise BadInput(f"{NEEDS} (missing: {error.name})") from None
    with _listening(host, port) as listener:
        port = listener.getsockname()[1]
        token = None if is_loopback(host) else new_token()
        app = PageAccess(
            page(running, title=title, focus_first=focus_first), hosts=_names(host, token), port=port, token=token
        )
        server = uvicorn.Server(
            uvicorn.Config(
                app,
                log_level="error",
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
        family, _, _, _, address = socket.getaddrinfo(host.strip("[]"), port, type=socket.SOCK_STREAM)[0]
        listener = socket.socket(family, socket.SOCK_STREAM)
    except OSError as error:
        raise BadInput(f"the page must have an address of this machine, got {host!r} ({error.strerror})") from None
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind(address)
    except OSError as error:
        listener.close()
        raise BadInput(
            f"the page must have a free port of this machine, got {host}:{port} ({error.strerror})"
        ) from None
    return listener


def _names(host: str, token: str | None) -> tuple[str, ...]:
    """Return the names by which a browser may call the page."""
    if token is None:
        return tuple(dict.fromkeys((*LOOPBACK_NAMES, _with_brackets(host))))
    return (_with_brackets(host), socket.gethostname(), socket.getfqdn())


def _address(host: str, port: int, token: str | None) -> str:
    everywhere = host.strip("[]") in ("0.0.0.0", "::")
    name = socket.gethostname() if everywhere else _with_brackets(host)
    return f"http://{name}:{port}/" + ("" if token is None else f"?token={token}")


def _with_brackets(host: str) -> str:
    return f"[{host}]" if ":" in host and not host.startswith("[") else host


def _stop_at_end(running: LiveLoop, server) -> None:
    """Let the server go once there are no more frames and every page was told why."""
    while running.newest.end_reason is None:
        running.newest.after(2**62, timeout_s=1.0)
    threading.Event().wait(LAST_WORDS_S)
    server.should_exit = True
