"""A handful of the campaign's trials: what `make fault-campaign` does three hundred times."""

import pytest

from simulate.rig import aravis_library
from tests.faults.campaign.__main__ import campaign
from tests.faults.campaign.tally import table
from tests.faults.campaign.trial import Outcome

SEED = 4


@pytest.mark.wires
@pytest.mark.aravis
@pytest.mark.skipif(not aravis_library.is_available(), reason="the Aravis library is not on this machine")
def test_faults_and_kills_at_random_moments_break_no_promise(tmp_path):
    outcomes, completed, failed = campaign(tmp_path, faults=2, kills=1, seed=SEED)
    assert [outcome.broken for outcome in outcomes] == [()] * 3
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
