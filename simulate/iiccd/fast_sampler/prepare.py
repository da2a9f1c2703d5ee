"""Preparation of a static scene: light on cells becomes pulses, gains and the mean charge of every pixel."""

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from simulate.iiccd import pattern
from simulate.iiccd.accuracy import ACCURACY
from simulate.iiccd.ccd import Ccd
from simulate.iiccd.chain import Chain
from simulate.iiccd.fast_sampler.charge_distribution import normal_law, pulse_law
from simulate.iiccd.fast_sampler.dense_events import DenseEventSampler
from simulate.iiccd.fast_sampler.frame_generator import Readout, StaticScene
from simulate.iiccd.fast_sampler.kernel import COARSE, REACH, Kernel, noise_kernel, pulse_kernel
from simulate.iiccd.fast_sampler.sparse_events import SparseEventSampler
from simulate.iiccd.grid import Grid, irfft_image, rfft_image
from simulate.iiccd.microchannel import MicrochannelPlate
from simulate.iiccd.phosphor import PhosphorDecay
from simulate.iiccd.stage_image import StageImage
from simulate.iiccd.transfer import StageBlur
from simulate.iiccd.video import Video

# Moments of arrival over which fractions of light are averaged, and the least mean fraction that is stored at all.
EMPTY = np.zeros((1, 1), np.float32)


@dataclass(frozen=True, kw_only=True)
class CameraStages:
    """The stages of a camera that frames of a steady scene pass, as its chain has them."""

    mcp: MicrochannelPlate
    behind_mcp: Chain
    collection: Chain
    afterglow: PhosphorDecay
    ccd: Ccd
    video: Video
    fields: int

    @property
    def height(self) -> int:
        """Rows of the chip in a pixel as read."""
        return 2 if self.fields == 2 else 1

    @classmethod
    def of(cls, chain: Chain, fields: int) -> "CameraStages":
        """Pick them from a chain."""
        plate, ccd, video = (chain.between(name, name).stages[0] for name in ("microchannel plate", "ccd", "video"))
        afterglow = chain.between("afterglow", "afterglow").stages[0]
        assert isinstance(plate, MicrochannelPlate) and isinstance(ccd, Ccd) and isinstance(afterglow, PhosphorDecay)
        assert isinstance(video, Video)
        return cls(
            mcp=plate,
            behind_mcp=chain.between("phosphor", "taper"),
            collection=chain.between("pixels", "pixels"),
            afterglow=afterglow,
            ccd=ccd,
            video=video,
            fields=fields,
        )


def prepare_static_scene(stages: CameraStages, at_mcp: StageImage, *, normal: bool = False) -> StaticScene:
    """Return a static scene prepared for the frame generator.

    Parameters
    ----------
    stages
        The camera's stages.
    at_mcp
        Expected photoelectrons at the MCP input, per cell and exposure, two cells per column and row.
    normal
        Whether a normal law of the same mean and variance stands for the law of a cell's charge.
    """
    grid = at_mcp.grid
    if grid is None or (grid.per_column, grid.per_row) != (2, 2):
        raise ValueError("a scene is made ready from two cells per column and row")
    sparse = is_sparse(at_mcp, stages.fields) and not normal
    screen = stages.behind_mcp.mean(stages.mcp.mean(at_mcp))
    mean, dark = _mean_charge(stages, stages.collection.mean(screen))
    drawn = _single_light if sparse else partial(_cell_light, normal=normal)
    (later, _, kept), _, n_lag_fields = decay_of(stages.afterglow)
    return StaticScene(
        light=drawn(stages, at_mcp, screen.pending_blurs, mean.shape),
        light_e=mean,
        dark_pattern_e=dark,
        response=_response(stages.ccd, mean.shape),
        stays=later.astype(float),
        kept=kept.astype(float),
        n_lag_fields=n_lag_fields,
        fields=stages.fields,
    )


