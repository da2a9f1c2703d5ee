"""The picture of a bar target fitted to its pixels, with the errors that the noise really there makes."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from charact.mtf.bar_target import BarTarget
from charact.mtf.bars_model import Shape, table_of
from charact.mtf.bars_noise import Noise, noise_of, noise_of_one

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

NAMES = (
    "log_attenuation", "exponent", "departure", "log_frequency", "log_length", "across_px", "along_px", "angle_rad",
    "level_dn", "pedestal_dn", "slope_across", "slope_along",
)  # fmt: skip
ALONG = ("log_length", "along_px")
# Priors, mean and standard deviation: n = 2 is a Gaussian, tubes lie near 1.2; the bars' frequency is known to a few
# percent (STANAG 4349: 5 %), their length to a third.
EXPONENT_PRIOR = (1.6, 0.6)
FREQUENCY_SD, LENGTH_SD = 0.02, 0.35
# How far a transfer may depart from the family at the bars' frequency: share of itself, and of the whole.
DEPARTURE_SD, DEPARTURE_FLOOR = 0.015, 0.002
BOUNDS = {"log_attenuation": (-9.0, 2.3), "exponent": (0.7, 3.5), "departure": (-0.9, 5.0)}
ITERATIONS, SETTLED, ROUGHLY = 12, 3e-3, 0.1
START_EXPONENT, START_CORE = 1.6, 0.4
# Least variance of a pixel, on the square of the bars' height: the table of the picture is no better.
LEAST_VARIANCE = 1e-8


@dataclass(frozen=True, kw_only=True)
class Fit:
    """A picture fitted.

    Parameters
    ----------
    target
        Where the bars lie.
    shape
        Their picture.
    names, value, covariance
        Parameters, their values and covariance.
    residual_dn, model_dn
        Pixels less the picture, and the picture, shape (pixel,).
    slope
        Derivatives of the picture, shape (parameter, pixel).
    estimator
        What each pixel weighs in each parameter, shape (parameter, pixel).
    noise_covariance
        The part of the covariance that the noise makes.
    prior_mean, precision
        Of the priors, shape (parameter,); precision 0: none.
    window
        Which pixels were used, shape (row, col).
    noise
        Noise of the pixels.
    """

    target: BarTarget
    shape: Shape
    names: tuple[str, ...]
    value: Array
    covariance: Array
    residual_dn: Array
    model_dn: Array
    slope: Array
    estimator: Array
    noise_covariance: Array
    prior_mean: Array
    precision: Array
    window: Mask
    noise: Noise

    def __getitem__(self, name: str) -> float:
        return float(self.value[self.names.index(name)])

    @property
    def values(self) -> dict[str, float]:
        """Parameters by name."""
        return dict(zip(self.names, self.value.tolist(), strict=True))

    def sd(self, name: str) -> float:
        """Standard deviation of a parameter."""
        index = self.names.index(name)
        return float(np.sqrt(self.covariance[index, index]))


@dataclass(frozen=True, kw_only=True)
class Problem:
    """What is fitted: the pixels of a window and the weight of each."""

    image: Array
    window: Mask
    variance: Array
    asked: float
    length_px: float
    strip: bool

    @property
    def names(self) -> tuple[str, ...]:
        """Parameters: bars through the whole region have no ends."""
        return tuple(name for name in NAMES if not (self.strip and name in ALONG))


def priors(problem: Problem, mtf: float) -> tuple[Array, Array]:
    """Return mean and precision of the normal prior of each parameter; precision 0: none."""
    known = {
        "exponent": EXPONENT_PRIOR,
        "departure": (0.0, DEPARTURE_SD + DEPARTURE_FLOOR / max(mtf, 1e-3)),
        "log_frequency": (np.log(problem.asked), FREQUENCY_SD),
        "log_length": (np.log(problem.length_px), LENGTH_SD),
    }
    mean = np.array([known.get(name, (0.0, np.inf))[0] for name in problem.names])
    return mean, np.array([known.get(name, (0.0, np.inf))[1] ** -2.0 for name in problem.names])


def start_of(problem: Problem, target: BarTarget, exponent: float, mtf: float) -> dict[str, float]:
    """Return the parameters to begin with at a target found."""
    pixels = problem.image[problem.window]
    low, high = np.quantile(pixels, [0.1, 0.95])
    return {
        "log_attenuation": float(np.log(-np.log(mtf))),
        "exponent": exponent,
        "departure": 0.0,
        "log_frequency": float(np.log(target.frequency)),
        "log_length": float(np.log(problem.length_px)),
        "across_px": 0.0,
        "along_px": 0.0,
        "angle_rad": target.angle_rad,
        "level_dn": 1.3 * float(high - low),
        "pedestal_dn": float(low),
        "slope_across": 0.0,
        "slope_along": 0.0,
    }


class Picture:
    """The picture of a target as a function of its parameters over the window's pixels."""

    def __init__(self, problem: Problem, target: BarTarget) -> None:
        self.problem, self.target = problem, target
        row, col = np.nonzero(problem.window)
        self.x, self.y = col - target.col, (row - target.row) * target.pitch_ratio
        across, along = self._places(target.angle_rad, 0.0, 0.0)
        self.reach = (float(np.abs(across).max()) + 3.0, float(np.abs(along).max()) + 3.0)

    def _places(self, angle_rad: float, across_px: float, along_px: float) -> tuple[Array, Array]:
        cosine, sine = np.cos(angle_rad), np.sin(angle_rad)
        return self.x * cosine + self.y * sine - across_px, self.y * cosine - self.x * sine - along_px

    def shape(self, theta: dict[str, float]) -> Shape:
        """Return the shape of a set of parameters."""
        return Shape(
            bars=self.target.bars,
            frequency=float(np.exp(theta["log_frequency"])),
            length_px=np.inf if self.problem.strip else float(np.exp(theta["log_length"])),
            reference=self.problem.asked,
            log_attenuation=theta["log_attenuation"],
            exponent=theta["exponent"],
            departure=theta["departure"],
            # The pixel turns so little with the bars that the angle they were found at will do.
            angle_rad=self.target.angle_rad,
        )

    def __call__(self, theta: dict[str, float]) -> tuple[Array, Array]:
        """Return picture, shape (pixel,), and its derivatives, shape (parameter, pixel)."""
        across, along = self._places(theta["angle_rad"], theta.get("across_px", 0.0), theta.get("along_px", 0.0))
        found = table_of(self.shape(theta), *self.reach).at(across, along)
        level = theta["level_dn"]
        slopes = level * found[6], level * found[7]
        scale = (2.0 * self.reach[0], 2.0 * self.reach[1])
        picture = (
            theta["pedestal_dn"]
            + level * found[0]
            + theta["slope_across"] * across / scale[0]
            + theta["slope_along"] * along / scale[1]
        )
        derivative = {
            **dict(zip(NAMES[:5], level * found[1:6], strict=True)),
            "across_px": -slopes[0],
            "along_px": -slopes[1],
            "angle_rad": slopes[0] * along - slopes[1] * across,
            "level_dn": found[0],
            "pedestal_dn": np.ones_like(across),
            "slope_across": across / scale[0],
            "slope_along": along / scale[1],
        }
        return picture, np.stack([derivative[name] for name in self.problem.names])


