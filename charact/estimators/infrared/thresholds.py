"""Thresholds and accuracy of the infrared quantities, one a line, each with its source."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class InfraredLimits:
    """Signal transfer, NETD and MRTD of infrared cameras."""

    draws: int = 4000  # posterior draws
    # K; setting and uniformity of a laboratory black body, one standard deviation
    blackbody_sd_k: float = 0.02
    # weight of that prior, in levels; few levels get intervals of Student's t
    scatter_freedom: float = 2.0
    advised_levels: int = 5  # levels that show scatter, drift and a bend apart
    significant_sd: float = 4.0  # standard errors of a significant slope or fall of the signal
    false_alarm: float = 1e-3  # false-alarm probability of levels that do not follow the law
    bend_share: float = 0.9  # part of chi squared that a parabola must take to be the reason
    max_clipped_fraction: float = 1e-4  # clipped values of a level that still counts
    # Change of the noise between levels beyond photon noise: 3-D noise of 16 frames of 64 x 64 px
    # repeats to 1 %.
    noise_change: float = 0.1
    # noise of the hottest or coldest level over that of the next which is saturation
    saturated_noise: float = 0.5
    # change of the smooth response over the frame; cos^4 at the edge of 20 deg: 6 %
    response_change: float = 0.1
    background_k: float = 0.5  # K; scatter of the stated backgrounds: 1.7 % of dL/dT in 3-5 um
    min_mtf: float = 0.02  # lower 95 % limit of the MTF that resolves a frequency
    # perceived signal-to-noise ratio at the threshold of detection (STANAG 4349 practice)
    snr: float = 2.5
    eye_s: float = 0.2  # s; integration time of the eye (the same)


INFRARED = InfraredLimits()