def is_sparse(at_mcp: StageImage, fields: int) -> bool:
    """Whether there is so little light, on cells two a pixel both ways, that single pulses are seen, and drawn."""
    height = 2 if fields == 2 else 1
    return max(float(at_mcp.values.mean(dtype=float)), 0.0) * 4 * height < ACCURACY.sparse_pe_per_px


def _cell_light(
    stages: CameraStages, at_mcp: StageImage, pending: tuple[StageBlur, ...], _size: tuple[int, ...], *, normal: bool
) -> DenseEventSampler:
    """Light of many pulses, added up in cells behind the blurs that it still owes."""
    grid = _grid_of(at_mcp)
    kernel = noise_kernel(pending, grid, stages.height, _impulse(stages.video), ACCURACY.skewness_tolerance)
    light = np.clip(_planes(_sharpen(at_mcp.values, kernel), kernel.divisions), 0.0, ACCURACY.max_pe_per_cell)
    expected = _cut(light, grid) * stages.mcp.detection_probability
    gain = _cut(_gain(stages, at_mcp, kernel.divisions), grid)
    law = normal_law(expected) if normal else pulse_law(stages.mcp.pulse_height_shape, expected)
    decay, lateness, _ = decay_of(stages.afterglow)
    # One block of memory for what is read together, large enough for large pages.
    cells = np.stack([expected, law.inverse, gain]).astype(np.float32)
    return DenseEventSampler(
        expected=cells[0],
        inverse=cells[1],
        rows=law.rows,
        gain=cells[2],
        shape=stages.mcp.pulse_height_shape,
        quantiles=law.quantiles,
        ions_per_field=stages.mcp.ions_per_cell(at_mcp) * 4 * expected[0].size,
        ion_size=stages.mcp.ion_event_size_pe,
        kernel=kernel,
        decay=decay,
        lateness=lateness,
        fields=stages.fields,
    )


def _single_light(
    stages: CameraStages, at_mcp: StageImage, pending: tuple[StageBlur, ...], size: tuple[int, ...]
) -> SparseEventSampler:
    """Light of single pulses behind the blurs that it still owes."""
    grid = _grid_of(at_mcp)
    light = np.maximum(_planes(at_mcp.values, (2, 2)), 0.0)
    expected = _interleave_planes(_cut(light, grid)) * stages.mcp.detection_probability
    gain = _interleave_planes(_cut(_gain(stages, at_mcp, (2, 2)), grid))
    (stays, _, kept), _, _ = decay_of(stages.afterglow)
    return SparseEventSampler(
        expected=expected.astype(np.float32),
        gain=gain.astype(np.float32),
        shape=stages.mcp.pulse_height_shape,
        ions_per_field=stages.mcp.ions_per_cell(at_mcp) * gain.size,
        ion_size=stages.mcp.ion_event_size_pe,
        kernel=pulse_kernel(pending, grid, stages.height),
        size=(size[0], size[1]),
        stays=stays,
        kept=kept,
        later=partial(_fractions_to_store, stages.afterglow),
        fields=stages.fields,
    )


def _gain(stages: CameraStages, at_mcp: StageImage, divisions: tuple[int, int]) -> NDArray[np.float64]:
    """CCD electrons for each detected photoelectron, in planes of cells."""
    quiet = replace(stages.mcp, ion_events_per_s_cm2=0.0)
    photons = stages.behind_mcp.mean(quiet.mean(at_mcp)).values
    each = _ratio(photons, at_mcp.values, divisions)
    return each * stages.ccd.quantum_efficiency / stages.mcp.detection_probability


def _grid_of(at_mcp: StageImage) -> Grid:
    assert at_mcp.grid is not None
    return at_mcp.grid


