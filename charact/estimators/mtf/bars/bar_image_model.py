"""Likelihood of a bar target: image as a function of its parameters, and their priors."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from charact.estimators.mtf.bars.target import BarTarget
from charact.estimators.mtf.bars.thresholds import ACCURACY
from charact.transfer.cores import ON_BARS
from charact.transfer.form import BarForm
from charact.transfer.stages import aperture
from labdata import Array, Mask

NAMES = (
    "log_attenuation",
    "form_one",
    "form_two",
    "departure",
    "log_frequency",
    "log_length",
    "log_width",
    "log_aspect",
    "across_px",
    "along_px",
    "angle_rad",
    "level_dn",
    "pedestal_dn",
    "slope_across",
    "slope_along",
)
SHAPES = NAMES[:8]
ALONG = ("log_length", "log_aspect", "along_px")
# Prior standard deviations: frequency (STANAG 4349: 5 %) and length, relative.
FREQUENCY_SD, LENGTH_SD = 0.02, 0.35
# The same of a bar's width over half a period, and of the blur along the bars over that across.
WIDTH_SD, ASPECT_SD = 0.01, 0.2
# Prior standard deviation of the model departure: relative to the transfer, and absolute.
DEPARTURE_SD, DEPARTURE_FLOOR = 0.015, 0.002
BOUNDS = {
    "log_attenuation": (-9.0, 2.3),
    "departure": (-0.9, 5.0),
    # Far beyond any target: bounds the size of the image when other objects are fitted.
    "log_frequency": (float(np.log(1e-3)), 0.0),
    "log_length": (0.0, float(np.log(4e3))),
    "log_width": (-0.3, 0.3),
    "log_aspect": (-1.5, 1.5),
}


@dataclass(frozen=True, kw_only=True)
class BarShape:
    """Shape parameters of an image of bars, without position."""

    bars: int  # Number N
    frequency: float  # Cycles per pixel across the bars, f = 1/P
    length_px: float  # Length of the bars; infinite: they cross the complete region
    reference: float  # Frequency at which the MTF is reported, cycles per pixel
    # ln(-ln c), c the core's transfer at the reference frequency, before the pixel
    log_attenuation: float
    # form, form_one, form_two: blur model, and its two parameters
    form: BarForm
    form_one: float
    form_two: float
    # Relative departure of the transfer from the blur model around the bar frequency
    departure: float
    angle_rad: float  # Direction across the bars, for the pixel's aperture
    log_width: float = 0.0  # ln of a bar's width over half a period
    log_aspect: float = 0.0  # ln of the blur along the bars over that across them

    @property
    def pixel(self) -> float:
        """Transfer of the pixel at the reference frequency."""
        return float(aperture(np.array([self.reference]), self.angle_rad)[0])

    @property
    def mtf(self) -> float:
        """MTF at the reference frequency, pixel included."""
        return self.pixel * float(np.exp(-np.exp(self.log_attenuation))) * (1.0 + self.departure)


@dataclass(frozen=True, kw_only=True)
class Table:
    """One quadrant of an image, which is even in both coordinates of the bars, tabulated."""

    step_across_px: float  # Step across the bars, px
    # Distance along the bars of each row, px; one row: the image does not vary along them
    along_px: Array
    # Image, 1 on a wide bar, and its derivatives by `SHAPES`, shape (9, along, across)
    values: Array

    def at(self, across: Array, along: Array) -> Array:
        """Return image, its derivatives, and the slopes across and along, at points, shape (11,
        point).
        """
        _, rows, cols = self.values.shape
        x = np.minimum(np.abs(across) / self.step_across_px, cols - 1.001)
        i = x.astype(np.intp)
        x = x - i
        if rows == 1:
            lower, upper = self.values[:, 0, i], self.values[:, 0, i + 1]
            slope = (upper - lower)[:1] * (np.sign(across) / self.step_across_px)
            return np.concatenate([lower + x * (upper - lower), slope, np.zeros_like(slope)])
        distance = np.minimum(np.abs(along), self.along_px[-1])
        j = np.clip(np.searchsorted(self.along_px, distance, side="right") - 1, 0, rows - 2)
        gap = (self.along_px[1:] - self.along_px[:-1])[j]
        y = (distance - self.along_px[j]) / gap
        position = j * cols + i
        flat = self.values.reshape(len(self.values), -1)
        a, b, c, d = (np.take(flat, position + shift, axis=1) for shift in (0, 1, cols, cols + 1))
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
    Across the bars, u, the spectrum of N bars is w sinc(u w) sin(pi N u P) / sin(pi u P), along
    them L sinc(L v). The transfer is that of a blur model at r = |(u, a v)|, c at f, times the
    pixel's two sincs in its own directions; a is the blur along the bars over that across them.
    Around f, over the width f/N in which the bars have light, it may depart from the model by a
    fraction.
    """
    from scipy.fft import irfft, next_fast_len

    period = float(next_fast_len(int(2.2 * half_across_px) + 16, True) or 0)
    step = 2.0 ** -max(3.0, np.ceil(np.log2(100 * shape.frequency)))
    highest_u, highest_v = _highest_frequencies(shape)
    u = np.arange(int(highest_u * period)) / period
    comb, comb_slope, comb_widens = _comb(shape, u)
    if np.isinf(shape.length_px):
        nodes = np.zeros(1)
        rows = _transfers(shape, u, nodes)[..., 0][:, None]
        longer = np.zeros_like(rows[0])
    else:
        nodes = _rows(shape.length_px, half_along_px)
        v, weight, weight_slope = _along(shape.length_px, nodes, highest_v)
        transfers = _transfers(shape, u, v)
        rows = np.swapaxes(transfers @ weight, 1, 2)
        longer = (transfers[0] @ weight_slope).T * comb
    bar_lobe = np.exp(-0.5 * ((u / shape.frequency - 1.0) * 2.0 * shape.bars) ** 2)
    family = rows[0] * comb
    rows = rows * (1.0 + shape.departure * bar_lobe)
    spectra = np.stack(
        [
            *(rows[:4] * comb),
            family * bar_lobe,
            rows[0] * comb_slope,
            longer,
            rows[0] * comb_widens,
            rows[4] * comb,
        ]
    )
    values = (
        np.asarray(irfft(spectra, int(period / step), axis=-1))[
            ..., : int(half_across_px / step) + 2
        ]
        / step
    )
    return Table(step_across_px=step, along_px=nodes, values=np.ascontiguousarray(values))


