"""Points that others draw: GalSim and prysm make the pictures, charact measures them, closed forms
hold the truth.

`python -m benchmarks.studies.strangers_points [--count 400] [--seed 1]` prints one line a kind of
spot, one for all, and how far single-frame points err beyond the Cramer-Rao bound of the fit by
their own form. GalSim draws Gaussian, Airy, Kolmogorov and Moffat spots, prysm propagates pupils
out of focus; each goes through a square pixel.
"""

import argparse
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from charact.estimators.mtf import measure_all
from charact.method import Context
from labdata import FrameStack

Array = NDArray[np.float64]

KINDS = (
    "gaussian",
    "airy",
    "airy with hole",
    "defocus",
    "defocus with hole",
    "kolmogorov",
    "moffat",
)
# Peak over the standard deviation of the background: faint ones of the bound, and ordinary ones.
FAINT, BRIGHT = 30.0, 400.0
# Samples across prysm's pupil, and of its transform.
PUPIL, PADDING = 192, 4


@dataclass(frozen=True, kw_only=True)
class Spot:
    """A spot: what it is, and where.

    Parameters
    ----------
    kind
        One of `KINDS`.
    shape
        Parameters of the form: Gaussian sigma, px; Airy cut-off, cy/px, hole, defocus in waves;
        Kolmogorov FWHM, px; Moffat FWHM, px, and exponent.
    shear
        Reduced shear along the rows: axes (1 + g) to (1 - g).
    place
        Column and row from the middle pixel, px.
    size
        Rows and columns of the picture.
    """

    kind: str
    shape: tuple[float, ...]
    shear: float
    place: tuple[float, float]
    size: int

    def picture(self) -> Array:
        """Return the picture of unit light, shape (row, col)."""
        if self.kind.startswith("defocus"):
            return _propagated(self)
        import galsim

        profile = _profile(self).shift(*self.place)
        image = galsim.Convolve(profile, galsim.Pixel(1.0)).drawImage(
            nx=self.size, ny=self.size, scale=1.0, method="no_pixel", dtype=float
        )
        if np.isfinite(image.array).all():
            return np.asarray(image.array, float)
        # GalSim's transfer of a hole is no number where three of its circles meet.
        return replace(self, shape=(self.shape[0] * (1.0 + 1e-6), *self.shape[1:])).picture()

    def transfer(self, frequency: Array, angle_deg: float) -> Array:
        """Return the true MTF along rows (0) or columns (90), pixel included."""
        if self.kind.startswith("defocus"):
            at, line = _line(self.shape[1], self.shape[2])
            own = np.interp(frequency / self.shape[0], at, line, right=0.0)
        else:
            profile = _profile(self)
            k = 2.0 * np.pi * frequency
            own = np.array(
                [
                    profile.kValue(*((one, 0.0) if angle_deg == 0.0 else (0.0, one))).real
                    for one in k
                ]
            )
        return np.asarray(own * np.sinc(frequency), float)

    def mtf50(self, angle_deg: float) -> float:
        """Return the true MTF50, cy/px."""
        frequency = np.linspace(0.002, 0.9, 1797)
        below = int(np.argmax(self.transfer(frequency, angle_deg) < 0.5))
        near = frequency[below - 1 : below + 1]
        high, low = self.transfer(near, angle_deg)
        return float(near[0] + (high - 0.5) / (high - low) * (near[1] - near[0]))


def _profile(spot: Spot):
    """Return GalSim's profile of a spot without its pixel."""
    import galsim

    wide = galsim.GSParams(maximum_fft_size=16384, folding_threshold=1e-3, maxk_threshold=1e-4)
    first, *rest = spot.shape
    if spot.kind == "gaussian":
        profile = galsim.Gaussian(sigma=first, gsparams=wide)
    elif spot.kind.startswith("airy"):
        profile = galsim.Airy(
            lam_over_diam=1.0 / first, obscuration=rest[0] if rest else 0.0, gsparams=wide
        )
    elif spot.kind == "kolmogorov":
        profile = galsim.Kolmogorov(fwhm=first, gsparams=wide)
    else:
        profile = galsim.Moffat(beta=rest[0], fwhm=first, gsparams=wide)
    return profile.shear(g1=spot.shear)


