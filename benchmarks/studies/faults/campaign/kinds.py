"""The faults of the campaign: how each is provoked and healed, what a run owes under it, and within
which time.
"""

import itertools
import os
import resource
import signal
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from benchmarks.studies.faults.campaign.client import Client
from benchmarks.studies.faults.campaign.rig import (
    DANGEROUS_V,
    GATE,
    GATE_NS,
    INSTRUMENTS,
    LUX,
    SUPPLY,
    CampaignRig,
)
from labdata import Conditions, Gating, Plan, Step
from labdata.store.journal import JOURNAL
from simulate.virtual_bench.faults import Faults
from simulate.virtual_bench.outputs import Outputs

PATIENT_S = 15.0
SILENCE_S = 0.5
ROOM_LUX = 1.0
BLOCKED_S, PROMPTED_S = 2.0, 3.0
TERM, INTERRUPT, KILL, STOP = signal.SIGTERM, signal.SIGINT, signal.SIGKILL, signal.SIGSTOP

Act = Callable[[CampaignRig, Client], object]
"""Acts on the bench or its client; a strike may return the monotonic time at which its limit
begins, s."""


def _nothing(rig: CampaignRig, client: Client) -> None:
    pass


def _gate_is_open(outputs: Outputs) -> bool:
    return outputs.gate_open


@dataclass(frozen=True, kw_only=True)
class Fault:
    """One fault.

    Parameters
    ----------
    strike, heal
        Provoke it and take it away.
    lasts_s
        When it is healed, s after it struck, or, without `passes`, as soon as the tube is at rest.
    passes
        Whether it is over after `lasts_s`, whatever became of the tube.
    limit_s
        Within which time the gate is shut and the high voltage is off, s.
    deaf
        Instruments that cannot hear while it lasts.
    returns
        Whether these hear again when it is over: their time counts from then; else they have none.
    since
        What the time counts from: the strike; the first frames asked for after it, where it shows
        only in frames that do not come; the first frame saturated after it; or the last frame that
        came, where a run may go on.
    ends_run
        Whether the run must end: one that goes on as if nothing had happened breaks its promise.
    one_suffices
        Whether one of gate and voltage is enough, in a run that goes on.
    client_lives, log_lives, terminal_lives
        Whether the client lives on, with what it takes to end in a sentence; whether the session's
        log takes that, and the terminal.
    silence_s
        How long the client's camera may be silent, s: short where silence is the fault, long where
        drawing a frame on a busy machine must not be taken for one.
    plan
        Makes the plan under which it strikes from the campaign's own.
    ready
        Whether the tube is in the state in which it strikes.
    latest_s
        Until when it waits at random for that, s after the first step began.
    prompts
        Whether a person at the terminal sets the light.
    pipes_log
        Whether a pipe stands in place of the bench server's log.
    repair
        What a person has to do at the bench afterwards.
    """

    strike: Act
    heal: Act = _nothing
    lasts_s: float = 3.0
    passes: bool = False
    limit_s: float = 1.0
    deaf: tuple[str, ...] = ()
    returns: bool = False
    since: Literal["strike", "frames", "saturation", "progress"] = "strike"
    ends_run: bool = False
    one_suffices: bool = False
    client_lives: bool = True
    log_lives: bool = True
    terminal_lives: bool = True
    silence_s: float = PATIENT_S
    plan: Callable[[Plan], Plan] = field(default=lambda plan: plan)
    ready: Callable[[Outputs], bool] = _gate_is_open
    latest_s: float = 1.2
    prompts: bool = False
    pipes_log: bool = False
    repair: Callable[[CampaignRig], object] = field(default=lambda rig: None)


Draw = Callable[[np.random.Generator], Fault]


# Instruments on their lines, at their panels, and what they feel


def _provoked(instrument: str, wrong: Faults, *, and_then: Act = _nothing, **known: Any) -> Fault:
    def strike(rig: CampaignRig, client: Client) -> object:
        rig.provoke(instrument, wrong)
        return and_then(rig, client)

    return Fault(
        strike=strike,
        heal=lambda rig, client: rig.provoke(instrument, Faults()),
        **known,
    )


