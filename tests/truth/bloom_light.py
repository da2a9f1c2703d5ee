"""Point source far too bright, as it lies before the camera: core, wing, halo and glare in closed
form.

Each part is a density of volume 1 on the plane, per square column pitch. A ring blurred by a
Gaussian is exp(-(r - a)^2 / 2 s^2) I0e(r a / s^2) / 2 pi s^2; a halo is a sum of rings, a Moffat
wing a sum of Gaussians.
"""

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from labdata import BadInput
from labdata.frames import read_only

Array = NDArray[np.float64]

# Side of the square that veiling glare fills, px.
GLARE_SIDE_PX = 600.0
# What the wing alone blurs is smooth: rings of the halo there, and the step of its table, px.
SMOOTH_RINGS, SMOOTH_STEP_PX = 60, 0.5
# Samples of light along a pixel's side.
FINE = 2
# Rings that make up a halo: enough for a blur of a hundredth of its diameter.
RINGS = 200
# Gaussians that make up a Moffat wing where it blurs a halo, and the least weight of those left out
# on either side.
GAUSSIANS, LEAST_WEIGHT = 48, 1e-8


@dataclass(frozen=True, kw_only=True)
class BloomScene:
    """A point source before an intensified camera, with one knob for each thing that it may do.

    Parameters
    ----------
    rows, cols, frames
        Size of each stack.
    row_pitch
        Row pitch over column pitch.
    row, col
        Centre of the source, px; None: a little off the middle of the frame.
    core_sigma_px
        Standard deviation of the Gaussian core, column pitches; the blur after the gain is a part
        of it.
    wing_share, wing_radius_px, wing_exponent
        Share of the core's light in a Moffat wing (1 + r^2/a^2)^-b before the plate, its a in
        column pitches and its b.
    halo_diameter_px, halo_fraction, halo_elastic_share
        Outer diameter in column pitches, share of all light that bounces, and share of that which
        keeps its energy.
    glare_fraction
        Share of all light spread evenly over 600 px x 600 px.
    dark_dn, background_dn
        Level without light, and even light on top of it, DN.
    full_scale_dn, bits
        Highest code, DN, and bits of a pixel.
    photoelectron_dn, excess
        DN per photoelectron, and F^2 = 1 + relative variance of the pulse heights.
    post_gain_sigma_px
        Standard deviation of the Gaussian blur after the gain, column pitches: it ties the noise of
        neighbours.
    read_noise_dn
        White noise, DN.
    plate_saturation_dn
        Level s (DN per pixel before any clip) at which the gain of the plate has halved: x/(1 +
        x/s). None: linear.
    full_well_dn
        What a pixel holds before charge spills along the column, DN; None: no spill.
    smear_fraction
        Share of a column's summed light that is spread evenly over the column.
    lag
        Share of a frame's light that returns in the next.
    motion_px
        Columns that the source moves from frame to frame.
    agc
        Whether an automatic gain holds the mean of the frame, light beyond full scale cut off, at
        that of the faintest level.
    wrong_dark_dn
        By how much the dark stack is off, DN.
    second_distance_px, second_ratio, second_angle_deg
        A second source: how far, its brightness relative to the first, and in which direction from
        the columns' one.
    light_sd
        Standard deviation of the natural logarithm of each level's stated light.
    """

    rows: int = 160
    cols: int = 180
    frames: int = 8
    row_pitch: float = 1.0
    row: float | None = None
    col: float | None = None
    core_sigma_px: float = 1.3
    wing_share: float = 0.0
    wing_radius_px: float = 3.0
    wing_exponent: float = 2.0
    halo_diameter_px: float = 46.0
    halo_fraction: float = 0.1
    halo_elastic_share: float = 0.3
    glare_fraction: float = 0.0
    dark_dn: float = 12.0
    background_dn: float = 4.0
    full_scale_dn: float = 255.0
    bits: int = 8
    photoelectron_dn: float = 3.0
    excess: float = 1.6
    post_gain_sigma_px: float = 0.7
    read_noise_dn: float = 0.6
    plate_saturation_dn: float | None = None
    full_well_dn: float | None = None
    smear_fraction: float = 0.0
    lag: float = 0.0
    motion_px: float = 0.0
    agc: bool = False
    wrong_dark_dn: float = 0.0
    second_distance_px: float | None = None
    second_ratio: float = 1.0
    second_angle_deg: float = 30.0
    light_sd: float = 0.0

    def __post_init__(self) -> None:
        if self.core_sigma_px <= self.post_gain_sigma_px:
            raise BadInput(
                "the core must be wider than the blur after the gain of "
                f"{self.post_gain_sigma_px} px, got {self.core_sigma_px}"
            )
        if self.full_scale_dn > 2**self.bits - 1:
            raise BadInput(
                f"full scale must fit into {self.bits} bits, got {self.full_scale_dn} DN"
            )

    @property
    def centre(self) -> tuple[float, float]:
        """Row and column of the source, px."""
        row = (self.rows - 1) / 2 + 0.2 if self.row is None else self.row
        col = (self.cols - 1) / 2 - 0.3 if self.col is None else self.col
        return row, col

    @property
    def span_dn(self) -> float:
        """Full scale above the dark level, DN."""
        return self.full_scale_dn - self.dark_dn

    @property
    def core_peak(self) -> float:
        """Highest share of the core's light that a pixel can hold, dimensionless."""
        return self.row_pitch * float(_core(self, np.zeros(1), before_gain=False)[0])

    def source_dn(self, overload: float) -> float:
        """All light of the source, DN px: at the overload 1 the core's peak just meets full
        scale.
        """
        core_share = 1.0 - self.halo_fraction - self.glare_fraction
        return overload * self.span_dn / (self.core_peak * core_share)


