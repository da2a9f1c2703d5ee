"""Image of N bars: their exact spectrum through a blur model and the pixel aperture."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from charact.mtf.bars.forms import BarBlurModel
from charact.mtf.blur_models import transfer as forms

Array = NDArray[np.float64]

# Highest frequencies of the picture's spectrum, cycles per pixel.
HIGHEST_ACROSS, HIGHEST_ALONG = 1.5, 1.0
# Rows of its table: this close at the bars' ends, px, and wider by this share of the distance from them.
STEP_AT_ENDS_PX, WIDENING = 0.18, 0.08
# A table across the bars has this many points a period; straight lines between them lose a few ten-thousandths.
POINTS_A_PERIOD = 100


@dataclass(frozen=True, kw_only=True)
class BarShape:
    """Shape parameters of an image of bars, without position.

    Parameters
    ----------
    bars
        Number N.
    frequency
        Cycles per pixel across the bars, f = 1/P.
    length_px
        Length of the bars; infinite: they cross the complete region.
    reference
        Frequency at which the MTF is reported, cycles per pixel.
    log_attenuation
        ln(-ln c), c the core's transfer at the reference frequency, before the pixel.
    form, form_one, form_two
        Blur model, and its two parameters.
    departure
        Relative departure of the transfer from the blur model around the bar frequency.
    angle_rad
        Direction across the bars, for the pixel's aperture.
    """

    bars: int
    frequency: float
    length_px: float
    reference: float
    log_attenuation: float
    form: BarBlurModel
    form_one: float
    form_two: float
    departure: float
    angle_rad: float

    @property
    def pixel(self) -> float:
        """Transfer of the pixel at the reference frequency."""
        return float(forms.aperture(np.array([self.reference]), self.angle_rad)[0])

    @property
    def mtf(self) -> float:
        """MTF at the reference frequency, pixel included."""
        return self.pixel * float(np.exp(-np.exp(self.log_attenuation))) * (1.0 + self.departure)


@dataclass(frozen=True, kw_only=True)
class Table:
    """One quadrant of an image, which is even in both coordinates of the bars, tabulated.

    Parameters
    ----------
    step_across_px
        Step across the bars, px.
    along_px
        Distance along the bars of each row, px; one row: the image does not vary along them.
    values
        Image, 1 on a wide bar, and its derivatives by log attenuation, both model parameters, departure, ln(frequency)
        and ln(length), shape (7, along, across).
    """

    step_across_px: float
    along_px: Array
    values: Array

    def at(self, across: Array, along: Array) -> Array:
        """Return image, the six derivatives, and the slopes across and along, at points, shape (9, point)."""
        _, rows, cols = self.values.shape
        x = np.minimum(np.abs(across) / self.step_across_px, cols - 1.001)
        i = x.astype(np.intp)
        x = x - i
        if rows == 1:
            left, right = self.values[:, 0, i], self.values[:, 0, i + 1]
            slope = (right - left)[:1] * (np.sign(across) / self.step_across_px)
            return np.concatenate([left + x * (right - left), slope, np.zeros_like(slope)])
        far = np.minimum(np.abs(along), self.along_px[-1])
        j = np.clip(np.searchsorted(self.along_px, far, side="right") - 1, 0, rows - 2)
        gap = (self.along_px[1:] - self.along_px[:-1])[j]
        y = (far - self.along_px[j]) / gap
        place = j * cols + i
        flat = self.values.reshape(len(self.values), -1)
        a, b, c, d = (np.take(flat, place + shift, axis=1) for shift in (0, 1, cols, cols + 1))
        low, high = a + x * (b - a), c + x * (d - c)
        across_slope = (b - a)[:1] + y * ((d - c)[:1] - (b - a)[:1])
        return np.concatenate(
            [
                low + y * (high - low),
                across_slope * (np.sign(across) / self.step_across_px),
                (high - low)[:1] * (np.sign(along) / gap),
            ]
        )


def table_of(shape: BarShape, half_across_px: float, half_along_px: float) -> Table:
    """Return the table of an image up to a distance from its centre.

    Notes
    -----
    Across the bars, u, the spectrum of N bars is w sinc(u w) sin(pi N u P) / sin(pi u P), along them L sinc(L v). The
    transfer is that of a blur model at r = |(u, v)|, c at f, times the pixel's two sincs in its own directions. Around
    f, over the width f/N in which the bars have light, it may depart from the model by a fraction.
    """
    from scipy.fft import irfft, next_fast_len

    period = float(next_fast_len(int(2.2 * half_across_px) + 16, True) or 0)
    step = 2.0 ** -max(3.0, np.ceil(np.log2(POINTS_A_PERIOD * shape.frequency)))
    u = np.arange(int(HIGHEST_ACROSS * period)) / period
    comb, comb_slope = _comb(shape, u)
    if np.isinf(shape.length_px):
        nodes = np.zeros(1)
        rows = _transfers(shape, u, nodes)[..., 0][:, None]
        longer = np.zeros_like(rows[0])
    else:
        nodes = _rows(shape.length_px, half_along_px)
        v, weight, weight_slope = _along(shape.length_px, nodes)
        transfers = _transfers(shape, u, v)
        rows = np.swapaxes(transfers @ weight, 1, 2)
        longer = (transfers[0] @ weight_slope).T * comb
    near = np.exp(-0.5 * ((u / shape.frequency - 1.0) * 2.0 * shape.bars) ** 2)
    family = rows[0] * comb
    rows = rows * (1.0 + shape.departure * near)
    spectrum = np.stack([*(rows * comb), family * near, rows[0] * comb_slope, longer])
    values = np.asarray(irfft(spectrum, int(period / step), axis=-1))[..., : int(half_across_px / step) + 2] / step
    return Table(step_across_px=step, along_px=nodes, values=np.ascontiguousarray(values))


def _rows(length_px: float, half_px: float) -> Array:
    """Return the rows of the table: dense at the bars' ends, 0 and the largest distance included."""
    nodes = [length_px / 2.0]
    while nodes[-1] < half_px + 1.0:
        nodes.append(nodes[-1] + STEP_AT_ENDS_PX + WIDENING * (nodes[-1] - length_px / 2.0))
    while nodes[0] > 0.0:
        nodes.insert(0, nodes[0] - STEP_AT_ENDS_PX - WIDENING * (length_px / 2.0 - nodes[0]))
    return np.array([0.0, *[node for node in nodes if node > 0.25 * STEP_AT_ENDS_PX]])


