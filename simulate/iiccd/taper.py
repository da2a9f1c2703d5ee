"""The fibre taper: it demagnifies the screen onto the CCD, loses light, and shows its fibres."""

from dataclasses import dataclass

import numpy as np

from simulate.iiccd import pattern
from simulate.iiccd.stage_image import StageImage
from simulate.iiccd.transfer import StageBlur


@dataclass(frozen=True, kw_only=True)
class Taper:
    """Fibre-optic taper.

    Parameters
    ----------
    transmission
        Photons out per photon in, dimensionless.
    blur
        Its fibres and interfaces.
    pattern_contrast, pattern_pitch_um, line_um
        Depth, pitch and width, at the small end, of the dark lines between multi-fibres.
    demagnification
        Large end over small end.
    """

    transmission: float
    blur: StageBlur
    pattern_contrast: float = 0.0
    pattern_pitch_um: float = 750.0
    line_um: float = 6.0
    demagnification: float = 1.0
    name: str = "taper"
    takes: str = "screen photons"
    emits: str = "screen photons"

    def mean(self, light: StageImage) -> StageImage:
        """Return photons per cell at the small end, owing the blur.

        The pattern is laid on before the blurs still owed, which soften it a little more than in reality.
        """
        values = light.values * np.asarray(self.transmission, light.values.dtype)
        if self.pattern_contrast > 0.0 and light.grid is not None:
            pitch_mm, line_mm = self.pattern_pitch_um * 1e-3, self.line_um * 1e-3
            values *= pattern.multifibre_transmission(
                light.grid, self.pattern_contrast, pitch_mm, line_mm, self.demagnification
            )
        return light.with_values(values).blurred(self.blur)

    def draw(self, light: StageImage, rng: np.random.Generator) -> StageImage:
        """Return the mean; the photons' noise is drawn where they are detected."""
        return self.mean(light)
