"""The judge handed to acquisition: counts the saturated pixels of every frame, and knows how well a mean is known."""

import math

import numpy as np
from numpy.typing import NDArray

from labdata.plan import Step

# A point source is meant to saturate; anything else with more than this share at the highest code was exposed too long.
SHARE_ALLOWED = 1e-3
# A level is saturated when more than a few pixels are.
SHARE_SATURATED = 0.01
# Looking after every frame would find a small interval by luck; after a quarter more of them each time it does not.
LOOK_AFTER = 1.25


class SaturationJudge:
    """Watches stacks: complains of saturated pixels that defects do not explain, and ends adaptive steps."""

    def watch(self, step: Step, full_scale_dn: float) -> "StackWatcher":
        """Begin to watch one stack."""
        return StackWatcher(step, full_scale_dn)


class StackWatcher:
    """Running numbers of one stack, over every pixel.

    Parameters
    ----------
    step
        What is being taken.
    full_scale_dn
        Highest code of the digitiser, DN.
    """

    def __init__(self, step: Step, full_scale_dn: float) -> None:
        self._step, self._full_scale_dn = step, full_scale_dn
        self._highest_code = math.ceil(full_scale_dn)  # whole as the pixels are: else all of them turn into fractions
        self._full, self._pixels = 0, 0
        self._means_dn: list[float] = []
        self._look_at = step.until.least_frames if step.until else 0

    def see(self, pixels: NDArray) -> None:
        """Look at the next frame, shape (row, col), DN."""
        self._full += int(np.count_nonzero(pixels >= self._highest_code))
        self._pixels += pixels.size
        if self._step.until:
            self._means_dn.append(float(pixels.mean(dtype=np.float64)))

    def enough(self) -> str | None:
        """Return why the mean is known well enough, in a sentence, or None."""
        until, taken = self._step.until, len(self._means_dn)
        if until is None or taken < self._look_at:
            return None
        self._look_at = int(np.ceil(LOOK_AFTER * taken))
        half_dn = half_interval_dn(np.array(self._means_dn))
        if half_dn > until.mean_within_dn:
            return None
        return (
            f"stopped after {taken} of at most {self._step.frames} frames: the mean of {np.mean(self._means_dn):.6g} "
            f"DN is known within {half_dn:.2g} DN, asked were {until.mean_within_dn:g}"
        )

    def is_saturated(self) -> bool:
        """Whether more than a hundredth of the pixels are at the highest code."""
        return self._share > SHARE_SATURATED

    def complaint(self) -> str | None:
        """Return one sentence on what is wrong with the stack, or None."""
        if self._step.kind == "point" or self._share <= SHARE_ALLOWED:
            return None
        return f"{100 * self._share:.2g} % of all pixels are at the highest code {self._full_scale_dn:g} DN"

    @property
    def _share(self) -> float:
        return self._full / self._pixels if self._pixels else 0.0


def half_interval_dn(means_dn: NDArray) -> float:
    """Return half of the 95 % interval of a level's mean from the means of its frames, shape (frame,), DN.

    Notes
    -----
    Student's interval, widened by the autocorrelation time tau = 1 + 2 sum rho of the means, summed while rho stays
    positive (Geyer, Stat. Sci. 7, 473 (1992)): lag and drift make frames know less than their number.
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
