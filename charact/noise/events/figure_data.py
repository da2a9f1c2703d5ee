"""What the report draws of single photoelectrons: filtered pixels as often as they came, and the fitted law."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from charact.noise.events.filters import MIDDLE
from charact.noise.events.pulse_height_fit import PulseFit

Array = NDArray[np.float64]

# Bars across the noise, and the range drawn: from noise below to mean responses above.
NOISE_BELOW, HEIGHTS_ABOVE, BARS = 5.0, 10.0, 120
# Values of the law: a power of two, and the range they span over the range drawn, against wrap-around.
VALUES, MARGIN = 8192, 4.0


def pulse_figure_data(found: PulseFit) -> dict[str, Any]:
    """Filtered pixels as measured and as the fitted law has them, ion events, and how exponential the law is."""
    best, one = found.peak.pulses, found.observed.filters[MIDDLE]
    noise = float(np.sqrt(one.noise(best.line) * best.noise_dn2))
    low, high = -NOISE_BELOW * noise, HEIGHTS_ABOVE * found.signal_to_noise * noise
    edges = np.linspace(low, high, BARS + 1)
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
    """Probability of filtered pixels per DN under the fitted law, from its characteristic function."""
    step = MARGIN * span_dn / VALUES
    frequency = np.asarray(2.0 * np.pi * np.fft.rfftfreq(VALUES, step), np.float64)
    log = found.peak.pulses.log_characteristic(found.observed.filters[MIDDLE], frequency)
    # The sign of numpy's transform is that of exp(-i t y).
    density = np.fft.irfft(np.exp(np.conj(log)), VALUES) / step
    place = np.fft.fftfreq(VALUES, 1.0 / (VALUES * step))
    order = np.argsort(place)
    return np.interp(value, place[order], np.maximum(density[order], 0.0))