def _rows(length_px: float, half_px: float) -> Array:
    """Return the rows of the table: dense at the bars' ends, 0 and the largest distance
    included.
    """
    nodes = [length_px / 2.0]
    while nodes[-1] < half_px + 1.0:
        nodes.append(
            nodes[-1]
            + ACCURACY.row_step_px
            + ACCURACY.row_step_growth * (nodes[-1] - length_px / 2.0)
        )
    while nodes[0] > 0.0:
        nodes.insert(
            0,
            nodes[0]
            - ACCURACY.row_step_px
            - ACCURACY.row_step_growth * (length_px / 2.0 - nodes[0]),
        )
    return np.array([0.0, *[node for node in nodes if node > 0.25 * ACCURACY.row_step_px]])


def _highest_frequencies(shape: BarShape) -> tuple[float, float]:
    """Return the frequencies across and along the bars up to which their image has light, cy/px.

    The pixel alone falls as 1/f: without a blur its image needs several cycles per pixel.
    """
    attenuation = float(np.exp(shape.log_attenuation))
    ln_core = shape.form.ln(
        np.log([1.0 / shape.reference]), attenuation, shape.form_one, shape.form_two
    )
    blurred = ln_core[0] < np.log(ACCURACY.negligible_transfer)
    return ACCURACY.highest_cy_per_px if blurred else ACCURACY.highest_sharp_cy_per_px


def _along(length_px: float, nodes: Array, highest: float) -> tuple[Array, Array, Array]:
    """Return frequencies along the bars, and their weights in every row and in its derivative by
    ln(length).
    """
    tall = float(int(2.2 * nodes[-1]) + 16)
    v = np.arange(int(highest * tall)) / tall
    wave = np.cos(2.0 * np.pi * v[:, None] * nodes) * (2.0 - (v == 0))[:, None] * length_px / tall
    return v, np.sinc(length_px * v)[:, None] * wave, np.cos(np.pi * length_px * v)[:, None] * wave


