"""Figure data of signal-to-noise ratios: levels, fitted noise laws and minima of every gain."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from charact.noise.gain.series import FlatSeries
from charact.noise.snr.levels import unclipped_flats
from charact.noise.snr.minimum_illumination import LEAST_SNR, Scope
from charact.noise.snr.stated_illumination import StatedIllumination
from charact.noise.thresholds import SNR
from labdata.measurement import Measurement

Array = NDArray[np.float64]


def snr_figure_data(gains: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the figure data of all gains; the unit of light is empty if they differ."""
    units = {gain["unit"] for gain in gains}
    return {
        "figure": "snr-light",
        "least_snr": LEAST_SNR,
        "unit": units.pop() if len(units) == 1 else "",
        "gains": gains,
    }


def setting_figure_data(
    series: FlatSeries,
    words: str,
    light: StatedIllumination | str,
    response: Array | None,
    scopes: list[Scope],
    found: list[Measurement],
) -> dict[str, Any]:
    """Return levels, noise laws and minima of one gain.

    Parameters
    ----------
    series, words
        The flats, and their gain setting in words.
    light, response
        Recorded light and signal per light; without light the signal is the abscissa.
    scopes
        Pixel and area.
    found
        The measurements.
    """
    if isinstance(light, str) or response is None:
        amount, per_amount, unit = series.signal_dn, 1.0, "DN"
    else:
        amount, per_amount, unit = light.amount, float(np.median(response)), light.unit
    shown = scopes[0].levels.lit & unclipped_flats(series)
    return {
        "gain": words,
        "unit": unit,
        "label": [flat.label for flat in series.flats],
        "amount": amount[shown].tolist(),
        "fitted": series.fitted[shown].tolist(),
        "scopes": [_scope(scope, shown, amount, per_amount, found) for scope in scopes],
    }


def _scope(scope: Scope, shown: NDArray[np.bool_], amount: Array, per_amount: float, found: list[Measurement]
           ) -> dict[str, Any]:  # fmt: skip
    """Return levels, noise law and minimum of a pixel or an area."""
    least = [m for m in found if m.quantity == f"minimum_illumination{scope.suffix}" and m.value is not None]
    middle = float(np.median(scope.law.signal_at(LEAST_SNR))) / per_amount
    low = min(float(amount[shown].min(initial=np.inf)), middle if np.isfinite(middle) else np.inf) / 2.0
    grid = np.geomspace(low, 2.0 * float(amount[shown].max(initial=low)), SNR.figure_points)
    temporal = np.quantile(scope.law.snr(grid * per_amount), [0.025, 0.5, 0.975], axis=0)
    total = np.median(scope.law.snr(grid * per_amount, pattern=True), axis=0)
    return {
        "name": "area" if scope.suffix else "pixel",
        "snr": scope.levels.snr[shown].tolist(),
        "snr_sd": scope.levels.snr_sd[shown].tolist(),
        "law_amount": grid.tolist(),
        "law_low": temporal[0].tolist(),
        "law_snr": temporal[1].tolist(),
        "law_high": temporal[2].tolist(),
        "law_with_pattern": total.tolist(),
        "minimum": least[0].value if least else None,
        "minimum_interval95": list(least[0].interval95 or ()) if least else None,
    }
