"""Two-dimensional blur models of points: elliptical cores and extended components.

A transfer is kept at radial frequencies and a few directions. Between directions it is a polynomial
in the cosine of twice the angle.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from charact.estimators.mtf.point.spot_image_matrix import COSINES, FREQUENCIES
from charact.estimators.mtf.point.thresholds import PRIORS
from charact.transfer.cores import ON_POINTS
from charact.transfer.extended import ExtendedComponent
from charact.transfer.form import table_of
from charact.transfer.tables import disc
from labdata import Array

# Centres of the departure bumps in ln of frequency over half frequency, and their width.
BUMPS, BUMP_WIDTH = (-2.0, -1.0, -0.4, 0.2, 0.7), 0.5
# Half frequencies of a tube at which a Gaussian blur is distinguishable, ln of cycles per column
# pitch.
TUBE = (float(np.log(0.02)), float(np.log(0.6)))
# The video filter's bandwidth as a parameter, and the powers of its logarithm in the image, from 0.
BANDWIDTH, BANDWIDTH_ORDERS = "ln_video_bandwidth", 3


@dataclass(frozen=True, kw_only=True)
class BlurModel2D:
    """Transfer of blur and source, without aperture and video filter."""

    core: str  # Name of the core in `ON_POINTS`
    round: bool = False  # Whether rows and columns are blurred alike
    # Whether a Gaussian multiplies the core: a tube behind a lens, or before its fibres
    lens: bool = False
    # Whether horizontal and vertical blur multiply, T(fx, 0) T(0, fy), instead of being elliptical
    separable: bool = False
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
        core = f"separable {self.core}" if self.separable else self.core
        core = f"{core} x gaussian" if self.lens else core
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
    def parameters(self) -> dict[str, tuple[str, tuple[float, float]]]:
        """Unit and bounds of each parameter by name."""
        core = table_of(ON_POINTS[self.core][0].parameters)
        if self.lens:
            if "exponent" in core:
                core["ln_half_frequency"], core["exponent"] = (
                    ("ln(cy/px)", TUBE),
                    ("1", PRIORS.tail),
                )
            core["blur_px"] = ("px", PRIORS.blur_px)
        extended = self.wide.parameters if self.wide else {}
        stretch = {} if self.round else {"stretch": ("1", PRIORS.stretch)}
        out: dict[str, tuple[str, tuple[float, float]]] = {**core, **stretch, **extended}
        if self.departures:
            bound = 4.0 * self.departures
            out.update(
                {f"departure_{number}": ("1", (-bound, bound)) for number in range(len(BUMPS))}
            )
        out.update(
            {name: ("1", (-6.0 * sd, 6.0 * sd)) for name, _, sd in self.known if name == BANDWIDTH}
        )
        if isinstance(self.pinhole_px, tuple):
            out["pinhole_px"] = ("px", self.pinhole_px)
        return out

    @cached_property
    def bounds(self) -> Array:
        """Bounds of the parameters, shape (parameter, 2)."""
        return np.array([bound for _, bound in self.parameters.values()])

    @cached_property
    def prior(self) -> tuple[Array, Array]:
        """Mean and precision of the Gaussian part of each parameter's prior; precision 0:
        uniform.
        """
        names = list(self.parameters)
        mean, precision = np.zeros((2, len(names)))
        for index, parameter in enumerate(ON_POINTS[self.core][0].parameters):
            mean[index], precision[index] = parameter.mean, parameter.sd**-2
        if self.lens and "exponent" in names:
            mean[1], precision[1] = PRIORS.tail_prior[0], PRIORS.tail_prior[1] ** -2
        known = {"stretch": PRIORS.stretch_sd}
        known.update({f"departure_{number}": self.departures for number in range(len(BUMPS))})
        for index, name in enumerate(names):
            if name in known:
                precision[index] = known[name] ** -2
        if self.wide is not None:
            precision[self.blur_parameters] = PRIORS.wide_share_sd**-2
        for name, value, sd in self.known:
            mean[names.index(name)], precision[names.index(name)] = value, sd**-2
        return mean, precision

    def log_prior(self, theta: Array) -> Array:
        """Return ln of the prior density, -inf outside the bounds, shape (n, parameter) -> (n,)."""
        bounds, (mean, precision) = self.bounds, self.prior
        in_bounds = np.all((theta >= bounds[:, 0]) & (theta <= bounds[:, 1]), axis=1)
        return np.where(
            in_bounds, self.log_volume() - 0.5 * (theta - mean) ** 2 @ precision, -np.inf
        )

    def log_volume(self) -> float:
        """Return ln prior density at the mean of its Gaussian part."""
        bounds, (_, precision) = self.bounds, self.prior
        known = precision > 0
        flat = -np.sum(np.log(bounds[~known, 1] - bounds[~known, 0]))
        half = np.log(2.0) * (int(self.wide is not None) + int("defocus_square" in self.parameters))
        return float(flat + half + 0.5 * np.sum(np.log(precision[known] / (2.0 * np.pi))))

    def start(self, ln_half_frequency: float) -> Array:
        """Return starting values."""
        begin = {
            **{shape.name: shape.start for shape in ON_POINTS[self.core][0].shape},
            "ln_half_frequency": ln_half_frequency,
            "blur_px": 0.4,
            "stretch": 0.0,
            **({"exponent": 1.3} if self.lens else {}),
            **{f"departure_{number}": 0.0 for number in range(len(BUMPS))},
            **{name: mean for name, mean, _ in self.known},
        }
        return np.array(
            [
                begin.get(name, 0.7 * low + 0.3 * high)
                for name, (_, (low, high)) in self.parameters.items()
            ]
        )

    def camera(self, theta: Array, frequency: Array, cosine: Array) -> Array:
        """Return the transfer of the camera's blur, without aperture, shape (n, direction,
        frequency).

        `theta`: parameters, shape (n, parameter); `frequency`: radial frequency, cycles per column
        pitch, shape (frequency,); `cosine`: cosine of twice the angle of each direction to the
        rows, shape (direction,).
        """
        p = {name: theta[:, index] for index, name in enumerate(self.parameters)}
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
        if not self.separable:
            return self._core_by_direction(
                shape, 0.5 * np.log(along / wider + across * wider), frequency
            )
        tiny = 1e-16
        horizontal = self._core_by_direction(shape, 0.5 * np.log(along / wider + tiny), frequency)
        return horizontal * self._core_by_direction(
            shape, 0.5 * np.log(across * wider + tiny), frequency
        )

    def _core_by_direction(self, shape: Array, ln_narrower: Array, frequency: Array) -> Array:
        """Return the core with half frequencies reduced by factors (n, direction), shape (n,
        direction, frequency).
        """
        every = np.repeat(shape, ln_narrower.shape[1], axis=0)
        every[:, 0] -= ln_narrower.ravel()
        return (
            ON_POINTS[self.core][0]
            .transfer(every, frequency)
            .reshape(*ln_narrower.shape, frequency.size)
        )

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
        names = list(self.parameters)
        return theta[:, names.index(BANDWIDTH)] if BANDWIDTH in names else None

    @property
    def bandwidth_order(self) -> int:
        """Number of powers of ln bandwidth in the image: 1 without the parameter."""
        return BANDWIDTH_ORDERS if BANDWIDTH in self.parameters else 1

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


def pinhole(frequency: Array, diameter_px: float | Array) -> Array:
    """Return 2 J1(u)/u, u = pi d f, the transfer of a uniform disc."""
    return disc(np.pi * diameter_px * frequency)[0]
