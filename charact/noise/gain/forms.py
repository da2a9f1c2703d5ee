"""Blur models with their priors.

They extrapolate the power to frequency 0: image tubes, exp(-b r^n) with n near 1.3, have a cusp there, a Gaussian is
flat.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from charact.noise.gain.model import NAMES
from charact.noise.thresholds import GAIN_PRIORS

Array = NDArray[np.float64]

# Values of parameters that a model omits.
NONE = dict.fromkeys(NAMES, 0.0) | {"exponent": 2.0, "spread_share": 1.0}


@dataclass(frozen=True, kw_only=True)
class GainBlurModel:
    """A blur model: free parameters of the noise model and their priors.

    Parameters
    ----------
    priors
        Bounds of every free parameter with mean and standard deviation of its normal prior; None: flat. With `split`,
        falls are those of the Gaussian part alone.
    strength
        Value if not free.
    odds
        Prior weight of the model.
    split
        Whether the falls exclude `strength`.
    """

    priors: dict[str, tuple[tuple[float, float], tuple[float, float] | None]]
    strength: float = 0.0
    odds: float = 1.0
    split: bool = False

    @property
    def names(self) -> tuple[str, ...]:
        """Free parameters."""
        return tuple(self.priors)

    @property
    def bounds(self) -> Array:
        """Bounds of the free parameters, shape (parameter, 2)."""
        return np.array([bounds for bounds, _ in self.priors.values()])

    def log_prior(self, points: Array) -> Array:
        """Return ln of the prior density, without that of power and falls, which all models have in common."""
        total = np.full(len(points), np.log(self.odds))
        for value, (name, (bounds, normal)) in zip(points.T, self.priors.items(), strict=True):
            if normal is not None:
                total -= 0.5 * ((value - normal[0]) / normal[1]) ** 2 + np.log(np.sqrt(2.0 * np.pi) * normal[1])
            elif name in ("strength", "spread_share"):
                total -= np.log(bounds[1] - bounds[0])
        return total

    def whole(self, points: Array) -> Array:
        """Return all parameters of the model, shape (point, parameter)."""
        place = {name: points[:, i] for i, name in enumerate(self.priors)}
        fixed = NONE | {"strength": self.strength}
        out = np.stack([place.get(name, np.full(len(points), fixed[name])) for name in NAMES], axis=1)
        if self.split:
            out[:, 1:3] += out[:, 3:4]
        return out

    @property
    def freed(self) -> "GainBlurModel":
        """Return the model with the fall of its extended component free up to halfway to the next."""
        fall = (self.strength / GAIN_PRIORS.spread_step, self.strength * GAIN_PRIORS.spread_step)
        return replace(self, priors={**self.priors, "strength": (fall, None)})

    def part(self, point: Array) -> Array:
        """Return the free parameters out of all (parameter,), inside their bounds."""
        own = point.copy()
        if self.split:
            own[1:3] -= own[3] if "strength" in self.priors else 0.0
        chosen = np.array([own[NAMES.index(name)] for name in self.priors])
        bounds = self.bounds
        return np.clip(chosen, np.maximum(bounds[:, 0], -1e9) + 1e-6, np.minimum(bounds[:, 1], 1e9) - 1e-6)


def blur_models(exponent: tuple[float, float] | None, *, blurred: bool, floor: bool) -> tuple[GainBlurModel, ...]:
    """Return the candidate blur models.

    Parameters
    ----------
    exponent
        Mean and standard deviation of the exponent of a described tube; None: not described.
    blurred
        Whether noise of neighbours is correlated.
    floor
        Whether a white floor can be measured.
    """
    power = ((0.0, np.inf), None)
    share = (GAIN_PRIORS.electron_bounds, GAIN_PRIORS.electron_fraction if floor else GAIN_PRIORS.few_electrons)
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
            "electron_share": share,
        }
    )
    if exponent is not None or not blurred:
        return (tube,)
    gaussian = {**falls, "electron_share": share}
    tailed = GainBlurModel(
        priors={
            **gaussian,
            "strength": (GAIN_PRIORS.tail_strength_bounds, None),
            "tail": (GAIN_PRIORS.tail_bounds, GAIN_PRIORS.tail),
        },
        split=True,
    )
    spread = {**gaussian, "spread_share": (GAIN_PRIORS.spread_bounds, None)}
    wide = [
        GainBlurModel(priors=spread, strength=fall, odds=1.0 / len(GAIN_PRIORS.spread_falls), split=True)
        for fall in GAIN_PRIORS.spread_falls
    ]
    return (tube, GainBlurModel(priors=gaussian), tailed, *wide)
