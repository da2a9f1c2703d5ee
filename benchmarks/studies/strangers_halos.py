"""Halo diameters of point series whose light is drawn by plain numpy, by no form that a method
fits.

A flat or rimmed disc is blurred by a core with or without wings and sampled by pixels, in five to
eight levels of up to 3,000 times the light that fills the core: `python -m
benchmarks.studies.strangers_halos [--seed N] [--count N]`.
"""

import argparse
import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks.studies.harness import judge_measurement
from charact.estimators import bloom
from charact.method import Context
from labdata import Conditions, FrameStack, Measurement, Session
from tests.truth.sessions import session_in_memory, stack_in_memory

Array = NDArray[np.float64]

# Samples along a pixel's side.
FINE = 5
RIMS = ("flat", "linear", "quadratic", "ring")
WINGS = ("none", "gaussian", "exponential", "moffat")
# What a halo's diameter may be off by: px or a fraction, whichever is more.
WITHIN_PX, WITHIN = 1.0, 0.02


@dataclass(frozen=True, kw_only=True)
class Halo:
    """One drawn series.

    Parameters
    ----------
    diameter_px, fraction
        Outer diameter of the disc before any blur, and its fraction of the light.
    rim, rise
        Where the disc is brighter (`RIMS`), and its radiance there over that of its middle.
    core_px, wing, wing_fraction, wing_px
        Standard deviation of the core; kind of its wings (`WINGS`), their fraction of the core's
        light and their scale.
    integrated
        Whether pixels integrate over their area; otherwise the core's width includes the pixel.
    side_px, row, col
        Side of the frame, and place of the source.
    bits, dark_dn, electrons_per_dn, read_dn
        Depth, level without light, scale of the shot noise, and read noise.
    levels, frames
        Number of levels, and frames of each.
    """

    diameter_px: float
    fraction: float
    rim: str
    rise: float
    core_px: float
    wing: str
    wing_fraction: float
    wing_px: float
    integrated: bool
    side_px: int
    row: float
    col: float
    bits: int
    dark_dn: float
    electrons_per_dn: float
    read_dn: float
    levels: int
    frames: int

    @property
    def full_dn(self) -> float:
        """Highest code, DN."""
        return 2.0**self.bits - 1.0


def halo_of(rng: np.random.Generator) -> Halo:
    """Draw one series."""
    bits, side = int(rng.choice([8, 12])), int(rng.integers(200, 321))
    rim = str(rng.choice(RIMS, p=[0.5, 0.5 / 3, 0.5 / 3, 0.5 / 3]))
    wing = str(rng.choice(WINGS, p=[0.5, 0.5 / 3, 0.5 / 3, 0.5 / 3]))
    core = float(rng.uniform(0.8, 2.0))
    scale = {
        "none": 0.0,
        "gaussian": rng.uniform(2.0, 4.0) * core,
        "exponential": rng.uniform(2.0, 5.0),
        "moffat": rng.uniform(1.5, 4.0),
    }[wing]
    row, col = 0.5 * (side - 1) + rng.uniform(-8.0, 8.0, 2)
    return Halo(
        diameter_px=float(rng.uniform(30.0, 70.0)),
        fraction=float(np.exp(rng.uniform(np.log(0.03), np.log(0.2)))),
        rim=rim,
        rise=1.0 if rim == "flat" else float(rng.uniform(1.1, 2.0)),
        core_px=core,
        wing=wing,
        wing_fraction=0.0 if wing == "none" else float(rng.uniform(0.03, 0.2)),
        wing_px=float(scale),
        integrated=bool(rng.random() < 0.5),
        side_px=side,
        row=float(row),
        col=float(col),
        bits=bits,
        dark_dn=float(rng.uniform(6.0, 20.0) * (1.0 if bits == 8 else 4.0)),
        electrons_per_dn=float(rng.uniform(2.0, 10.0) * (8.0 if bits == 8 else 1.0)),
        read_dn=float(rng.uniform(1.0, 3.0)),
        levels=int(rng.integers(5, 9)),
        frames=int(rng.choice([1, 2, 4, 8])),
    )


