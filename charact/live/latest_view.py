"""The place where frames are measured into views and where any number of onlookers find the newest one."""

import threading

from charact.live.live_view import LiveView


class LatestView:
    """The newest view: written by one thread, read by any. Nobody waits for a slow reader."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._view: LiveView | None = None
        self._ended: str | None = None

    @property
    def view(self) -> LiveView | None:
        """The newest view; None before the first."""
        return self._view

    @property
    def end_reason(self) -> str | None:
        """Why no further view will come; None while more may come."""
        return self._ended

    def put(self, view: LiveView) -> None:
        """Put a newer view in place of the last one."""
        with self._changed:
            self._view = view
            self._changed.notify_all()

    def end(self, why: str) -> None:
        """Say that no further view will come."""
        with self._changed:
            self._ended = why
            self._changed.notify_all()

    def after(self, number: int, *, timeout_s: float) -> LiveView | None:
        """Return the newest view once its number is above `number`; None if none came in time, or the views ended."""
        with self._changed:
            self._changed.wait_for(lambda: self._is_after(number) or self._ended is not None, timeout=timeout_s)
            return self._view if self._is_after(number) else None

    def _is_after(self, number: int) -> bool:
        return self._view is not None and self._view.number > number