def _on_a_line(faults: Callable[[np.random.Generator], Faults], *, hears: bool = True) -> Draw:
    """Draw a fault of one instrument's speech."""

    def draw(rng: np.random.Generator) -> Fault:
        instrument = str(rng.choice(INSTRUMENTS))
        deaf = () if hears else (instrument,)
        return _provoked(
            instrument, faults(rng), lasts_s=float(rng.uniform(0.5, 1.5)), passes=True, deaf=deaf
        )

    return draw


def _trip(rng: np.random.Generator) -> Fault:
    # The latch of a trip is cleared by a person.
    return _provoked(
        SUPPLY, Faults(tripped=True), ends_run=True, repair=lambda rig: _off_and_on(rig, SUPPLY)
    )


def _off_and_on(rig: CampaignRig, instrument: str) -> None:
    rig.unplug(instrument)
    rig.plug_in(instrument)


def _power_cut(*, back: bool) -> Draw:
    """Draw an instrument whose power goes, at once back at another port or a second later."""

    def draw(rng: np.random.Generator) -> Fault:
        instrument = str(rng.choice(INSTRUMENTS))
        return Fault(
            strike=lambda rig, client: (rig.power_cycle if back else rig.unplug)(instrument),
            heal=lambda rig, client: rig.await_ports() if back else rig.plug_in(instrument),
            lasts_s=1.0,
            passes=True,
            deaf=(instrument,),
        )

    return draw


def _line_lost(back_as: str | None) -> Draw:
    """Draw an instrument whose port goes for 0.3 s, and comes back, or stands under another name
    first.
    """

    def draw(rng: np.random.Generator) -> Fault:
        instrument = str(rng.choice(INSTRUMENTS))
        gone = (
            Faults(unplugged=True)
            if back_as is None
            else Faults(port_name=f"{instrument}.{back_as}")
        )
        lasts_s = 0.3 if back_as is None else 2.0
        return _provoked(
            instrument,
            gone,
            lasts_s=lasts_s,
            passes=True,
            deaf=(instrument,),
            returns=True,
            limit_s=2.0,
            ends_run=True,
        )

    return draw


def _panel(instrument: str, *commands: str, **known: Any) -> Draw:
    return lambda rng: _provoked(instrument, Faults(panel=commands), ends_run=True, **known)


def _with_a_step_without_voltage(plan: Plan) -> Plan:
    off = Step(
        label="off", kind="dark", frames=40, conditions=Conditions(mcp_v=0.0, gate_ns=GATE_NS)
    )
    return replace(plan, steps=(off, *plan.steps))


def _without_voltage(outputs: Outputs) -> bool:
    return outputs.gate_open and outputs.mcp_v < DANGEROUS_V


def _voltage_rises(outputs: Outputs) -> bool:
    return not outputs.gate_open and DANGEROUS_V < outputs.mcp_v < 640.0


def _triggered(plan: Plan) -> Plan:
    return replace(plan, gating=Gating(sync="triggered"))


def _disobedient(instrument: str) -> Draw:
    return lambda rng: _provoked(
        instrument, Faults(disobedient=True), deaf=(instrument,), since="progress"
    )


def _seen(faults: Callable[[np.random.Generator], Faults], **known: Any) -> Draw:
    """Draw a fault of the camera."""
    return lambda rng: _provoked(
        "camera",
        faults(rng),
        lasts_s=float(rng.uniform(0.8, 2.5)),
        passes=True,
        since="frames",
        **known,
    )


def _camera_gone(rng: np.random.Generator) -> Fault:
    return Fault(
        strike=lambda rig, client: rig.unplug("camera"),
        heal=lambda rig, client: rig.plug_in("camera"),
        since="frames",
        ends_run=True,
    )


def _clock_jump(rng: np.random.Generator) -> Fault:
    """The camera's clock and the computer's jump, forwards or backwards."""
    jump_s = float(rng.choice((-1.0, 1.0)) * rng.uniform(1.0, 7200.0))

    def jump(rig: CampaignRig, client: Client) -> None:
        rig.provoke("camera", Faults(clock_jump_s=jump_s))
        client.signal(signal.SIGUSR2)

    heal = _provoked("camera", Faults()).heal
    return Fault(strike=jump, heal=heal, lasts_s=float(rng.uniform(1, 2)), passes=True)


