"""Feasibility of a gain measurement, and the refusals where there is none."""

from typing import Any

import numpy as np

from charact.noise.checks import dark_findings
from charact.noise.findings import flags_of, notes_of
from charact.noise.gain.series import FlatSeries, without_noise
from charact.noise.quantities import dark_quantities
from labdata.measurement import Measurement, make_refusal


def gain_obstacle(series: FlatSeries) -> str | None:
    """Return why a series cannot give a gain, or None."""
    if not len(series.flats):
        return "flats need at least two frames each, and darks or a second level as reference"
    error = np.array([np.sqrt(f.variance_dn2 / (f.pixels * f.frames)) + 1e-12 for f in series.flats])
    brighter = series.signal_dn > 5.0 * np.sqrt(50.0) * error
    if not brighter.any():
        return f"no flat is brighter than its dark: the largest difference is {series.signal_dn.max():.3g} DN"
    noisier = series.variance_dn2 > 5.0 * series.variance_sd_dn2
    if not (brighter & noisier).any():
        return f"no flat is noisier than its dark: the largest difference is {series.variance_dn2.max():.3g} DN2"
    if not (series.fitted & brighter & noisier).any():
        return "every flat is saturated: none lies within 70 % of saturation and below full scale"
    return None


def without_flats(
    darks, series: FlatSeries | None, single: list[str], *, quantity=("system_gain", "DN/e-"), **fields: Any
) -> list[Measurement]:
    """Return the quantities of darks alone, and the refusal of the gain."""
    if series is not None:
        reason = "; ".join(part for part in (gain_obstacle(series), without_noise(series.single)) if part)
    elif single:
        reason = f"noise needs stacks of at least two frames; {', '.join(single)} has one"
    else:
        reason = "there are no flats"
    out = [make_refusal(quantity[0], quantity[1], reason, **fields)]
    wrong = [] if series is None or not len(series.flats) else dark_findings(series)
    dark = dark_quantities(tuple(darks), flags=(), **fields) if darks else []
    notes = notes_of(wrong)
    return out + [one.with_(flags=flags_of(wrong), notes=(*one.notes, *notes)) for one in dark]
