"""Blur models of a point series: core, halo and the parameters with their priors."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Literal

import numpy as np

from charact.transfer import spreads
from charact.transfer.form import Parameter, Parametric
from labdata import Array, Camera, has_tube

# Frequencies, cycles per column pitch, and weights of the transforms, for the sharpest core and the
# outermost ring of a series.
FREQUENCIES, _ = QUADRATURE = spreads.quadrature(1.25, 300)

Core = Literal["gaussian", "tube", "moffat", "matern"]
# Cores tried: of any camera, and of cameras with a tube.
CORES: tuple[Core, ...] = ("gaussian", "matern", "moffat")
CORES_OF_TUBES: tuple[Core, ...] = ("gaussian", "tube", "moffat")
Halo = Literal["none", "disc"]


CORE_SD = Parameter(name="core_sd", unit="px", low=0.35, high=8.0, start=1.2)
WING_SHARE = Parameter(name="wing_share", unit="1", low=0.0, high=0.7, start=0.05)
WINGS = {
    "moffat": (
        WING_SHARE,
        Parameter(name="wing_radius", unit="px", low=0.7, high=12.0, start=3.0),
        Parameter(name="wing_exponent", unit="1", low=1.1, high=4.0, start=2.0),
    ),
    "matern": (
        WING_SHARE,
        Parameter(name="wing_sd", unit="px", low=1.0, high=20.0, start=4.0),
        Parameter(name="wing_peak", unit="1", low=0.0, high=1.3, start=0.5),
    ),
}
LEAST_DIAMETER_PX = 12.0
# Fractions of a disc's light by density, with weak priors. Bounds slightly beyond 0..1, since a
# bound at 0 would bias the diameter.
PROFILE = tuple(
    Parameter(name=name, unit="1", low=low, high=1.2, mean=mean, sd=0.4)
    for name, low, mean in zip(
        spreads.PROFILE, (-0.15, -0.6, -0.6, -0.15), (0.3, 0.3, 0.1, 0.1), strict=True
    )
)
HALO_FRACTION = Parameter(name="halo_fraction", unit="1", low=1e-4, high=0.6, start=0.08)


@dataclass(frozen=True, kw_only=True)
class HaloModel(Parametric):
    """Blur model of a point source.

    `core`, `halo`: families of core and halo; `reach_px`: radius of the outermost ring, which
    limits the halo diameter; `pitch_ratio`: row pitch over column pitch, for the pixel's aperture;
    `sensor`: sensor description, whose tube gives the core's priors; None if unknown.
    """

    core: Core
    halo: Halo
    reach_px: float
    pitch_ratio: float = 1.0
    sensor: Camera | None = None

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """Parameters in the order of a point's coordinates, the core's first."""
        of_core = CORE_SD, *WINGS.get(self.core, ())
        core = (*tube_priors(self.sensor), CORE_SD) if self.core == "tube" else of_core
        widest = Parameter(
            name="halo_diameter",
            unit="px",
            low=LEAST_DIAMETER_PX,
            high=1.7 * self.reach_px,
            start=0.8 * self.reach_px,
        )
        return core + ((widest, *PROFILE, HALO_FRACTION) if self.halo == "disc" else ())

    def at(self, points: Array) -> dict[str, Array]:
        """Map parameter names to the columns of points."""
        return dict(zip(self.names, points.T, strict=True))

    def transform(self, points: Array) -> Array:
        """Transfer function of core, wing, pixel and halo, shape (draw, frequency)."""
        core = self.add_wing(self.blur_transform(points), points) * pixel_of(self.pitch_ratio)
        return core * self.halo_factor(points)

    def add_wing(self, blur: Array, points: Array) -> Array:
        """Add the core's wing to a blur, shape (draw, frequency)."""
        if self.core not in WINGS:
            return blur
        of = self.at(points)
        if self.core == "matern":
            wing = spreads.matern(FREQUENCIES, of["wing_sd"], of["wing_peak"])
        else:
            wing = spreads.moffat(FREQUENCIES, of["wing_radius"], of["wing_exponent"])
        return spreads.mix(blur, of["wing_share"], wing)

    def halo_factor(self, points: Array) -> Array:
        """Factor of the halo on the core's transfer function, shape (draw, frequency), or 1."""
        halo = self.halo_transform(points)
        if halo is None:
            return np.ones((1, 1))
        return spreads.mix(1.0, self.at(points)["halo_fraction"], halo)

    def blur_transform(self, points: Array) -> Array:
        """Transfer function of the core without wing and pixel, shape (draw, frequency)."""
        of = self.at(points)
        blur = spreads.gaussian(FREQUENCIES, of["core_sd"] ** 2)
        if self.core == "tube":
            blur = blur * spreads.tube(FREQUENCIES, of["core_frequency"], of["core_exponent"])
        return blur

    def halo_transform(self, points: Array) -> Array | None:
        """Transfer function of the halo alone, shape (draw, frequency); None without a halo."""
        if self.halo == "none":
            return None
        of = self.at(points)
        return spreads.halo_disc(FREQUENCIES, of["halo_diameter"], profile_of(of))


def profile_of(of: Mapping[str, Array]) -> Array:
    """Return the profile of a disc, shape (draw, fraction), from named parameters."""
    return np.stack([of[name] for name in spreads.PROFILE], axis=-1)


@lru_cache(maxsize=4)
def pixel_of(pitch_ratio: float) -> Array:
    """Transfer function of the pixel aperture, shape (frequency,)."""
    return spreads.pixel_of_all_directions(FREQUENCIES, pitch_ratio)


def onto_nodes(node_px: Array) -> Array:
    """Return the matrix that takes transforms to light at radii, shape (frequency, node); not to be
    written to.
    """
    return _onto_nodes(np.asarray(node_px, np.float64).tobytes())


@lru_cache(maxsize=4)
def _onto_nodes(nodes: bytes) -> Array:
    return spreads.hankel_matrix(QUADRATURE, np.frombuffer(nodes))


def tube_priors(sensor: Camera | None) -> tuple[Parameter, ...]:
    """Parameters of an image tube's core: as described, or of image tubes in general."""
    frequency = Parameter(name="core_frequency", unit="cy/px", low=0.03, high=2.0, mean=0.4, sd=0.3)
    exponent = Parameter(name="core_exponent", unit="1", low=0.7, high=2.5, mean=1.3, sd=0.3)
    if not has_tube(sensor):
        return frequency, exponent
    scale = float(sensor.ccd.pitch_x_um) * float(sensor.taper.demagnification) * 1e-3
    cut_off = float(sensor.tube.mtf_frequency_lp_per_mm) * scale
    described_exponent = replace(exponent, mean=float(sensor.tube.mtf_exponent), sd=0.1)
    return replace(frequency, mean=cut_off, sd=0.15 * cut_off), described_exponent
