"""White-noise floor of the scintillation noise: K, the gain per electron of the CCD.

Shot noise of CCD electrons adds K mu to the power at every frequency, blurred photoelectron pulses add k F^2 mu |H|^2.
The fit of both gives K if little of the pulses lies beyond the spectral band.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.method import Context
from charact.noise.gain.beyond import points_beyond
from charact.noise.gain.model import NAMES, transfer
from charact.noise.gain.pixel_readout_model import PixelReadoutModel
from charact.noise.gain.series import FlatSeries
from charact.noise.snr.cathode_radiometry import lognormal_draws
from charact.noise.thresholds import GAIN
from labdata.measurement import Posterior

Array = NDArray[np.float64]

HIDDEN = "no white-noise floor detected beneath the scintillation noise; take flats at low tube gain to measure K"
FILTERED = "electronics smooth the noise, so that no floor is white; K needs a readout without a low-pass filter"


@dataclass(frozen=True, kw_only=True)
class Floor:
    """Estimate of K.

    Parameters
    ----------
    draws
        Draws of K, shape (draw,), DN per electron.
    seen
        Whether the white floor is detected.
    source
        Source of the draws, in words.
    why_unseen
        Why the floor is not detected.
    """

    draws: Array
    seen: bool
    source: str
    why_unseen: str = ""


def floor_of(series: FlatSeries, posterior: Posterior, *, context: Context) -> Floor:
    """Return K from the detected floor, else from the sensor, else the range allowed by the spectrum.

    Parameters
    ----------
    series
        The flats of one setting.
    posterior
        Draws of covariance gain, blur and electron fraction, see `charact.noise.gain.model`.
    context
        Sensor, seed and interlacing.
    """
    rng = np.random.default_rng([context.seed, 31])
    white = not has_electronic_smoothing(series, context)
    draws = posterior["power"] * posterior["electron_share"]
    if white:
        pulses = float(np.median(posterior["power"] - draws)) * _transfer_beyond(series, posterior, context)
        draws = draws + GAIN.beyond_band_sd * pulses * rng.standard_normal(len(draws))
        middle = float(np.median(draws))
        if middle > GAIN.floor_sd * float(np.std(draws)) and pulses < GAIN.max_pulse_ratio * middle:
            return Floor(draws=np.maximum(draws, 0.0), seen=True, source="the white floor of the noise")
    why = HIDDEN if white else FILTERED
    if context.sensor is not None:
        draws = lognormal_draws(context.sensor.video.conversion_gain_dn_per_e, rng, len(draws))
        return Floor(draws=draws, seen=False, source="the sensor's conversion gain", why_unseen=why)
    if not white:
        # A negative covariance gain leaves no room for K.
        draws = rng.uniform(0.0, max(float(np.median(posterior["covariance_gain"])), 0.0), len(draws))
    draws = np.maximum(draws, 0.0)
    source = f"anything up to {float(np.quantile(draws, 0.975)):.2g} DN, as allowed by the spectrum"
    return Floor(draws=draws, seen=False, source=source, why_unseen=why)


def _transfer_beyond(series: FlatSeries, posterior: Posterior, context: Context) -> float:
    """Return the mean of |H|^2 of the fitted blur over the modes beyond the band."""
    row_pitch = series.flats[0].bins.row_pitch
    column, row, share = points_beyond(row_pitch)
    step = max(1, len(posterior.draws) // GAIN.floor_draws)
    some = np.column_stack([posterior[name][::step] for name in NAMES])
    passed = np.minimum(transfer(some, column, row, PixelReadoutModel.of(row_pitch, context.sensor)), 1.0)
    return float(np.median(passed @ share)) / float(share.sum())


def has_analogue_chain(context: Context) -> bool:
    """Return whether analog electronics behind the CCD may filter along the rows."""
    return context.interlaced or (context.sensor is not None and not context.sensor.video.digital)


def has_electronic_smoothing(series: FlatSeries, context: Context) -> bool:
    """Return whether electronics smooth the noise, so that it cannot be white."""
    return has_analogue_chain(context) or any(
        dark.variance_dn2 > 0
        and dark.neighbour_correlation > GAIN.smoothed_correlation + GAIN.floor_sd * dark.neighbour_sd
        for dark in series.darks
    )
