"""What one stack of dark or evenly lit frames tells: its level, its variance in time and the spectrum of its noise."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.method import Context
from charact.noise.fields import Exposures, exposures, fluctuations, runs_of
from charact.noise.spectrum import Bins, bins_of, cross_spectra
from charact.noise.temporal import autocovariance, usable_lags
from labdata.conditions import Conditions
from labdata.session import StackEntry

Array = NDArray[np.float64]

# Longest lag at which light of earlier exposures is looked for, exposures.
MOST_LAGS = 12
# Blocks of the image (rows, columns) whose scatter gives the uncertainty of its variance.
BLOCKS = (6, 8)


# Lags allowed for where none is seen, exposures.
FEW_LAGS = 2


# Exposures of an intensified camera this far apart no longer share the glow of the screen to speak of.
GLOW_EXPOSURES = 8


@dataclass(frozen=True, kw_only=True)
class Spectrum:
    """Noise of one stack when so many lags are allowed for: the more, the less biased and the less certain.

    Parameters
    ----------
    lags
        Lags, exposures, 0 first, shape (lag,).
    power_dn2
        Autocovariance in time of the modes of each bin, shape (bin, lag), DN^2.
    variance_dn2
        Temporal variance of a pixel, DN^2.
    """

    lags: NDArray[np.int64]
    power_dn2: Array
    variance_dn2: float


@dataclass(frozen=True, kw_only=True)
class Level:
    """Statistics of one stack; DN throughout.

    Parameters
    ----------
    label, kind, conditions
        As in the session.
    frames, pixels
        Number of frames, and of pixels in each.
    mean_dn
        Mean over all pixels and frames.
    frame_mean_dn
        Mean of each frame, shape (frame,).
    variance_dn2, variance_sd_dn2
        Temporal variance of a pixel, mean over the image, and its standard error.
    neighbour_correlation, neighbour_sd
        Correlation of the fluctuations of pixels next to each other in a row, and its standard error.
    spatial_variance_dn2, spatial_sd_dn2
        Variance over the image of what does not change in time, and its standard error.
    low_share, high_share
        Share of pixel values at the lowest and highest code.
    few, many
        Spectra that allow for few and for many lags, or None.
    runs, time, parity
        Runs of frames the statistics come from, and the exposures of one of them.
    bins
        Bins of the spectrum, or None.
    """

    label: str
    kind: str
    conditions: Conditions
    frames: int
    pixels: int
    mean_dn: float
    frame_mean_dn: Array
    variance_dn2: float
    variance_sd_dn2: float
    neighbour_correlation: float
    neighbour_sd: float
    spatial_variance_dn2: float
    spatial_sd_dn2: float
    low_share: float
    high_share: float
    few: Spectrum | None
    many: Spectrum | None
    runs: int
    time: NDArray[np.int64]
    parity: NDArray[np.int64]
    bins: Bins | None


def read_level(entry: StackEntry, *, context: Context, spectra: bool = True) -> Level | None:
    """Read one stack and return its statistics; None where it holds a single frame, which shows no change in time."""
    stack = entry.read()
    if len(stack) < 2:
        return None
    full_scale_dn = context.full_scale_dn if context.full_scale_dn is not None else stack.full_scale_dn
    runs = [_run(stack, first, last, context, spectra) for first, last in runs_of(stack)]
    weight = np.array([len(run["time"]) for run in runs], float)
    frame_mean = np.array([frame.mean(dtype=np.float64) for frame in stack.data])

    def pooled(name: str):
        return np.average([run[name] for run in runs], axis=0, weights=weight)

    return Level(
        label=entry.label,
        kind=entry.kind,
        conditions=entry.conditions,
        frames=len(stack),
        pixels=stack.data[0].size,
        mean_dn=float(frame_mean.mean()),
        frame_mean_dn=frame_mean,
        variance_dn2=float(pooled("variance")),
        variance_sd_dn2=float(np.sqrt(np.average([r["variance_sd"] ** 2 for r in runs], weights=weight) / len(runs))),
        neighbour_correlation=float(pooled("neighbour")),
        neighbour_sd=float(np.sqrt(np.average([r["neighbour_sd"] ** 2 for r in runs], weights=weight) / len(runs))),
        spatial_variance_dn2=float(pooled("pattern")[0]),
        spatial_sd_dn2=float(pooled("pattern")[1] / np.sqrt(len(runs))),
        low_share=_share_at(stack.data, stack.data.min()),
        high_share=0.0 if full_scale_dn is None else float(np.mean(stack.data >= full_scale_dn)),
        few=_pooled([run["few"] for run in runs], weight) if spectra else None,
        many=_pooled([run["many"] for run in runs], weight) if spectra else None,
        runs=len(runs),
        time=runs[0]["time"],
        parity=runs[0]["parity"],
        bins=runs[0]["bins"],
    )


def _run(stack, first: int, last: int, context: Context, spectra: bool) -> dict:
    """Statistics of a run of frames."""
    shots = exposures(stack, first, last, interlaced=context.interlaced)
    change = fluctuations(shots)
    pixel = _pixel_products(change, shots.parity)
    plain = np.zeros(1, np.int64)
    variance = float(autocovariance(pixel, shots.time, shots.parity, plain, within_parity=True)[0])
    found = {"time": shots.time, "parity": shots.parity, "variance": variance, "bins": None, "pattern": _fixed_pattern(shots, GLOW_EXPOSURES if context.interlaced else 1),
             **_blocks(change, shots.image, variance)}  # fmt: skip
    if spectra:
        row_pitch = context.pitch_ratio * shots.row_step
        bins = bins_of(*change.shape[1:], row_pitch)
        products = cross_spectra(change, shots.parity, bins)
        found |= {"bins": bins} | {
            name: _spectrum(products, pixel, shots, most) for name, most in (("few", FEW_LAGS), ("many", MOST_LAGS))
        }
    return found


def _spectrum(products: Array, pixel: Array, shots: Exposures, most: int) -> Spectrum:
    """Unbiased covariances in time up to a lag."""
    lags = usable_lags(shots.time, shots.parity, most)
    same = rows_lags(lags, shots.parity)
    variance = autocovariance(pixel, shots.time, shots.parity, same, within_parity=True)[0]
    power = autocovariance(products, shots.time, shots.parity, lags)
    return Spectrum(lags=lags, power_dn2=power, variance_dn2=float(variance))


def rows_lags(lags: NDArray[np.int64], parity: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the lags between exposures of the same rows."""
    return lags[lags % 2 == 0] if len(np.unique(parity)) > 1 else lags


