"""Forms that the blur after the gain may have, and what is known of their parameters before the data.

At frequency 0, where nothing is measured, forms say what the power rises to: image tubes, exp(-b r^n) with n near 1.3,
make a cusp there; a Gaussian and whatever has an even point spread function of finite width end flat.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from charact.noise.gain.model import NAMES

Array = NDArray[np.float64]

# Bounds, and mean and standard deviation of the normal prior, of the exponent where no sensor states it: image tubes
# lie between 1.1 and 1.7.
EXPONENT, EXPONENT_PRIOR = (0.7, 2.5), (1.3, 0.2)
# The same of a tail: a third for exp(-r/a), none for a Gaussian.
TAIL, TAIL_PRIOR = (0.01, 3.0), (0.33, 0.33)
# The same of the electrons' share of the noise, K / (K + k F^2): anything where a white floor can be looked for, else
# near none, as a photoelectron makes some hundred electrons in the CCD. Below zero, for a camera without would else be
# pushed to one side.
SHARE, SHARE_PRIOR, FEW_ELECTRONS = (-0.5, 1.0), (0.0, 10.0), (0.003, 0.01)
FALL, STRENGTH = (-1.0, 6.0), (-1.5, 6.0)
# Widest blur with a tail that an image of some hundred pixels tells from shading, as its fall at the reference.
WIDE = (0.0, 20.0)
# Share of the light that is spread wider than the rest, and falls of that at the reference: Gaussians of 1.6 to 4.5 px.
SPREAD, SPREAD_FALLS, SPREAD_STEP = (0.0, 0.6), (1.0, 2.8, 8.0), 1.7
# Standard errors of that share beyond which its fall is told too.
SPREAD_SEEN = 3.0
# What forms are without a parameter.
NONE = dict.fromkeys(NAMES, 0.0) | {"exponent": 2.0, "spread_share": 1.0}


@dataclass(frozen=True, kw_only=True)
class GainBlurModel:
    """A form of the blur: which parameters of the whole model are free, and what is known of them before the data.

    Parameters
    ----------
    priors
        Bounds of every free parameter with mean and standard deviation of its normal prior; None: flat. Falls are
        those of the Gaussian part alone where `split`.
    strength
        Value where it is not free.
    odds
        How likely it is beside the others before the data.
    split
        Whether `strength` is not yet in the falls.
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
        """Their bounds, shape (parameter, 2)."""
        return np.array([bounds for bounds, _ in self.priors.values()])

    def log_prior(self, points: Array) -> Array:
        """Return ln of the prior density but for that of the power and the falls, which all forms share."""
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
        """The form with the fall of its wider share free up to halfway to the next."""
        fall = (self.strength / SPREAD_STEP, self.strength * SPREAD_STEP)
        return replace(self, priors={**self.priors, "strength": (fall, None)})

    def part(self, point: Array) -> Array:
        """Return the free ones of all parameters (parameter,), inside their bounds."""
        own = point.copy()
        if self.split:
            own[1:3] -= own[3] if "strength" in self.priors else 0.0
        chosen = np.array([own[NAMES.index(name)] for name in self.priors])
        bounds = self.bounds
        return np.clip(chosen, np.maximum(bounds[:, 0], -1e9) + 1e-6, np.minimum(bounds[:, 1], 1e9) - 1e-6)


def blur_models(exponent: tuple[float, float] | None, *, blurred: bool, floor: bool) -> tuple[GainBlurModel, ...]:
    """Return the forms that are thought possible.

    Parameters
    ----------
    exponent
        Mean and standard deviation of the exponent of a described tube, which has that form; None: not described.
    blurred
        Whether noise is seen to be shared by neighbours.
    floor
        Whether a white floor can be looked for.
    """
    power = ((0.0, np.inf), None)
    share = (SHARE, SHARE_PRIOR if floor else FEW_ELECTRONS)
    falls = {"power": power, "fall_columns": (FALL, None), "fall_rows": (FALL, None)}
    tube = GainBlurModel(priors={**falls, "strength": (STRENGTH, None), "exponent": (EXPONENT, exponent or EXPONENT_PRIOR),
                        "electron_share": share})  # fmt: skip
    if exponent is not None or not blurred:
        return (tube,)
    gaussian = {**falls, "electron_share": share}
    tailed = GainBlurModel(priors={**gaussian, "strength": (WIDE, None), "tail": (TAIL, TAIL_PRIOR)}, split=True)
    spread = {**gaussian, "spread_share": (SPREAD, None)}
    wide = [
        GainBlurModel(priors=spread, strength=fall, odds=1.0 / len(SPREAD_FALLS), split=True) for fall in SPREAD_FALLS
    ]
    return (tube, GainBlurModel(priors=gaussian), tailed, *wide)
