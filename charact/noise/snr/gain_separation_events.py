"""Separation of k and F^2 with single photoelectrons of dark frames."""

from collections import Counter
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from charact.method import Context
from charact.noise.gain.series import gain_of
from charact.noise.snr.cathode_radiometry import lognormal_draws
from charact.noise.snr.gain_separation import posterior_of
from charact.noise.snr.tube_snr import snr_from_specification
from charact.noise.thresholds import SNR
from labdata.measurement import Measurement, Result, measurement_from_draws
from labdata.session import Session

Array = NDArray[np.float64]


def add_event_gains(result: Result, session: Session, *, context: Context) -> Result:
    """Return the result with k and F^2 from flats, light and pulses, if pulses were measured at the same gain.

    Parameters
    ----------
    result
        `pulse_gain` of the flats and `detected_photoelectron_gain` of a dark stack, with their posteriors; without
        either it is returned unchanged.
    session
        The session, with the gain of the dark stack.
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
    """Return whether a dark stack was taken at the gain of most flats."""
    (most, _), *_ = Counter(gain_of(entry.conditions) for entry in session.of_kind("flat")).most_common()
    here = [gain_of(entry.conditions) for entry in session.of_kind("dark") if entry.label == dark.stack]
    return most in here


def _event_gains(result: Result, flats: Measurement, darks: Measurement, context: Context) -> list[Measurement]:
    """Return k and F^2, and the tube's signal-to-noise ratio."""
    from charact.noise.events.event_measurements import detection

    assert flats.posterior is not None and darks.posterior is not None
    rng = np.random.default_rng([context.seed, 41])
    pulses = rng.choice(flats.posterior["pulse_gain"], SNR.separation_draws)
    height = rng.choice(darks.posterior["height_dn"], SNR.separation_draws)
    share, note = detection(context, rng, SNR.separation_draws)
    gain, agreement = _gain(result, flats.method, height, share, rng)
    flags = tuple(dict.fromkeys((*flats.flags, *darks.flags)))
    fields = {"method": f"{flats.method} + {darks.method}", "provenance": flats.provenance}
    out = [measurement_from_draws("pulse_height_factor", "1", pulses / height, flags=flags, **fields)]
    flags += ("model-misfit",) if agreement < SNR.min_agreement else ()
    notes = (note, "from the light and single photoelectrons" if agreement < 1.0 else
             "from single photoelectrons of the dark frames")  # fmt: skip
    kept = posterior_of("photoelectron_gain", "DN/pe", gain, context.seed)
    out.append(
        measurement_from_draws("photoelectron_gain", "DN/pe", gain, flags=flags, notes=notes, posterior=kept, **fields)
    )
    factor = pulses / gain
    out.append(measurement_from_draws("excess_noise_factor", "1", factor, flags=flags, notes=notes, **fields))
    if context.sensor is not None:
        sensitivity = lognormal_draws(
            context.sensor.photocathode.luminous_sensitivity_ua_per_lm, rng, SNR.separation_draws
        )
        told = (*notes, "luminous sensitivity from the sensor description")
        out.append(
            measurement_from_draws(
                "tube_snr", "1", snr_from_specification(sensitivity, factor), flags=flags, notes=told, **fields
            )
        )
    return out


def _gain(result: Result, method: str, height: Array, share: Array, rng: np.random.Generator) -> tuple[Array, float]:
    """Return draws of k, and the effective fraction consistent with light and pulses; 1 without a known light."""
    lit = [one for one in result.find("photoelectron_gain", method=method) if one.posterior is not None]
    if not lit or lit[0].posterior is None:
        return share * height, 1.0
    gain = rng.choice(lit[0].posterior["photoelectron_gain"], SNR.separation_draws)
    density, edges = np.histogram(np.log(share), bins=SNR.bins, density=True)
    place = np.searchsorted(edges, np.log(gain / height)) - 1
    inside = (place >= 0) & (place < SNR.bins)
    weight = np.where(inside, density[np.clip(place, 0, SNR.bins - 1)], 0.0)
    if not weight.any():
        return gain, 0.0
    agreement = float(weight.sum() ** 2 / (weight**2).sum() / SNR.separation_draws)
    return gain[rng.choice(SNR.separation_draws, SNR.separation_draws, p=weight / weight.sum())], min(agreement, 0.999)
