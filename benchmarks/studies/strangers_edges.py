"""Edges that GalSim and prysm draw, measured by `auto`: how many are ok, how well intervals hold,
what fails silently.

`python -m benchmarks.studies.strangers_edges [SEED] [COUNT]` prints one table. The transfer
functions are those of other people's optics packages, the edge spreads their transform with a
square pixel, exact for any direction; frames hold photon and read noise of ordinary cameras and
whole codes. The truth is the frequency along the edge's normal at which the modulus of the same
transfer times pixel falls to one half.
"""

import sys
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from time import process_time

import numpy as np
from numpy.typing import NDArray

from charact.estimators.mtf import measure
from charact.method import Context
from labdata import FrameStack, Measurement

Array = NDArray[np.float64]
Transfer = Callable[[Array], Array]

# Half frequencies of the optics, cy/px: from twice oversampled to aliased as lenses are used.
HALF_FREQUENCY_CY_PER_PX = (0.08, 0.45)
# Samples of an edge spread, places a pixel; the period, px, is far wider than any frame.
PER_PX, PERIOD_PX = 32, 8192
SHARPENED_SHARE = 0.15


@dataclass(frozen=True, kw_only=True)
class Drawn:
    """An edge with its truth.

    Parameters
    ----------
    form
        What blurred it.
    angle_deg
        Direction of its normal from the row direction, degrees.
    mtf50
        Truth, cy/px.
    stack
        Frames.
    """

    form: str
    angle_deg: float
    mtf50: float
    stack: FrameStack


def optics_of(form: str, rng: np.random.Generator) -> Transfer:
    """Return a drawn transfer function of a form, cy/px, its half frequency not yet set
    (scale-free).
    """
    import galsim

    if form == "defocus":
        return defocused(waves=rng.uniform(0.1, 0.6), obscuration=rng.choice([0.0, 0.3]))
    profile = {
        "gaussian": lambda: galsim.Gaussian(sigma=1.0),
        "airy": lambda: galsim.Airy(lam_over_diam=1.0),
        "airy-obscured": lambda: galsim.Airy(lam_over_diam=1.0, obscuration=rng.uniform(0.15, 0.5)),
        "kolmogorov": lambda: galsim.Kolmogorov(fwhm=1.0),
        "moffat": lambda: galsim.Moffat(beta=rng.uniform(2.0, 5.0), fwhm=1.0),
    }[form]()
    fine = np.linspace(0.0, 4.0, 4001)
    table = np.array([profile.kValue(2.0 * np.pi * f, 0.0).real for f in fine])
    return lambda frequency: np.interp(frequency, fine, table, right=0.0)


def defocused(waves: float, obscuration: float) -> Transfer:
    """Return prysm's transfer of a pupil out of focus by waves at its border, cut-off 1 cy/px."""
    from prysm import coordinates, geometry

    size = 512
    x, y = coordinates.make_xy_grid(size, diameter=2.0)
    r, _ = coordinates.cart_to_polar(x, y)
    pupil = geometry.circle(1.0, r).astype(float) - geometry.circle(obscuration, r)
    wave = pupil * np.exp(2j * np.pi * waves * r**2)
    padded = np.zeros((2 * size, 2 * size), complex)
    padded[:size, :size] = wave
    power = np.abs(np.fft.fft2(padded)) ** 2
    autocorrelation = np.fft.ifft2(power).real
    along = autocorrelation[0, :size] / autocorrelation[0, 0]
    frequency = np.arange(size) / size
    return lambda f: np.interp(f, frequency, along, right=0.0)


def half_frequency_of(transfer: Transfer) -> float:
    """Return the lowest frequency at which the modulus of a transfer is one half."""
    fine = np.linspace(1e-4, 4.0, 80001)
    curve = np.abs(transfer(fine))
    index = int(np.argmax(curve < 0.5))
    share = (curve[index - 1] - 0.5) / (curve[index - 1] - curve[index])
    return float(fine[index - 1] + share * (fine[index] - fine[index - 1]))


