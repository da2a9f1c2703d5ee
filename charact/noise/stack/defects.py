"""Defective pixels: those far from the others of their stack, in the mean or in how restless they are."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.noise.cube.contrasts import Contrasts
from charact.noise.cube.mean_squares import COL, ROW, centred
from charact.noise.findings import Finding

Array = NDArray[np.float64]
Places = NDArray[np.int64]

# A pixel is defective where its mean, shading and rows and columns taken away, is so many robust standard deviations
# from the others', or where half of its changes from frame to frame are so many times as large as theirs. A normal
# law puts one pixel of 10^14 beyond the first, and of 10^9 beyond the second.
FAR = 8.0
RESTLESS = 5.0
LEAST_PAIRS = 4
# Defects that hold more than this share of the random noise move it.
HELD = 0.02
# Variance of a digitiser's rounding, DN^2.
ROUNDING_DN2 = 1.0 / 12.0


@dataclass(frozen=True, kw_only=True)
class Defects:
    """Defective pixels of one stack.

    Parameters
    ----------
    threshold_dn
        Departure of the mean from which a pixel counts, DN.
    bright, faint, restless
        Row and column in the frame of pixels too bright, too faint and too restless, shape (pixel, 2).
    least, most
        How many would count were each mean one standard error nearer to the others' or further off, and 1.96.
    noise_share
        Share of the random noise's variance that the restless ones hold, dimensionless.
    """

    threshold_dn: float
    bright: Places
    faint: Places
    restless: Places
    least: tuple[int, int]
    most: tuple[int, int]
    noise_share: float

    @property
    def count(self) -> int:
        """Number of pixels that are one or the other."""
        every = [tuple(place) for places in (self.bright, self.faint, self.restless) for place in places.tolist()]
        return len(set(every))

    @property
    def findings(self) -> list[Finding]:
        """What they spoil of the random noise."""
        if self.noise_share <= HELD:
            return []
        share = f"{100 * self.noise_share:.2g} % of the random noise"
        return [("defects", f"{len(self.restless)} restless pixels hold {share}")]


def defects_of(found: Contrasts, random_dn2: float) -> Defects:
    """Return the defective pixels of a stack.

    Parameters
    ----------
    found
        Its contrasts.
    random_dn2
        Variance of the random noise of a pixel, DN^2.
    """
    frames, fields = found.size[0], len(found.by_pixel)
    away = (centred(found.by_pixel[:, :1], (ROW, COL), fixed=True) / np.sqrt(frames))[:, 0]
    # Where most pixels are alike to less than the noise of their means, that noise is the measure.
    error = float(np.sqrt(max(random_dn2, ROUNDING_DN2) / frames))
    threshold = FAR * max(1.4826 * float(np.median(np.abs(away))), error)
    restless, share = _restless(found)

    def beyond(nearer_dn: float) -> int:
        return int(np.count_nonzero((np.abs(away) > max(threshold + nearer_dn, 0.0)) | restless))

    return Defects(
        threshold_dn=threshold,
        bright=_places(away > threshold, fields),
        faint=_places(away < -threshold, fields),
        restless=_places(restless, fields),
        least=(beyond(error), beyond(1.96 * error)),
        most=(beyond(-error), beyond(-1.96 * error)),
        noise_share=share,
    )


def _restless(found: Contrasts) -> tuple[NDArray[np.bool_], float]:
    """Pixels half of whose changes are large, shape (field, row, col), and their share of the noise's variance.

    Half of them, for a pulse of light is one change and no defect.
    """
    if found.pairs.shape[1] < LEAST_PAIRS:
        return np.zeros(found.by_pixel[:, 0].shape, bool), 0.0
    usual = np.median(np.abs(found.pairs), axis=1)
    restless = usual > RESTLESS * max(float(np.median(usual)), 0.5)
    square = np.mean(found.pairs.astype(np.float64) ** 2, axis=1)
    return restless, float(square[restless].sum() / max(float(square.sum()), 1e-30))


def _places(chosen: NDArray[np.bool_], fields: int) -> Places:
    """Rows and columns of the frame."""
    field, row, col = np.nonzero(chosen)
    return np.stack([row * fields + field, col], axis=1)
