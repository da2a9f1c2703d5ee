"""One strike of some faults: what `make study NAME=fault-campaign` does with every fault, five
times each.
"""

import numpy as np
import pytest

from benchmarks.studies.faults.campaign.kinds import KINDS, draw_fault
from benchmarks.studies.faults.campaign.page import Row, page
from benchmarks.studies.faults.campaign.rig import CampaignRig
from benchmarks.studies.faults.campaign.trial import Outcome, end_of, resume, try_fault, warm_up
from simulate.virtual_bench import aravis_library

SEED = 4
AFTER_S = 0.4


def wired(test):
    """Mark a test that needs the whole virtual bench on its wires."""
    missing = not aravis_library.is_available()
    test = pytest.mark.skipif(missing, reason="the Aravis library is not on this machine")(test)
    return pytest.mark.wires(pytest.mark.aravis(test))


ENDS = {
    "silence": "must answer",
    "no answers": "must answer",
    "late answers": "must answer",
    "power of an instrument gone": "must stay on",
    "trip of the supply": "the high-voltage supply must stay on",
    "camera stalls": "has sent no frame for",
    "pictures come again": "a new picture under each number",
    "client killed": "SIGKILL",
    "client stopped": "SIGKILL",
    "client killed, supply silent": "SIGKILL",
    "client killed, voltage rising": "SIGKILL",
    "server killed": "the bench server has ended",
    "server stopped": "the bench server was silent",
    "server: SIGTERM": "",
    "room light": "pixels",
    "port gone for 0.3 s": "must stay on",
    "panel: gate idles open": "must keep its idle level",
    "panel: 850 V": "as set",
    "client without descriptors, server killed": "",
    "server without threads, client killed": "SIGKILL",
    "session disk hangs, server killed": "",
    "session disk hangs, SIGTERM": "143",
    "main thread hangs": "must show life",
    "main thread hangs, second Ctrl-C": "",
    "log blocks, client killed": "SIGKILL",
    "terminal blocks": "",
    # The last, for the next camera takes seconds to draw its first frame.
    "camera gone": "camera",
}
"""Kinds that are tried, and what the sentence must hold with which the run ends."""


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    """A virtual bench on which a plan has run, so that all is compiled."""
    folder = tmp_path_factory.mktemp("campaign")
    with CampaignRig(folder, SEED) as rig:
        warm_up(rig, folder / "struck-0")
        yield rig


def strike(rig: CampaignRig, kind: str) -> Outcome:
    """Strike the last session, or a new one where that is complete."""
    fault, ends = draw_fault(kind, np.random.default_rng(SEED)), []
    for _ in range(2):
        session = rig.folder / f"struck-{len(list(rig.folder.glob('struck-*'))) - 1}"
        after_s = min(AFTER_S, fault.latest_s)
        if (
            outcome := try_fault(rig, rig.plan(), session, kind, fault, after_s=after_s)
        ) is not None:
            return outcome
        ends.append(end_of(session))
        session.with_name(f"struck-{len(list(rig.folder.glob('struck-*')))}").mkdir()
    raise AssertionError(f"{kind} must strike, got two runs that ended before: {ends}")


@wired
@pytest.mark.parametrize("kind", ENDS)
def test_a_fault_ends_the_run_in_a_sentence_with_the_tube_safe_in_time(rig, kind):
    outcome = strike(rig, kind)
    assert outcome.live, "it struck while the tube was on"
    assert outcome.broken == ()
    assert outcome.found >= outcome.acknowledged
    assert outcome.endured or ENDS[kind] in outcome.sentence
    assert "\n" not in outcome.sentence


STARVED = (
    "must show life",
    "was silent",
    "has sent no frame",
    "must take a frame",
    "must answer within",
)
"""How a run ends, the tube safe, on a machine that other work starves: it is resumed once more."""


@wired
def test_a_run_that_is_left_alone_completes_what_was_struck(rig):
    for session in rig.folder.glob("struck-*"):
        wrong = resume(rig, rig.plan(), session)
        if any(end in sentence for end in STARVED for sentence in wrong):
            wrong = resume(rig, rig.plan(), session)
        assert wrong == [], session.name


def test_every_fault_of_the_campaign_can_be_drawn_and_has_a_limit():
    for kind in KINDS:
        fault = draw_fault(kind, np.random.default_rng(SEED))
        # Lost packets leave the tube as planned: they end a run only once more frames are broken
        # than may be.
        assert 0.0 < fault.limit_s <= (5.0 if kind == "packet loss" else 2.0), kind


def test_the_page_shows_median_and_worst_and_what_broke():
    safe = {
        "kind": "silence",
        "live": True,
        "limit_s": 1.0,
        "last_words": "",
        "acknowledged": 3,
        "found": 3,
    }
    outcomes = (
        Outcome(
            gate_s=None, voltage_s=0.4, endured=False, sentence="it was silent", broken=(), **safe
        ),
        Outcome(
            gate_s=0.2,
            voltage_s=0.3,
            endured=False,
            sentence="it was silent",
            broken=("too late",),
            **safe,
        ),
        Outcome(gate_s=None, voltage_s=None, endured=True, sentence="complete", broken=(), **safe),
    )
    row = Row(kind="silence", outcomes=outcomes, resumed=((), ("a frame is lost",)))
    assert (
        "| silence | 3 | 1 | 200 / 200 | 350 / 400 | 1000 | it was silent | 9 / 9 | 1 of 2 |"
        in page([row], "")
    )
    assert row.broken == ("too late", "resumed: a frame is lost")
