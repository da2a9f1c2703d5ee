"""The live page and its server."""

import asyncio
import json
import re
import signal
import socket
import subprocess
import sys
import textwrap
from contextlib import ExitStack
from http.client import HTTPConnection, HTTPResponse
from typing import Any

import httpx
import numpy as np
import pytest

from charact.live import LiveLoop
from charact.live.page import page
from charact.live.server import PageAccess, _address, _names, is_loopback, new_token, serve
from labdata import BadInput
from tests.charact.live.sources import Told, noisy, seen

# The page: who may see it, and what it shows.


PORT = 8600
OWN = f"http://127.0.0.1:{PORT}"
PATHS = ("/", "/live.js", "/live.css", "/view.json", "/picture.jpg", "/events")


@pytest.fixture(scope="module")
def running(seed):
    rng = np.random.default_rng(seed)
    frames = []
    for number in range(1, 4):
        pixels = noisy(rng)
        pixels.ravel()[:11] = 255
        frames.append(seen(pixels, number))
    with LiveLoop(Told(frames)) as running:
        while running.newest.end_reason is None:
            running.newest.after(2**62, timeout_s=1.0)
        yield running


class Client:
    """Asks an application without a network, and keeps its cookies."""

    def __init__(self, app: Any, base: str) -> None:
        self._app, self._base, self._cookies = app, base, httpx.Cookies()

    def get(self, path: str, **asked: Any) -> httpx.Response:
        return asyncio.run(self._ask("GET", path, asked))

    def post(self, path: str, **asked: Any) -> httpx.Response:
        return asyncio.run(self._ask("POST", path, asked))

    async def _ask(self, method: str, path: str, asked: dict) -> httpx.Response:
        transport = httpx.ASGITransport(self._app)
        async with httpx.AsyncClient(
            transport=transport, base_url=self._base, cookies=self._cookies
        ) as client:
            answer = await client.request(method, path, **asked)
            self._cookies = client.cookies
            return answer


def client(
    running: LiveLoop,
    *,
    token: str | None = None,
    base: str = OWN,
    hosts=("127.0.0.1", "localhost"),
) -> Client:
    return Client(
        PageAccess(page(running, title="charact live"), hosts=hosts, port=PORT, token=token), base
    )


def test_own_page_is_served_with_no_door_left_open(running) -> None:
    for path in PATHS:
        answer = client(running).get(path)
        assert answer.status_code == 200, path
        assert "access-control-allow-origin" not in answer.headers
        assert "default-src 'none'" in answer.headers["content-security-policy"]
        assert answer.headers["cross-origin-resource-policy"] == "same-origin"
        assert answer.headers["cache-control"] == "no-store"
    own = {"origin": OWN, "sec-fetch-site": "same-origin"}
    assert client(running).get("/view.json", headers=own).status_code == 200


@pytest.mark.parametrize(
    "strange",
    [
        {"host": f"rebound.example:{PORT}"},
        {"host": "127.0.0.1"},
        {"host": f"127.0.0.1.rebound.example:{PORT}"},
        {"host": ""},
        {"origin": "http://stranger.example"},
        {"origin": "null"},
        {"origin": f"https://127.0.0.1:{PORT}"},
        {"origin": f"http://localhost:{PORT}"},
        {"sec-fetch-site": "cross-site"},
        [("host", f"127.0.0.1:{PORT}"), ("host", "rebound.example")],
    ],
    ids=str,
)
def test_another_origin_or_another_name_sees_nothing(running, strange) -> None:
    for path in PATHS:
        answer = client(running).get(path, headers=strange)
        assert answer.status_code == 403
        assert "mean_dn" not in answer.text and "<" not in answer.text


def test_another_page_cannot_make_the_bench_forget(running) -> None:
    assert client(running).post("/best/forget").status_code == 403
    assert (
        client(running)
        .post("/best/forget", headers={"origin": "http://stranger.example"})
        .status_code
        == 403
    )
    assert client(running).post("/best/forget", headers={"origin": OWN}).status_code == 200


@pytest.mark.parametrize("path", ["/", "/view.json"])
def test_without_the_token_nobody_sees_a_page_that_others_can_reach(running, path) -> None:
    token, bench = new_token(), "http://bench.lab:8600"
    strangers = client(running, token=token, base=bench, hosts=("bench.lab",))
    refused = [
        strangers.get(path),
        strangers.get(path, params={"token": ""}),
        strangers.get(path, params={"token": token[:-1]}),
        strangers.get(path, params={"token": "ü"}),
        strangers.get(path, params={"token": [token, token]}),
        strangers.get(path, headers={"cookie": f"charact-{PORT}={token[:-1]}"}),
        strangers.get(path, headers={"cookie": f"charact-{PORT + 1}={token}"}),
        strangers.get(path, headers={"cookie": "charact-8600"}),
    ]
    assert {answer.status_code for answer in refused} == {401}
    assert all(
        "token in the address" in answer.text and "mean_dn" not in answer.text for answer in refused
    )
    assert (
        strangers.get(
            path, params={"token": token}, headers={"host": "rebound.example:8600"}
        ).status_code
        == 403
    )


def test_the_token_opens_once_by_address_and_then_by_a_cookie_that_no_script_reads(running) -> None:
    token = new_token()
    known = client(running, token=token, base="http://bench.lab:8600", hosts=("bench.lab",))
    answer = known.get("/", params={"token": token})
    assert answer.status_code == 303 and answer.headers["location"] == "/"
    assert {"httponly", "samesite=strict"} <= set(answer.headers["set-cookie"].lower().split("; "))
    assert known.get("/view.json").status_code == 200