def light_of(halo: Halo) -> Array:
    """Return the light of the source at fine samples, its core's highest 1, shape (FINE side, FINE
    side).

    A pixel's value is the sample at its middle.
    """
    count = FINE * halo.side_px
    row, col = (FINE * one + FINE // 2 for one in (halo.row, halo.col))
    offset = np.fft.fftfreq(count, 1.0 / count) / FINE
    core = _core(halo, np.hypot(offset[:, None], offset[None, :]))
    core /= core.sum()
    down, across = (np.arange(count) - row) / FINE, (np.arange(count) - col) / FINE
    disc = _disc(halo, np.hypot(down[:, None], across[None, :]))
    disc /= disc.sum()
    place = np.fft.fftfreq(count)
    point = np.exp(-2j * np.pi * (place[:, None] * row + np.fft.rfftfreq(count)[None, :] * col))
    blur = np.fft.rfft2(core)
    if halo.integrated:
        box = [
            np.where(
                one == 0, 1.0, np.sin(np.pi * FINE * one) / (FINE * np.sin(np.pi * one + 1e-300))
            )
            for one in (place, np.fft.rfftfreq(count))
        ]
        blur = blur * box[0][:, None] * box[1][None, :]
    of_core = np.fft.irfft2(blur * point, (count, count))
    of_disc = np.fft.irfft2(blur * np.fft.rfft2(disc), (count, count))
    return ((1.0 - halo.fraction) * of_core + halo.fraction * of_disc) / (
        (1.0 - halo.fraction) * of_core.max()
    )


def _core(halo: Halo, radius: Array) -> Array:
    """Light of core and wings, each of volume 1 before they are weighted."""
    core = np.exp(-0.5 * (radius / halo.core_px) ** 2) / (2.0 * np.pi * halo.core_px**2)
    scale, part = halo.wing_px, halo.wing_fraction
    if halo.wing == "none":
        return core
    wing = {
        "gaussian": lambda: np.exp(-0.5 * (radius / scale) ** 2) / (2.0 * np.pi * scale**2),
        "exponential": lambda: np.exp(-radius / scale) / (2.0 * np.pi * scale**2),
        "moffat": lambda: 1.5 / (np.pi * scale**2) * (1.0 + (radius / scale) ** 2) ** -2.5,
    }[halo.wing]()
    return (1.0 - part) * core + part * wing


def _disc(halo: Halo, radius: Array) -> Array:
    """Radiance of the disc, its edge covered in proportion to the area inside."""
    x = radius / (0.5 * halo.diameter_px)
    level = {
        "flat": lambda: np.ones_like(x),
        "linear": lambda: 1.0 + (halo.rise - 1.0) * x,
        "quadratic": lambda: 1.0 + (halo.rise - 1.0) * x**2,
        "ring": lambda: np.where(x > 0.9, halo.rise, 1.0),
    }[halo.rim]()
    return level * np.clip(0.5 + FINE * (0.5 * halo.diameter_px - radius), 0.0, 1.0)


def session_of(halo: Halo, rng: np.random.Generator) -> Session:
    """Draw the frames of all levels and of the dark."""
    light = light_of(halo)[FINE // 2 :: FINE, FINE // 2 :: FINE]
    span = halo.full_dn - halo.dark_dn
    stacks = []
    for index, times in enumerate([0.0, *np.geomspace(0.3, 3000.0, halo.levels)]):
        electrons = np.maximum(times * span * halo.electrons_per_dn * light, 0.0)
        signal = (
            rng.poisson(np.broadcast_to(electrons, (halo.frames, *light.shape)))
            / halo.electrons_per_dn
        )
        code = np.rint(halo.dark_dn + signal + halo.read_dn * rng.standard_normal(signal.shape))
        data = np.clip(code, 0.0, halo.full_dn).astype(np.uint8 if halo.bits == 8 else np.uint16)
        kind = "point" if times else "dark"
        conditions = Conditions(exposure_s=0.02, illuminance_lux=1e-5 * times if times else None)
        held = FrameStack(data=data, full_scale_dn=halo.full_dn)
        label = f"{kind}-{index}"
        stacks.append(stack_in_memory(kind, held, conditions, label=label))
    return session_in_memory(stacks)


def off_px(halo: Halo, found: Measurement) -> float:
    """Return how far a diameter is off, px; NaN where it is refused."""
    return float("nan") if found.value is None else found.value - halo.diameter_px


def is_within(halo: Halo, found: Measurement) -> bool:
    """Return whether a diameter is within the tolerance."""
    return bool(abs(off_px(halo, found)) <= max(WITHIN_PX, WITHIN * halo.diameter_px))


def row_of(name: str, rows: list[tuple[Halo, Measurement, Measurement]]) -> str:
    """Return one line of the table."""
    if not rows:
        return f"{name:<12}{0:>5}"
    pairs = [(halo, one) for halo, one, _ in rows]
    ok = [pair for pair in pairs if pair[1].status == "ok"]
    judged = [judge_measurement(one, halo.diameter_px) for halo, one in ok]
    errors = np.array([off_px(*pair) for pair in pairs if pair[1].value is not None])
    wide = [0.5 * (one.interval95[1] - one.interval95[0]) for _, one in ok if one.interval95]
    share = [
        halo.fraction >= one.interval95[0] and halo.fraction <= one.interval95[1]
        for halo, _, one in rows
        if one.status == "ok" and one.interval95
    ]
    within = sum(is_within(*pair) for pair in pairs)
    ok_within = sum(is_within(*pair) for pair in ok)
    refused = sum(measured.status == "refused" for _, measured in pairs)
    rms = np.sqrt(np.mean(errors**2)) if len(errors) else np.nan
    half_width = np.median(wide) if wide else np.nan
    covered, silent = (sum(verdict[key] for verdict in judged) for key in ("covers", "silent"))
    return (
        f"{name:<12}{len(rows):>5}{within:>8}{len(ok):>5}{ok_within:>10}{covered:>7}{silent:>8}"
        f"{refused:>9}{rms:>9.3f}{half_width:>10.3f}{sum(share):>8}/{len(share)}"
    )


def main() -> None:
    """Draw series, measure each and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument(
        "--quick", action="store_true", help="intervals from curvature instead of draws"
    )
    parser.add_argument(
        "--each", action="store_true", help="print each series that is not within, not ok or silent"
    )
    asked = parser.parse_args()
    rows, seconds = [], time.process_time()
    measuring = 0.0
    for number in range(asked.count):
        rng = np.random.default_rng([asked.seed, number])
        halo = halo_of(rng)
        session = session_of(halo, rng)
        began = time.process_time()
        result = bloom.measure(session, context=Context(seed=1, quick=asked.quick))
        measuring += time.process_time() - began
        (found,), (share,) = result.find("halo_diameter"), result.find("halo_fraction")
        rows.append((halo, found, share))
        holds = judge_measurement(found, halo.diameter_px).get("covers", False)
        if asked.each and (found.status != "ok" or not is_within(halo, found) or not holds):
            print(
                number,
                halo,
                found.value,
                found.interval95,
                found.status,
                found.flags,
                found.reason or "",
                flush=True,
            )
    print(
        "             series  within   ok ok+within  95 %  silent  refused   rms px  95 % px  "
        "fraction"
    )
    print(row_of("all", rows))
    for name in RIMS:
        print(row_of(name, [one for one in rows if one[0].rim == name]))
    for name in WINGS:
        print(row_of(f"wing {name}"[:12], [one for one in rows if one[0].wing == name]))
    for bits in (8, 12):
        print(row_of(f"{bits} bits", [one for one in rows if one[0].bits == bits]))
    for frames in (1, 8):
        print(row_of(f"{frames} frames", [one for one in rows if one[0].frames == frames]))
    print(
        f"{measuring / asked.count:.2f} s a series to measure, "
        f"{time.process_time() - seconds:.0f} s in all"
    )


if __name__ == "__main__":
    main()
