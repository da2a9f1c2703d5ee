"""Point spread functions of a camera, one per posterior draw, and their evaluation on a frame."""

from dataclasses import dataclass, fields, replace
from functools import cache, cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from charact.bloom import transfer
from labdata.errors import BadInput
from labdata.measurement import Posterior

Array = NDArray[np.float64]

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
    """Point spread function of a camera, one per draw; each field has shape (draw,) or is one number for all.

    Parameters
    ----------
    halo_diameter_px
        Outer diameter of the halo before blur, four gaps, column pitches.
    elastic_share
        Fraction of the backscattered electrons with elastic reflection, dimensionless.
    halo_fraction
        Fraction of the light in the halo, dimensionless.
    core_frequency_cy_per_px, core_exponent
        Parameters of the core's transfer exp(-(f/fc)^n - 2 pi^2 f^2 s^2); an infinite fc leaves the Gaussian alone.
    core_spread_px2
        s^2 of the core, px^2.
    wing_share, wing_radius_px, wing_exponent
        Fraction of the light outside halo and glare in a Moffat wing (1 + r^2/a^2)^-b, its a and its b.
    wing_sd_px, wing_peak
        Width of a Matern wing instead, and its p (`charact.bloom.transfer.matern`); 0 px: Moffat.
    flat_share, rising_share, rim_share
        Fractions of the halo that are flat, rise as x^2 and as x^12 to its edge; the remainder has uniformly
        distributed energies.
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
        arrays = np.broadcast_arrays(*(np.atleast_1d(np.asarray(getattr(self, name), float)) for name in _per_draw()))
        for name, array in zip(_per_draw(), arrays, strict=True):
            if name in SHARES and not ((array >= 0) & (array <= 1)).all():
                raise BadInput(f"{name} must lie in 0 to 1, got {array.min():g} to {array.max():g}")
            if name in POSITIVE and not (array > 0).all():
                raise BadInput(f"{name} must be positive, got {array.min():g}")
            object.__setattr__(self, name, array)

    def __len__(self) -> int:
        """Number of draws."""
        return len(self.halo_diameter_px)

    def select(self, draws: ArrayLike) -> "PosteriorPsf":
        """Return some draws, by their indices."""
        index = np.asarray(draws, int)
        return replace(self, **{name: getattr(self, name)[index] for name in _per_draw()})

    def subsample(self, most: int = 30) -> "PosteriorPsf":
        """Return at most `most` draws, evenly spaced."""
        return self if len(self) <= most else self.select(np.linspace(0, len(self) - 1, most).round())

    def centre(self) -> "PosteriorPsf":
        """Return one draw: the median of every parameter."""
        return replace(self, **{name: np.median(getattr(self, name), keepdims=True) for name in _per_draw()})

    def transfer(self, frequency_cy_per_px: ArrayLike) -> Array:
        """Return the transfer function without the veiling glare, 1 at frequency 0, shape (draw, frequency)."""
        frequency = np.asarray(frequency_cy_per_px, float)
        core = transfer.tube(frequency, self.core_frequency_cy_per_px, self.core_exponent)
        core = core * transfer.gaussian(frequency, self.core_spread_px2)
        wing, share = np.asarray(self.wing_share)[:, None], self.halo_share[:, None]
        if wing.any():
            if np.any(self.wing_sd_px):
                of = transfer.matern(frequency, np.asarray(self.wing_sd_px), np.asarray(self.wing_peak))
            else:
                of = transfer.moffat(frequency, np.asarray(self.wing_radius_px), np.asarray(self.wing_exponent))
            core = core * (1.0 - wing) + wing * of
        halo = transfer.disc(frequency, self.halo_diameter_px, self.halo_profile)
        return core * (1.0 - share + share * halo)

    @property
    def halo_profile(self) -> Array:
        """Profile of the halo disc, shape (draw, fraction)."""
        flat, rising, rim = (np.asarray(one) for one in (self.flat_share, self.rising_share, self.rim_share))
        return np.stack([self.elastic_share, 1.0 - self.elastic_share - flat - rising - rim, rising, rim], axis=-1)

    @property
    def halo_share(self) -> Array:
        """Fraction of the light without glare that lies in the halo, shape (draw,)."""
        return self.halo_fraction / (1.0 - np.asarray(self.glare_fraction))

    def density(self, radius_px: ArrayLike) -> Array:
        """Return the PSF at distances from the source, 1/px2, shape (draw, radius).

        `radius_px`: distances, column pitches, shape (radius,); valid to about 150 px.
        """
        return np.maximum(self.transfer(nodes()[0]) @ density_matrix(radius_px), 0.0)


@cache
def _per_draw() -> tuple[str, ...]:
    """Names of the fields with one number per draw."""
    return tuple(field.name for field in fields(PosteriorPsf) if field.name != "glare_area_px")


def nodes() -> tuple[Array, Array]:
    """Frequencies, cy/px, and weights of PSF integrals, valid to 150 px from the source."""
    return transfer.quadrature(0.8, 512)


def density_matrix(radius_px: ArrayLike) -> Array:
    """Matrix from a transfer function on `nodes` to the PSF at some radii, shape (node, radius)."""
    from scipy.special import j0

    frequency, weight = nodes()
    argument = 2.0 * np.pi * np.outer(frequency, np.asarray(radius_px, float))
    return (2.0 * np.pi * weight * frequency)[:, None] * j0(argument)


def spread_of(posterior: Posterior, *, pitch_ratio: float = 1.0, **known: ArrayLike) -> PosteriorPsf:
    """Return the point spread functions described by a posterior.

    `posterior`: draws with the names of `NAMES`, or with `core_sd`, the core before the pixel aperture, as fitted to
    point series; `pitch_ratio`: row pitch over column pitch, for that aperture; `known`: fields of `PosteriorPsf` that
    the posterior lacks. Raises BadInput if a required parameter is missing, or the halo model has no edge.
    """
    found = {field: posterior[name] for name, field in NAMES.items() if name in posterior.names}
    if "core_sd" in posterior.names:
        # The pixel aperture has the variance of a twelfth of its squared pitch; rows and columns are averaged.
        found["core_spread_px2"] = posterior["core_sd"] ** 2 + (1.0 + pitch_ratio**2) / 24.0
    if "even_share" in posterior.names:
        found["flat_share"] = 1.0 - np.sum([posterior[name] for name in transfer.PROFILE], axis=0)
    if "halo_sd" in posterior.names:
        raise BadInput("the PSF needs a halo with an edge; the fitted halo is Gaussian")
    tube = "core_frequency" in posterior.names
    given = {**({} if tube else GAUSSIAN), **known, **found}
    if not {"halo_diameter_px", "halo_fraction"} & given.keys():
        given = {**given, **NO_HALO}
    if needed := [name for name in list(NAMES.values())[:6] if name not in given]:
        raise BadInput(f"the PSF needs {', '.join(needed)}; the posterior has only {', '.join(posterior.names)}")
    shares = {name: np.clip(given[name], 0.0, 1.0) for name in SHARES if name in given}
    return PosteriorPsf(**{**given, **shares})  # pyright: ignore[reportArgumentType]


# Steps of the frequency and radius tables, cy/px and px, and extent of the latter.
FREQUENCY_STEP = 5e-4
RADIUS_STEP_PX, REACH_PX = 0.1, 150.0


@dataclass(frozen=True, kw_only=True)
class FrameGrid:
    """Pixels of a frame with padding, so that blur does not wrap around.

    `shape`: rows and columns of the frame; `room_px`: padding on each side, px; `pitch_ratio`: row pitch over column
    pitch.
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
        """Table index (step `FREQUENCY_STEP`) of every frequency of a transform, shape (row, half col)."""
        rows, cols = self.transform_shape
        down = np.fft.fftfreq(rows) / self.pitch_ratio
        frequency = np.hypot(down[:, None], np.fft.rfftfreq(cols)[None, :])
        return np.rint(frequency / FREQUENCY_STEP).astype(np.int32)

    @cached_property
    def frequency(self) -> Array:
        """Frequencies of the table, cycles per column pitch."""
        return np.asarray(FREQUENCY_STEP * np.arange(int(self.frequency_index.max()) + 1), np.float64)

    def forward_transform(self, image: NDArray) -> NDArray[np.complex64]:
        """Fourier transform of a zero-padded frame."""
        from scipy.fft import rfft2

        return np.asarray(rfft2(np.asarray(image, np.float32), s=self.transform_shape))

    def filter(self, transform: NDArray[np.complex64], table: Array) -> NDArray[np.float32]:
        """Frame of a transform times a rotationally symmetric transfer function, a table over `frequency`."""
        from scipy.fft import irfft2

        rows, cols = self.shape
        back = irfft2(
            transform * table.astype(np.float32)[self.frequency_index], s=self.transform_shape, overwrite_x=True
        )
        return np.asarray(back)[:rows, :cols]

    def distance(self, row: float, col: float) -> Array:
        """Distance of every pixel from a position, column pitches, shape (row, col)."""
        rows, cols = self.shape
        return np.hypot((np.arange(rows)[:, None] - row) * self.pitch_ratio, np.arange(cols)[None, :] - col)

    def apart(self, one: tuple[float, float], other: tuple[float, float]) -> float:
        """Distance of two positions, column pitches."""
        return float(np.hypot((one[0] - other[0]) * self.pitch_ratio, one[1] - other[1]))

    def middle(self, region: NDArray[np.int64]) -> tuple[float, float]:
        """Centre of some pixels, row and col."""
        rows, cols = np.divmod(region, self.shape[1])
        return float(rows.mean()), float(cols.mean())

    def at_border(self, region: NDArray[np.int64]) -> bool:
        """Whether some pixels touch the border of the frame."""
        rows, cols = np.divmod(region, self.shape[1])
        last = self.shape[0] - 1, self.shape[1] - 1
        return bool(rows.min() == 0 or cols.min() == 0 or rows.max() == last[0] or cols.max() == last[1])

    def point_image(self, place: tuple[float, float], profile: Array, pixels: NDArray[np.int64]) -> Array:
        """Signal of a unit point source in some pixels, from a PSF tabulated by distance, 1/px."""
        rows, cols = np.divmod(pixels, self.shape[1])
        radius = np.hypot((rows - place[0]) * self.pitch_ratio, cols - place[1])
        return radial(radius, profile) * self.pitch_ratio

    def patch(self, region: NDArray[np.int64], table: Array) -> NDArray[np.float32]:
        """Image of a unit source spread uniformly over some pixels, from a tabulated transfer function."""
        image = np.zeros(self.shape, np.float32)
        image.ravel()[region] = 1.0 / len(region)
        return self.filter(self.forward_transform(image), table)

    def around(self, row: float, col: float) -> tuple[slice, slice]:
        """Rows and columns within the range of the tabulated PSF around a position."""
        down, across = int(REACH_PX / self.pitch_ratio) + 1, int(REACH_PX) + 1
        rows = slice(max(0, int(row) - down), min(self.shape[0], int(row) + down + 1))
        cols = slice(max(0, int(col) - across), min(self.shape[1], int(col) + across + 1))
        return rows, cols


def profiles(spread: PosteriorPsf) -> Array:
    """PSF of every draw in steps of `RADIUS_STEP_PX`, shape (draw, radius)."""
    return spread.transfer(nodes()[0]) @ kernel()


@cache
def kernel() -> Array:
    """Matrix from a transfer function on `nodes` to the PSF at multiples of `RADIUS_STEP_PX`, shape (node, radius)."""
    return density_matrix(RADIUS_STEP_PX * np.arange(int(REACH_PX / RADIUS_STEP_PX) + 1))


def radial(radius_px: ArrayLike, profile: Array) -> Array:
    """Interpolate a radial table in steps of `RADIUS_STEP_PX`; 0 beyond its end."""
    place = np.asarray(radius_px) / RADIUS_STEP_PX
    index = np.minimum(place.astype(np.int32), len(profile) - 2)
    share = place - index
    found = profile[index] * (1.0 - share) + profile[index + 1] * share
    return np.where(place < len(profile) - 1, found, 0.0)