def with_pixel(transfer: Transfer, angle_rad: float) -> Transfer:
    """Return a transfer times that of a square pixel whose grid stands at an angle."""
    return lambda f: transfer(f) * np.sinc(f * np.cos(angle_rad)) * np.sinc(f * np.sin(angle_rad))


def spread_of(transfer: Transfer, distance: Array) -> Array:
    """Return the edge spread from 0 to 1 at distances: 1/2 + int M sin(2 pi f d)/(pi f) df, by one
    transform.
    """
    size = PER_PX * PERIOD_PX
    frequency = np.fft.rfftfreq(size, 1.0 / PER_PX)
    weight = np.zeros(frequency.size, complex)
    weight[1:] = -0.5j * transfer(frequency[1:]) / (np.pi * frequency[1:]) / PERIOD_PX
    place = np.arange(size // 4) / PER_PX
    half = np.fft.irfft(weight, size)[: place.size] * size + place / PERIOD_PX
    return 0.5 + np.sign(distance) * np.interp(np.abs(distance), place, half)


def drawn_edge(form: str, rng: np.random.Generator, *, sharpened: bool = False) -> Drawn:
    """Draw frames of one edge as an ordinary camera records them."""
    optics = optics_of(form, rng)
    wanted = np.exp(rng.uniform(*np.log(HALF_FREQUENCY_CY_PER_PX)))
    scale = half_frequency_of(optics) / wanted
    angle = rng.uniform(2.0, 88.0) if rng.random() > 0.15 else 45.0
    angle = np.deg2rad(angle + rng.choice([0.0, 90.0, 180.0, 270.0]))
    seen = with_pixel(lambda f: optics(f * scale), angle)
    rows, cols = rng.integers(96, 200, 2)
    row, col = np.arange(rows)[:, None] - (rows - 1) / 2, np.arange(cols)[None, :] - (cols - 1) / 2
    spread = spread_of(seen, col * np.cos(angle) + row * np.sin(angle) - rng.uniform(-6.0, 6.0))
    bits, full_well_e = int(rng.choice([8, 10, 12, 14, 16])), rng.uniform(8e3, 3e4)
    top = 2.0**bits - 1.0
    step = rng.uniform(0.2, 0.7)
    dark = rng.uniform(0.03, 0.9 - step)
    frames = int(rng.choice([1, 1, 1, 4, 16]))
    electrons = (dark + step * spread) * full_well_e
    signal = rng.poisson(electrons, (frames, rows, cols)) + rng.normal(
        0.0, rng.uniform(2.0, 8.0), (frames, rows, cols)
    )
    codes = signal * (0.96 * top / full_well_e) + rng.uniform(0.0, 0.03) * top
    if sharpened:
        codes = _unsharp(codes, rng.uniform(0.8, 2.0), rng.uniform(0.3, 1.5))
    kind = np.uint8 if bits == 8 else np.uint16
    stack = FrameStack(data=np.clip(np.rint(codes), 0, top).astype(kind))
    return Drawn(
        form=form, angle_deg=float(np.rad2deg(angle)), mtf50=half_frequency_of(seen), stack=stack
    )


def _unsharp(codes: Array, radius_px: float, amount: float) -> Array:
    from scipy.ndimage import gaussian_filter

    return codes + amount * (codes - gaussian_filter(codes, (0.0, radius_px, radius_px)))


FORMS = ("gaussian", "airy", "airy-obscured", "defocus", "kolmogorov", "moffat")


def draws(seed: int, count: int, *, sharpened: bool = False) -> Iterator[Drawn]:
    """Yield so many edges, every form in turn, each of its own seed."""
    for number in range(count):
        rng = np.random.default_rng([seed, number, int(sharpened)])
        yield drawn_edge(FORMS[number % len(FORMS)], rng, sharpened=sharpened)


@dataclass(frozen=True, kw_only=True)
class Row:
    """What was made of one edge."""

    drawn: Drawn
    found: Measurement
    seconds: float

    @property
    def ok(self) -> bool:
        """Whether a number is given without a flag."""
        return self.found.status == "ok"

    @property
    def error(self) -> float:
        """Relative error; NaN where no number is given."""
        return np.nan if self.found.value is None else self.found.value / self.drawn.mtf50 - 1.0

    @property
    def halves(self) -> float:
        """Error over the half of the 95 % interval on its side."""
        if self.found.value is None or self.found.interval95 is None:
            return np.nan
        low, high = self.found.interval95
        away = self.drawn.mtf50 - self.found.value
        return abs(away) / max(
            high - self.found.value if away > 0 else self.found.value - low, 1e-12
        )


def measured(edges: Iterator[Drawn], *, quick: bool = True) -> list[Row]:
    """Measure the most prominent edge of each by `auto`."""
    rows = []
    for one in edges:
        begin = process_time()
        found = measure("edge", one.stack, context=Context(quick=quick)).find("mtf50")[0]
        rows.append(Row(drawn=one, found=found, seconds=process_time() - begin))
    return rows


def line_of(name: str, rows: list[Row]) -> str:
    """Return a line of the table."""
    ok = [one for one in rows if one.ok]
    halves, errors = np.array([one.halves for one in ok]), np.array([abs(one.error) for one in ok])
    widths = [
        0.5 * (one.found.interval95[1] - one.found.interval95[0]) / one.drawn.mtf50
        for one in ok
        if one.found.interval95
    ]
    held, silent = int(np.sum(halves <= 1.0)), int(np.sum(halves > 2.0))
    flags = Counter(flag for one in rows for flag in one.found.flags)
    flags["refused"] += sum(one.found.status == "refused" for one in rows)
    told = " ".join(f"{flag}:{number}" for flag, number in flags.most_common() if number)
    middle = (np.median(errors), np.median(widths)) if ok else (np.nan, np.nan)
    return (
        f"{name:14s} {len(rows):4d} {100 * len(ok) / len(rows):5.1f} "
        f"{100 * held / max(len(ok), 1):6.1f} {silent:6d} {100 * middle[0]:7.2f} "
        f"{100 * middle[1]:7.2f}  {told}"
    )


def table_of(rows: list[Row], sharpened: list[Row]) -> str:
    """Return the table as text."""
    head = (
        f"{'edges of':14s} {'all':>4s} {'ok %':>5s} {'held %':>6s} {'silent':>6s} "
        f"{'error %':>7s} {'half %':>7s}  flags"
    )
    by_form = {form: [one for one in rows if one.drawn.form == form] for form in FORMS}
    lines = [line_of(form, of_form) for form, of_form in by_form.items() if of_form]
    at_45 = [one for one in rows if abs(one.drawn.angle_deg % 90.0 - 45.0) < 1e-9]
    groups = {"all": rows, "at 45 or 135": at_45, "sharpened": sharpened}
    return "\n".join(
        [head, *lines, *(line_of(name, of_group) for name, of_group in groups.items() if of_group)]
    )


def main() -> None:
    """Draw, measure, print."""
    seed, count = (int(one) for one in (*sys.argv[1:], *("1", "400")[len(sys.argv) - 1 :]))
    rows = measured(draws(seed, count))
    sharpened = measured(draws(seed, round(SHARPENED_SHARE * count), sharpened=True))
    print(table_of(rows, sharpened))
    print(f"{np.median([one.seconds for one in rows]):.3f} s of processor time an edge (median)")
    for one in rows:
        if one.ok and one.halves > 1.5:
            print(
                f"{one.drawn.form} {one.drawn.angle_deg:.1f} deg, {one.drawn.stack.shape}: "
                f"{one.found.value:.4f} for {one.drawn.mtf50:.4f} cy/px, {one.halves:.1f} half "
                "intervals"
            )


if __name__ == "__main__":
    main()
