"""Fixed patterns of the very camera whose maps are known: the one place that decides whether stages
take a map or draw a pattern from the parameters of the type.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labdata.camera.maps import NOISY, PixelMap
from simulate.arrays import Array32
from simulate.camera.grid import CameraFrame, Grid
from simulate.camera.video import NoFilter, VideoFilter, before_filter


@dataclass(frozen=True, kw_only=True, eq=False)
class SpecimenPatterns:
    """A draw of the maps of a camera, cut to its picture; None where the type's pattern stands.

    Maps show the picture behind the video filter, see `before_filter`.

    `response`: signal of each pixel over the mean; `offset_dn`,
    `dark_rate_dn_per_s`: its level above black, and what dark charge adds to it; `noise_dn`:
    standard deviation of its noise beyond that of other pixels; `shading`: of the light of flats,
    over its mean.
    """

    response: Array32 | None = None
    offset_dn: Array32 | None = None
    dark_rate_dn_per_s: Array32 | None = None
    noise_dn: Array32 | None = None
    # Parts of the standard deviations of the type's patterns, with light and without, that noise
    # hides in the maps: they are drawn.
    drawn_light: float = 1.0
    drawn_dark: float = 1.0
    shading: Array32 | None = None

    def charge_factor(self, video: Any) -> Array32 | None:
        """Return the response that the filter of a described video makes the map's."""
        if self.response is None:
            return None
        low_pass = VideoFilter.of(video) or NoFilter()
        return np.maximum(1.0 + before_filter(self.response - 1.0, low_pass), 0.0)

    def of_light(self, grid: Grid) -> Array32 | np.float32:
        """Return the shading of flats on cells; of a plane of a mosaic that of its samples."""
        if self.shading is None:
            return np.float32(1.0)
        counts = (
            (grid.rows, grid.per_row, grid.margin_rows),
            (
                grid.columns,
                grid.per_column,
                grid.margin_columns,
            ),
        )
        rows, cols = (
            np.clip(np.arange(cells) // per_pixel - margin, 0, pixels - 1) * size // pixels
            for (pixels, per_pixel, margin), cells, size in zip(
                counts, grid.shape, self.shading.shape, strict=True
            )
        )
        return self.shading[np.ix_(rows, cols)]


def patterns_of(camera: CameraFrame) -> SpecimenPatterns:
    """Return the draw of a camera's maps that its name gives."""
    maps = camera.description.maps
    if maps is None:
        return SpecimenPatterns()
    pitch_px, shape = maps.pitch_px, camera.shape
    shape = shape[0] // pitch_px, shape[1] // pitch_px

    def drawn(measured: PixelMap) -> NDArray[np.float32]:
        return maps.window(measured.draw(camera.pattern_seed), shape, neutral=np.nan)

    response = noise_dn = shading = None
    offset_dn, dark_rate_dn_per_s = (
        None if measured is None else np.nan_to_num(drawn(measured))
        for measured in (maps.offset_dn, maps.dark_rate_dn_per_s)
    )
    if (light := maps.light) is not None:
        smooth = maps.window(light.smooth.astype(np.float32), shape, neutral=1.0)
        response, shading = np.nan_to_num(drawn(light) / smooth, nan=1.0), smooth
    if maps.variance_dn2 is not None and maps.defect is not None:
        variance = maps.variance_dn2.value
        excess = np.maximum(variance - np.median(variance), 0.0) * (maps.defect & NOISY > 0)
        noise_dn = np.sqrt(maps.window(excess, shape, neutral=0.0))
    return SpecimenPatterns(
        response=response,
        offset_dn=offset_dn,
        dark_rate_dn_per_s=dark_rate_dn_per_s,
        noise_dn=noise_dn,
        drawn_light=1.0 if light is None else light.hidden_part,
        drawn_dark=max(
            (known.hidden_part for known in (maps.offset_dn, maps.dark_rate_dn_per_s) if known),
            default=1.0,
        ),
        shading=shading,
    )
