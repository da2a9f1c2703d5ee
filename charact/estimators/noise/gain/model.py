"""Noise power spectrum of a camera that blurs after its gain.

Photoelectrons are Poisson distributed and blurred after the gain; the CCD electrons add white shot
noise. The power is (k F^2 |H(f)|^2 + K) mu, and its limit f -> 0 is the covariance summed over all
separations. Image tubes have long wings (transfer exp(-(f/fc)^n) with n near 1), so the spectrum is
extrapolated with blur models instead of summed.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from charact.estimators.noise.thresholds import GAIN, GAIN_PRIORS
from charact.transfer.video_filter import VideoFilter
from labdata import Array
from labdata.camera.description import Camera, has_tube


@dataclass(frozen=True, kw_only=True)
class PixelReadoutModel:
    """Aperture and lattice of pixels, and the video filter."""

    # row pitch of one exposure, and pixel height of a described camera, column pitches
    row_pitch: float = 1.0
    described: bool = False  # whether the camera is described; otherwise readout counts as blur
    video: VideoFilter | None = None  # video filter; None for none

    @classmethod
    def of(cls, row_pitch: float, sensor: Camera | None) -> "PixelReadoutModel":
        """Return the readout model of a camera with a row pitch."""
        return cls(row_pitch=row_pitch, described=has_tube(sensor), video=VideoFilter.of(sensor))

    @cached_property
    def falls(self) -> tuple[float, float]:
        """Leading-order fall of ln |H|^2 by aperture and filter along rows and along columns,
        px^2.
        """
        if not self.described:
            return 0.0, 0.0
        aperture = np.pi**2 / 3.0
        low = np.array([GAIN.low_cy_per_px])
        filtered = (
            0.0
            if self.video is None
            else -2.0 * float(np.log(np.abs(self.video(low)))[0]) / GAIN.low_cy_per_px**2
        )
        return aperture + filtered, aperture * self.row_pitch**2

    def pixel_power(
        self, ln_power: Callable[[Array, Array], Array], column: Array, row: Array
    ) -> Array:
        """Return |H|^2 including pixel readout.

        `ln_power`: ln |H|^2 before the pixels, of frequencies along rows and columns, cycles per
        column pitch; `column`, `row`: frequencies, shape (bin,).

        Pixels sample light filtered by their aperture, sinc^2, so power beyond half a cycle per
        pixel is aliased: the nearest order, and the rest as the second order. Light without blur
        stays white. The gain of an aliased order over the baseband is limited to 2.
        """
        ln_baseband = ln_power(column, row)
        if not self.described:
            return np.exp(ln_baseband)
        out = np.zeros_like(ln_baseband)
        for x, across in _orders(column, 1.0):
            for y, down in _orders(row, self.row_pitch):
                out = out + _exponential_with_limit(ln_power(x, y) - ln_baseband) * across * down
        out = out * np.exp(ln_baseband)
        return out if self.video is None else out * np.abs(self.video(column)) ** 2


def _exponential_with_limit(difference: Array) -> Array:
    """Return exp of negative values, continued smoothly to a limit of 2 for positive ones."""
    decay = np.exp(-np.abs(difference))
    return np.where(difference < 0.0, decay, 2.0 - decay)


def _orders(frequency: Array, pitch: float) -> list[tuple[Array, Array]]:
    """Return the frequencies aliased to one, cycles per column pitch, and the aperture transfer of
    each.
    """
    lower, upper = (1.0 / pitch + sign * np.abs(frequency) for sign in (-1.0, 1.0))
    baseband, adjacent = np.sinc(frequency * pitch) ** 2, np.sinc(lower * pitch) ** 2
    return [(frequency, baseband), (lower, adjacent), (upper, 1.0 - baseband - adjacent)]


NAMES = (
    "power",
    "fall_columns",
    "fall_rows",
    "strength",
    "exponent",
    "electron_share",
    "tail",
    "spread_share",
)
UNITS = ("DN", "1", "1", "1", "1", "1", "1", "1")


def transfer(parameters: Array, column: Array, row: Array, reading: PixelReadoutModel) -> Array:
    """Return |H|^2 of the blur after the gain including pixel readout, shape (draw, bin).

    (1 - q + q sqrt(C))^2 exp(-cx x^2 - cy y^2), C = (1 + t b r^n)^(-1/t), frequencies in units of
    the reference: the tube's exp(-b r^n) for tail t = 0 and fraction q = 1, times the leading term
    of every other aperture and filter. Known pixel readout is included exactly. The parameters are
    the falls b + cx and b + cy, b, n, t and q.
    """
    columns, rows, strength, exponent = (parameters[:, i, None] for i in range(1, 5))
    tail, spread = np.maximum(parameters[:, 6, None], GAIN_PRIORS.min_tail), parameters[:, 7, None]
    known_columns, known_rows = (
        GAIN_PRIORS.reference_cy_per_px**2 * fall for fall in reading.falls
    )

    def before(column: Array, row: Array) -> Array:
        x, y = column / GAIN_PRIORS.reference_cy_per_px, row / GAIN_PRIORS.reference_cy_per_px
        gauss = (columns - strength - known_columns) * x**2 + (rows - strength - known_rows) * y**2
        core = -np.log1p(tail * strength * np.hypot(x, y) ** exponent) / tail
        if np.any(spread < 1.0):
            core = 2.0 * np.log1p(
                np.maximum(spread * np.expm1(0.5 * core), GAIN_PRIORS.min_transfer - 1.0)
            )
        return np.minimum(core - gauss, GAIN_PRIORS.max_log_transfer)

    return reading.pixel_power(before, column, row)


def spectrum_at(parameters: Array, column: Array, row: Array, reading: PixelReadoutModel) -> Array:
    """Return the power over signal at temporal lag 0, shape (draw, bin), DN."""
    white = parameters[:, 5:6]
    return parameters[:, :1] * ((1.0 - white) * transfer(parameters, column, row, reading) + white)


def leakage_ratio(
    point: Array,
    column: Array,
    row: Array,
    reading: PixelReadoutModel,
    leak_cy2_per_px2: tuple[float, float],
) -> Array:
    """Return the power of tapered modes over that of `spectrum_at`, shape (bin,), dimensionless.

    Each mode averages nearby frequencies, to second order two on either side.
    """
    across, down = np.sqrt(leak_cy2_per_px2)
    around = [
        spectrum_at(point, column + i * across, row + j * down, reading)[0]
        for i in (-1, 1)
        for j in (-1, 1)
    ]
    return np.mean(around, axis=0) / spectrum_at(point, column, row, reading)[0]


# Values of parameters that a model omits.
NONE = dict.fromkeys(NAMES, 0.0) | {"exponent": 2.0, "spread_share": 1.0}


@dataclass(frozen=True, kw_only=True)
class GainBlurModel:
    """A blur model: free parameters of the noise model and their priors."""

    # bounds of every free parameter with mean and standard deviation of its normal prior; None:
    # flat. With `split`, falls are those of the Gaussian part alone.
    priors: dict[str, tuple[tuple[float, float], tuple[float, float] | None]]
    strength: float = 0.0  # value if not free
    odds: float = 1.0  # prior weight of the model
    split: bool = False  # whether the falls exclude `strength`

    @property
    def names(self) -> tuple[str, ...]:
        """Free parameters."""
        return tuple(self.priors)

    @property
    def bounds(self) -> Array:
        """Bounds of the free parameters, shape (parameter, 2)."""
        return np.array([bounds for bounds, _ in self.priors.values()])

    def log_prior(self, points: Array) -> Array:
        """Return ln of the prior density, without that of power and falls, which all models have in
        common.
        """
        total = np.full(len(points), np.log(self.odds))
        for value, (name, (bounds, normal)) in zip(points.T, self.priors.items(), strict=True):
            if normal is not None:
                total -= 0.5 * ((value - normal[0]) / normal[1]) ** 2 + np.log(
                    np.sqrt(2.0 * np.pi) * normal[1]
                )
            elif name in ("strength", "spread_share"):
                total -= np.log(bounds[1] - bounds[0])
        return total

    def whole(self, points: Array) -> Array:
        """Return all parameters of the model, shape (point, parameter)."""
        columns = {name: points[:, i] for i, name in enumerate(self.priors)}
        fixed = NONE | {"strength": self.strength}
        out = np.stack(
            [columns.get(name, np.full(len(points), fixed[name])) for name in NAMES], axis=1
        )
        if self.split:
            out[:, 1:3] += out[:, 3:4]
        return out

    @property
    def with_free_spread(self) -> "GainBlurModel":
        """Return the model with the fall of its extended component free up to halfway to the
        next.
        """
        fall = (self.strength / GAIN_PRIORS.spread_step, self.strength * GAIN_PRIORS.spread_step)
        return replace(self, priors={**self.priors, "strength": (fall, None)})

    def part(self, point: Array) -> Array:
        """Return the free parameters out of all (parameter,), inside their bounds."""
        parameters = point.copy()
        if self.split:
            parameters[1:3] -= parameters[3] if "strength" in self.priors else 0.0
        chosen = np.array([parameters[NAMES.index(name)] for name in self.priors])
        bounds = self.bounds
        return np.clip(
            chosen, np.maximum(bounds[:, 0], -1e9) + 1e-6, np.minimum(bounds[:, 1], 1e9) - 1e-6
        )


WHITE = GainBlurModel(priors={"power": ((0.0, np.inf), None)})


def blur_models(
    exponent: tuple[float, float] | None, *, blurred: bool, floor: bool
) -> tuple[GainBlurModel, ...]:
    """Return the candidate blur models.

    `exponent`: mean and standard deviation of the exponent of a described tube; None: not
    described; `blurred`: whether noise of neighbours is correlated; `floor`: whether a white floor
    can be measured.
    """
    power = ((0.0, np.inf), None)
    white = (
        GAIN_PRIORS.electron_bounds,
        GAIN_PRIORS.electron_fraction if floor else GAIN_PRIORS.few_electrons,
    )
    falls = {
        "power": power,
        "fall_columns": (GAIN_PRIORS.fall_bounds, None),
        "fall_rows": (GAIN_PRIORS.fall_bounds, None),
    }
    tube = GainBlurModel(
        priors={
            **falls,
            "strength": (GAIN_PRIORS.strength_bounds, None),
            "exponent": (GAIN_PRIORS.exponent_bounds, exponent or GAIN_PRIORS.exponent),
            "electron_share": white,
        }
    )
    if exponent is not None or not blurred:
        return (tube,)
    gaussian = {**falls, "electron_share": white}
    tailed = GainBlurModel(
        priors={
            **gaussian,
            "strength": (GAIN_PRIORS.tail_strength_bounds, None),
            "tail": (GAIN_PRIORS.tail_bounds, GAIN_PRIORS.tail),
        },
        split=True,
    )
    spread = {**gaussian, "spread_share": (GAIN_PRIORS.spread_bounds, None)}
    spread_models = [
        GainBlurModel(
            priors=spread, strength=fall, odds=1.0 / len(GAIN_PRIORS.spread_falls), split=True
        )
        for fall in GAIN_PRIORS.spread_falls
    ]
    return (tube, GainBlurModel(priors=gaussian), tailed, *spread_models)