def _comb(shape: BarShape, u: Array) -> tuple[Array, Array, Array]:
    """Return the spectrum of the bars across them, px, and its derivatives by ln(frequency) and
    ln(width).
    """
    width = 0.5 * np.exp(shape.log_width) / shape.frequency
    positions = (np.arange(shape.bars) - (shape.bars - 1) / 2.0)[:, None] / shape.frequency
    turn = 2.0 * np.pi * positions * u
    bar, repeats = width * np.sinc(width * u), np.cos(turn).sum(axis=0)
    widens = width * np.cos(np.pi * width * u) * repeats
    return bar * repeats, bar * (turn * np.sin(turn)).sum(axis=0) - widens, widens


def _transfers(shape: BarShape, u: Array, v: Array) -> Array:
    """Return the transfer and its derivatives by log attenuation, both model parameters and log
    aspect, shape (5, u, v).
    """
    u_squared, v_squared = u[:, None] ** 2, (np.exp(shape.log_aspect) * v) ** 2
    r_squared = np.maximum(u_squared + v_squared, (1e-9 * shape.reference) ** 2)
    ln_ratio = 0.5 * np.log(r_squared / shape.reference**2)
    core = shape.form.derivatives(
        ln_ratio, float(np.exp(shape.log_attenuation)), shape.form_one, shape.form_two
    )
    core[0] = np.exp(core[0]) * _pixel(shape.angle_rad, u.size, float(u[1]), v.size, float(v[-1]))
    core[4] *= v_squared / r_squared
    core[1:] *= core[0]
    return core


@lru_cache(maxsize=4)
def _pixel(angle_rad: float, across: int, step: float, along: int, highest: float) -> Array:
    """Return the pixel's transfer at frequencies across and along the bars, cached for an unchanged
    grid.

    A rotated pixel is not symmetric along the bars: the mean over both senses applies to sums over
    them.
    """
    u, v = step * np.arange(across)[:, None], np.linspace(0.0, highest, along)
    cosine, sine = np.cos(angle_rad), np.sin(angle_rad)
    shear, counter_shear = (
        np.sinc(u * cosine - sense * v * sine) * np.sinc(u * sine + sense * v * cosine)
        for sense in (1.0, -1.0)
    )
    return 0.5 * (shear + counter_shear)


@dataclass(frozen=True, kw_only=True)
class BarLikelihood:
    """Pixels of a window with their variances, and the blur model."""

    image: Array
    window: Mask
    variance: Array
    asked: float
    length_px: float
    strip: bool
    form: BarForm = ON_BARS[0]

    @classmethod
    def of(
        cls, image: Array, window: Mask, target: BarTarget, asked: float, *, strip: bool = False
    ) -> "BarLikelihood":
        """Return the likelihood of a target in a mean frame before its noise is known."""
        variance = np.full(np.count_nonzero(window), float(image[window].var()) or 1.0)
        return cls(
            image=image,
            window=window,
            variance=variance,
            asked=asked,
            length_px=target.length_px,
            strip=strip,
        )

    @property
    def names(self) -> tuple[str, ...]:
        """Parameters; bars that cross the region have no ends."""
        return tuple(name for name in NAMES if not (self.strip and name in ALONG))

    @property
    def bounds(self) -> dict[str, tuple[float, float]]:
        """Bounds of the parameters that have any."""
        return {**BOUNDS, "form_one": self.form.bounds[0], "form_two": self.form.bounds[1]}


def priors(problem: BarLikelihood, mtf: float) -> tuple[Array, Array]:
    """Return mean and precision of the normal prior of each parameter; precision 0: none."""
    known = {
        "form_one": (problem.form.first.mean, problem.form.first.sd),
        "form_two": (problem.form.second.mean, problem.form.second.sd),
        "departure": (0.0, DEPARTURE_SD + DEPARTURE_FLOOR / max(mtf, 1e-3)),
        "log_frequency": (np.log(problem.asked), FREQUENCY_SD),
        "log_length": (np.log(problem.length_px), LENGTH_SD),
        "log_width": (0.0, WIDTH_SD),
        "log_aspect": (0.0, ASPECT_SD),
    }
    mean = np.array([known.get(name, (0.0, np.inf))[0] for name in problem.names])
    return mean, np.array([known.get(name, (0.0, np.inf))[1] ** -2.0 for name in problem.names])


