"""Ranks of true blurs among draws from the posteriors of edges: `make study NAME=edge-calibration`
draws table and figure.

Truths come from the prior that the posterior is told, frames from the study's own edges. What is
ranked is what users get of the form of tubes: its likelihood with the noise that an edge's pixels
show, drawn from by Markov chain and by importance.
"""

import argparse
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.studies.chart import write_json
from benchmarks.studies.figures import COLOURS, pyplot, save_figure
from benchmarks.studies.harness import Progress
from charact.estimators.mtf.curve import FINE, crossing_frequency
from charact.estimators.mtf.edge.fit.model_fit import EdgeFitter, form_of
from charact.estimators.mtf.edge.pixels.prepare_edge import EdgeRefusal, prepare_edge
from charact.estimators.mtf.edge.pixels.profile import EVEN_PER_PX
from charact.estimators.mtf.known_transfer import known_transfer
from charact.inference import importance_sample, sample
from charact.inference.importance import WANTED
from charact.method import Context
from charact.method.registry import single_blas_thread
from charact.transfer import cores, form
from charact.transfer.blur_model import BlurModel
from labdata import BadInput, FrameStack, Posterior
from tests.truth.blur import TrueBlur
from tests.truth.edge import EdgeScene

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Calibration:
    """Ranks of truths among draws from their posteriors.

    Parameters
    ----------
    names
        Of the parameters.
    ranks
        How many of the draws lie below the truth, shape (trial, parameter).
    draws
        Number of draws of each posterior: ranks run from 0 to it.
    flagged
        Trials left out because their posterior was flagged.
    seed
        Seed of the first trial; the others follow.
    """

    names: tuple[str, ...]
    ranks: NDArray[np.int64]
    draws: int
    flagged: int
    seed: int

    def histogram(self, name: str) -> NDArray[np.int64]:
        """Return how many ranks of a parameter fall into each of equal bins, shape (bin,)."""
        bins = self._bins()
        width = (self.draws + 1) // bins
        return np.bincount(self.ranks[:, self.names.index(name)] // width, minlength=bins)

    def band(self, level: float = 0.95) -> tuple[float, float]:
        """Return the counts between which one bin lies with this probability if ranks are
        uniform.
        """
        from scipy.stats import binom

        low, high = binom.interval(level, len(self.ranks), 1.0 / self._bins())
        return float(low), float(high)

    def chi_squared(self, name: str) -> tuple[float, float]:
        """Return chi squared of a parameter's histogram against a uniform one, and the probability
        of one as large.
        """
        from scipy.stats import chi2

        counts = self.histogram(name)
        expected = counts.sum() / counts.size
        value = float(np.sum((counts - expected) ** 2) / expected)
        return value, float(chi2.sf(value, counts.size - 1))

    @property
    def probability(self) -> float:
        """Probability of the least uniform histogram, allowing for the number of parameters
        (Bonferroni).
        """
        return min(1.0, len(self.names) * min(self.chi_squared(name)[1] for name in self.names))

    def coverage(self, level: float) -> NDArray[np.floating]:
        """Return how often the central interval of a level holds the truth, shape (parameter,)."""
        place = (self.ranks + 0.5) / (self.draws + 1)
        return np.mean(np.abs(place - 0.5) < level / 2, axis=0)

    def _bins(self) -> int:
        """Equal bins of ranks: at most 20, at least 5 trials each on average."""
        most = max(2, min(20, len(self.ranks) // 5))
        return next(bins for bins in range(most, 0, -1) if (self.draws + 1) % bins == 0)


def calibrate(
    prior: Callable[[np.random.Generator], Array],
    data: Callable[[Array, np.random.Generator], Any],
    posterior: Callable[[Any, int], Posterior | Array],
    *,
    names: tuple[str, ...],
    trials: int,
    seed: int,
    draws: int = 119,
    progress: Progress = lambda sentence, fraction: None,
) -> Calibration:
    """Draw truths and data, and rank each truth among draws from the posterior of its data.

    Parameters
    ----------
    prior
        Maps a generator to a truth, shape (parameter,).
    data
        Maps a truth and a generator to data.
    posterior
        Maps data and a seed to a `Posterior`, or to nearly independent draws (draw, parameter), at
        least `draws` of them. A flagged one is left out and counted.
    names
        Of the parameters.
    trials
        Number of truths.
    seed
        Trial t is drawn with the seed (seed, t).
    draws
        Draws used of each posterior, evenly thinned; 119 can be put into 20, 15, 12, 10 or fewer
        equal bins.
    progress
        Called with a sentence and the share done.

    Raises
    ------
    BadInput
        If there are fewer than ten trials, or a posterior gives fewer draws than asked for.

    Notes
    -----
    Talts et al. 2018, arXiv:1804.06788: with truth from the prior and data from the truth, the rank
    of the truth among L independent draws of the posterior is uniform over 0 to L. Leaving out
    flagged trials keeps that true only as far as flags do not depend on the truth, so their number
    belongs to the result.
    """
    if trials < 10:
        raise BadInput(f"trials must be at least 10, got {trials}")
    ranks, flagged = [], 0
    for trial in range(trials):
        progress("trial", trial / trials)
        rng = np.random.default_rng([seed, trial])
        truth = np.asarray(prior(rng), float)
        found = posterior(data(truth, rng), int(rng.integers(1 << 31)))
        if isinstance(found, Posterior) and found.flags:
            flagged += 1
            continue
        drawn = found.draws if isinstance(found, Posterior) else np.asarray(found, float)
        ranks.append(_rank(drawn, truth, draws))
    progress("trials done", 1.0)
    if len(ranks) < 10:
        raise BadInput(
            f"at least 10 posteriors must be without flags, got {len(ranks)} of {trials}"
        )
    return Calibration(names=names, ranks=np.array(ranks), draws=draws, flagged=flagged, seed=seed)


def _rank(drawn: Array, truth: Array, wanted: int) -> NDArray[np.int64]:
    """Return how many of the wanted draws lie below the truth, for each parameter."""
    if drawn.ndim != 2 or drawn.shape[1] != truth.size or len(drawn) < wanted:
        raise BadInput(
            f"a posterior must give ({wanted} or more, {truth.size}) draws, got {drawn.shape}"
        )
    kept = drawn[np.linspace(0, len(drawn) - 1, wanted).round().astype(int)]
    return np.sum(kept < truth, axis=0)


def plot_calibration(result: Calibration, path: Path) -> Path:
    """Draw a panel for each parameter, at most four in a line; bars outside the 95 % band are red.

    Parameters
    ----------
    result
        Ranks of truths among draws.
    path
        Where the SVG goes; a PNG is put beside it.
    """
    columns = min(4, len(result.names))
    lines = -(-len(result.names) // columns)
    figure, grid = pyplot().subplots(
        lines,
        columns,
        figsize=(1.0 + 3.0 * columns, 0.8 + 2.3 * lines),
        layout="constrained",
        squeeze=False,
    )
    for panel, name in zip(grid.flat, result.names, strict=False):
        _draw_histogram(panel, result, name)
    for panel in grid.flat[len(result.names) :]:
        panel.set_visible(False)
    for panel in grid[:, 0]:
        panel.set_ylabel("truths")
    flagged = f", {result.flagged} flagged and left out" if result.flagged else ""
    figure.suptitle(
        f"Ranks of {len(result.ranks)} truths among {result.draws} draws each{flagged}; band: 95 %"
    )
    return save_figure(figure, path)


def _draw_histogram(panel: Any, result: Calibration, name: str) -> None:
    """One parameter: its bars over the band."""
    counts, (low, high) = result.histogram(name), result.band()
    width = (result.draws + 1) / len(counts)
    panel.axhspan(low, high, color="black", alpha=0.12, linewidth=0)
    panel.axhline(len(result.ranks) / len(counts), color="black", linewidth=0.8)
    colours = [COLOURS[0] if low <= count <= high else COLOURS[1] for count in counts]
    panel.bar(
        [width * (number + 0.5) for number in range(len(counts))],
        counts,
        width=0.92 * width,
        color=colours,
    )
    value, probability = result.chi_squared(name)
    panel.set_title(
        f"{name}: chi squared {value:.0f} of {len(counts) - 1}, p = {probability:.2g}", fontsize=8
    )
    panel.set(xlabel="rank of the truth", xlim=(0, result.draws + 1))


TABLE = Path(__file__).with_name("tables") / "calibration.json"
FIGURES = Path("docs/pictures/mtf")
FORM = BlurModel(core="exponential")
NAMES: tuple[str, ...] = ("ln half frequency", "exponent", "MTF50")
# The method's priors of half frequency, cycles per pixel, and exponent, cut to what tubes and
# lenses have.
HALF_FREQUENCY, EXPONENT = (0.08, 0.4), (1.0, 2.6)
SHIFT_PX = (-6.0, 6.0)
SAMPLERS: dict[str, Callable[..., Posterior]] = {
    "emcee": partial(sample, max_steps=3000),
    "importance": partial(importance_sample, enough=WANTED),
}
TRIALS, DRAWS, SEED = 600, 119, 4000
BOUNDS = np.array([SHIFT_PX, tuple(np.log(HALF_FREQUENCY)), EXPONENT])


@dataclass(frozen=True, kw_only=True)
class Ranked:
    """What the ranks of one sampler say.

    Parameters
    ----------
    sampler
        Its name.
    trials, flagged
        Truths drawn, and those left out because their posterior was flagged.
    histograms
        Counts of ranks in equal bins, by name.
    probability
        Of histograms as uneven as the least even one, were ranks uniform.
    cover68, cover95
        How often the central intervals hold the truth, by name.
    """

    sampler: str
    trials: int
    flagged: int
    histograms: dict[str, list[int]]
    probability: float
    cover68: dict[str, float]
    cover95: dict[str, float]


def truth(rng: np.random.Generator) -> Array:
    """Draw ln of a half frequency, an exponent and the MTF50 that follows, pixel included."""
    prior = form.HALF_FREQUENCY
    half = _normal_within((prior.mean, prior.sd), tuple(np.log(HALF_FREQUENCY)), rng)
    exponent = _normal_within((cores.EXPONENT.mean, cores.EXPONENT.sd), EXPONENT, rng)
    return np.array([half, exponent, blur_of(half, exponent).mtf50(5.0)])


def _normal_within(
    normal: tuple[float, float], bounds: tuple[float, float], rng: np.random.Generator
) -> float:
    """Draw from the part of a normal distribution, mean and deviation, that lies within bounds."""
    drawn = -np.inf
    while not bounds[0] < drawn < bounds[1]:
        drawn = rng.normal(*normal)
    return drawn


def blur_of(ln_half_frequency: float, exponent: float) -> TrueBlur:
    """Return a blur exp(-(f/fc)^n) by the frequency at which it falls to one half."""
    cut_off = np.exp(ln_half_frequency) / np.log(2.0) ** (1.0 / exponent)
    return TrueBlur(form="exponential", frequency_cy_per_px=float(cut_off), exponent=exponent)


def edge_drawn(true: Array, rng: np.random.Generator) -> FrameStack:
    """Draw a frame of an edge with such a blur, its place, size, step and noise at random."""
    dark = float(rng.uniform(1300.0, 3500.0))
    scene = EdgeScene(
        blur=blur_of(float(true[0]), float(true[1])),
        rows=int(rng.integers(90, 161)),
        cols=int(rng.integers(90, 161)),
        angle_deg=5.0,
        offset_px=float(rng.uniform(-2.0, 2.0)),
        dark_dn=dark,
        bright_dn=dark + 1500.0,
        snr=float(np.exp(rng.uniform(np.log(10.0), np.log(60.0)))),
        shot_share=float(rng.choice([0.0, 0.8])),
        noise_blur_px=float(rng.choice([0.0, 0.5, 0.9])),
        black_dn=200.0,
        full_scale_dn=65535.0,
    )
    return scene.frames_drawn(rng)


@single_blas_thread()
def posterior_draws(sampler: str, stack: FrameStack, seed: int) -> Array | Posterior:
    """Return draws of half frequency, exponent and MTF50, shape (draw, 3); the posterior itself
    where it is flagged.
    """
    context = Context(seed=seed)
    edge = prepare_edge(stack, None, context, quickly=True)
    if isinstance(edge, EdgeRefusal):
        raise BadInput(f"every frame of this study holds an edge, got: {edge.reason}")
    known = known_transfer(edge.picture, edge.profile.angle_rad, context)
    fitter = EdgeFitter(edge.profile, known)
    fit = fitter.fit(FORM, np.concatenate([[0.0], FORM.start(np.log(fitter.guess()))]), EVEN_PER_PX)
    likelihood = fitter.log_probability(form_of(FORM), EVEN_PER_PX)

    def log_probability(theta: Array) -> Array:
        inside = np.all((theta >= BOUNDS[:, 0]) & (theta <= BOUNDS[:, 1]), axis=1)
        return np.where(inside, likelihood(theta) / fit.noise_scale, -np.inf)

    width = np.diff(BOUNDS, axis=1)[:, 0]
    found = SAMPLERS[sampler](
        log_probability,
        names=("edge_shift_px", *FORM.names),
        units=("px", *FORM.units),
        start=np.clip(fit.point, BOUNDS[:, 0] + 0.02 * width, BOUNDS[:, 1] - 0.02 * width),
        covariance=fit.covariance * fit.noise_scale,
        seed=seed,
        bounds=BOUNDS,
        draws=2 * DRAWS,
    )
    # A truth near the end of the prior leans on it, as it should.
    if set(found.flags) - {"prior-bound"}:
        return found
    half = crossing_frequency(
        FINE, np.abs(known(FINE)) * FORM.modulus(found.draws[:, 1:], FINE), 0.5
    )
    return np.column_stack([found.draws[:, 1:], half])


def ranks(sampler: str, trials: int, seed: int) -> Calibration:
    """Rank truths among the draws of a sampler."""
    return calibrate(
        truth,
        edge_drawn,
        partial(posterior_draws, sampler),
        names=NAMES,
        trials=trials,
        seed=seed,
        draws=DRAWS,
    )


def together(parts: Sequence[Calibration]) -> Calibration:
    """Return the ranks of several studies as those of one."""
    return Calibration(
        names=NAMES,
        ranks=np.concatenate([part.ranks for part in parts]),
        draws=DRAWS,
        flagged=sum(part.flagged for part in parts),
        seed=parts[0].seed,
    )


def summarise_ranks(sampler: str, found: Calibration) -> Ranked:
    """Return what ranks say."""
    cover68, cover95 = (
        dict(zip(NAMES, found.coverage(level).tolist(), strict=True)) for level in (0.68, 0.95)
    )
    return Ranked(
        sampler=sampler,
        trials=len(found.ranks) + found.flagged,
        flagged=found.flagged,
        histograms={name: found.histogram(name).tolist() for name in NAMES},
        probability=found.probability,
        cover68=cover68,
        cover95=cover95,
    )


def main() -> None:
    """Rank, draw and write."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.studies.edge_ranks", description=__doc__
    )
    parser.add_argument("--trials", type=int, default=TRIALS, help="truths for each sampler")
    parser.add_argument("--workers", type=int, default=2)
    asked = parser.parse_args()
    each = asked.trials // asked.workers
    rows = []
    with ProcessPoolExecutor(asked.workers, mp_context=get_context("spawn")) as pool:
        for sampler in SAMPLERS:
            found = together(
                list(pool.map(partial(ranks, sampler, each), range(SEED, SEED + asked.workers)))
            )
            # Pages show pictures as PNG, which lies beside the drawing.
            plot_calibration(found, FIGURES / f"ranks-{sampler}.svg").unlink()
            rows.append(summarise_ranks(sampler, found))
            print(rows[-1])
    write_json(
        TABLE,
        {
            "draws": DRAWS,
            "seeds": [SEED, SEED + asked.workers - 1],
            "samplers": [asdict(r) for r in rows],
        },
    )


if __name__ == "__main__":
    main()
