"""Likelihood of a bar target: image as a function of its parameters, and their priors."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.mtf.bars.bar_spectrum import BarShape, table_of
from charact.mtf.bars.forms import TUBE, BarBlurModel
from charact.mtf.bars.target import BarTarget

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

NAMES = (
    "log_attenuation", "form_one", "form_two", "departure", "log_frequency", "log_length", "across_px",
    "along_px", "angle_rad", "level_dn", "pedestal_dn", "slope_across", "slope_along",
)  # fmt: skip
ALONG = ("log_length", "along_px")
# Priors, standard deviations: the bars' frequency is known to a few percent (STANAG 4349: 5 %), their length to a
# third.
FREQUENCY_SD, LENGTH_SD = 0.02, 0.35
# How far a transfer may depart from the family at the bars' frequency: share of itself, and of the whole.
DEPARTURE_SD, DEPARTURE_FLOOR = 0.015, 0.002
BOUNDS = {
    "log_attenuation": (-9.0, 2.3),
    "departure": (-0.9, 5.0),
    # Far beyond any target: bounds the size of the image when other objects are fitted.
    "log_frequency": (float(np.log(1e-3)), 0.0),
    "log_length": (0.0, float(np.log(4e3))),
}
START_CORE = 0.4


@dataclass(frozen=True, kw_only=True)
class BarLikelihood:
    """Pixels of a window with their variances, and the blur model."""

    image: Array
    window: Mask
    variance: Array
    asked: float
    length_px: float
    strip: bool
    form: BarBlurModel = TUBE

    @property
    def names(self) -> tuple[str, ...]:
        """Parameters; bars that cross the region have no ends."""
        return tuple(name for name in NAMES if not (self.strip and name in ALONG))

    @property
    def bounds(self) -> dict[str, tuple[float, float]]:
        """Bounds of the parameters that have any."""
        return {**BOUNDS, "form_one": self.form.bounds[0], "form_two": self.form.bounds[1]}


def priors(problem: BarLikelihood, mtf: float) -> tuple[Array, Array]:
    """Return mean and precision of the normal prior of each parameter; precision 0: none."""
    known = {
        "form_one": problem.form.one,
        "form_two": problem.form.two,
        "departure": (0.0, DEPARTURE_SD + DEPARTURE_FLOOR / max(mtf, 1e-3)),
        "log_frequency": (np.log(problem.asked), FREQUENCY_SD),
        "log_length": (np.log(problem.length_px), LENGTH_SD),
    }
    mean = np.array([known.get(name, (0.0, np.inf))[0] for name in problem.names])
    return mean, np.array([known.get(name, (0.0, np.inf))[1] ** -2.0 for name in problem.names])


def initial_parameters(problem: BarLikelihood, target: BarTarget) -> dict[str, float]:
    """Return starting values for a detected target."""
    pixels = problem.image[problem.window]
    ground, far = np.quantile(pixels, [0.1, 0.95] if target.sign > 0 else [0.9, 0.05])
    return {
        "log_attenuation": float(np.log(-np.log(START_CORE))),
        "form_one": problem.form.start[0],
        "form_two": problem.form.start[1],
        "departure": 0.0,
        "log_frequency": float(np.log(target.frequency)),
        "log_length": float(np.log(problem.length_px)),
        "across_px": 0.0,
        "along_px": 0.0,
        "angle_rad": target.angle_rad,
        "level_dn": 1.3 * float(far - ground),
        "pedestal_dn": float(ground),
        "slope_across": 0.0,
        "slope_along": 0.0,
    }


class BarImageModel:
    """Image of a target over the window's pixels as a function of its parameters."""

    def __init__(self, problem: BarLikelihood, target: BarTarget) -> None:
        self.problem, self.target = problem, target
        row, col = np.nonzero(problem.window)
        self.x, self.y = col - target.col, (row - target.row) * target.pitch_ratio
        across, along = self.places(target.angle_rad, 0.0, 0.0)
        self.reach = (float(np.abs(across).max()) + 3.0, float(np.abs(along).max()) + 3.0)

    def places(self, angle_rad: float, across_px: float, along_px: float) -> tuple[Array, Array]:
        """Return distances of the window's pixels across and along displaced bars, shape (pixel,), px."""
        cosine, sine = np.cos(angle_rad), np.sin(angle_rad)
        return self.x * cosine + self.y * sine - across_px, self.y * cosine - self.x * sine - along_px

    def shape(self, theta: dict[str, float]) -> BarShape:
        """Return the image's shape for parameter values."""
        return BarShape(
            bars=self.target.bars,
            frequency=float(np.exp(theta["log_frequency"])),
            length_px=np.inf if self.problem.strip else float(np.exp(theta["log_length"])),
            reference=self.problem.asked,
            log_attenuation=theta["log_attenuation"],
            form=self.problem.form,
            form_one=theta["form_one"],
            form_two=theta["form_two"],
            departure=theta["departure"],
            # The fit changes the direction too little to affect the pixel's transfer.
            angle_rad=self.target.angle_rad,
        )

    def __call__(self, theta: dict[str, float]) -> tuple[Array, Array]:
        """Return the image, shape (pixel,), and its derivatives, shape (parameter, pixel)."""
        across, along = self.places(theta["angle_rad"], theta.get("across_px", 0.0), theta.get("along_px", 0.0))
        found = table_of(self.shape(theta), *self.reach).at(across, along)
        level = theta["level_dn"]
        slopes = level * found[7], level * found[8]
        scale = (2.0 * self.reach[0], 2.0 * self.reach[1])
        picture = (
            theta["pedestal_dn"]
            + level * found[0]
            + theta["slope_across"] * across / scale[0]
            + theta["slope_along"] * along / scale[1]
        )
        derivative = {
            **dict(zip(NAMES[:6], level * found[1:7], strict=True)),
            "across_px": -slopes[0],
            "along_px": -slopes[1],
            "angle_rad": slopes[0] * along - slopes[1] * across,
            "level_dn": found[0],
            "pedestal_dn": np.ones_like(across),
            "slope_across": across / scale[0],
            "slope_along": along / scale[1],
        }
        return picture, np.stack([derivative[name] for name in self.problem.names])
