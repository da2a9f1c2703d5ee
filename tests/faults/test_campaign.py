"""One strike of some faults: what `make fault-campaign` does with every fault, five times each."""

import numpy as np
import pytest

from simulate.rig import aravis_library
from tests.faults.campaign.kinds import KINDS, draw_fault
from tests.faults.campaign.page import Row, page
from tests.faults.campaign.rig import CampaignRig
from tests.faults.campaign.trial import Outcome, resume, try_fault, warm_up

SEED = 4
AFTER_S = 0.4
WIRED = [
    pytest.mark.wires,
    pytest.mark.aravis,
    pytest.mark.skipif(not aravis_library.is_available(), reason="the Aravis library is not on this machine"),
]
ENDS = {
    "silence": "must answer",
    "trip of the supply": "the high-voltage supply must stay on",
    "camera stalls": "has sent no frame for",
    "client killed": "SIGKILL",
    "client stopped": "SIGKILL",
    "client killed, supply silent": "SIGKILL",
    "client killed, voltage rising": "SIGKILL",
    "server killed": "the bench server has ended",
    "server stopped": "the bench server was silent",
    "server: SIGTERM": "",
    "room light": "saturated",
    "port gone for 0.3 s": "must stay on",
    "panel: gate idles open": "as set",
    "panel: 850 V": "as set",
    "client without descriptors, server killed": "",
    "server without threads, client killed": "SIGKILL",
    "session disk hangs, server killed": "",
    "session disk hangs, SIGTERM": "143",
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
        warm_up(rig, folder / "warm")
        yield rig


@pytest.mark.parametrize("kind", [pytest.param(kind, marks=WIRED, id=kind) for kind in ENDS])
def test_a_fault_ends_the_run_in_a_sentence_with_the_tube_safe_in_time_and_resume_completes_it(rig, kind):
    fault = draw_fault(kind, np.random.default_rng(SEED))
    session, plan = rig.folder / kind.replace(" ", "-"), fault.plan(rig.plan())
    outcome = try_fault(rig, plan, session, kind, fault, after_s=min(AFTER_S, fault.latest_s))
    assert outcome is not None and outcome.live, "it struck while the tube was on"
    assert outcome.broken == ()
    assert outcome.found >= outcome.acknowledged
    assert outcome.endured or ENDS[kind] in outcome.sentence
    assert "\n" not in outcome.sentence
    assert resume(rig, plan, session) == []


def test_every_fault_of_the_campaign_can_be_drawn_and_has_a_limit():
    for kind in KINDS:
        fault = draw_fault(kind, np.random.default_rng(SEED))
        assert 0.0 < fault.limit_s <= 2.0, kind


def test_the_page_shows_median_and_worst_and_what_broke():
    safe = {"kind": "silence", "live": True, "limit_s": 1.0, "last_words": "", "acknowledged": 3, "found": 3}
    outcomes = (
        Outcome(gate_s=None, voltage_s=0.4, endured=False, sentence="it was silent", broken=(), **safe),
        Outcome(gate_s=0.2, voltage_s=0.3, endured=False, sentence="it was silent", broken=("too late",), **safe),
        Outcome(gate_s=None, voltage_s=None, endured=True, sentence="complete", broken=(), **safe),
    )
    row = Row(kind="silence", outcomes=outcomes, resumed=((), ("a frame is lost",)))
    assert "| silence | 3 | 1 | 200 / 200 | 350 / 400 | 1000 | it was silent | 9 / 9 | 1 of 2 |" in page([row], "")
    assert row.broken == ("too late", "resumed: a frame is lost")
