"""The least error that a covariance gain can have, read from the noise spectra of one flat and one dark.

What is known. A flat of T frames and a dark of as many give, in every bin of spatial frequency, m independent modes of
each frame, complex normal numbers whose mean over the frames was taken away. Their covariance in time is

    C = (s + d) P + s r1 P T1 P + s r2 P T2 P,  P = 1 - 1/T,  Tk: 1 at k frames apart,

with s the power of the light's noise, d that of the dark's and r1, r2 the correlations of frames one and two apart,
which are 0 here and unknown to the estimator. ln s is a function of the bin's frequency and of six parameters: power at
frequency 0, the widths of the blur along rows and columns, strength and exponent of its wings, the electrons' share.
Normal modes of covariance C tell of two parameters a and b I_ab = m tr(C^-1 dC/da C^-1 dC/db), which is m w times

    (T - 1) s_a s_b between two of the six,  t_k s_a with rk,  t_kl between rk and rl,  w = s^2 / ((s + d)^2 + d^2),

where s_a = d ln s / da, t_k = tr(P Tk), t_kl = tr(P Tk P Tl); d^2 is the price of a dark that is free in every bin.
Information of bins and priors adds up. The gain is s(0) (1 + 2 r1 + 2 r2): its least relative variance is that of
ln s(0) + 2 r1 + 2 r2 under the inverse of I (Cramer and Rao; van Trees with the priors).

What no mode tells. The gain is a mean square of pulse heights g over a mean of them; N pulses of unequal heights
scatter it by (<g^4>/<g^2>^2 + <g^2>/<g>^2 - 2 <g^3>/(<g^2><g>)) / N, however many modes there are (Campbell's theorem).
"""

from math import prod

import numpy as np
from numpy.typing import NDArray

from charact.noise.gain.model import REFERENCE_CY_PER_PX
from charact.noise.stack.spectrum import bins_of
from charact.study.flats.pulse_frames import PulseScene

Array = NDArray[np.float64]

# What the estimator takes for granted before it looks: standard deviations of the exponent and of the electrons' share.
EXPONENT_SD, ELECTRON_SHARE_SD = 0.2, 0.01
# Exponent of wings whose strength is 0.
EXPONENT = 1.3
# Correlations in time that the estimator leaves free.
LAGS = (1, 2)


def least_relative_sd(scene: PulseScene) -> float:
    """Return the least standard deviation of the covariance gain over the covariance gain.

    Parameters
    ----------
    scene
        The light, the camera and the number of frames of the flat and of its dark.
    """
    bins = bins_of(scene.rows, scene.cols, 1.0)
    slopes, light, dark = _spectrum(scene, bins.column_cy_per_px, bins.row_cy_per_px)
    weight = bins.modes * bins.efficiency * light**2 / ((light + dark) ** 2 + dark**2)
    information = _information(slopes, weight, scene.frames)
    information[4, 4] += EXPONENT_SD**-2
    information[5, 5] += ELECTRON_SHARE_SD**-2
    of_gain = np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 2.0, 2.0])
    return float(np.sqrt(of_gain @ np.linalg.solve(information, of_gain) + heights_variance(scene)))


def heights_variance(scene: PulseScene) -> float:
    """Return the relative variance that unequal pulse heights give the gain."""
    shape = 1.0 / (scene.excess_noise_factor - 1.0)
    moments = [prod(shape + j for j in range(n)) / shape**n for n in range(5)]
    count = scene.photoelectrons * scene.rows * scene.cols * scene.frames
    return (moments[4] / moments[2] ** 2 + moments[2] - 2.0 * moments[3] / moments[2]) / count


def _spectrum(scene: PulseScene, column: Array, row: Array) -> tuple[Array, Array, float]:
    """Slopes of ln s along the six parameters, shape (parameter, bin), s and d, DN^2."""
    share = scene.electron_gain_dn / scene.covariance_gain_dn
    x, y = column / REFERENCE_CY_PER_PX, row / REFERENCE_CY_PER_PX
    pixel = (np.sinc(column) * np.sinc(row)) ** 2 if scene.blur_px else np.ones_like(x)
    blurred = pixel * np.exp(-((2.0 * np.pi * scene.blur_px * REFERENCE_CY_PER_PX) ** 2) * (x**2 + y**2))
    power = (1.0 - share) * blurred + share
    of_blur = (1.0 - share) * blurred / power
    slopes = np.array([
        np.ones_like(x), -(x**2) * of_blur, -(y**2) * of_blur, (x**2 + y**2 - np.hypot(x, y) ** EXPONENT) * of_blur,
        np.zeros_like(x), (1.0 - blurred) / power,
    ])  # fmt: skip
    signal = scene.photoelectrons * scene.photoelectron_gain_dn
    return slopes, scene.covariance_gain_dn * signal * power, scene.read_noise_dn**2 + 1.0 / 12.0


def _information(slopes: Array, weight: Array, frames: int) -> Array:
    """Fisher information of the parameters of the spectrum and of the correlations in time."""
    centred = np.eye(frames) - 1.0 / frames
    apart = np.abs(np.subtract.outer(np.arange(frames), np.arange(frames)))
    later = [centred @ (apart == lag) @ centred for lag in LAGS]
    count = len(slopes)
    out = np.zeros((count + len(LAGS),) * 2)
    out[:count, :count] = (frames - 1) * slopes * weight @ slopes.T
    for i, one in enumerate(later):
        out[count + i, :count] = out[:count, count + i] = np.trace(one) * (slopes @ weight)
        out[count + i, count:] = [np.trace(one @ other) * weight.sum() for other in later]
    return out
