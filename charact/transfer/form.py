"""What a form of a blur is: parameters with their priors, a transfer and its slopes."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from labdata import Array

# Transfers below this count as this: numbers smaller still slow every product down a hundredfold.
MIN_LN = -60.0
LN2 = float(np.log(2.0))
# Nodes of a transfer in ln of the frequency where it is scaled by interpolation.
LN_SCALES = np.linspace(-14.0, 8.0, 2201)
# Nodes of an image of bars in ln frequency, and the step of its differences.
LN_RATIOS, STEP = np.linspace(-9.0, 6.0, 1501), 1e-3


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """Parameter with its prior: flat between bounds, or normal where a standard deviation is
    given.
    """

    name: str
    unit: str
    low: float
    high: float
    mean: float = 0.0
    sd: float = float("inf")
    start: float = float("nan")

    @property
    def first(self) -> float:
        """Start value of an optimisation."""
        return self.start if np.isfinite(self.start) else self.mean


class Parametric:
    """What has parameters, in the order of a point's coordinates."""

    parameters: tuple[Parameter, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return tuple(parameter.name for parameter in self.parameters)

    @property
    def units(self) -> tuple[str, ...]:
        """Units of the parameters."""
        return tuple(parameter.unit for parameter in self.parameters)

    @cached_property
    def bounds(self) -> Array:
        """Bounds of the parameters, shape (parameter, 2)."""
        return np.array([[parameter.low, parameter.high] for parameter in self.parameters])

    @cached_property
    def prior(self) -> tuple[Array, Array]:
        """Mean and standard deviation of the priors, shape (parameter,)."""
        return (
            np.array([parameter.mean for parameter in self.parameters]),
            np.array([parameter.sd for parameter in self.parameters]),
        )

    @property
    def first(self) -> Array:
        """Start point of an optimisation, shape (parameter,)."""
        return np.array([parameter.first for parameter in self.parameters])

    def log_prior(self, points: Array) -> Array:
        """Return the log-prior up to a constant, -inf outside the bounds, shape (point,)."""
        in_bounds = np.all((points >= self.bounds[:, 0]) & (points <= self.bounds[:, 1]), axis=1)
        mean, sd = self.prior
        return np.where(in_bounds, -0.5 * (((points - mean) / sd) ** 2).sum(axis=1), -np.inf)

    @cached_property
    def prior_precision(self) -> tuple[Array, Array]:
        """Mean and precision of the priors, shape (parameter,); precision 0: flat."""
        mean, sd = self.prior
        return mean, sd**-2.0

    def start(self, first: float) -> Array:
        """Return a start point with a given first parameter, shape (parameter,)."""
        return np.array([first, *self.first[1:]])


class ProperPrior(Parametric):
    """Parameters whose log-prior is that of a density, so that evidences can be compared."""

    @property
    def ln_volume(self) -> float:
        """ln of the prior density at the mean of its Gaussian part."""
        precision = self.prior_precision[1]
        flat = precision == 0.0
        widths = np.ptp(self.bounds[flat], axis=1)
        return float(
            0.5 * np.sum(np.log(precision[~flat] / (2.0 * np.pi))) - np.sum(np.log(widths))
        )

    def log_prior(self, points: Array) -> Array:
        """Return ln of the prior density, -inf outside the bounds, shape (point,)."""
        return super().log_prior(points) + self.ln_volume


def flat_parameters(table: Mapping[str, tuple[str, tuple[float, float]]]) -> tuple[Parameter, ...]:
    """Return parameters without priors from unit and bounds by name."""
    return tuple(
        Parameter(name=name, unit=unit, low=low, high=high, start=0.7 * low + 0.3 * high)
        for name, (unit, (low, high)) in table.items()
    )


# Half frequency before the data: a core below the pixel is possible, and not as likely for every
# factor by which it would be smaller still.
HALF_FREQUENCY = Parameter(
    name="ln_half_frequency",
    unit="ln(cy/px)",
    low=float(np.log(0.008)),
    high=float(np.log(6.0)),
    mean=float(np.log(0.35)),
    sd=1.4,
)


def table_of(parameters: Sequence[Parameter]) -> dict[str, tuple[str, tuple[float, float]]]:
    """Return unit and bounds of parameters by name."""
    return {part.name: (part.unit, (part.low, part.high)) for part in parameters}


class Core:
    """A narrow blur along one direction, scaled by the frequency f2 at which it falls to one half.

    A form states `attenuation`; one that is used often states `terms` too.
    """

    name: str
    shape: tuple[Parameter, ...] = ()  # Parameters besides ln f2

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Parameters in order: ln f2, then those of the shape."""
        return HALF_FREQUENCY, *self.shape

    def attenuation(self, x: Array, shape: Sequence[float]) -> Array:
        """Return -ln of the transfer at frequencies in a unit of the form's own, shape (x,)."""
        raise NotImplementedError

    def ln_scaled(self, ln_ratio: Array, attenuation: float, shape: Sequence[float]) -> Array:
        """Return ln of the transfer at ln(f/f0) that is -`attenuation` at f0."""
        values = np.maximum.accumulate(
            np.minimum(self.attenuation(np.exp(LN_SCALES), shape), -MIN_LN)
        )
        ln_scale = float(np.interp(attenuation, values, LN_SCALES))
        return -np.interp(ln_ratio + ln_scale, LN_SCALES, values, left=0.0, right=-MIN_LN)

    def terms(self, theta: Array, frequency: Array) -> Iterator[Array]:
        """Yield the transfer, then its slope with each parameter, shape (n, parameter) and (f,) or
        (n, f) -> (n, f).
        """
        ln_frequency = np.broadcast_to(np.log(frequency), (len(theta), np.shape(frequency)[-1]))
        rows = zip(ln_frequency, theta, strict=True)
        yield np.exp([self.ln_scaled(ln_f - row[0], LN2, row[1:]) for ln_f, row in rows])
        yield from self.differences(theta, frequency)

    def differences(self, theta: Array, frequency: Array) -> Iterator[Array]:
        """Yield the slope with each parameter by differences."""
        for move in STEP * np.eye(theta.shape[1]):
            up, down = (self.transfer(theta + sign * move, frequency) for sign in (1.0, -1.0))
            yield (up - down) / (2.0 * STEP)

    def transfer(self, theta: Array, frequency: Array) -> Array:
        """Return the first of `terms`, negative where defocus turns it round."""
        return next(self.terms(theta, frequency))

    def derivatives(self, theta: Array, frequency: Array) -> Array:
        """Return all `terms` of one point, shape (parameter,) and (f,) -> (parameter + 1, f)."""
        return np.concatenate([*self.terms(theta[None], frequency)])


@dataclass(frozen=True, kw_only=True)
class BarForm:
    """A core times a Gaussian around the frequency of bars, with two parameters besides the
    attenuation A at the bar frequency f:

    ln T(r) = ln core(r) - s A (r/f)^2, with ln core(f) = -(1 - s) A.
    """

    name: str  # Printed name
    core: Core
    first: Parameter
    second: Parameter
    # From both parameters to those of the core's shape, and to the Gaussian's part s
    shape: Callable[[float, float], tuple[float, ...]]
    gaussian_share: Callable[[float, float], float] = lambda _first, _second: 0.0

    @property
    def bounds(self) -> list[tuple[float, float]]:
        """Bounds of both parameters."""
        return [(self.first.low, self.first.high), (self.second.low, self.second.high)]

    def ln(self, ln_ratio: Array, attenuation: float, first: float, second: float) -> Array:
        """Return ln transfer at ln(r/f)."""
        fraction, shape = self.gaussian_share(first, second), self.shape(first, second)
        core = self.core.ln_scaled(ln_ratio, (1.0 - fraction) * attenuation, shape)
        return np.maximum(core - fraction * attenuation * np.exp(2.0 * ln_ratio), MIN_LN)

    def table(self, ln_ratios: Array, attenuation: float, first: float, second: float) -> Array:
        """Return ln transfer and its derivatives by ln A and both parameters at ln(r/f), shape (4,
        point).
        """
        point = np.array([attenuation, first, second])
        slopes = [
            (self.ln(ln_ratios, *(point + move)) - self.ln(ln_ratios, *(point - move)))
            / (2.0 * STEP)
            for move in np.diag([attenuation * STEP, STEP, STEP])
        ]
        return np.stack([self.ln(ln_ratios, *point), *slopes])

    def derivatives(
        self, ln_ratio: Array, attenuation: float, first: float, second: float
    ) -> Array:
        """Return ln transfer and its derivatives by ln A, both parameters and ln r, shape (5, ...)
        for ln(r/f) of any shape.

        Interpolated in a radial table: the transfer is rotationally symmetric.
        """
        table = self.table(LN_RATIOS, attenuation, first, second)
        table = np.stack([*table, np.gradient(table[0], LN_RATIOS)])
        position = np.clip(
            (ln_ratio - LN_RATIOS[0]) / (LN_RATIOS[1] - LN_RATIOS[0]), 0.0, LN_RATIOS.size - 1.001
        )
        node = position.astype(np.intp)
        fraction = position - node
        return np.stack([row[node] + fraction * (row[node + 1] - row[node]) for row in table])
