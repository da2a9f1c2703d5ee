"""The fibre taper: it demagnifies the screen onto the CCD, loses light, and shows its fibres."""

from dataclasses import dataclass

import numpy as np

from simulate.iiccd import pattern
from simulate.iiccd.light import Light
from simulate.iiccd.transfer import FibreTaper


@dataclass(frozen=True, kw_only=True)
class Taper:
    """Fibre-optic taper.

    Parameters
    ----------
    transmission
        Photons out per photon in, dimensionless.
    blur
        Its fibres and interfaces.
    pattern_contrast, pattern_pitch_um
        Depth and pitch, at the small end, of the dark lines between multi-fibres; the lines are one fibre wide.
    """

    transmission: float
    blur: FibreTaper
    pattern_contrast: float = 0.0
    pattern_pitch_um: float = 750.0
    name: str = "taper"
    takes: str = "screen photons"
    emits: str = "screen photons"

    def mean(self, light: Light) -> Light:
        """Return photons per cell at the small end, owing the blur.

        The pattern is laid on before the blurs still owed, which soften it a little more than in reality.
        """
        values = light.values * np.asarray(self.transmission, light.values.dtype)
        if self.pattern_contrast > 0.0 and light.grid is not None:
            line_mm = self.blur.fibre_pitch_um * 1e-3
            values *= pattern.honeycomb(
                light.grid, self.pattern_contrast, self.pattern_pitch_um * 1e-3, line_mm, self.blur.demagnification
            )
        return light.with_values(values).blurred(self.blur)

    def draw(self, light: Light, rng: np.random.Generator) -> Light:
        """Return the mean; the photons' noise is drawn where they are detected."""
        return self.mean(light)
