"""Model errors and limits of the fit, one a line.

Relative errors and fractions are dimensionless. Without another source a model error is the largest
disagreement of formula and simulated frames over specimens drawn from the shipped descriptions.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class ModelErrors:
    """Errors of the predicted quantities, added to those of the measurement."""

    # Noise power and variance, relative: integrals of the blur agree within 0.2 % (tests/physics).
    noise: float = 0.002
    # Noise power at frequency 0, relative: extrapolation by blur models; 1.7 % of 24 specimens, 1.0
    # % stated.
    power: float = 0.012
    # Correlation of neighbouring pixels, absolute: 0.0011 of 24 specimens.
    neighbour: float = 0.0015
    # Stack mean above the black level, relative: 0.12 % of 24 specimens at known light.
    level: float = 0.0015
    # Level of every dark and flat, DN: clamp, ions of a dark, rounding.
    black_dn: float = 0.05
    # Mean, DN, and variance, DN^2, of a stack whose noise is below `least_noise_dn`: attracted to
    # whole numbers, by up to exp(-2 pi^2 s^2)/pi, and noise hidden or raised by rounding, by -1/12
    # to 1/6 DN^2.
    leaning_dn: float = 0.15
    rounding_dn2: float = 0.1
    # MTF, absolute, and distance over which its errors are correlated, cy/px: the window of an edge
    # of 100 px.
    mtf: float = 0.004
    mtf_correlation_cy_per_px: float = 0.08
    # Veiling glare, relative: it follows the mean of the field of view, which is larger than the
    # frame.
    glare: float = 0.1
    # Contrast of a target, as two decimals are stated: 0.01/sqrt(12); transmittance of an opaque
    # one: chrome of optical density 3.
    contrast_sd: float = 0.003
    opaque_transmittance: float = 0.001
    # Halo diameter, px: its edge is located on pixels.
    halo_px: float = 0.1
    # Variance of a tube's fixed pattern, relative: blur of the screen's grain.
    pattern: float = 0.05
    # Variance of a hexagonal pattern of lines over its squared contrast, 2 w^2/(p P): lines of w =
    # 6 um, a fibre or two, seen by pixels of p = 18 um at the pitch P of 0.5 mm.
    line_area: float = 0.008


@dataclass(frozen=True)
class FitLimits:
    """Limits of the data that are used and of what counts as identified."""

    # Noise at which quantisation is additive, DN: the first term of rounding is below 1 % there.
    least_noise_dn: float = 0.5
    # Spacing of the MTF's points, cy/px: half the distance over which errors are correlated; range,
    # and least MTF.
    mtf_spacing_cy_per_px: float = 0.04
    mtf_highest_cy_per_px: float = 0.45
    least_mtf: float = 0.03
    # Distance from an edge beyond which its sides show glare alone, px: more than three widths of
    # the widest lens blur of 20 um on pixels of 4 um; fewest pixels of a side.
    glare_px: float = 15.0
    glare_pixels: int = 500
    # p-value of a misfit, at which all errors are scaled.
    misfit: float = 1e-4
    # A parameter is identified if its posterior is narrower than this fraction of its prior, in
    # standard deviations.
    identified: float = 0.7
    # Fraction of the pixels of a frame that show what wells hold, and standard deviations of the
    # read noise that are taken off their level.
    brightest_fraction: float = 0.001
    read_noise_margin: float = 3.0
    # Quantile of its posterior below which, or above its complement, the mode is no typical value.
    edge: float = 0.1


@dataclass(frozen=True)
class Modes:
    """Search for the modes of the posterior."""

    # Starts drawn from the prior besides its centre, and their seed: of gen3-digital-iccd, whose
    # ions have two modes, three in ten ascents end on the lower one.
    starts: int = 7
    seed: int = 59
    iterations: int = 200  # of an ascent
    first_iterations: int = 30  # after which ascents to the same place are joined
    difference: float = 1e-3  # step of finite differences over the prior's width
    # Standard deviations between modes that are two; fraction of the posterior that one must hold
    # to be drawn from.
    distinct_sd: float = 6.0
    least_weight: float = 0.01
    # Fraction of its prior's width below which a parameter is determined by the data.
    scored_sd: float = 0.2


@dataclass(frozen=True)
class Sampling:
    """Draws of the posterior."""

    chains: int = 400  # chains, each of which gives a draw of the fitted description
    wider: float = 1.2  # variance of the normal law of the slice sampling over that of the chains
    # Steps of rounds whose draws are forgotten, and of rounds after each of which chains are
    # judged.
    burn_in_steps: tuple[int, ...] = (5, 5, 10)
    steps: tuple[int, ...] = (20, 20, 40, 80, 160, 160)
    least_variance: float = 1e-8  # of a direction of the parameters, each over its own
    least_angle: float = 1e-6  # bracket of a step, rad, below which a chain stays
    # emcee's walkers and their steps likewise.
    walkers_per_parameter: int = 4
    walkers_burn_in_steps: tuple[int, ...] = (100, 200)
    walkers_steps: tuple[int, ...] = (400, 400, 800)
    candidates: int = 400  # prior draws of a truncated parameter


@dataclass(frozen=True)
class ConvergenceLimits:
    """When chains are believed."""

    most_shift_sd: float = 0.1  # means of their halves apart, standard deviations of the posterior
    least_effective: float = 400.0  # effective draws of every parameter
    least_of_chain: float = 5.0  # effective draws of a chain: autocorrelation times
    # ln p(mode) - ln p(draw): relative departure of its mean from d/2, and absolute.
    depth_tolerance: float = 0.5
    depth_slack: float = 0.5


@dataclass(frozen=True)
class TubeFrames:
    """Frames of flats behind a tube: what is used of them, and model errors."""

    # Frames and pixels of a stack that are used: beyond them the model error of the correlation
    # dominates.
    most_frames: int = 32
    most_rows: int = 480
    most_columns: int = 768
    # Fewest frames that show a correlation, and largest lag, frames: slow screens have faded by
    # then.
    least_frames: int = 4
    largest_lag: int = 4
    # Flats whose frames are correlated, brightest first.
    most_flats: int = 3
    # Standard deviation of a pixel above which rounding adds noise of its own, DN: 1 % of the
    # variance at most.
    least_noise_dn: float = 0.6
    # Blocks of an image, rows and columns, whose scatter gives the standard errors.
    blocks: tuple[int, int] = (8, 8)
    # Model error of a correlation: the shape of the blur enters the correlation of successive
    # fields.
    correlation_model_sd: float = 0.001
    # Parts of a line whose covariance is that of the line noise: parts next to each other share
    # pulses.
    line_parts: int = 8


@dataclass(frozen=True)
class TubeDarks:
    """Pulses, quiet pixels and ions in the darks of a tube."""

    # Values that stand out of the noise by so much are pulses, standard deviations and DN; so are
    # their surroundings, rows and columns.
    pulse_sd: float = 4.5
    pulse_dn: float = 1.5
    pulse_reach: tuple[int, int] = (7, 9)
    # Fewest values below a grey value and largest fraction of them that locate the noise of a
    # coarse digitiser, and both fractions for a fine one.
    least_count: int = 50
    most_below: float = 0.9
    fine_below: tuple[float, float] = (0.05, 0.5)
    # Largest fraction of one grey value of a fine digitiser.
    fine_fraction: float = 0.05
    # Fewest quiet values, as a fraction, and fewest frames.
    least_quiet: float = 0.05
    least_frames: int = 4
    # Charge of an ion event over k F^2, and of each pixel of its window, DN: hardly a pulse is as
    # large, and no noise that rounding doubles along a line.
    ion_charge: float = 8.0
    ion_pixel_dn: float = 1.5
    # Window, field rows and columns, in which the charge of a pulse is summed.
    window: tuple[int, int] = (3, 5)
    # Least charge of an ion event over the noise of the window, and the area that its light
    # reaches, rows and columns.
    ion_sd: float = 7.0
    ion_reach: tuple[int, int] = (13, 13)


@dataclass(frozen=True)
class IonErrors:
    """Ion events in the darks of a tube: limits and model errors."""

    # Fewest events whose mean charge is observed; relative model errors of the root of their
    # number, of the charge, and of the number of pulses that coincide.
    least_events: int = 4
    number: float = 0.05
    charge: float = 0.1
    coincidences: float = 0.3


@dataclass(frozen=True)
class DarkErrors:
    """Observations of the darks of a tube: limits and model errors."""

    # Largest fraction of the image that may be reached by ions.
    most_reached: float = 0.6
    # Mean light of a pulse outside its surroundings, and its error; relative.
    wing: float = 0.04
    wing_sd: float = 0.04
    # Relative model errors: of the pulses' covariance, of fine and of coarse digitisers, and of
    # what rounding does.
    covariance_sd: float = 0.05
    coarse_covariance_sd: float = 0.08
    rounding_sd: float = 0.25
    # Error of the level between pulses by pulses too weak to be seen by a coarse digitiser, DN.
    level_sd_dn: float = 0.04
    # Variance of the noise between pulses: relative model error, of fine and of coarse digitisers.
    quiet_sd: float = 0.03
    coarse_quiet_sd: float = 0.07
    # Fixed pattern that rounding and few pulses leave in a coarse digitiser's quiet pixels, DN.
    coarse_pattern_dn: float = 0.03
    # Standard deviation below which rounding is no noise of its own, DN; slope below which it hides
    # a dark pattern.
    coarse_dn: float = 0.6
    least_slope: float = 0.4


@dataclass(frozen=True)
class TubePattern:
    """Pattern of the flats of a tube."""

    # Frames left out between two halves, whose lag would correlate their noise, where there are
    # enough.
    gap_frames: int = 4
    least_frames: int = 12
    # Variance over squared contrast of what the borders of multi-fibres leave: a twentieth of their
    # own, which is 2 w/P sqrt(pi)/2 of Gaussian lines of the width w of a fibre or two at the pitch
    # P of 0.5 mm.
    border_residue: float = 0.05 * 0.03
    # Relative model error of the variance.
    pattern_sd: float = 0.08


@dataclass(frozen=True)
class Levels:
    """Stacks within the linear range."""

    # Fraction of pixels at an end of the scale, and level over full scale, up to which a stack is
    # in the linear range.
    most_clipped: float = 0.001
    highest_level: float = 0.85
    # Variance over that of a dimmer flat, and standard errors, below which wells are full: that of
    # a linear response rises, a gamma of 0.45 lowers it to 0.55 over a factor of 400 of light.
    full_variance: float = 0.5
    full_sd: float = 3.0


@dataclass(frozen=True)
class MapLimits:
    """Maps of a specimen."""

    # Variance of the exposures of darks over their mean square that shows a rate: rounding of equal
    # ones is far below, a single pair of 10 % apart above.
    least_spread: float = 1e-3
    # Frames of a stack that is divided between maps and tests: a test needs two of them.
    divided_frames: int = 4
    # Difference of the parts of a dark with pulses, standard deviations of its noise, beyond which
    # the smaller one counts: 3 in 1000 normal pixels.
    pulse_sd: float = 3.0
    # Frames of a tube's darks whose two medians pulses hardly reach: of five frames a median needs
    # three pulses on a pixel, that of two is their mean.
    pulse_frames: int = 10
    # Chance of a pixel of normal noise in all of a frame that counts as noisy, and freedom of the
    # variances, with which a variance 5 times the mean is beyond chance (chi-squared).
    chance: float = 0.01
    least_freedom: int = 12
    # Widths of codes: half of the codes over which a histogram is smooth, half the noise, where a
    # normal density departs by .2 % from a curve of the third degree; number of values over the
    # highest, where it departs by as much; values of a code by which its noise is nearly normal;
    # chance of a finding without widths; number over the expected one of a missing code.
    least_codes: int = 4
    most_codes: int = 24
    frequent: float = 0.1
    least_values: float = 100.0
    code_chance: float = 1e-4
    missing: float = 0.1


@dataclass(frozen=True)
class ExposureSearch:
    """Search for an exposure."""

    # Frames over which image lag is summed: a P20 screen has emitted 99.9 % by then.
    lag_frames: int = 9
    # Gains that are tried, and the lowest MCP voltage over the highest: below it the law V^m of the
    # gain is not known.
    gains: int = 25
    lowest_voltage: float = 0.6
    # Noise above which rounding adds 1/12 DN^2 within 1 % (Widrow and Kollar, Quantization Noise,
    # 2008, 4: the error falls as exp(-2 pi^2 s^2)), DN.
    least_noise_dn: float = 0.5
    # Rounds in which the number of frames settles.
    rounds: int = 12
    # Shortest gate or exposure over the longest.
    shortest: float = 1e-6
    halvings: int = 40
    # Frames over the fewest up to which a lower gain is preferred: it spares the tube.
    more_frames: float = 1.1
    # Standard deviations of noise above the level that full scale and full well hold: one pixel in
    # a thousand is beyond, as the 0.1 % of EMVA 1288 Release 4.0, 6.6.
    headroom_sd: float = 3.09


ERRORS = ModelErrors()
LIMITS = FitLimits()
MODES = Modes()
SAMPLING = Sampling()
CONVERGENCE = ConvergenceLimits()
FRAMES = TubeFrames()
DARKS = TubeDarks()
DARK_ERRORS = DarkErrors()
ION_ERRORS = IonErrors()
PATTERN = TubePattern()
LEVELS = Levels()
MAP_LIMITS = MapLimits()
EXPOSURE = ExposureSearch()
