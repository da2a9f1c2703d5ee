"""What an instrument is for: any gate, supply, filter wheel or light source that keeps its role fits the bench."""

from collections.abc import Callable
from typing import Protocol

from drivers.serial_lines.line import InstrumentLine
from labdata.gating import Sync


class Instrument(Protocol):
    """What every instrument of the bench can do; one thread at a time uses it."""

    @property
    def line(self) -> InstrumentLine:
        """The line that it speaks on."""
        ...

    def identify(self) -> str:
        """Return who answers, and clear old errors; another instrument than expected is InstrumentReplyError."""
        ...

    def look(self) -> None:
        """Look whether all is as it was set, every moment while no procedure runs; what is wrong is a BenchError.

        Before anything was set it is a sign of life.
        """
        ...


class Gate(Instrument, Protocol):
    """Opens the gate unit of the tube for a set time at each trigger; `GateDriver` compares settings for its models."""

    @property
    def shut_commands(self) -> tuple[str, ...]:
        """Commands that shut the gate at once, sent one by one when the tube is made safe."""
        ...

    def check_pulse(
        self, *, width_ns: float, rate_hz: float, delay_ns: float = 0.0, sync: Sync = "free-running"
    ) -> None:
        """Refuse (BadInput) a pulse that this model cannot make: too short, too long, too fine, not so triggered."""
        ...

    def shut(self) -> None:
        """Shut the gate: no triggers, idle level closed; read back."""
        ...

    def open(self, *, width_ns: float, rate_hz: float, delay_ns: float = 0.0, sync: Sync = "free-running") -> float:
        """Open the gate for a time at each trigger, of which `rate_hz` come, and return its width as read back, ns."""
        ...


class Supply(Instrument, Protocol):
    """Puts the high voltage across the microchannel plate; `SupplyDriver` compares the output for its models."""

    @property
    def off_commands(self) -> tuple[str, ...]:
        """Commands that take the high voltage off, sent one by one when the tube is made safe."""
        ...

    @property
    def reading(self) -> str:
        """The question whose answer is the voltage at the output, for the log."""
        ...

    is_on: bool
    """Whether this object switched it on and not off."""

    def check_voltage(self, volts: float) -> None:
        """Refuse (BadInput) a voltage that this model cannot put out or is finer than its resolution."""
        ...

    def prepare(self, *, limit_v: float) -> None:
        """Switch off, and make the supply itself refuse more than a limit, V."""
        ...

    def switch_on(self) -> None:
        """Switch on at the lowest voltage."""
        ...

    def raise_to(self, goal_v: float, *, rate_v_per_s: float, check: Callable[[], None] = lambda: None) -> float:
        """Raise the voltage no faster than a rate, V/s, and return the settled output, V; a trip ends the ramp."""
        ...

    def lower_to(self, goal_v: float, *, check: Callable[[], None] = lambda: None) -> float:
        """Lower the voltage and return the settled output, V."""
        ...

    def off(self) -> float:
        """Order off, wait until the output is discharged, and return it, V."""
        ...

    def measured_v(self) -> float:
        """Voltage at the output, V."""
        ...

    def check_on(self) -> None:
        """Raise InstrumentTripped if the supply switched itself off. Reading may clear the trip: one owner does it."""
        ...


class FilterWheel(Instrument, Protocol):
    """Puts one of its filters into the light."""

    @property
    def positions(self) -> int:
        """How many positions the wheel has."""
        ...

    def position(self) -> int:
        """Where the wheel stands, counted from 1."""
        ...

    def turn_to(self, position: int) -> int:
        """Turn the wheel, wait until it stands, and return the position read back."""
        ...


class LightSource(Instrument, Protocol):
    """Lights the target, and goes dark on command."""

    @property
    def dark_commands(self) -> tuple[str, ...]:
        """Commands that take the light out, sent one by one when the tube is made safe."""
        ...

    def prepare(self, *, limit_a: float) -> None:
        """Go dark, and make the source itself refuse more than a current, A."""
        ...

    def darken(self) -> None:
        """Take the light out; read back."""
        ...

    def shine(self, current_a: float) -> float:
        """Drive the lamp with a current, A, and return it as read back."""
        ...


class LightMeter(Instrument, Protocol):
    """Measures the light next to the tube."""

    def tune(self, wavelength_nm: float) -> None:
        """Have it correct for the sensitivity of its head at a wavelength, nm; read back."""
        ...

    def power_w(self) -> float:
        """Power on its head, W."""
        ...


class Thermometer(Instrument, Protocol):
    """Measures how warm tube or camera are."""

    def temperature_c(self) -> float:
        """Temperature, degrees Celsius."""
        ...
