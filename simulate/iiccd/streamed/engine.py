"""Frames of a steady scene at video rate: what does not change is computed once, the rest in a few passes."""

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache
from itertools import count, pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulate.iiccd.automatic import AutomaticState
from simulate.iiccd.streamed.kernel import COARSE, REACH, Kernel
from simulate.iiccd.streamed.law import normal_quantiles

# The screen's state is drawn anew, from the fields before, at the start of each run of so many frames: a frame depends
# on the seed and on its own number alone, whichever frame is drawn first.
SEGMENT_FRAMES = 128
# What a generator is for, the planes of cells besides.
ION, CHARGE, COUNTED, READ = 60, 61, 62, 63

Frame = NDArray[np.unsignedinteger]
States = Callable[[int], AutomaticState]


@dataclass(frozen=True, kw_only=True)
class Steady:
    """A steady scene made ready.

    Parameters
    ----------
    expected, inverse, rows
        Mean number of detected photoelectrons of every cell, the inverse of the probability of any, and the row of the
        law, shape (plane, row, col).
    gain
        CCD electrons per mean pulse of every cell, shape (plane, row, col).
    shape, quantiles
        Gamma shape of pulses, and the rows of their law, flat.
    ions_per_field, ion_size
        Ion events on all cells in one exposure, and their mean number of pulses.
    kernel
        Spread of the noise; the first cell lies under the kernel of the first pixel.
    light_e
        Mean charge that light brings to every pixel, e-, shape (row, col).
    response
        Response of the pixels, shape (row, col), or (1, 1) where all are alike.
    dark_pattern_e
        Dark charge of the pixels about its mean, e-, shape (row, col), or (1, 1) where all are alike.
    decay
        Mean share stored, its standard deviation, and share kept, of each component of the screen's decay, shape
        (3, component).
    lateness
        Skewness of what pulses leave to later exposures, over their times of arrival, dimensionless.
    memory
        Exposures after which the screen has forgotten.
    fields
        Exposures in a frame.
    """

    expected: NDArray[np.float32]
    inverse: NDArray[np.float32]
    rows: NDArray[np.uint16]
    gain: NDArray[np.float32]
    shape: float
    quantiles: NDArray[np.float32]
    ions_per_field: float
    ion_size: float
    kernel: Kernel
    light_e: NDArray[np.float32]
    response: NDArray[np.float32]
    dark_pattern_e: NDArray[np.float32]
    decay: NDArray[np.float32]
    lateness: float
    memory: int
    fields: int