def test_no_address_but_the_loopback_is_served_without_a_token(running) -> None:
    for host in ("0.0.0.0", "::", "192.0.2.7", "bench.lab", ""):
        assert not is_loopback(host)
        with pytest.raises(BadInput, match="must have a token"):
            client(running, hosts=(host,))
    assert all(
        is_loopback(host) for host in ("127.0.0.1", "127.8.8.8", "::1", "[::1]", "localhost")
    )


def test_a_web_socket_is_never_accepted(running) -> None:
    sent = []

    async def send(message: dict) -> None:
        sent.append(message["type"])

    guard = PageAccess(
        page(running, title="charact live"), hosts=("127.0.0.1",), port=PORT, token=None
    )
    scope = {
        "type": "websocket",
        "path": "/events",
        "headers": [(b"host", b"127.0.0.1:8600")],
        "query_string": b"",
    }
    asyncio.run(guard(scope, None, send))
    assert "websocket.accept" not in sent and "websocket.send" not in sent


def test_events_carry_meters_and_histogram_and_end_with_a_reason(running) -> None:
    events = [
        block.split("\n", 1) for block in client(running).get("/events").text.strip().split("\n\n")
    ]
    kinds = [kind.removeprefix("event: ") for kind, _ in events]
    assert kinds == ["about", "view", "ended"]
    view = json.loads(events[1][1].removeprefix("data: "))
    assert view["saturated_px"] == 11 and sum(view["histogram"]) == view["pixels"] == 128 * 160
    assert view["frame_rate_hz"] == pytest.approx(30.0)
    assert "no more frames" in events[2][1]


def test_the_page_asks_the_network_for_nothing_and_names_a_unit_with_every_meter(running) -> None:
    files = {path: client(running).get(path).text for path in ("/", "/live.js", "/live.css")}
    assert not any(
        "http:" in text or "https:" in text or "//" in text.replace("// ", "")
        for text in files.values()
    )
    for unit in ("DN", "px", "Hz", "cy/px", "ms", "%"):
        assert any(unit in text for text in files.values())


def test_a_source_that_fails_ends_the_views_with_its_sentence() -> None:
    class Failing(Told):
        def __iter__(self):
            from drivers.errors import CameraError

            raise CameraError("camera X has gone")
            yield

    with LiveLoop(Failing([])) as running:
        assert running.newest.after(0, timeout_s=5.0) is None
        assert running.newest.end_reason == "camera X has gone"


# Serving: what is missing or taken is one sentence; the address of a page for others holds its
# token.


@pytest.fixture
def idle_loop():
    with LiveLoop(Told([seen(np.zeros((20, 20), np.uint8), 1)])) as idle_loop:
        yield idle_loop


def test_the_missing_extra_is_named_with_its_install_command(idle_loop, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "uvicorn", None)
    with pytest.raises(BadInput, match=r"pip install 'charact\[live\]'.*uvicorn"):
        serve(idle_loop, title="charact live", tell=print)


@pytest.mark.wires
def test_a_port_that_is_taken_or_none_is_one_sentence(idle_loop) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        with pytest.raises(BadInput, match="free port of this machine"):
            serve(idle_loop, title="charact live", port=taken.getsockname()[1], tell=print)
    with pytest.raises(BadInput, match="between 0 and 65535, got 70000"):
        serve(idle_loop, title="charact live", port=70000, tell=print)


@pytest.mark.wires
def test_the_server_ends_with_its_frames_and_says_why(idle_loop) -> None:
    told: list[str] = []
    with pytest.raises(BadInput, match="has no more frames"):
        serve(idle_loop, title="charact live", tell=told.append)
    assert len(told) == 1 and re.match(r"http://127\.0\.0\.1:\d+/\?token=.{40}", told[0])


SERVED = """
    from threading import Event
    import numpy as np
    from charact.live.live_loop import LiveLoop
    from charact.live.server import serve
    from tests.charact.live.sources import Told, seen
    frames = [seen(np.zeros((20, 20), np.uint8), number) for number in range(9)]
    with LiveLoop(Told(frames, let_go=Event(), pause_s=0.1)) as running:
        serve(running, title="charact live", tell=lambda address: print(address, flush=True))
"""


@pytest.mark.wires
def test_a_signal_ends_the_page_with_twenty_viewers_and_nobody_else_reads_it() -> None:
    command, stopping = [sys.executable, "-c", textwrap.dedent(SERVED)], signal.SIGTERM
    with (
        subprocess.Popen(command, stdout=-1, stderr=-1, text=True) as page,
        ExitStack() as ending,
    ):
        ending.callback(page.kill)
        assert page.stdout is not None and page.stderr is not None
        address, _, token = page.stdout.readline().strip().partition("/?token=")
        host = address.partition("//")[2]

        def asked(path: str, cookie: str = "") -> HTTPResponse:
            connection = HTTPConnection(host, timeout=10.0)
            connection.request("GET", path, headers={"cookie": cookie})
            answer = connection.getresponse()
            ending.callback(connection.close)
            ending.callback(answer.close)
            return answer

        cookie = str(asked(f"/?token={token}").headers["set-cookie"]).partition(";")[0]
        assert {asked("/events", cookie).status for _ in range(20)} == {200}
        assert asked("/view.json").status == 401
        page.send_signal(stopping)
        assert page.wait(5.0) in (-stopping, 0)
        assert not page.stderr.read()


def test_the_token_is_in_the_address_of_the_page() -> None:
    assert _address("::1", 8600, "secret") == "http://[::1]:8600/?token=secret"
    assert _address("bench.lab", 8600, "secret") == "http://bench.lab:8600/?token=secret"
    assert "0.0.0.0" not in _address("0.0.0.0", 8600, "secret")
    assert "bench.lab" in _names("bench.lab") and "localhost" in _names("127.0.0.1")
