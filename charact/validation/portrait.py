"""What is compared of one set of frames, measured or simulated, and the comparison of one with many."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.method import Context
from charact.validation import flats, histogram, sharpness
from charact.validation.frames import Chosen
from charact.validation.predictive import Comparison, Features, compare
from charact.validation.verdict import Statistic

Array = NDArray[np.float64]

# Probability that a right sensor fails any one of the statistics.
FAMILY_LEVEL = 0.005


@dataclass(frozen=True, kw_only=True)
class Portrait:
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


def portrait_of(frames: dict[str, NDArray], chosen: Chosen, *, context: Context, rng: np.random.Generator) -> Portrait:
    """Return the numbers of frames given by label."""
    dark = flats.tiles_of(frames[chosen.dark.label])
    lit = [flats.tiles_of(frames[shot.label]) for shot in chosen.flats]
    return Portrait(
        noise=flats.noise_features(lit, dark),
        correlation=flats.correlation_features(lit[-1]),
        mtf=sharpness.mtf_features(frames[chosen.edge.label], context) if chosen.edge is not None else None,
        mean_dn=np.array([one.mean.mean() - dark.mean.mean() for one in lit]),
        variance_dn2=np.array([one.variance - dark.variance for one in lit]),
        covariance_dn2=np.array([one.covariance_sum - dark.covariance_sum for one in lit]),
        grey_dn=histogram.sample_of(frames[chosen.flats[-1].label], rng),
    )


def statistics(one: Portrait, many: list[Portrait], chosen: Chosen) -> tuple[Statistic, ...]:
    """Return the statistics of one portrait against simulated ones, each at its share of the family's level."""
    with_mtf = one.mtf is not None and all(other.mtf is not None for other in many)
    level = FAMILY_LEVEL / (4 if with_mtf else 3)
    out = [
        _noise(one, many, chosen, level),
        _of_vector(
            "autocorrelation",
            "Correlation of neighbouring pixels, along rows (h) and columns (v)",
            flats.LAG_NAMES,
            one.correlation,
            [other.correlation for other in many],
            level,
        ),
        _histogram(one, many, level),
    ]
    if with_mtf:
        points = tuple(f"{f:.2f} cy/px" for f in sharpness.FREQUENCY_CY_PER_PX)
        curves = [other.mtf for other in many]
        title = "MTF of the edge up to 0.8 of the sampling limit"
        out.append(_of_vector("mtf", title, points, one.mtf, curves, level))  # type: ignore[arg-type]
    return tuple(out)


def _noise(one: Portrait, many: list[Portrait], chosen: Chosen, level: float) -> Statistic:
    names = [
        f"{what} of {shot.label}" for shot in chosen.flats for what in ("ln variance/signal", "ln covariance/signal")
    ]
    title = "Variance and covariance sum over signal, at every flat"
    return _of_vector("mean-variance", title, tuple(names), one.noise, [other.noise for other in many], level)


def _of_vector(
    name: str, title: str, labels: tuple[str, ...], one: Features, many: list[Features], level: float
) -> Statistic:
    found: Comparison = compare(one, many)
    return Statistic(
        name=name,
        title=title,
        distance=found.distance,
        p_value=found.p_value,
        level=level,
        labels=labels,
        measured=tuple(one.value.tolist()),
        low95=tuple((found.centre - 1.96 * found.sd).tolist()),
        high95=tuple((found.centre + 1.96 * found.sd).tolist()),
        note="chi-squared with the posterior's and the sampling covariance; distance: its root per number",
    )


def _histogram(one: Portrait, many: list[Portrait], level: float) -> Statistic:
    found = histogram.distance(one.grey_dn, np.concatenate([other.grey_dn for other in many]))
    return Statistic(
        name="histogram",
        title="Grey levels of independent pixels of the brightest flat about their mean",
        distance=found.kolmogorov / (1.36 / np.sqrt(one.grey_dn.size)) * 2.0,
        p_value=found.p_value,
        level=level,
        note=(
            f"Kolmogorov-Smirnov on {one.grey_dn.size} pixels at least {histogram.STRIDE // 2} px and a frame apart; "
            f"Wasserstein distance {found.wasserstein_sd:.3f} standard deviations"
        ),
    )
