"""Frame generator of the fast sampler: a static scene prepared once, then a few compiled passes per frame."""

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache
from itertools import count, pairwise
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from simulate.iiccd.automatic_controls import AutomaticState
from simulate.iiccd.fast_sampler.charge_distribution import normal_quantiles
from simulate.iiccd.fast_sampler.kernel import COARSE, REACH

# Does work on rows in bands of whole blocks: (work of first and last row, rows, rows in a block).
Shared = Callable[[Callable[[int, int], None], int, int], None]


class OuterWing(Protocol):
    """Part of the spread outside the compact kernel; names as in `Kernel`."""

    @property
    def height(self) -> int:
        """Rows of the chip in a pixel as read."""
        ...

    @property
    def wing(self) -> NDArray[np.float32]:
        """Weights of coarse cells."""
        ...


class PhosphorSampler(Protocol):
    """The phosphor from one exposure to the next.

    Parameters
    ----------
    shown
        Electrons beyond the mean that come out in each exposure of a frame, shape (exposure, plane, row, col).
    spread
        Separable kernels that take them to pixels, two of shape (plane, rank, tap).
    """

    shown: NDArray[np.float32]
    spread: tuple[NDArray[np.float32], NDArray[np.float32]]

    @property
    def far(self) -> OuterWing:
        """Part of the spread outside the compact kernels."""
        ...

    def forget(self) -> None:
        """Reset the stored light to its mean."""
        ...

    def expose(self, frame: int, brightness: float, shared: Shared) -> NDArray[np.float32]:
        """Draw the pulses of a frame's exposures, `brightness` times the mean light, and apply phosphor decay.

        Returns
        -------
        NDArray
            What each exposure shows beyond the mean, summed over coarse cells, shape (exposure, coarse row, coarse
            col).
        """
        ...


class EventSampler(Protocol):
    """Prepared light behind the gain."""

    @property
    def pulse_e(self) -> float:
        """Variance of a pixel's charge over its mean, from pulses alone, e-."""
        ...

    def phosphor_sampler(self, seed: int) -> PhosphorSampler:
        """Return the phosphor in its initial state."""
        ...


def key_of(seed: int, purpose: int, number: int) -> np.uint64:
    """Return the key of the random generator of one exposure."""
    # Exposures before the first frame, whose light it still shows, have numbers below zero; seeds may not.
    return np.random.SeedSequence([seed, purpose, number + 2**32]).generate_state(1, np.uint64)[0]


def float32_values(*numbers: float) -> tuple[np.float32, ...]:
    """Return numbers in single precision."""
    return tuple(np.float32(number) for number in numbers)


# The phosphor's state is drawn again, from the fields before, at the start of each segment: a frame depends on the seed
# and on its own number alone.
SEGMENT_FRAMES = 128
# What a generator is for; light has others.
CHARGE, COUNTED, READ = 61, 62, 63

Frame = NDArray[np.unsignedinteger]
States = Callable[[int], AutomaticState]


@dataclass(frozen=True, kw_only=True)
class StaticScene:
    """Static scene, prepared for the frame generator.

    Parameters
    ----------
    light
        How its pulses are drawn.
    light_e
        Mean charge that light brings to every pixel, e-, shape (row, col).
    response
        Response of the pixels, shape (row, col), or (1, 1) where all are alike.
    dark_pattern_e
        Dark charge of the pixels about its mean, e-, shape (row, col), or (1, 1) where all are alike.
    stays, kept
        Mean fraction of a pulse that each component of the phosphor's decay stores, and the fraction of what is
        stored that stays stored for one exposure more, shape (component,).
    n_lag_fields
        Number of exposures to which the phosphor decay extends.
    fields
        Exposures in a frame.
    """

    light: EventSampler
    light_e: NDArray[np.float32]
    response: NDArray[np.float32]
    dark_pattern_e: NDArray[np.float32]
    stays: NDArray[np.float64]
    kept: NDArray[np.float64]
    n_lag_fields: int
    fields: int


