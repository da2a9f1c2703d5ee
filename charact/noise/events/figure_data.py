"""Figure data of single photoelectrons: histogram of filtered pixels and the fitted distribution."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from charact.noise.events.filters import MIDDLE
from charact.noise.events.pulse_height_fit import PulseFit
from charact.noise.thresholds import EVENT_ACCURACY

Array = NDArray[np.float64]


def pulse_figure_data(found: PulseFit) -> dict[str, Any]:
    """Return measured and fitted distributions of filtered pixels, and the fit parameters."""
    best, one = found.peak.pulses, found.observed.filters[MIDDLE]
    noise = float(np.sqrt(one.noise(best.line) * best.noise_dn2))
    low, high = -EVENT_ACCURACY.figure_noise_sd * noise, EVENT_ACCURACY.figure_heights * found.signal_to_noise * noise
    edges = np.linspace(low, high, EVENT_ACCURACY.figure_bins + 1)
    middle = 0.5 * (edges[1:] + edges[:-1])
    value = [one.within(change, one.reach)[good[:, one.reach[0] : good.shape[1] - one.reach[0],
                                                one.reach[1] : good.shape[2] - one.reach[1]]]
             for change, good in zip(found.frames.changes, found.usable, strict=True)]  # fmt: skip
    pixels = sum(part.size for part in value)
    count = sum(np.histogram(part, edges)[0] for part in value)
    spread = found.posterior["relative_variance"]
    return {
        "figure": "pulse-heights",
        "edge_dn": edges.tolist(),
        "density_per_dn": (np.asarray(count) / pixels / np.diff(edges)).tolist(),
        "value_dn": middle.tolist(),
        "law_per_dn": _density(found, middle, float(high - low)).tolist(),
        "noise_per_dn": (np.exp(-0.5 * (middle / noise) ** 2) / noise / np.sqrt(2.0 * np.pi)).tolist(),
        "values": pixels,
        "filter_px": [one.high, one.broad],
        "response_to_mean_pulse_dn": found.signal_to_noise * noise,
        "density_per_px": best.density,
        "mean_height_dn": best.height_dn,
        "relative_variance": best.relative_variance,
        "relative_variance_sd": float(np.std(spread)),
        "spot_column_px": best.column_px,
        "spot_row_px": best.row_px,
        "glow": best.glow,
        "glow_exposures": best.glow_exposures,
        "fast_exposures": best.fast_exposures,
        "signal_to_noise": found.signal_to_noise,
        "ion_events": len(found.ion_height_dn),
        "ion_events_per_px": len(found.ion_height_dn) / sum(change.size for change in found.frames.changes),
        "ion_mean_height_dn": float(np.mean(found.ion_height_dn)) if len(found.ion_height_dn) else None,
        "chi2": found.peak.chi2,
        "freedom": found.peak.freedom,
        "chance": found.peak.chance,
    }


def _density(found: PulseFit, value: Array, span_dn: float) -> Array:
    """Return the fitted probability density of filtered pixels per DN, from its characteristic function."""
    step = EVENT_ACCURACY.figure_margin * span_dn / EVENT_ACCURACY.figure_points
    frequency = np.asarray(2.0 * np.pi * np.fft.rfftfreq(EVENT_ACCURACY.figure_points, step), np.float64)
    log = found.peak.pulses.log_characteristic(found.observed.filters[MIDDLE], frequency)
    # NumPy's transform uses exp(-i t y).
    density = np.fft.irfft(np.exp(np.conj(log)), EVENT_ACCURACY.figure_points) / step
    place = np.fft.fftfreq(EVENT_ACCURACY.figure_points, 1.0 / (EVENT_ACCURACY.figure_points * step))
    order = np.argsort(place)
    return np.interp(value, place[order], np.maximum(density[order], 0.0))
