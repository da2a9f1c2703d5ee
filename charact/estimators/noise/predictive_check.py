"""Posterior predictive check of flats.

Gains are fitted to means, variances and low spatial frequencies. Skewness, tails, row and column
means, flicker and local variance of measured flats are compared with flats drawn from the
posterior.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from charact.estimators.noise.findings import finding
from charact.estimators.noise.gain import model
from charact.estimators.noise.gain.emva1288 import excess_of
from charact.estimators.noise.gain.model import PixelReadoutModel
from charact.estimators.noise.gain.single_setting import SingleSetting
from charact.estimators.noise.thresholds import PREDICTIVE
from charact.frames.rounding import QUANTISED_DN2
from charact.frames.temporal import split_fields
from charact.method import Context
from charact.verdict import Finding
from labdata import Posterior, StackEntry, open_lazy_stack

Array = NDArray[np.floating]


@dataclass(frozen=True, kw_only=True)
class LightNoise:
    """Noise of uniform light for one posterior draw."""

    pulse_dn: float  # mean pulse height, DN; 0: no intensifier
    height_variance: float  # relative variance of the pulse heights, dimensionless
    electron_gain_dn: float  # K, DN per electron of the CCD; 0: no electron noise
    # parameters of `charact.estimators.noise.gain.model.transfer`; None: no blur
    blur: NDArray[np.float64] | None = None
    reading: PixelReadoutModel = field(default_factory=PixelReadoutModel)  # pixel readout
    retained: float = 0.0  # fraction of the light left one exposure later, dimensionless

    def frames(self, light_dn: Array, count: int, every: int, rng: np.random.Generator) -> Array:
        """Draw every `every`-th of successive exposures, shape (count, row, col), DN above the
        dark.

        `light_dn`: mean signal of every pixel, shape (row, col), DN.
        """
        if not self.pulse_dn:
            return self._electrons(np.broadcast_to(light_dn, (count, *light_dn.shape)), rng)
        glow = self._pulses(light_dn, np.inf, rng)
        out = [glow]
        for _ in range(count - 1):
            glow = self.retained**every * glow + self._pulses(light_dn, every, rng)
            out.append(glow)
        light, blur = np.array(out), self._blur(light_dn.shape)
        if blur is not None:
            light = np.fft.irfft2(np.fft.rfft2(light) * blur, s=light_dn.shape)
        return self._electrons(light, rng)

    def _pulses(self, light_dn: Array, exposures: float, rng: np.random.Generator) -> Array:
        """Return what the pulses of the last exposures leave in the present one, before the blur.

        Of i exposures ago the fraction (1 - r) r^i is left. Pulses of one height law replace those
        of all exposures: their sum has the same mean, variance and third cumulant.
        """
        first, squared, cubed = (
            (1.0 - self.retained) ** k
            * (1.0 - self.retained ** (k * exposures))
            / (1.0 - self.retained**k)
            for k in (1, 2, 3)
        )
        # Second over first moment of the heights, and third over second.
        mean_height = self.pulse_dn * (1.0 + self.height_variance) * squared / first
        skewed_height = self.pulse_dn * (1.0 + 2.0 * self.height_variance) * cubed / squared
        skewed_height = min(skewed_height, PREDICTIVE.max_skewness * mean_height)
        height, variance = (
            2.0 * mean_height - skewed_height,
            (skewed_height - mean_height) / (2.0 * mean_height - skewed_height),
        )
        number = rng.poisson(first * light_dn / height)
        if variance < 1e-9:
            return number * height
        return height * variance * rng.standard_gamma(number / variance)

    def _blur(self, shape: tuple[int, int]) -> Array | None:
        """Return the transfer at every frequency of an image."""
        if self.blur is None:
            return None
        # Frequencies along columns occur with both signs.
        column, row = np.meshgrid(
            np.fft.rfftfreq(shape[1]), np.fft.rfftfreq(shape[0]) / self.reading.row_pitch
        )
        frequency = column.ravel().astype(float), row.ravel().astype(float)
        power = model.transfer(self.blur[None], *frequency, self.reading)[0].reshape(column.shape)
        step = np.arange(shape[0])
        return np.sqrt(power)[np.minimum(step, shape[0] - step)]

    def _electrons(self, light_dn: Array, rng: np.random.Generator) -> Array:
        """Return the light with shot noise of electrons."""
        if not self.electron_gain_dn:
            return light_dn
        return self.electron_gain_dn * rng.poisson(
            np.maximum(light_dn, 0.0) / self.electron_gain_dn
        )


def pulse_noise(
    posterior: Posterior,
    index: int,
    level_factor: float,
    reading: PixelReadoutModel,
    rng: np.random.Generator,
) -> LightNoise:
    """Return the noise of an intensified camera for one draw of the noise-spectrum model.

    `posterior`, `index`: draws of `charact.estimators.noise.gain.model`, and the index of one;
    `level_factor`: covariance over signal of this level over the pooled one, dimensionless;
    `reading`: pixel readout; `rng`: generator for the pulse-height variance.

    The spectrum gives k F^2; the relative variance of heights is drawn from its prior. Image lag
    that leaves the fraction r per exposure lowers the covariance of one exposure by (1 - r) / (1 +
    r).
    """
    at = {name: float(posterior[name][index]) for name in (*model.NAMES, "lag_factor")}
    electrons = max(at["electron_share"], 0.0)
    spread = float(rng.uniform(*PREDICTIVE.height_variances))
    factor = max(at["lag_factor"], 1.0)
    # A draw of noise that falls with the light has no pulses.
    power_dn = max(level_factor * at["power"], 0.0)
    return LightNoise(
        pulse_dn=power_dn * factor * max(1.0 - electrons, 0.0) / (1.0 + spread),
        height_variance=spread,
        electron_gain_dn=power_dn * electrons,
        blur=np.array([at[name] for name in model.NAMES]),
        reading=reading,
        retained=(factor - 1.0) / (factor + 1.0),
    )


def electron_noise(gain_dn: float, excess_factor: float) -> LightNoise:
    """Return the noise of a camera without an intensifier; F^2 of a register is one plus the
    relative variance of heights.

    `gain_dn` is the gain per electron, DN; a draw below 0 has no noise.
    """
    gain_dn = max(gain_dn, 0.0)
    if excess_factor > 1.0:
        return LightNoise(
            pulse_dn=gain_dn, height_variance=excess_factor - 1.0, electron_gain_dn=0.0
        )
    return LightNoise(pulse_dn=0.0, height_variance=0.0, electron_gain_dn=gain_dn)


# Side of binned squares, px: finer detail depends on the blur beyond the fitted frequencies.
SIDE_PX = 4


@dataclass(frozen=True, kw_only=True)
class SummaryStatistic:
    """A summary statistic of frames."""

    words: str  # description
    harmless: float  # tolerated deviation
    upwards: bool = False  # whether only an excess counts


STATISTICS: dict[str, SummaryStatistic] = {
    "variance": SummaryStatistic(
        words=f"logarithm of the variance of {SIDE_PX} x {SIDE_PX} px", harmless=0.06
    ),
    "row_neighbours": SummaryStatistic(
        words="correlation of neighbouring squares of a row", harmless=0.03
    ),
    "below": SummaryStatistic(
        words="correlation of neighbouring squares of a column", harmless=0.03
    ),
    "skewness": SummaryStatistic(words="skewness of the squares", harmless=0.06),
    "tail": SummaryStatistic(
        words="height of the highest 0.1 % of the squares over their standard deviation",
        harmless=0.15,
    ),
    "patches": SummaryStatistic(
        words="logarithm of the scatter of the variance over the image", harmless=0.4, upwards=True
    ),
    "rows": SummaryStatistic(
        words="logarithm of the variance of row means", harmless=0.3, upwards=True
    ),
    "columns": SummaryStatistic(
        words="logarithm of the variance of column means", harmless=0.3, upwards=True
    ),
    "flicker": SummaryStatistic(
        words="logarithm of the variance of frame means", harmless=0.5, upwards=True
    ),
    "successive": SummaryStatistic(words="correlation of successive exposures", harmless=0.04),
}


def summary_statistics(frames: Array) -> dict[str, float]:
    """Return the summary statistics of exposures of one parity.

    `frames`: pixels, shape (exposure, row, col), DN; rows and columns in multiples of `SIDE_PX`.
    """
    count, rows, cols = frames.shape
    squares = frames.reshape(count, rows // SIDE_PX, SIDE_PX, cols // SIDE_PX, SIDE_PX).mean(
        axis=(2, 4)
    )
    change = squares - squares.mean(axis=0)
    frame_change = change.mean(axis=(1, 2))
    change -= frame_change[:, None, None]
    power = max(float(np.mean(change**2)), 1e-30)
    statistics = {
        "variance": np.log(power),
        "row_neighbours": np.mean(change[:, :, 1:] * change[:, :, :-1]) / power,
        "below": np.mean(change[:, 1:] * change[:, :-1]) / power,
        "skewness": np.mean(change**3) / power**1.5,
        "tail": np.quantile(change, PREDICTIVE.tail_quantile) / np.sqrt(power),
        "patches": _log_variance(_patches(change**2) / power),
        "rows": _log_variance(change.mean(axis=2)),
        "columns": _log_variance(change.mean(axis=1)),
    }
    if count >= PREDICTIVE.min_exposures:
        statistics["flicker"] = _log_variance(frame_change)
        statistics["successive"] = np.mean(change[1:] * change[:-1]) / power
    return {name: float(value) for name, value in statistics.items()}


def _patches(square: Array) -> Array:
    """Return means over patches and exposures."""
    rows, cols = (length // PREDICTIVE.patch for length in square.shape[1:])
    cut = square[:, : rows * PREDICTIVE.patch, : cols * PREDICTIVE.patch].mean(axis=0)
    return cut.reshape(rows, PREDICTIVE.patch, cols, PREDICTIVE.patch).mean(axis=(1, 3))


def _log_variance(values: Array) -> float:
    return float(np.log(max(float(np.var(values)), 1e-30)))


@dataclass(frozen=True, kw_only=True)
class PredictiveResidual:
    """Comparison of one statistic of one stack."""

    # stack, sign: label of the stack and name of the statistic
    stack: str
    sign: str
    # measured, expected, sd: statistic of the measured frames, and mean and standard deviation of
    # the drawn ones
    measured: float
    expected: float
    sd: float
    chance: float  # p-value of the deviation beyond its tolerance


def predictive_residuals(
    entries: tuple[StackEntry, ...],
    pooled: SingleSetting,
    gain_dn: Array | None,
    *,
    context: Context,
) -> list[PredictiveResidual]:
    """Return the statistics of some flats compared with frames drawn from the posterior.

    `entries`: the session's stacks; `pooled`: fit of the flats; `gain_dn`: draws of K for white
    noise, DN per electron, shape (draw,); None: fitted blur and gain.

    Dark noise is not modelled: dark frames, mirrored and shifted at random, are added, with a
    random fraction of the rounding error if the dark noise is smaller than a step. Shading is
    retained. Replicates vary over the posterior, and over the prior of the pulse-height variance.
    Gelman, Meng & Stern, Statistica Sinica 6, 733 (1996).
    """
    by_label = {entry.label: entry for entry in entries}
    rng = np.random.default_rng([context.seed, 61])
    out: list[PredictiveResidual] = []
    # The dimmest, the median and the brightest of the fitted flats.
    fitted = np.flatnonzero(pooled.series.fitted)
    some = np.unique(
        np.linspace(0, len(fitted) - 1, min(PREDICTIVE.levels, len(fitted))).round().astype(int)
    )
    for index in fitted[some].tolist():
        flat, dark = pooled.series.flats[index], pooled.series.darks[index]
        frames, base = (_middle(by_label[label], context) for label in (flat.label, dark.label))
        if frames is None or base is None:
            continue
        law = _noise_source(pooled, index, gain_dn, context, rng)
        steps = float(dark.variance_dn2 < QUANTISED_DN2)
        out += _stack_residuals(
            flat.label, frames, base, law, 2 if context.interlaced else 1, rng, steps
        )
    return out


def findings_of(residuals: list[PredictiveResidual]) -> list[Finding]:
    """Return findings of significant deviations from frames drawn from the posterior."""
    odd = [
        residual
        for residual in residuals
        if residual.chance * len(residuals) < PREDICTIVE.false_alarm
    ]
    worst = sorted(odd, key=lambda residual: residual.chance)[:3]
    return [
        finding(
            "model-misfit",
            f"{residual.stack} differs from frames drawn from the posterior: "
            f"{STATISTICS[residual.sign].words} is {residual.measured:.3g}, expected "
            f"{residual.expected:.3g} ± "
            f"{residual.sd:.2g}",
        )
        for residual in worst
    ]


def predictive_figure_data(residuals: list[PredictiveResidual]) -> dict[str, Any]:
    """Return the figure data of the check."""
    names = ("stack", "sign", "measured", "expected", "sd", "chance")
    return {
        "figure": "predictive-frames",
        **{name: [getattr(residual, name) for residual in residuals] for name in names},
        "harmless": [STATISTICS[residual.sign].harmless for residual in residuals],
    }


def _middle(entry: StackEntry, context: Context) -> Array | None:
    """Return the image centre of successive exposures of one parity, shape (exposure, row, col);
    None if too small.
    """
    stack = open_lazy_stack(entry)
    data = stack.frames(0, min(len(stack), PREDICTIVE.exposures))
    field = split_fields(data, 2 if context.interlaced else 1)[0]
    rows, cols = (
        SIDE_PX * (min(length, PREDICTIVE.side_px) // SIDE_PX) for length in field.shape[1:]
    )
    if min(rows, cols) < PREDICTIVE.min_side_px or len(field) < 2:
        return None
    first_row, first_col = (field.shape[1] - rows) // 2, (field.shape[2] - cols) // 2
    return field[:, first_row : first_row + rows, first_col : first_col + cols].astype(np.float64)


def _noise_source(
    pooled: SingleSetting,
    index: int,
    gain_dn: Array | None,
    context: Context,
    rng: np.random.Generator,
) -> Callable[[], LightNoise]:
    """Return a function that draws the noise of a level from the posterior."""
    if gain_dn is not None:
        factor = excess_of(pooled.series.flats[0].conditions, context).factor
        return lambda: electron_noise(float(rng.choice(gain_dn)), factor)
    posterior, reading = pooled.posterior, pooled.summary.reading
    level_factor = pooled.level_share(index)
    return lambda: pulse_noise(
        posterior, int(rng.integers(len(posterior.draws))), level_factor, reading, rng
    )


def _stack_residuals(
    label: str,
    frames: Array,
    base: Array,
    law: Callable[[], LightNoise],
    every: int,
    rng: np.random.Generator,
    steps_dn: float = 0.0,
) -> list[PredictiveResidual]:
    """Return the residuals of one stack, with rounding by steps of up to `steps_dn`."""
    from scipy.ndimage import uniform_filter

    light = np.maximum(
        uniform_filter(
            frames.mean(axis=0) - base.mean(axis=0), PREDICTIVE.smoothing_px, mode="nearest"
        ),
        0.0,
    )
    change = (base - base.mean(axis=0)) * np.sqrt(len(base) / (len(base) - 1))
    drawn = [
        summary_statistics(
            law().frames(light, len(frames), every, rng)
            + _resample_dark_noise(change, len(frames), rng)
            + _rounding(frames.shape, steps_dn, rng)
        )
        for _ in range(PREDICTIVE.replicates)
    ]
    ours = summary_statistics(frames)
    return [
        _residual(label, name, value, np.array([statistics[name] for statistics in drawn]))
        for name, value in ours.items()
    ]


def _rounding(shape: tuple[int, ...], most_dn: float, rng: np.random.Generator) -> Array:
    """Return the rounding error of a step of random height, DN."""
    if not most_dn:
        return np.zeros(shape)
    height = rng.uniform(0.0, most_dn)
    return height * rng.uniform(-0.5, 0.5, shape)


def _resample_dark_noise(change: Array, count: int, rng: np.random.Generator) -> Array:
    """Return dark-noise frames drawn with replacement, mirrored and shifted at random."""
    rows, cols = change.shape[1:]
    out = []
    for index in rng.integers(len(change), size=count):
        image = change[index, :: rng.choice([-1, 1]), :: rng.choice([-1, 1])]
        out.append(np.roll(image, (rng.integers(rows), rng.integers(cols)), axis=(0, 1)))
    return np.array(out)


def _residual(label: str, name: str, measured: float, drawn: Array) -> PredictiveResidual:
    """Return the residual of one statistic, with a p-value by Student's t for few replicates."""
    from scipy.special import stdtr

    expected, sd = float(drawn.mean()), max(float(drawn.std(ddof=1)), 1e-12)
    departure = measured - expected if STATISTICS[name].upwards else abs(measured - expected)
    excess = max(departure - STATISTICS[name].harmless, 0.0) / (
        sd * np.sqrt(1.0 + 1.0 / len(drawn))
    )
    sides = 1.0 if STATISTICS[name].upwards else 2.0
    chance = min(1.0, sides * float(stdtr(len(drawn) - 1, -excess))) if excess > 0 else 1.0
    return PredictiveResidual(
        stack=label, sign=name, measured=measured, expected=expected, sd=sd, chance=chance
    )