@dataclass(frozen=True, kw_only=True)
class Readout:
    """Parameters of CCD readout and electronics.

    Parameters
    ----------
    dark_e, read_noise_e
        Mean dark charge of a pixel and standard deviation of reading, e-.
    counted
        Whether charge is so little that its electrons are counted out one by one.
    limit_charge
        What the wells hold of a frame's charge; None where no well can overflow.
    impulse
        Impulse response along a line, shape (tap,).
    jitter_px, line_noise_dn
        Standard deviations of the start of a line and of an offset common to it.
    gain_dn_per_e, black_dn, gamma, top_dn
        DN per electron, DN without charge, exponent, highest code.
    """

    dark_e: float
    read_noise_e: float
    counted: bool
    limit_charge: Callable[[NDArray[np.float32]], NDArray[np.float32]] | None
    impulse: NDArray[np.float32]
    jitter_px: float
    line_noise_dn: float
    gain_dn_per_e: float
    black_dn: float
    gamma: float
    top_dn: int

    @property
    def reads_apart(self) -> bool:
        """Whether the noise of reading is drawn after the charge has settled, not together with that of the charge."""
        return self.counted or self.limit_charge is not None


class FrameGenerator:
    """Generates the frames of a static scene."""

    def __init__(self, scene: StaticScene, readout: Readout, states: States, *, seed: int, threads: int) -> None:
        self._scene, self._readout, self._states = scene, readout, states
        self._seed, self._threads = seed, threads
        self._sampler = scene.light.phosphor_sampler(seed)
        # What is stored of the mean, relative to a steady scene of untouched brightness.
        self._stored_mean = np.ones(len(scene.stays))
        self._charge = np.empty(scene.light_e.shape, np.float32)
        self._mean_of: tuple[tuple[float, ...], NDArray[np.float32]] = (), scene.light_e

    def frames(self, first_frame: int = 0) -> Iterator[Frame]:
        """Yield frames from a number on; never ends."""
        for frame in count(first_frame - first_frame % SEGMENT_FRAMES):
            if frame % SEGMENT_FRAMES == 0:
                self._begin_segment(frame)
            coarse, brightness = self._expose(frame)
            if frame >= first_frame:
                yield self._read(frame, coarse, brightness)

    def _begin_segment(self, frame: int) -> None:
        before = -(-self._scene.n_lag_fields // self._scene.fields)
        self._sampler.forget()
        self._stored_mean[:] = self._states(max(frame - before, 0)).brightness
        for earlier in range(frame - before, frame):
            self._expose(earlier)

    def _expose(self, frame: int) -> tuple[NDArray[np.float32], tuple[float, ...]]:
        """Expose a frame: light beyond the mean on coarse cells, and the factors of the mean light."""
        factor = self._states(max(frame, 0)).brightness
        coarse = self._sampler.expose(frame, factor, self._run_in_bands)
        return coarse, tuple(self._mean_shown(factor) for _ in range(self._scene.fields))

    def _mean_shown(self, brightness: float) -> float:
        later, kept = self._scene.stays, self._scene.kept
        # Of a steady scene a component stores later / (1 - kept) and gives back later.
        shown = brightness * (1.0 - later.sum()) + float(np.sum(later * self._stored_mean))
        self._stored_mean = kept * self._stored_mean + (1.0 - kept) * brightness
        return shown

    def _read(self, frame: int, coarse: NDArray[np.float32], brightness: tuple[float, ...]) -> Frame:
        """Spread a frame's exposures over the pixels that are read from them, and read these."""
        from simulate.iiccd.fast_sampler.charge_rows import charge_rows, read_rows

        scene, readout, normal = self._scene, self._readout, normal_quantiles()
        codes = np.empty(self._charge.shape, np.uint8 if readout.top_dn < 256 else np.uint16)
        wing = far_wing(self._sampler.far, coarse, scene.light_e.shape)
        mean, electronics = self._mean(brightness), self._electronics(frame)
        variance = readout.dark_e + (0.0 if readout.reads_apart else readout.read_noise_e**2)
        noise = readout.counted, np.float32(variance)
        key, read_key = key_of(self._seed, CHARGE, frame), key_of(self._seed, READ, frame)

        def collect(first: int, last: int) -> None:
            read = readout.reads_apart, read_key, *electronics
            charge_rows(
                first,
                last,
                key,
                self._sampler.shown,
                self._sampler.spread,
                wing,
                mean,
                scene.response,
                noise,
                normal,
                read,
                self._charge,
                codes,
            )

        self._run_in_bands(collect, len(codes), 1)
        if readout.reads_apart:
            charge = self._charge_in_wells(frame)
            self._run_in_bands(
                lambda a, b: read_rows(a, b, read_key, charge, *electronics, normal, codes), len(codes), 1
            )
        return codes

    def _mean(self, brightness: tuple[float, ...]) -> NDArray[np.float32]:
        """Mean charge of every pixel, the dark charge's pattern included, e-."""
        if brightness != self._mean_of[0]:
            factor = np.resize(np.array(brightness, np.float32), len(self._scene.light_e))[:, None]
            mean = factor * self._scene.light_e + self._scene.dark_pattern_e
            self._mean_of = brightness, np.ascontiguousarray(mean)
        return self._mean_of[1]

    def _electronics(self, frame: int) -> tuple[NDArray[np.float32], tuple[np.float32, ...], tuple[np.float32, ...]]:
        """Impulse response, noise and levels of reading a frame."""
        readout = self._readout
        read = readout.read_noise_e if readout.reads_apart else 0.0
        gain = readout.gain_dn_per_e * self._states(frame).gain
        noise = float32_values(read, readout.jitter_px, readout.line_noise_dn)
        return readout.impulse, noise, float32_values(gain, readout.black_dn, readout.top_dn, readout.gamma)

    def _charge_in_wells(self, frame: int) -> NDArray[np.float32]:
        """Charge in whole electrons where electrons are few, limited to the full well."""
        charge, readout = self._charge, self._readout
        if readout.counted:
            from simulate.iiccd.pulse_sampling import poisson_charge

            dark = np.float32(readout.dark_e)
            rng = np.random.default_rng([self._seed, COUNTED, frame + 2**32])
            charge = poisson_charge(rng, charge + dark) - dark
        return charge if readout.limit_charge is None else readout.limit_charge(charge)

    def _run_in_bands(self, work: Callable[[int, int], None], rows: int, block: int) -> None:
        """Do all rows in bands of whole blocks, one for each thread."""
        if self._threads == 1:
            work(0, rows)
            return
        borders = np.linspace(0, -(-rows // block), self._threads + 1).round().astype(int) * block
        bands = [(int(a), int(min(b, rows))) for a, b in pairwise(borders) if a < b]
        for done in [_pool(self._threads).submit(work, *band) for band in bands]:
            done.result()


def far_wing(
    kernel: OuterWing, coarse: NDArray[np.float32], shape: tuple[int, ...]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the far wing on coarse rows and the frame's columns, and each frame row's place among the coarse rows.

    Parameters
    ----------
    kernel
        Spread of the noise.
    coarse
        Noise summed over coarse cells, shape (..., coarse row, coarse col).
    shape
        Rows and columns of the frame.
    """
    from scipy import fft

    from simulate.iiccd.fast_sampler.charge_rows import interpolate_columns

    rows, cols = coarse.shape[-2:]
    size = tuple(fft.next_fast_len(n + m, real=True) for n, m in zip((rows, cols), kernel.wing.shape, strict=True))
    transform = _transform(kernel.wing.tobytes(), kernel.wing.shape, size)
    middle = kernel.wing.shape[0] // 2
    spectrum: Any = fft.rfft2(coarse, size)
    spread: Any = fft.irfft2(spectrum * transform, size)
    spread = spread[..., middle : middle + rows, middle : middle + cols]
    places, left, right, share = _places((rows, cols), kernel.height, shape)
    # A row beyond the last, which the rows of the frame look at with no weight.
    wide = np.empty((*coarse.shape[:-2], rows + 1, shape[1]), np.float32)
    interpolate_columns(
        np.ascontiguousarray(spread, np.float32).reshape(-1, rows, cols),
        left,
        right,
        share,
        wide.reshape(-1, rows + 1, shape[1]),
    )
    return wide, places


@lru_cache(maxsize=4)
def _transform(wing: bytes, shape: tuple[int, ...], size: tuple[int, ...]) -> NDArray[np.complex64]:
    from scipy import fft

    transform: Any = fft.rfft2(np.frombuffer(wing, np.float32).reshape(shape), size)
    return transform


@lru_cache(maxsize=4)
def _places(
    coarse: tuple[int, ...], height: int, shape: tuple[int, ...]
) -> tuple[NDArray[np.float32], NDArray[np.uint32], NDArray[np.uint32], NDArray[np.float32]]:
    """Positions of the frame's rows and columns between the centres of coarse cells."""
    centres = REACH + 0.5 * height, REACH + 0.5
    rows, cols = (
        np.clip((centre + np.arange(n)) / COARSE - 0.5, 0.0, cells - 1.0).astype(np.float32)
        for centre, n, cells in zip(centres, shape, coarse, strict=True)
    )
    left = cols.astype(np.uint32)
    return rows, left, np.minimum(left + 1, coarse[1] - 1).astype(np.uint32), (cols - left).astype(np.float32)


@lru_cache(maxsize=4)
def _pool(threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(threads, thread_name_prefix="charact-frames")
