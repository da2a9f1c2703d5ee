"""Blur models around the bar frequency: tube, tube with lens, lens, Moffat, two Gaussians.

Each has two parameters besides the attenuation at a reference frequency; their fits are compared by
evidence.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.inference.least_squares import Linearisation, least_squares, linearise_residual

Array = NDArray[np.float64]

Bounds = tuple[float, float]
Normal = tuple[float, float]

# Smaller transfers count as zero.
MIN_LN = -60.0
# Nodes of a model's table in ln frequency, and the step of its derivatives.
PLACES, STEP = np.linspace(-9.0, 6.0, 1501), 1e-3
NONE: Normal = (0.0, 1e-3)


@dataclass(frozen=True)
class BarBlurModel:
    """Blur model with the priors of its two parameters."""

    name: str  # Printed name
    # Priors of its parameters: mean and standard deviation
    first_prior: Normal
    second_prior: Normal
    bounds: tuple[Bounds, Bounds]  # Bounds of both
    start: tuple[float, float]  # Starting values of both
    # From ln(r/f), attenuation A = -ln c at f and both parameters to ln transfer
    ln: Callable[[Array, float, float, float], Array]

    def slopes(
        self, ln_ratio: Array, attenuation: float, first_shape: float, second_shape: float
    ) -> Array:
        """Return ln transfer and its derivatives by ln A, one and two, shape (4, ...) for ln(r/f)
        of any shape.

        Interpolated in a radial table: the transfer is rotationally symmetric.
        """
        table = self._table(PLACES, attenuation, first_shape, second_shape)
        position = np.clip(
            (ln_ratio - PLACES[0]) / (PLACES[1] - PLACES[0]), 0.0, PLACES.size - 1.001
        )
        node = position.astype(np.intp)
        fraction = position - node
        return np.stack([row[node] + fraction * (row[node + 1] - row[node]) for row in table])

    def _table(
        self, ln_ratios: Array, attenuation: float, first_shape: float, second_shape: float
    ) -> Array:
        """Return ln transfer and its derivatives at ln(r/f), shape (4, point)."""
        ln_transfer = self.ln(ln_ratios, attenuation, first_shape, second_shape)
        changed = (
            (attenuation * (1.0 + STEP), first_shape, second_shape),
            (attenuation, first_shape + STEP, second_shape),
            (attenuation, first_shape, second_shape + STEP),
        )
        backed = (
            (attenuation * (1.0 - STEP), first_shape, second_shape),
            (attenuation, first_shape - STEP, second_shape),
            (attenuation, first_shape, second_shape - STEP),
        )
        slopes = [
            (self.ln(ln_ratios, *up) - self.ln(ln_ratios, *down)) / (2.0 * STEP)
            for up, down in zip(changed, backed, strict=True)
        ]
        return np.stack([ln_transfer, *slopes])

    def nearest(self, ln_ratio: Array, transfer: Array, attenuation: float) -> tuple[float, Array]:
        """Return scale and parameters (ln A, one, two) that approximate a transfer at ln(r/f),
        shape (point,).

        One prior standard deviation costs as much as an error of 0.001 in the transfer.
        """
        mean, sd = np.array([(0.0, np.inf), self.first_prior, self.second_prior, (0.0, np.inf)]).T

        def linearise(theta: Array) -> Linearisation:
            table = self._table(ln_ratio, float(np.exp(theta[0])), theta[1], theta[2])
            modelled = np.exp(table[0])
            scale = float(modelled @ transfer) / float(modelled @ modelled)
            jacobian = np.vstack([scale * modelled * table[1:], modelled])
            off = mean - np.append(theta, 0.0)
            return linearise_residual(
                1e3 * (transfer - scale * modelled), 1e3 * jacobian, off, sd**-2.0, scale
            )

        start, bounds = [np.log(attenuation), *self.start], [(-9.0, 2.3), *self.bounds]
        optimum = least_squares(linearise, start, bounds, iterations=12)
        return optimum.at.model, optimum.point


def _one_scale_model(attenuation_of: Callable[[Array], Array]) -> Callable[[Array, float], Array]:
    """Return a one-scale model as a function of ln(r/f) and the attenuation at f, which sets the
    scale.
    """
    ln_scales = np.linspace(-14.0, 8.0, 2201)
    values = np.maximum.accumulate(attenuation_of(np.exp(ln_scales)))

    def ln(ln_ratio: Array, attenuation: float) -> Array:
        ln_scale = float(np.interp(attenuation, values, ln_scales))
        return -np.interp(ln_ratio + ln_scale, ln_scales, values, left=0.0, right=-MIN_LN)

    return ln


def _tube(ln_ratio: Array, attenuation: float, log_exponent: float, gaussian_share: float) -> Array:
    """c^((1 - s) (r/f)^n + s (r/f)^2) with ln n and s: a tube, and the Gaussian part of lens,
    phosphor and pixel.
    """
    power = np.exp(np.exp(log_exponent) * ln_ratio)
    fall = (1.0 - gaussian_share) * power + gaussian_share * np.exp(2.0 * ln_ratio)
    return np.maximum(-attenuation * fall, MIN_LN)


def _pupil(ln_ratio: Array, attenuation: float, gaussian_share: float, _: float) -> Array:
    """A circular pupil (Goodman, Fourier Optics, 6.3) times a Gaussian that has a fraction of the
    attenuation.
    """

    def pupil(x: Array) -> Array:
        clipped = np.minimum(x, 1.0)
        open_ = 2.0 / np.pi * (np.arccos(clipped) - clipped * np.sqrt(1.0 - clipped**2))
        return -np.log(np.maximum(open_, np.exp(MIN_LN)))

    lens = _one_scale_model(pupil)(ln_ratio, (1.0 - gaussian_share) * attenuation)
    return np.maximum(lens - gaussian_share * attenuation * np.exp(2.0 * ln_ratio), MIN_LN)


def _moffat(ln_ratio: Array, attenuation: float, log_wings: float, _: float) -> Array:
    """(1 + r^2/a^2)^-b, ln(b - 1): 2^(2-b)/Gamma(b-1) x^(b-1) K_(b-1)(x), x = 2 pi a f."""
    from scipy.special import gammaln, kve

    order = float(np.exp(log_wings))

    def own(x: Array) -> Array:
        argument = np.maximum(x, 1e-5)
        return -np.minimum(
            (1.0 - order) * np.log(2.0)
            - gammaln(order)
            + order * np.log(argument)
            + np.log(kve(order, argument))
            - argument,
            0.0,
        )

    return _one_scale_model(lambda x: np.minimum(own(x), -MIN_LN))(ln_ratio, attenuation)


def _two_gaussians(
    ln_ratio: Array, attenuation: float, wide_fraction: float, log_wider: float
) -> Array:
    """A Gaussian, and a fraction of the light in a wider one; `log_wider` is ln of the ratio of the
    widths.
    """
    wider = float(np.exp(2.0 * log_wider))

    def own(x: Array) -> Array:
        square = np.minimum(x**2, -MIN_LN)
        core = (1.0 - wide_fraction) * np.exp(-square) + wide_fraction * np.exp(
            -np.minimum(wider * square, -MIN_LN)
        )
        return -np.log(core)

    return _one_scale_model(own)(ln_ratio, attenuation)


TUBE = BarBlurModel(
    "a tube",
    first_prior=(float(np.log(1.5)), 0.8),
    second_prior=NONE,
    bounds=((float(np.log(0.3)), float(np.log(4.0))), (0.0, 1.0)),
    start=(float(np.log(1.6)), 0.0),
    ln=_tube,
)
STAGES = BarBlurModel(
    "a tube and a lens",
    first_prior=TUBE.first_prior,
    second_prior=(0.2, 0.25),
    bounds=TUBE.bounds,
    start=(float(np.log(1.4)), 0.2),
    ln=_tube,
)
PUPIL = BarBlurModel(
    "a lens",
    first_prior=(0.2, 0.4),
    second_prior=NONE,
    bounds=((0.0, 0.95), (-1.0, 1.0)),
    start=(0.1, 0.0),
    ln=_pupil,
)
MOFFAT = BarBlurModel(
    "a Moffat",
    first_prior=(float(np.log(2.5)), 0.7),
    second_prior=NONE,
    bounds=((float(np.log(0.2)), float(np.log(15.0))), (-1.0, 1.0)),
    start=(float(np.log(2.5)), 0.0),
    ln=_moffat,
)
WINGS = BarBlurModel(
    "two Gaussians",
    first_prior=(0.1, 0.2),
    second_prior=(float(np.log(3.0)), 0.5),
    bounds=((0.0, 0.6), (float(np.log(1.3)), float(np.log(20.0)))),
    start=(0.1, float(np.log(3.0))),
    ln=_two_gaussians,
)
BLUR_MODELS = (TUBE, STAGES, PUPIL, MOFFAT, WINGS)