def gaussian(radius_px: Array, sigma_px: float) -> Array:
    """Return the density of a Gaussian, 1/px2."""
    return np.exp(-0.5 * (radius_px / sigma_px) ** 2) / (2.0 * np.pi * sigma_px**2)


def moffat(radius_px: Array, scale_px: float, exponent: float) -> Array:
    """Return the density (b - 1) / (pi a^2) (1 + r^2/a^2)^-b of a Moffat wing, 1/px2; b > 1."""
    return (
        (exponent - 1.0) / (np.pi * scale_px**2) * (1.0 + (radius_px / scale_px) ** 2) ** -exponent
    )


def moffat_as_gaussians(scale_px: float, exponent: float) -> tuple[Array, Array]:
    """Return standard deviations and weights of the Gaussians whose sum is a Moffat wing, shape
    (gaussian,).

    With t from a gamma law of shape b - 1, the Gaussian of variance a^2 / 2t is on average the
    wing.
    """
    from scipy.special import gamma

    shape = exponent - 1.0
    log_t = np.linspace(np.log(LEAST_WEIGHT) / shape, np.log(30.0), GAUSSIANS)
    weight = np.exp(shape * log_t - np.exp(log_t)) / gamma(shape)
    return scale_px / np.sqrt(2.0 * np.exp(log_t)), weight / weight.sum()


def halo_rings(diameter_px: float, elastic_share: float, count: int = RINGS) -> tuple[Array, Array]:
    """Return radii and weights of the rings that make up a halo, px and dimensionless, shape
    (ring,).

    `diameter_px`: outer diameter, four gaps between photocathode and plate; `elastic_share`: share
    of the halo's electrons that keep their energy; the others keep any part of it alike; `count`:
    number of rings. With x = 2r/D, electrons that leave by the cosine law land with the density
    1/sqrt(1 - x^2) if they keep their energy, and arccos(x)/x if it is uniform. In the angle of x =
    sin(angle) the weight of their rings is sin(angle) and (pi/2 - angle) cos(angle): nothing is
    singular.
    """
    angle, weight = _angles(count, 0.0, 0.5 * np.pi)
    return 0.5 * diameter_px * np.sin(angle), weight * _weight(angle, elastic_share)


def halo_share_between(first: float, last: float, elastic_share: float) -> float:
    """Return the share of a halo's light between two radii, each a share of the halo's own."""
    angle, weight = _angles(RINGS, float(np.arcsin(first)), float(np.arcsin(last)))
    return float(weight @ _weight(angle, elastic_share))


@lru_cache
def _angles(count: int, first: float, last: float) -> tuple[Array, Array]:
    """Angles and weights of the quadrature by Gauss and Legendre."""
    node, weight = np.polynomial.legendre.leggauss(count)
    half = 0.5 * (last - first)
    return first + half * (node + 1.0), half * weight


def _weight(angle: Array, elastic_share: float) -> Array:
    """Light of a halo per angle."""
    return elastic_share * np.sin(angle) + (1.0 - elastic_share) * (0.5 * np.pi - angle) * np.cos(
        angle
    )


def rings_blurred(radius_px: Array, rings: tuple[Array, Array], sigma_px: float) -> Array:
    """Return the density at some radii of rings blurred by a Gaussian, 1/px2."""
    from scipy.special import i0e

    at, weight = rings
    out = np.zeros(len(radius_px))
    # Standard deviations beyond which a Gaussian is nothing.
    lit = radius_px < at.max() + 8.0 * sigma_px
    scaled_distance = np.subtract.outer(radius_px[lit], at) / sigma_px
    blurred = np.exp(-0.5 * scaled_distance**2) * i0e(
        np.multiply.outer(radius_px[lit], at) / sigma_px**2
    )
    out[lit] = blurred @ weight / (2.0 * np.pi * sigma_px**2)
    return out


