"""Thresholds of the validation: how many sets are simulated, and when a statistic fails."""

import math
from dataclasses import dataclass

from charact.observables.size import Tolerance


@dataclass(frozen=True)
class ValidationThresholds:
    """Set the ensemble, the tests and the controls."""

    # Simulated sets of frames, each from its own posterior draw: with fewer the tails of the tests
    # grow, with more the time.
    draws: int = 20
    # Most stacks that are simulated for further sets of statistics whose verdict those leave open,
    # by a spread near the tolerance or a p-value within a factor of its level: 40 sets of four
    # stacks, or 80 of a dark and a target. Of 20 sets, whose mean is off by .2 and whose spread by
    # .16 standard deviations, ln p has an error of 2.3 at four of them.
    most_further: int = 160
    unsure_p: float = 10.0
    # Repetitions of the parametric bootstrap in one run. Runs follow until as many repetitions
    # deviate as far as the measured set that p is known to a factor of 1.4 (Besag and Clifford
    # 1991), or p is half of the level.
    replicates: int = 4000
    exceedances: int = 10
    # Family-wise level of all statistics: a right sensor fails once in 100 sessions. Of the halves
    # of the measured frames, a control, once in 2000.
    level: float = 0.01
    halves_level: float = 0.0005
    # Departure over its tolerance from which on a fitted sensor is not to be trusted: tolerances of
    # purposes differ by about as much.
    far: float = 3.0
    # Sequential test (Wald 1945) of the share of further posterior draws that fail: that of sound
    # statistics, well above `level`, that of useless ones, and the likelihood ratio at which they
    # count as useless.
    sound_share: float = 0.05
    useless_share: float = 0.5
    useless_ratio: float = 1000.0
    # Relative change of a parameter in its negative control, the least one by which the numbers are
    # differentiated (their noise by rounding and by unlike Poisson draws is then 2 % of a shift of
    # five standard deviations), and probability with which an error must be found.
    control_change: float = 0.3
    least_change: float = 0.1
    # Least error that is printed over the standard deviation of the parameter's posterior: less
    # shows only if the parameters that vary with it are known.
    least_of_posterior: float = 1.0 / 3.0
    power: float = 0.8
    # Frames of a stack that are compared, of an edge more since it is cropped.
    frames: int = 8
    edge_frames: int = 16
    # Least frames of a stack: EMVA 1288 sets have pairs.
    fewest_frames: int = 2
    # Share of full scale above which a flat is outside the linear range, and share of clipped
    # pixels, of a flat and of a ring about a point source.
    highest_share: float = 0.8
    most_clipped: float = 1e-3
    # Difference of a target's stated and measured angle that is noted: half of that of a rotation
    # stage's scale of whole degrees.
    angle_deg: float = 0.5
    # Least frames and standard errors of a drift of the light within a stack: with six degrees of
    # freedom chance exceeds them once in 2000 stacks.
    drift_frames: int = 5
    drift_sd: float = 6.5

    def most_replicates(self, level: float) -> int:
        """Return the repetitions, whole runs, whose least p-value is half of a level at most."""
        return self.replicates * math.ceil(2.0 / level / self.replicates)


VALIDATION = ValidationThresholds()

# Departures that matter to no usual purpose, of all statistics and then of single ones.
TOLERANCES = (
    # A tenth of the variance, about what read noise and gain of two specimens of a type differ by.
    Tolerance(unit="% of noise", max=5.0),
    # What a good light meter is calibrated to.
    Tolerance(unit="% of level", max=1.0),
    # Twice the interval of an edge of 16 frames.
    Tolerance(unit="of MTF", max=0.03),
    # Rounding of a reading to whole DN.
    Tolerance(unit="DN", max=1.0),
    # The least veiling glare of a good lens, 1 to 3 %.
    Tolerance(unit="% of the step", max=1.0),
    # A code wider than its neighbours by a tenth.
    Tolerance(unit="% of values", max=5.0),
    # Thermal emission doubles within some 7 K.
    Tolerance(unit="% of events", max=100.0),
    # What is not twice as high as predicted is no defect among the others.
    Tolerance(unit="% of their height", max=100.0),
    # A sum over 169 lags has their noise: variances are held to less by `photon-transfer`.
    Tolerance(unit="% of noise", max=10.0, statistic="covariance"),
    # Image lag is seen from some 3 % on.
    Tolerance(unit="% of noise", max=3.0, statistic="time"),
    # Stripes, flicker, and a bend of the response are seen where a level alone is not.
    Tolerance(unit="% of level", max=0.5, statistic="fixed-pattern"),
    Tolerance(unit="% of level", max=0.5, statistic="rows-and-columns"),
    Tolerance(unit="% of level", max=0.5, statistic="linearity"),
    # Halos of two specimens of a type differ by more; rings of the same halo by a tenth.
    Tolerance(unit="% of level", max=20.0, statistic="point"),
)


@dataclass(frozen=True)
class CauseThresholds:
    """Set when a cause of a deviation is named."""

    # Relative error of the shift of a number by a simulated fault: periods, places and forms of
    # real ones differ.
    shift_error: float = 0.15
    # Alternatives that are simulated again, how often, and the largest factor of a step in size.
    refined: int = 4
    refinements: int = 2
    largest_step: float = 5.0
    # Least share of the excess of chi-squared, and odds against the likeliest, of a cause that is
    # named.
    explained: float = 0.4
    least_odds: float = 0.05


CAUSES = CauseThresholds()