@lru_cache(maxsize=64)
def _spread(hole: float, defocus: float) -> tuple[Array, float]:
    """Return prysm's spread of a pupil, shape (row, col), and its step in units of one over the
    cut-off.
    """
    from prysm.propagation import Wavefront

    step = 2.0 / PUPIL
    x = (np.arange(PUPIL) - PUPIL // 2 + 0.5) * step
    sub = (np.arange(6) - 2.5) / 6 * step
    radius = np.hypot((x[:, None] + sub)[:, None, :, None], (x[:, None] + sub)[None, :, None, :])
    inside = ((radius <= 1.0) & (radius >= hole)).mean(axis=(2, 3))
    wave = Wavefront(inside * np.exp(2j * np.pi * defocus * (x[:, None] ** 2 + x**2)), 1.0, step)
    psf = wave.focus(2.0, Q=PADDING).intensity
    return np.asarray(psf.data / psf.data.sum()), float(psf.dx)


@lru_cache(maxsize=64)
def _otf(hole: float, defocus: float) -> tuple[Array, Array]:
    """Return frequencies over the cut-off, ascending, and the transform of the spread, shape (row,
    col).
    """
    psf, step = _spread(hole, defocus)
    frequency = np.fft.fftshift(np.fft.fftfreq(len(psf), step))
    otf = np.fft.fftshift(np.fft.fft2(np.fft.ifftshift(psf))).real
    inside = np.abs(frequency) <= 1.0
    return frequency[inside], otf[np.ix_(inside, inside)]


def _line(hole: float, defocus: float) -> tuple[Array, Array]:
    frequency, otf = _otf(hole, defocus)
    middle = frequency.size // 2
    return frequency[middle:], otf[middle, middle:]


def _propagated(spot: Spot) -> Array:
    """Return the picture of a pupil's spread through square pixels, summed over its frequencies."""
    cut_off, hole, defocus = spot.shape
    relative, otf = _otf(hole, defocus)
    f = relative * cut_off
    at = np.arange(spot.size) - (spot.size - 1) / 2
    known = np.sinc(f)
    along = np.exp(2j * np.pi * np.outer(at - spot.place[0], f)) * known
    down = np.exp(2j * np.pi * np.outer(at - spot.place[1], f)) * known
    return np.asarray((down @ otf @ along.T).real * (f[1] - f[0]) ** 2)


@dataclass(frozen=True, kw_only=True)
class Camera:
    """A camera before a spot: peak over the background's noise, read noise in electrons, bits,
    frames, background.
    """

    peak_sd: float
    read_e: float
    background_e: float
    bits: int
    frames: int
    full: float

    @property
    def dark_e(self) -> float:
        """Standard deviation of the background, electrons."""
        return float(np.sqrt(self.read_e**2 + self.background_e))

    @property
    def dn_per_e(self) -> float:
        """Gain that puts the peak at a share of full scale, DN per electron."""
        return self.full * (2**self.bits - 1) / (self.peak_sd * self.dark_e)

    def expose(self, picture: Array, rng: np.random.Generator) -> NDArray[np.uint16]:
        """Return frames of a picture, shape (frame, row, col), DN."""
        mean = self.mean_e(picture)
        electrons = rng.poisson(np.tile(mean, (self.frames, 1, 1))) + rng.normal(
            0.0, self.read_e, (self.frames, *mean.shape)
        )
        offset = 0.06 * 2**self.bits
        codes = np.clip(np.rint(offset + self.dn_per_e * electrons), 0, 2**self.bits - 1)
        return codes.astype(np.uint8 if self.bits == 8 else np.uint16)

    def mean_e(self, picture: Array) -> Array:
        """Return the light of a picture of any light, electrons."""
        return (
            np.maximum(picture / picture.max() * self.peak_sd * self.dark_e, 0.0)
            + self.background_e
        )

    def variance_e2(self, picture: Array) -> Array:
        """Return the variance of one frame with rounding, electrons^2."""
        return self.mean_e(picture) + self.read_e**2 + 1.0 / (12.0 * self.dn_per_e**2)


def spot(kind: str, rng: np.random.Generator) -> Spot:
    """Draw a spot of a kind."""
    hole = float(rng.uniform(0.15, 0.5)) if "hole" in kind else 0.0
    shape = {
        "gaussian": lambda: (rng.uniform(0.6, 2.2),),
        "airy": lambda: (rng.uniform(0.2, 0.9),),
        "airy with hole": lambda: (rng.uniform(0.25, 0.9), hole),
        "defocus": lambda: (rng.uniform(0.3, 0.9), hole, rng.uniform(0.1, 0.5)),
        "defocus with hole": lambda: (rng.uniform(0.35, 0.9), hole, rng.uniform(0.1, 0.4)),
        "kolmogorov": lambda: (rng.uniform(1.8, 5.0),),
        "moffat": lambda: (rng.uniform(1.8, 5.0), rng.uniform(2.2, 5.0)),
    }[kind]()
    shear = 0.0 if "defocus" in kind or rng.uniform() < 0.5 else float(rng.uniform(-0.04, 0.04))
    return Spot(
        kind=kind,
        shape=tuple(float(one) for one in shape),
        shear=shear,
        place=(float(rng.uniform(-3, 3)), float(rng.uniform(-3, 3))),
        size=2 * int(rng.integers(30, 55)) + 1,
    )


def camera(rng: np.random.Generator, peak_sd: float | None = None) -> Camera:
    """Draw a camera; of a given peak over the noise one of a single frame."""
    return Camera(
        peak_sd=peak_sd or float(np.exp(rng.uniform(np.log(FAINT), np.log(BRIGHT)))),
        read_e=float(np.exp(rng.uniform(np.log(2.0), np.log(15.0)))),
        background_e=float(rng.choice([0.0, rng.uniform(0.0, 100.0)])),
        bits=int(rng.choice([8, 10, 12, 14, 16])),
        frames=1 if peak_sd or rng.uniform() < 0.5 else int(rng.integers(2, 17)),
        full=float(rng.uniform(0.4, 0.85)),
    )


@dataclass(frozen=True, kw_only=True)
class Row:
    """One number of a spot: status, flags, value, interval and truth; its bounds where they were
    worked out, of a fit of its form and of one whose shape is known.
    """

    kind: str
    status: str
    flags: tuple[str, ...]
    value: float
    low: float
    high: float
    truth: float
    bound: float = np.nan
    bound_of_size: float = np.nan

    @property
    def holds(self) -> bool:
        """Whether the 95 % interval holds the truth."""
        return self.low <= self.truth <= self.high

    @property
    def silent(self) -> bool:
        """Whether the number is ok and off by more than twice its half interval."""
        return self.status == "ok" and abs(self.value - self.truth) > self.high - self.low


def measured(
    one: Spot, by: Camera, rng: np.random.Generator, seed: int, *, bound: bool = False
) -> list[Row]:
    """Measure a spot as the command does, and return a row along rows and one along columns."""
    picture = one.picture()
    stack = FrameStack(data=by.expose(picture, rng), full_scale_dn=float(2**by.bits - 1))
    result = measure_all("point", stack, context=Context(quick=True, seed=seed))
    rows = []
    for angle in (0.0, 90.0):
        truth = one.mtf50(angle)
        limit, limit_of_size = (
            cramer_rao(one, by, angle, is_shape_free=is_free) if bound else np.nan
            for is_free in (True, False)
        )
        found = result.find("mtf50", orientation_deg=angle)[0]
        low, high = found.interval95 or (np.nan, np.nan)
        value = np.nan if found.value is None else float(found.value)
        rows.append(
            Row(
                kind=one.kind,
                status=found.status,
                flags=found.flags,
                value=value,
                low=low,
                high=high,
                truth=truth,
                bound=limit,
                bound_of_size=limit_of_size,
            )
        )
    return rows


def cramer_rao(one: Spot, by: Camera, angle_deg: float, *, is_shape_free: bool = True) -> float:
    """Return the least standard error of MTF50 by a fit of the spot's own form to one frame, cy/px.

    Free are light, level, place, the first of the form's parameters, which is its size, and with
    `is_shape_free` the others and, where the spot is drawn with one, its shear.
    """
    own = [*one.shape, one.shear]
    free = [index for index, value in enumerate(own) if value != 0.0][
        : None if is_shape_free else 1
    ]

    def moved(index: int, by_: float) -> Spot:
        parameters = own.copy()
        parameters[index] += by_
        return replace(one, shape=tuple(parameters[:-1]), shear=parameters[-1])

    def placed(across: float, down: float) -> Spot:
        return replace(one, place=(one.place[0] + across, one.place[1] + down))

    picture = one.picture()
    scale = by.peak_sd * by.dark_e / picture.max()
    step = 1e-3
    columns = [scale * picture, np.ones_like(picture)]
    columns += [
        scale * (placed(*move).picture() - picture) / step for move in ((step, 0.0), (0.0, step))
    ]
    columns += [scale * (moved(index, step).picture() - picture) / step for index in free]
    design = np.stack([column.ravel() for column in columns], axis=1) / np.sqrt(
        by.variance_e2(picture)
    ).reshape(-1, 1)
    slope = np.zeros(design.shape[1])
    slope[4:] = [
        (moved(index, step).mtf50(angle_deg) - one.mtf50(angle_deg)) / step for index in free
    ]
    return float(np.sqrt(slope @ np.linalg.solve(design.T @ design, slope)))


def table(count: int, seed: int, first: int = 0) -> list[Row]:
    """Return the rows of so many spots from a number on, the kinds in turn."""
    rows = []
    for number in range(first, first + count):
        rng = np.random.default_rng([seed, number])
        rows += measured(spot(KINDS[number % len(KINDS)], rng), camera(rng), rng, number)
    return rows


def at_the_bound(count: int, seed: int, first: int = 0) -> list[Row]:
    """Return the rows of so many single frames with a peak of `FAINT` standard deviations, from a
    number on.
    """
    rows = []
    for number in range(first, first + count):
        rng = np.random.default_rng([seed, 10_000 + number])
        rows += measured(
            spot(KINDS[number % len(KINDS)], rng), camera(rng, FAINT), rng, number, bound=True
        )
    return rows


def line(name: str, rows: list[Row]) -> str:
    """Return one line of the table."""
    ok = [row for row in rows if row.status == "ok"]
    answered = [row for row in rows if np.isfinite(row.value)]
    miss = np.array([abs(row.value / row.truth - 1.0) for row in answered])
    half = np.array([0.5 * (row.high - row.low) / row.truth for row in answered])
    return (
        f"{name:18s} {len(rows):4d} numbers  ok {100 * len(ok) / len(rows):5.1f} %  95 % of those "
        f"hold {100 * np.mean([row.holds for row in ok]) if ok else np.nan:5.1f} %  of all "
        f"answers {100 * np.mean([row.holds for row in answered]):5.1f} %  silent "
        f"{sum(row.silent for row in rows)}  median error {100 * np.median(miss):5.2f} %  half "
        f"interval {100 * np.median(half):5.2f} %"
    )


def main() -> None:
    """Draw, measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=400, help="spots of the table")
    parser.add_argument(
        "--bound", type=int, default=70, help="single frames held against the bound"
    )
    parser.add_argument("--seed", type=int, default=1, help="of all draws")
    parser.add_argument(
        "--rows", action="store_true", help="print each number that misses or is not ok"
    )
    asked = parser.parse_args()
    rows = table(asked.count, asked.seed)
    for kind in KINDS:
        print(line(kind, [row for row in rows if row.kind == kind]))
    print(line("all", rows))
    flags = sorted({flag for row in rows for flag in row.flags})
    print(
        "flags: " + ", ".join(f"{flag} {sum(flag in row.flags for row in rows)}" for flag in flags)
    )
    if asked.rows:
        for index, row in enumerate(rows):
            if row.status != "ok" or not row.holds:
                print(index // 2, row)
    faint = [row for row in at_the_bound(asked.bound, asked.seed) if np.isfinite(row.value)]
    print(f"peak {FAINT:g} sd, one frame: rms error over the bound, shape free and known")
    for kind in (*KINDS, "all"):
        rows = [row for row in faint if kind in (row.kind, "all")]
        if rows:
            errors = np.array([row.value - row.truth for row in rows])
            ratios = errors / np.array([[row.bound, row.bound_of_size] for row in rows]).T
            free, known = np.sqrt(np.mean(ratios**2, axis=1))
            print(f"  {kind:18s} {len(rows):3d} numbers  {free:.2f}  {known:.2f}")


if __name__ == "__main__":
    main()