def fitted(
    problem: Problem,
    target: BarTarget,
    start: dict[str, float],
    noise: Noise | None = None,
    *,
    tolerance: float = SETTLED,
) -> Fit:
    """Fit the picture by damped Gauss-Newton steps; the noise, if known, tells the covariance.

    Notes
    -----
    Weighted least squares is a linear estimator near its answer, E = (J' W J + P)^-1 J' W: whatever the correlation
    between pixels, its covariance is E S E' + the priors' part.
    """
    picture = Picture(problem, target)
    names = problem.names
    data, weight = problem.image[problem.window], 1.0 / problem.variance
    theta = np.array([start[name] for name in names])
    low, high = np.array([BOUNDS.get(name, (-np.inf, np.inf)) for name in names]).T
    pixel = picture.shape(start).pixel

    def loss(model: Array, point: Array) -> tuple[float, Array, Array]:
        mtf = pixel * np.exp(-np.exp(point[0]))
        mean, precision = priors(problem, float(mtf))
        cost = float(weight @ (data - model) ** 2 + precision @ (point - mean) ** 2)
        return cost, mean, precision

    model, slope = picture(dict(zip(names, theta, strict=True)))
    cost, mean, precision = loss(model, theta)
    for _ in range(ITERATIONS):
        normal = (slope * weight) @ slope.T + np.diag(precision)
        gradient = slope @ (weight * (data - model)) + precision * (mean - theta)
        scale = 1.0 / np.sqrt(np.diag(normal))
        step = scale * np.linalg.solve(normal * np.outer(scale, scale) + 1e-9 * np.eye(len(scale)), scale * gradient)
        expected = float(gradient @ step)
        for share in (1.0, 0.4, 0.1, 0.02):
            tried = np.clip(theta + share * step, low, high)
            new_model, new_slope = picture(dict(zip(names, tried, strict=True)))
            new_cost, new_mean, new_precision = loss(new_model, tried)
            if new_cost < cost:
                break
        else:
            break
        theta, model, slope, cost, mean, precision = tried, new_model, new_slope, new_cost, new_mean, new_precision
        if expected < tolerance:
            break
    normal = (slope * weight) @ slope.T + np.diag(precision)
    inverse = np.linalg.pinv(normal, rcond=1e-14, hermitian=True)
    estimator = inverse @ (slope * weight)
    noise = noise or Noise(variance=problem.variance, correlation=np.ones((1, 1)))
    spread = noise.spread(estimator, problem.window)
    covariance = spread + (inverse * precision) @ inverse
    point = dict(zip(names, theta, strict=True))
    moved = _moved(target, point)
    return Fit(
        target=moved,
        shape=picture.shape(point),
        names=names,
        value=theta,
        covariance=covariance,
        residual_dn=data - model,
        model_dn=model,
        slope=slope,
        estimator=estimator,
        noise_covariance=spread,
        prior_mean=mean,
        precision=precision,
        window=problem.window,
        noise=noise,
    )


