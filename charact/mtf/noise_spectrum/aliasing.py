"""How sampling folds a transfer's square into the band of the pixels, replica by replica."""

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from charact.mtf.blur_models import transfer as forms
from charact.mtf.blur_models.one_dimensional import EXPONENT, EXPONENT_PRIOR, HALF_FREQUENCY
from charact.mtf.noise_spectrum.thresholds import ACCURACY, THRESHOLDS
from charact.video_filter import VideoFilter

Array = NDArray[np.float64]


class PostGainBlur(Protocol):
    """A transfer function without aperture and video, as `charact.mtf.blur_models.one_dimensional.BlurModel`."""

    @property
    def name(self) -> str: ...
    @property
    def bounds(self) -> Array: ...
    @property
    def parameters(self) -> dict[str, tuple[str, tuple[float, float]]]: ...
    def start(self, half_frequency_cy_per_px: float) -> Array: ...
    def modulus(self, theta: Array, frequency: Array) -> Array: ...
    def log_prior(self, theta: Array) -> Array: ...


@dataclass(frozen=True, kw_only=True)
class KnownReadout:
    """The known part of the transfer after the gain."""

    height_px: float  # extent of a pixel as read along columns, column pitches; two rows where fields sum pairs of them
    video: VideoFilter | None  # filter along rows, or None
    anisotropy_sd: float  # prior standard deviation of the logarithm of the anisotropy
    # pitch of the taper's fibres, column pitches, and f0 of its interfaces exp(-(f/f0)^2), cycles per column pitch
    fibres: tuple[float, float] | None = None

    def electronics(self, column: Array) -> Array:
        """Return |V| of the described video at frequencies along rows; it acts on pixels, so it has no replicas."""
        return np.ones_like(column) if self.video is None else np.abs(self.video(column))

    @property
    def parameters(self) -> dict[str, tuple[str, tuple[float, float]]]:
        """Unit and bounds of what is known within a range only, by name."""
        return self.video.parameters if self.video else {}

    def bend(self, column: Array) -> Array | None:
        """Return how ln of |V| moves with the video's bandwidth, see `VideoFilter.bend`; None: it does not."""
        return self.video.bend(column).real if self.video and self.video.parameters else None

    def aperture(self, column: Array, row: Array) -> Array:
        """Return |sinc sinc| of the pixel, and the taper where it is described."""
        pixel = np.abs(np.sinc(column) * np.sinc(row * self.height_px))
        if self.fibres is None:
            return pixel
        radius, (pitch, interface) = np.hypot(column, row), self.fibres
        return pixel * np.abs(forms.disc(radius, pitch)) * np.exp(-((radius / interface) ** 2))


@dataclass(frozen=True, kw_only=True)
class SpectralReplicas:
    """Which replicas of the spectrum fold into which cells."""

    # column, row, cell, known: frequency of each replica, the cell that it folds into, in order, and the known |H|^2
    # there, shape (replica,)
    column: Array
    row: Array
    cell: NDArray[np.int64]
    known: Array
    first: NDArray[np.int64]  # index of the first replica of each cell, shape (cell,)
    within: Array  # mean over the modes of a cell of the folded power, over that at its mean frequency, shape (cell,)

    def power(self, shape: PostGainBlur, theta: Array) -> Array:
        """Return the folded |H|^2 of each cell for (ln anisotropy, *shape), shape (n, parameter) -> (n, cell)."""
        frequency = np.hypot(self.column, self.row * np.exp(-theta[:, :1]))
        core = shape.modulus(theta[:, 1:], frequency) ** 2 * self.known
        return np.add.reduceat(core, self.first, axis=1) * self.within


def spectral_replicas(
    column: Array, row: Array, row_pitch: float, known: KnownReadout, replicas: int = ACCURACY.n_replicas
) -> SpectralReplicas:
    """Return all replicas up to so many periods away for frequencies inside the band."""
    steps = np.arange(-replicas, replicas + 1)
    across, up = (grid.ravel() for grid in np.meshgrid(steps, steps / row_pitch))
    columns, rows = (column[:, None] + across).ravel(), (row[:, None] + up).ravel()
    cell = np.repeat(np.arange(len(column)), len(across))
    return SpectralReplicas(
        column=columns, row=rows, cell=cell,
        known=known.aperture(columns, rows) ** 2 * known.electronics(column)[cell] ** 2,
        first=np.arange(len(column)) * len(across), within=np.ones(len(column)),
    )  # fmt: skip


