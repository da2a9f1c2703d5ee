"""What is compared of one set of frames, measured or simulated, and the comparison of one with many."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.method import Context
from charact.validation import flats, histogram, mtf_features
from charact.validation.frames import MatchedStacks
from charact.validation.predictive import REPLICATES, Features, compare
from charact.validation.validation_result import Statistic

Array = NDArray[np.float64]

# Probability that a right sensor fails any one of the statistics.
FAMILY_LEVEL = 0.005


TITLES = {
    "mean-variance": "Variance and covariance sum over signal, at every flat",
    "autocorrelation": "Correlation of neighbouring pixels, along rows (h) and columns (v)",
    "mtf": "MTF of the edge up to 0.8 of the sampling limit",
}


@dataclass(frozen=True, kw_only=True)
class FrameFeatures:
    """Numbers of one set of frames.

    Parameters
    ----------
    noise, correlation, mtf
        Features of the flats above the dark, of the brightest flat's neighbours, of the edge.
    mean_dn, variance_dn2, covariance_dn2
        Signal, temporal variance and covariance sum of each flat above the dark, shape (flat,).
    grey_dn
        Independent pixels of the brightest flat about their mean, shape (n,), DN.
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
    """Return the numbers of frames given by label."""
    dark = flats.tiles_of(frames[chosen.dark.label])
    lit = [flats.tiles_of(frames[shot.label]) for shot in chosen.flats]
    return FrameFeatures(
        noise=flats.noise_features(lit, dark),
        correlation=flats.correlation_features(lit[-1]),
        mtf=mtf_features.mtf_features(frames[chosen.edge.label], context) if chosen.edge is not None else None,
        mean_dn=np.array([one.mean.mean() - dark.mean.mean() for one in lit]),
        variance_dn2=np.array([one.variance - dark.variance for one in lit]),
        covariance_dn2=np.array([one.covariance_sum - dark.covariance_sum for one in lit]),
        grey_dn=histogram.sample_of(frames[chosen.flats[-1].label], rng),
    )


def statistics(
    one: FrameFeatures, many: list[FrameFeatures], chosen: MatchedStacks, *, rng: np.random.Generator
) -> tuple[Statistic, ...]:
    """Return the statistics of one portrait against simulated ones, each at its share of the family's level.

    Parameters
    ----------
    one, many
        The portrait in question and those of the posterior draws.
    chosen
        The stacks, for their names.
    rng
        Draws of the null distributions.
    """
    curves = [other.mtf for other in many if other.mtf is not None]
    sharp = one.mtf if len(curves) > len(many) // 2 else None
    level = FAMILY_LEVEL / (3 if sharp is None else 4)
    noise_names = tuple(
        f"{what} of {shot.label}" for shot in chosen.flats for what in ("ln variance/signal", "ln covariance/signal")
    )
    vectors: dict[str, tuple[tuple[str, ...], Features, list[Features]]] = {
        "mean-variance": (noise_names, one.noise, [other.noise for other in many]),
        "autocorrelation": (flats.LAG_NAMES, one.correlation, [other.correlation for other in many]),
    }
    if sharp is not None:
        points = tuple(f"{frequency:.2f} cy/px" for frequency in mtf_features.FREQUENCY_CY_PER_PX)
        vectors["mtf"] = (points, sharp, curves)
    found = [_of_vector(name, *vector, level, rng) for name, vector in vectors.items()]
    return (*found[:2], _histogram(one, many, level), *found[2:])


def _of_vector(
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


def _histogram(one: FrameFeatures, many: list[FrameFeatures], level: float) -> Statistic:
    found = histogram.distance(one.grey_dn, np.concatenate([other.grey_dn for other in many]))
    return Statistic(
        name="histogram",
        title="Grey levels of independent pixels of the brightest flat about their mean",
        distance=found.kolmogorov / (1.36 / np.sqrt(one.grey_dn.size)) * 2.0,
        p_value=found.p_value,
        level=level,
        note=(
            f"histogram: Kolmogorov-Smirnov on {one.grey_dn.size} pixels at least {histogram.STRIDE // 2} px and "
            f"a frame apart; Wasserstein distance {found.wasserstein_sd:.3f} standard deviations"
        ),
    )