def _pooled(runs: list[Spectrum], weight: Array) -> Spectrum:
    """Mean of the spectra of all runs over the lags that all of them have."""
    lags = min((run.lags for run in runs), key=len)
    power = np.average([run.power_dn2[:, : len(lags)] for run in runs], axis=0, weights=weight)
    variance = float(np.average([run.variance_dn2 for run in runs], weights=weight))
    return Spectrum(lags=lags, power_dn2=power, variance_dn2=variance)


def _pixel_products(change: NDArray[np.float32], parity: NDArray[np.int64]) -> Array:
    """Mean product of exposures of equal parity, shape (exposure, exposure)."""
    flat = change.reshape(len(change), -1)
    out = np.zeros((len(change), len(change)))
    for value in np.unique(parity):
        same = np.flatnonzero(parity == value)
        out[np.ix_(same, same)] = (flat[same] @ flat[same].T) / flat.shape[1]
    return out


def _blocks(change: NDArray[np.float32], image: NDArray[np.float32], variance: float) -> dict[str, float]:
    """Standard error of the variance, and the correlation of neighbours with its own, from blocks of the image."""
    _, rows, cols = change.shape
    row_cuts = np.linspace(0, rows, min(BLOCKS[0], rows) + 1).astype(int)[:-1]
    col_cuts = np.linspace(0, cols, min(BLOCKS[1], cols) + 1).astype(int)[:-1]

    def means(of):
        total = np.add.reduceat(np.add.reduceat(of, row_cuts, axis=0), col_cuts, axis=1)
        size = np.diff(np.append(row_cuts, of.shape[0]))[:, None] * np.diff(np.append(col_cuts, of.shape[1]))
        return total / size

    power = means(np.einsum("trc,trc->rc", change, change).astype(np.float64))
    beside = means(np.einsum("trc,trc->rc", change[..., :-1], change[..., 1:]).astype(np.float64)[:, :cols])
    level = means(image.mean(axis=0, dtype=np.float64))
    # A block that is darker is also quieter: its variance is compared at the level of the whole.
    even = power * (level.mean() / level if level.min() > 0.5 * level.mean() else 1.0)
    count = np.sqrt(power.size)
    ratio = beside / np.maximum(power, 1e-12)
    relative = float(even.std(ddof=1) / max(even.mean(), 1e-12) / count) if power.size > 1 else 1.0
    return {"variance_sd": variance * relative, "neighbour": float(beside.mean() / max(power.mean(), 1e-12)),
            "neighbour_sd": float(ratio.std(ddof=1) / count) if power.size > 1 else 1.0}  # fmt: skip


def _fixed_pattern(shots: Exposures, apart: int) -> tuple[float, float]:
    """Variance over the image of what does not change in time, and its standard error.

    The mean covariance over the image of two exposures of the same rows: their temporal noise is not alike, so none
    of it has to be known and subtracted. Exposures nearer in time than `apart` may share the glow of the screen.
    """
    flat = shots.image.reshape(len(shots.image), -1)
    flat = flat - flat.mean(axis=1, keepdims=True)
    products, spread, size = [], [], flat.shape[1]
    for parity in np.unique(shots.parity):
        same = np.flatnonzero(shots.parity == parity)
        gram = (flat[same] @ flat[same].T).astype(np.float64) / size
        distance = np.abs(shots.time[same][:, None] - shots.time[same])
        far = distance >= min(apart, int(distance.max()))
        products.append(float(gram[far & (distance > 0)].mean()))
        noise = max(float(np.trace(gram)) / len(same) - products[-1], 0.0) / len(same)
        spread.append((4.0 * max(products[-1], 0.0) * noise + 2.0 * noise**2) / size)
    return float(np.mean(products)), float(np.sqrt(np.sum(spread)) / len(spread))


def _share_at(data: NDArray, lowest: float) -> float:
    """Share of values at the lowest code of an integer stack that reaches zero."""
    return float(np.mean(data == 0)) if data.dtype.kind in "ui" and lowest == 0 else 0.0
