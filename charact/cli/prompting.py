"""Operator of a real bench: prompts a person on the terminal to place targets and to set the light.

The tube may be on while the person or the terminal (Ctrl-S) is slow: no wait is longer than 0.1 s
without a call of `while_waiting`.
"""

import os
import select
import sys
from collections.abc import Callable

from labdata.conditions import Conditions
from labdata.errors import BadInput
from labdata.session import Kind
from labdata.target import Target

POLL_S = 0.1
"""Longest wait between two calls of `while_waiting`, s."""


class _Terminal:
    """Prompts on stderr and answers from stdin, polled."""

    def __init__(self) -> None:
        self.while_waiting: Callable[[], None] = lambda: None
        """Called every 0.1 s during a prompt; an exception ends the prompt."""
        self._typed = b""

    def _show(self, text: str) -> None:
        """Write a text if the terminal is ready."""
        descriptor = _descriptor(sys.stderr)
        if descriptor is None:
            print(text, end="", file=sys.stderr, flush=True)
        elif select.select((), (descriptor,), (), 0.0)[1]:
            os.write(descriptor, text.encode())

    def _answer(self, question: str, purpose: str) -> str:
        """Write a question and return the answer; the end of the input raises BadInput."""
        descriptor = _descriptor(sys.stderr)
        while descriptor is not None and not select.select((), (descriptor,), (), POLL_S)[1]:
            self.while_waiting()
        self._show(question)
        descriptor = _descriptor(sys.stdin)
        line = "" if descriptor is None else self._line_of(descriptor)
        if not line:
            raise BadInput(
                f"a person must answer {purpose}, got the end of the input; run it on a terminal"
            )
        return line.strip()

    def _line_of(self, descriptor: int) -> str:
        """Return the next line of a descriptor; further input is kept for the next question."""
        while b"\n" not in self._typed:
            if not select.select((descriptor,), (), (), POLL_S)[0]:
                self.while_waiting()
                continue
            try:
                more = os.read(descriptor, 4096)
            except OSError:  # the terminal was closed
                more = b""
            if not more:
                line, self._typed = self._typed, b""
                return line.decode(errors="replace")
            self._typed += more
        line, _, self._typed = self._typed.partition(b"\n")
        return (line + b"\n").decode(errors="replace")


class PromptingOperator(_Terminal):
    """Asks a person to place targets, to set the light and to read the light meter."""

    is_by_hand = True
    """Whether a person sets the light."""

    def darken(self) -> None:
        """Ask for the light to be blocked, without waiting."""
        self._show("Block the light now.\n")

    def place(
        self,
        *,
        kind: Kind,
        target: Target,
        illuminance_lux: float,
        filter_density: float | None = None,
    ) -> Conditions:
        """Ask for a target, a filter and an illuminance; return the reading of the light meter."""
        if illuminance_lux == 0.0:
            self.darken()
            return Conditions(illuminance_lux=0.0)
        behind = "" if filter_density is None else f" behind a filter of density {filter_density:g}"
        answer = self._answer(
            f"Place the {_words(kind, target)}; set {illuminance_lux:g} lux{behind}.\n"
            "What does the meter read, in lux? ",
            "what the meter reads",
        )
        try:
            return Conditions(illuminance_lux=float(answer), filter_density=filter_density)
        except ValueError:
            raise BadInput(f"the meter's reading must be a number in lux, got {answer!r}") from None


class TargetPlacer(_Terminal):
    """Asks a person to place targets; the bench controls the lamp."""

    is_by_hand = False
    """Whether a person sets the light."""

    def __init__(self) -> None:
        super().__init__()
        self._placed: tuple[Kind, Target] | None = None

    def darken(self) -> None:
        """Do nothing: the bench switches its lamp off."""

    def place(
        self,
        *,
        kind: Kind,
        target: Target,
        illuminance_lux: float,
        filter_density: float | None = None,
    ) -> Conditions:
        """Ask for a new target and wait until it is placed; a dark needs none."""
        if kind != "dark" and (kind, target) != self._placed:
            self._answer(
                f"Place the {_words(kind, target)}, then press Enter. ",
                f"once the {kind} target is placed",
            )
            self._placed = (kind, target)
        return Conditions(illuminance_lux=0.0)


def _descriptor(stream: object) -> int | None:
    """Return the descriptor of a stream, or None."""
    try:
        return stream.fileno()  # pyright: ignore[reportAttributeAccessIssue]
    except (AttributeError, OSError, ValueError):
        return None


def _words(kind: Kind, target: Target) -> str:
    details = ", ".join(
        f"{name} {value}" for name, value in vars(target).items() if value is not None
    )
    return f"{kind} target ({details or 'no details'})"
