"""What the noise spectrum of flats ought to be: a white floor, and pulses blurred after the gain,
folded by sampling.

Photoelectrons arrive independently and the gain makes a pulse of each, so that the power of their
noise is k F^2 mu |H|^2, H being the transfer of all that comes after the gain; electrons of the CCD
add K mu, white. A pixel grid folds |H|^2 back into its band, whereas white noise stays white; a
video filter acts on both.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from charact.estimators.mtf.noise_spectrum.pooled_spectrum import PooledSpectrum
from charact.estimators.mtf.noise_spectrum.thresholds import ACCURACY, THRESHOLDS
from charact.inference import find_maximum
from charact.inference.gauss_newton import ln_evidence
from charact.method import Context
from charact.transfer.blur_model import BlurModel
from charact.transfer.cores import EXPONENT
from charact.transfer.form import HALF_FREQUENCY, Parameter, Parametric, flat_parameters
from charact.transfer.stages import fibres
from charact.transfer.video_filter import PixelAndVideo, VideoFilter, powers
from labdata import Array
from labdata.camera.description import has_tube


@dataclass(frozen=True, kw_only=True)
class KnownReadout(PixelAndVideo):
    """The known part of the transfer after the gain."""

    anisotropy_sd: float  # prior standard deviation of the logarithm of the anisotropy
    # pitch of the taper's fibres, column pitches, and f0 of its interfaces exp(-(f/f0)^2), cycles
    # per column pitch
    fibres: tuple[float, float] | None = None

    def aperture(self, fx: Array, fy: Array) -> Array:
        """Return |sinc sinc| of the pixel, and the taper where it is described."""
        pixel = super().aperture(fx, fy)
        return pixel if self.fibres is None else pixel * fibres(np.hypot(fx, fy), *self.fibres)


@dataclass(frozen=True, kw_only=True)
class SpectralReplicas:
    """Which replicas of the spectrum fold into which cells."""

    # column, row, cell, known: frequency of each replica, the cell that it folds into, in order,
    # and the known |H|^2 there, shape (replica,)
    column: Array
    row: Array
    cell: NDArray[np.int64]
    known: Array
    first: NDArray[np.int64]  # index of the first replica of each cell, shape (cell,)
    # mean over the modes of a cell of the folded power, over that at its mean frequency, shape
    # (cell,)
    cell_factors: Array

    def power(self, shape: "PostGainBlur", theta: Array) -> Array:
        """Return the folded |H|^2 of each cell for (ln anisotropy, *shape), shape (n, parameter) ->
        (n, cell).
        """
        stretch, group = np.unique(np.exp(-theta[:, 0]), return_inverse=True)
        # Points of equal anisotropy, most of a stencil of derivatives, have their frequencies in
        # common.
        shared = 2 * len(stretch) <= len(theta)
        groups = (
            [np.flatnonzero(group == i) for i in range(len(stretch))]
            if shared
            else [np.arange(len(theta))]
        )
        out = np.empty((len(theta), len(self.first)))
        for rows in groups:
            # In parts that fit the processor's cache.
            for part in np.array_split(
                rows, len(rows) * len(self.column) // ACCURACY.n_at_once + 1
            ):
                frequency = np.hypot(
                    self.column, self.row * stretch[group[part[:1] if shared else part], None]
                )
                core = shape.modulus(theta[part, 1:], frequency) ** 2 * self.known
                out[part] = np.add.reduceat(core, self.first, axis=1) * self.cell_factors
        return out


def spectral_replicas(
    column: Array,
    row: Array,
    row_pitch: float,
    known: KnownReadout,
    replicas: int = ACCURACY.n_replicas,
) -> SpectralReplicas:
    """Return all replicas up to so many periods away for frequencies inside the band."""
    steps = np.arange(-replicas, replicas + 1)
    across, up = (grid.ravel() for grid in np.meshgrid(steps, steps / row_pitch))
    columns, rows = (column[:, None] + across).ravel(), (row[:, None] + up).ravel()
    cell = np.repeat(np.arange(len(column)), len(across))
    return SpectralReplicas(
        column=columns,
        row=rows,
        cell=cell,
        known=known.aperture(columns, rows) ** 2 * known.electronics(column)[cell] ** 2,
        first=np.arange(len(column)) * len(across),
        cell_factors=np.ones(len(column)),
    )


def without_weak_replicas(
    replicas: SpectralReplicas, shape: "PostGainBlur", theta: Array
) -> SpectralReplicas:
    """Return the folding without the replicas that carry next to nothing at one point
    (parameter,).
    """
    modal_replicas = replace(replicas, cell_factors=np.ones(len(replicas.first)))
    core = (
        shape.modulus(
            theta[None, 1:], np.hypot(replicas.column, replicas.row * np.exp(-theta[0]))[None]
        )[0]
        ** 2
    )
    part, total = core * replicas.known, modal_replicas.power(shape, theta[None])[0]
    strong = part > ACCURACY.min_replica * total[replicas.cell]
    strong[replicas.first + (replicas.first[1] - replicas.first[0]) // 2] = True
    cell = replicas.cell[strong]
    return replace(
        replicas,
        column=replicas.column[strong],
        row=replicas.row[strong],
        cell=cell,
        known=replicas.known[strong],
        first=np.searchsorted(cell, np.arange(len(replicas.first))),
    )


# Waves of the departure from a straight line, over this range of frequency, and the scale of their
# amplitudes.
WAVES = tuple(range(2, 8))


@dataclass(frozen=True)
class NonparametricBlur(Parametric):
    """-ln H = ln 2 exp(s), s a free smooth function of ln f.

    s = n ln(f/f2) + sum of a_k cos(k pi t)/k^2, t the place of ln f in its range: with normal
    amplitudes a smoothing spline, whose second derivative is penalised. Without them it is the form
    exp(-ln 2 (f/f2)^n).
    """

    name = "free"

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """Half frequency and exponent, then the amplitudes of the waves."""
        bound = THRESHOLDS.cosine_bound
        waves = (
            Parameter(name=f"wave_{k}", unit="1", low=-bound, high=bound, start=0.0) for k in WAVES
        )
        return (HALF_FREQUENCY, EXPONENT, *waves)

    def modulus(self, theta: Array, frequency: Array) -> Array:
        """Return the transfer, shape (n, parameter) and (f,), (1, f) or (n, f) -> (n, f)."""
        ln_frequency = np.log(np.maximum(frequency, 1e-9))
        low, high = np.log(ACCURACY.cosine_range_cy_per_px)
        cosine = np.cos(np.pi * np.clip((ln_frequency - low) / (high - low), 0.0, 1.0))
        line, bend = theta[:, 1:2] * (ln_frequency - theta[:, :1]), np.zeros(())
        # Each cosine from the two before it.
        before, now = np.ones_like(cosine), cosine
        for k in range(2, WAVES[-1] + 1):
            before, now = now, 2.0 * cosine * now - before
            bend = bend + theta[:, 2 + k - WAVES[0], None] * now / k**2
        return np.exp(-np.log(2.0) * np.exp(np.minimum(line + bend, 7.0)))

    def log_prior(self, theta: Array) -> Array:
        """Return ln of the prior density, -inf outside the bounds."""
        bounds, mean, sd = self.bounds, EXPONENT.mean, EXPONENT.sd
        in_bounds = np.all((theta >= bounds[:, 0]) & (theta <= bounds[:, 1]), axis=1)
        normal = -0.5 * ((theta[:, 1] - mean) / sd) ** 2 - np.log(sd)
        waves = -0.5 * np.sum((theta[:, 2:] / THRESHOLDS.cosine_prior_sd) ** 2, axis=1)
        waves = waves - len(WAVES) * np.log(THRESHOLDS.cosine_prior_sd)
        return np.where(
            in_bounds, normal + waves - 0.5 * (1 + len(WAVES)) * np.log(2.0 * np.pi), -np.inf
        )


# A transfer without aperture and video.
PostGainBlur = BlurModel | NonparametricBlur


FAMILIES: tuple[BlurModel, ...] = (
    BlurModel(core="gaussian"),
    BlurModel(core="exponential"),
    BlurModel(core="moffat"),
)
# How much likelier than any other the form of image tubes is that of a described one, in ln.
TUBE = "exponential"
# Scattered light after the gain: least length, px, largest length as a fraction of the image's
# shorter side, and bounds of its fraction.
SCATTER_PX, SCATTER_SHARE = 3.0, 0.08
SCATTER_FRACTION = (0.0, 0.4)
COMMON = ("ln_power", "white_share", "hidden_place", "ln_anisotropy")
ANISOTROPY = (-1.5, 1.5)
# Share of the mean power that is white: it may go below zero, else a camera without would be pushed
# to one side.
WHITE = (-0.05, 1.0)
# Position of the quantisation noise within its range; the Gaussian prior keeps the optimisation
# regular where the range is narrow.
QUANTISATION, QUANTISATION_PRIOR = (0.0, 1.0), (0.5, 0.5)
# Units and bounds of the common parameters after the power.
COMMON_BOUNDS = (("1", WHITE), ("1", QUANTISATION), ("1", ANISOTROPY))


def readout_of(context: Context) -> KnownReadout:
    """Return what the camera's description says of the transfer after the gain."""
    if not has_tube(context.camera):
        return KnownReadout(height_px=1.0, video=None, anisotropy_sd=THRESHOLDS.anisotropy_sd)
    rows = 2.0 if context.interlaced else 1.0
    pitch_um, taper = float(context.camera.ccd.pitch_x_um), context.camera.taper
    return KnownReadout(
        height_px=rows * context.pitch_ratio,
        video=VideoFilter.of(context.camera),
        anisotropy_sd=THRESHOLDS.round_sd,
        fibres=(
            float(taper.fibre_pitch_um) / pitch_um,
            float(taper.interface_mtf_lp_per_mm) * pitch_um * 1e-3,
        ),
    )


