"""Maps of a specimen: its fixed patterns from half of the frames of darks and flats; the other half
tests them.

A map is a ratio of sums over frames, m = sum x / sum s: of darks x is a frame less its mean and s
is 1, of flats x is a frame less the dark and s its mean signal, which weighs frames as their shot
noise asks. Two parts a, b of the frames, of weights A and B, give the noise of the map:
(m_a - m_b) sqrt(A B) / (A + B) has its variance, in every band of frequency.
"""

import zlib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from charact.fitting.fitted_session import with_fixed_gain
from charact.fitting.thresholds import LEVELS, LIMITS, MAP_LIMITS, PATTERN
from charact.frames.session_layout import sound_session
from charact.verdict import Finding
from labdata import Camera, Session, StackEntry, open_lazy_stack
from labdata.camera.maps import (
    IN_DARK,
    IN_LIGHT,
    LEAST_RATIO,
    NOISY,
    OUTLIER_SD,
    PixelMap,
    SpecimenMaps,
    power_of,
    smooth_part,
)

Array = NDArray[np.float64]


@dataclass
class _Parts:
    """Sums of frames in two parts, and their squared deviations in time."""

    total: Array | float = 0.0  # shape (part, row, col)
    weight: Array = field(default_factory=lambda: np.zeros(2))
    # The same sums of frames times their exposures, s; and of those and their squares.
    moment: Array | float = 0.0
    seconds: Array = field(default_factory=lambda: np.zeros((2, 2)))
    gap_frames: int = 0  # frames left out between the parts of a stack, whose noise lag would share
    with_pulses: bool = False  # of single events, which the median of a part's frames leaves out
    squares: Array | float = 0.0  # of frames less the mean of their stack, shape (row, col)
    freedom: int = 0
    frames: int = 0

    def add(self, frames: Array, weights: Array, exposure_s: float = 0.0) -> None:
        """Add frames of one stack, less their level, the first and the last ones to a part each."""
        gap = min(self.gap_frames, len(frames) // 4)
        middle = (len(frames) - gap + self.frames % 2) // 2
        parts = slice(middle), slice(middle + gap, None)
        weight = np.array([weights[part].sum() for part in parts])
        if self.with_pulses:
            medians = np.stack([np.median(frames[part], axis=0) for part in parts])
            medians -= medians.mean(axis=(1, 2), keepdims=True)
            sums = weight[:, None, None] * medians
        else:
            sums = np.stack([frames[part].sum(axis=0) for part in parts])
        self.total, self.weight = self.total + sums, self.weight + weight
        self.moment = self.moment + exposure_s * sums
        self.seconds = self.seconds + np.array([[exposure_s], [exposure_s**2]]) * weight
        self.squares = self.squares + len(frames) * frames.var(axis=0)
        self.freedom += len(frames) - 1
        self.frames += len(frames)

    def line(self) -> tuple["_Parts", "_Parts"]:
        """Return the sums of level and slope of frames over their exposure, by least squares."""
        first, second = self.seconds
        level = self.weight - first**2 / np.maximum(second, 1e-30)
        slope = second - first**2 / np.maximum(self.weight, 1e-30)
        slope[level < MAP_LIMITS.least_spread * self.weight] = 0.0
        of_total = first / np.maximum(self.weight, 1e-30)
        of_moment = first / np.maximum(second, 1e-30)
        return (
            replace(self, total=self.total - self.moment * of_moment[:, None, None], weight=level),
            replace(self, total=self.moment - self.total * of_total[:, None, None], weight=slope),
        )

    def map_of(self, neutral: float, least_ratio: float = LEAST_RATIO) -> PixelMap | None:
        """Return the map, or None where its own noise is unknown, or hides all bands of a ratio.

        A pixel on which the parts do not agree, as after a cosmic ray, has the value of the one
        nearer to `neutral`.
        """
        if not (self.weight > 0.0).all():
            return None
        first, second = np.asarray(self.total) / self.weight[:, None, None]
        weight = self.weight.sum()
        value = np.sum(self.total, axis=0) / weight
        noise = (first - second) * float(np.sqrt(self.weight.prod()) / weight)
        sd = 1.4826 * float(np.median(np.abs(noise)))
        # A pulse in most frames of one part must not stand out of the mean of both.
        most_sd = MAP_LIMITS.pulse_sd if self.with_pulses else OUTLIER_SD
        disagree = np.abs(noise) > most_sd * sd
        nearer = np.where(np.abs(first - neutral) < np.abs(second - neutral), first, second)
        value, noise = np.where(disagree, nearer, value), np.where(disagree, 0.0, noise)
        measured = PixelMap(value=value, sd=np.full(value.shape, noise.std()))
        powers = power_of(noise - smooth_part(noise))
        pattern = np.maximum(power_of(measured.remainder) - powers, 0.0)
        measured = replace(
            measured,
            power=tuple(pattern.tolist()),
            noise=tuple(powers.tolist()),
            least_ratio=least_ratio,
        )
        shading = smooth_part(noise).var(), measured.smooth.var()
        supported = (
            measured.shown.any()
            or measured.outliers.any()
            or shading[1] > (1.0 + LEAST_RATIO) * shading[0]
        )
        return measured if supported else None

    def hot_pixels(self) -> PixelMap | None:
        """Return the map of the pixels that stand out of rounding in both parts, which hides the
        pattern of the others; None where none does.
        """
        too_few = self.with_pulses and self.frames < MAP_LIMITS.pulse_frames
        if too_few or not (self.weight > 0.0).all():
            return None
        first, second = np.asarray(self.total) / self.weight[:, None, None]
        height = np.where(np.abs(first) < np.abs(second), first, second)
        sd_dn = LIMITS.least_noise_dn
        value = np.where(np.abs(height) > OUTLIER_SD * sd_dn, height, 0.0)
        # As much pattern as noise: no band is known.
        unknown = tuple(np.full_like(power_of(value), sd_dn**2).tolist())
        sd = np.full(value.shape, sd_dn)
        return PixelMap(value=value, sd=sd, power=unknown, noise=unknown) if value.any() else None


def with_maps(session: Session, fitted: Camera) -> Camera:
    """Return a fitted camera with the maps that half of the frames of its session support, and
    notes on them.
    """
    maps = None
    fixed, _ = with_fixed_gain(session)
    sound = sound_session(fixed)[1]
    if float(fitted.video.gamma) == 1.0:
        maps = measure_maps(sound, fitted)
    widths = code_width_finding(sound, float(2**fitted.video.bit_depth - 1))
    notes = () if maps is None else maps.notes
    if widths is not None:
        notes = (widths.note, *notes)
    return replace(fitted, maps=maps, notes=(*fitted.notes, *notes))


def code_width_finding(session: Session, full_dn: float) -> Finding | None:
    """Return the finding that codes of the converter are of unlike widths (differential
    nonlinearity), None where flats do not show it.

    Notes
    -----
    Noise of s DN gives neighbouring codes the same number of values, but for a curve of the third
    degree over s DN, m_k. The width of a code over the mean is c_k / m_k of its number c_k, whose
    counting noise is sqrt(m_k): without widths sum (c_k - m_k)^2 / m_k is chi-squared.
    """
    from scipy.signal import savgol_filter

    size = int(full_dn) + 1
    counts, expected = np.zeros(size), np.zeros(size)
    for chosen in frames_for_maps(session.of_kind("flat"), full_dn):
        codes = chosen.entry.read().data[chosen.numbers]
        sd_dn = float(np.sqrt(np.median(codes.var(axis=0, dtype=float)))) if len(codes) > 1 else 0.0
        half = int(min(sd_dn / 2.0, MAP_LIMITS.most_codes))
        if half < MAP_LIMITS.least_codes or codes.dtype.kind == "f":
            continue
        values = np.clip(codes, 0, size - 1).ravel()
        number = np.bincount(values, minlength=size).astype(float)
        smooth = np.asarray(savgol_filter(number, 2 * half + 1, 3, mode="constant"))
        frequent = smooth > MAP_LIMITS.frequent * smooth.max()
        counts, expected = counts + number * frequent, expected + smooth * frequent
    known = expected > MAP_LIMITS.least_values
    counts, expected = counts[known], expected[known]
    chi_squared = float(np.sum((counts - expected) ** 2 / expected))
    if not known.any() or chi2.sf(chi_squared, counts.size) > MAP_LIMITS.code_chance:
        return None
    width_sd = np.sqrt((chi_squared - counts.size) / expected.sum())
    missing = np.count_nonzero(counts < MAP_LIMITS.missing * expected)
    spectrum = np.abs(np.fft.rfft(counts / expected - 1.0))[1:]
    # A comb has harmonics as high as itself.
    period = counts.size / (1 + int(np.argmax(spectrum > spectrum.max() / 2.0)))
    return Finding(
        flag="nonlinear",
        effect=(
            f"codes of the converter are of unlike widths: standard deviation {width_sd:.2g} LSB "
            f"over {counts.size} codes, mostly of a period of {period:.2g}; {missing} codes are "
            "missing"
        ),
        remedy="a camera gain of 1 in its digitiser, or noise of several DN that evens them out",
    )


def measure_maps(session: Session, fitted: Camera) -> SpecimenMaps | None:
    """Return the maps that half of the darks and flats of a session support, None without any.

    Parameters
    ----------
    session
        Session of sound frames and fixed gain.
    fitted
        Its camera: a pattern behind a tube is that of tube and chip.
    """
    full_dn = float(2**fitted.video.bit_depth - 1)
    darks, flats = (frames_for_maps(session.of_kind(kind), full_dn) for kind in ("dark", "flat"))
    gap_frames = PATTERN.gap_frames if fitted.has_tube else 0
    # Those of a tube, or of single electrons that a register multiplies.
    has_pulses = fitted.has_tube or fitted.multiplies
    dark_levels, dark_parts = [], _Parts(with_pulses=has_pulses)
    lit = _Parts(gap_frames=gap_frames)
    for chosen, frames in _read(darks):
        mean_dn = frames.mean(axis=(1, 2), keepdims=True)
        dark_levels.append(float(mean_dn.mean()))
        exposure_s = chosen.entry.conditions.exposure_s or 0.0
        dark_parts.add(frames - mean_dn, np.ones(len(frames)), exposure_s)
    if not darks:
        return None
    at_zero, slope = dark_parts.line()
    if (rate := None if fitted.has_tube else slope.map_of(0.0)) is not None:
        dark_parts = at_zero
    variance = np.asarray(dark_parts.squares) / max(dark_parts.freedom, 1)
    noise_dn = float(np.sqrt(np.median(variance)))
    is_rounded = noise_dn <= LIMITS.least_noise_dn
    offset = dark_parts.hot_pixels() if is_rounded else dark_parts.map_of(0.0)
    no_noise = has_pulses or is_rounded or offset is None  # variances of another law, or none
    noisy = None if no_noise else _noisy(dark_parts, variance)
    dark_dn = float(np.mean(dark_levels)) + (0.0 if offset is None else offset.mean)
    for chosen, frames in _read(flats):
        signal = frames - dark_dn
        if rate is not None:
            signal -= rate.mean * (chosen.entry.conditions.exposure_s or 0.0)
        lit.add(signal, signal.mean(axis=(1, 2)))
    # Granularity and fibres of a tube are patterns of low frequency, unlike what noise hides: even
    # where none shows, a map bounds them by its noise.
    light = lit.map_of(1.0, 0.0 if fitted.has_tube else LEAST_RATIO)
    if offset is None and light is None:
        return None
    used = [*(darks if offset is not None else ()), *(flats if light is not None else ())]
    defect = np.zeros(variance.shape, np.uint8)
    for bit, pixels in (
        (IN_DARK, None if offset is None else offset.outliers),
        (IN_DARK, None if rate is None else rate.outliers),
        (IN_LIGHT, None if light is None else light.outliers),
        (NOISY, noisy),
    ):
        defect |= np.uint8(0) if pixels is None else np.uint8(bit) * pixels
    region = getattr(used[0].entry.view, "region", (0, 0))
    return SpecimenMaps(
        offset_dn=offset,
        dark_rate_dn_per_s=rate,
        variance_dn2=None
        if noisy is None
        else PixelMap(
            value=variance.astype(np.float32), sd=variance * np.sqrt(2.0 / dark_parts.freedom)
        ),
        defect=defect,
        frames={chosen.entry.label: tuple(chosen.numbers.tolist()) for chosen in used},
        checksums={chosen.entry.label: checksum(chosen.entry) for chosen in used},
        origin=(region[0], region[1]),
        pitch_px=session.sampling[1],
        notes=tuple(_notes(offset, rate, light, defect, (dark_parts.frames, lit.frames), noise_dn)),
        pattern=light if fitted.has_tube else None,
        response=None if fitted.has_tube else light,
    )


@dataclass(frozen=True, kw_only=True)
class ChosenFrames:
    """Numbers of the frames of a stack that make maps."""

    entry: StackEntry
    numbers: NDArray[np.int64]


def frames_for_maps(entries: Sequence[StackEntry], full_dn: float) -> list[ChosenFrames]:
    """Return the frames of stacks of one kind that make maps: the last half of four or more, and of
    shorter stacks every second stack whole, not the last, within the linear range and at the gain
    and temperature that most of them have.

    Frames of the other half follow each other, as lag and drift are compared.
    """
    groups: dict[tuple, list[tuple[StackEntry, int]]] = {}
    for entry in entries:
        stack, known = open_lazy_stack(entry), entry.conditions
        frame = stack.frames(0, 1)
        clipped = max(np.mean(frame >= full_dn), np.mean(frame <= 0))
        if clipped <= LEVELS.most_clipped and frame.mean() <= LEVELS.highest_level * full_dn:
            key = known.camera_gain_db, known.em_gain, known.temperature_c
            groups.setdefault(key, []).append((entry, len(stack)))
    largest = max(groups.values(), key=len, default=[])
    short = [entry for entry, count in largest if count < MAP_LIMITS.divided_frames]
    return [
        ChosenFrames(entry=entry, numbers=np.arange(0 if entry in short else -(-count // 2), count))
        for entry, count in largest
        if entry not in short[::-2]
    ]


def checksum(entry: StackEntry) -> int:
    """Return the CRC-32 of the first frame of a stack."""
    frame = open_lazy_stack(replace(entry, view=None)).frames(0, 1)
    return zlib.crc32(np.ascontiguousarray(frame).tobytes())


def _read(stacks: Iterable[ChosenFrames]) -> Iterator[tuple[ChosenFrames, Array]]:
    """Yield stacks with their chosen frames, shape (frame, row, col), DN."""
    for chosen in stacks:
        yield chosen, chosen.entry.read().data[chosen.numbers].astype(np.float64)


def _noisy(parts: _Parts, variance: Array) -> NDArray[np.bool_] | None:
    """Return the pixels whose variance in time no normal noise has by chance; None where too few
    frames show it.
    """
    if parts.freedom < MAP_LIMITS.least_freedom:
        return None
    chance = MAP_LIMITS.chance / variance.size
    factor = chi2.isf(chance, parts.freedom) / chi2.median(parts.freedom)
    return variance > factor * np.median(variance)


def _notes(
    offset: PixelMap | None,
    rate: PixelMap | None,
    light: PixelMap | None,
    defect: NDArray[np.uint8],
    counts: tuple[int, int],
    noise_dn: float,
) -> Iterator[str]:
    """Yield what each map contains, or why there is none."""
    for title, measured, count, factor, unit in (
        ("offset", offset, counts[0], 1.0, "DN"),
        ("dark current", rate, counts[0], 1.0, "DN/s"),
        ("response", light, counts[1], 100.0, "%"),
    ):
        if measured is None and title == "dark current":
            continue
        if measured is None:
            yield (
                f"no map of the specimen's {title}: its noise of {count} frames hides the pattern; "
                "the parameters of the type stand for it"
            )
            continue
        residual = measured.value - measured.smooth
        sd = max(1.4826 * float(np.median(np.abs(residual))), float(measured.sd[0, 0]))
        pixels = measured.outliers
        furthest = float(np.abs(residual)[pixels].max(initial=0.0)) / sd
        absorbed = f"{np.count_nonzero(pixels)} pixels beyond {OUTLIER_SD:g} of them"
        absorbed += f", up to {furthest:.3g}, are in the map" if pixels.any() else ""
        yield (
            f"map of the specimen's {title}: {count} frames, standard deviation "
            f"{factor * sd:.3g} {unit} of which {factor * float(measured.sd[0, 0]):.2g} is noise; "
            f"{absorbed}"
        )
    if (noisy := np.count_nonzero(defect & NOISY)) > 0:
        yield (
            f"map of the specimen's noise: {noisy} pixels are noisier than the dark's "
            f"{noise_dn:.3g} DN by more than chance and keep their noise"
        )
    if light is not None:
        yield (
            f"light of the flats: shading of {100.0 * float(light.smooth.std()):.2g} % standard "
            "deviation, taken for uneven light, is simulated in flats alone"
        )
