"""The window of a bar target: wide enough for its blur, and what the tails still carry beyond it."""

import numpy as np
from numpy.typing import NDArray

from charact.method import Context
from charact.mtf.bars.target import BarTarget
from charact.mtf.blur_models import transfer as forms
from charact.mtf.known_transfer import halo_diameters_px
from labdata.camera_description import Parameter

Array = NDArray[np.float64]

BEYOND_HALO_PX = 12.0
WINDOW_MARGIN_PX = 12.0
PRIOR_DRAWS = 200
SD_OF_RANGE = 2.0 * 1.959964


def margin_px(context: Context, frequency: float) -> float:
    """Return how far the window should reach beyond the bars: over the halo, where the camera has one."""
    own = max(WINDOW_MARGIN_PX, 1.5 / frequency)
    if context.sensor is None:
        return own
    return max(own, 0.5 * halo_diameters_px(context, transposed=False)[1] + BEYOND_HALO_PX)


def fitting_margin(target: BarTarget, shape: tuple[int, int], wanted: float) -> tuple[float, bool]:
    """Return the widest margin up to the one wanted at which the window fits, and whether it is less."""
    for margin in np.linspace(wanted, 2.0, 24):
        inside = target.box(shape, float(margin))
        across, along = target.coordinates(shape)
        reach = (np.abs(across).max(), np.abs(along).max())
        fits = reach[0] > target.width_px / 2 + margin and reach[1] > target.length_px / 2 + margin
        touches = inside[0].any() or inside[-1].any() or inside[:, 0].any() or inside[:, -1].any()
        if fits and not touches:
            return float(margin), margin < wanted - 1e-9
    return 2.0, True


def lost_fraction(context: Context, margin: float) -> tuple[float, float]:
    """Return the share of the light that the tails carry beyond the window, and its standard deviation.

    Parameters
    ----------
    context
        The camera's ranges; without a camera nothing is known and nothing is taken off.
    margin
        Reach of the window beyond the bars, column pitches.

    Notes
    -----
    Of light spread with the transfer M the part further off than X is 1 - (2/pi) int M(f) sin(2 pi f X)/f df; a window
    loses it on both pairs of sides. Drawn over the ranges of the tube and its halo.
    """
    if context.sensor is None:
        return 0.0, 0.0
    sensor = context.sensor
    rng = np.random.default_rng(0)
    pitch_mm = float(sensor.ccd.pitch_x_um) * 1e-3 * float(sensor.taper.demagnification)
    corner = _draw_parameter(sensor.tube.mtf_frequency_lp_per_mm, rng) * pitch_mm
    exponent = _draw_parameter(sensor.tube.mtf_exponent, rng)
    diameter = 4.0 * _draw_parameter(sensor.photocathode.gap_mm, rng) / pitch_mm
    share = _draw_parameter(sensor.photocathode.halo_fraction, rng)
    elastic = _draw_parameter(sensor.photocathode.halo_elastic_share, rng)
    f = np.asarray((np.arange(16384) + 0.5) / 8192.0, dtype=np.float64)
    kernel = np.sin(2.0 * np.pi * f * margin) / f * (f[1] - f[0])
    core = np.exp(-((f / corner[:, None]) ** exponent[:, None]))
    both = core * (1.0 - share[:, None] + share[:, None] * forms.halo(f, diameter, elastic))
    outside = 2.0 * (1.0 - 2.0 / np.pi * both @ kernel)
    return float(outside.mean()), float(max(outside.std(), 0.25 * abs(outside.mean())))


def _draw_parameter(parameter: Parameter, rng: np.random.Generator) -> Array:
    if parameter.low is None or parameter.high is None:
        return np.full(PRIOR_DRAWS, parameter.value)
    sd = (parameter.high - parameter.low) / SD_OF_RANGE
    return np.clip(rng.normal(parameter.value, sd, PRIOR_DRAWS), parameter.low, parameter.high)
