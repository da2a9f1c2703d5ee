"""Patterns other than row, column and pixel noise: shading, unseparated fields."""

import numpy as np

from charact.noise.cube.contrasts import Contrasts
from charact.noise.cube.mean_squares import ROW, TIME, shading, subtract_means
from charact.noise.findings import Finding
from charact.noise.thresholds import CUBE


def shading_findings(found: Contrasts) -> list[Finding]:
    """Return the note on the removed smooth shading."""
    image = found.by_pixel[:, 0] / np.sqrt(found.size[0])
    rows, cols = (np.column_stack([np.full(n, n**-0.5), shading(n)]) for n in found.size[1:])
    smooth = rows.T @ image @ cols
    smooth[:, 0, 0] = 0.0
    rms = float(np.sqrt(np.sum(smooth**2) / image.size))
    return [(None, f"excludes smooth shading up to fourth order along rows and columns, {rms:.3g} DN rms")]


def row_parity_findings(found: Contrasts, *, fixed: bool) -> list[Finding]:
    """Return the finding of different even and odd rows: fields not separated."""
    rows = subtract_means(found.by_row[..., :1], (TIME, ROW), fixed=False)
    if fixed:
        rows = subtract_means(found.by_row[..., :1].mean(axis=1, keepdims=True), (ROW,), fixed=True)
    sign = (-1.0) ** np.arange(rows.shape[2]) / np.sqrt(rows.shape[2])
    alternating = np.einsum("ftvx,v->ft", rows, sign)
    power = float(np.mean(alternating**2) / np.mean(rows**2)) if np.any(rows) else 0.0
    limit = CUBE.alternating_power if fixed else 1.0 + CUBE.alternating_sd * np.sqrt(2.0 / (found.size[0] - 1))
    if power <= limit:
        return []
    rms = float(np.sqrt(np.mean(alternating**2) / rows.shape[2] / found.size[2]))
    sentence = f"even and odd rows differ by {2.0 * rms:.3g} DN: interlaced fields, not separated?"
    return [("interlace-motion", sentence)]