@dataclass(frozen=True, kw_only=True)
class SpectrumLikelihood(Parametric):
    """Whittle's likelihood of a noise spectrum under one form of the transfer.

    The modes of noise are nearly independent complex Gaussians, so that a mean over n of them is
    gamma distributed with shape n: ln L = -n (ln M + P/M) for a measured power P and a model M
    (Whittle 1953).
    """

    spectrum: PooledSpectrum
    known: KnownReadout
    shape: PostGainBlur
    replicas: SpectralReplicas
    looks: Array

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """Common parameters, then those of the form and of the video."""
        level = np.log(float(np.mean(self.spectrum.power_dn2)))
        common = (("ln(DN^2)", (level - 12.0, level + 6.0)), *COMMON_BOUNDS)
        return (
            *flat_parameters(dict(zip(COMMON, common, strict=True))),
            *self.shape.parameters,
            *self.known.parameters,
        )

    def blur_parameters(self, theta: Array) -> Array:
        """Return the form's parameters of all, shape (n, parameter)."""
        return theta[:, len(COMMON) : len(COMMON) + len(self.shape.bounds)]

    def replica_parameters(self, theta: Array) -> Array:
        """Return the anisotropy and the form's parameters, shape (n, parameter)."""
        return theta[:, len(COMMON) - 1 : len(COMMON) + len(self.shape.bounds)]

    def passed(self, theta: Array, bend: Array | None) -> Array | float:
        """Return |V| of the video over the described one where `known.bend` is given, shape (n,
        f).
        """
        return 1.0 if bend is None else np.exp(powers(theta[:, -1]) @ bend)

    def parts(self, theta: Array) -> tuple[Array, Array]:
        """Return the white part and that of the blurred pulses, each (n, cell), DN^2."""
        passed = self.passed(theta, self._bend) ** 2
        white = theta[:, 1:2] * self._white_dn2 * passed
        pulses = (
            np.exp(theta[:, :1])
            * self.replicas.power(self.shape, self.replica_parameters(theta))
            * passed
        )
        low, high = self.spectrum.quantisation_noise_dn2
        return white + low + (high - low) * theta[:, 2:3], pulses

    @cached_property
    def _bend(self) -> Array | None:
        return self.known.bend(self.spectrum.column_cy_per_px)

    @cached_property
    def _white_dn2(self) -> Array:
        """Power in every cell if all of it were white, shape (cell,), DN^2."""
        mean_dn2 = float(np.mean(self.spectrum.power_dn2 - self.spectrum.dark_dn2))
        return max(mean_dn2, 1e-12) * self.known.electronics(self.spectrum.column_cy_per_px) ** 2

    def model(self, theta: Array) -> Array:
        """Return the power in every cell, dark included, shape (n, cell), DN^2."""
        white, pulses = self.parts(theta)
        return self.spectrum.dark_dn2 + white + pulses

    def log_likelihood(self, model: Array) -> Array:
        """Return ln L of models (n, cell), 0 where model and data agree."""
        possible = np.all(model > 0.0, axis=1)
        ratio = self.spectrum.power_dn2 / np.where(possible[:, None], model, 1.0)
        return np.where(
            possible, np.sum(self.looks * (1.0 + np.log(ratio) - ratio), axis=1), -np.inf
        )

    def log_likelihood_at(self, point: Array) -> float:
        """Return ln L at one point (parameter,)."""
        return float(self.log_likelihood(self.model(point[None]))[0])

    def log_probability(self, theta: Array) -> Array:
        """Return ln of the posterior density up to a constant that all forms share."""
        bounds = self.bounds
        in_bounds = np.all((theta >= bounds[:, 0]) & (theta <= bounds[:, 1]), axis=1)
        safe = np.clip(theta, *bounds.T)
        likelihood = self.log_likelihood(self.model(safe))
        # Anisotropies of an unknown camera and of a known one differ in width: normalised, should
        # they be compared.
        anisotropy = safe[:, len(COMMON) - 1]
        round_ = -0.5 * (anisotropy / self.known.anisotropy_sd) ** 2 - np.log(
            self.known.anisotropy_sd
        )
        hidden = -0.5 * ((safe[:, 2] - QUANTISATION_PRIOR[0]) / QUANTISATION_PRIOR[1]) ** 2
        total = likelihood + self.shape.log_prior(self.blur_parameters(safe)) + round_ + hidden
        if self.known.video and self.known.parameters:
            total = total + self.known.video.log_prior(safe[:, -1])
        return np.where(in_bounds & np.isfinite(total), total, -np.inf)

    def start_at(self, common: Array, half_frequency_cy_per_px: float) -> Array:
        """Return a point of given common parameters, the form's where it begins, and the video as
        described.
        """
        video = np.zeros(len(self.known.parameters))
        return np.concatenate([common, self.shape.start(np.log(half_frequency_cy_per_px)), video])


