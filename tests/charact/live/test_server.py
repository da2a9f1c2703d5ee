"""Serving: what is missing or taken is one sentence; the address of a page for others holds its
token.
"""

import socket
import sys

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
    assert len(told) == 1 and told[0].startswith("http://127.0.0.1:") and "token" not in told[0]


def test_the_token_is_in_the_address_of_a_page_that_others_can_reach_and_in_no_other() -> None:
    assert _address("127.0.0.1", 8600, None) == "http://127.0.0.1:8600/"
    assert _address("::1", 8600, None) == "http://[::1]:8600/"
    assert _address("bench.lab", 8600, "secret") == "http://bench.lab:8600/?token=secret"
    assert "0.0.0.0" not in _address("0.0.0.0", 8600, "secret")
    assert "bench.lab" in _names("bench.lab", "secret")
