"""Fibre taper: demagnification, transmission, multi-fibre pattern, distortion and shear."""

from dataclasses import dataclass

import numpy as np

from simulate.iiccd import image_placement, pattern
from simulate.iiccd.stage_image import NoiselessStage, StageImage
from simulate.iiccd.transfer import StageBlur


@dataclass(frozen=True, kw_only=True)
class Taper(NoiselessStage):
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
        """Return photons per cell at the small end, with the blur pending.

        The pattern is applied before the pending blurs, which soften it slightly too much.
        """
        values = light.values * np.asarray(self.transmission, light.values.dtype)
        if self.pattern_contrast > 0.0 and light.grid is not None:
            pitch_mm, line_mm = self.pattern_pitch_um * 1e-3, self.line_um * 1e-3
            values *= pattern.multifibre_transmission(
                light.grid, self.pattern_contrast, pitch_mm, line_mm, self.demagnification
            )
        return light.with_values(values).with_blurs(self.blur)


@dataclass(frozen=True, kw_only=True)
class FibreGeometry(NoiselessStage):
    """Displacement of light by the fibres of the taper.

    Parameters
    ----------
    distortion_fraction
        Radial displacement at the image's corner, positive for pincushion, dimensionless.
    shear_um
        Offset of a line where it crosses from one multi-fibre to the next, root mean square, at the small end.
    pattern_pitch_um
        Pitch of the multi-fibres at the small end.
    demagnification
        Large end over small end.
    pattern_seed
        Seed of the shears.

    Notes
    -----
    The displacement is static and acts on pulses as on light, so it is laid on the *expected* photoelectrons before
    they are drawn: Poisson events displaced by a fixed map are Poisson events of the displaced mean (Kingman, Poisson
    Processes, 2.3), and the noise is drawn where it will lie. What this leaves out: pulses that straddle a border of
    multi-fibres are not cut in two, and the blur after the gain is not stretched by the few per cent of the distortion;
    nor are the fixed patterns of MCP and phosphor. Light is conserved under distortion; a shear leaves light per area
    as it is, as each multi-fibre carries what it sees.
    """

    distortion_fraction: float = 0.0
    shear_um: float = 0.0
    pattern_pitch_um: float = 750.0
    demagnification: float = 1.0
    pattern_seed: int = 0
    name: str = "fibre geometry"
    takes: str = "photoelectrons at the plate"
    emits: str = "photoelectrons at the plate"

    def mean(self, light: StageImage) -> StageImage:
        """Return the expected photoelectrons at the displaced positions, shape (row, col)."""
        grid = light.grid
        if grid is None or (self.distortion_fraction == 0.0 and self.shear_um == 0.0):
            return light
        x, y = np.broadcast_arrays(*image_placement.cell_centres(grid))
        if self.shear_um > 0.0:
            pitch_mm, rms_mm = (um * 1e-3 * self.demagnification for um in (self.pattern_pitch_um, self.shear_um))
            shift_x, shift_y = pattern.multifibre_offsets(grid, pitch_mm, rms_mm, self.pattern_seed)
            x, y = x - shift_x, y - shift_y
        radial = image_placement.Radial(fraction=self.distortion_fraction, corner_mm=image_placement.corner_mm(grid))
        from_x, from_y, area = radial.source(x, y)
        moved = image_placement.resample_image(light.values, grid, from_x, from_y, order=3)
        return light.with_values(moved * area.astype(np.float32))
