"""From buffers to frames: whole ones are handed out in order, the others are counted lost, each with its reason."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from drivers.interface import CameraError
from labdata.capture import Frame, LostFrames, losses_before

MOST_BROKEN = 20
"""Broken frames that a capture bears beyond as many as it wants whole ones."""


@dataclass(frozen=True, kw_only=True)
class IncompleteFrame:
    """A frame that came and is not whole: its number where it can be told, and what is wrong in a few words."""

    number: int | None
    fault: str


class FrameAssembler:
    """The frames of one capture.

    Parameters
    ----------
    wanted
        Whole frames to hand out.
    discard
        Whole frames to throw away first.
    identifier
        The camera's name, for sentences.
    """

    def __init__(self, *, wanted: int, discard: int, identifier: str) -> None:
        self._wanted, self._discard, self._identifier = wanted, discard, identifier
        self._expected: int | None = None
        self._faults: dict[int, str] = {}
        self.losses: tuple[LostFrames, ...] = ()
        """Frames numbered by the camera since the first one kept, and not whole."""

    @property
    def lost(self) -> int:
        """How many they are."""
        return sum(loss.last - loss.first + 1 for loss in self.losses)

    def of(self, next_one: Callable[[], Frame | IncompleteFrame]) -> Iterator[Frame]:
        """Hand out whole frames.

        Parameters
        ----------
        next_one
            Returns the next frame, whole or broken.

        Raises
        ------
        CameraError
            If the camera sends only broken frames.
        """
        whole = broken = 0
        while whole < self._discard + self._wanted:
            frame = next_one()
            if isinstance(frame, Frame) and self._expected is not None and frame.number < self._expected:
                frame = IncompleteFrame(number=frame.number, fault="too late")
            if isinstance(frame, IncompleteFrame):
                broken += 1
                self._note(frame)
                self._require_some_whole(whole, broken, fault=frame.fault)
                continue
            self._count_lost(frame.number, handed_out=whole >= self._discard)
            whole += 1
            if whole > self._discard:
                yield frame

    def _note(self, frame: IncompleteFrame) -> None:
        if frame.number is not None:
            self._faults[frame.number] = frame.fault

    def _count_lost(self, number: int, *, handed_out: bool) -> None:
        """Count the numbers that are missing since the last whole frame.

        Frames broken before the first whole one are not of this run: a receiver may get its full buffer only when a
        frame is already coming, so that a busy machine receives the very first one without it.
        """
        if handed_out and self._expected is not None:
            self.losses += losses_before(number, expected=self._expected, faults=self._faults)
        self._faults.clear()
        self._expected = number + 1

    def _require_some_whole(self, whole: int, broken: int, *, fault: str) -> None:
        if broken > MOST_BROKEN + self._wanted:
            raise CameraError(
                f"camera {self._identifier} must send whole frames, got {broken} broken ones "
                f"(the last: {fault}) beside {whole} whole"
            )
