"""A few of the campaign's trials with the instrument chosen: what `make fault-campaign` draws three hundred times."""

import numpy as np
import pytest

from drivers.acquisition.acquire import LOG
from labdata.event_log import read_events
from labdata.sensors import save_sensor
from simulate.rig import aravis_library
from simulate.rig.faults import Faults
from tests.faults.campaign.kinds import KILL, SILENCE_S, Fault, draw_fault
from tests.faults.campaign.plan import small_plan
from tests.faults.campaign.rig import CampaignRig
from tests.faults.campaign.sessions import COMPLETE_S, WITHIN_S, campaign, undisturbed, warm_up
from tests.faults.campaign.tally import table
from tests.faults.campaign.trial import Outcome, try_fault

SEED = 4
WIRED = [
    pytest.mark.wires,
    pytest.mark.aravis,
    pytest.mark.skipif(not aravis_library.is_available(), reason="the Aravis library is not on this machine"),
]


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    """A virtual bench, its plan and a folder for sessions."""
    folder = tmp_path_factory.mktemp("campaign")
    with CampaignRig(folder, SEED) as rig:
        save_sensor(rig.sensor, folder / "sensor.toml")
        plan = small_plan(folder / "sensor.toml", SEED)
        warm_up(rig, plan, folder / "warm")
        yield rig, plan, folder


def _spoken(instrument: str, wrong: Faults, **known) -> Fault:
    return Fault(
        kind=instrument,
        strike=lambda rig, client: rig.provoke(instrument, wrong),
        heal=lambda rig, client: rig.provoke(instrument, Faults()),
        hold_s=1.0,
        **known,
    )


CAMERA_GONE = Fault(
    kind="camera",
    strike=lambda rig, client: rig.unplug("camera"),
    heal=lambda rig, client: rig.plug_in("camera"),
    hold_s=1.0,
)
CAMERA_STALLED = _spoken("camera", Faults(stalled=True), silence_s=SILENCE_S, shows_in_frames=True)
GATE_SILENT = _spoken("delay_generator", Faults(silent=True), gate_hears=False)
SUPPLY_SILENT = _spoken("high_voltage", Faults(silent=True), supply_hears=False)
TRIPPED = draw_fault("trip of the supply", np.random.default_rng(SEED))


@pytest.mark.parametrize(
    ("fault", "sentence"),
    [
        pytest.param(CAMERA_STALLED, "has sent no frame for", marks=WIRED, id="camera stalled"),
        pytest.param(GATE_SILENT, "the delay generator must answer", marks=WIRED, id="gate silent"),
        pytest.param(SUPPLY_SILENT, "the high-voltage supply must answer", marks=WIRED, id="supply silent"),
        pytest.param(TRIPPED, "the high-voltage supply must stay on", marks=WIRED, id="supply tripped"),
        # The last, for the next camera takes seconds to draw its first frame.
        pytest.param(CAMERA_GONE, "camera", marks=WIRED, id="camera gone"),
    ],
)
def test_a_fault_in_mid_run_ends_in_one_sentence_with_the_tube_safe_and_resume_completes(bench, fault, sentence):
    rig, plan, folder = bench
    session = folder / sentence.replace(" ", "-")
    outcome = try_fault(rig, plan, session, fault, after_s=0.6, within_s=WITHIN_S)
    assert outcome is not None and outcome.live, "it struck while the tube was on"
    assert outcome.broken == ()
    last = read_events(session / LOG)[-1]
    assert last["event"] == "run ends" and sentence in last["reason"] and "\n" not in last["reason"]
    assert undisturbed(rig, plan, session, silence_s=COMPLETE_S) == []


@pytest.mark.parametrize("seed", [pytest.param(SEED, marks=WIRED)])
def test_a_kill_and_what_the_dice_say_break_no_promise(bench, seed):
    rig, plan, folder = bench
    outcomes, completed, failed = campaign(rig, plan, folder / "dice", [KILL, "garbage"], np.random.default_rng(seed))
    assert [outcome.broken for outcome in outcomes] == [()] * 2
    assert completed and not failed


def test_the_tally_counts_each_kind_and_all():
    safe = {"endured": False, "live": True, "broken": ()}
    outcomes = [
        Outcome(kind="silence", gate_s=None, off_s=0.4, **safe),
        Outcome(kind="silence", gate_s=0.2, off_s=0.3, **safe),
        Outcome(kind="garbage", gate_s=None, off_s=None, endured=True, live=False, broken=("a frame was lost",)),
    ]
    assert table(outcomes).splitlines()[2:] == [
        "| garbage | 1 | 0 | 1 | - | - | 1 |",
        "| silence | 2 | 2 | 0 | 0.20 s of 1 | 0.40 s of 2 | 0 |",
        "| all | 3 | 2 | 1 | 0.20 s of 1 | 0.40 s of 2 | 1 |",
    ]
