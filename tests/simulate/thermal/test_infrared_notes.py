"""What infrared pictures say of themselves: too few rays, edges, metals, and what lies beyond their
laws.
"""

from dataclasses import replace

import numpy as np
import pytest

from labdata import from_mapping
from simulate.radiance.geometry import Viewpoint
from simulate.radiance.outdoor import OutdoorScene
from simulate.thermal import (
    infrared_radiance,
    infrared_rendering,
    notes_beyond_laws,
    temperatures_of,
    thresholds,
)
from tests.simulate.thermal.test_air import humid_air
from tests.simulate.thermal.test_infrared_rendering import NIGHT, box, ground

VIEW = Viewpoint(
    position_m=(0.0, -8.0, 2.0), forward=(0.0, 1.0, -0.1), shape=(12, 16), focal_px=(12.0, 12.0)
)
UP = np.array([0.0, 0.0, 1.0])


def picture_of(library="concrete", netd_k=0.3):
    tables = {
        "material": [
            {"label": "wall", "library": library},
            {"label": "paving", "library": "concrete"},
        ],
        "object": [ground("paving", 40.0), box("wall", "wall", [0.0, 0.0, 0.0])],
    }
    scene = from_mapping(NIGHT | tables, OutdoorScene, where="test")
    return infrared_radiance(
        temperatures_of(scene), scene, VIEW, band_um=(8.0, 12.0), netd_k=netd_k
    )


@pytest.fixture(scope="module")
def seen():
    return picture_of()


def test_a_picture_whose_rays_do_not_suffice_says_so(seen):
    """0.1 mK needs more than 512 rays of a pixel, 300 mK does not."""
    fine = picture_of(netd_k=1e-4)
    assert (
        fine.rays[0] == thresholds.INFRARED.max_rays
        and fine.error_k > thresholds.INFRARED.error_share * 1e-4
    )
    assert any(
        "uncertain by" in note and "more than 0.7 of the imager's 0.1 mK" in note
        for note in fine.notes
    )
    assert not any("more than 0.7" in note for note in seen.notes)
    assert seen.error_k < thresholds.INFRARED.error_share * 0.3


def test_edges_say_their_error_and_metals_that_of_the_bins(seen):
    (edges,) = (note for note in seen.notes if "where objects or faces meet" in note)
    assert "mean of 9 parts" in edges
    finer = {
        name: next(
            one.influence
            for one in picture_of(name).left_out
            if one.name == infrared_rendering.FINER
        )
        for name in ("concrete", "aluminium")
    }
    assert finer == {"concrete": 20.0, "aluminium": 100.0}


@pytest.mark.parametrize(
    ("celsius", "humidity", "elevation_deg", "range_m", "words"),
    [
        (15.0, 0.6, 40.0, 100.0, None),
        (35.0, 0.6, 40.0, 100.0, "air of 35 C and 60 % relative humidity lies beyond"),
        (15.0, 0.1, 40.0, 100.0, "air of 15 C and 10 % relative humidity lies beyond"),
        (15.0, 0.6, -0.5, 100.0, "the sun stands -0.5 degrees above the horizon"),
        (15.0, 0.6, 0.5, 100.0, "the sun stands 0.5 degrees above the horizon"),
        (15.0, 0.6, -5.0, 100.0, None),
        (15.0, 0.6, 40.0, 9500.0, "surfaces are up to 9.5 km away"),
    ],
)
def test_what_lies_beyond_the_laws_is_said(seen, celsius, humidity, elevation_deg, range_m, words):
    """Looking down there is no sky: one sentence at most."""
    angle = np.deg2rad(elevation_deg)
    sun = np.array([0.0, np.cos(angle), np.sin(angle)])
    down = replace(VIEW, forward=(0.0, 0.0, -1.0))
    truth = replace(seen.truth, range_m=np.where(seen.truth.object >= 0, range_m, np.inf))
    notes = notes_beyond_laws(humid_air((8.0, 12.0), celsius + 273.15, humidity), sun, down, truth)
    assert [note[: len(words or "")] for note in notes] == ([] if words is None else [words])


def test_sky_near_the_horizon_is_said_to_be_uncertain(seen):
    notes = notes_beyond_laws(humid_air((8.0, 12.0), 288.15, 0.6), UP, VIEW, seen.truth)
    (low,) = (note for note in notes if "less than 5 degrees above the horizon" in note)
    _, towards = VIEW.rays(*(np.indices(VIEW.shape).reshape(2, -1) + 0.5))
    sky = seen.truth.object.ravel() < 0
    share = np.mean(sky & (towards[:, 2] > 0.0) & (towards[:, 2] < np.sin(np.deg2rad(5.0))))
    assert low.startswith(f"{100.0 * share:.2g} % of the pixels")
