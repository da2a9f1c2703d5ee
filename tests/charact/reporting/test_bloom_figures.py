"""Figures of blooming draw the numbers they are given, and stay whole where some of them are
missing.
"""

import numpy as np
import pytest

from charact.reporting import (
    add_extent_data,
    blooms,
    figure_of,
    plot_bloom_frames,
    plot_bloom_map,
    white_style,
)
from labdata import Posterior, Result, measurement_from_draws, measurement_from_sd
from tests.truth.bloom import bloom_session
from tests.truth.bloom_extents import truth
from tests.truth.bloom_light import BloomScene

SCENE = BloomScene(frames=2)
OVERLOADS = (0.3, 30.0, 3000.0)
LABELS = [f"point-{n}" for n in range(3)]
NAMES = ("core_sd", "halo_diameter", "elastic_share", "halo_fraction")


def series() -> dict:
    return {
        "figure": "bloom-series",
        "label": LABELS,
        "overload": list(OVERLOADS),
        "overload_known": True,
        "illuminance_lux": [1e-6 * one for one in OVERLOADS],
        "gate_ns": [1.6e7] * 3,
        "bloom_diameter_px": [0.0, 7.4, 48.0],
        "streak_length_px": [0.0, 8.0, 48.0],
        "dark_dn": [12.0] * 3,
        "full_scale_dn": [255.0] * 3,
    }


def result() -> Result:
    draws = np.tile([np.sqrt(1.3**2 - 1 / 12), 46.0, 0.3, 0.1], (20, 1))
    posterior = Posterior(names=NAMES, units=("px", "px", "1", "1"), draws=draws)
    halo = measurement_from_draws(
        "halo_diameter", "px", draws[:, 1], method="made", posterior=posterior
    )
    bloom = [
        measurement_from_sd("bloom_diameter", "px", value, 0.2, method="made", stack=label)
        for label, value in (("point-1", 7.4), ("point-2", 48.0))
    ]
    return Result(measurements=(halo, *bloom), evidence={"bloom-series": series()})


@pytest.fixture(scope="module")
def evidence(seed) -> dict:
    return add_extent_data(bloom_session(SCENE, OVERLOADS, np.random.default_rng(seed)), result())


def test_measured_extents_and_their_intervals_are_drawn_with_the_halo(evidence):
    data = evidence["bloom-series"]
    assert data["measured"]["bloom_diameter"]["point-2"][0] == 48.0
    axes = blooms.plot_bloom_series(data).axes[0]
    drawn = [
        container for container in axes.containers if container.get_label() == "half of full scale"
    ]
    assert drawn[0].lines[0].get_xydata()[1].tolist() == [3000.0, 48.0]
    assert any(line.get_label().startswith("halo, 46.0") for line in axes.lines)
    assert "px" in axes.get_ylabel() and "overload" in axes.get_xlabel()


def test_the_line_through_the_diameters_is_what_the_spread_makes_of_a_point(evidence):
    foretold = evidence["bloom-series"]["foretold"]
    at, middle = np.array(foretold["overload"]), np.array(foretold["bloom_diameter"][1])
    scene = BloomScene(background_dn=0.0)
    for overload in (3.0, 30.0, 3000.0):
        expected = truth(scene, overload)["bloom_diameter"]
        assert np.interp(np.log(overload), np.log(at), middle) == pytest.approx(expected, rel=0.02)


def test_frames_show_source_bloom_and_halo_at_their_places(evidence):
    data = evidence["frames of the point series"]
    assert data["row"][0] == pytest.approx(SCENE.centre[0], abs=0.5)
    assert data["col"][0] == pytest.approx(SCENE.centre[1], abs=0.5)
    axes = plot_bloom_frames(data).axes[2]
    assert [round(patch.width) for patch in axes.patches] == [46, 48]
    tint = axes.images[1].get_array()
    assert (tint[..., 3] > 0).sum() == pytest.approx(
        truth(SCENE, 3000.0)["saturated_area"], rel=0.1
    )


def test_a_map_greys_what_is_unknown():
    fraction = np.full((40, 50), 0.3)
    fraction[:10] = np.nan
    data = {
        "signal_dn": np.ones((40, 50)),
        "fraction": fraction,
        "sd": 0.1 * fraction,
        "near_px": 3.0,
        "sources": [{"row": 5.0, "col": 6.0, "known": False}],
    }
    with white_style():
        axes = plot_bloom_map(data).axes
    shown = axes[1].images[0].get_array()
    assert np.ma.getmaskarray(shown).sum() == 500
    assert axes[0].lines[0].get_marker() == "x"


@pytest.mark.parametrize("missing", ["measured", "halo_px", "foretold"])
def test_a_series_is_drawn_without_what_a_method_does_not_give(evidence, missing):
    data = {key: value for key, value in evidence["bloom-series"].items() if key != missing}
    assert figure_of("bloom-series", data).svg
