"""The lens: it blurs the image on the photocathode and veils it with glare."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simulate.iiccd.stage_image import StageImage
from simulate.iiccd.transfer import StageBlur


@dataclass(frozen=True, kw_only=True)
class Optics:
    """Lens between the scene and the photocathode.

    Parameters
    ----------
    blur
        Its blur.
    veiling_glare_fraction
        Share of the light that is spread evenly over the picture, dimensionless.
    """

    blur: StageBlur
    veiling_glare_fraction: float
    name: str = "optics"
    takes: str = "photons"
    emits: str = "photons"

    def mean(self, light: StageImage) -> StageImage:
        """Return (1 - v) E + v mean(E), owing the blur; the light per cell keeps its sum."""
        return light.with_values(add_veiling_glare(light.values, self.veiling_glare_fraction)).blurred(self.blur)

    def draw(self, light: StageImage, rng: np.random.Generator) -> StageImage:
        """Return the mean: light has no noise of its own before it is detected."""
        return self.mean(light)


def add_veiling_glare(image: NDArray, fraction: float) -> NDArray:
    """Return (1 - v) E + v mean(E): a share of the light spread evenly."""
    level = image.mean(axis=(-2, -1), keepdims=True, dtype=np.float64)
    return (1.0 - fraction) * image + np.asarray(fraction * level, image.dtype)
