"""Figure data of a noise analysis: photon transfer curve, spectrum and correlations."""

from typing import Any

import numpy as np

from charact.noise.gain.fit import Fit
from charact.noise.gain.pooled_noise import PooledNoise
from charact.noise.gain.series import FlatSeries


def transfer_figure_data(series: FlatSeries, *, gain: float | None = None, **more: Any) -> dict[str, Any]:
    """Return the photon transfer curve: signal, variance and fitted range."""
    return {
        "figure": "photon-transfer",
        "label": [flat.label for flat in series.flats],
        "mean_dn": [flat.mean_dn for flat in series.flats],
        "signal_dn": series.signal_dn.tolist(),
        "variance_dn2": [flat.variance_dn2 for flat in series.flats],
        "variance_sd_dn2": series.variance_sd_dn2.tolist(),
        "fitted": series.fitted.tolist(),
        "system_gain_dn_per_e": gain,
        "reference": series.reference,
        "variance_above_dark_dn2": series.variance_dn2.tolist(),
        "dark_mean_dn": [dark.mean_dn for dark in series.darks],
        "dark_variance_dn2": [dark.variance_dn2 for dark in series.darks],
        **more,
    }


def spectrum_figure_data(summary: PooledNoise, fit: Fit) -> dict[str, Any]:
    """Return noise power over signal against radial frequency, with its fit."""
    radius = np.hypot(summary.column_cy_per_px, summary.row_cy_per_px)
    order = np.argsort(radius)
    return {
        "figure": "noise-spectrum",
        "radius_cy_per_px": radius[order].tolist(),
        "angle_deg": np.degrees(np.arctan2(summary.row_cy_per_px, summary.column_cy_per_px))[order].tolist(),
        "power_dn": summary.power_dn[order].tolist(),
        "power_sd_dn": summary.power_sd_dn[order].tolist(),
        "model_dn": fit.model_dn[order].tolist(),
        "used": fit.used[order].tolist(),
        "variance_over_signal_dn": summary.variance_dn,
        "chi2": fit.chi2,
        "freedom": fit.freedom,
        "chance": fit.chance,
    }


def correlation_figure_data(series: FlatSeries, summary: PooledNoise) -> dict[str, Any]:
    """Return the correlation of neighbouring pixels and of successive exposures."""
    lag = summary.lag
    return {
        "figure": "autocorrelation",
        "label": [flat.label for flat in series.flats],
        "neighbour_correlation": [flat.neighbour_correlation for flat in series.flats],
        "neighbour_sd": [flat.neighbour_sd for flat in series.flats],
        "lag_exposures": lag.lag.tolist(),
        "lag_correlation": lag.correlation.tolist(),
        "lag_correlation_sd": lag.correlation_sd.tolist(),
        "lag_factor": lag.factor,
        "lag_factor_sd": lag.factor_sd,
    }
