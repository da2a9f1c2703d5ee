"""Thresholds and numerical settings of the MTF comparisons of a session, each with its meaning and
source.
"""

from dataclasses import dataclass

# Half of a 68 % interval in standard deviations.
HALF68_SD = 0.994458


@dataclass(frozen=True)
class SessionThresholds:
    """Decide flags, refusals and selections; set on simulated targets where no source is named."""

    same_direction_deg: float = 10.0  # Angle beyond which directions have MTFs of their own, deg
    level: float = 0.05  # Significance level of the consistency tests
    min_mtf: float = 0.04  # MTF below which a curve is not used
    # Standard deviation of a principal component over the largest: smaller ones are curvature of
    # the blur model.
    min_component: float = 0.1
    model_sd: float = 0.002  # Standard deviation between the blur models of the methods at high SNR
    # Weight of a blur model below which it is left out of the average
    min_model_weight: float = 0.02
    # P-value below which a note names the target that deviates most
    inconsistent_p_value: float = 0.05
    misfit_p_value: float = 0.01  # P-value below which the joint MTF is flagged
    near_axis_deg: float = 30.0  # Angle to an axis within which a target measures it, deg
    # Variance of a combination left by the others below which nothing is compared
    min_compared: float = 0.02
    # Prior standard deviation of ln of the vertical over the horizontal half frequency
    stretch_sd: float = 0.2
    identified: float = 0.6  # Posterior over prior standard deviation of an identified stage
    product: float = 0.4  # Standard deviation of a product over that of independent members
    budget_p_value: float = 0.01  # P-value below which the stages do not describe the curves
    cascade_sd: float = 0.004  # Difference of a joint MTF and a product of stages
    cascade_correlation_cy_per_px: float = 0.08  # Frequency over which it is correlated, cy/px
    # Relative prior standard deviation where a description states no range
    unstated_sd: float = 0.3
    wavelength_mm: float = 0.7e-3  # Wavelength in the middle of the photocathode's band, mm


@dataclass(frozen=True)
class Detectability:
    """Numbers of noise-equivalent quanta and detectability."""

    draws: int = 400  # Draws of MTF and noise power
    cells: int = 6  # Cells of the noise power next to a frequency whose mean is taken there
    step_cy_per_px: float = 0.0025  # Step of the integral over frequencies, of discs up to 100 px


@dataclass(frozen=True)
class ThroughFocus:
    """Numbers of a curve through focus."""

    positions: int = 4  # Fewest positions: three make any parabola, a fourth tests it
    draws: int = 1000  # Draws of the fitted curve
    points: int = 101  # Points at which it is drawn
    # Powers of MTF50 that are parabolas of the focus: of a parabola, of a Lorentzian, and of
    # Gaussian blurs, which add in squares
    powers: tuple[float, ...] = (1.0, -1.0, -2.0)


THRESHOLDS = SessionThresholds()
DETECTABILITY = Detectability()
FOCUS = ThroughFocus()