def radial_light(scene: BloomScene, radius_px: Array, *, before_gain: bool = False) -> Array:
    """Return the light of a source of volume 1 over the radius, per square column pitch, glare left
    out.

    `radius_px`: distances from the source, column pitches; `before_gain`: whether the blur after
    the gain is still to come.
    """
    light = (1.0 - scene.halo_fraction - scene.glare_fraction) * _core(
        scene, radius_px, before_gain=before_gain
    )
    if scene.halo_fraction <= 0:
        return light
    return light + scene.halo_fraction * radial_halo(scene, radius_px, before_gain=before_gain)


def radial_halo(scene: BloomScene, radius_px: Array, *, before_gain: bool = False) -> Array:
    """Return the halo alone, blurred by core and wing, as a density of volume 1."""
    (sigma, after), wing = _sigmas(scene, before_gain), scene.wing_share
    rings = halo_rings(scene.halo_diameter_px, scene.halo_elastic_share)
    light = (1.0 - wing) * rings_blurred(radius_px, rings, sigma)
    if wing <= 0:
        return light
    from scipy.interpolate import CubicSpline

    coarse = np.arange(0.0, radius_px.max() + 1.0, SMOOTH_STEP_PX)
    rings = halo_rings(scene.halo_diameter_px, scene.halo_elastic_share, SMOOTH_RINGS)
    gaussians = zip(*moffat_as_gaussians(scene.wing_radius_px, scene.wing_exponent), strict=True)
    wing_light = np.sum(
        [
            wing * weight * rings_blurred(coarse, rings, np.hypot(wing_sigma, after))
            for wing_sigma, weight in gaussians
        ],
        0,
    )
    return light + np.asarray(CubicSpline(coarse, wing_light)(radius_px))


def _core(scene: BloomScene, radius_px: Array, *, before_gain: bool) -> Array:
    """Core and wing as a density of volume 1."""
    (sigma, after), wing = _sigmas(scene, before_gain), scene.wing_share
    light = (1.0 - wing) * gaussian(radius_px, sigma)
    if wing <= 0:
        return light
    widths, weights = moffat_as_gaussians(scene.wing_radius_px, scene.wing_exponent)
    variance = widths**2 + after**2
    return light + wing * (
        np.exp(-0.5 * np.divide.outer(radius_px**2, variance))
        @ (weights / (2.0 * np.pi * variance))
    )


def _sigmas(scene: BloomScene, before_gain: bool) -> tuple[float, float]:
    """Standard deviations of the core and of what blurs the wing, px: the blur after the gain is in
    both or in none.
    """
    after = scene.post_gain_sigma_px
    return (
        (float(np.sqrt(scene.core_sigma_px**2 - after**2)), 0.0)
        if before_gain
        else (scene.core_sigma_px, after)
    )


def optics_of(scene: BloomScene) -> BloomScene:
    """Return the scene with all that its light before the plate does not depend on set alike: a key
    to keep it by.
    """
    return replace(
        scene,
        frames=1,
        background_dn=0.0,
        photoelectron_dn=1.0,
        excess=1.0,
        read_noise_dn=0.0,
        full_well_dn=None,
        plate_saturation_dn=None,
        smear_fraction=0.0,
        lag=0.0,
        motion_px=0.0,
        agc=False,
        wrong_dark_dn=0.0,
        light_sd=0.0,
        dark_dn=0.0,
        full_scale_dn=1.0,
    )


@lru_cache(maxsize=64)
def picture_of(optics: BloomScene, move_px: float) -> Array:
    """Light before the plate of a source of overload 1 and span 1 DN, `FINE` times as finely as
    pixels, (row, col).
    """
    row, col = optics.centre
    picture = _source(optics, row, col + move_px)
    if optics.second_distance_px is not None:
        angle = np.deg2rad(optics.second_angle_deg)
        down = optics.second_distance_px * np.sin(angle) / optics.row_pitch
        along = optics.second_distance_px * np.cos(angle)
        picture = picture + optics.second_ratio * _source(optics, row + down, col + move_px + along)
    return read_only(picture)


def at_pixels(picture: Array) -> Array:
    """Return the samples of a fine picture that lie in the middles of pixels."""
    return picture[..., ::FINE, ::FINE]


def _source(optics: BloomScene, row: float, col: float) -> Array:
    from scipy.interpolate import CubicSpline

    down = (np.arange(FINE * optics.rows) / FINE - row)[:, None] * optics.row_pitch
    radius = np.hypot(down, (np.arange(FINE * optics.cols) / FINE - col)[None, :])
    table = np.arange(0.0, radius.max() + 1.0, 0.2)
    light = np.asarray(CubicSpline(table, radial_light(optics, table, before_gain=True))(radius))
    return (
        optics.row_pitch
        * optics.source_dn(1.0)
        * (light + optics.glare_fraction / GLARE_SIDE_PX**2)
    )
