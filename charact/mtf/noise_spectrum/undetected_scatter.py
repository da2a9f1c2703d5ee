"""How much light may be scattered after the gain without showing in the noise of flats.

The power of the noise is known up to a factor, and not at frequency 0: light that is spread widely lowers it only where
nothing is measured. What does not show is not counted, so that the transfer is that of all other light.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from charact.mtf.blur_models.transfer import glare
from charact.mtf.curve import FINE, crossing_frequency
from charact.mtf.noise_spectrum.aliasing import PostGainBlur
from charact.mtf.noise_spectrum.model import (
    SCATTER_FRACTION,
    SCATTER_PX,
    SCATTER_SHARE,
    SpectrumLikelihood,
    SpectrumOptimum,
)
from charact.mtf.noise_spectrum.result import transfer_of

Array = NDArray[np.float64]

# Gain in ln likelihood at which scattered light is told for sure: 5 is asked for, and the gain itself has a standard
# deviation of 5.
SURE = 12.0
# Small steps for slopes: of a share, and in standard deviations.
SHARE_STEP, STEP_SD = 1e-3, 0.05


@dataclass(frozen=True, kw_only=True)
class UndetectedComponent:
    """A form of the transfer of which a share of the light is scattered over a length, px."""

    shape: PostGainBlur
    share: float
    length_px: float

    @property
    def bounds(self) -> Array:
        """Bounds of the form's own parameters."""
        return self.shape.bounds

    def modulus(self, theta: Array, frequency: Array) -> Array:
        """Return the transfer, shape (n, parameter) and (f,) or (n, f) -> (n, f)."""
        veil = glare(frequency, np.array(self.length_px))
        return self.shape.modulus(theta, frequency) * (1.0 - self.share + self.share * veil)


@dataclass(frozen=True, kw_only=True)
class UndetectedScatter:
    """Scattered light that would not be told for sure.

    Parameters
    ----------
    length_px
        How far it is scattered, px.
    share
        Largest share of all light.
    lower_percent
        By how much MTF50 along rows would be lower if it were counted, percent.
    """

    length_px: float
    share: float
    lower_percent: float


def note(peak: SpectrumOptimum) -> str:
    """Return the sentence that says what would go unseen."""
    near, far = scatter_limits(peak)
    return (
        f"normalised to light that is not scattered far: {100 * near.share:.2g} % of it scattered after the gain over "
        f"{near.length_px:.2g} px, or {100 * far.share:.2g} % over {far.length_px:.2g} px, would not show for sure; "
        f"counted, MTF50 would be {near.lower_percent:.2g} % or {far.lower_percent:.2g} % lower"
    )


def scatter_limits(peak: SpectrumOptimum) -> tuple[UndetectedScatter, UndetectedScatter]:
    """Return what would go unseen of light scattered over the shortest and the longest length that are looked at.

    Notes
    -----
    A share q of scattered light changes ln of the power by q d, of which the form takes up what its parameters can.
    What is left tells q with information I, so that q = sqrt(2 S / I) gains S in ln likelihood. MTF50 is wrong by the
    slope of the true one with q less that of the fitted one.
    """
    longest = max(SCATTER_SHARE * peak.problem.spectrum.shorter_px, 2.0 * SCATTER_PX)
    slopes = _Jacobians(peak)
    return slopes.limit_at(SCATTER_PX), slopes.limit_at(longest)


class _Jacobians:
    """Slopes of ln of the power and of MTF50 with a form's parameters, at its peak."""

    def __init__(self, peak: SpectrumOptimum) -> None:
        self.peak, problem = peak, peak.problem
        low, high = problem.bounds.T
        sd = np.minimum(np.sqrt(np.maximum(np.diag(peak.covariance), 1e-30)), 0.2 * (high - low))
        up = np.minimum(peak.point + np.diag(STEP_SD * sd), high)
        down = np.maximum(peak.point - np.diag(STEP_SD * sd), low)
        change = np.diag(up - down)
        self.power = problem.model(peak.point[None])[0]
        self.of_power = (np.log(problem.model(up)) - np.log(problem.model(down))) / change[:, None]
        self.of_half = (_mtf50(peak, up) - _mtf50(peak, down)) / change
        # A parameter is somewhere within its bounds, whatever the data.
        self.normal = (self.of_power * problem.looks) @ self.of_power.T + np.diag(12.0 / (high - low) ** 2)

    def limit_at(self, length_px: float) -> UndetectedScatter:
        """Return what would go unseen of light scattered over a length."""
        looks, at = self.peak.problem.looks, self.peak.point[None]
        there = replace(self.peak, problem=_with_scatter(self.peak.problem, length_px))
        away = (there.problem.model(at)[0] / self.power - 1.0) / SHARE_STEP
        pull = self.of_power @ (looks * away)
        taken_up = np.linalg.solve(self.normal, pull)
        information = max(float(looks @ away**2 - pull @ taken_up), 1e-9)
        share = min(float(np.sqrt(2.0 * SURE / information)), SCATTER_FRACTION[1])
        half = _mtf50(self.peak, at)
        lower = ((half - _mtf50(there, at)) / SHARE_STEP + self.of_half @ taken_up) / half
        return UndetectedScatter(
            length_px=length_px, share=share, lower_percent=max(100.0 * share * float(lower[0]), 0.0)
        )


def _with_scatter(problem: SpectrumLikelihood, length_px: float) -> SpectrumLikelihood:
    shape: Any = UndetectedComponent(shape=problem.shape, share=SHARE_STEP, length_px=length_px)
    return replace(problem, shape=shape)


def _mtf50(peak: SpectrumOptimum, points: Array) -> Array:
    """MTF50 along rows at points (n, parameter), cy/px, shape (n,)."""
    ratio = peak.problem.spectrum.pitch_ratio
    return crossing_frequency(FINE, transfer_of(peak, points, FINE, vertical=False, pitch_ratio=ratio), 0.5)
