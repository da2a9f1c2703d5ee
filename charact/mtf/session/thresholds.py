"""Thresholds and numerical settings of the MTF comparisons of a session, each with its meaning and source."""

from dataclasses import dataclass

# Half of a 68 % interval in standard deviations.
HALF68_SD = 0.994458


@dataclass(frozen=True)
class SessionThresholds:
    """Decide flags, refusals and selections; set on simulated targets where no source is named."""

    # Angle beyond which directions have MTFs of their own, deg.
    same_direction_deg: float = 10.0
    # Significance level of the consistency tests.
    level: float = 0.05
    # MTF below which a curve is not used.
    min_mtf: float = 0.04
    # Standard deviation of a principal component over the largest: smaller ones are curvature of the blur model.
    min_component: float = 0.1
    # Standard deviation between the blur models of the methods at high SNR.
    model_sd: float = 0.002
    # Weight of a blur model below which it is left out of the average.
    min_model_weight: float = 0.02
    # P-value below which a note names the target that deviates most.
    inconsistent_p_value: float = 0.05
    # P-value below which the joint MTF is flagged.
    misfit_p_value: float = 0.01
    # Angle to an axis within which a target measures it, deg.
    near_axis_deg: float = 30.0
    # Variance of a combination left by the others below which nothing is compared.
    min_compared: float = 0.02
    # Prior standard deviation of ln of the vertical over the horizontal half frequency.
    stretch_sd: float = 0.2
    # Posterior over prior standard deviation of an identified stage.
    identified: float = 0.6
    # Standard deviation of a product over that of independent members.
    product: float = 0.4
    # P-value below which the stages do not describe the curves.
    budget_p_value: float = 0.01
    # Difference of a joint MTF and a product of stages.
    cascade_sd: float = 0.004
    # Frequency over which it is correlated, cy/px.
    cascade_correlation_cy_per_px: float = 0.08
    # Relative prior standard deviation where a description states no range.
    unstated_sd: float = 0.3
    # Wavelength in the middle of the photocathode's band, mm.
    wavelength_mm: float = 0.7e-3


@dataclass(frozen=True)
class SessionAccuracy:
    """Bounds draws, iterations, windows and tolerances."""

    # Steps of a Markov chain.
    chain_steps: int = 3000
    # Newton steps of a fit.
    newton_steps: int = 20
    # Draws of the prior, and of the joint MTF.
    prior_draws: int = 2000
    draws: int = 1000


THRESHOLDS = SessionThresholds()
ACCURACY = SessionAccuracy()