def without_weak_replicas(whole: SpectralReplicas, shape: PostGainBlur, theta: Array) -> SpectralReplicas:
    """Return the folding without the replicas that carry next to nothing at one point (parameter,)."""
    one = replace(whole, within=np.ones(len(whole.first)))
    core = shape.modulus(theta[None, 1:], np.hypot(whole.column, whole.row * np.exp(-theta[0]))[None])[0] ** 2
    part, total = core * whole.known, one.power(shape, theta[None])[0]
    kept = part > ACCURACY.min_replica * total[whole.cell]
    kept[whole.first + (whole.first[1] - whole.first[0]) // 2] = True
    cell = whole.cell[kept]
    return replace(
        whole, column=whole.column[kept], row=whole.row[kept], cell=cell, known=whole.known[kept],
        first=np.searchsorted(cell, np.arange(len(whole.first))),
    )  # fmt: skip


# Waves of the departure from a straight line, over this range of frequency, and the scale of their amplitudes.
WAVES = tuple(range(2, 8))


@dataclass(frozen=True)
class NonparametricBlur:
    """-ln H = ln 2 exp(s), s a free smooth function of ln f.

    s = n ln(f/f2) + sum of a_k cos(k pi t)/k^2, t the place of ln f in its range: with normal amplitudes a smoothing
    spline, whose second derivative is penalised. Without them it is the form exp(-ln 2 (f/f2)^n).
    """

    name = "free"

    @property
    def parameters(self) -> dict[str, tuple[str, tuple[float, float]]]:
        """Unit and bounds of each parameter by name."""
        low, high = np.log(HALF_FREQUENCY)
        waves = {f"wave_{k}": ("1", (-THRESHOLDS.cosine_bound, THRESHOLDS.cosine_bound)) for k in WAVES}
        return {"ln_half_frequency": ("ln(cy/px)", (float(low), float(high))), "exponent": ("1", EXPONENT), **waves}

    @property
    def bounds(self) -> Array:
        """Bounds of the parameters, shape (parameter, 2)."""
        return np.array([bound for _, bound in self.parameters.values()])

    def start(self, half_frequency_cy_per_px: float) -> Array:
        """Return a starting point of the optimisation."""
        return np.array([np.log(half_frequency_cy_per_px), 1.5, *np.zeros(len(WAVES))])

    def modulus(self, theta: Array, frequency: Array) -> Array:
        """Return the transfer, shape (n, parameter) and (f,) or (n, f) -> (n, f)."""
        place = np.log(np.maximum(frequency, 1e-9))
        low, high = np.log(ACCURACY.cosine_range_cy_per_px)
        bend = _waves(np.pi * np.clip((place - low) / (high - low), 0.0, 1.0), theta[:, 2:])
        line = theta[:, 1:2] * (place - theta[:, :1])
        return np.exp(-np.log(2.0) * np.exp(np.minimum(line + bend, 7.0)))

    def log_prior(self, theta: Array) -> Array:
        """Return ln of the prior density, -inf outside the bounds."""
        bounds = self.bounds
        inside = np.all((theta >= bounds[:, 0]) & (theta <= bounds[:, 1]), axis=1)
        mean, sd = EXPONENT_PRIOR
        normal = -0.5 * ((theta[:, 1] - mean) / sd) ** 2 - np.log(sd)
        waves = -0.5 * np.sum((theta[:, 2:] / THRESHOLDS.cosine_prior_sd) ** 2, axis=1) - len(WAVES) * np.log(
            THRESHOLDS.cosine_prior_sd
        )
        return np.where(inside, normal + waves - 0.5 * (1 + len(WAVES)) * np.log(2.0 * np.pi), -np.inf)


def _waves(angle: Array, amplitude: Array) -> Array:
    """Return the sum of a_k cos(k angle)/k^2, each cosine from the two before it."""
    one = np.cos(angle)
    before, now, total = np.ones_like(one), one, np.zeros(np.broadcast_shapes(one.shape, (len(amplitude), 1)))
    for k in range(2, WAVES[-1] + 1):
        before, now = now, 2.0 * one * now - before
        total = total + amplitude[:, k - WAVES[0], None] * now / k**2
    return total
