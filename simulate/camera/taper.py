"""Fibre taper: demagnification, transmission, multi-fibre pattern, distortion and shear."""

from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from labdata.conditions import Conditions
from simulate.camera import image_placement, pattern
from simulate.camera.chain import Slot, Stage, values_of
from simulate.camera.grid import ACCURACY, CameraFrame, Grid
from simulate.camera.stage_image import StageImage
from simulate.camera.transfer import FibreTaper, StageBlur


@dataclass(frozen=True, kw_only=True)
class Taper(
    Stage,
    slot=Slot.TAPER,
    section="taper",
    quantity="photons per exposure and cell",
    takes="screen photons",
    emits="screen photons",
):
    """Fibre-optic taper."""

    transmission: float  # photons out per photon in, dimensionless
    blur: StageBlur  # its fibres and interfaces
    # Depth, pitch and width, at the small end, of the dark lines between multi-fibres.
    pattern_contrast: float = 0.0
    pattern_pitch_um: float = 750.0
    line_um: float = 6.0
    demagnification: float = 1.0  # large end over small end
    effects: ClassVar = {"multi-fibre (chicken-wire) pattern": {"pattern_contrast": 0.0}}

    @classmethod
    def of(cls, camera: CameraFrame, conditions: Conditions) -> Self:
        taper = camera.description.taper
        blur = FibreTaper(
            fibre_pitch_um=float(taper.fibre_pitch_um),
            interface_lp_per_mm=float(taper.interface_mtf_lp_per_mm),
            demagnification=float(taper.demagnification),
        )
        # Fibres of both multi-fibres are squeezed where they meet.
        stage = values_of(cls, taper, blur=blur, line_um=2.0 * float(taper.fibre_pitch_um))
        if (drawn := camera.specimen.drawn_light) == 1.0 or stage.pattern_contrast == 0.0:
            return stage
        # A map of the pattern is 1 on average: the lines' loss of light stays.
        contrast = stage.pattern_contrast * drawn
        mapped = 1.0 - float(stage.lines(camera.cells).mean(dtype=float))
        passed = stage.transmission * (1.0 - (1.0 - drawn) * mapped)
        return replace(stage, transmission=passed, pattern_contrast=contrast)

    def lines(self, grid: Grid) -> NDArray[np.float32]:
        """Return the transmission of the lines between multi-fibres on cells."""
        return pattern.multifibre_transmission(
            grid,
            self.pattern_contrast,
            self.pattern_pitch_um * 1e-3,
            self.line_um * 1e-3,
            self.demagnification,
        )

    def mean(self, light: StageImage) -> StageImage:
        """Return photons per cell at the small end, with the blur pending.

        The pattern is applied before the pending blurs, which soften it slightly too much.
        """
        values = light.values * np.asarray(self.transmission, light.values.dtype)
        if self.pattern_contrast > 0.0 and light.grid is not None:
            values *= self.lines(light.grid)
        return light.with_values(values).with_blurs(self.blur)

    def bounds(self, budget: Any) -> dict[str, float]:
        """Return the influence of the dark lines: a change of gain by their depth."""
        return {"multi-fibre (chicken-wire) pattern": self.pattern_contrast * budget.of_gain(1.0)}


