"""How a camera spreads the light of a point: core, wing, halo and glare, as many times as its posterior has draws."""

from dataclasses import dataclass, fields, replace
from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from charact.bloom import transfer
from labdata.errors import BadInput
from labdata.measurement import Posterior

Array = NDArray[np.float64]

# Frequencies on which densities are worked out; so many make them true to 150 px.
HIGHEST_CY_PER_PX, NODES = 0.8, 512
SHARES = ("halo_fraction", "wing_share", "glare_fraction")
POSITIVE = ("halo_diameter_px", "core_frequency_cy_per_px", "core_exponent", "wing_radius_px")
# Name of each parameter of a posterior and the field that takes it; a spread without core frequency is Gaussian, one
# without a halo has none.
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
    """The point spread of a camera, one per draw; every field has the shape (draw,) or is one number for all.

    Parameters
    ----------
    halo_diameter_px
        Outer diameter of the halo before blur, four gaps, column pitches.
    elastic_share
        Share of the bounced electrons that keep their energy, dimensionless.
    halo_fraction
        Share of all light that lands in the halo, dimensionless.
    core_frequency_cy_per_px, core_exponent
        Of the core's transfer exp(-(f/fc)^n - 2 pi^2 f^2 s^2); an infinite fc leaves the Gaussian alone.
    core_spread_px2
        s^2 of the core, px^2.
    wing_share, wing_radius_px, wing_exponent
        Share of the light outside halo and glare that lies in a Moffat wing (1 + r^2/a^2)^-b, its a and its b.
    wing_sd_px, wing_peak
        Width of a wing of Matern's form instead, and its p (`charact.bloom.transfer.matern`); 0 px: Moffat's.
    flat_share, rising_share, rim_share
        Fractions of the halo that are flat, rise as x^2 and as x^12 to its edge; what is left bounced with an even
        fraction of its energy.
    glare_fraction
        Share of all light that is spread evenly, dimensionless.
    glare_area_px
        Over how many pixels; None: over the frame.

    Raises
    ------
    BadInput
        If a share is outside 0 to 1 or a length is not positive.
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
        names = [field.name for field in fields(self) if field.name != "glare_area_px"]
        arrays = np.broadcast_arrays(*(np.atleast_1d(np.asarray(getattr(self, name), float)) for name in names))
        for name, array in zip(names, arrays, strict=True):
            if name in SHARES and not ((array >= 0) & (array <= 1)).all():
                raise BadInput(f"{name} must lie in 0 to 1, got {array.min():g} to {array.max():g}")
            if name in POSITIVE and not (array > 0).all():
                raise BadInput(f"{name} must be positive, got {array.min():g}")
            object.__setattr__(self, name, array)

    def __len__(self) -> int:
        """Number of draws."""
        return len(self.halo_diameter_px)

    def taken(self, draws: ArrayLike) -> "PosteriorPsf":
        """Return the spread of some draws, by their numbers."""
        index = np.asarray(draws, int)
        names = [field.name for field in fields(self) if field.name != "glare_area_px"]
        return replace(self, **{name: getattr(self, name)[index] for name in names})

    def thinned(self, most: int = 30) -> "PosteriorPsf":
        """Return the spread of at most so many draws, evenly taken."""
        return self if len(self) <= most else self.taken(np.linspace(0, len(self) - 1, most).round())

    def centre(self) -> "PosteriorPsf":
        """Return one draw: the median of every parameter."""
        names = [field.name for field in fields(self) if field.name != "glare_area_px"]
        return replace(self, **{name: np.median(getattr(self, name), keepdims=True) for name in names})

    def transfer(self, frequency_cy_per_px: ArrayLike) -> Array:
        """Return the transfer function of all light but the glare, 1 at frequency 0, shape (draw, frequency)."""
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
        """Profile of the halo's disc, shape (draw, fraction)."""
        flat, rising, rim = (np.asarray(one) for one in (self.flat_share, self.rising_share, self.rim_share))
        return np.stack([self.elastic_share, 1.0 - self.elastic_share - flat - rising - rim, rising, rim], axis=-1)

    @property
    def halo_share(self) -> Array:
        """Share of the light that is not glare in the halo, shape (draw,)."""
        return self.halo_fraction / (1.0 - np.asarray(self.glare_fraction))

    def density(self, radius_px: ArrayLike) -> Array:
        """Return how much of a point's light lands on a pixel so far from it, 1/px2, shape (draw, radius).

        Parameters
        ----------
        radius_px
            Distances, column pitches, shape (radius,); true to about 150 px.
        """
        from scipy.special import j0

        frequency, weight = nodes()
        kernel = (2.0 * np.pi * weight * frequency)[:, None] * j0(
            2.0 * np.pi * np.outer(frequency, np.asarray(radius_px, float))
        )
        return np.maximum(self.transfer(frequency) @ kernel, 0.0)


@cache
def nodes() -> tuple[Array, Array]:
    """Frequencies, cy/px, on which densities are worked out, and the weights of their sum (Gauss and Legendre)."""
    node, weight = np.polynomial.legendre.leggauss(NODES)
    half = 0.5 * HIGHEST_CY_PER_PX
    return half * (node + 1.0), half * weight


def spread_of(posterior: Posterior, *, pitch_ratio: float = 1.0, **known: ArrayLike) -> PosteriorPsf:
    """Return the spread that a posterior describes.

    Parameters
    ----------
    posterior
        Draws with the names of `NAMES`, or with `core_sd`, the core before the pixel's aperture, as the fits of a point
        series give them.
    pitch_ratio
        Row pitch over column pitch, for that aperture.
    known
        Fields of `PosteriorPsf` that the posterior does not have.

    Raises
    ------
    BadInput
        If a parameter that is needed is missing, or the halo is of another form.
    """
    found = {field: posterior[name] for name, field in NAMES.items() if name in posterior.names}
    if "core_sd" in posterior.names:
        # A pixel's aperture is as wide as a Gaussian of a twelfth of its pitch squared; rows and columns are averaged.
        found["core_spread_px2"] = posterior["core_sd"] ** 2 + (1.0 + pitch_ratio**2) / 24.0
    if "even_share" in posterior.names:
        found["flat_share"] = 1.0 - np.sum([posterior[name] for name in transfer.PROFILE], axis=0)
    if "halo_sd" in posterior.names:
        raise BadInput("a spread needs a halo with an edge; the one that was fitted fades out like a Gaussian")
    tube = "core_frequency" in posterior.names
    given = {**({} if tube else GAUSSIAN), **known, **found}
    if not {"halo_diameter_px", "halo_fraction"} & given.keys():
        given = {**given, **NO_HALO}
    if needed := [name for name in list(NAMES.values())[:6] if name not in given]:
        raise BadInput(f"a spread needs {', '.join(needed)}; the posterior has only {', '.join(posterior.names)}")
    shares = {name: np.clip(given[name], 0.0, 1.0) for name in SHARES if name in given}
    return PosteriorPsf(**{**given, **shares})  # pyright: ignore[reportArgumentType]
