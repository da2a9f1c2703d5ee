"""Bar targets that others make: `python -m benchmarks.studies.strangers_bars` draws 200 and prints
one table.

Three to fifteen bars, bright or dark, five times as long as wide or in square patches, under blurs
of GalSim (Gaussian, two Gaussians, Airy, Moffat) through a square pixel, with the photon and read
noise of an ordinary camera. The picture is the bars' exact spectrum times the blur's and the
pixel's, its aliases summed.
"""

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import galsim
import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft2, next_fast_len

from charact.estimators.mtf import measure, measure_all
from charact.method import Context
from labdata import FrameStack, Measurement

Array = NDArray[np.float64]
Psf = galsim.GSObject

# Spectra so many sampling frequencies away fold back; every blur drawn has none further off.
ALIASES = 2
# The blur drawn leaves at least this MTF at the bars' frequency.
LEAST_MTF = 0.1
WIDEST_PX = 300.0
FORMS = ("Gaussian", "two Gaussians", "Airy", "Moffat")


@dataclass(frozen=True, kw_only=True)
class Stranger:
    """A bar target and the camera that takes it.

    Parameters
    ----------
    form, psf
        Name of the blur, and the blur; lengths in px.
    bars, frequency, square
        Number, cycles per pixel, and whether they are as long as the patch is wide: else five times
        their width.
    dark
        Whether they are darker than their ground.
    angle_deg
        Direction across them from the row direction.
    middle_px
        Where their middle lies off that of the frame, row and column.
    bright_e, contrast, read_e
        Electrons of the bright level, share of it that the dark level has, and read noise.
    bits, filled
        Of the digitiser, and the share of its scale that the bright level takes.
    frames
        Their number.
    """

    form: str
    psf: Psf
    bars: int
    frequency: float
    square: bool
    dark: bool
    angle_deg: float
    middle_px: tuple[float, float]
    bright_e: float
    contrast: float
    read_e: float
    bits: int
    filled: float
    frames: int

    @property
    def length_px(self) -> float:
        """Length of the bars."""
        return (self.bars - 0.5 if self.square else 2.5) / self.frequency

    def mtf(self, frequency: float) -> float:
        """MTF of blur and pixel at a frequency across the bars."""
        angle = np.deg2rad(self.angle_deg)
        pixel = np.sinc(frequency * np.cos(angle)) * np.sinc(frequency * np.sin(angle))
        return float(pixel * self.psf.kValue(2.0 * np.pi * frequency, 0.0).real)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of a frame that shows two periods of ground around the bars."""
        angle = np.deg2rad(self.angle_deg)
        across, along = (self.bars - 0.5) / self.frequency, self.length_px
        margin = 2.0 * max(2.0 / self.frequency, 14.0)
        down = across * abs(np.sin(angle)) + along * abs(np.cos(angle)) + margin
        right = across * abs(np.cos(angle)) + along * abs(np.sin(angle)) + margin
        return int(np.ceil(down)), int(np.ceil(right))

    def picture(self) -> Array:
        """Share of the bars' light that falls on each pixel, 1 on a wide bar, shape (row, col)."""
        rows, cols = (int(next_fast_len(2 * side + 32, True) or 0) for side in self.shape)
        at = np.linspace(0.0, 1.5 * (ALIASES + 1), 4000)
        transfer = np.array([self.psf.kValue(2.0 * np.pi * one, 0.0).real for one in at])
        angle, width = np.deg2rad(self.angle_deg), 0.5 / self.frequency
        places = (np.arange(self.bars) - 0.5 * (self.bars - 1)) / self.frequency
        row, col = (
            0.5 * (side - 1) + off for side, off in zip(self.shape, self.middle_px, strict=True)
        )
        spectrum = np.zeros((rows, cols // 2 + 1), complex)
        for up in range(-ALIASES, ALIASES + 1):
            for right in range(-ALIASES, ALIASES + 1):
                fy = np.fft.fftfreq(rows)[:, None] + up
                fx = np.fft.rfftfreq(cols)[None, :] + right
                across, along = (
                    fx * np.cos(angle) + fy * np.sin(angle),
                    fy * np.cos(angle) - fx * np.sin(angle),
                )
                comb = sum(np.cos(2.0 * np.pi * place * across) for place in places)
                bars = (
                    width
                    * np.sinc(width * across)
                    * comb
                    * self.length_px
                    * np.sinc(self.length_px * along)
                )
                seen = np.interp(np.hypot(fx, fy), at, transfer) * np.sinc(fx) * np.sinc(fy)
                spectrum += bars * seen * np.exp(-2j * np.pi * (fy * row + fx * col))
        return np.asarray(irfft2(spectrum, (rows, cols)))[: self.shape[0], : self.shape[1]]

    def frames_drawn(self, rng: np.random.Generator) -> FrameStack:
        """Draw the frames: Poisson electrons, read noise, whole codes over a black that nobody
        states.
        """
        share = self.picture()
        light = np.maximum(1.0 - share if self.dark else share, 0.0)
        mean_e = self.bright_e * (self.contrast + (1.0 - self.contrast) * light)
        full = 2.0**self.bits - 1.0
        black_dn = np.ceil(0.02 * full)
        per_e = (self.filled * full - black_dn) / self.bright_e
        black_dn = max(black_dn, np.ceil(5.0 * self.read_e * per_e))
        shape = (self.frames, *self.shape)
        signal = rng.poisson(mean_e, shape) + self.read_e * rng.standard_normal(shape)
        codes = np.clip(np.rint(black_dn + per_e * signal), 0.0, full)
        return FrameStack(data=codes.astype(np.uint8 if self.bits == 8 else np.uint16))


def _psf(form: str, rng: np.random.Generator) -> Psf:
    """Draw a blur of a form."""
    sigma_px = float(rng.uniform(0.4, 1.5))
    if form == "Gaussian":
        return galsim.Gaussian(sigma=sigma_px)
    if form == "two Gaussians":
        wing, share = float(rng.uniform(2.0, 4.0)), float(rng.uniform(0.05, 0.3))
        core = galsim.Gaussian(sigma=sigma_px, flux=1.0 - share)
        return galsim.Sum([core, galsim.Gaussian(sigma=wing * sigma_px, flux=share)])
    if form == "Airy":
        return galsim.Airy(lam_over_diam=float(rng.uniform(1.0, 3.0)))
    return galsim.Moffat(beta=float(rng.uniform(2.5, 5.0)), fwhm=2.355 * sigma_px)


def drawn(rng: np.random.Generator) -> Stranger:
    """Draw a target whose blur leaves something of its bars."""
    while True:
        form = str(rng.choice(FORMS))
        bars = int(rng.choice([3, 3, 3, 4, 5, 5, 7, 9, 12, 15]))
        bright_e = float(np.exp(rng.uniform(np.log(500.0), np.log(20000.0))))
        one = Stranger(
            form=form,
            psf=_psf(form, rng),
            bars=bars,
            frequency=float(np.exp(rng.uniform(np.log(0.02), np.log(0.4)))),
            square=bool(rng.random() < 0.5),
            dark=bool(rng.random() < 0.5),
            angle_deg=float(
                rng.choice([0.0, 90.0]) + rng.uniform(0.0, 30.0) * rng.choice([-1.0, 0.0, 1.0])
            ),
            middle_px=(float(rng.uniform(-3, 3)), float(rng.uniform(-3, 3))),
            bright_e=bright_e,
            contrast=float(rng.uniform(0.02, 0.4)),
            read_e=float(rng.uniform(2.0, 12.0)),
            bits=int(rng.choice([8, 10, 12, 14, 16])),
            filled=float(rng.uniform(0.5, 0.95)) / (1.0 + 5.0 / np.sqrt(bright_e)),
            frames=int(rng.choice([1, 1, 2, 4, 8])),
        )
        if one.bars / one.frequency < WIDEST_PX and one.mtf(one.frequency) > LEAST_MTF:
            return one


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What became of one target: how it was judged, and the number in half widths of its 95 %
    interval off.
    """

    stranger: Stranger
    status: str
    flags: tuple[str, ...]
    off: float
    error: float
    seconds: float

    @property
    def silent(self) -> bool:
        """Whether a number that is ok is wrong by twice its half interval."""
        return self.status == "ok" and self.off > 2.0


def outcome(number: int, seed: int, said: str) -> Outcome:
    """Draw and measure one target of which a region, nothing at all, or number and frequency are
    stated.
    """
    rng = np.random.default_rng([seed, number])
    one = drawn(rng)
    stack = one.frames_drawn(rng)
    context = Context(seed=number, quick=True)
    if said == "file":
        found = measure_all("bars", stack, context=context)
    else:
        known = {"bars": one.bars, "frequency_cy_per_px": one.frequency} if said == "all" else {}
        found = measure("bars", stack, region=(0, 0, *one.shape), context=context, **known)
    told = [m for m in found.measurements if m.quantity == "mtf"]
    return _judged(one, told[0], len(told))


def _judged(one: Stranger, found: Measurement, count: int) -> Outcome:
    """Hold a number against the truth; several targets in a frame of one, or another frequency, are
    a wrong number.
    """
    off, error = np.nan, np.nan
    if (
        found.value is not None
        and found.interval95 is not None
        and found.frequency_cy_per_px is not None
    ):
        truth = one.mtf(one.frequency)
        low, high = found.interval95
        error = found.value / truth - 1.0
        off = (found.value - truth) / (
            found.value - low if found.value > truth else high - found.value
        )
        if count > 1 or abs(found.frequency_cy_per_px / one.frequency - 1.0) > 0.02:
            off = np.inf
    return Outcome(
        stranger=one,
        status=found.status,
        flags=found.flags,
        off=abs(off),
        error=error,
        seconds=found.seconds or 0.0,
    )


ROWS: dict[str, Callable[[Stranger], bool]] = {
    "all": lambda one: True,
    "bright": lambda one: not one.dark,
    "dark": lambda one: one.dark,
    "3 bars": lambda one: one.bars == 3,
    "4 bars": lambda one: one.bars == 4,
    "5 and more": lambda one: one.bars > 4,
    "five to one": lambda one: not one.square,
    "square": lambda one: one.square,
    "untilted": lambda one: one.angle_deg % 90.0 == 0.0,
    "tilted": lambda one: one.angle_deg % 90.0 != 0.0,
    "one frame": lambda one: one.frames == 1,
    "several": lambda one: one.frames > 1,
    "8 bits": lambda one: one.bits == 8,
    "under 0.08 cy/px": lambda one: one.frequency < 0.08,
    "over 0.2 cy/px": lambda one: one.frequency > 0.2,
    **{form: lambda one, form=form: one.form == form for form in FORMS},
}


def table(outcomes: Sequence[Outcome]) -> list[str]:
    """Return the lines of the table."""
    lines = [
        " " * 18
        + "".join(
            f"{title:>{width}}"
            for title, width in (
                ("drawn", 6),
                ("ok", 6),
                ("suspect", 9),
                ("refused", 9),
                ("95 % hold", 11),
                ("silent", 8),
                ("rms %", 8),
            )
        )
    ]
    for name, chosen in ROWS.items():
        own = [one for one in outcomes if chosen(one.stranger)]
        ok = [one for one in own if one.status == "ok"]
        counts = [
            sum(one.status == status for one in own) for status in ("ok", "suspect", "refused")
        ]
        held = 100.0 * np.mean([one.off <= 1.0 for one in ok]) if ok else np.nan
        rms = 100.0 * np.sqrt(np.mean([one.error**2 for one in ok])) if ok else np.nan
        lines.append(
            f"{name:18}{len(own):6d}{counts[0]:6d}{counts[1]:9d}{counts[2]:9d}{held:11.1f}"
            f"{sum(one.silent for one in own):8d}{rms:8.2f}"
        )
    flags = sorted({flag for one in outcomes for flag in one.flags})
    counted = {flag: sum(flag in one.flags for one in outcomes) for flag in flags}
    lines.append("flags: " + ", ".join(f"{flag} {count}" for flag, count in counted.items()))
    return lines


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument(
        "--said", choices=("roi", "file", "all"), default="roi", help="what is said of each target"
    )
    parser.add_argument(
        "--list", action="store_true", help="print each target that is not ok, or misses"
    )
    asked = parser.parse_args()
    outcomes = []
    for number in range(asked.count):
        outcomes.append(one := outcome(number, asked.seed, asked.said))
        if asked.list and (one.status != "ok" or one.off > 1.0):
            s = one.stranger
            print(
                f"{number:4d} {one.status:8} {one.off:6.2f} {100 * one.error:7.2f}% {s.form:13} N "
                f"{s.bars:2d} f {s.frequency:.3f} {'dark' if s.dark else 'bright':6} "
                f"{'square' if s.square else '5:1':6} {s.angle_deg:6.1f} deg, MTF "
                f"{s.mtf(s.frequency):.3f}, {s.frames} frames of {s.bits} bits, {s.bright_e:.0f} "
                f"e: {', '.join(one.flags)}",
                flush=True,
            )
    print("\n".join(table(outcomes)))


if __name__ == "__main__":
    main()
