"""Retroreflectors such as beads and corner cubes, over a diffuse base."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from labdata.errors import BadInput
from labdata.frames import read_only
from simulate.radiance.brdf.microfacet import AlbedoTable, base_value, sample_mixture
from simulate.radiance.brdf.protocol import Reflectance, both_above, cosine_density, directions_at_cosine

NARROWEST_DEG, WIDEST_DEG = 0.02, 20.0
# Directions of which the lobe's albedo is the mean.
LATTICE = 8192


@dataclass(frozen=True, kw_only=True)
class Retroreflector:
    """A lobe around the direction to the light, over a diffuse base.

    Parameters
    ----------
    share
        Fraction of the light in the lobe, over wavelength.
    reflectance
        Of the base, over wavelength.
    half_width_deg
        Angle between light and viewer at half of the lobe's maximum, degrees.

    Notes
    -----
    f = R N(angle)/max(cos(i), cos(o)) + rho (1 - R e(i)) (1 - R e(o))/(pi (1 - R e_mean)), N = k exp(k (cos - 1))/(2 pi
    (1 - exp(-2 k))) with an integral of 1 over all directions, e the lobe's albedo: 1 but for grazing light. The
    coefficient of retroreflection, as sheets state it, is R N(0) cd lx-1 m-2 at normal incidence.
    """

    share: Reflectance
    reflectance: Reflectance
    half_width_deg: float = 0.5

    def __post_init__(self) -> None:
        if not NARROWEST_DEG <= self.half_width_deg <= WIDEST_DEG:
            raise BadInput(
                f"half_width_deg must lie in [{NARROWEST_DEG:g}, {WIDEST_DEG:g}], got {self.half_width_deg:g}"
            )

    @property
    def concentration(self) -> float:
        """k of the lobe, dimensionless."""
        return float(np.log(2.0) / (2.0 * np.sin(0.5 * np.deg2rad(self.half_width_deg)) ** 2))

    @property
    def _lobe_albedo(self) -> AlbedoTable:
        return _lobe_albedo(self.concentration)

    def value(
        self, incoming: NDArray[np.floating], outgoing: NDArray[np.floating], wavelength_nm: ArrayLike
    ) -> NDArray[np.float64]:
        """Return f, sr-1, shape (band, ray)."""
        above = both_above(incoming, outgoing)
        back = _lobe(incoming, outgoing, self.concentration)
        back = back * above / np.maximum(np.maximum(incoming[:, 2], outgoing[:, 2]), 1e-12)
        share, base = self.share.at(wavelength_nm)[:, None], self.reflectance.at(wavelength_nm)[:, None]
        table = self._lobe_albedo
        below = base_value(share * table.at(incoming), share * table.at(outgoing), share * table.mean, base)
        return share * back + below * above

    def sample(
        self, outgoing: NDArray[np.floating], rng: np.random.Generator
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Draw directions from the lobe or by the cosine law, half of each; and their densities."""
        back = _lobe_directions(outgoing, self.concentration, rng.random((len(outgoing), 2)))
        drawn = sample_mixture(back, np.full(len(outgoing), 0.5), rng)
        return drawn, self.pdf(drawn, outgoing)

    def pdf(self, incoming: NDArray[np.floating], outgoing: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return the density of `sample`, sr-1, shape (ray,)."""
        return 0.5 * _lobe(incoming, outgoing, self.concentration) + 0.5 * cosine_density(incoming)

    def albedo(self, outgoing: NDArray[np.floating], wavelength_nm: ArrayLike) -> NDArray[np.float64]:
        """Return the fraction of a uniform sky's light that goes to the viewer, shape (band, ray)."""
        back = self.share.at(wavelength_nm)[:, None] * self._lobe_albedo.at(outgoing)
        return back + (1.0 - back) * self.reflectance.at(wavelength_nm)[:, None]


def _lobe(incoming: NDArray[np.floating], outgoing: NDArray[np.floating], concentration: float) -> NDArray[np.float64]:
    # 1 - cos of the angle between, by the chord, which keeps its digits for narrow lobes.
    apart = 0.5 * np.sum(np.square(incoming - outgoing), axis=1)
    return concentration / (-2.0 * np.pi * np.expm1(-2.0 * concentration)) * np.exp(-concentration * apart)


def _lobe_directions(
    outgoing: NDArray[np.floating], concentration: float, even: NDArray[np.floating]
) -> NDArray[np.float64]:
    """Return directions of the lobe from pairs of uniform numbers in [0, 1)."""
    apart = -np.log1p(even[:, 0] * np.expm1(-2.0 * concentration)) / concentration
    aside = np.sqrt(np.maximum(apart * (2.0 - apart), 0.0))
    turn = 2.0 * np.pi * even[:, 1]
    # Two directions normal to the viewing direction (Duff et al., J. Comput. Graph. Tech. 6(1), 2017).
    sign = np.copysign(1.0, outgoing[:, 2])
    a = -1.0 / (sign + outgoing[:, 2])
    b = outgoing[:, 0] * outgoing[:, 1] * a
    x, y = outgoing[:, 0], outgoing[:, 1]
    one = np.column_stack([1.0 + sign * x**2 * a, sign * b, -sign * x])
    other = np.column_stack([b, sign + y**2 * a, -y])
    across = (aside * np.cos(turn))[:, None] * one + (aside * np.sin(turn))[:, None] * other
    return (1.0 - apart)[:, None] * outgoing + across


@lru_cache(maxsize=64)
def _lobe_albedo(concentration: float) -> AlbedoTable:
    """Return int N cos(i)/max(cos(i), cos(o)) di; light below the surface is lost."""
    width = 1.0 / np.sqrt(concentration)
    near = min(8.0 * width, 1.0) * np.linspace(0.0, 1.0, 65) ** 2
    cosine = np.union1d(near, np.linspace(0.0, 1.0, 33))
    # A lattice (Korobov, golden ratio): rows of a square grid would all meet the horizon at once.
    steps = np.arange(LATTICE)
    even = np.column_stack([(steps + 0.5) / LATTICE, (steps * 0.6180339887498949) % 1.0])
    albedo = []
    for mu in cosine:
        incoming = _lobe_directions(
            np.broadcast_to(directions_at_cosine(np.array([mu])), (len(even), 3)), concentration, even
        )
        height = np.maximum(incoming[:, 2], 0.0)
        albedo.append(float(np.mean(height / np.maximum(np.maximum(height, mu), 1e-12))))
    return AlbedoTable(read_only(cosine), read_only(np.array(albedo)))
