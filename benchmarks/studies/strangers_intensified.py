"""Photon-transfer sessions of intensified cameras drawn with plain NumPy: how often are their
numbers right?

Run as `python -m benchmarks.studies.strangers_intensified [FIRST] [COUNT]`. Neither the simulator
nor any form of the estimators takes part: Poisson photoelectrons on a raster of half pixels, pulse
heights of three laws, blur by Fourier transform with the closed form of its point spread function,
pixels of 2 x 2 half pixels, shot noise of the CCD's electrons, read noise and a digitiser. In every
other session pixels misbehave.
"""

import sys
import time
from collections import Counter, defaultdict
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labdata import Conditions, FrameStack, Session, StackEntry, make_refusal
from tests.truth.sessions import session_in_memory

Array = NDArray[Any]

BLURS = ("gaussian", "exponential", "moffat", "two gaussians")
HEIGHTS = ("exponential", "gamma", "negative binomial")
QUANTITIES = {"covariance_gain": "DN", "conversion_gain": "DN/e-", "read_noise": "DN"}
SESSIONS = 140
MOST_FAULTY, MOST_HITS = 0.005, 1e-4


@dataclass(frozen=True, kw_only=True)
class Stack(StackEntry):
    """A stack that lies in memory."""

    held: FrameStack

    def read(self) -> FrameStack:
        """The frames."""
        return self.held


@dataclass(frozen=True, kw_only=True)
class Camera:
    """An intensified camera; lengths in px, powers of noise in DN.

    `excess` is E h^2 / (E h)^2 of the pulse heights h, `widths_px` what the blur needs: standard
    deviation, scale of exp(-r/a), radius of a Moffat, or two standard deviations; `more` its
    exponent or the share of the wider.
    """

    blur: str
    widths_px: tuple[float, ...]
    more: float
    heights: str
    excess: float
    pulse_dn: float
    electron_dn: float
    read_dn: float
    bits: int
    shape: tuple[int, int]
    frames: int
    levels_dn: tuple[float, ...]
    shading: float
    prnu: float
    dsnu_dn: float
    faulty: float
    hits: float

    @property
    def truth(self) -> dict[str, float]:
        """Covariance gain K + k F^2, K, and the temporal noise of a dark with its rounding."""
        return {
            "covariance_gain": self.electron_dn + self.pulse_dn * self.excess,
            "conversion_gain": self.electron_dn,
            "read_noise": float(np.sqrt(self.read_dn**2 + 1.0 / 12.0)),
        }


