"""What is believed of a point source and its camera before the pixels are looked at."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from charact.method import Context
from charact.mtf.known_transfer import halo_diameters_px
from charact.video_filter import VideoFilter
from labdata.camera_description import Parameter

Array = NDArray[np.float64]

NAMES = (
    "x_px",
    "y_px",
    "ln_cut_off",
    "exponent",
    "blur_px",
    "stretch",
    "ln_bandwidth",
    "halo_deviate",
    "halo_diameter_px",
    "halo_elastic_share",
)
UNITS = ("px", "px", "ln(cy/px)", "1", "px", "1", "1", "1", "px", "1")
# Standard deviations by which a camera may differ from its description: tubes' cut-offs, exponents, and how far from
# round their blur is.
CUT_OFF_SD, EXPONENT_SD, STRETCH_SD = 0.12, 0.08, 0.03
ANY_STRETCH_SD = 0.15
# An unknown camera's Gaussian part: most probable width and its spread, px.
ANY_BLUR_PX = 0.4
# Exponents of a blur that is all of one form, and of the tails of tubes (physics reference 1.12: 1.1 to 2) beside a
# Gaussian core. Wider tails than those cannot be told from a background.
FREE, FREE_SD = 1.6, 0.6
TAIL, TAIL_SD, MIN_TAIL = 1.3, 0.25, 1.0
TWO_SIDED_95 = 1.959964
# Ranges of a halo's diameter that a description leaves open, and least standard deviation, share of it.
OPEN_DIAMETER, MIN_DIAMETER_SD = 0.15, 0.02
NO_HALO = (-30.0, 0.0, 0.0)


@dataclass(frozen=True, kw_only=True)
class PointPrior:
    """Priors within bounds, halves of two normal laws that meet at the described value.

    Parameters
    ----------
    free
        Which of `NAMES` are fitted.
    centre, below, above, bounds
        Peak, standard deviations below and above it, and bounds of all, shape (name,) and (name, 2); a parameter not
        free stays at its peak.
    halo_px
        Bounds of the halo's diameter, px; None: no halo can be told.
    halo_fraction_bend
        (a, b, c) of ln share = a + b z + c z^2, z the halo's standard normal deviate.
    """

    free: tuple[str, ...]
    centre: Array
    below: Array
    above: Array
    bounds: Array
    halo_px: tuple[float, float] | None
    halo_fraction_bend: tuple[float, float, float]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters that are fitted."""
        return self.free

    @property
    def units(self) -> tuple[str, ...]:
        """Their units."""
        return tuple(UNITS[NAMES.index(name)] for name in self.free)

    @property
    def spread(self) -> Array:
        """Mean of both standard deviations, whose normal law has the density's height, shape (name,)."""
        return 0.5 * (self.below + self.above)

    @property
    def chosen(self) -> NDArray[np.int64]:
        """Places of the free parameters among all."""
        return np.array([NAMES.index(name) for name in self.free])

    def named(self, theta: Array) -> dict[str, Array]:
        """Return every parameter by name, shape (n,) each, those held (1,)."""
        held = {name: self.centre[index : index + 1] for index, name in enumerate(NAMES)}
        return held | {name: theta[:, index] for index, name in enumerate(self.free)}

    def halo_fraction(self, deviate: Array) -> Array:
        """Return the halo's share of the photoelectrons."""
        a, b, c = self.halo_fraction_bend
        return np.exp(a + b * deviate + c * deviate**2)

    def log_density(self, theta: Array) -> Array:
        """Return ln of the density, -inf outside the bounds, shape (n,)."""
        chosen = self.chosen
        low, high = self.bounds[chosen].T
        inside = np.all((theta >= low) & (theta <= high), axis=1)
        away = theta - self.centre[chosen]
        normal = -0.5 * np.sum((away / np.where(away < 0.0, self.below[chosen], self.above[chosen])) ** 2, axis=1)
        return np.where(inside, normal, -np.inf)


def priors_of(context: Context, *, halo_seen: bool) -> tuple[PointPrior, ...]:
    """Return the priors that the data choose from: of the described camera, or two kinds of cameras at large.

    Parameters
    ----------
    halo_seen
        Whether the region is wide enough for the halo.
    """
    if context.sensor is None:
        return _generic_prior(0.0), _generic_prior(ANY_BLUR_PX)
    return (_sensor_prior(context, halo_seen),)


