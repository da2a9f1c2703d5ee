"""3-D noise of one stack: seven components with their findings, and the means of its exposures."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.method import Context
from charact.method.stopwatch import Stopwatch
from charact.noise.cube.components import Component, components
from charact.noise.cube.contrasts import contrasts
from charact.noise.cube.cube_checks import row_parity_findings, shading_findings
from charact.noise.findings import Finding
from charact.noise.stack.frame_means import FrameMeans, frame_means
from charact.noise.thresholds import CUBE
from labdata.lazy_stack import LazyStack

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Cube:
    """3-D noise of one stack.

    Parameters
    ----------
    components
        Variance of each component, by its axes: "t" to "tvh".
    findings
        Findings of each component, by its axes.
    means
        Means of the exposures.
    row_mean_dn, column_mean_dn
        Mean of each row, shape (row,), and of each column, shape (col,), DN.
    fields
        Number of cubes: 2 for interlaced frames.
    seconds
        Run time, s.
    """

    components: dict[str, Component]
    findings: dict[str, tuple[Finding, ...]]
    means: FrameMeans
    row_mean_dn: Array
    column_mean_dn: Array
    fields: int
    seconds: float


def cube_of(stack: LazyStack, *, context: Context) -> Cube | None:
    """Return the 3-D noise of a stack; None if it is too short or too small."""
    frames, rows, cols = stack.shape
    if frames < CUBE.min_frames or min(rows // (2 if context.interlaced else 1), cols) < CUBE.min_pixels:
        return None
    watch = Stopwatch()
    found = contrasts(stack, interlaced=context.interlaced)
    parts = components(found)
    shaded = tuple(shading_findings(found))
    split = context.interlaced
    findings = {
        "v": shaded + (() if split else tuple(row_parity_findings(found, fixed=True))),
        "h": shaded,
        "vh": shaded,
        "tv": () if split else tuple(row_parity_findings(found, fixed=False)),
    }
    return Cube(
        components=parts,
        findings=findings,
        means=frame_means(found.frame_mean_dn, stack.time_s),
        row_mean_dn=(found.by_row[..., 0].mean(axis=1) / np.sqrt(found.size[2])).T.ravel(),
        column_mean_dn=(found.by_col[:, :, 0].mean(axis=1) / np.sqrt(found.size[1])).mean(axis=0),
        fields=len(found.by_row),
        seconds=watch.seconds(),
    )
