"""The white floor of the light's noise: K, the gain per electron of the CCD, as far as the spectrum shows it.

Electrons of the CCD are counted without blur and add K mu to the power at every frequency; pulses of photoelectrons
add k F^2 mu |H|^2. The fit of both (`charact.noise.gain.model`) tells K where little of the pulses lies beyond the band
in which the spectrum is kept (`charact.noise.gain.beyond`).
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
from labdata.measurement import Posterior

Array = NDArray[np.float64]

# Power of the pulses beyond the band over that of the floor up to which the floor stands out from their form, and how
# well that form, which sampling folds, is believed there, as a share of what it says.
PULSES_SHARE = 0.3
BEYOND_BAND = 0.5
SIGNIFICANT = 3.0
# Draws of the blur that tell what it passes beyond the band.
SOME_DRAWS = 60
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


def floor_of(series: FlatSeries, posterior: Posterior, *, context: Context) -> Floor:
    """Return K from the floor where that is seen; else from the sensor; else anything the spectrum leaves room for.

    Parameters
    ----------
    series
        The flats of one gain.
    posterior
        Draws of the covariance gain, the blur and the electrons' share, see `charact.noise.gain.model`.
    context
        The sensor, seed, and whether fields are interlaced.
    """
    rng = np.random.default_rng([context.seed, 31])
    white = not has_electronic_smoothing(series, context)
    draws = posterior["power"] * posterior["electron_share"]
    if white:
        pulses = float(np.median(posterior["power"] - draws)) * _transfer_beyond(series, posterior, context)
        draws = draws + BEYOND_BAND * pulses * rng.standard_normal(len(draws))
        middle = float(np.median(draws))
        if middle > SIGNIFICANT * float(np.std(draws)) and pulses < PULSES_SHARE * middle:
            return Floor(draws=np.maximum(draws, 0.0), seen=True, source="the white floor of the noise")
    why = HIDDEN if white else FILTERED
    if context.sensor is not None:
        draws = lognormal_draws(context.sensor.video.conversion_gain_dn_per_e, rng, len(draws))
        return Floor(draws=draws, seen=False, source="the sensor's conversion gain", why_unseen=why)
    if not white:
        # A covariance that falls with the light tells no gain, and leaves no room for K.
        draws = rng.uniform(0.0, max(float(np.median(posterior["covariance_gain"])), 0.0), len(draws))
    draws = np.maximum(draws, 0.0)
    source = f"anything up to {float(np.quantile(draws, 0.975)):.2g} DN, as the spectrum leaves room for"
    return Floor(draws=draws, seen=False, source=source, why_unseen=why)


def _transfer_beyond(series: FlatSeries, posterior: Posterior, context: Context) -> float:
    """Mean of |H|^2 of the blur as fitted over the modes beyond the band."""
    row_pitch = series.flats[0].bins.row_pitch
    column, row, share = points_beyond(row_pitch)
    step = max(1, len(posterior.draws) // SOME_DRAWS)
    some = np.column_stack([posterior[name][::step] for name in NAMES])
    passed = np.minimum(transfer(some, column, row, PixelReadoutModel.of(row_pitch, context.sensor)), 1.0)
    return float(np.median(passed @ share)) / float(share.sum())


def has_analogue_chain(context: Context) -> bool:
    """Return whether electronics behind the CCD may filter along the rows, electrons and pulses alike."""
    return context.interlaced or (context.sensor is not None and not context.sensor.video.digital)


def has_electronic_smoothing(series: FlatSeries, context: Context) -> bool:
    """Return whether electronics smooth what they read, so that no noise behind them is white."""
    return has_analogue_chain(context) or any(
        dark.variance_dn2 > 0 and dark.neighbour_correlation > SMOOTH + SIGNIFICANT * dark.neighbour_sd
        for dark in series.darks
    )
