"""Serving: what is missing or taken is one sentence; the address of a page for others holds its
token.
"""

import re
import signal
import socket
import subprocess
import sys
import textwrap
from contextlib import ExitStack
from http.client import HTTPConnection, HTTPResponse

import numpy as np
import pytest

from charact.live import LiveLoop
from charact.live.server import _address, _names, serve
from labdata import BadInput
from tests.charact.live.sources import Told, seen


@pytest.fixture
def running():
    with LiveLoop(Told([seen(np.zeros((20, 20), np.uint8), 1)])) as running:
        yield running


def test_the_missing_extra_is_named_with_its_install_command(running, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "uvicorn", None)
    with pytest.raises(BadInput, match=r"pip install 'charact\[live\]'.*uvicorn"):
        serve(running, title="charact live", tell=print)


@pytest.mark.wires
def test_a_port_that_is_taken_or_none_is_one_sentence(running) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        with pytest.raises(BadInput, match="free port of this machine"):
            serve(running, title="charact live", port=taken.getsockname()[1], tell=print)
    with pytest.raises(BadInput, match="between 0 and 65535, got 70000"):
        serve(running, title="charact live", port=70000, tell=print)


@pytest.mark.wires
def test_the_server_ends_with_its_frames_and_says_why(running) -> None:
    told: list[str] = []
    with pytest.raises(BadInput, match="has no more frames"):
        serve(running, title="charact live", tell=told.append)
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
