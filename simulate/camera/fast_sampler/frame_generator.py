"""Frame generator of the fast sampler: exposures prepared once, then a few compiled passes per
frame.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import count, islice, pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from labdata.errors import BadInput
from labdata.frames import read_only
from simulate.arrays import Array32
from simulate.camera.automatic_controls import UNTOUCHED, AutomaticState
from simulate.camera.chain import Chain, Slot
from simulate.camera.fast_sampler.charge_distribution import normal_quantiles
from simulate.camera.fast_sampler.charge_rows import charge_rows, interpolate_columns, read_rows
from simulate.camera.fast_sampler.event_samplers import Exposure, prepare_exposure
from simulate.camera.fast_sampler.kernel import COARSE, REACH, Kernel, PulseKernel
from simulate.camera.grid import ACCURACY
from simulate.camera.random_numbers import key_of, poisson_numbers
from simulate.camera.stage_image import StageImage

Frame = NDArray[np.unsignedinteger]
# The phosphor's state is drawn again, from the fields before, at the start of each segment: a frame
# depends on the seed and on its own number alone.
SEGMENT_FRAMES = 128
# What a generator is for; light has others.
CHARGE, COUNTED, READ = 61, 62, 63
EMPTY = np.zeros((1, 1), np.float32)


@dataclass(frozen=True, kw_only=True)
class _Wells:
    """What may happen to the charge of a frame: electrons counted one by one where they are few,
    wells overflowing.
    """

    counts_electrons: bool
    overflow: bool

    @property
    def reads_later(self) -> bool:
        """Whether the noise of reading is drawn after the charge has settled, not together with
        that of the charge.
        """
        return self.counts_electrons or self.overflow


class FrameGenerator:
    """Generates frames of static or moving scenes.

    It takes the whole chain of a camera, its automatic controls untouched, and the exposures in a
    frame; so many threads share a frame, which does not depend on their number.
    """

    def __init__(self, chain: Chain, fields: int, *, seed: int, threads: int) -> None:
        self._chain, self._fields, self._seed, self._threads = chain, fields, seed, threads
        self._mcp, self._ccd, self._video = chain[Slot.MCP], chain[Slot.CCD], chain[Slot.VIDEO]
        self._decay = chain[Slot.DECAY]
        self._stored_fraction, _, self._kept_fraction = self._decay.recursion.astype(float)
        self._taps = np.array(self._video.taps, np.float32)

    def _prepare(self, exposure: Exposure) -> None:
        """Make the phosphor and the patterns of the frame that an exposure has."""
        shape, ccd = exposure.light_e.shape, self._ccd
        self._screen: Any = exposure.light.screen(self._decay, self._fields, self._seed, shape)
        dark = ccd.dark(shape) + ccd.offsets(shape) - np.float32(ccd.dark_e)
        dark = dark + self._video.charge_of_offsets()
        self._dark_pattern = np.ascontiguousarray(dark) if np.ndim(dark) == 2 else EMPTY
        responses = ccd.responses(shape)
        # Read only, as maps are: what is written to would be compiled for once more.
        self._response = read_only(EMPTY if responses is None else responses)
        self._charge = np.empty(shape, np.float32)

    def static(
        self,
        at_mcp: StageImage,
        state_of: Callable[[int], AutomaticState],
        first_frame: int,
        *,
        sparse: bool,
    ) -> Iterator[Frame]:
        """Yield the frames of a static scene from a number on, by the state of the controls in
        each; never ends.
        """
        exposure = prepare_exposure(self._chain, at_mcp, self._fields, sparse=sparse)
        exposures, light_e = [exposure] * self._fields, exposure.light_e
        self._prepare(exposure)
        wells = self._wells_of(float(light_e.max()), exposure)
        lag_frames = -(-self._decay.n_lag_fields // self._fields)

        @lru_cache(maxsize=256)
        def output_factor(brightness: float) -> float:
            """Output of the MCP, which saturates, over that of untouched brightness."""
            plates = (
                replace(self._mcp, gain=self._mcp.gain * factor) for factor in (brightness, 1.0)
            )
            output, reference = (
                float(plate.mean(at_mcp).values.sum(dtype=float)) for plate in plates
            )
            return output / reference

        def brightness_of(frame: int) -> float:
            brightness = state_of(max(frame, 0)).brightness
            return 1.0 if brightness == 1.0 else output_factor(brightness)

        @lru_cache(maxsize=1)
        def mean(shown: tuple[float, ...]) -> Array32:
            by_row = np.resize(np.array(shown, np.float32), len(light_e))[:, None]
            return np.ascontiguousarray(by_row * light_e + self._dark_pattern)

        def expose(frame: int) -> tuple[Array32, tuple[float, ...]]:
            brightness = brightness_of(frame)
            coarse = self._screen.expose(
                frame, [e.light for e in exposures], brightness, self._run_in_bands
            )
            return coarse, tuple(float(self._mean_shown(brightness)) for _ in exposures)

        for frame in count(first_frame - first_frame % SEGMENT_FRAMES):
            if frame % SEGMENT_FRAMES == 0:
                self._screen.forget()
                # What is stored of the mean, relative to a steady scene of untouched brightness.
                self._stored_mean: list[Any] = [brightness_of(frame - lag_frames)] * len(
                    self._stored_fraction
                )
                for lag_frame in range(frame - lag_frames, frame):
                    expose(lag_frame)
            coarse, shown = expose(frame)
            if frame >= first_frame:
                yield self._read(frame, coarse, mean(shown), wells, state_of(frame).gain)

    def moving(
        self,
        scenes: Iterable[StageImage],
        next_state: Callable[[AutomaticState, float, float], AutomaticState],
        *,
        is_sparse: Callable[[StageImage], bool],
        settled: bool,
    ) -> Iterator[Frame]:
        """Yield a frame for the scenes of each of its exposures; see
        `CameraModel.moving_frames`.

        `next_state` gives the state of the controls behind a state, a mean output of the MCP,
        electrons per s and cm2, and a mean level above black, DN. By the first scene `is_sparse`
        decides whether single pulses are drawn.
        """
        state, channels, sparse, remaining = UNTOUCHED, None, False, iter(scenes)
        prepared: tuple[StageImage, Any, Exposure] | None = None
        for frame in count():
            if not (batch := list(islice(remaining, self._fields))):
                return
            if len(batch) != self._fields:
                raise BadInput(f"a frame must have {self._fields} exposures, got {len(batch)}")
            plate = replace(self._mcp, gain=self._mcp.gain * state.brightness)
            if frame == 0:
                sparse = is_sparse(batch[0])
                first_exposure = prepare_exposure(
                    self._chain, batch[0], self._fields, sparse=sparse
                )
                self._prepare(first_exposure)
                self._stored_mean = [first_exposure.light_e * np.float64(settled)] * len(
                    self._stored_fraction
                )
                if settled and plate.depletion_blur_um is not None:
                    channels = plate.load(batch[0].values, batch[0].grid)
                for lag_frame in range(
                    -self._decay.n_lag_fields // self._fields if settled else 0, 0
                ):
                    self._screen.expose(
                        lag_frame, [first_exposure.light] * self._fields, 1.0, self._run_in_bands
                    )
            exposures, output = [], 0.0
            for scene in batch:
                assert scene.grid is not None
                output += (
                    float(plate.mean(scene).values.sum(dtype=float)) / scene.grid.cell_area_cm2
                )
                loaded_plate = plate
                if plate.depletion_blur_um is not None:
                    load_state, channels = plate.states_under(
                        channels, plate.load(scene.values, scene.grid)
                    )
                    loaded_plate = plate.with_depletion(load_state)
                # Light that stands still is prepared once.
                if (
                    prepared is None
                    or prepared[0] is not scene
                    or loaded_plate.gain_map is not None
                    or prepared[1] != loaded_plate
                ):
                    exposure = prepare_exposure(
                        self._chain.replacing(loaded_plate), scene, self._fields, sparse=sparse
                    )
                    prepared = scene, loaded_plate, exposure
                exposures.append(prepared[2])
            output /= batch[0].values.size * plate.field_s * self._fields
            coarse = self._screen.expose(
                frame, [e.light for e in exposures], 1.0, self._run_in_bands
            )
            mean = np.empty(self._charge.shape, np.float32)
            for n, exposure in enumerate(exposures):
                shown = self._mean_shown(exposure.light_e)
                mean[n :: self._fields] = (shown + self._dark_pattern)[n :: self._fields]
            wells = self._wells_of(float(mean.max()), exposures[0])
            image = self._read(frame, coarse, mean, wells, state.gain)
            yield image
            state = next_state(state, output, float(image.mean()) - self._video.black_level_dn)

    def _mean_shown(self, amount: Any) -> Any:
        """Mean light of an exposure, earlier ones included: of an amount as a factor or as a
        map.
        """
        # Of a steady scene a component stores s / (1 - k) and gives back s.
        shown = amount * (1.0 - self._stored_fraction.sum())
        shown = shown + sum(
            fraction * stored
            for fraction, stored in zip(self._stored_fraction, self._stored_mean, strict=True)
        )
        self._stored_mean = [
            kept_fraction * stored + (1.0 - kept_fraction) * amount
            for kept_fraction, stored in zip(self._kept_fraction, self._stored_mean, strict=True)
        ]
        return shown

    def _wells_of(self, brightest_e: float, exposure: Exposure) -> _Wells:
        """Decide by the variance of the charge of pixels of each mean, from none to the
        brightest.
        """
        ccd, light = self._ccd, exposure.light
        pulse_e = float(light.gain.mean()) * (1.0 + 1.0 / light.shape) * light.kernel.squares
        mean = np.linspace(0.0, max(brightest_e, 1.0), 200)
        variance = mean * (1.0 + pulse_e) + ccd.dark_e + ccd.read_noise_e**2
        skewness = float(((mean + ccd.dark_e) / np.maximum(variance, 1e-30) ** 1.5).max())
        highest = brightest_e + ACCURACY.max_charge_sd * np.sqrt(float(variance.max()))
        return _Wells(
            counts_electrons=skewness > ACCURACY.counted_skewness,
            overflow=bool(highest > ccd.full_well_e),
        )

    def _read(
        self, frame: int, coarse: Array32, mean: Array32, wells: _Wells, gain: float
    ) -> Frame:
        """Spread a frame's exposures over the pixels that are read from them, and read these."""
        ccd, video, screen, normal = self._ccd, self._video, self._screen, normal_quantiles()
        codes: Frame = np.empty(mean.shape, video.code_type)
        charge = self._charge
        wing = far_wing(screen.kernel, coarse, mean.shape)
        read_e = ccd.read_noise_e if wells.reads_later else 0.0
        variance = ccd.dark_e + (0.0 if wells.reads_later else ccd.read_noise_e**2)
        key, read_key = key_of(self._seed, CHARGE, frame), key_of(self._seed, READ, frame)
        noise = tuple(np.array([read_e, video.sync_jitter_px, video.line_noise_dn], np.float32))
        per_e = video.conversion_gain_dn_per_e * video.gain * gain
        levels = tuple(
            np.array([per_e, video.black_level_dn, video.full_scale_dn, video.gamma], np.float32)
        )
        readout = wells.reads_later, read_key, self._taps, noise, levels
        charge_noise = wells.counts_electrons, np.float32(variance)

        def collect(first: int, last: int) -> None:
            light = screen.shown, screen.spread, wing, mean, self._response
            charge_rows(first, last, key, *light, charge_noise, normal, readout, charge, codes)

        self._run_in_bands(collect, len(codes), 1)
        if wells.reads_later:
            if wells.counts_electrons:
                dark = np.float32(ccd.dark_e)
                charge = poisson_numbers(key_of(self._seed, COUNTED, frame), charge + dark) - dark
            limited = ccd.limit_to_full_well(charge) if wells.overflow else charge
            self._run_in_bands(
                lambda a, b: read_rows(
                    a, b, read_key, limited, self._taps, noise, levels, normal, codes
                ),
                len(codes),
                1,
            )
        return codes

    def _run_in_bands(self, work: Callable[[int, int], None], rows: int, block: int) -> None:
        """Do all rows in bands of whole blocks, one for each thread."""
        if self._threads == 1:
            work(0, rows)
            return
        borders = np.linspace(0, -(-rows // block), self._threads + 1).round().astype(int) * block
        bands = [(int(a), int(min(b, rows))) for a, b in pairwise(borders) if a < b]
        for job in [_pool(self._threads).submit(work, *band) for band in bands]:
            job.result()


def far_wing(
    kernel: Kernel | PulseKernel, coarse: Array32, shape: Sequence[int]
) -> tuple[Array32, Array32]:
    """Return the far wing on coarse rows and the frame's columns, and the position of each frame
    row among the coarse rows.

    `coarse` is the noise summed over coarse cells, shape (..., coarse row, coarse col).
    """
    rows, cols = coarse.shape[-2:]
    size = tuple(
        fft.next_fast_len(n + m, real=True)
        for n, m in zip((rows, cols), kernel.wing.shape, strict=True)
    )
    transform = _transform(kernel.wing.tobytes(), kernel.wing.shape, size)
    centre_row = kernel.wing.shape[0] // 2
    spectrum: Any = fft.rfft2(coarse, size)
    wing_image: Any = fft.irfft2(spectrum * transform, size)
    wing_image = wing_image[..., centre_row : centre_row + rows, centre_row : centre_row + cols]
    rows_on_coarse, left, right, fraction = _coarse_positions(
        (rows, cols), kernel.height, tuple(shape)
    )
    # A row beyond the last, which the rows of the frame look at with no weight.
    interpolated = np.empty((*coarse.shape[:-2], rows + 1, shape[1]), np.float32)
    images = np.ascontiguousarray(wing_image, np.float32).reshape(-1, rows, cols)
    interpolate_columns(images, left, right, fraction, interpolated.reshape(-1, rows + 1, shape[1]))
    return interpolated, rows_on_coarse


@lru_cache(maxsize=4)
def _transform(wing: bytes, shape: tuple[int, ...], size: tuple[int, ...]) -> NDArray[np.complex64]:
    transform: Any = fft.rfft2(np.frombuffer(wing, np.float32).reshape(shape), size)
    return transform


@lru_cache(maxsize=4)
def _coarse_positions(
    coarse: tuple[int, ...], height: int, shape: tuple[int, ...]
) -> tuple[Array32, NDArray[np.uint32], NDArray[np.uint32], Array32]:
    """Positions of the frame's rows and columns between the centres of coarse cells."""
    centres = REACH + 0.5 * height, REACH + 0.5
    rows, cols = (
        np.clip((centre + np.arange(n)) / COARSE - 0.5, 0.0, cells - 1.0).astype(np.float32)
        for centre, n, cells in zip(centres, shape, coarse, strict=True)
    )
    left = cols.astype(np.uint32)
    return (
        rows,
        left,
        np.minimum(left + 1, coarse[1] - 1).astype(np.uint32),
        (cols - left).astype(np.float32),
    )


@lru_cache(maxsize=4)
def _pool(threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(threads, thread_name_prefix="charact-frames")