def _sharpen(light: NDArray[np.floating], kernel: Kernel) -> NDArray[np.float64]:
    """Light on cells, two a pixel both ways, through the kernel's filter on its own lattice."""
    down, along = kernel.divisions
    rows, cols = light.shape[0] // 2, light.shape[1] // 2
    lattice = light.reshape(rows * down, 2 // down, cols * along, 2 // along).sum(axis=(1, 3), dtype=np.float64)
    spectrum = rfft_image(lattice) * rfft_image(_filter_on_lattice(kernel.sharpening, lattice.shape))
    sharp = irfft_image(spectrum, lattice.shape) / (2 // down * (2 // along))
    return sharp.repeat(2 // down, axis=0).repeat(2 // along, axis=1)


def _filter_on_lattice(filtered: NDArray[np.float64], shape: tuple[int, ...]) -> NDArray[np.float64]:
    """A filter, origin first, on a lattice of another shape; what reaches beyond it is folded back."""
    whole = np.zeros(shape)
    rows, cols = (np.fft.fftfreq(n, 1.0 / n).astype(int) % m for n, m in zip(filtered.shape, shape, strict=True))
    np.add.at(whole, (rows[:, None], cols[None, :]), filtered)
    return whole


def _ratio(
    photons: NDArray[np.floating], photoelectrons: NDArray[np.floating], divisions: tuple[int, int]
) -> NDArray[np.float64]:
    """Photons for each photoelectron, in planes of cells; where nothing falls, as on average."""
    out, into = _planes(photons, divisions), _planes(photoelectrons, divisions)
    average = out.sum() / into.sum() if into.sum() > 0.0 else 0.0
    return np.divide(out, into, out=np.full(out.shape, average), where=into > 1e-9 * max(float(into.max()), 1e-300))


def _impulse(video: Video) -> tuple[float, ...]:
    """The filter along a line as it matters, (tap,)."""
    taps = video.low_pass.impulse_response()
    return tuple(float(tap) for tap in taps[: np.flatnonzero(np.abs(taps) > ACCURACY.min_filter_tap)[-1] + 1])


def _planes(values: NDArray[np.floating], divisions: tuple[int, int]) -> NDArray[np.float64]:
    """Gather cells, two a pixel both ways, into planes of so many cells a row and a column, shape (plane, row, col)."""
    down, along = divisions
    rows, cols = values.shape[0] // 2, values.shape[1] // 2
    cells = values.reshape(rows, down, 2 // down, cols, along, 2 // along).sum(axis=(2, 5), dtype=np.float64)
    return cells.transpose(1, 3, 0, 2).reshape(down * along, rows, cols)


def _interleave_planes(planes: NDArray) -> NDArray:
    """Planes of cells, two a pixel both ways, as one image of them."""
    _, rows, cols = planes.shape
    return planes.reshape(2, 2, rows, cols).transpose(2, 0, 3, 1).reshape(2 * rows, 2 * cols)


def _cut(planes: NDArray, grid: Grid) -> NDArray:
    """Cells under the kernels of the frame's pixels, filled up with empty ones to whole coarse cells."""
    top, left = grid.margin_rows - REACH, grid.margin_columns - REACH
    cut = planes[:, top : top + grid.rows + 2 * REACH, left : left + grid.columns + 2 * REACH]
    missing = [(-n) % COARSE for n in cut.shape[1:]]
    return np.pad(cut, ((0, 0), (0, missing[0]), (0, missing[1])))


def _mean_charge(stages: CameraStages, pixels: StageImage) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Mean charge of the light, and the fixed pattern of the dark charge about its mean, e-."""
    light = np.ascontiguousarray(stages.ccd.mean_charge(pixels.values), np.float32)
    dark = stages.ccd.dark(light.shape) - np.float32(stages.ccd.dark_e)
    return light, np.ascontiguousarray(dark) if np.ndim(dark) == 2 else EMPTY


def _response(ccd: Ccd, shape: tuple[int, ...]) -> NDArray[np.float32]:
    if ccd.prnu == 0.0:
        return EMPTY
    return pattern.prnu_map((shape[0], shape[1]), ccd.prnu, ccd.pattern_seed)


def readout_of(stages: CameraStages, scene: StaticScene) -> Readout:
    """Return what reads a scene."""
    ccd, video = stages.ccd, stages.video
    overflows = (
        float(scene.light_e.max()) + ACCURACY.max_charge_sd * np.sqrt(float(_variance(scene, ccd).max()))
        > ccd.full_well_e
    )
    counted = _skewness(scene, ccd) > ACCURACY.counted_skewness
    return Readout(
        dark_e=ccd.dark_e,
        read_noise_e=ccd.read_noise_e,
        counted=counted,
        limit_charge=ccd.limit_to_full_well if overflows else None,
        impulse=np.array(_impulse(video), np.float32),
        jitter_px=video.sync_jitter_px,
        line_noise_dn=video.line_noise_dn,
        gain_dn_per_e=video.conversion_gain_dn_per_e * video.gain,
        black_dn=video.black_level_dn,
        gamma=video.gamma,
        top_dn=video.full_scale_dn,
    )


def _variance(scene: StaticScene, ccd: Ccd) -> NDArray[np.float64]:
    """Variance of the charge of a pixel of each mean, from none to the brightest, e-^2."""
    mean = np.linspace(0.0, max(float(scene.light_e.max()), 1.0), 200)
    return mean * (1.0 + scene.light.pulse_e) + ccd.dark_e + ccd.read_noise_e**2


def _skewness(scene: StaticScene, ccd: Ccd) -> float:
    """Skewness that the charge's own shot noise brings to the noise, at most."""
    mean = np.linspace(0.0, max(float(scene.light_e.max()), 1.0), 200)
    return float(((mean + ccd.dark_e) / np.maximum(_variance(scene, ccd), 1e-30) ** 1.5).max())


def decay_of(afterglow: PhosphorDecay) -> tuple[NDArray[np.float32], float, int]:
    """Return (later, spread, kept) of each phosphor component, the skewness of the delay and the number of lag fields.

    Notes
    -----
    A pulse that arrives u before its field ends leaves a_i exp(-u/tau_i) of its light to later fields. The spread of
    each component over arrival times is its regression on what all leave together, so that the variance of the field
    and its covariance with later ones are exact.
    """
    left, kept = _remaining_fractions(afterglow, _arrival_times())
    later, together = left.mean(axis=1), left.sum(axis=0)
    scatter = float(together.std())
    spread = (left - later[:, None]) @ together / together.size / (scatter or 1.0)
    seen = _lasting(afterglow)
    remaining = (later[seen, None] * kept[seen, None] ** np.arange(1, 400)).sum(axis=0)
    n_lag_fields = 1 + int(np.argmax(remaining < ACCURACY.max_lag_fraction)) if seen.any() else 0
    lateness = float(np.mean(((together - together.mean()) / scatter) ** 3)) if scatter > 1e-30 else 0.0
    return np.stack([later, spread, kept]).astype(np.float32)[:, seen], lateness, n_lag_fields


def _fractions_to_store(afterglow: PhosphorDecay, arrival: NDArray[np.float32]) -> NDArray[np.float32]:
    """Fraction that each component stores of a pulse, by arrival time as a fraction of the gate width."""
    return _remaining_fractions(afterglow, arrival)[0][_lasting(afterglow)].astype(np.float32)


def _arrival_times() -> NDArray[np.float64]:
    """Arrival times over which decay is averaged, as fractions of the gate width."""
    return (np.arange(ACCURACY.n_arrival_times) + 0.5) / ACCURACY.n_arrival_times


def _lasting(afterglow: PhosphorDecay) -> NDArray[np.bool_]:
    """Which components leave any light to later exposures, shape (component,)."""
    return _remaining_fractions(afterglow, _arrival_times())[0].mean(axis=1) > ACCURACY.min_stored_fraction


def _remaining_fractions(
    afterglow: PhosphorDecay, arrival: NDArray[np.floating]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Fraction of a pulse's light left in each component, by arrival time, and the decay factor of one field."""
    tau = np.maximum(np.array([afterglow.fast_decay_ms, afterglow.slow_decay_ms]) * 1e-3, 1e-12)
    share = np.array([afterglow.fast_fraction, 1.0 - afterglow.fast_fraction]) * tau
    left = share[:, None] / share.sum() * np.exp(-(afterglow.field_s - afterglow.gate_s * arrival) / tau[:, None])
    return left, np.exp(-afterglow.field_s / tau)
