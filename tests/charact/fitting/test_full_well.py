"""A camera whose frames reach full scale has wells that hold as much, whatever else of them is
unknown.
"""

import numpy as np
import pytest

from charact.fitting import full_well_draws, prior_of, sensor
from labdata import load_sensor


@pytest.fixture
def sheet():
    return load_sensor("pulnix-ag5745ef3")


def test_every_draw_fills_the_scale_and_is_the_prior_where_it_does_anyway(sheet, seed: int) -> None:
    rng = np.random.default_rng(seed)
    gain = rng.uniform(0.0035, 0.006, 4000)
    well = full_well_draws(sheet, {sensor.GAIN: gain}, rng)
    assert well is not None
    level = well * gain + float(sheet.video.black_level_dn)
    assert level.min() >= 255.0 * (1 - 1e-9)
    free = gain > 0.0059
    prior = prior_of(sheet, (sensor.FULL_WELL,)).draw(rng, 4000)[:, 0]
    least = 243.0 / 0.0059
    kept = prior[prior > least]
    error = kept.std() * np.sqrt(1.0 / kept.size + 1.0 / free.sum())
    assert abs(well[free].mean() - kept.mean()) < 4.0 * error


def test_without_a_gain_nothing_is_said(sheet, seed: int) -> None:
    assert full_well_draws(sheet, {}, np.random.default_rng(seed)) is None
