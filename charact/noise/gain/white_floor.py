"""The white floor of the light's noise: K, the gain per electron of the CCD, as far as the spectrum shows it.

Electrons of the CCD are counted without blur and add K mu to the power at every frequency; pulses of photoelectrons
add k F^2 mu |H|^2. Beyond the band in which the spectrum is kept, the variance of a pixel tells the mean power left:
K lies between none and all of it, and is that power where next to nothing of the pulses reaches so far.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.method import Context
from charact.noise.gain.model import transfer
from charact.noise.gain.reading import Reading
from charact.noise.gain.series import Series
from charact.noise.light.area import shares_of
from charact.noise.light.calibrated import drawn
from charact.noise.stack.level import Level, Spectrum
from charact.noise.stack.spectrum import BAND_CY_PER_PX
from labdata.measurement import Posterior

Array = NDArray[np.float64]

# Share of the power beyond the band that the pulses may have there at most for the rest to count as the floor, and how
# well the form fitted within the band is believed beyond it, as a share of what it says.
PULSES_SHARE = 0.3
BEYOND_BAND = 0.5
SIGNIFICANT = 3.0
# Correlation of neighbours in the darks above which the electronics smooth, and no floor is white.
SMOOTH = 0.03
# Spread of the shots of K over the covariance gain beyond which pulses and electrons are not told apart.
WIDEST_SHARE = 0.1
HIDDEN = "no white floor stands out under the blurred noise of the pulses: flats with the tube's gain down would show K"
FILTERED = "electronics smooth what they read, so that no floor is white: the charge of a CCD read without them shows K"


@dataclass(frozen=True, kw_only=True)
class Floor:
    """What is known of K.

    Parameters
    ----------
    draws
        Draws of K, shape (draw,), DN per electron.
    seen
        Whether the spectrum shows it.
    source
        Where the draws come from, in words.
    why_unseen
        Why the spectrum does not show it, where it does not.
    """

    draws: Array
    seen: bool
    source: str
    why_unseen: str = ""


def floor_of(series: Series, posterior: Posterior, *, context: Context) -> Floor:
    """Return K from the floor where that is seen; else from the sensor; else anything the spectrum leaves room for.

    Parameters
    ----------
    series
        The flats of one gain.
    posterior
        Draws of the covariance gain and of the blur, see `charact.noise.gain.model`.
    context
        The sensor, seed, and whether fields are interlaced.
    """
    rng = np.random.default_rng([context.seed, 31])
    count = len(posterior.draws)
    power, sd = power_beyond(series)
    share = 1.0 - posterior["electron_share"]
    pulses = float(np.median(posterior["power"] * share)) * _transfer_beyond(series, posterior, context)
    white = not _smoothed(series, context)
    error = float(np.hypot(sd, BEYOND_BAND * pulses))
    if white and power > SIGNIFICANT * sd and pulses < PULSES_SHARE * power and power - pulses > SIGNIFICANT * error:
        draws = np.maximum(power - pulses + error * rng.standard_normal(count), 0.0)
        return Floor(draws=draws, seen=True, source="the white floor of the noise")
    why = HIDDEN if white else FILTERED
    if context.sensor is not None:
        draws = drawn(context.sensor.video.conversion_gain_dn_per_e, rng, count)
        return Floor(draws=draws, seen=False, source="the sensor's conversion gain", why_unseen=why)
    # A covariance that falls with the light tells no gain, and leaves no room for K.
    most = max(power, 0.0) + 2.0 * sd if white else max(float(np.median(posterior["covariance_gain"])), 0.0)
    source = f"anything from none to {most:.2g} DN, the power left at high frequency"
    return Floor(draws=rng.uniform(0.0, most, count), seen=False, source=source, why_unseen=why)


def power_beyond(series: Series) -> tuple[float, float]:
    """Return the mean power of the light's noise over the signal beyond the band, and its standard error, DN."""
    shares = shares_of(series.flats[0].bins).modes
    rest = 1.0 - shares.sum()

    def of(level: Level) -> tuple[float, float]:
        spectrum: Spectrum = level.few
        inside = shares * spectrum.power_dn2[:, 0]
        exposures = level.runs * max(1, len(level.time) - 1)
        noise = np.sqrt(np.sum(inside**2 / (level.bins.modes * level.bins.efficiency * exposures)))
        value = (spectrum.variance_dn2 - inside.sum()) / rest
        return float(value), float(np.hypot(level.variance_sd_dn2, noise)) / rest

    chosen = np.flatnonzero(series.fitted)
    flats = np.array([of(series.flats[i]) for i in chosen])
    darks = np.array([of(series.darks[i]) for i in chosen])
    signal = series.signal_dn[chosen]
    value, sd = (flats[:, 0] - darks[:, 0]) / signal, np.hypot(flats[:, 1], darks[:, 1]) / signal
    weight = 1.0 / np.maximum(sd, 1e-12) ** 2
    mean = float(weight @ value / weight.sum())
    excess = float(weight @ (value - mean) ** 2) / max(1, len(value) - 1)
    return mean, float(np.sqrt(max(1.0, excess) / weight.sum()))


def _transfer_beyond(series: Series, posterior: Posterior, context: Context) -> float:
    """Mean of |H|^2 of the blur as fitted over the modes beyond the band."""
    bins = series.flats[0].bins
    rows, cols = bins.window.shape
    y = np.repeat(np.abs(np.fft.fftfreq(rows)) / bins.row_pitch, cols // 2 + 1).astype(float)
    x = np.tile(np.fft.rfftfreq(cols), rows).astype(float)
    beyond = np.hypot(y, x) >= BAND_CY_PER_PX
    names = ("power", "fall_columns", "fall_rows", "strength", "exponent")
    middle = np.median(np.column_stack([posterior[name] for name in names]), axis=0)
    reading = Reading.of(bins.row_pitch, context.sensor)
    return float(np.minimum(transfer(middle[None], x[beyond], y[beyond], reading), 1.0).mean())


def _smoothed(series: Series, context: Context) -> bool:
    """Whether electronics smooth what they read, so that no noise behind them is white."""
    analogue = context.interlaced or (context.sensor is not None and not context.sensor.video.digital)
    return analogue or any(
        dark.variance_dn2 > 0 and dark.neighbour_correlation > SMOOTH + SIGNIFICANT * dark.neighbour_sd
        for dark in series.darks
    )
