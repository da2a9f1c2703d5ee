"""Location of bars that cross a complete region, whose ends are not visible."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from charact.mtf.bars.bar_spectrum import BarShape, table_of
from charact.mtf.bars.forms import TUBE
from charact.mtf.bars.target import BarTarget, blank_target

Array = NDArray[np.float64]

# Directions tried about the grid's axes, and the likeness that noise alone does not reach.
TILTS_DEG = np.arange(-12.0, 12.1, 1.0)
BIN_PX = 0.5
LEAST_LIKENESS_SD = 6.0
# Light at both ends of a region over that in its middle from which the bars run through, and the depth of an end.
RUNS_THROUGH, END_SHARE = 0.6, 8
TYPICAL = {"log_attenuation": -0.4, "form": TUBE, "form_one": TUBE.start[0], "form_two": 0.0, "departure": 0.0}


def spans_region(image: Array, *, bars: int, frequency: float) -> bool:
    """Return whether a patch of light as wide as the bars meets two opposite borders of a region."""
    from scipy.ndimage import uniform_filter1d

    for picture in (image, image.T):
        depth = max(picture.shape[0] // END_SHARE, 2)
        width = int(min(bars / frequency, 0.6 * picture.shape[1])) or 1
        middle = (picture.shape[0] - depth) // 2
        bands = [picture[top : top + depth].mean(axis=0) for top in (0, middle, picture.shape[0] - depth)]
        height = [float(np.ptp(uniform_filter1d(band, width))) for band in bands]
        if min(height[0], height[2]) > RUNS_THROUGH * height[1]:
            return True
    return False


def strip_of(image: Array, *, bars: int, frequency: float, pitch_ratio: float) -> BarTarget | None:
    """Return the target that crosses a region along either axis, or None.

    Parameters
    ----------
    image
        Mean frame, shape (row, col).

    Notes
    -----
    The mean profile along each trial direction is correlated with that of the bars under a typical blur.
    """
    middle = ((image.shape[0] - 1) / 2.0, (image.shape[1] - 1) / 2.0)
    blank = replace(blank_target(bars, frequency, pitch_ratio), row=middle[0], col=middle[1])
    template = _template(blank)
    found = [
        _best(image, replace(blank, angle_rad=float(np.deg2rad(axis + tilt))), template)
        for axis in (0.0, 90.0)
        for tilt in TILTS_DEG
        if image.shape[int(axis == 0.0)] * (1.0 if axis == 0.0 else pitch_ratio) > blank.width_px
    ]
    likeness, target = max(found, key=lambda one: one[0], default=(0.0, None))
    return target if likeness > LEAST_LIKENESS_SD else None


def _best(image: Array, target: BarTarget, template: Array) -> tuple[float, BarTarget]:
    """Return the match of the profile along one direction in standard uncertainties, and the target there."""
    across, _ = target.coordinates((image.shape[0], image.shape[1]))
    first = float(np.floor(across.min()))
    place = ((across - first) / BIN_PX).astype(np.intp).ravel()
    count = np.bincount(place)
    values = (image - np.median(image)).ravel()
    profile = np.bincount(place, values)
    filled = count > 0
    mean = profile[filled].sum() / count.sum()
    profile = np.where(filled, profile - mean * count, 0.0)
    if template.size >= profile.size:
        return 0.0, target
    # Least squares of the template at each shift, with a free mean.
    weight = np.correlate(count.astype(float), np.ones(template.size), "valid")
    cross = np.correlate(profile, template, "valid")
    own = np.correlate(count.astype(float), template, "valid")
    square = np.correlate(count.astype(float), template**2, "valid")
    inner = np.correlate(profile, np.ones(template.size), "valid")
    power = np.maximum(square - own**2 / np.maximum(weight, 1.0), 1e-9)
    signed = cross - own * inner / np.maximum(weight, 1.0)
    gain = signed**2 / power
    best = int(np.argmax(gain))
    spread = float(np.sum(values**2) / values.size - (values.mean()) ** 2)
    centre = first + (best + template.size / 2.0) * BIN_PX
    moved = replace(
        target,
        sign=1 if signed[best] > 0 else -1,
        col=target.col + centre * np.cos(target.angle_rad),
        row=target.row + centre * np.sin(target.angle_rad) / target.pitch_ratio,
    )
    left = max(spread * values.size - float(gain[best]), 1e-9)
    return float(np.sqrt(gain[best] / (left / values.size))), moved


def _template(target: BarTarget) -> Array:
    """Return the profile of the bars under a typical blur, at bin centres."""
    half = target.width_px / 2.0 + 0.75 / target.frequency
    shape = BarShape(
        bars=target.bars, frequency=target.frequency, length_px=np.inf, reference=target.frequency, angle_rad=0.0,
        **TYPICAL,
    )  # fmt: skip
    places = (np.arange(int(2 * half / BIN_PX)) + 0.5) * BIN_PX
    places = places - places.mean()
    return table_of(shape, half, 1.0).at(places, places)[0]