@dataclass(frozen=True, kw_only=True)
class FibreGeometry(
    Stage,
    slot=Slot.FIBRES,
    section="taper",
    quantity="photoelectrons at the plate per exposure and cell, expected where they will be seen",
    takes="photoelectrons at the plate",
    emits="photoelectrons at the plate",
):
    """Displacement of light by the fibres of the taper.

    Notes
    -----
    The displacement is static and acts on pulses as on light, so it is laid on the *expected*
    photoelectrons before they are drawn: Poisson events displaced by a fixed map are Poisson events
    of the displaced mean (Kingman, Poisson Processes, 2.3), and the noise is drawn where it will
    lie. What this leaves out: pulses that straddle a border of multi-fibres are not cut in two, and
    the blur after the gain is not stretched by the few per cent of the distortion; nor are the
    fixed patterns of MCP and phosphor. Light is conserved under distortion; a shear leaves light
    per area as it is, as each multi-fibre carries what it sees.
    """

    # Radial displacement at the image's corner, positive for pincushion, dimensionless.
    distortion_fraction: float = 0.0
    # Offset of a line where it crosses from one multi-fibre to the next, root mean square, at the
    # small end.
    shear_um: float = 0.0
    pattern_pitch_um: float = 750.0  # pitch of the multi-fibres at the small end
    demagnification: float = 1.0  # large end over small end
    pattern_seed: int = 0  # seed of the shears
    effects: ClassVar = {
        "taper distortion and fibre shear": {"distortion_fraction": 0.0, "shear_um": 0.0}
    }

    @classmethod
    def of(cls, camera: CameraFrame, conditions: Conditions) -> Self:
        return values_of(cls, camera.description.taper, pattern_seed=camera.pattern_seed)

    def mean(self, light: StageImage) -> StageImage:
        """Return the expected photoelectrons at the displaced positions, shape (row, col)."""
        grid = light.grid
        if grid is None or (self.distortion_fraction == 0.0 and self.shear_um == 0.0):
            return light
        x, y = np.broadcast_arrays(*image_placement.cell_centres(grid))
        if self.shear_um > 0.0:
            pitch_mm, rms_mm = (
                um * 1e-3 * self.demagnification for um in (self.pattern_pitch_um, self.shear_um)
            )
            shift_x, shift_y = pattern.multifibre_offsets(grid, pitch_mm, rms_mm, self.pattern_seed)
            x, y = x - shift_x, y - shift_y
        radial = image_placement.Radial(
            fraction=self.distortion_fraction, corner_mm=image_placement.corner_mm(grid)
        )
        from_x, from_y, area = radial.source(x, y)
        displaced = image_placement.resample_image(light.values, grid, from_x, from_y, order=3)
        return light.with_values(displaced * area.astype(np.float32))

    def bounds(self, budget: Any) -> dict[str, float]:
        return {"taper distortion and fibre shear": budget.of_light(self._largest_change(budget))}

    def _largest_change(self, budget: Any) -> NDArray[np.float64]:
        """Bound on the change of each pixel: the range of values within the extent of the
        displacement.

        Distortion by D (r/R)^2 moves light by D r^3/R^2 and stretches areas by the factor (1 + D
        s^2)(1 + 3 D s^2), about 4 D s^2 with s = r/R. A multi-fibre is off by half the root mean
        square by which neighbours differ, in x and in y.
        """
        from scipy.ndimage import maximum_filter, minimum_filter

        (frame_rows, frame_cols), cells, surroundings = (
            budget.camera.shape,
            budget.camera.cells,
            budget.surroundings,
        )
        distortion, rings = abs(self.distortion_fraction), ACCURACY.n_distortion_rings
        y = (
            np.arange(surroundings.shape[0]) - ACCURACY.scene_margin_px - 0.5 * (frame_rows - 1)
        ) * cells.pitch_y_mm
        x = (
            np.arange(surroundings.shape[1]) - ACCURACY.scene_margin_px - 0.5 * (frame_cols - 1)
        ) * cells.pitch_x_mm
        corner_mm = image_placement.corner_mm(cells)
        radius = budget.frame_of(np.hypot(y[:, None], x[None, :])) / corner_mm
        hexagons = (
            surroundings.size
            * cells.pitch_x_mm
            * cells.pitch_y_mm
            / (self.pattern_pitch_um * 1e-3) ** 2
        )
        shear_mm = (
            0.5 * budget.extreme(2.0 * hexagons) * self.shear_um * 1e-3 * self.demagnification
        )
        area_change = (1.0 + distortion * radius**2) * (1.0 + 3.0 * distortion * radius**2) - 1.0
        change = np.zeros(budget.mean_pe.shape)
        for ring in range(rings):
            far_mm = distortion * ((ring + 1) / rings) ** 3 * corner_mm + shear_mm
            extent_px = [
                2 * int(np.ceil(far_mm / pitch)) + 1
                for pitch in (cells.pitch_y_mm, cells.pitch_x_mm)
            ]
            span = budget.frame_of(
                maximum_filter(surroundings, extent_px) - minimum_filter(surroundings, extent_px)
            )
            in_ring = (radius >= ring / rings) & (
                (radius < (ring + 1) / rings) | (ring == rings - 1)
            )
            change[in_ring] = span[in_ring]
        return change + area_change * budget.mean_pe