@dataclass(frozen=True, kw_only=True)
class SpectrumOptimum:
    """The best fit under one form."""

    problem: SpectrumLikelihood  # with the looks and the replicas that belong to the fit
    # point, covariance: peak and covariance there
    point: Array
    covariance: Array
    # laplace's approximation of the evidence, up to a constant that all forms share
    log_evidence: float

    @property
    def log_weight(self) -> float:
        """ln of the weight of this form among others: the root of its evidence, and its odds before
        the data.
        """
        # A described tube disfavours the forms that image tubes do not have.
        known, shape = self.problem.known, self.problem.shape
        atypical = known.fibres is not None and shape in FAMILIES and shape.name != TUBE
        return THRESHOLDS.evidence_power * self.log_evidence - THRESHOLDS.tube_ln_prior * atypical


def optimum_under_model(
    spectrum: PooledSpectrum,
    known: KnownReadout,
    shape: PostGainBlur,
    neighbour: SpectrumOptimum | None = None,
) -> SpectrumOptimum:
    """Find the optimum under a blur model, first roughly, then with the replicas, cells and looks
    of that fit.

    `neighbour`: the fit of another form from which the search begins.
    """
    all_replicas = spectral_replicas(
        spectrum.column_cy_per_px, spectrum.row_cy_per_px, spectrum.bins.row_pitch, known
    )
    cell_means = _cell_means_of(spectrum, known)
    problem = SpectrumLikelihood(
        spectrum=spectrum,
        known=known,
        shape=shape,
        replicas=all_replicas,
        looks=spectrum.looks_lagged,
    )
    half = len(COMMON)  # The first of a form's parameters is ln of its half frequency.
    point = (
        problem.start_at(neighbour.point[:half], float(np.exp(neighbour.point[half])))
        if neighbour
        else _start(problem)
    )
    # Heavy tails fold from afar: what a broad form leaves out, no likely form needs.
    broad = point.copy()
    broad[half] = min(broad[half] + np.log(1.5), shape.bounds[0, 1])
    sparse = without_weak_replicas(all_replicas, shape, problem.replica_parameters(broad[None])[0])
    problem = replace(problem, replicas=sparse)
    point, covariance = find_maximum(problem.log_probability, point, problem.bounds, iterations=25)
    for _ in range(2):
        sparse = without_weak_replicas(
            all_replicas, shape, problem.replica_parameters(point[None])[0]
        )
        white, pulses = problem.parts(point[None])
        pulse_fraction = (pulses / (spectrum.dark_dn2 + white + pulses))[0]
        # Only the pulses are shared by exposures; products of two exposures feel it in the square.
        fewer = 1.0 / spectrum.looks_lagged - 1.0 / spectrum.looks
        looks = 1.0 / (1.0 / spectrum.looks + pulse_fraction**2 * fewer)
        cell_factors = cell_means(shape, problem.replica_parameters(point[None]))
        problem = replace(problem, replicas=replace(sparse, cell_factors=cell_factors), looks=looks)
        point, covariance = find_maximum(
            problem.log_probability, point, problem.bounds, iterations=25
        )
    evidence = ln_evidence(float(problem.log_probability(point[None])[0]), covariance)
    return SpectrumOptimum(
        problem=problem, point=point, covariance=covariance, log_evidence=evidence
    )