def _moved(target: BarTarget, point: dict[str, float]) -> BarTarget:
    """Return the target where the fit has put it."""
    cosine, sine = np.cos(point["angle_rad"]), np.sin(point["angle_rad"])
    across, along = point["across_px"], point.get("along_px", 0.0)
    return replace(
        target,
        frequency=float(np.exp(point["log_frequency"])),
        angle_rad=point["angle_rad"],
        col=target.col + across * cosine - along * sine,
        row=target.row + (across * sine + along * cosine) / target.pitch_ratio,
    )


def measured(frames: Array, problem: Problem, target: BarTarget, *, inflation: float = 1.0) -> tuple[Fit, Problem]:
    """Fit the mean of frames with the noise that is in them; return the problem with each pixel's variance too.

    Parameters
    ----------
    frames
        Shape (frame, row, col); of one alone the noise is what a first fit leaves over.
    inflation
        Factor by which light that lingers widens the error of the mean, on its square.
    """
    first = fitted(problem, target, start_of(problem, target, START_EXPONENT, START_CORE), tolerance=ROUGHLY)
    window = problem.window
    if len(frames) > 1:
        noise = noise_of(frames, first.model_dn, window, inflation=inflation)
    else:
        spread = first.noise_covariance
        for _ in range(2):
            absorbed = _root(spread).T @ first.slope
            noise = noise_of_one(first.residual_dn, first.model_dn, absorbed, window)
            spread = noise.spread(first.estimator, window)
    # No pixel weighs more than the average one: steep weights carry the noise of the first fit into the second.
    least = max(float(noise.variance.mean()), LEAST_VARIANCE * first["level_dn"] ** 2)
    weighed = replace(problem, variance=np.maximum(noise.variance, least))
    return fitted(weighed, target, first.values, noise), weighed


def _root(covariance: Array) -> Array:
    """Return a matrix whose square is a covariance, shape (parameter, parameter)."""
    values, vectors = np.linalg.eigh(covariance)
    return vectors * np.sqrt(np.maximum(values, 0.0))
