"""The virtual adapter behaves as the Prologix manual says."""

import pytest

from simulate.virtual_bench.instruments.high_voltage import HighVoltageSupply
from simulate.virtual_bench.prologix import PrologixAdapter


@pytest.fixture
def adapter():
    adapter = PrologixAdapter({14: HighVoltageSupply()})
    said(adapter, b"++auto 0\n++eoi 1\n++eos 2\n++addr 14\n*CLS\n")
    return adapter


def said(adapter, data: bytes) -> bytes:
    return b"".join(answer for _, answer in adapter.receive(data))


@pytest.mark.parametrize("end", [b"\r", b"\n", b"\r\n"])
def test_lines_end_with_either_terminator(adapter, end):
    assert said(adapter, b"++addr" + end) == b"14\r\n"


def test_an_answer_comes_only_when_read(adapter):
    assert said(adapter, b"VSET?\n") == b""
    assert said(adapter, b"++read eoi\n") == b"0\n"


def test_auto_reads_after_every_write_and_makes_sets_query_errors(adapter):
    said(adapter, b"++auto 1\n")
    assert said(adapter, b"VSET?\n") == b"0\n"
    said(adapter, b"VSET 100\n")
    assert int(said(adapter, b"*ESR?\n")) & 4


def test_nobody_at_the_address_is_silence(adapter):
    assert said(adapter, b"++addr 9\n*IDN?\n++read eoi\n++spoll\n") == b""


@pytest.mark.parametrize(
    "line", [b"++what", b"++addr 31", b"++addr x", b"++eos 4", b"++read_tmo_ms 0", b"++mode 2"]
)
def test_unknown_commands_and_values_are_told(adapter, line):
    assert said(adapter, line + b"\n") == b"Unrecognized command\r\n"


def test_settings_read_back(adapter):
    said(adapter, b"++read_tmo_ms 250\n++savecfg 0\n")
    assert (
        said(adapter, b"++read_tmo_ms\n++eos\n++eoi\n++mode\n++auto\n++savecfg\n")
        == b"250\r\n2\r\n1\r\n1\r\n0\r\n0\r\n"
    )
    assert b"ersion" in said(adapter, b"++ver\n")


def test_an_unescaped_plus_is_thrown_away_and_an_escaped_one_kept(adapter):
    said(adapter, b"VSET 1\x1b+2\n")  # no number
    assert int(said(adapter, b"*ESR?\n++read eoi\n")) == 32
    said(adapter, b"VSET 1+00\n")
    assert said(adapter, b"VSET?\n++read eoi\n") == b"100\n"


def test_without_terminator_or_eoi_the_instrument_waits_for_more(adapter):
    said(adapter, b"++eoi 0\n++eos 3\nVSET?\n")
    assert said(adapter, b"++read eoi\n") == b""
    said(adapter, b"++clr\n++eoi 1\n")
    assert said(adapter, b"VSET?\n++read eoi\n") == b"0\n"


def test_a_serial_poll_shows_that_a_message_waits_and_takes_nothing(adapter):
    said(adapter, b"VSET?\n")
    assert said(adapter, b"++spoll\n++spoll 14\n") == b"16\r\n16\r\n"
    assert said(adapter, b"++read eoi\n") == b"0\n"


def test_a_mark_can_follow_the_end_of_an_answer(adapter):
    said(adapter, b"++eot_char 13\n++eot_enable 1\n")
    assert said(adapter, b"VSET?\n++read eoi\n") == b"0\n\r"
