"""Thresholds and numerical settings of the post-gain MTF from noise spectra, each with its meaning and source."""

from dataclasses import dataclass


@dataclass(frozen=True)
class SpectrumThresholds:
    """Decide flags, refusals and selections; set on simulated targets where no source is named."""

    # Prior standard deviation of its amplitudes.
    cosine_prior_sd: float = 1.5
    # Bound of its amplitudes.
    cosine_bound: float = 6.0
    # Frames that separate image lag from fixed pattern.
    min_frames: int = 4
    # Relative standard deviation of frame means that is flicker.
    flicker: float = 0.05
    # Change of power over signal along the levels of a linear response.
    max_nonlinearity: float = 0.02
    # The same of a described tube, whose MCP saturates.
    max_mcp_saturation: float = 0.08
    # Its significance, standard errors.
    nonlinearity_sd: float = 4.0
    # Fourth moment over the squared second of exponential pulse heights.
    pulse_kurtosis: float = 6.0
    # Second moment over the squared mean of exponential pulse heights.
    pulse_square: float = 2.0
    # Gain in ln likelihood of scattered light: chance below 0.01.
    scatter_ln_likelihood: float = 5.0
    # Exponent that screens, fibres and chips do not exceed.
    max_exponent: float = 2.5
    # Standard deviations beyond it that are flagged.
    exponent_sd: float = 1.5
    # P-value of a misfit.
    misfit_p_value: float = 0.002
    # Ln evidence of a blurred spectrum over a white one.
    min_blur_ln_evidence: float = 8.0
    # Weight of a blur model below which it is left out.
    min_model_weight: float = 0.02
    # Ln prior ratio of the tube form for a described tube.
    tube_ln_prior: float = 3.0
    # Power of the evidence: no form is exact, and forms differ at frequency 0 (494 random cameras).
    evidence_power: float = 0.5
    # Prior standard deviation of ln anisotropy of a described camera: tubes and fibres blur isotropically.
    round_sd: float = 0.1
    # The same of an unknown camera, whose pitches and video filter are not known.
    anisotropy_sd: float = 0.4
    # Significance of image lag, standard errors.
    lag_sd: float = 4.0
    # Relative uncertainty of MTF50 beyond which more frames are needed.
    max_relative_sd: float = 0.25
    # Nyquist frequency: beyond it only the form determines the MTF.
    nyquist_cy_per_px: float = 0.5


@dataclass(frozen=True)
class SpectrumAccuracy:
    """Bounds draws, iterations, windows and tolerances."""

    # Replicas of the spectrum on each axis that may alias into the band.
    n_replicas: int = 2
    # Fraction of the power below which a replica is left out.
    min_replica: float = 3e-4
    # Frequencies over which the non-parametric blur varies freely, cy/px.
    cosine_range_cy_per_px: tuple[float, ...] = (0.02, 1.0)
    # Cells of frequency on each axis.
    max_cells: int = 20
    # Modes of a cell along an axis.
    modes_per_cell: int = 4
    # Modes below which a cell is left out.
    min_modes: int = 8
    # Modes near an axis that are left out: row and column noise, and leakage of the taper.
    axis_modes: int = 2
    # Largest lag of image lag, exposures.
    max_lag_exposures: int = 12
    # Frequencies in which image lag is estimated, cycles per column pitch.
    lag_band_cy_per_px: float = 0.2
    # The same along columns, cycles per row of an exposure: fields do not alias there.
    lag_row_band: float = 0.08
    # Quantile of a dark's power that is taken as its white part.
    white_quantile: float = 0.1
    # Floor of a flat's power in its weight, DN^2.
    min_power_dn2: float = 1e-6
    # Step of a scattered fraction for derivatives.
    fraction_step: float = 1e-3
    # Step of parameters for derivatives, standard deviations.
    derivative_step_sd: float = 0.05


THRESHOLDS = SpectrumThresholds()
ACCURACY = SpectrumAccuracy()
