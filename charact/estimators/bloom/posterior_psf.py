"""Point spread functions of a camera, one per posterior draw, and their evaluation on a frame."""

from dataclasses import dataclass, fields, replace
from functools import cache, cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from charact.transfer import spreads
from labdata import Array, BadInput, Posterior

SHARES = ("halo_fraction", "wing_share", "glare_fraction")
POSITIVE = ("halo_diameter_px", "core_frequency_cy_per_px", "core_exponent", "wing_radius_px")
# Parameter of a posterior and the corresponding field. Without core frequency the core is Gaussian.
NAMES = {
    "halo_diameter": "halo_diameter_px",
    "elastic_share": "elastic_share",
    "halo_fraction": "halo_fraction",
    "core_frequency": "core_frequency_cy_per_px",
    "core_exponent": "core_exponent",
    "core_spread": "core_spread_px2",
    "wing_share": "wing_share",
    "wing_radius": "wing_radius_px",
    "wing_exponent": "wing_exponent",
    "wing_sd": "wing_sd_px",
    "wing_peak": "wing_peak",
    "rising_share": "rising_share",
    "rim_share": "rim_share",
    "glare_fraction": "glare_fraction",
}
GAUSSIAN = {"core_frequency_cy_per_px": np.inf, "core_exponent": 2.0}
NO_HALO = {"halo_diameter_px": 1.0, "elastic_share": 0.0, "halo_fraction": 0.0}


@dataclass(frozen=True, kw_only=True)
class PosteriorPsf:
    """Point spread function of a camera, one per draw; each field has shape (draw,) or is one
    number for all.

    Parameters
    ----------
    halo_diameter_px
        Outer diameter of the halo before blur, four gaps, column pitches.
    elastic_share
        Fraction of the backscattered electrons with elastic reflection, dimensionless.
    halo_fraction
        Fraction of the light in the halo, dimensionless.
    core_frequency_cy_per_px, core_exponent
        Parameters of the core's transfer exp(-(f/fc)^n - 2 pi^2 f^2 s^2); an infinite fc leaves the
        Gaussian alone.
    core_spread_px2
        s^2 of the core, px^2.
    wing_share, wing_radius_px, wing_exponent
        Fraction of the light outside halo and glare in a Moffat wing (1 + r^2/a^2)^-b, its a and
        its b.
    wing_sd_px, wing_peak
        Width of a Matern wing instead, and its p (`charact.estimators.bloom.spreads.matern`); 0
        px: Moffat.
    flat_share, rising_share, rim_share
        Fractions of the halo that are flat, rise as x^2 and as x^12 to its edge; the remainder has
        uniformly distributed energies.
    glare_fraction
        Fraction of the light that is spread uniformly, dimensionless.
    glare_area_px
        Area of the glare, pixels; None: the frame.

    Raises
    ------
    BadInput
        If a fraction is outside 0 to 1 or a length is not positive.
    """

    halo_diameter_px: Array
    elastic_share: Array
    halo_fraction: Array
    core_frequency_cy_per_px: Array
    core_exponent: Array
    core_spread_px2: Array
    wing_share: ArrayLike = 0.0
    wing_radius_px: ArrayLike = 3.0
    wing_exponent: ArrayLike = 2.0
    wing_sd_px: ArrayLike = 0.0
    wing_peak: ArrayLike = 0.5
    flat_share: ArrayLike = 0.0
    rising_share: ArrayLike = 0.0
    rim_share: ArrayLike = 0.0
    glare_fraction: ArrayLike = 0.0
    glare_area_px: float | None = None

    def __post_init__(self) -> None:
        arrays = np.broadcast_arrays(
            *(np.atleast_1d(np.asarray(getattr(self, name), float)) for name in _per_draw())
        )
        for name, array in zip(_per_draw(), arrays, strict=True):
            if name in SHARES and not ((array >= 0) & (array <= 1)).all():
                raise BadInput(f"{name} must lie in 0 to 1, got {array.min():g} to {array.max():g}")
            if name in POSITIVE and not (array > 0).all():
                raise BadInput(f"{name} must be positive, got {array.min():g}")
            object.__setattr__(self, name, array)

    def __len__(self) -> int:
        """Number of draws."""
        return len(self.halo_diameter_px)

    def subsample(self, max_draws: int = 30) -> "PosteriorPsf":
        """Return at most `max_draws` draws, evenly spaced."""
        if len(self) <= max_draws:
            return self
        index = np.linspace(0, len(self) - 1, max_draws).round().astype(int)
        return replace(self, **{name: getattr(self, name)[index] for name in _per_draw()})

    def centre(self) -> "PosteriorPsf":
        """Return one draw: the median of every parameter."""
        return replace(
            self, **{name: np.median(getattr(self, name), keepdims=True) for name in _per_draw()}
        )

    def transfer(self, frequency_cy_per_px: ArrayLike) -> Array:
        """Return the transfer function without the veiling glare, 1 at frequency 0, shape (draw,
        frequency).
        """
        frequency = np.asarray(frequency_cy_per_px, float)
        blur = spreads.tube(frequency, self.core_frequency_cy_per_px, self.core_exponent)
        blur = blur * spreads.gaussian(frequency, self.core_spread_px2)
        if np.any(self.wing_share):
            if np.any(self.wing_sd_px):
                wing = spreads.matern(
                    frequency, np.asarray(self.wing_sd_px), np.asarray(self.wing_peak)
                )
            else:
                wing = spreads.moffat(
                    frequency, np.asarray(self.wing_radius_px), np.asarray(self.wing_exponent)
                )
            blur = spreads.mix(blur, np.asarray(self.wing_share), wing)
        flat, rising, rim = (
            np.asarray(part) for part in (self.flat_share, self.rising_share, self.rim_share)
        )
        profile = [self.elastic_share, 1.0 - self.elastic_share - flat - rising - rim, rising, rim]
        halo = spreads.halo_disc(frequency, self.halo_diameter_px, np.stack(profile, axis=-1))
        return blur * spreads.mix(
            1.0, self.halo_fraction / (1.0 - np.asarray(self.glare_fraction)), halo
        )

    def density(self, radius_px: ArrayLike) -> Array:
        """Return the PSF at distances from the source, column pitches, up to 150, 1/px2, shape
        (draw, radius).
        """
        return np.maximum(self.transfer(nodes()[0]) @ density_matrix(radius_px), 0.0)


