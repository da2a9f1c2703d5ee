"""Features of measured or simulated frames, and their comparison with an ensemble."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.method import Context
from charact.validation.frames import MatchedStacks
from charact.validation.validation_result import Statistic
from labdata.frames import FrameStack

Array = NDArray[np.float64]

REPLICATES = 4000


@dataclass(frozen=True, kw_only=True)
class Features:
    """Numbers from one set of frames, shape (k,), their sampling covariance (k, k) and its degrees of freedom."""

    value: Array
    covariance: Array
    freedom: int


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """Distance of a measured vector from an ensemble of simulated ones.

    `distance`: root of chi-squared over its number of terms, 1 is usual; `p_value`: probability of at least this
    distance; `centre`, `sd`: predicted mean and standard deviation of a measured vector, shape (k,).
    """

    distance: float
    p_value: float
    centre: Array
    sd: Array


def compare(
    measured: Features, simulated: list[Features], *, rng: np.random.Generator, replicates: int = REPLICATES
) -> Comparison:
    """Compare one measured vector with at least two simulated ones, each from its own posterior draw.

    Notes
    -----
    Simulated vectors scatter with S = W + P: sampling W, and the posterior P. W is pooled from within the sets, S from
    between them, and P is the positive part of S - W. The distance of the measured vector from the mean of D draws has
    the covariance (W + P)(1 + 1/D). Since W and P are estimates, the squared distance has no tabulated distribution:
    the procedure is repeated on vectors drawn with the estimated W and P, and the p-value is the fraction of
    repetitions at least as distant (a parametric bootstrap; Davison & Hinkley 1997, section 4.2).
    """
    values = np.array([one.value for one in simulated])
    within, freedom = _pool_covariance([*simulated, measured])
    chi_squared, covariance = _distance(measured.value, values, within)
    whole = _root(within + _above(np.cov(values.T), within))
    normal = rng.standard_normal((replicates, len(values) + 1, values.shape[1])) @ whole.T
    sampled = rng.standard_normal((replicates, freedom, values.shape[1])) @ _root(within).T
    again = np.einsum("rni,rnj->rij", sampled, sampled, optimize=True) / freedom
    null, _ = _distance(normal[:, 0], normal[:, 1:], again)
    return Comparison(
        distance=float(np.sqrt(chi_squared / values.shape[1])),
        p_value=float((1 + np.sum(null >= chi_squared)) / (replicates + 1)),
        centre=values.mean(axis=0),
        sd=np.sqrt(np.diag(covariance)),
    )


def _distance(one: Array, many: Array, within: Array) -> tuple[Array, Array]:
    """Return the squared distance of vectors (..., k) from ensembles (..., draw, k), and the covariance it is in."""
    count = many.shape[-2]
    centre = many.mean(axis=-2)
    away = many - centre[..., None, :]
    between = np.swapaxes(away, -1, -2) @ away / (count - 1.0)
    covariance = (within + _above(between, within)) * (1.0 + 1.0 / count)
    gap = one - centre
    return np.einsum("...i,...i->...", gap, np.linalg.solve(covariance, gap[..., None])[..., 0]), covariance


def _pool_covariance(sets: list[Features]) -> tuple[Array, int]:
    """Return the sampling covariance pooled over sets, and its degrees of freedom."""
    freedom = sum(one.freedom for one in sets)
    total = np.sum([one.freedom * one.covariance for one in sets], axis=0)
    size = len(total)
    return total / freedom + 1e-12 * np.trace(total) / (freedom * size) * np.eye(size), freedom


def _above(between: Array, within: Array) -> Array:
    """Return the excess of covariances (..., k, k) over others, in the directions where it is positive."""
    root = _root(within)
    inverse = np.linalg.inv(root)
    white = inverse @ between @ np.swapaxes(inverse, -1, -2)
    values, vectors = np.linalg.eigh((white + np.swapaxes(white, -1, -2)) / 2.0)
    extra = (vectors * np.maximum(values - 1.0, 0.0)[..., None, :]) @ np.swapaxes(vectors, -1, -2)
    return np.asarray(root @ extra @ np.swapaxes(root, -1, -2))


def _root(covariance: Array) -> Array:
    """Return Cholesky roots."""
    return np.linalg.cholesky(covariance).astype(np.float64)


Array = NDArray[np.float64]


TITLES = {
    "mean-variance": "Variance and covariance sum over signal, at every flat",
    "autocorrelation": "Correlation of neighbouring pixels, along rows (h) and columns (v)",
    "mtf": "MTF of the edge up to 0.8 of the sampling limit",
}


@dataclass(frozen=True, kw_only=True)
class FrameFeatures:
    """Features of one set of frames.

    `noise`: of the flats above the dark; `correlation`: of neighbours in the brightest flat; `mtf`: of the edge.
    Signal, temporal variance and covariance sum of each flat above the dark have the shape (flat,); `grey_dn`:
    independent pixels of the brightest flat about their mean, DN.
    """

    noise: Features
    correlation: Features
    mtf: Features | None
    mean_dn: Array
    variance_dn2: Array
    covariance_dn2: Array
    grey_dn: Array


def portrait_of(
    frames: dict[str, NDArray], chosen: MatchedStacks, *, context: Context, rng: np.random.Generator
) -> FrameFeatures:
    """Return the features of frames given by label."""
    dark = tiles_of(frames[chosen.dark.label])
    lit = [tiles_of(frames[shot.label]) for shot in chosen.flats]
    return FrameFeatures(
        noise=noise_features(lit, dark),
        correlation=correlation_features(lit[-1]),
        mtf=mtf_features(frames[chosen.edge.label], context) if chosen.edge is not None else None,
        mean_dn=np.array([one.mean.mean() - dark.mean.mean() for one in lit]),
        variance_dn2=np.array([one.variance - dark.variance for one in lit]),
        covariance_dn2=np.array([one.covariance_sum - dark.covariance_sum for one in lit]),
        grey_dn=sample_of(frames[chosen.flats[-1].label], rng),
    )


def statistics(
    one: FrameFeatures, many: list[FrameFeatures], chosen: MatchedStacks, *, rng: np.random.Generator
) -> tuple[Statistic, ...]:
    """Compare one set of features with simulated ones, each statistic at its part of the family-wise level."""
    curves = [other.mtf for other in many if other.mtf is not None]
    sharp = one.mtf if len(curves) > len(many) // 2 else None
    level = 0.005 / (3 if sharp is None else 4)
    noise_names = tuple(
        f"{what} of {shot.label}" for shot in chosen.flats for what in ("ln variance/signal", "ln covariance/signal")
    )
    vectors: dict[str, tuple[tuple[str, ...], Features, list[Features]]] = {
        "mean-variance": (noise_names, one.noise, [other.noise for other in many]),
        "autocorrelation": (LAG_NAMES, one.correlation, [other.correlation for other in many]),
    }
    if sharp is not None:
        points = tuple(f"{frequency:.2f} cy/px" for frequency in FREQUENCY_CY_PER_PX)
        vectors["mtf"] = (points, sharp, curves)
    found = [_vector_statistic(name, *vector, level, rng) for name, vector in vectors.items()]
    return (*found[:2], _histogram_statistic(one, many, level), *found[2:])


def _vector_statistic(
    name: str, labels: tuple[str, ...], one: Features, many: list[Features], level: float, rng: np.random.Generator
) -> Statistic:
    found = compare(one, many, rng=rng)
    return Statistic(
        name=name,
        title=TITLES[name],
        distance=found.distance,
        p_value=found.p_value,
        level=level,
        labels=labels,
        measured=tuple(one.value.tolist()),
        low95=tuple((found.centre - 1.96 * found.sd).tolist()),
        high95=tuple((found.centre + 1.96 * found.sd).tolist()),
        note=f"{name}: distance is the root of chi-squared per number; p-value from {REPLICATES} repetitions",
    )


def _histogram_statistic(one: FrameFeatures, many: list[FrameFeatures], level: float) -> Statistic:
    found = distance(one.grey_dn, np.concatenate([other.grey_dn for other in many]))
    return Statistic(
        name="histogram",
        title="Grey levels of independent pixels of the brightest flat about their mean",
        distance=found.kolmogorov / (1.36 / np.sqrt(one.grey_dn.size)) * 2.0,
        p_value=found.p_value,
        level=level,
        note=(
            f"histogram: Kolmogorov-Smirnov on {one.grey_dn.size} pixels at least {STRIDE // 2} px and "
            f"a frame apart; Wasserstein distance {found.wasserstein_sd:.3f} standard deviations"
        ),
    )


TILES = 4
REACH = 6
# Lags (row, col) whose correlation is compared.
LAGS = ((0, 1), (0, 2), (0, 3), (1, 0), (2, 0), (3, 0), (4, 0))
LAG_NAMES = ("h1", "h2", "h3", "v1", "v2", "v3", "v4")


@dataclass(frozen=True, kw_only=True)
class TileStatistics:
    """Mean level of each tile of a stack, DN, and autocovariance of its frame-to-frame changes, DN^2.

    Shapes (tile,) and (tile, lag, lag) with lag zero at the centre.
    """

    mean: Array
    autocovariance: Array

    def without(self, tile: int) -> "TileStatistics":
        """Return all tiles but one."""
        return TileStatistics(
            mean=np.delete(self.mean, tile), autocovariance=np.delete(self.autocovariance, tile, axis=0)
        )

    @property
    def variance(self) -> float:
        """Temporal variance, DN^2."""
        return float(self.autocovariance[:, REACH, REACH].mean())

    @property
    def covariance_sum(self) -> float:
        """Covariance summed over all lags, DN^2."""
        return float(self.autocovariance.sum(axis=(1, 2)).mean())

    def correlation(self, lag: tuple[int, int]) -> float:
        """Correlation of pixels a lag (row, col) apart, dimensionless."""
        return float(self.autocovariance[:, REACH + lag[0], REACH + lag[1]].mean()) / self.variance


def tiles_of(frames: NDArray) -> TileStatistics:
    """Return the sums over TILES x TILES tiles of frames (frame, row, col); at least two frames."""
    change = frames.astype(np.float32)
    change -= change.mean(axis=0)
    count, rows, cols = change.shape
    height, width = rows // TILES, cols // TILES
    corners = [(height * r, width * c) for r in range(TILES) for c in range(TILES)]
    cut = [np.s_[:, row : row + height, col : col + width] for row, col in corners]
    scale = count / (count - 1.0)
    return TileStatistics(
        mean=np.array([float(frames[place].mean()) for place in cut]),
        autocovariance=np.array([scale * _autocovariance(change[place]) for place in cut]),
    )


def noise_features(lit: list[TileStatistics], dark: TileStatistics) -> Features:
    """Return ln(variance/signal) and ln(covariance sum/signal) of every flat."""

    def numbers(lit: list[TileStatistics], dark: TileStatistics) -> list[float]:
        parts = [
            (part, float(one.mean.mean() - dark.mean.mean()))
            for one in lit
            for part in (one.variance - dark.variance, one.covariance_sum - dark.covariance_sum)
        ]
        return [np.log(max(part, 1e-9) / signal) for part, signal in parts]

    out = [numbers([one.without(tile) for one in lit], dark.without(tile)) for tile in range(TILES**2)]
    return _jackknife(np.array(numbers(lit, dark)), np.array(out))


def correlation_features(flat: TileStatistics) -> Features:
    """Return the correlations of a flat at LAGS."""
    out = [[flat.without(tile).correlation(lag) for lag in LAGS] for tile in range(TILES**2)]
    return _jackknife(np.array([flat.correlation(lag) for lag in LAGS]), np.array(out))


def _jackknife(value: Array, left_out: Array) -> Features:
    """Return features with jackknife covariance, (n - 1)/n sum (t_i - mean)(t_i - mean)^T."""
    count = len(left_out)
    away = left_out - left_out.mean(axis=0)
    return Features(value=value, covariance=(count - 1.0) / count * away.T @ away, freedom=count - 1)


def _autocovariance(change: NDArray[np.float32]) -> Array:
    """Return the autocovariance of changes (frame, row, col), averaged over frames and pairs of pixels."""
    from scipy.fft import irfft2, next_fast_len, rfft2

    count, rows, cols = change.shape
    shape = (next_fast_len(rows + REACH), next_fast_len(cols + REACH))
    spectrum = np.asarray(rfft2(change, s=shape))
    full = np.asarray(irfft2((np.abs(spectrum) ** 2).sum(axis=0), s=shape))
    lags = np.arange(-REACH, REACH + 1)
    pairs = np.outer(rows - np.abs(lags), cols - np.abs(lags)) * count
    return full[np.ix_(lags, lags)] / pairs


STRIDE = 8


@dataclass(frozen=True, kw_only=True)
class Distance:
    """Distance of two samples of grey values.

    `kolmogorov`: largest difference of the distribution functions; `wasserstein_sd`: mean shift that converts one
    sample into the other, in standard deviations of the measured one; `p_value`: of the Kolmogorov distance.
    """

    kolmogorov: float
    wasserstein_sd: float
    p_value: float


def sample_of(frames: NDArray, rng: np.random.Generator) -> Array:
    """Return independent pixels (n,) without quantisation, less their mean, DN.

    Every second frame contributes a lattice of pixels, interleaved between frames, so that neither blur, phosphor decay
    nor fixed pattern correlate them.
    """
    row, col = (int(rng.integers(STRIDE)) for _ in range(2))
    parts = []
    for place, frame in enumerate(frames[::2]):
        shift = STRIDE // 2 * (place % 2)
        top, left = (row + shift) % STRIDE, (col + STRIDE // 2 * (place // 2 % 2)) % STRIDE
        parts.append(frame[top::STRIDE, left::STRIDE].astype(float).ravel())
    apart = np.concatenate(parts)
    apart += rng.uniform(-0.5, 0.5, apart.size)
    return apart - apart.mean()


def distance(measured: Array, simulated: Array) -> Distance:
    """Return the distance of two samples with equal means (two-sample Kolmogorov-Smirnov test)."""
    from scipy.stats import ks_2samp, wasserstein_distance

    found = ks_2samp(measured, simulated)
    return Distance(
        kolmogorov=float(found.statistic),  # type: ignore[union-attr]
        wasserstein_sd=float(wasserstein_distance(measured, simulated) / measured.std()),
        p_value=float(found.pvalue),  # type: ignore[union-attr]
    )


# Frequencies up to 0.8 of the sampling limit.
FREQUENCY_CY_PER_PX = np.arange(0.05, 0.4001, 0.05)


def mtf_features(frames: NDArray, context: Context) -> Features | None:
    """Return the MTF at FREQUENCY_CY_PER_PX with the method's own errors, or None where the method refuses."""
    from charact import mtf

    found = mtf.measure("edge", FrameStack(data=frames), method="edge-slanted", context=context)
    line = next(iter(found.curves.values()), None)
    if line is None or line.interval68 is None:
        return None
    value, low, high = (
        np.interp(FREQUENCY_CY_PER_PX, line.frequency_cy_per_px, y) for y in (line.value, *line.interval68)
    )
    sd = np.maximum((high - low) / (2.0 * 0.994458), 1e-4)
    apart = np.abs(FREQUENCY_CY_PER_PX[:, None] - FREQUENCY_CY_PER_PX[None, :])
    return Features(value=value, covariance=np.outer(sd, sd) * np.exp(-apart / 0.08), freedom=9)
