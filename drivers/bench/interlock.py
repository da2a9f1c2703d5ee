"""The interlock: it holds what may be true of the tube, lets commands pass or refuses them, and hears what was read."""

import threading
import time
from collections.abc import Callable

from drivers.bench.rules import REACTIONS, RULES, Reaction, Rule, alarm, refuse
from drivers.bench.state import Command, Event, TubeState
from labdata.limits import LimitsInForce

Watcher = Callable[[TubeState, float], None]
"""Called as watcher(state, now_s) with the state that held until now, at every change."""


class Interlock:
    """A state machine between whoever asks and the tube.

    Parameters
    ----------
    limits
        The limits in force.
    rules, reactions
        The rules; all of them, but for a test of what each is for.
    clock
        Monotonic time, s.
    """

    def __init__(
        self,
        limits: LimitsInForce,
        *,
        rules: tuple[Rule, ...] = RULES,
        reactions: tuple[Reaction, ...] = REACTIONS,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.limits = limits
        self._rules, self._reactions, self._clock = rules, reactions, clock
        self._state, self._watchers = TubeState(), []
        self._changing = threading.RLock()

    @property
    def state(self) -> TubeState:
        """What may be true of the tube now."""
        return self._state

    def watch(self, watcher: Watcher) -> None:
        """Call a watcher at every change, before it."""
        self._watchers.append(watcher)

    def foresee(self, *commands: Command, state: TubeState | None = None) -> None:
        """Refuse (InterlockRefused) commands that would be refused one after the other, from a state on."""
        state = self._state if state is None else state
        for command in commands:
            refuse(state, command, self.limits, self._clock(), self._rules)
            state = command.ordered(state)

    def permit(self, command: Command) -> None:
        """Let a command pass, which then counts as done, or refuse it (InterlockRefused)."""
        with self._changing:
            refuse(self._state, command, self.limits, self._clock(), self._rules)
            self._become(command.ordered(self._state))

    def tell(self, event: Event) -> None:
        """Hear what was read, seen or heard."""
        with self._changing:
            self._become(event.seen(self._state))

    def alarm(self) -> str | None:
        """Return why the tube must be made safe now, in a sentence; None where it need not."""
        return alarm(self._state, self.limits, self._clock(), self._reactions)

    def _become(self, state: TubeState) -> None:
        for watcher in self._watchers:
            watcher(self._state, self._clock())
        self._state = state
