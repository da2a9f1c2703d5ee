"""One strike: a fault at a random moment of a running plan, and what became of tube, frames and the
run's words.
"""

import signal
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.studies.faults.campaign.client import LAST_WORDS, Client
from benchmarks.studies.faults.campaign.kinds import PATIENT_S, Fault
from benchmarks.studies.faults.campaign.rig import DANGEROUS_V, FRAMES, GATE, SUPPLY, CampaignRig
from drivers.acquisition.acquire import LOG
from labdata import BadInput, Plan, open_session, read_events

LOOK_S = 0.004
OPEN_S = 20.0
END_S = 20.0
COMPLETE_S = 90.0
WARM_UPS = 4
REST_S = 0.1
BEYOND_S = 0.3
SAME_SIGNAL = 0.5
"""Frames of one flat whose mean signals differ by a larger fraction of their median do not show one
light."""

MARKS = {"frames": "asked", "saturation": "saturated", "progress": "frame"}
"""What a client marks when the events come from which the times of faults count."""


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What a strike showed.

    Parameters
    ----------
    kind
        Kind of the fault.
    endured
        The run went on to its end all the same.
    live
        Whether gate or high voltage were on when the fault struck.
    gate_s, voltage_s
        Seconds, counted as the fault says, until the gate was last seen open and the voltage last
        seen not falling; None where there is nothing to time: nothing was on, the run endured, or
        the instrument could not hear.
    limit_s
        Longest time promised, s.
    sentence
        How the run ended, by the session's log, or by its terminal where that does not say.
    last_words
        What the terminal says last of how the tube was left; its last line where it says nothing of
        that.
    acknowledged, found
        Frames of which the client was told, and how many of these are in the session whole and
        unchanged.
    broken
        Each promise that was broken, in words.
    """

    kind: str
    endured: bool
    live: bool
    gate_s: float | None
    voltage_s: float | None
    limit_s: float
    sentence: str
    last_words: str
    acknowledged: int
    found: int
    broken: tuple[str, ...]


def try_fault(
    rig: CampaignRig, plan: Plan, session: Path, kind: str, fault: Fault, *, after_s: float
) -> Outcome | None:
    """Run a plan, or go on with it, and have a fault strike at a moment; None if the run had ended
    before.

    Parameters
    ----------
    rig, plan, session
        The bench, the fault's plan and its session.
    kind, fault
        What goes wrong.
    after_s
        When: seconds after the first step began and as soon as the tube is ready for the fault, or,
        negative, before that, in whatever state it is, while bench and camera are opened.
    """
    if fault.pipes_log:
        rig.begin_log_pipe()
    client = Client(rig, plan, session, silence_s=fault.silence_s, prompts=fault.prompts)
    try:
        if not _await_moment(rig, client, fault, after_s):
            rig.await_free()
            return None
        watch = _Watch(rig, client, fault)
        watch.follow()
        code = client.wait(END_S)
        if code is None:
            client.signal(signal.SIGKILL)
            client.wait(END_S)
        freed = rig.await_free()
        left_on = tuple(_left_on(rig, fault))
        rig.heal()
        fault.repair(rig)
        rig.switch_off_what_is_on()
        return _outcome(client, session, kind, fault, watch, code, (*left_on, *_not_freed(freed)))
    finally:
        client.close()
        rig.end_log_pipe()


def _await_moment(rig: CampaignRig, client: Client, fault: Fault, after_s: float) -> bool:
    """Wait for the moment of the strike; whether the run still goes on then."""
    if after_s < 0.0:
        return client.wait(-after_s) is None
    client.await_steps(OPEN_S)
    if client.wait(after_s) is not None:
        return False
    while not fault.ready(rig.outputs()):
        if client.exit_code() is not None:
            return False
        client.listen()
        time.sleep(0.001)
    return True


class _Watch:
    """The strike, and the outputs of the instruments from then on, as they are on the tube's
    wires.
    """

    def __init__(self, rig: CampaignRig, client: Client, fault: Fault) -> None:
        self._rig, self._client, self._fault = rig, client, fault
        before = rig.outputs()
        self.gate_was_open, self.voltage_was_on = before.gate_open, before.mcp_v > DANGEROUS_V
        self.struck_s = time.monotonic()
        counted_s = fault.strike(rig, client)
        self.since_s = counted_s if isinstance(counted_s, float) else self.struck_s
        self.healed_s = self.since_s
        self._open_s = self._high_s = -np.inf
        self._volts = 0.0

    @property
    def live(self) -> bool:
        """Whether gate or voltage were on when the fault struck."""
        return self.gate_was_open or self.voltage_was_on

    def follow(self) -> None:
        """Look until the tube is at rest, or the fault and its limit are over; heal it."""
        fault, healed = self._fault, False
        heals_s = self.since_s + fault.lasts_s
        until_s = max(heals_s, self.since_s + fault.limit_s + BEYOND_S)
        hot_s = time.monotonic()
        while True:
            now_s = time.monotonic()
            if self._look(now_s):
                hot_s = now_s
            if fault.since == "saturation" and not self._marks_s() and now_s < self.since_s + END_S:
                # Beside a busy machine the first frame that shows the light may come late; the
                # light stays until then.
                heals_s = now_s + fault.lasts_s
                until_s = max(until_s, heals_s)
            at_rest = now_s > hot_s + REST_S
            over = at_rest and (self.live or self._client.exit_code() is not None)
            if not healed and (now_s > heals_s or (over and not fault.passes)):
                fault.heal(self._rig, self._client)
                healed, self.healed_s = True, now_s
                if fault.returns:
                    until_s = now_s + fault.limit_s + BEYOND_S
            if healed and (at_rest or now_s > until_s or fault.one_suffices):
                return
            self._client.listen()
            time.sleep(LOOK_S)

    def _look(self, now_s: float) -> bool:
        """Whether gate or voltage are on now."""
        now = self._rig.outputs()
        if now.gate_open:
            self._open_s = now_s
        if now.mcp_v > DANGEROUS_V and now.mcp_v >= self._volts - 0.5:
            self._volts, self._high_s = now.mcp_v, now_s
        elif now.mcp_v <= DANGEROUS_V:
            self._volts = 0.0
        return now.gate_open or now.mcp_v > DANGEROUS_V

    def _marks_s(self) -> list[float]:
        """Times after the strike of the marks from which the fault counts."""
        return [
            at_s for at_s in self._client.marks_s(MARKS[self._fault.since]) if at_s > self.since_s
        ]

    def _counted_s(self, last_s: float) -> float:
        """The moment from which the time until an output was last on counts."""
        since = self._fault.since
        if since == "strike":
            return self.since_s
        marks_s = self._marks_s()
        if since == "progress":
            return max((at_s for at_s in marks_s if at_s < last_s), default=self.since_s)
        return min(marks_s, default=self.since_s)

    def seconds(self, instrument: str) -> float | None:
        """Time until an instrument's output was off; None where it was not on, or could not
        hear.
        """
        was_on, last_s = (
            (self.gate_was_open, self._open_s)
            if instrument == GATE
            else (self.voltage_was_on, self._high_s)
        )
        since_s = self._counted_s(last_s)
        if instrument in self._fault.deaf:
            if not self._fault.returns:
                return None
            since_s = self.healed_s
        if not was_on and last_s < since_s:
            return None
        return max(0.0, last_s - since_s)


def _outcome(
    client: Client,
    session: Path,
    kind: str,
    fault: Fault,
    watch: _Watch,
    code: int | None,
    left: tuple[str, ...],
) -> Outcome:
    endured, live = code == 0, watch.live
    timed = live and (not endured or not fault.passes or fault.one_suffices)
    gate_s, voltage_s = (watch.seconds(one) if timed else None for one in (GATE, SUPPLY))
    acknowledged = client.acknowledged()
    found, wrong = frames_found(session, acknowledged)
    lines = client.told()
    return Outcome(
        kind=kind,
        endured=endured,
        live=live,
        gate_s=gate_s,
        voltage_s=voltage_s,
        limit_s=fault.limit_s,
        sentence=end_of(session, lines, code),
        last_words=next(
            (line for line in reversed(lines) if line.startswith(LAST_WORDS)), "".join(lines[-1:])
        ),
        acknowledged=sum(acknowledged.values()),
        found=found,
        broken=(
            *left,
            *_too_late(fault, gate_s, voltage_s),
            *_badly_ended(client, fault, code, live=live),
            *wrong,
            *_log_broken(session, fault, code),
        ),
    )


def _left_on(rig: CampaignRig, fault: Fault) -> Iterator[str]:
    """What is still on when the last process that guarded the tube has ended, though it could
    hear.
    """
    left = rig.outputs()
    if left.gate_open and (GATE not in fault.deaf or fault.returns):
        yield "the gate was left open"
    if left.mcp_v > DANGEROUS_V and (SUPPLY not in fault.deaf or fault.returns):
        yield f"{left.mcp_v:.0f} V were left on"


def _not_freed(freed: bool) -> Iterator[str]:
    if not freed:
        yield "the bench server did not end"


def _too_late(fault: Fault, gate_s: float | None, voltage_s: float | None) -> Iterator[str]:
    late = [
        f"{what} for {seconds:.2f} s"
        for what, seconds in (
            ("the gate was open", gate_s),
            ("the voltage did not fall", voltage_s),
        )
        if seconds is not None and seconds > fault.limit_s
    ]
    if len(late) > fault.one_suffices:
        yield from late


def _badly_ended(client: Client, fault: Fault, code: int | None, *, live: bool) -> Iterator[str]:
    if code is None:
        yield f"the client did not end within {END_S:g} s"
    if fault.client_lives and (
        code == 3 or any(line.startswith(("Traceback", "TRACEBACK")) for line in client.told())
    ):
        yield f"the client ended in a traceback: {client.told()[-1:]}"
    if code and fault.one_suffices:
        yield "the run did not go on"
    if code == 0 and fault.ends_run and live:
        yield "the run ended as if nothing had happened"
    silent = not any(line.startswith(LAST_WORDS) for line in client.told())
    if live and code is not None and fault.client_lives and fault.terminal_lives and silent:
        yield "the terminal does not say how the tube was left"


def end_of(session: Path, lines: Sequence[str] = (), code: int | None = None) -> str:
    """Return how the last run of a session ended: by its log, else by the client's exit code or
    last line.
    """
    run = _last_run(session)
    if run and run[-1]["event"] == "run ends":
        return "complete" if run[-1]["whole"] else run[-1]["reason"]
    if code is not None and code < 0:
        return f"(ended by {signal.Signals(-code).name})"
    return "".join(lines[-1:])


def _last_run(session: Path) -> list[dict]:
    """Events of the last run, as the session's log tells them."""
    if not (session / LOG).exists():
        return []
    told = read_events(session / LOG)
    begins = [number for number, each in enumerate(told) if each["event"] == "run begins"]
    return told[begins[-1] :] if begins else []


