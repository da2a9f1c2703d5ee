"""One frame by itself: extents, a halo's edge where the rings step, and a sentence for all that it
cannot tell.
"""

import json

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from charact.cli.application import app
from charact.estimators.bloom import BEYOND_ONE_FRAME, bare_session, measure_frame
from charact.method import Context
from labdata import Measurement
from tests.truth.bloom import bloom_session, stack
from tests.truth.bloom_extents import truth
from tests.truth.bloom_light import BloomScene

QUICK = Context(seed=1, quick=True)


@pytest.fixture
def picture(tmp_path, seed):
    def written(scene: BloomScene, overload: float):
        frame = stack(scene, overload, np.random.default_rng(seed)).data[0]
        path = tmp_path / "point.png"
        cv2.imwrite(str(path), frame)
        return path

    return written


def within(m: Measurement, known: float) -> bool:
    assert m.interval95 is not None and m.value is not None
    return abs(m.value - known) < m.interval95[1] - m.interval95[0]


def test_a_bare_picture_tells_extents_and_the_edge_of_the_halo(picture):
    scene = BloomScene(frames=1)
    result = measure_frame(bare_session(picture(scene, 300.0)), context=QUICK)
    known = truth(scene, 300.0)
    for name in ("bloom_diameter", "bloom_diameter_clip"):
        (found,) = result.find(name)
        assert found.status == "ok"
        assert within(found, known[name])
    (halo,) = result.find("halo_diameter")
    assert halo.status == "ok" and within(halo, 46.0)
    for quantity, _, _ in BEYOND_ONE_FRAME:
        (found,) = result.find(quantity)
        assert found.status == "refused" and "need" in (found.reason or "") + "needs"
    assert result.find("bloom_diameter_background")[0].status == "refused"


@pytest.mark.parametrize("overload", [3e4, 3.0])
def test_no_halo_is_told_where_it_is_cut_or_hidden(picture, overload):
    result = measure_frame(bare_session(picture(BloomScene(frames=1), overload)), context=QUICK)
    assert result.find("halo_diameter")[0].status == "refused"


def test_each_source_of_a_frame_has_its_region(picture):
    scene = BloomScene(frames=1, second_distance_px=45.0, second_ratio=0.5)
    found = measure_frame(bare_session(picture(scene, 30.0)), context=QUICK).find("bloom_diameter")
    assert len(found) == 2
    places = [(scene.centre[0], scene.centre[1])]
    angle = np.deg2rad(scene.second_angle_deg)
    places.append((places[0][0] + 45.0 * np.sin(angle), places[0][1] + 45.0 * np.cos(angle)))
    boxes = [m.region for m in found]
    for row, col in places:
        assert any(b and b[0] <= row < b[0] + b[2] and b[1] <= col < b[1] + b[3] for b in boxes)
    # The second source is the fainter one, and its bloom the smaller.
    own, other = sorted((m.value or 0.0) for m in found)
    assert own < other


@pytest.mark.parametrize("halo_fraction", [0.0, 0.3])
def test_encircled_radii_are_those_of_the_closed_form(seed, halo_fraction):
    """A source that nothing cuts, in many frames; the halo holds the outer tenth."""
    scene = BloomScene(frames=40, halo_fraction=halo_fraction, halo_diameter_px=30.0)
    result = measure_frame(bloom_session(scene, [0.6], np.random.default_rng(seed)), context=QUICK)
    for name in ("encircled_radius_50", "encircled_radius_90"):
        (found,) = result.find(name)
        assert found.status == "ok", found.reason
        assert within(found, truth(scene, 0.6)[name])


def test_the_command_reads_a_picture_or_says_why_not(picture, tmp_path):
    path = picture(BloomScene(frames=1), 300.0)
    run = CliRunner().invoke(app, ["bloom", str(path), "--json"])
    assert run.exit_code == 0
    assert "bloom_diameter" in {m["quantity"] for m in json.loads(run.stdout)["measurements"]}
    for verb, file in (("measure", path), ("bloom", tmp_path / "missing.png")):
        run = CliRunner().invoke(app, [verb, str(file), "--json"])
        assert run.exit_code == 1 and "must" in json.loads(run.stdout)["error"]
