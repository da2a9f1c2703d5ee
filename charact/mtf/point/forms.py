"""Forms of a point's picture: transfers in two dimensions, as a core that may be elliptical, and light beyond it.

A transfer is kept at radial frequencies and at a few directions: what lies between directions is a polynomial in the
cosine of twice the angle, as an ellipse's is nearly.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.mtf.forms.families import Core, Family, Wide
from charact.mtf.point.forward_model import pinhole

Array = NDArray[np.float64]

# Ratio of horizontal to vertical half frequency, ln: lenses and tubes are nearly round.
STRETCH = (-0.6, 0.6)
STRETCH_SD = 0.15
# Exponent of a tube's tails beside a Gaussian of lens, fibres and pulse (physics reference 1.12: 1.1 to 2).
TAIL = (1.0, 2.0)
TAIL_PRIOR = (1.3, 0.25)
BLUR_PX = (0.05, 2.0)
# Most cameras scatter a few per cent of their light: half of a normal distribution of this width.
WIDE_SHARE_SD = 0.1
# Half frequencies of a tube beside which a Gaussian blur can be told, ln of cycles per column pitch.
TUBE = (float(np.log(0.02)), float(np.log(0.6)))


@dataclass(frozen=True, kw_only=True)
class PointForm:
    """A form of the transfer of blur and source, aperture and video filter left aside.

    Parameters
    ----------
    core
        As of `charact.mtf.forms.families.Family`.
    lens
        Whether a Gaussian blur lies beside the core: a tube behind a lens, or before its fibres.
    separable
        Whether horizontal and vertical blur act one after the other, T(fx, 0) T(0, fy), instead of being elliptical.
    wide
        Light beyond the core, round; None: none.
    pinhole_px
        Diameter of the source, column pitches, or the bounds between which it is unknown.
    """

    core: Core
    lens: bool = False
    separable: bool = False
    wide: Wide | None = None
    pinhole_px: float | tuple[float, float] = 0.0

    @property
    def name(self) -> str:
        """Name for people."""
        core = f"separable {self.core}" if self.separable else self.core
        core = f"{core} x gaussian" if self.lens else core
        return core if self.wide is None else f"{core} + {self.wide.name}"

    @property
    def blur_parameters(self) -> int:
        """Number of parameters before those of the light beyond the core."""
        return self._family.core_parameters + int(self.lens) + 1

    @property
    def _family(self) -> Family:
        return Family(core=self.core)

    @property
    def parameters(self) -> dict[str, tuple[str, tuple[float, float]]]:
        """Unit and bounds of each parameter by name."""
        core = dict(self._family.parameters)
        if self.lens:
            core["ln_half_frequency"] = ("ln(cy/px)", TUBE)
            core["exponent"] = ("1", TAIL)
            core["blur_px"] = ("px", BLUR_PX)
        wide = self.wide.parameters if self.wide else {}
        out: dict[str, tuple[str, tuple[float, float]]] = {**core, "stretch": ("1", STRETCH), **wide}
        if isinstance(self.pinhole_px, tuple):
            out["pinhole_px"] = ("px", self.pinhole_px)
        return out

    @property
    def bounds(self) -> Array:
        """Bounds of the parameters, shape (parameter, 2)."""
        return np.array([bound for _, bound in self.parameters.values()])

    def prior(self) -> tuple[Array, Array]:
        """Return mean and precision of the Gaussian part of each parameter's prior; precision 0: flat in bounds."""
        names = list(self.parameters)
        mean, precision = np.zeros((2, len(names)))
        core_mean, core_precision = self._family.prior_precision()
        mean[: core_mean.size], precision[: core_mean.size] = core_mean, core_precision
        if self.lens:
            mean[1], precision[1] = TAIL_PRIOR[0], TAIL_PRIOR[1] ** -2
        precision[names.index("stretch")] = STRETCH_SD**-2
        if self.wide is not None:
            precision[self.blur_parameters] = WIDE_SHARE_SD**-2
        return mean, precision

    def log_prior(self, theta: Array) -> Array:
        """Return ln of the prior density, -inf outside the bounds, shape (n, parameter) -> (n,)."""
        bounds, (mean, precision) = self.bounds, self.prior()
        inside = np.all((theta >= bounds[:, 0]) & (theta <= bounds[:, 1]), axis=1)
        return np.where(inside, self.log_volume() - 0.5 * (theta - mean) ** 2 @ precision, -np.inf)

    def log_volume(self) -> float:
        """Return ln of the prior density where its Gaussian part is at its peak."""
        bounds, (_, precision) = self.bounds, self.prior()
        known = precision > 0
        flat = -np.sum(np.log(bounds[~known, 1] - bounds[~known, 0]))
        half = np.log(2.0) if self.wide is not None else 0.0
        return float(flat + half + 0.5 * np.sum(np.log(precision[known] / (2.0 * np.pi))))

    def start(self, ln_half_frequency: float) -> Array:
        """Return a point from which to climb."""
        begin = {"exponent": 1.3 if self.lens else 1.5, "moffat_exponent": 2.5, "blur_px": 0.4}
        return np.array([
            ln_half_frequency if name == "ln_half_frequency" else 0.0 if name == "stretch"
            else begin.get(name, 0.7 * low + 0.3 * high)
            for name, (_, (low, high)) in self.parameters.items()
        ])  # fmt: skip

    def camera(self, theta: Array, frequency: Array, cosine: Array) -> Array:
        """Return the transfer of the camera's blur, without aperture, shape (n, direction, frequency).

        Parameters
        ----------
        theta
            Parameters, shape (n, parameter).
        frequency
            Radial frequency, cycles per column pitch, shape (frequency,).
        cosine
            Cosine of twice the angle of each direction to the rows, shape (direction,).
        """
        p = {name: theta[:, index] for index, name in enumerate(self.parameters)}
        lens = self._core(theta, p["stretch"], frequency, cosine)
        if self.lens:
            lens = lens * np.exp(-2.0 * (np.pi * p["blur_px"][:, None] * frequency) ** 2)[:, None]
        if self.wide is None:
            return lens
        first, *shape = (p[name] for name in self.wide.parameters)
        beyond = self.wide.transfer(frequency, np.stack(shape, axis=1))
        return lens * (1.0 - first[:, None] + first[:, None] * beyond)[:, None]

    def _core(self, theta: Array, stretch: Array, frequency: Array, cosine: Array) -> Array:
        """Return the core along each direction: that of a half frequency which changes with the direction."""
        shape = theta[:, : self._family.core_parameters]
        along, across = 0.5 * (1.0 + cosine), 0.5 * (1.0 - cosine)
        wider = np.exp(stretch[:, None])
        if not self.separable:
            return self._turned(shape, 0.5 * np.log(along / wider + across * wider), frequency)
        little = 1e-16
        horizontal = self._turned(shape, 0.5 * np.log(along / wider + little), frequency)
        return horizontal * self._turned(shape, 0.5 * np.log(across * wider + little), frequency)

    def _turned(self, shape: Array, ln_narrower: Array, frequency: Array) -> Array:
        """Return the core with half frequencies lower by factors (n, direction), shape (n, direction, frequency)."""
        every = np.repeat(shape, ln_narrower.shape[1], axis=0)
        every[:, 0] -= ln_narrower.ravel()
        return self._family.modulus(every, frequency).reshape(*ln_narrower.shape, frequency.size)

    def source(self, theta: Array, frequency: Array) -> Array:
        """Return the transfer of the pinhole, shape (n, frequency)."""
        if isinstance(self.pinhole_px, float):
            return np.tile(pinhole(frequency, self.pinhole_px), (len(theta), 1))
        from scipy.special import j1

        u = np.maximum(np.pi * theta[:, -1:] * frequency, 1e-9)
        return np.asarray(2.0 * j1(u) / u, np.float64)

    def transfer(self, theta: Array, frequency: Array, cosine: Array) -> Array:
        """Return the transfer of blur and source, shape (n, direction, frequency)."""
        return self.camera(theta, frequency, cosine) * self.source(theta, frequency)[:, None]
