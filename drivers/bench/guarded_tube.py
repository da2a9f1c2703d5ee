"""Gate and gain behind the interlock: every order is asked for first and read back after."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from drivers.bench.interlock import Interlock
from drivers.bench.state import Command, GainRead, GateRead, LowerGain, OpenGate, RaiseGain, SafeOrdered
from drivers.instruments.voltage_limits import DISCHARGED_V
from drivers.roles import Gate, Supply
from labdata.gating import Gating

SAME_V = 0.5
"""A voltage this near the one asked is that one, V."""


class GuardedTube:
    """Gate and supply of one tube; nobody else speaks to them while it is in use.

    Parameters
    ----------
    gate, supply
        The instruments.
    interlock
        Asked before each order, told after it.
    field_hz
        Fields of the camera a second, Hz.
    gating
        What triggers the gate.
    check
        Raises what went wrong at the bench; called before each order and along every ramp.
    watch_supply
        Told whether the supply should be on, for whoever watches for trips.
    """

    def __init__(
        self,
        *,
        gate: Gate,
        supply: Supply,
        interlock: Interlock,
        field_hz: float,
        gating: Gating,
        check: Callable[[], None],
        watch_supply: Callable[[bool], None],
    ) -> None:
        self._gate, self._supply, self._interlock = gate, supply, interlock
        self._check, self._watch_supply = check, watch_supply
        self._gate_hz, self._most_hz = gating.rate_hz(field_hz), gating.most_hz(field_hz)
        self._gating = gating

    def read_anew(self) -> None:
        """Shut the gate and read what is left at the output of a supply that was ordered off."""
        self.shut()
        self._tell_gain(self._supply.measured_v())

    def set(self, *, mcp_v: float, gate_ns: float) -> tuple[float, float]:
        """Shut the gate, move the gain, verify it, open the gate; return voltage (V) and width (ns) read back.

        Raises
        ------
        InterlockRefused, BadInput
            If a rule forbids it or an instrument could not do it; nothing was changed then.
        """
        self._check()
        move = self._gain_move(mcp_v)
        self._foresee(move, mcp_v, gate_ns)
        self.shut()
        read_v = self._move_gain(move, mcp_v)
        read_ns = self._open(gate_ns) if gate_ns else 0.0
        return read_v, read_ns

    def shut(self) -> None:
        """Shut the gate, which needs no leave, and read it back."""
        self._interlock.tell(SafeOrdered())
        self._gate.shut()
        self._interlock.tell(GateRead(width_ns=0.0, rate_hz=0.0))

    def off(self) -> float:
        """Switch the gain off, which needs no leave, and follow it down; return what is left, V."""
        self._interlock.tell(SafeOrdered())
        self._watch_supply(False)
        return self._tell_gain(self._supply.off())

    def _gain_move(self, mcp_v: float) -> RaiseGain | LowerGain | None:
        """Return what a voltage asks of a supply; None where it is off or there already."""
        present_v = self._supply.measured_v() if self._supply.is_on else 0.0
        if not mcp_v or math.isclose(mcp_v, present_v, abs_tol=SAME_V):
            return None
        if mcp_v < present_v:
            return LowerGain(goal_v=mcp_v)
        return RaiseGain(goal_v=mcp_v, rate_v_per_s=self._rate_v_per_s)

    def _foresee(self, move: RaiseGain | LowerGain | None, mcp_v: float, gate_ns: float) -> None:
        """Refuse before anything is done what would be refused on the way."""
        commands: list[Command] = [] if move is None else [move]
        if mcp_v:
            self._supply.check_voltage(mcp_v)
        if gate_ns:
            commands.append(OpenGate(width_ns=gate_ns, rate_hz=self._most_hz))
            self._gate.check_pulse(width_ns=gate_ns, **self._pulse)
        self._interlock.foresee(*commands, state=replace(self._interlock.state, duty=0.0))

    @property
    def _pulse(self) -> dict[str, Any]:
        """All of a pulse but its width."""
        return {"rate_hz": self._gate_hz, "delay_ns": self._gating.delay_ns, "sync": self._gating.sync}

    @property
    def _rate_v_per_s(self) -> float:
        return self._interlock.limits.ramp_v_per_s

    def _move_gain(self, move: RaiseGain | LowerGain | None, mcp_v: float) -> float:
        if not mcp_v:
            return self.off()
        if move is None:
            return self._tell_gain(self._supply.measured_v())
        self._check()
        self._interlock.permit(move)
        if isinstance(move, LowerGain):
            return self._tell_gain(self._supply.lower_to(mcp_v, check=self._check))
        if not self._supply.is_on:
            self._supply.switch_on()
            self._watch_supply(True)
        return self._tell_gain(self._supply.raise_to(mcp_v, rate_v_per_s=self._rate_v_per_s, check=self._check))

    def _open(self, gate_ns: float) -> float:
        self._check()
        self._interlock.permit(OpenGate(width_ns=gate_ns, rate_hz=self._most_hz))
        read_ns = self._gate.open(width_ns=gate_ns, **self._pulse)
        self._interlock.tell(GateRead(width_ns=read_ns, rate_hz=self._most_hz))
        return read_ns

    def _tell_gain(self, read_v: float) -> float:
        self._interlock.tell(GainRead(mcp_v=0.0 if read_v <= DISCHARGED_V else read_v))
        return read_v