def frames_found(session: Path, acknowledged: dict[str, int]) -> tuple[int, list[str]]:
    """Return how many acknowledged frames are whole in the session, by their digests, and what is
    wrong with them.
    """
    found, wrong = 0, []
    for label, count in acknowledged.items():
        if not count:
            continue
        try:
            frames = open_session(session).stack(label).read().data
        except (KeyError, OSError, BadInput) as error:
            wrong.append(f"acknowledged frames of {label} are lost or torn: {error}")
            continue
        found += min(count, len(frames))
        if len(frames) < count:
            wrong.append(f"{count} frames of {label} were acknowledged, {len(frames)} are there")
        if len({frame.tobytes() for frame in frames}) < len(frames):
            wrong.append(f"a frame of {label} is there twice")
    return found, wrong


def _log_broken(session: Path, fault: Fault, code: int | None) -> Iterator[str]:
    """What the session's log does not tell."""
    run = _last_run(session)
    if not run or not fault.log_lives:
        return
    ended = [each for each in run if each["event"] == "run ends"]
    if code is not None and code >= 0:
        if not ended:
            yield "the log does not tell how the run ended"
        elif ended[0]["whole"] != (code == 0):
            yield "the log tells another end than the client"
        elif code == 1 and not ended[0]["reason"]:
            yield "the log gives no reason"
    elif ended and fault.client_lives:
        yield "the log tells the end of a run that was killed"


