"""Two-dimensional blur models of points: elliptical cores and extended components.

A transfer is kept at radial frequencies and a few directions. Between directions it is a polynomial
in the cosine of twice the angle.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from charact.estimators.mtf.point.spot_image_matrix import COSINES, FREQUENCIES, Aperture
from charact.estimators.mtf.point.thresholds import PRIORS
from charact.transfer.cores import ON_POINTS
from charact.transfer.extended import ExtendedComponent
from charact.transfer.form import Parameter, ProperPrior, flat_parameters
from charact.transfer.tables import disc
from charact.transfer.video_filter import powers
from labdata import Array

# Centres of the departure bumps in ln of frequency over half frequency, and their width.
BUMPS, BUMP_WIDTH = (-2.0, -1.0, -0.4, 0.2, 0.7), 0.5
# Parameters of a tube that a Gaussian blur multiplies: half frequencies at which that blur is
# distinguishable, ln of cycles per column pitch, and the exponent of its tails.
OF_LENS: dict[str, dict[str, float]] = {
    "ln_half_frequency": {"low": float(np.log(0.02)), "high": float(np.log(0.6))},
    "exponent": {
        "low": PRIORS.tail[0],
        "high": PRIORS.tail[1],
        "mean": PRIORS.tail_prior[0],
        "sd": PRIORS.tail_prior[1],
        "start": 1.3,
    },
}
# The video filter's bandwidth as a parameter, and the powers of its logarithm in the image, from 0.
BANDWIDTH, BANDWIDTH_ORDERS = "ln_video_bandwidth", 3


@dataclass(frozen=True, kw_only=True)
class BlurModel2D(ProperPrior):
    """Transfer of blur and source, without aperture and video filter."""

    core: str  # Name of the core in `ON_POINTS`
    round: bool = False  # Whether rows and columns are blurred alike
    # Whether a Gaussian multiplies the core: a tube behind a lens, or before its fibres
    lens: bool = False
    wide: ExtendedComponent | None = None  # Extended component, round; None: none
    # Diameter of the source, column pitches, or its bounds if unknown
    pinhole_px: float | tuple[float, float] = 0.0
    # Prior standard deviation of model departures, fraction of the transfer; 0: none
    departures: float = 0.0
    # Described parameters: name, mean and standard deviation. "ln_video_bandwidth", ln of the video
    # bandwidth over the described one, is a parameter only if it is among them
    known: tuple[tuple[str, float, float], ...] = ()

    @property
    def name(self) -> str:
        """Printed name."""
        core = f"{self.core} x gaussian" if self.lens else self.core
        core = f"round {core}" if self.round else core
        core = core if self.wide is None else f"{core} + {self.wide.name}"
        return f"{core} and departures" if self.departures else core

    @property
    def blur_parameters(self) -> int:
        """Number of parameters before those of the extended component."""
        return self.core_parameters + int(self.lens) + int(not self.round)

    @property
    def core_parameters(self) -> int:
        """Number of the core's parameters."""
        return len(ON_POINTS[self.core][0].parameters)

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """Parameters of the core, lens, stretch, extended component, departures, video and
        pinhole.
        """
        core = ON_POINTS[self.core][0].parameters
        lens, stretch, departures, bandwidth, pinhole = (), (), (), (), ()
        if self.lens:
            core = tuple(replace(part, **OF_LENS.get(part.name, {})) for part in core)
            low, high = PRIORS.blur_px
            lens = (Parameter(name="blur_px", unit="px", low=low, high=high, start=0.4),)
        if not self.round:
            low, high = PRIORS.stretch
            sd = PRIORS.stretch_sd
            stretch = (Parameter(name="stretch", unit="1", low=low, high=high, sd=sd),)
        extended = flat_parameters(self.wide.parameters) if self.wide else ()
        if extended:
            extended = (replace(extended[0], sd=PRIORS.wide_share_sd), *extended[1:])
        if self.departures:
            bound, sd = 4.0 * self.departures, self.departures
            departures = tuple(
                Parameter(name=f"departure_{number}", unit="1", low=-bound, high=bound, sd=sd)
                for number in range(len(BUMPS))
            )
        known = {name: {"mean": mean, "sd": sd, "start": mean} for name, mean, sd in self.known}
        if BANDWIDTH in known:
            bound = 6.0 * known[BANDWIDTH]["sd"]
            bandwidth = (Parameter(name=BANDWIDTH, unit="1", low=-bound, high=bound),)
        if isinstance(self.pinhole_px, tuple):
            pinhole = flat_parameters({"pinhole_px": ("px", self.pinhole_px)})
        every = (*core, *lens, *stretch, *extended, *departures, *bandwidth, *pinhole)
        return tuple(replace(part, **known.get(part.name, {})) for part in every)

    def start(self, first: float) -> Array:
        """As of `Parametric`; a described half frequency is where it begins."""
        described = {name: mean for name, mean, _ in self.known}
        return super().start(described.get("ln_half_frequency", first))

    @property
    def ln_volume(self) -> float:
        """As of `ProperPrior`, of which the priors at their border are half of a normal one."""
        halves = int(self.wide is not None) + int("defocus_square" in self.names)
        return super().ln_volume + halves * float(np.log(2.0))

    def camera(self, theta: Array, frequency: Array, cosine: Array) -> Array:
        """Return the transfer of the camera's blur, without aperture, shape (n, direction,
        frequency).

        `theta`: parameters, shape (n, parameter); `frequency`: radial frequency, cycles per column
        pitch, shape (frequency,); `cosine`: cosine of twice the angle of each direction to the
        rows, shape (direction,).
        """
        p = {name: theta[:, index] for index, name in enumerate(self.names)}
        lens = self._core(theta, p.get("stretch"), frequency, cosine)
        if self.lens:
            lens = lens * np.exp(-2.0 * (np.pi * p["blur_px"][:, None] * frequency) ** 2)[:, None]
        if self.departures:
            amplitudes = np.stack(
                [p[f"departure_{number}"] for number in range(len(BUMPS))], axis=1
            )
            off = np.log(np.maximum(frequency, 1e-12)) - theta[:, :1]
            bumps = np.exp(-0.5 * ((off[:, None] - np.array(BUMPS)[:, None]) / BUMP_WIDTH) ** 2)
            lens = lens * (1.0 + np.einsum("nk,nkf->nf", amplitudes, bumps))[:, None]
        if self.wide is None:
            return lens
        first, *shape = (p[name] for name in self.wide.parameters)
        extended = self.wide.transfer(frequency, np.stack(shape, axis=1))
        return lens * (1.0 - first[:, None] + first[:, None] * extended)[:, None]

    def _core(self, theta: Array, stretch: Array | None, frequency: Array, cosine: Array) -> Array:
        """Return the core along each direction: that of a direction-dependent half frequency."""
        shape = theta[:, : self.core_parameters]
        if stretch is None:
            modulus = ON_POINTS[self.core][0].transfer(shape, frequency)[:, None]
            return np.broadcast_to(modulus, (len(theta), cosine.size, frequency.size))
        along, across = 0.5 * (1.0 + cosine), 0.5 * (1.0 - cosine)
        wider = np.exp(stretch[:, None])
        ln_narrower = 0.5 * np.log(along / wider + across * wider)
        every = np.repeat(shape, cosine.size, axis=0)
        every[:, 0] -= ln_narrower.ravel()
        core = ON_POINTS[self.core][0].transfer(every, frequency)
        return core.reshape(len(theta), cosine.size, frequency.size)

    def transfer(self, theta: Array) -> Array:
        """Return the transfer of blur and source at the nodes of an image, shape (n, direction,
        frequency).
        """
        size = self.pinhole_px if isinstance(self.pinhole_px, float) else theta[:, -1:, None]
        return self.camera(theta, FREQUENCIES, COSINES) * pinhole(FREQUENCIES, size)

    def ln_bandwidth(self, theta: Array) -> Array | None:
        """Return ln of the video bandwidth over the described one, shape (n,); None: no
        parameter.
        """
        names = self.names
        return theta[:, names.index(BANDWIDTH)] if BANDWIDTH in names else None

    @property
    def bandwidth_order(self) -> int:
        """Number of powers of ln bandwidth in the image: 1 without the parameter."""
        return BANDWIDTH_ORDERS if BANDWIDTH in self.names else 1

    def nodes(self, theta: Array) -> Array:
        """Return the transfer of blur and source times powers of ln bandwidth, for `pixel_matrix`,
        shape (n, node).
        """
        transfer, bandwidth = self.transfer(theta).reshape(len(theta), -1), self.ln_bandwidth(theta)
        if bandwidth is None:
            return transfer
        return np.concatenate(
            [bandwidth[:, None] ** order * transfer for order in range(BANDWIDTH_ORDERS)], axis=1
        )


def mtf_of_camera(
    form: BlurModel2D, draws: Array, frequency: Array, aperture: Aperture, *, vertical: bool
) -> Array:
    """Return the MTF of draws along rows or columns, aperture and video filter included, shape
    (draw, frequency).
    """
    direction = np.array([-1.0 if vertical else 1.0])
    blur = np.abs(form.camera(draws, frequency * aperture.summed_px, direction)[:, 0])
    if vertical:
        return blur * np.abs(aperture.vertical(frequency))
    bandwidth = form.ln_bandwidth(draws)
    if bandwidth is not None and aperture.video is not None:
        blur = blur * np.exp(powers(bandwidth) @ aperture.video.bend(frequency).real)
    return blur * np.abs(aperture.horizontal(frequency))


def pinhole(frequency: Array, diameter_px: float | Array) -> Array:
    """Return 2 J1(u)/u, u = pi d f, the transfer of a uniform disc."""
    return disc(np.pi * diameter_px * frequency)[0]
