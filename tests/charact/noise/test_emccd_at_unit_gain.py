"""A real CCD of known gain: an EMCCD at unit gain, 3 x 3 px (Ryan et al. 2021, 10.1038/s41598-021-97759-6)."""

from dataclasses import replace

import numpy as np
import pytest
import tifffile

from charact import noise
from charact.method import Context
from labdata.importers import import_frames

# The authors' fit.
PHOTOELECTRONS_PER_COUNT = 3.859
LEVELS = range(1, 7)


@pytest.fixture(scope="module")
def levels(shared_data):
    return [shared_data / "emccd_ryan2021" / f"1x-gain_level-0{level}.tif" for level in LEVELS]


def test_the_gain_of_a_real_ccd_covers_what_its_authors_found(levels, tmp_path):
    session = import_frames(levels, tmp_path / "session", kind="flat", name_pattern=None)
    result = noise.measure(session, method="variance", context=Context(seed=1, quick=True))
    (gain,) = result.find("system_gain")
    low, high = gain.interval95 or (0.0, 0.0)
    assert low < 1.0 / PHOTOELECTRONS_PER_COUNT < high
    assert gain.value == pytest.approx(1.0 / PHOTOELECTRONS_PER_COUNT, rel=0.025)
    # There are frames of no dark, and it is said.
    assert "no-darks" in gain.flags


def test_a_map_of_mean_bias_is_no_sample_of_dark_noise(levels, shared_data, tmp_path):
    """A mean of many darks does not change in time: given as a dark it is named, subtracts no noise and moves no slope.

    Gaussian frames made of the authors' bias and read-noise maps do not bring the gain to theirs either: 0.253.
    """
    session = import_frames(levels[:3], tmp_path / "session", kind="flat", name_pattern=None)
    bias = import_frames([shared_data / "emccd_ryan2021" / "1x-gain_no-signal_S0.tif"], tmp_path / "bias",
                         kind="dark", name_pattern=None)  # fmt: skip
    both = replace(session, stacks=(*session.stacks, *bias.stacks))
    without, with_map = (
        noise.measure(one, method="variance", context=Context(seed=1, quick=True)).find("system_gain")[0]
        for one in (session, both)
    )
    assert with_map.value == without.value and with_map.interval95 == without.interval95
    assert "no-darks" in with_map.flags
    assert any(bias.stacks[0].label in note for note in with_map.notes)


def test_the_rest_of_the_difference_is_light_that_drifts(levels, shared_data):
    """The authors' figure counts the lamp's drift as noise: with it left in, the bare moments are theirs within 1 %;
    differences of successive frames, which no drift reaches, give 1.6 % more photoelectrons."""
    folder = shared_data / "emccd_ryan2021"
    offset, read = (tifffile.imread(folder / f"1x-gain_no-signal_{name}.tif").astype(float) for name in ("S0", "sigma"))
    whole, steady = [], []
    for file in levels:
        frames = tifffile.imread(file).astype(float)
        signal = (frames.mean(axis=0) - offset).mean()
        whole.append((frames.var(axis=0, ddof=1) - read**2).mean() / signal)
        steady.append((0.5 * (np.diff(frames, axis=0) ** 2).mean(axis=0) - read**2).mean() / signal)
    assert 1.0 / np.mean(whole) == pytest.approx(PHOTOELECTRONS_PER_COUNT, rel=0.01)
    error = np.std(steady, ddof=1) / np.sqrt(len(steady))
    assert abs(np.mean(steady) - 1.0 / PHOTOELECTRONS_PER_COUNT) > 4.0 * error
