"""Thresholds and numerical settings of the post-gain MTF from noise spectra, each with its meaning
and source.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class SpectrumThresholds:
    """Decide flags, refusals and selections; set on simulated targets where no source is named."""

    # prior standard deviation of amplitudes of the non-parametric blur
    cosine_prior_sd: float = 1.5
    cosine_bound: float = 6.0  # bound of amplitudes of the non-parametric blur
    min_frames: int = 4  # frames that separate image lag from fixed pattern
    flicker: float = 0.05  # relative standard deviation of frame means that is flicker
    # change of power over signal along the levels of a linear response
    max_nonlinearity: float = 0.02
    max_mcp_saturation: float = 0.08  # the same of a described tube, whose MCP saturates
    nonlinearity_sd: float = 4.0  # its significance, standard errors
    # fourth moment over the squared second of exponential pulse heights
    pulse_kurtosis: float = 6.0
    pulse_square: float = 2.0  # second moment over the squared mean of exponential pulse heights
    # gain in ln likelihood of scattered light: chance below 0.01
    scatter_ln_likelihood: float = 5.0
    max_exponent: float = 2.5  # exponent that screens, fibres and chips do not exceed
    exponent_sd: float = 1.5  # standard deviations beyond it that are flagged
    misfit_p_value: float = 0.002  # p-value of a misfit
    min_blur_ln_evidence: float = 8.0  # ln evidence of a blurred spectrum over a white one
    min_model_weight: float = 0.02  # weight of a blur model below which it is left out
    min_effort: float = 0.25  # least fraction of the effective draws of a model, else its weight
    tube_ln_prior: float = 3.0  # ln prior ratio of the tube form for a described tube
    # Power of the evidence: no form is exact, and forms differ at frequency 0 (494 random cameras).
    evidence_power: float = 0.5
    # Prior standard deviation of ln anisotropy of a described camera: tubes and fibres blur
    # isotropically.
    round_sd: float = 0.1
    # the same of an unknown camera, whose pitches and video filter are not known
    anisotropy_sd: float = 0.4
    lag_sd: float = 4.0  # significance of image lag, standard errors
    # relative uncertainty of MTF50 beyond which more frames are needed
    max_relative_sd: float = 0.25
    nyquist_cy_per_px: float = 0.5  # nyquist frequency: beyond it only the form determines the MTF


@dataclass(frozen=True)
class SpectrumAccuracy:
    """Bounds draws, iterations, windows and tolerances."""

    n_replicas: int = 2  # replicas of the spectrum on each axis that may alias into the band
    n_at_once: int = 20_000  # powers of replicas computed at once, of a processor's cache
    min_replica: float = 3e-4  # fraction of the power below which a replica is left out
    # Frequencies over which the non-parametric blur varies freely, cy/px.
    cosine_range_cy_per_px: tuple[float, ...] = (0.02, 1.0)
    max_cells: int = 20  # cells of frequency on each axis
    modes_per_cell: int = 4  # modes of a cell along an axis
    min_modes: int = 8  # modes below which a cell is left out
    # modes near an axis that are left out: row and column noise, and leakage of the taper
    axis_modes: int = 2
    # frequencies in which image lag is estimated, cycles per column pitch
    lag_band_cy_per_px: float = 0.2
    # the same along columns, cycles per row of an exposure: fields do not alias there
    lag_row_band: float = 0.08
    white_quantile: float = 0.1  # quantile of a dark's power that is taken as its white part
    min_power_dn2: float = 1e-6  # floor of a flat's power in its weight, DN^2
    fraction_step: float = 1e-3  # step of a scattered fraction for derivatives
    derivative_step_sd: float = 0.05  # step of parameters for derivatives, standard deviations


@dataclass(frozen=True)
class ProcessedThresholds:
    """Decide what even areas say of processing; fair ones are 208 edges drawn by other programs."""

    min_pairs: int = 800  # Pairs of neighbours along an axis below which nothing is tested
    # Squared differences at one of 8 places over the others: JPEG of quality 60 leaves 2.7 to 9.9,
    # pictures interpolated to twice the samples up to 1.7, fair ones up to 1.2
    block_ratio: float = 2.1
    parity_ratio: float = 1.7  # The same of even and odd pixels: 2.9 to 3.8, fair ones up to 1.12
    # Squared differences over those of independent pixels: medians and interpolation leave .1 to .4
    smoothed_ratio: float = 0.6
    # Excess of equal neighbours, fraction: medians leave .1 to .4
    equal_neighbours: float = 0.07
    # Least squared difference of neighbours less rounding, steps^2: below it codes hide the noise
    least_square: float = 0.05
    common_code: int = 15  # Pixels of a code whose neighbour is missed
    min_gaps: int = 2  # Codes left out: fair frames have none
    max_codes: int = 4096  # Codes of an area beyond which none is common
    # Relative changes of MTF50 at most: by the kernels of interpolation, and by a median of nine
    # pixels of noise, which leaves a straight edge without noise as it is (30 edges: 3.2 %)
    interpolation_bias: float = 0.01
    rank_bias: float = 0.035


PROCESSED = ProcessedThresholds()
THRESHOLDS = SpectrumThresholds()
ACCURACY = SpectrumAccuracy()
