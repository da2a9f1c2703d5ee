"""Defective pixels and struck values of a session, and views of its frames with them replaced."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from charact.estimators.noise.pixel_survey import PixelSurvey
from charact.estimators.noise.thresholds import SURVEY
from labdata.frames import LazyStack, View

Places = NDArray[np.int64]


@dataclass(frozen=True, kw_only=True)
class DefectivePixels:
    """Excluded pixels of a session; positions are row times columns plus column."""

    pixels: Places  # pixels that are defective in all frames
    blinking: Places  # those that blink
    # by stack label, positions and frames of struck values; frame -1 for all frames of the stack
    struck: dict[str, tuple[Places, Places]] = field(default_factory=dict)

    @property
    def note(self) -> str | None:
        """Note on the excluded pixels; None for none."""
        hits = sum(len(hit_pixels) for hit_pixels, _ in self.struck.values())
        parts = [f"{len(self.pixels)} defective pixels of the session"] if len(self.pixels) else []
        parts += [f"{hits} outliers of single frames (cosmic rays, ion feedback)"] if hits else []
        return f"excludes {' and '.join(parts)}" if parts else None


def find_defective_pixels(surveys: Sequence[PixelSurvey], *, multiplies: bool) -> DefectivePixels:
    """Return the defective pixels.

    `surveys`: one of each stack, of equal size; `multiplies`: whether a tube or a register
    multiplies electrons; its pulses are valid outliers.
    """
    pixels = surveys[0].pixels
    outlying = np.zeros(pixels, bool)
    for survey in surveys:
        outlying[survey.bright] = outlying[survey.faint] = True
    if np.count_nonzero(outlying) > SURVEY.max_fraction * pixels:
        outlying[:] = False
    min_departure_dn = SURVEY.max_pulse * _slope(surveys) if multiplies else 0.0
    blinks = _blinking_mask(surveys, outlying)
    defective = outlying | blinks
    struck = {
        survey.label: hits
        for survey in surveys
        if len((hits := _outlying_values(survey, defective, min_departure_dn))[0])
    }
    return DefectivePixels(
        pixels=np.flatnonzero(defective), blinking=np.flatnonzero(blinks), struck=struck
    )


def _slope(surveys: Sequence[PixelSurvey]) -> float:
    """Return variance over signal of the flats by robust statistics, DN; 0 without flats."""
    darks = [survey for survey in surveys if survey.kind == "dark"]
    dark, noise = (
        min((getattr(survey, name) for survey in darks), default=0.0)
        for name in ("level_dn", "sd_dn")
    )
    flats = [survey for survey in surveys if survey.kind == "flat" and survey.level_dn > dark]
    slopes = [(survey.sd_dn**2 - noise**2) / (survey.level_dn - dark) for survey in flats]
    return max(float(np.median(slopes)), 0.0) if slopes else 0.0


def _blinking_mask(
    surveys: Sequence[PixelSurvey], outlying: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Return the pixels that are outliers more often than chance allows."""
    from scipy.special import bdtrc

    counts, trials = np.zeros(len(outlying), np.int64), 0
    for survey in surveys:
        if len(survey.sudden) <= SURVEY.max_fraction * survey.pixels:
            counts[survey.sudden] += survey.times
            trials += survey.trials
    if not trials:
        return np.zeros(len(outlying), bool)
    never = float(np.mean(counts[~outlying] == 0))
    rate = min(SURVEY.rate_variation * (1.0 - max(never, 1e-9) ** (1.0 / trials)), 1.0)
    needed = np.arange(2, trials + 2)
    enough = needed[bdtrc(needed - 1, trials, rate) * len(outlying) < SURVEY.false_alarm]
    blinks = counts >= (enough[0] if len(enough) else trials + 1)
    return (
        blinks
        if np.count_nonzero(blinks) <= SURVEY.max_fraction * len(outlying)
        else np.zeros(len(outlying), bool)
    )


def _outlying_values(
    survey: PixelSurvey, defective: NDArray[np.bool_], min_departure_dn: float
) -> tuple[Places, Places]:
    """Return the values far beyond the tail of their stack."""
    is_track = np.zeros(len(defective), bool)
    if not min_departure_dn:
        # Pulses of a tube are tracks too, and valid.
        is_track[survey.track] = ~defective[survey.track]
    defective = defective | is_track
    is_sound = ~defective[survey.sudden]
    uses_tail = (
        survey.kind == "flat"
        or min_departure_dn > 0
        or np.count_nonzero(is_sound) > SURVEY.blinking_fraction * survey.pixels
    )
    is_outlier = is_sound & (
        survey.departure_dn > max(min_departure_dn, survey.tail_dn(defective) if uses_tail else 0.0)
    )
    frames = np.where(survey.times[is_outlier] > 1, -1, survey.frame[is_outlier])
    chosen = is_track[survey.track]
    return (
        np.concatenate([survey.sudden[is_outlier], survey.track[chosen]]),
        np.concatenate([frames, survey.track_frame[chosen]]),
    )


