"""A session's own point series says how its camera spreads light: that makes the map of any of its
stacks.
"""

import numpy as np
import pytest

from charact.estimators.bloom import map_of, spread_from
from charact.method import Context
from charact.reporting.bloom_images import write_bloom_map
from labdata import (
    BadInput,
    Posterior,
    Result,
    make_refusal,
    measurement_from_draws,
    measurement_from_sd,
)
from tests.truth.bloom import bloom_session
from tests.truth.bloom_light import BloomScene

CONTEXT = Context(seed=1, full_scale_dn=255.0)
SCENE = BloomScene(frames=3)


def result() -> Result:
    names = ("core_sd", "halo_diameter", "elastic_share", "halo_fraction")
    draws = np.tile([np.sqrt(1.3**2 - 1 / 12), 46.0, 0.3, 0.1], (12, 1))
    posterior = Posterior(names=names, units=("px", "px", "1", "1"), draws=draws)
    glare = measurement_from_sd("veiling_glare", "%", 2.0, 0.1, method="made")
    return Result(
        measurements=(
            measurement_from_draws(
                "halo_fraction", "1", draws[:, 3], method="made", posterior=posterior
            ),
            glare,
        )
    )


def test_the_spread_is_that_of_the_posterior_with_its_glare():
    spread = spread_from(result(), area_px=1000.0, rng=np.random.default_rng(1))
    assert spread.core_spread_px2 == pytest.approx(np.full(12, 1.3**2))
    assert np.mean(np.asarray(spread.glare_fraction)) == pytest.approx(0.02, abs=0.002)


def test_a_stack_is_mapped_and_written(tmp_path, seed):
    held = bloom_session(SCENE, (3.0, 300.0), np.random.default_rng(seed))
    found, signal = map_of(held, result(), context=CONTEXT)
    row, col = (round(one) for one in SCENE.centre)
    assert found.fraction[row, col + 12] > 0.8 > 0.3 > found.fraction[row, col]
    light = np.median(found.sources[0].light_dn_px)
    assert light == pytest.approx(SCENE.source_dn(300.0), rel=0.1)
    write_bloom_map(held, result(), CONTEXT, label="point-1", path=tmp_path / "map.npz")
    with np.load(tmp_path / "map.npz") as kept:
        np.testing.assert_array_equal(kept["fraction"], found.fraction)
        assert kept["signal_dn"].shape == signal.shape
    write_bloom_map(held, result(), CONTEXT, label=None, path=tmp_path / "map.png")
    assert (tmp_path / "map.png").read_bytes().startswith(b"\x89PNG")


def test_what_cannot_be_mapped_is_said_in_a_sentence(tmp_path, seed):
    held = bloom_session(SCENE, (3.0,), np.random.default_rng(seed))
    with pytest.raises(BadInput, match="point-9"):
        map_of(held, result(), label="point-9", context=CONTEXT)
    none = Result(
        measurements=(make_refusal("halo_diameter", "px", "no halo is visible", method="made"),)
    )
    with pytest.raises(BadInput, match="no halo is visible"):
        map_of(held, none, context=CONTEXT)
    with pytest.raises(BadInput, match="png"):
        write_bloom_map(held, result(), CONTEXT, label=None, path=tmp_path / "map.txt")