def _start(problem: SpectrumLikelihood) -> Array:
    """The best of a few half frequencies, with a fifth of white noise."""
    spectrum, candidates = problem.spectrum, []
    excess_dn2 = np.maximum(spectrum.power_dn2 - spectrum.dark_dn2, 0.0)
    for half in (0.05, 0.1, 0.17, 0.3, 0.5):
        begin = problem.start_at(np.array([0.0, 0.1, QUANTISATION_PRIOR[0], 0.0]), half)
        folded = problem.replicas.power(problem.shape, problem.replica_parameters(begin[None]))[0]
        level = max(
            float(np.sum(problem.looks * 0.9 * excess_dn2) / np.sum(problem.looks * folded)), 1e-9
        )
        begin[0] = np.log(level)
        candidates.append(begin)
    points = np.clip(np.array(candidates), problem.bounds[:, 0], problem.bounds[:, 1])
    return points[int(np.argmax(problem.log_probability(points)))]


def _cell_means_of(
    spectrum: PooledSpectrum, known: KnownReadout
) -> Callable[[PostGainBlur, Array], Array]:
    """Return a function of a form and its parameters (1, parameter) that returns a mean for each
    cell, shape (cell,).

    Mean power over the modes of a cell, smeared as fading out the sides smears it, over that at its
    middle.
    """
    column, row, cell = spectrum.modes
    # Each frequency occurs twice, at rows on either side.
    _, first, position = np.unique(column + 1j * row, return_index=True, return_inverse=True)
    across, down = np.sqrt(spectrum.bins.leak_cy2_per_px2)

    def near(column: Array, row: Array) -> SpectralReplicas:
        return spectral_replicas(column, row, spectrum.bins.row_pitch, known, replicas=1)

    around = [
        near(column[first] + x * across, row[first] + y * down) for x in (-1, 1) for y in (-1, 1)
    ]
    middle = near(spectrum.column_cy_per_px, spectrum.row_cy_per_px)

    def cell_means(shape: PostGainBlur, theta: Array) -> Array:
        modes = np.mean([shifted.power(shape, theta)[0] for shifted in around], axis=0)[position]
        mean = np.bincount(cell, modes) / np.bincount(cell)
        # Where next to nothing of the pulses is left, how it is spread over the cell does not
        # matter.
        return np.clip(mean / np.maximum(middle.power(shape, theta)[0], 1e-30), 0.2, 5.0)

    return cell_means


def white_log_probability(peak: SpectrumOptimum) -> float:
    """Return ln L of the best white spectrum, to be compared with the evidence of a blurred one."""
    problem = peak.problem
    spectrum = problem.spectrum
    floor = problem.known.electronics(spectrum.column_cy_per_px) ** 2
    hidden = float(np.mean(spectrum.quantisation_noise_dn2))
    excess_dn2 = np.maximum(spectrum.power_dn2 - spectrum.dark_dn2 - hidden, 0.0)
    level = float(np.sum(problem.looks * excess_dn2) / np.sum(problem.looks * floor))
    levels = level * np.exp(np.linspace(-0.3, 0.3, 121))
    return float(problem.log_likelihood(spectrum.dark_dn2 + hidden + levels[:, None] * floor).max())
