"""The bloom is the region of the picture behind the noise at or above a level, its area counted in
column pitches.
"""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from charact.estimators import bloom
from charact.estimators.bloom import extent_at, read_point_stacks, view_of
from charact.frames import Stack
from charact.method import Context
from labdata import FrameStack, Measurement, load_sensor
from tests.truth.bloom import bloom_session, stack
from tests.truth.bloom_extents import truth
from tests.truth.bloom_light import BloomScene
from tests.truth.thrown_halos import point_frames, point_session

QUICK = Context(seed=1, quick=True)
LEVELS = ("bloom_diameter", "bloom_diameter_background", "bloom_diameter_clip")


def disc(radius: float, shape=(81, 91), centre=(40, 45), row_pitch=1.0):
    rows, cols = np.indices(shape)
    return np.where(
        np.hypot(cols - centre[1], (rows - centre[0]) * row_pitch) <= radius, 200.0, 10.0
    )


def view(frames, dark_dn=0.0, centre=(40.0, 45.0), row_pitch=1.0):
    stack = Stack(frames=FrameStack(data=frames), stated_full_scale_dn=255.0)
    return view_of(stack, dark_dn, *centre, row_pitch)


def extent(image, level=100.0, row_pitch=1.0):
    found = extent_at(view(image[None], row_pitch=row_pitch), level)
    assert found is not None
    return found


def half95(m: Measurement) -> float:
    assert m.interval95 is not None
    return 0.5 * (m.interval95[1] - m.interval95[0])


@pytest.mark.parametrize("radius", [3.3, 8.0, 15.6])
@pytest.mark.parametrize("row_pitch", [1.0, 13.0 / 11.0])
def test_a_disc_has_its_own_diameter_whatever_the_row_pitch(radius, row_pitch):
    found = extent(disc(radius, row_pitch=row_pitch), row_pitch=row_pitch)
    assert found.diameter_px == pytest.approx(2 * radius, abs=0.6)
    assert not found.touches_border


def test_a_streak_counts_as_far_as_it_hangs_together():
    image = disc(8.0)
    image[15:70, 44:47] = 200.0
    image = gaussian_filter(image, 1.0)
    assert np.pi / 4.0 * extent(image).diameter_px ** 2 == pytest.approx(
        (image >= 100.0).sum(), rel=0.06
    )


@pytest.mark.parametrize("overload", [3.0, 300.0, 3e3, 1e6])
def test_three_levels_lie_where_the_closed_form_has_them(overload, seed):
    """Within 5 % or 1 px, and within what the interval promises, through core, step and plateau."""
    scene = BloomScene()
    rng = np.random.default_rng(seed)
    known = truth(scene, overload)
    result = bloom.measure(bloom_session(scene, [0.3, overload], rng), context=QUICK)
    for name in LEVELS:
        (found,) = result.find(name, stack="point-1")
        assert found.value is not None
        assert abs(found.value - known[name]) < max(0.05 * known[name], 1.0), name
        if found.status == "ok":
            assert abs(found.value - known[name]) < 2.0 * half95(found), name


def test_intervals_hold_where_noise_rules(seed):
    """Twice the background on the flank of the core and in the halo, in single frames: 15 draws of
    each.
    """
    for overload, frames in ((3.0, 1), (100.0, 1), (1e3, 2)):
        scene = BloomScene(frames=frames)
        held, known = [], truth(scene, overload)
        for rng in np.random.default_rng(seed).spawn(15):
            seen = view(stack(scene, overload, rng).data, scene.dark_dn, scene.centre)
            for name, level in (("bloom_diameter", 133.5), ("bloom_diameter_background", 20.0)):
                found = extent_at(seen, level)
                assert found is not None
                low, high = np.quantile(found.draws, [0.025, 0.975])
                held.append(low <= known[name] <= high)
        assert np.mean(held) > 0.95 - 3.0 * np.sqrt(0.95 * 0.05 / len(held)), (overload, frames)


