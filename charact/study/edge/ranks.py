"""Ranks of true blurs among draws from the posteriors of edges: `make calibration` draws table and figure.

Truths come from the prior that the posterior is told, frames from the study's own edges. What is ranked is what users
get of the form of tubes: its likelihood with the noise that an edge's pixels show, drawn from by Markov chain and by
importance.
"""

import argparse
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from charact.method import Context
from charact.method.registry import with_single_blas_thread
from charact.mtf.blur_models.one_dimensional import EXPONENT_PRIOR, HALF_FREQUENCY_PRIOR, BlurModel
from charact.mtf.curve import FINE, crossing_frequency
from charact.mtf.edge.fit.model_fit import BlurModelFitter
from charact.mtf.edge.pixels.illumination_gradient import EVEN_PER_PX
from charact.mtf.edge.pixels.prepare_edge import EdgeRefusal, prepare_edge
from charact.mtf.known_transfer import known_transfer
from charact.posterior import importance_sample, sample
from charact.posterior.sampling import WANTED
from charact.study.calibration import Calibration, calibrate
from charact.study.calibration_figure import plot_calibration
from charact.study.edge.scene import EdgeScene, TrueBlur
from charact.study.speed_accuracy import write_json
from labdata.errors import BadInput
from labdata.frames import FrameStack
from labdata.measurement import Posterior

Array = NDArray[np.float64]

TABLE = Path(__file__).resolve().parents[1] / "tables" / "calibration.json"
FIGURES = Path("docs/mtf")
FORM = BlurModel(core="exponential")
NAMES: tuple[str, ...] = ("ln half frequency", "exponent", "MTF50")
# The method's priors of half frequency, cycles per pixel, and exponent, cut to what tubes and lenses have.
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
    median, sd = HALF_FREQUENCY_PRIOR
    half = _normal_within((float(np.log(median)), sd), tuple(np.log(HALF_FREQUENCY)), rng)
    exponent = _normal_within(EXPONENT_PRIOR, EXPONENT, rng)
    return np.array([half, exponent, blur_of(half, exponent).mtf50(5.0)])


def _normal_within(normal: tuple[float, float], bounds: tuple[float, float], rng: np.random.Generator) -> float:
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


@with_single_blas_thread
def posterior_draws(sampler: str, stack: FrameStack, seed: int) -> Array | Posterior:
    """Return draws of half frequency, exponent and MTF50, shape (draw, 3); the posterior itself where it is flagged."""
    context = Context(seed=seed)
    edge = prepare_edge(stack, None, context, quickly=True)
    if isinstance(edge, EdgeRefusal):
        raise BadInput(f"every frame of this study holds an edge, got: {edge.reason}")
    known = known_transfer(edge.picture, edge.profile.angle_rad, context)
    fitter = BlurModelFitter(edge.profile, known)
    fit = fitter.fit(FORM, np.concatenate([[0.0], FORM.start(fitter.guess())]), EVEN_PER_PX)
    likelihood = fitter.log_probability(FORM, EVEN_PER_PX)

    def log_probability(theta: Array) -> Array:
        inside = np.all((theta >= BOUNDS[:, 0]) & (theta <= BOUNDS[:, 1]), axis=1)
        return np.where(inside, likelihood(theta) / fit.noise_scale, -np.inf)

    width = np.diff(BOUNDS, axis=1)[:, 0]
    found = SAMPLERS[sampler](
        log_probability,
        names=("edge_shift_px", *FORM.parameters),
        units=("px", *(unit for unit, _ in FORM.parameters.values())),
        start=np.clip(fit.point, BOUNDS[:, 0] + 0.02 * width, BOUNDS[:, 1] - 0.02 * width),
        covariance=fit.covariance * fit.noise_scale,
        seed=seed,
        bounds=BOUNDS,
        draws=2 * DRAWS,
    )
    # A truth near the end of the prior leans on it, as it should.
    if set(found.flags) - {"prior-bound"}:
        return found
    half = crossing_frequency(FINE, np.abs(known(FINE)) * FORM.modulus(found.draws[:, 1:], FINE), 0.5)
    return np.column_stack([found.draws[:, 1:], half])


def ranks(sampler: str, trials: int, seed: int) -> Calibration:
    """Rank truths among the draws of a sampler."""
    return calibrate(
        truth, edge_drawn, partial(posterior_draws, sampler), names=NAMES, trials=trials, seed=seed, draws=DRAWS
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
    cover68, cover95 = (dict(zip(NAMES, found.coverage(level).tolist(), strict=True)) for level in (0.68, 0.95))
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
    parser = argparse.ArgumentParser(prog="python -m charact.study.edge.ranks", description=__doc__)
    parser.add_argument("--trials", type=int, default=TRIALS, help="truths for each sampler")
    parser.add_argument("--workers", type=int, default=2)
    asked = parser.parse_args()
    each = asked.trials // asked.workers
    rows = []
    with ProcessPoolExecutor(asked.workers, mp_context=get_context("spawn")) as pool:
        for sampler in SAMPLERS:
            found = together(list(pool.map(partial(ranks, sampler, each), range(SEED, SEED + asked.workers))))
            # Pages show pictures as PNG, which lies beside the drawing.
            plot_calibration(found, FIGURES / f"ranks-{sampler}.svg").unlink()
            rows.append(summarise_ranks(sampler, found))
            print(rows[-1])
    write_json(
        TABLE, {"draws": DRAWS, "seeds": [SEED, SEED + asked.workers - 1], "samplers": [asdict(r) for r in rows]}
    )


if __name__ == "__main__":
    main()