def initial_parameters(problem: BarLikelihood, target: BarTarget) -> dict[str, float]:
    """Return starting values for a detected target."""
    pixels = problem.image[problem.window]
    background, bright = np.quantile(pixels, [0.1, 0.95] if target.sign > 0 else [0.9, 0.05])
    return {
        "log_attenuation": float(np.log(-np.log(0.4))),
        "form_one": problem.form.first.start,
        "form_two": problem.form.second.start,
        "departure": 0.0,
        "log_frequency": float(np.log(target.frequency)),
        "log_length": float(np.log(problem.length_px)),
        "log_width": 0.0,
        "log_aspect": 0.0,
        "across_px": 0.0,
        "along_px": 0.0,
        "angle_rad": target.angle_rad,
        "level_dn": 1.3 * float(bright - background),
        "pedestal_dn": float(background),
        "slope_across": 0.0,
        "slope_along": 0.0,
    }


class BarImageModel:
    """Image of a target over the window's pixels as a function of its parameters."""

    def __init__(self, problem: BarLikelihood, target: BarTarget) -> None:
        self.problem, self.target = problem, target
        row, col = np.nonzero(problem.window)
        self.x, self.y = col - target.col, (row - target.row) * target.pitch_ratio
        across, along = self.places(target.angle_rad, 0.0, 0.0)
        self.reach = (float(np.abs(across).max()) + 3.0, float(np.abs(along).max()) + 3.0)

    def places(self, angle_rad: float, across_px: float, along_px: float) -> tuple[Array, Array]:
        """Return distances of the window's pixels across and along displaced bars, shape (pixel,),
        px.
        """
        cosine, sine = np.cos(angle_rad), np.sin(angle_rad)
        return (
            self.x * cosine + self.y * sine - across_px,
            self.y * cosine - self.x * sine - along_px,
        )

    def shape(self, theta: dict[str, float]) -> BarShape:
        """Return the image's shape for parameter values."""
        return BarShape(
            bars=self.target.bars,
            frequency=float(np.exp(theta["log_frequency"])),
            length_px=np.inf if self.problem.strip else float(np.exp(theta["log_length"])),
            reference=self.problem.asked,
            log_attenuation=theta["log_attenuation"],
            form=self.problem.form,
            form_one=theta["form_one"],
            form_two=theta["form_two"],
            departure=theta["departure"],
            log_width=theta["log_width"],
            log_aspect=theta.get("log_aspect", 0.0),
            # The fit changes the direction too little to affect the pixel's transfer.
            angle_rad=self.target.angle_rad,
        )

    def __call__(self, theta: dict[str, float]) -> tuple[Array, Array]:
        """Return the image, shape (pixel,), and its derivatives, shape (parameter, pixel)."""
        across, along = self.places(
            theta["angle_rad"], theta.get("across_px", 0.0), theta.get("along_px", 0.0)
        )
        looked_up = table_of(self.shape(theta), *self.reach).at(across, along)
        level = theta["level_dn"]
        slopes = level * looked_up[-2], level * looked_up[-1]
        scale = (2.0 * self.reach[0], 2.0 * self.reach[1])
        image = (
            theta["pedestal_dn"]
            + level * looked_up[0]
            + theta["slope_across"] * across / scale[0]
            + theta["slope_along"] * along / scale[1]
        )
        derivative = {
            **dict(zip(SHAPES, level * looked_up[1:9], strict=True)),
            "across_px": -slopes[0],
            "along_px": -slopes[1],
            "angle_rad": slopes[0] * along - slopes[1] * across,
            "level_dn": looked_up[0],
            "pedestal_dn": np.ones_like(across),
            "slope_across": across / scale[0],
            "slope_along": along / scale[1],
        }
        return image, np.stack([derivative[name] for name in self.problem.names])
