"""Limits and model errors of the statistics, one a line, each with its source."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Readout:
    """Noise of the read-out of a digital camera."""

    # Fewest frames and pixels along an axis from which a spectrum is taken: two frames have one
    # phase of interference.
    fewest_frames: int = 4
    fewest_pixels: int = 48
    # Probability of the highest of all bins of white noise above which a peak is interference.
    chance_of_peak: float = 0.0001
    # Columns of the spectrum next to the rows' own from which the density of pixels is taken there.
    near_columns: int = 12
    # Bands of the rows' spectrum, equal in the logarithm of the frequency, cy/row.
    row_bands: int = 6
    # Relative model error of a band of the rows' spectrum: no camera has the exact law f^-a.
    row_model_sd: float = 0.05
    # Error of a frequency of interference, cycles over the frame: a clock of the camera divides its
    # pixel clock.
    frequency_cycles_sd: float = 0.02


@dataclass(frozen=True)
class SiliconErrors:
    """Observations of a camera without a tube: limits and model errors."""

    # Signal over full scale to which the photon transfer curve is fitted (EMVA 1288 release 4,
    # section 6.4).
    emva_reach: float = 0.7
    # Fewest flats whose variances are observed one by one, and least signal of each over the dark's
    # noise.
    fewest_flats: int = 3
    least_signal: float = 0.5
    # Relative error of variance over signal: no photon transfer curve is exactly that of the model.
    noise_model_sd: float = 0.01
    # Dark current and DSNU are stated at this temperature.
    reference_c: float = 25.0
    # Variance of rounding to whole DN, DN^2.
    rounding_dn2: float = 1.0 / 12.0
    # Dark noise below which rounding is not additive, DN.
    least_noise_dn: float = 0.4
    # Relative error of a flat's level, from linearity and the light's repeatability.
    level_model_sd: float = 0.003
    # Relative error of the electrons per lumen of a table of quantum efficiencies; see
    # `table_sensitivity_ua_per_lm`.
    lumen_model_sd: float = 0.002


@dataclass(frozen=True)
class FrameNumbers:
    """Numbers of the frames that a validation compares."""

    # Lags (row, col) whose correlation is compared, and the range of the summed covariance, px.
    lags: tuple[tuple[int, int], ...] = ((0, 1), (0, 2), (0, 3), (1, 0), (2, 0), (3, 0), (1, 1))
    reach: int = 6
    # Squared distance from the centre over that of a corner, below and above which noise is that of
    # the centre and of the corners: each some fifth of the picture.
    centre_square: float = 0.12
    corner_square: float = 0.58
    # Shares of the values whose mean describes a tail of the temporal noise.
    tails: tuple[float, ...] = (0.001, 0.01, 0.1)
    # Lowest bits of a value whose share of ones is compared.
    bits: int = 8
    # Edges of the bands of a noise spectrum, cy/px; the last ends in the corner.
    bands: tuple[float, ...] = (0.0, 0.05, 0.2, 0.35, 0.5, 0.71)
    # Standard deviations of a pixel that is no noise, in time.
    event_sd: tuple[float, ...] = (5.0, 10.0)
    # Share of the values, and number, up to which events are few: a change of their number by as
    # much is one of 100 %. Of 10 events 95 % of Poisson numbers lie within 4 to 16.
    few_events: float = 1e-5
    least_events: float = 10.0
    # Number of highest values whose mean is compared: of events in a stack, of pixels, and of
    # spots.
    highest_events: int = 30
    highest_pixels: int = 8
    highest_spots: int = 10
    # Values of a block, whose maximum says whether any of them may be among the highest.
    block: int = 64
    # Standard deviations of the two Gaussians whose difference shows a spot, px: shadows of dust
    # are some 10 px wide.
    spot_px: tuple[float, float] = (3.0, 9.0)


READOUT = Readout()
SILICON = SiliconErrors()
FRAMES = FrameNumbers()