# Processes


def _signalled(who: str, *numbers: signal.Signals, wait_s: float = 0.0) -> Act:
    """Send signals to the client or the bench server; the time counts from the last."""

    def send(rig: CampaignRig, client: Client) -> float:
        for place, number in enumerate(numbers):
            time.sleep(wait_s if place == 0 else 0.05)
            at_s = time.monotonic()
            _send(rig, client, who, number)
        return at_s

    return send


def _send(rig: CampaignRig, client: Client, who: str, number: signal.Signals) -> None:
    if who == "client":
        client.signal(number)
    elif (pid := rig.server()) is not None:
        os.kill(pid, number)


def _struck(who: str, *numbers: signal.Signals) -> Draw:
    """Draw a signal to a process; one that it stopped is killed afterwards."""
    stopped = numbers[-1] == STOP
    return lambda rng: Fault(
        strike=_signalled(who, *numbers),
        heal=_signalled(who, KILL) if stopped else _nothing,
        client_lives=who == "server" or numbers[-1] in (TERM, INTERRUPT),
        ends_run=True,
    )


def _starved(who: str, of: Literal["descriptors", "threads", "memory"]) -> Draw:
    """Draw a process that has nothing left of something when the other one is killed."""
    other = "server" if who == "client" else "client"

    def strike(rig: CampaignRig, client: Client) -> object:
        if (
            pid := client.pid if who == "client" else rig.server()
        ) is not None and client.exit_code() is None:
            _starve(pid, of)
        return _signalled(other, KILL)(rig, client)

    # A run that ends for want of something may do so at once, or before it writes its log.
    return lambda rng: Fault(strike=strike, client_lives=False, log_lives=False, ends_run=True)


def _starve(pid: int, of: str) -> None:
    """Leave a process no descriptor, no room for a thread's stack of 8 MB, or 50 MB of memory."""
    if of == "descriptors":
        used = {int(name) for name in os.listdir(f"/proc/{pid}/fd")}
        limit, least = (
            resource.RLIMIT_NOFILE,
            next(number for number in itertools.count() if number not in used),
        )
    else:
        size = int(Path(f"/proc/{pid}/statm").read_text().split()[0]) * resource.getpagesize()
        limit, least = resource.RLIMIT_AS, size + (50 if of == "memory" else 4) * 1_000_000
    resource.prlimit(pid, limit, (least, resource.prlimit(pid, limit)[1]))


# What blocks


def _blocked(block: Act, release: Act, then: Act = _nothing, **known: Any) -> Draw:
    """Draw something that takes no more, and what happens to the client besides."""

    def strike(rig: CampaignRig, client: Client) -> object:
        block(rig, client)
        return then(rig, client)

    known = {"since": "progress" if then is _nothing else "strike", **known}
    limit_s = BLOCKED_S if then is _nothing or then is KILLED else 1.0
    return lambda rng: Fault(
        strike=strike, heal=release, client_lives=then is not KILLED, limit_s=limit_s, **known
    )


KILLED, ENDED, INTERRUPTED = (
    _signalled("client", *numbers, wait_s=0.15)
    for numbers in ((KILL,), (TERM,), (INTERRUPT, INTERRUPT))
)
ENDED_LATER, INTERRUPTED_LATER = (
    _signalled("client", *numbers, wait_s=0.8) for numbers in ((TERM,), (INTERRUPT, INTERRUPT))
)
"""By then the main thread waits for what hangs."""

DISK: tuple[Act, Act] = (
    lambda rig, client: client.disk.begin(),
    lambda rig, client: client.disk.end(),
)
CAMERA: tuple[Act, Act] = (
    lambda rig, client: client.camera.begin(),
    lambda rig, client: client.camera.end(),
)
LOG: tuple[Act, Act] = (
    lambda rig, client: rig.block_log(True),
    lambda rig, client: rig.block_log(False),
)
LEDGER: tuple[Act, Act] = (
    lambda rig, client: rig.lock_ledger(True),
    lambda rig, client: rig.lock_ledger(False),
)
TERMINAL: tuple[Act, Act] = (
    lambda rig, client: client.terminal.stop(),
    lambda rig, client: client.terminal.go_on(),
)


