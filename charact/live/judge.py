"""Judge of stacks during an acquisition: saturated pixels, and the end of adaptive steps."""

import math

import numpy as np
from numpy.typing import NDArray

from labdata.plan import Step

# Allowed fraction of pixels at full scale (point sources are exempt), and that of a saturated
# stack.
MAX_SATURATED_FRACTION, SATURATED_FRACTION = 1e-3, 0.01


class SaturationJudge:
    """Reports saturated stacks and ends adaptive steps."""

    def watch(self, step: Step, full_scale_dn: float) -> "StackWatcher":
        """Return the watcher of one stack."""
        return StackWatcher(step, full_scale_dn)


class StackWatcher:
    """Running statistics of one stack over all pixels."""

    def __init__(self, step: Step, full_scale_dn: float) -> None:
        self._step, self._full_scale_dn = step, full_scale_dn
        self._full_scale = math.ceil(full_scale_dn)  # an integer: a float would convert every frame
        self._full, self._pixels = 0, 0
        self._means_dn: list[float] = []
        self._look_at = step.until.least_frames if step.until else 0

    def see(self, pixels: NDArray) -> None:
        """Add a frame, shape (row, col), DN."""
        self._full += int(np.count_nonzero(pixels >= self._full_scale))
        self._pixels += pixels.size
        if self._step.until:
            self._means_dn.append(float(pixels.mean(dtype=np.float64)))

    def enough(self) -> str | None:
        """Return a sentence that the mean is within its tolerance, or None."""
        until, taken = self._step.until, len(self._means_dn)
        if until is None or taken < self._look_at:
            return None
        # A check after every frame would find a small interval by chance.
        self._look_at = int(np.ceil(1.25 * taken))
        half_dn = half_interval_dn(np.array(self._means_dn))
        if half_dn > until.mean_within_dn:
            return None
        return (
            f"stopped after {taken} of at most {self._step.frames} frames: the mean of "
            f"{np.mean(self._means_dn):.6g} DN is known within {half_dn:.2g} DN, requested "
            f"{until.mean_within_dn:g}"
        )

    def is_saturated(self) -> bool:
        """Whether more than 1 % of the pixels are at full scale."""
        return self._share > SATURATED_FRACTION

    def complaint(self) -> str | None:
        """Return a sentence on saturated pixels, or None."""
        if self._step.kind == "point" or self._share <= MAX_SATURATED_FRACTION:
            return None
        return (
            f"{100 * self._share:.2g} % of all pixels are at full scale, {self._full_scale_dn:g} DN"
        )

    @property
    def _share(self) -> float:
        return self._full / self._pixels if self._pixels else 0.0


def half_interval_dn(means_dn: NDArray) -> float:
    """Return half the 95 % interval of a stack's mean from its frame means, shape (frame,), DN.

    Notes
    -----
    Student's interval with the effective number of frames, n / tau, because of image lag and drift.
    The autocorrelation time tau = 1 + 2 sum rho is summed while rho stays positive (Geyer, Stat.
    Sci. 7, 473 (1992)).
    """
    from scipy.special import stdtrit

    frames = len(means_dn)
    rest = means_dn - means_dn.mean()
    if not rest.any():
        return 0.0
    rho = np.correlate(rest, rest, "full")[frames - 1 :] / (rest @ rest)
    first_negative = int(np.argmax(rho <= 0.0)) or frames
    tau = 1.0 + 2.0 * float(rho[1:first_negative].sum())
    independent = max(2.0, frames / tau)
    return float(stdtrit(independent - 1.0, 0.975) * rest.std(ddof=1) / np.sqrt(independent))
