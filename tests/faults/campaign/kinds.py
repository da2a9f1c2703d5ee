"""What can go wrong at a bench: how each fault is provoked and healed, and what can still be made safe under it."""

import os
import signal
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from simulate.rig.faults import Faults
from tests.faults.campaign.client import Client
from tests.faults.campaign.rig import CampaignRig

PATIENT_S = 15.0
SILENCE_S = 0.5

Act = Callable[[CampaignRig, Client], None]


@dataclass(frozen=True, kw_only=True)
class Fault:
    """One fault.

    Parameters
    ----------
    kind
        Its kind, for the tally.
    strike, heal
        Provoke it and take it away.
    hold_s
        How long it lasts if the client goes on, s.
    gate_hears, supply_hears
        Whether the instrument still hears what it is told: what cannot hear cannot be made safe.
    client_lives
        Whether the client lives on to write how its run ended.
    silence_s
        How long the client's camera may be silent, s: short where silence is the fault, long where drawing a frame
        on a busy machine must not be taken for one.
    shows_in_frames
        Whether it shows only where frames are asked for and do not come: the time promised counts from then. Between
        two stacks a camera sends nothing, and the tube is in the conditions that the plan asks for.
    ends_runs
        Whether a run must end by it; one that need not is timed nowhere.
    repair
        What a person has to do at the bench afterwards.
    """

    kind: str
    strike: Act
    heal: Act
    hold_s: float
    gate_hears: bool = True
    supply_hears: bool = True
    client_lives: bool = True
    silence_s: float = PATIENT_S
    shows_in_frames: bool = False
    ends_runs: bool = True
    repair: Callable[[CampaignRig], None] = lambda rig: None


INSTRUMENTS = ("delay_generator", "high_voltage")


def draw_fault(kind: str, rng: np.random.Generator) -> Fault:
    """Draw one fault of a kind: which instrument it strikes, how hard and how long."""
    return _DRAWERS[kind](kind, rng)


def _spoken(faults: Callable[[np.random.Generator], Faults], *, hears: bool = True):
    """A fault of a serial instrument's speech."""

    def draw(kind: str, rng: np.random.Generator) -> Fault:
        instrument, wrong = str(rng.choice(INSTRUMENTS)), faults(rng)
        return Fault(
            kind=kind,
            strike=lambda rig, client: rig.provoke(instrument, wrong),
            heal=lambda rig, client: rig.provoke(instrument, Faults()),
            hold_s=float(rng.uniform(0.5, 1.5)),
            gate_hears=hears or instrument != "delay_generator",
            supply_hears=hears or instrument != "high_voltage",
        )

    return draw


def _tripped(kind: str, rng: np.random.Generator) -> Fault:
    return Fault(
        kind=kind,
        strike=lambda rig, client: rig.provoke("high_voltage", Faults(tripped=True)),
        heal=lambda rig, client: rig.provoke("high_voltage", Faults()),
        hold_s=1.0,
        repair=_power_cycle_supply,  # the latch of a trip is cleared by a person
    )


def _power_cycle_supply(rig: CampaignRig) -> None:
    rig.unplug("high_voltage")
    rig.plug_in("high_voltage")


def _seen(faults: Callable[[np.random.Generator], Faults], *, silence_s: float = PATIENT_S, ends_runs: bool = False):
    """A fault of the camera."""

    def draw(kind: str, rng: np.random.Generator) -> Fault:
        wrong = faults(rng)
        return Fault(
            kind=kind,
            strike=lambda rig, client: rig.provoke("camera", wrong),
            heal=lambda rig, client: rig.provoke("camera", Faults()),
            hold_s=float(rng.uniform(0.8, 2.5)),
            silence_s=silence_s,
            shows_in_frames=True,
            ends_runs=ends_runs,
        )

    return draw


def _unplugged(kind: str, rng: np.random.Generator) -> Fault:
    instrument = str(rng.choice((*INSTRUMENTS, "camera")))
    return Fault(
        kind=kind,
        strike=lambda rig, client: rig.unplug(instrument),
        heal=lambda rig, client: rig.plug_in(instrument),
        hold_s=1.0,
        gate_hears=instrument != "delay_generator",
        supply_hears=instrument != "high_voltage",
    )


def _power_cycled(kind: str, rng: np.random.Generator) -> Fault:
    """Off and on again: the instrument comes back with its own settings, which are safe, at another port."""
    instrument = str(rng.choice(INSTRUMENTS))
    return Fault(
        kind=kind,
        strike=lambda rig, client: rig.power_cycle(instrument),
        heal=lambda rig, client: rig.await_ports(),
        hold_s=1.0,
        gate_hears=instrument != "delay_generator",
        supply_hears=instrument != "high_voltage",
    )


def _clock_jumped(kind: str, rng: np.random.Generator) -> Fault:
    """The camera's clock and the computer's jump, forwards or backwards."""
    jump_s = float(rng.choice((-1.0, 1.0)) * rng.uniform(1.0, 7200.0))

    def jump(rig: CampaignRig, client: Client) -> None:
        rig.provoke("camera", Faults(clock_jump_s=jump_s))
        client.signal(signal.SIGUSR2)

    return Fault(
        kind=kind,
        strike=jump,
        heal=lambda rig, client: rig.provoke("camera", Faults()),
        hold_s=float(rng.uniform(1, 2)),
    )


def _client_hangs(kind: str, rng: np.random.Generator) -> Fault:
    return Fault(
        kind=kind,
        strike=lambda rig, client: client.signal(signal.SIGSTOP),
        heal=lambda rig, client: client.signal(signal.SIGKILL),
        hold_s=2.0,
        client_lives=False,
    )


def _watchdog_killed(kind: str, rng: np.random.Generator) -> Fault:
    def kill(rig: CampaignRig, client: Client) -> None:
        if (pid := rig.watchdog()) is not None:
            os.kill(pid, signal.SIGKILL)

    return Fault(kind=kind, strike=kill, heal=_nothing, hold_s=1.0)


def _killed(kind: str, rng: np.random.Generator) -> Fault:
    return Fault(
        kind=kind,
        strike=lambda rig, client: client.signal(signal.SIGKILL),
        heal=_nothing,
        hold_s=0.0,
        client_lives=False,
    )


def _nothing(rig: CampaignRig, client: Client) -> None:
    pass


KILL = "kill -9 of the client"
_DRAWERS: dict[str, Callable[[str, np.random.Generator], Fault]] = {
    "garbage": _spoken(lambda rng: Faults(garbage=True)),
    "half lines": _spoken(lambda rng: Faults(half_lines=True)),
    "silence": _spoken(lambda rng: Faults(silent=True), hears=False),
    "no answers": _spoken(lambda rng: Faults(mute=True)),
    "late answers": _spoken(lambda rng: Faults(late_s=float(rng.uniform(0.1, 0.8)))),
    "trip of the supply": _tripped,
    "unplugged": _unplugged,
    "power cycle": _power_cycled,
    "packet loss": _seen(lambda rng: Faults(lost_packet_share=float(rng.uniform(0.02, 0.3)))),
    "stalled camera": _seen(lambda rng: Faults(stalled=True), silence_s=SILENCE_S, ends_runs=True),
    "clock jump": _clock_jumped,
    "client hangs": _client_hangs,
    "kill -9 of the watchdog": _watchdog_killed,
    KILL: _killed,
}
KINDS = tuple(kind for kind in _DRAWERS if kind != KILL)
"""All kinds of faults but the kill of the client, which is counted by itself."""