@dataclass(frozen=True, kw_only=True)
class Readout:
    """What the CCD and the electronics behind it add.

    Parameters
    ----------
    dark_e, read_noise_e
        Mean dark charge of a pixel and standard deviation of reading, e-.
    counted
        Whether charge is so little that its electrons are counted out one by one.
    held
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
    held: Callable[[NDArray[np.float32]], NDArray[np.float32]] | None
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
        return self.counted or self.held is not None


class Stream:
    """A steady scene in front of a camera, with what the screen still holds from one exposure to the next."""

    def __init__(self, scene: Steady, readout: Readout, states: States, *, seed: int, threads: int) -> None:
        self._scene, self._readout, self._states = scene, readout, states
        self._seed, self._threads = seed, threads
        planes, rows, cols = scene.gain.shape
        self._stored = np.zeros((planes, scene.decay.shape[1], rows, cols), np.float32)
        self._shown = np.empty((planes, rows, cols), np.float32)
        self._coarse = np.empty((rows // COARSE, cols // COARSE), np.float32)
        # What is stored of the mean, relative to a steady scene of untouched brightness.
        self._stored_mean = np.ones(scene.decay.shape[1])
        self._charge = np.empty(scene.light_e.shape, np.float32)

    def frames(self, first_frame: int = 0) -> Iterator[Frame]:
        """Yield frames from a number on; never ends."""
        for frame in count(first_frame - first_frame % SEGMENT_FRAMES):
            if frame % SEGMENT_FRAMES == 0:
                self._begin_segment(frame)
            if frame >= first_frame:
                yield self._frame(frame)
            else:
                self._expose_all(frame * self._scene.fields, (frame + 1) * self._scene.fields)

    def _begin_segment(self, frame: int) -> None:
        self._stored[:] = 0.0
        field = frame * self._scene.fields
        self._stored_mean[:] = self._states(max((field - self._scene.memory) // self._scene.fields, 0)).brightness
        self._expose_all(field - self._scene.memory, field)

    def _expose_all(self, first: int, last: int) -> None:
        for field in range(first, last):
            self._expose(field)

    def _frame(self, frame: int) -> Frame:
        largest = 0.0
        for parity in range(self._scene.fields):
            brightness = self._expose(frame * self._scene.fields + parity)
            largest = max(largest, self._collect(frame, parity, brightness))
        charge = self._charge
        if self._readout.counted:
            charge = self._count(charge, frame)
            largest = np.inf
        if self._readout.held is not None and largest > 0.0:
            charge = self._readout.held(charge)
        return self._read(charge, frame)

    def _expose(self, field: int) -> float:
        """Draw one exposure's pulses and let the screen glow; the factor of the mean light that it shows."""
        from simulate.iiccd.streamed.passes import glow_rows

        scene = self._scene
        brightness = self._states(max(field // scene.fields, 0)).brightness
        self._coarse[:] = 0.0
        law = scene.quantiles, *_single(scene.shape, scene.lateness, brightness, self._ion_pulses_per_cell)
        ions = self._ions(field)

        def work(first: int, last: int) -> None:
            for plane in range(len(scene.gain)):
                cells = scene.expected[plane], scene.inverse[plane], scene.rows[plane], scene.gain[plane]
                drawn = ions if plane == 0 else _NO_IONS
                screen = scene.decay, self._stored[plane], self._shown[plane], self._coarse
                glow_rows(first, last, self._key(plane, field), *cells, law, drawn, *screen)

        self._shared(work, len(self._coarse) * COARSE, COARSE)
        return self._mean_shown(brightness)

    def _mean_shown(self, brightness: float) -> float:
        later, _, kept = self._scene.decay.astype(float)
        shown = brightness * (1.0 - later.sum())
        # Stored light of component i, in a steady scene: later / (1 - kept).
        shown += float(np.sum(later * self._stored_mean))
        self._stored_mean = kept * self._stored_mean + (1.0 - kept) * brightness
        return shown

    @property
    def _ion_pulses_per_cell(self) -> float:
        scene = self._scene
        return scene.ions_per_field * scene.ion_size / scene.gain[0].size / len(scene.gain)

    def _ions(self, field: int) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float32]]:
        """Rows, columns and pulses of the ion events of one exposure."""
        scene = self._scene
        if scene.ions_per_field == 0.0:
            return _NO_IONS
        rng = np.random.default_rng([self._seed, ION, field + 2**32])
        number = rng.poisson(scene.ions_per_field)
        rows, cols = (rng.integers(n, size=number) for n in scene.gain.shape[1:])
        pulses = rng.gamma(rng.poisson(scene.ion_size, size=number) * scene.shape) / scene.shape
        return rows, cols, pulses.astype(np.float32)

    def _collect(self, frame: int, parity: int, brightness: float) -> float:
        """Spread one exposure over the pixels that it is read from; the largest charge, e-."""
        from simulate.iiccd.streamed.passes import charge_rows

        scene, readout = self._scene, self._readout
        wing = far_wing(scene.kernel, self._coarse, scene.light_e.shape)
        variance = readout.dark_e + (0.0 if readout.reads_apart else readout.read_noise_e**2)
        kernel = scene.kernel.down, scene.kernel.along
        patterns = scene.response, scene.dark_pattern_e
        noise = np.float32(brightness), readout.counted, np.float32(variance)
        largest = [0.0]

        def work(first: int, last: int) -> None:
            start = first + (parity - first) % scene.fields
            found = charge_rows(
                start, last, scene.fields, self._key(CHARGE, frame), self._shown, kernel, wing, scene.light_e, patterns,
                noise, normal_quantiles(), self._charge,
            )  # fmt: skip
            largest.append(float(found))

        self._shared(work, len(scene.light_e), 1)
        return max(largest)

    def _count(self, charge: NDArray[np.float32], frame: int) -> NDArray[np.float32]:
        from simulate.iiccd.draws import poisson_charge

        dark = np.float32(self._readout.dark_e)
        rng = np.random.default_rng([self._seed, COUNTED, frame + 2**32])
        return poisson_charge(rng, charge + dark) - dark

    def _read(self, charge: NDArray[np.float32], frame: int) -> Frame:
        from simulate.iiccd.streamed.passes import read_rows

        readout = self._readout
        codes = np.empty(charge.shape, np.uint8 if readout.top_dn < 256 else np.uint16)
        read = readout.read_noise_e if readout.reads_apart else 0.0
        gain = readout.gain_dn_per_e * self._states(frame).gain
        noise = _single(read, readout.jitter_px, readout.line_noise_dn)
        levels = _single(gain, readout.black_dn, readout.top_dn, readout.gamma)

        def work(first: int, last: int) -> None:
            key = self._key(READ, frame)
            read_rows(first, last, key, charge, readout.impulse, noise, levels, normal_quantiles(), codes)

        self._shared(work, len(charge), 1)
        return codes

    def _key(self, purpose: int, number: int) -> np.uint64:
        # Exposures before the first frame, whose light it still shows, have numbers below zero; seeds may not.
        return np.random.SeedSequence([self._seed, purpose, number + 2**32]).generate_state(1, np.uint64)[0]

    def _shared(self, work: Callable[[int, int], None], rows: int, block: int) -> None:
        """Do all rows in bands of whole blocks, one for each thread."""
        if self._threads == 1:
            work(0, rows)
            return
        borders = np.linspace(0, -(-rows // block), self._threads + 1).round().astype(int) * block
        bands = [(int(a), int(min(b, rows))) for a, b in pairwise(borders) if a < b]
        for done in [_pool(self._threads).submit(work, *band) for band in bands]:
            done.result()


_NO_IONS = (np.empty(0, np.int64), np.empty(0, np.int64), np.empty(0, np.float32))


def far_wing(
    kernel: Kernel, coarse: NDArray[np.float32], shape: tuple[int, ...]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the far wing on coarse rows and the frame's columns, and each frame row's place among the coarse rows.

    Parameters
    ----------
    kernel
        Spread of the noise.
    coarse
        Noise summed over coarse cells, shape (coarse row, coarse col).
    shape
        Rows and columns of the frame.
    """
    from scipy import fft

    size = coarse.shape[0] + kernel.wing.shape[0], coarse.shape[1] + kernel.wing.shape[1]
    transform = _transform(kernel.wing.tobytes(), kernel.wing.shape, size)
    middle = kernel.wing.shape[0] // 2
    spectrum: Any = fft.rfft2(coarse, size)
    spread: Any = fft.irfft2(spectrum * transform, size)
    spread = spread[middle : middle + coarse.shape[0], middle : middle + coarse.shape[1]]
    rows, left, share = _places(coarse.shape, kernel.height, shape)
    return spread[:, left] * (1 - share) + spread[:, left + 1] * share, rows


@lru_cache(maxsize=4)
def _transform(wing: bytes, shape: tuple[int, ...], size: tuple[int, int]) -> NDArray[np.complex64]:
    from scipy import fft

    transform: Any = fft.rfft2(np.frombuffer(wing, np.float32).reshape(shape), size)
    return transform


@lru_cache(maxsize=4)
def _places(
    coarse: tuple[int, ...], height: int, shape: tuple[int, ...]
) -> tuple[NDArray[np.float32], NDArray[np.intp], NDArray[np.float32]]:
    """Places of the frame's rows and columns among the centres of coarse cells, columns as whole and fraction."""
    centres = REACH + 0.5 * height, REACH + 0.5
    rows, cols = (
        np.clip((centre + np.arange(n)) / COARSE - 0.5, 0.0, cells - 1.001).astype(np.float32)
        for centre, n, cells in zip(centres, shape, coarse, strict=True)
    )
    left = cols.astype(np.intp)
    return rows, left, (cols - left).astype(np.float32)


def _single(*numbers: float) -> tuple[np.float32, ...]:
    return tuple(np.float32(number) for number in numbers)


@lru_cache(maxsize=4)
def _pool(threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(threads, thread_name_prefix="charact-frames")
