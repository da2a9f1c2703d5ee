"""Fit of a bar target's image to its pixels, with the covariance and bias by the actual noise."""

from dataclasses import dataclass, replace

import numpy as np

from charact.estimators.mtf.bars.bar_image_model import (
    BarImageModel,
    BarLikelihood,
    BarShape,
    initial_parameters,
    priors,
)
from charact.estimators.mtf.bars.noise import WindowCovariance, noise_of, noise_of_one
from charact.estimators.mtf.bars.target import BarTarget
from charact.estimators.mtf.bars.thresholds import ACCURACY
from charact.frames.rounding import rounding_shifts
from charact.inference.gauss_newton import (
    Linearisation,
    least_squares,
    linearise_residual,
    weigh_by_evidence,
)
from charact.inference.laplace_approximation import covariance_root
from charact.transfer.cores import ON_BARS
from labdata import Array, Mask


@dataclass(frozen=True, kw_only=True)
class BarFit:
    """A fitted image."""

    target: BarTarget  # Position of the bars
    shape: BarShape  # Parameters of their image
    # names, value, covariance: parameter names, values and covariance
    names: tuple[str, ...]
    value: Array
    covariance: Array
    # residual_dn, model_dn: pixels less the image, and the image, shape (pixel,)
    residual_dn: Array
    model_dn: Array
    slope: Array  # Derivatives of the image, shape (parameter, pixel)
    inverse: Array  # Inverse of the normal matrix, priors included, shape (parameter, parameter)
    estimator: Array  # Weight of each pixel in each parameter, shape (parameter, pixel)
    noise_covariance: Array  # The part of the covariance that is due to noise
    # prior_mean, precision: of the priors, shape (parameter,); precision 0: none
    prior_mean: Array
    precision: Array
    window: Mask  # Pixels used, shape (row, col)
    noise: WindowCovariance  # Noise of the pixels
    strip: bool  # Whether the bars cross the complete window
    cost: float  # Chi squared with the priors' terms

    def __getitem__(self, name: str) -> float:
        return float(self.value[self.names.index(name)])

    @property
    def values(self) -> dict[str, float]:
        """Parameters by name."""
        return dict(zip(self.names, self.value.tolist(), strict=True))

    @property
    def start(self) -> dict[str, float]:
        """Parameters from which another fit begins where this one has put the target."""
        at_target = {name: 0.0 for name in ("across_px", "along_px") if name in self.names}
        return {**self.values, **at_target}

    def sd(self, name: str) -> float:
        """Standard deviation of a parameter."""
        index = self.names.index(name)
        return float(np.sqrt(self.covariance[index, index]))

    @property
    def ln_mtf_slope(self) -> Array:
        """Derivatives of ln MTF at the reference frequency, shape (parameter,)."""
        slope = np.zeros(len(self.names))
        slope[self.names.index("log_attenuation")] = -np.exp(self["log_attenuation"])
        slope[self.names.index("departure")] = 1.0 / (1.0 + self["departure"])
        return slope


def fit_bars(
    problem: BarLikelihood,
    target: BarTarget,
    start: dict[str, float],
    noise: WindowCovariance | None = None,
    *,
    tolerance: float = 3e-3,
) -> BarFit:
    """Fit the image by least squares; the noise, if given, sets the covariance.

    Notes
    -----
    Near its optimum weighted least squares is a linear estimator, E = (J' W J + P)^-1 J' W. For any
    correlation between pixels its covariance is E S E' plus the priors' part.
    """
    image = BarImageModel(problem, target)
    # The transfer of the aperture, which the priors need, hardly changes during the fit.
    pixel = image.shape(start).pixel
    data, weight = problem.image[problem.window], 1.0 / np.sqrt(problem.variance)

    def linearise(theta: Array) -> Linearisation:
        model, slope = image(dict(zip(problem.names, theta, strict=True)))
        mean, precision = priors(problem, float(pixel * np.exp(-np.exp(theta[0]))))
        return linearise_residual(
            (data - model) * weight,
            slope * weight,
            mean - theta,
            precision,
            (model, slope, mean, precision),
        )

    bounds = [problem.bounds.get(name, (-np.inf, np.inf)) for name in problem.names]
    begin = [start[name] for name in problem.names]
    optimum = least_squares(
        linearise,
        begin,
        bounds,
        iterations=24,
        tolerance=tolerance,
        damping=1e-6,
        grow=1e3,
    )
    model, slope, mean, precision = optimum.at.model
    weighted = slope / problem.variance
    inverse = np.asarray(
        np.linalg.pinv(optimum.at.normal, rcond=1e-14, hermitian=True), dtype=np.float64
    )
    estimator = inverse @ weighted
    noise = noise or WindowCovariance(variance=problem.variance, correlation=np.ones((1, 1)))
    spread = noise.spread(estimator, problem.window)
    point = dict(zip(problem.names, optimum.point.tolist(), strict=True))
    cosine, sine = np.cos(point["angle_rad"]), np.sin(point["angle_rad"])
    across, along = point["across_px"], point.get("along_px", 0.0)
    placed = replace(
        target,
        frequency=float(np.exp(point["log_frequency"])),
        angle_rad=point["angle_rad"],
        col=target.col + across * cosine - along * sine,
        row=target.row + (across * sine + along * cosine) / target.pitch_ratio,
    )
    return BarFit(
        target=placed,
        shape=image.shape(point),
        names=problem.names,
        value=optimum.point,
        covariance=spread + (inverse * precision) @ inverse,
        residual_dn=problem.image[problem.window] - model,
        model_dn=model,
        slope=slope,
        inverse=inverse,
        estimator=estimator,
        noise_covariance=spread,
        prior_mean=mean,
        precision=precision,
        window=problem.window,
        noise=noise,
        strip=problem.strip,
        cost=optimum.at.cost,
    )


