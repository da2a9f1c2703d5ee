"""What lies along columns is told from what lies around the source, and from nothing."""

from dataclasses import replace

import numpy as np
import pytest

from charact.estimators.bloom import column_artefact_mask
from charact.method import Context
from tests.charact.estimators.bloom.test_streak import spots_of
from tests.truth.bloom_light import BloomScene

QUICK = Context(seed=1, quick=True)
HALO_OVERLOADS = (0.5, 30.0, 3e3, 1e5)


def test_nothing_is_spoiled_where_the_source_is_round(seed):
    """Halo, rim, saturation and a place near the border are no columns, whatever the noise."""
    rng = np.random.default_rng(seed)
    scenes = (
        BloomScene(frames=4),
        BloomScene(frames=4, halo_fraction=0.3, halo_elastic_share=1.0, col=40.3),
    )
    spots = [
        spot for _ in range(5) for scene in scenes for spot in spots_of(scene, HALO_OVERLOADS, rng)
    ]
    # One in a hundred is the aim; five of forty come by chance once in ten thousand times.
    assert sum(column_artefact_mask(spot, QUICK).any() for spot in spots) < 5


@pytest.mark.parametrize("core_sigma_px", [1.3, 4.0])
def test_every_column_that_spills_is_left_out_as_far_as_it_does(seed, core_sigma_px):
    """Columns wider than the bloom's own: what is brighter than a camera with endless wells would
    show is masked.
    """
    scene = BloomScene(core_sigma_px=core_sigma_px, full_well_dn=3000.0, halo_fraction=0.05)
    spot = spots_of(scene, (0.5, 300.0), np.random.default_rng(seed))[1]
    mask = column_artefact_mask(spot, QUICK)
    away = np.abs(np.arange(scene.rows) - spot.row)[:, None] > 26.0
    bright = away & (spot.image > 0.5 * spot.full_scale_dn)
    assert bright.any(axis=0).sum() >= (3 if core_sigma_px < 2 else 9)
    assert mask[bright].all()
    assert not mask[
        :, np.abs(np.arange(scene.cols) - spot.col) > np.count_nonzero(bright.any(axis=0)) / 2 + 6
    ].any()


def test_smear_takes_whole_columns_and_leaves_the_core(seed):
    scene = BloomScene(smear_fraction=1e-3, halo_fraction=0.05)
    faint, bright = (
        column_artefact_mask(spot, QUICK)
        for spot in spots_of(scene, (0.5, 1e3), np.random.default_rng(seed))
    )
    assert not faint.any()
    source = round(scene.centre[1])
    assert bright[:30, source].all() and bright[-30:, source].all()
    assert not bright[round(scene.centre[0]), source]
    assert not bright[:, np.abs(np.arange(scene.cols) - source) > 8].any()


def test_bright_pulses_among_dark_pixels_are_neither_streak_nor_smear(seed):
    """Scintillation of a tube in darkness: most pixels hold nothing, a few hold pulses many times
    their scatter.
    """
    rng = np.random.default_rng(seed)
    (spot,) = spots_of(BloomScene(background_dn=1e-3, frames=4, read_noise_dn=0.05), (0.5,), rng)
    spoilt = 0
    for _ in range(20):
        pulses = (
            rng.poisson(0.01, spot.image.shape) * rng.standard_exponential(spot.image.shape) * 4.0
        )
        spoilt += bool(column_artefact_mask(replace(spot, image=spot.image + pulses), QUICK).any())
    # One in a hundred is the aim; three of twenty come by chance once in a thousand times.
    assert spoilt < 3
