"""Forms of the point spread that lenses and tubes have, as transfers along one direction: a core,
and light beyond it.

Every core is scaled by the frequency at which it falls to one half, so that forms can be compared
parameter by parameter.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from charact.estimators.mtf.blur_models import transfer as forms
from charact.estimators.mtf.blur_models.pupil_table import (
    AREA,
    SQUARED_WAVES,
    pupil_table,
    pupils_from_table,
)
from charact.estimators.mtf.blur_models.transfer import MOFFAT_EXPONENT, moffat

Array = NDArray[np.float64]

HALF_FREQUENCY = (0.008, 6.0)
# Half frequency before the data, cycles per pixel, and the standard deviation of its ln: a core
# below the pixel is possible, and not as likely for every factor by which it would be smaller
# still.
HALF_FREQUENCY_PRIOR = (0.35, 1.4)
# Exponent of exp(-ln 2 (f/f2)^n): tubes about 1.1 to 1.7, a Gaussian 2, and what aberrations may
# make of it.
EXPONENT = (0.6, 4.0)
EXPONENT_PRIOR = (1.6, 0.6)
# Transfers below this count as this: numbers smaller still slow every product down a hundredfold.
MIN_LN = -80.0
# Share of the light in a halo, in scattered light.
WIDE_SHARE = (0.0, 0.4)

Core = Literal["gaussian", "exponential", "moffat", "airy", "pupil"]

# Half frequency of a clear pupil in focus over its cut-off.
AIRY_HALF = 0.40397275

# What shapes a core besides its half frequency: unit and bounds by name, and where a fit begins.
SHAPES: dict[Core, dict[str, tuple[str, tuple[float, float]]]] = {
    "gaussian": {},
    "exponential": {"exponent": ("1", EXPONENT)},
    "moffat": {"moffat_exponent": ("1", MOFFAT_EXPONENT)},
    "airy": {},
    "pupil": {"obscured_area": ("1", AREA), "squared_defocus": ("waves^2", SQUARED_WAVES)},
}
STARTS: dict[Core, tuple[float, ...]] = {
    "gaussian": (),
    "exponential": (1.5,),
    "moffat": (2.5,),
    "airy": (),
    "pupil": (0.05, 0.05),
}


@dataclass(frozen=True, kw_only=True)
class ExtendedComponent:
    """Light beyond the core before the data.

    Parameters
    ----------
    size_px
        Bounds of how wide it is, px: what that means is the form's own.
    fraction
        Bounds of its share of all light.
    """

    size_px: tuple[float, float]
    fraction: tuple[float, float] = WIDE_SHARE

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

    def transfer(self, frequency: Array, shape: Array) -> Array:
        """Return its own transfer for parameters after the share, shape (f,) and (n, parameter - 1)
        -> (n, f).
        """
        raise NotImplementedError

    def share_unit(self, shape: Array) -> Array:
        """Return the share of all light for a first parameter of one, shape (n, parameter - 1) ->
        (n, 1).
        """
        return np.ones((len(shape), 1))


class HaloComponent(ExtendedComponent):
    """An intensifier's halo: its diameter, and besides the share of electrons that keep their
    energy.
    """

    name, size_name, after_size = "halo", "diameter_px", 2

    @property
    def parameters(self) -> dict[str, tuple[str, tuple[float, float]]]:
        """As of `ExtendedComponent`, and the elastic share."""
        return {**super().parameters, "halo_elastic_share": ("1", (0.0, 1.0))}

    def transfer(self, frequency: Array, shape: Array) -> Array:
        """As of `ExtendedComponent`, shape (n, 2)."""
        return forms.halo(frequency, shape[:, 0], shape[:, 1])


class DiscComponent(ExtendedComponent):
    """A halo of even brightness: its diameter."""

    name, size_name = "disc", "diameter_px"

    def transfer(self, frequency: Array, shape: Array) -> Array:
        """As of `ExtendedComponent`, shape (n, 1)."""
        return forms.disc(frequency, shape[:, 0])


class ScatterComponent(ExtendedComponent):
    """Scattered light of a camera of which nothing is known: how far it reaches."""

    name, size_name = "glare", "length_px"

    def transfer(self, frequency: Array, shape: Array) -> Array:
        """As of `ExtendedComponent`, shape (n, 1)."""
        return forms.glare(frequency, shape[:, 0])


class UnresolvedGlareComponent(ExtendedComponent):
    """Light spread wider than the window: its standard deviation.

    Inside the window only its slope is seen, which uneven light has too: how much light it is
    hardly shows. The share is therefore counted as if it were spread as widely as the bounds allow,
    which the slope tells; the share itself is that times sigma over the widest sigma.
    """

    name, share_name, size_name = "veil", "fraction_if_widest", "sigma_px"

    def transfer(self, frequency: Array, shape: Array) -> Array:
        """As of `ExtendedComponent`, shape (n, 1)."""
        return np.exp(-2.0 * (np.pi * frequency * shape[:, :1]) ** 2)

    def share_unit(self, shape: Array) -> Array:
        """Return the share of all light for one that would be all of it at the widest, shape (n, 1)
        -> (n, 1).
        """
        return shape[:, :1] / self.size_px[1]


@dataclass(frozen=True, kw_only=True)
class BlurModel:
    """A form of the transfer along one direction, aperture and video filter left aside.

    Parameters
    ----------
    core
        "gaussian": exp(-ln 2 (f/f2)^2). "exponential": exp(-ln 2 (f/f2)^n), the form of tubes.
        "moffat": that of the spread (1 + r^2/a^2)^-b, with wings of a power law. "airy": that of a
        clear pupil in focus; "pupil": of one with a hole in its middle and out of focus.
    wide
        Light beyond the core: a share q of all light, transfer (1 - q) core + q core wide; None:
        none.
    """

    core: Core
    wide: ExtendedComponent | None = None

    @property
    def name(self) -> str:
        """Name for people."""
        return self.core if self.wide is None else f"{self.core} + {self.wide.name}"

    @property
    def parameters(self) -> dict[str, tuple[str, tuple[float, float]]]:
        """Unit and bounds of each parameter by name."""
        low, high = np.log(HALF_FREQUENCY)
        half = {"ln_half_frequency": ("ln(cy/px)", (float(low), float(high)))}
        shape = SHAPES[self.core]
        return {**half, **shape, **(self.wide.parameters if self.wide else {})}

    @cached_property
    def bounds(self) -> Array:
        """Bounds of the parameters, shape (parameter, 2)."""
        return np.array([bound for _, bound in self.parameters.values()])

    @property
    def core_parameters(self) -> int:
        """Number of parameters before those of the light beyond the core."""
        return 1 + len(SHAPES[self.core])

    def start(self, half_frequency_cy_per_px: float) -> Array:
        """Return a starting point of the optimisation."""
        extended = (
            [0.7 * low + 0.3 * high for _, (low, high) in self.wide.parameters.values()]
            if self.wide
            else []
        )
        return np.array([np.log(half_frequency_cy_per_px), *STARTS[self.core], *extended])

    def modulus(self, theta: Array, frequency: Array) -> Array:
        """Return the transfer, shape (n, parameter) and (f,) -> (n, f); negative where defocus
        turns it round.
        """
        core = self._core_at(theta, frequency)
        if self.wide is None:
            return core
        tail = theta[:, self.core_parameters :]
        fraction = tail[:, :1] * self.wide.share_unit(tail[:, 1:])
        return core * (1.0 - fraction + fraction * self.wide.transfer(frequency, tail[:, 1:]))

    def _core_at(self, theta: Array, frequency: Array) -> Array:
        half = np.exp(theta[:, 0])
        if self.core == "airy":
            v = np.minimum(AIRY_HALF * frequency / half[:, None], 1.0)
            return (np.arccos(v) - v * np.sqrt(1.0 - v**2)) * 2.0 / np.pi
        if self.core == "pupil":
            at, area, squared = (
                np.ascontiguousarray(frequency, float),
                theta[:, 1].copy(),
                theta[:, 2].copy(),
            )
            return pupils_from_table(at, half, area, squared, pupil_table())
        if self.core == "moffat":
            ln = moffat(frequency, half, theta[:, 1])
        else:
            ln = forms.exponential(
                frequency, half, np.full_like(half, 2.0) if self.core == "gaussian" else theta[:, 1]
            )
        return np.exp(np.maximum(ln, MIN_LN))

    def log_prior(self, theta: Array) -> Array:
        """Return ln of the prior density, -inf outside the bounds: flat but for half frequency and
        exponent.
        """
        bounds, (mean, precision) = self.bounds, self.prior_precision
        in_bounds = np.all((theta >= bounds[:, 0]) & (theta <= bounds[:, 1]), axis=1)
        normal = precision > 0
        flat = 0.5 * np.sum(np.log(precision[normal] / (2.0 * np.pi))) - np.sum(
            np.log(np.ptp(bounds[~normal], axis=1))
        )
        return np.where(
            in_bounds, flat - 0.5 * np.sum(precision * (theta - mean) ** 2, axis=1), -np.inf
        )

    @cached_property
    def prior_precision(self) -> tuple[Array, Array]:
        """Mean and precision of the Gaussian part of the prior of each parameter; 0: flat."""
        mean, precision = np.zeros((2, len(self.bounds)))
        mean[0], precision[0] = np.log(HALF_FREQUENCY_PRIOR[0]), HALF_FREQUENCY_PRIOR[1] ** -2
        if self.core == "exponential":
            mean[1], precision[1] = EXPONENT_PRIOR[0], EXPONENT_PRIOR[1] ** -2
        return mean, precision