def _generic_prior(blur_px: float) -> PointPrior:
    """Any camera: exp(-(f/fc)^n), of which n = 2 is a Gaussian, alone or with a Gaussian core to its wide tails."""
    free = (*NAMES[:4], *(("blur_px",) if blur_px else ()), "stretch")
    core, core_sd = (
        (np.log(0.4), TAIL if blur_px else FREE, blur_px),
        (1.0, TAIL_SD if blur_px else FREE_SD, ANY_BLUR_PX),
    )
    prior = _prior(free, core, core_sd, (1e-3, np.ones(3)), None, NO_HALO)
    spread = np.where(np.array(NAMES) == "stretch", ANY_STRETCH_SD, prior.spread)
    least = np.where(np.array(NAMES) == "exponent", MIN_TAIL if blur_px else 0.5, prior.bounds[:, 0])
    return replace(prior, below=spread, above=spread, bounds=np.stack([least, prior.bounds[:, 1]], axis=1))


def _sensor_prior(context: Context, halo_seen: bool) -> PointPrior:
    """The described intensifier, whose lens and fibres are Gaussians to the tube's exponential."""
    sensor = context.sensor
    assert sensor is not None
    pitch_um = float(sensor.ccd.pitch_x_um)
    demagnification = float(sensor.taper.demagnification)
    cut_off = float(sensor.tube.mtf_frequency_lp_per_mm) * pitch_um * demagnification * 1e-3
    lens = float(sensor.optics.aberration_blur_um) / (pitch_um * demagnification)
    fibres = float(sensor.taper.fibre_pitch_um) / (4.0 * pitch_um)
    faces = 1e3 / (np.pi * np.sqrt(2.0) * float(sensor.taper.interface_mtf_lp_per_mm) * pitch_um)
    blur = float(np.sqrt(lens**2 + fibres**2 + faces**2))
    share = sensor.photocathode.halo_fraction
    halo = halo_diameters_px(context, transposed=False) if halo_seen else None
    bend = _bend(float(share), share.low, share.high) if halo_seen else NO_HALO
    gap = sensor.photocathode.gap_mm
    px_per_mm = 4e3 / (pitch_um * demagnification)
    diameter = px_per_mm * np.array([float(gap), *_sides(gap)])
    video = VideoFilter.of(sensor)
    bandwidth_sd = video.ln_bandwidth_sd if video else 0.0
    free = (*NAMES[:7], *(NAMES[7:] if halo_seen else ()))
    core = (np.log(cut_off), float(sensor.tube.mtf_exponent), blur)
    return _prior(free, core, (CUT_OFF_SD, EXPONENT_SD, 0.25 * blur), (bandwidth_sd, diameter), halo, bend)


def _prior(free, core, core_sd, tail, halo, bend) -> PointPrior:
    """Assemble a prior."""
    bandwidth_sd, diameter = tail
    centre = np.array([0.0, 0.0, *core, 0.0, 0.0, 0.0, diameter[0], 0.5])
    below, above = (
        np.array([np.inf, np.inf, *core_sd, STRETCH_SD, max(bandwidth_sd, 1e-3), 1.0, side, 1e3])
        for side in diameter[1:]
    )
    low, high = halo or (1.0, 2.0)
    bounds = np.array([
        (-3.0, 3.0), (-3.0, 3.0), (np.log(0.02), np.log(3.0)), (0.5, 4.0), (0.0, 3.0), (-0.3, 0.3), (-0.2, 0.2),
        (-3.0, 3.0), (low, high), (0.0, 1.0),
    ])  # fmt: skip
    return PointPrior(
        free=tuple(free), centre=centre, below=below, above=above, bounds=bounds, halo_px=halo, halo_fraction_bend=bend
    )


def _sides(known: Parameter) -> tuple[float, float]:
    """Return standard deviations below and above a described value, of which the range holds 95 %."""
    value = float(known)
    low = (1.0 - OPEN_DIAMETER) * value if known.low is None else known.low
    high = (1.0 + OPEN_DIAMETER) * value if known.high is None else known.high
    least = MIN_DIAMETER_SD * value
    return max((value - low) / TWO_SIDED_95, least), max((high - value) / TWO_SIDED_95, least)


def _bend(value: float, low: float | None, high: float | None) -> tuple[float, float, float]:
    """Return the parabola of ln through the 95 % bounds and the value, the middle."""
    low, high = low or 0.3 * value, high or 2.0 * value
    middle, down, up = np.log([value, low, high])
    return float(middle), float((up - down) / (2 * TWO_SIDED_95)), float((up + down - 2 * middle) / (2 * 3.841459))
