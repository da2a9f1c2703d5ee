"""What single photoelectrons of dark frames add to flats: their height k/p parts k from F^2 without a known light.

Flats give k F^2, dark frames h = k/p, and so p F^2 = k F^2 / h, one plus the relative variance of the heights, with no
more. The share p of the photoelectrons that start a pulse is known within the bounds of the tube's sheet, and gives k =
p h and F^2; where a known light gives k as well, both speak, and p is narrowed.
"""

from collections import Counter
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from charact.method import Context
from charact.noise.gain.series import gain_of
from charact.noise.snr.cathode_radiometry import lognormal_draws
from charact.noise.snr.gain_separation import posterior_of
from charact.noise.snr.tube_snr import snr_from_specification
from labdata.measurement import Measurement, Result, measurement_from_draws
from labdata.session import Session

Array = NDArray[np.float64]

DRAWS = 4000
# Effective share of the draws below which light and pulses contradict each other.
LEAST_AGREEMENT = 0.01
BINS = 24


def add_event_gains(result: Result, session: Session, *, context: Context) -> Result:
    """Return the result with k and F^2 from flats, light and pulses together, where there are pulses at their gain.

    Parameters
    ----------
    result
        `pulse_gain` of the flats and `detected_photoelectron_gain` of a dark stack, with their posteriors; without
        either it is returned as it is.
    session
        Tells at which gain the dark stack was taken.
    context
        The sensor, and the seed.
    """
    flats = [one for one in result.find("pulse_gain") if one.posterior is not None]
    darks = [one for one in result.find("detected_photoelectron_gain") if one.posterior is not None]
    if not flats or not darks or not _same_gain(session, darks[0]):
        return result
    parted = _event_gains(result, flats[0], darks[0], context)
    better = {one.quantity for one in result.find("tube_snr") if one.value is not None}
    new = tuple(one for one in parted if one.quantity not in better)
    named = {one.quantity for one in new}
    return replace(result, measurements=(*(one for one in result.measurements if one.quantity not in named), *new))


def _same_gain(session: Session, dark: Measurement) -> bool:
    """Whether a dark stack was taken at the gain of most flats."""
    (most, _), *_ = Counter(gain_of(entry.conditions) for entry in session.of_kind("flat")).most_common()
    here = [gain_of(entry.conditions) for entry in session.of_kind("dark") if entry.label == dark.stack]
    return most in here


def _event_gains(result: Result, flats: Measurement, darks: Measurement, context: Context) -> list[Measurement]:
    """p F^2, k and F^2, and the tube's ratio."""
    from charact.noise.events.event_measurements import detection

    assert flats.posterior is not None and darks.posterior is not None
    rng = np.random.default_rng([context.seed, 41])
    pulses = rng.choice(flats.posterior["pulse_gain"], DRAWS)
    height = rng.choice(darks.posterior["height_dn"], DRAWS)
    share, note = detection(context, rng, DRAWS)
    gain, agreement = _gain(result, flats.method, height, share, rng)
    flags = tuple(dict.fromkeys((*flats.flags, *darks.flags)))
    fields = {"method": f"{flats.method} + {darks.method}", "provenance": flats.provenance}
    out = [measurement_from_draws("pulse_height_factor", "1", pulses / height, flags=flags, **fields)]
    flags += ("model-misfit",) if agreement < LEAST_AGREEMENT else ()
    notes = (note, "from the light and from single photoelectrons together" if agreement < 1.0 else
             "from single photoelectrons of the dark frames")  # fmt: skip
    kept = posterior_of("photoelectron_gain", "DN/pe", gain, context.seed)
    out.append(
        measurement_from_draws("photoelectron_gain", "DN/pe", gain, flags=flags, notes=notes, posterior=kept, **fields)
    )
    factor = pulses / gain
    out.append(measurement_from_draws("excess_noise_factor", "1", factor, flags=flags, notes=notes, **fields))
    if context.sensor is not None:
        sensitivity = lognormal_draws(context.sensor.photocathode.luminous_sensitivity_ua_per_lm, rng, DRAWS)
        told = (*notes, "luminous sensitivity is the sensor's")
        out.append(
            measurement_from_draws(
                "tube_snr", "1", snr_from_specification(sensitivity, factor), flags=flags, notes=told, **fields
            )
        )
    return out


def _gain(result: Result, method: str, height: Array, share: Array, rng: np.random.Generator) -> tuple[Array, float]:
    """Draws of k, and the effective share of them that light and pulses agree on; 1 where there is no known light."""
    lit = [one for one in result.find("photoelectron_gain", method=method) if one.posterior is not None]
    if not lit or lit[0].posterior is None:
        return share * height, 1.0
    gain = rng.choice(lit[0].posterior["photoelectron_gain"], DRAWS)
    density, edges = np.histogram(np.log(share), bins=BINS, density=True)
    place = np.searchsorted(edges, np.log(gain / height)) - 1
    inside = (place >= 0) & (place < BINS)
    weight = np.where(inside, density[np.clip(place, 0, BINS - 1)], 0.0)
    if not weight.any():
        return gain, 0.0
    agreement = float(weight.sum() ** 2 / (weight**2).sum() / DRAWS)
    return gain[rng.choice(DRAWS, DRAWS, p=weight / weight.sum())], min(agreement, 0.999)
