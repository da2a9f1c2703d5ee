"""Which pixels of a session misbehave: bright, faint and blinking ones in every frame, others struck in single frames.

A pixel blinks where it departs suddenly in more frames than chance gives to any pixel; departures that fall on pixels
at random are the noise's own tail (pulses of a tube or of a register), unless they lie far beyond that tail.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from charact.noise.sound.survey import PixelSurvey
from charact.noise.sound.thresholds import BLINKING_SHARE, CHANCE, LARGEST_PULSE, MOST_SHARE, UNEVEN

Places = NDArray[np.int64]


@dataclass(frozen=True, kw_only=True)
class DefectivePixels:
    """Pixels of a session that are left out. Places are row times columns plus column.

    Parameters
    ----------
    places
        Pixels that misbehave throughout.
    blinking
        Those of them that blink.
    struck
        For each stack, by its label, places and frames that were struck; frame -1 for all frames of the stack.
    """

    places: Places
    blinking: Places
    struck: dict[str, tuple[Places, Places]] = field(default_factory=dict)

    @property
    def note(self) -> str | None:
        """What was left out, in words; None for nothing."""
        hits = sum(len(places) for places, _ in self.struck.values())
        parts = [f"{len(self.places)} misbehaving pixels of the session"] if len(self.places) else []
        parts += [f"{hits} values that single frames show far off (cosmic rays, ions)"] if hits else []
        return f"judged on sound pixels: {' and '.join(parts)} are left out" if parts else None


def find_defective_pixels(surveys: Sequence[PixelSurvey], *, multiplies: bool) -> DefectivePixels:
    """Return the pixels that misbehave.

    Parameters
    ----------
    surveys
        One of each stack, all of one size.
    multiplies
        Whether a tube or a register stands before the chip's output: its pulses are far off and sound.
    """
    pixels = surveys[0].pixels
    wrong = np.zeros(pixels, bool)
    for one in surveys:
        wrong[one.bright] = wrong[one.faint] = True
    if np.count_nonzero(wrong) > MOST_SHARE * pixels:
        wrong[:] = False
    least = LARGEST_PULSE * _slope(surveys) if multiplies else 0.0
    blinks = _blinking_mask(surveys, wrong)
    away = wrong | blinks
    struck = {one.label: hits for one in surveys if len((hits := _outlying_values(one, away, least))[0])}
    return DefectivePixels(places=np.flatnonzero(away), blinking=np.flatnonzero(blinks), struck=struck)


def _slope(surveys: Sequence[PixelSurvey]) -> float:
    """Variance over signal of the flats by robust statistics, DN; 0 where there are none."""
    darks = [one for one in surveys if one.kind == "dark"]
    dark, noise = (
        (min(darks, key=lambda one: one.level_dn).level_dn, min(one.sd_dn for one in darks)) if darks else (0, 0)
    )
    flats = [one for one in surveys if one.kind == "flat" and one.level_dn > dark]
    slopes = [(one.sd_dn**2 - noise**2) / (one.level_dn - dark) for one in flats]
    return max(float(np.median(slopes)), 0.0) if slopes else 0.0


def _departures_are_rare(one: PixelSurvey) -> bool:
    """Whether those that depart suddenly are a minority."""
    return len(one.sudden) <= MOST_SHARE * one.pixels


def _blinking_mask(surveys: Sequence[PixelSurvey], wrong: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Pixels that depart more often than chance lets any."""
    from scipy.stats import binom

    counts, trials = np.zeros(len(wrong), np.int64), 0
    for one in surveys:
        if _departures_are_rare(one):
            counts[one.sudden] += one.times
            trials += one.trials
    if not trials:
        return np.zeros(len(wrong), bool)
    never = float(np.mean(counts[~wrong] == 0))
    rate = min(UNEVEN * (1.0 - max(never, 1e-9) ** (1.0 / trials)), 1.0)
    needed = np.arange(2, trials + 2)
    enough = needed[binom.sf(needed - 1, trials, rate) * len(wrong) < CHANCE]
    blinks = counts >= (enough[0] if len(enough) else trials + 1)
    return blinks if np.count_nonzero(blinks) <= MOST_SHARE * len(wrong) else np.zeros(len(wrong), bool)


def _outlying_values(one: PixelSurvey, away: NDArray[np.bool_], least: float) -> tuple[Places, Places]:
    """Values far beyond the tail of their stack."""
    rest = ~away[one.sudden]
    own = one.kind == "flat" or least > 0 or np.count_nonzero(rest) > BLINKING_SHARE * one.pixels
    far = rest & (one.departure_dn > max(least, one.tail_dn(away) if own else 0.0))
    return one.sudden[far], np.where(one.times[far] > 1, -1, one.frame[far])