def camera_drawn(rng: np.random.Generator, number: int) -> Camera:
    """Draw a camera; its number says which blur it has and whether its pixels misbehave."""

    def log_uniform(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(np.log(low), np.log(high))))

    blur, bits = BLURS[number // 2 % len(BLURS)], int(rng.choice([12, 14, 16]))
    widths: dict[str, Callable[[], tuple[tuple[float, ...], float]]] = {
        "gaussian": lambda: ((log_uniform(0.5, 1.6),), 0.0),
        "exponential": lambda: ((log_uniform(0.35, 1.0),), 0.0),
        "moffat": lambda: ((log_uniform(1.0, 2.5),), float(rng.uniform(2.5, 4.5))),
        "two gaussians": lambda: (
            (log_uniform(0.5, 1.1), log_uniform(1.5, 4.0)),
            float(rng.uniform(0.05, 0.3)),
        ),
    }
    widths_px, more = widths[blur]()
    heights = str(rng.choice(HEIGHTS))
    excess = 2.0 if heights == "exponential" else float(rng.uniform(1.2, 2.2))
    brightest = float(rng.uniform(0.15, 0.55)) * 2.0**bits
    pulse_dn = brightest / log_uniform(20.0, 400.0)
    floor = float(rng.uniform(0.0, 0.5))
    count, bad = int(rng.integers(4, 7)), number % 2 == 1
    return Camera(
        blur=blur,
        widths_px=widths_px,
        more=more,
        heights=heights,
        excess=excess,
        pulse_dn=pulse_dn,
        electron_dn=pulse_dn * excess * floor / (1.0 - floor),
        read_dn=log_uniform(1.0, 4.0) * 2.0 ** (0.5 * (bits - 12)),
        bits=bits,
        shape=(int(rng.integers(112, 177)), int(rng.integers(112, 177))),
        frames=int(rng.integers(8, 13)),
        levels_dn=tuple(brightest * np.linspace(1.0 / count, 1.0, count)),
        shading=float(rng.uniform(0.0, 0.1)),
        prnu=float(rng.uniform(0.0, 0.01)),
        dsnu_dn=float(rng.uniform(0.0, 1.0)),
        faulty=float(rng.uniform(0.0, MOST_FAULTY)) if bad else 0.0,
        hits=log_uniform(1e-6, MOST_HITS) if bad else 0.0,
    )


def transfer(camera: Camera, rows: int, cols: int) -> Array:
    """Return the transfer of the blur on a raster of half pixels, in closed form where there is
    one.
    """
    from scipy.special import gamma, kv

    frequency = 2.0 * np.hypot(np.fft.fftfreq(rows)[:, None], np.fft.rfftfreq(cols)[None, :])
    angular = 2.0 * np.pi * frequency
    first = camera.widths_px[0]
    if camera.blur == "gaussian":
        return np.exp(-0.5 * (angular * first) ** 2)
    if camera.blur == "exponential":
        return (1.0 + (angular * first) ** 2) ** -1.5
    if camera.blur == "moffat":
        order = camera.more - 1.0
        place = np.maximum(angular * first, 1e-9)
        out = 2.0 * (place / 2.0) ** order * kv(order, place) / gamma(order)
        out[0, 0] = 1.0
        return out
    narrow, wide = (np.exp(-0.5 * (angular * width) ** 2) for width in camera.widths_px)
    return (1.0 - camera.more) * narrow + camera.more * wide


@dataclass
class Drawn:
    """Frames of one camera: its fixed pattern and its misbehaving pixels belong to all of its
    stacks.
    """

    camera: Camera
    rng: np.random.Generator
    faults: dict[str, Array] = field(default_factory=dict)

    def __post_init__(self) -> None:
        rows, cols = self.camera.shape
        one = self.camera
        self.passed = transfer(one, 2 * rows, 2 * cols).astype(np.float32)
        y, x = np.meshgrid(np.linspace(-1, 1, rows), np.linspace(-1, 1, cols), indexing="ij")
        self.light = 1.0 - one.shading * (x**2 + y**2)
        self.light /= self.light.mean()
        self.gains = 1.0 + one.prnu * self.rng.standard_normal(one.shape)
        self.black = (
            0.015 * 2.0**one.bits
            + 8.0 * one.read_dn
            + one.dsnu_dn * self.rng.standard_normal(one.shape)
        )
        kinds = self.rng.choice(["stuck", "hot", "blinking"], round(one.faulty * rows * cols))
        place = self.rng.choice(rows * cols, len(kinds), replace=False)
        self.faults = {kind: place[kinds == kind] for kind in ("stuck", "hot", "blinking")}
        top = 2.0**one.bits
        self.stuck = self.rng.choice([0.0, 0.5 * top, top - 1.0], len(self.faults["stuck"]))
        self.hot = np.exp(
            self.rng.uniform(np.log(10 * one.read_dn), np.log(0.2 * top), len(self.faults["hot"]))
        )
        self.blink = np.exp(
            self.rng.uniform(
                np.log(5 * one.read_dn), np.log(0.05 * top), len(self.faults["blinking"])
            )
        )

    def stack(self, signal_dn: float, frames: int) -> FrameStack:
        """Frames of even light with a mean signal, DN."""
        data = np.stack([self.frame(signal_dn) for _ in range(frames)])
        return FrameStack(data=data, full_scale_dn=2.0**self.camera.bits - 1.0)

    def frame(self, signal_dn: float) -> Array:
        """One frame."""
        one, rng = self.camera, self.rng
        light = self._pulses(signal_dn) if signal_dn else np.zeros(one.shape)
        if one.electron_dn > 0:
            light = one.electron_dn * rng.poisson(np.maximum(light, 0.0) / one.electron_dn)
        image = self.black + self.gains * light + one.read_dn * rng.standard_normal(one.shape)
        flat = image.ravel()
        flat[self.faults["hot"]] += self.hot + np.sqrt(self.hot) * rng.standard_normal(
            len(self.hot)
        )
        flat[self.faults["blinking"]] += self.blink * (rng.random(len(self.blink)) < 0.3)
        flat[self.faults["stuck"]] = self.stuck
        # A hit takes three pixels on average.
        for _ in range(rng.poisson(one.hits * image.size / 3.0)):
            row, col = (int(rng.integers(length)) for length in one.shape)
            size = np.exp(rng.uniform(np.log(20 * one.read_dn), np.log(0.5 * 2**one.bits)))
            image[row : row + int(rng.integers(1, 3)), col : col + int(rng.integers(1, 4))] += size
        return np.clip(np.rint(image), 0, 2**one.bits - 1).astype(np.uint16)

    def _pulses(self, signal_dn: float) -> Array:
        """Light of one frame, DN, without the CCD's own shot noise."""
        one, rng = self.camera, self.rng
        rows, cols = one.shape
        mean = np.repeat(np.repeat(self.light, 2, axis=0), 2, axis=1) * (
            signal_dn / one.pulse_dn / 4.0
        )
        count = rng.poisson(mean)
        heights = np.zeros(count.shape, np.float32)
        some = count > 0
        if one.heights == "negative binomial":
            # A height of r quanta on average is negative binomial with variance (excess - 1) r^2:
            # so is their sum.
            quanta, spread = 40.0, one.excess - 1.0
            shape = 1.0 / (spread - 1.0 / quanta)
            drawn = rng.negative_binomial(count[some] * shape, shape / (shape + quanta))
            heights[some] = drawn * one.pulse_dn / quanta
        else:
            shape = 1.0 / (one.excess - 1.0)
            heights[some] = rng.gamma(count[some] * shape, one.pulse_dn / shape)
        from scipy import fft

        spectrum = np.asarray(fft.rfft2(heights))
        blurred = np.asarray(fft.irfft2(spectrum * self.passed, s=heights.shape))
        return blurred.reshape(rows, 2, cols, 2).sum(axis=(1, 3)).astype(float)


def session_drawn(number: int) -> tuple[Session, Camera]:
    """Draw the session of a number, one dark of twice as many frames and the flats."""
    rng = np.random.default_rng([43, number])
    camera = camera_drawn(rng, number)
    drawn = Drawn(camera, rng)
    told = Conditions(exposure_s=0.02, mcp_v=800.0 if number % 4 > 1 else None)
    stacks = [_entry("dark", "dark", drawn.stack(0.0, 2 * camera.frames), told)]
    stacks += [
        _entry(f"flat-{i}", "flat", drawn.stack(level, camera.frames), told)
        for i, level in enumerate(camera.levels_dn)
    ]
    return session_in_memory(stacks, bit_depth=camera.bits), camera


def _entry(label: str, kind: Any, frames: FrameStack, told: Conditions) -> Stack:
    return Stack(label=label, kind=kind, frames="", folder=Path("."), conditions=told, held=frames)


def main(first: int = 0, count: int = SESSIONS) -> None:
    """Print one line a session, then how often the numbers are `ok`, hold and fail silently."""
    from charact.estimators import noise
    from charact.session_measurement import method_context

    told: dict[str, list[tuple[str, bool, bool]]] = defaultdict(list)
    errors: dict[str, list[float]] = defaultdict(list)
    flags: Counter[str] = Counter()
    spent = 0.0
    for number in range(first, first + count):
        session, camera = session_drawn(number)
        context = method_context(session, quick=True, seed=number)
        begin = time.process_time()
        result = noise.measure(session, context=context)
        spent += time.process_time() - begin
        line = []
        for quantity, unit in QUANTITIES.items():
            one = next(
                iter(result.find(quantity, unit=unit)),
                make_refusal(quantity, unit, "absent", method="none"),
            )
            group = f"{quantity}, {'misbehaving' if camera.faulty else 'clean'} pixels"
            if one.value is None or one.interval95 is None:
                told[group].append((one.status, False, False))
                line.append(f"{one.status}")
                continue
            truth = camera.truth[quantity]
            low, high = one.interval95
            held = low <= truth <= high
            silent = one.status == "ok" and abs(one.value - truth) > high - low
            told[group].append((one.status, held, silent))
            error = 100.0 * (one.value / truth - 1.0) if truth else np.nan
            half = 50.0 * (high - low) / truth if truth else np.nan
            errors[group].append(error)
            if quantity == "covariance_gain":
                flags.update(one.flags)
            line.append(
                f"{one.status} {error:+.2f} +- {half:.2f} "
                f"%{' SILENT' if silent else '' if held else ' out'}"
            )
        floor = camera.electron_dn / camera.truth["covariance_gain"]
        print(
            f"{number:4d} {camera.blur:13s} {camera.widths_px[0]:.2f} {camera.more:.2f} floor "
            f"{floor:.2f}: {'; '.join(line)} {','.join(result.find('covariance_gain')[0].flags)}",
            flush=True,
        )
    print(f"\n{'':44s} sessions   ok  hold of ok  silent  refused  rms error %")
    for group, rows in sorted(told.items()):
        ok = [row for row in rows if row[0] == "ok"]
        rms = float(np.sqrt(np.nanmean(np.square(errors[group])))) if errors[group] else np.nan
        print(
            f"{group:44s} {len(rows):8d} {100 * len(ok) / len(rows):4.0f}% "
            f"{100 * np.mean([row[1] for row in ok]) if ok else np.nan:9.1f}% "
            f"{sum(row[2] for row in rows):7d} {sum(row[0] == 'refused' for row in rows):8d} "
            f"{rms:11.2f}"
        )
    print(
        f"flags of covariance_gain: {dict(flags)}; {spent / count:.2f} s of processor time a "
        f"session"
    )


if __name__ == "__main__":
    main(*(int(word) for word in sys.argv[1:]))