@dataclass(frozen=True, kw_only=True)
class FrameView:
    """Transformation of the frames of one stack on reading.

    A defective pixel takes the values of a valid one up to 32 px away in all frames, shifted by the
    difference of the surrounding medians, which preserves level, noise and pattern. Random
    distances average out the added correlation in spectra. Variances change by less than 1e-4 if
    one pixel of 200 is replaced.
    """

    unit_dn: float  # divisor of the values, DN
    integral: bool  # whether the values are integers then
    # pixels, donors: replaced pixels, and their replacements
    pixels: Places
    donors: Places
    # struck, frame, struck_donors: values replaced in single frames, the frames, and the
    # replacements
    struck: Places
    frame: Places
    struck_donors: Places
    # view of the frames in which these pixels are counted; None: as they are
    under: View | None = None

    def through(self, stack: LazyStack) -> LazyStack:
        """Return the transformed stack."""
        stack = stack if self.under is None else self.under.through(stack)
        if self.unit_dn == 1.0 and not len(self.pixels) and not len(self.struck):
            return stack
        pixel, donor = (
            np.concatenate([self.pixels, self.struck]),
            np.concatenate([self.donors, self.struck_donors]),
        )
        first = stack.frames(0, min(len(stack), 2)).mean(axis=0, dtype=np.float64)
        shift = _surrounding_median(first, pixel) - _surrounding_median(first, donor)
        exact = stack.dtype.kind in "ui" or self.integral
        shift = np.rint(shift / self.unit_dn) * self.unit_dn if exact else shift
        throughout = len(self.pixels)

        def block(start: int, stop: int) -> NDArray:
            data = np.array(stack.frames(start, stop))
            flat = data.reshape(len(data), -1)
            if throughout:
                write_values(flat, np.s_[:], self.pixels, flat[:, self.donors], shift[:throughout])
            for at, frame, source, change in zip(
                self.struck, self.frame, self.struck_donors, shift[throughout:], strict=True
            ):
                if frame < 0:
                    write_values(flat, np.s_[:], at, flat[:, source], change)
                elif start <= frame < stop:
                    write_values(flat, frame - start, at, flat[frame - start, source], change)
            return self._in_units(data)

        full = None if stack.full_scale_dn is None else stack.full_scale_dn / self.unit_dn
        dtype = stack.dtype if self.unit_dn == 1.0 else np.dtype(np.float32)
        return replace(stack, block=block, full_scale_dn=full, dtype=dtype)

    def _in_units(self, data: NDArray) -> NDArray:
        if self.unit_dn == 1.0:
            return data
        scaled = data / self.unit_dn
        return (np.rint(scaled) if self.integral else scaled).astype(np.float32)


def write_values(flat: NDArray, frames, pixels, values: NDArray, shift) -> None:
    """Write shifted values, clipped to the range of an integer type."""
    shifted = values.astype(np.float64) + shift
    if flat.dtype.kind in "ui":
        limits = np.iinfo(flat.dtype)
        shifted = np.clip(shifted, limits.min, limits.max)
    flat[frames, pixels] = shifted.astype(flat.dtype)


def _surrounding_median(image: NDArray[np.float64], pixels: Places) -> NDArray[np.float64]:
    """Return the median of the 24 pixels around each position, DN."""
    rows, cols = image.shape
    row, col = np.divmod(pixels, cols)
    step = np.array([(i, j) for i in range(-2, 3) for j in range(-2, 3) if i or j])
    near_row = np.clip(row[:, None] + step[:, 0], 0, rows - 1)
    near_col = np.clip(col[:, None] + step[:, 1], 0, cols - 1)
    return np.median(image[near_row, near_col], axis=1) if len(pixels) else np.empty(0)


def choose_donors(
    pixels: Places, unsound: NDArray[np.bool_], size: tuple[int, int], rng: np.random.Generator
) -> Places:
    """Return a valid pixel near each position."""
    rows, cols = size
    donors = np.full(len(pixels), -1)
    while (missing := np.flatnonzero(donors < 0)).size:
        row, col = np.divmod(pixels[missing], cols)
        row = _mirror_inside(
            row + rng.integers(-SURVEY.replacement_px, SURVEY.replacement_px + 1, len(missing)),
            rows,
        )
        col = _mirror_inside(
            col + rng.integers(-SURVEY.replacement_px, SURVEY.replacement_px + 1, len(missing)),
            cols,
        )
        pixel = row * cols + col
        donors[missing] = np.where(unsound[pixel], -1, pixel)
    return donors


def _mirror_inside(position: NDArray, length: int) -> NDArray:
    """Return positions mirrored into the image."""
    position = np.abs(position) % (2 * length)
    return np.where(position < length, position, 2 * length - 1 - position)


def frame_view(
    label: str,
    defects: DefectivePixels | None,
    size: tuple[int, int],
    *,
    unit_dn: float,
    integral: bool,
    seed: int,
    under: View | None = None,
) -> FrameView:
    """Return the view of one stack."""
    none = np.empty(0, np.int64)
    pixels, struck, frame = none, none, none
    if defects is not None:
        pixels, (struck, frame) = defects.pixels, defects.struck.get(label, (none, none))
    unsound = np.zeros(size[0] * size[1], bool)
    unsound[pixels] = unsound[struck] = True
    rng = np.random.default_rng([seed, 71])
    return FrameView(
        unit_dn=unit_dn,
        integral=integral,
        pixels=pixels,
        donors=choose_donors(pixels, unsound, size, rng),
        struck=struck,
        frame=frame,
        struck_donors=choose_donors(struck, unsound, size, rng),
        under=under,
    )
