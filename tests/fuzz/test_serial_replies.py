"""Whatever an instrument says, its driver ends in an error of its own, in time."""

import random

import pytest

from tests.fuzz import serial_replies


@pytest.mark.parametrize("name", serial_replies.PARSERS)
def test_no_reply_makes_a_driver_crash_or_hang(name):
    rng = random.Random(20261122)
    for _ in range(12):
        serial_replies.try_once(name, serial_replies.reply(rng), rng)


def test_a_long_answer_is_not_repeated_whole_in_the_sentence():
    said = b"x" * (serial_replies.LONGEST_ANSWER - 10) + b"\r\n"
    serial_replies.try_once("ps350 status", said, random.Random(1))
    serial_replies.try_once("dg645 identity", said, random.Random(1))
