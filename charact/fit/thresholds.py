"""Model errors and limits of the fit, one a line.

Relative errors and fractions are dimensionless. Without another source a model error is the largest disagreement of
formula and simulated frames over specimens drawn from the shipped descriptions.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class ModelErrors:
    """Errors of the predicted quantities, added to those of the measurement."""

    # Noise power and variance, relative: integrals of the blur agree within 0.2 % (tests/physics).
    noise: float = 0.002
    # Noise power at frequency 0, relative: extrapolation by blur models; 1.7 % of 24 specimens, 1.0 % stated.
    power: float = 0.012
    # Correlation of neighbouring pixels, absolute: 0.0011 of 24 specimens.
    neighbour: float = 0.0015
    # Stack mean above the black level, relative: 0.12 % of 24 specimens at known light.
    level: float = 0.0015
    # Level of every dark and flat, DN: clamp, ions of a dark, rounding.
    black_dn: float = 0.05
    # Mean, DN, and variance, DN^2, of a stack whose noise is below `least_noise_dn`: attracted to whole numbers, by up
    # to exp(-2 pi^2 s^2)/pi, and noise hidden or raised by rounding, by -1/12 to 1/6 DN^2.
    leaning_dn: float = 0.15
    rounding_dn2: float = 0.1
    # MTF, absolute, and distance over which its errors are correlated, cy/px: the window of an edge of 100 px.
    mtf: float = 0.004
    mtf_correlation_cy_per_px: float = 0.08
    # Halo diameter, px: its edge is located on pixels.
    halo_px: float = 0.1
    # Variance of a tube's fixed pattern, relative: blur of the screen's grain.
    pattern: float = 0.05
    # Variance of a hexagonal pattern of lines over its squared contrast, 2 w^2/(p P): lines of w = 6 um, a fibre or
    # two, seen by pixels of p = 18 um at the pitch P of 0.5 mm.
    line_area: float = 0.008


@dataclass(frozen=True)
class FitLimits:
    """Limits of the data that are used and of what counts as identified."""

    # Noise at which quantisation is additive, DN: the first term of rounding is below 1 % there.
    least_noise_dn: float = 0.5
    # Spacing of the MTF's points, cy/px: half the distance over which errors are correlated; range, and least MTF.
    mtf_spacing_cy_per_px: float = 0.04
    mtf_highest_cy_per_px: float = 0.45
    least_mtf: float = 0.03
    # p-value of a misfit, at which all errors are scaled.
    misfit: float = 1e-4
    # A parameter is identified if its posterior is narrower than this fraction of its prior, in standard deviations.
    identified: float = 0.7
    # Quantile of its posterior below which, or above its complement, the mode is no typical value.
    edge: float = 0.1


@dataclass(frozen=True)
class Sampling:
    """Draws of the posterior."""

    kept: int = 400  # chains, each of which gives a draw of the fitted description
    rounds: int = 4  # of the adaptation, draws of each and freedom of its Student t
    round_draws: int = 3000
    freedom: float = 8.0
    wider: float = 1.2  # variance of the normal law of the slice sampling over the adapted one
    # Steps of the chains: after 10 no coordinate keeps a correlation above 0.5 with its start.
    least_steps: int = 10
    most_steps: int = 80
    most_change_se: float = 5.0  # change of mean or spread over the second half of the steps, standard errors
    least_angle: float = 1e-6  # bracket of a step, rad, below which a chain stays
    candidates: int = 400  # prior draws of a truncated parameter


ERRORS = ModelErrors()
LIMITS = FitLimits()
SAMPLING = Sampling()
