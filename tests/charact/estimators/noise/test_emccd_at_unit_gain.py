"""A real CCD of known gain: an EMCCD at unit gain, 3 x 3 px (Ryan et al. 2021,
10.1038/s41598-021-97759-6).
"""

from dataclasses import replace

import numpy as np
import pytest
import tifffile

from charact.estimators import noise
from charact.method import Context
from labdata.session_import import import_frames

# The authors' fit.
PHOTOELECTRONS_PER_COUNT = 3.859
LEVELS = range(1, 7)


@pytest.fixture(scope="module")
def frames(shared_data):
    """All frames of every level, DN."""
    return [
        tifffile.imread(shared_data / "emccd_ryan2021" / f"1x-gain_level-0{level}.tif")
        for level in LEVELS
    ]


@pytest.fixture(scope="module")
def gain(frames, tmp_path_factory):
    """The gain that we measure."""
    return gain_of(session_of(frames, tmp_path_factory.mktemp("whole")))


def session_of(frames, folder):
    """A session of flats, in files that open quickly."""
    files = [folder / f"level-{level}.npy" for level in LEVELS]
    for file, data in zip(files, frames, strict=False):
        np.save(file, data)
    return import_frames(files[: len(frames)], folder / "session", kind="flat", name_pattern=None)


def gain_of(session):
    (gain,) = noise.measure(session, method="variance", context=Context(seed=1, quick=True)).find(
        "system_gain"
    )
    return gain


def test_the_gain_of_a_real_ccd_is_what_its_authors_found(gain):
    assert gain.value == pytest.approx(1.0 / PHOTOELECTRONS_PER_COUNT, rel=0.025)
    # There are frames of no dark, and it is said.
    assert "no-darks" in gain.flags


def test_a_map_of_mean_bias_is_no_sample_of_dark_noise(frames, shared_data, tmp_path):
    """A mean of many darks does not change in time: given as a dark it is named, subtracts no noise
    and moves no slope.

    Gaussian frames made of the authors' bias and read-noise maps do not bring the gain to theirs
    either: 0.253.
    """
    session = session_of([stack[:500] for stack in frames[:3]], tmp_path)
    bias = import_frames(
        [shared_data / "emccd_ryan2021" / "1x-gain_no-signal_S0.tif"],
        tmp_path / "bias",
        kind="dark",
        name_pattern=None,
    )
    without, with_map = (
        gain_of(one) for one in (session, replace(session, stacks=(*session.stacks, *bias.stacks)))
    )
    assert with_map.value == pytest.approx(without.value, rel=1e-9)
    assert with_map.interval95 == pytest.approx(without.interval95, rel=1e-9)
    assert "no-darks" in with_map.flags
    assert any(bias.stacks[0].label in note for note in with_map.notes)
