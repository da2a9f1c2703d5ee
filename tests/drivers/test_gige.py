"""Block numbers of GigE Vision become running numbers across their wrap, and the control port says
who listens.
"""

import socket

import pytest

from drivers.cameras.aravis import connection
from drivers.cameras.aravis.capture import BLOCK_NUMBERS
from drivers.cameras.aravis.connection import ask_control_port
from drivers.cameras.frame_assembly import RunningNumbers


def test_running_numbers_go_on_where_16_bits_start_again_at_1():
    numbers = RunningNumbers(BLOCK_NUMBERS)
    assert [numbers.running(block) for block in (65533, 65534, 65535, 1, 2)] == [
        65533,
        65534,
        65535,
        65536,
        65537,
    ]


def test_a_gap_across_the_wrap_keeps_its_width():
    numbers = RunningNumbers(BLOCK_NUMBERS)
    first = numbers.running(65530)
    assert numbers.running(3) - first == 8


def test_a_late_block_keeps_its_place_before_the_later_ones():
    numbers = RunningNumbers(BLOCK_NUMBERS)
    assert [numbers.running(block) for block in (100, 102, 101, 103)] == [100, 102, 101, 103]


def test_a_late_block_from_before_the_wrap_is_late_and_not_a_cycle_ahead():
    numbers = RunningNumbers(BLOCK_NUMBERS)
    assert [numbers.running(block) for block in (65534, 1, 65535, 2)] == [
        65534,
        65536,
        65535,
        65537,
    ]


def test_blocks_of_64_bits_do_not_wrap():
    numbers = RunningNumbers(BLOCK_NUMBERS)
    assert [numbers.running(block) for block in (65534, 65535, 65536, 200000)] == [
        65534,
        65535,
        65536,
        200000,
    ]


@pytest.fixture
def control_port(monkeypatch):
    """A port of our own in place of the one GigE Vision port, which a virtual camera may hold."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as port:
        port.bind(("127.0.0.1", 0))
        monkeypatch.setattr(connection, "CONTROL_PORT", port.getsockname()[1])
        yield port


def test_a_port_where_nobody_listens_refuses_at_once(control_port):
    control_port.close()
    assert ask_control_port("127.0.0.1", timeout_s=5.0) is None


def test_a_port_that_says_nothing_is_silent(control_port):
    assert ask_control_port("127.0.0.1", timeout_s=0.05) is False