def fit_frames(
    frames: Array,
    problem: BarLikelihood,
    target: BarTarget,
    *,
    inflation: float = 1.0,
    first: BarFit | None = None,
) -> tuple[BarFit, BarLikelihood]:
    """Fit the mean of frames with its noise; return the likelihood with each pixel's variance too.

    `frames`: shape (frame, row, col); for one frame the noise is estimated from the residuals of a
    first fit; `inflation`: variance factor of the mean by image lag.
    """
    start, tolerance = initial_parameters(problem, target), ACCURACY.first_tolerance
    first = first or fit_bars(problem, target, start, tolerance=tolerance)
    window, background = problem.window, first["pedestal_dn"]
    if len(frames) > 1:
        noise = noise_of(frames, first.model_dn, window, ground_dn=background, inflation=inflation)
    else:
        # Start from white noise.
        spread = first.noise_covariance * np.mean(first.residual_dn**2) / np.mean(problem.variance)
        for _ in range(2):
            absorbed = covariance_root(spread).T @ first.slope
            noise = noise_of_one(
                first.residual_dn, first.model_dn, absorbed, window, ground_dn=background
            )
            spread = noise.spread(first.estimator, window)
        # A common quantisation shift is absorbed by the image: the residuals do not contain it.
        if frames.dtype.kind in "ui":
            noise = replace(noise, rounding=rounding_shifts(first.model_dn, noise.variance))
    # No pixel weighs more than the average one: unequal weights carry the noise of the first fit
    # into the second.
    min_variance = max(float(noise.variance.mean()), ACCURACY.min_variance * first["level_dn"] ** 2)
    likelihood = replace(problem, variance=np.maximum(noise.variance, min_variance))
    return fit_bars(likelihood, first.target, first.start, noise), likelihood


def fit_all_models(
    fit: BarFit, problem: BarLikelihood
) -> list[tuple[float, BarFit, BarLikelihood]]:
    """Fit all blur models; return weight, fit and likelihood of those that count, the likeliest
    first.

    `fit`: fit of one blur model; `problem`: its likelihood; the reported frequency may differ from
    that of the fit.

    Notes
    -----
    Weights are evidences by Laplace's approximation: exp(-chi^2 / 2), chi^2 divided by the
    correlation sum, times the posterior-to-prior widths of the model's two parameters. Each begins
    with its own typical shape and the transfer of the given fit at the reported frequency.
    """
    shape, ratio = fit.shape, problem.asked / fit.shape.reference
    ln_transfer = shape.form.ln(
        np.log([ratio]), float(np.exp(shape.log_attenuation)), shape.form_one, shape.form_two
    )
    fits = []
    for form in ON_BARS:
        likelihood = replace(problem, form=form)
        if form is shape.form and ratio == 1.0:
            fits.append((fit, likelihood))
            continue
        start = fit.start | {
            "log_attenuation": float(np.log(-ln_transfer[0])),
            "form_one": form.first.start,
            "form_two": form.second.start,
        }
        fits.append((fit_bars(likelihood, fit.target, start, fit.noise), likelihood))
    ln_evidences = [_ln_evidence(*candidate) for candidate in fits]
    weights = weigh_by_evidence(ln_evidences, min_weight=ACCURACY.min_model_weight)
    return [(weight, *fits[index]) for index, weight in weights]