def resume(
    rig: CampaignRig, plan: Plan, session: Path, *, silence_s: float = PATIENT_S
) -> list[str]:
    """Resume a session without a fault, which must complete it; what is wrong with it then."""
    rig.heal()
    client = Client(rig, plan, session, silence_s=silence_s)
    code = client.wait(COMPLETE_S)
    if code is None:
        client.signal(signal.SIGKILL)
        client.wait(COMPLETE_S)
    rig.await_free()
    words = client.told()
    client.close()
    if code != 0:
        return [f"the resumed run ended with {code}: {end_of(session, words, code)}"]
    stacks = {entry.label: entry for entry in open_session(session).stacks}
    counts = {step.label: step.frames for step in plan.steps}
    wrong = [
        f"{label} holds other than {count} frames or is not finished"
        for label, count in counts.items()
        if label not in stacks or not stacks[label].finished or len(stacks[label].read()) != count
    ]
    return [*wrong, *frames_found(session, counts)[1], *_untrue(session, plan)]


def warm_up(rig: CampaignRig, session: Path) -> None:
    """Run the plan until it completes: where the simulator is compiled first, a frame takes half a
    minute.
    """
    wrong: Sequence[str] = ()
    for _ in range(WARM_UPS):
        if not (wrong := resume(rig, rig.plan(), session, silence_s=COMPLETE_S)):
            return
    raise RuntimeError(f"a run without faults must complete, got {wrong}")


def _untrue(session: Path, plan: Plan) -> Iterator[str]:
    """Flats whose frames do not show one light: some were taken while the tube was in another
    state.
    """
    stacks = {entry.label: entry.read().data for entry in open_session(session).stacks}
    black_dn = float(np.median(stacks["dark"].mean(axis=(1, 2))))
    for label in (step.label for step in plan.steps if step.kind == "flat"):
        signals_dn = stacks[label].mean(axis=(1, 2)) - black_dn
        middle_dn = float(np.median(signals_dn))
        if apart := int(np.count_nonzero(abs(signals_dn - middle_dn) > SAME_SIGNAL * middle_dn)):
            yield f"{apart} of {FRAMES} frames of {label} do not show the light of the others"
