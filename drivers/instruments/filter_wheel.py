"""The filters: a Thorlabs FW102C wheel with six or twelve positions."""

import re

from drivers.serial_lines.line import InstrumentLine
from drivers.serial_lines.replies import query_int, rejected_error, reply_error, verify_read_back
from labdata.errors import BadInput

IDENTITY = re.compile(r"(?i).*FW(102|212).*")
SENSORS_OFF = "sensors=0"
"""The lamps of its own position sensors out while it stands: they would light the tube."""


class FilterWheel:
    """The wheel.

    Parameters
    ----------
    line
        InstrumentLine to the instrument.
    """

    def __init__(self, line: InstrumentLine) -> None:
        self.line = line
        self._seen: int | None = None

    def identify(self) -> str:
        """Return the identity, and have the wheel's own lamps out; another instrument is InstrumentReplyError."""
        identity = self.line.ask("*idn?")
        if not IDENTITY.fullmatch(identity):
            raise reply_error(self.line, "be an FW102C or FW212C", repr(identity))
        self.line.write(SENSORS_OFF)
        verify_read_back(self.line, "sensors?", 0)
        return identity

    def look(self) -> None:
        """Ask where the wheel stands; if somebody has turned it since the first look, that is InstrumentRejected."""
        now = self.position()
        if self._seen not in (None, now):
            raise rejected_error(self.line, f"stay at {self._seen}", f"{now}: somebody turned it")
        self._seen = now

    @property
    def positions(self) -> int:
        """How many positions the wheel has."""
        return query_int(self.line, "pcount?")

    def position(self) -> int:
        """Where the wheel stands, counted from 1; somebody may have turned it at its buttons."""
        return query_int(self.line, "pos?")

    def turn_to(self, position: int) -> int:
        """Turn the wheel, wait until it stands, and return the position read back.

        Raises
        ------
        BadInput
            If the wheel has no such position.
        InstrumentRejected
            If it stands elsewhere afterwards.
        """
        count = self.positions
        if not 1 <= position <= count:
            raise BadInput(f"the filter must be one of 1 to {count}, got {position}")
        self.line.write(f"pos={position}")
        if (reached := self.position()) != position:
            raise rejected_error(self.line, f"turn to {position}", f"{reached}")
        self._seen = reached
        return reached