@cache
def _per_draw() -> tuple[str, ...]:
    """Names of the fields with one number per draw."""
    return tuple(field.name for field in fields(PosteriorPsf) if field.name != "glare_area_px")


def nodes() -> tuple[Array, Array]:
    """Frequencies, cy/px, and weights of PSF integrals, valid to 150 px from the source."""
    return spreads.quadrature(0.8, 512)


def density_matrix(radius_px: ArrayLike) -> Array:
    """Matrix from a transfer function on `nodes` to the PSF at some radii, shape (node, radius)."""
    return spreads.hankel_matrix(nodes(), np.asarray(radius_px, float))


def spread_of(
    posterior: Posterior, *, pitch_ratio: float = 1.0, **known: ArrayLike
) -> PosteriorPsf:
    """Return the point spread functions described by a posterior.

    The draws have the names of `NAMES`, or `core_sd`, the core before the pixel aperture, as fitted
    to point series; `pitch_ratio`, row pitch over column pitch, is for that aperture. `known` are
    fields that the posterior lacks. Raises BadInput if a required parameter is missing.
    """
    fitted = {field: posterior[name] for name, field in NAMES.items() if name in posterior.names}
    if "core_sd" in posterior.names:
        # The pixel aperture has the variance of a twelfth of its squared pitch; rows and columns
        # are averaged.
        fitted["core_spread_px2"] = posterior["core_sd"] ** 2 + (1.0 + pitch_ratio**2) / 24.0
    if "even_share" in posterior.names:
        fitted["flat_share"] = 1.0 - np.sum([posterior[name] for name in spreads.PROFILE], axis=0)
    fields = {**({} if "core_frequency" in posterior.names else GAUSSIAN), **known, **fitted}
    if not {"halo_diameter_px", "halo_fraction"} & fields.keys():
        fields = {**fields, **NO_HALO}
    if needed := [name for name in list(NAMES.values())[:6] if name not in fields]:
        raise BadInput(
            f"the PSF needs {', '.join(needed)}; the posterior has only "
            f"{', '.join(posterior.names)}"
        )
    shares = {name: np.clip(fields[name], 0.0, 1.0) for name in SHARES if name in fields}
    return PosteriorPsf(**{**fields, **shares})  # pyright: ignore[reportArgumentType]


# Steps of the frequency and radius tables, cy/px and px, and extent of the latter.
FREQUENCY_STEP = 5e-4
RADIUS_STEP_PX, REACH_PX = 0.1, 150.0