def _along(length_px: float, nodes: Array) -> tuple[Array, Array, Array]:
    """Return frequencies along the bars, and their weights in every row and in its derivative by ln(length)."""
    tall = float(int(2.2 * nodes[-1]) + 16)
    v = np.arange(int(HIGHEST_ALONG * tall)) / tall
    wave = np.cos(2.0 * np.pi * v[:, None] * nodes) * (2.0 - (v == 0))[:, None] * length_px / tall
    return v, np.sinc(length_px * v)[:, None] * wave, np.cos(np.pi * length_px * v)[:, None] * wave


def _comb(shape: BarShape, u: Array) -> tuple[Array, Array]:
    """Return the spectrum of the bars across them, px, and its derivative by ln(frequency)."""
    width = 0.5 / shape.frequency
    places = (np.arange(shape.bars) - (shape.bars - 1) / 2.0)[:, None] / shape.frequency
    turn = 2.0 * np.pi * places * u
    bar, repeats = width * np.sinc(width * u), np.cos(turn).sum(axis=0)
    return bar * repeats, bar * (turn * np.sin(turn)).sum(axis=0) - width * np.cos(np.pi * width * u) * repeats


def _transfers(shape: BarShape, u: Array, v: Array) -> Array:
    """Return the transfer and its derivatives by log attenuation and both model parameters, shape (4, u, v)."""
    ln_ratio = np.log(np.maximum(np.hypot(u[:, None], v) / shape.reference, 1e-9))
    core = shape.form.slopes(ln_ratio, float(np.exp(shape.log_attenuation)), shape.form_one, shape.form_two)
    core[0] = np.exp(core[0]) * _pixel(shape.angle_rad, u.size, float(u[1]), v.size, float(v[-1]))
    core[1:] *= core[0]
    return core


@lru_cache(maxsize=4)
def _pixel(angle_rad: float, across: int, step: float, along: int, highest: float) -> Array:
    """Return the pixel's transfer at frequencies across and along the bars, cached for an unchanged grid.

    A rotated pixel is not symmetric along the bars: the mean over both senses applies to sums over them.
    """
    u, v = step * np.arange(across)[:, None], np.linspace(0.0, highest, along)
    cosine, sine = np.cos(angle_rad), np.sin(angle_rad)
    one, other = (
        np.sinc(u * cosine - sense * v * sine) * np.sinc(u * sine + sense * v * cosine) for sense in (1.0, -1.0)
    )
    return 0.5 * (one + other)
