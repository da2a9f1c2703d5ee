"""What the report draws of single photoelectrons: heights of the events found, and the law that was fitted."""

from typing import Any

import numpy as np

from charact.noise.events_pulses import PulseFit

BARS = 40


def pulse_evidence(found: PulseFit) -> dict[str, Any]:
    """Heights of the events found one by one, the fitted law, ion events, and how exponential the law is."""
    best, events = found.peak.pulses, found.events
    top = float(events.height_dn.max()) if len(events.height_dn) else events.threshold_dn + 1.0
    edges = np.linspace(events.threshold_dn, max(top, 1.01 * events.threshold_dn), BARS + 1)
    spread = found.posterior["relative_variance"]
    return {
        "figure": "pulse-heights",
        "edge_dn": edges.tolist(),
        "count": np.histogram(events.height_dn, edges)[0].tolist(),
        "searched_pixels": events.pixels,
        "recurring_share": events.again,
        "density_per_px": best.density,
        "mean_height_dn": best.height_dn,
        "relative_variance": best.relative_variance,
        "relative_variance_sd": float(np.std(spread)),
        # Density of the posterior over that of its flat prior where heights are exponential (Savage and Dickey).
        "log_evidence_of_exponential": _log_evidence(spread, 1.0),
        "spot_column_px": best.column_px,
        "spot_row_px": best.row_px,
        "glow": best.glow,
        "glow_exposures": best.glow_exposures,
        "signal_to_noise": found.signal_to_noise,
        "events_per_spot": found.crowding,
        "ion_events": len(found.ion_height_dn),
        "ion_events_per_px": len(found.ion_height_dn) / max(events.pixels, 1),
        "ion_mean_height_dn": float(np.mean(found.ion_height_dn)) if len(found.ion_height_dn) else None,
        "chi2": found.peak.chi2,
        "freedom": found.peak.freedom,
        "chance": found.peak.chance,
    }


def _log_evidence(draws, value: float) -> float:
    """Logarithm of the Bayes factor of one value of the relative variance against all of them."""
    from charact.noise.events_fit import BOUNDS

    low, high = BOUNDS["relative_variance"]
    middle, sd = float(np.mean(draws)), float(np.std(draws))
    return float(np.log(high - low) - np.log(sd * np.sqrt(2.0 * np.pi)) - 0.5 * ((value - middle) / sd) ** 2)