@dataclass(frozen=True, kw_only=True)
class FrameGrid:
    """Pixels of a frame of a shape (row, col), padded by `room_px` so that blur does not wrap
    around.
    """

    shape: tuple[int, int]
    room_px: int
    pitch_ratio: float = 1.0

    @cached_property
    def transform_shape(self) -> tuple[int, int]:
        """Rows and columns of the padded frame, sizes of fast transforms."""
        from scipy.fft import next_fast_len

        rows, cols = (next_fast_len(size + self.room_px, True) for size in self.shape)
        return int(rows or 0), int(cols or 0)

    @cached_property
    def frequency_index(self) -> NDArray[np.int32]:
        """Table index (step `FREQUENCY_STEP`) of every frequency of a transform, shape (row, half
        col).
        """
        rows, cols = self.transform_shape
        down = np.fft.fftfreq(rows) / self.pitch_ratio
        frequency = np.hypot(down[:, None], np.fft.rfftfreq(cols)[None, :])
        return np.rint(frequency / FREQUENCY_STEP).astype(np.int32)

    @cached_property
    def frequency(self) -> Array:
        """Frequencies of the table, cycles per column pitch."""
        return np.asarray(
            FREQUENCY_STEP * np.arange(int(self.frequency_index.max()) + 1), np.float64
        )

    def blur(self, image: NDArray, table: Array) -> NDArray[np.float32]:
        """Apply a rotationally symmetric transfer function, a table over `frequency`, to a
        frame.
        """
        from scipy.fft import irfft2, rfft2

        transform = np.asarray(rfft2(np.asarray(image, np.float32), s=self.transform_shape))
        transform = transform * table.astype(np.float32)[self.frequency_index]
        rows, cols = self.shape
        return np.asarray(irfft2(transform, s=self.transform_shape, overwrite_x=True))[:rows, :cols]

    def distance(self, row: float, col: float, pixels: NDArray[np.int64] | None = None) -> Array:
        """Distance of all pixels, shape (row, col), or of those of flat indices, from a position,
        column pitches.
        """
        if pixels is None:
            rows, cols = np.indices(self.shape, sparse=True)
        else:
            rows, cols = np.divmod(pixels, self.shape[1])
        return np.hypot((rows - row) * self.pitch_ratio, cols - col)

    def within(self, pixels: NDArray[np.int64], reach_px: float) -> NDArray[np.bool_]:
        """Pixels within a distance of given ones, shape (row, col)."""
        from scipy import ndimage

        background = np.ones(self.shape, bool)
        background.ravel()[pixels] = False
        return (
            np.asarray(ndimage.distance_transform_edt(background, sampling=(self.pitch_ratio, 1.0)))
            <= reach_px
        )

    def around(self, row: float, col: float) -> tuple[slice, slice]:
        """Rows and columns within the range of the tabulated PSF around a position."""
        down, across = int(REACH_PX / self.pitch_ratio) + 1, int(REACH_PX) + 1
        return (
            slice(max(0, int(row) - down), min(self.shape[0], int(row) + down + 1)),
            slice(max(0, int(col) - across), min(self.shape[1], int(col) + across + 1)),
        )

    def middle(self, pixels: NDArray[np.int64]) -> tuple[float, float]:
        """Centre of some pixels, row and col."""
        rows, cols = np.divmod(pixels, self.shape[1])
        return float(rows.mean()), float(cols.mean())

    def patch(self, pixels: NDArray[np.int64], table: Array) -> NDArray[np.float32]:
        """Image of a unit source spread uniformly over some pixels, from a tabulated transfer
        function.
        """
        image = np.zeros(self.shape, np.float32)
        image.ravel()[pixels] = 1.0 / len(pixels)
        return self.blur(image, table)


def profiles(spread: PosteriorPsf) -> Array:
    """PSF of every draw in steps of `RADIUS_STEP_PX`, shape (draw, radius)."""
    return spread.transfer(nodes()[0]) @ _kernel()


@cache
def _kernel() -> Array:
    """Matrix from a transfer function on `nodes` to the PSF at multiples of `RADIUS_STEP_PX`, shape
    (node, radius).
    """
    return density_matrix(RADIUS_STEP_PX * np.arange(int(REACH_PX / RADIUS_STEP_PX) + 1))


def radial(radius_px: ArrayLike, profile: Array) -> Array:
    """Interpolate a radial table in steps of `RADIUS_STEP_PX`; 0 beyond its end."""
    position = np.asarray(radius_px) / RADIUS_STEP_PX
    index = np.minimum(position.astype(np.int32), len(profile) - 2)
    fraction = position - index
    interpolated = profile[index] * (1.0 - fraction) + profile[index + 1] * fraction
    return np.where(position < len(profile) - 1, interpolated, 0.0)