def _fill_disk(full: bool) -> Act:
    """No file of client or server grows any more, which is what a full disk does to them; or they
    grow again.
    """

    def fill(rig: CampaignRig, client: Client) -> None:
        for pid in (client.pid if client.exit_code() is None else None, rig.server()):
            if pid is not None:
                hard = resource.prlimit(pid, resource.RLIMIT_FSIZE)[1]
                resource.prlimit(pid, resource.RLIMIT_FSIZE, (0 if full else hard, hard))

    return fill


FULL: tuple[Act, Act] = (_fill_disk(True), _fill_disk(False))


def _light_below_the_top_code(rng: np.random.Generator) -> Fault:
    """Room light on a camera that clips below its top code."""

    def strike(rig: CampaignRig, client: Client) -> None:
        rig.provoke("camera", Faults(ceiling_dn=ceiling_dn))
        rig.provoke("surroundings", Faults(room_light_lux=ROOM_LUX))

    def heal(rig: CampaignRig, client: Client) -> None:
        for place in ("camera", "surroundings"):
            rig.provoke(place, Faults())

    ceiling_dn = int(rng.integers(220, 255))
    return Fault(strike=strike, heal=heal, since="saturation", ends_run=True)


def _journal_lost(*, is_cut: bool) -> Draw:
    """Draw a journal that somebody removes or cuts while its stack grows."""

    def strike(rig: CampaignRig, client: Client) -> float:
        sizes: dict[Path, int] = {}
        until_s = time.monotonic() + 5.0
        while time.monotonic() < until_s:
            for path in client.session.glob(f"frames/*.zarr/{JOURNAL}"):
                size = path.stat().st_size
                if size > sizes.setdefault(path, size):
                    os.truncate(path, size // 2) if is_cut else path.unlink()
                    return time.monotonic()
            time.sleep(0.001)
        return time.monotonic()

    return lambda rng: Fault(strike=strike, ends_run=True, limit_s=2.0)


def _prompt(rng: np.random.Generator) -> Fault:
    """A person at the bench takes their time: until then gate or voltage are down, and nothing is
    held against them.
    """

    def wait(rig: CampaignRig, client: Client) -> float:
        client.await_prompt(10.0)
        return time.monotonic()

    def answer(rig: CampaignRig, client: Client) -> None:
        for _ in range(2):
            client.answer(f"{LUX:g}")

    return Fault(
        strike=wait,
        heal=answer,
        lasts_s=PROMPTED_S,
        passes=True,
        one_suffices=True,
        prompts=True,
        ready=lambda out: True,
    )


KILL_CLIENT = "client killed"
KINDS: dict[str, Draw] = {
    "garbage": _on_a_line(lambda rng: Faults(garbage=True)),
    "half lines": _on_a_line(lambda rng: Faults(half_lines=True)),
    "silence": _on_a_line(lambda rng: Faults(silent=True), hears=False),
    "no answers": _on_a_line(lambda rng: Faults(mute=True)),
    # An answer within 0.4 s is in time, one after it is none; between the two, chance would decide
    # when a run ends.
    "late answers": _on_a_line(lambda rng: Faults(late_s=float(rng.choice((0.1, 0.2, 0.5, 0.8))))),
    "trip of the supply": _trip,
    "power of an instrument gone": _power_cut(back=False),
    "power of an instrument off and on": _power_cut(back=True),
    # The tube stays as planned: a run ends only when more frames are broken than a camera may send.
    "packet loss": _seen(
        lambda rng: Faults(lost_packet_share=float(rng.uniform(0.02, 0.3))), limit_s=5.0
    ),
    "camera stalls": _seen(lambda rng: Faults(stalled=True), silence_s=SILENCE_S, ends_run=True),
    "pictures come again": _seen(
        lambda rng: Faults(repeated_pictures=int(rng.integers(1, 9))), ends_run=True
    ),
    "clocks jump": _clock_jump,
    KILL_CLIENT: _struck("client", KILL),
    "client stopped": _struck("client", STOP),
    "client: SIGTERM": _struck("client", TERM),
    "client: second Ctrl-C": _struck("client", INTERRUPT, INTERRUPT),
    "client killed, voltage rising": lambda rng: replace(
        _struck("client", KILL)(rng), ready=_voltage_rises, latest_s=0.0
    ),
    "client killed, supply silent": lambda rng: _provoked(
        SUPPLY,
        Faults(silent=True),
        and_then=KILLED,
        passes=True,
        lasts_s=1.5,
        deaf=(SUPPLY,),
        returns=True,
        client_lives=False,
    ),
    "server killed": _struck("server", KILL),
    "server: SIGTERM": _struck("server", TERM),
    "server stopped": _struck("server", STOP),
    "room light": lambda rng: _provoked(
        "surroundings", Faults(room_light_lux=ROOM_LUX), since="saturation", ends_run=True
    ),
    "port gone for 0.3 s": _line_lost(None),
    "port under another name for 2 s": _line_lost("renamed"),
    "panel: gate idles open": _panel(GATE, "LOFF 1,2"),
    "panel: gate stopped": _panel(GATE, "TSRC 5"),
    "panel: burst": _panel(GATE, "BURM 1"),
    "panel: gate of 1 us": _panel(GATE, "DLAY 3,2,1e-6"),
    "panel: 100 V": _panel(SUPPLY, "VSET 100"),
    "panel: 850 V": _panel(SUPPLY, "VLIM 900", "VSET 850"),
    "panel: high voltage on": _panel(
        SUPPLY, "VSET 650", "HVON", plan=_with_a_step_without_voltage, ready=_without_voltage
    ),
    "no triggers at the input": lambda rng: _provoked(
        GATE, Faults(untriggered=True), plan=_triggered, ends_run=True
    ),
    "gate does not obey": _disobedient(GATE),
    "supply does not obey": _disobedient(SUPPLY),
    **{
        f"{who} without {of}, {'server' if who == 'client' else 'client'} killed": _starved(who, of)
        for who in ("client", "server")
        for of in ("descriptors", "threads", "memory")
    },
    "session disk hangs": _blocked(*DISK, since="strike"),
    "session disk hangs, SIGTERM": _blocked(*DISK, ENDED_LATER),
    "session disk hangs, second Ctrl-C": _blocked(*DISK, INTERRUPTED_LATER),
    "session disk hangs, server killed": _blocked(*DISK, _signalled("server", KILL, wait_s=0.8)),
    "main thread hangs": _blocked(*CAMERA, since="strike", ends_run=True),
    "main thread hangs, SIGTERM": _blocked(*CAMERA, ENDED),
    "main thread hangs, second Ctrl-C": _blocked(*CAMERA, INTERRUPTED),
    "log blocks": _blocked(*LOG, pipes_log=True),
    "log blocks, client killed": _blocked(*LOG, KILLED, pipes_log=True),
    "dose ledger locked": _blocked(*LEDGER),
    "dose ledger locked, SIGTERM": _blocked(*LEDGER, ENDED),
    "dose ledger locked, client killed": _blocked(*LEDGER, KILLED),
    "disk full": _blocked(*FULL, since="strike", ends_run=True, log_lives=False),
    "disk full, client killed": _blocked(*FULL, KILLED, log_lives=False),
    "terminal blocks": _blocked(*TERMINAL, terminal_lives=False),
    "terminal blocks, SIGTERM": _blocked(*TERMINAL, ENDED, terminal_lives=False),
    "a person takes 3 s at the prompt": _prompt,
    "room light below the top code": _light_below_the_top_code,
    "journal of frames removed": _journal_lost(is_cut=False),
    "journal of frames cut": _journal_lost(is_cut=True),
    # The last: a camera takes seconds to come up, or minutes where another bench on the machine
    # took its wire.
    "camera gone": _camera_gone,
}
"""Every fault by its kind."""


def draw_fault(kind: str, rng: np.random.Generator) -> Fault:
    """Draw one fault of a kind: which instrument it strikes, how hard and how long."""
    return KINDS[kind](rng)
