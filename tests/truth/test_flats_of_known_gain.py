"""The closed-form flats obey the cascade: mean, and a covariance sum that no blur after the gain
can change.
"""

import numpy as np
import pytest

from tests.truth.flats import FlatScene


def _summed_covariance_over_mean(scene: FlatScene, seed: int) -> tuple[float, float]:
    """Slope of block variance against the mean, and the standard error; a block sum takes in all
    its covariances.
    """
    rng = np.random.default_rng(seed)
    light = scene._light(scene.photoelectrons[0], rng)
    return float(np.var(light.sum(axis=(1, 2))) / light.mean() / light[0].size), float(
        np.sqrt(2 / len(light))
    )


@pytest.mark.parametrize("blur_px", [0.0, 1.0])
def test_covariance_sum_over_mean_is_k_f2_plus_electron_gain_whatever_the_blur(blur_px, seed):
    scene = FlatScene(rows=24, cols=24, frames=3000, blur_px=blur_px, photoelectrons=(6.0,))
    ratio, relative_error = _summed_covariance_over_mean(scene, seed)
    assert ratio == pytest.approx(scene.truth_covariance_gain, rel=4.5 * relative_error)


def test_mean_is_gain_times_photoelectrons(seed):
    scene = FlatScene(photoelectrons=(8.0,), frames=40)
    stack = scene.session_drawn(np.random.default_rng(seed)).stack("flat-1").read()
    expected = scene.black_dn + 8.0 * scene.photoelectron_gain_dn
    error = np.sqrt(
        scene.truth_covariance_gain * 8.0 * scene.photoelectron_gain_dn / stack.data.size
    )
    assert stack.data.mean() == pytest.approx(expected, abs=4.5 * error + 0.02)


def test_blur_after_the_gain_lowers_the_variance_but_not_the_light(seed):
    sharp, blurred = (
        FlatScene(blur_px=blur, photoelectrons=(8.0,))
        .session_drawn(np.random.default_rng(seed))
        .stack("flat-1")
        .read()
        for blur in (0.0, 1.0)
    )
    assert blurred.data.var() < 0.2 * sharp.data.var()
    assert blurred.data.mean() == pytest.approx(sharp.data.mean(), rel=0.01)
