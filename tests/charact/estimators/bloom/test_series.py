"""The forward model of a point series finds the halo of closed forms, and says where it may not."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from charact.estimators import bloom
from charact.estimators.bloom import read_point_stacks
from charact.estimators.bloom.series.model_selection import candidates
from charact.estimators.bloom.series.ring_series import build_ring_series
from charact.estimators.bloom.series.rings import geometry_of
from charact.method import Context
from charact.method.registry import methods_of_kind
from tests.truth.bloom import bloom_session
from tests.truth.bloom_light import BloomScene
from tests.truth.counted_pulses import errors

QUICK = Context(seed=1, quick=True)
TWO_DECADES = tuple(np.geomspace(0.5, 5e4, 7))


def measured(scene, seed, overloads=TWO_DECADES, context=QUICK):
    drawn = bloom_session(scene, list(overloads), np.random.default_rng(seed))
    return bloom.measure(drawn, method="series-forward", context=context)


def only(result, quantity, **where):
    (found,) = result.find(quantity, **where)
    return found


def test_rings_that_the_border_cuts_keep_their_radius():
    cut = geometry_of((150, 170), 20.0, 30.0, pitch_ratio=1.0, spoiled=None)
    assert len(cut.radius_px) > 60
    assert np.all(np.abs(cut.radius_px[5:] - np.arange(5, len(cut.radius_px)) - 0.5) < 0.2)


@pytest.mark.parametrize(
    "scene",
    [
        BloomScene(
            halo_diameter_px=28.0, halo_fraction=0.25, halo_elastic_share=0.8, core_sigma_px=1.1
        ),
        BloomScene(halo_diameter_px=62.0, halo_fraction=0.04, wing_share=0.1, core_sigma_px=1.8),
    ],
    ids=["narrow", "wide with a wing"],
)
def test_halo_and_its_share_are_found_with_honest_intervals(scene, seed):
    result = measured(scene, seed)
    diameter, share = only(result, "halo_diameter"), only(result, "halo_fraction")
    assert diameter.status == "ok"
    assert abs(errors(diameter, scene.halo_diameter_px)) < 4.5
    assert abs(diameter.value - scene.halo_diameter_px) < max(1.0, 0.02 * scene.halo_diameter_px)
    assert abs(errors(share, scene.halo_fraction)) < 4.5
    best = result.evidence["bloom-forms"]["table"][0]["form"]
    assert best.endswith("disc")
    assert not scene.wing_share or best == "moffat core, disc"


def off_about_the_core(series, shares):
    """The series of a camera that is not round: its innermost rings, where uncut, are off by shares
    of their light.
    """
    count = len(shares)
    light = series.data[:, :count] - np.median(series.data[:, -6:], axis=1, keepdims=True)
    data = series.data.copy()
    data[:, :count] += np.where(series.cut[:, :count], 0.0, shares * light)
    return replace(series, data=data)


def test_rings_about_the_core_that_are_off_blur_the_halos_share_and_leave_its_edge(seed):
    """What many rings agree on says nothing of how far the few about the core are off, nor these of
    the many.
    """
    scene = BloomScene(halo_fraction=0.03, wing_share=0.1)
    drawn = bloom_session(scene, list(np.geomspace(0.3, 3e4, 9)), np.random.default_rng(seed))
    round_one, _ = build_ring_series(drawn, read_point_stacks(drawn, context=QUICK), context=QUICK)
    bent_one = off_about_the_core(round_one, np.array([-0.06, 0.12, -0.19, 0.2]))
    found = [
        candidates(one, pitch_ratio=1.0, sensor=None, has_tube=True, first_diameter_px=46.0)[0]
        for one in (round_one, bent_one)
    ]
    (whole, bent), names = (one.peak for one in found), found[0].form.names
    assert found[1].form.names == names
    edge, share = names.index("halo_diameter"), names.index("halo_fraction")
    sds = np.sqrt([np.diag(one.covariance) for one in (whole, bent)])
    assert sds[1, edge] < 1.8 * sds[0, edge]
    assert sds[1, share] > 1.1 * sds[0, share]
    for one, sd in zip((whole, bent), sds, strict=True):
        assert abs(one.point[edge] - scene.halo_diameter_px) < 4.5 * sd[edge]
        assert abs(one.point[share] - scene.halo_fraction) < 4.5 * sd[share]


@pytest.mark.parametrize(
    "scene",
    [BloomScene(halo_fraction=0.0), BloomScene(halo_fraction=0.0, wing_share=0.2)],
    ids=["bare core", "core with a wing"],
)
def test_no_halo_is_no_halo(scene, seed):
    result = measured(scene, seed)
    refusal = only(result, "halo_diameter")
    assert refusal.status == "refused" and "no halo" in refusal.reason
    assert only(result, "encircled_radius_50").status == "ok"


def test_a_source_in_the_corner_has_the_same_halo(seed):
    scene = BloomScene(row=22.3, col=24.8)
    found = only(measured(scene, seed), "halo_diameter")
    assert found.status == "ok"
    assert abs(errors(found, scene.halo_diameter_px)) < 4.5


def test_overflow_and_smear_do_not_pull_the_halo(seed):
    scene = BloomScene(full_well_dn=800.0, smear_fraction=0.002)
    found = only(measured(scene, seed), "halo_diameter")
    assert found.value == pytest.approx(scene.halo_diameter_px, rel=0.02)
    assert abs(errors(found, scene.halo_diameter_px)) < 4.5


def test_cores_cut_at_every_level_leave_the_halo_and_hide_its_share(seed):
    result = measured(BloomScene(), seed, tuple(np.geomspace(1e3, 1e6, 5)))
    assert abs(errors(only(result, "halo_diameter"), 46.0)) < 4.5
    share = only(result, "halo_fraction")
    low, high = share.interval95
    assert share.status != "ok" or low <= 0.1 <= high


def test_a_saturating_mcp_has_its_density_measured_and_leaves_the_halo(seed):
    saturation_dn = 1000.0
    scene = BloomScene(plate_saturation_dn=saturation_dn)
    result = measured(scene, seed, tuple(np.geomspace(0.3, 1e5, 9)))
    density = only(result, "mcp_saturation_density")
    assert abs(errors(density, saturation_dn)) < 4.5
    assert abs(errors(only(result, "halo_fraction"), scene.halo_fraction)) < 4.5
    left = [one.value for one in result.find("core_compression")]
    assert all(one > other for one, other in pairwise(left))
    assert 0.9 < left[0] <= 1.0 and left[-1] < 0.1


def test_glare_is_told_from_backgrounds_that_rise_with_the_light(seed):
    """Halos tell the light of cut cores, so that glare is known as well as the halo's share of the
    light.
    """
    scene = BloomScene(glare_fraction=0.1)
    series = [measured(scene, [seed, number]) for number in range(2)]
    glare, share = (
        [only(one, name) for one in series] for name in ("veiling_glare", "halo_fraction")
    )
    error = np.mean(
        [0.5 * (one.interval68[1] - one.interval68[0]) / one.value for one in share]
    ) / np.sqrt(len(series))
    inside = 0.1 * scene.rows * scene.cols / 600.0**2
    true = 100.0 * inside / (0.9 + inside)
    assert abs(np.mean([one.value for one in glare]) / true - 1.0) < 4.5 * error
    assert all(abs(errors(one, true)) < 4.5 for one in glare)


def test_a_source_beside_another_has_a_halo_of_its_own(seed):
    """Rings without the pixels nearer to the other one: the edge stays where it is, what counts
    light is flagged.
    """
    scene = BloomScene(rows=180, cols=260, second_distance_px=20.0, second_ratio=0.3)
    result = measured(scene, seed)
    found = only(result, "halo_diameter")
    assert found.status == "ok" and found.value is not None and found.interval95 is not None
    low, high = found.interval95
    assert abs(found.value - scene.halo_diameter_px) < 0.75 * (high - low)
    for quantity in ("halo_fraction", "halo_rim", "encircled_radius_50", "veiling_glare"):
        assert only(result, quantity).flags.count("several-targets") == 1


@pytest.mark.parametrize(
    "scene, flag",
    [
        (BloomScene(second_distance_px=7.0), "model-misfit"),
        (BloomScene(motion_px=0.5), "drift"),
        (BloomScene(agc=True), "agc"),
    ],
    ids=["two sources", "moving source", "automatic gain"],
)
def test_what_is_not_one_source_at_rest_is_flagged(scene, flag, seed):
    found = only(measured(scene, seed), "halo_diameter")
    assert found.status == "refused" or flag in found.flags


@pytest.mark.filterwarnings("error")
def test_a_source_at_the_border_is_measured_or_refused_by_every_method(seed):
    """Few rings fit beside it: no method may fall over that."""
    drawn = bloom_session(BloomScene(row=80.0, col=6.0), [3.0, 300.0], np.random.default_rng(seed))
    for method in methods_of_kind("bloom"):
        assert bloom.measure(drawn, method=method, context=QUICK).find("halo_diameter")
