"""Block numbers of GigE Vision become running numbers across their wrap."""

import socket

import pytest

from drivers.cameras.aravis import gige_control
from drivers.cameras.aravis.gige_control import BlockNumbers


def test_running_numbers_go_on_where_16_bits_start_again_at_1():
    numbers = BlockNumbers()
    assert [numbers.running(block) for block in (65533, 65534, 65535, 1, 2)] == [65533, 65534, 65535, 65536, 65537]


def test_a_gap_across_the_wrap_keeps_its_width():
    numbers = BlockNumbers()
    first = numbers.running(65530)
    assert numbers.running(3) - first == 8


def test_a_late_block_keeps_its_place_before_the_later_ones():
    numbers = BlockNumbers()
    assert [numbers.running(block) for block in (100, 102, 101, 103)] == [100, 102, 101, 103]


def test_a_late_block_from_before_the_wrap_is_late_and_not_a_cycle_ahead():
    numbers = BlockNumbers()
    assert [numbers.running(block) for block in (65534, 1, 65535, 2)] == [65534, 65536, 65535, 65537]


def test_blocks_of_64_bits_do_not_wrap():
    numbers = BlockNumbers()
    assert [numbers.running(block) for block in (65534, 65535, 65536, 200000)] == [65534, 65535, 65536, 200000]


@pytest.fixture
def control_port(monkeypatch):
    """A port of our own in place of the one GigE Vision port, which a virtual camera may hold."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as port:
        port.bind(("127.0.0.1", 0))
        monkeypatch.setattr(gige_control, "CONTROL_PORT", port.getsockname()[1])
        yield port


def test_a_port_where_nobody_listens_refuses_at_once(control_port):
    control_port.close()
    assert gige_control.ask("127.0.0.1", timeout_s=5.0) == "refused"


def test_a_port_that_says_nothing_is_silent(control_port):
    assert gige_control.ask("127.0.0.1", timeout_s=0.05) == "silent"
