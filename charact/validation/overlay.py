"""What a report draws of a validation: measured and simulated curves with the simulation's 95 % band, and pictures."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from charact.validation import flats, mtf_features
from charact.validation.frame_features import FrameFeatures
from charact.validation.frames import MatchedStacks
from charact.validation.validation_result import FramePair

Array = NDArray[np.float64]

BINS = 40
# Shares of the pixels shown black and white.
STRETCH = (0.002, 0.998)


def overlays(
    measured: FrameFeatures, simulated: list[FrameFeatures], chosen: MatchedStacks
) -> dict[str, dict[str, Any]]:
    """Return the overlays by name, JSON-ready."""
    out = {
        "photon-transfer": _transfer("variance_dn2", "Temporal variance, DN²", measured, simulated),
        "covariance": _transfer("covariance_dn2", "Covariance sum within 6 px, DN²", measured, simulated),
        "autocorrelation": {
            "title": "Correlation of neighbouring pixels",
            "x_title": "lag, px",
            "y_title": "correlation",
            "x": list(flats.LAG_NAMES),
            **_band(measured.correlation.value, np.array([one.correlation.value for one in simulated])),
        },
        "histogram": _histogram(measured, simulated, chosen),
    }
    curves = [one.mtf.value for one in simulated if one.mtf is not None]
    if measured.mtf is not None and curves:
        out["mtf"] = {
            "title": "MTF of the edge, both by the same method",
            "x_title": "frequency, cy/px",
            "y_title": "MTF",
            "x": mtf_features.FREQUENCY_CY_PER_PX.tolist(),
            **_band(measured.mtf.value, np.array(curves)),
            "measured_sd": np.sqrt(np.diag(measured.mtf.covariance)).tolist(),
        }
    return out


def pairs(chosen: MatchedStacks, simulated: dict[str, NDArray]) -> tuple[FramePair, ...]:
    """Return the first frame of each stack, measured and simulated, under one stretch."""
    shots = (chosen.flats[-1], *((chosen.edge,) if chosen.edge else ()), *chosen.others)
    out = []
    for shot in shots:
        both = [np.asarray(frames[shot.label][0], float) for frames in (chosen.measured, simulated)]
        low, high = np.quantile(np.concatenate([one.ravel() for one in both]), STRETCH)
        high = max(high, low + 1.0)
        shown = [np.rint(255 * np.clip((one - low) / (high - low), 0, 1)).astype(np.uint8) for one in both]
        out.append(
            FramePair(
                kind=shot.kind,
                label=shot.label,
                measured=shown[0],
                simulated=shown[1],
                low_dn=float(low),
                high_dn=float(high),
            )
        )
    return tuple(out)


def _band(measured: Array, simulated: Array) -> dict[str, list[float]]:
    """Return measured values beside the mean and the 95 % band of simulated ones (draw, k)."""
    centre, sd = simulated.mean(axis=0), simulated.std(axis=0, ddof=1)
    return {
        "measured": measured.tolist(),
        "simulated": centre.tolist(),
        "low95": (centre - 1.96 * sd).tolist(),
        "high95": (centre + 1.96 * sd).tolist(),
    }


def _transfer(field: str, title: str, measured: FrameFeatures, simulated: list[FrameFeatures]) -> dict[str, Any]:
    return {
        "title": title,
        "x_title": "signal, DN",
        "y_title": title,
        "x": measured.mean_dn.tolist(),
        "x_simulated": np.mean([one.mean_dn for one in simulated], axis=0).tolist(),
        **_band(getattr(measured, field), np.array([getattr(one, field) for one in simulated])),
    }


def _histogram(measured: FrameFeatures, simulated: list[FrameFeatures], chosen: MatchedStacks) -> dict[str, Any]:
    top = float(np.abs(measured.grey_dn).max())
    edges = np.linspace(-top, top, BINS + 1)

    def density(sample: Array) -> Array:
        return np.histogram(sample, edges)[0] / (sample.size * np.diff(edges))

    return {
        "title": f"Grey levels of {chosen.flats[-1].label} about their mean",
        "x_title": "grey level less the mean, DN",
        "y_title": "density, 1/DN",
        "x": ((edges[1:] + edges[:-1]) / 2).tolist(),
        **_band(density(measured.grey_dn), np.array([density(one.grey_dn) for one in simulated])),
    }