def _ln_evidence(fit: BarFit, problem: BarLikelihood) -> float:
    """Return ln evidence by Laplace's approximation."""
    remaining = [
        min(fit.sd(name) / prior_sd, 1.0)
        for name, prior_sd in (
            ("form_one", problem.form.first.sd),
            ("form_two", problem.form.second.sd),
        )
    ]
    return -0.5 * fit.cost / fit.noise.correlation_sum + float(
        np.sum(np.log(np.maximum(remaining, 1e-6)))
    )


def mtf_bias(fit: BarFit, problem: BarLikelihood) -> float:
    """Return the expected excess of the fitted MTF by noise.

    Notes
    -----
    A phase, direction or frequency that follows the noise raises the bars' amplitude. With slopes
    J, second derivatives H, weights W, estimator E = (J' W J + P)^-1 J' W and noise covariance S
    the bias of the estimate is (Box 1971, doi 10.1111/j.2517-6161.1971.tb00871.x, for weights that
    may differ from the noise's)

        b = (J' W J + P)^-1 [sum_k H_k' W q_k - J' W tr(H C) / 2],
        C = E S E',   q = (1 - J E) S E',

    and that of the MTF M is M' b + tr(M'' C) / 2, to second order in the noise. It is neglected for
    an MTF of less than 1.5 % uncertainty.
    """
    mtf_indices = [fit.names.index("log_attenuation"), fit.names.index("departure")]
    first, second = _mtf_slopes(fit)
    covariance = fit.noise_covariance
    if first @ covariance[np.ix_(mtf_indices, mtf_indices)] @ first < (0.015 * fit.shape.mtf) ** 2:
        return 0.0
    shared = fit.noise.covariance_with(fit.estimator, fit.window)
    unlike = shared - covariance @ fit.slope
    bends = _bends(fit, problem)
    pull = np.zeros(len(fit.names))
    bent = np.zeros(fit.slope.shape[1])
    for (parameter, other), bend in bends.items():
        pull[parameter] += np.sum(bend * unlike[other] / problem.variance)
        bent += covariance[parameter, other] * bend
        if parameter != other:
            pull[other] += np.sum(bend * unlike[parameter] / problem.variance)
            bent += covariance[parameter, other] * bend
    off = fit.inverse @ pull - 0.5 * fit.estimator @ bent
    return float(
        first @ off[mtf_indices]
        + 0.5 * np.sum(second * covariance[np.ix_(mtf_indices, mtf_indices)])
    )


def rounding_sd(fit: BarFit) -> float:
    """Return the relative standard uncertainty of the MTF by quantisation."""
    rounding = fit.noise.rounding
    if rounding is None or not len(rounding):
        return 0.0
    return float(np.sqrt(np.mean((rounding @ fit.estimator.T @ fit.ln_mtf_slope) ** 2)))


def _mtf_slopes(fit: BarFit) -> tuple[Array, Array]:
    """Return the MTF's first and second derivatives by log attenuation and departure."""
    attenuation = np.exp(fit["log_attenuation"])
    family = fit.shape.pixel * np.exp(-attenuation)
    mtf = fit.shape.mtf
    by_both = -attenuation * family
    second = np.array([[mtf * attenuation * (attenuation - 1.0), by_both], [by_both, 0.0]])
    return np.array([-attenuation * mtf, family]), second


def _bends(fit: BarFit, problem: BarLikelihood) -> dict[tuple[int, int], Array]:
    """Return the image's second derivatives over the pixels by pair of parameters.

    Level, pedestal and departure enter linearly: they have mixed derivatives only.
    """
    image, index, optimum = BarImageModel(problem, fit.target), fit.names.index, fit.start
    bends: dict[tuple[int, int], Array] = {}
    for name, step in _steps(fit, image).items():
        up, down = (
            image({**optimum, name: optimum[name] + sign * step})[1] for sign in (1.0, -1.0)
        )
        parameter = index(name)
        for other, bend in enumerate((up - down) / (2.0 * step)):
            pair = (min(parameter, other), max(parameter, other))
            bends[pair] = 0.5 * (bends[pair] + bend) if pair in bends else bend
    departure, level = index("departure"), index("level_dn")
    bends[departure, level] = fit.slope[departure] / fit["level_dn"]
    return bends


def _steps(fit: BarFit, picture: BarImageModel) -> dict[str, float]:
    """Return the finite-difference step of each nonlinear parameter, for positions part of a
    period.
    """
    half_size_px = picture.reach
    move = min(0.06 / fit.target.frequency, 0.25)
    steps = {
        "log_attenuation": ACCURACY.shape_step,
        "form_one": ACCURACY.shape_step,
        "log_frequency": ACCURACY.shape_step / fit.target.bars,
        "log_length": ACCURACY.shape_step / fit.target.bars,
        "across_px": move,
        "along_px": move,
        "angle_rad": move / half_size_px[1],
    }
    return {name: step for name, step in steps.items() if name in fit.names}
