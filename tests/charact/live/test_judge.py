"""The judge of an acquisition: a mean's interval holds what it promises, and saturated pixels are
counted, all.
"""

import numpy as np

from charact.live import SaturationJudge, half_interval_dn
from labdata import Conditions, Step, StopCriterion

SHAPE = (20, 30)


def watched(means_dn, *, until=None, kind="flat", frames=1000):
    step = Step(
        label="a",
        kind=kind,
        frames=frames,
        conditions=Conditions(illuminance_lux=1e-4),
        until=until,
    )
    watcher = SaturationJudge().watch(step, 4095.0)
    for taken, mean_dn in enumerate(means_dn, 1):
        watcher.see(np.full(SHAPE, mean_dn))
        if why := watcher.enough():
            return taken, why, watcher
    return len(means_dn), None, watcher


def test_the_interval_of_a_mean_holds_it_as_often_as_it_says(seed):
    rng = np.random.default_rng(seed)
    held = [abs(rest.mean()) <= half_interval_dn(rest) for rest in rng.standard_normal((2000, 30))]
    # 95 % of 2000 draws less three standard errors of that count.
    assert np.mean(held) > 0.95 - 3 * np.sqrt(0.95 * 0.05 / 2000)


def test_a_level_that_drifts_or_lags_is_known_less_well_than_white_noise(seed):
    rng = np.random.default_rng(seed)
    white = rng.standard_normal(200)
    lagging = np.convolve(white, 0.8 ** np.arange(20), "same")
    lagging *= white.std() / lagging.std()
    assert half_interval_dn(lagging) > 1.5 * half_interval_dn(white)
    assert half_interval_dn(np.linspace(-1.0, 1.0, 200)) > 3 * np.linspace(
        -1.0, 1.0, 200
    ).std() / np.sqrt(200)


def test_levels_that_were_stopped_early_are_as_near_the_truth_as_was_asked(seed):
    rng = np.random.default_rng(seed)
    within_dn, truth_dn, errors, taken = 0.3, 800.0, [], []
    for _ in range(300):
        means_dn = truth_dn + rng.standard_normal(400)
        frames, why, _ = watched(means_dn, until=StopCriterion(mean_within_dn=within_dn))
        assert why is not None
        taken.append(frames)
        errors.append(abs(means_dn[:frames].mean() - truth_dn))
    # Looking several times costs a little of the 95 %: 90 % is what is asked here.
    assert np.mean(np.array(errors) <= within_dn) > 0.90 - 3 * np.sqrt(0.9 * 0.1 / 300)
    assert 30 < np.median(taken) < 100  # (1.96 / 0.3)^2 = 43 frames


def test_every_saturated_pixel_counts():
    watcher = SaturationJudge().watch(
        Step(label="a", kind="flat", frames=9, conditions=Conditions()), 4095.0
    )
    frame = np.zeros(SHAPE)
    frame.flat[:3] = 4095.0
    watcher.see(frame)
    assert watcher.complaint() == "0.5 % of all pixels are at full scale, 4095 DN"
    assert not watcher.is_saturated()
    frame.flat[:60] = 4095.0
    watcher.see(frame)
    assert watcher.is_saturated()


def test_a_point_is_meant_to_saturate():
    watcher = SaturationJudge().watch(
        Step(label="a", kind="point", frames=9, conditions=Conditions()), 4095.0
    )
    watcher.see(np.full(SHAPE, 4095.0))
    assert watcher.complaint() is None
