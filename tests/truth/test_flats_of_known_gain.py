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