def test_a_level_within_the_noise_of_the_plateau_is_no_narrow_number(seed):
    """The plateau meets half of full scale: noise adds or loses the whole disc, and the interval or
    a flag says so.
    """
    scene = BloomScene(frames=1, halo_elastic_share=1.0)
    half = 0.5 * scene.span_dn
    rings = (
        view(stack(scene, 1e3, np.random.default_rng(seed)).data, scene.dark_dn, scene.centre)
    ).profile[1]
    overload = 1e3 * half / float(np.median(rings[8:16]))
    known = truth(scene, overload)["bloom_diameter"]
    for rng in np.random.default_rng(seed).spawn(3):
        (found,) = bloom.measure(bloom_session(scene, [overload], rng), context=QUICK).find(
            LEVELS[0]
        )
        assert found.status != "ok" or abs((found.value or 0.0) - known) < 2.0 * half95(found)


def test_overflow_and_smear_are_part_of_the_region(seed):
    scene = BloomScene(full_well_dn=300.0, smear_fraction=1e-4)
    result = bloom.measure(
        bloom_session(scene, [0.3, 30.0], np.random.default_rng(seed)), context=QUICK
    )
    (found,) = result.find("bloom_diameter", stack="point-1")
    known = truth(scene, 30.0)
    assert found.value == pytest.approx(
        known["bloom_diameter"], abs=max(0.05 * known["bloom_diameter"], 1.0)
    )
    (shape,) = result.find("bloom_ellipticity", stack="point-1")
    assert shape.value == pytest.approx(known["bloom_ellipticity"], abs=0.1)


def test_smear_at_the_level_is_a_streak_to_the_border_however_thin_it_is(seed):
    """Two columns of it, a fifth above the level, under noise that frays single pixels."""
    rng = np.random.default_rng(seed)
    image = gaussian_filter(disc(15.0), 1.0)
    image[:, 44:46] = np.maximum(image[:, 44:46], 120.0)
    frames = image + rng.normal(0.0, 16.0, (4, *image.shape))
    found = extent_at(view(frames), 100.0)
    assert found is not None and found.pulled and found.touches_border
    assert found.area == pytest.approx((image >= 100.0).sum(), rel=0.03)


def test_extents_of_few_codes_are_flagged(seed):
    """Eleven codes from dark to the highest: rounding moves where the light falls through a
    level.
    """
    scene = BloomScene(
        dark_dn=1.0,
        background_dn=0.2,
        full_scale_dn=12.0,
        photoelectron_dn=0.15,
        read_noise_dn=0.03,
    )
    drawn = bloom_session(scene, [0.8, 30.0, 300.0], np.random.default_rng(seed))
    found = bloom.measure(drawn, context=QUICK).measurements
    told = [one for one in found if one.quantity in LEVELS and one.status != "refused"]
    assert told and all("quantised" in one.flags for one in told)


def test_saturated_area_is_told_in_pixels_and_at_the_cathode(seed):
    scene = BloomScene(row_pitch=13.0 / 11.0)
    sensor = load_sensor("pulnix-ag5745ef3")
    context = Context(seed=1, quick=True, camera=sensor, full_scale_dn=255.0)
    result = bloom.measure(
        bloom_session(scene, [3e3], np.random.default_rng(seed)), context=context
    )
    (pixels,) = result.find("saturated_area", unit="px")
    area = {m.unit: m.value or 0.0 for m in result.find("saturated_area")}
    assert abs(area["px"] - truth(scene, 3e3)["saturated_area"]) < 2.0 * half95(pixels)
    cathode_mm2 = 11e-3 * 13e-3 * float(sensor.taper.demagnification) ** 2
    assert area["mm2"] == pytest.approx(area["px"] * cathode_mm2)
    assert area["mrad2"] == pytest.approx(
        area["mm2"] / (1e-3 * float(sensor.optics.focal_length_mm)) ** 2
    )


