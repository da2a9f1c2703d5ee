"""The gain of a tube by calibration: luminous gain against the voltage across its microchannel plate, and back."""

from dataclasses import dataclass

from labdata.errors import BadInput
from labdata.monotonic_table import RisingTable


@dataclass(frozen=True, kw_only=True)
class GainTable:
    """A calibration of one tube.

    Parameters
    ----------
    source
        Who measured it, how and when, in words.
    tube
        Name of the tube; None: not said.
    mcp_v
        Voltages across the plate, V, rising.
    luminous_gain
        Luminous gain at each, lm/lm or whatever the calibration counts, rising.
    relative_sd
        Relative standard uncertainty of each gain, dimensionless.

    Raises
    ------
    BadInput
        If the table is no monotone calibration of at least two points, or does not say where it comes from.

    Notes
    -----
    The gain of a plate goes as a power of its voltage (J. L. Wiza, Nucl. Instrum. Methods 162 (1979) 587); see
    `RisingTable` for what that makes of the numbers between the points.
    """

    source: str
    tube: str | None = None
    mcp_v: tuple[float, ...]
    luminous_gain: tuple[float, ...]
    relative_sd: tuple[float, ...]

    def __post_init__(self) -> None:
        if not self.source.strip():
            raise BadInput("a gain table must say its source, got none")
        self._table()

    @property
    def provenance(self) -> str:
        """Where a luminous gain by this table comes from, in a sentence."""
        of = f" of tube {self.tube}" if self.tube else ""
        span = f"{self.mcp_v[0]:g} to {self.mcp_v[-1]:g} V"
        return f"Luminous gain by calibration{of}: {self.source}; {len(self.mcp_v)} points, {span}."

    def gain_at(self, mcp_v: float, *, beyond_v: float = 0.0) -> tuple[float, float]:
        """Return the luminous gain at a voltage, V, and its relative standard uncertainty.

        Parameters
        ----------
        mcp_v
            Voltage across the plate, V.
        beyond_v
            How far it may lie outside the table, V: a supply set to the table's end reads back a little more or less.

        Raises
        ------
        BadInput
            If the voltage lies further outside.
        """
        return self._table().second_at(mcp_v, beyond=beyond_v)

    def volts_for(self, luminous_gain: float) -> float:
        """Return the voltage, V, at which the tube has a luminous gain; outside the table is BadInput."""
        return self._table().first_for(luminous_gain)

    def _table(self) -> RisingTable:
        return RisingTable(
            of="gain table",
            names=("mcp_v", "luminous_gain"),
            first=self.mcp_v,
            second=self.luminous_gain,
            relative_sd=self.relative_sd,
        )
