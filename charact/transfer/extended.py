"""Extended components of a blur: halo, disc, scattered light and unresolved glare, with slopes.

A component takes a fraction q of all light: T = (1 - q) core + q core component.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from charact.transfer.tables import disc, sine_integral
from labdata import Array


@dataclass(frozen=True, kw_only=True)
class ExtendedComponent:
    """Light beyond the core before the data.

    Parameters
    ----------
    size_px
        Bounds of how wide it is, px: what that means is the form's own.
    fraction
        Bounds of its fraction of all light.
    """

    size_px: tuple[float, float]
    fraction: tuple[float, float] = (0.0, 0.4)

    name: ClassVar[str]
    share_name: ClassVar[str] = "fraction"
    size_name: ClassVar[str]
    after_size: ClassVar[int] = 1

    @property
    def parameters(self) -> dict[str, tuple[str, tuple[float, float]]]:
        """Unit and bounds of each parameter by name."""
        return {
            f"{self.name}_{self.share_name}": ("1", self.fraction),
            f"{self.name}_{self.size_name}": ("px", self.size_px),
        }

    def terms(self, frequency: Array, shape: Array) -> Iterator[Array]:
        """Yield its own transfer, then its slope with each parameter after the fraction, all of
        which broadcast with the frequency.
        """
        raise NotImplementedError

    def transfer(self, frequency: Array, shape: Array) -> Array:
        """Return the first of `terms`, shape (f,) or (n, f) and (n, parameter - 1) -> (n, f)."""
        return next(self.terms(frequency, shape.T[..., None]))

    def share_unit(self, shape: Array) -> Array:
        """Return the fraction of all light for a first parameter of one, shape (n, parameter - 1)
        -> (n, 1).
        """
        return np.ones((len(shape), 1))


class HaloComponent(ExtendedComponent):
    """Halo of a proximity gap: D its outer diameter (four gaps), e the fraction of elastically
    scattered electrons.

    H(f) = e sin(u)/u + (1 - e) Si(u)/u, u = pi D f: cosine emission with the energy fraction w
    lands at r = w R sin(2 t), the shadow of a spherical shell, whose line spread is a box of half
    width w R (Archimedes); elastic electrons have w = 1, the rest is uniform in w.
    """

    name, size_name, after_size = "halo", "diameter_px", 2

    @property
    def parameters(self) -> dict[str, tuple[str, tuple[float, float]]]:
        """As of `ExtendedComponent`, and the elastic fraction."""
        return {**super().parameters, "halo_elastic_share": ("1", (0.0, 1.0))}

    def terms(self, frequency: Array, shape: Array) -> Iterator[Array]:
        """As of `ExtendedComponent`."""
        diameter_px, elastic = shape
        u = np.pi * diameter_px * frequency
        sinc, uniform = np.sin(u) / u, sine_integral(u) / u
        yield elastic * sinc + (1.0 - elastic) * uniform
        by_u = elastic * (np.cos(u) - sinc) + (1.0 - elastic) * (sinc - uniform)
        yield by_u / diameter_px
        yield sinc - uniform


class DiscComponent(ExtendedComponent):
    """Light spread evenly over a disc of diameter D: 2 J1(u)/u, u = pi D f."""

    name, size_name = "disc", "diameter_px"

    def terms(self, frequency: Array, shape: Array) -> Iterator[Array]:
        """As of `ExtendedComponent`."""
        value, slope = disc(np.pi * shape[0] * frequency)
        yield value
        yield slope * np.pi * frequency


class ScatterComponent(ExtendedComponent):
    """Scattered light of length l: 1/(1 + (2 pi f l)^2), line spread exp(-|x|/l)/(2 l)."""

    name, size_name = "glare", "length_px"

    def terms(self, frequency: Array, shape: Array) -> Iterator[Array]:
        """As of `ExtendedComponent`."""
        square = (2.0 * np.pi * frequency) ** 2
        yield (value := 1.0 / (1.0 + square * shape[0] ** 2))
        yield -2.0 * square * shape[0] * value**2


class UnresolvedGlareComponent(ExtendedComponent):
    """Light spread wider than the window, of standard deviation s: exp(-2 (pi f s)^2).

    Inside the window only its slope is seen, which uneven light has too: how much light it is
    hardly shows. The fraction is therefore counted as if it were spread as widely as the bounds
    allow, which the slope tells; the fraction itself is that times s over the widest s.
    """

    name, share_name, size_name = "veil", "fraction_if_widest", "sigma_px"

    def terms(self, frequency: Array, shape: Array) -> Iterator[Array]:
        """As of `ExtendedComponent`."""
        square = 2.0 * (np.pi * frequency) ** 2
        yield (value := np.exp(-square * shape[0] ** 2))
        yield -2.0 * square * shape[0] * value

    def share_unit(self, shape: Array) -> Array:
        """Return the fraction of all light for one that would be all of it at the widest, shape (n,
        1) -> (n, 1).
        """
        return shape[:, :1] / self.size_px[1]


def halo(u: Array, elastic_share: Array) -> Array:
    """Return the transfer of `HaloComponent`, u = pi D f, of shapes that broadcast."""
    uniform = sine_integral(u)
    return (uniform + elastic_share * (np.sin(u) - uniform)) / u