@pytest.mark.parametrize("row_pitch", [1.0, 1.3])
def test_a_round_source_is_round_and_a_wrong_row_pitch_makes_it_oval(seed, row_pitch):
    scene = BloomScene(row_pitch=row_pitch)
    (found,) = bloom.measure(
        bloom_session(scene, [3e3], np.random.default_rng(seed)), context=QUICK
    ).find("bloom_ellipticity")
    assert abs((found.value or 0.0) - 1.0 / row_pitch) < max(2.0 * half95(found), 0.02)


@pytest.mark.parametrize("overloads", [(1e5,), (3e3, 1e5), (0.5, 1e5)])
@pytest.mark.parametrize("trouble", ["none", "streak"])
def test_the_middle_is_pulled_neither_by_saturation_nor_by_streaks(seed, overloads, trouble):
    scene = BloomScene(row=70.3, col=95.4, full_well_dn=None if trouble == "none" else 6e4)
    for spot in read_point_stacks(
        bloom_session(scene, overloads, np.random.default_rng(seed)), context=QUICK
    ):
        assert abs(spot.row - 70.3) < 0.5 and abs(spot.col - 95.4) < 0.3


def test_two_sources_are_told_apart(seed):
    """The brighter one is the source, though both are cut at every level: noise, drawn four times,
    does not choose.
    """
    scene = BloomScene(second_distance_px=20.0, second_ratio=0.5)
    down, along = 20.0 * np.sin(np.deg2rad(30.0)), 20.0 * np.cos(np.deg2rad(30.0))
    for rng in np.random.default_rng(seed).spawn(4):
        spots = read_point_stacks(bloom_session(scene, [3.0, 30.0, 3e4], rng), context=QUICK)
        for spot in spots:
            assert np.hypot(spot.row - scene.centre[0], spot.col - scene.centre[1]) < 0.5
        for spot in spots[:2]:
            (other,) = spot.other_sources
            assert (
                np.hypot(other.row - scene.centre[0] - down, other.col - scene.centre[1] - along)
                < 1.5
            )


def test_a_gaussian_core_blooms_by_the_root_of_the_logarithm(seed):
    """D = 2 s sqrt(2 ln OL) with OL the peak over the threshold (physics reference, 2.1)."""
    rng = np.random.default_rng(seed)
    rows, cols = np.indices((111, 121))
    radius2 = (rows - 55.2) ** 2 + (cols - 60.4) ** 2
    width = 3.0
    stacks = []
    for index, overload in enumerate((0.3, 3.0, 30.0, 300.0)):
        light = 12.0 + overload * 121.5 * np.exp(-radius2 / (2 * width**2))
        noisy = light + rng.normal(0.0, 1.0, (4, 111, 121))
        data = np.clip(np.rint(noisy), 0, 255).astype(np.uint8)
        stacks.append((f"point-{index}", FrameStack(data=data, full_scale_dn=255.0), overload))
    result = bloom.measure(point_session(stacks), context=QUICK)
    assert result.find("bloom_diameter", stack="point-0")[0].status == "refused"
    for index, overload in ((1, 3.0), (2, 30.0), (3, 300.0)):
        (found,) = result.find("bloom_diameter", stack=f"point-{index}")
        assert found.status == "ok"
        assert abs((found.value or 0.0) - 2 * width * np.sqrt(2 * np.log(overload))) < 2.3 * half95(
            found
        )
    assert result.find("halo_diameter")[0].status == "refused"
    assert result.evidence["bloom-series"]["overload_known"]
    # Nothing lights the frame but the source: twice nothing is no level.
    assert all(m.status == "refused" for m in result.find("bloom_diameter_background"))


def test_without_darks_the_interval_holds_the_extent_that_they_give(seed):
    """A level between 0 DN and what most pixels show: wider, never narrower, and no flag for what
    is merely unknown.
    """
    frames = point_frames(np.random.default_rng(seed), 1e5)
    (bare,), (known,) = (
        bloom.measure(point_session([("point", frames, 1.0)], darks=darks), context=QUICK).find(
            "bloom_diameter"
        )
        for darks in (False, True)
    )
    assert "no-darks" not in bare.flags
    assert half95(bare) >= half95(known)
    assert abs((bare.value or 0.0) - (known.value or 0.0)) < 2.0 * half95(bare)
