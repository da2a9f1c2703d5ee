"""A person at the prompt may take their time: the run is called meanwhile, and may end the
prompt.
"""

import io
import os
import pty
import sys
import threading
import time
from collections.abc import Callable
from contextlib import closing

import pytest

from charact.cli.benches import PromptingOperator, TargetPlacer
from labdata import BadInput, Target


@pytest.fixture(params=["terminal", "pipe"])
def typed(request, monkeypatch):
    """Standard input that is a terminal or a pipe; what is called types on it, nothing closes
    it.
    """
    keyboard, there = pty.openpty() if request.param == "terminal" else os.pipe()[::-1]
    open_ends = {keyboard, there}
    with open(there, closefd=False) as stdin:
        monkeypatch.setattr(sys, "stdin", stdin)

        def type_(text: str) -> None:
            if text:
                os.write(keyboard, text.encode())
            elif request.param == "pipe":
                os.close(keyboard)
                open_ends.discard(keyboard)
            else:
                os.write(keyboard, b"\x04")

        yield type_
    for end in open_ends:
        os.close(end)


def reading(operator: PromptingOperator) -> float | None:
    return operator.place(kind="flat", target=Target(), illuminance_lux=2e-5).illuminance_lux


def later(act: Callable[[], None], seconds: float) -> threading.Timer:
    timer = threading.Timer(seconds, act)
    timer.start()
    return timer


def test_answers_are_read_line_by_line_whenever_they_are_typed(typed, capfd):
    operator = PromptingOperator()
    typed("1e-5\n2e-5\n")
    assert [reading(operator), reading(operator)] == [1e-5, 2e-5]
    later(lambda: typed("3e-"), 0.05)
    timer = later(lambda: typed("5\n"), 0.3)
    assert reading(operator) == 3e-5
    timer.join()
    assert capfd.readouterr().err.count("What does the meter read, in lux? ") == 3


def test_the_run_is_called_ten_times_a_second_and_what_it_raises_ends_the_prompt(typed):
    operator, calls_s = PromptingOperator(), []

    def waiting() -> None:
        calls_s.append(time.monotonic())
        if len(calls_s) == 6:
            raise ZeroDivisionError

    operator.while_waiting = waiting
    began_s = time.monotonic()
    with pytest.raises(ZeroDivisionError):
        reading(operator)
    # A bench makes safe after 0.6 s without a sign of life.
    assert (
        max(after - before for before, after in zip([began_s, *calls_s], calls_s, strict=False))
        < 0.5
    )
    operator.while_waiting = lambda: None
    typed("4e-5\n")
    assert reading(operator) == 4e-5


def test_the_end_of_the_input_is_one_sentence(typed):
    typed("")
    with pytest.raises(
        BadInput, match="a person must answer what the meter reads, got the end of the input"
    ):
        reading(PromptingOperator())
    typed_placer = TargetPlacer()
    with pytest.raises(BadInput, match="once the edge target is placed, got the end"):
        sys.stdin = io.StringIO("")
        typed_placer.place(kind="edge", target=Target(), illuminance_lux=1.0)


def test_a_terminal_that_takes_no_more_is_waited_for_in_slices_and_not_at_all_to_darken(
    monkeypatch,
):
    there, full = os.pipe()
    os.set_blocking(full, False)
    with closing(os.fdopen(there, "rb")), open(full, "w", closefd=True) as stderr:
        with pytest.raises(BlockingIOError):
            while True:
                os.write(full, bytes(4096))
        os.set_blocking(full, True)
        monkeypatch.setattr(sys, "stderr", stderr)
        operator, calls = PromptingOperator(), []

        def waiting() -> None:
            calls.append(1)
            if len(calls) == 3:
                raise ZeroDivisionError

        operator.while_waiting = waiting
        operator.darken()
        assert not calls
        with pytest.raises(ZeroDivisionError):
            reading(operator)


def test_targets_are_placed_once_and_a_dark_needs_none(typed, capfd):
    placer = TargetPlacer()
    typed("\n")
    for kind in ("edge", "dark", "edge"):
        placer.place(kind=kind, target=Target(angle_deg=5.0), illuminance_lux=1.0)
    assert capfd.readouterr().err.count("press Enter") == 1
    assert (PromptingOperator.is_by_hand, TargetPlacer.is_by_hand) == (True, False)
